"""Small mistakes put into the program one at a time: do the tests notice?

    python benchmarks/mutations.py                      every mutant of every file below
    python benchmarks/mutations.py --only bench/limits  those of some files
    python benchmarks/mutations.py --sample 40          so many, drawn by --seed

Comparisons get their neighbour, sums and products their inverse, numbers one more, conditions their opposite. A mutant
is killed when the tests of its file fail. Survivors are listed with their line: to be explained, or to be tested.
"""

from __future__ import annotations

import argparse
import ast
import copy
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
LIMIT_S = 300
FILES = {
    "fiohost/bench/limits.py": ("test_limits_hold.py", "test_edges.py"),
    "fiohost/bench/unwrap.py": ("test_edges.py", "test_log.py"),
    "fiohost/bench/guard.py": ("test_motor_guard.py",),
    "fiohost/bench/integrity.py": ("test_integrity.py",),
    "fiohost/bench/host.py": ("test_real_time.py", "test_guardian.py"),
    "fiohost/bench/line.py": ("test_real_time.py", "test_bench.py", "test_serial_line.py"),
    "fiohost/bench/rest.py": ("test_edges.py", "test_safe_stops.py", "test_bench.py"),
    "fiohost/bench/writer.py": ("test_log.py", "test_edges.py", "test_integrity.py"),
    "fiohost/files.py": ("test_files.py",),
    "fiohost/transport/hid.py": ("test_hid_line.py",),
    "fiohost/transport/serial.py": ("test_serial_line.py",),
    "fiohost/wire/crc.py": ("test_framing.py",),
    "fiohost/wire/layout.py": ("test_wire.py", "test_framing.py"),
    "fiohost/wire/link.py": ("test_framing.py", "test_serial_line.py"),
    "fiohost/wire/messages.py": ("test_wire.py", "test_framing.py"),
    "fiohost/wire/stream.py": ("test_framing.py",),
}
NEIGHBOURS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
}  # fmt: skip


@dataclass(frozen=True)
class Mutant:
    """One changed file: its text, and what was changed where."""

    path: str
    line: int
    what: str
    text: str


def mutants(path: str) -> Iterator[Mutant]:
    source = (ROOT / path).read_text()
    tree = ast.parse(source)
    count = sum(1 for _ in _places(tree))
    for index in range(count):
        changed = copy.deepcopy(tree)
        place = list(_places(changed))[index]
        line, what = _change(place)
        if what:
            yield Mutant(path, line, what, ast.unparse(ast.fix_missing_locations(changed)))


def _places(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that can be changed; what is only said (messages, annotations) is left alone."""
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, (ast.JoinedStr, ast.Raise, ast.arg)):
            continue
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                yield from _places(ast.Expression(body=node.value))
            continue
        if isinstance(node, (ast.Compare, ast.BinOp, ast.BoolOp, ast.UnaryOp, ast.Constant)):
            yield node
        yield from _places(node)


def _change(node: ast.AST) -> tuple[int, str]:
    """Change a node; line and words, no words where it stays as it is."""
    line = getattr(node, "lineno", 0)
    before = ast.unparse(node)
    if isinstance(node, ast.Compare) and type(node.ops[0]) in NEIGHBOURS:
        node.ops[0] = NEIGHBOURS[type(node.ops[0])]()  # type: ignore[call-overload]
    elif isinstance(node, ast.BinOp | ast.BoolOp) and type(node.op) in NEIGHBOURS:
        node.op = NEIGHBOURS[type(node.op)]()  # type: ignore[assignment]
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        node.op = ast.UAdd()
        node.operand = ast.Call(ast.Name("bool", ast.Load()), [node.operand], [])
    elif isinstance(node, ast.Constant) and isinstance(node.value, bool):
        node.value = not node.value
    elif isinstance(node, ast.Constant) and isinstance(node.value, (int, float)):
        node.value = node.value + 1
    else:
        return line, ""
    return line, f"{before}  ->  {ast.unparse(node)}"


def is_killed(mutant: Mutant, checkout: Path) -> bool:
    target = checkout / mutant.path
    kept = target.read_text()
    target.write_text(mutant.text)
    tests = [str(checkout / "tests" / name) for name in FILES[mutant.path]]
    environment = {**os.environ, "PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"}
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "--rootdir", str(checkout), *tests]
    try:
        done = subprocess.run(command, cwd=checkout, env=environment, capture_output=True, timeout=LIMIT_S, check=False)
        return done.returncode != 0
    except subprocess.TimeoutExpired:
        return True
    finally:
        target.write_text(kept)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", metavar="WORDS", help="files whose path has WORDS in it")
    parser.add_argument("--sample", type=int, default=0, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    found = [mutant for path in FILES if asked.only in path for mutant in mutants(path)]
    if asked.sample:
        found = random.Random(asked.seed).sample(found, min(asked.sample, len(found)))
    survivors: list[Mutant] = []
    with tempfile.TemporaryDirectory() as folder:
        checkout = Path(folder) / "checkout"
        for name in ("fiohost", "firmware_model", "tests", "configs", "docs", "benchmarks"):
            shutil.copytree(ROOT / name, checkout / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", checkout)
        for mutant in found:
            if not is_killed(mutant, checkout):
                survivors.append(mutant)
                print(f"survives: {mutant.path}:{mutant.line}: {mutant.what}", flush=True)
    killed = len(found) - len(survivors)
    print(f"{killed} of {len(found)} mutants killed ({100.0 * killed / max(1, len(found)):.1f} %)")
    return 0 if killed >= 0.95 * len(found) else 1


if __name__ == "__main__":
    sys.exit(main())
