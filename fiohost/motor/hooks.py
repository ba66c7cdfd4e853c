"""The effects' hooks joined into one function for each place where effects act.

Each link is a closure over the one before it, so the compiler sees straight code with one test an effect.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from fiohost.motor.compiled import inlined
from fiohost.motor.effect import effects, layout

EFFECT_INDEX = {name: i for i, name in enumerate(effects())}
N_PARAMETERS = sum(len(e.parameters) for e in effects().values())
N_EFFECTS = len(EFFECT_INDEX)


def _chain(kind: str, start: Callable[..., Any], link: Callable[..., Any]) -> Any:
    total = inlined(start)
    having = [e for e in effects().values() if getattr(e, kind) is not None]
    for item in sorted(having, key=lambda e: (e.stage, e.name)):
        first = layout()[item.name]
        total = link(total, inlined(getattr(item, kind)), EFFECT_INDEX[item.name], first, first + len(item.parameters))
    return total


def _command_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def command(duty_pct, p, on):  # type: ignore[no-untyped-def]
        duty_pct = before(duty_pct, p, on)
        if on[index]:
            duty_pct = hook(duty_pct, p[first:last])
        return duty_pct

    return command


def _torque_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def torque(theta, omega, time, duty, p, on):  # type: ignore[no-untyped-def]
        total = before(theta, omega, time, duty, p, on)
        if on[index]:
            total += hook(theta, omega, time, duty, p[first:last])
        return total

    return torque


def _current_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def current(i, duty, emf, time, winding, p, on):  # type: ignore[no-untyped-def]
        i = before(i, duty, emf, time, winding, p, on)
        if on[index]:
            i = hook(i, duty, emf, time, winding, p[first:last])
        return i

    return current


def _friction_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def friction(level, theta, omega, time, drive, direction, bearing, p, on):  # type: ignore[no-untyped-def]
        level = before(level, theta, omega, time, drive, direction, bearing, p, on)
        if on[index]:
            level = hook(level, theta, omega, time, drive, direction, bearing, p[first:last])
        return level

    return friction


def _breakaway_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def breakaway(p, on):  # type: ignore[no-untyped-def]
        total = before(p, on)
        if on[index]:
            total += hook(p[first:last])
        return total

    return breakaway


def _measure_link(before: Any, hook: Any, index: int, first: int, last: int) -> Any:
    @inlined
    def measure(theta, p, on):  # type: ignore[no-untyped-def]
        theta = before(theta, p, on)
        if on[index]:
            theta = hook(theta, p[first:last])
        return theta

    return measure


command = _chain("command", lambda duty_pct, p, on: duty_pct, _command_link)
current = _chain("current", lambda i, duty, emf, time, winding, p, on: i, _current_link)
torque = _chain("torque", lambda theta, omega, time, duty, p, on: 0.0, _torque_link)
friction = _chain("friction", lambda level, theta, omega, time, drive, direction, bearing, p, on: level, _friction_link)
breakaway = _chain("breakaway", lambda p, on: 0.0, _breakaway_link)
measure = _chain("measure", lambda theta, p, on: theta, _measure_link)
