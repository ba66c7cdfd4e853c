"""Diagnoses of benches that are not exact: right names, and verdicts that say to what the data are explained."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from short_runs import logs_of, multisine, plant_file, random_steps, staircase

from fiohost.bench.log import Log
from fiohost.circle.evidence import diagnose
from fiohost.discover.degenerate import believed, degenerate, may_vanish
from fiohost.discover.diagnose import Diagnosis
from fiohost.discover.logs.weighed_windows import WeighedWindows
from fiohost.discover.result import to_json
from fiohost.discover.step import Found, Step
from fiohost.judging.metrics import Judgement
from fiohost.judging.stage import Stage
from fiohost.noise.estimate import NONE
from fiohost.report.words import verdict_sentence

STALL_NM = 0.34 * 9.0 / 5.5  # of plant_file's motor
LIBRARY = ("constant_load", "cogging_torque", "quadratic_drag", "stribeck_friction", "transport_delay", "backlash")
RUNS = (staircase(1.0), multisine(8.0), random_steps(8.0))


def noisy(log: Log, counts: float, rng: np.random.Generator) -> Log:
    """A log of a sensor that is noisy by so many counts rms."""
    columns = {k: v for k, v in log.columns.items() if k not in ("direction", "angle_deg")}
    columns["pos"] = np.mod(np.floor(log.columns["pos"] + 0.5 + counts * rng.standard_normal(len(log))), 720)
    return Log.from_columns(columns, log.metadata, log.path)


def made(folder: Path, effects: dict[str, dict[str, float | str]], counts: float = 1.0) -> list[Log]:
    rng = np.random.default_rng(11)
    return [noisy(log, counts, rng) for log in logs_of(f"sim:{plant_file(folder, effects=effects)}", folder, RUNS)]


def run(logs: Sequence[Log], model: str = "linear+coulomb_friction") -> Diagnosis:
    return diagnose(logs, (), model, library=LIBRARY)


def test_a_noisy_bench_that_lacks_nothing_is_explained_to_within_its_noise(tmp_path: Path) -> None:
    told = to_json(run(made(tmp_path, {})))
    assert (told["verdict"], told["explained_to"], told["steps"]) == ("no_missing_effect", "noise", [])
    assert told["residual"]["white"] is True
    assert told["floor"]["from"] == "noise"
    sensor = told["noise"]["sensor_rms"]
    assert sensor["ci95"][0] <= 0.5 * np.sqrt(1.0 + 1.0 / 12.0) <= sensor["ci95"][1]
    assert told["floor"]["train"]["window_rms"] == pytest.approx(told["after"]["train"]["window_rms"], rel=0.05)
    assert "to within the noise" in verdict_sentence(told)
    assert "sensor noise of 0.5" in verdict_sentence(told)
    assert told["settings"]["search"]["draws"] > 0
    assert told["settings"]["fit"]["start"]["zero_looks"] > 0


@pytest.mark.long
def test_beside_more_noise_than_any_bench_has_what_windows_show_plainly_is_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where weights say nothing, what takes most of what windows as they are leave is help: structure remains."""
    monkeypatch.setattr(WeighedWindows, "most_torque_pct", 0.0)
    monkeypatch.setattr(WeighedWindows, "margin", 1e9)
    told = to_json(run(made(tmp_path, {"constant_load": {"torque_Nm": 0.06 * STALL_NM}})))
    assert (told["verdict"], [s["effect"] for s in told["steps"]]) == ("unexplained", ["constant_load"])
    assert told["after"]["train"]["window_rms"] < 0.7 * told["before"]["train"]["window_rms"]
    assert told["floor"]["from"] != "noise"


@pytest.mark.long
def test_on_a_noisy_bench_the_effect_that_is_there_is_named(tmp_path: Path) -> None:
    told = to_json(run(made(tmp_path, {"constant_load": {"torque_Nm": 0.02 * STALL_NM}})))
    assert [s["effect"] for s in told["steps"]] == ["constant_load"]
    assert (told["verdict"], told["explained_to"]) == ("explained", "noise")
    assert told["explained_pct"] > 95.0
    level = told["final"]["parameters"]["constant_load.level_pct"]
    assert level["ci95"][0] <= 2.0 <= level["ci95"][1]


def test_rows_that_are_missing_are_no_effect(tmp_path: Path) -> None:
    rng, cut = np.random.default_rng(12), []
    for log in logs_of(f"sim:{plant_file(tmp_path)}", tmp_path, RUNS):
        keep = rng.random(len(log)) > 0.03
        cut.append(Log.from_columns({k: v[keep] for k, v in log.columns.items()}, log.metadata, log.path))
    told = to_json(run(cut))
    assert (told["verdict"], told["explained_to"], told["steps"]) == ("no_missing_effect", "sensor", [])


def test_an_exact_bench_is_explained_to_the_sensor_and_its_residual_is_white(tmp_path: Path) -> None:
    told = to_json(run(logs_of(f"sim:{plant_file(tmp_path)}", tmp_path, RUNS)))
    assert (told["verdict"], told["explained_to"]) == ("no_missing_effect", "sensor")
    assert told["residual"]["white"] is True
    assert told["floor"]["from"] == "replicas"
    assert told["noise"]["sensor_rms"]["value"] < 0.1


@pytest.fixture(scope="module")
def stages(tmp_path_factory: pytest.TempPathFactory) -> tuple[Stage, Stage]:
    """The stages before and after an effect that is there was named."""
    folder = tmp_path_factory.mktemp("logs")
    plant = plant_file(folder, effects={"constant_load": {"torque_Nm": 0.02 * STALL_NM}})
    found = diagnose(logs_of(f"sim:{plant}", folder, RUNS), (), "linear+coulomb_friction", library=LIBRARY)
    assert [s.effect for s in found.steps] == ["constant_load"]
    return found.declared, found.final


