"""Teaching: a bench of one's own for every student, worksheets without answers, grades against the seals."""

from __future__ import annotations

import csv
import html
import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

import fiohost
from fiohost.bench.seal import student_seed
from fiohost.cli.main import cli
from fiohost.errors import ConfigError
from fiohost.labs.grade import Grade, all_named, grade, same_effect
from fiohost.labs.questions import QUESTIONS
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.motor.model import Model
from fiohost.report.worksheet import worksheet_page
from fiohost.transport.instruments import break_seal


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def test_a_student_has_the_same_bench_every_time_and_another_student_another() -> None:
    logs = []
    for student in ("anna", "Anna", "ben"):
        with fiohost.connect(f"sim:student:{student}") as bench:
            logs.append(bench.drive(40.0, 2.0))
    assert (logs[0].output == logs[1].output).all()
    assert not (logs[0].output == logs[2].output).all()
    assert "anna" not in str(logs[0].metadata).lower()
    with pytest.raises(ConfigError, match="no student's name"):
        fiohost.connect("sim:student:a/b")
    with pytest.raises(ConfigError, match="leave the seed away"):
        fiohost.connect("sim:student:anna", seed=3)


def test_the_option_stands_for_the_target_and_the_log_gives_nothing_away(tmp_path: Path) -> None:
    log = tmp_path / "run.csv"
    assert call("run", "steps_from_rest", "--student", "anna", "--log", log).exit_code == 0
    text = log.read_text()
    assert "# target: sim:sealed\n" in text
    assert str(student_seed("anna")) not in text
    refused = call("unseal", log)
    assert refused.exit_code == 1
    assert "not kept here" in refused.stderr
    assert "leave --target" in call("run", "steps_from_rest", "--student", "anna", "--target", "hid").stderr


def write(folder: Path, student: str, *, scale: float = 1.0, drop: bool = False) -> Path:
    """A model as the student's bench is, its gain off by a factor, or without its effects."""
    reduced = break_seal(student_seed(student))["reduced"]
    effects = tuple(name for name in reduced if name != "linear" and not (drop and name != "coulomb_friction"))
    values = {f"{e}.{k}": v for e in ("linear", *effects) for k, v in reduced[e].items()}
    values["linear.gain_deg_s_per_pct"] *= scale
    path = folder / f"{student}.toml"
    Model(effects, values).write(path)
    return path


def with_one_effect() -> str:
    """A student whose bench lacks nothing but one effect that a model file can hold."""
    for number in range(200):
        truth = break_seal(student_seed(f"s{number}"))
        extra = [name for name in truth["effects"] if name != "coulomb_friction"]
        if extra == ["gravity_load"]:
            return f"s{number}"
    raise AssertionError


def test_grades_say_what_was_right_and_how_far_off_the_rest_is(tmp_path: Path) -> None:
    student = with_one_effect()
    exact = grade(write(tmp_path, student))
    assert exact.effects_right
    assert exact.errors_pct is not None
    assert max(abs(error) for error in exact.errors_pct.values()) < 1e-6
    off = grade(write(tmp_path, student, scale=1.3) if not (tmp_path / f"{student}.toml").unlink() else tmp_path)
    assert off.errors_pct is not None
    assert off.errors_pct["linear.gain_deg_s_per_pct"] == pytest.approx(30.0)
    assert off.within(10.0) == len(off.errors_pct) - 1
    (tmp_path / f"{student}.toml").unlink()
    assert not grade(write(tmp_path, student, drop=True)).effects_right


def test_the_command_writes_a_table_and_one_broken_file_stops_nobody(tmp_path: Path) -> None:
    folder = tmp_path / "handed_in"
    folder.mkdir()
    student = with_one_effect()
    write(folder, student)
    (folder / "broken.toml").write_text("schema = 1")
    table = tmp_path / "grades.csv"
    result = call("lab", "grade", folder, "-o", table, "--json", "-")
    assert result.exit_code == 0, result.stderr
    rows = list(csv.DictReader(table.open()))
    assert {row["student"]: row["right"] for row in rows} == {"broken": "no", student: "yes"}
    told = {one["student"]: one for one in json.loads(result.stdout)["grades"]}
    assert "schema" in told["broken"]["problem"]
    assert call("lab", "grade", tmp_path / "absent").exit_code == 1
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no model file" in call("lab", "grade", empty).stderr


