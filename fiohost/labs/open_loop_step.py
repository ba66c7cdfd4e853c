"""Steps of voltage in open loop: steady speed, time constant, and what of the motor can be read off them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fiohost.errors import DataError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.play import NO_LIMITS, Run, Torque
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.labs.session import SATURATION, Session, volts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DURATION_S = 2.0
RISES_TO = 1.0 - np.exp(-1.0)
TAIL = 0.25


@dataclass(frozen=True)
class StepFit:
    """What one step says: steady speed, time to 63.2 % of it, and ``K`` (rad/s for a volt) and mechanical time constant
    of the response that fits best.
    """

    steady_rad_s: float
    time_63_s: float
    K: float
    tau_s: float


def fit_step(run: Run, volt: float, winding_s: float) -> StepFit:
    """Fit the angle of a motor K / (tau winding s^2 + tau s + 1) to a run from rest; when it begins is free too.

    ``winding_s`` is La / Ra: left out, the slower of the two lags would pass for tau. Raises DataError where the shaft
    does not turn.
    """
    from scipy.optimize import curve_fit

    angle = np.radians(run.angle_deg)
    last = run.time_s >= (1.0 - TAIL) * run.time_s[-1]
    steady = float(np.polyfit(run.time_s[last], angle[last], 1)[0])
    if abs(steady) < 1e-3:
        raise DataError(f"the shaft does not turn on {run.name} ({float(np.max(np.abs(run.volts))):.3g} V): give more")
    reached = np.flatnonzero(run.speed_rad_s / steady >= RISES_TO)
    time_63 = float(run.time_s[reached[0]]) if reached.size else float(run.time_s[-1])

    def response(t: np.ndarray, k: float, tau: float, begin: float) -> np.ndarray:
        since = np.maximum(t - begin, 0.0)
        root = np.sqrt(max(1.0 - 4.0 * winding_s / tau, 0.01))  # closer lags look like equal ones
        slow, fast = 0.5 * tau * (1.0 + root), 0.5 * tau * (1.0 - root)
        lagging = slow**2 * np.expm1(-since / slow)
        if fast > 0.0:
            lagging -= fast**2 * np.expm1(-since / fast)
        return np.asarray(k * volt * (since + lagging / (slow - fast)))

    start = (steady / volt, max(time_63, 0.005), 0.005)
    bounds = ([-np.inf, 1e-4, -0.02], [np.inf, 10.0, 0.5])
    try:
        found, _ = curve_fit(response, run.time_s, angle, start, bounds=bounds)
    except RuntimeError as exc:
        raise DataError(f"no response of a motor fits the step of {volt:g} V on {run.name}: {exc}") from exc
    return StepFit(steady, time_63, float(found[0]), float(found[1]))


def friction_from(q: MotorConstants, volt: float, speed_rad_s: float) -> float:
    """The text's Eq. D-8: all friction taken for viscous."""
    return (volt * q.Kt_Nm_per_A / speed_rad_s - q.Kt_Nm_per_A * q.Ke_Vs_per_rad) / q.R_ohm


def inertia_from(q: MotorConstants, tau_s: float, B_Nms: float) -> float:
    """The text's Eq. D-13."""
    return tau_s * (B_Nms + q.Kt_Nm_per_A * q.Ke_Vs_per_rad / q.R_ohm)


def open_loop_step(
    session: Session,
    levels_V: Sequence[float] = (1.0, 3.0, -2.0),
    torque: Torque | None = None,
    animate: bool = False,
) -> LabResult:
    """Steps 1 to 8: ideal model, model at the bench's ticks and target for each voltage."""
    q = session.constants
    trios = [session.three(f"step_{v:+g}V".replace("+", "plus_").replace("-", "minus_"), volts(v, DURATION_S),
                           DURATION_S) for v in levels_V]  # fmt: skip
    if animate:
        session.animate_motor("open_loop_step", trios[0][2])
    fits = [[fit_step(run, v, q.winding_s) for run in trio] for v, trio in zip(levels_V, trios, strict=True)]
    rows: list[list[float | str | None]] = []
    for v, trio, found in zip(levels_V, trios, fits, strict=True):
        for run, fit in zip(trio, found, strict=True):
            B = friction_from(q, v, fit.steady_rad_s)
            peak = None if run.current_A is None else float(np.max(np.abs(run.current_A)))
            rows.append([v, run.name, fit.steady_rad_s, q.speed_per_volt * v, fit.time_63_s, fit.tau_s, B,
                         inertia_from(q, fit.tau_s, B), peak])  # fmt: skip
    columns = ("V", "who", "steady rad/s", "Eq. 7-15 rad/s", "63.2 % at s", "fitted tau s", "B Eq. D-8 N m s",
               "J Eq. D-13 kg m2", "peak A")  # fmt: skip
    answers, tables, pressed = [_step_1(levels_V, fits, q)], [Table("Steps of voltage", columns, rows, (0, 1))], None
    found_2, table_2 = _friction_sweep(session)
    answers += [found_2, _half_speed(session)]
    tables.append(table_2)
    if torque is not None:
        answer, table, pressed = _pressed(session, levels_V[0], torque)
        answers.append(answer)
        tables.append(table)
    answers += _identified(q, levels_V, fits)
    tables.append(_saturation(session, max(levels_V, key=abs)))
    target_K = [f[2].K for f in fits]
    return LabResult(
        name="open-loop-step",
        title="Open-loop step: speed against time for steps of voltage",
        target=session.target,
        tables=tuple(tables),
        answers=tuple(answers),
        notes=tuple(session.notes),
        values={
            "levels_V": list(levels_V),
            "model_K_rad_s_V": q.speed_per_volt,
            "model_tau_s": q.tau_m_s,
            "target_K_rad_s_V": target_K,
            "target_tau_s": [f[2].tau_s for f in fits],
            "target_steady_rad_s": [f[2].steady_rad_s for f in fits],
        },
        figures={"open_loop_step": lambda: _draw(session, levels_V, trios, pressed)},
        files=dict(session.logs),
    )


