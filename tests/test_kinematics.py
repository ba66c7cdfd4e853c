"""Faults of the raw data are found without a model of the motor, and sound data has none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, TICK_S, measure, multisine, steps, truth_model
from short_runs import closed_loop, logs_of, staircase
from short_runs import multisine as tones

from fiohost.checks.finding import Finding
from fiohost.checks.kinematics import check
from fiohost.checks.said import Said, said_by
from fiohost.estimation.record import MEAN_SPEED, SPEED, Record, make_record, record_from_log


def found_in(*records: Record, said: Said | None = None) -> list[Finding]:
    return check(records, [said or Said()] * len(records))[0]


def record(seed: int, seconds: float = 12.0) -> Record:
    rng = np.random.default_rng(seed)
    return measure(truth_model(), steps(seconds, rng), rng)


def again(
    source: Record, *, y: np.ndarray | None = None, times_s: np.ndarray | None = None, keep: np.ndarray | None = None
) -> Record:
    """The record with other readings or times, or with some rows only."""
    rows = np.ones(len(source), dtype=bool) if keep is None else keep
    return make_record(
        source.name,
        (source.excitation.times_s if times_s is None else times_s)[rows],
        source.excitation.duties_pct[1:][rows],
        (source.y if y is None else y)[rows],
        quantum=QUANTUM_DEG,
        sample_time_s=TICK_S,
        command_delay_s=TICK_S,
        at_rest=True,
    )


@pytest.mark.parametrize("seed", range(6))
def test_sound_data_of_any_motor_has_no_fault(seed: int) -> None:
    rng = np.random.default_rng(seed)
    truth = truth_model(
        values={
            "linear.gain_deg_s_per_pct": float(rng.uniform(1.0, 30.0)),
            "linear.tau_s": float(10.0 ** rng.uniform(-2.3, -0.3)),
            "coulomb_friction.level_pct": float(rng.uniform(0.0, 8.0)),
        }
    )
    stairs = np.repeat([8.0, 30.0, 80.0, 15.0, 0.0, -8.0, -30.0, -80.0], 200)
    noise = rng.choice((-60.0, 60.0), 1600)  # a new command every tick is as rough as commands can be
    for duty in (multisine(8.0, rng), steps(8.0, rng), steps(8.0, rng, 0.02), stairs, noise):
        assert found_in(measure(truth, duty, rng)) == []


@pytest.mark.parametrize("effect", ["backlash", "hard_stop", "static_friction", "shaft_compliance", "gravity_load"])
def test_what_a_motor_can_do_is_no_fault(effect: str) -> None:
    rng = np.random.default_rng(7)
    truth = truth_model().with_effect(effect)
    assert [f for shape in (multisine, steps) for f in found_in(measure(truth, shape(8.0, rng), rng))] == []


def test_logs_of_the_bench_have_no_fault(tmp_path: Path) -> None:
    for log in logs_of("sim", tmp_path, (staircase(0.5), tones(5.0), closed_loop(5.0))):
        assert found_in(record_from_log(log), said=said_by(log)) == [], log.path.name


def wrapped(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    for row, turns in ((700, 1.0), (1100, -1.0), (1500, 2.0)):
        y[row:] += 360.0 * turns
    return y


def register(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y[900:] += 65536 * QUANTUM_DEG
    return y


def repeated(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    fast = np.flatnonzero(np.abs(np.diff(y)) > 6.5 * QUANTUM_DEG)
    rows = fast[(fast > 20) & (fast < len(y) - 20)][::25] + 1
    y[rows] = y[rows - 1]
    return y


def spiked(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y[300:2100:200] += 20 * QUANTUM_DEG
    return y


def lost(y: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y[1234:] -= 15 * QUANTUM_DEG
    return y


@pytest.mark.parametrize(
    ("fault", "name", "count"),
    [(wrapped, "wrap_mistake", 3), (register, "wrap_mistake", 1), (spiked, "spike", 9), (lost, "jump", 1)],
)
def test_a_wrong_reading_is_named_counted_and_placed(
    fault: Callable[[np.ndarray, np.random.Generator], np.ndarray], name: str, count: int
) -> None:
    source = record(3)
    y = fault(source.y.copy(), np.random.default_rng(4))
    (finding,) = found_in(again(source, y=y))
    assert (finding.name, finding.count, finding.harm) == (name, count, True)
    changed = np.flatnonzero(np.diff(y - source.y) != 0)[0] + 1
    assert finding.times_s[0] == pytest.approx(changed * TICK_S, abs=TICK_S)


def test_readings_that_repeat_at_speed_are_told_from_a_shaft_that_stands() -> None:
    source = record(3)
    y = repeated(source.y.copy(), np.random.default_rng(4))
    truth = int(np.sum(y != source.y))
    named = {f.name: f for f in found_in(again(source, y=y))}
    assert truth >= 8
    assert 0.7 * truth <= named["repeated_sample"].count <= truth
    assert "drop these rows" in named["repeated_sample"].advice


def test_a_single_spike_among_thousands_of_counts_is_a_note() -> None:
    source = record(5)
    y = source.y.copy()
    y[800] += 12 * QUANTUM_DEG
    (finding,) = found_in(again(source, y=y))
    assert (finding.name, finding.harm) == ("spike", False)


def test_missing_ticks_harm_where_the_command_changed_in_them() -> None:
    source = record(6)
    duty = source.excitation.duties_pct[1:]
    change = int(np.flatnonzero(np.diff(duty))[3])
    for first, harm in ((change + 20, False), (change - 5, True)):
        keep = np.ones(len(source), dtype=bool)
        keep[first : first + 10] = False
        (finding,) = found_in(again(source, keep=keep))
        assert (finding.name, finding.count, finding.harm) == ("missing_ticks", 1, harm)
        assert "10 ticks" in finding.advice


def test_time_stamps_off_the_grid_harm_unless_the_readings_follow_them() -> None:
    rng, source = np.random.default_rng(8), record(8)
    late = rng.uniform(-0.3, 0.3, len(source)) * TICK_S
    late[0] = 0.0
    times = source.excitation.times_s
    (finding,) = found_in(again(source, times_s=times + late))
    assert (finding.name, finding.harm) == ("irregular_time_stamps", True)
    really = np.floor(np.interp(times + late, times, source.y + 0.5 * QUANTUM_DEG) / QUANTUM_DEG) * QUANTUM_DEG
    (finding,) = found_in(again(source, y=really, times_s=times + late))
    assert (finding.name, finding.harm) == ("irregular_time_stamps", False)
    (finding,) = found_in(again(source, y=really))  # sampled irregularly, stamped as if not
    assert (finding.name, finding.harm) == ("sampling_jitter", True)


def test_the_direction_bit_is_held_against_the_movement() -> None:
    source = record(9)
    way = np.sign(np.diff(source.y, prepend=source.y[0]))
    bit = np.where(way < 0, 1.0, 0.0)
    for row in range(1, len(bit)):
        if way[row] == 0:
            bit[row] = bit[row - 1]
    assert found_in(source, said=Said(direction=bit)) == []
    (finding,) = found_in(source, said=Said(direction=1.0 - bit))
    assert "wrong way round" in finding.advice
    assert "direction_bit" in [s.name for s in check([source], [Said()])[1]]


def test_a_log_closes_only_where_it_says_so() -> None:
    source = record(10)
    assert [s.name for s in check([source], [Said()])[1]] == ["direction_bit", "not_closed"]
    (finding,) = found_in(source, said=Said(returns=True))
    assert finding.name == "not_closed"
    there_and_back = np.concatenate((source.y, source.y[::-1]))
    closed = replace(source, y=there_and_back[: len(source)])
    closed.y[-1] = closed.y[0]
    assert "not_closed" not in [f.name for f in found_in(closed, said=Said(returns=True))]


def test_a_smooth_command_with_a_flat_top_was_limited() -> None:
    rng = np.random.default_rng(11)
    duty = np.clip(1.5 * multisine(12.0, rng), -60.0, 60.0)
    (finding,) = found_in(measure(truth_model(), duty, rng))
    assert (finding.name, finding.harm) == ("clipped_command", False)


def turning(duties: list[float], seed: int = 12, effect: dict[str, float] | None = None) -> Record:
    """Steady speeds, four seconds each, by a motor that may have a load over its turn."""
    rng = np.random.default_rng(seed)
    truth = truth_model().with_effect("gravity_load", effect) if effect else truth_model()
    made = measure(truth, np.repeat(duties, 800), rng)
    return replace(made, y=made.y + rng.uniform(0.0, QUANTUM_DEG, len(made)))


def eccentric(source: Record, level_deg: float, order: int) -> Record:
    wrong = source.y + level_deg * np.sin(np.radians(order * source.y))
    return replace(source, y=np.floor(wrong / QUANTUM_DEG) * QUANTUM_DEG)


@pytest.mark.parametrize(("level_deg", "order"), [(1.0, 1), (0.5, 15)])
def test_an_error_of_the_encoder_keeps_its_size_at_any_speed(level_deg: float, order: int) -> None:
    (finding,) = found_in(eccentric(turning([30.0, 60.0, 90.0, -40.0, -80.0]), level_deg, order))
    assert (finding.name, finding.harm) == ("order_locked", True)
    assert f" {order} times a turn" in finding.advice
    one_speed = [eccentric(turning([40.0, 0.0, 40.0]), level_deg, order)]
    (finding,) = found_in(*one_speed)
    assert (finding.name, finding.harm) == ("order_locked", False)
    both = found_in(*one_speed, replace(eccentric(turning([80.0, 0.0, 80.0]), level_deg, order), name="faster"))
    assert [f.harm for f in both] == [True, True]


def test_a_load_over_the_turn_is_no_error_of_the_encoder() -> None:
    loaded = eccentric(turning([30.0, 60.0, 90.0, -40.0, -80.0], effect={"level_pct": 1.0}), 0.0, 1)
    assert found_in(loaded) == []
    slow = eccentric(turning([40.0, 0.0, 40.0], effect={"level_pct": 2.0}), 0.0, 1)
    fast = eccentric(turning([90.0, 0.0, 90.0], effect={"level_pct": 2.0}), 0.0, 1)
    assert found_in(slow, replace(fast, name="fast")) == []


def test_a_speed_that_leaps_is_no_counter_that_wrapped() -> None:
    """By the 65536 steps of its resolution that a counter has: a shaft thrown back by what it ran against does so."""
    source, quantum = record(3), 0.01
    speed = np.round(np.gradient(source.y, TICK_S) / quantum) * quantum
    speed[900] += 65536 * quantum
    made = make_record(
        "speed", source.excitation.times_s, source.excitation.duties_pct[1:], speed, kind=SPEED, unit="deg/s",
        quantum=quantum,
    )  # fmt: skip
    assert [f.name for f in found_in(made)] == ["spike"]


def test_speed_logs_are_checked_as_counts_an_interval() -> None:
    source = record(13)
    speed = np.diff(source.y, prepend=source.y[0]) / TICK_S
    made = make_record(
        "speed", source.excitation.times_s, source.excitation.duties_pct[1:], speed, kind=MEAN_SPEED, unit="deg/s",
        quantum=QUANTUM_DEG / TICK_S, command_delay_s=TICK_S,
    )  # fmt: skip
    assert found_in(made) == []
    speed[1000] += 30 * QUANTUM_DEG / TICK_S
    (finding,) = found_in(replace(made, y=speed))
    assert (finding.name, finding.count) == ("spike", 1)
