"""Deadband precompensation: how much of the deadband a loop may be given back before it jitters.

A square wave is run with shares of the measured deadband added to the controller's output (INC451 lab 2, Eq. 2.6), once
between angles that the encoder can read and once half a count beside them, where the error is never zero. What is then
taken is the largest share, from all of it downwards, that leaves the loop at rest everywhere.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import Square
from fiohost.control.jitter import JITTER, LIMIT_CYCLE, REST, Jitter, find_jitter
from fiohost.control.settings import ControlSettings
from fiohost.labs.identification import measured_profile
from fiohost.labs.result import Answer, LabResult, Table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHARES = (0.0, 0.2, 0.4, 0.6, 0.8, 0.9, 1.0, 1.1, 1.25, 1.5, 2.0)
REDUCED_BY = 0.05
LOW_DEG, HIGH_DEG, PERIOD_S, PERIODS = 170.0, 190.0, 4.0, 2
RESTS_AFTER = 0.5  # share of a half period after which the response should be over
WORDS = {REST: "at rest", JITTER: "jittering", LIMIT_CYCLE: "in a limit cycle"}
PLACES = ("on a count", "between counts")


@dataclass(frozen=True)
class Trial:
    """One share: the worst jitter and the largest mean error at the reference's two places."""

    share: float
    jitter: tuple[Jitter, Jitter]
    error_deg: tuple[float, float]
    log: Log

    @property
    def rests(self) -> bool:
        return all(one.kind == REST for one in self.jitter)

    @property
    def worst(self) -> Jitter:
        return max(self.jitter, key=lambda one: one.reversals_per_s)


def precompensation(
    bench: Bench,
    folder: Path,
    profile: BenchProfile | None = None,
    control: ControlSettings | None = None,
    shares: Sequence[float] = SHARES,
) -> tuple[LabResult, BenchProfile]:
    """The sweep and the reduction, and the bench profile with the share that was found. Raises FiohostError."""
    law = control or ControlSettings()
    measured = profile or measured_profile(bench)
    trials = {share: _trial(bench, folder, law, measured, share) for share in sorted(set(shares))}
    share = 1.0
    while share not in trials or not trials[share].rests:
        if share not in trials:
            trials[share] = _trial(bench, folder, law, measured, share)
            continue
        if share <= 0.0:
            break
        share = round(max(share - REDUCED_BY, 0.0), 6)
    kept = replace(measured, target=bench.transport.name, share=share)
    return _result(bench, law, kept, [trials[s] for s in sorted(trials)]), kept


def _trial(bench: Bench, folder: Path, law: ControlSettings, measured: BenchProfile, share: float) -> Trial:
    count_deg = 360.0 / bench.counts_per_rev
    compensated = law.with_compensation(share * measured.u_plus_pct, share * measured.u_minus_pct)
    duration_s = PERIODS * PERIOD_S
    on = Square(duration_s=duration_s, low=LOW_DEG, high=HIGH_DEG, period_s=PERIOD_S)
    beside = replace(on, low=LOW_DEG + 0.5 * count_deg, high=HIGH_DEG + 0.5 * count_deg)
    plan = Experiment(
        f"precompensation_{share:g}", reference=(on, beside), control=compensated, sample_time_s=bench.sample_time_s
    )
    log = bench.run(plan, folder / f"{plan.name}.csv")
    halves = [_half(log, k) for k in range(4 * PERIODS)]
    jitters, errors = [], []
    for place in (halves[1 : 2 * PERIODS], halves[2 * PERIODS :]):  # how the shaft gets to the first level is no step
        jitters.append(max((one for one, _ in place), key=lambda one: (one.kind != REST, one.swing_deg)))
        errors.append(max(error for _, error in place))
    return Trial(share, (jitters[0], jitters[1]), (errors[0], errors[1]), log)


def _half(log: Log, k: int) -> tuple[Jitter, float]:
    """Jitter and mean error of one half period, once the response should be over."""
    half_s = 0.5 * PERIOD_S
    inside = (log.time_s >= (k + RESTS_AFTER) * half_s) & (log.time_s < (k + 1) * half_s - 1e-9)
    y = log.output[inside]
    jitter = find_jitter(log.time_s[inside], log.duty_pct[inside], y, log.output_quantum)
    return jitter, abs(float(np.mean(log.columns["ref_deg"][inside] - y)))


def _result(bench: Bench, law: ControlSettings, kept: BenchProfile, trials: Sequence[Trial]) -> LabResult:
    chosen = next(trial for trial in trials if trial.share == kept.share)
    plus, minus = kept.compensation_pct
    columns = ("share", "u+ (%)", "u- (%)", "reversals (1/s)", "swing (deg)", "error (deg)", "the loop is")
    tables = [
        Table(
            f"Reference {place}: share of the deadband that is compensated",
            columns,
            [
                (t.share, t.share * kept.u_plus_pct, t.share * kept.u_minus_pct + 0.0, t.jitter[i].reversals_per_s,
                 t.jitter[i].swing_deg, t.error_deg[i], WORDS[t.jitter[i].kind])
                for t in trials
            ],
        )
        for i, place in enumerate(PLACES)
    ]  # fmt: skip
    files = {
        "log without compensation": str(trials[0].log.path),
        "log with the share found": str(chosen.log.path),
    }
    return LabResult(
        name="precompensation",
        title=f"Deadband precompensation, {law.kind.upper()} with kp = {law.kp_pct_per_deg:g} %/deg",
        target=bench.transport.name,
        tables=tuple(tables),
        answers=_answers(law, kept, trials, chosen),
        notes=_notes(kept),
        values={
            "u_plus_pct": kept.u_plus_pct,
            "u_minus_pct": kept.u_minus_pct,
            "share": kept.share,
            "compensation_plus_pct": plus,
            "compensation_minus_pct": minus,
            "rests": chosen.rests,
            "error_without_deg": max(trials[0].error_deg),
            "error_deg": max(chosen.error_deg),
            "sweep": [
                {"share": t.share, "reversals_per_s": t.worst.reversals_per_s, "swing_deg": t.worst.swing_deg,
                 "kind": t.worst.kind, "error_deg": max(t.error_deg)} for t in trials
            ],
        },
        figures={
            "precompensation_sweep": lambda: _plot_sweep(trials, kept),
            "precompensation_runs": lambda: _plot_runs(trials, chosen),
        },
        files=files,
    )  # fmt: skip


