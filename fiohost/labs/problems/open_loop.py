"""Problems D-1 to D-6: the speed of the motor alone, with and without friction, inductance and load."""

from __future__ import annotations

from functools import partial
from typing import Any

from fiohost.labs.constants import MotorConstants
from fiohost.labs.problems.answer import (
    Numbers,
    change_by_load,
    four_answers,
    in_s,
    motor_of,
    rise_times,
    solved,
    speed_and_current,
)
from fiohost.labs.problems.servo import Response, Servo
from fiohost.labs.result import LabResult, Table

SHOWN = 8.0  # time constants of a picture


def d1(n: Numbers) -> LabResult:
    motor = motor_of(n)
    run = Servo(motor, n["volts"]).run(n["seconds"])
    answers, values = four_answers(run, "abcd")
    pictures = partial(speed_and_current, {f"{n['volts']:g} V": run}, SHOWN * motor.tau_m_s)
    return solved(1, "speed and current of the motor after a step of voltage", answers, values, pictures)


def d2(n: Numbers) -> LabResult:
    motor = motor_of(n, B_Nms=0.0)
    run = Servo(motor, n["volts"]).run(n["seconds"])
    other = Servo(motor, n["other_volts"]).run(n["seconds"])
    answers, values = four_answers(run, " abc")
    answers.append((f"(d) Steady speed at {n['other_volts']:g} V", f"{other.speed[-1]:.4g} rad/s"))
    runs = {f"{n['volts']:g} V": run, f"{n['other_volts']:g} V": other}
    pictures = partial(speed_and_current, runs, SHOWN * motor.tau_m_s)
    values |= {"other_steady_speed_rad_s": float(other.speed[-1])}
    about = "the same without viscous friction"
    return solved(
        2, about, answers, values, pictures, notes=["Without friction the back-emf alone ends the rise: V/Kb."]
    )


def d3(n: Numbers) -> LabResult:
    motor = motor_of(n, B_Nms=0.0, L_H=0.0)
    heavier = motor.with_inertia(n["inertia_factor"] * motor.J_kgm2)
    run, slow = (Servo(m, n["volts"]).run(n["seconds"]) for m in (motor, heavier))
    answers, values = four_answers(run, "abcd")
    times = rise_times(slow, slow.speed, float(slow.speed[-1]))
    for letter, share, time_s in zip("ef", (63, 75), times, strict=True):
        answers.append((f"({letter}) {share} % with {n['inertia_factor']:g} times the inertia", in_s(time_s)))
    values |= {"heavier_to_63_pct_s": times[0], "heavier_to_75_pct_s": times[1]}
    runs = {"J": run, f"{n['inertia_factor']:g} J": slow}
    note = "Without inductance the current is there at once, V/R, and the times are proportional to the inertia."
    about = "the same without inductance, and with more inertia"
    return solved(3, about, answers, values, partial(speed_and_current, runs, SHOWN * heavier.tau_m_s), notes=[note])


def d4(n: Numbers) -> LabResult:
    return _loaded(4, n)


def d5(n: Numbers) -> LabResult:
    return _loaded(5, n)


def d6(n: Numbers) -> LabResult:
    motor = motor_of(n, L_H=0.0)
    run = Servo(motor, n["volts"], amplifier=n["amplifier"]).run(n["seconds"])
    answers = [("Steady speed", f"{run.speed[-1]:.4g} rad/s, at {n['amplifier'] * n['volts']:g} V on the motor")]
    note = (
        "The text names Fig. D-1, which is a photograph; taken is the motor of Fig. D-24 behind an amplifier. Its "
        "limits "
        "are ignored, as the text says: a real one of 4.5 V would not give this."
    )
    values = {"steady_speed_rad_s": float(run.speed[-1])}
    pictures = partial(speed_and_current, {f"{n['amplifier']:g} x {n['volts']:g} V": run}, SHOWN * motor.tau_m_s)
    return solved(6, "an amplifier before the motor", answers, values, pictures, notes=[note])


def _loaded(number: int, n: Numbers) -> LabResult:
    """D-1 to D-3 again with a load torque that begins during the run."""
    cases = {
        "D-1": motor_of(n),
        "D-2": motor_of(n, B_Nms=0.0),
        "D-3": motor_of(n, B_Nms=0.0, L_H=0.0),
    }
    load, begin_s, volts = n["load_Nm"], n["load_from_s"], n["volts"]
    runs = {name: _with_load(motor, n, load) for name, motor in cases.items()}
    found = {name: change_by_load(run, begin_s) for name, run in runs.items()}
    rows = [
        [
            name,
            f["before_rad_s"],
            f["after_rad_s"],
            f["up_63_s"],
            f["up_75_s"],
            f["change_63_s"],
            f["change_75_s"],
            f["A"],
        ]
        for name, f in found.items()
    ]
    columns = ("as in", "before (rad/s)", "after (rad/s)", "63 % (s)", "75 % (s)", "63 % of change (s)",
               "75 % of change (s)", "largest current (A)")  # fmt: skip
    stall = -motor_of(n).Kt_Nm_per_A * volts / n["R_ohm"]
    more = [factor * stall for factor in (0.2, 0.4, 0.6, 0.8, 1.0, 1.2)]
    steady = {load_Nm: round(float(_with_load(cases["D-1"], n, load_Nm).speed[-1]), 6) + 0.0 for load_Nm in more}
    first = found["D-1"]
    answers = [
        (
            "(a) How does the steady speed change?",
            "; ".join(f"{name}: {f['before_rad_s']:.4g} to {f['after_rad_s']:.4g} rad/s" for name, f in found.items()),
        ),
        *(
            (
                f"({letter}) {share} % of the new steady speed",
                f"as D-1: {in_s(first[f'up_{share}_s'])} after the voltage, on the way up, before the load; of the "
                "change "
                f"that the load makes, {in_s(first[f'change_{share}_s'])} after it",
            )
            for letter, share in (("b", 63), ("c", 75))
        ),
        ("(d) Largest current", "; ".join(f"{name}: {f['A']:.4g} A" for name, f in found.items())),
        (
            "(e) More load",
            "The speed falls in proportion, by R/(Ki Kb + R B) for each N m: "
            + ", ".join(f"{speed:.3g} rad/s at {torque:g}" for torque, speed in steady.items())
            + f". At {stall:.4g} N m the motor stands; a stronger load turns it backwards.",
        ),
    ]
    notes = [
        "The text asks for 63 % of the new speed though the motor passes that on its way up, before the load: both "
        "readings are given. T is added to the motor's torque (Fig. D-24), so the minus sign opposes.",
    ]
    values: dict[str, Any] = {"cases": found, "speed_by_load_rad_s": {f"{k:g}": v for k, v in steady.items()}}
    pictures = partial(speed_and_current, {f"as {name}": run for name, run in runs.items()}, begin_s + 0.8)
    about = f"D-1 to D-3 with a load of {load:g} N m from {begin_s:g} s on"
    return solved(number, about, answers, values, pictures, [Table("With the load", columns, rows)], notes)


def _with_load(motor: MotorConstants, n: Numbers, load_Nm: float) -> Response:
    return Servo(motor, n["volts"], load_Nm=load_Nm, load_from_s=n["load_from_s"]).run(n["seconds"])
