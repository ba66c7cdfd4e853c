"""What is shown in the guest, step by step; each is a row of the table."""

from __future__ import annotations

import importlib
import json
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from children import Child, StepFailed
from ends import (
    HIDRAW,
    LIBUSB,
    SERIAL,
    WORK,
    Line,
    board,
    counts_between,
    fiohost,
    first_gone_s,
    framed_pos,
    read_log,
    row_count,
    watch,
)
from inside import wait_for_nodes

from firmware_model import gadget

GATE_S = 1.0  # an emulated clock is rough; 0.1 s is aimed at
WATCHDOG_S = 0.1
TIMING = ("half a tick", "reports come every", "reports were lost")  # findings that speak of the emulation
EVERYTHING = (
    *("fiohost.bench.connect", "fiohost.bench.deadband", "fiohost.bench.doctor", "fiohost.report.deadband"),
    *("fiohost.cli.main", "fiohost.cli.deadband", "fiohost.cli.drive", "fiohost.cli.hardware", "fiohost.cli.run"),
    *("fiohost.transport.discovery", "fiohost.transport.hid", "fiohost.transport.serial", "fiohost.panel.keys"),
)
EXPERIMENT = """schema = "fiohost.experiment/1"
title = "P control of a square wave 60/300 deg"
[[reference]]
kind = "square"
low_deg = 60.0
high_deg = 300.0
period_s = 4.0
duration_s = 10.0
[controller]
kind = "p"
kp_pct_per_deg = 0.5
[deadband]
u_plus_pct = 3.0
u_minus_pct = -3.0
"""


def check(true: object, what: str) -> None:
    if not true:
        raise StepFailed(what)


class Table:
    """Runs steps and prints a row for each. ``failed`` counts."""

    def __init__(self) -> None:
        self.failed = 0
        print(f"{'line':8s} {'step':28s} {'exit':>5s} {'time':>7s}  result", flush=True)

    def step(self, line: Line, what: str, run: Callable[[Line], tuple[Child | None, str]]) -> None:
        began_s, code = time.monotonic(), "-"
        try:
            child, note = run(line)
            code = "-" if child is None else str(child.code)
        except Exception as exc:
            self.failed += 1
            note = f"FAILED: {exc}" if isinstance(exc, StepFailed) else f"FAILED: {type(exc).__name__}: {exc}"
            Child.end_all("fiohost")
            with suppress(Exception):
                replug()
        took_s = time.monotonic() - began_s
        print(f"{line.name:8s} {what:28s} {code:>5s} {took_s:6.1f}s  {note}", flush=True)


def all_of_them() -> int:
    WORK.mkdir(parents=True, exist_ok=True)
    (WORK / "closed.toml").write_text(EXPERIMENT)
    _import_everything()
    table = Table()
    for line in (HIDRAW, LIBUSB):
        with board(line):
            _ordinary(table, line)
            table.step(line, "unplugged in mid-run", unplugged)
            replug()
            table.step(line, "unplugged, --reconnect", reconnected)
    with board(LIBUSB, "--layout", "framed-hid"):
        table.step(LIBUSB, "opened twice, held up", fresh)
    with board(HIDRAW, "--layout", "framed-hid", "--watchdog", str(WATCHDOG_S)):
        table.step(HIDRAW, "kill -9, watchdog", killed)
    with board(SERIAL):
        _ordinary(table, SERIAL)
        table.step(SERIAL, "unplugged in mid-run", unplugged)
        replug()
        table.step(SERIAL, "unplugged, --reconnect", reconnected)
    with board(SERIAL, "--layout", "framed", "--watchdog", str(WATCHDOG_S)):
        table.step(SERIAL, "kill -9, watchdog", killed)
    print(f"guest: {table.failed} steps failed" if table.failed else "guest: all steps are as they must be", flush=True)
    return 1 if table.failed else 0


