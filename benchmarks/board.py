"""How much faster than real time the simulated board runs: simulated time over processor time, best of warm repeats.

    python benchmarks/board.py [--repeats N] [--json FILE]

Each way is run without effects and with every effect there is at once. Behind the wire: commands encoded to reports,
``Board.step``, telemetry decoded and unwrapped, a PD controller in Python. The motor alone: a staircase of duties.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent))

from fiohost.bench.unwrap import Unwrapper
from fiohost.control.controllers import PD
from fiohost.control.law import ControlLaw
from fiohost.transport.profile import TargetProfile
from fiohost.transport.simulated import SimulatedTransport
from fiohost.wire.messages import Command
from firmware_model import Board
from firmware_model.motor import Motor
from firmware_model.plants import Plant, make_plant
from firmware_model.registry import effects

STEP_S = 0.005
DRIVEN = 1
# The default motor with its winding: without inductance there are no edges to resolve.
MOTOR = {
    "supply_V": 9.0,
    "R_ohm": 5.515,
    "L_H": 0.015,
    "Kt_Nm_per_A": 0.3408,
    "Ke_Vs_per_rad": 0.4869,
    "J_kgm2": 3.07e-3,
    "coulomb_Nm": 0.02045,
}
# Every effect at a size that shows, none so large that the motor stands still.
ALL: dict[str, dict[str, Any]] = {
    "armature_heating": {"thermal_K_per_W": 15.0, "time_constant_s": 20.0},
    "armature_inductance": {"inductance_H": 0.015},
    "asymmetric_coulomb_friction": {"forward_Nm": 0.002, "reverse_Nm": 0.004},
    "asymmetric_deadband": {"u_plus_pct": 1.0, "u_minus_pct": -2.0},
    "backlash": {"gap_deg": 2.0, "load_inertia_kgm2": 1e-3},
    "bridge_voltage_drop": {"drop_V": 0.4},
    "clock_ripple": {"ratio": 0.02, "frequency_Hz": 7.0},
    "coast_pwm": {"pwm_Hz": 500.0},
    "cogging_torque": {"order": 12.0, "torque_Nm": 0.004},
    "constant_load": {"torque_Nm": 0.005},
    "current_limit": {"limit_A": 1.5},
    "direction_dependent_gain": {"ratio": 0.95},
    "duty_curve": {"exponent": 1.1},
    "duty_steps": {"step_pct": 5.0, "share": 0.5},
    "encoder_eccentricity": {"level_deg": 0.5},
    "fast_decay": {"diode_V": 0.5},
    "friction_over_position": {"torque_2_Nm": 0.002, "torque_5_Nm": -0.002},
    "friction_warm_up": {"ratio": 0.3, "time_constant_s": 20.0},
    "gain_warm_up": {"ratio": 0.05, "time_constant_s": 20.0},
    "gravity_load": {"torque_Nm": 0.01},
    "hard_stop": {"angle_deg": 20000.0},
    "input_deadband": {"level_pct": 1.0},
    "load_dependent_friction": {"ratio": 0.1},
    "load_over_position": {"torque_2_Nm": 0.002, "torque_5_Nm": -0.002},
    "missed_counts": {"ratio": 0.001},
    "parameter_change": {"time_s": 1.0, "which": "inertia", "ratio": 1.2},
    "position_dependent_friction": {"ratio": 0.3},
    "presliding_friction": {"breakaway_deg": 0.5},
    "pwm_dead_time": {"time_s": 5e-7},
    "pwm_resolution": {"levels": 255.0},
    "quadratic_drag": {"drag_Nms2": 5e-5},
    "shaft_angle_error": {"level_1_rad": 0.005, "level_2_rad": 0.003},
    "shaft_compliance": {"stiffness_Nm_per_rad": 8.0, "damping_Nms": 0.003, "load_inertia_kgm2": 1e-3},
    "slot_errors": {},
    "static_friction": {"extra_Nm": 0.005},
    "stribeck_friction": {"extra_Nm": 0.005, "stribeck_speed_rad_s": 1.0},
    "sublinear_viscous_friction": {"torque_Nm": 0.002, "knee_rad_s": 1.0},
    "supply_drift": {"drift_per_s": -1e-3},
    "supply_sag": {"source_ohm": 0.5},
    "transport_delay": {"delay_s": 0.012},
    "viscous_friction": {"drag_Nms": 1e-4},
    "viscous_friction_by_direction": {"drag_Nms": 1e-4},
    "voltage_saturation": {"limit_pct": 90.0},
}
PLANTS = {"no effects": {}, "all effects": ALL}


class Way(NamedTuple):
    """One way of running the board: how, and the ratio to reach without effects and with all."""

    name: str
    run: Callable[[Plant, int], float]
    targets: tuple[float, float]


def behind_the_wire(plant: Plant, steps: int) -> float:
    """Processor time in s of a closed loop over the wire."""
    profile = TargetProfile.load().with_counts(plant.counts_per_rev)
    codec, unwrap = profile.codec, Unwrapper(plant.counts_per_rev).update
    line = SimulatedTransport(Board(plant, seed=1).step, "sim", "simulated")
    law = ControlLaw(PD(1.0, 0.02, STEP_S, filter_s=0.01))
    line.open()
    begin = time.process_time()
    for k in range(steps):
        angle_deg = unwrap(codec.decode(line.receive(0.05)).pos) * 360.0 / plant.counts_per_rev
        ref_deg = 180.0 if k // 200 % 2 == 0 else 0.0
        line.send(codec.encode(Command.drive(law.step(ref_deg, angle_deg))))
    return time.process_time() - begin


def motor_alone(pwm: str) -> Callable[[Plant, int], float]:
    """Processor time in s of the motor on a staircase of duties that changes every 0.2 s."""

    def run(plant: Plant, steps: int) -> float:
        motor = Motor(plant, pwm=pwm)
        stairs = np.repeat(np.random.default_rng(1).uniform(-90.0, 90.0, -(-steps // 40)), 40)[:steps]
        modes = np.full(steps, DRIVEN)
        begin = time.process_time()
        motor.run_many(modes, stairs, STEP_S)
        return time.process_time() - begin

    return run


WAYS = (
    Way("behind the wire", behind_the_wire, (300.0, 100.0)),
    Way("motor alone, averaged PWM", motor_alone("averaged"), (5000.0, 500.0)),
    Way("motor alone, resolved edges", motor_alone("edge_resolved"), (1000.0, 75.0)),
)


def measure(repeats: int, simulated_s: float) -> list[dict[str, Any]]:
    """The best ratio of each way and plant."""
    if missing := set(effects()) ^ set(ALL):
        raise SystemExit(f"the table of effects in this script is not that of the board: {', '.join(sorted(missing))}")
    steps = round(simulated_s / STEP_S)
    rows = []
    for way in WAYS:
        for (label, chosen), target in zip(PLANTS.items(), way.targets, strict=True):
            plant = make_plant({**MOTOR, "effects": chosen}, label)
            way.run(plant, 40)  # warm: compiled and loaded
            times = [way.run(plant, steps) for _ in range(repeats)]
            ratio = steps * STEP_S / min(times)
            rows.append({"way": way.name, "plant": label, "times_real_time": ratio, "target": target})
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--repeats", type=int, default=10, help="the best of so many counts (10)")
    parser.add_argument("--simulated-s", type=float, default=4.0, help="simulated time of each repeat (4)")
    parser.add_argument("--json", type=Path, help="write the rows to this file as well")
    options = parser.parse_args()
    if options.repeats < 1 or not STEP_S <= options.simulated_s <= 1e4:
        parser.error("--repeats is 1 or more, --simulated-s 0.005 to 10000")
    rows = measure(options.repeats, options.simulated_s)
    print(f"{'':28} {'':12} {'x real time':>12} {'target':>8}")
    for row in rows:
        verdict = "" if row["times_real_time"] >= row["target"] else "  missed"
        print(f"{row['way']:28} {row['plant']:12} {row['times_real_time']:12.0f} {row['target']:8.0f}{verdict}")
    if options.json:
        about = {"machine": platform.processor() or platform.machine(), "python": platform.python_version()}
        options.json.write_text(json.dumps({**about, "rows": rows}, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
