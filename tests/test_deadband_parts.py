"""The deadband sweep piece by piece: when a ramp ends, where a start is, how the sweep goes on, what it says."""

from __future__ import annotations

import math
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from fiohost.bench import deadband, starts
from fiohost.bench.deadband import Deadband, Onset, _onset, _RampUp, _start_time, _turn_on, _TurnBy, measure_deadband
from fiohost.bench.log import Log
from fiohost.bench.program import Hold
from fiohost.errors import ConfigError, DataError
from fiohost.wire.messages import Command

TICK_S = 0.0078125
NONE = np.zeros(0)


def onset(duty_pct: float, place_deg: float | None = None, onset_s: float = 1.0, at_deg: float = 5.0) -> Onset:
    return Onset(duty_pct > 0.0, duty_pct, at_deg, onset_s, NONE, NONE, NONE, place_deg)


def bench(**more: Any) -> Any:
    return SimpleNamespace(sample_time_s=TICK_S, counts_per_rev=720, **more)


# ---- what a sweep says ---------------------------------------------------------------------------------------------


def test_means_and_spreads_of_each_direction() -> None:
    found = Deadband((
        onset(4.0, 0.0), onset(-3.0, 0.0), onset(6.0, 90.0), onset(-4.0, 90.0),
        onset(5.0, 0.0), onset(-3.0, 0.0), onset(10.0, 90.0), onset(-5.0, 180.0),
    ))  # fmt: skip
    assert (found.method, found.u_plus_pct, found.u_minus_pct) == ("ramp", 6.25, -3.75)
    assert found.places(True) == {0.0: [4.0, 5.0], 90.0: [6.0, 10.0]}
    assert found.places(False) == {0.0: [-3.0, -3.0], 90.0: [-4.0], 180.0: [-5.0]}
    assert found.spread_pct(True) == pytest.approx(np.std([4, 6, 5, 10], ddof=1))
    assert found.spread_over_angle_pct(True) == pytest.approx(np.std([4.5, 8.0], ddof=1))
    assert found.spread_over_repeats_pct(True) == pytest.approx(math.sqrt((0.5 + 8.0) / 2))
    assert found.spread_over_repeats_pct(False) == 0.0
    uneven = Deadband(
        (onset(1.0, 0.0), onset(2.0, 0.0), onset(6.0, 0.0), onset(5.0, 9.0), onset(7.0, 9.0), onset(-1.0))
    )
    assert uneven.spread_over_repeats_pct(True) == pytest.approx(math.sqrt((2 * 7.0 + 2.0) / 3))
    told = found.as_dict()
    assert (told["schema"], told["method"], told["u_plus_pct"]) == ("fiohost.deadband/1", "ramp", 6.25)
    assert (told["u_plus_range_pct"], told["u_minus_range_pct"]) == ([4.0, 10.0], [-5.0, -3.0])
    assert told["u_minus_spread_pct"] == pytest.approx(found.spread_pct(False))
    assert told["u_minus_spread_over_angle_pct"] == pytest.approx(1.0)
    assert told["repeats"][1] == {
        "direction": "reverse", "onset_duty_pct": -3.0, "at_angle_deg": 5.0, "onset_s": 1.0, "place_deg": 0.0,
    }  # fmt: skip
    assert told["repeats"][0]["direction"] == "forward"


def test_what_makes_one_pair_of_numbers_doubtful_is_said_by_direction() -> None:
    even = (onset(-3.0), onset(-3.0))
    assert Deadband((onset(7.0), onset(10.0), *even)).notes() == []
    (said,) = Deadband((onset(6.99), onset(10.0), *even)).notes()
    assert said.startswith("the start forward differs between places of the turn (6.99 to 10.00 %)")
    assert Deadband((onset(0.05), onset(0.05), *even)).notes() == []
    (said,) = Deadband((onset(0.049), onset(10.0), *even)).notes()
    assert said == "the shaft starts forward at almost no duty: nothing holds it there, or a load turns it"
    (said,) = Deadband((onset(7.0), onset(-1.0), onset(-3.0))).notes()
    assert said.startswith("the start in reverse differs between places of the turn (1.00 to 3.00 %)")
    assert Deadband((onset(7.0), *even)).as_dict()["notes"] == []


