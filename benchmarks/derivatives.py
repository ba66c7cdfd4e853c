"""What derivatives of one-second windows cost along their tangent, beside fitting every window anew for each.

    python benchmarks/derivatives.py

Prints milliseconds of one linearisation over 60 s of 200 Hz logs for the dry motor and with each effect, and their
ratio; then a whole fit of windows both ways, from values 20 % off, and how far apart the two end.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np

from fiohost.estimation.fit import fit
from fiohost.estimation.predict import Flat, free_output
from fiohost.estimation.record import Record, make_record
from fiohost.estimation.settings import SETTINGS
from fiohost.estimation.solver import Point, Problem
from fiohost.estimation.starts import first_starts
from fiohost.motor.effect import effects
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start

TICK_S, SECONDS, COUNT_DEG, TURNS = 0.005, 60.0, 0.5, 3
DRY = {"linear.gain_deg_s_per_pct": 10.0, "linear.tau_s": 0.08, "coulomb_friction.level_pct": 3.0}
SHOWN = ("backlash", "cogging_torque", "constant_load", "fast_decay", "friction_warm_up", "presliding_friction",
         "quadratic_drag", "shaft_compliance", "stribeck_friction", "transport_delay")  # fmt: skip


def record_of(model: Model, rng: np.random.Generator) -> Record:
    """Random steps of half a second on a model, through an encoder."""
    n = round(SECONDS / TICK_S)
    duty = np.repeat(rng.uniform(-60.0, 60.0, n // 100), 100)
    record = make_record("steps", np.arange(n) * TICK_S, duty, np.zeros(n), quantum=COUNT_DEG)
    y = free_output(record, Flat.of(model), Start(0.2, 0.0))
    return make_record("steps", np.arange(n) * TICK_S, duty, np.floor(y / COUNT_DEG) * COUNT_DEG, quantum=COUNT_DEG)


def best_of(function: Callable[[], object]) -> float:
    """Seconds of the fastest of some turns; the first, which may compile, does not count."""
    function()
    spans = []
    for _ in range(TURNS):
        began = time.perf_counter()
        function()
        spans.append(time.perf_counter() - began)
    return min(spans)


def main() -> None:
    rng = np.random.default_rng(1)
    dry = Model.parse("linear+coulomb_friction").with_values(DRY)
    print(f"{'linearisation of windows':26} {'anew':>9} {'tangent':>9} {'ratio':>6}")
    ratios = []
    for name in (None, *SHOWN):
        model = dry if name is None else dry.with_effect(name, dict(effects()[name].trials[0]))
        records = [record_of(model, rng)]
        problem = Problem(model, records, True)
        point = Point(model.vector(), first_starts(problem.base, records))
        residuals = problem.residuals(point)
        anew, tangent = (best_of(partial(problem.linearise, point, residuals, exactly)) for exactly in (True, False))
        ratios.append(anew / tangent)
        print(f"{name or 'dry motor':26} {1e3 * anew:6.1f} ms {1e3 * tangent:6.1f} ms {ratios[-1]:6.1f}")
    print(f"{'geometric mean':26} {'':9} {'':9} {np.exp(np.mean(np.log(ratios))):6.1f}")

    records = [record_of(dry, rng)]
    off = dry.with_values({k: 1.2 * v for k, v in DRY.items()})
    ways = [partial(fit, off, records, windows=True, tolerance=t) for t in (2.0 * SETTINGS.along_tangent, 1e-6)]
    near, exact = (1e3 * best_of(way) for way in ways)
    print(f"fit along the tangent {near:.0f} ms, finished with exact derivatives {exact:.0f} ms;", end=" ")
    print("rms {:.5f} and {:.5f} deg".format(*(way().rms for way in ways)))


if __name__ == "__main__":
    main()
