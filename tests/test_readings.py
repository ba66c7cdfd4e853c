"""Tables of figures instead of logs: the same effects are found in them, and what they cannot tell is said."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from short_runs import logs_of, plant_file

from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.signals import Constant
from fiohost.circle.readings import diagnose_readings, read_readings
from fiohost.cli.main import cli
from fiohost.control.closed_loop import Plant
from fiohost.control.metrics import step_figures
from fiohost.discover.tables.diagnose import diagnose_tables
from fiohost.discover.tables.fit import Rows, fit_tables
from fiohost.discover.tables.responses import Responses
from fiohost.discover.tables.starts import fit_declared
from fiohost.discover.tables.steady import operate
from fiohost.discover.tables.table import Row
from fiohost.motor.model import Model

SOME = ["voltage_saturation", "constant_load", "quadratic_drag", "duty_curve", "transport_delay"]
RESPONSE = """\
schema = "fiohost.readings/1"
kind = "response"
table = "responses.csv"
[step]
to = 120
duration_s = 1.5
[controller]
kp = "kp"
delay_s = 0.005
[encoder]
quantum_deg = 0.5
[figures.overshoot_pct]
quantum = 0.5
[figures.rise_s]
quantum = 0.005
[figures.settling_5_s]
quantum = 0.01
"""
STATIC = """\
schema = "fiohost.readings/1"
kind = "steady"
table = "curve.csv"
[duty]
value = "duty"
[figures.speed]
quantum = 1.0
"""


def write(folder: Path, text: str, name: str, header: str, rows: Sequence[Sequence[object]]) -> Path:
    """A readings file and its table; gives the file."""
    (folder / name).write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    path = folder / f"{Path(name).stem}.toml"
    path.write_text(text)
    return path


def fiohost(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def rounded(value: float, quantum: float) -> str:
    return f"{round(value / quantum) * quantum:.6g}"


# ---- responses -----------------------------------------------------------------------------------------------------

GAINS = (0.5, 0.8, 1.2, 2.0, 3.0)


@pytest.fixture(scope="module")
def board_table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Figures of responses at five gains, run on a board whose bridge gives no more above 45 % of duty."""
    folder = tmp_path_factory.mktemp("board")
    plant = plant_file(folder, {"coulomb_Nm": 0.004}, {"voltage_saturation": {"limit_pct": 45.0}})
    rows = []
    for kp in GAINS:
        step = Constant(duration_s=1.5, level=120.0)
        experiment = Experiment(f"kp_{kp}", reference=(step,), control=ControlSettings("p", kp))
        (log,) = logs_of(f"sim:{plant}", folder, [experiment], seed=2)
        angle = log.columns["angle_deg"]
        found = step_figures(log.time_s, angle - angle[0], 0.0, 120.0 - angle[0])
        figures = ((found.overshoot_pct, 0.5), (found.rise_s, 0.005), (found.settling_5_s, 0.01))
        rows.append([kp, 120.0 - angle[0], *(rounded(*f) for f in figures)])
    text = RESPONSE.replace("to = 120", 'to = "to"')
    return write(folder, text, "responses.csv", "kp,to,overshoot_pct,rise_s,settling_5_s", rows)


@pytest.mark.long
def test_a_saturation_on_the_board_is_found_in_its_figures(board_table: Path) -> None:
    found = diagnose_readings([board_table], "linear+coulomb_friction", library=SOME).to_json()
    assert found["verdict"] == "explained", found["residual"]
    assert found["steps"][0]["effect"] == "voltage_saturation"
    limit = found["final"]["parameters"]["voltage_saturation.limit_pct"]
    assert limit["value"] == pytest.approx(45.0, rel=0.08)
    assert found["before"]["train"]["left_out_rms"] > 5.0 * found["after"]["train"]["left_out_rms"]
    assert "quadratic_drag" not in found["steps"][0]["indistinguishable_from"]


TRUTH = Model(
    ("coulomb_friction",),
    {"linear.gain_deg_s_per_pct": 10.6, "linear.tau_s": 0.072, "coulomb_friction.level_pct": 2.0},
)


