"""After a diagnosis: the experiment that tells rivals apart, how small an effect shows, what nothing explains."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from bench_data import measure, multisine, steps, suite, truth_model
from click.testing import CliRunner
from report_case import diagnosis
from rich.console import Console
from short_runs import SUITE, logs_of, one_effect_plant, plant_file, random_steps, staircase

from fiohost.advice.empirical import Empirical, empirical_term
from fiohost.advice.limit import Limit
from fiohost.advice.limits import detection_limits
from fiohost.advice.next_experiment import SEPARATES, Duel, separations
from fiohost.advice.outlook import look_ahead
from fiohost.bench.connect import connect
from fiohost.bench.experiment import Experiment
from fiohost.circle import close
from fiohost.circle.evidence import diagnose
from fiohost.circle.menu import MENU, menu, offer
from fiohost.cli.main import cli
from fiohost.discover.diagnose import Diagnosis, diagnose_records
from fiohost.discover.result import to_json
from fiohost.errors import DataError
from fiohost.estimation.fit import fit, fit_from_scratch
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, record_from_log
from fiohost.judging.metrics import judge
from fiohost.judging.stage import judged
from fiohost.motor.model import Model
from fiohost.report.circle import follow_up_sentence
from fiohost.report.page import render
from fiohost.report.tables import print_diagnosis

DECLARED = Model.parse("linear+coulomb_friction")
FLOOR = (0.1443, 0.1435)
STALL_NM_PER_PCT = 0.34 * 9.0 / 5.5 / 100.0  # of the plant that ``plant_file`` makes


def looked_at(records: Sequence[Record], library: Sequence[str]) -> Diagnosis:
    return look_ahead(diagnose_records(records, (), DECLARED, library=library), menu(), library=library)


# ---- the next experiment -------------------------------------------------------------------------------------------


def test_the_menu_is_of_open_loop_experiments_that_run() -> None:
    assert len(MENU) >= 12
    assert not any(Experiment.load(name).closed_loop for name in MENU)
    pulses = offer(Experiment.load("pulses"))
    assert set(np.unique(pulses.modes)) == {0, 1, 2}, "drive, brake and standby"
    assert np.all(pulses.duty_pct[pulses.modes != 1] == 0.0)


def test_the_difference_that_is_promised_is_the_one_that_comes() -> None:
    """A winding's lag and a dead time are near each other; a fast multisine leaves them near, pulses do not."""
    truth = truth_model(("coulomb_friction", "armature_inductance"), {"armature_inductance.time_constant_s": 0.003})
    records = suite(truth, 3)
    winner = fit(truth, records)
    rival = fit(
        Model.parse("linear+coulomb_friction+transport_delay").with_values(dict(records_start(winner.model))), records
    )
    duel = Duel(winner.model, {"transport_delay": rival}, records, FLOOR)
    found = {s.experiment: s for s in separations(duel, menu())}
    best = max(found.values(), key=lambda s: s.least)
    assert best.least > SEPARATES
    dullest = min(found.values(), key=lambda s: s.least)
    assert dullest.least < 0.2
    for name in (best.experiment, dullest.experiment):
        record, start = duel.record(next(o for o in menu() if o.name == name))
        y = np.floor(free_output(record, Flat.of(truth), start._replace(angle=start.angle + 0.2)) / 0.5) * 0.5
        run = replace(record, y=y)
        again = judge(run, fit(rival.model, [*records, run]).model).errors
        over = max(again.free_run_rms / FLOOR[0], again.window_rms / FLOOR[1])
        assert over == pytest.approx(np.hypot(1.0, found[name].least), rel=0.3), name


def records_start(model: Model) -> dict[str, float]:
    return {k: model.number(k) for k in ("linear.gain_deg_s_per_pct", "linear.tau_s", "coulomb_friction.level_pct")}


