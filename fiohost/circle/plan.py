"""Which experiments the circle runs: a suite that shows every effect it can, and a fresh record nobody has seen."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import replace

from fiohost.bench.experiment import Experiment
from fiohost.bench.signals import RandomSteps

# One experiment three times, so that the bench's own repeatability is measured.
SUITE = ("staircase", "multisine", "multisine", "multisine", "pulses", "sine_slow", "square_170_190")
FRESH = "random_steps"


def suite(names: Sequence[str] = SUITE) -> list[Experiment]:
    """The experiments of a suite in order. Raises ConfigError for an unknown name."""
    return [Experiment.load(name) for name in names]


def fresh(seed: int | None = None) -> Experiment:
    """Random steps that were never run before: drawn from the system's randomness unless a seed is given."""
    drawn = secrets.randbelow(2**31) if seed is None else seed
    base = Experiment.load(FRESH)
    signals = tuple(replace(s, seed=drawn) if isinstance(s, RandomSteps) else s for s in base.command)
    return replace(base, name=f"{FRESH}_fresh", command=signals)


def log_names(experiments: Sequence[Experiment]) -> list[str]:
    """File names, numbered where an experiment is repeated."""
    names = [e.name for e in experiments]
    seen: dict[str, int] = {}
    found = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        found.append(f"{name}_{seen[name]}.csv" if names.count(name) > 1 else f"{name}.csv")
    return found
