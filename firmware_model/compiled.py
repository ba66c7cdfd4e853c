"""Compilation of the board's kernel, kept on disk between runs.

Numba looks only at the file of the compiled function to tell whether a kept copy is stale; this kernel is put
together from many files. So the copies lie in a folder named by a hash of all of them, in the user's cache, in the
temporary folder where that cannot be written, or nowhere at all: then each process compiles for itself.
"""

from __future__ import annotations

import contextlib
import getpass
import hashlib
import os
import platform
import tempfile
from collections.abc import Callable, Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba

numba_config: Any = numba.config
njit: Any = numba.njit

# The kernel allocates nothing and hands its arrays down; without reference counting those calls are free.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False}

# the line and its bytes, and what calls the kernel
NOT_COMPILED = ("__main__.py", "emulated", "formats.py", "gadget.py", "lines", "quadrature.py", "serve.py")


def _fingerprint() -> str:
    """Changes whenever a source that can enter the kernel, the interpreter or the compiler does."""
    hasher = hashlib.blake2s(digest_size=10)
    hasher.update(f"{platform.python_version()} {numba.__version__}".encode())
    root = Path(__file__).resolve().parent
    for source in sorted(root.glob("**/*.py")):
        if source.relative_to(root).parts[0] in NOT_COMPILED:
            continue
        hasher.update(str(source.relative_to(root)).encode() + b"\0" + source.read_bytes())
    return hasher.hexdigest()


def _roots() -> Iterator[Path]:
    named = os.environ.get("XDG_CACHE_HOME")
    if named:
        yield Path(named)
    else:
        with contextlib.suppress(RuntimeError):  # no home is known for this user
            yield Path.home() / ".cache"
    try:
        user = getpass.getuser()
    except (OSError, KeyError, ImportError):
        user = "anyone"
    yield Path(tempfile.gettempdir()) / f"cache-of-{user}"


@lru_cache(maxsize=1)
def kept_in() -> str:
    """A folder that can be written, or the empty string."""
    for root in _roots():
        folder = root / "firmware_model" / _fingerprint()
        try:
            folder.mkdir(parents=True, exist_ok=True, mode=0o700)
            with tempfile.TemporaryFile(dir=folder):
                return str(folder)
        except OSError:
            continue
    return ""


def part(function: Callable[..., Any], *, inline: bool = False) -> Any:
    """Compile a function that only the kernel calls; ``inline``: put it into its callers, however many there are."""
    return njit(forceinline=inline, **OPTIONS)(function)


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function called from Python: without the interpreter's lock, kept on disk where possible."""
    saved = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = kept_in()
    try:
        return njit(nogil=True, cache=bool(kept_in()), **OPTIONS)(function)
    finally:
        numba_config.CACHE_DIR = saved
