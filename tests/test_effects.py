"""The library as it is listed, and how small an effect shows: the shipped limits are of this program and are true."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from short_runs import logs_of, random_steps, staircase

from fiohost.advice.limit import Limit, shipped
from fiohost.bench.connect import connect
from fiohost.bench.log import Log
from fiohost.circle import detection
from fiohost.circle.plan import SUITE, suite
from fiohost.cli.main import cli
from fiohost.discover.logs.whole_runs import WholeRuns
from fiohost.errors import FiohostError
from fiohost.estimation.fit import fit
from fiohost.estimation.record import Record, record_from_log
from fiohost.judging.metrics import judge
from fiohost.judging.stage import Stage
from fiohost.motor.effect import Value, effect, effects
from fiohost.motor.model import Model
from fiohost.settings import find_config
from firmware_model.plants import load_plant

MEASURED = shipped()


def test_the_shipped_limits_are_of_every_effect_in_the_shipped_suite() -> None:
    assert {x.effect for x in MEASURED.limits} == set(effects())
    assert MEASURED.experiments == SUITE
    assert MEASURED.seconds == pytest.approx(sum(e.duration_s for e in suite()), abs=0.1)
    assert set(Model.parse(MEASURED.model).effects) == set(load_plant(MEASURED.plant).reduced()) - {"linear"}
    without = {x.effect for x in MEASURED.limits if x.value is None}
    assert without == {
        "linear", "missed_counts", "asymmetric_coulomb_friction", "fast_decay", "hard_stop", "coast_pwm",
        "clock_ripple", "load_over_position", "friction_over_position", "shaft_angle_error", "speed_filter",
        "unsigned_speed",
    }  # fmt: skip


@pytest.mark.parametrize("limit", [x for x in MEASURED.limits if x.value is not None], ids=lambda x: x.effect)
def test_a_limit_is_a_size_that_the_effect_can_have(limit: Limit) -> None:
    item = effect(limit.effect)
    assert item.parameter(limit.parameter).check(limit.value, limit.effect) != limit.neutral
    assert set(limit.at) == {p.name for p in item.parameters} - {limit.parameter}
    assert limit.log.split(".")[0].rstrip("_123") in SUITE


@pytest.mark.parametrize(
    ("good", "bad", "said"),
    [("effect = ", "efect = ", "'effect'"), ("backlash", "baklash", "'backlash'"), ("side", "sidde", "'side'")],
)
def test_a_file_of_limits_with_an_unknown_name_is_refused(tmp_path: Path, good: str, bad: str, said: str) -> None:
    path = tmp_path / "limits.toml"
    path.write_text(find_config("limits", "default_suite").read_text().replace(good, bad))
    with pytest.raises(FiohostError, match=said):
        shipped(path)


# ---- true on the board ---------------------------------------------------------------------------------------------

# By effect: the keys of a plant file, of a size and the effect's other parameters; torques by the stall torque.
ON_THE_BOARD = {
    "constant_load": lambda v, at, nm: {"torque_Nm": v * nm},
    "transport_delay": lambda v, at, nm: {"delay_s": v},
    "encoder_eccentricity": lambda v, at, nm: {"level_deg": v, **at},
}


def run(folder: Path, name: str = "", values: Mapping[str, Value] | None = None) -> list[Record]:
    """Records of the suite on the plant of the shipped limits, with one effect more."""
    text = (Path(__file__).resolve().parent.parent / "configs" / "plants" / f"{MEASURED.plant}.toml").read_text()
    if values is not None:
        text += f"\n[effects.{name}]\n" + "\n".join(f"{k} = {v!r}" for k, v in values.items()) + "\n"
    plant = folder / "plant.toml"
    plant.write_text(text)
    with connect(f"sim:{plant}", seed=11) as bench:
        return [record_from_log(bench.run(e), f"{i} {e.name}") for i, e in enumerate(suite())]


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Stage:
    """The plant as it is: its model's figures and the bounds that counts alone would leave."""
    runs = WholeRuns(run(tmp_path_factory.mktemp("clean")), np.random.default_rng(1))
    stage = runs.stage(runs.finished(runs.declared(Model.parse(MEASURED.model), from_file=False)))
    assert stage.at_floor
    return stage


