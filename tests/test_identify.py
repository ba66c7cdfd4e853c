"""Estimation: simulation-error fits, initial states, intervals."""

from __future__ import annotations

import numpy as np
import pytest
from bench_data import TICK_S, measure, multisine, steps, suite, truth_model

from fiohost.errors import DataError
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.initial import initial_state
from fiohost.estimation.intervals import estimates
from fiohost.estimation.predict import Flat, free_output, free_states, window_residuals
from fiohost.estimation.record import ANGLE, MEAN_SPEED, SPEED, cut_windows, make_record
from fiohost.judging.metrics import judge
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.motor.state import BRAKE, DRIVE


def test_the_fit_finds_gain_lag_and_friction_from_counts_far_below_one_percent() -> None:
    truth = truth_model()
    found = fit_from_scratch(Model.parse("linear+coulomb_friction"), suite(truth, 1)).model
    for key, tolerance in (
        ("linear.gain_deg_s_per_pct", 3e-4),
        ("linear.tau_s", 2e-3),
        ("coulomb_friction.level_pct", 5e-3),
    ):
        assert found.number(key) == pytest.approx(truth.number(key), rel=tolerance), key


def test_fixed_parameters_stay_where_they_are() -> None:
    truth = truth_model()
    model = Model(("coulomb_friction",), {"linear.tau_s": 0.1}, frozenset({"linear.tau_s"}))
    found = fit_from_scratch(model, suite(truth, 2)).model
    assert found.number("linear.tau_s") == 0.1
    assert found.number("linear.gain_deg_s_per_pct") != 10.0


def test_the_initial_state_of_a_record_that_begins_in_motion_is_found() -> None:
    rng = np.random.default_rng(5)
    truth = truth_model()
    whole = measure(truth, steps(6.0, rng), rng)
    first = 217
    part = make_record(
        "tail",
        np.arange(len(whole) - first) * TICK_S,
        whole.excitation.duties_pct[1 + first :],
        whole.y[first:],
        quantum=0.5,
        command_delay_s=TICK_S,
    )
    assert not part.at_rest
    y = free_output(part, Flat.of(truth), initial_state(part, Flat.of(truth)))
    # The command in force before the first row is not recorded: it is taken as the first one.
    assert np.sqrt(np.mean((part.y - y)[200:] ** 2)) < 0.5


@pytest.mark.parametrize(("speed_deg_s", "before"), [(0.0, (0.0, BRAKE)), (400.0, (40.0, DRIVE))])
@pytest.mark.parametrize("kind", [ANGLE, SPEED])
def test_noisy_readings_of_a_shaft_at_rest_are_no_motion(
    kind: int, speed_deg_s: float, before: tuple[float, int]
) -> None:
    """What acted before the first row is the first command in motion only; a delay acts on it."""
    rng, times = np.random.default_rng(5), np.arange(400) * TICK_S
    speed = speed_deg_s + (400.0 - speed_deg_s) * (1.0 - np.exp(-np.maximum(times - 0.03, 0.0) / 0.07))
    angle = np.concatenate(([0.0], np.cumsum(speed[:-1]) * TICK_S))
    made = angle + rng.normal(0.0, 0.3, len(times)) if kind == ANGLE else speed + rng.normal(0.0, 20.0, len(times))
    begun = make_record(
        "noisy",
        times,
        np.full(len(times), 40.0),
        made,
        kind=kind,
        unit="deg" if kind == ANGLE else "deg/s",
        quantum=0.01,
    ).excitation
    assert (begun.duties_pct[0], begun.modes[0]) == before


def test_speed_logs_are_first_class() -> None:
    rng = np.random.default_rng(6)
    truth = truth_model()
    made = measure(truth, multisine(10.0, rng), rng)
    angle = free_output(made, Flat.of(truth), Start(0.0, 0.0))
    mean_speed = np.diff(angle, prepend=angle[0]) / TICK_S
    for kind, y in ((MEAN_SPEED, mean_speed), (SPEED, np.gradient(angle, TICK_S))):
        record = make_record(
            "speed", made.excitation.times_s, made.excitation.duties_pct[1:], y, kind=kind, unit="deg/s",
            command_delay_s=TICK_S,
        )  # fmt: skip
        found = fit_from_scratch(Model.parse("linear+coulomb_friction"), [record]).model
        assert found.number("linear.tau_s") == pytest.approx(0.072, rel=0.02)
        assert found.number("coulomb_friction.level_pct") == pytest.approx(2.7, rel=0.05)


def test_intervals_cover_the_truth_about_as_often_as_they_say() -> None:
    truth = truth_model()
    hits, total = 0, 0
    for seed in range(30):
        found = estimates(
            fit(Model.parse("linear+coulomb_friction").with_values(truth.values), suite(truth, 100 + seed, 6.0))
        )
        for key, estimate in found.items():
            hits += estimate.ci95[0] <= truth.number(key) <= estimate.ci95[1]
            total += 1
    assert 0.85 <= hits / total <= 1.0, f"{hits} of {total}"


def test_a_parameter_that_the_data_do_not_show_is_called_so() -> None:
    truth = truth_model()
    model = Model(("coulomb_friction", "voltage_saturation"), truth.values | {"voltage_saturation.limit_pct": 99.5})
    found = estimates(fit(model, suite(truth, 3)))
    assert not found["voltage_saturation.limit_pct"].identifiable
    assert found["linear.tau_s"].identifiable


def test_windows_cover_every_sample_once_and_a_short_tail_joins_the_last() -> None:
    times = np.arange(1050) * TICK_S
    edges = cut_windows(times)
    assert edges[0] == 0
    assert edges[-1] == 1050
    assert edges.tolist() == [0, 200, 400, 600, 800, 1050]


def test_figures_of_the_true_model_are_those_of_the_counts_alone() -> None:
    truth = truth_model()
    for record in suite(truth, 9):
        errors = judge(record, truth).errors
        assert errors.window_rms == pytest.approx(0.5 / np.sqrt(12), rel=0.1)
        if record.name.startswith("steps"):  # it moves in its first second, so its angle within a count is known
            assert errors.bin_violation_pct is not None
            assert errors.bin_violation_pct < 10


def test_nothing_to_fit_is_said() -> None:
    with pytest.raises(DataError, match="no log"):
        fit(Model(), [])
    still = make_record("still", np.arange(100) * TICK_S, np.zeros(100), np.zeros(100), quantum=0.5)
    with pytest.raises(DataError, match="moving"):
        fit_from_scratch(Model(), [still])


def test_windows_are_fitted_to_their_minimum_wherever_the_free_run_stands() -> None:
    """An offset of the run as a whole must not spoil the search for a window's speed."""
    rng = np.random.default_rng(41)
    truth = truth_model(())
    record = measure(truth, np.full(1600, 60.0), rng)
    near = truth.with_values({"linear.gain_deg_s_per_pct": 10.4, "linear.tau_s": 0.1})
    found = [
        window_residuals(record, Flat.of(near), free_states(record, Flat.of(near), Start(angle, 150.0)))
        for angle in (0.0, 0.004, 0.5, 40.0, -3000.0)
    ]
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-4)
    fits = [fit(truth.with_values({"linear.gain_deg_s_per_pct": k, "linear.tau_s": t}), [record], windows=True).model
            for k, t in ((9.0, 0.03), (10.6, 0.2), (14.0, 0.07))]  # fmt: skip
    for model in fits:
        assert model.number("linear.gain_deg_s_per_pct") == pytest.approx(10.6, rel=1e-3)
        assert model.number("linear.tau_s") == pytest.approx(0.072, rel=0.02)
