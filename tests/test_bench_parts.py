"""A bench's runs turn by turn, what is opened for a target's name, and what is kept beside a run."""

from __future__ import annotations

import io
import json
import logging
import os
import signal
import threading
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from boards import WatchedTransport, bench_on

import fiohost
from fiohost import files
from fiohost.bench import connect as connecting
from fiohost.bench import loop, priority, seal, stop, table, terminal, watcher, writer
from fiohost.bench.clock import MonotonicClock, PlayedClock, VirtualClock
from fiohost.bench.connect import asking, connect, open_target, split_target
from fiohost.bench.experiment import Experiment
from fiohost.bench.limits import Limiter
from fiohost.bench.loop import Bench
from fiohost.bench.program import Hold, OpenLoop
from fiohost.bench.seal import draw_seed, find_seed, find_version, is_faulty, is_sealed, store_seed, student_seed
from fiohost.bench.signals import Constant
from fiohost.bench.stop import Stopped, StopSignals
from fiohost.bench.table import read_cells
from fiohost.bench.turns import Tick, turns
from fiohost.bench.writer import LogWriter
from fiohost.errors import ConfigError, FiohostError, HostError, LimitError, LogError
from fiohost.transport import serial, trace
from fiohost.transport.profile import Guards, Limits, TargetProfile
from fiohost.transport.trace import TraceReader, TraceWriter
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command, Telemetry

# ---- turn by turn --------------------------------------------------------------------------------------------------


class Turns:
    """A line, a log and a program that are the test: *readings* are (step, pos), None where nothing came."""

    def __init__(self, readings: list[tuple[int, int] | None], *, real: bool = False, **limits: float) -> None:
        self.profile = TargetProfile.load()
        self.profile = fiohost_replace(self.profile, limits=Limits().within(limits))
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


def fiohost_replace(profile: TargetProfile, **changes: Any) -> TargetProfile:
    from dataclasses import replace

    return replace(profile, **changes)


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


def test_on_a_real_clock_each_row_has_the_time_since_the_first_turn() -> None:
    made = Turns([None, (1, 0), (2, 0), (3, 0)], real=True)
    made.run(OpenLoop([BRAKE_COMMAND] * 2))
    assert [row[-1] for row in made.rows] == [0.25, 0.5]


def test_turns_without_a_reading_are_turns_of_the_host() -> None:
    """It comes round, though the board says nothing that can be used: that is no computer that is held up."""
    made = Turns([(1, 0), None, None, None, (5, 0), (6, 0)], real=True)
    made.tick_s, made.transport.can_reopen = 40.0, True
    made.profile = fiohost_replace(made.profile, guards=Guards(gap_s=60.0))
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


# ---- targets -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "wanted"),
    [
        ("sim", ("sim", "", "hid-assumed")), ("sim:a:b", ("sim", "a:b", "hid-assumed")),
        ("hid:A", ("hid", "A", "hid-assumed")), ("serial:COM3", ("serial", "COM3", "serial-documented")),
        ("replay:a:b.jsonl", ("replay", "a:b.jsonl", "")), ("serial-framed", ("serial", "", "serial-framed")),
        ("serial-framed:/dev/x", ("serial", "/dev/x", "serial-framed")),
        ("emulated:uno:p", ("emulated", "uno:p", "uno")),
    ],
)  # fmt: skip
def test_a_target_is_a_medium_what_follows_it_and_a_profile(target: str, wanted: tuple[str, str, str]) -> None:
    assert split_target(target) == wanted


def test_a_profile_in_a_file_is_a_target_with_what_follows(tmp_path: Path) -> None:
    path = tmp_path / "a:b.toml"
    path.write_text(TargetProfile.load("serial-framed").text)
    assert split_target(str(path)) == ("serial", "", str(path))
    assert split_target(f"{path}:/dev/x:y") == ("serial", "/dev/x:y", str(path))
    with pytest.raises(ConfigError, match="unknown target 'serail'; did you mean 'serial'"):
        split_target("serail")
    with pytest.raises(ConfigError, match="replay needs the file of a trace"):
        split_target("replay")


