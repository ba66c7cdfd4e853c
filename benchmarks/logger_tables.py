"""Benches as loggers of other people see them: a plain simulation with noise, and six ways to write it to a table.

Equations as a textbook has them, Euler's rule, a random torque (Ornstein-Uhlenbeck) on the shaft, a gain that may be
another in each run. Shares nothing with the board or the fit. Everything is in percent of duty and degrees.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numba import njit

STEP_S = 5e-5
KINDS = (
    "nothing", "gravity_load", "constant_load", "quadratic_drag", "backlash", "input_deadband", "voltage_saturation",
    "transport_delay", "armature_inductance", "stribeck_friction", "cogging_torque",
)  # fmt: skip
(NOTHING, GRAVITY, LOAD, DRAG, PLAY, ZONE, SATURATION, DELAY, WINDING, STRIBECK, COGGING) = range(len(KINDS))
DRAWS: Mapping[str, Callable[[random.Random], tuple[float, ...]]] = {
    "nothing": lambda r: (0.0,),
    "gravity_load": lambda r: (r.uniform(3.0, 8.0), r.uniform(0.0, 6.28)),
    "constant_load": lambda r: (r.uniform(2.0, 6.0) * r.choice((-1.0, 1.0)),),
    "quadratic_drag": lambda r: (r.uniform(10.0, 40.0),),
    "backlash": lambda r: (r.uniform(4.0, 12.0),),
    "input_deadband": lambda r: (r.uniform(4.0, 10.0),),
    "voltage_saturation": lambda r: (r.uniform(45.0, 65.0),),
    "transport_delay": lambda r: (r.uniform(0.01, 0.04),),
    "armature_inductance": lambda r: (r.uniform(0.01, 0.03),),
    "stribeck_friction": lambda r: (r.uniform(3.0, 8.0), r.uniform(30.0, 120.0)),
    "cogging_torque": lambda r: (r.uniform(3.0, 8.0), r.uniform(0.0, 6.28), float(r.randrange(2, 9))),
}
# What angles alone show.
OF_ANGLES = ("gravity_load", "backlash", "cogging_torque")


@njit(cache=True)
def simulate(duty, torque, row_s, gain, tau, friction, kind, q):  # type: ignore[no-untyped-def]
    """Angle and speed (n) of a run from rest under duties and a random torque (n), each held from row to row."""
    n, per_row = len(duty), round(row_s / STEP_S)
    shown, speeds = np.zeros(n), np.zeros(n)
    angle = speed = current = load = 0.0
    late = round(q[0] / STEP_S) if kind == DELAY else 0
    for k in range(n):
        if kind == PLAY:
            load = min(max(load, angle - 0.5 * q[0]), angle + 0.5 * q[0])
        shown[k], speeds[k] = (load if kind == PLAY else angle), speed
        for i in range(per_row):
            at = (k * per_row + i - late) // per_row
            u = duty[at] if at >= 0 else 0.0
            if kind == ZONE:
                u = math.copysign(max(abs(u) - q[0], 0.0), u)
            elif kind == SATURATION:
                u = math.copysign(min(abs(u), q[0]), u)
            push = u - speed / gain
            if kind == WINDING:
                current += STEP_S / q[0] * (push - current)
                push = current
            push += torque[k]
            if kind == GRAVITY:
                push -= q[0] * math.sin(math.radians(angle) + q[1])
            elif kind == LOAD:
                push -= q[0]
            elif kind == DRAG:
                push -= q[0] * speed * abs(speed) / 1e6
            elif kind == COGGING:
                push -= q[0] * math.sin(q[2] * math.radians(angle) + q[1])
            slides = friction + (q[0] * math.exp(-((speed / q[1]) ** 2)) if kind == STRIBECK else 0.0)
            if speed == 0.0 and abs(push) <= slides:
                continue
            way = math.copysign(1.0, speed if speed != 0.0 else push)
            after = speed + STEP_S * gain / tau * (push - way * slides)
            speed = 0.0 if speed * after < 0.0 else after
            angle += STEP_S * speed
    return shown, speeds


class Rows(NamedTuple):
    """What a logger may read at its rows (n): time in s, duty in percent, angle in deg and speed in deg/s."""

    times_s: np.ndarray
    duty_pct: np.ndarray
    angle_deg: np.ndarray
    speed_deg_s: np.ndarray
    rng: np.random.Generator


def _counted(rows: Rows, counts: int) -> np.ndarray:
    """Speeds in rpm from counts between rows."""
    seen = np.floor(rows.angle_deg / 360.0 * counts + rows.rng.random())
    return np.asarray(np.diff(seen, prepend=seen[0]) / counts / (rows.times_s[1] - rows.times_s[0]) * 60.0)


def counted_speed(rows: Rows) -> str:
    """Milliseconds, PWM steps, rpm from counts."""
    columns = zip(rows.times_s, rows.duty_pct, _counted(rows, 1440), strict=True)
    return "time_ms,pwm,rpm\n" + "".join(f"{1e3 * t:.0f},{round(2.55 * u)},{w:.2f}\n" for t, u, w in columns)


def filtered_speed(rows: Rows) -> str:
    """The same, smoothed by an average that forgets."""
    shown, smooth = "t,PWM,speed_rpm\n", 0.0
    for t, u, w in zip(rows.times_s, rows.duty_pct, _counted(rows, 2000), strict=True):
        smooth = 0.8 * smooth + 0.2 * w
        shown += f"{t:.3f},{round(2.55 * u)},{smooth:.3f}\n"
    return shown


def tachometer(rows: Rows) -> str:
    """Volts of 12 and an analogue speed with noise."""
    speed = np.radians(rows.speed_deg_s)
    speed = speed + 0.004 * np.abs(speed).max() * rows.rng.standard_normal(len(speed))
    columns = zip(rows.times_s, rows.duty_pct, speed, strict=True)
    return "Time (s),Voltage (V),Speed (rad/s)\n" + "".join(f"{t:.4f},{0.12 * u:.4f},{w:.5f}\n" for t, u, w in columns)


def wrapped_angle(rows: Rows) -> str:
    """Microseconds that jitter, volts of 24, an absolute encoder of 4096 steps in radians."""
    angle = np.floor(rows.angle_deg % 360.0 / 360.0 * 4096.0) / 4096.0 * 2.0 * np.pi
    columns = zip(1e6 * rows.times_s + rows.rng.normal(0.0, 100.0, len(angle)), rows.duty_pct, angle, strict=True)
    return "timestamp_us,u_volt,theta_rad\n" + "".join(f"{t:.0f},{0.24 * u:.3f},{a:.5f}\n" for t, u, a in columns)


def counts_with_gaps(rows: Rows) -> str:
    """A duty without sign, a direction, counts; 1 % of the rows are missing."""
    lines = []
    for k, (t, u, a) in enumerate(zip(rows.times_s, rows.duty_pct, rows.angle_deg, strict=True)):
        if k < 3 or rows.rng.random() >= 0.01:
            lines.append(f"{t:.4f};{0.01 * abs(u):.4f};{int(u >= 0.0)};{math.floor(a / 360.0 * 1000.0)}\n")
    return "# bench log\nt;duty;dir;counts\n" + "".join(lines)


def sketch(rows: Rows) -> str:
    """PWM steps without sign, the way in letters, a counter and the rpm that the sketch makes of it."""
    seen = np.floor(rows.angle_deg / 360.0 * 2400.0)
    rpm = np.diff(seen, prepend=seen[0]) / 2400.0 / (rows.times_s[1] - rows.times_s[0]) * 60.0
    steps = np.rint(2.55 * rows.duty_pct)
    ways = np.where(steps > 0.0, "F", np.where(steps < 0.0, "R", "N"))
    columns = zip(rows.times_s, np.abs(steps), ways, seen, rpm, strict=True)
    lines = [f"{1e3 * t:.0f},{u:.0f},{way},{c:.0f},{w:.2f}\n" for t, u, way, c, w in columns]
    return "t_ms,pwm_cmd,dir,enc_count,rpm\n" + "".join(lines)


class Logger(NamedTuple):
    """How a logger writes, how far its rows are apart, and what must be said of its tables."""

    write: Callable[[Rows], str]
    row_s: float
    seconds: float
    angle: bool
    said: Mapping[str, float]
    steps: float = 0.0  # of the PWM, which the bridge knows no finer than the table does


LOGGERS: Mapping[str, Logger] = {
    "counted speed": Logger(counted_speed, 0.01, 20.0, False, {"full_scale": 255.0}, 255.0),
    "filtered speed": Logger(filtered_speed, 0.01, 20.0, False, {"full_scale": 255.0}, 255.0),
    "tachometer": Logger(tachometer, 0.002, 12.0, False, {"full_scale": 12.0}),
    "wrapped angle": Logger(wrapped_angle, 0.005, 20.0, True, {"full_scale": 24.0}),
    "sketch": Logger(sketch, 0.01, 20.0, True, {}, 255.0),
    "counts with gaps": Logger(counts_with_gaps, 0.005, 20.0, True, {"full_scale": 1.0, "counts_per_rev": 1000.0}),
}


def commands(shape: str, n: int, row_s: float, rng: np.random.Generator) -> np.ndarray:
    """Duties (n) in percent: random steps, a staircase up and down, a sine, or a square wave."""
    times = np.arange(n) * row_s
    if shape == "steps":
        holds = rng.integers(round(0.3 / row_s), round(2.0 / row_s), n)
        return np.repeat(rng.uniform(-95.0, 95.0, n), holds)[:n]
    if shape == "stairs":
        up = np.arange(0.0, 101.0, 10.0)
        levels = np.concatenate((up, up[-2::-1], -up[1:], -up[-2::-1]))
        return np.asarray(levels[np.arange(n) * len(levels) // n])
    size, hertz = rng.uniform(40.0, 90.0), rng.uniform(0.1, 0.4)
    wave = np.sin(2.0 * np.pi * hertz * times)
    return np.asarray(size * (np.sign(wave) if shape == "square" else wave))


def tables(logger: str, kind: str, seed: int, folder: Path) -> tuple[list[Path], dict[str, object]]:
    """Five tables of a drawn bench, the last one to be held out, and the truth."""
    of, draw = LOGGERS[logger], random.Random(f"loggers {logger} {kind} {seed}")
    rng = np.random.default_rng(draw.randrange(2**32))
    gain, tau, friction = draw.uniform(6.0, 40.0), draw.uniform(0.03, 0.3), draw.uniform(1.5, 6.0)
    noise_pct, lasts_s = draw.choice((0.0, 0.2, 0.5)), draw.uniform(0.05, 0.5)
    scatter, values = draw.choice((0.0, 0.005)), DRAWS[kind](draw)
    n, paths = round(of.seconds / of.row_s), []
    stays = math.exp(-of.row_s / lasts_s)
    for number, shape in enumerate(("steps", "stairs", "sine", "square", "steps"), 1):
        duty, torque = commands(shape, n, of.row_s, rng), np.zeros(n)
        if of.steps:
            duty = np.rint(0.01 * of.steps * duty) / (0.01 * of.steps)
        for k, kick in enumerate(rng.standard_normal(n - 1), 1):
            torque[k] = stays * torque[k - 1] + noise_pct * math.sqrt(1.0 - stays**2) * kick
        own = gain * (1.0 + scatter * rng.standard_normal())
        angle, speed = simulate(
            duty, torque, of.row_s, own, tau, friction, KINDS.index(kind), np.array((*values, 0.0, 0.0))
        )
        paths.append(folder / f"run{number}.csv")
        paths[-1].write_text(of.write(Rows(np.arange(n) * of.row_s, duty, angle, speed, rng)))
    truth = {"gain": gain, "tau": tau, "friction": friction, "values": values}
    return paths, truth | {"noise_pct": noise_pct, "lasts_s": lasts_s, "gain_sd": scatter}
