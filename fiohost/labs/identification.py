"""Closed-loop identification, two ways side by side, and what friction does to both.

A square wave of 170 and 190 degrees with C(s) = 1 and a deadband precompensator is run (INC451 lab 2, section 2.4.2.2).
K and tau follow from overshoot and peak time of its steps, and from a fit of the loop's second-order form. A third fit,
of a motor with dry friction and a winding to the commands, says what the two leave out: its loop is simulated with the
friction and without, and both methods are used on what it gives. Its intervals count where within a count the shaft
may have stood, which repeated motion does not average out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiohost.bench.deadband import measure_deadband
from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import COMMAND_DELAY_TICKS, Bench
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import Square
from fiohost.control.closed_loop import Plant, run_loop
from fiohost.control.jitter import REST, find_jitter
from fiohost.control.settings import ControlSettings
from fiohost.errors import DataError
from fiohost.estimation.fit import Fit, fit_from_scratch
from fiohost.estimation.intervals import estimates
from fiohost.estimation.logs import GAIN, METHODS, OMEGA, TAU, ZETA, Curve, Identification, identify
from fiohost.estimation.record import record_from_log
from fiohost.estimation.second_order import closed_loop
from fiohost.estimation.step_response import steps_of
from fiohost.labs.result import Answer, Cell, LabResult, Table
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LOW_DEG, HIGH_DEG, PERIOD_S = 170.0, 190.0, 6.0
PERIODS = 5
KP = 1.0
REPEATS = 3
FOLLOWS = 0.5  # share of the step that the shaft must at least turn
EXPLAINS_DEG = 2.0  # a fit with friction that leaves more than this, rms, does not explain the run
MODEL = "linear+coulomb_friction+armature_inductance"
REPLICAS = 6  # fits to the same run with the shaft elsewhere within its count
LEVEL = "coulomb_friction.level_pct"
WINDING = "armature_inductance.time_constant_s"


@dataclass(frozen=True)
class Found:
    """All that was identified on one log, by method; the last two are of simulated loops.

    ``left_deg`` (n) is what the fit with friction leaves of the log. A method that finds nothing is left out, with a
    sentence in ``said``.
    """

    measured: Mapping[str, Identification]
    said: Sequence[str]
    friction: Fit
    left_deg: np.ndarray
    with_friction: Mapping[str, Identification]
    without: Mapping[str, Identification]
    replicas: Sequence[Model]

    @property
    def left_rms_deg(self) -> float:
        return float(np.sqrt(np.mean(self.left_deg**2)))


def identification(bench: Bench, folder: Path, profile: BenchProfile | None = None) -> LabResult:
    """The run and both methods. Raises FiohostError where neither finds anything."""
    known = profile or measured_profile(bench)
    control = ControlSettings(kp_pct_per_deg=KP).with_compensation(*known.compensation_pct)
    log, friction = run_and_fit(bench, folder, control)
    linear = Model(values={key: friction.model.number(key) for key in (f"linear.{GAIN}", f"linear.{TAU}")})
    bare = control.with_compensation(0.0, 0.0)
    measured, said = _both(log)
    if not measured:
        raise DataError(f"neither method identifies this loop: {'; '.join(said)}")
    with_friction, without = _simulated(log, friction.model, control), _simulated(log, linear, bare)
    left_deg = friction.errors([record_from_log(log)])[0]
    found = Found(measured, said, friction, left_deg, with_friction, without, replicas(log, friction))
    models = {"model with friction": friction.model}
    models |= {f"model of {method}": one.model for method, one in measured.items()}
    files = {"log": str(log.path)}
    for role, model in models.items():
        path = folder / f"identification_{role.replace(' ', '_')}.toml"
        model.write(path, f"identified from {log.path}: {role}")
        files[role] = str(path)
    return _result(bench, known, control, log, found, files)


def run_and_fit(bench: Bench, folder: Path, control: ControlSettings) -> tuple[Log, Fit]:
    """The square wave, and a motor with dry friction fitted to its commands. Raises DataError where none follows."""
    square = Square(duration_s=PERIODS * PERIOD_S, low=LOW_DEG, high=HIGH_DEG, period_s=PERIOD_S)
    plan = Experiment("identification", reference=(square,), control=control, sample_time_s=bench.sample_time_s)
    log = bench.run(plan, folder / "identification.csv")
    turned = float(np.ptp(log.output[log.time_s > log.time_s[-1] - PERIOD_S]))
    if turned < FOLLOWS * (HIGH_DEG - LOW_DEG):
        raise DataError(
            f"the shaft turns {turned:.3g} deg in a period where {HIGH_DEG - LOW_DEG:g} are asked for: this loop "
            "identifies nothing; the deadband is larger than what is compensated, or the motor is not connected"
        )
    return log, fit_from_scratch(Model.parse(MODEL), [record_from_log(log)])


def replicas(log: Log, fitted: Fit, count: int = REPLICAS) -> list[Model]:
    """Models as fitted to the run that the fitted model would have read, from different places within a count."""
    record = record_from_log(log)
    exact = record.y - fitted.errors([record])[0]
    rng = np.random.default_rng(1)
    found = []
    for _ in range(count):
        counts = np.floor((exact + rng.uniform(0.0, record.quantum)) / record.quantum) * record.quantum
        found.append(fit_from_scratch(fitted.model, [replace(record, y=counts)]).model)
    return found


def _both(log: Log) -> tuple[dict[str, Identification], list[str]]:
    """What each method finds, and why one finds nothing."""
    found, said = {}, []
    for method in METHODS:
        try:
            found[method] = identify(log, method)
        except DataError as exc:
            said.append(f"{method}: {exc}")
    return found, said


def measured_profile(bench: Bench) -> BenchProfile:
    """The deadband by slow ramps, where no profile is at hand."""
    found = measure_deadband(bench, REPEATS)
    return BenchProfile(
        bench.transport.name, found.method, max(found.u_plus_pct, 0.0), min(found.u_minus_pct, 0.0),
        found.spread_pct(True), found.spread_pct(False),
    )  # fmt: skip


def _simulated(log: Log, model: Model, control: ControlSettings) -> dict[str, Identification]:
    """What both methods find on the simulated loop of a model; a method that finds nothing is left out."""
    tick_s, count_deg = log.sample_time_s, log.output_quantum
    loop = control.loop(tick_s, log.command_delay_ticks * tick_s, count_deg)
    run = run_loop(Plant.of(model), loop, log.columns["ref_deg"], Start(float(log.output[0]) + 0.5 * count_deg, 0.0))
    columns = {"time_s": run.time_s, "duty_pct": run.duty_pct, "ref_deg": run.ref_deg, "angle_deg": run.angle_deg}
    simulated = Log.from_columns(columns, {**log.metadata, **control.describe()}, "simulated")
    return _both(simulated)[0]


def _result(
    bench: Bench, known: BenchProfile, control: ControlSettings, log: Log, found: Found, files: Mapping[str, str]
) -> LabResult:
    estimated = estimates(found.friction, found.replicas)
    level = estimated[LEVEL].value
    gain, tau = estimated[f"linear.{GAIN}"], estimated[f"linear.{TAU}"]
    zeta, omega = closed_loop(gain.value, tau.value, KP)
    rows: list[Sequence[Cell]] = [_row(method, one) for method, one in found.measured.items()]
    fit_pct = 100.0 * (1.0 - found.left_rms_deg / float(np.std(log.output)))
    rows.append(
        ("with friction", gain.value, gain.half_width, tau.value, tau.half_width, zeta, omega,
         fit_pct, found.left_rms_deg)
    )  # fmt: skip
    columns = ("method", "K (deg/s/%)", "+-", "tau (s)", "+-", "zeta", "omega_n (rad/s)", "fit (%)", "rms (deg)")
    simulated: list[Sequence[Cell]] = [
        (loop, method, *_brief(one).values())
        for loop, both in (("with friction", found.with_friction), ("without", found.without))
        for method, one in both.items()
    ]
    loops = ("the loop simulated", "method", "K (deg/s/%)", "tau (s)", "zeta", "omega_n (rad/s)")
    values = {
        "kp_pct_per_deg": KP,
        "compensation_plus_pct": control.u_plus_pct,
        "compensation_minus_pct": control.u_minus_pct,
        "deadband_share": known.share,
        **{method: one.to_json() for method, one in found.measured.items()},
        "with_friction": {
            "model": MODEL, "rms_deg": found.left_rms_deg,
            "parameters": {name: estimate.to_json() for name, estimate in estimated.items()},
        },
        "simulated_with_friction": {name: _brief(one) for name, one in found.with_friction.items()},
        "simulated_without": {name: _brief(one) for name, one in found.without.items()},
    }  # fmt: skip
    figures = _step_table(log, control)
    return LabResult(
        name="identification",
        title=f"Closed-loop identification, square {LOW_DEG:g}/{HIGH_DEG:g} deg, period {PERIOD_S:g} s, C(s) = {KP:g}",
        target=bench.transport.name,
        tables=(
            figures,
            Table("K and tau of the motor, +- half a 95 % interval", columns, rows),
            Table("What both methods find on the simulated loop of the fit with friction", loops, simulated, (0, 1)),
        ),
        answers=(
            *_said_by_steps(figures, found),
            *_answers(control, found, level, gain.value, tau.value, log),
        ),
        notes=_notes(log, known, found),
        values=values,
        figures={"identification": lambda: _plot(log, found)},
        files=files,
    )


def _row(label: str, found: Identification) -> tuple[Cell, ...]:
    gain, tau = found.parameters[GAIN], found.parameters[TAU]
    return (label, gain.value, gain.half_width, tau.value, tau.half_width, found.value(ZETA), found.value(OMEGA),
            found.fit_pct, found.rms)  # fmt: skip


def _brief(found: Identification) -> dict[str, float]:
    return {name: found.value(name) for name in (GAIN, TAU, ZETA, OMEGA)}


def _step_table(log: Log, control: ControlSettings) -> Table:
    """The figures that are read off an oscilloscope, over all steps."""
    delay_s = log.command_delay_ticks * log.sample_time_s
    steps = steps_of(
        log.time_s, log.columns["ref_deg"], log.output, log.duty_pct, control.limit_pct, delay_s, log.output_quantum
    )
    shown = {
        "overshoot (%)": "overshoot_pct", "rise 10-90 % (s)": "rise_s", "peak (s)": "peak_s",
        "settling 2 % (s)": "settling_2_s", "settling 5 % (s)": "settling_5_s", "error (deg)": "steady_state_error",
    }  # fmt: skip
    rows: list[Sequence[Cell]] = []
    for label, name in shown.items():
        values = np.array([float(getattr(step.figures, name)) for step in steps])
        spread = float(values.std(ddof=1)) if values.size > 1 else None
        rows.append((label, float(values.mean()), spread, float(values.min()), float(values.max())))
    return Table(f"Figures of {len(steps)} steps", ("figure", "mean", "spread", "smallest", "largest"), rows)


def _said_by_steps(figures: Table, found: Found) -> tuple[Answer, ...]:
    """The text's blanks of step 2, where the step figures can be used."""
    if "step" not in found.measured:
        return ()
    mean = {str(row[0]): float(row[1] or 0.0) for row in figures.rows}
    step = found.measured["step"]
    return (
        Answer(
            "What do the figures of the step say?",
            f"Overshoot {mean['overshoot (%)']:.1f} %, rise {mean['rise 10-90 % (s)']:.3f} s, settling "
            f"{mean['settling 2 % (s)']:.3f} s (2 %). Overshoot and peak time say zeta = {step.value(ZETA):.3f} and "
            f"omega_n = {step.value(OMEGA):.2f} rad/s, so tau = 1/(2 zeta omega_n) = {step.value(TAU):.4f} s and "
            f"K = omega_n/(2 zeta) = {step.value(GAIN):.2f} deg/s per % "
            f"(INC451, Eq. 2.7, C(s) = {KP:g}).",
        ),
    )


