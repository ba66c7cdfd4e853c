"""What a command means on this bench, asked of the data as discrete questions before any effect is looked for.

When does a command act, what does zero duty do, what does the bridge do between pulses? A delay that is no whole number
of ticks is a dead time, not a wrong statement. The user is told; nothing is changed but where nobody said when commands
act, and they did so before their rows: a program that writes a command beside the reading that came after it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.checks.asked import (
    BELIEVED,
    FIRST,
    ROUGH,
    Asked,
    Question,
    at_zero,
    fit_windows,
    floor_of,
    pieces,
    shifted,
)
from fiohost.checks.said import Said
from fiohost.errors import FiohostError
from fiohost.estimation.fit import Fit, best_of, first_guess
from fiohost.estimation.record import ANGLE, BRAKE, Record
from fiohost.motor.model import Model
from fiohost.motor.state import STANDBY
from fiohost.workers import each

OFFSETS = (-2, -1, 0, 1, 2)
LAGS_S = (0.03, 0.1, 0.4)
DECAY_LAGS_S = (0.0003, 0.001, 0.004)
LAG = "armature_inductance"
# A delay is whole within this many standard errors and this part of a tick, or roughly where the floor is far.
SIGMAS, LEAST_TICKS, NEAR_TICK = 3.0, 0.005, 0.1
# Nothing that is missing makes a command act before it was given: of 20 effects none takes more than 1.1 from the error
# so. Where nobody said when it acts, this is enough.
BEFORE = 2.0
LEAST_SAMPLES = 20
# With the bridge open between pulses the mean current is next to nothing below half duty.
LOW_DUTY_PCT, HIGH_DUTY_PCT, PROPORTIONAL, SPEED_SPAN_S = (15.0, 40.0), 65.0, 0.6, 0.02


@dataclass(frozen=True)
class Semantics:
    """All questions, the floor of the window error, and how many seconds of the logs were used."""

    questions: tuple[Question, ...]
    floor: float | None
    seconds_used: float
    earlier_ticks: int = 0  # before their rows commands acted, and nobody said so

    def to_json(self) -> dict[str, object]:
        return {
            "seconds_used": self.seconds_used,
            "floor_window_rms": self.floor,
            **{q.name: q.to_json() for q in self.questions},
        }


def _ticks(record: Record) -> int:
    """Ticks after which a command acts, as the record has it."""
    return round(float(record.excitation.act_times_s[0] - record.excitation.times_s[0]) / record.sample_time_s)


def _free_delay(asked: Asked, model: Model, near: int) -> tuple[float, float, float]:
    """A freely fitted delay in ticks beside the logs' statement, with its 95 % interval."""
    before, sample_s = -OFFSETS[0], float(np.median([p.sample_time_s for p in asked.parts]))
    key = "transport_delay.delay_s"
    late = model.with_effect("transport_delay", {"delay_s": max(before + near, 0.05) * sample_s})
    found = asked.refit(late, lambda r: shifted(r, -before))
    at, curvature = found.names.index(key), sum(j.T @ j for j in found.jacobians)
    error = np.sqrt(found.cost / found.samples * np.linalg.pinv(curvature)[at, at]) / sample_s
    value = found.model.number(key) / sample_s - before
    return float(value), float(value - 1.96 * error), float(value + 1.96 * error)


def _whole(asked: Asked, fits: Mapping[int, Fit], best: int, delay: tuple[float, float, float]) -> str:
    """The verdict on a number of ticks: it must be whole, and no electrical lag may do as well."""
    margin = SIGMAS * (delay[2] - delay[0]) / 1.96 + LEAST_TICKS
    if abs(delay[0] - best) > (margin if asked.reached(fits[best].rms) else NEAR_TICK):
        return "open"
    verdict = asked.believed(fits[0], fits[best])
    if verdict in BELIEVED and LAG not in asked.base.model.effects:
        verdict = asked.believed(fits[0], fits[best], [asked.refit(asked.base.model.with_effect(LAG))])
    return verdict


