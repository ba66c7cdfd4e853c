"""How well the ticks were kept, and what came of the reports."""

from __future__ import annotations

from fiohost.wire.link import LinkCounts


class TickStatistics:
    """Counts ticks and how late they were against their deadlines. In virtual time nothing is ever late."""

    def __init__(self, sample_time_s: float, *, real: bool) -> None:
        self.real = real
        self.ticks = 0
        self.late = 0  # more than half a tick after the deadline
        self.worst_s = 0.0
        self.silent = 0  # ticks without telemetry
        self.refused = 0  # ticks whose report could not be one
        self.passed_over = 0  # reports older than the one read
        self.host_late = 0  # ticks missed or answered late because this computer was
        self.slowed = 0  # commands held back by the slew limit
        self.link = LinkCounts()
        self._sum_s = 0.0
        self._limit_s = 0.5 * sample_time_s

    def count(self, late_s: float) -> None:
        """One tick; below 0 is early, and not late."""
        self.ticks += 1
        if late_s > 0.0:
            self._sum_s += late_s
            if late_s > self.worst_s:
                self.worst_s = late_s
            if late_s > self._limit_s:
                self.late += 1

    @property
    def mean_s(self) -> float:
        """Mean lateness in seconds."""
        return self._sum_s / self.ticks if self.ticks else 0.0

    def describe(self) -> str:
        """One line for people and for the log's head."""
        if not self.real:
            said = f"{self.ticks} ticks in virtual time"
        else:
            said = (
                f"{self.ticks} ticks; {self.late} late by more than half a tick; "
                f"lateness mean {1e3 * self.mean_s:.2f} ms, worst {1e3 * self.worst_s:.2f} ms"
            )
        faults = {
            "without telemetry": self.silent,
            "with a report that was refused": self.refused,
            "surplus reports": self.passed_over,
            "missed or late because of this computer": self.host_late,
            "commands held back by the slew limit": self.slowed,
        }
        told = [f"{count} {what}" for what, count in faults.items() if count]
        return "; ".join([said, *told, *self.link.describe()])

    def as_dict(self) -> dict[str, object]:
        return {
            "ticks": self.ticks,
            "virtual_time": not self.real,
            "late": self.late,
            "without_telemetry": self.silent,
            "refused_reports": self.refused,
            "surplus_reports": self.passed_over,
            "host_late": self.host_late,
            "slowed_commands": self.slowed,
            **self.link.as_dict(),
            "mean_lateness_ms": round(1e3 * self.mean_s, 4),
            "worst_lateness_ms": round(1e3 * self.worst_s, 4),
        }