def _answers(
    control: ControlSettings, found: Found, level: float, gain: float, tau: float, log: Log
) -> tuple[Answer, ...]:
    left = level - 0.5 * (control.u_plus_pct - control.u_minus_pct)
    dead_s = (COMMAND_DELAY_TICKS + 0.5) * log.sample_time_s
    errors = " and ".join(f"{one.rms:.2g} deg ({method})" for method, one in found.measured.items())
    why = (
        f"The same log fitted with dry friction and a winding gives K = {gain:.3g} deg/s per %, tau = {tau:.3g} s, "
        f"La/Ra = {1e3 * found.friction.model.number(WINDING):.1f} ms and friction {level:.2f} %, of which the "
        f"precompensator leaves {left:.2f} %; its error is {found.left_rms_deg:.2g} deg "
        f"rms over the whole run, that of the linear loops {errors}. "
    )
    for method in METHODS if explained(found.friction) else ():
        if method in found.with_friction and method in found.without:
            rough, clean = found.with_friction[method], found.without[method]
            why += (
                f"On its simulated loop {method} finds tau = {rough.value(TAU):.3g} s with that friction and its "
                f"compensation, {clean.value(TAU):.3g} s with neither. "
            )
    if explained(found.friction):
        why += (
            "Where the output turns round while the shaft still moves, friction and compensation both brake: damping "
            "that the linear form puts into tau."
        )
        take = (
            "The one with friction: it is simulated with the limit, the counts, the delay and the compensation as they "
            "are. The linear one of the fit is a fair second, for steps of about this size."
        )
    else:
        why += f"Dry friction does not explain this run: fiohost diagnose {log.path} looks for what does."
        take = "None of these for certain: what diagnose finds, or the linear one of the fit, for steps of this size."
    delay = (
        f"The command acts {dead_s * 1e3:.1f} ms late (a tick, and half a tick of holding), which the form does not "
        f"know: kp K times that is {100.0 * KP * gain * dead_s:.0f} % of what damps the loop, so that without friction "
        "tau is found too long and zeta too small by about as much."
    )
    return (
        Answer("How do the two methods differ?", _difference(found)),
        Answer("Why: friction and deadband", why.strip()),
        Answer("Why: the time that a command takes", delay),
        Answer("Which model to design with?", take),
    )


