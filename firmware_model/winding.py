"""The winding's own events: a current that ends in a diode, starts against a voltage drop, or ceases in each pulse."""

from __future__ import annotations

from firmware_model.circuit import DRIVEN, STANDBY, phase_broken, settle_phase, sign
from firmware_model.compiled import part
from firmware_model.hooks import drop
from firmware_model.layout import CURRENT, FLOW, MEAN, MODE, OMEGA, PHASE, THETA, C
from firmware_model.physics import CEASING, fast_circuit, is_clipped, pressure, pulses

L, FAST, PERIOD, SUPPLY = int(C.L), int(C.FAST), int(C.PERIOD), int(C.SUPPLY)
SMALL_A = 1e-12
PASSED_A, PASSED_S = 1e-6, 1e-10  # a current that has just passed zero in a diode, so long ago at the most


@part
def passed_A(p):  # type: ignore[no-untyped-def]
    """How large a current may be that has just passed zero: a fast winding's is, after the shortest time."""
    return max(PASSED_A, PASSED_S * p[SUPPLY] / p[L])


@part
def blocked(time, y, duty, p, on):  # type: ignore[no-untyped-def]
    """Direction in which the driven current starts from zero against the voltage drop (0: it does not)."""
    push = pressure(time, y, duty, p, on)
    lost = drop(0.0, y[THETA], y[OMEGA], 0.0, 0.0, duty, time, y, p, on)
    if lost <= 0.0:
        return 1
    return sign(push) if abs(push) > lost else 0


@part
def switched(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Whether a current under fast decay has left its regime: against the duty, continuous, ceasing in each pulse."""
    way, supply, emf, ohms, lost, most = fast_circuit(time, y, m, duty, p, on)
    current = way * y[CURRENT]
    if m[FLOW] != CEASING:
        if m[FLOW] * way < 0.0:
            return current > 0.0
        if current * p[L] > 0.01 * abs(duty) * p[PERIOD] * max(supply - lost - emf, 0.0):
            return False  # more than one pulse alone can give
    mean, ceases = pulses(duty, p, supply, emf, ohms, lost, most)
    if m[FLOW] == CEASING:
        return not ceases or emf > supply + lost
    return ceases and (current < mean or is_clipped(duty, p, supply, emf, ohms, lost, most))


@part
def settle_fast(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Regime of the current under fast decay."""
    way, supply, emf, ohms, lost, most = fast_circuit(time, y, m, duty, p, on)
    mean, ceases = pulses(duty, p, supply, emf, ohms, lost, most)
    current = way * y[CURRENT]
    if current < -SMALL_A or (current <= SMALL_A and emf > supply + lost):
        m[FLOW] = -int(way)
    elif ceases and (current <= mean + SMALL_A or is_clipped(duty, p, supply, emf, ohms, lost, most)):
        m[FLOW] = CEASING
        y[CURRENT] = way * mean
    else:
        m[FLOW] = int(way)
        y[CURRENT] = way * max(current, 0.0)


@part
def settle_flow(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Which way the current may flow from here on."""
    if m[PHASE] != MEAN:
        settle_phase(time, y, m, duty, p, on)
        return
    if p[FAST] > 0.0 and m[MODE] == DRIVEN:
        settle_fast(time, y, m, duty, p, on)
        return
    if p[L] <= 0.0:
        m[FLOW] = 1
        return
    if m[FLOW] != 0 and y[CURRENT] * m[FLOW] <= 0.0:
        lost = drop(0.0, y[THETA], y[OMEGA], 0.0, 0.0, duty, time, y, p, on)
        if (m[MODE] == STANDBY or lost > 0.0) and y[CURRENT] * m[FLOW] < 0.0 and abs(y[CURRENT]) < passed_A(p):
            y[CURRENT] = 0.0
    if m[MODE] == STANDBY or y[CURRENT] != 0.0:
        m[FLOW] = sign(y[CURRENT])
    else:
        m[FLOW] = blocked(time, y, duty, p, on)


@part
def current_broken(time, y, m, duty, p, on):  # type: ignore[no-untyped-def]
    """Whether the winding's current has gone beyond an event."""
    if m[PHASE] != MEAN:
        return phase_broken(time, y, m, duty, p, on)
    if p[FAST] > 0.0 and m[MODE] == DRIVEN:
        return switched(time, y, m, duty, p, on)
    if p[L] <= 0.0:
        return False
    if m[FLOW] == 0:
        return m[MODE] != STANDBY and blocked(time, y, duty, p, on) != 0
    if y[CURRENT] * m[FLOW] >= 0.0:
        return False
    return m[MODE] == STANDBY or drop(0.0, y[THETA], y[OMEGA], 0.0, 0.0, duty, time, y, p, on) > 0.0
