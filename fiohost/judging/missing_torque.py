"""The torque that a model lacks, over time.

A deviation of the angle obeys the linear part of the model driven by the torque that the model lacks, so a Kalman
smoother with that torque as a random walk recovers it from the residual (Kristensen and Madsen's grey box; Rauch,
Tung, Striebel 1965). It is band-limited by the counts: good for loads, gravity, drag and drift, blind to delays and
play.
"""

from __future__ import annotations

import numpy as np

from fiohost.estimation.record import ANGLE, Record
from fiohost.judging.settings import TORQUE
from fiohost.motor.compiled import compiled
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise


@compiled
def _smooth(e, dt, gain, tau, noise, walk, d, work):  # type: ignore[no-untyped-def]
    """Forward filter and backward smoother of (angle, speed, torque); ``work`` is (n, 18), ``d`` (n, 2) torque,
    variance.
    """
    n = e.shape[0]
    x0, x1, x2 = e[0], 0.0, 0.0
    p00, p01, p02, p11, p12, p22 = noise * noise, 0.0, 0.0, (100.0 * gain) ** 2 * 1e-2, 0.0, 25.0
    a = np.exp(-dt / tau)
    f01, f02 = tau * (1.0 - a), gain * (dt - tau * (1.0 - a))
    f11, f12 = a, gain * (1.0 - a)
    for k in range(n):
        if k > 0:
            # Predict: x = F x, P = F P F' + Q with the walk on the torque.
            y0, y1 = x0 + f01 * x1 + f02 * x2, f11 * x1 + f12 * x2
            g00, g01, g02 = p00 + f01 * p01 + f02 * p02, p01 + f01 * p11 + f02 * p12, p02 + f01 * p12 + f02 * p22
            g11, g12 = f11 * p11 + f12 * p12, f11 * p12 + f12 * p22
            q00 = g00 + g01 * f01 + g02 * f02
            q01 = g01 * f11 + g02 * f12
            q11 = g11 * f11 + g12 * f12
            x0, x1 = y0, y1
            p00, p01, p02, p11, p12, p22 = q00, q01, g02, q11, g12, p22 + walk * walk * dt
        work[k, 0], work[k, 1], work[k, 2] = x0, x1, x2
        work[k, 3], work[k, 4], work[k, 5], work[k, 6], work[k, 7], work[k, 8] = p00, p01, p02, p11, p12, p22
        s = p00 + noise * noise
        k0, k1, k2 = p00 / s, p01 / s, p02 / s
        r = e[k] - x0
        x0, x1, x2 = x0 + k0 * r, x1 + k1 * r, x2 + k2 * r
        p22 -= k2 * p02
        p12 -= k1 * p02
        p11 -= k1 * p01
        p02 -= k0 * p02
        p01 -= k0 * p01
        p00 -= k0 * p00
        work[k, 9], work[k, 10], work[k, 11] = x0, x1, x2
        work[k, 12], work[k, 13], work[k, 14], work[k, 15], work[k, 16], work[k, 17] = p00, p01, p02, p11, p12, p22
    # Bryson-Frazier form backwards: adjoint vector l and matrix L, no inverse of P needed.
    l0, l1, l2 = 0.0, 0.0, 0.0
    m00, m01, m02, m11, m12, m22 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(n - 1, -1, -1):
        p00, p01, p02, p11, p12, p22 = work[k, 3], work[k, 4], work[k, 5], work[k, 6], work[k, 7], work[k, 8]
        s = p00 + noise * noise
        k0, k1, k2 = p00 / s, p01 / s, p02 / s
        r = e[k] - work[k, 0]
        # l <- -H' r / s + (I - K H)' l ; L <- H'H/s + (I - KH)' L (I - KH)
        c0 = l0 - (k0 * l0 + k1 * l1 + k2 * l2)
        v0 = m00 * k0 + m01 * k1 + m02 * k2
        v1 = m01 * k0 + m11 * k1 + m12 * k2
        v2 = m02 * k0 + m12 * k1 + m22 * k2
        kk = k0 * v0 + k1 * v1 + k2 * v2
        l0 = c0 - r / s
        m00 = m00 - 2.0 * v0 + kk + 1.0 / s
        m01 = m01 - v1
        m02 = m02 - v2
        d[k, 0] = work[k, 2] - (p02 * l0 + p12 * l1 + p22 * l2)
        u0 = m00 * p02 + m01 * p12 + m02 * p22
        u1 = m01 * p02 + m11 * p12 + m12 * p22
        u2 = m02 * p02 + m12 * p12 + m22 * p22
        d[k, 1] = max(p22 - (p02 * u0 + p12 * u1 + p22 * u2), 0.0)
        # Back through the prediction: l <- F' l, L <- F' L F.
        n1, n2 = f01 * l0 + f11 * l1, f02 * l0 + f12 * l1 + l2
        w01, w02 = m00 * f01 + m01 * f11, m00 * f02 + m01 * f12 + m02
        w11, w12 = m01 * f01 + m11 * f11, m01 * f02 + m11 * f12 + m12
        w22 = m02 * f02 + m12 * f12 + m22
        z11 = f01 * w01 + f11 * w11
        z12 = f01 * w02 + f11 * w12
        z22 = f02 * w02 + f12 * w12 + w22
        l1, l2 = n1, n2
        m01, m02, m11, m12, m22 = w01, w02, z11, z12, z22


def missing_torque(record: Record, model: Model, residual: np.ndarray, noise: Noise | None = None) -> np.ndarray:
    """Torque (n) in percent of duty that the model lacks, smoothed, from the free-run residual (n) of a record.

    The band of the smoother is that of a torque as random as the ``noise`` of the records, else one that hides nothing
    above the counts. Speeds are summed up to angles.
    """
    here = noise.at(record.sample_time_s) if noise else None
    sensor, walk_pct = (here.sensor.value, here.walk_pct) if here else (0.0, TORQUE.walk_pct)
    rounding = max(record.quantum, 1e-6 * float(np.ptp(record.y)), 1e-12) / np.sqrt(12.0)
    if record.average:
        rounding = max(rounding, record.average.rms)
    sigma = float(np.hypot(rounding, sensor))
    if record.kind != ANGLE:
        residual = np.cumsum(residual * np.gradient(record.excitation.times_s))
        sigma *= record.sample_time_s
    d = np.zeros((len(residual), 2))
    _smooth(
        np.ascontiguousarray(residual),
        record.sample_time_s,
        model.number("linear.gain_deg_s_per_pct"),
        model.number("linear.tau_s"),
        sigma,
        walk_pct,
        d,
        np.zeros((len(residual), 18)),
    )
    return d[:, 0]
