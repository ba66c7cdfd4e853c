"""The one way in and the one way out of the file system, so that nothing is lost without a word.

In: only regular files, up to a size, each refusal in one sentence. Out: nothing that exists is overwritten unless that
was asked for (``--force``), no output is an input of the same command, a log belongs to one run at a time, and what is
a result appears whole or not at all.
"""

from __future__ import annotations

import errno
import os
import re
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from fiohost.errors import FiohostError

_BINARY = getattr(os, "O_BINARY", 0)  # Windows translates line ends without it
MOST_SAID = 1500  # characters of a message
MOST_SHOWN = 200  # characters of a name in a message
FORCE = "--force overwrites it"
_CONTROL = re.compile(r"\x1b\[[0-9;]*m|[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


@dataclass
class _Command:
    """What one command reads and writes."""

    force: bool = False
    tracks: bool = True  # whether inputs and outputs are held against each other
    inputs: list[Path] = field(default_factory=list)
    outputs: list[Path] = field(default_factory=list)


@dataclass(frozen=True)
class FreeName:
    """A name that nobody has chosen: PATH, or the first of PATH-2, PATH-3, ... that does not exist."""

    path: Path


Output = str | Path | FreeName

_command: ContextVar[_Command | None] = ContextVar("command", default=None)


@contextmanager
def command() -> Iterator[None]:
    """What is read and written within belongs together: no output may be an input."""
    token = _command.set(_Command())
    try:
        yield
    finally:
        _command.reset(token)


@contextmanager
def overwriting() -> Iterator[None]:
    """Within it files that exist are overwritten."""
    now = _command.get()
    token = _command.set(_Command(True, now.tracks, now.inputs, now.outputs) if now else _Command(True, False))
    try:
        yield
    finally:
        _command.reset(token)


def is_forced() -> bool:
    now = _command.get()
    return now is not None and now.force


def shown(text: object) -> str:
    """A name for a message: control characters as escapes, the middle of a long one left out."""
    plain = escaped(str(text))
    half = MOST_SHOWN // 2
    return plain if len(plain) <= MOST_SHOWN else f"{plain[:half]}...{plain[-half:]}"


def shortened(text: str, most: int = MOST_SAID) -> str:
    """A message without the middle of what is too long to be read."""
    return text if len(text) <= most else f"{text[: most // 2]} ... {text[-most // 2 :]}"


def escaped(text: str, *, styled: bool = False) -> str:
    """Text whose control characters (but tab and line end) are shown, so that no name plays tricks with a terminal.

    *styled*: colours and weights may stay.
    """
    text = text.encode(errors="surrogateescape").decode(errors="backslashreplace")

    def show(found: re.Match[str]) -> str:
        if found[0] in "\t\n" or (styled and len(found[0]) > 1):
            return found[0]
        return "".join(f"\\x{ord(char):02x}" if ord(char) < 32 or ord(char) > 126 else char for char in found[0])

    return _CONTROL.sub(show, text)


# ---- in ------------------------------------------------------------------------------------------------------------


def read_input(path: str | Path, most_bytes: int, what: str, error: type[FiohostError]) -> bytes:
    """The whole of a regular file of at most *most_bytes*. *what* names its kind in messages. Raises *error*."""
    with open_input(path, most_bytes, what, error) as file:
        try:
            size = os.fstat(file.fileno()).st_size  # a read of all that is allowed takes it all
            data = file.read(min(size, most_bytes) + 1)
            if len(data) > size:  # it grows
                data += file.read(max(0, most_bytes + 1 - len(data)))
        except (OSError, MemoryError) as exc:
            raise error(f"cannot read {what} {shown(path)}: {_why(exc)}") from exc
    if len(data) > most_bytes:
        raise error(_too_large(path, what, most_bytes))
    return data


def open_input(path: str | Path, most_bytes: int, what: str, error: type[FiohostError]) -> BinaryIO:
    """A regular file of at most *most_bytes*, open for reading. Raises *error*."""
    note_input(path, error)
    try:
        fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0) | _BINARY)
    except (OSError, ValueError) as exc:  # ValueError: a zero byte in the name
        kind = _kind_of(path)
        raise error(f"cannot read {what} {shown(path)}: {f'it is {kind}' if kind else _why(exc)}") from exc
    found = os.fstat(fd)
    if stat.S_ISREG(found.st_mode) and found.st_size <= most_bytes:
        return os.fdopen(fd, "rb")
    os.close(fd)
    if not stat.S_ISREG(found.st_mode):
        raise error(f"cannot read {what} {shown(path)}: it is {_kind(found.st_mode)}, not a file")
    raise error(_too_large(path, what, most_bytes))


