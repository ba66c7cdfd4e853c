"""Worlds in which a bench does not repeat itself: what is laid over the simulated board and over its logs.

A torque acts in the simulation, as a hand on the shaft would; the sensor's noise, lost rows, stamps and wrong bits are
of the log alone. Everything is drawn from the case's seed.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from discovery_cases import Case, make_case, stall_Nm

from firmware_model import Board, Instruments
from firmware_model.plants import make_plant

# The sensor's noise is laid over a finer encoder, so that it is the shaft's angle that is noisy and not the count.
FINER = 16
COUNTS = 720
TICK_S = 0.005
# Lost in bursts: so many rows each, drawn evenly.
BURST_ROWS = (5, 20)
# A stamp is never so late that rows change places.
MOST_JITTER = 0.45
# What hangs on the bench's own time cannot be had where every run is of a board that was just switched on.
CLOCKED = ("armature_heating", "friction_warm_up", "parameter_change", "supply_drift")


@dataclass(frozen=True)
class World:
    """One way in which a bench is not exact.

    ``sensor_counts`` rms; ``torque_pct`` of duty rms with the correlation time ``torque_s``; shares of rows that are
    ``missing`` (in ``bursts`` or singly) or have ``wrong_bits``; ``jitter_s`` rms of the time stamps; ``varies``:
    relative sd of gain and dry friction and sd of an offset in percent of duty, from run to run.
    """

    name: str
    sensor_counts: float = 0.0
    torque_pct: float = 0.0
    torque_s: float = 0.0
    missing: float = 0.0
    bursts: bool = False
    jitter_s: float = 0.0
    wrong_bits: float = 0.0
    varies: tuple[float, float, float] = (0.0, 0.0, 0.0)

    @property
    def restarts(self) -> bool:
        return any(self.varies)

    @property
    def sensor_deg(self) -> float:
        return self.sensor_counts * 360.0 / COUNTS


WORLDS = (
    World("exact"),
    World("sensor 1 count", sensor_counts=1.0),
    World("sensor 3 counts", sensor_counts=3.0),
    World("torque 0.5 %, 0.1 s", torque_pct=0.5, torque_s=0.1),
    World("torque 0.5 %, 0.5 s", torque_pct=0.5, torque_s=0.5),
    World("torque 1 %, 0.1 s", torque_pct=1.0, torque_s=0.1),
    World("torque 1 %, 0.5 s", torque_pct=1.0, torque_s=0.5),
    World("1 % missing", missing=0.01),
    World("3 % missing", missing=0.03),
    World("1 % missing in bursts", missing=0.01, bursts=True),
    World("3 % missing in bursts", missing=0.03, bursts=True),
    World("stamps 1 ms", jitter_s=1e-3),
    World("wrong bits", wrong_bits=1.0 / 5000.0),
    World("run to run", varies=(0.01, 0.10, 1.0)),
    World("all but run to run", 1.0, 0.5, 0.1, missing=0.01, jitter_s=1e-3, wrong_bits=1.0 / 5000.0),
    World("all", 1.0, 0.5, 0.1, missing=0.01, jitter_s=1e-3, wrong_bits=1.0 / 5000.0, varies=(0.01, 0.10, 1.0)),
)
BY_NAME = {w.name: w for w in WORLDS}


class Hand:
    """A random torque on the shaft: an Ornstein-Uhlenbeck process, stepped exactly from tick to tick
    (Gillespie 1996).
    """

    def __init__(self, board: Board, offset_Nm: float, rms_Nm: float, time_s: float, rng: random.Random) -> None:
        self._board, self._furniture, self._rng = board, Instruments(board), rng
        self._offset, self._rms = offset_Nm, rms_Nm
        self._stays = math.exp(-TICK_S / time_s) if rms_Nm > 0.0 else 0.0
        self._torque = rng.gauss(0.0, rms_Nm)

    def step(self, report: bytes | None) -> bytes:
        self._torque = self._stays * self._torque + math.sqrt(1.0 - self._stays**2) * self._rng.gauss(0.0, self._rms)
        self._furniture.disturb(self._offset + self._torque)
        return self._board.step(report)


def _plant(case: Case, world: World, rng: random.Random) -> tuple[Any, float]:
    """The plant of one run, and the offset of its torque in percent of duty."""
    gain, friction, offset = world.varies
    values = {**case.values, "supply_V": case.values["supply_V"] * (1.0 + gain * rng.gauss(0.0, 1.0))}
    scale = max(1.0 + friction * rng.gauss(0.0, 1.0), 0.0)
    values["coulomb_Nm"] = case.values["coulomb_Nm"] * scale
    plant = make_plant(values, "case")
    return replace(plant, counts_per_rev=COUNTS * (FINER if world.sensor_counts else 1)), offset * rng.gauss(0.0, 1.0)


def run(world: World, seed: int, names: Sequence[str], experiments: Sequence[Any]) -> tuple[Case, list[Any]]:
    """The case of a seed and the logs of its experiments in a world."""
    from fiohost.bench.loop import Bench
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.simulated import SimulatedTransport

    case = make_case(seed, tuple(names))
    rng = random.Random(f"world {world.name} {seed}")
    per_pct = stall_Nm(case.values) / 100.0

    def bench() -> Bench:
        plant, offset = _plant(case, world, rng)
        board = Board(plant, seed=rng.randrange(2**31) if world.restarts else seed)
        hand = Hand(board, offset * per_pct, world.torque_pct * per_pct, world.torque_s, rng)
        line = SimulatedTransport(hand.step, "sim:sealed", "simulated", counts_per_rev=plant.counts_per_rev)
        return Bench(line, TargetProfile.load())

    logs: list[Any] = []
    groups = [[e] for e in experiments] if world.restarts else [list(experiments)]
    for group in groups:
        with bench() as running:
            logs += [running.run(e) for e in group]
    drawn = np.random.default_rng(rng.randrange(2**63))
    return case, [laid_over(log, world, drawn) for log in logs]


def laid_over(log: Any, world: World, rng: np.random.Generator) -> Any:
    """A log as the world's bench would have written it."""
    from fiohost.bench.log import Log
    from fiohost.bench.unwrap import unwrap_counts

    columns = {k: v.copy() for k, v in log.columns.items()}
    metadata = dict(log.metadata)
    n = len(log)
    if world.sensor_counts:
        fine = unwrap_counts(columns["pos"], COUNTS * FINER) + 0.5
        counts = np.floor(fine / FINER + world.sensor_counts * rng.standard_normal(n))
        columns["pos"] = np.mod(counts, COUNTS)
        metadata["counts_per_rev"] = str(COUNTS)
        for name in ("direction", "angle_deg"):  # what the board says of its own count
            columns.pop(name, None)
    if world.wrong_bits:
        wrong = rng.random(n) < world.wrong_bits
        stand, drive = (columns["c3"] + columns["c4"] != 1.0), (columns["c3"] + columns["c4"] == 1.0)
        columns["c3"][wrong & stand], columns["c4"][wrong & stand] = 1.0, 0.0
        columns["c3"][wrong & drive], columns["c4"][wrong & drive] = 0.0, 0.0
    if world.jitter_s:
        most = MOST_JITTER * TICK_S
        columns["time_s"] = columns["time_s"] + np.clip(world.jitter_s * rng.standard_normal(n), -most, most)
        columns["time_s"] -= columns["time_s"][0]
    if world.missing:
        keep = np.ones(n, dtype=bool)
        low, high = BURST_ROWS if world.bursts else (1, 1)
        bursts = rng.poisson(world.missing * n / (0.5 * (low + high)))
        for first, rows in zip(rng.integers(1, n - 1, bursts), rng.integers(low, high + 1, bursts), strict=True):
            keep[first : first + rows] = False
        columns = {k: v[keep] for k, v in columns.items()}
    return log if world == BY_NAME["exact"] else Log.from_columns(columns, metadata, log.path)
