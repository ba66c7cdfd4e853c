"""Shared by the tests: where the real measurements are."""

from __future__ import annotations

import os
import signal
from pathlib import Path

import pytest

# Workers share the cores among themselves: numpy's own threads would only get in their way. It is not imported yet.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent


def pytest_configure() -> None:
    """Tests of signals need them heard: under nohup a hang-up is ignored, in the background of a shell script Ctrl-C,
    and so it is in all children.
    """
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
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
