"""``fiohost sniff``: raw reports beside the fields that the profile's layout sees in them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from fiohost.cli.options import parse_seed, parse_whole, target_options
from fiohost.cli.output import Output, json_option, output_for
from fiohost.errors import ReportError, TelemetryTimeoutError

if TYPE_CHECKING:
    from fiohost.transport.profile import TargetProfile
    from fiohost.transport.trace import Event
    from fiohost.wire.dump import Dump

SCHEMA = "fiohost.sniff/1"
WAIT_S = 2.0  # for the first report, and for the next


@click.command()
@target_options
@click.option("--replay", "replay_file", metavar="FILE", help="Show a recorded trace, both directions, instead.")
@click.option("--count", default="100", show_default=True, metavar="N", help="Stop after N reports; 0: at Ctrl-C.")
@click.option("--all", "every", is_flag=True, help="Show reports that changed nothing too.")
@click.option("--raw", is_flag=True, help="Pieces of a serial stream as they come, not reports.")
@json_option
def sniff(
    target: str, seed: str | None, replay_file: str | None, count: str, every: bool, raw: bool, json_to: str | None
) -> None:
    """Show what a board sends, byte by byte: changed bytes are marked, the profile's fields stand beside them.

    Nothing is sent: the board is never driven. To find the layout of an unknown board, let it run with its motor
    braked and turn the shaft by hand: the bytes that follow are the count and the direction. The end says of every
    byte that changed how often and in which range.

    \b
    Example:
      fiohost sniff --target hid
      fiohost sniff --target serial:/dev/ttyACM0 --raw --count 0
      fiohost run multisine --trace wire.jsonl && fiohost sniff --replay wire.jsonl --count 20
    """
    from fiohost.wire.dump import Dump

    out = output_for(json_to)
    most = parse_whole("--count", count, 0, 10**9)
    profile, stream, events = _recorded(replay_file) if replay_file else _live(target, parse_seed(seed))
    dumps = {"in": Dump(), "out": Dump()}
    refused, quiet = 0, False
    out(f"layout of {profile.name} ({profile.status}); > before a byte: it changed")
    try:
        for event in _reports(events, profile, whole=not stream or raw):
            if event.direction in dumps:
                quiet = False
                refused += _show(out, profile, dumps[event.direction], event, every, is_report=not (stream and raw))
            elif event.direction == "none" and not replay_file and not quiet:
                quiet = True
                out(f"nothing came for {WAIT_S:g} s (Ctrl-C ends)")
            if most and sum(dump.reports for dump in dumps.values()) >= most:
                break
    except KeyboardInterrupt:
        out()
    _say_summary(out, dumps, refused)
    directions = {name: {"reports": dump.reports, "bytes_that_changed": dump.summary()} for name, dump in dumps.items()}
    out.json({"schema": SCHEMA, "profile": profile.name, "refused": refused, **directions})


def _recorded(path: str) -> tuple[TargetProfile, bool, Iterator[Event]]:
    from fiohost.transport.replay import ReplayTransport
    from fiohost.transport.trace import TraceReader

    replay = ReplayTransport(Path(path))
    return replay.profile, replay.stream, TraceReader(path).events()


def _live(target: str, seed: int | None) -> tuple[TargetProfile, bool, Iterator[Event]]:
    from fiohost.bench.clock import MonotonicClock
    from fiohost.bench.connect import open_target, watched
    from fiohost.transport.trace import Event

    transport, profile = open_target(target, seed=seed)
    profile = profile.with_counts(transport.counts_per_rev)
    clock = MonotonicClock()
    line = watched(transport, profile, clock)

    def events() -> Iterator[Event]:
        began_s = clock.now_s()
        with line:
            while True:
                try:
                    data = line.receive(WAIT_S)
                except TelemetryTimeoutError:
                    yield Event(clock.now_s() - began_s, "none")
                    continue
                yield Event(clock.now_s() - began_s, "in", data)

    return profile, transport.stream, events()


def _reports(events: Iterator[Event], profile: TargetProfile, *, whole: bool) -> Iterator[Event]:
    """The events, of a stream cut into reports."""
    if whole:
        yield from events
        return
    from dataclasses import replace

    from fiohost.wire.stream import StreamParser

    layouts = {"in": profile.codec.telemetry_layout, "out": profile.codec.command_layout}

    def parser(direction: str) -> StreamParser[bytes]:
        def read(report: bytes) -> bytes:
            layouts[direction].unpack(report)
            return report

        return StreamParser(layouts[direction], read)

    parsers = {direction: parser(direction) for direction in layouts}
    for event in events:
        if event.direction in parsers:
            for report in parsers[event.direction].feed(event.data):
                yield replace(event, data=report)


def _show(out: Output, profile: TargetProfile, dump: Dump, event: Event, every: bool, *, is_report: bool) -> int:
    """Print one report if it says something new; gives 1 where the layout refuses it."""
    from fiohost.wire.dump import field_words, hex_rows

    incoming = event.direction == "in"
    layout = profile.codec.telemetry_layout if incoming else profile.codec.command_layout
    marks = dump.changed(event.data)
    words, refused = "", 0
    if is_report:
        words = field_words(layout, event.data)
        try:
            profile.codec.decode(event.data) if incoming else layout.unpack(event.data)
        except ReportError as exc:
            words, refused = f"{words}  REFUSED: {exc}", 1
    if every or dump.reports == 1 or any(marks):
        for number, row in enumerate(hex_rows(event.data, marks)):
            text = "".join(click.style(item, fg="yellow", bold=True) if changed else item for item, changed in row)
            head = f"{event.time_s:10.4f} {event.direction:>3} " if number == 0 else " " * 15
            out(f"{head}{text}{'   ' + words if number == 0 and words else ''}", styled=True)
    return refused


def _say_summary(out: Output, dumps: dict[str, Dump], refused: int) -> None:
    told: dict[str, Any] = {"in": "from the board", "out": "to the board"}
    for name, dump in dumps.items():
        if not dump.reports:
            continue
        rows = dump.summary()
        out(f"{dump.reports} reports {told[name]}; {len(rows)} of {len(dump.bytes)} bytes changed")
        for row in rows:
            pair = f"; as u16 from here {row['u16_low']} .. {row['u16_high']}" if "u16_low" in row else ""
            out(f"  byte {row['offset']:>3}: {row['changes']} changes, {row['low']} .. {row['high']}{pair}")
    if refused:
        out(f"{refused} reports do not fit the layout")
