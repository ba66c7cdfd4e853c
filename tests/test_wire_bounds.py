"""Layouts and messages to the last byte and number."""

from __future__ import annotations

import struct
from typing import Any

import pytest
from test_exact_bounds import beyond
from test_framing import layout

from fiohost.errors import ConfigError, ReportError
from fiohost.transport.profile import TargetProfile
from fiohost.wire.crc import crc_function, find_crc
from fiohost.wire.dump import field_words
from fiohost.wire.layout import Field, Layout
from fiohost.wire.link import Link
from fiohost.wire.messages import (
    BRAKE_COMMAND,
    MODE_NAMES,
    NUMBERED_TELEMETRY_FIELDS,
    STANDBY_COMMAND,
    Codec,
    Command,
    Telemetry,
)

FRAMED = TargetProfile.load("serial-framed").codec
DIRECTION = {"name": "direction", "type": "u8"}

# ---- layouts -------------------------------------------------------------------------------------------------------


def keyed(key: str, value: object) -> Layout:
    """A layout with one number set."""
    where, _, name = key.rpartition(".")
    if where == "crc":
        return layout(length=4096, crc={"name": "CRC-16/ARC", "offset": 10, "end": 3, name: value})
    if where == "field":
        return layout(length=4096, fields=[DIRECTION, {"name": "pos", "type": "u16", name: value}])
    return layout(**{"length": 4096, key: value})


@pytest.mark.parametrize(
    ("key", "low", "high"),
    [
        ("length", 3, 4096),
        ("report_id", 1, 255),
        ("field.offset", 1, 4094),
        ("field.scale", 1e-12, 1e12),
        ("crc.offset", 3, 4094),
        ("crc.first", 0, 2),
        ("crc.end", 1, 10),
    ],
)
def test_numbers_of_a_layout_end_where_they_must(key: str, low: float, high: float) -> None:
    if key == "report_id":  # it takes the first byte
        shifted = [DIRECTION | {"offset": 1}, {"name": "pos", "type": "u16"}]
        for value in (low, high):
            assert layout(report_id=value, fields=shifted).report_id == value
    else:
        for value in (low, high):
            keyed(key, value)
    for value in beyond(low, high):
        with pytest.raises(ConfigError):
            keyed(key, value)


@pytest.mark.parametrize("key", ["length", "field.offset", "crc.offset", "crc.first", "crc.end"])
def test_no_number_of_a_layout_is_beyond_the_largest_report(key: str) -> None:
    """Refused for itself from 4097 on, and for what it does not fit before."""
    for value, said in ((4096, r"beyond|overlaps|part of the report"), (4097, r"outside \d+\.\.4096")):
        if key == "length" and value == 4096:
            continue
        with pytest.raises(ConfigError, match=said):
            keyed(key, value)
    for value in (-1, 0 if key == "length" else -2):
        with pytest.raises(ConfigError, match="outside"):
            keyed(key, value)


def test_a_report_of_one_byte_may_be_one() -> None:
    with pytest.raises(ConfigError, match="ends at byte 3, beyond the 1 of the report"):
        layout(length=1)
    assert Layout("one", 1, (Field("direction", "u8", 0),)).decode(b"\x01") == {"direction": 1}


def test_a_header_is_sixteen_bytes_at_most() -> None:
    fields = [DIRECTION, {"name": "pos", "type": "u16"}]
    assert layout(length=30, header="00" * 16, fields=fields).header == bytes(16)
    with pytest.raises(ConfigError, match="header has 17 bytes, more than 16"):
        layout(length=30, header="00" * 17, fields=fields)


