"""Runs the commands shown in the documents and puts their real output there.

Usage: ``python docs/tools/outputs.py [PAGE...]``.

Every fenced ``console`` block of a page is run in order in one temporary folder; lines after ``$ `` are commands, all
others are replaced by what the commands print.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent.parent
PAGES = ("README.md", "docs/user-guide.md")
BLOCK = re.compile(r"```console\n(.*?)```", re.DOTALL)


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


def run(block: str, folder: Path, environment: dict[str, str]) -> str:
    lines = []
    for command in commands(block):
        print(f"$ {command}", flush=True)
        done = subprocess.run(
            ["bash", "-c", command],
            cwd=folder,
            env=environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )
        lines.append(f"$ {command}")
        lines += [line.rstrip() for line in done.stdout.rstrip().splitlines()]
    return "```console\n" + "\n".join(lines) + "\n```"


def main(pages: list[str]) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        command = folder / "bin" / "fiohost"
        command.parent.mkdir()
        command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m fiohost.cli.main "$@"\n')
        command.chmod(0o755)
        environment = {
            **os.environ,
            "PATH": f"{command.parent}:{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT),
            "XDG_STATE_HOME": str(folder / "state"),
            "COLUMNS": "110",
        }
        for page in pages:
            path = ROOT / page
            work = folder / path.stem
            work.mkdir()
            parts = BLOCK.split(path.read_text(encoding="utf-8"))  # text, block, text, block, ... text
            parts[1::2] = [run(block, work, environment) for block in parts[1::2]]
            path.write_text("".join(parts), encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:] or list(PAGES))
