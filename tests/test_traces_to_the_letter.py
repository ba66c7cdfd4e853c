"""Traces, replays and the lines around other lines, event by event; and what a target profile may leave away."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from boards import WatchedTransport

from fiohost.bench.connect import asking, connect
from fiohost.errors import ConfigError, DisconnectedError, LogError, TelemetryTimeoutError
from fiohost.transport import emulated, replay, simulated
from fiohost.transport.base import Transport, Way
from fiohost.transport.instruments import Instruments, break_seal
from fiohost.transport.profile import Limits, TargetProfile
from fiohost.transport.replay import ReplayTransport
from fiohost.transport.simulated import SimulatedTransport, plant_board, sealed_board
from fiohost.transport.timed import TimedTransport
from fiohost.transport.trace import MAX_LINE_BYTES, Event, TraceReader, TraceWriter
from fiohost.transport.traced import TracedTransport, is_debugged

HEAD = {
    "schema": "fiohost.trace/1", "profile": "hid-assumed", "profile_toml": TargetProfile.load().text,
    "lock_step": True, "stream": False,
}  # fmt: skip


def trace_of(path: Path, *events: Any, **head: Any) -> Path:
    """A file with that head and those lines (text as it is, else JSON)."""
    lines = [json.dumps({**HEAD, **head}), *(e if isinstance(e, str) else json.dumps(e) for e in events)]
    path.write_text("\n".join(lines) + "\n")
    return path


# ---- reading -------------------------------------------------------------------------------------------------------


def test_events_are_read_with_their_time_bytes_and_count(tmp_path: Path) -> None:
    path = trace_of(
        tmp_path / "t.jsonl", {"t": 1, "dir": "in", "hex": "00 ff", "passed_over": 4294967295},
        {"t": -1e12, "dir": "none"}, HEAD, {"t": 1e12, "dir": "gone"}, {"t": 0.5, "dir": "out", "hex": "7e"},
    )  # fmt: skip
    assert list(TraceReader(path).events()) == [
        Event(1.0, "in", b"\x00\xff", 4294967295), Event(-1e12, "none"), Event(1e12, "gone"), Event(0.5, "out", b"~"),
    ]  # fmt: skip
    assert Event(0.0, "in") == Event(0.0, "in", b"", 0)


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ({"t": 1.0000001e12, "dir": "in"}, "is not an event: dir is one of out, in, none, gone"),
        ({"t": 0, "dir": "in", "passed_over": 4294967296}, "is not an event: dir"),
        ({"t": 0, "dir": "in", "passed_over": -1}, "is not an event: dir"),
        ({"t": 0, "dir": "up"}, "is not an event: dir"),
        ({"dir": "in"}, "is not an event with t, dir and hex .KeyError"),
        ({"t": 0, "dir": "in", "hex": "0g"}, "is not an event with t, dir and hex .ValueError"),
        ("[]", "is not a JSON object"),
        ("{", "is not a JSON object"),
        ({"schema": "fiohost.trace/1", "profile_toml": "other"}, "begins a session with another target profile"),
        (" " * (MAX_LINE_BYTES + 2), "is longer than 100000 bytes"),
    ],
)
def test_a_line_that_is_no_event_is_told_by_its_number(line: Any, said: str, tmp_path: Path) -> None:
    path = trace_of(tmp_path / "t.jsonl", {"t": 0, "dir": "none"}, line)
    with pytest.raises(ConfigError, match=f"t.jsonl line 3 {said}"):
        list(TraceReader(path).events())


def test_a_line_may_be_as_long_as_is_said_and_the_last_may_be_cut_off(tmp_path: Path) -> None:
    event = json.dumps({"t": 0, "dir": "none"})
    longest = event + " " * (100_000 - len(event))
    path = trace_of(tmp_path / "t.jsonl", longest)
    assert list(TraceReader(path).events()) == [Event(0.0, "none")]
    with path.open("a") as file:
        file.write(longest)
    assert len(list(TraceReader(path).events())) == 1
    with pytest.raises(ConfigError, match="is longer than 100000"):
        list(TraceReader(trace_of(path, longest + " ")).events())
    for text in ("", "[]\n", '{"schema": "fiohost.trace/2"}\n'):
        path.write_text(text)
        with pytest.raises(ConfigError, match="is not a trace: its first line"):
            TraceReader(path)


# ---- writing -------------------------------------------------------------------------------------------------------


def test_a_trace_is_written_with_microseconds_since_its_session_began(tmp_path: Path) -> None:
    writer = TraceWriter(tmp_path / "t.jsonl")
    writer.session({"lock_step": True, "name": "ä"}, 100.0)
    writer.event(100.12345678, "in", b"\x01\x02", 3)
    writer.event(100.25, "none")
    writer.session({"lock_step": True}, 200.0)
    writer.event(200.5, "out", b"\x03")
    writer.close()
    writer.event(300.0, "in")  # nobody hears it
    lines = (tmp_path / "t.jsonl").read_text().splitlines()
    assert lines == [
        '{"schema": "fiohost.trace/1", "lock_step": true, "name": "ä"}',
        '{"t": 0.123457, "dir": "in", "hex": "01 02", "passed_over": 3}', '{"t": 0.25, "dir": "none"}',
        '{"schema": "fiohost.trace/1", "lock_step": true}', '{"t": 0.5, "dir": "out", "hex": "03"}',
    ]  # fmt: skip
    TraceWriter(tmp_path / "none.jsonl").close()


class Behind:
    """What writes behind the loop, as a test has it."""

    def __init__(self, *, takes: bool = True, ends: bool = True, problem: Exception | None = None) -> None:
        self.waiting, self.problem, self._takes, self._ends = 5, problem, takes, ends
        self.put_in: list[bytes] = []

    def put(self, line: bytes) -> bool:
        self.put_in.append(line)
        return self._takes

    def close(self, limit_s: float) -> bool:
        assert limit_s == 5.0
        return self._ends


def test_a_disk_that_fails_under_a_trace_is_said_once_and_the_brake_goes_out(tmp_path: Path) -> None:
    def behind(**how: Any) -> Any:
        made: Any = TraceWriter(tmp_path / f"{len(list(tmp_path.iterdir()))}.jsonl")
        made.session({}, 0.0)
        made._behind.close(100.0)
        made._behind = Behind(**how)
        return made

    writer = behind(takes=False)
    with pytest.raises(LogError, match=r"cannot write the trace .*: the disk takes nothing"):
        writer.event(0.0, "in")
    writer.event(0.0, "out")
    assert len(writer._behind.put_in) == 1
    writer = behind(problem=LogError("full"))
    with pytest.raises(LogError, match="full"):
        writer.event(0.0, "in")
    writer.event(0.0, "out")
    writer.close()  # it was said
    writer = behind(problem=LogError("full"))
    with pytest.raises(LogError, match="full"):
        writer.close()
    with pytest.raises(LogError, match="does not answer: 5 lines are lost"):
        behind(ends=False).close()


# ---- replays -------------------------------------------------------------------------------------------------------


def test_a_replay_gives_what_came_in_its_order_and_ends_once(tmp_path: Path) -> None:
    path = trace_of(
        tmp_path / "t.jsonl", {"t": 0.25, "dir": "out", "hex": "09"},
        {"t": 0.5, "dir": "in", "hex": "01", "passed_over": 2}, {"t": 0.75, "dir": "none"},
        {"t": 1.0, "dir": "in", "hex": "02", "passed_over": 3}, {"t": 1.25, "dir": "gone"}, {"t": 1.5, "dir": "none"},
        identity="x" * 300, target="y" * 300, counts_per_rev=4, facts={"plant": "p", "n": 1},
    )  # fmt: skip
    made = ReplayTransport(path)
    assert (made.time_s, made.name, made.identity) == (0.0, f"replay:{path}", "x" * 200)
    assert (made.lock_step, made.stream, made.counts_per_rev) == (True, False, 4)
    assert made.facts == {"plant": "p", "n": "1", "replay_of": "y" * 200}
    with pytest.raises(DisconnectedError, match="the trace is closed"):
        made.send(b"")
    made.open()
    assert (made.receive(0.0), made.time_s, made.passed_over) == (b"\x01", 0.5, 2)
    with pytest.raises(TelemetryTimeoutError, match="nothing came in this tick"):
        made.receive(0.0)
    assert (made.receive(0.0), made.passed_over) == (b"\x02", 5)
    with pytest.raises(DisconnectedError, match="ends here"):
        made.receive(0.0)
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.0)
    with pytest.raises(TelemetryTimeoutError, match="the trace has ended"):
        made.receive(0.0)
    made.close()
    made.open()
    assert made.receive(0.0) == b"\x01"


@pytest.mark.parametrize(("counts", "found"), [(3, None), (1 << 24, 1 << 24), ((1 << 24) + 1, None), ("720", None)])
def test_a_replay_believes_counts_that_can_be(counts: Any, found: int | None, tmp_path: Path) -> None:
    made = ReplayTransport(trace_of(tmp_path / "t.jsonl", counts_per_rev=counts, facts=3, lock_step=1, stream="yes"))
    assert (made.counts_per_rev, made.facts) == (found, {"replay_of": ""})
    assert (made.lock_step, made.stream) == (False, False)
    for missing in ("profile", "profile_toml"):
        with pytest.raises(ConfigError, match="has no profile and profile_toml"):
            ReplayTransport(trace_of(tmp_path / "t.jsonl", **{missing: None}))


def test_a_replay_is_paced_where_that_is_asked_and_never_by_more_than_a_second(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    slept: list[float] = []
    now_s = [1000.0]
    monkeypatch.setattr(replay, "time", SimpleNamespace(monotonic=lambda: now_s[0], sleep=slept.append))
    path = trace_of(tmp_path / "t.jsonl", *({"t": t, "dir": "in", "hex": "01"} for t in (0.25, 0.5, 9.0)))
    made = ReplayTransport(path, paced=True)
    made.open()
    for t in (1000.0, 1000.75, 1000.75):
        now_s[0] = t
        made.receive(0.0)
    assert slept == [0.25, 0.0, 1.0]
    plain = ReplayTransport(path)
    plain.open()
    plain.receive(0.0)
    assert len(slept) == 3


# ---- lines around lines --------------------------------------------------------------------------------------------


class Inner(Transport):
    """A line that gives what is laid ready."""

    def __init__(self) -> None:
        self.name, self.identity, self.facts = "inner", "unknown", {}
        self.ready: list[Any] = []
        self.done: list[object] = []

    def open(self) -> None:
        self.done.append("open")
        self.identity, self.facts = "board", {"fact": "1"}
        self.can_reopen = self.is_known_again = self.stream = True
        self.counts_per_rev = 1000

    def reopen(self) -> None:
        self.done.append("reopen")
        self.identity = "another"

    def send(self, report: bytes) -> None:
        if self.ready and isinstance(self.ready[0], Exception):
            raise self.ready.pop(0)
        self.done.append(report)

    def receive(self, timeout_s: float) -> bytes:
        come, passed_over = self.ready.pop(0)
        self.passed_over += passed_over
        if isinstance(come, Exception):
            raise come
        return bytes(come)

    def close(self) -> None:
        self.done.append("close")

    @property
    def way(self) -> Way | None:
        return Way(fd=3)


def test_what_crosses_a_line_is_told_to_the_trace_as_it_happens() -> None:
    told: list[Any] = []
    trace: Any = SimpleNamespace(
        session=lambda head, now: told.append((head, now)), event=lambda *event: told.append(event)
    )
    inner, now_s = Inner(), iter(range(1, 100))
    made = TracedTransport(inner, trace, lambda: float(next(now_s)), {"profile": "p", "identity": "head's"})
    made.open()
    assert told.pop() == (
        {"target": "inner", "identity": "head's", "lock_step": False, "stream": True, "counts_per_rev": 1000,
         "facts": {"fact": "1"}, "profile": "p"}, 1.0,
    )  # fmt: skip
    assert (made.identity, made.can_reopen, made.is_known_again, made.stream, made.counts_per_rev, made.way) == (
        "board", True, True, True, 1000, Way(fd=3),
    )  # fmt: skip
    inner.ready = [(b"one", 2), (TelemetryTimeoutError("no"), 0), (b"two", 1), (DisconnectedError("gone"), 0)]
    made.send(b"out")
    made.receive(0.1)
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.1)
    made.receive(0.1)
    assert made.passed_over == 3
    with pytest.raises(DisconnectedError):
        made.receive(0.1)
    inner.ready = [DisconnectedError("gone")]
    with pytest.raises(DisconnectedError):
        made.send(b"lost")
    assert told == [
        (2.0, "out", b"out", 0), (3.0, "in", b"one", 2), (4.0, "none", b"", 0), (5.0, "in", b"two", 1),
        (6.0, "gone", b"", 0), (7.0, "gone", b"", 0),
    ]  # fmt: skip
    made.reopen()
    assert made.identity == "another"
    made.close()
    assert inner.done == ["open", b"out", "reopen", "close"]


def test_a_trace_that_cannot_begin_lets_the_line_go() -> None:
    def fails(head: object, now_s: float) -> None:
        raise LogError("full")

    inner = Inner()
    trace: Any = SimpleNamespace(session=fails)
    with pytest.raises(LogError, match="full"):
        TracedTransport(inner, trace).open()
    assert inner.done == ["open", "close"]
    plain = TracedTransport(Inner())
    plain.open()
    plain.send(b"x")  # without a trace nobody is told


def test_traffic_is_shown_in_hex_where_that_is_asked(caplog: pytest.LogCaptureFixture) -> None:
    assert not is_debugged()
    with caplog.at_level(logging.DEBUG, "fiohost.traffic"):
        assert is_debugged()
        inner = Inner()
        made = TracedTransport(inner)
        inner.ready = [(b"\x01\x00\x02\x00", 0)]
        made.send(b"\x03\x00")
        inner.ready = [(b"\x01\x00\x02\x00", 0)]
        made.receive(0.1)
    assert caplog.messages == ["out   2: 03", "in    4: 01 00 02"]
    quiet = TracedTransport(Inner())
    quiet.send(b"\x03")
    assert len(caplog.messages) == 2


def test_a_timed_line_passes_everything_on_and_notes_when() -> None:
    inner, now_s = Inner(), iter([10.0, 10.25, 11.0, 11.5])
    made = TimedTransport(inner, lambda: next(now_s))
    made.open()
    inner.ready = [(b"one", 2)]
    assert made.receive(0.1) == b"one"
    assert made.passed_over == 2
    made.send(b"answer")
    inner.ready = [(b"two", 0)]
    made.receive(0.1)
    made.send(b"answer")
    assert (made.received_s, made.answered_s) == ([10.0, 11.0], [0.25, 0.5])
    assert (made.name, made.identity, made.can_reopen, made.is_known_again, made.stream, made.way) == (
        "inner", "board", True, True, True, Way(fd=3),
    )  # fmt: skip
    made.reopen()
    assert made.identity == "another"
    made.close()
    assert inner.done == ["open", b"answer", b"answer", "reopen", "close"]


# ---- simulated and emulated boards ---------------------------------------------------------------------------------


def test_a_simulated_board_takes_the_newest_report_once_and_gives_the_newest() -> None:
    heard: list[bytes | None] = []
    gives: list[Any] = [b"one", [], [b"a", b"b", b"c"], [b"d"]]
    made = SimulatedTransport(lambda report: (heard.append(report), gives.pop(0))[1], "sim", "simulated")
    for call in (lambda: made.send(b"x"), lambda: made.receive(0.0)):
        with pytest.raises(DisconnectedError, match="simulated board is closed"):
            call()
    made.open()
    made.send(b"old")
    made.send(b"new")
    assert made.receive(0.0) == b"one"
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.0)
    assert (made.receive(0.0), made.passed_over) == (b"c", 2)
    assert (made.receive(0.0), made.passed_over) == (b"d", 2)
    assert heard == [b"new", None, None, None]
    assert (made.lock_step, made.facts, made.counts_per_rev) == (True, {}, None)
    made.close()
    with pytest.raises(DisconnectedError):
        made.receive(0.0)


def test_boards_by_plant_and_by_seed() -> None:
    plain = plant_board("")
    assert (plain.name, plain.identity, plain.counts_per_rev) == ("sim", "simulated", 720)
    assert plain.facts.keys() == {"plant", "supply_V", "pwm_hz"}
    assert plant_board("ideal").name == "sim:ideal"
    assert simulated._boards[plain] is not None
    for faulty, name in ((False, "sim:sealed"), (True, "sim:sealed-faulty")):
        made = sealed_board(7, faulty=faulty)
        assert (made.name, made.identity) == (name, "simulated, sealed")
        assert made.facts.keys() == {"sealed_version"}
        assert made not in simulated._boards
    told: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("firmware_model.Board", lambda plant, **asked: told.update(asked) or SimpleNamespace(step=None))
        plant_board("", 3)
        assert told == {"seed": 3, "layout": "assumed", "duty_steps": 3600}
        plant_board("", duty_steps=100, layout="documented")
        assert told == {"seed": None, "layout": "documented", "duty_steps": 100}
        sealed_board(5)
        assert told == {"seed": 5, "layout": "assumed", "duty_steps": 3600}
        sealed_board(5, duty_steps=10)
        assert told["duty_steps"] == 10
    with pytest.raises(ConfigError):
        plant_board("", layout="nonsense")
    with pytest.raises(ConfigError):
        sealed_board(5, layout="nonsense")


def test_a_board_of_machine_code_is_stepped_with_what_waits_for_it() -> None:
    heard: list[bytes] = []
    gives = [b"tele", b""]
    board: Any = SimpleNamespace(step=lambda waiting: (heard.append(waiting), gives.pop(0))[1])
    made = emulated.EmulatedTransport(board, "emulated:uno", "chip", {"a": "b"})
    assert (made.name, made.identity, made.facts, made.lock_step, made.stream) == (
        "emulated:uno", "chip", {"a": "b"}, True, True,
    )  # fmt: skip
    for call in (lambda: made.send(b"x"), lambda: made.receive(0.0)):
        with pytest.raises(DisconnectedError, match="emulated board is closed"):
            call()
    made.open()
    made.send(b"a")
    made.send(b"b")
    assert made.receive(0.0) == b"tele"
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.0)
    assert heard == [b"ab", b""]
    made.close()
    with pytest.raises(DisconnectedError):
        made.receive(0.0)
    with pytest.raises(ConfigError, match="emulated needs a board"):
        emulated.split_emulated("")
    name, plant = emulated.split_emulated("uno:my:plant")
    assert plant == "my:plant"
    assert name.startswith("uno")


class FakeEmulator:
    """In the place of the emulator: keeps what it was made of."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        import firmware_model
        import firmware_model.emulated.board as boards

        self.made: list[Any] = []
        self.drawn: list[int] = []
        draw = firmware_model.draw
        monkeypatch.setattr(firmware_model, "draw", lambda seed: (self.drawn.append(seed), draw(seed))[1])
        monkeypatch.setattr(emulated, "_chip", lambda board: lambda path: (board, path.suffix))
        monkeypatch.setattr(boards, "EmulatedBoard", self.make)

    def make(self, chip: Any, plant: Any, name: str, bridge: str, *, seed: int | None) -> Any:
        self.made.append((chip, plant.name, name, bridge, seed))
        return SimpleNamespace()


