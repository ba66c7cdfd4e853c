"""Fine-tuning by the position response (section D-1-6): inertia, friction or both, until the model follows the target.

The formulas of the second-order loop (Eqs. D-15 to D-29) say which way to go; how far, the distance between the two
responses says, at the bench's own ticks, delay, counts and limits.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from fiohost.errors import ConfigError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.pi_design import figures_of
from fiohost.labs.play import Run
from fiohost.labs.printed import position_rows
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.labs.session import Gains, Session, position
from fiohost.labs.transfer import motor_function
from fiohost.settings import nearest

if TYPE_CHECKING:
    from matplotlib.figure import Figure

RUN_S = 2.0
MUCH = 4.0  # times what counts leave: more than a finer tuning would take
TUNED = {"J": ("J_kgm2",), "B": ("B_Nms",), "both": ("J_kgm2", "B_Nms")}
FACTORS = (0.7, 0.8, 0.9, 1.1, 1.2)  # of what was measured, shown beside
RANGE = (0.3, 3.0)  # within which it is looked for


@dataclass(frozen=True)
class SecondOrder:
    """The position loop of Eq. D-15 and its figures by the text's formulas."""

    omega_n_rad_s: float
    zeta: float
    poles: str
    overshoot_pct: float
    peak_s: float | None
    rise_s: float
    settling_5_s: float


def second_order(q: MotorConstants, kp: float) -> SecondOrder:
    """Eqs. D-16 to D-29: frequency and damping, poles, overshoot, peak, rise (0.4167, 2.917) and settling (3.2)."""
    omega = math.sqrt(kp * q.Kt_Nm_per_A / (q.R_ohm * q.J_kgm2))  # D-17
    zeta = q.damping_Nms / q.J_kgm2 / (2.0 * omega)  # D-18
    modes = motor_function(q, "angle", winding=False).fed_back(kp).modes()  # D-19
    root = math.sqrt(1.0 - zeta**2) if zeta < 1.0 else 0.0
    return SecondOrder(
        omega, zeta, "; ".join(mode.pole for mode in modes),
        100.0 * math.exp(-math.pi * zeta / root) if root else 0.0,  # D-26
        math.pi / (omega * root) if root else None,  # D-27
        (1.0 - 0.4167 * zeta + 2.917 * zeta**2) / omega,  # D-28
        3.2 / (zeta * omega) if zeta < 0.69 else 4.5 * zeta / omega,  # D-29, and section 7-5 beyond its range
    )  # fmt: skip


def distance_deg(model: Run, target: Run) -> float:
    """Root mean square of what parts two responses, both from rest."""
    n = min(len(model.time_s), len(target.time_s))
    there = np.interp(target.time_s[:n], model.time_s, model.angle_deg)
    return float(np.sqrt(np.mean((target.angle_deg[:n] - there) ** 2)))


def fine_tuning(session: Session, kp: float = 3.0, step_deg: float = 160.0, tuned: str = "J") -> LabResult:
    """Run the target once, then look for the constants with which the model comes nearest. Raises FiohostError."""
    from scipy.optimize import minimize

    if tuned not in TUNED:
        raise ConfigError(f"unknown choice {tuned!r} of what is tuned; {nearest(tuned, TUNED)}")
    q, law = session.constants, position(Gains(kp), step_deg)
    target = session.on_target("fine_tuning", law, RUN_S)

    def model(factors: np.ndarray) -> Run:
        changed = {name: getattr(q, name) * float(f) for name, f in zip(TUNED[tuned], factors, strict=True)}
        return replace(session, constants=replace(q, **changed)).model(law, RUN_S)

    def cost(logs: np.ndarray) -> float:
        return distance_deg(model(np.exp(logs)), target)

    bounds = [tuple(np.log(RANGE))] * len(TUNED[tuned])
    begin = [(0.0,) * len(bounds), (-0.2,) * len(bounds), (0.2,) * len(bounds)]
    best = min(
        (minimize(cost, start, method="Nelder-Mead", bounds=bounds, options={"xatol": 1e-3, "fatol": 1e-3})
         for start in begin[: 1 if len(bounds) > 1 else 3]),
        key=lambda found: float(found.fun),
    )  # fmt: skip
    factors = np.exp(best.x)
    chosen = replace(
        q, **{name: getattr(q, name) * float(f) for name, f in zip(TUNED[tuned], factors, strict=True)},
        source=f"{q.source}, tuned by the position response of {session.target}",
    )  # fmt: skip
    tries = sorted({1.0, *FACTORS}) if tuned != "both" else [1.0]
    runs = {f"{factor:g} times": model(np.full(len(bounds), factor)) for factor in tries}
    runs["best"] = model(factors)
    sets = {f"{factor:g} times": {name: getattr(q, name) * factor for name in TUNED[tuned]} for factor in tries}
    sets["best"] = {name: getattr(chosen, name) for name in TUNED[tuned]}
    rows = [_row(name, replace(q, **sets[name]), kp, run, step_deg, target) for name, run in runs.items()]
    rows.append(["target", *[None] * 7, *_seen(target, step_deg), None])
    rows += [
        [text.who, *[None] * 7, text.overshoot_pct, text.rise_s, text.settling_5_s, None]
        for text in position_rows(q, session.limits.volts, step_deg, kp)
    ]
    formulas = second_order(chosen, kp)
    return LabResult(
        name="fine-tuning",
        title=f"Fine-tuning by the position response, Kp {kp:g}, {step_deg:g} deg",
        target=session.target,
        tables=(Table(f"The model with other {_letters(tuned)}", _COLUMNS, rows), _formulas(q, chosen, kp)),
        answers=_answers(q, chosen, kp, tuned, runs, target, session.way.quantum_deg / math.sqrt(12.0)),
        notes=tuple(session.notes),
        values={
            "tuned": tuned, "J_kgm2": chosen.J_kgm2, "B_Nms": chosen.B_Nms, "rms_before_deg": distance_deg(
                runs["1 times"], target), "rms_after_deg": float(best.fun), "omega_n_rad_s": formulas.omega_n_rad_s,
            "zeta": formulas.zeta, "constants": {k: getattr(chosen, k) for k in ("R_ohm", "L_H", "Kt_Nm_per_A",
                                                 "Ke_Vs_per_rad", "J_kgm2", "B_Nms", "coulomb_Nm", "supply_V")},
        },
        figures={"fine_tuning": lambda: _draw(session, runs, target, step_deg)},
        files=dict(session.logs),
    )  # fmt: skip


