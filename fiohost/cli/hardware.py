"""Commands about real boards: ``devices``, ``udev`` and ``doctor``."""

from __future__ import annotations

import platform
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.options import parse_number, parse_seed, target_options
from fiohost.cli.output import Output, json_option, output_for
from fiohost.errors import FiohostError, TransportError

if TYPE_CHECKING:
    from fiohost.bench.doctor import Finding, Timing

MARKS = {"ok": "ok     ", "note": "note   ", "problem": "PROBLEM"}
BARS = 12  # of a histogram


@click.command()
@click.option("--all", "show_all", is_flag=True, help="Also HID devices that no profile knows.")
@json_option
def devices(show_all: bool, json_to: str | None) -> None:
    """List boards that are connected, each as the --target that opens it, and what keeps you from it.

    Serial ports are all listed; HID devices where a target profile has their identity.

    \b
    Example:
      fiohost devices
      fiohost manual --pwm 0 --target serial:/dev/ttyACM0
    """
    from fiohost.transport.discovery import find_devices
    from fiohost.transport.hid_modules import find_backends

    out = output_for(json_to)
    found = find_devices()
    for problem in find_backends()[1]:
        out(f"note: {problem}")
    shown = [one for one in found if show_all or one.is_candidate]
    for one in shown:
        fits = f"; profiles {', '.join(one.profiles)}" if one.profiles else ""
        out(f"{one.target}\n    {one.identity} {one.name}{fits}")
        if one.problem:
            out(f"    {one.problem}")
    if not shown:
        hidden = len(found) - len(shown)
        more = f"; {hidden} other HID devices are shown by --all" if hidden else ""
        out(f"no board is connected{more}. Simulated ones need none: --target sim")
    out.json({"schema": "fiohost.devices/1", "devices": [one.to_json() for one in shown]})


@click.command()
@click.argument("profiles", nargs=-1, metavar="[PROFILE]...")
@click.option("--group", default="plugdev", show_default=True, metavar="G", help="Group that may reach the boards.")
def udev(profiles: Sequence[str], group: str) -> None:
    """Print udev rules (Linux) for the boards of all shipped target profiles, and of PROFILEs of your own.

    They open the boards' USB devices, hidraw nodes and serial ports to whoever sits at the screen (uaccess) and to a
    group, for those who come over SSH: "sudo usermod -aG plugdev $USER", then log in anew. They also keep
    ModemManager from trying the ports.

    \b
    Example:
      fiohost udev | sudo tee /etc/udev/rules.d/70-fiohost.rules
      sudo udevadm control --reload && sudo udevadm trigger
    """
    from fiohost.transport.discovery import known_identities
    from fiohost.transport.udev import rules

    if not group.replace("-", "").replace("_", "").isalnum():
        raise FiohostError(f"--group {group[:60]!r} is no name of a group")
    click.echo(rules(known_identities(profiles), group), nl=False)


@click.command()
@target_options
@click.option("--move", is_flag=True, help="Also try encoder and wiring, with short pulses of rising duty.")
@click.option("--most", default="40", show_default=True, metavar="PCT", help="With --move: no duty beyond this.")
@click.option("--seconds", default="2", show_default=True, metavar="S", help="How long to look at the timing.")
@json_option
def doctor(target: str, seed: str | None, move: bool, most: str, seconds: str, json_to: str | None) -> None:
    """Look at everything between this computer and the motor, and say what to do about what is not right.

    Software, permissions, the board's identity and layout, the time between its reports and how fast they are
    answered. The motor stays braked, unless --move is given. Exit code 1 where there is a problem.

    \b
    Example:
      fiohost doctor --target hid
      fiohost doctor --target serial:/dev/ttyACM0 --move
    """
    out = output_for(json_to)
    most_pct = parse_number("--most", most, 1.0, 100.0, "percent of full scale")
    listen_s = parse_number("--seconds", seconds, 0.2, 600.0, "s")
    report = _Report(out)
    _software(report)
    timing = _bench(report, target, parse_seed(seed), listen_s, most_pct if move else None)
    problems = [finding for finding in report.findings if finding.level == "problem"]
    out.json(
        {
            "schema": "fiohost.doctor/1",
            "target": target,
            "findings": [vars(finding) for finding in report.findings],
            "timing": _timing_json(timing),
        }
    )
    if problems:
        raise TransportError(f"{len(problems)} problem{'s' * (len(problems) > 1)} found with {target}; see above")


class _Report:
    """Findings, each printed as it is made."""

    def __init__(self, out: Output) -> None:
        self.out = out
        self.findings: list[Finding] = []

    def __call__(self, finding: Finding) -> None:
        self.findings.append(finding)
        self.out(f"{MARKS[finding.level]}  {finding.what}")
        if finding.cure:
            self.out(f"         -> {finding.cure}")