def test_which_board_of_machine_code_with_which_plant(monkeypatch: pytest.MonkeyPatch) -> None:
    fake = FakeEmulator(monkeypatch)
    plain = emulated.emulated_board("uno", 4)
    chip, plant, name, _, seed = fake.made[-1]
    assert (chip, plant, name, seed) == (("uno", ".hex"), "default", "uno", 4)
    assert plain.facts.keys() == {"plant", "supply_V", "pwm_hz"}
    assert (plain.name, "sealed" in plain.identity, plain in simulated._boards) == ("emulated:uno", False, True)
    assert emulated.emulated_board("uno:ideal").facts["plant"] == "ideal"
    for given, drawn in ((9, 9), (None, 0)):
        sealed = emulated.emulated_board("uno:sealed", given)
        assert (sealed.facts.keys(), fake.drawn[-1]) == ({"sealed_version"}, drawn)
        assert sealed.identity.endswith(", sealed")
        assert sealed not in simulated._boards
    with pytest.raises(ConfigError):
        emulated.emulated_board("uno:no such plant")


def test_instruments_are_of_open_simulated_benches_alone() -> None:
    with connect("sim") as bench:
        made = Instruments.of(bench)
        assert isinstance(made.current_A, float)
        for call in (
            lambda: made.hang_mass(-1.0, 0.1),
            lambda: made.disturb(float("inf")),
            lambda: made.limit_current(0.0),
        ):
            with pytest.raises(ConfigError):
                call()
    for name, said in (("sim:sealed", "shows nothing but its wire"), ("emulated:uno:sealed", "nothing but its wire"),
                       ("hid:sealed", "nothing but"), ("sealed", "nothing but"), ("serial:COM3", "read the meters"),
                       ("", "this target has no instruments: read")):  # fmt: skip
        transport = WatchedTransport()
        transport.name = name
        with pytest.raises(ConfigError, match=said):
            Instruments.of(SimpleNamespace(transport=transport))  # type: ignore[arg-type]
    traced: Any = SimpleNamespace(transport=TracedTransport(plant_board("")))
    assert isinstance(Instruments.of(traced).voltage_V, float)
    assert "faults" in break_seal(3, faulty=True)
    assert "faults" not in break_seal(3)
    with pytest.raises(ConfigError):
        break_seal(3, 999)
    assert break_seal(3, 1).keys() == break_seal(3).keys()


