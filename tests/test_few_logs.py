"""A single log of a shaft that mostly rests: the right name, or the right name among those it cannot be told from."""

from __future__ import annotations

from pathlib import Path

import pytest
from short_runs import closed_loop, logs_of, plant_file

from fiohost.circle.evidence import diagnose

STALL_NM = 0.34 * 9.0 / 5.5  # of plant_file's motor
LIBRARY = ["static_friction", "stribeck_friction", "position_dependent_friction", "duty_curve", "quadratic_drag"]


def names(folder: Path, effects: dict[str, dict[str, float | str]]) -> tuple[str, list[tuple[str, ...]]]:
    """The verdict, and every step's name with those beside it."""
    logs = logs_of(f"sim:{plant_file(folder, effects=effects)}", folder, [closed_loop(24.0)], seed=4)
    found = diagnose(logs, (), "linear+coulomb_friction", library=LIBRARY)
    return found.verdict, [(s.effect, *s.indistinguishable_from) for s in found.steps]


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
