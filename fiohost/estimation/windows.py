"""Initial states by least squares: the one piece of estimation that must be compiled, as it runs inside everything.

A window keeps every state of the free run but angle and speed, which are free in it (angle only where the output is an
angle). Gauss-Newton with one finite difference for the speed, and one for the angle where torques depend on it.
"""

from __future__ import annotations

from fiohost.motor.compiled import compiled, inlined
from fiohost.motor.hooks import jumped, measure, measure_speed
from fiohost.motor.kernel import simulate
from fiohost.motor.state import FOLLOWING, LOAD_OMEGA, LOAD_THETA, OMEGA, THETA

ANGLE, SPEED, MEAN_SPEED = 0, 1, 2

# A step is taken where it promises this share of the squared error; columns serve again while steps keep that much of
# their promise.
WORTH_MOVING = 1e-4
AS_PROMISED = 0.7
# A step that did not pay is tried again damped by so much of the columns' squares at least: less moves it little.
LEAST_DAMPING = 0.1


@inlined
def output(times, states, first, count, kind, seen, p, on, y):  # type: ignore[no-untyped-def]
    """The measured quantity (count) from states: angle, speed, or mean speed over the interval before."""
    rate = OMEGA if seen == THETA else LOAD_OMEGA
    for i in range(count):
        if kind == ANGLE:
            y[i] = measure(states[i, seen], (), p, on)
        elif kind == SPEED or i == 0:
            y[i] = measure_speed(states[i, rate], (), states[i], 0, p, on)
        else:
            mean = (states[i, seen] - states[i - 1, seen]) / (times[first + i] - times[first + i - 1])
            y[i] = measure_speed(mean, (), states[i], 0, p, on)


@compiled
def read_output(times, states, kind, seen, p, on, y):  # type: ignore[no-untyped-def]
    """``output`` for a whole record, from Python."""
    output(times, states, 0, states.shape[0], kind, seen, p, on, y)


@inlined
def window_output(times, states, first, count, kind, seen, p, on, measured, y):  # type: ignore[no-untyped-def]
    """``output`` of a window within a run; a first mean speed that began in the window before is taken as measured."""
    output(times, states, first, count, kind, seen, p, on, y)
    if kind == MEAN_SPEED and first > 0:
        y[0] = measured[first]


@inlined
def _move(state, base, shift, omega, p, on):  # type: ignore[no-untyped-def]
    """A copy of ``base`` turned by ``shift``, to an end of travel at most, and running at ``omega``, load and gap with
    it.
    """
    for i in range(base.shape[0]):
        state[i] = base[i]
    end, _ = jumped(base[THETA] + shift, omega, p, on)
    if end != base[THETA] + shift:
        shift = end - base[THETA]
    state[THETA] += shift
    state[LOAD_THETA] += shift
    state[LOAD_OMEGA] += omega - base[OMEGA]
    state[OMEGA] = omega
    for slot in FOLLOWING:
        state[slot] += omega - base[OMEGA]


@inlined
def _speed_and_angle(  # type: ignore[no-untyped-def]
    times,
    act_times,
    duties,
    modes,
    clock,
    y,
    first,
    last,
    base,
    shift,
    omega,
    free_speed,
    bends,
    kind,
    seen,
    substep,
    p,
    on,
    speed_step,
    state,
    states,
    y0,
    y1,
    by_speed,
    by_angle,
):
    """Columns of a window by speed and angle around its output ``y0``: by difference, or exactly one by an angle on
    which nothing depends.
    """
    for i in range(last - first):
        by_angle[i] = 1.0 if kind == ANGLE else 0.0
        by_speed[i] = 0.0
    if free_speed:
        _move(state, base, shift, omega + speed_step, p, on)
        simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states)
        window_output(times, states, first, last - first, kind, seen, p, on, y, y1)
        for i in range(last - first):
            by_speed[i] = (y1[i] - y0[i]) / speed_step
    if kind == ANGLE and bends:
        angle_step = speed_step * 0.01
        _move(state, base, shift + angle_step, omega, p, on)
        simulate(times, act_times, duties, modes, clock, first, last, state, substep, p, on, states)
        window_output(times, states, first, last - first, kind, seen, p, on, y, y1)
        for i in range(last - first):
            by_angle[i] = (y1[i] - y0[i]) / angle_step


@inlined
def _least_squares(rs, ra, ss, sa, aa, damping):  # type: ignore[no-untyped-def]
    """Speed and angle that take most of what is left, from products of columns and of what is left."""
    s11, s22 = ss * (1.0 + damping) + 1e-30, aa * (1.0 + damping)
    det = s11 * s22 - sa * sa
    if det <= 1e-12 * s11 * s22:
        return 0.0, ra / s22
    return (s22 * rs - sa * ra) / det, (s11 * ra - sa * rs) / det


