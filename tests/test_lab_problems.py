"""The problems of the control lab appendix against closed forms, worked out here from the text's numbers alone."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT
from scipy import signal
from scipy.optimize import brentq, minimize_scalar

from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError
from fiohost.labs.problems.catalogue import PROBLEMS, problem

R, L, K, J, B = 2.0, 0.008, 0.1, 4e-4, 1e-3  # problem D-1; both motor constants are K

Values = dict[str, Any]


@pytest.fixture(scope="module")
def values() -> Callable[[int], Values]:
    """The figures of a problem with the text's numbers, each solved once."""
    found: dict[int, Values] = {}

    def of(number: int) -> Values:
        if number not in found:
            found[number] = dict(PROBLEMS[number].solve().values)
        return found[number]

    return of


def response(numerator: list[float], denominator: list[float]) -> Callable[[float], float]:
    """The step response of a transfer function by partial fractions."""
    shares, poles, _ = signal.residue(numerator, [*denominator, 0.0])
    return lambda t: float(np.sum(shares * np.exp(poles * t)).real)


def when(y: Callable[[float], float], level: float, until: float) -> float:
    return float(brentq(lambda t: y(t) - level, 1e-9, until, xtol=1e-12))


def peak(y: Callable[[float], float], about: tuple[float, float]) -> tuple[float, float]:
    """When and how high."""
    found = minimize_scalar(lambda t: -y(t), bounds=about, method="bounded", options={"xatol": 1e-9})
    return float(found.x), -float(found.fun)


def speed(volts: float, friction: float) -> Callable[[float], float]:
    return response([volts * K], [L * J, R * J + L * friction, R * friction + K * K])


def current(volts: float, friction: float) -> Callable[[float], float]:
    return response([volts * J, volts * friction], [L * J, R * J + L * friction, R * friction + K * K])


def position(kp: float, kd: float = 0.0) -> Callable[[float], float]:
    return response([K * kp], [L * J, R * J + L * B, R * B + K * (K + kd), K * kp])


# ---- voltage to speed ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "friction"), [(1, B), (2, 0.0)])
def test_speed_and_current_are_those_of_the_second_order_motor(
    values: Callable[[int], Values], number: int, friction: float
) -> None:
    found, exact = values(number), speed(5.0, friction)
    steady = 5.0 * K / (R * friction + K * K)
    assert found["steady_speed_rad_s"] == pytest.approx(steady, rel=1e-6)
    assert found["to_63_pct_s"] == pytest.approx(when(exact, 0.63 * steady, 0.5), rel=1e-4)
    assert found["to_75_pct_s"] == pytest.approx(when(exact, 0.75 * steady, 0.5), rel=1e-4)
    assert found["largest_current_A"] == pytest.approx(peak(current(5.0, friction), (1e-3, 0.05))[1], rel=5e-5)


def test_twice_the_voltage_is_twice_the_speed(values: Callable[[int], Values]) -> None:
    assert values(2)["other_steady_speed_rad_s"] == pytest.approx(100.0, rel=1e-6)


def test_without_inductance_the_rise_is_one_exponential(values: Callable[[int], Values]) -> None:
    found, tau = values(3), J * R / K**2
    assert found["steady_speed_rad_s"] == pytest.approx(50.0, rel=1e-6)
    assert found["largest_current_A"] == pytest.approx(2.5, rel=1e-9)
    for key, factor, left in (
        ("to_63_pct_s", 1, 0.37),
        ("to_75_pct_s", 1, 0.25),
        ("heavier_to_63_pct_s", 2, 0.37),
        ("heavier_to_75_pct_s", 2, 0.25),
    ):
        assert found[key] == pytest.approx(-factor * tau * math.log(left), rel=1e-4), key


