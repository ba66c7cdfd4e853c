"""Who watches a run, reading by reading: the guards of the motor, of the host, and those who look on."""

from __future__ import annotations

import math
import signal
import sys
import threading
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import pytest

from fiohost.bench.guard import MotorGuard
from fiohost.bench.host import HostWatch
from fiohost.bench.watcher import SWITCH_S, Watcher, quick_switches
from fiohost.errors import GuardError, HostError
from fiohost.transport.profile import Guards
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

TICK_S = 0.0078125  # 128 a second: sums of it are exact


def checked(guard: MotorGuard, readings: list[tuple[int, float, float | None]]) -> tuple[int, str]:
    """How many readings (tick, duty or None for standby, angle) are let pass, and what is said then."""
    for done, (k, angle, duty) in enumerate(readings):
        try:
            guard.check(k, STANDBY_COMMAND if duty is None else Command.drive(duty), angle)
        except GuardError as exc:
            return done, str(exc)
    return len(readings), ""


def guard(counts_per_rev: int = 720, patience: float | None = None, **guards: float) -> MotorGuard:
    more = {} if patience is None else {"patience": patience}
    return MotorGuard(Guards().changed(guards), TICK_S, counts_per_rev, **more)


# ---- a shaft that stands -------------------------------------------------------------------------------------------


def test_full_duty_on_a_shaft_that_stands_lasts_as_long_as_is_said() -> None:
    """To the tick: the heat of the first reading's duty is there at the second."""
    for duty, seconds in ((100.0, 1.0), (-100.0, 1.0), (50.0, 4.0)):
        done, said = checked(guard(stall_s=1.0), [(k, 9.0, duty) for k in range(2000)])
        assert done == seconds * 128 + 1
        assert f"driven with {duty:g} %, longer than guards.stall_s = 1 s of full duty" in said
    assert checked(guard(patience=2.0, stall_s=1.0), [(k, 9.0, 100.0) for k in range(2000)])[0] == 257
    assert checked(guard(patience=1.0, stall_s=1.0), [(k, 9.0, 100.0) for k in range(2000)])[0] == 129
    assert checked(guard(stall_s=1.0), [(5 * k, 9.0, 100.0) for k in range(2000)])[0] == 26  # ticks that were missed


