"""A sealed bench: plant, effects and, on request, faults drawn by a seed, told to nobody until it is opened.

The seed and the version of the draws are the only link between the functions. A version is frozen: what it may draw,
and how, stays as it is, so that a log is unsealed as the bench it was. New effects and other sizes enter a new version:
it draws as the one before, then gives some of the benches one of its own effects in the place of their first.
Ranges are wide and physically sensible: gain 6 to 16 deg/s per percent, time constant 40 to 150 ms, dry friction 1 to 6
percent of full duty, and no effect, one or two of those that half a minute of motion can show, from faint to plain.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import replace
from typing import Any

from firmware_model.errors import FirmwareModelError
from firmware_model.faults import PARAMETERS as FAULT_KEYS
from firmware_model.plants import Plant, make_plant
from firmware_model.registry import effects

SUPPLY_V = 9.0
SHARES = {0: 15, 1: 60, 2: 25}  # how many benches of a hundred have so many effects
# The same thing to an encoder: a bench with both would be a bench with one of them.
ALIKE = (
    {"asymmetric_coulomb_friction", "constant_load"},
    {"gravity_load", "cogging_torque"},
    {"gravity_load", "load_over_position"},
    {"cogging_torque", "load_over_position"},
    {"position_dependent_friction", "friction_over_position"},
    {"encoder_eccentricity", "shaft_angle_error"},
)

Values = dict[str, Any]


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


def _sign(rng: random.Random) -> float:
    return rng.choice((-1.0, 1.0))


def _turn(rng: random.Random) -> float:
    return rng.uniform(0.0, 2.0 * math.pi)


def _stall(motor: Values) -> float:
    """Torque at rest on full duty, N m."""
    return float(motor["Kt_Nm_per_A"] * SUPPLY_V / motor["R_ohm"])


def _backlash(rng: random.Random, motor: Values) -> Values:
    if rng.random() < 0.5:
        return {"gap_rad": math.radians(_between(rng, 1.0, 6.0)), "side": "encoder_after_gap"}
    return {
        "gap_rad": math.radians(_between(rng, 3.0, 12.0)),
        "side": "encoder_before_gap",
        "load_inertia_kgm2": rng.uniform(0.3, 0.6) * motor["J_kgm2"],
    }


def _one_sided(rng: random.Random, motor: Values) -> Values:
    more = _between(rng, 0.1, 1.0) * motor["coulomb_Nm"]
    return {"forward_Nm": more, "reverse_Nm": 0.0} if rng.random() < 0.5 else {"forward_Nm": 0.0, "reverse_Nm": more}


def _edges(rng: random.Random, motor: Values) -> Values:
    wide = _between(rng, 1.0, 10.0)
    narrow = wide * rng.uniform(0.2, 0.7)
    plus, minus = (wide, narrow) if rng.random() < 0.5 else (narrow, wide)
    return {"u_plus_pct": plus, "u_minus_pct": -minus}


def _curve(rng: random.Random, size_Nm: float) -> Values:
    """A curve of this size that repeats once a turn: a few of its lowest orders."""
    orders = [(rng.uniform(0.3, 1.0) / n, n, _turn(rng)) for n in (1, 2, 3)]
    heights = [sum(a * math.sin(2.0 * math.pi * n * k / 12 + phase) for a, n, phase in orders) for k in range(11)]
    largest = max(abs(h) for h in heights)
    return {f"torque_{k + 1}_Nm": size_Nm * h / largest for k, h in enumerate(heights)}


# SI parameters of each effect at a drawn size.
EFFECTS: dict[str, Callable[[random.Random, Values], Values]] = {
    "armature_inductance": lambda r, m: {"inductance_H": _between(r, 0.002, 0.012) * m["R_ohm"]},
    "asymmetric_coulomb_friction": _one_sided,
    "asymmetric_deadband": _edges,
    "backlash": _backlash,
    "clock_ripple": lambda r, m: {
        "ratio": _between(r, 0.003, 0.03),
        "frequency_Hz": _between(r, 0.3, 10.0),
        "phase_rad": _turn(r),
        "of": r.choice(("torque", "gain")),
    },
    "bridge_voltage_drop": lambda r, m: {"drop_V": _between(r, 0.01, 0.06) * SUPPLY_V},
    "cogging_torque": lambda r, m: {
        "order": float(r.choice((2, 3, 4, 6, 8, 12, 15, 20))),
        "torque_Nm": _between(r, 0.01, 0.06) * _stall(m),
        "phase_rad": _turn(r),
    },
    "constant_load": lambda r, m: {"torque_Nm": _sign(r) * _between(r, 0.003, 0.06) * _stall(m)},
    "current_limit": lambda r, m: {"limit_A": r.uniform(0.3, 0.9) * SUPPLY_V / m["R_ohm"]},
    "direction_dependent_gain": lambda r, m: {"ratio": 1.0 + _sign(r) * _between(r, 0.005, 0.2)},
    "duty_curve": lambda r, m: {"exponent": 1.0 + _sign(r) * _between(r, 0.01, 0.3)},
    "duty_steps": lambda r, m: {
        "step_pct": r.choice((5.0, 10.0, 20.0, 25.0)),
        "share": _sign(r) * _between(r, 0.03, 0.4),
        "rounding": r.choice(("cut", "nearest")),
    },
    "encoder_eccentricity": lambda r, m: {
        "level_rad": math.radians(_between(r, 0.3, 2.0)),
        "order": float(r.choice((1, 1, 2, 4))),
        "phase_rad": _turn(r),
    },
    "friction_over_position": lambda r, m: _curve(r, _between(r, 0.15, 0.7) * m["coulomb_Nm"]),
    "gain_warm_up": lambda r, m: {
        "ratio": _sign(r) * _between(r, 0.01, 0.15),
        "time_constant_s": _between(r, 3.0, 15.0),
        "follows": r.choice(("running", "heat")),
    },
    "gravity_load": lambda r, m: {"torque_Nm": _between(r, 0.004, 0.08) * _stall(m), "phase_rad": _turn(r)},
    "input_deadband": lambda r, m: {"level_pct": _between(r, 0.7, 12.0)},
    "load_dependent_friction": lambda r, m: {"ratio": _between(r, 0.03, 0.3)},
    "load_over_position": lambda r, m: _curve(r, _between(r, 0.005, 0.05) * _stall(m)),
    "position_dependent_friction": lambda r, m: {
        "ratio": r.uniform(0.15, 0.6),
        "order": float(r.choice((1, 1, 2, 4))),
        "phase_rad": _turn(r),
    },
    "quadratic_drag": lambda r, m: {
        "drag_Nms2": _between(r, 0.01, 0.08) * _stall(m) / math.radians(1000.0) ** 2,
    },
    "shaft_angle_error": lambda r, m: {
        **{f"level_{n}_rad": math.radians(_between(r, 0.2, 1.5) / n) for n in (1, 2, 3)},
        **{f"phase_{n}_rad": _turn(r) for n in (1, 2, 3)},
    },
    "static_friction": lambda r, m: {"extra_Nm": _between(r, 0.01, 0.05) * _stall(m)},
    "stribeck_friction": lambda r, m: {
        "extra_Nm": _between(r, 0.01, 0.05) * _stall(m),
        "stribeck_speed_rad_s": _between(r, 0.3, 4.0),
    },
    "sublinear_viscous_friction": lambda r, m: {
        "torque_Nm": _between(r, 0.005, 0.03) * _stall(m),
        "knee_rad_s": _between(r, 0.5, 5.0),
    },
    "supply_sag": lambda r, m: {"source_ohm": _between(r, 0.04, 0.4) * m["R_ohm"]},
    "transport_delay": lambda r, m: {"delay_s": _between(r, 0.002, 0.045)},
    "viscous_friction_by_direction": lambda r, m: {
        "drag_Nms": _between(r, 0.02, 0.3) * m["Kt_Nm_per_A"] * m["Ke_Vs_per_rad"] / m["R_ohm"],
        "direction": r.choice(("forward", "reverse")),
    },
    "voltage_saturation": lambda r, m: {"limit_pct": r.uniform(35.0, 85.0)},
}

# The effects of each version, in the order in which they are drawn from.
VERSIONS: dict[int, tuple[str, ...]] = {
    1: (
        "armature_inductance", "asymmetric_coulomb_friction", "asymmetric_deadband", "backlash", "bridge_voltage_drop",
        "cogging_torque", "constant_load", "current_limit", "direction_dependent_gain", "duty_curve",
        "encoder_eccentricity", "gravity_load", "input_deadband", "load_dependent_friction",
        "position_dependent_friction", "quadratic_drag", "static_friction", "stribeck_friction", "supply_sag",
        "transport_delay", "voltage_saturation",
    ),
}  # fmt: skip
# Those that a version brings: so many benches of a hundred that have an effect get one of them.
BROUGHT: dict[int, tuple[str, ...]] = {
    2: (
        "clock_ripple", "duty_steps", "friction_over_position", "gain_warm_up", "load_over_position",
        "shaft_angle_error", "sublinear_viscous_friction", "viscous_friction_by_direction",
    ),
}  # fmt: skip
BROUGHT_SHARE = 35
VERSIONS[2] = VERSIONS[1] + BROUGHT[2]
NEWEST = max(VERSIONS)

# What a line and a clock may do, each of it mild enough for a run to go on.
FAULTS: dict[str, Callable[[random.Random], Values]] = {
    "dropped": lambda r: {"report_drop_ratio": _between(r, 0.001, 0.03)},
    "doubled": lambda r: {"report_double_ratio": _between(r, 0.001, 0.05)},
    "late": lambda r: {"report_late_ratio": _between(r, 0.001, 0.03), "report_late_s": r.uniform(0.004, 0.02)},
    "cut": lambda r: {"report_cut_ratio": _between(r, 0.001, 0.02)},
    "jitter": lambda r: {"tick_jitter_s": _between(r, 1e-4, 1e-3)},
    "slow_ticks": lambda r: {"tick_late_ratio": _between(r, 0.001, 0.02), "tick_late_s": r.uniform(0.001, 0.008)},
    "clock": lambda r: {"clock_ppm": _sign(r) * _between(r, 50.0, 20000.0)},
}


def _names(rng: random.Random, seed: int, version: int) -> tuple[str, ...]:
    """Effects of one bench: none, one, or two that are not alike."""
    (count,) = rng.choices(tuple(SHARES), tuple(SHARES.values()))
    while True:
        names = tuple(rng.sample(VERSIONS[1], count))
        if not any(set(names) <= alike for alike in ALIKE) or count < 2:
            break
    for brought in (BROUGHT[v] for v in range(2, version + 1)):
        own = random.Random(f"sealed {seed} of {', '.join(brought)}")
        if names and own.randrange(100) < BROUGHT_SHARE:
            apart = [n for n in brought if not any(alike <= {n, *names[1:]} for alike in ALIKE)]
            names = (own.choice(apart), *names[1:])
    return names


def draw(seed: int, *, faulty: bool = False, version: int = NEWEST) -> Plant:
    """The sealed plant of this seed in a version of the draws, with faults of line and clock where asked for. Its name
    tells nothing. Raises FirmwareModelError for a version that is not known.
    """
    if version not in VERSIONS:
        raise FirmwareModelError(
            f"version {version} of the sealed draws is not known; there are {', '.join(map(str, VERSIONS))}"
        )
    rng = random.Random(f"sealed {seed}")
    motor = _motor(rng)
    chosen = {name: EFFECTS[name](rng, motor) for name in _names(rng, seed, version)}
    plant = make_plant({**motor, "effects": chosen}, "sealed")
    if not faulty:
        return plant
    rng = random.Random(f"sealed faults {seed}")
    faults: Values = {}
    for kind in rng.sample(sorted(FAULTS), rng.randint(1, 3)):
        faults |= FAULTS[kind](rng)
    return replace(plant, faults=make_plant({**motor, "faults": faults}, "sealed").faults)


def reveal(seed: int, version: int = NEWEST) -> dict[str, Any]:
    """The truth behind a seed: sentences, SI parameters and the same in percent of duty, degrees and seconds.

    ``faults`` are those of the same bench drawn with faults.
    """
    plant = draw(seed, version=version)
    drawn = draw(seed, faulty=True, version=version).faults or {}
    usual = {q.key: q.choices[0] if q.choices else q.default for q in FAULT_KEYS}
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
        "version": version,
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
        "faults": {key: value for key, value in drawn.items() if value != usual[key]},
    }