def _when(asked: Asked, said: Sequence[Said]) -> tuple[Question, int]:
    """When does a command act; and by how many ticks before its row, where nobody said when it does?"""
    name, earlier = "command_delay", 0
    ticks = {_ticks(r) for r in asked.records}
    stated = all(s.delay_ticks is not None for s in said)
    one = next(iter(ticks)) if len(ticks) == 1 else None
    words = f"{one} ticks" if one is not None else "the stated number of ticks, different by log"
    words = words if stated else f"nothing; {words} are taken"
    model = asked.base.model
    if "transport_delay" in model.effects:
        own = "the declared model has a delay of its own, which is fitted freely"
        return Question(name, words, "not_asked", own), 0

    def label(offset: int) -> str:
        return str(one + offset) if one is not None else f"{offset:+d}"

    fits = dict(zip(OFFSETS, each(lambda o: asked.refit(model, lambda r: shifted(r, o)), OFFSETS), strict=True))
    errors = {o: f.rms for o, f in fits.items()}
    best = min(OFFSETS, key=lambda o: errors[o])
    table = {label(o): e for o, e in errors.items()}
    verdict, estimate = "as_said", None
    if best != 0 and not asked.reached(errors[0]):
        value = _free_delay(asked, fits[best].model, best)
        verdict = _whole(asked, fits, best, value)
        before = best < 0 and not stated and abs(value[0] - best) <= NEAR_TICK
        if before and verdict not in BELIEVED and errors[0] >= BEFORE * errors[best]:
            verdict = "suspected"
        estimate = value if one is None else (value[0] + one, value[1] + one, value[2] + one)
    if verdict in BELIEVED:
        sure = "the data say" if verdict == "contradicted" else "the data rather say"
        sentence = (
            f"the logs say {words} until a command acts, {sure} {label(best)} (window error {errors[best]:.3g} against "
            f"{errors[0]:.3g}): set command_delay_ticks, unless there is a dead time of exactly that"
        )
        if best < 0 and one == 0 and not stated:
            earlier = -best
            sentence = (
                f"nobody said when a command acts, {sure} {earlier} row{'s' if earlier > 1 else ''} before its own "
                f"(window error {errors[best]:.3g} against {errors[0]:.3g}), as where it is written beside the reading "
                "that came after it: that is taken"
            )
    elif estimate:
        sentence = (
            f"the data do not settle when a command acts: a free delay goes to {estimate[0]:.3g} ticks"
            f"{'' if one is not None else ' more than said'}, so a dead time or something else is missing"
        )
    else:
        sentence = "commands act when the logs say"
    return Question(name, words, verdict, sentence, table, label(best), estimate), earlier


def _zero(asked: Asked, said: Sequence[Said]) -> Question:
    """Does zero duty brake or coast?"""
    name = "zero_duty"
    parts = asked.parts
    modes = np.concatenate([p.excitation.modes[p.excitation.duties_pct == 0.0] for p in asked.records])
    logged = "coast" if np.all(modes == STANDBY) else "brake" if not np.any(modes == STANDBY) else "as the bits say"
    words = logged if all(s.bits for s in said) else f"nothing; {logged} is taken"
    running = sum(_running_at_zero(p) for p in parts)
    if running < LEAST_SAMPLES:
        return Question(name, words, "not_asked", "the shaft never runs at zero duty: these data cannot tell")
    choices = {"brake": BRAKE, "coast": STANDBY}
    other = [k for k in choices if k != logged]
    found = each(lambda k: asked.refit(asked.base.model, lambda r: at_zero(r, choices[k])), other)
    fits = {logged: asked.base, **dict(zip(other, found, strict=True))}
    errors = {k: f.rms for k, f in fits.items()}
    best = min(errors, key=lambda k: errors[k])
    verdict = asked.believed(fits[logged], fits[best]) if best != logged else "as_said"
    if verdict in BELIEVED:
        sure = "the data say" if verdict == "contradicted" else "the data rather say"
        advice = "see that C3 and C4 reach the bridge" if all(s.bits for s in said) else "log c3 and c4"
        sentence = (
            f"at zero duty the logs say {words}, {sure} {best} (window error {errors[best]:.3g} against "
            f"{errors[logged]:.3g}): {advice}"
        )
    else:
        sentence = (
            "zero duty does what the logs say" if verdict == "as_said" else "zero duty: the data do not settle it"
        )
    return Question(name, words, verdict, sentence, errors, best)


def _running_at_zero(part: Record) -> int:
    """Samples of a piece at which the command is zero and the reading changes."""
    ex = part.excitation
    acting = np.searchsorted(ex.act_times_s, ex.times_s, side="right")
    zero = ex.duties_pct[acting] == 0.0
    return int(np.sum(zero[1:] & zero[:-1] & (np.diff(part.y) != 0)))


def _fast(asked: Asked) -> Fit:
    """The declared model with fast decay, from the best of a few electrical lags, or with that which is declared;
    roughly, where it is no good.
    """
    lags = DECAY_LAGS_S[:1] if LAG in asked.guess.effects else DECAY_LAGS_S
    models = [asked.guess.with_effect("fast_decay", {"electrical_tau_s": tau}) for tau in lags]
    rough = min(each(lambda m: fit_windows(m, asked.parts, ROUGH), models), key=lambda f: f.cost)
    return rough if rough.rms > asked.base.rms else fit_windows(rough.model, asked.parts, FIRST)


