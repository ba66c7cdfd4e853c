"""A diagnosis made by hand, with arrays to match, for the tests of the report room."""

from __future__ import annotations

from typing import Any

import numpy as np

from fiohost.report.series import CurvePlot, SeriesPlot


def error(rms: float) -> dict[str, Any]:
    return {"free_run_rms": rms, "window_rms": rms / 3, "bin_violation_pct": 4.2, "fit_pct": 99.1, "samples": 4000}


def pair(train: float, holdout: float) -> dict[str, Any]:
    return {"train": error(train), "holdout": error(holdout)}


def parameter(value: float, unit: str, **more: Any) -> dict[str, Any]:
    return {
        "value": value, "unit": unit, "ci95": [0.99 * value, 1.01 * value],
        "identifiable": True, "at_bound": False, **more,
    }  # fmt: skip


def diagnosis() -> dict[str, Any]:
    files = [("staircase.csv", "train"), ("multisine.csv", "train"), ("multisine_repeat.csv", "train"),
             ("square_170_190.csv", "train"), ("random_steps.csv", "holdout")]  # fmt: skip
    final = {
        "linear.gain_deg_s_per_pct": parameter(10.1, "deg/s/%"),
        "linear.tau_s": parameter(0.0832, "s"),
        "coulomb_friction.level_pct": parameter(1.61, "%"),
        "gravity_load.level_pct": parameter(2.4, "%"),
        "gravity_load.phase_deg": parameter(31.0, "deg", identifiable=False),
        "backlash.gap_deg": parameter(0.0, "deg", at_bound=True),
    }
    names = ["gravity_load", "constant_load", "coulomb_friction", "transport_delay", "backlash", "input_deadband"]
    return {
        "schema": "fiohost.diagnosis/1",
        "fiohost_version": "0.1.0",
        "seconds": 12.3,
        "output_unit": "deg",
        "declared": {"model": "linear+coulomb_friction", "parameters": {}},
        "verdict": "explained",
        "before": pair(21.3, 18.7),
        "steps": [
            {
                "effect": "gravity_load",
                "parameters": {"level_pct": final["gravity_load.level_pct"]},
                "evidence": {"gain_pct": 98.2},
                "after": pair(0.151, 0.149),
                "indistinguishable_from": ["cogging_torque"],
            }
        ],
        "after": pair(0.151, 0.149),
        "final": {"model": "linear+coulomb_friction+gravity_load", "parameters": final},
        "floor": {**pair(0.147, 0.146), "from": "replicas", "replicas": 20},
        "logs": [
            {
                "file": f"/tmp/<b>bench</b>/{name}", "sha256": "0" * 64, "role": role, "initial": {},
                "before": error(25.0 / (i + 1)), "after": error(0.150), "floor": error(0.147),
            }
            for i, (name, role) in enumerate(files)
        ],
        "candidates": [
            {"effect": name, "score": 0.97 / 2**i, "rejected_because": "" if i == 0 else "worse in cross-validation"}
            for i, name in enumerate(names)
        ],
        "residual": {"white": True, "depends_on": ["angle", "speed_sign"], "tests": {"angle": {"strength": 0.1}}},
        "next_experiment": {"why": "turn the rig by 90 degrees", "experiment": "slow_turns"},
    }  # fmt: skip


def series(role: str = "holdout", samples: int = 4000) -> SeriesPlot:
    rng = np.random.default_rng(1)
    time_s = np.arange(samples) * 0.005
    duty_pct = 40.0 * np.sign(np.sin(2 * np.pi * time_s / 6.0))
    truth = 180.0 + 120.0 * np.sin(2 * np.pi * time_s / 6.0)
    measured = np.round(2 * truth) / 2
    return SeriesPlot(
        title="random_steps.csv", role=role, unit="deg", time_s=time_s, measured=measured,
        before=truth + 18.0 * np.sin(2 * np.pi * time_s / 2.3), after=truth + rng.normal(0, 0.05, samples),
        duty_pct=duty_pct, floor_rms=0.146,
    )  # fmt: skip


def curve() -> CurvePlot:
    speed = np.linspace(-800.0, 800.0, 41)
    friction = 1.6 * np.sign(speed) + 0.6 * np.exp(-np.abs(speed) / 90.0) * np.sign(speed)
    return CurvePlot(
        title="Missing torque against speed", x_label="speed (deg/s)", y_label="torque (% of duty)", x=speed,
        lines={"estimated": friction, "model": 1.6 * np.sign(speed)}, band=(friction - 0.2, friction + 0.2),
        points={"measured": (speed[::4], friction[::4] + 0.1)},
    )  # fmt: skip
