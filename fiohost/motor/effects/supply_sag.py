"""The supply falls with the current drawn."""

from fiohost.motor.effect import Effect, Parameter


def resistance(ohms, duty_pct, z, q):  # type: ignore[no-untyped-def]
    share = duty_pct * 0.01
    return ohms + q[0] * share * share


EFFECTS = (
    Effect(
        name="supply_sag",
        summary="supply falls with current drawn (source over winding resistance)",
        equation="current = (duty - emf) / (1 + ratio * (duty / 100 %)**2): the source feeds only the duty's share",
        acts_on="current",
        stage=30,
        substep_s=0.005,
        commonness=4,
        signature="large steps are slower, steady speeds hardly",
        parameters=(Parameter("ratio", "", 0.1, 0.0, 5.0, step=1e-4),),
        trials=({"ratio": 0.1},),
        source="Battery and wiring resistance; averaged switch model, Erickson and Maksimovic",
        resistance=resistance,
    ),
)
