"""Small mistakes put into the program one at a time: do the tests notice?

    python benchmarks/mutations.py --sample 200 --seed 1     so many, drawn from all of wire, transport and bench
    python benchmarks/mutations.py --only bench/limits       all of some files
    python benchmarks/mutations.py --keep folder ...         look again which test runs which line where tests changed
    python benchmarks/mutations.py --controls 10 ...         files as they are among them: no test may fail for those

Comparisons get their neighbour, sums and products their inverse, numbers one more, conditions their opposite; calls
made for what they do alone are left out, ``break`` and ``continue`` change places. First the tests run once and
coverage.py notes which of them (and which of the programs that they start) come by each line. A mutant is run against
those alone, short ones first, and is killed when one fails. Prints survivors with their line, and the killed share with
its 95 % interval.
"""

from __future__ import annotations

import argparse
import ast
import copy
import hashlib
import json
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NoReturn

import pytest
from scipy.stats import beta

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("fiohost/wire", "fiohost/transport", "fiohost/bench")
TESTS = (
    "api", "bench", "bench_parts", "board", "cli_drive", "coming_to_rest", "deadband_methods", "deadband_parts",
    "doctor", "doctor_parts", "edges", "exact_bounds", "exact_steps", "experiments", "faults", "framing",
    "front_door", "guardian", "guardian_alone", "guardian_host", "hid_calls", "hid_line", "in_hand", "instruments",
    "integrity", "limits_hold", "line_ticks", "lines", "lines_around_lines", "links_and_streams", "log",
    "log_numbers", "log_rows", "log_writing", "long_logs", "manual_keys", "motor_guard", "nodes_and_locks",
    "rate_and_clock", "readings", "real_time", "safe_stops", "serial_calls", "serial_line", "served_board",
    "signal_values", "signals_and_terminals", "small_tables", "statements", "stop_keys", "table_log",
    "target_profiles", "targets_and_seals", "time_convention", "trace", "trace_events", "watching", "wire",
    "wire_bounds",
)  # fmt: skip
APART = {  # tests of files that run where coverage.py cannot look, or that only slow tests come by
    "fiohost/bench/guardian_process.py": ("tests/test_guardian_alone.py", "tests/test_guardian.py"),
    "fiohost/bench/hand.py": ("tests/test_statements.py", "tests/test_api.py"),
    "fiohost/transport/emulated.py": ("tests/test_lines_around_lines.py", "tests/test_emulated_targets.py"),
}
COPIED = ("fiohost", "firmware_model", "firmware", "tests", "configs", "docs", "benchmarks")
PARTS = 3
BUDGET_S = 30.0  # of tests for a mutant, by what they took in the first run; what is beyond is said
NOTHING = "as it is"  # what was changed, of a control
LIMIT_S = 120.0  # beside ten times what the tests took: a mutant that hangs is killed, and counted as such
WARM = "tests/test_statements.py"  # compiles the simulation: that is done once, before a limit counts
ASKED = "FIOHOST_MUTANT"
# in the tests and in each program that they start: one module is loaded from another file
HOOK = f"""
import importlib.util, os, sys
name, _, file = os.environ.get("{ASKED}", "").partition("=")
class Finder:
    @staticmethod
    def find_spec(asked, path=None, target=None):
        return importlib.util.spec_from_file_location(name, file) if asked == name else None
if name:
    sys.meta_path.insert(0, Finder)
"""
LIBRARIES = (
    "click", "coverage", "hypothesis", "numba", "numpy", "rich.console", "scipy.optimize", "scipy.signal",
    "scipy.special", "serial", "tornado.web",
)  # loaded once  # fmt: skip
NEIGHBOURS: dict[type[ast.AST], type[ast.AST]] = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or, ast.Or: ast.And,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.FloorDiv: ast.Mult,
}  # fmt: skip
PROMISES = {"dataclass": ("frozen", "kw_only"), "zip": ("strict",)}  # arguments that change no run that is right


