"""Whether a bench repeats itself is seen in runs of the same commands."""

from __future__ import annotations

import numpy as np
import pytest

from fiohost.checks.repeating import differing
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

STEP_S = 0.01


def run_of(name: str, gain: float, duty_pct: float = 40.0) -> Record:
    times = np.arange(800) * STEP_S
    bare = make_record(name, times, np.full(800, duty_pct), np.zeros(800), quantum=0.5, at_rest=True)
    model = Model((), {"linear.gain_deg_s_per_pct": gain, "linear.tau_s": 0.08})
    y = np.floor(free_output(bare, Flat.of(model), Start(0.0, 0.0)) / 0.5) * 0.5
    return make_record(name, times, np.full(800, duty_pct), y, quantum=0.5, at_rest=True)


def test_runs_of_the_same_commands_that_come_out_otherwise_are_reported_with_their_size() -> None:
    (found,) = differing([run_of("a", 10.0), run_of("other", 10.0, 30.0), run_of("b", 10.4)])
    assert (found.name, found.harm, found.log, found.count) == ("not_repeated", False, "a", 2)
    assert "a, b" in found.advice
    said = float(found.advice.partition("differ by ")[2].partition(" %")[0])
    assert said == pytest.approx(100.0 * 0.04 / 1.02 / np.sqrt(2.0), rel=0.05)


def test_runs_that_repeat_to_the_count_are_not() -> None:
    assert list(differing([run_of("a", 10.0), run_of("b", 10.0)])) == []
