"""A record: what was commanded, what was measured and how, as arrays ready for the kernel."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import median_filter

from fiohost.errors import DataError
from fiohost.estimation.stamps import doubtful_modes, known_segments, true_times
from fiohost.motor.model import MM_PER_M
from fiohost.motor.simulate import Excitation
from fiohost.noise.average import Average, found_average
from fiohost.noise.quantum import found_quantum

if TYPE_CHECKING:
    from fiohost.bench.log import Log
    from fiohost.noise.disturbance import Disturbance

ANGLE, SPEED, MEAN_SPEED = 0, 1, 2
REST_SAMPLES = 5
SHORTEST = 20
# Multiples of the golden ratio are spread evenly, and in step with nothing.
GOLDEN = 0.6180339887498949
# Standstill of one reading counts for no more than so much motion.
REST_COUNTS_S = 0.05
BRAKE = 2
# The noise gain of fourth differences, and a median of sizes taken for a normal distribution's.
FOURTH_DIFFERENCE, TO_SIGMA = 70.0**0.5, 1.4826
# A reading stands off by more than the noise that fourth differences show, if by so many sigmas.
SURE_SIGMAS = 4.0
# Running medians over so long take the fast noise off.
SMOOTH_S = 0.05
# The mean of a normal variable's absolute value.
MEAN_OF_NORMAL = 0.7978845608
# A linear axis is held in millimetres: what is sized for degrees (trials, bounds, steps of the library) then fits it.
HELD_IN = {"m": "mm", "m/s": "mm/s"}


def speed_unit(unit: str) -> str:
    """The unit of speed that goes with an output's unit."""
    return unit if unit.endswith("/s") else f"{unit}/s"