@dataclass(frozen=True)
class Mutant:
    """One changed place of a file; *inside* tells a function's line from a module's."""

    path: str
    index: int
    line: int
    what: str
    inside: bool

    @property
    def text(self) -> str:
        """Of the whole file."""
        changed = ast.parse((ROOT / self.path).read_text())
        if self.what == NOTHING:
            return ast.unparse(changed)
        _change(list(_places(changed))[self.index])
        return ast.unparse(ast.fix_missing_locations(changed))


@dataclass
class Covered:
    """Which test comes by which line (path, line: names), and how long each took (s)."""

    by_line: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    seconds: dict[str, float] = field(default_factory=dict)
    files: dict[str, str] = field(default_factory=dict)  # what was looked at, and the digest of each
    budget_s: float = BUDGET_S
    limit_s: float = LIMIT_S
    also: list[str] = field(default_factory=list)  # written since
    alone: bool = False  # whether the others have been tried

    def take(self, newer: Covered) -> None:
        """What *newer* found of its files in the place of what was known of them."""
        old = {name for name in self.seconds if name.partition("::")[0] in newer.files}
        self.seconds = {name: s for name, s in self.seconds.items() if name not in old} | newer.seconds
        for lines in self.by_line.values():
            for line, names in lines.items():
                lines[line] = [name for name in names if name not in old]
        for path, found in newer.by_line.items():
            lines = self.by_line.setdefault(path, {})
            for line, names in found.items():
                lines[line] = sorted({*lines.get(line, []), *names})
        self.files |= newer.files

    def of(self, mutant: Mutant) -> list[str]:
        """Tests to run, short ones first. A module's own line belongs to all who come by its functions."""
        lines = self.by_line.get(mutant.path, {})
        if self.alone:
            return self.also
        if mutant.path in APART:
            return [*self.also, *APART[mutant.path]]
        if mutant.inside:
            found = set(lines.get(mutant.line, []))
        else:
            found = {name for names in lines.values() for name in names}
        return [*self.also, *sorted(found, key=lambda name: self.seconds.get(name, 0.0))]


# ---- the mistakes ---------------------------------------------------------------------------------------------------


def mutants(path: str) -> Iterator[Mutant]:
    """All of one file; their texts are made when they are wanted."""
    tree = ast.parse((ROOT / path).read_text())
    inside = {
        line
        for node in ast.walk(tree)
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda))
        for part in (node.body if isinstance(node.body, list) else [node.body])
        for line in range(part.lineno, (part.end_lineno or part.lineno) + 1)
    }
    for index, place in enumerate(_places(tree)):
        line, what = _change(copy.deepcopy(place))
        if what:
            yield Mutant(path, index, line, what, line in inside)


def _places(tree: ast.AST) -> Iterator[ast.AST]:
    """Nodes that can be changed. Left alone is what is only said (messages, the program's own log, annotations), and
    what no run of a right program can show: what may be written to a dataclass, and whether zip finds lengths equal.
    """
    promises = PROMISES.get(tree.func.id, ()) if isinstance(tree, ast.Call) and isinstance(tree.func, ast.Name) else ()
    for node in ast.iter_child_nodes(tree):
        if isinstance(node, ast.keyword) and node.arg in promises:
            continue
        if isinstance(node, (ast.JoinedStr, ast.Raise, ast.arg)) or _is_said(node):
            continue
        if isinstance(node, ast.AnnAssign):
            if node.value is not None:
                yield from _places(ast.Expression(body=node.value))
            continue
        if isinstance(node, (ast.Compare, ast.BinOp, ast.BoolOp, ast.UnaryOp, ast.Constant, ast.Break, ast.Continue)):
            yield node
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Call):
            yield node
        yield from _places(node)


def _is_said(node: ast.AST) -> bool:
    """A statement for the program's own log, or a note for an error."""
    if not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Call)):
        return False
    called = ast.unparse(node.value.func)
    return called.startswith("logger.") or called.endswith(".add_note")


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
    elif isinstance(node, ast.Expr):
        node.value = ast.Constant(None)
    elif isinstance(node, ast.Break | ast.Continue):
        node.__class__ = ast.Continue if isinstance(node, ast.Break) else ast.Break  # type: ignore[assignment]
    else:
        return line, ""
    return line, f"{before}  ->  {ast.unparse(node)}"


