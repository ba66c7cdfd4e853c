"""The report room turns results into words, tables, pictures and one page that needs nothing but itself."""

from __future__ import annotations

import copy
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from desktop import Chromium, needed
from report_case import curve, diagnosis, error, series
from rich.console import Console

from fiohost.errors import FiohostError
from fiohost.report import words
from fiohost.report.page import write_page
from fiohost.report.plots import save_plots
from fiohost.report.preliminary import limits
from fiohost.report.series import SeriesPlot
from fiohost.report.tables import print_diagnosis


def printed(result: dict[str, Any]) -> str:
    console = Console(width=140, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    print_diagnosis(console, result)
    return console.export_text()


def test_the_verdict_names_effect_rivals_and_held_out_errors() -> None:
    sentence = words.verdict_sentence(diagnosis())
    assert sentence == (
        "Missing from linear+coulomb_friction: gravity load (these data cannot tell it from cogging torque). "
        "The held-out error falls from 18.7 deg to 0.149 deg rms; the floor is 0.146 deg."
    )


def test_the_verdict_says_when_nothing_is_missing_and_when_it_cannot_be_named() -> None:
    clean = {**diagnosis(), "verdict": "no_missing_effect", "steps": []}
    assert words.verdict_sentence(clean).startswith("Nothing is missing: linear+coulomb_friction explains the data")
    lost = {**diagnosis(), "verdict": "unexplained", "steps": []}
    assert "no candidate accounts for; what remains follows the shaft angle and the direction of motion" in (
        words.verdict_sentence(lost)
    )
    partly = {**diagnosis(), "verdict": "unexplained"}
    assert words.verdict_sentence(partly).startswith("Partly explained: adding gravity load")


def test_without_held_out_logs_the_training_error_is_what_is_told() -> None:
    result = diagnosis()
    for key in ("before", "after", "floor"):
        result[key]["holdout"] = None
    assert "The training error falls from 21.3 deg to 0.151 deg" in words.verdict_sentence(result)
    assert "floor" in printed(result)
    assert "held out\n" not in printed({**result, "logs": []})


def test_an_effect_that_was_found_too_is_no_rival() -> None:
    result = diagnosis()
    other = {**result["steps"][0], "effect": "cogging_torque", "indistinguishable_from": ["clock_ripple"]}
    result["steps"].append(other)
    said = words.verdict_sentence(result)
    assert "gravity load and cogging torque (these data cannot tell it from clock ripple)" in said
    assert words.rivals_of(result, result["steps"][0]) == []


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.0, "0"), (1234.5, "1234"), (0.14567, "0.1457"), (2.5e-7, "2.500e-07"), (None, "–"), (float("nan"), "–"),
     (float("inf"), "infinite"), (720, "720"), (True, "–"), ("x", "–")],
)  # fmt: skip
def test_numbers_have_sensible_digits(value: Any, text: str) -> None:
    assert words.number(value) == text


def test_the_terminal_shows_errors_floor_parameters_and_candidates() -> None:
    text = printed(diagnosis())
    for part in ("random_steps.csv", "held out", "floor (from replicas)", "coulomb_friction.level_pct",
                 "1.594 .. 1.626", "not identifiable from these data", "at its bound", "chosen",
                 "slow_turns"):  # fmt: skip
        assert part in text, part
    assert "<b>" not in text  # only the file's name, not its folder


def test_names_from_files_are_never_read_as_markup() -> None:
    result = diagnosis()
    result["logs"][0]["file"] = "[bold red]x.csv"
    assert "[bold red]x.csv" in printed(result)


class Checker(HTMLParser):
    """Collects everything that would be fetched, and checks that elements are closed in order."""

    VOID = frozenset({"meta", "br", "hr", "img", "link", "input"})

    def __init__(self) -> None:
        super().__init__()
        self.fetched: list[str] = []
        self.ids: list[str] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        for name, value in attrs:
            if name in ("src", "href", "xlink:href", "data", "action") and not (value or "").startswith(("#", "data:")):
                self.fetched.append(f"{tag} {name}={value}")
            if name == "id" and value:
                self.ids.append(value)
        if tag in ("iframe", "link", "object"):
            self.fetched.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag, f"</{tag}> closes nothing"


