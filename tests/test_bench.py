"""The bench: what it records, when its commands act, and which targets it takes."""

from __future__ import annotations

import select
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from boards import WatchedTransport, bench_on
from short_runs import plant_file

from fiohost.bench.connect import connect
from fiohost.bench.experiment import ControlSettings, Experiment
from fiohost.bench.host import HostWatch
from fiohost.bench.line import Line
from fiohost.bench.log import BRAKE, DRIVE, Log
from fiohost.bench.loop import Tick
from fiohost.bench.seal import find_seed
from fiohost.bench.signals import Constant, Pulses, Square, Staircase
from fiohost.errors import (
    ConfigError,
    TransportError,
)
from fiohost.estimation.record import record_from_log

STAIRS = Experiment("stairs", [Staircase(levels=(30.0, -30.0, 0.0), step_s=0.5, duration_s=3.0)])
SQUARE = Experiment(
    "square",
    reference=[Square(low=170.0, high=190.0, period_s=2.0, duration_s=6.0)],
    control=ControlSettings(u_plus_pct=2.0, u_minus_pct=-2.0),
)


class HeldUp(HostWatch):
    """A computer that stands still for 5 s of the board's steps before a program's first reading."""

    def __init__(self, line: Line) -> None:
        super().__init__(line)
        self.line = line

    @contextmanager
    def alarmed(self) -> Iterator[None]:
        self.line.steps += 1000
        yield