def table_of(truth: Model, folder: Path, seed: int) -> Responses:
    """The figures that a model gives, each rounded at a place of its own."""
    empty = write(
        folder, RESPONSE, "responses.csv", "kp,overshoot_pct,rise_s,settling_5_s", [(k, 0, 0, 0) for k in GAINS]
    )
    table, _ = read_readings(empty)
    assert isinstance(table, Responses)
    rng = np.random.default_rng(seed)
    rows = []
    for i, row in enumerate(table.rows):
        exact = table.predict(Plant.of(truth), i, ())
        rows.append(Row(row.label, {f.name: exact[f.name] + f.quantum * rng.uniform(-0.5, 0.5) for f in table.figures}))
    return Responses(table.name, table.figures, rows, table.responses)


@pytest.mark.parametrize("seed", range(5))
def test_figures_of_a_complete_model_claim_nothing(tmp_path: Path, seed: int) -> None:
    found = diagnose_tables([table_of(TRUTH, tmp_path, seed)], Model.parse("linear+coulomb_friction"), seed=seed)
    assert found.verdict == "no_missing_effect"
    assert found.final.fit.model.number("coulomb_friction.level_pct") == pytest.approx(2.0, abs=0.5)


def test_a_declared_model_is_fitted_past_the_jumps_of_figures(tmp_path: Path) -> None:
    """Downhill from the best of a grid of gains and lags alone it stays at 16 times the floor."""
    numbers = {"linear.gain_deg_s_per_pct": 12.187, "linear.tau_s": 0.104, "coulomb_friction.level_pct": 1.386}
    data = Rows([table_of(TRUTH.with_values(numbers), tmp_path, 0)])
    found = fit_declared(data, Model.parse("linear+coulomb_friction"), keep_start=False)
    assert found.rms < 1.5


@pytest.mark.long
def test_an_effect_is_found_though_the_declared_model_fits_nothing(tmp_path: Path) -> None:
    """Without the saturation the best fit has a gain three times too large and all of the friction there may be."""
    numbers = {"linear.gain_deg_s_per_pct": 11.313, "linear.tau_s": 0.095, "coulomb_friction.level_pct": 2.79}
    truth = TRUTH.with_values(numbers).with_effect("voltage_saturation", {"limit_pct": 31.844})
    found = diagnose_tables([table_of(truth, tmp_path, 0)], Model.parse("linear+coulomb_friction"), library=SOME)
    assert found.verdict == "explained"
    assert [s.effect for s in found.found.steps] == ["voltage_saturation"]
    assert found.final.fit.model.number("voltage_saturation.limit_pct") == pytest.approx(31.844, rel=0.05)


def test_a_trial_that_runs_away_has_no_figures(tmp_path: Path) -> None:
    numbers = {"linear.gain_deg_s_per_pct": 81.03, "linear.tau_s": 1.196, "coulomb_friction.level_pct": 71.85}
    warms = {"ratio": 4.976, "time_constant_s": 1.0732, "follows": "heat"}
    away = TRUTH.with_values(numbers).with_effect("gain_warm_up", warms)
    table = table_of(TRUTH, tmp_path, 0)
    assert any(np.isnan(list(table.predict(Plant.of(away), i, ()).values())).all() for i in range(len(table.rows)))
    assert np.isfinite(fit_tables(Rows([table]), away, evaluations=0).cost)


@pytest.mark.long
def test_a_hidden_gap_is_found_in_figures_and_rivals_that_leave_as_little_are_named(tmp_path: Path) -> None:
    truth = TRUTH.with_effect("backlash", {"gap_deg": 6.0, "load_inertia_ratio": 0.4, "side": "encoder_before_gap"})
    found = diagnose_tables(
        [table_of(truth, tmp_path, 1)], Model.parse("linear+coulomb_friction"), library=["backlash", "supply_sag"]
    )
    assert found.verdict == "explained"
    assert [s.effect for s in found.found.steps] == ["backlash"]


