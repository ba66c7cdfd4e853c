"""The PWM with resolved edges: beside its mean, beside an independent solution, and what only the edges show."""

from __future__ import annotations

import math
import struct
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from board_reference.compare import driven, shown, solved

import fiohost
from firmware_model import Board, FirmwareModelError, Instruments, load_plant
from firmware_model.layout import CURRENT, OMEGA, PLAIN, STIFF, THETA
from firmware_model.motor import Motor
from firmware_model.plants import Plant, make_plant
from firmware_model.registry import effects

BASE = {
    "supply_V": 9.0,
    "R_ohm": 5.515,
    "L_H": 0.015,
    "Kt_Nm_per_A": 0.3408,
    "Ke_Vs_per_rad": 0.4869,
    "J_kgm2": 3.07e-3,
    "coulomb_Nm": 0.02045,
}
STANDBY, DRIVEN, BRAKE = 0, 1, 2
STEP_S = 0.005
EDGES = "edge_resolved"
FORWARD = (1, 0)

# Averaged map of fast decay beside the edges. Its pulses see one back-emf a period; seen: 2e-5 from 55 % duty on, and
# 2e-4 rad/s where the motor hardly starts.
MAP_RELATIVE, MAP_RAD_S = 5e-5, 4e-4

# Every effect at a size that shows.
SIZES: dict[str, dict[str, Any]] = {
    "armature_heating": {"thermal_K_per_W": 15.0, "time_constant_s": 1.0},
    "armature_inductance": {"inductance_H": 0.018},
    "asymmetric_coulomb_friction": {"forward_Nm": 0.004, "reverse_Nm": 0.008},
    "asymmetric_deadband": {"u_plus_pct": 3.0, "u_minus_pct": -6.0},
    "backlash": {"gap_deg": 4.0, "load_inertia_kgm2": 1e-3},
    "bridge_voltage_drop": {"drop_V": 0.4},
    "cogging_torque": {"order": 12.0, "torque_Nm": 0.008},
    "clock_ripple": {"ratio": 0.03, "frequency_Hz": 3.0},
    "coast_pwm": {"pwm_Hz": 1000.0},
    "constant_load": {"torque_Nm": 0.01},
    "current_limit": {"limit_A": 0.5},
    "direction_dependent_gain": {"ratio": 0.9},
    "duty_curve": {"exponent": 1.2},
    "duty_steps": {"step_pct": 12.5, "share": 0.3},
    "encoder_eccentricity": {"level_deg": 2.0},
    "fast_decay": {"diode_V": 0.5},
    "friction_over_position": {"span_deg": 90.0, "torque_2_Nm": 0.008, "torque_6_Nm": -0.008},
    "friction_warm_up": {"ratio": 0.4, "time_constant_s": 1.0},
    "gain_warm_up": {"ratio": 0.2, "time_constant_s": 0.5},
    "gravity_load": {"torque_Nm": 0.02},
    "hard_stop": {"angle_deg": 15.0},
    "input_deadband": {"level_pct": 5.0},
    "load_dependent_friction": {"ratio": 0.15},
    "load_over_position": {"span_deg": 90.0, "torque_2_Nm": 0.02, "torque_6_Nm": -0.02},
    "missed_counts": {"ratio": 0.05},
    "parameter_change": {"time_s": 0.1511, "which": "inertia", "ratio": 1.5},
    "position_dependent_friction": {"ratio": 0.4},
    "presliding_friction": {"breakaway_deg": 1.0},
    "pwm_dead_time": {"time_s": 1e-6},
    "pwm_resolution": {"levels": 50.0},
    "quadratic_drag": {"drag_Nms2": 2e-4},
    "shaft_angle_error": {"level_1_deg": 1.0, "level_3_deg": 0.5},
    "shaft_compliance": {"stiffness_Nm_per_rad": 8.0, "damping_Nms": 0.003, "load_inertia_kgm2": 1e-3},
    "slot_errors": {},
    "static_friction": {"extra_Nm": 0.01},
    "stribeck_friction": {"extra_Nm": 0.01, "stribeck_speed_rad_s": 1.0},
    "sublinear_viscous_friction": {"torque_Nm": 0.01, "knee_rad_s": 2.0},
    "supply_drift": {"drift_per_s": -0.05},
    "supply_sag": {"source_ohm": 1.0},
    "transport_delay": {"delay_s": 0.01233},
    "viscous_friction": {"drag_Nms": 3e-3},
    "viscous_friction_by_direction": {"drag_Nms": 3e-3},
    "voltage_saturation": {"limit_pct": 60.0},
}


