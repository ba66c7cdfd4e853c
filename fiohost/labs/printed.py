"""The text's own printed responses, shipped as readings, each beside the constants and the limit that it belongs to.

The files are ``configs/readings/nxt_d7.toml`` to ``nxt_d15.toml`` (schema ``fiohost.readings/1``), which
``fiohost lab tables`` judges too. A row measured on one motor says nothing of another, so it is shown nowhere else.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

from fiohost.labs.constants import TEXT, MotorConstants
from fiohost.settings import find_config, read_text

SIMULATED, MEASURED = "simulated", "measured"
HALF_V, FULL_V = 2.25, 4.5
STEP_DEG = 160.0


@dataclass(frozen=True)
class Printed:
    """One printed response: overshoot in percent, settling to 5 % and rise in seconds, and what it was made with."""

    table: str
    source: str
    settings: Mapping[str, float | str]
    overshoot_pct: float
    settling_5_s: float
    rise_s: float
    error: float | None

    @property
    def who(self) -> str:
        return f"text {self.table}, {self.source}"

    def has(self, **settings: float | str) -> bool:
        """Whether it was made with these settings."""
        return all(self.settings.get(key) == value for key, value in settings.items())


@cache
def printed(name: str) -> tuple[Printed, ...]:
    """All rows of a shipped file, simulated and measured. Raises ConfigError for an unknown name."""
    table = tomllib.loads(read_text(find_config("readings", name)))
    figures = ("overshoot_pct", "settling_5_s", "rise_s", "steady_state_error")
    found = []
    for row in table["row"]:
        source = str(row["source"])
        number = "D-12" if name == "nxt_d13" and source == SIMULATED else name.replace("nxt_d", "D-")
        settings = {key: value for key, value in row.items() if key not in (*figures, "source")}
        found.append(Printed(number, source, settings, *(row.get(key) for key in figures)))
    return tuple(found)


def position_rows(constants: MotorConstants, limit_V: float | None, step_deg: float, kp: float) -> tuple[Printed, ...]:
    """The text's rows for a position step: D-7 without load, D-9 for the arm with its voltage held within 2.25 V.

    What was measured on the arm stands beside both of its sets (D-8, D-10), what was simulated beside D-10 alone.
    """
    if step_deg != STEP_DEG:
        return ()
    name = next((name for name, known in TEXT.items() if known == constants), "")
    if name == "no_load" and limit_V in (FULL_V, None):
        rows = printed("nxt_d7")
    elif name in ("arm_measured", "arm_tuned") and limit_V == HALF_V:
        rows = tuple(row for row in printed("nxt_d9") if name == "arm_tuned" or row.source == MEASURED)
    else:
        return ()
    return tuple(row for row in rows if row.has(kp=kp) and (limit_V is not None or row.source == SIMULATED))
