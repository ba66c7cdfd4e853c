"""The disc's slots and the two channels are never quite even: every edge comes a little early or late, each turn alike.

Edge n of a turn (n = 0 .. counts - 1) lies at n + e(n) counts. e(n) is the sum of what the slot has (the four edges of
one period, cut off their place) and of what the phase has (rise and fall of both channels, in every slot alike). Each
part is drawn evenly from plus or minus its size, by the seed. The sizes leave the edges in their order.
"""

import math

from firmware_model.effect import Effect, Parameter
from firmware_model.layout import C

QUANTUM = int(C.QUANTUM)
PHASES = 4
PRIME = 2147483647


def measure(angle, p, k):  # type: ignore[no-untyped-def]
    counts = round(2.0 * math.pi / p[QUANTUM])
    place = angle / p[QUANTUM]
    passed = math.floor(place) - 1
    begin = end = 0.0
    for edge in range(passed, passed + 4):  # one of these is the last edge passed
        at = float(edge)
        n = edge % counts
        for kind in range(2):
            x = (n // PHASES if kind == 0 else 1000000 + n % PHASES) * 7919 + int(p[k + 2]) * 104729 + 12345
            for _ in range(3):  # a multiplicative generator, its low and high bits mixed between the rounds
                x = (x % PRIME) * 48271 % PRIME
                x = x ^ (x >> 13)
            at += p[k + kind] * (2.0 * (x % PRIME) / PRIME - 1.0)
        if at > place:
            end = at
            break
        passed, begin = edge, at
    share = (place - begin) / (end - begin)
    return (passed + min(max(share, 1e-6), 1.0 - 1e-6)) * p[QUANTUM]


EFFECT = Effect(
    name="slot_errors",
    summary="every edge of the encoder's disc a little off, the same each turn",
    equation="edge n at n + slot r(n div 4) + phase r(n mod 4) counts, r even in -1..1",
    parameters=(
        Parameter("slot_counts", default=0.1, lower=0.0, upper=0.24),
        Parameter("phase_counts", default=0.1, lower=0.0, upper=0.24),
        Parameter("seed", default=0.0, lower=0.0, upper=1e6),
    ),
    source="Slot and phase errors of incremental encoders: makers give them in electrical degrees of one period",
    reduced=lambda plant, q: {"slot_counts": q["slot_counts"], "phase_counts": q["phase_counts"]},
    stage=90,  # after every other error of the disc, as it works on the edges themselves
    measure=measure,
)
