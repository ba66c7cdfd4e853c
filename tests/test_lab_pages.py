"""The page that each lab writes: the text's questions with sections, this run's answers, tables and plots inside."""

from __future__ import annotations

import html
import json
import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from click.testing import CliRunner

from fiohost.cli.lab import LABS
from fiohost.cli.main import cli
from fiohost.labs.questions import QUESTIONS
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.report.lab import render_lab, sentence

NO_TEXT = {"list", "tables", "problems", "grade"}  # a problem's questions are its own answers


def test_every_experiment_of_the_texts_has_its_questions_with_their_sections() -> None:
    assert set(QUESTIONS) == set(LABS) - NO_TEXT
    for name, asked in QUESTIONS.items():
        for item in asked:
            assert re.search(r"section (D-)?\d", item.where), (name, item.where)
            assert item.text.endswith(("?", "on.")), item.text
    assert len(QUESTIONS["steps"]) == 25


class Page(HTMLParser):
    """What a page loads, and how its tags nest."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.loads: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in ("meta", "img", "br"):
            self.open.append(tag)
        self.loads += [str(value) for key, value in attrs if key in ("src", "href")]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def whole(text: str) -> Page:
    page = Page()
    page.feed(text)
    assert page.open == []
    return page


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "lab", "plots"),
    [
        (["open-loop-step", "--volts", "2", "--no-diagnose"], "open-loop-step", 1),
        (["fine-tuning", "--tune", "B", "--no-diagnose"], "fine-tuning", 1),
        (["problems", "D-7"], "D-7", 1),
    ],
)
def test_a_lab_writes_one_page_with_all_in_it(arguments: list[str], lab: str, plots: int, tmp_path: Path) -> None:
    answer = CliRunner().invoke(cli, ["lab", *arguments, "--report", str(tmp_path), "--json", "-"])
    assert answer.exit_code == 0, answer.stderr
    said = json.loads(answer.stdout)
    assert Path(said["files"]["page"]) == tmp_path / f"{lab}.html"
    text = (tmp_path / f"{lab}.html").read_text(encoding="utf-8")
    page = whole(text)
    assert len(page.loads) == plots
    assert all(source.startswith("data:image/png;base64,") for source in page.loads)
    shown = html.unescape(re.sub(r"<[^>]+>", " ", text))
    for item in said["answers"]:
        assert sentence(item["answer"]) in shown
    for item in QUESTIONS.get(lab, ()):
        assert item.text in shown
        assert item.where in shown
    for table in said["tables"]:
        assert table["title"] in shown
        assert all(column in shown for column in table["columns"])


def test_a_question_of_the_text_is_followed_by_this_runs_answer_or_by_room_for_ones_own() -> None:
    answers = (Answer("Step 9. a", "answer 9"), Answer("Step 10. b", "answer 10"), Answer("Another", "beside <b>"))
    result = LabResult("open-loop-sine", "A & B", "sim", (Table("t", ("a", "b"), [[1.23456, "x<y"]]),), answers[1:])
    text = render_lab(result, {}, {})
    whole(text)
    first, second = (text.index(item.text) for item in QUESTIONS["open-loop-sine"])
    assert first < text.index("Your answer") < second < text.index("Answer 10.") < text.index("Beside &lt;b&gt;")
    assert "x&lt;y" in text
    assert "1.235" in text
    assert "A &amp; B" in text


def test_answers_are_sentences_on_the_page_and_symbols_stay_as_they_are() -> None:
    assert sentence("measured 2.3 s") == "Measured 2.3 s."
    assert sentence("a step gives two numbers, K and tau.") == "A step gives two numbers, K and tau."
    assert sentence("from -6.8 to -7.1") == "From -6.8 to -7.1."
    assert sentence("w = -36.07 T") == "w = -36.07 T."
    assert sentence("tau = 0.081 s") == "tau = 0.081 s."