def entries(folder: Path, what: str, error: type[FiohostError]) -> list[Path]:
    """What is in a folder, in order of names; *what* names its kind in messages. Raises *error*."""
    try:
        return sorted(folder.iterdir())
    except (OSError, ValueError) as exc:
        raise error(f"cannot read {what} {shown(folder)}: {_why(exc)}") from exc


def note_input(path: str | Path, error: type[FiohostError] = FiohostError) -> None:
    """This command reads that file, through a reader of somebody else's. Raises *error* where it also writes it."""
    now = _command.get()
    if now is None or not now.tracks:
        return
    path = Path(path)
    for output in now.outputs:
        if _same(output, path):
            raise error(f"cannot write {shown(output)}: this command reads it; give the output another name")
    now.inputs.append(path)


# ---- out -----------------------------------------------------------------------------------------------------------


def claim(path: str | Path, what: str = "the file") -> Path:
    """Say before any work that this file will be written; *what* names its kind. Raises FiohostError where it could not
    be, or must not be.
    """
    path = Path(path)
    now = _command.get()
    if now is not None:
        for given in now.inputs:
            if _same(given, path):
                raise FiohostError(
                    f"cannot write {what} {shown(path)}: this command reads it; give the output another name"
                )
        if any(_same(output, path) for output in now.outputs):
            raise FiohostError(f"cannot write {what} {shown(path)} twice: give each output a name of its own")
    _check(path, what)
    if now is not None:
        now.outputs.append(path)
    return path


def write_output(path: Output, data: str | bytes) -> Path:
    """Write a result, whole or not at all: under another name first. Gives its name. Raises FiohostError."""
    names = _names(path.path) if isinstance(path, FreeName) else iter([_claimed(Path(path), "the file")])
    if isinstance(data, str):
        data = data.encode(errors="surrogateescape")
    temporary, name = "", Path()
    try:
        for name in names:
            if not temporary:
                temporary = _written(data, name)
            try:
                _put(temporary, name, forced=is_forced() and not isinstance(path, FreeName))
                break
            except FileExistsError:
                if not isinstance(path, FreeName):
                    raise
    except OSError as exc:
        raise FiohostError(f"cannot write {shown(name)}: {_why(exc)}") from exc
    finally:
        _release(name)
        if temporary:
            with suppress(OSError):
                os.unlink(temporary)
    return name


def open_log(path: Output, what: str) -> tuple[BinaryIO, Path]:
    """A file for a log, new or, where that was asked for, emptied; locked against other runs for as long as it is open.

    Unbuffered: a row is one write call. Gives the file and its name; *what* names its kind. Raises FiohostError.
    """
    names = _names(path.path) if isinstance(path, FreeName) else iter([_claimed(Path(path), what)])
    exclusive = 0 if is_forced() and not isinstance(path, FreeName) else os.O_EXCL
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | _BINARY
    for name in names:
        try:
            fd = os.open(name, flags | getattr(os, "O_NOFOLLOW", 0) | exclusive, 0o666)
        except FileExistsError as exc:
            if isinstance(path, FreeName):
                continue
            raise FiohostError(f"cannot write {what} {shown(name)}: {_why(exc)}") from exc
        except OSError as exc:
            raise FiohostError(f"cannot write {what} {shown(name)}: {_why(exc)}") from exc
        finally:
            _release(name)  # it may be read when the run has ended
        try:
            _lock(fd, name)
            with suppress(OSError):
                os.ftruncate(fd, 0)
        except BaseException:
            os.close(fd)
            raise
        return os.fdopen(fd, "r+b", buffering=0), name
    raise AssertionError


def _written(data: bytes, beside: Path) -> str:
    """The name of a new file with *data*, in the folder of another. Raises OSError."""
    fd, temporary = tempfile.mkstemp(prefix=".fiohost-", dir=beside.parent)
    try:
        with os.fdopen(fd, "wb") as stream:
            stream.write(data)
            stream.flush()
            with suppress(OSError, AttributeError):
                os.fchmod(fd, 0o666 & ~_umask())
            os.fsync(fd)
    except BaseException:
        os.unlink(temporary)
        raise
    return temporary


def _release(path: Path) -> None:
    now = _command.get()
    if now is not None and path in now.outputs:
        now.outputs.remove(path)


