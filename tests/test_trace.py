"""What a trace keeps and a replay gives back, what sniff shows of it, and the limits that stand before the wire."""

from __future__ import annotations

import errno
import json
import random
import re
from contextlib import suppress
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from fiohost.bench.clock import PlayedClock
from fiohost.bench.connect import asking, connect, split_target, watched
from fiohost.bench.experiment import Experiment
from fiohost.bench.limits import Limiter
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.signals import Staircase
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DisconnectedError, FiohostError, LimitError, LogError
from fiohost.transport.profile import Limits, TargetProfile
from fiohost.transport.simulated import SimulatedTransport
from fiohost.transport.trace import TraceReader, TraceWriter
from firmware_model import Board, FaultyBoard
from firmware_model.plants import make_plant
from firmware_model.sealed import NEWEST

STAIRS = Experiment("stairs", [Staircase(levels=(30.0, -60.0), step_s=0.3, duration_s=0.6)])
MOTOR = {"supply_V": 9.0, "R_ohm": 5.5, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.487, "J_kgm2": 3e-3, "coulomb_Nm": 0.02}
FAULTY = "[faults]\nreport_drop_ratio = 0.05\nreport_double_ratio = 0.05\nreport_corrupt_ratio = 0.05\n"


def rows(log: Log) -> Any:
    return np.column_stack([log.columns[name] for name in ("time_s", "duty_pct", "pos", "angle_deg")])


def faulty_plant(folder: Path) -> Path:
    path = folder / "faulty.toml"
    path.write_text("".join(f"{key} = {value!r}\n" for key, value in MOTOR.items()) + FAULTY)
    return path


def run(*arguments: object) -> Any:
    return CliRunner().invoke(cli, [str(argument) for argument in arguments])


# ---- trace and replay ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["sim", "sim-framed", "sim:FAULTY", "sim-framed:FAULTY"])
def test_a_replay_of_a_trace_gives_the_same_log(target: str, tmp_path: Path) -> None:
    target = target.replace("FAULTY", str(faulty_plant(tmp_path)))
    with asking(trace=tmp_path / "t.jsonl"), connect(target, seed=1) as bench:
        recorded, told = bench.run(STAIRS), bench.statistics.as_dict()
    with connect(f"replay:{tmp_path / 't.jsonl'}") as bench:
        replayed = bench.run(STAIRS)
        assert bench.statistics.as_dict() == told
        assert bench.profile.name == recorded.metadata["profile"]
    assert np.array_equal(rows(recorded), rows(replayed))
    assert replayed.metadata["replay_of"] == "sim" + target.partition(":")[1] + target.partition(":")[2]
    if "faulty" in target:
        assert len(recorded) < 120
    if "framed" in target and "faulty" in target:  # every row that is missing has a number, and some of the last brake
        missing = 120 - len(recorded)
        assert 5 < missing <= int(str(told["reports_lost"])) < missing + 15
        assert f"{told['reports_lost']} reports lost" in recorded.metadata["tick_statistics"]
        assert "crc" in str(told["refused_by_reason"])