def test_the_page_is_one_file_that_fetches_nothing(tmp_path: Path) -> None:
    confirm = {
        "file": "fresh.csv",
        "before": error(18.0),
        "after": error(0.15),
        "improvement_pct": 99.2,
        "ci95": [99, 99.3],
    }
    seal = {"effects": [{"name": "gravity_load", "level_pct": 2.41}], "plant": {"R_ohm": 5.5}}
    path = write_page(
        tmp_path / "deep" / "page.html", title="close-loop <seed> & 12", diagnosis=diagnosis(),
        series=[series("train"), series("holdout"), series("confirm")], seal=seal, confirm=confirm, curves=[curve()],
    )  # fmt: skip
    html = path.read_text(encoding="utf-8")
    checker = Checker()
    checker.feed(html)
    assert checker.open == []
    assert checker.fetched == []
    assert "http" not in html
    assert "@import" not in html
    assert not re.search(r"url\((?!#)", html)
    assert len(checker.ids) == len(set(checker.ids)), "two pictures share an id"
    assert "close-loop &lt;seed&gt; &amp; 12" in html
    assert "<b>bench" not in html
    assert html.index("Missing from linear") < html.index("Error before and after") < html.index("The seal, opened")
    assert "99.2 % less (95 % interval of the improvement: 99.00 .. 99.30 %)" in html
    assert html.count("<svg") == 4  # candidates, logs, residual, curve; records are drawn by the page
    assert html.count('class="record"') == 3
    assert len(html) < 3_000_000
    assert [p.name for p in path.parent.iterdir()] == ["page.html"]


def test_a_next_experiment_in_words_is_no_command(tmp_path: Path) -> None:
    result = diagnosis()
    text = write_page(tmp_path / "a.html", title="t", diagnosis=result).read_text(encoding="utf-8")
    assert "<strong>fiohost run slow_turns</strong>" in text
    result["next_experiment"] |= {"experiment": "a sum of sines", "in_words": True}
    text = write_page(tmp_path / "b.html", title="t", diagnosis=result).read_text(encoding="utf-8")
    assert "<strong>a sum of sines</strong>" in text


def test_what_is_left_unexplained_though_small_is_said_not_to_be_random() -> None:
    result = {**diagnosis(), "verdict": "unexplained", "steps": []}
    told = "It is no larger than the floor, but it is not random."
    assert told not in words.verdict_sentence(result)
    result["residual"]["white"] = False
    assert told not in words.verdict_sentence(result)  # above the floor
    result["floor"]["holdout"]["free_run_rms"] = 0.15
    assert words.verdict_sentence(result).endswith(told)


def test_the_page_stands_with_the_least_that_a_diagnosis_can_hold(tmp_path: Path) -> None:
    result = copy.deepcopy(diagnosis())
    result.update(verdict="no_missing_effect", steps=[], candidates=[], next_experiment=None)
    for key in ("before", "after", "floor"):
        result[key]["holdout"] = None
    html = write_page(tmp_path / "page.html", title="t", diagnosis=result).read_text(encoding="utf-8")
    assert "Nothing is missing" in html
    assert "The seal" not in html


def test_pictures_are_saved_with_harmless_names_and_a_long_log_stays_small(tmp_path: Path) -> None:
    long = series(samples=200_000)
    odd = SeriesPlot("../a b/ö.csv", "train", "deg", long.time_s, long.measured, long.before, None)
    files = save_plots(tmp_path / "pictures", [long, odd], diagnosis(), [curve()])
    assert len(files) == 5
    for file in files:
        assert file.parent == tmp_path / "pictures"
        assert file.read_bytes().startswith(b"\x89PNG")
        assert file.stat().st_size < 500_000


def test_missing_figures_leave_gaps_and_no_failure(tmp_path: Path) -> None:
    result = diagnosis()
    for log in result["logs"]:
        log["after"] = log["floor"] = None
        log["before"]["window_rms"] = float("nan")
    short = SeriesPlot("one", "train", "m", np.zeros(1), np.zeros(1), np.zeros(1), None, np.zeros(1))
    assert write_page(tmp_path / "page.html", title="t", diagnosis=result, series=[short]).is_file()
    printed(result)


def test_an_unwritable_page_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(FiohostError, match="cannot make the folder"):
        write_page(tmp_path / "file" / "page.html", title="t", diagnosis=diagnosis())
    with pytest.raises(FiohostError, match="cannot make the folder"):
        save_plots(tmp_path / "file", [], diagnosis())


