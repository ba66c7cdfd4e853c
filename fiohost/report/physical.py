"""Sizes in the user's units: percent of duty as volts, amperes and newton metres, as far as the constants are known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from fiohost.report.words import DASH, effect_words, interval, number, with_unit

PERCENT = "%"
# Effects whose percent is a voltage alone, not a torque at the shaft.
VOLTAGES = (
    "bridge_voltage_drop", "input_deadband", "asymmetric_deadband", "voltage_saturation", "duty_steps"
)  # fmt: skip
STRENGTHS = ("level", "extra", "forward", "reverse", "drop", "u_plus", "u_minus", "limit", "gap", "ratio", "delay")


@dataclass(frozen=True)
class Physical:
    """What is known beside the logs: volts of full duty, the winding's ohms, newton metres an ampere; None: unknown.

    A torque of *p* percent is what the shaft gives at rest at *p* percent of duty: ``p/100 full_scale_V`` volts, that
    over ``R_ohm`` amperes, that times ``Kt_Nm_per_A`` newton metres.
    """

    full_scale_V: float | None = None
    R_ohm: float | None = None
    Kt_Nm_per_A: float | None = None

    @classmethod
    def of(cls, told: Mapping[str, Any] | None) -> Physical:
        """From ``constants`` of a diagnosis' JSON, any of its keys."""
        known = told or {}
        return cls(*(known.get(key) for key in ("full_scale_V", "R_ohm", "Kt_Nm_per_A")))

    def to_json(self) -> dict[str, float]:
        return {key: value for key, value in asdict(self).items() if value is not None}

    @property
    def newton_metres_per_pct(self) -> float | None:
        """The torque of one percent of duty at rest."""
        if self.full_scale_V is None or self.R_ohm is None or self.Kt_Nm_per_A is None:
            return None
        return 0.01 * self.full_scale_V / self.R_ohm * self.Kt_Nm_per_A

    def words(self, pct: float, torque: bool = True, digits: int = 3) -> str:
        """``0.206 V, 0.0375 A, 0.0123 N m`` for a level in percent of duty; empty where nothing is known."""
        parts = []
        if self.full_scale_V is not None:
            volts = 0.01 * pct * self.full_scale_V
            parts.append(with_unit(volts, "V", digits))
            if torque and self.R_ohm is not None:
                parts.append(with_unit(volts / self.R_ohm, "A", digits))
        if torque and self.newton_metres_per_pct is not None:
            parts.append(with_unit(pct * self.newton_metres_per_pct, "N m", digits))
        return ", ".join(parts)


def constants_of(metadata: Iterable[Mapping[str, str]], constants: Any | None = None) -> Physical:
    """What logs' heads say, where they agree (``supply_V``, or ``full_scale`` in V), and a set of motor constants.

    ``constants`` is a :class:`fiohost.labs.constants.MotorConstants`; its supply counts where the logs name none.
    """
    volts = {_volts(head) for head in metadata}
    full = volts.pop() if len(volts) == 1 else None
    if constants is None:
        return Physical(full)
    return Physical(full or constants.supply_V, constants.R_ohm, constants.Kt_Nm_per_A)


def _volts(head: Mapping[str, str]) -> float | None:
    """Volts at full duty by one log's head."""
    text = head.get("full_scale") if head.get("full_scale_unit") == "V" else head.get("supply_V")
    try:
        value = float(text) if text else 0.0
    except ValueError:
        return None
    return value if 0.0 < value < 1e5 else None


def unit_words(unit: str) -> str:
    """``% of duty`` for a torque's percent."""
    return "% of duty" if unit == PERCENT else unit


def size_rows(diagnosis: Mapping[str, Any]) -> list[dict[str, str]]:
    """What was found, a row a parameter: ``effect`` (in the first row of each), ``parameter``, ``value``, ``interval``,
    ``physical``.
    """
    known = Physical.of(diagnosis.get("constants"))
    rows = []
    for step in diagnosis.get("steps") or []:
        name = str(step.get("effect"))
        for i, (key, told) in enumerate((step.get("parameters") or {}).items()):
            value, unit = told.get("value"), str(told.get("unit") or "")
            text = effect_words(value) if isinstance(value, str) else with_unit(value, unit_words(unit), 4)
            bounds = interval(told)
            in_percent = unit == PERCENT and isinstance(value, (int, float))
            rows.append(
                {
                    "effect": "" if i else effect_words(name),
                    "parameter": spoken(key),
                    "value": text,
                    "interval": "" if bounds == DASH else with_interval(bounds, unit),
                    "physical": known.words(float(value), name not in VOLTAGES) if in_percent else "",
                }
            )
    return rows


def with_interval(bounds: str, unit: str) -> str:
    return f"{bounds} {unit_words(unit)}".rstrip()


def spoken(parameter: str) -> str:
    """``level`` for ``level_pct``: the unit stands beside the number."""
    for tail in ("_deg_s_per_pct", "_pct", "_deg_s", "_deg", "_hz", "_us", "_s"):
        if parameter.endswith(tail):
            return effect_words(parameter.removesuffix(tail))
    return effect_words(parameter)


def _strength(told: Mapping[str, Any]) -> str | None:
    """The parameter that says how large an effect is; of several of one kind, as levels of orders, the largest."""
    for kind in STRENGTHS:
        keys = [k for k in told if k.startswith(kind) and isinstance(told[k].get("value"), (int, float))]
        if keys:
            return max(keys, key=lambda k: abs(float(told[k]["value"])))
    return next(iter(told), None)


def headline(diagnosis: Mapping[str, Any]) -> str:
    """The size of what was found in one line: ``gravity load 2.285 % of duty (0.206 V)``; empty where nothing was."""
    known = Physical.of(diagnosis.get("constants"))
    parts = []
    for step in diagnosis.get("steps") or []:
        name, told = str(step.get("effect")), step.get("parameters") or {}
        key = _strength(told)
        if key is None or isinstance(told[key].get("value"), str):
            continue
        value, unit = told[key].get("value"), str(told[key].get("unit") or "")
        if not isinstance(value, (int, float)):
            continue
        size = number(value, 3) + (f" {unit_words(unit)}" if unit else f" ({spoken(key)})")
        more = known.words(float(value), name not in VOLTAGES) if unit == PERCENT else ""
        parts.append(f"{effect_words(name)} {size}" + (f" ({more})" if more else ""))
    return "; ".join(parts)
