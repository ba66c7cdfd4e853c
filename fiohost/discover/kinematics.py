"""Kinematics before dynamics: what is wrong with a log's raw data, found without a model of any motor.

Thresholds come from the sensor: its step, its sample time, and the change of speed that the log itself shows to be in
reach (``fiohost.discover.counts``). A fault is harm where it adds more to the squared error of the log than its counts
do, for then the fit would take it for dynamics. Nothing is mended here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.counts import (
    AT_SPEED,
    COUNT_NOISE,
    Counts,
    counts_of,
    doubt,
    jumps,
    repeats,
    roughness,
    spikes,
    spread,
)
from fiohost.discover.order_locked import ripples
from fiohost.discover.said import Said
from fiohost.identify.record import ANGLE, Record

TIMES_SHOWN = 5
TURN_DEG = 360.0
REGISTERS = (256.0, 65536.0)
LEAST_SAMPLES = 100
# Readings roughen with speed where the moments of sampling scatter; below this the counts may do it.
ROUGHER = 2.0
FULL_SCALE_PCT = 100.0
# A movement of this many counts a sample has a direction beyond doubt.
SURE_COUNTS = 2.0


@dataclass(frozen=True)
class Finding:
    """One fault of one log: how often, when first, what it is in a sentence, and whether a fit suffers by it."""

    log: str
    name: str
    harm: bool
    count: int
    times_s: tuple[float, ...]
    advice: str

    def to_json(self) -> dict[str, object]:
        return {
            "log": self.log,
            "name": self.name,
            "severity": "harm" if self.harm else "note",
            "count": self.count,
            "times_s": list(self.times_s),
            "advice": self.advice,
        }


@dataclass(frozen=True)
class Skipped:
    """A check that a log cannot be put to, and why."""

    log: str
    name: str
    why: str

    def to_json(self) -> dict[str, str]:
        return {"log": self.log, "name": self.name, "why": self.why}


@dataclass(frozen=True)
class _Case:
    """One log under examination."""

    record: Record
    said: Said
    data: Counts

    def finding(self, name: str, harm: bool, where: np.ndarray, advice: str) -> Finding:
        """A finding at rows ``where``."""
        times = self.record.excitation.times_s[where[:TIMES_SHOWN]]
        return Finding(self.record.name, name, harm, len(where), tuple(float(t) for t in times), advice)

    def outweighs_counts(self, sizes: np.ndarray) -> bool:
        """Whether single wrong readings of these sizes in counts add as much to the log's error as its counts do."""
        return bool(np.sum(sizes**2) > COUNT_NOISE**2 * len(self.record))

    @property
    def top_speed(self) -> float:
        """Counts a tick."""
        return float(np.max(np.abs(self.data.speed())))


def _wrap(case: _Case) -> float | None:
    """Counts of one turn, where the output is an angle in degrees."""
    turning = case.record.rotary and case.record.kind == ANGLE
    return TURN_DEG / case.data.quantum if turning else None


def _unwrapped(case: _Case) -> tuple[_Case, Finding | None]:
    """Jumps by about a whole number of turns or of a register's range, and the log without them."""
    turn = _wrap(case)
    moduli = sorted({m for m in (turn, turn / 2 if turn else None, *REGISTERS) if m is not None}, reverse=True)
    data, rows, whole = case.data, np.empty(0, dtype=np.int64), 0.0
    for _ in range(3):  # what a large jump hides shows once it is gone
        size = jumps(data)
        counts = np.zeros(len(size))
        for modulus in moduli:
            times = np.rint(size / modulus)
            fits = (np.abs(times) >= 1) & (counts == 0) & (np.abs(size - times * modulus) <= doubt(data))
            counts[fits] = times[fits] * modulus
            whole = modulus if np.any(fits) and not whole else whole
        if not np.any(counts):
            break
        rows = np.union1d(rows, np.flatnonzero(counts) + 1)
        data = replace(data, counts=data.counts - np.concatenate(([0.0], np.cumsum(counts))))
    if not rows.size:
        return case, None
    advice = (
        f"the angle jumps by about {whole:g} counts within one sample: the encoder was unwrapped wrongly; "
        "set counts_per_rev (in a map: wrap) to the count at which it starts anew"
    )
    return replace(case, data=data), case.finding("wrap_mistake", True, rows, advice)


def _repeated(case: _Case) -> tuple[np.ndarray, Iterator[Finding]]:
    same, at_speed = repeats(case.data)
    rows = np.flatnonzero(same) + 1

    def tell() -> Iterator[Finding]:
        if rows.size:
            speed = case.data.speed()[rows - 1]
            advice = (
                f"the reading repeats while the shaft turns at more than {AT_SPEED:g} counts a sample, in "
                f"{100.0 * rows.size / max(at_speed, 1):.2g} % of such samples: reports arrived late or twice; "
                "drop these rows (a missing row is understood)"
            )
            yield case.finding("repeated_sample", case.outweighs_counts(speed), rows, advice)

    return rows, tell()


