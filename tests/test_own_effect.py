"""Effects, experiments and plants from outside: of a package that is installed, of a script, of a named folder."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from places import PACKAGES, ROOT

PAGE = (ROOT / "docs" / "own-effect.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", PAGE, re.DOTALL)

# A sensor's effect is in a kernel of its own that compiles in seconds.
SENSOR = """
from fiohost import Effect, Parameter
SCALE = {scale}
def stretched(theta_deg, factor):
    return theta_deg * factor
def measure(theta_deg, q):
    return stretched(theta_deg, 1.0 + SCALE * q[0])
EFFECT = Effect("{name}", "a scale that is off", "reading = theta * (1 + scale * share)", "measurement",
                (Parameter("share", "", 0.1, -1.0, 1.0),), "the sensor's maker", measure=measure)
"""
READ = """
import numpy as np
from fiohost.estimation.windows import read_output
from fiohost.motor.model import Model
from fiohost.motor.state import STATE_SIZE, THETA
model = Model(("stretch",), {"stretch.share": 0.5})
states, y = np.full((3, STATE_SIZE), 10.0), np.zeros(3)
read_output(np.arange(3.0), states, 0, THETA, model.vector(), model.switches(), y)
print(y[0], sum(read_output.stats.cache_hits.values()), sum(read_output.stats.cache_misses.values()))
"""


def install(folder: Path, name: str, modules: dict[str, str], points: str) -> None:
    """A package as an installer leaves it: modules and a folder of metadata beside them."""
    folder.mkdir(exist_ok=True)
    for module, text in modules.items():
        (folder / module).parent.mkdir(parents=True, exist_ok=True)
        (folder / module).write_text(text)
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(exist_ok=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(points)


def python(folder: Path, *words: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A fresh interpreter that finds what is installed in the folder."""
    known = {**os.environ, "PYTHONPATH": os.pathsep.join((str(folder), str(PACKAGES))), "COLUMNS": "200", **environment}
    return subprocess.run([sys.executable, *words], env=known, capture_output=True, text=True, cwd=folder)


def sensor(folder: Path, scale: float = 1.0, name: str = "stretch") -> None:
    text = SENSOR.format(scale=scale, name=name)
    install(folder, "stretch", {"stretch.py": text}, "[fiohost.effects]\nstretch = stretch:EFFECT\n")


# One that each check refuses.
BAD = """
import math
from fiohost import Effect, Parameter
def never_off(theta_deg, omega_deg_s, time_s, q):
    return -1.0 - q[0]
def pushes(theta_deg, omega_deg_s, time_s, q):
    return q[0] * math.tanh(omega_deg_s)
def stairs(duty_pct, period_s, q):
    return duty_pct * (1.0 + 0.1 * math.floor(q[0] * 50.0 + 0.5))
def hunts(theta_deg, omega_deg_s, time_s, q):
    return 20.0 * q[0] * math.sin(0.5 * time_s)
size = (Parameter("level_pct", "%", 1.0, 0.0, 5.0),)
wrong = (Parameter("level_pct", "%", 9.0, 0.0, 5.0),)
EFFECTS = [
    Effect(name, name, name, "torque", size, "a test", substep_s=0.0025, **{key: hook})
    for name, key, hook in (("never_off", "torque", never_off), ("pushes", "torque", pushes),
                            ("stairs", "command", stairs), ("hunts", "torque", hunts))
] + [Effect("beyond", "beyond", "beyond", "torque", wrong, "a test", torque=hunts)]
"""
WRONG_IN = {"never_off": "neutral", "pushes": "energy", "stairs": "derivative", "hunts": "steady", "beyond": "bounds"}


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The page's package, and one whose effects are wrong, in one kernel: it is compiled once."""
    folder = tmp_path_factory.mktemp("site")
    (point,) = re.findall(r'^sticky_grease = "(.*)"$', BLOCKS[1][1], re.MULTILINE)
    files = {"sticky_grease.py": BLOCKS[0][1], "test_sticky_grease.py": BLOCKS[2][1]}
    install(folder, "sticky_grease", files, f"[fiohost.effects]\nsticky_grease = {point}\n")
    install(folder, "bad_effects", {"bad_effects.py": BAD}, "[fiohost.effects]\nbad = bad_effects\n")
    return folder


