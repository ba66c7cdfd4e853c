"""What a command means on a bench is asked of the data, and no missing effect is taken for a wrong statement."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import short_runs
from bench_data import QUANTUM_DEG, measure, multisine, steps, truth_model

from fiohost.checks.asked import Question, shifted
from fiohost.checks.said import Said
from fiohost.checks.semantics import ask
from fiohost.circle.evidence import diagnose
from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.result import to_json
from fiohost.estimation.record import BRAKE, Record
from fiohost.motor.model import Model
from fiohost.motor.simulate import free_run
from fiohost.motor.state import STANDBY

DECLARED = Model.parse("linear+coulomb_friction")
STATED = Said(delay_ticks=1, bits=True)


def pulses(seconds: float, rng: np.random.Generator) -> np.ndarray:
    """Pulses of 0.6 s that end in zero duty, in percent."""
    levels = rng.uniform(30.0, 90.0, int(seconds / 1.5) + 1) * rng.choice((-1.0, 1.0), int(seconds / 1.5) + 1)
    return np.concatenate([np.repeat([u, 0.0], (120, 180)) for u in levels])[: round(seconds / 0.005)]


def logs(truth: Model, *, delay_ticks: int = 1, seconds: float = 10.0, seed: int = 1) -> list[Record]:
    """Records of a motor; all say that commands act after one tick and zero duty brakes."""
    rng = np.random.default_rng(seed)
    made = [measure(truth, s(seconds, rng), rng, delay_ticks=delay_ticks) for s in (multisine, steps, pulses)]
    return [replace(shifted(r, 1 - delay_ticks), name=f"log{i}") for i, r in enumerate(made)]


def asked(records: list[Record], model: Model = DECLARED, said: Said = STATED) -> Mapping[str, Question]:
    found = ask(records, [said] * len(records), model)
    assert found is not None
    return {q.name: q for q in found.questions}


def test_what_the_logs_say_is_confirmed_where_it_is_true() -> None:
    found = asked(logs(truth_model()))
    assert [q.verdict for q in found.values()] == ["as_said"] * 3
    assert found["command_delay"].best == "1"
    assert found["zero_duty"].window_rms["coast"] > 5.0 * found["zero_duty"].window_rms["brake"]


@pytest.mark.parametrize("delay_ticks", [0, 2, 3])
def test_a_wrong_delay_is_contradicted_with_the_right_one(delay_ticks: int) -> None:
    found = asked(logs(truth_model(), delay_ticks=delay_ticks))["command_delay"]
    # An electrical lag as long as a tick would do nearly as well for one tick more: longer logs make that sure.
    assert found.verdict == "contradicted" or (delay_ticks, found.verdict) == (2, "suspected")
    assert found.best == str(delay_ticks)
    assert found.estimate is not None
    assert found.estimate[0] == pytest.approx(delay_ticks, abs=0.03)
    assert "set command_delay_ticks" in found.sentence
    assert f" say {delay_ticks} " in found.sentence


def test_where_nobody_said_it_commands_may_have_acted_before_their_rows() -> None:
    """As where a program drives, waits, reads and then writes both. Nothing is missing then; what is said stands."""
    records = [shifted(r, -1) for r in logs(truth_model(), delay_ticks=-1)]
    said = ask(records, [Said(delay_ticks=0)] * len(records), DECLARED)
    silent = ask(records, [Said()] * len(records), DECLARED)
    assert said is not None
    assert silent is not None
    assert (said.earlier_ticks, silent.earlier_ticks) == (0, 1)
    assert ("that is taken" in said.questions[0].sentence, "that is taken" in silent.questions[0].sentence) == (
        False,
        True,
    )
    assert [q.verdict for q in silent.questions[1:]] == ["as_said"] * 2
    found = diagnose_records(records[:2], records[2:], DECLARED)
    assert (found.verdict, found.steps) == ("no_missing_effect", ())


@pytest.mark.parametrize(("delay_ticks", "earlier"), [(-1, 1), (0, 0)])
def test_commands_that_acted_before_their_rows_are_seen_beside_a_missing_effect(delay_ticks: int, earlier: int) -> None:
    truth = truth_model().with_effect("stribeck_friction", {"extra_pct": 1.0, "stribeck_speed_deg_s": 60.0})
    records = [shifted(r, -1) for r in logs(truth, delay_ticks=delay_ticks, seed=3)]
    found = ask(records, [Said()] * len(records), DECLARED)
    assert found is not None
    assert found.earlier_ticks == earlier


@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("transport_delay", {"delay_s": 0.003}),
        ("transport_delay", {"delay_s": 0.0048}),
        ("armature_inductance", {"time_constant_s": 0.002}),
        ("armature_inductance", {"time_constant_s": 0.005}),
        ("backlash", {"gap_deg": 3.0}),
        ("input_deadband", {"level_pct": 8.0}),
        ("gravity_load", {"level_pct": 3.0}),
        ("supply_sag", {"ratio": 0.15}),
        ("voltage_saturation", {"limit_pct": 50.0}),
        ("bridge_voltage_drop", {"drop_pct": 4.0}),
    ],
)
def test_a_missing_effect_is_no_wrong_statement(effect: str, values: Mapping[str, float]) -> None:
    found = asked(logs(truth_model().with_effect(effect, values), seed=2))
    assert [q.sentence for q in found.values() if q.warns] == []


def test_zero_duty_that_coasts_is_told_from_one_that_brakes() -> None:
    truth, rng = truth_model(), np.random.default_rng(3)
    records = []
    for record in logs(truth, seed=3):
        ex = record.excitation
        coasting = replace(ex, modes=np.where(ex.duties_pct == 0.0, STANDBY, ex.modes))
        angle = free_run(truth, coasting, rng.uniform(0.0, QUANTUM_DEG))
        records.append(replace(record, y=np.floor(angle / QUANTUM_DEG) * QUANTUM_DEG))
    assert all(np.all(r.excitation.modes[r.excitation.duties_pct == 0.0][1:] != STANDBY) for r in records)
    found = asked(records)["zero_duty"]
    assert (found.verdict, found.best) == ("contradicted", "coast")
    assert "C3 and C4" in found.sentence
    silent = asked(records, said=Said())["zero_duty"]
    assert silent.said.startswith("nothing")
    assert "log c3 and c4" in silent.sentence
    told = [
        replace(r, excitation=replace(r.excitation, modes=np.where(r.excitation.duties_pct == 0.0, STANDBY, BRAKE)))
        for r in records
    ]
    assert asked(told)["zero_duty"].verdict == "as_said"


def test_an_open_bridge_between_pulses_is_told_from_a_shorted_one() -> None:
    truth = truth_model().with_effect("fast_decay", {"electrical_tau_s": 0.001})
    records = logs(truth, seconds=6.0, seed=4)
    found = asked(records)["decay"]
    assert found.warns
    assert found.best == "fast"
    assert found.window_rms["fast"] < 0.2 * found.window_rms["slow"]


def test_logs_without_rests_say_nothing_about_zero_duty() -> None:
    rng = np.random.default_rng(5)
    found = asked([measure(truth_model(), multisine(10.0, rng), rng)])["zero_duty"]
    assert found.verdict == "not_asked"
    assert "cannot tell" in found.sentence


def test_a_diagnosis_of_a_board_says_before_any_dynamics_what_its_log_has_wrong(tmp_path: Path) -> None:
    (log,) = short_runs.logs_of("sim:ideal", tmp_path, [short_runs.random_steps(20.0)])
    text = log.path.read_text()
    assert "# command_delay_ticks: 1\n" in text
    lines = text.replace("# command_delay_ticks: 1\n", "# command_delay_ticks: 0\n").splitlines(keepends=True)
    wrong = tmp_path / "wrong.csv"
    wrong.write_text("".join(lines[:-500] + lines[-480:]))
    found = json.loads(json.dumps(to_json(diagnose([wrong], model=DECLARED, library=["transport_delay"]))))
    assert (found["semantics"]["command_delay"]["verdict"], found["semantics"]["command_delay"]["best"]) in (
        ("contradicted", "1"),
        ("suspected", "1"),
    )
    (gap,) = found["kinematics"]
    assert (gap["log"], gap["name"], gap["count"]) == ("wrong.csv", "missing_ticks", 1)
    assert found["data"]["reversals"] > 3
    assert found["data"]["cannot_show"]
    # It warned and changed nothing: the search still meets the tick as a delay.
    assert [s["effect"] for s in found["steps"]] == ["transport_delay"]
