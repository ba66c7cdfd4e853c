"""A motor's constants from readings: Ra, Ki, Kb, B, dry friction, time constant and inertia, each with an interval.

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
from typing import TYPE_CHECKING

import numpy as np

from fiohost.errors import DataError
from fiohost.labs.constants import BOUNDS, MotorConstants
from fiohost.labs.inductance import inductance_H
from fiohost.labs.readings import Readings
from fiohost.labs.result import Answer, Cell, LabResult, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fiohost.report.panels import Panel

DRAWS = 4000
ITERATIONS = 50
LEAST_LINE = 3  # points of a straight line that shall have a spread
# The text's values (tables D-4 to D-6 and section D-1-4) and its run-down, measured
TEXT = {"La": 0.0047, "Ra": 2.27, "Ki": 0.25, "Kb": 0.25, "B": 0.00131, "tau_m": 0.081, "J": 0.00233}
TEXT_FULL_V = 4.5
GEAR_STAGES = (((10, 30, 40), 4), ((9, 27), 3), ((10, 20), 2), ((10, 13, 20), 2))  # table D-1
GEAR_RATIO = 48
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


def _columns(readings: Readings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
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
    volt, speed, current = _columns(readings)
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
    """The first value is the estimate, the others are draws."""
    if spare <= 0:
        return Constant(name, float(values[0]), None, None, n)
    low, high = np.quantile(values[1:], (0.025, 0.975))
    return Constant(name, float(values[0]), float(low), float(high), n)


def constants_of(found: Mapping[str, Constant], readings: Readings, L_H: float | None = None) -> MotorConstants:
    """The set of constants that the other experiments take, the inductance as given or as measured.

    Raises DataError where J or the inductance is missing.
    """
    if "J" not in found:
        raise DataError("no time constant among the readings, so no inertia: the set of constants is not whole")
    if L_H is None and "La" not in found:
        raise DataError("no reading tells the inductance: give --inductance, or rows of inductance or rise")
    L_H = found["La"].value if L_H is None else L_H
    dry = max(found["Tc"].value, 0.0) if "Tc" in found and _is_there(found["Tc"]) else 0.0
    return MotorConstants(
        R_ohm=found["Ra"].value, L_H=L_H, Kt_Nm_per_A=found["Ki"].value, Ke_Vs_per_rad=found["Kb"].value,
        J_kgm2=found["J"].value, B_Nms=max(found["B"].value, BOUNDS["B_Nms"][0]), coulomb_Nm=dry,
        supply_V=readings.supply_V, source=f"characterised: {readings.source}, port {readings.port}",
    )  # fmt: skip


def _is_there(constant: Constant) -> bool:
    """Whether an interval leaves out zero."""
    return constant.low is None or constant.low > 0.0


def predicted_run_down(B: float, Tc: float, J: float, from_rad_s: float) -> float:
    """Time to 37 % of a speed under viscous and dry friction alone (the winding open)."""
    left = math.exp(-1.0) * from_rad_s
    if B <= 1e-12:
        return J * (from_rad_s - left) / Tc if Tc > 0.0 else math.inf
    return J / B * math.log((from_rad_s + Tc / B) / (left + Tc / B))


def characterise(readings: Readings, L_H: float | None, target: str) -> LabResult:
    """The constants as a result; ``L_H`` is the inductance where it is known. Raises DataError."""
    found, lines = solve(readings)
    if L_H is not None:
        found["La"] = Constant("La", L_H, None, None, 1)
    rows: list[list[Cell]] = []
    for name, c in found.items():
        text = TEXT.get(name)
        differs = None if text is None else 100.0 * (c.value / text - 1.0)
        rows.append([name, c.unit, c.value, c.low, c.high, c.n, text, differs])
    columns = ("constant", "unit", "found", "95 % from", "to", "readings", "text", "differs %")
    tables = [
        Table(f"Constants at the output shaft, motor port {readings.port}", columns, rows),
        _powers(readings, found),
        *([_speed_torque(readings, found)] if len(readings.lift_speed) > 1 else []),
        gear_table(found),
    ]
    why = "; ".join(f"{name}: {text}" for name, text in _why(found, lines, readings).items())
    answers = [Answer("How was each constant found, and where would the text's way have led?", why)]
    values = {name: {"value": c.value, "unit": c.unit, "ci95": [c.low, c.high], "readings": c.n, "text": TEXT.get(name)}
              for name, c in found.items()}  # fmt: skip
    if readings.run_down and "J" in found:
        answers.append(_run_down_answer(readings, found))
    answers.append(_check_constants(found))
    if len(readings.lift_speed) > 1:
        answers.append(_speed_torque_answer(readings, found))
    notes = []
    if abs(readings.supply_V - TEXT_FULL_V) > 0.01:
        notes.append(f"full duty is {readings.supply_V:g} V here and {TEXT_FULL_V:g} V in the text: another supply, or "
                     "voltages that are not halved")  # fmt: skip
    if lines.speed_current is None:
        notes.append(
            "fewer than three no-load speeds: dry friction cannot be told from viscous, all is taken for viscous; were "
            f"all of it dry, Ki would be {1.0 / lines.lift.slope:.4f} N m/A"
        )
    if readings.lift_stalled:
        notes.append(f"stalled lifts left out of the line ({len(readings.lift_stalled)}): there friction helps to hold")
    return LabResult(
        name="characterise",
        title="Constants of the motor from readings",
        target=target,
        tables=tuple(tables),
        answers=tuple(answers),
        notes=tuple(notes),
        values={"port": readings.port, "constants": values, "L_H": found["La"].value if "La" in found else None,
                "gear_ratio": GEAR_RATIO, "source": readings.source, **_curves(readings, found)},
        figures={"characterise": lambda: _draw(readings, found, lines),
                 "characterise_curves": lambda: _draw_curves(readings, found)},
    )  # fmt: skip


def _why(found: Mapping[str, Constant], lines: Lines, readings: Readings) -> dict[str, str]:
    """For each constant where the text's way would lead with these readings, in a few words."""
    R, Kb, B = (found[name].value for name in ("Ra", "Kb", "B"))
    ratios = [v / i for v, i in readings.stall if i]
    emf = "" if lines.emf is None else f"; slope of V on w alone {lines.emf.slope:.4f}"
    half = ". The text halves the wires' voltage" if TEXT["Ra"] * 1.6 < R else ""
    why = {
        "La": _why_La(readings),
        "Ra": f"slope through zero; mean of ratios, as the text: {np.mean(ratios):.3f}{half}",
        "Ki": f"1/slope of i on T is {1.0 / lines.lift.slope:.4f}; viscous friction in it: {B * R / Kb:.4f}",
        "Kb": f"(V - Ra i) on w{emf}",
        "B": "slope of Ki i on w, dry friction apart" if lines.speed_current else "Ki i / w, all friction",
        "tau_m": "mean of the steps",
        "J": "tau_m (B + Ki Kb / Ra)",
    }
    if "Tc" in found:
        there = "" if _is_there(found["Tc"]) else " (none to be seen)"
        why["Tc"] = f"dry friction, the rest of Ki i at no speed{there}; the text has it in B"
    return why


