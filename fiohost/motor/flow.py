"""The linear flow of each regime: speeds, current and twist after a time, under torques and voltages held constant.

With ``J = tau/K`` the inertia in percent of duty per deg/s2, ``d`` the voltage and ``f`` the other torques in percent:

    one body       J omega' = i + f,                i = d - omega/K, or lag i' = d - omega/K - ohms i
    spring closed  Jm omega' = i + f - T,  Jl v' = g + T,  twist' = omega - v,  T = k twist + c (omega - v)

One body has a closed form with one or two poles. Two bodies on a spring are four states ``x' = A x + b``; their
``exp(A t)`` and its two integrals are summed as series over a short time and doubled (scaling and squaring; Moler and
Van Loan 2003). What was computed for the last span of a kind is kept beside the state, as most steps are equally long.
"""

from __future__ import annotations

from math import cos, exp, expm1, log1p, sin, sqrt

from fiohost.motor.compiled import inlined, part
from fiohost.motor.state import ONE_BODY, SCRATCH, TWO_BODIES

SAME_TIME_S = 1e-12
N = 4
SHORT = 0.5  # of the norm of A t, for which the series is summed
TERMS = 14
# In the scratch: the matrix A, a term of the series, what is done with it, and the three sums. Their places are known
# when it is compiled, so nothing is asked about an index.
SQUARE = N * N
MATRIX, TERM, SPARE, FLOW, ONCE, TWICE = (SCRATCH + SQUARE * i for i in range(6))


@part
def _swing(dt, tau, lag, ohms):  # type: ignore[no-untyped-def]
    """exp(a dt) cosh(b dt) and exp(a dt) sinh(b dt) / b for the poles a +- b of current and speed."""
    a = -0.5 * ohms / lag
    square = a * a - 1.0 / (tau * lag)
    if square > 1e-6 * a * a:
        b = sqrt(square)
        fast, slow = exp((a - b) * dt), exp((a + b) * dt)
        return 0.5 * (slow + fast), 0.5 * (slow - fast) / b
    fallen = exp(a * dt)
    if square < -1e-6 * a * a:
        b = sqrt(-square)
        return fallen * cos(b * dt), fallen * sin(b * dt) / b
    return fallen, fallen * dt


@inlined
def one_body(omega, amps, volts, force, gain, per_gain, tau, lag, ohms, emf, dt, x, at):  # type: ignore[no-untyped-def]
    """Angle turned, speed and current after dt of a body of time constant ``tau``; without ``emf`` no current answers
    the speed, and without ``lag`` the current is what ``volts`` and speed leave.
    """
    if not emf:
        rate = gain * (volts + force) / tau
        return (omega + 0.5 * rate * dt) * dt, omega + rate * dt, volts
    if lag == 0.0:
        if abs(dt - x[at]) > SAME_TIME_S or tau != x[at + 1] or x[at + 2] != 0.0:
            x[at], x[at + 1], x[at + 2], x[at + 3] = dt, tau, 0.0, expm1(-dt / tau)
        steady = gain * (volts + force)
        change = (omega - steady) * x[at + 3]
        after = omega + change
        return steady * dt - tau * change, after, volts - after * per_gain
    if abs(dt - x[at]) > SAME_TIME_S or tau != x[at + 1] or lag != x[at + 2] or ohms != x[at + 3]:
        x[at], x[at + 1], x[at + 2], x[at + 3] = dt, tau, lag, ohms
        c, s = _swing(dt, tau, lag, ohms)
        half = 0.5 * ohms / lag * s
        x[at + 4], x[at + 5], x[at + 6], x[at + 7] = c + half, s / tau, -s / lag, c - half
    steady = gain * (volts + ohms * force)
    w, v = (omega - steady) * per_gain, amps + force
    w1 = x[at + 4] * w + x[at + 5] * v
    v1 = x[at + 6] * w + x[at + 7] * v
    return steady * dt - gain * (lag * (v1 - v) + ohms * tau * (w1 - w)), steady + gain * w1, v1 - force


