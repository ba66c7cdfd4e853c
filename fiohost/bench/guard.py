"""Whether the motor follows what it is told: a shaft that stands, turns against its command, or cannot be where the
encoder says. Looked at in each tick, between command and wire; thresholds are the target's ``[guards]``.

A stall is judged as a fuse judges it: heat grows with the square of the current, so ``stall_s`` is for full duty, and
half the duty may last four times as long.
"""

from __future__ import annotations

import math
from collections import deque

from fiohost.errors import GuardError
from fiohost.transport.profile import Guards
from fiohost.wire.messages import DRIVE, Command

STALL_COUNTS = 4  # a shaft that moved no further stands
COOLING = 0.1  # of the heat that full duty brings, goes in the same time without duty: pulses add up
STRONG_PCT = 20.0  # from here on a duty is expected to decide which way the shaft turns
SPEED_TICKS = 10  # over which a speed is measured
FASTER_DEG_S = 60.0  # than when the duty came on: then it is not only running down
GLITCHES = 5  # so many readings that cannot be ...
GLITCH_TICKS = 20  # ... in so many ticks: not single damaged reports


class MotorGuard:
    """The guards of one run. *patience*: a program that stalls on purpose may stall so many times longer."""

    def __init__(self, guards: Guards, sample_time_s: float, counts_per_rev: int, patience: float = 1.0) -> None:
        self._guards, self._tick_s = guards, sample_time_s
        self._stall_s = guards.stall_s * patience
        self._stall_deg = STALL_COUNTS * 360.0 / counts_per_rev
        self._stood_deg: float  # where the shaft stands
        self._heat_s: float  # since it does
        self._held_pct: float  # the duty of the tick before
        self._seen: deque[tuple[int, float]] = deque(maxlen=SPEED_TICKS + 1)
        self._glitches: deque[float] = deque(maxlen=GLITCH_TICKS)  # speeds that cannot be, else 0
        self._sign = 0.0  # of the strong duty that acts now
        self._far_deg: float  # the furthest that it has brought the shaft
        self._against_deg_s: float  # how fast that ran the other way when the duty came on

    def check(self, k: int, command: Command, angle_deg: float) -> None:
        """Tick *k*: what is to be sent, and where the shaft is. Raises GuardError."""
        if self._seen:
            last_k, last_deg = self._seen[-1]
            since_s = max(1, k - last_k) * self._tick_s
            self._plausible(abs(angle_deg - last_deg) / since_s)
            self._stall(since_s, angle_deg)
            if k - last_k > SPEED_TICKS:  # by then it may have turned by more than half a turn: which way, nobody saw
                self._seen.clear()
                self._sign = 0.0
        else:
            self._stood_deg, self._heat_s = angle_deg, 0.0
        self._seen.append((k, angle_deg))
        self._held_pct = command.duty_pct if command.mode == DRIVE else 0.0
        self._direction(self._held_pct, angle_deg)

    def _plausible(self, speed_deg_s: float) -> None:
        is_glitch = speed_deg_s > self._guards.speed_deg_s
        self._glitches.append(speed_deg_s if is_glitch else 0.0)
        found = sum(map(bool, self._glitches))
        if is_glitch and found >= GLITCHES:
            raise GuardError(
                f"the encoder says things that cannot be: {found} of the last {len(self._glitches)} "
                f"readings are jumps, up to {max(self._glitches):.0f} deg/s, beyond guards.speed_deg_s = "
                f"{self._guards.speed_deg_s:g}: braked; check the encoder's wires, its supply and the reports' layout"
            )

    def _stall(self, since_s: float, angle_deg: float) -> None:
        """So long the board has held the duty of the tick before: ticks that the host missed count as well."""
        duty_pct = self._held_pct
        if abs(angle_deg - self._stood_deg) > self._stall_deg:
            self._stood_deg, self._heat_s = angle_deg, 0.0
            return
        if not duty_pct:
            self._heat_s = max(0.0, self._heat_s - COOLING * since_s)
            return
        self._heat_s += (0.01 * duty_pct) ** 2 * since_s
        if self._heat_s > self._stall_s:
            raise GuardError(
                f"the shaft stands though the motor is driven with {duty_pct:.3g} %, longer than guards.stall_s = "
                f"{self._guards.stall_s:g} s of full duty: braked; it is held, or the encoder, the supply or the "
                "bridge has failed"
            )

    def _direction(self, duty_pct: float, angle_deg: float) -> None:
        sign = math.copysign(1.0, duty_pct) if abs(duty_pct) >= STRONG_PCT else 0.0
        speed = self._speed_deg_s()
        if not sign or sign != self._sign or any(self._glitches):  # a wrong reading shifts angle and speed
            self._sign = sign
            self._far_deg, self._against_deg_s = sign * angle_deg, max(0.0, -sign * speed)
            return
        self._far_deg = max(self._far_deg, sign * angle_deg)
        back_deg = self._far_deg - sign * angle_deg
        if back_deg > self._guards.wrong_way_deg and -sign * speed > self._against_deg_s + FASTER_DEG_S:
            raise GuardError(
                f"the shaft turns against the command ({back_deg:.0f} deg back at {duty_pct:.3g} %, "
                f"{speed:.0f} deg/s and faster), beyond guards.wrong_way_deg = {self._guards.wrong_way_deg:g}: braked; "
                "the motor's wires or the encoder's channels are swapped (swap one of them), or a load is too heavy"
            )

    def _speed_deg_s(self) -> float:
        (first, begin), (last, end) = self._seen[0], self._seen[-1]
        return (end - begin) / (max(1, last - first) * self._tick_s)
