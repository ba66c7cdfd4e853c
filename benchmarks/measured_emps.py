"""EMPS, a motor and ball screw in closed loop at 1 kHz: fitted on the first half of the record, judged on the second.

The folder holds ``train.csv`` of the public data named in ``configs/maps/emps.toml``. The published model and its
figures are those of A. Janot, M. Gautier, M. Brunot, "Data Set and Reference Models of EMPS", 2019 Workshop on
Nonlinear System Identification Benchmarks.
"""

from __future__ import annotations

import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from measured_page import common, halves, save, table
from scipy.signal import butter, sosfiltfilt

from fiohost.circle.evidence import diagnose, read_logs
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.estimation.fit import Fit, fit, fit_from_scratch
from fiohost.estimation.record import Record, record_from_log
from fiohost.judging.metrics import judge
from fiohost.motor.model import Model
from fiohost.report import words
from fiohost.report.diagnosis import series_of
from fiohost.report.plots import plot_curve, plot_series
from fiohost.report.series import CurvePlot

MAP = "emps"
# Records and models of a linear axis are in millimetres, a diagnosis as told in metres.
MM = 1e3
# Of the record: 35.15065 N a volt, and 100 % are taken as 10 V.
NEWTON_PER_PCT = 35.15065 * 0.1
DECLARED = "linear+coulomb_friction"
# The structure of the published symmetric model: its offset of the force is a constant load.
PUBLISHED = Model.parse("linear+coulomb_friction+constant_load")
PUBLISHED_SI = {"mass": 95.1089, "viscous": 203.5034, "dry": 20.3935, "offset": -3.1648}
# Positions are filtered so before they are differentiated twice, and both forces before they are compared.
CUTOFF_HZ, ORDER, EDGE_S = 60.0, 4, 0.1
FORCE_TERMS = {"coulomb_friction", "constant_load", "asymmetric_coulomb_friction", "direction_dependent_gain"}


def published() -> Model:
    """The published parameters in percent of full scale: F = M a + Fv v + Fc sgn v + offset."""
    si = PUBLISHED_SI
    return PUBLISHED.with_values(
        {
            "linear.gain_deg_s_per_pct": MM * NEWTON_PER_PCT / si["viscous"],
            "linear.tau_s": si["mass"] / si["viscous"],
            "coulomb_friction.level_pct": si["dry"] / NEWTON_PER_PCT,
            "constant_load.level_pct": si["offset"] / NEWTON_PER_PCT,
        }
    )


def in_si(model: Model) -> dict[str, float]:
    """Mass in kg, viscous friction in N s/m, dry friction and offset in N of a model of the published structure."""
    viscous = MM * NEWTON_PER_PCT / model.number("linear.gain_deg_s_per_pct")
    return {
        "mass": viscous * model.number("linear.tau_s"),
        "viscous": viscous,
        "dry": NEWTON_PER_PCT * model.number("coulomb_friction.level_pct"),
        "offset": NEWTON_PER_PCT * model.number("constant_load.level_pct"),
    }


def smooth(values: np.ndarray, sample_time_s: float) -> np.ndarray:
    """Zero-phase low pass of a series (n)."""
    return np.asarray(sosfiltfilt(butter(ORDER, CUTOFF_HZ, fs=1.0 / sample_time_s, output="sos"), values))


