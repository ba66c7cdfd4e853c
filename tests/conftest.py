"""Shared by the tests: where the real measurements are."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from datetime import date
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings
from places import ROOT

# Workers share the cores among themselves: more threads would only get in their way. numpy is not imported yet.
if "PYTEST_XDIST_WORKER" in os.environ:
    for name in ("OPENBLAS_NUM_THREADS", "FIOHOST_THREADS"):
        os.environ.setdefault(name, "1")

# Each day one of so many shares of the long tests is run, all of them in as many days; workers are told which.
SHARES, SHARE = 14, "FIOHOST_TESTS_SHARE"

LEFT = pytest.StashKey[int]()

# A busy machine is no fault of what is tested; the rest is as hypothesis has it, in the gate and outside.
settings.register_profile("patient", settings(), deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("patient")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--long", action="store_true", help=f"all long tests, not a day's share of 1 in {SHARES}")


def pytest_configure(config: pytest.Config) -> None:
    """Long tests are left out where all tests are asked for, not where some are named. Tests of signals need them
    heard: under nohup a hang-up is ignored, in the background of a shell script Ctrl-C and Ctrl-\\, and so it is in all
    children.
    """
    if "PYTEST_XDIST_WORKER" not in os.environ:
        given = config.option
        named = config.args_source is not pytest.Config.ArgsSource.TESTPATHS or given.keyword or given.markexpr
        share = "all" if named or given.long else str(date.today().toordinal() % SHARES)
        os.environ.setdefault(SHARE, share)
        if config.pluginmanager.hasplugin("xdist"):
            config.pluginmanager.register(Workers())
    signal.signal(signal.SIGHUP, signal.SIG_DFL)
    signal.signal(signal.SIGQUIT, signal.SIG_DFL)
    if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Of the long tests the day's share; those of one group go together."""
    if os.environ[SHARE] == "all":
        return
    group = {i: (mark.args or (i.nodeid,))[0] for i in items if (mark := i.get_closest_marker("long"))}
    today = sorted(set(group.values()))[int(os.environ[SHARE]) :: SHARES]
    others = [i for i in items if i in group and group[i] not in today]
    items[:] = [i for i in items if i not in others]
    config.hook.pytest_deselected(items=others)
    config.stash[LEFT] = len(others)
    if hasattr(config, "workeroutput"):
        config.workeroutput[SHARE] = len(others)


class Workers:
    """What workers tell where tests are shared among them."""

    def pytest_testnodedown(self, node: Any) -> None:
        """How many tests a worker left to other days."""
        node.config.stash[LEFT] = getattr(node, "workeroutput", {}).get(SHARE, 0)


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


def pytest_terminal_summary(terminalreporter: Any, config: pytest.Config) -> None:
    """All figures, by whichever worker they were measured; and how many tests are left to other days."""
    if left := config.stash.get(LEFT, 0):
        terminalreporter.section("long tests")
        terminalreporter.write_line(
            f"{left} LONG TESTS ARE LEFT TO OTHER DAYS, one in {SHARES} is run: all with --long"
        )
    reports = [report for outcome in ("passed", "failed") for report in terminalreporter.stats.get(outcome, [])]
    found = [text for report in reports for name, text in report.user_properties if name == "measured"]
    if found:
        terminalreporter.section("measured")
    for text in sorted(found):
        terminalreporter.write_line(text)
