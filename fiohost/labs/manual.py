"""Manual control, scripted: what a hand on the slider sees, as tables.

Duty in a staircase up and down through both directions, the speed that each step settles to, the duty at which the
shaft starts, and how it comes to rest in brake and in standby.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from fiohost.bench.deadband import Deadband, measure_deadband
from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.program import OpenLoop
from fiohost.bench.signals import Staircase
from fiohost.errors import DataError
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

UP_PCT = (0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 40.0, 60.0, 80.0, 100.0)
NEAR_START = (0.75, 0.9, 1.1, 1.3)  # more steps, at these shares of the duty at which it starts
STEP_S = 1.0
SETTLED = 0.5  # the last share of a step, over which its speed is taken
MOVING_DEG_S = 1.5  # slower is at rest: a count in half a second
SHOWN_UP_TO_PCT = 30.0  # above it the angle's picture is all stripes
RUN_UP_S, WATCH_S = 1.5, 3.0
# Table 2.1 of the lab text, and Fig. 2.9 for motor B as this lab connects it
WIRING = Table(
    "Wiring: driver board to FiO Lite (INC451, table 2.1; this lab, Fig. 2.9)",
    ("signal", "driver port", "pin", "this lab"),
    (
        ("direction 1, motor A", "Da1", "C1", None),
        ("direction 2, motor A", "Da2", "C2", None),
        ("PWM, motor A", "Pa", "C6", None),
        ("direction 1, motor B", "Db1", "C3", "C3"),
        ("direction 2, motor B", "Db2", "C4", "C4"),
        ("PWM, motor B", "Pb", "C7", "A3, the board's PWM output"),
        ("encoder channel 1", None, None, "A8"),
        ("encoder channel 2", None, None, "A9"),
    ),
    given=(0, 1, 2, 3),
)


@dataclass(frozen=True)
class Line:
    """Speed = gain (duty - friction), through the steps of one direction that turn."""

    gain_deg_s_per_pct: float
    friction_pct: float


@dataclass(frozen=True)
class Rest:
    """How the shaft came to rest: time and angle from the command that ended the drive."""

    after_s: float
    turned_deg: float


@dataclass(frozen=True)
class Branch:
    """One direction: the signed duty of each step (n,), and its speed on the way up and on the way down (n,)."""

    duty_pct: Array
    up_deg_s: Array
    down_deg_s: Array

    def line(self) -> Line:
        """Raises DataError where the shaft turned at fewer than two duties."""
        duty = np.concatenate([self.duty_pct, self.duty_pct])
        speed = np.concatenate([self.up_deg_s, self.down_deg_s])
        turns = np.abs(speed) > MOVING_DEG_S
        if np.unique(duty[turns]).size < 2:
            raise DataError("the shaft hardly turned: check the supply, the wiring and the pull-ups of C3 and C4")
        gain, offset = np.polyfit(duty[turns], speed[turns], 1)
        return Line(float(gain), float(-offset / gain))

    def sticks(self) -> NDArray[np.bool_]:
        """Where it stood on the way up and turned on the way down, shape (n,)."""
        return np.asarray((np.abs(self.up_deg_s) <= MOVING_DEG_S) & (np.abs(self.down_deg_s) > 2.0 * MOVING_DEG_S))

    def last_at_rest_pct(self, speed: Array) -> float:
        """The largest duty at which it stood still, with its sign."""
        still = np.flatnonzero(np.abs(speed) <= MOVING_DEG_S)
        return float(self.duty_pct[still[-1]]) if still.size else 0.0

    def slowest_turning_pct(self, speed: Array) -> float:
        """The smallest duty at which it turned, with its sign. There is one: :meth:`line` has been asked."""
        return float(self.duty_pct[np.flatnonzero(np.abs(speed) > MOVING_DEG_S)[0]])


def manual_control(bench: Bench, folder: Path) -> LabResult:
    """The whole observation on one bench; logs go to *folder*. Raises FiohostError where the shaft does not turn."""
    limit = bench.profile.limit_duty_pct
    deadband = measure_deadband(bench, repeats=3, max_pct=limit)
    start_pct = (deadband.u_plus_pct - deadband.u_minus_pct) / 2.0
    near = {round(share * start_pct, 1) for share in NEAR_START}
    ups = tuple(sorted(duty for duty in {*UP_PCT, *near} if duty <= limit))
    stairs_path, rests_path = folder / "manual_staircase.csv", folder / "manual_rests.csv"
    stairs = bench.run(_staircase(ups, bench.sample_time_s), stairs_path)
    forward, reverse = branches(stairs, ups)
    rest_duty = min(limit, max(60.0, 1.5 * max(deadband.u_plus_pct, -deadband.u_minus_pct)))
    braked, coasted = _rests(bench, rest_duty, rests_path)
    lines = {"forward": forward.line(), "reverse": reverse.line()}
    values: dict[str, Any] = {
        "u_plus_pct": deadband.u_plus_pct,
        "u_minus_pct": deadband.u_minus_pct,
        "u_plus_spread_pct": deadband.spread_pct(True),
        "u_minus_spread_pct": deadband.spread_pct(False),
        "brake_s": braked.after_s,
        "brake_deg": braked.turned_deg,
        "standby_s": coasted.after_s,
        "standby_deg": coasted.turned_deg,
    }
    for way, line in lines.items():
        values[f"{way}_gain_deg_s_per_pct"] = line.gain_deg_s_per_pct
        values[f"{way}_dry_friction_pct"] = line.friction_pct
    values["sticks_at_pct"] = [duty for b in (forward, reverse) for duty in b.duty_pct[b.sticks()].tolist()]
    return LabResult(
        name="manual",
        title="Manual control: duty, direction bits, angle and speed",
        target=bench.transport.name,
        tables=(WIRING, _speeds(forward, reverse), _modes(forward, reverse, rest_duty, braked, coasted)),
        answers=(
            _on_modes(forward, reverse, rest_duty, braked, coasted),
            _on_angle(stairs, bench.counts_per_rev),
            _on_deadband(deadband, forward, reverse),
            _on_friction(lines, deadband, (forward, reverse)),
        ),
        notes=tuple(deadband.notes()),
        values=values,
        figures={
            "manual_speed": lambda: _plot_speed(forward, reverse, lines, deadband, bench.transport.name),
            "manual_angle": lambda: _plot_angle(stairs, bench.transport.name),
        },
        files={"log of the staircase": str(stairs_path), "log of brake and standby": str(rests_path)},
    )


# ---- runs ----------------------------------------------------------------------------------------------------------


def _staircase(ups: tuple[float, ...], sample_time_s: float) -> Experiment:
    """Up and down forward, then up and down in reverse; at 0 it brakes."""
    there = (*ups, *reversed(ups))
    levels = (*there, *(-duty for duty in there))
    signal = Staircase(levels=levels, step_s=STEP_S, duration_s=STEP_S * len(levels))
    return Experiment("manual_staircase", (signal,), sample_time_s=sample_time_s)


def branches(log: Log, ups: tuple[float, ...]) -> tuple[Branch, Branch]:
    """Forward and reverse of the staircase's log: the speed of each step over its settled end."""
    time_s, angle = log.time_s, log.output
    speeds = []
    for i in range(4 * len(ups)):
        begin, end = (np.searchsorted(time_s, [(i + 1 - SETTLED) * STEP_S, (i + 1) * STEP_S - 1e-9])).tolist()
        end = min(end, time_s.size - 1)
        speeds.append((angle[end] - angle[begin]) / (time_s[end] - time_s[begin]))
    up, down, up_reverse, down_reverse = np.array(speeds).reshape(4, len(ups))
    duty = np.array(ups)
    return Branch(duty, up, down[::-1]), Branch(-duty, up_reverse, down_reverse[::-1])


