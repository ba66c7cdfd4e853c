"""Free run of a model: from commands and an initial state to angle and speed at given times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from fiohost.motor import kernel
from fiohost.motor.compiled import compiled
from fiohost.motor.effect import effect
from fiohost.motor.events import SPRING
from fiohost.motor.hooks import EFFECT_INDEX
from fiohost.motor.model import Model, slot
from fiohost.motor.state import (
    BACKLASH,
    CONTACT,
    CURRENT,
    FOLLOWING,
    GAP,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    SMALLEST_SHARE,
    STATE_SIZE,
    THETA,
    WARMTH,
    WORK_SIZE,
)

# The effect as which a load of its own acts from each sample to the next.
_LOADED, _LOAD = EFFECT_INDEX["constant_load"], slot("constant_load.level_pct")

# Where a coupling says on which side of it the encoder sits: switch, slots of the side and of the load's share, the
# side beyond it, and whether it is there by its gap, with or without a load.
_COUPLINGS = [
    (
        EFFECT_INDEX[e.name],
        slot(f"{e.name}.side"),
        slot(f"{e.name}.{share}"),
        next(i for i, c in enumerate(e.parameter("side").choices) if c.startswith("encoder_after")),
        e.name == "backlash",
    )
    for e, share in ((effect("backlash"), "load_inertia_ratio"), (effect("shaft_compliance"), "inertia_ratio"))
]


# A change of speed of which no more than this share is left after a sample is gone, and its current with it.
LASTING = 0.1


@dataclass(frozen=True)
class Excitation:
    """What acted on the motor and when it was looked at.

    ``times_s`` (n): sample times. ``act_times_s`` (m): when each command begins to act. ``duties_pct``, ``modes`` (m
    + 1): signed duty and mode (1 drive, 2 brake, 0 standby), the first entry being what acted before the first command.
    ``clock_s`` is the bench's own time at sample time zero, for what drifts.
    """

    times_s: np.ndarray
    act_times_s: np.ndarray
    duties_pct: np.ndarray
    modes: np.ndarray
    clock_s: float = 0.0


class Start(NamedTuple):
    """How a run begins: the angle that the encoder sees, the speed, where in a gap the motor stands, -1 to 1, how much
    faster than the motor a load free in the gap drifts, and how warm winding or bearings are, 0 to 1.

    ``zero`` is where on the bench's turn the run's angle is zero, in degrees; None: where the bench's is, or unknown.
    """

    angle: float
    speed: float
    play: float = 0.0
    drift: float = 0.0
    warmth: float = 0.0
    zero: float | None = None


def seen_angle(p: np.ndarray, on: np.ndarray) -> int:
    """Which angle of the state the encoder sees: the load's where it sits after a gap, else the motor's."""
    for index, side, share, after, gap in _COUPLINGS:
        if on[index] and p[side] == after and (p[GAP] > 0.0 if gap else p[share] >= SMALLEST_SHARE):
            return LOAD_THETA
    return THETA


def start_state(start: Start, p: np.ndarray, on: np.ndarray) -> np.ndarray:
    """The kernel's state at a start, the gap between motor and load taken up by ``play``."""
    state = np.zeros(STATE_SIZE)
    lead = 0.5 * p[GAP] * start.play if on[BACKLASH] else 0.0
    state[THETA] = state[LOAD_THETA] = start.angle
    if seen_angle(p, on) == THETA:
        state[LOAD_THETA] -= lead
    else:
        state[THETA] += lead
    state[OMEGA] = start.speed
    state[WARMTH] = start.warmth
    state[list(FOLLOWING)] = start.speed
    state[LOAD_OMEGA] = start.speed + start.drift
    state[CONTACT] = start.play if abs(start.play) == 1.0 and start.drift == 0.0 else 0.0
    return state


