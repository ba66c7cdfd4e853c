"""Many benches are compared: who stands apart, what drifts, what a type has in common; no worker lost loses a bench."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bench_data import measure, steps
from click.testing import CliRunner

from fiohost.bench.writer import LogWriter
from fiohost.cli.main import cli
from fiohost.errors import ConfigError
from fiohost.fleet.benches import Bench, find_benches
from fiohost.fleet.run import KEPT, run_fleet
from fiohost.fleet.summary import columns_of, summarised
from fiohost.fleet.together import population, trend, z_scores
from fiohost.fleet.work import Settings, fitted, work
from fiohost.motor.model import Model

GAIN, TAU, LEVEL = "linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct"
FIT = Settings("linear+coulomb_friction", diagnose=False)
MODEL = Model(("coulomb_friction",))


def motor(rng: np.random.Generator, friction: float = 1.0) -> Model:
    values = {GAIN: 10.5 * np.exp(0.02 * rng.standard_normal()), TAU: 0.08 * np.exp(0.03 * rng.standard_normal()),
              LEVEL: 3.0 * friction * np.exp(0.05 * rng.standard_normal())}  # fmt: skip
    return Model(("coulomb_friction",), values)


def write_log(path: Path, model: Model, seconds: float, rng: np.random.Generator, serial: int = 0) -> None:
    record = measure(model, steps(seconds, rng), rng)
    head = {"sample_time_s": "0.005", "counts_per_rev": "720", "command_delay_ticks": "1", "serial_number": str(serial)}
    with LogWriter(path, head) as writer:
        for t, u, y in zip(record.excitation.times_s, record.excitation.duties_pct[1:], record.y, strict=True):
            writer.row(float(t), float(u), int(u >= 0.0), int(u < 0.0), round(y * 2.0) % 720, 0)


@pytest.fixture(scope="module")
def line(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Eight motors of a line, the sixth with twice the friction."""
    folder = tmp_path_factory.mktemp("line")
    for i in range(8):
        rng = np.random.default_rng(i)
        (folder / f"m{i}").mkdir()
        write_log(folder / f"m{i}" / "run.csv", motor(rng, 2.0 if i == 5 else 1.0), 6.0, rng, 100 + i)
    return folder


def test_the_folders_of_a_folder_the_logs_of_one_and_the_rows_of_a_table_are_benches(
    line: Path, tmp_path: Path
) -> None:
    assert [b.name for b in find_benches(line)] == [f"m{i}" for i in range(8)]
    assert [b.logs for b in find_benches(line / "m3")] == [(line / "m3" / "run.csv",)]
    (tmp_path / "t.csv").write_text(
        f"bench,logs,type\na,{line}/m0/run.csv;{line}/m1/run.csv,x\nb,{line}/m2/run.csv,y\n"
    )
    first, second = find_benches(tmp_path / "t.csv")
    assert len(first.logs) == 2
    assert second.said == {"type": "y"}
    with pytest.raises(ConfigError, match="holds no bench"):
        find_benches(_empty(tmp_path))


def _empty(folder: Path) -> Path:
    (folder / "empty").mkdir()
    return folder / "empty"


@pytest.mark.long
def test_the_command_writes_a_table_and_a_page_and_finds_the_odd_one(line: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    arguments = ["fleet", str(line), "--out", str(out), "--fit-only", "--processes", "2", "--json", str(tmp_path / "r")]
    done = CliRunner().invoke(cli, arguments)
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "r").read_text())
    assert result["benches"] == 8
    assert [one["bench"] for one in result["apart"]] == ["m5"]
    assert result["apart"][0]["in"] == LEVEL
    assert result["order"] == "serial_number"
    import pyarrow.parquet

    table = pyarrow.parquet.read_table(out / "fleet.parquet")
    assert table.num_rows == 8
    assert table[LEVEL].to_pylist()[5] == pytest.approx(6.0, rel=0.2)
    page = (out / "fleet.html").read_text()
    assert "m5" in page
    assert "1 stands apart" in page
    assert "Not looked for" in page  # none was found, which is not to say that none is there
    assert "<svg" in page

    again = CliRunner().invoke(cli, [*arguments, "--force"])  # what was done is not done again
    assert again.exit_code == 0, again.output
    assert "8 of 8 benches are there already" in again.output
    changed = CliRunner().invoke(cli, [*arguments, "--force", "--model", "linear"])
    assert "are there already" not in changed.output


