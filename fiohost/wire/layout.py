"""A report layout as data: named fields to bytes and back.

A layout is a fixed number of bytes, little-endian and packed; fields stand at their offsets, all other bytes are
zero. Layouts come from the target profiles in ``configs/targets`` and are checked before a byte is sent: overlapping
fields, fields beyond the end, unknown types and names are refused.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

from fiohost.errors import ConfigError, ReportError
from fiohost.settings import Table, nearest

TYPES = {"u8": "B", "i8": "b", "u16": "H", "i16": "h", "u32": "I", "i32": "i", "f32": "f", "f64": "d"}
MAX_REPORT_BYTES = 4096

Value = int | float


@dataclass(frozen=True)
class Field:
    """One number of a report: name, type (a key of TYPES) and offset in bytes."""

    name: str
    type: str
    offset: int

    @property
    def size(self) -> int:
        return struct.calcsize("<" + TYPES[self.type])


@dataclass(frozen=True)
class Layout:
    """A report: its length in bytes and its fields. Raises ConfigError where they do not fit each other."""

    name: str
    length: int
    fields: tuple[Field, ...]

    def __post_init__(self) -> None:
        end, before = 0, "the start"
        for field in self._in_order:
            if field.type not in TYPES:
                raise ConfigError(f"{self.name}: type {field.type!r} is unknown; {nearest(field.type, TYPES)}")
            if field.offset < end:
                raise ConfigError(f"{self.name}: field {field.name!r} at offset {field.offset} overlaps {before}")
            end, before = field.offset + field.size, repr(field.name)
        names = [field.name for field in self.fields]
        if len(set(names)) < len(names):
            raise ConfigError(f"{self.name}: a field is there twice ({', '.join(names)})")
        if end > self.length:
            raise ConfigError(f"{self.name}: field {before} ends at byte {end}, beyond the {self.length} of the report")

    @classmethod
    def from_table(cls, table: Table, names: Sequence[str], required: Sequence[str]) -> Layout:
        """Read ``length`` and ``fields = [{name, type, offset}, ...]``; *names* are the fields that exist.

        ``offset`` may be left out: a field then follows the one before it. Raises ConfigError.
        """
        length = table.integer("length", low=1, high=MAX_REPORT_BYTES)
        fields: list[Field] = []
        for entry in table.tables("fields"):
            after = fields[-1].offset + fields[-1].size if fields else 0
            fields.append(
                Field(
                    entry.text("name", choices=names),
                    entry.text("type", choices=list(TYPES)),
                    entry.integer("offset", after, low=0, high=MAX_REPORT_BYTES),
                )
            )
            entry.finish()
        table.finish()
        missing = [name for name in required if name not in {field.name for field in fields}]
        if missing:
            raise table.fail(f"field {missing[0]!r} is missing")
        return cls(table.where, length, tuple(fields))

    @property
    def _in_order(self) -> list[Field]:
        return sorted(self.fields, key=lambda field: field.offset)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Field names in the order of their bytes, the order of :attr:`packer`'s arguments."""
        return tuple(field.name for field in self._in_order)

    @cached_property
    def packer(self) -> struct.Struct:
        """The whole report as one Struct, gaps and tail as pad bytes."""
        form, at = "<", 0
        for field in self._in_order:
            form += f"{field.offset - at}x" + TYPES[field.type]
            at = field.offset + field.size
        return struct.Struct(form + f"{self.length - at}x")

    def encode(self, values: Mapping[str, Value]) -> bytes:
        """Bytes of a report. Raises ReportError where a value is missing or does not fit its type."""
        try:
            return self.packer.pack(*(values[name] for name in self.names))
        except (struct.error, OverflowError, KeyError) as exc:
            raise ReportError(f"{self.name}: the values {dict(values)} do not fit the report: {exc}") from exc

    def decode(self, report: bytes) -> dict[str, Value]:
        """Values of a report by name. Raises ReportError where its length is not the layout's."""
        if len(report) != self.length:
            raise ReportError(
                f"a report of {len(report)} bytes arrived where {self.length} are expected: "
                "the layout of the target profile is not the board's"
            )
        return dict(zip(self.names, self.packer.unpack(report), strict=True))