@pytest.mark.parametrize(
    ("crc", "is_sound"),
    [
        ({"offset": 4, "first": 0, "end": 4}, True),
        ({"offset": 4, "first": 0, "end": 5}, False),
        ({"offset": 4, "first": 6, "end": 16}, True),  # of what comes behind it
        ({"offset": 4, "first": 5, "end": 16}, False),
        ({"offset": 4, "first": 2, "end": 2}, False),
        ({"offset": 4, "first": 6, "end": 17}, False),
        ({"offset": 14, "first": 0, "end": 14}, True),
    ],
)
def test_a_crc_is_of_other_bytes_than_its_own(crc: dict[str, int], is_sound: bool) -> None:
    if not is_sound:
        with pytest.raises(ConfigError, match=r"the CRC's bytes .* are not a part of the report"):
            layout(crc={"name": "CRC-16/ARC", **crc})
        return
    told = layout(crc={"name": "CRC-16/ARC", **crc})
    report = told.encode({"direction": 1, "pos": 0x0102})
    value = crc_function(find_crc("CRC-16/ARC"))(report[crc["first"] : crc["end"]])
    assert report[crc["offset"] : crc["offset"] + 2] == value.to_bytes(2, "little")
    assert told.decode(report) == {"direction": 1, "pos": 0x0102}


def test_parts_stand_where_nobody_says_behind_each_other() -> None:
    told = layout(length=9, report_id=7, header="AA BB", crc={"name": "CRC-16/ARC"}, terminator="0a")
    assert [(field.name, field.offset) for field in told.fields] == [("direction", 3), ("pos", 4)]
    assert told.crc is not None
    assert (told.crc.offset, told.crc.first, told.crc.end) == (6, 0, 6)
    assert told.encode({"direction": 1, "pos": 2})[:6] == bytes.fromhex("07 aa bb 01 02 00")
    with pytest.raises(ConfigError, match="field 'direction' at offset 2 overlaps the header"):
        layout(report_id=7, header="AA BB", fields=[DIRECTION | {"offset": 2}, {"name": "pos", "type": "u16"}])
    with pytest.raises(ConfigError, match="field 'direction' at offset 0 overlaps the report ID"):
        layout(report_id=7, fields=[DIRECTION | {"offset": 0}, {"name": "pos", "type": "u16"}])
    with pytest.raises(ConfigError, match="a field is there twice"):
        layout(fields=[DIRECTION, DIRECTION, {"name": "pos", "type": "u16"}])


@pytest.mark.parametrize(
    ("marks", "has"),
    [({}, False), ({"header": "7e"}, True), ({"terminator": "03"}, True), ({"crc": {"name": "CRC-16/ARC"}}, True),
     ({"report_id": 3}, False)],
)  # fmt: skip
def test_a_report_is_found_in_a_stream_by_one_mark_or_none(marks: dict[str, Any], has: bool) -> None:
    told = layout(**marks)
    assert told.has_marks is has
    report = told.encode({"direction": 1, "pos": 700})
    assert len(report) == told.length
    assert told.decode(report) == {"direction": 1, "pos": 700}
    assert told.decode(report)["pos"] == 700


def test_what_stands_in_the_place_of_the_fields_is_shown_of_any_bytes() -> None:
    told = layout(header="7e", fields=[DIRECTION, {"name": "pos", "type": "u16", "byte_order": "big"},
                                       {"name": "tick", "type": "u16", "scale": 0.5}])  # fmt: skip
    whole = bytes.fromhex("00 01 01 02 08 00")
    assert told.peek(whole) == {"direction": 1, "pos": 0x0102, "tick": 4.0}
    assert told.peek(whole[:5]) == {"direction": 1, "pos": 0x0102}
    assert told.peek(whole[:1]) == {}
    assert field_words(told, whole) == "direction 1  pos 258  tick 4"


