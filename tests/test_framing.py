"""Layouts with marks, CRC, sequence and tick; the stream parser; what a link counts; the board's own code."""

from __future__ import annotations

import importlib
import re
import struct
import tracemalloc
import zlib
from binascii import crc_hqx
from pathlib import Path

import pytest
from draws import drawn_seed
from hypothesis import given, settings
from hypothesis import strategies as st

from fiohost.errors import ConfigError, ReportError
from fiohost.settings import Table
from fiohost.transport.profile import TargetProfile
from fiohost.wire.crc import ALIASES, CATALOGUE, crc_function, find_crc
from fiohost.wire.layout import Layout
from fiohost.wire.link import MAX_GAP, Link
from fiohost.wire.messages import BRAKE_COMMAND, Codec, Command
from fiohost.wire.stream import PIECE, StreamParser
from firmware_model import Receiver, make_format
from firmware_model.report import compare_value

# the profile, and the name that the board's own code gives to its layout
SHIPPED = {
    "hid-assumed": "assumed",
    "serial-documented": "documented",
    "serial-framed": "framed",
    "hid-framed": "framed-hid",
}
NAMES = ("direction", "pos", "sequence", "tick")
BASE: dict[str, object] = {
    "length": 16,
    "fields": [{"name": "direction", "type": "u8"}, {"name": "pos", "type": "u16"}],
}


def layout(**change: object) -> Layout:
    return Layout.from_table(Table({**BASE, **change}, "layout"), NAMES, NAMES[:2])


def codec_of(name: str) -> Codec:
    return TargetProfile.load(name).codec


# ---- CRC -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*CATALOGUE, *ALIASES])
def test_a_crc_gives_its_published_check_value(name: str) -> None:
    crc = find_crc(name)
    assert crc_function(crc)(b"123456789") == crc.check


@given(st.binary(max_size=100))
def test_crcs_agree_with_those_of_the_standard_library(data: bytes) -> None:
    assert crc_function(find_crc("CRC-32/ISO-HDLC"))(data) == zlib.crc32(data)
    assert crc_function(find_crc("CRC-16/XMODEM"))(data) == crc_hqx(data, 0)
    assert crc_function(find_crc("CRC-16/CCITT-FALSE"))(data) == crc_hqx(data, 0xFFFF)


def test_an_unknown_crc_is_refused_with_the_nearest() -> None:
    with pytest.raises(ConfigError, match="did you mean 'CRC-16/CCITT-FALSE'"):
        layout(crc={"name": "CRC-16/CCITT-FALS"})


# ---- layouts -------------------------------------------------------------------------------------------------------


def test_marks_byte_orders_and_scales_stand_where_the_layout_says() -> None:
    told = layout(
        length=14,
        report_id=5,
        header="AA 55",
        terminator="0d0a",
        byte_order="big",
        fields=[
            {"name": "direction", "type": "u8"},
            {"name": "pos", "type": "u16"},
            {"name": "tick", "type": "u16", "byte_order": "little", "scale": 0.5},
        ],
        crc={"name": "CRC-16/KERMIT", "offset": 10, "first": 3, "end": 8, "byte_order": "little"},
    )
    report = told.encode({"direction": 1, "pos": 0x0102, "tick": 9})
    crc = crc_function(find_crc("CRC-16/KERMIT"))(report[3:8]).to_bytes(2, "little")
    assert report == bytes.fromhex("05 aa 55 01 01 02 12 00 00 00") + crc + b"\r\n"
    assert told.decode(report) == {"direction": 1, "pos": 0x0102, "tick": 9.0}


