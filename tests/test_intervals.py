"""Intervals of a fit's parameters where derivatives do not say all."""

from __future__ import annotations

import numpy as np

from fiohost.estimation.fit import Fit
from fiohost.estimation.intervals import estimates
from fiohost.motor.model import Model
from fiohost.motor.simulate import Start


def test_what_trades_with_a_searched_step_is_as_well_known_as_beside_it() -> None:
    """Gain, share and step of rounded commands trade exactly as long as no command is rounded otherwise: by derivatives
    alone the gain was anywhere, and commands that are rounded were not believed.
    """
    values = {"linear.gain_deg_s_per_pct": 6.6, "linear.tau_s": 0.09}
    model = Model((), values).with_effect("duty_steps", {"step_pct": 20.0, "share": 0.12, "rounding": "cut"})
    names = ("linear.gain_deg_s_per_pct", "linear.tau_s", "duty_steps.step_pct", "duty_steps.share")
    rng = np.random.default_rng(1)
    by_gain, by_lag, by_share = rng.standard_normal((3, 2000)) * [[160.0], [2600.0], [190.0]] / 45.0
    by_step = 0.04 * by_gain + 0.02 * by_share + 1e-5 * rng.standard_normal(2000)
    columns, left = np.column_stack((by_gain, by_lag, by_step, by_share)), rng.standard_normal(2000)
    none = np.empty((2000, 0))
    halves = [slice(0, 1000), slice(1000, 2000)]
    residuals, jacobians = ([a[h] for h in halves] for a in (left, columns))
    fitted = Fit(model, names, 2000.0, residuals, jacobians, (none[:1000],) * 2, (Start(0.0, 0.0),) * 2, True, 2000.0)
    for runs_differ in (False, True):
        found = estimates(fitted, runs_differ=runs_differ)
        assert found["linear.gain_deg_s_per_pct"].half_width < 0.5, runs_differ
        assert found["duty_steps.share"].half_width < 0.5, runs_differ
    assert found["duty_steps.step_pct"].half_width > 10.0
