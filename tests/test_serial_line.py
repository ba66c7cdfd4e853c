"""A real serial line (a pty): what the host does with what a line can do to it, and that every way out brakes."""

from __future__ import annotations

import errno
import os
import re
import signal
import termios
import threading
import tty
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from boards import HANG_S, until
from click.testing import CliRunner
from lines import BRAKE, PtyBoard, patient

from fiohost.bench import connect
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench, Tick
from fiohost.bench.stop import Stopped
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, DisconnectedError, HostError, TelemetryTimeoutError, TransportError
from fiohost.transport import serial as serial_line
from fiohost.transport.serial import SerialTransport


def test_a_run_over_a_pty_begins_and_ends_braked_and_is_logged(tmp_path: Path) -> None:
    with PtyBoard() as board:
        with board.bench() as bench:
            log = bench.drive(40.0, 2.0, tmp_path / "run.csv")
        assert board.ends_braked
        assert tuple(board.commands[0]) == BRAKE
        assert (1440, 1, 0) in board.commands
    assert 5 < len(log) <= 401  # a host that is late leaves out rows
    assert log.time_s[-1] <= 2.0
    assert np.ptp(log.output) > 50.0
    assert log.metadata["serial_number"] == board.target
    assert log.dropped == () or "missing" in log.dropped[0]


def test_commands_do_not_heap_up_before_a_target_that_takes_one_a_step() -> None:
    """Five brakes sent at once would stay under way for ever: each later command would act five steps late."""
    lags = [99]
    with PtyBoard() as board, board.bench() as bench:
        while min(lags) > 2 and len(lags) < 50:  # a computer that is late makes a run's lag longer
            log = bench.drive(40.0, 0.6)
            lags.append(int(np.argmax(np.diff(log.output) > 0)))
    assert min(lags) <= 2, lags


def test_garbage_and_halves_of_packets_cost_no_more_than_themselves() -> None:
    halves: list[bytes] = []

    def mangle(k: int, packet: bytes) -> bytes:
        match k % 10:
            case 3:
                return b"\x7e\x7e\x00\xff\x7e" + packet
            case 5:
                halves.append(packet[4:])
                return packet[:4]
            case 6:
                return halves.pop() + packet
        return packet

    with PtyBoard(mangle=mangle) as board, board.bench() as bench:
        log = bench.drive(40.0, 2.0)
        garbage = bench.statistics.link.garbage_bytes
    assert garbage > 0
    steps = np.diff(log.output)
    assert set(np.unique(steps[5:] % 2.5)) == {0.0}  # no count that the board did not send
    assert log.metadata["ending"] == "complete"


