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

from numba import types

from fiohost.motor.body import asked, glide, is_steady
from fiohost.motor.compiled import inlined, part, shared
from fiohost.motor.electrics import is_simple, losses, winding_lag
from fiohost.motor.events import PLAY, RIGID, SPRING
from fiohost.motor.flow import SAME_TIME_S
from fiohost.motor.hooks import (
    FIXED_STATES,
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
from fiohost.motor.state import (
    CONTACT,
    CURRENT,
    GAIN,
    HELD,
    LOAD_OMEGA,
    LOAD_THETA,
    OMEGA,
    SMALLEST_SHARE,
    STATE_SIZE,
    TAU,
    THETA,
)
from fiohost.motor.step import advance

# How a motor steps: over a whole hold, or from event to event.
GLIDE, STEP = range(2)


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


@part
def _acting(act_times, now):  # type: ignore[no-untyped-def]
    """How many commands have begun to act, by bisection."""
    low, high = 0, act_times.shape[0]
    while low < high:
        middle = (low + high) >> 1
        if act_times[middle] <= now:
            low = middle + 1
        else:
            high = middle
    return low


@inlined
def _written(at, x, to):  # type: ignore[no-untyped-def]
    """Write a state, and the effects' own in ``x``, to an array."""
    to[THETA], to[OMEGA], to[LOAD_THETA], to[LOAD_OMEGA], to[CONTACT], to[CURRENT], to[HELD] = at
    for i in range(FIXED_STATES, STATE_SIZE):
        to[i] = x[i]


@inlined
def _held(duty, time, x, p, on):  # type: ignore[no-untyped-def]
    """Voltage and torque where both stay over a hold."""
    at = 0.0, 0.0, time
    return voltage(duty, (duty, time), x, 0, p, on), torque(at, p, on) + load(at, p, on)


@inlined
def _run(  # type: ignore[no-untyped-def]
    way, kind, more, special, times, act_times, duties, modes, clock, first, last, x, substep, joint, lag, lost, p, on,
    states,
):  # fmt: skip
    """The loop over samples and commands. The first four arguments are constants, each set of which makes code of its
    own: how the motor steps, and what ``step.advance`` has to know.
    """
    late, n = delay((), p, on), act_times.shape[0]
    now = times[first]
    has = asked(joint, clock + now, x, p, on)
    change = next_moment(clock + now, p, on) - clock
    j = _acting(act_times, now - late)
    acts = act_times[j] + late if j < n else inf
    duty, mode = command(duties[j], (p[PERIOD],), p, on), modes[j]
    if way == GLIDE:
        volts, force = _held(duty, clock + now, x, p, on)
    at = x[THETA], x[OMEGA], x[LOAD_THETA], x[LOAD_OMEGA], x[CONTACT], x[CURRENT], x[HELD]
    _written(at, x, states[0])
    for k in range(first + 1, last):
        while now < times[k]:
            if acts <= now:
                j += 1
                acts = act_times[j] + late if j < n else inf
                if duties[j] != duties[j - 1] or modes[j] != mode:
                    at = at[:-1] + (0.0,)  # noqa: RUF005 (numba knows no star)
                    duty, mode = command(duties[j], (p[PERIOD],), p, on), modes[j]
                    if way == GLIDE:
                        volts = voltage(duty, (duty, clock + now), x, 0, p, on)
                continue
            until = min(times[k], acts, change)
            if until - now > SAME_TIME_S:  # rounding alone is no span
                if way == GLIDE:
                    at = glide(at, x, volts, mode, until - now, force, has)
                else:
                    at = advance(
                        at, x, duty, mode, clock + now, until - now, substep, kind, lag, lost, has, more, special,
                        p, on,
                    )  # fmt: skip
            now = until
            if now >= change:
                change = next_moment(clock + now, p, on) - clock
                change = change if change > now else inf
                has = asked(joint, clock + now, x, p, on)
                if way == GLIDE:
                    volts, force = _held(duty, clock + now, x, p, on)
        _written(at, x, states[k - first])
    _written(at, x, x)


_series, _flags = types.float64[::1], types.boolean[::1]
SIGNATURE = types.none(
    _series, _series, _series, types.int64[::1], types.float64, types.int64, types.int64, _series, types.float64,
    _series, _flags, types.float64[:, ::1],
)  # fmt: skip


@shared(SIGNATURE)
def simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states):  # type: ignore[no-untyped-def]
    """Simulate samples ``first..last`` of a record from ``state``; ``states[k - first]`` is the state at ``times[k]``.

    ``duties[0]`` and ``modes[0]`` are what acted before the first row's command; ``act_times[j]`` is when
    ``duties[j+1]`` begins to act, before any transport delay of the model. ``substep`` 0 takes each hold in one exact
    step.
    """
    joint, lag, lost = joint_of(p, on), winding_lag(p, on), losses(p, on)
    keeps = remembers(on) or ends(on) or bristles(on)
    varies = lost[3] or lost[4]
    more = keeps or varies or lost[0] > 0.0 or lost[1] < inf or lost[2]
    begin = _acting(act_times, times[first] - delay((), p, on))
    simple = is_simple(lag, lost, modes[begin:], act_times[begin:], times[last - 1])
    rigid, spring = joint[0] == RIGID, joint[0] == SPRING
    run = times, act_times, duties, modes, clock, first, last, state, substep, joint
    of = lost, p, on, states
    # Each branch is code of its own: what is a constant in it is left out of its steps.
    if rigid and lag == 0.0 and is_steady(substep, on):
        _run(GLIDE, RIGID, False, False, *run, 0.0, *of)
    elif rigid and not simple and not (keeps or varies):
        _run(STEP, RIGID, False, True, *run, lag, *of)
    elif not simple or (more and not (rigid and lag == 0.0)):
        _run(STEP, joint[0], True, True, *run, lag, *of)
    elif rigid and more:
        _run(STEP, RIGID, True, False, *run, 0.0, *of)
    elif rigid and lag == 0.0:
        _run(STEP, RIGID, False, False, *run, 0.0, *of)
    elif rigid:
        _run(STEP, RIGID, False, False, *run, lag, *of)
    elif spring:
        _run(STEP, SPRING, False, False, *run, lag, *of)
    elif lag == 0.0:
        _run(STEP, PLAY, False, False, *run, 0.0, *of)
    else:
        _run(STEP, PLAY, False, False, *run, lag, *of)
