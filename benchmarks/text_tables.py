"""The printed tables of the control lab appendix as readings files, and the motor that the text simulates.

The figures themselves stay where the data are: a readings file names the table beside it. Constants are those of
``fiohost.labs.constants``.
"""

from __future__ import annotations

import csv
import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fiohost.circle.readings import read_readings
from fiohost.control.metrics import step_figures
from fiohost.discover.tables.responses import Responses
from fiohost.discover.tables.table import Row
from fiohost.labs.constants import TEXT, MotorConstants
from fiohost.labs.play import IDEAL, NO_LIMITS, Limits, PositionLaw, Torque, play_model
from fiohost.labs.session import Gains
from fiohost.motor.model import Model

# The text's simulation is in continuous time; what tick its bench had is not said.
TICK_S = 0.002
SPOOL_M = 0.01375
DEG_PER_CM = math.degrees(0.01 / SPOOL_M)
FULL_V = 4.5
TURN = "[step]\nto = 160\nduration_s = 3.0\n"
# The elevator holds each floor for 2 s: up from 0, then down again.
CM = f'unit = "cm"\ndeg_per_unit = {DEG_PER_CM!r}\nduration_s = 2.0\ntimes_of = "target"\n'
UP = f"[step]\nto = 5\n{CM}"
DOWN = f"[step]\nto = 0\nfrom = 5\nhold_s = 2.0\n{CM}"
TIMES = {"overshoot_pct": ("overshoot_pct", 0.1), "settling_5_s": ("settling_s", 0.01), "rise_s": ("rise_s", 0.01)}
HEIGHTS = {**TIMES, "steady_state_error": ("steady_state_error_cm", 0.01)}


@dataclass(frozen=True)
class Printed:
    """One printed table of responses: which rows of which file, how the loop was set, whose constants are declared.

    ``figures`` are columns and the steps of their printed numbers; ``simulated`` chooses the rows that the text
    simulated, where it did.
    """

    name: str
    label: str
    csv: str
    only: Mapping[str, str]
    motor: str
    step: str
    settings: Mapping[str, str | float]
    figures: Mapping[str, tuple[str, float]] = field(default_factory=lambda: TIMES)
    simulated: Mapping[str, str] | None = None

    def write(self, data: Path, folder: Path, only: Mapping[str, str] | None = None, name: str = "") -> Path:
        """The readings file in a folder, its table beside it."""
        shutil.copy(data / self.csv, folder)
        lines = ['schema = "fiohost.readings/1"', 'kind = "response"', f'table = "{self.csv}"', "[only]"]
        lines += [f'{column} = "{text}"' for column, text in (only or self.only).items()]
        lines += [self.step, "[controller]", 'unit = "V/rad"', f"full_scale_V = {FULL_V}", f"sample_time_s = {TICK_S}"]
        lines += [f'{key} = "{v}"' if isinstance(v, str) else f"{key} = {v}" for key, v in self.settings.items()]
        for figure, (column, quantum) in self.figures.items():
            lines += [f"[figures.{figure}]", f'column = "{column}"', f"quantum = {quantum}"]
        path = folder / f"{name or self.name}.toml"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return path

    def read(self, data: Path, folder: Path, only: Mapping[str, str] | None = None, name: str = "") -> Responses:
        table, _ = read_readings(self.write(data, folder, only, name))
        assert isinstance(table, Responses)
        return table


