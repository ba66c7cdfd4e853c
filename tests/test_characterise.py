"""Constants from readings: the truth lies within the intervals, and what cannot be readings is refused."""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from places import ROOT

from fiohost.bench.connect import connect
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DataError, FiohostError
from fiohost.labs.characterise import characterise
from fiohost.labs.constants import MotorConstants
from fiohost.labs.measure import measure
from fiohost.labs.questions import paired
from fiohost.labs.readings import NoLoad, Readings
from fiohost.labs.solve_constants import constants_of, predicted_run_down, solve

PRINTED = ROOT / "docs" / "labs" / "nxt_readings.toml"
TRUE = {"Ra": 2.27, "Ki": 0.25, "Kb": 0.26, "B": 0.00131, "Tc": 0.008, "J": 0.00233}
TRUE["tau_m"] = TRUE["J"] / (TRUE["B"] + TRUE["Ki"] * TRUE["Kb"] / TRUE["Ra"])
NOISE_A, NOISE_V, NOISE_RAD_S = 0.003, 0.01, 0.02


def drawn(seed: int, q: Mapping[str, float] = TRUE) -> Readings:
    """Readings of a motor of known constants, with scatter, from Ki (V - Kb w) / Ra = B w + Tc + T."""
    rng = np.random.default_rng(seed)
    readings = Readings()

    def steady(volt: float, torque: float) -> tuple[float, float]:
        speed = (q["Ki"] * volt / q["Ra"] - q["Tc"] - torque) / (q["B"] + q["Ki"] * q["Kb"] / q["Ra"])
        return speed, (volt - q["Kb"] * speed) / q["Ra"] + NOISE_A * rng.normal()

    for volt in (0.45, 0.9, 1.35, -0.45, -0.9, -1.35):
        readings.stall.append((volt + NOISE_V * rng.normal(), volt / q["Ra"] + NOISE_A * rng.normal()))
    for torque in np.linspace(0.0, 0.12, 12).tolist():
        readings.lift.append((torque, steady(2.25, torque)[1]))
    for volt in (0.9, 1.8, 2.7, 3.6, 4.5):
        speed, current = steady(volt, 0.0)
        readings.no_load.append(NoLoad(volt + NOISE_V * rng.normal(), speed + NOISE_RAD_S * rng.normal(), current))
    readings.time_constants_s = [q["tau_m"] * (1.0 + 0.01 * rng.normal()) for _ in range(5)]
    return readings


def test_the_truth_lies_within_the_intervals_about_as_often_as_they_say() -> None:
    seeds = 60
    inside = dict.fromkeys(TRUE, 0)
    widths: dict[str, list[float]] = {name: [] for name in TRUE}
    for seed in range(seeds):
        found, _ = solve(drawn(seed))
        for name, true in TRUE.items():
            low, high = found[name].low, found[name].high
            assert low is not None
            assert high is not None
            inside[name] += low <= true <= high
            widths[name].append((high - low) / true)
    assert all(0.85 * seeds <= hits for hits in inside.values()), inside
    assert all(np.median(widths[name]) < {"B": 0.4, "Tc": 0.8}.get(name, 0.06) for name in TRUE)  # worth having
    assert sum(inside.values()) < seeds * len(TRUE)  # intervals that never miss are too wide


def test_viscous_friction_is_not_taken_for_torque_constant() -> None:
    """The bare slope of current on torque is off by B Ra / Kb, here 4.6 %."""
    found, lines = solve(drawn(0))
    assert 1.0 / lines.lift.slope > 1.03 * TRUE["Ki"]
    assert found["Ki"].value == pytest.approx(TRUE["Ki"], rel=0.02)


