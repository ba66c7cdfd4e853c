"""What logs can show, and which effects they therefore cannot show or tell apart.

Seen before anything is fitted, from commands and readings alone. An effect that the logs cannot show may be there; that
it was not found says nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

from fiohost.checks.exercised import Exercised, exercise
from fiohost.checks.said import Said
from fiohost.estimation.record import Record
from fiohost.motor.effect import effects

# What it takes to show an effect: few events may be chance, and a slow effect needs its time.
FEW_REVERSALS, FEW_STARTS, FEW_LEVELS, FEW_TURNS = 3, 3, 4, 1.0
LARGE_STEP_PCT, FINE_LEVELS = 50.0, 20
LOW_BAND_HZ, SLOW_S = 3.0, 30.0
LEAST_SLOW_S, LEAST_BRAKING_S = 1.0, 0.2


@dataclass(frozen=True)
class Limit:
    """Effects that the data cannot show, or (``apart``) cannot tell from one another, and why; they ``hardly`` show
    where there is little of what shows them.
    """

    effects: tuple[str, ...]
    apart: bool
    why: str
    hardly: bool = False

    def to_json(self) -> dict[str, object]:
        return {"effects": list(self.effects), "why": self.why}


@dataclass(frozen=True)
class Informative:
    """What was exercised and what follows from it."""

    exercised: Exercised
    limits: tuple[Limit, ...]

    def to_json(self) -> dict[str, object]:
        return {
            **asdict(self.exercised),
            "cannot_show": [x.to_json() for x in self.limits if not x.apart],
            "cannot_tell_apart": [x.to_json() for x in self.limits if x.apart],
        }


def _times(count: int, what: str) -> str:
    return f"{count or 'no'} {what}{'' if count == 1 else 's'}"


Rule = tuple[tuple[str, ...], Callable[[Exercised], bool], Callable[[Exercised], str]]
ON_THE_TURN = ("gravity_load", "cogging_torque", "position_dependent_friction")
TURNING = (*ON_THE_TURN, "encoder_eccentricity")
# What else there is looks like these.
CANNOT_SHOW: Sequence[Rule] = (
    (
        ("asymmetric_coulomb_friction", "asymmetric_deadband", "direction_dependent_gain", "constant_load"),
        lambda d: not d.both_directions,
        lambda d: "one direction only: what differs by direction is taken for friction or gain",
    ),
    (
        ("encoder_eccentricity", "shaft_angle_error"),
        lambda d: not d.angle,
        lambda d: "no angle is measured: what a sensor of it gets wrong does not show",
    ),
    (
        (*ON_THE_TURN, "load_over_position", "friction_over_position"),
        lambda d: d.turns is None,
        lambda d: "readings of the speed are missing: where on its turn the shaft went on is not known",
    ),
    (
        ("parameter_change",),
        lambda d: d.overlapping,
        lambda d: "they do not say when they were begun: what happens once happens in one of them",
    ),
)
# Little shows these; whole runs of few logs may still tell them, with what they look like there.
HARDLY_SHOW: Sequence[Rule] = (
    (
        TURNING,
        lambda d: d.turns is not None and d.turns < FEW_TURNS,
        lambda d: f"{d.turns or 0.0:.2g} turns are covered: what repeats with the turn does not repeat",
    ),
    (
        ("backlash",),
        lambda d: d.reversals < FEW_REVERSALS,
        lambda d: f"{_times(d.reversals, 'reversal')}: play in the gears shows after the shaft turns back",
    ),
    (
        ("static_friction", "presliding_friction"),
        lambda d: d.starts < FEW_STARTS,
        lambda d: f"{_times(d.starts, 'start')} from standstill: break-away shows nowhere else",
    ),
    (
        ("stribeck_friction",),
        lambda d: d.slow_s < LEAST_SLOW_S,
        lambda d: f"{d.slow_s:.1f} s of motion below a tenth of the top speed: friction of slow motion is not seen",
    ),
    (
        ("current_limit", "supply_sag"),
        lambda d: d.largest_step_pct < LARGE_STEP_PCT,
        lambda d: f"no step is larger than {d.largest_step_pct:.3g} %: large currents never flow",
    ),
    (
        ("duty_curve", "quadratic_drag", "voltage_saturation"),
        lambda d: d.levels < FEW_LEVELS,
        lambda d: f"{_times(d.levels, 'level')} of duty: whether the speed grows in proportion cannot be seen",
    ),
    (
        ("pwm_resolution", "duty_steps"),
        lambda d: d.distinct_duties < FINE_LEVELS,
        lambda d: f"{d.distinct_duties} different duties: steps of the duty do not show at a few levels",
    ),
    (
        ("armature_inductance", "shaft_compliance", "transport_delay"),
        lambda d: d.useful_hz is not None and d.useful_hz < LOW_BAND_HZ,
        lambda d: f"the movement stands above the counts up to {d.useful_hz or 0.0:.2g} Hz only: fast lags do not show",
    ),
    (
        ("supply_drift", "armature_heating", "friction_warm_up"),
        lambda d: d.seconds < SLOW_S,
        lambda d: f"{d.seconds:.3g} s in all: slow changes have no time to show",
    ),
    (
        ("gain_warm_up",),
        lambda d: d.overlapping and d.clock_s < SLOW_S,
        lambda d: f"several logs that each begin anew, {d.clock_s:.3g} s at most: what warms up is not seen going on",
    ),
)
CANNOT_TELL: Sequence[Rule] = (
    (
        ("coulomb_friction", "input_deadband", "bridge_voltage_drop"),
        lambda d: d.braking_s < LEAST_BRAKING_S,
        lambda d: "the shaft hardly turns against its command: dry friction, dead zone and bridge drop look the same",
    ),
    (
        ("quadratic_drag", "duty_curve", "voltage_saturation"),
        lambda d: d.levels >= FEW_LEVELS and d.reversals + d.braking_s / LEAST_BRAKING_S < FEW_REVERSALS,
        lambda d: "steady speeds alone: a curve over the speed and one over the duty look the same",
    ),
    (
        ("missed_counts", "quadratic_drag", "duty_curve"),
        lambda d: not d.both_directions,
        lambda d: "no way out and back: lost counts look like a lower speed",
    ),
    (
        ("transport_delay", "armature_inductance", "shaft_compliance"),
        lambda d: d.closed_loop_only,
        lambda d: "closed loop only: the command follows the reading, and lags hide in the loop",
    ),
    (
        ("current_limit", "supply_sag", "load_dependent_friction"),
        lambda d: d.closed_loop_only,
        lambda d: "closed loop only: large commands come with large accelerations and nothing separates the two",
    ),
)


def inform(records: Sequence[Record], said: Sequence[Said], declared: Sequence[str] = ()) -> Informative:
    """What the training logs exercised, and what they cannot show or tell apart beside the ``declared`` effects."""
    seen = exercise(records, said)
    known = effects()
    limits = []
    for rules, apart in ((CANNOT_SHOW, False), (HARDLY_SHOW, False), (CANNOT_TELL, True)):
        for names, lacks, why in rules:
            if lacks(seen):
                # A rule may name what this version's library does not have.
                some = tuple(n for n in names if n in known and (apart or n not in declared))
                some = tuple(n for n in some if seen.rotary or not known[n].angle_bound)
                if len(some) > (1 if apart else 0):
                    limits.append(Limit(some, apart, why(seen), rules is HARDLY_SHOW))
    return Informative(seen, tuple(limits))
