"""What an effect is, and the library of them: every module in ``fiohost.motor.effects`` adds its own.

An effect says where it acts by giving hooks, plain functions of numbers which the kernel compiles. Those of one kind
are chained in the order of their effects' ``stage``; the first argument is what came so far.

On the drive, in percent of full duty or of the current that it drives through a cold winding at rest:

``command(duty_pct, period_s, q)``
    the duty that really acts, a static map; ``period_s`` is that of the PWM.
``voltage(volts_pct, duty_pct, time_s, z, q)``
    the voltage while a pulse is on, as a share of the supply times the duty.
``resistance(ohms, duty_pct, z, q)``
    resistance of the circuit, in those of the cold winding.
``drop(lost_pct, q)``, ``ceiling(most_pct, q)``, ``lag(q)``
    voltage lost against the current, greatest current, and L/R in seconds. All three act on the instant current.
``coasts(q)``
    for a bridge that is open between pulses: L/R over the period of the PWM, as the averaged current needs no more.

On the shaft, torques in percent of duty, the sign that of the motion which they help:

``torque(theta_deg, omega_deg_s, time_s, q)``, ``load(theta_deg, omega_deg_s, time_s, q)``
    torque added on the motor's side, and beyond a gap or spring.
``friction(level_pct, theta_deg, omega_deg_s, time_s, drive_pct, direction, z, q)``
    sliding friction on the motor's side; ``drive_pct`` is the current, ``direction`` +1 or -1.
``breakaway(q)``
    static friction above sliding friction.
``bristle(z, q)``
    the share of sliding friction, -1 to 1, that acts in the place of its direction; there is then no stick.
``inertia(ratio, time_s, q)``
    inertia as a multiple of the whole one.
``coupling(q)``
    what joins a second inertia: its share of the whole, half the gap in degrees, the stiffness as a resonance in rad/s
    (0: rigid) and its damping ratio.
``event(theta_deg, omega_deg_s, q)``, ``jump(theta_deg, omega_deg_s, q)``
    how far the load is from an event (below 0: beyond it), and angle and speed just after it.
``bars(theta_deg, direction, q)``
    whether the load at rest cannot go that way.

In time, and at the sensor:

``rate(z, omega_deg_s, current_pct, q)``
    of the effect's own state ``z``: the pair ``(source, decay)`` of ``dz/dt = source - decay z``, carried exactly.
``moment(q)``, ``delay(q)``
    a moment on the bench's clock at which the plant changes, and dead time, in seconds.
``measure(theta_deg, q)``, ``measure_speed(omega_deg_s, z, q)``
    the angle that the encoder shows, and the speed that a sensor of speed does.

``q`` are the effect's own parameters in their declared order. Hooks of an effect without ``substep_s`` depend on
nothing that changes within a hold, neither angle nor speed nor current, nor on time but by a ``moment``.
"""

from __future__ import annotations

import importlib
import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cache

from fiohost.errors import ModelError
from fiohost.settings import nearest

Value = float | str


class Kind(StrEnum):
    """What a parameter is, and so how it is found.

    A size vanishes at the neutral value and the error is smooth in it; a shape says what the effect is like where it
    has a size. A phase belongs to an order or a frequency. An order is a whole number, a choice a word: both are found
    by trying. An event is a moment or place, a threshold a level, at which the error may jump: they are searched. A
    place says where a curve is laid: it is given, never estimated.
    """

    SIZE = "size"
    SHAPE = "shape"
    PHASE = "phase"
    ORDER = "order"
    CHOICE = "choice"
    EVENT = "event"
    THRESHOLD = "threshold"
    PLACE = "place"


Hook = Callable[..., float]
Hook2 = Callable[..., tuple[float, float]]
Hook4 = Callable[..., tuple[float, float, float, float]]


