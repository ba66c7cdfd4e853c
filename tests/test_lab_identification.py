"""What intervals of the closed-loop identification count: the encoder's half count, the plateau of a peak."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

import fiohost
from fiohost.bench.log import Log
from fiohost.bench.profile import BenchProfile
from fiohost.control.settings import ControlSettings
from fiohost.estimation.intervals import estimates
from fiohost.estimation.logs import identify
from fiohost.estimation.second_order import from_overshoot
from fiohost.labs.identification import identification, replicas, run_and_fit

COUNT_DEG = 0.5
GAIN, TAU_S, WINDING_S, FRICTION_PCT = 10.5907, 0.102034, 0.00272, 3.676  # of the default plant


def counted_loop(zeta: float, omega: float, shift_deg: float) -> Log:
    """A second-order loop, the same step of 20 deg up and down, read in counts of half a degree, 5 ms late."""
    times = np.arange(0, 4800) * 0.005
    ref = np.where((times // 3.0) % 2.0 < 1.0, 170.0, 190.0)
    damped, y, x, v = omega * math.sqrt(1.0 - zeta**2), np.empty(len(times)), 170.0, 0.0
    assert damped > 0.0
    for k in range(len(times)):
        y[k] = np.floor((x + shift_deg) / COUNT_DEG) * COUNT_DEG
        held = ref[max(k - 1, 0)]
        for _ in range(20):
            v += 0.00025 * (omega**2 * (held - x) - 2.0 * zeta * omega * v)
            x += 0.00025 * v
    columns = {"time_s": times, "duty_pct": 0.5 * (ref - y), "ref_deg": ref, "angle_deg": y}
    about = {"kp_pct_per_deg": "1.0", "controller": "p", "sample_time_s": "0.005", "counts_per_rev": "720",
             "command_delay_ticks": "1", "limit_pct": "100"}  # fmt: skip
    return Log.from_columns(columns, about, "counted")


@pytest.mark.parametrize("shift_deg", [0.05, 0.2, 0.35, 0.45])
def test_steps_that_repeat_to_the_count_still_leave_half_a_count_and_a_plateau_open(shift_deg: float) -> None:
    """Every step reads the same, so nothing scatters; the intervals hold the truth all the same."""
    zeta, omega = 0.5, 11.0
    found = identify(counted_loop(zeta, omega, shift_deg), "step")
    for name, truth in {"zeta": zeta, "omega_n_rad_s": omega, "tau_s": 1.0 / (2.0 * zeta * omega),
                        "gain_deg_s_per_pct": omega / (2.0 * zeta)}.items():  # fmt: skip
        low, high = found.parameters[name].ci95
        assert low <= truth <= high, (name, shift_deg)
        assert high - low < 0.6 * truth
    half = found.parameters["gain_deg_s_per_pct"].half_width
    assert half > 0.1  # half a count of 20 deg is 1.25 % of overshoot, and a peak stands for some ticks


def test_the_peak_that_is_printed_is_the_one_that_was_used() -> None:
    found = identify(counted_loop(0.5, 11.0, 0.2), "step")
    assert found.steps
    for step in found.steps:
        assert step.zeta is not None
        assert from_overshoot(step.figures.overshoot_pct, step.figures.peak_s) == pytest.approx(
            (step.zeta, step.omega_n_rad_s), rel=1e-9
        )
        assert step.peak_half_s >= 0.0025
    head = found.to_json()["steps"][0]
    assert head["peak_s"] == found.steps[0].figures.peak_s


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_intervals_of_the_fit_with_friction_hold_what_is_in_the_board(seed: int, tmp_path: Path) -> None:
    control = ControlSettings(kp_pct_per_deg=1.0).with_compensation(3.0, -3.0)
    with fiohost.connect("sim", seed=seed) as bench:
        log, fit = run_and_fit(bench, tmp_path, control)
    found = estimates(fit, replicas(log, fit))
    truth = {"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU_S, "coulomb_friction.level_pct": FRICTION_PCT,
             "armature_inductance.time_constant_s": WINDING_S}  # fmt: skip
    for name, value in truth.items():
        low, high = found[name].ci95
        assert low <= value <= high, name
    assert found["linear.gain_deg_s_per_pct"].half_width < 0.02


def test_the_lab_prints_intervals_that_hold_the_motor(tmp_path: Path) -> None:
    with fiohost.connect("sim") as bench:
        values = identification(bench, tmp_path, BenchProfile("sim", "ramp", 3.75, -3.75, share=0.8)).values
    for name, truth in {"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU_S}.items():
        low, high = values["with_friction"]["parameters"][name]["ci95"]
        assert low <= truth <= high
