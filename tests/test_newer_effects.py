"""What single effects mean: their equations by hand, on the kernel that is fitted; the board is in test_pairs."""

from __future__ import annotations

import math

import numpy as np
import pytest

from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import MEAN_SPEED, SPEED, make_record
from fiohost.motor.electrics import coasting, follow, repeated
from fiohost.motor.hooks import command, measure
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, free_run
from firmware_model.motor import Motor
from firmware_model.plants import make_plant

GAIN, TAU, TICK_S = 10.0, 0.08, 0.005
LINEAR = {"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU}
DRIVE, STANDBY = 1, 0


def model(name: str, **values: float | str) -> Model:
    return Model((name,), {**LINEAR, **{f"{name}.{key}": value for key, value in values.items()}})


def held(duty_pct: float, seconds: float, mode: int = DRIVE) -> Excitation:
    times = np.arange(round(seconds / TICK_S) + 1) * TICK_S
    n = len(times)
    return Excitation(times, times, np.full(n + 1, duty_pct), np.full(n + 1, mode, dtype=np.int64))


def speed_at(m: Model, duty_pct: float, seconds: float = 3.0) -> float:
    """Mean speed over the last half second of a held duty, in deg/s."""
    angle = free_run(m, held(duty_pct, seconds), 0.0)
    return float(angle[-1] - angle[-101]) / (100 * TICK_S)


# ---- friction ------------------------------------------------------------------------------------------------------


def test_viscous_friction_is_part_of_the_gain_while_the_bridge_drives_and_alone_while_it_is_open() -> None:
    m = model("viscous_friction", pct_at_1000_deg_s=25.0)
    assert speed_at(m, 50.0) == pytest.approx(50.0 / (1.0 / GAIN + 0.025), rel=1e-6)
    angle = free_run(m, held(0.0, 8.0, STANDBY), 0.0, 400.0)
    lag_s = TAU / GAIN / 0.025  # J / b
    assert angle[-1] == pytest.approx(400.0 * lag_s * -math.expm1(-8.0 / lag_s), rel=1e-4)


@pytest.mark.parametrize(("direction", "slowed"), [("forward", 60.0), ("reverse", -60.0)])
def test_viscous_friction_by_direction_slows_one_direction_and_leaves_the_other(direction: str, slowed: float) -> None:
    m = model("viscous_friction_by_direction", pct_at_1000_deg_s=10.0, direction=direction)
    assert speed_at(m, slowed) == pytest.approx(slowed / (1.0 / GAIN + 0.010), rel=1e-6)
    assert speed_at(m, -slowed) == pytest.approx(-slowed * GAIN, rel=1e-6)


def test_sublinear_friction_is_its_level_at_1000_deg_s_and_more_than_its_share_below() -> None:
    m = model("sublinear_viscous_friction", pct_at_1000_deg_s=4.0, knee_deg_s=50.0)
    assert speed_at(m, 104.0) == pytest.approx(1000.0, rel=1e-6)
    slow = speed_at(m, 22.0)
    load = 22.0 - slow / GAIN
    assert load == pytest.approx(4.0 * math.asinh(slow / 50.0) / math.asinh(20.0), rel=1e-6)
    assert load > 2.0 * 4.0 * slow / 1000.0
    wide = model("sublinear_viscous_friction", pct_at_1000_deg_s=4.0, knee_deg_s=2000.0)
    assert speed_at(wide, 22.0) == pytest.approx(22.0 / (0.1 + 0.004), rel=5e-3), "with a high knee it is viscous"


# ---- curves --------------------------------------------------------------------------------------------------------


def curve_at(angle_deg: float, points: list[float], **place: float) -> float:
    """The curve in percent: the duty that holds a motor of this load just where it is, from the model's own hook."""
    from fiohost.motor.effect import effect

    values = {"from_deg": 0.0, "span_deg": 360.0, **place}
    q = np.array([*values.values(), *points])
    load = effect("load_over_position").load
    assert load is not None
    return -float(load(angle_deg, 0.0, 0.0, q))


def test_a_curve_goes_through_its_points_repeats_and_has_no_mean() -> None:
    points = list(np.random.default_rng(2).uniform(-3.0, 3.0, 11))
    for k, value in enumerate([*points, -sum(points)]):
        assert curve_at(30.0 * k, points) == pytest.approx(value, abs=1e-12)
        assert curve_at(30.0 * k - 720.0, points) == pytest.approx(value, abs=1e-9)
        assert curve_at(5.0 + 10.0 * k, points, from_deg=5.0, span_deg=120.0) == pytest.approx(value, abs=1e-9)
    fine = [curve_at(a, points) for a in np.arange(0.0, 360.0, 0.05)]
    assert np.mean(fine) == pytest.approx(0.0, abs=1e-9)
    assert np.max(np.abs(np.diff(fine, 2))) < 1e-3, "no corners"


def test_a_curve_is_linear_in_its_points_and_its_place_is_given_not_fitted() -> None:
    rng = np.random.default_rng(3)
    a, b = (list(rng.uniform(-3.0, 3.0, 11)) for _ in range(2))
    both = [2.0 * x - y for x, y in zip(a, b, strict=True)]
    for angle in rng.uniform(-500.0, 500.0, 50):
        assert curve_at(angle, both) == pytest.approx(2.0 * curve_at(angle, a) - curve_at(angle, b), abs=1e-12)
    free = model("load_over_position").free()
    assert [k for k in free if k.startswith("load_")] == [f"load_over_position.point_{i}_pct" for i in range(1, 12)]


def test_a_curve_of_a_load_is_found_again_by_a_fit() -> None:
    points = {f"point_{i}_pct": 2.0 * math.sin(2.0 * math.pi * 2 * (i - 1) / 12) for i in range(1, 12)}
    truth = model("load_over_position", **points)
    rng = np.random.default_rng(4)
    duty = np.repeat(rng.uniform(-60.0, 60.0, 40), 100)
    times = np.arange(len(duty)) * TICK_S
    record = make_record("steps", times, duty, np.zeros(len(duty)), quantum=0.5, at_rest=True)
    y = free_output(record, Flat.of(truth), Start(0.2, 0.0))
    seen = make_record("steps", times, duty, np.floor(y / 0.5) * 0.5, quantum=0.5, at_rest=True)
    found = fit(model("load_over_position", **{k: 0.1 for k in points}), [seen], windows=True).model
    for key, value in points.items():
        assert found.number(f"load_over_position.{key}") == pytest.approx(value, abs=0.25), key


# ---- time and duty -------------------------------------------------------------------------------------------------


def test_a_clocks_line_is_at_its_frequency_whatever_the_speed() -> None:
    m = model("clock_ripple", level_pct=3.0, frequency_hz=2.0, phase_deg=90.0, of="torque")
    for duty in (20.0, 70.0):
        y = free_run(m, held(duty, 6.0), 0.0)
        speed = np.diff(y)[-800:] / TICK_S
        t = (np.arange(len(y) - 801, len(y) - 1) + 0.5) * TICK_S
        pulse = 2.0 * math.pi * 2.0
        reach = 3.0 * GAIN / math.hypot(1.0, pulse * TAU)
        expected = GAIN * duty + reach * np.sin(pulse * t + math.pi / 2.0 - math.atan(pulse * TAU))
        assert np.max(np.abs(speed - expected)) < 0.1
    ripple = model("clock_ripple", level_pct=3.0, frequency_hz=2.0, of="gain")
    sizes = [np.ptp(np.diff(free_run(ripple, held(d, 6.0), 0.0))[-800:]) for d in (20.0, 80.0)]
    assert sizes[1] == pytest.approx(4.0 * sizes[0], rel=1e-3), "a gain's line grows with the duty"


@pytest.mark.parametrize(("follows", "goal"), [("time", 1.0), ("running", 1.0), ("heat", 0.0)])
def test_gain_warms_to_its_level_with_its_time_constant(follows: str, goal: float) -> None:
    """At a held duty without load the current is nil, so nothing heats."""
    m = model("gain_warm_up", ratio=0.1, time_constant_s=2.0, follows=follows)
    y = free_run(m, held(40.0, 30.0), 0.0)
    speed = np.diff(y) / TICK_S
    assert speed[-1] == pytest.approx(400.0 * (1.0 + 0.1 * goal), rel=2e-4)
    if goal:
        assert speed[round(2.0 / TICK_S)] == pytest.approx(400.0 * (1.0 + 0.1 * -math.expm1(-1.0)), rel=2e-3)


@pytest.mark.parametrize(
    ("rounding", "duty", "acts"),
    [("cut", 39.9, 0.8 * 39.9 + 0.2 * 20.0), ("cut", 40.0, 40.0), ("nearest", 31.0, 0.8 * 31.0 + 0.2 * 40.0),
     ("up", 21.0, 0.8 * 21.0 + 0.2 * 40.0), ("cut", -39.9, -(0.8 * 39.9 + 0.2 * 20.0)), ("cut", 0.0, 0.0)],
)  # fmt: skip
def test_a_share_of_the_duty_comes_in_steps(rounding: str, duty: float, acts: float) -> None:
    m = model("duty_steps", step_pct=20.0, share=0.2, rounding=rounding)
    assert command(duty, (5e-5,), m.vector(), m.switches()) == pytest.approx(acts, abs=1e-9)


# ---- a bridge that coasts ------------------------------------------------------------------------------------------


def mean_by_pulses(
    volts: float, emf: float, share: float, ohms: float, periods: float, most: float, drop: float, pause: float
) -> float:
    """Mean current over a period once it repeats, each pulse followed piece by piece; voltages lost are ``drop`` while
    it is on and ``pause`` between two.
    """
    i, mean = 0.0, 0.0
    for _ in range(4000):
        i, first, _ = follow(i, volts - emf, drop, ohms, periods / ohms, most, share)
        i, second, _ = follow(i, -emf, pause, ohms, periods / ohms, most, 1.0 - share)
        if abs(first + second - mean) < 1e-13:
            break
        mean = first + second
    return mean


@pytest.mark.parametrize("most", [np.inf, 30.0])
def test_the_closed_form_of_a_coasting_bridge_is_what_its_pulses_give(most: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(400):
        volts = rng.choice((-1.0, 1.0)) * rng.uniform(80.0, 100.0)
        emf, share, ohms = rng.uniform(-130.0, 130.0), rng.uniform(0.02, 1.0), rng.uniform(0.8, 1.5)
        periods = 10.0 ** rng.uniform(-3.0, 0.0)
        expected = mean_by_pulses(volts, emf, share, ohms, periods, most, 0.0, abs(volts))
        found = coasting(volts, emf, share, 0.0, ohms, most, periods)
        assert found == pytest.approx(expected, abs=1e-6), (volts, emf, share, ohms, periods)


@pytest.mark.parametrize("most", [np.inf, 3.0])
@pytest.mark.parametrize("opens", [False, True])
def test_a_current_that_repeats_itself_is_found_however_slow_the_winding(opens: bool, most: float) -> None:
    """A steady speed under light load, where the current flows both ways in each period and each zero costs a drop."""
    rng = np.random.default_rng(6)
    for _ in range(100):
        volts, drop, share = rng.choice((-1.0, 1.0)) * 100.0, rng.uniform(0.5, 4.0), rng.uniform(0.02, 0.9)
        emf, periods = share * volts + rng.uniform(-5.0, 5.0), 10.0 ** rng.uniform(-1.0, 2.0)
        pause = drop + (100.0 if opens else 0.0)
        expected = mean_by_pulses(volts, emf, share, 1.0, periods, most, drop, pause)
        found = repeated(volts, share, drop, pause, emf, 1.0, periods, most, 1.0)
        assert found == pytest.approx(expected, abs=1e-6), (volts, emf, share, drop, periods)


def test_a_current_that_ceases_at_once_is_the_duty_times_supply_less_emf() -> None:
    m = Model(
        ("coast_pwm", "viscous_friction"),
        {**LINEAR, "coast_pwm.decay_periods": 0.0, "viscous_friction.pct_at_1000_deg_s": 20.0},
    )
    for duty in (10.0, 40.0, 80.0):
        share = 0.01 * duty
        assert speed_at(m, duty, 8.0) == pytest.approx(duty / (share / GAIN + 0.02), rel=1e-4)


def test_the_boards_coasting_bridge_with_resolved_edges_turns_as_fast() -> None:
    table = {
        "supply_V": 9.0, "R_ohm": 5.0, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.45, "J_kgm2": 3e-3, "coulomb_Nm": 0.018,
        "L_H": 5e-4, "effects": {"coast_pwm": {"pwm_Hz": 500.0}, "viscous_friction": {"drag_Nms": 0.004}},
    }  # fmt: skip
    plant = make_plant(table, "coasting")
    names = ("coulomb_friction", "coast_pwm", "viscous_friction")
    reduced = plant.reduced()
    m = Model(names, {f"{name}.{key}": value for name in ("linear", *names) for key, value in reduced[name].items()})
    assert m.number("coast_pwm.decay_periods") == pytest.approx(0.05)
    for duty in (15.0, 40.0, 80.0):
        motor = Motor(plant, pwm="edge_resolved")
        _, states = motor.run_many(np.full(800, DRIVE, dtype=np.int64), np.full(800, duty), TICK_S)
        board = math.degrees(states[-1, 0] - states[-201, 0]) / 1.0
        assert speed_at(m, duty, 4.0) == pytest.approx(board, rel=3e-3)


# ---- sensors -------------------------------------------------------------------------------------------------------


def test_the_phases_of_an_angle_error_turn_with_the_zero_each_by_its_order() -> None:
    values = {"level_1_deg": 1.0, "phase_1_deg": 20.0, "level_2_deg": 0.5, "phase_2_deg": -50.0, "level_3_deg": 0.3}
    m = model("shaft_angle_error", **values)
    flat = Flat.of(m)
    assert flat.orders() == [1, 2, 3]
    turned = flat.from_zero(35.0)
    for angle in (0.0, 77.0, 301.0):
        here = measure(angle, (), turned.p, turned.on) - angle
        there = measure(angle + 35.0, (), flat.p, flat.on) - (angle + 35.0)
        assert here == pytest.approx(there, abs=1e-9)


def test_a_curve_stays_where_it_is_on_the_bench_when_the_zero_turns() -> None:
    flat = Flat.of(model("load_over_position", from_deg=10.0))
    place = next(i for i, (a, b) in enumerate(zip(flat.p, flat.from_zero(35.0).p, strict=True)) if a != b)
    assert flat.p[place] == 10.0
    assert flat.from_zero(35.0).p[place] == pytest.approx(-25.0)


@pytest.mark.parametrize("kind", [SPEED, MEAN_SPEED])
def test_a_speed_without_sign_is_simulated_as_it_is_read_and_its_share_is_found(kind: int) -> None:
    rng = np.random.default_rng(6)
    duty = np.repeat(rng.uniform(-60.0, 60.0, 30), 40)
    times = np.arange(len(duty)) * 0.01
    truth = model("unsigned_speed", share=1.0)
    blank = make_record("speed", times, duty, np.zeros(len(duty)), kind=kind, unit="deg/s", at_rest=True)
    y = free_output(blank, Flat.of(truth), Start(0.0, 0.0))
    signed = free_output(blank, Flat.of(Model((), LINEAR)), Start(0.0, 0.0))
    assert np.min(y) >= 0.0
    np.testing.assert_allclose(y, np.abs(signed), atol=1e-9)
    seen = make_record("speed", times, duty, y, kind=kind, unit="deg/s", at_rest=True)
    found = fit(model("unsigned_speed", share=0.7), [seen]).model
    assert found.number("unsigned_speed.share") == pytest.approx(1.0, abs=1e-3)
    assert found.number("linear.gain_deg_s_per_pct") == pytest.approx(GAIN, rel=1e-3)