@dataclass(frozen=True)
class Parameter:
    """One number (or choice) of an effect.

    ``neutral`` is the value at which the effect vanishes (None where the effect has none, as for a phase);
    ``ragged`` says that the cost is no smooth function of it, so that it is searched, not only followed downhill;
    ``step`` is the finite-difference step, relative to the value where ``relative_step`` is set. ``special`` is the
    kind where the rest does not tell it. ``order`` is how many times a parameter moves with the zero of angle, where
    the effect has no parameter that says so. ``by_speed`` is the power of a motor's full speed that trials go with: a
    speed goes with the first.
    """

    name: str
    unit: str
    start: Value
    lower: float = -math.inf
    upper: float = math.inf
    neutral: float | None = 0.0
    step: float = 1e-2
    relative_step: bool = False
    choices: tuple[str, ...] = ()
    period: float | None = None
    whole: bool = False
    ragged: bool = False
    special: Kind | None = None
    order: int | None = None
    by_speed: float = 0.0

    @property
    def kind(self) -> Kind:
        """What it is, and so how it is found."""
        if self.special is not None:
            return self.special
        if self.choices:
            return Kind.CHOICE
        if self.whole:
            return Kind.ORDER
        if self.ragged:
            return Kind.THRESHOLD
        if self.period is not None:
            return Kind.PHASE
        return Kind.SHAPE if self.neutral is None else Kind.SIZE

    @property
    def is_choice(self) -> bool:
        return bool(self.choices)

    @property
    def is_smooth(self) -> bool:
        """Whether a gradient means anything: not for a choice or a whole number, found by trying, or a place."""
        return self.kind not in (Kind.CHOICE, Kind.ORDER, Kind.PLACE)

    @property
    def is_searched(self) -> bool:
        """Whether it is only searched for: no derivative says how far off it is, as of a moment."""
        return self.ragged and self.neutral is None

    @property
    def is_length(self) -> bool:
        """Whether it is counted in degrees, which on a linear axis are millimetres."""
        return self.unit.startswith("deg") and self.period is None

    def check(self, value: object, where: str) -> Value:
        """Return the value if it is allowed. Raises ModelError with the reason."""
        if self.is_choice:
            if not isinstance(value, str) or value not in self.choices:
                raise ModelError(f"{where} = {value!r} is unknown; {nearest(str(value), self.choices)}")
            return value
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
            raise ModelError(f"{where} = {value!r} is not a finite number")
        if not self.lower <= value <= self.upper:
            raise ModelError(f"{where} = {value:g} is outside {self.lower:g}..{self.upper:g} {self.unit}")
        return float(value)

    def allows(self, value: Value) -> bool:
        """Whether a value is within its bounds, or one of its choices."""
        return value in self.choices if isinstance(value, str) else self.lower <= value <= self.upper

    def code(self, value: Value) -> float:
        """The number the kernel sees: the value itself, or the position of a choice."""
        return float(self.choices.index(value)) if isinstance(value, str) else value


# The hooks that an effect may have, with what each takes.
HOOKS: Mapping[str, tuple[str, ...]] = {
    "command": ("duty_pct", "period_s", "q"),
    "voltage": ("volts_pct", "duty_pct", "time_s", "z", "q"),
    "resistance": ("ohms", "duty_pct", "z", "q"),
    "drop": ("q",),
    "ceiling": ("q",),
    "lag": ("q",),
    "coasts": ("q",),
    "torque": ("theta_deg", "omega_deg_s", "time_s", "q"),
    "load": ("theta_deg", "omega_deg_s", "time_s", "q"),
    "friction": ("level_pct", "theta_deg", "omega_deg_s", "time_s", "drive_pct", "direction", "z", "q"),
    "breakaway": ("q",),
    "bristle": ("slack", "z", "q"),
    "inertia": ("ratio", "time_s", "q"),
    "coupling": ("q",),
    "event": ("theta_deg", "omega_deg_s", "q"),
    "jump": ("theta_deg", "omega_deg_s", "q"),
    "bars": ("theta_deg", "direction", "q"),
    "rate": ("z", "omega_deg_s", "current_pct", "q"),
    "moment": ("q",),
    "delay": ("q",),
    "measure": ("theta_deg", "q"),
    "measure_speed": ("omega_deg_s", "z", "q"),
}


