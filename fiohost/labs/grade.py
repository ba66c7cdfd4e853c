"""What students handed in against the seals of their benches: effects by name, parameters by their error, and the error
on a fresh record of the bench, which nobody has seen before and which no way of writing a model changes.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fiohost.bench.connect import connect
from fiohost.bench.seal import student_seed
from fiohost.circle.plan import fresh
from fiohost.circle.replay import replay
from fiohost.errors import DataError, FiohostError
from fiohost.files import entries
from fiohost.motor.effect import effects
from fiohost.motor.model import Model
from fiohost.transport.instruments import break_seal

SUFFIX = ".toml"
MOST_HANDED_IN = 1000
ASIDE = ("linear", "coulomb_friction")  # what every bench has, so that naming it is no finding
FRESH_SEED = 20_201  # of the steps of the record that grades: the same for everybody, in nobody's logs
ONCE_A_TURN = 1.0  # the order at which cogging is gravity


@dataclass(frozen=True)
class Grade:
    """One student's result. ``errors_pct`` are those of parameters that truth and hand-in share, ``fresh_rms_deg`` the
    error of a free run on a fresh record, ``problem`` says why nothing could be compared.
    """

    student: str
    true_effects: tuple[str, ...] = ()
    named: tuple[str, ...] = ()
    errors_pct: Mapping[str, float] | None = None
    problem: str = ""
    effects_right: bool = False
    fresh_rms_deg: float | None = None

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
            "fresh_rms_deg": self.fresh_rms_deg,
            "problem": self.problem,
        }


def grade_folder(folder: Path, said: Callable[[str], None] = lambda text: None) -> list[Grade]:
    """Grade every model file ``STUDENT.toml`` of a folder, in order of names. Raises DataError where there is none."""
    if not os.path.isdir(folder):
        raise DataError(f"{folder} is no folder: put what was handed in into one, as STUDENT{SUFFIX}")
    handed_in = [path for path in entries(folder, "the folder", DataError) if path.suffix == SUFFIX]
    if not handed_in:
        raise DataError(f"{folder} holds no model file: each student hands in STUDENT{SUFFIX}, from --save-model")
    if len(handed_in) > MOST_HANDED_IN:
        raise DataError(f"{folder} holds {len(handed_in)} files: at most {MOST_HANDED_IN}")
    found = []
    for number, path in enumerate(handed_in, start=1):
        said(f"{path.name}, {number} of {len(handed_in)}")
        found.append(grade(path))
    return found


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
    truth_values = flat(reduced)
    true, found = as_written_once(truth_values), as_written_once(model.values)
    errors = {key: _error_pct(key, found[key], value) for key, value in true.items() if key in found and value}
    right = all_named(true_effects, named, {**truth_values, **model.values})
    return Grade(path.stem, true_effects, named, errors, effects_right=right, fresh_rms_deg=fresh_rms(path.stem, model))


def _error_pct(key: str, found: float, true: float) -> float:
    if key.endswith("phase_deg"):
        return 100.0 * ((found - true + 180.0) % 360.0 - 180.0) / 360.0
    return 100.0 * (found / true - 1.0)


def as_written_once(values: Mapping[str, Any]) -> dict[str, float]:
    """The numbers of a model where exact equivalents have one form: dry friction and a constant load as friction in
    each direction, cogging once a turn as gravity.
    """
    found = {key: float(value) for key, value in values.items() if not isinstance(value, str)}
    level, load = found.pop("coulomb_friction.level_pct", 0.0), found.pop("constant_load.level_pct", 0.0)
    more = [found.pop(f"asymmetric_coulomb_friction.{way}_pct", 0.0) for way in ("forward", "reverse")]
    found["friction_forward_pct"], found["friction_reverse_pct"] = level + more[0] + load, level + more[1] - load
    if found.get("cogging_torque.order") == ONCE_A_TURN:
        for name in ("level_pct", "phase_deg"):
            found[f"gravity_load.{name}"] = found.pop(f"cogging_torque.{name}")
        del found["cogging_torque.order"]
    return found


def flat(reduced: Mapping[str, Mapping[str, Any]]) -> dict[str, Any]:
    return {f"{effect}.{name}": value for effect, values in reduced.items() for name, value in values.items()}


def all_named(true: tuple[str, ...], named: tuple[str, ...], values: Mapping[str, Any]) -> bool:
    """Whether the effects are the same; two names for what no log can tell apart are the same effect."""
    return len(true) == len(named) and all(any(same_effect(a, b, values) for b in named) for a in true)


def same_effect(a: str, b: str, values: Mapping[str, Any]) -> bool:
    """Equal, or exact equivalents by the library: cogging is gravity at once a turn only."""
    if a == b:
        return True
    if "cogging_torque" in (a, b) and values.get("cogging_torque.order") != ONCE_A_TURN:
        return False
    library = effects()
    return any(one in library and other in library[one].equivalents for one, other in ((a, b), (b, a)))


def fresh_rms(student: str, model: Model) -> float | None:
    """Error in degrees rms of a free run on a record of the student's bench; None where the model has none."""
    with connect(f"sim:student:{student}") as bench:
        log = bench.run(fresh(FRESH_SEED))
    try:
        rms = replay(log, model).errors.free_run_rms
    except FiohostError:
        return None
    return float(rms) if math.isfinite(rms) else None
