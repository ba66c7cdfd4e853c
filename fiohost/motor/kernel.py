"""The simulation kernel: from commands to states, by exact steps between events.

Between events each regime is linear, so speed, angle and current follow closed forms. Where a torque depends on the
state, the step is cut to ``substep`` and the torque is taken at the midpoint. A step ends at an event: where the speed
crosses zero (there the shaft rests while drive minus load stays within break-away), at an end of travel, where play
closes or opens, where a current ceases. Without state-dependent torques a whole hold is one exact step. Nothing is
regularised.

Units: degrees (or the unit of a linear axis), seconds, percent of duty.
"""

from __future__ import annotations

from math import inf
from typing import Any

import numpy as np

from fiohost.motor.body import asked, glide, is_steady, slide
from fiohost.motor.compiled import compiled, inlined
from fiohost.motor.electrics import is_simple, losses, winding_lag
from fiohost.motor.events import PLAY, RIGID, SPRING
from fiohost.motor.flow import SAME_TIME_S
from fiohost.motor.hooks import (
    PERIOD,
    bristles,
    command,
    coupling,
    delay,
    ends,
    load,
    next_moment,
    remembers,
    torque,
    voltage,
)
from fiohost.motor.state import GAIN, HELD, SMALLEST_SHARE, STATE_SIZE, TAU
from fiohost.motor.step import stepper


@inlined
def joint_of(p, on):  # type: ignore[no-untyped-def]
    """What joins the load: kind, share of the inertia, half the gap, stiffness, damping, and the whole inertia, in
    percent of duty, degrees and seconds.
    """
    share, half_gap, stiff, damp = coupling(p, on)
    mass = p[TAU] / p[GAIN]
    if share < SMALLEST_SHARE:
        return RIGID, 0.0, half_gap, 0.0, 0.0, mass
    if stiff > 0.0:
        return SPRING, share, half_gap, stiff * mass, damp * mass, mass
    if half_gap > 0.0:
        return PLAY, share, half_gap, 0.0, 0.0, mass
    return RIGID, 0.0, 0.0, 0.0, 0.0, mass


def _over(advance: Any, steady: bool = False, body: bool = False) -> Any:
    """The loop over samples and commands, with a step of the motor."""

    @inlined
    def run(times, act_times, duties, modes, clock, first, last, x, substep, joint, lag, lost, p, on, states):  # type: ignore[no-untyped-def]
        late, n = delay((), p, on), act_times.shape[0]
        now = times[first]
        has = asked(joint, clock + now, x, p, on)
        change = next_moment(clock + now, p, on) - clock
        j = np.searchsorted(act_times, now - late, side="right")
        acts = act_times[j] + late if j < n else inf
        duty, mode = command(duties[j], (p[PERIOD],), p, on), modes[j]
        if steady:
            volts, at = voltage(duty, (duty, clock + now), x, 0, p, on), (0.0, 0.0, clock + now)
            force = torque(at, p, on) + load(at, p, on)
        for i in range(STATE_SIZE):
            states[0, i] = x[i]
        for k in range(first + 1, last):
            while now < times[k]:
                until = times[k]
                changes = acts < until
                if changes:
                    until = max(acts, now)
                if change < until:
                    until, changes = change, False
                if until - now > SAME_TIME_S:  # rounding alone is no span
                    if steady:
                        advance(x, volts, mode, until - now, force, has)
                    elif body:
                        advance(x, duty, mode, clock + now, until - now, substep, lost, has, p, on)
                    else:
                        advance(x, duty, mode, clock + now, until - now, substep, joint[0], lag, lost, has, p, on)
                now = until
                if now >= change:
                    change = next_moment(clock + now, p, on) - clock
                    change = change if change > now else inf
                    has = asked(joint, clock + now, x, p, on)
                    if steady:
                        volts, at = voltage(duty, (duty, clock + now), x, 0, p, on), (0.0, 0.0, clock + now)
                        force = torque(at, p, on) + load(at, p, on)
                if changes:
                    j += 1
                    acts = act_times[j] + late if j < n else inf
                    if duties[j] != duties[j - 1] or modes[j] != mode:
                        x[HELD] = 0.0
                        duty, mode = command(duties[j], (p[PERIOD],), p, on), modes[j]
                        if steady:
                            volts = voltage(duty, (duty, clock + now), x, 0, p, on)
            for i in range(STATE_SIZE):
                states[k - first, i] = x[i]

    return run


_steady = _over(glide, steady=True)
_body = _over(slide, body=True)
_one = _over(stepper(two=False, more=False, special=False))
_two = _over(stepper(two=True, more=False, special=False))
_open = _over(stepper(two=False, more=False, special=True))
_all = _over(stepper(two=True, more=True, special=True))


@compiled
def simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states):  # type: ignore[no-untyped-def]
    """Simulate samples ``first..last`` of a record from ``state``; ``states[k - first]`` is the state at ``times[k]``.

    ``duties[0]`` and ``modes[0]`` are what acted before the first row's command; ``act_times[j]`` is when
    ``duties[j+1]`` begins to act, before any transport delay of the model. ``substep`` 0 takes each hold in one exact
    step.
    """
    joint, lag, lost = joint_of(p, on), winding_lag(p, on), losses(p, on)
    more = remembers(on) or ends(on) or bristles(on) or lost[0] > 0.0 or lost[1] < inf or lost[2] or lost[3] or lost[4]
    begin = np.searchsorted(act_times, times[first] - delay((), p, on), side="right")
    simple = is_simple(lag, lost, modes[begin:], act_times[begin:], times[last - 1])
    rigid = joint[0] == RIGID
    if rigid and lag == 0.0 and is_steady(substep, on):
        _steady(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
    elif rigid and lag == 0.0:
        _body(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
    elif rigid and not simple and not (remembers(on) or ends(on) or bristles(on) or lost[3] or lost[4]):
        _open(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
    elif rigid and simple and not more:
        _one(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
    elif more or not simple:
        _all(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
    else:
        _two(times, act_times, duties, modes, clock, first, last, state, substep, joint, lag, lost, p, on, states)