# The full speed of a motor that trials are for.
TRIED_DEG_S = 1000.0


@dataclass(frozen=True)
class Span:
    """What the data cover: the bench's time in seconds, the angles in degrees where the shaft stood though driven on,
    as at an end of travel (positive where it was driven forward), frequencies in Hz of lines in what is left, and the
    speed that was reached.
    """

    time_s: tuple[float, float]
    ends_deg: tuple[float, ...]
    lines_hz: tuple[float, ...] = ()
    full_deg_s: float = TRIED_DEG_S

    @property
    def speed_scale(self) -> float:
        """How many times as fast it is as what the library's trials are for, to a power of four: a trial need only come
        near.
        """
        return float(4.0 ** round(math.log(max(self.full_deg_s, 1e-3) / TRIED_DEG_S, 4.0)))


# What follows the angle is frozen for no more of its swing; no step is shorter than this.
SWING_DEG, SHORTEST_STEP_S = 90.0, 1e-3


@dataclass(frozen=True)
class Effect:
    """One physical effect, its equation and parameters, where it acts and what it cannot be told from.

    ``stage`` orders maps of the command. ``commonness`` (0 every drive has it, 9 rare) decides between effects that the
    data cannot tell apart; all their names are reported whatever it is. ``couples`` names each size that swings and
    the phase that goes with it: a sine and a cosine make any of both, so that a trial needs no phase. ``points`` names
    sizes that add up to a curve: a trial is all of them together, each as large as data ask for. ``once`` marks
    an event that can be had only once, so that left-out records cannot confirm it: it is believed only where it leaves
    nothing; ``shown`` what readings show by themselves wherever it is tried, so that one record is enough; ``warms``
    what hangs on how warm the bench began, ``clocked`` what hangs on the bench's own time, from one log to the next.
    ``trials_for`` makes trials that depend on what the data cover. ``substep_s`` is the longest step over which the
    effect may be frozen, and so is a lag of the motor over ``steps_a_lag`` (0: it changes with the speed by nothing);
    ``opens`` says that the bridge is open, not shorted, between pulses; ``drives`` that
    the effect may bring energy of its own, as a weight or a clock does.
    """

    name: str
    summary: str
    equation: str
    acts_on: str
    parameters: tuple[Parameter, ...]
    source: str
    signature: str = ""
    stage: int = 0
    commonness: int = 5
    substep_s: float | None = None
    steps_a_lag: float = 16.0
    angle_bound: bool = False
    equivalents: tuple[str, ...] = ()
    replaces: tuple[str, ...] = ()
    trials: tuple[Mapping[str, Value], ...] = ()
    trials_for: Callable[[Span], tuple[Mapping[str, Value], ...]] | None = field(default=None, repr=False)
    couples: tuple[tuple[str, str], ...] = ()
    points: tuple[str, ...] = ()
    once: bool = False
    shown: bool = False
    warms: bool = False
    clocked: bool = False
    opens: bool = False
    drives: bool = False
    command: Hook | None = field(default=None, repr=False)
    voltage: Hook | None = field(default=None, repr=False)
    resistance: Hook | None = field(default=None, repr=False)
    drop: Hook | None = field(default=None, repr=False)
    ceiling: Hook | None = field(default=None, repr=False)
    lag: Hook | None = field(default=None, repr=False)
    coasts: Hook | None = field(default=None, repr=False)
    torque: Hook | None = field(default=None, repr=False)
    load: Hook | None = field(default=None, repr=False)
    friction: Hook | None = field(default=None, repr=False)
    breakaway: Hook | None = field(default=None, repr=False)
    bristle: Hook | None = field(default=None, repr=False)
    inertia: Hook | None = field(default=None, repr=False)
    coupling: Hook4 | None = field(default=None, repr=False)
    event: Hook | None = field(default=None, repr=False)
    jump: Hook2 | None = field(default=None, repr=False)
    bars: Callable[..., bool] | None = field(default=None, repr=False)
    rate: Hook2 | None = field(default=None, repr=False)
    moment: Hook | None = field(default=None, repr=False)
    delay: Hook | None = field(default=None, repr=False)
    measure: Hook | None = field(default=None, repr=False)
    measure_speed: Hook | None = field(default=None, repr=False)

    def tried(self, span: Span) -> list[dict[str, Value]]:
        """The trials for what the data cover; what lies beyond the bounds of a parameter is none of this effect: a line
        of an hour's log that is slower than any ripple.
        """
        given = self.trials_for(span) if self.trials_for else self.trials
        by = {p.name: span.speed_scale**p.by_speed for p in self.parameters if p.by_speed and not p.is_choice}
        trials = [{**t, **{n: float(t[n]) * by[n] for n in by if n in t}} for t in given]
        return [t for t in trials if all(p.allows(t[p.name]) for p in self.parameters if p.name in t)]

    def step_s(self, own: Mapping[str, Value], lag_s: float, full_deg_s: float) -> float | None:
        """The longest step of a motor with such a lag and full speed, ``own`` being the effect's parameters by their
        names; None where one exact step serves. What follows the angle is frozen for a part of a swing; a step is no
        shorter than the shortest: a motor that is faster follows at once, and a swing that is faster moves nothing.
        """
        if self.substep_s is None:
            return None
        most = [lag_s / self.steps_a_lag] if self.steps_a_lag else []
        if self.angle_bound:
            swings = float(own.get("order", max(len(self.points) / 2.0, 1.0)))
            most.append(SWING_DEG / (swings * max(full_deg_s, 1e-9)))
        return min([self.substep_s, *(max(m, SHORTEST_STEP_S) for m in most)])

    @property
    def everywhere(self) -> bool:
        """Whether every drive has it."""
        return self.commonness == 0

    @property
    def unseen_in_windows(self) -> bool:
        """Whether its score says nothing in windows that begin as another model has them: warmth, an end of travel."""
        return self.warms or self.event is not None

    @property
    def hook_functions(self) -> tuple[Callable[..., object], ...]:
        """Its hooks, in the order of their kinds."""
        return tuple(hook for kind in HOOKS if (hook := getattr(self, kind)) is not None)

    @property
    def remembers(self) -> bool:
        """Whether it adds to the motor's state beside angle and speed."""
        return any(hook is not None for hook in (self.rate, self.coupling, self.lag))

    def parameter(self, name: str) -> Parameter:
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        known = [p.name for p in self.parameters]
        raise ModelError(f"effect {self.name!r} has no parameter {name!r}; {nearest(name, known)}")


