"""A single log of a shaft that mostly rests: the right name, or the right name among those it cannot be told from."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_runs import closed_loop, logs_of, plant_file

from fiohost.bench.experiment import Experiment
from fiohost.circle.evidence import diagnose
from fiohost.discover.result import to_json

STALL_NM = 0.34 * 9.0 / 5.5  # of plant_file's motor
LIBRARY = ["static_friction", "stribeck_friction", "position_dependent_friction", "duty_curve", "quadratic_drag"]


def names(folder: Path, effects: dict[str, dict[str, float | str]]) -> tuple[str, list[tuple[str, ...]]]:
    """The verdict, and every step's name with those beside it."""
    logs = logs_of(f"sim:{plant_file(folder, effects=effects)}", folder, [closed_loop(24.0)], seed=4)
    found = diagnose(logs, (), "linear+coulomb_friction", library=LIBRARY)
    return found.verdict, [(s.effect, *s.indistinguishable_from) for s in found.steps]


@pytest.mark.long
@pytest.mark.parametrize(
    ("truth", "values"),
    [
        ("static_friction", {"extra_Nm": 0.03 * STALL_NM}),
        ("stribeck_friction", {"extra_Nm": 0.03 * STALL_NM, "stribeck_speed_rad_s": 1.0}),
        ("duty_curve", {"exponent": 0.9}),
    ],
)
def test_one_square_wave_names_what_is_there(tmp_path: Path, truth: str, values: dict[str, float | str]) -> None:
    verdict, told = names(tmp_path, {truth: values})
    assert verdict == "explained"
    assert len(told) == 1
    assert truth in told[0]


def test_one_square_wave_of_a_bench_that_lacks_nothing_names_nothing(tmp_path: Path) -> None:
    assert names(tmp_path, {}) == ("no_missing_effect", [])


@pytest.mark.long
@pytest.mark.parametrize(
    ("experiment", "truth", "values", "others"),
    [
        ("pulses", "supply_drift", {"drift_per_s": 8e-4}, ["parameter_change", "clock_ripple", "gain_warm_up"]),
        ("multisine", "supply_sag", {"source_ohm": 0.6}, ["duty_curve", "load_dependent_friction"]),
        ("random_steps", "friction_warm_up", {"ratio": 0.4, "time_constant_s": 40.0}, ["parameter_change"]),
    ],
)  # fmt: skip
def test_what_a_log_hardly_shows_is_named_where_it_leaves_nothing(
    tmp_path: Path, experiment: str, truth: str, values: dict[str, float | str], others: list[str]
) -> None:
    """Of one log rules say that it cannot show this effect; followed to the count, no other is to take its place."""
    plant = plant_file(tmp_path, effects={truth: values})
    logs = logs_of(f"sim:{plant}", tmp_path, [Experiment.load(experiment)], seed=4)
    said: list[str] = []
    found = diagnose(logs, (), "linear+coulomb_friction", library=[truth, *others], say=said.append)
    told = to_json(found)
    assert truth in {name for limit in told["data"]["cannot_show"] for name in limit["effects"]}
    assert [s.effect for s in found.steps] == [truth], said
    assert found.verdict == "explained"
    assert not any("noise" in text for text in said), said
