"""Readings at a simulated board, taken with its virtual meters as the text takes them with a multimeter.

A stalled shaft is held by a soft hand, a mass hangs on the spool, the speed is that of the encoder. Meters show what a
multimeter shows: steps of 1 mA and 10 mV.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from fiohost.bench.experiment import Experiment
from fiohost.bench.loop import Bench, Tick
from fiohost.bench.signals import Pulses
from fiohost.errors import DataError
from fiohost.labs.inductance import rough_H
from fiohost.labs.open_loop_step import fit_step
from fiohost.labs.play import OpenLaw, play_target, smooth_speed
from fiohost.labs.readings import GRAVITY_M_S2, METER_A, METER_V, SPOOL_RADIUS_M, NoLoad, Readings
from fiohost.transport.instruments import Instruments

STALL_POWERS = (10.0, 20.0, 30.0, -10.0, -20.0, -30.0)  # table D-4
MASSES_KG = (0.0, 0.067, 0.119, 0.173, 0.234, 0.293, 0.353, 0.413, 0.471, 0.532, 0.643, 0.702)  # table D-5
LIFT_POWER = 50.0
SPEED_POWERS = (10.0, 20.0, 40.0, 60.0, 80.0, 100.0)  # from where Fig. D-22 begins
HAND_NM_PER_RAD = 0.1  # soft enough for the motor's own damping, stiff enough to be at rest within seconds
RISE_POWERS, RISE_RUN_S, RISE_TICKS = (40.0, -40.0, 30.0, -30.0), 0.2, 3  # below what a supply of 1 A would cut
STALL_S, LIFT_S, STEP_S, ON_S, OFF_S = 2.0, 1.2, 1.5, 1.0, 4.0
READ_S = 0.3
TURNS_RAD_S = 0.2


class _Meter:
    """Reads at every tick; what is shown is the mean of the last READ_S, in steps of the meter."""

    def __init__(self, lab: Instruments, tick_s: float, act: Callable[[Tick], None] | None = None) -> None:
        self._lab, self._act = lab, act
        self._keep = round(READ_S / tick_s)
        self._seen: list[tuple[float, float]] = []

    def __call__(self, tick: Tick) -> None:
        if self._act is not None:
            self._act(tick)
        self._seen = [*self._seen[-self._keep + 1 :], (self._lab.voltage_V, self._lab.current_A)]

    def read(self) -> tuple[float, float]:
        volts, amperes = np.mean(self._seen, axis=0)
        return round(float(volts) / METER_V) * METER_V, round(float(amperes) / METER_A) * METER_A


class _MeteredLaw(OpenLaw):
    """A voltage that is asked for, and what of it the winding gets: bridges lose some."""

    def __init__(self, lab: Instruments, volt: float, ticks: int, supply_V: float) -> None:
        super().__init__(np.full(ticks, volt), 100.0 / supply_V)
        self._lab = lab
        self._seen: list[float] = []

    def step(self, k: int, angle_deg: float) -> tuple[float, float]:
        self._seen.append(self._lab.voltage_V)
        return super().step(k, angle_deg)

    @property
    def steady_V(self) -> float:
        """As a meter shows it; the median, as it begins at rest."""
        return round(float(np.median(self._seen)) / METER_V) * METER_V


def measure(
    bench: Bench,
    port: str,
    L_H: float | None,
    supply_V: float,
    *,
    stall_powers: Sequence[float] = STALL_POWERS,
    masses_kg: Sequence[float] = MASSES_KG,
    speed_powers: Sequence[float] = SPEED_POWERS,
) -> Readings:
    """All tables of the characterisation. The winding's lag is taken off the time constants; without ``L_H`` its
    inductance is that of the current's rise.

    Raises ConfigError where the bench has no instruments, DataError where the motor does not turn.
    """
    lab = Instruments.of(bench)
    found = Readings(port=port, supply_V=supply_V, source=f"virtual meters at {bench.transport.name}")
    found.stall = [_stalled(bench, lab, power) for power in stall_powers]
    found.rise = [row for power in RISE_POWERS for row in _risen(bench, lab, power, supply_V)]
    R_ohm = float(np.mean([v / i for v, i in found.stall]))
    winding_s = (rough_H(found.rise, R_ohm) if L_H is None else L_H) / R_ohm
    for mass in masses_kg:
        torque, current, speed = _lifted(bench, lab, mass)
        turns = speed > TURNS_RAD_S
        (found.lift if turns else found.lift_stalled).append((torque, current))
        if turns:
            found.lift_speed.append((torque, current, speed))
    for power in speed_powers:
        reading, tau_s = _freely(bench, lab, power, supply_V, winding_s)
        found.no_load.append(reading)
        found.time_constants_s.append(tau_s)
    timed, found.run_down_curve = _run_down(bench)
    found.run_down.append(timed)
    return found


def _stalled(bench: Bench, lab: Instruments, power: float) -> tuple[float, float]:
    """Voltage and current with the shaft held."""
    begin: list[float] = []

    def hold(tick: Tick) -> None:
        begin.append(tick.angle_deg)
        lab.disturb(-HAND_NM_PER_RAD * float(np.radians(tick.angle_deg - begin[0])))

    meter = _Meter(lab, bench.sample_time_s, hold)
    try:
        bench.drive(power, STALL_S, progress=meter, progress_every_s=bench.sample_time_s)
    finally:
        lab.disturb(0.0)
    return meter.read()


def _lifted(bench: Bench, lab: Instruments, mass_kg: float) -> tuple[float, float, float]:
    """Torque of a mass on the spool, the current that lifts it, and the speed at which it goes up."""

    def hang(tick: Tick) -> None:
        if tick.time_s >= 0.05:  # a motor that does not pull yet would be dragged along
            lab.hang_mass(mass_kg, SPOOL_RADIUS_M * GRAVITY_M_S2 / 9.81)

    meter = _Meter(lab, bench.sample_time_s, hang)
    try:
        log = bench.drive(LIFT_POWER, LIFT_S, progress=meter, progress_every_s=bench.sample_time_s)
    finally:
        lab.hang_mass(0.0, SPOOL_RADIUS_M)
    last = log.time_s > log.time_s[-1] - READ_S
    speed = float(np.polyfit(log.time_s[last], np.radians(log.output[last]), 1)[0])
    return mass_kg * GRAVITY_M_S2 * SPOOL_RADIUS_M, meter.read()[1], speed


def _freely(bench: Bench, lab: Instruments, power: float, supply_V: float, winding_s: float) -> tuple[NoLoad, float]:
    """Steady voltage, speed and current without load, and the time constant on the way there."""
    ticks = round(STEP_S / bench.sample_time_s) + 1
    law = _MeteredLaw(lab, power / 100.0 * supply_V, ticks, supply_V)
    run = play_target(bench, law, STEP_S, supply_V)
    volt = law.steady_V
    fit = fit_step(run, volt, winding_s)
    assert run.current_A is not None
    current = float(np.mean(run.current_A[run.time_s > run.time_s[-1] - READ_S]))
    meter = NoLoad(volt, fit.steady_rad_s, round(current / METER_A) * METER_A, power)
    return meter, fit.tau_s


def _run_down(bench: Bench) -> tuple[tuple[float, float], tuple[list[float], list[float]]]:
    """Time to 37 % of the speed once the input is off (standby, the winding open), the speed before, and the curve."""
    signal = Pulses(duration_s=ON_S + OFF_S, levels=(100.0,), on_s=ON_S, off_s=OFF_S, rest="standby")
    log = bench.run(Experiment("run_down", command=(signal,)))
    speed = smooth_speed(log.time_s, log.output - log.output[0])
    off = log.time_s >= ON_S + bench.sample_time_s
    before = float(np.mean(speed[(log.time_s > ON_S - READ_S) & (log.time_s < ON_S)]))
    slow = np.flatnonzero(speed[off] <= np.exp(-1.0) * before)
    if not slow.size:
        raise DataError(f"the shaft runs down slower than {OFF_S:g} s to 37 % of its speed")
    since = log.time_s - ON_S - bench.sample_time_s
    shown = since >= -READ_S
    curve = (since[shown].tolist(), speed[shown].tolist())
    return (float(since[off][slow[0]]), before), curve


def _risen(bench: Bench, lab: Instruments, power: float, supply_V: float) -> list[tuple[float, float, float]]:
    """Voltage, time and current at the first ticks after a step of voltage from rest."""
    law = _MeteredLaw(lab, power / 100.0 * supply_V, 60, supply_V)
    run = play_target(bench, law, RISE_RUN_S, supply_V)
    assert run.current_A is not None
    began = int(np.flatnonzero(np.abs(run.volts) > 0.0)[0])
    return [
        (law.steady_V, k * bench.sample_time_s, round(float(run.current_A[began + k]) / METER_A) * METER_A)
        for k in range(1, RISE_TICKS + 1)
    ]
