"""The kernel that is fitted: closed forms where they exist, limits where they do not."""

from __future__ import annotations

import numpy as np
import pytest

from fiohost.errors import FiohostError, ModelError
from fiohost.motor.effect import Span, effect, effects
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, Start, free_run, run, start_state

GAIN, TAU = 10.0, 0.08
LINEAR = {"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU}


def held(duty_pct: list[float], hold_s: float, tick_s: float = 0.005, mode: int = 1) -> Excitation:
    """Levels held one after another, acting at once."""
    ticks = round(hold_s / tick_s)
    duty = np.repeat(np.array(duty_pct), ticks)
    times = np.arange(len(duty) + 1) * tick_s
    modes = np.concatenate(([2], np.full(len(duty), mode, dtype=np.int64)))
    return Excitation(times, times[:-1], np.concatenate(([0.0], duty)), modes)


def test_a_step_gives_the_textbook_response() -> None:
    ex = held([40.0], 1.0)
    t = ex.times_s
    expected = GAIN * 40.0 * (t - TAU * (1 - np.exp(-t / TAU)))
    np.testing.assert_allclose(free_run(Model(values=LINEAR), ex, 0.0, 0.0), expected, atol=1e-9)


def test_dry_friction_lowers_the_steady_speed_by_its_level_and_holds_below_it() -> None:
    model = Model(("coulomb_friction",), {**LINEAR, "coulomb_friction.level_pct": 5.0})
    y = free_run(model, held([40.0], 2.0), 0.0, 0.0)
    assert (y[-1] - y[-2]) / 0.005 == pytest.approx(GAIN * 35.0, rel=1e-6)
    assert np.all(free_run(model, held([4.999], 10.0), 12.25, 0.0) == 12.25)


def test_a_braked_shaft_with_dry_friction_stops_dead_at_the_time_the_formula_gives() -> None:
    model = Model(("coulomb_friction",), {**LINEAR, "coulomb_friction.level_pct": 5.0})
    ex = held([0.0], 1.0, tick_s=0.0001, mode=2)
    states = run(
        ex, model.vector(), model.switches(), 0.0, start_state(Start(0.0, 300.0), model.vector(), model.switches())
    )
    speed = states[:, 1]
    stop_s = ex.times_s[np.argmax(speed == 0.0)]
    assert stop_s == pytest.approx(TAU * np.log(1 + 300.0 / (GAIN * 5.0)), abs=2e-4)
    assert np.all(speed[ex.times_s > stop_s] == 0.0)


def test_in_standby_only_friction_stops_the_shaft() -> None:
    model = Model(("coulomb_friction",), {**LINEAR, "coulomb_friction.level_pct": 5.0})
    ex = held([0.0], 1.0, mode=0)
    turned = free_run(model, ex, 0.0, 300.0)[-1]
    deceleration = GAIN * 5.0 / TAU
    assert turned == pytest.approx(300.0**2 / (2 * deceleration), rel=1e-9)


def test_a_delay_of_half_a_tick_shifts_the_response_by_half_a_tick() -> None:
    late = Model(("transport_delay",), {**LINEAR, "transport_delay.delay_s": 0.0025})
    fine = held([40.0], 0.5, tick_s=0.0025)
    y = free_run(late, held([40.0], 0.5), 0.0, 0.0)
    reference = free_run(Model(values=LINEAR), fine, 0.0, 0.0)
    np.testing.assert_allclose(y[1:], reference[1::2][: len(y) - 1], atol=1e-9)


def test_gravity_swings_like_a_damped_pendulum_and_its_energy_never_grows() -> None:
    level, phase = 8.0, 30.0
    model = Model(("gravity_load",), {**LINEAR, "gravity_load.level_pct": level, "gravity_load.phase_deg": phase})
    ex = held([0.0], 6.0, mode=0)
    states = run(
        ex,
        model.vector(),
        model.switches(),
        model.substep_s(),
        start_state(Start(60.0, 0.0), model.vector(), model.switches()),
    )
    # In standby nothing damps: kinetic plus potential energy, in units of torque percent times degrees, stays.
    kinetic = 0.5 * TAU / GAIN * states[:, 1] ** 2
    potential = -level * np.cos(np.radians(states[:, 0] + phase)) * 180 / np.pi
    energy = kinetic + potential
    assert np.ptp(energy) < 5e-3 * (np.ptp(kinetic))
    assert np.ptp(states[:, 0]) > 100


def test_substeps_are_fine_enough_for_a_load_that_follows_the_angle() -> None:
    model = Model(
        ("coulomb_friction", "gravity_load"),
        {**LINEAR, "gravity_load.level_pct": 10.0, "coulomb_friction.level_pct": 3.0},
    )
    rng = np.random.default_rng(4)
    ex = held(rng.uniform(-80, 80, 60).tolist(), 0.3)
    p, on = model.vector(), model.switches()
    coarse = run(ex, p, on, model.substep_s(), start_state(Start(5.0, 0.0), model.vector(), model.switches()))[:, 0]
    fine = run(ex, p, on, 5e-5, start_state(Start(5.0, 0.0), model.vector(), model.switches()))[:, 0]
    assert np.max(np.abs(coarse - fine)) < 0.005


@pytest.mark.parametrize(("gain", "tau_s"), [(10.0, 0.012), (10.0, 0.03), (50.0, 0.012), (50.0, 0.08)])
@pytest.mark.parametrize("name", [name for name, item in effects().items() if item.substep_s is not None])
def test_steps_are_fine_enough_for_every_effect(name: str, gain: float, tau_s: float) -> None:
    """To 2e-5 s times full speed, 0.02 deg at 1000 deg/s; where current ceases in a period of the PWM, to 3e-4 s."""
    item, ex = effect(name), held(np.random.default_rng(4).uniform(-80, 80, 30).tolist(), 0.3)
    linear = {"linear.gain_deg_s_per_pct": gain, "linear.tau_s": tau_s, "coulomb_friction.level_pct": 3.0}
    base = Model(("coulomb_friction",), linear)
    tried = item.tried(Span((0.0, 9.0), (), (3.0,)))
    ceases = item.opens or item.ceiling is not None or item.coasts is not None
    for trial in (tried[0], tried[-1]):
        model = base.with_effect(name, trial)
        p, on = model.vector(), model.switches()
        begin = start_state(Start(5.0, 0.0), p, on)
        coarse, fine = (run(ex, p, on, s, begin)[:, 0] for s in (model.substep_s(), 1e-4))
        apart = float(np.sqrt(np.mean((coarse - fine) ** 2)))
        assert apart < (3e-4 if ceases else 2e-5) * 100.0 * gain, (trial, model.substep_s(), apart)


def test_a_hold_is_stepped_in_equal_parts() -> None:
    """Parts that differ ask for the flow of each anew, and the longest is less exact than it need be."""
    values = {**LINEAR, "shaft_compliance.inertia_ratio": 0.3, "quadratic_drag.pct_at_1000_deg_s": 20.0}
    model = Model(("shaft_compliance", "quadratic_drag"), values)
    ex = held([60.0, -60.0], 0.5)
    p, on = model.vector(), model.switches()
    start = start_state(Start(0.0, 0.0), p, on)
    for substep_s in (0.0026, 0.003, 0.0049):
        np.testing.assert_array_equal(run(ex, p, on, substep_s, start), run(ex, p, on, 0.0025, start))


def test_play_after_the_motor_leaves_a_flat_of_the_gap_at_each_reversal() -> None:
    model = Model(("backlash",), {**LINEAR, "backlash.gap_deg": 3.0, "backlash.load_inertia_ratio": 0.0})
    ex = held([40.0, -40.0], 1.0)
    states = run(
        ex, model.vector(), model.switches(), 0.0, start_state(Start(0.0, 0.0), model.vector(), model.switches())
    )
    motor, load = states[:, 0], states[:, 2]
    assert motor[200] - load[200] == pytest.approx(1.5)
    assert load[-1] - motor[-1] == pytest.approx(1.5)
    assert np.max(np.abs(motor - load)) == pytest.approx(1.5)


def test_a_gap_before_the_load_conserves_momentum_at_impact_and_vanishes_without_load() -> None:
    rng = np.random.default_rng(3)
    ex = held(rng.uniform(-60, 60, 40).tolist(), 0.25)
    without = free_run(Model(("coulomb_friction",), LINEAR), ex, 0.0, 0.0)
    values = {**LINEAR, "backlash.side": "encoder_before_gap", "backlash.gap_deg": 4.0}
    light = Model(("coulomb_friction", "backlash"), {**values, "backlash.load_inertia_ratio": 0.011})
    heavy = Model(("coulomb_friction", "backlash"), {**values, "backlash.load_inertia_ratio": 0.4})
    assert np.max(np.abs(free_run(light, ex, 0.0, 0.0) - without)) < 0.4
    assert np.max(np.abs(free_run(heavy, ex, 0.0, 0.0) - without)) > 0.5
    p, on = heavy.vector(), heavy.switches()
    states = run(ex, p, on, 0.0, start_state(Start(0.0, 0.0), p, on))
    assert np.max(np.abs(states[:, 0] - states[:, 2])) <= 2.0 + 1e-9


def test_a_gap_is_crossed_alike_wherever_on_a_long_way_it_is() -> None:
    """Far angles are told apart less finely: contact must not be lost and made again without end there."""
    rng = np.random.default_rng(7)
    ex = held(rng.uniform(-60, 60, 40).tolist(), 0.25)
    for gap_deg in (3.7, 68.4475):
        values = {**LINEAR, "backlash.side": "encoder_before_gap", "backlash.gap_deg": gap_deg}
        model = Model(("backlash",), {**values, "backlash.load_inertia_ratio": 0.3})
        near, far = free_run(model, ex, 0.0, 0.0), free_run(model, ex, 3e5, 0.0)
        assert np.max(np.abs(far - 3e5 - near)) < 1e-3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("linear+coulomb_fricton", "coulomb_friction"),
        ("coulomb_friction", "begins with linear"),
        ("linear+backlash+backlash", "twice"),
        ("linear+", "unknown effect"),
    ],
)
def test_a_wrong_model_expression_is_refused_with_the_nearest_name(text: str, says: str) -> None:
    with pytest.raises(FiohostError, match=says):
        Model.parse(text)