def test_a_trace_is_a_head_and_one_event_a_line_with_the_boards_time(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(trace=path), connect("sim-framed", seed=1) as bench:
        bench.drive(40.0, 0.1)
        lines = path.read_text().splitlines()  # flushed: all of it is there while the bench is open
    head, events = json.loads(lines[0]), [json.loads(line) for line in lines[1:]]
    assert (head["schema"], head["target"], head["profile"]) == ("fiohost.trace/1", "sim", "sim-framed")
    came = [event for event in events if event["dir"] == "in"]
    codec = TargetProfile.parse(head["profile_toml"], "x").codec
    ticks = [codec.decode(bytes.fromhex(event["hex"])).tick for event in came]
    assert ticks == list(range(len(came)))
    times = [event["t"] for event in came[:40]]  # the brake at the end is not waited for in virtual time
    assert times == pytest.approx([0.005 * k for k in range(40)], abs=1e-6)
    sent = [bytes.fromhex(event["hex"]) for event in events if event["dir"] == "out"]
    assert codec.command_layout.decode(sent[25])["duty_pct"] == 40.0


def test_the_trace_of_a_sealed_board_names_no_plant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with asking(trace=tmp_path / "t.jsonl"), connect("sim:sealed", seed=3) as bench:
        bench.drive(20.0, 0.05)
    head = json.loads((tmp_path / "t.jsonl").read_text().splitlines()[0])
    assert head["facts"] == {"sealed_version": str(NEWEST)}
    assert (head["target"], head["identity"]) == ("sim:sealed", "simulated, sealed")


def test_a_trace_that_ends_early_ends_the_replay_in_one_sentence(tmp_path: Path) -> None:
    whole, cut = tmp_path / "t.jsonl", tmp_path / "cut.jsonl"
    with asking(trace=whole), connect("sim", seed=1) as bench:
        bench.run(STAIRS)
    text = whole.read_text()
    cut.write_text(text[: len(text) // 2])  # in mid-line, as after a crash
    with pytest.raises(DisconnectedError, match="ends here") as caught, connect(f"replay:{cut}") as bench:
        bench.run(STAIRS, tmp_path / "log.csv")
    assert not getattr(caught.value, "__notes__", [])[1:]  # nothing about a motor that may be running
    assert len(Log.read(tmp_path / "log.csv")) > 20


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "is not a trace"),
        ("{}\n", "is not a trace"),
        ('{"schema": "fiohost.trace/1"}\n', "no profile"),
        ('{"schema": "fiohost.trace/1", "profile": "x", "profile_toml": "a = 1"}\n', "transport|unknown key|missing"),
        ("HEAD nonsense\n", "line 2 is not a JSON object"),
        ('HEAD {"t": 0}\n', "line 2 is not an event"),
        ('HEAD {"t": 0, "dir": "up", "hex": "00"}\n', "dir is one of out, in"),
        ('HEAD {"t": 0, "dir": "in", "hex": "0"}\n', "line 2 is not an event"),
        ('HEAD {"schema": "fiohost.trace/1", "profile_toml": "other"}\n', "another target profile"),
    ],
)
def test_a_file_that_is_no_trace_is_refused_in_one_sentence(text: str, reason: str, tmp_path: Path) -> None:
    profile = TargetProfile.load()
    head = {"schema": "fiohost.trace/1", "profile": profile.name, "profile_toml": profile.text, "lock_step": True}
    path = tmp_path / "t.jsonl"
    path.write_text(text.replace("HEAD ", json.dumps(head) + "\n"))
    with pytest.raises(ConfigError, match=reason), connect(f"replay:{path}") as bench:
        bench.run(STAIRS)


@settings(max_examples=60, deadline=None)
@given(st.binary(max_size=300))
def test_any_bytes_behind_the_head_are_events_or_a_refusal(tmp_path_factory: Any, tail: bytes) -> None:
    path = tmp_path_factory.mktemp("t") / "t.jsonl"
    path.write_bytes(b'{"schema": "fiohost.trace/1"}\n' + tail)
    with suppress(ConfigError):
        assert all(event.direction for event in TraceReader(path).events())


