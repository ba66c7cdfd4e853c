"""What goes wrong on a line, and what is found when a cable is plugged in: steps with the gadget's plug in hand."""

from __future__ import annotations

import os
import signal
import stat
import subprocess
import time
from pathlib import Path

from children import Child, check
from ends import (
    WORK,
    Line,
    counts_between,
    fiohost,
    first_gone_s,
    framed_pos,
    read_log,
    row_count,
    watch,
)
from ordinary import CLOSED_LOOP
from plug import replug

from firmware_model import gadget

GATE_S = 1.0  # an emulated clock is rough; 0.1 s is aimed at
WATCHDOG_S = 0.1
STEP_S = 0.005
OPENINGS = 4
STALE_STEPS = 4.0
UDEVADM = "/run/bin/udevadm"
RULES = Path("/run/udev/rules.d/70-fiohost.rules")
TTY = Path("/dev/ttyACM0")


def _running(line: Line, name: str, *options: str) -> tuple[Child, Path, Path]:
    """A run that has got going, its log and its trace."""
    log, trace = WORK / f"{name}.csv", WORK / f"{name}.jsonl"
    log.unlink(missing_ok=True)
    trace.unlink(missing_ok=True)
    child = fiohost(line, "run", str(CLOSED_LOOP), "--log", str(log), "--trace", str(trace), *options)
    child.wait_for(lambda: row_count(log) >= 300, 60.0, "300 rows")
    return child, log, trace


def unplugged(line: Line) -> tuple[Child, str]:
    child, path, trace = _running(line, "unplugged")
    began_s, began_clock_s = time.monotonic(), time.time()
    gadget.unplug()
    child.wait()
    replug()
    check(child.code == 1, f"exit {child.code}: {child.said()[-300:]}")
    said = child.wait_line("MOTOR MAY BE RUNNING") - began_s
    noticed = first_gone_s(trace) - began_clock_s
    log = read_log(path)
    check(log.head["ending"].startswith("stopped: DisconnectedError"), f"the log's ending is {log.head['ending']!r}")
    check("tick_statistics" in log.head and len(log.rows) >= 300, "the log is not complete")
    check(noticed < GATE_S and said < GATE_S, f"noticed after {noticed:.3f} s, said after {said:.3f} s")
    times = f"noticed within {1e3 * noticed:.0f} ms, said after {1e3 * said:.0f} ms"
    return child, f"{times}; log complete, {len(log.rows)} rows"


def reconnected(line: Line) -> tuple[Child, str]:
    child, path, _ = _running(line, "reconnected", "--reconnect", "30")
    gadget.unplug()
    child.wait_line("waiting for the board to come back")
    time.sleep(1.0)
    plugged_s = time.monotonic()
    replug()
    check(child.wait() == 1, f"exit {child.code}: {child.said()[-300:]}")
    back = child.wait_line("braked first of all") - plugged_s
    log = read_log(path)
    check(log.head["ending"].startswith("stopped: DisconnectedError"), f"the log's ending is {log.head['ending']!r}")
    (WORK / "rest.csv").unlink(missing_ok=True)
    probe = fiohost(line, "manual", "--pwm", "0", "--duration", "0.3", "--log", str(WORK / "rest.csv"))
    check(probe.wait() == 0, f"after the reconnection: {probe.said()[-300:]}")
    rest = read_log(WORK / "rest.csv").rows
    check(rest[0]["pos"] == rest[-1]["pos"], "the shaft does not rest")
    return child, f"back, and braked first of all, {back:.1f} s after the plug went in"


def fresh(line: Line) -> tuple[None, str]:
    """What is read first after an opening, and after the host was held up, is new by the board's own tick."""
    import hid

    from fiohost.transport.hid import HidTransport
    from fiohost.transport.hid_modules import Backend

    def reading(transport: HidTransport) -> tuple[float, int]:
        """(task steps by the clock, by the board's tick)"""
        report = transport.receive(1.0)
        return time.monotonic() / STEP_S, int.from_bytes(report[4:8], "little")

    def older(first: tuple[float, int], second: tuple[float, int]) -> float:
        """How many steps the first reading is older than the second, beyond the time between them."""
        return (second[1] - first[1]) - (second[0] - first[0])

    opened, held_up = [], []
    for _ in range(OPENINGS):
        with HidTransport("", 0x0483, 0x5750, backends=[Backend("libusb", hid)]) as transport:
            first, second = reading(transport), reading(transport)
            time.sleep(0.3)
            opened.append(older(first, second))
            held_up.append(older(reading(transport), second))
        time.sleep(0.5)
    note = f"readings are {max(opened):.1f} steps old at {OPENINGS} openings, {max(held_up):.1f} after 0.3 s held up"
    check(max(*opened, *held_up) < STALE_STEPS, note)
    return None, note


