"""The picture of a found effect: its torque over what it follows, data, curve, and the equation with its numbers.

The data are the effect's own torque along the run plus what the final model still lacks there: what the motor shows
beyond the rest of the model (a component plus residual plot: Ezekiel 1924; Larsen and McCleary 1972). A wrong shape
stands off the curve.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.estimation.record import ANGLE
from fiohost.judging.followed import bench_angle
from fiohost.judging.missing_torque import missing_torque
from fiohost.motor.effect import Effect, effect
from fiohost.motor.model import Model
from fiohost.report.physical import spoken
from fiohost.report.series import Array, CurvePlot
from fiohost.report.words import effect_words, number

if TYPE_CHECKING:
    from fiohost.discover.diagnose import Diagnosis
    from fiohost.estimation.record import Record
    from fiohost.judging.metrics import Judgement

GRID = 361
BINS = 72
LEAST = 5  # samples of a bin that is shown
MOST_SAMPLES = 40_000  # along which an effect is followed: enough for means in bins
MOVES = 1e-9  # a torque that changes by less follows nothing
SPEED_SHARE = 0.02  # of the top speed: below it the direction is a matter of rounding
ANGLE_LABEL = "shaft angle on the turn (deg)"
TORQUE_LABEL = "torque, + helps forward motion (% of duty)"
READING_LABEL = "reading - angle of the shaft (deg)"
LOAD_LABEL = "load torque, + opposes forward motion (% of duty)"
Torque = Callable[[float, float], float]


def equation_words(item: Effect, parameters: Mapping[str, Any]) -> str:
    """The equation with its numbers: ``load = 2.285 % * sin(theta + 120.3 deg)``.

    ``parameters`` maps the effect's parameters to P of the diagnosis, or to plain values.
    """
    text = item.equation
    named: dict[str, str] = {}
    for parameter in item.parameters:
        told = parameters.get(parameter.name)
        value = told.get("value") if isinstance(told, Mapping) else told
        if value is None:
            continue
        shown = effect_words(value) if isinstance(value, str) else number(float(value), 4)
        unit = "" if isinstance(value, str) else str(told.get("unit", "")) if isinstance(told, Mapping) else ""
        unit = unit or ("" if isinstance(value, str) else parameter.unit)
        words = f"{shown} {unit}".rstrip()
        for name in (parameter.name, re.sub(r"_(pct|deg_s|deg|hz|us|s)$", "", parameter.name)):
            named.setdefault(name, f"({words})" if isinstance(value, float) and value < 0.0 else words)
    if not named:
        return text
    pattern = "|".join(rf"\b{re.escape(name)}\b" for name in sorted(named, key=len, reverse=True))
    filled = re.sub(pattern, lambda match: named[match[0]], text)
    if filled != text:
        return filled
    own = [p.name for p in item.parameters if p.name in named]  # those of a sum stand in no equation
    return f"{text}, with " + ", ".join(f"{spoken(name)} {named[name].strip('()')}" for name in own)


def effect_curves(found: Diagnosis) -> list[CurvePlot]:
    """One picture for each found effect that is a torque over angle or speed, a map of the duty, or an error of the
    sensor over the turn; in their order.
    """
    model = found.final.fit.model
    pictures = []
    for step in found.steps:
        made = _picture(found, model, effect(step.effect))
        if made is not None:
            pictures.append(made)
    return pictures


def _picture(found: Diagnosis, model: Model, item: Effect) -> CurvePlot | None:
    told = {p.name: model.values[f"{item.name}.{p.name}"] for p in item.parameters}
    title = equation_words(item, told)
    if item.command is not None:
        return _command_picture(found, model, item, title)
    if item.measure is not None and item.angle_bound:
        return _reading_picture(found, model, item, title)
    if item.rate is not None or item.bristle is not None or item.moment is not None:
        return None  # has a past: no curve holds it
    if item.torque is None and item.load is None and item.friction is None:
        return None
    helps = item.equation.startswith("torque")  # else the equation is that of a load or friction
    label, torque = (TORQUE_LABEL, _torque(model, item)) if helps else (LOAD_LABEL, _opposite(_torque(model, item)))
    speeds = _top_speed(found)
    by_angle = _varies(torque, [(a, s) for a in np.linspace(0.0, 350.0, 36) for s in (0.5 * speeds,)])
    direction = [torque(a, 0.5 * speeds) - torque(a, -0.5 * speeds) for a in np.linspace(0.0, 350.0, 36)]
    if by_angle and not found.train[0].rotary:
        return None
    both = bool(np.max(np.abs(direction)) > MOVES)
    data = [
        _along(r, j, model, torque, 1.0 if helps else -1.0)
        for r, j in zip(found.train, found.final.judgements, strict=True)
    ]
    samples = [np.concatenate(part) for part in zip(*[d for d in data if d is not None], strict=True)] if data else []
    if not samples:
        return None
    angle, speed, shown = samples
    unit = "deg" if found.train[0].rotary else "mm"
    name = effect_words(item.name)
    if by_angle:
        grid = np.linspace(0.0, 360.0, GRID)
        ways = {"forward": 1.0, "reverse": -1.0} if both else {"": 1.0}
        lines = {f"{name} {way}".strip(): _over(torque, grid, sign * 0.5 * speeds) for way, sign in ways.items()}
        points = {}
        for way, sign in ways.items():
            there = sign * speed > SPEED_SHARE * speeds if way else np.ones(len(speed), dtype=bool)
            points[f"data {way}".strip()] = _means(angle[there], shown[there], np.linspace(0.0, 360.0, BINS + 1))
        return CurvePlot(title, ANGLE_LABEL, label, grid, lines, points=points, equation=title, found=True)
    moving = np.abs(speed) > SPEED_SHARE * speeds
    grid = np.linspace(-speeds, speeds, 2 * GRID)
    line = np.array([torque(0.0, s) for s in grid])
    edges = np.linspace(-speeds, speeds, BINS + 1)
    return CurvePlot(
        title, f"speed ({unit}/s)", label, grid, {name: line},
        points={"data": _means(speed[moving], shown[moving], edges)}, equation=title, found=True,
    )  # fmt: skip


def _command_picture(found: Diagnosis, model: Model, item: Effect, title: str) -> CurvePlot:
    """A map of the duty: what acts over what is commanded, the difference against the duty."""
    hook, q = item.command, _codes(model, item)
    assert hook is not None
    period_s = 1.0 / model.pwm_hz

    def lost(duty: float) -> float:
        return float(hook(duty, period_s, q)) - duty

    records = zip(found.train, found.final.judgements, strict=True)
    pieces = [(r.excitation.duties_pct[: len(r.y)], missing_torque(r, model, j.free_residual)) for r, j in records]
    duty, left = (np.concatenate(part) for part in zip(*pieces, strict=True))
    most = max(float(np.abs(duty).max()), 1.0)
    grid = np.linspace(-most, most, 2 * GRID)
    driven = duty != 0.0
    pick = slice(None, None, max(1, int(driven.sum()) // MOST_SAMPLES))
    shown = np.array([lost(d) for d in duty[driven][pick]]) + left[driven][pick]
    points = _means(duty[driven][pick], shown, np.linspace(-most, most, BINS + 1))
    return CurvePlot(
        title, "commanded duty (%)", "duty that acts - commanded (%)", grid,
        {effect_words(item.name): np.array([lost(d) for d in grid])}, points={"data": points}, equation=title,
        found=True,
    )  # fmt: skip


def _reading_picture(found: Diagnosis, model: Model, item: Effect, title: str) -> CurvePlot | None:
    """An error of the sensor over the turn: the effect's own, with what the final model leaves of the reading."""
    hook, q = item.measure, _codes(model, item)
    assert hook is not None

    def error(theta: float) -> float:
        return float(hook(theta, q)) - theta

    pieces = []
    for record, judgement in zip(found.train, found.final.judgements, strict=True):
        angle = bench_angle(record, judgement)
        if angle is not None:
            pieces.append((angle, judgement.free_residual))
    if not pieces:
        return None
    angle, left = (np.concatenate(part) for part in zip(*pieces, strict=True))
    pick = slice(None, None, max(1, len(angle) // MOST_SAMPLES))
    shown = np.array([error(a) for a in angle[pick]]) + left[pick]
    grid = np.linspace(0.0, 360.0, GRID)
    return CurvePlot(
        title, ANGLE_LABEL, READING_LABEL, grid, {effect_words(item.name): np.array([error(a) for a in grid])},
        points={"data": _means(angle[pick], shown, np.linspace(0.0, 360.0, BINS + 1))}, equation=title, found=True,
    )  # fmt: skip


def _codes(model: Model, item: Effect) -> tuple[float, ...]:
    return tuple(p.code(model.values[f"{item.name}.{p.name}"]) for p in item.parameters)


def _torque(model: Model, item: Effect) -> Torque:
    """The torque that the effect adds at an angle (deg) and a speed (deg/s), in percent of duty: with it minus
    without it in the chain of frictions.
    """
    zero = (0.0, 0.0)
    chain = [effect(name) for name in model.effects]
    frictions = [(e.friction, _codes(model, e), e.name) for e in sorted(chain, key=lambda e: e.stage) if e.friction]
    own = [(hook, _codes(model, item)) for hook in (item.torque, item.load) if hook is not None]

    def level(theta: float, omega: float, direction: float, without: str) -> float:
        value = 0.0
        for hook, q, name in frictions:
            if name != without:
                value = float(hook(value, theta, omega, 0.0, 0.0, direction, zero, q))
        return value

    def torque(theta: float, omega: float) -> float:
        direction = 1.0 if omega >= 0.0 else -1.0
        total = sum(float(hook(theta, omega, 0.0, q)) for hook, q in own)
        if item.friction is not None:
            total -= direction * (level(theta, omega, direction, "") - level(theta, omega, direction, item.name))
        return total

    return torque


def _opposite(torque: Torque) -> Torque:
    return lambda theta, omega: -torque(theta, omega)


def _varies(torque: Torque, places: Sequence[tuple[float, float]]) -> bool:
    return bool(np.ptp([torque(a, s) for a, s in places]) > MOVES)


def _over(torque: Torque, grid: Array, speed: float) -> Array:
    return np.array([torque(a, speed) for a in grid])


def _speed(record: Record, judgement: Judgement) -> Array:
    simulated = judgement.simulated
    return np.gradient(simulated, record.excitation.times_s) if record.kind == ANGLE else np.asarray(simulated)


def _top_speed(found: Diagnosis) -> float:
    speeds = [np.abs(_speed(r, j)) for r, j in zip(found.train, found.final.judgements, strict=True)]
    return max(float(np.quantile(np.concatenate(speeds), 0.999)), 1e-6)


def _along(
    record: Record, judgement: Judgement, model: Model, torque: Torque, sign: float
) -> tuple[Array, Array, Array] | None:
    """Angle on the turn, speed, and the effect's torque plus *sign* times what is still missing, along one record."""
    speed, left = _speed(record, judgement), missing_torque(record, model, judgement.free_residual)
    angle = bench_angle(record, judgement)
    if angle is None:
        angle = np.zeros(len(speed))
    step = max(1, len(speed) // MOST_SAMPLES)
    angle, speed, left = angle[::step], speed[::step], left[::step]
    own = np.array([torque(a, s) for a, s in zip(angle.tolist(), speed.tolist(), strict=True)])
    return angle, speed, own + sign * left


def _means(x: Array, y: Array, edges: Array) -> tuple[Array, Array]:
    """Means of both in bins that hold enough samples."""
    bins = np.digitize(x, edges) - 1
    kept = [i for i in range(len(edges) - 1) if np.count_nonzero(bins == i) >= LEAST]
    return np.array([x[bins == i].mean() for i in kept]), np.array([y[bins == i].mean() for i in kept])


def captions(diagnosis: Mapping[str, Any]) -> list[str]:
    """For every found effect its equation with numbers, for a page made of the JSON alone."""
    said = []
    for step in diagnosis.get("steps") or []:
        try:
            item = effect(str(step.get("effect")))
        except Exception:  # an effect of a package that is not here
            continue
        said.append(f"{effect_words(item.name)}: {equation_words(item, step.get('parameters') or {})}")
    return said
