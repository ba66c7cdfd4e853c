"""The simulated board as seen through the wire: bytes in, bytes out."""

from __future__ import annotations

import math
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from places import PACKAGES

from firmware_model import Board, Instruments, load_plant, plant_names
from firmware_model.layout import CURRENT, LOAD_OMEGA, LOAD_THETA, OMEGA, THETA
from firmware_model.motor import Motor
from firmware_model.plants import Plant, make_plant
from firmware_model.report import compare_value

BASE = {"supply_V": 9.0, "R_ohm": 5.5, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.487, "J_kgm2": 3e-3, "coulomb_Nm": 0.02}


def plant(effects: dict[str, dict[str, object]] | None = None, **constants: float) -> Plant:
    return make_plant({**BASE, **constants, "effects": effects or {}}, "test")


def report(duty_pct: float, c3: int, c4: int) -> bytes:
    return struct.pack("<fBB58x", duty_pct, c3, c4)


def drive(board: Board, command: bytes | None, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Unwrapped counts and direction bits seen over a number of steps with one report repeated."""
    seen = [struct.unpack_from("<BH", board.step(command)) for _ in range(steps)]
    pos = np.array([p for _, p in seen])
    jumps = (np.diff(pos) + 360) % 720 - 360
    return pos[0] + np.concatenate(([0], np.cumsum(jumps))), np.array([d for d, _ in seen])


FORWARD, REVERSE, BRAKE, STANDBY = (1, 0), (0, 1), (1, 1), (0, 0)


def test_telemetry_is_direction_then_position_in_64_bytes() -> None:
    board = Board(load_plant("default"), seed=1)
    first = board.step(None)
    assert len(first) == 64
    assert first == bytes(64)  # counting from 0, direction up


def test_truth_table_through_the_wire() -> None:
    for bits, sign in ((FORWARD, 1), (REVERSE, -1), (BRAKE, 0), (STANDBY, 0)):
        counts, directions = drive(Board(load_plant("default")), report(40.0, *bits), 200)
        moved = counts[-1] - counts[0]
        assert np.sign(moved) == sign, bits
        if sign:
            assert abs(moved) > 200
            assert directions[-1] == (1 if sign < 0 else 0)


def test_position_wraps_at_both_ends() -> None:
    for bits in (FORWARD, REVERSE):
        board = Board(load_plant("default"))
        pos = [struct.unpack_from("<BH", board.step(report(100.0, *bits)))[1] for _ in range(600)]
        assert 0 <= min(pos) < 15
        assert 705 < max(pos) <= 719
        assert sum(abs(b - a) > 360 for a, b in zip(pos, pos[1:], strict=False)) >= 5


def test_direction_is_stale_at_rest() -> None:
    board = Board(load_plant("default"))
    drive(board, report(40.0, *REVERSE), 100)
    counts, directions = drive(board, report(0.0, *BRAKE), 200)
    assert counts[-1] == counts[-100]
    assert directions[-1] == 1


def test_compare_value_is_truncated_and_unclamped() -> None:
    assert compare_value(40.0) == 1440
    assert compare_value(0.0277) == 0
    assert compare_value(0.0278) == 1
    assert compare_value(100.0) == 3600
    assert compare_value(250.0) == 9000
    assert compare_value(-40.0) == 0
    assert compare_value(math.nan) == 0
    assert compare_value(math.inf) == compare_value(1e30) == 0xFFFF


def test_duty_over_100_stays_fully_on() -> None:
    full, _ = drive(Board(load_plant("default")), report(100.0, *FORWARD), 200)
    over, _ = drive(Board(load_plant("default")), report(400.0, *FORWARD), 200)
    assert np.array_equal(full, over)


@pytest.mark.parametrize("bad", [b"", b"\x00" * 6, bytes(63), bytes(65)])
def test_outputs_hold_while_nothing_valid_arrives(bad: bytes) -> None:
    held, told = Board(load_plant("default")), Board(load_plant("default"))
    drive(held, report(50.0, *FORWARD), 50)
    drive(told, report(50.0, *FORWARD), 50)
    quiet, _ = drive(held, None, 50)
    junk, _ = drive(told, bad, 50)
    assert np.array_equal(quiet, junk)
    assert quiet[-1] - quiet[0] > 150


def test_command_acts_from_the_step_that_latches_it() -> None:
    board = Board(plant(coulomb_Nm=0.0))
    before = board.step(report(100.0, *FORWARD))
    assert struct.unpack_from("<BH", before)[1] == 0
    late = Board(plant(coulomb_Nm=0.0))
    late.step(None)
    early, _ = drive(board, None, 20)
    delayed, _ = drive(late, report(100.0, *FORWARD), 21)
    assert np.array_equal(early, delayed[1:])


def test_default_plant_reaches_170_rpm_at_9_volts_with_60_milliampere() -> None:
    board = Board(load_plant("default"), seed=5)
    meters = Instruments(board)
    drive(board, report(100.0, *FORWARD), 400)
    counts, _ = drive(board, None, 1001)
    rpm = (counts[-1] - counts[0]) / 720.0 / 5.0 * 60.0
    assert rpm == pytest.approx(170.0, abs=0.2)
    assert meters.current_A == pytest.approx(0.060, abs=0.0005)
    assert meters.voltage_V == pytest.approx(9.0, abs=1e-6)


def test_appendix_set_reaches_its_speed_at_2_volts() -> None:
    board = Board(load_plant("nxt_no_load"))
    counts, _ = drive(board, report(100.0 * 2.0 / 4.5, *FORWARD), 1000)
    speed = (counts[-1] - counts[-401]) * math.radians(0.5) / 2.0
    assert speed == pytest.approx(7.64, abs=0.01)
    lag = 999 * 0.005 - (counts[-1] - counts[0]) * math.radians(0.5) / speed
    winding_s = 0.0047 / 2.27  # adds its own lag
    assert lag == pytest.approx(0.081 + winding_s, abs=0.004)


def test_stall_against_a_hanging_mass() -> None:
    board = Board(load_plant("default"))
    bench = Instruments(board)
    bench.hang_mass(0.54 / 9.81, 1.0)  # beyond the 0.536 N m it can lift; dry friction keeps it from falling
    drive(board, report(100.0, *FORWARD), 400)
    assert bench.current_A == pytest.approx(9.0 / 5.515, rel=0.001)


@pytest.mark.parametrize("winding", [0.0, 0.015])
def test_held_below_break_away_it_does_not_creep(winding: float) -> None:
    machine = plant(L_H=winding, coulomb_Nm=0.02)
    breakaway_pct = machine.percent_of_torque(0.02)
    motor = Motor(machine)
    motor.run_many(np.ones(200, np.int64), np.full(200, 20.0), 0.005)
    motor.run_many(np.ones(400, np.int64), np.full(400, 0.9 * breakaway_pct), 0.005)
    _, states = motor.run_many(np.ones(20000, np.int64), np.full(20000, 0.9 * breakaway_pct), 0.005)
    assert np.all(states[:, THETA] == states[0, THETA])
    assert np.all(states[:, OMEGA] == 0.0)
    _, moving = motor.run_many(np.ones(200, np.int64), np.full(200, 1.02 * breakaway_pct), 0.005)
    assert moving[-1, THETA] > moving[0, THETA]


def test_brake_stops_soon_and_standby_runs_down_on_friction_alone() -> None:
    machine = plant(coulomb_Nm=0.004)
    ran = {}
    for name, bits in (("brake", BRAKE), ("standby", STANDBY)):
        board = Board(machine)
        drive(board, report(60.0, *FORWARD), 300)
        counts, _ = drive(board, report(0.0, *bits), 2000)
        ran[name] = (counts[-1] - counts[0]) / 2.0
    speed = machine.gain_deg_s_per_pct * (60.0 - machine.percent_of_torque(0.004))
    coast = math.degrees(math.radians(speed) ** 2 * machine.J_kgm2 / (2.0 * 0.004))
    assert ran["brake"] < 1.1 * speed * machine.tau_s
    assert ran["standby"] == pytest.approx(coast, rel=0.01)


def test_standby_stops_the_current_and_brake_reverses_it() -> None:
    board = Board(load_plant("default"))
    bench = Instruments(board)
    drive(board, report(80.0, *FORWARD), 300)
    drive(board, report(0.0, *STANDBY), 1)
    assert bench.current_A == 0.0
    drive(board, report(80.0, *FORWARD), 300)
    drive(board, report(0.0, *BRAKE), 2)
    assert bench.current_A < -0.3
    assert bench.voltage_V == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("side", ["encoder_after_gap", "encoder_before_gap"])
@pytest.mark.parametrize("load_kgm2", [0.0, 1e-3])
def test_play_shows_as_a_lost_motion_behind_the_gap(side: str, load_kgm2: float) -> None:
    effect = {"backlash": {"gap_deg": 6.0, "side": side, "load_inertia_kgm2": load_kgm2}}
    motor = Motor(plant(effect, coulomb_Nm=0.03))
    duties = np.concatenate((np.full(200, 12.0), np.full(200, -12.0), np.full(200, 12.0)))
    _, states = motor.run_many(np.ones(600, np.int64), duties, 0.005)
    twist = np.degrees(states[:, THETA] - states[:, LOAD_THETA])
    assert np.max(np.abs(twist)) <= 3.0 + 1e-9
    assert twist[199] == pytest.approx(3.0, abs=1e-9)
    assert twist[399] == pytest.approx(-3.0, abs=1e-9)


@pytest.mark.parametrize("load_kgm2", [0.0, 1e-3])
def test_energy_only_leaves(load_kgm2: float) -> None:
    """In standby with no load nothing feeds the machine: its kinetic energy never grows."""
    effect = {"backlash": {"gap_deg": 6.0, "load_inertia_kgm2": load_kgm2}}
    machine = plant(effect, coulomb_Nm=0.002)
    motor = Motor(machine)
    motor.run_many(np.ones(100, np.int64), np.full(100, 50.0), 0.005)
    _, states = motor.run_many(np.zeros(4000, np.int64), np.zeros(4000), 0.005)
    energy = (machine.J_kgm2 - load_kgm2) * states[:, OMEGA] ** 2 + load_kgm2 * states[:, LOAD_OMEGA] ** 2
    assert energy[0] > 0.0
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] == pytest.approx(0.0, abs=1e-4 * energy[0])


def test_same_seed_same_bench_and_seeds_differ_within_one_count() -> None:
    def run(seed: int | None) -> np.ndarray:
        return drive(Board(plant(coulomb_Nm=0.0), seed=seed), report(5.03, *FORWARD), 103)[0]

    assert np.array_equal(run(7), run(7))
    runs = np.array([run(seed) for seed in range(8)])
    assert np.max(np.ptp(runs, axis=0)) == 1


def test_current_follows_at_once_without_inductance() -> None:
    motor = Motor(plant(coulomb_Nm=1.0))
    motor.run(1, 50.0, 0.005)
    assert motor.current_A == pytest.approx(4.5 / 5.5)
    with_winding = Motor(plant(coulomb_Nm=1.0, L_H=0.015))
    with_winding.run(1, 50.0, 0.015 / 5.5)
    assert with_winding.current_A == pytest.approx(4.5 / 5.5 * (1.0 - math.exp(-1.0)), rel=1e-8)
    assert with_winding._y[CURRENT] == with_winding.current_A


BYTES = st.one_of(
    st.none(),
    st.binary(max_size=70),
    st.builds(
        report,
        st.floats(width=32, allow_nan=True, allow_infinity=True),
        st.integers(0, 255),
        st.integers(0, 255),
    ),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(BYTES, max_size=60), st.integers(0, 1000))
def test_any_sequence_of_reports_leaves_the_task_alive(reports: list[bytes | None], seed: int) -> None:
    board = Board(load_plant("default"), seed=seed)
    last = 0
    for one in reports:
        telemetry = board.step(one)
        direction, pos = struct.unpack_from("<BH", telemetry)
        assert len(telemetry) == 64
        assert direction in (0, 1)
        assert 0 <= pos <= 719
        moved = (pos - last + 360) % 720 - 360
        assert abs(moved) <= 11  # no more than full speed allows
        last = pos


@settings(max_examples=25, deadline=None)
@given(st.floats(5.0, 100.0), st.integers(20, 200))
def test_forward_then_back_returns_the_count(duty: float, steps: int) -> None:
    """Without friction the machine is symmetric: the same command reversed, then braked, ends where it began."""
    board = Board(plant(coulomb_Nm=0.0))
    drive(board, report(duty, *FORWARD), steps)
    drive(board, report(0.0, *BRAKE), 600)
    drive(board, report(duty, *REVERSE), steps)
    counts, _ = drive(board, report(0.0, *BRAKE), 600)
    assert abs(counts[-1] % 720) in (0, 719)


def test_importing_the_package_is_cheap() -> None:
    code = "import sys, firmware_model; assert 'numpy' not in sys.modules and 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGES)


def test_the_board_never_imports_the_host() -> None:
    code = (
        "import sys, firmware_model as f; f.Board(f.load_plant('default')).step(None); f.draw(1); f.reveal(1);"
        "assert not any(m.split('.')[0] == 'fiohost' for m in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=PACKAGES)


def test_every_shipped_plant_makes_a_board() -> None:
    assert {"default", "ideal", "nxt_no_load"} <= set(plant_names())
    for name in plant_names():
        Board(load_plant(name)).step(report(30.0, *FORWARD))


def test_fast_decay_starts_only_above_half_duty() -> None:
    """HARDWARE: the same motor starts at a few percent with the off-phase shorted, above about half with it open."""

    def starts(name: str) -> int:
        for duty in range(1, 100):
            counts, _ = drive(Board(load_plant(name)), report(float(duty), *FORWARD), 60)
            if counts[-1] - counts[0] > 2:
                return duty
        return 100

    assert starts("default") <= 5
    assert 48 <= starts("nxt_fast_decay") <= 60
    slow, _ = drive(Board(load_plant("default")), report(100.0, *FORWARD), 300)
    fast, _ = drive(Board(load_plant("nxt_fast_decay")), report(100.0, *FORWARD), 300)
    assert np.array_equal(slow, fast)  # fully on there is no off-phase


def test_end_of_travel_holds_and_lets_go() -> None:
    board = Board(plant({"hard_stop": {"angle_deg": 30.2}}))
    counts, _ = drive(board, report(40.0, *FORWARD), 300)
    assert counts[-1] == counts[-100] == 60
    back, _ = drive(board, report(40.0, *REVERSE), 100)
    assert back[-1] < back[0] - 100


def test_missed_counts_are_lost_for_good() -> None:
    whole, _ = drive(Board(plant()), report(60.0, *FORWARD), 400)
    lossy, _ = drive(Board(plant({"missed_counts": {"ratio": 0.05}})), report(60.0, *FORWARD), 400)
    assert (lossy[-1] - lossy[0]) / (whole[-1] - whole[0]) == pytest.approx(0.95, abs=0.001)


def test_eccentric_disc_shows_an_error_that_returns_every_turn() -> None:
    straight, _ = drive(Board(plant()), report(50.0, *FORWARD), 800)
    bent, _ = drive(Board(plant({"encoder_eccentricity": {"level_deg": 2.0}})), report(50.0, *FORWARD), 800)
    error = (bent - straight) / 2.0
    assert np.max(error) == pytest.approx(2.0, abs=0.6)
    assert np.min(error) == pytest.approx(-2.0, abs=0.6)