def test_a_shaft_stands_that_moves_no_further_than_four_counts() -> None:
    for counts, done in ((4, 129), (5, 2000)):
        readings = [(k, 0.5 * counts * (k // 100), 100.0) for k in range(2000)]
        assert checked(guard(stall_s=1.0), readings)[0] == (done if counts == 4 else 2000)
    for step_deg, done in ((70.0, 129), (80.0, 2000)):  # of a coarse encoder four counts are 72 deg
        readings = [(k, step_deg * (k // 100), 100.0) for k in range(2000)]
        assert checked(guard(counts_per_rev=20, stall_s=1.0), readings)[0] == done
    to_and_fro = [(k, 90.0 * (k % 2), 100.0) for k in range(2000)]
    assert checked(guard(counts_per_rev=16, stall_s=1.0, speed_deg_s=1e9), to_and_fro)[0] == 129


def test_a_rest_cools_a_tenth_as_fast_and_never_below_nothing() -> None:
    def pulses(rest: int, first: int = 0) -> int:
        readings = [(k, 9.0, None) for k in range(first)]
        for _ in range(40):
            at = len(readings)
            readings += [(at + k, 9.0, 100.0) for k in range(32)]
            at = len(readings)
            readings += [(at + k, 9.0, 0.0) for k in range(rest)]
        return checked(guard(stall_s=1.0), readings)[0]  # type: ignore[arg-type]

    assert pulses(0) == 129
    assert pulses(320) == 40 * 352  # a quarter of a second's heat goes in two and a half
    assert 4 * 192 < pulses(160) < 7 * 192  # half of it does
    assert pulses(0, first=5000) == 5000 + 129  # a long rest saves nothing up


def test_the_duty_that_counts_is_the_one_that_the_board_had() -> None:
    readings = [(0, 9.0, 100.0)] + [(k, 9.0, 0.0) for k in range(1, 300)]
    assert checked(guard(stall_s=0.05), readings)[0] == 300
    assert checked(guard(stall_s=0.05), [(0, 9.0, 0.0), (50, 9.0, 100.0), (51, 9.0, 0.0), (60, 9.0, 0.0)])[0] == 4
    assert checked(guard(stall_s=0.05), [(0, 9.0, 0.0), (1, 9.0, 100.0), (60, 9.0, 0.0)])[0] == 2
    assert checked(guard(stall_s=0.05), [(0, 9.0, 0.0), (1, 9.0, None), (60, 9.0, 100.0), (61, 9.0, 0.0)])[0] == 4


# ---- readings that cannot be ---------------------------------------------------------------------------------------


def test_five_jumps_in_twenty_readings_are_no_single_damaged_ones() -> None:
    def jumps(*at: int, size: float = 100.0, every: int = 1) -> tuple[int, str]:
        angle, readings = 0.0, []
        for k in range(60):
            angle += size if k in at else 0.0
            readings.append((every * k, angle, None))
        return checked(guard(speed_deg_s=10_000.0), readings)  # type: ignore[arg-type]

    assert jumps(5, 6, 7, 8) == (60, "")
    done, said = jumps(5, 6, 7, 8, 9)
    assert done == 9
    assert "5 of the last 9 readings are jumps, up to 12800 deg/s, beyond guards.speed_deg_s = 10000" in said
    assert jumps(5, 10, 15, 20, 25)[0] == 60
    assert jumps(5, 10, 15, 20, 24)[0] == 24
    assert "5 of the last 20 readings" in jumps(30, 31, 32, 33, 34)[1]
    assert jumps(5, 6, 7, 8, 9, size=78.125)[0] == 60  # 10,000 deg/s exactly
    assert jumps(5, 6, 7, 8, 9, every=2)[0] == 60  # in twice the time
    assert jumps(5, 6, 7, 8, 9, size=-100.0)[0] == 9
    assert jumps(0, 1, 2, 3, 4)[0] == 60  # where it is first seen is no jump


# ---- a shaft that turns the wrong way ------------------------------------------------------------------------------


def back(duty: float, speeds_deg_s: list[float], before: float = 0.0, **guards: float) -> tuple[int, str]:
    """Readings from a duty on, of a shaft with those speeds tick by tick; *before* is its speed until then."""
    sign = math.copysign(1.0, duty)
    angle, readings = 50.0, [(0, 50.0, 0.0)]
    for speed in [before] * 40:
        angle += sign * speed * TICK_S
        readings.append((len(readings), angle, 0.0))
    first = len(readings)
    for speed in speeds_deg_s:
        angle += sign * speed * TICK_S
        readings.append((len(readings), angle, duty))
    done, said = checked(guard(stall_s=1e9, **guards), readings)
    return done - first, said


@pytest.mark.parametrize("duty", [50.0, -50.0])
def test_a_shaft_that_runs_against_a_strong_duty_ever_faster_is_stopped(duty: float) -> None:
    """200 deg/s the wrong way: beyond 180 deg after 116 of these ticks."""
    done, said = back(duty, [-200.0] * 300)
    assert done == 116
    assert f"(181 deg back at {duty:g} %, {-math.copysign(200.0, duty):.0f} deg/s and faster)" in said
    assert back(duty, [-200.0] * 300, wrong_way_deg=90.0)[0] == 58
    assert back(duty, [200.0] * 10 + [-200.0] * 300)[0] == 125  # from the furthest place
    assert back(0.4 * duty, [-200.0] * 300)[0] == 116  # 20 % are strong
    assert back(0.39 * duty, [-200.0] * 300)[0] == 300


def test_a_shaft_that_only_runs_down_is_let_run() -> None:
    """No faster than 60 deg/s beyond what it ran, over ten ticks, when the duty came on."""
    assert back(50.0, [-66.0] * 600)[0] == 600
    assert back(50.0, [-67.0] * 600)[0] < 600
    assert back(50.0, [-300.0] * 300, before=-300.0)[0] == 300
    assert back(50.0, [-366.0] * 300, before=-300.0)[0] == 300
    assert back(50.0, [-367.0] * 300, before=-300.0)[0] < 300
    assert back(50.0, [-60.0] * 600, before=300.0)[0] == 600
    assert back(50.0, [-60.5] * 600, before=300.0)[0] < 600


def test_each_strong_duty_is_judged_from_where_it_came_on() -> None:
    swings = [(k, 80.0 * math.sin(k / 20.0), 50.0 if k // 60 % 2 else -50.0) for k in range(600)]
    assert checked(guard(stall_s=1e9), swings)[0] == 600  # type: ignore[arg-type]
    down = [(k, -1.5 * k, 50.0 if k % 60 else 0.0) for k in range(600)]  # 90 deg from one to the next
    assert checked(guard(stall_s=1e9), down)[0] == 600  # type: ignore[arg-type]
    done, _ = checked(guard(stall_s=1e9), [(k, -1.5 * k, 50.0) for k in range(600)])
    assert done == 121


def test_a_wrong_reading_shifts_the_angle_and_is_no_motion() -> None:
    readings = [(k, -200.0 * (k >= 100), 50.0) for k in range(300)]
    assert checked(guard(stall_s=1e9), readings)[0] == 300  # type: ignore[arg-type]


def test_a_speed_is_that_over_ten_ticks() -> None:
    made = guard(stall_s=1e9)
    for k in range(30):
        made.check(k, BRAKE_COMMAND, float(k if k < 20 else 20 + 2 * (k - 20)))
    assert made._speed_deg_s() == pytest.approx(19.0 / 10.0 / TICK_S)
    alone = guard()
    alone.check(5, BRAKE_COMMAND, 7.0)
    assert alone._speed_deg_s() == 0.0
    alone.check(6, BRAKE_COMMAND, 8.0)
    assert alone._speed_deg_s() == 128.0
    alone.check(9, BRAKE_COMMAND, 8.0)
    assert alone._speed_deg_s() == 32.0


# ---- the host ------------------------------------------------------------------------------------------------------


def host(now_s: list[float], guardian: Any = None, *, can_reopen: bool = True, real: bool = True) -> HostWatch:
    line: Any = SimpleNamespace(
        clock=SimpleNamespace(real=real, now_s=lambda: now_s[0]),
        guardian=guardian,
        profile=SimpleNamespace(guards=Guards(gap_s=0.25)),
        transport=SimpleNamespace(can_reopen=can_reopen),
    )
    return HostWatch(line)


def guardian(*, has_braked: bool = False, answers: bool = True) -> Any:
    return SimpleNamespace(has_braked=has_braked, answers=lambda now_s: answers)


@pytest.mark.parametrize(("can_reopen", "real"), [(False, True), (True, False)])
def test_a_board_that_waits_for_its_host_needs_no_watch(can_reopen: bool, real: bool) -> None:
    now_s = [0.0]
    watch = host(now_s, guardian(has_braked=True, answers=False), can_reopen=can_reopen, real=real)
    now_s[0] = 100.0
    before = signal.getsignal(signal.SIGALRM)
    with watch.alarmed():
        watch.turn()
        assert signal.getsignal(signal.SIGALRM) is before


def test_a_guardian_that_had_to_brake_or_does_not_answer_ends_the_run() -> None:
    with pytest.raises(HostError, match=r"held fiohost up for 0\.25 s in mid-run"):
        host([0.0], guardian(has_braked=True)).turn()
    with pytest.raises(HostError, match="the guardian of the motor does not answer"):
        host([0.0], guardian(answers=False)).turn()
    host([0.0], guardian()).turn()
    host([0.0]).turn()
    now_s = [0.0]
    watch = host(now_s)
    for _ in range(3):
        now_s[0] += 0.25
        watch.turn()
    now_s[0] += 0.375
    with pytest.raises(HostError, match=r"held fiohost up for 0\.38 s in mid-run, longer than the 0\.25 s"):
        watch.turn()


def test_a_controller_that_does_not_come_back_is_rung_out_and_the_alarm_is_put_back() -> None:
    before = signal.getsignal(signal.SIGALRM)
    now_s = [0.0]
    watch = host(now_s)
    with watch.alarmed():
        now_s[0] = 0.75
        with pytest.raises(HostError, match=r"held fiohost up for 0\.75 s"):
            signal.raise_signal(signal.SIGALRM)
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0.0, 0.0)
    watch._ring(0, None)  # one that comes too late
    set_s: list[tuple[int, float]] = []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("signal.setitimer", lambda which, seconds: set_s.append((which, seconds)))
        now_s[0] = watch._last_s
        watch.turn()
    assert set_s == []  # it rings only within


def test_outside_the_main_thread_there_is_no_alarm() -> None:
    before = signal.getsignal(signal.SIGALRM)
    seen: list[object] = []

    def run() -> None:
        with host([0.0]).alarmed():
            seen.append(signal.getsignal(signal.SIGALRM) is before)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [True]


# ---- those who look on ---------------------------------------------------------------------------------------------


def test_threads_give_way_soon_where_it_is_asked_and_as_before_afterwards() -> None:
    before = sys.getswitchinterval()
    with quick_switches(False):
        assert sys.getswitchinterval() == before
    with suppress(ZeroDivisionError), quick_switches(True):
        assert sys.getswitchinterval() == pytest.approx(SWITCH_S) == pytest.approx(0.0005)
        _ = 1 / 0
    assert sys.getswitchinterval() == before


def test_one_who_looks_on_too_slowly_misses_ticks_and_holds_nobody_up() -> None:
    """A hundred wait; what fails is told at the next tick."""
    go, shown = threading.Event(), list[int]()

    def look(tick: Any) -> None:
        go.wait()
        shown.append(tick)

    watcher = Watcher(look)
    for k in range(300):
        watcher(k)  # type: ignore[arg-type]
    go.set()
    watcher.close()
    assert shown[0] == 0
    assert 100 <= len(shown) <= 102
    failing = Watcher(lambda tick: [][0])
    failing(0)  # type: ignore[arg-type]
    with pytest.raises(IndexError):
        failing.close()
    with pytest.raises(IndexError):
        failing(1)  # type: ignore[arg-type]
    stuck = threading.Event()
    leaves = Watcher(lambda tick: stuck.wait())
    leaves(0)  # type: ignore[arg-type]
    leaves.leave()  # waits for nothing
    stuck.set()
