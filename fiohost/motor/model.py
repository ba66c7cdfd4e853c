"""A model: ``linear`` and the effects in it, with parameter values, as people write it and as the kernel takes it."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from fiohost.errors import ConfigError, FiohostError, ModelError
from fiohost.files import write_output
from fiohost.motor.effect import Effect, Parameter, Value, effect, effects, flat_size, layout
from fiohost.motor.seen import RANGES, Seen
from fiohost.settings import Table, config_names, find_config, nearest, read_toml

SCHEMA = "fiohost.model/1"
# What the numbers of a model are in, and those of its file; on a linear axis files say metres.
DEGREES, MILLIMETRES, METRES = "deg", "mm", "m"
MM_PER_M = 1000.0
# The frequency of the PWM where nothing says another.
PWM_HZ = 20000.0
LOWEST_PWM_HZ, HIGHEST_PWM_HZ = 10.0, 1e6


@dataclass(frozen=True)
class Model:
    """``linear`` plus effects in the order in which they came in.

    ``values`` holds every parameter of every effect as ``effect.parameter``; ``fixed`` names those not to be estimated.
    ``unit`` is what the degrees in parameters' names really are: ``deg``, or ``mm`` on a linear axis. ``pwm_hz`` is the
    frequency of the bridge's PWM, of which the winding's ripple depends. ``seen`` is what it was fitted to.
    """

    effects: tuple[str, ...] = ()
    values: Mapping[str, Value] = None  # type: ignore[assignment]
    fixed: frozenset[str] = frozenset()
    unit: str = DEGREES
    pwm_hz: float = PWM_HZ
    seen: Seen | None = field(default=None, compare=False)

    def __post_init__(self) -> None:
        given = dict(self.values or {})
        if not LOWEST_PWM_HZ <= self.pwm_hz <= HIGHEST_PWM_HZ:
            raise ModelError(f"pwm_hz = {self.pwm_hz:g} is outside {LOWEST_PWM_HZ:g}..{HIGHEST_PWM_HZ:g} Hz")
        if len(set(self.effects)) != len(self.effects):
            twice = next(e for e in self.effects if self.effects.count(e) > 1)
            raise ModelError(f"effect {twice!r} is named twice")
        full: dict[str, Value] = {}
        for item in self.parts():
            for parameter in item.parameters:
                key = f"{item.name}.{parameter.name}"
                full[key] = parameter.check(given.pop(key, parameter.start), key)
        for key in given:
            raise ModelError(f"unknown parameter {key!r} in a model of {self.expression}; {nearest(key, full)}")
        for key in self.fixed:
            if key not in full:
                raise ModelError(f"unknown parameter {key!r} in [fixed]; {nearest(key, full)}")
        object.__setattr__(self, "values", full)

    @classmethod
    def parse(cls, text: str) -> Model:
        """Read ``linear+EFFECT+...`` or a model file. Raises ModelError or ConfigError naming the nearest valid
        name.
        """
        if text.endswith(".toml") or "/" in text or text in config_names("models"):
            return cls.read(find_config("models", text))
        names = [part.strip() for part in text.split("+")]
        if names[0] != "linear":
            known = [*effects(), *config_names("models")]
            if names[0] not in known:
                raise ModelError(f"unknown model or effect {names[0]!r}; {nearest(names[0], known)}")
            raise ModelError(f"a model begins with linear, as in linear+{'+'.join(names)}")
        return cls(effects=tuple(effect(name).name for name in names[1:]))

    @classmethod
    def read(cls, path: Path) -> Model:
        """Read a ``fiohost.model/1`` file; one whose ``unit`` is metres becomes a model in millimetres."""
        table = read_toml(path)
        table.schema(SCHEMA)
        unit = table.text("unit", DEGREES, choices=(DEGREES, METRES))
        pwm_hz = table.number("pwm_hz", PWM_HZ, low=LOWEST_PWM_HZ, high=HIGHEST_PWM_HZ)
        names = table.raw("effects", [])
        if not isinstance(names, list) or not all(isinstance(n, str) for n in names):
            raise table.fail("effects is not a list of names")
        nested = table.table("parameters").data
        fixed_table = table.table("fixed")
        fixed = fixed_table.raw("names", [])
        if not isinstance(fixed, list) or not all(isinstance(n, str) for n in fixed):
            raise fixed_table.fail("names is not a list of parameter names")
        fixed_table.finish()
        seen = _seen(table)
        table.finish()
        values: dict[str, Value] = {}
        for group, inner in nested.items():
            if not isinstance(inner, dict):
                raise table.fail(f"parameter {group!r} is not of the form effect.parameter")
            values.update({f"{group}.{key}": value for key, value in inner.items()})
        try:
            if unit == METRES:
                known = seen.scaled(MM_PER_M) if seen else None
                return cls(tuple(names), _scaled(values, MM_PER_M), frozenset(fixed), MILLIMETRES, pwm_hz, known)
            return cls(tuple(names), values, frozenset(fixed), pwm_hz=pwm_hz, seen=seen)
        except FiohostError as exc:
            raise ConfigError(f"{path}: {exc}") from exc

    def write(self, path: Path, comment: str = "") -> None:
        """Write a ``fiohost.model/1`` file. Raises FiohostError if it cannot be written."""
        lines = [f"# {line}" for line in comment.splitlines()]
        quoted = ", ".join(f'"{name}"' for name in self.effects)
        lines += [f'schema = "{SCHEMA}"', f"effects = [{quoted}]"]
        linear = self.unit == MILLIMETRES
        lines += [f'unit = "{METRES}"'] if linear else []
        lines += [f"pwm_hz = {self.pwm_hz!r}"] if self.pwm_hz != PWM_HZ else []
        lines += ["", "[parameters]"]
        for key, value in (_scaled(self.values, 1.0 / MM_PER_M) if linear else self.values).items():
            lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value!r}")
        if self.fixed:
            names = ", ".join(f'"{name}"' for name in sorted(self.fixed))
            lines += ["", "[fixed]", f"names = [{names}]"]
        if self.seen is not None:
            told = (self.seen.scaled(1.0 / MM_PER_M) if linear else self.seen).to_json()
            lines += ["", "[seen]", *(f"{key} = {json.dumps(value)}" for key, value in told.items())]
        write_output(path, "\n".join(lines) + "\n")

    def on_axis(self, rotary: bool) -> Model:
        """The model for logs of a shaft or of a linear axis, where numbers that people gave are in metres.

        Raises ModelError for a model of a linear axis on a shaft.
        """
        if rotary == (self.unit == DEGREES):
            return self
        if rotary:
            raise ModelError("the model is one of a linear axis (its unit is the metre), but the logs measure an angle")
        given = {k: v for k, v in self.values.items() if v != self.parameter(k).start}
        return replace(self, values={**self.values, **_scaled(given, MM_PER_M)}, unit=MILLIMETRES)

    def with_pwm(self, pwm_hz: float) -> Model:
        """The model on a bridge with this frequency of its PWM; as it is for 0. Raises ModelError out of range."""
        if pwm_hz == 0.0 or pwm_hz == self.pwm_hz:
            return self
        return replace(self, pwm_hz=pwm_hz)

    @property
    def given(self) -> bool:
        """Whether any parameter has another value than the library's start."""
        return any(v != self.parameter(k).start for k, v in self.values.items())

    @property
    def expression(self) -> str:
        return "+".join(("linear", *self.effects))

    def parts(self) -> list[Effect]:
        """``linear`` and the effects as found in the library."""
        return [effect(name) for name in ("linear", *self.effects)]

    def parameter(self, key: str) -> Parameter:
        group, _, name = key.partition(".")
        return effect(group).parameter(name)

    def free(self) -> list[str]:
        """Names of the parameters to be estimated by gradients: not fixed, neither choices nor whole numbers."""
        return [k for k in self.values if k not in self.fixed and self.parameter(k).is_smooth]

    def phased(self) -> dict[str, str]:
        """Names of the sizes that swing, with that of the phase of each."""
        return {f"{e}.{size}": f"{e}.{phase}" for e in self.effects for size, phase in effect(e).couples}

    def number(self, key: str) -> float:
        value = self.values[key]
        if isinstance(value, str):
            raise ModelError(f"{key} is a choice, not a number")
        return value

    def with_values(self, values: Mapping[str, Value]) -> Model:
        """A copy with some parameters changed, each checked against its bounds."""
        return replace(self, values={**self.values, **values})

    def with_effect(self, name: str, values: Mapping[str, Value] | None = None) -> Model:
        """A copy with one effect added, in the place of those it replaces; ``values`` are its parameters' short
        names.
        """
        added = {f"{name}.{key}": value for key, value in (values or {}).items()}
        base = self.without(effect(name).replaces)
        return replace(base, effects=(*base.effects, name), values={**base.values, **added})

    def with_swapped(self, name: str, other: str, values: Mapping[str, Value]) -> Model:
        """A copy with one effect in the place of another; ``values`` are its parameters' full names."""
        base = self.without([name])
        effects = tuple(other if e == name else e for e in self.effects)
        return replace(base, effects=effects, values={**base.values, **values})

    def without(self, names: Iterable[str]) -> Model:
        """A copy with some effects taken out."""
        gone = set(names)
        return Model(
            effects=tuple(e for e in self.effects if e not in gone),
            values={k: v for k, v in self.values.items() if k.partition(".")[0] not in gone},
            fixed=frozenset(k for k in self.fixed if k.partition(".")[0] not in gone),
            unit=self.unit,
            pwm_hz=self.pwm_hz,
            seen=self.seen,
        )

    def switches(self) -> np.ndarray:
        """Which effects are on, in the kernel's order."""
        on = np.zeros(len(layout()), dtype=np.bool_)
        for item in self.parts():
            on[list(layout()).index(item.name)] = True
        return on

    def vector(self) -> np.ndarray:
        """All parameters in the kernel's flat order, then the PWM's period in s; those of absent effects are zero."""
        flat = np.zeros(flat_size())
        flat[-1] = 1.0 / self.pwm_hz
        for item in self.parts():
            for i, parameter in enumerate(item.parameters):
                flat[layout()[item.name] + i] = parameter.code(self.values[f"{item.name}.{parameter.name}"])
        return flat

    @property
    def full_deg_s(self) -> float:
        """The speed that full duty drives it to without a load, in deg/s, on a linear axis in mm/s."""
        return 100.0 * abs(self.number("linear.gain_deg_s_per_pct"))

    def substep_s(self) -> float:
        """Longest step of the kernel in s, 0 where each hold is one exact step."""
        lag_s, full_deg_s = self.number("linear.tau_s"), self.full_deg_s
        steps = [item.step_s(self.of(item.name), lag_s, full_deg_s) for item in self.parts()]
        return min((s for s in steps if s is not None), default=0.0)

    def of(self, name: str) -> dict[str, Value]:
        """An effect's own parameters by their names within it."""
        return {p.name: self.values[f"{name}.{p.name}"] for p in effect(name).parameters}