@pytest.mark.parametrize(
    ("at", "reason"), [(0, "report_id"), (1, "header"), (4, "crc"), (10, "crc"), (12, "terminator"), (None, "length")]
)
def test_a_damaged_report_is_refused_for_what_is_wrong(at: int | None, reason: str) -> None:
    told = layout(
        length=13, report_id=5, header="AA 55", terminator="03", crc={"name": "CRC-32", "offset": 8, "end": 6}
    )
    report = bytearray(told.encode({"direction": 0, "pos": 7}))
    if at is None:
        report.pop()
    else:
        report[at] ^= 0x10
    with pytest.raises(ReportError) as caught:
        told.decode(bytes(report))
    assert caught.value.reason == reason


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"headr": "7E"}, "did you mean 'header'"),
        ({"header": "7G"}, "not bytes in hex"),
        ({"header": "00" * 17}, "more than 16"),
        ({"terminator": "03" * 14}, "beyond the 2 of the report before its terminator"),
        ({"header": "7E", "fields": [{"name": "pos", "type": "u16", "offset": 0}, *[]]}, "'direction' is missing"),
        ({"report_id": 0}, "outside 1..255"),
        ({"byte_order": "bigg"}, "did you mean 'big'"),
        ({"crc": {"name": "CRC-16/ARC", "offset": 1}}, "overlaps"),
        ({"crc": {"name": "CRC-16/ARC", "offset": 15}}, "the CRC ends at byte 17"),
        ({"crc": {"name": "CRC-16/ARC", "end": 9}}, "without the CRC itself"),
        ({"crc": {"name": "CRC-16/ARC", "ofset": 9}}, "did you mean 'offset'"),
        ({"crc": 3}, "not a table"),
    ],
)
def test_parts_that_do_not_fit_are_refused_by_name(change: dict[str, object], reason: str) -> None:
    with pytest.raises(ConfigError, match=reason):
        layout(**change)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        ('header = "7E 7E"\nterminator = "03 03"', "", "a serial line needs a header"),
        ('"pos", type = "u16"', '"pos", type = "f32"', "beyond|'pos' is a whole number"),
        ('"pos", type = "u16"', '"pos", type = "u16", scale = 2', "only duty_pct and tick may"),
        ('"duty_pct", type = "f32"', '"duty_pct", type = "i8", scale = 0.5', "cannot carry a duty of 100"),
        ('duty_pct = 100.0 ', "duty_pc = 100.0 ", "did you mean 'duty_pct'"),
        ('duty_pct = 100.0 ', "slew_pct_per_s = 0.0 ", "outside 0.1"),
    ],
)  # fmt: skip
def test_a_profile_that_cannot_carry_the_messages_is_refused(old: str, new: str, reason: str) -> None:
    text = TargetProfile.load("serial-documented").text
    assert old in text
    with pytest.raises(ConfigError, match=reason):
        TargetProfile.parse(text.replace(old, new), "changed")


VALUES = st.one_of(
    st.sampled_from(["0", "-1", "1e300", "99999999999", "nan", '""', '"7E"', '"u32"', '"big"', "[]", "{}", "true"]),
    st.integers(0, 70).map(str),
)


@settings(max_examples=300)
@given(st.sampled_from(sorted(SHIPPED)), st.integers(0, 60), VALUES)
def test_a_profile_with_any_value_changed_is_sound_or_refused(name: str, which: int, value: str) -> None:
    text = TargetProfile.load(name).text
    places = [match.span(1) for match in re.finditer(r"\w+ = (\"[^\"]*\"|[\w.]+)", text)]
    begins, ends = places[which % len(places)]
    try:
        profile = TargetProfile.parse(text[:begins] + value + text[ends:], "changed")
    except ConfigError:
        return
    link = Link(profile.codec)
    assert len(link.encode(Command.drive(100.0))) == profile.codec.command_layout.length
    report = profile.codec.telemetry_layout.encode(dict.fromkeys(profile.codec.telemetry_layout.names, 0))
    assert link.receive(report) is not None


def test_a_hid_profile_numbers_all_reports_or_none() -> None:
    text = TargetProfile.load("hid-assumed").text.replace("[command] ", "[command]\nreport_id = 1 #")
    with pytest.raises(ConfigError, match="numbers all reports or none"):
        TargetProfile.parse(text.replace("offset = 5", "offset = 6").replace("offset = 4", "offset = 5").replace(
            "offset = 0 },\n    { name = \"c3", "offset = 1 },\n    { name = \"c3"), "one way")  # fmt: skip


def test_a_duty_in_whole_numbers_is_logged_as_the_board_reads_it() -> None:
    text = TargetProfile.load("serial-documented").text.replace(
        '"duty_pct", type = "f32"', '"duty_pct", type = "u16", scale = 0.1'
    )
    codec = TargetProfile.parse(text.replace("length = 10", "length = 8"), "tenths").codec
    assert codec.encode(Command.drive(-12.34)).hex(" ") == "7e 7e 7b 00 00 01 03 03"
    assert codec.carried(Command.drive(-12.34)).duty_pct == pytest.approx(-12.3)
    assert codec.carried(BRAKE_COMMAND) == BRAKE_COMMAND


# ---- both ends, each with code of its own --------------------------------------------------------------------------


