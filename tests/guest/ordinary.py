"""What every line must be good for: doctor, manual, deadband and a closed loop. Each gives its process and a note."""

from __future__ import annotations

import json

from children import Child, check
from ends import WORK, Line, fiohost, read_log

# Findings that speak of the emulation.
TIMING = ("half a tick", "reports come every", "reports were lost", "answered late")
CLOSED_LOOP = WORK / "closed.toml"
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
    late = log.head["tick_statistics"].split("; lateness")[0]
    return child, f"{len(log.rows)} rows of 600, {turned:.0f} deg; {late}"


def deadband(line: Line) -> tuple[Child, str]:
    result = WORK / "deadband.json"
    plot = ("--plot", str(WORK / "deadband.svg"))
    child = fiohost(line, "deadband", "--repeats", "1", *plot, "--json", str(result))
    check(child.wait() == 0, child.said()[-300:])
    found = json.loads(result.read_text())
    plus, minus = found["u_plus_pct"], found["u_minus_pct"]
    check(3.0 < plus < 5.0 and -5.0 < minus < -3.0, f"it found {plus:.2f} and {minus:.2f} %")
    return child, f"{plus:.2f} %, {minus:.2f} % (in lock step 3.76, -3.76)"


def closed_loop(line: Line) -> tuple[Child, str]:
    path = WORK / "closed.csv"
    child = fiohost(line, "run", str(CLOSED_LOOP), "--log", str(path))
    check(child.wait() == 0, child.said()[-300:])
    log = read_log(path)
    ends = [row for row in log.rows if row["time_s"] % 2.0 > 1.8]
    off = max(abs(row["angle_deg"] - row["ref_deg"]) for row in ends)
    check(log.head["ending"] == "complete", f"the log's ending is {log.head['ending']!r}")
    check(len(log.rows) > 1500, f"only {len(log.rows)} rows of 2000")
    check(off < 10.0, f"{off:.1f} degrees from its reference at the end of a half period")
    return child, f"{len(log.rows)} rows of 2000, at most {off:.1f} deg off at the half periods' ends"
