"""What a search spares itself where it would change nothing, and what it asks for when nothing else is left."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from bench_data import measure, steps, suite, truth_model

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.evidence import State
from fiohost.discover.logs import non_smooth
from fiohost.discover.logs.evidence import Logs
from fiohost.discover.logs.job import Job
from fiohost.discover.logs.ladder import Ladder
from fiohost.discover.logs.optimise import fits_anew
from fiohost.discover.logs.plain_windows import PlainWindows
from fiohost.discover.logs.rough import rough_fits
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.discover.settings import SETTINGS
from fiohost.estimation.fit import Fit, fit, fit_from_scratch
from fiohost.estimation.record import Record
from fiohost.judging.settings import FLOOR
from fiohost.judging.stage import Stage
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.noise.runs import Pull, estimate_runs

DECLARED = Model.parse("linear+coulomb_friction")
# Of load over the angle, percent of duty at the second to the twelfth of twelve places on a turn: by its size no whole
# run keeps to the angle of one without it.
CURVE_PCT = (-0.24, 0.38, 2.14, 3.43, 2.74, 0.94, -0.54, -1.71, -2.71, -2.66, -1.41)


def drawn(stage: Stage) -> list[int]:
    """How many replicas judged each record."""
    return [len(f.draws) for f in stage.floors]


def test_replicas_are_drawn_until_they_can_say_no_more() -> None:
    records = suite(truth_model(("coulomb_friction", "transport_delay"), {"transport_delay.delay_s": 0.03}), 4)
    lacking, full = (
        fit_from_scratch(Model.parse(m), records)
        for m in ("linear+coulomb_friction", "linear+coulomb_friction+transport_delay")
    )
    runs = WholeRuns(records, np.random.default_rng(3))
    away, there = runs.settled(lacking), runs.settled(full)
    assert not runs.stage(away).follows
    assert drawn(runs.stage(away)) == [FLOOR.few] * 4
    assert runs.stage(there).at_floor
    assert drawn(runs.stage(there)) == [FLOOR.some] * 4


def test_every_structure_is_judged_by_the_same_draws() -> None:
    """Whatever was judged before it: else what is found would hang on the way that a search took."""
    records = suite(truth_model(), 4)
    fitted = fit_from_scratch(DECLARED, records)
    first, second = WholeRuns(records, np.random.default_rng(3)), WholeRuns(records, np.random.default_rng(3))
    second.stage(second.settled(fit_from_scratch(Model.parse("linear"), records)))
    one, other = first.stage(first.settled(fitted)), second.stage(second.settled(fitted))
    assert one.excesses == other.excesses
    assert one.scattered_models == other.scattered_models


def test_the_best_scores_are_enough_where_more_would_change_nothing() -> None:
    """Beside one at the floor of whole runs those that score about as much are asked too."""
    records = suite(truth_model(("coulomb_friction", "transport_delay"), {"transport_delay.delay_s": 0.008}), 4)
    names = ("transport_delay", "viscous_friction", "constant_load", "duty_curve", "supply_sag", "quadratic_drag")
    enough = SETTINGS.least_refitted

    def rough(logs: Logs, few: Sequence[str], rival: State | None = None, near: str = "") -> int:
        state = logs.declared(DECLARED, False)
        (screen,) = logs.screens(state)
        scores = {n: screen.score(effect(n)) for n in few}
        best = max(scores.values(), key=lambda score: score.share)
        scores |= {near: replace(scores[near], share=0.9 * best.share)} if near else {}
        jobs = [Job(score, state.fit, screen.records) for score in scores.values()]
        asked, fits = rough_fits(logs, jobs, logs.floor_rms(state), rival)
        assert len(asked) == len(fits)
        assert not near or near in [job.name for job in asked]
        return len(fits)

    runs, windows = WholeRuns(records), PlainWindows(records)
    assert rough(runs, names) == enough
    assert rough(runs, names, near=names[-1]) == enough + 1
    assert rough(runs, names[1:]) == len(names) - 1
    assert rough(WholeRuns(records[:2]), names) == len(names)
    full = runs.settled(fit_from_scratch(DECLARED.with_effect("transport_delay", {"delay_s": 0.008}), records))
    assert rough(runs, names, full) == enough
    assert rough(windows, names) == enough
    assert rough(windows, names[1:]) == len(names) - 1


def test_far_from_the_floor_a_threshold_is_searched_coarsely_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fine search took half a minute of a candidate beside which another effect was missing, and led nowhere."""
    truth = truth_model(
        ("coulomb_friction", "static_friction", "quadratic_drag"),
        {"static_friction.extra_pct": 3.0, "quadratic_drag.pct_at_1000_deg_s": 6.0},
    )
    asked: dict[str, list[float]] = {}

    def searched(found: Fit, key: str, records: Sequence[Record], scales: Sequence[tuple[float, float, int]]) -> Fit:
        asked.setdefault(key, []).extend(highest for _, highest, _ in scales)
        return found

    monkeypatch.setattr(non_smooth, "_searched", searched)
    for missing in (False, True):
        runs = WholeRuns(suite(truth, 5))
        state = runs.declared(DECLARED if missing else DECLARED.with_effect("quadratic_drag"), False)
        runs.beside(state).refitted([effect("static_friction")], lambda text: None)
        looks = asked.pop("static_friction.extra_pct")
        assert SETTINGS.optimiser.coarse[1] in looks
        assert (SETTINGS.optimiser.fine[1] in looks) is not missing


