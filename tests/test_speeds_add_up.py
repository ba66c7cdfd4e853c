"""Speeds add up to where the shaft is on its turn: what belongs to a place there is named from them too."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_data import suite, truth_model
from test_own_zero import ANGLE_BOUND, OTHERS, STALL_NM, logs_with_zeros_of_their_own, told_of

from fiohost.bench.log import Log
from fiohost.checks.informative import inform
from fiohost.circle.evidence import diagnose
from fiohost.discover.logs.folds import slices
from fiohost.discover.logs.offered import candidates, span_of
from fiohost.estimation.record import MEAN_SPEED, SPEED, Record, thinned


def of_speeds(log: Log) -> Log:
    """The log of a bench that writes down the mean speed of each tick alone."""
    angle, step_s = 0.5 * np.unwrap(log.columns["pos"], period=720.0), log.sample_time_s
    columns = {name: values for name, values in log.columns.items() if name != "pos"}
    columns["speed_deg_s"] = np.diff(angle, prepend=angle[0]) / step_s
    said = {"output_average": "previous_interval", "output_quantum": f"{0.5 / step_s}"}
    return Log.from_columns(columns, {**log.metadata, **said}, path=log.path)


def speeds_of(record: Record, kind: int = MEAN_SPEED) -> Record:
    """The record as a bench has it that knows speeds alone."""
    times = record.excitation.times_s
    y = np.gradient(record.y, times) if kind == SPEED else np.diff(record.y, prepend=record.y[0]) / 0.005
    return replace(record, y=y, kind=kind, unit="deg/s", quantum=record.quantum / 0.005, weights=np.ones(len(y)))


@pytest.fixture(scope="module")
def turned() -> Record:
    return suite(truth_model(), 3)[0]


def test_speeds_add_up_to_the_angle_in_every_part_of_a_log(turned: Record) -> None:
    since = turned.y - turned.y[0]
    speeds = speeds_of(turned)
    np.testing.assert_allclose(speeds.angles(), since, atol=1e-6)
    np.testing.assert_allclose(thinned(speeds, 0.02).angles(), since[::4], atol=1e-6)
    np.testing.assert_allclose(speeds_of(turned, SPEED).angles(), since, atol=2.0 * turned.quantum)
    pieces, edge = slices(speeds, 3), 0
    for piece in pieces:
        np.testing.assert_allclose(piece.angles(), since[edge : edge + len(piece)], atol=1e-6)
        edge += len(piece)
    assert turned.angles() is turned.y


def test_of_speeds_only_what_acts_at_a_place_is_tried_and_nothing_behind_a_gap(turned: Record) -> None:
    speeds = speeds_of(turned)
    tried = {e.name for e in candidates(truth_model(), [speeds], ANGLE_BOUND, span_of([speeds]))}
    assert tried == {"gravity_load", "cogging_torque", "position_dependent_friction"}
    assert candidates(truth_model(), [replace(speeds, rotary=False)], ANGLE_BOUND, span_of([speeds])) == []
    known = inform([speeds], [])
    assert known.exercised.turns == pytest.approx(float(np.ptp(turned.y)) / 360.0)
    hidden = {name for limit in known.limits if not (limit.apart or limit.hardly) for name in limit.effects}
    assert "encoder_eccentricity" in hidden
    assert "gravity_load" not in hidden
    broken = replace(speeds, segments=np.repeat([0, 1], [1000, len(speeds) - 1000]))
    reasons = {name: limit.why for limit in inform([broken], []).limits if not limit.apart for name in limit.effects}
    for name in ("gravity_load", "friction_over_position"):
        assert "where on its turn the shaft went on is not known" in reasons[name]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "physical", "key", "size"),
    [
        ("gravity_load", {"torque_Nm": 0.02, "phase_rad": 1.0}, "level_pct", 100 * 0.02 / STALL_NM),
        ("cogging_torque", {"torque_Nm": 0.03, "order": 4.0, "phase_rad": 1.0}, "level_pct", 100 * 0.03 / STALL_NM),
        ("none", {}, "", 0.0),
    ],
)
def test_what_is_bound_to_the_angle_is_named_from_speeds(
    tmp_path: Path, name: str, physical: dict[str, Any], key: str, size: float
) -> None:
    effects = {name: physical} if physical else {}
    logs, begun = logs_with_zeros_of_their_own(tmp_path, effects, 5)
    logs = [of_speeds(log) for log in logs]
    found = diagnose(logs[:3], logs[3:], "linear+coulomb_friction", library=(*ANGLE_BOUND, *OTHERS))
    told, values = told_of(found)
    assert [s["effect"] for s in told["steps"]] == list(effects)
    assert told["verdict"] == ("explained" if effects else "no_missing_effect")
    if effects:
        assert values[f"{name}.{key}"] == pytest.approx(size, rel=0.05)
        assert told["after"]["holdout"]["window_rms"] < 1.2 * told["floor"]["holdout"]["window_rms"]
        period = 360.0 / physical.get("order", 1.0)
        zeros = [log["initial"]["zero"] for log in told["logs"]]
        assert zeros[0] is None
        pairs = zip(zeros[1:], begun[1:], strict=True)
        off = [(z - (b - begun[0]) + 0.5 * period) % period - 0.5 * period for z, b in pairs]
        assert max(abs(x) for x in off) * 360.0 / period < 30.0, off
