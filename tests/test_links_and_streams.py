"""Links, streams, dumps and a board's word of itself, to the last byte and number."""

from __future__ import annotations

import struct

import pytest
from test_framing import layout, numbered, steps_of

from fiohost.errors import ReportError
from fiohost.transport.profile import TargetProfile
from fiohost.wire.crc import crc_function, find_crc
from fiohost.wire.dump import MOST_BYTES, Dump, hex_rows
from fiohost.wire.identity import ANSWER_BYTES, QUERY, Identity, find_identity
from fiohost.wire.link import MAX_GAP, Link
from fiohost.wire.stream import PIECE, StreamParser

FRAMED = TargetProfile.load("serial-framed").codec
DIRECTION = {"name": "direction", "type": "u8"}

# ---- links ---------------------------------------------------------------------------------------------------------


def test_sixty_four_numbers_may_be_missing() -> None:
    assert MAX_GAP == 64
    link = Link(FRAMED)
    assert steps_of(link, numbered(100, 164)) == [1, 64]
    assert link.counts.lost == 63
    link = Link(FRAMED)
    assert steps_of(link, numbered(100, 165)) == [1, "late"]
    link = Link(FRAMED)
    link.receive(numbered(100)[0])
    link.receive(numbered(169)[0], passed_over=5)
    assert (link.steps, link.counts.lost) == (69, 63)


def test_numbers_begin_anew_where_two_of_them_are_in_order() -> None:
    for second, said in ((1064, 1), (1065, "late"), (1000, "late"), (999, "late")):
        link = Link(FRAMED)
        assert steps_of(link, numbered(10, 1000, second)) == [1, "late", said]
        assert link.counts.restarts == (said == 1)
        assert link.counts.late == (0 if said == 1 else 2)
    link = Link(FRAMED)
    assert steps_of(link, numbered(10, 1000, 11, 1001, 12)) == [1, "late", 1, "late", 1]  # two strays are no restart
    link.begin()
    assert steps_of(link, numbered(2000, 2001)) == [1, 1]


def with_tick(sequence: int, tick: int) -> bytes:
    return FRAMED.telemetry_layout.encode({"sequence": sequence, "tick": tick, "direction": 0, "pos": 0})


def test_steps_are_the_ticks_unless_those_are_far_off_the_numbers() -> None:
    for tick, steps in ((3, 3), (128, 128), (129, 2), (0, 1), (2**32 - 1, 2)):
        link = Link(FRAMED)
        link.receive(with_tick(5, 0))
        link.receive(with_tick(7, tick))
        assert link.steps == steps, tick
        assert link.counts.lost == 1


def test_a_line_of_whole_reports_counts_what_it_refuses_and_what_was_passed_over() -> None:
    plain = Link(TargetProfile.load().codec)
    good = bytes(64)
    plain.receive(good, passed_over=2)
    assert (plain.steps, plain.numbered) == (3, False)
    plain.receive(good)
    assert plain.steps == 1
    for _ in range(2):
        with pytest.raises(ReportError):
            plain.receive(bytes(63))
    assert plain.counts.refused == {"length": 2}
    assert plain.counts.describe() == ["refused: length 2"]
    assert Link(FRAMED).numbered


def test_what_a_stream_brought_is_counted_once() -> None:
    link = Link(FRAMED, stream=True)
    one, two, three, four = numbered(1, 2, 3, 4)
    damaged = two[:-1] + bytes([two[-1] ^ 1])
    assert link.receive(b"xyz" + one + damaged + three + four[:4]) is not None
    assert link.counts.garbage_bytes == 3 + len(two)
    assert link.counts.refused == {"crc": 1}
    assert (link.steps, link.passed_over, link.counts.lost) == (3, 1, 1)
    assert link.receive(four[4:]) is not None
    assert (link.steps, link.passed_over) == (1, 1)
    assert link.counts.garbage_bytes == 3 + len(two)
    with pytest.raises(ReportError, match="repeats"):
        link.receive(four)
    assert link.counts.as_dict() == {
        "reports_lost": 1, "reports_repeated": 1, "reports_late": 0, "board_restarts": 0,
        "garbage_bytes": 3 + len(two), "refused_by_reason": {"crc": 1},
    }  # fmt: skip
    assert link.counts.describe() == ["1 reports lost", "1 repeated", f"{3 + len(two)} bytes of garbage",
                                      "refused: crc 1"]  # fmt: skip


def test_a_report_within_a_damaged_piece_of_its_length_is_found() -> None:
    link = Link(FRAMED, stream=True)
    one, two = numbered(1, 2)
    length = len(one)
    assert link.receive(b"\0\0\0" + one[: length - 3]) is None  # as long as a report, and none
    assert link.receive(one[length - 3 :]) is not None
    assert link.receive(two) is not None
    plain = Link(TargetProfile.load("serial-documented").codec, stream=True)
    report = plain.codec.telemetry_layout.encode({"direction": 0, "pos": 5})
    assert plain.receive(report * 3) is not None
    assert (plain.steps, plain.passed_over) == (3, 2)


# ---- streams -------------------------------------------------------------------------------------------------------