@pytest.mark.parametrize(("profile", "board"), SHIPPED.items())
@settings(max_examples=60)
@given(st.floats(-100, 100), st.integers(0, 65535), st.integers(0, 1), st.integers(0, 719))
def test_host_and_board_understand_each_other(
    profile: str, board: str, duty_pct: float, number: int, direction: int, pos: int
) -> None:
    codec, form = codec_of(profile), make_format(board)
    command = Command.drive(duty_pct)
    heard = form.parse(codec.encode(command, number % codec.command_numbers))
    assert heard == (compare_value(abs(command.duty_pct)), command.c3, command.c4)
    for k in range(2):
        told = codec.decode(form.telemetry(direction, pos))
        assert told[:2] == (direction, pos)
        assert told[2:] == ((k, k) if "framed" in board else (None, None))


@pytest.mark.parametrize("board", ["framed", "framed-hid", "documented"])
def test_the_board_drops_a_damaged_command(board: str) -> None:
    profile = next(name for name, layout_name in SHIPPED.items() if layout_name == board)
    report, form = codec_of(profile).encode(Command.drive(40.0)), make_format(board)
    assert form.parse(report) is not None
    for at in range(12 if "framed" in board else 2):
        assert form.parse(report[:at] + bytes([report[at] ^ 1]) + report[at + 1 :]) is None
    assert form.parse(report[:-1]) is None


def test_the_boards_receiver_takes_one_packet_a_step_and_has_a_bounded_ring() -> None:
    codec, port = codec_of("serial-documented"), Receiver(make_format("documented"))
    packets = [codec.encode(Command.drive(duty)) for duty in (10.0, 20.0, 30.0)]
    port.feed(b"\x00\x55" + packets[0] + packets[1] + packets[2][:4])
    assert [port.take(), port.take(), port.take()] == [packets[0], packets[1], None]
    port.feed(packets[2][4:])
    assert port.take() == packets[2]
    port.feed(b"\x7e" + packets[0] + packets[1])  # a false start costs it a packet, as it costs the real one
    assert [port.take(), port.take()] == [packets[1], None]
    port.feed(bytes(100_000))
    assert port.take() is None
    port.feed(packets[0] * 100)
    assert sum(port.take() is not None for _ in range(100)) == 25


# ---- streams -------------------------------------------------------------------------------------------------------


def frames(profile: str, count: int) -> list[bytes]:
    form = make_format(SHIPPED[profile])
    return [form.telemetry(k % 2, 97 * k % 720) for k in range(count)]


SERIAL = pytest.mark.parametrize("profile", ["serial-documented", "serial-framed"])


@SERIAL
@settings(max_examples=150)
@given(data=st.data())
def test_after_any_garbage_at_most_one_good_report_is_lost(profile: str, data: st.DataObject) -> None:
    codec, sent = codec_of(profile), frames(profile, 6)
    header = codec.telemetry_layout.header
    piece = st.one_of(st.binary(max_size=30), st.sampled_from([header, header[:1], sent[0][:-1], sent[0][3:]]))
    garbage = b"".join(data.draw(st.lists(piece, max_size=6)))
    stream = garbage + b"".join(sent)
    cuts = sorted(data.draw(st.lists(st.integers(0, len(stream)), max_size=8)))
    parser = StreamParser(codec.telemetry_layout, codec.decode)
    got = [m for a, b in zip([0, *cuts], [*cuts, len(stream)], strict=True) for m in parser.feed(stream[a:b])]
    assert got[-5:] == [codec.decode(one) for one in sent[1:]]
    assert parser.garbage_bytes + parser.reports * codec.telemetry_layout.length == len(stream)


