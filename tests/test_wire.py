"""The wire: what a command and a reading look like as bytes, and what is never sent or believed."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiohost.errors import ConfigError, LimitError, ReportError
from fiohost.settings import Table
from fiohost.transport.profile import TargetProfile
from fiohost.wire.layout import Field, Layout
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

PROFILE = TargetProfile.load("hid-assumed")
CODEC = PROFILE.codec


@pytest.mark.parametrize(
    ("command", "first_bytes"),
    [
        (Command.drive(40), "00 00 20 42 01 00"),
        (Command.drive(-40), "00 00 20 42 00 01"),
        (Command.drive(0), "00 00 00 00 01 01"),
        (Command.drive(-0.0), "00 00 00 00 01 01"),
        (Command.drive(100), "00 00 c8 42 01 00"),
        (BRAKE_COMMAND, "00 00 00 00 01 01"),
        (STANDBY_COMMAND, "00 00 00 00 00 00"),
    ],
)
def test_a_command_is_64_bytes_with_the_magnitude_and_the_direction_bits(command: Command, first_bytes: str) -> None:
    report = CODEC.encode(command)
    assert report == bytes.fromhex(first_bytes) + bytes(58)


@given(st.floats(-100, 100))
def test_the_wire_never_carries_a_negative_duty_and_the_command_says_what_it_carries(duty_pct: float) -> None:
    command = Command.drive(duty_pct)
    magnitude, c3, c4 = struct.unpack_from("<fBB", CODEC.encode(command))
    assert magnitude == abs(command.duty_pct) >= 0.0
    assert (c3, c4) == ((1, 0) if command.duty_pct > 0 else (0, 1) if command.duty_pct < 0 else (1, 1))
    assert math.isclose(command.duty_pct, duty_pct, rel_tol=1e-7, abs_tol=1e-37)


@pytest.mark.parametrize("duty_pct", [math.nan, math.inf, -math.inf, 100.0001, -101, 1e300])
def test_a_duty_beyond_full_scale_or_nan_is_refused(duty_pct: float) -> None:
    with pytest.raises(LimitError, match="-100 to 100"):
        Command.drive(duty_pct)


def test_a_reading_is_direction_then_count() -> None:
    assert CODEC.decode(bytes.fromhex("01 cf 02") + bytes(61)) == (1, 719, None, None)


@pytest.mark.parametrize(
    ("report", "reason"),
    [
        (bytes.fromhex("00 d0 02") + bytes(61), "POS = 720, beyond the 720 counts"),
        (bytes.fromhex("02 00 00") + bytes(61), "direction = 2"),
        (bytes(63), "63 bytes arrived where 64"),
        (bytes(65), "65 bytes arrived where 64"),
        (b"", "0 bytes arrived"),
    ],
)
def test_a_reading_that_cannot_be_one_is_a_report_error(report: bytes, reason: str) -> None:
    with pytest.raises(ReportError, match=reason):
        CODEC.decode(report)


@given(st.binary(max_size=80))
def test_any_bytes_are_a_reading_within_the_turn_or_a_report_error(report: bytes) -> None:
    try:
        direction, pos = CODEC.decode(report)[:2]
    except ReportError:
        return
    assert direction in (0, 1)
    assert 0 <= pos < 720


def test_fields_may_stand_in_any_order_and_leave_gaps() -> None:
    layout = Layout("x", 10, (Field("pos", "u16", 6), Field("direction", "i8", 1)))
    assert layout.names == ("direction", "pos")
    assert layout.encode({"pos": 0x1234, "direction": -1}) == bytes.fromhex("00 ff 00 00 00 00 34 12 00 00")
    assert layout.decode(layout.encode({"pos": 5, "direction": 1})) == {"pos": 5, "direction": 1}
    with pytest.raises(ReportError, match="do not fit"):
        layout.encode({"pos": 70000, "direction": 0})
    with pytest.raises(ReportError, match="do not fit"):
        layout.encode({"pos": 7})


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"length": 2}, "ends at byte 3, beyond the 2"),
        ({"fields": [{"name": "pos", "type": "u16"}]}, "'direction' is missing"),
        ({"fields": [{"name": "pos", "type": "u16"}, {"name": "direction", "type": "u8", "offset": 1}]}, "overlaps"),
        ({"fields": [{"name": "pos", "type": "u15"}]}, "did you mean 'u16'"),
        ({"fields": [{"name": "positon", "type": "u16"}]}, "positon"),
        ({"fields": [{"name": "pos", "type": "u16", "ofset": 1}]}, "did you mean 'offset'"),
        ({"reportid": 1}, "unknown key 'reportid'; did you mean 'report_id'"),
        ({"length": 1e9}, "outside"),
        ({"fields": 3}, "not a list of tables"),
    ],
)
def test_a_layout_that_does_not_fit_is_refused_by_name(change: dict[str, object], reason: str) -> None:
    good = {
        "length": 64,
        "fields": [{"name": "direction", "type": "u8"}, {"name": "pos", "type": "u16"}],
    }
    Layout.from_table(Table(dict(good), "good"), ("direction", "pos"), ("direction", "pos"))
    with pytest.raises(ConfigError, match=reason):
        Layout.from_table(Table({**good, **change}, "bad"), ("direction", "pos"), ("direction", "pos"))


def test_a_profile_says_how_well_its_layout_is_known() -> None:
    assert (PROFILE.status, PROFILE.vendor_id, PROFILE.product_id) == ("assumed", 0x0483, 0x5750)


def test_a_profile_with_an_unknown_key_or_medium_is_refused(tmp_path: Path) -> None:
    text = (Path(__file__).parent.parent / "configs" / "targets" / "hid-assumed.toml").read_text()
    (tmp_path / "a.toml").write_text(text.replace('transport = "hid"', 'transport = "hidd"'))
    with pytest.raises(ConfigError, match="did you mean 'hid'"):
        TargetProfile.load(tmp_path / "a.toml")
    (tmp_path / "b.toml").write_text(text.replace("vendor_id", "vendorid"))
    with pytest.raises(ConfigError, match="did you mean 'vendor_id'"):
        TargetProfile.load(tmp_path / "b.toml")
