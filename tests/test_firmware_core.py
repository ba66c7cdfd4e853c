"""The firmware's core on this computer, under ASan and UBSan; its images; its sketch."""

from __future__ import annotations

import importlib.util
import math
import random
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest
from emulators import absent, board, needed
from places import ROOT

from fiohost.boards.sketch import write_sketch
from fiohost.transport.profile import TargetProfile
from fiohost.wire.identity import ANSWER_BYTES, QUERY, find_identity
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command
from firmware_model.bridge import BRAKE, DRIVEN, STANDBY
from firmware_model.emulated import wiring
from firmware_model.emulated.chip import Level
from firmware_model.encoder import decode
from firmware_model.report import compare_value

CODEC = TargetProfile.load("serial-framed").codec
STEPS = (8, 36)
ARDUINO = Path("/usr/share/arduino/hardware/arduino/avr")


@pytest.fixture(scope="module")
def fuzz() -> ModuleType:
    needed("cc", "make")
    spec = importlib.util.spec_from_file_location("firmware_fuzz", ROOT / "benchmarks" / "firmware_fuzz.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_core_and_python_say_the_same_of_every_frame(fuzz: ModuleType) -> None:
    seen = fuzz.compare(250_000, seed=7)
    assert seen["bytes"] >= 500_000
    assert seen["commands"] > 10_000
    assert seen["queries"] > 3_000


@pytest.mark.parametrize("steps", STEPS)
def test_a_duty_is_truncated_as_the_simulated_board_does(fuzz: ModuleType, steps: int) -> None:
    rng = random.Random(steps)
    duties = [k / steps for k in range(100 * steps + 1)] + [rng.uniform(0, 100) for _ in range(2000)]
    bits = [struct.unpack("<I", struct.pack("<f", duty))[0] for duty in duties]
    near = [one + off for one in bits for off in (-1, 0, 1) if one + off >= 0]  # and the floats beside it
    values = [x for one in near if 0.0 <= (x := struct.unpack("<f", struct.pack("<I", one))[0]) <= 100.0]
    values += [1e-40, 1e-20, 0.0, -0.0]
    stream = b"".join(CODEC.command_layout.encode({"sequence": 0, "duty_pct": x, "c3": 1, "c4": 0}) for x in values)
    said = [line.split()[2] for line in fuzz.run(fuzz.built(steps), stream) if line[0] == "C"]
    assert said == [str(compare_value(x, 100 * steps)) for x in values]


def lines_of(fuzz: ModuleType, bridge: str, command: bytes) -> dict[str, Level]:
    """Lines of the bridge after a task step that took *command*."""
    said = [line for line in fuzz.run(fuzz.built(8, bridge), command, str(len(command))) if line[0] == "L"]
    in1, in2, pwm = (Level(int(number), 800) for number in said[0].split()[1:])
    return {"in1": in1, "in2": in2, "pwm": pwm, "en": pwm, "stby": Level(1, 1), "sleep": Level(1, 1)}


@pytest.mark.parametrize("bridge", ["tb6612", "l298n", "drv8833"])
def test_the_truth_table_is_what_the_bridges_datasheet_wants(fuzz: ModuleType, bridge: str) -> None:
    winding = wiring._OF[bridge]
    for duty in (100.0, 40.0, -40.0, -100.0):
        assert winding(lines_of(fuzz, bridge, CODEC.encode(Command.drive(duty)))) == (DRIVEN, duty)
    assert winding(lines_of(fuzz, bridge, CODEC.encode(BRAKE_COMMAND))) == (BRAKE, 0.0)
    assert winding(lines_of(fuzz, bridge, CODEC.encode(STANDBY_COMMAND))) == (STANDBY, 0.0)
    assert winding(lines_of(fuzz, bridge, bytes(12))) == (BRAKE, 0.0)  # at boot, nothing said


def test_the_watchdog_brakes_at_its_step_and_not_before(fuzz: ModuleType) -> None:
    stream = CODEC.encode(Command.drive(50.0)) + bytes(12 * 40)
    said = [line for line in fuzz.run(fuzz.built(8), stream, "12") if line[0] == "L"]
    assert said[:20] == ["L 800 0 400"] * 20
    assert said[20:] == ["L 800 800 800"] * 21


def test_reports_and_answers_are_those_that_the_host_reads(fuzz: ModuleType) -> None:
    stream = QUERY + bytes(8) + bytes(12 * 3)
    told = [bytes.fromhex(line[2:]) for line in fuzz.run(fuzz.built(36), stream, "12") if line[0] == "R"]
    assert [len(one) for one in told] == [13 + ANSWER_BYTES, 13, 13, 13]
    assert [tuple(CODEC.decode(one[:13])) for one in told] == [(k % 2, k, k, k) for k in range(4)]
    found = find_identity(told[0])
    assert found is not None
    assert (found.name, found.bridge, found.duty_steps, found.bad_edges) == ("host", "tb6612", 3600, 7)
    assert math.isclose(found.watchdog_s, 0.1)


def test_the_decoder_counts_as_the_simulated_one(fuzz: ModuleType) -> None:
    said = [int(line[2:]) for line in fuzz.run(fuzz.built(8), b"") if line[0] == "D"]
    wanted = [decode(change >> 2, change & 3) for change in range(16)]
    assert said == [2 if invalid else count for count, invalid in wanted]


# ---- images and sketch ----------------------------------------------------------------------------------------------


def test_the_images_are_what_the_sources_make(measured: Callable[[str], None]) -> None:
    needed("make", "avr-gcc", "arm-none-eabi-gcc")
    done = subprocess.run(["make", "-s", "-C", str(ROOT / "firmware"), "check"], capture_output=True, text=True)
    measured("\n".join(["firmware", *done.stdout.splitlines(), *done.stderr.splitlines()]))
    assert done.returncode == 0
    assert "12 files, each the same byte for byte" in done.stdout


def test_the_sketch_builds_as_the_arduino_ide_builds_it_and_speaks(tmp_path: Path) -> None:
    """All files of one folder, the .ino as C++ behind Arduino.h, linked with the Arduino core as a library."""
    needed("avr-gcc", "avr-g++", "avr-ar", "avr-objcopy")
    if not (ARDUINO / "cores" / "arduino" / "main.cpp").is_file():
        absent(f"no Arduino core in {ARDUINO} (apt-get install arduino-core-avr)")
    folder = write_sketch(tmp_path)
    core, standard = ARDUINO / "cores" / "arduino", ARDUINO / "variants" / "standard"
    (tmp_path / "fiohost_uno.ino.cpp").write_text("#include <Arduino.h>\n" + (folder / "fiohost_uno.ino").read_text())
    flags = ["-c", "-g", "-Os", "-w", "-ffunction-sections", "-fdata-sections", "-mmcu=atmega328p", "-DF_CPU=16000000L"]
    flags += ["-DARDUINO=10819", "-DDECIMAL_DIG=__DECIMAL_DIG__", f"-I{core}", f"-I{standard}"]
    objects, library = [], []
    for path in [*folder.glob("*.c"), tmp_path / "fiohost_uno.ino.cpp", *core.glob("*.c"), *core.glob("*.cpp")]:
        to = tmp_path / f"{path.parent.name}-{path.name}.o"
        compiler = ["avr-gcc", "-std=gnu11"] if path.suffix == ".c" else ["avr-g++", "-std=gnu++11", "-fno-exceptions"]
        subprocess.run([*compiler, *flags, str(path), "-o", str(to)], check=True)
        (library if path.parent == core else objects).append(str(to))
    subprocess.run(["avr-ar", "rcs", str(tmp_path / "core.a"), *library], check=True)
    link = ["avr-gcc", "-w", "-Os", "-g", "-Wl,--gc-sections", "-mmcu=atmega328p", "-o", str(tmp_path / "sketch.elf")]
    subprocess.run([*link, *objects, str(tmp_path / "core.a"), "-lm"], check=True)
    image = tmp_path / "sketch.hex"
    subprocess.run(["avr-objcopy", "-O", "ihex", "-R", ".eeprom", str(tmp_path / "sketch.elf"), str(image)], check=True)
    sketched = board("uno", image=image)
    assert sketched.step().hex(" ") == "a5 5a 00 00 00 00 00 00 00 00 00 9c 0c"
    sketched.step(CODEC.encode(Command.drive(-25.0)))
    sketched.step()
    assert sketched.outputs == (DRIVEN, -25.0)
