"""What the doctor finds on benches that have something wrong, and what devices and udev say."""

from __future__ import annotations

import json
import struct
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
from boards import WatchedTransport, bench_on
from click.testing import CliRunner
from lines import FakeHidapi, PtyBoard, info

from fiohost.bench.connect import connect
from fiohost.bench.doctor import PROBLEM, Finding, signs, timing
from fiohost.cli.main import cli
from fiohost.transport import discovery, serial
from fiohost.transport.hid_modules import Backend
from fiohost.transport.simulated import SimulatedTransport


def problems(findings: list[Finding]) -> str:
    return " | ".join(finding.what for finding in findings if finding.level == PROBLEM)


class Rewired(SimulatedTransport):
    """The simulated board with its wires changed: *command* and *telemetry* are done to the bytes."""

    def __init__(self, command: Callable[[bytes], bytes] = bytes, telemetry: Callable[[bytes], bytes] = bytes) -> None:
        inner = WatchedTransport()
        step = inner._step

        def rewired(report: bytes | None) -> bytes:
            sent = step(report if report is None else command(report))
            assert isinstance(sent, bytes)
            return telemetry(sent)

        super().__init__(rewired, "sim", "simulated")


def _swap_bits(report: bytes) -> bytes:
    return report[:4] + report[5:6] + report[4:5] + report[6:]


def _count_backwards(report: bytes) -> bytes:
    down, pos = struct.unpack_from("<BH", report)
    return struct.pack("<BH", 1 - down, -pos % 720) + report[3:]


def _same_way(report: bytes) -> bytes:
    return report if report[4] == report[5] else report[:4] + b"\x01\x00" + report[6:]


def _dead_c3(report: bytes) -> bytes:
    return report[:4] + b"\x00" + report[5:]


def _turned_bit(report: bytes) -> bytes:
    return bytes([1 - report[0]]) + report[1:]


def test_a_sound_bench_has_no_problem_and_is_moved_a_little_only() -> None:
    board = WatchedTransport()
    findings = list(signs(bench_on(board), 40.0))
    assert problems(findings) == ""
    assert len(findings) == 3
    assert max(struct.unpack_from("<f", report)[0] for report in board.sent) <= 20.0
    assert board.braked


@pytest.mark.parametrize(
    ("board", "said"),
    [
        (Rewired(_swap_bits), "makes the encoder count down"),
        (Rewired(telemetry=_count_backwards), "makes the encoder count down"),
        (Rewired(_same_way), "turns the same way"),
        (Rewired(_dead_c3), "does not move forward"),
        (Rewired(lambda report: bytes(64)), "does not move within 40 % of duty, in either direction"),
        (Rewired(telemetry=_turned_bit), "direction bit says the opposite"),
    ],
)
def test_wrong_wires_are_named(board: Rewired, said: str) -> None:
    findings = list(signs(bench_on(board), 40.0))
    assert said in problems(findings)
    assert all(finding.cure for finding in findings if finding.level == PROBLEM)


def test_pulses_below_a_slew_limit_accuse_no_wire() -> None:
    with connect("sim", limits={"slew_pct_per_s": 10.0, "run_time_s": 0.5}) as bench:
        assert len(timing(bench, 2.0).answer_ms) == 100  # and the run time holds
        (finding,) = signs(bench, 40.0)
    assert "does not move within 2 % of duty" in finding.what
    assert finding.cure.startswith("the target's slew limit lets a short pulse reach no more")


def test_timing_keeps_the_motor_braked_and_counts_each_tick() -> None:
    board = WatchedTransport()
    found = timing(bench_on(board), 1.0)
    assert len(found.answer_ms) == 200
    assert all(report[:6] == bytes.fromhex("00 00 00 00 01 01") for report in board.sent)
    assert found.achievable_hz > 0.0


PATIENT = ["--guard", "gap_s=20", "--guard", "late_pct=100", "--guard", "silence_s=10"]  # a busy machine


