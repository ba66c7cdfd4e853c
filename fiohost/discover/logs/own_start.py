"""Held-out logs judged with what differs from run to run taken from their own first seconds.

No bench repeats itself: gain, dry friction, an offset of the load and the dead time of a day are not those of another.
They are the most likely ones given the beginning of the log and how they scatter (maximum a posteriori, as the best
linear prediction of random effects: Laird and Ware 1982); everything else stays as it was fitted. The rest of the log,
which they never saw, is judged with them and without.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from fiohost.discover.logs.folds import piece
from fiohost.discover.logs.movement import at_rest, movement, standing
from fiohost.discover.logs.whitened import with_noise
from fiohost.estimation.fit import Fit, fit
from fiohost.estimation.initial import has_own_zero
from fiohost.estimation.predict import Flat
from fiohost.estimation.record import SHORTEST, Record
from fiohost.judging.metrics import Judgement, judge, pool
from fiohost.motor.effect import effect
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start
from fiohost.noise.estimate import Noise
from fiohost.noise.runs import FRICTION, FRICTIONS, GAIN, LOAD, LOAD_EFFECT, NO_SCATTER, RunToRun
from fiohost.workers import each

GAIN_KEY, LOAD_KEY, DELAY_EFFECT = "linear.gain_deg_s_per_pct", f"{LOAD_EFFECT}.level_pct", "transport_delay"
DELAY_KEY = f"{DELAY_EFFECT}.delay_s"
# A tolerance within which no step is worth taking.
ENDLESS = 1e30


@dataclass(frozen=True)
class OwnSettings:
    """What a log's beginning says of the log."""

    # So much of it at most, and of a short log this share; its first part, in which a motor settles, is left out.
    seconds: float = 10.0
    share: float = 1.0 / 3.0
    left_out: float = 0.2
    # How runs differ where training says nothing of it: gain and friction as shares, load in percent of duty; the dead
    # time by a tick.
    gain_sd: float = 0.05
    friction_sd: float = 0.3
    load_sd_pct: float = 1.0
    delay_sd_ticks: float = 1.0
    rounds: int = 4


SETTINGS = OwnSettings()


@dataclass(frozen=True)
class OwnStart:
    """The rest of a log, from ``from_s`` on, judged without (``cold``) and with (``own``) the log's ``values``, each
    with its unit.
    """

    from_s: float
    values: dict[str, tuple[float, str]]
    cold: Judgement
    own: Judgement

    def to_json(self) -> dict[str, object]:
        return {
            "from_s": self.from_s,
            "values": {key: {"value": value, "unit": unit} for key, (value, unit) in self.values.items()},
            "cold": self.cold.errors.to_json(),
            "own": self.own.errors.to_json(),
        }


def own_starts(
    records: Sequence[Record],
    model: Model,
    noise: Noise,
    settings: OwnSettings = SETTINGS,
) -> list[OwnStart | None]:
    """Each record's own start under a fitted model that leaves a ``noise`` in its training records; None where a record
    is too short.
    """
    return each(lambda r: _own_start(r, model, noise, settings), records)


def pooled(found: Sequence[OwnStart | None]) -> dict[str, object] | None:
    """Errors of all rests together, as the schema has them; None of none."""
    known = [f for f in found if f is not None]
    cold, own = pool([f.cold.errors for f in known]), pool([f.own.errors for f in known])
    return None if cold is None or own is None else {"cold": cold.to_json(), "own": own.to_json()}


def _own_start(record: Record, model: Model, noise: Noise, settings: OwnSettings) -> OwnStart | None:
    times = record.excitation.times_s - record.excitation.times_s[0]
    ends_s = min(settings.seconds, settings.share * record.seconds)
    first, last = np.searchsorted(times, (settings.left_out * ends_s, ends_s)).tolist()
    if last - first < SHORTEST or len(record) - last < SHORTEST or ends_s < 1.0:
        return None
    beginning = piece(record, first, last, record.name)
    rest = piece(record, last, len(record), record.name)
    known, zero = _most_likely(beginning, model, noise, settings)
    cold = judge(rest, model)
    if zero is not None:
        known, rest = from_zero(known, zero), replace(rest, own_zero=False)
    keys = [key for key in _keys(known) if key in known.values]
    values = {key: (known.number(key), known.parameter(key).unit) for key in keys}
    return OwnStart(float(times[last]), values, cold, judge(rest, known))


