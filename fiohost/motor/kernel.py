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

import numpy as np

from fiohost.motor.compiled import compiled, inlined
from fiohost.motor.electrics import winding_lag
from fiohost.motor.events import PLAY, RIGID, SPRING
from fiohost.motor.hooks import PERIOD, command, coupling, delay, ends, next_moment, remembers, winds
from fiohost.motor.state import GAIN, HELD, SMALLEST_SHARE, STATE_SIZE, TAU
from fiohost.motor.step import advance


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


@compiled
def simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states):  # type: ignore[no-untyped-def]
    """Simulate samples ``first..last`` of a record from ``state``; ``states[k - first]`` is the state at ``times[k]``.

    ``duties[0]`` and ``modes[0]`` are what acted before the first row's command; ``act_times[j]`` is when
    ``duties[j+1]`` begins to act, before any transport delay of the model. ``substep`` 0 takes each hold in one exact
    step.
    """
    late = delay((), p, on)
    joint, lag, has = joint_of(p, on), winding_lag(p, on), (winds(on), remembers(on), ends(on))
    now = times[first]
    change = next_moment(clock + now, p, on) - clock
    j = np.searchsorted(act_times, now - late, side="right")
    duty = command(duties[j], (p[PERIOD],), p, on)
    for i in range(STATE_SIZE):
        states[0, i] = state[i]
    n = act_times.shape[0]
    for k in range(first + 1, last):
        while now < times[k]:
            until = times[k]
            changes = j < n and act_times[j] + late < until
            if changes:
                until = max(act_times[j] + late, now)
            if change < until:
                until, changes = change, False
            if until > now:
                advance(state, duty, modes[j], clock + now, until - now, substep, joint, lag, has, p, on)
            now = until
            if now >= change:
                change = next_moment(clock + now, p, on) - clock
                change = change if change > now else inf
            if changes:
                if duties[j + 1] != duties[j] or modes[j + 1] != modes[j]:
                    state[HELD] = 0.0
                j += 1
                duty = command(duties[j], (p[PERIOD],), p, on)
        for i in range(STATE_SIZE):
            states[k - first, i] = state[i]