# ---- what a target may leave away ----------------------------------------------------------------------------------


def profile(**changes: str | None) -> TargetProfile:
    """The plain one with keys changed, or left away."""
    lines = TargetProfile.load("serial-documented").text.splitlines()
    place = next(k for k, line in enumerate(lines) if line.startswith("["))
    kept = [line for line in lines[:place] if line.split("=")[0].strip() not in changes]
    more = [f"{name} = {value}" for name, value in changes.items() if value is not None]
    return TargetProfile.parse("\n".join([*kept, *more, *lines[place:]]), "mine")


def test_what_nobody_says_of_a_target() -> None:
    bare = profile(title=None, status=None, sample_time_s=None, counts_per_rev=None, duty_steps=None, baud=None,
                   watchdog_s=None)  # fmt: skip
    assert (bare.title, bare.status, bare.sample_time_s, bare.counts_per_rev) == ("mine", "assumed", 0.005, 720)
    assert (bare.duty_steps, bare.baud, bare.watchdog_s, bare.board, bare.board_layout) == (
        0,
        115_200,
        0.0,
        "",
        "assumed",
    )
    told = profile(sample_time_s="0.01", counts_per_rev="1000", duty_steps="7", baud="9600", watchdog_s="0.5")
    assert (told.sample_time_s, told.counts_per_rev, told.duty_steps, told.baud, told.watchdog_s) == (
        0.01, 1000, 7, 9600, 0.5,
    )  # fmt: skip
    assert told.codec.counts_per_rev == 1000
    other = told.with_counts(360)
    assert (other.counts_per_rev, other.codec.counts_per_rev, other.duty_steps) == (360, 360, 7)
    assert told.with_counts(1000) is told
    assert told.with_counts(None) is told
    assert told.limit_duty_pct == told.limits.duty_pct
    with pytest.raises(ConfigError, match="transport"):
        profile(transport='"usb"')
    layout = profile(transport='"sim"', board_layout='"documented"')
    assert layout.board_layout == "documented"
    with pytest.raises(ConfigError, match="board_layout"):
        profile(board_layout='"documented"')