MEASURED, SIMULATED = {"source": "measured"}, {"source": "simulated"}
LIFT = "table_d12_d13_elevator.csv"
PI = "table_d14_elevator_pi.csv"
POWER = "table_d15_elevator_power.csv"
BY_GAIN: Mapping[str, str | float] = {"kp": "kp"}
BY_INTEGRAL: Mapping[str, str | float] = {"kind": "pi", "kp": 2, "ki": "ki"}
BY_POWER: Mapping[str, str | float] = {"kp": 5, "limit_pct": "power_pct"}
PRINTED = {
    t.name: t
    for t in (
        Printed("d7", "D-7, no load", "table_d7_position_no_load.csv", MEASURED, "no_load", TURN, BY_GAIN,
                simulated=SIMULATED),
        Printed("d9", "D-9, arm", "table_d9_position_arm.csv", MEASURED, "arm_tuned", TURN, BY_GAIN,
                simulated=SIMULATED),
        Printed("d9_half", "D-9, arm, at half voltage", "table_d9_position_arm.csv", MEASURED, "arm_tuned", TURN,
                {"kp": "kp", "limit_pct": 50}, simulated=SIMULATED),
        Printed("d13", "D-12/D-13, elevator up", LIFT, MEASURED, "elevator", UP, BY_GAIN, HEIGHTS, SIMULATED),
        Printed("d14_up", "D-14, PI, up", PI, {"direction": "up"}, "elevator", UP, BY_INTEGRAL, HEIGHTS),
        Printed("d14_down", "D-14, PI, down", PI, {"direction": "down"}, "elevator", DOWN, BY_INTEGRAL, HEIGHTS),
        Printed("d15_up", "D-15, power, up", POWER, {"direction": "up"}, "elevator", UP, BY_POWER, HEIGHTS),
        Printed("d15_down", "D-15, power, down", POWER, {"direction": "down"}, "elevator", DOWN, BY_POWER, HEIGHTS),
    )
}  # fmt: skip


def with_full_power(up: Responses, by_gain: Responses) -> Responses:
    """The table of limited powers with its row at 100 %, which is printed as the last of the gains."""
    row = Row("power_pct 100", by_gain.rows[-1].measured)
    return replace(up, rows=[*up.rows, row], responses=[*up.responses, by_gain.responses[-1]])


def joined(name: str, tables: Sequence[Responses]) -> Responses:
    """Tables of the same figures as one."""
    rows = [Row(f"{t.name}: {row.label}", row.measured) for t in tables for row in t.rows]
    return replace(tables[0], name=name, rows=rows, responses=[r for t in tables for r in t.responses])


def load_Nm(data: Path, motor: str) -> float:
    """What hangs on a motor, positive where it opposes the way up; the text counts it the other way."""
    with (data / "parameters.csv").open(encoding="utf-8") as lines:
        rows = csv.DictReader(line for line in lines if not line.startswith("#"))
        loads = {row["plant"]: -float(row["load_torque_Nm"]) for row in rows}
    return loads[f"nxt_{motor}"]


def declared(data: Path, name: str) -> Model:
    """The text's motor with nothing to be fitted; a load that is none stays out, so that one can be found."""
    motor, load = TEXT[name], load_Nm(data, name)
    model = motor.model()
    if load:
        model = model.with_values({"constant_load.level_pct": motor.torque_pct(load)})
    else:
        model = model.without(["constant_load"])
    return replace(model, fixed=frozenset(model.values))


@dataclass(frozen=True)
class Limit:
    """What a simulation cuts off, by the name that it has on the page."""

    label: str
    limits: Limits


LIMITS = (
    Limit("no limit", NO_LIMITS),
    Limit("4.5 V", Limits(FULL_V, None)),
    Limit("4.5 V and 1 A", Limits(FULL_V, 1.0)),
    Limit("2.25 V and 1 A", Limits(0.5 * FULL_V, 1.0)),
)


def simulate(table: Responses, row: int, motor: MotorConstants, load: float, limits: Limits) -> dict[str, float]:
    """Figures of a row as the text's block diagram gives them: continuous, with its limits on voltage and current.

    The current is the whole one, viscous friction's part in it, which the model that is fitted cannot limit.
    """
    response = table.responses[row]
    gains = Gains(math.degrees(response.loop.kp_pct_per_deg) * FULL_V / 100.0)
    law = PositionLaw(gains.controller(IDEAL, motor.pct_per_volt), np.array([response.to_deg]))
    run = play_model(motor, law, response.duration_s, IDEAL, limits=limits, torque=Torque(-load))
    found = step_figures(run.time_s, run.angle_deg, 0.0, response.to_deg, table.times_of_target)
    return {f.name: float(getattr(found, f.name)) / f.scale for f in table.figures}


def off(table: Responses, figures: Sequence[Mapping[str, float]]) -> float:
    """Rms in floors of what figures, one mapping a row, leave of the readings of a table."""
    left = [
        (row.measured[f.name] - own[f.name]) / f.floor
        for row, own in zip(table.rows, figures, strict=True)
        for f in table.figures
    ]
    return float(np.sqrt(np.mean(np.square(left))))
