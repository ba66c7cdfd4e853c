"""A device node of the system as the board's line: a pty, a gadget's serial port (``/dev/ttyGS0``), a gadget's HID."""

from __future__ import annotations

import errno
import os
import tty
from contextlib import suppress
from pathlib import Path

from firmware_model.errors import FirmwareModelError

PIECE = 4096
MOST_READS = 64  # in one task step


class NodeLine:
    """An open node that is read and written without waiting. *stream*: bytes (serial), not reports (HID)."""

    def __init__(self, path: str, *, stream: bool) -> None:
        self.stream, self.where, self._path = stream, path, path
        self._fd = -1
        try:
            self._open()
        except OSError as exc:
            raise FirmwareModelError(f"cannot open {path}: {exc.strerror}; is the gadget set up?") from exc

    def _open(self) -> None:
        self._fd = os.open(self._path, os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY)
        if self.stream and os.isatty(self._fd):
            tty.setraw(self._fd)

    def receive(self) -> list[bytes]:
        if self._fd < 0:  # given back with the cable, or hung up
            with suppress(OSError):
                self._open()
        came: list[bytes] = []
        try:
            while self._fd >= 0 and len(came) < MOST_READS:
                data = os.read(self._fd, PIECE)
                if data:
                    came.append(data)
                else:  # hung up; a line on which nothing comes would block
                    self._lost()
        except BlockingIOError:
            pass
        except OSError:
            self._lost()
        return came

    def send(self, report: bytes) -> None:
        if self._fd < 0:
            return
        try:
            os.write(self._fd, report)
        except OSError as exc:  # nobody there: a full buffer, or no cable
            if exc.errno == errno.ESHUTDOWN:  # Linux crashes where a HID gadget's node is held until the cable is back
                self._lost()

    def _lost(self) -> None:
        with suppress(OSError):
            os.close(self._fd)
        self._fd = -1

    def close(self) -> None:
        if self._fd >= 0:
            self._lost()


class PtyLine(NodeLine):
    """A pty: a real serial line to the host, which opens ``where``. *link* is a name for it that stays the same."""

    def __init__(self, link: str | None = None) -> None:
        master, self._host_end = os.openpty()  # the host's end stays open here, or a host that leaves would hang us up
        tty.setraw(self._host_end)
        os.set_blocking(master, False)
        self.stream, self._fd = True, master
        self._path = self.where = os.ttyname(self._host_end)
        self._link = Path(link) if link else None
        if self._link is not None:
            try:
                if self._link.is_symlink():
                    self._link.unlink()
                self._link.symlink_to(self._path)
            except OSError as exc:
                self.close()
                raise FirmwareModelError(f"cannot make the link {link}: {exc.strerror}") from exc
            self.where = str(self._link)

    def _open(self) -> None:
        raise OSError("a pty does not come back")

    def close(self) -> None:
        super().close()
        if self._host_end >= 0:
            os.close(self._host_end)
            self._host_end = -1
        if self._link is not None:
            with suppress(OSError):
                if os.readlink(self._link) == self._path:
                    self._link.unlink()
