"""A saved model on a log's commands: the free run that anyone can check the figures with."""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from fiohost import __version__
from fiohost.bench.log import Log
from fiohost.estimation.bench import on_turn
from fiohost.estimation.record import Record, record_from_log, speed_unit
from fiohost.estimation.seen import seen_of
from fiohost.files import write_output
from fiohost.judging.metrics import Errors, Judgement, judge
from fiohost.judging.units import LOG_UNIT, STARTS, metres
from fiohost.motor.model import MM_PER_M, Model
from fiohost.motor.simulate import Start


@dataclass(frozen=True)
class Replay:
    """A free run: times and output (n), the initial state estimated on the first second, the figures against
    the log; ``beyond`` is where the log leaves what the model was fitted to.
    """

    time_s: np.ndarray
    output: np.ndarray
    output_name: str
    unit: str
    start: Start
    errors: Errors
    beyond: tuple[str, ...] = ()


def replay(log: Log, model: Model) -> Replay:
    """Simulate a model on the commands of a log. Raises ModelError, DataError."""
    record = record_from_log(log)
    model = model.on_axis(record.rotary).with_pwm(record.pwm_hz)
    record, found = _on_its_turn(record, model)
    beyond = model.seen.beyond(seen_of([record]), speed_unit(record.unit)) if model.seen else []
    start = found.start._replace(angle=found.start.angle - record.ahead_deg)
    y, errors = found.simulated - record.ahead_deg, found.errors
    if record.unit in LOG_UNIT:
        y = y / MM_PER_M
        start = start._replace(**metres({name: getattr(start, name) for name in STARTS}))
        errors = replace(errors, free_run_rms=metres(errors.free_run_rms), window_rms=metres(errors.window_rms))
    return Replay(log.time_s, y, log.output_name, log.output_unit, start, errors, tuple(beyond))


def _on_its_turn(record: Record, model: Model) -> tuple[Record, Judgement]:
    """A record that says no whole turns, and what is judged of it, on the turn that suits the model's ends of travel
    best: its own, or that on which its shaft came to one of them.
    """
    ways = [record]
    for item in (e for e in model.parts() if record.wraps and e.event is not None and e.angle_bound):
        end = model.number(f"{item.name}.{item.parameters[0].name}")
        side = 1.0 if end > 0.0 else -1.0
        room = abs(end) + record.quantum - float(np.max(side * record.y))
        ways.append(on_turn(record, int(side * (room // 360.0))))
    judged = [judge(way, model) for way in ways]
    best = min(range(len(ways)), key=lambda i: judged[i].errors.free_run_rms)
    return ways[best], judged[best]


def write_replay(path: Path, result: Replay, log: Log, model_name: str) -> None:
    """Write ``time_s`` and the output column, the initial state in the header. Raises LogError."""
    head = {
        "schema": "fiohost.simulation/1",
        "fiohost_version": __version__,
        "log": log.path.name,
        "log_sha256": log.sha256,
        "model": model_name,
        f"initial_{result.output_name}": repr(result.start.angle),
        "initial_speed": repr(result.start.speed),
        "initial_play": repr(result.start.play),
        "initial_drift": repr(result.start.drift),
        **({} if result.start.zero is None else {"initial_zero": repr(result.start.zero)}),
        "initial_state": "least squares on the first second of the log",
        "free_run_rms": f"{result.errors.free_run_rms:.6g} {result.unit}",
    }
    lines = [f"# {key}: {value}" for key, value in head.items()]
    lines.append(f"time_s,{result.output_name}")
    rows = io.StringIO()
    np.savetxt(rows, np.column_stack((result.time_s, result.output)), fmt=("%.9g", "%.12g"), delimiter=",")
    write_output(path, "\n".join(lines) + "\n" + rows.getvalue())
