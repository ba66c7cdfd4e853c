"""Plant files and sealed draws: what is refused and why, and what a seed may draw."""

from __future__ import annotations

from pathlib import Path

import pytest

from firmware_model import FirmwareModelError, draw, load_plant, reveal
from firmware_model.plants import make_plant
from firmware_model.registry import effects

GOOD = "supply_V = 9.0\nR_ohm = 5.5\nKt_Nm_per_A = 0.34\nKe_Vs_per_rad = 0.487\nJ_kgm2 = 3e-3\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD + "colomb_Nm = 0.02\n", ["colomb_Nm", "coulomb_Nm"]),
        (GOOD + "L_mH = 15\n", ["L_mH", "wrong unit", "L_H"]),
        (GOOD + "coulomb_mNm = 20\n", ["coulomb_mNm", "wrong unit", "coulomb_Nm"]),
        (GOOD.replace("3e-3", "-3e-3"), ["J_kgm2", "-0.003"]),
        (GOOD.replace("3e-3", "inf"), ["J_kgm2", "finite"]),
        (GOOD.replace("3e-3", "nan"), ["J_kgm2", "finite"]),
        (GOOD.replace("5.5", '"5.5"'), ["R_ohm", "number"]),
        (GOOD.replace("5.5", "true"), ["R_ohm", "number"]),
        (GOOD.replace("R_ohm = 5.5\n", ""), ["R_ohm", "missing"]),
        (GOOD + "[effects.back_lash]\ngap_deg = 3\n", ["back_lash", "backlash"]),
        (GOOD + "[effects.backlash]\ngap_mm = 3\n", ["gap_mm", "effects.backlash"]),
        (GOOD + "[effects.backlash]\ngap_deg = -3\n", ["gap_deg", "-3"]),
        (GOOD + "[effects.backlash]\ngap_deg = 3\nside = 'left'\n", ["side", "encoder_after_gap", "left"]),
        (GOOD + "[effects.backlash]\ngap_deg = 3\nload_inertia_kgm2 = 1\n", ["load_inertia_kgm2", "J_kgm2"]),
        (GOOD + "[effects.constant_load]\n", ["torque_Nm", "missing"]),
        (GOOD + "effects = 3\n", ["effects"]),
        (GOOD + "schema = 'other/1'\n", ["schema", "other/1"]),
        ("R_ohm = = 3\n", ["TOML"]),
    ],
)
def test_bad_plant_files_are_refused_by_key_and_reason(tmp_path: Path, text: str, said: list[str]) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(FirmwareModelError) as refused:
        load_plant(path)
    for word in said:
        assert word in str(refused.value)
    assert "\n" not in str(refused.value)


def test_unknown_names_and_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(FirmwareModelError, match="default"):
        load_plant("defualt")
    with pytest.raises(FirmwareModelError, match=r"missing\.toml"):
        load_plant(tmp_path / "missing.toml")


def test_degrees_are_accepted_where_the_kernel_has_radians() -> None:
    plant = make_plant({**_base(), "effects": {"backlash": {"gap_deg": 180.0}}}, "test")
    assert plant.effects["backlash"]["gap_rad"] == pytest.approx(3.14159265)


def _base() -> dict[str, float]:
    return {"supply_V": 9.0, "R_ohm": 5.5, "Kt_Nm_per_A": 0.34, "Ke_Vs_per_rad": 0.487, "J_kgm2": 3e-3}


def test_sealed_draws_are_wide_repeatable_and_have_one_effect() -> None:
    met = set()
    for seed in range(300):
        plant = draw(seed)
        assert plant == draw(seed)
        assert plant.name == "sealed"
        assert plant.L_H == 0.0
        assert 6.0 <= plant.gain_deg_s_per_pct <= 16.0
        assert 0.040 <= plant.tau_s <= 0.150
        assert 1.0 <= plant.percent_of_torque(plant.coulomb_Nm) <= 6.0
        (effect,) = plant.effects
        met.add(effect)
    assert met == {
        "backlash",
        "constant_load",
        "gravity_load",
        "input_deadband",
        "transport_delay",
        "voltage_saturation",
    }


def test_reveal_tells_the_truth_in_words_si_and_percent() -> None:
    for seed in range(30):
        plant, truth = draw(seed), reveal(seed)
        (effect,) = plant.effects
        assert truth["effects"] == [effect]
        assert truth["si"]["R_ohm"] == plant.R_ohm
        assert truth["si"]["effects"][effect] == plant.effects[effect]
        assert truth["reduced"]["linear"]["tau_s"] == plant.tau_s
        assert any(effect in sentence for sentence in truth["truth"])
        assert set(truth["reduced"]) == {"linear", "coulomb_friction", effect}


def test_every_effect_says_what_it_is() -> None:
    for name, effect in effects().items():
        assert effect.name == name
        assert effect.summary
        assert effect.equation
        assert effect.source
