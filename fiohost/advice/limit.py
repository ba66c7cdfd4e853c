"""The smallest visible size of an effect, and those of the shipped suite on the default plant, as data.

Light: the list of effects shows them without loading what computes them (:mod:`fiohost.advice.limits`).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from fiohost.motor.effect import Value, effect
from fiohost.settings import Table, find_config, read_toml

SCHEMA = "fiohost.limits/1"
SHIPPED = "default_suite"


@dataclass(frozen=True)
class Limit:
    """The smallest visible size of one effect: ``value`` of ``parameter``, None with a ``reason`` where there is none.

    ``neutral`` is where the effect vanishes (None where it has no size but is there or not), ``at`` the effect's other
    parameters, ``log`` and ``figure`` what shows it first.
    """

    effect: str
    parameter: str
    unit: str
    value: float | None
    neutral: float | None
    at: Mapping[str, Value] = field(default_factory=dict)
    log: str = ""
    figure: str = ""
    reason: str | None = None

    def to_json(self) -> dict[str, object]:
        return {
            "effect": self.effect,
            "parameter": self.parameter,
            "unit": self.unit,
            "smallest_visible": self.value,
            "neutral": self.neutral,
            "at": dict(self.at),
            "shows_in": {"log": self.log, "figure": self.figure} if self.log else None,
            "reason": self.reason,
        }


@dataclass(frozen=True)
class Measured:
    """Limits of one suite of experiments on one plant, and how they were come by."""

    plant: str
    model: str
    experiments: tuple[str, ...]
    seconds: float
    window_floor_deg: float
    limits: tuple[Limit, ...]

    def of(self, effect_name: str) -> list[Limit]:
        return [x for x in self.limits if x.effect == effect_name]

    def to_json(self) -> dict[str, object]:
        return {
            "schema": SCHEMA,
            "plant": self.plant,
            "model": self.model,
            "experiments": list(self.experiments),
            "seconds": self.seconds,
            "window_floor_deg": self.window_floor_deg,
            "limits": [x.to_json() for x in self.limits],
        }


def shipped(path: Path | None = None) -> Measured:
    """The limits of a file, by default of the shipped one. Raises ConfigError, ModelError."""
    table = read_toml(path or find_config("limits", SHIPPED))
    table.schema(SCHEMA)
    experiments = table.raw("experiments")
    if not isinstance(experiments, list) or not all(isinstance(e, str) for e in experiments):
        raise table.fail("experiments is not a list of names")
    found = Measured(
        table.text("plant"),
        table.text("model"),
        tuple(experiments),
        table.number("seconds", low=0.0),
        table.number("window_floor_deg", low=0.0),
        tuple(_limit(row) for row in table.tables("limit")),
    )
    table.finish()
    return found


def _limit(row: Table) -> Limit:
    item = effect(row.text("effect"))
    parameter = item.parameter(row.text("parameter"))
    at = row.table("at")
    others = {name: item.parameter(name).check(at.raw(name), f"{at.where} {name}") for name in at.data}
    value = row.number("smallest_visible") if "smallest_visible" in row else None
    found = Limit(
        item.name,
        parameter.name,
        parameter.unit,
        value,
        row.number("neutral") if "neutral" in row else None,
        others,
        row.text("log", ""),
        row.text("figure", ""),
        row.text("reason") if value is None else None,
    )
    row.finish()
    return found
