"""Logs of a counter that says no whole turns: an end of travel is one place on the bench, whatever each log counts."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_data import TICK_S
from short_runs import logs_of, multisine, plant_file, staircase

from fiohost.bench.experiment import Experiment
from fiohost.bench.signals import RandomSteps
from fiohost.circle.replay import replay
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.estimation.bench import on_turns, with_bench
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.record import Record, make_record, record_from_log
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise, Ranged
from fiohost.noise.settings import SETTINGS

REST_S = 0.3
FORWARD = RandomSteps(duration_s=4.0, low=20.0, high=80.0, hold_min_s=0.1, hold_max_s=0.9, seed=5)
RUNS = (Experiment("forward", (FORWARD,)), staircase(0.7), multisine(4.0))


def counted(begin_deg: float, end_deg: float, clock_s: float, *, rests: bool = True) -> Record:
    """Two seconds from one angle of the bench to another, by a counter that begins within a turn."""
    times = np.arange(400) * TICK_S
    share = np.clip(times / (1.0 if rests else times[-1]), 0.0, 1.0)
    angle = begin_deg % 360.0 + share * (end_deg - begin_deg)
    record = make_record(f"at {clock_s} s", times, np.full(400, 20.0), angle, quantum=0.5, clock_s=clock_s)
    return replace(record, wraps=True)


def begins(*records: Record) -> list[float]:
    return [float(r.y[0]) for r in on_turns(records)]


def test_a_log_begins_on_the_turn_on_which_the_one_before_it_ended() -> None:
    below, above = counted(10.0, -15.0, 0.0), counted(-15.0, 1000.0, 2.0 + REST_S)
    after = counted(1000.0, 0.0, 4.0 + 2.0 * REST_S)
    assert float(above.y[0]) == 345.0
    assert begins(below, above, after) == [10.0, -15.0, 1000.0]
    assert begins(after, below, above) == [1000.0, 10.0, -15.0], "in whatever order they are given"


def test_a_shaft_that_still_turned_is_looked_for_ahead() -> None:
    """Left at 500 deg/s and 1000 deg, in 0.3 s it may have gone up to 150 deg: to 1060 and not back to 700."""
    left = counted(0.0, 1000.0, 0.0, rests=False)
    assert begins(left, counted(1060.0, 0.0, 2.0 + REST_S))[1] == 1060.0
    # In two seconds it may have gone more than a turn: nobody knows which.
    assert begins(left, counted(1060.0, 0.0, 4.0))[1] == 340.0


def test_where_nothing_says_how_logs_follow_each_other_they_stay_as_they_are() -> None:
    below, above = counted(10.0, -15.0, 0.0), counted(-15.0, 1000.0, 0.0)
    assert begins(below, above) == [10.0, 345.0], "both begin at once"
    whole = replace(counted(-15.0, 1000.0, 2.3), wraps=False)
    assert begins(below, whole) == [10.0, 345.0], "this one's readings are no count of a turn"


def test_what_was_held_out_moves_no_other_log() -> None:
    first, held, last = counted(0.0, 350.0, 0.0), counted(350.0, 1200.0, 2.3), counted(1200.0, 0.0, 4.6)
    fitted = with_bench([first, last])
    assert [float(r.y[0]) for r in fitted] == [0.0, 480.0]
    (placed,) = on_turns([held], fitted)
    assert float(placed.y[0]) == 350.0


def test_logs_of_a_bench_go_on_from_each_other(tmp_path: Path) -> None:
    logs = logs_of(f"sim:{plant_file(tmp_path, effects={})}", tmp_path, RUNS)
    records = [record_from_log(log) for log in logs]
    assert all(r.wraps and 0.0 <= r.y[0] < 360.0 for r in records)
    placed = on_turns(records)
    assert [float(p.y[0] - r.y[0]) % 360.0 for p, r in zip(placed, records, strict=True)] == [0.0] * len(RUNS)
    gaps = [float(b.y[0] - a.y[-1]) for a, b in zip(placed, placed[1:], strict=False)]
    assert max(abs(g) for g in gaps) < 180.0
    assert max(abs(float(b.y[0] - a.y[-1])) for a, b in zip(records, records[1:], strict=False)) > 360.0


def test_a_log_is_replayed_on_the_turn_on_which_its_shaft_met_an_end(tmp_path: Path) -> None:
    """One of two logs begins two turns on: by its own count the end of travel would be 720 deg further."""
    stop = {"hard_stop": {"angle_rad": float(np.radians(900.0))}}
    logs = logs_of(f"sim:{plant_file(tmp_path, effects=stop)}", tmp_path, RUNS[::2])
    records = [record_from_log(log) for log in logs]
    assert float(max(records[0].y)) == pytest.approx(900.0, abs=0.5)
    assert [r.ahead_deg for r in on_turns(records)] == [0.0, 720.0]
    free = tmp_path / "free"
    free.mkdir()
    logs_without = logs_of(f"sim:{plant_file(free, effects={})}", free, RUNS[1:])
    without = fit_from_scratch(Model.parse("linear+coulomb_friction"), [record_from_log(log) for log in logs_without])
    model = without.model.with_effect("hard_stop", {"angle_deg": 900.25})
    for log, record in zip(logs, records, strict=True):
        found = replay(log, model)
        assert found.errors.free_run_rms < 2.0
        assert found.start.angle == pytest.approx(float(record.y[0]), abs=0.5)
        assert found.output == pytest.approx(record.y, abs=6.0)


@pytest.mark.parametrize(("time_s", "is_noise"), [(0.5, True), (0.9 * SETTINGS.times_s[1], False)])
def test_a_torque_of_which_nothing_says_that_it_comes_back_wanders_on(time_s: float, is_noise: bool) -> None:
    """4 % for half a second is what a bench may have. For as long as windows tell, it is an end of travel that one log
    met and the others did not.
    """
    rng = np.random.default_rng(1)
    times = np.arange(2400) * TICK_S
    duty = np.repeat(rng.choice((-60.0, 40.0, 80.0), 24), 100)
    record = make_record("run", times, duty, np.cumsum(duty) * 0.05, quantum=0.5)
    windows = WeighedWindows([record])
    found = windows.settled(fit(Model.parse("linear"), windows.records, windows=True, max_iterations=2))
    torque = Ranged(4.0, 3.5, 4.7)
    noise = Noise(Ranged(0.06, 0.04, 0.07), torque, Ranged(time_s, 0.9 * time_s, time_s))
    assert windows.no_noise(replace(found, noise=noise)) is not is_noise
    assert not windows.no_noise(replace(found, noise=replace(noise, torque_pct=Ranged(0.5, 0.4, 0.6))))
