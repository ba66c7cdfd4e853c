"""Problems D-18 and D-19: a PID controller that takes the effect of a load away, with a given overshoot.

An integral in a loop that already integrates makes the integral of the error of a step zero, so some overshoot is
certain; the two overshoots asked for are those of a pair of poles with a damping of 1/sqrt(2) and 3/4 (4.32, 2.84 %).
Three answers are given. The text's PID (Fig. D-36), all of it on the error: KP as large as the voltage allows, and of
all (KI, KD) with that overshoot the pair with the least time-weighted error (ITAE) after a load. The same with the
derivative of the angle, which no step makes endless, and the largest KI: there the integral of what a load does,
T R/(Ki KI), says all. And the latter with a proportional part that does not see the
step of the reference either (set-point weighting; Astrom and Hagglund, Advanced PID Control, section 3.4): its
overshoot is that of its poles alone, so the integral may be as fast as the rest.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from fiohost.control.metrics import step_figures
from fiohost.errors import DataError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.problems.answer import Numbers, angle_and_volts, motor_of, solved
from fiohost.labs.problems.servo import POSITION, FloatArray, Response, Servo
from fiohost.labs.result import LabResult, Table

THIRD_POLE = 2.0  # of the design by poles, as a multiple of the pair's frequency
LEAST_KI = 1e-3
MOST_KI = 1e3  # times KP
KD_RANGE = (0.02, 2.0)
NONE = 1e9  # the cost of no gains
TEXTS = "text's PID (Fig. D-36)"


ROWS = ("KP (V/rad)", "KI (V/(rad s))", "KD (V s/rad)", "overshoot (%)", "rise (s)", "settled to 2 % (s)",
        "largest voltage (V)", "load turns it by (rad)", "back within 2 % (s)")  # fmt: skip


class Gains(NamedTuple):
    """V/rad, V/(rad s), V s/rad; ``weight`` and ``kd_weight`` of the reference in the other two parts."""

    kp: float
    ki: float
    kd: float
    weight: float = 1.0
    kd_weight: float = 0.0


def d18(n: Numbers) -> LabResult:
    return _designed(18, n)


def d19(n: Numbers) -> LabResult:
    return _designed(19, n)


def loop_poles(motor: MotorConstants, gains: Gains) -> FloatArray:
    """Coefficients of the closed loop's polynomial, the highest power first: four where there is inductance."""
    R, L, K, J, B = motor.R_ohm, motor.L_H, motor.Kt_Nm_per_A, motor.J_kgm2, motor.B_Nms
    found = np.array([L * J, R * J + L * B, R * B + K * (motor.Ke_Vs_per_rad + gains.kd), K * gains.kp, K * gains.ki])
    return found if L > 0.0 else found[1:]


def overshoot_pct(motor: MotorConstants, gains: Gains, seconds: float) -> float:
    """Overshoot of a step of the reference, by partial fractions; endless where the loop is not stable."""
    K, polynomial = motor.Kt_Nm_per_A, loop_poles(motor, gains)
    poles = np.roots(polynomial)
    if (poles.real >= 0.0).any():
        return float("inf")
    times = _times(seconds) if gains.kd_weight else np.linspace(0.0, seconds, 4001)
    top = [K * gains.kd_weight * gains.kd, K * gains.weight * gains.kp, K * gains.ki]
    shares = np.polyval(top, poles) / (poles * np.polyval(np.polyder(polynomial), poles))
    return float(100.0 * np.max((shares @ np.exp(np.outer(poles, times))).real))


def _times(seconds: float) -> FloatArray:
    """From the winding's first moments, in which a derivative of the error acts, to the end."""
    return np.geomspace(1e-4, seconds, 6000)


def load_itae(motor: MotorConstants, gains: Gains, seconds: float) -> float:
    """Integral of time times what a load of 1 N m turns the shaft by, in rad s2, by partial fractions."""
    polynomial, times = loop_poles(motor, gains), _times(seconds)
    poles = np.roots(polynomial)
    top = [motor.L_H, motor.R_ohm, 0.0] if motor.L_H > 0.0 else [motor.R_ohm, 0.0]
    shares = np.polyval(top, poles) / (poles * np.polyval(np.polyder(polynomial), poles))
    turned = np.abs((shares @ np.exp(np.outer(poles, times))).real)
    return float(np.trapezoid(times * turned, times))


