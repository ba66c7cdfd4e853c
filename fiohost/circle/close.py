"""The whole circle on one bench: run a suite, diagnose, run a fresh record, confirm, and only then open the seal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.circle.confirm import Confirmation, confirm
from fiohost.circle.evidence import diagnose
from fiohost.circle.plan import fresh, log_names, suite
from fiohost.discover.diagnose import Diagnosis
from fiohost.identify.record import record_from_log
from fiohost.motor.model import Model

DECLARED = "linear+coulomb_friction"


@dataclass(frozen=True)
class Circle:
    """What one turn of the circle found; the seal is opened by the caller, after this exists."""

    diagnosis: Diagnosis
    confirmation: Confirmation
    logs: tuple[Log, ...]
    fresh_log: Log

    def to_json(self, diagnosis: dict[str, Any], seal: dict[str, Any] | None) -> dict[str, Any]:
        return {
            "schema": "fiohost.circle/1",
            "target": self.fresh_log.metadata.get("target", ""),
            "logs": [str(log.path) for log in self.logs],
            "diagnosis": diagnosis,
            "confirm": self.confirmation.to_json(),
            "seal": seal,
        }


def close_loop(
    bench: Bench,
    folder: Path,
    model: str | Model = DECLARED,
    *,
    experiments: Sequence[Experiment] | None = None,
    say: Callable[[str], None] = lambda text: None,
) -> Circle:
    """Run the suite on a bench, logging into ``folder``, diagnose, and confirm on a fresh record.

    The engine sees the logs only. Raises FiohostError; the bench brakes after every run whatever happens.
    """
    planned = list(suite() if experiments is None else experiments)
    logs = []
    for experiment, name in zip(planned, log_names(planned), strict=True):
        say(f"running {experiment.name}, {experiment.duration_s:.0f} s")
        logs.append(bench.run(experiment, folder / name))
    found = diagnose(logs, (), model, say=say)
    newest = fresh()
    say(f"running a fresh record: {newest.name}, {newest.duration_s:.0f} s")
    log = bench.run(newest, folder / f"{newest.name}.csv")
    checked = confirm(record_from_log(log), found.declared, found.final)
    return Circle(found, checked, tuple(logs), log)