def _step_1(levels_V: Sequence[float], fits: list[list[StepFit]], q: MotorConstants) -> Answer:
    said = "; ".join(
        f"{v:+g} V: {fit[0].steady_rad_s:.3f} rad/s against {q.speed_per_volt * v:.3f} by Eq. 7-15"
        for v, fit in zip(levels_V, fits, strict=True)
    )
    return Answer("Step 1. Steady speed of the model for each step of voltage", said)


def _friction_sweep(session: Session, volt: float = 2.0) -> tuple[Answer, Table]:
    """Step 2, without limits: friction moves both the speed and the lag."""
    rows: list[list[float]] = []
    for factor in (0.0, 0.5, 1.0, 2.0, 5.0, 10.0):
        q = replace(session.constants, B_Nms=factor * session.constants.B_Nms)
        fit = fit_step(session.ideal(volts(volt, DURATION_S), DURATION_S, NO_LIMITS, q), volt, q.winding_s)
        rows.append([factor, q.B_Nms, fit.steady_rad_s, fit.tau_s])
    low, high = rows[0], rows[-1]
    answer = Answer(
        "Step 2. What viscous friction does",
        f"at {volt:g} V the speed falls from {low[2]:.2f} rad/s without friction to {high[2]:.2f} at {high[0]:g} times "
        f"the motor's B, and the lag with it, from {1e3 * low[3]:.1f} to {1e3 * high[3]:.1f} ms: both are divided by "
        "Ki Kb + Ra B",
    )
    columns = ("times B", "B N m s", "rad/s", "tau s")
    return answer, Table(f"Friction, model without limits, {volt:g} V", columns, rows, given=(0, 1))


def _half_speed(session: Session, volt: float = 2.0) -> Answer:
    q = session.constants
    half = q.Kt_Nm_per_A * q.Ke_Vs_per_rad / q.R_ohm
    free, slow = (
        fit_step(session.ideal(volts(volt, DURATION_S), DURATION_S, NO_LIMITS, replace(q, B_Nms=B)), volt, q.winding_s)
        for B in (0.0, half)
    )
    return Answer(
        "Step 3. Viscous friction that halves the speed",
        f"B = Ki Kb / Ra = {half:.4f} N m s ({half / q.B_Nms if q.B_Nms else float('inf'):.1f} times the motor's own): "
        f"{free.steady_rad_s:.3f} rad/s without friction, {slow.steady_rad_s:.3f} with it",
    )


def _pressed(session: Session, volt: float, torque: Torque) -> tuple[Answer, Table, list[Run]]:
    """Step 4: the same step of voltage, with a torque that comes when the speed has settled."""
    q = session.constants
    runs = session.three("step_disturbed", volts(volt, 2 * DURATION_S), 2 * DURATION_S, torque)
    rows: list[list[float | str]] = []
    for run in runs:
        before = run.time_s <= torque.at_s
        after = run.time_s >= 0.5 * (torque.at_s + run.time_s[-1])
        first = before & (run.time_s >= 0.5 * torque.at_s)
        speeds = [float(np.polyfit(run.time_s[m], np.radians(run.angle_deg[m]), 1)[0]) for m in (first, after)]
        rows.append([run.name, speeds[0], speeds[1], speeds[1] - speeds[0]])
    expected = torque.torque_Nm / q.damping_Nms
    answer = Answer(
        f"Step 4. A disturbance torque of {torque.torque_Nm:g} N m at {volt:g} V",
        f"the speed changes by {rows[0][3]:.2f} rad/s on the model and {rows[2][3]:.2f} on the target"
        f"{'' if session.presses else ', where nobody pressed'}; "
        f"TL / (B + Ki Kb / Ra) = {expected:.2f}",
    )
    columns = ("who", "before rad/s", "after rad/s", "change rad/s")
    return answer, Table("Disturbance in open loop", columns, rows), [*runs]