def _rests(bench: Bench, duty_pct: float, path: Path) -> tuple[Rest, Rest]:
    """Run up and brake, run up and coast."""
    run_up, watch = (round(s / bench.sample_time_s) for s in (RUN_UP_S, WATCH_S))
    drive = [Command.drive(duty_pct)] * run_up
    program = OpenLoop([*drive, *[BRAKE_COMMAND] * watch, *drive, *[STANDBY_COMMAND] * watch])
    log = bench.play(program, path, {"experiment": "manual_rests", "loop": "open"})
    ends = [k * bench.sample_time_s for k in (run_up, 2 * run_up + watch)]
    return _rest(log, ends[0], ends[0] + WATCH_S), _rest(log, ends[1], ends[1] + WATCH_S)


def _rest(log: Log, from_s: float, until_s: float) -> Rest:
    chosen = (log.time_s >= from_s - 1e-9) & (log.time_s < until_s - 1e-9)
    time_s, angle = log.time_s[chosen], log.output[chosen]
    changes = np.flatnonzero(np.diff(angle))
    last = int(changes[-1]) + 1 if changes.size else 0
    return Rest(float(time_s[last] - from_s), float(abs(angle[-1] - angle[0])))


# ---- what is said --------------------------------------------------------------------------------------------------


def _speeds(forward: Branch, reverse: Branch) -> Table:
    columns = ("duty %", "forward, up deg/s", "forward, down deg/s", "reverse, up deg/s", "reverse, down deg/s")
    rows = np.column_stack(
        [forward.duty_pct, forward.up_deg_s, forward.down_deg_s, reverse.up_deg_s, reverse.down_deg_s]
    )
    title = "Speed against duty, steps of 1 s (reverse: the duty is negative)"
    return Table(title, columns, rows.round(1).tolist(), given=())  # steps lie about the dead zone that was found


