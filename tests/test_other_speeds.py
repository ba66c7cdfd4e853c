"""Motors that are many times as fast, or as slow, as those that the library's trials are for."""

from __future__ import annotations

import numpy as np
import pytest
from bench_data import measure, steps, suite, truth_model

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.offered import span_of
from fiohost.discover.logs.screen import Screen
from fiohost.discover.score import at_a_bound
from fiohost.estimation.fit import fit
from fiohost.motor.effect import Span, effect
from fiohost.motor.model import Model

LIBRARY = (
    "asymmetric_deadband",
    "quadratic_drag",
    "duty_curve",
    "constant_load",
    "stribeck_friction",
    "sublinear_viscous_friction",
)


@pytest.mark.parametrize(
    ("gain", "names", "values"),
    [
        (
            250.0,
            {"stribeck_friction"},
            {"stribeck_friction.extra_pct": 3.0, "stribeck_friction.stribeck_speed_deg_s": 1500.0},
        ),
        (
            1.0,
            {"stribeck_friction"},
            {"stribeck_friction.extra_pct": 3.0, "stribeck_friction.stribeck_speed_deg_s": 4.0},
        ),
    ],
)
def test_what_hangs_on_speed_is_named_on_fast_and_slow_motors(
    gain: float, names: set[str], values: dict[str, float]
) -> None:
    truth = truth_model(("coulomb_friction", *sorted(names)), {"linear.gain_deg_s_per_pct": gain, **values})
    found = diagnose_records(suite(truth, 11), (), Model.parse("linear+coulomb_friction"), library=LIBRARY)
    assert ({s.effect for s in found.steps}, found.verdict) == (names, "explained")
    final = found.final.fit.model
    assert {k: final.number(k) for k in values} == pytest.approx(values, rel=0.05)


def test_a_drag_of_a_fast_motor_scores_beside_another_effect_that_hides_it() -> None:
    """A trial for a slow motor is 200 % of full drive there: by its signature it takes 4 and 6 % of what is left."""
    values = {"asymmetric_deadband.u_plus_pct": 3.1, "asymmetric_deadband.u_minus_pct": -6.6}
    drag = {"quadratic_drag.pct_at_1000_deg_s": 0.013, "coulomb_friction.level_pct": 8.0}
    motor = {"linear.gain_deg_s_per_pct": 250.0, "linear.tau_s": 0.0427}
    truth = truth_model(("coulomb_friction", "asymmetric_deadband", "quadratic_drag"), {**values, **drag, **motor})
    for seed in (1, 3):
        rng = np.random.default_rng(seed)
        records = [measure(truth, steps(12.0, rng), rng) for _ in range(3)]
        declared = Model.parse("linear+coulomb_friction+asymmetric_deadband")
        screen = Screen(fit(declared, records, windows=True, max_iterations=40), records)
        assert screen.score(effect("quadratic_drag")).share > 0.25


def test_trials_are_for_the_speed_that_is_reached() -> None:
    for gain, scale in ((10.6, 1.0), (250.0, 16.0), (0.4, 1 / 16.0)):
        span = span_of(suite(truth_model(values={"linear.gain_deg_s_per_pct": gain}), 3, 6.0))
        assert span.speed_scale == scale, span
        (drag,) = effect("quadratic_drag").tried(span)
        assert drag == {"pct_at_1000_deg_s": 2.0 / scale**2}
        speeds = [t["stribeck_speed_deg_s"] for t in effect("stribeck_friction").tried(span)]
        assert speeds[::2] == [15.0 * scale, 60.0 * scale, 200.0 * scale]
    assert effect("quadratic_drag").tried(Span((0.0, 9.0), ())) == [{"pct_at_1000_deg_s": 2.0}]


def test_a_friction_that_falls_beyond_all_speeds_is_not_believed() -> None:
    """At such speeds its fall is a straight line, which the gain is too."""
    records = suite(truth_model(), 5, 6.0)
    for speed, why in ((900.0, None), (1300.0, "stribeck_speed_deg_s went beyond the motor's full speed")):
        values = {"extra_pct": 3.0, "stribeck_speed_deg_s": speed}
        model = Model.parse("linear+coulomb_friction").with_effect("stribeck_friction", values)
        held = fit(model.with_values({"linear.gain_deg_s_per_pct": 10.6}), records, windows=True, max_iterations=0)
        said = at_a_bound(held, "stribeck_friction")
        assert said is None if why is None else why in str(said), (speed, said)
    assert np.isfinite(held.cost)
