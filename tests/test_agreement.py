"""Two simulations that share no code, the board's and the fit's, agree on a motor that both describe.

The board integrates amperes and newton metres adaptively and locates events; the kernel takes exact steps in percent
and degrees. A log of the first, replayed by the second from physical constants, must lie within the encoder's counts.
"""

from __future__ import annotations

import ast
import math
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from places import PACKAGES, ROOT
from short_runs import closed_loop, logs_of, multisine, plant_file, pulses, staircase

import fiohost
import firmware_model
from fiohost.bench.experiment import Experiment
from fiohost.bench.log import Log
from fiohost.bench.signals import Staircase
from fiohost.estimation.record import record_from_log
from fiohost.motor.model import Model
from fiohost.motor.simulate import free_run

IDEAL = ROOT / "configs" / "plants" / "ideal.toml"
INTEGRATION_DEG = 1e-3  # what the board's adaptive steps may add up to
# Warmth follows the motor by steps of the kernel: over a run of thousands of degrees that much may add up.
SLOW_STATES, SLOW_STATES_DEG = ("armature_heating", "friction_warm_up"), 0.1


def physical_model(plant: Path) -> Model:
    """K, tau and the level of dry friction from a plant file's SI constants, by the textbook's formulas."""
    q: dict[str, Any] = {"B_Nms": 0.0, "coulomb_Nm": 0.0, **tomllib.loads(plant.read_text())}
    damping = q["Kt_Nm_per_A"] * q["Ke_Vs_per_rad"] + q["R_ohm"] * q["B_Nms"]
    stall_Nm = q["Kt_Nm_per_A"] * q["supply_V"] / q["R_ohm"]
    values = {
        "linear.gain_deg_s_per_pct": math.degrees(0.01 * q["supply_V"] * q["Kt_Nm_per_A"] / damping),
        "linear.tau_s": q["J_kgm2"] * q["R_ohm"] / damping,
        "coulomb_friction.level_pct": 100.0 * q["coulomb_Nm"] / stall_Nm,
    }
    return Model(("coulomb_friction",), values)


def room_for_the_angle(log: Log, model: Model) -> tuple[float, float]:
    """Initial angles (least, most) for which every sample of the log lies in the bin of its count; least > most: none.

    The angle of a motor without loads that follow it is its free run from zero, shifted.
    """
    y = free_run(model, record_from_log(log).excitation, 0.0)
    return float(np.max(log.output - y)), float(np.min(log.output + log.output_quantum - y))


def assert_agrees(log: Log, model: Model) -> None:
    least, most = room_for_the_angle(log, model)
    assert least <= most + INTEGRATION_DEG, f"{log.path.name}: off by {least - most:.4f} deg beyond the counts"
    assert np.ptp(log.output) > 20.0, "a shaft that does not turn proves nothing"


# ---- agreement -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [None, 4])
def test_on_the_ideal_plant_every_sample_lies_within_its_count(tmp_path: Path, seed: int | None) -> None:
    model = physical_model(IDEAL)
    for log in logs_of(
        "sim:ideal", tmp_path, [staircase(2.0), multisine(30.0), closed_loop(30.0), pulses()], seed=seed
    ):
        assert log.command_delay_ticks == 1
        assert log.output_quantum == 0.5
        assert_agrees(log, model)


def test_the_agreement_is_sharp_enough_to_show_a_wrong_constant(tmp_path: Path) -> None:
    model = physical_model(IDEAL)
    (log,) = logs_of("sim:ideal", tmp_path, [multisine(30.0)])
    for key, factor in (
        ("linear.gain_deg_s_per_pct", 1.002),
        ("linear.tau_s", 1.01),
        ("coulomb_friction.level_pct", 1.02),
    ):
        least, most = room_for_the_angle(log, model.with_values({key: model.number(key) * factor}))
        assert least > most, key


@pytest.mark.parametrize(
    "changes",
    [
        {"coulomb_Nm": 0.0},
        {"coulomb_Nm": 0.09},
        {"B_Nms": 0.004, "supply_V": 12.0},
        {"J_kgm2": 3.0e-4},
        {"J_kgm2": 2.0e-2, "R_ohm": 2.0},
        {"counts_per_rev": 4000},
    ],
    ids=lambda changes: ",".join(f"{k}={v}" for k, v in changes.items()),
)
def test_on_other_motors_too(tmp_path: Path, changes: dict[str, float]) -> None:
    plant = plant_file(tmp_path, changes)
    model = physical_model(plant)
    experiments = [staircase(), multisine(10.0, 7), closed_loop()]
    if "B_Nms" not in changes:  # in standby viscous damping is alone: K and tau hold it together with the back-emf
        experiments.append(pulses())
    for experiment in experiments:  # each from power-on: without dry friction a shaft that has run creeps on
        (log,) = logs_of(f"sim:{plant}", tmp_path, [experiment], seed=2)
        assert log.output_quantum == pytest.approx(360.0 / changes.get("counts_per_rev", 720))
        assert_agrees(log, model)


