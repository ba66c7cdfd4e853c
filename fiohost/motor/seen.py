"""What a model was fitted to went through: beyond it, the model extrapolates.

Kept in model files beside the parameters, so that whoever uses one is told.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

# Beyond what was seen by more than this share of it, a model extrapolates.
BEYOND = 0.1
RANGES = ("duty_pct", "speed")


@dataclass(frozen=True)
class Seen:
    """Ranges (low, high) of duty in percent, of speed in the output's unit per second (of a speed: its unit) as means
    over a tenth of a second, the longest time in s that one command was held, and whether the bridge was open.
    """

    duty_pct: tuple[float, float]
    speed: tuple[float, float]
    hold_s: float
    coasted: bool

    def to_json(self) -> dict[str, Any]:
        return {
            "duty_pct": list(self.duty_pct),
            "speed": list(self.speed),
            "hold_s": self.hold_s,
            "coasted": self.coasted,
        }

    def scaled(self, factor: float) -> Seen:
        """The same with speeds in another unit."""
        return Seen(self.duty_pct, (self.speed[0] * factor, self.speed[1] * factor), self.hold_s, self.coasted)

    def beyond(self, other: Seen, speed_unit: str = "") -> list[str]:
        """Where another data set leaves what was seen here, a sentence's part each."""
        found = []
        for name, unit, own, there in (
            ("duty", "%", self.duty_pct, other.duty_pct),
            ("speed", speed_unit, self.speed, other.speed),
        ):
            room = BEYOND * max(own[1] - own[0], abs(own[0]), abs(own[1]))
            for value, known, out in (
                (there[0], own[0], there[0] < own[0] - room),
                (there[1], own[1], there[1] > own[1] + room),
            ):
                if out:
                    found.append(f"{name} {value:.4g} {unit}".rstrip() + f", seen to {known:.4g} {unit}".rstrip())
        if other.hold_s > (1.0 + BEYOND) * self.hold_s:
            found.append(f"a command held {other.hold_s:.3g} s, longest seen {self.hold_s:.3g} s")
        if other.coasted and not self.coasted:
            found.append("an open bridge, never seen")
        return found


def together(parts: Sequence[Seen]) -> Seen:
    """What several data sets went through."""
    return Seen(
        (min(p.duty_pct[0] for p in parts), max(p.duty_pct[1] for p in parts)),
        (min(p.speed[0] for p in parts), max(p.speed[1] for p in parts)),
        max(p.hold_s for p in parts),
        any(p.coasted for p in parts),
    )
