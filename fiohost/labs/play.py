"""One control law on the model and on a target: what both did, in the same units.

The model side is played three ways at most: ``ideal`` (nearly continuous, perfect sensor, no delay: what a textbook's
block diagram says), ``model`` (the same model under the bench's ticks, delay and encoder counts), and the ``target``.
Volts are volts at full scale; a bench knows them as percent.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from fiohost.bench.guard import STALL_COUNTS
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.program import Answer
from fiohost.control.controllers import Controller
from fiohost.control.law import saturate
from fiohost.errors import ConfigError, GuardError
from fiohost.labs.constants import MotorConstants
from fiohost.motor.hooks import measure
from fiohost.motor.kernel import simulate
from fiohost.motor.model import slot
from fiohost.motor.simulate import Start, seen_angle, start_state
from fiohost.motor.state import CURRENT, DRIVE, OMEGA, STATE_SIZE, TAU, WORK_SIZE
from fiohost.transport.instruments import Instruments
from fiohost.wire.messages import Command

IDEAL_TICK_S = 0.0005
SMOOTHING_TICKS = 9  # of a target's speed, by a parabola through so many readings: 0.07 rad/s of count noise at 5 ms
DRIVEN_PCT, DRIVEN_S = 20.0, 0.5  # so strong and so long, a motor of the labs has turned
_LOAD, _LIMIT = slot("constant_load.level_pct"), slot("current_limit.limit_pct")


class Law(Protocol):
    """What answers a reading; the duty that it wants may be beyond what the bridge can give."""

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        """Wanted duty in percent, and the reference in the law's own unit, at tick *k*."""

    def applied(self, duty_pct: float) -> None:
        """What of it was really applied."""


@dataclass(frozen=True)
class Way:
    """How a law is played: its tick, what it costs until a command acts, and one count of the encoder."""

    name: str
    sample_time_s: float
    delay_s: float = 0.0
    quantum_deg: float = 0.0
    speed_ticks: int = 1  # over which a law takes its speed


IDEAL = Way("ideal", IDEAL_TICK_S)


def bench_way(bench: Bench, name: str = "model") -> Way:
    """The bench's own timing: a command acts one tick after the reading that it answers."""
    return Way(name, bench.sample_time_s, bench.sample_time_s, 360.0 / bench.counts_per_rev, speed_ticks=4)


class OpenLaw:
    """Voltages known beforehand, (n) in volts."""

    def __init__(self, volts: np.ndarray, pct_per_volt: float) -> None:
        self._volts, self._scale = volts.tolist(), pct_per_volt

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        volt = self._volts[min(k, len(self._volts) - 1)]
        return volt * self._scale, volt

    def applied(self, duty_pct: float) -> None:
        pass


class PositionLaw:
    """A controller on the angle turned since the start; the reference (n) is in degrees."""

    def __init__(self, controller: Controller, refs_deg: np.ndarray) -> None:
        self._controller, self._refs = controller, refs_deg.tolist()
        controller.reset()

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        ref = self._refs[min(k, len(self._refs) - 1)]
        return self._controller.step(ref, angle_deg), ref

    def applied(self, duty_pct: float) -> None:
        self._controller.applied(duty_pct)


class SpeedLaw:
    """A controller on the mean speed of the last ticks, in deg/s; the reference (n) is in rad/s."""

    def __init__(self, controller: Controller, refs_rad_s: np.ndarray, way: Way) -> None:
        self._controller, self._refs = controller, refs_rad_s.tolist()
        self._past: list[tuple[int, float]] = []
        self._way = way
        controller.reset()

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        self._past = [*self._past[-self._way.speed_ticks :], (k, angle_deg)]
        first, before = self._past[0]
        speed = (angle_deg - before) / ((k - first) * self._way.sample_time_s) if k > first else 0.0
        ref = self._refs[min(k, len(self._refs) - 1)]
        return self._controller.step(float(np.degrees(ref)), speed), ref

    def applied(self, duty_pct: float) -> None:
        self._controller.applied(duty_pct)


@dataclass(frozen=True)
class Run:
    """What happened, each array (n): angle turned since the start, speed, armature voltage and current (None: no
    meter), and the reference in the law's unit.
    """

    name: str
    time_s: np.ndarray
    ref: np.ndarray
    angle_deg: np.ndarray
    speed_rad_s: np.ndarray
    volts: np.ndarray
    current_A: np.ndarray | None = None
    log: Path | None = None

    def after(self, begin_s: float) -> Run:
        """The run from a moment on, with times counted from it."""
        keep = self.time_s >= begin_s - 1e-9
        current = None if self.current_A is None else self.current_A[keep]
        return replace(
            self, time_s=self.time_s[keep] - begin_s, ref=self.ref[keep], angle_deg=self.angle_deg[keep],
            speed_rad_s=self.speed_rad_s[keep], volts=self.volts[keep], current_A=current,
        )  # fmt: skip


