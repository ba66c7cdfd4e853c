"""Units as people write them in the heads of tables: what they measure, and how they become a log's."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

# unit of a map -> (quantity, column of the log, factor to the log's unit); counts need the counts of a turn
MAP_UNITS: dict[str, tuple[str, str, float]] = {
    "deg": ("angle", "angle_deg", 1.0),
    "rad": ("angle", "angle_deg", 180.0 / math.pi),
    "rev": ("angle", "angle_deg", 360.0),
    "counts": ("angle", "angle_deg", math.nan),
    "deg/s": ("speed", "speed_deg_s", 1.0),
    "rad/s": ("speed", "speed_deg_s", 180.0 / math.pi),
    "rpm": ("speed", "speed_deg_s", 6.0),
    "rev/s": ("speed", "speed_deg_s", 360.0),
    "counts/s": ("speed", "speed_deg_s", math.nan),
    "m/s": ("speed", "speed_m_s", 1.0),
    "mm/s": ("speed", "speed_m_s", 1e-3),
    "m": ("position", "position_m", 1.0),
    "mm": ("position", "position_m", 1e-3),
}

LONGEST = 300  # characters of a name in which a unit is looked for

TIME, VOLTAGE, RATIO, CURRENT, TORQUE, TEMPERATURE = "time", "voltage", "ratio", "current", "torque", "temperature"
ANGLE, SPEED, POSITION = "angle", "speed", "position"


@dataclass(frozen=True)
class Unit:
    """What a unit measures; ``base`` is the map's name of it (or s, V, %, A, N m, deg C), ``scale`` makes it that."""

    measures: str
    base: str
    scale: float = 1.0


def _units() -> dict[str, Unit]:
    table: list[tuple[str, str, str, float]] = [
        ("s sec secs second seconds sek sekunde sekunden", TIME, "s", 1.0),
        ("ms msec msecs millisecond milliseconds millis", TIME, "s", 1e-3),
        ("us usec µs μs microsecond microseconds micros", TIME, "s", 1e-6),
        ("ns nsec nanoseconds", TIME, "s", 1e-9),
        ("min minute minutes minuten", TIME, "s", 60.0),
        ("h hour hours stunden", TIME, "s", 3600.0),
        ("days", TIME, "s", 86_400.0),
        ("deg degree degrees ° grad º", ANGLE, "deg", 1.0),
        ("rad radian radians", ANGLE, "rad", 1.0),
        ("mrad", ANGLE, "rad", 1e-3),
        ("rev revs turn turns umdr umdrehung umdrehungen revolution revolutions", ANGLE, "rev", 1.0),
        (
            "count counts cnt cnts tick ticks inc incs inkremente increments pulse pulses imp impulse impulses lsb cts",
            ANGLE,
            "counts",
            1.0,
        ),
        ("deg/s degree/s degrees/s °/s º/s dps grad/s deg/sec deg_s", SPEED, "deg/s", 1.0),
        ("rad/s rad/sec rad*s^-1 rads^-1 rad_s radians/s 1/s", SPEED, "rad/s", 1.0),
        ("rpm 1/min u/min min^-1 rev/min r/min umin min-1 u/min. upm umdr/min rev_min", SPEED, "rpm", 1.0),
        ("rps rev/s r/s u/s turns/s turn/s umdr/s", SPEED, "rev/s", 1.0),
        ("krpm", SPEED, "rpm", 1000.0),
        ("counts/s count/s cnt/s cnts/s ticks/s inc/s pulses/s cps counts_s ticks_s", SPEED, "counts/s", 1.0),
        ("m/s m_s", SPEED, "m/s", 1.0),
        ("mm/s mm_s", SPEED, "mm/s", 1.0),
        ("m metre metres meter", POSITION, "m", 1.0),
        ("mm millimetre millimetres", POSITION, "mm", 1.0),
        ("cm", POSITION, "mm", 10.0),
        ("um µm μm", POSITION, "mm", 1e-3),
        ("v volt volts", VOLTAGE, "V", 1.0),
        ("mv", VOLTAGE, "V", 1e-3),
        ("% pct percent prozent", RATIO, "%", 1.0),
        ("a amp amps ampere", CURRENT, "A", 1.0),
        ("ma", CURRENT, "A", 1e-3),
        ("nm n*m n·m n.m", TORQUE, "N m", 1.0),
        ("mnm mn*m", TORQUE, "N m", 1e-3),
        ("°c degc c celsius", TEMPERATURE, "deg C", 1.0),
    ]
    return {word: Unit(what, base, scale) for words, what, base, scale in table for word in words.split()}


UNITS = _units()
_BRACKETS = re.compile(r"^(.*?)\s*[\[({<]\s*([^\])}>]*?)\s*[\])}>]\s*(.*)$")
_ONE_LETTER = {"s": "s", "m": "m", "a": "A", "v": "V"}  # as a suffix only in this case
_PER = re.compile(r"(?:_per_|_p_| per )")


def unit_of(text: str) -> Unit | None:
    """The unit that a text is, or None."""
    if len(text) > LONGEST:
        return None
    key = re.sub(r"\s+", "", text.strip().strip("[](){}<>").lower()).replace("²", "^2")
    if key in ("n·m", "nm"):
        key = "nm"
    key = re.sub(r"([a-z°]+)per([a-z]+)$", r"\1/\2", key) if key not in UNITS else key
    return UNITS.get(key) or UNITS.get(key.replace("sec", "s"))


def is_unit(text: str) -> bool:
    return unit_of(text) is not None


def name_and_unit(head: str) -> tuple[str, str]:
    """The name and the unit in one head of a column: ``Speed [rpm]``, ``n / min^-1``, ``u (V)``, ``time_ms``, ``t, s``.

    The unit is "" where none is told.
    """
    head = head.strip()
    if len(head) > LONGEST:
        return head, ""
    found = _BRACKETS.match(head)
    if found and (is_unit(found[2]) or not found[3]):
        inside = found[2].strip()
        first = re.split(r"[,;\s]\s*", inside)[0]
        return found[1].strip() or head, inside if is_unit(inside) or not is_unit(first) else first
    for pattern in (r"^(.*\S)\s+in\s+(\S+)$", r"^(.*\S)\s+/\s+(\S+)$", r"^(.*\S),\s*(\S+)$", r"^(.*\S)\s+(\S+)$"):
        parts = re.match(pattern, head)
        if (
            parts
            and is_unit(parts[2])
            and (len(parts[2]) > 1 or _ONE_LETTER.get(parts[2].lower(), parts[2]) == parts[2])
        ):
            return parts[1], parts[2]
    slash = re.match(r"^([^/]+)/(\S+)$", head)
    if slash and is_unit(slash[2]) and not is_unit(head):
        return slash[1], slash[2]
    tokens = _PER.sub("/", head).split("_")
    for count in (2, 1):
        if len(tokens) > count:
            suffix = "/".join(tokens[-count:])
            if is_unit(suffix) and _suffix_holds(suffix):
                return "_".join(tokens[:-count]), suffix
    camel = re.match(r"^(.*[a-z])(Ms|Us|Sec|Deg|Rad|Rpm|RPM|Pct|Volts?|Counts|Ticks)$", head)
    if camel:
        return camel[1], camel[2]
    return head, head if is_unit(head) and len(head) > 1 else ""


def _suffix_holds(suffix: str) -> bool:
    wanted = _ONE_LETTER.get(suffix.lower())
    return (wanted is None and len(suffix) > 1) or suffix == wanted
