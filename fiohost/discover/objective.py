"""The objective: simulation error by multiple shooting, the horizon as long as the noise lets it be.

A motor that repeats itself to the count is fitted in whole runs: there the counts are all that a true model leaves. One
that does not is fitted in one-second windows, each with its own angle and speed, weighed by the covariance of the noise
that is left. Both give a deviance, -2 log likelihood but for a constant, and everything else works on that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.discover.degenerate import core_lost
from fiohost.discover.evidence import Evidence, State, deviance_of
from fiohost.discover.folds import folds
from fiohost.discover.null import draw_null
from fiohost.discover.optimise import again, polish, searched_again, unstuck
from fiohost.discover.refit import LogsBeside
from fiohost.discover.score import Gain, left_out, objection, only_in
from fiohost.discover.screen import Screen
from fiohost.discover.settings import SETTINGS
from fiohost.discover.whitened import drawing, plain, settle, with_noise, with_scatter
from fiohost.estimation.fit import Fit, fit, fit_from_scratch
from fiohost.estimation.record import Record, thinned
from fiohost.judging.missing_torque import dependences, ruled
from fiohost.judging.stage import Stage, judged
from fiohost.motor.model import Model
from fiohost.noise.runs import NO_SCATTER, run_of, varied
from fiohost.noise.whiten import is_white, unevenness


class Logs(Evidence[Stage]):
    """Training records, or pieces of them where they are few, as they are fitted."""

    def __init__(
        self,
        train: Sequence[Record],
        rng: np.random.Generator | None = None,
        anew: bool = False,
    ) -> None:
        """``anew`` says that candidates may begin from values of their own where none comes close."""
        super().__init__(rng)
        self.train, self.anew = train, anew
        self.records, self.groups = folds(train)
        self._own: WeakKeyDictionary[State, np.ndarray] = WeakKeyDictionary()

    @property
    def few(self) -> bool:
        """Whether there are fewer than three experiments."""
        return len(self.records) > len(self.train)

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        """The state of a fit, its deviance comparable with those of others; ``whitened`` says that it was fitted so."""
        raise NotImplementedError

    def screens(self, state: State) -> list[Screen]:
        """Around which fits the library is scored."""
        raise NotImplementedError

    def no_noise(self, state: State) -> bool:
        """Whether the random torque that a state leaves is larger than any bench's."""
        return False

    def under(self, state: State, other: State) -> Fit:
        """A state's model fitted under another's noise."""
        return state.fit

    def chance(self, state: State, best: State) -> State:
        """A state with the noise that the best candidate leaves: were nothing missing, it would be the state's own."""
        return state

    def floor_rms(self, state: State) -> float:
        """The error that whole runs of a state could reach."""
        return self.stage(state).floor_rms

    def judge(self, state: State) -> Stage:
        train = drawing(self.train, state.noise) if state.noise else self.train
        return judged(state.fit, state.records, train, self.rng)

    def declared(self, model: Model, from_file: bool) -> State:
        return self.settled(fit_from_scratch(model, self.records, keep_start=from_file, windows=not self.exact))

    def beside(self, state: State) -> LogsBeside:
        return LogsBeside(self, state)

    def without(self, state: State, name: str) -> State:
        return self.settled(again(state.fit, state.fit.model.without([name]), state.records))

    def gain(self, before: State, after: State) -> Gain:
        if after not in self._own:
            self._own[after] = self._left_out(after.fit, after)
        return Gain.of(self._left_out(self.under(before, after), after), self._own[after], self.settings)

    def _left_out(self, fitted: Fit, under: State) -> np.ndarray:
        """Deviance of left-out blocks of a fit, under the noise that a state leaves."""
        return left_out(fitted, under.variance, under.records, self.groups)

    def degenerate(self, state: State, names: Sequence[str]) -> str | None:
        why = next((w for w in (objection(state.fit, n) for n in names) if w), None)
        return why or core_lost(state.bare or state.fit)  # of noise that is none, weights promise too much

    def unconfirmed(self, before: State, after: State, name: str) -> str | None:
        group = only_in(after.fit, name, self.groups)
        if group is None or self._nothing_left(before, after, group):
            return None
        return f"only {self.records[group[0]].name} shows it, and something is left"

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        """Whether a state explains the only records that show what it has more than the one before."""
        raise NotImplementedError

    def follows(self, state: State) -> dict[str, object]:
        found = dependences(self.train, state.fit.model, self.stage(state).judgements, self.rng)
        return {d.variable: d.to_json() for d in found if d.significant}


