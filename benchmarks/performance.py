"""``docs/performance.md`` by one command: each benchmark below is run, and the page shows what it printed.

    python benchmarks/performance.py [--only startup,log_speed] [--small] [--page docs/performance.md]

With ``--only`` the other parts of the page stay as they are, with the day and the program that they were made with.
With ``--small`` the long ones take a smaller sample: hours become some ten minutes. The page shows how each was called.
"""

from __future__ import annotations

import argparse
import os
import platform
import re
import subprocess
import sys
import textwrap
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

from fiohost import __version__

HERE = Path(__file__).resolve().parent
PAGE = HERE.parent / "docs" / "performance.md"
LIMIT_S = 6 * 3600.0


class Part(NamedTuple):
    """One benchmark: its title, how it is called, what a reader has to know of it, and how for a smaller sample."""

    title: str
    arguments: tuple[str, ...]
    about: str
    small: tuple[str, ...] | None = None


PARTS = {
    "startup": Part("The keyboard", (), "How long `fiohost --help` and `import fiohost` take, against importing the "
                    "library that every command is made with; and the first use of all kernels, which are compiled "
                    "then and kept. Aim: at most twice, below 50 ms, and below 20 s."),
    "log_speed": Part("Logs", ("--repeats", "3"), "An hour at 200 Hz read and written as CSV. fiohost also checks "
                      "lengths, ranges and check sums. Aim: within twice the faster of pandas and pyarrow, for a table "
                      "that is all there; a run writes each row with a system call of its own, so that a killed host "
                      "loses none."),
    "kernel": Part("The simulation", ("--slices", "60"), "The fit's simulation against the same algorithm in C, built "
                   "here with `-O3 -march=native`. Aim: at most 1.1 times."),
    "simulators": Part("The simulation against other simulators", (), "The same equations and commands in programs "
                       "that simulate, which the benchmark installs from PyPI. `cannot` is what has no such term or no "
                       "such motor there. The furthest is that of the angle from a solution with events at a tolerance "
                       "of 1e-11."),
    "fits": Part("A fit", (), "One structure fitted to 60 s by programs that identify, and how far each is off on a "
                 "log that none saw. Ours looks for its first values itself and begins from several lags; least "
                 "squares over our kernel are given first values near enough."),
    "diagnosis": Part("A diagnosis", (), "Aims: growth with the log no worse than linear; an hour at 200 Hz within "
                      "5 minutes and 2 GiB; at 158 s of logs a median of 5 s of the processor for one effect, 15 s for "
                      "two.", ("--cases", "3")),
    "fleet": Part("A fleet", (), "A line test: motors drawn of one type, some of a bad lot (2 % unless it is "
                  "said), 20 s of log each.",
                  ("--motors", "60", "--bad", "0.1", "--short", "20")),
    "watch": Part("While it runs", (), "False alarms of `fiohost watch` in simulated days of normal running with "
                  "drifting temperature and load, and the delay from a change to its alarm. Aim: at most one false "
                  "alarm in 24 h.", ("--hours", "24", "--repeats", "1")),
}  # fmt: skip
HEAD = """# How fast it is

Made by `benchmarks/performance.py`: below each title stands what that benchmark printed, on the day, the machine and
the program that are named there. Ratios count more than seconds: both sides of each ran in turn on the same machine.
Where a machine did other things beside, the processor's time says more than the clock.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help="some of " + ", ".join(PARTS))
    parser.add_argument("--small", action="store_true", help="smaller samples")
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    wanted = given.only.split(",")
    if unknown := [name for name in wanted if name not in PARTS]:
        parser.error(f"unknown: {', '.join(unknown)}; known are {', '.join(PARTS)}")
    found = sections(given.page.read_text()) if given.page.exists() else {}
    for name in wanted:
        print(f"{name} ...", flush=True)
        found[PARTS[name].title] = section(name, PARTS[name], given.small)
        told = [HEAD, *(found[part.title] for part in PARTS.values() if part.title in found)]
        given.page.write_text("\n".join(text.rstrip("\n") + "\n" for text in told))  # what is done is not lost


def section(name: str, part: Part, small: bool) -> str:
    """Run one benchmark; its part of the page."""
    command = ["benchmarks/" + name + ".py", *(part.small if small and part.small else part.arguments)]
    ran = subprocess.run(
        [sys.executable, *command], cwd=HERE.parent, check=False, stdout=subprocess.PIPE, text=True, timeout=LIMIT_S
    )
    if ran.returncode != 0:
        sys.exit(f"{ran.stdout}\n{' '.join(command)} failed")  # what it had come to is not lost
    day = datetime.now(tz=UTC).date().isoformat()
    where = f"{day}, fiohost {__version__}, Python {platform.python_version()}, {platform.system()} "
    where += f"{platform.machine()}, {os.cpu_count()} cores"
    shown = f"```text\n$ python {' '.join(command)}\n{ran.stdout.rstrip()}\n```"
    return f"## {part.title}\n\n{textwrap.fill(part.about, 120)}\n\n{shown}\n\n*{where}*\n"


def sections(page: str) -> dict[str, str]:
    """The parts of a page by their titles."""
    return {text.partition("\n")[0]: "## " + text for text in re.split(r"^## ", page, flags=re.MULTILINE)[1:]}


if __name__ == "__main__":
    main()
