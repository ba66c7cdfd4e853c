"""Values of an effect's parameters from which it is tried."""

from __future__ import annotations

from collections.abc import Sequence

from fiohost.motor.effect import Effect, Value

Trial = dict[str, Value]


def varied(effect: Effect, trials: Sequence[Trial], order: Sequence[int]) -> list[int]:
    """The order of trials with the best of each choice first: no choice is lost because another scores higher."""
    kinds = [tuple(trials[i][p.name] for p in effect.parameters if p.is_choice) for i in range(len(trials))]
    first = [i for n, i in enumerate(order) if kinds[i] not in [kinds[j] for j in order[:n]]]
    return [*first, *(i for i in order if i not in first)]
