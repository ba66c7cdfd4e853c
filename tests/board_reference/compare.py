"""The board's kernel beside the reference on one record of commands."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from firmware_model.hooks import slots
from firmware_model.layout import CONTACT, COUNT, CURRENT, LOAD_OMEGA, LOAD_THETA, OMEGA, SLIP, STOPPED, THETA
from firmware_model.motor import Motor
from firmware_model.plants import Plant

from .constants import STATES
from .machine import ATOL, RTOL, Reference, State

STEP_S = 0.005
NUDGE = 1e-9  # rad, at the start of a run whose sensitivity is asked for


@dataclass(frozen=True)
class Run:
    """What the board did: commands (n,), its states before each of them, and the counter."""

    plant: Plant
    modes: np.ndarray
    duties: np.ndarray
    states: tuple[State, ...]
    counts: np.ndarray
    edges: bool = False

    @property
    def two_bodies_with_play(self) -> bool:
        """Impacts make such a machine chaotic."""
        effects = self.plant.effects
        inertia = effects.get("backlash", {}).get("load_inertia_kgm2", 0.0) > 0.0 or "shaft_compliance" in effects
        return "backlash" in effects and inertia


def state_of(motor: Motor) -> State:
    """The board's state in the reference's order."""
    y, m = motor._y, motor._m
    x = np.zeros(STATES)
    x[:6] = y[[THETA, OMEGA, CURRENT, LOAD_THETA, LOAD_OMEGA, SLIP]]
    x[6:] = [y[slots()[name]] for name in ("armature_heating", "friction_warm_up", "gain_warm_up")]
    return State(x, float(m[CONTACT]), bool(m[STOPPED]))


def driven(plant: Plant, modes: np.ndarray, duties: np.ndarray, *, edges: bool = False) -> Run:
    """The board's motor under a record of commands; ``edges``: with every edge of the PWM resolved."""
    motor = Motor(plant, pwm="edge_resolved" if edges else "averaged")
    states, counts = [], np.zeros(len(duties), np.int64)
    for k in range(len(duties)):
        states.append(state_of(motor))
        counts[k] = motor._m[COUNT]
        motor.run(int(modes[k]), float(duties[k]), STEP_S)
    return Run(plant, modes, duties, tuple(states), counts, edges)


def solved(
    run: Run, first: int = 0, last: int | None = None, *, looser: float = 1.0, nudge: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Angles in degrees and counts of the reference from the board's state at ``first``, before each command."""
    start = State(run.states[first].x.copy(), run.states[first].contact, run.states[first].resting)
    start.x[[0, 3]] += nudge
    reference = Reference(run.plant, start, RTOL * looser, ATOL * looser, run.edges)
    angles, counts = reference.angles(run.modes, run.duties, STEP_S, first, last)
    return np.degrees(angles[:-1]), counts[:-1]


def shown(run: Run) -> np.ndarray:
    """Angles in degrees that the board's disc shows, (n,)."""
    reference = Reference(run.plant, run.states[0])
    bodies = [state.x[3] if reference.after else state.x[0] for state in run.states]
    return np.array([math.degrees(reference.encoder.shown(angle)) for angle in bodies])


def distance(run: Run, angles: np.ndarray) -> float:
    """Largest distance in degrees between the board and angles of the reference for the whole run."""
    return float(np.max(np.abs(shown(run) - angles)))


def windows(run: Run, span: int) -> float:
    """Largest distance in degrees where the reference begins anew from the board's state every ``span`` steps."""
    board = shown(run)
    worst = 0.0
    for first in range(0, len(board), span):
        last = min(first + span, len(board))
        angles, _ = solved(run, first, last)
        worst = max(worst, float(np.max(np.abs(board[first:last] - angles))))
    return worst


def sensitivity(run: Run, angles: np.ndarray) -> float:
    """How far a nudge of 1e-9 rad at the start moves the reference itself, in degrees."""
    return float(np.max(np.abs(angles - solved(run, nudge=NUDGE)[0])))
