"""Cyclic redundancy checks by their standard names.

Names and parameters (width, polynomial, initial value, reflection, final XOR) are those of the catalogue of
parametrised CRC algorithms (reveng.sourceforge.io/crc-catalogue); its check value of each, over the bytes
``123456789``, stands beside them and is held by a test.
"""

from __future__ import annotations

import binascii
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from fiohost.errors import ConfigError
from fiohost.settings import nearest


@dataclass(frozen=True)
class Crc:
    """One algorithm: *reflected* where both input and output are (bits travel least significant first)."""

    width: int
    polynomial: int
    initial: int
    reflected: bool
    final_xor: int
    check: int

    @property
    def size(self) -> int:
        """Bytes of the result."""
        return self.width // 8


CATALOGUE = {
    "CRC-8/SMBUS": Crc(8, 0x07, 0x00, False, 0x00, 0xF4),
    "CRC-8/MAXIM-DOW": Crc(8, 0x31, 0x00, True, 0x00, 0xA1),
    "CRC-16/ARC": Crc(16, 0x8005, 0x0000, True, 0x0000, 0xBB3D),
    "CRC-16/CCITT-FALSE": Crc(16, 0x1021, 0xFFFF, False, 0x0000, 0x29B1),
    "CRC-16/IBM-SDLC": Crc(16, 0x1021, 0xFFFF, True, 0xFFFF, 0x906E),
    "CRC-16/KERMIT": Crc(16, 0x1021, 0x0000, True, 0x0000, 0x2189),
    "CRC-16/MODBUS": Crc(16, 0x8005, 0xFFFF, True, 0x0000, 0x4B37),
    "CRC-16/XMODEM": Crc(16, 0x1021, 0x0000, False, 0x0000, 0x31C3),
    "CRC-32/ISO-HDLC": Crc(32, 0x04C11DB7, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xCBF43926),
    "CRC-32/ISCSI": Crc(32, 0x1EDC6F41, 0xFFFFFFFF, True, 0xFFFFFFFF, 0xE3069283),
    "CRC-32/MPEG-2": Crc(32, 0x04C11DB7, 0xFFFFFFFF, False, 0x00000000, 0x0376E6E7),
}
ALIASES = {
    "CRC-16/IBM-3740": "CRC-16/CCITT-FALSE",
    "CRC-16/X-25": "CRC-16/IBM-SDLC",
    "CRC-16/CCITT": "CRC-16/KERMIT",
    "CRC-16": "CRC-16/ARC",
    "CRC-32": "CRC-32/ISO-HDLC",
    "CRC-32C": "CRC-32/ISCSI",
}


def find_crc(name: str) -> Crc:
    """The algorithm of that name or alias. Raises ConfigError with the nearest one."""
    name = ALIASES.get(name, name)
    if name not in CATALOGUE:
        raise ConfigError(f"CRC {name!r} is unknown; {nearest(name, [*CATALOGUE, *ALIASES])}")
    return CATALOGUE[name]


@cache
def crc_function(crc: Crc) -> Callable[[bytes], int]:
    """The algorithm as a function of bytes: Python's own where it has it, else one table look-up a byte."""
    if (crc.width, crc.polynomial, crc.reflected, crc.final_xor) == (16, 0x1021, False, 0):
        return lambda data: binascii.crc_hqx(data, crc.initial)
    if crc == CATALOGUE["CRC-32/ISO-HDLC"]:
        return binascii.crc32
    table = tuple(_remainder(crc, byte) for byte in range(256))
    width, initial, final = crc.width, crc.initial, crc.final_xor
    mask, shift = (1 << width) - 1, width - 8
    begin = int(f"{initial:0{width}b}"[::-1], 2) if crc.reflected else initial

    def reflected(data: bytes) -> int:
        value = begin
        for byte in data:
            value = value >> 8 ^ table[(value ^ byte) & 0xFF]
        return value ^ final

    def forward(data: bytes) -> int:
        value = begin
        for byte in data:
            value = value << 8 & mask ^ table[value >> shift ^ byte]
        return value ^ final

    return reflected if crc.reflected else forward


def _remainder(crc: Crc, byte: int) -> int:
    """What eight steps of polynomial division make of one byte."""
    if crc.reflected:
        value, divisor = byte, int(f"{crc.polynomial:0{crc.width}b}"[::-1], 2)
        for _ in range(8):
            value = value >> 1 ^ (divisor if value & 1 else 0)
        return value
    value, top = byte << crc.width - 8, 1 << crc.width - 1
    for _ in range(8):
        value = (value << 1 ^ (crc.polynomial if value & top else 0)) & (1 << crc.width) - 1
    return value
