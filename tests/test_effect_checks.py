"""Every effect of the library passes the checks that one's own must pass; what a parameter is follows from its data."""

from __future__ import annotations

import pytest
from click.testing import CliRunner

from fiohost.cli.main import cli
from fiohost.motor.check import check_effect
from fiohost.motor.effect import HOOKS, Kind, effect, effects


@pytest.mark.parametrize("name", effects())
def test_an_effect_keeps_its_bounds_vanishes_is_smooth_settles_and_makes_no_energy(name: str) -> None:
    wrong = [check for check in check_effect(name) if not check.passed]
    assert not wrong, wrong


def test_the_check_prints_each_figure_and_refuses_names_that_are_not_known() -> None:
    told = CliRunner().invoke(cli, ["effects", "check", "constant_load", "duty_curve"])
    assert told.exit_code == 0, told.output
    assert told.stdout.count("passed") == 10
    assert "faster at the end; it may, as it brings energy of its own" in told.stdout
    assert CliRunner().invoke(cli, ["effects", "check"]).exit_code == 2
    unknown = CliRunner().invoke(cli, ["effects", "check", "duty_curv"])
    assert unknown.exit_code == 1
    assert "'duty_curve'" in unknown.stderr


def test_kinds_say_how_a_parameter_is_found() -> None:
    kinds = {
        "gravity_load.level_pct": Kind.SIZE,
        "gravity_load.phase_deg": Kind.PHASE,
        "cogging_torque.order": Kind.ORDER,
        "stribeck_friction.stribeck_speed_deg_s": Kind.SHAPE,
        "stribeck_friction.shape": Kind.CHOICE,
        "static_friction.extra_pct": Kind.THRESHOLD,
        "duty_steps.step_pct": Kind.THRESHOLD,
        "parameter_change.time_s": Kind.EVENT,
        "hard_stop.angle_deg": Kind.EVENT,
        "load_over_position.from_deg": Kind.PLACE,
        "load_over_position.point_3_pct": Kind.SIZE,
    }
    for key, kind in kinds.items():
        name, _, parameter = key.partition(".")
        assert effect(name).parameter(parameter).kind is kind, key
    for item in effects().values():
        for p in item.parameters:
            assert p.kind is not Kind.SIZE or p.neutral is not None, f"{item.name}.{p.name}"
            assert p.is_smooth == (p.kind not in (Kind.CHOICE, Kind.ORDER, Kind.PLACE)), f"{item.name}.{p.name}"


def test_every_hook_takes_what_its_kind_takes() -> None:
    for item in effects().values():
        for kind, wanted in HOOKS.items():
            hook = getattr(item, kind)
            assert hook is None or hook.__code__.co_argcount == len(wanted), f"{item.name}.{kind}"