def _import_everything() -> None:
    """Once, here: each child is a copy of this process."""
    began_s = time.monotonic()
    for name in EVERYTHING:
        importlib.import_module(name)
    from matplotlib import pyplot

    from firmware_model import Board, load_plant

    pyplot.figure().savefig(WORK / "first.png")  # fonts and the like
    for layout in ("assumed", "framed"):
        Board(load_plant("default"), layout=layout).step(None)
    print(f"guest: everything imported in {time.monotonic() - began_s:.0f} s", flush=True)


def _ordinary(table: Table, line: Line) -> None:
    table.step(line, "doctor", doctor)
    table.step(line, "manual 40 %, 3 s", manual)
    table.step(line, "deadband", deadband)
    table.step(line, "run, closed loop, 10 s", closed_loop)


def replug() -> None:
    """Plug the cable in where it is out; until both its ends are there."""
    if not gadget.is_plugged():
        gadget.plug()
        wait_for_nodes()


# ---- the commands ----------------------------------------------------------------------------------------------------


def doctor(line: Line) -> tuple[Child, str]:
    report = WORK / "doctor.json"
    child = fiohost(line, "doctor", "--seconds", "2", "--json", str(report))
    code = child.wait()
    check(report.exists(), f"no report: {child.said()[-300:]}")
    found = json.loads(report.read_text())
    problems = [one["what"] for one in found["findings"] if one["level"] == "problem"]
    other = [what for what in problems if not any(words in what for words in TIMING)]
    check(not other, f"it found {other}")
    check(code == bool(problems), f"exit {code} with {len(problems)} problems")
    answer, interval = found["timing"]["answer_ms"], found["timing"]["interval_ms"]
    note = (
        f"a report every {interval['median']:.2f} ms, answered in {answer['median']:.2f} ms (99 %: {answer['p99']:.1f})"
    )
    return child, note + (f"; says of this computer: {problems[0]}" if problems else "")


def manual(line: Line) -> tuple[Child, str]:
    path = WORK / "manual.csv"
    child = fiohost(line, "manual", "--pwm", "40", "--duration", "3", "--log", str(path))
    check(child.wait() == 0, child.said()[-300:])
    log = read_log(path)
    turned = log.rows[-1]["angle_deg"] - log.rows[0]["angle_deg"]
    check(log.head["ending"] == "complete", f"the log's ending is {log.head['ending']!r}")
    check(log.head.get("hid_backend", line.name).startswith(line.name), f"the line was {log.head.get('hid_backend')}")
    check(500.0 < turned < 1500.0, f"the shaft turned {turned:.0f} degrees")
    return child, f"{len(log.rows)} rows of 600, {turned:.0f} deg; {log.head['tick_statistics'][:60]}"


def deadband(line: Line) -> tuple[Child, str]:
    result = WORK / "deadband.json"
    plot = ("--plot", str(WORK / "deadband.png"))
    child = fiohost(line, "deadband", "--repeats", "1", *plot, "--json", str(result))
    check(child.wait() == 0, child.said()[-300:])
    found = json.loads(result.read_text())
    plus, minus = found["u_plus_pct"], found["u_minus_pct"]
    check(3.0 < plus < 5.0 and -5.0 < minus < -3.0, f"it found {plus:.2f} and {minus:.2f} %")
    return child, f"{plus:.2f} %, {minus:.2f} % (in lock step 3.76, -3.76)"


def closed_loop(line: Line) -> tuple[Child, str]:
    path = WORK / "closed.csv"
    child = fiohost(line, "run", str(WORK / "closed.toml"), "--log", str(path))
    check(child.wait() == 0, child.said()[-300:])
    log = read_log(path)
    ends = [row for row in log.rows if row["time_s"] % 2.0 > 1.8]
    off = max(abs(row["angle_deg"] - row["ref_deg"]) for row in ends)
    check(log.head["ending"] == "complete", f"the log's ending is {log.head['ending']!r}")
    check(len(log.rows) > 1500, f"only {len(log.rows)} rows of 2000")
    check(off < 10.0, f"{off:.1f} degrees from its reference at the end of a half period")
    return child, f"{len(log.rows)} rows of 2000, at most {off:.1f} deg off at the half periods' ends"


