"""Speed control: proportional gains, an added gear head, a disturbance, and the motor seen through its own loop."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from fiohost.control.metrics import StepFigures, step_figures
from fiohost.errors import DataError
from fiohost.labs.open_loop_step import fit_step, inertia_from
from fiohost.labs.play import Run, Torque
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.labs.session import SATURATION, Gains, Session, speed

if TYPE_CHECKING:
    from matplotlib.figure import Figure

DURATION_S = 1.5
GEAR_RATIO = 24.0
GEAR_LOAD_KGM2 = 0.5  # behind the added gear head: ours, the text gives none
PI_PER_P = 10.0  # Ki over Kp, 1/s: a little below the motor's corner

Trio = tuple[Run, Run, Run]


def figures_of(run: Run, ref: float) -> StepFigures:
    return step_figures(run.time_s, run.speed_rad_s, 0.0, ref)


def speed_control(
    session: Session,
    gains: Sequence[float] = (0.1, 0.5, 1.0),
    refs: Sequence[float] = (12.0, -10.0, 15.0),
    torque: Torque | None = None,
    gear_load_kgm2: float = GEAR_LOAD_KGM2,
    animate: bool = False,
) -> LabResult:
    """Steps 11 to 15: ideal model, model at the bench's ticks, and target for each gain and reference."""
    q = session.constants
    runs: dict[tuple[float, float], Trio] = {
        (kp, ref): session.three(f"speed_kp{kp:g}_ref{ref:g}".replace(".", "p").replace("-", "minus"),
                                 speed(Gains(kp), ref), DURATION_S)
        for kp in gains for ref in refs
    }  # fmt: skip
    if animate:
        session.animate_motor("speed_control", runs[gains[-1], refs[0]][2])
    rows: list[list[Cell]] = []
    for (kp, ref), trio in runs.items():
        share = 100.0 * kp * q.speed_per_volt / (1.0 + kp * q.speed_per_volt)
        for run in trio:
            found = figures_of(run, ref)
            rows.append([kp, ref, run.name, found.final, 100.0 * found.final / ref, share, found.overshoot_pct,
                         found.rise_s, float(np.max(np.abs(run.volts)))])  # fmt: skip
    columns = ("Kp", "ref rad/s", "who", "final rad/s", "of ref %", "formula %", "overshoot %", "rise s", "peak V")
    tables = [Table("Proportional speed control (Kp in V per rad/s)", columns, rows, (0, 1, 2))]
    first = refs[0]
    finals = {kp: [figures_of(run, first).final for run in runs[kp, first]] for kp in gains}
    gear_answer, gear_table = _gear(session, gains, first, gear_load_kgm2)
    limit_table = _limits(session, gains[-1], refs[-1])
    answers = [_step_11(runs, refs), gear_answer, _step_13(finals, first), _step_14(session, gains, runs, first)]
    answers.append(_step_15(runs))
    tables += [gear_table, limit_table]
    pressed: list[tuple[str, Trio]] = []
    if torque is not None:
        middle = gains[len(gains) // 2]
        answer, table, pressed = _pressed(session, middle, first, torque)
        answers.append(answer)
        tables.append(table)
    return LabResult(
        name="speed-control",
        title="Speed control with a proportional controller",
        target=session.target,
        tables=tuple(tables),
        answers=tuple(answers),
        notes=tuple(session.notes),
        values={
            "kp_V_s_per_rad": list(gains),
            "ref_rad_s": list(refs),
            "target_final_rad_s": [[figures_of(runs[kp, ref][2], ref).final for ref in refs] for kp in gains],
            "model_final_rad_s": [[figures_of(runs[kp, ref][1], ref).final for ref in refs] for kp in gains],
        },
        figures={"speed_control": lambda: _draw(session, gains, refs, runs, pressed)},
        files=dict(session.logs),
    )


def _step_11(runs: dict[tuple[float, float], Trio], refs: Sequence[float]) -> Answer:
    told = []
    for (kp, ref), trio in runs.items():
        found = figures_of(trio[0], ref)
        told.append(f"Kp {kp:g}, {ref:g} rad/s: {found.final:.2f} rad/s, rise {1e3 * found.rise_s:.0f} ms")
    return Answer(f"Step 11. Steps of {', '.join(f'{r:g}' for r in refs)} rad/s on the ideal model", "; ".join(told))


def _gear(session: Session, gains: Sequence[float], ref: float, load: float) -> tuple[Answer, Table]:
    """Step 12: a load behind the gear head counts at the shaft with the square of the ratio."""
    q = session.constants
    geared = q.with_inertia(q.J_kgm2 + load / GEAR_RATIO**2)
    rows: list[list[Cell]] = []
    for kp in gains:
        for name, constants in (("motor", q), ("with gear", geared)):
            law = speed(Gains(kp), ref)
            found = figures_of(session.ideal(law, DURATION_S, session.limits, constants), ref)
            rows.append([kp, name, constants.J_kgm2, constants.tau_m_s, found.final, found.final / GEAR_RATIO
                         if constants is geared else None, found.rise_s])  # fmt: skip
    a, b = rows[-2], rows[-1]
    answer = Answer(
        f"Step 12. A gear head of 1:{GEAR_RATIO:g} with {load:g} kg m2 behind it (a load of ours, the text gives none)",
        f"J at the motor's shaft becomes J + J_load / {GEAR_RATIO:g}^2 = {geared.J_kgm2:.5f} kg m2 instead of "
        f"{q.J_kgm2:.5f}; at Kp {gains[-1]:g} the rise takes {1e3 * float(b[6] or 0):.0f} ms instead of "
        f"{1e3 * float(a[6] or 0):.0f}, the final speed stays {b[4]:.2f} rad/s, {b[5]:.3f} rad/s behind the gear",
    )
    columns = ("Kp", "who", "J kg m2", "tau_m s", "final rad/s", "behind gear rad/s", "rise s")
    return answer, Table(f"Gear head of 1:{GEAR_RATIO:g}, ideal model, {ref:g} rad/s", columns, rows, (0, 1))


def _step_13(finals: dict[float, list[float]], ref: float) -> Answer:
    told = "; ".join(
        f"Kp {kp:g}: model {f[1]:.2f}, target {f[2]:.2f} rad/s (error {100.0 * (1.0 - f[2] / ref):.1f} %)"
        for kp, f in finals.items()
    )
    return Answer(
        f"Step 13. The final speed by gain, {ref:g} rad/s asked for",
        f"{told}. By formula the final speed is Kp K / (1 + Kp K) of the reference: it never gets there without an "
        "integral",
    )


def _step_14(session: Session, gains: Sequence[float], runs: dict[tuple[float, float], Trio], ref: float) -> Answer:
    """Inertia from the closed loop: its lag is tau_m / (1 + Kp K), and its winding lag the same as before."""
    q, kp = session.constants, gains[0]
    told = []
    for run in runs[kp, ref]:
        try:
            fit = fit_step(run, ref, q.winding_s)
        except DataError as exc:  # a small gain may not get the shaft off its friction
            told.append(f"{run.name}: {exc}")
            continue
        share = fit.steady_rad_s / ref
        tau_m = fit.tau_s / (1.0 - share)
        B = q.Kt_Nm_per_A / q.R_ohm * (kp * (ref / fit.steady_rad_s - 1.0) - q.Ke_Vs_per_rad)
        told.append(
            f"{run.name}: loop's lag {1e3 * fit.tau_s:.1f} ms, times 1 + Kp K = {1.0 / (1.0 - share):.3f} gives "
            f"tau_m = {tau_m:.4f} s, B = {B:.5f} N m s, J = {inertia_from(q, tau_m, B):.5f} kg m2"
        )
    return Answer(f"Step 14. Inertia and friction from the closed loop, Kp {kp:g}", "; ".join(told) + (
        f" (put into the model: B = {q.B_Nms:.5f}, J = {q.J_kgm2:.5f}). What the bench's "
        "ticks and delay do to the loop is read as less inertia; the open loop of step 5 has none of it"
    ))  # fmt: skip


def _step_15(runs: dict[tuple[float, float], Trio]) -> Answer:
    told, worst = [], 0.0
    for (kp, ref), (_, model, target) in runs.items():
        a, b = figures_of(model, ref).final, figures_of(target, ref).final
        worst = max(worst, abs(100.0 * (b - a) / ref))
        told.append(f"Kp {kp:g}, {ref:g} rad/s: {b:.2f} (model {a:.2f})")
    text = f"{'; '.join(told)}. Largest difference {worst:.2f} % of the reference"
    return Answer("Step 15. The same on the target: final speed in rad/s", text)


def _limits(session: Session, kp: float, ref: float) -> Table:
    rows: list[list[Cell]] = []
    for name in ("none", "voltage", "current", "both"):
        run = session.ideal(speed(Gains(kp), ref), DURATION_S, SATURATION[name])
        found = figures_of(run, ref)
        current = run.current_A if run.current_A is not None else np.zeros(1)
        rows.append([name, found.final, found.rise_s, found.overshoot_pct, float(np.max(np.abs(run.volts))),
                     float(np.max(np.abs(current)))])  # fmt: skip
    columns = ("limits", "final rad/s", "rise s", "overshoot %", "peak V", "peak A")
    return Table(f"Limits of 4.5 V and 1 A, ideal model, Kp {kp:g}, {ref:g} rad/s", columns, rows)


def _pressed(
    session: Session, kp: float, ref: float, torque: Torque
) -> tuple[Answer, Table, list[tuple[str, Trio]]]:  # fmt: skip
    """A disturbance under P and under PI."""
    q = session.constants
    duration = torque.at_s + DURATION_S
    both = [(str(g), g) for g in (Gains(kp), Gains(kp, PI_PER_P * kp))]
    trios = [
        (name, session.three(f"speed_disturbed_{'pi' if g.ki else 'p'}", speed(g, ref), duration, torque))
        for name, g in both
    ]
    rows: list[list[Cell]] = []
    for name, trio in trios:
        for run in trio:
            before = run.speed_rad_s[(run.time_s < torque.at_s) & (run.time_s > 0.8 * torque.at_s)].mean()
            after = run.speed_rad_s[run.time_s > run.time_s[-1] - 0.2 * DURATION_S].mean()
            rows.append([name, run.name, float(before), float(after), float(after - before), float(ref - after)])
    expected = torque.torque_Nm / q.damping_Nms / (1.0 + kp * q.speed_per_volt)
    answer = Answer(
        f"Disturbance of {torque.torque_Nm:g} N m on the speed loop",
        ("" if session.presses else "nobody pressed on the target: ")
        + f"under {both[0][0]} the target's speed changes by {rows[2][4]:.2f} rad/s (model {rows[1][4]:.2f}, formula "
        f"{expected:.2f}), under {both[1][0]} by {rows[5][4]:.2f}: the integral leaves an error of "
        f"{rows[5][5]:.2f} rad/s",
    )
    columns = ("controller", "who", "before rad/s", "after rad/s", "change rad/s", "error rad/s")
    return answer, Table("Disturbance under speed control", columns, rows, (0, 1)), trios


def _draw(
    session: Session, gains: Sequence[float], refs: Sequence[float], runs: dict[tuple[float, float], Trio],
    pressed: list[tuple[str, Trio]],
) -> Figure:  # fmt: skip
    from fiohost.report.panels import Curve, Panel, plot_panels

    panels = []
    for ref in refs:
        curves = [Curve([0.0, 1.0], [ref, ref], "reference", -1, "reference")]
        curves += [
            Curve(run.time_s, run.speed_rad_s, f"Kp {kp:g}, {run.name}", case, run.name)
            for case, kp in enumerate(gains) for run in runs[kp, ref]
        ]  # fmt: skip
        panels.append(Panel(curves, "speed (rad/s)", title=f"Step of {ref:g} rad/s", x_limits=(0.0, 1.0)))
    if pressed:
        curves = [Curve(run.time_s, run.speed_rad_s, f"{name}, {run.name}", case, run.name)
                  for case, (name, trio) in enumerate(pressed) for run in trio]  # fmt: skip
        panels.append(Panel(curves, "speed (rad/s)", title="Disturbance torque"))
    return plot_panels(panels, f"Speed control, {session.target} and model")
