"""The search on records made by the fit's own kernel: names, honesty, and the tools it is made of."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import QUANTUM_DEG, TRUTH, measure, multisine, steps, suite, truth_model

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.logs.folds import folds, slices
from fiohost.discover.result import to_json
from fiohost.errors import DataError
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.record import make_record
from fiohost.estimation.repeats import repeats
from fiohost.judging.metrics import judge
from fiohost.judging.missing_torque import missing_torque
from fiohost.motor.effect import Value
from fiohost.motor.model import Model
from fiohost.motor.simulate import free_run
from fiohost.noise.average import Average
from fiohost.report.preliminary import warnings
from fiohost.report.words import verdict_sentence

DECLARED = Model.parse("linear+coulomb_friction")


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "values"),
    [
        ("constant_load", {"constant_load.level_pct": -0.8}),
        ("gravity_load", {"gravity_load.level_pct": 2.5, "gravity_load.phase_deg": 130.0}),
        ("transport_delay", {"transport_delay.delay_s": 0.0062}),
        ("input_deadband", {"input_deadband.level_pct": 3.0}),
        ("voltage_saturation", {"voltage_saturation.limit_pct": 62.0}),
        ("backlash", {"backlash.gap_deg": 1.7, "backlash.load_inertia_ratio": 0.0}),
        ("backlash", {"backlash.gap_deg": 3.0, "backlash.side": "encoder_before_gap"}),
    ],
)
def test_a_missing_effect_is_named_and_measured(effect: str, values: dict[str, float | str]) -> None:
    truth = truth_model(("coulomb_friction", effect), values)
    rng = np.random.default_rng(77)
    held = [measure(truth, steps(8.0, rng), rng, name="held")]
    found = diagnose_records(suite(truth, 11, 8.0), held, DECLARED)
    assert [s.effect for s in found.steps] == [effect]
    assert found.verdict == "explained"
    final = found.final.fit.model
    for key, value in values.items():
        if isinstance(value, float) and "phase" not in key and value > 0.0:
            assert final.number(key) == pytest.approx(value, rel=0.05), key
        elif isinstance(value, str):
            assert final.values[key] == value
    before, after = found.before_holdout[0].errors, found.after_holdout[0].errors
    assert after.window_rms < 0.75 * before.window_rms
    assert after.window_rms < 1.1 * found.floor_holdout[0].errors.window_rms


def test_nothing_is_claimed_where_nothing_is_missing() -> None:
    for seed in range(5):
        found = diagnose_records(suite(truth_model(), 200 + seed), (), DECLARED)
        assert found.verdict == "no_missing_effect", seed
        ratio = np.sqrt(
            np.mean([j.errors.window_rms**2 for j in found.final.judgements])
            / np.mean([f.errors.window_rms**2 for f in found.final.floors])
        )
        assert 0.9 < ratio < 1.1


@pytest.mark.long
def test_an_effect_outside_the_library_is_not_explained_away() -> None:
    truth = truth_model(("coulomb_friction", "gravity_load"), {"gravity_load.level_pct": 4.0})
    library = ["input_deadband", "transport_delay", "voltage_saturation", "constant_load", "backlash"]
    found = diagnose_records(suite(truth, 12), (), DECLARED, library=library)
    assert found.verdict == "unexplained"
    left = to_json(found)["residual"]
    assert not left["white"]
    assert "angle" in left["depends_on"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("mistaken", "truth"),
    [
        # Both directions together look like two levels, until there is a load to tell them apart: then one will do.
        ("asymmetric_deadband", {"input_deadband.level_pct": 6.0, "constant_load.level_pct": 1.5}),
        # What pulls one way and turns with the angle looks like a gain of its own in each direction.
        (
            "direction_dependent_gain",
            {"constant_load.level_pct": 2.0, "gravity_load.level_pct": 3.0, "gravity_load.phase_deg": 60.0},
        ),
    ],
)
def test_an_effect_mistaken_for_a_part_of_another_gives_way_to_it(mistaken: str, truth: dict[str, Value]) -> None:
    names = list(dict.fromkeys(key.partition(".")[0] for key in truth))
    model = truth_model(("coulomb_friction", *names), truth)
    found = diagnose_records(suite(model, 5), (), DECLARED, library=[*names, mistaken])
    assert sorted(s.effect for s in found.steps) == sorted(names)
    assert found.verdict == "explained"
    for key, value in truth.items():
        assert found.final.fit.model.number(key) == pytest.approx(value, rel=0.02), key
    assert mistaken not in found.final.fit.model.effects


@pytest.mark.long
def test_what_is_peculiar_to_one_record_explains_only_where_it_leaves_nothing() -> None:
    """The strongest of constant commands ran on less supply: no limit of the voltage, while gravity is missing too."""
    rng = np.random.default_rng(6)
    gravity = {"gravity_load.level_pct": 1.0, "gravity_load.phase_deg": 20.0}
    truth = truth_model(("coulomb_friction", "gravity_load"), gravity)
    records = [measure(truth, np.full(800, duty), rng, name=f"at {duty:g} %") for duty in (10.0, 30.0, 50.0, 70.0)]
    weak = measure(truth, np.full(800, 88.0), rng, name="at 90 %")
    told = replace(weak.excitation, duties_pct=np.where(weak.excitation.duties_pct, 90.0, 0.0))
    records.append(replace(weak, excitation=told))
    alone = diagnose_records(records, (), DECLARED, library=["voltage_saturation", "supply_drift"])
    assert alone.verdict == "unexplained"
    both = diagnose_records(records, (), DECLARED, library=["voltage_saturation", "gravity_load"])
    assert {s.effect for s in both.steps} == {"gravity_load", "voltage_saturation"}
    assert both.verdict == "explained"


def test_held_out_records_change_nothing_but_the_report() -> None:
    truth = truth_model(("coulomb_friction", "constant_load"), {"constant_load.level_pct": 1.0})
    train = suite(truth, 13)
    rng = np.random.default_rng(14)
    # Held-out records of quite another motor: they may say what they like, the choice must not hear them.
    other = truth_model(("coulomb_friction", "gravity_load"), {"gravity_load.level_pct": 9.0})
    held = [measure(other, steps(6.0, rng), rng, name="other")]
    library = ["constant_load", "gravity_load", "input_deadband", "backlash", "transport_delay", "quadratic_drag"]
    alone, with_held = (diagnose_records(train, h, DECLARED, library=library) for h in ((), held))
    assert alone.final.fit.model == with_held.final.fit.model
    assert [c.score for c in alone.candidates] == [c.score for c in with_held.candidates]


def test_a_held_out_record_that_shows_more_than_all_training_records_is_pointed_out() -> None:
    truth = truth_model(("coulomb_friction", "voltage_saturation"), {"voltage_saturation.limit_pct": 70.0})
    rng = np.random.default_rng(31)
    train = [measure(truth, multisine(8.0, rng, 60.0), rng, name=f"gentle{i}") for i in range(3)]
    strong = measure(truth, np.repeat((30.0, 95.0, -20.0, -90.0), 400), rng, name="strong")
    held = [measure(truth, multisine(8.0, rng, 60.0), rng, name="also gentle"), strong]
    library = ["voltage_saturation", "constant_load"]
    told = to_json(diagnose_records(train, held, DECLARED, library=library))
    assert told["verdict"] == "no_missing_effect"
    assert {e["log"] for e in told["holdout_not_followed"]} == {"strong"}
    assert "does not follow what was held out" in verdict_sentence(told)
    assert [text.split(":")[0] for text in warnings(told)] == ["Strong"]
    among = to_json(diagnose_records([*train, strong], held[:1], DECLARED, library=library))
    assert [s["effect"] for s in among["steps"]] == ["voltage_saturation"]
    assert among["holdout_not_followed"] == []
    assert warnings(among) == []


def test_the_missing_torque_over_time_is_recovered_from_the_residual() -> None:
    rng = np.random.default_rng(15)
    truth = truth_model(("coulomb_friction", "gravity_load"), {"gravity_load.level_pct": 5.0})
    record = measure(truth, np.full(2000, 30.0), rng)
    declared = truth_model()
    found = judge(record, declared)
    torque = missing_torque(record, declared, found.free_residual)
    true = -5.0 * np.sin(np.radians(record.y))
    middle = slice(200, -200)
    # A load against the linear model: what friction and drive do not explain, within the smoother's band.
    assert np.corrcoef(torque[middle], true[middle])[0, 1] > 0.97
    assert np.std(torque[middle] - true[middle]) < 0.25 * np.std(true[middle])


def test_folds_leave_out_whole_experiments_and_keep_repeats_together() -> None:
    truth, rng = truth_model(), np.random.default_rng(16)
    same = multisine(8.0, rng)
    records = [measure(truth, same, rng, name=f"same{i}") for i in range(3)]
    records += [measure(truth, steps(8.0, rng), rng, name=f"step{i}") for i in range(2)]
    assert repeats(records) == [[0, 1, 2]]
    _, groups = folds(records)
    assert sorted(map(sorted, groups)) == [[0, 1, 2], [3], [4]]
    pieces, groups = folds(records[:1])
    assert len(pieces) == len(groups) == 2
    assert sum(len(p) for p in pieces) == len(records[0])


def test_a_log_too_short_to_be_cut_is_refused_in_a_sentence() -> None:
    rng = np.random.default_rng(5)
    enough = measure(truth_model(), steps(0.3, rng), rng, name="short")
    pieces, _ = folds([enough])
    assert [len(piece) for piece in pieces] == [30, 30]
    with pytest.raises(DataError, match=r"short: 59 samples are too few to be cut"):
        folds([measure(truth_model(), steps(0.295, rng), rng, name="short")])
    # Many seconds, few samples: no more pieces than have enough of them.
    slow = make_record("slow", np.arange(90) * 0.2, np.repeat((10.0, 20.0, 15.0), 30), np.arange(90) * 2.0)
    assert len(folds([slow])[0]) == 2


def test_a_piece_of_a_record_goes_on_where_the_one_before_ended() -> None:
    truth, rng = truth_model(), np.random.default_rng(17)
    record = measure(truth, steps(10.0, rng), rng)
    for piece in slices(record, 4):
        assert judge(piece, truth).errors.window_rms < 0.17


def test_a_piece_of_a_record_knows_what_is_known_of_its_sensor() -> None:
    rng = np.random.default_rng(17)
    record = replace(measure(truth_model(), steps(10.0, rng), rng), noise_rms=0.3, quantum_found=True, regular=True)
    record = replace(record, average=Average(0.8, 18.0))
    for piece in folds([record])[0]:
        assert (piece.noise_rms, piece.quantum_found, piece.regular) == (0.3, True, True)
        assert piece.average == Average(0.8, 18.0)


def test_a_record_is_cut_where_its_command_has_long_been_the_same() -> None:
    truth, rng = truth_model(), np.random.default_rng(24)
    record = measure(truth, np.repeat((12.0, -12.0, 25.0, -25.0), 1000), rng)
    # Even edges would be the reversals themselves.
    assert [len(piece) for piece in slices(record, 4)] == [750, 1000, 1000, 1250]
    alone = diagnose_records([record], (), DECLARED, library=["armature_inductance", "supply_drift"])
    assert alone.verdict == "no_missing_effect"
    assert alone.final.fit.model.number("linear.tau_s") == pytest.approx(TRUTH["linear.tau_s"], rel=0.01)


def test_records_of_different_things_are_not_mixed() -> None:
    truth, rng = truth_model(), np.random.default_rng(18)
    record = measure(truth, steps(4.0, rng), rng)
    from dataclasses import replace

    with pytest.raises(DataError, match="different"):
        diagnose_records([record, replace(record, unit="m")], (), DECLARED)


def test_the_json_holds_what_the_schema_promises() -> None:
    truth = truth_model(("coulomb_friction", "constant_load"), {"constant_load.level_pct": 1.0})
    found = to_json(diagnose_records(suite(truth, 19, 6.0), suite(truth, 20, 6.0)[:1], DECLARED))
    assert found["schema"] == "fiohost.diagnosis/1"
    assert set(found) >= {
        "fiohost_version", "seconds", "output_unit", "declared", "verdict", "before", "steps", "after", "final",
        "floor", "logs", "candidates", "residual", "next_experiment",
    }  # fmt: skip
    step = found["steps"][0]
    assert step["effect"] == "constant_load"
    assert "asymmetric_coulomb_friction" in step["indistinguishable_from"]
    low, high = step["parameters"]["level_pct"]["ci95"]
    assert low < 1.0 < high
    assert {log["role"] for log in found["logs"]} == {"train", "holdout"}
    for block in (found["before"], found["after"], found["floor"]):
        assert set(block["holdout"]) == {"free_run_rms", "window_rms", "bin_violation_pct", "fit_pct", "samples"}


def test_a_fit_on_everything_is_the_same_whatever_the_order_of_the_records() -> None:
    truth = truth_model()
    records = suite(truth, 21, 6.0)
    one = fit_from_scratch(DECLARED, records).model
    two = fit_from_scratch(DECLARED, records[::-1]).model
    for key in one.values:
        assert one.number(key) == pytest.approx(two.number(key), rel=1e-4)


def test_standstill_pulls_no_model_to_the_middle_of_a_count() -> None:
    """Of shafts that rest most of the time least squares that take every reading at rest for one know much less."""
    truth = truth_model()
    rng = np.random.default_rng(3)
    names = ("linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct")
    errors = []
    for _ in range(8):
        levels, width = rng.uniform(15.0, 60.0, 8) * np.tile((1.0, -1.0), 4), int(rng.integers(15, 60))
        duty = np.concatenate([np.concatenate((np.full(width, level), np.zeros(400))) for level in levels])
        record = measure(truth, duty, rng)
        assert np.mean(record.weights < 1.0) > 0.8
        found = [fit(truth, [r]).model for r in (record, replace(record, weights=np.ones(len(record))))]
        errors.append([[model.number(n) / truth.number(n) - 1.0 for n in names] for model in found])
    weighted, plain = np.sqrt(np.mean(np.square(errors), axis=0))
    assert np.all(weighted < 0.6 * plain)
    assert weighted[0] < 1e-3


def test_a_start_that_soon_rests_is_found_within_its_count() -> None:
    """A model off by a little in its last digits must not move the angle to where the resting reading is the mean."""
    truth = truth_model()
    rng = np.random.default_rng(8)
    off = truth.with_values({"linear.gain_deg_s_per_pct": 10.6 * 1.001})
    errors = []
    for _ in range(12):
        record = measure(truth, np.concatenate((np.full(30, 40.0), np.zeros(370))), rng)
        angle = judge(record, off).start.angle
        low = np.max(record.y - free_run(truth, record.excitation, 0.0))
        high = np.min(record.y + record.quantum - free_run(truth, record.excitation, 0.0))
        errors.append(angle + 0.5 * record.quantum - 0.5 * (low + high))
    assert np.abs(errors).max() < 0.2 * 0.5


@pytest.mark.long
def test_an_end_of_travel_is_believed_though_one_record_only_met_it() -> None:
    """Readings show it by themselves, beside friction that changes around the turn and leaves something."""
    values = {"hard_stop.angle_deg": 900.0, "position_dependent_friction.ratio": 0.4}
    there = truth_model(("coulomb_friction", "hard_stop", "position_dependent_friction"), values)
    rng = np.random.default_rng(8)
    away = [
        measure(there, duty(12.0, rng), rng, name=f"away {i}") for i, duty in enumerate((multisine, steps, multisine))
    ]
    assert max(float(r.y.max()) for r in away) < 890.0
    met = measure(there, np.concatenate((np.full(800, 40.0), np.full(800, -30.0), steps(4.0, rng))), rng, name="met")
    assert float(met.y.max()) == pytest.approx(900.0, abs=1.0)
    assert judge(met, there).errors.window_rms < QUANTUM_DEG / 3.0  # no window begins beyond the end
    library = ["hard_stop", "position_dependent_friction", "constant_load", "supply_sag"]
    found = diagnose_records([*away, met], (), Model.parse("linear+coulomb_friction"), library=library)
    assert {s.effect for s in found.steps} == {"hard_stop", "position_dependent_friction"}
    assert found.verdict == "explained"
