"""The effects' hooks, chained once at import into one function of each kind, all effects in it, switched by ``on``."""

from __future__ import annotations

from functools import cache, partial
from typing import Any

from firmware_model.compiled import part
from firmware_model.layout import FIRST_EFFECT, OWN
from firmware_model.registry import effects, index_of

link = partial(part, inline=True)  # most effects are absent: a call would cost more than the switch

# Kinds of hooks an effect can have; all but the first two act on the physics.
HOOKS = (
    "command",
    "measure",
    "voltage",
    "resistance",
    "drop",
    "ceiling",
    "motor_torque",
    "load_torque",
    "friction",
    "breakaway",
    "inertia",
    "rate",
)


@cache
def offsets() -> dict[str, int]:
    """Index of each effect's first parameter in p."""
    result = {}
    place = FIRST_EFFECT
    for name, effect in effects().items():
        result[name] = place
        place += len(effect.parameters)
    return result


@cache
def slots() -> dict[str, int]:
    """Index of each effect's own state in y."""
    result = {}
    place = OWN
    for name, effect in effects().items():
        result[name] = place
        place += effect.states
    return result


def parameter_count() -> int:
    """Length of p."""
    return FIRST_EFFECT + sum(len(effect.parameters) for effect in effects().values())


def state_count() -> int:
    """Length of y."""
    return OWN + sum(effect.states for effect in effects().values())


def _chain(kind: str) -> Any:
    @link
    def chained(value, theta, omega, effort, side, duty, time, y, p, on):  # type: ignore[no-untyped-def]
        return value

    for name, effect in effects().items():
        hook = getattr(effect, kind)
        if hook is not None:
            chained = _link(chained, link(hook), index_of()[name], offsets()[name], slots()[name])
    return chained


def _link(before: Any, hook: Any, index: int, k: int, s: int) -> Any:
    @link
    def chained(value, theta, omega, effort, side, duty, time, y, p, on):  # type: ignore[no-untyped-def]
        value = before(value, theta, omega, effort, side, duty, time, y, p, on)
        if on[index]:
            value = hook(value, theta, omega, effort, side, duty, time, y, p, k, s)
        return value

    return chained


def _simple_chain(kind: str) -> Any:
    @link
    def chained(value, p, on):  # type: ignore[no-untyped-def]
        return value

    for name, effect in effects().items():
        hook = getattr(effect, kind)
        if hook is not None:
            chained = _simple_link(chained, link(hook), index_of()[name], offsets()[name])
    return chained


def _simple_link(before: Any, hook: Any, index: int, k: int) -> Any:
    @link
    def chained(value, p, on):  # type: ignore[no-untyped-def]
        value = before(value, p, on)
        if on[index]:
            value = hook(value, p, k)
        return value

    return chained


def _rate_chain() -> Any:
    @link
    def chained(theta, omega, effort, side, duty, time, y, dy, p, on):  # type: ignore[no-untyped-def]
        return None

    for name, effect in effects().items():
        if effect.rate is not None:
            chained = _rate_link(chained, link(effect.rate), index_of()[name], offsets()[name], slots()[name])
    return chained


def _rate_link(before: Any, hook: Any, index: int, k: int, s: int) -> Any:
    @link
    def chained(theta, omega, effort, side, duty, time, y, dy, p, on):  # type: ignore[no-untyped-def]
        before(theta, omega, effort, side, duty, time, y, dy, p, on)
        dy[s] = hook(y[s], theta, omega, effort, side, duty, time, y, p, k, s) if on[index] else 0.0

    return chained


command = _simple_chain("command")
measure = _simple_chain("measure")
voltage = _chain("voltage")
resistance = _chain("resistance")
drop = _chain("drop")
ceiling = _chain("ceiling")
motor_torque = _chain("motor_torque")
load_torque = _chain("load_torque")
friction = _chain("friction")
breakaway = _chain("breakaway")
inertia = _chain("inertia")
own_rates = _rate_chain()
