"""Reverse gain over forward gain."""

from fiohost.motor.effect import Effect, Parameter


def voltage(volts_pct, duty_pct, time_s, z, q):  # type: ignore[no-untyped-def]
    return volts_pct if duty_pct > 0.0 else volts_pct * q[0]


EFFECTS = (
    Effect(
        name="direction_dependent_gain",
        summary="reverse gain over forward gain",
        equation="voltage = duty forward, ratio * duty in reverse",
        acts_on="current",
        signature="steady speeds differ by direction in proportion to the duty",
        parameters=(Parameter("ratio", "", 0.95, 0.2, 5.0, neutral=1.0, step=1e-4),),
        trials=({"ratio": 0.95},),
        source="Unequal halves of a bridge; brush timing",
        voltage=voltage,
    ),
)
