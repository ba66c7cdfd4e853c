"""Compilation of the board's kernel, kept on disk between runs.

Numba looks only at the file of the compiled function to tell whether a kept copy is stale; this kernel is put
together from many files. So the copies lie in a folder named by a hash of all of them, in the user's cache. To load a
copy is to run it: a folder that is not this user's own and closed to everybody else is not used, and each process then
compiles for itself.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import platform
import stat
import tempfile
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.extending import register_jitable

numba_config: Any = numba.config
njit: Any = numba.njit

# The kernel allocates nothing and hands its arrays down; without reference counting those calls are free.
OPTIONS: dict[str, Any] = {"error_model": "numpy", "_nrt": False, "no_cfunc_wrapper": True}

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


def _root() -> Path:
    named = os.environ.get("XDG_CACHE_HOME")
    return Path(named) if named else Path.home() / ".cache"


@lru_cache(maxsize=1)
def kept_in() -> str:
    """A folder of this user's own that can be written, or the empty string."""
    try:
        root = _root()
        root.mkdir(parents=True, exist_ok=True, mode=0o700)
        if _others_can_replace(root.resolve()):
            return ""
        folder = root
        for name in ("firmware_model", _fingerprint()):
            folder = folder / name
            with contextlib.suppress(FileExistsError):
                folder.mkdir(mode=0o700)
            if not _is_own(folder):
                return ""
        with tempfile.TemporaryFile(dir=folder):
            return str(folder)
    except (OSError, RuntimeError):  # RuntimeError: no home is known for this user
        return ""


def _others_can_replace(place: Path) -> bool:
    """Whether somebody but this user and root may rename what lies in a folder or in one above it."""
    if os.name != "posix":
        return False
    for folder in (place, *place.parents):
        found = folder.stat()
        shared = stat.S_IMODE(found.st_mode) & 0o022 and not found.st_mode & stat.S_ISVTX
        if shared or found.st_uid not in (0, os.getuid()):
            return True
    return False


def _is_own(folder: Path) -> bool:
    """A folder and no link, of this user, closed to others; one that others could only read is closed now."""
    if os.name != "posix":
        return True
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        return False
    if stat.S_IMODE(found.st_mode) & 0o022 and any(folder.iterdir()):
        return False
    folder.chmod(0o700)
    return True


class PartCode(JITCodeLibrary):
    """Code of a part, as numba translates it. Only where it stands in the kernel is it optimised and made into
    machine code: numba would do both for each part, with all that it calls.
    """

    hint = "inlinehint"

    def finalize(self) -> None:
        whole = self._final_module
        for function in whole.functions:
            if not function.is_declaration:
                function.add_function_attribute(self.hint)
        for called in dict.fromkeys(self._linking_libraries):
            whole.link_in(called._get_module_for_linking(), preserve=True)
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        """None: nothing outside the kernel runs it."""
        self._ensure_finalized()
        return 0

    @property
    def codegen(self) -> PartCode:
        """Asked by numba to tell machine code where its constants are."""
        return self

    def set_env(self, name: str, env: object) -> None:
        """There is no machine code to be told."""


class InlinedCode(PartCode):
    """Code of a part that is put into its callers, however many there are."""

    hint = "alwaysinline"


class PartCompiler(Compiler):
    """Numba's compiler, writing a part's code."""

    code = PartCode

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.state.library = self.state.library or self.code(self.state.targetctx.codegen(), "part")


class InlinedCompiler(PartCompiler):
    """The same for one that is put into its callers."""

    code = InlinedCode


def part(function: Callable[..., Any], *, inline: bool = False) -> Any:
    """Compile a function for the kernel alone, Python runs it as Python; ``inline``: put it into its callers, however
    many there are.
    """
    return register_jitable(pipeline_class=InlinedCompiler if inline else PartCompiler, **OPTIONS)(function)


def entry(function: Callable[..., Any]) -> Any:
    """Compile a function called from Python: without the interpreter's lock, kept on disk where possible."""
    saved = numba_config.CACHE_DIR
    numba_config.CACHE_DIR = kept_in()
    try:
        return njit(nogil=True, cache=bool(kept_in()), **OPTIONS)(function)
    finally:
        numba_config.CACHE_DIR = saved