def over_bound(records: Sequence[Record], clean: Stage) -> float:
    """The largest figure over what counts alone would leave of it, once the model without the effect is fitted."""
    fitted = fit(clean.fit.model, records).model
    ratios = []
    for record in records:
        judgement = judge(record, fitted)
        for bound in (x for x in clean.excesses if x.record == record.name):
            owner = judgement if bound.figure == "wide_windows_pct" else judgement.errors
            ratios.append(getattr(owner, bound.figure) / bound.limit)
    return max(ratios)


@pytest.mark.long
@pytest.mark.parametrize("name", ON_THE_BOARD)
def test_twice_its_limit_an_effect_shows_and_a_fifth_of_it_does_not(name: str, tmp_path: Path, clean: Stage) -> None:
    limit = MEASURED.of(name)[0]
    assert limit.value is not None
    stall_nm_per_pct = 1.0 / load_plant(MEASURED.plant).percent_of_torque(1.0)
    small, large = (ON_THE_BOARD[name](factor * limit.value, limit.at, stall_nm_per_pct) for factor in (0.2, 2.0))
    # Bounds come from few replicas, so that a figure may stand a fifth above its own by chance: some samples that a
    # creeping shaft leaves outside their counts.
    assert over_bound(run(tmp_path, name, small), clean) < 1.2
    assert over_bound(run(tmp_path, name, large), clean) > 1.5


# ---- the listing ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> list[Log]:
    return logs_of("sim:ideal", tmp_path_factory.mktemp("logs"), [staircase(), random_steps(seed=5)], seed=1)


def test_the_listing_has_equation_signature_equivalents_and_limit_of_every_effect() -> None:
    told = CliRunner().invoke(cli, ["effects"])
    assert told.exit_code == 0
    blocks = {block.partition(":")[0]: block for block in told.stdout.split("\n\n")}
    for name, item in effects().items():
        for text in (item.equation, item.signature, *item.equivalents, item.source, "smallest seen (default suite)"):
            assert text in blocks[name], f"{name} lacks {text!r}"
    assert "gap_deg 0.0" in blocks["backlash"]


def test_brief_is_a_table_and_names_are_explained_alone() -> None:
    brief = CliRunner().invoke(cli, ["effects", "--brief"], env={"COLUMNS": "200"}).stdout
    assert "smallest seen (default suite)" in brief.splitlines()[0]
    assert all(any(line.startswith(name) for line in brief.splitlines()) for name in effects())
    two = CliRunner().invoke(cli, ["effects", "backlash", "gravity_load"]).stdout
    assert "backlash:" in two
    assert "gravity_load:" in two
    assert "hard_stop:" not in two


def test_limits_of_given_logs_stand_beside_those_of_the_suite(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, logs: list[Log]
) -> None:
    few = partial(detection.smallest_visible, library=["constant_load", "missed_counts", "coulomb_friction"])
    monkeypatch.setattr(detection, "smallest_visible", few)
    out = tmp_path / "limits.json"
    arguments = ["effects", "--limits", *(str(log.path) for log in logs), "--model", "linear+coulomb_friction"]
    told = CliRunner().invoke(cli, [*arguments, "--json", str(out)], env={"COLUMNS": "200"})
    assert told.exit_code == 0, told.output
    assert "smallest seen (these logs)" in told.stdout
    result = json.loads(out.read_text())
    assert result["given_logs"]["seconds"] == pytest.approx(20.0, abs=0.1)
    assert result["default_suite"]["experiments"] == list(SUITE)
    found = {e["name"]: e["detection_limits"] for e in result["effects"]}
    (own,), (default,) = found["constant_load"]["given_logs"], found["constant_load"]["default_suite"]
    assert own["smallest_visible"] > default["smallest_visible"] > 0.0, "20 s show less than 218 s"
    assert "linear" in found["missed_counts"]["given_logs"][0]["reason"]
    assert "part of the model" in found["coulomb_friction"]["given_logs"][0]["reason"]
    assert found["backlash"]["given_logs"] == []


def test_a_model_that_leaves_something_has_no_limits_to_tell(logs: list[Log]) -> None:
    told = CliRunner().invoke(cli, ["effects", "--limits", str(logs[0].path)])
    assert told.exit_code == 1
    assert "linear leaves something unexplained" in told.stderr


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--limits"], "needs logs"),
        (["backlash", "--model", "linear"], "go with --limits"),
        (["baklash"], "'backlash'"),
    ],
)
def test_what_makes_no_sense_is_refused(arguments: list[str], said: str) -> None:
    told = CliRunner().invoke(cli, ["effects", *arguments])
    assert told.exit_code == (1 if arguments == ["baklash"] else 2)
    assert said in told.stderr
