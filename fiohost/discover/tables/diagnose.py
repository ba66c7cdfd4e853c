"""A diagnosis of tables: from a declared model and readings to a result in the fields of ``fiohost.diagnosis/1``."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost import __version__
from fiohost.discover.candidate import Progress
from fiohost.discover.nodes import Node
from fiohost.discover.result import clean
from fiohost.discover.search import Search
from fiohost.discover.settings import SETTINGS
from fiohost.discover.step import Found
from fiohost.discover.tables.evidence import Readings, TableStage
from fiohost.discover.tables.fit import Rows, TableFit
from fiohost.discover.tables.settings import SETTINGS as TABLES
from fiohost.discover.tables.table import Table
from fiohost.errors import DataError
from fiohost.estimation.intervals import Estimate
from fiohost.motor.model import Model


@dataclass(frozen=True)
class TableDiagnosis:
    """All that was found beside the declared model at the ``root``; ``why_not`` says why nothing can be said, where
    that is so. ``to_json`` gives the fields of ``fiohost.diagnosis/1`` that tables have.
    """

    evidence: Readings
    root: Node
    found: Found[TableStage]
    seconds: float
    why_not: str | None = None
    files: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        if self.why_not is not None:
            return "cannot_be_judged"
        if not self.final.follows:
            return "unexplained"
        return "explained" if self.found.steps else "no_missing_effect"

    @property
    def final(self) -> TableStage:
        return self.found.final

    def to_json(self) -> dict[str, Any]:
        """Errors are in floors; ``rows`` holds every figure in its own unit, measured, declared and final."""
        found, final, rows = self.found, self.found.final, self.evidence.rows
        stages = [found.declared, *(step.stage for step in found.steps)]
        result = {
            "schema": "fiohost.diagnosis/1",
            "fiohost_version": __version__,
            "seconds": self.seconds,
            "evidence": "readings",
            "output_unit": "floors",
            "readings": [{"name": t.name, "rows": len(t.rows), **self.files.get(t.name, {})} for t in rows.tables],
            "declared": {"model": found.declared.fit.model.expression, "parameters": _parameters(found.declared)},
            "verdict": self.verdict,
            "why": self.why_not,
            "before": {"train": errors(rows, found.declared), "holdout": None},
            "steps": [
                {
                    "effect": step.effect,
                    "parameters": _parameters(step.stage, step.effect),
                    "evidence": {
                        "left_out_error_ratio": _ratio(before, step.stage),
                        "by_chance": step.evidence["by_chance"],
                    },
                    "after": {"train": errors(rows, step.stage), "holdout": None},
                    "indistinguishable_from": list(step.indistinguishable_from),
                }
                for before, step in zip(stages, found.steps, strict=False)
            ],
            "after": {"train": errors(rows, final), "holdout": None},
            "final": {
                "model": final.fit.model.expression,
                "parameters": _parameters(final),
                "constants": self._constants(final.fit),
            },
            "floor": {
                "train": {"free_run_rms": final.floor_rms, "limit_rms": final.limit_rms, "samples": rows.samples},
                "holdout": None,
                "from": "replicas",
                "replicas": SETTINGS.floor.replicas,
            },
            "settings": {"search": asdict(SETTINGS), "tables": asdict(TABLES)},
            "fitted_parameters": self.evidence.parameter_count(final.fit),
            "rows": self._rows(),
            "candidates": [
                {"effect": c.effect, "score": max(c.score, 0.0), "rejected_because": c.rejected_because}
                for c in sorted(found.offered, key=lambda c: c.score, reverse=True)
            ],
            "residual": {
                "white": final.follows,
                "depends_on": [] if final.follows else self._standing_out(),
                "tests": {"figures": self._by_figure(final)},
            },
            "logs": [],
            "next_experiment": None,
        }
        return clean(result)  # type: ignore[no-any-return]

    def _rows(self) -> list[dict[str, Any]]:
        """Every row with its figures: measured, declared, final, in the figure's unit, and its floor."""
        told = []
        rows, declared, final = self.evidence.rows, self.found.declared.fit, self.found.final.fit
        for i, place in enumerate(rows.places):
            figures = {
                f.name: {
                    "measured": place.row.measured[f.name],
                    "before": declared.predicted[i][f.name],
                    "after": final.predicted[i][f.name],
                    "floor": f.floor,
                    "unit": f.unit,
                }
                for f in rows.figures(place)
            }
            told.append({"readings": rows.tables[place.table].name, "row": place.row.label, "figures": figures})
        return told

    def _by_figure(self, stage: TableStage) -> dict[str, float]:
        """Error of each figure over all rows, in floors."""
        left: dict[str, list[float]] = {}
        for place, residual in zip(self.evidence.rows.places, stage.fit.residuals, strict=True):
            for figure, value in zip(self.evidence.rows.figures(place), residual, strict=True):
                left.setdefault(figure.name, []).append(float(value))
        return {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in left.items()}

    def _standing_out(self) -> list[str]:
        by_figure = self._by_figure(self.found.final)
        return [n for n in sorted(by_figure, key=lambda n: -by_figure[n]) if by_figure[n] > TABLES.stands_out]

    def _constants(self, fitted: TableFit) -> dict[str, Any]:
        """What was fitted of the benches themselves."""
        rows = self.evidence.rows
        return {
            f"{rows.tables[t].name}.{rows.constant((t, i)).name}": {
                "value": fitted.constants[t][i],
                "unit": rows.constant((t, i)).unit,
            }
            for t, i in rows.fitted
        }