@part
def mean_current(amps, volts, ohms, lag, dt):  # type: ignore[no-untyped-def]
    """Mean over dt of a current that tends from ``amps`` to what a constant voltage drives."""
    tends, spans = volts / ohms, dt * ohms / lag
    return tends - (amps - tends) * expm1(-spans) / spans


@inlined
def time_to_rest(omega, volts, force, gain, tau, emf, dt):  # type: ignore[no-untyped-def]
    """When a body whose current has no lag comes to rest, given that it does within dt."""
    net = gain * (volts + force)
    at = -tau * log1p(-omega / (omega - net)) if emf else -omega * tau / net
    return min(max(at, 0.0), dt)


@inlined
def _times(x, a, b, to):  # type: ignore[no-untyped-def]
    """The product of two matrices."""
    for i in range(N):
        for j in range(N):
            x[to + N * i + j] = (
                x[a + N * i] * x[b + j] + x[a + N * i + 1] * x[b + N + j]
                + x[a + N * i + 2] * x[b + 2 * N + j] + x[a + N * i + 3] * x[b + 3 * N + j]
            )  # fmt: skip


@part
def _propagate(x, at, dt):  # type: ignore[no-untyped-def]
    """``exp(A dt)``, its integral and the integral of that, from ``at`` on, for the matrix A in the scratch."""
    size = 0.0
    for i in range(N):
        row = 0.0
        for j in range(N):
            row += abs(x[MATRIX + N * i + j])
        size = max(size, row)
    doublings, h = 0, dt
    while size * h > SHORT:
        h *= 0.5
        doublings += 1
    for i in range(SQUARE):
        unit = 1.0 if i % (N + 1) == 0 else 0.0
        x[TERM + i] = unit
        x[FLOW + i], x[ONCE + i], x[TWICE + i] = unit, unit * h, unit * 0.5 * h * h
    for k in range(1, TERMS):
        _times(x, MATRIX, TERM, SPARE)
        by, once, twice = h / k, h / (k + 1), h * h / ((k + 1) * (k + 2))
        for i in range(SQUARE):
            total = x[SPARE + i] * by
            x[TERM + i] = total
            x[FLOW + i] += total
            x[ONCE + i] += total * once
            x[TWICE + i] += total * twice
    for _ in range(doublings):
        _times(x, FLOW, TWICE, TERM)
        _times(x, FLOW, ONCE, SPARE)
        for i in range(SQUARE):
            x[TWICE + i] += x[TERM + i] + h * x[ONCE + i]
            x[ONCE + i] += x[SPARE + i]
        _times(x, FLOW, FLOW, TERM)
        for i in range(SQUARE):
            x[FLOW + i] = x[TERM + i]
        h *= 2.0
    for i in range(3 * SQUARE):
        x[at + i] = x[FLOW + i]


@inlined
def _row(m, at, omega, amps, twist, load_omega):  # type: ignore[no-untyped-def]
    return m[at] * omega + m[at + 1] * amps + m[at + 2] * twist + m[at + 3] * load_omega


@inlined
def _pushed(m, at, b0, b1, b3):  # type: ignore[no-untyped-def]
    return m[at] * b0 + m[at + 1] * b1 + m[at + 3] * b3


