"""What may change in a motor, as columns: by how much a window's output moves with each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fiohost.motor.effect import Kind, Value, effect
from fiohost.motor.model import Model
from fiohost.noise.runs import FRICTIONS, varied

GAIN_STEP, TAU_STEP, LOAD_STEP_PCT, SHARE_STEP = 0.02, 0.05, 0.5, 0.1
GAIN, TAU = "linear.gain_deg_s_per_pct", "linear.tau_s"


@dataclass(frozen=True)
class Column:
    """A changed model and by how much of what it is changed; ``unit`` of that."""

    model: Model
    step: float
    unit: str


@dataclass(frozen=True)
class Candidate:
    """What may have changed: an effect's name, what of it, its columns (two for a sine and a cosine), and the size
    that would not astonish, in the columns' unit.
    """

    effect: str
    what: str
    columns: tuple[Column, ...]
    usual: float

    @property
    def name(self) -> str:
        return f"{self.effect} ({self.what})" if self.what else self.effect


# Effects that a model may not have yet: the parameters they are tried at, which of these measures them, the unit, what
# the size vanishes at, and a size that would not astonish.
NEW: Mapping[str, tuple[tuple[Mapping[str, Value], ...], str, float, float]] = {
    "gravity_load": (
        ({"level_pct": 1.0, "phase_deg": 0.0}, {"level_pct": 1.0, "phase_deg": 90.0}), "level_pct", 0.0, 5.0,
    ),
    "backlash": (({"gap_deg": 2.0},), "gap_deg", 0.0, 3.0),
    "input_deadband": (({"level_pct": 2.0},), "level_pct", 0.0, 5.0),
    "voltage_saturation": (({"limit_pct": 70.0},), "limit_pct", 100.0, 30.0),
    "quadratic_drag": (({"pct_at_1000_deg_s": 2.0},), "pct_at_1000_deg_s", 0.0, 10.0),
    "supply_sag": (({"ratio": 0.05},), "ratio", 0.0, 0.2),
    "direction_dependent_gain": (({"ratio": 0.95},), "ratio", 1.0, 0.1),
    "transport_delay": (({"delay_s": 0.005},), "delay_s", 0.0, 0.02),
    "stribeck_friction": (({"extra_pct": 2.0, "stribeck_speed_deg_s": 60.0},), "extra_pct", 0.0, 5.0),
    "load_dependent_friction": (({"ratio": 0.05},), "ratio", 0.0, 0.2),
    "encoder_eccentricity": (
        ({"level_deg": 1.0, "order": 1.0, "phase_deg": 0.0}, {"level_deg": 1.0, "order": 1.0, "phase_deg": 90.0}),
        "level_deg", 0.0, 3.0,
    ),
}  # fmt: skip
# Those whose columns change with their size are tried at another one too.
WIDER: Mapping[str, Mapping[str, Value]] = {
    "backlash": {"gap_deg": 5.0},
    "input_deadband": {"level_pct": 6.0},
    "voltage_saturation": {"limit_pct": 50.0},
}
# What only an angle can show, and what a model of speed has no use for.
OF_ANGLES = frozenset({"backlash", "encoder_eccentricity", "gravity_load"})


def drifting(model: Model, around: np.ndarray | None = None) -> tuple[Column, ...]:
    """The three that drift in normal running: gain and dry friction by their shares, load in percent of duty; seen
    from ``around`` (3).
    """
    at = np.zeros(3) if around is None else around
    steps = np.diag((GAIN_STEP, SHARE_STEP, LOAD_STEP_PCT))
    units = ("share", "share", "% duty")
    return tuple(
        Column(varied(model, at + own), float(own.sum()), unit) for own, unit in zip(steps, units, strict=True)
    )


def friction_of(model: Model) -> float:
    """Dry friction in percent of duty that a model has, the mean over directions; 0 of none."""
    found = [model.number(key) for key in FRICTIONS if key in model.values]
    return sum(found) / len(found) if found else 0.0


def candidates(model: Model, *, angle: bool = True) -> list[Candidate]:
    """All that may change in a motor of this model, beside the three that drift; ``angle``: the output is an angle.

    First come gain, dry friction and load themselves: a jump of these is an effect, a drift is normal.
    """
    gain, friction, load = drifting(model)
    found = [Candidate("parameter_change", "gain", (gain,), 0.1)]
    if friction_of(model) > 0.0:
        found.append(Candidate("parameter_change", "friction", (friction,), 1.0))
    else:
        tried = model.with_effect("coulomb_friction", {"level_pct": 1.0})
        found.append(Candidate("coulomb_friction", "", (Column(tried, 1.0, "%"),), 3.0))
    found.append(Candidate("constant_load", "", (load,), 3.0))
    slower = model.with_values({TAU: model.number(TAU) * (1.0 + TAU_STEP)})
    found.append(Candidate("parameter_change", "inertia", (Column(slower, TAU_STEP, "share"),), 0.3))
    for name in model.effects:
        sizes = [p.name for p in effect(name).parameters if p.kind == Kind.SIZE]
        found += [_own(model, name, p) for p in sizes if f"{name}.{p}" not in FRICTIONS and name != "constant_load"]
    there = set(model.effects)
    for name, (tries, measure, neutral, usual) in NEW.items():
        if name in there or (not angle and name in OF_ANGLES):
            continue
        if (set(effect(name).equivalents) | set(effect(name).replaces)) & there:
            continue
        unit = effect(name).parameter(measure).unit
        columns = tuple(Column(model.with_effect(name, t), float(t[measure]) - neutral, unit) for t in tries)
        found.append(Candidate(name, "", columns, usual))
        if name in WIDER:
            wide = WIDER[name]
            column = Column(model.with_effect(name, wide), float(wide[measure]) - neutral, unit)
            found.append(Candidate(name, "", (column,), usual))
    return found


def _own(model: Model, name: str, parameter: str) -> Candidate:
    """An effect of the model itself whose size changes, in its own unit."""
    key, bounds = f"{name}.{parameter}", effect(name).parameter(parameter)
    now = model.number(key)
    step = 0.1 * abs(now) or bounds.step
    if now + step > bounds.upper:
        step = -step
    column = Column(model.with_values({key: now + step}), step, bounds.unit)
    return Candidate(name, f"its {parameter}", (column,), max(abs(now), abs(step)))
