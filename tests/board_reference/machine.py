"""The machine in time: which regime holds, the events that end it, and what happens at each of them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from firmware_model.plants import Plant

from . import laws
from .constants import PULSES, STATES, effective, opens, record
from .encoder import Encoder

RTOL, ATOL = 1e-12, 1e-13
LONGEST_S = 0.0025  # of a step, so that no two events hide in one
STANDBY, DRIVEN = 0, 1


def sign(value: float) -> float:
    return float(value > 0.0) - float(value < 0.0)


@dataclass
class State:
    """Where a run starts: angle, speed, current, load's angle and speed, bristle, warmths; contact; on the stop."""

    x: np.ndarray = field(default_factory=lambda: np.zeros(STATES))
    contact: float = 0.0
    resting: bool = False


class Margin:
    """One event for solve_ivp: falls through zero where the regime ends; a hair above it where the regime begins."""

    terminal = True
    direction = -1.0

    def __init__(self, which: int, c: Any) -> None:
        self.which, self.c = which, c
        self.start, self.way = 0.0, 1.0

    def __call__(self, t: float, x: np.ndarray) -> float:
        value = self.way * laws.margin(self.which, t, x, self.c)
        return max(value, 1e-14) if t == self.start else value


class Reference:
    """Angles of a plant driven by duties held for ``span_s`` each, from rest at time 0 or from a given state.

    ``edges``: every period of the PWM in its two parts, in place of their mean.
    """

    def __init__(self, plant: Plant, start: State, rtol: float = RTOL, atol: float = ATOL, edges: bool = False) -> None:
        self.plant, self.rtol, self.atol = plant, rtol, atol
        self.c = record(plant)
        self.q = self.c[0]
        self.x = np.array(start.x, float)
        self.contact, self.resting = start.contact, start.resting
        self.margins = [Margin(which, self.c) for which in range(laws.MARGINS)]
        gap, spring = plant.effects.get("backlash", {}), plant.effects.get("shaft_compliance", {})
        self.half, self.load_j = float(self.q["half"]), float(self.q["load_J"])
        self.after = gap.get("side") == "encoder_after_gap" or spring.get("side") == "encoder_after_spring"
        self.way = sign(self.q["stop"])
        self.delay = plant.effects.get("transport_delay", {}).get("delay_s", 0.0)
        self.change = plant.effects.get("parameter_change", {})
        self.smooth = plant.effects.get("supply_sag", {}).get("smoothing") != "none"
        self.stride = LONGEST_S
        self.edges, self.drop = edges, float(self.q["drop"])
        self.encoder = Encoder(plant, self.disc)

    @property
    def disc(self) -> float:
        """Angle of the encoder's disc, rad."""
        return float(self.x[3] if self.after else self.x[0])

    # -- laws at the present state

    def motor(self, t: float) -> float:
        return float(laws.motor_torque(t, self.x, self.c))

    def starts(self, t: float, torque: float, stopped: bool) -> float:
        """Direction in which a torque moves what is at rest; 0: held."""
        side = sign(torque)
        if side == 0.0 or (stopped and side == self.way):
            return 0.0
        return side if abs(torque) > laws.hold(t, self.x, side, self.c) else 0.0

    # -- choice of the regime

    def choose_current(self, t: float, fired: int) -> list[int]:
        q, c, x = self.q, self.c, self.x
        q["limited"] = 0.0
        if q["L"] == 0.0:
            q["flow"] = 0.0
            if q["standby"]:
                return []
            kinks = [laws.LOSS] if q["drop"] > 0.0 else []
            kinks += [laws.CLAMP] if q["limit"] < math.inf else []
            return kinks + ([laws.NO_CURRENT] if q["tooth"] > 0.0 else [])
        if fired == laws.CURRENT_END:
            x[2] = 0.0
        kinks = [laws.NO_CURRENT] if q["tooth"] > 0.0 else []
        if q["standby"]:
            q["flow"] = sign(x[2])
            return [laws.CURRENT_END] if q["flow"] else []
        if q["fast"]:
            return self.choose_pulses(t, fired) + kinks
        if q["drop"] == 0.0:
            q["flow"] = sign(x[2]) or 1.0
            watched = kinks
        else:
            volts = laws.push(t, x, c)
            q["flow"] = sign(x[2])
            if x[2] == 0.0 and (abs(volts) > q["drop"] or fired == laws.CURRENT_START):
                q["flow"] = sign(volts)
            if q["flow"] == 0.0:
                return [laws.CURRENT_START]
            watched = [laws.CURRENT_END]
        return self.choose_limit(t, fired, watched)

    def choose_limit(self, t: float, fired: int, watched: list[int]) -> list[int]:
        """Whether the current stands at its limit; what to watch besides ``watched``."""
        q, c, x = self.q, self.c, self.x
        if q["limit"] == math.inf:
            return watched
        if fired == laws.LIMIT or abs(x[2]) >= q["limit"]:
            way = sign(x[2])
            x[2] = way * q["limit"]
            if fired != laws.UNLIMIT and way * laws.outward(t, x, c) > 0.0:
                q["limited"] = way
        return [*watched, laws.UNLIMIT if q["limited"] else laws.LIMIT]

    def choose_pulses(self, t: float, fired: int) -> list[int]:
        """Fast decay: against the duty, without a gap, or in pulses that cease in every period."""
        q, c, x = self.q, self.c, self.x
        way = sign(q["duty"])
        late, mean, meets = laws.pulse(t, x, c)
        i = way * x[2]
        returns = fired == laws.RETURNED or way * q["Ke"] * x[1] > laws.full_volts(t, x, c) + q["drop"]
        if i < 0.0 or (i == 0.0 and returns):
            q["flow"] = -way
            return self.choose_limit(t, fired, [laws.CURRENT_END])
        if fired != laws.UNBROKEN and (fired == laws.CEASING or (late < 0.0 and (meets or i <= mean + 1e-12))):
            q["flow"] = PULSES
            return [laws.UNBROKEN, laws.RETURNED]
        q["flow"] = way
        return self.choose_limit(t, fired, [laws.CEASING])

    def choose_motor(self, t: float, fired: int, torque: float, stopped: bool) -> list[int]:
        """The motor alone, or all there is: sliding or held."""
        q, c, x = self.q, self.c, self.x
        if x[1] != 0.0:
            q["side"] = sign(x[1])
        elif fired == laws.START:
            up = laws.hold(t, x, 1.0, c) - torque
            q["side"] = 1.0 if up < laws.hold(t, x, -1.0, c) + torque else -1.0
            if stopped:
                q["side"] = -self.way
        else:
            q["side"] = self.starts(t, torque, stopped)
        free = q["bristle"] > 0.0 and not (stopped and torque * self.way >= 0.0)
        q["held"] = float(q["side"] == 0.0 and not free)
        if q["held"]:
            return [laws.START]
        return [laws.TURN] if q["side"] else []

    def choose_one(self, t: float, fired: int) -> list[int]:
        q, x = self.q, self.x
        if fired == laws.TURN:
            x[1] = 0.0
        if fired == laws.END:
            x[0], x[1], self.resting = q["stop"], 0.0, True
        watched = self.choose_motor(t, fired, self.motor(t), self.resting)
        if not q["held"]:
            self.resting = False
        q["resting"] = float(self.resting)
        return watched + ([laws.END] if self.way and not self.resting else [])

    def choose_two(self, t: float, fired: int) -> list[int]:
        q, x = self.q, self.x
        if fired == laws.TURN:
            x[1] = 0.0
        if fired == laws.END:
            x[3], x[4], self.resting = q["stop"], 0.0, True
            if self.contact == self.way:
                x[1] = 0.0
            else:
                self.contact = 0.0
        if fired == laws.LOAD_START:
            self.resting = False
        if fired == laws.PULL:
            self.contact = 0.0
        rigid = q["stiffness"] == 0.0
        if rigid and fired in (laws.WALL_UP, laws.WALL_DOWN):
            self.contact = 1.0 if fired == laws.WALL_UP else -1.0
            common = x[1] + (x[4] - x[1]) * q["load_J"] / q["J"]
            x[1] = x[4] = 0.0 if self.resting and common * self.way > 0.0 else common
        if self.contact:
            x[3], x[4] = x[0] - self.contact * self.half, x[1]
            if x[1]:
                self.resting = False
        q["resting"], q["contact"] = float(self.resting), self.contact
        if not rigid:
            self.press(fired)
        if self.contact and fired != laws.START and x[1] == 0.0:
            alone = self.starts(t, self.motor(t), False)
            q["held"] = float(alone == 0.0 and not q["bristle"])
            self.part(t, alone)
        elif self.contact and x[1] != 0.0:
            q["held"] = 0.0
            self.part(t, sign(x[1]))
        return self.watch_two(t, fired, rigid)

    def part(self, t: float, side: float) -> None:
        motor, load = laws.apart(t, self.x, side, self.c)
        if (motor - load) * self.contact < 0.0:
            self.contact = self.q["contact"] = 0.0

    def watch_two(self, t: float, fired: int, rigid: bool) -> list[int]:
        q, c, x = self.q, self.c, self.x
        if self.contact:
            watched = self.choose_motor(t, fired, self.motor(t) + laws.load_torque(x, c), self.resting)
            if not q["held"]:
                self.resting = False
            watched += [laws.PULL]
        else:
            watched = self.choose_motor(t, fired, self.motor(t), False)
            if self.resting and laws.load_torque(x, c) * self.way < 0.0:
                self.resting = False
            if self.resting:
                watched += [laws.LOAD_START]
            if rigid:
                watched += [laws.WALL_UP, laws.WALL_DOWN]
            elif self.half:
                watched += [laws.PRESS_UP, laws.PRESS_DOWN]
        q["resting"] = float(self.resting)
        return watched + ([laws.END] if self.way and not self.resting else [])

    def press(self, fired: int) -> None:
        """A spring with play in it pushes at one face or at none."""
        q, c, x = self.q, self.c, self.x
        if not self.half:
            q["pressed"] = 0.0
        elif fired in (laws.PRESS_UP, laws.PRESS_DOWN):
            face = 1.0 if fired == laws.PRESS_UP else -1.0
            q["pressed"] = 0.0 if q["pressed"] == face else face
        elif fired < 0:
            face = sign(x[0] - x[3])
            closed = abs(x[0] - x[3]) > self.half and face * laws.coupling(x, face, c) > 0.0
            q["pressed"] = face if closed else 0.0

    # -- time

    def run(self, t: float, end: float) -> None:
        """One command, to ``end``."""
        fired = -1
        for _ in range(10000):
            watched = self.choose_current(t, fired)
            watched += (self.choose_two if self.load_j else self.choose_one)(t, fired)
            if self.q["bristle"] > 0.0 and self.q["forward"] != self.q["reverse"]:
                watched.append(laws.BRISTLE)
            if self.load_j and self.encoder.share:
                watched.append(laws.LOAD_TURN)
            t, fired = self.solve(t, end, watched, fired)
            if self.q["flow"] == PULSES:
                self.x[2] = laws.current(t, self.x, self.c)
            if self.half and not self.load_j:
                self.x[3] = min(max(self.x[3], self.x[0] - self.half), self.x[0] + self.half)
            self.encoder.follow(self.disc)
            if t >= end:
                return
        raise AssertionError("too many events in one hold")

    def solve(self, t: float, end: float, watched: list[int], fired: int) -> tuple[float, int]:
        """On to the next event or the end; returns the time and the event."""
        c = self.c
        events = [self.margins[which] for which in watched]
        for event in events:
            event.start = t
            if event.which >= laws.FIRST_KINK:
                event.way = -event.way if event.which == fired else sign(laws.margin(event.which, t, self.x, c)) or 1.0
        result = solve_ivp(
            lambda now, x: laws.rates(now, x, c),
            (t, end),
            self.x,
            method="DOP853",
            events=events,
            max_step=LONGEST_S,
            first_step=min(self.stride, end - t),
            rtol=self.rtol,
            atol=self.atol,
        )
        assert result.status >= 0, result.message
        self.x = result.y[:, -1].copy()
        if len(result.t) > 2:
            self.stride = max(min(result.t[-2] - result.t[-3], LONGEST_S), 1e-7)
        if result.status == 0:
            return end, -1
        first = next(i for i, times in enumerate(result.t_events) if len(times))
        return float(result.t[-1]), watched[first]

    def angles(
        self, modes: np.ndarray, duties: np.ndarray, span_s: float, first: int = 0, last: int | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Angle that the disc shows in rad, and the counter, before each hold from ``first`` to ``last`` and after."""
        last = len(duties) if last is None else last
        seen, counts = [], []
        act = np.arange(len(duties)) * span_s + self.delay
        change_at = self.change.get("time_s", math.inf)
        j = 0
        for k in range(first, last + 1):
            seen.append(self.encoder.shown(self.disc))
            counts.append(self.encoder.count)
            if k == last:
                break
            now, stop = k * span_s, (k + 1) * span_s
            while now < stop:
                while j < len(act) and act[j] <= now + 1e-12:
                    j += 1
                until = min(stop, act[j] if j < len(act) else math.inf)
                if now < change_at - 1e-12:
                    until = min(until, change_at)
                sent = (int(modes[j - 1]), float(duties[j - 1])) if j else (STANDBY, 0.0)
                if self.edges:
                    until = self.segment(now, until, *sent)
                else:
                    self.command(*sent)
                if now >= change_at - 1e-12:
                    self.q[self.change["which"]] = self.change["ratio"]
                self.run(now, until)
                now = until
        return np.array(seen), np.array(counts)

    def command(self, mode: int, duty: float) -> None:
        """A command at the bridge, averaged over a period; fast decay without pulses leaves it open."""
        q = self.q
        q["duty"] = effective(self.plant, duty)
        q["fast"] = float(mode == DRIVEN and opens(self.plant))
        q["standby"] = float(mode == STANDBY or (q["fast"] and q["duty"] == 0.0))
        share = abs(q["duty"]) / 100.0
        q["sag"] = q["source"] * (share**2 if self.smooth else share)

    def segment(self, t: float, end: float, mode: int, duty: float) -> float:
        """The bridge in one part of a period of the PWM, its edges resolved; returns the time of the next edge."""
        self.command(mode, duty)
        q = self.q
        q["drop"] = self.drop
        if mode != DRIVEN:
            return end
        share, way = min(abs(q["duty"]) / 100.0, 1.0), sign(q["duty"])
        period = math.floor(t / q["period"] + 1e-6)
        q["standby"] = q["fast"] = q["sag"] = 0.0
        if t / q["period"] - period < share - 1e-6:
            # With a capacitor the pulse bears the mean over a period of what the supply's resistance takes.
            q["duty"], q["sag"] = 100.0 * way, q["source"] * (share if self.smooth else 1.0)
            return min(end, (period + share) * q["period"])
        if opens(self.plant):
            # Open: the current runs down against the supply, through a pair of diodes.
            q["duty"] = way
            q["drop"] += laws.full_volts(t, self.x, self.c) + q["diode"] if way else q["supply"] - self.drop
        q["duty"] = 0.0
        return min(end, (period + 1) * q["period"])