def forces(record: Record, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Command and the command that the model asks for to move as measured, both in N (n) and filtered alike."""
    step = record.sample_time_s
    speed = np.gradient(smooth(record.y, step), step)
    gain, lag = model.number("linear.gain_deg_s_per_pct"), model.number("linear.tau_s")
    asked = (lag * np.gradient(speed, step) + speed) / gain
    values = {key: value for key, value in model.values.items() if not isinstance(value, str)}
    forward = values.get("asymmetric_coulomb_friction.forward_pct", values.get("coulomb_friction.level_pct", 0.0))
    reverse = values.get("asymmetric_coulomb_friction.reverse_pct", values.get("coulomb_friction.level_pct", 0.0))
    asked += np.where(speed > 0, forward, -reverse) + values.get("constant_load.level_pct", 0.0)
    asked = np.where(asked < 0, asked / values.get("direction_dependent_gain.ratio", 1.0), asked)
    given = record.excitation.duties_pct[1:]
    return NEWTON_PER_PCT * smooth(given, step), NEWTON_PER_PCT * smooth(asked, step)


def force_error_pct(record: Record, model: Model) -> float | None:
    """Norm of the difference of the two forces in percent of the command's; None for effects without such a law."""
    if not set(model.effects) <= FORCE_TERMS:
        return None
    edge = round(EDGE_S / record.sample_time_s)
    given, asked = (force[edge:-edge] for force in forces(record, model))
    return 100.0 * float(np.linalg.norm(given - asked) / np.linalg.norm(given))


def regressed(record: Record) -> Model:
    """The published structure by linear least squares on the force, filtered as for the force error."""
    step, edge = record.sample_time_s, round(EDGE_S / record.sample_time_s)
    speed = np.gradient(smooth(record.y, step), step)
    columns = (np.gradient(speed, step), speed, np.sign(speed), np.ones_like(speed))
    regressor = np.column_stack([smooth(column, step) for column in columns])[edge:-edge]
    given = smooth(record.excitation.duties_pct[1:], step)[edge:-edge]
    inertia, viscous, dry, offset = (float(value) for value in np.linalg.lstsq(regressor, given)[0])
    return PUBLISHED.with_values(
        {
            "linear.gain_deg_s_per_pct": 1.0 / viscous,
            "linear.tau_s": inertia / viscous,
            "coulomb_friction.level_pct": dry,
            "constant_load.level_pct": offset,
        }
    )


def fitted(model: Model, records: Sequence[Record], windows: bool = False) -> Fit:
    near = fit_from_scratch(model, records)
    return fit(near.model, records, windows=True) if windows else near


def judged_row(label: str, record: Record, model: Model) -> list[str]:
    errors = judge(record, model).errors
    force = force_error_pct(record, model)
    return [
        label,
        f"{errors.free_run_rms:.2f}",
        f"{errors.window_rms:.3f}",
        words.DASH if force is None else f"{force:.1f}",
    ]


def published_table(whole: Record, models: Mapping[str, tuple[Model, float | None]]) -> str:
    """Models of the published structure on the whole record; with each the error of the fit itself, in mm."""
    rows = []
    for label, (model, own) in models.items():
        si = in_si(model)
        errors = judge(whole, model).errors
        rows.append(
            [
                label,
                *(f"{si[key]:.2f}" for key in ("mass", "viscous", "dry", "offset")),
                words.DASH if own is None else f"{own:.2f}",
                f"{errors.free_run_rms:.2f}",
                f"{errors.window_rms:.3f}",
                f"{force_error_pct(whole, model):.2f}",
            ]
        )
    head = ["parameters", "mass (kg)", "viscous (N s/m)", "dry (N)", "offset (N)", "start fitted too (mm)"]
    return table([*head, "free run (mm)", "1 s windows (mm)", "force (%)"], rows)


def pictures(found: Diagnosis, held: Record, models: Mapping[str, Model]) -> None:
    (shown,) = [s for s in series_of(found) if s.role == "holdout"]
    save("emps_run", plot_series(shown))
    times = held.excitation.times_s
    lines = {label: judge(held, model).free_residual for label, model in models.items()}
    thin = slice(None, None, 10)
    save(
        "emps_free",
        plot_curve(
            CurvePlot(
                title="Free run of the held-out half: measured minus simulated",
                x_label="time (s)",
                y_label="error (mm)",
                x=times[thin],
                lines={label: line[thin] for label, line in lines.items()},
            )
        ),
    )
    part = (times >= 4.0) & (times < 8.0)
    given, asked = forces(held, models["as published, fitted here"])
    save(
        "emps_force",
        plot_curve(
            CurvePlot(
                title="Force of the command and force that the model asks for",
                x_label="time (s)",
                y_label="force (N)",
                x=times[part],
                lines={"command": given[part], "model": asked[part], "difference": (given - asked)[part]},
            )
        ),
    )


def section(folder: Path) -> dict[str, str]:
    """Diagnoses the record, draws the pictures and gives the words of the section."""
    with tempfile.TemporaryDirectory() as scratch:
        first, second = halves(folder / "train.csv", Path(scratch))
        found = diagnose([first], [second], DECLARED, table_map=MAP, say=print)
    (train,), (held,) = found.train, found.holdout
    whole = record_from_log(read_logs([folder / "train.csv"], MAP)[0], "train.csv")
    told = to_json(found)
    half, half_windows = fitted(PUBLISHED, [train]).model, fitted(PUBLISHED, [train], windows=True).model
    full, full_windows = fitted(PUBLISHED, [whole]), fitted(PUBLISHED, [whole], windows=True).model
    named = found.final.fit.model
    pictures(found, held, {"as named": named, "as published, fitted here": half})
    rows = [
        judged_row("declared", held, found.declared.fit.model),
        judged_row(f"named: {named.expression}", held, named),
        judged_row("structure as published, free runs fitted", held, half),
        judged_row("structure as published, 1 s windows fitted", held, half_windows),
        judged_row("published parameters (of the whole record)", held, published()),
    ]
    return {
        **common(told, MM),
        "judged": table(["model", "free run (mm)", "1 s windows (mm)", "force (%)"], rows),
        "published": published_table(
            whole,
            {
                "published": (published(), None),
                "force fitted": (regressed(whole), None),
                "free run fitted": (full.model, full.rms),
                "1 s windows fitted": (full_windows, None),
            },
        ),
        **numbers(told, whole, full),
        **drift(held, half),
    }


def numbers(told: Mapping[str, Any], whole: Record, full: Fit) -> dict[str, str]:
    held = {key: told[key]["holdout"] for key in ("after", "floor")}
    return {
        "whole_rms": f"{full.rms:.2f}",
        "published_force": f"{force_error_pct(whole, published()):.2f}",
        "windows_mm": f"{MM * held['after']['window_rms']:.2f}",
        "free_mm": f"{MM * held['after']['free_run_rms']:.2f}",
        "floor_nm": f"{1e9 * held['floor']['free_run_rms']:.0f}",
        "cutoff": f"{CUTOFF_HZ:g}",
    }


def drift(held: Record, model: Model) -> dict[str, str]:
    """Slope of the free run's error, and the constant force that makes an axis creep so."""
    slope = float(np.polyfit(held.excitation.times_s, judge(held, model).free_residual, 1)[0])
    return {"drift": f"{slope:.1f}", "drift_N": f"{abs(slope) / MM * in_si(model)['viscous']:.1f}"}