@pytest.mark.parametrize(
    ("target", "L_H", "supply_V", "true"),
    [
        ("sim:nxt_no_load", 0.0047, 4.5, {"Ra": 2.27, "Ki": 0.25, "Kb": 0.25, "B": 0.00131, "Tc": 0.0, "J": 0.00233}),
        ("sim:nxt_lego", 0.0047, 4.5, {"Ra": 2.27, "Ki": 0.25, "Kb": 0.25, "B": 0.00016, "Tc": 0.009, "J": 0.00233}),
        ("sim", 0.015, 9.0, {"Ra": 5.515, "Ki": 0.3408, "Kb": 0.4869, "B": 0.0, "Tc": 0.02045, "J": 3.07e-3}),
    ],
)
def test_virtual_meters_find_the_simulated_boards_constants(
    target: str, L_H: float, supply_V: float, true: dict[str, float]
) -> None:
    with connect(target, seed=1) as bench:
        readings = measure(bench, "B", L_H, supply_V, masses_kg=(0.0, 0.119, 0.293, 0.471, 0.702))
    assert readings.port == "B"
    found, _ = solve(readings)
    for name, value in true.items():
        low, high = found[name].low, found[name].high
        assert low is not None
        assert high is not None
        # a tenth of the width more: the steps of a meter are no Gaussian scatter
        room = 0.1 * (high - low)
        assert low - room <= value <= high + room, name
    # a supply of 1 A slows the stronger steps
    assert found["J"].value == pytest.approx(true["J"], rel=0.03 if target == "sim:nxt_lego" else 0.015)
    time_s, begin = readings.run_down[0]
    assert begin is not None
    predicted = predicted_run_down(max(found["B"].value, 0.0), max(found["Tc"].value, 0.0), found["J"].value, begin)
    assert predicted == pytest.approx(time_s, rel=0.03)
    constants = constants_of(found, readings, L_H)
    assert (constants.coulomb_Nm > 0.0) == (true["Tc"] > 0.0)


def test_the_printed_tables_give_the_printed_resistance_and_not_quite_the_printed_torque_constant() -> None:
    readings = Readings.load(PRINTED)
    assert len(readings.lift) == 12
    assert len(readings.lift_stalled) == 1
    found, lines = solve(readings)
    low, high = found["Ra"].low, found["Ra"].high
    assert low is not None
    assert high is not None
    assert low < 2.27 < high
    # stated: a slope of 3.95 A/(N m); table D-5 without its stall has another
    assert lines.lift.slope == pytest.approx(4.025, abs=0.005)
    result = characterise(readings, 0.0047, "printed")
    assert any("fewer than three no-load speeds" in note for note in result.notes)
    assert found["J"].low is None  # one time constant has no interval


def test_readings_are_read_as_they_were_written(tmp_path: Path) -> None:
    readings = drawn(3)
    readings.lift_stalled.append((0.2, 0.9))
    readings.run_down.append((1.7, None))
    readings.write(tmp_path / "r.toml")
    again = Readings.load(tmp_path / "r.toml")
    assert [n for row in again.lift for n in row] == pytest.approx([n for row in readings.lift for n in row], rel=1e-6)
    assert len(again.lift_stalled) == 1
    assert again.run_down == [(1.7, None)]