@pytest.mark.parametrize("as_file", [True, False])
def test_a_port_gives_all_that_came_and_says_when_it_takes_nothing_or_hangs_up(
    as_file: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through its descriptor, and through pyserial's own calls where a port is no file."""
    monkeypatch.setattr(serial_line, "AS_FILE", as_file)
    board, host = os.openpty()
    tty.setraw(host)
    with SerialTransport(os.ttyname(host)) as port:
        for size in (1, 700, 4095):
            os.write(board, bytes(size))
            came = port.receive(30.0)
            while len(came) < size:  # the kernel carries a pty's bytes over in pieces, when it comes to it
                came += port.receive(30.0)
            assert came == bytes(size)
        with pytest.raises(TelemetryTimeoutError, match="nothing came"):
            port.receive(0.01)
        port.send(b"\x7e\x7e")
        assert os.read(board, 100) == b"\x7e\x7e"
        with pytest.raises(TransportError, match="takes no bytes"):  # the pty holds some 20 kB
            port.send(bytes(1_000_000))
        os.close(host)
        os.close(board)
        with pytest.raises(DisconnectedError, match="unplugged"):
            port.receive(1.0)
        with pytest.raises(DisconnectedError, match="unplugged"):
            port.send(b"\x7e\x7e")


def test_a_hang_up_in_mid_packet_is_a_board_that_went_away(tmp_path: Path) -> None:
    def mangle(k: int, packet: bytes) -> bytes:
        if k == 60:
            board.line.send(packet[:3])
            board.hang_up()
        return packet

    board = PtyBoard(once_driven=mangle)
    with pytest.raises(DisconnectedError, match="unplugged or reset") as caught, board, board.bench() as bench:
        bench.drive(40.0, 30.0, tmp_path / "run.csv")
    assert any("MOTOR MAY BE RUNNING" in note for note in caught.value.__notes__)
    assert not any("not back" in note for note in caught.value.__notes__)  # nobody has asked to wait for it
    log = Log.read(tmp_path / "run.csv")
    assert len(log) > 0
    assert log.dropped == () or "missing" in log.dropped[0]


def test_fifty_ms_of_silence_brake() -> None:
    def mangle(k: int, packet: bytes) -> bytes:
        return packet if k < 60 else b""

    with PtyBoard(once_driven=mangle) as board:
        with pytest.raises(TelemetryTimeoutError), board.bench(silence_s=0.05) as bench:
            bench.drive(40.0, 30.0)
        assert board.ends_braked


def test_a_line_of_garbage_alone_is_as_good_as_silence() -> None:
    with PtyBoard(once_driven=lambda k, packet: packet if k < 60 else b"\x7e\x7e\x00\x01\x02") as board:
        with pytest.raises((TelemetryTimeoutError, TransportError)), board.bench(silence_s=0.05) as bench:
            bench.drive(40.0, 30.0)
        assert board.ends_braked


def test_a_board_that_says_nothing_is_refused_before_anything_is_driven() -> None:
    with PtyBoard(mangle=lambda k, packet: b"") as board:
        with pytest.raises(TelemetryTimeoutError, match="sends nothing"):
            board.bench(silence_s=0.05)
        SerialTransport(board.target).open()  # the port is free again
        assert all(tuple(command) == BRAKE for command in board.commands)


@pytest.mark.parametrize(
    ("step_s", "repeats", "said"),
    [
        (0.02, 1, r"every (19|20|21)\b"),
        (0.005, 2, r"every 2\.[456]"),
        (0.01, 1, r"every (9\.[5-9]|10)"),
    ],
)
def test_a_board_of_another_rate_is_refused_with_its_rate(step_s: float, repeats: int, said: str) -> None:
    """Or, where this computer was too late too often to tell, a run that says so at its end."""
    profile = patient("serial-documented", late_pct=1.0)
    with PtyBoard(step_s=step_s, repeats=repeats) as board:
        with (
            pytest.raises((TransportError, HostError)) as caught,
            Bench(SerialTransport(board.target), profile, clock=board.clock()) as bench,
        ):
            bench.drive(40.0, 10.0)
        if isinstance(caught.value, HostError):
            assert "because this computer was busy" in str(caught.value)
            return
        assert re.search(said, str(caught.value))
        assert all(tuple(command) == BRAKE for command in board.commands)


def test_a_slow_board_runs_with_a_profile_that_says_so() -> None:
    profile = replace(patient("serial-documented"), sample_time_s=0.02)
    with PtyBoard(step_s=0.02) as board, Bench(SerialTransport(board.target), profile, clock=board.clock()) as bench:
        log = bench.drive(40.0, 1.6)
    assert log.sample_time_s == pytest.approx(0.02)


def test_a_port_belongs_to_one_host_and_is_free_again_afterwards() -> None:
    with PtyBoard() as board:
        with board.bench(), pytest.raises(TransportError, match="in use by another program"):
            SerialTransport(board.target).open()
        with board.bench() as bench:
            assert len(bench.drive(0.0, 1.0)) > 0


def test_what_waited_in_the_port_before_it_was_opened_is_not_read() -> None:
    """The board goes on counting while nobody listens; the first reading is not of that time."""

    def mangle(k: int, packet: bytes) -> bytes:
        return packet[:3] + int(k % 720).to_bytes(2, "little") + packet[5:]

    with PtyBoard(mangle=mangle) as board:
        until(lambda: board.steps >= 60)
        before = board.steps
        with SerialTransport(board.target) as port:
            data = port.receive(30.0)
            while len(data) < 14:
                data += port.receive(30.0)
    begins = data.index(b"\x7e\x7e")
    assert int.from_bytes(data[begins + 3 : begins + 5], "little") >= before - 1


@pytest.mark.parametrize(("name", "code"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGHUP", 129)])
def test_signals_brake_on_a_real_line(name: str, code: int) -> None:
    def knock(tick: Tick) -> None:
        if tick.time_s >= 0.1:
            os.kill(os.getpid(), getattr(signal, name))

    with PtyBoard() as board:
        with pytest.raises(Stopped) as caught, board.bench() as bench:
            bench.drive(40.0, progress=knock, progress_every_s=0.05)
        assert caught.value.exit_code == code
        assert board.ends_braked


def test_an_exception_in_a_controller_brakes_on_a_real_line() -> None:
    class Failing:
        def step(self, k: int, angle_deg: float) -> None:
            raise ZeroDivisionError

    before = set(threading.enumerate())
    with PtyBoard() as board:
        with pytest.raises(ZeroDivisionError), board.bench() as bench:
            bench.play(Failing(), progress=lambda tick: None)  # type: ignore[arg-type]
        assert board.ends_braked
    until(lambda: set(threading.enumerate()) <= before)  # nobody is left waiting for ticks


# ---- plugged in again ----------------------------------------------------------------------------------------------


def test_a_board_that_comes_back_is_braked_first_of_all(tmp_path: Path) -> None:
    link = str(tmp_path / "board")
    boards = [PtyBoard(link)]

    def replug(tick: Tick) -> None:
        if len(boards) == 1 and tick.time_s >= 0.1:
            boards[0].unplug()
            threading.Timer(0.3, lambda: boards.append(PtyBoard(link))).start()

    with pytest.raises(DisconnectedError) as caught, boards[0].bench(reconnect_s=HANG_S) as bench:
        bench.drive(40.0, 30.0, progress=replug, progress_every_s=0.05)
    assert any("was braked first of all" in note for note in caught.value.__notes__)
    boards[1].takes_all()
    boards[1].unplug()
    assert boards[1].commands
    assert {tuple(command) for command in boards[1].commands} == {BRAKE}


def test_the_command_line_waits_for_a_board_and_says_what_came_of_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = str(tmp_path / "board")
    boards: list[PtyBoard] = []

    def mangle(k: int, packet: bytes) -> bytes:
        if k == 60:
            boards[0].hang_up()
            threading.Timer(0.2, lambda: boards.append(PtyBoard(link))).start()
        return packet

    boards.append(PtyBoard(link, once_driven=mangle))
    monkeypatch.setattr(connect, "MonotonicClock", boards[0].clock)
    arguments = ["manual", "--pwm", "40", "--target", f"serial:{link}", "--reconnect", f"{HANG_S:g}", "--json", "-"]
    arguments += ["--guard", "gap_s=20", "--guard", "late_pct=100", "--guard", "silence_s=10"]
    answer = CliRunner().invoke(cli, arguments)
    for board in boards:
        board.unplug()
    assert answer.exit_code == 1
    assert "unplugged or reset" in answer.stderr
    assert "was braked first of all" in answer.stderr
    assert "no watchdog" in caplog.text  # on standard error where nobody collects what is logged
    assert "MOTOR MAY BE RUNNING; waiting" in caplog.text
    assert {tuple(command) for command in boards[1].commands} == {BRAKE}


def test_waiting_for_a_board_ends(tmp_path: Path) -> None:
    board = PtyBoard(str(tmp_path / "board"))
    with pytest.raises(DisconnectedError) as caught, board.bench(reconnect_s=0.2) as bench:
        bench.drive(40.0, 30.0, progress=lambda tick: board.unplug(), progress_every_s=0.05)
    assert any("MOTOR MAY BE RUNNING" in note and "not back" in note for note in caught.value.__notes__)


class Port:
    """A USB serial port as pyserial describes it."""

    def __init__(self, device: str, serial: str | None = "S1", location: str = "1-2") -> None:
        self.device, self.vid, self.pid = device, 0x0483, 0x5740
        self.serial_number, self.location = serial, location


def test_a_usb_port_is_found_again_by_its_identity(monkeypatch: pytest.MonkeyPatch) -> None:
    with PtyBoard() as first, PtyBoard() as second:
        ports = [Port(first.target), Port("/dev/other", "S2")]
        monkeypatch.setattr(serial_line, "_ports", lambda: ports)
        line = SerialTransport("0483:5740:S1")
        with line:
            assert line.identity == "0483:5740:S1"
            ports[:] = [Port("/dev/other", "S2")]
            with pytest.raises(DisconnectedError, match="not back"):
                line.reopen()
            ports[:] = [Port("/dev/other", "S2"), Port(second.target)]
            line.reopen()
            line.send(bytes.fromhex("7e7e 00000000 01 01 0303"))
            line.receive(30.0)
            until(lambda: second.braked)
        assert not first.commands


def test_several_ports_must_be_told_apart(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = [Port("/dev/ttyACM0"), Port("/dev/ttyACM1", "S2")]
    monkeypatch.setattr(serial_line, "_ports", lambda: ports)
    with pytest.raises(ConfigError, match=r"2 serial ports fit.*ttyACM0, /dev/ttyACM1"):
        SerialTransport("").open()
    with pytest.raises(ConfigError, match="no USB serial port 1234:5678"):
        SerialTransport("1234:5678").open()


# ---- opening -------------------------------------------------------------------------------------------------------


def test_a_port_that_is_not_there_or_none_is_said_so(tmp_path: Path) -> None:
    with pytest.raises(TransportError, match="there is no serial port /dev/ttyNOPE"):
        SerialTransport("/dev/ttyNOPE").open()
    (tmp_path / "file").write_text("x")
    with pytest.raises(TransportError, match="cannot be opened as a serial port"):
        SerialTransport(str(tmp_path / "file")).open()
    forbidden = serial_line._why("/dev/ttyACM0", OSError(errno.EACCES, "Permission denied"))
    assert "no permission" in forbidden
    assert "fiohost udev" in forbidden


def test_dtr_and_rts_are_left_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl

    asked = []

    def ioctl(fd: int, request: int, *more: object) -> object:
        asked.append(request)
        return real(fd, request, *more)  # type: ignore[arg-type]

    real = fcntl.ioctl
    monkeypatch.setattr(fcntl, "ioctl", ioctl)
    with PtyBoard() as board, SerialTransport(board.target) as port:
        port.receive(30.0)
    assert asked
    assert not {termios.TIOCMBIS, termios.TIOCMBIC, termios.TIOCMSET} & set(asked)
