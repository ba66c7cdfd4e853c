"""Blocks of ticks of two loops that took turns, and what they say: distributions, ratios, missed deadlines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

STEP_S = 0.005
BAR = 40  # characters of the longest bar
BARE, FIOHOST = "bare", "fiohost"


@dataclass
class Block:
    """One stretch of one loop: its time on the system's monotonic clock, and what the host saw."""

    loop: str
    begin_ns: int = 0
    end_ns: int = 0
    ticks: int = 0
    cpu_s: float = 0.0
    host_ns: list[int] = field(default_factory=list)  # from a report in hand to its answer handed over
    read_ns: list[int] = field(default_factory=list)
    board_ns: list[int] = field(default_factory=list)  # from a report's leaving the board to its answer's arrival
    missed: int = 0


def share_out(blocks: Sequence[Block], times: dict[str, list[int | None]]) -> None:
    """The board's times to the blocks that they fell in."""
    sent = np.array(times["sent_ns"])
    for block in blocks:
        first, last = np.searchsorted(sent, [block.begin_ns, block.end_ns - round(1e9 * STEP_S)])
        took = times["took_ns"][first:last]
        block.board_ns = [ns for ns in took if ns is not None and ns < 1e9 * STEP_S]
        block.missed = len(took) - len(block.board_ns)


def count_missed(blocks: Sequence[Block]) -> None:
    """Of a real board: task steps that passed between two answers."""
    for block in blocks:
        gaps = np.diff(np.array(block.read_ns[: len(block.host_ns)]) + np.array(block.host_ns[: len(block.read_ns)]))
        block.missed = int(np.sum(np.maximum(0, np.rint(gaps / (1e9 * STEP_S)) - 1)))


def figures(blocks: Sequence[Block], loop: str, key: str) -> dict[str, Any]:
    """Distribution of round trips in microseconds, CPU a tick, missed deadlines, of all blocks of one loop."""
    mine = [block for block in blocks if block.loop == loop]
    us = 1e-3 * np.concatenate([np.array(getattr(block, key), dtype=float) for block in mine])
    ticks = sum(block.ticks for block in mine)
    names = {"min": 0.0, "median": 50.0, "p95": 95.0, "p99": 99.0, "max": 100.0}
    return {
        "round_trip_us": {name: round(float(np.percentile(us, q)), 1) for name, q in names.items()},
        "cpu_us_per_tick": round(1e6 * sum(block.cpu_s for block in mine) / ticks, 1),
        "ticks": ticks,
        "seconds": round(1e-9 * sum(block.end_ns - block.begin_ns for block in mine), 1),
        "missed_deadlines": sum(block.missed for block in mine),
    }


def ratios(blocks: Sequence[Block], key: str) -> dict[str, Any]:
    """fiohost over bare: of all, and of each pair of neighbouring blocks."""
    pairs = [
        float(np.median(getattr(b, key)) / np.median(getattr(a, key)))
        for a, b in zip(blocks[::2], blocks[1::2], strict=True)
    ]
    return {"pairs": [round(ratio, 3) for ratio in pairs], "median_of_pairs": round(float(np.median(pairs)), 3)}


def histogram(blocks: Sequence[Block], key: str, rows: int = 12) -> str:
    """Both distributions on one scale, up to where a hundredth of the slower one lies beyond."""
    both = {
        loop: 1e-3 * np.concatenate([np.array(getattr(b, key), dtype=float) for b in blocks if b.loop == loop])
        for loop in (BARE, FIOHOST)
    }
    low, high = min(x.min() for x in both.values()), max(np.percentile(x, 99.0) for x in both.values())
    edges = np.append(np.linspace(low, high, rows + 1), np.inf)
    counts = {loop: np.histogram(x, edges)[0] / x.size for loop, x in both.items()}
    most = max(c.max() for c in counts.values())
    lines = [f"{'us':>14s}  {BARE:<{BAR}s}  {FIOHOST}"]
    for i in range(rows + 1):
        span = f"{edges[i]:6.0f}..{edges[i + 1]:<6.0f}" if i < rows else f"{edges[i]:6.0f}..      "
        bars = ["#" * round(BAR * counts[loop][i] / most) for loop in (BARE, FIOHOST)]
        lines.append(f"{span}  {bars[0]:<{BAR}s}  {bars[1]}".rstrip())
    return "\n".join(lines)
