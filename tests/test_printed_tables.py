"""Tables of figures round the circle: what an explanation is worth, and the page of a text's own measurements."""

from __future__ import annotations

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT

from fiohost.cli.main import cli
from fiohost.control.closed_loop import Loop, Plant
from fiohost.control.metrics import step_figures
from fiohost.discover.tables.diagnose import diagnose_tables
from fiohost.discover.tables.responses import Response, Responses
from fiohost.discover.tables.table import Figure, Row
from fiohost.discover.tables.worth import left_out_rms, scatter_needed, worth
from fiohost.errors import ConfigError
from fiohost.labs.constants import TEXT
from fiohost.labs.tables import judge, plot_rows
from fiohost.motor.model import Model

sys.path.insert(0, str(ROOT / "benchmarks"))

import measured_page
import measured_tables
import text_steady
import text_tables
import viscous

DRY_PCT = 4.0
LOOPS = [Loop(kp, sample_time_s=0.005, delay_s=0.005) for kp in (0.6, 1.0, 1.6, 2.4)]
FIGURES = [Figure("overshoot_pct", "%", 0.1), Figure("rise_s", "s", 0.002), Figure("settling_5_s", "s", 0.002)]


def fixed(model: Model) -> Model:
    return replace(model, fixed=frozenset(model.values))


@pytest.fixture(scope="module")
def motor() -> Model:
    return fixed(Model(values={"linear.gain_deg_s_per_pct": 9.0, "linear.tau_s": 0.08}))


@pytest.fixture(scope="module")
def responses(motor: Model) -> Responses:
    """Rounded figures of a motor with dry friction at four gains."""
    truth = Plant.of(motor.with_effect("coulomb_friction", {"level_pct": DRY_PCT}))
    blank = Responses("made", FIGURES, [Row("", {}) for _ in LOOPS], [Response(loop, 120.0) for loop in LOOPS])
    rows = []
    for i, loop in enumerate(LOOPS):
        seen = blank.predict(truth, i, ())
        rounded = {f.name: round(seen[f.name] / f.quantum) * f.quantum for f in FIGURES}
        rows.append(Row(f"kp {loop.kp_pct_per_deg:g}", rounded))
    return replace(blank, rows=rows)


# ---- what an explanation is worth ----------------------------------------------------------------------------------


def test_the_effect_that_is_there_is_worth_nearly_all_and_another_less(responses: Responses, motor: Model) -> None:
    found = diagnose_tables([responses], motor, library=["voltage_saturation"], from_file=True)
    declared = found.found.declared
    right, wrong = (worth(found.evidence, found.root, name) for name in ("coulomb_friction", "quadratic_drag"))
    assert right.fit is not None
    assert right.fit.model.number("coulomb_friction.level_pct") == pytest.approx(DRY_PCT, rel=0.05)
    assert right.rms < 2.0 < wrong.rms < declared.fit.rms
    assert right.why_not is None
    assert right.left_out_rms is not None
    assert wrong.left_out_rms is not None
    assert right.left_out_rms < 0.2 * wrong.left_out_rms
    walked = left_out_rms(found.evidence, right.fit, looks=20)
    assert walked == pytest.approx(right.left_out_rms, rel=0.05)  # a smooth case: nothing to walk past


@pytest.mark.parametrize(("name", "why"), [("gravity_load", "at which angle"), ("linear", "part of")])
def test_what_tables_say_nothing_of_is_refused(responses: Responses, motor: Model, name: str, why: str) -> None:
    found = diagnose_tables([responses], motor, library=["voltage_saturation"], from_file=True)
    with pytest.raises(ConfigError, match=why):
        judge(found, [name])


def test_scatter_that_would_let_a_model_pass() -> None:
    assert scatter_needed(1.0, 1.5) == 0.0
    needed = scatter_needed(7.0, 1.4)
    assert 7.0 / np.hypot(1.0, needed) == pytest.approx(1.4)