def test_what_is_opened_for_each_medium(monkeypatch: pytest.MonkeyPatch) -> None:
    hid, profile = open_target("hid:A1")
    assert (hid.name, hid._prefix, profile.name) == ("hid:A1", b"\0", "hid-assumed")  # type: ignore[attr-defined]
    assert (hid._vendor_id, hid._product_id) == (0x0483, 0x5750)  # type: ignore[attr-defined]
    framed, _ = open_target("hid-framed")
    report_id = TargetProfile.load("hid-framed").codec.telemetry_layout.report_id
    assert framed._prefix == (b"" if report_id is not None else b"\0")  # type: ignore[attr-defined]
    plain, profile = open_target("serial:/dev/x")
    assert (plain._asked, plain._baud) == ("/dev/x", profile.baud)  # type: ignore[attr-defined]
    with_id = fiohost_replace(profile, vendor_id=0x1209, product_id=None, baud=9600)
    assert connecting._serial("", with_id, None, "")._asked == "1209:0000"  # type: ignore[attr-defined]
    assert connecting._serial("/dev/x", with_id, None, "")._asked == "/dev/x"  # type: ignore[attr-defined]
    assert connecting._serial("", profile, None, "")._baud == profile.baud  # type: ignore[attr-defined]
    kept: dict[str, int] = {}
    monkeypatch.setattr(connecting, "store_seed", kept.__setitem__)
    sealed, _ = open_target("sim:sealed", seed=0, run_id="told")
    faulty, _ = open_target("sim:sealed-faulty", run_id="drawn")
    assert (sealed.name, faulty.name) == ("sim:sealed", "sim:sealed-faulty")
    assert kept["told"] == 0
    assert kept.keys() == {"told", "drawn"}
    student, _ = open_target("sim:student:me", run_id="mine")
    assert (student.name, student.identity) == ("sim:sealed", "simulated, sealed")
    assert "mine" not in kept
    with pytest.raises(ConfigError, match="drawn by the student's name"):
        open_target("sim:student:me", seed=1)


def test_the_time_of_a_bench_is_that_of_its_target(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(trace=path), connect("sim") as bench:
        assert isinstance(bench.clock, VirtualClock)
        bench.drive(20.0, 0.05)
    with connect("sim", realtime=True) as bench:
        assert isinstance(bench.clock, MonotonicClock)
    with connect(f"replay:{path}") as bench:
        assert isinstance(bench.clock, VirtualClock)  # the trace is of a board in lock step
    head, *events = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(json.loads(head) | {"lock_step": False}), *events]) + "\n")
    assert open_target(f"replay:{path}")[0]._paced is False  # type: ignore[attr-defined]
    bench = connect(f"replay:{path}")
    assert isinstance(bench.clock, PlayedClock)
    assert bench.clock.now_s() == bench.transport.time_s  # type: ignore[attr-defined]
    paced = connecting.connect(f"replay:{path}", realtime=True)
    assert isinstance(paced.clock, MonotonicClock)
    for seed in (-1, 2**63):
        with pytest.raises(ConfigError, match=f"seed {seed} is outside"):
            connect("sim", seed=seed)
    for seed in (0, 2**63 - 1):
        connect("sim", seed=seed).close()


# ---- seals ---------------------------------------------------------------------------------------------------------


def test_which_targets_are_sealed() -> None:
    for target in ("sim:sealed", "sim:sealed-faulty", "sim:student:me", "emulated:uno:sealed"):
        assert is_sealed(target)
    for target in ("sim", "sim:seal", "emulated:uno", "uno:sealed", "hid:sealed"):
        assert not is_sealed(target)
    assert [is_faulty(t) for t in ("sim:sealed", "sim:sealed-faulty")] == [False, True]


def test_a_students_seed_is_that_of_the_name_alone() -> None:
    assert student_seed("Ada@x.org") == student_seed("ada@X.org") != student_seed("ada@x.net")
    assert 0 <= student_seed("1") < 2**32
    assert student_seed("x" * 80)
    for name in ("", "x" * 81, "a b", "a/b"):
        with pytest.raises(ConfigError, match="is no student's name"):
            student_seed(name)
    assert 0 <= draw_seed() < 2**32