@dataclass(frozen=True)
class Torque:
    """A disturbance torque on the shaft from a moment on, positive forward (the text's sign: -0.1 opposes)."""

    torque_Nm: float
    at_s: float = 0.0

    def at(self, time_s: float) -> float:
        return self.torque_Nm if time_s >= self.at_s - 1e-9 else 0.0


@dataclass(frozen=True)
class Limits:
    """Saturations of amplifier and motor, None: none. The text's: 4.5 V and 1 A."""

    volts: float | None = 4.5
    amperes: float | None = 1.0


NO_LIMITS = Limits(None, None)
Watch = Callable[[float, float], float | None]


def play_model(
    constants: MotorConstants,
    law: Law,
    duration_s: float,
    way: Way,
    *,
    limits: Limits = NO_LIMITS,
    torque: Torque | None = None,
    watch: Watch | None = None,
) -> Run:
    """Play a law on the fit's model of a motor, from rest. *watch* sees time and angle at each tick and may answer with
    an inertia in kg m2, which holds from then on (a payload let go).
    """
    model = constants.model(volt_limit_V=limits.volts, current_limit_A=limits.amperes)
    p, on, substep = model.vector(), model.switches(), model.substep_s()
    top = np.inf if limits.volts is None else limits.volts * constants.pct_per_volt
    n = max(round(duration_s / way.sample_time_s), 1) + 1
    times = np.arange(n) * way.sample_time_s
    acts = times + way.delay_s
    duties, modes = np.zeros(n + 1), np.full(n + 1, DRIVE, dtype=np.int64)
    state = np.zeros(WORK_SIZE)
    state[:STATE_SIZE] = start_state(Start(0.0, 0.0), p, on)
    seen, past = seen_angle(p, on), np.empty((2, STATE_SIZE))
    refs, angles, speeds, currents = np.empty(n), np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        angle = float(measure(state[seen], (), p, on))
        angles[k], speeds[k] = angle, np.radians(state[OMEGA])
        if way.quantum_deg:
            angle = float(np.floor(angle / way.quantum_deg + 0.5) * way.quantum_deg)
        wanted, refs[k] = law.step(k, angle)
        duties[k + 1] = min(max(wanted, -top), top)
        law.applied(float(duties[k + 1]))
        if torque is not None:
            p[_LOAD] = -constants.torque_pct(torque.at(times[k]))
        if limits.amperes is not None:
            p[_LIMIT] = _limit_pct(constants, float(duties[k]), float(speeds[k]), limits.amperes)
        changed = None if watch is None else watch(float(times[k]), angle)
        if changed is not None:
            p[TAU] = constants.with_inertia(changed).tau_m_s
        currents[k] = _current(constants, state, duties[k], float(speeds[k]), limits)
        if k + 1 < n:
            simulate(times, acts, duties, modes, 0.0, k, k + 2, state, substep, p, on, past)
    shift = max(round(way.delay_s / way.sample_time_s), 0)
    acting = np.concatenate((np.zeros(shift), duties[1:]))[:n]
    return Run(way.name, times, refs, angles, speeds, acting / constants.pct_per_volt, currents)


def _limit_pct(constants: MotorConstants, duty: float, speed: float, limit_A: float) -> float:
    """A current limit for the reduced model, whose current counts viscous friction as back-emf: what friction takes is
    added or taken off, by which way the current flows.
    """
    forward = duty / constants.pct_per_volt > speed / constants.speed_per_volt
    friction_A = constants.B_Nms * speed / constants.Kt_Nm_per_A
    allowed = limit_A - friction_A if forward else limit_A + friction_A
    return max(100.0 * allowed * constants.R_ohm / constants.supply_V, 0.0)


def _current(constants: MotorConstants, state: np.ndarray, duty: float, speed: float, limits: Limits) -> float:
    """Winding current in amperes: the model's own where it lags, else by Ohm's law."""
    if constants.L_H > 0.0:  # the reduced current counts viscous friction as back-emf
        return float(state[CURRENT]) / 100.0 * constants.supply_V / constants.R_ohm + (
            constants.B_Nms * speed / constants.Kt_Nm_per_A
        )
    found = (duty / constants.pct_per_volt - constants.Ke_Vs_per_rad * speed) / constants.R_ohm
    return found if limits.amperes is None else saturate(found, limits.amperes)


def furniture(bench: Bench) -> Instruments | None:
    """The instruments of a bench, None where it has none."""
    try:
        return Instruments.of(bench)
    except ConfigError:
        return None


