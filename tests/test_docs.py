"""The documents say what the code does: byte examples, TOML examples and lists of names are checked against it."""

from __future__ import annotations

import importlib.util
import re
import sys
from dataclasses import fields
from pathlib import Path
from types import ModuleType

import click
import pytest
from places import ROOT

from fiohost.bench.experiment import Experiment
from fiohost.bench.profile import BenchProfile
from fiohost.bench.signals import KINDS
from fiohost.circle.readings import read_readings
from fiohost.cli.main import COMMANDS, cli
from fiohost.control.settings import ControlSettings
from fiohost.importing.map import TableMap
from fiohost.labs.readings import Readings
from fiohost.motor.model import Model
from fiohost.settings import config_names
from fiohost.transport.profile import TargetProfile
from fiohost.wire.identity import ANSWER_BYTES, QUERY
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command

PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])


def text(name: str) -> str:
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def blocks(language: str) -> list[tuple[str, str]]:
    """All fenced blocks of one language: where it is, and what is in it."""
    found = []
    for page in PAGES:
        if not page.is_file():
            continue
        for i, match in enumerate(re.findall(rf"```{language}\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)):
            found.append((f"{page.name} {i + 1}", match))
    return found


def layout_sections() -> dict[str, str]:
    """The parts of the wire's page that describe a shipped layout, by the profile's name."""
    parts = re.split(r"^## ", text("protocol.md"), flags=re.MULTILINE)
    return {match[1]: part for part in parts if (match := re.match(r"Layout `([\w-]+)`\n", part))}


@pytest.mark.parametrize(("name", "count"), [("hid-assumed", 9), ("serial-documented", 7), ("serial-framed", 7)])
def test_the_byte_examples_are_what_the_codec_sends_and_understands(name: str, count: int) -> None:
    section = layout_sections()[name]
    rows = re.findall(r"^\| (command|telemetry) \| (.+?) \| `([0-9a-f ]+)` \|$", section, re.MULTILINE)
    assert len(rows) == count
    codec = TargetProfile.load(name).codec
    for kind, meaning, hexadecimal in rows:
        report = bytes.fromhex(hexadecimal)
        report = report.ljust(64, b"\0") if name.startswith("hid") else report
        meaning, _, numbers = meaning.partition(", sequence ")
        if kind == "telemetry":
            told = tuple(int(part) for part in re.findall(r"\d+", f"{meaning} {numbers}"))
            assert tuple(value for value in codec.decode(report) if value is not None) == told, meaning
            continue
        if meaning in ("brake", "standby"):
            command = BRAKE_COMMAND if meaning == "brake" else STANDBY_COMMAND
        else:
            word, level = meaning.removesuffix(" %").split()
            command = Command.drive(float(level) * (1 if word == "forward" else -1))
        assert codec.encode(command, int(numbers or 0)) == report, meaning


@pytest.mark.parametrize("name", layout_sections())
def test_the_offset_tables_are_those_of_the_shipped_profiles(name: str) -> None:
    codec = TargetProfile.load(name).codec
    rows = re.findall(r"^\| (\d+) \| (\w+) \| `(\w+)` \|", layout_sections()[name], re.MULTILINE)
    expected: list[tuple[str, str, str]] = []
    for layout in (codec.command_layout, codec.telemetry_layout):
        parts = [(field.offset, field.type, field.name) for field in layout.fields]
        parts += [(0, "bytes", "header")] if layout.header else []
        parts += [(layout.length - len(layout.terminator), "bytes", "terminator")] if layout.terminator else []
        parts += [(layout.crc.offset, f"u{8 * layout.crc.size}", "crc")] if layout.crc else []
        expected += [(str(offset), kind, what) for offset, kind, what in sorted(parts)]
    assert rows == expected


def test_every_shipped_profile_has_a_layout_on_the_page() -> None:
    """Those without a section of their own carry the bytes of one that has."""
    sections = layout_sections()
    for name in config_names("targets"):
        profile = TargetProfile.load(name)
        own = name if name in sections else "serial-framed"
        sent, told = profile.codec, TargetProfile.load(own).codec
        report = told.encode(Command.drive(40.0), 7)
        assert sent.encode(Command.drive(40.0), 7) == report.ljust(sent.command_layout.length, b"\0")
        assert sent.telemetry_layout.fields == told.telemetry_layout.fields


@pytest.mark.parametrize(("where", "block"), blocks("toml"))
def test_every_toml_example_is_accepted(where: str, block: str, tmp_path: Path) -> None:
    path = tmp_path / "example.toml"
    path.write_text(block, encoding="utf-8")
    schema = re.search(r'schema = "([^"]+)"', block)
    assert schema, f"{where}: a full example names its schema"
    match schema[1]:
        case "fiohost.target/1":
            TargetProfile.load(path)
        case "fiohost.map/1":
            TableMap.load(path)
        case "fiohost.experiment/1":
            Experiment.load(path)
        case "fiohost.bench/1":
            BenchProfile.load(path)
        case "fiohost.controller/1":
            ControlSettings.load(path)
        case "fiohost.model/1":
            Model.read(path)
        case "fiohost.readings/1":
            read_readings(path)
        case "fiohost.characterisation/1":
            Readings.load(path)
        case "firmware_model.plant/1":
            from firmware_model.plants import load_plant

            load_plant(path)
        case other:
            pytest.fail(f"{where}: unknown schema {other}")


def tool(name: str) -> ModuleType:
    """A script of docs/tools as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "docs" / "tools" / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module  # where its dataclasses look for their module
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize(("name", "page"), [("effects_page", "effects.md"), ("numbers_page", "reference/numbers.md")])
def test_a_page_made_by_a_script_is_what_the_script_makes(name: str, page: str) -> None:
    assert text(page) == tool(name).page(), f"write it anew: python docs/tools/{name}.py"


def test_the_wiring_pictures_are_those_of_their_script() -> None:
    for name, picture in tool("wiring").pictures().items():
        assert (ROOT / "docs" / "images" / name).read_text(encoding="utf-8") == picture, name
        assert f"images/{name}" in text("firmware.md")


def test_the_firmwares_page_begins_with_what_has_met_a_real_board() -> None:
    first = text("firmware.md").splitlines()[2]
    assert first.startswith("**None of this has met a real board.**")


def test_the_query_on_the_page_is_the_one_that_is_sent() -> None:
    section = text("protocol.md").partition("### Who is there")[2]
    assert f"`{QUERY.hex(' ')}`" in section
    assert re.findall(r"^\| 38 \| u16 \| CRC", section, re.MULTILINE)
    assert ANSWER_BYTES == 40


def test_every_signal_and_its_keys_are_documented() -> None:
    rows = dict(re.findall(r"^\| `(\w+)` \| (.+?) \| .+ \|$", text("experiments.md"), re.MULTILINE))
    assert set(rows) == set(KINDS)
    for kind, cells in rows.items():
        keys = {field.name for field in fields(KINDS[kind])} - {"duration_s"}
        assert set(re.findall(r"`(\w+)`", re.sub(r"\(.*?\)", "", cells))) == keys, kind


def shown_commands() -> list[tuple[str, str]]:
    lines = [(where, line[2:]) for where, block in blocks("console") for line in block.splitlines() if line[:2] == "$ "]
    indented = [
        (page.name, line.strip())
        for page in PAGES
        if page.is_file()
        for line in page.read_text(encoding="utf-8").splitlines()
        if line.startswith("    fiohost ")
    ]
    return [(where, line) for where, line in (*lines, *indented) if "fiohost " in line]


@pytest.mark.parametrize(("where", "line"), shown_commands())
def test_every_command_shown_exists_with_its_options(where: str, line: str) -> None:
    name, *words = re.split(r"[;|>]", line.partition("fiohost ")[2])[0].split()
    assert name in COMMANDS, f"{where}: {line}"
    command = cli.get_command(click.Context(cli), name)
    while isinstance(command, click.Group) and words and not words[0].startswith("-"):
        command = command.get_command(click.Context(command), words.pop(0))
    assert command is not None, f"{where}: {line}"
    known = {option for parameter in command.params for option in (*parameter.opts, *parameter.secondary_opts)} | {
        "--help"
    }
    assert {word for word in words if word.startswith("-") and not word[1:2].isdigit()} <= known, f"{where}: {line}"


def test_no_page_shows_a_command_that_was_refused() -> None:
    for page in PAGES:
        for block in re.findall(r"```console\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
            assert not re.search(r"^(fiohost: |Error: |Traceback)", block, re.MULTILINE), f"{page.name}: {block}"


def test_links_between_pages_lead_somewhere() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
            assert (page.parent / target).exists(), f"{page.name}: {target}"