# ---- the tests ------------------------------------------------------------------------------------------------------


def in_a_child(do: Callable[[], int], limit_s: float) -> int | None:
    """Exit code of what a child of its own does, with the libraries loaded already; None where it took too long."""
    return in_children([(do, None)], limit_s)[0]


def in_children(each: Sequence[tuple[Callable[[], int], Path | None]], limit_s: float) -> list[int | None]:
    """As :func:`in_a_child`, for some beside each other; what they say goes to files."""
    children, codes = [], dict[int, int | None]()
    for do, said in each:
        children.append(os.fork())
        if not children[-1]:
            _be_a_child(do, said)
    deadline_s = time.monotonic() + limit_s
    try:
        while len(codes) < len(children) and time.monotonic() < deadline_s:
            for child in children:
                if child not in codes:
                    ended, status = os.waitpid(child, os.WNOHANG)
                    codes |= {child: os.waitstatus_to_exitcode(status)} if ended else {}
            time.sleep(0.02)
    finally:
        for child in children:
            with suppress(ProcessLookupError):  # what it started, and itself where it is too slow
                os.killpg(child, signal.SIGKILL)
            with suppress(ChildProcessError):
                os.waitpid(child, 0)
    return [codes.get(child) for child in children]


def _be_a_child(do: Callable[[], int], said: Path | None) -> NoReturn:
    code = 3
    try:
        os.setsid()
        nowhere = os.open(os.devnull, os.O_RDWR)
        out = nowhere if said is None else os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
        for fd, to in ((0, nowhere), (1, out), (2, out)):
            os.dup2(to, fd)
        code = do()
    finally:
        os._exit(code)


def tested(checkout: Path, names: Sequence[str], *plugins: object) -> int:
    """Run tests of the copy (in a child); pytest's exit code."""
    os.chdir(checkout)
    more = {"PYTHONPATH": str(checkout), "PYTHONDONTWRITEBYTECODE": "1", "CI": "1"}
    os.environ.update(more | {"XDG_CACHE_HOME": str(checkout.parent / "cache")})
    sys.path[:0] = [str(checkout), str(checkout / "tests")]
    sys.dont_write_bytecode = True
    return int(pytest.main(["-q", "-p", "no:cacheprovider", "--rootdir", str(checkout), *names], list(plugins)))


class Contexts:
    """Tells coverage.py which test goes on, and keeps how long each took."""

    def __init__(self, kept: Path) -> None:
        self._kept = kept
        self._left_out: set[str] = set()
        self.seconds: dict[str, float] = {}

    @staticmethod
    def pytest_runtest_setup(item: Any) -> None:
        from coverage import Coverage

        now = Coverage.current()
        if now is not None:
            now.switch_context(item.nodeid)

    def pytest_runtest_logreport(self, report: Any) -> None:
        self.seconds[report.nodeid] = self.seconds.get(report.nodeid, 0.0) + report.duration
        if report.outcome != "passed":
            self._left_out.add(report.nodeid)
        passed = {name: s for name, s in self.seconds.items() if name not in self._left_out}
        self._kept.write_text(json.dumps(passed))


def coverage_of(checkout: Path, files: dict[str, str]) -> Covered:
    """Run the tests of *files* once, some beside others. The programs that they start note their lines under the test's
    name too. Tests that fail while they are watched (such as those that fill the disk) are left out.
    """
    rules, data = checkout.parent / "coverage.ini", checkout.parent / "data"
    folders = ",".join(f"*/{package}/*" for package in PACKAGES)
    rules.write_text(
        f"[run]\nparallel = true\npatch = subprocess, _exit\nsigterm = true\ninclude = {folders}\n"
        f"data_file = {data / 'c'}\ncontext = ${{PYTEST_CURRENT_TEST-}}\n"
    )
    shutil.rmtree(data, ignore_errors=True)
    data.mkdir()
    kept = [(data / f"seconds{part}.json", data / f"said{part}.txt") for part in range(min(PARTS, len(files)))]

    def run(part: int) -> int:
        from coverage import Coverage

        noted = Coverage(config_file=str(rules), context="")
        noted.start()
        code = tested(checkout, list(files)[part::PARTS], Contexts(kept[part][0]))
        noted.stop()
        noted.save()
        return code

    in_children([(partial(run, part), said) for part, (_, said) in enumerate(kept)], 3600.0)
    covered = Covered(files=files)
    for seconds, _ in kept:
        covered.seconds |= json.loads(seconds.read_text()) if seconds.exists() else {}
    return _read(data, checkout, covered)


