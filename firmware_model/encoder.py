"""The encoder's counter: it follows the edges of the disc."""

from __future__ import annotations

import math

from firmware_model.compiled import part
from firmware_model.hooks import measure
from firmware_model.layout import BODIES, COUNT, DIRECTION, EDGES, LOAD_THETA, LOST, THETA, C

AFTER, HALF_GAP, QUANTUM = int(C.AFTER), int(C.HALF_GAP), int(C.QUANTUM)
ANGLE_ZERO, SHARE_LOST = int(C.ANGLE_ZERO), int(C.SHARE_LOST)


@part
def follow(y, m, p):  # type: ignore[no-untyped-def]
    """The far side of a gap that has no mass of its own stays within the play."""
    if m[BODIES] == 1 and p[HALF_GAP] > 0.0:
        y[LOAD_THETA] = min(max(y[LOAD_THETA], y[THETA] - p[HALF_GAP]), y[THETA] + p[HALF_GAP])


@part
def read_encoder(y, r, m, p, on):  # type: ignore[no-untyped-def]
    """Follow the edges since the last look; between two looks the disc has turned one way only.

    ``r[EDGES]`` is the true count of edges so far, ``m[COUNT]`` what the counter made of them.
    """
    angle = y[LOAD_THETA] if p[AFTER] > 0.0 else y[THETA]
    edges = math.floor(measure(angle, p, on) / p[QUANTUM]) - p[ANGLE_ZERO]
    passed = edges - r[EDGES]
    if passed == 0.0:
        return
    r[EDGES] = edges
    if p[SHARE_LOST] > 0.0:
        # Every edge adds its share to the loss; a whole one is not counted.
        r[LOST] += abs(passed) * p[SHARE_LOST]
        missed = min(math.floor(r[LOST]), abs(passed))
        r[LOST] -= missed
        passed -= math.copysign(missed, passed)
        if passed == 0.0:
            return
    m[COUNT] += int(passed)
    m[DIRECTION] = 0 if passed > 0.0 else 1
