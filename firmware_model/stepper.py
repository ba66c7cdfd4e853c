"""Integration between events: Dormand and Prince's pair of orders 5 and 4; events are located by bisection.

The step adapts itself, so a winding's milliseconds, a bristle's stiffness and a minute's warming need no setting. The
event within a step is looked for on the step's own interpolant, then met by a true step up to there.
"""

from __future__ import annotations

from firmware_model.compiled import part
from firmware_model.events import broken, settle
from firmware_model.layout import CURRENT, EVENTS, LOAD_OMEGA, OMEGA, STATES, STEPS, STRIDE, TIME
from firmware_model.physics import rates

LONGEST_S = 0.005
SHORTEST_S = 1e-9
FINEST_S = 1e-11  # to which an event is known: at full speed less than a step may err
ROUNDS, FINER = 4, 2.0**-16

# Error allowed in one step, per state: rad, rad/s, A; anything else is scaled like an angle.
ANGLE_RAD = 2e-10
SPEED_RAD_S = 2e-8
CURRENT_A = 2e-8


@part
def move(time, y, h, w, m, duty, p, on):  # type: ignore[no-untyped-def]
    """One step of h from y into w[8]; w[1] holds the rates at y. Returns the end time."""
    n = m[STATES]
    for i in range(n):
        w[0, i] = y[i] + h * (0.2 * w[1, i])
    rates(time + 0.2 * h, w[0], w[2], m, duty, p, on)
    for i in range(n):
        w[0, i] = y[i] + h * (3.0 / 40.0 * w[1, i] + 9.0 / 40.0 * w[2, i])
    rates(time + 0.3 * h, w[0], w[3], m, duty, p, on)
    for i in range(n):
        w[0, i] = y[i] + h * (44.0 / 45.0 * w[1, i] - 56.0 / 15.0 * w[2, i] + 32.0 / 9.0 * w[3, i])
    rates(time + 0.8 * h, w[0], w[4], m, duty, p, on)
    for i in range(n):
        w[0, i] = y[i] + h * (
            19372.0 / 6561.0 * w[1, i]
            - 25360.0 / 2187.0 * w[2, i]
            + 64448.0 / 6561.0 * w[3, i]
            - 212.0 / 729.0 * w[4, i]
        )
    rates(time + 8.0 / 9.0 * h, w[0], w[5], m, duty, p, on)
    for i in range(n):
        w[0, i] = y[i] + h * (
            9017.0 / 3168.0 * w[1, i]
            - 355.0 / 33.0 * w[2, i]
            + 46732.0 / 5247.0 * w[3, i]
            + 49.0 / 176.0 * w[4, i]
            - 5103.0 / 18656.0 * w[5, i]
        )
    rates(time + h, w[0], w[6], m, duty, p, on)
    for i in range(n):
        w[8, i] = y[i] + h * (
            35.0 / 384.0 * w[1, i]
            + 500.0 / 1113.0 * w[3, i]
            + 125.0 / 192.0 * w[4, i]
            - 2187.0 / 6784.0 * w[5, i]
            + 11.0 / 84.0 * w[6, i]
        )


@part
def error(h, w, n):  # type: ignore[no-untyped-def]
    """Largest error of the step in units of what is allowed; w[7] holds the rates at its end."""
    worst = 0.0
    for i in range(n):
        e = h * (
            71.0 / 57600.0 * w[1, i]
            - 71.0 / 16695.0 * w[3, i]
            + 71.0 / 1920.0 * w[4, i]
            - 17253.0 / 339200.0 * w[5, i]
            + 22.0 / 525.0 * w[6, i]
            - 1.0 / 40.0 * w[7, i]
        )
        allowed = ANGLE_RAD
        if i in (OMEGA, LOAD_OMEGA):
            allowed = SPEED_RAD_S
        elif i == CURRENT:
            allowed = CURRENT_A
        worst = max(worst, abs(e) / allowed)
    return worst


