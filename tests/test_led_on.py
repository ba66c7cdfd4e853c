"""How one effect leads to the next: by windows, by an event, from a ledge; and what is not asked twice."""

from __future__ import annotations

from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from bench_data import measure, steps, suite, truth_model

from fiohost.discover.diagnose import diagnose_records
from fiohost.discover.evidence import State
from fiohost.discover.logs import finals, whole_runs
from fiohost.discover.logs.evidence import Logs
from fiohost.discover.logs.ladder import Ladder
from fiohost.discover.logs.local_minima import polish
from fiohost.discover.logs.moments import unconfirmed_moment
from fiohost.discover.logs.one_clock import in_sequence
from fiohost.discover.logs.optimise import carried_on
from fiohost.discover.logs.plain_windows import PlainWindows
from fiohost.discover.logs.rough import rough_fits
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.discover.nodes import Node
from fiohost.discover.search import Search
from fiohost.estimation.fit import Fit, fit, fit_from_scratch, unchanged
from fiohost.estimation.record import Record
from fiohost.judging.stage import Stage
from fiohost.motor.effect import effects
from fiohost.motor.model import Model


@pytest.mark.long
def test_what_whole_runs_cannot_follow_is_found_in_windows() -> None:
    values = {
        "asymmetric_coulomb_friction.forward_pct": 5.0,
        "asymmetric_coulomb_friction.reverse_pct": 3.5,
        "friction_warm_up.ratio": 0.6,
        "friction_warm_up.time_constant_s": 15.0,
        "friction_warm_up.follows": "time",
    }
    records = suite(truth_model(("asymmetric_coulomb_friction", "friction_warm_up"), values), 11, 10.0)
    said: list[str] = []
    library = ["constant_load", "friction_warm_up"]  # a load is the mean of a friction that differs by direction
    found = diagnose_records(records, (), Model.parse("linear+coulomb_friction"), library=library, say=said.append)
    assert any("windows of 1 s" in text for text in said), said
    assert {s.effect for s in found.steps} == set(library), said
    assert found.verdict == "explained"


@pytest.mark.long
def test_two_effects_of_which_neither_brings_whole_runs_near_are_led_to_by_windows_as_they_are() -> None:
    """Weighed by the noise that each candidate leaves, which here is what it lacks, that took three times as long."""
    values = {"gravity_load.level_pct": 6.0, "gravity_load.phase_deg": 40.0, "pwm_dead_time.time_us": 3.0}
    truth = truth_model(("coulomb_friction", "gravity_load", "pwm_dead_time"), values)
    said: list[str] = []
    library = ["pwm_dead_time", "gravity_load", "cogging_torque", "constant_load", "stribeck_friction"]
    found = diagnose_records(
        suite(truth, 11, 15.0), (), Model.parse("linear+coulomb_friction"), library=library, say=said.append
    )
    assert ({s.effect for s in found.steps}, found.verdict) == ({"gravity_load", "pwm_dead_time"}, "explained"), said
    far = [i for i, text in enumerate(said) if text == "whole runs are far from the floor with every effect"]
    assert said[far[0] + 1] == "whole runs stay unexplained: windows of 1 s", said
    assert not any("noise" in text or "anew" in text for text in said), said


@pytest.mark.long
def test_of_two_effects_windows_may_show_but_one_and_whole_runs_the_other() -> None:
    values = {
        "quadratic_drag.pct_at_1000_deg_s": 2.5,
        "asymmetric_deadband.u_plus_pct": 0.02,
        "asymmetric_deadband.u_minus_pct": -0.1,
    }
    truth = truth_model(("coulomb_friction", "quadratic_drag", "asymmetric_deadband"), values)
    said: list[str] = []
    library = ["quadratic_drag", "asymmetric_deadband", "load_over_position", "cogging_torque", "stribeck_friction"]
    found = diagnose_records(
        suite(truth, 11, 15.0), (), Model.parse("linear+coulomb_friction"), library=library, say=said.append
    )
    assert {s.effect for s in found.steps} == {"quadratic_drag", "asymmetric_deadband"}, said
    assert any("windows of 1 s" in text for text in said), said
    assert not any("noise" in text or "curves" in text for text in said), said


