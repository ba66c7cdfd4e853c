"""What students handed in against the seals of their benches: effects by name, parameters by their error."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fiohost.bench.seal import student_seed
from fiohost.errors import DataError, FiohostError
from fiohost.files import entries
from fiohost.motor.model import Model
from fiohost.transport.instruments import break_seal

SUFFIX = ".toml"
MOST_HANDED_IN = 1000
ASIDE = ("linear", "coulomb_friction")  # what every bench has, so that naming it is no finding


@dataclass(frozen=True)
class Grade:
    """One student's result. ``errors_pct`` are those of parameters that truth and hand-in share, ``problem`` says why
    nothing could be compared.
    """

    student: str
    true_effects: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    errors_pct: Mapping[str, float] | None = None
    problem: str = ""

    @property
    def effects_right(self) -> bool:
        return not self.problem and set(self.true_effects) == set(self.named)

    def within(self, tolerance_pct: float) -> int:
        """How many parameters are no further off than that."""
        return sum(abs(error) <= tolerance_pct for error in (self.errors_pct or {}).values())

    def to_json(self, tolerance_pct: float) -> dict[str, Any]:
        return {
            "student": self.student,
            "true_effects": self.true_effects,
            "named": self.named,
            "effects_right": self.effects_right,
            "errors_pct": dict(self.errors_pct or {}),
            "within_tolerance": self.within(tolerance_pct),
            "compared": len(self.errors_pct or {}),
            "problem": self.problem,
        }


def grade_folder(folder: Path) -> list[Grade]:
    """Grade every model file ``STUDENT.toml`` of a folder, in order of names. Raises DataError where there is none."""
    if not os.path.isdir(folder):
        raise DataError(f"{folder} is no folder: put what was handed in into one, as STUDENT{SUFFIX}")
    handed_in = [path for path in entries(folder, "the folder", DataError) if path.suffix == SUFFIX]
    if not handed_in:
        raise DataError(f"{folder} holds no model file: each student hands in STUDENT{SUFFIX}, from --save-model")
    if len(handed_in) > MOST_HANDED_IN:
        raise DataError(f"{folder} holds {len(handed_in)} files: at most {MOST_HANDED_IN}")
    return [grade(path) for path in handed_in]


def grade(path: Path) -> Grade:
    """Compare one model file with the bench of the student that it is named after."""
    try:
        truth = break_seal(student_seed(path.stem))
    except FiohostError as exc:
        return Grade(path.stem, problem=str(exc))
    reduced: Mapping[str, Mapping[str, Any]] = truth["reduced"]
    true_effects = tuple(name for name in truth.get("effects") or () if name not in ASIDE)
    try:
        model = Model.read(path)
    except FiohostError as exc:
        return Grade(path.stem, true_effects, problem=str(exc))
    named = tuple(name for name in model.effects if name not in ASIDE)
    errors: dict[str, float] = {}
    for effect, parameters in reduced.items():
        if effect != "linear" and effect not in model.effects:
            continue
        for name, value in parameters.items():
            key = f"{effect}.{name}"
            found = model.values.get(key)
            if isinstance(found, str) or isinstance(value, str) or found is None or not value:
                continue
            if name.endswith("phase_deg"):
                turn = (found - value + 180.0) % 360.0 - 180.0
                errors[key] = 100.0 * turn / 360.0
            else:
                errors[key] = 100.0 * (found / value - 1.0)
    return Grade(path.stem, true_effects, named, errors)
