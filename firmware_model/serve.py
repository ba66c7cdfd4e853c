"""The board in real time: its task at absolute deadlines, its line open to any host.

A board in another process, on a pty, or on a Raspberry Pi's USB port is still the same board: one task step every 5 ms,
whether a host is there or not.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from firmware_model.formats import Receiver, make_format
from firmware_model.lines import Line

Step = Callable[[bytes | None], bytes | list[bytes]]

LOST_WAY_S = 1.0  # later than that (the computer slept), the steps missed are left out


@dataclass
class Kept:
    """How well the deadlines were kept."""

    steps: int = 0
    late: int = 0  # by more than half a step
    worst_s: float = 0.0

    def describe(self) -> str:
        return f"{self.steps} steps, {self.late} late by more than half a step, worst {1e3 * self.worst_s:.1f} ms"


def serve(
    step: Step,
    line: Line,
    layout: str,
    *,
    step_s: float = 0.005,
    repeats: int = 1,
    stop: Callable[[], bool] = lambda: False,
) -> Kept:
    """Run a board's *step* every *step_s* on *line* until *stop* says so, asked once a step.

    A stream's packets are taken one a step, as the target's parser takes them; of HID reports the newest counts.
    *repeats* sends each telemetry report more than once.
    """
    receiver = Receiver(make_format(layout)) if line.stream else None
    kept, due_s = Kept(), time.monotonic()
    while not stop():
        left_s = due_s - time.monotonic()
        if left_s > 0.0:
            time.sleep(left_s)
        late_s = time.monotonic() - due_s
        due_s = due_s + step_s if late_s < LOST_WAY_S else time.monotonic() + step_s
        kept.steps += 1
        kept.late += late_s > 0.5 * step_s
        kept.worst_s = max(kept.worst_s, late_s)
        came = line.receive()
        if receiver is not None:
            for piece in came:
                receiver.feed(piece)
            newest = receiver.take()
        else:
            newest = came[-1] if came else None
        sent = step(newest)
        for report in [sent] if isinstance(sent, bytes) else sent:
            for _ in range(repeats):
                line.send(report)
    return kept
