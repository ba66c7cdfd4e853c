"""A linear axis: its log and all that is told of it are in metres, whatever it is held in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_data import measure, multisine, steps, truth_model

from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.circle.replay import replay
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.errors import ModelError
from fiohost.estimation.record import record_from_log
from fiohost.judging.units import in_metres
from fiohost.motor.model import Model

QUANTUM_M = 0.5e-3
GAP_M = 2.4e-3
LIBRARY = ("backlash", "constant_load", "quadratic_drag", "transport_delay")


def axis_logs(truth: Model, seed: int) -> list[Log]:
    """What an axis would log whose millimetres are the truth's degrees."""
    rng = np.random.default_rng(seed)
    made = [measure(truth, shape(8.0, rng), rng) for shape in (multisine, steps, multisine, steps)]
    head = {"output_quantum": str(QUANTUM_M), "command_delay_ticks": "1", "sample_time_s": "0.005", "begins": "at rest"}
    return [
        Log.from_columns(
            {"time_s": r.excitation.times_s, "duty_pct": r.excitation.duties_pct[1:], "position_m": r.y / 1000.0},
            head,
            path=f"axis{i}.csv",
        )
        for i, r in enumerate(made)
    ]


@pytest.fixture(scope="module")
def logs() -> list[Log]:
    sizes = {"backlash.gap_deg": 1000.0 * GAP_M, "backlash.load_inertia_ratio": 0.0}
    return axis_logs(truth_model(("coulomb_friction", "backlash"), sizes), 3)


@pytest.fixture(scope="module")
def found(logs: list[Log]) -> Diagnosis:
    return diagnose(logs[:3], logs[3:], "linear+coulomb_friction", library=LIBRARY)


@pytest.fixture(scope="module")
def told(found: Diagnosis) -> dict[str, Any]:
    return to_json(found)


def test_play_of_millimetres_is_found_and_told_in_metres(told: dict[str, Any]) -> None:
    assert [s["effect"] for s in told["steps"]] == ["backlash"]
    gap = told["final"]["parameters"]["backlash.gap_deg"]
    assert gap["unit"] == "m"
    assert gap["value"] == pytest.approx(GAP_M, rel=0.05)
    assert gap["ci95"][0] < GAP_M < gap["ci95"][1]
    gain = told["final"]["parameters"]["linear.gain_deg_s_per_pct"]
    assert (gain["unit"], gain["value"]) == ("m/s per %", pytest.approx(0.0106, rel=0.01))


def test_errors_states_and_speeds_are_in_metres(told: dict[str, Any], logs: list[Log]) -> None:
    assert told["output_unit"] == "m"
    counts = QUANTUM_M / np.sqrt(12.0)
    for errors in (told["after"]["train"], told["after"]["holdout"], told["floor"]["train"], told["logs"][0]["after"]):
        assert errors["window_rms"] == pytest.approx(counts, rel=0.15)
        assert 0.5 * counts < errors["free_run_rms"] < 3.0 * counts
    assert told["semantics"]["floor_window_rms"] == pytest.approx(counts, rel=0.2)
    assert abs(told["logs"][0]["initial"]["angle"] - logs[0].output[0]) < 5.0 * QUANTUM_M
    assert 0.2 < told["data"]["speed_max"] < 1.5


def test_a_saved_model_says_its_unit_and_replays_to_the_same_figures(
    tmp_path: Path, found: Diagnosis, told: dict[str, Any], logs: list[Log]
) -> None:
    path = tmp_path / "axis.toml"
    found.final.fit.model.write(path)
    assert 'unit = "m"' in path.read_text()
    assert Model.read(path).number("backlash.gap_deg") == pytest.approx(1000.0 * GAP_M, rel=0.05)
    held = replay(logs[3], Model.read(path))
    assert (held.output_name, held.unit) == ("position_m", "m")
    assert held.errors.free_run_rms == pytest.approx(told["after"]["holdout"]["free_run_rms"], rel=1e-6)
    assert np.sqrt(np.mean((held.output - logs[3].output) ** 2)) == pytest.approx(held.errors.free_run_rms, rel=1e-6)
    with pytest.raises(ModelError, match="linear axis"):
        Model.read(path).on_axis(rotary=True)


def test_numbers_without_a_unit_are_metres_on_a_linear_axis(tmp_path: Path, logs: list[Log]) -> None:
    path = tmp_path / "plain.toml"
    path.write_text(
        'schema = "fiohost.model/1"\neffects = ["coulomb_friction"]\n[parameters]\n'
        "linear.gain_deg_s_per_pct = 0.0106\nlinear.tau_s = 0.072\ncoulomb_friction.level_pct = 2.7\n"
    )
    model = Model.read(path).on_axis(rotary=False)
    assert model.number("linear.gain_deg_s_per_pct") == pytest.approx(10.6)
    assert (model.number("linear.tau_s"), model.number("coulomb_friction.level_pct")) == (0.072, 2.7)
    assert replay(logs[3], Model.read(path)).errors.window_rms < 3.0 * GAP_M
    assert Model.parse("linear+backlash").on_axis(rotary=False).number("backlash.gap_deg") == 2.0


def test_an_expression_gives_no_start_values_and_a_file_does(tmp_path: Path) -> None:
    assert not Model.parse("linear+coulomb_friction").given
    path = tmp_path / "given.toml"
    Model(("coulomb_friction",), {"linear.tau_s": 0.3}).write(path)
    assert Model.parse(str(path)).given


def test_speeds_of_an_axis_are_held_in_millimetres_too() -> None:
    times = np.arange(100) * 0.01
    columns = {"time_s": times, "duty_pct": 50.0 + 0 * times, "speed_m_s": 0.02 * times}
    record = record_from_log(Log.from_columns(columns, {"output_quantum": "1e-4"}))
    assert (record.unit, record.quantum) == ("mm/s", pytest.approx(0.1))
    assert record.y[-1] == pytest.approx(19.8)


def test_a_figure_that_is_only_named_has_no_length() -> None:
    """As in where a smallest visible effect shows."""
    told = {"shows_in": {"log": "a.csv", "figure": "window_rms"}, "excess": {"figure": "window_rms", "value": 2.0}}
    assert in_metres(told) == {**told, "excess": {"figure": "window_rms", "value": 0.002}}
