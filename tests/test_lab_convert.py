"""The converter and the transfer functions of the control lab's window."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from fiohost.cli.main import cli
from fiohost.errors import ConfigError
from fiohost.labs.constants import TEXT
from fiohost.labs.transfer import TransferFunction, motor_function
from fiohost.labs.units import convert


@pytest.mark.parametrize(
    ("value", "unit", "to", "expected"),
    [
        (160.0, "deg", "rad", 2.7925268),  # the text's 5.585 is not 160 deg
        (7.636, "rad/s", "rpm", 7.636 * 30.0 / math.pi),
        (0.25, "N*m/A", "mN*m/A", 250.0),
        (1.0, "ozf*inch", "N*m", 0.00706155),
        (0.00233, "kg*m^2", "g*cm^2", 23300.0),
        (2.25, "V", "duty_pct", 50.0),
        (5.0, "car_cm", "rad", 5.0 / 1.375),
        (720.0, "count", "turn", 1.0),
        (0.25, "V*s/rad", "V/krpm", 0.25 * 1000.0 * math.pi / 30.0),
        (-3.0, "deg", "count", -6.0),
    ],
)
def test_a_quantity_is_the_same_in_another_unit(value: float, unit: str, to: str, expected: float) -> None:
    ((found, _),) = convert(value, unit, to).others
    assert found == pytest.approx(expected, rel=1e-6)
    ((back, _),) = convert(found, to, unit).others
    assert back == pytest.approx(value, rel=1e-9)


def test_without_a_unit_the_common_ones_are_shown() -> None:
    result = CliRunner().invoke(cli, ["convert", "100", "rpm", "--json", "-"])
    assert result.exit_code == 0, result.stderr
    said = {item["unit"]: item["value"] for item in json.loads(result.stdout)["converted"]}
    assert said == {"deg/s": pytest.approx(600.0), "rad/s": pytest.approx(10.471976)}


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["1", "foo"], "unknown unit"),
        (["1", "deg", "V"], "different quantities"),
        (["1", "9**9**9"], "is no unit"),
        (["1", "m**99"], "is no unit"),
        (["nan", "deg"], "VALUE"),
        (["1", "V", "duty_pct", "--supply", "0"], "--supply"),
    ],
)
def test_what_is_no_unit_is_refused_in_a_sentence(arguments: list[str], told: str) -> None:
    result = CliRunner().invoke(cli, ["convert", *arguments])
    assert result.exit_code == 1
    assert told in result.stderr
    assert "Traceback" not in result.stderr


def test_the_closed_loop_of_the_arm_has_the_texts_poles() -> None:
    """Eqs. D-20 to D-22 with table D-8, and D-23 to D-25 with table D-10, at KP = 3."""
    for name, omega, zeta, real, imaginary in (
        ("arm_measured", 10.45, 0.478, -5.0, 9.18),
        ("arm_tuned", 11.0, 0.503, -5.54, 9.5),
    ):
        (mode,) = motor_function(TEXT[name], "angle", winding=False).fed_back(3.0).modes()
        assert mode.omega_n_rad_s == pytest.approx(omega, abs=0.015)
        assert mode.zeta == pytest.approx(zeta, abs=0.001)
        assert mode.real == pytest.approx(real, abs=0.01)
        assert mode.imaginary == pytest.approx(
            imaginary, abs=0.015
        )  # the text prints 9.03 in D-25, which is not 11, 0.503


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.floats(-50.0, -0.05), min_size=1, max_size=3),
    st.lists(st.tuples(st.floats(-20.0, -0.1), st.floats(0.5, 30.0)), max_size=2),
    st.integers(0, 2),
    st.floats(0.1, 100.0),
)
def test_all_forms_are_the_same_function(
    real: list[float], pairs: list[tuple[float, float]], integrators: int, gain: float
) -> None:
    poles = [*map(complex, real), *(complex(a, s * b) for a, b in pairs for s in (1, -1)), *[0j] * integrators]
    found = TransferFunction.from_roots(gain, [], poles)
    assert found.kind == integrators
    for text in (found.polynomial(), found.roots(), found.time_constants()):
        s = 0.7 + 1.3j
        value = eval_form(text, s)
        exact = gain / np.prod([s - p for p in poles])
        assert abs(value - exact) < 2e-3 * abs(exact)  # five printed digits


def eval_form(text: str, s: complex) -> complex:
    """A printed form as Python."""
    text = text.replace("^", "**")
    words = text.replace("(", "( ").replace(")", " )").split()
    out: list[str] = []
    for word in words:
        if out and word not in ("+", "-", "/", ")") and out[-1] not in ("+", "-", "/", "("):
            out.append("*")
        out.append(word)
    return complex(eval(" ".join(out), {"s": s}))


def test_gain_and_phase_are_scipys() -> None:
    q = TEXT["no_load"]
    found = motor_function(q)
    _, exact = signal.freqs(found.num, found.den, worN=[5.0])
    assert found.at(5.0) == pytest.approx(complex(exact[0]), rel=1e-12)
    result = CliRunner().invoke(cli, ["tf", "--constants", "no_load", "--frequency", "5", "--json", "-"])
    said = json.loads(result.stdout)
    assert said["gain"] == pytest.approx(3.5526, abs=1e-3)
    assert said["phase_deg"] == pytest.approx(-22.101, abs=1e-3)
    assert "time constants   3.8183 / ((0.078752 s + 1) (0.0021239 s + 1))" in result.stderr


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--poles", "1+2j"], "come in pairs"),
        (["--num", "1,2,3", "--den", "1,2"], "no such system"),
        (["--den", "0"], "not 0"),
        (["--constants", "no_lod"], "did you mean 'no_load'"),
        (["--constants", "no_load", "--output", "sped"], "did you mean 'speed'"),
        (["--poles", "x"], "is no number"),
        (["--den", "1e-320,1"], "which no motor has"),
        (["--den", "1,0,1e-310"], "which no motor has"),
    ],
)
def test_what_is_no_transfer_function_is_refused(arguments: list[str], told: str) -> None:
    result = CliRunner().invoke(cli, ["tf", *arguments])
    assert result.exit_code == 1
    assert told in result.stderr
    with pytest.raises(ConfigError):
        TransferFunction.of([1.0] * 20, [1.0] * 20)