# ---- how it goes on ------------------------------------------------------------------------------------------------


class Sweep:
    """A sweep whose ramps find what they are told to, and that keeps what it was asked for."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, found: Any, coarse_pct: float = 5.0) -> None:
        self.asked: list[tuple[Any, ...]] = []
        self._found = found
        monkeypatch.setattr(deadband, "_coarse", lambda bench, forward, most: coarse_pct)
        monkeypatch.setattr(deadband, "_turn_on", lambda bench, *rest: self.asked.append(("turn", *rest)))
        monkeypatch.setattr(deadband, "_ramp", self.ramp)

    def ramp(self, bench: Any, forward: bool, begin: float, rate: float, most: float) -> Onset:
        self.asked.append(("ramp", forward, begin, rate, most))
        found: Onset = self._found(forward, begin)
        return found


def test_a_sweep_turns_on_and_starts_from_below_in_both_directions(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(8.0 if forward else -7.0))
    shown: list[Onset] = []
    found = measure_deadband(bench(), 2, 60.0, shown.append)
    assert sweep.asked == [
        ("turn", True, 5.0, 60.0, None), ("ramp", True, 5.0, 0.5, 60.0),
        ("turn", False, 5.0, 60.0, None), ("ramp", False, 5.0, 0.5, 60.0),
        ("turn", True, 5.0, 60.0, None), ("ramp", True, 5.0, 0.5, 60.0),
        ("turn", False, 5.0, 60.0, None), ("ramp", False, 5.0, 0.5, 60.0),
    ]  # fmt: skip
    assert tuple(shown) == found.onsets
    assert [o.duty_pct for o in shown] == [8.0, -7.0, 8.0, -7.0]
    sweep.asked.clear()
    measure_deadband(bench())
    assert len(sweep.asked) == 2 * 2 * 5  # five repeats where nobody says
    assert sweep.asked[0] == ("turn", True, 5.0, 100.0, None)


def test_a_start_at_once_is_looked_for_again_from_nothing_and_the_next_begins_below_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Here the shaft starts at 3 % forward though the fast ramp said more, and at 8 % in reverse."""
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(max(3.0, begin), onset_s=0.19 if begin > 3.0 else 0.2)
                  if forward else onset(-8.0, onset_s=0.2))  # fmt: skip
    found = measure_deadband(bench(), 2)
    assert [o.duty_pct for o in found.onsets] == [3.0, -8.0, 3.0, -8.0]
    assert [asked[2] for asked in sweep.asked if asked[0] == "ramp"] == [5.0, 0.0, 5.0, pytest.approx(2.4), 5.0]
    assert [asked[2] for asked in sweep.asked if asked[0] == "turn"] == [5.0, 5.0, pytest.approx(2.4), 5.0]


def test_a_shaft_that_starts_at_once_from_nothing_is_believed(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(0.5 if forward else -0.5, onset_s=0.1), coarse_pct=0.0)
    measure_deadband(bench(), 1)
    assert [asked[0] for asked in sweep.asked] == ["turn", "ramp"] * 2


def test_a_start_at_once_from_little_is_looked_for_again_too(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(0.6 if forward else -0.6, onset_s=0.1), coarse_pct=0.5)
    measure_deadband(bench(), 1)
    assert [asked[2] for asked in sweep.asked if asked[0] == "ramp"] == [0.5, 0.0] * 2


def test_places_are_even_over_the_turn_and_repeated_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(8.0 if forward else -7.0))
    found = measure_deadband(bench(), 2, angles=3)
    assert [o.place_deg for o in found.onsets] == [0.0, 0.0, 120.0, 120.0, 240.0, 240.0] * 2
    assert [asked[4] for asked in sweep.asked if asked[0] == "turn"] == [o.place_deg for o in found.onsets]
    monkeypatch.setattr(starts, "step_until_it_starts", lambda bench, *rest: (sweep.asked.append(rest), onset(9.0))[1])
    sweep.asked.clear()
    assert measure_deadband(bench(), 1, 50.0, method="steps").method == "steps"
    assert sweep.asked[1] == (True, 5.0, 50.0)


