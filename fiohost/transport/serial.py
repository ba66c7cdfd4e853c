"""A board on a serial line: ``/dev/ttyACM0``, ``COM3``, or a pty.

pyserial finds, opens and sets up the port. The line is a stream: what has come is handed on, all of it. It is taken for
this host alone, its DTR and RTS are left as the system sets them (pyserial would set them too, and that resets some
boards), and where the adapter offers low latency it is asked for (FTDI adapters otherwise wait 16 ms before they hand a
report on). Where a port is a file, bytes go through its descriptor: three system calls a tick, where pyserial makes
eight.
"""

from __future__ import annotations

import errno
import math
import os
import select
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError, TransportError
from fiohost.settings import nearest
from fiohost.transport.access import UDEV_CURE
from fiohost.transport.base import Transport, Way

if TYPE_CHECKING:
    from collections.abc import Iterable

DEFAULT_BAUD = 115_200
WRITE_TIMEOUT_S = 0.05
TIMEOUT_STEP_S = 0.01
PIECE = 4096  # of a read; for more the system must first find memory, which takes longer than all the rest
MOST_BYTES = 1 << 20  # taken in one go: a line that never pauses must not hold up the loop

AS_FILE = os.name == "posix"

# what pyserial and the system raise when a port goes away under them; TypeError comes of a port half closed
_GONE: tuple[type[Exception], ...] = (OSError, TypeError, ValueError)
with suppress(ImportError):
    import termios

    _GONE = (*_GONE, termios.error)


class SerialTransport(Transport):
    """One port. *port* is a path or name, ``VID:PID[:SERIAL]`` of a USB one, or empty for the only USB one.

    A USB port is known by its identity from the first opening on, so that :meth:`reopen` finds it under a new name.
    """

    stream = True
    can_reopen = True

    def __init__(self, port: str, baud: int = DEFAULT_BAUD) -> None:
        self.name = f"serial:{port}" if port else "serial"
        self.facts = {}
        self._asked = port
        self._baud = baud
        self._key: tuple[object, ...] | None = None  # of a USB port, once it is known
        self._port: Any = None
        self._fd: int | None = None  # the port as a file, where it is one

    def open(self) -> None:
        path = _find(self._asked)
        self._open(path)
        info = next((info for info in _ports() if info.device == path), None)
        self._key = _key(info) if info is not None and info.vid is not None else None
        self.identity = _identity(info) if self._key else path
        self.is_known_again = info is not None and bool(info.serial_number)

    def reopen(self) -> None:
        self.close()
        path = self._asked
        if self._key is not None:
            found = [info.device for info in _ports() if info.vid is not None and _key(info) == self._key]
            if not found:
                raise DisconnectedError(f"the board {self.identity} is not back")
            path = found[0]
        self._open(path)

    def _open(self, path: str) -> None:
        try:
            port = _serial_class()(path, self._baud, timeout=0, write_timeout=WRITE_TIMEOUT_S, exclusive=_can_lock())
        except _GONE as exc:
            raise TransportError(_why(path, exc)) from exc
        _keep_others_out(port)
        with suppress(*_GONE, AttributeError, NotImplementedError):
            port.set_low_latency_mode(True)  # a pty and most CDC ports have no such thing
        self._port, self._fd = port, port.fileno() if AS_FILE else None

    def send(self, report: bytes) -> None:
        try:
            if self._fd is not None:
                _write(self._fd, report)
            else:
                self._taken().write(report)
        except _GONE as exc:
            if isinstance(exc, TimeoutError) or type(exc).__name__ == "SerialTimeoutException":
                raise TransportError(
                    f"{self.name} takes no bytes: nobody reads at the other end, or its flow control holds the line"
                ) from exc
            raise self._gone(exc) from exc

    def receive(self, timeout_s: float) -> bytes:
        try:
            data = _read_port(self._taken(), timeout_s) if self._fd is None else _read(self._fd, timeout_s)
        except _GONE as exc:
            raise self._gone(exc) from exc
        if not data:
            raise TelemetryTimeoutError(f"nothing came on {self.name} for {1e3 * timeout_s:.0f} ms")
        return data

    def close(self) -> None:
        port, self._port, self._fd = self._port, None, None
        if port is not None:
            with suppress(*_GONE):
                port.close()

    @property
    def way(self) -> Way | None:
        return None if self._fd is None else Way(fd=self._fd)

    def _taken(self) -> Any:
        if self._port is None:
            raise DisconnectedError(f"{self.name} is not open")
        return self._port

    def _gone(self, exc: Exception) -> DisconnectedError:
        text = " ".join(str(exc).split())
        return DisconnectedError(f"{self.name} went away: the board was unplugged or reset ({text[:120]})")


