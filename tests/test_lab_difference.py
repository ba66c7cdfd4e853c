"""The end of a lab: its target differs from its model, and the difference is named from the lab's own logs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fiohost.bench.connect import connect
from fiohost.bench.log import Log
from fiohost.labs.constants import TEXT
from fiohost.labs.difference import MOST_LOGS, QUESTION, logs_of, reaches_limit, with_difference
from fiohost.labs.elevator.car import car_model
from fiohost.labs.elevator.experiment import Plan, _run, small_moves
from fiohost.labs.elevator.ride import up_and_down
from fiohost.labs.pi_design import figures_of
from fiohost.labs.printed import MEASURED, printed
from fiohost.labs.result import LabResult
from fiohost.labs.session import Gains, Session, position
from fiohost.labs.small import small_steps, with_small_steps
from firmware_model import load_plant

Q = TEXT["no_load"]


def lab(target: str, folder: Path, gains: tuple[float, ...]) -> LabResult:
    """Short runs of a position loop, as a lab keeps them."""
    with Session.open(target, "no_load", folder, seed=1) as session:
        for kp in gains:
            session.on_target(f"position_kp{kp:g}".replace(".", "p"), position(Gains(kp), 160.0), 2.0)
        return LabResult("position-control", "loop", target, files=dict(session.logs))


def named(target: str, constants: str, folder: Path) -> Mapping[str, Any]:
    """What the end of a lab says, from small steps alone."""
    with Session.open(target, constants, folder, seed=1) as session:
        session.on_target("position_kp5", position(Gains(5.0), 160.0), 1.0)  # its current is cut, the model's is not
        own = LabResult("position-control", "loop", session.target, files=dict(session.logs))
        result, model, limited = with_small_steps(session, own)
    told = with_difference(result, model, limited=limited)
    (answer,) = (a.answer for a in told.answers if a.question == QUESTION)
    return {**told.values["difference"], "answer": answer}


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "constants", "dry_Nm"),
    [("sim:nxt_lego", "no_load", 0.009), ("sim:nxt_lego_arm", "arm_measured", 0.017)],
)
def test_what_the_labs_target_has_beside_its_model_is_named_with_its_size(
    target: str, constants: str, dry_Nm: float, tmp_path: Path
) -> None:
    """Both, and neither for the other: after a step is taken back friction slows the shaft, and a deadband does not."""
    told = named(target, constants, tmp_path)
    assert len(told["logs"]) == MOST_LOGS
    assert all("small" in name for name in told["logs"])
    assert told["verdict"] == "explained"
    assert set(told["effects"]) == {"coulomb_friction", "input_deadband"}
    assert told["sizes"]["coulomb_friction.level_pct"] == pytest.approx(Q.torque_pct(dry_Nm), rel=0.05)
    assert told["sizes"]["input_deadband.level_pct"] == pytest.approx(1.5, rel=0.1)
    assert "cannot tell" not in told["answer"]
    assert "Sizes: " in told["answer"]
    assert "fiohost diagnose" in told["answer"]


def test_small_moves_of_the_elevator_name_what_its_car_has(tmp_path: Path) -> None:
    """The moves of the text ask for up to 2 A, of which the supply gives one; no model of these names explains them."""
    plan, files = Plan(), {}
    with connect("sim:nxt_lego_elevator", seed=1) as bench:
        for number, design in enumerate(small_moves(plan), start=1):
            path = tmp_path / f"elevator_small_{number}.csv"
            _run(bench, plan, design, up_and_down, path)
            files[f"log {number}"] = str(path)
    limited = car_model(current_limit_A=1.0)
    assert not any(reaches_limit(Log.read(name), limited) for name in files.values())
    told = with_difference(LabResult("elevator", "car", "sim", files=files), car_model(), limited=limited).values
    assert told["difference"]["verdict"] == "explained"
    assert set(told["difference"]["effects"]) == {"coulomb_friction", "input_deadband"}


def test_what_is_being_done_is_said_before_each_run(tmp_path: Path) -> None:
    said: list[str] = []
    with Session.open("sim:nxt_lego", "no_load", tmp_path, seed=1, said=said.append) as session:
        small_steps(session, "position")
    assert [text.split(":")[0] for text in said] == [Path(name).stem for name in session.logs.values()]
    assert all("2 s on sim:nxt_lego" in text for text in said)
    assert len(said) == 3


def test_small_logs_go_before_those_of_the_text(tmp_path: Path) -> None:
    names = ["elevator_p_1", "elevator_power_1", "elevator_small_1", "elevator_small_2", "elevator_small_3"]
    for name in names:
        (tmp_path / f"{name}.csv").write_text("row\n" * 10)
    files = {f"log {name}": str(tmp_path / f"{name}.csv") for name in names}
    assert [Path(name).stem for name in logs_of(LabResult("x", "x", "sim", files=files))] == names[2:]
    assert len(logs_of(LabResult("x", "x", "sim", files=dict(list(files.items())[:4])))) == MOST_LOGS


def test_logs_that_a_known_limit_of_the_current_does_not_reach_are_looked_at(tmp_path: Path) -> None:
    """4.2 V ask a standing winding for 1.8 A; small steps ask for half an ampere."""
    limited = Q.model(current_limit_A=1.0)
    with Session.open("sim:nxt_lego", "no_load", tmp_path, seed=1) as session:
        for name, ref_deg in (("a", 160.0), ("b", 40.0), ("c", 160.0), ("d", 45.0), ("e", -50.0)):
            session.on_target(f"position_{name}", position(Gains(1.5), ref_deg), 1.0)
        result = LabResult("position-control", "loop", "sim", files=dict(session.logs))
    assert [Path(name).stem for name in logs_of(result, limited)] == ["position_b", "position_d", "position_e"]
    assert [Path(name).stem for name in logs_of(result)] == ["position_a", "position_c", "position_e"]
    only_cut = replace(result, files={role: name for role, name in result.files.items() if name[-5] in "acd"})
    assert [Path(name).stem for name in logs_of(only_cut, limited)] == ["position_a", "position_c", "position_d"]


@pytest.mark.long
def test_a_target_that_is_the_model_lacks_nothing(tmp_path: Path) -> None:
    result = with_difference(lab("sim:nxt_no_load", tmp_path, (1.5,)), Q.model())
    assert result.values["difference"]["effects"] == []


def test_logs_with_a_hand_on_the_shaft_and_long_ones_are_left_out(tmp_path: Path) -> None:
    names = ["a.csv", "b.csv", "c.csv", "d.csv", "position_disturbed_1.csv", "elevator_ride.csv", "long.csv"]
    for name in names:
        (tmp_path / name).write_text("row\n" * (5000 if name == "long.csv" else 10))
    files = {f"log {name}": str(tmp_path / name) for name in names}
    chosen = logs_of(LabResult("x", "x", "sim", files={**files, "picture": "a.png"}))
    assert [Path(name).name for name in chosen] == ["a.csv", "c.csv", "d.csv"]
    assert len(chosen) == MOST_LOGS
    assert logs_of(LabResult("x", "x", "sim")) == []


@pytest.mark.parametrize("kp", [1.5, 2.5])
def test_the_default_target_does_what_the_text_measured_where_its_model_does_not(kp: float, tmp_path: Path) -> None:
    """Table D-7: 0 and 12.5 % of overshoot; the model gives 3.3 and 11 %, and leaves no error."""
    (row,) = (r for r in printed("nxt_d7") if r.has(kp=kp) and r.source == MEASURED)
    with Session.open("sim:nxt_lego", "no_load", tmp_path, seed=1) as session:
        target = figures_of(session.on_target("loop", position(Gains(kp), 160.0), 3.0), 160.0)
        model = figures_of(session.model(position(Gains(kp), 160.0), 3.0), 160.0)
    assert target.overshoot_pct == pytest.approx(row.overshoot_pct, abs=1.3)
    assert target.rise_s == pytest.approx(row.rise_s, abs=0.03)
    assert abs(model.overshoot_pct - target.overshoot_pct) > 0.5


def test_the_targets_friction_falls_with_the_power_as_in_fig_d22() -> None:
    """About 0.0065 N m s at 10 % of the power, 0.0013 at half, from steady speeds by hand."""
    plant = load_plant("nxt_lego")
    damping = plant.B_Nms + plant.Kt_Nm_per_A * plant.Ke_Vs_per_rad / plant.R_ohm

    def as_viscous(share: float) -> float:
        volts = (share - 0.01 * plant.effects["input_deadband"]["level_pct"]) * plant.supply_V
        speed = (plant.Kt_Nm_per_A * volts / plant.R_ohm - plant.coulomb_Nm) / damping
        return float(plant.B_Nms + plant.coulomb_Nm / speed)

    assert as_viscous(0.1) == pytest.approx(0.0065, abs=0.002)
    assert as_viscous(0.5) == pytest.approx(0.00131, abs=0.0001)
    assert np.all(np.diff([as_viscous(share) for share in (0.1, 0.3, 0.5, 1.0)]) < 0.0)
    assert plant.effects["current_limit"]["limit_A"] == 1.0
