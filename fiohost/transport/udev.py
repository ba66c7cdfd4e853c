"""The udev rules that let a user reach the boards, made from the identities in the target profiles.

``uaccess`` gives a device to whoever sits at the screen; the rules must sort before systemd's 73-seat-late.rules for
that. Over SSH nobody sits there, so the devices belong to a group too.
"""

from __future__ import annotations

from collections.abc import Mapping

PATH = "/etc/udev/rules.d/70-fiohost.rules"

_HEAD = """\
# fiohost: who may reach the boards. Made by 'fiohost udev'; install with
#   fiohost udev | sudo tee {path}
#   sudo udevadm control --reload && sudo udevadm trigger
# and plug the board in anew. At the screen that is all. Over SSH, once:
#   sudo usermod -aG {group} $USER     (a group that is missing: sudo groupadd {group}), then log in anew
"""
_BOARD = """
# {names}
SUBSYSTEM=="usb", ENV{{DEVTYPE}}=="usb_device", ATTR{{idVendor}}=="{vid}", ATTR{{idProduct}}=="{pid}", \
MODE="0660", GROUP="{group}", TAG+="uaccess", ENV{{ID_MM_DEVICE_IGNORE}}="1"
KERNEL=="hidraw*", KERNELS=="*:{vid_upper}:{pid_upper}.*", MODE="0660", GROUP="{group}", TAG+="uaccess"
SUBSYSTEM=="tty", ATTRS{{idVendor}}=="{vid}", ATTRS{{idProduct}}=="{pid}", \
MODE="0660", GROUP="{group}", TAG+="uaccess", ENV{{ID_MM_DEVICE_IGNORE}}="1"
"""


def rules(identities: Mapping[tuple[int, int], tuple[str, ...]], group: str) -> str:
    """The text of the rules file: for each identity one for libusb, one for hidraw and one for its serial port."""
    text = _HEAD.format(path=PATH, group=group)
    for (vendor, product), names in sorted(identities.items()):
        vid, pid = f"{vendor:04x}", f"{product:04x}"
        text += _BOARD.format(
            names=", ".join(names), vid=vid, pid=pid, vid_upper=vid.upper(), pid_upper=pid.upper(), group=group
        )
    return text
