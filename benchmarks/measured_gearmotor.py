"""A 100:1 gear motor on an H-bridge in drive/brake PWM: speed logs of three days, fitted on one and judged on others.

The folder holds the tables of the public data named in ``configs/maps/brake_pwm_gearmotor.toml``.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from measured_page import begun, common, halves, save, table, with_interval

from fiohost.circle.evidence import diagnose, read_logs
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.intervals import estimates
from fiohost.estimation.record import Record, record_from_log
from fiohost.judging.metrics import Errors, judge
from fiohost.motor.model import Model
from fiohost.report.diagnosis import series_of
from fiohost.report.plots import plot_curve, plot_residual_bars, plot_series
from fiohost.report.series import CurvePlot

MAP, ANGLE_MAP = "brake_pwm_gearmotor", "brake_pwm_gearmotor_angle"
DAYS = ("08-11", "08-14", "08-17")
# What is fitted to every day alone, so that the days can be compared.
STRUCTURE = Model.parse("linear+coulomb_friction+transport_delay")
COLUMNS = (
    ("linear.gain_deg_s_per_pct", "gain (deg/s per %)", 1.0, 3),
    ("linear.tau_s", "lag (ms)", 1e3, 2),
    ("coulomb_friction.level_pct", "dry friction (%)", 1.0, 2),
    ("transport_delay.delay_s", "delay (ms)", 1e3, 2),
)
VOLT_PCT = 20.0
# Static speeds below this voltage are those of the start of motion.
CLEAR_V = 0.5


def name_of(kind: str, day: str) -> str:
    return f"{kind}_exp_2026-{day}.csv"


def record_of(path: Path, table_map: str = MAP) -> Record:
    return record_from_log(read_logs([path], table_map)[0], path.name)


def fitted_to(record: Record) -> Model:
    return fit_from_scratch(STRUCTURE, [record]).model


def day_table(folder: Path) -> str:
    """The same model fitted to every day's record, and to both halves of it."""
    rows = []
    with tempfile.TemporaryDirectory() as scratch:
        for day in DAYS:
            whole = folder / name_of("prbs_open", day)
            first, second = halves(whole, Path(scratch))
            for label, path in (("whole", whole), ("first half", first), ("second half", second)):
                found = fit_from_scratch(STRUCTURE, [record_of(path)])
                known = estimates(found)
                values = [with_interval(known[key], scale, digits) for key, _, scale, digits in COLUMNS]
                rows.append([f"{day}, {label}", *values, f"{found.rms:.2f}"])
    return table(["day", *(head for _, head, _, _ in COLUMNS), "error (deg/s)"], rows)


def change_table(models: Mapping[str, Model], records: Mapping[str, Record]) -> str:
    """The error on one day of a model of another, with nothing, one number and all numbers fitted anew."""
    rows = []
    choices = [("nothing", []), *((head.partition(" (")[0], [key]) for key, head, _, _ in COLUMNS)]
    choices += [("delay and dry friction", ["transport_delay.delay_s", "coulomb_friction.level_pct"])]
    pairs = [("08-11", "08-14"), ("08-14", "08-11"), ("08-14", "08-17"), ("08-17", "08-14")]
    for label, free in [*choices, ("all", list(STRUCTURE.free()))]:
        figures = []
        for fitted, judged in pairs:
            fixed = frozenset(models[fitted].values) - frozenset(free)
            model = fit(replace(models[fitted], fixed=fixed), [records[judged]]).model if free else models[fitted]
            figures.append(f"{judge(records[judged], model).errors.free_run_rms:.2f}")
        rows.append([label, *figures])
    return table(["fitted anew", *(f"{a} on {b}" for a, b in pairs)], rows)


def static_speeds(folder: Path, day: str) -> tuple[np.ndarray, np.ndarray]:
    """Voltages (n) and averaged steady speeds (n) of a table that no fit sees."""
    columns = np.genfromtxt(folder / f"static_gain_response_2026-{day}.csv", delimiter=",", names=True)
    return columns["u"], columns["y"]