@dataclass(frozen=True)
class Record:
    """One log as evidence.

    ``y`` (n) is the measured output in ``unit`` (of a linear axis mm or mm/s), of kind ``ANGLE``, ``SPEED`` (at the
    instant) or ``MEAN_SPEED`` (over the interval before the sample); ``begun_deg`` is how far the shaft had turned
    by then since a log of speeds began. ``quantum`` is the sensor's step in that unit (0 where unknown).
    ``at_rest`` says that the shaft stands still at the first sample, ``own_zero`` that nobody knows where on the
    bench's turn its angle is zero, ``wraps`` that its counter says no whole turns (``ahead_deg`` are those that
    were added to what its log says), ``begins`` that the bench's own time does with it. ``pwm_hz`` is the frequency
    of the bridge's PWM, 0 where unknown. ``weights`` (n) are by what whole runs weigh the readings' errors,
    ``windows`` (m + 1) the edges of one-second windows, of which only ``every`` so many are looked at: what is
    fitted to them is an array of their samples (k) alone. ``segments`` (n) number the stretches within which all
    commands are known, -1 where one acts that is not; no window spans two. ``doubtful`` are rows whose command was
    set aside, ``regular`` says that stamps were taken for those of a regular clock, ``quantum_found`` that the
    quantum is from the readings; ``noise_rms`` is the sensor's where declared, ``average`` that through which its
    logger smoothed counted speeds. With a ``disturbance`` windows are whitened, and bootstrap samples are drawn
    with it.
    """

    name: str
    excitation: Excitation
    y: np.ndarray
    kind: int
    unit: str
    quantum: float
    sample_time_s: float
    at_rest: bool
    rotary: bool
    own_zero: bool = False
    begun_deg: float = 0.0
    wraps: bool = False
    ahead_deg: float = 0.0
    begins: bool = False
    pwm_hz: float = 0.0
    windows: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    every: int = 1
    weights: np.ndarray = field(default_factory=lambda: np.empty(0))
    segments: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    doubtful: tuple[int, ...] = ()
    regular: bool = False
    quantum_found: bool = False
    noise_rms: float | None = None
    average: Average | None = None
    disturbance: Disturbance | None = None

    def __len__(self) -> int:
        return len(self.y)

    @property
    def broken(self) -> bool:
        """Whether commands are missing, so that a whole run cannot be followed."""
        return bool(len(self.segments)) and int(self.segments[0]) != int(self.segments[-1])

    @property
    def seconds(self) -> float:
        return float(self.excitation.times_s[-1] - self.excitation.times_s[0])

    def angles(self, y: np.ndarray | None = None) -> np.ndarray:
        """Where the shaft was at each sample (n) as the readings, or ``y`` (n) in their place, have it: mean speeds add
        up to how far it has turned since its log began, and so do speeds, about, by trapezoids.
        """
        y = self.y if y is None else y
        if self.kind == ANGLE:
            return y
        steps_s = np.diff(self.excitation.times_s)
        turns = steps_s * (y[1:] if self.kind == MEAN_SPEED else 0.5 * (y[1:] + y[:-1]))
        return np.concatenate(([self.begun_deg], self.begun_deg + np.cumsum(turns)))

    @cached_property
    def smooth(self) -> np.ndarray:
        """Readings (n) without their fast noise: running medians, which leave an end of travel where it is."""
        return np.asarray(
            median_filter(self.y, size=2 * round(0.5 * SMOOTH_S / self.sample_time_s) + 1, mode="nearest")
        )

    @cached_property
    def scatter(self) -> float:
        """Rms of the readings' fast noise beyond their counts, about: what second differences say of it."""
        bends = np.diff(self.y, 2)
        variance = (float(np.mean(np.abs(bends))) / MEAN_OF_NORMAL) ** 2 / 6.0 if len(bends) else 0.0
        return float(np.sqrt(max(variance - self.quantum**2 / 12.0, 0.0)))

    @cached_property
    def sure(self) -> np.ndarray:
        """How sure each reading (n) is of where a window began: all alike, less where a random torque has moved it."""
        whitener = self.disturbance.whitener if self.disturbance else None
        return whitener.sure if whitener else np.ones(len(self))

    def speed_at(self, i: int) -> float:
        """The speed that is seen from a sample on, in the output's unit per second where that is an angle."""
        if self.kind != ANGLE:
            return float(self.y[i])
        last = min(i + max(round(SMOOTH_S / self.sample_time_s), 1), len(self) - 1)
        return float(
            (self.y[last] - self.y[i]) / max(self.excitation.times_s[last] - self.excitation.times_s[i], 1e-12)
        )

    @cached_property
    def looked_at(self) -> tuple[np.ndarray, np.ndarray]:
        """The first sample of every window that is looked at, and that after its last: evenly spread, but not in step
        with anything that repeats itself.
        """
        chosen = (np.arange(len(self.windows) - 1) * GOLDEN) % 1.0 < 1.0 / self.every
        return self.windows[:-1][chosen], self.windows[1:][chosen]

    @cached_property
    def behind_gaps(self) -> np.ndarray:
        """Which of the windows that are looked at begin where commands of a gap acted since the one before."""
        segments = self.segments[self.looked_at[0]] if self.broken else np.empty(0)
        return np.flatnonzero(np.diff(segments, prepend=segments[:1]))

    @property
    def edges(self) -> np.ndarray:
        """Where windows begin and end (m + 1) among the samples of those that are looked at, one after the other."""
        return one_by_one(*self.looked_at)

    @cached_property
    def rows(self) -> np.ndarray:
        """Which of the record's samples (k) those of the windows that are looked at are, one after the other."""
        firsts, lasts = self.looked_at
        edges = self.edges
        return np.asarray(np.arange(edges[-1]) + np.repeat(firsts - edges[:-1], lasts - firsts))

    @property
    def acting_pct(self) -> np.ndarray:
        """Duty (n) in percent that acts at each sample."""
        ex = self.excitation
        return ex.duties_pct[np.searchsorted(ex.act_times_s, ex.times_s, side="right")]

    def first_second(self) -> int:
        """Number of samples in the first second, at least a handful."""
        times = self.excitation.times_s
        return min(max(int(np.searchsorted(times, times[0] + 1.0)), REST_SAMPLES), len(self))


def thinned(record: Record, step_s: float) -> Record:
    """A record with readings about so far apart, all commands as they are; itself where they are not closer.

    Readings of a millisecond weigh accelerations that no model of a motor follows; of a mean speed those between are
    averaged.
    """
    every = int(step_s / record.sample_time_s + 1e-9)
    if every < 2:
        return record
    rows = np.arange(0, len(record), every)
    y = record.y[rows]
    if record.kind == MEAN_SPEED:
        sums = np.cumsum(record.y)
        y = np.concatenate((y[:1], np.diff(sums[rows]) / every))
    times, segments = record.excitation.times_s[rows], record.segments[rows]
    quantum = record.quantum / (every if record.kind == MEAN_SPEED else 1)
    noise_rms = record.noise_rms
    if noise_rms is not None and record.kind == MEAN_SPEED:
        noise_rms /= float(np.sqrt(every))
    sample_time_s = record.sample_time_s * every
    return replace(
        record,
        excitation=replace(record.excitation, times_s=times),
        y=y,
        quantum=quantum,
        noise_rms=noise_rms,
        average=record.average.of_every(every) if record.average else None,
        sample_time_s=sample_time_s,
        segments=segments,
        windows=cut_windows(times, segments=segments),
        weights=rest_weights(y, record.kind, quantum, sample_time_s),
    )


