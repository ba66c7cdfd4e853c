"""How fast the fit's simulation kernel is: against the same algorithm in C, and against another checkout.

    python benchmarks/kernel.py [--slices N] [--against DIR] [--json FILE]

``kernel.c`` is built with ``cc -O3 -march=native`` into a temporary folder and called once a record. The two sides must
show the same angles; then they run in turn in short slices of the processor's time. The ratio of the fastest slices of
each side and the median of the ratios of neighbours both hold on a machine that does other things beside. With
``--against`` each effect of the library beside dry friction runs here and in the program in another folder, whose
kernel works in a process of its own, and so does the first simulation of all, with nothing compiled before.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import math
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

HERE = Path(__file__).parent
if "--serve" not in sys.argv:  # in the process of another checkout, its program comes first
    sys.path.insert(0, str(HERE.parent))

from fiohost.motor import kernel  # noqa: E402
from fiohost.motor.effect import effects  # noqa: E402
from fiohost.motor.model import Model  # noqa: E402
from fiohost.motor.simulate import Start, start_state  # noqa: E402
from fiohost.motor.state import LOAD_THETA, STATE_SIZE, THETA, WORK_SIZE  # noqa: E402

SAME_DEG, SAME_TWO_BODIES_DEG = 1e-6, 1e-3
LEAST_SLICE_S = 5e-4  # shorter runs are repeated within a slice
DRIVE = 1
DRY = {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08, "coulomb_friction.level_pct": 3.0}
# Effects beside dry friction that kernel.c knows, with sizes that show, and whether a second inertia moves by itself.
MODELS: dict[str, tuple[dict[str, dict[str, Any]], bool]] = {
    "dry friction": ({}, False),
    "inductance": ({"armature_inductance": {"time_constant_s": 0.004}}, False),
    "Stribeck": ({"stribeck_friction": {"extra_pct": 2.0, "stribeck_speed_deg_s": 60.0}}, False),
    "cogging": ({"cogging_torque": {"order": 12.0, "level_pct": 1.5, "phase_deg": 30.0}}, False),
    "backlash": ({"backlash": {"gap_deg": 3.0, "side": "encoder_before_gap", "load_inertia_ratio": 0.3}}, True),
    "compliance": ({"shaft_compliance": {"resonance_hz": 12.0, "damping_ratio": 0.05, "inertia_ratio": 0.3}}, True),
}
RECORDS = {"20 s at 5 ms": (20.0, 0.005), "10 s at 1 ms": (10.0, 0.001)}
FINE = ("Stribeck", "cogging", "backlash", "compliance")  # these at 1 ms as well
AGAINST = "20 s at 5 ms"
C_PARAMETERS = (
    "linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct", "armature_inductance.time_constant_s",
    "stribeck_friction.extra_pct", "stribeck_friction.stribeck_speed_deg_s", "stribeck_friction.shape",
    "cogging_torque.order", "cogging_torque.level_pct", "cogging_torque.phase_deg", "backlash.gap_deg",
    "share of the load", "shaft_compliance.resonance_hz", "shaft_compliance.damping_ratio",
)  # fmt: skip
C_STATES = 6  # angle and speed of motor and load, contact, current
Row = dict[str, Any]


class Pair(NamedTuple):
    """Seconds of one run on either side: the fastest of each, and the median of the ratios of neighbours."""

    mine_s: float
    other_s: float
    median: float

    @property
    def ratio(self) -> float:
        return self.mine_s / self.other_s


def commands(span_s: float, tick_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Times and duties (n) in percent: levels of a few tenths of a second, sines, and rests between them."""
    rng, n, duties = np.random.default_rng(1), round(span_s / tick_s), []
    while len(duties) < n:
        ticks = round(rng.uniform(0.2, 0.8) / tick_s)
        size, kind = rng.choice((-1.0, 1.0)) * math.exp(rng.uniform(math.log(2.0), math.log(90.0))), rng.integers(6)
        wave = np.sin(2.0 * math.pi * rng.uniform(0.5, 4.0) * tick_s * np.arange(ticks))
        duties += list(size * (wave if kind == 0 else np.zeros(ticks) if kind == 1 else np.ones(ticks)))
    return np.arange(n) * tick_s, np.array(duties[:n])


def model_of(parts: dict[str, dict[str, Any]]) -> Model:
    """Dry friction and these effects; parameters that the program at hand does not know stay out."""
    model = Model(("coulomb_friction",), DRY)
    for name, values in parts.items():
        known = [q.name for q in effects()[name].parameters]
        model = model.with_effect(name, {k: v for k, v in values.items() if k in known})
    return model


