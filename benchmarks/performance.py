"""``docs/performance.md`` by one command: each benchmark below is run, and the page shows what it printed.

    python benchmarks/performance.py [--only startup,log_speed] [--page docs/performance.md]

With ``--only`` the other parts of the page stay as they are, with the day and the program that they were made with.
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
LIMIT_S = 1800.0


class Part(NamedTuple):
    """One benchmark: its title, how it is called, and what a reader has to know of it."""

    title: str
    arguments: tuple[str, ...]
    about: str


PARTS = {
    "startup": Part("The keyboard", (), "How long `fiohost --help` and `import fiohost` take, against importing the "
                    "library that every command is made with. Aim: at most twice, and below 50 ms."),
    "log_speed": Part("Logs", ("--repeats", "3"), "An hour at 200 Hz read and written as CSV. fiohost also checks "
                      "lengths, ranges and check sums. Aim: within twice the faster of pandas and pyarrow, for a table "
                      "that is all there; a run writes each row with a system call of its own, so that a killed host "
                      "loses none."),
    "kernel": Part("The simulation", ("--slices", "60"), "The fit's simulation against the same algorithm in C, built "
                   "here with `-O3 -march=native`. Aim: at most 1.1 times."),
}  # fmt: skip
HEAD = """# How fast it is

Made by `benchmarks/performance.py`: below each title stands what that benchmark printed, on the day, the machine and
the program that are named there. Ratios count more than seconds: both sides of each ran in turn on the same machine.
Where a machine did other things beside, the processor's time says more than the clock.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", default=",".join(PARTS), help="some of " + ", ".join(PARTS))
    parser.add_argument("--page", type=Path, default=PAGE)
    given = parser.parse_args()
    wanted = given.only.split(",")
    if unknown := [name for name in wanted if name not in PARTS]:
        parser.error(f"unknown: {', '.join(unknown)}; known are {', '.join(PARTS)}")
    before = sections(given.page.read_text()) if given.page.exists() else {}
    told = [HEAD]
    for name, part in PARTS.items():
        if name in wanted:
            print(f"{name} ...", flush=True)
            told.append(section(name, part))
        elif part.title in before:
            told.append(before[part.title])
    given.page.write_text("\n".join(text.rstrip("\n") + "\n" for text in told))


def section(name: str, part: Part) -> str:
    """Run one benchmark; its part of the page."""
    command = ["benchmarks/" + name + ".py", *part.arguments]
    ran = subprocess.run(
        [sys.executable, *command], cwd=HERE.parent, check=True, stdout=subprocess.PIPE, text=True, timeout=LIMIT_S
    )
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
