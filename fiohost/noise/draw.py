"""Draws of the noise, for bootstrap samples."""

from __future__ import annotations

import numpy as np

from fiohost.motor.compiled import compiled
from fiohost.noise.estimate import Noise


def draw_torque(times_s: np.ndarray, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """A random torque (n) in percent of duty at the times: exact steps of an Ornstein-Uhlenbeck process (Gillespie
    1996).
    """
    torque_pct, time_s = noise.torque_pct.value, noise.torque_s.value
    if torque_pct <= 0.0 or time_s <= 0.0:
        return np.zeros(len(times_s))
    stays = np.exp(-np.diff(times_s) / time_s)
    kicks = np.concatenate(([1.0], np.sqrt(1.0 - stays**2))) * rng.standard_normal(len(times_s))
    torque = np.empty(len(times_s))
    _walk(stays, kicks, torque)
    return torque_pct * torque


def draw_sensor(samples: int, noise: Noise, rng: np.random.Generator) -> np.ndarray:
    """What a sensor's noise adds to readings (n), in their unit."""
    if noise.of_angle:
        return np.asarray(noise.sensor.value / np.sqrt(2.0) * np.diff(rng.standard_normal(samples + 1)))
    return noise.sensor.value * rng.standard_normal(samples)


@compiled
def _walk(stays, kicks, torque):  # type: ignore[no-untyped-def]
    torque[0] = kicks[0]
    for k in range(len(stays)):
        torque[k + 1] = stays[k] * torque[k] + kicks[k + 1]
