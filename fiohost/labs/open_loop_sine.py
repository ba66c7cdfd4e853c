"""Sines of voltage in open loop: gain and phase of the speed, a Bode plot, and what saturation does to both."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from fiohost.bench.log import Log
from fiohost.errors import ConfigError, DataError
from fiohost.labs.constants import MotorConstants
from fiohost.labs.play import Run
from fiohost.labs.result import Answer, LabResult, Table
from fiohost.labs.session import Session, volts

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SETTLE_S = 0.8  # ten time constants of the motor
SMALL_V, LARGE_V = 2.0, 10.0
FREQUENCIES = (0.5, 1.0, 2.0, 5.0, 10.0)  # rad/s, step 9
SWEEP = (*FREQUENCIES, 20.0, 40.0)
LEAST_SHARE = 0.02  # of the strongest input: below it there is no sine to speak of
MOST_REST = 0.5  # of the sine's amplitude, rms of the command beside it: more is another command
HARMONICS = 15  # fitted beside the first: of a cut sine they fall with the square of their number
NEAR_TOP = 1e-4  # of the largest command: so near stands what a limit cuts
SHARE_OF_A_SINE = 0.05  # of the samples that near the top: a whole sine has a hundredth there


@dataclass(frozen=True)
class Response:
    """Gain (rad/s for a volt) and phase at one frequency, the amplitudes behind them, and how well a sine fits."""

    omega_rad_s: float
    gain: float
    phase_deg: float
    input_V: float
    output_rad_s: float
    distortion_pct: float  # rms of the angle beside its sine, in percent of the sine's rms
    cut_pct: float = 0.0  # of the time in which the command stood at its limit

    @property
    def gain_db(self) -> float:
        return 20.0 * math.log10(self.gain)


def first_harmonic(time_s: np.ndarray, y: np.ndarray, omega: float) -> tuple[complex, np.ndarray]:
    """The phasor of ``sin`` at ``omega`` in what is periodic, and what of it is beside that sine and its mean (n).

    Harmonics are fitted beside it: with them left out, a window that is no whole number of samples would mix them in.
    """
    step = float(np.median(np.diff(time_s)))
    highest = max(min(HARMONICS, int(0.5 * np.pi / (omega * step)), len(time_s) // 8), 1)
    columns = [np.ones_like(time_s)]
    for n in range(1, highest + 1):
        columns += [np.sin(n * omega * time_s), np.cos(n * omega * time_s)]
    basis = np.column_stack(columns)
    found = np.linalg.lstsq(basis, y, rcond=None)[0]
    return complex(found[1], found[2]), y - basis[:, :3] @ found[:3]


def drift_per_s(time_s: np.ndarray, y: np.ndarray, period_s: float, from_s: float) -> float:
    """How fast a periodic movement drifts, from what a whole period changes: no harmonic counts for drift.

    A slope beside the sine over one period would take from all of them, as its own harmonics fall as slowly as 1/n.
    Moments from ``from_s`` on are compared with those a period before, where there are any.
    """
    later = time_s >= max(time_s[0] + period_s, from_s) - 1e-9
    if not later.any():
        later = time_s >= time_s[-1]
    before = np.interp(time_s[later] - period_s, time_s, y)
    return float(np.mean(y[later] - before)) / period_s


def asked_sine(time_s: np.ndarray, volts_in: np.ndarray, omega: float) -> tuple[complex, float]:
    """The phasor of the sine that was asked for, also where a limit cut it, and the share of samples that were cut.

    What stands at the limit says nothing of the sine: the phasor is that of the samples below it. Raises DataError
    where there is no sine of that frequency.
    """
    top = float(np.max(np.abs(volts_in), initial=0.0))
    cut = np.abs(volts_in) >= (1.0 - NEAR_TOP) * top
    if float(np.mean(cut)) <= SHARE_OF_A_SINE:
        cut[:] = False
    basis = np.column_stack([np.sin(omega * time_s), np.cos(omega * time_s), np.ones_like(time_s)])
    keep = ~cut
    if keep.sum() < 2 * basis.shape[1]:
        raise DataError("the command stands at its limit all the time: nothing is left of a sine")
    found, _, rank, _ = np.linalg.lstsq(basis[keep], volts_in[keep], rcond=None)
    sent = complex(found[0], found[1])
    rest = volts_in[keep] - basis[keep] @ found
    rms = float(np.sqrt(np.mean(rest**2)))
    if rank < basis.shape[1] or abs(sent) <= LEAST_SHARE * top or rms > MOST_REST * abs(sent) or top == 0.0:
        raise DataError(f"the command holds no sine of {omega:g} rad/s: give the frequency that was commanded")
    return sent, float(np.mean(cut))


def gain_and_phase(
    time_s: np.ndarray, volts_in: np.ndarray, angle_deg: np.ndarray, omega: float, acts_after_s: float
) -> Response:
    """Gain and phase from the voltage asked for to the speed, over the later half of a run's whole periods.

    Where a current is at its limit, little but friction damps what is left of the start: the first half is for that.

    ``acts_after_s`` passes from a row until its voltage acts; a held voltage acts as the sine half a sample later,
    which is taken off too. The speed is the derivative of the angle's own first harmonic, so no count is ever
    differentiated. Raises DataError for less than a period, or where there is no sine of that frequency.
    """
    step = float(np.median(np.diff(time_s)))
    period = 2.0 * math.pi / omega
    settled = time_s >= time_s[0] + SETTLE_S - 1e-9
    periods = math.floor((time_s[-1] - time_s[0] - SETTLE_S) / period + 1e-6)
    if periods < 1:
        raise DataError(f"the run is too short for a whole period at {omega:g} rad/s after {SETTLE_S:g} s of settling")
    begin_s = float(time_s[-1]) - (periods - periods // 2) * period
    keep = time_s > begin_s - 0.5 * step
    sent, cut = asked_sine(time_s[keep] + acts_after_s + 0.5 * step, volts_in[keep], omega)
    angle = np.radians(angle_deg)
    drift = drift_per_s(time_s[settled], angle[settled], period, begin_s)
    turned, rest = first_harmonic(time_s[keep], (angle - drift * time_s)[keep], omega)
    speed = turned * complex(0.0, omega)
    ratio = speed / sent
    rms = abs(turned) / math.sqrt(2.0)
    return Response(
        omega, abs(ratio), math.degrees(math.atan2(ratio.imag, ratio.real)), abs(sent), abs(speed),
        100.0 * float(np.sqrt(np.mean(rest**2))) / rms if rms else 0.0, 100.0 * cut,
    )  # fmt: skip


def calculate(log: Log, omega: float, full_V: float) -> Response:
    """The gain and phase calculator on any log with an angle. Raises DataError or ConfigError."""
    if log.output_name != "angle_deg":
        raise ConfigError(f"{log.path} holds {log.output_name}: the calculator wants a log with pos or angle_deg")
    delay = log.command_delay_ticks * log.sample_time_s
    return gain_and_phase(log.time_s, log.duty_pct / 100.0 * full_V, log.output, omega, delay)


def model_response(q: MotorConstants, omega: float) -> complex:
    """Volts to speed: Ki / ((La s + Ra)(J s + B) + Ki Kb)."""
    s = complex(0.0, omega)
    bottom = (q.L_H * s + q.R_ohm) * (q.J_kgm2 * s + q.B_Nms) + q.Kt_Nm_per_A * q.Ke_Vs_per_rad
    return q.Kt_Nm_per_A / bottom


def calculator(log: Log, omega: float, q: MotorConstants, full_V: float) -> LabResult:
    """The calculator's answer as a result, beside the model's."""
    found = calculate(log, omega, full_V)
    row = _row("log", found, q)
    return LabResult(
        name="open-loop-sine",
        title=f"Gain and phase at {omega:g} rad/s of {log.path}",
        target=log.metadata.get("target", "a log"),
        tables=(Table("Gain and phase calculator", _COLUMNS, [row], (0, 1)),),
        notes=(
            f"the command stood at its limit {found.cut_pct:.0f} % of the time: gain and phase are against the sine of "
            f"{found.input_V:.3g} V that was asked for, found from the rest",
        ) if found.cut_pct else (),
        values={"omega_rad_s": omega, "gain_rad_s_V": found.gain, "gain_db": found.gain_db,
                "phase_deg": found.phase_deg, "distortion_pct": found.distortion_pct, "cut_pct": found.cut_pct},
    )  # fmt: skip


_COLUMNS = ("who", "rad/s", "in V", "out rad/s", "gain rad/s/V", "gain dB", "phase deg", "formula dB", "formula deg",
            "not sine %")  # fmt: skip


def _row(who: str, r: Response, q: MotorConstants) -> list[float | str]:
    formula = model_response(q, r.omega_rad_s)
    phase = math.degrees(math.atan2(formula.imag, formula.real))
    return [who, r.omega_rad_s, r.input_V, r.output_rad_s, r.gain, r.gain_db, r.phase_deg,
            20.0 * math.log10(abs(formula)), phase, r.distortion_pct]  # fmt: skip


def _sine_run(session: Session, amplitude: float, omega: float) -> tuple[Run, Run, Response, Response]:
    """The same sine on the ideal model and on the target; input is the sine that was asked for."""
    periods = 1 if omega < 1.5 else math.ceil(omega)
    duration = SETTLE_S + periods * 2.0 * math.pi / omega + 2.0 * session.bench.sample_time_s
    law = volts(lambda t: amplitude * np.sin(omega * t), duration)
    case = f"sine_{amplitude:g}V_{omega:g}rad_s".replace(".", "p")
    ideal = session.ideal(law, duration, session.limits)
    target = session.on_target(case, law, duration)
    found = [
        gain_and_phase(run.time_s, run.ref, run.angle_deg, omega, delay)
        for run, delay in ((ideal, 0.0), (target, session.bench.sample_time_s))  # both are held, half a tick on average
    ]
    return ideal, target, found[0], found[1]


def open_loop_sine(
    session: Session, frequencies: Sequence[float] = SWEEP, small_V: float = SMALL_V, large_V: float = LARGE_V
) -> LabResult:
    """Steps 9 and 10: gain and phase at each frequency, and at the text's five with an amplitude that saturates."""
    if not frequencies or not all(0.01 <= w <= 200.0 for w in frequencies):
        raise ConfigError("frequencies are within 0.01 to 200 rad/s, one or more")
    q = session.constants
    small = [_sine_run(session, small_V, w) for w in frequencies]
    large_at = [w for w in frequencies if w <= FREQUENCIES[-1]] or [frequencies[0]]
    large = [_sine_run(session, large_V, w) for w in large_at]
    rows = [_row(who, r, q) for _, _, a, b in small for who, r in (("model", a), ("target", b))]
    rows_large = [_row(who, r, q) for _, _, a, b in large for who, r in (("model", a), ("target", b))]
    return LabResult(
        name="open-loop-sine",
        title="Open-loop sine: frequency response from voltage to speed",
        target=session.target,
        tables=(
            Table(f"Amplitude {small_V:g} V", _COLUMNS, rows, (0, 1)),
            Table(
                f"Amplitude {large_V:g} V: the amplifier saturates; gain of the first harmonic",
                _COLUMNS,
                rows_large,
                (0, 1),
            ),
        ),
        answers=(_step_9(small, q), _step_10(large, large_V, session)),
        notes=tuple(session.notes),
        values={
            "small_V": small_V,
            "large_V": large_V,
            "omega_rad_s": list(frequencies),
            "target_gain_db": [b.gain_db for *_, b in small],
            "target_phase_deg": [b.phase_deg for *_, b in small],
            "model_gain_db": [a.gain_db for _, _, a, _ in small],
            "model_phase_deg": [a.phase_deg for _, _, a, _ in small],
            "large_omega_rad_s": large_at,
            "large_target_gain_db": [b.gain_db for *_, b in large],
            "large_target_phase_deg": [b.phase_deg for *_, b in large],
        },
        figures={
            "open_loop_sine_bode": lambda: _bode(session, small, large, small_V, large_V),
            "open_loop_sine_time": lambda: _time(session, small, large, small_V, large_V),
        },
        files=dict(session.logs),
    )


