"""``fiohost manual`` in a terminal: what the keys do, and that terminal and motor are left as they should be."""

from __future__ import annotations

import os
import signal
import sys
import termios
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from boards import HANG_S, WatchedTransport, bench_on, rows_of
from places import PACKAGES
from test_cli_drive import FIOHOST

from fiohost.bench.log import Log
from fiohost.panel.keys import Decoder, Keyboard, KeyProgram
from fiohost.wire.messages import Command

LIMIT_S = HANG_S
BRAKE = "00 00 00 00 01 01"
BRAKED, STANDBY = (0.0, 1, 1), (0.0, 0, 0)
UP, DOWN, PAGE_UP, SHIFT_DOWN = "\x1b[A", "\x1bOB", "\x1b[5~", "\x1b[1;2B"


@pytest.fixture(autouse=True)
def _own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(PACKAGES))


class Terminal:
    """``fiohost manual`` on a pseudo terminal; its standard error goes to a file, with the traffic in it."""

    def __init__(self, *arguments: str) -> None:
        import pty

        self.pid, self.fd = pty.fork()
        if self.pid == 0:
            os.dup2(os.open("errors.txt", os.O_WRONLY | os.O_CREAT), 2)
            os.execv(sys.executable, [*FIOHOST, "--debug", "manual", "--log", "run.csv", *arguments])
        self.settings = termios.tcgetattr(self.fd)
        self.shown = ""

    def read(self) -> None:
        """Take what is shown; a terminal that nobody reads would fill up."""
        with suppress(OSError):  # nothing there, or hung up
            os.set_blocking(self.fd, False)
            self.shown += os.read(self.fd, 100_000).decode(errors="ignore")

    def press(self, key: str, then: tuple[float, int, int]) -> None:
        """Press a key and wait until the log's last row has this duty, C3 and C4."""
        os.write(self.fd, key.encode())
        self.wait_for(then)

    def wait_for(self, state: tuple[float, int, int]) -> None:
        deadline = time.monotonic() + LIMIT_S
        while last_state() != state:
            assert time.monotonic() < deadline, (state, last_state(), self.shown[-500:], Path("errors.txt").read_text())
            self.read()
            time.sleep(0.01)

    def shows(self, text: str) -> None:
        """Wait until the live line has shown it."""
        deadline = time.monotonic() + LIMIT_S
        while text not in self.shown:
            assert time.monotonic() < deadline, (text, self.shown[-500:])
            self.read()
            time.sleep(0.01)

    def ended(self) -> int:
        deadline = time.monotonic() + LIMIT_S
        while True:
            done, status = os.waitpid(self.pid, os.WNOHANG)
            if done:
                return os.waitstatus_to_exitcode(status)
            assert time.monotonic() < deadline, "it does not end"
            self.read()
            time.sleep(0.01)


def last_state() -> tuple[float, int, int] | None:
    path = Path("run.csv")
    rows = [row for row in rows_of(path) if row.count(",") == 8] if path.exists() else []
    if len(rows) < 2:
        return None
    fields = rows[-2].split(",")  # the last may still be half written
    return float(fields[1]), int(fields[2]), int(fields[3])


def last_sent() -> str:
    lines = Path("errors.txt").read_text().splitlines()
    return [line.partition("64: ")[2] for line in lines if line.startswith("fiohost.traffic: out")][-1]


