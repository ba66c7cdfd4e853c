"""Step responses of a position loop at several settings: overshoot, rise, settling, steady-state error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.control.closed_loop import Loop, LoopRun, Plant, step_run
from fiohost.control.metrics import step_figures
from fiohost.discover.tables.table import Constant, Figure, Row

# Figure of a file -> its unit; "" is the unit of the step.
RESPONSE_FIGURES = {
    "overshoot_pct": "%",
    "rise_s": "s",
    "peak_s": "s",
    "settling_2_s": "s",
    "settling_5_s": "s",
    "final": "",
    "steady_state_error": "",
}


@dataclass(frozen=True)
class Response:
    """One step of the reference, in degrees, and the loop that follows it."""

    loop: Loop
    to_deg: float
    from_deg: float = 0.0
    hold_s: float = 0.0
    duration_s: float = 3.0

    def run(self, plant: Plant) -> LoopRun:
        return step_run(plant, self.loop, self.to_deg, self.duration_s, from_deg=self.from_deg, hold_s=self.hold_s)


@dataclass(frozen=True)
class Responses:
    """A table of step responses; ``times_of_target`` as in ``step_figures``."""

    name: str
    figures: Sequence[Figure]
    rows: Sequence[Row]
    responses: Sequence[Response]
    constants: Sequence[Constant] = ()
    times_of_target: bool = False

    def predict(self, plant: Plant, row: int, constants: Sequence[float]) -> Mapping[str, float]:
        response = self.responses[row]
        run = response.run(plant)
        if not np.isfinite(run.angle_deg).all():  # a trial that runs away has no figures
            return dict.fromkeys((figure.name for figure in self.figures), float("nan"))
        found = step_figures(run.time_s, run.angle_deg, response.from_deg, response.to_deg, self.times_of_target)
        return {figure.name: float(getattr(found, figure.name)) / figure.scale for figure in self.figures}
