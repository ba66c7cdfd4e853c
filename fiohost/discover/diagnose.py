"""The diagnosis: fit what is declared, judge it, and add what it lacks until nothing more is earned.

Training records decide everything. Held-out records are judged once, at the end, by the models that were chosen.
"""

from __future__ import annotations

import gc
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from threadpoolctl import threadpool_limits

from fiohost.advice.outlook import Outlook
from fiohost.checks.asked import shifted
from fiohost.checks.preliminary import Preliminary, examine
from fiohost.checks.said import Said
from fiohost.discover.candidate import Candidate, Progress
from fiohost.discover.degenerate import believed
from fiohost.discover.logs.ladder import Ladder
from fiohost.discover.logs.one_clock import in_sequence
from fiohost.discover.logs.own_start import SETTINGS as OWN
from fiohost.discover.logs.own_start import OwnSettings, OwnStart, own_starts
from fiohost.discover.logs.unnamed import Unnamed, with_curves
from fiohost.discover.logs.whitened import drawing, looks_white, noise_of
from fiohost.discover.step import Step
from fiohost.errors import DataError
from fiohost.estimation.bench import joining, pwm_of, with_bench
from fiohost.estimation.counted import as_counts
from fiohost.estimation.intervals import Estimate, estimates
from fiohost.estimation.record import ANGLE, Record, speed_unit
from fiohost.estimation.seen import seen_of
from fiohost.judging.floor import Floor, floors
from fiohost.judging.followed import Dependence, ForceCurve, dependences, force_curves
from fiohost.judging.metrics import Errors, Judgement, judge, pool
from fiohost.judging.stage import Stage
from fiohost.judging.verdict import Excess, excesses
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import NO_SCATTER
from fiohost.workers import each


@dataclass(frozen=True)
class Followed:
    """How a model follows records, and their floors."""

    judgements: tuple[Judgement, ...]
    floors: tuple[Floor, ...]


@dataclass(frozen=True)
class Diagnosis:
    """All that was found; ``to_json`` gives schema ``fiohost.diagnosis/1``."""

    declared: Stage
    steps: tuple[Step[Stage], ...]
    candidates: tuple[Candidate, ...]
    residual: tuple[Dependence, ...]
    train: tuple[Record, ...]
    holdout: tuple[Record, ...]
    before_holdout: tuple[Judgement, ...]
    after_holdout: tuple[Judgement, ...]
    step_holdout: tuple[tuple[Judgement, ...], ...]
    floor_holdout: tuple[Floor, ...]
    preliminary: Preliminary
    seconds: float
    files: dict[str, dict[str, str]] = field(default_factory=dict)
    outlook: Outlook = field(default_factory=Outlook)
    one_clock: bool = False
    noise: Noise | None = None
    noise_decided: bool = False
    curves: tuple[ForceCurve, ...] = ()
    white: bool = False
    ruling: tuple[str, ...] = ()
    tolerance_pct: float = 0.0
    unnamed: Unnamed | None = None
    own_starts: tuple[OwnStart | None, ...] = ()
    own_settings: OwnSettings = OWN
    logged: tuple[Record, ...] = ()
    logged_stages: tuple[Followed, ...] = ()

    @property
    def stages(self) -> tuple[Followed, ...]:
        """The declared model and that of each step on the training logs as they were logged."""
        return self.logged_stages or tuple(
            Followed(s.judgements, s.floors) for s in (self.declared, *(step.stage for step in self.steps))
        )

    @property
    def tolerable(self) -> bool:
        """Whether what is left does not matter to the user."""
        return self.tolerance_pct > 0.0 and self.final.left_pct <= self.tolerance_pct

    @property
    def final(self) -> Stage:
        return self.steps[-1].stage if self.steps else self.declared

    @property
    def in_hand(self) -> Model:
        """The best usable model: the final one, curves of no name in it where something stays unexplained."""
        return replace(self.unnamed.model if self.unnamed else self.final.fit.model, seen=seen_of(self.train))

    @property
    def depends_on(self) -> list[str]:
        """What the missing torque follows where something stays unexplained, by variable."""
        if self.verdict != "unexplained":
            return []
        found = [d.variable for d in self.residual if d.significant]
        more = (n for n in self.ruling if not (n == "angle_and_speed_sign" and "angle" in found))
        return list(dict.fromkeys([*found, *more]))

    @property
    def extrapolates(self) -> dict[str, list[str]]:
        """By held-out record, where it goes beyond what the training records went through."""
        seen = seen_of(self.train)
        beyond = {r.name: seen.beyond(seen_of([r]), speed_unit(r.unit)) for r in self.holdout}
        return {name: parts for name, parts in beyond.items() if parts}

    @property
    def verdict(self) -> str:
        if not self.tolerable and (not self.final.follows or (self.noise_decided and not self.white)):
            return "unexplained"
        return "explained" if self.steps else "no_missing_effect"

    @property
    def explained_to(self) -> str | None:
        """To what the final model explains the data: the sensor's counts, noise, how far repeats of a run differ, or
        what the user tolerates.
        """
        if self.verdict == "unexplained":
            return None
        if not self.final.follows or (self.noise_decided and not self.white):
            return "tolerance"
        scatter = self.noise_decided and self.noise is not None and self.noise.runs.known
        if scatter or any(f.source == "repeats" for f in self.final.floors):
            return "repeatability"
        counts = not self.noise_decided or self.noise is None or self.noise.only_counts
        return "sensor" if counts else "noise"

    @property
    def explained_pct(self) -> float | None:
        """Share of the declared model's squared error that is gone, in one-second windows; of what stands above the
        floor where no more than that is left.
        """
        before, after = pooled(self.declared.judgements), pooled(self.final.judgements)
        floor = pool([f.errors for f in self.final.floors])
        if before is None or after is None or floor is None:
            return None
        least = 0.0 if self.verdict == "unexplained" else floor.window_rms**2  # what is left is then no noise
        there = before.window_rms**2 - least
        left = max(after.window_rms**2 - least, 0.0)
        return 100.0 * max(1.0 - left / there, 0.0) if there > left else (100.0 if left == 0.0 else 0.0)

    @property
    def not_followed(self) -> list[Excess]:
        """Where held-out records stand above what chance allows though all training records are followed: they show
        something that those do not. It is said, and changes nothing else.
        """
        above = excesses(self.holdout, self.after_holdout, self.floor_holdout) if self.final.follows else []
        return [e for e in above if e.value > e.allowed]


