"""The control law as one piece: controller, deadband compensation, limit (Fig. 2.13 of the lab text)."""

from __future__ import annotations

from dataclasses import dataclass, field

from fiohost.control.controllers import Controller
from fiohost.control.deadband import DeadbandCompensator
from fiohost.errors import ConfigError


def saturate(value: float, limit: float) -> float:
    """*value* held within +-*limit*. NaN stays NaN, so that the wire refuses it."""
    if value > limit:
        return limit
    if value < -limit:
        return -limit
    return value


@dataclass(frozen=True)
class ControlLaw:
    """From reference and angle (deg) to the duty (percent) that is sent."""

    controller: Controller
    compensator: DeadbandCompensator = field(default_factory=DeadbandCompensator)
    limit_pct: float = 100.0

    def __post_init__(self) -> None:
        if not 0.0 < self.limit_pct <= 100.0:
            raise ConfigError(f"limit_pct = {self.limit_pct:g} is not above 0 and at most 100")

    def reset(self) -> None:
        self.controller.reset()

    def step(self, ref_deg: float, angle_deg: float) -> float:
        """The duty of this tick, within the limit."""
        wanted = self.controller.step(ref_deg, angle_deg)
        compensated = self.compensator.apply(wanted)
        sent = saturate(compensated, self.limit_pct)
        self.controller.applied(wanted + (sent - compensated))
        return sent
