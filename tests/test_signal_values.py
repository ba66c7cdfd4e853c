"""What each kind of signal says at each time, which numbers a file may give it, and how signals make an experiment."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from test_exact_bounds import beyond

from fiohost.bench.experiment import Experiment
from fiohost.bench.profile import BenchProfile
from fiohost.bench.program import ClosedLoop, Hold, OpenLoop
from fiohost.bench.signals import (
    KINDS,
    Constant,
    Multisine,
    Pulses,
    Ramp,
    RandomSteps,
    Signal,
    Sine,
    Square,
    Staircase,
    Steps,
    _read,
    read_signal,
)
from fiohost.bench.statistics import TickStatistics
from fiohost.bench.unwrap import ambiguous_steps
from fiohost.control.settings import ControlSettings
from fiohost.errors import ConfigError, LimitError
from fiohost.settings import Table
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

QUARTERS = np.arange(8) * 0.25


@pytest.mark.parametrize(
    ("signal", "values"),
    [
        (Constant(duration_s=2.0, level=7.0), [7.0] * 8),
        (Steps(duration_s=2.0, times_s=(0.5, 1.25), levels=(3.0, -4.0)), [0, 0, 3, 3, 3, -4, -4, -4]),
        (Steps(duration_s=2.0, times_s=(0.0,), levels=(3.0,)), [3] * 8),
        (Staircase(duration_s=2.0, levels=(1.0, 2.0, 3.0), step_s=0.5), [1, 1, 2, 2, 3, 3, 1, 1]),
        (Square(duration_s=2.0, low=-1.0, high=5.0, period_s=1.0), [-1, -1, 5, 5, -1, -1, 5, 5]),
        (Square(duration_s=2.0, low=-1.0, high=5.0, period_s=1.0, start="high"), [5, 5, -1, -1, 5, 5, -1, -1]),
        (Sine(duration_s=2.0, amplitude=4.0, mean=1.0, period_s=1.0), [1, 5, 1, -3, 1, 5, 1, -3]),
        (Sine(duration_s=2.0, amplitude=4.0, period_s=2.0), 4.0 * np.sin(np.pi * QUARTERS)),
        (Ramp(duration_s=1.0, begin=2.0, end=6.0), [2, 3, 4, 5, 6, 6, 6, 6]),
        (Ramp(duration_s=2.0, begin=-4.0, end=4.0), [-4, -3, -2, -1, 0, 1, 2, 3]),
        (Pulses(duration_s=2.0, levels=(8.0, 9.0), on_s=0.5, off_s=0.25), [8, 8, 0, 9, 9, 0, 8, 8]),
    ],
)
def test_a_signal_at_each_quarter_of_a_second(signal: Signal, values: Any) -> None:
    np.testing.assert_allclose(signal.values(QUARTERS), values, atol=1e-12)
    assert signal.standby(QUARTERS).tolist() == [False] * 8


def test_pulses_may_run_down_in_standby() -> None:
    pulses = Pulses(duration_s=2.0, levels=(8.0,), on_s=0.5, off_s=0.25, rest="standby")
    assert pulses.standby(QUARTERS).tolist() == [False, False, True] * 2 + [False, False]


def test_a_time_at_an_edge_belongs_to_what_begins() -> None:
    """Also where it is a little before it by rounding."""
    for signal in (
        Steps(duration_s=1.0, times_s=(0.3,), levels=(1.0,)),
        Staircase(duration_s=1.0, levels=(0.0, 1.0), step_s=0.3),
        Square(duration_s=1.0, low=0.0, high=1.0, period_s=0.6),
        Pulses(duration_s=1.0, levels=(0.0, 1.0), on_s=0.2, off_s=0.1),
        Pulses(duration_s=1.0, levels=(-1.0,), on_s=0.3, off_s=0.7, rest="standby"),
    ):
        at = np.array([0.3 - 1e-6, 0.3 - 1e-12, 0.3, 0.3 + 1e-6])
        wanted = [0.0, 1.0, 1.0, 1.0] if signal.standby(at).sum() == 0 else [-1.0, 0.0, 0.0, 0.0]
        assert signal.values(at).tolist() == wanted, signal


def test_random_steps_are_those_of_their_seed() -> None:
    signal = RandomSteps(duration_s=3.0, low=-10.0, high=30.0, hold_min_s=0.25, hold_max_s=0.5, seed=11)
    rng = np.random.default_rng(11)
    ends = np.cumsum(rng.uniform(0.25, 0.5, 14))
    levels = rng.uniform(-10.0, 30.0, 14)
    times = np.arange(0.0, 3.0, 0.005)
    wanted = [levels[int(np.sum(ends <= t))] for t in times]
    np.testing.assert_array_equal(signal.values(times), wanted)
    assert RandomSteps(duration_s=0.1, low=1.0, high=2.0, hold_min_s=1.0, hold_max_s=1.0, seed=1).values(times).size
    edge = signal.values(ends[:5] - 1e-12)  # a rounding before it belongs to what begins
    np.testing.assert_array_equal(edge, levels[1:6])
    late = signal.values(np.array([100.0]))  # behind all that was drawn the last level stays
    assert late[0] == levels[-1]


def test_a_multisine_has_its_lines_its_mean_and_no_more_than_its_peak() -> None:
    signal = Multisine(duration_s=4.0, amplitude=5.0, period_s=2.0, low_hz=0.5, high_hz=20.0, count=9)
    assert signal.mean == 0.0
    assert signal.seed == 0
    lines = signal.frequencies_hz()
    np.testing.assert_allclose(lines * 2.0, np.rint(lines * 2.0))
    assert lines.tolist() == [0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 8.0, 12.5, 20.0]
    values = signal.values(np.linspace(0.0, 2.0, 20_001))
    assert 4.9 < np.abs(values).max() <= 5.0
    assert abs(values[:-1].mean()) < 0.01
    drawn = replace(signal, seed=5, mean=-2.0)
    phases = np.random.default_rng(5).uniform(0.0, 2.0 * math.pi, lines.size)
    fine = np.arange(1280) / 640.0  # 32 times the highest line over a period
    total, times = (sum(np.sin(2.0 * math.pi * f * t + p) for f, p in zip(lines, phases, strict=True))
                    for t in (fine, np.linspace(0.0, 4.0, 777)))  # fmt: skip
    wanted = -2.0 + 5.0 * np.clip(times / np.abs(total).max(), -1.0, 1.0)
    np.testing.assert_allclose(drawn.values(np.linspace(0.0, 4.0, 777)), wanted, atol=1e-9)
    slow = Multisine(duration_s=4.0, amplitude=1.0, period_s=1.0, low_hz=1.0, high_hz=1.0, count=1, seed=3)
    phase = float(np.random.default_rng(3).uniform(0.0, 2.0 * math.pi, 1)[0])
    peak = np.abs(np.sin(2.0 * math.pi * np.arange(64) / 64.0 + phase)).max()  # no fewer than 64 in a period
    assert slow.values(np.zeros(1))[0] == pytest.approx(math.sin(phase) / peak, rel=1e-12)
    narrow = Multisine(duration_s=4.0, amplitude=5.0, period_s=1.0, low_hz=1.0, high_hz=1.0, count=1)
    assert np.abs(narrow.values(np.linspace(0.0, 1.0, 1001))).max() == pytest.approx(5.0, rel=5e-3)
    told = narrow.values(np.linspace(0.0, 1.0, 1001))  # a peak between the times that were looked at is cut
    assert (told.max(), told.min()) == (5.0, -5.0)
    for low_hz, is_sound in ((0.999, True), (0.998, False)):
        asked = {"duration_s": 1.0, "amplitude": 1.0, "period_s": 1.0, "low_hz": low_hz, "high_hz": 2.0, "count": 2}
        if is_sound:
            Multisine(**asked)
        else:
            with pytest.raises(ConfigError, match="low_hz must be at least"):
                Multisine(**asked)
    with pytest.raises(ConfigError, match="at most high_hz"):
        Multisine(duration_s=1.0, amplitude=1.0, period_s=1.0, low_hz=3.0, high_hz=2.0, count=2)
    with pytest.raises(ConfigError, match="nor the high level below the low"):
        RandomSteps(duration_s=1.0, low=2.0, high=1.0, hold_min_s=0.1, hold_max_s=0.1, seed=1)


DAY_S = 86_400.0
NUMBERS: dict[str, tuple[float, float]] = {
    **dict.fromkeys(("duration_s", "step_s", "period_s", "hold_min_s", "hold_max_s", "on_s", "off_s"), (1e-3, DAY_S)),
    **dict.fromkeys(("low_hz", "high_hz"), (1e-4, 1e3)),
    "count": (1, 1000),
    "seed": (0, 2**63 - 1),
    "times_s": (-DAY_S, DAY_S),
}
CHOICES = ("start", "rest")


@pytest.mark.parametrize("kind", KINDS)
def test_numbers_of_a_signal_end_where_the_page_says(kind: str) -> None:
    for field in (field for field in fields(KINDS[kind]) if field.name not in CHOICES):
        for unit, most in (("pct", 100.0), ("deg", 1e6)):
            key = field.name if field.name in NUMBERS else f"{field.name}_{unit}"
            listed = str(field.type).startswith("tuple")

            def read(value: float) -> object:
                return _read(Table({key: [value] if listed else value}, "signal"), field, unit)  # noqa: B023

            bounds = NUMBERS.get(field.name, (-most, most))
            for value in bounds:
                assert read(value) == ((value,) if listed else value)
            for value in beyond(*bounds):
                with pytest.raises(ConfigError, match=key):
                    read(value)


def test_what_a_signals_file_may_leave_away() -> None:
    assert read_signal(Table({"kind": "sine", "duration_s": 1.0, "amplitude_deg": 2.0, "period_s": 1.0}, "s"), "deg") \
        == Sine(duration_s=1.0, amplitude=2.0, mean=0.0, period_s=1.0)  # fmt: skip
    with pytest.raises(ConfigError, match="unknown key 'perod_s'; known: begin_deg"):
        read_signal(Table({"kind": "ramp", "duration_s": 1.0, "begin_deg": 0.0, "end_deg": 1.0, "perod_s": 1.0}, "s"),
                    "deg")  # fmt: skip
    with pytest.raises(ConfigError, match="kind = 'sinus' is unknown; did you mean"):
        read_signal(Table({"kind": "sinus"}, "s"), "deg")
    with pytest.raises(ConfigError, match="period_s"):
        read_signal(Table({"kind": "sine", "duration_s": 1.0, "amplitude_deg": 2.0}, "s"), "deg")


# ---- experiments ---------------------------------------------------------------------------------------------------


def test_signals_stand_behind_each_other_and_the_last_fills_the_run() -> None:
    made = Experiment(
        "mine",
        command=(Constant(duration_s=0.5, level=1.0), Ramp(duration_s=1.0, begin=0.0, end=4.0)),
        sample_time_s=0.25,
    )
    values, standby = made.levels()
    assert (values.tolist(), standby.any(), made.ticks, made.duration_s) == ([1, 1, 0, 1, 2, 3], False, 6, 1.5)
    uneven = Experiment("mine", command=(Constant(duration_s=0.3, level=1.0),) * 3, sample_time_s=0.25)
    assert uneven.levels()[0].tolist() == [1.0] * 4
    short = Experiment("mine", command=(Constant(duration_s=0.01, level=1.0),), sample_time_s=0.25)
    assert (short.ticks, short.levels()[0].tolist()) == (1, [1.0])
    program = Experiment(
        "mine",
        command=(Pulses(duration_s=1.0, levels=(-5.0,), on_s=0.25, off_s=0.25, rest="standby"),
                 Constant(duration_s=0.25, level=0.0)),
        sample_time_s=0.25,
    ).program()  # fmt: skip
    drive = Command.drive(-5.0)
    asked = [program.step(k, 0.0) for k in range(6)]
    assert asked == [(drive, None), (STANDBY_COMMAND, None), (drive, None), (STANDBY_COMMAND, None),
                     (BRAKE_COMMAND, None), None]  # fmt: skip
    with pytest.raises(LimitError):
        Experiment("mine", command=(Constant(duration_s=1.0, level=101.0),)).program()


def test_an_experiment_is_a_command_or_a_reference_with_its_law() -> None:
    signal, control = Constant(duration_s=1.0, level=1.0), ControlSettings()
    for wrong, said in (
        ({}, "one of them"), ({"command": (signal,), "reference": (signal,), "control": control}, "one of them"),
        ({"reference": (signal,)}, "goes with"), ({"command": (signal,), "control": control}, "goes with"),
        ({"command": (Constant(duration_s=DAY_S, level=1.0), signal)}, "lasts longer than 86400 s"),
    ):  # fmt: skip
        with pytest.raises(ConfigError, match=said):
            Experiment("mine", **wrong)  # type: ignore[arg-type]
    closed = Experiment("mine", reference=(signal,), control=control, extra_metadata={"who": "me"})
    assert (closed.closed_loop, closed.describe()["loop"], closed.describe()["who"]) == (True, "closed", "me")
    day = Experiment("mine", command=(Constant(duration_s=DAY_S, level=1.0),))
    assert (day.closed_loop, day.describe()["loop"], day.sample_time_s) == (False, "open", 0.005)
    other = Experiment("mine", command=(Constant(duration_s=DAY_S, level=2.0),), title="what it is")
    assert other.describe()["experiment_sha256"] != day.describe()["experiment_sha256"]
    named = Experiment("mine", command=(Constant(duration_s=DAY_S, level=1.0),), title="what it is")
    assert named.describe() == day.describe()


@pytest.mark.parametrize(("sample_time_s", "is_read"), [(1e-4, True), (1.0, True), (9.9e-5, False), (1.01, False)])
def test_a_file_may_ask_for_ticks_of_a_tenth_of_a_millisecond_to_a_second(
    sample_time_s: float, is_read: bool, tmp_path: Path
) -> None:
    text = f'schema = "fiohost.experiment/1"\nsample_time_s = {sample_time_s}\n[[command]]\nkind = "constant"\n'
    (tmp_path / "e.toml").write_text(text + "duration_s = 2.0\nlevel_pct = 5.0\n")
    if is_read:
        assert Experiment.load(tmp_path / "e.toml").sample_time_s == sample_time_s
    else:
        with pytest.raises(ConfigError, match="sample_time_s"):
            Experiment.load(tmp_path / "e.toml")


# ---- programs, statistics, gaps ------------------------------------------------------------------------------------


def test_programs_end_at_their_tick() -> None:
    drive = Command.drive(3.0)
    assert [Hold(drive, 2).step(k, 0.0) for k in range(3)] == [(drive, None), (drive, None), None]
    assert Hold(drive).step(10**9, 0.0) == (drive, None)
    assert [OpenLoop([drive]).step(k, 0.0) for k in range(2)] == [(drive, None), None]
    law = ControlSettings().law(0.005)
    closed = ClosedLoop(law, [5.0])
    answer = closed.step(0, 5.0)
    assert answer is not None
    assert answer[1] == 5.0
    assert closed.step(1, 5.0) is None


def test_lateness_is_counted_from_half_a_tick_on() -> None:
    statistics = TickStatistics(0.25, real=True)
    assert (statistics.mean_s, statistics.worst_s) == (0.0, 0.0)
    for late_s in (-1.0, 0.0, 0.125, 0.25, 0.125):
        statistics.count(late_s)
    assert (statistics.ticks, statistics.late, statistics.worst_s, statistics.mean_s) == (5, 1, 0.25, 0.1)
    assert statistics.describe() == (
        "5 ticks; 1 late by more than half a tick; lateness mean 100.00 ms, worst 250.00 ms"
    )
    assert statistics.as_dict() == {
        "ticks": 5, "virtual_time": False, "late": 1, "without_telemetry": 0, "refused_reports": 0,
        "surplus_reports": 0, "host_late": 0, "slowed_commands": 0, "reports_lost": 0, "reports_repeated": 0,
        "reports_late": 0, "board_restarts": 0, "garbage_bytes": 0, "refused_by_reason": {},
        "mean_lateness_ms": 100.0, "worst_lateness_ms": 250.0,
    }  # fmt: skip
    virtual = TickStatistics(0.25, real=False)
    virtual.silent, virtual.refused, virtual.passed_over, virtual.host_late, virtual.slowed = 1, 2, 3, 4, 5
    assert virtual.describe() == (
        "0 ticks in virtual time; 1 without telemetry; 2 with a report that was refused; 3 surplus reports; "
        "4 missed or late because of this computer; 5 commands held back by the slew limit"
    )


def test_a_way_through_a_gap_is_uncertain_by_the_speed_on_either_side() -> None:
    """Of 100 counts a turn: 45 are as far as is certain."""

    def doubtful(pos: list[float], time_s: list[float]) -> list[int]:
        return ambiguous_steps(np.array(pos), np.array(time_s), 1.0, 100).tolist()

    even = [0.0, 1.0, 2.0, 3.0]
    assert doubtful([0, 45, 90, 35], even) == []
    assert doubtful([0, 46, 92, 38], even) == [0, 1, 2]
    assert doubtful([0, 54, 8, 62], even) == [0, 1, 2]
    assert doubtful([0, 10, 60], [0.0, 1.0, 6.0]) == [1]  # 10 a tick before it: 50 in five
    assert doubtful([0, 9, 54], [0.0, 1.0, 6.0]) == []
    assert doubtful([0, 50, 60], [0.0, 5.0, 6.0]) == [0]  # and after it
    assert doubtful([0, 5, 14], [0.0, 5.0, 6.0]) == []
    assert doubtful([0, 5, 45, 50], [0.0, 1.0, 6.0, 7.0]) == []
    assert doubtful([0, 1, 2, 32], [0.0, 1.0, 21.0, 22.0]) == [1]
    assert doubtful([0, 0, 0, 30, 30], [0.0, 1.0, 21.0, 41.0, 42.0]) == []  # no gap says how fast the next one is
    assert doubtful([0, 10], [0.0, 9.0]) == []


def test_what_nobody_said_of_a_bench_profile() -> None:
    plain = BenchProfile("sim", "ramp", 4.0, -3.0)
    assert (plain.u_plus_spread_pct, plain.u_minus_spread_pct, plain.share) == (0.0, 0.0, 0.8)
    assert plain.compensation_pct == pytest.approx((3.2, -2.4))
    assert math.isclose(BenchProfile("sim", "ramp", 4.0, -3.0, share=1.0).compensation_pct[1], -3.0)