@pytest.mark.parametrize(("number", "load", "begin"), [(4, -0.1, 0.5), (5, -0.2, 1.0)])
def test_a_load_adds_its_own_response(values: Callable[[int], Values], number: int, load: float, begin: float) -> None:
    for name, friction, inductance in (("D-1", B, L), ("D-2", 0.0, L), ("D-3", 0.0, 0.0)):
        found = values(number)["cases"][name]
        damping = R * friction + K * K
        by_load = response(
            [inductance, R], [inductance * J, R * J + inductance * friction, damping][inductance == 0.0 :]
        )
        after = (5.0 * K + load * R) / damping
        assert found["after_rad_s"] == pytest.approx(after, rel=1e-6), name
        by_volts = response([5.0 * K], [inductance * J, R * J + inductance * friction, damping][inductance == 0.0 :])
        before = by_volts(begin)
        assert found["before_rad_s"] == pytest.approx(before, rel=1e-5), name
        assert found["up_63_s"] == pytest.approx(when(by_volts, 0.63 * after, begin), rel=2e-3), name

        def fallen(t: float, load: float = load, by_load: Any = by_load, by_volts: Any = by_volts) -> float:
            return float(by_volts(begin + t) + load * by_load(t))

        level = before + 0.75 * (after - before)
        assert found["change_75_s"] == pytest.approx(when(fallen, level, 1.0), rel=1e-3), name
    assert values(number)["speed_by_load_rad_s"]["-0.25"] == pytest.approx(0.0, abs=1e-5)


def test_an_amplifier_multiplies(values: Callable[[int], Values]) -> None:
    assert values(6)["steady_speed_rad_s"] == pytest.approx(10.0 * K / (R * B + K * K), rel=1e-6)


# ---- speed under P -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "kp"), [(7, 0.1), (8, 1.0)])
def test_speed_under_p_is_of_first_order(values: Callable[[int], Values], number: int, kp: float) -> None:
    found, loop = values(number), 2.0 * kp * K / R
    rate = (B + K * K / R + loop) / J
    assert found["steady_speed_rad_s"] == pytest.approx(10.0 * loop / (rate * J), rel=1e-6)
    assert found["to_63_pct_s"] == pytest.approx(-math.log(0.37) / rate, rel=1e-3)
    assert found["to_75_pct_s"] == pytest.approx(-math.log(0.25) / rate, rel=1e-3)
    assert found["largest_current_A"] == pytest.approx(20.0 * kp / R, rel=1e-9)


def test_a_limited_current_decides_the_rise(values: Callable[[int], Values]) -> None:
    found = values(8)  # 1 A all the way to 63 %: J dw/dt = K - B w
    level = 0.63 * found["limited_steady_speed_rad_s"]
    assert found["limited_to_63_pct_s"] == pytest.approx(-J / B * math.log(1.0 - level * B / K), rel=1e-3)
    assert found["limited_largest_current_A"] == pytest.approx(1.0)
    assert found["limited_steady_speed_rad_s"] == pytest.approx(found["steady_speed_rad_s"], rel=1e-5)


@pytest.mark.parametrize(("number", "after"), [(9, 0.0), (10, -6.25)])
def test_a_load_stops_the_loop_or_turns_it(values: Callable[[int], Values], number: int, after: float) -> None:
    found, rate = values(number), (B + K * K / R + 0.01) / J
    assert found["after_rad_s"] == pytest.approx(after, abs=1e-6)
    assert found["before_rad_s"] == pytest.approx(6.25, rel=1e-6)
    assert found["change_63_s"] == pytest.approx(-math.log(0.37) / rate, rel=1e-3)


def test_the_sensor_is_made_up_for_by_the_gain(values: Callable[[int], Values]) -> None:
    assert values(11)["kp"] == pytest.approx(0.1 / 0.2)
    assert values(11)["steady_speed_rad_s"] == pytest.approx(6.25, rel=1e-6)


# ---- position ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "kp", "about"), [(12, 1.0, (0.2, 0.6)), (13, 2.0, (0.1, 0.35))])
def test_the_largest_rotation_is_that_of_the_third_order_loop(
    values: Callable[[int], Values], number: int, kp: float, about: tuple[float, float]
) -> None:
    at, top = peak(position(kp), about)
    assert values(number)["largest_rotation_rad"] == pytest.approx(top, rel=1e-6)
    assert values(number)["peak_s"] == pytest.approx(at, abs=2e-4)


def test_the_best_gain_overshoots_as_much_as_is_allowed(values: Callable[[int], Values]) -> None:
    found = values(14)
    assert found["best"] == "kp 1"
    assert peak(position(found["kp_with_that_overshoot"]), (0.15, 0.6))[1] == pytest.approx(1.10, abs=1e-3)
    times = np.linspace(0.0, 10.0, 40_001)
    exact = position(0.5)
    cost = np.trapezoid(times * np.abs(1.0 - np.array([exact(t) for t in times])), times)
    assert found["itae_rad_s2"]["kp 0.5"] == pytest.approx(cost, rel=1e-3)


