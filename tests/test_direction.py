"""A command without sign and a column beside it that says which way: found, kept in the map, refused if it is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from fiohost.errors import ConfigError, DataError
from fiohost.importing.convert import log_from_raw
from fiohost.importing.map import TableMap
from fiohost.importing.read import read_raw
from fiohost.importing.understand import understand
from fiohost.settings import read_toml

TIME_S = 0.01 * np.arange(1500)
DUTY = 60.0 * np.sin(2.0 * np.pi * 0.2 * TIME_S + 0.3)
SPEED = 10.0 * np.roll(DUTY, 5)


def table(path: Path, name: str, way: np.ndarray, speed: np.ndarray, duty: np.ndarray = DUTY) -> Path:
    rows = zip(TIME_S, np.abs(duty), way, speed, strict=True)
    lines = [f"{t:.2f},{u:.3f},{w:g},{n:.2f}" for t, u, w, n in rows]
    path.write_text("\n".join([f"t_s,pwm_pct,{name},speed [deg/s]", *lines]) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "forward", "back", "signed"),
    [("dir", 1, 0, True), ("dir", 0, 1, True), ("Richtung", 1, -1, True), ("dir", 1, 0, False), ("ccw", 0, 1, False)],
)
def test_the_column_that_says_which_way_is_the_sign_of_the_command(
    tmp_path: Path, name: str, forward: float, back: float, signed: bool
) -> None:
    way = np.where(DUTY >= 0.0, forward, back)
    raw = read_raw(table(tmp_path / "t.csv", name, way, SPEED if signed else np.abs(SPEED)))
    found = understand(raw)
    assert any(name in line for line in found.lines)
    assert any("forward" in text for text in found.assumed) is not signed, "what the shaft shows is not assumed"
    assert (found.certain.sign_column, found.certain.forward) == (name, forward)
    log = log_from_raw(raw, found.certain)
    np.testing.assert_allclose(log.duty_pct, DUTY, atol=6e-4)
    moving = np.abs(SPEED) > 100.0
    np.testing.assert_array_equal(np.sign(log.output[moving]), np.sign(SPEED[moving]))
    kept = tmp_path / "kept.toml"
    kept.write_text(found.certain.to_toml())
    again = TableMap.from_table(read_toml(kept), "kept")
    np.testing.assert_array_equal(log_from_raw(raw, again).duty_pct, log.duty_pct)


def test_a_command_with_a_sign_needs_no_column_for_it(tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", "dir", (DUTY > 0).astype(float), SPEED)
    path.write_text(path.read_text().replace("\n14.99,", "\n14.99,-"))  # one negative command
    assert understand(read_raw(path)).certain.sign_column is None


def test_a_direction_that_is_measured_while_the_motor_is_driven_one_way_is_no_sign(tmp_path: Path) -> None:
    duty = np.abs(DUTY)
    back = (duty < 3.0).astype(float)  # the shaft swings back a little where it stands
    raw = read_raw(table(tmp_path / "t.csv", "direction", back, 10.0 * duty, duty))
    assert understand(raw).certain.sign_column is None


def test_a_column_of_more_than_two_values_and_a_value_without_column_are_refused(tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", "dir", np.arange(1500) % 3, SPEED)
    text = (
        'schema = "fiohost.map/1"\n[time]\ncolumn = "t_s"\n[command]\ncolumn = "pwm_pct"\nsign_column = "dir"\n'
        '[output]\ncolumn = "speed [deg/s]"\nquantity = "speed"\nunit = "deg/s"\n'
    )
    kept = tmp_path / "map.toml"
    kept.write_text(text)
    with pytest.raises(DataError, match="more than two values"):
        log_from_raw(read_raw(path), TableMap.load(kept))
    kept.write_text(text.replace('sign_column = "dir"', "forward = 1"))
    with pytest.raises(ConfigError, match="sign_column"):
        TableMap.load(kept)