def _seen(table: Table) -> Seen | None:
    """What a file says that its model was fitted to went through; None where it says nothing. Raises ConfigError."""
    if "seen" not in table.data:
        return None
    told = table.table("seen")
    ranges = {}
    for key in RANGES:
        pair = told.numbers(key, most=2)
        if len(pair) != 2 or pair[0] > pair[1]:
            raise told.fail(f"{key} is not a range of two numbers, the lower first")
        ranges[key] = (pair[0], pair[1])
    hold_s, coasted = told.number("hold_s", low=0.0), told.raw("coasted", False)
    if not isinstance(coasted, bool):
        raise told.fail("coasted is neither true nor false")
    told.finish()
    return Seen(ranges["duty_pct"], ranges["speed"], hold_s, coasted)


def _scaled(values: Mapping[str, Value], factor: float) -> dict[str, Value]:
    """Parameters with lengths in another unit; what is no number or unknown is left for the check."""

    def is_length(key: str) -> bool:
        group, _, name = key.partition(".")
        return any(q.name == name and q.is_length for q in effect(group).parameters)

    return {
        key: value * factor if isinstance(value, (int, float)) and is_length(key) else value
        for key, value in values.items()
    }


def slot(key: str) -> int:
    """Index of ``effect.parameter`` in the kernel's flat parameter array."""
    group, _, name = key.partition(".")
    names = [p.name for p in effect(group).parameters]
    return layout()[group] + names.index(name)