def numba_side(model: Model, record: str) -> tuple[Callable[[], None], np.ndarray]:
    """What runs the record in the kernel, and the array (n, STATE_SIZE) that its states are written to."""
    at, duties = commands(*RECORDS[record])
    p, on, n = model.vector(), model.switches(), len(at)
    before = np.concatenate(([0.0], duties))
    modes = np.full(n + 1, DRIVE)
    start, state, states = start_state(Start(0.2, 0.0), p, on), np.zeros(WORK_SIZE), np.empty((n, STATE_SIZE))
    substep = model.substep_s()

    def run() -> None:
        state[:STATE_SIZE], state[STATE_SIZE:] = start, 0.0
        kernel.simulate(at, at, before, modes, 0.0, 0, n, state, substep, p, on, states)

    return run, states


class CModel(ctypes.Structure):
    _fields_ = [(f"q{i}", ctypes.c_double) for i in range(len(C_PARAMETERS))]


class CState(ctypes.Structure):
    _fields_ = [(f"x{i}", ctypes.c_double) for i in range(C_STATES)]


def build(folder: Path) -> Any:
    """The C kernel. Leaves with a sentence where there is no compiler."""
    library = folder / "kernel.so"
    command = ["cc", "-O3", "-march=native", "-shared", "-fPIC", str(HERE / "kernel.c"), "-o", str(library), "-lm"]
    try:
        subprocess.run(command, check=True)
    except (OSError, subprocess.CalledProcessError) as exc:
        sys.exit(f"kernel.c cannot be built: {exc}; install a C compiler that is called cc")
    simulate = ctypes.CDLL(str(library)).simulate
    simulate.restype = None
    return simulate


def c_side(simulate: Any, model: Model, record: str) -> tuple[Callable[[], None], np.ndarray]:
    """As ``numba_side``, in C."""
    at, duties = commands(*RECORDS[record])
    before, states = np.concatenate(([0.0], duties)), np.empty((len(at), C_STATES))
    values = dict(model.values)
    values["share of the load"] = values.get(
        "backlash.load_inertia_ratio", values.get("shaft_compliance.inertia_ratio", 0)
    )
    values["stribeck_friction.shape"] = float(values.get("stribeck_friction.shape") == "gaussian")
    numbers = [float(values.get(key, 0.0)) for key in C_PARAMETERS]
    numbers[C_PARAMETERS.index("shaft_compliance.resonance_hz")] *= 2.0 * math.pi
    x = start_state(Start(0.2, 0.0), model.vector(), model.switches())
    start = CState(x[THETA], 0.0, x[LOAD_THETA], 0.0, 0.0, 0.0)
    pointers = [array.ctypes.data_as(ctypes.c_void_p) for array in (at, before, states)]
    n, q, substep = ctypes.c_long(len(at)), ctypes.byref(CModel(*numbers)), ctypes.c_double(model.substep_s())

    def run() -> None:
        simulate(q, pointers[0], n, pointers[0], n, pointers[1], substep, start, pointers[2])

    run()
    run.kept = (at, before, states)  # type: ignore[attr-defined]
    return run, states


def timer(run: Callable[[], None]) -> Callable[[], float]:
    """What times one slice: seconds of a run, the mean of as many as make a slice."""
    run()
    begin = time.thread_time()
    run()
    turns = max(round(LEAST_SLICE_S / (time.thread_time() - begin)), 1)

    def slice_s() -> float:
        begin = time.thread_time()
        for _ in range(turns):
            run()
        return (time.thread_time() - begin) / turns

    return slice_s


def in_turn(mine: Callable[[], float], other: Callable[[], float], slices: int) -> Pair:
    """Slices of both sides one after another, first this one and then that one."""
    mine_s, other_s = np.empty(slices), np.empty(slices)
    for i in range(slices):
        sides = ((mine, mine_s), (other, other_s))
        for run, spans in sides if i % 2 else reversed(sides):
            spans[i] = run()
    return Pair(float(mine_s.min()), float(other_s.min()), float(np.median(mine_s / other_s)))


def row_of(name: str, record: str, pair: Pair, **more: float) -> Row:
    span_s = RECORDS[record][0]
    figures = {"us_per_s": 1e6 * pair.mine_s / span_s, "other_us_per_s": 1e6 * pair.other_s / span_s}
    return {"model": name, "record": record, **figures, "ratio": pair.ratio, "median_ratio": pair.median, **more}


def against_c(slices: int) -> Iterable[Row]:
    """Each model of the table beside C, its angles compared first. Leaves with a sentence where they are not alike."""
    with tempfile.TemporaryDirectory() as folder:
        simulate = build(Path(folder))
        for record in RECORDS:
            for name in MODELS if record == AGAINST else FINE:
                parts, two = MODELS[name]
                model = model_of(parts)
                (mine, states), (other, c_states) = numba_side(model, record), c_side(simulate, model, record)
                mine(), other()
                apart = np.abs(states[:, THETA] - c_states[:, 0])
                if two:
                    apart = np.maximum(apart, np.abs(states[:, LOAD_THETA] - c_states[:, 2]))
                most = float(np.max(apart))
                if not most < (SAME_TWO_BODIES_DEG if two else SAME_DEG):
                    sys.exit(f"{name}, {record}: kernel and C differ by {most:.3g} deg, so they do not do the same")
                yield row_of(name, record, in_turn(timer(mine), timer(other), slices), apart_deg=most)


