"""The doctor's findings, each from the numbers that it is made of."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from boards import WatchedTransport, bench_on

from fiohost.bench import doctor
from fiohost.bench.doctor import NOTE, OK, PROBLEM, Finding, Timing, _Braked, identity, signs, timing, who
from fiohost.bench.log import Log
from fiohost.errors import TelemetryTimeoutError
from fiohost.transport.profile import TargetProfile
from fiohost.transport.timed import TimedTransport
from fiohost.wire.crc import crc_function, find_crc
from fiohost.wire.identity import QUERY, Identity

FRAMED = TargetProfile.load("serial-framed")


# ---- who it is -----------------------------------------------------------------------------------------------------


def answer() -> bytes:
    body = struct.pack("<2sB12s8sBBBHHHHHH", b"\xa5!", 1, b"uno", b"l298n", 1, 2, 3, 3600, 250, 720, 5000, 0, 0)
    return body + struct.pack("<H", crc_function(find_crc("CRC-16/CCITT-FALSE"))(body))


class Asked:
    """A bench whose line says what is laid ready, a piece at a time, None for silence."""

    def __init__(self, pieces: list[bytes | None], profile: TargetProfile = FRAMED, *, stream: bool = True) -> None:
        self.profile, self.sample_time_s = profile, 0.005
        self.transport: Any = self
        self.stream = stream
        self.sent: list[bytes] = []
        self.waits_s: list[float] = []
        self._pieces = pieces

    def send(self, report: bytes) -> None:
        self.sent.append(report)

    def receive(self, timeout_s: float) -> bytes:
        self.waits_s.append(timeout_s)
        piece = self._pieces.pop(0) if self._pieces else None
        if piece is None:
            raise TelemetryTimeoutError("none")
        return piece


def test_a_board_is_asked_three_times_and_heard_for_twenty_pieces_each() -> None:
    whole = answer()
    bench: Any = Asked([None, b"telemetry" + whole[:7], whole[7:]])
    found = identity(bench)
    assert found is not None
    assert found.name == "uno"
    assert (bench.sent, bench.waits_s) == ([QUERY], [0.005] * 3)
    late: Any = Asked([None] * 59 + [whole])
    assert identity(late) is not None
    assert late.sent == [QUERY] * 3
    silent: Any = Asked([])
    assert identity(silent) is None
    assert (len(silent.sent), len(silent.waits_s)) == (3, 60)
    halves: Any = Asked([whole[:7], *[None] * 19, whole[7:]])  # of two answers none is whole
    assert identity(halves) is None


def test_a_board_whose_layout_has_no_query_is_not_asked() -> None:
    layout = FRAMED.codec.command_layout
    for profile, stream in (
        (FRAMED, False),
        (TargetProfile.load("serial-documented"), True),
        (with_layout(replace(layout, crc=None)), True),
        (with_layout(replace(layout, header=b"\xa5\x5b")), True),
    ):
        bench: Any = Asked([answer()], profile, stream=stream)
        assert identity(bench) is None
        assert bench.sent == []


def with_layout(layout: Any) -> Any:
    return SimpleNamespace(codec=SimpleNamespace(command_layout=layout))


SELF = Identity("uno", "l298n", "1.2.3", 3600, 0.25, 720, 0.005, 0, 0)
MINE = replace(FRAMED, board="uno", duty_steps=3600, watchdog_s=0.25, counts_per_rev=720, sample_time_s=0.005)


def findings(monkeypatch: pytest.MonkeyPatch, found: Identity | None, profile: TargetProfile) -> list[Finding]:
    monkeypatch.setattr(doctor, "identity", lambda bench: found)
    bench: Any = SimpleNamespace(profile=profile)
    return list(who(bench))


def test_what_a_board_says_of_itself_is_held_against_its_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    assert findings(monkeypatch, SELF, MINE) == [Finding(OK, SELF.describe())]
    assert len(findings(monkeypatch, SELF, replace(MINE, board=""))) == 1
    assert len(findings(monkeypatch, SELF, replace(MINE, duty_steps=0))) == 1  # a profile need not know it
    assert len(findings(monkeypatch, SELF, replace(MINE, watchdog_s=0.25 + 5e-10))) == 1
    for key, said, wrong in (
        ("duty_steps", "3601", 3601), ("watchdog_s", "0.5", 0.5), ("watchdog_s", "0", 0.0),
        ("counts_per_rev", "1440", 1440), ("sample_time_s", "0.0051", 0.0051),
    ):  # fmt: skip
        (_, finding) = findings(monkeypatch, SELF, replace(MINE, **{key: wrong}))  # type: ignore[arg-type]
        true = f"{getattr(SELF, key):g}"
        assert finding.level == PROBLEM
        assert finding.what == f"the profile says {key} = {said}, the board {true}"
        assert finding.cure == f"write {key} = {true} into a profile of your own, or use --target uno:PORT"
    (_, other) = findings(monkeypatch, SELF, replace(MINE, board="bluepill"))
    assert (other.level, other.what) == (PROBLEM, f"the profile {MINE.name} is of 'bluepill', the board is 'uno'")
    assert other.cure == "use the profile of this board: --target uno:PORT"
    worn = findings(monkeypatch, replace(SELF, refused_frames=3, bad_edges=4), MINE)
    assert [(finding.level, finding.what.split(" the reset")[0]) for finding in worn[1:]] == [
        (NOTE, "the board has refused 3 damaged frames since its reset"),
        (PROBLEM, "both encoder levels changed at once 4 times since"),
    ]


def test_a_board_that_does_not_say_who_it_is(monkeypatch: pytest.MonkeyPatch) -> None:
    (finding,) = findings(monkeypatch, None, MINE)
    assert (finding.level, finding.what) == (PROBLEM, "the board does not say who it is; the profile is of 'uno'")
    assert finding.cure == "'fiohost firmware flash uno' puts the firmware on it that does"
    assert findings(monkeypatch, None, replace(MINE, board="")) == []


# ---- how well the line keeps time ----------------------------------------------------------------------------------


def timed(
    monkeypatch: pytest.MonkeyPatch, interval_ms: list[float], answer_ms: list[float], *,
    lost: tuple[int, int, int] = (0, 0, 0), lock_step: bool = False, real: bool = True, seconds: float = 2.0,
) -> tuple[Timing, Any]:  # fmt: skip
    """The findings of a line with those times, and the bench; the profile says 10 ms."""
    bench: Any = SimpleNamespace(sample_time_s=0.01, profile=FRAMED, clock=SimpleNamespace(real=real), asked=[])
    bench.transport = line = SimpleNamespace(lock_step=lock_step)
    bench.statistics = SimpleNamespace(
        link=SimpleNamespace(lost=lost[0]), refused=lost[1], silent=lost[2], ticks=77, describe=lambda: "words"
    )
    monkeypatch.setattr(doctor, "TimedTransport", lambda line, clock: SimpleNamespace(line=line))

    def play(program: Any) -> None:
        assert bench.transport.line is line
        bench.asked.append(program._ticks)
        program.received_s = np.cumsum([1.0, *(1e-3 * np.array(interval_ms))]).tolist()
        program.answered_s = (1e-3 * np.array(answer_ms)).tolist()

    bench.play = play
    found = timing(bench, seconds)
    assert bench.transport is line
    return found, bench


def words(found: Timing, level: str) -> list[str]:
    return [finding.what for finding in found.findings if finding.level == level]


def test_reports_and_answers_are_timed_in_milliseconds(monkeypatch: pytest.MonkeyPatch) -> None:
    found, bench = timed(monkeypatch, [10.0, 10.5, 9.5], [1.0, 2.0, 4.0])
    assert found.interval_ms.tolist() == pytest.approx([10.0, 10.5, 9.5])
    assert found.answer_ms.tolist() == pytest.approx([1.0, 2.0, 4.0])
    assert found.sample_time_ms == 10.0
    assert words(found, PROBLEM) == []
    assert words(found, OK) == [
        "reports come every 10.00 ms, as the profile says", "answers are on their way within 3.96 ms (99 %)",
    ]  # fmt: skip
    assert bench.asked == [200]
    assert timed(monkeypatch, [10.0], [1.0], seconds=0.01)[1].asked == [20]
    assert Timing(np.array([1.0]), np.arange(1.0, 102.0), 1.0).achievable_hz == pytest.approx(1e3 / 96.0)
    assert Timing(np.array([1.0]), np.array([1e-9]), 1.0).achievable_hz == pytest.approx(1e6)


def test_listening_takes_two_seconds_and_no_longer_than_a_run_may(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[int] = []

    def stops(line: object, ticks: int) -> None:
        asked.append(ticks)
        raise KeyError

    monkeypatch.setattr(doctor, "_Braked", stops)
    bench: Any = SimpleNamespace(sample_time_s=0.01, profile=FRAMED, transport=WatchedTransport())
    short = replace(FRAMED, limits=FRAMED.limits.within({"run_time_s": 0.5}))
    for bench.profile in (FRAMED, short):
        with pytest.raises(KeyError):
            timing(bench)
    assert asked == [200, 50]
    assert isinstance(bench.transport, WatchedTransport)


def test_a_rate_a_tenth_off_is_a_problem_where_the_board_keeps_its_own_time(monkeypatch: pytest.MonkeyPatch) -> None:
    for interval_ms, is_problem in ((10.9, False), (11.1, True), (9.1, False), (8.9, True)):
        found, _ = timed(monkeypatch, [interval_ms] * 3, [1.0])
        assert len(words(found, PROBLEM)) == is_problem
        assert len(words(found, OK)) == 2 - is_problem
    finding = timed(monkeypatch, [12.5, 12.5, 99.0], [1.0])[0].findings[0]
    assert finding.what == "reports come every 12.50 ms, the profile says 10 ms"
    assert finding.cure.startswith("set sample_time_s = 0.0125 in a profile of your own")
    for lock_step, real, count in ((True, False, 1), (True, True, 2), (False, False, 2)):
        assert len(timed(monkeypatch, [20.0], [1.0], lock_step=lock_step, real=real)[0].findings) == count


def test_answers_later_than_half_a_tick_may_be_one_in_fifty(monkeypatch: pytest.MonkeyPatch) -> None:
    for late, is_problem in ((2, False), (3, True)):
        found, _ = timed(monkeypatch, [10.0], [1.0] * (100 - late) + [5.1] * late)
        assert words(found, PROBLEM) == (["3.0 % of the answers took longer than half a tick"] if is_problem else [])
    assert words(timed(monkeypatch, [10.0], [5.0] * 10)[0], PROBLEM) == []


@pytest.mark.parametrize("lost", [(2, 0, 0), (0, 2, 0), (0, 0, 2), (0, 1, 1), (1, 0, 1)])
def test_reports_that_were_lost_are_added_up(lost: tuple[int, int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    found, _ = timed(monkeypatch, [10.0], [1.0], lost=lost)
    assert words(found, PROBLEM) == ["2 of 77 reports were lost or damaged: words"]


def test_only_what_was_timed_while_it_braked_counts() -> None:
    line: Any = SimpleNamespace(received_s=[0.0, 1.0, 2.0, 3.0], answered_s=[0.1, 0.2])  # one was not answered
    program = _Braked(line, 2)
    assert program.step(0, 0.0) is not None
    line.received_s += [4.0]
    line.answered_s += [0.3]
    assert program.step(1, 0.0) is not None
    line.received_s += [5.0]
    line.answered_s += [0.4]
    assert (program.received_s, program.answered_s) == ([], [])
    assert program.step(2, 0.0) is None
    assert (program.received_s, program.answered_s) == ([3.0, 4.0, 5.0], [0.3, 0.4])
    line.received_s += [6.0]
    assert len(program.received_s) == 3


def test_a_timed_bench_is_timed_from_its_own_reports() -> None:
    with bench_on(WatchedTransport()) as bench:
        before = bench.transport
        found = timing(bench, 0.5)
        assert bench.transport is before
        assert not isinstance(before, TimedTransport)
    assert (len(found.answer_ms), len(found.interval_ms)) == (100, 100)
    assert found.findings[-1].level == OK


# ---- signs ---------------------------------------------------------------------------------------------------------


class Pulsed:
    """A bench whose shaft turns as *counts(duty)* says in a pulse; what was asked is kept."""

    def __init__(self, counts: Any, *, direction: Any = lambda step: step < 0, most_pct: float = 100.0,
                 reaches: float = 1.0, slowed: int = 0) -> None:  # fmt: skip
        self.asked: list[float] = []
        self.seconds: set[float] = set()
        self.counts_per_rev = 720
        self.profile = SimpleNamespace(limit_duty_pct=most_pct)
        self.statistics = SimpleNamespace(slowed=slowed)
        self._counts, self._direction, self._reaches = counts, direction, reaches

    def drive(self, duty_pct: float, seconds: float) -> Log:
        self.asked.append(duty_pct)
        self.seconds.add(seconds)
        turned = self._counts(duty_pct)
        steps = [0, *np.diff(np.linspace(0, turned, 11).round())]
        pos = (100 + np.cumsum(steps)) % 720
        columns = {
            "time_s": np.arange(11) * 0.005, "duty_pct": np.full(11, duty_pct * self._reaches), "pos": pos,
            "direction": [float(self._direction(step)) for step in steps],
        }  # fmt: skip
        return Log.from_columns(columns, {"sample_time_s": "0.005"})


def told(bench: Any, most_pct: float = 40.0) -> list[tuple[str, str]]:
    return [(finding.level, finding.what) for finding in signs(bench, most_pct)]


def way(start_pct: float, sign: float = 1.0) -> Any:
    return lambda duty: sign * np.sign(duty) * (20 if abs(duty) >= start_pct else 0)


def test_a_sound_bench_is_moved_by_the_smallest_pulse_that_does() -> None:
    bench = Pulsed(way(15.0))
    assert told(bench) == [
        (OK, "the shaft moves forward at 15 % and in reverse at 15 %"), (OK, "forward duty makes the encoder count up"),
        (OK, "the direction bit follows the count"),
    ]  # fmt: skip
    assert (bench.asked, bench.seconds) == ([5.0, 10.0, 15.0, -5.0, -10.0, -15.0], {0.2})
    for counts, moved in ((5, False), (6, True), (-6, True)):
        still = Pulsed(lambda duty, counts=counts: counts)
        assert (still.asked or told(still)) is not None
        assert (len(still.asked) == 2) is moved


def test_pulses_rise_to_what_is_asked_and_never_beyond_the_limit() -> None:
    for most, limit, wanted in (
        (40.0, 100.0, [5.0, 10.0, 15.0, 20.0, 30.0, 40.0]), (100.0, 100.0, [5.0, 10.0, 15.0, 20.0, 30.0, 40.0, 100.0]),
        (100.0, 12.0, [5.0, 10.0, 12.0]), (3.0, 100.0, [3.0]), (20.0, 100.0, [5.0, 10.0, 15.0, 20.0]),
    ):  # fmt: skip
        bench = Pulsed(way(1e9), most_pct=limit)
        ((level, what),) = told(bench, most)
        assert bench.asked == [*wanted, *(-duty for duty in wanted)]
        assert level == PROBLEM
        assert what == f"the shaft does not move within {wanted[-1]:g} % of duty, in either direction"


def test_what_a_slew_limit_let_a_pulse_reach_is_said() -> None:
    held: Any = Pulsed(way(1e9), reaches=0.5, slowed=3)
    (finding,) = signs(held, 40.0)
    assert finding.what == "the shaft does not move within 20 % of duty, in either direction"
    assert finding.cure.startswith("the target's slew limit lets a short pulse reach no more; is the motor's supply on")
    free: Any = Pulsed(way(1e9))
    (finding,) = signs(free, 40.0)
    assert finding.cure.startswith("is the motor's supply on")
    turned: Any = Pulsed(way(15.0), reaches=0.5)
    assert next(iter(signs(turned, 40.0))).what == "the shaft moves forward at 7.5 % and in reverse at 7.5 %"


@pytest.mark.parametrize(("sign", "words", "bit"), [(1, "forward", "C3"), (-1, "in reverse", "C4")])
def test_a_direction_that_is_dead_is_named_with_its_bit(sign: int, words: str, bit: str) -> None:
    bench: Any = Pulsed(lambda duty: 0 if sign * duty > 0 else 20 * np.sign(duty))
    found = list(signs(bench, 30.0))
    assert (found[0].level, found[0].what) == (PROBLEM, f"the shaft does not move {words} within 30 %")
    assert found[0].cure.startswith(f"{bit} does not reach the bridge as 1")
    assert [finding.level for finding in found[1:]] == [OK, OK]
    turned: Any = Pulsed(lambda duty: 0 if sign * duty > 0 else -20 * np.sign(duty))
    assert "makes the encoder count down" in list(signs(turned, 30.0))[1].what


def test_wires_that_are_swapped_and_bits_that_do_not_choose() -> None:
    assert told(Pulsed(way(5.0, -1.0)))[1:] == [
        (PROBLEM, "forward duty makes the encoder count down: a controller would run away from its reference"),
        (OK, "the direction bit follows the count"),
    ]
    assert told(Pulsed(lambda duty: 20))[1:] == [(PROBLEM, "the shaft turns the same way forward and in reverse")]
    assert told(Pulsed(lambda duty: -20))[1:] == [(PROBLEM, "the shaft turns the same way forward and in reverse")]


def test_the_direction_bit_may_be_wrong_in_a_fifth_of_the_steps() -> None:
    seen: Counter[bool] = Counter()

    def mostly(step: float, of: int) -> bool:
        if step:
            seen[True] += 1
        return (step < 0) != (bool(step) and seen[True] % of == 0)

    assert told(Pulsed(way(5.0), direction=lambda step: mostly(step, 5)))[-1] == (
        OK, "the direction bit follows the count",
    )  # fmt: skip
    assert told(Pulsed(way(5.0), direction=lambda step: mostly(step, 4)))[-1] == (
        PROBLEM, "the direction bit says the opposite of the count",
    )  # fmt: skip
    assert told(Pulsed(way(5.0), direction=lambda step: step > 0))[-1][0] == PROBLEM
    assert told(Pulsed(way(5.0), direction=lambda step: True))[-1][0] == PROBLEM
