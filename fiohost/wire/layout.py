"""A report layout as data: named fields to bytes and back.

A layout is a fixed number of bytes: a report ID, header bytes, fields at their offsets, a CRC, terminator bytes, each
where the layout has one; all other bytes are zero. Layouts come from the target profiles in ``configs/targets`` and are
checked before a byte is sent: parts that overlap or do not fit, unknown types, names and keys are refused.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from fiohost.errors import ConfigError, ReportError
from fiohost.settings import Table, nearest
from fiohost.wire.crc import crc_function, find_crc

TYPES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "f32": "f", "f64": "d"}
BYTE_ORDERS = ("little", "big")
MAX_REPORT_BYTES = 4096
MAX_MARK_BYTES = 16

Value = int | float


@dataclass(frozen=True)
class Field:
    """One number of a report: name, type (a key of TYPES), offset in bytes. Its value is the number times *scale*."""

    name: str
    type: str
    offset: int
    byte_order: str = "little"
    scale: float = 1.0

    @property
    def size(self) -> int:
        return struct.calcsize("<" + TYPES[self.type])

    @property
    def is_whole(self) -> bool:
        """Whether the wire carries a whole number."""
        return not self.type.startswith("f")


@dataclass(frozen=True)
class Check:
    """A CRC of the bytes *first* to *end* (not included), at *offset*."""

    name: str
    offset: int
    first: int
    end: int
    byte_order: str = "little"

    @property
    def size(self) -> int:
        return find_crc(self.name).size


@dataclass(frozen=True)
class Layout:
    """A report: its length in bytes and its parts. Raises ConfigError where they do not fit each other."""

    name: str
    length: int
    fields: tuple[Field, ...]
    report_id: int | None = None
    header: bytes = b""
    terminator: bytes = b""
    crc: Check | None = None

    def __post_init__(self) -> None:
        for field in self.fields:
            if field.type not in TYPES:
                raise ConfigError(f"{self.name}: type {field.type!r} is unknown; {nearest(field.type, TYPES)}")
        names = [field.name for field in self.fields]
        if len(set(names)) < len(names):
            raise ConfigError(f"{self.name}: a field is there twice ({', '.join(names)})")
        parts = [(field.offset, field.size, f"field {field.name!r}") for field in self.fields]
        if self.crc is not None:
            parts.append((self.crc.offset, self.crc.size, "the CRC"))
        end, before = 0, "the start"
        for offset, size, what in [*self._marks(), *sorted(parts)]:
            if offset < end:
                raise ConfigError(f"{self.name}: {what} at offset {offset} overlaps {before}")
            end, before = offset + size, what
        room = self.length - len(self.terminator)
        if end > room:
            of = "the report" if not self.terminator else "the report before its terminator"
            raise ConfigError(f"{self.name}: {before} ends at byte {end}, beyond the {room} of {of}")
        if self.crc is not None and not (
            0 <= self.crc.first < self.crc.end <= self.length
            and (self.crc.offset >= self.crc.end or self.crc.offset + self.crc.size <= self.crc.first)
        ):
            span = f"{self.crc.first}..{self.crc.end}"
            raise ConfigError(
                f"{self.name}: the CRC's bytes {span} are not a part of the report without the CRC itself"
            )

    def _marks(self) -> list[tuple[int, int, str]]:
        """Report ID and header: offset, size, name."""
        marks = [] if self.report_id is None else [(0, 1, "the report ID")]
        return [*marks, (len(marks), len(self.header), "the header")] if self.header else marks

    @classmethod
    def from_table(cls, table: Table, names: Sequence[str], required: Sequence[str]) -> Layout:
        """Read a layout (docs/protocol.md lists the keys); *names* are the fields that exist.

        ``offset`` may be left out: a part then follows the one before it. Raises ConfigError.
        """
        length = table.integer("length", low=1, high=MAX_REPORT_BYTES)
        report_id = table.integer("report_id", low=1, high=255) if "report_id" in table else None
        table.raw("report_id")  # known, though absent
        header, terminator = _bytes_of(table, "header"), _bytes_of(table, "terminator")
        order = table.text("byte_order", "little", choices=BYTE_ORDERS)
        at = (report_id is not None) + len(header)
        fields: list[Field] = []
        for entry in table.tables("fields"):
            field = Field(
                entry.text("name", choices=names),
                entry.text("type", choices=list(TYPES)),
                entry.integer("offset", at, low=0, high=MAX_REPORT_BYTES),
                entry.text("byte_order", order, choices=BYTE_ORDERS),
                entry.number("scale", 1.0, low=1e-12, high=1e12),
            )
            entry.finish()
            fields.append(field)
            at = field.offset + field.size
        crc = _check_of(table.table("crc"), at, order) if "crc" in table else None
        table.raw("crc")
        table.finish()
        missing = [name for name in required if name not in {field.name for field in fields}]
        if missing:
            raise table.fail(f"field {missing[0]!r} is missing")
        return cls(table.where, length, tuple(fields), report_id, header, terminator, crc)

    @property
    def _in_order(self) -> list[Field]:
        return sorted(self.fields, key=lambda field: field.offset)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Field names in the order of their bytes, the order of :attr:`pack`'s arguments."""
        return tuple(field.name for field in self._in_order)

    @property
    def has_marks(self) -> bool:
        """Whether a report can be told from other bytes of a stream."""
        return bool(self.header or self.terminator or self.crc)

    def field(self, name: str) -> Field | None:
        return next((field for field in self.fields if field.name == name), None)

    @cached_property
    def pack(self) -> Callable[..., bytes]:
        """Field values in the order of :attr:`names` to bytes. Raises struct.error, OverflowError or ValueError."""
        pack_numbers, _ = _numbers(self._in_order, self.length)
        mark = (b"" if self.report_id is None else bytes([self.report_id])) + self.header
        ends, terminator, check = self.length - len(self.terminator), self.terminator, self.crc

        def pack_marked(*values: Value) -> bytes:
            return mark + pack_numbers(*values)[len(mark) : ends] + terminator

        def pack_checked(*values: Value) -> bytes:
            report = bytearray(pack_marked(*values))
            assert check is not None
            report[check.offset : check.offset + check.size] = self._crc_bytes(report)
            return bytes(report)

        if check is not None:
            return pack_checked
        return pack_marked if mark or terminator else pack_numbers

    @cached_property
    def unpack(self) -> Callable[[bytes], tuple[Value, ...]]:
        """Bytes to field values in the order of :attr:`names`. Raises ReportError for bytes that are no such report."""
        _, unpack_numbers = _numbers(self._in_order, self.length)
        first = 0 if self.report_id is None else 1
        begins, ends = first + len(self.header), self.length - len(self.terminator)
        length, header, terminator, check = self.length, self.header, self.terminator, self.crc

        def unpack(report: bytes) -> tuple[Value, ...]:
            if len(report) != length:
                raise ReportError(
                    f"a report of {len(report)} bytes arrived where {length} are expected: "
                    "the layout of the target profile is not the board's",
                    "length",
                )
            if first and report[0] != self.report_id:
                raise ReportError(
                    f"a report with ID {report[0]} arrived where {self.report_id} is expected", "report_id"
                )
            if report[first:begins] != header:
                raise ReportError(f"a report begins with {report[:begins].hex(' ')}, not with its header", "header")
            if report[ends:] != terminator:
                raise ReportError(f"a report ends with {report[ends:].hex(' ')}, not with its terminator", "terminator")
            if check is not None and report[check.offset : check.offset + check.size] != self._crc_bytes(report):
                raise ReportError(f"a report's {check.name} does not match: it was damaged on its way", "crc")
            return unpack_numbers(report)

        return unpack

    @cached_property
    def _crc_bytes(self) -> Callable[[bytes | bytearray], bytes]:
        """The CRC of a report, as it stands in it."""
        assert self.crc is not None
        crc, first, end = find_crc(self.crc.name), self.crc.first, self.crc.end
        value, size, big = crc_function(crc), crc.size, self.crc.byte_order == "big"
        return lambda report: value(bytes(report[first:end])).to_bytes(size, "big" if big else "little")

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Bytes of a report. Raises ReportError where a value is missing or does not fit its type."""
        try:
            return self.pack(*(values[name] for name in self.names))
        except (struct.error, OverflowError, ValueError, KeyError) as exc:
            raise ReportError(f"{self.name}: the values {dict(values)} do not fit the report: {exc}") from exc

    def decode(self, report: bytes) -> dict[str, Value]:
        """Values of a report by name. Raises ReportError where it is no such report."""
        return dict(zip(self.names, self.unpack(report), strict=True))

    def peek(self, report: bytes) -> dict[str, Value]:
        """What stands where the fields would be, whatever the marks say; fields beyond the end are left out."""
        found: dict[str, Value] = {}
        for field in self._in_order:
            if field.offset + field.size <= len(report):
                form = struct.Struct(_order_sign(field) + TYPES[field.type])
                found[field.name] = _scaled(form.unpack_from(report, field.offset)[0], field)
        return found


def _numbers(fields: Sequence[Field], length: int) -> tuple[Callable[..., bytes], Callable[[bytes], tuple[Value, ...]]]:
    """Pack and unpack of the fields alone, gaps and marks as zeros."""
    orders = {_order_sign(field) for field in fields}
    if len(orders) <= 1 and not any(_rounds(field) for field in fields):  # the common case, without a detour
        form, at = "".join(orders) or "<", 0
        for field in fields:
            form += f"{field.offset - at}x" + TYPES[field.type]
            at = field.offset + field.size
        whole = struct.Struct(form + f"{length - at}x")
        return whole.pack, whole.unpack
    forms = [(field, struct.Struct(_order_sign(field) + TYPES[field.type])) for field in fields]

    def pack(*values: Value) -> bytes:
        report = bytearray(length)
        for value, (field, form) in zip(values, forms, strict=True):
            form.pack_into(report, field.offset, _raw(value, field))
        return bytes(report)

    def unpack(report: bytes) -> tuple[Value, ...]:
        return tuple(_scaled(form.unpack_from(report, field.offset)[0], field) for field, form in forms)

    return pack, unpack


def _rounds(field: Field) -> bool:
    """Whether its number is not the value itself: it has a scale, or a duty is carried in whole numbers."""
    return field.scale != 1.0 or (field.name == "duty_pct" and field.is_whole)


def _order_sign(field: Field) -> str:
    return ">" if field.byte_order == "big" else "<"


def _raw(value: Value, field: Field) -> Value:
    """The number on the wire, of a whole-number field that is scaled or carries the duty the nearest one."""
    if field.scale == 1.0 and not _rounds(field):
        return value
    return round(value / field.scale) if field.is_whole else value / field.scale


def _scaled(number: Value, field: Field) -> Value:
    return number if field.scale == 1.0 else number * field.scale


def _bytes_of(table: Table, key: str) -> bytes:
    """Bytes written in hex, ``"7E 7E"``."""
    text = table.text(key, "")
    try:
        found = bytes.fromhex(text)
    except ValueError:
        raise table.fail(f'{key} = {text[:60]!r} is not bytes in hex, such as "7E 7E"') from None
    if len(found) > MAX_MARK_BYTES:
        raise table.fail(f"{key} has {len(found)} bytes, more than {MAX_MARK_BYTES}")
    return found


def _check_of(table: Table, at: int, order: str) -> Check:
    name = table.text("name")
    try:
        find_crc(name)
    except ConfigError as exc:
        raise table.fail(str(exc)) from None
    offset = table.integer("offset", at, low=0, high=MAX_REPORT_BYTES)
    check = Check(
        name,
        offset,
        table.integer("first", 0, low=0, high=MAX_REPORT_BYTES),
        table.integer("end", offset, low=0, high=MAX_REPORT_BYTES),
        table.text("byte_order", order, choices=BYTE_ORDERS),
    )
    table.finish()
    return check
