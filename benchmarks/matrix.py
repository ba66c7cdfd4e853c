"""The same checks under other circumstances: interpreters, old and new numpy, locales, homes, odd folders, an ordinary
user, no screen.

    python benchmarks/matrix.py             all of it
    python benchmarks/matrix.py --sample    one of each kind, as the gate does
    python benchmarks/matrix.py --list
    python benchmarks/matrix.py --without 3.12 --without 3.13    on a computer that has them not

Each row makes a virtual environment of its own, installs the checkout, and runs a log through run, check, identify,
simulate and a plot. In a folder that cannot be written the results go elsewhere, and a log there is refused. An
interpreter that is not on this computer fails the run, unless it was named by ``--without``:
what was not tried never passes for tried. The last line counts all three kinds.
"""

from __future__ import annotations

import argparse
import os
import pwd
import shutil
import subprocess
import sys
import tempfile
import threading
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field
from itertools import repeat
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PYTHONS = ("3.11", "3.12", "3.13")
NUMPY = {"oldest": {"3.11": "1.26.0", "3.12": "1.26.0", "3.13": "2.1.0"}, "newest": {}}
LIMIT_S = 1800
# Rows side by side, which wait for each other where they share an environment that is not built yet.
WORKERS = min(2, os.cpu_count() or 1)
BUILDING: defaultdict[str, threading.Lock] = defaultdict(threading.Lock)
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
    ordinary: bool = False  # as a user who is not root, where root starts it
    read_only: bool = False  # the folder
    at_home: bool = False  # with a home of its user's own, where what is compiled is kept


ROWS = (
    *(Row(f"Python {python}, {numpy} numpy", python, numpy, sampled=python == "3.11" and numpy == "oldest")
      for python in PYTHONS for numpy in NUMPY),
    Row("LANG=C", numpy="oldest", environment=NO_UTF8, sampled=True),  # in the sample's first environment
    Row("no HOME", environment={"HOME": None, "XDG_CACHE_HOME": None, "XDG_STATE_HOME": None}),
    Row("a home that cannot be written", environment={"HOME": "/proc/nowhere", "XDG_CACHE_HOME": None}),
    Row("blanks and umlauts", folder="Prüf stand ü"),
    Row("no display", environment={"DISPLAY": None, "WAYLAND_DISPLAY": None, "MPLBACKEND": None}),
    Row("an ordinary user without a home", environment={"HOME": "/nonexistent", "XDG_CACHE_HOME": None}, ordinary=True,
        folder="theirs"),
    Row("an ordinary user in a folder that cannot be written", ordinary=True, read_only=True, folder="shut",
        at_home=True, sampled=True),
)  # fmt: skip


def _as(row: Row) -> dict[str, Any]:
    """Arguments of subprocess for the row's user."""
    if not row.ordinary or os.geteuid():
        return {}
    return {"user": "nobody", "group": pwd.getpwnam("nobody").pw_gid, "extra_groups": []}


def interpreter_of(version: str, **user: Any) -> str | None:
    """A Python of that version that starts: on the path, of the system, or one that pyenv has and has not chosen."""
    kept = Path(os.environ.get("PYENV_ROOT", Path.home() / ".pyenv")) / "versions"
    names = [f"python{version}", f"/usr/bin/python{version}", f"/usr/local/bin/python{version}"]
    found = [*map(shutil.which, names), *sorted(map(str, kept.glob(f"{version}.*/bin/python{version}")))]
    for candidate in filter(None, found):
        with suppress(OSError):
            tried = [candidate, "-c", "import ensurepip"]
            if not subprocess.run(tried, capture_output=True, cwd="/", **user).returncode:
                return candidate
    return None


