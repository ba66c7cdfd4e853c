"""K, tau, zeta and wn: what is put into a loop is found again, by both methods, and what cannot be found is refused."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

import fiohost
from fiohost.bench.log import Log
from fiohost.bench.signals import Square, Staircase
from fiohost.cli.main import cli
from fiohost.control.closed_loop import Loop, Plant, run_loop
from fiohost.errors import ConfigError, DataError
from fiohost.estimation.second_order import closed_loop, from_overshoot, open_loop, overshoot_pct
from fiohost.motor.model import Model
from fiohost.motor.simulate import Excitation, free_run

TICK_S = 0.001


def loop_log(gain: float, tau_s: float, kp: float = 1.0, effects: dict[str, dict[str, float]] | None = None,
             periods: int = 3, **settings: float) -> Log:  # fmt: skip
    """A square wave through a nearly continuous loop without counts: the textbook's case."""
    model = Model(values={"linear.gain_deg_s_per_pct": gain, "linear.tau_s": tau_s})
    for name, values in (effects or {}).items():
        model = model.with_effect(name, values)
    times = np.arange(round(4.0 * periods / TICK_S)) * TICK_S
    ref = Square(duration_s=4.0 * periods, low=170.0, high=190.0, period_s=4.0).values(times)
    run = run_loop(Plant.of(model), Loop(kp, sample_time_s=TICK_S, **settings), ref)
    columns = {"time_s": run.time_s, "duty_pct": run.duty_pct, "ref_deg": ref, "angle_deg": run.angle_deg}
    return Log.from_columns(columns, {"kp_pct_per_deg": repr(kp), "controller": "p", "sample_time_s": str(TICK_S)})


def speed_table(folder: Path, gain: float = 8.0, tau_s: float = 0.05) -> Path:
    """A table of commands and speeds with sensor noise, as somebody's own recorder writes it."""
    rng = np.random.default_rng(3)
    times = np.arange(4000) * 0.01
    duty = np.repeat(rng.choice((20.0, 35.0, 50.0, 65.0, 80.0), 40), 100)
    speed, now = np.zeros(4000), 0.0
    for k in range(3999):
        now += (1.0 - math.exp(-0.01 / tau_s)) * (gain * duty[k] - now)
        speed[k + 1] = now
    rows = zip(times, duty, speed + 2.0 * rng.standard_normal(4000), strict=True)
    path = folder / "drive.csv"
    path.write_text("t (s),duty (%),speed (deg/s)\n" + "".join(f"{t:.3f},{u:.1f},{y:.3f}\n" for t, u, y in rows))
    return path


# ---- formulas ------------------------------------------------------------------------------------------------------


@given(st.floats(0.05, 0.85), st.floats(0.5, 100.0), st.floats(0.1, 10.0))
def test_the_formulas_undo_each_other(zeta: float, omega: float, kp: float) -> None:
    assert closed_loop(*open_loop(zeta, omega, kp), kp) == pytest.approx((zeta, omega))
    peak_s = math.pi / (omega * math.sqrt(1.0 - zeta**2))
    assert from_overshoot(overshoot_pct(zeta), peak_s) == pytest.approx((zeta, omega), rel=1e-6)


def test_the_loop_of_the_text_is_its_own_denominator() -> None:
    zeta, omega = closed_loop(10.0, 0.08, 1.5)
    assert omega**2 == pytest.approx(1.5 * 10.0 / 0.08)
    assert 2.0 * zeta * omega == pytest.approx(1.0 / 0.08)


# ---- both methods --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["step", "pem"])
@pytest.mark.parametrize(("gain", "tau_s", "kp"), [(10.0, 0.08, 1.0), (6.0, 0.15, 0.7)])
def test_a_linear_loop_gives_back_its_motor(method: str, gain: float, tau_s: float, kp: float) -> None:
    found = fiohost.identify(loop_log(gain, tau_s, kp), method)
    zeta, omega = closed_loop(gain, tau_s, kp)
    assert found.kp_pct_per_deg == kp
    assert found.value("gain_deg_s_per_pct") == pytest.approx(gain, rel=0.02)
    assert found.value("tau_s") == pytest.approx(tau_s, rel=0.02)
    assert (found.value("zeta"), found.value("omega_n_rad_s")) == pytest.approx((zeta, omega), rel=0.01)
    assert found.fit_pct > 98.0
    for estimate in found.parameters.values():
        assert estimate.ci95[0] <= estimate.value <= estimate.ci95[1]


