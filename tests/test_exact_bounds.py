"""Where a bound is, to the last number: what is just within is taken, what is just beyond is refused."""

from __future__ import annotations

import math
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fiohost.bench.deadband import Deadband, Onset
from fiohost.bench.experiment import Experiment
from fiohost.bench.limits import Limiter
from fiohost.bench.log import Log
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import Multisine, Pulses, RandomSteps, Steps
from fiohost.bench.table import MAX_LINE, read_cells
from fiohost.bench.unwrap import ambiguous_steps
from fiohost.errors import ConfigError, LimitError, LogError
from fiohost.transport.profile import Guards, Limits, TargetProfile
from fiohost.wire.crc import CATALOGUE, crc_function
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

LIMITS = {"duty_pct": (0.0, 100.0), "slew_pct_per_s": (0.1, 1e6), "travel_deg": (1.0, 1e9), "run_time_s": (0.05, 1e7)}
GUARDS = {
    "braked_deg_s": (0.0, 1e6), "gap_s": (0.02, 60.0), "late_pct": (0.0, 100.0), "stall_s": (0.05, 1e9),
    "silence_s": (0.01, 60.0), "wrong_way_deg": (5.0, 1e9), "speed_deg_s": (1.0, 1e9),
}  # fmt: skip
TARGET = {"sample_time_s": (1e-4, 1.0), "counts_per_rev": (4, 1 << 24), "duty_steps": (0, 1 << 32),
          "baud": (50, 50_000_000), "watchdog_s": (0.0, 60.0)}  # fmt: skip


def beyond(low: float, high: float) -> tuple[float, float]:
    """The next numbers below and above; whole ones where the bounds are whole."""
    if isinstance(low, int):
        return low - 1, high + 1
    return math.nextafter(low, -math.inf), math.nextafter(high, math.inf)


def target(**values: float) -> TargetProfile:
    text = TargetProfile.load("serial-documented").text
    lines = [line for line in text.splitlines() if line.split("=")[0].strip() not in values]
    place = next(k for k, line in enumerate(lines) if line.startswith("["))
    lines[place:place] = [f"{name} = {value!r}" for name, value in values.items()]
    return TargetProfile.parse("\n".join(lines), "mine")


@pytest.mark.parametrize(("name", "bounds"), [*LIMITS.items(), *GUARDS.items(), *TARGET.items()])
def test_numbers_of_a_target(name: str, bounds: tuple[float, float]) -> None:
    def read(value: float) -> float:
        if name in LIMITS:
            return getattr(Limits().within({name: value}), name)
        if name in GUARDS:
            return getattr(Guards().changed({name: value}), name)
        return getattr(target(**{name: value}), name)

    assert [read(value) for value in bounds] == list(bounds)
    for value in beyond(*bounds):
        with pytest.raises(ConfigError, match=name):
            read(value)


def log(**metadata: Any) -> Log:
    columns = {"time_s": [0.0, 0.005, 0.01], "duty_pct": [0.0, 1.0, 2.0], "pos": [0, 0, 1]}
    return Log.from_columns(columns, {"sample_time_s": "0.005", **{k: str(v) for k, v in metadata.items()}})


@pytest.mark.parametrize(
    ("name", "within", "outside"),
    [
        ("counts_per_rev", [2, 10**9], [1.5, 720.5, 10**9 + 1]),
        ("command_delay_ticks", [0, 10_000], [-1, 0.5, 10_001]),
        ("pwm_hz", [0.0, 1e9], [-1e-300, 1e9 + 1]),
    ],
)
def test_numbers_in_a_logs_head(name: str, within: list[float], outside: list[float]) -> None:
    for value in within:
        made = log(**{name: value})
        assert getattr(made, name) == value
    for value in outside:
        with pytest.raises(LogError, match=name):
            log(**{name: value})


def test_an_encoder_may_have_one_count() -> None:
    columns = {"time_s": [0.0, 0.005], "duty_pct": [0.0, 0.0], "pos": [0, 0]}
    assert Log.from_columns(columns, {"counts_per_rev": "1"}).counts_per_rev == 1
    with pytest.raises(LogError, match="counts_per_rev"):
        Log.from_columns(columns, {"counts_per_rev": "0"})


