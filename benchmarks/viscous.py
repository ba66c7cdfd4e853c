"""Viscous friction as the control lab appendix explains its measurements: larger than measured, or falling with power.

Both are fitted to a table of responses as its constants, beside a model of which nothing else is fitted.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.control.closed_loop import Plant
from fiohost.discover.tables.evidence import Readings
from fiohost.discover.tables.fit import TableFit, fit_tables
from fiohost.discover.tables.responses import Responses
from fiohost.discover.tables.settings import SETTINGS
from fiohost.discover.tables.table import Constant, Figure, Row
from fiohost.discover.tables.worth import Worth, left_out_rms
from fiohost.labs.constants import MotorConstants
from fiohost.motor.model import Model
from fiohost.motor.state import GAIN, TAU

MOST_NMS = 0.05
# Where a fit begins: B over that of the motor, and what a tenth of the power adds to it.
STARTS = ((1.0, 0.0), (2.0, 0.0), (4.0, 0.0), (1.0, 1e-4), (1.0, 5e-4), (2.0, 5e-4))


@dataclass(frozen=True)
class ViscousByRow:
    """A table of responses of a motor whose viscous friction is ``B + extra (1 / power - 1)`` in each row.

    ``powers`` (one a row) are shares of full power. So shaped is the text's own curve of the coefficient over power.
    """

    inner: Responses
    motor: MotorConstants
    powers: Sequence[float]
    constants: Sequence[Constant]

    @property
    def name(self) -> str:
        return self.inner.name

    @property
    def figures(self) -> Sequence[Figure]:
        return self.inner.figures

    @property
    def rows(self) -> Sequence[Row]:
        return self.inner.rows

    def predict(self, plant: Plant, row: int, constants: Sequence[float]) -> Mapping[str, float]:
        B, extra = constants
        motor = replace(self.motor, B_Nms=B + extra * (1.0 / self.powers[row] - 1.0))
        p = plant.p.copy()
        p[GAIN] = math.degrees(motor.speed_per_volt) / motor.pct_per_volt
        p[TAU] = motor.tau_m_s
        return self.inner.predict(plant.at(p), row, ())


def powers(table: Responses, model: Model) -> list[float]:
    """The mean power of each row on its way to 90 % of the step, as a share of full power, by a model."""
    found = []
    plant = Plant.of(model)
    for response in table.responses:
        run = response.run(plant)
        way = (run.angle_deg - response.from_deg) / (response.to_deg - response.from_deg)
        moving = max(int(np.argmax(way >= 0.9)), 1)
        found.append(float(np.mean(np.abs(run.duty_pct[:moving]))) / 100.0)
    return found


def fitted_viscous(table: Responses, model: Model, motor: MotorConstants, falling: bool) -> Worth:
    """Fit the coefficient to a table: one for all rows, or ``falling`` with their power.

    What it is worth holds a fit whose constants are B and extra, in N m s.
    """
    own = powers(table, model)

    def seen(B: float, extra: float) -> Readings:
        constants = (
            Constant("B_Nms", "N m s", B, 0.0, MOST_NMS, True),
            Constant("extra_Nms", "N m s", extra, 0.0, MOST_NMS, falling),
        )
        return Readings([ViscousByRow(table, motor, own, constants)])

    tried: list[tuple[Readings, TableFit]] = []
    for times, extra in STARTS:
        if falling or not extra:
            evidence = seen(times * motor.B_Nms, extra)
            tried.append((evidence, fit_tables(evidence.rows, model, derive=False)))
    evidence, best = min(tried, key=lambda pair: pair[1].cost)
    best = fit_tables(evidence.rows, model, constants=best.constants, looks=SETTINGS.looks)
    name = "viscous friction falling with power" if falling else "viscous friction"
    return Worth(name, best, best.rms, left_out_rms(evidence, best))