def test_tables_need_no_plotting() -> None:
    code = "import sys, fiohost.report.tables; sys.exit('matplotlib' in sys.modules or 'numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_browser_shows_the_page(tmp_path: Path) -> None:
    needed("chromium")
    page = write_page(tmp_path / "page.html", title="t", diagnosis=diagnosis(), series=[series()])
    with Chromium(tmp_path / "profile") as browser:
        dom = browser.shown(page)
    assert "Missing from linear+coulomb_friction" in dom
    assert dom.count("<svg") == 3
    assert dom.count('class="uplot ') == 4, "output, both errors, duty"


def preliminary() -> dict[str, Any]:
    """What a diagnosis may say before any dynamics, a fault of every kind in it."""
    spike = {"name": "spike", "severity": "harm", "count": 2, "times_s": [1.5, 2.5], "advice": "drop <these> rows"}
    late = {"said": "1 ticks", "best": "2", "verdict": "contradicted", "sentence": "the logs say 1, the data say 2",
            "window_rms": {"1": 0.43, "2": 0.14}, "estimate": {"value": 2.0, "ci95": [1.99, 2.01]}}  # fmt: skip
    quiet = {"said": "brake", "best": None, "verdict": "not_asked", "sentence": "cannot tell", "window_rms": {}}
    return {
        "kinematics": [
            {"log": "a.csv", **spike},
            {"log": "b.csv", **spike},
            {"log": "a.csv", **spike, "name": "clipped_command", "severity": "note", "advice": "flat"},
        ],
        "kinematics_skipped": [{"log": "a.csv", "name": "not_closed", "why": "the log does not say"}],
        "semantics": {"seconds_used": 40.0, "floor_window_rms": 0.14, "command_delay": late, "zero_duty": quiet},
        "data": {
            "seconds": 30.0, "reversals": 0, "both_directions": False, "closed_loop_only": False,
            "cannot_show": [{"effects": ["backlash"], "why": "no reversals"}],
            "cannot_tell_apart": [{"effects": ["missed_counts", "quadratic_drag"], "why": "no way out and back"}],
        },
    }  # fmt: skip


def test_the_terminal_warns_of_faults_and_keeps_the_rest_for_verbose() -> None:
    result = {**diagnosis(), **preliminary()}
    text = " ".join(printed(result).split())
    assert "Warning: The logs say 1, the data say 2." in text
    assert "Warning: a.csv at 1.500 and 2.500 s; b.csv at 1.500 and 2.500 s: drop <these> rows." in text
    assert "These logs cannot show backlash (why: -v or the page)." in text
    assert "no reversals" not in text
    assert "flat" not in text
    console = Console(width=200, record=True, file=open("/dev/null", "w"))  # noqa: SIM115
    print_diagnosis(console, result, verbose=True)
    full = " ".join(console.export_text().split())
    for part in ("flat", "no reversals", "missed counts from quadratic drag", "1: 0.430, 2: 0.140", "not_closed",
                 "reversals 0"):  # fmt: skip
        assert part in full, part


def test_what_was_found_is_not_said_to_be_what_the_logs_cannot_show() -> None:
    named = {**diagnosis(), **preliminary()}
    name = named["steps"][0]["effect"]
    named["data"] = {**named["data"], "cannot_show": [{"effects": ["backlash", name], "why": "no reversals"},
                                                      {"effects": [name], "why": "one level"}]}  # fmt: skip
    assert "These logs cannot show backlash (why: -v or the page)." in " ".join(printed(named).split())
    assert limits(named)[0] == ("cannot show backlash", "no reversals")
    assert not any("one level" in why for _, why in limits(named))


def test_a_diagnosis_that_found_nothing_before_says_nothing_before() -> None:
    empty = {"kinematics": [], "kinematics_skipped": [], "semantics": None,
             "data": {"cannot_show": [], "cannot_tell_apart": []}}  # fmt: skip
    assert printed({**diagnosis(), **empty}) == printed(diagnosis())


def test_the_page_tells_what_was_seen_before_any_dynamics(tmp_path: Path) -> None:
    with_it = write_page(tmp_path / "a.html", title="x", diagnosis={**diagnosis(), **preliminary()})
    text = with_it.read_text()
    for part in ("Before any dynamics", "drop &lt;these&gt; rows", "the data say 2", "cannot show backlash",
                 "no reversals", "ticks until a command acts: 2"):  # fmt: skip
        assert part in text, part
    Checker().feed(text)
    assert "Before any dynamics" not in write_page(tmp_path / "b.html", title="x", diagnosis=diagnosis()).read_text()
