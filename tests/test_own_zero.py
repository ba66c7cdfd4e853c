"""Logs whose zero of POS is their own (``pos_reset: true``): what is bound to the angle is found all the same."""

from __future__ import annotations

import random
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from short_runs import multisine, plant_file, random_steps, staircase

from fiohost.bench.connect import connect
from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.circle.replay import replay
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.result import to_json
from fiohost.estimation.initial import find_zero
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import make_record, record_from_log
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

ANGLE_BOUND = ("gravity_load", "cogging_torque", "position_dependent_friction", "encoder_eccentricity")
OTHERS = ("constant_load", "backlash", "transport_delay")
STALL_NM = 0.34 * 9.0 / 5.5


def logs_with_zeros_of_their_own(folder: Path, effects: dict[str, Any], seed: int) -> tuple[list[Log], list[float]]:
    """Five logs of one board, each begun where the shaft happened to stand, which POS then calls zero; and where."""
    drawn, logs, begun = random.Random(seed), [], []
    experiments = [multisine(8.0, seed), random_steps(8.0, seed), staircase(0.8), multisine(8.0, 50 + seed)]
    with connect(f"sim:{plant_file(folder, effects=effects)}", seed=seed) as bench:
        for i, experiment in enumerate([*experiments, random_steps(8.0, 50 + seed)]):
            bench.run(random_steps(drawn.uniform(1.0, 3.0), drawn.randrange(1000)), folder / f"turn{i}.csv")
            log = bench.run(experiment, folder / f"run{i}.csv")
            first = float(log.columns["pos"][0])
            columns = {name: values for name, values in log.columns.items() if name != "angle_deg"}
            columns["pos"] = (columns["pos"] - first) % 720
            logs.append(Log.from_columns(columns, {**log.metadata, "pos_reset": "true"}, path=f"run{i}.csv"))
            begun.append(0.5 * first)
    return logs, begun


def told_of(found: Diagnosis) -> tuple[dict[str, Any], dict[str, Any]]:
    told = to_json(found)
    return told, {key: p["value"] for key, p in told["final"]["parameters"].items()}


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "physical", "key", "size"),
    [
        ("gravity_load", {"torque_Nm": 0.02, "phase_rad": 1.0}, "level_pct", 100 * 0.02 / STALL_NM),
        ("cogging_torque", {"torque_Nm": 0.02, "order": 4.0, "phase_rad": 1.0}, "level_pct", 100 * 0.02 / STALL_NM),
        ("encoder_eccentricity", {"level_rad": 0.02, "order": 2.0, "phase_rad": 1.0}, "level_deg", 1.146),
        ("position_dependent_friction", {"ratio": 0.5, "order": 2.0, "phase_rad": 1.0}, "ratio", 0.5),
    ],
)
def test_what_is_bound_to_the_angle_is_named_with_its_size(
    tmp_path: Path, name: str, physical: dict[str, Any], key: str, size: float
) -> None:
    logs, begun = logs_with_zeros_of_their_own(tmp_path, {name: physical}, 5)
    found = diagnose(logs[:3], logs[3:], "linear+coulomb_friction", library=(*ANGLE_BOUND, *OTHERS))
    told, values = told_of(found)
    assert [s["effect"] for s in told["steps"]] == [name]
    assert values[f"{name}.{key}"] == pytest.approx(size, rel=0.02)
    assert told["after"]["holdout"]["free_run_rms"] < 1.2 * told["floor"]["holdout"]["free_run_rms"]
    # The first log's zero is the bench's; the others', held-out ones too, are found within a degree of the phase.
    period = 360.0 / physical.get("order", 1.0)
    zeros = [log["initial"]["zero"] for log in told["logs"]]
    assert zeros[0] is None
    off = [
        (z - (b - begun[0]) + 0.5 * period) % period - 0.5 * period for z, b in zip(zeros[1:], begun[1:], strict=True)
    ]
    assert max(abs(x) for x in off) * 360.0 / period < 8.0, off
    if name == "gravity_load":
        held = replay(logs[4], found.final.fit.model)
        assert held.errors.free_run_rms < 1.2 * told["floor"]["holdout"]["free_run_rms"]


@pytest.mark.parametrize("seed", [1, 2])
def test_without_such_an_effect_nothing_is_claimed(tmp_path: Path, seed: int) -> None:
    logs, _ = logs_with_zeros_of_their_own(tmp_path, {}, seed)
    told, _ = told_of(diagnose(logs[:3], logs[3:], "linear+coulomb_friction"))
    assert told["verdict"] == "no_missing_effect"
    assert told["steps"] == []


def test_a_log_says_whether_its_zero_is_its_own_and_one_of_speeds_never_knows(tmp_path: Path) -> None:
    (log, *_), _ = logs_with_zeros_of_their_own(tmp_path, {}, 1)
    assert record_from_log(log).own_zero
    common = Log.from_columns(log.columns, {**log.metadata, "pos_reset": "false"})
    assert not record_from_log(common).own_zero
    for name, knows in (("speed_deg_s", False), ("speed_m_s", True)):  # a linear axis has no turn
        columns = {"time_s": log.time_s, "duty_pct": log.duty_pct, name: 0.0 * log.time_s}
        assert record_from_log(Log.from_columns(columns, {"pos_reset": "false"})).own_zero is not knows


@pytest.mark.parametrize("seed", range(6))
def test_the_zero_is_seen_though_in_some_windows_a_weight_is_lifted_that_the_model_leaves_hanging(seed: int) -> None:
    """A weight on a fast motor under small commands: whether it goes over the top hangs on the last digits of a
    model, and a window in which it does is whole turns off.
    """
    truth = Model.parse("linear+coulomb_friction+gravity_load+armature_inductance").with_values({
        "linear.gain_deg_s_per_pct": 210.0, "linear.tau_s": 0.15, "coulomb_friction.level_pct": 5.6,
        "gravity_load.level_pct": 10.0, "gravity_load.phase_deg": 40.0, "armature_inductance.time_constant_s": 5e-4,
    })  # fmt: skip
    rng = np.random.default_rng(seed)
    duty = np.repeat(rng.uniform(-35.0, 35.0, 24), 100)
    bare = make_record("run", 0.005 * np.arange(len(duty)), duty, np.zeros(len(duty)), quantum=360.0 / 4096.0)
    angle = free_output(bare, Flat.of(truth), Start(-55.0, 0.0, 0.0))
    counts = np.floor((angle + 55.0) * 4096.0 / 360.0 + rng.normal(0.0, 1.0, len(angle)))
    record = replace(bare, y=counts * 360.0 / 4096.0, own_zero=True)
    found = find_zero(record, Flat.of(truth.without(["armature_inductance"])))
    assert abs((found + 55.0 + 180.0) % 360.0 - 180.0) < 2.0
