"""The command line as people meet it: the first look, groups, misspelled names, the tab key, pictures and pages."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from desktop import Chromium, needed

from fiohost.cli.main import COMMANDS, GROUPS, cli
from fiohost.report.log_plot import plot_logs
from fiohost.report.log_series import LogSeries
from fiohost.report.plots import PIECES


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def test_the_bare_command_shows_a_path_whose_commands_exist() -> None:
    said = call()
    assert said.exit_code == 0
    shown = re.findall(r"^  fiohost (\S+)", said.stdout, re.MULTILINE)
    assert {"manual", "run", "plot", "import", "diagnose", "devices"} <= set(shown)
    assert set(shown) <= set(COMMANDS)


def test_the_help_shows_every_command_once_in_its_group() -> None:
    text = call("--help").stdout
    for title in GROUPS:
        assert f"\n{title}:\n" in text
    for name in COMMANDS:
        assert len(re.findall(rf"^  {re.escape(name)}  ", text, re.MULTILINE)) == 1, name
    named = [name for names in GROUPS.values() for name in names]
    assert len(named) == len(set(named))


@pytest.mark.parametrize(("typed", "meant"), [("diagnos", "diagnose"), ("indentify", "identify"), ("plott", "plot")])
def test_a_misspelled_command_gets_a_suggestion(typed: str, meant: str) -> None:
    refused = call(typed)
    assert refused.exit_code == 2
    assert f"did you mean {meant!r}" in refused.stderr


@pytest.mark.parametrize(
    ("line", "offered"),
    [
        ("fiohost dia", "diagnose"),
        ("fiohost run stair", "staircase"),
        ("fiohost run --target sim:nxt_n", "sim:nxt_no_load"),
        ("fiohost manual --target serial-d", "serial-documented"),
        ("fiohost diagnose --model linear+coul", "linear+coulomb_friction"),
        ("fiohost design --model nx", "nxt"),
        ("fiohost effects gravity", "gravity_load"),
        ("fiohost lab precomp", "precompensation"),
        ("fiohost import --map em", "emps"),
        ("fiohost plot --spec", "--spectrum"),
    ],
)
def test_the_tab_key_knows_names(line: str, offered: str) -> None:
    words = line.split()
    environment = {**os.environ, "COMP_WORDS": line, "COMP_CWORD": str(len(words) - 1)}
    environment["_FIOHOST_COMPLETE"] = "bash_complete"
    code = "from fiohost.cli.main import main; main()"
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert offered in [one.partition(",")[2] for one in done.stdout.splitlines()], done.stdout + done.stderr


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_completion_is_printed_and_installed_once(shell: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    printed = call("completion", shell)
    if printed.exit_code and shutil.which(shell) is None:
        pytest.skip(f"NO {shell} HERE: its completion is not tested")
    assert printed.exit_code == 0, printed.output
    assert "_FIOHOST_COMPLETE" in printed.stdout
    monkeypatch.setenv("HOME", str(tmp_path))
    for _ in range(2):
        assert call("completion", shell, "--install").exit_code == 0
    written = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert len(written) == 1
    text = written[0].read_text()
    assert text.count("fiohost completion") == (0 if shell == "fish" else 1) or "_FIOHOST_COMPLETE" in text
    if shell == "bash":
        subprocess.run(["bash", "-n", "-c", printed.stdout], check=True)


def test_an_unknown_shell_is_refused() -> None:
    refused = call("completion", "basch")
    assert refused.exit_code == 1
    assert "did you mean 'bash'" in refused.stderr


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "run.csv"
    made = call("run", "square_170_190", "--log", path)
    assert made.exit_code == 0, made.output
    return path


@pytest.mark.parametrize(("samples", "bands"), [(200, 0), (5000, 1)])
def test_the_error_of_a_long_log_is_a_band_with_its_mean_and_no_block(samples: int, bands: int) -> None:
    time_s = 0.005 * np.arange(samples)
    error = np.random.default_rng(1).uniform(-0.25, 0.25, samples)
    duty = np.zeros(samples)
    one = LogSeries("run", "deg", time_s, error, None, "deg/s", duty, 0.005, simulated=duty, model="linear")
    figure = plot_logs([one], "run")
    (axes,) = (a for a in figure.axes if a.get_ylabel().startswith("measured"))
    assert len(axes.collections) == bands
    assert max(len(line.get_xdata()) for line in axes.lines) <= PIECES


@pytest.mark.parametrize("name", ["p.png", "p.svg", "p.pdf", "p.html"])
def test_a_log_is_drawn_as_picture_or_page(log: Path, tmp_path: Path, name: str) -> None:
    drawn = call("plot", log, "--against", "linear", "-o", tmp_path / name)
    assert drawn.exit_code == 0, drawn.stderr
    assert "deg rms" in drawn.stdout
    begins = {"p.png": b"\x89PNG", "p.svg": b"<?xml", "p.pdf": b"%PDF", "p.html": b"<!DOCTYPE html>"}[name]
    assert (tmp_path / name).read_bytes().startswith(begins)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--phase", "--spectrum"], "two pictures"),
        (["-o", "p.jpeg"], "a picture ends with"),
        (["--phase", "-o", "p.html"], "make pictures"),
        (["--against", "linearr"], "did you mean"),
    ],
)
def test_a_plot_that_cannot_be_is_refused(log: Path, arguments: list[str], says: str) -> None:
    refused = call("plot", log, *arguments)
    assert refused.exit_code == 1
    assert says in refused.stderr


def test_the_page_is_drawn_in_a_browser_without_a_network(log: Path, tmp_path: Path) -> None:
    needed("chromium")
    page = tmp_path / "run.html"
    assert call("plot", log, log.parent, "-o", page).exit_code in (0, 1)
    assert call("plot", log, "--against", "linear", "-o", page, "--force").exit_code == 0
    text = page.read_text()
    assert not re.search(r"""(?:src|href)=["']?https?:""", text)
    assert len(text) < 4_000_000
    with Chromium(tmp_path / "profile") as browser:
        shown = browser.shown(page)
    assert shown.count("<canvas") == 4
    for label in ("reference", "measured", "linear", "duty"):
        assert label in shown


def test_the_way_of_a_user_needs_nothing_that_windows_lacks(tmp_path: Path) -> None:
    script = Path(__file__).with_name("without_unix.py")
    done = subprocess.run([sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert (tmp_path / "p.html").exists()
