"""The lab on a motor's constants: what the readings give beside the text's values: tables, answers, figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fiohost.labs.characterise_figures import draw, draw_curves
from fiohost.labs.constants import MotorConstants
from fiohost.labs.readings import Readings
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.labs.solve_constants import (
    UNITS,
    Constant,
    Lines,
    constants_of,
    is_there,
    predicted_run_down,
    solve,
    speed_torque_line,
)

# The text's values (tables D-4 to D-6 and section D-1-4) and its run-down, measured
TEXT = {"La": 0.0047, "Ra": 2.27, "Ki": 0.25, "Kb": 0.25, "B": 0.00131, "tau_m": 0.081, "J": 0.00233}
TEXT_FULL_V = 4.5
GEAR_STAGES = (((10, 30, 40), 4), ((9, 27), 3), ((10, 20), 2), ((10, 13, 20), 2))  # table D-1
GEAR_RATIO = 48


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
        Table(f"Constants at the output shaft, motor port {readings.port}", columns, rows, (0, 1, 6)),
        _powers(readings, found),
        *([_speed_torque(readings, found)] if len(readings.lift_speed) > 1 else []),
        gear_table(found),
    ]
    why = "; ".join(f"{name}: {text}" for name, text in _why(found, lines, readings).items())
    answers = [
        _winding_answer(found, readings),
        Answer("How was each constant found, and where would the text's way have led?", why),
    ]
    values = {name: {"value": c.value, "unit": c.unit, "ci95": [c.low, c.high], "readings": c.n, "text": TEXT.get(name)}
              for name, c in found.items()}  # fmt: skip
    if readings.run_down and "J" in found:
        answers.append(_run_down_answer(readings, found))
    answers.append(_check_constants(found))
    if len(readings.lift_speed) > 1:
        answers.append(_speed_torque_answer(readings, found))
    answers += _power_answer(readings, found)
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
        figures={"characterise": lambda: draw(readings, found, lines),
                 "characterise_curves": lambda: draw_curves(readings, found)},
    )  # fmt: skip


def viscous_only(readings: Readings, L_H: float | None = None) -> MotorConstants:
    """The constants of the readings as the text's form of model has them, without dry friction. Raises DataError."""
    return replace(constants_of(solve(readings)[0], readings, L_H), coulomb_Nm=0.0)


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
        there = "" if is_there(found["Tc"]) else " (none to be seen)"
        why["Tc"] = f"dry friction, the rest of Ki i at no speed{there}; the text has it in B"
    return why


def _winding_answer(found: Mapping[str, Constant], readings: Readings) -> Answer:
    told = f"Ra = {_interval(found['Ra'])} ohm, from {len(readings.stall)} stalls (Eq. D-2)"
    if "La" in found:
        told += f"; La = {1e3 * found['La'].value:.3g} mH, {_why_La(readings)}; La/Ra = "
        told += f"{1e3 * found['La'].value / found['Ra'].value:.2f} ms"
    return Answer("What are resistance and inductance of the winding?", told)


def _interval(c: Constant) -> str:
    return f"{c.value:.4g}" if c.low is None or c.high is None else f"{c.value:.4g} ({c.low:.4g} to {c.high:.4g})"


def _power_answer(readings: Readings, found: Mapping[str, Constant]) -> list[Answer]:
    """Fig. D-22 in words, where more than one power was read."""
    rows = sorted(
        (abs(r.power(readings.supply_V)), found["Ki"].value * r.current_A / r.speed_rad_s)
        for r in readings.no_load if r.current_A is not None
    )  # fmt: skip
    if len(rows) < 2:
        return []
    (low, first), (high, last) = rows[0], rows[-1]
    told = f"taken for viscous it is {first:.3g} N m s at {low:.0f} % and {last:.3g} at {high:.0f} %"
    if "Tc" in found and is_there(found["Tc"]):
        viscous = f"{found['B'].value:.3g} N m s are" if is_there(found["B"]) else "none is"
        told += f": {viscous} viscous, and {found['Tc'].value:.3g} N m of dry friction, which "
        told += "is the same at every speed, count for less as the shaft gets faster"
    return [Answer("What does the friction do as the power rises (Fig. D-22)?", told)]


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
        [r.power(readings.supply_V), r.voltage_V, r.speed_rad_s, r.current_A,
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
        f"Gear train 1:{GEAR_RATIO} (table D-1: {stages})",
        ("constant", "unit", "output shaft", "motor's shaft"),
        rows,
        (0, 1),
    )


def _curves(readings: Readings, found: Mapping[str, Constant]) -> dict[str, object]:
    """The speed-torque line and friction by power, for programs."""
    Ki = found["Ki"].value
    told: dict[str, object] = {
        "friction_by_power": [
            {"power_pct": r.power(readings.supply_V), "B_Nms": Ki * r.current_A / r.speed_rad_s}
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