def _why_La(readings: Readings) -> str:
    if readings.inductance_H:
        return "by a meter"
    return (
        "the stalled winding's time constant, with R + Ra"
        if readings.decay
        else ("the current's rise in the first ticks after a step" if readings.rise else "as given")
    )


def _powers(readings: Readings, found: Mapping[str, Constant]) -> Table:
    """Fig. D-22: viscous friction as the text takes it, power by power."""
    Ki = found["Ki"].value
    rows: list[list[Cell]] = [
        [100.0 * r.voltage_V / readings.supply_V, r.voltage_V, r.speed_rad_s, r.current_A,
         None if r.current_A is None else Ki * r.current_A / r.speed_rad_s]
        for r in readings.no_load
    ]  # fmt: skip
    columns = ("power %", "V", "rad/s", "A", "Ki i / w N m s")
    return Table("Friction taken as viscous, power by power (Eq. D-11, Fig. D-22)", columns, rows)


def _speed_torque(readings: Readings, found: Mapping[str, Constant]) -> Table:
    """Fig. D-21, and viscous friction lift by lift (Eq. D-10)."""
    Ki = found["Ki"].value
    rows: list[list[Cell]] = [
        [torque, speed, amps, (Ki * amps - torque) / speed] for torque, amps, speed in readings.lift_speed
    ]
    columns = ("load N m", "speed rad/s", "A", "B by Eq. D-10 N m s")
    return Table("Speed against torque (Fig. D-21)", columns, rows)


def speed_torque_line(readings: Readings) -> tuple[float, float]:
    """Slope in rad/s per N m and speed without load of the line through the lifts."""
    torque, _, speed = np.array(readings.lift_speed).T
    slope, begin = np.polyfit(torque, speed, 1)
    return float(slope), float(begin)