class WholeRuns(Logs):
    """Free runs of whole records: counts are all that a true model leaves."""

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        return State(fitted, deviance_of(fitted), tuple(self.records))

    def screens(self, state: State) -> list[Screen]:
        return [Screen(state.fit, self.records)]

    def as_good(self, state: State, best: State) -> bool:
        # Counts of whole runs err alike and do not average out.
        return state.fit.cost <= self.settings.as_good * best.fit.cost

    def only_counts(self, state: State) -> bool:
        """Whether nothing but the rounding to counts is left: no other structure could leave less."""
        counts = max(r.quantum for r in self.records) / float(np.sqrt(12.0))
        return state.fit.rms <= self.settings.finished * counts

    def finished(self, state: State) -> State:
        """A state with its non-smooth parameters searched again, and got out of a local minimum."""
        found, records = state.fit, self.records
        if any(found.model.parameter(n).ragged for n in found.names) and not self.stage(state).at_floor:
            better = searched_again(found, records)
            if better.cost < found.cost and not _doubted(better):
                state = self.settled(better)
        stage, found = self.stage(state), state.fit
        if stage.follows or stage.windows_above_floor > self.settings.stuck:
            return state
        better = unstuck(found, records, self.rng)
        return state if better.cost >= found.cost or _doubted(better) else self.settled(better)

    def polished(self, state: State) -> State:
        better = polish(state.fit, state.records, self.rng)
        return state if better is state.fit or _doubted(better) else self.settled(better)

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        return self.stage(before).left_of(after.fit, group) <= self.settings.finished


