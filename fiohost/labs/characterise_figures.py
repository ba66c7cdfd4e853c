"""Figures of a motor's constants: the lines they stand on, and the text's curves."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from fiohost.labs.readings import Readings
from fiohost.labs.solve_constants import Constant, Lines, columns_of, speed_torque_line

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fiohost.report.panels import Panel


def draw_curves(readings: Readings, found: Mapping[str, Constant]) -> Figure:
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
    rows = [(abs(r.power(readings.supply_V)), Ki * r.current_A / r.speed_rad_s)
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


def draw(readings: Readings, found: Mapping[str, Constant], lines: Lines) -> Figure:
    """The four lines: stall, lifting, and without load back-emf and friction."""
    from fiohost.report.panels import Curve, Panel, plot_panels

    stall, lift = np.array(readings.stall), np.array(readings.lift)
    volt, speed, current = columns_of(readings)
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
