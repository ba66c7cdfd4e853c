"""Every way out of a run, by the command line on a serial line: the motor is braked, the log whole, the exit clean."""

from __future__ import annotations

import os
import pty
import resource
import signal
import subprocess
import sys
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import pytest
from boards import HANG_S, WatchedTransport, bench_on, rows_of, until
from lines import BRAKE, PtyBoard, patient
from places import PACKAGES

from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.errors import MotorRunningError
from fiohost.transport.serial import SerialTransport

FORWARD = (1440, 1, 0)  # 40 % as the board takes it
LIMIT_S = HANG_S
MAIN = "from fiohost.cli.main import main; main()"
DRIVE = ["manual", "--pwm", "40"]


class Host:
    """``fiohost`` in a process of its own, on a board; its standard error goes to a file."""

    def __init__(
        self, board: PtyBoard, folder: Path, *arguments: str, gap_s: float = 20.0, code: str = MAIN, **how: Any
    ) -> None:
        self.board, self.log, self.errors = board, folder / "run.csv", folder / "errors.txt"
        command = [
            sys.executable,
            "-c",
            code,
            *arguments,
            "--target",
            f"serial:{board.target}",
            "--guard",
            f"gap_s={gap_s}",
            "--guard",
            "silence_s=10",  # a busy machine holds up the board's thread too
            "--guard",
            "late_pct=100",
        ]
        with self.errors.open("w") as errors:
            self.process = subprocess.Popen(command, cwd=folder, **{"stderr": errors, "text": True, **how})
        board.hosts.append(self.process)

    def drives(self, rows: int = 50) -> None:
        """Wait until the motor has been driven for some rows of the log."""

        def has_driven() -> bool:
            assert self.process.poll() is None, self.said
            return self.log.exists() and len(rows_of(self.log)) >= rows

        until(has_driven)

    def ended(self) -> int:
        """Its exit code, once what must hold of every end has been seen: a brake, no traceback."""
        code = self.process.wait(LIMIT_S)
        self.board.takes_all()
        commands = [tuple(command) for command in self.board.commands]
        assert commands[0] == BRAKE
        assert FORWARD in commands
        after = commands[len(commands) - commands[::-1].index(FORWARD) :]
        assert len(after) > 1
        assert set(after) == {BRAKE}
        assert "Traceback" not in self.said
        assert "Exception ignored" not in self.said
        return code

    @property
    def said(self) -> str:
        return self.errors.read_text()


@pytest.fixture
def board() -> Iterator[PtyBoard]:
    with PtyBoard() as made:
        yield made


@pytest.fixture(autouse=True)
def _checkout(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


def whole(log: Path, ending: str, rows: int = 50) -> None:
    """All that was driven is in the log, nothing torn, and it says how it ended."""
    read = Log.read(log)
    assert len(read) >= rows
    assert not [note for note in read.dropped if "missing" not in note]  # a host that is late leaves out rows
    assert read.metadata["ending"].startswith(ending)


@pytest.mark.parametrize(
    ("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129), ("SIGQUIT", 131), ("SIGTSTP", 148)]
)
def test_a_signal(board: PtyBoard, tmp_path: Path, name: str, code: int) -> None:
    host = Host(board, tmp_path, *DRIVE, "--log", "run.csv", stdout=subprocess.DEVNULL)
    host.drives()
    host.process.send_signal(getattr(signal, name))
    assert host.ended() == code
    whole(host.log, "stopped by")
    assert "the board has no watchdog" in host.said  # said at its start


@pytest.mark.parametrize("command", [["manual", "--pwm", "40"], ["run", "step_40.toml"]])
def test_a_reader_who_leaves(board: PtyBoard, tmp_path: Path, command: list[str]) -> None:
    """As ``fiohost ... | head -1`` does."""
    (tmp_path / "step_40.toml").write_text(STEP_40)
    host = Host(board, tmp_path, *command, "--log", "run.csv", stdout=subprocess.PIPE)
    assert host.process.stdout is not None
    host.process.stdout.readline()
    host.drives()
    host.process.stdout.close()
    assert host.ended() == 1
    whole(host.log, "stopped: BrokenPipeError")
    assert "rows" in host.said  # where the log is


@pytest.mark.parametrize("is_its_own", [True, False])
def test_a_closed_terminal(board: PtyBoard, tmp_path: Path, is_its_own: bool) -> None:
    """One that is the process's own hangs up with a signal, any other only takes no more text."""
    terminal, end = pty.openpty()

    streams: dict[str, int | IO[str]] = {"stdin": end, "stdout": end}
    if is_its_own:
        streams["stderr"] = end  # what is said last goes nowhere, and that changes nothing
    host = Host(
        board,
        tmp_path,
        *DRIVE,
        "--log",
        "run.csv",
        preexec_fn=own_terminal(end) if is_its_own else os.setsid,
        **streams,
    )
    os.close(end)
    host.drives()
    os.close(terminal)
    code = host.ended()
    if is_its_own:
        assert code == 129
        whole(host.log, "stopped by SIGHUP")
    else:
        assert code == 1
        whole(host.log, "stopped: FiohostError")
        assert "the terminal has gone; the motor was braked" in host.said


STEP_40 = 'schema = "fiohost.experiment/1"\n[[command]]\nkind = "constant"\nlevel_pct = 40.0\nduration_s = 600.0\n'


def own_terminal(end: int) -> Any:
    """Makes a child the leader of a session on that terminal, as a shell's job in the foreground is."""

    def take() -> None:
        import fcntl

        os.setsid()
        fcntl.ioctl(end, termios.TIOCSCTTY, 0)

    return take


def limited(size: int) -> Any:
    """A disk that is full once a file has grown to *size* bytes."""
    return lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))