@pytest.mark.long
@pytest.mark.parametrize(
    ("effect", "values"), [("transport_delay", {"delay_s": 0.0012}), ("armature_inductance", {"inductance_H": 0.008})]
)
def test_close_loop_runs_what_tells_rivals_apart_and_then_names_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, effect: str, values: dict[str, float | str]
) -> None:
    lags = ["transport_delay", "armature_inductance"]
    monkeypatch.setattr(close, "diagnose", partial(diagnose, library=lags))
    plant = plant_file(tmp_path, None, {effect: values})
    few = [random_steps(seed=5), random_steps(seed=6)]
    with connect(f"sim:{plant}", seed=1) as bench:
        circle = close.close_loop(bench, tmp_path, experiments=few)
    followed = circle.follow_up
    assert followed is not None
    assert sorted(close.named(followed.first)[0]) == sorted(lags)
    assert close.named(circle.diagnosis) == [[effect]]
    assert [log.path.name for log in circle.logs][-1] == f"{followed.experiment}_next.csv"
    assert [r.name for r in circle.diagnosis.train][-1] == f"{followed.experiment}_next.csv"
    assert not circle.diagnosis.holdout
    told = circle.to_json(to_json(circle.diagnosis), None)["follow_up"]
    assert told["experiment"] == to_json(followed.first)["next_experiment"]["experiment"]
    assert told["named_after"] == [[effect]]
    assert told["first_diagnosis"]["schema"] == "fiohost.diagnosis/1"
    assert "2 names became 1" in follow_up_sentence(told)


