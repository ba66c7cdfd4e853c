"""What the texts work out by hand: fine-tuning and its formulas, the elevator from its parts, the wiring."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from click.testing import CliRunner
from places import ROOT

from fiohost.cli.main import cli
from fiohost.errors import ConfigError
from fiohost.labs.characterise import GEAR_RATIO, GEAR_STAGES
from fiohost.labs.constants import TEXT, MotorConstants
from fiohost.labs.elevator.parts import Parts, parts_table
from fiohost.labs.fine_tuning import fine_tuning, second_order
from fiohost.labs.manual import WIRING
from fiohost.labs.session import Session


def test_the_formulas_of_the_second_order_loop_give_what_the_text_prints() -> None:
    """Eqs. D-20 to D-29 at KP = 3; D-25 prints an imaginary part of 9.03, which its own D-23 and D-24 do not give."""
    before, after = second_order(TEXT["arm_measured"], 3.0), second_order(TEXT["arm_tuned"], 3.0)
    assert (before.omega_n_rad_s, before.zeta) == (pytest.approx(10.45, abs=0.015), pytest.approx(0.478, abs=0.001))
    assert (after.omega_n_rad_s, after.zeta) == (pytest.approx(11.0, abs=0.01), pytest.approx(0.503, abs=0.001))
    assert round(after.overshoot_pct) == 16
    assert after.peak_s == pytest.approx(0.33, abs=0.005)
    assert after.rise_s == pytest.approx(0.14, abs=0.005)
    assert after.settling_5_s == pytest.approx(0.58, abs=0.005)


def test_the_inertia_of_the_board_is_found_by_its_position_response(tmp_path: Path) -> None:
    """From table D-8's 0.00302 to the 0.00273 that is in the board, the voltage held within 2.25 V."""
    saved = tmp_path / "arm.toml"
    arguments = [
        "lab",
        "fine-tuning",
        "--target",
        "sim:nxt_arm_tuned",
        "--no-diagnose",
        "--seed",
        "1",
        "--save",
        str(saved),
        "--report",
        str(tmp_path / "lab"),
    ]
    answer = CliRunner().invoke(cli, arguments)
    assert answer.exit_code == 0, answer.stderr
    found = MotorConstants.load(str(saved))
    assert abs(found.J_kgm2 - 0.00273) < 0.00002
    assert found.B_Nms == TEXT["arm_measured"].B_Nms
    assert "text D-9, measured" in answer.stdout
    assert "lacks something else" not in answer.stdout
    assert (tmp_path / "lab" / "fine_tuning.png").stat().st_size > 10_000


def test_where_no_inertia_makes_the_model_follow_the_lab_says_so(tmp_path: Path) -> None:
    """The default arm has dry friction: the best inertia is that of no arm, and leaves degrees."""
    with Session.open("sim:nxt_lego_arm", "arm_measured", tmp_path, seed=1, saturation="half") as session:
        found = fine_tuning(session)
    assert found.values["rms_after_deg"] > 1.0
    (answer,) = (a.answer for a in found.answers if a.question.startswith("Which J "))
    assert "no J does it. The model lacks something else" in answer
    assert found.tables[0].title == "The model with other J"


def test_what_cannot_be_tuned_is_refused(tmp_path: Path) -> None:
    opened = Session.open("sim:nxt_arm_tuned", "arm_measured", tmp_path, seed=1)
    with opened as session, pytest.raises(ConfigError, match="did you mean 'both'"):
        fine_tuning(session, tuned="bot")


def test_the_elevator_from_its_parts_is_the_texts() -> None:
    """Eqs. D-33 to D-35 and section D-2-2: 0.017 N m, 0.0024 kg m2, 0.1113 A, 5.8655 rad/s, 0.0018 N m s."""
    parts = Parts()
    assert parts.load_Nm == pytest.approx(0.017, abs=0.0005)
    assert parts.J_total_kgm2 == pytest.approx(0.0024, abs=0.00005)
    assert parts.current_A(0.017) == pytest.approx(0.1113, abs=5e-5)
    assert parts.speed_rad_s(0.017) == pytest.approx(5.8655, abs=5e-4)
    assert parts.B_Nms(0.017) == pytest.approx(0.0018, abs=0.00005)
    assert [row[1] for row in parts_table().rows] == ["D-34", "D-33, D-35", "line of D-14", "D-12", "D-10"]
    assert Parts(car_kg=0.0).load_Nm == 0.0


def test_the_gears_of_table_d1_make_48() -> None:
    product = 1
    for teeth, ratio in GEAR_STAGES:
        assert teeth[-1] / teeth[0] == ratio  # what turns between the first and the last is an idler
        product *= ratio
    assert product == GEAR_RATIO == 48


def test_the_wiring_is_that_of_table_2_1_and_stands_on_the_page() -> None:
    ports = {row[1]: row[2] for row in WIRING.rows if row[1]}
    assert ports == {"Da1": "C1", "Da2": "C2", "Pa": "C6", "Db1": "C3", "Db2": "C4", "Pb": "C7"}
    page = (ROOT / "docs" / "labs" / "manual.md").read_text(encoding="utf-8")
    for port, pin in ports.items():
        assert re.search(rf"\| {port} \| {pin} \|", page), port