def plant(chosen: dict[str, dict[str, Any]] | None = None, **constants: float) -> Plant:
    return make_plant({**BASE, **constants, "effects": chosen or {}}, "test")


def states_of(machine: Plant, pwm: str, duties: np.ndarray, mode: int = DRIVEN) -> np.ndarray:
    return Motor(machine, pwm=pwm).run_many(np.full(len(duties), mode), duties, STEP_S)[1]


def steady_speed(machine: Plant, pwm: str, duty_pct: float) -> float:
    """Mean speed over the last of 1.5 seconds, rad/s; 0 where it never starts."""
    theta = states_of(machine, pwm, np.full(300, duty_pct))[:, THETA]
    return float((theta[-1] - theta[-101]) / (100 * STEP_S))


def drawn(seed: int, chosen: dict[str, dict[str, Any]] | None = None) -> Plant:
    """A geared motor of random constants, friction low enough to start at 10 % duty."""
    rng = np.random.default_rng(seed)
    ke = 0.4869 * rng.uniform(0.5, 2.0)
    ohms = 5.515 * rng.uniform(0.4, 2.5)
    kt = ke * rng.uniform(0.65, 0.95)
    tau_s, winding_s = rng.uniform(0.04, 0.15), rng.uniform(2e-4, 5e-3)
    return plant(
        chosen,
        R_ohm=ohms,
        L_H=ohms * winding_s,
        Kt_Nm_per_A=kt,
        Ke_Vs_per_rad=ke,
        J_kgm2=tau_s * kt * ke / ohms,
        coulomb_Nm=rng.uniform(0.0, 0.05) * kt * 9.0 / ohms,
        supply_V=9.0,
    )


# ---- beside the mean


@pytest.mark.parametrize("duty_pct", [10.0, 25.0, 50.0, 80.0, -33.3, 100.0])
def test_slow_decay_mean_speed_is_that_of_the_averaged_pwm(duty_pct: float) -> None:
    for machine in (load_plant("default"), load_plant("nxt_no_load"), *(drawn(seed) for seed in range(6))):
        mean = steady_speed(machine, "averaged", duty_pct)
        assert abs(mean) > 0.5
        assert steady_speed(machine, EDGES, duty_pct) == pytest.approx(mean, rel=1e-3)


def test_fast_decay_map_follows_the_edges_in_both_regimes() -> None:
    """Where the current ceases within each period and where it never does; a plain mean of the voltage is far off."""
    ceases = []
    for duty_pct in (52.0, 55.0, 60.0, 70.0, 80.0, 90.0, 97.0):
        for coulomb_Nm, henry in ((0.002, 0.015), (0.02045, 0.015), (0.02045, 0.0015)):
            constants = {"coulomb_Nm": coulomb_Nm, "L_H": henry}
            machine = plant({"fast_decay": {"diode_V": 0.5}}, **constants)
            edges, mean = (steady_speed(machine, pwm, duty_pct) for pwm in (EDGES, "averaged"))
            assert edges == pytest.approx(mean, rel=MAP_RELATIVE, abs=MAP_RAD_S)
            naive = steady_speed(plant(**constants), "averaged", duty_pct)  # duty times supply
            if duty_pct <= 80.0 and mean > 0.0:
                assert naive > 1.1 * mean
            motor = Motor(machine, pwm=EDGES)
            motor.run_many(np.full(300, DRIVEN), np.full(300, duty_pct), STEP_S)
            ceases.append(motor._y[CURRENT] == 0.0)  # at the end of a period
    assert 5 < sum(ceases) < len(ceases) - 5


