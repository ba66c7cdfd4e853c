"""An experiment: what is commanded or asked for over time, as data from ``configs/experiments`` or built in code.

Either ``command`` is given (open loop, percent) or ``reference`` (degrees) with a control law; both are sequences of
signals that follow each other.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiohost.bench.program import ClosedLoop, OpenLoop, Program
from fiohost.bench.signals import MAX_DURATION_S, Signal, read_signal, signal_to_toml
from fiohost.control.settings import ControlSettings
from fiohost.errors import ConfigError
from fiohost.settings import Table, config_names, find_config, read_toml
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

SCHEMA = "fiohost.experiment/1"
DEFAULT_SAMPLE_TIME_S = 0.005


@dataclass(frozen=True)
class Experiment:
    """A run to be: its signals one after another, and a control law where the loop is closed.

    Raises ConfigError unless exactly one of *command* and *reference* is there, a reference with *control*.
    """

    name: str
    command: Sequence[Signal] = ()
    reference: Sequence[Signal] = ()
    control: ControlSettings | None = None
    title: str = ""
    sample_time_s: float = DEFAULT_SAMPLE_TIME_S
    extra_metadata: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if bool(self.command) == bool(self.reference):
            raise ConfigError(f"experiment {self.name!r}: needs [[command]] (open loop) or [[reference]], one of them")
        if bool(self.reference) != (self.control is not None):
            raise ConfigError(f"experiment {self.name!r}: [controller] goes with [[reference]], and only with it")
        if not 1e-4 <= self.sample_time_s <= 1.0:
            raise ConfigError(f"experiment {self.name!r}: sample_time_s = {self.sample_time_s:g} is outside 0.0001..1")
        if self.duration_s > MAX_DURATION_S:
            raise ConfigError(f"experiment {self.name!r}: lasts longer than {MAX_DURATION_S:g} s")
        if self.control is not None:
            self.control.law(self.sample_time_s)

    @classmethod
    def load(cls, name_or_path: str | Path) -> Experiment:
        """Read an experiment file, or a shipped one by name. Raises ConfigError."""
        path = find_config("experiments", name_or_path)
        return cls.from_table(read_toml(path), path.stem)

    @classmethod
    def from_table(cls, top: Table, name: str) -> Experiment:
        top.schema(SCHEMA)
        title = top.text("title", "")
        sample_time_s = top.number("sample_time_s", DEFAULT_SAMPLE_TIME_S, low=1e-4, high=1.0)
        command = [read_signal(table, "pct") for table in top.tables("command")]
        reference = [read_signal(table, "deg") for table in top.tables("reference")]
        if any(signal.kind == "pulses" for signal in reference):
            raise top.fail("'pulses' is a command, not a reference: the bridge rests between them")
        control, deadband = None, top.table("deadband")
        if top.raw("controller") is not None or deadband.data:
            control = ControlSettings.from_tables(top.table("controller", required=True), deadband)
        top.finish()
        return cls(name, tuple(command), tuple(reference), control, title, sample_time_s)

    @staticmethod
    def names() -> list[str]:
        """Names of the shipped experiments."""
        return config_names("experiments")

    @property
    def closed_loop(self) -> bool:
        return bool(self.reference)

    @property
    def signals(self) -> Sequence[Signal]:
        return self.reference or self.command

    @property
    def duration_s(self) -> float:
        return sum(signal.duration_s for signal in self.signals)

    @property
    def ticks(self) -> int:
        return max(1, round(self.duration_s / self.sample_time_s))

    def levels(self) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Duty (percent) or reference (deg) at each tick, and where the bridge is in standby; shape (ticks,) both."""
        time_s = np.arange(self.ticks, dtype=np.float64) * self.sample_time_s
        values, standby = np.zeros(self.ticks), np.zeros(self.ticks, dtype=np.bool_)
        begin = 0.0
        for i, signal in enumerate(self.signals):
            first = round(begin / self.sample_time_s)
            begin += signal.duration_s
            last = self.ticks if i == len(self.signals) - 1 else round(begin / self.sample_time_s)
            own = time_s[: last - first]
            values[first:last], standby[first:last] = signal.values(own), signal.standby(own)
        return values, standby

    def program(self) -> Program:
        """What the tick loop asks, for one run. Raises LimitError where a command is beyond full scale."""
        values, standby = self.levels()
        if self.control is not None:
            return ClosedLoop(self.control.law(self.sample_time_s), values.tolist())
        known = {value: Command.drive(value) for value in set(values.tolist())}
        known[0.0] = BRAKE_COMMAND
        return OpenLoop(
            [STANDBY_COMMAND if s else known[v] for v, s in zip(values.tolist(), standby.tolist(), strict=True)]
        )

    def to_toml(self) -> str:
        """The file that :meth:`load` reads."""
        title = self.title.replace("\\", "/").replace('"', "'")
        lines = [f'schema = "{SCHEMA}"', f'title = "{title}"', f"sample_time_s = {self.sample_time_s!r}"]
        key, unit = ("reference", "deg") if self.closed_loop else ("command", "pct")
        for signal in self.signals:
            lines += ["", f"[[{key}]]", *signal_to_toml(signal, unit)]
        if self.control is not None:
            lines += ["", *self.control.to_toml()]
        return "\n".join(lines) + "\n"

    def describe(self) -> dict[str, str]:
        """Metadata of a log: the name, a hash of what was done, gains."""
        text = self.to_toml().split("\n", 2)[2]  # without the title
        found = {"experiment": self.name, "experiment_sha256": hashlib.sha256(text.encode()).hexdigest()[:16]}
        found["loop"] = "closed" if self.closed_loop else "open"
        return {**found, **(self.control.describe() if self.control else {}), **self.extra_metadata}