def explained(friction: Fit) -> bool:
    """Whether dry friction is what the linear loop lacks."""
    return friction.rms <= EXPLAINS_DEG


def _difference(found: Found) -> str:
    if len(found.measured) < len(METHODS):
        return f"Only {next(iter(found.measured))} identifies this loop: {'; '.join(found.said)}."
    step, pem = (found.measured[method] for method in METHODS)
    names = {GAIN: "K", TAU: "tau", ZETA: "zeta", OMEGA: "omega_n"}
    apart = [names[name] for name in names if not _overlap(step, pem, name)]
    meet = f"The 95 % intervals of {', '.join(apart)} do not meet" if apart else "The 95 % intervals meet"
    return (
        f"By the steps K = {step.value(GAIN):.2f} deg/s per % and tau = {step.value(TAU):.4f} s, by the fit "
        f"{pem.value(GAIN):.2f} and {pem.value(TAU):.4f} s: K is {_change(step.value(GAIN), pem.value(GAIN))}, tau "
        f"{_change(step.value(TAU), pem.value(TAU))}. {meet}: they say how well the run repeats and what counts "
        "leave open, and hold nothing of what the form lacks."
    )


def _overlap(a: Identification, b: Identification, name: str) -> bool:
    one, other = a.parameters[name].ci95, b.parameters[name].ci95
    return one[0] <= other[1] and other[0] <= one[1]