def test_too_few_rows_are_said_to_be_too_few(tmp_path: Path) -> None:
    one = write(tmp_path, RESPONSE, "responses.csv", "kp,overshoot_pct,rise_s,settling_5_s", [(1.2, 11.0, 0.17, 0.5)])
    found = diagnose_readings([one], "linear").to_json()
    assert found["verdict"] == "cannot_be_judged"
    assert "1 row" in found["why"]
    assert not found["steps"]
    known = TRUTH.without(["coulomb_friction"])
    fixed = Model((), known.values, frozenset(known.values))
    assert diagnose_readings([one], fixed).verdict == "cannot_be_judged"  # wrong, but nothing can be chosen from a row
    own = table_of(fixed, tmp_path, 3)
    alone = Responses("one", own.figures, own.rows[:1], own.responses[:1])
    assert diagnose_tables([alone], fixed).verdict == "no_missing_effect"  # nothing to fit, so one row can speak


# ---- steady points -------------------------------------------------------------------------------------------------


def curve(folder: Path, speed: Callable[[float], float], duties: Sequence[float]) -> Path:
    return write(folder, STATIC, "curve.csv", "duty,speed", [(u, rounded(speed(u), 1.0)) for u in duties])


FORWARD = (2, 4, 6, 10, 15, 20, 30, 45, 60, 80)


@pytest.fixture(scope="module")
def static(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Result]:
    """The command on a static curve of a motor that starts at 5 %, with all that can be asked of it."""
    folder = tmp_path_factory.mktemp("static")
    path = curve(folder, lambda u: 10.0 * max(u - 5.0, 0.0), FORWARD)
    outputs = ("--json", folder / "f.json", "--report", folder / "report", "--save-model", folder / "f.toml")
    result = fiohost("diagnose", "--readings", path, "--model", "linear", *outputs)
    assert result.exit_code == 0, result.output
    return folder, result


@pytest.mark.long("static curve")
def test_a_static_curve_cannot_tell_a_deadband_from_friction_and_says_so(static: tuple[Path, Result]) -> None:
    found: dict[str, Any] = json.loads((static[0] / "f.json").read_text())
    assert found["verdict"] == "explained"
    (step,) = found["steps"]
    named = {step["effect"], *step["indistinguishable_from"]}
    assert {"coulomb_friction", "input_deadband", "bridge_voltage_drop", "pwm_dead_time"} <= named
    assert {"voltage_saturation", "duty_curve", "quadratic_drag"}.isdisjoint(named)
    assert found["final"]["parameters"]["linear.tau_s"]["identifiable"] is False
    assert step["parameters"]["level_pct"]["value"] == pytest.approx(5.0, abs=0.1)


@pytest.mark.long
def test_a_bridge_that_coasts_is_seen_in_a_curve_though_its_shape_is_no_size(tmp_path: Path) -> None:
    path = curve(tmp_path, lambda u: 900.0 * max(1.0 - 4.0 / u, 0.0), FORWARD)  # no current once a pulse is over
    found = diagnose_readings([path], "linear+coulomb_friction", library=["coast_pwm", *SOME])
    assert [step.effect for step in found.found.steps] == ["coast_pwm"]
    assert found.final.fit.rms < 0.1 * found.found.declared.fit.rms


def test_a_straight_curve_lacks_nothing(tmp_path: Path) -> None:
    found = diagnose_readings([curve(tmp_path, lambda u: 9.3 * u, FORWARD)], "linear")
    assert found.verdict == "no_missing_effect"


@pytest.mark.parametrize("tau_s", [0.01, 0.08, 1.16])
def test_what_no_figure_shows_is_left_as_it_is_and_holds_no_fit_back(tmp_path: Path, tau_s: float) -> None:
    table, _ = read_readings(curve(tmp_path, lambda u: 9.94 * min(u, 43.4), FORWARD))
    begun = {"linear.gain_deg_s_per_pct": 6.1, "linear.tau_s": tau_s, "voltage_saturation.limit_pct": 60.0}
    found = fit_tables(Rows([table]), Model(("voltage_saturation",), begun), evaluations=8)
    assert found.model.number("linear.tau_s") == tau_s
    assert found.rms < 1.5