def on_error(motor: MotorConstants, n: Numbers, kd_weight: float) -> Gains:
    """The PID with the overshoot asked for that is least disturbed by a load. Raises DataError where none has it."""
    kp = n["largest_V"] / n["ref_rad"]

    def with_kd(kd: float) -> Gains | None:
        def over(ki: float) -> float:
            return min(overshoot_pct(motor, Gains(kp, ki, kd, 1.0, kd_weight), n["seconds"]), 1e3) - n["overshoot_pct"]

        if over(LEAST_KI) >= 0.0 or over(MOST_KI * kp) <= 0.0:
            return None
        return Gains(kp, float(brentq(over, LEAST_KI, MOST_KI * kp, xtol=1e-6)), kd, 1.0, kd_weight)

    def cost(log_kd: float) -> float:
        found = with_kd(float(np.exp(log_kd)))
        if found is None:
            return NONE
        return load_itae(motor, found, n["seconds"]) if kd_weight else -found.ki

    tried = np.linspace(np.log(KD_RANGE[0]), np.log(KD_RANGE[1]), 24)
    first = int(np.argmin([cost(x) for x in tried]))
    low, high = tried[max(first - 1, 0)], tried[min(first + 1, len(tried) - 1)]
    best = minimize_scalar(cost, bounds=(low, high), method="bounded", options={"xatol": 1e-3})
    found = with_kd(float(np.exp(best.x if best.fun < cost(tried[first]) else tried[first])))
    if found is None or cost(tried[first]) >= NONE:
        raise DataError(f"no PID with kp = {kp:g} V/rad has an overshoot of {n['overshoot_pct']:g} %: change largest_V")
    return found


def by_poles(motor: MotorConstants, n: Numbers) -> Gains:
    """The design with weight 0: a pair of poles, a third one beyond it, the rest where it must be; the pair's damping
    is what gives the overshoot. Raises DataError where no damping does.
    """
    omega = n["omega_rad_s"]
    given = loop_poles(motor, Gains(0.0, 0.0, 0.0))
    third = THIRD_POLE * omega

    def placed(zeta: float) -> Gains:
        wanted = np.polymul([1.0, 2.0 * zeta * omega, omega * omega], [1.0, third])
        if motor.L_H > 0.0:
            wanted = np.polymul(wanted, [1.0, given[1] / given[0] - 2.0 * zeta * omega - third])
        wanted = wanted * given[0]
        K = motor.Kt_Nm_per_A
        return Gains(float(wanted[-2] / K), float(wanted[-1] / K), float((wanted[-3] - given[-3]) / K), 0.0)

    def over(zeta: float) -> float:
        return min(overshoot_pct(motor, placed(zeta), n["seconds"]), 1e3) - n["overshoot_pct"]

    if over(0.2) < 0.0 or over(1.5) > 0.0:
        raise DataError(f"no such poles have an overshoot of {n['overshoot_pct']:g} %: change omega_rad_s")
    return placed(float(brentq(over, 0.2, 1.5, xtol=1e-6)))


