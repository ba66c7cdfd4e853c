"""Real measurements beyond angles at 4 ms: mean speeds of a gear motor at 20 ms, positions of a linear axis at 1 kHz.

Pieces of the records and a part of the library; the whole is ``benchmarks/measured.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fiohost.circle.evidence import diagnose
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.estimation.record import ANGLE, MEAN_SPEED
from fiohost.importing.convert import log_from_table
from fiohost.importing.map import TableMap

GEARMOTOR = "brake_pwm_gearmotor"
GEAR_LIBRARY = ("coulomb_friction", "transport_delay", "armature_inductance", "duty_curve", "current_limit")
AXIS_LIBRARY = ("constant_load", "asymmetric_coulomb_friction", "direction_dependent_gain")
GEAR_SECONDS, AXIS_SECONDS = 12.0, 6.3


def piece(source: Path, target: Path, rows: slice) -> Path:
    """Some rows of a table under its head line."""
    head, *lines = source.read_text().splitlines(keepends=True)
    target.write_text(head + "".join(lines[rows]))
    return target


@pytest.fixture(scope="module")
def days(measured_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """The first seconds of the open-loop record of every day."""
    folder, rows = tmp_path_factory.mktemp("gear"), slice(0, round(GEAR_SECONDS / 0.02))
    source = measured_data / "measured" / GEARMOTOR
    names = {day: f"prbs_open_exp_2026-{day}.csv" for day in ("08-11", "08-14", "08-17")}
    return {day: piece(source / name, folder / name, rows) for day, name in names.items()}


def one_way(days: dict[str, Path], fitted: str, judged: str) -> Diagnosis:
    return diagnose([days[fitted]], [days[judged]], "linear", table_map=GEARMOTOR, library=GEAR_LIBRARY)


@pytest.fixture(scope="module")
def later(days: dict[str, Path]) -> Diagnosis:
    return one_way(days, "08-14", "08-17")


@pytest.fixture(scope="module")
def axis(measured_data: Path, tmp_path_factory: pytest.TempPathFactory) -> Diagnosis:
    """The linear axis, symmetric friction declared: its first way there and back is fitted, the next one judged."""
    source, folder = measured_data / "measured" / "emps" / "train.csv", tmp_path_factory.mktemp("emps")
    rows = round(AXIS_SECONDS / 0.001)
    first = piece(source, folder / "first.csv", slice(0, rows))
    second = piece(source, folder / "second.csv", slice(rows, 2 * rows))
    return diagnose([first], [second], "linear+coulomb_friction", table_map="emps", library=AXIS_LIBRARY)


@pytest.mark.long("gear")
def test_a_speed_log_stays_a_mean_speed_of_its_own_sample_time(later: Diagnosis) -> None:
    (record,) = later.train
    assert (record.kind, record.unit, record.sample_time_s) == (MEAN_SPEED, "deg/s", pytest.approx(0.02))
    assert np.allclose(np.rint(record.y / record.quantum), record.y / record.quantum, atol=1e-3)


@pytest.mark.long("gear")
def test_the_floor_of_a_mean_speed_is_that_of_two_readings(later: Diagnosis) -> None:
    quantum = later.train[0].quantum
    floor = to_json(later)["floor"]["train"]["free_run_rms"]
    assert floor == pytest.approx(quantum / np.sqrt(6.0), rel=0.15)


@pytest.mark.long("gear")
def test_the_later_firmware_shows_as_a_delay_and_the_earlier_as_none(later: Diagnosis, days: dict[str, Path]) -> None:
    told, earlier = to_json(later), to_json(one_way(days, "08-11", "08-14"))
    assert sorted(s["effect"] for s in told["steps"]) == ["coulomb_friction", "transport_delay"]
    delay = told["final"]["parameters"]["transport_delay.delay_s"]
    assert 0.004 < delay["value"] < 0.02, delay
    assert told["after"]["holdout"]["window_rms"] < 0.6 * told["before"]["holdout"]["window_rms"]
    names = {s["effect"] for s in earlier["steps"]}
    assert "coulomb_friction" in names
    assert "transport_delay" not in names


def test_the_closed_loop_record_with_angles_has_a_map_of_its_own(measured_data: Path) -> None:
    table = measured_data / "measured" / GEARMOTOR / "step_closed_exp_2026-08-17.csv"
    log = log_from_table(table, TableMap.load("brake_pwm_gearmotor_angle"))
    assert (log.output_name, log.output_unit) == ("angle_deg", "deg")
    assert log.output[-1] == pytest.approx(100.0, abs=2.0)


@pytest.mark.long("axis")
def test_the_axis_is_told_in_metres(axis: Diagnosis) -> None:
    told: dict[str, Any] = to_json(axis)
    (record,) = axis.train
    assert (record.kind, record.rotary, record.sample_time_s) == (ANGLE, False, pytest.approx(0.001))
    assert told["output_unit"] == "m"
    assert told["final"]["parameters"]["linear.gain_deg_s_per_pct"]["unit"] == "m/s per %"


@pytest.mark.long("axis")
def test_the_axis_lacks_a_force_that_acts_one_way_and_more_remains(axis: Diagnosis) -> None:
    told = to_json(axis)
    one_way = {
        "constant_load",
        "asymmetric_coulomb_friction",
        "direction_dependent_gain",
        "viscous_friction_by_direction",
    }
    assert one_way & {name for s in told["steps"] for name in (s["effect"], *s["indistinguishable_from"])}
    assert told["verdict"] == "unexplained"
    assert told["after"]["holdout"]["free_run_rms"] < 0.5 * told["before"]["holdout"]["free_run_rms"]
    assert told["after"]["holdout"]["window_rms"] < 1.2e-3