class _LawProgram:
    """A law as the bench's tick loop asks for it, with meters read and the disturbance set at each tick.

    When telemetry k is here the board has run on to tick k + 1: so far are the meters, and there a hand can press.
    """

    def __init__(
        self, law: Law, ticks: int, tick_s: float, limit_pct: float, lab: Instruments | None, torque: Torque | None
    ) -> None:
        self._law, self._ticks, self._tick_s, self._limit = law, ticks, tick_s, limit_pct
        self._lab, self._torque = lab, torque
        self._begin: float | None = None
        self.refs: list[float] = []
        self.currents: list[float] = []

    def step(self, k: int, angle_deg: float) -> Answer | None:
        if k >= self._ticks:
            return None
        if self._begin is None:
            self._begin = angle_deg
        wanted, ref = self._law.step(k, angle_deg - self._begin)
        duty = saturate(wanted, self._limit)
        self._law.applied(duty)
        if self._lab is not None:
            self.currents.append(self._lab.current_A)
            if self._torque is not None:
                self._lab.disturb(self._torque.at((k + 1) * self._tick_s))
        self.refs.append(ref)
        return Command.drive(duty), None


def play_target(
    bench: Bench,
    law: Law,
    duration_s: float,
    volts_at_full_duty: float,
    *,
    log_path: Path | None = None,
    metadata: Mapping[str, str] | None = None,
    limits: Limits = NO_LIMITS,
    torque: Torque | None = None,
) -> Run:
    """Play a law on a target, from rest; meters are read and the supply's current is limited where there is furniture.

    Whatever the limits say, no target gives more than its full duty.
    """
    lab = furniture(bench)
    limit = 100.0 if limits.volts is None else min(100.0, 100.0 * limits.volts / volts_at_full_duty)
    ticks = max(round(duration_s / bench.sample_time_s), SMOOTHING_TICKS) + 1
    program = _LawProgram(law, ticks, bench.sample_time_s, limit, lab, torque)
    if lab is not None:
        lab.limit_current(limits.amperes)
    try:
        log = bench.play(program, log_path, metadata)
    finally:
        if lab is not None:
            lab.disturb(0.0)
            lab.limit_current(None)
    check_moved(log)
    times, angle = log.time_s, log.output - log.output[0]
    ticks_of = np.rint(times / bench.sample_time_s).astype(np.int64)  # a lost tick has no row
    duty = np.concatenate(([0.0], log.duty_pct))[: len(log)]  # it acts a tick after the reading that it answers
    meter = {k + 1: value for k, value in zip(ticks_of.tolist(), program.currents, strict=False)}
    current = np.array([meter.get(k, 0.0) for k in ticks_of.tolist()]) if program.currents else None
    refs = np.array(program.refs[: len(log)])
    speed = smooth_speed(times, angle)
    return Run("target", times, refs, angle, speed, duty / 100.0 * volts_at_full_duty, current, log_path)


def check_moved(log: Log) -> None:
    """A lab's runs are shorter than a guard's patience: one whose shaft stood all the time, though driven, says nothing
    about a motor. Raises GuardError.
    """
    driven_s = log.sample_time_s * int(np.count_nonzero(np.abs(log.duty_pct) >= DRIVEN_PCT))
    if driven_s >= DRIVEN_S and np.ptp(log.output) <= STALL_COUNTS * log.output_quantum:
        raise GuardError(
            f"the shaft stood for the whole run though the motor was driven with {DRIVEN_PCT:g} % and more for "
            f"{driven_s:.2g} s: it is held, or the encoder, the supply or the bridge has failed"
        )


def smooth_speed(time_s: np.ndarray, angle_deg: np.ndarray) -> np.ndarray:
    """Speed (n) in rad/s of an angle (n) in counts, from rest: a parabola through the readings about each moment."""
    from scipy.signal import savgol_filter

    step = float(np.median(np.diff(time_s)))
    grid = np.arange(-SMOOTHING_TICKS, round((time_s[-1] - time_s[0]) / step) + 1) * step + time_s[0]
    even = np.interp(grid, time_s, angle_deg)
    found = savgol_filter(even, SMOOTHING_TICKS, 2, deriv=1, delta=step)
    found[-(SMOOTHING_TICKS // 2) :] = found[-(SMOOTHING_TICKS // 2) - 1]  # a one-sided parabola is all noise
    return np.asarray(np.radians(np.interp(time_s, grid, found)))


def target_volts(bench: Bench, constants: MotorConstants) -> float:
    """The winding's voltage at full duty: the target's own where it says so, else that of the constants."""
    stated = bench.transport.facts.get("supply_V", "")
    return float(stated) if stated else constants.supply_V
