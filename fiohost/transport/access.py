"""Why a device node cannot be opened, and what to do about it: missing, busy and forbidden look alike to many calls."""

from __future__ import annotations

import os
import sys
from pathlib import Path

UDEV_CURE = (
    "install the udev rules with 'fiohost udev | sudo tee /etc/udev/rules.d/70-fiohost.rules', then 'sudo udevadm "
    "control --reload' and plug the board in anew (over SSH also join the group: see 'fiohost udev --help')"
)


def refusal(node: str, what: str) -> str | None:
    """One sentence on what keeps this user from *node*; None where it is there and may be read and written.

    *what* names the device for people. Where nodes are no files (Windows, macOS) nothing is known: None.
    """
    if not sys.platform.startswith("linux") or not node.startswith("/"):
        return None
    if not Path(node).exists():
        return f"{what} is not there any more ({node} is gone): plug it in and look with 'fiohost devices'"
    if not os.access(node, os.R_OK | os.W_OK):
        return f"no permission for {what} ({node}): {UDEV_CURE}"
    return None


def usb_node(interface: str) -> str:
    """``/dev/bus/usb/BUS/DEVICE`` of a USB interface as ``1-2.3:1.0``; empty where it is not known."""
    folder = Path("/sys/bus/usb/devices") / interface.partition(":")[0]
    try:
        bus, device = (int((folder / name).read_text()) for name in ("busnum", "devnum"))
    except (OSError, ValueError):
        return ""
    return f"/dev/bus/usb/{bus:03d}/{device:03d}"


def usb_interface(node: str) -> str:
    """The USB interface (``1-2.3:1.0``) behind a node such as ``/dev/hidraw0``; empty where there is none."""
    name = Path(node).name
    for kind in ("hidraw", "tty"):
        device = Path("/sys/class") / kind / name / "device"
        if device.exists():
            for folder in (device.resolve(), *device.resolve().parents):
                if (folder / "bInterfaceNumber").exists():
                    return folder.name
    return ""
