"""The effects' hooks joined into one function for each place where effects act.

Each link is a closure over the one before it, so the compiler sees straight code with one test an effect. Where a hook
reads its effect's own state, ``shift`` says where in the kernel's array it is: as it was at the beginning of a step, or
as predicted for its middle.
"""

from __future__ import annotations

from collections.abc import Callable
from math import exp, inf, nan
from types import FunctionType
from typing import Any

from fiohost.motor.compiled import inlined, part
from fiohost.motor.effect import Effect, effects, layout

EFFECT_INDEX = {name: i for i, name in enumerate(effects())}
N_PARAMETERS = sum(len(e.parameters) for e in effects().values())
PERIOD = N_PARAMETERS  # behind the effects' parameters: the period of the PWM in s
N_EFFECTS = len(EFFECT_INDEX)
FIXED_STATES = 7  # those of the kernel; the effects' own follow
OWN = {e.name: FIXED_STATES + i for i, e in enumerate(e for e in effects().values() if e.rate is not None)}


def having(*kinds: str) -> list[Effect]:
    """The effects with a hook of one of these kinds, in the order in which they act."""
    found = [e for e in effects().values() if any(getattr(e, kind) for kind in kinds)]
    return sorted(found, key=lambda e: (e.stage, e.name))


def hook(function: Any) -> Any:
    """An effect's hook, compiled with the plain functions of its own module that it calls."""
    return inlined(_with_helpers(function))


def _with_helpers(function: Any) -> Any:
    known = function.__globals__
    called = {name: known[name] for name in function.__code__.co_names if isinstance(known.get(name), FunctionType)}
    own = {n: part(_with_helpers(f)) for n, f in called.items() if f.__module__ == function.__module__}
    if not own:
        return function
    return FunctionType(function.__code__, {**known, **own}, function.__name__, None, function.__closure__)


def _places(item: Effect) -> tuple[int, int, int]:
    first = layout()[item.name]
    return EFFECT_INDEX[item.name], first, first + len(item.parameters)


