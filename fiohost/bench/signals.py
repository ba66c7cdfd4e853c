"""Test signals: what a command or a reference does over time, as data.

A signal is a frozen dataclass with a ``duration_s``; ``values(time_s)`` gives its level at each time of an array of
shape (n,), counted from the signal's own start. Levels are in percent of full scale for a command, in degrees for a
reference; in a TOML file the key says which (``levels_pct``, ``low_deg``). Random signals hold their own seed, so that
an experiment is the same each time.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, Field, dataclass, field, fields
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from fiohost.errors import ConfigError
from fiohost.settings import Table, nearest

FloatArray = NDArray[np.float64]

MAX_DURATION_S = 86_400.0
_EPS = 1e-9  # of a step: a time that is a multiple of the step belongs to the step that begins
UNIT_LIMITS = {"pct": 100.0, "deg": 1e6}  # the largest level by unit of the key


def _level(**more: Any) -> Any:
    """A field in the unit of the signal; its key in a file ends with that unit."""
    return field(metadata={"level": True}, **more)


def _positive(low: float = 1e-3, high: float = MAX_DURATION_S, **more: Any) -> Any:
    return field(metadata={"low": low, "high": high}, **more)


def _choice(*choices: str, **more: Any) -> Any:
    return field(metadata={"choices": choices}, **more)


def _whole(low: int, high: int, **more: Any) -> Any:
    return field(metadata={"whole": (low, high)}, **more)


@dataclass(frozen=True, kw_only=True)
class Signal:
    """Base of all signals."""

    kind: ClassVar[str] = ""
    duration_s: float = _positive()

    def values(self, time_s: FloatArray) -> FloatArray:
        """Level at each time, shape (n,)."""
        raise NotImplementedError

    def standby(self, time_s: FloatArray) -> NDArray[np.bool_]:
        """Where the bridge is in standby instead of braking at level 0, shape (n,)."""
        return np.zeros(time_s.shape, dtype=np.bool_)


@dataclass(frozen=True, kw_only=True)
class Constant(Signal):
    """One level throughout."""

    kind: ClassVar[str] = "constant"
    level: float = _level()

    def values(self, time_s: FloatArray) -> FloatArray:
        return np.full(time_s.shape, self.level)


@dataclass(frozen=True, kw_only=True)
class Steps(Signal):
    """Level ``levels[i]`` from ``times_s[i]`` on; 0 before the first."""

    kind: ClassVar[str] = "steps"
    times_s: tuple[float, ...] = ()
    levels: tuple[float, ...] = _level()

    def __post_init__(self) -> None:
        if len(self.times_s) != len(self.levels) or any(
            b <= a for a, b in zip(self.times_s, self.times_s[1:], strict=False)
        ):
            raise ConfigError("steps: times_s must increase, with one level for each time")

    def values(self, time_s: FloatArray) -> FloatArray:
        index = np.searchsorted(np.array(self.times_s), time_s + _EPS, side="right")
        return np.concatenate(([0.0], self.levels))[index]


@dataclass(frozen=True, kw_only=True)
class Staircase(Signal):
    """The levels one after another, each for ``step_s``, again from the first after the last."""

    kind: ClassVar[str] = "staircase"
    levels: tuple[float, ...] = _level()
    step_s: float = _positive()

    def values(self, time_s: FloatArray) -> FloatArray:
        index = np.floor(time_s / self.step_s + _EPS).astype(np.int64) % len(self.levels)
        return np.asarray(self.levels, dtype=np.float64)[index]


@dataclass(frozen=True, kw_only=True)
class Square(Signal):
    """``low`` and ``high`` for half a period each."""

    kind: ClassVar[str] = "square"
    low: float = _level()
    high: float = _level()
    period_s: float = _positive()
    start: str = _choice("low", "high", default="low")

    def values(self, time_s: FloatArray) -> FloatArray:
        half = np.floor(2.0 * time_s / self.period_s + _EPS).astype(np.int64) % 2
        first, second = (self.low, self.high) if self.start == "low" else (self.high, self.low)
        return np.where(half == 0, first, second)


@dataclass(frozen=True, kw_only=True)
class Sine(Signal):
    """``mean + amplitude * sin(2 pi t / period)``."""

    kind: ClassVar[str] = "sine"
    amplitude: float = _level()
    mean: float = _level(default=0.0)
    period_s: float = _positive()

    def values(self, time_s: FloatArray) -> FloatArray:
        return np.asarray(self.mean + self.amplitude * np.sin(2.0 * math.pi * time_s / self.period_s))


@dataclass(frozen=True, kw_only=True)
class Multisine(Signal):
    """``count`` equal sines between ``low_hz`` and ``high_hz``, at multiples of 1/``period_s``, scaled to a peak.

    Frequencies are spread evenly on a logarithmic axis; phases are drawn from ``seed``. The peak of the whole signal
    about ``mean`` is ``amplitude``.
    """

    kind: ClassVar[str] = "multisine"
    amplitude: float = _level()
    mean: float = _level(default=0.0)
    period_s: float = _positive()
    low_hz: float = _positive(1e-4, 1e3)
    high_hz: float = _positive(1e-4, 1e3)
    count: int = _whole(1, 1000)
    seed: int = _whole(0, 2**63 - 1, default=0)

    def __post_init__(self) -> None:
        if self.high_hz < self.low_hz or self.low_hz * self.period_s < 0.999:
            raise ConfigError("multisine: low_hz must be at least 1/period_s and at most high_hz")

    def frequencies_hz(self) -> FloatArray:
        """The lines that are used, shape (at most count,): equal ones are taken once."""
        wished = np.geomspace(self.low_hz, self.high_hz, self.count)
        return np.unique(np.rint(wished * self.period_s)) / self.period_s

    def values(self, time_s: FloatArray) -> FloatArray:
        lines = self.frequencies_hz()
        phases = np.random.default_rng(self.seed).uniform(0.0, 2.0 * math.pi, lines.size)
        fine = np.linspace(0.0, self.period_s, max(64, int(32 * self.period_s * lines[-1])), endpoint=False)
        peak = float(np.abs(_sum_of_sines(fine, lines, phases)).max())
        return self.mean + self.amplitude * np.clip(_sum_of_sines(time_s, lines, phases) / peak, -1.0, 1.0)


def _sum_of_sines(time_s: FloatArray, lines_hz: FloatArray, phases: FloatArray) -> FloatArray:
    total = np.zeros(time_s.shape)
    for line, phase in zip(lines_hz, phases, strict=True):
        total += np.sin(2.0 * math.pi * line * time_s + phase)
    return total


@dataclass(frozen=True, kw_only=True)
class Ramp(Signal):
    """From ``begin`` to ``end`` in a straight line over the whole duration."""

    kind: ClassVar[str] = "ramp"
    begin: float = _level()
    end: float = _level()

    def values(self, time_s: FloatArray) -> FloatArray:
        return self.begin + (self.end - self.begin) * np.clip(time_s / self.duration_s, 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class RandomSteps(Signal):
    """Levels drawn evenly between ``low`` and ``high``, each held for a time drawn between the two holds."""

    kind: ClassVar[str] = "random_steps"
    low: float = _level()
    high: float = _level()
    hold_min_s: float = _positive()
    hold_max_s: float = _positive()
    seed: int = _whole(0, 2**63 - 1)

    def __post_init__(self) -> None:
        if self.hold_max_s < self.hold_min_s or self.high < self.low:
            raise ConfigError("random_steps: hold_max_s must not be below hold_min_s, nor the high level below the low")

    def values(self, time_s: FloatArray) -> FloatArray:
        rng = np.random.default_rng(self.seed)
        count = int(self.duration_s / self.hold_min_s) + 2
        ends = np.cumsum(rng.uniform(self.hold_min_s, self.hold_max_s, count))
        levels = rng.uniform(self.low, self.high, count)
        index = np.searchsorted(ends, time_s + _EPS, side="right")
        return levels[np.minimum(index, count - 1)]


@dataclass(frozen=True, kw_only=True)
class Pulses(Signal):
    """Each level for ``on_s``, then ``off_s`` of brake or standby (run-down), then the next level, and again."""

    kind: ClassVar[str] = "pulses"
    levels: tuple[float, ...] = _level()
    on_s: float = _positive()
    off_s: float = _positive()
    rest: str = _choice("brake", "standby", default="brake")

    def _place(self, time_s: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        cycle = self.on_s + self.off_s
        index = np.floor(time_s / cycle + _EPS).astype(np.int64)
        return index % len(self.levels), time_s - index * cycle < self.on_s - _EPS * cycle

    def values(self, time_s: FloatArray) -> FloatArray:
        index, driven = self._place(time_s)
        return np.where(driven, np.asarray(self.levels, dtype=np.float64)[index], 0.0)

    def standby(self, time_s: FloatArray) -> NDArray[np.bool_]:
        return ~self._place(time_s)[1] & (self.rest == "standby")


KINDS: dict[str, type[Signal]] = {
    c.kind: c for c in (Constant, Steps, Staircase, Square, Sine, Multisine, Ramp, RandomSteps, Pulses)
}


def read_signal(table: Table, unit: str) -> Signal:
    """A signal from one TOML table whose levels are in *unit* (``pct`` or ``deg``). Raises ConfigError."""
    kind = table.text("kind")
    if kind not in KINDS:
        raise table.fail(f"kind = {kind!r} is unknown; {nearest(kind, KINDS)}")
    values = {f.name: _read(table, f, unit) for f in fields(KINDS[kind])}
    table.finish()
    try:
        return KINDS[kind](**values)
    except ConfigError as exc:
        raise table.fail(str(exc)) from exc


def signal_to_toml(signal: Signal, unit: str) -> list[str]:
    """The lines that :func:`read_signal` reads."""
    lines = [f'kind = "{signal.kind}"']
    for f in fields(signal):
        value = getattr(signal, f.name)
        text = f'"{value}"' if isinstance(value, str) else repr(list(value) if isinstance(value, tuple) else value)
        lines.append(f"{_key(f, unit)} = {text}")
    return lines


def _key(f: Field[Any], unit: str) -> str:
    return f"{f.name}_{unit}" if f.metadata.get("level") else f.name


def _read(table: Table, f: Field[Any], unit: str) -> Any:
    key, meta = _key(f, unit), f.metadata
    default = None if f.default is MISSING else f.default
    if str(f.type).startswith("tuple"):
        numbers = tuple(table.numbers(key))
        most = UNIT_LIMITS[unit] if meta.get("level") else MAX_DURATION_S
        if any(abs(v) > most for v in numbers):
            raise table.fail(f"{key} holds a number beyond {most:g}")
        return numbers
    if "choices" in meta:
        return table.text(key, default, choices=meta["choices"])
    if "whole" in meta:
        low, high = meta["whole"]
        return table.integer(key, default, low=low, high=high)
    if meta.get("level"):
        return table.number(key, default, low=-UNIT_LIMITS[unit], high=UNIT_LIMITS[unit])
    return table.number(key, default, low=meta["low"], high=meta["high"])