@pytest.mark.parametrize(
    ("wrong", "right"),
    [({"repeats": 0}, {"repeats": 1}), ({"max_pct": 0.99}, {"max_pct": 1.0}), ({"max_pct": 100.1}, {"max_pct": 100.0}),
     ({"angles": -1}, {"angles": 0}), ({"angles": 361}, {"angles": 360}), ({"method": "slope"}, {"method": "ramp"})],
)  # fmt: skip
def test_a_sweep_ends_where_it_must(wrong: Any, right: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    Sweep(monkeypatch, lambda forward, begin: onset(8.0 if forward else -7.0))
    measure_deadband(bench(), **{"repeats": 1, **right})
    with pytest.raises(ConfigError):
        measure_deadband(bench(), **{"repeats": 1, **wrong})


def test_a_fast_ramp_says_where_slow_ones_begin(monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = Sweep(monkeypatch, lambda forward, begin: onset(20.0 if forward else -20.0))
    monkeypatch.undo()
    monkeypatch.setattr(deadband, "_ramp", sweep.ramp)
    assert deadband._coarse(bench(), True, 60.0) == deadband._coarse(bench(), False, 60.0) == 13.0
    assert sweep.asked == [("ramp", True, 0.0, 10.0, 60.0), ("ramp", False, 0.0, 10.0, 60.0)]


def test_a_shaft_is_turned_on_with_more_than_it_needs_for_some_seconds_at_most() -> None:
    played: list[_TurnBy] = []
    made = bench(play=played.append)
    for forward, begin, most, place in ((True, 4.0, 100.0, None), (False, 4.0, 100.0, None), (True, 4.0, 15.0, 90.0)):
        _turn_on(made, forward, begin, most, place)
    assert [turn._command.duty_pct for turn in played] == [18.0, -18.0, 15.0]
    assert [turn._ticks for turn in played] == [384, 384, 1536]
    assert [turn._angle_deg for turn in played[:2]] == [137.5, 60.0]


def test_a_turn_ends_at_its_angle_or_its_time() -> None:
    for sign in (1.0, -1.0):
        command = Command.drive(sign * 20.0)
        turn = _TurnBy(command, 60.0, None, 5)
        assert turn.step(0, 100.0) == (command, None)
        assert turn.step(1, 100.0 + sign * 59.5) == (command, None)
        assert turn.step(2, 100.0 + sign * 60.0) is None
        assert turn.step(4, 100.0) == (command, None)
        assert turn.step(5, 100.0) is None


@pytest.mark.parametrize(
    ("duty_pct", "from_deg", "to_deg", "way_deg"),
    [(20.0, 100.0, 180.0, 80.0), (-20.0, 100.0, 180.0, 280.0), (20.0, 100.0, 120.0, 20.0), (20.0, 100.0, 119.5, 379.5),
     (-20.0, 100.0, 80.0, 20.0), (-20.0, 100.0, 80.5, 379.5), (20.0, 350.0, 10.0, 20.0), (20.0, 100.0, 100.0, 360.0)],
)  # fmt: skip
def test_a_place_is_reached_in_the_direction_of_the_sweep_and_never_without_taking_up_the_play(
    duty_pct: float, from_deg: float, to_deg: float, way_deg: float
) -> None:
    turn = _TurnBy(Command.drive(duty_pct), 60.0, to_deg, 10_000)
    sign = math.copysign(1.0, duty_pct)
    assert turn.step(0, from_deg) is not None
    assert turn.step(1, from_deg + sign * (way_deg - 0.25)) is not None
    assert turn.step(2, from_deg + sign * way_deg) is None


# ---- one ramp ------------------------------------------------------------------------------------------------------


def ramp(forward: bool = True, begin: float = 2.0, most: float = 100.0) -> _RampUp:
    return _RampUp(bench(), forward, begin, 1.0 / TICK_S, most)  # a percent a tick


@pytest.mark.parametrize("forward", [True, False])
def test_a_ramp_goes_up_until_the_shaft_has_moved_ten_counts(forward: bool) -> None:
    sign = 1.0 if forward else -1.0
    made = ramp(forward)
    asked = [made.step(k, 100.0 + sign * 0.5 * counts) for k, counts in enumerate((0, 0, 1, 2, 9))]
    assert [answer[0].duty_pct for answer in asked if answer] == [sign * (2.0 + k) for k in range(5)]
    assert (made.started, made.wrong_way) == (False, False)
    assert made.step(5, 100.0 + sign * 5.0) is None
    assert (made.started, made.wrong_way, made.rest_tick) == (True, False, 0)
    wrong = ramp(forward)
    wrong.step(0, 100.0)
    assert wrong.step(1, 100.0 - sign * 4.5) is not None
    assert wrong.step(2, 100.0 - sign * 5.0) is None
    assert (wrong.started, wrong.wrong_way) == (False, True)
    assert wrong.patience == 10.0


def test_a_ramp_ends_beyond_its_largest_duty() -> None:
    made = ramp(begin=2.0, most=4.0)
    assert [made.step(k, 0.0) is None for k in range(4)] == [False, False, False, True]
    assert (made.started, made.wrong_way) == (False, False)


def test_a_shaft_that_creeps_for_two_seconds_and_stops_has_not_started() -> None:
    """It rests anew where it has crept to: 256 ticks are two seconds."""
    made = _RampUp(bench(), True, 0.0, 0.5, 100.0)
    made.step(0, 100.0)
    made.step(10, 101.0)  # two counts
    made.step(266, 101.0)
    assert made.rest_tick == 0
    made.step(267, 101.5)
    assert made.rest_tick == 267
    assert made.step(300, 106.0) is not None  # nine counts on
    assert made.step(301, 106.5) is None
    assert made.started
    back = _RampUp(bench(), True, 0.0, 0.5, 100.0)
    for k, deg in ((0, 100.0), (10, 101.0), (200, 100.5), (210, 101.0), (400, 101.0)):  # a count of flicker is none
        back.step(k, deg)
    assert back.rest_tick == 0


def log_of(counts: list[int], duties: list[float], delay: int = 0) -> Log:
    rows = len(counts)
    columns = {
        "time_s": [TICK_S * k for k in range(rows)],
        "duty_pct": duties,
        "pos": [(700 + c) % 720 for c in counts],
    }
    return Log.from_columns(columns, {"sample_time_s": str(TICK_S), "command_delay_ticks": str(delay)})


@pytest.mark.parametrize(("sign", "delay"), [(1, 0), (-1, 0), (1, 2)])
def test_a_start_is_read_from_the_log_with_the_duty_that_acted_then(sign: int, delay: int) -> None:
    """Two percent a tick; the shaft is at rest up to tick 40 and speeds up evenly from there."""
    counts = [sign * int(0.5 + 0.2 * max(0, k - 40) ** 2) for k in range(64)]
    log = log_of(counts, [sign * 0.25 * k for k in range(64)], delay)
    program: Any = SimpleNamespace(rest_tick=0)
    found = _onset(log, program, sign > 0)
    assert found.onset_s == pytest.approx(40 * TICK_S, abs=2.5 * TICK_S)
    assert found.duty_pct == pytest.approx(sign * 0.25 * (found.onset_s / TICK_S - delay))
    assert (found.forward, found.at_angle_deg, found.place_deg) == (sign > 0, 350.0, None)
    assert found.moved_deg.tolist() == [0.5 * c for c in counts]
    assert found.duty_acting_pct[10] == pytest.approx(sign * 0.25 * (10 - delay))
    late: Any = SimpleNamespace(rest_tick=55)
    again = _onset(log, late, sign > 0)
    assert again.moved_deg[55] == 0.0
    assert again.at_angle_deg == pytest.approx((350.0 + 0.5 * counts[55]) % 360.0)
    assert again.onset_s >= 55 * TICK_S


def test_no_start_is_before_a_duty_acts() -> None:
    counts = [int(0.5 + 0.05 * k * k) for k in range(32)]
    found = _onset(log_of(counts, [0.0] * 5 + [1.0 + k for k in range(27)]), SimpleNamespace(rest_tick=0), True)  # type: ignore[arg-type]
    assert found.onset_s == 5 * TICK_S
    assert found.duty_pct == 1.0


def test_the_start_is_where_the_square_root_of_the_counts_was_nothing() -> None:
    time_s = np.arange(0.0, 2.0, 1e-4)
    exact = np.floor(0.5 + 40.0 * np.clip(time_s - 1.0, 0.0, None) ** 2)
    assert _start_time(time_s, exact) == pytest.approx(1.0, abs=2e-4)
    assert _start_time(time_s, np.floor(exact)) <= time_s[np.flatnonzero(exact <= 0)[-1]]
    few = np.floor(0.5 + 4.0 * np.clip(time_s - 1.0, 0.0, None) ** 2)  # four counts: three edges
    assert _start_time(time_s, few) == pytest.approx(1.0 + math.sqrt(0.125), abs=2e-4)
    early = exact + 1.0  # never at rest in what is seen
    assert _start_time(time_s, early) == 0.0
    slowing = np.floor(10.0 * np.sqrt(np.clip(time_s - 1.0, 0.0, None)))
    assert 0.0 <= _start_time(time_s, slowing) <= time_s[np.flatnonzero(slowing <= 0)[-1]]


def test_edges_are_where_a_count_was_reached_for_good() -> None:
    """By hand: from two counts on, each where it was last not reached, the straight line of their roots to nothing."""

    def started(*counts: int, before: int = 100) -> float:
        """Seconds from the first of *counts* on, behind a long rest."""
        seen = np.array([0] * before + list(counts), dtype=float)
        return _start_time(np.arange(seen.size) - float(before), seen)

    def line(edges: list[float]) -> float:
        slope, at_zero = np.polyfit(edges, np.sqrt(np.arange(2, 2 + len(edges)) - 0.5), 1)
        return float(-at_zero / slope)

    assert started(0, 0, 0, 0, 0, 0, 1, 2, 3, 4, 4, 5, 5, 6) == pytest.approx(line([7, 8, 9, 11, 13]))
    assert started(0, 0, 0, 0, 0, 1, 2, 3, 2, 4, 5) == pytest.approx(line([6, 9, 9, 10]))  # four edges are enough
    assert started(0, 0, 0, 0, 0, 1, 2, 3, 4, 5, 6, 5) == pytest.approx(line([6, 7, 8, 9]))  # the sixth did not last
    assert started(0, 0, 0, 1, 2, 3, 4) == 2.0  # three are not: the last tick at rest
    assert started(0, 0, 1, 0, 2, 3, 4) == 3.0
    assert started(0, 0, 2, *[2] * 9, 3, *[3] * 9, 4, *[4] * 9, 5, before=0) == 0.0  # no earlier than was looked


@pytest.mark.parametrize(("forward", "way"), [(True, "forward"), (False, "in reverse")])
def test_a_ramp_that_finds_no_start_says_which_way(forward: bool, way: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def play(program: _RampUp) -> str:
        program.wrong_way, program.started = outcome
        return "log"

    monkeypatch.setattr(deadband, "_onset", lambda log, program, forward: (log, forward))
    outcome = (True, False)
    with pytest.raises(DataError, match=f"turns against the duty when driven {way}: swap"):
        deadband._ramp(bench(play=play), forward, 0.0, 0.5, 30.0)
    outcome = (False, False)
    with pytest.raises(DataError, match=f"does not start {way} up to 30 %"):
        deadband._ramp(bench(play=play), forward, 0.0, 0.5, 30.0)
    outcome = (False, True)
    assert deadband._ramp(bench(play=play), forward, 0.0, 0.5, 30.0) == ("log", forward)  # type: ignore[comparison-overlap]


# ---- by steps ------------------------------------------------------------------------------------------------------


def stepped(
    monkeypatch: pytest.MonkeyPatch, way_deg: Any, begin: float, forward: bool = True, most: float = 100.0
) -> tuple[list[float], float]:
    """The duties that were tried, and where the start is said to be."""
    asked: list[float] = []

    def play(program: Hold) -> Any:
        answer = program.step(0, 0.0)
        assert answer is not None
        assert program.step(76, 0.0) is not None
        assert program.step(77, 0.0) is None  # 0.6 s
        asked.append(answer[0].duty_pct)
        return SimpleNamespace(output=np.array([10.0, 10.0 + way_deg(answer[0].duty_pct)]))

    monkeypatch.setattr(starts, "_onset", lambda logs, duty_pct, forward: replace(onset(duty_pct), forward=forward))
    found = starts.step_until_it_starts(bench(play=play), forward, begin, most)
    assert found.forward == forward
    return asked, found.duty_pct


def test_steps_go_up_by_a_quarter_percent_until_the_shaft_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    def way(duty: float) -> float:
        return 8.0 * max(0.0, abs(duty) - 5.1) * math.copysign(1.0, duty)

    asked, found = stepped(monkeypatch, way, 4.75)
    assert (asked, found) == ([4.75, 5.0, 5.25, 5.5, 6.5], pytest.approx(5.1))
    asked, found = stepped(monkeypatch, way, 4.75, forward=False)
    assert (asked, found) == ([-4.75, -5.0, -5.25, -5.5, -6.5], pytest.approx(-5.1))
    assert stepped(monkeypatch, way, 0.0)[0][0] == 0.25
    asked, found = stepped(monkeypatch, way, 5.5)
    assert (asked, found) == ([5.5, 6.5], pytest.approx(5.1))  # it turned at once: nothing smaller was tried


def test_the_second_step_that_turns_may_be_any_larger_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(starts, "SECOND_PCT", 2.0)
    asked, found = stepped(monkeypatch, lambda duty: 8.0 * max(0.0, duty - 5.1), 4.75)
    assert (asked[-1], found) == (7.5, pytest.approx(5.1))


def test_a_start_lies_between_the_last_step_that_did_not_turn_and_the_first_that_did(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A shaft that sticks harder than it slides; one that creeps in a step has turned in it neither way."""
    assert stepped(monkeypatch, lambda duty: 20.0 * duty if duty >= 5.5 else 0.0, 4.75)[1] == 5.25
    creeps = {5.0: 0.5, 5.25: 0.75, 5.5: 100.0, 6.5: 200.0}  # of counts of half a degree
    assert stepped(monkeypatch, lambda duty: creeps.get(duty, 0.0), 4.75)[1] == 5.0
    flat = {5.5: 5.0, 6.5: 5.0}
    assert stepped(monkeypatch, lambda duty: flat.get(duty, 0.0), 4.75)[1] == 5.5
    assert stepped(monkeypatch, lambda duty: 8.0 * max(0.0, duty - 5.1), 4.75, most=6.5)[0][-1] == 6.5
    assert stepped(monkeypatch, lambda duty: 8.0 * max(0.0, duty - 5.1), 4.75, most=6.4)[0][-1] == 5.5
    at_edge = {5.0: 1.25, 6.0: 2.5}  # two and a half counts are a turn
    assert stepped(monkeypatch, lambda duty: at_edge.get(duty, 0.0), 4.75)[0] == [4.75, 5.0, 6.0]


def test_steps_that_find_no_start_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[float] = []
    with pytest.raises(DataError, match=r"does not start forward up to 5\.6 %"):
        stepped(monkeypatch, lambda duty: asked.append(duty) or 0.0, 5.0, most=5.6)
    assert asked == pytest.approx([5.0, 5.25, 5.5, 5.6])
    with pytest.raises(DataError, match="turns against the duty"):
        stepped(monkeypatch, lambda duty: -1.25 if duty >= 5.5 else -1.0, 5.0)
