"""The firmware's core on this computer, under ASan and UBSan, on a stream of damaged frames; held against Python.

    python benchmarks/firmware_fuzz.py [--bytes N] [--seed N]

The stream is whole, damaged, cut and doubled commands, queries, headers and noise. The core says which commands and
queries it found; the host's stream parser and the simulated board's own parser say the same of every one, or the run
fails. A million bytes take some ten seconds; ten million are run before a release.
"""

from __future__ import annotations

import argparse
import random
import struct
import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent.parent))

from fiohost.errors import ReportError
from fiohost.transport.profile import TargetProfile
from fiohost.wire.identity import QUERY
from fiohost.wire.stream import StreamParser
from firmware_model.formats import crc16, make_format

ROOT = Path(__file__).resolve().parent.parent
STEPS = (8, 36)  # duty steps per percent: the Uno's and the Blue Pill's
LENGTH = 12
TAIL = bytes(16)  # so that nothing is held back at the end
ODD_DUTIES = (0.0, -0.0, 100.0, 100.00001, -1.0, 1e-30, 1e-45, 1e30, float("inf"), float("-inf"), float("nan"), 12.5)


def built(steps: int, bridge: str = "tb6612") -> Path:
    """The harness, made anew where its sources changed. Raises CalledProcessError."""
    name = f"build/harness-{steps}-{bridge}"
    subprocess.run(["make", "-s", "-C", str(ROOT / "firmware"), name], check=True)
    return ROOT / "firmware" / name


def run(harness: Path, stream: bytes, *arguments: str) -> list[str]:
    """Lines that the harness says of a stream. Raises CalledProcessError where a sanitizer stopped it."""
    done = subprocess.run([harness, *arguments], input=stream, capture_output=True)
    if done.returncode:
        raise SystemExit(f"{harness.name} stopped:\n{done.stderr.decode(errors='replace')[:2000]}")
    return done.stdout.decode().splitlines()


def frame(rng: random.Random) -> bytes:
    """A command whose CRC is right, of any content."""
    kind = rng.randrange(8)
    if kind == 0:
        duty = struct.pack("<f", rng.choice(ODD_DUTIES))
    elif kind == 1:
        duty = rng.randbytes(4)
    else:
        duty = struct.pack("<f", rng.uniform(0.0, 100.0))
    bits = bytes(rng.choice((0, 1)) for _ in range(2)) if rng.randrange(12) else rng.randbytes(2)
    body = b"\xa5\x5a" + rng.randbytes(2) + duty + bits
    return body + struct.pack("<H", crc16(body))


def piece(rng: random.Random) -> bytes:
    """Something that may come on a line."""
    kind = rng.randrange(12)
    whole = frame(rng)
    if kind < 4:
        return whole
    if kind == 4:
        at = rng.randrange(LENGTH)
        return whole[:at] + bytes([whole[at] ^ 1 << rng.randrange(8)]) + whole[at + 1 :]
    if kind == 5:
        return whole[: rng.randrange(LENGTH)]
    if kind == 6:
        return whole[rng.randrange(LENGTH) :]
    if kind == 7:
        return rng.randbytes(rng.randrange(1, 40))
    if kind == 8:
        return rng.choice((b"\xa5", b"\xa5\x5a", b"\xa5\xa5\x5a", b"\xa5?", b"\xa5?88"[: rng.randrange(1, 5)]))
    if kind == 9:
        return QUERY
    if kind == 10:
        return whole[:4] + whole
    return whole[: rng.randrange(2, LENGTH)] + QUERY + whole


def stream_of(count: int, seed: int) -> bytes:
    """A stream of at least *count* bytes."""
    rng, parts, length = random.Random(seed), [], 0
    while length < count:
        parts.append(piece(rng))
        length += len(parts[-1])
    return b"".join(parts) + TAIL


def reference(stream: bytes, steps: int) -> list[str]:
    """What the Python parsers find in it, in the harness's words."""
    codec, form = TargetProfile.load("serial-framed").codec, make_format("framed", 100 * steps)
    layout = codec.command_layout
    found: list[tuple[int, str]] = []

    def read(report: bytes) -> int:
        sequence = int(layout.decode(report)["sequence"])
        command = form.parse(report)
        if command is None:
            raise ReportError("the board's own parser drops it", "board")
        at = parser.garbage_bytes + LENGTH * parser.reports
        found.append((at, f"C {sequence} {command.compare} {command.c3} {command.c4}"))
        return at

    parser = StreamParser(layout, read)
    parser.feed(stream)
    ends = 0
    queries: list[tuple[int, str]] = []
    for begins in [*(at for at, _ in found), len(stream)]:
        at = stream.find(QUERY, ends, begins)
        while at >= 0:
            queries.append((at, "Q"))
            at = stream.find(QUERY, at + len(QUERY), begins)
        ends = begins + LENGTH
    return [said for _, said in sorted(found + queries)]


def once(said: list[str]) -> list[str]:
    """Queries one behind the other as one: a single byte may complete two, which get one answer."""
    return [line for k, line in enumerate(said) if line != "Q" or k == 0 or said[k - 1] != "Q"]


def compare(count: int, seed: int) -> dict[str, int]:
    """Fuzz each form of the core. Counts of what was found; SystemExit where the two sides differ."""
    stream, seen = stream_of(count, seed), {"bytes": 0, "commands": 0, "queries": 0}
    for steps in STEPS:
        said = once([line for line in run(built(steps), stream, "97") if line[0] in "CQ"])
        wanted = once(reference(stream, steps))
        for number, (core, python) in enumerate(zip(said, wanted, strict=False)):
            if core != python:
                raise SystemExit(f"frame {number}: the core says {core!r}, Python {python!r} (seed {seed})")
        if len(said) != len(wanted):
            raise SystemExit(f"the core found {len(said)} frames, Python {len(wanted)} (seed {seed})")
        seen["bytes"] += len(stream)
        seen["queries"] += said.count("Q")
        seen["commands"] += len(said) - said.count("Q")
    return seen


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bytes", type=int, default=10_000_000, help="through the core, all its forms together")
    parser.add_argument("--seed", type=int, default=1, help="what they are (1)")
    asked = parser.parse_args()
    began_s = time.monotonic()
    seen = compare(asked.bytes // len(STEPS), asked.seed)
    print(
        f"{seen['bytes']} bytes under ASan and UBSan, seed {asked.seed}: {seen['commands']} commands and "
        f"{seen['queries']} queries, each the same to the core and to Python; {time.monotonic() - began_s:.0f} s"
    )


if __name__ == "__main__":
    main()
