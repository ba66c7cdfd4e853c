"""Shared by the tests: where the real measurements are."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from places import ROOT

# Workers share the cores among themselves: more threads would only get in their way. numpy is not imported yet.
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("OPENBLAS_NUM_THREADS", "FIOHOST_THREADS"):
        os.environ.setdefault(name, "1")

# A busy machine is no fault of what is tested; the rest is as hypothesis has it, in the gate and outside.
settings.register_profile("patient", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


def pytest_configure() -> None:
    """Tests of signals need them heard: under nohup a hang-up is ignored, in the background of a shell script Ctrl-C
    and Ctrl-\\, and so it is in all children.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.fixture(scope="session")
def measured_data() -> Path:
    """Folder with the real measurements (``measured/`` in it): FIOHOST_DATA, else ``../shared/data``."""
    named = os.environ.get("FIOHOST_DATA")
    folder = Path(named) if named else ROOT.parent / "shared" / "data"
    if not (folder / "measured").is_dir():
        pytest.skip(
            f"REAL MEASUREMENTS ABSENT: no folder {folder / 'measured'}; set FIOHOST_DATA to the folder above it"
        )
    return folder


@pytest.fixture
def measured(request: pytest.FixtureRequest) -> Callable[[str], None]:
    """A figure that a test measured, for the end of the output: ``measured("12 of 12")``."""

    def keep(text: str) -> None:
        request.node.user_properties.append(("measured", text))

    return keep


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """All figures, by whichever worker they were measured."""
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    found = [text for report in reports for name, text in report.user_properties if name == "measured"]
    if found:
        terminalreporter.section("measured")
    for text in sorted(found):
        terminalreporter.write_line(text)