def test_a_trace_is_not_recorded_over_itself(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    assert run("manual", "--pwm", 20, "--duration", 0.1, "--fast", "--trace", path).exit_code == 0
    before = path.read_bytes()
    done = run("manual", "--pwm", 20, "--duration", 0.1, "--fast", "--target", f"replay:{path}", "--trace", path)
    assert done.exit_code == 1
    assert "another name" in done.stderr
    assert path.read_bytes() == before
    again = ["manual", "--pwm", 30, "--duration", 0.05, "--fast", "--trace", path]
    done = run(*again, "--target", f"replay:{path}", "--force")
    assert done.exit_code == 1
    assert "another name" in done.stderr
    assert path.read_bytes() == before
    assert run(*again).exit_code == 1
    assert run(*again, "--force").exit_code == 0
    assert path.read_bytes().count(b"fiohost.trace/1") == 1  # anew


def test_a_trace_that_cannot_be_written_is_refused_before_anything_moves(tmp_path: Path) -> None:
    done = run("manual", "--pwm", 20, "--duration", 0.1, "--fast", "--trace", tmp_path / "no" / "t.jsonl")
    assert done.exit_code == 1
    assert "nothing was driven" in done.stderr


def test_a_full_disk_under_the_trace_ends_the_run_with_a_brake(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []
    send = SimulatedTransport.send
    monkeypatch.setattr(SimulatedTransport, "send", lambda self, report: (sent.append(report), send(self, report))[1])

    class Full:
        left = 60

        def write(self, data: bytes) -> int:
            self.left -= 1
            if self.left < 0:
                raise OSError(errno.ENOSPC, "No space left on device")
            return len(data)

        def truncate(self, size: int) -> None: ...

        def close(self) -> None: ...

    begin = TraceWriter.__init__

    def begin_full(self: TraceWriter, path: str | Path) -> None:
        begin(self, path)
        self._file = Full()  # type: ignore[assignment]

    monkeypatch.setattr(TraceWriter, "__init__", begin_full)
    with (
        pytest.raises(LogError, match="No space left"),
        asking(trace=tmp_path / "t.jsonl"),
        connect("sim", seed=1) as bench,
    ):
        bench.drive(50.0, 1.0)
    assert sent[-1][:6] == bytes.fromhex("00 00 00 00 01 01")


class Chopped(SimulatedTransport):
    """The framed board on a line without borders: pieces of any size, garbage between them, no lock step."""

    stream, lock_step = True, False

    def __init__(self) -> None:
        board = Board(make_plant(MOTOR, "chopped"), seed=1, layout="framed")
        super().__init__(board.step, "serial:x", "a stream")
        self._random, self._held, self.time_s = random.Random(1), b"", 0.0

    def receive(self, timeout_s: float) -> bytes:
        self.time_s += 0.005
        garbage = self._random.randbytes(20) + b"\xa5\x5a" if self._random.random() < 0.03 else b""
        self._held += garbage + super().receive(timeout_s)
        cut = self._random.randint(1, len(self._held))
        piece, self._held = self._held[:cut], self._held[cut:]
        return piece


def test_a_run_on_a_chopped_stream_has_the_rows_of_its_ticks_and_replays_alike(tmp_path: Path) -> None:
    profile = TargetProfile.load("serial-framed")
    line = Chopped()
    clock = PlayedClock(lambda: line.time_s)
    with asking(trace=tmp_path / "t.jsonl"), Bench(watched(line, profile, clock), profile, clock=clock) as bench:
        log = bench.run(STAIRS)
        counts = bench.statistics.link
    assert counts.garbage_bytes > 20
    assert len(log) > 60
    assert log.time_s[-1] == pytest.approx(0.6, abs=0.03)
    assert "bytes of garbage" in log.metadata["tick_statistics"]
    with connect(f"replay:{tmp_path / 't.jsonl'}") as bench:
        again = bench.run(STAIRS)
        assert bench.statistics.link == counts
    assert np.array_equal(rows(log), rows(again))


# ---- sniff ---------------------------------------------------------------------------------------------------------


def test_sniff_shows_bytes_fields_and_what_changed(tmp_path: Path) -> None:
    assert run("manual", "--pwm", 60, "--duration", 0.5, "--fast", "--trace", tmp_path / "t.jsonl").exit_code == 0
    done = run("sniff", "--replay", tmp_path / "t.jsonl", "--count", 0, "--json", tmp_path / "s.json")
    assert done.exit_code == 0, done.output
    shown = re.findall(r" in  00>([0-9a-f]{2}) \.\.\+62   direction 0  pos (\d+)\n", done.stdout)
    assert len(shown) > 10
    assert all(int(byte, 16) == int(pos) for byte, pos in shown)
    assert "duty_pct 60  c3 1  c4 0" in done.stdout
    told = json.loads((tmp_path / "s.json").read_text())
    moved = {row["offset"]: row for row in told["in"]["bytes_that_changed"]}
    assert {1} <= set(moved) <= {1, 2}
    assert moved[1]["u16_high"] > 50
    assert {row["offset"] for row in told["out"]["bytes_that_changed"]} >= {2, 3, 5}
    assert told["refused"] == 0


def test_sniff_drives_nothing_and_says_what_does_not_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(SimulatedTransport, "send", lambda self, report: pytest.fail("sniff has sent something"))
    text = TargetProfile.load("sim-framed").text.replace('board_layout = "framed-hid"', 'board_layout = "assumed"')
    (tmp_path / "wrong.toml").write_text(text)
    done = run("sniff", "--target", tmp_path / "wrong.toml", "--count", 5)
    assert done.exit_code == 0, done.output
    assert "REFUSED: a report begins with 00 00" in done.stdout
    assert "5 reports do not fit the layout" in done.stdout


@pytest.mark.parametrize("group", [(), ("lab",)])
def test_every_command_with_a_target_can_be_traced_and_limited(group: tuple[str, ...]) -> None:
    parent: Any = cli
    for name in group:
        parent = parent.get_command(click.Context(parent), name)
    found = 0
    for name in parent.list_commands(click.Context(parent)):
        command = parent.get_command(click.Context(parent), name)
        options = {option for parameter in command.params for option in parameter.opts}
        if "--target" in options:
            found += 1
            assert {"--trace", "--limit"} <= options, name
    assert found > 4


# ---- targets -------------------------------------------------------------------------------------------------------


def test_a_profile_is_a_target_by_name_or_file_with_what_follows_its_medium(tmp_path: Path) -> None:
    assert split_target("sim-framed:ideal") == ("sim", "ideal", "sim-framed")
    assert split_target("serial-framed:/dev/ttyACM0") == ("serial", "/dev/ttyACM0", "serial-framed")
    assert split_target("serial:COM3") == ("serial", "COM3", "serial-documented")
    mine = tmp_path / "mine.toml"
    mine.write_text(TargetProfile.load("serial-framed").text)
    assert split_target(f"{mine}:COM3") == ("serial", "COM3", str(mine))
    for wrong in ("sim-frame", "replay:", "replay", str(tmp_path / "other.toml")):
        with pytest.raises(ConfigError):
            split_target(wrong)


@pytest.mark.parametrize("plant", ["default", "ideal"])
def test_the_framed_board_gives_the_same_log_as_the_plain_one(plant: str) -> None:
    logs = []
    for target in (f"sim:{plant}", f"sim-framed:{plant}"):
        with connect(target, seed=4) as bench:
            logs.append(rows(bench.run(STAIRS)))
    assert np.array_equal(*logs)


def test_a_row_has_the_time_of_its_own_tick_where_reports_carry_it() -> None:
    """A report that comes two ticks late is of its own tick; without a number it is taken for what came then."""
    logs = {}
    for layout, profile in (("framed-hid", "sim-framed"), ("assumed", "hid-assumed")):
        faults = {"direction": "to_host", "report_late_ratio": 0.1, "report_late_s": 0.01}
        plant = make_plant({**MOTOR, "faults": faults}, "late")
        assert plant.faults is not None
        board = FaultyBoard(Board(plant, seed=1, layout=layout), plant.faults, seed=1)
        with Bench(SimulatedTransport(board.step, "sim", "x"), TargetProfile.load(profile)) as bench:
            logs[layout] = bench.drive(60.0, 0.8)
            assert bench.statistics.link.lost == 0
            assert bench.statistics.passed_over > 0
    rough = {}
    for name, log in logs.items():
        speed = np.diff(log.output) / np.diff(log.time_s)
        rough[name] = np.abs(np.diff(speed[60:])).max()  # at a steady speed only whole counts are left
    assert np.all(np.diff(np.rint(logs["framed-hid"].time_s / 0.005)) >= 1)
    assert rough["framed-hid"] < 0.5 * rough["assumed"]


# ---- limits --------------------------------------------------------------------------------------------------------


def test_beyond_the_travel_limit_the_bench_brakes_and_says_so(tmp_path: Path) -> None:
    log_path = tmp_path / "log.csv"
    done = run("manual", "--pwm", 60, "--duration", 5, "--fast", "--limit", "travel_deg=90", "--log", log_path)
    assert done.exit_code == 1
    assert "travel limit of 90 deg: braked" in done.stderr
    log = Log.read(log_path)
    travel = np.abs(log.output - log.output[0])
    assert 60.0 < travel.max() <= 90.0
    assert log.metadata["limits"] == "travel 90 deg"


def test_a_run_ends_at_its_longest_time() -> None:
    with connect("sim", seed=1, limits={"run_time_s": 0.25}) as bench:
        with pytest.raises(LimitError, match=r"0\.25 s: braked"):
            bench.drive(20.0, 10.0)
        assert bench.drive(20.0, 0.2).time_s[-1] < 0.25


def test_the_slew_limit_holds_the_duty_back_and_the_log_has_what_was_sent() -> None:
    with connect("sim", seed=1, limits={"slew_pct_per_s": 200.0}) as bench:
        log = bench.run(STAIRS)
        assert bench.statistics.slowed > 50
    assert "held back by the slew limit" in log.metadata["tick_statistics"]
    assert np.abs(np.diff(log.duty_pct)).max() <= 1.0 + 1e-6
    assert log.duty_pct[:31] == pytest.approx(np.arange(1.0, 32.0).clip(max=30.0), abs=1e-5)


def test_a_duty_beyond_the_limit_is_never_sent(tmp_path: Path) -> None:
    done = run("manual", "--pwm", -60, "--duration", 1, "--fast", "--limit", "duty_pct=50", "--trace", tmp_path / "t")
    assert done.exit_code == 1
    assert "limit of 50 %" in done.stderr
    profile = TargetProfile.load()
    sent = [event.data for event in TraceReader(tmp_path / "t").events() if event.direction == "out"]
    assert sent
    assert all(profile.codec.command_layout.decode(report)["duty_pct"] == 0.0 for report in sent)


def test_a_limit_can_only_be_made_stricter_and_an_unknown_one_is_refused() -> None:
    mine = Limits(duty_pct=60.0, travel_deg=100.0)
    assert mine.within({"duty_pct": 80.0, "travel_deg": 50.0}) == Limits(duty_pct=60.0, travel_deg=50.0)
    for text, reason in (("trvel_deg=3", "travel_deg"), ("travel_deg=x", "not a number"), ("travel_deg=-1", "outside")):
        done = run("manual", "--pwm", 1, "--duration", 1, "--fast", "--limit", text)
        assert done.exit_code == 1
        assert reason in done.stderr


@settings(max_examples=100)
@given(
    st.lists(st.tuples(st.floats(-100, 100), st.sampled_from(["drive", "brake", "standby"])), min_size=1, max_size=40),
    st.floats(1.0, 5000.0),
)
def test_no_step_between_driving_commands_is_larger_than_the_slew_limit(asked: Any, slew: float) -> None:
    from fiohost.wire.messages import BRAKE_COMMAND, DRIVE, STANDBY_COMMAND, Command

    limiter, last = Limiter(Limits(slew_pct_per_s=slew), 0.005), 0.0
    for k, (duty_pct, mode) in enumerate(asked):
        wanted = {"drive": Command.drive(duty_pct), "brake": BRAKE_COMMAND, "standby": STANDBY_COMMAND}[mode]
        allowed = limiter.allow(wanted, 0.0, 0.005 * k)
        if wanted.mode != DRIVE:
            assert allowed == wanted
        else:
            assert abs(allowed.duty_pct - last) <= 0.005 * slew + 1e-5
        last = allowed.duty_pct


def test_limits_are_errors_of_the_one_tree() -> None:
    assert issubclass(LimitError, FiohostError)


def test_the_times_of_each_session_begin_at_0(tmp_path: Path) -> None:
    writer = TraceWriter(tmp_path / "trace")
    for begun_s in (100.0, 250.0):
        writer.session({"lock_step": True}, begun_s)
        writer.event(begun_s + 0.25, "in", b"\x01")
    writer.close()
    events = [json.loads(line) for line in (tmp_path / "trace").read_text().splitlines()]
    assert [event["t"] for event in events if "t" in event] == [0.25, 0.25]
