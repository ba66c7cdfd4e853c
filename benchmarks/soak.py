"""Hours of runs with everything going wrong: is memory flat, every log whole, the motor always braked?

    python benchmarks/soak.py --simulated-hours 8
    python benchmarks/soak.py --real-minutes 30

Simulated: random programs on sealed boards with faults of line and clock, in this process, in virtual time. Real: a
host in a process of its own on a board on a pty, in real time, ended each time in another way. Prints tables of counts.
"""

from __future__ import annotations

import argparse
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT / "tests"), str(ROOT)]

from boards import WatchedTransport  # noqa: E402
from lines import PtyBoard  # noqa: E402

from fiohost.bench.connect import connect  # noqa: E402
from fiohost.bench.integrity import ALTERED, CUT_OFF, WHOLE, judge  # noqa: E402
from fiohost.bench.loop import Bench  # noqa: E402
from fiohost.bench.program import OpenLoop  # noqa: E402
from fiohost.errors import FiohostError  # noqa: E402
from fiohost.transport.profile import TargetProfile  # noqa: E402
from fiohost.wire.messages import BRAKE_COMMAND, STANDBY_COMMAND, Command  # noqa: E402

BRAKE = (0, 1, 1)
RUN_TICKS = 12_000  # a minute
WAIT_S = 30.0