def _read(folder: Path, checkout: Path, covered: Covered) -> Covered:
    from coverage import CoverageData

    for part in folder.glob("c.*"):
        data = CoverageData(basename=str(part))
        with suppress(Exception):  # of a program that was killed while it wrote
            data.read()
        for file in data.measured_files():
            path = str(Path(file).relative_to(checkout))
            lines = covered.by_line.setdefault(path, {})
            for line, contexts in data.contexts_by_lineno(file).items():
                names = {context.partition(" (")[0] for context in contexts} & covered.seconds.keys()
                lines[line] = sorted({*lines.get(line, []), *names})
    return covered


def outcome(mutant: Mutant, covered: Covered, checkout: Path) -> str:
    """``killed``, ``killed: hangs``, ``survives``, with words on what was not run."""
    asked, spent_s = [], 0.0
    tests = covered.of(mutant)
    for name in tests:
        spent_s += covered.seconds.get(name, 0.0)
        if spent_s > covered.budget_s and asked:
            break
        asked.append(name)
    if not asked:
        return "survives: no test comes by"
    real = checkout / mutant.path
    changed = real.with_name(f"mutant{os.getpid()}_{real.name}")  # beside it: what it looks for there is found
    changed.write_text(mutant.text)

    def run() -> int:
        name = mutant.path.removesuffix(".py").replace("/", ".")
        os.environ[ASKED] = f"{name}={changed}"
        exec((checkout / "sitecustomize.py").read_text(), {})
        return tested(checkout, ["-x", *asked])

    try:
        code = in_a_child(run, covered.limit_s + 10.0 * min(spent_s, covered.budget_s))
    finally:
        changed.unlink()
    if code is None:
        return "killed: hangs"
    if code:
        return "killed"
    return "survives" if len(asked) == len(tests) else f"survives: {len(asked)} of {len(tests)} tests were run"


# ---- the run --------------------------------------------------------------------------------------------------------


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", default="", metavar="WORDS", help="files whose path has WORDS in it")
    parser.add_argument("--sample", type=int, default=0, metavar="N")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="of which test runs which line, for the next time")
    parser.add_argument(
        "--again", type=Path, metavar="FILE", help="those that an earlier run printed there, with --also alone"
    )
    parser.add_argument("--also", action="append", default=[], metavar="TEST", help="tests for each, newer than --keep")
    parser.add_argument("--alone", action="store_true", help="no tests but those of --also")
    parser.add_argument("--limit", type=float, default=LIMIT_S, metavar="S", help="from here on a mutant hangs")
    parser.add_argument("--jobs", type=int, default=2, metavar="N", help="mutants beside each other")
    parser.add_argument("--budget", type=float, default=BUDGET_S, metavar="S", help="of tests for a mutant")
    parser.add_argument("--controls", type=int, default=0, metavar="N", help="files that nothing was done to, as well")
    parser.add_argument("--list", action="store_true", help="say what would be tried, and try nothing")
    asked = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda signum, frame: sys.exit(143))
    paths = [str(p.relative_to(ROOT)) for package in PACKAGES for p in sorted((ROOT / package).glob("*.py"))]
    found = [mutant for path in paths if asked.only in path for mutant in mutants(path)]
    drawn = random.Random(asked.seed).sample(found, min(asked.sample or len(found), len(found)))
    if asked.again:
        told = asked.again.read_text()
        drawn = [m for m in found if f"{m.path}:{m.line}: {m.what}\n" in told]
    controls = random.Random(asked.seed).sample(found, min(asked.controls, len(found)))
    print(f"{len(drawn)} of {len(found)} mutants of {len(paths)} files", flush=True)
    if asked.list:
        print("\n".join(f"{m.path}:{m.line}: {m.what}" for m in drawn))
        return 0
    sys.path = [path for path in sys.path if Path(path or ".").resolve() != ROOT]
    for library in LIBRARIES:
        import_module(library)
    with tempfile.TemporaryDirectory() as folder:
        kept = asked.keep or Path(folder)
        kept.mkdir(parents=True, exist_ok=True)
        checkout = kept.resolve() / "checkout"
        shutil.rmtree(checkout, ignore_errors=True)
        for name in COPIED:
            shutil.copytree(ROOT / name, checkout / name, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "pyproject.toml", checkout)
        (checkout / "sitecustomize.py").write_text(HOOK)
        alone = asked.alone or bool(asked.again)
        covered = Covered(alone=True) if alone else _covered(kept / "covered.json", checkout)
        in_a_child(partial(tested, checkout, [WARM]), 3600.0)
        covered.also, covered.budget_s, covered.limit_s = asked.also, asked.budget, asked.limit
        return _try([replace(m, what=NOTHING) for m in controls] + drawn, covered, checkout, asked.jobs)


