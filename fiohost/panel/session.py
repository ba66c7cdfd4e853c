"""A panel session: the display in a process of its own, the bench loop here."""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
from collections.abc import Callable
from contextlib import suppress
from importlib import import_module
from multiprocessing.connection import Connection
from typing import Any

from fiohost.bench.loop import Bench
from fiohost.errors import FiohostError
from fiohost.files import Output
from fiohost.panel.link import READING_S, Facts, PanelProgram, Remote

START_LIMIT_S = 60.0  # for a display to stand: the first import of matplotlib builds a cache of fonts
MAX_ANSWER_BYTES = 2000
WINDOW, WEB = "fiohost.panel.window:show", "fiohost.panel.web:serve"


def run_panel(
    bench: Bench,
    kind: str,
    options: dict[str, Any],
    log_path: Output | None = None,
    say: Callable[[str], None] = lambda where: None,
) -> int:
    """Show a display (WINDOW or WEB, with its *options*), drive as it asks until it is closed, brake; gives rows.

    *say* is called with where the display is, once it stands. Raises FiohostError where it cannot be made, or died.
    """
    facts = Facts(
        target=bench.transport.name,
        counts_per_rev=bench.counts_per_rev,
        sample_time_s=bench.sample_time_s,
        limit_pct=bench.profile.limit_duty_pct,
        log="" if log_path is None else str(log_path),
    )
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe()
    display = context.Process(target=_display, args=(theirs, kind, facts, options), name="fiohost-panel", daemon=True)
    display.start()
    theirs.close()
    try:
        say(_wait_for(ours))
        program = PanelProgram(bench, ours, "the panel died and the motor was braked")
        metadata = {"experiment": "panel", "loop": "open"}
        try:
            return bench.live(program, log_path, metadata, program, READING_S, program.recorder.row)
        finally:
            program.recorder.close()
    finally:
        ours.close()  # the display ends when it finds nobody at the other end
        display.join(3.0)
        if display.is_alive():
            display.kill()
            display.join()


def _wait_for(display: Connection[Any, Any]) -> str:
    """Where the display is. Raises FiohostError with its own reason where it cannot be made."""
    answer: dict[str, Any] = {}
    with suppress(OSError, EOFError, ValueError):
        if display.poll(START_LIMIT_S):
            answer = json.loads(display.recv_bytes(MAX_ANSWER_BYTES))
    if "ready" not in answer:
        raise FiohostError(str(answer.get("failed", "the panel could not be started; nothing was driven")))
    return str(answer["ready"])


def _display(bench: Connection[Any, Any], kind: str, facts: Facts, options: dict[str, Any]) -> None:
    """What runs in the display's process. Signals from a terminal are the bench's: it ends us by closing the link."""
    for name in ("SIGINT", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    if hasattr(os, "nice"):
        os.nice(3)  # where time is scarce the loop comes first
    remote = Remote(bench)
    module, _, function = kind.partition(":")
    with suppress(EOFError):
        try:
            getattr(import_module(module), function)(remote, facts, **options)
        except FiohostError as exc:
            remote.failed(str(exc))
