"""How many threads work is shared among."""

from __future__ import annotations

import os
import threading

import pytest

from fiohost.errors import ConfigError
from fiohost.workers import THREADS, each, one_thread, threads


def names(count: int) -> set[str]:
    """The threads that so many items are worked on by, each waiting until as many are at work as there may be."""
    together = threading.Barrier(min(count, threads()))

    def name(_: int) -> str:
        together.wait(60.0)
        return threading.current_thread().name

    return set(each(name, range(count)))


def test_the_environment_says_how_many_threads_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "3")
    assert threads() == 3
    assert len(names(3)) == 3
    one_thread()
    assert names(1) == {threading.current_thread().name}
    assert each(lambda _: threading.current_thread().name, "ab") == 2 * [threading.current_thread().name]


def test_else_there_are_as_many_as_cores_that_may_be_used(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, "")
    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {4, 7}, raising=False)
    assert threads() == 2
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.setattr(os, "cpu_count", lambda: None)
    assert threads() == 1


@pytest.mark.parametrize("told", ["0", "-1", "two", "1.5", "\u0662", "9" * 5000])
def test_what_is_no_number_of_threads_is_refused(told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(THREADS, told)
    with pytest.raises(ConfigError, match="whole number from 1 to 1024"):
        each(str, [1, 2])
