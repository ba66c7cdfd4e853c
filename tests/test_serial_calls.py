"""The line to pyserial and to a port's descriptor, call by call; and what every medium has."""

from __future__ import annotations

import errno
import os
from types import SimpleNamespace
from typing import Any

import pytest

from fiohost.errors import ConfigError, DisconnectedError, TransportError
from fiohost.transport import serial
from fiohost.transport.base import Transport, Way
from fiohost.transport.serial import SerialTransport

# ---- serial --------------------------------------------------------------------------------------------------------


def port_info(device: str, **changes: Any) -> Any:
    plain = {"device": device, "vid": 0x0483, "pid": 0x5740, "serial_number": "S", "location": "1-2"}
    return SimpleNamespace(**{**plain, **changes})


class Ports:
    """The ports of this computer and the class that opens them, in the place of pyserial."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, *infos: Any) -> None:
        self.infos = list(infos)
        self.opened: list[tuple[str, int, dict[str, Any]]] = []
        self.closed: list[str] = []
        self.fails: Exception | None = None
        monkeypatch.setattr(serial, "_ports", lambda: list(self.infos))
        monkeypatch.setattr(serial, "_serial_class", lambda: self.make)
        self.kept: list[Any] = []
        monkeypatch.setattr(serial, "_keep_others_out", self.kept.append)

    def make(self, path: str, baud: int, **options: Any) -> Any:
        if self.fails is not None:
            raise self.fails
        self.opened.append((path, baud, options))
        read, _ = os.pipe()
        quick: list[bool] = []
        return SimpleNamespace(
            fileno=lambda: read, close=lambda: self.closed.append(path), set_low_latency_mode=quick.append, quick=quick
        )


def test_a_port_is_taken_for_this_host_alone_with_its_speed_and_without_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = Ports(monkeypatch, port_info("/dev/ttyACM0"), port_info("/dev/ttyS0", vid=None, serial_number=None))
    made = SerialTransport("/dev/ttyACM0", 9600)
    assert (made.way, made.can_reopen, made.stream) == (None, True, True)
    made.open()
    wanted = {"timeout": 0, "write_timeout": 0.05, "exclusive": True}
    assert ports.opened == [("/dev/ttyACM0", 9600, wanted)]
    assert (made.identity, made.is_known_again) == ("0483:5740:S", True)
    assert made._port.quick == [True]
    assert ports.kept == [made._port]
    assert made.way == Way(fd=made._fd)
    made.close()
    made.close()
    assert ports.closed == ["/dev/ttyACM0"]
    assert made.way is None
    for call in (lambda: made.receive(0.0), lambda: made.send(b"")):
        with pytest.raises(DisconnectedError, match="serial:/dev/ttyACM0 is not open"):
            call()
    plain = SerialTransport("/dev/ttyS0")
    plain.open()
    assert (ports.opened[1][1], plain.identity, plain.is_known_again, plain._key) == (
        115_200,
        "/dev/ttyS0",
        False,
        None,
    )
    unlisted = SerialTransport("/dev/pts/7")
    unlisted.open()
    assert (unlisted.identity, unlisted.is_known_again) == ("/dev/pts/7", False)
    monkeypatch.setattr(serial.os, "name", "nt")
    assert serial._can_lock() is None


def test_a_board_comes_back_under_another_name_by_its_number_or_its_place(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = Ports(monkeypatch, port_info("/dev/ttyACM0", serial_number=None))
    made = SerialTransport("")
    assert made.name == "serial"
    made.open()
    assert made.identity == "0483:5740:at 1-2"
    ports.infos[:] = [port_info("/dev/ttyACM1", serial_number=None, location="1-3")]
    with pytest.raises(DisconnectedError, match="the board 0483:5740:at 1-2 is not back"):
        made.reopen()
    ports.infos.append(port_info("/dev/ttyACM2", serial_number=None))
    made.reopen()
    assert ports.opened[-1][0] == "/dev/ttyACM2"
    pty = SerialTransport("/dev/pts/7")
    pty.open()
    pty.reopen()
    assert [path for path, _, _ in ports.opened[-2:]] == ["/dev/pts/7"] * 2


@pytest.mark.parametrize(
    ("asked", "found"),
    [
        ("", None), ("0483:5740", None), ("0483:5740:a", "/dev/ttyACM0"), ("0483:5740:B", "/dev/ttyACM1"),
        ("/dev/ttyS7", "/dev/ttyS7"), ("COM3", "COM3"), ("/dev/serial/by-path/1:2", "/dev/serial/by-path/1:2"),
    ],
)  # fmt: skip
def test_a_port_is_meant_by_path_or_identity(asked: str, found: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
    Ports(monkeypatch, port_info("/dev/ttyACM0", serial_number="A"), port_info("/dev/ttyACM1", serial_number="b"))
    if found is not None:
        assert serial._find(asked) == found
        return
    with pytest.raises(
        ConfigError, match=f"2 serial ports fit{' ' + asked if asked else ''}: say which, serial:PORT; /"
    ):
        serial._find(asked)


def test_no_port_is_said_with_those_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = port_info("/dev/ttyS0", vid=None, pid=None)
    ports = Ports(monkeypatch, plain, port_info("/dev/ttyACM0", serial_number="A"))
    assert serial._find("") == "/dev/ttyACM0"
    with pytest.raises(ConfigError, match="no USB serial port 1209:0001 is connected; ports: /dev/ttyACM0"):
        serial._find("1209:0001")
    ports.infos.clear()
    with pytest.raises(ConfigError, match="no USB serial port is connected; ports: none"):
        serial._find("")


@pytest.mark.parametrize(
    ("failure", "said"),
    [
        (OSError(errno.ENOENT, "x"), "there is no serial port /dev/ttyACM9; did you mean '/dev/ttyACM0'"),
        (OSError("could not open: FileNotFoundError(2)"), "there is no serial port /dev/ttyACM9"),
        (OSError(errno.EACCES, "x"), "no permission for /dev/ttyACM9: install the udev rules"),
        (OSError(errno.EBUSY, "x"), "/dev/ttyACM9 is in use by another program"),
        (OSError(errno.EAGAIN, "x"), "/dev/ttyACM9 is in use by another program"),
        (OSError("could not open: PermissionError(13)"), "/dev/ttyACM9 is in use by another program"),
        (ValueError("odd  baud\n" + "x" * 300), "cannot be opened as a serial port: odd baud x{151}$"),
    ],
)
def test_why_a_port_does_not_open(failure: Exception, said: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ports = Ports(monkeypatch, port_info("/dev/ttyACM0"))
    ports.fails = failure
    with pytest.raises(TransportError, match=said):
        SerialTransport("/dev/ttyACM9").open()
    ports.infos.clear()
    ports.fails = OSError(errno.ENOENT, "x")
    with pytest.raises(TransportError, match="there is no serial port /dev/ttyACM9; no serial port is connected"):
        SerialTransport("/dev/ttyACM9").open()


def test_a_ports_descriptor_may_be_the_smallest_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    ports = Ports(monkeypatch)
    done: list[object] = []
    make = ports.make
    monkeypatch.setattr(
        ports, "make", lambda *asked, **options: [p := make(*asked, **options), setattr(p, "fileno", lambda: 0)][0]
    )
    monkeypatch.setattr(serial, "_serial_class", lambda: ports.make)
    monkeypatch.setattr(serial, "_write", lambda fd, report: done.append((fd, report)))
    monkeypatch.setattr(serial, "_read", lambda fd, timeout_s: bytes([fd]))
    made = SerialTransport("/dev/pts/7")
    made.open()
    made.send(b"abc")
    assert (made.receive(0.0), done, made.way) == (b"\0", [(0, b"abc")], Way(fd=0))


def test_a_port_is_closed_to_programs_that_ask_for_no_lock_unless_it_is_a_pty(monkeypatch: pytest.MonkeyPatch) -> None:
    import fcntl
    import termios

    asked: list[object] = []
    monkeypatch.setattr(fcntl, "ioctl", lambda fd, what: asked.append((fd, what)))
    port = SimpleNamespace(fileno=lambda: 7)
    for name, count in (("/dev/pts/3", 0), ("/dev/ttyACM0", 1)):
        monkeypatch.setattr(serial.os, "ttyname", lambda fd, name=name: name)
        serial._keep_others_out(port)
        assert asked == [(7, termios.TIOCEXCL)] * count


def test_what_the_system_takes_a_piece_of_is_written_on_and_given_up_after_fifty_ms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s, waits, taken = [10.0], list[float](), list[bytes]()
    takes: list[int | None] = [2, None, 3, None, 1]

    def write(fd: int, report: bytes) -> int:
        size = takes.pop(0) if takes else None
        if size is None:
            raise BlockingIOError
        taken.append(report[:size])
        return size

    def select(read: Any, wait_for: list[int], wrong: Any, wait_s: float) -> Any:
        assert wait_for == [7]
        waits.append(wait_s)
        now_s[0] += min(wait_s, 0.02)
        return [], [7] if wait_s > 0.0 else [], []

    monkeypatch.setattr(serial, "os", SimpleNamespace(write=write))
    monkeypatch.setattr(serial, "select", SimpleNamespace(select=select))
    monkeypatch.setattr(serial, "time", SimpleNamespace(monotonic=lambda: now_s[0]))
    serial._write(7, b"abcdef")
    assert b"".join(taken) == b"abcdef"
    assert waits == pytest.approx([0.05, 0.03])
    waits.clear()
    with pytest.raises(TimeoutError):
        serial._write(7, b"abcdef")
    assert waits == pytest.approx([0.05, 0.03, 0.01, 0.0], abs=1e-9)


def test_a_line_that_is_ready_and_gives_nothing_has_hung_up() -> None:
    read, write = os.pipe()
    assert serial._read(read, -1.0) == b""
    os.write(write, b"abc")
    assert serial._read(read, 0.0) == b"abc"
    os.close(write)
    with pytest.raises(OSError, match="ready, and nothing to read") as caught:
        serial._read(read, 0.0)
    assert caught.value.errno == errno.EIO
    os.close(read)


def test_through_pyserial_a_wait_is_set_in_steps_and_no_more_is_read_than_in_one_go(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(serial, "MOST_BYTES", 10)
    asked: list[int] = []

    def read(size: int) -> bytes:
        assert size > 0
        asked.append(size)
        return bytes(size)

    port = SimpleNamespace(timeout=None, in_waiting=6, read=read)
    assert len(serial._read_port(port, 0.025)) == 10
    assert asked == [1, 6, 3]
    assert port.timeout == pytest.approx(0.03)
    port.in_waiting = 0
    port.read = lambda size: b""
    assert serial._read_port(port, 0.025) == b""


# ---- what every medium has -----------------------------------------------------------------------------------------


def test_a_medium_that_says_nothing_of_itself_is_no_board_on_a_cable() -> None:
    done: list[str] = []

    class Plain(Transport):
        name = "plain"

        def open(self) -> None:
            done.append("open")

        def send(self, report: bytes) -> None: ...

        def receive(self, timeout_s: float) -> bytes:
            return b""

        def close(self) -> None:
            done.append("close")

    with Plain() as made:
        assert (made.lock_step, made.stream, made.can_reopen, made.is_known_again) == (False,) * 4
        assert (made.passed_over, made.counts_per_rev, made.way, made.identity) == (0, None, None, "")
        with pytest.raises(DisconnectedError, match="plain does not come back"):
            made.reopen()
    assert done == ["open", "close"]
    assert Way() == Way(fd=-1, path="", module="", prefix=b"")
