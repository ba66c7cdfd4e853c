"""Plant files and sealed draws: what is refused and why, and what a seed may draw."""

from __future__ import annotations

import hashlib
import struct
from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from firmware_model import Board, FirmwareModelError, draw, load_plant, plant_names, reveal
from firmware_model.plants import make_plant
from firmware_model.registry import effects
from firmware_model.sealed import ALIKE, BROUGHT, EFFECTS, SHARES, VERSIONS

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
        (GOOD.replace("9.0", "1e300"), ["supply_V", "beyond what any motor has"]),
        (GOOD.replace("5.5", "1" * 400), ["R_ohm", "digits"]),
        (GOOD.replace("5.5", "0x" + "f" * 5000), ["R_ohm", "digits"]),
        (GOOD.replace("5.5", "1" * 5000), ["TOML"]),
        (GOOD + "effects = " + "[" * 3000 + "]" * 3000, ["TOML"]),
        (GOOD.replace("3e-3", "1e-300"), ["J_kgm2", "least"]),
        (GOOD + "counts_per_rev = 719.5\n", ["counts_per_rev", "whole"]),
        (GOOD + "pull_ups = 1\n", ["pull_ups", "true or false"]),
        (GOOD + "pullups = false\n", ["pullups", "pull_ups"]),
        (GOOD + "watchdog = true\n", ["[watchdog]", "table"]),
        (GOOD + "[watchdog]\ntimeout_ms = 100\n", ["timeout_ms", "wrong unit", "timeout_s"]),
        (GOOD + "[watchdog]\ntimeout_s = -1\n", ["timeout_s", "-1"]),
        (GOOD + "[thermal_shutdown]\nopen_C = 100\n", ["open_C", "opens_C"]),
        (GOOD + "[thermal_shutdown]\nhysteresis_K = nan\n", ["hysteresis_K", "finite"]),
        (GOOD + "[faults]\nreport_dropped_ratio = 0.1\n", ["report_dropped_ratio", "report_drop_ratio"]),
        (GOOD + "[faults]\nreport_drop_ratio = 1.5\n", ["report_drop_ratio", "1.5"]),
        (GOOD + "[faults]\nreset_at_s = inf\n", ["reset_at_s", "finite"]),
        (GOOD + "[faults]\ndirection = 'up'\n", ["direction", "to_host", "up"]),
        (GOOD + "[faults]\nsupply_lost_at_s = 3\nsupply_back_at_s = 2\n", ["supply_back_at_s", "later"]),
        (GOOD + "[faults]\nsupply_back_at_s = 2\n", ["supply_back_at_s", "later"]),
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


def test_sealed_draws_are_wide_repeatable_and_have_no_effect_one_or_two() -> None:
    met: Counter[str] = Counter()
    counts: Counter[int] = Counter()
    for seed in range(1000):
        plant = draw(seed)
        assert plant == draw(seed)
        assert plant.name == "sealed"
        assert plant.L_H == 0.0
        assert 6.0 <= plant.gain_deg_s_per_pct <= 16.0
        assert 0.040 <= plant.tau_s <= 0.150
        assert 1.0 <= plant.percent_of_torque(plant.coulomb_Nm) <= 6.0
        assert not any(alike <= set(plant.effects) for alike in ALIKE)
        assert plant.faults is None
        met.update(list(plant.effects))
        counts[len(plant.effects)] += 1
    assert set(met) == set(EFFECTS)
    assert min(met.values()) > 20
    for count, share in SHARES.items():
        assert counts[count] / 10.0 == pytest.approx(share, abs=5.0)  # of a hundred; five are 3 standard deviations
    assert set(counts) == set(SHARES)


def drawn_digest(version: int) -> str:
    """A fingerprint of the plants of some seeds, to nine digits; what an effect has by default says nothing."""
    digest = hashlib.sha256()
    for seed in range(200):
        plant = draw(seed, faulty=True, version=version)
        values = [plant.R_ohm, plant.Kt_Nm_per_A, plant.Ke_Vs_per_rad, plant.J_kgm2, plant.coulomb_Nm]
        told = [f"{v:.9g}" for v in values]
        for name, inner in [*plant.effects.items(), ("faults", plant.faults or {})]:
            known = effects()[name].parameters if name in effects() else ()
            usual = {q.key: q.choices[int(q.default or 0)] if q.choices else q.default for q in known}
            kept = {k: v for k, v in inner.items() if v != usual.get(k)}
            told += [name, *(f"{k} {v:.9g}" if isinstance(v, float) else f"{k} {v}" for k, v in kept.items())]
        digest.update(" ".join(told).encode())
    return digest.hexdigest()[:16]


FROZEN = {1: "0d5d0f77babcc94f", 2: "538940a954c6649c"}


@pytest.mark.parametrize("version", VERSIONS)
def test_a_version_of_the_sealed_draws_stays_as_it_was_published(version: int) -> None:
    assert drawn_digest(version) == FROZEN[version]