def _software(report: _Report) -> None:
    from importlib.metadata import version

    from fiohost import __version__
    from fiohost.bench.doctor import NOTE, OK, PROBLEM, Finding
    from fiohost.transport.discovery import find_devices
    from fiohost.transport.hid_modules import find_backends

    report(Finding(OK, f"fiohost {__version__}, Python {platform.python_version()}, {platform.platform(terse=True)}"))
    backends, problems = find_backends()
    for problem in problems:
        report(Finding(NOTE if backends else PROBLEM, problem))
    names = ", ".join(f"{backend.name} {backend.version}" for backend in backends) or "none"
    report(Finding(OK if backends else PROBLEM, f"hidapi: {names}; pyserial {version('pyserial')}"))
    if sys.platform.startswith("linux") and backends and backends[0].name != "hidraw":
        report(Finding(NOTE, "hidapi has no hidraw module here: libusb takes the board away from the kernel meanwhile"))
    for one in find_devices():
        if one.is_candidate:
            report(
                Finding(PROBLEM if one.problem else OK, f"{one.target}: {one.name or one.identity}", one.problem or "")
            )


def _bench(report: _Report, target: str, seed: int | None, listen_s: float, most_pct: float | None) -> Timing | None:
    from fiohost.bench.connect import connect
    from fiohost.bench.doctor import NOTE, OK, PROBLEM, Finding, signs, timing, who

    found = None
    try:
        with connect(target, seed=seed, realtime=True) as bench:
            profile = bench.profile
            report(Finding(OK, f"{bench.transport.name} opened: {bench.transport.identity}, profile {profile.name}"))
            on_a_cable = bench.transport.can_reopen
            if on_a_cable and profile.status == "assumed":
                cure = "'fiohost sniff' shows the raw reports; write the board's own into a profile"
                report(Finding(NOTE, "the layout of its reports is assumed, nobody has measured it", cure))
            if on_a_cable and not profile.watchdog_s:
                cure = "keep the motor's switch at hand; a watchdog in the board's program helps (watchdog_s)"
                report(Finding(NOTE, "the board has no watchdog: a host that dies leaves its motor running", cure))
            for finding in who(bench):
                report(finding)
            found = timing(bench, listen_s)
            for finding in found.findings:
                report(finding)
            _show_timing(report.out, found)
            if most_pct is None:
                report(Finding(NOTE, "encoder and wiring were not tried", "with --move, short pulses try them"))
            else:
                for finding in signs(bench, most_pct):
                    report(finding)
    except FiohostError as exc:
        report(Finding(PROBLEM, str(exc), " ".join(getattr(exc, "__notes__", ()))))
    return found


def _show_timing(out: Output, timing: Timing) -> None:
    import numpy as np

    out(f"         this host could answer {timing.achievable_hz:.0f} reports a second")
    for name, values in (("from report to report", timing.interval_ms), ("from report to answer", timing.answer_ms)):
        median, worst = np.median(values), values.max()
        out(f"         {name}: median {median:.2f} ms, 99 % {np.percentile(values, 99):.2f} ms, worst {worst:.2f} ms")
        counts, edges = _histogram(values)
        for count, low, high in zip(counts, edges[:-1], edges[1:], strict=True):
            bar = "#" * max(round(40 * count / max(counts)), 1 if count else 0)
            out(f"         {low:8.3f} .. {high:7.3f} ms {count:6d} {bar}".rstrip())


def _histogram(values: Any) -> tuple[list[int], list[float]]:
    """Counts and edges: even from the least to the 99th percentile, the rest in a last one."""
    import numpy as np

    low, high = float(values.min()), float(np.percentile(values, 99))
    edges = np.linspace(low, max(high, low + 0.01), BARS)
    if values.max() > edges[-1]:
        edges = np.append(edges, values.max())
    counts, edges = np.histogram(values, edges)
    return counts.tolist(), edges.tolist()


def _timing_json(timing: Timing | None) -> dict[str, Any] | None:
    if timing is None:
        return None
    import numpy as np

    result: dict[str, Any] = {"sample_time_ms": timing.sample_time_ms, "achievable_hz": timing.achievable_hz}
    for name, values in (("interval_ms", timing.interval_ms), ("answer_ms", timing.answer_ms)):
        counts, edges = _histogram(values)
        result[name] = {
            "median": float(np.median(values)),
            "p99": float(np.percentile(values, 99)),
            "worst": float(values.max()),
            "histogram": {"edges": edges, "counts": counts},
        }
    return result
