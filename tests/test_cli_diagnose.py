"""``diagnose`` and ``simulate`` as people use them: what they print and write, what they refuse, what they survive."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner, Result
from short_runs import SUITE, logs_of, plant_file, random_steps

from fiohost.bench.log import Log
from fiohost.cli.main import cli
from fiohost.discover.diagnose import Diagnosis, diagnose_records

DECLARED = "linear+coulomb_friction"
DRAG_NM = 0.016


def fiohost(*arguments: str | Path) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def sentence(result: Result) -> str:
    """The one sentence with which a command refuses."""
    assert result.exit_code == 1, result.output
    lines = result.stderr.strip().splitlines()
    assert len(lines) == 1, result.stderr
    assert lines[0].startswith("fiohost: ")
    assert "Traceback" not in result.output
    assert "inside fiohost" not in lines[0]
    return lines[0]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Logs of a board whose shaft carries a constant load, and one held out; all by their experiments' names."""
    place = tmp_path_factory.mktemp("logs")
    plant = plant_file(place, effects={"constant_load": {"torque_Nm": DRAG_NM}})
    logs_of(f"sim:{plant}", place, SUITE, seed=5)
    logs_of(f"sim:{plant}", place, [random_steps(seed=99)], seed=6)
    return place


TRAIN = [f"{e.name}.csv" for e in SUITE]
HELD = "short_random_steps_99.csv"


@pytest.fixture(scope="module")
def logs(folder: Path) -> list[Path]:
    return [folder / name for name in TRAIN]


@pytest.fixture(scope="module")
def held(folder: Path) -> Path:
    return folder / HELD


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory, logs: list[Path], held: Path) -> tuple[Path, Result]:
    """One complete diagnosis with everything that can be asked of it, and the folder of its outputs."""
    out = tmp_path_factory.mktemp("out")
    result = fiohost(
        "diagnose", *logs, "--holdout", held, "--model", DECLARED,
        "--json", out / "found.json", "--save-model", out / "found.toml", "--report", out / "report",
    )  # fmt: skip
    assert result.exit_code == 0, result.output
    return out, result


@pytest.fixture(scope="module")
def found(whole: tuple[Path, Result]) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((whole[0] / "found.json").read_text())
    return loaded


@pytest.fixture
def no_fit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever fits fails: for what must be refused before."""

    def fitted(*_: object, **__: object) -> Diagnosis:
        raise AssertionError("a fit was begun")

    monkeypatch.setattr("fiohost.circle.evidence.diagnose_records", fitted)


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Diagnoses look at one candidate only, for tests of everything around the search."""

    def short(*args: Any, **more: Any) -> Diagnosis:
        return diagnose_records(*args, **{**more, "library": ["constant_load"]})

    monkeypatch.setattr("fiohost.circle.evidence.diagnose_records", short)


# ---- the result ----------------------------------------------------------------------------------------------------


def test_the_load_is_named_and_the_error_falls_on_held_out_data(found: dict[str, Any]) -> None:
    assert found["verdict"] == "explained"
    assert [s["effect"] for s in found["steps"]] == ["constant_load"]
    assert "asymmetric_coulomb_friction" in found["steps"][0]["indistinguishable_from"]
    before, after, floor = (found[key]["holdout"]["window_rms"] for key in ("before", "after", "floor"))
    assert after < 0.7 * before
    assert after == pytest.approx(floor, rel=0.1)
    stall_Nm = 0.34 * 9.0 / 5.5
    load = found["final"]["parameters"]["constant_load.level_pct"]
    assert load["value"] == pytest.approx(100 * DRAG_NM / stall_Nm, rel=0.01)
    assert load["unit"] == "%"


ERRORS = {"free_run_rms", "window_rms", "bin_violation_pct", "fit_pct", "samples"}
PARAMETER = {"value", "unit", "ci95", "identifiable", "at_bound"}


