"""The log of one run, schema ``fiohost.log/1``: read with distrust, written row by row.

The file is CSV: lines ``# key: value``, one header row, rows. The reader (:class:`Log`) uses what is whole and keeps
a sentence for everything that it left out or doubts (``Log.dropped``); what nobody could use is a LogError. The
writer is :class:`fiohost.bench.writer.LogWriter`.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiohost import files
from fiohost.bench.head import MAX_LINE_CHARS, MAX_METADATA_LINES, OUTPUT_UNITS, check_names, needed_columns, read_head
from fiohost.bench.integrity import ALTERED, judge
from fiohost.bench.rows import after_line, parse_rows
from fiohost.bench.unwrap import ambiguous_steps, unwrap_counts
from fiohost.bench.writer import SCHEMA, LogWriter
from fiohost.errors import LogError
from fiohost.settings import counted, nearest
from fiohost.wire.messages import BRAKE, DRIVE, STANDBY

__all__ = ["BRAKE", "DRIVE", "OUTPUT_UNITS", "STANDBY", "Log", "LogWriter"]

FloatArray = NDArray[np.float64]

MAX_LOG_BYTES = 640_000_000  # 10 million rows with every column that a run writes, some 14 hours at 5 ms, and more
HEAD_BYTES = MAX_METADATA_LINES * MAX_LINE_CHARS
BYTE_ORDER_MARK = b"\xef\xbb\xbf"
MAX_NUMBER = 1e12  # of a time (s) or an output: beyond it no shaft turns and no run lasts; squares stay finite
BLOCK_ROWS = 1 << 15  # that are looked at at a time: they stay near the processor
MAX_EMPTY_TICKS = 20  # missing ticks per row, beyond a million: more is a broken time column, not a gap
DUTY_TOLERANCE_PCT = 0.01
DEFAULT_COUNTS_PER_REV = 720
IMPORTED = "import"  # the target of a log that was made of a foreign table
FOUND = "found"  # the name of a map of it that nobody wrote

_AVERAGES = ("instant", "previous_interval")


@dataclass(frozen=True, eq=False, repr=False)
class Log:
    """One run: numbers by column (each of shape (rows,)), the file's metadata, and what the reader left out.

    Gaps stay gaps: a missing tick is a missing row, never an invented one.
    """

    metadata: dict[str, str]
    columns: dict[str, FloatArray]
    path: Path
    sha256: str  # of the file's bytes
    dropped: tuple[str, ...] = ()

    def __repr__(self) -> str:
        whole = len(self) > 1
        seconds = f", {float(self.time_s[-1] - self.time_s[0]):.4g} s" if whole else ""
        return f"<Log {self.path}: {len(self)} rows{seconds} of {', '.join(self.columns)}>"

    # ---- making one -------------------------------------------------------------------------------------------

    @classmethod
    def read(cls, path: str | Path) -> Log:
        """Read a log file. Raises LogError where it cannot be read, is no log, or holds nothing whole."""
        path = Path(path)
        data = files.read_input(path, MAX_LOG_BYTES, "the log", LogError)
        whole = data.rstrip(b"\0")  # a crashed machine may leave a tail of zeros
        with ThreadPoolExecutor(1) as beside:  # sums let go of the interpreter's lock
            digest, judging = beside.submit(_sha256, data), beside.submit(judge, data)
            notes = [f"{len(data) - len(whole)} zero bytes at the end of the file"] if len(whole) < len(data) else []
            del data
            metadata, columns, left_out = _parsed(whole, path)
            judged = judging.result()
        if judged.state == ALTERED:
            notes.append(f"nothing, but the file was altered since it was written: {'; '.join(judged.notes)}")
        return cls._checked(metadata, columns, path, digest.result(), notes + left_out)

    @classmethod
    def parse(
        cls, text: str, *, path: str | Path = "(memory)", sha256: str | None = None, dropped: Sequence[str] = ()
    ) -> Log:
        """Make a log of its text. *dropped* are sentences that the caller already has to say. Raises LogError."""
        data = text.encode()
        metadata, columns, left_out = _parsed(data, Path(path))
        return cls._checked(metadata, columns, Path(path), sha256 or _sha256(data), [*dropped, *left_out])

    @classmethod
    def from_columns(
        cls, columns: Mapping[str, Any], metadata: Mapping[str, str] | None = None, path: str | Path = "(memory)"
    ) -> Log:
        """Make a log of arrays in memory (simulated data, tests); the same checks as for a file. Raises LogError."""
        arrays = {name: np.array(values, dtype=np.float64) for name, values in columns.items()}
        if len({a.shape for a in arrays.values()}) > 1 or any(a.ndim != 1 for a in arrays.values()):
            raise LogError(f"{path}: the columns of a log are arrays of one length")
        check_names(list(arrays), Path(path))
        digest = hashlib.sha256(repr(sorted((metadata or {}).items())).encode())
        for name in sorted(arrays):
            digest.update(name.encode() + arrays[name].tobytes())
        return cls._checked(dict(metadata or {}), arrays, Path(path), digest.hexdigest(), [])

    @classmethod
    def _checked(
        cls, metadata: dict[str, str], columns: dict[str, FloatArray], path: Path, sha256: str, notes: list[str]
    ) -> Log:
        needed = needed_columns(list(columns))
        if not all(_largest(columns[name]) <= MAX_NUMBER for name in needed):
            whole = np.logical_and.reduce([np.abs(columns[name]) <= MAX_NUMBER for name in needed])
            first = int(np.argmin(whole))
            notes.append(
                f"{int(np.sum(~whole))} rows with missing or infinite numbers, or beyond {MAX_NUMBER:g} (the first is "
                f"row {first + 1})"
            )
            columns = {name: values[whole] for name, values in columns.items()}
        for name, values in columns.items():  # a picture of what is beyond cannot be drawn either
            if name not in needed and not _largest(values) <= MAX_NUMBER and np.any(np.abs(values) > MAX_NUMBER):
                columns[name] = np.where(np.abs(values) > MAX_NUMBER, np.nan, values)
                notes.append(f"numbers beyond {MAX_NUMBER:g} in column {name}")
        time_s = columns["time_s"]
        steps_s = np.diff(time_s)
        least_s = steps_s.min(initial=math.inf)
        if least_s < 0:
            row = int(np.argmax(steps_s < 0)) + 1
            raise LogError(
                f"{path}: time runs backwards at row {row + 1} ({time_s[row - 1]:g} s, then {time_s[row]:g} s); "
                "two runs in one file must be split"
            )
        if least_s == 0:
            keep = np.concatenate(([True], steps_s > 0))
            notes.append(f"{int(np.sum(~keep))} rows that repeat the time of the row before")
            columns, steps_s = {name: values[keep] for name, values in columns.items()}, steps_s[keep[1:]]
        if not columns["time_s"].size:
            raise LogError(f"the log {path} holds no whole row" + (f" (dropped: {'; '.join(notes)})" if notes else ""))
        for values in columns.values():
            values.setflags(write=False)
        log = cls(metadata, columns, path, sha256, tuple(notes))
        return cls(metadata, columns, path, sha256, (*notes, *log._doubts(steps_s)))

    def stretches(self, rows: int, count: int) -> list[Log]:
        """Logs of *rows* rows in all, *count* stretches spread evenly from the first row to the last; each says so. The
        log itself where it has no more.
        """
        if len(self) <= rows:
            return [self]
        each = rows // count
        note = f"all but {count} stretches of {each} rows, spread evenly over its {len(self)} rows"
        return [
            Log(
                self.metadata if begin == 0 else {**self.metadata, "begins": "moving"},
                {name: values[begin : begin + each].copy() for name, values in self.columns.items()},
                self.path,
                self.sha256,
                (*self.dropped, note),
            )
            for begin in (k * (len(self) - each) // max(1, count - 1) for k in range(count))
        ]

    # ---- what it says -----------------------------------------------------------------------------------------

    def __len__(self) -> int:
        return int(self.time_s.size)

    @property
    def time_s(self) -> FloatArray:
        """Seconds since the run began, shape (rows,), strictly increasing."""
        return self.columns["time_s"]

    @property
    def duty_pct(self) -> FloatArray:
        """Signed command of each tick in percent of full scale."""
        return self.columns["duty_pct"]

    @cached_property
    def mode(self) -> NDArray[np.int8]:
        """What the bridge was told on each row: DRIVE (1), BRAKE (2) or STANDBY (0); without c3 and c4 all DRIVE."""
        if "c3" not in self.columns or "c4" not in self.columns:
            return np.full(len(self), DRIVE, dtype=np.int8)
        c3, c4 = self.columns["c3"] == 1.0, self.columns["c4"] == 1.0
        return np.where(c3 & c4, BRAKE, np.where(c3 | c4, DRIVE, STANDBY)).astype(np.int8)

    @property
    def output_name(self) -> str:
        """``angle_deg`` (also where it comes from pos), ``speed_deg_s``, ``position_m`` or ``speed_m_s``."""
        return "angle_deg" if "pos" in self.columns else next(n for n in OUTPUT_UNITS if n in self.columns)

    @property
    def output_unit(self) -> str:
        return OUTPUT_UNITS[self.output_name]

    @cached_property
    def output(self) -> FloatArray:
        """The measured output, shape (rows,), in :attr:`output_unit`; an angle is unwrapped and starts at POS/2."""
        if "pos" not in self.columns:
            return self.columns[self.output_name]
        return unwrap_counts(self.columns["pos"], self.counts_per_rev) * (360.0 / self.counts_per_rev)

    @property
    def output_quantum(self) -> float:
        """Size of one count in the output's unit; 0 where it is not known."""
        if "pos" in self.columns:
            return 360.0 / self.counts_per_rev
        return self._number("output_quantum", 0.0, low=0.0)

    @property
    def output_noise_rms(self) -> float | None:
        """Noise of the sensor beside its counts, rms in the output's unit; None where nobody says it."""
        if not self.metadata.get("output_noise_rms", "").strip():
            return None
        return self._number("output_noise_rms", math.nan, low=0.0)

    @property
    def output_average(self) -> str:
        """``instant``, or ``previous_interval``: the mean speed of the interval that ended at the row."""
        value = self.metadata.get("output_average", "instant")
        if value not in _AVERAGES:
            raise LogError(f"{self.path}: output_average is {value!r}; {nearest(value, _AVERAGES)}")
        return value

    @cached_property
    def sample_time_s(self) -> float:
        """Seconds between ticks: the metadata's, else the median distance of rows."""
        return self._sample_time_s(np.diff(self.time_s))

    def _sample_time_s(self, steps_s: FloatArray) -> float:
        stated = self._number("sample_time_s", 0.0, low=0.0, high=3600.0)
        if len(self) < 2:
            if not stated:
                raise LogError(f"{self.path}: one row and no sample_time_s in the metadata")
            return stated
        if stated and 2 * np.count_nonzero(steps_s < 0.7 * stated) < steps_s.size:
            return stated  # the median is no smaller
        step = float(np.median(steps_s))
        if not stated:
            return step
        if step < 0.7 * stated:
            raise LogError(
                f"{self.path}: the metadata say sample_time_s = {stated:g}, but rows are {step:g} s apart: one is wrong"
            )
        return stated

    @cached_property
    def tick(self) -> NDArray[np.int64]:
        """Tick of each row, counted from the first; more than one apart where ticks are missing."""
        return np.asarray(np.rint((self.time_s - self.time_s[0]) / self.sample_time_s), dtype=np.int64)

    @property
    def command_delay_ticks(self) -> int:
        """Ticks from a row's encoder reading until its command acts; 0 where the metadata do not say."""
        return int(self._number("command_delay_ticks", 0.0, low=0.0, high=10_000.0, whole=True))

    @property
    def command_delay_stated(self) -> bool:
        """Whether somebody said so: a map that was found knows nothing of it."""
        return bool(self.metadata.get("command_delay_ticks", "").strip()) and self.metadata.get("map") != FOUND

    @property
    def counts_per_rev(self) -> int:
        return int(self._number("counts_per_rev", DEFAULT_COUNTS_PER_REV, low=1.0, high=1e9, whole=True))

    @property
    def bench_time_s(self) -> float:
        """Time of the first row since the bench was opened; 0 where it is not known."""
        return self._number("bench_time_s", 0.0, low=0.0)

    @property
    def duty_steps(self) -> int:
        """Timer counts of a PWM period, to which the target truncates each command; 0 where it is not known."""
        return int(self._number("duty_steps", 0.0, low=0.0, high=1e10, whole=True))

    @property
    def pwm_hz(self) -> float:
        """Frequency of the bridge's PWM in Hz; 0 where it is not known."""
        return self._number("pwm_hz", 0.0, low=0.0, high=1e9)

    @property
    def begins_at_rest(self) -> bool | None:
        """Whether the shaft stood still before the first row, for which the bench waits; None where nobody says.

        Raises LogError where the metadata say something else.
        """
        told = self.metadata.get("begins", "").strip()
        if told not in ("", "at rest", "moving"):
            raise LogError(
                f"{self.path}: the metadata say begins = {told[:40]!r}, which is neither 'at rest' nor 'moving'"
            )
        return {"at rest": True, "moving": False}.get(told)

    @property
    def pos_reset(self) -> bool:
        """True where the zero of POS is not the one of the bench's other logs."""
        return self.metadata.get("pos_reset", "false").strip().lower() in ("true", "1", "yes")

    @cached_property
    def ambiguous_rows(self) -> NDArray[np.int64]:
        """Rows before which the shaft may have turned further than the shortest path says (long gaps, high speed)."""
        if "pos" not in self.columns:
            return np.zeros(0, dtype=np.int64)
        return ambiguous_steps(self.columns["pos"], self.time_s, self.sample_time_s, self.counts_per_rev) + 1

    # ---- checks -----------------------------------------------------------------------------------------------

    def _number(self, key: str, default: float, *, low: float, high: float = math.inf, whole: bool = False) -> float:
        text = self.metadata.get(key, "").strip()
        if not text:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (low <= value <= high and math.isfinite(value)) or (whole and value != int(value)):
            raise LogError(f"{self.path}: the metadata say {key} = {text[:40]!r}, which is no sensible number")
        return value

    def _doubts(self, steps_s: FloatArray) -> list[str]:
        """Refuse what is no log; return sentences on gaps and doubtful angles. *steps_s* are from row to row."""
        schema = self.metadata.get("schema", SCHEMA)
        if schema != SCHEMA:
            raise LogError(f"{self.path}: schema is {schema[:60]!r}, this version reads {SCHEMA!r}")
        self._check_range("duty_pct", -100.0 - DUTY_TOLERANCE_PCT, 100.0 + DUTY_TOLERANCE_PCT)
        for bit in ("c3", "c4"):
            if bit in self.columns:
                self._check_range(bit, 0.0, 1.0, whole=True)
        if "pos" in self.columns:
            self._check_range("pos", 0.0, self.counts_per_rev - 1.0, whole=True)
        _ = self.output_average, self.output_quantum, self.output_noise_rms, self.command_delay_ticks, self.pwm_hz
        if len(self) < 2:
            return []
        sample_s = self._sample_time_s(steps_s)
        if steps_s.sum() / sample_s > MAX_EMPTY_TICKS * len(self) + 1_000_000:
            raise LogError(
                f"{self.path}: {len(self)} rows over {self.time_s[-1] - self.time_s[0]:g} s with a sample time of "
                f"{self.sample_time_s:g} s: nearly all ticks are missing, or the time column is broken"
            )
        doubts = []
        if steps_s.max() / sample_s >= 1.5:
            gaps = np.rint(steps_s / sample_s).astype(np.int64) - 1
            worst, missing = int(np.argmax(gaps)), int(gaps.clip(0).sum())
            doubts.append(
                f"{counted(missing, 'tick')} {'is' if missing == 1 else 'are'} missing "
                f"in {counted(int(np.sum(gaps > 0)), 'gap')} "
                f"(the longest: {counted(int(gaps[worst]), 'tick')} after {self.time_s[worst]:g} s)"
            )
        if self.ambiguous_rows.size:
            row = int(self.ambiguous_rows[0])
            doubts.append(
                f"the angle is ambiguous from row {row + 1} ({self.time_s[row]:g} s) on: the shaft may have made "
                "another turn while ticks were missing"
            )
        return doubts

    def _check_range(self, name: str, low: float, high: float, *, whole: bool = False) -> None:
        for begin, values in _blocks(self.columns[name]):
            bad = (values < low) | (values > high)
            if whole:
                bad |= values != np.rint(values)
            if np.any(bad):
                at = int(np.argmax(bad))
                kind = "a whole number in " if whole else "in "
                raise LogError(
                    f"{self.path}: {name} = {values[at]:g} in row {begin + at + 1} is not {kind}{low:g}..{high:g}"
                )


