"""The same checks under other circumstances: interpreters, old and new numpy, locales, homes, odd folders, no screen.

    python benchmarks/matrix.py             all of it
    python benchmarks/matrix.py --sample    one of each kind, as the gate does
    python benchmarks/matrix.py --list
    python benchmarks/matrix.py --without 3.12 --without 3.13    on a computer that has them not

Each row makes a virtual environment of its own, installs the checkout, and runs a log through run, check, identify,
simulate and a plot. An interpreter that is not on this computer fails the run, unless it was named by ``--without``:
what was not tried never passes for tried. The last line counts all three kinds.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13")
NUMPY = {"oldest": {"3.11": "1.26.0", "3.12": "1.26.0", "3.13": "2.1.0"}, "newest": {}}
LIMIT_S = 1800
KINDS = ("ok", "ABSENT", "FAILED")
NO_UTF8: dict[str, str | None] = {"LANG": "C", "LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
STEP = (
    'schema = "fiohost.experiment/1"\n[[command]]\nkind = "staircase"\nlevels_pct = [20.0, 40.0, -30.0]\n'
    "step_s = 0.5\nduration_s = 3.0\n"
)


@dataclass(frozen=True)
class Row:
    """One circumstance."""

    name: str
    python: str = "3.11"
    numpy: str = "newest"
    environment: dict[str, str | None] = field(default_factory=dict)  # None: not set at all
    folder: str = "plain"
    sampled: bool = False


ROWS = (
    *(Row(f"Python {python}, {numpy} numpy", python, numpy, sampled=python == "3.11" and numpy == "oldest")
      for python in PYTHONS for numpy in NUMPY),
    Row("LANG=C", environment=NO_UTF8, sampled=True),
    Row("no HOME", environment={"HOME": None, "XDG_CACHE_HOME": None, "XDG_STATE_HOME": None}),
    Row("a home that cannot be written", environment={"HOME": "/proc/nowhere", "XDG_CACHE_HOME": None}),
    Row("blanks and umlauts", folder="Prüf stand ü"),
    Row("no display", environment={"DISPLAY": None, "WAYLAND_DISPLAY": None, "MPLBACKEND": None}),
)  # fmt: skip


def interpreter_of(version: str) -> str | None:
    """A Python of that version that starts: on the path, or one that pyenv has and has not chosen."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    found = [shutil.which(f"python{version}"), *sorted(map(str, kept.glob(f"{version}.*/bin/python{version}")))]
    for candidate in found:
        if candidate and not subprocess.run([candidate, "-c", ""], capture_output=True, check=False).returncode:
            return candidate
    return None


def commands(fiohost: list[str]) -> list[list[str]]:
    return [
        [*fiohost, "run", "e.toml", "--log", "run.csv", "--json", "run.json"],
        [*fiohost, "check", "run.csv"],
        [*fiohost, "identify", "run.csv", "--from", "duty", "--save-model", "m.toml", "--plot", "p.png", "--json", "-"],
        [*fiohost, "simulate", "run.csv", "--model", "m.toml", "-o", "sim.csv"],
        [*fiohost, "effects", "--brief"],
    ]


def run(row: Row, work: Path) -> str:
    """What came of it: ``ok`` with seconds, ``ABSENT``, or the command that failed and its last words."""
    interpreter = interpreter_of(row.python)
    if interpreter is None:
        return f"ABSENT: there is no python{row.python} on this computer"
    began = time.monotonic()
    venv, folder = work / f"venv-{row.python}-{row.numpy}", work / row.folder
    folder.mkdir(exist_ok=True)
    python = str(venv / "bin" / "python")
    if not venv.exists():
        wanted = NUMPY[row.numpy].get(row.python)
        packages = [str(ROOT), *([f"numpy=={wanted}"] if wanted else [])]
        for command in ([interpreter, "-m", "venv", str(venv)], [python, "-m", "pip", "install", "-q", *packages]):
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
            if done.returncode:
                shutil.rmtree(venv, ignore_errors=True)
                return f"FAILED to install: {(done.stdout + done.stderr).strip()[-200:]}"
    environment = {k: v for k, v in os.environ.items() if k not in row.environment and not k.startswith("PYTHON")}
    environment |= {k: v for k, v in row.environment.items() if v is not None}
    (folder / "e.toml").write_text(STEP)
    for command in commands([python, "-m", "fiohost"]):
        done = subprocess.run(
            [*command, *(["--force"] if "effects" not in command else [])],
            cwd=folder, env=environment, capture_output=True, timeout=LIMIT_S, check=False,
        )  # fmt: skip
        said = (done.stdout + done.stderr).decode(errors="replace")
        if done.returncode or "Traceback" in said:
            return f"FAILED: fiohost {command[3]}: exit {done.returncode}: {said.strip()[-300:]}"
    return f"ok in {time.monotonic() - began:.0f} s"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--sample", action="store_true", help="one of each kind")
    parser.add_argument("--only", default="", metavar="WORDS", help="rows whose name has WORDS in it")
    parser.add_argument("--list", action="store_true", help="say what there is, and do nothing")
    parser.add_argument("--without", action="append", default=[], choices=PYTHONS, help="known to be absent here")
    asked = parser.parse_args()
    rows = [row for row in ROWS if (row.sampled or not asked.sample) and asked.only in row.name]
    if asked.list:
        print("\n".join(row.name for row in rows))
        return 0
    counts = dict.fromkeys(KINDS, 0)
    unasked = 0
    with tempfile.TemporaryDirectory() as work:
        for row in rows:
            result = run(row, Path(work))
            kind = result.split()[0].rstrip(":")
            counts[kind] += 1
            unasked += kind == "ABSENT" and row.python not in asked.without
            print(f"{'!!! ' if kind != 'ok' else ''}{row.name}: {result}", flush=True)
    print(f"{len(rows)} circumstances: {', '.join(f'{count} {kind}' for kind, count in counts.items())}")
    if unasked:
        print(
            f"!!! {unasked} OF {len(rows)} CIRCUMSTANCES WERE NOT TRIED: install their Python, or name it by --without"
        )
    return 1 if counts["FAILED"] or unasked else 0


if __name__ == "__main__":
    sys.exit(main())
