"""The whole circle on one bench: run a suite, diagnose, run a fresh record, confirm, and only then open the seal.

Where the suite leaves rivals and an experiment would part them, that one is run too and all is diagnosed once more.
"""

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
from fiohost.discover.result import to_json
from fiohost.estimation.bench import joining
from fiohost.estimation.record import record_from_log
from fiohost.motor.model import Model

DECLARED = "linear+coulomb_friction"


@dataclass(frozen=True)
class FollowUp:
    """The experiment that was run to part rivals, and the diagnosis before it."""

    experiment: str
    log: Log
    first: Diagnosis

    def to_json(self, after: Diagnosis) -> dict[str, Any]:
        upcoming = self.first.outlook.next_experiment
        return {
            "experiment": self.experiment,
            "why": upcoming.why if upcoming else "",
            "log": str(self.log.path),
            "named_before": named(self.first),
            "named_after": named(after),
            "first_diagnosis": to_json(self.first),
        }


def named(found: Diagnosis) -> list[list[str]]:
    """For every effect that was found its name and those that the data cannot tell from it."""
    return [[step.effect, *step.indistinguishable_from] for step in found.steps]


@dataclass(frozen=True)
class Circle:
    """What one turn of the circle found; the seal is opened by the caller, after this exists.

    ``diagnosis`` is the last one, after the ``follow_up`` where there was one.
    """

    diagnosis: Diagnosis
    confirmation: Confirmation
    logs: tuple[Log, ...]
    fresh_log: Log
    follow_up: FollowUp | None = None

    def to_json(self, diagnosis: dict[str, Any], seal: dict[str, Any] | None) -> dict[str, Any]:
        return {
            "schema": "fiohost.circle/1",
            "target": self.fresh_log.metadata.get("target", ""),
            "logs": [str(log.path) for log in self.logs],
            "diagnosis": diagnosis,
            "follow_up": self.follow_up.to_json(self.diagnosis) if self.follow_up else None,
            "confirm": self.confirmation.to_json(),
            "seal": seal,
        }


def close_loop(
    bench: Bench,
    folder: Path,
    model: str | Model = DECLARED,
    *,
    experiments: Sequence[Experiment] | None = None,
    follow_up: bool = True,
    say: Callable[[str], None] = lambda text: None,
) -> Circle:
    """Run the suite on a bench, logging into ``folder``, diagnose, and confirm on a fresh record.

    ``follow_up`` allows one more experiment and diagnosis where these data leave rivals that it would part. The engine
    sees the logs only. Raises FiohostError; the bench brakes after every run whatever happens.
    """
    planned = list(suite() if experiments is None else experiments)
    logs = []
    for experiment, name in zip(planned, log_names(planned), strict=True):
        say(f"running {experiment.name}, {experiment.duration_s:.0f} s")
        logs.append(bench.run(experiment, folder / name))
    found = diagnose(logs, (), model, say=say)
    followed = _follow(bench, folder, found, say) if follow_up else None
    if followed:
        logs.append(followed.log)
        found = diagnose(logs, (), model, say=say)
    newest = fresh()
    say(f"running a fresh record: {newest.name}, {newest.duration_s:.0f} s")
    log = bench.run(newest, folder / f"{newest.name}.csv")
    (newly,) = joining([record_from_log(log)], [*found.train, *found.holdout])
    checked = confirm(newly, found.declared, found.final)
    return Circle(found, checked, tuple(logs), log, followed)


def _follow(bench: Bench, folder: Path, found: Diagnosis, say: Callable[[str], None]) -> FollowUp | None:
    """Run the experiment that would part the rivals; None where there are none, or none would."""
    upcoming = found.outlook.next_experiment
    if upcoming is None or upcoming.experiment is None or not upcoming.rivals:
        return None
    experiment = Experiment.load(upcoming.experiment)
    say(f"running {experiment.name} to tell rivals apart, {experiment.duration_s:.0f} s")
    return FollowUp(experiment.name, bench.run(experiment, folder / f"{experiment.name}_next.csv"), found)
