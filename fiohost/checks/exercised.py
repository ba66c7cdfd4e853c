"""What logs went through: speeds, reversals, starts, turns, levels and the band of the movement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, minimum_filter1d

from fiohost.checks.counts import quantum_of
from fiohost.checks.said import Said
from fiohost.estimation.bench import overlapping
from fiohost.estimation.record import ANGLE, SMOOTH_S, Record

# A shaft stands where its reading stays for so long, and has moved where it left by more grains than one flicker.
STANDS_S, STANDS_SAMPLES = 0.1, 5
MOVED_GRAINS = 2.0
# Readings without their fast noise still wander by so many times the error of their running median.
WANDERS = 5.0
MEDIAN = 1.25  # its standard error over that of a mean
SPEED_SPAN_S = 0.02
LEVEL_PCT = 10.0
ABOVE_ERROR, MOST_LINES, SEGMENT_S = 2.0, 0.8, 2.0
SLOW_SHARE = 0.1


@dataclass(frozen=True)
class Exercised:
    """What a set of logs went through; speeds in the output's unit per second, shares of no unit.

    ``useful_hz`` is the highest frequency at which the movement stands above the counts, None where it cannot be told.
    ``turns`` are whole revolutions covered between the ends of travel, None where no angle is known. Logs that are
    ``overlapping`` on the bench's own time do not say when they were begun: what one clock covers, ``clock_s``, is then
    the longest of them.
    """

    logs: int
    seconds: float
    rotary: bool
    angle: bool
    speed_min: float
    speed_max: float
    reversals: int
    starts: int
    standstill_s: float
    slow_s: float
    braking_s: float
    turns: float | None
    useful_hz: float | None
    levels: int
    distinct_duties: int
    duty_max_pct: float
    largest_step_pct: float
    both_directions: bool
    closed_loop_only: bool
    saturated_pct: float
    overlapping: bool
    clock_s: float


@dataclass(frozen=True)
class _Motion:
    """One log as movement: ``angle`` (n) from the reading or its sum, ``speed`` (n), the ``duty`` (n) that acts.

    They are without the sensor's fast noise. ``grain`` is the least change of angle that is one: a count, and how far
    what is left of the noise wanders. ``raw`` (n) is the angle as it was read, ``variance`` that of its error.
    """

    times_s: np.ndarray
    angle: np.ndarray
    speed: np.ndarray
    duty: np.ndarray
    raw: np.ndarray
    variance: float
    grain: float
    sample_s: float
    standing: np.ndarray

    @property
    def moving(self) -> np.ndarray:
        return ~self.standing


def _runs(same: np.ndarray) -> list[tuple[int, int]]:
    """First and last-plus-one index of each run of True."""
    edges = np.diff(np.concatenate(([0], same.astype(np.int8), [0])))
    return list(zip(np.flatnonzero(edges == 1).tolist(), np.flatnonzero(edges == -1).tolist(), strict=True))


def _standing(record: Record, angle: np.ndarray, within: float) -> np.ndarray:
    """Samples (n, boolean) at which the shaft stands: the reading stays ``within`` so much for some time."""
    least = max(STANDS_SAMPLES, round(STANDS_S / record.sample_time_s)) | 1  # as much before as after
    still = maximum_filter1d(angle, least) - minimum_filter1d(angle, least) < within
    return np.asarray(maximum_filter1d(still.astype(np.int8), least) > 0)


def _motion(record: Record) -> _Motion:
    ex, quantum = record.excitation, quantum_of(record)
    span = max(1, round(SPEED_SPAN_S / record.sample_time_s))
    noise = record.scatter
    read = record.smooth if noise > 0.0 else record.y
    wander = WANDERS * MEDIAN * noise / np.sqrt(max(SMOOTH_S / record.sample_time_s, 1.0))
    angle = read if record.kind == ANGLE else np.cumsum(record.y) * record.sample_time_s
    if record.kind == ANGLE:
        kernel = np.concatenate((np.full(span, angle[0]), angle, np.full(span, angle[-1])))
        gap = np.concatenate((np.full(span, ex.times_s[0]), ex.times_s, np.full(span, ex.times_s[-1])))
        speed = (kernel[2 * span :] - kernel[: -2 * span]) / np.maximum(gap[2 * span :] - gap[: -2 * span], 1e-12)
        standing = _standing(record, angle, 0.5 * quantum + wander)
        raw, variance, grain = record.y, quantum**2 / 12.0 + noise**2, quantum + wander
    else:
        speed, standing = read, np.abs(read) < max(0.5 * quantum + wander, 1e-12)
        raw, variance, grain = angle, (quantum * record.sample_time_s) ** 2 / 12.0, quantum * record.sample_time_s
    acting = ex.duties_pct[np.searchsorted(ex.act_times_s, ex.times_s, side="right")]
    return _Motion(ex.times_s, angle, speed, acting, raw, variance, grain, record.sample_time_s, standing)


def _reversals(motion: _Motion) -> int:
    """Turning points of the angle, each followed by more movement than a reading flickers."""
    threshold = MOVED_GRAINS * motion.grain
    counted, way, extreme = 0, 0, float(motion.angle[0])
    for value in motion.angle[np.concatenate(([True], np.diff(motion.angle) != 0))].tolist():
        if (way >= 0 and value > extreme) or (way <= 0 and value < extreme):
            if way == 0 and abs(value - extreme) <= threshold:
                continue
            way, extreme = (1 if value > extreme else -1), value
        elif abs(value - extreme) > threshold:
            counted, way, extreme = counted + 1, -way, value
    return counted


def _starts(motion: _Motion) -> int:
    """Times that the shaft leaves a standstill."""
    ahead = max(STANDS_SAMPLES, round(STANDS_S / motion.sample_s))
    found = 0
    for _, b in _runs(motion.standing):
        left = motion.angle[b : b + ahead] - motion.angle[b - 1]
        found += bool(np.max(np.abs(left), initial=0.0) > MOVED_GRAINS * motion.grain)
    return found


def _useful_hz(motions: Sequence[_Motion]) -> float | None:
    """Highest frequency up to which the movement stands above the readings' error, in the log that goes highest."""
    from matplotlib.mlab import psd  # Welch (1967); that of scipy.signal takes a second to load

    found = []
    for m in motions:
        samples = round(SEGMENT_S / m.sample_s)
        if len(m.raw) < 2 * samples or m.variance <= 0.0:
            continue
        evenly = np.arange(m.times_s[0], m.times_s[-1], m.sample_s)  # missing rows would be steps
        # Second differences: steps of speed are flat in them, and the readings' error rises as the fourth power.
        bends = np.diff(np.interp(evenly, m.times_s, m.raw), n=2)
        power, hz = map(np.asarray, psd(bends, samples, 1.0 / m.sample_s, detrend="mean", noverlap=samples // 2))
        error = 2.0 * m.sample_s * m.variance * (2.0 * np.sin(np.pi * hz * m.sample_s)) ** 4
        above = np.cumsum(power[1:] > ABOVE_ERROR * error[1:]) / np.arange(1, len(hz))
        good = np.flatnonzero(above > MOST_LINES)
        found.append(float(hz[1:][good[-1]]) if good.size else 0.0)
    return max(found) if found else None


def exercise(records: Sequence[Record], said: Sequence[Said]) -> Exercised:
    motions = [_motion(r) for r in records]
    speed = np.concatenate([m.speed for m in motions])
    duty = np.concatenate([m.duty for m in motions])
    moving = np.concatenate([m.moving for m in motions])
    weight = np.concatenate([np.full(len(m.speed), m.sample_s) for m in motions])
    top = float(np.max(np.abs(speed), initial=0.0))
    floor = float(np.median([MOVED_GRAINS * m.grain / (2.0 * SPEED_SPAN_S) for m in motions]))
    runs = moving & (np.abs(speed) > floor)
    against = runs & (speed * duty <= 0.0)
    held = np.abs(duty[np.abs(duty) > 0])
    bins, sizes = np.unique(np.floor(held / LEVEL_PCT), return_counts=True)
    all_angle = all(r.kind == ANGLE for r in records)
    turning = all(r.rotary and (r.kind == ANGLE or not r.broken) for r in records)
    reference = [s.closed_loop for s in said]
    return Exercised(
        logs=len(records),
        seconds=float(sum(r.seconds for r in records)),
        rotary=all(r.rotary for r in records),
        angle=all_angle,
        speed_min=float(speed.min()),
        speed_max=float(speed.max()),
        reversals=sum(_reversals(m) for m in motions),
        starts=sum(_starts(m) for m in motions),
        standstill_s=float(weight[~moving].sum()),
        slow_s=float(weight[moving & (np.abs(speed) < SLOW_SHARE * top)].sum()),
        braking_s=float(weight[against].sum()),
        turns=max(float(np.ptp(r.angles())) for r in records) / 360.0 if turning else None,
        useful_hz=_useful_hz(motions),
        levels=int(np.sum(sizes >= max(STANDS_SAMPLES, 0.005 * len(duty)))) if len(bins) else 0,
        distinct_duties=len(np.unique(np.abs(duty))),
        duty_max_pct=float(np.max(np.abs(duty), initial=0.0)),
        largest_step_pct=max(float(np.max(np.abs(np.diff(r.excitation.duties_pct)), initial=0.0)) for r in records),
        both_directions=bool(np.any(speed[runs] > 0) and np.any(speed[runs] < 0)),
        closed_loop_only=bool(reference) and all(reference),
        saturated_pct=float(100.0 * np.mean(np.abs(duty) >= 100.0 - 1e-6)),
        overlapping=overlapping(records),
        clock_s=float((max if overlapping(records) else sum)(r.seconds for r in records)),
    )
