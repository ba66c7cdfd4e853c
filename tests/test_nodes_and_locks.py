"""Device nodes, the locks on them, and what is listed as connected."""

from __future__ import annotations

import os
import stat
from pathlib import Path
from types import SimpleNamespace

import pytest
from lines import FakeHidapi, info

from fiohost.errors import TransportError
from fiohost.transport import access, discovery, lock, serial
from fiohost.transport.discovery import find_devices, known_identities
from fiohost.transport.hid_modules import Backend
from fiohost.transport.lock import DeviceLock


@pytest.fixture(autouse=True)
def _own_locks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lock, "_folder", lambda: tmp_path)


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