def one_by_one(firsts: np.ndarray, lasts: np.ndarray) -> np.ndarray:
    """Edges (m + 1) of windows from ``firsts`` up to ``lasts`` (m each) where nothing is kept between them."""
    return np.concatenate(([0], np.cumsum(lasts - firsts)))


def cut_windows(times_s: np.ndarray, length_s: float = 1.0, segments: np.ndarray | None = None) -> np.ndarray:
    """Boundaries (m + 1) of consecutive windows of one length; a last piece under half a window joins the one
    before.

    No window spans two ``segments`` (n); a row where an unknown command acts (-1) is a window of its own, which fits
    anything.
    """
    if segments is not None and len(segments) and (segments != segments[0]).any():
        ends = [0, *(np.flatnonzero((np.diff(segments) != 0) | (segments[1:] < 0)) + 1).tolist(), len(times_s)]
        parts = [a + cut_windows(times_s[a:b], length_s)[:-1] for a, b in zip(ends[:-1], ends[1:], strict=True)]
        return np.concatenate([*parts, [len(times_s)]]).astype(np.int64)
    marks = np.arange(times_s[0], times_s[-1] + length_s, length_s)
    edges = np.unique(np.concatenate((np.searchsorted(times_s, marks - 1e-9), [len(times_s)])))
    if len(edges) > 2 and times_s[-1] - times_s[edges[-2]] < 0.5 * length_s:
        edges = np.delete(edges, -2)
    return edges.astype(np.int64)


def rest_weights(y: np.ndarray, kind: int, quantum: float, sample_time_s: float) -> np.ndarray:
    """Square roots of weights (n) by which all standstill at one reading counts as ``REST_COUNTS_S`` of motion.

    Readings of a shaft at rest err alike, by where within its count it stands: together they are one piece of evidence,
    and least squares that take them for many pull the model to the middle of that count.
    """
    if kind != ANGLE or quantum <= 0.0:
        return np.ones(len(y))
    edges = np.flatnonzero(np.diff(y)) + 1
    lengths = np.diff(np.concatenate(([0], edges, [len(y)])))
    most = max(REST_COUNTS_S / sample_time_s, 1.0)
    return np.asarray(np.repeat(np.sqrt(np.minimum(most / lengths, 1.0)), lengths))


def make_record(
    name: str,
    times_s: np.ndarray,
    duty_pct: np.ndarray,
    y: np.ndarray,
    *,
    mode: np.ndarray | None = None,
    kind: int = ANGLE,
    unit: str = "deg",
    quantum: float = 0.0,
    sample_time_s: float | None = None,
    command_delay_s: float = 0.0,
    rotary: bool = True,
    at_rest: bool | None = None,
    clock_s: float = 0.0,
    own_zero: bool = False,
    segments: np.ndarray | None = None,
) -> Record:
    """Build a record from columns (n each): times in s, signed duty in percent, measured output in ``unit``.

    ``at_rest`` says that the shaft stands still at the first sample; None judges by the samples, and then the speed is
    estimated unless they are all equal. What acted before the first row is not recorded: it is taken as the first
    command where the shaft is clearly in motion, else as brake. ``segments`` (n) number the stretches of known
    commands; None: all are known. Raises DataError if there is too little to work on.
    """
    if len(times_s) < SHORTEST:
        raise DataError(f"{name}: {len(times_s)} samples are too few, at least {SHORTEST} are needed")
    times = np.ascontiguousarray(times_s - times_s[0], dtype=np.float64)
    modes = np.ones(len(times), dtype=np.int64) if mode is None else np.asarray(mode, dtype=np.int64)
    output = np.ascontiguousarray(y, dtype=np.float64)
    if at_rest is None:
        at_rest = bool(np.ptp(output[:REST_SAMPLES]) == 0.0) if kind == ANGLE else bool(output[0] == 0.0)
    moving = not at_rest and _in_motion(output, kind, quantum)
    before = (float(duty_pct[0]), int(modes[0])) if moving else (0.0, BRAKE)
    excitation = Excitation(
        times_s=times,
        act_times_s=times + command_delay_s,
        duties_pct=np.concatenate(([before[0]], np.asarray(duty_pct, dtype=np.float64))),
        modes=np.concatenate(([before[1]], modes)),
        clock_s=clock_s,
    )
    step = float(np.median(np.diff(times))) if sample_time_s is None else sample_time_s
    return Record(
        name=name,
        excitation=excitation,
        y=output,
        kind=kind,
        unit=unit,
        quantum=quantum,
        sample_time_s=step,
        at_rest=at_rest,
        rotary=rotary,
        own_zero=own_zero,
        segments=np.zeros(len(times), dtype=np.int64) if segments is None else segments,
        windows=cut_windows(times, segments=segments),
        weights=rest_weights(output, kind, quantum, step),
    )


