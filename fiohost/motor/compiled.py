"""Compilation of the numeric kernels, kept on disk so that only the first run pays for it.

The cache lives in the user's cache folder under a hash of all sources of this room: numba's own check looks at one file
only and would miss a changed effect. Where no folder can be written the kernels are compiled in memory.

Kernels allocate nothing, so they are compiled without numba's reference counts: the atomic increments at every call
cost more than the physics (a factor of ten on the whole simulation).
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba as _numba

numba: Any = _numba  # its stubs know neither the cache directory nor the switch of reference counts


@cache
def cache_dir() -> Path | None:
    """A writable folder for this version of the sources, or None."""
    digest = hashlib.sha256(f"{sys.version}{numba.__version__}".encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    for root in (Path(base), Path(tempfile.gettempdir()) / f"cache-{os.getuid() if hasattr(os, 'getuid') else 'user'}"):
        folder = root / "fiohost" / "kernels" / digest.hexdigest()[:16]
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            probe = folder / f".probe{os.getpid()}"
            probe.write_bytes(b"")
            probe.unlink()
        except OSError:
            continue
        return folder
    return None


def compiled(function: Callable[..., Any]) -> Any:
    """Compile an entry kernel: cached on disk, running without the interpreter's lock."""
    folder = cache_dir()
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or "")
    try:
        return numba.njit(cache=folder is not None, nogil=True, error_model="numpy", _nrt=False)(function)
    finally:
        numba.config.CACHE_DIR = before


def part(function: Callable[..., Any]) -> Any:
    """Compile a part of an entry kernel that is called, not repeated wherever it is used.

    It says so, as it would inherit ``forceinline`` from a caller: then the compiler hoists the divisions of rare
    branches out of the step's loops and does them at every step.
    """
    return numba.njit(error_model="numpy", forceinline=False, _nrt=False)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a part of an entry kernel; it is kept with the kernel that calls it."""
    return numba.njit(error_model="numpy", forceinline=True, _nrt=False)(function)


@inlined
def sign(value):  # type: ignore[no-untyped-def]
    """-1, 0 or 1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
