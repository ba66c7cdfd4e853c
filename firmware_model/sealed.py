"""A sealed bench: plant and effect drawn by a seed, told to nobody until it is opened.

The seed is the only link between the two functions. Ranges are wide and physically sensible: gain 6 to 16 deg/s per
percent, time constant 40 to 150 ms, dry friction 1 to 6 percent of full duty, no inductance, and exactly one effect.
"""

from __future__ import annotations

import math
import random
from typing import Any

from firmware_model.plants import Plant, make_plant
from firmware_model.registry import effects

SUPPLY_V = 9.0
EFFECTS = (
    "backlash",
    "constant_load",
    "gravity_load",
    "input_deadband",
    "transport_delay",
    "voltage_saturation",
)


def _between(rng: random.Random, low: float, high: float) -> float:
    """Log-uniform, so that small and large sizes are met equally often."""
    return math.exp(rng.uniform(math.log(low), math.log(high)))


def _motor(rng: random.Random) -> dict[str, Any]:
    """Constants of a geared motor: R and Kt free, the others follow from gain, time constant and friction drawn."""
    gain = _between(rng, 6.0, 16.0)
    tau = _between(rng, 0.040, 0.150)
    coulomb_pct = _between(rng, 1.0, 6.0)
    resistance = _between(rng, 3.0, 9.0)
    ratio = rng.uniform(0.65, 0.95)  # Kt below Ke: the gears lose torque
    back_emf = SUPPLY_V / (100.0 * math.radians(gain))
    kt = ratio * back_emf
    return {
        "supply_V": SUPPLY_V,
        "R_ohm": resistance,
        "Kt_Nm_per_A": kt,
        "Ke_Vs_per_rad": back_emf,
        "J_kgm2": tau * kt * back_emf / resistance,
        "coulomb_Nm": coulomb_pct / 100.0 * kt * SUPPLY_V / resistance,
    }


def _effect(rng: random.Random, name: str, motor: dict[str, Any]) -> dict[str, Any]:
    """SI parameters of one effect at a size that shows."""
    stall_Nm = motor["Kt_Nm_per_A"] * SUPPLY_V / motor["R_ohm"]
    if name == "input_deadband":
        return {"level_pct": _between(rng, 1.5, 12.0)}
    if name == "voltage_saturation":
        return {"limit_pct": rng.uniform(35.0, 85.0)}
    if name == "transport_delay":
        return {"delay_s": _between(rng, 0.004, 0.045)}
    if name == "constant_load":
        return {"torque_Nm": rng.choice((-1.0, 1.0)) * _between(rng, 0.005, 0.06) * stall_Nm}
    if name == "gravity_load":
        return {"torque_Nm": _between(rng, 0.01, 0.08) * stall_Nm, "phase_rad": rng.uniform(0.0, 2.0 * math.pi)}
    if rng.random() < 0.5:
        return {"gap_rad": math.radians(_between(rng, 1.0, 6.0)), "side": "encoder_after_gap"}
    return {
        "gap_rad": math.radians(_between(rng, 3.0, 12.0)),
        "side": "encoder_before_gap",
        "load_inertia_kgm2": rng.uniform(0.3, 0.6) * motor["J_kgm2"],
    }


def draw(seed: int) -> Plant:
    """The sealed plant of this seed. It carries no name that tells anything."""
    rng = random.Random(f"sealed {seed}")
    motor = _motor(rng)
    name = rng.choice(EFFECTS)
    return make_plant({**motor, "effects": {name: _effect(rng, name, motor)}}, "sealed")


def reveal(seed: int) -> dict[str, Any]:
    """The truth behind a seed: sentences, SI parameters and the same in percent of duty, degrees and seconds."""
    plant = draw(seed)
    reduced = plant.reduced()
    linear = reduced["linear"]
    sentences = [
        f"gain {linear['gain_deg_s_per_pct']:.3f} deg/s per %, time constant {linear['tau_s'] * 1e3:.1f} ms, "
        f"dry friction {reduced['coulomb_friction']['level_pct']:.2f} %"
    ]
    for name in plant.effects:
        values = ", ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in reduced[name].items())
        sentences.append(f"{name}: {effects()[name].summary} ({values})")
    return {
        "seed": seed,
        "name": plant.name,
        "effects": list(plant.effects),
        "truth": sentences,
        "si": {
            "R_ohm": plant.R_ohm,
            "L_H": plant.L_H,
            "Kt_Nm_per_A": plant.Kt_Nm_per_A,
            "Ke_Vs_per_rad": plant.Ke_Vs_per_rad,
            "J_kgm2": plant.J_kgm2,
            "B_Nms": plant.B_Nms,
            "coulomb_Nm": plant.coulomb_Nm,
            "supply_V": plant.supply_V,
            "effects": {name: dict(values) for name, values in plant.effects.items()},
        },
        "reduced": reduced,
    }
