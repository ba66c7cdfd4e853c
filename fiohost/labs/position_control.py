"""Position control: proportional gains, disturbance and integral, inertia, saturation, a PI design, and Eq. 7-53."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from fiohost.control.metrics import step_figures
from fiohost.labs.constants import MotorConstants
from fiohost.labs.pi_design import Designed, design_pi, figures_of, play_design
from fiohost.labs.play import NO_LIMITS, Run, Torque
from fiohost.labs.printed import position_rows
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.labs.session import SATURATION, Gains, MakeLaw, Session, position

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from fiohost.report.panels import Panel

DURATION_S = 2.0
DISTURBED_S = 4.0  # after the torque comes
BAND = 0.05
INERTIAS = (1.0, 2.0, 4.0)
RESTS, LONGEST_S = 0.002, 64.0  # a loop has settled within this share of its step; it is followed no longer
Trio = tuple[Run, Run, Run]


@dataclass(frozen=True)
class PositionPlan:
    """What is done: gains in V/rad, V/(rad s) and V s/rad; steps in degrees."""

    step_deg: float = 160.0
    gains: Sequence[float] = (1.5, 2.0, 5.0)
    integral_with: float = 2.0
    integrals: Sequence[float] = (1.0, 3.0, 6.0)
    pid: Gains = Gains(3.0, 6.0, 0.1)  # noqa: RUF009
    torque: Torque | None = Torque(-0.1, 2.0)  # noqa: RUF009
    overshoot_pct: float = 30.0
    rise_s: float = 0.1
    animate: bool = False


def second_order(q: MotorConstants, kp: float) -> tuple[float, float]:
    """Damping and natural frequency by the text's Eq. 7-53, sensor gain 1."""
    omega_n = math.sqrt(kp * q.Kt_Nm_per_A / (q.R_ohm * q.J_kgm2))
    return q.damping_Nms / q.J_kgm2 / (2.0 * omega_n), omega_n


def predicted_overshoot(zeta: float) -> float:
    return 100.0 * math.exp(-math.pi * zeta / math.sqrt(1.0 - zeta**2)) if zeta < 1.0 else 0.0


def position_control(session: Session, plan: PositionPlan = PositionPlan()) -> LabResult:
    """Steps 16 to 25, each with its own table."""
    q, to = session.constants, plan.step_deg
    runs = {
        kp: session.three(f"position_kp{kp:g}".replace(".", "p"), position(Gains(kp), to), DURATION_S)
        for kp in plan.gains
    }
    if plan.animate:
        session.animate_motor("position_control", runs[plan.gains[-1]][2], to)
    tables, answers = [_proportional(session, runs, to)], [_step_16(runs, to)]
    pressed: list[tuple[Gains, Trio]] = []
    if plan.torque is not None:
        pressed = _press(session, plan, plan.torque)
        tables.append(_pressed_table(pressed, to, plan.torque))
        left = {
            kp: _pushed(session.ideal(position(Gains(kp), to), plan.torque.at_s + DISTURBED_S, session.limits,
                                      torque=plan.torque), to, plan.torque)[2]
            for kp in plan.gains
        }  # fmt: skip
        answers += _steps_17_18(session, pressed, to, plan.torque, left)
    inertia = _inertia(session, plan)
    saturation = _saturation(session, max(plan.gains), to)
    designed = play_design(session, design_pi(q, plan.overshoot_pct, plan.rise_s, session.limits), to)
    valid, valid_table = _eq_7_53(session, plan.gains, runs, to)
    tables += [inertia[1], saturation, designed.table(), valid_table]
    answers += [
        inertia[0],
        _step_20(saturation, max(plan.gains)),
        designed.step_21(),
        valid,
    ]
    answers += [
        _step_23(runs, to),
        _step_24(runs, max(plan.gains), to),
        designed.step_25(),
    ]
    return LabResult(
        name="position-control",
        title=f"Position control, steps of {to:g} deg",
        target=session.target,
        tables=tuple(tables),
        answers=tuple(answers),
        notes=tuple(session.notes),
        values=_values(plan, runs, pressed, designed, to),
        figures={
            "position_control": lambda: _draw(session, plan, runs, pressed),
            **({"position_control_pi": lambda: _draw_design(session, designed)} if designed.runs else {}),
        },
        files=dict(session.logs),
    )


# ---- proportional gains ------------------------------------------------------------------------------------------