def identified(text: str) -> TargetProfile:
    base = TargetProfile.load("hid-assumed").text
    begin = base.index("[identity]")
    end = base.index("[", begin + 1)
    return TargetProfile.parse(base[:begin] + f"[identity]\n{text}\n" + base[end:], "mine")


def test_an_identity_is_two_numbers_of_sixteen_bits_each_of_which_may_be_missing() -> None:
    assert (identified("").vendor_id, identified("").product_id) == (None, None)
    both = identified("vendor_id = 0\nproduct_id = 65535\nboard = 'x'")
    assert (both.vendor_id, both.product_id, both.board) == (0, 65535, "x")
    assert (identified("vendor_id = 65535").vendor_id, identified("product_id = 0").product_id) == (65535, 0)
    for text in ("vendor_id = -1", "vendor_id = 65536", "product_id = -1", "product_id = 65536", "vendr_id = 1"):
        with pytest.raises(ConfigError):
            identified(text)


def test_limits_are_the_stricter_of_two_and_told_in_words() -> None:
    plain = Limits()
    assert plain.describe() == ""
    mine = plain.within({"duty_pct": 60.0, "travel_deg": 90.0})
    assert mine.describe() == "duty 60 %, travel 90 deg"
    both = mine.within({"duty_pct": 80.0, "travel_deg": 45.0, "slew_pct_per_s": 200.0, "run_time_s": 9.0})
    assert both == Limits(60.0, 200.0, 45.0, 9.0)
    assert both.describe() == "duty 60 %, slew 200 %/s, travel 45 deg, run 9 s"
    with pytest.raises(ConfigError, match="duty_pc"):
        plain.within({"duty_pc": 1.0})
    guards = TargetProfile.load().guards
    assert guards.changed({"stall_s": 1.0}) == replace(guards, stall_s=1.0)
    with pytest.raises(ConfigError, match="stal_s"):
        guards.changed({"stal_s": 1.0})


