"""What a target's profile may leave away, and what is asked for everything that is connected."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fiohost.bench.connect import asking, connect
from fiohost.errors import ConfigError
from fiohost.transport.profile import Limits, TargetProfile
from fiohost.transport.traced import TracedTransport

# ---- what a target may leave away ----------------------------------------------------------------------------------


def profile(**changes: str | None) -> TargetProfile:
    """The plain one with keys changed, or left away."""
    lines = TargetProfile.load("serial-documented").text.splitlines()
    place = next(k for k, line in enumerate(lines) if line.startswith("["))
    kept = [line for line in lines[:place] if line.split("=")[0].strip() not in changes]
    more = [f"{name} = {value}" for name, value in changes.items() if value is not None]
    return TargetProfile.parse("\n".join([*kept, *more, *lines[place:]]), "mine")


def test_what_nobody_says_of_a_target() -> None:
    bare = profile(title=None, status=None, sample_time_s=None, counts_per_rev=None, duty_steps=None, baud=None,
                   watchdog_s=None)  # fmt: skip
    assert (bare.title, bare.status, bare.sample_time_s, bare.counts_per_rev) == ("mine", "assumed", 0.005, 720)
    assert (bare.duty_steps, bare.baud, bare.watchdog_s, bare.board, bare.board_layout) == (
        0,
        115_200,
        0.0,
        "",
        "assumed",
    )
    told = profile(sample_time_s="0.01", counts_per_rev="1000", duty_steps="7", baud="9600", watchdog_s="0.5")
    assert (told.sample_time_s, told.counts_per_rev, told.duty_steps, told.baud, told.watchdog_s) == (
        0.01, 1000, 7, 9600, 0.5,
    )  # fmt: skip
    assert told.codec.counts_per_rev == 1000
    other = told.with_counts(360)
    assert (other.counts_per_rev, other.codec.counts_per_rev, other.duty_steps) == (360, 360, 7)
    assert told.with_counts(1000) is told
    assert told.with_counts(None) is told
    assert told.limit_duty_pct == told.limits.duty_pct
    with pytest.raises(ConfigError, match="transport"):
        profile(transport='"usb"')
    layout = profile(transport='"sim"', board_layout='"documented"')
    assert layout.board_layout == "documented"
    with pytest.raises(ConfigError, match="board_layout"):
        profile(board_layout='"documented"')


def identified(text: str) -> TargetProfile:
    base = TargetProfile.load("hid-assumed").text
    begin = base.index("[identity]")
    end = base.index("[", begin + 1)
    return TargetProfile.parse(base[:begin] + f"[identity]\n{text}\n" + base[end:], "mine")


def test_an_identity_is_two_numbers_of_sixteen_bits_each_of_which_may_be_missing() -> None:
    assert (identified("").vendor_id, identified("").product_id) == (None, None)
    both = identified("vendor_id = 0\nproduct_id = 65535\nboard = 'x'")
    assert (both.vendor_id, both.product_id, both.board) == (0, 65535, "x")
    assert (identified("vendor_id = 65535").vendor_id, identified("product_id = 0").product_id) == (65535, 0)
    for text in ("vendor_id = -1", "vendor_id = 65536", "product_id = -1", "product_id = 65536", "vendr_id = 1"):
        with pytest.raises(ConfigError):
            identified(text)


def test_limits_are_the_stricter_of_two_and_told_in_words() -> None:
    plain = Limits()
    assert plain.describe() == ""
    mine = plain.within({"duty_pct": 60.0, "travel_deg": 90.0})
    assert mine.describe() == "duty 60 %, travel 90 deg"
    both = mine.within({"duty_pct": 80.0, "travel_deg": 45.0, "slew_pct_per_s": 200.0, "run_time_s": 9.0})
    assert both == Limits(60.0, 200.0, 45.0, 9.0)
    assert both.describe() == "duty 60 %, slew 200 %/s, travel 45 deg, run 9 s"
    with pytest.raises(ConfigError, match="duty_pc"):
        plain.within({"duty_pc": 1.0})
    guards = TargetProfile.load().guards
    assert guards.changed({"stall_s": 1.0}) == replace(guards, stall_s=1.0)
    with pytest.raises(ConfigError, match="stal_s"):
        guards.changed({"stal_s": 1.0})


# ---- what is asked for everything that is connected ----------------------------------------------------------------


def test_what_is_asked_holds_within_and_the_stricter_of_the_limits(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(limits={"duty_pct": 50.0}, guards={"stall_s": 9.0}), asking(trace=path, guards={"late_pct": 5.0}):
        with connect("sim", limits={"duty_pct": 80.0}, guards={"stall_s": 7.0}, reconnect_s=2.0) as bench:
            assert isinstance(bench.transport, TracedTransport)
            assert bench.profile.limits.duty_pct == 50.0
            assert (bench.profile.guards.stall_s, bench.profile.guards.late_pct) == (7.0, 5.0)
            assert bench.reconnect_s == 2.0
        with asking(limits={"duty_pct": 60.0}), connect("sim") as bench:
            assert bench.profile.limits.duty_pct == 50.0
        with asking(limits={"duty_pct": 40.0, "travel_deg": 90.0}), connect("sim") as bench:
            assert isinstance(bench.transport, TracedTransport)
            assert bench.profile.limits.travel_deg == 90.0
            assert (bench.profile.limits.duty_pct, bench.profile.guards.stall_s) == (40.0, 9.0)
            assert bench.profile.guards.late_pct == 5.0
    assert [json.loads(line)["schema"] for line in path.read_text().splitlines() if "schema" in line] == [
        "fiohost.trace/1"
    ] * 3
    with connect("sim") as bench:
        assert not isinstance(bench.transport, TracedTransport)
        assert bench.profile.guards.stall_s == 3.0
    head = json.loads(path.read_text().splitlines()[0])
    assert (head["profile"], head["sample_time_s"], head["target"], head["lock_step"]) == (
        "hid-assumed", 0.005, "sim", True,
    )  # fmt: skip
    assert head["profile_toml"] == TargetProfile.load().text
