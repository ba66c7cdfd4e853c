"""A lock of our own on a device that the system would share between two hosts (hidraw, Windows).

A file per device in a folder that all users share, locked for as long as the process lives; a host that was killed
leaves no lock behind, only the file.
"""

from __future__ import annotations

import os
import re
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

from fiohost.errors import TransportError

_PRIVATE = 0o600
_SHARED = 0o666


def _folder() -> Path:
    """Where every user's host looks; only where there is no such place, one of this user's own."""
    for name in ("/run/lock", os.environ.get("XDG_RUNTIME_DIR", "")):
        if name and os.access(name, os.W_OK):
            return Path(name)
    return Path(tempfile.gettempdir())


class DeviceLock:
    """The lock on one device, known by *identity* (any text). Taken when made. Raises TransportError if it is held."""

    def __init__(self, identity: str, what: str) -> None:
        name = re.sub(r"[^A-Za-z0-9._-]+", "-", identity).strip("-")[:100]
        self.path = _folder() / f"fiohost-{name}.lock"
        self._fd = self._open()
        try:
            _lock(self._fd)
        except OSError:
            with suppress(OSError):
                holder = os.pread(self._fd, 20, 0).decode(errors="replace").strip() if os.name == "posix" else ""
            self.release()
            by = f" (process {holder})" if holder.isdigit() else ""
            raise TransportError(
                f"{what} is in use by another fiohost{by}: end that one first, two hosts on one board fight each other"
            ) from None
        with suppress(OSError):
            os.ftruncate(self._fd, 0)
            os.write(self._fd, str(os.getpid()).encode())

    def _open(self) -> int:
        flags = os.O_RDWR | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_CLOEXEC", 0)
        try:
            with suppress(FileNotFoundError):
                return os.open(self.path, flags)
            fd = os.open(self.path, flags | os.O_CREAT, _PRIVATE)
        except OSError as exc:
            raise TransportError(
                f"cannot make the lock {self.path}: {exc.strerror}; another user's host may have left it: remove it"
            ) from exc
        with suppress(OSError, AttributeError):
            os.fchmod(fd, _SHARED)  # whatever the umask: the next user must be able to ask
        return fd

    def release(self) -> None:
        """Give the device back; harmless when done twice."""
        if self._fd >= 0:
            os.close(self._fd)
            self._fd = -1


if sys.platform == "win32":
    import msvcrt

    def _lock(fd: int) -> None:
        msvcrt.locking(fd, msvcrt.LK_NBLCK, 1)

else:
    import fcntl

    def _lock(fd: int) -> None:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