@pytest.mark.parametrize(
    ("effect", "physical"),
    [
        ("input_deadband", {"level_pct": 6.0}),
        ("voltage_saturation", {"limit_pct": 55.0}),
        ("transport_delay", {"delay_s": 0.0123}),
        ("constant_load", {"torque_Nm": 0.012}),
        ("gravity_load", {"torque_Nm": 0.03, "phase_rad": 0.5}),
        ("backlash", {"gap_rad": 0.05, "side": "encoder_after_gap", "load_inertia_kgm2": 0.0}),
        ("backlash", {"gap_rad": 0.1, "side": "encoder_before_gap", "load_inertia_kgm2": 1.2e-3}),
        # Loaded hard for its size: what the hot winding loses, not the cold one, is what warms it.
        ("armature_heating", {"alpha_per_K": 0.0039, "thermal_K_per_W": 40.0, "time_constant_s": 4.0}),
        ("friction_warm_up", {"ratio": 0.5, "time_constant_s": 4.0}),
    ],
    ids=lambda value: value if isinstance(value, str) else value.get("side", ""),
)
def test_each_effect_means_the_same_on_both_sides(tmp_path: Path, effect: str, physical: dict[str, Any]) -> None:
    plant = plant_file(tmp_path, effects={effect: physical})
    model = physical_model(plant).with_effect(effect, reduced(physical, plant))
    for experiment in (staircase(), multisine(10.0, 7), closed_loop(), pulses()):
        # Without a seed the board starts in the middle of its count and of its play.
        (log,) = logs_of(f"sim:{plant}", tmp_path, [experiment])
        y = free_run(model, record_from_log(log).excitation, 0.25)
        beyond_deg = np.maximum(log.output - y, y - log.output - log.output_quantum)
        assert beyond_deg.max() <= (SLOW_STATES_DEG if effect in SLOW_STATES else 2.0 * INTEGRATION_DEG), (
            experiment.name
        )
        assert np.ptp(log.output) > 20.0


def test_under_fast_decay_what_flows_of_more_falls_before_it_ceases_in_each_pulse(tmp_path: Path) -> None:
    """The duty of these runs crosses over and over from where the current never ceases to where it does."""
    changes = {"L_H": 0.011, "R_ohm": 5.5}
    plant = plant_file(tmp_path, changes, effects={"fast_decay": {}})
    model = physical_model(plant).with_effect("fast_decay", {"electrical_tau_s": changes["L_H"] / changes["R_ohm"]})
    for experiment in (multisine(10.0, 7), closed_loop()):
        (log,) = logs_of(f"sim:{plant}", tmp_path, [experiment])
        y = free_run(model, record_from_log(log).excitation, 0.25)
        beyond_deg = np.maximum(log.output - y, y - log.output - log.output_quantum)
        assert beyond_deg.max() <= 0.02, experiment.name
        assert np.ptp(log.output) > 20.0


def test_a_current_that_ceases_in_each_period_is_more_than_mean_voltages_promise(tmp_path: Path) -> None:
    """A shaft that coasts down is driven again where mean voltage and back-emf nearly balance: 22 deg off otherwise."""
    changes = {"L_H": 0.003, "R_ohm": 5.5, "coulomb_Nm": 0.008}
    plant = plant_file(tmp_path, changes, effects={"fast_decay": {}})
    model = physical_model(plant).with_effect("fast_decay", {"electrical_tau_s": changes["L_H"] / changes["R_ohm"]})
    levels = (*[62.0] * 8, *[3.0] * 3, *[60.0] * 4, *[3.0] * 3, *[60.0] * 4, *[3.0] * 3, *[60.0] * 8)
    again = Staircase(duration_s=0.1 * len(levels), levels=levels, step_s=0.1)
    (log,) = logs_of(f"sim:{plant}", tmp_path, [Experiment("driven_again", (again,))])
    y = free_run(model, record_from_log(log).excitation, 0.25)
    beyond_deg = np.maximum(log.output - y, y - log.output - log.output_quantum)
    assert beyond_deg.max() <= 0.2
    assert np.ptp(log.output) > 500.0


