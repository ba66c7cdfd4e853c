"""The position labs: what cannot be met is said and the rest is kept; the text's rows stand where they belong."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from scipy.integrate import solve_ivp

from fiohost.bench.connect import connect
from fiohost.circle.readings import read_readings
from fiohost.cli.main import cli
from fiohost.control.metrics import step_figures
from fiohost.labs.constants import TEXT
from fiohost.labs.design_project import Task, tuned
from fiohost.labs.pi_design import design_pi
from fiohost.labs.play import Limits
from fiohost.labs.position_control import PositionPlan, position_control
from fiohost.labs.printed import position_rows, printed
from fiohost.labs.session import SATURATION, Gains, Session, position
from fiohost.settings import config_names, find_config


def test_a_pi_that_does_not_exist_is_a_sentence_and_the_rest_is_kept(tmp_path: Path) -> None:
    """The arm has no PI for 30 % and 0.1 s: its proportional loop alone overshoots by as much at 0.1013 s."""
    arguments = ["lab", "position-control", "--constants", "arm_measured", "--target", "sim:nxt_arm_measured"]
    arguments += ["--no-diagnose", "--gains", "2", "--integrals", "3", "--json", "-", "--report", str(tmp_path)]
    answer = CliRunner().invoke(cli, arguments)
    assert answer.exit_code == 0, answer.stderr
    said = json.loads(answer.stdout)
    (table,) = (t for t in said["tables"] if t["title"] == "The PI design")
    assert table["rows"][0][0].startswith("no PI gives 30 % and 0.1 s")
    answers = {a["question"][:8]: a["answer"] for a in said["answers"]}
    assert "no PI gives 30 %" in answers["Step 21."]
    assert "no PI gives 30 %" in answers["Step 25."]
    assert said["values"]["pi"]["met"] is False
    assert len(list(tmp_path.glob("*.csv"))) == 4  # one P, three with the disturbance
    assert len(said["values"]["proportional"]) == 1


def test_a_design_that_exists_is_met_to_half_a_percent() -> None:
    assert not design_pi(TEXT["arm_measured"], 30.0, 0.1, SATURATION["both"]).met
    found = design_pi(TEXT["arm_tuned"], 30.0, 0.1, SATURATION["both"])
    assert found.met
    assert (found.overshoot_pct, found.rise_s) == pytest.approx((30.0, 0.1), rel=0.005)


# ---- the text's rows -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("constants", "limit_V", "kp", "who"),
    [
        ("no_load", 4.5, 5.0, ["text D-7, simulated", "text D-7, measured"]),
        ("no_load", 2.25, 5.0, []),
        ("no_load", 4.5, 3.0, []),
        ("arm_measured", 4.5, 5.0, []),
        ("arm_measured", 2.25, 3.0, ["text D-9, measured"]),
        ("arm_tuned", 2.25, 3.0, ["text D-9, simulated", "text D-9, measured"]),
        ("elevator", 2.25, 3.0, []),
    ],
)
def test_a_row_of_the_text_stands_beside_its_own_motor_only(
    constants: str, limit_V: float, kp: float, who: list[str]
) -> None:
    assert [row.who for row in position_rows(TEXT[constants], limit_V, 160.0, kp)] == who
    assert position_rows(TEXT[constants], limit_V, 90.0, kp) == ()
    heavier = TEXT[constants].with_inertia(0.004)
    assert position_rows(heavier, limit_V, 160.0, kp) == ()


def test_the_printed_tables_are_shipped_as_readings_that_the_tables_lab_reads() -> None:
    assert config_names("readings") == ["nxt_d13", "nxt_d14", "nxt_d15", "nxt_d7", "nxt_d9"]
    rows = {"nxt_d7": 3, "nxt_d9": 3, "nxt_d13": 3, "nxt_d14": 3, "nxt_d15": 3}
    for name, count in rows.items():
        table, _ = read_readings(find_config("readings", name))
        assert len(table.rows) == count
    (row,) = (r for r in printed("nxt_d13") if r.has(kp=3) and r.source == "simulated")
    assert (row.table, row.overshoot_pct, row.settling_5_s, row.rise_s, row.error) == ("D-12", 9.5, 0.52, 0.23, 0.07)


# ---- limits --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["half", "none", "current"])
def test_a_limit_holds_for_model_and_target_alike(name: str, tmp_path: Path) -> None:
    with Session.open("sim:nxt_arm_tuned", "arm_tuned", tmp_path, seed=1, saturation=name) as session:
        law = position(Gains(5.0), 160.0)
        model, target = session.model(law, 1.0), session.on_target("arm", law, 1.0)
    top = 2.25 if name == "half" else 4.5
    assert np.max(np.abs(model.volts)) == pytest.approx(top)
    assert np.max(np.abs(target.volts)) == pytest.approx(top, rel=1e-3)
    assert np.max(np.abs(model.angle_deg - target.angle_deg)) < 3.0


def test_a_target_whose_current_nothing_limits_has_a_model_without_that_limit(tmp_path: Path) -> None:
    with connect("sim:sealed", seed=1) as bench:
        session = Session(TEXT["no_load"], bench, tmp_path, SATURATION["both"])
        assert session.bench_limits == Limits(4.5, None)
    with connect("sim:nxt_no_load", seed=1) as bench:
        assert Session(TEXT["no_load"], bench, tmp_path, SATURATION["both"]).bench_limits == Limits(4.5, 1.0)


# ---- both ways alike -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [90.0, 37.0])
def test_a_plant_that_is_the_same_both_ways_gets_the_same_design_both_ways(angle: float, tmp_path: Path) -> None:
    with Session.open("sim:nxt_arm_measured", "arm_measured", tmp_path, seed=1) as session:
        assert tuned(session, Task(angle_deg=angle)) == tuned(session, Task(angle_deg=-angle))


def test_step_19_follows_the_loop_until_it_has_settled(tmp_path: Path) -> None:
    """Four times the inertia of the arm under Kp 2, Ki 3 with 4.5 V and 1 A: 9.36 s by another solver."""
    q = TEXT["arm_measured"].with_inertia(4.0 * TEXT["arm_measured"].J_kgm2)

    def rates(t: float, x: np.ndarray) -> list[float]:
        amps, speed, angle, gathered = x
        wanted = 2.0 * (np.radians(160.0) - angle) + gathered
        volts = min(max(wanted, -4.5), 4.5)
        torque = q.Kt_Nm_per_A * min(max(amps, -1.0), 1.0)
        back = (volts - wanted) / (2.0 / 3.0)  # what the limit cuts is given back within Kp/Ki
        return [(volts - q.R_ohm * amps - q.Ke_Vs_per_rad * speed) / q.L_H, (torque - q.B_Nms * speed) / q.J_kgm2,
                speed, 3.0 * (np.radians(160.0) - angle) + back]  # fmt: skip

    times = np.arange(0.0, 32.0, 0.002)
    found = solve_ivp(rates, (0.0, 32.0), [0.0] * 4, "LSODA", times, rtol=1e-7, atol=1e-9, max_step=0.01)
    exact = step_figures(times, np.degrees(found.y[2]), 0.0, 160.0)
    with Session.open("sim:nxt_arm_measured", "arm_measured", tmp_path, seed=1) as session:
        plan = PositionPlan(gains=(2.0,), integrals=(3.0,), torque=None)
        result = position_control(session, plan)
    (table,) = (t for t in result.tables if t.title.startswith("Inertia under PI"))
    last = [float(str(cell)) for cell in table.rows[-1]]
    assert last[2] == pytest.approx(exact.overshoot_pct, abs=0.5)
    assert last[4] == pytest.approx(exact.settling_5_s, abs=0.05)
    assert abs(last[5]) < 0.1
    assert last[6] >= 16.0


@pytest.mark.parametrize(
    ("more", "target"), [([], "sim:nxt_lego_arm"), (["--target", "sim:nxt_arm_tuned"], "sim:nxt_arm_tuned")]
)
def test_constants_of_the_arm_stand_beside_the_arm_unless_another_bench_is_named(
    more: list[str], target: str, tmp_path: Path
) -> None:
    asked = ["lab", "open-loop-step", "--volts", "2", "--disturbance", "0", "--constants", "arm_tuned", "--no-diagnose"]
    done = CliRunner().invoke(cli, [*asked, *more, "--report", str(tmp_path / "lab"), "--json", "-"])
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["target"] == target
