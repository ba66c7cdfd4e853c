"""One log of the square wave of a lab, under a turn and mostly at rest: frozen benches that were told wrongly."""

from __future__ import annotations

from collections.abc import Mapping

import pytest

from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.circle.evidence import diagnose
from fiohost.transport.profile import TargetProfile
from fiohost.transport.simulated import SimulatedTransport
from firmware_model import Board
from firmware_model.plants import Plant

CONSTANTS = ("R_ohm", "Kt_Nm_per_A", "Ke_Vs_per_rad", "J_kgm2", "coulomb_Nm")


def square(constants: tuple[float, ...], seed: int, effects: Mapping[str, Mapping[str, float]] | None = None) -> Log:
    """A run of 170 and 190 degrees on a bench of these constants; its shaft stands as the ``seed`` has it."""
    values = dict(zip(CONSTANTS, constants, strict=True))
    plant = Plant(name="case", L_H=0.0, B_Nms=0.0, supply_V=9.0, counts_per_rev=720, effects=effects or {}, **values)
    board = Board(plant, seed=seed)
    with Bench(SimulatedTransport(board.step, "sim:sealed", "simulated"), TargetProfile.load()) as bench:
        return bench.run(Experiment.load("square_170_190"))


@pytest.mark.long
@pytest.mark.parametrize(
    ("constants", "seed", "library"),
    [
        # Rests beside the edges of counts: the true model leaves 0.21 to 0.24 deg where counts leave 0.144.
        (
            (3.824589741000358, 0.435500572102644, 0.6628728377446536, 0.0059532588534815046, 0.03230802769579513),
            738841567,
            ["armature_inductance", "transport_delay", "clock_ripple"],
        ),
        (
            (6.208631637564315, 0.7040301807104026, 0.8013791534200938, 0.012397153581948546, 0.054096627654197156),
            355787345,
            ["backlash", "parameter_change", "gain_warm_up"],
        ),
    ],
)
def test_what_windows_of_a_shaft_at_rest_do_not_show_is_not_claimed(
    constants: tuple[float, ...], seed: int, library: list[str]
) -> None:
    found = diagnose([square(constants, seed)], (), "linear+coulomb_friction", library=library)
    assert not found.steps


@pytest.mark.long
def test_an_effect_that_scores_little_is_asked_too() -> None:
    """A parameter that changes scores more and leads windows on; of whole runs only the truth follows all."""
    constants = (
        5.72070467486677,
        0.36754735771534247,
        0.40350422598996977,
        0.0010825303699230618,
        0.018147381880490206,
    )
    truth = {"stribeck_friction": {"extra_Nm": 0.02217650817087946, "stribeck_speed_rad_s": 1.415558918385329}}
    log = square(constants, 1250304517, truth)
    others = [
        "parameter_change",
        "gain_warm_up",
        "duty_steps",
        "backlash",
        "coast_pwm",
        "constant_load",
        "pwm_resolution",
    ]
    found = diagnose([log], (), "linear+coulomb_friction", library=["stribeck_friction", *others])
    assert [s.effect for s in found.steps] == ["stribeck_friction"]
    assert found.verdict == "explained"


@pytest.mark.long
def test_under_a_turn_a_weight_is_named_with_what_cannot_be_told_from_it() -> None:
    constants = (4.645459334243753, 0.4923884655652564, 0.624174709825372, 0.006216620538681686, 0.014689340550358707)
    log = square(
        constants, 179302362, {"gravity_load": {"torque_Nm": 0.020196535920689707, "phase_rad": 0.23989428094262932}}
    )
    library = ["gravity_load", "cogging_torque", "constant_load", "stribeck_friction", "encoder_eccentricity"]
    found = diagnose([log], (), "linear+coulomb_friction", library=library)
    assert len(found.steps) == 1
    assert "gravity_load" in (found.steps[0].effect, *found.steps[0].indistinguishable_from)
    assert found.verdict == "explained"