def test_a_full_disk_under_the_log(board: PtyBoard, tmp_path: Path) -> None:
    host = Host(board, tmp_path, *DRIVE, "--log", "run.csv", stdout=subprocess.DEVNULL, preexec_fn=limited(8000))
    assert host.ended() == 1
    whole(host.log, "stopped: LogError")
    assert "rows are safe in it" in host.said


def test_a_full_disk_under_what_is_said(board: PtyBoard, tmp_path: Path) -> None:
    with (tmp_path / "out.txt").open("w") as out:
        host = Host(board, tmp_path, *DRIVE, stdout=out, preexec_fn=limited(250))
        assert host.ended() == 1
    assert "what there is to say cannot be written: File too large" in host.said


def test_nobody_to_say_anything_to_from_the_start(board: PtyBoard, tmp_path: Path) -> None:
    """Standard output and error closed, as some services start their children: the run is the same."""
    shell = ["sh", "-c", 'exec "$@" <&- >&- 2>&-', "sh", sys.executable, "-c", MAIN]
    arguments = [
        *DRIVE,
        "--duration",
        "5",
        "--log",
        "run.csv",
        "--target",
        f"serial:{board.target}",
        *("--guard", "gap_s=20", "--guard", "silence_s=10", "--guard", "late_pct=100"),
    ]
    assert subprocess.run([*shell, *arguments], cwd=tmp_path, timeout=LIMIT_S, check=False).returncode == 0
    whole(tmp_path / "run.csv", "complete", rows=1)
    assert board.ends_braked


# ---- what reads or writes fails in a way that nobody foresaw -------------------------------------------------------


def test_reading_that_fails_for_good_on_the_simulated_board(tmp_path: Path) -> None:
    """The brake goes out all the same, more than once."""

    def fail(k: int, report: bytes) -> bytes:
        if k >= 60:
            raise RuntimeError("the reader died")
        return report

    transport = WatchedTransport(on_receive=fail)
    with pytest.raises(RuntimeError, match="the reader died") as caught, bench_on(transport) as bench:
        bench.drive(40.0, 5.0, tmp_path / "run.csv")
    driven = max(k for k, report in enumerate(transport.sent) if report[:4] == bytes.fromhex("00 00 20 42"))
    assert len(transport.sent) - driven > 5
    assert transport.braked
    assert not any("MAY BE RUNNING" in note for note in caught.value.__notes__)
    log = Log.read(tmp_path / "run.csv")
    assert (len(log) > 0, log.dropped) == (True, ())
    assert log.metadata["ending"] == "stopped: RuntimeError: the reader died"


class BrokenSerial(SerialTransport):
    """From a time on all reading fails, or also all writing."""

    fails = ""

    def receive(self, timeout_s: float) -> bytes:
        if self.fails:
            raise RuntimeError("the reader died")
        return super().receive(timeout_s)

    def send(self, report: bytes) -> None:
        if self.fails == "both":
            raise RuntimeError("the writer died")
        super().send(report)


