"""The simulated board as a device of its own: served in real time, with or without a watchdog, on any line."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import pytest
from boards import HANG_S, rows_of
from lines import PATIENT
from places import PACKAGES, ROOT

from fiohost.bench.connect import connect
from fiohost.bench.log import Log
from firmware_model import FirmwareModelError, gadget
from firmware_model.__main__ import main
from firmware_model.lines.node import NodeLine, PtyLine
from firmware_model.serve import serve

WATCHDOG_S = 1.0


@contextmanager
def served(link: Path, *options: str) -> Iterator[subprocess.Popen[str]]:
    command = [sys.executable, "-m", "firmware_model", "--pty", str(link), *options]
    board = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=PACKAGES)
    assert board.stdout is not None
    try:
        assert "Ctrl-C ends" in board.stdout.readline()
        yield board
    finally:
        board.send_signal(signal.SIGTERM)
        board.communicate(timeout=HANG_S)


def counts_since(link: Path, seconds: float) -> list[int]:
    """Counts of each step since the last report that a host has read, and for some *seconds* from now."""
    node = os.open(link, os.O_RDONLY | os.O_NOCTTY | os.O_NONBLOCK)
    time.sleep(seconds)
    data = os.read(node, 1 << 16)
    os.close(node)
    first = data.index(b"\x7e\x7e")
    pos = [int.from_bytes(data[at + 3 : at + 5], "little") for at in range(first, len(data) - 6, 7)]
    return [(after - before + 360) % 720 - 360 for before, after in pairwise(pos)]


@pytest.mark.parametrize("watchdog", [False, True])
def test_a_dead_computer_leaves_the_motor_running_and_a_watchdog_brakes_it(watchdog: bool, tmp_path: Path) -> None:
    """Host and guardian end at once.

    The watchdog's time is long against any stall of a host on a busy machine: one of 0.1 s brakes before the host ends.
    Its exact step is shown where no clock of the computer counts, in test_board_options.
    """
    link, log, trace = tmp_path / "board", tmp_path / "run.csv", tmp_path / "trace"
    profile = tmp_path / "guarded.toml"
    profile.write_text(f"watchdog_s = {WATCHDOG_S}\n" + (ROOT / "configs/targets/serial-documented.toml").read_text())
    target = f"{profile if watchdog else 'serial'}:{link}"
    with served(link, *(["--watchdog", str(WATCHDOG_S)] if watchdog else [])) as board:
        arguments = [
            "manual",
            "--pwm",
            "40",
            "--log",
            str(log),
            "--trace",
            str(trace),
            "--target",
            target,
            *(word for key, value in PATIENT.items() for word in ("--guard", f"{key}={value}")),
        ]
        host = subprocess.Popen(
            [sys.executable, "-m", "fiohost", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            cwd=PACKAGES,
        )
        deadline = time.monotonic() + HANG_S
        while time.monotonic() < deadline and host.poll() is None and (not log.exists() or len(rows_of(log)) < 80):
            time.sleep(0.02)
        guardian = Path(f"/proc/{host.pid}/task/{host.pid}/children").read_text().split()[0]
        os.kill(int(guardian), signal.SIGKILL)
        host.kill()
        said = host.communicate()[1]
        counts = counts_since(link, 2.0 * WATCHDOG_S)
        assert ("no watchdog" in said) != watchdog
        driven = sum("20 42 01 00" in line for line in trace.read_text().splitlines())
        assert driven >= 80
        assert len(Log.read(log)) >= driven - 1  # every row but the last
        full = sum(counts[:18]) / 18
        assert full > 3.0  # the board holds the last command, until its watchdog's time is up or for ever
        assert (sum(counts[-20:]) == 0) == watchdog
        with connect(f"serial:{link}", guards=PATIENT) as bench:  # the next host brakes it first of all
            bench.settle()
        assert sum(counts_since(link, 0.1)) == 0
        assert board.poll() is None


def test_the_board_is_driven_as_in_this_process(tmp_path: Path) -> None:
    with served(tmp_path / "board") as board:
        with connect(f"serial:{tmp_path / 'board'}", guards=PATIENT) as bench:
            log = bench.drive(40.0, 1.5)
        with connect("sim") as bench:
            there = bench.drive(40.0, 1.5)
        board.send_signal(signal.SIGINT)
        said = board.communicate(timeout=HANG_S)[0]
    assert board.returncode == 0
    assert "steps" in said
    assert not (tmp_path / "board").exists()
    speed = (log.output[-1] - log.output[-101]) / (log.time_s[-1] - log.time_s[-101])
    there_speed = (there.output[-1] - there.output[-101]) / (there.time_s[-1] - there.time_s[-101])
    assert speed == pytest.approx(there_speed, rel=0.1)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--pty", "--plant", "nothing"], "no plant named 'nothing'"),
        (["--pty", "--layout", "assumed"], "has no header"),
        (["--pty", "--watchdog", "1000"], "outside 0.005 to 60"),
        (["--pty", "--step-ms", "nan"], "outside 0.1 to 1000"),
        (["--device", "/dev/ttyGS99"], "cannot open /dev/ttyGS99"),
        (["--pty", "/no/such/folder/link"], "cannot make the link"),
    ],
)
def test_what_cannot_be_served_is_said_in_a_sentence(
    arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 1
    assert said in capsys.readouterr().err


def test_deadlines_are_absolute_a_late_step_delays_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    now, steps = [7.0], []

    def passes(seconds: float) -> None:
        now[0] += seconds

    monkeypatch.setattr("firmware_model.serve.time", SimpleNamespace(monotonic=lambda: now[0], sleep=passes))
    line = PtyLine()

    def step(packet: bytes | None) -> bytes:
        steps.append(now[0] - 7.0)
        if len(steps) == 11:
            passes(0.1)
        return b""

    kept = serve(step, line, "documented", stop=lambda: len(steps) >= 60)
    line.close()
    late = 0.05 + 0.1  # step 10 was due at 50 ms and lasts 100 ms: those due within run at once, one after another
    assert steps == pytest.approx([0.005 * k if k <= 10 else max(late, 0.005 * k) for k in range(60)])
    assert (kept.steps, kept.late, kept.worst_s) == (60, 19, pytest.approx(0.095))


def test_a_node_of_reports_is_read_report_by_report_and_survives_an_unplug(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "hidg0")
    node = NodeLine(str(tmp_path / "hidg0"), stream=False)
    node.send(b"a" * 64)
    assert node.receive() == [b"a" * 64]
    os.close(node._fd)  # as the kernel does it: every call fails
    assert node.receive() == []
    node.send(b"b" * 64)
    assert node.receive() == [b"b" * 64] or node.receive() == []
    node.close()


def test_a_nodes_cable_that_is_out_is_noticed_and_the_node_given_back(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel says so by the end of a serial line, and by ESHUTDOWN where a HID report is written."""
    node_file = tmp_path / "node"
    node_file.write_bytes(b"a" * 64)
    node = NodeLine(str(node_file), stream=False)
    assert node.receive() == [b"a" * 64]
    assert node._fd < 0
    assert node.receive() == [b"a" * 64]  # taken again
    node = NodeLine(str(node_file), stream=False)

    def write(fd: int, data: bytes) -> int:
        raise OSError(errno.ESHUTDOWN, "shut down")

    monkeypatch.setattr("firmware_model.lines.node.os.write", write)
    node.send(b"b" * 64)
    assert node._fd < 0


