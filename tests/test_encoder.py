"""The simulated encoder: levels, the decoder's four states, and edges told with their times."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace

import pytest

from firmware_model import Board, load_plant
from firmware_model.encoder import decode, levels_of
from firmware_model.layout import LEVELS
from firmware_model.motor import Motor
from firmware_model.quadrature import EdgeMotor

A_LEADS = [0b00, 0b01, 0b11, 0b10]  # A + 2 B while counting up, four states round and round
DRIVEN, BRAKE = 1, 2


def counted(levels: Sequence[int]) -> tuple[int, int]:
    """Counts and invalid changes of a decoder that sees these levels one after the other."""
    seen = [decode(before, after) for before, after in itertools.pairwise(levels)]
    return sum(count for count, _ in seen), sum(invalid for _, invalid in seen)


def test_the_disc_shows_four_states_in_which_a_leads_upwards() -> None:
    assert [levels_of(state) for state in range(8)] == A_LEADS * 2
    assert [levels_of(state) for state in range(-1, -5, -1)] == [A_LEADS[k % 4] for k in range(-1, -5, -1)]


def test_every_change_of_one_level_is_a_count_in_its_direction() -> None:
    up = [A_LEADS[k % 4] for k in range(9)]
    assert counted(up) == (8, 0)
    assert counted(up[::-1]) == (-8, 0)


def test_a_reversal_within_a_state_takes_back_what_it_counted() -> None:
    for start in range(4):
        here, there = levels_of(start), levels_of(start + 1)
        assert counted([here, there, here]) == (0, 0)
        assert counted([here, there, here, there, levels_of(start + 2)]) == (2, 0)


def test_a_glitch_of_one_level_counts_nothing_and_of_both_is_invalid() -> None:
    for levels in range(4):
        for bit in (1, 2):
            assert counted([levels, levels ^ bit, levels]) == (0, 0)
        assert counted([levels, levels ^ 3]) == (0, 1)
        assert counted([levels, levels ^ 3, levels]) == (0, 2)
        assert counted([levels, levels]) == (0, 0)


def follow(motor: EdgeMotor, steps: int) -> list[int]:
    """A decoder of its own on the edges of a motor driven both ways; its count after each step."""
    levels, count, counts = motor.levels, 0, []
    duties = (40.0, -70.0, 0.0, 90.0, -8.0)
    for k in range(steps):
        duty = duties[k // 100 % len(duties)]
        came = motor.run_to(0.005 * (k + 1), (DRIVEN if duty else BRAKE, duty))
        times = [edge.time_s for edge in came]
        assert times == sorted(times)
        assert all(0.005 * k - 1e-9 <= time_s <= 0.005 * (k + 1) + 1e-9 for time_s in times)
        for edge in came:
            change, invalid = decode(levels, edge.levels)
            assert (abs(change), invalid) == (1, 0), "each edge changes one level"
            levels, count = edge.levels, count + change
        counts.append(count)
    return counts


@pytest.mark.parametrize("plant", ["default", "nxt_fast_decay", "nxt_elevator"])
def test_the_edges_told_are_the_counts_of_the_simulated_board(plant: str) -> None:
    edges, plain = EdgeMotor(load_plant(plant)), Motor(load_plant(plant))
    counts = follow(edges, 1000)
    for k, count in enumerate(counts):
        duty = (40.0, -70.0, 0.0, 90.0, -8.0)[k // 100 % 5]
        plain.run(DRIVEN if duty else BRAKE, duty, 0.005)
        assert abs(plain.count - count) <= 1, k  # where an edge lies within the integration's error
    assert max(counts) - min(counts) > 200
    assert edges.count == counts[-1]
    assert edges.invalid == 0


def test_lost_edges_do_not_show_in_the_levels() -> None:
    plant = load_plant("default")
    whole, lossy = EdgeMotor(plant), EdgeMotor(replace(plant, effects={"missed_counts": {"ratio": 0.1}}))
    assert follow(lossy, 100)[-1] == lossy.count
    assert lossy.count == pytest.approx(0.9 * follow(whole, 100)[-1], abs=1.0)


def test_an_edge_lies_where_the_disc_meets_it() -> None:
    """At an even speed edges come at even times, whatever the looks at the disc."""
    motor = EdgeMotor(load_plant("ideal"))
    motor.run_to(2.0, (DRIVEN, 50.0))
    came = motor.run_to(2.1, None)
    gaps = [b.time_s - a.time_s for a, b in itertools.pairwise(came)]
    assert len(gaps) > 30
    assert max(gaps) - min(gaps) < 1e-8


def test_a_motor_taken_back_goes_the_same_way_again() -> None:
    motor = EdgeMotor(load_plant("default"), within_count=0.3)
    motor.run_to(0.5, (DRIVEN, 60.0))
    saved, count = motor.save(), motor.count
    first = motor.run_to(0.52, (DRIVEN, -30.0))
    motor.restore(saved)
    assert (motor.count, motor.time_s) == (count, 0.5)
    assert motor.run_to(0.52, (DRIVEN, -30.0)) == first
    assert first


def test_a_reset_counter_starts_anew_and_the_disc_stays() -> None:
    board = Board(load_plant("default"), seed=3)
    motor = board._motor
    motor.run(DRIVEN, 60.0, 0.3)
    levels = int(motor._m[LEVELS])
    motor.reset_counter()
    assert (motor.count, int(motor._m[LEVELS])) == (0, levels)
