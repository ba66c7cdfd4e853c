"""USB HID through hidapi as it really behaves: what it does not say, the host finds out."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from lines import FakeHidapi, info, patient
from places import PACKAGES
from test_real_time import HandClock

from fiohost.bench.loop import Bench
from fiohost.bench.program import Answer
from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError, TransportError
from fiohost.transport import access, hid_modules
from fiohost.transport import lock as locks
from fiohost.transport.hid import HidTransport
from fiohost.transport.hid_modules import Backend, find_backends, working_backends
from fiohost.transport.lock import DeviceLock
from fiohost.transport.profile import TargetProfile
from fiohost.wire.messages import Command
from firmware_model.report import parse, telemetry


@pytest.fixture(autouse=True)
def _own_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "_folder", lambda: tmp_path)


def line(
    module: FakeHidapi, which: str = "", *more: FakeHidapi, numbered: bool = False, stale_s: float = 0.0
) -> HidTransport:
    names = ("hidraw", "libusb")
    backends = [Backend(name, m) for name, m in zip(names, (module, *more), strict=False)]
    return HidTransport(which, 0x0483, 0x5750, numbered=numbered, backends=backends, stale_s=stale_s)


# ---- reading and writing -------------------------------------------------------------------------------------------


def test_a_report_without_an_id_is_written_behind_a_zero_and_one_with_an_id_as_it_is() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        board.send(b"\x07" * 64)
    with line(module, numbered=True) as board:
        board.send(b"\x07" * 64)
    assert module.written == [b"\0" + b"\x07" * 64, b"\x07" * 64]


def test_the_newest_report_is_read_and_the_others_are_counted() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        module.queue.extend(bytes([k]) * 64 for k in range(5))
        assert board.receive(0.05) == b"\x04" * 64
        assert board.passed_over == 4


def test_after_a_queue_that_was_full_the_next_report_counts() -> None:
    """A full queue of the kernel drops what is newest: all that is in it is old."""
    module = FakeHidapi(info())
    with line(module) as board:
        module.script.extend([b"\x01" * 64, b"\xee" * 64])
        module.queue.extend(b"\x02" * 64 for _ in range(63))
        assert board.receive(0.05) == b"\xee" * 64
        assert board.passed_over == 64


def test_what_an_earlier_host_left_is_not_read() -> None:
    module = FakeHidapi(info())
    module.queue.extend(b"\x01" * 64 for _ in range(31))
    with line(module) as board:
        module.script.append(b"\x02" * 64)
        assert board.receive(0.05) == b"\x02" * 64
        assert board.passed_over == 0


def test_a_report_that_waited_in_the_board_itself_is_not_read() -> None:
    """The endpoint keeps what no host took; it comes a moment after the opening, when the queue has been emptied."""
    module = FakeHidapi(info())
    with line(module, stale_s=0.05) as board:
        module.queue.append(b"\x01" * 64)
        with pytest.raises(TelemetryTimeoutError):
            board.receive(0.001)
        module.script.append(b"\x02" * 64)
        assert board.receive(1.0) == b"\x02" * 64
        assert board.passed_over == 0


def test_an_empty_packet_behind_each_report_hides_none() -> None:
    """Over libusb it is an empty report; a host that stopped there would stay behind for ever."""
    module = FakeHidapi(info())
    with line(module) as board:
        for k in range(5):
            module.queue.extend([bytes([k]) * 64, b""])
        assert board.receive(0.05) == b"\x04" * 64
        assert board.passed_over == 4
        module.script.extend([b"", b"\x05" * 64])
        assert board.receive(0.05) == b"\x05" * 64


def test_two_empty_reads_say_that_nothing_waits() -> None:
    """A third would be one system call more in each tick."""
    module = FakeHidapi(info())
    with line(module) as board:
        module.script.append(b"\x01" * 64)
        module.queue.extend([b"", b"", b"\x02" * 64])
        assert board.receive(0.05) == b"\x01" * 64
        assert list(module.queue) == [b"\x02" * 64]


def test_a_first_read_that_is_empty_before_its_time_is_read_again() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        module.script.extend([None, None, b"\x02" * 64])
        assert board.receive(0.05) == b"\x02" * 64


def test_nothing_in_time_is_a_timeout() -> None:
    with line(FakeHidapi(info())) as board, pytest.raises(TelemetryTimeoutError, match="nothing came"):
        board.receive(0.002)


def test_a_read_that_a_signal_cut_short_is_no_unplugged_board() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        module.script.extend([OSError("read error"), b"\x02" * 64])
        assert board.receive(0.05) == b"\x02" * 64
        module.script.extend([OSError("read error")] * 3)
        with pytest.raises(DisconnectedError, match="unplugged"):
            board.receive(0.05)


def test_a_write_that_gives_minus_one_is_an_error_though_nothing_is_raised() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        module.write_results.append(-1)
        board.send(b"\x01" * 64)  # cut short by a signal, then it went through
        assert len(module.written) == 1
        module.write_results.extend([-1] * 3)
        with pytest.raises(TransportError, match="takes no report") as caught:
            board.send(b"\x01" * 64)
        assert not isinstance(caught.value, DisconnectedError)
        module.infos.clear()
        module.write_results.extend([-1] * 3)
        with pytest.raises(DisconnectedError):
            board.send(b"\x01" * 64)


def test_a_board_found_gone_is_gone_for_the_brake_too() -> None:
    """Without asking for all devices again, which takes libusb a tenth of a second."""
    module = FakeHidapi(info())
    with line(module) as board:
        module.script.extend([OSError("read error")] * 3)
        with pytest.raises(DisconnectedError):
            board.receive(0.05)
        module.write_results.extend([-1] * 3)
        with pytest.raises(DisconnectedError):
            board.send(b"\x01" * 64)


def test_a_closed_line_is_said_to_be_so() -> None:
    board = line(FakeHidapi(info()))
    with pytest.raises(DisconnectedError, match="not open"):
        board.send(b"\0" * 64)
    board.close()


# ---- opening -------------------------------------------------------------------------------------------------------


def test_hidraw_comes_first_then_libusb() -> None:
    raw, usb = FakeHidapi(info()), FakeHidapi(info())
    with line(raw, "", usb) as board:
        assert (raw.opened, usb.opened) == (1, 0)
        assert board.facts == {"hid_backend": "hidraw 0.0-fake"}
    raw.refuses_to_open = True
    with line(raw, "", usb) as board:
        assert usb.opened == 1
        assert board.facts == {"hid_backend": "libusb 0.0-fake"}


@pytest.mark.parametrize("which", ["", "A1", "1-2:1.0", "0483:5750", "0483:5750:A1"])
def test_a_board_is_meant_by_serial_number_path_or_identity(which: str) -> None:
    other = info("9-9:1.0", "B2", vendor_id=0x1234)
    with line(FakeHidapi(other, info()), which) as board:
        assert board.identity == "A1"


def test_several_boards_must_be_told_apart() -> None:
    module = FakeHidapi(info(), info("1-3:1.0", "B2"))
    with pytest.raises(ConfigError, match=r"2 HID devices fit 0483:5750: say which: hid:1-2:1\.0, hid:1-3:1\.0"):
        line(module).open()
    with line(module, "B2") as board:
        assert board.identity == "B2"


def test_the_vendor_page_is_the_board_where_it_is_a_keyboard_too() -> None:
    with line(FakeHidapi(info("1-2:1.1", usage_page=1, interface_number=1), info())) as board:
        assert board._known == info()


def test_a_missing_board_is_said_with_what_there_is() -> None:
    with pytest.raises(TransportError, match=r"no HID device 0483:5750 is connected.*1234:0001 mouse"):
        line(FakeHidapi(info(vendor_id=0x1234, product_id=1, product_string="mouse"))).open()


def test_why_a_node_does_not_open_is_looked_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "hidraw7"
    assert "is gone" in str(access.refusal(str(node), "the board"))
    node.touch()
    assert access.refusal(str(node), "the board") is None
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert "udev rules" in str(access.refusal(str(node), "the board"))


def test_a_board_that_does_not_open_leaves_no_lock() -> None:
    module = FakeHidapi(info())
    module.refuses_to_open = True
    with pytest.raises(TransportError, match=r"cannot be opened|is gone"):
        line(module).open()
    module.refuses_to_open = False
    with line(module):
        pass


# ---- one host to a board -------------------------------------------------------------------------------------------


def test_a_second_host_is_refused_and_told_by_whom() -> None:
    module = FakeHidapi(info())
    with line(module):
        with pytest.raises(TransportError, match=f"in use by another fiohost .process {os.getpid()}."):
            line(module).open()
        with line(FakeHidapi(info("1-3:1.0", "B2"))):
            pass
    with line(module):
        pass


def test_a_host_that_was_killed_leaves_no_lock(tmp_path: Path) -> None:
    code = (
        "import os, sys, pathlib; from fiohost.transport import lock\n"
        f"lock._folder = lambda: pathlib.Path({str(tmp_path)!r})\n"
        "held = lock.DeviceLock('1-2:1.0', 'the board'); print('held', flush=True); sys.stdin.read()"
    )
    host = subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=PACKAGES)
    assert host.stdout is not None
    assert host.stdout.readline() == b"held\n"
    with pytest.raises(TransportError, match=f"process {host.pid}"):
        DeviceLock("1-2:1.0", "the board")
    host.kill()
    host.communicate()
    DeviceLock("1-2:1.0", "the board").release()


def test_a_link_in_the_place_of_a_lock_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "precious").write_text("precious")
    (tmp_path / "fiohost-1-2-1.0.lock").symlink_to(tmp_path / "precious")
    with pytest.raises(TransportError, match="cannot make the lock"):
        DeviceLock("1-2:1.0", "the board")
    assert (tmp_path / "precious").read_text() == "precious"


def test_a_board_is_found_again_by_its_serial_number_under_another_path() -> None:
    module = FakeHidapi(info())
    with line(module) as board:
        module.infos = [info("1-3:1.0", "B2")]
        with pytest.raises(TransportError, match="A1 is not back"):
            board.reopen()
        module.infos = [info("1-3:1.0", "B2"), info("1-4:1.0", "A1")]
        board.reopen()
        board.send(b"\0" * 64)
        assert board.identity == "A1"


# ---- the modules ---------------------------------------------------------------------------------------------------


def loader(**modules: Any) -> Any:
    def load(name: str) -> Any:
        found = modules.get(name, ModuleNotFoundError(name))
        if isinstance(found, Exception):
            raise found
        return found

    return load


def test_the_rival_package_is_recognised_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    rival = SimpleNamespace(enumerate=list, Device=object, __file__="/x/hid/__init__.py")
    with pytest.raises(TransportError, match=r"/x/hid/__init__.py.*pip install --force-reinstall hidapi"):
        working_backends(loader(hid=rival))
    monkeypatch.setattr(hid_modules.metadata, "version", lambda name: "1.0.6")
    for broken in (rival, ImportError("Unable to load any of the following libraries: libhidapi-hidraw.so")):
        with pytest.raises(TransportError, match=r"package hid 1.0.6 \(pyhidapi\), which is not hidapi"):
            working_backends(loader(hid=broken))
    found, problems = find_backends(loader(hid=rival, hidraw=FakeHidapi()))
    assert [backend.name for backend in found] == ["hidraw"]
    assert len(problems) == 1


def test_without_hidapi_it_is_said_what_to_install() -> None:
    with pytest.raises(TransportError, match="pip install hidapi"):
        working_backends(loader())


def test_the_installed_hidapi_works() -> None:
    names = [backend.name for backend in working_backends()]
    assert names[0] == ("hidraw" if sys.platform.startswith("linux") else "native")
    for backend in working_backends():
        assert isinstance(backend.enumerate(), list)
        assert backend.version[0].isdigit()
        with pytest.raises(OSError, match="open failed"):
            backend.module.device().open_path(b"/dev/no-such-hidraw")


# ---- a bench on it -------------------------------------------------------------------------------------------------


class Stepping(FakeHidapi):
    """A board that steps when it is asked for a report, five milliseconds of its own each."""

    pos = 0

    def __init__(self, *infos: dict[str, Any]) -> None:
        super().__init__(*infos)
        self.clock = HandClock()

    def device(self) -> Any:
        device = super().device()
        plain = device.read

        def read(size: int, timeout_ms: int = 0) -> list[int]:
            if not timeout_ms:
                return plain(size)
            self.clock.time_s += 0.005
            last = parse(self.written[-1][1:])
            if last is not None and last.compare:
                self.pos = (self.pos + (5 if last.c3 else -5)) % 720
            return list(telemetry(0, self.pos))

        device.read = read  # type: ignore[method-assign]
        return device


def test_a_bench_over_hid_brakes_first_and_last() -> None:
    module = Stepping(info())
    with Bench(line(module), patient("hid-assumed"), clock=module.clock) as bench:
        log = bench.drive(-30.0, 0.2)
    commands = [parse(report[1:]) for report in module.written]
    assert all(command is not None for command in commands)
    assert commands[0] == commands[-1] == (0, 1, 1)
    assert (1080, 0, 1) in commands
    assert log.output[-1] < log.output[0] - 20.0
    assert log.metadata["serial_number"] == "A1"
    assert log.metadata["hid_backend"].startswith("hidraw")


def test_reports_that_a_full_queue_lost_are_missing_rows_by_the_clock() -> None:
    """While the host slept no report was kept, and none has a number."""

    module = Stepping(info())

    class Sleeping:
        def step(self, k: int, angle_deg: float) -> Answer | None:
            if k == 10:
                module.clock.time_s += 0.4
            return (Command.drive(20.0), None) if k < 120 else None

    with Bench(line(module), patient("hid-assumed"), clock=module.clock) as bench:
        log = bench.play(Sleeping())
    gap = int(np.argmax(np.diff(log.time_s)))
    assert log.time_s[gap] == pytest.approx(0.05, abs=0.1)
    assert np.diff(log.time_s)[gap] >= 0.395
    assert any("missing" in note for note in log.dropped)


# ---- the board as a HID device of this computer --------------------------------------------------------------------


def test_the_board_speaks_to_the_kernel_as_uhid_wants_it(monkeypatch: pytest.MonkeyPatch) -> None:
    import socket
    import struct

    from firmware_model.lines import uhid

    kernel, board = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    kernel.setblocking(False)
    board.setblocking(False)
    monkeypatch.setattr(uhid.os, "open", lambda path, flags: os.dup(board.fileno()))
    device = uhid.UhidLine(64, 64, "S7")
    create = kernel.recv(8192)
    kind, name, _, uniq, size, bus, vendor, product = struct.unpack_from("<I128s64s64sHHII", create)
    assert (kind, bus, vendor, product, uniq.rstrip(b"\0")) == (11, 3, 0x0483, 0x5750, b"S7")
    assert name.startswith(b"fiohost simulated board")
    assert create[280 : 280 + size] == uhid.report_descriptor(64, 64)
    assert uhid.report_descriptor(64, 64)[-7:] == bytes.fromhex("40 00 09 01 91 02 c0")
    assert len(create) == uhid.EVENT_SIZE

    report = bytes(range(1, 65))
    for data in (b"\0" + report, report):  # with and without the zero of an unnumbered report
        kernel.send(struct.pack("<I4096sHB", 6, data, len(data), 1))
    kernel.send(struct.pack("<IIBB", 9, 77, 0, 0).ljust(uhid.EVENT_SIZE, b"\0"))
    assert device.receive() == [report, report]
    assert kernel.recv(8192) == struct.pack("<IIHH", 10, 77, 5, 0)
    assert device.receive() == []

    device.send(report)
    assert kernel.recv(8192) == struct.pack("<IH", 12, 64) + report
    device.close()
    assert kernel.recv(8192) == struct.pack("<I", 1)


@pytest.mark.skipif(not os.access("/dev/uhid", os.W_OK), reason="this machine has no /dev/uhid that can be written")
def test_a_run_over_the_hidraw_of_the_kernel() -> None:
    import threading

    from firmware_model.lines.uhid import UhidLine
    from firmware_model.serve import serve

    taken = []

    def step(report: bytes | None) -> bytes:
        if report is not None:
            taken.append(parse(report))
        return telemetry(0, len(taken) % 720)

    device, ended = UhidLine(64, 64, "FIOHOST-TEST"), threading.Event()
    board = threading.Thread(target=serve, args=(step, device, "assumed"), kwargs={"stop": ended.is_set})
    board.start()
    try:
        time.sleep(1.0)  # for udev
        with Bench(HidTransport("FIOHOST-TEST", 0x0483, 0x5750), TargetProfile.load()) as bench:
            bench.drive(30.0, 0.2)
            assert bench.transport.facts["hid_backend"].startswith("hidraw")
    finally:
        ended.set()
        board.join()
        device.close()
    assert taken[0] == taken[-1] == (0, 1, 1)
    assert (1080, 1, 0) in taken