def _step_9(small: list[tuple[Run, Run, Response, Response]], q: MotorConstants) -> Answer:
    told = "; ".join(
        f"{b.omega_rad_s:g} rad/s: {b.gain_db:.2f} dB, {b.phase_deg:.1f} deg (model {a.gain_db:.2f}, {a.phase_deg:.1f})"
        for _, _, a, b in small
    )
    corner = 1.0 / q.tau_m_s
    text = (
        f"{told}. Gain falls and phase lags more as frequency rises; the corner of the constants is {corner:.1f} rad/s"
    )
    return Answer("Step 9. Gain and phase of the target at each frequency", text)


def _step_10(large: list[tuple[Run, Run, Response, Response]], large_V: float, session: Session) -> Answer:
    _, run, a, b = large[0]
    top = float(np.max(np.abs(run.volts)))
    fastest = float(np.max(np.abs(run.speed_rad_s)))
    return Answer(
        f"Step 10. The same with {large_V:g} V",
        f"the target never gets more than {top:.3g} V, so its speed stays below {fastest:.1f} rad/s; at "
        f"{b.omega_rad_s:g} rad/s the gain of the first harmonic is {b.gain_db:.2f} dB (model {a.gain_db:.2f}) and "
        f"{b.distortion_pct:.1f} % of the angle's swing is no sine (model {a.distortion_pct:.1f} %): a gain that "
        "depends on the amplitude belongs to no transfer function",
    )


