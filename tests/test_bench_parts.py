"""A bench's runs turn by turn, and what they keep and say."""

from __future__ import annotations

import logging
import signal
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from boards import WatchedTransport, bench_on

import fiohost
from fiohost.bench import loop
from fiohost.bench.connect import connect
from fiohost.bench.experiment import Experiment
from fiohost.bench.limits import Limiter
from fiohost.bench.loop import Bench
from fiohost.bench.program import Hold, OpenLoop
from fiohost.bench.signals import Constant
from fiohost.bench.stop import Stopped
from fiohost.bench.turns import Tick, turns
from fiohost.errors import ConfigError, FiohostError, HostError, LimitError
from fiohost.transport.profile import Guards, Limits, TargetProfile
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command, Telemetry

# ---- turn by turn --------------------------------------------------------------------------------------------------


class Turns:
    """A line, a log and a program that are the test: *readings* are (step, pos), None where nothing came."""

    def __init__(self, readings: list[tuple[int, int] | None], *, real: bool = False, **limits: float) -> None:
        self.profile = TargetProfile.load()
        self.profile = replace(self.profile, limits=Limits().within(limits))
        self.steps, self.guardian, self.statistics = 100, None, SimpleNamespace(slowed=-1)
        self.time_s, self.tick_s = 50.0, 0.25
        self.clock: Any = SimpleNamespace(real=real, now_s=lambda: self.time_s)
        self.link = SimpleNamespace(encode=lambda command: command, codec=self.profile.codec)
        self.done: list[object] = []
        self.transport = SimpleNamespace(send=lambda command: self.done.append(("send", command)), can_reopen=False)
        self.rows: list[tuple[Any, ...]] = []
        self._readings = readings

    def tick(self) -> Telemetry | None:
        self.time_s += self.tick_s
        found = self._readings.pop(0)
        if found is None:
            return None
        self.steps = 100 + found[0]
        self.done.append("read")
        return Telemetry(found[0] % 2, found[1])

    def row(self, *row: Any) -> None:
        self.done.append("row")
        self.rows.append(row)

    def run(self, program: Any, progress: Any = None, every: int = 1, requested: int = 0) -> None:
        stop = SimpleNamespace(requested=requested, check=self._stopped)
        turns(self, program, SimpleNamespace(row=self.row), stop, progress, every)  # type: ignore[arg-type]

    def _stopped(self) -> None:
        raise Stopped(signal.SIGINT)


def test_a_turn_is_a_reading_an_answer_and_a_row() -> None:
    drive = Command.drive(30.0)
    seen: list[tuple[int, float]] = []

    class Program:
        def step(self, k: int, angle_deg: float) -> Any:
            seen.append((k, angle_deg))
            made.done.append("step")
            return None if k > 5 else (drive, 7.5)

    made = Turns([(1, 719), None, (3, 1), (6, 3), (7, 5)])
    made.run(Program())
    assert seen == [(0, 359.5), (2, 360.5), (5, 361.5), (6, 362.5)]
    assert made.done == ["read", "step", ("send", drive), "row"] * 3 + ["read", "step"]
    assert made.rows == [
        (0.0, 30.0, 1, 0, 719, 1, 7.5, 359.5, None), (0.01, 30.0, 1, 0, 1, 1, 7.5, 360.5, None),
        (0.025, 30.0, 1, 0, 3, 0, 7.5, 361.5, None),
    ]  # fmt: skip
    assert made.statistics.slowed == 0
    early = Turns([(-5, 719), (2, 1)])  # a board that counts anew is at the beginning
    early.run(OpenLoop([drive]))
    assert early.rows[0][0] == 0.0


def test_on_a_real_clock_each_row_has_the_time_since_the_first_reading() -> None:
    made = Turns([None, (1, 0), (2, 0), (3, 0)], real=True)
    made.run(OpenLoop([BRAKE_COMMAND] * 2))
    assert [row[-1] for row in made.rows] == [0.0, 0.25]


def test_turns_without_a_reading_are_turns_of_the_host() -> None:
    """It comes round, though the board says nothing that can be used: that is no computer that is held up."""
    made = Turns([(1, 0), None, None, None, (5, 0), (6, 0)], real=True)
    made.tick_s, made.transport.can_reopen = 40.0, True
    made.profile = replace(made.profile, guards=Guards(gap_s=60.0))
    made.run(OpenLoop([BRAKE_COMMAND] * 5))
    assert len(made.rows) == 2