def _designed(number: int, n: Numbers) -> LabResult:
    motor = motor_of(n)
    designs = {
        TEXTS: on_error(motor, n, 1.0),
        "D on the angle": on_error(motor, n, 0.0),
        "P and D on the angle": by_poles(motor, n),
    }
    steps, loads = {}, {}
    rows: list[list[Any]] = []
    for name, gains in designs.items():
        servo = Servo(motor, n["ref_rad"], POSITION, gains.kp, gains.ki, gains.kd, gains.weight,
                      derivative_of_error=gains.kd_weight > 0.0)  # fmt: skip
        step = steps[name] = servo.run(n["seconds"])
        load = loads[name] = replace(servo, load_Nm=n["load_Nm"], load_from_s=n["load_from_s"]).run(n["seconds"])
        f = step_figures(step.time_s, step.angle, 0.0, n["ref_rad"])
        over = 100.0 * (float(step.angle.max()) / n["ref_rad"] - 1.0)
        sag, back_s = _by_load(load, step, n)
        rows.append(
            [
                gains.kp,
                gains.ki,
                gains.kd,
                over,
                f.rise_s,
                f.settling_2_s,
                "endless" if gains.kd_weight else float(step.volts.max()),
                sag,
                back_s,
            ]
        )
    (plain, calm, other), (first, second, third) = designs.values(), rows
    moved = _settled_on_error(motor, calm, n)
    back = [f"{row[8]:.3g} s" if row[8] is not None else f"not within {n['seconds']:g} s" for row in rows]
    answers = [
        (
            f"Which PID takes the load away with {n['overshoot_pct']:g} % of overshoot?",
            f"KP = {plain.kp:.4g}, KI = {plain.ki:.4g}, KD = {plain.kd:.4g}: overshoot {first[3]:.3g} %, error at "
            "the end 0 whatever "
            f"the load. A load of {n['load_Nm']:g} N m turns the shaft by {first[7]:.3g} rad and is taken away in "
            f"{back[0]}. In the moment of the step this diagram asks for an endless voltage.",
        ),
        (
            "What if the derivative is that of the angle, as a real one is?",
            f"KP = {calm.kp:.4g}, KI = {calm.ki:.4g}, KD = {calm.kd:.4g} have that overshoot, {second[3]:.3g} %, ask "
            f"for {second[6]:.3g} V at most and take the load away in {back[1]}: slow, since with the "
            "proportional part on the error only a slow integral overshoots so little. The same gains in the text's "
            f"diagram overshoot by {moved[0]:.2f} % and are settled to 2 % after {moved[1]:.2f} s.",
        ),
        (
            "Is there a faster one?",
            f"With the proportional part on the angle too: KP = {other.kp:.4g}, KI = {other.ki:.4g}, KD = "
            f"{other.kd:.4g} have the same overshoot, {third[3]:.3g} %, and take the load away in {back[2]}.",
        ),
    ]
    notes = [
        f"The text's PID has the derivative of the error (Fig. D-36); it leaves open the size of the step "
        f"({n['ref_rad']:g} rad here) and the limits: KP asks for {n['largest_V']:g} V in the moment of the step.",
        "Some overshoot is certain: with the integral the loop integrates twice, and then the error of a step has a "
        "mean of 0.",
    ]
    table = Table("Three designs", ("", *designs), list(zip(ROWS, *rows, strict=True)))
    values: dict[str, Any] = {
        name: {**gains._asdict(), "overshoot_pct": row[3], "settling_2_s": row[5], "load_turns_rad": row[7],
               "load_gone_s": row[8]}
        for (name, gains), row in zip(designs.items(), rows, strict=True)
    }  # fmt: skip
    values["D on the angle, in the text's diagram"] = {"overshoot_pct": moved[0], "settling_2_s": moved[1]}
    about = f"PID that removes a load, overshoot {n['overshoot_pct']:g} %"
    pictures = partial(
        angle_and_volts, {f"{name}, load at {n['load_from_s']:g} s": run for name, run in loads.items()}, n["ref_rad"]
    )
    return solved(number, about, answers, values, pictures, [table], notes)


def _settled_on_error(motor: MotorConstants, gains: Gains, n: Numbers) -> tuple[float, float]:
    """Overshoot in percent and settling to 2 % of gains in the text's diagram, all on the error."""
    servo = Servo(motor, n["ref_rad"], POSITION, gains.kp, gains.ki, gains.kd, derivative_of_error=True)
    found = servo.run(n["seconds"])
    settling_s = step_figures(found.time_s, found.angle, 0.0, n["ref_rad"]).settling_2_s
    return 100.0 * (float(found.angle.max()) / n["ref_rad"] - 1.0), settling_s


def _by_load(loaded: Response, free: Response, n: Numbers) -> tuple[float, float | None]:
    """How far a load turns the shaft from where it would be, and when that is within 2 % of the step for good."""
    turned = np.abs(loaded.angle - free.angle)
    outside = np.flatnonzero(turned > 0.02 * n["ref_rad"])
    most = float(turned.max())
    if not outside.size:
        return most, 0.0
    if outside[-1] + 1 == len(turned):
        return most, None
    return most, float(loaded.time_s[outside[-1]]) - n["load_from_s"]