def test_the_intervals_of_a_fit_hold_the_truth_under_noise() -> None:
    whole = loop_log(10.0, 0.08)
    base = Log.from_columns({n: v[::5] for n, v in whole.columns.items()}, whole.metadata | {"sample_time_s": "0.005"})
    clean = fiohost.identify(base)
    rng = np.random.default_rng(4)
    inside = {name: 0 for name in ("gain_deg_s_per_pct", "tau_s", "zeta", "omega_n_rad_s")}
    tries = 12
    for _ in range(tries):
        noisy = {**base.columns, "angle_deg": base.columns["angle_deg"] + rng.normal(0.0, 0.5, len(base))}
        found = fiohost.identify(Log.from_columns(noisy, base.metadata))
        for name in inside:
            low, high = found.parameters[name].ci95
            inside[name] += low <= clean.value(name) <= high
            assert 1e-5 < (high - low) / clean.value(name) < 0.1
    assert min(inside.values()) >= 0.75 * tries


def test_an_open_loop_is_fitted_from_its_duty() -> None:
    times = np.arange(2000) * 0.005
    duty = Staircase(duration_s=10.0, levels=(40.0, -30.0, 70.0, 0.5), step_s=1.0).values(times)
    model = Model(values={"linear.gain_deg_s_per_pct": 8.0, "linear.tau_s": 0.12})
    act = Excitation(times, times, np.concatenate(([0.0], duty)), np.ones(2001, dtype=np.int64))
    columns = {"time_s": times, "duty_pct": duty, "angle_deg": free_run(model, act, 5.0)}
    found = fiohost.identify(Log.from_columns(columns, {"sample_time_s": "0.005"}), kp_pct_per_deg=2.0)
    assert found.fitted == "duty"
    assert found.value("gain_deg_s_per_pct") == pytest.approx(8.0, rel=1e-3)
    assert found.value("tau_s") == pytest.approx(0.12, rel=1e-3)
    assert (found.value("zeta"), found.value("omega_n_rad_s")) == pytest.approx(closed_loop(8.0, 0.12, 2.0), rel=1e-2)


def test_friction_makes_the_two_methods_differ_by_more_than_their_intervals() -> None:
    log = loop_log(10.0, 0.08, effects={"coulomb_friction": {"level_pct": 3.0}}, u_plus_pct=2.6, u_minus_pct=-2.6)
    step, pem = fiohost.identify(log, "step"), fiohost.identify(log, "pem")
    assert step.parameters["zeta"].ci95[0] > pem.parameters["zeta"].ci95[1]


def test_missing_rows_and_a_saturated_beginning_are_left_out() -> None:
    whole = loop_log(10.0, 0.08, periods=4)
    keep = np.ones(len(whole), dtype=bool)
    keep[9000:9100] = keep[7000:7003] = False
    holed = Log.from_columns({n: v[keep] for n, v in whole.columns.items()}, whole.metadata)
    assert np.max(np.abs(whole.duty_pct)) == 100.0  # the way to the first level
    found = fiohost.identify(holed)
    assert found.value("tau_s") == pytest.approx(0.08, rel=0.02)
    assert found.curves[0].time_s[0] == pytest.approx(2.0)
    assert len(found.curves[0].time_s) == 14000 - 103


# ---- refusals ------------------------------------------------------------------------------------------------------


def test_what_cannot_be_identified_is_refused_with_its_reason() -> None:
    log = loop_log(10.0, 0.08, periods=1)
    with pytest.raises(ConfigError, match="did you mean 'pem'"):
        fiohost.identify(log, "pen")
    with pytest.raises(DataError, match="pd controller"):
        fiohost.identify(Log.from_columns(log.columns, {**log.metadata, "controller": "pd"}))
    with pytest.raises(DataError, match="give kp"):
        fiohost.identify(Log.from_columns(log.columns, {}))
    with pytest.raises(DataError, match="use the method pem"):
        fiohost.identify(loop_log(10.0, 0.02, kp=0.2), "step")  # zeta is above 1
    open_log = Log.from_columns({n: v for n, v in log.columns.items() if n != "ref_deg"}, {})
    with pytest.raises(DataError, match="without a reference"):
        fiohost.identify(open_log, "step")
    with pytest.raises(DataError, match="no log"):
        fiohost.identify([])
    still = {**log.columns, "angle_deg": np.zeros(len(log)), "duty_pct": np.zeros(len(log))}
    with pytest.raises(DataError, match="nothing moves"):
        fiohost.identify(Log.from_columns(still, log.metadata))


