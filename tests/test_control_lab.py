"""The control lab's experiments: model and target side by side, and answers that the textbook's formulas confirm."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT
from scipy import signal

from fiohost.bench.connect import connect
from fiohost.bench.log import Log
from fiohost.cli.lab import LABS, lab
from fiohost.cli.labs import control_lab
from fiohost.cli.main import cli
from fiohost.control.metrics import step_figures
from fiohost.errors import ConfigError, DataError
from fiohost.labs.constants import TEXT, MotorConstants
from fiohost.labs.design_project import Task, design_project
from fiohost.labs.open_loop_sine import calculate, model_response, open_loop_sine
from fiohost.labs.open_loop_step import open_loop_step
from fiohost.labs.pi_design import design_pi
from fiohost.labs.play import IDEAL, NO_LIMITS, Limits, Run, Torque, play_model, play_target
from fiohost.labs.position_control import PositionPlan, position_control
from fiohost.labs.result import LabResult
from fiohost.labs.session import Gains, Session, position, volts
from fiohost.labs.speed_control import speed_control
from fiohost.labs.steps import COMMANDS, LAST

Q = TEXT["no_load"]
LIMITS = Limits(4.5, 1.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("lab")


@pytest.fixture(scope="module")
def results(folder: Path) -> dict[str, LabResult]:
    """One short sitting of each experiment on the text's motor."""
    with Session.open("sim:nxt_no_load", "no_load", folder, seed=1) as session:
        plan = PositionPlan(gains=(2.0, 5.0), integrals=(3.0,), torque=Torque(-0.1, 1.5))
        return {
            "step": open_loop_step(session, (2.0, 3.0), Torque(-0.05, 1.0)),
            "sine": open_loop_sine(session, (2.0, 10.0)),
            "speed": speed_control(session, (0.5,), (12.0,), Torque(-0.05, 1.0)),
            "position": position_control(session, plan),
        }


# ---- constants -----------------------------------------------------------------------------------------------------


def test_the_texts_constants_give_the_texts_speed_and_time_constant() -> None:
    """Figs. D-19 and D-25: 7.639 rad/s for 2 V, 0.081 s."""
    assert 2.0 * Q.speed_per_volt == pytest.approx(7.639, abs=0.005)
    assert Q.tau_m_s == pytest.approx(0.081, abs=0.0005)


def test_constants_are_read_as_they_were_written(tmp_path: Path) -> None:
    TEXT["arm_tuned"].write(tmp_path / "arm.toml")
    assert MotorConstants.load(str(tmp_path / "arm.toml")) == TEXT["arm_tuned"]