def test_a_logs_duty_may_be_beyond_full_scale_by_its_rounding_only() -> None:
    for duty in (100.01, -100.01):
        assert len(Log.from_columns({"time_s": [0.0, 0.01], "duty_pct": [0.0, duty], "pos": [0, 1]})) == 2
    for duty in (100.02, -100.02):
        with pytest.raises(LogError, match="duty_pct"):
            Log.from_columns({"time_s": [0.0, 0.01], "duty_pct": [0.0, duty], "pos": [0, 1]})


def test_of_broken_lines_the_first_is_named() -> None:
    rows = [f"{0.005 * k:.3f},10,{k % 720}" for k in range(60)]
    rows[7], rows[9] = "broken", "broken,too"
    made = Log.parse("time_s,duty_pct,pos\n" + "\n".join(rows) + "\n")
    assert made.dropped[0] == "2 lines that do not fit the columns (the first is line 9)"
    assert len(made) == 58
    rows[0] = "broken"
    made = Log.parse("time_s,duty_pct,pos\n" + "\n".join(rows) + "\n")
    assert made.dropped[0] == "3 lines that do not fit the columns (the first is line 2)"


def test_a_benchs_own_profile(tmp_path: Path) -> None:
    path = tmp_path / "bench.toml"

    def made(**values: float) -> BenchProfile:
        path.unlink(missing_ok=True)
        kept: dict[str, Any] = {"u_plus_pct": 5.0, "u_minus_pct": -5.0, **values}
        BenchProfile(target="sim", method="ramp", **kept).save(path)
        return BenchProfile.load(path)

    bounds = {"u_plus_pct": (0.0, 99.0), "u_minus_pct": (-99.0, 0.0), "u_plus_spread_pct": (0.0, 100.0),
              "u_minus_spread_pct": (0.0, 100.0), "share": (0.0, 1.5)}  # fmt: skip
    for name, ends in bounds.items():
        for value in ends:
            assert getattr(made(**{name: value}), name) == value
        for value in beyond(*ends):
            with pytest.raises(ConfigError, match=name):
                made(**{name: value})


def test_signals_that_make_no_sense_and_those_that_just_do() -> None:
    assert Steps(duration_s=1.0, times_s=(0.1, 0.2), levels=(1.0, 2.0)).times_s[1] == 0.2
    for times in ((0.1, 0.1), (0.2, 0.1), (0.1,)):
        with pytest.raises(ConfigError, match="times_s must increase"):
            Steps(duration_s=1.0, times_s=times, levels=(1.0, 2.0))
    with pytest.raises(ConfigError, match="hold_max_s"):
        RandomSteps(duration_s=1.0, low=0.0, high=1.0, hold_min_s=0.2, hold_max_s=0.1, seed=1)
    same = RandomSteps(duration_s=1.0, low=2.0, high=2.0, hold_min_s=0.2, hold_max_s=0.2, seed=1)
    assert set(same.values(np.arange(5) * 0.2)) == {2.0}


def test_pulses_begin_and_end_with_their_tick() -> None:
    pulses = Pulses(duration_s=1.0, levels=(10.0, 20.0), on_s=0.1, off_s=0.05)
    told = pulses.values(np.arange(60) * 0.005)
    assert [int(np.sum(told == level)) for level in (10.0, 20.0, 0.0)] == [20, 20, 20]
    assert (told[0], told[19], told[20], told[29], told[30]) == (10.0, 10.0, 0.0, 0.0, 20.0)


def test_a_multisine_reaches_its_peak_and_is_the_sum_that_its_seed_draws() -> None:
    made = Multisine(duration_s=2.0, mean=1.0, amplitude=10.0, low_hz=1.0, high_hz=8.0, period_s=1.0, count=6, seed=3)
    time_s = np.arange(4000) * 0.0005
    told = made.values(time_s) - 1.0
    assert np.abs(told).max() == pytest.approx(10.0, rel=2e-3)
    lines = made.frequencies_hz()
    assert lines.min() >= 1.0
    assert lines.max() <= 8.0
    phases = np.random.default_rng(3).uniform(0.0, 2.0 * math.pi, lines.size)
    wanted = sum(np.sin(2.0 * math.pi * f * time_s + p) for f, p in zip(lines, phases, strict=True))
    inside = np.abs(told) < 9.9
    assert np.mean(inside) > 0.95  # nearly nothing is cut: the peak is that of the whole period
    np.testing.assert_allclose(told[inside] / wanted[inside], (told[0] / wanted[0]), rtol=1e-6)