def foretold(model: Model, volts: np.ndarray) -> np.ndarray:
    """Steady speed (n) of a linear motor with dry friction."""
    drive = np.maximum(VOLT_PCT * volts - model.number("coulomb_friction.level_pct"), 0.0)
    return np.asarray(model.number("linear.gain_deg_s_per_pct") * drive)


def static_off(folder: Path, models: Mapping[str, Model]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Measured minus foretold steady speed over the voltage, by day."""
    found = {}
    for day in ("08-11", "08-17"):
        volts, speeds = static_speeds(folder, day)
        found[day] = (volts, speeds - foretold(models[day], volts))
    return found


def pictures(one: Diagnosis, off: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> None:
    save("gearmotor_errors", plot_residual_bars(to_json(one)["logs"], "deg/s"))
    (shown,) = [s for s in series_of(one) if s.title == name_of("prbs_open", "08-17")]
    save("gearmotor_run", plot_series(begun(shown, 6.0, 20.0)))
    (volts, first), (others, second) = off.values()
    curve = CurvePlot(
        title="Steady speed: measured minus foretold by the day's dynamic record",
        x_label="command (V)",
        y_label="difference (deg/s)",
        x=volts,
        lines={},
        points={"08-11": (volts, first), "08-17": (others, second)},
    )
    save("gearmotor_static", plot_curve(curve))


def section(folder: Path) -> dict[str, str]:
    """Diagnoses two days, draws the pictures and gives the words of the section."""

    def one_way(day: str, *kinds: str) -> Diagnosis:
        fitted = [folder / name_of(kind, day) for kind in ("prbs_open", *kinds)]
        known = [name_of("prbs_open", d) for d in DAYS]
        known += [name_of("step_open", "08-11"), name_of("step_closed", "08-11")]
        judged = [folder / name for name in known if folder / name not in fitted]
        return diagnose(fitted, judged, "linear", table_map=MAP, say=print)

    old, new = one_way("08-11", "step_open"), one_way("08-14")
    records = {day: record_of(folder / name_of("prbs_open", day)) for day in DAYS}
    models = {day: fitted_to(record) for day, record in records.items()}
    off = static_off(folder, models)
    pictures(new, off)
    turned = record_of(folder / name_of("step_closed", "08-17"), ANGLE_MAP)
    left = judge(turned, models["08-17"]).errors
    return {
        **{f"old_{key}": text for key, text in common(to_json(old)).items()},
        **{f"new_{key}": text for key, text in common(to_json(new)).items()},
        "days": day_table(folder),
        "changes": change_table(models, records),
        "structure": STRUCTURE.expression,
        **static_facts(off),
        **angle_facts(turned, left),
        **closed_facts(folder, models["08-11"]),
    }


def static_facts(off: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, str]:
    found = {}
    for day, (volts, difference) in off.items():
        clear = difference[volts > CLEAR_V]
        key = day.replace("-", "")
        found[f"static_rms_{key}"] = f"{np.sqrt(np.mean(clear**2)):.1f}"
        found[f"static_worst_{key}"] = f"{np.abs(clear).max():.1f}"
    return found


def angle_facts(record: Record, errors: Errors) -> dict[str, str]:
    return {
        "angle_rms": f"{errors.free_run_rms:.2f}",
        "angle_windows": f"{errors.window_rms:.2f}",
        "angle_span": f"{np.ptp(record.y):.0f}",
    }


def closed_facts(folder: Path, model: Model) -> dict[str, str]:
    """How the closed-loop record of 08-11 begins, and what a model of that day leaves of it."""
    record = record_of(folder / name_of("step_closed", "08-11"))
    return {
        "closed_after": f"{judge(record, model).errors.free_run_rms:.1f}",
        "closed_first": f"{record.y[1]:.1f}",
        "closed_command": f"{record.excitation.duties_pct[1] / VOLT_PCT:g}",
    }