@pytest.mark.parametrize("method", ["step", "pem"])
@pytest.mark.parametrize("rows", [slice(0, 1), slice(0, 15), slice(100, 130), slice(0, 1900)])
def test_logs_of_next_to_nothing_are_refused_by_a_sentence(method: str, rows: slice) -> None:
    log = loop_log(10.0, 0.08, periods=1)
    short = Log.from_columns({n: v[rows] for n, v in log.columns.items()}, log.metadata)
    with pytest.raises(DataError) as caught:
        fiohost.identify(short, method)
    assert "\n" not in str(caught.value)


def test_a_reference_with_holes_is_refused() -> None:
    log = loop_log(10.0, 0.08, periods=1)
    holed = {**log.columns, "ref_deg": np.where(np.arange(len(log)) < 50, np.nan, log.columns["ref_deg"])}
    with pytest.raises(DataError, match="50 of 4000"):
        fiohost.identify(Log.from_columns(holed, log.metadata))


def test_a_loop_at_its_limit_throughout_is_refused() -> None:
    log = loop_log(10.0, 0.08, limit_pct=5.0)
    with pytest.raises(DataError, match="at its limit"):
        fiohost.identify(Log.from_columns(log.columns, {**log.metadata, "limit_pct": "5"}))


# ---- the command ---------------------------------------------------------------------------------------------------


def test_the_command_identifies_a_run_of_the_simulated_board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)

    def run(*words: str) -> str:
        result = CliRunner().invoke(cli, words)
        assert result.exit_code == 0, result.output
        return result.output

    run("run", "square_170_190", "--log", "run.csv")
    text = run("identify", "run.csv", "--method", "step", "--json", "step.json")
    assert "omega_n" in text
    run("identify", "run.csv", "--save-model", "motor.toml", "--plot", "fit.png", "--json", "pem.json")
    step, pem = (json.loads(Path(f"{name}.json").read_text()) for name in ("step", "pem"))
    assert len(step["steps"]) == 9  # the way to the first level is no step
    for found in (step, pem):
        values = {name: item["value"] for name, item in found["parameters"].items()}
        zeta, omega = closed_loop(values["gain_deg_s_per_pct"], values["tau_s"])
        assert (values["zeta"], values["omega_n_rad_s"]) == pytest.approx((zeta, omega), rel=0.02)
        assert 8.0 < values["gain_deg_s_per_pct"] < 13.0
        assert 0.05 < values["tau_s"] < 0.12
    assert Model.read(Path("motor.toml")).number("linear.tau_s") == pem["parameters"]["tau_s"]["value"]
    assert Path("fit.png").read_bytes()[:4] == b"\x89PNG"
    refused = CliRunner().invoke(cli, ["identify", "run.csv", "--plot", "run.csv"])
    assert refused.exit_code == 1


# ---- logs of speed -------------------------------------------------------------------------------------------------


def test_gain_and_lag_come_from_a_table_of_speeds(tmp_path: Path) -> None:
    table, picture = speed_table(tmp_path), tmp_path / "fit.png"
    result = CliRunner().invoke(
        cli, ["identify", str(table), "--json", str(tmp_path / "x.json"), "--plot", str(picture)]
    )
    assert result.exit_code == 0, result.output
    assert "from duty to speed" in result.output
    assert "deg/s rms" in result.output
    told = json.loads((tmp_path / "x.json").read_text())
    assert told["output_unit"] == "deg/s"
    assert "rms_deg" not in told
    assert told["rms"] == pytest.approx(2.0, rel=0.1)
    for name, truth in (("gain_deg_s_per_pct", 8.0), ("tau_s", 0.05)):
        value = told["parameters"][name]
        assert value["value"] == pytest.approx(truth, rel=0.02)
        assert value["ci95"][0] < truth < value["ci95"][1]
    assert picture.stat().st_size > 10_000


def test_a_loop_s_form_is_not_asked_of_speeds(tmp_path: Path) -> None:
    with pytest.raises(DataError, match="needs the angle of a shaft"):
        fiohost.identify(speed_table(tmp_path), "step")
