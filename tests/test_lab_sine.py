"""Gain and phase of a sine that a limit cuts: those of the first harmonic, to the printed digits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from fiohost.errors import DataError
from fiohost.labs.constants import TEXT
from fiohost.labs.open_loop_sine import FREQUENCIES, calculate, gain_and_phase, open_loop_sine
from fiohost.labs.session import Session

Q = TEXT["no_load"]
# 10 V cut at 4.5 V and 1 A, by an integration to nine digits and the Fourier integral of the last period
CUT = {0.5: (2.110, -2.32), 1.0: (2.105, -4.62), 2.0: (2.086, -9.19), 5.0: (1.875, -29.15), 10.0: (1.298, -61.67)}


def cut_sine(omega: float, duration_s: float, drift_rad_s: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times at 5 ms, the voltage as it was given (n), and the angle in counts of half a degree."""
    times = np.arange(round(duration_s / 0.005) + 1) * 0.005

    def volts(t: np.ndarray) -> np.ndarray:
        return np.clip(10.0 * np.sin(omega * t), -4.5, 4.5)

    def rates(t: float, x: np.ndarray) -> list[float]:
        amps, speed, _ = x
        slope = (float(volts(np.array(t))) - Q.R_ohm * amps - Q.Ke_Vs_per_rad * speed) / Q.L_H
        torque = Q.Kt_Nm_per_A * min(max(amps, -1.0), 1.0)
        return [slope, (torque - Q.B_Nms * speed) / Q.J_kgm2, speed]

    found = solve_ivp(rates, (0.0, times[-1]), [0.0] * 3, "LSODA", times, rtol=1e-8, atol=1e-10, max_step=0.02)
    angle = np.degrees(found.y[2] + drift_rad_s * times)
    return times, volts(times + 0.0025), np.floor(angle / 0.5) * 0.5


@pytest.mark.parametrize("omega", [0.5, 1.0, 2.0, 5.0])
def test_a_cut_sine_has_the_gain_and_phase_of_its_first_harmonic(omega: float) -> None:
    period = 2.0 * np.pi / omega
    times, volts, angle = cut_sine(omega, 0.8 + period * max(1, round(omega)) + 0.01)
    found = gain_and_phase(times, volts, angle, omega, 0.0)
    assert (found.gain, found.phase_deg) == pytest.approx(CUT[omega], abs=0.006)
    assert found.gain == pytest.approx(CUT[omega][0], abs=0.0011)
    assert found.input_V == pytest.approx(10.0, abs=0.01)  # the sine that was asked for, not what was left of it
    assert found.cut_pct > 60.0


def test_a_shaft_that_drifts_beside_its_sine_has_the_same_gain_and_phase() -> None:
    times, volts, angle = cut_sine(1.0, 0.8 + 2.0 * np.pi + 0.6, drift_rad_s=0.3)
    found = gain_and_phase(times, volts, angle, 1.0, 0.0)
    assert (found.gain, found.phase_deg) == pytest.approx(CUT[1.0], abs=0.01)


def test_a_command_that_stands_at_its_limit_all_the_time_is_no_sine() -> None:
    times = np.arange(2000) * 0.005
    with pytest.raises(DataError, match="limit all the time"):
        gain_and_phase(times, np.sign(np.sin(times + 1e-9)) * 4.5, times, 1.0, 0.0)
    square = np.sign(np.sin(3.0 * times + 1e-9)) * (4.0 + 1e-2 * times)
    with pytest.raises(DataError, match="holds no sine"):
        gain_and_phase(times, square, times, 1.0, 0.0)


def test_the_experiment_asks_all_five_frequencies_at_both_amplitudes_and_its_logs_say_the_same(tmp_path: Path) -> None:
    with Session.open("sim:nxt_no_load", "no_load", tmp_path, seed=1) as session:
        result = open_loop_sine(session, (0.5, 10.0))
    assert FREQUENCIES == (0.5, 1.0, 2.0, 5.0, 10.0)
    assert result.values["large_omega_rad_s"] == [0.5, 10.0]
    large = result.tables[1]
    for row in large.rows:
        gain, phase_deg = CUT[float(str(row[1]))]
        assert row[4] == pytest.approx(gain, abs=0.0006)
        assert row[6] == pytest.approx(phase_deg, abs=0.006 if row[0] == "model" else 0.03)
    from fiohost.bench.log import Log

    again = calculate(Log.read(tmp_path / "sine_10V_0p5rad_s.csv"), 0.5, 4.5)
    assert again.input_V == pytest.approx(10.0, abs=0.02)
    assert (again.gain, again.phase_deg) == pytest.approx(CUT[0.5], abs=0.006)