@SERIAL
def test_what_a_stream_loses_is_counted_and_nothing_is_held(profile: str) -> None:
    codec, sent = codec_of(profile), frames(profile, 50)
    length = codec.telemetry_layout.length
    parser = StreamParser(codec.telemetry_layout, codec.decode)
    damaged = sent[7][:-2] + bytes([sent[7][-2] ^ 0xFF]) + sent[7][-1:]
    found = parser.feed(b"".join([*sent[:7], damaged, *sent[8:]]))
    assert len(found) == parser.reports == 49
    assert parser.garbage_bytes == length
    assert parser.refused == {"crc" if profile == "serial-framed" else "terminator": 1}
    tracemalloc.start()
    try:
        for _ in range(4):
            parser.feed(codec.telemetry_layout.header * (PIECE // 4))
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert held < 20_000
    assert len(parser.held) < length


# ---- sequence and tick ---------------------------------------------------------------------------------------------


def numbered(*numbers: int) -> list[bytes]:
    codec = codec_of("serial-framed")
    values = ({"sequence": n % 65536, "tick": n, "direction": 0, "pos": n % 720} for n in numbers)
    return [codec.telemetry_layout.encode(value) for value in values]


def steps_of(link: Link, reports: list[bytes]) -> list[int | str]:
    """Steps of each report, or why it was refused."""
    found: list[int | str] = []
    for report in reports:
        try:
            link.receive(report)
            found.append(link.steps)
        except ReportError as exc:
            found.append(exc.reason)
    return found


def test_lost_repeated_and_late_reports_are_counted_by_their_numbers() -> None:
    link = Link(codec_of("serial-framed"))
    assert steps_of(link, numbered(10, 11, 14, 14, 12, 15)) == [1, 1, 3, "repeated", "late", 1]
    assert (link.counts.lost, link.counts.repeated, link.counts.late) == (2, 1, 1)
    assert link.counts.describe() == ["2 reports lost", "1 repeated", "1 late"]
    assert Link(codec_of("serial-framed")).receive(numbered(3)[0], 5) is not None


def test_half_a_report_is_waited_for_in_a_stream_alone() -> None:
    half = numbered(3)[0][:7]
    assert Link(codec_of("serial-framed"), stream=True).receive(half) is None
    with pytest.raises(ReportError):
        Link(codec_of("serial-framed")).receive(half)


def test_reports_left_out_by_the_transport_are_not_lost_ones() -> None:
    link = Link(codec_of("serial-framed"))
    first, second = numbered(1, 6)
    link.receive(first)
    link.receive(second, passed_over=3)
    assert (link.counts.lost, link.steps) == (1, 5)


def test_numbers_wrap_and_a_board_that_starts_anew_is_believed_at_its_second_report() -> None:
    link = Link(codec_of("serial-framed"))
    assert steps_of(link, numbered(65534, 65535, 65536, 65537)) == [1, 1, 1, 1]
    link = Link(codec_of("serial-framed"))
    assert steps_of(link, numbered(5000, 5001, 0, 1, 2)) == [1, 1, "late", 1, 1]
    assert (link.counts.restarts, link.counts.late, link.counts.lost) == (1, 0, 0)
    link.begin()
    assert steps_of(link, numbered(90000)) == [1]
    assert link.counts.lost == 0


def test_a_stream_gives_the_newest_reading_and_all_steps_up_to_it() -> None:
    link = Link(codec_of("serial-framed"), stream=True)
    assert link.receive(numbered(1)[0][:5]) is None
    reading = link.receive(numbered(1)[0][5:] + b"".join(numbered(2, 4, 5)))
    assert reading is not None
    assert (reading.tick, link.passed_over, link.steps, link.counts.lost) == (5, 3, 5, 1)
    with pytest.raises(ReportError, match="CRC"):
        link.receive(numbered(6)[0][:-1] + b"\x00" + bytes(20))
    assert link.counts.refused["crc"] == 1
    assert link.counts.garbage_bytes > 0


@given(st.lists(st.integers(0, 2**32 - 1), max_size=30), st.booleans())
def test_any_numbers_give_steps_within_reason(numbers: list[int], stream: bool) -> None:
    link = Link(codec_of("serial-framed"), stream=stream)
    for steps in steps_of(link, numbered(*numbers)):
        assert isinstance(steps, str) or 1 <= steps <= MAX_GAP * MAX_GAP


def test_each_command_has_its_number() -> None:
    link = Link(codec_of("serial-framed"))
    sent = [link.encode(BRAKE_COMMAND) for _ in range(3)]
    assert [struct.unpack_from("<H", report, 2)[0] for report in sent] == [0, 1, 2]
    link._sent = 65535
    assert struct.unpack_from("<H", link.encode(BRAKE_COMMAND), 2)[0] == 0


# ---- mutated reports -----------------------------------------------------------------------------------------------


def test_mutated_reports_raise_typed_errors_only_and_memory_does_not_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    """A few of the million that ``benchmarks/fuzz.py`` tries before a release."""
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / "benchmarks")
    fuzz = importlib.import_module("fuzz")
    seen, grown = fuzz.fuzz(3000, seed=drawn_seed())
    assert grown < fuzz.MOST_GROWTH_BYTES
    assert seen["accepted"] > 500
    assert min(seen[f"refused: {reason}"] for reason in ("crc", "header", "length", "terminator", "values")) > 0
