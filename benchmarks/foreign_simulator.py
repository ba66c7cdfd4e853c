"""A third simulator of a motor bench, of other habits than the board's and the fit's: one plain fixed step, Euler's,
with textbook equations as one would write them down. Shares nothing with either, and is as exact as such a step is.

Everything is in percent of duty and degrees. Friction stops a shaft where its speed would change sign. Kinds that begin
with ``pwm`` and are no steps have a winding that sees every pulse of the bridge, in steps of 1 us.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit

STEP_S, TICK_S = 20e-6, 0.005
PULSE_STEP_S, SUPPLY = 1e-6, 100.0

# Which equation: the place of its name is the number that the kernel knows it by.
KINDS = (
    "nothing", "static_friction", "stribeck_friction", "lugre", "dahl", "quadratic_drag", "asymmetric_friction",
    "constant_load", "gravity", "cogging_with_overtone", "friction_by_angle", "play", "springy_gap", "springy_shaft",
    "springy_stop", "dead_zone", "minimum_pulse", "delay", "inductance", "supply_sag", "saturation", "duty_curve",
    "weaker_backward", "pwm_steps", "change_in_every_log", "change_once", "friction_falls_with_time", "heating",
    "eccentric_disc", "current_limit", "bridge_drop", "supply_drift", "friction_by_load", "pwm_current_limit",
    "pwm_fast_decay", "pwm_bridge_drop", "pwm_supply_sag", "pwm_heating",
)  # fmt: skip
(NOTHING, STATIC, STRIBECK, LUGRE, DAHL, DRAG, ASYMMETRIC, LOAD, GRAVITY, COGGING, BY_ANGLE, PLAY, GAP, SHAFT, STOP,
 ZONE, PULSE, DELAY, LAG, SAG, SATURATION, CURVE, BACKWARD, STEPS, EVERY, ONCE, COOLS, HEATING, DISC, LIMIT, DROP,
 DRIFT, BY_LOAD, PWM_LIMIT, PWM_DECAY, PWM_DROP, PWM_SAG, PWM_HEATING) = range(len(KINDS))  # fmt: skip
FIRST_SWITCHED = PWM_LIMIT


@njit(cache=True)
def simulate(  # type: ignore[no-untyped-def]
    kind, q, gain, tau, friction, asked, coast, kp, lift, quantum, place, angle, clock, pwm_s
):
    """Counts (n), duties (n) and the last angle of a run from rest; ``asked`` (n) are duties, or angles under P control
    of ``kp`` above zero, lifted over friction by ``lift``. A duty acts one tick after the reading that it answers.
    ``pwm_s`` is the period of the pulses.
    """
    switched = kind >= FIRST_SWITCHED
    h = PULSE_STEP_S if switched else STEP_S
    ticks, steps, per_pulse = len(asked), round(TICK_S / h), round(pwm_s / h)
    inertia = tau / gain
    counts, duties = np.zeros(ticks, np.int64), np.zeros(ticks)
    speed = current = bristle = heat = 0.0
    load_angle, load_speed, out = angle, 0.0, angle
    for k in range(ticks):
        seen = angle
        if kind == PLAY:
            seen = out
        elif kind == DISC:
            seen = angle + q[0] * math.sin(math.radians(q[1] * angle) + q[2])
        counts[k] = math.floor(seen / quantum + place)
        duties[k] = asked[k]
        if kp > 0.0:
            error = asked[k] - counts[k] * quantum
            duties[k] = kp * error + (lift if error > quantum else -lift if error < -quantum else 0.0)
            duties[k] = round(min(max(duties[k], -100.0), 100.0), 3)
        for s in range(steps):
            time = k * TICK_S + s * h
            acts = math.floor((time - (q[0] if kind == DELAY else 0.0)) / TICK_S + 1e-9) - 1
            u = duties[acts] if acts >= 0 else 0.0
            loose = acts >= 0 and coast[acts]
            size, side = abs(u), math.copysign(1.0, u)
            if kind == ZONE:
                u = side * max(size - q[0], 0.0)
            elif kind == PULSE:
                u = u if size > q[0] else 0.0
            elif kind == SATURATION:
                u = side * min(size, q[0])
            elif kind == CURVE:
                u = side * 100.0 * (size / 100.0) ** q[0]
            elif kind == BACKWARD:
                u = u * q[0] if u < 0.0 else u
            elif kind == STEPS:
                u = side * math.floor(size / 100.0 * q[0]) / q[0] * 100.0
            elif kind == DRIFT:
                u = u * (1.0 + q[0] * (clock + time))
            push = 0.0 if loose else u - speed / gain
            if kind == LAG:
                current = 0.0 if loose else current + h / q[0] * (push - current)
                push = current
            elif kind == SAG:
                push /= 1.0 + q[0] * (u / 100.0) ** 2
            elif kind == HEATING:
                push /= 1.0 + q[0] * heat
                heat += h / q[1] * ((push / 100.0) ** 2 - heat)
            elif kind == LIMIT:
                push = min(max(push, -q[0]), q[0])
            elif kind == DROP:
                push = math.copysign(max(abs(push) - q[0], 0.0), push)
            elif switched:
                on = min(max(abs(u) / 100.0 * per_pulse - s % per_pulse, 0.0), 1.0)
                current = _switched(kind, q, current, u, loose, on, speed / gain, heat)
                push = current
                if kind == PWM_HEATING:
                    heat += h / q[2] * ((current / 100.0) ** 2 - heat)
            mass = inertia
            if (kind == EVERY and time > q[1]) or (kind == ONCE and clock + time > q[1]):
                mass *= q[0]
            turn = math.radians(angle)
            if kind == DRAG:
                push -= q[0] * speed * abs(speed) / 1e6
            elif kind == LOAD:
                push -= q[0]
            elif kind == GRAVITY:
                push -= q[0] * math.sin(turn + q[1])
            elif kind == COGGING:
                push -= q[0] * (math.sin(q[1] * turn + q[2]) + q[3] * math.sin(2.0 * q[1] * turn + 1.0))
            elif kind == STOP and angle > q[0]:
                push -= q[1] * (angle - q[0]) + q[2] * max(speed, 0.0)
            slides = friction
            if kind == STRIBECK:
                slides += q[0] * math.exp(-((speed / q[1]) ** 2))
            elif kind == ASYMMETRIC:
                slides = q[0] if speed > 0.0 or (speed == 0.0 and push > 0.0) else q[1]
            elif kind == BY_ANGLE:
                slides *= 1.0 + q[0] * math.sin(q[1] * turn + q[2])
            elif kind == COOLS:
                slides *= 1.0 + q[0] * math.exp(-time / q[1])
            elif kind == BY_LOAD:
                slides += q[0] * abs(push)
            holds = slides + (q[0] if kind == STATIC else 0.0)
            if kind in (LUGRE, DAHL):
                level = friction + (q[1] * math.exp(-((speed / q[2]) ** 2)) if kind == LUGRE else 0.0)
                rate = speed - abs(speed) * friction / q[0] * bristle / level
                bristle += h * rate
                speed += h / mass * (push - friction / q[0] * bristle - q[3] * rate)
            elif kind in (GAP, SHAFT):
                twist = angle - load_angle
                strain = twist if kind == SHAFT else math.copysign(max(abs(twist) - 0.5 * q[3], 0.0), twist)
                pull = q[0] * strain + (q[1] * (speed - load_speed) if strain != 0.0 else 0.0)
                load_speed += h / (mass * q[2]) * pull
                speed = _slid(speed, push - pull, slides, holds, h / (mass * (1.0 - q[2])))
                load_angle += h * load_speed
            else:
                speed = _slid(speed, push, slides, holds, h / mass)
            angle += h * speed
            if kind == PLAY:
                out = min(max(out, angle - 0.5 * q[0]), angle + 0.5 * q[0])
    return counts, duties, angle


@njit(cache=True)
def _switched(kind, q, current, duty, loose, on, emf, heat):  # type: ignore[no-untyped-def]
    """The winding's current after one step, in a pulse for a share ``on`` of it; its L/R is the last of ``q``."""
    lag, ohms, lost, source = q[3], 1.0, 0.0, 0.0
    if kind == PWM_HEATING:
        ohms += q[0] * heat
    elif kind == PWM_DROP:
        lost = q[0]
    if loose:
        lost += SUPPLY
    else:
        source = math.copysign(on * SUPPLY, duty)
        if kind == PWM_SAG:
            source -= on * q[0] * current
        elif kind == PWM_DECAY and duty != 0.0:
            lost += (1.0 - on) * SUPPLY
    if current == 0.0:
        push = math.copysign(max(abs(source - emf) - lost, 0.0), source - emf)
        return PULSE_STEP_S / lag * push
    after = current + PULSE_STEP_S / lag * (source - emf - math.copysign(lost, current) - ohms * current)
    if lost > 0.0 and after * current < 0.0:
        return 0.0
    return min(max(after, -q[0]), q[0]) if kind == PWM_LIMIT else after