def test_a_seed_is_kept_under_its_run_and_found_by_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for _ in range(2):  # the folder may be there already
        store_seed("0123456789abcdef", 42)
    kept = tmp_path / "fiohost" / "seals" / "0123456789abcdef.json"
    assert json.loads(kept.read_text()) == {"run_id": "0123456789abcdef", "seed": 42}

    def log(**head: str) -> str:
        lines = "".join(f"# {key}: {value}\n" for key, value in head.items())
        path = tmp_path / "run.csv"
        path.write_text(f"{lines}time_s,duty_pct,pos\n0,0,0\n0.005,0,0\n")
        return str(path)

    sealed = {"target": "sim:sealed", "run_id": "0123456789abcdef"}
    assert find_seed(log(**sealed)) == 42
    assert (find_version(log(**sealed)), find_version("42")) == (1, None)
    assert find_version(log(**sealed, sealed_version="3")) == 3
    for said in ("x", "1234567"):
        with pytest.raises(ConfigError, match="which is no version"):
            find_version(log(**sealed, sealed_version=said))
    with pytest.raises(ConfigError, match="is a log of 'sim': not sealed"):
        find_seed(log(target="sim"))
    with pytest.raises(ConfigError, match="is a log of 'an unnamed target'"):
        find_seed(log())
    for run_id in ("0123456789abcdee", "../../x", "0123456", ""):
        with pytest.raises(ConfigError, match="is not kept here"):
            find_seed(log(target="sim:sealed", run_id=run_id))
    kept.write_text("{}")
    with pytest.raises(FiohostError, match=r"the seal .* is damaged"):
        find_seed(log(**sealed))
    assert find_seed(str(2**63 - 1)) == 2**63 - 1
    assert find_seed("0") == 0
    with pytest.raises(ConfigError, match="is larger than"):
        find_seed(str(2**63))
    with pytest.raises(ConfigError, match="is neither a seed"):
        find_seed("12x")
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match="cannot keep the seal in"):
        store_seed("0123456789abcdef", 1)
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "windows"))
    assert seal.state_dir() == tmp_path / "windows" / "fiohost"


# ---- signals, terminals, priority ----------------------------------------------------------------------------------


def test_signals_become_a_request_and_are_put_back() -> None:
    before = {name: signal.getsignal(name) for name in (*stop._SIGNALS, signal.SIGTTOU)}
    with StopSignals() as signals:
        assert signal.getsignal(signal.SIGTTOU) == signal.SIG_IGN  # nor does output stop it
        signals.check()
        assert signals.requested == 0
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGINT)  # the first is told
        assert signals.requested == signal.SIGTERM
        with pytest.raises(Stopped, match="stopped by SIGTERM") as caught:
            signals.check()
        assert (caught.value.signum, caught.value.exit_code) == (15, 143)
    assert {name: signal.getsignal(name) for name in before} == before
    assert str(Stopped(99)) == "stopped by 99"


def test_a_second_signal_is_raised_at_once_where_the_loop_may_hang_and_only_there() -> None:
    with StopSignals() as signals:
        signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        with signals.interruptible(), pytest.raises(Stopped, match="Ctrl-C"):
            signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        with signals.interruptible():
            pass
        signal.raise_signal(signal.SIGTERM)
    with StopSignals() as signals, signals.interruptible():
        signal.raise_signal(signal.SIGINT)  # the first is never raised
        assert signals.requested == signal.SIGINT
        with pytest.raises(Stopped):
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)  # while it is on its way out no more


def test_what_was_ignored_stays_ignored_and_a_thread_changes_nothing() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopSignals() as signals:
            signal.raise_signal(signal.SIGHUP)
            assert signals.requested == 0
        assert signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)
    seen: list[object] = []

    def run() -> None:
        with StopSignals():
            seen.append(signal.getsignal(signal.SIGTERM) == handler)

    handler = signal.getsignal(signal.SIGTERM)
    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    assert seen == [True]


def test_what_fails_for_want_of_the_terminal_is_its_hang_up() -> None:
    def ended(requested: int, failure: BaseException) -> BaseException:
        signals = StopSignals()
        signals.requested = requested
        failure.add_note("a note")
        try:
            with signals.hang_ups():
                raise failure
        except BaseException as exc:
            return exc

    for failure in (OSError("no terminal"), FiohostError("no log")):
        found = ended(signal.SIGHUP, failure)
        assert isinstance(found, Stopped)
        assert (found.exit_code, found.__notes__, found.__cause__) == (129, ["a note"], failure)
        assert ended(0, failure) is failure
        assert ended(signal.SIGTERM, failure) is failure
    other = ValueError()
    assert ended(signal.SIGHUP, other) is other