def report_folder(folder: Path, *, chosen: bool = True) -> Path:
    """A folder for pages, pictures and logs: made, or empty, or to be overwritten. *chosen*: by a person; otherwise the
    first free one of NAME, NAME-2, ... Raises FiohostError.
    """
    for name in [folder] if chosen else _names(folder):
        try:
            if name.is_dir() and chosen:
                if not is_forced() and any(name.iterdir()):
                    raise FiohostError(
                        f"the folder {shown(name)} holds something already: give another name, or --force to overwrite"
                    )
                return name
            name.mkdir(parents=True)
        except FileExistsError:
            if chosen:
                raise FiohostError(f"cannot make the folder {shown(name)}: a file has that name") from None
            continue
        except OSError as exc:
            raise FiohostError(f"cannot make the folder {shown(name)}: {_why(exc)}") from exc
        return name
    raise AssertionError


def make_folder(folder: Path) -> None:
    """A folder and those above it, where they are not there yet. Raises FiohostError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as exc:
        raise FiohostError(f"cannot make the folder {shown(folder)}: {_why(exc)}") from exc


def _names(path: Path) -> Iterator[Path]:
    yield path
    number = 2
    while True:
        yield path.with_name(f"{path.stem}-{number}{path.suffix}")
        number += 1


def _claimed(path: Path, what: str) -> Path:
    """The path, claimed now where it was not before. Raises FiohostError."""
    now = _command.get()
    return path if now is not None and path in now.outputs else claim(path, what)


def _check(path: Path, what: str) -> None:
    """Raises FiohostError."""
    try:
        found = os.lstat(path)
    except FileNotFoundError:
        if not path.parent.is_dir():
            raise FiohostError(f"cannot write {what} {shown(path)}: there is no folder {shown(path.parent)}") from None
        if not os.access(path.parent, os.W_OK):
            raise FiohostError(f"cannot write {what} {shown(path)}: permission denied") from None
        return
    except (OSError, ValueError) as exc:
        raise FiohostError(f"cannot write {what} {shown(path)}: {_why(exc)}") from exc
    if not stat.S_ISREG(found.st_mode):
        raise FiohostError(f"cannot write {what} {shown(path)}: it is {_kind(found.st_mode)}, not an ordinary file")
    if not is_forced():
        raise FiohostError(f"cannot write {what} {shown(path)}: it exists; {FORCE}, or give another name")
    if not os.access(path, os.W_OK):
        raise FiohostError(f"cannot write {what} {shown(path)}: permission denied")


def _put(temporary: str, path: Path, *, forced: bool) -> None:
    """Give a finished file its name. Raises OSError; where somebody has made one of that name meanwhile too."""
    if forced:
        os.replace(temporary, path)
        return
    try:
        os.link(temporary, path)
    except FileExistsError:
        raise
    except OSError:  # no links on this disk
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
        os.replace(temporary, path)


def _lock(fd: int, path: Path) -> None:
    try:
        import fcntl
    except ImportError:  # Windows: exclusive creation is all there is
        return
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as exc:
        if exc.errno in (errno.EWOULDBLOCK, errno.EACCES):
            raise FiohostError(f"another run is writing {shown(path)}: wait for it, or give another name") from exc


def _same(one: Path, other: Path) -> bool:
    try:
        return os.path.samefile(one, other)
    except (OSError, ValueError):
        return os.path.abspath(one) == os.path.abspath(other)


def _kind_of(path: str | Path) -> str:
    try:
        mode = os.stat(path).st_mode
    except (OSError, ValueError):
        return ""
    return "" if stat.S_ISREG(mode) else _kind(mode)


def _kind(mode: int) -> str:
    kinds = {
        stat.S_IFDIR: "a directory",
        stat.S_IFIFO: "a pipe",
        stat.S_IFCHR: "a device",
        stat.S_IFBLK: "a device",
        stat.S_IFSOCK: "a socket",
        stat.S_IFLNK: "a link (name the file itself)",
    }
    return kinds.get(stat.S_IFMT(mode), "something else")


def _why(exc: Exception) -> str:
    if isinstance(exc, OSError):
        return exc.strerror or type(exc).__name__
    return "there is not so much memory" if isinstance(exc, MemoryError) else "its name holds a zero byte"


def _too_large(path: str | Path, what: str, most_bytes: int) -> str:
    size = f"{most_bytes / 1e6:g} MB"
    return f"{what} {shown(path)} is larger than {size}, more than such a file can need: it is none, or must be cut"


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