@njit(cache=True)
def _slid(speed, push, slides, holds, step):  # type: ignore[no-untyped-def]
    """The speed after one step of dry friction."""
    if speed == 0.0:
        return step * (push - math.copysign(slides, push)) if abs(push) > holds else 0.0
    after = speed + step * (push - math.copysign(slides, speed))
    return 0.0 if after * speed < 0.0 else after


@dataclass(frozen=True)
class Kind:
    """How an equation's parameters are drawn for a motor of some gain, lag and friction; the names that are right for
    it, none where nothing is missing, whether the library has this very equation, and what has to be named beside.
    """

    draw: Callable[[random.Random, float, float, float], tuple[float, ...]]
    right: tuple[str, ...] = ()
    exact: bool = True
    beside: tuple[str, ...] = ()


def _spring(r: random.Random, gain: float, tau: float, low_hz: float, high_hz: float) -> tuple[float, float, float]:
    """Stiffness, damping and the load's share of the inertia."""
    share, pulse = r.uniform(0.2, 0.5), 2.0 * math.pi * r.uniform(low_hz, high_hz)
    both = tau / gain * share * (1.0 - share)
    return both * pulse**2, 2.0 * r.uniform(0.03, 0.3) * pulse * both, share


def _unequal(r: random.Random, friction: float) -> tuple[float, float]:
    part = r.choice((-1.0, 1.0)) * r.uniform(0.1, 0.4)
    return friction * (1.0 + part), friction * (1.0 - part)