def test_a_table_in_csv_says_the_same_and_each_port_has_its_own_rows(tmp_path: Path) -> None:
    lines = ["# port B has twice the resistance", "kind,port,wire_voltage_V,voltage_V,torque_Nm,current_A,speed_rad_s"]
    lines += [f"stall,{port},{2 * k * v},,,{v},,"[:-1] for port, k in (("A", 2.0), ("B", 4.0)) for v in (0.1, 0.2, 0.3)]
    lines += [f"lift,{port},,,{t},{4 * t + 0.04}," for port in "AB" for t in (0.0, 0.05, 0.1)]
    lines += [f"no_load,{port},,{0.25 * w + 0.1},,0.04,{w}" for port in "AB" for w in (3.0, 6.0, 9.0)]
    path = tmp_path / "r.csv"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    for port, R in (("A", 2.0), ("B", 4.0)):
        found, _ = solve(Readings.load(path, port))
        assert found["Ra"].value == pytest.approx(R)
        assert found["Ki"].value == pytest.approx(0.25, rel=1e-6)
        assert found["Kb"].value == pytest.approx(0.25, rel=0.2)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("stall = [{ voltage_V = 1, curent_A = 1 }]", "did you mean 'current_A'"),
        ("stal = [{ voltage_V = 1, current_A = 1 }]", "did you mean 'stall'"),
        ("stall = [{ voltage_V = 1, wire_voltage_V = 2, current_A = 1 }]", "one of them"),
        ("stall = [{ voltage_V = 1 }]", "current_A is missing"),
        ("stall = [{ voltage_V = nan, current_A = 1 }]", "not a number"),
        ('stall = [{ port = "C", voltage_V = 1, current_A = 1 }]', "port 'C' is unknown"),
        ("lift = [{ mass_kg = 1, torque_Nm = 1, current_A = 1 }]", "one of them"),
        ('lift = [{ mass_kg = 1, current_A = 1, stalled = "perhaps" }]', "not true or false"),
        ("time_constant = [{ time_s = 0 }]", "not above 0"),
        ("stall = 3", "not a list"),
        ('schema = "fiohost.model/1"', "expected"),
    ],
)
def test_what_is_no_reading_is_refused_by_key_and_reason(text: str, told: str, tmp_path: Path) -> None:
    path = tmp_path / "r.toml"
    path.write_text(text + "\n", encoding="utf-8")
    with pytest.raises(ConfigError, match=told):
        Readings.load(path)


def test_readings_that_say_nothing_are_refused(tmp_path: Path) -> None:
    for kind in ("stall", "lift", "no_load"):
        readings = drawn(1)
        setattr(readings, kind, [])
        with pytest.raises(DataError, match="without load" if kind == "no_load" else kind):
            solve(readings)
    readings = drawn(1)
    readings.lift = [(0.05, 0.2)] * 5
    with pytest.raises(DataError, match="all lie at one place"):
        solve(readings)
    path = tmp_path / "r.csv"
    path.write_text("kind,voltage_V,amps\nstall,1,1\n", encoding="utf-8")
    with pytest.raises(FiohostError, match="unknown column 'amps'"):
        Readings.load(path)


def test_the_command_saves_constants_that_the_experiments_take(tmp_path: Path) -> None:
    saved = tmp_path / "motor.toml"
    answer = CliRunner().invoke(
        cli,
        [
            "lab",
            "characterise",
            "--readings",
            str(PRINTED),
            "--report",
            str(tmp_path),
            "--save",
            str(saved),
            "--json",
            "-",
        ],
    )
    assert answer.exit_code == 0, answer.stderr
    said = json.loads(answer.stdout)["values"]
    constants = MotorConstants.load(str(saved))
    assert constants.R_ohm == pytest.approx(said["constants"]["Ra"]["value"])
    assert constants.supply_V == 4.5
    assert (tmp_path / "characterise.png").stat().st_size > 10_000
    sealed = CliRunner().invoke(
        cli, ["lab", "characterise", "--target", "sim:sealed", "--seed", "1", "--report", str(tmp_path / "sealed")]
    )
    assert sealed.exit_code == 1
    assert "nothing but its wire" in sealed.stderr


# ---- inductance, speed against torque ------------------------------------------------------------------------------


