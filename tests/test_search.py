"""The search by itself, over evidence that is a table of deviances: what it adds, asks for again and drops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import pytest

from fiohost.discover.belief import Belief
from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.evidence import Evidence, State
from fiohost.discover.nodes import Added, Child, Node
from fiohost.discover.null import Decided, Null
from fiohost.discover.score import Gain
from fiohost.discover.search import Search
from fiohost.estimation.fit import Fit
from fiohost.motor.effect import Effect, effects
from fiohost.motor.model import Model

FIRST, OTHER = "coulomb_friction", "constant_load"
THIRD, FOURTH, EVENT = "transport_delay", "gravity_load", "parameter_change"
SAMPLES = 100.0
# By what is in a model, and whether its fit begins where the other effect was beside: the first stops half-way alone.
LEFT = {
    ((), False): 1000.0,
    ((FIRST,), False): 500.0,
    ((OTHER,), False): 900.0,
    ((FIRST, OTHER), False): 0.0,
    ((FIRST,), True): 0.0,
    ((OTHER,), True): 900.0,
    ((THIRD,), False): 1000.0,
    ((FIRST, THIRD), False): 500.0,
    ((OTHER, THIRD), True): 900.0,
    ((OTHER, THIRD), False): 200.0,
}


@dataclass(frozen=True, eq=False)
class Stage:
    fit: Fit
    floor_rms: float = 1.0
    left_pct: float = 100.0

    @property
    def follows(self) -> bool:
        return self.fit.cost <= SAMPLES


def state(names: Sequence[str], beside: bool = False) -> State:
    deviance = LEFT[tuple(n for n in (FIRST, OTHER, THIRD, FOURTH, EVENT) if n in names), beside]
    fit = Fit(Model(tuple(names)), tuple(names), SAMPLES + deviance, (), (), (), (), True, SAMPLES)
    return State(fit, deviance)


class Table(Evidence[Stage]):
    """``unsure`` is the standard error of what left-out data gain; no name is believed where all are ``doubted``."""

    unsure, doubted = 1.0, False

    def __init__(self) -> None:
        super().__init__()
        self.carried: list[tuple[str, ...]] = []

    def finished(self, state: State) -> State:
        self.carried.append(state.fit.names)
        return state

    def judge(self, state: State) -> Stage:
        return Stage(state.fit)

    def declared(self, model: Model, from_file: bool) -> State:
        return state(())

    def beside(self, state: State) -> Beside:
        return Beside(state)

    def without(self, state_: State, name: str) -> State:
        return state([n for n in state_.fit.names if n != name], beside=True)

    def as_good(self, state: State, best: State) -> bool:
        return state.deviance <= best.deviance

    def gain(self, before: State, after: State) -> Gain:
        return Gain(before.deviance - after.deviance, self.unsure, 1.0)

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        return "its size is not distinct from none" if self.doubted else None

    def white(self, state: State) -> bool:
        return True


class Beside:
    def __init__(self, state: State) -> None:
        self.names = state.fit.names

    def offered(self, library: Sequence[str] | None) -> tuple[list[Effect], list[Candidate]]:
        return [effects()[n] for n in library or () if n not in self.names], []

    def refitted(
        self, offered: Sequence[Effect], say: Progress, *, rival: State | None = None
    ) -> list[tuple[Effect, State]]:
        return [(effect, state([*self.names, effect.name])) for effect in offered]

    def passed_over(self) -> list[Candidate]:
        return []

    def null(self, best: State, decided: Decided = lambda null: False) -> Null:
        return Null(5.0, {}, ())


def test_an_effect_that_only_led_to_a_better_fit_of_another_is_not_named() -> None:
    """Alone the first stops half-way, beside the other it does not, and from there the other is not needed."""
    search = Search(Table(), (FIRST, OTHER), lambda text: None)
    assert search.run(search.declared(Model(()), False)).names == {FIRST}


def test_a_name_that_vanishes_beside_the_next_one_was_mistaken_for_it_and_goes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beside the third the first is not distinct from none: that is no objection to the third."""
    left = {(): 1e4, (FIRST,): 5000.0, (THIRD,): 6000.0, (FIRST, THIRD): 150.0}
    for have, deviance in left.items():
        for beside in (False, True):
            monkeypatch.setitem(LEFT, (have, beside), deviance)
    monkeypatch.setitem(LEFT, ((THIRD,), True), 200.0)

    def gone(self: Table, state: State, name: str) -> bool:
        return name == FIRST and THIRD in state.fit.names

    def doubted(self: Table, state: State, names: Sequence[str]) -> str | None:
        return "the first vanishes" if FIRST in names and THIRD in state.fit.names else None

    monkeypatch.setattr(Table, "vanishes", gone)
    monkeypatch.setattr(Table, "degenerate", doubted)
    search = Search(Table(), (FIRST, THIRD), lambda text: None)
    found = search.run(search.declared(Model(()), False))
    assert (set(found.names), found.state.deviance) == ({THIRD}, 200.0)


