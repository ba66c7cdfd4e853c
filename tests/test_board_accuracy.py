"""The board's motor against the same machine solved by scipy at tight tolerance (two independent pieces of code).

Short records of every effect and of a few pairs drawn anew at each run. ``benchmarks/board_accuracy.py`` has long ones.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_reference.compare import distance, driven, sensitivity, solved
from board_reference.draws import SIZES, WINDING_H, drawn, drawn_pair, plant_with
from draws import drawn_seed

from firmware_model.plants import Plant
from firmware_model.registry import effects

ALLOWED_DEG = 5e-5  # a tenth of what the long records are held to
DRAWN_ALLOWED_DEG = 5e-4  # as those: near chaotic motion more is no defect (6e-5 seen of a load in a springy gap)
SLOW_ALLOWED_DEG = 5e-3  # where slow pulses begin to cease the board's step errs by more than it estimates: 2.5e-3 seen
CHAOS = 3.0  # times the reference's own sensitivity
STEPS = 200
PAIRS = 6

CASES: dict[str, dict[str, dict[str, Any]]] = {
    "no effect": {},
    **{name: {name: drawn(name, np.random.default_rng(7))} for name in SIZES},
    "fast decay, limited": {"fast_decay": {"diode_V": 0.7}, "current_limit": {"limit_A": 0.2}},
    "backlash, disc": {"backlash": {"gap_deg": 4.0}},
    "backlash, load": {"backlash": {"gap_deg": 4.0, "load_inertia_kgm2": 1e-3, "side": "encoder_before_gap"}},
    "backlash, hanging load": {
        "constant_load": {"torque_Nm": 0.03},
        "backlash": {"gap_deg": 4.0, "load_inertia_kgm2": 1e-3, "side": "encoder_after_gap"},
    },
}
NEEDS_WINDING = {"fast_decay", "coast_pwm", "fast decay, limited"}


def records(seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Modes and duties: levels with standby and brake among them, and a duty new at every step."""
    rng = np.random.default_rng(seed)
    modes = np.ones(STEPS, np.int64)
    stairs = np.repeat(rng.uniform(-70.0, 70.0, STEPS // 20), 20)
    modes[60:90], modes[120:140] = 0, 2
    stairs[modes != 1] = 0.0
    return [(modes, stairs), (modes[:50], rng.uniform(-60.0, 60.0, 50))]


def misses(plant: Plant, seed: int, allowed_deg: float = ALLOWED_DEG) -> list[str]:
    """What is wrong on the records of a seed, in words."""
    found = []
    if "coast_pwm" in plant.effects:
        allowed_deg = SLOW_ALLOWED_DEG
    for modes, duties in records(seed):
        run = driven(plant, modes, duties)
        angles, counts = solved(run)
        error = distance(run, angles)
        if error > allowed_deg and error > CHAOS * sensitivity(run, angles):
            found.append(f"{error:.2g} deg from the reference")
        if error < ALLOWED_DEG and np.any(run.counts != counts) and np.sum(run.counts != counts) > 1:
            found.append(f"{np.sum(run.counts != counts)} counter readings differ")
    return found


def test_every_effect_of_the_board_has_a_reference() -> None:
    assert set(SIZES) == set(effects())


@pytest.mark.long
@pytest.mark.parametrize("winding", ["none", "with"])
@pytest.mark.parametrize("name", CASES)
def test_kernel_follows_the_tight_reference(name: str, winding: str) -> None:
    if winding == "none" and name in NEEDS_WINDING:
        winding = "with"
    plant = plant_with(CASES[name], WINDING_H if winding == "with" else 0.0)
    assert not misses(plant, 3), dict(plant.effects)


@pytest.mark.parametrize("draw", range(PAIRS))
def test_a_pair_drawn_now_follows_the_tight_reference(draw: int) -> None:
    seed = drawn_seed(draw)
    plant = drawn_pair(np.random.default_rng(seed))
    print(f"seed {seed}: {dict(plant.effects)}")  # shown where it fails
    assert not misses(plant, seed, DRAWN_ALLOWED_DEG)


def test_the_benchmark_of_speed_knows_every_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(Path(__file__).parent.parent / "benchmarks")
    import board

    assert set(board.ALL) == set(effects())
