"""The page on speed: made of what benchmarks print, a part at a time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from boards import HANG_S

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
sys.path.insert(0, str(BENCHMARKS))

import performance  # noqa: E402


def test_a_part_is_made_anew_and_the_others_stay(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    page = tmp_path / "page.md"
    printed = iter(["first figures", *list(performance.PARTS)[1:], "second figures"])
    monkeypatch.setattr(
        performance.subprocess,
        "run",
        lambda command, **_: subprocess.CompletedProcess(command, 0, f"{next(printed)}\n"),
    )
    monkeypatch.setattr(sys, "argv", ["performance.py", "--page", str(page)])
    performance.main()
    whole = page.read_text()
    assert list(performance.sections(whole)) == [part.title for part in performance.PARTS.values()]
    assert "$ python benchmarks/startup.py\nfirst figures\n" in whole
    monkeypatch.setattr(sys, "argv", ["performance.py", "--page", str(page), "--only", "startup"])
    performance.main()
    assert page.read_text() == whole.replace("first figures", "second figures")


def test_what_is_done_stays_where_a_later_part_fails_and_small_samples_are_shown_as_such(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    page = tmp_path / "page.md"

    def ran(command: list[str], **_: object) -> subprocess.CompletedProcess[str]:
        if "fleet.py" in command[1]:
            raise subprocess.CalledProcessError(1, command)
        return subprocess.CompletedProcess(command, 0, "done\n")

    monkeypatch.setattr(performance.subprocess, "run", ran)
    monkeypatch.setattr(sys, "argv", ["performance.py", "--page", str(page), "--small", "--only", "diagnosis,fleet"])
    with pytest.raises(subprocess.CalledProcessError):
        performance.main()
    assert "$ python benchmarks/diagnosis.py --cases 3\ndone\n" in page.read_text()


def test_an_unknown_part_is_refused(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(sys, "argv", ["performance.py", "--only", "speed"])
    with pytest.raises(SystemExit):
        performance.main()
    assert "unknown: speed" in capsys.readouterr().err


def test_the_keyboard_waits_no_longer_than_is_asked() -> None:
    """What is imported, not how long it takes: nothing heavy before a command is known."""
    told = subprocess.run(
        [sys.executable, "-c", "import sys, fiohost.cli.main; print(*sys.modules)"],
        check=True, stdout=subprocess.PIPE, text=True, timeout=HANG_S,
    ).stdout.split()  # fmt: skip
    assert "click" in told
    assert not {"numpy", "scipy", "numba", "pandas", "pyarrow", "matplotlib", "rich"} & set(told)
