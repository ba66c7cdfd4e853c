"""The null: what each of the library gains by chance, as bootstrap samples of the evidence say (Efron 1979)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class Null:
    """What bootstrap samples of a state reach: the deviance that the best of the library gains (``level``), what each
    effect gains that leaves a trace (``levels``), and how uneven their residuals are.
    """

    level: float
    levels: dict[str, float]
    unevenness: tuple[float, ...]

    def of(self, name: str) -> float:
        """The level of an effect; that of the whole library where it leaves no trace in a screen."""
        return self.levels.get(name, self.level)


# Whether what is asked of a null is plain by a few samples: then no more are drawn (Besag and Clifford 1991).
Decided = Callable[[Null], bool]
