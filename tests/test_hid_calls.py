"""The line to hidapi, call by call: what is asked of it, and what is made of each answer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from lines import FakeHidapi, info
from test_hid_line import line

from fiohost.errors import ConfigError, DisconnectedError, TelemetryTimeoutError, TransportError
from fiohost.transport import hid, hid_modules, lock
from fiohost.transport.hid import HidTransport
from fiohost.transport.hid_modules import Backend, find_backends


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
