"""The Kalman filter of the noise: what each reading tells that the ones before it did not.

The innovations of the true noise are white: the same as a series times the inverse Cholesky factor of its covariance,
at a cost that grows with the samples and not with their cube (Kalman 1960; Anderson and Moore 1979, section 5.3). The
state is what is seen, the speed and the torque, as ``covariance`` has them; of a mean speed also how the counts at both
its ends err. Where a window begins, nothing is known of angle and speed (de Jong 1991), but the torque lasts from the
window before.
"""

from __future__ import annotations

import numpy as np

from fiohost.motor.compiled import compiled, inlined
from fiohost.noise.covariance import ANGLE, MEAN_SPEED, SPEED, way

# States: seen, speed, torque; of a mean speed also the errors of the counts at its end and at its beginning.
STATES, COUNTED = 3, 5
# How states follow from one sample to the next: of what is seen its own share, that of the speed and of the torque; of
# the speed that of the speed and of the torque; of the torque its own.
LINKS = 6
# Least variance of a reading, as a share of the mean one: numbers have so many digits. So many times that one where
# nothing is known.
LEAST, UNKNOWN = 1e-9, 1e8


@inlined
def _onward(x, column, links, i):  # type: ignore[no-untyped-def]
    """One column of states (k, m) at the next sample."""
    seen = links[i, 0] * x[0, column] + links[i, 1] * x[1, column] + links[i, 2] * x[2, column]
    x[1, column] = links[i, 3] * x[1, column] + links[i, 4] * x[2, column]
    x[0, column] = seen
    x[2, column] *= links[i, 5]
    if x.shape[0] == COUNTED:
        x[4, column] = x[3, column]
        x[3, column] = 0.0


@inlined
def _onward_row(x, row, links, i):  # type: ignore[no-untyped-def]
    """One row of a covariance (k, k) likewise."""
    seen = links[i, 0] * x[row, 0] + links[i, 1] * x[row, 1] + links[i, 2] * x[row, 2]
    x[row, 1] = links[i, 3] * x[row, 1] + links[i, 4] * x[row, 2]
    x[row, 0] = seen
    x[row, 2] *= links[i, 5]
    if x.shape[0] == COUNTED:
        x[row, 4] = x[row, 3]
        x[row, 3] = 0.0


@inlined
def _covered(p, links, i, torque, count):  # type: ignore[no-untyped-def]
    """The states' covariance (k, k) at the next sample."""
    for column in range(p.shape[0]):
        _onward(p, column, links, i)
    for row in range(p.shape[0]):
        _onward_row(p, row, links, i)
    p[2, 2] += torque * (1.0 - links[i, 5] ** 2)
    if p.shape[0] == COUNTED:
        p[3, 3] += count


@inlined
def _begin(p, torque, count, kind, of_seen, of_speed):  # type: ignore[no-untyped-def]
    """The states' covariance where a window begins, for variances of what is seen, of the speed and of the torque."""
    for i in range(p.shape[0]):
        for j in range(p.shape[0]):
            p[i, j] = 0.0
    p[0, 0], p[1, 1], p[2, 2] = of_seen, of_speed, torque
    if kind == SPEED:
        p[0, 1] = p[1, 0] = of_speed
    if p.shape[0] == COUNTED:
        p[3, 3] = p[4, 4] = count


@inlined
def _read(x, column, weight):  # type: ignore[no-untyped-def]
    """What is read of one column of states; counts that err alike are weighed together."""
    if x.shape[0] == COUNTED:
        return x[0, column] + (x[3, column] - x[4, column]) / weight
    return x[0, column]


@inlined
def _read_row(x, row, weight):  # type: ignore[no-untyped-def]
    if x.shape[0] == COUNTED:
        return x[row, 0] + (x[row, 3] - x[row, 4]) / weight
    return x[row, 0]


@inlined
def _variance(p, weight):  # type: ignore[no-untyped-def]
    """The variance of what is read, but for noise of each reading's own."""
    seen = _read_row(p, 0, weight)
    if p.shape[0] == COUNTED:
        seen += (_read_row(p, 3, weight) - _read_row(p, 4, weight)) / weight
    return max(seen, 0.0)