def test_a_gadget_is_made_as_the_kernel_wants_it_and_taken_away(tmp_path: Path) -> None:
    configfs, controllers = tmp_path / "usb_gadget", tmp_path / "udc"
    configfs.mkdir()
    controllers.mkdir()
    with pytest.raises(FirmwareModelError, match="can be a device"):
        gadget.up(configfs, controllers)
    (controllers / "dummy_udc.0").mkdir()
    assert gadget.up(configfs, controllers) == "dummy_udc.0"
    made = configfs / "firmware_model"
    assert (made / "idProduct").read_text() == "0x5750\n"
    assert (made / "functions/hid.usb0/report_length").read_text() == "64\n"
    assert (made / "configs/c.1/hid.usb0").resolve() == made / "functions/hid.usb0"
    assert (made / "configs/c.1/acm.usb0").is_symlink()
    assert (made / "UDC").read_text() == "dummy_udc.0\n"
    gadget.unplug(configfs)
    assert (made / "UDC").read_text() == "\n"
    assert not gadget.is_plugged(configfs)
    assert gadget.plug(configfs, controllers) == "dummy_udc.0"
    assert gadget.is_plugged(configfs)
    gadget.down(configfs)
    assert not list((made / "configs/c.1").glob("*.usb0"))
    with pytest.raises(FirmwareModelError, match="File exists"):
        gadget.up(configfs, controllers)  # a folder with files stays, other than in configfs
