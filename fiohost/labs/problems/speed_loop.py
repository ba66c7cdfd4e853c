"""Problems D-7 to D-11: the motor's speed under proportional control."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

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
from fiohost.labs.problems.servo import SPEED, Servo
from fiohost.labs.result import LabResult, Table


def loop(n: Numbers) -> Servo:
    """The loop of D-7: no inductance, an amplifier, unity feedback."""
    return Servo(motor_of(n, L_H=0.0), n["ref_rad_s"], SPEED, n["kp"], amplifier=n["amplifier"])


def d7(n: Numbers) -> LabResult:
    run = loop(n).run(n["seconds"])
    answers, values = four_answers(run, "abcd")
    short = (n["ref_rad_s"] - values["steady_speed_rad_s"]) / n["ref_rad_s"]
    note = f"A P controller leaves an error, here {100.0 * short:.3g} % of what was asked for."
    pictures = partial(speed_and_current, {f"kp {n['kp']:g}": run}, 10.0 * (values["to_63_pct_s"] or n["seconds"]))
    return solved(7, "speed under P control", answers, values, pictures, notes=[note])


def d8(n: Numbers) -> LabResult:
    servo = loop(n)
    run = servo.run(n["seconds"])
    limited = replace(servo, limit_V=n["limit_V"], limit_A=n["limit_A"]).run(n["seconds"])
    answers, values = four_answers(run, "abcd")
    slow = rise_times(limited, limited.speed, float(limited.speed[-1]))
    gains = {kp: replace(servo, kp=kp).run(n["seconds"]) for kp in (0.1, 0.2, 0.5, n["kp"])}
    rows = [
        [kp, float(r.speed[-1]), rise_times(r, r.speed, float(r.speed[-1]))[0], r.most_amps] for kp, r in gains.items()
    ]
    limits = f"{n['limit_V']:g} V and {n['limit_A']:g} A"
    answers.append(
        (
            "(e) What does a larger gain do?",
            f"Less error, a faster rise, a larger current: {run.most_amps:.3g} A in the first moment, which no such "
            "motor "
            f"gets. With {limits} the speed ends at {limited.speed[-1]:.4g} rad/s and has 63 % of it after "
            f"{in_s(slow[0])}: "
            "the limit, not the gain, then decides how fast it is.",
        )
    )
    values |= {
        "limited_steady_speed_rad_s": float(limited.speed[-1]),
        "limited_to_63_pct_s": slow[0],
        "limited_largest_current_A": limited.most_amps,
    }
    columns = ("kp", "steady speed (rad/s)", "63 % (s)", "largest current (A)")
    pictures = partial(speed_and_current, {"no limits": run, limits: limited}, 0.5)
    return solved(8, "a larger gain", answers, values, pictures, [Table("By gain, without limits", columns, rows)])


def d9(n: Numbers) -> LabResult:
    return _loaded(9, n)


def d10(n: Numbers) -> LabResult:
    return _loaded(10, n)


def d11(n: Numbers) -> LabResult:
    sensor = n["sensor_V_s_per_rad"]
    kp = n["kp"] / sensor
    asked_V = n["ref_rad_s"] * sensor
    with_sensor = Servo(motor_of(n, L_H=0.0), asked_V, SPEED, kp, amplifier=n["amplifier"], sensor=sensor).run(
        n["seconds"]
    )
    without = loop(n).run(n["seconds"])
    apart = float(abs(with_sensor.speed - without.speed).max())
    answers = [
        (
            "Which kp gives the result of D-7?",
            f"kp = {kp:.4g}: the loop gain kp Ks must be that of D-7, {n['kp']:g}. With a reference of {asked_V:g} V "
            "the two "
            f"speeds then differ by at most {apart:.1g} rad/s.",
        )
    ]
    note = (
        f"The text's reference of 2 rad/s is what the sensor's {sensor:g} V s/rad makes of {n['ref_rad_s']:g} rad/s, "
        f"{asked_V:g} "
        "V: taken as volts. Taken as 2 rad/s the response is a fifth as large and the gain the same."
    )
    values = {"kp": kp, "steady_speed_rad_s": float(with_sensor.speed[-1]), "largest_difference_rad_s": apart}
    runs = {f"with sensor, kp {kp:g}": with_sensor, f"D-7, kp {n['kp']:g}": without}
    return solved(
        11, "a speed sensor in the loop", answers, values, partial(speed_and_current, runs, 0.25), notes=[note]
    )


def _loaded(number: int, n: Numbers) -> LabResult:
    """D-7 with a load that begins during the run."""
    load, begin_s = n["load_Nm"], n["load_from_s"]
    run = replace(loop(n), load_Nm=load, load_from_s=begin_s).run(n["seconds"])
    found = change_by_load(run, begin_s)
    after = float(run.speed[-1])
    stands = abs(after) < 1e-6 * n["ref_rad_s"]
    answers = [
        ("(a) Steady speed", f"{0.0 if stands else after:.4g} rad/s after the load, {found['before_rad_s']:.4g} before")
    ]
    for letter, share in (("b", 63), ("c", 75)):
        text = f"{in_s(found[f'change_{share}_s'])} after the load for {share} % of the change that it makes"
        if not stands and after > 0.0:
            text = f"{in_s(found[f'up_{share}_s'])} after the step, on the way up; {text}"
        answers.append((f"({letter}) {share} % of the new steady speed", text))
    if stands:
        why = (
            "The load just balances what the loop gives at standstill: the new speed is 0, of which 63 % means nothing."
        )
    elif after < 0.0:
        why = "The load is stronger than the loop at standstill: it turns the motor backwards, which no way up passes."
    else:
        why = "The motor passes that speed on its way up, before the load: both readings are given."
    pictures = partial(speed_and_current, {f"{load:g} N m from {begin_s:g} s": run}, begin_s + 0.5)
    about = f"D-7 with a load of {load:g} N m from {begin_s:g} s on"
    return solved(number, about, answers, dict(found), pictures, notes=[why])
