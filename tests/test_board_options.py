"""Between command and motor: pull-ups, watchdog, thermal shutdown, brake and standby; and the edges of the encoder."""

from __future__ import annotations

import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from firmware_model import Board, Instruments, load_plant
from firmware_model.layout import OMEGA, THETA
from firmware_model.motor import Motor
from firmware_model.plants import Plant, make_plant
from firmware_model.thermal import PARAMETERS, ThermalShutdown

BASE = {"supply_V": 9.0, "R_ohm": 5.5, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.487, "J_kgm2": 3e-3, "coulomb_Nm": 0.02}
FORWARD, REVERSE, BRAKE, STANDBY = (1, 0), (0, 1), (1, 1), (0, 0)


def plant(**more: object) -> Plant:
    return make_plant({**BASE, **more}, "test")


def report(duty_pct: float, bits: tuple[int, int]) -> bytes:
    return struct.pack("<fBB58x", duty_pct, *bits)


def drive(board: Board, command: bytes | None, steps: int) -> np.ndarray:
    """Unwrapped counts seen over a number of steps with one report repeated."""
    pos = np.array([struct.unpack_from("<BH", board.step(command))[1] for _ in range(steps)])
    return np.concatenate(([pos[0]], pos[0] + np.cumsum((np.diff(pos) + 360) % 720 - 360)))


# ---- the board around the bridge -----------------------------------------------------------------------------------


@pytest.mark.parametrize("bits", [FORWARD, REVERSE, BRAKE, STANDBY])
def test_without_pull_ups_the_motor_coasts_in_every_setting(bits: tuple[int, int]) -> None:
    board = Board(plant(pull_ups=False))
    meters = Instruments(board)
    at_rest = drive(board, report(100.0, bits), 100)
    assert np.ptp(at_rest) == 0
    meters.disturb(0.2)
    drive(board, report(100.0, bits), 100)
    meters.disturb(0.0)
    coasting = np.diff(drive(board, report(100.0, bits), 40))
    assert meters.current_A == 0.0
    told = Board(plant())
    Instruments(told).disturb(0.2)
    drive(told, report(0.0, STANDBY), 100)
    Instruments(told).disturb(0.0)
    np.testing.assert_array_equal(np.diff(drive(told, report(0.0, STANDBY), 40)), coasting)


def test_a_watchdog_brakes_when_nothing_valid_has_come_for_100_ms() -> None:
    watched, plain = Board(plant(watchdog={})), Board(plant())
    for board in (watched, plain):
        drive(board, report(60.0, FORWARD), 200)
    seen, held = (drive(board, None, 200) for board in (watched, plain))
    # 20 steps held, and one more until what changed shows as counts
    np.testing.assert_array_equal(seen[:20], held[:20])
    assert np.diff(seen)[25] < np.diff(held)[25]
    assert np.ptp(seen[-50:]) == 0
    assert np.diff(held).min() > 3
    again = drive(watched, report(60.0, FORWARD), 200)
    assert np.diff(again)[-1] > 3  # the next valid report ends it


def test_a_watchdog_is_not_fed_by_what_is_no_report() -> None:
    board = Board(plant(watchdog={"timeout_s": 0.05}))
    drive(board, report(60.0, FORWARD), 200)
    assert np.ptp(drive(board, b"\xff" * 63, 200)[-50:]) == 0


def test_the_bridge_opens_when_hot_and_closes_after_it_has_cooled() -> None:
    """Stalled at 1.64 A its 1 ohm warms the bridge by 156 K/W with 10 s: 170 degrees come after 4.3 s."""
    board = Board(plant(thermal_shutdown={}))
    lab = Instruments(board)
    lab.hang_mass(1.0, 0.0556)
    current = []
    for _ in range(3000):
        board.step(report(100.0, FORWARD))
        current.append(lab.current_A)
    flowing = np.array(current) > 0.1
    stall_A = 9.0 / 5.5
    rise_K = 156.0 * stall_A**2
    opens_s = -10.0 * math.log1p(-(170.0 - 25.0) / rise_K)
    closes_s = opens_s + 10.0 * math.log((170.0 - 25.0) / (130.0 - 25.0))
    edges = 0.005 * (np.flatnonzero(np.diff(flowing.astype(int))) + 1)
    assert edges[0] == pytest.approx(opens_s, abs=0.03)
    assert edges[1] == pytest.approx(closes_s, abs=0.05)
    assert len(edges) >= 3  # and again, as long as it is asked for


