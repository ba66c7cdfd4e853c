"""The firmware as machine code, in emulators: what the bytes on its line do to the bridge, and what comes back."""

from __future__ import annotations

import random
import struct
from collections.abc import Callable

import pytest
from emulators import BOARDS, DUTY_STEPS, board, chip

from fiohost.transport.profile import TargetProfile
from fiohost.wire.identity import QUERY, find_identity
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command, Telemetry
from fiohost.wire.stream import StreamParser
from firmware_model.bridge import BRAKE, DRIVEN, STANDBY
from firmware_model.emulated.board import EmulatedBoard
from firmware_model.emulated.chip import HIGH
from firmware_model.emulated.wiring import PINS, winding
from firmware_model.encoder import levels_of
from firmware_model.quadrature import Edge

CODEC = TargetProfile.load("serial-framed").codec
IMAGES = [f"{name}-{bridge}" for name in BOARDS for bridge in ("tb6612", "l298n", "drv8833")]
EACH = pytest.mark.parametrize("name", BOARDS)


def readings(data: bytes) -> list[Telemetry]:
    return StreamParser(CODEC.telemetry_layout, CODEC.decode).feed(data)


def told(duty_pct: float, number: int = 0) -> bytes:
    return CODEC.encode(Command.drive(duty_pct), number)


def latch(emulated: EmulatedBoard, data: bytes) -> tuple[int, float]:
    """What the bridge does after the step that took *data*."""
    emulated.step(data)
    emulated.step()
    return emulated.outputs


@EACH
def test_the_first_bytes_are_those_of_the_page(name: str) -> None:
    assert board(name).step().hex(" ") == "a5 5a 00 00 00 00 00 00 00 00 00 9c 0c"


@EACH
def test_the_command_bytes_of_the_page_do_what_it_says(name: str) -> None:
    emulated = board(name)
    for sent, outputs in (
        ("a5 5a 07 00 00 00 20 42 01 00 65 ad", (DRIVEN, 40.0)),
        ("a5 5a 08 00 00 00 48 41 00 01 f6 d2", (DRIVEN, -12.5)),
        ("a5 5a 09 00 00 00 00 00 01 01 d6 67", (BRAKE, 0.0)),
        ("a5 5a ff ff 00 00 00 00 00 00 f1 2c", (STANDBY, 0.0)),
    ):
        assert latch(emulated, bytes.fromhex(sent)) == outputs


@pytest.mark.parametrize("image", IMAGES)
def test_the_bridge_sees_the_truth_table(image: str) -> None:
    """Both signs, both ends of the scale, brake and standby, in both orders; what lies between is truncated."""
    emulated = board(image)
    steps = DUTY_STEPS[image.partition("-")[0]]
    assert emulated.outputs == (BRAKE, 0.0)  # at boot
    rng = random.Random(image)
    duties = [100.0, -100.0, 50.0, -50.0, 100.0 / steps, -100.0 / steps, *(rng.uniform(-100, 100) for _ in range(12))]
    for duty in duties:
        mode, seen = latch(emulated, told(duty))
        wanted = int(abs(Command.drive(duty).duty_pct) * steps / 100) * 100 / steps
        assert (mode, abs(seen), seen > 0) == (DRIVEN, pytest.approx(wanted, abs=1e-12), duty > 0)
        stops = [(BRAKE_COMMAND, BRAKE), (STANDBY_COMMAND, STANDBY)]
        rng.shuffle(stops)
        for command, stopped in stops:
            assert latch(emulated, CODEC.encode(command))[0] == stopped


@pytest.mark.parametrize("image", IMAGES)
def test_a_duty_below_a_step_never_drives(image: str) -> None:
    emulated = board(image)
    mode, duty = latch(emulated, told(50.0 / DUTY_STEPS[image.partition("-")[0]]))
    assert duty == 0.0
    assert mode in (DRIVEN, BRAKE, STANDBY)


@pytest.mark.parametrize("image", IMAGES)
def test_nothing_drives_the_bridge_before_the_lines_say_brake(image: str) -> None:
    name, _, bridge = image.partition("-")
    started = chip(image)
    seen = [winding(started, name, bridge)]
    while seen[-1][0] != BRAKE:
        assert started.time_s < 0.01
        started.run_to(started.time_s + 1e-6)
        seen.append(winding(started, name, bridge))
    assert {mode for mode, _ in seen[:-1]} == {STANDBY}


def test_an_l298n_brakes_with_its_enable_high() -> None:
    for name in BOARDS:
        emulated = board(f"{name}-l298n")
        assert latch(emulated, CODEC.encode(BRAKE_COMMAND)) == (BRAKE, 0.0)
        levels = {line: emulated.chip.output(pin) for line, pin in PINS[name, "l298n"].items()}
        assert {level is not None and level.share for level in levels.values()} == {HIGH.share}


