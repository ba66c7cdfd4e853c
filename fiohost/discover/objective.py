"""The objective: simulation error by multiple shooting, the horizon as long as the noise lets it be.

A motor that repeats itself to the count is fitted in whole runs: there the counts are all that a true model leaves. One
that does not is fitted in one-second windows, each with its own angle and speed, weighed by the covariance of the noise
that is left. Both give a deviance, -2 log likelihood but for a constant, and everything else works on that.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.floor import replica_errors
from fiohost.discover.folds import folds
from fiohost.discover.screen import Screen
from fiohost.discover.settings import SETTINGS
from fiohost.discover.stage import Stage, judged
from fiohost.discover.whitened import drawing, plain, settle, with_noise, with_scatter
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.record import Record, thinned
from fiohost.noise.estimate import Noise


@dataclass(frozen=True)
class State:
    """A fitted structure: its ``records`` as they were fitted, ``deviance``, the ``noise`` that it leaves in windows
    and how the shaft moves there (``moving``, n each). ``bare`` is its fit to windows as they are.
    """

    fit: Fit
    records: tuple[Record, ...]
    deviance: float
    noise: Noise | None = None
    moving: tuple[np.ndarray, ...] = ()
    bare: Fit | None = None

    @property
    def price(self) -> float:
        """Deviance with a price on each parameter (Schwarz 1978)."""
        return self.deviance + len(self.fit.names) * float(np.log(max(self.fit.samples, 2.0)))

    @property
    def variance(self) -> float:
        """Of what is left, in the unit in which residuals are squared: 1 where they are whitened."""
        return 1.0 if self.noise else self.fit.cost / max(self.fit.samples, 1.0)


class Objective:
    """Training records, or pieces of them where they are few, as they are fitted; ``plain`` without weights."""

    windows = False

    def __init__(self, train: Sequence[Record]) -> None:
        self.train = train
        self.records, self.groups = folds(train)
        self.plain: Sequence[Record] = self.records

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

    def plainly(self, state: State) -> Fit:
        """A state's model fitted to them."""
        return state.fit

    def under(self, state: State, other: State) -> Fit:
        """A state's model fitted under another's noise."""
        raise NotImplementedError

    def null(self, state: State, best: State) -> State:
        """A state with the noise that the best candidate leaves: were nothing missing, it would be the state's own."""
        raise NotImplementedError

    def stage(self, state: State, rng: np.random.Generator) -> Stage:
        """A state judged on whole records."""
        train = drawing(self.train, state.noise) if state.noise else self.train
        return judged(state.fit, state.records, train, rng)

    def draw(self, state: State, rng: np.random.Generator) -> list[np.ndarray]:
        """One bootstrap sample of what a state leaves, as it was fitted."""
        return replica_errors(state.fit, state.records, rng, anywhere=True)


class WholeRuns(Objective):
    """Free runs of whole records: counts are all that a true model leaves."""

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        n = max(fitted.samples, 1.0)
        return State(fitted, tuple(self.records), n * float(np.log(max(fitted.cost / n, 1e-300))))

    def screens(self, state: State) -> list[Screen]:
        return [Screen(state.fit, self.records)]

    def under(self, state: State, other: State) -> Fit:
        return state.fit

    def null(self, state: State, best: State) -> State:
        return state


class Windows(Objective):
    """One-second windows whitened by the noise that a structure leaves itself."""

    windows = True

    def __init__(self, train: Sequence[Record]) -> None:
        super().__init__(train)
        every = -(-sum(len(r.windows) - 1 for r in self.records) // SETTINGS.most_windows)
        self.records = [replace(thinned(r, SETTINGS.window_step_s), every=every) for r in self.records]
        # Restricted likelihoods compare only where the same is projected off: the shaft stands where the first says.
        self._moving: tuple[np.ndarray, ...] | None = None
        self.plain = plain(self.records)
        self._plainly: dict[int, tuple[State, Fit]] = {}

    def settled(self, fitted: Fit, whitened: bool = False) -> State:
        found = settle(fitted, self.records, self._moving, bare_first=not whitened)
        self._moving = found.moving
        return State(found.fit, found.records, found.deviance, found.noise, found.moving, found.bare)

    def screens(self, state: State) -> list[Screen]:
        # Where much is missing the noise takes up what an effect would explain: windows as they are are asked too.
        bare = Screen(self._fitted(state.fit, self.plain), self.plain)
        return [Screen(state.fit, state.records, bare.span.lines_hz), bare]

    def plainly(self, state: State) -> Fit:
        if id(state) not in self._plainly:
            near = state.bare or state.fit
            found = fit(near.model, self.plain, windows=True, starts=near.starts, max_iterations=20, tolerance=1e-4)
            self._plainly[id(state)] = state, found
        return self._plainly[id(state)][1]

    def under(self, state: State, other: State) -> Fit:
        return self._fitted(state.fit, other.records)

    def null(self, state: State, best: State) -> State:
        assert best.noise is not None
        records = with_noise(self.plain, state.fit.model, best.noise, state.moving)
        if best.noise.runs.known:
            records = with_scatter(state.fit, records, best.noise)
        return State(self._fitted(state.fit, records), records, state.deviance, best.noise, state.moving)

    @staticmethod
    def _fitted(found: Fit, records: Sequence[Record]) -> Fit:
        return fit(
            found.model, records, windows=True, starts=found.starts, max_iterations=12, tolerance=1e-5, zeros=False
        )
