"""The noise of one record: what its bootstrap samples are drawn with, and what whitens its windows."""

from __future__ import annotations

from dataclasses import dataclass, field

from fiohost.noise.estimate import Noise
from fiohost.noise.whiten import Whitener


@dataclass(frozen=True)
class Disturbance:
    """Noise as estimated, and the whitener of a record's windows by it; None: bootstrap samples only."""

    noise: Noise
    whitener: Whitener | None = field(default=None, repr=False)