def _single(case: _Case, taken: np.ndarray) -> Iterator[Finding]:
    """Spikes and jumps that are no wraps; rows next to those ``taken`` by another finding are left to it."""
    near = np.zeros(len(case.record), dtype=bool)
    for shift in range(-3, 4):
        near[np.clip(taken + shift, 0, len(near) - 1)] = True
    up = spikes(case.data)
    rows = np.flatnonzero((up != 0) & ~near)
    if rows.size:
        advice = (
            f"single readings stand up to {np.max(np.abs(up[rows])):.3g} counts off both their neighbours and no "
            "shaft can do that: a damaged report or a wrong byte; drop these rows"
        )
        yield case.finding("spike", case.outweighs_counts(up[rows]), rows, advice)
    for shift in range(-3, 4):
        near[np.clip(rows + shift, 0, len(near) - 1)] = True
    step = np.concatenate(([0.0], jumps(case.data)))
    rows = np.flatnonzero((step != 0) & ~near)
    if rows.size and case.record.kind == ANGLE:
        advice = (
            f"the angle jumps by up to {np.max(np.abs(step[rows])):.3g} counts within one sample and stays there: "
            "counts were lost or added, or a row is missing that the time stamps do not show; cut the log there"
        )
        yield case.finding("jump", True, rows, advice)
    elif rows.size:
        advice = (
            f"the speed leaps by up to {np.max(np.abs(step[rows])):.3g} counts for one sample: a damaged report or "
            "a late one; drop these rows"
        )
        yield case.finding("spike", case.outweighs_counts(step[rows]), rows, advice)


def _missing_ticks(case: _Case) -> Iterator[Finding]:
    missing = case.data.whole - 1
    rows = np.flatnonzero(missing > 0) + 1
    if not rows.size:
        return
    duty = case.record.excitation.duties_pct[1:]
    per_pct = case.top_speed / max(float(np.max(np.abs(duty))), 1e-9)
    # A command that was sent in the gap is not known: the shaft may have turned this much more or less.
    unknown = per_pct * np.abs(np.diff(duty))[rows - 1] * missing[rows - 1]
    ticks = int(missing[rows - 1].sum())
    advice = f"{ticks} ticks are missing in {rows.size} gaps, the longest {int(missing.max())} ticks; "
    if case.said.ambiguous:
        advice += "in some of them the shaft may have made another turn: cut the log there"
    elif np.any(unknown > 0.5):
        advice += "the command changes across some of them and what acted in between is not known: cut the log there"
    else:
        advice += "the simulation goes on across them and nothing has to be done"
    yield case.finding("missing_ticks", bool(case.said.ambiguous or np.any(unknown > 0.5)), rows, advice)


def _stamps(case: _Case) -> Iterator[Finding]:
    """Time stamps off the grid, and whether the readings follow them."""
    off = case.data.ticks - case.data.whole
    turned = np.abs(off) * case.top_speed
    rows = np.flatnonzero(turned > 0.5) + 1
    if float(np.sqrt(np.mean(turned**2))) <= COUNT_NOISE:
        return
    speed = case.data.speed()
    fast = (np.abs(speed) > AT_SPEED) & case.data.regular
    follows = None
    if np.sum(fast) >= LEAST_SAMPLES:
        x, z = (off * speed)[fast], (case.data.steps - speed)[fast]
        follows = float(x @ z) / max(float(x @ x), 1e-300)
    scatter_ms = 1e3 * case.record.sample_time_s * float(np.std(off))
    text = f"the time stamps scatter by {scatter_ms:.2g} ms about the sample time; "
    if follows is not None and follows > 0.5:
        text += "the readings follow them, so they are true and the fit uses them as they are"
    elif follows is not None:
        text += (
            "the readings do not follow them: the target samples by its own clock; stamp rows by tick times sample time"
        )
    else:
        text += "if the target samples by its own clock, stamp rows by tick times sample time"
    yield case.finding("irregular_time_stamps", follows is None or follows <= 0.5, rows, text)


def _jitter(case: _Case) -> Iterator[Finding]:
    """Readings that roughen in proportion to speed: the moments of sampling scatter and the stamps do not say so."""
    rough, speed = roughness(case.data)
    speed = np.abs(speed)
    fast = speed > AT_SPEED
    if np.sum(fast) < 4 * LEAST_SAMPLES or np.std(case.data.ticks - case.data.whole) * case.top_speed > 0.5:
        return
    parts = np.array_split(np.flatnonzero(fast)[np.argsort(speed[fast])], 4)
    sizes = np.array([spread(rough[p]) for p in parts])
    speeds = np.array([float(np.mean(speed[p])) for p in parts])
    excess = np.sqrt(np.maximum(sizes**2 - 2.0 * COUNT_NOISE**2, 0.0)) / speeds
    if sizes[-1] < ROUGHER * COUNT_NOISE or excess.min() < 0.5 * excess.max():
        return
    scatter_ms = 1e3 * case.record.sample_time_s * float(np.median(excess))
    advice = (
        f"readings scatter in proportion to the speed, as if sampled {scatter_ms:.2g} ms rms early or late: not "
        "as regularly as the time stamps say; sample in the timer's interrupt, or log the target's own time"
    )
    yield case.finding("sampling_jitter", True, np.flatnonzero(np.abs(case.data.speed()) > AT_SPEED) + 1, advice)


