"""The gadget's cable: plugged in, with both of its ends there."""

from __future__ import annotations

import time
from pathlib import Path

from firmware_model import gadget

NODES = ("/dev/hidg0", "/dev/ttyGS0", "/dev/hidraw0", "/dev/ttyACM0")
LIMIT_S = 20.0


def replug() -> None:
    """Plug the cable in where it is out; until both its ends are there. Raises TimeoutError."""
    if not gadget.is_plugged():
        gadget.plug()
        wait_for_nodes()


def wait_for_nodes() -> None:
    """Until both ends of the cable are there. Raises TimeoutError."""
    deadline_s = time.monotonic() + LIMIT_S
    while missing := [node for node in NODES if not Path(node).exists()]:
        if time.monotonic() > deadline_s:
            raise TimeoutError(f"plugged in, but {', '.join(missing)} did not come in {LIMIT_S:g} s")
        time.sleep(0.02)
