"""A closed position loop over a model of the motor, compiled: a response of seconds costs a fraction of a millisecond.

The loop is the bench's: at every tick the encoder is read, the law answers, and the answer acts after the command
delay, held until the next one. The law is that of ``fiohost.control.law`` with an integral added: P, PD, PI or PID,
then deadband compensation, then the limit. A loop in continuous time is one with a small sample time.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from math import floor, isfinite
from typing import NamedTuple

import numpy as np

from fiohost.errors import ConfigError
from fiohost.motor.compiled import compiled
from fiohost.motor.hooks import measure
from fiohost.motor.kernel import simulate
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start, seen_angle, start_state
from fiohost.motor.state import DRIVE, STATE_SIZE, WORK_SIZE

MOST_TICKS = 5_000_000
REST = Start(0.0, 0.0)


@dataclass(frozen=True)
class Loop:
    """The settings of a discrete loop; gains are in percent of duty for an error in degrees.

    ``u = kp e + ki integral(e) + kd s/(1 + filter s) e``, the integral and the derivative by backward difference. With
    ``derivative_on_angle`` a step of the reference gives no kick. With ``holds_integral`` the integral gives back what
    the limit cut off, within ``tracking_s`` and as far as it holds any, so that it does not wind up. ``delay_s`` passes
    from a reading until its command acts; ``quantum_deg`` is the encoder's count, 0 for an ideal one.
    """

    kp_pct_per_deg: float
    ki_pct_per_deg_s: float = 0.0
    kd_pct_s_per_deg: float = 0.0
    filter_s: float = 0.0
    derivative_on_angle: bool = False
    holds_integral: bool = True
    limit_pct: float = 100.0
    u_plus_pct: float = 0.0
    u_minus_pct: float = 0.0
    threshold_pct: float = 0.0
    sample_time_s: float = 0.005
    delay_s: float = 0.0
    quantum_deg: float = 0.0
    tracking_s: float = 0.0

    def __post_init__(self) -> None:
        for item in fields(self):
            if not isfinite(getattr(self, item.name)):
                raise ConfigError(f"{item.name} = {getattr(self, item.name)!r} of a loop is not a finite number")
        if not self.sample_time_s > 0.0:
            raise ConfigError(f"sample_time_s = {self.sample_time_s:g} of a loop is not above 0")
        if not 0.0 < self.limit_pct <= 100.0:
            raise ConfigError(f"limit_pct = {self.limit_pct:g} of a loop is not above 0 and at most 100")
        for name in ("filter_s", "threshold_pct", "u_plus_pct", "delay_s", "quantum_deg", "tracking_s"):
            if getattr(self, name) < 0.0:
                raise ConfigError(f"{name} = {getattr(self, name):g} of a loop is below 0")
        if self.u_minus_pct > 0.0:
            raise ConfigError(f"u_minus_pct = {self.u_minus_pct:g} of a loop is above 0")

    @cached_property
    def packed(self) -> np.ndarray:
        """The settings in the order of the kernel."""
        return np.array([float(getattr(self, item.name)) for item in fields(self)])


class Plant(NamedTuple):
    """A model as the loop's kernel takes it: parameters, switches, longest step, and the angle that is seen."""

    p: np.ndarray
    on: np.ndarray
    substep_s: float
    seen: int

    @classmethod
    def of(cls, model: Model) -> Plant:
        return cls(model.vector(), model.switches(), model.substep_s(), 0).at(model.vector())

    def at(self, p: np.ndarray) -> Plant:
        """The same model with other values in its parameter array."""
        return self._replace(p=p, seen=seen_angle(p, self.on))


@dataclass(frozen=True)
class LoopRun:
    """A run of a loop, each array (n): at each tick what the encoder showed and the duty that answered it."""

    time_s: np.ndarray
    ref_deg: np.ndarray
    angle_deg: np.ndarray
    duty_pct: np.ndarray