def test_a_terminals_flow_control_is_off_meanwhile_and_as_before_afterwards(monkeypatch: pytest.MonkeyPatch) -> None:
    import termios

    far, near = os.openpty()
    mode = termios.tcgetattr(near)
    mode[0] |= termios.IXON
    termios.tcsetattr(near, termios.TCSANOW, mode)

    def has_flow_control() -> bool:
        return bool(termios.tcgetattr(near)[0] & termios.IXON)

    stream: Any = SimpleNamespace(fileno=lambda: near)
    for name in ("stdin", "stdout", "stderr"):
        monkeypatch.setattr(terminal.sys, name, stream)
    group = [os.getpgrp()]
    monkeypatch.setattr(terminal.os, "tcgetpgrp", lambda fd: group[0])
    before = {number: signal.getsignal(number) for number in (signal.SIGTTOU, signal.SIGTTIN)}
    with terminal.not_held_up():
        assert not has_flow_control()
        assert {signal.getsignal(number) for number in before} == {signal.SIG_IGN}
    assert has_flow_control()
    assert {number: signal.getsignal(number) for number in before} == before
    group[0] += 1
    with terminal.not_held_up():  # a background job leaves the terminal alone
        assert has_flow_control()
    group[0] -= 1
    mode[0] &= ~termios.IXON
    termios.tcsetattr(near, termios.TCSANOW, mode)
    with terminal.not_held_up():
        assert not has_flow_control()
    assert not has_flow_control()
    for stream in (io.StringIO(), None, SimpleNamespace(fileno=lambda: far + 500)):
        monkeypatch.setattr(terminal.sys, "stdin", stream)
        with terminal.not_held_up():
            pass
    os.close(far)
    os.close(near)


def test_precedence_is_taken_and_given_back(monkeypatch: pytest.MonkeyPatch) -> None:
    set_: list[tuple[int, int, int]] = []
    monkeypatch.setattr(os, "sched_getscheduler", lambda pid: 40 + pid)
    monkeypatch.setattr(os, "sched_getparam", lambda pid: os.sched_param(3 + pid))
    monkeypatch.setattr(os, "sched_setscheduler", lambda pid, how, param: set_.append((pid, how, param.sched_priority)))
    with pytest.raises(KeyError), priority.realtime_priority():
        raise KeyError
    assert set_ == [(0, os.SCHED_FIFO, 10), (0, 40, 3)]

    def forbidden(pid: int, how: int, param: object) -> None:
        raise PermissionError(1, "not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", forbidden)
    with pytest.raises(ConfigError, match=r"not allowed here \(not permitted\)"), priority.realtime_priority():
        pass
    monkeypatch.delattr(os, "sched_setscheduler")
    with pytest.raises(ConfigError, match="only Linux has"), priority.realtime_priority():
        pass


# ---- what is bounded -----------------------------------------------------------------------------------------------


