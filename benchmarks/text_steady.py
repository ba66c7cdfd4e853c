"""The control lab appendix' readings at constant speed: current against torque (table D-5), and what it calls a viscous
friction that falls with power (Fig. D-22).
"""

from __future__ import annotations

import csv
import shutil
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from measured_page import save, table

from fiohost.circle.readings import diagnose_readings
from fiohost.discover.tables.worth import scatter_needed
from fiohost.labs.constants import TEXT, MotorConstants
from fiohost.labs.tables import judge, plot_rows
from fiohost.motor.model import Model
from fiohost.report import words

LIFTS = "table_d5_torque_current.csv"
RUN_V, RUN_SHARE = 2.0, 0.5  # the text calls 2.0 V 50 % of power
LOW_SHARE = 0.1  # the lowest power of Fig. D-22


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open(encoding="utf-8") as lines:
        return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def write_lifts(data: Path, folder: Path, motor: MotorConstants, fit: str = "") -> Path:
    """Table D-5 as a readings file, without its stalled row; ``fit`` names a constant to be fitted."""
    shutil.copy(data / LIFTS, folder)
    stall_A = motor.supply_V / motor.R_ohm
    lines = ['schema = "fiohost.readings/1"', 'kind = "steady"', f'table = "{LIFTS}"', "[only]", 'stall = "0"']
    lines += ["[duty]", f"value = {RUN_V}", 'unit = "V"', f"full_scale_V = {motor.supply_V}"]
    lines += ["[torque]", 'value = "torque_Nm"', "[motor]", f"stall_current_A = {stall_A!r}"]
    lines += [f"stall_torque_Nm = {stall_A * motor.Kt_Nm_per_A!r}"]
    lines += [f"viscous_share = {1.0 - motor.Ke_Vs_per_rad * motor.speed_per_volt!r}"]
    lines += [f'fit = ["{fit}"]'] if fit else []
    lines += ["[figures.current]", 'column = "current_A"', "quantum = 0.001"]
    path = folder / f"d5{fit and '_'}{fit}.toml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def fixed_model(motor: MotorConstants) -> Model:
    """The text's motor at constant speed: nothing to be fitted."""
    model = motor.model().without(["constant_load", "armature_inductance"])
    return Model(model.effects, model.values, frozenset(model.values))


def apparent_B(motor: MotorConstants, volts: float, dry_Nm: float, B: float = 0.0) -> float:
    """The viscous coefficient that a no-load speed seems to show (Eq. D-8) where friction is dry, or part of it is."""
    turning = motor.Kt_Nm_per_A * volts / motor.R_ohm - dry_Nm
    speed = turning / (B + motor.Kt_Nm_per_A * motor.Ke_Vs_per_rad / motor.R_ohm)
    return B + dry_Nm / speed


def damping_table(motor: MotorConstants, known: Mapping[str, float], no_load_A: float) -> tuple[str, dict[str, str]]:
    """Fig. D-22 at its ends, by explanation; the dry friction of the current without load is fitted to nothing."""
    low_V, dry_Nm = RUN_V * LOW_SHARE / RUN_SHARE, motor.Kt_Nm_per_A * no_load_A
    B_low, B_run = known["viscous_B_at_10pct_power_about_Nms"], known["viscous_B_from_speed_Nms"]

    def speed(volts: float, B: float) -> float:
        return motor.Kt_Nm_per_A * volts / (motor.Kt_Nm_per_A * motor.Ke_Vs_per_rad + motor.R_ohm * B)

    # both coefficients are B + dry / speed, at two speeds
    slow, fast = speed(low_V, B_low), speed(RUN_V, B_run)
    both_Nm = (B_low - B_run) / (1.0 / slow - 1.0 / fast)
    both_B = B_run - both_Nm / fast
    alone = [apparent_B(motor, volts, dry_Nm) for volts in (low_V, RUN_V)]
    mixed = [apparent_B(motor, volts, both_Nm, both_B) for volts in (low_V, RUN_V)]
    rows = {
        "read off Fig. D-22": [B_low, B_run],
        "before: constant viscous friction": [B_run, B_run],
        "dry friction alone, from the current without load": alone,
        "dry and viscous, fitted to both": mixed,
    }
    shown = [[label, *(f"{1e3 * value:.2f}" for value in values)] for label, values in rows.items()]
    head = ["friction", "at 10 % of power (0.001 N m s)", "at 50 % (0.001 N m s)"]
    return table(head, shown), {
        "dry_no_load": f"{dry_Nm:.4f}",
        "dry_both": f"{both_Nm:.4f}",
        "viscous_both": f"{1e3 * both_B:.2f}",
        "dry_pct": f"{motor.torque_pct(dry_Nm):.1f}",
    }