def diagnose_records(
    train: Sequence[Record],
    holdout: Sequence[Record],
    model: Model,
    *,
    library: Sequence[str] | None = None,
    from_file: bool = False,
    seed: int = 0,
    tolerance_pct: float = 0.0,
    own: OwnSettings = OWN,
    say: Progress = lambda text: None,
    files: dict[str, dict[str, str]] | None = None,
    said: Mapping[str, Said] | None = None,
) -> Diagnosis:
    """Diagnose a declared model on training records; held-out records report only.

    ``library`` restricts the candidates, ``seed`` fixes the replicas, ``own`` says what is taken from the beginning of
    held-out records, ``say`` hears of progress; ``said`` is what logs say beside their records, by name. Raises
    DataError if the records do not share one output or there are none.
    """
    if not train:
        raise DataError("there is no log to fit")
    units = {r.unit for r in (*train, *holdout)}
    if len(units) > 1:
        raise DataError(f"the logs measure different things ({', '.join(sorted(units))}); diagnose them apart")
    train, model = with_bench(train), model.on_axis(train[0].rotary).with_pwm(pwm_of([*train, *holdout]))
    holdout = joining(holdout, train)
    # Records are shared among threads here; numpy's own threads on small matrices would only get in their way.
    with threadpool_limits(limits=1, user_api="blas"):
        return _diagnose(
            train, holdout, model, library, from_file, seed, tolerance_pct, own, say, files or {}, said or {}
        )


