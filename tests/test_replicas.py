"""Replicas: what a model would be fitted to, had it been true."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, suite, truth_model

from fiohost.estimation.fit import Fit, fit
from fiohost.judging import floor
from fiohost.judging.floor import Refits
from fiohost.judging.metrics import Judgement, judge
from fiohost.judging.settings import FLOOR
from fiohost.judging.stage import judged
from fiohost.judging.verdict import open_still
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start


def along(fitted: Fit) -> Callable[[Model], list[np.ndarray]]:
    """What models leave of records that are linear in their parameters."""
    centre = np.array([fitted.model.number(n) for n in fitted.names])

    def left(model: Model) -> list[np.ndarray]:
        moved = np.array([model.number(n) for n in fitted.names]) - centre
        return [r - c @ moved for r, c in zip(fitted.residuals, fitted.jacobians, strict=True)]

    return left


def test_what_is_at_its_bound_stays_there_in_what_a_replica_would_be_fitted_to() -> None:
    """Its derivative there is next to nothing; one step by it would go to the other end."""
    values = {"gap_deg": 3.0, "side": "encoder_after_gap", "load_inertia_ratio": 0.0}
    model = Model((), {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08}).with_effect("backlash", values)
    names = ("linear.gain_deg_s_per_pct", "backlash.gap_deg", "backlash.load_inertia_ratio")
    columns = np.random.default_rng(1).standard_normal((400, 3)) * [1.0, 1.0, 1e-3]
    noise = 0.1 * columns[:, 0] + 0.05 * columns[:, 1] + 0.5 * columns[:, 2]
    none = np.empty((400, 0))
    fitted = Fit(model, names, 1.0, (noise,), (columns,), (none,), (Start(0.0, 0.0),), True, 400.0)
    again = Refits(fitted, along(fitted)).model([noise])
    assert again.number("backlash.load_inertia_ratio") == 0.0
    assert again.number("linear.gain_deg_s_per_pct") == pytest.approx(10.1, abs=1e-3)
    assert again.number("backlash.gap_deg") == pytest.approx(3.05, abs=1e-3)


def test_a_level_that_no_reading_hangs_on_stays_in_what_a_replica_would_be_fitted_to() -> None:
    """Between two levels that a shaft was driven at any break-away does: its derivative is rounding. One step by it led
    to either end, so that a true model's own data erred by ten times what the real ones did, and it was not believed.
    """
    values = {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08, "coulomb_friction.level_pct": 3.0}
    model = Model(("coulomb_friction",), values).with_effect("static_friction", {"extra_pct": 3.4})
    names = ("linear.gain_deg_s_per_pct", "static_friction.extra_pct")
    columns = np.random.default_rng(2).standard_normal((400, 2)) * [1.0, 1e-11]
    noise = 0.1 * columns[:, 0] + np.random.default_rng(3).standard_normal(400)
    fitted = Fit(model, names, 1.0, (noise,), (columns,), (np.empty((400, 0)),), (Start(0.0, 0.0),), True, 400.0)
    again = Refits(fitted, along(fitted)).model([noise])
    assert again.number("static_friction.extra_pct") == 3.4
    assert again.number("linear.gain_deg_s_per_pct") == pytest.approx(10.1, abs=0.1)


def test_a_step_to_what_a_replica_would_be_fitted_to_is_halved_while_it_does_not_pay() -> None:
    """Where a shaft rests in one valley or the next a derivative says nothing: models one whole step away erred by a
    hundred times what their own data do, so that nothing stood above such a floor and anything was an explanation.
    """
    model = Model((), {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08})
    columns = np.random.default_rng(4).standard_normal((400, 1))
    noise, none = 0.8 * columns[:, 0], np.empty((400, 0))
    names = ("linear.gain_deg_s_per_pct",)
    fitted = Fit(model, names, 1.0, (noise,), (columns,), (none,), (Start(0.0, 0.0),), True, 400.0)
    straight = along(fitted)

    def beyond(edge: float) -> Callable[[Model], list[np.ndarray]]:
        """As if the shaft came to rest elsewhere with a gain that is more than so much larger."""
        return lambda m: [left + 50.0 * (m.number(names[0]) > 10.0 + edge) for left in straight(m)]

    gains = [Refits(fitted, beyond(edge)).model([noise]).number(names[0]) for edge in (1.0, 0.5, 0.3, 0.1)]
    assert gains == pytest.approx([10.8, 10.4, 10.2, 10.0])


def test_bootstrap_samples_are_drawn_of_each_record_until_they_can_say_no_more() -> None:
    """Those of records that stand well among theirs were drawn as often as those of the one that does not."""
    truth, rng = truth_model(), np.random.default_rng(5)
    records = suite(truth, 5)
    swing = 0.1 * QUANTUM_DEG * np.sin(np.arange(len(records[1])) / 7.0)
    records[1] = replace(records[1], y=records[1].y + swing)
    stage = judged(fit(truth, records), records, records, rng)
    drawn = {r.name: len(f.draws) for r, f in zip(records, stage.floors, strict=True)}
    assert drawn.pop(records[1].name) > FLOOR.replicas
    assert min(drawn.values()) == FLOOR.some
    assert all(drawn[name] > FLOOR.some for name in open_still(stage.excesses) if name in drawn)


def test_one_draw_of_many_that_errs_far_does_not_raise_the_floor(monkeypatch: pytest.MonkeyPatch) -> None:
    """A linear axis that stuck in one of 32 draws had a floor twice as high as its error."""
    truth, rng = truth_model(), np.random.default_rng(5)
    record = suite(truth, 5)[0]
    judgement, count = judge(record, truth), 32

    def far(*args: object, **kwargs: object) -> Judgement:
        far.calls += 1  # type: ignore[attr-defined]
        errors = replace(judgement.errors, window_rms=100.0, free_run_rms=100.0)
        return replace(judgement, errors=errors) if far.calls == 7 else judgement  # type: ignore[attr-defined]

    far.calls = 0  # type: ignore[attr-defined]
    monkeypatch.setattr(floor, "judge", far)
    found = floor.replica_floor(record, truth, judgement, [truth] * count, rng)
    assert len(found.draws) == count
    assert found.errors == judgement.errors
