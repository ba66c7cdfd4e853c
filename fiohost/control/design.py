"""Gains that meet a specification in simulation: limits, friction, counts, delay and compensation as on the bench.

The worst ratio of a figure to what is allowed is made as small as it goes, first on the model as it is, then on models
whose gain, lag, friction and delay are off: such a controller has room where the bench differs from the model. Where
even the best gains do not meet the specification, what can be met is searched for, one figure at a time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize

from fiohost.control.closed_loop import Plant
from fiohost.control.settings import KINDS, ControlSettings
from fiohost.control.specification import Specification, StepOutcome, distance, outcomes
from fiohost.errors import ConfigError, ModelError
from fiohost.motor.model import Model
from fiohost.settings import nearest

STEPS_DEG = (20.0, 90.0, 180.0)  # of the squares 170/190, 135/225 and 90/270 degrees
SHARE = 0.8  # of the deadband that is compensated, where nobody says otherwise
RESTS_AFTER = 3.0  # a run lasts so many times the settling time asked for, or the time that the largest step needs
SHORTEST_RUN_S, LONGEST_RUN_S = 1.5, 30.0
FILTER_TICKS = 2.0
VARIATIONS = (
    ("gain", 0.9), ("gain", 1.1), ("tau", 0.9), ("tau", 1.1), ("friction", 0.8), ("friction", 1.2), ("delay", 1.0)
)  # fmt: skip
# Where gains are looked for: kp as a multiple of the one that damps the linear loop to 0.7, the times in lags.
KP_RANGE, TD_RANGE, TI_RANGE = (0.1, 40.0), (0.02, 5.0), (0.5, 1000.0)
LOOKS = {1: 5, 2: 7, 3: 8}  # powers of two
BEST = 3
LOOKED_AT_OFF = 24  # of the best points, before the best of them are polished on models that are off
ABOVE = 1.02  # a threshold of so many counts is a little above them, digits cut off
NEAR = 0.02  # how little the mean of all figures counts beside the worst
FIGURES = ("overshoot_pct", "settling_s", "sse_deg")
FRICTION = {
    "coulomb_friction": ("level_pct", "level_pct"),
    "asymmetric_coulomb_friction": ("forward_pct", "reverse_pct"),
    "static_friction": ("extra_pct", "extra_pct"),
    "input_deadband": ("level_pct", "level_pct"),
    "asymmetric_deadband": ("u_plus_pct", "u_minus_pct"),
}


@dataclass(frozen=True)
class Nearest:
    """A specification that can be met, which figures of what was asked for give way, and a controller that meets it."""

    gives_way: tuple[str, ...]
    asked: Specification
    settings: ControlSettings


@dataclass(frozen=True, repr=False)
class Design:
    """A controller, what it does at each step on the model, and the worst on models that are off; ``print`` shows it.

    ``nearest`` are specifications that can be met, where what was asked for cannot.
    """

    settings: ControlSettings
    asked: Specification
    model: Model
    found: Sequence[StepOutcome]
    off: Sequence[StepOutcome]
    sample_time_s: float
    delay_s: float
    quantum_deg: float
    duration_s: float
    nearest: Sequence[Nearest] = ()
    notes: Sequence[str] = ()

    @property
    def feasible(self) -> bool:
        return all(one.meets(self.asked) for one in self.found)

    @property
    def robust(self) -> bool:
        """Whether the specification holds too where the model is off."""
        return all(one.meets(self.asked) for one in self.off)

    @property
    def rank(self) -> tuple[bool, bool, float]:
        """Which of two designs is better: the larger."""
        return self.feasible, self.robust, -float(distance(self.found, self.asked).max())

    @property
    def worst(self) -> dict[str, float]:
        """The largest figures of all steps on the model."""
        names = ("overshoot_pct", "settling_s", "error_deg", "rise_s", "reversals_per_s")
        return {name: max(getattr(one, name) for one in self.found) for name in names}

    def __str__(self) -> str:
        from fiohost.control.said import lines_of

        return "\n".join(lines_of(self))

    def __repr__(self) -> str:
        met = "met" if self.robust and self.feasible else "met on the model only" if self.feasible else "not feasible"
        return f"<Design: {self.settings.kind} for {self.model.expression}, specification {met}; print() shows it>"

    def to_json(self) -> dict[str, Any]:
        return {
            "schema": "fiohost.design/1",
            "model": self.model.expression,
            "specification": vars(self.asked),
            "feasible": self.feasible,
            "robust": self.robust,
            "controller": {"kind": self.settings.kind} | self.settings.describe_numbers(),
            "sample_time_s": self.sample_time_s,
            "steps": [vars(one) for one in self.found],
            "worst": self.worst,
            "worst_off_model": {
                name: max(getattr(one, name) for one in self.off)
                for name in ("overshoot_pct", "settling_s", "error_deg")
            },
            "nearest_feasible": [
                {"gives_way": n.gives_way, "specification": vars(n.asked), "controller": n.settings.describe_numbers()}
                for n in self.nearest
            ],
            "notes": list(self.notes),
        }


def design(
    model: Model | str,
    controller: str = "pd",
    *,
    overshoot_pct: float = 5.0,
    settling_s: float = 0.5,
    sse_deg: float = 1.0,
    band_pct: float = 2.0,
    steps_deg: Sequence[float] = STEPS_DEG,
    compensation_pct: tuple[float, float] | None = None,
    limit_pct: float = 100.0,
    filter_s: float | None = None,
    derivative_on: str = "angle",
    threshold_counts: float | None = None,
    sample_time_s: float = 0.005,
    delay_s: float | None = None,
    quantum_deg: float = 0.5,
) -> Design:
    """Find the gains of a ``p``, ``pd``, ``pi`` or ``pid`` controller for a model (or its expression or file).

    ``compensation_pct`` is the deadband compensation forward and in reverse, by default SHARE of the model's own
    friction and deadband. An error of ``threshold_counts`` counts commands nothing: compensated friction holds a shaft
    no longer, which would jitter from count to count, but a load must be held all the time. Unless given, one count is
    tried where the error allowed is larger, and none. ``delay_s`` is one tick unless given. Raises FiohostError for
    values that make no loop.
    """
    motor = Model.parse(model) if isinstance(model, str) else model
    if controller not in KINDS:
        raise ConfigError(f"unknown controller {controller!r}; {nearest(controller, KINDS)}")
    if not steps_deg or not all(1e-3 <= abs(size) <= 1e5 for size in steps_deg):
        raise ConfigError("a design needs one step or more, each of 0.001 to 100000 deg")
    asked = Specification(overshoot_pct, settling_s, sse_deg, band_pct)
    plus, minus = compensation_pct or tuple(SHARE * level for level in deadband_of(motor))
    base = ControlSettings(
        kind=controller,
        filter_s=FILTER_TICKS * sample_time_s if filter_s is None else filter_s,
        derivative_on=derivative_on,
        limit_pct=limit_pct,
        u_plus_pct=plus,
        u_minus_pct=minus,
    )
    base.law(sample_time_s)  # refuses what makes no law
    tried = [1.0, 0.0] if sse_deg > quantum_deg else [0.0]
    searches = []
    for counts in tried if threshold_counts is None else [threshold_counts]:
        bench = _Bench(sample_time_s, sample_time_s if delay_s is None else delay_s, quantum_deg, counts)
        search = _Search(motor, base, asked, [abs(size) for size in steps_deg], bench)
        at = search.optimum()
        searches.append((search.design_at(at), search, at))
        if searches[-1][0].robust:
            break
    found, search, at = max(searches, key=lambda one: one[0].rank)
    return found if found.feasible else replace(found, nearest=search.nearest(at))


def deadband_of(model: Model) -> tuple[float, float]:
    """Duty at which a model starts from rest, forward (>= 0) and in reverse (<= 0), in percent."""
    load = model.number("constant_load.level_pct") if "constant_load" in model.effects else 0.0
    plus, minus = load, load
    for name in model.effects:
        if name in FRICTION:
            forward, reverse = FRICTION[name]
            plus += abs(model.number(f"{name}.{forward}"))
            minus -= abs(model.number(f"{name}.{reverse}"))
    return max(plus, 0.0), min(minus, 0.0)


def with_deadband(model: Model, u_plus_pct: float, u_minus_pct: float) -> Model:
    """A model with the dead zone of a bench (Eq. 2.5 of the lab text), unless it has friction or a deadband."""
    if FRICTION.keys() & set(model.effects) or u_plus_pct == u_minus_pct == 0.0:
        return model
    return model.with_effect("asymmetric_deadband", {"u_plus_pct": u_plus_pct, "u_minus_pct": u_minus_pct})


def varied(model: Model, what: str, factor: float) -> Model:
    """A model whose gain, lag or friction is off by a factor, or with a delay of so many seconds more."""
    if what == "delay":
        known = model.number("transport_delay.delay_s") if "transport_delay" in model.effects else 0.0
        base = model if "transport_delay" in model.effects else model.with_effect("transport_delay")
        return base.with_values({"transport_delay.delay_s": known + factor})
    keys = {"gain": ["linear.gain_deg_s_per_pct"], "tau": ["linear.tau_s"]}.get(what)
    if keys is None:
        keys = sorted({f"{name}.{part}" for name, parts in FRICTION.items() if name in model.effects for part in parts})
    return model.with_values({key: model.number(key) * factor for key in keys})


class _Bench(NamedTuple):
    """What of the bench matters to a loop."""

    tick_s: float
    delay_s: float
    quantum_deg: float
    threshold_counts: float


class _Search:
    """All that stays the same while gains are looked for."""

    def __init__(
        self, model: Model, base: ControlSettings, asked: Specification, steps_deg: Sequence[float], bench: _Bench
    ) -> None:
        self.model, self.base, self.asked, self.steps_deg, self.bench = model, base, asked, steps_deg, bench
        self.gain, self.tau = model.number("linear.gain_deg_s_per_pct"), model.number("linear.tau_s")
        if not self.gain > 0.0 or not self.tau > 0.0:
            raise ModelError("a loop cannot be designed for a motor whose gain or lag is zero")
        self.nominal = [Plant.of(model)]
        self.off = [
            Plant.of(varied(model, what, by * bench.tick_s if what == "delay" else by)) for what, by in VARIATIONS
        ]
        fastest_s = max(steps_deg) / (self.gain * base.limit_pct) + 3.0 * self.tau  # of the largest step, at the limit
        self.duration_s = min(max(RESTS_AFTER * max(asked.settling_s, fastest_s), SHORTEST_RUN_S), LONGEST_RUN_S)
        ranges = {"p": (KP_RANGE,), "pd": (KP_RANGE, TD_RANGE), "pi": (KP_RANGE, TI_RANGE)}
        self.bounds = np.log(ranges.get(base.kind, (KP_RANGE, TD_RANGE, TI_RANGE)))

    def settings(self, at: np.ndarray) -> ControlSettings:
        """Gains at a point of the search: kp, then the derivative's time, then the integral's, as far as they go."""
        scale = np.exp(np.clip(at, self.bounds[:, 0], self.bounds[:, 1]))
        kp = float(scale[0]) / (4.0 * 0.7**2 * self.gain * self.tau)
        threshold = ABOVE * kp * self.bench.threshold_counts * self.bench.quantum_deg
        found = replace(self.base, kp_pct_per_deg=kp, threshold_pct=threshold)
        if self.base.kind in ("pd", "pid"):
            found = replace(found, kd_pct_s_per_deg=kp * self.tau * float(scale[1]))
        if self.base.kind in ("pi", "pid"):
            ti = self.tau * float(scale[-1])
            found = replace(found, ki_pct_per_deg_s=kp / ti, tracking_s=ti)
        return found

    def look(self, settings: ControlSettings, plants: Sequence[Plant]) -> list[StepOutcome]:
        loop = settings.loop(self.bench.tick_s, self.bench.delay_s, self.bench.quantum_deg)
        return outcomes(plants, loop, self.steps_deg, self.asked, self.duration_s)

    def cost(self, at: np.ndarray, plants: Sequence[Plant]) -> float:
        """The worst ratio of all; outside its range a point costs what it is off by."""
        ratios = distance(self.look(self.settings(at), plants), self.asked)
        return float(ratios.max() + NEAR * ratios.mean()) + self._beyond(at)

    def _beyond(self, at: np.ndarray) -> float:
        return float(np.sum(np.maximum(self.bounds[:, 0] - at, 0.0) + np.maximum(at - self.bounds[:, 1], 0.0)))

    def best(self, cost: Callable[[np.ndarray], float], starts: Sequence[np.ndarray]) -> np.ndarray:
        most = 60 * len(self.bounds)
        tried = [
            minimize(cost, start, method="Nelder-Mead", options={"maxfev": most, "xatol": 0.01, "fatol": 1e-3})
            for start in starts
        ]
        return np.asarray(min(tried, key=lambda found: float(found.fun)).x)

    def optimum(self) -> np.ndarray:
        """The point of the least cost, on models that are off too where the specification can be met at all."""

        def nominal(at: np.ndarray) -> float:
            return self.cost(at, self.nominal)

        def everywhere(at: np.ndarray) -> float:
            return self.cost(at, [*self.nominal, *self.off])

        ranked = sorted([*self.points(), *self.without_integral()], key=nominal)
        at = self.best(nominal, ranked[:BEST])
        if not self.meets(at):
            return at
        robust = self.best(everywhere, sorted([at, *ranked[:LOOKED_AT_OFF]], key=everywhere)[:BEST])
        return robust if self.meets(robust) else at

    def meets(self, at: np.ndarray) -> bool:
        return all(one.meets(self.asked) for one in self.look(rounded(self.settings(at)), self.nominal))

    def points(self) -> list[np.ndarray]:
        """Points all over the range of the gains, the same each time."""
        from scipy.stats import qmc  # takes a second to load

        points = qmc.Sobol(len(self.bounds), seed=1).random_base2(LOOKS[len(self.bounds)])
        return [self.bounds[:, 0] + point * np.ptp(self.bounds, axis=1) for point in points]

    def without_integral(self) -> list[np.ndarray]:
        """The best P or PD controller with an integral that hardly acts, a start for PI and PID."""
        plain = {"pi": "p", "pid": "pd"}.get(self.base.kind)
        if plain is None:
            return []
        search = _Search(self.model, replace(self.base, kind=plain), self.asked, self.steps_deg, self.bench)
        return [np.append(search.optimum(), self.bounds[-1, 1])]

    def design_at(self, at: np.ndarray) -> Design:
        """What a point of the search is as a controller, and what that does."""
        settings = rounded(self.settings(at))
        notes = []
        if not FRICTION.keys() & set(self.model.effects):
            notes.append("the model has neither friction nor deadband: on a bench with either the error will be larger")
        if seen := self.model.seen:
            most = min(settings.limit_pct, max(abs(s) for s in self.steps_deg) * settings.kp_pct_per_deg)
            ask = replace(seen, duty_pct=(min(-most, seen.duty_pct[0]), max(most, seen.duty_pct[1])))
            notes += [f"the model extrapolates: {part}" for part in seen.beyond(ask)]
        return Design(
            settings, self.asked, self.model, self.look(settings, self.nominal), self.look(settings, self.off),
            self.bench.tick_s, self.bench.delay_s, self.bench.quantum_deg, self.duration_s, notes=notes,
        )  # fmt: skip

    def nearest(self, at: np.ndarray) -> list[Nearest]:
        """What can be met: with one figure giving way, or where that is never enough with all that must."""
        found = [self._wider((name,), self._with_others_met(which, at)) for which, name in enumerate(FIGURES)]
        kept = [one for one in found if one is not None]
        whole = self._wider(FIGURES, at) if not kept else None
        return [whole] if whole is not None else kept

    def _with_others_met(self, which: int, at: np.ndarray) -> np.ndarray:
        """The point where one figure is as small as it goes while the others are met."""

        def cost(x: np.ndarray) -> float:
            ratios = distance(self.look(self.settings(x), self.nominal), self.asked)
            others = np.delete(ratios, which)
            return float(ratios[which] + 100.0 * np.maximum(others - 0.98, 0.0).sum()) + self._beyond(x)

        return self.best(cost, [min((*self.points(), at), key=cost)])

    def _wider(self, names: Sequence[str], at: np.ndarray) -> Nearest | None:
        """The specification with these figures widened as far as a point needs; None where that does not help."""
        settings = rounded(self.settings(at))
        found = self.look(settings, self.nominal)
        asked = self.asked
        for i, name in enumerate(FIGURES):
            ratio = max(one.ratios(self.asked)[i] for one in found)
            if name in names and ratio >= 1.0:
                asked = replace(asked, **{name: _upwards(getattr(asked, name) * ratio)})
        meets = all(one.meets(asked) for one in found)
        return (
            Nearest(tuple(n for n in names if getattr(asked, n) > getattr(self.asked, n)), asked, settings)
            if meets
            else None
        )


def _upwards(value: float) -> float:
    """A little more than a value, in three digits: a response stays below it."""
    unit = 10.0 ** (np.floor(np.log10(value)) - 2.0)
    return float(round((np.floor(value / unit) + 1.0) * unit, 12))


def rounded(settings: ControlSettings) -> ControlSettings:
    """Gains as people write them: three digits."""
    numbers = {f.name: getattr(settings, f.name) for f in fields(settings) if f.type == "float"}
    return replace(settings, **{name: float(f"{value:.3g}") for name, value in numbers.items()})  # type: ignore[arg-type]