def memory_mb() -> float:
    """Resident now."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def simulated(hours: float, rng: random.Random, folder: Path) -> Counter[str]:
    counts: Counter[str] = Counter()
    left, first_mb = hours * 3600.0, 0.0
    while left > 0.0:
        counts["runs"] += 1
        path = folder / "run.csv"
        path.unlink(missing_ok=True)
        program = OpenLoop(_commands(rng))
        ended = "complete"
        try:
            if rng.random() < 0.5:
                bench: Bench = connect("sim:sealed-faulty", seed=rng.randrange(2**31))
                watched = None
            else:
                watched = WatchedTransport(on_receive=_mishap(rng, counts))
                bench = Bench(watched, TargetProfile.load())
            with bench:
                bench.play(program, path)
        except FiohostError as exc:
            ended = type(exc).__name__
        except OSError:
            ended = "OSError"
        counts[f"ended: {ended}"] += 1
        if watched is not None and not watched.braked:
            counts["NOT BRAKED"] += 1
        state = judge(path.read_bytes()).state if path.exists() else "no log"
        counts[f"log {state}"] += 1
        rows = max(0, path.read_bytes().count(b"\n") - 20) if path.exists() else 0
        left -= 0.005 * max(rows, 100)
        counts["simulated seconds"] += round(0.005 * max(rows, 100))
        if counts["runs"] == 30:
            first_mb = memory_mb()
    counts["memory after 30 runs, MB"] = round(first_mb)
    counts["memory at the end, MB"] = round(memory_mb())
    return counts


def _commands(rng: random.Random) -> list[Command]:
    made: list[Command] = []
    while len(made) < RUN_TICKS:
        duty = rng.uniform(-100.0, 100.0)
        kind = rng.choice([Command.drive(duty), Command.drive(duty), BRAKE_COMMAND, STANDBY_COMMAND])
        made += [kind] * rng.randrange(20, 400)
    return made[:RUN_TICKS]


def _mishap(rng: random.Random, counts: Counter[str]):  # type: ignore[no-untyped-def]
    """What telemetry becomes from some tick on."""
    at, kind = rng.randrange(200, 2 * RUN_TICKS), rng.choice(["garbage", "silence", "frozen", "exception"])
    counts[f"mishap: {kind}"] += 1
    frozen: list[bytes] = []

    def receive(k: int, report: bytes) -> bytes:
        if k < at:
            return report
        if kind == "garbage":
            return rng.randbytes(64)
        if kind == "frozen":
            frozen[:] = frozen or [report]
            return frozen[0]
        if kind == "exception":
            raise OSError("the reader died")
        return b""

    return receive


def real(minutes: float, rng: random.Random, folder: Path) -> Counter[str]:
    counts: Counter[str] = Counter()
    end_s, first_mb = time.monotonic() + 60.0 * minutes, 0.0
    while time.monotonic() < end_s:
        counts["runs"] += 1
        _one_real(rng, folder / f"run{counts['runs']}.csv", counts)
        if counts["runs"] == 5:
            first_mb = memory_mb()
    counts["memory after 5 runs, MB"] = round(first_mb)
    counts["memory at the end, MB"] = round(memory_mb())
    return counts


def _one_real(rng: random.Random, log: Path, counts: Counter[str]) -> None:
    way = rng.choice(["SIGKILL", "SIGSTOP", "SIGTERM", "SIGINT", "SIGSEGV", "unplug", "garbage", "stall", "complete"])
    counts[f"way: {way}"] += 1
    wrong = [False]

    def mangle(k: int, packet: bytes) -> bytes:
        if wrong[0]:
            return rng.randbytes(7) if way == "garbage" else packet[:3] + b"\x05\0" + packet[5:]
        return packet

    duty = "100" if way == "stall" else str(rng.randrange(20, 100))
    with PtyBoard(mangle=mangle) as board:
        command = [sys.executable, "-m", "fiohost", "manual", "--pwm", duty, "--target", f"serial:{board.target}"]
        command += ["--log", str(log), "--guard", "late_pct=100", "--guard", "gap_s=0.3", "--guard", "stall_s=1"]
        command += ["--duration", "3"] if way == "complete" else []
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        host = subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        try:
            _wait(lambda: sum(c.compare > 0 for c in list(board.commands)) > 100 or host.poll() is not None)
            time.sleep(rng.uniform(0.0, 2.0))
            if way.startswith("SIG"):
                with suppress(ProcessLookupError):
                    host.send_signal(getattr(signal, way))
            elif way == "unplug":
                board.hang_up()
            wrong[0] = way in ("garbage", "stall")
            if way != "unplug" and not _wait(lambda: board.braked):
                counts["NOT BRAKED"] += 1
            if way == "SIGSTOP":
                host.send_signal(signal.SIGCONT)
            try:
                counts[f"exit {host.wait(WAIT_S)}"] += 1
            except subprocess.TimeoutExpired:
                counts["DID NOT END"] += 1
        finally:
            host.kill()
            host.wait()
    state = judge(log.read_bytes()).state if log.exists() else "no log"
    counts[f"log {state}"] += 1
    if state == ALTERED or (state == CUT_OFF and way not in ("SIGKILL", "SIGSEGV")):
        counts["LOG NOT AS IT SHOULD BE"] += 1
    if state == WHOLE and way in ("SIGKILL", "SIGSEGV"):
        counts["ended before it was killed"] += 1
    log.unlink(missing_ok=True)


def _wait(what) -> bool:  # type: ignore[no-untyped-def]
    deadline_s = time.monotonic() + WAIT_S
    while not what():
        if time.monotonic() > deadline_s:
            return False
        time.sleep(0.005)
    return True


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--simulated-hours", type=float, default=0.0, metavar="H")
    parser.add_argument("--real-minutes", type=float, default=0.0, metavar="M")
    parser.add_argument("--seed", type=int, default=1)
    asked = parser.parse_args()
    signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background of a shell it is ignored, by hosts too
    rng = random.Random(asked.seed)
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for what, counts in (
            ("simulated", simulated(asked.simulated_hours, rng, Path(folder)) if asked.simulated_hours else None),
            ("real", real(asked.real_minutes, rng, Path(folder)) if asked.real_minutes else None),
        ):
            if counts is None:
                continue
            print(f"\n| {what} | count |\n|---|---|")
            for name in sorted(counts, key=str.lower):
                print(f"| {name} | {counts[name]} |")
                bad += name.isupper() and counts[name]
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