def _lag(r: random.Random) -> float:
    """L/R of a winding that shows at readings of 5 ms."""
    return r.uniform(0.0015, 0.006)


def _turn(r: random.Random) -> float:
    return r.uniform(0.0, 2.0 * math.pi)


_WINDING = ("armature_inductance",)
_CONSTANT = ("constant_load", "asymmetric_coulomb_friction")
_ANGLE = ("cogging_torque", "gravity_load")
_ZONE = ("input_deadband", "asymmetric_deadband", "pwm_dead_time")
DRAWS: dict[str, Kind] = {
    "nothing": Kind(lambda r, k, t, c: ()),
    "static_friction": Kind(lambda r, k, t, c: (r.uniform(0.5, 2.0),), ("static_friction",)),
    "stribeck_friction": Kind(lambda r, k, t, c: (r.uniform(0.5, 2.0), r.uniform(15.0, 80.0)), ("stribeck_friction",)),
    "lugre": Kind(
        lambda r, k, t, c: (r.uniform(0.3, 1.5), r.uniform(0.3, 1.0), r.uniform(15.0, 60.0), r.uniform(0.002, 0.01)),
        ("presliding_friction", "stribeck_friction"),
        exact=False,
    ),
    "dahl": Kind(lambda r, k, t, c: (r.uniform(0.4, 2.0),), ("presliding_friction",)),
    "quadratic_drag": Kind(lambda r, k, t, c: (r.uniform(2.0, 15.0),), ("quadratic_drag",)),
    "asymmetric_friction": Kind(lambda r, k, t, c: _unequal(r, c), _CONSTANT),
    "constant_load": Kind(lambda r, k, t, c: (r.choice((-1.0, 1.0)) * r.uniform(0.3, 0.9) * c,), _CONSTANT),
    "gravity": Kind(lambda r, k, t, c: (r.uniform(0.5, 4.0), _turn(r)), _ANGLE),
    "cogging_with_overtone": Kind(
        lambda r, k, t, c: (r.uniform(0.5, 2.5), r.choice((4.0, 6.0, 12.0, 15.0)), _turn(r), r.uniform(0.05, 0.3)),
        _ANGLE,
        exact=False,
    ),
    "friction_by_angle": Kind(
        lambda r, k, t, c: (r.uniform(0.2, 0.5), r.choice((1.0, 2.0, 3.0)), _turn(r)), ("position_dependent_friction",)
    ),
    "play": Kind(lambda r, k, t, c: (r.uniform(1.0, 5.0),), ("backlash",)),
    "springy_gap": Kind(
        lambda r, k, t, c: (*_spring(r, k, t, 60.0, 100.0), r.uniform(1.0, 4.0)), ("backlash",), exact=False
    ),
    "springy_shaft": Kind(lambda r, k, t, c: _spring(r, k, t, 6.0, 20.0), ("shaft_compliance",)),
    "springy_stop": Kind(lambda r, k, t, c: (r.uniform(800.0, 2500.0), 50.0, 0.5), ("hard_stop",), exact=False),
    "dead_zone": Kind(lambda r, k, t, c: (r.uniform(2.0, 8.0),), _ZONE),
    "minimum_pulse": Kind(lambda r, k, t, c: (r.uniform(c + 0.5, c + 5.0),), _ZONE, exact=False),
    "delay": Kind(lambda r, k, t, c: (r.uniform(0.002, 0.012),), ("transport_delay",)),
    "inductance": Kind(lambda r, k, t, c: (r.uniform(0.0015, 0.008),), ("armature_inductance",)),
    "supply_sag": Kind(lambda r, k, t, c: (r.uniform(0.05, 0.3),), ("supply_sag",)),
    "saturation": Kind(lambda r, k, t, c: (r.uniform(50.0, 80.0),), ("voltage_saturation",)),
    "duty_curve": Kind(lambda r, k, t, c: (r.choice((r.uniform(0.7, 0.93), r.uniform(1.08, 1.4))),), ("duty_curve",)),
    "weaker_backward": Kind(lambda r, k, t, c: (r.uniform(0.85, 0.97),), ("direction_dependent_gain",)),
    "pwm_steps": Kind(lambda r, k, t, c: (r.choice((16.0, 25.0, 32.0, 50.0)),), ("pwm_resolution",)),
    "change_in_every_log": Kind(lambda r, k, t, c: (r.uniform(1.2, 1.8), r.uniform(7.0, 13.0)), ("parameter_change",)),
    "change_once": Kind(lambda r, k, t, c: (r.uniform(1.2, 1.8), r.uniform(40.0, 120.0)), ("parameter_change",)),
    "friction_falls_with_time": Kind(
        lambda r, k, t, c: (r.uniform(0.2, 0.8), r.uniform(5.0, 20.0)), ("friction_warm_up",)
    ),
    "heating": Kind(lambda r, k, t, c: (r.uniform(0.3, 2.0), r.uniform(5.0, 20.0)), ("armature_heating",)),
    "eccentric_disc": Kind(
        lambda r, k, t, c: (r.uniform(0.3, 1.5), r.choice((1.0, 2.0)), _turn(r)), ("encoder_eccentricity",)
    ),
    "current_limit": Kind(lambda r, k, t, c: (r.uniform(40.0, 80.0),), ("current_limit",)),
    "bridge_drop": Kind(lambda r, k, t, c: (r.uniform(1.0, 5.0),), ("bridge_voltage_drop",)),
    "supply_drift": Kind(lambda r, k, t, c: (r.choice((-1.0, 1.0)) * r.uniform(3e-4, 1.5e-3),), ("supply_drift",)),
    "friction_by_load": Kind(lambda r, k, t, c: (r.uniform(0.05, 0.2),), ("load_dependent_friction",)),
    "pwm_current_limit": Kind(
        lambda r, k, t, c: (r.uniform(40.0, 80.0), 0.0, 0.0, _lag(r)), ("current_limit",), beside=_WINDING
    ),
    "pwm_fast_decay": Kind(lambda r, k, t, c: (0.0, 0.0, 0.0, _lag(r)), ("fast_decay",)),
    "pwm_bridge_drop": Kind(
        lambda r, k, t, c: (r.uniform(1.0, 5.0), 0.0, 0.0, _lag(r)), ("bridge_voltage_drop",), beside=_WINDING
    ),
    "pwm_supply_sag": Kind(
        lambda r, k, t, c: (r.uniform(0.05, 0.3), 0.0, 0.0, _lag(r)), ("supply_sag",), beside=_WINDING
    ),
    "pwm_heating": Kind(
        lambda r, k, t, c: (r.uniform(0.3, 2.0), 0.0, r.uniform(5.0, 20.0), _lag(r)),
        ("armature_heating",),
        beside=_WINDING,
    ),
}


def parameters(values: tuple[float, ...]) -> np.ndarray:
    """What the kernel takes (4)."""
    return np.array([*values, 0.0, 0.0, 0.0, 0.0][:4])
