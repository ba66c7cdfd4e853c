"""What the noise that is there already says of candidates: that none needs to be settled on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bench_data import suite, truth_model

from fiohost.discover.evidence import State
from fiohost.discover.logs.refit import LogsBeside
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.estimation.fit import Fit, fit
from fiohost.motor.effect import effect

OFFERED = ("quadratic_drag", "armature_inductance", "input_deadband", "voltage_saturation", "constant_load")


@pytest.mark.long
@pytest.mark.parametrize("missing", [False, True])
def test_beside_white_noise_that_no_candidate_gains_on_it_is_not_settled_on_them(
    missing: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Noise and model settled on each other for each of eight fits, half of the time beside what lacked nothing."""
    rng = np.random.default_rng(3)
    lags = {"armature_inductance.time_constant_s": 0.006}
    names = ("coulomb_friction", "armature_inductance") if missing else ("coulomb_friction",)
    truth = truth_model(names, lags if missing else None)
    shaky = [replace(r, y=r.y + r.quantum * np.round(2.0 * rng.standard_normal(len(r)))) for r in suite(truth, 3)]
    windows = WeighedWindows(shaky)
    state = windows.settled(fit(truth.without(["armature_inductance"]), windows.records, windows=True))
    settled: list[str] = []

    def recorded(self: WeighedWindows, fitted: Fit, whitened: bool = False) -> State:
        settled.append(fitted.model.effects[-1])
        return of_class(self, fitted, whitened)

    of_class = WeighedWindows.settled
    monkeypatch.setattr(WeighedWindows, "settled", recorded)
    found = LogsBeside(windows, state).refitted([effect(n) for n in OFFERED], lambda text: None)
    others = {of.name: s for of, s in found if of.name != "constant_load"}
    assert others
    assert all((s.noise is state.noise) is not missing for s in others.values())
    assert (set(settled) <= {"constant_load"}) is not missing
    if missing:
        assert min(found, key=lambda f: f[1].deviance)[0].name == "armature_inductance"
