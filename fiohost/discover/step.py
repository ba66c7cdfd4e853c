"""What a search adds to a model, step by step, and what it comes to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic

from fiohost.discover.candidate import Candidate
from fiohost.discover.evidence import J
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise


@dataclass(frozen=True)
class Step(Generic[J]):
    """One effect that was added, what spoke for it, and the names it cannot be told from.

    ``rival_models`` are the fitted models of those that only this data cannot tell from it.
    """

    effect: str
    stage: J
    evidence: dict[str, object]
    indistinguishable_from: tuple[str, ...]
    rival_models: Mapping[str, Model] = field(default_factory=dict)


@dataclass(frozen=True)
class Found(Generic[J]):
    """The outcome of one search: the declared stage first, the final one last. ``one_clock`` says that its records were
    taken for one after the other. Where noise decided, ``noise`` is what is left, ``white`` whether it looks so,
    ``ruling`` what it follows else, and ``taken`` the share of the squared error of windows that the final
    structure takes there.
    """

    stages: tuple[J, ...]
    steps: tuple[Step[J], ...]
    offered: tuple[Candidate, ...]
    one_clock: bool = False
    noise: Noise | None = None
    white: bool = False
    ruling: tuple[str, ...] = ()
    taken: float = 0.0

    @property
    def declared(self) -> J:
        return self.stages[0]

    @property
    def final(self) -> J:
        return self.stages[-1]


def named_with(winner: str, rivals: Mapping[str, Model]) -> tuple[str, ...]:
    """The names that are said together with a winner: its exact equivalents, its rivals and theirs."""
    names = [n for name in (winner, *rivals) for n in (name, *effect(name).equivalents)]
    return tuple(n for n in dict.fromkeys(names) if n != winner)
