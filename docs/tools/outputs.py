"""Runs the commands shown in the documents and puts their real output there.

Usage: ``python docs/tools/outputs.py [PAGE...]`` writes every shown output anew: console blocks, notebooks, the page of
the effects, pictures. ``--check`` writes nothing and leaves with 1 where a shown text is not what the program prints;
``--check --sample`` does so for the two notebooks and the few pages that take seconds.

Every fenced ``console`` block of a page is run in order in a folder of the page's own; lines after ``$ `` are commands,
all others are replaced by what the commands print. What a page needs beside stands in comments that no reader sees:
``<!-- file: NAME -->`` writes the block that follows to a file, ``<!-- before: COMMAND -->`` runs a command.
"""

from __future__ import annotations

import argparse
import difflib
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
NOTEBOOKS = ROOT / "docs" / "notebooks"
# What a full run makes beside the console blocks. Their check is a test's, where they have one.
OTHERS = (
    "effects_page.py",
    "numbers_page.py",
    "pictures.py",
    "panel_pictures.py",
    "control_lab_pictures.py",
    "wiring.py",
)
SAMPLE = (
    "docs/labs/tools.md",
    "docs/labs/problems.md",
    "docs/notebooks/bench.ipynb",
    "docs/notebooks/diagnosis.ipynb",
)
STEP = re.compile(
    r"<!-- before: (?P<before>.*?) -->|<!-- file: (?P<file>.*?) -->\n+```\w*\n(?P<content>.*?)```"
    r"|```console\n(?P<console>.*?)```",
    re.DOTALL,
)
NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
CLOCK = re.compile(r"^(took|diagnosis in) [\d.]+ (s|min)", re.MULTILINE)  # differs from run to run
LAST_PLACES = 2.0  # by which another computer's arithmetic may move the last digit that is shown
SHARE = 0.01  # of a number, by which a fit that ends elsewhere within its tolerance may move it


def pages() -> list[Path]:
    """All pages with commands, and the notebooks."""
    found = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [p for p in found if "```console" in p.read_text(encoding="utf-8")] + sorted(NOTEBOOKS.glob("*.ipynb"))


def commands(block: str) -> list[str]:
    """The commands of a block, a trailing backslash continuing on the next line."""
    found: list[str] = []
    more = False
    for line in block.splitlines():
        if more:
            found[-1] += "\n" + line
        elif line.startswith("$ "):
            found.append(line[2:])
        more = line.endswith("\\") and (more or line.startswith("$ "))
    return found


def call(command: str, folder: Path, environment: dict[str, str]) -> str:
    print(f"$ {command}", flush=True)
    words = ["bash", "-c", command]
    done = subprocess.run(
        words, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=False
    )
    return done.stdout


def anew(text: str, folder: Path, environment: dict[str, str]) -> str:
    """The text of a page with its console blocks run."""

    def step(match: re.Match[str]) -> str:
        if match["before"]:
            said = call(match["before"], folder, environment)
            if said.strip():
                print(said)
        elif match["file"]:
            path = folder / match["file"]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(match["content"], encoding="utf-8")
        else:
            lines = []
            for command in commands(match["console"]):
                lines.append(f"$ {command}")
                lines += [line.rstrip() for line in call(command, folder, environment).rstrip().splitlines()]
            return "```console\n" + "\n".join(lines) + "\n```"
        return match[0]

    return STEP.sub(step, text)


def executed(path: Path, folder: Path) -> str:
    """A notebook with its cells run, as text."""
    import nbformat
    from nbclient import NotebookClient

    print(f"notebook {path.name}", flush=True)
    notebook = nbformat.read(path, as_version=4)
    place = {"metadata": {"path": str(folder)}}
    NotebookClient(notebook, timeout=1200, kernel_name="python3", resources=place).execute()
    for cell in notebook.cells:
        cell.metadata = {}
    notebook.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    return nbformat.writes(notebook) + "\n"


