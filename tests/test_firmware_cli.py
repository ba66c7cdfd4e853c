"""``fiohost firmware``: what ships is listed and found; the right tool is called with the right words."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from lines import PATIENT, PtyBoard
from places import ROOT

from fiohost.bench.connect import connect
from fiohost.bench.doctor import who
from fiohost.boards.flash import INSTALL, command_of, flash
from fiohost.boards.images import BOARDS, BRIDGES, find_image, images
from fiohost.boards.sketch import write_sketch
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, FiohostError
from fiohost.transport.profile import TargetProfile
from fiohost.wire.identity import QUERY, START, find_identity


def said(*words: str) -> Result:
    return CliRunner().invoke(cli, ["firmware", *words])


def everywhere(name: str) -> str:
    return f"/opt/{name}"


def test_list_names_every_board_bridge_and_size(tmp_path: Path) -> None:
    to = tmp_path / "list.json"
    done = said("list", "--json", str(to))
    assert done.exit_code == 0
    assert "none of them has met a real board yet" in done.output
    rows = json.loads(to.read_text())["images"]
    assert {(row["board"], row["bridge"]) for row in rows} == {(b, r) for b in BOARDS for r in BRIDGES}
    for row in rows:
        assert Path(row["bin"]).stat().st_size == row["bytes"] > 1000


def test_path_prints_the_file_alone() -> None:
    for image in images():
        assert said("path", image.name).output == f"{image.hex_path}\n"
        assert said("path", image.board.name, "--bridge", image.bridge, "--bin").output == f"{image.bin_path}\n"
    assert find_image("uno").bridge == "tb6612"


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["path", "unoo"], "did you mean 'uno'"),
        (["path", "uno", "--bridge", "l298"], "did you mean 'l298n'"),
        (["path", "uno-l298n", "--bridge", "tb6612"], "names one bridge"),
        (["flash", "uno"], "give --port"),
        (["flash", "bluepill", "--old-bootloader"], "Arduino Nanos only"),
    ],
)
def test_what_cannot_be_is_refused_in_one_sentence(words: list[str], reason: str) -> None:
    done = said(*words)
    assert done.exit_code == 1
    assert reason in done.output
    assert len(done.output.splitlines()) == 1


def test_flash_calls_the_boards_own_tool() -> None:
    uno, pill = find_image("uno-l298n"), find_image("bluepill")
    assert command_of(uno, "/dev/ttyACM0", which=everywhere) == [
        "/opt/avrdude", "-p", "m328p", "-c", "arduino", "-P", "/dev/ttyACM0", "-U", f"flash:w:{uno.hex_path}:i",
    ]  # fmt: skip
    assert command_of(uno, "COM3", old_bootloader=True, which=everywhere)[5:7] == ["-b", "57600"]
    assert command_of(pill, None, which=everywhere) == [
        "/opt/st-flash", "--reset", "write", str(pill.bin_path), "0x08000000",
    ]  # fmt: skip
    assert command_of(pill, "/dev/ttyUSB0", which=everywhere) == [
        "/opt/stm32flash", "-w", str(pill.hex_path), "-v", "-g", "0x08000000", "/dev/ttyUSB0",
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("board", "port", "tool"),
    [("uno", "p", "avrdude"), ("bluepill", None, "st-flash"), ("bluepill", "p", "stm32flash")],
)
def test_an_absent_tool_is_named_with_its_package(board: str, port: str | None, tool: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(INSTALL[tool])):
        command_of(find_image(board), port, which=lambda name: None)


def test_a_tool_that_fails_is_told_in_one_sentence() -> None:
    calls: list[object] = []
    run: Callable[[object], int] = lambda words: calls.append(words) or 0  # noqa: E731
    flash(["avrdude", "-x"], run)
    assert calls == [["avrdude", "-x"]]
    with pytest.raises(FiohostError, match="avrdude failed with exit code 3"):
        flash(["/opt/avrdude"], lambda words: 3)
    with pytest.raises(FiohostError, match="cannot be run"):
        flash(["/nonesuch/avrdude"])


def test_the_sketch_is_the_sources_as_they_are(tmp_path: Path) -> None:
    made = write_sketch(tmp_path)
    names = {path.name for path in made.iterdir()}
    assert {"fiohost_uno.ino", "uno.c", "fio_config.h", "frame.c", "board.c"} <= names
    for path in made.iterdir():
        sources = [one for part in ("core", "uno") if (one := ROOT / "firmware" / part / path.name).exists()]
        assert [source.read_bytes() for source in sources] == [path.read_bytes()]
    with pytest.raises(ConfigError, match="there already"):
        write_sketch(tmp_path)


def test_the_profiles_are_what_the_firmware_says_of_itself() -> None:
    header = (ROOT / "firmware" / "core" / "board.h").read_text()
    watchdog_ms = int(re.search(r"FIO_WATCHDOG_MS (\d+)u", header)[1])  # type: ignore[index]
    step_ms = int(re.search(r"FIO_STEP_MS (\d+)u", header)[1])  # type: ignore[index]
    for name in BOARDS:
        profile = TargetProfile.load(name)
        config = (ROOT / "firmware" / name / "fio_config.h").read_text()
        found = {key: int(value) for key, value in re.findall(r"#define FIO_(\w+) (\d+)u", config)}
        assert profile.duty_steps == 100 * found["STEPS_PER_PCT"]
        assert profile.counts_per_rev == found["COUNTS_PER_REV"]
        assert profile.watchdog_s == pytest.approx(1e-3 * watchdog_ms)
        assert profile.sample_time_s == pytest.approx(1e-3 * step_ms)
        assert (profile.baud, profile.board) == (500_000, name)
        assert f'"{name}"' in config


def test_a_damaged_answer_is_none() -> None:
    good = bytes.fromhex(
        "a5210175 6e6f0000 00000000 00000074 62363631 32000000 01002003 6400d002 88130000 00006993".replace(" ", "")
    )
    found = find_identity(b"\xa5!" + good + b"xyz")
    assert found is not None
    assert (found.name, found.bridge, found.version, found.duty_steps) == ("uno", "tb6612", "0.1.0", 800)
    for at in range(len(good)):
        assert find_identity(good[:at] + bytes([good[at] ^ 4]) + good[at + 1 :]) is None
    assert find_identity(good[:-1]) is None
    assert START not in QUERY


def test_a_board_that_knows_no_query_is_told_from_one_that_should() -> None:
    """The simulated board on a pty speaks the layout and passes the query over."""
    with PtyBoard(layout="framed") as line, connect(f"serial-framed:{line.target}", guards=PATIENT) as bench:
        assert list(who(bench)) == []
        assert bench.drive(20.0, 0.1).columns["pos"][-1] >= 0
    with PtyBoard(layout="framed") as line, connect(f"uno:{line.target}", guards=PATIENT) as bench:
        (finding,) = who(bench)
    assert finding.level == "problem"
    assert "does not say who it is" in finding.what
