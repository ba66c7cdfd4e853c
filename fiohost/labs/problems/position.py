"""Problems D-12 to D-17: the angle under P and PD control, with and without a load."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np

from fiohost.control.metrics import step_figures
from fiohost.labs.problems.answer import Numbers, angle_and_volts, motor_of, solved
from fiohost.labs.problems.servo import POSITION, Response, Servo
from fiohost.labs.result import Cell, LabResult, Table

GAINS = (0.1, 0.2, 0.5, 1.0, 2.0)
DERIVATIVE_GAINS = (0.0, 0.01, 0.02, 0.03, 0.05, 0.1)
SLOW_PARTS, LONGEST_S = 25.0, 1000.0  # time constants after which nothing is left to see
COLUMNS = ("overshoot (%)", "peak at (s)", "settled 5 % (s)", "rise (s)", "ITAE (rad s2)")


def servo(n: Numbers, kp: float, kd: float = 0.0, load_Nm: float = 0.0, of_error: bool = True) -> Servo:
    """The position loop of Fig. D-26 around the motor of D-1, the derivative as in the text's block (Fig. D-36)."""
    return Servo(
        motor_of(n), n["ref_rad"], POSITION, kp, kd=kd, amplifier=n["amplifier"], load_Nm=load_Nm,
        derivative_of_error=of_error,
    )  # fmt: skip


def settled_run(loop: Servo, seconds: float) -> Response:
    """The response over the time asked for, or until its slowest part is gone: its last value is where it rests."""
    motor, gain = loop.motor, loop.motor.Kt_Nm_per_A * loop.amplifier
    poles = np.roots([
        motor.L_H * motor.J_kgm2, motor.R_ohm * motor.J_kgm2 + motor.L_H * motor.B_Nms,
        motor.R_ohm * motor.damping_Nms + gain * loop.kd, gain * loop.kp,
    ])  # fmt: skip
    slowest = float(np.min(-poles.real))
    return loop.run(min(max(seconds, SLOW_PARTS / slowest), LONGEST_S) if slowest > 0.0 else seconds)


def d12(n: Numbers) -> LabResult:
    run = servo(n, n["kp"]).run(n["seconds"])
    f = step_figures(run.time_s, run.angle, 0.0, n["ref_rad"])
    peak = float(run.angle.max())
    answers = [
        (
            "(a) Steady position",
            f"{n['ref_rad']:.4g} rad: without load the loop rests only where the error is 0. At {n['seconds']:g} s "
            "it is at "
            f"{run.angle[-1]:.4g} rad",
        ),
        ("(b) Largest rotation", f"{peak:.4g} rad, {100.0 * (peak / n['ref_rad'] - 1.0):.3g} % over"),
        ("(c) When", f"{f.peak_s:.4g} s after the step"),
    ]
    values = {"steady_position_rad": n["ref_rad"], "largest_rotation_rad": peak, "peak_s": f.peak_s}
    about = "position under P control"
    return solved(
        12, about, answers, values, partial(angle_and_volts, {f"kp {n['kp']:g}": run}, n["ref_rad"]), notes=[_LOOP]
    )


def d13(n: Numbers) -> LabResult:
    run = servo(n, n["kp"]).run(n["seconds"])
    f = step_figures(run.time_s, run.angle, 0.0, n["ref_rad"])
    peak = float(run.angle.max())
    answers = [
        ("(a) When is the largest rotation?", f"{f.peak_s:.4g} s after the step"),
        ("(b) Largest rotation", f"{peak:.4g} rad, {100.0 * (peak / n['ref_rad'] - 1.0):.3g} % over"),
    ]
    values = {"largest_rotation_rad": peak, "peak_s": f.peak_s}
    pictures = partial(angle_and_volts, {f"kp {n['kp']:g}": run}, n["ref_rad"])
    return solved(13, "a larger gain", answers, values, pictures, notes=[_LOOP])


def d14(n: Numbers) -> LabResult:
    most = n["most_overshoot_pct"]
    runs = {f"kp {kp:g}": settled_run(servo(n, kp), n["seconds"]) for kp in GAINS}
    rows = _rows(runs, n)
    allowed = [row for row in rows if row[1] <= most]
    best = min(allowed, key=lambda row: row[-1])[0] if allowed else "none"
    fine = gain_with_overshoot(n)
    answers = [
        (
            "Which gain is best?",
            f"Of these {best}: the least time-weighted error (ITAE) of those that overshoot by {most:g} % at most. "
            + (f"Of all gains kp = {fine:.3g}, which overshoots by just that. " if fine else "")
            + "Smaller ones creep, larger ones swing.",
        )
    ]
    values = {"best": best, "kp_with_that_overshoot": fine, "itae_rad_s2": {row[0]: row[-1] for row in rows}}
    pictures = partial(angle_and_volts, _until(runs, n["seconds"]), n["ref_rad"])
    return solved(14, "position, five gains", answers, values, pictures, [_table(rows)], [_LOOP])


