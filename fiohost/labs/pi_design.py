"""A PI position controller for an overshoot and a rise time, and the largest step that it meets without saturation."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiohost.control.metrics import MOST_OVERSHOOT_PCT, StepFigures, step_figures
from fiohost.labs.constants import MotorConstants
from fiohost.labs.ideal import play_ideal
from fiohost.labs.play import IDEAL, NO_LIMITS, Limits, Run
from fiohost.labs.result import Answer, Cell, Table
from fiohost.labs.session import Gains, Session, position

RUN_S = 4.0
POINTS = 8001
SMALL_DEG = 1.0  # too small to meet a limit
CLOSE_PCT = 0.005  # share of overshoot and of rise: nearer than anyone measures


@dataclass(frozen=True)
class PiDesign:
    """Gains in V/rad and V/(rad s), what the unsaturated model does with them, and the largest unsaturated step.

    Where no gains give what was asked for, ``met`` is false and all figures are those of the nearest ones.
    """

    asked_overshoot_pct: float
    asked_rise_s: float
    met: bool
    gains: Gains
    overshoot_pct: float
    rise_s: float
    volts_per_deg: float
    amperes_per_deg: float
    largest_deg: float
    bound_by: str
    limits: Limits

    @property
    def why_not(self) -> str:
        """That nothing meets it, and what comes nearest."""
        return (
            f"no PI gives {self.asked_overshoot_pct:g} % overshoot and a rise of {self.asked_rise_s:g} s on this "
            f"motor; nearest: {self.overshoot_pct:.1f} % and {self.rise_s:.4f} s with {self.gains}"
        )


def figures_of_gains(q: MotorConstants, gains: Gains) -> tuple[float, float]:
    """Overshoot in percent and rise in seconds of the ideal loop without limits, by partial fractions."""
    K = q.Kt_Nm_per_A
    bottom = np.array([
        q.L_H * q.J_kgm2, q.R_ohm * q.J_kgm2 + q.L_H * q.B_Nms, q.R_ohm * q.damping_Nms, K * gains.kp, K * gains.ki
    ])  # fmt: skip
    bottom = np.trim_zeros(bottom, "f")
    poles = np.roots(bottom)
    times = np.linspace(0.0, RUN_S, POINTS)
    shares = np.polyval([K * gains.kp, K * gains.ki], poles) / (poles * np.polyval(np.polyder(bottom), poles))
    with np.errstate(over="ignore", invalid="ignore"):
        response = 1.0 + (shares @ np.exp(np.outer(poles, times))).real
    if not np.isfinite(response).all():
        return MOST_OVERSHOOT_PCT, RUN_S
    found = step_figures(times, response, 0.0, 1.0)
    return found.overshoot_pct, found.rise_s


def design_pi(q: MotorConstants, overshoot_pct: float, rise_s: float, limits: Limits) -> PiDesign:
    """The PI gains that give both figures, or the nearest ones with ``met`` false where none do.

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
    met = abs(overshoot - overshoot_pct) <= CLOSE_PCT * overshoot_pct and abs(rise - rise_s) <= CLOSE_PCT * rise_s
    run = play_ideal(q, position(gains, SMALL_DEG)(IDEAL, q.pct_per_volt), RUN_S, limits=NO_LIMITS)
    assert run.current_A is not None
    per_deg = float(np.max(np.abs(run.volts))), float(np.max(np.abs(run.current_A)))
    bounds = {
        "voltage": math.inf if limits.volts is None else limits.volts / per_deg[0],
        "current": math.inf if limits.amperes is None else limits.amperes / per_deg[1],
    }
    bound_by = min(bounds, key=lambda name: bounds[name])
    return PiDesign(overshoot_pct, rise_s, met, gains, overshoot, rise, *per_deg, bounds[bound_by], bound_by, limits)


def figures_of(run: Run, ref_deg: float) -> StepFigures:
    return step_figures(run.time_s, run.angle_deg, 0.0, ref_deg)


