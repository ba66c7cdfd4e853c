"""Programs from files: Intel HEX as avr-objcopy and arm-none-eabi-objcopy write it."""

from __future__ import annotations

from pathlib import Path

from firmware_model.errors import FirmwareModelError

DATA, END, SEGMENT, START_SEGMENT, UPPER, START = range(6)
MOST_BYTES = 1 << 20


def read_hex(path: Path) -> bytes:
    """The bytes of a program from its lowest address on, gaps filled with FF. Raises FirmwareModelError."""
    try:
        lines = path.read_text(encoding="ascii").split()
    except (OSError, UnicodeDecodeError) as exc:
        raise FirmwareModelError(f"cannot read the program {path}: {exc}") from exc
    pieces: dict[int, bytes] = {}
    upper = 0
    for number, line in enumerate(lines, 1):
        try:
            record = bytes.fromhex(line.removeprefix(":"))
            size, address, kind = record[0], int.from_bytes(record[1:3], "big"), record[3]
            body = record[4 : 4 + size]
        except (ValueError, IndexError):
            record, body, kind, size = b"\1", b"", END, 1
        if line[:1] != ":" or sum(record) % 256 or len(record) != size + 5:
            raise FirmwareModelError(f"{path}, line {number}, is no Intel HEX")
        if kind == END:
            break
        if kind == UPPER:
            upper = int.from_bytes(body, "big") << 16
        elif kind == SEGMENT:
            upper = int.from_bytes(body, "big") << 4
        elif kind == DATA:
            pieces[upper + address] = body
    if not pieces:
        raise FirmwareModelError(f"{path} holds no program")
    first, last = min(pieces), max(at + len(body) for at, body in pieces.items())
    if last - first > MOST_BYTES:
        raise FirmwareModelError(f"{path} spans {last - first} bytes: no program of these boards")
    code = bytearray(b"\xff" * (last - first))
    for at, body in pieces.items():
        code[at - first : at - first + len(body)] = body
    return bytes(code)