def _change(value: float, against: float) -> str:
    percent = 100.0 * (value / against - 1.0)
    return f"{abs(percent):.0f} % {'larger' if percent > 0.0 else 'smaller'}"


def _notes(log: Log, known: BenchProfile, found: Found) -> tuple[str, ...]:
    said = [*found.said, *(note for one in found.measured.values() for note in one.notes)]
    rests = (log.time_s % (0.5 * PERIOD_S)) > 0.25 * PERIOD_S
    last = rests & (log.time_s > log.time_s[-1] - 0.5 * PERIOD_S)
    jitter = find_jitter(log.time_s[last], log.duty_pct[last], log.output[last], log.output_quantum)
    if jitter.kind != REST:
        said.append(
            f"the loop does not rest ({jitter.kind}, {jitter.reversals_per_s:.0f} reversals a second): reduce the "
            f"share {known.share:g} of the deadband, as fiohost lab precompensation does"
        )
    return tuple(said)


def _plot(log: Log, found: Found) -> Figure:
    from fiohost.report.identification import plot_identification

    begin = max(one.curves[0].time_s[0] for one in found.measured.values())
    inside = log.time_s >= begin - 1e-9
    simulated = (log.output - found.left_deg)[inside]
    fitted = Curve("", log.time_s[inside], log.output[inside], simulated, log.columns["ref_deg"][inside])
    curves = {f"{name}: tau = {one.value(TAU):.3g} s": one.curves[0] for name, one in found.measured.items()}
    tau = found.friction.model.number(f"linear.{TAU}")
    return plot_identification(
        "Closed-loop identification: a step, and the errors of the whole run",
        {**curves, f"with friction: tau = {tau:.3g} s": replace(fitted, name="friction")},
    )
