"""A board over USB HID, through hidapi: ``hid`` (the only one of its kind) or ``hid:SERIAL_OR_PATH``.

hidapi is used as it is, not as one would think: a write that fails gives -1 and raises nothing; a read gives ``[]``
when its time is over, blocks for ever on a time of 0, and raises an OSError without a number both for an unplugged
board and for a signal that came meanwhile; opening fails alike for missing, busy and forbidden. Reports wait in a
queue, so the newest is taken and the others are counted.

Two things come from beyond hidapi. A board's endpoint keeps what it could not deliver while no host was there, so the
first report after opening may be as old as the last host. And a report as long as the endpoint's packet may be followed
by an empty packet, which ends the transfer (USB 2.0, 5.7.3; Linux' gadgets do so since 2025): over libusb that is an
empty report, which looks like "nothing there" and stands between the reports that wait.
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError, TransportError
from fiohost.transport.access import refusal, usb_interface, usb_node
from fiohost.transport.base import Transport, Way
from fiohost.transport.hid_modules import Backend, working_backends
from fiohost.transport.lock import DeviceLock

MAX_REPORT = 4096
FULL_QUEUE = 30  # reports at once: the queue may have been full, and the newest of it is old
MOST_DRAINED = 1000
EMPTY_READS = 2  # in a row: nothing waits; a single one may be the empty packet behind a report
STALE_S = 0.05  # after opening: what has come by then may be old (the kernel's driver waits as long for its hidraw)
TRIES = 3  # of a call that a signal may have cut short
VENDOR_PAGES = 0xFF00

Info = dict[str, Any]


class HidTransport(Transport):
    """One HID device. *which* is a serial number, a path as ``fiohost devices`` shows it, ``VID:PID[:SERIAL]``, or "".

    *numbered*: reports begin with a report ID in both directions. What comes within *stale_s* of opening is not read;
    the line can be written to at once.
    """

    can_reopen = True

    def __init__(
        self,
        which: str,
        vendor_id: int | None,
        product_id: int | None,
        *,
        numbered: bool = False,
        backends: Sequence[Backend] | None = None,
        stale_s: float = STALE_S,
    ) -> None:
        self.name = f"hid:{which}" if which else "hid"
        self.facts = {}
        self._which, self._vendor_id, self._product_id = which, vendor_id, product_id
        self._prefix = b"" if numbered else b"\0"
        self._given = backends
        self._stale_s = stale_s
        self._fresh_from_s = 0.0  # on the monotonic clock; 0: all is fresh
        self._found_gone = False
        self._device: Any = None
        self._backend: Backend | None = None
        self._lock: DeviceLock | None = None
        self._known: Info | None = None  # the board that was opened, to be found again

    # ---- opening --------------------------------------------------------------------------------------------------

    def open(self) -> None:
        self._take(self._is_meant, f"no HID device {self._wanted()} is connected")

    def reopen(self) -> None:
        self.close()
        known = self._known
        if known is None:
            return self.open()
        return self._take(lambda info: _same_board(info, known), f"the board {self.identity} is not back")

    def _take(self, fits: Callable[[Info], bool], missing: str) -> None:
        """Open the device that *fits* through the first backend that can. Raises TransportError, ConfigError."""
        seen: set[str] = set()
        reason = ""
        for backend in self._backends():
            everything = backend.enumerate()
            seen.update(label(info) for info in everything)
            info = self._one_of([info for info in everything if fits(info)])
            if info is None:
                continue
            reason = self._open(backend, info) or ""
            if not reason:
                return
        names = ", ".join(sorted(seen)[:8]) or "none"
        raise TransportError(reason or f"{missing}; HID devices: {names}; 'fiohost devices' lists what is there")

    def _backends(self) -> Sequence[Backend]:
        if self._given is None:
            self._given = working_backends()
        return self._given

    def _one_of(self, found: list[Info]) -> Info | None:
        """The device, where one fits. Raises ConfigError where several do."""
        if any(info.get("usage_page", 0) >= VENDOR_PAGES for info in found):  # a board may be a keyboard as well
            found = [info for info in found if info.get("usage_page", 0) >= VENDOR_PAGES]
        boards = {board_key(info): info for info in found}
        if len(boards) > 1:
            names = ", ".join(sorted(f"hid:{path_text(info)}" for info in boards.values()))
            raise ConfigError(f"{len(boards)} HID devices fit {self._wanted()}: say which: {names}")
        return next(iter(boards.values()), None)

    def _wanted(self) -> str:
        identity = "" if self._vendor_id is None else f"{self._vendor_id:04x}:{self._product_id or 0:04x}"
        return self._which or identity or "of any kind"

    def _is_meant(self, info: Info) -> bool:
        which = self._which
        pair = re.fullmatch(r"([0-9a-fA-F]{4}):([0-9a-fA-F]{4})(?::(.+))?", which)
        if pair:
            same = (info["vendor_id"], info["product_id"]) == (int(pair[1], 16), int(pair[2], 16))
            return same and pair[3] in (None, info.get("serial_number"))
        if which:
            return which in (path_text(info), board_key(info), info.get("serial_number"))
        wanted = (self._vendor_id, self._product_id)
        return self._vendor_id is not None and wanted == (info["vendor_id"], info["product_id"])

    def _open(self, backend: Backend, info: Info) -> str | None:
        """Lock and open; the reason where it does not open. Raises TransportError where another host has the lock."""
        what = f"the board {_handle(info)}"
        lock = DeviceLock(board_key(info), what)
        device = backend.module.device()
        try:
            device.open_path(info["path"])
            device.set_nonblocking(1)
        except (OSError, ValueError) as exc:
            lock.release()
            return _why(info, what, exc)
        self._device, self._lock, self._backend, self._known = device, lock, backend, info
        self.identity = _handle(info)
        self.is_known_again = bool(info.get("serial_number"))
        self.facts = {"hid_backend": f"{backend.name} {backend.version}"}
        self._found_gone = False
        self._drain()  # what an earlier host left there
        self._fresh_from_s = time.monotonic() + self._stale_s if self._stale_s else 0.0
        return None

    def close(self) -> None:
        device, self._device = self._device, None
        if device is not None:
            with suppress(OSError, ValueError):
                device.close()
        if self._lock is not None:
            self._lock.release()
            self._lock = None

    @property
    def way(self) -> Way | None:
        if self._device is None or self._known is None or self._backend is None:
            return None
        path = path_text(self._known)
        is_node = path.startswith("/dev/hidraw")
        module = "" if is_node else getattr(self._backend.module, "__name__", "")
        return Way(path=path, module=module, prefix=self._prefix) if is_node or module else None

    # ---- talking --------------------------------------------------------------------------------------------------

    def send(self, report: bytes) -> None:
        device = self._taken()
        for _ in range(TRIES):
            try:
                if device.write(self._prefix + report) >= 0:
                    return
            except (OSError, ValueError) as exc:  # ValueError: closed meanwhile
                raise self._gone(exc) from exc
        why = _last_error(device)
        if self._is_gone():
            raise self._gone(why)
        raise TransportError(
            f"{self.name} takes no report ({why or 'no reason given'}): its reports are not those of the target "
            "profile, or the board is busy; 'fiohost doctor' looks closer"
        )

    def receive(self, timeout_s: float) -> bytes:
        deadline_s = time.monotonic() + timeout_s
        if self._fresh_from_s and not self._passes_stale(deadline_s):
            raise self._silence(timeout_s)
        while True:
            left_s = deadline_s - time.monotonic()
            first = self._read(math.ceil(1e3 * left_s)) if left_s > 0.0 else self._read()
            if first:
                break
            if left_s <= 0.0:
                raise self._silence(timeout_s)
        newest, others = self._drain(first)
        if others >= FULL_QUEUE:  # a full queue loses the newest: what is in it is old, what comes next is not
            left_s = deadline_s - time.monotonic()
            fresh = self._read(math.ceil(1e3 * left_s)) if left_s > 0.0 else b""
            if fresh:
                newest, more = self._drain(fresh)
                others += 1 + more
        self.passed_over += others
        return newest

    def _passes_stale(self, deadline_s: float) -> bool:
        """Wait for what the board kept from before, and throw it away; False where *deadline_s* comes first."""
        time.sleep(max(0.0, min(self._fresh_from_s, deadline_s) - time.monotonic()))
        if deadline_s < self._fresh_from_s:
            return False
        self._drain()
        self._fresh_from_s = 0.0
        return True

    def _drain(self, newest: bytes = b"") -> tuple[bytes, int]:
        """The newest report that waits, and how many older ones (*newest*, which had come, among them)."""
        others = empty = 0
        while others < MOST_DRAINED and empty < EMPTY_READS:
            report = self._read()
            if report:
                newest, others, empty = report, others + 1, 0
            else:
                empty += 1
        return newest, others

    def _read(self, timeout_ms: int = 0) -> bytes:
        """One report, or nothing: at once without a time, since the device was set not to block."""
        device = self._taken()
        for left in reversed(range(TRIES)):
            try:
                return bytes(device.read(MAX_REPORT, timeout_ms) if timeout_ms else device.read(MAX_REPORT))
            except (OSError, ValueError) as exc:
                if not left or isinstance(exc, ValueError):
                    raise self._gone(exc) from exc
        raise AssertionError

    def _silence(self, timeout_s: float) -> TelemetryTimeoutError:
        return TelemetryTimeoutError(f"nothing came from {self.name} for {1e3 * timeout_s:.0f} ms")

    def _taken(self) -> Any:
        if self._device is None:
            raise DisconnectedError(f"{self.name} is not open")
        return self._device

    def _is_gone(self) -> bool:
        backend, known = self._backend, self._known
        if self._found_gone or backend is None or known is None:  # libusb takes a tenth of a second to tell
            return True
        return not any(info["path"] == known["path"] for info in backend.enumerate())

    def _gone(self, why: object) -> DisconnectedError:
        self._found_gone = True
        return DisconnectedError(
            f"{self.name} went away: the board was unplugged or reset ({why or 'no reason given'})"
        )


# ---- what hidapi says of a device ------------------------------------------------------------------------------------


def path_text(info: Info) -> str:
    path = info["path"]
    return path.decode(errors="replace") if isinstance(path, bytes) else str(path)


def board_key(info: Info) -> str:
    """Which board it is, whatever the backend: its place on the USB where that is known, else its path."""
    path = path_text(info)
    return usb_interface(path) if path.startswith("/dev/") and usb_interface(path) else path


def node_of(info: Info) -> str:
    """The device node that must be readable and writable to open it; empty where it is not known."""
    path = path_text(info)
    return path if path.startswith("/dev/") else usb_node(path)


def _handle(info: Info) -> str:
    """A short name of a board that ``hid:`` takes: the serial number where it has one."""
    return str(info.get("serial_number") or path_text(info))


def label(info: Info) -> str:
    name = info.get("product_string") or "unnamed"
    return f"{info['vendor_id']:04x}:{info['product_id']:04x} {name}"


def _same_board(info: Info, known: Info) -> bool:
    if (info["vendor_id"], info["product_id"]) != (known["vendor_id"], known["product_id"]):
        return False
    if info.get("interface_number", -1) != known.get("interface_number", -1):
        return False
    if known.get("serial_number"):
        return bool(info.get("serial_number") == known["serial_number"])
    return board_key(info) == board_key(known)


def _why(info: Info, what: str, exc: Exception) -> str:
    node = node_of(info)
    reason = refusal(node, what) if node else None
    return reason or (
        f"{what} cannot be opened ({exc}), though it is there and permitted: another program holds it, or it was just "
        "plugged in; try again"
    )


def _last_error(device: Any) -> str:
    with suppress(OSError, ValueError, AttributeError):
        return " ".join(str(device.error()).split())[:120]
    return ""