def test_a_model_file_comes_back_as_it_was_and_a_wrong_one_is_refused(tmp_path) -> None:  # type: ignore[no-untyped-def]
    model = Model(("coulomb_friction", "backlash"), {**LINEAR, "backlash.side": "encoder_before_gap"})
    path = tmp_path / "m.toml"
    model.write(path)
    assert Model.parse(str(path)) == model
    for old, new, says in (
        ("linear.tau_s", "linear.tau", "tau_s"),
        ("effects", "efects", "effects"),
        ("linear.tau_s = 0.08", "linear.tau_s = nan", "finite"),
        ("linear.tau_s = 0.08", "linear.tau_s = -1.0", "outside"),
        ('"encoder_before_gap"', '"before"', "encoder_before_gap"),
    ):
        path.write_text(path.read_text())
        broken = tmp_path / "broken.toml"
        broken.write_text(path.read_text().replace(old, new))
        with pytest.raises(FiohostError, match=says):
            Model.parse(str(broken))


def test_every_effect_says_what_it_is_and_vanishes_at_its_neutral_value() -> None:
    rng = np.random.default_rng(8)
    ex = held(rng.uniform(-70, 70, 30).tolist(), 0.2)
    base = Model(("coulomb_friction",), LINEAR)
    reference = free_run(base, ex, 3.0, 0.0)
    for name, item in effects().items():
        assert item.summary
        assert item.equation
        assert item.source
        if name in ("linear", "coulomb_friction") or all(p.neutral is None for p in item.parameters):
            continue
        neutral = {p.name: p.neutral for p in item.parameters if p.neutral is not None}
        y = free_run(base.with_effect(name, neutral), ex, 3.0, 0.0)
        np.testing.assert_allclose(y, reference, atol=2e-3, err_msg=name)


def test_parameters_out_of_range_are_refused_by_name() -> None:
    with pytest.raises(ModelError, match=r"linear\.tau_s"):
        Model(values={"linear.tau_s": 0.0})


@pytest.mark.parametrize("name", [name for name, item in effects().items() if item.substep_s is None])
def test_an_effect_that_a_hold_freezes_depends_on_nothing_that_changes_within_it(name: str) -> None:
    item = effects()[name]
    q = tuple(parameter.code(parameter.start) for parameter in item.parameters)
    later = 0.0 if item.moment else 7.0
    states = ((0.0, 0.0, 50.0), (33.0, 200.0, 50.0 + later), (-5.0, -900.0, 50.0 + 2.0 * later))
    for hook in filter(None, (item.torque, item.load)):
        assert len({hook(*state, q) for state in states}) == 1
    for direction in (1.0, -1.0) if item.friction else ():
        assert len({item.friction(3.0, *state, state[1] / 9.0, direction, 0.0, q) for state in states}) == 1  # type: ignore[misc]
    assert item.rate is None
    assert item.resistance is None
    assert item.bristle is None
    if item.voltage:
        assert len({item.voltage(40.0, 40.0, time, 0.0, q) for *_, time in states}) == 1