@compiled
def _run(times, act_times, refs, loop, clock, state, substep, p, on, seen, duties, modes, states, angles):  # type: ignore[no-untyped-def]
    """Ticks of a loop from ``state``; fills ``duties`` (n + 1, the first acted before the run) and ``angles`` (n).

    The order of ``loop`` is that of the fields of ``Loop``.
    """
    kp, ki, kd, filter_s, on_angle, holds = loop[0], loop[1], loop[2], loop[3], loop[4] != 0.0, loop[5] != 0.0
    limit, u_plus, u_minus, threshold, tick, count = loop[6], loop[7], loop[8], loop[9], loop[10], loop[12]
    returned = tick / max(loop[13], tick)
    keep, new = filter_s / (filter_s + tick), 1.0 / (filter_s + tick)
    integral, slope, before = 0.0, 0.0, 0.0
    n = times.shape[0]
    for k in range(n):
        angle = measure(state[seen], (), p, on)
        if count > 0.0:
            angle = floor(angle / count) * count
        error = refs[k] - angle
        signal = -angle if on_angle else error
        change = signal - before if k > 0 else 0.0  # no kick from the first reading
        before = signal
        slope = keep * slope + new * change
        integral += ki * tick * error
        wanted = kp * error + integral + kd * slope
        sent = wanted
        if -threshold <= wanted <= threshold:
            sent = 0.0
        elif wanted > 0.0:
            sent += u_plus
        else:
            sent += u_minus
        held = min(max(sent, -limit), limit)
        if holds and ki != 0.0:
            back = returned * (held - sent)
            integral = (
                max(integral + back, min(integral, 0.0)) if back < 0.0 else min(integral + back, max(integral, 0.0))
            )
        angles[k] = angle
        duties[k + 1] = held
        if k + 1 < n:
            simulate(times, act_times, duties, modes, clock, k, k + 2, state, substep, p, on, states)


def run_loop(plant: Plant, loop: Loop, ref_deg: np.ndarray, start: Start = REST, clock_s: float = 0.0) -> LoopRun:
    """Run a loop over a reference (n), one value a tick, in degrees; before the run no duty acts.

    Raises ConfigError for a reference that is empty, endless or not finite.
    """
    refs = np.ascontiguousarray(ref_deg, dtype=np.float64)
    if not 0 < refs.size <= MOST_TICKS or refs.ndim != 1 or not np.isfinite(refs).all():
        raise ConfigError(f"a reference of {refs.size} ticks cannot be run: it has 1 to {MOST_TICKS} finite values")
    n = len(refs)
    times = np.arange(n) * loop.sample_time_s
    state = np.zeros(WORK_SIZE)
    state[:STATE_SIZE] = start_state(start, plant.p, plant.on)
    duties, angles = np.zeros(n + 1), np.empty(n)
    _run(
        times, times + loop.delay_s, refs, loop.packed, clock_s, state, plant.substep_s, plant.p, plant.on,
        plant.seen, duties, np.full(n + 1, DRIVE, dtype=np.int64), np.empty((2, STATE_SIZE)), angles,
    )  # fmt: skip
    return LoopRun(times, refs, angles, duties[1:])


def step_run(
    plant: Plant, loop: Loop, to_deg: float, duration_s: float, *, from_deg: float = 0.0, hold_s: float = 0.0
) -> LoopRun:
    """The response to a step of the reference, from rest at 0 degrees; times count from the step.

    Where the step begins elsewhere, the loop first goes ``from_deg`` and has ``hold_s`` to get there.
    """
    before, after = round(hold_s / loop.sample_time_s), max(round(duration_s / loop.sample_time_s), 1) + 1
    run = run_loop(plant, loop, np.concatenate((np.full(before, from_deg), np.full(after, to_deg))))
    times = np.arange(after) * loop.sample_time_s
    return LoopRun(times, run.ref_deg[before:], run.angle_deg[before:], run.duty_pct[before:])