@pytest.mark.parametrize("pwm", ["averaged", EDGES])
def test_fast_decay_starts_only_above_about_half_duty(pwm: str) -> None:
    """The same motor: a few percent with the off-phase shorted, above half with it open."""

    def starts(name: str) -> int:
        for duty in range(1, 100):
            if steady_speed(load_plant(name), pwm, float(duty)) > 0.2:
                return duty
        return 100

    assert starts("default") <= 5
    assert 48 <= starts("nxt_fast_decay") <= 60


@pytest.mark.parametrize("name", sorted(SIZES))
def test_every_effect_acts_with_edges_as_it_does_in_the_mean(name: str) -> None:
    """Angles of a staircase lie by the averaged ones, within a hundredth of what the effect does and a ripple."""
    rng = np.random.default_rng(5)
    duties = np.repeat(rng.uniform(-70.0, 70.0, 6), 20)
    chosen = {name: SIZES[name]}
    without = states_of(plant(), "averaged", duties)[:, THETA]
    mean = states_of(plant(chosen), "averaged", duties)[:, THETA]
    edges = states_of(plant(chosen), EDGES, duties)[:, THETA]
    does = float(np.max(np.abs(mean - without)))
    part = 0.03 if name == "current_limit" else 0.01  # the limit cuts the current's peaks, not its mean
    assert np.max(np.abs(edges - mean)) < part * does + math.radians(0.02)
    if effects()[name].measure is None and name not in ("missed_counts", "static_friction"):
        assert does > math.radians(0.1)


def test_all_effects_run_together() -> None:
    assert set(SIZES) == set(effects())
    motor = Motor(plant(SIZES), pwm=EDGES)
    _, states = motor.run_many(np.full(200, DRIVEN), np.repeat([100.0, -100.0, 30.0, -100.0], 50), STEP_S)
    assert np.all(np.isfinite(states))
    assert np.ptp(states[:, THETA]) > 0.3


# ---- beside an independent solution

REFERENCED: dict[str, dict[str, dict[str, Any]]] = {
    "slow decay": {},
    "fast decay": {"fast_decay": {"diode_V": 0.6}},
    "voltage drop": {"bridge_voltage_drop": {"drop_V": 0.5}},
    "fast decay, voltage drop": {"fast_decay": {"diode_V": 0.0}, "bridge_voltage_drop": {"drop_V": 0.5}},
    "current limit": {"current_limit": {"limit_A": 0.4}},
    "loads, friction, sag, heat": {
        "gravity_load": {"torque_Nm": 0.03, "phase_rad": 1.0},
        "cogging_torque": {"order": 12.0, "torque_Nm": 0.01},
        "supply_sag": {"source_ohm": 1.0},
        "armature_heating": {"thermal_K_per_W": 15.0, "time_constant_s": 1.0},
        "load_dependent_friction": {"ratio": 0.1},
        "stribeck_friction": {"extra_Nm": 0.01, "stribeck_speed_rad_s": 1.0},
    },
}
# Linear machines differ by the reference's own tolerance, the others by the steps' second order.
ALLOWED_DEG = {name: 1e-8 for name in REFERENCED} | {"loads, friction, sag, heat": 5e-5}


@pytest.mark.long
@pytest.mark.parametrize("name", sorted(REFERENCED))
def test_edges_follow_the_independent_solution(name: str) -> None:
    """Drive, reverse through a stop, coast, brake, crawl and drive again: 0.2 s, 4000 periods."""
    record = [(DRIVEN, 70.0)] * 8 + [(DRIVEN, -35.5)] * 8 + [(STANDBY, 0.0)] * 5 + [(BRAKE, 0.0)] * 5
    record += [(DRIVEN, 8.0)] * 6 + [(DRIVEN, 60.0)] * 8
    modes, duties = np.array([mode for mode, _ in record]), np.array([duty for _, duty in record])
    run = driven(plant(REFERENCED[name]), modes, duties, edges=True)
    expected, _ = solved(run)
    assert float(np.max(np.abs(shown(run) - expected))) < ALLOWED_DEG[name]


