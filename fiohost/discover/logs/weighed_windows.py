"""Windows weighed by the noise that a structure leaves itself: what is believed of a motor that does not repeat itself
to the count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np

from fiohost.discover.degenerate import core_lost
from fiohost.discover.evidence import State
from fiohost.discover.logs.bootstrap import draw_null
from fiohost.discover.logs.left_out import left_out
from fiohost.discover.logs.non_smooth import thorough_fit
from fiohost.discover.logs.optimise import again
from fiohost.discover.logs.plain_windows import PlainWindows
from fiohost.discover.logs.screen import Screen
from fiohost.discover.logs.whitened import drawing, settle, with_noise, with_scatter
from fiohost.discover.score import Gain, objection
from fiohost.discover.settings import SETTINGS, SearchSettings
from fiohost.estimation.fit import Fit, fit, unchanged
from fiohost.estimation.record import Record
from fiohost.judging.followed import ruled
from fiohost.motor.effect import Effect, effect
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import LOAD, LOAD_EFFECT, NO_SCATTER, run_of, varied
from fiohost.noise.whiten import is_white, unevenness


class WeighedWindows(PlainWindows):
    """One-second windows whitened by the noise that a structure leaves itself; ``plain`` are they as they are."""

    def __init__(
        self,
        train: Sequence[Record],
        rng: np.random.Generator | None = None,
        settings: SearchSettings = SETTINGS,
    ) -> None:
        super().__init__(train, rng, anew=True, settings=settings)
        # Likelihoods compare only where the same is free, so that the shaft stands where the first says.
        self._stands: list[np.ndarray] | None = None
        self._as_they_are: WeakKeyDictionary[State, Fit] = WeakKeyDictionary()
        self._white: WeakKeyDictionary[State, bool] = WeakKeyDictionary()
        self._ruling: WeakKeyDictionary[State, tuple[str, ...]] = WeakKeyDictionary()

    @property
    def least_taken(self) -> float:
        return self.settings.least_further

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        found = settle(fitted, self.records, self._stands, bare_first=not whitened)
        self._stands = [m.stands for m in found.moving]
        return State(found.fit, found.deviance, found.records, found.noise, found.moving, found.bare)

    def finished(self, state: State) -> State:
        """A state with its last effect's non-smooth parameters searched in windows as they are: under the noise that a
        wrong value leaves, a shaft that starts elsewhere is hardly seen.
        """
        state = super().finished(state)
        last = effect(state.fit.model.effects[-1]) if state.fit.model.effects else None
        if last is None or last.once or not any(p.ragged for p in last.parameters):
            return state
        better = thorough_fit(self.as_they_are(state), last, self.plain)
        return min(state, self.settled(better), key=lambda s: s.deviance)

    def screens(self, state: State) -> list[Screen]:
        # Where much is missing the noise takes up what an effect would explain: windows as they are are asked too.
        bare = Screen(self._fitted(state.fit, self.plain), self.plain)
        return [Screen(state.fit, state.records, bare.span.lines_hz), bare]

    def under(self, state: State, other: State) -> Fit:
        return self._fitted(state.fit, other.records)

    def chance(self, state: State, best: State) -> State:
        if best.noise is state.noise:
            return state
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
        """A state's model fitted to windows as they are; from where noise led it, if that is nearer to them."""
        if state not in self._as_they_are:
            weighed = unchanged(state.fit.model, self.plain, starts=state.fit.starts, windows=True, zeros=False)
            near = state.bare if state.bare is not None and state.bare.cost <= weighed.cost else weighed
            near = replace(near, model=state.fit.model) if near is weighed else near
            found = fit(near.model, self.plain, windows=True, starts=near.starts, max_iterations=20, tolerance=1e-4)
            self._as_they_are[state] = found
        return self._as_they_are[state]

    def held_against(self, state: State, found: Sequence[tuple[Effect, State]]) -> State:
        """The state, a load beside it where runs differ in theirs, and few of them may have one in common by chance.

        Only where that state leaves noise: else what is missing may be what makes runs differ.
        """
        if state.noise is None or LOAD_EFFECT in state.fit.model.effects:
            return state
        loaded = next((s for of, s in found if of.name == LOAD_EFFECT), None)
        if loaded is None and state.noise.runs.sd[LOAD] > 0.0:
            begun = state.fit.model.with_effect(LOAD_EFFECT, {"level_pct": 0.0})
            loaded = self.settled(again(state.fit, begun, state.records), whitened=True)
        if loaded is None or loaded.noise is None or loaded.deviance > state.deviance:
            return state
        level = loaded.fit.model.number(f"{LOAD_EFFECT}.level_pct")
        return loaded if loaded.noise.runs.load_by_chance(level, self.margin) and self.white(state) else state

    def taken_beside_noise(self, before: State, after: State) -> float:
        """The share of the squared error that one state takes of another's under the noise that it leaves, each run
        with what is its own.
        """
        return 1.0 - after.fit.cost / max(self.under(before, after).cost, 1e-300)

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

    def white(self, state: State) -> bool:
        if self.no_noise(state):
            return False
        return self._even(state) and (self._at_floor(state) or not self.ruling(state))

    def _nothing_left(self, before: State, after: State, group: Sequence[int]) -> bool:
        return not self.no_noise(after) and self._even(after)

    def _at_floor(self, state: State) -> bool:
        """Whether counts are all that is left: they are no noise, so that the floor decides, as in whole runs."""
        return state.noise is not None and state.noise.only_counts and self.stage(state).follows

    def reached(self, fitted: Fit, floor_rms: float) -> bool:
        return False  # what noise leaves is not known before the model is

    def no_noise(self, state: State) -> bool:
        shortest_s = min(r.seconds for r in self.records)
        return state.noise is None or state.noise.wanders_pct(shortest_s) > self.most_torque_pct

    def _even(self, state: State) -> bool:
        """Whether what is left is counts or as white as what bootstrap samples leave, whatever else it follows."""
        if state not in self._white:
            self._white[state] = self._at_floor(state) or self._looks_white(state)
        return self._white[state]

    def _looks_white(self, state: State) -> bool:
        null = draw_null(state.fit, state.records, Screen(state.fit, state.records, ()), [], self.rng, self.settings)
        uneven = unevenness(state.fit.residuals, [r.edges for r in state.records])
        return is_white(uneven, null.unevenness)

    @property
    def most_torque_pct(self) -> float:
        """A random torque of more than this is no noise."""
        duty = np.concatenate([r.acting_pct for r in self.records])
        return min(self.settings.most_torque_pct, self.settings.most_of_duty * float(np.sqrt(np.mean(duty**2))))

    def ruling(self, state: State) -> tuple[str, ...]:
        """What the torque that a state lacks follows, each run with what is its own."""
        if state.noise is None:
            return ()
        if state not in self._ruling:
            self._ruling[state] = self._ruled(state, state.noise)
        return self._ruling[state]

    def _ruled(self, state: State, noise: Noise) -> tuple[str, ...]:
        stage = self.stage(state)
        by_run = [noise.runs.by_run.get(run_of(r.name), np.zeros(3)) for r in self.train]
        own, *estimates = ([varied(m, v) for v in by_run] for m in (stage.fit.model, *stage.scattered_models))
        records = drawing(self.train, replace(noise, runs=NO_SCATTER))
        starts, s = [j.start for j in stage.judgements], self.settings
        shared = ("shared_load",) if noise.runs.shares_load(s.shared_load) else ()
        return shared + ruled(records, own, estimates, starts, self.rng, noise, s.follows, s.gumbel_sigmas)