def test_what_takes_the_place_of_another_is_asked_what_it_lacks(monkeypatch: pytest.MonkeyPatch) -> None:
    """The first hides that the third is missing; beside those that are left when it has gone the fourth is seen."""

    class Left(dict[tuple[tuple[str, ...], bool], float]):
        def __missing__(self, key: tuple[tuple[str, ...], bool]) -> float:
            names = set(key[0])
            if FIRST in names:
                return 2000.0 if OTHER in names else 3000.0
            if names >= {OTHER, THIRD}:
                return 300.0 if FOURTH in names else 1000.0
            return 5000.0 - 1800.0 * (FOURTH in names) - 900.0 * (OTHER in names) - 500.0 * (THIRD in names)

    monkeypatch.setattr("test_search.LEFT", Left())
    monkeypatch.setattr(Table, "exact", False)
    search = Search(Table(), (FIRST, OTHER, THIRD, FOURTH), lambda text: None)
    assert search.run(search.declared(Model(()), False)).names == {OTHER, THIRD, FOURTH}


def test_a_null_of_few_samples_decides_where_no_candidate_gains_about_what_it_has_to(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """One gains 500 and the other 100, of which 1.5 times a level is asked, give or take a factor of two."""
    told: list[bool] = []

    def null(self: Beside, best: State, decided: Decided) -> Null:
        told.extend(decided(Null(level, {}, ())) for level in (5.0, 40.0, 100.0, 250.0, 600.0, 1000.0))
        return Null(5.0, {}, ())

    monkeypatch.setattr(Beside, "null", null)
    search = Search(Table(), (FIRST, OTHER), lambda text: None)
    next(search.expand(search.declared(Model(()), False)))
    assert told == [True, False, False, False, False, True]


@pytest.mark.parametrize(("asked_for", "found"), [(FIRST, {FIRST}), (OTHER, set())])
def test_beside_noise_the_friction_of_every_drive_is_asked_for_less_than_other_effects(
    asked_for: str, found: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ten runs one way at constant powers show dry friction by twice what chance reaches, and it halves their error."""
    monkeypatch.setitem(LEFT, ((asked_for,), False), 800.0)
    monkeypatch.setattr(Beside, "null", lambda *args: Null(100.0, {}, ()))
    monkeypatch.setattr(Table, "margin", 2.25)
    table = Table()
    table.exact = False
    search = Search(table, (asked_for,), lambda text: None)
    assert search.run(search.declared(Model(()), False)).names == found


def test_a_third_effect_is_asked_for_beside_the_best_two_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    left = {(): 1e4, (FIRST,): 5000.0, (OTHER,): 5200.0, (THIRD,): 9000.0}
    left |= {(FIRST, OTHER): 2500.0, (FIRST, THIRD): 2000.0, (OTHER, THIRD): 1500.0, (FIRST, OTHER, THIRD): 500.0}
    for have, deviance in left.items():
        for beside in (False, True):
            monkeypatch.setitem(LEFT, (have, beside), deviance)
    asked: list[set[str]] = []

    def offered(self: Beside, library: Sequence[str] | None) -> tuple[list[Effect], list[Candidate]]:
        asked.append(set(self.names))
        return [effects()[n] for n in library or () if n not in self.names], []

    monkeypatch.setattr(Beside, "offered", offered)
    search = Search(Table(), (FIRST, OTHER, THIRD), lambda text: None)
    assert search.run(search.declared(Model(()), False), most=3).names == {FIRST, OTHER, THIRD}
    assert asked == [set(), {FIRST}, {OTHER}, {OTHER, THIRD}]


def test_a_search_ends_where_no_structure_can_explain_the_data() -> None:
    asked: list[frozenset[str]] = []

    def in_vain(node: Node) -> bool:
        asked.append(node.names)
        return bool(node.added)

    search = Search(Table(), (FIRST, OTHER), lambda text: None, in_vain=in_vain)
    found = search.run(search.declared(Model(()), False))
    assert (set(found.names), found.state.deviance) == ({FIRST}, 500.0)
    assert asked == [frozenset(), {FIRST}]


def test_a_search_ends_with_as_many_effects_as_it_was_asked_for() -> None:
    search = Search(Table(), [FIRST, OTHER], lambda text: None)
    root = Node(state(()))
    assert len(search.run(root, most=1).added) == 1
    assert not search.explains(search.run(root, most=1))
    assert search.explains(search.run(root))


@pytest.mark.parametrize(("unsure", "white"), [(1.0, False), (1000.0, True)])
def test_what_no_name_is_given_to_is_missing_where_left_out_data_gain_by_it(unsure: float, white: bool) -> None:
    table = Table()
    table.unsure, table.doubted, table.exact = unsure, True, False
    search = Search(table, (FIRST, OTHER), lambda text: None)
    found = search.run(search.declared(Model(()), False))
    assert not found.names
    assert search.white(found) is white


def test_where_one_explains_the_data_no_other_is_asked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """To get a fit off its ledge, or to see that there is none, takes longer than all that was asked before."""
    monkeypatch.setitem(LEFT, ((FIRST,), True), 500.0)
    table = Table()
    search = Search(table, (FIRST, OTHER, THIRD), lambda text: None)
    found = search.run(search.declared(Model(()), False))
    assert found.names == {FIRST, OTHER}
    assert table.carried[-1] == (OTHER, FIRST)
    assert (OTHER, THIRD) not in table.carried


@pytest.mark.parametrize(("left", "names"), [(300.0, {EVENT, OTHER}), (30000.0, frozenset())])
def test_an_event_leads_to_what_is_missing_beside_it_where_it_comes_near(
    left: float, names: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No other record can confirm it; where whole runs are followed at last, they do."""
    for have, deviance in (((), 1e5), ((OTHER,), 1e5), ((EVENT,), left), ((OTHER, EVENT), 0.0)):
        monkeypatch.setitem(LEFT, (have, False), deviance)
    for have in ((OTHER,), (EVENT,)):
        monkeypatch.setitem(LEFT, (have, True), 1e5)
    search = Search(Table(), (OTHER, EVENT), lambda text: None)
    found = search.run(search.declared(Model(()), False))
    assert found.names == names
    assert search.explains(found) is bool(names)


def test_what_was_asked_beside_a_structure_is_asked_again_only_where_that_does_better_now() -> None:
    table = Table()
    search = Search(table, (FIRST, OTHER), lambda text: None)
    root = Node(state(()))
    first = search.run(root, most=1)
    asked = len(table.carried)
    assert search.run(root, most=1) is search.run(Node(state(())), most=1) is first
    assert len(table.carried) == asked
    better = State(root.state.fit, root.state.deviance - 100.0)
    assert search.run(Node(better), most=1) is not first
    assert len(table.carried) > asked


def test_where_no_candidate_comes_near_more_may_be_asked_for_later(monkeypatch: pytest.MonkeyPatch) -> None:
    search = Search(Table(), (FIRST, OTHER), lambda text: None)
    root = Node(state(()))
    with monkeypatch.context() as patched:
        patched.setattr(Beside, "refitted", lambda *given, **more: [])
        assert search.run(root) is root
    assert search.run(root) is root
    search.forget_far()
    assert search.run(root).names == {FIRST}


@pytest.mark.parametrize(
    ("least", "alone", "names"),
    [(0.1, 310.0, {OTHER}), (0.01, 310.0, {FIRST, OTHER}), (0.7, 850.0, {FIRST, OTHER}), (0.7, 450.0, {OTHER})],
)
def test_beside_noise_a_name_stays_where_it_is_believed_beside_those_found_later(
    least: float, alone: float, names: set[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A load took half of what a friction by direction leaves; beside that it takes 3 % of what windows leave. The one
    that gains most beside the others need not take as much: nor need a first one.
    """
    left = {((FIRST,), False): 500.0, ((OTHER,), False): 900.0, ((FIRST, OTHER), False): 300.0}
    for have, deviance in (left | {((FIRST,), True): 500.0, ((OTHER,), True): alone}).items():
        monkeypatch.setitem(LEFT, have, deviance)

    def immaterial(self: Table, before: State, after: State) -> str | None:
        beside_the_first = FIRST in before.fit.names
        return "removes too little" if not beside_the_first and 1.0 - after.deviance / before.deviance < least else None

    monkeypatch.setattr(Table, "immaterial", immaterial)
    table = Table()
    table.exact = False
    search = Search(table, (FIRST, OTHER), lambda text: None)
    assert search.run(search.declared(Model(()), False)).names == names


@pytest.mark.parametrize("plainly", [False, True])
def test_what_windows_as_they_are_tell_apart_are_no_rivals(plainly: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """Under noise a load may gain what a friction by direction does, and leave eight times as much in windows."""
    monkeypatch.setattr(Table, "plainly", lambda *given: plainly)
    table = Table()
    table.unsure = 1e6
    one, other = (Child(effects()[name], state([name]), gain) for name, gain in ((FIRST, 500.0), (OTHER, 450.0)))
    assert set(Belief(table).rivals(one, [one, other])) == (set() if plainly else {OTHER})


def test_a_general_curve_explains_only_what_no_named_effect_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """It came first while a choice was wrong; with that put right either explained all."""
    curve = "load_over_position"
    named, general = (state([n]) for n in (FIRST, OTHER))

    def node(name: str, found: State) -> Node:
        added = Added(search, Child(effects()[name], found, 0.0), root, (), 0.0)
        return Node(found, (added,))

    search = Search(Table(), (), lambda text: None)
    root = Node(state(()))
    monkeypatch.setattr(search, "explains", lambda node: bool(node.added))
    for others in ([], [node(FIRST, named)]):
        grown = [node(curve, general), *others]
        monkeypatch.setattr(search, "expanded", lambda node, grown=grown: iter(grown))
        assert search.next_ones([root]) == grown[-1:]


@pytest.mark.parametrize(("behind", "error", "rival"), [(3.3, 0.9, True), (7.0, 0.9, False), (7.0, 4.0, True)])
def test_a_rival_that_is_nearly_as_likely_is_named_however_sure_the_difference_is(
    behind: float, error: float, rival: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Counts of a winding of 8 ms at 20 ms, by which a dead time gains 78 of deviance and the winding 75."""
    monkeypatch.setitem(LEFT, ((OTHER,), False), 500.0 + behind)
    table = Table()
    table.unsure = error
    one, other = (Child(effects()[n], state((n,)), 1000.0 - state((n,)).deviance) for n in (FIRST, OTHER))
    assert set(Belief(table).rivals(one, [one, other])) == ({OTHER} if rival else set())