def test_the_json_follows_the_schema(found: dict[str, Any], logs: list[Path], held: Path) -> None:
    assert found["schema"] == "fiohost.diagnosis/1"
    assert found["output_unit"] == "deg"
    assert found["declared"]["model"] == DECLARED
    assert found["seconds"] > 0
    for key in ("before", "after", "floor"):
        for role in ("train", "holdout"):
            assert set(found[key][role]) >= ERRORS, key
    assert found["floor"]["from"] in ("replicas", "repeats")
    assert found["floor"]["replicas"] >= 10
    for part in (found["declared"], found["final"], *found["steps"]):
        for name, parameter in part["parameters"].items():
            assert set(parameter) >= PARAMETER, name
    assert {"residual_power_removed"} <= set(found["steps"][0]["evidence"])
    assert [(log["file"], log["role"]) for log in found["logs"]] == [
        *((p.name, "train") for p in logs),
        (HELD, "holdout"),
    ]
    for log, path in zip(found["logs"], [*logs, held], strict=True):
        assert log["sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
        for key in ("before", "after", "floor"):
            assert set(log[key]) >= ERRORS
        assert log["initial"]["speed"] == 0.0
    scores = [c["score"] for c in found["candidates"]]
    assert scores == sorted(scores, reverse=True)
    assert {"effect", "score", "rejected_because"} <= set(found["candidates"][0])
    assert isinstance(found["residual"]["white"], bool)
    assert isinstance(found["residual"]["depends_on"], list)
    assert "next_experiment" in found


def test_the_summary_says_it_in_words_after_the_roles(whole: tuple[Path, Result]) -> None:
    text = whole[1].stdout
    assert re.search(rf"training .*{TRAIN[0]}: 2000 rows", text)
    assert re.search(rf"held out .*{HELD}: 2000 rows", text)
    assert text.index(HELD) < text.index("constant load")
    assert "asymmetric coulomb friction" in text


def test_roles_are_printed_before_anything_is_fitted(logs: list[Path], held: Path, no_fit: None) -> None:
    result = fiohost("diagnose", *logs[:2], "--holdout", held, "--model", DECLARED)
    assert result.exit_code == 1
    assert "a fit was begun" in result.stderr
    assert [line.split()[0] for line in result.stdout.splitlines()] == ["training", "training", "held"]


def test_the_report_is_a_page_of_its_own_and_plots(whole: tuple[Path, Result]) -> None:
    report = whole[0] / "report"
    html = (report / "report.html").read_text(encoding="utf-8")
    assert "constant load" in html
    assert html.count('class="record"') == len(TRAIN) + 1
    assert html.count("<svg") >= 3  # the residual, the candidates, the logs
    assert not re.search(r"""(src|href)\s*=\s*["'](?!#)""", html)
    assert not re.search(r"url\((?!#)", html)
    plots = list(report.glob("*.png"))
    assert len(plots) >= len(TRAIN) + 1
    assert any(HELD in p.name for p in plots)


def test_a_saved_model_is_replayed_to_the_same_figures(
    whole: tuple[Path, Result], found: dict[str, Any], logs: list[Path], held: Path
) -> None:
    out = whole[0]
    saved = tomllib.loads((out / "found.toml").read_text())
    assert saved["schema"] == "fiohost.model/1"
    assert saved["effects"] == ["coulomb_friction", "constant_load"]
    for path, told in zip([*logs, held], found["logs"], strict=True):
        result = fiohost(
            "simulate", path, "--model", out / "found.toml", "-o", out / "y.csv", "--json", out / "y.json", "--force"
        )
        assert result.exit_code == 0, result.output
        head = [line for line in (out / "y.csv").read_text().splitlines() if line.startswith("#")]
        table = np.loadtxt(out / "y.csv", delimiter=",", skiprows=len(head) + 1)
        log = Log.read(path)
        np.testing.assert_allclose(table[:, 0], log.time_s, atol=1e-9)
        rms = np.sqrt(np.mean((log.output - table[:, 1]) ** 2))
        assert rms == pytest.approx(told["after"]["free_run_rms"], rel=1e-6)
        assert json.loads((out / "y.json").read_text())["errors"] == pytest.approx(told["after"])
        stated = dict(line.lstrip("# ").split(": ", 1) for line in head)
        assert float(stated["initial_angle_deg"]) == pytest.approx(told["initial"]["angle"])
        assert float(stated["initial_speed"]) == 0.0
        assert table[0, 1] == pytest.approx(float(stated["initial_angle_deg"]))


def test_a_saved_model_can_be_declared_again_and_then_nothing_is_missing(
    whole: tuple[Path, Result], logs: list[Path], quick: None
) -> None:
    result = fiohost("diagnose", *logs, "--model", whole[0] / "found.toml", "--json", whole[0] / "again.json")
    assert result.exit_code == 0, result.output
    again = json.loads((whole[0] / "again.json").read_text())
    assert again["verdict"] == "no_missing_effect"
    assert again["declared"]["model"] == "linear+coulomb_friction+constant_load"
    assert again["before"]["holdout"] is None


@pytest.mark.long
def test_json_on_standard_output_is_json_and_nothing_else(tmp_path: Path, logs: list[Path], quick: None) -> None:
    result = fiohost("diagnose", *logs[1:], "--model", DECLARED, "--json", "-", "--report", tmp_path / "r")
    assert result.exit_code == 0, result.output
    assert json.loads(result.stdout)["schema"] == "fiohost.diagnosis/1"
    assert "training" in result.stderr
    assert "constant load" in result.stderr


@pytest.mark.long
def test_a_reader_who_leaves_early_costs_none_of_the_files(
    tmp_path: Path, logs: list[Path], quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As ``fiohost diagnose ... | head`` does."""

    def left(*_: object) -> None:
        raise BrokenPipeError(32, "Broken pipe")

    monkeypatch.setattr("fiohost.report.tables.print_diagnosis", left)
    told, model, report = tmp_path / "d.json", tmp_path / "found.toml", tmp_path / "r"
    files = ["--json", told, "--save-model", model, "--report", report]
    assert fiohost("diagnose", *logs[1:], "--model", DECLARED, *files).exit_code == 1
    assert json.loads(told.read_text())["schema"] == "fiohost.diagnosis/1"
    assert model.exists()
    assert (report / "report.html").exists()


# ---- damaged logs --------------------------------------------------------------------------------------------------


def table_of(path: Path) -> tuple[str, list[str]]:
    """Head (with column names) and rows of a log, as text."""
    lines = path.read_text().splitlines(keepends=True)
    first = next(i for i, line in enumerate(lines) if not line.startswith("#")) + 1
    return "".join(lines[:first]), lines[first:]


def diagnosed(files: Sequence[Path], out: Path) -> tuple[Result, dict[str, Any]]:
    result = fiohost("diagnose", *files, "--model", DECLARED, "--json", out)
    assert result.exit_code == 0, result.output
    return result, json.loads(out.read_text())


def test_a_log_cut_off_in_mid_line_is_used_as_far_as_it_is_whole(tmp_path: Path, logs: list[Path], quick: None) -> None:
    head, rows = table_of(logs[1])
    (tmp_path / "cut.csv").write_text(head + "".join(rows[:1500]) + rows[1500][: len(rows[1500]) // 2])
    result, found = diagnosed([tmp_path / "cut.csv", *logs[2:]], tmp_path / "j.json")
    assert "cut.csv: 1500 rows" in result.stdout
    assert "dropped: the last line, which is cut off in its middle" in result.stdout
    assert found["logs"][0]["after"]["samples"] == 1500
    assert [s["effect"] for s in found["steps"]] == ["constant_load"]


def test_a_log_with_missing_ticks_says_so_and_is_simulated_through_the_gap(
    tmp_path: Path, logs: list[Path], quick: None
) -> None:
    head, rows = table_of(logs[0])  # the staircase: what was commanded in the gap is what was commanded before
    (tmp_path / "gap.csv").write_text(head + "".join(rows[:720] + rows[730:1300] + rows[1301:]))
    result, found = diagnosed([tmp_path / "gap.csv", *logs[1:]], tmp_path / "j.json")
    assert "11 ticks are missing in 2 gaps (the longest: 10 ticks after 3.595 s)" in result.stdout
    assert found["logs"][0]["after"]["samples"] == 1989
    assert found["verdict"] == "explained"
    assert [s["effect"] for s in found["steps"]] == ["constant_load"]


@pytest.mark.long
def test_missing_ticks_under_a_changing_command_do_not_hide_the_effect(
    tmp_path: Path, logs: list[Path], quick: None
) -> None:
    head, rows = table_of(logs[1])  # the multisine: what was commanded in the gap nobody knows
    (tmp_path / "gap.csv").write_text(head + "".join(rows[:700] + rows[706:]))
    result, found = diagnosed([tmp_path / "gap.csv", *logs[2:]], tmp_path / "j.json")
    assert "6 ticks are missing in 1 gap" in result.stdout
    assert [s["effect"] for s in found["steps"]] == ["constant_load"]


# ---- refusals ------------------------------------------------------------------------------------------------------


def test_a_log_in_both_roles_is_refused_whatever_it_is_called(
    tmp_path: Path, logs: list[Path], held: Path, no_fit: None
) -> None:
    other = tmp_path / "other_name.csv"
    shutil.copy(logs[0], other)
    said = sentence(fiohost("diagnose", *logs, "--holdout", held, "--holdout", other, "--model", DECLARED))
    assert "other_name.csv is in both roles" in said
    assert logs[0].name in said
    assert "given twice" in sentence(fiohost("diagnose", logs[0], logs[1], logs[0]))


@pytest.mark.parametrize(
    ("model", "says"),
    [
        ("linear+coulomb_fricton", "coulomb_friction"),
        ("linear+backlush", "backlash"),
        ("coulomb_friction", "begins with linear"),
        ("absent.toml", "absent.toml"),
    ],
)
def test_a_model_nobody_knows_is_refused_with_the_nearest_name(
    logs: list[Path], no_fit: None, model: str, says: str
) -> None:
    assert says in sentence(fiohost("diagnose", logs[0], "--model", model))
    assert says in sentence(fiohost("simulate", logs[0], "--model", model, "-o", "y.csv"))
    assert not Path("y.csv").exists()


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("linear.tau_s", "linear.tua_s", "linear.tau_s"),
        ("coulomb_friction.level_pct", "coulomb_friction.level", "coulomb_friction.level_pct"),
        ("effects =", "efects =", "effects"),
        ("[parameters]", "[paramters]", "parameters"),
        ("fiohost.model/1", "fiohost.model/7", "fiohost.model/1"),
    ],
)
def test_a_model_file_with_an_unknown_key_is_refused_with_the_nearest_one(
    tmp_path: Path, whole: tuple[Path, Result], logs: list[Path], no_fit: None, old: str, new: str, says: str
) -> None:
    text = (whole[0] / "found.toml").read_text()
    assert old in text
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text.replace(old, new))
    for said in (
        sentence(fiohost("diagnose", logs[0], "--model", wrong)),
        sentence(fiohost("simulate", logs[0], "--model", wrong, "-o", tmp_path / "y.csv")),
    ):
        assert "wrong.toml" in said
        assert says in said
    assert not (tmp_path / "y.csv").exists()


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("", "is empty"),
        ("# schema: fiohost.log/1\n", "no rows"),
        ("time_s,duty_pct,pos\n", "no whole row"),
        ("time_s,duty_pct,pos\n0,0,1\n0.005,0,1\n", "too few"),
        ("t,u,y\n0,1,2\n1,2,3\n", "unknown is the unit of the output 'y'"),
        ("\x89PNG\r\n\x1a\n\0\0\0", "not a log"),
    ],
)
def test_a_file_that_is_no_log_is_refused(
    tmp_path: Path, logs: list[Path], no_fit: None, content: str, says: str
) -> None:
    bad = tmp_path / "bad.csv"
    bad.write_bytes(content.encode("latin-1"))
    said = sentence(fiohost("diagnose", logs[0], bad))
    assert "bad.csv" in said
    assert says in said
    assert says in sentence(fiohost("simulate", bad, "--model", "linear", "-o", tmp_path / "y.csv"))
    assert "absent.csv" in sentence(fiohost("diagnose", tmp_path / "absent.csv"))


def test_logs_that_show_no_motion_are_refused(tmp_path: Path, logs: list[Path]) -> None:
    head, _ = table_of(logs[0])
    still = [f"{0.005 * k:.3f},2,1,0,7,0,,3.5\n" for k in range(400)]
    (tmp_path / "still.csv").write_text(head + "".join(still))
    assert "nothing to fit" in sentence(fiohost("diagnose", tmp_path / "still.csv"))


def test_what_cannot_be_written_is_refused_before_the_work_and_nothing_is_lost(
    tmp_path: Path, logs: list[Path], no_fit: None
) -> None:
    (tmp_path / "a_file").write_text("precious")
    nowhere, directory, inside = tmp_path / "absent" / "f", tmp_path, tmp_path / "a_file" / "f"
    for option in ("--json", "--save-model"):
        for target in (nowhere, directory, inside):
            assert str(target) in sentence(fiohost("diagnose", logs[0], option, target))
    for target in (tmp_path / "a_file", inside):
        assert str(target) in sentence(fiohost("diagnose", logs[0], "--report", target))
    for target in (nowhere, directory, inside):
        assert str(target) in sentence(fiohost("simulate", logs[0], "--model", "linear", "-o", target))
    assert (tmp_path / "a_file").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a_file"]


def test_an_output_that_would_overwrite_an_input_is_refused(tmp_path: Path, logs: list[Path], no_fit: None) -> None:
    mine = tmp_path / "mine.csv"
    shutil.copy(logs[0], mine)
    other = tmp_path / "." / "mine.csv"
    for arguments in (
        ("simulate", mine, "--model", "linear", "-o", other),
        ("diagnose", mine, "--json", other),
        ("diagnose", logs[0], "--holdout", mine, "--save-model", other),
    ):
        assert "mine.csv" in sentence(fiohost(*arguments))
    assert mine.read_bytes() == logs[0].read_bytes()


def test_a_full_disk_under_the_report_does_not_cost_the_result(
    tmp_path: Path, logs: list[Path], quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    from fiohost.errors import LogError

    def full(*_: object, **__: object) -> None:
        raise LogError("cannot write pictures into report: No space left on device")

    monkeypatch.setattr("fiohost.report.plots.save_plots", full)
    result = fiohost(
        "diagnose", *logs[1:], "--model", DECLARED,
        "--json", tmp_path / "f.json", "--save-model", tmp_path / "f.toml", "--report", tmp_path / "r",
    )  # fmt: skip
    assert "No space left" in sentence(result)
    assert json.loads((tmp_path / "f.json").read_text())["verdict"] == "explained"
    assert (tmp_path / "f.toml").is_file()