def test_long_runs_are_tried_at_their_beginnings_first() -> None:
    """What follows these is fitted to all; where the shaft wanders from all models there, nothing is."""
    rng = np.random.default_rng(6)
    names = ("quadratic_drag", "viscous_friction", "duty_curve")
    truth = truth_model(("quadratic_drag",), {"quadratic_drag.pct_at_1000_deg_s": 8.0})
    record = measure(truth, steps(400.0, rng), rng)
    wanders = np.cumsum(0.2 * rng.standard_normal(len(record)))

    def asked(record: Record) -> tuple[list[str], float, float]:
        """What is refitted, the error of the best over the floor, and to how many samples."""
        runs = WholeRuns([record])
        state = runs.declared(Model.parse("linear"), False)
        (screen,) = runs.screens(state)
        jobs = [Job(screen.score(effect(n)), state.fit, screen.records) for n in names]
        beside, floor = runs.beside(state), runs.floor_rms(state)
        assert sum(r.seconds for r in runs.beginnings) <= 1.25 * SETTINGS.most_windows
        left, fits = rough_fits(beside.logs, jobs, floor)
        return [job.name for job in left], min(f.rms for f in fits) / floor, max(f.samples for f in fits)

    left, above, samples = asked(record)
    assert (left, samples > 0.9 * len(record)) == (["quadratic_drag"], True)
    assert above < SETTINGS.lost
    _, above, samples = asked(replace(record, y=record.y + wanders))
    assert above > SETTINGS.lost
    assert samples < 0.5 * len(record)


@pytest.mark.long
def test_where_no_name_leads_whole_runs_there_a_curve_over_the_angle_does() -> None:
    values = {f"load_over_position.point_{i}_pct": 1.5 * x for i, x in enumerate(CURVE_PCT, 1)}
    records = suite(truth_model(("coulomb_friction", "load_over_position"), values), 11, 24.0)
    said: list[str] = []
    library = ["load_over_position", "stribeck_friction"]
    found = diagnose_records(records, (), DECLARED, library=library, say=said.append)
    assert [s.effect for s in found.steps] == ["load_over_position"], said
    assert found.verdict == "explained"
    asked = said.index("general curves over the angle beside them")
    assert said[asked + 1].startswith("scoring 1 effects"), said  # what windows said of the others stands
    assert not any("anew" in text or "noise" in text for text in said), said


@pytest.mark.parametrize("missing", ["quadratic_drag", "static_friction"])
def test_where_names_leave_counts_alone_no_curve_over_the_angle_is_asked_for(
    missing: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whole runs may err by the last digit of a model that windows are explained by; a curve took minutes to say so."""
    truth = truth_model().with_effect(missing)
    monkeypatch.setattr(Ladder, "_led", lambda self, seen, most=None: None)
    monkeypatch.setattr(Ladder, "_anew", lambda self: None)
    monkeypatch.setattr(Ladder, "_at_the_floor", lambda self, node: False)
    said: list[str] = []
    library = ["quadratic_drag", "load_over_position"]
    rng = np.random.default_rng(0)
    Ladder(suite(truth, 11), DECLARED, library, False, rng, said.append, (), (), 0.0)._by_plain_windows()
    asked = any(text.startswith("general curves") for text in said)
    assert asked is (missing not in library), said


def test_of_a_model_that_runs_away_it_is_not_known_how_runs_differ() -> None:
    """Its derivatives overflow where its error just does not; no eigenvalue of them is found."""
    rng = np.random.default_rng(1)
    columns = [rng.standard_normal((200, 3)) for _ in range(4)]
    offsets = (np.array([0.0, 0.0, x]) for x in (-3.0, -1.0, 1.0, 3.0))
    pulls = {str(i): Pull(by.T @ by, by.T @ (by @ x)) for i, (by, x) in enumerate(zip(columns, offsets, strict=True))}
    assert estimate_runs(pulls).known
    for away in (np.inf, np.nan):
        assert not estimate_runs(pulls | {"1": Pull(np.full((3, 3), away), np.full(3, away))}).known


def test_windows_begin_no_refit_far_away_but_it_may_begin_anew() -> None:
    windows = PlainWindows(suite(truth_model(), 4, 8.0))
    state = windows.declared(DECLARED, False)
    (screen,) = windows.screens(state)
    score = screen.score(effect("fast_decay"))
    assert (score.trials, score.far) == ((), effect("fast_decay").trials)
    assert windows.beside(state).refitted([effect("fast_decay")], lambda text: None) == []
    assert len(fits_anew(screen.fit, [score], screen.records, 1)) == 1


def test_where_windows_leave_but_counts_what_takes_little_of_them_leads_on() -> None:
    """There is no noise that might do for so little, and whole runs see it: one cog of 0.12 % takes 8 % of windows."""
    values = {
        "duty_steps.step_pct": 25.0,
        "duty_steps.share": 0.36,
        "duty_steps.rounding": "cut",
        "cogging_torque.order": 20.0,
        "cogging_torque.level_pct": 0.12,
        "cogging_torque.phase_deg": -30.0,
    }
    steps = ("coulomb_friction", "duty_steps")
    records = suite(truth_model((*steps, "cogging_torque"), values), 11, 24.0)
    models = [
        truth_model(names, {n: v for n, v in values.items() if n.split(".")[0] in names})
        for names in (steps, (*steps, "cogging_torque"))
    ]

    def immaterial(logs: Sequence[Record]) -> tuple[bool, float, str | None]:
        plain = PlainWindows(logs)
        one, both = (plain.settled(fit(m, plain.records, windows=True)) for m in models)
        return plain.reached(one.fit, 0.0), plain.taken(one, both), plain.immaterial(one, both)

    reached, taken, why = immaterial(records)
    assert reached
    assert 0.02 < taken < SETTINGS.least_of_rest
    assert why is None
    rng = np.random.default_rng(5)
    reached, taken, why = immaterial([replace(r, y=r.y + rng.normal(0.0, 0.5, len(r))) for r in records])
    assert not reached
    assert why is not None
    assert why.startswith("removes ")