class Windows(Logs):
    """One-second windows whitened by the noise that a structure leaves itself; ``plain`` are they as they are."""

    exact = False

    def __init__(self, train: Sequence[Record], rng: np.random.Generator | None = None) -> None:
        super().__init__(train, rng, anew=True)
        every = -(-sum(len(r.windows) - 1 for r in self.records) // SETTINGS.most_windows)
        self.records = [replace(thinned(r, SETTINGS.window_step_s), every=every) for r in self.records]
        self.plain = plain(self.records)
        # Likelihoods compare only where the same is free, so that the shaft stands where the first says.
        self._stands: list[np.ndarray] | None = None
        self._as_they_are: WeakKeyDictionary[State, Fit] = WeakKeyDictionary()
        self._white: WeakKeyDictionary[State, bool] = WeakKeyDictionary()

    @property
    def margin(self) -> float:
        return self.settings.margin_in_windows

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        found = settle(fitted, self.records, self._stands, bare_first=not whitened)
        self._stands = [m.stands for m in found.moving]
        return State(found.fit, found.deviance, found.records, found.noise, found.moving, found.bare)

    def screens(self, state: State) -> list[Screen]:
        # Where much is missing the noise takes up what an effect would explain: windows as they are are asked too.
        bare = Screen(self._fitted(state.fit, self.plain), self.plain)
        return [Screen(state.fit, state.records, bare.span.lines_hz), bare]

    def floor_rms(self, state: State) -> float:
        return float("inf")

    def under(self, state: State, other: State) -> Fit:
        return self._fitted(state.fit, other.records)

    def chance(self, state: State, best: State) -> State:
        assert best.noise is not None
        records = with_noise(self.plain, state.fit.model, best.noise, state.moving)
        if best.noise.runs.known:
            records = with_scatter(state.fit, records, best.noise)
        return State(self._fitted(state.fit, records), state.deviance, records, best.noise, state.moving)

    @staticmethod
    def _fitted(found: Fit, records: Sequence[Record]) -> Fit:
        return fit(
            found.model, records, windows=True, starts=found.starts, max_iterations=12, tolerance=1e-5, zeros=False
        )

    def as_they_are(self, state: State) -> Fit:
        """A state's model fitted to windows as they are."""
        if state not in self._as_they_are:
            near = state.bare or state.fit
            found = fit(near.model, self.plain, windows=True, starts=near.starts, max_iterations=20, tolerance=1e-4)
            self._as_they_are[state] = found
        return self._as_they_are[state]

    def taken(self, before: State, after: State) -> float:
        """The share of the squared error of windows as they are that one state takes of another's."""
        return 1.0 - self.as_they_are(after).cost / max(self.as_they_are(before).cost, 1e-300)

    def immaterial(self, before: State, after: State) -> str | None:
        taken = self.taken(before, after)
        if taken >= self.settings.least_further:
            return None
        return f"removes {100 * max(taken, 0.0):.0f} % of what windows leave"

    def plainly(self, before: State, after: State, names: Sequence[str]) -> bool:
        """Whether windows as they are speak for a candidate, whatever weights say: where much is missing the noise
        takes up what an effect explains, and what is slow in it most of all.
        """
        if self.taken(before, after) < self.settings.least_of_rest:
            return False
        without, found = self.as_they_are(before), self.as_they_are(after)
        if any(objection(found, n) for n in names) or core_lost(found):
            return False
        variance = found.cost / max(found.samples, 1.0)
        blocks = (left_out(f, variance, self.plain, self.groups) for f in (without, found))
        gain = Gain.of(next(blocks), next(blocks), self.settings)
        return gain.sure(self.settings) and not gain.by_one

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        return self.white(after)

    def white(self, state: State) -> bool:
        if self.no_noise(state):
            return False
        if state not in self._white:
            # Counts are no noise: without any, what is at its floor is explained, here as in whole runs.
            at_floor = state.noise is not None and state.noise.only_counts and self.stage(state).follows
            self._white[state] = at_floor or self._looks_white(state)
        return self._white[state]

    def no_noise(self, state: State) -> bool:
        return state.noise is None or state.noise.torque_pct.value > self.most_torque_pct

    def _looks_white(self, state: State) -> bool:
        null = draw_null(state.fit, state.records, Screen(state.fit, state.records, ()), [], self.rng, self.settings)
        uneven = unevenness(state.fit.residuals, [r.edges for r in state.records])
        return is_white(uneven, null.unevenness) and not self._ruled(state)

    @property
    def most_torque_pct(self) -> float:
        """A random torque of more than this is no noise."""
        duty = np.concatenate([r.acting_pct for r in self.records])
        return min(self.settings.most_torque_pct, self.settings.most_of_duty * float(np.sqrt(np.mean(duty**2))))

    def _ruled(self, state: State) -> bool:
        """Whether what a state lacks follows anything, each run with what is its own."""
        assert state.noise is not None
        stage, noise = self.stage(state), state.noise
        by_run = [noise.runs.by_run.get(run_of(r.name), np.zeros(3)) for r in self.train]
        own, *estimates = ([varied(m, v) for v in by_run] for m in (stage.fit.model, *stage.scattered_models))
        records = drawing(self.train, replace(noise, runs=NO_SCATTER))
        starts, s = [j.start for j in stage.judgements], self.settings
        return ruled(records, own, estimates, starts, self.rng, s.follows, s.gumbel_sigmas)


def _doubted(found: Fit) -> bool:
    """Whether something speaks against the effect that was added last."""
    return any(objection(found, name) for name in found.model.effects[-1:])
