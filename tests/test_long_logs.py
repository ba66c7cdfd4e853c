"""Logs of any length are read in pieces: the same as in one, and with little memory beside the numbers themselves. So
they are diagnosed: no more is kept of a candidate or a replica than is asked for.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_data import measure, steps, truth_model

from fiohost.bench import rows as rows_module
from fiohost.bench.log import Log
from fiohost.bench.unwrap import ambiguous_steps
from fiohost.discover.movement import movement
from fiohost.discover.refit import Job, ranked
from fiohost.discover.weighed import WeighedWindows
from fiohost.discover.whitened import with_noise
from fiohost.errors import LogError
from fiohost.estimation.fit import fit
from fiohost.judging.floor import replica_floor
from fiohost.judging.metrics import judge
from fiohost.motor.effect import effects
from fiohost.motor.model import Model
from fiohost.noise.estimate import NONE, Ranged

HEAD = "# schema: fiohost.log/1\n# sample_time_s: 0.005\ntime_s,duty_pct,c3,c4,pos,direction,ref_deg,angle_deg,note\n"


def rows(count: int) -> list[str]:
    return [f"{0.005 * k:.3f},{k % 90},1,0,{k % 720},0,,{0.5 * (k % 720):.1f},{k}" for k in range(count)]


def test_in_pieces_a_log_is_the_same_as_in_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With lines that are damaged in several pieces, a column that holds text in one of them, and an umlaut."""
    lines = rows(400)
    lines[7], lines[300] = "0.035,7,1", lines[300].replace(",1,0,", ",x,0,")
    lines[350] = lines[350].rpartition(",")[0] + ",Prüfling"
    lines[352] = "# a remark"
    path = tmp_path / "run.csv"
    path.write_bytes(b"\xef\xbb\xbf" + ("# bench: Prüfstand\n" + HEAD + "\n".join(lines) + "\n0.5,1").encode())
    whole = Log.read(path)
    assert len(whole) == 397
    assert "note" not in whole.columns
    assert any("2 lines that do not fit the columns (the first is line 12)" in note for note in whole.dropped)
    monkeypatch.setattr(rows_module, "PIECE_BYTES", 500)
    cut = Log.read(path)
    assert (cut.dropped, cut.metadata, cut.sha256) == (whole.dropped, whole.metadata, whole.sha256)
    assert cut.columns.keys() == whole.columns.keys()
    for name, values in whole.columns.items():
        np.testing.assert_array_equal(cut.columns[name], values)


def test_a_byte_that_is_no_text_is_named_with_its_place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rows_module, "PIECE_BYTES", 500)
    data = (HEAD + "\n".join(rows(100)) + "\n").encode()
    at = len(data) - 40
    path = tmp_path / "run.csv"
    path.write_bytes(data[:at] + b"\xff" + data[at + 1 :])
    with pytest.raises(LogError, match=f"byte {at} is not UTF-8"):
        Log.read(path)


def test_reading_takes_little_memory_beside_the_file_and_its_numbers(tmp_path: Path) -> None:
    count = 60_000
    path = tmp_path / "run.csv"
    path.write_text(HEAD + "\n".join(rows(count)) + "\n")
    rows_module.PIECE_BYTES, kept = 100_000, rows_module.PIECE_BYTES
    tracemalloc.start()
    try:
        log = Log.read(path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
        rows_module.PIECE_BYTES = kept
    numbers = sum(values.nbytes for values in log.columns.values())
    assert peak < 1.7 * (path.stat().st_size + numbers)


def test_a_gap_is_judged_by_the_speeds_beside_it() -> None:
    """100 counts a tick over a gap of three ticks: near half a turn, on either side, at the ends too."""

    def judged(pos: list[float], ticks: list[float]) -> list[int]:
        found = ambiguous_steps(np.array(pos), 0.005 * np.array(ticks), 0.005, 720)
        return [int(at) for at in found]

    assert judged([0, 100, 200, 600, 600], [0, 1, 2, 6, 7]) == [2]
    assert judged([0, 0, 0, 600, 700], [0, 1, 2, 6, 7]) == [2]
    assert judged([0, 20, 40, 120, 140], [0, 1, 2, 6, 7]) == []
    assert judged([0, 300, 400], [0, 4, 5]) == [0]
    assert judged([0, 100, 400], [0, 1, 5]) == [1]
    assert judged([0, 300], [0, 4]) == []  # nobody knows a speed
    assert judged([0, 0, 250, 250, 250], [0, 1, 3, 7, 8]) == []  # a gap says nothing of the speed in the next
    assert judged([0, 330], [0, 1]) == [0]


def test_a_floor_keeps_no_arrays_of_its_replicas() -> None:
    rng = np.random.default_rng(1)
    truth = truth_model()
    record = measure(truth, steps(60.0, rng), rng)
    judgement = judge(record, truth)

    def peak(draws: int) -> int:
        tracemalloc.start()
        try:
            replica_floor(record, truth, judgement, [truth] * draws, np.random.default_rng(2))
            return tracemalloc.get_traced_memory()[1]
        finally:
            tracemalloc.stop()

    peak(2)
    assert peak(16) < peak(2) + 2 * record.y.nbytes  # of each draw three arrays would be kept


def test_a_rough_fit_and_what_the_null_does_not_ask_for_keep_no_arrays() -> None:
    rng = np.random.default_rng(1)
    records = [measure(truth_model(("coulomb_friction",)), steps(16.0, rng), rng)]
    windows = WeighedWindows(records)
    root = windows.declared(Model(), False)
    beside = windows.beside(root)
    screen, other = beside.screens
    offered = [effects()[n] for n in ("coulomb_friction", "quadratic_drag")]
    kept, light = ranked(screen, offered, True), ranked(other, offered, False)
    assert all(s.directions for s in kept)
    assert not any(s.directions for s in light)
    _, (rough,) = beside.rough([Job(kept[0], root.fit, root.records)], float("inf"))
    assert rough.cost < root.fit.cost
    assert (rough.residuals, rough.jacobians, rough.nuisances) == ((), (), ())


def test_of_a_long_log_only_what_is_looked_at_is_kept() -> None:
    """Beside them everything between was zero, and whitened, and kept of each of a dozen candidates."""
    rng = np.random.default_rng(1)
    record = replace(measure(truth_model(), steps(40.0, rng), rng), every=8)
    whole = fit(Model(), [record], windows=True, max_iterations=3)
    noise = replace(NONE, torque_pct=Ranged(0.5, 0.5, 0.5), torque_s=Ranged(0.1, 0.1, 0.1))
    moves = [movement(record, whole.model, whole.starts[0])]
    white = fit(whole.model, with_noise([record], whole.model, noise, moves), windows=True, starts=whole.starts)
    for found in (whole, white):
        assert len(found.residuals[0]) == len(found.jacobians[0]) == found.samples <= len(record) / 4