def test_one_row_that_is_off_proves_no_effect(tmp_path: Path) -> None:
    """A saturation fits a last row that fell short, but no other row knows of it."""
    path = curve(tmp_path, lambda u: 10.0 * u - (100.0 if u > 70 else 0.0), FORWARD)
    found = diagnose_readings([path], "linear", library=["voltage_saturation"]).to_json()
    (candidate,) = found["candidates"]
    assert candidate["score"] > 0.99
    assert "one row only" in candidate["rejected_because"]
    assert found["verdict"] == "unexplained"
    assert not found["steps"]


CURRENT = """\
schema = "fiohost.readings/1"
kind = "steady"
table = "lifting.csv"
[duty]
value = 50
[torque]
value = "torque_Nm"
[motor]
stall_current_A = 2.0
fit = ["stall_torque_Nm"]
[figures.current]
column = "current_mA"
unit = "mA"
quantum = 1.0
"""


def test_current_against_torque_shows_the_friction_within(tmp_path: Path) -> None:
    torques = np.linspace(0.0, 0.1, 8)
    rows = [(f"{t:.4f}", rounded(1000.0 * t / 0.25 + 41.0, 1.0)) for t in torques]
    path = write(tmp_path, CURRENT, "lifting.csv", "torque_Nm,current_mA", rows)
    some = ["coulomb_friction", "load_dependent_friction", "current_limit", "supply_sag"]
    found = diagnose_readings([path], "linear", library=some).to_json()
    assert found["verdict"] == "explained"
    assert found["steps"][0]["effect"] == "coulomb_friction"
    assert found["steps"][0]["parameters"]["level_pct"]["value"] == pytest.approx(2.05, abs=0.05)
    constant = found["final"]["constants"]["lifting.stall_torque_Nm"]["value"]
    assert constant == pytest.approx(0.25 * 2.0, rel=0.01)


def test_steady_points_are_the_formulas() -> None:
    found = operate(Plant.of(TRUTH), 40.0, 2.0, 1.0)
    assert found.speed_deg_s == pytest.approx(10.6 * 38.0, rel=1e-6)
    assert found.current_pct == pytest.approx(2.0, abs=1e-6)
    stuck = operate(Plant.of(TRUTH), 1.5, 2.0, 1.0)
    assert (stuck.speed_deg_s, stuck.current_pct) == (0.0, 1.5)


# ---- the command ---------------------------------------------------------------------------------------------------


@pytest.mark.long("static curve")
def test_the_command_prints_writes_and_draws(static: tuple[Path, Result]) -> None:
    folder, result = static
    assert "Missing from linear: coulomb friction (these data cannot tell it from" in result.stdout
    found: dict[str, Any] = json.loads((folder / "f.json").read_text())
    assert found["schema"] == "fiohost.diagnosis/1"
    assert found["settings"]["tables"]["looks"] > 0
    assert found["settings"]["search"]["draws"] > 0
    assert found["output_unit"] == "floors"
    assert len(found["rows"]) == len(FORWARD)
    figure = found["rows"][-1]["figures"]["speed"]
    assert figure["after"] == pytest.approx(figure["measured"], abs=1.0)
    assert abs(figure["before"] - figure["measured"]) > 2.0
    assert [p.name for p in (folder / "report").glob("curve_01*.png")]
    assert Model.read(folder / "f.toml").effects == ("coulomb_friction",)


