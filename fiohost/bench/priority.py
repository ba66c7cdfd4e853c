"""Precedence over other programs for the loop and its guardian, where the system allows it."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

from fiohost.errors import ConfigError

LEVEL = 10  # of 1 to 99: above all ordinary programs, below the kernel's own threads


@contextmanager
def realtime_priority() -> Iterator[None]:
    """Within it this thread, and processes that it starts, run before all ordinary ones. Raises ConfigError."""
    if not hasattr(os, "sched_setscheduler"):
        raise ConfigError("--realtime-priority: this system has no such thing, only Linux has; leave it out")
    before, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(LEVEL))
    except OSError as exc:
        raise ConfigError(
            f"--realtime-priority: not allowed here ({exc.strerror}); a line '@plugdev - rtprio 20' in "
            "/etc/security/limits.conf and a new login allow it to that group"
        ) from exc
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, parameter)
