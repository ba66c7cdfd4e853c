"""What small mistakes would change unseen: each test here stands for one that nothing else noticed."""

from __future__ import annotations

import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from boards import WatchedTransport, bench_on
from lines import patient
from test_real_time import HandClock, TimedBoard

from fiohost.bench import deadband
from fiohost.bench.limits import Limiter
from fiohost.bench.line import Line
from fiohost.bench.loop import Bench
from fiohost.bench.rest import Shaft
from fiohost.bench.signals import RandomSteps
from fiohost.bench.unwrap import Unwrapper, unwrap_counts
from fiohost.bench.writer import LogWriter
from fiohost.errors import LimitError
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import ANGLE, MEAN_SPEED, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.transport.profile import Limits, TargetProfile
from fiohost.wire.messages import Command


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_travel_limit_holds_both_ways(sign: float) -> None:
    limiter = Limiter(Limits(travel_deg=90.0), 0.005)
    command = Command.drive(sign * 30.0)
    limiter.allow(command, 10.0, 0.0)
    limiter.allow(command, 10.0 + sign * 90.0, 0.005)
    with pytest.raises(LimitError, match="travel limit"):
        limiter.allow(command, 10.0 + sign * 90.5, 0.01)
    with bench_on(WatchedTransport(), travel_deg=90.0) as bench, pytest.raises(LimitError, match="travel limit"):
        bench.drive(sign * 60.0, 5.0)


def test_the_brake_goes_out_often_on_a_line_that_may_lose_it() -> None:
    """Once a tick for as long as it takes to see the shaft stand, though it stands from the first."""
    clock = HandClock()
    board = TimedBoard(clock)
    sent: list[bytes] = []
    with Bench(board, patient("hid-assumed"), clock=clock) as bench:
        bench.drive(5.0, 0.1)
        board.send = sent.append  # type: ignore[method-assign]
    assert len(sent) >= 20
    assert {report[:6] for report in sent} == {bytes.fromhex("00 00 00 00 01 01")}


def test_a_log_is_on_the_disk_when_it_is_closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    synced: list[tuple[int, int]] = []
    monkeypatch.setattr(os, "fsync", lambda fd: synced.append((os.fstat(fd).st_ino, os.fstat(fd).st_size)))
    writer = LogWriter(tmp_path / "run.csv", {})
    writer.row(0.0, 1.0, 1, 0, 5, 0)
    writer.close()
    found = (tmp_path / "run.csv").stat()
    assert synced == [(found.st_ino, found.st_size)]  # with all that it holds


@pytest.mark.parametrize("turn", [4, 720, 721])
def test_the_shortest_path_is_taken_for_every_step_there_is(turn: int) -> None:
    for step in range(-turn + 1, turn):
        shortest = min((abs(step + n * turn), step + n * turn) for n in (-1, 0, 1))[0]
        for begin in (0, turn // 3, turn - 1):
            unwrap = Unwrapper(turn).update
            unwrap(begin)
            moved = unwrap((begin + step) % turn) - begin
            assert abs(moved) == shortest, (begin, step)
            assert (moved - step) % turn == 0
    rng = np.random.default_rng(1)
    pos = rng.integers(0, turn, 2000).astype(float)
    unwrap = Unwrapper(turn).update
    assert [unwrap(int(p)) for p in pos] == unwrap_counts(pos, turn).astype(int).tolist()


def test_a_mean_speed_is_the_difference_of_the_angles_at_its_ends() -> None:
    """To the last digits: the same motion, asked for as angles and as mean speeds."""
    times = np.arange(400) * 0.01
    duty = 40.0 * np.sign(np.sin(5.0 * times))
    model = Flat.of(Model.parse("linear+coulomb_friction"))
    zeros = np.zeros(times.size)
    made = {kind: make_record("m", times, duty, zeros, kind=kind, at_rest=True) for kind in (ANGLE, MEAN_SPEED)}
    angle, speed = (free_output(made[kind], model, Start(0.0, 0.0)) for kind in (ANGLE, MEAN_SPEED))
    assert np.abs(speed).max() > 100.0
    assert np.diff(angle) / 0.01 == pytest.approx(speed[1:], rel=1e-6, abs=1e-6)


@pytest.mark.parametrize("seed", [0, 2**63 - 1])
def test_a_seed_may_be_the_smallest_and_the_largest_there_is(seed: int) -> None:
    steps = RandomSteps(duration_s=2.0, low=-80.0, high=80.0, hold_min_s=0.1, hold_max_s=0.3, seed=seed)
    values = steps.values(np.arange(0.0, 2.0, 0.005))
    assert len(np.unique(values)) > 5
    assert np.abs(values).max() <= 80.0


def test_a_shaft_that_goes_to_and_fro_by_one_count_stands_and_by_two_it_does_not() -> None:
    clock = HandClock()
    with Bench(TimedBoard(clock), patient("hid-assumed"), clock=clock) as bench:
        for counts, stands in ((1, True), (2, False)):
            shaft = Shaft(bench._line)
            for k in range(100):
                shaft.note(k, counts * (k % 2))
            assert shaft.stands == stands


def test_reports_that_are_passed_over_are_counted_once_each() -> None:
    clock = HandClock()
    line = Line(TimedBoard(clock), patient("hid-assumed"), clock)
    for _ in range(4):
        clock.time_s += 0.0125  # two and a half steps of the board
        line.tick()
        assert line.statistics.passed_over == line.transport.passed_over
    assert line.statistics.passed_over > 3


def test_a_host_that_slept_does_not_hurry_through_the_ticks_of_that_time() -> None:
    class Slept(HandClock):
        late_s = 0.0

        def wait_until(self, deadline_s: float) -> float:
            self.time_s = max(self.time_s, deadline_s) + self.late_s
            return self.late_s

    clock = Slept()
    line = Line(WatchedTransport(), TargetProfile.load(), clock)
    line.transport.open()
    for late_s, next_s in ((0.9, 0.005 + 0.005), (1.1, 0.91 + 1.1 + 0.005)):
        clock.late_s = late_s
        line.tick()
        assert line._due_s == pytest.approx(next_s, abs=0.006), late_s
        line._due_s = clock.time_s + 0.005


def test_a_slow_ramp_begins_well_below_where_a_fast_one_started(monkeypatch: pytest.MonkeyPatch) -> None:
    onset = SimpleNamespace(duty_pct=-10.0)
    monkeypatch.setattr(deadband, "_ramp", lambda *_: onset)
    assert deadband._coarse(SimpleNamespace(), False, 100.0) == 6.0
    onset.duty_pct = 1.0
    assert deadband._coarse(SimpleNamespace(), True, 100.0) == 0.0
