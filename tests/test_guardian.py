"""Whatever becomes of the host in mid-run, the motor is braked: by its guardian where the host cannot."""

from __future__ import annotations

import os
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest
from boards import rows_of, until
from lines import PtyBoard, patient
from places import PACKAGES
from test_safe_stops import FORWARD, LIMIT_S, MAIN, STEP_40, Host

from fiohost.bench.guardian import Guardian
from fiohost.bench.log import Log
from fiohost.bench.program import Answer, Hold
from fiohost.errors import HostError, TransportError
from fiohost.wire.messages import Command

GAP_S = 2.0  # of a machine that has much to do
RUN = ["run", "step_40.toml", "--log", "run.csv"]


@pytest.fixture(autouse=True)
def _checkout(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))
    (tmp_path / "step_40.toml").write_text(STEP_40)


@pytest.fixture
def board() -> Iterator[PtyBoard]:
    with PtyBoard() as made:
        yield made


def braked(board: PtyBoard) -> None:
    until(lambda: board.braked)


@pytest.mark.parametrize("name", ["SIGKILL", "SIGSEGV", "SIGABRT"])
def test_a_host_that_is_killed_or_crashes(board: PtyBoard, tmp_path: Path, name: str) -> None:
    host = Host(board, tmp_path, *RUN)
    host.drives()
    os.kill(host.process.pid, getattr(signal, name))
    assert host.process.wait(LIMIT_S) == -getattr(signal, name)
    braked(board)
    log = Log.read(host.log)
    assert len(log) >= 49
    assert log.metadata["ending"].startswith("unfinished")
    until(lambda: "its guardian sent the brake" in host.said)
    with board.bench() as bench:  # the guardian has given the line back
        assert len(bench.drive(0.0, 1.0)) > 0


def is_driven(board: PtyBoard) -> bool:
    return any(command.compare for command in list(board.commands))


def in_step(what: str) -> str:
    """A host whose program does that once it has driven."""
    return (
        "import ctypes, os, time\nfrom fiohost.bench.program import OpenLoop\nstep = OpenLoop.step\n"
        f"def late(self, k, angle):\n    if k >= 1:\n        {what}\n    return step(self, k, angle)\n"
        f"OpenLoop.step = late\n{MAIN}"
    )


def test_a_controller_that_ends_the_process(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *RUN, code=in_step("os._exit(7)"))
    assert host.process.wait(LIMIT_S) == 7
    assert board.commands
    braked(board)


def test_a_controller_that_never_comes_back_is_ended(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *RUN, gap_s=GAP_S, code=in_step("while True: pass"))
    assert host.ended() == 1
    assert "a controller that takes too long" in host.said
    log = Log.read(host.log)
    assert log.metadata["ending"].startswith("stopped: HostError")


def test_a_controller_whose_first_step_never_comes_back_is_ended(board: PtyBoard, tmp_path: Path) -> None:
    code = in_step("while True: pass").replace("k >= 1", "k >= 0")
    host = Host(board, tmp_path, *RUN, gap_s=GAP_S, code=code)
    assert host.process.wait(LIMIT_S) == 1
    assert "a controller that takes too long" in host.said
    assert FORWARD not in [tuple(command) for command in board.commands]
    braked(board)


def test_a_controller_that_never_comes_back_from_c(board: PtyBoard, tmp_path: Path) -> None:
    """It holds the interpreter: no signal is heard, no thread runs. The guardian brakes, the rest is kill -9."""
    deadlock = "lock, one = ctypes.PyDLL(None).pthread_mutex_lock, bytes(64); lock(one); lock(one)"
    host = Host(board, tmp_path, *RUN, gap_s=GAP_S, code=in_step(deadlock))
    try:
        until(lambda: is_driven(board))
        braked(board)
        assert host.process.poll() is None
    finally:
        host.process.kill()
        host.process.wait(LIMIT_S)


def test_a_host_that_is_stopped_for_a_while(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *RUN, gap_s=GAP_S)
    until(lambda: is_driven(board))
    host.process.send_signal(signal.SIGSTOP)
    braked(board)
    host.process.send_signal(signal.SIGCONT)
    assert host.ended() == 1
    assert "this computer held fiohost up for " in host.said
    assert Log.read(host.log).metadata["ending"].startswith("stopped: HostError")


FROZEN = (
    "import time\nfrom fiohost.bench.writer import LogWriter\nwrite = LogWriter._write\n"
    "def frozen(self, data):\n    if self.rows > 60:\n        time.sleep(1e6)\n    write(self, data)\n"
    f"LogWriter._write = frozen\nimport fiohost.bench.writer as w; w.CLOSE_LIMIT_S = 0.5\n{MAIN}"
)


