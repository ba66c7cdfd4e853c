"""Lines that pass on to others and tell of it; simulated boards and those of machine code as lines."""

from __future__ import annotations

import logging
from types import SimpleNamespace
from typing import Any

import pytest
from boards import WatchedTransport

from fiohost.bench.connect import connect
from fiohost.errors import ConfigError, DisconnectedError, LogError, TelemetryTimeoutError
from fiohost.transport import emulated, simulated
from fiohost.transport.base import Transport, Way
from fiohost.transport.instruments import Instruments, break_seal
from fiohost.transport.simulated import SimulatedTransport, plant_board, sealed_board
from fiohost.transport.timed import TimedTransport
from fiohost.transport.traced import TracedTransport, is_debugged

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
