"""The time convention from end to end: what the metadata say of a command's delay is known, and nothing else is."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from bench_data import TICK_S, measure, multisine, steps, truth_model
from short_runs import logs_of

from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.estimation.fit import fit
from fiohost.estimation.record import Record, record_from_log
from fiohost.motor.model import Model

DECLARED = "linear+coulomb_friction"


@pytest.fixture(scope="module")
def wire_logs(tmp_path_factory: pytest.TempPathFactory) -> list[Log]:
    """Logs of an effect-free board, driven through the wire."""
    return logs_of("sim:ideal", tmp_path_factory.mktemp("wire"), seed=11)


def restated(log: Log, delay_ticks: int, shift: int = 0) -> Log:
    """The same run with its commands moved ``shift`` rows later and another delay in the metadata."""
    columns = dict(log.columns)
    for name, rest in (("duty_pct", 0.0), ("c3", 1.0), ("c4", 1.0)):  # before the run the bench brakes
        columns[name] = np.concatenate((np.full(shift, rest), columns[name][: len(log) - shift]))
    return Log.from_columns(columns, {**log.metadata, "command_delay_ticks": str(delay_ticks)}, log.path)


def delay_of(records: Sequence[Record]) -> float:
    """The delay in seconds that a fit finds beyond the stated one, starting from a tick."""
    model = Model.parse(f"{DECLARED}+transport_delay").with_values({"transport_delay.delay_s": TICK_S})
    return fit(model, records).model.number("transport_delay.delay_s")


def fitted_delay_s(logs: Sequence[Log]) -> float:
    return delay_of([record_from_log(log) for log in logs])


def test_a_board_driven_through_the_wire_shows_no_transport_delay(wire_logs: list[Log]) -> None:
    assert all(log.command_delay_ticks == 1 for log in wire_logs)
    found = diagnose(wire_logs, (), DECLARED)
    assert found.verdict == "no_missing_effect"
    assert found.steps == ()
    assert fitted_delay_s(wire_logs) < 0.02 * TICK_S


def test_a_log_whose_command_acts_at_once_shows_none_either(wire_logs: list[Log]) -> None:
    at_once = [restated(log, 0, shift=1) for log in wire_logs]
    found = diagnose(at_once, (), DECLARED)
    assert found.verdict == "no_missing_effect"
    assert fitted_delay_s(at_once) < 0.02 * TICK_S


def test_nor_does_one_that_says_nothing_of_a_delay(wire_logs: list[Log]) -> None:
    silent = []
    for log in (restated(log, 0, shift=1) for log in wire_logs):
        metadata = {k: v for k, v in log.metadata.items() if k != "command_delay_ticks"}
        silent.append(Log.from_columns(log.columns, metadata, log.path))
    assert all(log.command_delay_ticks == 0 for log in silent)
    assert fitted_delay_s(silent) < 0.02 * TICK_S


def test_metadata_that_leave_out_a_tick_are_found_out_as_a_delay_of_a_tick(wire_logs: list[Log]) -> None:
    found = diagnose([restated(log, 0) for log in wire_logs], (), DECLARED)
    assert [step.effect for step in found.steps] == ["transport_delay"]
    assert found.verdict == "explained"
    assert found.final.fit.model.number("transport_delay.delay_s") == pytest.approx(TICK_S, abs=0.1e-3)


@pytest.mark.long
def test_metadata_that_claim_a_tick_too_many_are_not_explained_away(wire_logs: list[Log]) -> None:
    few = ["transport_delay", "armature_inductance", "input_deadband"]
    found = diagnose([restated(log, 2) for log in wire_logs], (), DECLARED, library=few)
    assert found.verdict == "unexplained"  # a command that acts before it is given is no effect
    assert "transport_delay" not in [step.effect for step in found.steps]


@pytest.mark.parametrize("ticks", [0, 1, 3])
def test_the_kernels_own_records_keep_the_convention(ticks: int) -> None:
    rng = np.random.default_rng(30 + ticks)
    truth = truth_model()
    records = [measure(truth, shape(8.0, rng), rng, delay_ticks=ticks) for shape in (multisine, steps)]
    assert delay_of(records) < 0.02 * TICK_S