def test_of_a_stream_no_more_is_held_than_may_begin_a_report() -> None:
    told = layout(length=8, header="7e 7f 80")
    parser = StreamParser(told, told.decode)
    report = told.encode({"direction": 1, "pos": 2})
    assert parser.feed(b"\0" * 20 + b"\x7e\x7f") == []
    assert (bytes(parser.held), parser.garbage_bytes) == (b"\x7e\x7f", 20)
    assert len(parser.feed(report[2:] + report)) == 2
    assert (parser.reports, parser.garbage_bytes, len(parser.held)) == (2, 20, 0)
    long = bytes(PIECE - 3) + report + bytes(PIECE)  # over the border of two pieces
    assert len(parser.feed(long)) == 1
    assert parser.garbage_bytes + len(parser.held) == 20 + 2 * PIECE - 3
    assert len(parser.held) < told.length


def test_a_stream_without_a_header_is_tried_at_each_byte() -> None:
    told = layout(length=5, terminator="0a 0d")
    parser = StreamParser(told, told.decode)
    report = told.encode({"direction": 0, "pos": 9})
    assert len(parser.feed(b"abc" + report + b"d" + report)) == 2
    assert (parser.garbage_bytes, parser.refused, parser.reports) == (4, {"terminator": 4}, 2)
    assert str(parser.problem).startswith("a report ends with")
    by_id = layout(length=5, report_id=9, terminator="0a", fields=[DIRECTION | {"offset": 1},
                                                                   {"name": "pos", "type": "u16"}])  # fmt: skip
    parser = StreamParser(by_id, by_id.decode)
    assert len(parser.feed(b"\0\0" + by_id.encode({"direction": 0, "pos": 9}))) == 1
    assert (parser.garbage_bytes, parser.refused) == (2, {})


# ---- dumps ---------------------------------------------------------------------------------------------------------


def test_what_each_byte_did_is_kept() -> None:
    dump = Dump()
    assert dump.changed(bytes([1, 5, 0])) == [False, False, False]
    assert dump.changed(bytes([1, 7, 1, 9])) == [False, True, True, True]  # it grew by a byte
    assert dump.changed(bytes([1, 6, 1, 9])) == [False, True, False, False]
    assert dump.reports == 3
    assert dump.summary() == [
        {"offset": 1, "changes": 2, "low": 5, "high": 7, "u16_low": 5, "u16_high": 0x0107},
        {"offset": 2, "changes": 1, "low": 0, "high": 1, "u16_low": 0x0901, "u16_high": 0x0901},
    ]
    dump.changed(bytes([1, 6, 1, 8]))
    assert dump.summary()[-1] == {"offset": 3, "changes": 1, "low": 8, "high": 9}  # no byte behind it
    assert len(Dump().changed(bytes(MOST_BYTES + 5))) == MOST_BYTES == 4096


def test_rows_of_hex_leave_zeros_out_at_the_end_that_did_not_change() -> None:
    assert hex_rows(bytes([1, 0, 0, 0]), [False, True, False, False]) == [
        [(" 01", False), (">00", True), (" ..+2", False)]
    ]
    assert hex_rows(bytes(3), [False] * 3) == [[(" 00", False), (" ..+2", False)]]
    assert hex_rows(b"", []) == [[]]
    full = hex_rows(bytes([255]) * 33, [False] * 33)
    assert [len(row) for row in full] == [16, 16, 1]
    beyond_all = hex_rows(bytes([255]) * 5000, [False] * 5000)
    assert sum(len(row) for row in beyond_all) == 4097
    assert beyond_all[-1][-1] == (" ..+904", False)


# ---- who a board is ------------------------------------------------------------------------------------------------

NUMBERS = (1, 2, 3, 3600, 250, 720, 5000, 7, 9)  # version, duty steps, watchdog (ms), counts, step (us), two counts


def answer(form: int = 1, damage: int = 0) -> bytes:
    body = struct.pack("<2sB12s8sBBBHHHHHH", b"\xa5!", form, b"uno", b"l298n", *NUMBERS)
    crc = crc_function(find_crc("CRC-16/CCITT-FALSE"))(body) ^ damage
    return body + struct.pack("<H", crc)


def test_a_boards_word_of_itself_is_found_in_a_stream_and_read_in_its_units() -> None:
    wanted = Identity("uno", "l298n", "1.2.3", 3600, 0.25, 720, 0.005, 7, 9)
    assert (ANSWER_BYTES, len(answer()), len(QUERY)) == (40, 40, 4)
    for before in (b"", b"\0" * 5, b"\xa5", b"\xa5!", answer(form=2), answer(damage=1), b"\xa5!" * 30):
        found = find_identity(before + answer() + b"more")
        assert found is not None, before
        assert (found.name, found.bridge, found.version) == ("uno", "l298n", "1.2.3")
        assert found.watchdog_s == pytest.approx(wanted.watchdog_s)
        assert found.sample_time_s == pytest.approx(wanted.sample_time_s)
        assert (found.duty_steps, found.counts_per_rev, found.refused_frames, found.bad_edges) == (3600, 720, 7, 9)
    for none in (b"", answer()[:-1], answer(form=2), answer(damage=1), answer()[1:]):
        assert find_identity(none) is None
    assert wanted.describe().endswith(
        "3600 duty steps, 720 counts a turn, a step every 5 ms; it brakes 250 ms after the last command"
    )
