"""What is left of a model is a random torque where it follows nothing but itself."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fiohost.discover.logs.whitened import drawing
from fiohost.estimation.fit import fit_from_scratch
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.judging import followed
from fiohost.judging.followed import ruled
from fiohost.judging.levels import levels_of
from fiohost.judging.metrics import Judgement, judge
from fiohost.judging.missing_torque import missing_torque
from fiohost.judging.replica import Replicas
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise, Ranged

QUANTUM, STEP_S, SECONDS = 0.5, 0.005, 30.0
SLOW = Noise(Ranged(0.0, 0.0, 0.0), Ranged(0.3, 0.3, 0.3), Ranged(1.0, 1.0, 1.0))
TRUTH = Model((), {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08}).with_effect(
    "coulomb_friction", {"level_pct": 3.0}
)
START = Start(0.0, 0.0)


def made(truth: Model) -> list[Record]:
    """Three runs of levels, a random torque in them, one after the other by the bench's clock."""
    found = []
    for run in range(3):
        rng = np.random.default_rng(run)
        times = np.arange(round(SECONDS / STEP_S)) * STEP_S
        duty = np.repeat(rng.choice([-60.0, -30.0, 25.0, 45.0, 70.0], 30), 200)
        bare = make_record(f"run {run}", times, duty, np.zeros(len(times)), quantum=QUANTUM, at_rest=True)
        bare = make_record(
            f"run {run}", times, duty, free_output(bare, Flat.of(truth), START), quantum=QUANTUM, at_rest=True
        )
        (loaded,) = drawing([bare], SLOW)
        y = Replicas(loaded, truth, START).draw(rng)
        found.append(make_record(f"run {run}", times, duty, y, quantum=QUANTUM, at_rest=True))
    return found


@pytest.mark.parametrize(
    ("effect", "values", "ruling"),
    [
        ("", {}, ()),
        ("gain_warm_up", {"ratio": 0.06, "time_constant_s": 12.0}, ("gain_drift",)),
        ("friction_warm_up", {"ratio": 0.5, "time_constant_s": 12.0}, ("friction_drift",)),
        (
            "position_dependent_friction",
            {"ratio": 0.3, "order": 2.0, "phase_deg": 20.0},
            ("angle_and_speed_sign",),
        ),
    ],
)
def test_what_drifts_in_each_run_or_follows_the_angle_is_no_random_torque(
    effect: str, values: dict[str, float | str], ruling: tuple[str, ...]
) -> None:
    records = made(TRUTH.with_effect(effect, values) if effect else TRUTH)
    model = fit_from_scratch(TRUTH, records).model
    judged = [model] * len(records)
    drawn = drawing(records, SLOW)
    found = ruled(drawn, judged, [judged] * 16, [START] * 3, np.random.default_rng(0), SLOW, 0.1, 3.137)
    assert set(ruling) <= set(found)
    assert bool(ruling) == bool(found)


def test_what_stands_out_is_held_against_all_that_the_torque_may_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of several figures the one that stands out by chance is the largest: alone it would have one chance in a hundred,
    with all of them it has six.
    """
    records, figures = made(TRUTH.with_effect("gain_warm_up", {"ratio": 0.06, "time_constant_s": 12.0})), []
    model = fit_from_scratch(TRUTH, records).model

    def levels(found: np.ndarray, sigmas: float) -> np.ndarray:
        figures.append(found.shape[1])
        return levels_of(found, sigmas)

    monkeypatch.setattr(followed, "levels_of", levels)
    judged, rng = [model] * len(records), np.random.default_rng(0)
    found = ruled(drawing(records, SLOW), judged, [judged] * 16, [START] * 3, rng, SLOW, 0.1, 3.137)
    assert figures == [6]
    assert 0 < len(found) < 6


@pytest.mark.parametrize("as_a_whole", [False, True])
def test_an_estimate_that_runs_away_says_nothing_of_what_a_random_torque_follows(
    monkeypatch: pytest.MonkeyPatch, as_a_whole: bool
) -> None:
    records = made(TRUTH)
    model = fit_from_scratch(TRUTH, records).model
    lost, judged = TRUTH.with_values({"linear.gain_deg_s_per_pct": 11.0}), [model] * 3

    def torque(record: Record, of: Model, residual: np.ndarray, noise: Noise | None) -> np.ndarray:
        return np.full(len(residual), np.nan) if of is lost else missing_torque(record, of, residual, noise)

    def away(record: Record, of: Model, *rest: Any, **near: Any) -> Judgement:
        found = judge(record, of, *rest, **near)
        return replace(found, simulated=np.full(len(record), np.nan)) if of is lost else found

    monkeypatch.setattr(followed, *(("judge", away) if as_a_whole else ("missing_torque", torque)))
    estimates = [*([judged] * 15), [lost] * 3]
    rng = np.random.default_rng(0)
    assert ruled(drawing(records, SLOW), judged, estimates, [START] * 3, rng, SLOW, 0.0, 3.137) == ()
    assert ruled(drawing(records, SLOW), judged, [[lost] * 3] * 8, [START] * 3, rng, SLOW, 0.0, 3.137) == ()
