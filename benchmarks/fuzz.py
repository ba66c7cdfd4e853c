"""Mutated reports against every parser of the wire: only typed errors, and no growth of memory. Run before a release.

    python benchmarks/fuzz.py                 a million reports, five to ten minutes
    python benchmarks/fuzz.py --count 20000   fewer

Good reports of every shipped layout are flipped, cut, lengthened, spliced and shuffled, and given to the codec, to the
link (whole reports and streams), to sniff's dump and to the simulated board's own parser and receiver. Whatever is
accepted must be a reading that can be one. Prints what was tried; exit 1 where memory grew or anything else was raised.
"""

from __future__ import annotations

import argparse
import gc
import random
import sys
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable

from fiohost.errors import ReportError
from fiohost.transport.profile import TargetProfile
from fiohost.wire.dump import Dump, field_words, hex_rows
from fiohost.wire.link import Link
from fiohost.wire.messages import Codec, Command
from firmware_model import Receiver, make_format

LAYOUTS = {
    "hid-assumed": "assumed",
    "serial-documented": "documented",
    "serial-framed": "framed",
    "hid-framed": "framed-hid",
}
MOST_GROWTH_BYTES = 64_000
MOST_BYTES = 300  # of a mutated report
DUMP_EVERY = 20
WARM_UP = 0.1  # share of the reports before memory is first looked at: caches fill, counters get their keys


def mutated(report: bytes, rng: random.Random) -> bytes:
    """One report with one to three changes."""
    for _ in range(rng.randint(1, 3)):
        at = rng.randrange(len(report) + 1)
        match rng.randrange(7):
            case 0 if report:  # a flipped bit
                at = rng.randrange(len(report))
                report = report[:at] + bytes([report[at] ^ 1 << rng.randrange(8)]) + report[at + 1 :]
            case 1:  # a burst, of the same length
                burst = rng.randbytes(rng.randint(1, 8))
                report = (report[:at] + burst + report[at + len(burst) :])[: len(report)]
            case 2:
                report = report[:at]
            case 3:
                report = report[at:]
            case 4:
                report = report[:at] + rng.randbytes(rng.randint(1, 16)) + report[at:]
            case 5:  # a part of it once more
                report = (report[:at] + report)[:MOST_BYTES]
            case _:
                report = rng.randbytes(rng.randrange(100))
    return report


class Target:
    """All parsers of one layout."""

    def __init__(self, profile: str, board: str, seen: Counter[str]) -> None:
        self.codec: Codec = TargetProfile.load(profile).codec
        self.form = make_format(board)
        self.line, self.stream = Link(self.codec), Link(self.codec, stream=self.codec.telemetry_layout.has_marks)
        self.port, self.dump, self.seen = Receiver(self.form), Dump(), seen
        for extreme in (b"\x00", b"\xff"):  # a dump keeps a record of each byte: all there are, before memory counts
            self.dump.changed(extreme * (MOST_BYTES + 100))

    def try_one(self, rng: random.Random, damage: Callable[[bytes, random.Random], bytes]) -> None:
        telemetry = damage(self.form.telemetry(rng.randrange(2), rng.randrange(720)), rng)
        command = damage(self.codec.encode(Command.drive(rng.uniform(-100, 100)), rng.randrange(256)), rng)
        for link in (self.line, self.stream):
            try:
                reading = link.receive(telemetry)
            except ReportError as exc:
                self.seen[f"refused: {exc.reason}"] += 1
                continue
            if reading is not None:
                assert reading.direction in (0, 1), reading
                assert 0 <= reading.pos < 720, reading
                assert link.steps >= 1, link.steps
                self.seen["accepted"] += 1
        if rng.randrange(DUMP_EVERY) == 0:
            field_words(self.codec.telemetry_layout, telemetry)
            hex_rows(telemetry, self.dump.changed(telemetry))
        heard = self.form.parse(command)
        assert heard is None or (heard.c3 in (0, 1) and 0 <= heard.compare <= 0xFFFF), heard
        self.port.feed(command)
        self.port.take()
        self.seen["commands taken" if heard else "commands dropped"] += 1


def fuzz(count: int, seed: int = 1) -> tuple[Counter[str], int]:
    """Try *count* mutated reports in each direction; what was seen, and by how many bytes memory grew."""
    rng, seen = random.Random(seed), Counter[str]()
    targets = [Target(profile, board, seen) for profile, board in LAYOUTS.items()]
    tracemalloc.start()
    try:
        begun = 0
        for k in range(count):
            # every fourth is left whole, so that the links have numbers to go on
            targets[k % len(targets)].try_one(rng, mutated if k // len(targets) % 4 else lambda report, _: report)
            if k == int(WARM_UP * count):
                gc.collect()
                begun, _ = tracemalloc.get_traced_memory()
        gc.collect()
        held, _ = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    return seen, held - begun


def main() -> int:
    parser = argparse.ArgumentParser(description="Mutated reports against every parser of the wire.")
    parser.add_argument("--count", type=int, default=1_000_000, help="reports in each direction (1000000)")
    parser.add_argument("--seed", type=int, default=1, help="what they are (1)")
    asked = parser.parse_args()
    began_s = time.monotonic()
    seen, grown = fuzz(asked.count, asked.seed)
    for what, number in sorted(seen.items()):
        print(f"  {number:>9} {what}")
    print(
        f"{asked.count} mutated reports in each direction, seed {asked.seed}, {time.monotonic() - began_s:.0f} s: "
        f"only typed errors; memory grew by {grown} bytes"
    )
    if grown > MOST_GROWTH_BYTES:
        print(f"memory grew by more than {MOST_GROWTH_BYTES} bytes", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
