"""Compilation of the numeric kernels, kept on disk so that only the first run pays for it.

The cache lives in the user's cache folder under a hash of all sources of this room: numba's own check looks at one file
only and would miss a changed effect. What lies there is unpickled, which runs code: so each folder below the root is
this user's own, closed to all others and no link, or the kernels are compiled in memory.

Kernels allocate nothing, so they are compiled without numba's reference counts: the atomic increments at every call
cost more than the physics (a factor of ten on the whole simulation). Products and sums may be fused, as a C compiler
does it: results are the same to rounding. Divisors may not be inverted: then the compiler takes their inverses out of
rare branches and computes them at every step.

Parts of a kernel have no entry of their own from Python, which would be compiled as well; Python that calls one runs it
as Python.
"""

from __future__ import annotations

import hashlib
import os
import stat
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numba as _numba
from numba.extending import register_jitable

from fiohost.motor.linked import EntryCompiler, HelperCompiler, InlinedCompiler, PartCompiler, call_by_address

numba: Any = _numba  # its stubs know neither the cache directory nor the switch of reference counts

PRIVATE = 0o700
ROUNDING = {"contract"}
OPTIONS: dict[str, Any] = {
    "error_model": "numpy",
    "fastmath": ROUNDING,
    "_nrt": False,
    "no_cfunc_wrapper": True,
}


@cache
def cache_dir() -> Path | None:
    """A writable folder for this version of the sources, of this user alone, or None.

    Effects of other packages are a part of the kernels: a change in what of them is compiled is another folder.
    """
    from fiohost.motor.own import fingerprint

    digest = hashlib.sha256(f"{sys.version}{numba.__version__}".encode())
    for path in sorted(Path(__file__).parent.rglob("*.py")):
        digest.update(path.read_bytes())
    digest.update(fingerprint())
    base = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    folder = Path(base)
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=PRIVATE)
        if not is_safe_root(folder):
            return None
        for name in ("fiohost", "kernels", digest.hexdigest()[:16]):
            folder = folder / name
            if not make_own(folder):
                return None
        probe = folder / f".probe{os.getpid()}"
        probe.write_bytes(b"")
        probe.unlink()
    except (OSError, RuntimeError):
        return None
    return folder


def make_own(folder: Path) -> bool:
    """Make a folder of this user alone, or see that it is one: no link, owned by this user, closed to others."""
    with suppress(FileExistsError):
        folder.mkdir(mode=PRIVATE)
    if not hasattr(os, "getuid"):
        return True  # Windows keeps the folders of users apart
    found = os.lstat(folder)
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        return False
    if stat.S_IMODE(found.st_mode) & 0o077:
        if any(folder.iterdir()) and stat.S_IMODE(found.st_mode) & 0o022:
            return False  # others may have put something there
        folder.chmod(PRIVATE)
    return True


def is_safe_root(folder: Path) -> bool:
    """Whether nobody but this user and root can put another folder in the place of one below it."""
    if not hasattr(os, "getuid"):
        return True
    for place in (folder.resolve(), *folder.resolve().parents):
        found = os.stat(place)
        if found.st_uid not in (0, os.getuid()):
            return False
        if stat.S_IMODE(found.st_mode) & 0o022 and not found.st_mode & stat.S_ISVTX:
            return False
    return True


def compiled(function: Callable[..., Any]) -> Any:
    """Compile an entry kernel: cached on disk, running without the interpreter's lock."""
    folder = cache_dir()
    before = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(folder or "")
    try:
        return numba.njit(cache=folder is not None, nogil=True, pipeline_class=EntryCompiler, **OPTIONS)(function)
    finally:
        numba.config.CACHE_DIR = before


def shared(signature: Any) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Compile an entry kernel that other entry kernels call at its address; else each would hold a copy of its code,
    optimised and made into machine code once more.
    """

    def made(function: Callable[..., Any]) -> Callable[..., Any]:
        entry = compiled(function)

        @wraps(function)
        def from_python(*args: Any) -> Any:
            return entry(*args)

        call_by_address(from_python, entry, signature, OPTIONS)
        return from_python

    return made


def part(function: Callable[..., Any]) -> Any:
    """Compile a part of an entry kernel that is called, not repeated wherever it is used."""
    return register_jitable(pipeline_class=PartCompiler, **OPTIONS)(function)


def helper(function: Callable[..., Any]) -> Any:
    """Compile a part of an entry kernel that is called or repeated, as LLVM finds best."""
    return register_jitable(pipeline_class=HelperCompiler, **OPTIONS)(function)


def inlined(function: Callable[..., Any]) -> Any:
    """Compile a part of an entry kernel; it is kept with the kernel that calls it."""
    return register_jitable(pipeline_class=InlinedCompiler, **OPTIONS)(function)


@inlined
def sign(value):  # type: ignore[no-untyped-def]
    """-1, 0 or 1."""
    return 1.0 if value > 0.0 else (-1.0 if value < 0.0 else 0.0)
