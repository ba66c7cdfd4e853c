"""A PI position controller for an overshoot and a rise time, and the largest step that it meets without saturation."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from fiohost.control.closed_loop import Loop, Plant, step_run
from fiohost.control.metrics import StepFigures, step_figures
from fiohost.errors import DataError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.play import IDEAL, IDEAL_TICK_S, NO_LIMITS, Limits, Run, play_model
from fiohost.labs.result import Answer, Cell, Table
from fiohost.labs.session import Gains, Session, position

RUN_S = 4.0
SMALL_DEG = 1.0  # too small to meet a limit
CLOSE = (0.5, 0.001)  # overshoot in percent, rise in seconds: nearer than anyone measures


@dataclass(frozen=True)
class PiDesign:
    """Gains in V/rad and V/(rad s), what the unsaturated model does with them, and the largest unsaturated step."""

    gains: Gains
    overshoot_pct: float
    rise_s: float
    volts_per_deg: float
    amperes_per_deg: float
    largest_deg: float
    bound_by: str


def figures_of_gains(q: MotorConstants, gains: Gains) -> tuple[float, float]:
    """Overshoot in percent and rise in seconds of the ideal loop without limits."""
    scale = math.radians(1.0) * q.pct_per_volt
    loop = Loop(gains.kp * scale, ki_pct_per_deg_s=gains.ki * scale, sample_time_s=IDEAL_TICK_S)
    run = step_run(Plant.of(q.model()), loop, SMALL_DEG, RUN_S)
    found = step_figures(run.time_s, run.angle_deg, 0.0, SMALL_DEG)
    return found.overshoot_pct, found.rise_s


def design_pi(q: MotorConstants, overshoot_pct: float, rise_s: float, limits: Limits) -> PiDesign:
    """The PI gains that give both figures. Raises DataError where none do.

    Started from the proportional gain whose second-order loop has the overshoot (the text's Eq. 7-53).
    """
    from scipy.optimize import least_squares

    damping = -math.log(overshoot_pct / 100.0) / math.hypot(math.pi, math.log(overshoot_pct / 100.0))
    kp = 1.0 / (4.0 * damping**2 * q.tau_m_s * q.speed_per_volt)

    def misses(x: np.ndarray) -> list[float]:
        overshoot, rise = figures_of_gains(q, Gains(math.exp(x[0]), math.exp(x[1])))
        return [(overshoot - overshoot_pct) / overshoot_pct, (rise - rise_s) / rise_s]

    best = None
    for share in (0.2, 1.0, 5.0):
        begin = np.log([0.8 * kp, share * kp])
        found = least_squares(
            misses, begin, bounds=(begin - 6.0, begin + 4.0), diff_step=(1e-3, 1e-3), xtol=1e-6, ftol=1e-10
        )
        best = found if best is None or found.cost < best.cost else best
        if best.cost < 1e-6:
            break
    assert best is not None
    gains = Gains(math.exp(best.x[0]), math.exp(best.x[1]))
    overshoot, rise = figures_of_gains(q, gains)
    if abs(overshoot - overshoot_pct) > CLOSE[0] or abs(rise - rise_s) > CLOSE[1]:
        raise DataError(
            f"no PI gains give {overshoot_pct:g} % overshoot and a rise of {rise_s:g} s on this motor; nearest: "
            f"{overshoot:.1f} % and {rise:.3f} s with {gains}"
        )
    run = play_model(q, position(gains, SMALL_DEG)(IDEAL, q.pct_per_volt), RUN_S, IDEAL, limits=NO_LIMITS)
    assert run.current_A is not None
    per_deg = float(np.max(np.abs(run.volts))), float(np.max(np.abs(run.current_A)))
    bounds = {
        "voltage": math.inf if limits.volts is None else limits.volts / per_deg[0],
        "current": math.inf if limits.amperes is None else limits.amperes / per_deg[1],
    }
    bound_by = min(bounds, key=lambda name: bounds[name])
    return PiDesign(gains, overshoot, rise, *per_deg, bounds[bound_by], bound_by)


def figures_of(run: Run, ref_deg: float) -> StepFigures:
    return step_figures(run.time_s, run.angle_deg, 0.0, ref_deg)


def play_design(session: Session, design: PiDesign, to: float) -> list[tuple[str, float, Run]]:
    """The designed loop on everything: without limits, at its largest step, and at the lab's step."""
    small = min(design.largest_deg, to)
    found = [("no limits", to, session.ideal(position(design.gains, to), RUN_S, NO_LIMITS))]
    for case, size in (("largest unsaturated step", small), ("lab's step", to)):
        name = "position_pi_" + ("largest" if size == small else "full")
        found += [(case, size, run) for run in session.three(name, position(design.gains, size), RUN_S)]
    return found


def design_table(designed: list[tuple[str, float, Run]]) -> Table:
    rows: list[list[Cell]] = []
    for case, size, run in designed:
        f = figures_of(run, size)
        current = None if run.current_A is None else float(np.max(np.abs(run.current_A)))
        rows.append([case, size, run.name, f.overshoot_pct, f.rise_s, f.settling_5_s,
                     float(np.max(np.abs(run.volts))), current])  # fmt: skip
    columns = ("case", "deg", "who", "overshoot %", "rise s", "settling 5 % s", "peak V", "peak A")
    return Table("The PI design", columns, rows)


def step_21(design: PiDesign, overshoot_pct: float, rise_s: float) -> Answer:
    return Answer(
        f"Step 21. PI for {overshoot_pct:g} % overshoot and a rise of {rise_s:g} s, and its largest step",
        f"Kp = {design.gains.kp:.3f} V/rad, Ki = {design.gains.ki:.3f} V/(rad s): {design.overshoot_pct:.1f} % and "
        f"{design.rise_s:.4f} s. A degree asks for {design.volts_per_deg:.4f} V and {design.amperes_per_deg:.4f} A at "
        f"most, so 4.5 V and 1 A allow {design.largest_deg:.1f} deg; the {design.bound_by} is the bound",
    )


def step_25(designed: list[tuple[str, float, Run]], overshoot_pct: float, rise_s: float) -> Answer:
    told = []
    for case in ("largest unsaturated step", "lab's step"):
        size, model, target = next((s, m, t) for (c, s, m), (_, _, t) in zip(designed[2:], designed[3:], strict=False)
                                   if c == case and m.name == "model" and t.name == "target")  # fmt: skip
        a, b = figures_of(model, size), figures_of(target, size)
        told.append(
            f"{size:.1f} deg: overshoot {b.overshoot_pct:.1f} %, rise {b.rise_s:.3f} s (model at the bench's ticks "
            f"{a.overshoot_pct:.1f} %, {a.rise_s:.3f} s)"
        )
    return Answer(
        "Step 25. The PI design on the target",
        f"asked for {overshoot_pct:g} % and {rise_s:g} s; {'; '.join(told)}. Ticks, delay and counts add "
        "overshoot to what was designed in continuous time; where the amplifier saturates the figures are others",
    )
