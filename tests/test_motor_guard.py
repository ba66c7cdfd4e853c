"""A motor that does not follow is braked, and it is said which way it does not."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from boards import WatchedTransport, bench_on
from click.testing import CliRunner
from lines import PtyBoard

from fiohost.bench.guard import MotorGuard
from fiohost.bench.log import Log
from fiohost.bench.loop import Bench
from fiohost.cli.main import cli
from fiohost.errors import ConfigError, FiohostError, GuardError
from fiohost.transport.profile import Guards, TargetProfile
from fiohost.wire.messages import Command

STATIONARY = bytes.fromhex("00 0500")


def frozen(k: int, report: bytes) -> bytes:
    return STATIONARY.ljust(64, b"\0")


def mirrored(k: int, report: bytes) -> bytes:
    """As with the motor's wires or the encoder's channels swapped."""
    pos = int.from_bytes(report[1:3], "little")
    return bytes([1 - report[0]]) + ((720 - pos) % 720).to_bytes(2, "little") + report[3:]


def scattered(k: int, report: bytes) -> bytes:
    rng = random.Random(k)
    return report[:1] + rng.randrange(720).to_bytes(2, "little") + report[3:] if k > 60 else report


@pytest.mark.parametrize(
    ("wrong", "said", "within_s"),
    [
        (frozen, "the shaft stands though the motor is driven with 100 %", 3.1),
        (mirrored, "the shaft turns against the command", 1.0),
        (scattered, "the encoder says things that cannot be", 0.5),
    ],
)
def test_a_motor_that_does_not_follow_is_braked_and_named(
    wrong: object, said: str, within_s: float, tmp_path: Path
) -> None:
    transport = WatchedTransport(on_receive=wrong)  # type: ignore[arg-type]
    with bench_on(transport) as bench:
        with pytest.raises(GuardError, match=said):
            bench.drive(100.0, 6.0, tmp_path / "run.csv")
        assert transport.braked
    log = Log.read(tmp_path / "run.csv")
    assert log.metadata["ending"].startswith("stopped: GuardError")
    assert log.time_s[-1] < within_s


@pytest.mark.parametrize("command", [["manual", "--pwm", "100", "--duration", "6", "--fast"], ["run", "step.toml"],
                                     ["deadband", "--plot", "d.png"], ["lab", "manual"]])  # fmt: skip
def test_every_command_that_drives_has_the_guard(
    command: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("step.toml").write_text(
        'schema = "fiohost.experiment/1"\n[[command]]\nkind = "constant"\nlevel_pct = 100.0\nduration_s = 6.0\n'
    )
    monkeypatch.setitem(
        __import__("fiohost.bench.connect", fromlist=["_MEDIA"])._MEDIA, "sim",
        lambda *a: WatchedTransport(on_receive=scattered),
    )  # fmt: skip
    done = CliRunner().invoke(cli, command)
    assert done.exit_code == 1
    assert "the encoder says things that cannot be" in done.stderr or "turns against the duty" in done.stderr


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (frozen, "the shaft stood for the whole run though the motor was driven with 20 % and more"),
        (mirrored, "the shaft turns against the command"),
        (scattered, "the encoder says things that cannot be"),
    ],
)
def test_a_lab_ends_where_the_motor_does_not_follow(
    wrong: object, said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its runs are too short for a shaft that stands to be taken for a stalled one."""
    monkeypatch.chdir(tmp_path)
    made: list[WatchedTransport] = []

    def open_it(*_: object) -> WatchedTransport:
        made.append(WatchedTransport(on_receive=wrong))  # type: ignore[arg-type]
        return made[-1]

    monkeypatch.setitem(__import__("fiohost.bench.connect", fromlist=["_MEDIA"])._MEDIA, "sim", open_it)
    done = CliRunner().invoke(cli, ["lab", "speed-control", "--gains", "0.5", "--refs", "12", "--no-diagnose"])
    assert done.exit_code == 1
    assert said in done.stderr
    assert made[-1].braked