def _pulls_at_low_duty(records: Sequence[Record]) -> bool:
    """Whether the shaft runs at low duty nearly in proportion: an open bridge gives no torque there."""
    low, high = [], []
    for record in records:
        ex, span = record.excitation, max(1, round(SPEED_SPAN_S / record.sample_time_s))
        acting = ex.duties_pct[np.searchsorted(ex.act_times_s, ex.times_s[span:], side="right")]
        speed = record.y[span:]
        if record.kind == ANGLE:
            speed = (speed - record.y[:-span]) / (ex.times_s[span:] - ex.times_s[:-span])
        size = np.abs(acting)
        ratio = speed / np.where(size > 0, acting, np.inf)
        low.append(ratio[(size >= LOW_DUTY_PCT[0]) & (size <= LOW_DUTY_PCT[1])])
        high.append(ratio[size >= HIGH_DUTY_PCT])
    below, above = np.concatenate([*low, []]), np.concatenate([*high, []])
    enough = len(below) >= LEAST_SAMPLES and len(above) >= LEAST_SAMPLES
    return enough and bool(np.median(below) > PROPORTIONAL * np.median(above) > 0)


def _between(asked: Asked) -> Question:
    """Is the bridge shorted or open between pulses?"""
    name, effect, base = "decay", "fast_decay", asked.base
    if effect in base.model.effects:
        declared, fits = "fast", {"fast": base, "slow": asked.refit(base.model.without([effect]))}
        verdict = asked.believed(base, fits["slow"])
    else:
        declared, fits, verdict = "slow", {"slow": base}, "as_said" if asked.reached(base.rms) else "open"
        if verdict == "open" and _pulls_at_low_duty(asked.records):
            sentence = "slow decay, as declared: the motor pulls at duties where an open bridge gives no torque"
            return Question(name, "slow decay is declared", "as_said", sentence, {"slow": base.rms}, "slow")
        if verdict == "open":
            fits["fast"] = _fast(asked)
            verdict = asked.believed(base, fits["fast"])
        if verdict in BELIEVED:
            ordinary = [e for e in ("input_deadband", "coulomb_friction") if e not in base.model.effects]
            rivals = each(lambda e: asked.refit(base.model.with_effect(e)), ordinary)
            verdict = asked.believed(base, fits["fast"], rivals)
    errors = {k: f.rms for k, f in fits.items()}
    best = min(errors, key=lambda k: errors[k])
    if verdict in BELIEVED:
        sure = "the data say" if verdict == "contradicted" else "the data rather say"
        sentence = (
            f"{declared} decay is declared, {sure} {best} (window error {errors[best]:.3g} against "
            f"{errors[declared]:.3g}): {'declare' if best == 'fast' else 'take out'} {effect}, or change the bridge"
        )
    else:
        sentence = (
            f"{declared} decay, as declared"
            if verdict == "as_said"
            else "the decay mode does not explain what is missing"
        )
    return Question(name, f"{declared} decay is declared", verdict, sentence, errors, best)


def ask(records: Sequence[Record], said: Sequence[Said], model: Model, *, from_file: bool = False) -> Semantics | None:
    """Ask the training logs what a command means; None where there is nothing to ask.

    ``from_file`` also starts the fit from the model's own values. Never raises for data that cannot be fitted: that is
    for the fit itself to say.
    """
    parts = pieces(records)
    if not parts:
        return None
    try:
        guess = first_guess(model, records)
    except FiohostError:
        return None
    lags = () if "linear.tau_s" in model.fixed else LAGS_S
    starts = [guess.with_values({"linear.tau_s": tau}) for tau in lags]
    usual = starts[len(starts) // 2] if starts else model
    near = best_of([*starts, model] if from_file else starts or [model], lambda m: fit_windows(m, parts, FIRST))
    asked = Asked(records, parts, usual, near, floor_of(near, parts))
    when, earlier = _when(asked, said)
    if earlier:
        moved = [shifted(p, -earlier) for p in parts]
        again = fit_windows(near.model, moved, FIRST)
        asked = Asked([shifted(r, -earlier) for r in records], moved, usual, again, floor_of(again, moved))
    questions = (when, _zero(asked, said), _between(asked))
    return Semantics(questions, asked.floor, sum(p.seconds for p in parts), earlier)
