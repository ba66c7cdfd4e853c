"""How long the horizon is: whole runs where the bench repeats itself to the count, windows where not."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.checks.counts import AT_SPEED, LEAST_MOVING, ROUGHEST_COUNTS, counts_of, roughness, spread
from fiohost.discover.candidate import Progress
from fiohost.discover.objective import PlainWindows, WholeRuns
from fiohost.discover.optimise import chosen_again
from fiohost.discover.search import Node, Search
from fiohost.discover.step import Found
from fiohost.discover.weighed import WeighedWindows
from fiohost.discover.whitened import drawing, noise_of
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.record import Record
from fiohost.judging.stage import Stage, judged
from fiohost.motor.effect import effects
from fiohost.motor.model import Model
from fiohost.noise.estimate import Noise

# Windows have a stream of draws of their own, so that no other draw depends on whether they are needed.
NOISE_SEED = 1


def searched(
    train: Sequence[Record],
    model: Model,
    library: Sequence[str] | None,
    from_file: bool,
    rng: np.random.Generator,
    say: Progress,
    hidden: Mapping[str, str],
    tolerance_pct: float = 0.0,
) -> Found[Stage]:
    """What a declared model lacks: by whole runs; where these cannot be followed, by windows under the noise that is
    left, without what is ``hidden`` from the logs; by whole runs again from there.

    With few experiments windows come first: their whole runs have too many local minima. What is left below
    ``tolerance_pct`` of the motion is not asked about.
    """
    windows = WeighedWindows(train, np.random.default_rng(NOISE_SEED))

    def noise_alone(model: Model) -> Noise | None:
        """The random torque, or how runs differ, where that is all that a model leaves in windows: no whole run can be
        followed then.
        """
        probe = WeighedWindows(train, np.random.default_rng(NOISE_SEED))
        found = probe.settled(fit(model, probe.plain, windows=True, max_iterations=12))
        noise = found.noise
        known = noise is not None and (noise.torque_known or noise.runs.known)
        return noise if known and probe.white(found) else None

    def in_vain(node: Node) -> bool:
        """Whether no structure follows whole runs. Beside one name a noise may still be another effect, which windows
        do not tell from it.
        """
        return len(node.added) > 1 and noise_alone(node.state.fit.model) is not None

    runs = WholeRuns(train, rng)
    whole = Search(runs, library, say, tolerance_pct=tolerance_pct, in_vain=in_vain)
    root = whole.declared(model, from_file)
    if whole.explains(root):
        return whole.found(root, root)
    exact = not (any(r.broken for r in train) or noisy_sensor(train))
    shown = [n for n in (effects() if library is None else library) if n not in hidden]
    near: WeakKeyDictionary[Node, Node] = WeakKeyDictionary()

    def as_whole_runs(node: Node) -> Node:
        """What windows led to, fitted to whole runs; choices that windows hardly show are made anew there."""
        if node not in near:
            fitted = fit(node.state.fit.model, runs.records, max_iterations=25, tolerance=1e-6)
            near[node] = Node(runs.settled(fitted), node.added)
            if not whole.explains(near[node]):
                near[node] = Node(runs.settled(chosen_again(fitted, runs.records)), node.added)
        return near[node]

    def enough(node: Node) -> bool:
        return exact and whole.explains(as_whole_runs(node))

    def led(seen: Node, further: bool = True) -> Node | None:
        """What explains whole runs from where windows led, with ``further`` effects added there or without, or None."""
        again = as_whole_runs(seen)
        if not whole.explains(again):
            again = Node(runs.finished(again.state), seen.added)
        if whole.explains(again):
            again = whole.exchanged(again, root=None if runs.only_counts(again.state) else root)
        elif further:
            again = whole.run(again)
        return again if whole.explains(again) else None

    def far() -> Found[Stage] | None:
        """What explains whole runs where effects begin from values of their own, or None."""
        search = Search(WholeRuns(train, rng, anew=True), library, say, tolerance_pct=tolerance_pct, in_vain=in_vain)
        best = search.run(root)
        return search.found(root, best) if search.explains(best) else None

    begun_anew = not exact
    if exact and not runs.few:
        best: Node | None = whole.run(root)
        if best is not None and whole.explains(best):
            return whole.found(root, best)
        if timed := _by_one_clock(runs, library, say, model, from_file):
            return timed
        say("whole runs stay unexplained: windows of 1 s")
        noise = noise_alone(root.state.fit.model)
        plain = PlainWindows(train, np.random.default_rng(NOISE_SEED), beside_noise=noise is not None)
        # Where two names do not lead whole runs to the data, noise is asked for before more are.
        rough = Search(
            plain, shown, say, tolerance_pct=tolerance_pct, enough=enough, in_vain=lambda n: len(n.added) > 1
        )
        seen = rough.declared(model, from_file)
        if noise is None or not noise.runs.known:
            seen = rough.run(seen)
        if seen.added and (best := led(seen, further=False)):
            return whole.found(root, best)
        # Where windows lead nowhere, or counts are all that they leave, whole runs are begun anew before noise is
        # asked for.
        if rough.white(seen) or not (seen.added or noise):
            begun_anew = True
            if anew := far():
                return anew
    say("whole runs stay unexplained: windows of 1 s, under the noise that is left")
    by_windows = Search(windows, shown, say, tolerance_pct=tolerance_pct, enough=enough)
    begun = by_windows.declared(model, from_file)
    seen = by_windows.run(begun)
    if exact and (seen.added or runs.few) and (best := led(seen)):
        return whole.found(root, best)
    found = by_windows.found(begun, seen)
    found = _plainly_fitted(replace(found, white=by_windows.white(seen)), windows, rng)
    if not begun_anew and not (found.white and found.final.follows):
        return far() or found
    return found


def _plainly_fitted(found: Found[Stage], windows: WeighedWindows, rng: np.random.Generator) -> Found[Stage]:
    """What a search came to, models that leave more than noise fitted to windows as they are: weights are right only
    where all that is left is what they are made of. Their own data err by what they leave so.

    Where runs differ, windows as they are would have one model for all of them: there weights are kept.
    """
    noise, steps = found.noise, list(found.steps)
    differ = noise is not None and noise.runs.known

    def plainly(stage: Stage) -> Fit:
        return fit(stage.fit.model, windows.plain, windows=True, starts=stage.fit.starts, tolerance=1e-6)

    def plain(stage: Stage) -> Stage:
        fitted = plainly(stage)
        train = windows.train if noise is None else drawing(windows.train, _left_by(fitted, windows, noise))
        return judged(fitted, windows.plain, train, rng)

    taken = 0.0
    if steps:
        before, after = plainly(found.stages[0]), plainly(found.final)
        taken = 1.0 - after.cost / before.cost if before.cost > 0.0 else 0.0
    if differ:
        return replace(found, taken=taken)
    stages = list(found.stages)
    if steps or not found.white:
        stages[0] = plain(stages[0])
    if steps and not found.white:
        steps = [replace(s, stage=plain(s.stage)) for s in steps]
        stages[-1] = steps[-1].stage
    return replace(found, stages=tuple(stages), steps=tuple(steps), taken=taken)


def _left_by(fitted: Fit, windows: WeighedWindows, noise: Noise) -> Noise:
    """The noise that a fit to windows as they are leaves, runs differing as they were found to."""
    return replace(noise_of(fitted.model, fitted.starts, windows.plain), runs=noise.runs)


def noisy_sensor(records: Sequence[Record]) -> bool:
    """Whether readings of a moving shaft are rougher than any counts make them; of a sensor without counts nothing else
    is known.
    """
    if max(r.quantum for r in records) <= 0.0:
        return True
    found = [roughness(data) for data in map(counts_of, records) if data is not None]
    rough = np.concatenate([[], *(r[np.abs(speed) > AT_SPEED] for r, speed in found)])
    return len(rough) >= LEAST_MOVING and spread(rough) > ROUGHEST_COUNTS


def in_sequence(records: Sequence[Record]) -> list[Record]:
    """The records as if each had been begun where the one before it ended."""
    began = np.cumsum([0.0, *(r.seconds for r in records)])
    return [
        replace(r, excitation=replace(r.excitation, clock_s=float(t))) for r, t in zip(records, began[:-1], strict=True)
    ]


def _by_one_clock(
    runs: WholeRuns, library: Sequence[str] | None, say: Progress, model: Model, from_file: bool
) -> Found[Stage] | None:
    """What a search over the records in sequence finds of effects that hang on the bench's own time, where none of
    several says when it was begun; None if nothing that explains them all.
    """
    names = [n for n in (effects() if library is None else library) if effects()[n].clocked]
    if len(runs.train) < 2 or any(r.excitation.clock_s != 0.0 for r in runs.train) or not names:
        return None
    say("the logs do not say when they were begun: as if taken one after the other")
    search = Search(WholeRuns(in_sequence(runs.train), runs.rng), names, say)
    root = search.declared(model, from_file)
    best = search.run(root)
    return replace(search.found(root, best), one_clock=True) if best.added and search.explains(best) else None
