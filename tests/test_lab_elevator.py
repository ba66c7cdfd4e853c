"""The elevator: its buttons, its building, its car on model and target, and what is judged of a move."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from fiohost.bench.connect import connect
from fiohost.cli.main import cli
from fiohost.control.metrics import step_figures
from fiohost.errors import ConfigError
from fiohost.labs.constants import TEXT
from fiohost.labs.elevator.buttons import Buttons, Press, parse_presses, pressed
from fiohost.labs.elevator.car import TOP_FLOOR, Design, FloatArray, Record, car_model, floor_cm, moves
from fiohost.labs.elevator.experiment import Plan, _run, live, shared_limit
from fiohost.labs.elevator.ride import ByButtons, ByKeys, ideal, up_and_down
from fiohost.labs.elevator.search import simulate
from fiohost.labs.printed import printed

TICK_S = 0.005


def floors_by(presses: Sequence[Press], until_s: float) -> list[int]:
    """The floors asked for at each tick."""
    state, found = Buttons(), []
    for k in range(round(until_s / TICK_S)):
        state = state.after(k * TICK_S, *(pressed(presses, button, k * TICK_S) for button in ("up", "down")))
        found.append(state.floor)
    return found


# ---- buttons -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("held_s", "floor"), [(0.02, 1), (0.3, 1), (0.49, 1), (0.51, 2), (0.9, 2), (5.0, 2)])
def test_a_short_press_is_one_floor_and_a_long_one_two(held_s: float, floor: int) -> None:
    assert floors_by([Press("up", 0.1, held_s)], 6.0)[-1] == floor


def test_the_second_floor_comes_after_half_a_second() -> None:
    found = floors_by([Press("up", 1.0, 2.0)], 4.0)
    assert (found[199], found[200], found[299], found[301]) == (0, 1, 1, 2)


def test_presses_beyond_the_building_are_not_owed() -> None:
    top = floors_by([Press("up", 1.0 * i, 0.7) for i in range(6)] + [Press("down", 8.0)], 9.0)
    assert max(top) == TOP_FLOOR == 6
    assert top[-1] == TOP_FLOOR - 1
    assert floors_by([Press("down", 1.0), Press("up", 2.0)], 3.0)[-1] == 1


def test_both_buttons_at_once_stay() -> None:
    assert set(floors_by([Press("up", 1.0, 1.0), Press("down", 1.0, 1.0)], 3.0)) == {0}


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.booleans(), st.booleans()), max_size=200))
def test_no_presses_ask_for_a_floor_outside(pattern: list[tuple[bool, bool]]) -> None:
    state = Buttons(3)
    for k, (up, down) in enumerate(pattern):
        before, state = state, state.after(0.1 * k, up, down)
        assert 0 <= state.floor <= TOP_FLOOR
        assert abs(state.floor - before.floor) <= 1


@pytest.mark.parametrize(
    "wrong", ["sideways@1", "up", "up@x", "up@-1", "up@nan", "up@1:0", "up@1:99", "up@1e9", "", " , "]
)
def test_presses_that_make_no_sense_are_refused(wrong: str) -> None:
    with pytest.raises(ConfigError):
        parse_presses(wrong)


def test_presses_are_read_in_order() -> None:
    assert parse_presses("down@5:0.7, UP@1") == (Press("up", 1.0), Press("down", 5.0, 0.7))


# ---- what is judged ------------------------------------------------------------------------------------------------


def record(ref_cm: FloatArray, height_cm: FloatArray) -> Record:
    return Record(TICK_S * np.arange(len(ref_cm), dtype=np.float64), ref_cm, height_cm, np.zeros(len(ref_cm)))


def test_two_changes_within_a_second_are_one_move() -> None:
    ref = np.repeat([0.0, 5.0, 10.0, 0.0], [200, 100, 400, 400])
    found = list(moves(record(ref, ref)))
    assert [(m.begin_s, m.from_cm, m.to_cm, m.floors) for m in found] == [(1.0, 0.0, 10.0, 2), (3.5, 10.0, 0.0, 2)]
    assert found[0].figures.settling_5_s == pytest.approx(0.5, abs=0.01)
    assert list(moves(record(np.zeros(50), np.zeros(50)))) == []


def test_each_criterion_is_judged_by_itself() -> None:
    times = np.arange(600) * TICK_S
    ref = np.where(times < 0.5, 0.0, 5.0)
    on = np.maximum(times - 0.5, 0.0)

    def faults(height: FloatArray) -> list[str]:
        (move,) = moves(record(ref, height))
        return move.faults

    assert faults(5.0 * (1.0 - np.exp(-on / 0.15))) == []
    assert faults(4.85 * (1.0 - np.exp(-on / 0.15))) == ["error"]
    assert "settling" in faults(5.0 * (1.0 - np.exp(-on / 0.5)))
    assert faults(5.0 * (1.0 - np.exp(-on / 0.15) * np.cos(12.0 * on))) == ["overshoot"]


def test_the_weight_of_the_car_leaves_the_error_of_the_formula() -> None:
    for kp in (2.0, 5.0):
        run = simulate(car_model(), Design(kp), TICK_S, 0.0)
        by_hand = 1.375 * (0.124 * 9.81 * 0.01375) * 2.27 / (0.25 * kp)  # Eq. D-34: 0.0167 N m, which the text rounds
        (up, _) = moves(run)
        assert up.figures.steady_state_error == pytest.approx(by_hand, rel=0.03)


def test_gains_in_volts_per_radian_are_those_of_the_text() -> None:
    found = Design(2.0, 0.3, 60.0).settings(4.5)
    assert found.kp_pct_per_deg == pytest.approx(2.0 * math.pi / 180.0 / 4.5 * 100.0)
    assert found.ki_pct_per_deg_s / found.kp_pct_per_deg == pytest.approx(0.15)
    assert (found.kind, found.limit_pct) == ("pi", 60.0)


# ---- the lab -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, object]:
    """The lab as it is run from the command line, with few gains."""
    folder = tmp_path_factory.mktemp("elevator")
    args = [
        "--target",
        "sim:nxt_elevator",
        "--no-diagnose",
        "--gains",
        "2,5",
        "--ki",
        "0.2",
        "--powers",
        "40",
        "--kd",
        "0.2",
        "--ride-kp",
        "2.5",
        "--ride-power",
        "35",
    ]
    args += ["--presses", "up@1,up@3:0.7,up@6:0.7,up@9:0.7,down@12", "--report", str(folder), "--json", "-"]
    result = CliRunner().invoke(cli, ["lab", "elevator", *args])
    assert result.exit_code == 0, result.stderr
    found: dict[str, object] = json.loads(result.stdout)
    pictures = ("p", "pi", "power", "pd", "found", "ride")
    assert {p.name for p in folder.glob("*.png")} == {f"elevator_{name}.png" for name in pictures}
    return found


def test_model_and_target_go_together(shown: dict[str, object]) -> None:
    values = shown["values"]
    assert isinstance(values, dict)
    for key in ("p", "pi", "power", "pd", "found"):
        rows = values[key]
        pairs = [
            (a, b)
            for a in rows
            for b in rows
            if (a["on"], b["on"]) == ("model", "target")
            and all(a[k] == b[k] for k in ("move", "kp_V_per_rad", "ki_V_per_rad_s", "kd_V_s_per_rad", "power_pct"))
        ]
        assert len(pairs) == len(rows) / 3  # ideal, model, target
        for model, target in pairs:
            assert target["overshoot_pct"] == pytest.approx(model["overshoot_pct"], abs=0.6)
            assert target["settling_5_s"] == pytest.approx(model["settling_5_s"], abs=0.03)
            assert target["error_cm"] == pytest.approx(model["error_cm"], abs=0.02)


def test_what_is_found_on_the_model_meets_the_criteria_on_the_target(shown: dict[str, object]) -> None:
    values = shown["values"]
    assert isinstance(values, dict)
    assert [row["meets"] for row in values["found"]] == [True] * 6
    assert not any(row["meets"] for row in values["p"] if row["kp_V_per_rad"] == 5.0)


def test_the_ride_ends_within_the_building(shown: dict[str, object]) -> None:
    values = shown["values"]
    assert isinstance(values, dict)
    ride = values["ride"]
    assert ride["floors_asked"] == [0, 1, 2, 3, 4, 5, 6, 5]
    assert [m["to_floor"] for m in ride["moves"] if m["on"] == "target"] == [1, 3, 5, 6, 5]
    assert all(m["meets"] for m in ride["moves"] if abs(m["to_floor"] - m["from_floor"]) == 1)


def test_options_that_make_no_sense_are_refused(tmp_path: Path) -> None:
    for args, word in (
        (["--gains", "2,x"], "--gains"),
        (["--ride-power", "101"], "--ride-power"),
        (["--gains", ",".join(str(i) for i in range(1, 30))], "at most"),
        (["--presses", "left@1"], "press"),
        (["--live"], "terminal"),
    ):
        result = CliRunner().invoke(cli, ["lab", "elevator", *args, "--report", str(tmp_path)])
        assert result.exit_code == 1, args
        assert word in result.stderr


def test_the_texts_block_diagram_gives_the_texts_figures() -> None:
    """Table D-12: overshoot, settling about the 5 cm asked for, rise and error, by an integration of its own."""
    motor = TEXT["elevator"]
    for kp, figures in {
        2.0: (6.2, 0.367, 0.251, 0.106),
        3.0: (9.8, 0.532, 0.226, 0.071),
        5.0: (14.1, 0.517, 0.218, 0.042),
    }.items():
        (up, down) = moves(ideal(motor, Design(kp), 1.0))
        f = up.figures
        assert (
            round(f.overshoot_pct, 1),
            round(f.settling_5_s, 3),
            round(f.rise_s, 3),
            round(f.steady_state_error, 3),
        ) == figures
        printed_row = next(row for row in printed("nxt_d13") if row.table == "D-12" and row.has(kp=kp))
        assert f.overshoot_pct == pytest.approx(printed_row.overshoot_pct, abs=0.4)
        assert f.settling_5_s == pytest.approx(printed_row.settling_5_s, abs=0.013)
        assert f.rise_s == pytest.approx(printed_row.rise_s, abs=0.005)
        assert down.begin_s == pytest.approx(2.0, abs=1e-9)

        def rates(t: float, x: FloatArray, kp: float = kp) -> list[float]:
            amps, speed, angle = x
            volts = min(max(kp * (5.0 / 1.375 - angle), -4.5), 4.5)
            torque = 0.25 * min(max(amps, -1.0), 1.0) - 0.017
            return [(volts - 2.27 * amps - 0.25 * speed) / 0.0047, (torque - 0.002 * speed) / 0.0024, speed]

        times = np.linspace(0.0, 2.0, 8001)
        exact = 1.375 * solve_ivp(rates, (0.0, 2.0), [0.0] * 3, "RK45", times, rtol=1e-8, atol=1e-10).y[2]
        other = step_figures(times, exact, 0.0, 5.0, True)
        assert f.overshoot_pct == pytest.approx(other.overshoot_pct, abs=0.01)
        assert f.settling_5_s == pytest.approx(other.settling_5_s, abs=5e-4)


def test_the_texts_own_rows_stand_beside_the_same_gains(shown: dict[str, object]) -> None:
    tables = shown["tables"]
    assert isinstance(tables, list)
    text = {t["title"][:9]: [row[2] for row in t["rows"] if str(row[2]).startswith("text")] for t in tables}
    assert text["P control"] == ["text D-12, simulated", "text D-13, measured"] * 2
    assert text["PI contro"] == ["text D-14, measured"] * 2  # up and down
    assert text["Limited p"] == ["text D-15, measured"] * 2
    assert text["PD contro"] == []


@pytest.mark.parametrize("limit_A", [1.0, None])
def test_a_current_limit_holds_for_model_and_target_alike(limit_A: float | None, tmp_path: Path) -> None:
    """With 1 A the largest gain overshoots more, up and down, on both."""
    with connect("sim:nxt_elevator", seed=1) as bench:
        plan = Plan(gains=(5.0,), integral_gains=(), powers_pct=(), derivative_gains=(), current_limit_A=limit_A)
        run = _run(bench, plan, Design(5.0), up_and_down, tmp_path / "run.csv")
        assert shared_limit(bench, plan) == limit_A
    model, target = (list(moves(record)) for record in (run.model, run.target))
    assert [m.way for m in target] == ["up", "down"]
    for a, b in zip(model, target, strict=True):
        assert a.figures.overshoot_pct == pytest.approx(b.figures.overshoot_pct, abs=0.4)
    down = target[1].figures.overshoot_pct
    assert (down > 20.0) if limit_A else (down < 18.0)
    with connect("sim:sealed", seed=1) as bench:
        assert shared_limit(bench, plan) is None


# ---- keys ----------------------------------------------------------------------------------------------------------


def test_a_ride_by_keys_ends_by_its_key(tmp_path: Path) -> None:
    script = {100: ["u", "u"], 500: ["U"], 900: ["down", "x", "page down"], 1300: ["q"]}
    asked = iter(range(100_000))
    demand = ByKeys(lambda: script.get(next(asked), []))
    with connect("sim:nxt_elevator") as bench:
        result = live(bench, Plan(), demand, tmp_path, lambda tick: None)
    assert result.values["ride"]["floors_asked"] == [0, 1, 2, 3, 4, 3, 2, 1]
    assert demand.floor == 1
    assert len(demand.presses) == 5


def test_a_scripted_ride_ends_by_itself() -> None:
    demand = ByButtons([Press("up", 1.0, 0.7)])
    heights = [demand(0.1 * k) for k in range(60)]
    assert heights[5:20] == [0.0] * 5 + [floor_cm(1)] * 5 + [floor_cm(2)] * 5
    assert floor_cm(TOP_FLOOR) == 30.0  # the text's height limit
    assert heights[48:] == [None] * 12
