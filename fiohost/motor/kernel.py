"""The simulation kernel: from commands to states, by exact steps between events.

Between events the drive is constant, so speed and angle follow closed forms. Where a torque depends on the state, the
step is cut to ``substep`` and the torque is taken at the midpoint. A step ends where the speed crosses zero; there the
shaft rests while drive minus load stays within break-away. Without state-dependent torques a whole hold is one exact
step. Nothing is regularised.

Units: degrees (or the unit of a linear axis), seconds, percent of duty.
"""

from __future__ import annotations

import numpy as np

from fiohost.motor.compiled import compiled
from fiohost.motor.gap import advance_gap
from fiohost.motor.hooks import command
from fiohost.motor.lagged import advance_lagged
from fiohost.motor.rigid import advance
from fiohost.motor.spring import advance_spring
from fiohost.motor.state import (
    BACKLASH,
    CHANGE_ON,
    CHANGE_TIME,
    DELAY,
    DELAY_ON,
    FAST_ON,
    GAP,
    LAG,
    LAG_ON,
    SHARE,
    SMALLEST_LAG_S,
    SMALLEST_SHARE,
    SPRING_ON,
    SPRING_SHARE,
    STATE_SIZE,
)


@compiled
def simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states):  # type: ignore[no-untyped-def]
    """Simulate samples ``first..last`` of a record from ``state``; ``states[k - first]`` is the state at ``times[k]``.

    ``duties[0]`` and ``modes[0]`` are what acted before the first row's command; ``act_times[j]`` is when
    ``duties[j+1]`` begins to act, before any transport delay of the model. ``substep`` 0 takes each hold in one exact
    step.
    """
    delay = p[DELAY] if on[DELAY_ON] else 0.0
    gap = on[BACKLASH] and p[GAP] > 0.0
    spring = on[SPRING_ON] and p[SPRING_SHARE] >= SMALLEST_SHARE
    switch = p[CHANGE_TIME] - clock if on[CHANGE_ON] else -1.0
    two = gap and p[SHARE] >= SMALLEST_SHARE
    play = 0.5 * p[GAP] if gap else 0.0
    lagged = (on[LAG_ON] and p[LAG] >= SMALLEST_LAG_S) or on[FAST_ON]
    now = times[first]
    j = np.searchsorted(act_times, now - delay, side="right")
    duty = command(duties[j], p, on)
    for i in range(STATE_SIZE):
        states[0, i] = state[i]
    n = act_times.shape[0]
    for k in range(first + 1, last):
        while now < times[k]:
            until = times[k]
            changes = j < n and act_times[j] + delay < until
            if changes:
                until = max(act_times[j] + delay, now)
            if now < switch < until:
                until, changes = switch, False
            if until > now:
                if two:
                    advance_gap(state, duty, modes[j], clock + now, until - now, substep, p, on)
                elif spring:
                    advance_spring(state, duty, modes[j], clock + now, until - now, substep, p, on)
                elif lagged:
                    advance_lagged(state, duty, modes[j], clock + now, until - now, substep, play, p, on)
                else:
                    advance(state, duty, modes[j], clock + now, until - now, substep, play, p, on)
            now = until
            if changes:
                j += 1
                duty = command(duties[j], p, on)
        for i in range(STATE_SIZE):
            states[k - first, i] = state[i]