@pytest.mark.long
def test_an_event_beside_another_effect_leads_whole_runs_to_it() -> None:
    values = {"sublinear_viscous_friction.pct_at_1000_deg_s": 0.8, "sublinear_viscous_friction.knee_deg_s": 70.0}
    names, rng = ("coulomb_friction", "sublinear_viscous_friction"), np.random.default_rng(13)
    before = truth_model(names, {**values, "linear.gain_deg_s_per_pct": 6.9})
    grows = {"which": "gain", "ratio": 1.5}
    changing, after = (before.with_effect("parameter_change", {"time_s": t, **grows}) for t in (5.0, 0.0))
    logs = in_sequence([measure(m, steps(12.0, rng), rng) for m in (before, before, changing, after)])
    said: list[str] = []
    library = ["parameter_change", "sublinear_viscous_friction", "gain_warm_up", "voltage_saturation", "gravity_load"]
    found = diagnose_records(logs, (), Model.parse("linear+coulomb_friction"), library=library, say=said.append)
    assert [s.effect for s in found.steps] == ["parameter_change", "sublinear_viscous_friction"], said
    assert found.final.fit.model.number("parameter_change.time_s") == pytest.approx(29.0, abs=0.02)
    assert found.verdict == "explained"
    assert not any("windows of 1 s" in text for text in said), said


def test_what_is_asked_for_again_is_not_fitted_again_beside_itself(monkeypatch: pytest.MonkeyPatch) -> None:
    """It was carried to its minimum, and a gap is searched for long."""
    values = {"gravity_load.level_pct": 6.0, "gravity_load.phase_deg": 40.0, "pwm_dead_time.time_us": 3.0}
    records = suite(truth_model(("coulomb_friction", "gravity_load", "pwm_dead_time"), values), 11, 8.0)
    model = Model.parse("linear+coulomb_friction+pwm_dead_time")
    runs = WholeRuns(records)
    without = runs.settled(fit_from_scratch(model, records))
    full = model.with_effect("gravity_load", {"level_pct": 5.0, "phase_deg": 30.0})
    rival = runs.settled(fit(full.with_values(dict(without.fit.model.values)), records))
    fitted: list[str] = []

    def counted(rough: Fit, logs: Sequence[Record]) -> Fit:
        fitted.append(rough.model.effects[-1])
        return carried_on(rough, logs)

    monkeypatch.setattr(finals, "carried_on", counted)
    offered = [effects()[n] for n in ("gravity_load", "cogging_torque", "position_dependent_friction")]
    beside = runs.beside(without)
    alone = dict((e.name, s) for e, s in beside.refitted(offered, lambda text: None))
    assert "gravity_load" in fitted
    assert alone["gravity_load"].fit.rms == pytest.approx(rival.fit.rms, rel=0.05)
    fitted.clear()
    jobs, floor = beside.worth(), runs.floor_rms(without)
    again = beside.finals.carried(*rough_fits(beside.logs, jobs, floor), floor, rival)
    assert again["gravity_load"][1] is rival
    assert "gravity_load" not in fitted


@pytest.mark.long
def test_an_effect_that_led_near_another_gives_its_place_to_it() -> None:
    """A winding in which current ceases slowly begins too far off from gain and friction as they seem without it."""
    values = {"linear.gain_deg_s_per_pct": 13.7, "linear.tau_s": 0.1, "coulomb_friction.level_pct": 5.0}
    truth = truth_model(("coulomb_friction", "fast_decay"), {**values, "fast_decay.electrical_tau_s": 0.0007})
    said: list[str] = []
    library = ["fast_decay", "coast_pwm", "transport_delay"]
    found = diagnose_records(
        suite(truth, 3, 8.0), (), Model.parse("linear+coulomb_friction"), library=library, say=said.append
    )
    assert ([s.effect for s in found.steps], found.verdict) == (["fast_decay"], "explained"), said
    assert "adding coast_pwm" in said