def test_a_worksheet_has_blanks_and_the_answers_are_in_the_teachers_file_alone(tmp_path: Path) -> None:
    page, answers = tmp_path / "sheet.html", tmp_path / "teacher.json"
    result = call(
        "lab", "manual", "--student", "anna", "--worksheet", page, "--answers", answers, "--report", tmp_path / "lab"
    )
    assert result.exit_code == 0, result.stderr
    told, text = json.loads(answers.read_text()), page.read_text()
    assert told["student"] == "anna"
    assert told["answers"]
    assert text.count('class="blank"') >= 10
    for one in told["answers"]:
        assert one["answer"] not in result.output
        assert one["answer"] not in text
    for number in re.findall(r"[-+]\d+ deg/s|at rest after [^\"<]+ deg", json.dumps(told["tables"])):
        assert number not in text  # what a shaft did is found, in words or not
    found = {f"{cell:.4g}" for t in told["tables"] for row in t["rows"] for cell in row[1:] if isinstance(cell, float)}
    given = {f"{row[i]:.4g}" for t in told["tables"] for row in t["rows"] for i in (0, 3) if isinstance(row[i], float)}
    shown = set(re.findall(r"<td>([^<]+)</td>", text))
    assert not (found - given) & shown
    assert {"Da1", "C1", "A8"} <= shown  # the wiring is given whole
    for item in QUESTIONS["manual"]:
        assert item.text in html.unescape(text)
        assert item.where in text
    assert (
        "no --json beside it"
        in call(
            "lab", "manual", "--worksheet", tmp_path / "two.html", "--json", "-", "--report", tmp_path / "lab2"
        ).stderr
    )


def test_a_worksheet_shows_what_is_set_and_nothing_that_is_found() -> None:
    table = Table("By gain", ("who", "kp", "overshoot", "meets it"), [("target", 2.5, 7.125, "NO")], given=(0, 1))
    answers = (Answer("Step 9. Gain", "it falls"), Answer("And beside?", "a <secret>"))
    page = worksheet_page(LabResult("open-loop-sine", "Sine", "sim", (table,), answers), "anna")
    for given in ("target", "2.5", "anna", "And beside?", *(item.text for item in QUESTIONS["open-loop-sine"])):
        assert given in html.unescape(page)
    for found in ("7.125", "NO", "falls", "secret"):
        assert found not in page
    assert page.count('class="blank"') == 2


@pytest.mark.parametrize("lab", ["open-loop-step", "elevator", "characterise"])
def test_every_lab_takes_a_student_and_no_target_beside(lab: str) -> None:
    refused = call("lab", lab, "--student", "anna", "--target", "hid")
    assert refused.exit_code == 1
    assert "leave --target" in refused.stderr


def test_a_step_on_a_students_bench_is_that_students(tmp_path: Path) -> None:
    done = call("lab", "open-loop-step", "--volts", "3", "--disturbance", "0", "--no-diagnose", "--student", "anna",
                "--report", tmp_path / "lab", "--json", "-")  # fmt: skip
    assert done.exit_code == 0, done.stderr
    assert json.loads(done.stdout)["target"] == "sim:sealed"


def student_with(effect: str) -> str:
    """A student whose bench lacks nothing but this effect."""
    for number in range(2000):
        truth = break_seal(student_seed(f"s{number}"))
        if [name for name in truth["effects"] if name != "coulomb_friction"] == [effect]:
            return f"s{number}"
    raise AssertionError(effect)


def test_another_name_for_the_same_friction_is_right_and_a_fresh_record_says_so_too(tmp_path: Path) -> None:
    """Friction that differs by direction is its mean and a constant load: no log tells them apart."""
    student = student_with("asymmetric_coulomb_friction")
    reduced = break_seal(student_seed(student))["reduced"]
    own = reduced["asymmetric_coulomb_friction"]
    linear = {f"linear.{key}": value for key, value in reduced["linear"].items()}
    level = reduced["coulomb_friction"]["level_pct"]  # what is in both directions

    def handed_in(*effects: str, more: dict[str, float]) -> Grade:
        path = tmp_path / f"{student}.toml"
        path.unlink(missing_ok=True)
        Model(effects, {**linear, **more}).write(path)
        return grade(path)

    mean, half = (
        level + 0.5 * (own["forward_pct"] + own["reverse_pct"]),
        0.5 * (own["forward_pct"] - own["reverse_pct"]),
    )
    loaded = {"coulomb_friction.level_pct": mean, "constant_load.level_pct": half}
    total = {f"asymmetric_coulomb_friction.{way}": level + own[way] for way in ("forward_pct", "reverse_pct")}
    for one, named in (
        (handed_in("coulomb_friction", "constant_load", more=loaded), "constant_load"),
        (handed_in("asymmetric_coulomb_friction", more=total), "asymmetric_coulomb_friction"),  # as diagnose writes it
    ):
        assert one.named == (named,)
        assert one.effects_right
        assert set(one.errors_pct or {}) >= {"friction_forward_pct", "friction_reverse_pct"}
        assert max(abs(error) for error in (one.errors_pct or {}).values()) < 1e-6
        assert one.fresh_rms_deg is not None
        assert one.fresh_rms_deg < 0.2  # half a degree of count leaves 0.144
    without = handed_in("coulomb_friction", more={"coulomb_friction.level_pct": mean})
    assert not without.effects_right
    assert without.fresh_rms_deg is not None
    assert without.fresh_rms_deg > 0.4


def test_cogging_is_gravity_once_a_turn_only() -> None:
    assert same_effect("gravity_load", "cogging_torque", {"cogging_torque.order": 1.0})
    assert not same_effect("gravity_load", "cogging_torque", {"cogging_torque.order": 4.0})
    assert not all_named(("gravity_load",), ("gravity_load", "backlash"), {})
    assert not all_named(("gravity_load", "backlash"), ("gravity_load", "gravity_load"), {})
