"""Problems and labs solved again by scipy's own solvers, apart from the labs' code, and compared as printed.

Nothing here uses the labs' simulations: the equations are written down anew from the text (Figs. D-24, D-26, D-35,
D-58).
"""

from __future__ import annotations

import re
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from places import ROOT
from scipy import signal, stats
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fiohost.labs.characterise import characterise
from fiohost.labs.constants import TEXT
from fiohost.labs.elevator.car import Design, moves
from fiohost.labs.elevator.ride import ideal
from fiohost.labs.open_loop_sine import open_loop_sine
from fiohost.labs.open_loop_step import open_loop_step
from fiohost.labs.play import Torque
from fiohost.labs.position_control import PositionPlan, position_control
from fiohost.labs.problems.catalogue import PROBLEMS
from fiohost.labs.readings import Readings
from fiohost.labs.result import LabResult
from fiohost.labs.session import Session
from fiohost.labs.speed_control import speed_control
from fiohost.report.lab import cell_text

INF = float("inf")


class Motor(NamedTuple):
    R: float
    L: float
    K: float
    J: float
    B: float


D1 = Motor(2.0, 0.008, 0.1, 0.0004, 0.001)
NXT = Motor(2.27, 0.0047, 0.25, 0.00233, 0.00131)


class Solved(NamedTuple):
    t: np.ndarray
    i: np.ndarray
    w: np.ndarray
    angle: np.ndarray

    def to(self, y: np.ndarray, level: float, begin: float = 0.0) -> float:
        """When y first crosses a level after a moment."""
        below = np.sign(y - level) != np.sign(y[np.searchsorted(self.t, begin)] - level)
        k = int(np.flatnonzero((self.t >= begin) & below)[0])
        share = (level - y[k - 1]) / (y[k] - y[k - 1])
        return float(self.t[k - 1] + share * (self.t[k] - self.t[k - 1]))


def solve(
    m: Motor, volts: Callable[[float, float, float], float], seconds: float, *, load: float = 0.0, at: float = 0.0,
    amps: float = INF, points: int = 40_001, kick: float = 0.0,
) -> Solved:  # fmt: skip
    """From rest; volts(t, speed, angle); the load from a moment on; kick is a current in the first moment."""
    times = np.unique(np.append(np.linspace(0.0, seconds, points), at))

    def current(i: float, v: float, w: float) -> float:
        return i if m.L > 0.0 else (v - m.K * w) / m.R

    def rates(t: float, x: np.ndarray, torque: float) -> list[float]:
        i, w, angle = x
        v = volts(t, w, angle)
        i_now = min(max(current(i, v, w), -amps), amps)
        slope = (v - m.R * i - m.K * w) / m.L if m.L > 0.0 else 0.0
        return [slope, (m.K * i_now - m.B * w + torque) / m.J, w]

    parts, state = [], np.array([kick, 0.0, 0.0])
    for a, b, torque in ((0.0, at, 0.0), (at, seconds, load)):
        if b <= a:
            continue
        own = times[(times >= a) & (times <= b)]
        # LSODA with small steps where something saturates, an explicit method of high order where nothing does
        found = solve_ivp(rates, (a, b), state, "LSODA", own, args=(torque,), rtol=1e-9, atol=1e-11,
                          max_step=2e-3 if amps < INF else np.inf)  # fmt: skip
        state = found.y[:, -1]
        keep = slice(None) if not parts else slice(1, None)
        parts.append((found.t[keep], found.y[:, keep]))
    t = np.concatenate([part[0] for part in parts])
    i, w, angle = np.concatenate([part[1] for part in parts], axis=1)
    if m.L == 0.0:
        i = np.array([current(0.0, volts(s, x, y), x) for s, x, y in zip(t, w, angle, strict=True)])
    return Solved(t, i, w, angle)


def step(v: float) -> Callable[[float, float, float], float]:
    return lambda t, w, angle: v


@cache
def answer(number: int) -> LabResult:
    return PROBLEMS[number].solve()


NUMBER = re.compile(r"(?<![\w.])-?\d+(?:\.\d+)?(?:e[-+]\d+)?")
Place = tuple[str, int] | tuple[str, str, str]


