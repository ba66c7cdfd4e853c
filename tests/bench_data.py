"""Records made by the fit's own kernel, for tests of the estimation and of the search (not of the physics)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fiohost.estimation.record import Record, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, free_run

TICK_S = 0.005
QUANTUM_DEG = 0.5
TRUTH = {"linear.gain_deg_s_per_pct": 10.6, "linear.tau_s": 0.072}


def multisine(seconds: float, rng: np.random.Generator, amplitude_pct: float = 75.0) -> np.ndarray:
    """Fifteen sines from 0.05 to 6 Hz with random phases, in percent."""
    times = np.arange(round(seconds / TICK_S)) * TICK_S
    total = sum(np.sin(2 * np.pi * 0.05 * k**1.8 * times + rng.uniform(0, 6.3)) for k in range(1, 16))
    return np.asarray(amplitude_pct * total / np.abs(total).max())


def steps(seconds: float, rng: np.random.Generator, hold_s: float = 0.5) -> np.ndarray:
    """Random levels, each held for a while, in percent."""
    hold = round(hold_s / TICK_S)
    count = int(np.ceil(seconds / TICK_S / hold))
    return np.repeat(rng.uniform(-85, 85, count), hold)[: round(seconds / TICK_S)]


def measure(
    truth: Model, duty_pct: np.ndarray, rng: np.random.Generator, *, delay_ticks: int = 1, name: str = "made"
) -> Record:
    """What the bench would log of a motor that is exactly ``truth``: counts of half a degree, from rest."""
    times = np.arange(len(duty_pct)) * TICK_S
    excitation = Excitation(
        times,
        times + delay_ticks * TICK_S,
        np.concatenate(([0.0], duty_pct)),
        np.concatenate(([2], np.ones(len(times), dtype=np.int64))),
    )
    angle = free_run(truth, excitation, rng.uniform(0, QUANTUM_DEG), 0.0)
    counts = np.floor(angle / QUANTUM_DEG) * QUANTUM_DEG
    return make_record(
        name,
        times,
        duty_pct,
        counts,
        quantum=QUANTUM_DEG,
        sample_time_s=TICK_S,
        command_delay_s=delay_ticks * TICK_S,
        at_rest=True,
    )


def truth_model(
    effects: Sequence[str] = ("coulomb_friction",), values: Mapping[str, float | str] | None = None
) -> Model:
    given: dict[str, float | str] = dict(TRUTH)
    if "coulomb_friction" in effects:
        given["coulomb_friction.level_pct"] = 2.7
    return Model(effects=tuple(effects), values={**given, **(values or {})})


def suite(truth: Model, seed: int, seconds: float = 12.0) -> list[Record]:
    """Two multisines and two records of random steps."""
    rng = np.random.default_rng(seed)
    shapes = (multisine, steps, multisine, steps)
    return [measure(truth, shape(seconds, rng), rng, name=f"{shape.__name__}{i}") for i, shape in enumerate(shapes)]
