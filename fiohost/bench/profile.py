"""A bench profile: what was measured on a bench once and later commands need, as a TOML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fiohost.errors import ConfigError
from fiohost.files import write_output
from fiohost.settings import exists, read_toml

SCHEMA = "fiohost.bench/1"
METHODS = ("ramp", "steps")
SHARE = 0.8  # of the deadband is compensated where nobody has tried out more: all of it makes a loop jitter


@dataclass(frozen=True)
class BenchProfile:
    """The deadband of both directions with its spread, and how much of it a precompensator may take away.

    ``u_plus_pct`` is 0 or more, ``u_minus_pct`` 0 or less, in percent of duty; ``share`` is 0 to 1.5.
    """

    target: str
    method: str
    u_plus_pct: float
    u_minus_pct: float
    u_plus_spread_pct: float = 0.0
    u_minus_spread_pct: float = 0.0
    share: float = SHARE

    @property
    def compensation_pct(self) -> tuple[float, float]:
        """What a precompensator (Eq. 2.6 of the lab text) adds forward and in reverse."""
        return self.share * self.u_plus_pct, self.share * self.u_minus_pct

    @classmethod
    def load(cls, path: str | Path) -> BenchProfile:
        """Read a profile. Raises ConfigError: unknown keys and values out of range are refused."""
        path = Path(path)
        if not exists(path):
            raise ConfigError(f"no bench profile {str(path)!r}; fiohost deadband --save {path.name} makes one")
        top = read_toml(path)
        top.schema(SCHEMA)
        target = top.text("target", "")
        deadband, compensation = top.table("deadband", required=True), top.table("compensation")
        top.finish()
        found = cls(
            target=target,
            method=deadband.text("method", METHODS[0], choices=METHODS),
            u_plus_pct=deadband.number("u_plus_pct", low=0.0, high=99.0),
            u_minus_pct=deadband.number("u_minus_pct", low=-99.0, high=0.0),
            u_plus_spread_pct=deadband.number("u_plus_spread_pct", 0.0, low=0.0, high=100.0),
            u_minus_spread_pct=deadband.number("u_minus_spread_pct", 0.0, low=0.0, high=100.0),
            share=compensation.number("share", SHARE, low=0.0, high=1.5),
        )
        deadband.finish()
        compensation.finish()
        return found

    def save(self, path: str | Path) -> None:
        """Write a profile that :meth:`load` reads. Raises FiohostError if it cannot be written."""
        target = self.target.replace("\\", "/").replace('"', "'")
        lines = [f'schema = "{SCHEMA}"', f'target = "{target}"', "", "[deadband]", f'method = "{self.method}"']
        for name in ("u_plus_pct", "u_plus_spread_pct", "u_minus_pct", "u_minus_spread_pct"):
            lines.append(f"{name} = {getattr(self, name)!r}")
        lines += ["", "[compensation]", f"share = {self.share!r}"]
        write_output(path, "\n".join(lines) + "\n")