def _direction_bit(case: _Case) -> Iterator[Finding]:
    bit = case.said.direction
    if bit is None or case.record.kind != ANGLE:
        return
    steps = case.data.steps
    # Two counts and more, the same way for three samples: no reversal is near, and the bit can only say one thing.
    way = np.sign(steps) * (np.abs(steps) >= SURE_COUNTS)
    sure = np.zeros(len(way), dtype=bool)
    sure[1:-1] = (way[1:-1] != 0) & (way[1:-1] == way[:-2]) & (way[1:-1] == way[2:]) & case.data.regular[1:-1]
    says = np.where(bit[1:] > 0.5, -1.0, 1.0)
    wrong = sure & (says != way)
    if not np.any(wrong):
        return
    rows, share = np.flatnonzero(wrong) + 1, float(np.mean(wrong[sure]))
    if share > 0.9:
        advice = (
            "the direction bit is the wrong way round throughout: exchange the encoder's channels A and B, or read it "
            "inverted"
        )
        harm = False
    else:
        advice = (
            f"the direction bit contradicts the movement in {100 * share:.2g} % of the clear samples: the shaft "
            "turns more than half a turn between samples, or the bit is read at another moment than the counts"
        )
        harm = bool(np.median(np.abs(steps[wrong])) > 0.25 * (_wrap(case) or np.inf))
    yield case.finding("direction_bit", harm, rows, advice)


def _clipped(case: _Case) -> Iterator[Finding]:
    """A command that runs smoothly into a ceiling and lies flat there."""
    duty = case.record.excitation.duties_pct[1:]
    top = float(np.max(np.abs(duty)))
    held = np.abs(duty) >= top * (1.0 - 1e-9)
    if top <= 0 or len(np.unique(duty)) < len(duty) / 4 or np.sum(held) < 2:
        return  # levels, not a smooth command
    if case.said.closed_loop and top >= FULL_SCALE_PCT * (1.0 - 1e-6):
        return  # a controller at full scale is no fault
    flat = held[1:] & held[:-1] & (duty[1:] == duty[:-1])
    rows = np.flatnonzero(flat) + 1
    if rows.size < max(3, 0.001 * len(duty)):
        return
    advice = (
        f"the command lies flat at {top:.4g} % in {100 * np.mean(held):.2g} % of the rows: it was limited; harmless if "
        "it was logged after the limiter, as it must be"
    )
    yield case.finding("clipped_command", False, rows, advice)


def _closure(case: _Case) -> Iterator[Finding]:
    if not case.said.returns or case.record.kind != ANGLE:
        return
    off = float(case.data.counts[-1] - case.data.counts[0])
    if abs(off) > 1.0:
        advice = (
            f"the shaft was brought back to where it began, but {off:+g} counts are left: counts were lost at speed; "
            "check supply and wiring of the encoder"
        )
        yield case.finding("not_closed", True, np.array([len(case.record) - 1]), advice)


def _order_locked(case: _Case) -> Iterator[Finding]:
    if not case.record.rotary or case.record.kind != ANGLE:
        return
    excitation, quantum = case.record.excitation, case.data.quantum
    for ripple in ripples(excitation.times_s, case.data.counts * quantum, excitation.duties_pct[1:], quantum):
        what = f"{ripple.order} times a turn by {ripple.level:.2g} {case.record.unit}"
        if ripple.reading:
            advice = (
                f"the reading wavers {what}, the same at {ripple.slow:.3g} and {ripple.fast:.3g} {case.record.unit}/s: "
                "an error of the encoder (eccentric disc, slot widths), no torque"
            )
        else:
            advice = (
                f"at steady speed the angle wavers {what}; one speed cannot tell an error of the encoder from a "
                "torque: turn at twice and at half the speed"
            )
        yield Finding(case.record.name, "order_locked", ripple.reading, ripple.segments, ripple.times_s, advice)


AFTER_WRAPS: Sequence[Callable[[_Case], Iterator[Finding]]] = (
    _missing_ticks,
    _stamps,
    _jitter,
    _direction_bit,
    _clipped,
    _closure,
    _order_locked,
)


def check(record: Record, said: Said | None = None) -> tuple[list[Finding], list[Skipped]]:
    """What is wrong with one log's raw data, and which checks it could not be put to."""
    given = said or Said()
    skipped = []
    if given.direction is None and record.kind == ANGLE:
        skipped.append(Skipped(record.name, "direction_bit", "the log has no direction bit"))
    if not given.returns:
        why = "the log does not say (returns_to_start) that the shaft was brought back to where it began"
        skipped.append(Skipped(record.name, "not_closed", why))
    data = counts_of(record)
    if data is None:
        return [], [*skipped, Skipped(record.name, "counts", "the readings never change")]
    case, wraps = _unwrapped(_Case(record, given, data))
    rows, repeated = _repeated(case)
    found = [wraps] if wraps else []
    found += [*repeated, *_single(case, rows)]
    for look in AFTER_WRAPS:
        found += look(case)
    return found, skipped