def _answers(law: ControlSettings, kept: BenchProfile, trials: Sequence[Trial], chosen: Trial) -> tuple[Answer, ...]:
    stuck = max(kept.u_plus_pct, -kept.u_minus_pct) / abs(law.kp_pct_per_deg)
    left = max(1.0 - kept.share, 0.0) * stuck
    full = next(trial for trial in trials if trial.share == 1.0)
    said = [
        Answer(
            "Does the loop jitter when all of the measured deadband is compensated?",
            f"{'No' if full.rests else 'Yes'}: with u+ = {kept.u_plus_pct:.2f} % and u- = {kept.u_minus_pct:.2f} % it "
            f"is {WORDS[full.jitter[0].kind]} where the reference is on a count and {WORDS[full.jitter[1].kind]} "
            "between two, with "
            f"{full.worst.reversals_per_s:.1f} reversals of the duty a second over {full.worst.swing_deg:.1f} deg.",
        ),
        Answer(
            "How far has it to be reduced?",
            f"To {100.0 * kept.share:.0f} % of the deadband: {kept.compensation_pct[0]:.2f} % forward, "
            f"{kept.compensation_pct[1]:.2f} % in reverse. "
            + ("There the loop is at rest in every half period." if chosen.rests else "The loop jitters without any."),
        ),
        Answer(
            "What does the compensation bring?",
            f"Without it the shaft may stop up to {stuck:.1f} deg from where it should, where the controller's output "
            f"is as large as the deadband (here it was {max(trials[0].error_deg):.2f} deg); with the share taken, up "
            f"to {left:.1f} deg (here {max(chosen.error_deg):.2f} deg).",
        ),
    ]
    cycle = next((trial for trial in trials if trial.worst.kind == LIMIT_CYCLE), None)
    if cycle is None:
        text = f"None up to {trials[-1].share:g} times the deadband; what jitters stays within two counts."
    else:
        text = (
            f"From {cycle.share:g} times the deadband on: {cycle.worst.frequency_hz:.1f} Hz, "
            f"{cycle.worst.swing_deg:.1f} deg from peak to peak."
        )
    return (*said, Answer("Is there a limit cycle?", text))


def _notes(kept: BenchProfile) -> tuple[str, ...]:
    if max(kept.u_plus_pct, -kept.u_minus_pct) < 0.25:
        return ("the shaft starts at almost no duty: there is no deadband to compensate",)
    return ()


def _plot_sweep(trials: Sequence[Trial], kept: BenchProfile) -> Figure:
    from fiohost.report.panels import Curve, Panel, plot_panels

    shares = np.array([trial.share for trial in trials])

    def panel(values: Sequence[tuple[float, float]], label: str) -> Panel:
        top = max(max(pair) for pair in values) or 1.0
        curves = []
        for i, place in enumerate(PLACES):
            y = [pair[i] for pair in values]
            curves += [Curve(shares, y, f"reference {place}", i, "target"), Curve(shares, y, "", i, "points")]
        curves.append(Curve([kept.share, kept.share], [0.0, top], f"share taken: {kept.share:g}", -1, "reference"))
        return Panel(curves, label, "share of the measured deadband that is compensated")

    return plot_panels(
        [
            panel([_both(t, "reversals_per_s") for t in trials], "reversals of the\nduty (1/s)"),
            panel([_both(t, "swing_deg") for t in trials], "swing, peak to\npeak (deg)"),
            panel([t.error_deg for t in trials], "mean error (deg)"),
        ],
        "Compensation against jitter, once each response should be over",
        panel_height=2.2,
    )


def _both(trial: Trial, name: str) -> tuple[float, float]:
    return getattr(trial.jitter[0], name), getattr(trial.jitter[1], name)


def _plot_runs(trials: Sequence[Trial], chosen: Trial) -> Figure:
    """The last period of a few runs, whose reference lies between counts."""
    from fiohost.report.panels import Curve, Panel, plot_panels

    shown = {trials[0].share: trials[0], chosen.share: chosen}
    shown |= {t.share: t for t in trials if t.share in (1.0, trials[-1].share)}
    panels = []
    for share in sorted(shown):
        log = shown[share].log
        inside = log.time_s >= (2 * PERIODS - 1) * PERIOD_S
        times = log.time_s[inside]
        reference = Curve(times, log.columns["ref_deg"][inside], "reference", -1, "reference")
        what = f"share {share:g}" + (" (taken)" if share == chosen.share else "")
        panels += [
            Panel([reference, Curve(times, log.output[inside], "measured")], "angle (deg)", title=what),
            Panel([Curve(times, log.duty_pct[inside], "duty")], "duty (%)"),
        ]
    return plot_panels(panels, "Precompensation: the reference between two counts", columns=2, panel_height=2.2)
