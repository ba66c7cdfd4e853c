"""Lines to hidapi and pyserial, call by call: what is asked of them, and what is made of each answer."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lines import FakeHidapi, info
from test_hid_line import line

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError, TransportError
from fiohost.transport import access, discovery, hid, hid_modules, lock, serial
from fiohost.transport.base import Transport, Way
from fiohost.transport.discovery import find_devices, known_identities
from fiohost.transport.hid import HidTransport
from fiohost.transport.hid_modules import Backend, find_backends
from fiohost.transport.lock import DeviceLock
from fiohost.transport.serial import SerialTransport

REPORT = bytes(range(64))


@pytest.fixture(autouse=True)
def _own_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)


# ---- HID: time in hand ---------------------------------------------------------------------------------------------


class Device:
    """An open device: each read takes what is next of *ready* (seconds, what comes); times asked for are kept."""

    def __init__(self, ready: list[tuple[float, Any]]) -> None:
        self.now_s, self.ready = 500.0, ready
        self.asked: list[int] = []
        self.slept: list[float] = []
        self.written: list[bytes] = []
        self.closed = False

    def open_path(self, path: bytes) -> None: ...

    def set_nonblocking(self, value: int) -> None:
        assert value == 1

    def read(self, size: int, timeout_ms: int = 0) -> list[int]:
        assert size == 4096
        self.asked.append(timeout_ms)
        if not self.ready:
            return []
        takes_s, come = self.ready.pop(0)
        self.now_s += takes_s
        if isinstance(come, Exception):
            raise come
        return list(come)

    def write(self, report: bytes) -> int:
        self.written.append(report)
        return len(report)

    def sleep(self, seconds: float) -> None:
        self.slept.append(seconds)
        self.now_s += seconds

    def close(self) -> None:
        self.closed = True


def hid_line(
    monkeypatch: pytest.MonkeyPatch, *ready: tuple[float, Any], stale_s: float = 0.0
) -> tuple[HidTransport, Device]:
    device = Device([])
    module = SimpleNamespace(enumerate=lambda: [info()], device=lambda: device, __version__="1", __name__="fake")
    monkeypatch.setattr(hid, "time", SimpleNamespace(monotonic=lambda: device.now_s, sleep=device.sleep))
    made = HidTransport("", 0x0483, 0x5750, backends=[Backend("hidraw", module)], stale_s=stale_s)
    made.open()
    assert made._lock is not None
    made._lock.release()  # for the next one of this test
    device.ready[:], device.asked = ready, []
    return made, device


def test_a_report_is_waited_for_in_whole_milliseconds_and_then_the_queue_is_emptied(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made, device = hid_line(monkeypatch, (0.01, b"one"), (0.0, b"two"))
    assert made.receive(0.0502) == b"two"
    assert device.asked == [51, 0, 0, 0]  # two empty reads say that nothing waits
    assert made.passed_over == 1
    made, device = hid_line(monkeypatch, (0.0, b"one"))
    assert made.receive(0.0001) == b"one"
    assert device.asked[0] == 1
    made, device = hid_line(monkeypatch, (0.0, b"one"))
    assert made.receive(0.0) == b"one"  # one look without a wait
    assert device.asked == [0, 0, 0]


def test_a_wait_that_ends_early_is_gone_on_with_until_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    made, device = hid_line(monkeypatch, (0.02, b""), (0.01, b""), (0.0, b"late"))
    assert made.receive(0.0625) == b"late"
    assert device.asked[:3] == [63, 43, 33]
    made, device = hid_line(monkeypatch, (0.0625, b""), (0.0, b""))
    with pytest.raises(TelemetryTimeoutError, match="nothing came from hid for 62 ms"):
        made.receive(0.0625)
    assert device.asked == [63, 0]  # and a last look


def test_after_a_full_queue_the_next_report_is_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    """Thirty-one that came at once are a queue that may have lost the newest."""
    for count, asks_again in ((30, False), (31, True)):
        come = [(0.0, bytes([k + 1])) for k in range(count)]
        made, device = hid_line(monkeypatch, *come, (0.0, b""), (0.0, b""), (0.01, b"x"), (0.0, b"y"))
        assert made.receive(0.0625) == (b"y" if asks_again else bytes([count]))
        assert made.passed_over == (count + 1 if asks_again else count - 1)
        assert device.asked.count(63) == (2 if asks_again else 1)
    made, device = hid_line(monkeypatch, (0.0625, b"1"), *[(0.0, b"2")] * 30, (0.0, b""), (0.0, b""), (0.0, b"x"))
    assert made.receive(0.0625) == b"2"  # there is no time left to wait for it
    assert made.passed_over == 30


def test_no_more_than_a_thousand_are_read_in_one_go(monkeypatch: pytest.MonkeyPatch) -> None:
    made, device = hid_line(monkeypatch, *[(0.0, b"1")] * 1100)
    made._drain()
    assert len(device.asked) == 1000
    made, device = hid_line(monkeypatch, (0.0, b""), (0.0, b"1"), (0.0, b""), (0.0, b"2"), (0.0, b""))
    assert made._drain() == (b"2", 2)  # an empty read between two is the end of a packet
    assert len(device.asked) == 6
    made, device = hid_line(monkeypatch)
    assert made._drain(b"had") == (b"had", 0)


def test_what_comes_soon_after_opening_is_thrown_away(monkeypatch: pytest.MonkeyPatch) -> None:
    made, device = hid_line(monkeypatch, (0.0, b"old"), (0.0, b""), (0.0, b""), (0.001, b"new"), stale_s=0.05)
    assert made.receive(0.25) == b"new"
    assert device.slept == [pytest.approx(0.05)]
    device.ready.append((0.0, b"next"))
    assert made.receive(0.25) == b"next"
    assert len(device.slept) == 1
    made, device = hid_line(monkeypatch, (0.0, b"old"), stale_s=0.05)
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.02)
    assert (device.slept, device.asked) == ([pytest.approx(0.02)], [])
    device.now_s += 1.0
    device.ready += [(0.0, b""), (0.0, b""), (0.0, b"new")]
    assert made.receive(0.25) == b"new"
    assert device.slept[1] == 0.0
    assert HidTransport("", 1, 2)._stale_s == 0.05
    made, device = hid_line(monkeypatch, (0.0, b"old"), stale_s=0.0625)
    with pytest.raises(TelemetryTimeoutError):
        made.receive(0.0625)
    assert made._fresh_from_s == 0.0  # its time had just come
    made.close()
    assert device.closed


def test_a_call_that_a_signal_cuts_short_is_tried_three_times_and_a_closed_device_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    cut = OSError("read error")
    made, device = hid_line(monkeypatch, (0.0, cut), (0.0, cut), (0.0, b"one"))
    assert made.receive(0.05) == b"one"
    made, device = hid_line(monkeypatch, *[(0.0, cut)] * 3)
    with pytest.raises(DisconnectedError, match=r"unplugged or reset \(read error\)"):
        made.receive(0.05)
    assert len(device.asked) == 3
    made, device = hid_line(monkeypatch, *[(0.0, ValueError("not open"))] * 3)
    with pytest.raises(DisconnectedError):
        made.receive(0.05)
    assert len(device.asked) == 1


def test_a_write_is_tried_three_times(monkeypatch: pytest.MonkeyPatch) -> None:
    made, device = hid_line(monkeypatch)
    results: list[int] = [-1, -1, 0]
    device.write = lambda report: (device.written.append(report), results.pop(0))[1]  # type: ignore[method-assign]
    made.send(b"abc")  # nothing written is no failure
    assert device.written == [b"\0abc"] * 3
    results[:] = [-1] * 3
    with pytest.raises(TransportError, match=r"hid takes no report \(no reason given\): its reports are not those"):
        made.send(b"abc")
    device.error = lambda: "a  b\n" + "c" * 200  # type: ignore[attr-defined]
    results[:] = [-1] * 3
    with pytest.raises(TransportError, match=rf"\(a b {'c' * 116}\)"):
        made.send(b"abc")
    made._backend.module.enumerate = list  # type: ignore[union-attr]
    results[:] = [-1] * 3
    with pytest.raises(DisconnectedError, match="went away"):
        made.send(b"abc")


# ---- HID: which device ---------------------------------------------------------------------------------------------


def opened(which: str, *infos: dict[str, Any]) -> str:
    module = FakeHidapi(*infos)
    made = line(module, which)
    made.open()
    made.close()
    return str(made.identity)


def test_a_device_is_meant_by_the_profile_a_pair_a_serial_number_or_a_path() -> None:
    mine, other = info("1-2:1.0", "A"), info("1-3:1.0", "B", vendor_id=0x1209, product_id=0x0001)
    assert opened("", mine, other) == "A"
    assert opened("1209:0001", mine, other) == "B"
    assert opened("1209:0001:B", mine, other) == "B"
    assert opened("B", mine, other) == opened("1-3:1.0", mine, other) == "B"
    for which in ("1209:0002", "1208:0001", "1209:0001:C", "C", "1-4:1.0"):
        with pytest.raises(
            TransportError, match=f"no HID device {which} is connected; HID devices: 0483:5750 board, 12"
        ):
            opened(which, mine, other)
    with pytest.raises(TransportError, match="no HID device 0483:5750 is connected; HID devices: 1209:0001 board"):
        opened("", other)
    with pytest.raises(TransportError, match="HID devices: none"):
        opened("")
    nobody = HidTransport("", None, None, backends=[Backend("hidraw", FakeHidapi(mine))])
    with pytest.raises(TransportError, match="no HID device of any kind is connected"):
        nobody.open()
    unknown = HidTransport("", 0x1209, None, backends=[Backend("hidraw", FakeHidapi(mine))])
    with pytest.raises(TransportError, match="no HID device 1209:0000 is connected"):
        unknown.open()
    assert (nobody.name, HidTransport("x", 1, 2).name) == ("hid", "hid:x")
    many = [info(f"1-{k}:1.0", str(k), vendor_id=k) for k in range(1, 12)]
    with pytest.raises(TransportError, match="0008:5750 board; 'fiohost"):
        opened("", *many)


def test_a_board_is_known_by_its_place_whatever_goes_to_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(hid, "usb_interface", lambda path: "1-2:1.0" if path.endswith("0") else "")
    monkeypatch.setattr(hid, "usb_node", lambda interface: f"node of {interface}")
    assert [hid.board_key(info(path)) for path in ("/dev/hidraw0", "/dev/hidraw1", "1-9:1.0")] == [
        "1-2:1.0", "/dev/hidraw1", "1-9:1.0",
    ]  # fmt: skip
    assert [hid.node_of(info(path)) for path in ("/dev/hidraw0", "1-9:1.0")] == ["/dev/hidraw0", "node of 1-9:1.0"]
    assert hid.label(info()) == "0483:5750 board"
    assert hid.label(info(product_string="")) == "0483:5750 unnamed"
    assert hid.path_text({"path": "text"}) == "text"
    assert not hid._same_board(info(interface_number=1), info())
    with_key = [info("/dev/hidraw0", ""), info("1-2:1.0", "")]
    assert hid._same_board(*with_key)
    assert not hid._same_board(info("/dev/hidraw1", ""), info("1-2:1.0", ""))
    assert not hid._same_board(info(serial=""), info(serial="A"))


def test_a_board_that_is_a_keyboard_as_well_is_found_by_its_own_page() -> None:
    page = info("1-2:1.1", "A", usage_page=0xFF00)
    keyboard = info("1-2:1.0", "A", usage_page=0x0001)
    module = FakeHidapi(keyboard, page)
    made = line(module)
    made.open()
    assert made._known == page
    made.close()
    with pytest.raises(ConfigError, match=r"2 HID devices fit 0483:5750: say which: hid:1-2:1\.0, hid:1-3:1\.0"):
        opened("", keyboard, info("1-3:1.0", "B", usage_page=0x0001))
    below = info("1-2:1.1", "A", usage_page=0xFEFF)
    with pytest.raises(ConfigError, match="2 HID devices"):
        opened("", keyboard, below)
    plain = {key: value for key, value in info("1-2:1.0", "A").items() if key != "usage_page"}
    assert opened("", plain) == "A"


def test_the_second_backend_is_tried_where_the_first_cannot() -> None:
    first, second = FakeHidapi(info()), FakeHidapi(info())
    first.refuses_to_open = True
    made = line(first, "", second)
    made.open()
    assert made.facts == {"hid_backend": "libusb 0.0-fake"}
    assert made.is_known_again
    made.close()
    second.refuses_to_open = True
    with pytest.raises(TransportError, match=r"the board A1 cannot be opened \(open failed\), though it is there"):
        line(first, "", second).open()
    empty = FakeHidapi()
    made = line(empty, "", FakeHidapi(info(serial="")))
    made.open()
    assert (made.is_known_again, made.identity) == (False, "1-2:1.0")
    made.close()
    made.close()
    with pytest.raises(DisconnectedError, match="hid is not open"):
        made.receive(0.0)


def test_a_board_that_was_never_open_is_opened_by_reopening_and_another_is_not_taken_for_it() -> None:
    module = FakeHidapi(info("1-2:1.0", "A"))
    made = line(module)
    made.reopen()
    assert module.opened == 1
    module.infos[:] = [info("1-9:1.0", "B")]
    with pytest.raises(TransportError, match="the board A is not back"):
        made.reopen()
    module.infos[:] = [info("1-9:1.0", "A")]
    made._found_gone = True
    made.reopen()
    assert (module.opened, made._found_gone) == (2, False)
    made.close()
    numberless = FakeHidapi(info("1-2:1.0", ""))
    made = line(numberless)
    made.open()
    assert made.identity == "1-2:1.0"
    numberless.infos[:] = [info("1-3:1.0", "")]
    with pytest.raises(TransportError, match=r"the board 1-2:1\.0 is not back"):
        made.reopen()


def test_hidapis_modules_are_named_by_what_they_go_through(monkeypatch: pytest.MonkeyPatch) -> None:
    module = SimpleNamespace(device=None, enumerate=lambda: [{"a": 1}])

    def load(*there: str) -> Callable[[str], Any]:
        def found(name: str) -> Any:
            if name not in there:
                raise ModuleNotFoundError
            return module

        return found

    for is_linux, names in ((True, ["hidraw", "libusb"]), (False, ["hidraw", "libusb"])):
        monkeypatch.setattr(hid_modules, "_is_linux", lambda: is_linux)  # noqa: B023
        backends, problems = find_backends(load("hidraw", "hid"))
        assert ([backend.name for backend in backends], problems) == (names, [])
        (alone,), _ = find_backends(load("hid"))
        assert alone.name == ("libusb" if is_linux else "native")
    assert (backends[0].version, backends[0].enumerate()) == ("unknown", [{"a": 1}])
    monkeypatch.setattr(hid_modules, "_rival", lambda name: None)
    for half in (SimpleNamespace(device=None, __file__="x.so"), SimpleNamespace(enumerate=None, __file__="x.so")):
        backends, problems = find_backends(lambda name: half)  # noqa: B023
        assert backends == []
        assert problems[1].startswith("the module 'hid' (x.so) is not the one of hidapi: pip uninstall hid")

    def breaks(name: str) -> Any:
        raise ImportError("no  such\nlibrary" + "x" * 200)

    assert find_backends(breaks)[1][0] == f"the module 'hidraw' does not load: no such library{'x' * 105}"


# ---- nodes, locks --------------------------------------------------------------------------------------------------


def test_what_keeps_a_user_from_a_node(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    node = tmp_path / "node"
    assert "is not there any more" in str(access.refusal(str(node), "the board"))
    node.touch()
    assert access.refusal(str(node), "the board") is None
    monkeypatch.setattr(access.os, "access", lambda path, mode: mode != os.R_OK | os.W_OK)
    assert str(access.refusal(str(node), "the board")).startswith(f"no permission for the board ({node}): install the")
    assert access.refusal("1-2:1.0", "the board") is None
    monkeypatch.setattr(access.sys, "platform", "darwin")
    assert access.refusal(str(node), "the board") is None


def test_the_usb_node_and_interface_of_a_device(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    devices = tmp_path / "sys" / "bus" / "usb" / "devices" / "1-2.3"
    devices.mkdir(parents=True)
    real = Path

    def under(*parts: str) -> Path:
        return real(*(f"{tmp_path}{part}" if part.startswith("/sys") else part for part in parts))

    monkeypatch.setattr(access, "Path", under)
    assert access.usb_node("1-2.3:1.0") == ""
    (devices / "busnum").write_text("1\n")
    (devices / "devnum").write_text("x")
    assert access.usb_node("1-2.3:1.0") == ""
    (devices / "devnum").write_text("14\n")
    assert access.usb_node("1-2.3:1.0") == "/dev/bus/usb/001/014"
    interface = devices / "1-2.3:1.1"
    (interface / "hidraw" / "hidraw0").mkdir(parents=True)
    (interface / "bInterfaceNumber").touch()
    for kind, name in (("hidraw", "hidraw0"), ("tty", "ttyACM0")):
        place = tmp_path / "sys" / "class" / kind / name
        place.mkdir(parents=True)
        (place / "device").symlink_to(interface / "hidraw" / "hidraw0" if kind == "hidraw" else interface)
        assert access.usb_interface(f"/dev/{name}") == "1-2.3:1.1"
    assert access.usb_interface("/dev/ttyS0") == ""


def test_a_lock_is_a_file_that_all_may_use_with_its_holder_in_it(tmp_path: Path) -> None:
    held = DeviceLock("/dev/hid raw/0" + "x" * 200, "the board")
    assert held.path == tmp_path / ("fiohost-dev-hid-raw-0" + "x" * 87 + ".lock")
    assert stat.S_IMODE(held.path.stat().st_mode) == 0o666
    assert held.path.read_text() == str(os.getpid())
    said = rf"the board is in use by another fiohost \(process {os.getpid()}\): end that one first"
    with pytest.raises(TransportError, match=said):
        DeviceLock("/dev/hid raw/0" + "x" * 200, "the board")
    held.release()
    held.release()
    held.path.write_text("999999999999 and more")
    again = DeviceLock("/dev/hid raw/0" + "x" * 200, "the board")
    assert again.path.read_text() == str(os.getpid())  # nothing of an earlier one is left
    again.release()
    blocked = tmp_path / "fiohost-b.lock"
    blocked.mkdir()
    with pytest.raises(TransportError, match=r"cannot make the lock .*remove it"):
        DeviceLock("b", "the board")


def test_locks_are_where_every_users_host_looks(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.undo()
    can_write: list[str] = []
    monkeypatch.setattr(lock.os, "access", lambda path, mode: path in can_write and mode == os.W_OK)
    monkeypatch.setattr(lock.tempfile, "gettempdir", lambda: "/tmp/x")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    assert lock._folder() == Path("/tmp/x")
    can_write.append(str(tmp_path))
    assert lock._folder() == tmp_path
    can_write.append("/run/lock")
    assert lock._folder() == Path("/run/lock")
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    can_write[:] = [""]
    assert lock._folder() == Path("/tmp/x")


# ---- what is connected ---------------------------------------------------------------------------------------------


def test_devices_are_told_with_what_opens_them_and_boards_first(monkeypatch: pytest.MonkeyPatch) -> None:
    mouse = info("3-1:1.0", "M", vendor_id=0x1234, product_id=1, product_string="mouse", manufacturer_string="maker")
    unnamed = info("3-2:1.0", "", manufacturer_string=None, product_string=None)
    both = [Backend("hidraw", FakeHidapi(mouse, unnamed)), Backend("libusb", FakeHidapi(mouse, info("4-1:1.0", "S")))]
    monkeypatch.setattr(discovery, "find_backends", lambda: (both, []))
    ports = [
        SimpleNamespace(device="/dev/ttyNOPE", vid=0x0483, pid=0x5740, serial_number="", description=None),
        SimpleNamespace(device="/dev/null", vid=1, pid=2, serial_number="Z", description="x"),
    ]
    monkeypatch.setattr(serial, "usb_ports", lambda: ports)
    found = find_devices()
    assert [(one.target, one.identity, one.name, one.is_candidate) for one in found] == [
        ("hid:3-2:1.0", "0483:5750", "", True),
        ("hid:S", "0483:5750:S", "board", True),
        ("serial:/dev/null", "0001:0002:Z", "x", True),
        ("serial:/dev/ttyNOPE", "0483:5740", "", True),
        ("hid:3-1:1.0", "1234:0001:M", "maker mouse", False),
    ]
    assert found[0].to_json()["profiles"] == ["hid-assumed", "hid-framed"]
    assert found[2].problem is None
    assert "is gone" in str(found[3].problem)
    assert known_identities()[0x0483, 0x5750] == ("hid-assumed", "hid-framed")


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