def test_only_a_duty_in_whole_numbers_is_rounded() -> None:
    whole = Layout("w", 4, (Field("duty_pct", "u8", 0), Field("c3", "u8", 1), Field("c4", "u8", 2)))
    assert whole.pack(33.5, 1, 0) == bytes([34, 1, 0, 0])
    tenths = Layout("t", 4, (Field("duty_pct", "u16", 0, "big", 0.1), Field("c3", "u8", 2), Field("c4", "u8", 3)))
    assert tenths.pack(33.34, 1, 0) == bytes([1, 77, 1, 0])
    scaled = Layout("f", 6, (Field("duty_pct", "f32", 0, "little", 0.01), Field("c3", "u8", 4), Field("c4", "u8", 5)))
    assert scaled.pack(33.3, 1, 0) == struct.pack("<fBB", 3330.0, 1, 0)
    mixed = Layout("m", 6, (Field("pos", "u16", 0, "big"), Field("direction", "u16", 2)))
    assert mixed.pack(0x0102, 0x0304) == bytes.fromhex("01 02 04 03 00 00")
    big = Layout("b", 6, (Field("pos", "u16", 1, "big"), Field("direction", "u16", 3, "big")))
    assert big.pack(0x0102, 0x0304) == bytes.fromhex("00 01 02 03 04 00")
    assert big.decode(big.pack(0x0102, 0x0304)) == {"pos": 0x0102, "direction": 0x0304}
    with pytest.raises(ReportError, match="do not fit"):
        mixed.encode({"pos": 1.5, "direction": 0})
    codec = Codec(scaled, Layout("p", 3, (Field("direction", "u8", 0), Field("pos", "u16", 1))), 720)
    drive = Command.drive(-33.3)
    assert codec.carried(drive).duty_pct == pytest.approx(-33.3, rel=1e-6)
    assert codec.carried(drive).duty_pct != drive.duty_pct


# ---- messages ------------------------------------------------------------------------------------------------------


def test_modes_have_their_numbers_and_names() -> None:
    assert MODE_NAMES == {1: "drive", 2: "brake", 0: "standby"}
    assert [c.mode_name for c in (Command.drive(1.0), BRAKE_COMMAND, STANDBY_COMMAND)] == ["drive", "brake", "standby"]
    assert (BRAKE_COMMAND.mode, STANDBY_COMMAND.mode, Command.drive(-1.0).mode) == (2, 0, 1)
    for duty_pct in (100.0, -100.0):
        assert Command.drive(duty_pct).duty_pct == duty_pct


def test_commands_are_numbered_from_nothing_on_and_the_numbers_wrap() -> None:
    link = Link(FRAMED)
    names = FRAMED.command_layout
    assert [names.decode(link.encode(BRAKE_COMMAND))["sequence"] for _ in range(3)] == [0, 1, 2]
    assert names.decode(FRAMED.encode(BRAKE_COMMAND))["sequence"] == 0
    assert FRAMED.command_numbers == 65536
    link._sent = 65534
    assert [names.decode(link.encode(BRAKE_COMMAND))["sequence"] for _ in range(2)] == [65535, 0]
    assert TargetProfile.load().codec.command_numbers == 1


def test_a_reading_has_the_numbers_that_its_layout_has() -> None:
    for more, wanted in (({}, (None, None)), ({"sequence": 9}, (9, None)), ({"tick": 8}, (None, 8.0))):
        fields = [DIRECTION, {"name": "pos", "type": "u16"}, *({"name": name, "type": "u8"} for name in more)]
        told = layout(fields=fields)
        codec = Codec(TargetProfile.load().codec.command_layout, told, 720)
        found = codec.decode(told.encode({"direction": 1, "pos": 719, **more}))
        assert (found, type(found)) == ((1, 719, *wanted), Telemetry)
    assert NUMBERED_TELEMETRY_FIELDS == ("direction", "pos", "sequence", "tick")


@pytest.mark.parametrize(
    ("field", "said"),
    [
        ({"name": "sequence", "type": "i8"}, "counts up and wraps"),
        ({"name": "tick", "type": "i32"}, "counts up and wraps"),
        ({"name": "tick", "type": "f32"}, "is a whole number"),
        ({"name": "sequence", "type": "u8", "scale": 2.0}, "has a scale; only duty_pct and tick may"),
    ],
)
def test_a_number_that_does_not_count_is_refused(field: dict[str, object], said: str) -> None:
    told = layout(fields=[DIRECTION, {"name": "pos", "type": "u16"}, field])
    with pytest.raises(ConfigError, match=said):
        Codec(TargetProfile.load().codec.command_layout, told, 720)
