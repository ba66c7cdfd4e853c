"""Rough fits of candidates: some steps from the best beginnings of each, ahead of what is carried to its minimum."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from fiohost.discover.evidence import State
from fiohost.discover.logs.job import Job, Logs
from fiohost.discover.logs.moments import fit_event, moment_of
from fiohost.discover.logs.optimise import begun, gone_on
from fiohost.estimation.fit import Fit
from fiohost.workers import each


def rough_fits(
    logs: Logs, jobs: Sequence[Job], floor: float, rival: State | None = None
) -> tuple[list[Job], list[Fit]]:
    """The jobs worth one, and their rough fits, without their arrays: of a long log, those of all would fill the
    memory. The best scores come first. Beside one at the floor those that score about as much follow, as the data
    may not tell them from it; none where windows reach it, by which nothing is believed, and where whole runs have
    a ``rival`` or are far from it with all of them. Few experiments may be explained by many effects: all follow.
    Long runs are tried at their beginnings first, and only what follows these is fitted to all.
    """
    s = logs.settings
    if logs.exact and logs.long:
        tried = some_rough(logs, [job._replace(records=logs.beginnings) for job in jobs], floor, None, ())
        least = min((f.rms for f in tried), default=np.inf)
        if least > s.lost * floor:
            return list(jobs), tried
        near = s.hopeless * max(least, floor) ** 2
        jobs = [job for job, f in zip(jobs, tried, strict=True) if f.rms**2 <= near]
    first, rest = list(jobs[: s.least_refitted]), list(jobs[s.least_refitted :])
    found = some_rough(logs, first, floor, rival, ())
    least = min((f.rms for f in found), default=np.inf)
    if not logs.exact:
        rest = [] if any(logs.reached(f, floor) for f in found) else rest
    elif not logs.few:
        if rival is not None or least > s.lost * floor:
            rest = []
        elif least**2 <= s.as_good * floor**2:
            rest = [job for job in rest if job.score.share > s.shared_gain * jobs[0].score.share]
    return first + rest, found + some_rough(logs, rest, floor, rival, found)


def some_rough(logs: Logs, jobs: Sequence[Job], floor: float, rival: State | None, others: Sequence[Fit]) -> list[Fit]:
    """Rough fits of some jobs; beside one that is at the floor they go on only where they may come near it."""
    if not jobs:
        return []
    s = logs.settings
    ahead = each(lambda job: list(map(bare, begun(job.base, job.score, job.records))), jobs)
    seen = [*(f for fits in ahead for f in fits), *others, *([rival.fit] if rival else [])]
    best = min(seen, key=lambda f: f.cost)
    # A rival in whole runs is at the floor, or it would be none.
    at_floor = logs.exact and (rival is not None or logs.reached(best, floor))
    most = s.hopeless**2 * best.cost if at_floor else np.inf

    def go_on(i: int) -> Fit:
        job, near = jobs[i], [f for f in ahead[i] if f.cost <= most]
        found = [gone_on(near, job.records) if near else ahead[i][0]]
        if logs.exact and not at_floor and moment_of(job.score.effect) is not None:
            found.append(fit_event(job.base, job.score.effect, job.records))
        return bare(min(found, key=lambda f: f.cost))

    return each(go_on, range(len(jobs)))


def bare(found: Fit) -> Fit:
    """A fit without its arrays."""
    return replace(found, residuals=(), jacobians=(), nuisances=())
