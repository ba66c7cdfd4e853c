"""The supply falls with the current drawn."""

from fiohost.motor.effect import Effect, Parameter

SMOOTHING = ("capacitor", "none")


def resistance(ohms, duty_pct, z, q):  # type: ignore[no-untyped-def]
    share = abs(duty_pct) * 0.01
    return ohms + q[0] * (share * share if q[1] == 0.0 else share)


EFFECTS = (
    Effect(
        name="supply_sag",
        summary="supply falls with current drawn (source over winding resistance)",
        equation="current = (duty - emf) / (1 + ratio * d**2), d = |duty| / 100 %, where a capacitor at the bridge "
        "smooths what the source gives; (duty - emf) / (1 + ratio * d) where the source gives each pulse itself",
        acts_on="current",
        stage=30,
        substep_s=0.005,
        steps_a_lag=4.0,
        commonness=4,
        signature="large steps are slower, steady speeds hardly",
        parameters=(
            Parameter("ratio", "", 0.1, 0.0, 5.0, step=1e-4),
            Parameter("smoothing", "", SMOOTHING[0], neutral=None, choices=SMOOTHING),
        ),
        trials=tuple({"ratio": 0.1, "smoothing": s} for s in SMOOTHING),
        source="Battery and wiring resistance; averaged switch model, Erickson and Maksimovic",
        resistance=resistance,
    ),
)