def test_a_motor_that_runs_free_never_warms_its_bridge_to_opening() -> None:
    guarded, plain = Board(plant(thermal_shutdown={})), Board(plant())
    for command in (report(100.0, FORWARD), report(100.0, REVERSE)):
        np.testing.assert_array_equal(drive(guarded, command, 1000), drive(plain, command, 1000))


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(-5.0, 5.0), min_size=1, max_size=60), st.floats(0.01, 30.0))
def test_temperature_stays_between_ambient_and_what_the_largest_loss_would_keep(
    currents: list[float], span_s: float
) -> None:
    values = {q.key: q.default for q in PARAMETERS}
    bridge = ThermalShutdown(values)
    top_C = 25.0 + 156.0 * max(i * i for i in currents)
    for current_A in currents:
        was_open = bridge.open
        bridge.pass_time(current_A, span_s)
        assert 25.0 - 1e-9 <= bridge.temperature_C <= top_C + 1e-9
        if bridge.temperature_C > 170.0:
            assert bridge.open
        elif bridge.temperature_C < 130.0:
            assert not bridge.open
        else:
            assert bridge.open == was_open


# ---- brake and standby ---------------------------------------------------------------------------------------------


def time_constant_s(bits: tuple[int, int]) -> float:
    """From the wire: how fast the appendix's motor without load runs down from 60 %, viscous friction alone."""
    board = Board(load_plant("nxt_no_load"))
    drive(board, report(60.0, FORWARD), 400)
    counts = drive(board, report(0.0, bits), 4000)
    rest = counts[-1] - counts
    span = 20 if bits == BRAKE else 400
    # what remains falls as exp(-t/tau); two readings of it, one count fine
    return float(span * 0.005 / math.log(rest[4] / rest[4 + span]))


def test_brake_runs_down_with_the_electromechanical_time_constant_and_standby_with_friction_s() -> None:
    assert time_constant_s(BRAKE) == pytest.approx(0.081, rel=0.04)
    assert time_constant_s(STANDBY) == pytest.approx(1.78, rel=0.02)


@settings(max_examples=30, deadline=None)
@given(
    st.dictionaries(
        st.sampled_from(["stribeck", "asymmetric", "static", "drag", "position", "viscous"]),
        st.floats(0.1, 1.0),
        max_size=4,
    ),
    st.floats(20.0, 100.0),
    st.sampled_from([1.0, -1.0]),
)
def test_energy_never_appears_from_friction(sizes: dict[str, float], duty_pct: float, way: float) -> None:
    effects = {
        "stribeck": ("stribeck_friction", lambda x: {"extra_Nm": 0.02 * x, "stribeck_speed_rad_s": 2.0 * x}),
        "asymmetric": ("asymmetric_coulomb_friction", lambda x: {"forward_Nm": 0.02 * x, "reverse_Nm": 0.0}),
        "static": ("static_friction", lambda x: {"extra_Nm": 0.03 * x}),
        "drag": ("quadratic_drag", lambda x: {"drag_Nms2": 1e-4 * x}),
        "position": ("position_dependent_friction", lambda x: {"ratio": 0.9 * x, "order": 3.0}),
    }
    chosen = {effects[name][0]: effects[name][1](x) for name, x in sizes.items() if name in effects}
    motor = Motor(plant(effects=chosen, B_Nms=1e-3 * sizes.get("viscous", 0.0)))
    motor.run_many(np.ones(60, np.int64), np.full(60, way * duty_pct), 0.005)
    _, states = motor.run_many(np.zeros(800, np.int64), np.zeros(800), 0.005)
    energy = 0.5 * 3e-3 * states[:, OMEGA] ** 2
    assert energy[0] > 0.0
    assert np.all(np.diff(energy) <= 1e-15)
    assert np.all(np.diff(states[:, THETA]) * way >= 0.0)


# ---- the encoder ---------------------------------------------------------------------------------------------------

UNEVEN = {"slot_errors": {"slot_counts": 0.2, "phase_counts": 0.2, "seed": 7}}


