"""A plant: motor, bridge and load as a set of constants that belongs together, with the effects it has.

Its file also holds what a board around it may have: missing pull-ups, a watchdog, a thermal shutdown, faults.
"""

from __future__ import annotations

import errno
import math
import os
import stat
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from firmware_model import faults, thermal
from firmware_model.effect import Parameter
from firmware_model.errors import FirmwareModelError
from firmware_model.reading import number, parameters, unknown
from firmware_model.registry import effects

TINY = 1e-12
MAX_BYTES = 1_000_000  # of a plant's file
OWN, OWN_GROUP = "FIOHOST_CONFIGS", "fiohost.configs"  # where plants of the user's are

MOTOR = (
    Parameter("R_ohm", lower=1e-3, upper=1e4),
    Parameter("L_H", default=0.0, lower=0.0, upper=10.0),
    Parameter("Kt_Nm_per_A", lower=1e-6, upper=1e3),
    Parameter("Ke_Vs_per_rad", lower=1e-6, upper=1e3),
    Parameter("J_kgm2", lower=TINY, upper=1e3),
    Parameter("B_Nms", default=0.0, lower=0.0, upper=1e3),
    Parameter("coulomb_Nm", default=0.0, lower=0.0, upper=1e3),
    Parameter("supply_V", lower=0.1, upper=1e3),
)
OPTIONS = {  # tables of the board: each is there or not
    "watchdog": (Parameter("timeout_s", default=0.1, lower=0.005, upper=60.0),),
    "thermal_shutdown": thermal.PARAMETERS,
    "faults": faults.PARAMETERS,
}
PWM_HZ = 20000.0
KEYS = (
    *(q.key for q in MOTOR), *OPTIONS,
    "name", "source", "counts_per_rev", "pull_ups", "pwm", "pwm_hz", "effects", "schema",
)  # fmt: skip
PWM = ("averaged", "edge_resolved")
SCHEMA = "firmware_model.plant/1"


@dataclass(frozen=True)
class Plant:
    """Constants of a motor referred to its output shaft, SI units; ``effects`` maps a name to its SI parameters.

    ``supply_V`` is the winding's voltage at full duty. ``J_kgm2`` is all inertia, loads behind a gap or spring
    included. The options of the board (None: it has none) map the keys of OPTIONS to their values.
    """

    name: str
    R_ohm: float
    L_H: float
    Kt_Nm_per_A: float
    Ke_Vs_per_rad: float
    J_kgm2: float
    B_Nms: float
    coulomb_Nm: float
    supply_V: float
    counts_per_rev: int = 720
    source: str = ""
    effects: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    pull_ups: bool = True
    watchdog: Mapping[str, Any] | None = None
    thermal_shutdown: Mapping[str, Any] | None = None
    faults: Mapping[str, Any] | None = None
    pwm: str = PWM[0]
    pwm_hz: float = PWM_HZ

    def percent_of_torque(self, torque_Nm: float) -> float:
        """The duty in percent whose stall torque balances ``torque_Nm``: 100 T R / (Kt V)."""
        return 100.0 * torque_Nm * self.R_ohm / (self.Kt_Nm_per_A * self.supply_V)

    @property
    def inductance_H(self) -> float:
        """The winding's inductance, from the plant's own key or from the effect."""
        return max(self.L_H, float(self.effects.get("armature_inductance", {}).get("inductance_H", 0.0)))

    @property
    def gain_deg_s_per_pct(self) -> float:
        """Speed per percent of duty without dry friction: K = Kt V / (100 (Kt Ke + R B))."""
        damping = self.Kt_Nm_per_A * self.Ke_Vs_per_rad + self.R_ohm * self.B_Nms
        return math.degrees(0.01 * self.supply_V * self.Kt_Nm_per_A / damping)

    @property
    def tau_s(self) -> float:
        """Mechanical time constant without inductance: J R / (Kt Ke + R B)."""
        return self.J_kgm2 * self.R_ohm / (self.Kt_Nm_per_A * self.Ke_Vs_per_rad + self.R_ohm * self.B_Nms)

    def reduced(self) -> dict[str, dict[str, Any]]:
        """What a log can tell of this plant: parameters in percent of duty, degrees and seconds, by effect."""
        result: dict[str, dict[str, Any]] = {
            "linear": {"gain_deg_s_per_pct": self.gain_deg_s_per_pct, "tau_s": self.tau_s}
        }
        if self.coulomb_Nm > 0.0:
            # Viscous damping and dry friction are separate here, as they are in the reduced model.
            result["coulomb_friction"] = {"level_pct": self.percent_of_torque(self.coulomb_Nm)}
        if self.L_H > 0.0:
            result["armature_inductance"] = {"time_constant_s": self.L_H / self.R_ohm}
        for name, values in self.effects.items():
            result[name] = effects()[name].reduced(self, values)
        return result


def check_pwm(value: Any, where: str) -> str:
    """The way in which the PWM is simulated, as in the key ``pwm``."""
    if not isinstance(value, str) or value not in PWM:
        raise FirmwareModelError(f"{where}: pwm must be one of {', '.join(PWM)}, not {value!r}")
    return value