@pytest.mark.parametrize("fails", ["reading", "both"])
def test_reading_and_writing_that_fail_for_good_on_a_serial_line(fails: str, board: PtyBoard, tmp_path: Path) -> None:
    line = BrokenSerial(board.target)

    def break_it(tick: object) -> None:
        line.fails = fails

    with pytest.raises(RuntimeError, match=r"the (reader|writer) died") as caught:  # noqa: SIM117 (the bench opens within)
        with Bench(line, patient("serial-documented"), clock=board.clock()) as bench:
            bench.drive(40.0, 5.0, tmp_path / "run.csv", progress=break_it, progress_every_s=0.3)
    assert board.ends_braked  # by the guardian, where the host cannot write
    assert any("MAY BE RUNNING" in note for note in caught.value.__notes__)  # who does not read does not know
    assert Log.read(tmp_path / "run.csv").metadata["ending"].startswith("stopped: RuntimeError: the ")


# ---- a board that does not obey ------------------------------------------------------------------------------------


def test_a_board_that_ignores_the_brake_is_said_to_run(board: PtyBoard, tmp_path: Path) -> None:
    """The brake was sent, and telemetry says that nobody heeded it."""
    host = Host(board, tmp_path, *DRIVE, "--duration", "5", "--log", "run.csv", stdout=subprocess.PIPE)
    host.drives(1)
    board.runs_away = True
    out, _ = host.process.communicate(timeout=LIMIT_S)
    assert host.process.returncode == 1
    assert "THE MOTOR MAY BE RUNNING" in host.said
    assert "the shaft still turns at " in host.said
    assert "braked" not in out
    assert board.braked  # it was told so
    assert Log.read(host.log).metadata["ending"].startswith("stopped: MotorRunningError")


def test_a_board_that_runs_already_is_not_driven(tmp_path: Path) -> None:
    with PtyBoard(runs_away=True) as board, board.bench() as bench:
        with pytest.raises(MotorRunningError, match="before the run"):
            bench.drive(40.0, 1.0)
        assert {tuple(command) for command in board.commands} == {BRAKE}
        board.runs_away = False


def test_a_braked_shaft_that_a_load_turns_slowly_is_no_running_motor(board: PtyBoard) -> None:
    profile = patient("serial-documented", braked_deg_s=600.0)
    with Bench(SerialTransport(board.target), profile, clock=board.clock()) as bench:
        board.runs_away = True
        assert len(bench.drive(0.0, 1.0)) > 0


def test_a_board_that_comes_back_and_ignores_the_brake_is_not_said_to_be_braked(tmp_path: Path) -> None:
    link = str(tmp_path / "board")
    with PtyBoard(link) as gone:
        host = Host(gone, tmp_path, *DRIVE, "--reconnect", f"{HANG_S:g}", "--log", "run.csv", stdout=subprocess.DEVNULL)
        host.drives()
        gone.unplug()
        with PtyBoard(link, runs_away=True):
            assert host.process.wait(LIMIT_S) == 1
    assert "was braked first of all" not in host.said
    assert "THE MOTOR MAY BE RUNNING; the board ignores commands" in host.said


# ---- plugged in again ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [[*DRIVE], ["run", "staircase"], ["panel", "--web", "--port", "0"]])
def test_a_board_that_comes_back_is_braked_first_of_all_by_every_command_that_drives(
    command: list[str], tmp_path: Path
) -> None:
    link = str(tmp_path / "board")
    with PtyBoard(link) as gone:
        command = [*command, "--reconnect", f"{HANG_S:g}", "--log", "run.csv"]
        host = Host(gone, tmp_path, *command, stdout=subprocess.DEVNULL)
        host.drives()
        gone.unplug()
        until(lambda: "waiting for the board to come back" in host.said)
        with PtyBoard(link) as back:
            code = host.process.wait(LIMIT_S)
            back.takes_all()
            assert {tuple(taken) for taken in back.commands} == {BRAKE}
    assert code == 1
    assert "THE MOTOR MAY BE RUNNING; waiting for the board to come back" in host.said
    assert "a board came back" in host.said
    assert "was braked first of all" in host.said
    assert "it has no serial number, so that another one in its place looks the same" in host.said
    whole(host.log, "stopped: DisconnectedError")