def edges_of_a_turn(machine: Plant, bits: tuple[int, int] = FORWARD) -> tuple[np.ndarray, np.ndarray]:
    """Times between edges (s) and the counts after them, of two slow turns at constant speed, in steps of 50 us."""
    motor = Motor(machine)
    sign = 1.0 if bits == FORWARD else -1.0
    motor.run_many(np.ones(200, np.int64), np.full(200, sign * 60.0), 0.005)
    counts, _ = motor.run_many(np.ones(30000, np.int64), np.full(30000, sign * 60.0), 5e-5)
    changes = np.flatnonzero(np.diff(counts))
    return 5e-5 * changes, counts[changes + 1]


def test_uneven_edges_return_every_turn_and_differ_by_seed() -> None:
    found = {}
    for seed in (7, 8):
        times, counts = edges_of_a_turn(plant(effects={"slot_errors": {**UNEVEN["slot_errors"], "seed": seed}}))
        assert np.all(np.diff(counts) == 1)
        period = times[720:1440] - times[:720]
        assert np.ptp(period) < 2e-4  # every edge comes again after a turn
        even = np.interp(np.arange(720), [0, 720], [times[0], times[720]])
        off = (times[:720] - even) * 720 / (times[720] - times[0])
        order = np.argsort(counts[:720] % 720)
        found[seed] = (off - off.mean())[order]
        assert 0.1 < found[seed].std() < 0.25
        assert np.abs(found[seed]).max() < 0.6
        slots = found[seed].reshape(180, 4)
        assert np.ptp(slots.mean(axis=0)) > 0.03  # the phases' part is the same in every slot
        assert slots.mean(axis=1).std() > 0.05  # the slots' part differs
    assert abs(np.corrcoef(found[7], found[8])[0, 1]) < 0.5


def test_an_even_disc_has_even_edges() -> None:
    times, counts = edges_of_a_turn(plant())
    assert np.all(np.diff(counts) == 1)
    assert np.ptp(np.diff(times)) < 1.1e-4


@settings(max_examples=30, deadline=None)
@given(
    st.lists(
        st.tuples(st.floats(0.0, 100.0, width=32), st.sampled_from([FORWARD, REVERSE, BRAKE, STANDBY])), max_size=6
    ),
    st.sampled_from(
        [{}, UNEVEN, {"encoder_eccentricity": {"level_deg": 2.0}}, {**UNEVEN, "missed_counts": {"ratio": 0.1}}]
    ),
    st.integers(0, 1000),
)
def test_counts_change_by_whole_edges_one_after_the_other(
    script: list[tuple[float, tuple[int, int]]], effects: dict, seed: int
) -> None:
    """Seen every 50 us no edge is skipped, DIR is that of the last one, and POS is the count within the turn."""
    board = Board(plant(effects=effects), seed=seed)
    last, direction = 0, 0
    for duty_pct, bits in script:
        for k in range(200):
            told = board.step(report(duty_pct, bits) if k == 0 else None, span_s=5e-5 if k else 0.05)
            down, pos = struct.unpack_from("<BH", told)
            moved = (pos - last + 360) % 720 - 360
            if k > 1:
                assert abs(moved) <= 1
                direction = direction if moved == 0 else int(moved < 0)
                assert down == direction
            else:
                direction = down
            last = pos


@settings(max_examples=20, deadline=None)
@given(st.floats(5.0, 100.0), st.integers(20, 200), st.integers(0, 100))
def test_forward_then_back_returns_the_count_over_an_uneven_disc_too(duty: float, steps: int, seed: int) -> None:
    board = Board(plant(effects=UNEVEN, coulomb_Nm=0.0), seed=None)
    board_counts = drive(board, report(duty, FORWARD), steps)
    drive(board, report(0.0, BRAKE), 600)
    drive(board, report(duty, REVERSE), steps)
    counts = drive(board, report(0.0, BRAKE), 600)
    assert abs((counts[-1] - board_counts[0] + 360) % 720 - 360) <= 1


def test_after_a_reset_the_counter_starts_at_zero_counting_up() -> None:
    board = Board(plant())
    drive(board, report(60.0, REVERSE), 300)
    drive(board, report(0.0, BRAKE), 200)
    assert struct.unpack_from("<BH", board.step(None)) != (0, 0)
    board.reset()
    assert struct.unpack_from("<BH", board.step(None)) == (0, 0)
    assert np.ptp(drive(board, None, 50)) == 0