# ---- what is asked for everything that is connected ----------------------------------------------------------------


def test_what_is_asked_holds_within_and_the_stricter_of_the_limits(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(limits={"duty_pct": 50.0}, guards={"stall_s": 9.0}), asking(trace=path, guards={"late_pct": 5.0}):
        with connect("sim", limits={"duty_pct": 80.0}, guards={"stall_s": 7.0}, reconnect_s=2.0) as bench:
            assert isinstance(bench.transport, TracedTransport)
            assert bench.profile.limits.duty_pct == 50.0
            assert (bench.profile.guards.stall_s, bench.profile.guards.late_pct) == (7.0, 5.0)
            assert bench.reconnect_s == 2.0
        with asking(limits={"duty_pct": 60.0}), connect("sim") as bench:
            assert bench.profile.limits.duty_pct == 50.0
        with asking(limits={"duty_pct": 40.0, "travel_deg": 90.0}), connect("sim") as bench:
            assert isinstance(bench.transport, TracedTransport)
            assert bench.profile.limits.travel_deg == 90.0
            assert (bench.profile.limits.duty_pct, bench.profile.guards.stall_s) == (40.0, 9.0)
            assert bench.profile.guards.late_pct == 5.0
    assert [json.loads(line)["schema"] for line in path.read_text().splitlines() if "schema" in line] == [
        "fiohost.trace/1"
    ] * 3
    with connect("sim") as bench:
        assert not isinstance(bench.transport, TracedTransport)
        assert bench.profile.guards.stall_s == 3.0
    head = json.loads(path.read_text().splitlines()[0])
    assert (head["profile"], head["sample_time_s"], head["target"], head["lock_step"]) == (
        "hid-assumed", 0.005, "sim", True,
    )  # fmt: skip
    assert head["profile_toml"] == TargetProfile.load().text
