"""Checks of one effect: bounds, neutral value, derivatives, steady speeds and energy, each with its figure.

They run on the kernel that is fitted, on a motor of 10 deg/s per percent and 80 ms. What holds for the library holds
for an effect from another package: ``fiohost effects check NAME`` and :func:`check_effect` say the same.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fiohost.errors import ModelError
from fiohost.motor.effect import Effect, Kind, Parameter, Value, effect
from fiohost.motor.model import Model

GAIN_DEG_S_PER_PCT, TAU_S, FRICTION_PCT = 10.0, 0.08, 2.0
TICK_S = 0.005
BRAKE, DRIVE, STANDBY = 2, 1, 0
# An effect at its neutral value leaves the angle as it was but for rounding, with steps of the same length.
NEUTRAL_DEG = 1e-6
# Two difference quotients, one of half the step, differ by less than this share of their size.
SMOOTH = 0.1
# A held duty gives a speed that changes by less than this share of the full one from second to second.
STEADY = 0.02
# A shaft that is left alone is never faster in its last seconds than in its first, but for the error of the steps.
ENERGY = 0.01
ROUNDING = 1e-5
# No motor turns faster, whatever its effects: what is beyond has run away.
FASTEST_DEG_S = 1e9
# Where a size begins at its neutral value, and the whole range is too much: this share of it.
TRIED = 0.02
START_DEG_S, ALONE_S, HOLD_S = 300.0, 10.0, 30.0
HELD_PCT = (60.0, -60.0, 20.0, 100.0)


@dataclass(frozen=True)
class Check:
    """One check: whether it is passed, its figure in ``unit`` (None: nothing to measure) and what that is."""

    name: str
    passed: bool
    figure: float | None
    unit: str
    said: str


def check_effect(which: str | Effect) -> tuple[Check, ...]:
    """All checks of an effect of the library, or of another package, by name or itself. Raises ModelError where it is
    not known, or a hook of another package's cannot be compiled.
    """
    from numba.core.errors import NumbaError

    item = effect(which) if isinstance(which, str) else effect(which.name)
    try:
        return _all(item)
    except NumbaError as exc:
        lines = [" ".join(line.split()) for line in str(exc).splitlines() if line.strip()]
        about = next((line for line in lines if "Failed in nopython" not in line), "no reason is given")
        raise ModelError(
            f"the kernel with {item.name!r} and the effects of other packages cannot be compiled: {about[:200]}; a "
            "hook may use numbers, math and plain functions of its own module"
        ) from exc


def _all(item: Effect) -> tuple[Check, ...]:
    bounds = _bounds(item)
    if not bounds.passed:
        return (bounds,)  # what cannot be run within its bounds cannot be tried further
    return (bounds, _neutral(item), _derivatives(item), _steady(item), _energy(item))


def failed(which: str | Effect) -> list[str]:
    """What an effect fails, in words: empty where it passes, for a test of one line."""
    return [f"{check.name}: {check.said}" for check in check_effect(which) if not check.passed]


def _model(item: Effect, values: Mapping[str, Value]) -> Model:
    base = Model((), {"linear.gain_deg_s_per_pct": GAIN_DEG_S_PER_PCT, "linear.tau_s": TAU_S})
    if item.name == "linear":
        return base.with_values({f"linear.{k}": v for k, v in values.items()})
    if item.friction is not None and item.name != "coulomb_friction" and "coulomb_friction" not in item.replaces:
        base = base.with_effect("coulomb_friction", {"level_pct": FRICTION_PCT})
    return base.with_effect(item.name, values)


def _tried(item: Effect) -> dict[str, Value]:
    """Values at which the effect acts: its first trial, else where it starts, vanishing sizes moved a little."""
    values: dict[str, Value] = {p.name: p.start for p in item.parameters}
    if item.name == "linear":
        return {"gain_deg_s_per_pct": GAIN_DEG_S_PER_PCT, "tau_s": TAU_S}
    if item.trials:
        return {**values, **item.trials[0]}
    for i, p in enumerate(item.parameters):
        if p.neutral is not None and p.is_smooth and values[p.name] == p.neutral:
            step = TRIED * (p.upper - p.lower) if np.isfinite(p.upper - p.lower) else p.step
            values[p.name] = float(np.clip(p.neutral + (step if i % 2 else -step), p.lower, p.upper))
    return values


def _run(
    model: Model, duties: np.ndarray, mode: int = DRIVE, speed: float = 0.0, step_s: float | None = None
) -> np.ndarray:
    """Columns (n, 2) of the shown angle in degrees and the shown speed in deg/s, under duties (n) in percent."""
    from fiohost.motor.hooks import measure, measure_speed
    from fiohost.motor.simulate import Excitation, Start, run, seen_angle, start_state
    from fiohost.motor.state import LOAD_OMEGA, OMEGA, THETA

    p, on = model.vector(), model.switches()
    times = np.arange(len(duties)) * TICK_S
    modes = np.full(len(duties) + 1, mode, dtype=np.int64)
    ex = Excitation(times, times, np.concatenate((duties[:1], duties)), modes)
    step_s = model.substep_s() if step_s is None else step_s
    states = run(ex, p, on, step_s, start_state(Start(0.25, speed), p, on))
    seen = seen_angle(p, on)
    rate = OMEGA if seen == THETA else LOAD_OMEGA
    angles, speeds = states[:, seen], states[:, rate]
    if any(part.measure is not None for part in model.parts()):
        angles = np.array([measure(float(angle), (), p, on) for angle in angles])
    if any(part.measure_speed is not None for part in model.parts()):
        speeds = np.array([measure_speed(float(v), (), x, 0, p, on) for v, x in zip(speeds, states, strict=True)])
    return np.column_stack((angles, speeds))


def _pct(share: float) -> str:
    """A share in words; what is rounding alone is told as that."""
    return f"{100.0 * share:.2g} %" if share >= ROUNDING else f"less than {100.0 * ROUNDING:g} %"


def _drawn(seconds: float = 3.0) -> np.ndarray:
    """Duties (n) in percent of some levels in both directions, the same at every call."""
    ticks = round(0.3 / TICK_S)
    levels = np.random.default_rng(7).uniform(-80.0, 80.0, round(seconds / 0.3))
    return np.repeat(levels, ticks)


def _bounds(item: Effect) -> Check:
    """Whether starts, neutral values and trials are allowed, and the motor stays finite at every bound."""
    wrong, tried = [], 0
    for p in item.parameters:
        for what, value in (("start", p.start), ("neutral value", p.neutral)):
            try:
                if value is not None:
                    p.check(value, f"the {what} of {p.name}")
            except ModelError as exc:
                wrong.append(str(exc))
    for trial in item.trials:
        try:
            for name, value in trial.items():
                item.parameter(name).check(value, f"a trial's {name}")
        except ModelError as exc:
            wrong.append(str(exc))
    if not wrong:
        duties, values = _drawn(1.2), _tried(item)
        for p in item.parameters:
            ends: tuple[Value, ...] = p.choices or tuple(v for v in (p.lower, p.upper) if np.isfinite(v))
            for value in ends:
                tried += 1
                y = _run(_model(item, {**values, p.name: value}), duties)
                if not np.all(np.isfinite(y)) or np.max(np.abs(y[:, 1])) > FASTEST_DEG_S:
                    wrong.append(f"at {p.name} = {value} the motor runs away")
    said = "; ".join(wrong) or f"{tried} bounds and choices tried, all finite"
    return Check("bounds", not wrong, float(len(wrong)), "wrong", said)


def _neutral(item: Effect) -> Check:
    """How far the angle is from that of a motor without the effect, at the neutral value."""
    sized = {p.name: p.neutral for p in item.parameters if p.neutral is not None}
    if not sized:
        return Check("neutral", True, None, "deg", "has no neutral value: it is there or not")
    beside = _model(item, {**_tried(item), **sized})
    without = beside.without([item.name])
    step_s = beside.substep_s()
    apart = np.abs(_run(beside, _drawn()) - _run(without, _drawn(), step_s=step_s))
    worst = float(np.max(apart[:, 0]))
    said = f"{worst:.2g} deg" if worst > NEUTRAL_DEG else f"less than {NEUTRAL_DEG:g} deg"
    return Check("neutral", worst <= NEUTRAL_DEG, worst, "deg", f"{said} from a motor without it")


def _derivatives(item: Effect) -> Check:
    """How much two difference quotients of the run by each parameter differ, as a share of their size."""
    values = _tried(item)
    followed = [p for p in item.parameters if p.kind in (Kind.SIZE, Kind.SHAPE, Kind.PHASE)]
    worst, which = 0.0, ""
    for p in followed:
        apart = _roughness(item, values, p)
        if apart > worst:
            worst, which = apart, p.name
    if not followed:
        return Check("derivative", True, None, "of its size", "no parameter is followed by gradients: all are searched")
    said = f"quotients of two steps differ by {_pct(worst)}" + (f" ({which})" if worst >= ROUNDING else "")
    return Check("derivative", worst <= SMOOTH, worst, "of its size", said)


def _roughness(item: Effect, values: Mapping[str, Value], p: Parameter) -> float:
    value = values[p.name]
    assert not isinstance(value, str)
    whole = p.step * (abs(value) if p.relative_step and value else 1.0)
    whole = -whole if value + whole > p.upper else whole
    base = _run(_model(item, values), _drawn())
    scale = np.array([1.0, TAU_S])
    slopes = []
    for step in (whole, 0.5 * whole):
        moved = _run(_model(item, {**values, p.name: value + step}), _drawn())
        slopes.append((moved - base) * scale / step)
    if not np.all(np.isfinite(slopes)):
        return np.inf
    size = float(np.linalg.norm(slopes[0]))
    return float(np.linalg.norm(slopes[0] - slopes[1])) / size if size > 0.0 else 0.0


def _steady(item: Effect) -> Check:
    """How much the mean speed of a second changes to the next, long after each duty was set."""
    worst, second = 0.0, round(1.0 / TICK_S)
    full = 100.0 * GAIN_DEG_S_PER_PCT
    for duty in HELD_PCT:
        angle = _run(_model(item, _tried(item)), np.full(round(HOLD_S / TICK_S), duty))[:, 0]
        last, before = angle[-1] - angle[-1 - second], angle[-1 - second] - angle[-1 - 2 * second]
        worst = max(worst, abs(last - before) / full)
    said = f"from one second to the next a held duty's speed changes by {_pct(worst)} of the full one"
    changing = item.warms or item.once or item.clocked or item.trials_for is not None
    if changing:
        said += "; it may, as it follows time"
    return Check("steady", bool(np.isfinite(worst)) and (changing or worst <= STEADY), worst, "of full speed", said)


def _energy(item: Effect) -> Check:
    """How much faster a shaft without duty, braked or open, becomes in its last seconds than it was in its first."""
    worst, zeros = 0.0, np.zeros(round(ALONE_S / TICK_S))
    part = round(2.0 / TICK_S)
    for mode in (BRAKE, STANDBY):
        for speed in (START_DEG_S, -START_DEG_S):
            angle = _run(_model(item, _tried(item)), zeros, mode, speed)[:, 0]
            ran = np.abs(np.diff(angle)) / TICK_S
            worst = max(worst, float(np.max(ran[-part:]) / max(float(np.max(ran[:part])), 1e-9)) - 1.0)
    said = f"left alone it is {_pct(worst)} faster at the end" if worst > ROUNDING else "left alone it gains no speed"
    if item.drives:
        said += "; it may, as it brings energy of its own"
    passed = bool(np.isfinite(worst)) and (item.drives or worst <= ENERGY)
    return Check("energy", passed, max(worst, 0.0), "faster", said)
