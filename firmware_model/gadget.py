"""``python -m firmware_model.gadget up|down``: this computer's USB device port becomes a board (Linux, root).

For a computer whose USB port can be a device, such as a Raspberry Pi Zero 2 W, or for the kernel's own ``dummy_hcd``.
The gadget has the identity of the assumed board, a HID function (``/dev/hidg0``) and a serial one (``/dev/ttyGS0``).
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from firmware_model.errors import FirmwareModelError
from firmware_model.lines.uhid import PRODUCT_ID, VENDOR_ID, report_descriptor

CONFIGFS = Path("/sys/kernel/config/usb_gadget")
CONTROLLERS = Path("/sys/class/udc")
NAME = "firmware_model"
REPORT_SIZE = 64
NEEDS = "it needs root, 'modprobe libcomposite', and a USB port that can be a device (on a Pi: dtoverlay=dwc2)"


def up(configfs: Path = CONFIGFS, controllers: Path = CONTROLLERS, serial_number: str = "SIMULATED") -> str:
    """Make the gadget and plug it in; gives the controller's name. Raises FirmwareModelError."""
    gadget = configfs / NAME
    try:
        _controller(controllers)
        gadget.mkdir()
        _write(gadget, idVendor=f"0x{VENDOR_ID:04x}", idProduct=f"0x{PRODUCT_ID:04x}", bcdDevice="0x0100")
        strings = {"serialnumber": serial_number, "manufacturer": "firmware_model", "product": "simulated board"}
        _write(_folder(gadget / "strings/0x409"), **strings)
        hid = _folder(gadget / "functions/hid.usb0")
        _write(hid, protocol="0", subclass="0", report_length=str(REPORT_SIZE))
        (hid / "report_desc").write_bytes(report_descriptor(REPORT_SIZE, REPORT_SIZE))
        acm = _folder(gadget / "functions/acm.usb0")
        config = _folder(gadget / "configs/c.1")
        for function in (hid, acm):
            (config / function.name).symlink_to(function)
    except OSError as exc:
        raise FirmwareModelError(f"cannot make the gadget in {gadget}: {exc.strerror}; {NEEDS}") from exc
    return plug(configfs, controllers)


def plug(configfs: Path = CONFIGFS, controllers: Path = CONTROLLERS) -> str:
    """Plug the cable in (again); gives the controller's name. Raises FirmwareModelError."""
    name = _controller(controllers)
    try:
        _write(configfs / NAME, UDC=name)
    except OSError as exc:
        raise FirmwareModelError(f"the gadget cannot be plugged in: {exc.strerror}; {NEEDS}") from exc
    return name


def _controller(controllers: Path) -> str:
    """The USB port that can be a device. Raises FirmwareModelError."""
    try:
        names = sorted(path.name for path in controllers.iterdir())
    except OSError:
        names = []
    if not names:
        raise FirmwareModelError(f"no USB port of this computer can be a device; {NEEDS}")
    return names[0]


def is_plugged(configfs: Path = CONFIGFS) -> bool:
    return bool((configfs / NAME / "UDC").read_text().strip())


def unplug(configfs: Path = CONFIGFS) -> None:
    """What pulling the cable does. Raises FirmwareModelError."""
    try:
        (configfs / NAME / "UDC").write_text("\n")
    except OSError as exc:
        raise FirmwareModelError(f"the gadget cannot be unplugged: {exc.strerror}") from exc


def down(configfs: Path = CONFIGFS) -> None:
    """Unplug and take the gadget away, in the order in which the kernel allows it."""
    gadget = configfs / NAME
    with suppress(OSError, FirmwareModelError):
        unplug(configfs)
    for link in (gadget / "configs/c.1").glob("*.usb0"):
        link.unlink()
    for folder in ("configs/c.1", "functions/hid.usb0", "functions/acm.usb0", "strings/0x409", "."):
        with suppress(OSError):
            (gadget / folder).rmdir()


def _folder(path: Path) -> Path:
    path.mkdir(parents=True, exist_ok=True)
    return path


def _write(folder: Path, **values: str) -> None:
    for name, value in values.items():
        (folder / name).write_text(value + "\n")


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser("python -m firmware_model.gadget", description=__doc__)
    parser.add_argument("what", choices=("up", "down"))
    try:
        if parser.parse_args(arguments).what == "up":
            print(f"gadget on {up()}: /dev/hidg0 and /dev/ttyGS0, for python -m firmware_model --device NODE")
        else:
            down()
    except FirmwareModelError as exc:
        print(f"firmware_model: {exc}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