def _bode(
    session: Session, small: list[tuple[Run, Run, Response, Response]],
    large: list[tuple[Run, Run, Response, Response]], small_V: float, large_V: float,
) -> Figure:  # fmt: skip
    from fiohost.report.panels import Curve, Panel, plot_panels

    low, high = small[0][3].omega_rad_s / 2.0, small[-1][3].omega_rad_s * 2.0
    grid = np.geomspace(low, high, 200)
    line = np.array([model_response(session.constants, float(w)) for w in grid])
    at, at_large = [b.omega_rad_s for *_, b in small], [b.omega_rad_s for *_, b in large]

    def curves(of_line: np.ndarray, key: str) -> list[Curve]:
        return [
            Curve(grid, of_line, "constants, formula", -2, "model"),
            Curve(at, [getattr(a, key) for _, _, a, _ in small], f"model, {small_V:g} V", 0, "crosses"),
            Curve(at, [getattr(b, key) for *_, b in small], f"target, {small_V:g} V", 0, "points"),
            Curve(at_large, [getattr(a, key) for _, _, a, _ in large], f"model, {large_V:g} V", 1, "crosses"),
            Curve(at_large, [getattr(b, key) for *_, b in large], f"target, {large_V:g} V", 1, "points"),
        ]

    panels = [
        Panel(curves(20.0 * np.log10(np.abs(line)), "gain_db"), "gain (dB of 1 rad/s per V)", "frequency (rad/s)",
              "Gain", log_x=True),
        Panel(curves(np.degrees(np.angle(line)), "phase_deg"), "phase (deg)", "frequency (rad/s)", "Phase", log_x=True),
    ]  # fmt: skip
    return plot_panels(panels, f"Bode plot, volts to speed, {session.target} and model")


def _time(
    session: Session, small: list[tuple[Run, Run, Response, Response]],
    large: list[tuple[Run, Run, Response, Response]], small_V: float, large_V: float,
) -> Figure:  # fmt: skip
    from fiohost.report.panels import Curve, Panel, plot_panels

    panels = []
    for level, runs in ((small_V, small), (large_V, large)):
        ideal, target, _, b = min(runs, key=lambda r: abs(r[3].omega_rad_s - 1.0))
        curves = [
            Curve(target.time_s, target.ref, "voltage asked for (V)", -1, "reference"),
            Curve(target.time_s, target.volts, "voltage given, target (V)", 2, "reference"),
            Curve(target.time_s, target.speed_rad_s, "speed, target (rad/s)", 0, "target"),
            Curve(ideal.time_s, ideal.speed_rad_s, "speed, model (rad/s)", 0, "model"),
        ]
        title = f"{level:g} sin({b.omega_rad_s:g} t) V: gain {b.gain:.3g} rad/s per V, phase {b.phase_deg:.1f} deg"
        panels.append(Panel(curves, "voltage (V), speed (rad/s)", title=title))
    return plot_panels(panels, f"Open-loop sine, {session.target} and model")