@compiled
def follow(times, lags, keeps, rows, begins, gain, tau, kind, torque_s, links):  # type: ignore[no-untyped-def]
    """``links`` (n, LINKS) from each of the ``rows`` (n) of a record to the next one; ``begins`` (n) says where a
    window does. From one window to the next only the torque is kept.
    """
    for at in range(len(rows)):
        row = rows[at]
        for k in range(LINKS):
            links[at, k] = 0.0
        if at + 1 == len(rows):
            break
        step = times[rows[at + 1]] - times[row]
        links[at, 5] = np.exp(-step / torque_s) if torque_s > 0.0 else 0.0
        if begins[at + 1]:
            continue
        links[at, 0] = 1.0 if kind == ANGLE else 0.0
        lag = lags[row]
        if lag <= 0.0:
            continue
        goes, full = way(step, lag), gain * lag / tau
        links[at, 3], links[at, 4] = (1.0 - goes / lag) * keeps[row], full * goes / lag
        if kind == SPEED:
            links[at, 1], links[at, 2] = links[at, 3], links[at, 4]
            continue
        over = step if kind == MEAN_SPEED else 1.0
        # Where it crosses zero between two samples is not known: half-way, on average.
        links[at, 1], links[at, 2] = 0.5 * goes * (1.0 + keeps[row]) / over, full * (step - goes) / over


@compiled
def filters(  # type: ignore[no-untyped-def]
    weights, begins, stands, links, own, count, torque, at_start, kind, tau, gains, scales, sure, p
):
    """``gains`` (n, k), one over the innovations' standard deviations (``scales``, n) and one over the variances of the
    readings from a known start under a torque as that ``at_start`` (``sure``, n), for variances of each reading's
    ``own`` noise (n), of a ``count`` and of the ``torque``; ``stands`` (n) says where the shaft does, ``p`` (k, k) is
    work space. Returns the logarithm of the covariance's determinant.
    """
    states, n, mean = p.shape[0], len(weights), 0.0
    for at in range(n):
        if begins[at]:
            _begin(p, at_start, count, kind, 0.0, 0.0)
        sure[at] = _variance(p, weights[at]) + own[at]
        mean += sure[at] / n
        _covered(p, links, at, at_start, count)
    least, unknown = LEAST * mean + 1e-300, UNKNOWN * mean + 1e-290
    of_speed = unknown / tau**2 if kind == ANGLE else unknown
    determinant = 0.0
    for at in range(n):
        if begins[at]:
            free = 0.0 if stands[at] else of_speed
            _begin(p, p[2, 2] if at > 0 else torque, count, kind, unknown, free)
            # All starts are as likely, whatever the noise: their sizes are the same for all models.
            determinant -= (np.log(of_speed) if free > 0.0 else 0.0) + (0.0 if kind == SPEED else np.log(unknown))
        sure[at] = 1.0 / (sure[at] + least)
        variance = _variance(p, weights[at]) + own[at] + least
        scales[at] = 1.0 / np.sqrt(variance)
        determinant += np.log(variance)
        for k in range(states):
            gains[at, k] = _read_row(p, k, weights[at]) / variance
        for k in range(states):
            for j in range(states):
                p[k, j] -= gains[at, k] * gains[at, j] * variance
        _covered(p, links, at, torque, count)
    return determinant


@compiled
def innovations(series, rows, links, weights, gains, scales, x, out):  # type: ignore[no-untyped-def]
    """``out`` (samples, c), zero before: the innovations of the ``rows`` (n) of a ``series`` (samples, c); ``x`` (k, c)
    is work space, zero before.
    """
    columns = series.shape[1]
    for at in range(len(rows)):
        row = rows[at]
        for c in range(columns):
            left = series[row, c] - _read(x, c, weights[at])
            out[row, c] = left * scales[at]
            for k in range(x.shape[0]):
                x[k, c] += gains[at, k] * left
            _onward(x, c, links, at)
