"""The motor behind the bridge, as the board sees it."""

from __future__ import annotations

import math

from firmware_model.plants import Plant


class Motor:
    """Linear placeholder."""

    def __init__(self, plant: Plant, *, within_count: float = 0.5, within_gap: float = 0.5) -> None:
        self._plant = plant
        self._theta = within_count * 360.0 / plant.counts_per_rev
        self._omega = 0.0
        self.count = 0
        self.direction = 0

    def run(self, mode: int, duty_pct: float, span_s: float) -> None:
        tau = self._plant.tau_s if mode else 1e9
        steady = self._plant.gain_deg_s_per_pct * duty_pct
        decay = math.exp(-span_s / tau)
        self._theta += steady * span_s + (self._omega - steady) * tau * (1.0 - decay)
        self._omega = steady + (self._omega - steady) * decay
        count = math.floor(self._theta * self._plant.counts_per_rev / 360.0)
        if count != self.count:
            self.direction = int(count < self.count)
        self.count = count