def test_a_disk_that_freezes_ends_the_run_and_the_loop_goes_on_until_then(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *RUN, code=FROZEN)
    assert host.ended() == 1
    assert "the disk has taken nothing" in host.said
    assert "does not answer" in host.said
    assert len([c for c in board.commands if c.compare]) > 300  # rows that waited, each with its command
    assert len(rows_of(host.log)) == 61


def test_sigterm_is_heard_while_the_disk_is_frozen(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *RUN, code=FROZEN.replace("import time", "import time, fiohost.bench.writer as w\n"
                "w.MAX_WAITING = 10**6", 1))  # fmt: skip
    host.drives(61)
    host.process.send_signal(signal.SIGTERM)
    assert host.ended() == 143


def test_a_reader_of_standard_error_who_stops_reading(board: PtyBoard, tmp_path: Path) -> None:
    """The traffic in hex fills the pipe many times over: a loop that it held up would send no more."""
    read, write = os.pipe()
    host = Host(board, tmp_path, "--debug", "manual", "--pwm", "40", "--log", "run.csv",
                stdout=subprocess.DEVNULL, stderr=write)  # fmt: skip
    os.close(write)

    def has_sent_enough() -> bool:
        assert host.process.poll() is None, os.read(read, 1 << 16)[-3000:]
        return len(board.commands) > 1500

    until(has_sent_enough)
    host.process.send_signal(signal.SIGTERM)
    until(lambda: "ending: stopped by SIGTERM" in host.log.read_text())
    assert board.ends_braked
    with os.fdopen(read, "rb") as reader:
        said = reader.read()
    assert host.process.wait(LIMIT_S) == 143
    assert len(said) > 100_000  # more than a pipe holds


def test_a_guardian_is_told_whether_the_motor_was_braked(board: PtyBoard, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where it was, it has nothing to brake, and nobody has died."""
    told = []
    close = Guardian.close
    monkeypatch.setattr(Guardian, "close", lambda self, braked=True: (told.append(braked), close(self, braked=braked)))
    with board.bench():
        pass
    assert told == [True]

    def fails(line: object) -> None:
        raise TransportError("no brake")

    monkeypatch.setattr("fiohost.bench.loop.brake", fails)
    with pytest.raises(TransportError, match="no brake"), board.bench():
        pass
    assert told == [True, False]


def test_a_guardian_that_was_ended_is_missed(board: PtyBoard) -> None:
    with board.bench() as bench:
        assert bench._guardian is not None
        pid = bench._guardian.pid

        class Killing(Hold):
            def step(self, k: int, angle_deg: float) -> Answer | None:
                if k >= 20:
                    os.kill(pid, signal.SIGKILL)
                return super().step(k, angle_deg)

        with pytest.raises(HostError, match="guardian of the motor does not answer"):
            bench.play(Killing(Command.drive(40.0), None))
    assert board.ends_braked


def test_a_guardian_that_was_stopped_is_missed_after_the_longest_gap(board: PtyBoard) -> None:
    """As long as it may be held up by what holds up its host."""
    with board.bench() as bench:
        guardian = bench._guardian
        assert guardian is not None
        until(lambda: guardian.answers(0.0) and guardian._own_beat > 0)
        os.kill(guardian.pid, signal.SIGSTOP)
        until(lambda: Path(f"/proc/{guardian.pid}/stat").read_text().rpartition(")")[2].split()[0] == "T")
        guardian.answers(100.0)  # what it said before it was stopped
        guardian._heard_s = 100.0
        assert guardian.answers(100.0 + bench.profile.guards.gap_s)
        assert not guardian.answers(100.1 + bench.profile.guards.gap_s)
        os.kill(guardian.pid, signal.SIGCONT)


def test_a_guardian_brakes_a_node_and_with_numbers_of_its_own(tmp_path: Path) -> None:
    """A hidraw node is opened anew, each report behind its prefix; numbered commands are spread over all numbers."""
    from fiohost.transport.base import Transport, Way

    node = tmp_path / "node"
    node.touch()

    class Hidraw(Transport):
        way = Way(path=str(node), prefix=b"\0")  # type: ignore[assignment]
        open = send = receive = close = None  # type: ignore[assignment]

    Hidraw.__abstractmethods__ = frozenset()  # type: ignore[attr-defined]
    profile = patient("hid-framed")
    guardian = Guardian.of(Hidraw(), profile)
    assert guardian is not None
    with guardian.on_duty():
        pass
    guardian.close(braked=False)
    sent = node.read_bytes()
    size = 1 + profile.codec.command_layout.length
    frames = [sent[i : i + size] for i in range(0, len(sent), size)]
    assert {frame[:1] for frame in frames} == {b"\0"}
    fields = [profile.codec.command_layout.decode(frame[1:]) for frame in frames]
    assert {(f["duty_pct"], f["c3"], f["c4"]) for f in fields} == {(0.0, 1, 1)}
    assert len({f["sequence"] for f in fields}) > 8