def _modes(forward: Branch, reverse: Branch, duty_pct: float, braked: Rest, coasted: Rest) -> Table:
    fast = int(np.argmin(np.abs(forward.duty_pct - duty_pct)))
    columns = ("C3", "C4", "mode", "duty %", "what the shaft did")
    rows = [
        [1, 0, "forward", forward.duty_pct[fast], f"{forward.up_deg_s[fast]:+.0f} deg/s"],
        [0, 1, "reverse", reverse.duty_pct[fast], f"{reverse.up_deg_s[fast]:+.0f} deg/s"],
        [1, 1, "brake", 0.0, f"at rest after {braked.after_s:.2f} s and {braked.turned_deg:.0f} deg"],
        [0, 0, "standby", 0.0, f"at rest after {coasted.after_s:.2f} s and {coasted.turned_deg:.0f} deg"],
    ]
    return Table("The direction bits", columns, rows, given=(0, 1, 3))


def _on_modes(forward: Branch, reverse: Branch, duty_pct: float, braked: Rest, coasted: Rest) -> Answer:
    up, down = forward.up_deg_s[-1], reverse.up_deg_s[-1]
    ratio = coasted.after_s / max(braked.after_s, 1e-3)
    way = f"{ratio:.1f} times as long" if ratio > 1.1 else "no longer: friction alone stops it as fast"
    return Answer(
        "How do duty and the two bits set direction and speed, and how do brake and standby differ?",
        f"1 0 turns forward ({up:+.0f} deg/s at {forward.duty_pct[-1]:g} %), 0 1 in reverse ({down:+.0f} deg/s), and "
        f"the duty's size sets the speed. From {duty_pct:g} % the brake (1 1) needs {braked.after_s:.2f} s and "
        f"{braked.turned_deg:.0f} deg to rest, standby (0 0) {coasted.after_s:.2f} s and {coasted.turned_deg:.0f} deg, "
        f"{way}: braking shorts the motor, which then works against its own turning; in standby only friction does.",
    )


def _on_angle(log: Log, counts_per_rev: int) -> Answer:
    pos, direction = log.columns["pos"], log.columns["direction"]
    steps = np.diff(log.output)
    moved = steps != 0.0
    right = float(np.mean((steps[moved] < 0) == (direction[1:][moved] == 1))) if moved.any() else 0.0
    wraps = int(np.sum(np.abs(np.diff(pos)) > counts_per_rev / 2))
    deg = 360.0 / counts_per_rev
    return Answer(
        "How do encoder counts become an angle of 0 to 360 degrees?",
        f"POS ran from {pos.min():.0f} to {pos.max():.0f}, {counts_per_rev} a turn, beginning anew {wraps} times."
        f" (POS+1) x {deg:g} shows {(pos.min() + 1) * deg:g} to {(pos.max() + 1) * deg:g} deg in steps of {deg:g}. The "
        f"direction bit agreed with the movement in {100 * right:.1f} % of the ticks in which the count changed (0 up, "
        "1 down); at rest it keeps its last value.",
    )


def _on_deadband(deadband: Deadband, forward: Branch, reverse: Branch) -> Answer:
    return Answer(
        "From which duty does the motor start, in each direction?",
        f"forward from u+ = {deadband.u_plus_pct:.2f} % (spread {deadband.spread_pct(True):.2f}), in reverse from "
        f"u- = {deadband.u_minus_pct:.2f} % (spread {deadband.spread_pct(False):.2f}), by slow ramps from rest. In the "
        f"staircase it stood still up to {forward.last_at_rest_pct(forward.up_deg_s):g} % and turned from "
        f"{forward.slowest_turning_pct(forward.up_deg_s):g} %; in reverse up to "
        f"{reverse.last_at_rest_pct(reverse.up_deg_s):g} % and from "
        f"{reverse.slowest_turning_pct(reverse.up_deg_s):g} %.",
    )