@EACH
def test_pos_wraps_both_ways_and_the_direction_bit_is_of_the_last_edge(name: str) -> None:
    emulated = board(name)
    for sign, jump, direction in ((1, -719, 0), (-1, 719, 1)):
        seen: list[Telemetry] = []
        for k in range(400):
            seen += readings(emulated.step(told(60.0 * sign, k)))
        steps = [b.pos - a.pos for a, b in zip(seen, seen[1:], strict=False)]
        assert {reading.direction for reading in seen[-50:]} == {direction}
        assert min(steps) < -700 if sign > 0 else max(steps) > 700
        assert abs(jump) - max(abs(step) for step in steps) < 20
        assert emulated.motor.count % 720 == pytest.approx(seen[-1].pos, abs=20)


@EACH
def test_the_watchdog_brakes_a_tenth_of_a_second_after_the_last_command(
    name: str, measured: Callable[[str], None]
) -> None:
    waits = []
    for late_s in (0.0, 0.0011, 0.0023, 0.0031, 0.0043):
        emulated = board(name)
        for k in range(30):
            emulated.step(told(50.0, k))
        emulated.run_to(emulated.chip.time_s + late_s)
        emulated.chip.receive(told(70.0))
        arrives_s = emulated.chip.time_s + 12 * 10 / 500e3
        emulated.run_to(arrives_s + 0.006)
        assert emulated.outputs == (DRIVEN, 70.0)
        while emulated.outputs[0] == DRIVEN:
            emulated.run_to(emulated.chip.time_s + 1e-4)
            assert emulated.chip.time_s < arrives_s + 1.0
        assert emulated.outputs == (BRAKE, 0.0)
        waits.append(emulated.chip.time_s - arrives_s)
    measured(f"{name}: braked {1e3 * min(waits):.1f} to {1e3 * max(waits):.1f} ms after the last command")
    assert min(waits) >= 0.100
    assert max(waits) <= 0.110


@EACH
def test_errors_that_last_brake_and_a_query_is_no_command(name: str) -> None:
    """A line that carries only damage, or only questions, is as good as none."""
    damaged = bytes([*told(80.0)[:-1], told(80.0)[-1] ^ 1])
    for what in (damaged, QUERY, told(80.0)[:7], b"\xa5\x5a" * 6):
        emulated = board(name)
        assert latch(emulated, told(80.0)) == (DRIVEN, 80.0)
        for _ in range(22):
            emulated.step(what)
        assert emulated.outputs == (BRAKE, 0.0)
        assert latch(emulated, told(20.0) + told(20.0)) == (DRIVEN, 20.0)


@EACH
def test_after_any_garbage_every_command_is_latched(name: str, measured: Callable[[str], None]) -> None:
    emulated, rng = board(name), random.Random(5)
    whole = told(33.0)
    for junk in (rng.randbytes(200), whole[:5], whole[:-1] + b"\0", b"\xa5" * 30, b"\xa5\x5a" * 20, QUERY[:3]):
        emulated.step(junk)
    emulated.step(bytes(12))  # an unfinished frame may cost the next one; twelve zeros end it
    right = 0
    for k in range(300):
        duty = rng.uniform(1.0, 100.0) * rng.choice((1, -1))
        mode, seen = latch(emulated, rng.randbytes(rng.randrange(0, 9)).replace(b"\xa5", b"") + told(duty, k))
        right += mode == DRIVEN and abs(seen - duty) < 100.0 / DUTY_STEPS[name] + 1e-9
    measured(f"{name}: {right} of 300 commands latched")
    assert right == 300


@EACH
def test_a_line_full_of_garbage_neither_stops_the_task_nor_the_watchdog(name: str) -> None:
    """250 bytes a step is all that 500 kBd can carry."""
    emulated, rng = board(name), random.Random(8)
    assert latch(emulated, told(80.0)) == (DRIVEN, 80.0)
    data = b"".join(emulated.step(rng.randbytes(249)) for _ in range(60))
    ticks = [reading.tick for reading in readings(data)]
    assert len(ticks) >= 58
    assert {round(b - a) for a, b in zip(ticks, ticks[1:], strict=False) if a is not None and b is not None} == {1}
    assert emulated.outputs == (BRAKE, 0.0)


@EACH
@pytest.mark.parametrize("value", [100.1, -1.0, float("nan"), float("inf"), -float("inf")])
def test_a_duty_that_no_host_can_mean_is_dropped(name: str, value: float) -> None:
    layout = CODEC.command_layout
    assert latch(emulated := board(name), told(25.0)) == (DRIVEN, 25.0)
    assert latch(emulated, layout.encode({"sequence": 1, "duty_pct": value, "c3": 1, "c4": 0})) == (DRIVEN, 25.0)
    assert latch(emulated, layout.encode({"sequence": 1, "duty_pct": 5.0, "c3": 2, "c4": 0})) == (DRIVEN, 25.0)


