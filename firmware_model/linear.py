"""The linear part of the motor, solved exactly: speed and current under constant torque and voltage.

d omega/dt = a11 omega + a12 i + g1,  di/dt = a21 omega + a22 i + g2. The exponential of this 2 x 2 matrix is summed as
its series to the last bit. For a span that returns (a whole segment of a PWM period) its entries are kept in a row:

    omega' = row[0] omega + row[1] i + row[4] g1 + row[5] g2
    i'     = row[2] omega + row[3] i + row[6] g1 + row[7] g2
    turn   = row[4] omega + row[5] i + row[8] g1 + row[9] g2
"""

from __future__ import annotations

import math

from firmware_model.compiled import part

KEPT = 10
BUILT = 10  # place in a row that says whose numbers it holds
ROW = 12
NEAR, TERMS_NEAR, FAR, TERMS_FAR = 0.02, 8, 0.5, 14  # the first term left out is below 1e-16 of the first one


@part
def flow(omega, current, h, a11, a12, a21, a22, g1, g2):  # type: ignore[no-untyped-def]
    """Speed and current after ``h``, and the angle turned."""
    size = (abs(a11) + abs(a22) + math.sqrt(abs(a12 * a21))) * h
    pieces = 1 if size <= FAR else math.ceil(size / FAR)
    terms = TERMS_NEAR if size <= NEAR else TERMS_FAR
    h /= pieces
    turn = 0.0
    for _ in range(pieces):
        d1 = h * (a11 * omega + a12 * current + g1)
        d2 = h * (a21 * omega + a22 * current + g2)
        turn += h * omega
        for k in range(2, terms + 2):
            omega += d1
            current += d2
            turn += h * d1 / k
            scale = h / k
            d1, d2 = scale * (a11 * d1 + a12 * d2), scale * (a21 * d1 + a22 * d2)
    return omega, current, turn


@part
def keep(row, h, a11, a12, a21, a22):  # type: ignore[no-untyped-def]
    """The entries of the exponential and its integrals over ``h``, into ``row``."""
    row[0], row[2], _ = flow(1.0, 0.0, h, a11, a12, a21, a22, 0.0, 0.0)
    row[1], row[3], _ = flow(0.0, 1.0, h, a11, a12, a21, a22, 0.0, 0.0)
    row[4], row[6], row[8] = flow(0.0, 0.0, h, a11, a12, a21, a22, 1.0, 0.0)
    row[5], row[7], row[9] = flow(0.0, 0.0, h, a11, a12, a21, a22, 0.0, 1.0)


@part
def kept_flow(row, omega, current, g1, g2):  # type: ignore[no-untyped-def]
    """As :func:`flow`, over the span of a row."""
    return (
        row[0] * omega + row[1] * current + row[4] * g1 + row[5] * g2,
        row[2] * omega + row[3] * current + row[6] * g1 + row[7] * g2,
        row[4] * omega + row[5] * current + row[8] * g1 + row[9] * g2,
    )
