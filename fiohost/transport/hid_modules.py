"""Which hidapi there is: its modules under their names, and the rival package that takes one of them.

The PyPI package ``hidapi`` brings on Linux ``hidraw`` (the kernel's own driver: the better one) and ``hid`` (through
libusb, which takes the device away from the kernel meanwhile); elsewhere ``hid`` alone. The package ``hid`` (pyhidapi)
is another one and installs a module ``hid`` too.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib import metadata
from typing import Any

from fiohost.errors import TransportError

CURE = "pip uninstall hid, then pip install --force-reinstall hidapi"


@dataclass(frozen=True)
class Backend:
    """One module that works. ``name`` is hidraw, libusb or native (the system's own, outside Linux)."""

    name: str
    module: Any

    @property
    def version(self) -> str:
        return str(getattr(self.module, "__version__", "unknown"))

    def enumerate(self) -> list[dict[str, Any]]:
        """What is connected, as hidapi describes it."""
        return list(self.module.enumerate())


def find_backends(load: Callable[[str], Any] = importlib.import_module) -> tuple[list[Backend], list[str]]:
    """The modules that work, the better first, and sentences on those that do not. *load* imports a module by name."""
    found: list[Backend] = []
    problems: list[str] = []
    for name in ("hidraw", "hid"):
        try:
            module = load(name)
        except ModuleNotFoundError:
            continue
        except ImportError as exc:
            problems.append(_rival(name) or f"the module {name!r} does not load: {' '.join(str(exc).split())[:120]}")
            continue
        if not (hasattr(module, "device") and hasattr(module, "enumerate")):
            problems.append(_rival(name) or f"the module {name!r} ({_file(module)}) is not the one of hidapi: {CURE}")
            continue
        kind = "hidraw" if name == "hidraw" else "libusb" if found or _is_linux() else "native"
        found.append(Backend(kind, module))
    return found, problems


def working_backends(load: Callable[[str], Any] = importlib.import_module) -> list[Backend]:
    """At least one, or TransportError with what to install."""
    found, problems = find_backends(load)
    if not found:
        raise TransportError("; ".join(problems) or "the package hidapi is not installed: pip install hidapi")
    return found


def _rival(name: str) -> str | None:
    if name != "hid":
        return None
    try:
        version = metadata.version("hid")
    except metadata.PackageNotFoundError:
        return None
    return f"the module 'hid' is that of the package hid {version} (pyhidapi), which is not hidapi: {CURE}"


def _file(module: Any) -> str:
    return str(getattr(module, "__file__", "unknown"))


def _is_linux() -> bool:
    import sys

    return sys.platform.startswith("linux")
