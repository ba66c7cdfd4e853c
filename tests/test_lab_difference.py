"""The end of a lab: its target differs from its model, and the difference is named from the lab's own logs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fiohost.labs.constants import TEXT
from fiohost.labs.difference import MOST_LOGS, QUESTION, logs_of, with_difference
from fiohost.labs.pi_design import figures_of
from fiohost.labs.printed import MEASURED, printed
from fiohost.labs.result import LabResult
from fiohost.labs.session import Gains, Session, position
from firmware_model import load_plant

Q = TEXT["no_load"]


def lab(target: str, folder: Path, gains: tuple[float, ...]) -> LabResult:
    """Short runs of a position loop, as a lab keeps them."""
    with Session.open(target, "no_load", folder, seed=1) as session:
        for kp in gains:
            session.on_target(f"position_kp{kp:g}".replace(".", "p"), position(Gains(kp), 160.0), 2.0)
        return LabResult("position-control", "loop", target, files=dict(session.logs))


def test_what_the_labs_target_has_beside_its_model_is_seen_and_nothing_else_is_named(tmp_path: Path) -> None:
    result = with_difference(lab("sim:nxt_lego", tmp_path, (1.5, 5.0)), Q.model())
    found = result.values["difference"]
    assert found["verdict"] != "no_missing_effect"
    assert set(found["effects"]) <= {"coulomb_friction", "input_deadband"}
    (answer,) = (a.answer for a in result.answers if a.question == QUESTION)
    assert "friction" in answer
    assert "fiohost diagnose" in answer


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