def make_plant(table: Mapping[str, Any], name: str) -> Plant:
    """A plant from the tables of its file; ``name`` is used in messages."""
    where = f"plant {name!r}"
    known = {*KEYS}
    for key in table:
        if key not in known:
            raise unknown(key, known, where)
    if table.get("schema", SCHEMA) != SCHEMA:
        raise FirmwareModelError(f"{where}: schema {table['schema']!r} is not {SCHEMA!r}")
    for key in ("name", "source"):
        if not isinstance(table.get(key, ""), str):
            raise FirmwareModelError(f"{where}: {key} must be text, not {table[key]!r}")
    motor_keys = {q.key for q in MOTOR}
    motor = parameters({k: v for k, v in table.items() if k in motor_keys}, MOTOR, where)
    counts = number(table.get("counts_per_rev", 720), "counts_per_rev", where, 4, 65536)
    if counts != int(counts):
        raise FirmwareModelError(f"{where}: counts_per_rev must be a whole number, not {counts}")
    pull_ups = table.get("pull_ups", True)
    if not isinstance(pull_ups, bool):
        raise FirmwareModelError(f"{where}: pull_ups must be true or false, not {pull_ups!r}")
    pwm = check_pwm(table.get("pwm", PWM[0]), where)
    pwm_hz = number(table.get("pwm_hz", PWM_HZ), "pwm_hz", where, 10.0, 1e6)
    options: dict[str, Any] = {
        key: parameters(_table(table[key], key, where), wanted, f"{where}, [{key}]")
        for key, wanted in OPTIONS.items()
        if key in table
    }
    if "faults" in options:
        faults.check(options["faults"], f"{where}, [faults]")
    given = table.get("effects", {})
    if not isinstance(given, Mapping):
        raise FirmwareModelError(f"{where}: effects must be tables [effects.NAME], not {given!r}")
    chosen: dict[str, Mapping[str, Any]] = {}
    for effect_name, values in given.items():
        if effect_name not in effects():
            raise unknown(effect_name, effects(), f"{where}, effects")
        values = _table(values, f"effects.{effect_name}", where)
        chosen[effect_name] = parameters(values, effects()[effect_name].parameters, f"{where}, [effects.{effect_name}]")
    plant = Plant(
        name=str(table.get("name", name)),
        source=str(table.get("source", "")),
        counts_per_rev=int(counts),
        effects=chosen,
        pull_ups=pull_ups,
        pwm=pwm,
        pwm_hz=pwm_hz,
        **options,
        **motor,
    )
    for effect_name, checked in chosen.items():
        load = float(checked.get("load_inertia_kgm2", 0.0))
        if load >= plant.J_kgm2:
            raise FirmwareModelError(
                f"{where}, [effects.{effect_name}]: load_inertia_kgm2 = {load:g} must be less than the whole "
                f"inertia J_kgm2 = {plant.J_kgm2:g} of which it is a part"
            )
    return plant


def _table(value: Any, name: str, where: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise FirmwareModelError(f"{where}: [{name}] must be a table, not {value!r}")
    return value


def _folder() -> Path:
    """Where the named plants are: in the installed package, else in the checkout."""
    here = Path(__file__).resolve().parent
    installed = here / "plants"
    return installed if installed.is_dir() else here.parent / "configs" / "plants"


def _own_folders() -> list[Path]:
    """Folders of plants of the user's (``plants`` in those that ``FIOHOST_CONFIGS`` names) and of packages that declare
    themselves as entry points of the group ``fiohost.configs``. Raises FirmwareModelError for one that is not there.
    """
    roots = [Path(part).expanduser() for part in os.environ.get(OWN, "").split(os.pathsep) if part]
    for root in roots:
        if not root.is_dir():
            raise FirmwareModelError(f"{OWN} names {str(root)!r}, which is no folder")
    for point in sorted(entry_points(group=OWN_GROUP), key=lambda p: (p.name, p.value)):
        spec = find_spec(point.value)
        if spec is None or not spec.submodule_search_locations:
            raise FirmwareModelError(f"plants of another package: {point.value} is no package with a folder")
        roots += [Path(place) for place in spec.submodule_search_locations]
    return [root / "plants" for root in roots if (root / "plants").is_dir()]


def _named() -> dict[str, Path]:
    """The plants that are known by a name: the shipped ones and the user's own."""
    found = {path.stem: path for path in _folder().glob("*.toml")}
    for folder in _own_folders():
        for path in sorted(folder.glob("*.toml")):
            if path.stem in found and not path.samefile(found[path.stem]):
                raise FirmwareModelError(
                    f"there are two plants of the name {path.stem!r}: {found[path.stem]} and {path}; rename yours"
                )
            found[path.stem] = path
    return found


def plant_names() -> list[str]:
    """Names of the plants that ship with the package, and of the user's own."""
    return sorted(_named())


def _text_of(path: Path) -> str:
    """The text of a file of at most MAX_BYTES. Raises OSError, ValueError."""
    fd = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0))  # a pipe must not hold us
    try:
        if not stat.S_ISREG(os.fstat(fd).st_mode):
            raise OSError(errno.EINVAL, "it is not a file, but a folder, a device or a pipe")
        data = os.read(fd, MAX_BYTES + 1)
    finally:
        os.close(fd)
    if len(data) > MAX_BYTES:
        raise OSError(errno.EFBIG, f"it is larger than {MAX_BYTES // 1_000_000} MB, more than a plant can need")
    return data.decode("utf-8")


def load_plant(path_or_name: str | Path) -> Plant:
    """A plant by the name of a shipped one, or from a TOML file (a name with a slash or ending in .toml)."""
    text = str(path_or_name)
    is_path = isinstance(path_or_name, Path) or text.endswith(".toml") or "/" in text or "\\" in text
    known = {} if is_path else _named()
    if not is_path and text not in known:
        raise FirmwareModelError(f"no plant named {text!r}; there are: {', '.join(sorted(known))}")
    path = Path(text) if is_path else known[text]
    try:
        table = tomllib.loads(_text_of(path))
    except OSError as error:
        raise FirmwareModelError(f"cannot read plant file {path}: {error.strerror}") from error
    except (ValueError, RecursionError) as error:  # not TOML, not UTF-8, numbers or nesting beyond all measure
        raise FirmwareModelError(f"plant file {path} is not valid TOML: {error}") from error
    return make_plant(table, path.stem)
