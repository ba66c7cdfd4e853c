"""Kinematics before dynamics: what is wrong with a log's raw data, found without a model of any motor.

Thresholds come from the sensor: its step, its sample time, and the change of speed that the log itself shows to be in
reach (``fiohost.checks.counts``). A fault is harm where it adds more to the squared error of the log than its counts
do, for then the fit would take it for dynamics. Nothing is mended here.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from fiohost.checks.counts import (
    AT_SPEED,
    counts_of,
    doubt,
    jumps,
    repeats,
    spikes,
)
from fiohost.checks.finding import Case, Finding, Skipped
from fiohost.checks.order_locked import SPEED_RATIO, Ripple, ripples
from fiohost.checks.said import Said
from fiohost.checks.timing import doubtful_rows, found_step, irregular_stamps, missing_ticks, sampling_jitter
from fiohost.estimation.record import ANGLE, SPEED, Record

TURN_DEG = 360.0
REGISTERS = (256.0, 65536.0)
FULL_SCALE_PCT = 100.0
# A movement of this many counts a sample has a direction beyond doubt.
SURE_COUNTS = 2.0
# A command that rests in more of its rows than this is made of levels.
RESTS = 0.1


def _wrap(case: Case) -> float | None:
    """Counts of one turn, where the output is an angle in degrees."""
    turning = case.record.rotary and case.record.kind == ANGLE
    return TURN_DEG / case.data.quantum if turning else None


def _unwrapped(case: Case) -> tuple[Case, Finding | None]:
    """Jumps by about a whole number of turns or of a register's range, and the log without them; a tachometer counts
    nothing.
    """
    if case.record.kind == SPEED:
        return case, None
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


def _repeated(case: Case) -> tuple[np.ndarray, Iterator[Finding]]:
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


def _single(case: Case, taken: np.ndarray) -> Iterator[Finding]:
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


def _direction_bit(case: Case) -> Iterator[Finding]:
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


def _clipped(case: Case) -> Iterator[Finding]:
    """A command that runs smoothly into a ceiling and lies flat there."""
    duty = case.record.excitation.duties_pct[1:]
    top = float(np.max(np.abs(duty)))
    held = np.abs(duty) >= top * (1.0 - 1e-9)
    same = duty[1:] == duty[:-1]
    if top <= 0 or np.mean(held) > 0.5 or np.mean(same[~held[1:]]) > RESTS:
        return  # levels, not a smooth command
    if case.said.closed_loop and top >= FULL_SCALE_PCT * (1.0 - 1e-6):
        return  # a controller at full scale is no fault
    rows = np.flatnonzero(held[1:] & same) + 1
    if rows.size < max(3, 0.001 * len(duty)):
        return
    advice = (
        f"the command lies flat at {top:.4g} % in {100 * np.mean(held):.2g} % of the rows: it was limited; harmless if "
        "it was logged after the limiter, as it must be"
    )
    yield case.finding("clipped_command", False, rows, advice)


def _closure(case: Case) -> Iterator[Finding]:
    if not case.said.returns or case.record.kind != ANGLE:
        return
    off = float(case.data.counts[-1] - case.data.counts[0])
    if abs(off) > 1.0:
        advice = (
            f"the shaft was brought back to where it began, but {off:+g} counts are left: counts were lost at speed; "
            "check supply and wiring of the encoder"
        )
        yield case.finding("not_closed", True, np.array([len(case.record) - 1]), advice)


def _order_locked(cases: Sequence[Case]) -> Iterator[Finding]:
    """Ripple of the turn in every log; where one log has one speed, the other logs' speeds tell what it is."""
    seen: list[tuple[Case, Ripple]] = []
    for case in cases:
        if case.record.rotary and case.record.kind == ANGLE and case.record.unit == "deg":
            ex, quantum = case.record.excitation, case.data.quantum
            seen += [(case, r) for r in ripples(ex.times_s, case.data.counts * quantum, ex.duties_pct[1:], quantum)]
    for order in sorted({r.order for _, r in seen}):
        group = [(c, r) for c, r in seen if r.order == order]
        slow, fast = min((r for _, r in group), key=lambda r: r.slow), max((r for _, r in group), key=lambda r: r.fast)
        apart = fast.fast >= SPEED_RATIO * slow.slow
        # A torque's ripple falls with the speed at least: what falls by less than half of that is none.
        keeps = bool(fast.level > slow.level * np.sqrt(slow.slow / fast.fast))
        for case, ripple in group:
            what = f"{order} times a turn by {ripple.level:.2g} deg"
            if ripple.reading or (apart and keeps):
                advice = (
                    f"the reading wavers {what}; from {slow.slow:.3g} to {fast.fast:.3g} deg/s it fades less than a "
                    "torque's ripple would: an error of the encoder (eccentric disc, slot widths)"
                )
            elif not apart:
                advice = (
                    f"at steady speed the angle wavers {what}; one speed cannot tell an error of the encoder from a "
                    "torque: turn at twice and at half the speed"
                )
            else:
                continue
            harm = ripple.reading or (apart and keeps)
            yield Finding(case.record.name, "order_locked", harm, ripple.segments, ripple.times_s, advice)


ONE_BY_ONE: Sequence[Callable[[Case], Iterator[Finding]]] = (
    found_step,
    missing_ticks,
    doubtful_rows,
    irregular_stamps,
    sampling_jitter,
    _direction_bit,
    _clipped,
    _closure,
)


def check(records: Sequence[Record], said: Sequence[Said]) -> tuple[list[Finding], list[Skipped]]:
    """What is wrong with the raw data of logs, and which checks they could not be put to."""
    found: list[Finding] = []
    skipped: list[Skipped] = []
    cases: list[Case] = []
    for record, given in zip(records, said, strict=True):
        if given.direction is None and record.kind == ANGLE:
            skipped.append(Skipped(record.name, "direction_bit", "the log has no direction bit"))
        if not given.returns:
            why = "the log does not say (returns_to_start) that the shaft was brought back to where it began"
            skipped.append(Skipped(record.name, "not_closed", why))
        data = counts_of(record)
        if data is None:
            skipped.append(Skipped(record.name, "counts", "the readings never change"))
            continue
        case, wraps = _unwrapped(Case(record, given, data))
        rows, repeated = _repeated(case)
        found += [wraps] if wraps else []
        found += [*repeated, *_single(case, rows)]
        for look in ONE_BY_ONE:
            found += look(case)
        cases.append(case)
    return [*found, *_order_locked(cases)], skipped
