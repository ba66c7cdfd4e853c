"""The compiled loop is the bench's loop and the textbook's, and the figures of its responses are the textbook's."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from short_runs import logs_of
from test_agreement import IDEAL, physical_model

from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.signals import Square
from fiohost.control.closed_loop import Loop, LoopRun, Plant, run_loop, step_run
from fiohost.control.metrics import step_figures
from fiohost.errors import ConfigError, DataError
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, free_run

GAIN, TAU = 10.0, 0.08
LINEAR = Model(values={"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU})


def second_order(zeta: float, omega_n: float, times: np.ndarray) -> np.ndarray:
    """Unit step response of an underdamped second-order system."""
    root = math.sqrt(1.0 - zeta**2)
    phase = omega_n * root * times
    return 1.0 - np.exp(-zeta * omega_n * times) * (np.cos(phase) + zeta / root * np.sin(phase))


# ---- figures -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("zeta", [0.2, 0.45, 0.7, 0.9])
@pytest.mark.parametrize("size", [160.0, -2.0])
def test_figures_of_a_second_order_response_are_the_formulas(zeta: float, size: float) -> None:
    omega_n = 10.0
    times = np.linspace(0.0, 12.0 / (zeta * omega_n) + 2.0, 40001)
    found = step_figures(times, 3.0 + size * second_order(zeta, omega_n, times), 3.0, 3.0 + size)
    root = math.sqrt(1.0 - zeta**2)
    assert found.overshoot_pct == pytest.approx(100.0 * math.exp(-math.pi * zeta / root), abs=0.01)
    assert found.peak_s == pytest.approx(math.pi / (omega_n * root), abs=2e-3)
    assert found.steady_state_error == pytest.approx(0.0, abs=1e-3)
    fine = np.linspace(0.0, times[-1], 2_000_001)
    error = np.abs(second_order(zeta, omega_n, fine) - 1.0)
    for band, value in ((0.02, found.settling_2_s), (0.05, found.settling_5_s)):
        assert value == pytest.approx(fine[np.flatnonzero(error > band)[-1]], abs=1e-3)
    first = np.argmax(second_order(zeta, omega_n, fine) >= 0.9), np.argmax(second_order(zeta, omega_n, fine) >= 0.1)
    assert found.rise_s == pytest.approx(fine[first[0]] - fine[first[1]], abs=1e-3)


def test_figures_of_a_first_order_lag_are_its_logarithms() -> None:
    times = np.linspace(0.0, 2.0, 801)
    found = step_figures(times, 1.0 - np.exp(-times / 0.1), 0.0, 1.0)
    assert found.overshoot_pct < 1e-6
    assert found.rise_s == pytest.approx(0.1 * math.log(9.0), abs=2e-5)
    assert found.settling_5_s == pytest.approx(0.1 * math.log(20.0), abs=2e-5)
    assert found.settling_2_s == pytest.approx(0.1 * math.log(50.0), abs=5e-5)


@pytest.mark.parametrize("end", [156.0, 0.1, -1.0 / 3.0])
def test_a_response_that_rests_does_not_overshoot_by_round_off(end: float) -> None:
    times = np.arange(401) * 0.005
    assert step_figures(times, np.minimum(times / 0.3, 1.0) * end, 0.0, 1.02 * end).overshoot_pct == 0.0
    slow = end * (1.0 - np.exp(-times / 0.09))  # still 2e-10 of its way to go at the end
    assert step_figures(times, slow, 0.0, end).overshoot_pct == 0.0


@settings(max_examples=60, deadline=None)
@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=60), st.floats(-1e3, 1e3))
@example([1.0, 2.225073858507e-311], 0.0)
def test_figures_of_any_response_are_bounded_by_its_run(values: list[float], target: float) -> None:
    times = np.arange(len(values)) * 0.01
    found = step_figures(times, np.array(values), 0.0, target)
    for value in (found.rise_s, found.peak_s, found.settling_2_s, found.settling_5_s):
        assert 0.0 <= value <= times[-1]
    assert found.settling_5_s <= found.settling_2_s
    assert 0.0 <= found.overshoot_pct <= 1000.0
    assert math.isfinite(found.final)


def test_a_shaft_that_stays_has_the_whole_step_for_error_and_never_gets_there() -> None:
    found = step_figures(np.arange(100) * 0.01, np.zeros(100), 0.0, 5.0)
    assert (found.overshoot_pct, found.steady_state_error) == (0.0, 5.0)
    assert found.rise_s == found.settling_5_s == pytest.approx(0.99)


@pytest.mark.parametrize("y", [[1.0], [0.0, math.nan, 1.0]])
def test_figures_of_nothing_are_refused(y: list[float]) -> None:
    with pytest.raises(DataError):
        step_figures(np.arange(len(y)) * 0.01, np.array(y), 0.0, 1.0)


# ---- the loop ------------------------------------------------------------------------------------------------------


def test_a_fast_loop_is_the_continuous_one() -> None:
    kp = 1.5
    omega_n = math.sqrt(kp * GAIN / TAU)
    zeta = 1.0 / (2.0 * TAU * omega_n)
    run = step_run(Plant.of(LINEAR), Loop(kp, sample_time_s=1e-5), 60.0, 1.5)
    exact = 60.0 * second_order(zeta, omega_n, run.time_s)
    assert np.max(np.abs(run.duty_pct)) < 100.0
    assert np.max(np.abs(run.angle_deg - exact)) < 0.01


MODELS = {
    "linear": LINEAR,
    "stick": LINEAR.with_effect("coulomb_friction", {"level_pct": 3.0}).with_effect("static_friction"),
    "play": LINEAR.with_effect("backlash", {"gap_deg": 3.0}),
    "delay": LINEAR.with_effect("transport_delay", {"delay_s": 0.013}),
    "lag": LINEAR.with_effect("armature_inductance", {"time_constant_s": 0.004}),
    "drop": LINEAR.with_effect("bridge_voltage_drop", {"drop_pct": 4.0}),
}


@pytest.mark.parametrize("name", MODELS)
def test_its_angle_is_the_free_run_on_its_own_commands(name: str) -> None:
    loop = Loop(2.0, kd_pct_s_per_deg=0.02, filter_s=0.01, delay_s=0.007)
    run = step_run(Plant.of(MODELS[name]), loop, 90.0, 1.0)
    modes = np.ones(len(run.time_s) + 1, dtype=np.int64)
    excitation = Excitation(run.time_s, run.time_s + 0.007, np.concatenate(([0.0], run.duty_pct)), modes)
    assert np.ptp(run.angle_deg) > 80.0
    assert np.max(np.abs(run.angle_deg - free_run(MODELS[name], excitation, 0.0))) < 1e-7


@pytest.mark.parametrize("on_angle", [False, True])
@pytest.mark.parametrize("tracking_s", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["p", "pd", "pi", "pid"])
def test_its_commands_are_those_of_the_benchs_law(kind: str, on_angle: bool, tracking_s: float) -> None:
    control = ControlSettings(
        kind, 1.4, 0.03, 0.02, "angle" if on_angle else "error", 55.0, 2.0, -3.0, 0.6, 4.0, tracking_s
    )
    run = step_run(Plant.of(MODELS["stick"]), control.loop(0.005, 0.005, 0.5), -70.0, 1.0)
    law = control.law(0.005)
    expected = [law.step(r, a) for r, a in zip(run.ref_deg, run.angle_deg, strict=True)]
    assert run.duty_pct == pytest.approx(expected, abs=1e-9)
    assert np.all(np.mod(run.angle_deg, 0.5) == 0.0)
    law.reset()
    assert law.step(run.ref_deg[0], run.angle_deg[0]) == expected[0]
    assert np.any(np.abs(run.duty_pct) == 55.0)  # the limit cut something, so that it had to be given back


def test_it_goes_where_the_bench_goes(tmp_path: Path) -> None:
    square = Square(duration_s=6.0, low=10.0, high=150.0, period_s=3.0)
    control = ControlSettings("p", 1.2, limit_pct=80.0, u_plus_pct=2.0, u_minus_pct=-2.0)
    (log,) = logs_of("sim:ideal", tmp_path, [Experiment("loop", reference=(square,), control=control)])
    loop = Loop(1.2, limit_pct=80.0, u_plus_pct=2.0, u_minus_pct=-2.0, delay_s=0.005, quantum_deg=0.5)
    begin = float(log.columns["angle_deg"][0]) + 0.25
    run = run_loop(Plant.of(physical_model(IDEAL)), loop, log.columns["ref_deg"], Start(begin, 0.0))
    assert np.ptp(log.columns["angle_deg"]) > 100.0
    # The board cuts the duty to its timer's steps and its encoder's zero lies somewhere within a count.
    assert np.max(np.abs(run.angle_deg - log.columns["angle_deg"])) <= 1.0


def test_an_integral_takes_away_what_a_load_leaves() -> None:
    loaded = LINEAR.with_effect("constant_load", {"level_pct": 5.0})

    def left(loop: Loop) -> float:
        run = step_run(Plant.of(loaded), loop, 60.0, 6.0)
        return step_figures(run.time_s, run.angle_deg, 0.0, 60.0).steady_state_error

    assert left(Loop(1.0)) == pytest.approx(5.0, abs=0.01)  # 5 % of duty at 1 %/deg
    assert left(Loop(1.0, ki_pct_per_deg_s=1.0)) == pytest.approx(0.0, abs=0.05)


@pytest.mark.parametrize("tracking_s", [0.0, 0.1])
def test_a_held_integral_does_not_wind_up(tracking_s: float) -> None:
    def overshoot(holds: bool) -> float:
        loop = Loop(
            2.0, ki_pct_per_deg_s=4.0, kd_pct_s_per_deg=0.15, limit_pct=20.0, holds_integral=holds,
            tracking_s=tracking_s,
        )  # fmt: skip
        run = step_run(Plant.of(LINEAR), loop, 180.0, 8.0)
        assert np.max(np.abs(run.duty_pct)) <= 20.0
        return step_figures(run.time_s, run.angle_deg, 0.0, 180.0).overshoot_pct

    assert overshoot(True) < 0.5 * overshoot(False)


def test_a_step_that_begins_elsewhere_first_goes_there() -> None:
    back = step_run(Plant.of(LINEAR), Loop(1.0), 0.0, 2.0, from_deg=90.0, hold_s=3.0)
    there: LoopRun = step_run(Plant.of(LINEAR), Loop(1.0), 90.0, 2.0)
    assert back.time_s[0] == 0.0
    assert back.angle_deg == pytest.approx(90.0 - there.angle_deg, abs=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [{"kp_pct_per_deg": math.nan}, {"sample_time_s": 0.0}, {"limit_pct": 101.0}, {"delay_s": -1.0}, {"u_minus_pct": 1}],
)
def test_settings_that_make_no_loop_are_refused(wrong: dict[str, float]) -> None:
    with pytest.raises(ConfigError, match=next(iter(wrong))):
        Loop(**{"kp_pct_per_deg": 1.0, **wrong})
    with pytest.raises(ConfigError, match="reference"):
        run_loop(Plant.of(LINEAR), Loop(1.0), np.empty(0))