@pytest.mark.long
@pytest.mark.parametrize(
    ("target", "true_H", "supply_V"),
    [("sim:nxt_no_load", 0.0047, 4.5), ("sim", 0.015, 9.0), ("sim:nxt_lego", 0.0047, 4.5)],
)
def test_the_saved_inductance_is_the_one_in_the_board(
    target: str, true_H: float, supply_V: float, tmp_path: Path
) -> None:
    saved = tmp_path / "motor.toml"
    arguments = ["lab", "characterise", "--target", target, "--save", str(saved), "--report", str(tmp_path / "lab")]
    answer = CliRunner().invoke(cli, [*arguments, "--json", str(tmp_path / "told.json")])
    assert answer.exit_code == 0, answer.output
    told = json.loads((tmp_path / "told.json").read_text())
    motor = MotorConstants.load(str(saved))
    assert abs(motor.L_H - true_H) < 0.02 * true_H
    assert told["values"]["speed_torque_slope_rad_s_per_Nm"] == pytest.approx(-1.0 / motor.damping_Nms, rel=0.01)
    by_power = [row["B_Nms"] for row in told["values"]["friction_by_power"]]
    powers = [row["power_pct"] for row in told["values"]["friction_by_power"]]
    assert powers == [10.0, 20.0, 40.0, 60.0, 80.0, 100.0]  # what was asked for, whatever the bridge loses of it
    assert (by_power[0] > 3.0 * by_power[-1]) == (
        target != "sim:nxt_no_load"
    )  # Fig. D-22: friction that is dry falls with power
    assert (tmp_path / "lab" / "characterise_curves.png").stat().st_size > 10_000
    again = Readings.load(tmp_path / "lab" / "readings.toml")
    assert len(again.rise) == 12
    assert len(again.lift_speed) == len(again.lift)


@pytest.mark.parametrize(
    ("row", "expected_H"),
    [
        ("{ inductance_H = 0.0051 }", 0.0051),
        ("{ series_ohm = 2.2, time_s = 0.00105 }", None),
    ],
)
def test_an_inductance_by_a_meter_or_by_the_decay_with_a_known_resistor_is_taken(
    row: str, expected_H: float | None, tmp_path: Path
) -> None:
    path = tmp_path / "readings.toml"
    path.write_text(without_inductance() + f"\ninductance = [ {row} ]\n")
    found, _ = solve(Readings.load(path))
    by_decay = 0.00105 * (2.2 + found["Ra"].value)
    assert found["La"].value == pytest.approx(by_decay if expected_H is None else expected_H, rel=1e-9)


def without_inductance() -> str:
    return "\n".join(line for line in PRINTED.read_text().splitlines() if not line.startswith("inductance"))


def test_without_any_reading_of_the_inductance_no_set_is_written(tmp_path: Path) -> None:
    bare = tmp_path / "bare.toml"
    bare.write_text(without_inductance())
    arguments = ["lab", "characterise", "--readings", str(bare), "--save", str(tmp_path / "m.toml")]
    answer = CliRunner().invoke(cli, [*arguments, "--report", str(tmp_path / "lab")])
    assert answer.exit_code == 1
    assert "no reading tells the inductance" in answer.stderr
    answer = CliRunner().invoke(
        cli, [*arguments, "--inductance", "0.0047", "--report", str(tmp_path / "lab2")], catch_exceptions=False
    )
    assert answer.exit_code == 0, answer.stderr
    assert MotorConstants.load(str(tmp_path / "m.toml")).L_H == 0.0047


def test_what_the_text_asks_of_the_winding_and_of_the_friction_is_answered_in_numbers() -> None:
    """Dry friction of 9 mN m and 0.00016 N m s: taken for viscous it falls with the power, as in Fig. D-22."""
    readings = Readings.load(PRINTED)
    readings.inductance_H = [0.0047]
    speeds = [3.0, 6.5, 10.0, 13.5, 17.0]
    currents = [(0.009 + 0.00016 * w) / 0.25 for w in speeds]
    readings.no_load = [NoLoad(2.27 * i + 0.25 * w, w, i) for w, i in zip(speeds, currents, strict=True)]
    result = characterise(readings, None, "readings")
    told = {a.question: a.answer for a in result.answers}
    assert "La = 4.7 mH, by a meter" in told["What are resistance and inductance of the winding?"]
    assert "Ra = 2.2" in told["What are resistance and inductance of the winding?"]
    friction = told["What does the friction do as the power rises (Fig. D-22)?"]
    first, last = (float(x) for x in re.findall(r"([\d.]+) (?:N m s )?at", friction))
    Ki = result.values["constants"]["Ki"]["value"]
    assert (first, last) == pytest.approx((Ki * currents[0] / 3.0, Ki * currents[-1] / 17.0), rel=0.006)
    assert "of dry friction" in friction
    for item, found in paired(result).asked[:3]:
        assert found, item.text
