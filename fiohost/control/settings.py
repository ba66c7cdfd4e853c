"""The settings of a control law: as people write them, as a law for a run, as a loop for a simulation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from fiohost.control.controllers import PD, PI, PID, Controller, P
from fiohost.control.deadband import DeadbandCompensator
from fiohost.control.law import ControlLaw
from fiohost.files import write_output
from fiohost.settings import Table, read_toml

if TYPE_CHECKING:
    from fiohost.control.closed_loop import Loop

SCHEMA = "fiohost.controller/1"
KINDS = ("p", "pd", "pi", "pid")


@dataclass(frozen=True)
class ControlSettings:
    """Controller, deadband compensation and limit; :meth:`law` makes one for a run.

    The derivative counts for pd and pid, the integral for pi and pid.
    """

    kind: str = "p"
    kp_pct_per_deg: float = 1.0
    kd_pct_s_per_deg: float = 0.0
    filter_s: float = 0.0
    derivative_on: str = "error"
    limit_pct: float = 100.0
    u_plus_pct: float = 0.0
    u_minus_pct: float = 0.0
    threshold_pct: float = 0.0
    ki_pct_per_deg_s: float = 0.0
    tracking_s: float = 0.0

    @property
    def _differentiates(self) -> bool:
        return self.kind in ("pd", "pid")

    @property
    def _integrates(self) -> bool:
        return self.kind in ("pi", "pid")

    def law(self, sample_time_s: float) -> ControlLaw:
        """A fresh control law. Raises ConfigError for values that make none."""
        compensator = DeadbandCompensator(self.u_plus_pct, self.u_minus_pct, self.threshold_pct)
        return ControlLaw(self._controller(sample_time_s), compensator, self.limit_pct)

    def _controller(self, sample_time_s: float) -> Controller:
        kp, ki, kd, on_angle = (
            self.kp_pct_per_deg, self.ki_pct_per_deg_s, self.kd_pct_s_per_deg, self.derivative_on == "angle"
        )  # fmt: skip
        if self.kind == "pid":
            return PID(kp, ki, kd, sample_time_s, self.filter_s, on_angle, self.tracking_s)
        if self.kind == "pi":
            return PI(kp, ki, sample_time_s, self.tracking_s)
        return PD(kp, kd, sample_time_s, self.filter_s, on_angle) if self.kind == "pd" else P(kp)

    def loop(self, sample_time_s: float, delay_s: float, quantum_deg: float) -> Loop:
        """The same law over a model. Raises ConfigError for values that make none."""
        from fiohost.control.closed_loop import Loop  # brings the compiled kernel, which a run does not need

        return Loop(
            self.kp_pct_per_deg,
            self.ki_pct_per_deg_s if self._integrates else 0.0,
            self.kd_pct_s_per_deg if self._differentiates else 0.0,
            self.filter_s,
            derivative_on_angle=self.derivative_on == "angle",
            limit_pct=self.limit_pct,
            u_plus_pct=self.u_plus_pct,
            u_minus_pct=self.u_minus_pct,
            threshold_pct=self.threshold_pct,
            sample_time_s=sample_time_s,
            delay_s=delay_s,
            quantum_deg=quantum_deg,
            tracking_s=self.tracking_s,
        )

    def with_compensation(self, u_plus_pct: float, u_minus_pct: float) -> ControlSettings:
        return replace(self, u_plus_pct=u_plus_pct, u_minus_pct=u_minus_pct)

    @classmethod
    def from_tables(cls, controller: Table, deadband: Table) -> ControlSettings:
        """Read ``[controller]`` and ``[deadband]``, each key only where the kind has it. Raises ConfigError."""
        kind = controller.text("kind", choices=KINDS)
        found = cls(
            kind=kind,
            kp_pct_per_deg=controller.number("kp_pct_per_deg", low=-1e4, high=1e4),
            limit_pct=controller.number("limit_pct", 100.0, low=0.1, high=100.0),
            u_plus_pct=deadband.number("u_plus_pct", 0.0, low=0.0, high=99.0),
            u_minus_pct=deadband.number("u_minus_pct", 0.0, low=-99.0, high=0.0),
            threshold_pct=deadband.number("threshold_pct", 0.0, low=0.0, high=100.0),
        )
        if found._integrates:
            found = replace(
                found,
                ki_pct_per_deg_s=controller.number("ki_pct_per_deg_s", low=-1e4, high=1e4),
                tracking_s=controller.number("tracking_s", 0.0, low=0.0, high=1e4),
            )
        if found._differentiates:
            found = replace(
                found,
                kd_pct_s_per_deg=controller.number("kd_pct_s_per_deg", low=-1e4, high=1e4),
                filter_s=controller.number("filter_s", 0.0, low=0.0, high=100.0),
                derivative_on=controller.text("derivative_on", "error", choices=("error", "angle")),
            )
        controller.finish()
        deadband.finish()
        return found

    @classmethod
    def load(cls, path: Path) -> ControlSettings:
        """Read a ``fiohost.controller/1`` file. Raises ConfigError."""
        top = read_toml(path)
        top.schema(SCHEMA)
        found = cls.from_tables(top.table("controller", required=True), top.table("deadband"))
        top.finish()
        return found

    def save(self, path: Path, comment: str = "") -> None:
        """Write a ``fiohost.controller/1`` file. Raises FiohostError if it cannot be written."""
        lines = [*(f"# {line}" for line in comment.splitlines()), f'schema = "{SCHEMA}"', "", *self.to_toml()]
        write_output(path, "\n".join(lines) + "\n")

    def describe_numbers(self) -> dict[str, float | str]:
        """Every setting that the kind has, as it is."""
        return {**self._gains(), **self._compensation()}

    def _gains(self) -> dict[str, float | str]:
        """The settings of the controller that its kind has, units in the keys."""
        found: dict[str, float | str] = {"kp_pct_per_deg": self.kp_pct_per_deg}
        if self._integrates:
            found |= {"ki_pct_per_deg_s": self.ki_pct_per_deg_s, "tracking_s": self.tracking_s}
        if self._differentiates:
            found |= {"kd_pct_s_per_deg": self.kd_pct_s_per_deg, "filter_s": self.filter_s}
            found |= {"derivative_on": self.derivative_on}
        return {**found, "limit_pct": self.limit_pct}

    def _compensation(self) -> dict[str, float]:
        names = ("u_plus_pct", "u_minus_pct", "threshold_pct")
        return {name: getattr(self, name) for name in names}

    def to_toml(self) -> list[str]:
        """The lines that :meth:`from_tables` reads."""
        lines = ["[controller]", f'kind = "{self.kind}"']
        lines += [f'{k} = "{v}"' if isinstance(v, str) else f"{k} = {v!r}" for k, v in self._gains().items()]
        return [*lines, "", "[deadband]", *(f"{k} = {v!r}" for k, v in self._compensation().items())]

    def describe(self) -> dict[str, str]:
        """Metadata of a log, units in the keys."""
        found = {"controller": self.kind, **self._gains(), **self._compensation()}
        return {key: value if isinstance(value, str) else f"{value:.12g}" for key, value in found.items()}