def _diagnose(
    train: Sequence[Record],
    holdout: Sequence[Record],
    model: Model,
    library: Sequence[str] | None,
    from_file: bool,
    seed: int,
    tolerance_pct: float,
    own: OwnSettings,
    say: Progress,
    files: dict[str, dict[str, str]],
    said: Mapping[str, Said],
) -> Diagnosis:
    began, logged = time.monotonic(), train
    if counts := as_counts(train, model):
        train = counts
        say("the speeds are differences of counts: searched as the angle that they add up to")
    preliminary = examine(train, holdout, model, said, from_file=from_file, say=say)
    if preliminary.semantics and (earlier := preliminary.semantics.earlier_ticks):
        train, logged, holdout = ([shifted(r, -earlier) for r in part] for part in (train, logged, holdout))
    rng = np.random.default_rng(seed)
    say(f"fitting {model.expression} to {len(train)} logs, {sum(r.seconds for r in train):.0f} s")
    hidden = {name: limit.why for limit in preliminary.data.limits if not limit.apart for name in limit.effects}
    hardly = {name for limit in preliminary.data.limits if limit.hardly for name in limit.effects}
    climbed = Ladder(train, model, library, from_file, rng, say, hidden, hardly, tolerance_pct).climbed()
    gc.collect()  # a ladder and its searches hold each other: of a long log that is hundreds of MiB
    found = believed(climbed, hidden)
    if found.one_clock:
        ordered = in_sequence([*train, *holdout])
        train, holdout = ordered[: len(train)], ordered[len(train) :]
        logged = in_sequence(logged)
    declared, steps, offered, stage = found.stages[0], found.steps, found.offered, found.final
    final, counted = stage.fit.model, train[0].unit != logged[0].unit
    noise = found.noise or noise_of(final, [j.start for j in stage.judgements], train)
    heard = noise.of_speeds(train[0].sample_time_s) if counted else noise
    if found.noise:
        train, logged, holdout = drawing(train, noise), drawing(logged, heard), drawing(holdout, heard)
    say("judging logs as they were logged") if counted else None
    as_logged = [_followed(s, logged, rng) for s in (declared, *(s.stage for s in steps))] if counted else []
    say("judging held-out logs") if holdout else None
    after = tuple(each(lambda r: judge(r, final), holdout)) if holdout else ()
    left = dependences(train, final, stage.judgements, rng)
    lacked = dependences(train, declared.fit.model, declared.judgements, rng) if steps else left
    diagnosis = Diagnosis(
        own_starts=tuple(own_starts(holdout, final, heard, own)),
        own_settings=own,
        curves=tuple(force_curves(lacked, left)),
        tolerance_pct=tolerance_pct,
        declared=declared,
        steps=tuple(steps),
        candidates=tuple(offered),
        residual=tuple(left),
        train=tuple(train),
        holdout=tuple(holdout),
        before_holdout=tuple(each(lambda r: judge(r, declared.fit.model), holdout)) if holdout else (),
        after_holdout=after,
        step_holdout=tuple(tuple(judge(r, s.stage.fit.model) for r in holdout) for s in steps),
        floor_holdout=tuple(floors(holdout, final, after, stage.scattered_models, rng)) if holdout else (),
        preliminary=preliminary,
        seconds=time.monotonic() - began,
        files=files,
        one_clock=found.one_clock,
        noise=heard,
        noise_decided=found.noise is not None,
        white=found.white if found.noise else looks_white(stage, train),
        ruling=found.ruling,
        logged=tuple(logged),
        logged_stages=tuple(as_logged),
    )
    if diagnosis.verdict != "unexplained":
        return diagnosis
    say("describing by curves what no name explains")
    curves = with_curves(final, train)
    return replace(diagnosis, unnamed=curves, seconds=time.monotonic() - began)


def _followed(stage: Stage, records: Sequence[Record], rng: np.random.Generator) -> Followed:
    """A stage's model on records as they were logged."""
    judged = tuple(each(lambda r: judge(r, stage.fit.model), records))
    return Followed(judged, tuple(floors(records, stage.fit.model, judged, stage.scattered_models, rng)))


def pooled(judgements: Sequence[Judgement]) -> Errors | None:
    return pool([j.errors for j in judgements])


def parameters(found: Diagnosis, stage: Stage) -> dict[str, Estimate]:
    """The parameters of one of the diagnosis' stages, with intervals."""
    count = max((r.quantum for r in found.train if r.kind == ANGLE), default=0.0)
    apart = found.noise is not None and found.noise_decided and len(stage.fit.residuals) == len(found.train)
    runs = found.noise.runs if found.noise is not None and apart else NO_SCATTER
    return estimates(stage.fit, stage.scattered_models, count, runs)