def run(
    excitation: Excitation,
    p: np.ndarray,
    on: np.ndarray,
    substep_s: float,
    state: np.ndarray,
    first: int = 0,
    last: int | None = None,
) -> np.ndarray:
    """States (last - first, STATE_SIZE) at the sample times, from ``state`` at ``times_s[first]``; it is left
    untouched.
    """
    last = len(excitation.times_s) if last is None else last
    states = np.empty((last - first, STATE_SIZE))
    kernel.simulate(
        excitation.times_s,
        excitation.act_times_s,
        excitation.duties_pct,
        excitation.modes,
        excitation.clock_s,
        first,
        last,
        np.concatenate((state, np.zeros(WORK_SIZE - STATE_SIZE))),
        substep_s,
        p,
        on,
        states,
    )
    return states


def run_loaded(
    excitation: Excitation,
    p: np.ndarray,
    on: np.ndarray,
    substep_s: float,
    state: np.ndarray,
    loads_pct: np.ndarray,
    first: int = 0,
    last: int | None = None,
) -> np.ndarray:
    """``run`` with a load (last - first) of its own from each sample to the next, beside what the model has; positive
    where it opposes forward motion.
    """
    ex, last = excitation, len(excitation.times_s) if last is None else last
    states = np.empty((last - first, STATE_SIZE))
    p, loads = p.copy(), loads_pct + (p[_LOAD] if on[_LOADED] else 0.0)
    on = on.copy()
    on[_LOADED] = True
    states[0], work = state, np.concatenate((state, np.zeros(WORK_SIZE - STATE_SIZE)))
    _run_loaded(
        ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, first, last, loads, work, substep_s, p, on,
        states,
    )  # fmt: skip
    return states


@compiled
def _run_loaded(  # type: ignore[no-untyped-def]
    times, act_times, duties, modes, clock, first, last, loads, state, substep, p, on, states
):
    for i in range(first, last - 1):
        p[_LOAD] = loads[i - first]
        at = states[i - first : i - first + 2]
        kernel.simulate(times, act_times, duties, modes, clock, i, i + 2, state, substep, p, on, at)


def speed_kept(
    excitation: Excitation,
    p: np.ndarray,
    on: np.ndarray,
    substep_s: float,
    states: np.ndarray,
    step_deg_s: float,
    first: int,
) -> np.ndarray:
    """Which share (n - 1) of a small change of speed is there one sample later, along a run's ``states`` (n,
    STATE_SIZE) from sample ``first`` on. Motor and load are changed together, and the current as a change of speed that
    is there for longer has changed it: at once the winding's lag would hide that the current brakes it, and a spring
    between both that the load drives the motor on.
    """
    ex, kept = excitation, np.empty(len(states) - 1)
    _speed_kept(
        ex.times_s, ex.act_times_s, ex.duties_pct, ex.modes, ex.clock_s, first, states, step_deg_s,
        np.empty(WORK_SIZE), substep_s, p, on, np.empty((2, STATE_SIZE)), kept,
    )  # fmt: skip
    return kept


@compiled
def _speed_kept(  # type: ignore[no-untyped-def]
    times, act_times, duties, modes, clock, first, states, step, state, substep, p, on, at, kept
):
    kind, share, _, _, _, _ = kernel.joint_of(p, on)
    of_load, by_speed = share if kind == SPRING else 0.0, 0.0
    for i in range(states.shape[0] - 1):
        for k in range(WORK_SIZE):
            state[k] = states[i, k] if k < STATE_SIZE else 0.0
        state[OMEGA] += step
        state[LOAD_OMEGA] += step
        state[CURRENT] += by_speed * step
        kernel.simulate(
            times, act_times, duties, modes, clock, first + i, first + i + 2, state, substep, p, on, at
        )  # fmt: skip
        left = at[1, OMEGA] - states[i + 1, OMEGA]
        left += of_load * (at[1, LOAD_OMEGA] - states[i + 1, LOAD_OMEGA] - left)
        kept[i] = left / step
        by_speed = (at[1, CURRENT] - states[i + 1, CURRENT]) / left if left > LASTING * step else 0.0


def free_run(model: Model, excitation: Excitation, theta_deg: float, omega_deg_s: float = 0.0) -> np.ndarray:
    """Angle (n) of the shaft as the encoder would see it without quantisation, in degrees."""
    p, on = model.vector(), model.switches()
    states = run(excitation, p, on, model.substep_s(), start_state(Start(theta_deg, omega_deg_s), p, on))
    return np.asarray(states[:, seen_angle(p, on)])
