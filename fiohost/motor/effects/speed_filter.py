"""The speed is smoothed before it is logged."""

from fiohost.motor.effect import Effect, Parameter

SHORTEST_S = 1e-5


def smoothed(shown_deg_s, z, q):  # type: ignore[no-untyped-def]
    return z if q[0] >= SHORTEST_S else shown_deg_s


def rate(z, omega_deg_s, current_pct, q):  # type: ignore[no-untyped-def]
    lag_s = max(q[0], SHORTEST_S)
    return omega_deg_s / lag_s, 1.0 / lag_s


EFFECTS = (
    Effect(
        name="speed_filter",
        summary="speed that a filter smooths before it is logged",
        equation="time_constant * d(reading)/dt = omega - reading; an average that keeps a share b of itself from each "
        "step of its loop to the next has time_constant = -step / ln b",
        acts_on="measurement",
        stage=-10,
        substep_s=0.002,
        commonness=3,
        signature="speeds that lag the shaft after every change, at the end of each slowing too; nothing in angles",
        parameters=(Parameter("time_constant_s", "s", 0.02, 0.0, 2.0, step=1e-4),),
        trials=tuple({"time_constant_s": t} for t in (0.01, 0.03, 0.1)),
        source="Moving averages of encoder speeds; Franklin, Powell, Workman, Digital Control of Dynamic Systems",
        measure_speed=smoothed,
        rate=rate,
    ),
)
