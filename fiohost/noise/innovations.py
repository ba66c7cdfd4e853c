"""The Kalman filter of the noise: what each reading tells that the ones before it did not.

The innovations of the true noise are white: the same as a series times the inverse Cholesky factor of its covariance,
at a cost that grows with the samples and not with their cube (Kalman 1960; Anderson and Moore 1979, section 5.3). The
states are what is seen, the speed and the torque, as ``covariance`` has them, and how the last count erred: what a mean
speed lacks of one, the next one has. Where a window begins, nothing is known of angle and speed (de Jong 1991), but the
torque lasts from the window before.
"""

from __future__ import annotations

import numpy as np

from fiohost.motor.compiled import compiled, inlined
from fiohost.noise.covariance import ANGLE, MEAN_SPEED, SPEED, way

SEEN, OF_SPEED, OF_TORQUE, ERRED = range(4)
STATES = 4
# How states follow from one sample to the next: of what is seen its own share, that of the speed and of the torque; of
# the speed that of the speed and of the torque; of the torque and of the last error their own.
LINKS = 7
# Least variance of a reading, as a share of the mean one: numbers have so many digits. So many times that one where
# nothing is known.
LEAST, UNKNOWN = 1e-9, 1e8
# A filter has settled where the variance of so many readings in turn changed by no more than so much of it.
SETTLED, SETTLED_TO = 4, 1e-9


@inlined
def _covered(p, links, at, torque):  # type: ignore[no-untyped-def]
    """The states' covariance (k, k) at the next sample, from that after a reading."""
    a, b, c, d, e = links[at, 0], links[at, 1], links[at, 2], links[at, 3], links[at, 4]
    f, g = links[at, 5], links[at, 6]
    for row in range(STATES):
        p[row, SEEN] = a * p[row, SEEN] + b * p[row, OF_SPEED] + c * p[row, OF_TORQUE]
        p[row, OF_SPEED] = d * p[row, OF_SPEED] + e * p[row, OF_TORQUE]
        p[row, OF_TORQUE] *= f
        p[row, ERRED] *= g
    for column in range(STATES):
        p[SEEN, column] = a * p[SEEN, column] + b * p[OF_SPEED, column] + c * p[OF_TORQUE, column]
        p[OF_SPEED, column] = d * p[OF_SPEED, column] + e * p[OF_TORQUE, column]
        p[OF_TORQUE, column] *= f
        p[ERRED, column] *= g
    p[OF_TORQUE, OF_TORQUE] += torque * (1.0 - f**2)


@inlined
def _begin(p, torque, count, kind, of_seen, of_speed):  # type: ignore[no-untyped-def]
    """The states' covariance where a window begins, for variances of what is seen, of the speed and of the torque."""
    for row in range(STATES):
        for column in range(STATES):
            p[row, column] = 0.0
    p[SEEN, SEEN], p[OF_SPEED, OF_SPEED], p[OF_TORQUE, OF_TORQUE], p[ERRED, ERRED] = of_seen, of_speed, torque, count
    if kind == SPEED:
        p[SEEN, OF_SPEED] = p[OF_SPEED, SEEN] = of_speed


@inlined
def _variance(p, weight, count):  # type: ignore[no-untyped-def]
    """The variance of what is read, but for noise of each reading's own."""
    seen = p[SEEN, SEEN] + ((p[ERRED, ERRED] + count) / weight - p[SEEN, ERRED] - p[ERRED, SEEN]) / weight
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
        links[at, 6] = 1.0
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


@inlined
def _read(p, at, weight, own, count, gains, scales):  # type: ignore[no-untyped-def]
    """The states' covariance (k, k) after a reading, from that before it; its gains and scale are kept. Returns the
    variance of what is read.
    """
    variance = _variance(p, weight, count) + own
    scales[at] = 1.0 / np.sqrt(variance)
    for k in range(ERRED):
        gains[at, k] = (p[k, SEEN] - p[k, ERRED] / weight) / variance
    gains[at, ERRED] = count / weight / variance  # how this count errs: nothing was known of it
    for k in range(ERRED):
        p[k, ERRED] = p[ERRED, k] = 0.0
    p[ERRED, ERRED] = count
    for k in range(STATES):
        for j in range(STATES):
            p[k, j] -= gains[at, k] * gains[at, j] * variance
    return variance


