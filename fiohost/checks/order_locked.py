"""Ripple locked to the shaft's turn at steady speed: an error of the reading keeps its size, a torque's fades.

Where the command rests the angle is a smooth curve. What is left beside it is held against sines of the angle itself,
one order at a time. A torque ripple moves the shaft by 1/speed to 1/speed squared; an eccentric disc does not care.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

ORDERS = 64
MOST_ORDERS = 3
# Of a rest of the command, the part that is used: the lag of the motor is over.
SETTLED = 0.4
STEADY = 0.1
TURNS, LEAST_SAMPLES = 2.0, 40
MOST_TURNS = 6.0
SEGMENTS = 12
# Counts at steady speed make a sawtooth whose first harmonic is 1/pi counts; a beat with the sampling may lie anywhere.
LEAST_COUNTS = 0.5
SPEED_RATIO = 1.5
KEEPS_SIZE = 0.8
SIGMAS = 6.0


@dataclass(frozen=True)
class Ripple:
    """One order (cycles a turn) and its amplitude ``level`` in the output's unit, over ``segments`` of steady speed.

    ``reading`` says that it is one of the reading, by its size at ``slow`` and ``fast`` speed; else it is not known.
    """

    order: int
    level: float
    reading: bool
    slow: float
    fast: float
    segments: int
    times_s: tuple[float, ...]


@dataclass
class _Segment:
    time_s: float
    speed: float
    theta: np.ndarray
    rest: np.ndarray
    smooth: np.ndarray

    def columns(self, order: int) -> np.ndarray:
        """Cosine and sine (n, 2) of an order, without what the smooth curve can imitate."""
        waves = np.column_stack((np.cos(order * self.theta), np.sin(order * self.theta)))
        return np.asarray(waves - self.smooth @ (self.smooth.T @ waves))

    def fit(self, order: int) -> complex:
        found = np.linalg.lstsq(self.columns(order), self.rest, rcond=None)[0]
        return complex(found[0], found[1])

    @property
    def orders(self) -> int:
        """Highest order that the sampling shows."""
        turns = abs(float(self.theta[-1] - self.theta[0])) / (2.0 * np.pi)
        return int(0.4 * len(self.theta) / turns)


def _pieces(angle: np.ndarray, duty: np.ndarray) -> Iterator[tuple[int, int]]:
    """First and last sample of whole turns within settled rests of the command."""
    edges = np.concatenate(([0], np.flatnonzero(np.diff(duty) != 0) + 1, [len(duty)]))
    for begin, b in zip(edges[:-1], edges[1:], strict=True):
        a = int(begin + SETTLED * (b - begin))
        turns = abs(float(angle[b - 1] - angle[a])) / 360.0
        if duty[a] == 0.0 or turns < TURNS:
            continue
        each = np.floor(turns / max(np.ceil(turns / MOST_TURNS), 1.0))
        marks = a + np.searchsorted(np.abs(angle[a:b] - angle[a]), np.arange(0.0, turns, each) * 360.0)
        yield from zip(marks[:-1].tolist(), marks[1:].tolist(), strict=True)


def _segments(times_s: np.ndarray, angle: np.ndarray, duty: np.ndarray) -> list[_Segment]:
    found = []
    for a, b in _pieces(angle, duty):
        if b - a < LEAST_SAMPLES:
            continue
        t = times_s[a:b] - times_s[a:b].mean()
        smooth, _ = np.linalg.qr(np.vander(t / np.max(np.abs(t)), 4))
        y = angle[a:b]
        parts = np.array_split(y, 4)
        speeds = np.array([p[-1] - p[0] for p in parts]) / [len(p) - 1 for p in parts]
        if np.ptp(speeds) > STEADY * abs(speeds.mean()):
            continue
        speed = float((y[-1] - y[0]) / (times_s[b - 1] - times_s[a]))
        found.append(_Segment(float(times_s[a]), speed, np.radians(y), y - smooth @ (smooth.T @ y), smooth))
    by_speed = sorted(found, key=lambda s: abs(s.speed))
    some = np.unique(np.linspace(0, len(found) - 1, min(SEGMENTS, len(found))).astype(int)) if found else ()
    return sorted((by_speed[i] for i in some), key=lambda s: s.time_s)


def ripples(times_s: np.ndarray, angle: np.ndarray, duty: np.ndarray, quantum: float) -> list[Ripple]:
    """Orders that waver by half a count and more, in step over two segments or more of an angle (n) in degrees."""
    segments = _segments(times_s, angle, duty)
    found: list[Ripple] = []
    if len(segments) < 2:
        return found
    highest = min(ORDERS, min(s.orders for s in segments))
    weights = np.array([len(s.rest) for s in segments], dtype=float)
    for _ in range(MOST_ORDERS):
        waves = np.array([[s.fit(n) for s in segments] for n in range(1, highest + 1)])
        if not waves.size:
            break
        order = int(np.argmax((np.abs(waves) ** 2) @ weights)) + 1
        a = waves[order - 1]
        mean = complex(np.sum(a * weights) / weights.sum())
        rms = float(np.sqrt(np.sum(np.abs(a) ** 2 * weights) / weights.sum()))
        noise = max(float(np.std(s.rest)) * np.sqrt(2.0 / len(s.rest)) for s in segments)
        if rms < LEAST_COUNTS * quantum or rms < SIGMAS * noise:
            break
        speeds = np.abs([s.speed for s in segments])
        slow, fast = speeds <= speeds.min() * SPEED_RATIO**0.5, speeds >= speeds.max() / SPEED_RATIO**0.5
        apart = speeds.max() >= SPEED_RATIO * speeds.min()
        in_step = abs(mean) >= KEEPS_SIZE * rms
        keeps = float(np.abs(a[fast]).mean()) >= KEEPS_SIZE * float(np.abs(a[slow]).mean())
        if in_step and (keeps or not apart):
            times = tuple(s.time_s for s in segments[:5])
            found.append(
                Ripple(order, abs(mean), apart, float(speeds.min()), float(speeds.max()), len(segments), times)
            )
        for s, wave in zip(segments, a, strict=True):
            s.rest = s.rest - s.columns(order) @ np.array([wave.real, wave.imag])
    return found
