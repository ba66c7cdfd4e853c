"""Every room of the host knows those that the page of the house lists beside it, and no other."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "architecture.md"
ROW = re.compile(r"^\| `(\w+)` \| .* \| (.*) ?\|$", re.M)
ROOMS = {name: set(re.findall(r"`(\w+)`", knows)) for name, knows in ROW.findall(PAGE.read_text(encoding="utf-8"))}


def imported(file: Path) -> set[str]:
    """The second part of all names of this project that a file imports."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and node.module:
            names = [f"{node.module}.{a.name}" for a in node.names] if node.module == "fiohost" else [node.module]
        elif isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        else:
            continue
        found |= {n.split(".")[1] for n in names if n.startswith("fiohost.")}
    return found


def test_every_folder_of_the_host_is_a_room_of_the_page() -> None:
    folders = {p.parent.name for p in (ROOT / "fiohost").glob("*/__init__.py")}
    assert folders == set(ROOMS)


@pytest.mark.parametrize("room", sorted(set(ROOMS) - {"cli"}))
def test_a_room_knows_those_that_the_page_lists_and_no_other(room: str) -> None:
    known = set().union(*(imported(f) for f in (ROOT / "fiohost" / room).rglob("*.py")))
    assert known & (set(ROOMS) - {room}) == ROOMS[room]


def test_the_selection_knows_nothing_of_logs_or_tables() -> None:
    door = {"diagnose.py", "result.py"}
    for file in (ROOT / "fiohost" / "discover").glob("*.py"):
        if file.name not in door:
            text = file.read_text(encoding="utf-8")
            assert not re.search(r"fiohost\.discover\.(logs|tables)", text), file.name


def test_host_and_simulated_board_share_no_code() -> None:
    for here, other in (("fiohost/motor", "firmware_model"), ("firmware_model", "fiohost")):
        for file in (ROOT / here).rglob("*.py"):
            assert not re.search(rf"^\s*(from|import) {other}\b", file.read_text(encoding="utf-8"), re.M), file