def test_a_bench_that_cannot_be_read_is_said_and_the_others_go_on(line: Path, tmp_path: Path) -> None:
    (tmp_path / "bad.csv").write_text("no log at all\n")
    benches = [Bench("bad", (tmp_path / "bad.csv",)), Bench("gone", (tmp_path / "gone.csv",)), find_benches(line)[0]]
    rows = run_fleet(benches, tmp_path / "out", FIT)
    assert rows[0]["error"]
    assert rows[1]["error"]
    assert rows[2]["error"] is None
    assert [name for name, _ in summarised(rows).failed] == ["bad", "gone"]


def test_a_diagnosis_names_what_the_declared_model_lacks(line: Path) -> None:
    bench = find_benches(line)[5]
    row = work("m5", bench.contents(), 1, Settings("linear"))
    assert row["error"] is None
    assert [step["effect"] for step in row["steps"]] == ["coulomb_friction"]
    assert summarised([row]).effects == {"coulomb_friction": 1}


@pytest.mark.long
def test_a_process_that_is_killed_loses_nothing(line: Path, tmp_path: Path) -> None:
    benches, killed = find_benches(line), []

    def kill_one(text: str) -> None:
        if not killed:
            import multiprocessing

            child = multiprocessing.active_children()[0]
            killed.append(child.pid)
            child.kill()

    rows = run_fleet(benches, tmp_path / "out", FIT, processes=1, say=kill_one)
    assert killed
    assert [row["error"] for row in rows] == [None] * 8
    assert len(list((tmp_path / "out" / KEPT).glob("*.json"))) == 8