def test_the_doctor_looks_at_a_real_line(tmp_path: Path) -> None:
    with PtyBoard() as board:
        target, json_file = f"serial:{board.target}", tmp_path / "doctor.json"
        answer = CliRunner().invoke(
            cli, ["doctor", "--target", target, "--seconds", "0.5", "--json", str(json_file), *PATIENT]
        )
    found = json.loads(json_file.read_text())
    said = [finding["what"] for finding in found["findings"]]
    assert any(f"{target} opened" in what for what in said)
    assert any("no watchdog" in what for what in said)
    assert any("were not tried" in what for what in said)
    assert all(tuple(command) == (0, 1, 1) for command in board.commands)
    interval = found["timing"]["interval_ms"]
    assert sum(interval["histogram"]["counts"]) > 20
    assert "from report to answer" in answer.output


def test_a_target_that_does_not_open_is_a_finding_and_exit_code_1() -> None:
    answer = CliRunner().invoke(cli, ["doctor", "--target", "serial:/dev/ttyNOPE"])
    assert answer.exit_code == 1
    assert "PROBLEM  there is no serial port /dev/ttyNOPE" in answer.output


@pytest.fixture
def _connected(monkeypatch: pytest.MonkeyPatch) -> None:
    board = info("1-2:1.0", "A1", manufacturer_string="maker")
    module = FakeHidapi(info("3-1:1.0", "M", vendor_id=0x1234, product_id=1, product_string="mouse"), board)
    backends = [Backend("hidraw", module), Backend("libusb", module)]
    monkeypatch.setattr(discovery, "find_backends", lambda: (backends, []))
    port = SimpleNamespace(device="/dev/ttyNOPE", vid=0x0483, pid=0x5740, serial_number="S", description="STM32")
    monkeypatch.setattr(serial, "usb_ports", lambda: [port])


@pytest.mark.usefixtures("_connected")
def test_devices_are_listed_as_targets_once_each(tmp_path: Path) -> None:
    answer = CliRunner().invoke(cli, ["devices", "--json", str(tmp_path / "d.json")])
    assert answer.exit_code == 0
    assert "hid:A1\n    0483:5750:A1 maker board; profiles hid-assumed, hid-framed" in answer.output
    assert "serial:/dev/ttyNOPE" in answer.output
    assert "is gone" in answer.output
    assert "mouse" not in answer.output
    found = json.loads((tmp_path / "d.json").read_text())["devices"]
    assert [one["target"] for one in found] == ["hid:A1", "serial:/dev/ttyNOPE"]
    assert "hid:3-1:1.0" in CliRunner().invoke(cli, ["devices", "--all"]).output


def test_udev_rules_are_made_of_the_profiles(tmp_path: Path) -> None:
    profile = Path("configs/targets/hid-assumed.toml").read_text().replace("0x5750", "0xAB1C")
    (tmp_path / "mine.toml").write_text(profile)
    answer = CliRunner().invoke(cli, ["udev", str(tmp_path / "mine.toml"), "--group", "bench"])
    assert answer.exit_code == 0
    rules = [line for line in answer.output.splitlines() if line and not line.startswith("#")]
    assert len(rules) == 6
    assert all('TAG+="uaccess"' in rule and 'GROUP="bench"' in rule for rule in rules)
    assert sum('KERNEL=="hidraw*", KERNELS=="*:0483:5750.*"' in rule for rule in rules) == 1
    assert sum('KERNELS=="*:0483:AB1C.*"' in rule for rule in rules) == 1
    assert sum('SUBSYSTEM=="usb"' in rule and 'ATTR{idProduct}=="ab1c"' in rule for rule in rules) == 1
    assert sum('SUBSYSTEM=="tty"' in rule and 'ATTRS{idProduct}=="ab1c"' in rule for rule in rules) == 1
    assert "usermod -aG bench" in answer.output
    assert CliRunner().invoke(cli, ["udev", "--group", 'x" RUN+="']).exit_code == 1