def d15(n: Numbers) -> LabResult:
    runs = _by_kd(n, 0.0)
    rows, on_angle = _rows(runs, n), _rows(_by_kd(n, 0.0, of_error=False), n)
    best, best_on_angle = (min(of, key=lambda row: row[-1])[0] for of in (rows, on_angle))
    optimum = best_kd(n)
    answers = [
        (
            "What does the derivative do, and which KD is good?",
            f"It damps: with kp {n['kp']:g} the overshoot falls from {rows[0][1]:.3g} % to {rows[-1][1]:.3g} % as kd "
            f"grows; beyond some kd the shaft only gets slower. Least time-weighted error (ITAE) of these: {best}, of "
            f"all kd = {optimum:.3g}. The steady error without load stays 0.",
        ),
        (
            "Does it matter what is differentiated?",
            f"The poles are the same. With that of the angle, which no step reaches, the least ITAE is that of "
            f"{best_on_angle} and every rise is slower: what the text's block gains is the blow of an endless voltage "
            "in the moment of the step, which no amplifier gives.",
        ),
    ]
    values = {
        "best": best, "best_kd_V_s_per_rad": optimum, "itae_rad_s2": {r[0]: r[-1] for r in rows},
        "overshoot_pct": {r[0]: r[1] for r in rows}, "on_angle_best": best_on_angle,
        "on_angle_itae_rad_s2": {r[0]: r[-1] for r in on_angle},
    }  # fmt: skip
    tables = [
        Table("By gain, derivative of the error (Fig. D-36)", ("gain", *COLUMNS), rows),
        Table("By gain, derivative of the angle", ("gain", *COLUMNS), on_angle),
    ]
    pictures = partial(angle_and_volts, _until(runs, 1.0), n["ref_rad"])
    return solved(15, "position under PD control", answers, values, pictures, tables, [_LOOP, _ON_ERROR])


def d16(n: Numbers) -> LabResult:
    return _loaded(16, n)


def d17(n: Numbers) -> LabResult:
    return _loaded(17, n)


def gain_with_overshoot(n: Numbers) -> float | None:
    """The gain between the smallest and the largest of D-14 that overshoots by as much as is allowed."""
    from scipy.optimize import brentq

    def over(log_kp: float) -> float:
        run = servo(n, float(np.exp(log_kp))).run(3.0)
        return 100.0 * (float(run.angle.max()) / n["ref_rad"] - 1.0) - n["most_overshoot_pct"]

    low, high = np.log(GAINS[0]), np.log(GAINS[-1])
    return float(np.exp(brentq(over, low, high, xtol=1e-3))) if over(low) < 0.0 < over(high) else None


def itae(run: Response, ref: float) -> float:
    """Integral of time times the error's size."""
    return float(np.trapezoid(run.time_s * np.abs(ref - run.angle), run.time_s))


def _loaded(number: int, n: Numbers) -> LabResult:
    """D-15 with a load from the beginning."""
    load, kp = n["load_Nm"], n["kp"]
    runs = _by_kd(n, load)
    motor = motor_of(n)
    expected = -load * motor.R_ohm / (motor.Kt_Nm_per_A * kp * n["amplifier"])
    ends = {name: float(run.angle[-1]) for name, run in runs.items()}
    errors = {name: n["ref_rad"] - end for name, end in ends.items()}
    shown: list[list[Cell]] = [[row[0], ends[row[0]], errors[row[0]], *row[3:-1]] for row in _rows(runs, n)]
    answers = [
        (
            "What does the load do, and what does KD do about it?",
            f"It leaves an error of T R/(Ki KP) = {expected:.4g} rad, whatever kd is: the shaft comes to rest at "
            f"{n['ref_rad'] - expected:.4g} rad instead of {n['ref_rad']:g}. The derivative shapes the way there only.",
        )
    ]
    if expected > n["ref_rad"]:
        text = "The load is stronger than the loop at standstill: the shaft is driven back behind where it began."
        answers.append(("Why does it turn backwards?", text))
    values: dict[str, Any] = {"expected_error_rad": expected, "error_rad_by_kd": errors}
    table = Table("By gain", ("gain", "at the end (rad)", "error (rad)", *COLUMNS[2:-1]), shown)
    note = "The text does not say when the load begins: taken from the beginning."
    pictures = partial(angle_and_volts, _until(runs, 1.5), n["ref_rad"])
    return solved(number, f"D-15 with a load of {load:g} N m", answers, values, pictures, [table], [note, _ON_ERROR])


def best_kd(n: Numbers) -> float:
    """The derivative gain of D-15 with the least ITAE."""
    from scipy.optimize import minimize_scalar

    def cost(kd: float) -> float:
        return itae(servo(n, n["kp"], kd).run(n["seconds"]), n["ref_rad"])

    return float(minimize_scalar(cost, bounds=(0.0, DERIVATIVE_GAINS[-1]), method="bounded", options={"xatol": 1e-4}).x)


def _by_kd(n: Numbers, load_Nm: float, of_error: bool = True) -> dict[str, Response]:
    return {
        f"kd {kd:g}": settled_run(servo(n, n["kp"], kd, load_Nm, of_error), n["seconds"]) for kd in DERIVATIVE_GAINS
    }


def _until(runs: Mapping[str, Response], seconds: float) -> dict[str, Response]:
    """The beginning of some runs, for a picture."""
    return {name: run.until(seconds) for name, run in runs.items()}


def _rows(runs: Mapping[str, Response], n: Numbers) -> list[list[Any]]:
    """Name and COLUMNS; the peak is given where there is one."""
    rows: list[list[Any]] = []
    for name, run in runs.items():
        f = step_figures(run.time_s, run.angle, 0.0, n["ref_rad"])
        over = round(f.overshoot_pct, 2)
        rows.append([name, over, f.peak_s if over else None, f.settling_5_s, f.rise_s, itae(run, n["ref_rad"])])
    return rows


def _table(rows: list[list[Any]]) -> Table:
    return Table("By gain", ("gain", *COLUMNS), rows)


_LOOP = (
    "The text names Fig. D-3, the window of a library; taken is the loop of Fig. D-26, without limits and with an "
    "amplifier of gain 1."
)
_ON_ERROR = (
    "The derivative is that of the error, as in the text's block (Fig. D-36): in the moment of the step it asks for an "
    "endless voltage, which the picture leaves out."
)