def _in_motion(y: np.ndarray, kind: int, quantum: float) -> bool:
    """Whether the first samples show more motion than a start from rest could, and more than readings scatter by."""
    noise = SURE_SIGMAS * TO_SIGMA * float(np.median(np.abs(np.diff(y, n=4)))) / FOURTH_DIFFERENCE
    if kind == ANGLE:
        least = max(3.0 * quantum, float(np.sqrt(2.0)) * noise)
        return bool(abs(y[2] - y[0]) >= least) if least > 0.0 else bool(y[1] != y[0])
    return bool(abs(y[0]) > max(2.0 * quantum, noise))


def acting_duty(duty_pct: np.ndarray, duty_steps: int) -> np.ndarray:
    """The duty (n) that acts when a target's timer truncates it to one of ``duty_steps``; 0 steps: as it is.

    The wire carries a 32-bit float, and the target computes with that.
    """
    if duty_steps <= 0:
        return duty_pct
    sent = duty_pct.astype(np.float32).astype(np.float64)
    return np.asarray(np.trunc(sent * (duty_steps / 100.0)) * (100.0 / duty_steps))


def record_from_log(log: Log, name: str | None = None) -> Record:
    """The record of a log: its output whatever it is, its commands with what is known of the bench.

    Known are the delay until a command acts and the steps of the target's timer; neither is ever a missing effect.
    Metres become millimetres. Stamps that the readings contradict are taken for those of a regular clock, a single row
    whose direction bits contradict all around it is set aside, windows begin anew after missing ticks, and a sensor's
    step that nobody says is looked for in its readings.
    """
    output = log.output_name
    kind = ANGLE if output in ("angle_deg", "position_m") else SPEED
    if kind == SPEED and log.output_average == "previous_interval":
        kind = MEAN_SPEED
    scale = MM_PER_M if log.output_unit in HELD_IN else 1.0
    y, step_s = log.output * scale, log.sample_time_s
    duty = acting_duty(log.duty_pct, log.duty_steps)
    times = true_times(log.time_s, y, step_s) if kind == ANGLE else log.time_s
    mode, doubtful = doubtful_modes(log.mode, duty)
    delay_s = log.command_delay_ticks * step_s
    quantum = log.output_quantum * scale or found_quantum(y)
    noise = log.output_noise_rms
    record = make_record(
        name or (log.path.name if log.path else "log"),
        times,
        duty,
        y,
        mode=mode,
        kind=kind,
        unit=HELD_IN.get(log.output_unit, log.output_unit),
        quantum=quantum,
        sample_time_s=step_s,
        command_delay_s=delay_s,
        rotary=output in ("angle_deg", "speed_deg_s"),
        own_zero=(log.pos_reset and output == "angle_deg") or output == "speed_deg_s",
        clock_s=log.bench_time_s,
        at_rest=None if log.begins_at_rest and (len(y) < 2 or y[0] != y[1]) else log.begins_at_rest,
        segments=known_segments(times, duty, mode, doubtful, step_s, delay_s),
    )
    return replace(
        record,
        pwm_hz=log.pwm_hz,
        doubtful=doubtful,
        regular=times is not log.time_s,
        quantum_found=quantum > 0.0 and log.output_quantum <= 0.0,
        noise_rms=None if noise is None else noise * scale,
        average=found_average(y, duty, quantum) if kind == SPEED else None,
        wraps=output == "angle_deg" and "pos" in log.columns and not log.pos_reset,
    )