def test_the_derivative_damps_as_the_poles_say(values: Callable[[int], Values]) -> None:
    over = values(15)["overshoot_pct"]
    times = np.linspace(0.3, 0.6, 30_001)
    for kd in (0.01, 0.02):
        y = by_poles([K * kd, K], [L * J, R * J + L * B, R * B + K * (K + kd), K], times)
        assert over[f"kd {kd:g}"] == pytest.approx(100.0 * (y.max() - 1.0), abs=0.01)
    assert over["kd 0.1"] == 0.0


@pytest.mark.parametrize(("number", "load"), [(16, -0.1), (17, -0.2)])
def test_no_derivative_takes_the_load_away(values: Callable[[int], Values], number: int, load: float) -> None:
    for name, error in values(number)["error_rad_by_kd"].items():
        assert error == pytest.approx(-load * R / (K * 1.0), rel=2e-3), name


@pytest.mark.parametrize(("number", "overshoot"), [(18, 4.3), (19, 2.8)])
def test_the_pid_overshoots_as_asked_and_leaves_nothing_of_the_load(
    values: Callable[[int], Values], number: int, overshoot: float
) -> None:
    forms = {name: found for name, found in values(number).items() if "kp" in found}
    assert list(forms) == ["text's PID (Fig. D-36)", "D on the angle", "P and D on the angle"]
    times = np.concatenate([np.linspace(0.0, 0.4, 8001), np.linspace(0.4005, 12.0, 23_200)])
    for name, found in forms.items():
        kp, ki, kd = found["kp"], found["ki"], found["kd"]
        denominator = [L * J, R * J + L * B, R * B + K * (K + kd), K * kp, K * ki]
        y = by_poles([K * kd * found["kd_weight"], K * kp * found["weight"], K * ki], denominator, times)
        assert 100.0 * (y.max() - 1.0) == pytest.approx(overshoot, abs=0.01), name
        assert found["overshoot_pct"] == pytest.approx(overshoot, abs=0.01), name
        by_load = by_poles([L, R, 0.0], denominator, times)
        assert found["load_turns_rad"] == pytest.approx(0.1 * by_load.max(), rel=1e-3), name
        assert by_load[-1] == pytest.approx(0.0, abs=0.05)
    assert forms["D on the angle"]["kp"] == pytest.approx(5.0)
    assert forms["P and D on the angle"]["load_gone_s"] < 0.1 * forms["D on the angle"]["load_gone_s"]
    assert forms["text's PID (Fig. D-36)"]["load_gone_s"] < 0.3 * forms["D on the angle"]["load_gone_s"]


def by_poles(top: list[float], bottom: list[float], times: np.ndarray) -> np.ndarray:
    """Unit step response of a proper fraction by its partial fractions."""
    residues, poles, _ = signal.residue(top, [*bottom, 0.0])
    return np.asarray((residues @ np.exp(np.outer(poles, times))).real)


@pytest.mark.parametrize(("number", "overshoot", "settling_s"), [(18, 4.11, 0.22), (19, 3.68, 0.19)])
def test_the_page_says_what_the_texts_derivative_of_the_error_makes_of_a_design_on_the_angle(
    values: Callable[[int], Values], number: int, overshoot: float, settling_s: float
) -> None:
    """Fig. D-36 has du/dt of the error: the same gains overshoot otherwise and settle sooner there."""
    found = values(number)["D on the angle, in the text's diagram"]
    assert found["overshoot_pct"] == pytest.approx(overshoot, abs=0.01)
    assert found["settling_2_s"] == pytest.approx(settling_s, abs=0.005)
    gains = values(number)["D on the angle"]
    assert gains["kd_weight"] == 0.0
    page = (ROOT / "docs" / "labs" / "problems.md").read_text(encoding="utf-8")
    assert f"{overshoot:g} %" in page


def test_the_derivative_gain_of_d15_is_that_of_the_texts_block(values: Callable[[int], Values]) -> None:
    """With du/dt of the error the least ITAE is near 0.036, of the table's gains at 0.03; of the angle at 0.02."""
    found = values(15)
    assert found["best"] == "kd 0.03"
    assert found["on_angle_best"] == "kd 0.02"
    times = np.linspace(0.0, 3.0, 30_001)

    def cost(kd: float) -> float:
        y = by_poles([K * kd, K], [L * J, R * J + L * B, R * B + K * (K + kd), K], times)
        return float(np.trapezoid(times * np.abs(1.0 - y), times))

    best = minimize_scalar(cost, bounds=(0.0, 0.1), method="bounded", options={"xatol": 1e-5}).x
    assert found["best_kd_V_s_per_rad"] == pytest.approx(best, abs=5e-4)
    for kd in (0.01, 0.03, 0.1):
        assert found["itae_rad_s2"][f"kd {kd:g}"] == pytest.approx(cost(kd), rel=1e-3)