def test_a_program_begins_with_its_first_reading_however_late(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("fiohost.bench.turns.HostWatch", HeldUp)
    with connect("sim") as bench:
        log = bench.run(STAIRS)
    assert len(log) == 600
    assert log.time_s[0] == 0.0


def test_a_run_is_logged_tick_by_tick_with_what_the_contract_asks_for(tmp_path: Path) -> None:
    with connect("sim") as bench:
        log = bench.run(STAIRS, tmp_path / "run.csv")
    assert log.dropped == ()
    assert len(log) == 600
    np.testing.assert_allclose(log.time_s, 0.005 * np.arange(600), atol=1e-12)
    assert set(np.unique(log.duty_pct)) == {-30.0, 0.0, 30.0}
    np.testing.assert_array_equal(log.mode, np.where(log.duty_pct == 0.0, BRAKE, DRIVE))
    np.testing.assert_array_equal(log.columns["c3"], log.duty_pct >= 0)
    np.testing.assert_array_equal(log.columns["c4"], log.duty_pct <= 0)
    np.testing.assert_array_equal(log.output, log.columns["angle_deg"])
    wanted = {"schema", "target", "serial_number", "experiment", "sample_time_s", "command_delay_ticks",
              "counts_per_rev", "full_scale", "full_scale_unit", "supply_V", "host_version", "start_time",
              "tick_statistics", "plant", "run_id", "ending"}  # fmt: skip
    assert wanted <= set(log.metadata)
    assert (log.metadata["ending"], log.command_delay_ticks, log.counts_per_rev) == ("complete", 1, 720)
    assert list(log.columns) == ["time_s", "duty_pct", "c3", "c4", "pos", "direction", "ref_deg", "angle_deg"]


def test_the_command_of_a_row_acts_one_tick_after_its_encoder_reading() -> None:
    with connect("sim:ideal") as bench:
        log = bench.run(Experiment("kick", [Constant(level=100.0, duration_s=0.2)]))
    # 100 % accelerates the ideal plant at 10,200 deg/s^2, so the half count to the next edge takes 7 ms. Acting from
    # tick 1 on (5 ms), it is seen at tick 3; had it acted at once, at tick 2; a tick later, at tick 4.
    assert log.command_delay_ticks == 1
    assert int(np.argmax(log.output != log.output[0])) == 3


def test_the_controlled_angle_does_not_jump_at_0_and_360_degrees() -> None:
    across = Experiment(
        "across",
        reference=[Square(low=-40.0, high=40.0, period_s=2.0, duration_s=4.0)],
        control=ControlSettings(u_plus_pct=2.0, u_minus_pct=-2.0),
    )
    with connect("sim") as bench:
        log = bench.run(across)
    assert np.ptp(log.columns["pos"]) > 500  # the raw count does jump
    assert np.abs(np.diff(log.output)).max() < 10.0
    assert np.abs(log.output - log.columns["ref_deg"])[-50:].max() < 5.0


def test_the_shaft_follows_the_square_wave_of_the_lab() -> None:
    with connect("sim") as bench:
        log = bench.run(SQUARE)
    ref = log.columns["ref_deg"]
    settled = np.flatnonzero(np.diff(ref) != 0)
    assert np.abs(log.output[settled] - ref[settled]).max() < 4.0
    assert log.metadata["kp_pct_per_deg"] == "1"


def test_each_run_begins_at_rest_braked_with_its_own_time(tmp_path: Path) -> None:
    board = WatchedTransport()
    with bench_on(board) as bench:
        first = bench.drive(80.0, 0.5)
        second = bench.run(STAIRS)
    assert first.time_s[0] == second.time_s[0] == 0.0
    np.testing.assert_array_equal(second.output[:3], second.output[0])
    assert first.metadata["run_id"] == second.metadata["run_id"]
    assert first.begins_at_rest
    assert second.begins_at_rest


def test_a_shaft_that_no_brake_holds_is_said_to_move(tmp_path: Path) -> None:
    """A load beyond dry friction creeps on under brake: such a log does not begin at rest, and a fit must not take it
    for one, however few counts its first samples show.
    """
    plant = plant_file(tmp_path, {"coulomb_Nm": 0.005}, {"constant_load": {"torque_Nm": 0.012}})
    with connect(f"sim:{plant}") as bench:
        log = bench.drive(20.0, 1.0)
    assert log.begins_at_rest is False
    assert not record_from_log(log).at_rest


def test_the_time_of_the_bench_is_that_of_the_board_in_lock_step(tmp_path: Path) -> None:
    """What drifts or warms goes on between two runs, also while the bench watches the shaft come to rest."""
    board = WatchedTransport()
    with bench_on(board) as bench:
        bench.drive(80.0, 0.5)
        begun = []
        for _ in range(2):
            before = board.received
            log = bench.drive(-80.0, 0.5)
            begun.append((before * 0.005, float(log.metadata["bench_time_s"])))
    for left_s, begun_s in begun:
        assert left_s < begun_s <= left_s + 0.11  # 0.1 s of rest are waited for


def test_lock_step_gives_the_same_data_in_real_and_in_virtual_time() -> None:
    short = Experiment("short", [Pulses(levels=(60.0, -60.0), on_s=0.1, off_s=0.05, rest="standby", duration_s=0.3)])
    logs = []
    for realtime in (False, True):
        start = time.monotonic()
        with connect("sim", realtime=realtime) as bench:
            logs.append(bench.run(short))
        took = time.monotonic() - start
        assert took >= 0.3 or not realtime  # how long virtual time takes is the computer's affair
    for name in ("time_s", "duty_pct", "pos", "c3", "c4"):
        np.testing.assert_array_equal(logs[0].columns[name], logs[1].columns[name])
    assert "virtual" in logs[0].metadata["tick_statistics"]
    assert "lateness" in logs[1].metadata["tick_statistics"]
    assert "host_time_s" in logs[1].columns


def test_progress_is_told_at_its_interval() -> None:
    seen: list[Tick] = []
    with connect("sim") as bench:
        bench.run(STAIRS, progress=seen.append, progress_every_s=0.5)
    assert [round(t.time_s, 6) for t in seen] == [0.0, 0.5, 1.0, 1.5, 2.0, 2.5]


def test_in_virtual_time_nobody_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Real time must not be asked for: how fast it goes is then the computer's affair alone."""
    with connect("sim") as bench:
        bench.run(STAIRS)

        def asked(*arguments: object) -> None:
            raise AssertionError("the loop waits")

        for module, name in ((time, "sleep"), (select, "select")):
            monkeypatch.setattr(module, name, asked)
        log = bench.drive(40.0, 20.0)
        monkeypatch.undo()
    assert len(log) == 4000


@pytest.mark.parametrize(
    ("target", "reason"),
    [
        ("simm", "did you mean 'sim'"),
        ("sim:no_such_plant", "no_such_plant"),
        ("sim:no/such/file.toml", "no/such/file.toml"),
        ("hid:no-such-board", "no HID device no-such-board is connected"),
        ("serial:COM99", "there is no serial port COM99"),
        ("", "unknown target"),
    ],
)
def test_an_unknown_target_is_refused_in_one_sentence(target: str, reason: str) -> None:
    with pytest.raises((ConfigError, TransportError), match=reason):
        connect(target)


def test_an_experiment_for_another_sample_time_is_refused() -> None:
    slow = Experiment("slow", [Constant(level=10.0, duration_s=1.0)], sample_time_s=0.01)
    with connect("sim") as bench, pytest.raises(ConfigError, match="every 5 ms"):
        bench.run(slow)


def test_the_log_of_a_sealed_board_gives_nothing_away_and_can_be_unsealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    texts = []
    for i in range(2):
        with connect("sim:sealed", seed=987654321) as bench:
            path = tmp_path / f"sealed{i}.csv"
            bench.run(STAIRS, path)
        texts.append(path.read_text())
        assert find_seed(str(path)) == 987654321
    for text in texts:
        assert "987654321" not in text
        assert "plant" not in text
        assert "supply" not in text
    logs = [Log.parse(text) for text in texts]
    np.testing.assert_array_equal(logs[0].output, logs[1].output)
    same = {key for key in logs[0].metadata if logs[0].metadata[key] == logs[1].metadata[key]}
    assert "run_id" not in same  # nothing in the head is made from the seed
    with connect("sim:sealed") as bench:
        bench.run(STAIRS, tmp_path / "drawn.csv")
    assert find_seed(str(tmp_path / "drawn.csv")) >= 0


def test_a_seal_that_is_not_kept_here_is_said_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with connect("sim:sealed", seed=1) as bench:
        bench.run(STAIRS, tmp_path / "sealed.csv")
    with connect("sim") as bench:
        bench.run(STAIRS, tmp_path / "open.csv")
    with pytest.raises(ConfigError, match="not sealed"):
        find_seed(str(tmp_path / "open.csv"))
    with pytest.raises(ConfigError, match="neither a seed"):
        find_seed("no-such-log.csv")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "elsewhere"))
    with pytest.raises(ConfigError, match="not kept here"):
        find_seed(str(tmp_path / "sealed.csv"))
