"""What leaves fiohost does the same elsewhere: C for firmware, MATLAB scripts, python-control, FMU."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result

from fiohost.api import simulate
from fiohost.cli.main import cli
from fiohost.control.settings import ControlSettings
from fiohost.errors import ConfigError
from fiohost.export.c_code import controller_c
from fiohost.export.matlab import matlab_script
from fiohost.export.stepper import Stepper
from fiohost.motor.model import Model

TICK_S = 0.005
LAWS = {
    "p": ControlSettings(kind="p", kp_pct_per_deg=1.7, u_plus_pct=1.2, u_minus_pct=-1.5, threshold_pct=0.4),
    "pd": ControlSettings(
        kind="pd", kp_pct_per_deg=3.66, kd_pct_s_per_deg=0.16, filter_s=0.01, derivative_on="angle", limit_pct=80.0
    ),
    "pd on the error": ControlSettings(kind="pd", kp_pct_per_deg=2.1, kd_pct_s_per_deg=0.07),
    "pi": ControlSettings(kind="pi", kp_pct_per_deg=1.1, ki_pct_per_deg_s=2.3, tracking_s=0.2, limit_pct=40.0),
    "pid": ControlSettings(
        kind="pid", kp_pct_per_deg=4.0, ki_pct_per_deg_s=9.0, kd_pct_s_per_deg=0.11, filter_s=0.004, tracking_s=0.0,
        limit_pct=60.0, u_plus_pct=2.0, u_minus_pct=-2.5, threshold_pct=0.7,
    ),
}  # fmt: skip


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli, [str(a) for a in arguments])


def angles(rows: int = 900) -> np.ndarray:
    """Readings that make a loop saturate, reverse and come near zero."""
    rng = np.random.default_rng(3)
    return np.round(2.0 * (60.0 * np.sin(np.arange(rows) * 0.02) + np.cumsum(rng.normal(0.0, 0.3, rows)))) / 2.0


@pytest.mark.parametrize("name", LAWS)
def test_the_law_in_c_gives_the_duties_of_a_run_bit_for_bit(name: str, tmp_path: Path) -> None:
    gcc = shutil.which("gcc")
    if gcc is None:
        pytest.skip("NO gcc HERE: THE C OF A CONTROLLER IS NOT COMPILED")
    (tmp_path / "law.h").write_text(controller_c(LAWS[name], TICK_S))
    (tmp_path / "main.c").write_text(
        '#include "law.h"\n#include <stdio.h>\nint main(void) {\n  double r, y; fiohost_controller_t c;\n'
        "  fiohost_controller_reset(&c);\n"
        '  while (scanf("%lf %lf", &r, &y) == 2) printf("%a\\n", (double)fiohost_controller_step(&c, r, y));\n}\n'
    )
    strict = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Werror"]
    subprocess.run([gcc, *strict, "main.c", "-o", "law"], cwd=tmp_path, check=True)
    law, y = LAWS[name].law(TICK_S), angles()
    told = "\n".join(f"{30.0 if k < 500 else -20.0!r} {angle!r}" for k, angle in enumerate(y.tolist()))
    out = subprocess.run([tmp_path / "law"], input=told, capture_output=True, text=True, check=True).stdout.split()
    found = [float.fromhex(word) for word in out]
    assert found == [law.step(30.0 if k < 500 else -20.0, float(angle)) for k, angle in enumerate(y)]
    single = [*strict, "-DFIOHOST_REAL=float", "main.c", "-o", "single"]
    subprocess.run([gcc, *single], cwd=tmp_path, check=True)  # as a processor without double would take it


@pytest.mark.parametrize("name", LAWS)
def test_a_controller_in_python_control_gives_the_duties_of_a_run_within_its_limits(name: str) -> None:
    control = pytest.importorskip("control", reason="python-control IS NOT INSTALLED: its objects are not tested")
    from dataclasses import replace

    from fiohost.export.python_control import controller_to_control

    settings = replace(LAWS[name], limit_pct=100.0, u_plus_pct=0.0, u_minus_pct=0.0, threshold_pct=0.0)
    y = 0.05 * (angles(200) - angles(200)[0])  # so small that no limit is met; from 0, where both begin
    ref = np.full(len(y), 2.0)
    ref[0] = 0.0
    law = settings.law(TICK_S)
    want = [law.step(float(r), float(angle)) for r, angle in zip(ref, y, strict=True)]
    assert np.abs(want).max() < 100.0
    system = controller_to_control(settings, TICK_S)
    found = control.forced_response(system, np.arange(len(y)) * TICK_S, np.vstack([ref, y])).outputs
    np.testing.assert_allclose(np.ravel(found), want, atol=1e-6)


def test_a_model_in_python_control_moves_as_here() -> None:
    control = pytest.importorskip("control", reason="python-control IS NOT INSTALLED: its objects are not tested")
    from fiohost.export.python_control import to_control

    model = Model(values={"linear.gain_deg_s_per_pct": 9.8, "linear.tau_s": 0.081})
    time_s = np.arange(400) * TICK_S
    for output, unit in (("angle", "angle_deg"), ("speed", "speed_deg_s")):
        system = to_control(model, output)
        assert system.input_labels == ["duty_pct"]
        assert system.output_labels == [unit]
    found = control.forced_response(to_control(model), time_s, np.full(400, 30.0)).outputs
    np.testing.assert_allclose(found, simulate(np.full(400, 30.0), model).output, atol=1e-6)
    with pytest.raises(ConfigError, match="angle or speed"):
        to_control(model, "torque")


@pytest.mark.parametrize("name", LAWS)
def test_a_matlab_script_runs_and_gives_the_same_loop(name: str, tmp_path: Path) -> None:
    model = Model(values={"linear.gain_deg_s_per_pct": 6.2, "linear.tau_s": 0.074})
    script = matlab_script(model, LAWS[name], TICK_S, 90.0, 1.0)
    numbers = dict(re.findall(r"^c\.(\w+) = ([^;]+);", script, re.MULTILINE))
    assert float(numbers["kp"]) == LAWS[name].kp_pct_per_deg
    assert float(numbers["limit"]) == LAWS[name].limit_pct
    octave = shutil.which("octave-cli") or shutil.which("octave")
    if octave is None:
        pytest.skip("NO octave HERE: A MATLAB SCRIPT IS WRITTEN BUT NOT RUN")
    (tmp_path / "loop.m").write_text(script)
    (tmp_path / "main.m").write_text(
        "fiohost_no_plot = true; source('loop.m'); printf('%.17g %.17g\\n', [angle'; duty']);\n"
    )
    done = subprocess.run([octave, "--no-gui", "--quiet", "main.m"], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = np.array([[float(word) for word in line.split()] for line in done.stdout.splitlines()])
    law, keep = LAWS[name].law(TICK_S), np.exp(-TICK_S / 0.074)
    theta = omega = acting = 0.0
    for angle, duty in found:
        assert angle == pytest.approx(theta, abs=1e-6)
        sent = law.step(90.0, theta)
        assert duty == pytest.approx(sent, abs=1e-6)
        target = 6.2 * acting
        theta += target * TICK_S + (omega - target) * 0.074 * (1.0 - keep)
        omega, acting = target + (omega - target) * keep, sent


MODELS = ("linear", "linear+coulomb_friction+gravity_load", "linear+backlash+transport_delay")


@pytest.mark.parametrize("expression", MODELS[:2])
def test_a_model_that_goes_on_step_by_step_is_the_model(expression: str) -> None:
    duty = np.repeat([30.0, -20.0, 0.0, 12.0], 60)
    whole, stepper = simulate(duty, expression), Stepper(Model.parse(expression))
    steps = [stepper.step(float(u), TICK_S)[0] for u in duty]
    np.testing.assert_allclose(steps[:-1], whole.output[1:], atol=1e-9)


def test_an_fmu_simulated_by_another_program_is_the_model(tmp_path: Path) -> None:
    pytest.importorskip("pythonfmu3", reason="pythonfmu3 IS NOT INSTALLED: FMUs are not tested")
    fmpy = pytest.importorskip("fmpy", reason="fmpy IS NOT INSTALLED: FMUs are not simulated")
    (tmp_path / "m.toml").write_text(
        'schema = "fiohost.model/1"\neffects = ["coulomb_friction"]\n[parameters]\nlinear.gain_deg_s_per_pct = 6.0\n'
        "linear.tau_s = 0.08\ncoulomb_friction.level_pct = 3.0\n"
    )
    fmu = tmp_path / "motor.fmu"
    result = call("export", tmp_path / "m.toml", "-o", fmu, "--json", "-")
    assert result.exit_code == 0, result.stderr
    assert json.loads(result.stdout)["kind"] == "fmu"
    duty = np.repeat([30.0, -20.0, 0.0, 12.0], 50)
    time_s = np.arange(len(duty)) * TICK_S
    given = np.array(list(zip(time_s, duty, strict=True)), dtype=[("time", float), ("duty_pct", float)])
    told = fmpy.simulate_fmu(
        str(fmu), stop_time=float(time_s[-1]), step_size=TICK_S, output_interval=TICK_S, input=given,
        fmi_type="CoSimulation",
    )  # fmt: skip
    whole = simulate(duty, tmp_path / "m.toml").output
    np.testing.assert_allclose(told["angle_deg"][: len(whole)], whole[: len(told)], atol=1e-6)


def test_the_commands_write_what_they_say_and_refuse_the_rest(tmp_path: Path) -> None:
    LAWS["pd"].save(tmp_path / "pd.toml")
    for name, holds in (("c.h", "fiohost_controller_step"), ("l.m", "fiohost_controller")):
        result = call("export", "linear", "--controller", tmp_path / "pd.toml", "-o", tmp_path / name)
        assert result.exit_code == 0, result.stderr
        assert holds in (tmp_path / name).read_text()
    for arguments, says in (
        (["linear", "-o", tmp_path / "x.slx"], "known: .fmu, .h, .m"),
        (["linear", "-o", tmp_path / "x.h"], "--controller says which"),
        (["linear", "-o", tmp_path / "no name.fmu"], "letters, digits and underscores"),
    ):
        refused = call("export", *arguments)
        assert refused.exit_code == 1
        assert says in refused.stderr
    emitted = call(
        "design", "--model", "linear", "--controller", "p", "--emit", "c", "--emit-to", tmp_path / "d.h", "--json", "-"
    )
    assert emitted.exit_code == 0, emitted.stderr
    kp = json.loads(emitted.stdout)["controller"]["kp_pct_per_deg"]
    assert f"_KP ((FIOHOST_REAL){kp!r})" in (tmp_path / "d.h").read_text()
    assert "neither c nor matlab" in call("design", "--model", "linear", "--emit", "ada").stderr
