"""Any effects together mean the same on the board and in the fit; ``benchmarks/agreement.py`` runs every pair."""

from __future__ import annotations

import os
import random

import numpy as np
import pytest
from pairs import (
    EITHER,
    FIRST_SECOND_DEG,
    NAMES,
    PAIRS,
    RULE,
    as_model,
    compare,
    draw_commands,
    draw_plant,
    draw_run,
    on_host,
)

from fiohost.motor.effect import effects
from fiohost.motor.model import Model
from firmware_model.plants import make_plant

SEED = 1 if os.environ.get("CI") else random.randrange(10**6)
MOTOR_KEYS = ("supply_V", "R_ohm", "L_H", "Kt_Nm_per_A", "Ke_Vs_per_rad", "J_kgm2", "coulomb_Nm")


@pytest.mark.parametrize("name", NAMES)
def test_an_effect_alone_means_the_same_on_both_sides(name: str) -> None:
    found = draw_run((name,), SEED, 20.0)
    assert found.turned_deg > 5.0, "a shaft that does not turn proves nothing"
    assert found.agrees, f"seed {SEED}: {found.first_deg:.4f} and {found.whole_deg:.4f} deg. {RULE}"


@pytest.mark.parametrize("index", range(60))
def test_two_effects_together_mean_the_same_on_both_sides(index: int) -> None:
    pair = random.Random(f"pair {SEED} {index}").choice(PAIRS)
    print(f"{pair}, seed {SEED}")  # shown where it fails, whatever way
    found = draw_run(pair, SEED, 6.0)
    assert found.agrees, f"{pair}, seed {SEED}: {found.first_deg:.4f} and {found.whole_deg:.4f} deg. {RULE}"


@pytest.mark.parametrize("seed", range(8))
def test_so_do_five_effects_together(seed: int) -> None:
    rng = random.Random(f"five {SEED} {seed}")
    names = tuple(rng.sample(NAMES, 5))
    while any(either <= set(names) for either in EITHER):
        names = tuple(rng.sample(NAMES, 5))
    found = draw_run(names, seed, 6.0)
    assert found.agrees, f"{names}: {found.first_deg:.4f} and {found.whole_deg:.4f} deg. {RULE}"


@pytest.mark.parametrize(
    "names",
    [
        ("backlash", "quadratic_drag"),
        ("backlash", "armature_inductance"),
        ("shaft_compliance", "armature_inductance"),
        ("backlash", "hard_stop"),
        ("shaft_compliance", "hard_stop"),
        ("shaft_compliance", "presliding_friction"),
        ("backlash", "gravity_load"),
        ("backlash", "shaft_compliance"),
        ("parameter_change", "shaft_compliance"),
    ],
    ids="+".join,
)
def test_what_joins_two_bodies_goes_with_everything(names: tuple[str, ...]) -> None:
    """A load of half the inertia: nothing is left out in silence."""
    for seed in range(4):
        rng = random.Random(f"{names} {seed}")
        plant = draw_plant(rng, names)
        tables = {name: dict(values) for name, values in plant.effects.items()}
        for name in ("backlash", "shaft_compliance"):
            if name in tables:
                tables[name]["load_inertia_kgm2"] = 0.5 * plant.J_kgm2
        if "hard_stop" in tables:
            tables["hard_stop"]["angle_rad"] = rng.choice((-1.0, 1.0)) * 0.5
        heavy = make_plant({**{key: getattr(plant, key) for key in MOTOR_KEYS}, "effects": tables}, "heavy")
        modes, duties = draw_commands(rng, 4.0)
        found = compare(heavy, modes, duties)
        assert found.agrees, f"seed {seed}: {found.first_deg:.4f} and {found.whole_deg:.4f} deg. {RULE}"


def neutral(model: Model, name: str) -> Model:
    values = {p.name: p.neutral for p in effects()[name].parameters if p.neutral is not None}
    return model.with_effect(name, values)


@pytest.mark.parametrize("name", [n for n, e in effects().items() if any(p.neutral is not None for p in e.parameters)])
def test_an_effect_at_its_neutral_value_changes_nothing_beside_any_other(name: str) -> None:
    """But for the length of steps, and so for events that come and go within one."""
    rng = random.Random(f"neutral {name} {SEED}")
    modes, duties = draw_commands(rng, 1.5)
    for other in NAMES:
        if other == name or {other, name} <= {"coulomb_friction", "asymmetric_coulomb_friction"}:
            continue
        model = as_model(draw_plant(rng, (other,)))
        if name in model.effects:
            continue
        without, beside = (on_host(m, 0.25, modes, duties) for m in (model, neutral(model, name)))
        assert np.max(np.abs(without - beside)) <= FIRST_SECOND_DEG, other