def spoken(path: Path, text: str) -> str:
    """What of a page is compared: all of it, of a notebook its sources and what they print."""
    if path.suffix != ".ipynb":
        return text
    import nbformat

    lines = []
    for cell in nbformat.reads(text, as_version=4).cells:
        lines.append(cell.source)
        for output in cell.get("outputs", []):
            lines.append(output.get("text") or output.get("data", {}).get("text/plain", ""))
    return re.sub(r"0x[0-9a-f]+", "0x", "\n".join(lines))


def same(shown: str, printed: str) -> bool:
    """Whether two texts differ in nothing but blanks, times taken, and numbers by their last digit or a per cent."""
    texts = [CLOCK.sub(r"\1", text) for text in (shown, printed)]
    if len({" ".join(NUMBER.sub("#", text).split()) for text in texts}) > 1:
        return False
    return all(_close(a, b) for a, b in zip(*(NUMBER.findall(text) for text in texts), strict=True))


def _close(a: str, b: str) -> bool:
    apart, largest = abs(float(a) - float(b)), max(abs(float(a)), abs(float(b)))
    return apart <= max(LAST_PLACES * 1.001 * max(_place(a), _place(b)), SHARE * largest)


def _place(number: str) -> float:
    """The value of a one in the last place."""
    digits, _, power = number.lower().partition("e")
    return float(10.0 ** (int(power or 0) - len(digits.partition(".")[2])))


def difference(path: Path, shown: str, printed: str) -> list[str]:
    """Lines in which they really differ; empty where none does."""
    if same(shown, printed):
        return []
    name = str(path.relative_to(ROOT))
    lines = difflib.unified_diff(shown.splitlines(), printed.splitlines(), name, "what is printed", "", "", 0, "")
    return list(lines)


def environment_in(folder: Path) -> dict[str, str]:
    """Where commands run: ``fiohost`` is this checkout's."""
    for name, words in (("fiohost", "-m fiohost"), ("python", ""), ("pip", "-m pip")):
        command = folder / "bin" / name
        command.parent.mkdir(exist_ok=True)
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" {words} "$@"\n')
        command.chmod(0o755)
    return {
        **os.environ,
        "PATH": f"{folder / 'bin'}:{os.environ['PATH']}",
        "PYTHONPATH": f"site{os.pathsep}{ROOT}",
        "XDG_STATE_HOME": str(folder / "state"),
        "COLUMNS": "110",
        "CHECKOUT": str(ROOT),
    }


def main() -> int:
    told = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    told.add_argument("pages", nargs="*", metavar="PAGE", help="only these")
    told.add_argument("--check", action="store_true", help="compare, write nothing")
    told.add_argument("--sample", action="store_true", help="only the notebooks and the pages that take seconds")
    options = told.parse_args()
    names = options.pages or (SAMPLE if options.sample else ())
    chosen = [ROOT / name for name in names] or pages()
    wrong = 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        environment = environment_in(folder)
        for path in chosen:
            work = folder / "pages" / path.relative_to(ROOT).with_suffix("")
            work.mkdir(parents=True)
            shown = path.read_text(encoding="utf-8")
            notebook = path.suffix == ".ipynb"
            printed = executed(path, work) if notebook else anew(shown, work, environment)
            lines = difference(path, spoken(path, shown), spoken(path, printed))
            wrong += bool(lines)
            print("\n".join(lines) or f"{path.relative_to(ROOT)}: as it is printed", flush=True)
            if lines and not options.check:
                path.write_text(printed, encoding="utf-8")
    if not names and not options.check:
        for tool in OTHERS:
            print(f"{tool}", flush=True)
            subprocess.run([sys.executable, str(Path(__file__).with_name(tool))], check=True)
    if wrong and options.check:
        print(f"{wrong} pages show what is not printed: python docs/tools/outputs.py writes them anew", file=sys.stderr)
    return int(bool(wrong and options.check))


if __name__ == "__main__":
    sys.exit(main())