def test_times_of_the_target_and_of_the_final_value_differ_where_an_error_stays() -> None:
    time_s = np.linspace(0.0, 3.0, 3001)
    y = 0.94 * (1.0 - np.exp(-time_s / 0.1))
    own, asked = (step_figures(time_s, y, 0.0, 1.0, of_target) for of_target in (False, True))
    assert own.rise_s == pytest.approx(0.1 * np.log(9.0), rel=1e-3)
    assert asked.rise_s == pytest.approx(0.1 * np.log((1.0 - 0.1 / 0.94) / (1.0 - 0.9 / 0.94)), rel=1e-3)
    assert own.settling_5_s == pytest.approx(0.1 * np.log(20.0), rel=1e-3)
    assert asked.settling_5_s == time_s[-1]  # 0.94 never comes within 5 % of 1
    assert (own.overshoot_pct, own.final) == (asked.overshoot_pct, asked.final)


# ---- the lab -------------------------------------------------------------------------------------------------------


def test_the_lab_reports_before_after_and_left_out(responses: Responses, motor: Model, tmp_path: Path) -> None:
    lines = ['schema = "fiohost.readings/1"', 'kind = "response"', "[step]", "to = 120", "[controller]", 'kp = "kp"']
    lines += ["sample_time_s = 0.005", "delay_s = 0.005"]
    for figure in FIGURES:
        lines += [f"[figures.{figure.name}]", f"quantum = {figure.quantum}"]
    for row, loop in zip(responses.rows, LOOPS, strict=True):
        lines += ["[[row]]", f"kp = {loop.kp_pct_per_deg}", *(f"{n} = {v!r}" for n, v in row.measured.items())]
    readings, model = tmp_path / "bench.toml", tmp_path / "motor.toml"
    readings.write_text("\n".join(lines) + "\n")
    motor.write(model)
    told = tmp_path / "told.json"
    arguments = ["lab", "tables", "--readings", str(readings), "--model", str(model), "--explain", "quadratic_drag"]
    result = CliRunner().invoke(cli, [*arguments, "--report", str(tmp_path / "out"), "--json", str(told)])
    assert result.exit_code == 0, result.output
    found = json.loads(told.read_text())
    diagnosis = found["values"]["diagnosis"]
    assert diagnosis["verdict"] == "explained"
    (step,) = diagnosis["steps"]
    assert "coulomb_friction" in [step["effect"], *step["indistinguishable_from"]]
    (errors, scatter, readings_table) = found["tables"]
    assert [row[0] for row in errors["rows"]] == ["linear", f"+ {step['effect']}", "declared + quadratic_drag"]
    assert errors["rows"][1][1] < 0.1 * errors["rows"][0][1]
    assert [row[4] for row in scatter["rows"]] == [0.0] * len(FIGURES)  # explained: no scatter is needed
    assert len(readings_table["rows"]) == len(FIGURES) * len(LOOPS)
    assert (tmp_path / "out" / "tables_bench.png").stat().st_size > 10_000
    (asked,) = found["values"]["asked"]
    assert asked["rms"] > errors["rows"][1][1]


def test_the_picture_stands_rows_at_the_number_that_changes(responses: Responses, motor: Model) -> None:
    found = diagnose_tables([responses], motor, library=["voltage_saturation"], from_file=True)
    theirs = {"rise_s": [0.1] * len(LOOPS)}
    figure = plot_rows(found.to_json()["rows"], "made", theirs)
    panels = [axes for axes in figure.axes if axes.get_visible()]
    assert len(panels) == len(FIGURES)
    assert [axes.get_xlabel() for axes in panels] == ["kp"] * len(panels)
    assert [len(axes.lines) for axes in panels] == [3, 4, 3]
    assert list(panels[0].lines[0].get_xdata()) == [loop.kp_pct_per_deg for loop in LOOPS]


# ---- the functions of the page -------------------------------------------------------------------------------------


def test_viscous_friction_of_the_motor_itself_changes_nothing(responses: Responses) -> None:
    motor = TEXT["arm_tuned"]
    model = fixed(motor.model().without(["constant_load"]))
    plant = Plant.of(model)
    own = viscous.ViscousByRow(responses, motor, [0.5] * len(LOOPS), ())
    for i in range(len(LOOPS)):
        assert own.predict(plant, i, (motor.B_Nms, 0.0)) == pytest.approx(responses.predict(plant, i, ()))
        more = own.predict(plant, i, (motor.B_Nms, 0.01))
        assert more == pytest.approx(own.predict(plant, i, (motor.B_Nms + 0.01, 0.0)))
        assert more["rise_s"] > responses.predict(plant, i, ())["rise_s"]


