"""The board as a HID device of this computer, through ``/dev/uhid`` (Linux, needs root): no cable, the real hidraw.

Events and their sizes are those of the kernel's ``include/uapi/linux/uhid.h``.
"""

from __future__ import annotations

import os
import struct
from contextlib import suppress

from firmware_model.errors import FirmwareModelError

VENDOR_ID, PRODUCT_ID = 0x0483, 0x5750
BUS_USB = 0x03
DATA_MAX = 4096
EVENT_SIZE = 4 + 128 + 64 + 64 + 2 + 2 + 4 * 4 + DATA_MAX  # the largest event, create2
DESTROY, OUTPUT, GET_REPORT, GET_REPORT_REPLY, CREATE2, INPUT2, SET_REPORT, SET_REPORT_REPLY = (
    1, 6, 9, 10, 11, 12, 13, 14,
)  # fmt: skip
EIO = 5


def report_descriptor(in_size: int, out_size: int) -> bytes:
    """A device of the vendor's page 0xFF00 with one input and one output report of bytes, no report IDs."""
    return bytes.fromhex("06 00 FF 09 01 A1 01 15 00 26 FF 00 75 08") + b"".join(
        [
            struct.pack("<BHBB", 0x96, in_size, 0x09, 0x01) + b"\x81\x02",
            struct.pack("<BHBB", 0x96, out_size, 0x09, 0x01) + b"\x91\x02",
            b"\xc0",
        ]
    )


class UhidLine:
    """A HID device that the kernel makes for us. Raises FirmwareModelError where it does not."""

    stream = False

    def __init__(self, in_size: int, out_size: int, serial_number: str = "SIMULATED", path: str = "/dev/uhid") -> None:
        self._out_size = out_size
        descriptor = report_descriptor(in_size, out_size)
        create = struct.pack(
            f"<I128s64s64sHHIIII{DATA_MAX}s", CREATE2, b"fiohost simulated board", b"firmware_model",
            serial_number.encode()[:63], len(descriptor), BUS_USB, VENDOR_ID, PRODUCT_ID, 0x0100, 0, descriptor,
        )  # fmt: skip
        try:
            self._fd = os.open(path, os.O_RDWR | os.O_NONBLOCK)
            os.write(self._fd, create)
        except OSError as exc:
            raise FirmwareModelError(
                f"cannot make a HID device through {path}: {exc.strerror}; it needs Linux, 'modprobe uhid' and root"
            ) from exc
        self.where = f"hid:{serial_number}"

    def receive(self) -> list[bytes]:
        came: list[bytes] = []
        with suppress(BlockingIOError):
            while event := os.read(self._fd, EVENT_SIZE):
                (kind,) = struct.unpack_from("<I", event)
                if kind == OUTPUT:
                    (size,) = struct.unpack_from("<H", event, 4 + DATA_MAX)
                    report = event[4 : 4 + min(size, DATA_MAX)]
                    # the kernel hands on the 0 that stands for "no report ID" in a write to hidraw
                    came.append(report[1:] if size == self._out_size + 1 and report[0] == 0 else report)
                elif kind in (GET_REPORT, SET_REPORT):  # unanswered, they hold up whoever asks for seconds
                    (number,) = struct.unpack_from("<I", event, 4)
                    reply = GET_REPORT_REPLY if kind == GET_REPORT else SET_REPORT_REPLY
                    with suppress(OSError):
                        os.write(self._fd, struct.pack("<IIHH", reply, number, EIO, 0))
        return came

    def send(self, report: bytes) -> None:
        with suppress(OSError):
            os.write(self._fd, struct.pack("<IH", INPUT2, len(report)) + report)

    def close(self) -> None:
        with suppress(OSError):
            os.write(self._fd, struct.pack("<I", DESTROY))
        with suppress(OSError):
            os.close(self._fd)
