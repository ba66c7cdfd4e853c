"""Real measurements: a LEGO NXT motor at constant powers (University of Trento lab course, 2017).

Declared is a linear motor, fitted on 10, 30 .. 90 % power and judged on 15, 35 .. 95 %. The runs do not repeat to the
count: gain and friction differ from run to run. Beside that it lacks dry friction, and its angle errs once a turn.
Here on the first seconds of every other run and with the effects that constant powers can show; the whole runs with
the whole library are ``benchmarks/measured.py``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.cli.main import cli
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.motor.effect import effect

SECONDS = 4.0
FIT = range(10, 101, 20)
JUDGE = range(15, 96, 20)
LIBRARY = ("coulomb_friction", "input_deadband", "constant_load", "transport_delay", "shaft_angle_error")


@pytest.fixture(scope="module")
def imported(measured_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[int, Path]:
    """The first seconds of every run as a log, made by ``fiohost import``; by power in percent."""
    folder = tmp_path_factory.mktemp("nxt")
    made = {}
    for power in (*FIT, *JUDGE):
        table = measured_data / "measured" / "nxt_open_loop" / f"power_{power:03d}.csv"
        lines = table.read_text().splitlines(keepends=True)
        begun = [line for line in lines[1:] if float(line.split(",")[0]) <= SECONDS]
        cut, log = folder / table.name, folder / f"log_{power:03d}.csv"
        cut.write_text(lines[0] + "".join(begun))
        result = CliRunner().invoke(cli, ["import", str(cut), "--map", "nxt_open_loop", "-o", str(log)])
        assert result.exit_code == 0, result.output
        made[power] = log
    return made


@pytest.fixture(scope="module")
def found(imported: dict[int, Path]) -> Diagnosis:
    train, held = [imported[p] for p in FIT], [imported[p] for p in JUDGE]
    return diagnose(train, held, "linear", library=LIBRARY)


@pytest.fixture(scope="module")
def told(found: Diagnosis) -> dict[str, Any]:
    return to_json(found)


def test_the_import_says_what_was_measured_and_how(imported: dict[int, Path]) -> None:
    for power, path in imported.items():
        log = Log.read(path)
        assert np.all(log.duty_pct == power)
        assert log.output_name == "angle_deg"
        assert log.output_quantum == 1.0
        assert log.command_delay_ticks == 0
        assert log.sample_time_s == pytest.approx(0.004, rel=1e-3)
        assert log.dropped == ()


@pytest.mark.long("nxt")
def test_dry_friction_is_found_or_a_name_that_these_data_cannot_tell_from_it(told: dict[str, Any]) -> None:
    assert told["steps"], "nothing was found in measurements of a motor with dry friction"
    names = [n for step in told["steps"] for n in (step["effect"], *step["indistinguishable_from"])]
    assert "coulomb_friction" in names, names  # beside it what swings once a turn, which is there too
    for step in told["steps"]:
        assert effect(step["effect"]).name == step["effect"]
    level = told["final"]["parameters"].get("coulomb_friction.level_pct")
    if level is not None:
        assert 0.5 < level["value"] < 4.0


@pytest.mark.long("nxt")
def test_the_held_out_error_falls_by_much_in_whole_runs_and_in_windows(told: dict[str, Any]) -> None:
    before, after = told["before"]["holdout"], told["after"]["holdout"]
    assert after["free_run_rms"] < 0.65 * before["free_run_rms"]
    assert after["window_rms"] < 0.8 * before["window_rms"]


@pytest.mark.long("nxt")
def test_no_step_is_taken_that_makes_held_out_runs_worse(told: dict[str, Any]) -> None:
    figures = [told["before"]["holdout"]["window_rms"], *(s["after"]["holdout"]["window_rms"] for s in told["steps"])]
    # Models are of the runs' mean, from which each run is off: before friction is named, by a tenth of its gain.
    assert all(after < 1.05 * before for before, after in zip(figures, figures[1:], strict=False))
    assert figures[-1] < 0.7 * figures[0]


@pytest.mark.long("nxt")
def test_the_angle_s_own_error_is_found_beside_it(told: dict[str, Any]) -> None:
    assert "shaft_angle_error" in [s["effect"] for s in told["steps"]]
    assert 0.3 < told["final"]["parameters"]["shaft_angle_error.level_1_deg"]["value"] < 0.7
    assert 0.05 < told["final"]["parameters"]["linear.tau_s"]["value"] < 0.08


@pytest.mark.long("nxt")
def test_what_remains_is_how_runs_differ(told: dict[str, Any]) -> None:
    assert (told["verdict"], told["explained_to"]) == ("explained", "repeatability")
    assert told["residual"]["white"]
    assert told["run_to_run"]
    for candidate in told["candidates"]:
        assert candidate["effect"] in LIBRARY
