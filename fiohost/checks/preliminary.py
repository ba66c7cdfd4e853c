"""Before any dynamics: is the raw data sound, what does a command mean, what can the logs show?"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from fiohost.checks.finding import Finding, Skipped
from fiohost.checks.informative import Informative, inform
from fiohost.checks.kinematics import check
from fiohost.checks.repeating import differing
from fiohost.checks.said import Said
from fiohost.checks.semantics import Semantics, ask
from fiohost.estimation.record import Record
from fiohost.motor.model import Model


@dataclass(frozen=True)
class Preliminary:
    """What was seen of the logs before the diagnosis; it reports and warns."""

    kinematics: tuple[Finding, ...]
    skipped: tuple[Skipped, ...]
    semantics: Semantics | None
    data: Informative

    def to_json(self) -> dict[str, object]:
        """The keys of the diagnosis that this fills."""
        return {
            "kinematics": [f.to_json() for f in self.kinematics],
            "kinematics_skipped": [s.to_json() for s in self.skipped],
            "semantics": self.semantics.to_json() if self.semantics else None,
            "data": self.data.to_json(),
        }


def examine(
    train: Sequence[Record],
    holdout: Sequence[Record],
    model: Model,
    said: Mapping[str, Said],
    *,
    from_file: bool = False,
    say: Callable[[str], None] = lambda text: None,
) -> Preliminary:
    """Look at logs before anything is fitted. ``said`` is by record name; held-out raw data is checked, no more."""
    say("checking the raw data")
    records = [*train, *holdout]
    found, skipped = check(records, [said.get(r.name, Said()) for r in records])
    found = [*found, *differing(records)]
    fitted = [said.get(r.name, Said()) for r in train]
    data = inform(train, fitted, model.effects)
    say("asking what a command means")
    return Preliminary(tuple(found), tuple(skipped), ask(train, fitted, model, from_file=from_file), data)