def _keys(model: Model) -> list[str]:
    return [GAIN_KEY, *(key for key in FRICTIONS if key in model.values), LOAD_KEY, DELAY_KEY]


def _spreads(model: Model, tick_s: float, runs: RunToRun, settings: OwnSettings) -> dict[str, float]:
    """How far (standard deviation) a run's own values lie from those of the model; those that do not differ are left
    out. What training runs that differ do not differ by is theirs to say: a load of the run's own would else be the
    likeliest reason of any other speed.
    """
    sd = np.array([settings.gain_sd, settings.friction_sd, settings.load_sd_pct])
    sd = runs.sd if runs.known else sd
    of = {GAIN_KEY: sd[GAIN] * abs(model.number(GAIN_KEY)), LOAD_KEY: sd[LOAD]}
    of |= {key: sd[FRICTION] * max(abs(model.number(key)), 1e-3) for key in FRICTIONS if key in model.values}
    of |= {DELAY_KEY: settings.delay_sd_ticks * tick_s}
    return {key: float(value) for key, value in of.items() if value > 0.0 and key not in model.fixed}


def _most_likely(record: Record, model: Model, noise: Noise, settings: OwnSettings) -> tuple[Model, float | None]:
    """The model with the record's own values, and where on the bench's turn the record's zero is (None: known)."""
    for name in (LOAD_EFFECT, DELAY_EFFECT):
        if name not in model.effects:
            parameter = effect(name).parameters[0]
            model = model.with_effect(name, {parameter.name: float(parameter.neutral or 0.0)})
    spreads = _spreads(model, record.sample_time_s, noise.runs, settings)
    keys, precision = list(spreads), np.array(list(spreads.values())) ** -2.0
    mean = np.array([model.number(key) for key in keys])
    own = replace(model, fixed=frozenset(key for key in model.values if key not in keys))
    bare = replace(record, disturbance=None, every=1)
    begun = fit(own, [bare], windows=True, max_iterations=1, tolerance=ENDLESS).starts
    moves = at_rest(movement(bare, own, begun[0]), standing(bare, own, begun[0], noise.torque_pct.value))
    (record,) = with_noise([bare], own, replace(noise, runs=NO_SCATTER), [moves])
    lower, upper = (np.array([getattr(model.parameter(k), end) for k in keys]) for end in ("lower", "upper"))

    def seen_at(here: np.ndarray, starts: Sequence[Start]) -> tuple[float, Fit]:
        at = own.with_values(dict(zip(keys, here.tolist(), strict=True)))
        # A wrong speed drifts by more than the turn swings, so that each speed has a zero of its own.
        anew = [s._replace(zero=None) for s in starts]
        seen = fit(at, [record], windows=True, starts=anew, max_iterations=1, tolerance=ENDLESS)
        return seen.cost + float(precision @ (here - mean) ** 2), seen

    here, (cost, seen) = mean, seen_at(mean, begun)
    for _ in range(settings.rounds):
        columns = seen.jacobians[0][:, [seen.names.index(key) for key in keys]]
        pull = columns.T @ seen.residuals[0] - precision * (here - mean)
        step = np.linalg.solve(columns.T @ columns + np.diag(precision), pull)
        there = np.clip(here + step, lower, upper)
        next_cost, found = seen_at(there, seen.starts)
        if next_cost >= cost:
            break
        here, cost, seen = there, next_cost, found
    known = own.with_values(dict(zip(keys, here.tolist(), strict=True)))
    zero = (seen.starts[0].zero or 0.0) if has_own_zero(record, Flat.of(known)) else None
    return replace(known, fixed=model.fixed), zero


def from_zero(model: Model, zero_deg: float) -> Model:
    """The same model for angles counted from another zero of the bench's turn."""
    values: dict[str, float | str] = {}
    for item in (part for part in model.parts() if part.angle_bound):
        whole = next((q.name for q in item.parameters if q.whole), None)
        for q in item.parameters:
            if q.order is None and q.period is None:
                continue
            turns = q.order if q.order is not None else round(model.number(f"{item.name}.{whole}")) if whole else 1
            key = f"{item.name}.{q.name}"
            moved = model.number(key) + turns * zero_deg
            values[key] = moved if q.period is None else (moved + 180.0) % 360.0 - 180.0
    return model.with_values(values)