_COLUMNS = ("model", "J kg m2", "B N m s", "omega_n rad/s", "zeta", "poles", "Eq. D-26 %", "Eq. D-28 s", "overshoot %",
            "rise s", "settling 5 % s", "rms to target deg")  # fmt: skip


def _row(name: str, q: MotorConstants, kp: float, run: Run, step_deg: float, target: Run) -> list[Cell]:
    f = second_order(q, kp)
    return [name, q.J_kgm2, q.B_Nms, f.omega_n_rad_s, f.zeta, f.poles, f.overshoot_pct, f.rise_s,
            *_seen(run, step_deg), distance_deg(run, target)]  # fmt: skip


def _seen(run: Run, step_deg: float) -> tuple[float, float, float]:
    f = figures_of(run, step_deg)
    return f.overshoot_pct, f.rise_s, f.settling_5_s


def _formulas(before: MotorConstants, after: MotorConstants, kp: float) -> Table:
    a, b = second_order(before, kp), second_order(after, kp)
    rows: list[list[Cell]] = [
        ["natural frequency (rad/s)", "D-17", a.omega_n_rad_s, b.omega_n_rad_s],
        ["damping", "D-18", a.zeta, b.zeta],
        ["poles (1/s)", "D-19", a.poles, b.poles],
        ["overshoot (%)", "D-26", a.overshoot_pct, b.overshoot_pct],
        ["peak (s)", "D-27", a.peak_s, b.peak_s],
        ["rise (s)", "D-28", a.rise_s, b.rise_s],
        ["settling to 5 % (s)", "D-29", a.settling_5_s, b.settling_5_s],
    ]
    columns = ("figure", "Eq.", "before", "tuned")
    return Table("The second-order loop by the text's formulas", columns, rows, given=(0, 1))


def _letters(tuned: str) -> str:
    return "J and B" if tuned == "both" else tuned


def _answers(
    q: MotorConstants, chosen: MotorConstants, kp: float, tuned: str, runs: dict[str, Run], target: Run,
    counts_deg: float,
) -> tuple[Answer, ...]:  # fmt: skip
    a, b = second_order(q, kp), second_order(chosen, kp)
    before, after = distance_deg(runs["1 times"], target), distance_deg(runs["best"], target)
    names = {"J": f"J = {chosen.J_kgm2:.5f} kg m2 (measured: {q.J_kgm2:.5f})",
             "B": f"B = {chosen.B_Nms:.5f} N m s (measured: {q.B_Nms:.5f})"}  # fmt: skip
    found = names.get(tuned) or " and ".join(names.values())
    rest = (
        f". Counts would leave {counts_deg:.2f}: no {_letters(tuned)} does it. The model lacks something else, for "
        "which the tuned one stands in"
    ) if after > MUCH * counts_deg else ""  # fmt: skip
    way = "left" if b.zeta * b.omega_n_rad_s > a.zeta * a.omega_n_rad_s else "right"
    return (
        Answer(
            f"Which {_letters(tuned)} makes the model follow the target?",
            f"{found}: the responses then differ by {after:.2f} deg rms instead of {before:.2f}{rest}",
        ),
        Answer(
            "Where do the poles go?",
            f"from {a.poles} to {b.poles}, to the {way}: zeta {a.zeta:.3f} to {b.zeta:.3f}, omega_n "
            f"{a.omega_n_rad_s:.2f} to {b.omega_n_rad_s:.2f} rad/s; by the formulas the overshoot goes from "
            f"{a.overshoot_pct:.1f} to {b.overshoot_pct:.1f} %",
        ),
        Answer(
            "How far can the formulas be trusted here?",
            "they know no inductance, no limit of the voltage and no ticks: compare them with the model's own figures. "
            "Where the voltage is limited the response is set by the largest speed, and the rise by it alone",
        ),
    )


def _draw(session: Session, runs: dict[str, Run], target: Run, step_deg: float) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    shown = [name for name in ("1 times", "best") if name in runs]
    curves = [Curve([0.0, RUN_S], [step_deg, step_deg], "reference", -1, "reference"),
              Curve(target.time_s, target.angle_deg, "target", 0, "target")]  # fmt: skip
    apart = []
    for case, name in enumerate(shown, start=1):
        run = runs[name]
        label = "measured constants" if name == "1 times" else "tuned"
        curves.append(Curve(run.time_s, run.angle_deg, label, case, "model"))
        there = np.interp(target.time_s, run.time_s, run.angle_deg)
        apart.append(Curve(target.time_s, target.angle_deg - there, label, case, "plain"))
    panels = [Panel(curves, "angle (deg)", title="Position response", x_limits=(0.0, 1.5)),
              Panel(apart, "target less model (deg)", title="What is left", x_limits=(0.0, 1.5))]  # fmt: skip
    return plot_panels(panels, f"Fine-tuning, {session.target} and model")