def test_progress_is_told_at_the_first_turn_and_each_so_many_steps() -> None:
    told: list[Tick] = []
    made = Turns([(k, 0) for k in (1, 2, 3, 4, 6, 9, 10, 11)])
    made.run(OpenLoop([BRAKE_COMMAND] * 10), told.append, every=3)
    assert [round(tick.time_s / 0.005) for tick in told] == [0, 3, 8, 9]
    assert told[0] == Tick(0.0, BRAKE_COMMAND, 0, 1, 0.0, None)


def test_limits_and_guards_stand_between_the_program_and_the_board() -> None:
    made = Turns([(k, 0) for k in range(1, 9)], slew_pct_per_s=1000.0)
    made.run(OpenLoop([Command.drive(12.0)] * 4))
    assert [row[1] for row in made.rows] == pytest.approx([5.0, 10.0, 12.0, 12.0])
    assert made.statistics.slowed == 2
    made = Turns([(k, 0) for k in range(1, 9)], duty_pct=10.0)
    with pytest.raises(LimitError):
        made.run(OpenLoop([Command.drive(12.0)]))
    assert made.done == ["read"]
    patient = OpenLoop([Command.drive(100.0)] * 2000)
    for patience, count in ((None, 601), (2.0, 1201)):
        made = Turns([(k, 0) for k in range(1, 2002)])
        if patience is not None:
            patient.patience = patience  # type: ignore[attr-defined]
        with pytest.raises(FiohostError, match="the shaft stands"):
            made.run(patient)
        assert len(made.rows) == pytest.approx(count, abs=1)


def test_a_signal_ends_the_turns_before_the_next_reading() -> None:
    made = Turns([(1, 0)])
    with pytest.raises(Stopped):
        made.run(OpenLoop([BRAKE_COMMAND]), requested=signal.SIGINT)
    assert made.done == []


def test_a_limiter_begins_at_rest_and_counts_from_nothing() -> None:
    limiter = Limiter(Limits().within({"slew_pct_per_s": 1000.0}), 0.005)
    assert limiter.slowed == 0
    assert limiter.allow(Command.drive(-100.0), 0.0, 0.0).duty_pct == pytest.approx(-5.0)
    assert limiter.allow(STANDBY_COMMAND, 0.0, 0.005) is STANDBY_COMMAND
    assert limiter.allow(Command.drive(3.0), 0.0, 0.01).duty_pct == 3.0
    free = Limiter(Limits(), 0.005)
    assert free.allow(Command.drive(100.0), 1e6, 1e6).duty_pct == 100.0


# ---- runs ----------------------------------------------------------------------------------------------------------


def test_a_duty_is_held_for_whole_ticks_and_at_least_one() -> None:
    with connect("sim") as bench:
        for seconds, rows in ((0.0, 1), (0.0124, 2), (0.0126, 3), (0.1, 20)):
            assert len(bench.drive(10.0, seconds)) == rows
        coasts = bench.drive(10.0, 0.02, standby=True)
        assert (coasts.duty_pct.tolist(), set(coasts.columns["c3"]), set(coasts.columns["c4"])) == ([0.0] * 4, {0}, {0})
        assert (coasts.metadata["experiment"], coasts.metadata["loop"]) == ("manual", "open")
        with pytest.raises(LimitError):
            bench.drive(101.0, 0.1)


def test_an_experiment_runs_at_the_boards_sample_time(tmp_path: Path) -> None:
    signal_ = Constant(duration_s=0.05, level=10.0)
    with connect("sim") as bench:
        near = Experiment("mine", command=(signal_,), sample_time_s=0.005 + 5e-10)
        log = bench.run(near, tmp_path / "a.csv", extra_metadata={"who": "me", "loop": "mine"})
        assert (log.metadata["who"], log.metadata["loop"], len(log)) == ("me", "mine", 10)
        assert log.path == tmp_path / "a.csv"
        for wrong in (0.005 + 2e-9, 0.005 - 2e-9, 0.01):
            with pytest.raises(ConfigError, match=r"wants ticks of .* ms, but the board's task runs every 5 ms"):
                bench.run(Experiment("mine", command=(signal_,), sample_time_s=wrong))