@pytest.mark.long
def test_the_effect_of_the_page_is_listed_checked_and_passes_its_own_test(installed: Path) -> None:
    """The page's own text: its module, its entry points, its test, and what it shows of the terminal."""
    assert len([line for line in BLOCKS[0][1].splitlines() if line.strip()]) <= 25
    checked = python(installed, "-m", "fiohost", "effects", "check", "sticky_grease", "--json", "checks.json")
    assert checked.returncode == 0, checked.stderr
    shown = next(text for kind, text in BLOCKS if kind == "console")
    assert checked.stdout.strip() == shown.partition("\n")[2].strip()
    told = json.loads((installed / "checks.json").read_text())["effects"][0]
    assert [c["name"] for c in told["checks"]] == ["bounds", "neutral", "derivative", "steady", "energy"]
    listed = python(installed, "-m", "fiohost", "effects", "sticky_grease")
    assert "load = level * tanh(omega / knee)" in listed.stdout
    tested = python(installed, "-m", "pytest", "-q", "-p", "no:cacheprovider", "test_sticky_grease.py")
    assert tested.returncode == 0, tested.stdout


@pytest.mark.long
def test_a_kernel_with_an_effect_of_a_package_is_kept_until_the_effect_changes(tmp_path: Path) -> None:
    cache = {"XDG_CACHE_HOME": str(tmp_path / "cache")}
    said = []
    for scale in (1.0, 1.0, 2.0, 1.0):
        sensor(tmp_path, scale)
        run = python(tmp_path, "-c", READ, **cache)
        assert run.returncode == 0, run.stderr
        said.append(tuple(float(word) for word in run.stdout.split()))
    assert said == [(15.0, 0.0, 1.0), (15.0, 1.0, 0.0), (20.0, 0.0, 1.0), (15.0, 1.0, 0.0)]
    assert len(list((tmp_path / "cache" / "fiohost" / "kernels").iterdir())) == 2


@pytest.mark.parametrize(
    ("module", "said"),
    [
        ("import no_such_module", "cannot be loaded: ModuleNotFoundError: No module named 'no_such_module'"),
        ("EFFECT = 3", "neither an Effect, a tuple of them, nor a module with EFFECTS"),
        (SENSOR.format(scale=1.0, name="backlash"), "there is an effect 'backlash' already"),
        (SENSOR.format(scale=1.0, name="Not-a-name"), "a name is of small letters"),
        (
            SENSOR.format(scale=1.0, name="stretch").replace("measure(theta_deg, q)", "measure(q)"),
            "measure(q) must be measure(theta_deg, q)",
        ),
        (SENSOR.format(scale=1.0, name="stretch").replace(", measure=measure", ""), "it has no hook"),
    ],
    ids=("import", "no-effect", "taken", "name", "arguments", "no-hook"),
)
def test_a_package_that_is_wrong_is_refused_with_the_reason(tmp_path: Path, module: str, said: str) -> None:
    install(tmp_path, "stretch", {"stretch.py": module}, "[fiohost.effects]\nstretch = stretch:EFFECT\n")
    run = python(tmp_path, "-m", "fiohost", "effects", "stretch")
    assert run.returncode == 1
    assert said in run.stderr
    assert "Traceback" not in run.stderr