def test_viscous_friction_is_fitted_where_it_is_what_changed(responses: Responses) -> None:
    motor = TEXT["no_load"]
    model = fixed(motor.model().without(["constant_load", "armature_inductance"]))
    larger = replace(motor, B_Nms=3.0 * motor.B_Nms).model().without(["constant_load", "armature_inductance"])
    rows = [Row(row.label, responses.predict(Plant.of(larger), i, ())) for i, row in enumerate(responses.rows)]
    found = viscous.fitted_viscous(replace(responses, rows=rows), model, motor, False)
    assert found.rms < 1.0
    assert found.fit is not None
    assert found.fit.constants[0][0] == pytest.approx(3.0 * motor.B_Nms, rel=0.05)


def test_dry_friction_seems_viscous_and_to_fall_with_power() -> None:
    motor = TEXT["no_load"]
    slow, fast = (text_steady.apparent_B(motor, volts, 0.01) for volts in (0.5, 4.0))
    assert slow > 5.0 * fast
    still = text_steady.apparent_B(motor, 2.0, 0.0, motor.B_Nms)
    assert still == motor.B_Nms


def test_tables_are_joined_row_by_row(responses: Responses) -> None:
    both = text_tables.joined("both", [responses, replace(responses, name="other")])
    assert len(both.rows) == len(both.responses) == 2 * len(LOOPS)
    plant = Plant.of(Model.parse("linear"))
    assert both.predict(plant, len(LOOPS), ()) == responses.predict(plant, 0, ())
    figures = [row.measured for row in responses.rows]
    assert text_tables.off(responses, figures) == 0.0
    moved = [{**own, "rise_s": own["rise_s"] + FIGURES[1].floor} for own in figures]
    assert text_tables.off(responses, moved) == pytest.approx(np.sqrt(1.0 / 3.0))


def test_a_row_of_the_page_has_a_cell_for_every_heading() -> None:
    assert measured_page.table(["a", "b"], [["1", "2"]]).splitlines()[-1] == "| 1 | 2 |"
    with pytest.raises(ValueError, match="has not 2 cells"):
        measured_page.table(["a", "b"], [["1", "2"], ["1", "2", "3"]])


# ---- the page itself, where the printed tables are -----------------------------------------------------------------


@pytest.fixture(scope="module")
def printed(measured_data: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Responses]:
    folder = measured_data / "nxt_textbook"
    if not folder.is_dir():
        pytest.skip(f"PRINTED TABLES ABSENT: no folder {folder}; FIOHOST_DATA names the folder above it")
    return measured_tables.tables_of(folder, tmp_path_factory.mktemp("tables"))


def on_page(label: str) -> list[str]:
    """The cells of a table's row in the one table of the page."""
    page = (ROOT / "docs" / "measured.md").read_text(encoding="utf-8")
    part = page[page.index("## Printed tables") :]
    (line, *_) = [line for line in part.splitlines() if line.startswith(f"| {label} |")]
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_the_page_tells_the_errors_of_the_declared_motor(printed: dict[str, Responses], measured_data: Path) -> None:
    for name, printed_table in text_tables.PRINTED.items():
        model = text_tables.declared(measured_data / "nxt_textbook", printed_table.motor)
        plant = Plant.of(model)
        figures = [printed[name].predict(plant, i, ()) for i in range(len(printed[name].rows))]
        assert float(on_page(printed_table.label)[3]) == pytest.approx(
            text_tables.off(printed[name], figures), rel=0.01
        )


def test_before_and_after_of_limited_power_downward_are_made_again(
    printed: dict[str, Responses], measured_data: Path
) -> None:
    told = text_tables.PRINTED["d15_down"]
    model = text_tables.declared(measured_data / "nxt_textbook", told.motor)
    found = diagnose_tables([printed["d15_down"]], model, library=["coulomb_friction"], from_file=True)
    cells = on_page(told.label)
    assert [step.effect for step in found.found.steps] == ["coulomb_friction"]
    assert "coulomb friction" in cells[4]
    assert float(cells[5].split()[0]) == pytest.approx(found.final.fit.rms, rel=0.03)
    assert found.final.left_out_rms is not None
    assert float(cells[5].split("(")[1].rstrip(")")) == pytest.approx(found.final.left_out_rms, rel=0.1)
    assert found.final.fit.rms < 0.4 * found.found.declared.fit.rms
    assert found.verdict == "unexplained"