def test_the_lines_of_a_multisine_are_multiples_of_one_over_its_period() -> None:
    made = Multisine(duration_s=4.0, amplitude=1.0, low_hz=0.5, high_hz=2.0, period_s=4.0, count=3)
    assert made.frequencies_hz().tolist() == [0.5, 1.0, 2.0]


def test_a_table_has_lines_as_long_as_is_said(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    for more, is_read in ((0, True), (1, False)):
        path.write_text("a,b\n" + "1," + "x" * (MAX_LINE - 3 + more) + "\n")
        if is_read:
            assert len(read_cells(path, 10)[0][0]["b"]) == 100_000 - 3
        else:
            with pytest.raises(LogError, match="line 2 is longer than 100000"):
                read_cells(path, 10)


def test_spreads_of_a_deadband_need_two() -> None:
    def onset(duty_pct: float, place_deg: float | None = None) -> Onset:
        none = np.zeros(0)
        return Onset(duty_pct > 0.0, duty_pct, 0.0, 0.0, none, none, none, place_deg)

    one = Deadband((onset(3.0, 0.0), onset(-4.0)))
    assert one.spread_pct(True) == 0.0
    assert one.spread_over_angle_pct(True) is one.spread_over_repeats_pct(True) is None
    two = Deadband((onset(3.0, 0.0), onset(5.0, 90.0), onset(-4.0)))
    assert two.spread_pct(True) == two.spread_over_angle_pct(True) == pytest.approx(math.sqrt(2.0))
    assert two.spread_over_repeats_pct(True) is None


def test_an_experiment_is_known_by_sixteen_digits_whatever_its_title() -> None:
    made = Experiment.load("staircase").describe()
    assert made["experiment_sha256"] == "".join(c for c in made["experiment_sha256"] if c in "0123456789abcdef")
    assert len(made["experiment_sha256"]) == 16


def test_a_logs_head_is_as_long_as_is_said() -> None:
    rows = "time_s,duty_pct,pos\n0,0,0\n0.005,0,1\n"
    assert len(Log.parse("# a: b\n" * 1000 + rows)) == 2
    with pytest.raises(LogError, match="1000 lines and no column names"):
        Log.parse("# a: b\n" * 1001 + rows)
    assert len(Log.parse("# a: " + "x" * 19_995 + "\n" + rows)) == 2
    with pytest.raises(LogError, match="line 1 is longer than 20000 characters"):
        Log.parse("# a: " + "x" * 19_996 + "\n" + rows)


def test_so_many_ticks_may_be_missing() -> None:
    """A million, and twenty a row beside."""
    for ticks, is_read in ((1_000_040, True), (1_000_042, False)):
        columns = {"time_s": [0.0, 0.005 * ticks], "duty_pct": [0.0, 0.0], "pos": [0, 1]}
        if is_read:
            assert len(Log.from_columns(columns, {"sample_time_s": "0.005"})) == 2
        else:
            with pytest.raises(LogError, match="nearly all ticks are missing"):
                Log.from_columns(columns, {"sample_time_s": "0.005"})


def test_limits_hold_at_their_number_and_not_before() -> None:
    limits = Limits().within({"duty_pct": 50.0, "travel_deg": 90.0, "run_time_s": 1.0})
    drive = Command.drive(50.0)
    limiter = Limiter(limits, 0.005)
    assert limiter.allow(drive, 10.0, 0.0) is drive
    assert limiter.allow(drive, 100.0, 0.995) is drive
    assert limiter.allow(drive, -80.0, 0.995) is drive
    for command, angle_deg, time_s, said in (
        (drive, 10.0, 1.0, "lasted"), (drive, 100.5, 0.5, "[+]90.5 deg"), (drive, -80.5, 0.5, "-90.5 deg"),
        (Command.drive(-50.01), 10.0, 0.5, "a duty of -50.01 %"),
    ):  # fmt: skip
        with pytest.raises(LimitError, match=said):
            limiter.allow(command, angle_deg, time_s)


def test_the_slew_limit_counts_time_and_what_it_held_back() -> None:
    limiter = Limiter(Limits().within({"slew_pct_per_s": 1000.0}), 0.005)

    def sent(command: Command, time_s: float) -> float:
        return limiter.allow(command, 0.0, time_s).duty_pct

    assert [sent(Command.drive(12.0), t) for t in (0.0, 0.005, 0.01, 0.015)] == pytest.approx([5.0, 10.0, 12.0, 12.0])
    assert limiter.slowed == 2
    assert sent(Command.drive(-100.0), 0.035) == pytest.approx(-8.0)  # three ticks were missing
    assert sent(BRAKE_COMMAND, 0.04) == 0.0
    assert sent(Command.drive(-100.0), 0.045) == pytest.approx(-5.0)
    assert limiter.slowed == 4


def test_a_duty_is_rounded_only_where_the_layout_rounds() -> None:
    exact = TargetProfile.load("serial-framed").codec
    drive = Command.drive(33.3)
    assert exact.carried(drive) is drive
    text = TargetProfile.load("serial-framed").text
    whole = TargetProfile.parse(text.replace('"duty_pct", type = "f32"', '"duty_pct", type = "u8"'), "whole").codec
    assert whole.carried(drive).duty_pct == 33.0
    assert whole.carried(Command.drive(-33.3)).duty_pct == -33.0
    for command in (BRAKE_COMMAND, STANDBY_COMMAND):
        assert whole.carried(command) is command


def test_a_target_that_says_nothing_has_the_guards_of_the_page() -> None:
    """As docs/protocol.md gives them: they are what a bench is watched by unless somebody changes them."""
    wanted = {"braked_deg_s": 60.0, "stall_s": 3.0, "wrong_way_deg": 180.0, "speed_deg_s": 10_000.0, "late_pct": 1.0}
    assert asdict(Guards()) == {**wanted, "gap_s": 0.1, "silence_s": 0.05}
    assert target().guards == Guards()


def test_a_target_needs_both_layouts() -> None:
    text = TargetProfile.load("serial-documented").text
    for name in ("command", "telemetry"):
        with pytest.raises(ConfigError, match=f"{name}.*(missing|needed|required|is not there)"):
            TargetProfile.parse(text.replace(f"[{name}]", f"[{name}_]"), "mine")


def test_an_experiments_ticks_and_length() -> None:
    signal = Steps(duration_s=1.0, times_s=(0.1,), levels=(1.0,))
    for sample_time_s in (1e-4, 1.0):
        assert Experiment("mine", command=(signal,), sample_time_s=sample_time_s).duration_s == 1.0
    for sample_time_s in beyond(1e-4, 1.0):
        with pytest.raises(ConfigError, match=r"outside 0\.0001\.\.1"):
            Experiment("mine", command=(signal,), sample_time_s=sample_time_s)


def test_a_crc_is_that_of_the_catalogue_by_table_and_by_pythons_own() -> None:
    for name, crc in CATALOGUE.items():
        assert crc_function(crc)(b"123456789") == crc.check, name
        assert crc_function(crc)(b"") == (crc.initial ^ crc.final_xor if crc.final_xor else crc.initial), name
    other = replace(CATALOGUE["CRC-16/XMODEM"], final_xor=0xFFFF)  # not one that Python has
    assert crc_function(other)(b"123456789") == 0x31C3 ^ 0xFFFF


def test_what_nobody_says_of_a_log_and_a_target() -> None:
    assert log(counts_per_rev=1440).output_quantum == 0.25
    silent = log()
    assert (silent.pwm_hz, silent.bench_time_s, silent.duty_steps, silent.command_delay_ticks) == (0.0, 0.0, 0, 0)
    assert target().watchdog_s == 0.0
    assert ambiguous_steps(np.zeros(1), np.zeros(1), 0.005, 720).size == 0
    assert ambiguous_steps(np.array([0.0, 350.0]), np.array([0.0, 0.005]), 0.005, 720).tolist() == [0]


def test_one_broken_line_of_few_is_left_out_and_two_are_too_many() -> None:
    rows = ["0,0,0", "0.005,0,1", "broken"]
    assert len(Log.parse("time_s,duty_pct,pos\n" + "\n".join(rows) + "\n")) == 2
    with pytest.raises(LogError, match="2 of 4 lines do not fit the 3 columns"):
        Log.parse("time_s,duty_pct,pos\n" + "\n".join([*rows, "broken"]) + "\n")