def test_a_session_without_a_log_counts_its_rows_and_shows_them(tmp_path: Path) -> None:
    rows: list[Any] = []
    ticks: list[Tick] = []
    with connect("sim") as bench:
        hold = Hold(Command.drive(10.0), 40)
        assert bench.live(hold, also=lambda *row: rows.append(row), progress=ticks.append) == 40
        assert (len(rows), len(ticks)) == (40, 2)  # each tenth of a second
        ticks.clear()
        assert bench.live(hold, tmp_path / "a.csv", {"a": "b"}, ticks.append, 0.05) == 40
        assert len(ticks) == 4
        ticks.clear()
        bench.play(hold, progress=ticks.append)
        bench.drive(10.0, 0.2, progress=ticks.append)
        assert len(ticks) == 4
        ticks.clear()
        bench.play(hold, progress=ticks.append, progress_every_s=0.0)
        assert len(ticks) == 40
        ticks.clear()
        bench.run(Experiment("x", command=(Constant(duration_s=0.2, level=1.0),)), progress=ticks.append)
        assert len(ticks) == 2
    assert fiohost.read_log(tmp_path / "a.csv").metadata["a"] == "b"


def test_a_logs_head_says_what_it_is_of(tmp_path: Path) -> None:
    with connect("sim") as bench:
        assert bench.settle() is None
        log = bench.drive(10.0, 0.05)
        wanted = {
            "target": "sim", "serial_number": "simulated", "profile": "hid-assumed", "run_id": bench.run_id,
            "sample_time_s": "0.005", "command_delay_ticks": "1", "counts_per_rev": "720", "full_scale": "100",
            "full_scale_unit": "% duty", "host_version": fiohost.__version__, "clock": "virtual", "begins": "at rest",
            "ending": "complete",
        }  # fmt: skip
        assert wanted.items() <= log.metadata.items()
        assert "limits" not in log.metadata
        assert log.metadata["duty_steps"] == str(bench.profile.duty_steps)
        assert float(log.metadata["bench_time_s"]) == pytest.approx(bench._line.steps * 0.005 - 0.05 - 0.05, abs=0.06)
        assert len(bench.run_id) == 16
        again = bench.drive(10.0, 0.05)
        assert again.metadata["run_id"] == bench.run_id
        assert again.bench_time_s > log.bench_time_s
    with connect("sim", realtime=True) as bench:
        assert bench.head()["clock"] == "real"
        assert "host_time_s" in bench.drive(10.0, 0.02).columns
    with connect("sim", limits={"duty_pct": 20.0}) as bench:
        assert bench.head()["limits"] == "duty 20 %"


def test_the_ticks_of_a_run_are_its_own(caplog: pytest.LogCaptureFixture) -> None:
    """Also those that bring the shaft to rest before it, of which the program's own log tells."""
    with connect("sim") as bench:
        bench.drive(0.0, 1.0)
        with caplog.at_level(logging.INFO, "fiohost.bench"):
            bench.settle()
            bench.drive(0.0, 0.05)
            bench.settle()
        assert [message.partition(" s at")[0] for message in caplog.messages] == ["at rest after 0.105"] * 3
        bench.drive(0.0, 0.05)
        assert bench.statistics.ticks == 10 + 1  # and the one that ends it

        def fails() -> None:
            raise HostError("no guardian")

        bench._set_guardian = fails  # type: ignore[method-assign]
        with pytest.raises(HostError, match="no guardian"):
            bench.drive(0.0, 0.05)
        assert bench.statistics.ticks == 0


def test_an_own_clock_says_how_long_a_bench_on_a_cable_is_open() -> None:
    now_s = [100.0]
    with bench_on(WatchedTransport()) as bench:
        bench.clock = SimpleNamespace(now_s=lambda: now_s[0], real=True)  # type: ignore[assignment]
        bench._opened_s = 40.0
        assert bench._bench_time_s() == pytest.approx(bench._line.steps * 0.005)
        real = bench.transport
        bench.transport = SimpleNamespace(lock_step=False)  # type: ignore[assignment]
        assert bench._bench_time_s() == 60.0
        bench.transport = real