def _speed_torque_answer(readings: Readings, found: Mapping[str, Constant]) -> Answer:
    Ki, Kb, R, B = (found[name].value for name in ("Ki", "Kb", "Ra", "B"))
    slope, begin = speed_torque_line(readings)
    friction = [(Ki * amps - torque) / speed for torque, amps, speed in readings.lift_speed]
    return Answer(
        "How does the speed fall with the load (Fig. D-21), and what friction do the lifts show (Eq. D-10)?",
        f"w = {slope:.2f} T + {begin:.3f} rad/s; the constants give -1/(B + Ki Kb/Ra) = {-1.0 / (B + Ki * Kb / R):.2f} "
        f"rad/s per N m. B by Eq. D-10 is {float(np.mean(friction)):.5f} N m s on average; with dry friction it grows "
        "as the shaft gets slower",
    )


def gear_table(found: Mapping[str, Constant]) -> Table:
    """The constants at the motor's own shaft, behind the gears of table D-1 and without what they lose."""
    at_motor = {"Ki": 1.0 / GEAR_RATIO, "Kb": 1.0 / GEAR_RATIO, "B": GEAR_RATIO**-2, "J": GEAR_RATIO**-2}
    rows: list[list[Cell]] = [
        [name, UNITS[name], found[name].value, factor * found[name].value]
        for name, factor in at_motor.items() if name in found
    ]  # fmt: skip
    stages = ", ".join(f"{'/'.join(str(t) for t in teeth)} 1:{ratio}" for teeth, ratio in GEAR_STAGES)
    return Table(
        f"Gear train 1:{GEAR_RATIO} (table D-1: {stages})", ("constant", "unit", "output shaft", "motor's shaft"), rows
    )


def _curves(readings: Readings, found: Mapping[str, Constant]) -> dict[str, object]:
    """The speed-torque line and friction by power, for programs."""
    Ki = found["Ki"].value
    told: dict[str, object] = {
        "friction_by_power": [
            {"power_pct": 100.0 * r.voltage_V / readings.supply_V, "B_Nms": Ki * r.current_A / r.speed_rad_s}
            for r in readings.no_load if r.current_A is not None
        ]
    }  # fmt: skip
    if len(readings.lift_speed) > 1:
        slope, begin = speed_torque_line(readings)
        told |= {"speed_torque_slope_rad_s_per_Nm": slope, "speed_torque_no_load_rad_s": begin}
    return told


def _run_down_answer(readings: Readings, found: Mapping[str, Constant]) -> Answer:
    time_s, from_rad_s = readings.run_down[0]
    B, J = found["B"].value, found["J"].value
    Tc = max(found["Tc"].value, 0.0) if "Tc" in found else 0.0
    begin = from_rad_s or max(abs(r.speed_rad_s) for r in readings.no_load)
    alone = f"; without dry friction it would be J / B = {J / B:.3f} s" if J / max(B, 1e-12) < 1e3 else ""
    return Answer(
        "Run-down: do the constants agree with the time to 37 % of the speed, input off?",
        f"measured {time_s:.3f} s; with viscous and dry friction {predicted_run_down(max(B, 0.0), Tc, J, begin):.3f} s "
        f"from {begin:.2f} rad/s{alone}",
    )


def _check_constants(found: Mapping[str, Constant]) -> Answer:
    Ki, Kb = found["Ki"], found["Kb"]
    told = f"Ki = {Ki.value:.4f} N m/A, Kb = {Kb.value:.4f} V s/rad, ratio {Ki.value / Kb.value:.3f}"
    apart = Ki.low is not None and Ki.high is not None and Kb.low is not None and Kb.high is not None and (
        Ki.high < Kb.low or Kb.high < Ki.low
    )  # fmt: skip
    meaning = (
        "their intervals are apart: gears lose torque, so at the output shaft Ki is below Kb. One mean hides that"
        if apart and Ki.value < Kb.value else
        "their intervals are apart" if apart else "no difference can be seen, as for an ideal motor"
    )  # fmt: skip
    return Answer("Are torque and back-emf constants equal?", f"{told}: {meaning}")