def test_a_script_registers_an_effect_before_the_kernel_is_there_and_not_after(tmp_path: Path) -> None:
    (tmp_path / "stretch.py").write_text(SENSOR.format(scale=1.0, name="stretch"))
    code = (
        "import fiohost, stretch\n"
        "assert fiohost.register_effect(stretch.EFFECT) is stretch.EFFECT\n"
        "try:\n    fiohost.register_effect(stretch.EFFECT)\n"
        "except fiohost.errors.ModelError as exc:\n    print(exc)\n"
        "print(fiohost.Model(('stretch',)).expression)\n"
        "import fiohost.motor.hooks\n"
        "try:\n    fiohost.register_effect(stretch.EFFECT)\n"
        "except fiohost.errors.ModelError as exc:\n    print(exc)\n"
    )
    run = python(tmp_path, "-c", code)
    assert run.returncode == 0, run.stderr
    twice, model, late = run.stdout.splitlines()
    assert "there is an effect 'stretch' already" in twice
    assert model == "linear+stretch"
    assert "comes too late: the kernel is compiled" in late


@pytest.mark.long
def test_each_check_finds_what_it_is_for(installed: Path) -> None:
    run = python(installed, "-m", "fiohost", "effects", "check", *WRONG_IN, "--json", "bad.json")
    assert run.returncode == 1
    assert "not every check is passed: never_off (neutral)" in run.stderr
    for told in json.loads((installed / "bad.json").read_text())["effects"]:
        failed = [check["name"] for check in told["checks"] if not check["passed"]]
        assert WRONG_IN[told["name"]] in failed, told


# ---- files ---------------------------------------------------------------------------------------------------------

EXPERIMENT = (ROOT / "configs" / "experiments" / "coast.toml").read_text(encoding="utf-8")
PLANT = (ROOT / "configs" / "plants" / "ideal.toml").read_text(encoding="utf-8")


def bench_folder(folder: Path, experiment: str = "slow_coast", plant: str = "our_motor") -> Path:
    for kind, name, text in (("experiments", experiment, EXPERIMENT), ("plants", plant, PLANT)):
        (folder / kind).mkdir(parents=True, exist_ok=True)
        (folder / kind / f"{name}.toml").write_text(text)
    return folder


NAMES = """
from fiohost.settings import config_names
from firmware_model import plant_names
print(config_names("experiments"), plant_names())
"""


def test_a_folder_of_ones_own_makes_its_names_known(tmp_path: Path) -> None:
    own = bench_folder(tmp_path / "bench")
    run = python(tmp_path, "-m", "fiohost", "run", "slow_coast", "--target", "sim:our_motor", "--log", "x.csv",
                 FIOHOST_CONFIGS=str(own))  # fmt: skip
    assert run.returncode == 0, run.stderr
    assert (tmp_path / "x.csv").is_file()


def test_so_does_a_package_that_declares_it(tmp_path: Path) -> None:
    install(tmp_path, "our_bench", {"our_bench/__init__.py": ""}, "[fiohost.configs]\nours = our_bench\n")
    bench_folder(tmp_path / "our_bench")
    run = python(tmp_path, "-c", NAMES)
    assert "slow_coast" in run.stdout, run.stderr
    assert "our_motor" in run.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("run", "coast", "--log", "x.csv"), "there are two experiments of the name 'coast'"),
        (("plants",), "there are two plants of the name 'ideal'"),
    ],
    ids=("experiment", "plant"),
)
def test_a_name_that_is_there_twice_is_refused(tmp_path: Path, words: tuple[str, ...], said: str) -> None:
    own = bench_folder(tmp_path / "bench", "coast", "ideal")
    run = python(tmp_path, "-m", "fiohost", *words, FIOHOST_CONFIGS=str(own))
    assert run.returncode == 1
    assert said in run.stderr


def test_a_folder_that_is_not_there_is_told(tmp_path: Path) -> None:
    run = python(tmp_path, "-m", "fiohost", "run", "coast", "--log", "x.csv", FIOHOST_CONFIGS=str(tmp_path / "none"))
    assert run.returncode == 1
    assert "which is no folder" in run.stderr