def test_a_fit_that_is_sound_is_believed(stages: tuple[Stage, Stage]) -> None:
    assert degenerate(*stages) is None


def test_a_core_parameter_at_its_bound_is_not_believed(stages: tuple[Stage, Stage]) -> None:
    before, after = stages
    bound = after.fit.model.parameter("linear.tau_s").upper
    fitted = replace(after.fit, model=after.fit.model.with_values({"linear.tau_s": bound}))
    assert "goes to its bound" in str(degenerate(before, replace(after, fit=fitted)))


def test_an_interval_wider_than_its_value_is_not_believed(stages: tuple[Stage, Stage]) -> None:
    before, after = stages
    gains = np.geomspace(1e-3, 140.0, len(after.scattered_models))
    models = [
        m.with_values({"linear.gain_deg_s_per_pct": float(g)})
        for m, g in zip(after.scattered_models, gains, strict=True)
    ]
    assert "anywhere in" in str(degenerate(before, replace(after, scatter=lambda: models)))


@pytest.mark.parametrize(
    ("sizes", "vanishes"),
    [((1.8, 2.0, 2.2, 30.0), False), ((1.8, 2.0, 2.2, 0.0), True), ((1.8, 2.0, 2.2, -1.0), True)],
)
def test_an_effect_may_vanish_where_bootstrap_samples_come_to_nil(
    stages: tuple[Stage, Stage], sizes: tuple[float, ...], vanishes: bool
) -> None:
    """A sample in which a shaft sticks may be far off, and says nothing of that."""
    _, after = stages
    key = "constant_load.level_pct"
    sign = np.sign(after.fit.model.number(key))
    models = [after.fit.model.with_values({key: float(sign * size)}) for size in sizes]
    assert bool(may_vanish(replace(after, scatter=lambda: models), "constant_load")) == vanishes


def test_a_floor_above_the_error_is_not_believed(stages: tuple[Stage, Stage]) -> None:
    before, after = stages

    def worse(draw: Judgement) -> Judgement:
        return replace(draw, errors=replace(draw.errors, window_rms=10.0 * draw.errors.window_rms, free_run_rms=10.0))

    all_worse = tuple(replace(f, draws=tuple(map(worse, f.draws))) for f in after.floors)
    assert "the model's own data err" in str(degenerate(before, replace(after, floors=all_worse)))
    but_one = tuple(replace(f, draws=(*map(worse, f.draws[1:]), f.draws[0])) for f in after.floors)
    assert degenerate(before, replace(after, floors=but_one)) is None  # the shaft stuck in all others


def test_an_error_that_is_no_lower_is_not_believed(stages: tuple[Stage, Stage]) -> None:
    _, after = stages
    assert "no lower" in str(degenerate(after, after))


def test_what_the_logs_cannot_show_is_not_named_where_it_leaves_something(tmp_path: Path) -> None:
    plant = plant_file(tmp_path, effects={"constant_load": {"torque_Nm": 0.02 * STALL_NM}})
    found = diagnose(logs_of(f"sim:{plant}", tmp_path, RUNS), (), "linear+coulomb_friction", library=("constant_load",))
    final, hidden = found.final, {"constant_load": "one direction only"}
    sound = Found((found.declared, final), found.steps, ())
    assert believed(sound, hidden).steps == found.steps  # it leaves nothing
    left = tuple(replace(e, value=2.0 * e.allowed) for e in final.excesses)
    doubted = believed(replace(sound, stages=(found.declared, replace(final, excesses=left))), hidden)
    assert doubted.steps == ()
    assert "cannot show" in str(doubted.offered[0].rejected_because)


def test_only_what_makes_a_fit_degenerate_is_taken_back(stages: tuple[Stage, Stage]) -> None:
    """The sound step before it stays."""
    before, after = stages
    bound = after.fit.model.parameter("linear.tau_s").upper
    spoiled = replace(after, fit=replace(after.fit, model=after.fit.model.with_values({"linear.tau_s": bound})))
    steps = tuple(Step(name, stage, {"residual_power_removed": 0.5}, ()) for name, stage in
                  (("constant_load", after), ("duty_steps", spoiled)))  # fmt: skip
    kept = believed(Found((before, spoiled), steps, ()), {})
    assert [s.effect for s in kept.steps] == ["constant_load"]
    assert kept.final is after
    assert [c.effect for c in kept.offered] == ["duty_steps"]
    assert "goes to its bound" in str(kept.offered[0].rejected_because)


@pytest.mark.parametrize(("white", "named"), [(True, 2), (False, 1)])
def test_a_small_part_of_what_is_no_noise_is_not_named(stages: tuple[Stage, Stage], white: bool, named: int) -> None:
    before, after = stages
    little = replace(after, judgements=tuple(
        replace(j, errors=replace(j.errors, window_rms=0.95 * j.errors.window_rms)) for j in after.judgements
    ))  # fmt: skip
    steps = tuple(Step(name, stage, {"residual_power_removed": 0.1}, ()) for name, stage in
                  (("constant_load", after), ("duty_steps", little)))  # fmt: skip
    found = believed(Found((before, little), steps, (), noise=NONE, white=white), {})
    assert len(found.steps) == named
    assert white or "removes 10 % of what was left" in str(found.offered[0].rejected_because)