def killed(line: Line) -> tuple[Child, str]:
    """Host and guardian at once, as a computer that dies; the board's watchdog brakes."""
    child, note, braked = _killed(line, and_guardian=True)
    check(0.5 * WATCHDOG_S < braked < GATE_S, f"{note}: the motor ran on, or was braked by another")
    return child, f"{note} (watchdog {1e3 * WATCHDOG_S:.0f} ms)"


def guarded(line: Line) -> tuple[Child, str]:
    """The host alone, on a board without a watchdog: the guardian brakes."""
    child, note, braked = _killed(line, and_guardian=False)
    check(0.0 < braked < GATE_S, f"{note}: the motor ran on")
    return child, f"{note} (guardian)"


def _killed(line: Line, *, and_guardian: bool) -> tuple[Child, str, float]:
    path = WORK / "killed.csv"
    path.unlink(missing_ok=True)
    child = fiohost(line, "manual", "--pwm", "80", "--log", str(path), framed=True)
    child.wait_for(lambda: row_count(path) >= 300, 60.0, "300 rows")
    for guardian in Path(f"/proc/{child.pid}/task/{child.pid}/children").read_text().split():
        if and_guardian:
            os.kill(int(guardian), signal.SIGKILL)
    child.kill()
    killed_s = time.monotonic()
    seen = watch(line, framed_pos, 2.0)
    check(child.wait() == -9, f"exit {child.code}")
    last = read_log(path).rows[-10:]
    per_tick = (last[-1]["angle_deg"] - last[0]["angle_deg"]) * 2.0 / (last[-1]["time_s"] - last[0]["time_s"]) * 0.005
    check(len(seen) > 100 and per_tick > 3.0, f"{len(seen)} reports seen, {per_tick:.1f} counts a tick before")
    braked = next((seen[k][0] for k in range(4, len(seen)) if _speed(seen, k) < 0.9 * per_tick), 0.0) - killed_s
    rest = next((at_s for at_s, pos in seen if pos == seen[-1][1] == seen[-50][1]), 0.0) - killed_s
    note = f"slower {1e3 * braked:.0f} ms after the kill, at rest after {1e3 * rest:.0f} ms"
    check(rest > braked, f"{note}: it did not come to rest")
    return child, note, braked


def _speed(seen: list[tuple[float, int]], k: int) -> float:
    """Counts a tick, over the four ticks before report k."""
    return counts_between(seen[k - 4][1], seen[k][1]) / 4.0


def udev_rules(line: Line) -> tuple[Child, str]:
    """The rules that fiohost prints, in the hands of the system's own udev: all three nodes go to the group."""
    child = fiohost(None, "udev", "--group", "dialout")
    check(child.wait() == 0, child.said())
    RULES.write_text(child.said() + "\n")
    environment = {**os.environ, "LD_LIBRARY_PATH": "/run/bin", "SYSTEMD_IGNORE_CHROOT": "1"}
    gadget.unplug()
    for words in (("control", "--reload"), ("settle",)):
        subprocess.run([UDEVADM, *words], env=environment, check=True)
    replug()
    subprocess.run([UDEVADM, "settle"], env=environment, check=True)
    usb = max(Path("/dev/bus/usb/001").iterdir())  # the board: the newest device of the only bus
    found = [f"{stat.filemode(path.stat().st_mode)[1:]} {path.group()}" for path in (Path(line.node), TTY, usb)]
    check(found == ["rw-rw---- dialout"] * 3, f"hidraw, tty and usb are {found}")
    return child, "hidraw, ttyACM and usb nodes are rw-rw---- dialout"