def test_keys_change_the_duty_brake_coast_reverse_and_quit() -> None:
    terminal = Terminal()  # no --pwm: it begins braked
    terminal.wait_for(BRAKED)
    terminal.press(UP, (1.0, 1, 0))
    terminal.press(DOWN, BRAKED)
    terminal.press(DOWN, (-1.0, 0, 1))
    terminal.press(PAGE_UP, (9.0, 1, 0))
    terminal.press(SHIFT_DOWN, (-1.0, 0, 1))
    terminal.press(PAGE_UP * 14, (100.0, 1, 0))  # no further
    terminal.press("r", (-100.0, 0, 1))
    terminal.press(" ", BRAKED)
    terminal.press(PAGE_UP * 3, (30.0, 1, 0))
    terminal.shows(" 30.0%   1  0  drive")
    terminal.press("s", STANDBY)
    terminal.shows("  0.0%   0  0  standby")
    terminal.press(PAGE_UP, (10.0, 1, 0))
    os.write(terminal.fd, b"\x1a\x1c\x13x\x1b[15~")  # Ctrl-Z, Ctrl-\, Ctrl-S, and keys without a meaning
    terminal.press(UP, (11.0, 1, 0))
    os.write(terminal.fd, b"q")
    assert terminal.ended() == 0
    assert termios.tcgetattr(terminal.fd) == terminal.settings
    assert last_sent() == BRAKE
    assert Log.read("run.csv").metadata["ending"] == "complete"
    for word in ("POS", "deg/s", "space brake"):
        assert word in terminal.shown


@pytest.mark.parametrize(("how", "code"), [("Ctrl-C", 130), ("SIGTERM", 143), ("hang up", None)])
def test_terminal_and_motor_are_left_in_order_however_it_ends(how: str, code: int | None) -> None:
    terminal = Terminal("--pwm", "40")
    terminal.wait_for((40.0, 1, 0))
    if how == "Ctrl-C":
        os.write(terminal.fd, b"\x03")
    elif how == "SIGTERM":
        os.kill(terminal.pid, signal.SIGTERM)
    else:
        os.close(terminal.fd)
    ended = terminal.ended()
    if code is not None:
        assert ended == code
        assert termios.tcgetattr(terminal.fd) == terminal.settings
    assert ended in (1, 129, 130, 143)
    assert last_sent() == BRAKE
    log = Log.read("run.csv")
    assert log.dropped == ()
    assert log.metadata["ending"].startswith("stopped")


def test_a_duration_ends_it_too() -> None:
    class Untouched(Keyboard):
        def __init__(self) -> None:
            pass

        def read(self) -> list[str]:
            return []

    transport = WatchedTransport()
    with bench_on(transport) as bench:
        bench.live(KeyProgram(Untouched(), Command.drive(-20.0), 100.0, 100), "run.csv")
    log = Log.read("run.csv")
    assert (len(log), set(log.duty_pct)) == (100, {-20.0})
    assert transport.braked


def test_the_terminal_is_put_back_after_an_exception(monkeypatch: pytest.MonkeyPatch) -> None:
    import pty

    main, terminal = pty.openpty()
    monkeypatch.setattr(sys, "stdin", os.fdopen(terminal))
    before = termios.tcgetattr(terminal)

    def fail() -> None:
        with Keyboard() as keyboard:
            during: list[Any] = termios.tcgetattr(terminal)
            assert not during[3] & (termios.ICANON | termios.ECHO)
            assert during[3] & termios.ISIG  # Ctrl-C is a signal still
            os.write(main, b"a")
            assert keyboard.read() == ["a"]
            assert keyboard.read() == []
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        fail()
    assert termios.tcgetattr(terminal) == before
    os.close(main)


@pytest.mark.parametrize(
    ("pieces", "keys"),
    [
        (["\x1b[A\x1b[B"], ["up", "down"]),
        (["\x1b", "[", "5", "~q"], ["page up", "q"]),
        (["\x1b[1;2A", "\x1b[1;5C", "\x1b[15~", "\x1bOP", "s"], ["page up", "s"]),
        (["\x1b[38;5;1q", " "], [" "]),  # an unknown sequence that ends like a key is none
        (["\x1b", "r", "\x1b\x1b[A"], ["r", "up"]),
    ],
)
def test_sequences_in_pieces_and_unknown_ones(pieces: list[str], keys: list[str]) -> None:
    decoder = Decoder()
    assert [key for piece in pieces for key in decoder.keys(piece)] == keys