BROKEN: Mapping[str, tuple[Callable[[str], str], str]] = {
    "unknown key": (lambda t: t.replace("[duty]", "[dutty]"), "did you mean 'duty'"),
    "unknown figure": (lambda t: t.replace("figures.speed", "figures.sped"), "did you mean 'speed'"),
    "unknown column": (lambda t: t.replace('"duty"', '"dutyy"'), "did you mean 'duty'"),
    "unknown unit": (lambda t: t + 'unit = "deg/sec"\n', "did you mean 'deg/s'"),
    "no quantum": (lambda t: t.replace("quantum = 1.0", ""), "quantum"),
    "unknown kind": (lambda t: t.replace('"steady"', '"stready"'), "did you mean 'steady'"),
    "no table": (lambda t: t.replace("curve.csv", "absent.csv"), "absent.csv"),
    "no rows left": (lambda t: t + '[only]\nduty = "7"\n', "0 rows"),
    "other schema": (lambda t: t.replace("readings/1", "readings/9"), "fiohost.readings/9"),
    "given and measured": (lambda t: t + '[speed]\nvalue = "speed"\n', "speed is both given and measured"),
    "beyond full scale": (lambda t: t.replace('value = "duty"', "value = 130"), "outside -100..100"),
    "no stall current": (lambda t: t + "[figures.current]\ncolumn = 'speed'\nquantum = 1\n", "stall_current_A"),
}


def refused(result: Result) -> str:
    assert result.exit_code == 1, result.output
    (line,) = result.stderr.strip().splitlines()
    assert line.startswith("fiohost: ")
    assert "inside fiohost" not in line
    return line


@pytest.mark.parametrize("fault", BROKEN)
def test_a_malformed_file_is_refused_in_one_sentence(tmp_path: Path, fault: str) -> None:
    path = curve(tmp_path, lambda u: 10.0 * u, FORWARD)
    change, says = BROKEN[fault]
    path.write_text(change(path.read_text()))
    assert says in refused(fiohost("diagnose", "--readings", path))


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("duty,speed\n10,fast\n20,200\n", "'fast' is not a number"),
        ("duty,speed\n10,\n20,200\n", "none of the figures is there"),
        ("duty,speed\n10\n20,200\n", "1 cells under 2 column names"),
        ("duty,speed,speed\n10,1,1\n", "columns named 'speed'"),
        ("duty,speed\n,100\n20,200\n", "duty is empty"),
        ("duty,speed\n", "at least one row"),
        ("duty,speed\n" + "1,2\n" * 501, "more than 500 rows"),
    ],
)
def test_a_malformed_table_is_refused_in_one_sentence(tmp_path: Path, text: str, says: str) -> None:
    path = curve(tmp_path, lambda u: 10.0 * u, FORWARD)
    (tmp_path / "curve.csv").write_text(text)
    assert says in refused(fiohost("diagnose", "--readings", path))


def test_logs_and_readings_do_not_mix_and_one_of_them_is_needed(tmp_path: Path) -> None:
    path = curve(tmp_path, lambda u: 10.0 * u, FORWARD)
    assert "LOG does not go with --readings" in refused(fiohost("diagnose", "run.csv", "--readings", path))
    assert "--limits" in refused(fiohost("diagnose", "--readings", path, "--limits"))
    assert fiohost("diagnose").exit_code == 2


def test_gains_and_steps_may_be_in_volts_and_in_lengths(tmp_path: Path) -> None:
    """An elevator: 5 cm on a spool of 1.375 cm, 2 V for a radian at a full scale of 4.5 V."""
    text = RESPONSE.replace("to = 120", f"to = 5\nunit = 'cm'\ndeg_per_unit = {math.degrees(1 / 1.375)}")
    text = text.replace('kp = "kp"', 'kp = 2\nunit = "V/rad"\nfull_scale_V = 4.5') + "[figures.final]\nquantum = 0.01\n"
    path = write(tmp_path, text, "responses.csv", "overshoot_pct,rise_s,settling_5_s,final", [(6, 0.2, 0.5, "")])
    table, _ = read_readings(path)
    assert isinstance(table, Responses)
    assert table.responses[0].to_deg == pytest.approx(math.degrees(5 / 1.375))
    assert table.responses[0].loop.kp_pct_per_deg == pytest.approx(2.0 * 100 / 4.5 * math.pi / 180)
    assert "final" not in table.rows[0].measured
    assert table.predict(Plant.of(TRUTH.without(["coulomb_friction"])), 0, ())["final"] == pytest.approx(5.0, abs=0.1)