def _proportional(session: Session, runs: dict[float, Trio], to: float) -> Table:
    rows: list[list[Cell]] = []
    for kp, trio in runs.items():
        for run in trio:
            f = figures_of(run, to)
            rows.append([kp, run.name, f.overshoot_pct, f.rise_s, f.settling_5_s, f.steady_state_error,
                         float(np.max(np.abs(run.volts)))])  # fmt: skip
        rows += [
            [kp, text.who, text.overshoot_pct, text.rise_s, text.settling_5_s, None, None]
            for text in position_rows(session.constants, session.limits.volts, to, kp)
        ]
    columns = ("Kp V/rad", "who", "overshoot %", "rise s", "settling 5 % s", "error deg", "peak V")
    return Table(f"Proportional position control, {to:g} deg", columns, rows, given=(0, 1))


def _step_16(runs: dict[float, Trio], to: float) -> Answer:
    told = "; ".join(f"Kp {kp:g}: {figures_of(trio[0], to).steady_state_error:.3f} deg" for kp, trio in runs.items())
    return Answer(
        f"Step 16. Steady-state error of the ideal model after a step of {to:g} deg",
        f"{told}. The motor integrates voltage to angle, so without a load no error is left",
    )


def _step_23(runs: dict[float, Trio], to: float) -> Answer:
    told = "; ".join(
        f"Kp {kp:g}: error {b.steady_state_error:.2f} deg, overshoot {b.overshoot_pct:.1f} % "
        f"(model {a.overshoot_pct:.1f}), rise {b.rise_s:.3f} s (model {a.rise_s:.3f})"
        for kp, a, b in ((kp, figures_of(t[1], to), figures_of(t[2], to)) for kp, t in runs.items())
    )
    return Answer("Step 23. The same on the target", told)


# ---- disturbance, integral, derivative ---------------------------------------------------------------------------


def _press(session: Session, plan: PositionPlan, torque: Torque) -> list[tuple[Gains, Trio]]:
    kinds = [Gains(plan.integral_with), *(Gains(plan.integral_with, ki) for ki in plan.integrals), plan.pid]
    duration = torque.at_s + DISTURBED_S
    return [
        (g, session.three(f"position_disturbed_{i}", position(g, plan.step_deg), duration, torque))
        for i, g in enumerate(kinds)
    ]


def _pushed(run: Run, to: float, torque: Torque) -> tuple[float, float, float]:
    """Error just before the torque, largest deviation after it, and error at the end, in degrees."""
    before = (run.time_s < torque.at_s) & (run.time_s > 0.8 * torque.at_s)
    after = run.time_s >= torque.at_s
    tail = run.time_s > run.time_s[-1] - 0.1 * DISTURBED_S
    rest = float(run.angle_deg[before].mean()) if before.any() else 0.0
    away = run.angle_deg[after] - rest
    return to - rest, float(away[np.argmax(np.abs(away))]), to - float(run.angle_deg[tail].mean())


def _pressed_table(pressed: list[tuple[Gains, Trio]], to: float, torque: Torque) -> Table:
    rows: list[list[Cell]] = []
    for gains, trio in pressed:
        for run in trio:
            keep = run.time_s < torque.at_s if torque.at_s > 0.5 else run.time_s >= 0.0
            f = step_figures(run.time_s[keep], run.angle_deg[keep], 0.0, to)
            rows.append([str(gains), run.name, f.overshoot_pct, f.settling_5_s, *_pushed(run, to, torque)])
    columns = ("controller", "who", "overshoot %", "settling 5 % s", "error before deg", "pushed by deg",
               "error at end deg")  # fmt: skip
    return Table(f"Disturbance of {torque.torque_Nm:g} N m at {torque.at_s:g} s", columns, rows, given=(0, 1))


def _steps_17_18(
    session: Session, pressed: list[tuple[Gains, Trio]], to: float, torque: Torque, left: dict[float, float]
) -> list[Answer]:
    q, alone = session.constants, pressed[0]
    ends = [_pushed(run, to, torque)[2] for run in alone[1]]
    expected = -math.degrees(torque.torque_Nm * q.R_ohm / (q.Kt_Nm_per_A * alone[0].kp))
    told = "; ".join(
        f"{g}: target {_pushed(t[2], to, torque)[2]:.2f} deg left, pushed by {_pushed(t[2], to, torque)[1]:.1f}, "
        f"overshoot {_overshoot(t[2], to, torque):.1f} %"
        for g, t in pressed[1:]
    )
    return [
        Answer(
            f"Step 17. A disturbance torque of {torque.torque_Nm:g} N m",
            f"with {alone[0]} V/rad an error of {ends[0]:.1f} deg stays on the model and {ends[2]:.1f} on the target"
            f"{'' if session.presses else ', where nobody pressed'}; "
            f"TL Ra / (Ki Kp) = {expected:.1f} deg. By gain, on the model: "
            + ", ".join(f"Kp {kp:g}: {error:.1f} deg" for kp, error in left.items()),
        ),
        Answer(
            "Step 18. Integral gains, and a derivative beside them",
            f"{told}. The integral takes the error away; more of it does so sooner and overshoots more",
        ),
    ]