@part
def two_bodies(  # type: ignore[no-untyped-def]
    omega,
    amps,
    twist,
    load_omega,
    volts,
    force,
    load,
    stiff,
    damp,
    gain,
    per_gain,
    own,
    other,
    lag,
    ohms,
    kind,
    dt,
    x,
    at,
):
    """Angle turned by the motor, speed, current, twist and load speed after dt of two bodies on a spring.

    ``own`` and ``other`` are their inertias. ``kind`` is a sum: 1 the motor is held, 2 the load is held, 4 the current
    answers the speed.
    """
    at += ONE_BODY
    m = x[at : at + TWO_BODIES]  # the sums, then what they were computed for
    held, load_held, emf = kind & 1, kind & 2, kind & 4
    lagged = emf and lag > 0.0
    dt_at = 3 * SQUARE
    if (
        abs(dt - m[dt_at]) > SAME_TIME_S
        or m[dt_at + 1] != kind + 1.0
        or m[dt_at + 2] != own
        or m[dt_at + 3] != lag
        or (lagged and m[dt_at + 4] != ohms)
    ):
        m[dt_at], m[dt_at + 1], m[dt_at + 2], m[dt_at + 3], m[dt_at + 4] = dt, kind + 1.0, own, lag, ohms
        a, rate = MATRIX, sqrt(stiff / own + stiff / other)  # the twist by its own frequency: as large as a speed
        for i in range(SQUARE):
            x[a + i] = 0.0
        if not held:
            x[a], x[a + 2], x[a + 3] = -damp / own, -stiff / own / rate, damp / own
            if lagged:
                x[a + 1] = 1.0 / own
            elif emf:
                x[a] -= 1.0 / (gain * own)
        if lagged:
            x[a + 4], x[a + 5] = -1.0 / (gain * lag), -ohms / lag
        x[a + 8], x[a + 11] = rate, -rate
        if not load_held:
            x[a + 12], x[a + 14], x[a + 15] = damp / other, stiff / other / rate, -damp / other
        _propagate(x, at, dt)
        for i in range(0, 3 * SQUARE, SQUARE):
            for j in range(N):
                m[i + N * j + 2] *= rate
                m[i + 2 * N + j] /= rate
    b0 = 0.0 if held else (force if lagged else force + volts) / own
    b1 = volts / lag if lagged else 0.0
    b3 = 0.0 if load_held else load / other
    after = _row(m, 0, omega, amps, twist, load_omega) + _pushed(m, SQUARE, b0, b1, b3)
    flowing = _row(m, N, omega, amps, twist, load_omega) + _pushed(m, SQUARE + N, b0, b1, b3)
    twisted = _row(m, 2 * N, omega, amps, twist, load_omega) + _pushed(m, SQUARE + 2 * N, b0, b1, b3)
    load_after = _row(m, 3 * N, omega, amps, twist, load_omega) + _pushed(m, SQUARE + 3 * N, b0, b1, b3)
    turned = _row(m, SQUARE, omega, amps, twist, load_omega) + _pushed(m, 2 * SQUARE, b0, b1, b3)
    if not lagged:
        flowing = volts - (after * per_gain if emf else 0.0)
    return turned, after, flowing, twisted, load_after


@inlined
def flow(motion, forces, bodies, regime, h, x, at):  # type: ignore[no-untyped-def]
    """Angle turned by the motor and speed, current, twist and load speed after ``h`` in a regime."""
    omega, amps, twist, load_omega = motion
    volts, force, beyond = forces
    gain, per_gain, mass, own, other, _, per_other, stiff, damp, half_gap = bodies
    joined, sprung, stuck, stuck_load, emf, lag, ohms, contact = regime
    if sprung:
        held = (1 if stuck else 0) + (2 if stuck_load else 0) + (4 if emf else 0)
        offset = stiff * contact * half_gap
        return two_bodies(
            omega, amps, twist, load_omega, volts, force + offset, beyond - offset, stiff, damp, gain, per_gain, own,
            other, lag, ohms, held, h, x, at,
        )  # fmt: skip
    if stuck:
        turn, after, flowing = 0.0, 0.0, volts
        if lag > 0.0:
            flowing = volts / ohms + (amps - volts / ohms) * exp(-h * ohms / lag)
    elif joined:
        turn, after, flowing = one_body(
            omega, amps, volts, force + beyond, gain, per_gain, gain * mass, lag, ohms, emf, h, x, at
        )
    else:
        turn, after, flowing = one_body(omega, amps, volts, force, gain, per_gain, gain * own, lag, ohms, emf, h, x, at)
    if joined:
        return turn, after, flowing, twist, after
    if stuck_load:
        return turn, after, flowing, twist + turn, 0.0
    rate = beyond * per_other
    return turn, after, flowing, twist + turn - (load_omega + 0.5 * rate * h) * h, load_omega + rate * h


@part
def flow_again(motion, forces, bodies, regime, h, x, at):  # type: ignore[no-untyped-def]
    """``flow``, called where it is rarely needed."""
    return flow(motion, forces, bodies, regime, h, x, at)