@dataclass(frozen=True)
class Designed:
    """The designed loop on everything: case, step in degrees, run. No runs where no gains give what was asked for."""

    design: PiDesign
    runs: tuple[tuple[str, float, Run], ...] = ()

    def table(self) -> Table:
        columns = ("case", "deg", "who", "overshoot %", "rise s", "settling 5 % s", "peak V", "peak A")
        rows: list[list[Cell]] = []
        for case, size, run in self.runs:
            f = figures_of(run, size)
            current = None if run.current_A is None else float(np.max(np.abs(run.current_A)))
            rows.append([case, size, run.name, f.overshoot_pct, f.rise_s, f.settling_5_s,
                         float(np.max(np.abs(run.volts))), current])  # fmt: skip
        d = self.design
        if not d.met:
            asked = f"no PI gives {d.asked_overshoot_pct:g} % and {d.asked_rise_s:g} s on this motor"
            rows = [[asked, *[None] * (len(columns) - 1)],
                    [f"nearest: {d.gains}", None, "ideal", d.overshoot_pct, d.rise_s, None, None, None]]  # fmt: skip
        return Table("The PI design", columns, rows, given=(0, 2) if d.met else ())

    def step_21(self) -> Answer:
        d = self.design
        limits = [f"{value:g} {unit}" for value, unit in ((d.limits.volts, "V"), (d.limits.amperes, "A")) if value]
        told = (
            f"Kp = {d.gains.kp:.3f} V/rad, Ki = {d.gains.ki:.3f} V/(rad s): {d.overshoot_pct:.1f} % and "
            f"{d.rise_s:.4f} s. A degree asks for {d.volts_per_deg:.4f} V and {d.amperes_per_deg:.4f} A at most, so "
            + (f"{' and '.join(limits)} allow {d.largest_deg:.1f} deg; the {d.bound_by} is the bound" if limits else
               "without limits any step is met")
        )  # fmt: skip
        asked = f"PI for {d.asked_overshoot_pct:g} % overshoot and a rise of {d.asked_rise_s:g} s"
        return Answer(f"Step 21. {asked}, and its largest step", told if d.met else d.why_not)

    def step_25(self) -> Answer:
        question, d = "Step 25. The PI design on the target", self.design
        if not d.met:
            return Answer(question, f"nothing to run: {d.why_not}")
        told = []
        for case in ("largest unsaturated step", "lab's step"):
            size, by_name = 0.0, {}
            for name, step, run in self.runs:
                if name == case:
                    size, by_name[run.name] = step, run
            a, b = figures_of(by_name["model"], size), figures_of(by_name["target"], size)
            told.append(
                f"{size:.1f} deg: overshoot {b.overshoot_pct:.1f} %, rise {b.rise_s:.3f} s (model at the bench's ticks "
                f"{a.overshoot_pct:.1f} %, {a.rise_s:.3f} s)"
            )
        return Answer(
            question,
            f"asked for {d.asked_overshoot_pct:g} % and {d.asked_rise_s:g} s; {'; '.join(told)}. Ticks, delay and "
            "counts add overshoot to what was designed in continuous time; where the amplifier saturates the figures "
            "are others",
        )

    def values(self, named: Callable[[Run, float], dict[str, float]]) -> dict[str, Any]:
        """For programs."""
        d = self.design
        found: dict[str, Any] = {
            "met": d.met, "kp_V_per_rad": d.gains.kp, "ki_V_per_rad_s": d.gains.ki, "overshoot_pct": d.overshoot_pct,
            "rise_s": d.rise_s, "largest_unsaturated_step_deg": d.largest_deg if math.isfinite(d.largest_deg) else None,
            "bound_by": d.bound_by,
        }  # fmt: skip
        return found if not self.runs else {**found, "target_at_largest": named(self.runs[3][2], self.runs[3][1])}


def play_design(session: Session, design: PiDesign, to: float) -> Designed:
    """The designed loop without limits, at its largest step, and at the lab's step."""
    if not design.met:
        return Designed(design)
    small = math.copysign(min(design.largest_deg, abs(to)), to)
    found = [("no limits", to, session.ideal(position(design.gains, to), RUN_S, NO_LIMITS))]
    for case, size in (("largest unsaturated step", small), ("lab's step", to)):
        name = "position_pi_" + ("largest" if size == small else "full")
        found += [(case, size, run) for run in session.three(name, position(design.gains, size), RUN_S)]
    return Designed(design, tuple(found))
