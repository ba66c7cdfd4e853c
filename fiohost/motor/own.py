"""Effects from outside the library: of packages that declare them, and those that a script registers.

A package declares its effects as entry points of the group ``fiohost.effects``: each leads to an :class:`Effect`, a
tuple of them, or a module with ``EFFECTS``. A script calls :func:`register_effect`. Both come before the kernel is
compiled, as every effect is a part of it.
"""

from __future__ import annotations

import hashlib
import inspect
import re
import sys
from collections.abc import Iterable, Mapping
from importlib.metadata import EntryPoint, entry_points
from types import CodeType, FunctionType, ModuleType
from typing import Any

from fiohost.errors import ModelError
from fiohost.motor.effect import HOOKS, Effect

GROUP = "fiohost.effects"
NAME = re.compile(r"[a-z][a-z0-9_]*\Z")
KERNEL = "fiohost.motor.hooks"  # once it is there, all effects are compiled into it

_registered: dict[str, Effect] = {}


def register_effect(effect: Effect) -> Effect:
    """Add an effect to the library of this process, before anything is simulated; it is returned, so that this can
    stand around its definition.

    Raises ModelError for a name that is taken, hooks that take other arguments than theirs, and where the kernel is
    already compiled.
    """
    from fiohost.motor.effect import effects

    if KERNEL in sys.modules:
        raise ModelError(
            f"effect {getattr(effect, 'name', effect)!r} comes too late: the kernel is compiled; register effects "
            f"right after the imports, or declare them as entry points of the group {GROUP!r}"
        )
    check_definition(effect, "register_effect")
    if effect.name in effects():
        raise ModelError(f"there is an effect {effect.name!r} already; give yours another name")
    _registered[effect.name] = effect
    effects.cache_clear()
    return effect


def own_effects(taken: Iterable[str]) -> dict[str, Effect]:
    """Effects of other packages and of this process, by name; ``taken`` are names of the library.

    Raises ModelError where one cannot be loaded, is no effect, or has a name that is taken: a model or a diagnosis that
    silently lacks it would be another one.
    """
    found: dict[str, Effect] = {}
    names = set(taken)
    for point in sorted(entry_points(group=GROUP), key=lambda p: (p.name, p.value)):
        for effect in _loaded(point):
            if effect.name in names:
                raise ModelError(f"{_of(point)}: there is an effect {effect.name!r} already; give it another name")
            names.add(effect.name)
            found[effect.name] = effect
    return {**found, **_registered}


def _of(point: EntryPoint) -> str:
    package = point.dist.name if point.dist is not None else "a package"
    return f"effect {point.name!r} of {package} ({point.value})"


def _loaded(point: EntryPoint) -> tuple[Effect, ...]:
    where = _of(point)
    try:
        what: Any = point.load()
    except Exception as exc:
        text = " ".join(f"{type(exc).__name__}: {exc}".split())[:200]
        raise ModelError(f"{where} cannot be loaded: {text}; mend or uninstall the package") from exc
    if isinstance(what, ModuleType):
        what = getattr(what, "EFFECTS", None)
    items = (what,) if isinstance(what, Effect) else what
    if not isinstance(items, (tuple, list)) or not items:
        raise ModelError(f"{where} is neither an Effect, a tuple of them, nor a module with EFFECTS")
    for item in items:
        check_definition(item, where)
    return tuple(items)


def check_definition(effect: object, where: str) -> None:
    """Refuse what the kernel cannot take: raises ModelError with the reason."""
    if not isinstance(effect, Effect):
        raise ModelError(f"{where}: {effect!r} is no fiohost.Effect")
    where = f"{where}, {effect.name!r}"
    if not NAME.match(effect.name):
        raise ModelError(f"{where}: a name is of small letters, digits and underscores")
    names = [p.name for p in effect.parameters]
    if not names or len(set(names)) != len(names):
        raise ModelError(f"{where}: an effect has at least one parameter, each with a name of its own")
    hooks = {kind: getattr(effect, kind) for kind in HOOKS if getattr(effect, kind) is not None}
    if not hooks:
        raise ModelError(f"{where}: it has no hook, so it does nothing; hooks are {', '.join(HOOKS)}")
    for kind, function in hooks.items():
        if not isinstance(function, FunctionType):
            raise ModelError(f"{where}: {kind} is no plain function, which the kernel could compile")
        given, wanted = list(inspect.signature(function).parameters), HOOKS[kind]
        if len(given) != len(wanted):
            raise ModelError(f"{where}: {kind}({', '.join(given)}) must be {kind}({', '.join(wanted)})")
    if (effect.jump is None) != (effect.event is None):
        raise ModelError(f"{where}: event and jump go together")


def fingerprint() -> bytes:
    """Changes with whatever of these effects is compiled into the kernel: their order, and the code and numbers of
    their hooks. A kept kernel belongs to one fingerprint.
    """
    from fiohost.motor.effect import effects

    digest = hashlib.sha256()
    for name, item in effects().items():
        if item.hook_functions and next(iter(item.hook_functions)).__module__.startswith("fiohost.motor.effects."):
            continue
        digest.update(f"{name} {item.stage} {item.opens} {item.warms} {len(item.parameters)}".encode())
        for kind in HOOKS:
            if (function := getattr(item, kind)) is not None:
                digest.update(f"{kind} {_told(function, set())}".encode())
    return digest.digest()


def _told(function: FunctionType, seen: set[str]) -> str:
    """A function as what it does: its code, its constants, and the values and functions it refers to."""
    seen.add(function.__qualname__)
    refers = inspect.getclosurevars(function)
    known: Mapping[str, Any] = {**refers.globals, **refers.nonlocals}
    values = []
    for name, value in sorted(known.items()):
        if isinstance(value, FunctionType):
            values.append(f"{name}: {_told(value, seen) if value.__qualname__ not in seen else '...'}")
        elif isinstance(value, (int, float, str, tuple)):
            values.append(f"{name} = {value!r}")
        elif not isinstance(value, ModuleType):
            code = getattr(getattr(value, "py_func", None), "__code__", None)
            values.append(f"{name}: {_code(code) if code else type(value).__qualname__}")
    return f"{_code(function.__code__)} {values}"


def _code(code: CodeType) -> str:
    constants = [_code(c) if isinstance(c, CodeType) else repr(c) for c in code.co_consts]
    return f"{code.co_code.hex()} {constants} {code.co_names} {code.co_varnames}"