def steady_facts(data: Path, scratch: Path) -> dict[str, str]:
    """Judges table D-5 with the text's constants and with a torque constant of its own, and Fig. D-22."""
    motor = TEXT["no_load"]
    known = {row["name"]: float(row["value"]) for row in rows_of(data / "facts.csv")}
    lifts = [row for row in rows_of(data / LIFTS) if row["stall"] == "0"]
    (stalled,) = [row for row in rows_of(data / LIFTS) if row["stall"] != "0"]
    torque = np.array([float(row["torque_Nm"]) for row in lifts])
    current = np.array([float(row["current_A"]) for row in lifts])
    floor = 0.001 / np.sqrt(12.0)
    line = current[0] + known["torque_current_slope_A_per_Nm"] * torque
    rows = [["the text's straight line, 3.95 A/(N m)", *_errors(line - current, floor), "", ""]]
    for label, fit in (("the text's constants", ""), ("torque constant fitted", "stall_torque_Nm")):
        found = judge(diagnose_readings([write_lifts(data, scratch, motor, fit)], fixed_model(motor), say=print))
        search = found.diagnosis.found
        final = search.final
        named = ", ".join(words.effect_words(s.effect) for s in search.steps) or "nothing"
        left = [
            f"{1e3 * floor * search.declared.fit.rms:.1f}",
            words.number(search.declared.fit.rms, 3),
            f"{words.number(final.fit.rms, 3)} ({words.number(final.left_out_rms, 3)})",
            f"{named}; would pass with {1e3 * floor * scatter_needed(final.fit.rms, final.limit_rms):.1f} mA",
        ]
        rows.append([label, *left])
        if not fit:
            picture = plot_rows(found.diagnosis.to_json()["rows"], f"D-5, current of a lift: {named} found",
                                {"current": list(line)}, "the text's line")  # fmt: skip
            save("table_d5", picture)
    slope, offset = np.polyfit(torque, current, 1)
    fast = known["no_load_speed_at_2V_rad_s"] + known["speed_torque_slope_rad_s_per_Nm"] * torque
    coefficients = (motor.Kt_Nm_per_A * current - torque) / fast
    damping, more = damping_table(motor, known, float(current[0]))
    return {
        "d5": table(["current of a lift", "before (mA)", "(floors)", "after (left out)", "named"], rows),
        "d5_slope": f"{slope:.2f}",
        "d5_offset": f"{1e3 * offset:.0f}",
        "d5_B_mean": f"{1e3 * float(coefficients.mean()):.2f}",
        "d5_B_low": f"{1e3 * float(coefficients.min()):.2f}",
        "d5_B_high": f"{1e3 * float(coefficients.max()):.2f}",
        "d5_stall_A": f"{RUN_V / motor.R_ohm:.2f}",
        "d5_stall_seen_A": f"{float(stalled['current_A']):.3f}",
        "d5_speed_slope": f"{-motor.speed_per_volt * motor.R_ohm / motor.Kt_Nm_per_A:.1f}",
        "d22": damping,
        **more,
    }


def _errors(left: np.ndarray, floor: float) -> list[str]:
    rms = float(np.sqrt(np.mean(left**2)))
    return [f"{1e3 * rms:.1f}", words.number(rms / floor, 3)]