def printed(result: LabResult, place: Place) -> str:
    """The number at one place, as printed: (question, which of its answer's numbers) or (table, row, column)."""
    if len(place) == 2:
        question, which = place
        (told,) = (a.answer for a in result.answers if a.question.startswith(question))
        return str(NUMBER.findall(told)[which])
    title, row, column = place
    table = next(t for t in result.tables if t.title.startswith(title))
    (cells,) = (r for r in table.rows if cell_text(r[0]) == row)
    return cell_text(cells[table.columns.index(column)])


def shares(s: Solved) -> list[float]:
    final = float(s.w[-1])
    return [final, s.to(s.w, 0.63 * final), s.to(s.w, 0.75 * final), float(s.i[np.argmax(np.abs(s.i))])]


def p1() -> list[float]:
    return shares(solve(D1, step(5.0), 10.0))


def p2() -> list[float]:
    m = D1._replace(B=0.0)
    return [*shares(solve(m, step(5.0), 10.0)), float(solve(m, step(10.0), 10.0).w[-1])]


def p3() -> list[float]:
    m = D1._replace(B=0.0, L=0.0)
    heavy = solve(m._replace(J=2.0 * m.J), step(5.0), 10.0)
    return [*shares(solve(m, step(5.0), 10.0)), *shares(heavy)[1:3]]


def loaded(load: float, at: float) -> list[float]:
    found: list[float] = []
    for m in (D1, D1._replace(B=0.0), D1._replace(B=0.0, L=0.0)):
        s = solve(m, step(5.0), 10.0, load=load, at=at)
        before, after = float(np.interp(at, s.t, s.w)), float(s.w[-1])
        found += [before, after, s.to(s.w, 0.63 * after), s.to(s.w, 0.75 * after)]
        found += [s.to(s.w, before + share * (after - before), at) - at for share in (0.63, 0.75)]
    return found


def p6() -> list[float]:
    return [float(solve(D1._replace(L=0.0), step(10.0), 2.0).w[-1])]


def speed_loop(kp: float, **more: Any) -> Solved:
    return solve(D1._replace(L=0.0), lambda t, w, a: 2.0 * kp * (10.0 - w), 2.0, **more)


def p9(load: float, at: float) -> list[float]:
    s = speed_loop(0.1, load=load, at=at)
    before, after = float(np.interp(at, s.t, s.w)), float(s.w[-1])
    return [before] + [s.to(s.w, before + share * (after - before), at) - at for share in (0.63, 0.75)]


def angle_loop(kp: float, kd: float = 0.0, load: float = 0.0, seconds: float = 3.0) -> Solved:
    """Fig. D-36: the derivative of the error, whose step is a blow of kd volt seconds on the winding."""
    return solve(D1, lambda t, w, a: kp * (1.0 - a) - kd * w, seconds, load=load, kick=kd / D1.L)


def peak(s: Solved) -> tuple[float, float]:
    """Size and time of the largest angle, by a parabola through the three points about it."""
    k = int(np.argmax(s.angle))
    a, b, c = np.polyfit(s.t[k - 1 : k + 2] - s.t[k], s.angle[k - 1 : k + 2], 2)
    return float(c - b * b / (4.0 * a)), float(s.t[k] - b / (2.0 * a))


def settled(s: Solved, final: float, band: float = 0.05) -> float:
    k = int(np.flatnonzero(np.abs(s.angle - final) > band * final)[-1])
    edge = final * (1.0 + band * np.sign(s.angle[k] - final))
    return float(s.t[k] + (edge - s.angle[k]) / (s.angle[k + 1] - s.angle[k]) * (s.t[k + 1] - s.t[k]))


def p14() -> list[float]:
    found = []
    for kp in (0.1, 0.2, 0.5, 1.0, 2.0):
        s = angle_loop(kp, seconds=12.0 if kp < 0.15 else 6.0)
        found += [settled(s, 1.0), s.to(s.angle, 0.9) - s.to(s.angle, 0.1)]
    return found


def p15() -> list[float]:
    found = []
    for kd in (0.01, 0.02, 0.03):
        s = angle_loop(1.0, kd)
        found += [settled(s, 1.0), float(np.trapezoid(s.t * np.abs(1.0 - s.angle), s.t))]
    return found