@pytest.mark.parametrize("decay", ["slow", "fast"])
@pytest.mark.parametrize("name", [*sorted(SIZES), "all"])
def test_a_segment_in_one_step_is_the_segment_in_adaptive_steps(name: str, decay: str) -> None:
    """0.2 s with a reversal: one step a segment beside Dormand-Prince within each segment at 2e-10 rad a step."""
    chosen = SIZES if name == "all" else {name: SIZES[name]}
    machine = plant({**chosen, **({"fast_decay": {"diode_V": 0.5}} if decay == "fast" else {})})
    duties = np.repeat([70.0, -60.0, 10.0, 30.0], [10, 14, 10, 6])
    angles = []
    for stiff in (0, 1):
        motor = Motor(machine, pwm=EDGES)
        if stiff:
            motor._m[STIFF], motor._m[PLAIN] = 1, 0
        angles.append(motor.run_many(np.full(len(duties), DRIVEN), duties, STEP_S)[1][:, THETA])
    assert np.max(np.abs(angles[0] - angles[1])) < math.radians(1e-4)


def test_whole_periods_at_once_are_the_periods_one_by_one() -> None:
    """A plant on which nothing but the linear motor acts leaps; a weight of nothing makes it go segment by segment."""
    duties = np.repeat([70.0, -70.0, 3.0, -20.0, 2.0], 30)
    leaps = states_of(plant(), EDGES, duties)
    steps = states_of(plant({"gravity_load": {"torque_Nm": 0.0}}), EDGES, duties)
    assert np.max(np.abs(leaps - steps)) < 1e-9


# ---- what the bridge does to the current


def spinning(pwm: str) -> Motor:
    motor = Motor(plant(coulomb_Nm=0.0), pwm=pwm)
    motor.run_many(np.full(300, DRIVEN), np.full(300, 80.0), STEP_S)
    return motor


@pytest.mark.parametrize("pwm", ["averaged", EDGES])
def test_open_bridge_ends_the_current_in_its_diodes(pwm: str) -> None:
    """L di/dt = -V - Ke omega - R i from i0: zero after (L/R) ln(1 + R i0 / (V + Ke omega)), and none from then on."""
    motor = Motor(plant(coulomb_Nm=1.0), pwm=pwm)  # held: no back-emf
    motor.run(DRIVEN, 100.0, 0.1)
    first = motor._y[CURRENT]
    assert first == pytest.approx(9.0 / 5.515, rel=1e-9)
    ends_s = 0.015 / 5.515 * math.log(1.0 + 5.515 * first / 9.0)
    motor.run(STANDBY, 0.0, 0.5 * ends_s)
    up = (first + 9.0 / 5.515) * math.exp(-0.5 * ends_s * 5.515 / 0.015) - 9.0 / 5.515
    assert motor._y[CURRENT] == pytest.approx(up, rel=1e-6)
    motor.run(STANDBY, 0.0, 0.5 * ends_s + 1e-6)
    assert motor._y[CURRENT] == 0.0


@pytest.mark.parametrize("pwm", ["averaged", EDGES])
def test_shorted_bridge_brakes_by_the_back_emf(pwm: str) -> None:
    """From i0 towards -Ke omega / R with the winding's time constant, the speed hardly changed meanwhile."""
    motor = spinning(pwm)
    omega, first = motor._y[OMEGA], motor._y[CURRENT]
    span_s = 1e-3
    motor.run(BRAKE, 0.0, span_s)
    towards = -0.4869 * omega / 5.515
    decay = math.exp(-span_s * 5.515 / 0.015)
    assert motor._y[CURRENT] == pytest.approx(towards + (first - towards) * decay, rel=0.02)
    assert motor._y[CURRENT] < -0.3
    motor.run(BRAKE, 0.0, 2.0)
    assert motor._y[CURRENT] == pytest.approx(0.0, abs=1e-6)


