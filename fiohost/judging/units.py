"""A linear axis is held in millimetres (see ``record_from_log``); what is told of it is in metres, as its log is."""

from __future__ import annotations

from typing import Any

from fiohost.estimation.record import HELD_IN
from fiohost.motor.effect import effect
from fiohost.motor.model import MM_PER_M

LOG_UNIT = {held: unit for unit, held in HELD_IN.items()}
# Keys whose numbers are lengths or speeds wherever they stand, and those of an initial state that are.
LENGTHS = ("free_run_rms", "window_rms", "floor_window_rms", "speed_min", "speed_max")
STARTS = ("angle", "speed", "drift")
# Numbers that are in the "unit" beside them.
QUANTITY = ("value", "ci95", "smallest_visible", "neutral")
MEASUREMENT = "measurement"


def metres(value: Any) -> Any:
    """Numbers in millimetres, alone or in lists and dictionaries, in metres."""
    if isinstance(value, dict):
        return {k: metres(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [metres(v) for v in value]
    return value / MM_PER_M if isinstance(value, float) else value


def in_metres(told: Any) -> Any:
    """A diagnosis as dictionary, all its millimetres and the library's degrees in metres."""
    if isinstance(told, (list, tuple)):
        return [in_metres(item) for item in told]
    if not isinstance(told, dict):
        return told
    found = {k: v if k == "settings" else metres(v) if k in LENGTHS else in_metres(v) for k, v in told.items()}
    if "initial" in found:
        found["initial"] = {k: metres(v) if k in STARTS else v for k, v in told["initial"].items()}
    if str(told.get("figure", "")).endswith("rms"):
        found |= {k: metres(told[k]) for k in ("value", "limit") if k in told}
    if "curve" in told:
        found |= _curves(told)
    unit = str(told.get("unit", ""))
    if unit.startswith(("deg", "mm")):
        found |= {k: metres(told[k]) for k in QUANTITY if k in told}
        found["unit"] = unit.replace("deg", "m").replace("mm", "m")
    if "at" in told:  # the other parameters of a smallest visible effect
        lengths = [q.name for q in effect(told["effect"]).parameters if q.is_length]
        found["at"] = {k: metres(v) if k in lengths else v for k, v in told["at"].items()}
    return found


def _curves(term: dict[str, Any]) -> dict[str, Any]:
    """The curves of an empirical term, in metres along its variable and its values where these are lengths."""
    x = 1.0 / MM_PER_M if term["variable"] == "speed" else 1.0
    y = 1.0 / MM_PER_M if term["kind"] == MEASUREMENT else 1.0
    curves = {k: [[a * x, b * y] for a, b in term[k]] for k in ("curve", "forward", "reverse")}
    return {**curves, "chance": term["chance"] * y}
