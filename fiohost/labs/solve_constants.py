"""A motor's constants solved from readings: Ra, Ki, Kb, B, dry friction, time constant, inertia, with intervals.

The tests are the text's (stall, lifting, no load, step, run-down); what is made of them differs in three places:
- lifting at one voltage, more load is less speed and less viscous friction, so the slope of current on torque is
  1 / (Ki + B Ra / Kb), not 1 / Ki;
- voltage on speed has the slope Kb only once Ra times the current is taken off;
- friction is viscous and dry: Ki i = B w + Tc. All of it taken for viscous, B falls as power rises (Fig. D-22).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from fiohost.errors import DataError
from fiohost.labs.constants import BOUNDS, MotorConstants
from fiohost.labs.inductance import inductance_H
from fiohost.labs.readings import Readings

DRAWS = 4000
ITERATIONS = 50
ROUNDING = 1e-9  # of an interval: a value that is smaller is that of floating point
LEAST_LINE = 3  # points of a straight line that shall have a spread
UNITS = {"La": "H", "Ra": "ohm", "Ki": "N m/A", "Kb": "V s/rad", "B": "N m s", "Tc": "N m", "tau_m": "s", "J": "kg m2"}


@dataclass(frozen=True)
class Line:
    """A straight line by least squares: slope and intercept, their covariance (2, 2), and degrees of freedom.

    Without spare points the covariance is zero and ``spare`` 0: a value, but no interval.
    """

    slope: float
    intercept: float
    covariance: np.ndarray
    spare: int

    @classmethod
    def fit(cls, x: np.ndarray, y: np.ndarray, y_step: float, x_step: float = 0.0, through_zero: bool = False) -> Line:
        """Fit a line. Scatter is never taken for less than what the steps of both meters make."""
        basis = x[:, None] if through_zero else np.column_stack([x, np.ones_like(x)])
        if len(x) < basis.shape[1] or np.linalg.matrix_rank(basis) < basis.shape[1]:
            raise DataError("the readings of a line all lie at one place: read at different powers or loads")
        found = np.linalg.lstsq(basis, y, rcond=None)[0]
        spare = len(x) - len(found)
        covariance = np.zeros((2, 2))
        if spare > 0:
            rest = y - basis @ found
            least = (y_step**2 + (float(found[0]) * x_step) ** 2) / 12.0  # of values rounded to a step
            own = max(float(rest @ rest) / spare, least) * np.linalg.inv(basis.T @ basis)
            covariance[: len(found), : len(found)] = own
        return cls(float(found[0]), 0.0 if through_zero else float(found[1]), covariance, spare)

    def draw(self, rng: np.random.Generator, n: int) -> np.ndarray:
        """Slopes and intercepts (n, 2) as the readings leave them open (Student's t)."""
        centre = np.array([self.slope, self.intercept])
        if self.spare == 0:
            return np.tile(centre, (n, 1))
        normal = rng.multivariate_normal(np.zeros(2), self.covariance, n, method="svd")
        scale = np.sqrt(self.spare / rng.chisquare(self.spare, n))
        return np.asarray(centre + normal * scale[:, None])


@dataclass(frozen=True)
class Constant:
    """A constant with its 95 % interval, None where the readings are too few for one."""

    name: str
    value: float
    low: float | None
    high: float | None
    n: int

    @property
    def unit(self) -> str:
        return UNITS[self.name]


@dataclass(frozen=True)
class Lines:
    """The straight lines behind the constants. ``emf`` is voltage on speed with an intercept, the text's way."""

    stall: Line
    lift: Line
    speed_current: Line | None  # current on speed: friction; None for fewer than three speeds
    emf: Line | None
    mean_current_share: float  # of current and speed, where there is no line


def columns_of(readings: Readings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Voltage, speed and current of the no-load readings that have all three."""
    rows = [(r.voltage_V, r.speed_rad_s, r.current_A) for r in readings.no_load if r.current_A is not None]
    if not rows:
        raise DataError("no reading of voltage, speed and current without load: Kb and friction need one at least")
    table = np.array(rows, dtype=np.float64)
    if np.any(table[:, 1] == 0.0):
        raise DataError("a no-load reading has a speed of 0: that is a stall")
    return table[:, 0], table[:, 1], table[:, 2]


def solve(readings: Readings) -> tuple[dict[str, Constant], Lines]:
    """All constants, with intervals from draws of the lines behind them (seeded, so the same each time).

    Raises DataError where a kind of reading is missing or says nothing.
    """
    for kind, rows, least in (("stall", readings.stall, 1), ("lift", readings.lift, 2)):
        if len(rows) < least:
            raise DataError(f"{len(rows)} readings of {kind} of port {readings.port}: {least} at least are needed")
    stall = np.array(readings.stall)
    lift = np.array(readings.lift)
    ampere, volts = readings.meter_A, readings.meter_V
    volt, speed, current = columns_of(readings)
    lines = Lines(
        Line.fit(stall[:, 1], stall[:, 0], volts, ampere, through_zero=True),
        Line.fit(lift[:, 0], lift[:, 1], ampere),
        Line.fit(speed, current, ampere) if len(speed) >= LEAST_LINE else None,
        Line.fit(speed, volt, volts) if len(speed) >= LEAST_LINE else None,
        float(np.mean(current / speed)),
    )
    if lines.stall.slope <= 0.0 or lines.lift.slope <= 0.0:
        raise DataError("more current at less voltage or less torque: signs of the readings are mixed up")
    rng = np.random.default_rng(1)
    R = np.concatenate(([lines.stall.slope], lines.stall.draw(rng, DRAWS)[:, 0]))
    s = np.concatenate(([lines.lift.slope], lines.lift.draw(rng, DRAWS)[:, 0]))
    friction = np.zeros((DRAWS + 1, 2))
    if lines.speed_current is None:
        friction[:, 0] = lines.mean_current_share
    else:
        friction[0] = lines.speed_current.slope, lines.speed_current.intercept
        friction[1:] = lines.speed_current.draw(rng, DRAWS)
    # Kb from (V - R i) = Kb w, linear in R; its own scatter beside that of R
    at_R = Line.fit(speed, volt - R[0] * current, math.hypot(volts, R[0] * ampere), through_zero=True)
    share = float(speed @ current) / float(speed @ speed)
    own = np.concatenate(([0.0], at_R.draw(rng, DRAWS)[:, 0] - at_R.slope))
    Kb = at_R.slope - (R - R[0]) * share + own
    Ki = 1.0 / s
    for _ in range(ITERATIONS):  # B is Ki times a slope, Ki is 1/slope less B R / Kb
        Ki = 1.0 / s - Ki * friction[:, 0] * R / Kb
    B, Tc = Ki * friction[:, 0], Ki * friction[:, 1]
    found = {
        "Ra": _constant("Ra", R, lines.stall.spare, len(stall)),
        "Ki": _constant("Ki", Ki, lines.lift.spare, len(lift)),
        "Kb": _constant("Kb", Kb, at_R.spare, len(speed)),
        "B": _constant("B", B, lines.speed_current.spare if lines.speed_current else 0, len(speed)),
    }
    if lines.speed_current is not None:
        found["Tc"] = _constant("Tc", Tc, lines.speed_current.spare, len(speed))
    if readings.time_constants_s:
        taus = np.array(readings.time_constants_s)
        tau = np.full(DRAWS + 1, taus.mean())
        if len(taus) > 1:
            error = taus.std(ddof=1) / math.sqrt(len(taus))
            tau[1:] += error * rng.standard_t(len(taus) - 1, DRAWS)
        found["tau_m"] = _constant("tau_m", tau, len(taus) - 1, len(taus))
        J = tau * (B + Ki * Kb / R)
        found["J"] = _constant("J", J, len(taus) - 1, len(taus))
        winding = inductance_H(readings, *(float(value[0]) for value in (R, Ki, Kb, J, B, Tc)))
        if winding is not None:
            found["La"] = Constant("La", winding[0], None, None, winding[2])
    return found, lines


def _constant(name: str, values: np.ndarray, spare: int, n: int) -> Constant:
    """The first value is the estimate, the others are draws. What is zero but for rounding is 0."""
    if spare <= 0:
        return Constant(name, float(values[0]), None, None, n)
    low, high = np.quantile(values[1:], (0.025, 0.975))
    value = float(values[0])
    return Constant(name, value if abs(value) > ROUNDING * (high - low) else 0.0, float(low), float(high), n)


def constants_of(found: Mapping[str, Constant], readings: Readings, L_H: float | None = None) -> MotorConstants:
    """The set of constants that the other experiments take, the inductance as given or as measured.

    Raises DataError where J or the inductance is missing.
    """
    if "J" not in found:
        raise DataError("no time constant among the readings, so no inertia: the set of constants is not whole")
    if L_H is None and "La" not in found:
        raise DataError("no reading tells the inductance: give --inductance, or rows of inductance or rise")
    L_H = found["La"].value if L_H is None else L_H
    dry = max(found["Tc"].value, 0.0) if "Tc" in found and is_there(found["Tc"]) else 0.0
    return MotorConstants(
        R_ohm=found["Ra"].value, L_H=L_H, Kt_Nm_per_A=found["Ki"].value, Ke_Vs_per_rad=found["Kb"].value,
        J_kgm2=found["J"].value, B_Nms=max(found["B"].value, BOUNDS["B_Nms"][0]), coulomb_Nm=dry,
        supply_V=readings.supply_V, source=f"characterised: {readings.source}, port {readings.port}",
    )  # fmt: skip


def is_there(constant: Constant) -> bool:
    """Whether an interval leaves out zero."""
    return constant.low is None or constant.low > 0.0


def predicted_run_down(B: float, Tc: float, J: float, from_rad_s: float) -> float:
    """Time to 37 % of a speed under viscous and dry friction alone (the winding open)."""
    left = math.exp(-1.0) * from_rad_s
    if B <= 1e-12:
        return J * (from_rad_s - left) / Tc if Tc > 0.0 else math.inf
    return J / B * math.log((from_rad_s + Tc / B) / (left + Tc / B))


def speed_torque_line(readings: Readings) -> tuple[float, float]:
    """Slope in rad/s per N m and speed without load of the line through the lifts."""
    torque, _, speed = np.array(readings.lift_speed).T
    slope, begin = np.polyfit(torque, speed, 1)
    return float(slope), float(begin)