def commands(fiohost: list[str], to: Path | None) -> list[list[str]]:
    """All of them; results go into the folder *to*, or where they are run."""

    def out(name: str) -> str:
        return name if to is None else str(to / name)

    log, model = out("run.csv"), out("m.toml")
    return [
        [*fiohost, "run", "e.toml", "--log", log, "--json", out("run.json")],
        [*fiohost, "check", log],
        [*fiohost, "identify", log, "--from", "duty", "--save-model", model, "--plot", out("p.png"), "--json", "-"],
        [*fiohost, "simulate", log, "--model", model, "-o", out("sim.csv")],
        [*fiohost, "effects", "--brief"],
    ]


def _home(row: Row, work: Path) -> Path:
    """A home of the row's user alone."""
    home = work / "home"
    home.mkdir(mode=0o700)
    if row.ordinary and not os.geteuid():
        shutil.chown(home, "nobody")
    return home


def installed(row: Row, venv: Path, interpreter: str) -> str:
    """Install the checkout where it is not yet; what went wrong, or nothing."""
    if venv.exists():
        return ""
    python, wanted = str(venv / "bin" / "python"), NUMPY[row.numpy].get(row.python)
    packages = [str(ROOT), *([f"numpy=={wanted}"] if wanted else [])]
    quick = shutil.which("uv", path=str(Path(sys.executable).parent))
    installer = [python, "-m", "pip"] if quick is None else [quick, "pip"]
    chosen = [] if quick is None else ["--python", python, "--refresh-package", "fiohost"]
    for command in ([interpreter, "-m", "venv", str(venv)], [*installer, "install", "-q", *chosen, *packages]):
        done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT_S, check=False)
        if done.returncode:
            shutil.rmtree(venv, ignore_errors=True)
            return f"FAILED to install: {(done.stdout + done.stderr).strip()[-200:]}"
    return ""


def run(row: Row, work: Path, venvs: Path) -> str:
    """What came of it in the folder ``work``: ``ok`` with seconds, ``ABSENT``, or the command that failed and its last
    words.
    """
    user = _as(row)
    interpreter = interpreter_of(row.python, **user)
    if interpreter is None:
        return f"ABSENT: there is no python{row.python} on this computer"
    began = time.monotonic()
    venv = venvs / f"venv-{row.python}-{row.numpy}{'-user' * bool(user)}"
    folder = work / row.folder
    folder.mkdir(parents=True)
    python = str(venv / "bin" / "python")
    with BUILDING[venv.name]:
        failed = installed(row, venv, interpreter)
    if failed:
        return failed
    environment = {k: v for k, v in os.environ.items() if k not in row.environment and not k.startswith("PYTHON")}
    environment |= {k: v for k, v in row.environment.items() if v is not None}
    if row.at_home:
        environment["HOME"] = str(_home(row, work))
        environment.pop("XDG_CACHE_HOME", None)
    (folder / "e.toml").write_text(STEP)
    to = work / f"{row.folder}-results" if row.read_only else None
    for place in (to, folder):
        if place is not None:
            place.mkdir(exist_ok=True)
            place.chmod(0o777)
    fiohost, how = [python, "-m", "fiohost"], {"cwd": folder, "env": environment, **user}

    def wrong(command: list[str], code: int = 0) -> str:
        words = [*command, *(["--force"] if "effects" not in command else [])]
        done = subprocess.run(words, capture_output=True, timeout=LIMIT_S, check=False, **how)
        said = (done.stdout + done.stderr).decode(errors="replace")
        if done.returncode == code and "Traceback" not in said:
            return ""
        return f"FAILED: fiohost {command[3]}: exit {done.returncode}: {said.strip()[-300:]}"

    if row.read_only:
        folder.chmod(0o555)
        failed = wrong([*fiohost, "run", "e.toml", "--log", "here.csv"], 1)
    for command in commands(fiohost, to):
        failed = failed or wrong(command)
    if failed:
        return failed
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
    with tempfile.TemporaryDirectory() as work, ThreadPoolExecutor(WORKERS) as pool:
        Path(work).chmod(0o755)
        folders = [Path(work) / f"row {i}" for i in range(len(rows))]
        for row, result in zip(rows, pool.map(run, rows, folders, repeat(Path(work))), strict=True):
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