@EACH
def test_of_several_commands_the_newest_counts(name: str) -> None:
    assert latch(board(name), told(10.0, 1) + told(20.0, 2) + told(-30.0, 3)) == (DRIVEN, -30.0)


@pytest.mark.parametrize("image", IMAGES)
def test_the_board_says_who_it_is_without_hiding_a_report(image: str) -> None:
    emulated = board(image)
    heard = [emulated.step(QUERY) for _ in range(3)]
    assert len(readings(b"".join(heard))) == 3
    found = find_identity(heard[1])
    assert found is not None
    profile = TargetProfile.load(found.name)
    assert f"{found.name}-{found.bridge}" == image
    assert (found.duty_steps, found.watchdog_s, found.counts_per_rev, found.sample_time_s) == pytest.approx(
        (profile.duty_steps, profile.watchdog_s, profile.counts_per_rev, profile.sample_time_s)
    )
    assert (found.refused_frames, found.bad_edges) == (0, 0)
    damaged = told(5.0)[:-1] + b"\xff"
    heard_later = [emulated.step(part) for part in (damaged, bytes(12), QUERY, b"", b"")]
    later = find_identity(b"".join(heard_later))
    assert later is not None
    assert later.refused_frames >= 1


def lost(name: str, edges_per_s: float, span_s: float = 0.2) -> int:
    """Counts that a chip lacks of edges at a steady rate, modulo a turn, with a host that talks all the time."""
    started = chip(name)
    started.run_to(0.02)
    count = round(edges_per_s * span_s)
    started.put_edges([Edge(0.02 + (k + 1) / edges_per_s, int(levels_of(k + 1))) for k in range(count)])
    data = b""
    while started.time_s < 0.02 + span_s + 0.02:
        started.receive(told(40.0) + QUERY)
        started.run_to(started.time_s + 0.005)
        data += started.sent()
    return (count - readings(data)[-1].pos + 360) % 720 - 360


def test_the_unos_encoder_counts_above_a_hundred_thousand_edges_a_second(measured: Callable[[str], None]) -> None:
    exact = 0.0
    for rate in (20e3, 60e3, 100e3, 110e3, 120e3, 130e3, 140e3, 150e3, 160e3, 180e3, 200e3):
        if (gone := lost("uno", rate)) != 0:
            break
        exact = rate
    measured(f"uno: every edge counted up to {exact:.0f} a second; at {rate:.0f} {gone} of {0.2 * rate:.0f} lost")
    assert exact >= 100e3


def test_the_blue_pills_encoder_is_a_timer() -> None:
    assert lost("bluepill", 200e3) == 0


def test_the_unos_task_and_its_interrupts_are_short(measured: Callable[[str], None]) -> None:
    emulated = board("uno", "default")
    emulated.chip.stats(anew=True)
    for k in range(200):
        emulated.step(told(90.0 - k / 3, k))
    plain = emulated.chip.stats()["task_cycles"]
    for k in range(200):
        emulated.step(told(90.0 - k / 3, k) + QUERY * (k % 7 == 0))
    stats = emulated.chip.stats()
    task, dark = stats["task_cycles"], stats["dark_cycles"]
    measured(f"uno: task {plain} cycles of 80000 at most, {task} with an answer; interrupts off {dark} at most")
    assert stats["tasks"] >= 400
    assert stats["bytes_overrun"] == 0
    assert stats["task_cycles"] < 8000  # a tenth of the step
    assert stats["dark_cycles"] < 160  # an edge at 100,000 a second


def test_the_blue_pills_task_is_short_and_takes_no_interrupt(measured: Callable[[str], None]) -> None:
    emulated = board("bluepill", "default")
    emulated.chip.count_instructions()
    for k in range(100):
        emulated.step(told(90.0 - k, k) + QUERY * (k % 7 == 0))
    measured(f"bluepill: task {emulated.chip.instructions} instructions at most of a step of 360000 cycles")
    assert 100 < emulated.chip.instructions < 36000
    assert emulated.chip.around.pwm_hz == pytest.approx(20e3)
    assert emulated.chip.around.core_hz == pytest.approx(72e6)


def test_a_blue_pill_whose_program_hangs_starts_anew_and_brakes() -> None:
    emulated = board("bluepill")
    assert latch(emulated, told(80.0)) == (DRIVEN, 80.0)
    emulated.chip.around.core[0x10] = 0  # as if the steps had stopped: nobody feeds the watchdog
    emulated.chip.around._tick_at = float("inf")
    emulated.run_to(emulated.chip.time_s + 0.15)
    assert emulated.chip.resets == 1
    assert emulated.outputs == (BRAKE, 0.0)


def test_the_telemetry_tick_counts_steps() -> None:
    for name in BOARDS:
        emulated = board(name)
        data = b"".join(emulated.step() for _ in range(50))
        assert [struct.unpack_from("<HI", data, 13 * k + 2) for k in range(50)] == [(k, k) for k in range(50)]