def _folded(kind: str) -> Any:
    """Hooks that get what came so far and return their own version of it."""

    @inlined
    def total(value, args, p, on):  # type: ignore[no-untyped-def]
        return value

    def link(before: Any, act: Any, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(value, args, p, on):  # type: ignore[no-untyped-def]
            value = before(value, args, p, on)
            if on[index]:
                value = act(value, *args, p[first:last])
            return value

        return chained

    for item in having(kind):
        total = link(total, hook(getattr(item, kind)), *_places(item))
    return total


def _with_state(kind: str) -> Any:
    """As ``_folded``, for hooks that know their effect's own state."""

    @inlined
    def total(value, args, x, shift, p, on):  # type: ignore[no-untyped-def]
        return value

    def link(before: Any, act: Any, slot: int, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(value, args, x, shift, p, on):  # type: ignore[no-untyped-def]
            value = before(value, args, x, shift, p, on)
            if on[index]:
                own = x[slot + shift] if slot else 0.0
                value = act(value, *args, own, p[first:last])
            return value

        return chained

    for item in having(kind):
        total = link(total, hook(getattr(item, kind)), OWN.get(item.name, 0), *_places(item))
    return total


def _joined(kind: str, start: float, join: Callable[[float, float], float]) -> Any:
    """Hooks whose values are joined, by a sum or the like."""
    join = inlined(join)

    @inlined
    def total(args, p, on):  # type: ignore[no-untyped-def]
        return start

    def link(before: Any, act: Any, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(args, p, on):  # type: ignore[no-untyped-def]
            value = before(args, p, on)
            if on[index]:
                value = join(value, act(*args, p[first:last]))
            return value

        return chained

    for item in having(kind):
        total = link(total, hook(getattr(item, kind)), *_places(item))
    return total


def _coupled() -> Any:
    @inlined
    def total(p, on):  # type: ignore[no-untyped-def]
        return 0.0, 0.0, 0.0, 0.0

    def link(before: Any, act: Any, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(p, on):  # type: ignore[no-untyped-def]
            share, half, stiff, damp = before(p, on)
            if on[index]:
                r, h, pulse, ratio = act(p[first:last])
                both = r * (1.0 - r)
                share, half = max(share, r), max(half, h)
                stiff, damp = stiff + both * pulse * pulse, damp + 2.0 * both * ratio * pulse
            return share, half, stiff, damp

        return chained

    for item in having("coupling"):
        total = link(total, hook(item.coupling), *_places(item))
    return total


def _jumped() -> Any:
    """Angle and speed of the load beyond the events in which it stands."""

    @inlined
    def total(theta, omega, p, on):  # type: ignore[no-untyped-def]
        return theta, omega

    def link(before: Any, event: Any, jump: Any, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(theta, omega, p, on):  # type: ignore[no-untyped-def]
            theta, omega = before(theta, omega, p, on)
            if on[index] and event(theta, omega, p[first:last]) < 0.0:
                theta, omega = jump(theta, omega, p[first:last])
            return theta, omega

        return chained

    for item in having("jump"):
        total = link(total, hook(item.event), hook(item.jump), *_places(item))
    return total


def _carried() -> Any:
    """The effects' own states over a step, written ``to`` so many places further on."""

    @inlined
    def total(x, to, omega, amps, dt, p, on):  # type: ignore[no-untyped-def]
        return None

    def link(before: Any, act: Any, slot: int, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(x, to, omega, amps, dt, p, on):  # type: ignore[no-untyped-def]
            before(x, to, omega, amps, dt, p, on)
            if on[index]:
                source, decay = act(x[slot], omega, amps, p[first:last])
                if abs(decay) * dt < 1e-9:
                    x[slot + to] = x[slot] + (source - decay * x[slot]) * dt
                else:
                    x[slot + to] = source / decay + (x[slot] - source / decay) * exp(-decay * dt)

        return chained

    for item in having("rate"):
        total = link(total, hook(item.rate), OWN[item.name], *_places(item))
    return total


def _any(*kinds: str) -> Any:
    """Whether an effect with a hook of one of these kinds is in the model."""
    places = tuple(EFFECT_INDEX[item.name] for item in having(*kinds))

    @inlined
    def found(on):  # type: ignore[no-untyped-def]
        for place in places:  # noqa: SIM110 (numba has no any)
            if on[place]:
                return True
        return False

    return found


def _sum(a: float, b: float) -> float:
    return a + b


def _least(a: float, b: float) -> float:
    return min(a, b)


def _largest(a: float, b: float) -> float:
    return max(a, b)


def _either(a: bool, b: bool) -> bool:
    return a or b


command = _folded("command")
inertia = _folded("inertia")
measure = _folded("measure")
measure_speed = _folded("measure_speed")
voltage = _with_state("voltage")
resistance = _with_state("resistance")
friction = _with_state("friction")
bristle = _with_state("bristle")
drop = _joined("drop", 0.0, _sum)
ceiling = _joined("ceiling", inf, _least)
lag = _joined("lag", 0.0, _largest)
coasts = _joined("coasts", -1.0, _largest)
torque = _joined("torque", 0.0, _sum)
load = _joined("load", 0.0, _sum)
breakaway = _joined("breakaway", 0.0, _sum)
delay = _joined("delay", 0.0, _sum)
margin = _joined("event", inf, _least)
barred = _joined("bars", False, _either)  # type: ignore[arg-type]
coupling = _coupled()
jumped = _jumped()
carry = _carried()
opens = _any("opens")
remembers = _any("rate")
winds = _any("resistance", "drop", "ceiling", "lag", "coasts", "opens", "voltage")
ends = _any("event")


def _moments() -> Any:
    """The next moment after one at which the plant changes, on the bench's clock."""

    @inlined
    def total(now, p, on):  # type: ignore[no-untyped-def]
        return inf

    def link(before: Any, act: Any, index: int, first: int, last: int) -> Any:
        @inlined
        def chained(now, p, on):  # type: ignore[no-untyped-def]
            found = before(now, p, on)
            if on[index]:
                at = act(p[first:last])
                if at > now:
                    found = min(found, at)
            return found

        return chained

    for item in having("moment"):
        total = link(total, hook(item.moment), *_places(item))
    return total


next_moment = _moments()
NO_BRISTLE = nan