def _on_friction(lines: Mapping[str, Line], deadband: Deadband, sides: Sequence[Branch]) -> Answer:
    said = [
        f"{way}: {line.gain_deg_s_per_pct:.2f} deg/s for each percent beyond {line.friction_pct:+.2f} %"
        for way, line in lines.items()
    ]
    starts = (deadband.u_plus_pct, deadband.u_minus_pct)
    beyond = max(abs(u) - abs(line.friction_pct) for u, line in zip(starts, lines.values(), strict=True))
    sticking = [duty for branch in sides for duty in branch.duty_pct[branch.sticks()].tolist()]
    if sticking:
        shown = ", ".join(f"{duty:+g}" for duty in sticking)
        verdict = (
            f"At {shown} % it stood on the way up and turned on the way down: static friction above the sliding one."
        )
    elif beyond > 0.5:
        verdict = (
            f"It starts {beyond:.1f} % beyond where the line meets zero, at the same duty on both ways: so it is not "
            "static friction, the line is bent near zero, as with a bridge that opens between its pulses."
        )
    else:
        verdict = "It starts where the line meets zero speed: no static friction above the sliding one is seen."
    return Answer(
        "What do dry and viscous friction do to the speed?",
        f"{'; '.join(said)}. What the line lacks at zero speed is dry (Coulomb) friction: the duty it eats is the same "
        "at every speed, turns round with the direction and makes the dead zone. Viscous friction and the motor's own "
        f"voltage are in the slope, and speeds alone cannot part them. {verdict}",
    )


# ---- pictures ------------------------------------------------------------------------------------------------------


def _plot_speed(
    forward: Branch, reverse: Branch, lines: Mapping[str, Line], deadband: Deadband, target: str
) -> Figure:  # fmt: skip
    from fiohost.report.panels import Curve, Panel, plot_panels

    curves = []
    for i, (branch, line) in enumerate(zip((forward, reverse), lines.values(), strict=True)):
        ends = np.array([line.friction_pct, branch.duty_pct[-1]])
        label = f"{line.gain_deg_s_per_pct:.2f} deg/s per % beyond {line.friction_pct:+.2f} %"
        curves += [
            Curve(ends, line.gain_deg_s_per_pct * (ends - line.friction_pct), label, 0, "model"),
            Curve(branch.duty_pct, branch.up_deg_s, "" if i else "step up", 1, "points"),
            Curve(branch.duty_pct, branch.down_deg_s, "" if i else "step down", -2, "crosses"),
        ]
    near = 3.0 * max(deadband.u_plus_pct, -deadband.u_minus_pct)
    gain = max(line.gain_deg_s_per_pct for line in lines.values())
    starts = (deadband.u_minus_pct, deadband.u_plus_pct)
    marks = [
        Curve([u, u], [-gain * near, gain * near], "" if i else "starts here", 2, "ideal") for i, u in enumerate(starts)
    ]
    inside = [
        Curve(c.x, c.y, "" if c.style == "model" else c.label, c.case, c.style) for c in curves
    ]  # the same curves, seen near zero
    return plot_panels(
        [
            Panel(curves, "speed (deg/s)", "duty (%)", "Speed against duty"),
            Panel([*inside, *marks], "speed (deg/s)", "duty (%)", "Near zero: the dead zone",
                  x_limits=(-near, near), y_limits=(-gain * near, gain * near)),
        ],
        f"Steady speed of each step: {target}",
        panel_height=3.6,
    )  # fmt: skip


def _plot_angle(log: Log, target: str) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    begin = float(log.time_s[np.flatnonzero(log.duty_pct)[0]])
    beyond = np.flatnonzero((np.abs(log.duty_pct) > SHOWN_UP_TO_PCT) & (log.time_s > begin))
    shown = slice(0, int(beyond[0]) if beyond.size else len(log))
    time_s = log.time_s[shown]
    angle = (log.columns["pos"][shown] + 1) * log.output_quantum
    angle[np.abs(np.diff(angle, prepend=angle[:1])) > 180.0] = np.nan
    return plot_panels(
        [
            Panel([Curve(time_s, log.duty_pct[shown], case=-2, style="reference")], "duty (%)", title="What is sent"),
            Panel([Curve(time_s, angle, case=0, style="reference")], "angle (deg)", title="Angle shown, (POS+1)/2",
                  y_limits=(0.0, 360.0)),
        ],
        f"The first steps of the staircase: {target}",
        panel_height=2.4,
    )  # fmt: skip