def test_what_a_plant_has_in_si_is_in_percent_degrees_and_seconds_what_the_formulas_say() -> None:
    """A motor whose torque at rest on full duty is 0.6 N m: 0.006 N m are one percent."""
    effects_si = {
        "armature_heating": {"alpha_per_K": 0.004, "thermal_K_per_W": 10.0, "time_constant_s": 7.0},
        "armature_inductance": {"inductance_H": 0.01},
        "asymmetric_coulomb_friction": {"forward_Nm": 0.006, "reverse_Nm": 0.012},
        "backlash": {"gap_rad": np.pi / 90.0, "side": "encoder_before_gap", "load_inertia_kgm2": 1e-3},
        "bridge_voltage_drop": {"drop_V": 0.2},
        "cogging_torque": {"order": 6.0, "torque_Nm": 0.003, "phase_rad": np.pi / 2.0},
        "clock_ripple": {"ratio": 0.02, "frequency_Hz": 2.0, "phase_rad": np.pi / 2.0, "of": "gain"},
        "constant_load": {"torque_Nm": -0.006},
        "current_limit": {"limit_A": 1.0},
        "duty_steps": {"step_pct": 20.0, "share": 0.1, "rounding": "up"},
        "gain_warm_up": {"ratio": -0.1, "time_constant_s": 9.0, "follows": "heat"},
        "gravity_load": {"torque_Nm": 0.018, "phase_rad": np.pi},
        "hard_stop": {"angle_rad": -np.pi},
        "parameter_change": {"time_s": 3.0, "which": "gain", "ratio": 1.5},
        "presliding_friction": {"breakaway_rad": np.pi / 180.0},
        "pwm_dead_time": {"time_s": 1e-6},
        "quadratic_drag": {"drag_Nms2": 0.006 / np.radians(1000.0) ** 2},
        "load_over_position": {"from_rad": np.pi, "torque_2_Nm": 0.012},
        "shaft_angle_error": {"level_2_rad": np.pi / 180.0, "phase_2_rad": np.pi / 2.0},
        "shaft_compliance": {
            "stiffness_Nm_per_rad": 1e-3 * (2.0 * np.pi * 10.0) ** 2, "damping_Nms": 0.0, "load_inertia_kgm2": 2e-3,
            "side": "encoder_after_spring",
        },
        "static_friction": {"extra_Nm": 0.012},
        "stribeck_friction": {"extra_Nm": 0.006, "stribeck_speed_rad_s": np.pi},
        "sublinear_viscous_friction": {"torque_Nm": 0.006, "knee_rad_s": np.radians(1000.0) / np.sinh(2.0)},
        "supply_drift": {"drift_per_s": 1e-4},
        "supply_sag": {"source_ohm": 1.0},
        "viscous_friction": {"drag_Nms": 0.006 / np.radians(1000.0)},
        "viscous_friction_by_direction": {"drag_Nms": 0.012 / np.radians(1000.0), "direction": "reverse"},
    }  # fmt: skip
    plant = make_plant(
        {
            "supply_V": 10.0, "R_ohm": 5.0, "Kt_Nm_per_A": 0.3, "Ke_Vs_per_rad": 0.4, "J_kgm2": 4e-3,
            "coulomb_Nm": 0.006, "effects": effects_si,
        },
        "known",
    )  # fmt: skip
    reduced = plant.reduced()
    expected = {
        "linear": {"gain_deg_s_per_pct": np.degrees(0.25), "tau_s": 1.0 / 6.0},
        "coulomb_friction": {"level_pct": 1.0},
        "armature_heating": {"rise_ratio": 0.8, "time_constant_s": 7.0},
        "armature_inductance": {"time_constant_s": 0.002},
        "asymmetric_coulomb_friction": {"forward_pct": 1.0, "reverse_pct": 2.0},
        "backlash": {"gap_deg": 2.0, "side": "encoder_before_gap", "load_inertia_ratio": 0.25},
        "bridge_voltage_drop": {"drop_pct": 2.0},
        "cogging_torque": {"order": 6.0, "level_pct": 0.5, "phase_deg": 90.0},
        "clock_ripple": {"level_pct": 2.0, "frequency_hz": 2.0, "phase_deg": 90.0, "of": "gain"},
        "constant_load": {"level_pct": -1.0},
        "current_limit": {"limit_pct": 50.0},
        "duty_steps": {"step_pct": 20.0, "share": 0.1, "rounding": "up"},
        "gain_warm_up": {"ratio": -0.1, "time_constant_s": 9.0, "follows": "heat"},
        "gravity_load": {"level_pct": 3.0, "phase_deg": 180.0},
        "hard_stop": {"angle_deg": -180.0},
        "parameter_change": {"time_s": 3.0, "which": "gain", "ratio": 1.5},
        "presliding_friction": {"breakaway_deg": 1.0},
        "pwm_dead_time": {"time_us": 1.0},
        "quadratic_drag": {"pct_at_1000_deg_s": 1.0},
        "load_over_position": {"from_deg": 180.0, "span_deg": 360.0, "point_2_pct": 2.0, "point_3_pct": 0.0},
        "shaft_angle_error": {"level_1_deg": 0.0, "level_2_deg": 1.0, "phase_2_deg": 90.0, "level_3_deg": 0.0},
        "shaft_compliance": {
            "resonance_hz": 10.0, "damping_ratio": 0.0, "inertia_ratio": 0.5, "side": "encoder_after_spring",
        },
        "static_friction": {"extra_pct": 2.0},
        "stribeck_friction": {"extra_pct": 1.0, "stribeck_speed_deg_s": 180.0},
        "sublinear_viscous_friction": {"pct_at_1000_deg_s": 2.0, "knee_deg_s": 1000.0 / np.sinh(2.0)},
        "supply_drift": {"pct_per_100_s": 1.0},
        "supply_sag": {"ratio": 0.2, "smoothing": "capacitor"},
        "viscous_friction": {"pct_at_1000_deg_s": 1.0},
        "viscous_friction_by_direction": {"pct_at_1000_deg_s": 2.0, "direction": "reverse"},
    }  # fmt: skip
    assert reduced.keys() == expected.keys()
    for name, values in expected.items():
        for key, value in values.items():
            assert reduced[name][key] == (value if isinstance(value, str) else pytest.approx(value)), (name, key)
    as_model(plant)  # and every name is one of the fit's
