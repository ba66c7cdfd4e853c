"""What a table of readings is: rows, their figures with floors, and the constants that turn a model into readings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import sqrt
from typing import Protocol

import numpy as np

from fiohost.control.closed_loop import Plant


@dataclass(frozen=True)
class Figure:
    """A measured quantity: the step of its printed numbers and the standard deviation of repeats, in its unit.

    ``scale`` is the size of that unit in those of a model: degrees, deg/s, seconds, percent, amperes.
    """

    name: str
    unit: str
    quantum: float
    scatter: float = 0.0
    scale: float = 1.0

    @property
    def floor(self) -> float:
        """Standard deviation of a reading of a true model: uniform rounding and scatter."""
        return sqrt(self.quantum**2 / 12.0 + self.scatter**2)

    def noise_floors(self, rng: np.random.Generator) -> float:
        """One draw of that error, in floors."""
        half = 0.5 * self.quantum
        return float(rng.uniform(-half, half) + self.scatter * rng.standard_normal()) / self.floor


@dataclass(frozen=True)
class Row:
    """One row: what tells it from the others, and its readings by figure; what was not measured is not there."""

    label: str
    measured: Mapping[str, float]


@dataclass(frozen=True)
class Constant:
    """A number of the bench, not of the model, without which its readings cannot be predicted; fitted or known."""

    name: str
    unit: str
    value: float
    lower: float
    upper: float
    fitted: bool = False


class Table(Protocol):
    """One table as evidence."""

    @property
    def name(self) -> str: ...

    @property
    def figures(self) -> Sequence[Figure]: ...

    @property
    def rows(self) -> Sequence[Row]: ...

    @property
    def constants(self) -> Sequence[Constant]: ...

    def predict(self, plant: Plant, row: int, constants: Sequence[float]) -> Mapping[str, float]:
        """Every figure of a row as the model has it; ``constants`` are the values in their order."""