def test_a_loop_that_creeps_is_followed_until_it_rests() -> None:
    """D-14 at kp 0.1: no overshoot, settled to 5 % after 3.4546 s, as its poles say."""
    found = PROBLEMS[14].solve()
    rows = {row[0]: row for row in found.tables[0].rows}
    times = np.linspace(0.0, 6.0, 60_001)
    y = by_poles([K * 0.1], [L * J, R * J + L * B, R * B + K * K, K * 0.1], times)
    exact = float(times[np.flatnonzero(np.abs(y - 1.0) > 0.05)[-1] + 1])
    assert exact == pytest.approx(3.4546, abs=1e-4)
    assert rows["kp 0.1"][1] == 0.0
    assert float(str(rows["kp 0.1"][3])) == pytest.approx(exact, abs=5e-4)


@pytest.mark.parametrize("number", [1, 2])
def test_the_plots_of_d1_and_d2_cover_the_ten_seconds_asked_for(number: int) -> None:
    (draw,) = PROBLEMS[number].solve().figures.values()
    ends = [line.get_xdata()[-1] for axes in draw().axes for line in axes.get_lines()]
    assert max(ends) == pytest.approx(10.0)
    assert min(ends) < 2.0  # and the rise, which nobody could see there


# ---- how they are asked --------------------------------------------------------------------------------------------


def test_a_problem_may_be_asked_with_other_numbers(tmp_path: Path) -> None:
    args = ["lab", "problems", "d7", "--set", "kp=0.2", "--set", "B_Nms=0", "--report", str(tmp_path), "--json", "-"]
    result = CliRunner().invoke(cli, args)
    assert result.exit_code == 0, result.stderr
    found = json.loads(result.stdout)
    loop = 2.0 * 0.2 * K / R
    assert found["values"]["steady_speed_rad_s"] == pytest.approx(10.0 * loop / (K * K / R + loop), rel=1e-6)
    assert Path(found["files"]["problem_D-7"]).is_file()
    assert "Steady speed" in result.stderr


def test_all_are_listed_with_their_numbers() -> None:
    result = CliRunner().invoke(cli, ["lab", "problems", "--list"])
    assert result.exit_code == 0
    for number, item in PROBLEMS.items():
        assert f"D-{number} " in result.stdout
        assert all(key in result.stdout for key in item.numbers)


@pytest.mark.parametrize(
    ("args", "word"),
    [
        (["D-20"], "D-1 to D-19"),
        (["nonsense"], "D-1 to D-19"),
        (["D-1", "--set", "volt=5"], "did you mean 'volts'"),
        (["D-1", "--set", "volts"], "KEY=VALUE"),
        (["D-1", "--set", "R_ohm=0"], "R_ohm"),
        (["D-1", "--set", "seconds=nan"], "seconds"),
        (["D-4", "--set", "load_from_s=20"], "load_from_s"),
        (["D-3", "--set", "L_H=0.1"], "no number"),
    ],
)
def test_what_cannot_be_asked_is_refused(args: list[str], word: str, tmp_path: Path) -> None:
    result = CliRunner().invoke(cli, ["lab", "problems", *args, "--report", str(tmp_path)])
    assert result.exit_code == 1
    assert word in result.stderr


def test_the_motor_of_the_problems_is_that_of_the_plant() -> None:
    from firmware_model import load_plant

    plant = load_plant("problem_d1")
    assert {key: getattr(plant, key) for key in PROBLEMS[1].numbers if hasattr(plant, key)} == {
        "R_ohm": R, "L_H": L, "Kt_Nm_per_A": K, "Ke_Vs_per_rad": K, "J_kgm2": J, "B_Nms": B,
    }  # fmt: skip
    assert problem("D-1").numbers["R_ohm"] == R
    with pytest.raises(ConfigError):
        problem("7.5")


def test_a_motor_that_cannot_be_followed_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(DataError, match="cannot be computed"):
        PROBLEMS[4].solve({"L_H": 1e-12})
    monkeypatch.setattr("fiohost.labs.problems.servo.MOST_RATES", 100)
    with pytest.raises(DataError, match="too fast"):
        PROBLEMS[1].solve()
