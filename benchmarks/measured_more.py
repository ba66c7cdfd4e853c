"""Three more motors, their tables read without a map: a bridge that coasts, a direct drive, a torque-driven motor.

The folder holds ``coast_pwm_gearmotor`` (github.com/nebisman/UNDCMotor, commit 0983b07), ``direct_drive_foc``
(github.com/heitor-andrade/laas_anti_cogging, commit eb0391d) and ``bldc_torque`` (github.com/malik-robert/HSM150-data,
commit 35c3b1b).
"""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from measured_page import error_table, halves, save

from fiohost.circle.evidence import diagnose
from fiohost.circle.readings import diagnose_readings
from fiohost.control.closed_loop import Plant
from fiohost.discover.result import to_json
from fiohost.discover.tables.steady import operate
from fiohost.importing.automatic import read_any
from fiohost.importing.found import Answers
from fiohost.motor.model import Model
from fiohost.report import words
from fiohost.report.plots import plot_curve
from fiohost.report.readings import readings_sentence
from fiohost.report.series import CurvePlot

SUPPLY_V = 5.0
EVERY = 7  # so many rows of the static curve lie between two that are fitted
SETTLE_S, AVERAGE_S = 2.0, 1.0
# Of a static speed that is an average: what its repeats may scatter by.
SCATTER_DEG_S = 2.0
STATIC = """\
schema = "fiohost.readings/1"
kind = "steady"
title = "static curve"
[duty]
value = "duty"
unit = "V"
full_scale_V = {supply}
[figures.speed]
unit = "deg/s"
quantum = 0.01
scatter = {scatter}
"""


def sections(train: Sequence[Path], held: Sequence[Path], answers: Answers, model: str) -> dict[str, str]:
    """What a diagnosis says of tables that are read without a map."""
    logs = read_any([*train, *held], answers)
    told = to_json(diagnose(logs[: len(train)], logs[len(train) :], model, say=print))
    beyond = [f"`{one['log']}`: {', '.join(one['beyond'])}" for one in told["extrapolates"]]
    return {
        "verdict": words.verdict_sentence(told),
        "verdict_name": told["verdict"],
        "short": ", ".join(words.effect_words(step["effect"]) for step in told["steps"]) or "nothing",
        "errors": error_table(told),
        "beyond": "; ".join(beyond) or "nothing",
    }


def static(folder: Path) -> dict[str, str]:
    """A static curve diagnosed on every seventh of its rows and foretold for the others, with its picture."""
    volts, speeds = np.loadtxt(folder / "static_gain_response.csv", delimiter=",", skiprows=1).T
    fitted = np.arange(len(volts)) % EVERY == 0
    rows = [f"\n[[row]]\nduty = {u}\nspeed = {y}\n" for u, y in zip(volts[fitted], speeds[fitted], strict=True)]
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "static.toml"
        path.write_text(STATIC.format(supply=SUPPLY_V, scatter=SCATTER_DEG_S) + "".join(rows), encoding="utf-8")
        found = diagnose_readings([path], "linear+coulomb_friction", say=print)

    def foretold(model: Model) -> np.ndarray:
        plant = Plant.of(model)
        duties = 100.0 * volts / SUPPLY_V
        return np.array([operate(plant, float(d), SETTLE_S, AVERAGE_S).speed_deg_s for d in duties])

    before, after = foretold(found.found.declared.fit.model), foretold(found.final.fit.model)
    picture = CurvePlot(
        title="Static curve of a bridge that coasts",
        x_label="voltage (V)",
        y_label="speed (deg/s)",
        x=volts,
        lines={found.final.fit.model.expression: after, found.found.declared.fit.model.expression: before},
        points={
            "measured, fitted": (volts[fitted], speeds[fitted]),
            "measured, held out": (volts[~fitted], speeds[~fitted]),
        },
    )
    save("coast_static", plot_curve(picture))

    def rms(of: np.ndarray) -> str:
        return f"{np.sqrt(np.mean((of - speeds)[~fitted] ** 2)):.2f}"

    return {
        "verdict": readings_sentence(found.to_json()),
        "short": ", ".join(words.effect_words(step.effect) for step in found.found.steps) or "nothing",
        "verdict_name": found.verdict,
        "fitted": f"{np.count_nonzero(fitted)}",
        "held": f"{np.count_nonzero(~fitted)}",
        "before": rms(before),
        "after": rms(after),
        "worst": f"{np.max(np.abs((after - speeds)[~fitted])):.0f}",
    }


def section(folder: Path) -> dict[str, str]:
    """Diagnoses all three and gives the words of the section."""
    coast, torque = folder / "coast_pwm_gearmotor", folder / "bldc_torque"
    parts = {"static": static(coast)}
    speeds = Answers(unit="deg/s", full_scale=SUPPLY_V)
    parts["coast"] = sections([coast / "prbs_open_exp.csv"], [coast / "step_open_exp.csv"], speeds, "linear")
    with tempfile.TemporaryDirectory() as scratch:
        first, second = halves(folder / "direct_drive_foc" / "acceleration.csv", Path(scratch))
        answers = Answers(unit="rad", full_scale=12.0, command="Uq", output="Position")
        parts["direct"] = sections([first], [second], answers, "linear")
    runs = [torque / f"{name}.csv" for name in ("pos_0.06_1", "neg_0.045_1", "pos_0.06_2", "pos_0.065_1")]
    parts["torque"] = sections(runs[:2], runs[2:], Answers(full_scale=0.1), "linear")
    return {f"{name}_{key}": text for name, told in parts.items() for key, text in told.items()}