def _identified(q: MotorConstants, levels_V: Sequence[float], fits: list[list[StepFit]]) -> list[Answer]:
    """Steps 5 to 8: what model and target say of K, tau, B and J."""
    first = fits[0][0]
    B = friction_from(q, levels_V[0], first.steady_rad_s)
    K = [f[2].K for f in fits]
    tau = [f[2].tau_s for f in fits]
    told = "; ".join(
        f"{v:+g} V: {f[2].steady_rad_s:.3f} rad/s, model {f[1].steady_rad_s:.3f} "
        f"({100.0 * (f[2].steady_rad_s / f[1].steady_rad_s - 1.0):+.1f} %)"
        for v, f in zip(levels_V, fits, strict=True)
    )
    mean_K, mean_tau = float(np.mean(K)), float(np.mean(tau))
    B_target = (q.Kt_Nm_per_A / mean_K - q.Kt_Nm_per_A * q.Ke_Vs_per_rad) / q.R_ohm
    spread = 100.0 * (max(K) - min(K)) / abs(mean_K)
    return [
        Answer(
            "Step 5. Inertia and viscous friction from the speed response",
            f"from the model's step of {levels_V[0]:+g} V, by Eqs. D-8 and D-13: B = {B:.5f} N m s (put in: "
            f"{q.B_Nms:.5f}), J = {inertia_from(q, first.tau_s, B):.5f} kg m2 (put in: {q.J_kgm2:.5f}), from "
            f"tau = {first.tau_s:.4f} s",
        ),
        Answer(
            "Step 6. Other parameters from the time response",
            f"a step gives two numbers, K = {first.K:.3f} rad/s/V and tau = {first.tau_s:.4f} s; R, Ki, Kb, B and J "
            "are five. Known R, Ki and Kb leave B and J; otherwise a meter is needed (fiohost lab characterise)",
        ),
        Answer("Step 7. The same steps on the target", told),
        Answer(
            "Step 8. The target's model",
            f"K = {mean_K:.3f} rad/s/V (by voltage {', '.join(f'{k:.3f}' for k in K)}; spread {spread:.1f} %), "
            f"tau = {mean_tau:.4f} s ({', '.join(f'{t:.4f}' for t in tau)}); with the constants' R, Ki and Kb: "
            f"B = {B_target:.5f} N m s, J = {inertia_from(q, mean_tau, B_target):.5f} kg m2. "
            + _linear(levels_V, K, spread),
        ),
    ]


def _linear(levels_V: Sequence[float], K: list[float], spread_pct: float) -> str:
    """Whether one gain holds for all voltages, in words."""
    if spread_pct < 1.0:
        return "K is the same at all voltages: linear"
    if int(np.argmax(K)) == int(np.argmax(np.abs(levels_V))):
        return "K grows with the voltage, as it does where friction is dry: no linear model holds at all of them"
    return "K is not the same at all voltages: no linear model holds at all of them"


def _saturation(session: Session, volt: float) -> Table:
    """The largest step with each of the limits: speed is bounded by the voltage, the start by the current."""
    rows: list[list[float | str]] = []
    for name in ("none", "voltage", "current", "both"):
        run = session.ideal(volts(volt, DURATION_S), DURATION_S, SATURATION[name])
        fit = fit_step(run, volt, session.constants.winding_s)
        peak = float(np.max(np.abs(run.current_A))) if run.current_A is not None else float("nan")
        rows.append([name, fit.steady_rad_s, fit.time_63_s, peak])
    columns = ("limits", "steady rad/s", "63.2 % at s", "peak A")
    return Table(f"Limits of 4.5 V and 1 A, ideal model, step of {volt:+g} V", columns, rows)


def _draw(
    session: Session, levels_V: Sequence[float], trios: list[tuple[Run, Run, Run]], pressed: list[Run] | None
) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    curves = [
        Curve(run.time_s, run.speed_rad_s, f"{v:+g} V, {run.name}", case, run.name)
        for case, (v, trio) in enumerate(zip(levels_V, trios, strict=True))
        for run in trio
    ]
    panels = [Panel(curves, "speed (rad/s)", title="Steps of voltage", x_limits=(0.0, 1.0))]
    if all(run.current_A is not None for trio in trios for run in trio):
        panels.append(Panel([
            Curve(run.time_s, run.current_A, f"{v:+g} V, {run.name}", case, run.name)
            for case, (v, trio) in enumerate(zip(levels_V, trios, strict=True)) for run in trio
        ], "current (A)", title="Armature current", x_limits=(0.0, 1.0)))  # fmt: skip
    if pressed:
        panels.append(Panel([Curve(r.time_s, r.speed_rad_s, r.name, 0, r.name) for r in pressed], "speed (rad/s)",
                            title="Disturbance torque"))  # fmt: skip
    return plot_panels(panels, f"Open-loop step, {session.target} and model")