def test_an_effect_that_becomes_known_changes_no_version_that_there_is(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(EFFECTS, "a_new_one", lambda rng, motor: {})
    assert drawn_digest(1) == FROZEN[1]


def test_a_new_version_gives_some_benches_its_own_effects_and_leaves_the_others_as_they_were() -> None:
    same = moved = 0
    for seed in range(300):
        before, after = draw(seed, version=1), draw(seed, version=2)
        assert before.tau_s == after.tau_s
        assert len(before.effects) == len(after.effects)
        own = [name for name in after.effects if name in BROUGHT[2]]
        same += not own and before == after
        moved += len(own) == 1 and list(before.effects)[1:] == [n for n in after.effects if n not in own]
    assert same + moved == 300
    assert 60 < moved < 120  # 35 of the 85 of a hundred that have an effect


def test_a_version_that_is_not_known_is_refused() -> None:
    with pytest.raises(FirmwareModelError, match="there are 1, 2"):
        draw(1, version=999)


def test_sealed_sizes_go_from_faint_to_plain() -> None:
    sizes = [draw(seed).reduced().get("constant_load", {}).get("level_pct") for seed in range(3000)]
    known = sorted(abs(size) for size in sizes if size is not None)
    assert known[0] < 0.5
    assert known[-1] > 4.0


def test_sealed_faults_come_on_request_and_leave_plant_and_effects_as_they_are() -> None:
    kinds = set()
    for seed in range(200):
        plant = draw(seed, faulty=True)
        assert plant == draw(seed, faulty=True)
        assert replace(plant, faults=None) == draw(seed)
        found = reveal(seed)["faults"]
        assert found
        assert plant.faults is not None
        assert all(plant.faults[key] == value for key, value in found.items())
        kinds |= set(found)
    assert {"report_drop_ratio", "report_cut_ratio", "clock_ppm", "tick_jitter_s"} <= kinds


def test_reveal_tells_the_truth_in_words_si_and_percent() -> None:
    for seed in range(60):
        plant, truth = draw(seed), reveal(seed)
        assert truth["effects"] == list(plant.effects)
        assert truth["si"]["R_ohm"] == plant.R_ohm
        assert truth["si"]["effects"] == {name: dict(values) for name, values in plant.effects.items()}
        assert truth["reduced"]["linear"]["tau_s"] == plant.tau_s
        assert len(truth["truth"]) == 1 + len(plant.effects)
        assert all(any(name in sentence for sentence in truth["truth"]) for name in plant.effects)
        assert set(truth["reduced"]) == {"linear", "coulomb_friction", *plant.effects}


def test_every_sealed_effect_makes_a_board_that_runs() -> None:
    left, seed = set(EFFECTS), 0
    while left:
        plant = draw(seed)
        if left & set(plant.effects):
            board = Board(plant, seed=seed)
            for k in range(60):
                board.step(struct.pack("<fBB58x", 70.0, k // 30, 1 - k // 30))
            left -= set(plant.effects)
        seed += 1


# R, L, Kt, Ke, J, B, Coulomb, supply as printed in the sources that the files name.
PRINTED = {
    "default": (5.515, 0.015, 0.3408, 0.4869, 3.07e-3, 0.0, 0.02045, 9.0),
    "nxt_fast_decay": (5.515, 0.015, 0.3408, 0.4869, 3.07e-3, 0.0, 0.02045, 9.0),
    "nxt_no_load": (2.27, 0.0047, 0.25, 0.25, 0.00233, 0.00131, 0.0, 4.5),
    "nxt_arm_measured": (2.27, 0.0047, 0.25, 0.25, 0.00302, 0.0027, 0.0, 4.5),
    "nxt_arm_tuned": (2.27, 0.0047, 0.25, 0.25, 0.00273, 0.0027, 0.0, 4.5),
    "nxt_elevator": (2.27, 0.0047, 0.25, 0.25, 0.0024, 0.002, 0.0, 4.5),
    "problem_d1": (2.0, 0.008, 0.1, 0.1, 0.0004, 0.001, 0.0, 5.0),
}
TABLES = {
    "nxt_no_load": ("table D-6", 0.081),
    "nxt_arm_measured": ("table D-8", 0.1),
    "nxt_arm_tuned": ("table D-10", 0.09),
    "nxt_elevator": ("table D-11", 0.08),
}


@pytest.mark.parametrize("name", PRINTED)
def test_shipped_plants_are_the_printed_sets_kept_whole(name: str) -> None:
    p = load_plant(name)
    constants = (p.R_ohm, p.L_H, p.Kt_Nm_per_A, p.Ke_Vs_per_rad, p.J_kgm2, p.B_Nms, p.coulomb_Nm, p.supply_V)
    assert constants == PRINTED[name]
    assert p.source
    if name in TABLES:
        table, tau_s = TABLES[name]
        assert table in p.source
        assert p.tau_s == pytest.approx(tau_s, abs=0.0055)  # the appendix's own rounding


def test_the_elevator_hangs_its_car_and_one_plant_has_fast_decay() -> None:
    load = load_plant("nxt_elevator").effects["constant_load"]["torque_Nm"]
    assert load == 0.017
    assert load == pytest.approx(0.124 * 9.81 * 0.01375, abs=0.0005)
    assert [name for name in plant_names() if "fast_decay" in load_plant(name).effects] == ["nxt_fast_decay"]
    assert {*PRINTED, "ideal"} <= set(plant_names())


def test_every_effect_says_what_it_is() -> None:
    for name, effect in effects().items():
        assert effect.name == name
        assert effect.summary
        assert effect.equation
        assert effect.source