@pytest.mark.long
def test_what_an_earlier_program_left_is_made_anew(line: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    benches = find_benches(line)[:1]
    monkeypatch.setattr("fiohost.fleet.run.SCHEMA", "fiohost.fleet_bench/0")
    run_fleet(benches, tmp_path / "out", FIT)
    said: list[str] = []
    run_fleet(benches, tmp_path / "out", FIT, say=said.append)
    assert len(said) == 1, said  # there already
    monkeypatch.undo()
    run_fleet(benches, tmp_path / "out", FIT, say=said.append)
    assert len(said) == 2
    assert said[1].endswith("fitted")


@pytest.mark.long
def test_a_cluster_gives_the_same_and_a_worker_that_is_killed_loses_nothing(line: Path, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    benches, killed = find_benches(line), []
    with (
        distributed.LocalCluster(n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None) as cluster,
        distributed.Client(cluster) as client,
    ):
        pids = list(client.run(os.getpid).values())

        def kill_one(text: str) -> None:
            if not killed:
                killed.append(pids[0])
                os.kill(pids[0], signal.SIGKILL)

        rows = run_fleet(benches, tmp_path / "out", FIT, scheduler=cluster.scheduler_address, say=kill_one)
    assert killed
    assert [row["error"] for row in rows] == [None] * 8
    alone = work("m0", benches[0].contents(), 1, FIT)
    assert rows[0]["values"] == pytest.approx(alone["values"], rel=1e-6)


def test_no_scheduler_is_one_sentence(line: Path, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    with pytest.raises(ConfigError, match="no Dask scheduler answers"):
        run_fleet(find_benches(line)[:1], tmp_path, FIT, scheduler="nonsense address")


def drawn_rows(motors: int, sd: float, own_sd: float, rng: np.random.Generator) -> tuple[list[dict[str, Any]], Any]:
    true = np.exp(np.log([10.0, 0.08]) + sd * rng.standard_normal((motors, 2)))
    seen = true * np.exp(own_sd * rng.standard_normal((motors, 2)))
    rows = [{"bench": f"m{i}", "error": None, "names": ["a", "b"], "values": v.tolist(), "window_rms": 1.0 + i % 3,
             "covariance": np.diag((own_sd * v) ** 2).tolist()} for i, v in enumerate(seen)]  # fmt: skip
    return rows, true


def test_the_population_is_that_of_which_motors_were_drawn_and_lends_what_one_lacks() -> None:
    rows, true = drawn_rows(200, 0.05, 0.10, np.random.default_rng(1))
    found = population(rows)
    assert found is not None
    assert found.mean * found.scale == pytest.approx([10.0, 0.08], rel=0.03)
    assert np.sqrt(np.diag(found.covariance)) == pytest.approx([0.05, 0.05], rel=0.4)
    seen = np.array([row["values"] for row in rows])
    lent = np.array([found.with_prior(np.array(r["values"]), np.array(r["covariance"]))[0] for r in rows])
    assert np.std(np.log(lent / true)) < 0.6 * np.std(np.log(seen / true))


def test_a_fit_knows_how_sure_it_is_though_a_torque_wanders() -> None:
    """Motors that are all the same, each under a torque of 1 % that lasts for half a second: what estimates differ by
    is what they are uncertain by.
    """
    rng = np.random.default_rng(5)
    truth, stays, rows = Model(("coulomb_friction",), {GAIN: 10.5, TAU: 0.08, LEVEL: 3.0}), np.exp(-0.01), []
    for i in range(16):
        duty, torque = steps(12.0, rng), np.zeros(2400)
        for k in range(1, len(torque)):
            torque[k] = stays * torque[k - 1] + np.sqrt(1.0 - stays**2) * rng.standard_normal()
        record = replace(measure(truth, duty, rng), y=measure(truth, duty + torque, rng).y)
        rows.append({"bench": str(i), "error": None} | fitted(MODEL, [record]))
    scatter = np.std(np.log([r["values"] for r in rows]), axis=0, ddof=1)

    claimed = np.mean([np.sqrt(np.diag(r["covariance"])) / np.array(r["values"]) for r in rows], axis=0)
    assert claimed == pytest.approx(scatter, rel=0.5)


def test_a_short_log_with_the_fleet_behind_it_says_more_than_alone() -> None:
    rng = np.random.default_rng(3)
    rows: list[Mapping[str, Any]] = []
    for i in range(12):
        truth = motor(rng)
        rows.append({"bench": str(i), "error": None} | fitted(MODEL, [measure(truth, steps(15.0, rng), rng)]))
    type_ = population(rows)
    assert type_ is not None
    alone, behind = [], []
    for _ in range(6):
        truth = motor(rng)
        true = np.array([truth.number(n) for n in type_.names])
        record = measure(truth, 0.3 * steps(5.0, rng), rng)
        noisy = replace(record, y=record.y + 10.0 * rng.standard_normal(len(record)))
        short = fitted(MODEL, [noisy])
        values, covariance = np.array(short["values"]), np.array(short["covariance"], dtype=np.float64)
        alone.append(np.log(values / true))
        behind.append(np.log(type_.with_prior(values, covariance)[0] / true))
    assert np.sqrt(np.mean(np.square(behind))) < 0.8 * np.sqrt(np.mean(np.square(alone)))


def test_a_parameter_stands_apart_that_errs_with_another_as_soon_as_the_other_is_as_in_the_type() -> None:
    """Gain and friction err together: by itself each scatters by 20 %, but not one alone."""
    rng = np.random.default_rng(4)
    covariance = np.square([0.2, 0.2])[:, None] * np.array([[1.0, 0.95], [0.95, 1.0]])
    seen = np.array([1.0, 3.0]) * (1.0 + rng.multivariate_normal([0.0, 0.0], covariance, 200))
    seen[0] = [0.95, 3.0 * 1.5]
    wide = (covariance * np.outer([1.0, 3.0], [1.0, 3.0])).tolist()
    rows = [{"bench": str(i), "error": None, "names": ["a", "b"], "values": v.tolist(), "window_rms": 1.0 + i % 3,
             "covariance": wide} for i, v in enumerate(seen)]  # fmt: skip
    z = z_scores(rows, ("a", "b"))
    assert abs(z[0, 1]) > 5.0
    assert np.max(np.abs(z[1:, :2])) < 4.0


def test_a_short_log_claims_no_more_than_it_knows() -> None:
    """Of five windows a fit takes much of what its errors leave; its intervals are as true as those of many windows."""
    rng = np.random.default_rng(6)
    truth, off = Model(("coulomb_friction",), {GAIN: 10.5, TAU: 0.08, LEVEL: 3.0}), []
    for _ in range(24):
        record = measure(truth, steps(5.0, rng), rng)
        noisy = replace(
            record, y=record.y + 5.0 * np.repeat(rng.standard_normal(len(record) // 40 + 1), 40)[: len(record)]
        )
        row = fitted(MODEL, [noisy])
        true = np.array([truth.number(n) for n in row["names"]])
        off.append((np.array(row["values"]) - true) / np.sqrt(np.diag(np.array(row["covariance"], dtype=float))))
    assert np.sqrt(np.mean(np.square(off))) < 1.5


def test_good_motors_do_not_stand_apart_and_a_trend_is_told_from_none() -> None:
    rng = np.random.default_rng(2)
    rows, _ = drawn_rows(300, 0.03, 0.01, rng)
    assert float(np.nanmax(np.abs(z_scores(rows, ("a", "b"))[:, :2]))) < 4.5
    serial = np.arange(100.0)
    told = trend(serial, 10.0 + 0.01 * serial + 0.1 * rng.standard_normal(100))
    assert told is not None
    assert told["p"] < 1e-3
    assert told["low"] < 0.01 < told["high"]
    none = trend(serial, rng.standard_normal(100))
    assert none is not None
    assert none["p"] > 1e-3
    assert columns_of(summarised(rows))["a.with_type"][0] is not None