def test_a_stall_is_judged_by_its_heat() -> None:
    """Half the duty may last four times as long, and what moves begins anew."""

    def seconds(duty_pct: float, move_every: int = 0, patience: float = 1.0, every: int = 1) -> float:
        guard = MotorGuard(Guards(), 0.005, 720, patience)
        angle = 0.0
        for k in range(0, 100_000, every):
            if move_every and k % move_every == 0:
                angle += 3.0
            try:
                guard.check(k, Command.drive(duty_pct), angle)
            except GuardError:
                return k * 0.005
        return float("inf")

    assert seconds(100.0) == pytest.approx(3.0, abs=0.02)
    assert seconds(100.0, every=7) == pytest.approx(3.0, abs=0.04)  # the host missed the others, the motor did not
    assert seconds(-50.0) == pytest.approx(12.0, abs=0.02)
    assert seconds(5.0) == float("inf")  # 20 minutes
    assert seconds(100.0, move_every=400) == float("inf")
    assert seconds(100.0, patience=10.0) == pytest.approx(30.0, abs=0.02)


def test_pulses_on_a_shaft_that_stands_add_up() -> None:
    """Half a second of full duty, then a rest: no pulse is a stall by itself."""

    def pulses(rest_s: float) -> int:
        guard = MotorGuard(Guards(), 0.005, 720)
        for k in range(20_000):
            n, since_s = divmod(k * 0.005, 0.5 + rest_s)
            try:
                guard.check(k, Command.drive(100.0 if since_s < 0.5 else 0.0), 0.0)
            except GuardError:
                return int(n) + 1
        return 0

    assert pulses(0.05) == 7
    assert pulses(2.0) == 10
    assert pulses(6.0) == 0  # it cools in between


def test_half_a_turn_that_nobody_saw_is_no_turn_against_the_command() -> None:
    """Readings 0.4 s apart of a shaft at 500 deg/s look like 160 deg back, again and again."""
    guard, command, angle = MotorGuard(Guards(), 0.005, 720), Command.drive(40.0), 0.0
    ticks = [k for begin in range(0, 800, 100) for k in range(begin, begin + 20)]
    for before, k in zip([0, *ticks], ticks, strict=False):
        turned = 2.5 * (k - before)
        angle += (turned + 180.0) % 360.0 - 180.0
        guard.check(k, command, angle)

    def turns_back() -> None:
        for step in range(1, 200):
            guard.check(k + step, command, angle - 2.5 * step)

    with pytest.raises(GuardError, match="against the command"):
        turns_back()


def test_a_reversal_at_full_speed_and_single_damaged_readings_are_no_faults(tmp_path: Path) -> None:
    """A heavy shaft runs on against its new command, ever slower; a report in a hundred has a wrong count."""
    (tmp_path / "heavy.toml").write_text(
        Path(__file__).parent.parent.joinpath("configs/plants/default.toml").read_text().replace(
            "J_kgm2 = 3.07e-3", "J_kgm2 = 3.07e-2")
    )  # fmt: skip

    def damaged(k: int, report: bytes) -> bytes:
        return scattered(k, report) if k % 100 == 0 else report

    transport = WatchedTransport(str(tmp_path / "heavy.toml"), on_receive=damaged)
    with bench_on(transport) as bench:
        from fiohost.bench.program import OpenLoop

        ways = [100.0] * 600 + [-100.0] * 600 + [100.0] * 600
        assert len(bench.play(OpenLoop([Command.drive(duty) for duty in ways]))) == 1800


def test_thresholds_are_in_the_target_and_on_the_command_line(tmp_path: Path) -> None:
    profile = TargetProfile.load()
    with Bench(WatchedTransport(on_receive=frozen), profile) as bench, pytest.raises(GuardError):
        bench.drive(100.0, 6.0)
    text = profile.text.replace("[command]", "[guards]\nstall_s = 100.0\n\n[command]", 1)
    with Bench(WatchedTransport(on_receive=frozen), TargetProfile.parse(text, "mine")) as bench:
        assert len(bench.drive(100.0, 6.0)) == 1200
    done = CliRunner().invoke(cli, ["manual", "--pwm", "40", "--duration", "1", "--fast", "--guard", "speed_deg_s=10"])
    assert done.exit_code == 1
    assert "beyond guards.speed_deg_s = 10" in done.stderr
    for wrong in ("stall_s=-1", "stal_s=3", "stall_s=nan"):
        assert CliRunner().invoke(cli, ["run", "sine_slow", "--guard", wrong]).exit_code == 1
    with pytest.raises(ConfigError, match="stall_s"):
        Guards().changed({"stall_s": -1.0})


def test_the_guard_is_there_on_a_real_line() -> None:
    with PtyBoard(mangle=lambda k, packet: packet[:3] + b"\x05\0" + packet[5:]) as board, board.bench() as bench:
        bench.profile.guards.changed({})
        with pytest.raises(FiohostError, match="the shaft stands"):
            bench.drive(100.0, 20.0)
