"""Identification of the lab text: K, tau, zeta and wn from logs, by step figures or by a fit, with intervals."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import stdtrit

from fiohost.bench.log import Log
from fiohost.errors import ConfigError, DataError
from fiohost.estimation.fit import fit_from_scratch
from fiohost.estimation.intervals import Estimate, covariance
from fiohost.estimation.record import record_from_log
from fiohost.estimation.second_order import LoopRecord, closed_loop, fit_second_order, open_loop, respond
from fiohost.estimation.step_response import LoopStep, steps_of
from fiohost.motor.model import Model
from fiohost.settings import nearest

METHODS = ("step", "pem")
OUTPUTS = ("angle_deg", "speed_deg_s")
GAIN, TAU, ZETA, OMEGA = "gain_deg_s_per_pct", "tau_s", "zeta", "omega_n_rad_s"
UNITS = {GAIN: "deg/s per %", TAU: "s", ZETA: "", OMEGA: "rad/s", "static_gain": ""}
DIFFERENCE = 1e-6


@dataclass(frozen=True)
class Curve:
    """One log as it was compared, arrays (n) in ``unit``: deg, or deg/s of a log of speeds. The reference is None for
    an open loop.
    """

    name: str
    time_s: np.ndarray
    measured: np.ndarray
    simulated: np.ndarray
    ref_deg: np.ndarray | None
    unit: str = "deg"


@dataclass(frozen=True)
class Identification:
    """What logs say of K / (s (tau s + 1)), and of the loop of proportional gain ``kp_pct_per_deg`` around it.

    ``parameters``: gain_deg_s_per_pct, tau_s, zeta, omega_n_rad_s, each with a 95 % interval; ``spread`` is their
    standard deviation over the steps, of the method ``step`` alone. ``fit_pct`` and ``rms`` (in
    ``output_unit``) compare what is simulated with what was measured.
    """

    method: str
    fitted: str  # "reference": the loop's form, "duty": the motor's
    kp_pct_per_deg: float
    parameters: Mapping[str, Estimate]
    fit_pct: float
    rms: float
    curves: Sequence[Curve] = field(repr=False)
    steps: Sequence[LoopStep] = ()
    spread: Mapping[str, float] = field(default_factory=dict)
    notes: Sequence[str] = ()

    def value(self, name: str) -> float:
        return self.parameters[name].value

    @property
    def output_unit(self) -> str:
        return self.curves[0].unit

    @property
    def model(self) -> Model:
        """The motor alone, as ``linear``."""
        return Model(values={f"linear.{name}": self.value(name) for name in (GAIN, TAU)})

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": "fiohost.identification/1",
            "method": self.method,
            "fitted": self.fitted,
            "kp_pct_per_deg": self.kp_pct_per_deg,
            "parameters": {name: estimate.to_json() for name, estimate in self.parameters.items()},
            "spread": dict(self.spread),
            "fit_pct": self.fit_pct,
            "output_unit": self.output_unit,
            "rms": self.rms,
            **({"rms_deg": self.rms} if self.output_unit == "deg" else {}),
            "logs": list(dict.fromkeys(curve.name for curve in self.curves)),
            "steps": [_step_json(step) for step in self.steps],
            "notes": list(self.notes),
        }


def _step_json(step: LoopStep) -> dict[str, Any]:
    figures = {name: float(value) for name, value in vars(step.figures).items()}
    head = {"at_s": step.at_s, "from_deg": step.from_deg, "to_deg": step.to_deg, "saturated": step.saturated}
    return {**head, **figures, ZETA: step.zeta, OMEGA: step.omega_n_rad_s}


def identify(
    logs: Sequence[Log | str | Path] | Log | str | Path,
    method: str = "pem",
    *,
    fitted: str | None = None,
    kp_pct_per_deg: float | None = None,
) -> Identification:
    """K, tau, zeta and wn from one or more logs.

    ``step``: overshoot and peak time of every step of a closed loop's reference, averaged. ``pem``: a fit of simulated
    to measured angle or speed; ``fitted`` says from what, ``reference`` (a closed loop's second-order form) or ``duty``
    (K / (s (tau s + 1)) on the commands), by default the reference where all logs have one. ``kp_pct_per_deg`` is
    needed where the logs do not say it. Raises FiohostError.
    """
    given = [logs] if isinstance(logs, (Log, str, Path)) else list(logs)
    from fiohost.importing.automatic import read_any

    read = read_any(given)
    if not read:
        raise DataError("there is no log to identify from")
    if method not in METHODS:
        raise ConfigError(f"unknown method {method!r}; {nearest(method, METHODS)}")
    closed = all("ref_deg" in log.columns and np.isfinite(log.columns["ref_deg"]).any() for log in read)
    source = fitted or ("reference" if closed else "duty")
    if source not in ("reference", "duty"):
        raise ConfigError(f"what is fitted is the reference or the duty, not {source!r}")
    by_duty = source == "duty" and method == "pem"
    for log in read:
        if log.output_name not in (OUTPUTS if by_duty else OUTPUTS[:1]):
            needs = "the angle or the speed of a shaft" if by_duty else "the angle of a shaft (a speed: --from duty)"
            raise DataError(f"{log.path} holds {log.output_name}: identification needs {needs}")
    if by_duty:
        return _from_duty(read, kp_pct_per_deg)
    if not closed:
        raise DataError(
            "the logs are of an open loop, without a reference: steps and the loop's form need a closed one (a square "
            "wave with a P controller); for an open loop use the method pem"
        )
    for log in read:
        missing = int(np.count_nonzero(~np.isfinite(log.columns["ref_deg"])))
        if missing:
            raise DataError(f"{log.path} has no reference in {missing} of {len(log)} rows: cut it to its closed loop")
    kp = _kp_of(read, kp_pct_per_deg)
    return _by_steps(read, kp) if method == "step" else _from_reference(read, kp)


def _kp_of(logs: Sequence[Log], given: float | None) -> float:
    """The proportional gain of the logs' controller. Raises DataError where Eq. 2.7 does not hold for them."""
    said = {log.metadata.get("kp_pct_per_deg", "") for log in logs}
    for log in logs:
        kind = log.metadata.get("controller", "p")
        if kind != "p":
            raise DataError(
                f"{log.path} is of a {kind} controller, and this method is for a proportional one: fit from the duty"
            )
    if given is None and len(said) == 1:
        try:
            given = float(next(iter(said)))
        except ValueError:
            given = None
    if given is None:
        raise DataError("the logs do not say one proportional gain: give kp, in percent of duty per degree")
    if not 1e-6 <= given <= 1e6:
        raise ConfigError(f"kp_pct_per_deg = {given:g} is outside 1e-06..1e+06")
    return given


def _limit_of(log: Log) -> float:
    try:
        return float(log.metadata.get("limit_pct", "100"))
    except ValueError:
        return 100.0


def _by_steps(logs: Sequence[Log], kp: float) -> Identification:
    steps = []
    for log in logs:
        delay_s = log.command_delay_ticks * log.sample_time_s
        steps += steps_of(
            log.time_s, log.columns["ref_deg"], log.output, log.duty_pct, _limit_of(log), delay_s, log.output_quantum
        )
    found = [(s.zeta, s.omega_n_rad_s) for s in steps if s.zeta is not None and s.omega_n_rad_s is not None]
    if not found:
        raise DataError(
            f"none of {len(steps)} steps overshoots within the limits of the duty, so they give no zeta: use the "
            "method pem, a larger kp, or smaller steps"
        )
    rows = np.array([(*open_loop(zeta, omega, kp), zeta, omega) for zeta, omega in found])
    mean = rows.mean(axis=0)
    spread = rows.std(axis=0, ddof=1) if len(rows) > 1 else np.full(4, np.inf)
    half = stdtrit(max(len(rows) - 1, 1), 0.975) * spread / np.sqrt(len(rows)) + _open_by_counts(steps, kp)
    parameters = {name: _estimate(name, mean[i], half[i]) for i, name in enumerate((GAIN, TAU, ZETA, OMEGA))}
    notes = []
    if len(found) < len(steps):
        notes.append(
            f"{len(steps) - len(found)} of {len(steps)} steps are left out: no overshoot, or duty at its limit"
        )
    if len(found) == 1:
        notes.append("one step alone has no spread: the intervals are without bound")
    linear, left_out = _loop_records(logs)
    curves = [_curve(*of, respond(of[1], mean[3], mean[2])) for of in linear]
    notes += left_out
    kept = {name: float(spread[i]) for i, name in enumerate((GAIN, TAU, ZETA, OMEGA)) if len(rows) > 1}
    return Identification("step", "reference", kp, parameters, *_errors(curves), curves, steps, kept, notes)


def _open_by_counts(steps: Sequence[LoopStep], kp: float) -> np.ndarray:
    """How far half a count of overshoot and the plateau of the peak leave K, tau, zeta and wn open (4).

    Counts err alike in repeated steps, so this does not shrink with their number: it is the mean over the steps.
    """
    halves = []
    for step in steps:
        corners = step.corners()
        if corners and step.zeta is not None and step.omega_n_rad_s is not None:
            own = np.array((*open_loop(step.zeta, step.omega_n_rad_s, kp), step.zeta, step.omega_n_rad_s))
            ends = np.array([(*open_loop(zeta, omega, kp), zeta, omega) for zeta, omega in corners])
            halves.append(np.max(np.abs(ends - own), axis=0))
    return np.asarray(np.mean(halves, axis=0))


def _from_reference(logs: Sequence[Log], kp: float) -> Identification:
    linear, notes = _loop_records(logs)
    found = fit_second_order([record for _, record, _ in linear])
    curves = [_curve(*of, simulated) for of, simulated in zip(linear, found.simulated, strict=True)]
    if found.zeta >= 1.0:
        notes.append(f"zeta = {found.zeta:.3g}: the loop is not underdamped, K and tau are little determined by it")
    loop, cov = (found.zeta, found.omega_n_rad_s), found.covariance[np.ix_([1, 0], [1, 0])]
    motor = open_loop(*loop, kp)
    variances = _carried(lambda zeta, omega: open_loop(zeta, omega, kp), loop, cov)
    parameters = {**_pair((GAIN, TAU), motor, variances), **_pair((ZETA, OMEGA), loop, np.diag(cov))}
    parameters["static_gain"] = _estimate("static_gain", found.gain, 1.96 * float(np.sqrt(found.covariance[2, 2])))
    return Identification("pem", "reference", kp, parameters, *_errors(curves), curves, notes=notes)


def _pair(names: tuple[str, str], values: tuple[float, float], variances: np.ndarray) -> dict[str, Estimate]:
    return {
        n: _estimate(n, v, 1.96 * float(np.sqrt(max(s, 0.0)))) for n, v, s in zip(names, values, variances, strict=True)
    }


def _carried(
    change: Callable[[float, float], tuple[float, float]], at: tuple[float, float], cov: np.ndarray
) -> np.ndarray:
    """Variances (2) of what a change of variables makes of two estimates, by its derivatives; infinite where one of
    these is unknown.
    """
    if not np.isfinite(cov).all():
        return np.full(2, np.inf)
    point = np.array(at)
    steps = np.diag(DIFFERENCE * point)
    slopes = np.column_stack(
        [(np.array(change(*(point + d))) - np.array(change(*(point - d)))) / (2.0 * d.sum()) for d in steps]
    )
    return np.asarray(np.diag(slopes @ cov @ slopes.T))


def _from_duty(logs: Sequence[Log], kp: float | None) -> Identification:
    """K / (s (tau s + 1)) fitted to the angle, or K / (tau s + 1) to the speed, on the commands."""
    records = [record_from_log(log) for log in logs]
    if len({r.unit for r in records}) > 1:
        raise DataError("some logs hold angles and some speeds: identify from each kind apart")
    found = fit_from_scratch(Model(), records)
    motor = (found.model.number(f"linear.{GAIN}"), found.model.number(f"linear.{TAU}"))
    order = [found.names.index(f"linear.{name}") for name in (GAIN, TAU)]
    cov = covariance(found)[0][np.ix_(order, order)]
    said = {log.metadata.get("kp_pct_per_deg", "") for log in logs}
    kp = kp or (_kp_of(logs, None) if said != {""} else 1.0)
    loop = closed_loop(*motor, kp)
    variances = _carried(lambda gain, tau: closed_loop(gain, tau, kp), motor, cov)
    parameters = {**_pair((GAIN, TAU), motor, np.diag(cov)), **_pair((ZETA, OMEGA), loop, variances)}
    curves = [
        Curve(r.name, log.time_s, r.y, r.y - left, log.columns.get("ref_deg") if r.unit == "deg" else None, r.unit)
        for log, r, left in zip(logs, records, found.errors(records), strict=True)
    ]
    notes = [f"zeta and wn are those of a loop with kp = {kp:g} %/deg around this motor"]
    return Identification("pem", "duty", kp, parameters, *_errors(curves), curves, notes=notes)


def _estimate(name: str, value: float, half: float) -> Estimate:
    return Estimate(
        float(value), UNITS[name], (float(value - half), float(value + half)), bool(np.isfinite(half)), False
    )


def _errors(curves: Sequence[Curve]) -> tuple[float, float]:
    """Fit in percent over all curves, and the error rms in their unit."""
    left = np.concatenate([c.measured - c.simulated for c in curves])
    spread = np.concatenate([c.measured - c.measured.mean() for c in curves])
    fit = 100.0 * (1.0 - np.linalg.norm(left) / max(float(np.linalg.norm(spread)), 1e-300))
    return float(fit), float(np.sqrt(np.mean(left**2)))


def _loop_records(logs: Sequence[Log]) -> tuple[list[tuple[Log, LoopRecord, np.ndarray]], list[str]]:
    """As :func:`_loop_record`, of each log that has one, and a note on the others. Raises DataError for none."""
    found, refused = [], []
    for log in logs:
        try:
            found.append((log, *_loop_record(log)))
        except DataError as exc:
            refused.append(exc)
    if not found:
        raise refused[0]
    return found, [f"left out, {len(refused)} of {len(logs)} records: {exc}" for exc in refused[:1]]


def _curve(log: Log, record: LoopRecord, times: np.ndarray, simulated: np.ndarray) -> Curve:
    seen = np.isfinite(record.y_deg)
    ref = record.ref_deg[seen]
    return Curve(log.path.name, times[seen], record.y_deg[seen], simulated[seen], ref)


def _loop_record(log: Log) -> tuple[LoopRecord, np.ndarray]:
    """A log from where it follows its reference within the limits of the duty, on an even grid, and its times.

    What the duty's limit cut is no linear response; where it was reached, the record begins with the next step.
    """
    ref, limit = log.columns["ref_deg"], _limit_of(log)
    begin = 0
    full = np.flatnonzero(np.abs(log.duty_pct) >= limit)
    if full.size:
        edges = np.flatnonzero(np.diff(ref)) + 1
        later = edges[edges > full[-1]]
        if not later.size:
            raise DataError(
                f"{log.path}: the duty is at its limit up to the last step, so no response is a linear one; "
                "use smaller steps or a smaller gain"
            )
        begin = int(later[0])
    tick = log.tick[begin:] - log.tick[begin]
    n = int(tick[-1]) + 1
    rows = np.searchsorted(tick, np.arange(n), side="right") - 1  # a missing tick keeps the reference before it
    acting = np.concatenate((np.full(log.command_delay_ticks, ref[max(begin - 1, 0)]), ref[begin:][rows]))[:n]
    y = np.full(n, np.nan)
    y[tick] = log.output[begin:]
    times = log.time_s[begin] + np.arange(n) * log.sample_time_s
    return LoopRecord(log.sample_time_s, acting, y), times
