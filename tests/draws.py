"""Seeds of what is drawn at a test's run."""

from __future__ import annotations

import os
import secrets


def drawn_seed(place: int = 0) -> int:
    """A new seed at every run; in the gate, which is to say the same of the same program, that of its ``place``."""
    return place if os.environ.get("CI") else secrets.randbelow(2**31)