def reduced(physical: dict[str, Any], plant: Path) -> dict[str, float | str]:
    """Percent of duty, degrees and seconds from SI."""
    q = tomllib.loads(plant.read_text())
    stall_Nm = q["Kt_Nm_per_A"] * q["supply_V"] / q["R_ohm"]
    convert: dict[str, tuple[str, float]] = {
        "torque_Nm": ("level_pct", 100.0 / stall_Nm),
        "phase_rad": ("phase_deg", math.degrees(1.0)),
        "gap_rad": ("gap_deg", math.degrees(1.0)),
        "load_inertia_kgm2": ("load_inertia_ratio", 1.0 / q["J_kgm2"]),
    }
    found: dict[str, float | str] = {}
    for key, value in physical.items():
        name, factor = convert.get(key, (key, 1.0))
        found[name] = value if isinstance(value, str) else value * factor
    if "thermal_K_per_W" in physical:
        rise_K = found.pop("thermal_K_per_W") * q["supply_V"] ** 2 / q["R_ohm"]
        found["rise_ratio"] = found.pop("alpha_per_K") * rise_K
    return found


# ---- separate code -------------------------------------------------------------------------------------------------

FIT_ROOMS = ("motor", "estimation", "discover", "circle")


def modules(package: Path) -> Iterator[tuple[str, ast.Module]]:
    for path in sorted(package.rglob("*.py")):
        yield str(path.relative_to(package.parent)), ast.parse(path.read_text(encoding="utf-8"))


def imported(tree: ast.Module) -> set[str]:
    """Every module that a source names in an import, ``import_module("...")`` and ``__import__("...")`` included."""
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            found.add("." * node.level + (node.module or ""))
        elif isinstance(node, ast.Call) and ast.unparse(node.func).split(".")[-1] in ("import_module", "__import__"):
            found.update(a.value for a in node.args if isinstance(a, ast.Constant) and isinstance(a.value, str))
    return found


def test_the_board_imports_nothing_of_the_host() -> None:
    sources = dict(modules(Path(firmware_model.__file__).parent))
    assert len(sources) > 15
    for name, tree in sources.items():
        for module in imported(tree):
            assert module.split(".")[0] != "fiohost", f"{name} imports {module}"


def test_the_fit_imports_nothing_of_the_board_and_the_board_is_met_in_the_transport_only() -> None:
    package = Path(fiohost.__file__).parent
    for name, tree in modules(package):
        room = Path(name).parts[1]
        for module in imported(tree):
            if module.split(".")[0] == "firmware_model":
                assert room == "transport", f"{name} imports {module}"
            if room in FIT_ROOMS:
                assert not module.startswith("fiohost.transport"), f"{name} imports {module}"


def loaded_after(code: str) -> set[str]:
    """Top names and rooms in ``sys.modules`` of a fresh interpreter after ``code``."""
    tail = "\nimport sys; print(*{'.'.join(m.split('.')[:2]) for m in sys.modules})"
    command = [sys.executable, "-P", "-c", code + tail]  # what is installed, whose kernels are compiled
    done = subprocess.run(command, capture_output=True, text=True, check=True, cwd=PACKAGES)
    return set(done.stdout.split())


IMPORT_ALL = """
import importlib, pkgutil
def everything(name):
    package = importlib.import_module(name)
    for info in pkgutil.walk_packages(package.__path__, name + '.'):
        importlib.import_module(info.name)
"""


def test_a_running_board_has_loaded_nothing_of_the_host() -> None:
    code = IMPORT_ALL + (
        "everything('firmware_model')\n"
        "from firmware_model import Board, draw, load_plant\n"
        "for plant in (load_plant('default'), draw(1)):\n"
        "    assert len(Board(plant).step(bytes(64))) == 64\n"
    )
    loaded = loaded_after(code)
    assert "firmware_model.board" in loaded
    assert not {m for m in loaded if m.split(".")[0] == "fiohost"}


def test_a_fit_has_loaded_nothing_of_the_board() -> None:
    rooms = "".join(f"everything('fiohost.{room}')\n" for room in FIT_ROOMS)
    fitting = (
        f"import sys; sys.path.insert(0, {str(ROOT / 'tests')!r})\n"
        "from bench_data import suite, truth_model\n"
        "from fiohost.estimation.fit import fit_from_scratch\n"
        "fit_from_scratch(truth_model(), suite(truth_model(), 1, 2.0))\n"
    )
    loaded = loaded_after(IMPORT_ALL + rooms + fitting)
    assert {f"fiohost.{room}" for room in FIT_ROOMS} <= loaded
    assert not {m for m in loaded if m.split(".")[0] == "firmware_model"}
