"""Designed loops do what was asked for, on the model and on the board; what cannot be had is said with what can."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import fiohost
from fiohost.bench.experiment import Experiment
from fiohost.bench.signals import Constant, Square
from fiohost.cli.main import cli
from fiohost.control.closed_loop import Plant
from fiohost.control.design import deadband_of, varied, with_deadband
from fiohost.control.jitter import reversals
from fiohost.control.settings import ControlSettings
from fiohost.control.specification import Specification, judge, outcomes
from fiohost.errors import ConfigError, FiohostError
from fiohost.motor.model import Model

NXT = Model.parse("nxt")


# ---- judgement -----------------------------------------------------------------------------------------------------


def test_a_response_is_judged_by_its_own_final_value_within_a_count_at_least() -> None:
    times = np.arange(200) * 0.01
    y = 20.0 * (1.0 - np.exp(-times / 0.1))
    found = judge(times, y, np.ones(200), 0.0, 20.0, 2.0, 0.0)
    assert found.settling_s == pytest.approx(0.1 * np.log(50.0), abs=0.011)
    coarse = judge(times, np.floor(y / 0.5) * 0.5, np.ones(200), 0.0, 20.0, 0.5, 0.5)
    assert coarse.settling_s == pytest.approx(0.1 * np.log(40.0 / 2.0), abs=0.06)  # 2 % of 20 deg is below a count
    short = judge(times, 0.9 * y, np.ones(200), 0.0, 20.0, 2.0, 0.0)
    assert short.error_deg == pytest.approx(2.0, abs=1e-3)


def test_jitter_is_counted_where_the_response_should_rest() -> None:
    times = np.arange(400) * 0.005
    duty = np.where(np.arange(400) // 10 % 2 == 0, 3.0, -3.0)  # a reversal each 50 ms
    assert judge(times, np.full(400, 5.0), duty, 0.0, 5.0, 2.0, 0.5).reversals_per_s == pytest.approx(20.0, rel=0.06)
    assert reversals(np.array([1.0, 0.0, 0.0, 2.0, -1.0, 0.0, 1.0])) == 2


# ---- designs -------------------------------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize("kind", ["pd", "pid"])
def test_a_design_meets_what_was_asked_for_with_room_for_a_model_that_is_off(kind: str) -> None:
    found = fiohost.design(NXT, kind)
    assert found.feasible
    assert found.robust
    assert found.settings.kind == kind
    again = outcomes([Plant.of(NXT)], found.settings.loop(0.005, 0.005, 0.5), (20.0, 90.0, 180.0), found.asked, 1.5)
    assert [vars(one) for one in again] == [vars(one) for one in found.found]
    assert all(one.overshoot_pct < 5.0 and one.settling_s < 0.5 and one.error_deg < 1.0 for one in again)


def test_a_design_meets_its_specification_on_the_board() -> None:
    found = fiohost.design(NXT)
    square = Square(duration_s=8.0, low=90.0, high=270.0, period_s=4.0)
    plan = Experiment("x", reference=(Constant(duration_s=2.0, level=90.0), square), control=found.settings)
    with fiohost.connect("sim") as bench:
        log = bench.run(plan)
    first = int(np.flatnonzero(np.diff(log.columns["ref_deg"]))[0]) + 1
    part = slice(first, first + 400)
    times, y = log.time_s[part] - log.time_s[first], log.output[part]
    assert judge(times, y, log.duty_pct[part], y[0], 270.0, 2.0, 0.5).meets(found.asked)


def test_what_cannot_be_met_is_said_with_the_nearest_that_can() -> None:
    found = fiohost.design(NXT, "p")
    assert not found.feasible
    assert found.nearest
    for near in found.nearest:
        assert near.gives_way
        loop = near.settings.loop(0.005, 0.005, 0.5)
        assert all(
            one.meets(near.asked) for one in outcomes([Plant.of(NXT)], loop, (20.0, 90.0, 180.0), near.asked, 1.5)
        )
        for name in ("overshoot_pct", "settling_s", "sse_deg"):
            wider = getattr(near.asked, name) > getattr(found.asked, name)
            assert wider == (name in near.gives_way)


def test_only_the_settling_time_gives_way_where_only_that_is_too_short() -> None:
    found = fiohost.design(NXT, "pd", settling_s=0.2)  # 180 degrees at 820 deg/s take longer
    settling = [near for near in found.nearest if near.gives_way == ("settling_s",)]
    assert not found.feasible
    assert settling
    assert 0.2 < settling[0].asked.settling_s < 0.5


def test_a_bench_deadband_is_put_into_a_model_that_has_none() -> None:
    plain = Model(values={"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.1})
    put = with_deadband(plain, 4.0, -3.0)
    assert deadband_of(put) == (4.0, -3.0)
    assert with_deadband(NXT, 4.0, -3.0) == NXT
    assert deadband_of(NXT.with_effect("constant_load", {"level_pct": 1.0})) == pytest.approx((4.68, -2.68))
    slower = varied(put, "friction", 1.2)
    assert deadband_of(slower) == pytest.approx((4.8, -3.6))


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        ({"controller": "pdi"}, "did you mean"),
        ({"overshoot_pct": 0.0}, "overshoot_pct"),
        ({"settling_s": -1.0}, "settling_s"),
        ({"sse_deg": float("nan")}, "sse_deg"),
        ({"steps_deg": ()}, "one step"),
        ({"limit_pct": 0.0}, "limit_pct"),
    ],
)
def test_a_specification_that_is_none_is_refused(given: dict[str, object], reason: str) -> None:
    with pytest.raises(FiohostError, match=reason):
        fiohost.design(NXT, **given)
    with pytest.raises(ConfigError):
        Specification(band_pct=0.0)


# ---- the commands --------------------------------------------------------------------------------------------------


def test_a_designed_controller_runs_and_keeps_to_its_profile(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bench.toml").write_text(
        'schema = "fiohost.bench/1"\n[deadband]\nu_plus_pct = 4.0\nu_minus_pct = -3.0\n[compensation]\nshare = 0.5\n'
    )
    words = ["design", "--model", "nxt", "--steps", "20", "--profile", "bench.toml", "--save", "pd.toml", "--plot",
             "pd.png", "--json", "pd.json"]  # fmt: skip
    result = CliRunner().invoke(cli, words)
    assert result.exit_code == 0, result.output
    found = json.loads(Path("pd.json").read_text())
    assert found["feasible"]
    control = ControlSettings.load(Path("pd.toml"))
    assert (control.u_plus_pct, control.u_minus_pct) == (2.0, -1.5)
    assert found["controller"]["kp_pct_per_deg"] == control.kp_pct_per_deg
    assert Path("pd.png").read_bytes()[:4] == b"\x89PNG"
    Path("bench.toml").write_text(Path("bench.toml").read_text().replace("0.5", "0.7"))
    words = ["run", "square_170_190", "--controller", "pd.toml", "--profile", "bench.toml", "--log", "run.csv"]
    assert CliRunner().invoke(cli, words).exit_code == 0
    log = fiohost.Log.read("run.csv")
    assert float(log.metadata["kp_pct_per_deg"]) == control.kp_pct_per_deg
    assert float(log.metadata["u_plus_pct"]) == pytest.approx(2.8)
    for wrong, reason in (
        (["run", "staircase", "--profile", "bench.toml"], "open loop"),
        (["run", "square_170_190", "--profile", "absent.toml"], "fiohost deadband --save"),
        (["design", "--model", "nxt", "--overshoot", "x"], "--overshoot"),
        (["design", "--model", "nxt", "--steps", "20,,3"], "--steps"),
    ):
        refused = CliRunner().invoke(cli, wrong)
        assert refused.exit_code == 1
        assert reason in refused.output
