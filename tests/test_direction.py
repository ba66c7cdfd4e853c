"""A command without sign and a column beside it that says which way: found, kept in the map, refused if it is none."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fiohost.errors import ConfigError, DataError
from fiohost.importing.automatic import read_any
from fiohost.importing.convert import log_from_raw
from fiohost.importing.direction import Value
from fiohost.importing.map import TableMap
from fiohost.importing.read import read_raw
from fiohost.importing.understand import understand
from fiohost.settings import read_toml

TIME_S = 0.01 * np.arange(1500)
DUTY = 60.0 * np.sin(2.0 * np.pi * 0.2 * TIME_S + 0.3)
SPEED = 10.0 * np.roll(DUTY, 5)


def table(
    path: Path, name: str, way: Sequence[Value] | np.ndarray, speed: np.ndarray, duty: np.ndarray = DUTY,
    signed: bool = True,
) -> Path:  # fmt: skip
    rows = zip(TIME_S, np.abs(duty), way, speed if signed else np.abs(speed), strict=True)
    shown = ((t, u, w if isinstance(w, str) else f"{w:g}", n) for t, u, w, n in rows)
    lines = [f"{t:.2f},{u:.3f},{w},{n:.2f}" for t, u, w, n in shown]
    path.write_text("\n".join([f"t_s,pwm_pct,{name},speed [deg/s]", *lines]) + "\n")
    return path


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "forward", "back"),
    [
        *[("dir", 1, 0), ("dir", 0, 1), ("Richtung", 1, -1), ("ccw", 0, 1), ("dir", -1, 1)],
        *[("dir", "F", "R"), ("direction", "fwd", "rev"), ("Richtung", "vorwärts", "rückwärts"), ("dir", "+", "-")],
        *[("dir", "CCW", "CW"), ("dir", "left", "right"), ("dir", "B", "A")],
    ],
)
def test_the_column_that_says_which_way_is_the_sign_of_the_command(
    tmp_path: Path, name: str, forward: Value, back: Value, signed: bool
) -> None:
    """What the shaft shows is not assumed; without it, words and a minus say it, and of two others the larger one."""
    raw = read_raw(table(tmp_path / "t.csv", name, [forward if u >= 0.0 else back for u in DUTY], SPEED, signed=signed))
    found = understand(raw)
    assert any(name in line for line in found.lines)
    sign = 1.0
    if not signed:
        says = {"CCW": -1.0, "left": -1.0, "B": 1.0, 0: 1.0 if name == "ccw" else -1.0, -1: -1.0}
        sign = says.get(forward, 1.0)
        said_itself = -1 in (forward, back) or (isinstance(forward, str) and forward != "B")
        assert any("forward" in text for text in found.assumed) is not said_itself
    else:
        assert not any("forward" in text for text in found.assumed)
    assert (found.certain.sign_column, found.certain.forward) == (name, forward if sign > 0.0 else back)
    log = log_from_raw(raw, found.certain)
    np.testing.assert_allclose(log.duty_pct, sign * DUTY, atol=6e-4)
    moving = np.abs(SPEED) > 100.0
    np.testing.assert_array_equal(np.sign(log.output[moving]), sign * np.sign(SPEED[moving]))
    kept = tmp_path / "kept.toml"
    kept.write_text(found.certain.to_toml())
    again = TableMap.from_table(read_toml(kept), "kept")
    np.testing.assert_array_equal(log_from_raw(raw, again).duty_pct, log.duty_pct)


def test_a_motor_that_is_let_go_is_driven_neither_way(tmp_path: Path) -> None:
    way = ["N" if abs(u) > 50.0 else "F" if u >= 0.0 else "R" for u in DUTY]
    raw = read_raw(table(tmp_path / "t.csv", "dir", way, SPEED))
    log = log_from_raw(raw, understand(raw).certain)
    np.testing.assert_allclose(log.duty_pct, np.where(np.abs(DUTY) > 50.0, 0.0, DUTY), atol=6e-4)


def test_tables_of_one_way_each_are_told_apart_by_all_of_a_bench(tmp_path: Path) -> None:
    duty, speed = np.abs(DUTY), np.abs(SPEED)
    ahead = read_raw(table(tmp_path / "a.csv", "dir", np.ones(1500), speed, duty))
    back = read_raw(table(tmp_path / "b.csv", "dir", np.zeros(1500), -speed, duty))
    assert understand(back).certain.sign_column is None  # alone it says nothing
    for raw, other, sign in ((ahead, back, 1.0), (back, ahead, -1.0)):
        log = log_from_raw(raw, understand(raw, others=[other]).certain)
        np.testing.assert_allclose(log.duty_pct, sign * duty, atol=6e-4)


def test_words_of_one_way_alone_are_a_sign_too(tmp_path: Path) -> None:
    duty, speed = np.abs(DUTY), np.abs(SPEED)
    raw = read_raw(table(tmp_path / "b.csv", "dir", ["N" if i < 300 else "R" for i in range(1500)], -speed, duty))
    found = understand(raw).certain
    assert (found.forward, found.backward) == (None, "R")
    log = log_from_raw(raw, found)
    np.testing.assert_allclose(log.duty_pct, np.where(np.arange(1500) < 300, 0.0, -duty), atol=6e-4)


def test_a_frame_with_words_is_read_alike(tmp_path: Path) -> None:
    pandas = pytest.importorskip("pandas")
    path = table(tmp_path / "t.csv", "dir", ["F" if u >= 0.0 else "R" for u in DUTY], SPEED)
    (log,) = read_any([pandas.read_csv(path)])
    np.testing.assert_allclose(log.duty_pct, DUTY, atol=6e-4)


def test_a_sign_that_is_measured_is_none_of_the_command(tmp_path: Path) -> None:
    way = np.where(np.arange(1500) % 100 < 10, 0.0, np.sign(DUTY))  # stands while it is driven
    assert understand(read_raw(table(tmp_path / "t.csv", "dir", way, np.abs(SPEED)))).certain.sign_column is None


def test_a_command_with_a_sign_needs_no_column_for_it(tmp_path: Path) -> None:
    path = table(tmp_path / "t.csv", "dir", (DUTY > 0).astype(float), SPEED)
    path.write_text(path.read_text().replace("\n14.99,", "\n14.99,-"))  # one negative command
    assert understand(read_raw(path)).certain.sign_column is None


def test_a_direction_that_is_measured_while_the_motor_is_driven_one_way_is_no_sign(tmp_path: Path) -> None:
    duty = np.abs(DUTY)
    back = (duty < 3.0).astype(float)  # the shaft swings back a little where it stands
    raw = read_raw(table(tmp_path / "t.csv", "direction", back, 10.0 * duty, duty))
    assert understand(raw).certain.sign_column is None


@pytest.mark.parametrize(("ways", "forward"), [("FR", "1"), ("FR", "'Fwd'"), ((1, 0), "'F'"), ("R", "'F'")])
def test_a_map_whose_values_are_not_in_the_column_is_refused(
    tmp_path: Path, ways: Sequence[Value], forward: str
) -> None:
    """Every row would be one backwards."""
    path = table(tmp_path / "t.csv", "dir", [ways[0] if u >= 0.0 else ways[-1] for u in DUTY], SPEED)
    kept = tmp_path / "map.toml"
    kept.write_text(
        'schema = "fiohost.map/1"\n[time]\ncolumn = "t_s"\n[command]\ncolumn = "pwm_pct"\nsign_column = "dir"\n'
        f'forward = {forward}\n[output]\ncolumn = "speed [deg/s]"\nquantity = "speed"\nunit = "deg/s"\n'
    )
    with pytest.raises(DataError, match="say which of them is"):
        log_from_raw(read_raw(path), TableMap.load(kept))


def test_tables_whose_columns_hold_other_things_say_nothing_of_this_one(tmp_path: Path) -> None:
    way = ["F" if u >= 0.0 else "R" for u in DUTY]
    raw = read_raw(table(tmp_path / "a.csv", "dir", way, SPEED))
    other = tmp_path / "b.csv"
    rows = (f"{t:.2f},off,F,{n:.2f}" for t, n in zip(TIME_S, SPEED, strict=True))
    other.write_text("\n".join(["t_s,pwm_pct,dir,speed [deg/s]", *rows]) + "\n")
    assert understand(raw, others=[read_raw(other)]).certain == understand(raw).certain


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
    for key in ("forward", "backward"):
        kept.write_text(text.replace('sign_column = "dir"', f"{key} = 1"))
        with pytest.raises(ConfigError, match="sign_column"):
            TableMap.load(kept)
    kept.write_text(text.replace('sign_column = "dir"', 'sign_column = "dir"\nbackwards = "R"'))
    with pytest.raises(ConfigError, match="did you mean 'backward'"):
        TableMap.load(kept)
    kept.write_text(text.replace('sign_column = "dir"', 'sign_column = "dir"\nforward = "F"\nbackward = "F"'))
    with pytest.raises(ConfigError, match="the same value"):
        TableMap.load(kept)
    path = table(tmp_path / "t.csv", "dir", [f"w{i}" for i in range(1500)], SPEED)
    kept.write_text(text)
    with pytest.raises(DataError, match="too many different words"):
        log_from_raw(read_raw(path), TableMap.load(kept))