def _covered(kept: Path, checkout: Path) -> Covered:
    """As it was kept, with the tests looked at that are new or have changed since."""
    names = [f"tests/test_{name}.py" for name in TESTS]
    digests = {name: hashlib.sha256((checkout / name).read_bytes()).hexdigest() for name in names}
    covered = Covered()
    if kept.exists():
        read = json.loads(kept.read_text())
        lines = {path: {int(k): v for k, v in of.items()} for path, of in read["by_line"].items()}
        covered = Covered(lines, read["seconds"], read["files"])
    covered.take(Covered(files={name: "" for name in covered.files if name not in digests}))  # they are gone
    new = {name: digest for name, digest in digests.items() if covered.files.get(name) != digest}
    if new:
        covered.take(coverage_of(checkout, new))
        kept.write_text(json.dumps({"by_line": covered.by_line, "seconds": covered.seconds, "files": covered.files}))
    return covered


def _try(drawn: list[Mutant], covered: Covered, checkout: Path, jobs: int) -> int:
    found = [checkout.parent / f"found{job}.txt" for job in range(jobs)]

    def work(job: int) -> int:
        with found[job].open("w") as file:
            for mutant in drawn[job::jobs]:
                came = outcome(mutant, covered, checkout)
                print(f"{came}: {mutant.path}:{mutant.line}: {mutant.what}", file=file, flush=True)
        return 0

    in_children([(partial(work, job), None) for job in range(jobs)], 24 * 3600.0)
    lines = [line for path in found for line in path.read_text().splitlines()]
    controls = [line for line in lines if line.endswith(f": {NOTHING}")]
    lines = [line for line in lines if line not in controls]
    print("\n".join(sorted(line for line in lines if not line.startswith("killed: fiohost"))))
    n, killed = len(lines), sum(line.startswith("killed") for line in lines)
    hung = sum(line.startswith("killed: hangs") for line in lines)
    low, high = (100.0 * x for x in _interval(killed, n))
    wrong = [line for line in controls if line.startswith("killed")]
    print("\n".join([*wrong, f"{len(wrong)} of {len(controls)} files as they are were taken for mutants"]))
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    share = f"{100.0 * killed / max(1, n):.1f} % ({low:.1f} to {high:.1f} %, 95 %)"
    print(f"{killed} of {n} mutants killed: {share}; {hung} of them hung")
    print(f"{sum(u.ru_utime + u.ru_stime for u in used) / 60.0:.1f} minutes of CPU")
    return 0 if len(lines) + len(controls) == len(drawn) and killed >= 0.95 * n and not wrong else 1


def _interval(k: int, n: int) -> tuple[float, float]:
    """Clopper and Pearson's 95 % interval of a share."""
    return (float(beta.ppf(0.025, k, n - k + 1)) if k else 0.0, float(beta.ppf(0.975, k + 1, n - k)) if k < n else 1.0)


if __name__ == "__main__":
    sys.exit(main())
