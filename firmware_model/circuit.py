"""The winding's circuit in each part of a PWM period, where edges are resolved.

In each part the bridge shows the winding a voltage and a loss against its current: the transistors' drop while it is
driven or shorted, the whole supply as well while it is open and the current runs down through the diodes. A current at
zero stays there until the voltage less the back-emf exceeds the loss.
"""

from __future__ import annotations

import math

from firmware_model.compiled import part
from firmware_model.hooks import ceiling, drop, resistance, voltage
from firmware_model.layout import CURRENT, FLOW, MODE, OMEGA, ON, PHASE, THETA, C

R, L, KE, SUPPLY, FAST, DIODE = int(C.R), int(C.L), int(C.KE), int(C.SUPPLY), int(C.FAST), int(C.DIODE)
STANDBY, DRIVEN = 0, 1
SMALL_A = 1e-6  # a current that has just passed zero in a diode


@part
def sign(x):  # type: ignore[no-untyped-def]
    return 1 if x > 0.0 else (-1 if x < 0.0 else 0)


@part
def circuit(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Voltage in V, resistance in ohm, loss against the current in V and greatest current in A of this part."""
    theta, omega = y[THETA], y[OMEGA]
    most = ceiling(math.inf, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    if m[MODE] == STANDBY:
        return 0.0, p[R], p[SUPPLY], most
    ohms = resistance(p[R], theta, omega, 0.0, 0.0, 0.0, time, y, p, on)
    lost = drop(0.0, theta, omega, 0.0, 0.0, duty, time, y, p, on)
    if m[MODE] != DRIVEN or (m[PHASE] != ON and p[FAST] <= 0.0):
        return 0.0, ohms, lost, most
    way = 1.0 if duty > 0.0 else -1.0
    volts = voltage(way * p[SUPPLY], theta, omega, 0.0, 0.0, duty, time, y, p, on)
    if m[PHASE] != ON:
        return 0.0, ohms, abs(volts) + lost + p[DIODE], most
    # Hooks know the mean over a period. What the source adds to it is borne by the pulses alone.
    mean = resistance(p[R], theta, omega, 0.0, 0.0, duty, time, y, p, on)
    return volts, ohms + (mean - ohms) / (0.01 * abs(duty)), lost, most


@part
def starts(push, lost):  # type: ignore[no-untyped-def]
    """Direction in which a current starts from zero against a loss (0: it does not); any where nothing is lost."""
    if lost <= 0.0:
        return 1
    return sign(push) if abs(push) > lost else 0


@part
def phase_electrical(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Current in A and its rate in A/s."""
    if m[FLOW] == 0:
        return 0.0, 0.0
    volts, ohms, lost, most = circuit(time, y, m, duty, p, on)
    current = min(max(y[CURRENT], -most), most)
    rate = (volts - m[FLOW] * lost - p[KE] * y[OMEGA] - ohms * current) / p[L]
    if (current >= most and rate > 0.0) or (current <= -most and rate < 0.0):
        rate = 0.0
    return current, rate


@part
def settle_phase(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Which way the current may flow from here on."""
    volts, _, lost, _ = circuit(time, y, m, duty, p, on)
    if lost > 0.0 and y[CURRENT] * m[FLOW] < 0.0 and abs(y[CURRENT]) < SMALL_A:
        y[CURRENT] = 0.0
    m[FLOW] = sign(y[CURRENT])
    if m[FLOW] == 0:
        m[FLOW] = starts(volts - p[KE] * y[OMEGA], lost)


@part
def phase_broken(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Whether a current has passed zero in a diode, or starts."""
    if m[FLOW] != 0 and y[CURRENT] * m[FLOW] >= 0.0:
        return False
    volts, _, lost, _ = circuit(time, y, m, duty, p, on)
    if m[FLOW] == 0:
        return starts(volts - p[KE] * y[OMEGA], lost) != 0
    return lost > 0.0
