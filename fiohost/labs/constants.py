"""A motor's constants in SI units at the output shaft: the lab appendix's sets, and files of one's own.

The physical form of a model, converted one way into the reduced form that a log can tell. Full scale belongs to the
set: the appendix's resistance is from HALF the voltage between the wires, so its sets are whole at 4.5 V only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path

from fiohost.errors import ConfigError
from fiohost.files import write_output
from fiohost.motor.model import Model
from fiohost.settings import exists, nearest, read_toml

SCHEMA = "fiohost.constants/1"
BOUNDS = {
    "R_ohm": (1e-3, 1e4),
    "L_H": (0.0, 10.0),
    "Kt_Nm_per_A": (1e-6, 1e3),
    "Ke_Vs_per_rad": (1e-6, 1e3),
    "J_kgm2": (1e-12, 1e3),
    "B_Nms": (0.0, 1e3),
    "coulomb_Nm": (0.0, 1e3),
    "supply_V": (0.1, 1e3),
}
NEEDED = ("R_ohm", "Kt_Nm_per_A", "Ke_Vs_per_rad", "J_kgm2", "supply_V")


@dataclass(frozen=True)
class MotorConstants:
    """Winding, torque and back-emf constants (the text's Ki and Kb), inertia, friction; ``supply_V`` is full duty."""

    R_ohm: float
    Kt_Nm_per_A: float
    Ke_Vs_per_rad: float
    J_kgm2: float
    B_Nms: float
    supply_V: float
    L_H: float = 0.0
    coulomb_Nm: float = 0.0
    source: str = ""

    def __post_init__(self) -> None:
        for key, (low, high) in BOUNDS.items():
            value = getattr(self, key)
            if not low <= value <= high:  # NaN fails this too
                raise ConfigError(f"{key} = {value!r} of a motor's constants is outside {low:g}..{high:g}")

    @classmethod
    def load(cls, name_or_path: str) -> MotorConstants:
        """A set of the text by its name (``TEXT``), or a ``fiohost.constants/1`` file. Raises ConfigError."""
        if name_or_path in TEXT:
            return TEXT[name_or_path]
        path = Path(name_or_path)
        if path.suffix != ".toml" and not exists(path):
            raise ConfigError(
                f"unknown constants {name_or_path!r}; {nearest(name_or_path, TEXT)} (or give a .toml file)"
            )
        table = read_toml(path)
        table.schema(SCHEMA)
        values = {
            key: table.number(key, None if key in NEEDED else 0.0, low=low, high=high)
            for key, (low, high) in BOUNDS.items()
        }
        source = table.text("source", "")
        table.finish()
        return cls(source=source or str(path), **values)

    def write(self, path: Path) -> None:
        """Write the file that :meth:`load` reads. Raises ConfigError."""
        source = self.source.replace("\\", "/").replace('"', "'")
        lines = [f'schema = "{SCHEMA}"', f'source = "{source}"']
        lines += [f"{key} = {getattr(self, key)!r}" for key in BOUNDS]
        write_output(path, "\n".join(lines) + "\n")

    @property
    def damping_Nms(self) -> float:
        """B + Ki Kb / Ra: what slows the shaft, friction and back-emf together."""
        return self.B_Nms + self.Kt_Nm_per_A * self.Ke_Vs_per_rad / self.R_ohm

    @property
    def speed_per_volt(self) -> float:
        """Steady speed in rad/s for a volt, Ki / (Ki Kb + Ra B) (the text's Eq. 7-15)."""
        return self.Kt_Nm_per_A / (self.R_ohm * self.damping_Nms)

    @property
    def tau_m_s(self) -> float:
        """Mechanical time constant, from Eq. D-13."""
        return self.J_kgm2 / self.damping_Nms

    @property
    def winding_s(self) -> float:
        """Electrical time constant La / Ra."""
        return self.L_H / self.R_ohm

    @property
    def pct_per_volt(self) -> float:
        """The text's block from volts to percent."""
        return 100.0 / self.supply_V

    def torque_pct(self, torque_Nm: float) -> float:
        """The duty in percent that balances a torque at rest: 100 T R / (Ki V)."""
        return 100.0 * torque_Nm * self.R_ohm / (self.Kt_Nm_per_A * self.supply_V)

    def with_inertia(self, J_kgm2: float) -> MotorConstants:
        return replace(self, J_kgm2=J_kgm2)

    def model(self, *, volt_limit_V: float | None = None, current_limit_A: float | None = None) -> Model:
        """The reduced model that the fit uses, with a load that may be set, winding lag, dry friction and limits.

        Its current counts viscous friction as back-emf, so a current limit is off by B w / Ki, 0.04 A at 7.6 rad/s,
        unless whoever runs it corrects for that (``play_model`` does).
        """
        model = Model(
            values={
                "linear.gain_deg_s_per_pct": math.degrees(self.speed_per_volt) / self.pct_per_volt,
                "linear.tau_s": self.tau_m_s,
            }
        ).with_effect("constant_load", {"level_pct": 0.0})
        if self.L_H > 0.0:
            model = model.with_effect("armature_inductance", {"time_constant_s": self.L_H / self.R_ohm})
        if self.coulomb_Nm > 0.0:
            model = model.with_effect("coulomb_friction", {"level_pct": self.torque_pct(self.coulomb_Nm)})
        if volt_limit_V is not None:
            limit = min(volt_limit_V * self.pct_per_volt, 100.0)
            model = model.with_effect("voltage_saturation", {"limit_pct": limit})
        if current_limit_A is not None:
            limit = min(100.0 * current_limit_A * self.R_ohm / self.supply_V, 200.0)
            model = model.with_effect("current_limit", {"limit_pct": limit})
        return model


def _set(where: str, J_kgm2: float, B_Nms: float) -> MotorConstants:
    return MotorConstants(
        R_ohm=2.27, L_H=0.0047, Kt_Nm_per_A=0.25, Ke_Vs_per_rad=0.25, J_kgm2=J_kgm2, B_Nms=B_Nms, supply_V=4.5,
        source=f"control lab appendix, table {where}",
    )  # fmt: skip


TEXT = {
    "no_load": _set("D-6", 0.00233, 0.00131),
    "arm_measured": _set("D-8", 0.00302, 0.0027),
    "arm_tuned": _set("D-10", 0.00273, 0.0027),
    "elevator": _set("D-11", 0.0024, 0.002),
}
