"""What an effect is: its name, its equation, its parameters in SI units and where it acts.

Every hook is a plain function that numba can compile; the kernel chains those of one kind together. A hook receives
the value as left by the effects before it and returns its own version of it, so adding a torque reads ``return value
- ...``.

Signature of the hooks on the physics (all but ``command`` and ``measure``)::

    hook(value, theta, omega, effort, side, duty, time, y, p, k, s) -> value

``theta`` rad and ``omega`` rad/s of the body concerned, ``effort`` the motor's torque Kt i in N m, ``side`` the
direction of sliding (-1, 0, +1), ``duty`` the bridge's duty in percent, ``time`` s since power-on, ``y`` the whole
state, ``p`` all parameters with this effect's own from index ``k`` on, ``s`` the index of this effect's own state in
``y``. ``command(duty, p, k)`` and ``measure(angle_rad, p, k)`` are simpler.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from firmware_model.plants import Plant

Hook = Callable[..., float]
Structure = Callable[["Plant", Mapping[str, Any]], dict[str, float]]
Reduced = Callable[["Plant", Mapping[str, Any]], dict[str, Any]]


@dataclass(frozen=True)
class Parameter:
    """A number in SI units, its key carrying the unit, or one of a few words (``choices``, stored as their index)."""

    key: str
    default: float | None = None
    lower: float = float("-inf")
    upper: float = float("inf")
    choices: tuple[str, ...] = ()


@dataclass(frozen=True)
class Effect:
    """One effect. ``reduced`` gives the same thing in percent of duty, degrees and seconds.

    ``structure`` sets constants of the kernel itself (gap, second inertia, delay; names of ``layout.C``), ``states`` is
    the number of states of its own (0 or 1), whose rate is ``rate``. ``stage`` orders the hooks, least first.
    """

    name: str
    summary: str
    equation: str
    parameters: tuple[Parameter, ...]
    source: str
    reduced: Reduced
    stage: int = 50
    states: int = 0
    command: Hook | None = None
    voltage: Hook | None = None
    resistance: Hook | None = None
    drop: Hook | None = None
    ceiling: Hook | None = None
    motor_torque: Hook | None = None
    load_torque: Hook | None = None
    friction: Hook | None = None
    breakaway: Hook | None = None
    inertia: Hook | None = None
    rate: Hook | None = None
    measure: Hook | None = None
    structure: Structure | None = None
