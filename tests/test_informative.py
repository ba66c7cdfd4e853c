"""Logs that cannot show an effect say so, each with its reason."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_data import measure, multisine, truth_model
from short_runs import SUITE, closed_loop, logs_of

from fiohost.bench.experiment import Experiment
from fiohost.bench.signals import Staircase
from fiohost.checks.informative import Informative, inform
from fiohost.checks.said import Said, said_by
from fiohost.estimation.record import record_from_log

UP = Experiment("up", (Staircase(duration_s=10.0, levels=tuple(10.0 * k for k in range(10)), step_s=1.0),))


def informed(folder: Path, *experiments: Experiment) -> Informative:
    logs = logs_of("sim", folder, experiments)
    return inform([record_from_log(log) for log in logs], [said_by(log) for log in logs])


def hidden(found: Informative) -> dict[str, str]:
    """Effects that cannot be shown, with the reason."""
    return {name: limit.why for limit in found.limits if not limit.apart for name in limit.effects}


def apart(found: Informative) -> list[set[str]]:
    return [set(limit.effects) for limit in found.limits if limit.apart]


def test_a_closed_loop_square_wave_alone_hides_lags_and_what_takes_a_turn(tmp_path: Path) -> None:
    found = informed(tmp_path, closed_loop(12.0))
    assert found.exercised.closed_loop_only
    assert found.exercised.reversals >= 3
    assert {"gravity_load", "supply_drift"} <= set(hidden(found))
    assert "turns are covered" in hidden(found)["gravity_load"]
    assert "backlash" not in hidden(found)
    assert {"transport_delay", "armature_inductance", "shaft_compliance"} in apart(found)


def test_a_staircase_up_shows_neither_play_nor_break_away_nor_direction(tmp_path: Path) -> None:
    found = informed(tmp_path, UP)
    seen = found.exercised
    assert (seen.reversals, seen.starts, seen.both_directions, seen.closed_loop_only) == (0, 1, False, False)
    assert hidden(found)["backlash"].startswith("no reversals")
    assert hidden(found)["static_friction"].startswith("1 start from standstill")
    assert "one direction only" in hidden(found)["direction_dependent_gain"]
    assert {"pwm_resolution", "duty_steps"} <= set(hidden(found))
    assert "gravity_load" not in hidden(found)
    assert {"quadratic_drag", "duty_curve", "voltage_saturation"} in apart(found)
    assert {"coulomb_friction", "input_deadband", "bridge_voltage_drop"} in apart(found)


def test_the_full_suite_can_show_everything(tmp_path: Path) -> None:
    found = informed(tmp_path, *SUITE, closed_loop())
    assert found.limits == ()
    assert found.exercised.levels >= 8
    assert 5.0 < (found.exercised.useful_hz or 0.0) < 60.0


def test_a_limit_that_gentle_commands_meet_is_not_hidden_by_their_size() -> None:
    limited = truth_model(("coulomb_friction", "voltage_saturation"), {"voltage_saturation.limit_pct": 39.0})
    rng = np.random.default_rng(4)
    found = inform([measure(limited, multisine(12.0, rng, 70.0), rng)], [Said()])
    assert found.exercised.duty_max_pct < 75.0
    assert "voltage_saturation" not in hidden(found)


def test_movement_is_counted_as_it_was_made() -> None:
    duty = np.repeat([0.0, 40.0, 0.0, -40.0, 0.0, 60.0, 0.0], 200)
    record = measure(truth_model(), duty, np.random.default_rng(1))
    seen = inform([record], [Said()]).exercised
    assert (seen.starts, seen.reversals) == (3, 2)
    assert seen.standstill_s == pytest.approx(4.0, abs=1.5)
    assert seen.speed_max == pytest.approx(10.6 * (60.0 - 2.7), rel=0.05)
    assert (seen.duty_max_pct, seen.largest_step_pct) == (60.0, 60.0)
    assert seen.turns == pytest.approx(float(np.ptp(record.y)) / 360.0)


def test_a_declared_effect_is_not_among_those_that_cannot_be_shown() -> None:
    record = measure(truth_model(), np.full(800, 30.0), np.random.default_rng(2))
    assert "backlash" in hidden(inform([record], [Said()]))
    assert "backlash" not in hidden(inform([record], [Said()], ["backlash"]))


@pytest.mark.parametrize("counts_rms", [1.0, 3.0])
def test_what_a_noisy_sensor_shows_is_what_the_shaft_does(tmp_path: Path, counts_rms: float) -> None:
    rng = np.random.default_rng(3)
    exact = [record_from_log(log) for log in logs_of("sim", tmp_path, [*SUITE, closed_loop()])]
    noisy = [replace(r, y=r.y + counts_rms * r.quantum * rng.standard_normal(len(r))) for r in exact]
    noisy = [replace(r, y=np.floor(r.y / r.quantum) * r.quantum) for r in noisy]
    seen, truth = (inform(records, [Said()] * len(exact)).exercised for records in (noisy, exact))
    assert seen.starts >= 0.7 * truth.starts
    assert 0.3 * truth.reversals <= seen.reversals <= 1.2 * truth.reversals
    assert seen.standstill_s > 0.7 * truth.standstill_s
    assert seen.useful_hz is not None
    assert truth.useful_hz is not None
    assert 3.0 < seen.useful_hz < truth.useful_hz
    assert "static_friction" not in hidden(inform(noisy, [Said()] * len(exact)))


def test_an_event_cannot_be_placed_where_logs_do_not_say_when_they_were_begun(tmp_path: Path) -> None:
    logs = logs_of("sim", tmp_path, (*SUITE, closed_loop()))
    records = [record_from_log(log) for log in logs]
    said = [said_by(log) for log in logs]
    assert "parameter_change" not in hidden(inform(records, said))
    unsaid = [replace(r, excitation=replace(r.excitation, clock_s=0.0)) for r in records]
    assert "when they were begun" in hidden(inform(unsaid, said))["parameter_change"]
    # Runs of ten seconds that each begin anew are no half a minute in which a gain may warm up.
    assert "gain_warm_up" in hidden(inform(unsaid, said))
    assert "gain_warm_up" not in hidden(inform(records, said))
    assert "parameter_change" not in hidden(inform(unsaid[:1], said[:1]))  # of one log its own time is enough
