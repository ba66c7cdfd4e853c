"""How warm a motor is: what can be told of it, and what it follows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, TICK_S, measure, truth_model

from fiohost.discover.logs.movement import movement
from fiohost.discover.logs.non_smooth import chosen_again
from fiohost.discover.logs.whitened import with_noise
from fiohost.estimation.bench import with_bench
from fiohost.estimation.fit import fit
from fiohost.estimation.initial import guessed_warmth, initial_state
from fiohost.estimation.intervals import estimates
from fiohost.estimation.predict import Flat, errors, free_output, some_windows
from fiohost.estimation.record import Record, make_record
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import NONE, Ranged

GAIN = "linear.gain_deg_s_per_pct"
WARMING = truth_model(
    ("coulomb_friction", "gain_warm_up"),
    {"gain_warm_up.ratio": -0.1, "gain_warm_up.time_constant_s": 6.0, "gain_warm_up.follows": "time"},
)


WEARING = truth_model(
    ("coulomb_friction", "friction_warm_up"),
    {"friction_warm_up.ratio": 0.35, "friction_warm_up.time_constant_s": 9.0, "friction_warm_up.follows": "running"},
)


def begun(warmths: tuple[float, ...], truth: Model = WARMING) -> list[Record]:
    """Runs of 12 s with rests, one for each warmth at its beginning, some seconds after each other."""
    rng, records = np.random.default_rng(7), []
    for i, warmth in enumerate(warmths):
        levels = np.where(np.arange(12) % 3 == 2, 0.0, rng.uniform(20.0, 70.0, 12) * rng.choice([-1.0, 1.0], 12))
        record = measure(truth, np.repeat(levels, 200), rng, name=f"run {i}")
        record = replace(record, excitation=replace(record.excitation, clock_s=14.0 * i))
        angle = free_output(record, Flat.of(truth), Start(0.1, 0.0, warmth=warmth))
        records.append(replace(record, y=np.floor(angle / QUANTUM_DEG) * QUANTUM_DEG))
    return records


@pytest.mark.parametrize("windows", [False, True])
def test_where_the_bench_s_time_begins_it_is_cold_so_that_gain_and_warming_can_be_told_apart(windows: bool) -> None:
    records = with_bench(begun((0.0, 0.9)))
    assert [r.begins for r in records] == [True, False]
    found = fit(WARMING.with_values({GAIN: 10.2, "gain_warm_up.ratio": -0.05}), records, windows=windows)
    gain = estimates(found)[GAIN]
    assert gain.half_width < 0.02 * gain.value
    assert gain.value == pytest.approx(10.6, rel=0.005)
    assert found.starts[0].warmth == 0.0
    assert found.starts[1].warmth == pytest.approx(0.9, abs=0.05)


def test_how_warm_a_weighed_run_began_is_guessed_from_some_of_its_windows_weighed_like_all() -> None:
    """As they are, they led a drawn bench with missing rows astray."""
    (record,) = begun((0.6,))
    start, flat = Start(0.1, 0.0), Flat.of(WARMING)
    noise = replace(NONE, torque_pct=Ranged(0.5, 0.5, 0.5), torque_s=Ranged(0.3, 0.3, 0.3))
    (weighed,) = with_noise([record], WARMING, noise, [movement(record, WARMING, start)])
    whole, part = (some_windows(weighed, every, flat, start._replace(warmth=0.5), record.y) for every in (1, 3))
    np.testing.assert_allclose(whole, errors(weighed, flat, start._replace(warmth=0.5), True))
    looked = np.repeat(np.isin(record.windows[:-1], replace(record, every=3).looked_at[0]), np.diff(record.windows))
    assert np.linalg.norm(part[looked]) > 0.8 * np.linalg.norm(whole[looked])
    assert np.linalg.norm(part) < 0.8 * np.linalg.norm(whole)
    assert guessed_warmth(weighed, flat, start, record.y) == pytest.approx(0.6, abs=0.15)


def test_how_warm_a_run_with_missing_rows_began_is_seen_in_its_windows() -> None:
    """No free run knows the commands that nobody logged: what it leaves behind them says nothing of warmth."""
    (record,) = begun((0.4,))
    pieces = [np.arange(0, 250), np.arange(550, 850), np.arange(1150, 1450), np.arange(1750, len(record))]
    rows = np.concatenate(pieces)
    cut = make_record(
        record.name,
        record.excitation.times_s[rows],
        record.excitation.duties_pct[1:][rows],
        record.y[rows],
        quantum=QUANTUM_DEG,
        sample_time_s=TICK_S,
        command_delay_s=TICK_S,
        at_rest=True,
        segments=np.repeat(np.arange(4), [len(p) for p in pieces]),
    )
    assert cut.broken
    assert initial_state(cut, Flat.of(WARMING)).warmth == pytest.approx(0.4, abs=0.05)


def test_another_model_begins_as_warm_as_its_windows_say_however_far_that_is() -> None:
    """A replica's model differs in how fast it warms: it may have begun much warmer than the fitted one."""
    (record,) = begun((0.4,))
    flat = Flat.of(WARMING)
    near = initial_state(record, flat)._replace(warmth=0.15)
    assert initial_state(record, flat, near=near).warmth == pytest.approx(0.4, abs=0.03)


def test_a_warmth_that_windows_took_for_that_of_running_follows_time_in_whole_runs() -> None:
    records = with_bench(begun((0.0, 0.9)))
    wrong = fit(WARMING.with_values({"gain_warm_up.follows": "running"}), records)
    right = chosen_again(wrong, records)
    assert right.model.values["gain_warm_up.follows"] == "time"
    assert right.rms < 0.2 < 0.5 * wrong.rms


@pytest.mark.parametrize("trial", range(6))
def test_a_warmth_that_may_not_go_as_far_as_it_would_does_not_hold_the_rest_back(trial: int) -> None:
    """From where all runs seem cold: the parameters went as if the warmth went all the way at once, so that no step
    paid, and friction that falls was told as friction that differs from run to run.
    """
    records = with_bench(begun((0.0, 0.65, 0.85), WEARING))
    rough = fit(truth_model(), records, windows=True)
    added = rough.model.with_effect("friction_warm_up", effect("friction_warm_up").trials[trial])
    found = fit(added, records, windows=True, starts=rough.starts, max_iterations=1, tolerance=1e-2)
    for steps, tolerance in ((4, 1e-2), (25, 1e-4), (25, 1e-6)):
        found = fit(found.model, records, windows=True, starts=found.starts, max_iterations=steps, tolerance=tolerance)
    follows = {"friction_warm_up.follows": found.model.values["friction_warm_up.follows"]}
    assert found.cost < 1.05 * fit(WEARING.with_values(follows), records, windows=True).cost
