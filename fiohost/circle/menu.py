"""The menu from which the next experiment is chosen: shipped experiments, as what they would command."""

from __future__ import annotations

import numpy as np

from fiohost.advice.next_experiment import Offer
from fiohost.bench.experiment import Experiment
from fiohost.motor.state import BRAKE, DRIVE, STANDBY

# Open loop, so that what they command does not hang on the plant.
MENU = (
    "staircase", "pulses", "multisine", "multisine_fast", "triangle_slow", "sine_slow", "sines_small", "reversals",
    "turns_slow", "starts_slow", "steps_from_rest", "coast", "ramp_full", "soak",
)  # fmt: skip


def offer(experiment: Experiment) -> Offer:
    """What an open-loop experiment would command."""
    duty, standby = experiment.levels()
    times = np.arange(experiment.ticks) * experiment.sample_time_s
    modes = np.where(standby, STANDBY, np.where(duty == 0.0, BRAKE, DRIVE))
    return Offer(experiment.name, experiment.title, times, duty, modes)


def menu() -> list[Offer]:
    return [offer(Experiment.load(name)) for name in MENU]