def _read(fd: int, timeout_s: float) -> bytes:
    """What has come, waited for at most *timeout_s*; nothing then. Raises OSError where the line hung up."""
    if not select.select([fd], [], [], max(timeout_s, 0.0))[0]:
        return b""
    data = os.read(fd, PIECE)
    if not data:
        raise OSError(errno.EIO, "ready, and nothing to read")
    while len(data) % PIECE == 0 and len(data) < MOST_BYTES and select.select([fd], [], [], 0.0)[0]:
        data += os.read(fd, PIECE)
    return data


def _write(fd: int, report: bytes) -> None:
    """All of *report*. Raises TimeoutError where the line does not take it, OSError where it hung up."""
    deadline_s = 0.0
    while report:
        try:
            report = report[os.write(fd, report) :]
            continue
        except BlockingIOError:
            pass
        deadline_s = deadline_s or time.monotonic() + WRITE_TIMEOUT_S
        if not select.select([], [fd], [], max(0.0, deadline_s - time.monotonic()))[1]:
            raise TimeoutError


def _read_port(port: Any, timeout_s: float) -> bytes:
    """The same as :func:`_read` through pyserial, for ports that are no files."""
    waits_s = math.ceil(max(timeout_s, 0.0) / TIMEOUT_STEP_S) * TIMEOUT_STEP_S
    if port.timeout != waits_s:  # pyserial sets up the whole port anew for each change
        port.timeout = waits_s
    data = bytes(port.read(1))
    while data and len(data) < MOST_BYTES and (waiting := port.in_waiting):
        data += port.read(min(waiting, MOST_BYTES - len(data)))
    return data


def _serial_class() -> type[Any]:
    """pyserial's class without its habit of setting DTR and RTS when it opens a port."""
    import serial

    class Port(serial.Serial):  # type: ignore[misc]
        def _update_dtr_state(self) -> None:
            pass

        def _update_rts_state(self) -> None:
            pass

    return Port


def _keep_others_out(port: Any) -> None:
    """Close the port to programs that do not ask for locks. A pty would stay closed when this process is killed."""
    with suppress(*_GONE, ImportError, AttributeError):
        import fcntl

        if not os.ttyname(port.fileno()).startswith("/dev/pts/"):
            fcntl.ioctl(port.fileno(), termios.TIOCEXCL)


def _can_lock() -> bool | None:
    """Windows opens ports for one program at any rate, and pyserial refuses to be asked there."""
    return True if os.name == "posix" else None


def _ports() -> list[Any]:
    from serial.tools.list_ports import comports

    return sorted(comports())


def usb_ports() -> list[Any]:
    """The USB serial ports of this computer, as pyserial describes them (device, vid, pid, serial_number, ...)."""
    return [info for info in _ports() if info.vid is not None]


def _key(info: Any) -> tuple[object, ...]:
    """What stays when a port is plugged in anew: its serial number, or where it has none its place."""
    return (info.vid, info.pid, info.serial_number or f"at {info.location}")


def _identity(info: Any) -> str:
    vid, pid, last = _key(info)
    return f"{vid:04x}:{pid:04x}:{last}"


def _find(asked: str) -> str:
    """The port that *asked* means. Raises ConfigError."""
    is_identity = asked.count(":") >= 1 and "/" not in asked
    if asked and not is_identity:
        return asked
    found = [info for info in usb_ports() if _identity(info).lower().startswith(asked.lower())]
    if len(found) == 1:
        return str(found[0].device)
    known = _listed(info.device for info in usb_ports())
    if not found:
        raise ConfigError(f"no USB serial port{f' {asked}' if asked else ''} is connected; ports: {known}")
    raise ConfigError(f"{len(found)} serial ports fit{f' {asked}' if asked else ''}: say which, serial:PORT; {known}")


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def _why(path: str, exc: Exception) -> str:
    """One sentence on why a port cannot be opened."""
    number = getattr(exc, "errno", None)
    ports = [str(info.device) for info in _ports()]
    if number == errno.ENOENT or "FileNotFoundError" in str(exc):
        hint = nearest(path, ports) if ports else "no serial port is connected"
        return f"there is no serial port {path}; {hint}"
    if number == errno.EACCES:
        return f"no permission for {path}: {UDEV_CURE}"
    if number in (errno.EAGAIN, errno.EBUSY) or "PermissionError" in str(exc):
        return f"{path} is in use by another program (another fiohost, a terminal, ModemManager): end that one first"
    text = " ".join(str(exc).split())
    return f"{path} cannot be opened as a serial port: {text[:160]}"
