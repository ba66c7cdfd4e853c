"""What is opened for a target's name, and which seed is kept for a sealed one."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fiohost.bench import connect as connecting
from fiohost.bench import seal
from fiohost.bench.clock import MonotonicClock, PlayedClock, VirtualClock
from fiohost.bench.connect import asking, connect, open_target, split_target
from fiohost.bench.seal import draw_seed, find_seed, find_version, is_faulty, is_sealed, store_seed, student_seed
from fiohost.errors import ConfigError, FiohostError
from fiohost.transport.profile import TargetProfile

# ---- targets -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("target", "wanted"),
    [
        ("sim", ("sim", "", "hid-assumed")), ("sim:a:b", ("sim", "a:b", "hid-assumed")),
        ("hid:A", ("hid", "A", "hid-assumed")), ("serial:COM3", ("serial", "COM3", "serial-documented")),
        ("replay:a:b.jsonl", ("replay", "a:b.jsonl", "")), ("serial-framed", ("serial", "", "serial-framed")),
        ("serial-framed:/dev/x", ("serial", "/dev/x", "serial-framed")),
        ("emulated:uno:p", ("emulated", "uno:p", "uno")),
    ],
)  # fmt: skip
def test_a_target_is_a_medium_what_follows_it_and_a_profile(target: str, wanted: tuple[str, str, str]) -> None:
    assert split_target(target) == wanted


def test_a_profile_in_a_file_is_a_target_with_what_follows(tmp_path: Path) -> None:
    path = tmp_path / "a:b.toml"
    path.write_text(TargetProfile.load("serial-framed").text)
    assert split_target(str(path)) == ("serial", "", str(path))
    assert split_target(f"{path}:/dev/x:y") == ("serial", "/dev/x:y", str(path))
    with pytest.raises(ConfigError, match="unknown target 'serail'; did you mean 'serial'"):
        split_target("serail")
    with pytest.raises(ConfigError, match="replay needs the file of a trace"):
        split_target("replay")


def test_what_is_opened_for_each_medium(monkeypatch: pytest.MonkeyPatch) -> None:
    hid, profile = open_target("hid:A1")
    assert (hid.name, hid._prefix, profile.name) == ("hid:A1", b"\0", "hid-assumed")  # type: ignore[attr-defined]
    assert (hid._vendor_id, hid._product_id) == (0x0483, 0x5750)  # type: ignore[attr-defined]
    framed, _ = open_target("hid-framed")
    report_id = TargetProfile.load("hid-framed").codec.telemetry_layout.report_id
    assert framed._prefix == (b"" if report_id is not None else b"\0")  # type: ignore[attr-defined]
    plain, profile = open_target("serial:/dev/x")
    assert (plain._asked, plain._baud) == ("/dev/x", profile.baud)  # type: ignore[attr-defined]
    with_id = replace(profile, vendor_id=0x1209, product_id=None, baud=9600)
    assert connecting._serial("", with_id, None, "")._asked == "1209:0000"  # type: ignore[attr-defined]
    assert connecting._serial("/dev/x", with_id, None, "")._asked == "/dev/x"  # type: ignore[attr-defined]
    assert connecting._serial("", profile, None, "")._baud == profile.baud  # type: ignore[attr-defined]
    kept: dict[str, int] = {}
    monkeypatch.setattr(connecting, "store_seed", kept.__setitem__)
    sealed, _ = open_target("sim:sealed", seed=0, run_id="told")
    faulty, _ = open_target("sim:sealed-faulty", run_id="drawn")
    assert (sealed.name, faulty.name) == ("sim:sealed", "sim:sealed-faulty")
    assert kept["told"] == 0
    assert kept.keys() == {"told", "drawn"}
    student, _ = open_target("sim:student:me", run_id="mine")
    assert (student.name, student.identity) == ("sim:sealed", "simulated, sealed")
    assert "mine" not in kept
    with pytest.raises(ConfigError, match="drawn by the student's name"):
        open_target("sim:student:me", seed=1)


def test_the_time_of_a_bench_is_that_of_its_target(tmp_path: Path) -> None:
    path = tmp_path / "t.jsonl"
    with asking(trace=path), connect("sim") as bench:
        assert isinstance(bench.clock, VirtualClock)
        bench.drive(20.0, 0.05)
    with connect("sim", realtime=True) as bench:
        assert isinstance(bench.clock, MonotonicClock)
    with connect(f"replay:{path}") as bench:
        assert isinstance(bench.clock, VirtualClock)  # the trace is of a board in lock step
    head, *events = path.read_text().splitlines()
    path.write_text("\n".join([json.dumps(json.loads(head) | {"lock_step": False}), *events]) + "\n")
    assert open_target(f"replay:{path}")[0]._paced is False  # type: ignore[attr-defined]
    bench = connect(f"replay:{path}")
    assert isinstance(bench.clock, PlayedClock)
    assert bench.clock.now_s() == bench.transport.time_s  # type: ignore[attr-defined]
    paced = connecting.connect(f"replay:{path}", realtime=True)
    assert isinstance(paced.clock, MonotonicClock)
    for seed in (-1, 2**63):
        with pytest.raises(ConfigError, match=f"seed {seed} is outside"):
            connect("sim", seed=seed)
    for seed in (0, 2**63 - 1):
        connect("sim", seed=seed).close()


# ---- seals ---------------------------------------------------------------------------------------------------------


def test_which_targets_are_sealed() -> None:
    for target in ("sim:sealed", "sim:sealed-faulty", "sim:student:me", "emulated:uno:sealed"):
        assert is_sealed(target)
    for target in ("sim", "sim:seal", "emulated:uno", "uno:sealed", "hid:sealed"):
        assert not is_sealed(target)
    assert [is_faulty(t) for t in ("sim:sealed", "sim:sealed-faulty")] == [False, True]


def test_a_students_seed_is_that_of_the_name_alone() -> None:
    assert student_seed("Ada@x.org") == student_seed("ada@X.org") != student_seed("ada@x.net")
    assert 0 <= student_seed("1") < 2**32
    assert student_seed("x" * 80)
    for name in ("", "x" * 81, "a b", "a/b"):
        with pytest.raises(ConfigError, match="is no student's name"):
            student_seed(name)
    assert 0 <= draw_seed() < 2**32


def test_a_seed_is_kept_under_its_run_and_found_by_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    for _ in range(2):  # the folder may be there already
        store_seed("0123456789abcdef", 42)
    kept = tmp_path / "fiohost" / "seals" / "0123456789abcdef.json"
    assert json.loads(kept.read_text()) == {"run_id": "0123456789abcdef", "seed": 42}

    def log(**head: str) -> str:
        lines = "".join(f"# {key}: {value}\n" for key, value in head.items())
        path = tmp_path / "run.csv"
        path.write_text(f"{lines}time_s,duty_pct,pos\n0,0,0\n0.005,0,0\n")
        return str(path)

    sealed = {"target": "sim:sealed", "run_id": "0123456789abcdef"}
    assert find_seed(log(**sealed)) == 42
    assert (find_version(log(**sealed)), find_version("42")) == (1, None)
    assert find_version(log(**sealed, sealed_version="3")) == 3
    for said in ("x", "1234567"):
        with pytest.raises(ConfigError, match="which is no version"):
            find_version(log(**sealed, sealed_version=said))
    with pytest.raises(ConfigError, match="is a log of 'sim': not sealed"):
        find_seed(log(target="sim"))
    with pytest.raises(ConfigError, match="is a log of 'an unnamed target'"):
        find_seed(log())
    for run_id in ("0123456789abcdee", "../../x", "0123456", ""):
        with pytest.raises(ConfigError, match="is not kept here"):
            find_seed(log(target="sim:sealed", run_id=run_id))
    kept.write_text("{}")
    with pytest.raises(FiohostError, match=r"the seal .* is damaged"):
        find_seed(log(**sealed))
    assert find_seed(str(2**63 - 1)) == 2**63 - 1
    assert find_seed("0") == 0
    with pytest.raises(ConfigError, match="is larger than"):
        find_seed(str(2**63))
    with pytest.raises(ConfigError, match="is neither a seed"):
        find_seed("12x")
    (tmp_path / "file").touch()
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "file"))
    with pytest.raises(ConfigError, match="cannot keep the seal in"):
        store_seed("0123456789abcdef", 1)
    monkeypatch.delenv("XDG_STATE_HOME")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "windows"))
    assert seal.state_dir() == tmp_path / "windows" / "fiohost"