@part
def interpolate(y, h, w, n):  # type: ignore[no-untyped-def]
    """Coefficients of the step's interpolant of order 4, into w[2] to w[5]; w[1] to w[7] hold its rates, w[8] its end.

    Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, section II.6.
    """
    for i in range(n):
        whole = w[8, i] - y[i]
        first = h * w[1, i] - whole
        second = whole - h * w[7, i] - first
        third = h * (
            -12715105075.0 / 11282082432.0 * w[1, i]
            + 87487479700.0 / 32700410799.0 * w[3, i]
            - 10690763975.0 / 1880347072.0 * w[4, i]
            + 701980252875.0 / 199316789632.0 * w[5, i]
            - 1453857185.0 / 822651844.0 * w[6, i]
            + 69997945.0 / 29380423.0 * w[7, i]
        )
        w[2, i], w[3, i], w[4, i], w[5, i] = whole, first, second, third


@part
def between(y, share, w, n):  # type: ignore[no-untyped-def]
    """The state at a share 0..1 of the interpolated step, into w[0]."""
    rest = 1.0 - share
    for i in range(n):
        w[0, i] = y[i] + share * (w[2, i] + rest * (w[3, i] + share * (w[4, i] + rest * w[5, i])))


@part
def meet_event(y, r, h, w, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Carry y and the time to just beyond the first event in the step of h, whose end lies beyond it.

    The interpolant tells where. If the true step up to there ends short of the event, the little that is missing is
    done in the same way, in a step so short that its interpolant is as good as the step.
    """
    n = m[STATES]
    time = r[TIME]
    for _ in range(ROUNDS):
        interpolate(y, h, w, n)
        low, high = 0.0, 1.0
        while (high - low) * h > FINEST_S:
            middle = 0.5 * (low + high)
            between(y, middle, w, n)
            if broken(time + middle * h, w[0], m, duty, p, on):
                high = middle
            else:
                low = middle
        move(time, y, high * h, w, m, duty, p, on)
        time += high * h
        left = h - high * h
        for i in range(n):
            y[i] = w[8, i]
        if left <= 0.0 or broken(time, y, m, duty, p, on):
            break
        rates(time, y, w[1], m, duty, p, on)
        h *= FINER
        while True:
            h = min(h, left)
            move(time, y, h, w, m, duty, p, on)
            if h >= left or broken(time + h, w[8], m, duty, p, on):
                break
            h *= 8.0
        rates(time + h, w[8], w[7], m, duty, p, on)
    r[TIME] = time


@part
def advance_step(y, r, m, w, until, p, on, duty, fresh):  # type: ignore[no-untyped-def]
    """One accepted step towards ``until``; True where it ended at an event and the rates must be taken anew."""
    n = m[STATES]
    time = r[TIME]
    if fresh:
        rates(time, y, w[1], m, duty, p, on)
    left = until - time
    stride = r[STRIDE]
    while True:
        h = min(stride, left)
        move(time, y, h, w, m, duty, p, on)
        rates(time + h, w[8], w[7], m, duty, p, on)
        worst = error(h, w, n)
        m[STEPS] += 1
        if worst <= 1.0 or h <= SHORTEST_S:
            break
        stride = h * max(0.2, 0.9 * worst**-0.2)
    grown = h * min(4.0, 0.9 * max(worst, 1e-8) ** -0.2)
    r[STRIDE] = min(LONGEST_S, grown if h < left or worst > 0.1 else max(grown, stride))
    if not broken(time + h, w[8], m, duty, p, on):
        for i in range(n):
            y[i] = w[8, i]
            w[1, i] = w[7, i]
        r[TIME] = until if h >= left else time + h
        return False
    meet_event(y, r, h, w, m, duty, p, on)
    if until - r[TIME] <= 0.0:
        r[TIME] = until
    m[EVENTS] += 1
    settle(r[TIME], y, m, duty, p, on)
    return True
