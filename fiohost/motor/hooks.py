"""The effects' hooks joined into one function for each place where effects act.

Each function is written out as text, with one test of a switch an effect, and compiled as a whole: a chain of closures
does the same, but its links are compiled one by one, which takes longer than all the rest. A hook gets its effect's
parameters as a tuple. Where it reads its effect's own state, ``shift`` says where in the kernel's array that is: as it
was at the beginning of a step, or as predicted for its middle.
"""

from __future__ import annotations

import re
from math import exp, inf, nan
from types import FunctionType
from typing import Any

from fiohost.motor.compiled import helper, inlined
from fiohost.motor.effect import Effect, effects, layout

EFFECT_INDEX = {name: i for i, name in enumerate(effects())}
N_PARAMETERS = sum(len(e.parameters) for e in effects().values())
PERIOD = N_PARAMETERS  # behind the effects' parameters: the period of the PWM in s
N_EFFECTS = len(EFFECT_INDEX)
FIXED_STATES = 7  # those of the kernel; the effects' own follow
OWN = {e.name: FIXED_STATES + i for i, e in enumerate(e for e in effects().values() if e.rate is not None)}
NO_BRISTLE = nan
SHORT = 0.01  # part of a time constant, for which six terms of a series are exact


def having(*kinds: str) -> list[Effect]:
    """The effects with a hook of one of these kinds, in the order in which they act."""
    found = [e for e in effects().values() if any(getattr(e, kind) for kind in kinds)]
    return sorted(found, key=lambda e: (e.stage, e.name))


@inlined
def _made(fallen):  # type: ignore[no-untyped-def]
    """``(1 - exp(-y)) / y`` of a small y, by its series: the way that a state has made after y time constants."""
    return 1.0 - fallen * (1 / 2 - fallen * (1 / 6 - fallen * (1 / 24 - fallen * (1 / 120 - fallen * (1 / 720)))))


def _with_helpers(function: Any) -> Any:
    """A hook that calls plain functions of its own module, those compiled as well."""
    known = function.__globals__
    called = {name: known[name] for name in function.__code__.co_names if isinstance(known.get(name), FunctionType)}
    own = {n: helper(_with_helpers(f)) for n, f in called.items() if f.__module__ == function.__module__}
    if not own:
        return function
    return FunctionType(function.__code__, {**known, **own}, function.__name__, None, function.__closure__)


def _joined(kind: str, arguments: str, link: str, start: str = "pass", end: str = "return value") -> Any:
    """A function of some arguments: the line ``start``, the lines of ``link`` for each effect that is on and has a hook
    of a kind, and ``end``. In a link stand HOOK for the hook, EVENT for that of events, Q for the effect's parameters
    and OWN for its own state.
    """
    head = ", ".join([*arguments.split(), "p", "on"])
    lines = [f"def {kind}({head}):", f"    {start}"]
    names: dict[str, Any] = {"exp": exp, "inf": inf, "made": _made, "SHORT": SHORT}
    for item in having(kind):
        begin, slot = layout()[item.name], OWN.get(item.name)
        values = "".join(f"p[{begin + i}], " for i in range(len(item.parameters)))
        words = {"Q": f"({values})", "OWN": f"x[{slot} + shift]" if slot else "0.0"}
        for word, hook in (("HOOK", kind), ("EVENT", "event")):
            words[word] = f"{hook}_{item.name}"
            if getattr(item, hook):
                names[words[word]] = inlined(_with_helpers(getattr(item, hook)))
        told = link
        for word, meant in words.items():
            told = re.sub(rf"\b{word}\b", meant, told)
        lines += [f"    if on[{EFFECT_INDEX[item.name]}]:", *(f"        {line}" for line in told.splitlines())]
    exec("\n".join([*lines, f"    {end}"]), names)  # of this package's own names alone
    return inlined(names[kind])