def errors(rows: Rows, stage: TableStage) -> dict[str, Any]:
    """``E`` of the diagnosis, in floors; outside the bin is a figure that no rounding of the prediction gives."""
    outside = [
        abs(residual) * figure.floor > 0.5 * figure.quantum + 3.0 * figure.scatter
        for place, residuals in zip(rows.places, stage.fit.residuals, strict=True)
        for figure, residual in zip(rows.figures(place), residuals, strict=True)
    ]
    return {
        "free_run_rms": stage.fit.rms,
        "window_rms": None,
        "left_out_rms": stage.left_out_rms,
        "bin_violation_pct": 100.0 * float(np.mean(outside)),
        "fit_pct": None,
        "samples": rows.samples,
    }


def _ratio(before: TableStage, after: TableStage) -> float | None:
    """The error on rows left out, over that without the effect."""
    was, now = before.left_out_rms, after.left_out_rms
    return now / was if was and now is not None else None


def _parameters(stage: TableStage, only: str | None = None) -> dict[str, Any]:
    """Parameters with intervals; those that no figure shows are said not to be identifiable."""
    known: Mapping[str, Estimate] = stage.parameters()
    unseen = {n for n, s in zip(stage.fit.names, stage.fit.seen, strict=True) if not s}
    found: dict[str, Any] = {}
    for name, value in stage.fit.model.values.items():
        group, _, short = name.partition(".")
        if only is not None and group != only:
            continue
        if isinstance(value, str):
            entry: dict[str, Any] = {"value": value, "unit": "", "ci95": None, "identifiable": True, "at_bound": False}
        else:
            entry = {**known[name].to_json()}
            entry["identifiable"] = bool(entry["identifiable"]) and name not in unseen
        found[short if only else name] = entry
    return found


def diagnose_tables(
    tables: Sequence[Table],
    model: Model,
    *,
    library: Sequence[str] | None = None,
    from_file: bool = False,
    seed: int = 0,
    say: Progress = lambda text: None,
    files: Mapping[str, Mapping[str, str]] | None = None,
) -> TableDiagnosis:
    """Diagnose a declared model on tables of readings, all together.

    ``library`` restricts the candidates, ``seed`` fixes the replicas. Raises DataError if there is nothing to judge.
    """
    readings = Readings(tables, np.random.default_rng(seed))
    rows = readings.rows
    if not rows.samples:
        raise DataError("the tables hold no reading to be judged")
    began = time.monotonic()
    with threadpool_limits(limits=1, user_api="blas"):
        say(f"fitting {model.expression} to {len(rows)} rows, {rows.samples} figures")
        search = Search(readings, library, say)
        root = search.declared(model, from_file)
        stage = search.belief.stage(root)
        why_not = readings.too_few(stage.fit)
        if why_not is None and not stage.follows and stage.left_out is None:
            why_not = (
                f"{model.expression} does not explain these figures, but their {len(rows)} rows are too few to leave "
                "one out, so nothing can be chosen that it lacks; measure more rows"
            )
        found = search.found(root, root if why_not else search.run(root))
    return TableDiagnosis(readings, root, found, time.monotonic() - began, why_not, files or {})
