"""All effects, found by their files, and where each one's numbers lie in the kernel's arrays."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from pkgutil import iter_modules

from firmware_model import effects as folder
from firmware_model.effect import Effect


@cache
def effects() -> dict[str, Effect]:
    """Every effect by name, in the order in which their hooks act."""
    found = [import_module(f"{folder.__name__}.{module.name}").EFFECT for module in iter_modules(folder.__path__)]
    return {effect.name: effect for effect in sorted(found, key=lambda e: (e.stage, e.name))}


@cache
def index_of() -> dict[str, int]:
    """Place of each effect in the array of switches."""
    return {name: i for i, name in enumerate(effects())}