def _blocks(values: FloatArray) -> Iterator[tuple[int, FloatArray]]:
    """Some rows at a time, and where they begin."""
    return ((begin, values[begin : begin + BLOCK_ROWS]) for begin in range(0, values.size, BLOCK_ROWS))


def _largest(values: FloatArray) -> float:
    """Of the magnitudes; NaN where one is."""
    return float(np.max([np.abs(block).max() for _, block in _blocks(values)], initial=0.0))


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def _parsed(data: bytes, path: Path) -> tuple[dict[str, str], dict[str, FloatArray], list[str]]:
    """Metadata, columns as they stand, and sentences on what is left out. Raises LogError."""
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n")
    begin = len(BYTE_ORDER_MARK) if data.startswith(BYTE_ORDER_MARK) else 0
    if len(data) == begin or data[begin:].isspace():
        raise LogError(f"the log {path} is empty")
    if b"\0" in data[:MAX_LINE_CHARS]:
        raise LogError(f"{path} is not a log: it holds zero bytes")
    end = data.rfind(b"\n") + 1
    notes = ["the last line, which is cut off in its middle"] if end < len(data) else []
    stop = begin  # of the head, and of a few rows
    for _ in range(MAX_METADATA_LINES + 1):
        stop = after_line(data, stop) if stop < begin + HEAD_BYTES else stop
    head = _decoded(data, begin, min(stop, end), path)
    metadata, names, start, first_line = read_head(head, path)
    check_names(names, path)
    start = begin + len(head[:start].encode())
    table = parse_rows(data, start, end, names, needed_columns(names), first_line, str(path))
    return metadata, table.columns, notes + list(table.notes)


def _decoded(data: bytes, start: int, stop: int, path: Path) -> str:
    """Raises LogError."""
    try:
        return data[start:stop].decode()
    except UnicodeDecodeError as exc:
        raise LogError(f"{path} is not a log: byte {start + exc.start} is not UTF-8 text") from exc