def test_a_follow_up_can_be_declined(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[bool] = []

    def heard(*_: object, follow_up: bool, **__: object) -> None:
        asked.append(follow_up)
        raise DataError("stopped here")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(close, "close_loop", heard)
    for more in ([], ["--no-follow-up"]):
        assert CliRunner().invoke(cli, ["close-loop", "--target", "sim:ideal", *more]).exit_code == 1
    assert asked == [True, False]


def test_exact_equivalents_call_for_no_experiment() -> None:
    truth = truth_model(("coulomb_friction", "constant_load"), {"constant_load.level_pct": 1.0})
    rng = np.random.default_rng(1)
    slow = measure(truth, 12.0 * np.sin(np.arange(4000) * 0.005 * 2.0), rng, name="slow")
    found = looked_at([*suite(truth, 13), slow], ["constant_load", "quadratic_drag"])
    assert found.steps[0].indistinguishable_from == ("asymmetric_coulomb_friction",)
    told = to_json(found)
    assert told["separation"] is None
    upcoming = found.outlook.next_experiment
    assert upcoming is None or not upcoming.rivals


def test_what_the_logs_do_not_show_is_asked_for() -> None:
    rng = np.random.default_rng(4)
    one_way = [measure(truth_model(), np.abs(steps(10.0, rng)) + 10.0, rng, name=f"r{i}") for i in range(2)]
    upcoming = looked_at(one_way, ["quadratic_drag"]).outlook.next_experiment
    assert upcoming is not None
    assert upcoming.experiment == "staircase"
    assert "both directions" in upcoming.why


# ---- detection limits ----------------------------------------------------------------------------------------------


def of(limits: Sequence[Limit], effect: str) -> Limit:
    return next(x for x in limits if x.effect == effect)


SEEN = {
    "transport_delay": lambda v, at: {"delay_s": v},
    "input_deadband": lambda v, at: {"level_pct": v},
    "gravity_load": lambda v, at: {"torque_Nm": v * STALL_NM_PER_PCT, "phase_deg": at["phase_deg"]},
    "static_friction": lambda v, at: {"extra_Nm": v * STALL_NM_PER_PCT},
    "encoder_eccentricity": lambda v, at: {"level_deg": v, "order": at["order"], "phase_deg": at["phase_deg"]},
}


@pytest.mark.long
def test_effects_on_a_board_are_seen_above_their_limit_and_not_below(tmp_path: Path) -> None:
    """At half the limit and at twice: one of ten verdicts may be wrong, the counts being what they are."""
    clean = tmp_path / "clean"
    clean.mkdir()
    library = list(SEEN)
    records = [record_from_log(log) for log in logs_of(f"sim:{plant_file(clean)}", clean, SUITE[:3], seed=4)]
    stage = judged(fit_from_scratch(DECLARED, records), records, records, np.random.default_rng(1))
    assert stage.at_floor
    limits = detection_limits(stage, records, library)
    assert {x.effect for x in limits} == set(library)
    wrong = []
    for effect, values in SEEN.items():
        limit = of(limits, effect)
        assert limit.value is not None
        for factor, seen in ((0.5, False), (2.0, True)):
            folder = tmp_path / f"{effect}_{factor}"
            folder.mkdir()
            plant = plant_file(folder, None, {effect: values(factor * limit.value, limit.at)})
            records = [record_from_log(log) for log in logs_of(f"sim:{plant}", folder, SUITE[:3], seed=4)]
            verdict = judged(fit_from_scratch(DECLARED, records), records, records, np.random.default_rng(1)).at_floor
            if verdict == seen:
                wrong.append(f"{effect} at {factor:g} times its limit")
    assert len(wrong) <= 1, "; ".join(wrong)


def test_what_never_comes_into_play_has_its_limit_where_it_would() -> None:
    rng = np.random.default_rng(8)
    gentle = [measure(truth_model(), 0.45 * steps(10.0, rng), rng, name=f"r{i}") for i in range(3)]
    top = max(float(np.max(np.abs(r.excitation.duties_pct))) for r in gentle)
    found = diagnose_records(gentle, (), DECLARED, library=["constant_load"])
    limits = detection_limits(found.final, gentle, ["voltage_saturation", "constant_load", "fast_decay"])
    saturation = of(limits, "voltage_saturation").value
    assert saturation is not None
    assert 0.8 * top < saturation < top
    load = of(limits, "constant_load")
    assert load.value is not None
    assert 0.0 < load.value < 0.05
    assert of(limits, "fast_decay").value is None
    assert "cases" in str(of(limits, "fast_decay").reason)


def test_what_one_way_logs_hide_at_any_size_has_no_limit() -> None:
    """Sizes grow to their bounds, and not by a rounding beyond."""
    forward = np.repeat((20.0, 40.0, 30.0), 600)
    records = [measure(truth_model(), forward, np.random.default_rng(1))]
    found = diagnose_records(records, (), DECLARED, library=["constant_load"])
    limits = detection_limits(found.final, records, ["direction_dependent_gain", "duty_curve"])
    assert of(limits, "direction_dependent_gain").value is None
    assert of(limits, "duty_curve").value is not None


# ---- what nothing explains -----------------------------------------------------------------------------------------


def described(records: Sequence[Record]) -> Empirical | None:
    rng = np.random.default_rng(0)
    return empirical_term(judged(fit_from_scratch(DECLARED, records), records, records, rng), records, rng)


@pytest.mark.parametrize(
    ("effect", "values", "variable", "parity"),
    [
        ("position_dependent_friction", {"ratio": 0.4}, "angle", "odd"),
        ("quadratic_drag", {"pct_at_1000_deg_s": 6.0}, "speed", "odd"),
        ("constant_load", {"level_pct": 2.0}, "speed_sign", "even"),
    ],
)
def test_a_torque_that_no_candidate_explains_is_described(
    effect: str, values: dict[str, float], variable: str, parity: str
) -> None:
    truth = truth_model(("coulomb_friction", effect), {f"{effect}.{k}": v for k, v in values.items()})
    term = described(suite(truth, 3))
    assert term is not None
    assert (term.variable, term.parity, term.kind) == (variable, parity, "torque")
    assert term.by_chance < term.share_of_power <= 1.0
    assert term.over_floor > 2.0


@pytest.mark.long
def test_the_curve_is_the_missing_torque_and_names_nothing() -> None:
    truth = truth_model(
        ("coulomb_friction", "gravity_load"), {"gravity_load.level_pct": 2.5, "gravity_load.phase_deg": 130.0}
    )
    found = looked_at(suite(truth, 3), ["transport_delay"])
    assert found.verdict == "unexplained"
    assert not found.steps
    told = to_json(found)
    term = told["residual"]["empirical"]
    assert (term["variable"], term["parity"], term["kind"], term["unit"]) == ("angle", "even", "torque", "%")
    curve = np.array(term["curve"])
    true = -2.5 * np.sin(np.radians(curve[:, 0] + 130.0))
    assert np.corrcoef(curve[:, 1], true)[0, 1] > 0.9
    assert told["next_experiment"]["experiment"] in MENU


def test_an_error_of_the_encoder_is_not_taken_for_a_torque() -> None:
    records = [
        replace(r, y=np.floor((r.y + 0.25 + 1.0 * np.sin(np.radians(r.y))) / 0.5) * 0.5)
        for r in suite(truth_model(), 3)
    ]
    term = described(records)
    assert term is not None
    assert (term.variable, term.kind, term.parity, term.unit) == ("angle", "measurement", "even", "deg")
    np.testing.assert_allclose(term.curve[:, 1], np.sin(np.radians(term.curve[:, 0])), atol=0.25)


def test_nothing_is_described_where_nothing_is_left() -> None:
    found = looked_at([measure(truth_model(), multisine(8.0, np.random.default_rng(2)), np.random.default_rng(3))], [])
    assert found.verdict == "no_missing_effect"
    assert to_json(found)["residual"]["empirical"] is None


# ---- in text and on the page ---------------------------------------------------------------------------------------


def test_limits_are_told_on_request_whatever_was_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    few = partial(diagnose, library=["backlash", "gravity_load"])
    monkeypatch.setattr("fiohost.circle.evidence.diagnose", few)
    logs = logs_of(f"sim:{one_effect_plant(tmp_path, 'backlash', 0)}", tmp_path, [staircase(), random_steps(seed=5)])
    out = tmp_path / "f.json"
    arguments = ["diagnose", *(str(log.path) for log in logs), "--model", "linear+coulomb_friction", "--json", str(out)]
    asked = CliRunner().invoke(cli, [*arguments, "--limits"])
    assert asked.exit_code == 0, asked.output
    limits = json.loads(out.read_text())["detection_limits"]
    assert {x["effect"] for x in limits} == {"gravity_load"}
    assert limits[0]["smallest_visible"] > 0.0
    assert re.search(r"^gravity load \(phase deg .*level_pct +0\.0", asked.stdout, re.MULTILINE)


def test_text_and_page_say_what_to_run_what_would_show_and_what_is_left(capsys: pytest.CaptureFixture[str]) -> None:
    told = diagnosis()
    over = {"backlash": 3.0, "transport_delay": 0.4}
    told["next_experiment"] = {"why": "there they part", "experiment": "reversals"}
    told["separation"] = {
        "rivals": list(over), "why": "there they part", "separates_from": 1.5,
        "experiments": [{"experiment": "reversals", "seconds": 36.0, "over_floor": over}],
    }  # fmt: skip
    limit = {"effect": "duty_curve", "parameter": "exponent", "unit": "", "neutral": 1.0, "at": {}, "reason": None}
    told["detection_limits"] = [
        {**limit, "smallest_visible": 1.004},
        {**limit, "effect": "hard_stop", "smallest_visible": None, "reason": "no way to see it"},
    ]
    told["residual"]["empirical"] = {
        "variable": "angle", "parity": "odd", "kind": "torque", "share_of_power": 0.62, "by_chance": 0.2,
        "residual_over_floor": 3.4, "unit": "%", "curve": [],
    }  # fmt: skip
    print_diagnosis(Console(width=400), told)
    text, page = capsys.readouterr().out, render(title="t", diagnosis=told)
    for said in (
        "fiohost run reversals", "There they part.", "0.0040 above 1.00", "no size: no way to see it",
        "not a named effect", "62 % of what remains", "3.40 times the floor", "turning round with the direction",
    ):  # fmt: skip
        assert said in text, said
        assert said in page, said
    assert "What each experiment would tell apart" in page
    told["next_experiment"] = None
    assert "fiohost run" not in render(title="t", diagnosis=told)
    assert "There they part." in render(title="t", diagnosis=told)