@compiled
def filters(  # type: ignore[no-untyped-def]
    weights, begins, stands, links, own, count, torque, at_start, kind, tau, gains, scales, sure, p
):
    """``gains`` (n, k), one over the innovations' standard deviations (``scales``, n) and one over the variances of the
    readings from a known start under a torque as that ``at_start`` (``sure``, n), for variances of each reading's
    ``own`` noise (n), of a ``count`` that the next reading has too and of the ``torque``; ``stands`` (n) says where the
    shaft does, ``p`` (k, k) is work space. Returns the logarithm of the covariance's determinant.
    """
    n, mean = len(weights), 0.0
    for at in range(n):
        if begins[at]:
            _begin(p, at_start, count, kind, 0.0, 0.0)
        sure[at] = _variance(p, weights[at], count) + own[at]
        mean += sure[at] / n
        p[ERRED, ERRED] = count
        _covered(p, links, at, at_start)
    least, unknown = LEAST * mean + 1e-300, UNKNOWN * mean + 1e-290
    of_speed = unknown / tau**2 if kind == ANGLE else unknown
    determinant = 0.0
    for at in range(n):
        if begins[at]:
            free = 0.0 if stands[at] else of_speed
            _begin(p, p[OF_TORQUE, OF_TORQUE] if at > 0 else torque, count, kind, unknown, free)
            # All starts are as likely, whatever the noise: their sizes are the same for all models.
            determinant -= (np.log(of_speed) if free > 0.0 else 0.0) + (0.0 if kind == SPEED else np.log(unknown))
        sure[at] = 1.0 / (sure[at] + least)
        determinant += np.log(_read(p, at, weights[at], own[at] + least, count, gains, scales))
        _covered(p, links, at, torque)
    return determinant


@compiled
def innovations(series, rows, links, weights, gains, scales, x, out):  # type: ignore[no-untyped-def]
    """``out`` (samples, c), zero before: the innovations of the ``rows`` (n) of a ``series`` (samples, c); ``x`` (k, c)
    is work space, zero before.
    """
    for at in range(len(rows)):
        row, weight = rows[at], weights[at]
        for c in range(series.shape[1]):
            left = series[row, c] - x[SEEN, c] + x[ERRED, c] / weight
            out[row, c] = left * scales[at]
            seen, speed = x[SEEN, c] + gains[at, SEEN] * left, x[OF_SPEED, c] + gains[at, OF_SPEED] * left
            torque = x[OF_TORQUE, c] + gains[at, OF_TORQUE] * left
            x[SEEN, c] = links[at, 0] * seen + links[at, 1] * speed + links[at, 2] * torque
            x[OF_SPEED, c] = links[at, 3] * speed + links[at, 4] * torque
            x[OF_TORQUE, c] = links[at, 5] * torque
            x[ERRED, c] = links[at, 6] * gains[at, ERRED] * left


@inlined
def _squares(series, lasting, links, gains, scales, x):  # type: ignore[no-untyped-def]
    """The sum of all squared innovations of a ``series`` (n, c), of which ``lasting`` (n) columns go on so far."""
    total = 0.0
    for k in range(STATES):
        for c in range(series.shape[1]):
            x[k, c] = 0.0
    for at in range(len(series)):
        power, of_seen, of_speed, of_torque = 0.0, gains[at, SEEN], gains[at, OF_SPEED], gains[at, OF_TORQUE]
        a, b, c, d, e = links[at, 0], links[at, 1], links[at, 2], links[at, 3], links[at, 4]
        f, g = links[at, 5], links[at, 6] * gains[at, ERRED]
        for k in range(lasting[at]):
            left = series[at, k] - x[SEEN, k] + x[ERRED, k]
            power += left * left
            seen, speed = x[SEEN, k] + of_seen * left, x[OF_SPEED, k] + of_speed * left
            torque = x[OF_TORQUE, k] + of_torque * left
            x[SEEN, k] = a * seen + b * speed + c * torque
            x[OF_SPEED, k] = d * speed + e * torque
            x[OF_TORQUE, k] = f * torque
            x[ERRED, k] = g * left
        total += power * scales[at] ** 2
    return total


@compiled
def deviances(series, lasting, links, owns, counts, torques, kind, gains, scales, p, x, found):  # type: ignore[no-untyped-def]
    """``found`` (s, t): -2 log likelihood of pieces of speeds, but for a constant, for variances of each reading's own
    (``owns``, s), of what the next reading has too (``counts``, s) and of a torque (``torques``, t).

    The pieces are the columns of a ``series`` (n, c), the longest first; ``lasting`` (n) of them go on so far. All have
    the ``links`` (n, LINKS), the same at each sample. ``gains`` (n, k), ``scales`` (n), ``p`` (k, k) and ``x``
    (k, c) are work space.
    """
    columns = series.shape[1]
    for i in range(len(owns)):
        for j in range(len(torques)):
            mean = owns[i] + 2.0 * counts[i] + torques[j] * (links[0, 4] / (1.0 - links[0, 3])) ** 2
            least, unknown = LEAST * mean + 1e-300, UNKNOWN * mean + 1e-290
            _begin(p, torques[j], counts[i], kind, unknown, unknown)
            found[i, j] = -columns * np.log(unknown) * (1.0 if kind == SPEED else 2.0)
            variance, before, same = 0.0, 0.0, 0
            for at in range(len(series)):
                if same < SETTLED:
                    before, variance = variance, _read(p, at, 1.0, owns[i] + least, counts[i], gains, scales)
                    same = same + 1 if abs(variance - before) <= SETTLED_TO * variance else 0
                    _covered(p, links, at, torques[j])
                else:
                    scales[at] = scales[at - 1]
                    for k in range(STATES):
                        gains[at, k] = gains[at - 1, k]
                found[i, j] += lasting[at] * np.log(variance)
            found[i, j] += _squares(series, lasting, links, gains, scales, x)