class Other:
    """The kernel of the program in another folder, in a process that times a slice when it is asked to."""

    def __init__(self, folder: Path) -> None:
        self.process = subprocess.Popen(
            [sys.executable, str(HERE / "kernel.py"), "--serve"],
            env={**os.environ, "PYTHONPATH": str(folder.resolve())},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        where = self.ask("where")
        if not isinstance(where, str) or Path(where).parent.resolve() != folder.resolve():
            sys.exit(f"{folder} holds no fiohost whose kernel this benchmark knows")

    def ask(self, question: Any) -> Any:
        if self.process.stdin is None or self.process.stdout is None:
            return None
        try:
            self.process.stdin.write(json.dumps(question) + "\n")
            self.process.stdin.flush()
            return json.loads(self.process.stdout.readline() or "null")
        except BrokenPipeError:
            return None

    def slice_s(self) -> float:
        return float(self.ask("slice"))


def serve() -> None:
    """Answer the questions of ``Other``: where this program is, which model to run, how long a slice of it takes."""
    run: Callable[[], float] | None = None
    for line in sys.stdin:
        question, answer = json.loads(line), None
        if question == "where":
            answer = str(Path(kernel.__file__).parent.parent)
        elif question == "slice" and run:
            answer = run()
        elif isinstance(question, dict):
            known = set(question) <= set(effects())
            run = timer(numba_side(model_of(question), AGAINST)[0]) if known else None
            answer = known
        print(json.dumps(answer), flush=True)


def against(folder: Path, slices: int) -> Iterable[Row]:
    """Each effect beside dry friction here and there, each at its first trial; those unknown there stay out."""
    other = Other(folder)
    singly = {name: {name: dict(e.trials[0]) if e.trials else {}} for name, e in effects().items()}
    singly["coulomb_friction"] = {}
    singly["backlash, two bodies"] = MODELS["backlash"][0]
    for name, parts in singly.items():
        if name != "linear" and other.ask(parts):
            pair = in_turn(timer(numba_side(model_of(parts), AGAINST)[0]), other.slice_s, slices)
            yield row_of(name, AGAINST, pair)
    other.process.terminate()


def cold(folder: Path, turns: int = 2) -> float:
    """CPU seconds of the first simulation of the program in a folder, its compilation included; the least of some."""
    code = (
        f"import sys, time; sys.argv.append('--serve'); sys.path.append({str(HERE)!r}); import kernel as k; "
        "run = k.numba_side(k.model_of({}), k.AGAINST)[0]; t = time.process_time(); run(); "
        "print(time.process_time() - t)"
    )
    spans = []
    for _ in range(turns):
        with tempfile.TemporaryDirectory() as cache:
            env = {**os.environ, "PYTHONPATH": str(folder.resolve()), "XDG_CACHE_HOME": cache}
            told = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, text=True, check=True)
            spans.append(float(told.stdout))
    return min(spans)


def show(rows: Iterable[Row], other: str) -> list[Row]:
    """Print a table as its rows come; microseconds are those of a simulated second."""
    print(f"{'model':28} {'record':14} {'us/s':>8} {other + ' us/s':>10} {'ratio':>6} {'median':>7}")
    kept = []
    for row in rows:
        apart = f"  apart {row['apart_deg']:.1e} deg" if "apart_deg" in row else ""
        print(
            f"{row['model']:28} {row['record']:14} {row['us_per_s']:8.2f} {row['other_us_per_s']:10.2f} "
            f"{row['ratio']:6.2f} {row['median_ratio']:7.2f}{apart}",
            flush=True,
        )
        kept.append(row)
    mean = math.exp(sum(math.log(row["ratio"]) for row in kept) / len(kept))
    print(f"{'geometric mean':28} {'':14} {'':8} {'':10} {mean:6.2f}\n", flush=True)
    return kept


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--slices", type=int, default=300, help="so many short slices of each side (300)")
    parser.add_argument("--against", type=Path, metavar="DIR", help="time another checkout of the program as well")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the rows to this file as well")
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.slices < 1:
        parser.error("--slices is 1 or more")
    if options.serve:
        serve()
        return
    found: dict[str, Any] = {"against_c": show(against_c(options.slices), "C")}
    if options.against:
        found["against"] = show(against(options.against, options.slices), "other")
        found["cold_cpu_s"] = {"here": cold(HERE.parent), "other": cold(options.against)}
        print(
            "first simulation with nothing compiled: {here:.1f} CPU s, other {other:.1f}".format(**found["cold_cpu_s"])
        )
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
