"""A diagnosis of tables: from a declared model and readings to a result in the fields of ``fiohost.diagnosis/1``."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost import __version__
from fiohost.discover.candidate import Progress
from fiohost.discover.result import clean
from fiohost.discover.settings import SETTINGS
from fiohost.discover.tables.evidence import Table
from fiohost.discover.tables.fit import Evidence, TableFit
from fiohost.discover.tables.search import Search, TableSearch, TableStage, parameter_count, select
from fiohost.errors import DataError
from fiohost.estimation.intervals import Estimate
from fiohost.motor.model import Model

STANDS_OUT = 2.0  # floors: a figure this far off on the whole is part of what remains


@dataclass(frozen=True)
class TableDiagnosis:
    """All that was found; ``to_json`` gives the fields of ``fiohost.diagnosis/1`` that tables have."""

    evidence: Evidence
    found: TableSearch
    seconds: float
    files: Mapping[str, Mapping[str, str]] = field(default_factory=dict)

    @property
    def verdict(self) -> str:
        return self.found.verdict

    @property
    def final(self) -> TableStage:
        return self.found.final

    def to_json(self) -> dict[str, Any]:
        """Errors are in floors; ``rows`` holds every figure in its own unit, measured, declared and final."""
        found, final, evidence = self.found, self.found.final, self.evidence
        result = {
            "schema": "fiohost.diagnosis/1",
            "fiohost_version": __version__,
            "seconds": self.seconds,
            "evidence": "readings",
            "output_unit": "floors",
            "readings": [{"name": t.name, "rows": len(t.rows), **self.files.get(t.name, {})} for t in evidence.tables],
            "declared": {"model": found.declared.fit.model.expression, "parameters": _parameters(found.declared)},
            "verdict": found.verdict,
            "why": found.why_not,
            "before": {"train": errors(evidence, found.declared), "holdout": None},
            "steps": [
                {
                    "effect": step.effect,
                    "parameters": _parameters(step.stage, step.effect),
                    "evidence": {"left_out_error_ratio": step.left_out_ratio, "by_chance": step.by_chance},
                    "after": {"train": errors(evidence, step.stage), "holdout": None},
                    "indistinguishable_from": list(step.indistinguishable_from),
                }
                for step in found.steps
            ],
            "after": {"train": errors(evidence, final), "holdout": None},
            "final": {
                "model": final.fit.model.expression,
                "parameters": _parameters(final),
                "constants": self._constants(final.fit),
            },
            "floor": {
                "train": {"free_run_rms": final.floor_rms, "limit_rms": final.limit_rms, "samples": evidence.samples},
                "holdout": None,
                "from": "replicas",
                "replicas": SETTINGS.floor.replicas,
            },
            "fitted_parameters": parameter_count(evidence, final.fit),
            "rows": self._rows(),
            "candidates": [
                {"effect": c.effect, "score": max(c.score, 0.0), "rejected_because": c.rejected_because}
                for c in sorted(found.candidates, key=lambda c: c.score, reverse=True)
            ],
            "residual": {
                "white": final.at_floor,
                "depends_on": [] if final.at_floor else self._standing_out(),
                "tests": {"figures": self._by_figure(final)},
            },
            "logs": [],
            "next_experiment": None,
        }
        return clean(result)  # type: ignore[no-any-return]

    def _rows(self) -> list[dict[str, Any]]:
        """Every row with its figures: measured, declared, final, in the figure's unit, and its floor."""
        rows = []
        evidence, declared, final = self.evidence, self.found.declared.fit, self.found.final.fit
        for i, place in enumerate(evidence.places):
            figures = {
                f.name: {
                    "measured": place.row.measured[f.name],
                    "before": declared.predicted[i][f.name],
                    "after": final.predicted[i][f.name],
                    "floor": f.floor,
                    "unit": f.unit,
                }
                for f in evidence.figures(place)
            }
            rows.append({"readings": evidence.tables[place.table].name, "row": place.row.label, "figures": figures})
        return rows

    def _by_figure(self, stage: TableStage) -> dict[str, float]:
        """Error of each figure over all rows, in floors."""
        left: dict[str, list[float]] = {}
        for place, residual in zip(self.evidence.places, stage.fit.residuals, strict=True):
            for figure, value in zip(self.evidence.figures(place), residual, strict=True):
                left.setdefault(figure.name, []).append(float(value))
        return {name: float(np.sqrt(np.mean(np.square(values)))) for name, values in left.items()}

    def _standing_out(self) -> list[str]:
        by_figure = self._by_figure(self.found.final)
        return [n for n in sorted(by_figure, key=lambda n: -by_figure[n]) if by_figure[n] > STANDS_OUT]

    def _constants(self, fitted: TableFit) -> dict[str, Any]:
        """What was fitted of the benches themselves."""
        return {
            f"{self.evidence.tables[t].name}.{self.evidence.constant((t, i)).name}": {
                "value": fitted.constants[t][i],
                "unit": self.evidence.constant((t, i)).unit,
            }
            for t, i in self.evidence.fitted
        }


def errors(evidence: Evidence, stage: TableStage) -> dict[str, Any]:
    """``E`` of the diagnosis, in floors; outside the bin is a figure that no rounding of the prediction gives."""
    outside = [
        abs(residual) * figure.floor > 0.5 * figure.quantum + 3.0 * figure.scatter
        for place, residuals in zip(evidence.places, stage.fit.residuals, strict=True)
        for figure, residual in zip(evidence.figures(place), residuals, strict=True)
    ]
    return {
        "free_run_rms": stage.fit.rms,
        "window_rms": None,
        "left_out_rms": stage.left_out_rms,
        "bin_violation_pct": 100.0 * float(np.mean(outside)),
        "fit_pct": None,
        "samples": evidence.samples,
    }


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
    evidence = Evidence(tables)
    if not evidence.samples:
        raise DataError("the tables hold no reading to be judged")
    began = time.monotonic()
    with threadpool_limits(limits=1, user_api="blas"):
        found = select(Search(evidence, np.random.default_rng(seed), library, say), model, from_file)
    return TableDiagnosis(evidence, found, time.monotonic() - began, files or {})