def _overshoot(run: Run, to: float, torque: Torque) -> float:
    keep = run.time_s < max(torque.at_s, 0.5)
    return step_figures(run.time_s[keep], run.angle_deg[keep], 0.0, to).overshoot_pct


# ---- inertia and saturation --------------------------------------------------------------------------------------


def _inertia(session: Session, plan: PositionPlan) -> tuple[Answer, Table]:
    q, to = session.constants, plan.step_deg
    gains = Gains(plan.integral_with, plan.integrals[len(plan.integrals) // 2])
    found, rows = [], []
    for factor in INERTIAS:
        run, rests = _until_it_rests(session, position(gains, to), q.with_inertia(factor * q.J_kgm2), to)
        f = figures_of(run, to)
        found.append((f, to - float(run.angle_deg[-1]), rests))
        settled = (f.settling_5_s, found[-1][1]) if rests else (None, None)
        rows.append([factor, factor * q.J_kgm2, f.overshoot_pct, f.rise_s, *settled, float(run.time_s[-1])])
    (a, a_error, _), (b, b_error, _) = found[0], found[-1]
    told = (
        f"{INERTIAS[-1]:g} times the inertia: overshoot {b.overshoot_pct:.1f} % instead of {a.overshoot_pct:.1f}, rise "
        f"{b.rise_s:.3f} s instead of {a.rise_s:.3f}"
    )
    if all(rests for *_, rests in found):
        told += (
            f", settling {b.settling_5_s:.2f} s instead of {a.settling_5_s:.2f}; the error left is {abs(b_error):.2f} "
            f"deg instead of {abs(a_error):.2f}: inertia changes the way, not the end, as long as the loop is stable"
        )
    else:
        told += (
            f". Followed for {LONGEST_S:g} s it does not settle: with a PI the inertia decides whether a loop is stable"
        )
    answer = Answer(f"Step 19. More inertia under PI ({gains})", told)
    columns = ("times J", "J kg m2", "overshoot %", "rise s", "settling 5 % s", "error at end deg", "followed s")
    return answer, Table(f"Inertia under PI, ideal model, {gains}", columns, rows, given=(0, 1))


def _until_it_rests(session: Session, law: MakeLaw, q: MotorConstants, to: float) -> tuple[Run, bool]:
    """The ideal model, followed twice as long each time until it rests within RESTS of the step."""
    duration = 4.0 * DURATION_S
    while True:
        run = session.ideal(law, duration, session.limits, q)
        tail = run.angle_deg[run.time_s > 0.75 * duration]
        rests = bool(np.max(np.abs(tail - to)) < RESTS * abs(to))
        if rests or duration >= LONGEST_S:
            return run, rests
        duration *= 2.0


def _saturation(session: Session, kp: float, to: float) -> Table:
    rows: list[list[Cell]] = []
    for name in ("none", "voltage", "current", "both"):
        run = session.ideal(position(Gains(kp), to), DURATION_S, SATURATION[name])
        f = figures_of(run, to)
        current = np.zeros(1) if run.current_A is None else run.current_A
        rows.append([name, f.overshoot_pct, f.rise_s, f.settling_5_s, float(np.max(np.abs(run.volts))),
                     float(np.max(np.abs(current))), float(np.max(np.abs(run.speed_rad_s)))])  # fmt: skip
    columns = ("limits", "overshoot %", "rise s", "settling 5 % s", "peak V", "peak A", "fastest rad/s")
    return Table(f"Limits of 4.5 V and 1 A, ideal model, Kp {kp:g}, {to:g} deg", columns, rows)


def _step_20(table: Table, kp: float) -> Answer:
    told = "; ".join(
        f"{row[0]}: overshoot {row[1]:.1f} %, rise {row[2]:.3f} s, up to {row[4]:.1f} V and {row[5]:.2f} A"
        for row in table.rows
    )
    return Answer(f"Step 20. Voltage and current saturation at Kp {kp:g}", told)


def _step_24(runs: dict[float, Trio], kp: float, to: float) -> Answer:
    _, model, target = runs[kp]
    a, b = figures_of(model, to), figures_of(target, to)
    at_limit = 100.0 * float(np.mean(np.abs(target.volts) >= 0.999 * np.max(np.abs(target.volts))))
    amperes = "" if target.current_A is None else f" and {float(np.max(np.abs(target.current_A))):.2f} A"
    return Answer(
        f"Step 24. Saturation on the target at Kp {kp:g}",
        f"asked for {math.radians(to) * kp:.1f} V, given at most {float(np.max(np.abs(target.volts))):.2f} V{amperes} "
        f"({at_limit:.0f} % of the run at that voltage); overshoot {b.overshoot_pct:.1f} % (model with the same limits "
        f"{a.overshoot_pct:.1f}), rise {b.rise_s:.3f} s (model {a.rise_s:.3f})",
    )


# ---- Eq. 7-53 ----------------------------------------------------------------------------------------------------


def _eq_7_53(session: Session, gains: Sequence[float], runs: dict[float, Trio], to: float) -> tuple[Answer, Table]:
    q = session.constants
    rows: list[list[Cell]] = []
    for kp in gains:
        zeta, omega_n = second_order(q, kp)
        free = figures_of(session.ideal(position(Gains(kp), to), DURATION_S, NO_LIMITS), to)
        limited, target = (figures_of(runs[kp][i], to) for i in (0, 2))
        rows.append([kp, zeta, omega_n, predicted_overshoot(zeta), free.overshoot_pct, limited.overshoot_pct,
                     target.overshoot_pct])  # fmt: skip
    told = "; ".join(
        f"Kp {r[0]:g}: {r[3]:.1f} % predicted, {r[4]:.1f} % with inductance and no limits, {r[5]:.1f} % with limits, "
        f"{r[6]:.1f} % on the target"
        for r in rows
    )
    answer = Answer(
        "Step 22. How far Eq. 7-53 holds",
        f"overshoot: {told}. It holds while nothing saturates; the winding's lag adds a little, limits change the rest",
    )
    columns = ("Kp V/rad", "zeta", "omega_n rad/s", "Eq. 7-53 %", "no limits %", "limits %", "target %")
    return answer, Table("Overshoot by Eq. 7-53", columns, rows)


# ---- for programs and eyes ---------------------------------------------------------------------------------------


def _values(
    plan: PositionPlan, runs: dict[float, Trio], pressed: list[tuple[Gains, Trio]], designed: Designed, to: float,
) -> dict[str, Any]:  # fmt: skip
    def named(run: Run, size: float) -> dict[str, float]:
        f = figures_of(run, size)
        return {"overshoot_pct": f.overshoot_pct, "rise_s": f.rise_s, "settling_5_s": f.settling_5_s,
                "steady_state_error_deg": f.steady_state_error}  # fmt: skip

    return {
        "step_deg": to,
        "proportional": [
            {"kp_V_per_rad": kp, **{r.name: named(r, to) for r in trio}} for kp, trio in runs.items()
        ],
        "disturbed": [
            {"kp": g.kp, "ki": g.ki, "kd": g.kd,
             **{f"{r.name}_error_at_end_deg": _pushed(r, to, plan.torque)[2] for r in trio}}
            for g, trio in pressed if plan.torque is not None
        ],
        "pi": designed.values(named),
    }  # fmt: skip


def _draw(session: Session, plan: PositionPlan, runs: dict[float, Trio], pressed: list[tuple[Gains, Trio]]) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    to = plan.step_deg
    asked = Curve([0.0, DURATION_S], [to, to], "reference", -1, "reference")
    angle = [Curve(r.time_s, r.angle_deg, f"Kp {kp:g}, {r.name}", i, r.name)
             for i, (kp, trio) in enumerate(runs.items()) for r in trio]  # fmt: skip
    volt = [Curve(r.time_s, r.volts, f"Kp {kp:g}, {r.name}", i, r.name)
            for i, (kp, trio) in enumerate(runs.items()) for r in trio]  # fmt: skip
    panels: list[Panel] = [
        Panel([asked, *angle], "angle (deg)", title=f"Step of {to:g} deg", x_limits=(0.0, 1.5)),
        Panel(volt, "armature voltage (V)", title="Voltage", x_limits=(0.0, 1.0)),
    ]
    if pressed:
        end = float(pressed[0][1][0].time_s[-1])
        curves = [Curve([0.0, end], [to, to], "reference", -1, "reference")]
        curves += [Curve(r.time_s, r.angle_deg, f"{g}, {r.name}", i, r.name)
                   for i, (g, trio) in enumerate(pressed) for r in trio[1:]]  # fmt: skip
        panels.append(Panel(curves, "angle (deg)", title="Disturbance torque: P, PI and PID"))
    return plot_panels(panels, f"Position control, {session.target} and model")


def _draw_design(session: Session, designed: Designed) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    sizes = sorted({size for _, size, _ in designed.runs})
    panels = []
    for size in sizes:
        curves = [Curve([0.0, 1.5], [size, size], "reference", -1, "reference")]
        curves += [
            Curve(r.time_s, r.angle_deg, f"{r.name}, no limits" if case == "no limits" else r.name,
                  1 if case == "no limits" else 0, r.name)
            for case, s, r in designed.runs if s == size
        ]  # fmt: skip
        panels.append(Panel(curves, "angle (deg)", title=f"PI design, step of {size:.1f} deg", x_limits=(0.0, 1.5)))
    return plot_panels(panels, f"PI design, {session.target} and model")
