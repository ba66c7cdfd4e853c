"""The bridge's thermal shutdown: its losses warm it, above a temperature it opens, cooled down it works again.

One thermal mass: time_constant dT/dt = thermal P - (T - ambient), P = bridge_ohm i^2 with the winding's mean current.
The losses are taken as constant over a task step, for which the solution is exact.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from firmware_model.effect import Parameter

# 1 ohm: 0.40 V lost at 0.40 A (LB1836M). 156 K/W: 0.8 W allowed from 25 to 150 degrees, usual for its package. The
# temperatures are those of the maker's other bridges, which have 150 to 180 degrees and a hysteresis of 40 K; the time
# constant is that of a small package with its copper. All four are assumed, none is measured.
PARAMETERS = (
    Parameter("bridge_ohm", default=1.0, lower=0.0, upper=100.0),
    Parameter("thermal_K_per_W", default=156.0, lower=0.0, upper=1e4),
    Parameter("time_constant_s", default=10.0, lower=0.01, upper=1e4),
    Parameter("ambient_C", default=25.0, lower=-60.0, upper=150.0),
    Parameter("opens_C", default=170.0, lower=-50.0, upper=500.0),
    Parameter("hysteresis_K", default=40.0, lower=0.1, upper=500.0),
)


class ThermalShutdown:
    """Temperature of one bridge, and whether it has opened (``open``)."""

    def __init__(self, values: Mapping[str, Any]) -> None:
        self._values = values
        self.temperature_C: float = values["ambient_C"]
        self.open = False

    def pass_time(self, current_A: float, span_s: float) -> None:
        """Warm or cool for ``span_s`` with this current, then decide."""
        v = self._values
        final_C = v["ambient_C"] + v["thermal_K_per_W"] * v["bridge_ohm"] * current_A**2
        self.temperature_C = final_C + (self.temperature_C - final_C) * math.exp(-span_s / v["time_constant_s"])
        if self.temperature_C > v["opens_C"]:
            self.open = True
        elif self.temperature_C < v["opens_C"] - v["hysteresis_K"]:
            self.open = False