SOLUTIONS: dict[int, Callable[[], list[float]]] = {
    1: p1, 2: p2, 3: p3, 4: lambda: loaded(-0.1, 0.5), 5: lambda: loaded(-0.2, 1.0), 6: p6,
    7: lambda: shares(speed_loop(0.1)), 8: lambda: shares(speed_loop(1.0)),
    9: lambda: p9(-0.1, 0.5), 10: lambda: [*p9(-0.2, 1.0), float(speed_loop(0.1, load=-0.2, at=1.0).w[-1])],
    12: lambda: list(peak(angle_loop(1.0))), 13: lambda: list(peak(angle_loop(2.0))),
    14: p14, 15: p15,
    16: lambda: [1.0 - float(angle_loop(1.0, load=-0.1, seconds=6.0).angle[-1])],
    17: lambda: [1.0 - float(angle_loop(1.0, load=-0.2, seconds=6.0).angle[-1])],
}  # fmt: skip


A, B, C, D, E, F = ((f"({letter})", 0) for letter in "abcdef")
LOADED = ("before (rad/s)", "after (rad/s)", "63 % (s)", "75 % (s)", "63 % of change (s)", "75 % of change (s)")
WITH_LOAD: list[Place] = [("With the load", row, column) for row in ("D-1", "D-2", "D-3") for column in LOADED]
# where each number of a solution stands
PLACES: dict[int, list[Place]] = {
    1: [A, B, C, D], 2: [("Steady speed", 0), A, B, C, D], 3: [A, B, C, D, E, F], 4: WITH_LOAD, 5: WITH_LOAD,
    6: [("", 0)], 7: [A, B, C, D], 8: [A, B, C, D], 9: [("(a)", 1), B, C], 10: [("(a)", 1), B, C, A],
    12: [B, C], 13: [B, A],
    14: [("By gain", f"kp {kp:g}", column) for kp in (0.1, 0.2, 0.5, 1.0, 2.0)
         for column in ("settled 5 % (s)", "rise (s)")],
    15: [("By gain, derivative of the error", f"kd {kd:g}", column) for kd in (0.01, 0.02, 0.03)
         for column in ("settled 5 % (s)", "ITAE (rad s2)")],
    16: [("By gain", "kd 0", "error (rad)")], 17: [("By gain", "kd 0", "error (rad)")],
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("number", SOLUTIONS)
def test_a_problem_is_right_to_the_printed_digits(number: int) -> None:
    expected = [f"{value:.4g}" for value in SOLUTIONS[number]()]
    assert [printed(answer(number), place) for place in PLACES[number]] == expected


def test_d11_has_the_loop_gain_of_d7() -> None:
    """The gain behind a sensor of 0.2 V s/rad that ends where D-7 ends."""
    end = float(speed_loop(0.1).w[-1])

    def over(kp: float) -> float:
        s = solve(D1._replace(L=0.0), lambda t, w, a: 2.0 * kp * (2.0 - 0.2 * w), 2.0, points=101)
        return float(s.w[-1]) - end

    assert printed(answer(11), ("Which kp", 0)) == f"{brentq(over, 0.1, 2.0):.4g}"


def pid_loop(kp: float, ki: float, kd: float, points: int = 80_001) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fig. D-36 by transfer functions: times, the angle after a step of 1 rad, and after a load of -0.1 N m."""
    m = D1
    motor = np.polyadd(np.polymul([m.L, m.R], [m.J, m.B]), [m.K**2])
    law = m.K * np.array([kd, kp, ki])
    bottom = np.polyadd(np.polymul(motor, [1.0, 0.0, 0.0]), law)
    times = np.linspace(0.0, 20.0, points)
    _, angle = signal.step((law, bottom), T=times)
    _, pushed = signal.step((-0.1 * np.polymul([m.L, m.R], [1.0, 0.0]), bottom), T=times)
    return times, angle, pushed


@pytest.mark.long
@pytest.mark.parametrize("number", [18, 19])
def test_a_pid_design_is_right_to_the_printed_digits(number: int) -> None:
    """The gains are those of the page's values; every figure beside them is worked out again."""
    (table,) = (t for t in answer(number).tables if t.title == "Three designs")
    told = {str(row[0]): [cell_text(cell) for cell in row[1:]] for row in table.rows}
    exact = {str(row[0]): row[1] for row in table.rows}
    t, angle, pushed = pid_loop(*(float(exact[name]) for name in ("KP (V/rad)", "KI (V/(rad s))", "KD (V s/rad)")))
    over = f"{100.0 * (angle.max() - 1.0):.3g}"
    assert over == f"{float(told['overshoot (%)'][0]):.3g}" == {18: "4.3", 19: "2.8"}[number]
    rise = t[np.argmax(angle >= 0.9)] - t[np.argmax(angle >= 0.1)]
    assert float(told["rise (s)"][0]) == pytest.approx(rise, abs=t[1])
    outside = t[np.flatnonzero(np.abs(angle - 1.0) > 0.02)[-1] + 1]
    assert float(told["settled to 2 % (s)"][0]) == pytest.approx(outside, abs=2.0 * t[1])
    assert told["load turns it by (rad)"][0] == f"{np.abs(pushed).max():.4g}"
    assert abs(pushed[-1]) < 1e-6
    on_angle = [float(row[2]) for row in table.rows[:3]]
    t, angle, _ = pid_loop(*on_angle)
    settled_s = t[np.flatnonzero(np.abs(angle - 1.0) > 0.02)[-1] + 1]
    words = " ".join(a.answer for a in answer(number).answers)
    assert f"overshoot by {100.0 * (angle.max() - 1.0):.3g} % and are settled to 2 % after {settled_s:.2f} s" in words
    assert (f"{100.0 * (angle.max() - 1.0):.3g}", f"{settled_s:.2f}") == {18: ("4.11", "0.22"), 19: ("3.68", "0.19")}[
        number
    ]


# ---- labs ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sitting(tmp_path_factory: pytest.TempPathFactory) -> dict[str, LabResult]:
    folder = tmp_path_factory.mktemp("independent")
    with Session.open("sim:nxt_no_load", "no_load", folder, seed=1) as session:
        return {
            "step": open_loop_step(session, (3.0,), Torque(-0.05, 1.0)),
            "sine": open_loop_sine(session, (2.0, 5.0, 10.0)),
            "speed": speed_control(session, (0.5,), (12.0,)),
            "position": position_control(session, PositionPlan(gains=(1.5, 5.0), integrals=(3.0,), torque=None)),
        }


def rows(result: LabResult, title: str, who: str = "ideal") -> list[list[str]]:
    """The rows of one player, as printed."""
    table = next(t for t in result.tables if t.title.startswith(title))
    return [[cell_text(cell) for cell in row] for row in table.rows if who in row]


def of_angle(s: Solved, to_deg: float) -> list[str]:
    """Overshoot, rise and settling to 5 %, as printed to four digits."""
    y = np.degrees(s.angle)
    own = Solved(s.t, s.i, s.w, y)
    over = 100.0 * (peak(own)[0] / to_deg - 1.0)
    rise = s.to(y, 0.9 * to_deg) - s.to(y, 0.1 * to_deg)
    return [f"{over:.3g}", f"{rise:.4g}", f"{settled(own, to_deg):.3g}"]


def position_loop(kp: float, volts: float, amps: float) -> Solved:
    ref = np.radians(160.0)
    return solve(NXT, lambda t, w, a: min(max(kp * (ref - a), -volts), volts), 2.0, amps=amps)


@pytest.mark.long
@pytest.mark.parametrize("kp", [1.5, 5.0])
def test_position_control_is_right_to_the_printed_digits(kp: float, sitting: dict[str, LabResult]) -> None:
    row = next(r for r in rows(sitting["position"], "Proportional") if float(r[0]) == kp)
    found = [f"{float(row[2]):.3g}", row[3], f"{float(row[4]):.3g}"]
    assert found == of_angle(position_loop(kp, 4.5, 1.0), 160.0)


@pytest.mark.parametrize(
    ("limits", "volts", "amps"), [("none", INF, INF), ("voltage", 4.5, INF), ("current", INF, 1.0)]
)
def test_each_limit_is_right_to_the_printed_digits(
    limits: str, volts: float, amps: float, sitting: dict[str, LabResult]
) -> None:
    (row,) = rows(sitting["position"], "Limits of 4.5 V", limits)
    s = position_loop(5.0, volts, amps)
    assert [f"{float(row[1]):.3g}", row[2], f"{float(row[3]):.3g}"] == of_angle(s, 160.0)
    assert f"{float(row[6]):.3g}" == f"{np.max(np.abs(s.w)):.3g}"


def test_the_open_loop_step_is_right_to_the_printed_digits(sitting: dict[str, LabResult]) -> None:
    (row,) = rows(sitting["step"], "Steps of voltage")
    s = solve(NXT, step(3.0), 4.0, amps=1.0)
    assert row[2] == f"{float(s.w[-1]):.4g}"
    assert float(row[4]) == pytest.approx(s.to(s.w, (1.0 - np.exp(-1.0)) * float(s.w[-1])), abs=6e-4)  # a tick
    assert float(row[8]) == pytest.approx(1.0, abs=1e-6)
    free = solve(NXT, step(3.0), 4.0)
    (none,) = rows(sitting["step"], "Limits of", "none")
    assert [none[1], none[3]] == [f"{float(free.w[-1]):.4g}", f"{float(free.i.max()):.4g}"]


@pytest.mark.parametrize("omega", [2.0, 5.0, 10.0])
def test_the_cut_sine_is_right_to_the_printed_digits(omega: float, sitting: dict[str, LabResult]) -> None:
    """The last of so many periods that nothing is left of the start, which a current at its limit hardly damps."""
    period, periods = 2.0 * np.pi / omega, max(4, round(omega))
    s = solve(NXT, lambda t, w, a: min(max(10.0 * np.sin(omega * t), -4.5), 4.5), periods * period, amps=1.0)
    last = s.t >= (periods - 1) * period - 1e-12
    wave = 2.0 / period * np.trapezoid(s.w[last] * np.exp(-1j * omega * s.t[last]), s.t[last]) * 1j / 10.0
    row = next(r for r in rows(sitting["sine"], "Amplitude 10 V", "model") if float(r[1]) == omega)
    assert [row[4], row[6]] == [f"{abs(wave):.4g}", f"{np.degrees(np.angle(wave)):.4g}"]


def test_speed_control_is_right_to_the_printed_digits(sitting: dict[str, LabResult]) -> None:
    s = solve(NXT, lambda t, w, a: min(max(0.5 * (12.0 - w), -4.5), 4.5), 1.5, amps=1.0)
    (row,) = rows(sitting["speed"], "Proportional speed")
    final = float(s.w[s.t > 1.35].mean())
    assert row[3] == f"{final:.4g}"
    assert float(row[7]) == pytest.approx(s.to(s.w, 0.9 * final) - s.to(s.w, 0.1 * final), rel=2e-4)


@pytest.mark.parametrize("kp", [2.0, 3.0, 5.0])
def test_the_elevator_is_right_to_the_printed_digits(kp: float) -> None:
    lift = Motor(2.27, 0.0047, 0.25, 0.0024, 0.002)
    s = solve(lift, lambda t, w, a: min(max(kp * (5.0 / 1.375 - a), -4.5), 4.5), 2.0, load=-0.017, amps=1.0)
    height = Solved(s.t, s.i, s.w, 1.375 * s.angle)
    final = float(height.angle[s.t >= 1.8].mean())
    f = next(moves(ideal(TEXT["elevator"], Design(kp), 1.0))).figures
    rise = s.to(height.angle, 4.5) - s.to(height.angle, 0.5)
    expected = (100.0 * (peak(height)[0] / final - 1.0), settled(height, 5.0), rise, 5.0 - final)
    found = (f.overshoot_pct, f.settling_5_s, f.rise_s, f.steady_state_error)
    assert [f"{x:.3g}" for x in found] == [f"{x:.3g}" for x in expected]


def test_the_characterisation_is_right_to_the_printed_digits() -> None:
    """Ra, Ki, B and J of the text's own readings by scipy's regression: tables D-4 and D-5, Fig. D-19."""
    readings = Readings.load(ROOT / "docs" / "labs" / "nxt_readings.toml")
    volts, amps = (np.array(column) for column in zip(*readings.stall, strict=True))
    Ra = float(volts @ amps / (amps @ amps))
    slope = float(stats.linregress(*(np.array(column) for column in zip(*readings.lift, strict=True))).slope)
    w, i = 7.636, 0.041
    Kb = (2.0 - Ra * i) / w
    Ki = brentq(lambda k: k + k * i / w * Ra / Kb - 1.0 / slope, 0.1, 0.5)
    B = Ki * i / w
    found = characterise(readings, 0.0047, "readings")
    told = {str(row[0]): cell_text(row[2]) for row in found.tables[0].rows}
    assert told["Ra"] == f"{Ra:.4g}"
    assert told["Kb"] == f"{Kb:.4g}"
    assert told["Ki"] == f"{Ki:.4g}"
    assert told["B"] == f"{B:.4g}"
    assert told["J"] == f"{0.081 * (B + Ki * Kb / Ra):.4g}"