@pytest.mark.long
def test_what_was_added_is_got_off_its_ledge_before_more_is(monkeypatch: pytest.MonkeyPatch) -> None:
    """Far from it where there are few experiments; where there are more, ledges are near."""
    begun: dict[str, list[tuple[str, ...]]] = {"unstuck": [], "polish": []}
    for name, found in begun.items():

        def recorded(
            fitted: Fit,
            records: Sequence[Record],
            rng: np.random.Generator,
            found: list[tuple[str, ...]] = found,
        ) -> Fit:
            found.append(fitted.model.effects)
            return fitted

        monkeypatch.setattr(whole_runs, name, recorded)
    values = {"constant_load.level_pct": 2.5, "quadratic_drag.pct_at_1000_deg_s": 1.0}
    records = suite(truth_model(("coulomb_friction", "constant_load", "quadratic_drag"), values), 3)
    added = ("coulomb_friction", "constant_load")
    for some, name, other in ((records, "polish", "unstuck"), (records[:2], "unstuck", "polish")):
        begun["unstuck"].clear()
        begun["polish"].clear()
        diagnose_records(some, (), Model.parse("linear+coulomb_friction"), library=["constant_load"])
        assert added in begun[name]
        assert added not in begun[other]


@pytest.mark.parametrize(
    ("off", "at_floor", "follows", "asked"),
    [
        (1.0, True, True, []),
        (1.0, False, True, ["polish"]),
        (1.001, True, True, ["unstuck"]),
        (1.001, False, False, ["polish"]),
    ],
)
def test_what_follows_the_data_is_got_off_its_ledge_where_more_than_counts_is_left(
    off: float, at_floor: bool, follows: bool, asked: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Friction that sticks makes replicas err by more than counts: one wrong by a seventh followed the data."""
    called: list[str] = []
    for name in ("polish", "unstuck"):

        def recorded(found: Fit, records: Sequence[Record], rng: np.random.Generator, name: str = name) -> Fit:
            called.append(name)
            return found

        monkeypatch.setattr(whole_runs, name, recorded)
    records = suite(truth_model(), 3)
    runs, truth = WholeRuns(records), fit(truth_model(), records)
    gain = off * truth.model.number("linear.gain_deg_s_per_pct")
    state = runs.settled(unchanged(truth.model.with_values({"linear.gain_deg_s_per_pct": gain}), records))
    stage = SimpleNamespace(at_floor=at_floor, follows=follows, windows_above_floor=0.0)
    monkeypatch.setattr(WholeRuns, "stage", lambda runs, state: stage)
    runs.finished(state)
    assert called == asked


@pytest.mark.parametrize("windows", [False, True])
@pytest.mark.parametrize("noise", [False, True])
def test_what_comes_to_the_floor_and_leaves_no_noise_is_told_without_asking_for_one(
    noise: bool, windows: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load that holds a shaft on a slope, a tenth of a count elsewhere, took minutes and ended in other names; a
    bridge that coasts, its duty in coarse steps, took a quarter of an hour where windows had named both.
    """
    truth = truth_model(("coulomb_friction", "quadratic_drag"), {"quadratic_drag.pct_at_1000_deg_s": 20.0})
    asked_for_noise, run = SimpleNamespace(), Search.run

    def led_by_windows(search: Search[Stage], root: Node, most: int | None = None) -> Node:
        return root if isinstance(search.evidence, WholeRuns) else run(search, root, most)

    monkeypatch.setattr(Search, "explains", lambda self, node: False)
    if windows:
        monkeypatch.setattr(Search, "run", led_by_windows)
    else:
        monkeypatch.setattr(Ladder, "_by_plain_windows", lambda self: None)
    monkeypatch.setattr(Ladder, "_by_weighed_windows", lambda self: asked_for_noise)
    monkeypatch.setattr(Ladder, "_noise_alone", lambda self, node: noise)
    model, rng = Model.parse("linear+coulomb_friction"), np.random.default_rng(0)
    ladder = Ladder(suite(truth, 11, 12.0), model, ["quadratic_drag"], False, rng, lambda text: None, (), (), 0.0)
    found = ladder.climbed()
    assert (found is asked_for_noise) is noise
    assert noise or [s.effect for s in found.steps] == ["quadratic_drag"]


def test_what_was_polished_in_vain_is_neither_judged_nor_polished_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A better last digit was another state: it was held against bootstrap samples of its own, and polished anew."""
    records = suite(truth_model(), 3)
    runs, looked = WholeRuns(records), list[Fit]()

    def recorded(found: Fit, records: Sequence[Record], rng: np.random.Generator) -> Fit:
        looked.append(found)
        return polish(found, records, rng)

    monkeypatch.setattr(whole_runs, "polish", recorded)
    monkeypatch.setattr(WholeRuns, "_nothing_to_gain", lambda self, state: False)
    state = runs.settled(fit(truth_model(), records))
    assert runs.polished(state) is state
    assert runs.finished(state) is state
    assert len(looked) == 1


@pytest.mark.long
@pytest.mark.parametrize("evidence", [PlainWindows, WeighedWindows, WholeRuns])
def test_the_moment_of_an_event_is_looked_for_again_beside_what_was_added_since(evidence: type[Logs]) -> None:
    """Beside a dead time that was missing it was 4 s late, and stayed there: both names were right, and given up."""
    values: dict[str, float | str] = {
        "parameter_change.time_s": 4.3, "parameter_change.which": "gain", "parameter_change.ratio": 0.88,
        "constant_load.level_pct": 2.0,
    }  # fmt: skip
    truth = truth_model(("coulomb_friction", "parameter_change", "constant_load"), values)
    logs = evidence(suite(truth, 11))
    late = truth.with_values({"parameter_change.time_s": 8.6})
    state = logs.settled(fit(late, logs.records, windows=not logs.exact, max_iterations=12))
    assert abs(state.fit.model.number("parameter_change.time_s") - 4.3) > 1.0
    found = logs.finished(state).fit.model
    assert found.number("parameter_change.time_s") == pytest.approx(4.3, abs=0.1)
    assert found.effects == truth.effects


@pytest.mark.parametrize("evidence", [PlainWindows, WeighedWindows, WholeRuns])
def test_a_choice_is_made_again_beside_what_was_added_since(evidence: type[Logs]) -> None:
    """A supply that sags was held by no capacitor while a friction was missing: both together explained nothing, and
    whole runs were searched for 80 s more.
    """
    sags = {"supply_sag.ratio": 0.2, "supply_sag.smoothing": "capacitor"}
    truth = truth_model(("coulomb_friction", "supply_sag", "constant_load"), {**sags, "constant_load.level_pct": 2.0})
    logs = evidence(suite(truth, 11))
    other = truth.with_values({"supply_sag.smoothing": "none"})
    state = logs.settled(fit(other, logs.records, windows=not logs.exact))
    assert logs.finished(state).fit.model.values["supply_sag.smoothing"] == "capacitor"


@pytest.mark.parametrize(("moment", "believed"), [(11.5, False), (0.5, False), (6.0, True)])
def test_an_event_needs_logs_on_both_sides_of_its_moment(moment: float, believed: bool) -> None:
    """What a log's last rows left was blamed on a change there: all logs after it were then wrong thirty times over."""
    values: dict[str, float | str] = {
        "parameter_change.time_s": moment, "parameter_change.which": "gain", "parameter_change.ratio": 0.88,
    }  # fmt: skip
    truth = truth_model(("coulomb_friction", "parameter_change"), values)
    runs = WholeRuns(suite(truth, 11)[:2])
    state = runs.settled(fit(truth, runs.records, max_iterations=1))
    assert (runs.degenerate(state, ["parameter_change"]) is None) is believed
    assert (unconfirmed_moment(state.fit, effects()["parameter_change"], runs.records) is None) is believed


@pytest.mark.parametrize(("follows", "near", "asked"), [(False, True, 1), (False, False, 0), (True, True, 0)])
def test_what_windows_lead_near_the_counts_is_got_off_its_ledge_before_they_are_asked_on(
    follows: bool, near: bool, asked: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Static friction that windows named stood a twentieth off its level in whole runs: all else was asked for then,
    under noise too, and took 129 s in the place of 29.
    """
    called: list[State] = []

    def recorded(runs: WholeRuns, state: State) -> State:
        called.append(state)
        return state

    monkeypatch.setattr(Search, "explains", lambda self, node: follows)
    monkeypatch.setattr(WholeRuns, "near_counts", lambda self, state: near)
    monkeypatch.setattr(WholeRuns, "finished", recorded)
    records, model = suite(truth_model(), 11), Model.parse("linear+coulomb_friction")
    ladder = Ladder(records, model, [], False, np.random.default_rng(0), lambda text: None, (), (), 0.0)
    called.clear()
    assert ladder._enough(ladder.root) is follows
    assert len(called) == asked