@compiled
def fit_windows(  # type: ignore[no-untyped-def]
    times,
    act_times,
    duties,
    modes,
    clock,
    y,
    sure,
    firsts,
    lasts,
    edges,
    bases,
    free_speed,
    bends,
    kind,
    seen,
    substep,
    p,
    on,
    speed_step,
    residuals,
    shifts,
    omegas,
    state,
    states,
    y0,
    y1,
    known,
    columns,
):
    """Fit angle shift and speed of the windows from ``firsts`` (m) up to ``lasts`` (m); ``bases`` (m, states) are the
    free run's states at their first samples.

    Readings count by how ``sure`` (n) they are, one over their variance or alike. Writes ``residuals`` (k), measured
    minus simulated, one window after the other at ``edges`` (m + 1), ``shifts`` (m) and ``omegas`` (m). ``bends`` says
    that torques depend on the angle, so that a shift is not just added to the output. ``columns`` (2, k) are the
    outputs' derivatives by speed and angle; where they are ``known`` from nearby they serve as long as steps do what
    they promise. The four arguments before ``known`` are work space.
    """
    for w in range(firsts.shape[0]):
        a, b = firsts[w], lasts[w]
        place = edges[w]
        n = b - a
        total = 0.0
        for i in range(a, b):
            total += sure[i]
        base = bases[w]
        shift, omega = 0.0, base[OMEGA]
        _move(state, base, shift, omega, p, on)
        simulate(times, act_times, duties, modes, clock, a, b, state, substep, p, on, states)
        window_output(times, states, a, n, kind, seen, p, on, y, y0)
        if kind == ANGLE and not (known and bends):  # what is known of both takes their step at once
            for i in range(n):
                shift += sure[a + i] * (y[a + i] - y0[i]) / total
            if bends:
                _move(state, base, shift, omega, p, on)
                simulate(times, act_times, duties, modes, clock, a, b, state, substep, p, on, states)
                window_output(times, states, a, n, kind, seen, p, on, y, y0)
            else:
                for i in range(n):
                    y0[i] += shift
        cost = 0.0
        for i in range(n):
            cost += sure[a + i] * (y[a + i] - y0[i]) ** 2
        damping = 1e-9
        aa, sa, ss = 0.0, 0.0, 0.0
        by_speed, by_angle = columns[0, place : place + n], columns[1, place : place + n]
        serving, moved, summed = known, known, False
        for _ in range(16):
            if not serving:
                moved, summed = False, False
                _speed_and_angle(
                    times, act_times, duties, modes, clock, y, a, b, base, shift, omega, free_speed, bends, kind, seen,
                    substep, p, on, speed_step, state, states, y0, y1, by_speed, by_angle,
                )  # fmt: skip
            if not summed:
                serving, summed = True, True
                ss, sa, aa = 0.0, 0.0, 0.0 if kind == ANGLE else 1.0
                for i in range(n):
                    ss += sure[a + i] * by_speed[i] * by_speed[i]
                    sa += sure[a + i] * by_speed[i] * by_angle[i]
                    aa += sure[a + i] * by_angle[i] * by_angle[i]
            rs, ra = 0.0, 0.0
            for i in range(n):
                rs += sure[a + i] * by_speed[i] * (y[a + i] - y0[i])
                ra += sure[a + i] * by_angle[i] * (y[a + i] - y0[i])
            step_speed, step_angle = _least_squares(rs, ra, ss, sa, aa, damping)
            expected = step_speed * rs + step_angle * ra
            if expected <= WORTH_MOVING * cost:
                break
            _move(state, base, shift + step_angle, omega + step_speed, p, on)
            simulate(times, act_times, duties, modes, clock, a, b, state, substep, p, on, states)
            window_output(times, states, a, n, kind, seen, p, on, y, y1)
            new = 0.0
            for i in range(n):
                new += sure[a + i] * (y[a + i] - y1[i]) ** 2
            if new <= cost:
                # Columns serve again while the step did what they promised.
                serving = cost - new > AS_PROMISED * expected
                moved = True
                cost = new
                shift += step_angle
                omega += step_speed
                for i in range(n):
                    y0[i] = y1[i]
                damping *= 0.1
            else:
                damping = max(damping * 10.0, LEAST_DAMPING)
                serving = not moved
        shifts[w] = shift
        omegas[w] = omega
        for i in range(n):
            residuals[place + i] = y[a + i] - y0[i]


@compiled
def window_outputs(  # type: ignore[no-untyped-def]
    times,
    act_times,
    duties,
    modes,
    clock,
    y,
    firsts,
    lasts,
    edges,
    begins,
    kind,
    seen,
    substep,
    p,
    on,
    state,
    states,
    outputs,
):
    """The ``outputs`` (k) of windows that begin at ``begins`` (m, states), one after the other at ``edges`` (m + 1)."""
    for w in range(firsts.shape[0]):
        a, b = firsts[w], lasts[w]
        begin = begins[w]
        _move(state, begin, 0.0, begin[OMEGA], p, on)
        simulate(times, act_times, duties, modes, clock, a, b, state, substep, p, on, states)
        window_output(times, states, a, b - a, kind, seen, p, on, y, outputs[edges[w] : edges[w + 1]])
