"""The counts of a turn, told by a speed that a table has beside its counter."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fiohost.importing.convert import log_from_raw
from fiohost.importing.read import read_raw
from fiohost.importing.understand import Understanding, understand

TIME_S = 0.01 * np.arange(1200)
DUTY = 60.0 * np.sign(np.sin(2.0 * np.pi * 0.25 * TIME_S)) * (TIME_S > 0.5)
SPEED = np.zeros(1200)  # in rpm, a lag of 0.2 s behind the duty
for i in range(1199):
    SPEED[i + 1] = SPEED[i] + 0.05 * (3.0 * DUTY[i] - SPEED[i])
TURNS = np.cumsum(SPEED) * 0.01 / 60.0
FILTERED = np.zeros(1200)
for i in range(1199):
    FILTERED[i + 1] = FILTERED[i] + 0.2 * (SPEED[i + 1] - FILTERED[i])


def counts(per_turn: float) -> np.ndarray:
    return np.floor(per_turn * TURNS)


def seen(pos: np.ndarray) -> np.ndarray:
    """The speed in rpm that a sketch works out from the counter, with two decimals."""
    return np.diff(pos, prepend=0.0) * 100.0 * 60.0 / 2400.0


def read(path: Path, speed: Sequence[float], pos: np.ndarray, name: str = "rpm") -> Understanding:
    lines = [f"{t:.2f},{u:g},{n:.0f},{v:.2f}" for t, u, n, v in zip(TIME_S, DUTY, pos, speed, strict=True)]
    path.write_text("\n".join([f"t_s,duty_pct,enc_count,{name}", *lines]) + "\n")
    return understand(read_raw(path))


@pytest.mark.parametrize(
    ("per_turn", "name", "factor"), [(2400.0, "rpm", 1.0), (720.0, "speed [deg/s]", 6.0), (48.0, "w (rad/s)", 0.10472)]
)
def test_a_speed_beside_a_counter_says_the_counts_of_a_turn(
    tmp_path: Path, per_turn: float, name: str, factor: float
) -> None:
    found = read(tmp_path / "t.csv", factor * SPEED, counts(per_turn), name)
    assert found.certain.counts_per_rev == per_turn
    assert any("--counts-per-rev" in text for text in found.assumed)
    log = log_from_raw(found.table, found.certain)
    np.testing.assert_allclose(log.output, 360.0 * counts(per_turn) / per_turn, atol=1e-6)


def test_one_that_was_worked_out_from_the_counter_says_it_exactly(tmp_path: Path) -> None:
    pos = counts(2400.0)
    assert read(tmp_path / "t.csv", seen(pos), pos).certain.counts_per_rev == 2400.0


def test_one_behind_a_filter_says_it_nearly(tmp_path: Path) -> None:
    assert read(tmp_path / "t.csv", FILTERED, counts(2400.0)).certain.counts_per_rev == pytest.approx(2400.0, rel=5e-3)


def test_a_counter_that_begins_anew_is_followed_over_that(tmp_path: Path) -> None:
    found = read(tmp_path / "t.csv", SPEED, np.mod(counts(24_000.0) + 100.0, 65_536.0))
    assert (found.certain.counts_per_rev, found.certain.wrap) == (24_000.0, 65_536.0)


@pytest.mark.parametrize(
    ("name", "speed"),
    [
        ("ref_rpm", SPEED),  # where it should be
        ("rpm", np.abs(SPEED)),  # without its sign it does not add up to the counter
        ("rpm", np.roll(SPEED, 300)),  # of another time
        ("speed", SPEED),  # in no unit
        ("rpm", 0.001 * SPEED),  # less than two turns
    ],
)
def test_one_that_does_not_say_it_is_not_asked(tmp_path: Path, name: str, speed: np.ndarray) -> None:
    found = read(tmp_path / "t.csv", speed, counts(2400.0), name)
    assert found.table_map is None
    assert [one.option for one in found.unknown] == ["--counts-per-rev"]


def test_tables_of_a_bench_have_one_turn(tmp_path: Path) -> None:
    one = read(tmp_path / "a.csv", SPEED, counts(2400.0)).table
    other = read(tmp_path / "b.csv", np.zeros(1200), np.zeros(1200)).table  # a run that stood says nothing alone
    assert understand(other).table_map is None
    assert understand(other, others=[one]).certain.counts_per_rev == 2400.0