# ---- what goes wrong -------------------------------------------------------------------------------------------------


def _running(line: Line, name: str, *options: str) -> tuple[Child, Path, Path]:
    """A run that has got going, its log and its trace."""
    log, trace = WORK / f"{name}.csv", WORK / f"{name}.jsonl"
    log.unlink(missing_ok=True)
    child = fiohost(line, "run", str(WORK / "closed.toml"), "--log", str(log), "--trace", str(trace), *options)
    child.wait_for(lambda: row_count(log) >= 300, 60.0, "300 rows")
    return child, log, trace


def unplugged(line: Line) -> tuple[Child, str]:
    child, path, trace = _running(line, "unplugged")
    began_s, began_clock_s = time.monotonic(), time.time()
    gadget.unplug()
    check(child.wait() == 1, f"exit {child.code}: {child.said()[-300:]}")
    said = child.wait_line("MOTOR MAY BE RUNNING") - began_s
    noticed = first_gone_s(trace) - began_clock_s
    log = read_log(path)
    check(log.head["ending"].startswith("stopped: DisconnectedError"), f"the log's ending is {log.head['ending']!r}")
    check("tick_statistics" in log.head and len(log.rows) >= 300, "the log is not complete")
    check(noticed < GATE_S and said < GATE_S, f"noticed after {noticed:.3f} s, said after {said:.3f} s")
    return (
        child,
        f"noticed within {1e3 * noticed:.0f} ms, said after {1e3 * said:.0f} ms; log complete, {len(log.rows)} rows",
    )


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
    probe = fiohost(line, "manual", "--pwm", "0", "--duration", "0.3", "--log", str(WORK / "rest.csv"))
    check(probe.wait() == 0, f"after the reconnection: {probe.said()[-300:]}")
    rest = read_log(WORK / "rest.csv").rows
    check(rest[0]["pos"] == rest[-1]["pos"], "the shaft does not rest")
    return child, f"back, and braked first of all, {back:.1f} s after the plug went in"


def fresh(line: Line) -> tuple[None, str]:
    """What is read first after a second opening, and after the host was held up, is new by the board's own tick."""
    import hid

    from fiohost.transport.hid import HidTransport
    from fiohost.transport.hid_modules import Backend

    def ticks(transport: HidTransport, number: int) -> list[int]:
        return [int.from_bytes(transport.receive(1.0)[4:8], "little") for _ in range(number)]

    with HidTransport("", 0x0483, 0x5750, backends=[Backend("libusb", hid)]) as transport:
        ticks(transport, 3)
        time.sleep(0.3)
        held_up = ticks(transport, 2)
    time.sleep(1.0)
    with HidTransport("", 0x0483, 0x5750, backends=[Backend("libusb", hid)]) as transport:
        opened = ticks(transport, 2)
    later, again = held_up[1] - held_up[0], opened[1] - opened[0]
    check(0 < later < 20, f"after 0.3 s held up the next report was {later} ticks newer")
    check(0 < again < 20, f"the first report after opening was {again} ticks older than the second")
    return None, f"from the first report to the next {again} ticks after opening, {later} after 0.3 s held up"


def killed(line: Line) -> tuple[Child, str]:
    path = WORK / "killed.csv"
    path.unlink(missing_ok=True)
    child = fiohost(line, "manual", "--pwm", "80", "--log", str(path), framed=True)
    child.wait_for(lambda: row_count(path) >= 300, 60.0, "300 rows")
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
    check(0.5 * WATCHDOG_S < braked < GATE_S and rest > braked, f"{note}: the motor ran on, or was braked by another")
    return child, f"{note} (watchdog {1e3 * WATCHDOG_S:.0f} ms)"


def _speed(seen: list[tuple[float, int]], k: int) -> float:
    """Counts a tick, over the four ticks before report k."""
    return counts_between(seen[k - 4][1], seen[k][1]) / 4.0