@pytest.mark.parametrize(
    ("line", "told"),
    [("R_ohms = 2", "did you mean 'R_ohm'"), ("J_kgm2 = -1", "outside"), ("B_Nms = nan", "finite"), ("", "is missing")],
)
def test_constants_that_make_no_motor_are_refused(line: str, told: str, tmp_path: Path) -> None:
    keys = {"Kt_Nm_per_A": 0.25, "Ke_Vs_per_rad": 0.25, "J_kgm2": 1e-3, "R_ohm": 2.0, "supply_V": 4.5}
    given = line.partition(" ")[0]
    text = "\n".join(f"{k} = {v}" for k, v in keys.items() if k != given and (line or k != "R_ohm"))
    (tmp_path / "m.toml").write_text(f"{text}\n{line}\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=told):
        MotorConstants.load(str(tmp_path / "m.toml"))
    with pytest.raises(ConfigError, match="did you mean 'no_load'"):
        MotorConstants.load("noload")


# ---- model and target ----------------------------------------------------------------------------------------------


def both(law_of: object, duration_s: float, limits: Limits, torque: Torque | None = None) -> tuple[Run, Run]:
    with connect("sim:nxt_no_load", seed=1) as bench:
        session = Session(Q, bench, Path(), limits)
        make = law_of  # type: ignore[assignment]
        model = session.model(make, duration_s, torque)  # type: ignore[arg-type]
        law = make(session.way, Q.pct_per_volt)  # type: ignore[operator]
        return model, play_target(bench, law, duration_s, 4.5, limits=limits, torque=torque)


@pytest.mark.parametrize("limits", [LIMITS, Limits(4.5, None)])
def test_the_model_at_the_benchs_ticks_does_what_the_board_does(limits: Limits) -> None:
    """Two simulations that share no code, with limits and a disturbance, in closed loop."""
    model, target = both(position(Gains(5.0), 160.0), 2.0, limits, Torque(-0.1, 1.0))
    assert np.ptp(target.angle_deg) > 160.0
    assert np.max(np.abs(model.angle_deg - target.angle_deg)) < 3.0  # two counts of each, times the loop's gain
    assert model.current_A is not None
    assert target.current_A is not None
    assert np.max(np.abs(target.current_A)) == pytest.approx(np.max(np.abs(model.current_A)), rel=0.03)
    if limits.amperes is not None:
        assert np.max(np.abs(target.current_A)) < limits.amperes + 1e-6


def test_in_open_loop_they_agree_to_two_counts_and_a_few_milliampere() -> None:
    model, target = both(volts(3.0, 1.0), 1.0, Limits(4.5, None))
    assert np.max(np.abs(model.angle_deg - target.angle_deg)) < 1.0  # of 598 degrees
    assert np.max(np.abs(model.current_A - target.current_A)) < 0.03  # type: ignore[operator]
    assert np.max(np.abs(model.speed_rad_s - target.speed_rad_s)[20:]) < 0.35


# ---- open loop -----------------------------------------------------------------------------------------------------


def test_the_step_experiment_finds_the_motor_that_is_there(results: dict[str, LabResult]) -> None:
    values = results["step"].values
    assert values["target_K_rad_s_V"] == pytest.approx([Q.speed_per_volt] * 2, rel=0.003)
    assert values["target_tau_s"] == pytest.approx([Q.tau_m_s] * 2, rel=0.02)
    change = [float(row[3]) for row in table(results["step"], "Disturbance in open loop").rows]  # type: ignore[arg-type]
    assert change == pytest.approx([-0.05 / Q.damping_Nms] * 3, abs=0.03)


def test_dry_friction_shows_as_a_gain_that_grows_with_the_voltage(tmp_path: Path) -> None:
    with Session.open("sim", "no_load", tmp_path, seed=1) as session:
        result = open_loop_step(session, (1.0, 4.0))
    low, high = result.values["target_K_rad_s_V"]
    assert high > 1.1 * low
    assert "no linear model" in next(a.answer for a in result.answers if a.question.startswith("Step 8."))


def test_gain_and_phase_are_those_of_the_transfer_function(results: dict[str, LabResult]) -> None:
    values = results["sine"].values
    for i, omega in enumerate(values["omega_rad_s"]):
        formula = model_response(Q, omega)
        assert values["target_gain_db"][i] == pytest.approx(20.0 * math.log10(abs(formula)), abs=0.05)
        assert values["target_phase_deg"][i] == pytest.approx(math.degrees(np.angle(formula)), abs=0.3)
    assert max(values["large_target_gain_db"]) < values["target_gain_db"][0] - 4.0  # 10 V do not come through


def test_the_calculator_reads_a_log_and_refuses_what_is_not_in_it(results: dict[str, LabResult], folder: Path) -> None:
    log = Log.read(folder / "sine_2V_10rad_s.csv")
    found = calculate(log, 10.0, 4.5)
    assert found.gain == pytest.approx(abs(model_response(Q, 10.0)), rel=0.005)
    with pytest.raises(DataError, match="holds no sine"):
        calculate(log, 47.0, 4.5)
    with pytest.raises(DataError, match="too short"):
        calculate(log, 0.5, 4.5)


# ---- speed and position --------------------------------------------------------------------------------------------


def test_final_speed_under_a_proportional_gain_is_the_formulas(results: dict[str, LabResult]) -> None:
    share = 0.5 * Q.speed_per_volt / (1.0 + 0.5 * Q.speed_per_volt)
    (((target,),), ((model,),)) = (results["speed"].values[f"{who}_final_rad_s"] for who in ("target", "model"))
    assert target == pytest.approx(12.0 * share, rel=0.01)
    assert model == pytest.approx(12.0 * share, rel=0.01)
    rows = table(results["speed"], "Disturbance under speed control").rows
    left = {(str(row[0]), row[1]): float(row[5]) for row in rows}  # type: ignore[arg-type]
    assert abs(left["Kp 0.5, Ki 5", "target"]) < 0.2
    assert left["Kp 0.5", "target"] > 4.0


def test_a_torque_leaves_the_error_that_statics_say_and_an_integral_takes_it_away(
    results: dict[str, LabResult],
) -> None:
    alone, integral, pid = results["position"].values["disturbed"]
    expected = math.degrees(0.1 * Q.R_ohm / (Q.Kt_Nm_per_A * 2.0))
    assert alone["ideal_error_at_end_deg"] == pytest.approx(expected, abs=0.1)
    assert alone["target_error_at_end_deg"] == pytest.approx(expected, abs=0.6)
    assert abs(integral["target_error_at_end_deg"]) < 1.0
    assert abs(pid["target_error_at_end_deg"]) < 1.0


def exact_step(q: MotorConstants, gains: Gains, times: np.ndarray) -> np.ndarray:
    """The position loop's unit step by its transfer function, winding's inductance and all."""
    plant = np.polymul([1.0, 0.0], np.polyadd(
        np.polymul([q.L_H, q.R_ohm], [q.J_kgm2, q.B_Nms]), [q.Kt_Nm_per_A * q.Ke_Vs_per_rad]
    ))  # fmt: skip
    top = np.array([gains.kp, gains.ki]) * q.Kt_Nm_per_A
    bottom = np.polyadd(np.polymul([1.0, 0.0], plant), top)
    return np.asarray(signal.step((top, bottom), T=times)[1])


def test_the_pi_design_has_the_overshoot_and_rise_that_were_asked_for() -> None:
    design = design_pi(Q, 30.0, 0.1, LIMITS)
    times = np.linspace(0.0, 4.0, 8001)
    found = step_figures(times, exact_step(Q, design.gains, times), 0.0, 1.0)
    assert found.overshoot_pct == pytest.approx(30.0, abs=0.5)
    assert found.rise_s == pytest.approx(0.1, abs=0.001)
    for factor in (1.0, 1.2):
        law = position(design.gains, factor * design.largest_deg)(IDEAL, Q.pct_per_volt)
        run = play_model(Q, law, 1.0, IDEAL, limits=NO_LIMITS)
        assert run.current_A is not None
        most = max(np.max(np.abs(run.volts)) / 4.5, np.max(np.abs(run.current_A)) / 1.0)
        assert most == pytest.approx(factor, rel=0.01)
    slow = design_pi(Q, 30.0, 2.0, LIMITS)
    assert not slow.met
    assert slow.why_not.startswith("no PI gives 30 % overshoot and a rise of 2 s")


def test_eq_7_53_is_right_where_nothing_saturates_and_wrong_where_it_does(results: dict[str, LabResult]) -> None:
    rows = {float(r[0]): [float(c) for c in r] for r in table(results["position"], "Overshoot by Eq. 7-53").rows}  # type: ignore[arg-type]
    for kp in (2.0, 5.0):
        assert rows[kp][4] == pytest.approx(rows[kp][3], abs=2.0)
    assert rows[5.0][5] < rows[5.0][3] - 3.0


# ---- the arm, the checklist, the commands --------------------------------------------------------------------------


def test_the_arm_hits_the_cup_and_a_gripper_that_opens_on_the_way_does_not(folder: Path) -> None:
    with Session.open("sim:nxt_arm_measured", "arm_measured", folder, seed=1) as session:
        result = design_project(session, Task(angle_deg=-60.0), Gains(10.0, 0.0, 0.5), animate=True)
    assert result.values["met"] is True
    cases = result.values["cases"]
    assert not cases["text"][1]["in_cup"]
    assert cases["chosen"][1]["total_s"] < cases["text, waits"][1]["total_s"]
    # thrown at 4 rad/s from 0.12 m: a free fall of 0.1 m takes it 70 mm further
    thrown = cases["text"][1]
    assert thrown["miss_m"] == pytest.approx(abs(thrown["speed_rad_s"]) * 0.12 * math.sqrt(0.2 / 9.81), abs=0.005)
    from PIL import Image

    with Image.open(result.files["animation"]) as picture:
        assert getattr(picture, "n_frames", 1) > 40


def test_every_step_of_the_text_has_an_answer_and_a_command_that_exists(results: dict[str, LabResult]) -> None:
    answered = {int(m[1]) for r in results.values() for a in r.answers if (m := re.match(r"Step (\d+)\.", a.question))}
    assert answered == set(COMMANDS) == set(range(1, LAST + 1))
    for text in COMMANDS.values():
        name, *words = text.split()
        command = getattr(control_lab, name.replace("-", "_"))
        assert name in LABS
        known = {option for parameter in command.params for option in parameter.opts}
        assert {word for word in words if word.startswith("--")} <= known


def test_every_experiment_has_its_page() -> None:
    mine = [name for name, (where, _) in LABS.items() if "control_lab" in where or "characterise" in where]
    assert len(mine) == 8
    for name in mine:
        page = ROOT / "docs" / "labs" / f"{name}.md"
        assert f"fiohost lab {name}" in page.read_text(encoding="utf-8")


def test_a_command_prints_draws_and_writes_json(tmp_path: Path) -> None:
    answer = CliRunner().invoke(
        cli,
        [
            "lab",
            "open-loop-step",
            "--volts",
            "2",
            "--disturbance",
            "0",
            "--report",
            str(tmp_path),
            "--json",
            "-",
            "--target",
            "sim:nxt_no_load",
            "--no-diagnose",
        ],
    )
    assert answer.exit_code == 0, answer.stderr
    said = json.loads(answer.stdout)
    assert said["schema"] == "fiohost.lab/1"
    assert said["values"]["target_K_rad_s_V"][0] == pytest.approx(Q.speed_per_volt, rel=0.003)
    assert (tmp_path / "open_loop_step.png").stat().st_size > 10_000
    assert Log.read(tmp_path / "step_plus_2V.csv").output_name == "angle_deg"


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["speed-control", "--saturation", "nome"], "did you mean 'none'"),
        (["speed-control", "--gains", "0.1,much"], "--gains 'much' is not a number"),
        (["position-control", "--pid", "1,2,3,4"], "is not P, or P,I"),
        (["open-loop-step", "--volts", "0"], "a step of nothing"),
        (["design-project", "--angle", "1"], "5 to 90 deg"),
        (["steps", "--only", "30"], "within 1 to 25"),
        (["steps", "--constants", "no_lod"], "did you mean 'no_load'"),
    ],
)
def test_what_makes_no_sense_is_refused_in_a_sentence(arguments: list[str], told: str, tmp_path: Path) -> None:
    answer = CliRunner().invoke(cli, ["lab", *arguments, "--report", str(tmp_path)])
    assert answer.exit_code == 1
    assert told in answer.stderr
    assert "Traceback" not in answer.stderr
    assert lab.name == "lab"


def table(result: LabResult, title: str):  # type: ignore[no-untyped-def]
    return next(t for t in result.tables if t.title.startswith(title))
