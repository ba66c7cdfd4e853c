"""What one log costs: whole runs are asked for no more than they can say."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, TICK_S, measure, steps, truth_model

from fiohost.discover.evidence import State
from fiohost.discover.logs import ladder as ladders
from fiohost.discover.logs.ladder import Ladder
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

DRAG = truth_model(("coulomb_friction", "quadratic_drag"), {"quadratic_drag.pct_at_1000_deg_s": 12.0})
LIBRARY = ("quadratic_drag", "gravity_load", "constant_load")


def pushed(seconds: float, torque_pct: float, time_s: float = 0.1) -> Record:
    """Random steps of a motor with drag under a random torque."""
    rng = np.random.default_rng(3)
    duty = steps(seconds, rng)
    push, stays = np.zeros(len(duty)), float(np.exp(-TICK_S / time_s))
    for k in range(1, len(duty)):
        push[k] = stays * push[k - 1] + np.sqrt(1.0 - stays**2) * torque_pct * rng.standard_normal()
    times = np.arange(len(duty)) * TICK_S
    bare = make_record("bare", times, duty + push, np.zeros(len(duty)), quantum=QUANTUM_DEG, at_rest=True)
    angle = np.floor(free_output(bare, Flat.of(DRAG), Start(0.0, 0.0)) / QUANTUM_DEG) * QUANTUM_DEG
    return make_record("pushed", times, duty, angle, quantum=QUANTUM_DEG, at_rest=True)


def climbing(record: Record) -> Ladder:
    model, rng = Model.parse("linear+coulomb_friction"), np.random.default_rng(0)
    return Ladder([record], model, LIBRARY, False, rng, lambda text: None, (), (), 0.0)


def refuse(*args: Any, **more: Any) -> Any:
    raise AssertionError("whole runs are searched")


def test_what_no_effect_leads_near_counts_in_windows_is_not_searched_in_whole_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(ladders, "thorough_fit", refuse)
    assert climbing(pushed(20.0, 3.0))._each_alone() is None


@pytest.mark.parametrize(("seconds", "kept"), [(400.0, ["quadratic_drag"]), (20.0, list(LIBRARY))])
def test_of_a_long_log_only_what_its_beginning_follows_is_fitted_to_all_of_it(seconds: float, kept: list[str]) -> None:
    record = measure(DRAG, steps(seconds, np.random.default_rng(3)), np.random.default_rng(4))
    ladder, found = climbing(record), []
    for name in LIBRARY:
        fitted = fit(ladder.root.state.fit.model.with_effect(name, {}), [record], windows=True, tolerance=1e-4)
        found.append((effect(name), State(fitted, 0.0)))
    assert [of.name for of, _ in ladder._followed_at_first(found)] == kept


@pytest.mark.long
def test_where_a_torque_is_all_that_a_long_log_leaves_no_whole_run_is_searched(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Ladder, "_led", refuse)
    found = climbing(pushed(400.0, 1.0)).climbed()
    assert [s.effect for s in found.steps] == ["quadratic_drag"]
    assert found.noise is not None
    assert found.noise.torque_known
