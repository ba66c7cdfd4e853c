"""A speed that a filter smooths before it is logged: simulated, fitted, and told from what lags in the motor."""

from __future__ import annotations

import numpy as np
import pytest

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.offered import candidates, span_of
from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import ANGLE, MEAN_SPEED, SPEED, Record, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

GAIN, TAU_S, LEVEL_PCT, LAG_S = 12.0, 0.08, 4.0, 0.03
TICK_S, LOOP_S, FINE_S = 0.01, 1e-4, 1e-4
KEPT = float(np.exp(-LOOP_S / LAG_S))  # of itself from one turn of the logger's loop to the next
TRUTH = {"linear.gain_deg_s_per_pct": GAIN, "linear.tau_s": TAU_S, "coulomb_friction.level_pct": LEVEL_PCT}
NOISE_DEG_S = 1.0


def duties(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Random levels (n), each held for 0.3 s."""
    return np.repeat(rng.uniform(-70.0, 70.0, round(seconds / 0.3)), round(0.3 / TICK_S))


def speeds(duty: np.ndarray, winding_s: float = 0.0) -> np.ndarray:
    """Speeds (m) in deg/s of a motor with dry friction by Euler's rule at every turn of the logger's loop, its winding
    lagging by ``winding_s``.
    """
    speed = drive = 0.0
    per_row, per_loop, pull = round(TICK_S / FINE_S), round(LOOP_S / FINE_S), FINE_S * GAIN / TAU_S
    found = np.empty(len(duty) * per_row // per_loop)
    for k, asked in enumerate(duty):
        for i in range(per_row):
            if i % per_loop == 0:
                found[(k * per_row + i) // per_loop] = speed
            wanted = asked - speed / GAIN
            drive = drive + FINE_S / winding_s * (wanted - drive) if winding_s else wanted
            moves = np.sign(speed) or np.sign(drive)
            if speed == 0.0 and abs(drive) <= LEVEL_PCT:
                continue
            after = speed + pull * (drive - LEVEL_PCT * moves)
            speed = 0.0 if speed * after < 0.0 else after
    return found


def logged(seconds: float, seed: int, *, kept: float = KEPT, winding_s: float = 0.0, kind: int = SPEED) -> Record:
    """A log of speeds, each of which a filter mixes with what it showed before."""
    rng = np.random.default_rng(seed)
    duty = duties(seconds, rng)
    shown, smooth = [], 0.0
    for value in speeds(duty, winding_s):
        smooth = kept * smooth + (1.0 - kept) * value
        shown.append(smooth)
    y = np.array(shown[:: round(TICK_S / LOOP_S)]) + rng.normal(0.0, NOISE_DEG_S, len(duty))
    times = np.arange(len(duty)) * TICK_S
    return make_record(f"log {seed}", times, duty, y, kind=kind, unit="deg/s", at_rest=True, command_delay_s=0.0)


def model(lag_s: float | None) -> Model:
    found = Model(("coulomb_friction",), TRUTH)
    return found if lag_s is None else found.with_effect("speed_filter", {"time_constant_s": lag_s})


def test_the_filter_is_that_of_an_average_that_forgets() -> None:
    record = logged(12.0, 1, kind=SPEED)
    error = record.y - free_output(record, Flat.of(model(LAG_S)), Start(0.0, 0.0))
    without = record.y - free_output(record, Flat.of(model(None)), Start(0.0, 0.0))
    assert np.sqrt(np.mean(error**2)) < 1.5 * NOISE_DEG_S
    assert np.sqrt(np.mean(without**2)) > 30.0 * NOISE_DEG_S


@pytest.mark.parametrize("kind", [SPEED, MEAN_SPEED])
def test_a_filter_without_lag_shows_the_speed_as_it_is(kind: int) -> None:
    record = logged(3.0, 2, kind=kind)
    shown = free_output(record, Flat.of(model(0.0)), Start(5.0, 40.0))
    np.testing.assert_allclose(shown, free_output(record, Flat.of(model(None)), Start(5.0, 40.0)), atol=1e-6)


@pytest.mark.parametrize("windows", [False, True])
def test_its_lag_and_that_of_the_motor_are_found_apart(windows: bool) -> None:
    found = fit(model(0.01), [logged(15.0, 3)], windows=windows).model
    assert found.number("speed_filter.time_constant_s") == pytest.approx(LAG_S, rel=0.05)
    assert found.number("linear.tau_s") == pytest.approx(TAU_S, rel=0.02)
    assert found.number("linear.gain_deg_s_per_pct") == pytest.approx(GAIN, rel=0.01)


@pytest.mark.long
@pytest.mark.parametrize(
    ("truth", "kept", "winding_s"), [("speed_filter", KEPT, 0.0), ("armature_inductance", 0.0, 0.02)]
)
def test_a_filter_and_a_winding_that_lags_are_told_apart(truth: str, kept: float, winding_s: float) -> None:
    logs = [logged(10.0, seed, kept=kept, winding_s=winding_s) for seed in (4, 5, 6)]
    library = ["speed_filter", "armature_inductance", "transport_delay", "stribeck_friction", "constant_load"]
    found = diagnose_records(logs, [], Model.parse("linear+coulomb_friction"), library=library)
    assert [s.effect for s in found.steps] == [truth]
    assert found.verdict == "explained"


def test_where_angles_are_logged_it_is_not_asked_for() -> None:
    angles = logged(3.0, 7, kind=ANGLE)
    asked = {e.name for e in candidates(model(None), [angles], None, span_of([angles]))}
    assert not {"speed_filter", "unsigned_speed"} & asked
    assert {"speed_filter", "unsigned_speed"} <= {
        e.name for e in candidates(model(None), [logged(3.0, 7)], None, span_of([logged(3.0, 7)]))
    }