def test_ripple_of_the_current_is_that_of_the_supply_on_the_inductance() -> None:
    """Slow decay at half duty: a quarter of V T / L from trough to peak, to first order."""
    motor = spinning(EDGES)
    motor.run(DRIVEN, 50.0, 1.0)
    trough = motor._y[CURRENT]
    motor.run(DRIVEN, 50.0, 25e-6)
    assert motor._y[CURRENT] - trough == pytest.approx(0.25 * 9.0 * 50e-6 / 0.015, rel=0.01)


def test_held_below_break_away_ripple_may_nudge_what_the_mean_would_hold() -> None:
    """The averaged shaft stands still for ever; with edges it does so only while the current's peak holds too."""
    machine = plant(L_H=0.002)
    breakaway_pct = machine.percent_of_torque(0.02045)
    duties = np.full(400, 0.97 * breakaway_pct)
    mean, edges = (states_of(machine, pwm, duties) for pwm in ("averaged", EDGES))
    assert np.all(mean[:, THETA] == mean[0, THETA])
    assert edges[-1, THETA] > edges[0, THETA]
    quiet = states_of(machine, EDGES, np.full(400, 0.9 * breakaway_pct))
    assert np.all(quiet[:, THETA] == quiet[0, THETA])


# ---- how it is asked for


def report(duty_pct: float) -> bytes:
    return struct.pack("<fBB58x", duty_pct, *FORWARD)


def test_meters_show_the_mean_of_a_period_and_disturb_nothing() -> None:
    boards = [Board(load_plant("default"), pwm=pwm) for pwm in ("averaged", EDGES, EDGES)]
    for _ in range(300):
        for board in boards:
            board.step(report(60.0))
        Instruments(boards[1]).current_A  # noqa: B018
    mean, edges, unseen = (Instruments(board) for board in boards)
    assert edges.current_A == pytest.approx(mean.current_A, rel=2e-3)
    assert edges.voltage_V == pytest.approx(mean.voltage_V, rel=1e-3)
    assert edges.current_A == unseen.current_A


def test_timer_truncates_the_pulse() -> None:
    """Between two compare values nothing changes; the next one is a longer pulse."""
    angles = []
    for duty_pct in (50.0, 50.027, 50.028):
        board = Board(load_plant("default"), pwm=EDGES)
        for _ in range(200):
            board.step(report(duty_pct))
        angles.append(float(board._motor._y[THETA]))
    assert angles[0] == angles[1] < angles[2]


def test_plant_file_chooses_and_the_host_drives_it(tmp_path: Path) -> None:
    text = "".join(f"{key} = {value!r}\n" for key, value in BASE.items())
    ends = []
    for pwm in ("averaged", EDGES):
        path = tmp_path / f"{pwm}.toml"
        path.write_text(f'{text}pwm = "{pwm}"\n[effects.bridge_voltage_drop]\ndrop_V = 0.4\n', encoding="utf-8")
        assert load_plant(path).pwm == pwm
        with fiohost.connect(f"sim:{path}") as bench:
            ends.append(bench.drive(40.0, 0.5).output[-1])
    assert ends[0] == pytest.approx(ends[1], abs=1.0)
    assert ends[0] > 60.0


@pytest.mark.parametrize(("key", "said"), [('"edges"', ["averaged, edge_resolved", "edges"]), ("3", ["pwm", "3"])])
def test_unknown_ways_are_refused(tmp_path: Path, key: str, said: list[str]) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("".join(f"{k} = {v!r}\n" for k, v in BASE.items()) + f"pwm = {key}\n", encoding="utf-8")
    with pytest.raises(FirmwareModelError) as refused:
        load_plant(path)
    assert all(word in str(refused.value) for word in said)
    with pytest.raises(FirmwareModelError, match="averaged, edge_resolved"):
        Board(load_plant("default"), pwm="edges")


def test_edges_need_a_winding_with_inductance() -> None:
    with pytest.raises(FirmwareModelError, match="needs a winding with inductance"):
        Motor(plant(L_H=0.0), pwm=EDGES)
    Motor(plant({"armature_inductance": {"inductance_H": 0.01}}, L_H=0.0), pwm=EDGES)
