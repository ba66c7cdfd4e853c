"""What a fleet shows: a table with a row a bench, how often which effect occurs, who stands apart, what drifts."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from fiohost.errors import ConfigError
from fiohost.files import write_output
from fiohost.fleet.together import APART_Z, Population, population, trend, z_scores

SCHEMA = "fiohost.fleet/1"
LEFT = "window_rms"
# Where a serial number or a time may stand, in the order of preference.
ORDERS = ("serial", "serial_number", "start_time", "started", "date", "time")
# A drift over serial number or time is said from this chance on.
DRIFT_P = 0.01


@dataclass(frozen=True)
class Fleet:
    """All results together: ``rows`` of the benches, parameters ``names``, robust ``z`` (rows, k + 1), the population
    where there are benches enough, and the ``order`` (rows) of serial number or time with its name.
    """

    rows: Sequence[Mapping[str, Any]]
    names: tuple[str, ...]
    z: np.ndarray
    types: Mapping[str, Population]
    order: np.ndarray
    order_name: str
    trends: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def apart(self) -> list[tuple[str, str, float]]:
        """Benches that stand apart: name, in what most, and its z-score; the farthest first."""
        found = []
        for row, scores in zip(self.rows, self.z, strict=True):
            if np.isfinite(scores).any() and float(np.nanmax(np.abs(scores))) > APART_Z:
                k = int(np.nanargmax(np.abs(scores)))
                found.append((str(row["bench"]), (*self.names, LEFT)[k], float(scores[k])))
        return sorted(found, key=lambda one: -abs(one[2]))

    @property
    def effects(self) -> dict[str, int]:
        """In how many benches each effect was found."""
        steps = (step["effect"] for row in self.rows for step in row.get("steps") or ())
        return dict(Counter(steps).most_common())

    @property
    def failed(self) -> list[tuple[str, str]]:
        return [(str(r["bench"]), str(r["error"])) for r in self.rows if r.get("error")]

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": SCHEMA,
            "benches": len(self.rows),
            "failed": [{"bench": b, "error": e} for b, e in self.failed],
            "verdicts": dict(Counter(str(r.get("verdict") or "fitted") for r in self.rows if not r.get("error"))),
            "effects": self.effects,
            "apart": [{"bench": b, "in": p, "z": z} for b, p, z in self.apart],
            "types": {name: p.to_json() for name, p in self.types.items()},
            "order": self.order_name or None,
            "trends": {name: dict(t) for name, t in self.trends.items()},
            "cpu_s": float(sum(r.get("cpu_s", 0.0) for r in self.rows)),
        }


def summarised(rows: Sequence[Mapping[str, Any]]) -> Fleet:
    """Compare the benches of a fleet; each type (``type`` in what is said of it) with its own kind."""
    good = [r for r in rows if not r.get("error")]
    names = tuple(Counter(tuple(r["names"]) for r in good).most_common(1)[0][0]) if good else ()
    of = [str(r.get("said", {}).get("type", "")) for r in rows]
    z, types = np.full((len(rows), len(names) + 1), np.nan), {}
    for name in sorted(set(of)):
        places = [i for i, t in enumerate(of) if t == name]
        own = [rows[i] for i in places]
        z[places] = z_scores(own, names)
        found = population(own)
        if found is not None and found.names == names:
            types[name or "all"] = found
    order, order_name = _order(rows)
    trends = {}
    for k, name in enumerate((*names, LEFT)):
        values = np.array([_value(r, name, names) for r in rows])
        there = trend(order, values) if order_name and k < len(names) + 1 else None
        if there is not None and there["p"] < DRIFT_P / (len(names) + 1):
            trends[name] = there
    return Fleet(rows, names, z, types, order, order_name, trends)


def _value(row: Mapping[str, Any], name: str, names: Sequence[str]) -> float:
    if row.get("error") or tuple(row.get("names", ())) != tuple(names):
        return float("nan")
    return float(row[LEFT]) if name == LEFT else float(row["values"][list(names).index(name)])


def _order(rows: Sequence[Mapping[str, Any]]) -> tuple[np.ndarray, str]:
    """Serial number, or time in s, of each row; the first of the known names that most rows have."""
    for name in ORDERS:
        found = np.array([_number(str(r.get("said", {}).get(name, ""))) for r in rows])
        if np.isfinite(found).sum() > 0.5 * len(rows) and len(np.unique(found[np.isfinite(found)])) > 1:
            return found, name
    return np.full(len(rows), np.nan), ""


def _number(text: str) -> float:
    digits = text.strip().lstrip("#").removeprefix("SN").lstrip("-_ ")
    try:
        return float(digits)
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return float("nan")


def columns_of(fleet: Fleet) -> dict[str, list[Any]]:
    """The table: a row a bench. Parameters with their standard deviation, z-score, and value with the type's prior."""
    of = [str(r.get("said", {}).get("type", "")) or "all" for r in fleet.rows]
    table: dict[str, list[Any]] = {
        "bench": [str(r["bench"]) for r in fleet.rows],
        "type": of,
        "order": [None if not np.isfinite(v) else float(v) for v in fleet.order],
        "error": [r.get("error") for r in fleet.rows],
        "verdict": [r.get("verdict") for r in fleet.rows],
        "effects": ["+".join(s["effect"] for s in r.get("steps") or ()) for r in fleet.rows],
        "log_s": [r.get("log_s") for r in fleet.rows],
        LEFT: [r.get(LEFT) for r in fleet.rows],
        "unit": [r.get("unit") for r in fleet.rows],
        "cpu_s": [float(r.get("cpu_s", 0.0)) for r in fleet.rows],
        "z_max": [float(np.nanmax(np.abs(z))) if np.isfinite(z).any() else None for z in fleet.z],
    }
    for k, name in enumerate(fleet.names):
        table[name] = [_finite(_value(r, name, fleet.names)) for r in fleet.rows]
        sds: list[float | None] = []
        own: list[float | None] = []
        own_sd: list[float | None] = []
        for row, kind in zip(fleet.rows, of, strict=True):
            sd, with_type, shared_sd = None, None, None
            if not row.get("error") and tuple(row["names"]) == fleet.names:
                covariance = np.array(row["covariance"], dtype=np.float64)
                sd = _finite(float(np.sqrt(covariance[k, k])) if covariance[k, k] >= 0.0 else float("nan"))
                type_ = fleet.types.get(kind)
                if type_ is not None:
                    values, shared = type_.with_prior(np.array(row["values"]), covariance)
                    with_type, shared_sd = float(values[k]), float(np.sqrt(shared[k, k]))
            sds.append(sd)
            own.append(with_type)
            own_sd.append(shared_sd)
        table |= {f"{name}.sd": sds, f"{name}.z": [_finite(float(z)) for z in fleet.z[:, k]],
                  f"{name}.with_type": own, f"{name}.with_type_sd": own_sd}  # fmt: skip
    return table


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def write_table(fleet: Fleet, path: Path) -> None:
    """Write the table as Parquet, whole or not at all. Raises FiohostError."""
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        raise ConfigError("the table of a fleet needs pyarrow: pip install 'fiohost[data]'") from None
    made = io.BytesIO()
    pyarrow.parquet.write_table(pyarrow.table(columns_of(fleet)), made)
    write_output(path, made.getvalue())
