"""Experiments and control: what a signal is at each tick, what files may say, what a control law answers."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.program import ClosedLoop
from fiohost.bench.signals import (
    KINDS,
    Constant,
    Multisine,
    Pulses,
    Ramp,
    RandomSteps,
    Sine,
    Square,
    Staircase,
    Steps,
)
from fiohost.control.controllers import PD, PI, P
from fiohost.control.deadband import DeadbandCompensator
from fiohost.control.law import ControlLaw
from fiohost.errors import ConfigError, LimitError
from fiohost.wire.messages import BRAKE, STANDBY

TICKS_S = np.arange(2000, dtype=np.float64) * 0.005


# ---- signals -------------------------------------------------------------------------------------------------------


def test_edges_fall_on_their_tick() -> None:
    square = Square(low=170.0, high=190.0, period_s=6.0, duration_s=10.0).values(TICKS_S)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(square)) + 1, [600, 1200, 1800])
    assert square[0] == 170.0
    stairs = Staircase(levels=(1.0, 2.0, 3.0), step_s=0.7, duration_s=10.0).values(TICKS_S)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(stairs)) + 1, 140 * np.arange(1, 15))
    steps = Steps(times_s=(0.1, 0.3), levels=(5.0, -5.0), duration_s=10.0).values(TICKS_S)
    assert [steps[19], steps[20], steps[59], steps[60]] == [0.0, 5.0, 5.0, -5.0]


def test_a_multisine_has_its_peak_its_lines_and_the_same_phases_each_time() -> None:
    lines = {"period_s": 10.0, "low_hz": 0.1, "high_hz": 8.0}
    signal = Multisine(amplitude=60.0, mean=5.0, count=12, seed=3, duration_s=10.0, **lines)
    values = signal.values(TICKS_S)
    assert 58.0 < np.abs(values - 5.0).max() <= 60.0
    np.testing.assert_array_equal(values, signal.values(TICKS_S))
    spectrum = np.abs(np.fft.rfft(values - 5.0)) / values.size
    loud = np.flatnonzero(spectrum > 0.2 * spectrum.max()) / 10.0
    np.testing.assert_allclose(loud, signal.frequencies_hz(), atol=1e-9)


def test_pulses_rest_in_brake_or_in_standby() -> None:
    for rest, mode in (("brake", BRAKE), ("standby", STANDBY)):
        plan = Experiment("p", [Pulses(levels=(50.0, -50.0), on_s=0.1, off_s=0.1, rest=rest, duration_s=0.4)])
        answers = [plan.program().step(k, 0.0) for k in range(80)]
        commands = [answer[0] for answer in answers if answer]
        assert [c.duty_pct for c in commands] == [50.0] * 20 + [0.0] * 20 + [-50.0] * 20 + [0.0] * 20
        assert {c.mode for c in commands[20:40]} == {mode}


def test_ramp_sine_and_random_steps_stay_within_their_levels() -> None:
    ramp = Ramp(begin=-10.0, end=30.0, duration_s=10.0).values(TICKS_S)
    assert (ramp[0], round(float(ramp[1000]), 9)) == (-10.0, 10.0)
    sine = Sine(amplitude=20.0, mean=5.0, period_s=4.0, duration_s=10.0).values(TICKS_S)
    assert (sine.max(), sine.min()) == pytest.approx((25.0, -15.0), abs=1e-3)
    random = RandomSteps(low=-40.0, high=80.0, hold_min_s=0.2, hold_max_s=0.5, seed=1, duration_s=10.0)
    values = random.values(TICKS_S)
    assert -40.0 <= values.min() < values.max() <= 80.0
    holds = np.diff(np.flatnonzero(np.diff(values)))
    assert 39 <= holds.min() <= holds.max() <= 101
    np.testing.assert_array_equal(values, random.values(TICKS_S))


def test_signals_follow_each_other() -> None:
    plan = Experiment("two", [Constant(level=10.0, duration_s=0.1), Constant(level=-10.0, duration_s=0.05)])
    values, _ = plan.levels()
    np.testing.assert_array_equal(values, [10.0] * 20 + [-10.0] * 10)
    assert plan.duration_s == pytest.approx(0.15)


# ---- files ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", Experiment.names())
def test_every_shipped_experiment_loads_and_survives_its_own_writing(name: str, tmp_path: Path) -> None:
    plan = Experiment.load(name)
    assert plan.title
    path = tmp_path / f"{name}.toml"
    path.write_text(plan.to_toml())
    again = Experiment.load(path)
    assert again == plan
    np.testing.assert_array_equal(again.levels()[0], plan.levels()[0])
    assert plan.program().step(0, 0.0) is not None
    assert plan.program().step(plan.ticks, 0.0) is None


def test_every_kind_of_signal_is_written_as_it_is_read(tmp_path: Path) -> None:
    signals = [
        Constant(level=1.0, duration_s=1.0),
        Steps(times_s=(0.0, 0.5), levels=(1.0, 2.0), duration_s=1.0),
        Staircase(levels=(1.0, 2.0), step_s=0.1, duration_s=1.0),
        Square(low=1.0, high=2.0, period_s=0.5, start="high", duration_s=1.0),
        Sine(amplitude=3.0, period_s=0.5, duration_s=1.0),
        Multisine(amplitude=3.0, period_s=1.0, low_hz=1.0, high_hz=3.0, count=2, seed=9, duration_s=1.0),
        Ramp(begin=0.0, end=4.0, duration_s=1.0),
        RandomSteps(low=0.0, high=1.0, hold_min_s=0.1, hold_max_s=0.2, seed=4, duration_s=1.0),
        Pulses(levels=(5.0,), on_s=0.1, off_s=0.1, rest="standby", duration_s=1.0),
    ]
    assert {s.kind for s in signals} == set(KINDS)
    plan = Experiment("all", tuple(signals))
    (tmp_path / "all.toml").write_text(plan.to_toml())
    assert Experiment.load(tmp_path / "all.toml") == plan


OPEN = '[[command]]\nkind = "constant"\nlevel_pct = 10.0\nduration_s = 1.0\n'
CLOSED = (
    '[[reference]]\nkind = "square"\nlow_deg = 1.0\nhigh_deg = 2.0\nperiod_s = 1.0\nduration_s = 1.0\n'
    '[controller]\nkind = "p"\nkp_pct_per_deg = 1.0\n'
)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is empty"),
        (OPEN + CLOSED, "one of them"),
        (CLOSED.split("[controller]")[0], "goes with"),
        (OPEN + '[controller]\nkind = "p"\nkp_pct_per_deg = 1.0\n', "goes with"),
        (OPEN + "[deadband]\nu_plus_pct = 1.0\n", r"\[controller\] is missing"),
        (OPEN.replace("constant", "constnat"), "did you mean 'constant'"),
        (OPEN.replace("level_pct", "level_deg"), "'level_pct' is missing"),
        (OPEN.replace("10.0", "101.0"), "outside -100..100"),
        (OPEN.replace("10.0", "nan"), "not a finite number"),
        (OPEN.replace("10.0", '"ten"'), "not a finite number"),
        (OPEN.replace("1.0\n", "-1.0\n"), "outside"),
        (OPEN.replace("1.0\n", "1e9\n"), "outside"),
        (OPEN + "surprise = 1\n", "unknown key 'surprise'"),
        ("surprise = 1\n" + OPEN, "unknown key 'surprise'"),
        ("[controler]\n" + OPEN, "did you mean 'controller'"),
        ('schema = "fiohost.experiment/2"\n' + OPEN, "schema"),
        (CLOSED.replace('"p"', '"pdd"'), "did you mean 'pd'"),
        (CLOSED.replace('"p"', '"pd"'), "'kd_pct_s_per_deg' is missing"),
        (CLOSED.replace('"p"', '"pi"'), "'ki_pct_per_deg_s' is missing"),
        (CLOSED + "ki_pct_per_deg_s = 1.0\n", "unknown key 'ki_pct_per_deg_s'"),
        (CLOSED.replace('"p"', '"pi"') + "ki_pct_per_deg_s = 1.0\ntracking_s = -1.0\n", "tracking_s"),
        (CLOSED + "[deadband]\nu_minus_pct = 3.0\n", "outside -99..0"),
        (CLOSED.replace('kind = "square"', 'kind = "pulses"'), "missing"),
        (OPEN.replace('"constant"', '"steps"') + "times_s = [0.0]\nlevels_pct = [1.0]\n", "unknown key 'level_pct'"),
        (
            '[[command]]\nkind = "steps"\ntimes_s = [1.0, 0.5]\nlevels_pct = [1.0, 2.0]\nduration_s = 2.0\n',
            "must increase",
        ),
        ("[[command]]\nkind = \n", "not valid TOML"),
    ],
)
def test_a_file_that_is_wrong_is_refused_by_key_and_reason(text: str, reason: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=reason) as caught:
        Experiment.load(path)
    assert "\n" not in str(caught.value)


def test_an_unknown_experiment_names_the_nearest() -> None:
    with pytest.raises(ConfigError, match="square_170_190"):
        Experiment.load("square_170_180")


# ---- control -------------------------------------------------------------------------------------------------------


@given(st.floats(-90, 90), st.floats(0, 9), st.floats(-9, 0))
def test_compensation_undoes_the_deadband_of_the_lab_text(u: float, u_plus: float, u_minus: float) -> None:
    def dead_zone(v: float) -> float:  # Eq. 2.5
        return v - u_plus if v > u_plus else v - u_minus if v < u_minus else 0.0

    compensated = DeadbandCompensator(u_plus, u_minus).apply(u)
    assert math.isclose(dead_zone(compensated), u, abs_tol=1e-12)


def test_compensation_leaves_zero_at_zero_and_refuses_wrong_signs() -> None:
    assert DeadbandCompensator(3.0, -3.0).apply(0.0) == 0.0
    assert DeadbandCompensator(3.0, -3.0, threshold_pct=0.5).apply(-0.5) == 0.0
    for u_plus, u_minus in ((-1.0, -1.0), (1.0, 1.0), (math.nan, -1.0), (200.0, -1.0)):
        with pytest.raises(ConfigError):
            DeadbandCompensator(u_plus, u_minus)


def test_the_pd_controller_differentiates_through_its_filter() -> None:
    pd = PD(2.0, 0.1, sample_time_s=0.005, filter_s=0.02)
    assert pd.step(10.0, 0.0) == 20.0  # no kick from the first reading
    slope, filtered = 0.0, 0.0
    for k in range(1, 200):
        slope = -1.0 / 0.005 if k == 1 else 0.0
        filtered += 0.005 / (0.02 + 0.005) * (slope - filtered)
        expected = 2.0 * (10.0 - 1.0) + 0.1 * filtered
        assert pd.step(10.0, 1.0) == pytest.approx(expected)
    pd.reset()
    assert pd.step(10.0, 0.0) == 20.0


def test_a_step_of_the_reference_gives_no_kick_when_only_the_angle_is_differentiated() -> None:
    kicked, calm = PD(1.0, 0.1, 0.005), PD(1.0, 0.1, 0.005, on_angle=True)
    for pd in (kicked, calm):
        pd.step(0.0, 0.0)
    assert kicked.step(10.0, 0.0) == pytest.approx(10.0 + 0.1 * 10.0 / 0.005)
    assert calm.step(10.0, 0.0) == 10.0


def test_the_law_compensates_then_limits_and_tells_the_controller_what_was_applied() -> None:
    told: list[float] = []

    class Spy(P):
        def applied(self, duty_pct: float) -> None:
            told.append(duty_pct)

    law = ControlLaw(Spy(1.0), DeadbandCompensator(3.0, -4.0), limit_pct=50.0)
    assert [law.step(r, 0.0) for r in (10.0, -10.0, 49.0, -1000.0, 0.0)] == [13.0, -14.0, 50.0, -50.0, 0.0]
    assert told == [10.0, -10.0, 47.0, -46.0, 0.0]


@pytest.mark.parametrize("kind", ["p", "pd", "pi", "pid"])
def test_a_controller_survives_its_own_writing_and_its_log_names_every_gain(kind: str, tmp_path: Path) -> None:
    wanted = ControlSettings(kind, 1.5, u_plus_pct=3.0, u_minus_pct=-2.0)
    if kind in ("pd", "pid"):
        wanted = replace(wanted, kd_pct_s_per_deg=0.04, filter_s=0.01, derivative_on="angle")
    if kind in ("pi", "pid"):
        wanted = replace(wanted, ki_pct_per_deg_s=0.7, tracking_s=0.2)
    wanted.save(tmp_path / "c.toml", "found\nby hand")
    assert ControlSettings.load(tmp_path / "c.toml") == wanted
    said = wanted.describe()
    for name, value in wanted.law(0.005).controller.gains.items():
        assert float(said[name]) == value


def test_an_integral_gives_back_what_the_limit_cut_within_its_tracking_time() -> None:
    law = ControlLaw(PI(1.0, 2.0, sample_time_s=0.01, tracking_s=0.05), limit_pct=10.0)
    wanted, integral = 0.0, 0.0
    for _ in range(300):
        integral += 2.0 * 0.01 * 5.0
        wanted = 5.0 + integral
        assert law.step(5.0, 0.0) == pytest.approx(min(wanted, 10.0))
        integral += 0.01 / 0.05 * (min(wanted, 10.0) - wanted)
    assert wanted == pytest.approx(10.0 + 2.0 * 0.05 * 5.0, abs=0.01)  # excess: ki tracking_s e


def test_a_proportional_part_beyond_the_limit_does_not_wind_the_integral_up_the_other_way() -> None:
    for sign in (1.0, -1.0):
        law = ControlLaw(PI(1.0, 2.0, sample_time_s=0.01), limit_pct=10.0)
        assert {law.step(sign * 300.0, 0.0) for _ in range(100)} == {sign * 10.0}
        assert law.step(sign * 4.0, 0.0) == pytest.approx(sign * (4.0 + 2.0 * 0.01 * 4.0))


def test_a_law_that_computes_nan_is_refused_by_the_wire() -> None:
    with pytest.raises(LimitError):
        ClosedLoop(ControlLaw(P(1.0)), [math.nan]).step(0, 0.0)


@pytest.mark.parametrize(
    "bad", [{"limit_pct": 0.0}, {"limit_pct": 101.0}, {"u_plus_pct": -1.0}, {"kp_pct_per_deg": math.inf}]
)
def test_settings_built_in_code_are_checked_like_those_of_a_file(bad: dict[str, float]) -> None:
    with pytest.raises(ConfigError):
        Experiment("x", reference=[Constant(level=1.0, duration_s=1.0)], control=ControlSettings(**bad))  # type: ignore[arg-type]