@pytest.mark.parametrize(
    ("late", "ticks", "passed_over", "late_pct", "fails"),
    [(4, 10, 0, 1.0, False), (5, 10, 0, 1.0, True), (5, 500, 0, 1.0, False), (6, 599, 0, 1.0, True),
     (6, 500, 100, 1.0, False), (5, 10, 0, 50.0, False), (5, 10, 0, 49.0, True)],
)  # fmt: skip
def test_a_run_that_was_not_in_real_time_fails_from_five_late_ticks_on(
    late: int, ticks: int, passed_over: int, late_pct: float, fails: bool, tmp_path: Path
) -> None:
    made: Any = SimpleNamespace(
        statistics=SimpleNamespace(host_late=late, ticks=ticks, passed_over=passed_over),
        profile=SimpleNamespace(guards=Guards(late_pct=late_pct)), transport=SimpleNamespace(can_reopen=True),
    )  # fmt: skip
    writer: Any = SimpleNamespace(path=tmp_path / "a.csv", rows=9)
    if fails:
        with pytest.raises(HostError, match=rf"{late} of {ticks} ticks \({100 * late / ticks:.1f} %\)") as caught:
            Bench._judge_host(made, writer)
        assert caught.value.__notes__ == [f"the log {tmp_path / 'a.csv'} is closed with its 9 rows"]
        writer.path = None
        with pytest.raises(HostError) as caught:
            Bench._judge_host(made, writer)
        assert not hasattr(caught.value, "__notes__")
    else:
        Bench._judge_host(made, writer)
    made.transport.can_reopen = False
    Bench._judge_host(made, writer)


def test_a_line_whose_guardian_cannot_be_made_is_let_go(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(transport: object, profile: object) -> None:
        raise HostError("no guardian")

    monkeypatch.setattr(loop.Guardian, "of", fails)
    transport = WatchedTransport()
    on_a_cable = type("Board", (WatchedTransport,), {"way": property(lambda self: "a way")})()
    with pytest.raises(HostError, match="no guardian"):
        Bench(on_a_cable, TargetProfile.load())
    assert on_a_cable._is_open is False
    bench_on(transport).close()  # where there is no way nobody asks for one
    assert transport._is_open is False


def test_a_guardian_is_kept_for_its_line_and_made_anew_for_another(monkeypatch: pytest.MonkeyPatch) -> None:
    made: list[Any] = []
    on_duty: list[Any] = []

    def of(transport: Any, profile: object) -> Any:
        told: list[Any] = []
        one = SimpleNamespace(way=transport.way, told=told, close=lambda braked=True: told.append(braked))
        one.on_duty = lambda: (on_duty.append(one), nullcontext())[1]
        one.beat, one.has_braked = lambda: None, False
        made.append(one)
        return one

    monkeypatch.setattr(loop.Guardian, "of", of)
    transport = WatchedTransport()
    bench = bench_on(transport)
    assert made == []
    ways = iter(["one", "one", "two", "two"])
    monkeypatch.setattr(WatchedTransport, "way", property(lambda self: current[0]))
    current = [next(ways)]
    bench._set_guardian()
    bench._set_guardian()
    assert [one.way for one in made] == ["one"]
    bench._line.guardian = None  # it was given up
    bench._set_guardian()
    assert [one.way for one in made] == ["one", "one"]
    assert made[0].told == [True]
    current[0] = "two"
    bench.live(Hold(BRAKE_COMMAND, 3))  # a board that came back has another way
    assert [one.way for one in made] == ["one", "one", "two"]
    assert on_duty == [made[-1]]
    bench._line.guardian = None
    bench._guardian = made[-1]
    bench.close()
    assert made[-1].told == [True]
    assert bench._guardian is None


def test_what_ended_a_run_is_told_and_not_what_became_of_the_line_since(monkeypatch: pytest.MonkeyPatch) -> None:
    bench = bench_on(WatchedTransport())

    def fails(line: object) -> None:
        raise OSError("no brake")

    monkeypatch.setattr(loop, "brake", fails)
    with pytest.raises(OSError, match="no brake"):
        bench.__exit__(None, None, None)
    first = ValueError("first")
    assert bench.__exit__(ValueError, first, None) is None


def test_a_log_of_traffic_says_where_a_bench_is_open(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "fiohost.bench"), connect("sim") as bench:
        assert f"opened sim: simulated, profile hid-assumed (layout assumed), run {bench.run_id}" in caplog.text