@cache
def effects() -> dict[str, Effect]:
    """All known effects by name, ``linear`` and those of other packages included, in alphabetical order.

    Raises ModelError where an effect of another package cannot be loaded.
    """
    from fiohost.motor.own import own_effects

    package = importlib.import_module("fiohost.motor.effects")
    found: dict[str, Effect] = {}
    for info in pkgutil.iter_modules(package.__path__):
        module = importlib.import_module(f"fiohost.motor.effects.{info.name}")
        for effect in module.EFFECTS:
            found[effect.name] = effect
    return dict(sorted({**found, **own_effects(found)}.items()))


def effect(name: str) -> Effect:
    """Find an effect by name. Raises ModelError naming the nearest known one."""
    library = effects()
    if name not in library:
        raise ModelError(f"unknown effect {name!r}; {nearest(name, library)}")
    return library[name]


@cache
def layout() -> dict[str, int]:
    """Offset of each effect's parameters in the kernel's flat parameter array."""
    offsets: dict[str, int] = {}
    offset = 0
    for name, item in effects().items():
        offsets[name] = offset
        offset += len(item.parameters)
    return offsets


@cache
def flat_size() -> int:
    """Length of the kernel's flat parameter array: all parameters of all effects, and the PWM's period."""
    return sum(len(item.parameters) for item in effects().values()) + 1