def test_no_file_is_read_and_nothing_waits_beyond_its_bound(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A log of 640 MB, a table of 400, a trace of 10 GB; 400 rows, 1000 lines of a trace, 100 ticks that are shown."""
    asked: list[int] = []

    def reads(path: object, most: int, *rest: object) -> bytes:
        asked.append(most)
        raise LogError("seen")

    for name in ("read_input", "open_input"):
        monkeypatch.setattr(files, name, reads)
    for read in (fiohost.read_log, lambda path: read_cells(path, 1), TraceReader):
        with pytest.raises(LogError, match="seen"):
            read("x")  # type: ignore[arg-type]
    assert asked == [640_000_000, 400_000_000, 10_000_000_000]
    monkeypatch.undo()
    asked.clear()
    made: Any = SimpleNamespace(close=lambda limit_s: True, waiting=0, problem=None, put=lambda item: True)
    for module in (writer, trace, watcher):
        monkeypatch.setattr(module, "Background", lambda do, most, name: (asked.append(most), made)[1])
    LogWriter(tmp_path / "a.csv", {}, behind=True).close()
    TraceWriter(tmp_path / "t.jsonl").session({}, 0.0)
    watcher.Watcher(print)
    assert asked == [400, 1, 1000, 100]


def test_no_more_of_a_stream_is_taken_in_one_go_than_a_mebibyte(monkeypatch: pytest.MonkeyPatch) -> None:
    waits: list[float] = []
    select = SimpleNamespace(select=lambda read, write, wrong, wait_s: (waits.append(wait_s), (read, [], []))[1])
    monkeypatch.setattr(serial, "select", select)
    monkeypatch.setattr(serial, "os", SimpleNamespace(read=lambda fd, size: bytes(size)))
    assert len(serial._read(3, 0.25)) == 1_048_576
    assert (waits[0], set(waits[1:])) == (0.25, {0.0})
    waits.clear()
    serial._read(3, -1.0)
    assert waits[0] == 0.0


# ---- tables that people write --------------------------------------------------------------------------------------


def cells(tmp_path: Path, text: str | bytes, most_rows: int = 10) -> list[dict[str, str]]:
    path = tmp_path / "t.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_cells(path, most_rows)[0]


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|", " "])
def test_cells_are_split_by_what_gives_most(delimiter: str, tmp_path: Path) -> None:
    text = "# a remark\n\n a{0}b c{0}d \r\n1{0}x{0}2\n".replace("b c", "bc").format(delimiter)
    assert cells(tmp_path, text) == [{"a": "1", "bc": "x", "d": "2"}]


def test_a_table_of_readings_is_as_large_as_is_said(tmp_path: Path) -> None:
    assert len(cells(tmp_path, "a,b\n" + "1,2\n" * 10)) == 10
    with pytest.raises(LogError, match="has more than 10 rows"):
        cells(tmp_path, "a,b\n" + "1,2\n" * 11)
    for text in ("", "a,b\n", "# x\na,b\n"):
        with pytest.raises(LogError, match="at least one row below it"):
            cells(tmp_path, text)
    wide = [f"c{k}" for k in range(1001)]
    assert len(cells(tmp_path, ",".join(wide[:1000]) + "\n" + ",".join("1" * 1000) + "\n")[0]) == 1000
    with pytest.raises(LogError, match="has 1001 columns, more than 1000"):
        cells(tmp_path, ",".join(wide) + "\n" + ",".join("1" * 1001) + "\n")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a,a,b\n1,2,3\n", "has 2 columns named 'a': rename"), ("a,b\n1\n", "line 2: 1 cells under 2 column names"),
        ("# x\na,b\n1,2\n1,2,3\n", "line 4: 3 cells under 2"), ("1,2\n3,4\n", "starts with a row of numbers"),
        ('a,b\n"1,2\n', "line 2 cannot be split into cells"), (b"a,b\n1,\0\n", "is not a text table in UTF-8"),
        ("a\n1\n".encode("utf-16"), "is not a text table in UTF-8"), (b"\xfe\xff\0a", "is not a text table"),
    ],
)  # fmt: skip
def test_a_table_that_is_none_is_refused_with_its_line(text: str | bytes, said: str, tmp_path: Path) -> None:
    with pytest.raises(LogError, match=said):
        cells(tmp_path, text)


def test_cells_may_be_quoted_empty_or_of_another_encoding(tmp_path: Path) -> None:
    assert cells(tmp_path, 'a,b\n"1,5", \n') == [{"a": "1,5", "b": ""}]
    assert cells(tmp_path, b"\xef\xbb\xbfa,b\n\xff,2\n") == [{"a": "\ufffd", "b": "2"}]
    assert cells(tmp_path, "a,1\n2,3\n") == [{"a": "2", "1": "3"}]
    assert cells(tmp_path, ",a\n2,3\n") == [{"": "2", "a": "3"}]
    (tmp_path / "far.csv").write_bytes(b"a,b\n" + b"1,2\n" * 1500 + b"1,\0\n")
    assert len(read_cells(tmp_path / "far.csv", 2000)[0]) == 1501  # only the beginning is looked at for its kind
    one, two = (read_cells(tmp_path / "far.csv", 2000)[1] for _ in range(2))
    assert one == two
    assert len(one) == 64


def test_a_wanted_column_is_there_once() -> None:
    assert table._header("t,u;y", ("u;y",), Path("x")) == (",", ["t", "u;y"])
    assert table._header("t,u;y", ("t,u",), Path("x")) == (";", ["t,u", "y"])
    with pytest.raises(LogError, match="has no column 'v'; "):
        table._header("t,u", ("v",), Path("x"))
    with pytest.raises(LogError, match="has 2 columns named 'u'"):
        table._header("t,u,u", ("u",), Path("x"))


def test_a_log_of_traffic_says_where_a_bench_is_open(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, "fiohost.bench"), connect("sim") as bench:
        assert f"opened sim: simulated, profile hid-assumed (layout assumed), run {bench.run_id}" in caplog.text
