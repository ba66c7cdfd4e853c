"""Many PWM periods at once, exactly, where nothing but the linear motor and its dry friction acts.

A period is an affine map of speed and current; maps of 2, 4, 8, ... periods are its products. A leap is taken only
where a bound shows that no event can lie inside it: sliding, the speed cannot fall to zero; held, no peak of the
current reaches break-away (while held, the current runs evenly from period to period, so its first and last ones bound
all).
"""

from __future__ import annotations

from firmware_model.circuit import STANDBY
from firmware_model.compiled import part
from firmware_model.layout import CURRENT, MODE, OFF, OMEGA, ON, SIDE, THETA, C
from firmware_model.linear import BUILT
from firmware_model.segments import BODY, ROWS, TABLE, coefficients, row_of

R, L, KT, KE, B = int(C.R), int(C.L), int(C.KT), int(C.KE), int(C.B)
J, COULOMB, SUPPLY, EXTERNAL = int(C.J), int(C.COULOMB), int(C.SUPPLY), int(C.EXTERNAL)
PERIOD = int(C.PERIOD)
POWERS = TABLE + ROWS
LEVELS = 8  # up to 128 periods at once; a task step has 100
WORK_ROWS = POWERS + LEVELS + 2
M11, M12, M21, M22, N1, N2, C1, C2, C3 = range(9)


@part
def forget(w):  # type: ignore[no-untyped-def]
    for level in range(LEVELS):
        w[POWERS + level, BUILT] = 0.0


@part
def compose(a, b, both):  # type: ignore[no-untyped-def]
    """First ``a``, then ``b``, into ``both``: speed and current x' = M x + c, angle turned N x + C3."""
    both[M11] = b[M11] * a[M11] + b[M12] * a[M21]
    both[M12] = b[M11] * a[M12] + b[M12] * a[M22]
    both[M21] = b[M21] * a[M11] + b[M22] * a[M21]
    both[M22] = b[M21] * a[M12] + b[M22] * a[M22]
    both[N1] = a[N1] + b[N1] * a[M11] + b[N2] * a[M21]
    both[N2] = a[N2] + b[N1] * a[M12] + b[N2] * a[M22]
    both[C1] = b[M11] * a[C1] + b[M12] * a[C2] + b[C1]
    both[C2] = b[M21] * a[C1] + b[M22] * a[C2] + b[C2]
    both[C3] = a[C3] + b[N1] * a[C1] + b[N2] * a[C2] + b[C3]


@part
def map_of(row, g1, g2, into):  # type: ignore[no-untyped-def]
    """A segment's exponential with its constant torque and voltage as an affine map."""
    for i in range(4):
        into[i] = row[i]
    into[N1], into[N2] = row[4], row[5]
    into[C1] = row[4] * g1 + row[5] * g2
    into[C2] = row[6] * g1 + row[7] * g2
    into[C3] = row[8] * g1 + row[9] * g2


@part
def build(w, m, p, duty, share, free):  # type: ignore[no-untyped-def]
    """The map of one period."""
    a11, a12, a21, a22, body = coefficients(w, m, p, free)
    g1 = (p[EXTERNAL] - m[SIDE] * p[COULOMB]) / w[BODY, 0] if body != 0 else 0.0
    first, second, whole = w[POWERS + LEVELS], w[POWERS + LEVELS + 1], w[POWERS]
    if share > 0.0:
        g2 = (p[SUPPLY] if duty > 0.0 else -p[SUPPLY]) / p[L]
        map_of(w[row_of(w, ON, share * p[PERIOD], free, body, a11, a12, a21, a22)], g1, g2, first)
    if share < 1.0:
        map_of(w[row_of(w, OFF, (1.0 - share) * p[PERIOD], free, body, a11, a12, a21, a22)], g1, 0.0, second)
    if share <= 0.0:
        for i in range(BUILT):
            whole[i] = second[i]
    elif share >= 1.0:
        for i in range(BUILT):
            whole[i] = first[i]
    else:
        compose(first, second, whole)
    whole[BUILT] = 1.0


@part
def quiet_periods(y, m, p, share, free):  # type: ignore[no-untyped-def]
    """For how many periods the speed keeps its direction: bounds of the current, of the braking, of the loss of speed.

    While the speed lies between 0 and twice its value now, the current lies within what it is and what supply and
    back-emf could drive. Within the time returned the speed does not leave that range.
    """
    speed = y[OMEGA] * m[SIDE]
    if speed <= 0.0:
        return 0.0
    most = abs(y[CURRENT])
    if free:
        most = max(most, ((p[SUPPLY] if share > 0.0 else 0.0) + 2.0 * p[KE] * speed) / p[R])
    elif 2.0 * p[KE] * speed >= p[SUPPLY]:
        return 0.0
    change = (p[KT] * most + 2.0 * p[B] * speed + p[COULOMB] + abs(p[EXTERNAL])) / p[J]
    return 0.9 * speed / (change * p[PERIOD])


@part
def stays_held(y, w, m, p, share, power):  # type: ignore[no-untyped-def]
    """Whether the motor at rest stays so through the periods of a map."""
    peak = w[POWERS + LEVELS]
    level = p[COULOMB]
    start = y[CURRENT]
    last = power[M22] * start + power[C2]
    for current in (start, last):
        if abs(p[KT] * current + p[EXTERNAL]) > level:
            return False
        if share > 0.0 and abs(p[KT] * (peak[M22] * current + peak[C2]) + p[EXTERNAL]) > level:
            return False
    return True


@part
def leap(y, w, m, p, duty, share, most):  # type: ignore[no-untyped-def]
    """Pass up to ``most`` whole periods in one; returns how many, 0 where an event may be near."""
    free = m[MODE] != STANDBY
    if not free and y[CURRENT] != 0.0:
        return 0
    key = 2.0 + m[SIDE]
    if w[POWERS, ROWS - 1] != key or w[POWERS, BUILT] == 0.0:
        forget(w)
        build(w, m, p, duty, share, free)
        w[POWERS, ROWS - 1] = key
    held = m[SIDE] == 0
    quiet = float(most) if held else min(float(most), quiet_periods(y, m, p, share, free))
    level = 0
    while level + 1 < LEVELS and 2 << level <= quiet:
        level += 1
        if w[POWERS + level, BUILT] == 0.0:
            compose(w[POWERS + level - 1], w[POWERS + level - 1], w[POWERS + level])
            w[POWERS + level, BUILT] = 1.0
    if quiet < 1.0:
        return 0
    while held and not stays_held(y, w, m, p, share, w[POWERS + level]):
        level -= 1
        if level < 0:
            return 0
    power = w[POWERS + level]
    omega, current = y[OMEGA], y[CURRENT]
    y[THETA] += power[N1] * omega + power[N2] * current + power[C3]
    y[OMEGA] = power[M11] * omega + power[M12] * current + power[C1]
    y[CURRENT] = power[M21] * omega + power[M22] * current + power[C2]
    return 1 << level
