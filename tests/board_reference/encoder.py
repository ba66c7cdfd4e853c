"""The reference's encoder: the angle that the disc shows and the counter's edges, one by one."""

from __future__ import annotations

import math

import numpy as np

from firmware_model.plants import Plant


def drawn(number: int, seed: int) -> float:
    """The effect's even draw from -1 to 1: three rounds of a multiplicative generator, high bits folded on low ones."""
    prime = 2**31 - 1
    x = 7919 * number + 104729 * seed + 12345
    for _ in range(3):
        x = 48271 * (x % prime) % prime
        x ^= x >> 13
    return 2.0 * (x % prime) / prime - 1.0


class Encoder:
    """Counts edges of a disc that turns one way between two calls of :meth:`follow`."""

    def __init__(self, plant: Plant, angle: float) -> None:
        effects = plant.effects
        self.disc = effects.get("encoder_eccentricity", {})
        self.shaft = effects.get("shaft_angle_error", {})
        self.share = float(effects.get("missed_counts", {}).get("ratio", 0.0))
        self.quantum = 2.0 * math.pi / plant.counts_per_rev
        edges = np.arange(plant.counts_per_rev, dtype=float)
        if "slot_errors" in effects:
            q = effects["slot_errors"]
            for n in range(plant.counts_per_rev):
                edges[n] += q["slot_counts"] * drawn(n // 4, int(q["seed"]))
                edges[n] += q["phase_counts"] * drawn(1000000 + n % 4, int(q["seed"]))
        self.edges = edges
        self.edge = self.passed(angle)
        self.count = 0
        self.lost = 0.0

    def shown(self, angle: float) -> float:
        """What a disc off its centre shows of an angle, rad; its slots as if they were even."""
        shown = angle
        if self.disc:
            shown += self.disc["level_rad"] * math.sin(self.disc["order"] * angle + self.disc["phase_rad"])
        if self.shaft:
            at = shown if self.disc else angle
            shown += sum(
                self.shaft[f"level_{n}_rad"] * math.sin(n * at + self.shaft[f"phase_{n}_rad"]) for n in (1, 2, 3)
            )
        return shown

    def passed(self, angle: float) -> int:
        """The last edge passed; edge 0 of turn 0 is number 0."""
        place = self.shown(angle) / self.quantum
        counts = len(self.edges)
        turn = math.floor(place / counts)
        within = place - turn * counts
        if within < self.edges[0]:
            return turn * counts - 1  # the turn's first edge comes late
        if within >= self.edges[0] + counts:
            return (turn + 1) * counts  # the next turn's first edge comes early
        return turn * counts + int(np.searchsorted(self.edges, within, side="right")) - 1

    def follow(self, angle: float) -> None:
        """Every edge adds its share to what is lost; a whole one is not counted."""
        edge = self.passed(angle)
        way = 1 if edge > self.edge else -1
        while self.edge != edge:
            self.edge += way
            self.lost += self.share
            if self.lost >= 1.0:
                self.lost -= 1.0
            else:
                self.count += way
