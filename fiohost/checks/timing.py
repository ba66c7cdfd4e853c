"""Checks of a log's time: missing ticks, stamps off the grid, sampling that is less regular than the stamps say."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fiohost.checks.counts import AT_SPEED, COUNT_NOISE, ROUGHEST_COUNTS, roughness, spread
from fiohost.checks.finding import Case, Finding
from fiohost.settings import counted

LEAST_SAMPLES = 100


def missing_ticks(case: Case) -> Iterator[Finding]:
    """Gaps between rows, and whether what was commanded in them matters."""
    missing = case.data.whole - 1
    rows = np.flatnonzero(missing > 0) + 1
    if not rows.size:
        return
    duty = case.record.excitation.duties_pct[1:]
    per_pct = case.top_speed / max(float(np.max(np.abs(duty))), 1e-9)
    # A command that was sent in the gap is not known: the shaft may have turned this much more or less.
    unknown = per_pct * np.abs(np.diff(duty))[rows - 1] * missing[rows - 1]
    ticks = int(missing[rows - 1].sum())
    advice = f"{counted(ticks, 'tick')} {'is' if ticks == 1 else 'are'} missing in {counted(rows.size, 'gap')}, "
    advice += f"the longest {counted(int(missing.max()), 'tick')}; "
    if case.said.ambiguous:
        advice += "in some of them the shaft may have made another turn: cut the log there"
    elif np.any(unknown > 0.5):
        advice += "the command changes across some of them and what acted in between is not known: windows begin anew"
    else:
        advice += "the simulation goes on across them and nothing has to be done"
    yield case.finding("missing_ticks", bool(case.said.ambiguous or np.any(unknown > 0.5)), rows, advice)


def found_step(case: Case) -> Iterator[Finding]:
    """The sensor's step, and an average that smoothed it, where nobody said it and the readings show it."""
    if case.record.quantum_found:
        step = f"{case.record.quantum:.6g} {case.record.unit}"
        advice = f"all readings differ by multiples of {step}, which is taken for the sensor's step"
        yield case.finding("quantum_found", False, np.empty(0, dtype=np.int64), advice)
    average = case.record.average
    if average:
        advice = (
            f"each reading keeps {average.keeps:.4g} of the one before and takes the rest from speeds in steps of "
            f"{average.quantum:.6g} {case.record.unit}: counted, and smoothed by the logger; what counts err by is "
            "taken for smoothed too, and the lag is the effect speed_filter"
        )
        yield case.finding("average_found", False, np.empty(0, dtype=np.int64), advice)


def doubtful_rows(case: Case) -> Iterator[Finding]:
    """Single rows whose direction bits contradict all around them."""
    rows = np.array(case.record.doubtful, dtype=np.int64)
    if rows.size:
        advice = (
            f"the direction bits of {'row' if rows.size == 1 else 'rows'} {', '.join(str(r + 1) for r in rows[:10])} "
            "contradict all rows around: set aside, and windows begin anew there"
        )
        yield case.finding("doubtful_row", False, rows, advice)


def irregular_stamps(case: Case) -> Iterator[Finding]:
    """Time stamps off the grid, and whether the readings follow them."""
    if case.record.regular:
        advice = (
            "the time stamps scatter and the readings do not follow them: the target samples by its own clock; rows "
            "were taken for a tick apart"
        )
        yield case.finding("irregular_time_stamps", False, np.arange(len(case.record)), advice)
        return
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


def sampling_jitter(case: Case) -> Iterator[Finding]:
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
    if sizes[-1] < ROUGHEST_COUNTS or excess.min() < 0.5 * excess.max():
        return
    scatter_ms = 1e3 * case.record.sample_time_s * float(np.median(excess))
    advice = (
        f"readings scatter in proportion to the speed, as if sampled {scatter_ms:.2g} ms rms early or late: not "
        "as regularly as the time stamps say; sample in the timer's interrupt, or log the target's own time"
    )
    yield case.finding("sampling_jitter", True, np.flatnonzero(np.abs(case.data.speed()) > AT_SPEED) + 1, advice)