def _draw_curves(readings: Readings, found: Mapping[str, Constant]) -> Figure:
    """Figs. D-21 to D-23: speed against torque, friction against power, the run-down."""
    from fiohost.report.panels import Curve, Panel, plot_panels

    Ki, B = found["Ki"].value, max(found["B"].value, 0.0)
    panels = []
    if len(readings.lift_speed) > 1:
        torque, _, speed = np.array(readings.lift_speed).T
        slope, begin = speed_torque_line(readings)
        ends = np.array([0.0, float(torque.max())])
        line = Curve(ends, begin + slope * ends, f"slope {slope:.3g} rad/s per N m", 0, "model")
        panels.append(Panel([Curve(torque, speed, "readings", -2, "points"), line], "speed (rad/s)",
                            "torque of the mass (N m)", "Speed against torque (Fig. D-21)"))  # fmt: skip
    rows = [(100.0 * abs(r.voltage_V) / readings.supply_V, Ki * r.current_A / r.speed_rad_s)
            for r in readings.no_load if r.current_A is not None]  # fmt: skip
    power, friction = np.array(sorted(rows)).T
    panels.append(
        Panel(
            [
                Curve(power, friction, "Ki i / w", -2, "points"),
                Curve([0.0, 100.0], [B, B], f"B = {B:.3g} N m s", 0, "model"),
            ],
            "friction as viscous (N m s)",
            "power (%)",
            "Friction against power (Fig. D-22)",
            y_limits=(0.0, 1.2 * float(friction.max())),
        )
    )
    if readings.run_down and "J" in found:
        panels.append(_run_down_panel(readings, found))
    return plot_panels(panels, f"Curves of the motor, {readings.source}", columns=1, panel_height=2.6)


def _run_down_panel(readings: Readings, found: Mapping[str, Constant]) -> Panel:
    """The run-down (Fig. D-23): measured where a bench showed it, and as the constants say."""
    from fiohost.report.panels import Curve, Panel

    time_s, from_rad_s = readings.run_down[0]
    begin = from_rad_s or max(abs(r.speed_rad_s) for r in readings.no_load)
    J, B = found["J"].value, max(found["B"].value, 1e-12)
    Tc = max(found["Tc"].value, 0.0) if "Tc" in found else 0.0
    seconds, speeds = (np.array(values) for values in readings.run_down_curve)
    end = float(seconds[-1]) if seconds.size else 4.0 * time_s
    grid = np.linspace(0.0, end, 400)
    falls = np.maximum((begin + Tc / B) * np.exp(-B / J * grid) - Tc / B, 0.0)
    curves = [Curve(seconds, speeds, "measured", -2, "plain")] if seconds.size else []
    curves += [Curve(grid, falls, "by the constants", 0, "model"),
               Curve([time_s], [np.exp(-1.0) * begin], f"37 % after {time_s:.3g} s", 1, "points")]  # fmt: skip
    return Panel(curves, "speed (rad/s)", "time since the input is off (s)", "Run-down (Fig. D-23)")


def _draw(readings: Readings, found: Mapping[str, Constant], lines: Lines) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    stall, lift = np.array(readings.stall), np.array(readings.lift)
    volt, speed, current = _columns(readings)
    R, Ki, Kb = (found[name].value for name in ("Ra", "Ki", "Kb"))

    def ends(x: np.ndarray) -> np.ndarray:
        return np.array([min(0.0, float(x.min())), max(0.0, float(x.max()))])

    i, t, w = ends(stall[:, 1]), ends(lift[:, 0]), ends(speed)
    lifted = [
        Curve(lift[:, 0], lift[:, 1], "readings", -2, "points"),
        Curve(t, lines.lift.intercept + lines.lift.slope * t, f"slope {lines.lift.slope:.3g} A per N m", 0, "model"),
    ]
    if readings.lift_stalled:
        held = np.array(readings.lift_stalled)
        lifted.append(Curve(held[:, 0], held[:, 1], "stalled, left out", 1, "crosses"))
    emf = [Curve(speed, volt, "V", -2, "points"), Curve(speed, volt - R * current, "V - Ra i", 0, "crosses"),
           Curve(w, Kb * w, f"Kb = {Kb:.4f} V s/rad", 0, "model")]  # fmt: skip
    friction = [Curve(speed, Ki * current, "Ki i", -2, "points")]
    if lines.speed_current is not None:
        line = Ki * (lines.speed_current.intercept + lines.speed_current.slope * w)
        friction.append(Curve(w, line, f"Tc + B w, B = {found['B'].value:.3g} N m s", 0, "model"))
    panels = [
        Panel([Curve(stall[:, 1], stall[:, 0], "readings", -2, "points"),
               Curve(i, R * i, f"Ra = {R:.3f} ohm", 0, "model")], "armature voltage (V)", "stall current (A)", "Stall"),
        Panel(lifted, "current (A)", "torque of the mass (N m)", "Lifting"),
        Panel(emf, "voltage (V)", "speed (rad/s)", "No load: back-emf"),
        Panel(friction, "torque of friction (N m)", "speed (rad/s)", "No load: friction",
              y_limits=(0.0, 1.3 * Ki * float(np.max(np.abs(current))))),
    ]  # fmt: skip
    return plot_panels(panels, f"Characterisation, {readings.source}", columns=1, panel_height=2.6)