def any_of(*kinds: str, varying: bool = False) -> Any:
    """Whether an effect with a hook of one of these kinds is in the model; ``varying``: one that a hold does not
    freeze.
    """
    places = tuple(EFFECT_INDEX[e.name] for e in having(*kinds) if e.substep_s is not None or not varying)

    @inlined
    def found(on):  # type: ignore[no-untyped-def]
        for place in places:  # noqa: SIM110 (numba has no any)
            if on[place]:
                return True
        return False

    return found


# Hooks that get what came so far and return their own version of it; some know their effect's own state.
command = _joined("command", "value args", "value = HOOK(value, *args, Q)")
inertia = _joined("inertia", "value args", "value = HOOK(value, *args, Q)")
measure = _joined("measure", "value args", "value = HOOK(value, *args, Q)")
voltage = _joined("voltage", "value args x shift", "value = HOOK(value, *args, OWN, Q)")
resistance = _joined("resistance", "value args x shift", "value = HOOK(value, *args, OWN, Q)")
friction = _joined("friction", "value args x shift", "value = HOOK(value, *args, OWN, Q)")
bristle = _joined("bristle", "value args x shift", "value = HOOK(value, *args, OWN, Q)")
measure_speed = _joined("measure_speed", "value args x shift", "value = HOOK(value, *args, OWN, Q)")
# Hooks whose values are joined.
drop = _joined("drop", "args", "value += HOOK(*args, Q)", "value = 0.0")
torque = _joined("torque", "args", "value += HOOK(*args, Q)", "value = 0.0")
load = _joined("load", "args", "value += HOOK(*args, Q)", "value = 0.0")
breakaway = _joined("breakaway", "args", "value += HOOK(*args, Q)", "value = 0.0")
delay = _joined("delay", "args", "value += HOOK(*args, Q)", "value = 0.0")
lag = _joined("lag", "args", "value = max(value, HOOK(*args, Q))", "value = 0.0")
coasts = _joined("coasts", "args", "value = max(value, HOOK(*args, Q))", "value = -1.0")
ceiling = _joined("ceiling", "args", "value = min(value, HOOK(*args, Q))", "value = inf")
margin = _joined("event", "args", "value = min(value, HOOK(*args, Q))", "value = inf")
barred = _joined("bars", "args", "value = value or HOOK(*args, Q)", "value = False")
# The next moment after one at which the plant changes, on the bench's clock.
next_moment = _joined("moment", "now", "at = HOOK(Q)\nvalue = min(value, at if at > now else inf)", "value = inf")
# What joins a second inertia, as an effect's ``coupling`` says, but stiffness and damping over those of the whole one.
coupling = _joined(
    "coupling",
    "",
    """
r, h, pulse, ratio = HOOK(Q)
share, half = max(share, r), max(half, h)
stiff, damp = stiff + r * (1.0 - r) * pulse * pulse, damp + 2.0 * r * (1.0 - r) * ratio * pulse
""".strip(),
    "share, half, stiff, damp = 0.0, 0.0, 0.0, 0.0",
    "return share, half, stiff, damp",
)
# Angle and speed of the load beyond the events in which it stands.
jumped = _joined(
    "jump",
    "theta omega",
    "if EVENT(theta, omega, Q) < 0.0:\n    theta, omega = HOOK(theta, omega, Q)",
    end="return theta, omega",
)
# The effects' own states over a step, written ``to`` so many places further on.
carry = _joined(
    "rate",
    "x to omega amps dt",
    """
shift = 0
z = OWN
shift = to
source, decay = HOOK(z, omega, amps, Q)
if abs(decay) * dt < SHORT:
    OWN = z + (source - decay * z) * dt * made(decay * dt)
else:
    OWN = source / decay + (z - source / decay) * exp(-decay * dt)
""".strip(),
    end="return None",
)
opens = any_of("opens")
pulled = any_of("torque")
loaded = any_of("load")
rubs = any_of("friction", varying=True)
remembers = any_of("rate")
bristles = any_of("bristle")
resists = any_of("resistance")
varies = any_of("voltage")
ends = any_of("event")
