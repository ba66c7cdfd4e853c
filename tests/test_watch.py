"""A motor that changes while it runs is told from one that drifts as all do; a log is followed as it grows."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bench_data import TRUTH, measure, steps
from click.testing import CliRunner

from fiohost.bench.writer import LogWriter
from fiohost.cli.main import cli
from fiohost.errors import DataError
from fiohost.estimation.record import Record
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise, Ranged
from fiohost.noise.runs import varied
from fiohost.watch.detector import Detector, Event
from fiohost.watch.evidence import piece
from fiohost.watch.follow import GrowingLog, following
from fiohost.watch.learn import Learned, learn
from fiohost.watch.replicas import drifting_run, walk
from fiohost.watch.settings import WatchSettings

QUICK = WatchSettings(replica_windows=150)
NOISE = Noise(Ranged(0.05, 0.0, 0.0), Ranged(0.2, 0.0, 0.0), Ranged(0.2, 0.0, 0.0))
MOTOR = Model(("coulomb_friction",), {**TRUTH, "coulomb_friction.level_pct": 3.0})
TICKS_A_SECOND, LEARN_S, ONSET_S = 200, 25, 60


def run_of(seconds: int, seed: int, changed: dict[str, float] | None = None, added: str = "") -> Record:
    """A run of a motor that drifts, and from ONSET_S on is another."""
    rng = np.random.default_rng(seed)
    record = measure(MOTOR, steps(seconds, rng), rng)
    models = [varied(MOTOR, own) for own in walk(seconds, (0.01, 0.06, 0.25), rng)]
    for i in range(ONSET_S, len(models)):
        if added:
            models[i] = models[i].with_effect(added, changed)
        elif changed:
            models[i] = models[i].with_values({k: models[i].number(k) * f for k, f in changed.items()})
    return replace(record, y=drifting_run(record, models, Start(0.0, 0.0), NOISE, rng))


@pytest.fixture(scope="module")
def learned() -> Learned:
    return learn(piece(run_of(LEARN_S, 1), 0, LEARN_S * TICKS_A_SECOND), MOTOR, QUICK)


def events_of(learned: Learned, record: Record) -> tuple[list[Event], Detector]:
    detector, found = learned.detector(QUICK), []
    for window in learned.evidence(record):
        found += detector.push(window)
    return found, detector


def test_a_motor_that_drifts_in_gain_friction_and_load_is_normal(learned: Learned) -> None:
    found, detector = events_of(learned, run_of(150, 2))
    assert not found
    assert detector.at.any()  # the drift was followed


@pytest.mark.parametrize(
    ("changed", "added", "effect", "what"),
    [
        ({"coulomb_friction.level_pct": 2.5}, "", "parameter_change", "friction"),
        ({"linear.gain_deg_s_per_pct": 0.88}, "", "parameter_change", "gain"),
        ({"linear.tau_s": 1.3}, "", "parameter_change", "inertia"),
        ({"gap_deg": 2.0}, "backlash", "backlash", ""),
        ({"level_pct": 4.0, "phase_deg": 30.0}, "gravity_load", "gravity_load", ""),
    ],
)
def test_what_changes_is_told_within_seconds_and_named(
    learned: Learned, changed: dict[str, float], added: str, effect: str, what: str
) -> None:
    found, _ = events_of(learned, run_of(85, 3, changed, added))
    alarm, named = found[0], found[1]
    assert alarm.kind == "alarm"
    assert named.kind == "named"
    assert ONSET_S < alarm.time_s <= ONSET_S + 12.0
    assert abs(named.since_s - ONSET_S) <= 3.0
    assert (named.causes[0].effect, named.causes[0].what) == (effect, what)
    assert alarm.false_alarms_per_day < 1e-2


def test_an_alarm_is_over_when_the_motor_is_as_it_was(learned: Learned) -> None:
    record, rng = run_of(120, 4), np.random.default_rng(5)
    loaded = MOTOR.with_effect("gravity_load", {"level_pct": 4.0, "phase_deg": 70.0})
    models = [loaded if 50 <= i < 75 else MOTOR for i in range(120)]
    found, _ = events_of(learned, replace(record, y=drifting_run(record, models, Start(0.0, 0.0), NOISE, rng)))
    kinds = [e.kind for e in found]
    assert kinds[:2] == ["alarm", "named"]
    assert "over" in kinds
    assert next(e for e in found if e.kind == "over").time_s > 75.0
    assert found[1].causes[0].effect == "gravity_load"
    assert found[1].causes[0].size == pytest.approx(4.0, rel=0.2)


def test_what_is_normal_is_found_far_from_the_model() -> None:
    """A motor with less gain and more friction than its model says, whose first steps lead to a load instead."""
    stands = varied(MOTOR, np.array([-0.11, 0.1, 0.0]))
    record, rng = run_of(LEARN_S, 27), np.random.default_rng(27)
    run = replace(record, y=drifting_run(record, [stands], Start(0.0, 0.0), NOISE, rng))
    model = learn(run, MOTOR, QUICK).model
    assert model.number("linear.gain_deg_s_per_pct") == pytest.approx(
        stands.number("linear.gain_deg_s_per_pct"), rel=0.01
    )
    assert model.number("coulomb_friction.level_pct") == pytest.approx(3.3, rel=0.05)
    assert abs(model.number("constant_load.level_pct")) < 1.0


def test_what_the_learned_stretch_hardly_showed_takes_more_to_alarm(learned: Learned) -> None:
    """A lag that gets longer is as sure as what was learned of it; were nothing known of that, it would not count."""
    windows = learned.evidence(run_of(40, 6, {"linear.tau_s": 1.3}))
    known, unknown = learned.detector(QUICK), learned.detector(QUICK)
    unknown.normal = replace(learned.normal, unsure=1e6 * learned.normal.unsure)
    known.normal = replace(learned.normal, unsure=0.0 * learned.normal.unsure)
    for detector in (known, unknown):
        for window in windows:
            detector.follow(window)
    sure, unsure = known.looks().squares, unknown.looks().squares
    assert np.all(unsure <= sure)
    assert unsure[:, 3].max() < 1e-2 * sure[:, 3].max()


def test_too_short_a_stretch_teaches_nothing() -> None:
    with pytest.raises(DataError, match="too few to learn from"):
        learn(run_of(5, 1), MOTOR, QUICK)


def _write(path: Path, record: Record) -> LogWriter:
    writer = LogWriter(path, {"sample_time_s": "0.005", "counts_per_rev": "720", "command_delay_ticks": "1"})
    for t, u, y in zip(record.excitation.times_s, record.excitation.duties_pct[1:], record.y, strict=True):
        writer.row(float(t), float(u), int(u >= 0.0), int(u < 0.0), round(y * 2.0) % 720, 0)
    return writer


def test_a_growing_log_is_followed_to_its_end(tmp_path: Path) -> None:
    path, record = tmp_path / "run.csv", run_of(3, 6)
    with LogWriter(path, {"sample_time_s": "0.005"}) as writer:
        growing = GrowingLog(path)
        seen = []

        def more(_: float) -> None:
            if len(seen) < 3:
                writer.row(0.005 * len(seen), 10.0, 1, 0, len(seen), 0)
            else:
                writer.close()

        for rows in following(growing, idle_s=100.0, now=lambda: 0.0, wait=more):
            seen += rows
    assert growing.ended
    assert [time_s for time_s, _ in seen] == pytest.approx([0.0, 0.005, 0.01])
    assert len(growing.log([line for _, line in seen])) == 3
    assert record.seconds > 2.0


def test_a_half_written_row_waits_for_its_rest(tmp_path: Path) -> None:
    path = tmp_path / "run.csv"
    path.write_text("# schema: fiohost.log/1\ntime_s,duty_pct,angle_deg\n0,1,2\n0.1,1,")
    growing = GrowingLog(path)
    assert len(growing.lines()) == 1
    with path.open("a") as more:
        more.write("3\n")
    assert growing.lines() == [(0.1, "0.1,1,3")]


def test_the_command_names_the_change_in_a_log_that_another_writes(tmp_path: Path) -> None:
    path, model = tmp_path / "run.csv", tmp_path / "motor.toml"
    MOTOR.write(model)
    writer = _write(path, run_of(90, 3, {"linear.tau_s": 1.3}))
    closing = threading.Timer(1.0, writer.close)
    closing.start()
    done = CliRunner().invoke(cli, ["watch", str(path), "--model", str(model), "--learn", "25", "--json",
                                    str(tmp_path / "r.json")])  # fmt: skip
    closing.join()
    assert done.exit_code == 0, done.output
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["schema"] == "fiohost.watch/1"
    assert result["ended"] == "the log ended"
    alarm, named = result["events"][:2]
    assert alarm["kind"] == "alarm"
    assert ONSET_S <= alarm["time_s"] <= ONSET_S + 12.0
    assert (named["causes"][0]["effect"], named["causes"][0]["what"]) == ("parameter_change", "inertia")
    assert "ALARM" in done.output


def test_a_log_that_ends_while_learning_is_refused(tmp_path: Path) -> None:
    _write(tmp_path / "run.csv", run_of(5, 8)).close()
    done = CliRunner().invoke(cli, ["watch", str(tmp_path / "run.csv")])
    assert done.exit_code == 1
    assert "too few to learn from" in done.output


def test_a_log_and_a_target_are_one_too_many() -> None:
    assert CliRunner().invoke(cli, ["watch", "run.csv", "--target", "sim"]).exit_code == 2
