"""Results in plain words: the verdict in one sentence, numbers with sensible digits, names of what a residual follows.

Knows the JSON of a diagnosis (schema ``fiohost.diagnosis/1``) and nothing else.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

DASH = "–"
RUN_WORDS = {"linear.gain_deg_s_per_pct": "a gain", "constant_load.level_pct": "an offset load"}
LEVELS = {
    "noise": "to within the noise",
    "repeatability": "to within what the bench repeats",
    "tolerance": "to within what is asked",
}
MORE_HELD_OUT = " What was held out is not all followed by it."
ROLE_WORDS = {"train": "training", "holdout": "held out"}

FOLLOWS = {
    "angle": "the shaft angle",
    "angle_and_speed_sign": "the shaft angle and the direction of motion",
    "speed": "the speed",
    "speed_sign": "the direction of motion",
    "duty": "the duty",
    "duty_sign": "the sign of the duty",
    "current": "the current",
    "time": "the time",
    "gain_drift": "a gain that changes in a run",
    "friction_drift": "a friction that changes in a run",
    "shared_load": "a load that all runs have in common",
    "acceleration": "the acceleration",
    "reversals": "reversals",
    "starts": "starts from rest",
    "stops": "stops",
    "command": "the command",
    "standstill": "standstill",
}


def number(value: Any, digits: int = 4) -> str:
    """A number with *digits* significant digits, no exponent where it can be helped; a dash for none, NaN or text."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return DASH
    if not math.isfinite(value):
        return DASH if math.isnan(value) else ("infinite" if value > 0 else "-infinite")
    if value == 0:
        return "0"
    if isinstance(value, int):  # a count or a seed: all of it
        return str(value)
    if 1e-4 <= abs(value) < 1e6:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        return f"{value:.{decimals}f}"
    return f"{value:.{digits - 1}e}"


def with_unit(value: Any, unit: str, digits: int = 3) -> str:
    text = number(value, digits)
    return text if text == DASH or not unit else f"{text} {unit}"


def share(value: Any) -> str:
    """A score or share with three decimals; what is smaller is 0."""
    text = number(value)
    return text if text == DASH else f"{value:.3f}".replace("-0.000", "0.000")


def interval(parameter: Mapping[str, Any], digits: int = 4) -> str:
    """The 95 % interval of one parameter, ``lo .. hi``, with as many digits as its width needs, or a dash."""
    bounds = parameter.get("ci95")
    if not isinstance(bounds, Sequence) or len(bounds) != 2 or any(number(b) == DASH for b in bounds):
        return DASH
    low, high = (float(b) for b in bounds)
    largest, width = max(abs(low), abs(high)), high - low
    if width > 0 and math.isfinite(width) and largest > 0:
        digits = min(max(digits, 1 + math.ceil(math.log10(largest / width))), 8)
    return f"{number(low, digits)} .. {number(high, digits)}"


def remark(parameter: Mapping[str, Any]) -> str:
    """What a reader must know about one parameter before using it."""
    notes = []
    if parameter.get("identifiable") is False:
        notes.append("not identifiable from these data")
    if parameter.get("at_bound"):
        notes.append("at its bound")
    return "; ".join(notes)


def listed(names: Iterable[str], last: str = "and") -> str:
    items = list(names)
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {last} {items[-1]}"


def effect_words(name: str) -> str:
    """``coulomb_friction`` as people say it."""
    return name.replace("_", " ")


def roles_of(diagnosis: Mapping[str, Any]) -> list[str]:
    """``train``, and ``holdout`` where there are held-out logs."""
    return ["train", "holdout"] if (diagnosis.get("before") or {}).get("holdout") else ["train"]


def judged(diagnosis: Mapping[str, Any]) -> str:
    """The role whose figures count: ``holdout`` where there is one, else ``train``."""
    return roles_of(diagnosis)[-1]


def error_of(block: Any, role: str, key: str = "free_run_rms") -> float | None:
    """One figure out of ``{"train": E, "holdout": E|null}``."""
    entry = block.get(role) if isinstance(block, Mapping) else None
    value = entry.get(key) if isinstance(entry, Mapping) else None
    return float(value) if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def follows(diagnosis: Mapping[str, Any]) -> str:
    """What the remaining residual depends on, in words; empty where nothing is known."""
    names = (diagnosis.get("residual") or {}).get("depends_on") or []
    return listed(FOLLOWS.get(str(name), str(name).replace("_", " ")) for name in names)


def verdict_sentence(diagnosis: Mapping[str, Any]) -> str:
    """The result in a few sentences that stand alone."""
    return f"{_verdict(diagnosis)}{_searched(diagnosis)}"


def searched_unit(diagnosis: Mapping[str, Any]) -> str:
    """The unit of what was searched: the output's, or that of the angle that speeds add up to."""
    return str((diagnosis.get("searched_as") or {}).get("unit") or diagnosis.get("output_unit", ""))


def _searched(diagnosis: Mapping[str, Any]) -> str:
    """How far the angle errs that speeds of counts add up to, where it was searched; empty otherwise."""
    told = diagnosis.get("searched_as")
    if not isinstance(told, Mapping):
        return ""
    before, after, floor = (
        with_unit((told.get(key) or {}).get("free_run_rms"), searched_unit(diagnosis))
        for key in ("before", "after", "floor")
    )
    change = f"by {before} rms before and {after} after" if diagnosis.get("steps") else f"by {after} rms"
    return f" The angle that these speeds of counts add up to, which was searched, errs {change}; its floor is {floor}."


def _verdict(diagnosis: Mapping[str, Any]) -> str:
    verdict = diagnosis.get("verdict")
    declared = str((diagnosis.get("declared") or {}).get("model", "the declared model"))
    found = found_words(diagnosis)
    change = _change(diagnosis)
    rest = follows(diagnosis)
    more = bool(diagnosis.get("holdout_not_followed"))
    if verdict == "no_missing_effect" and more:
        return (
            f"Nothing is missing from {declared} that the training logs show, but it does not follow what was held "
            f"out{_level(diagnosis)}."
        )
    if verdict == "no_missing_effect":
        level = LEVELS.get(str(diagnosis.get("explained_to")), "down to their floor")
        return f"Nothing is missing: {declared} explains the data {level}{_level(diagnosis)}.{_noise(diagnosis)}"
    if verdict == "explained":
        said = f"Missing from {declared}: {listed(found)}{_clock(diagnosis)}. {change}{_noise(diagnosis)}"
        return f"{said}{MORE_HELD_OUT if more else ''}"
    remains = f"what remains follows {rest}" if rest else "what remains follows nothing that was looked at"
    if found:
        share = diagnosis.get("explained_pct")
        much = f" {number(share, 3)} % of the error is explained." if isinstance(share, (int, float)) else ""
        return (
            f"Partly explained: adding {listed(found)} helped, but structure remains.{much} {change} "
            f"Unexplained: {remains}."
        )
    small = " It is no larger than the floor, but it is not random." if _is_small(diagnosis) else ""
    said = f"Unexplained: {declared} lacks something that no candidate accounts for; {remains}."
    return f"{said}{_level(diagnosis, ' ')}{small}"


def _is_small(diagnosis: Mapping[str, Any]) -> bool:
    """Whether no more is left than the floor, though it is no noise."""
    error, floor = (error_of(diagnosis.get(key), judged(diagnosis)) for key in ("after", "floor"))
    white = (diagnosis.get("residual") or {}).get("white")
    return white is False and error is not None and floor is not None and error <= floor


def _noise(diagnosis: Mapping[str, Any]) -> str:
    """What is left where the data are explained to within the noise or what the bench repeats; empty otherwise."""
    noise = diagnosis.get("noise")
    if diagnosis.get("explained_to") not in LEVELS or not isinstance(noise, Mapping):
        return ""
    parts = []
    for key, told in (diagnosis.get("run_to_run") or {}).items():
        size = (
            f"{number(told['sd_pct'], 2)} %" if told.get("sd_pct") else with_unit(told["sd"]["value"], "% of duty", 2)
        )
        parts.append(f"{RUN_WORDS.get(key, effect_words(key.partition('.')[0]))} that scatters by {size} between runs")
    sensor = "noise of the angle that speeds are taken from," if noise.get("sensor_of_angle") else "sensor noise"
    for key, what in (("sensor_rms", sensor), ("torque_rms_pct", "a random torque")):
        told = noise[key]
        if told["ci95"][0] > 0.0:
            unit = "% of duty" if key == "torque_rms_pct" else told["unit"]
            own = (noise.get("sensor_by_log") or {}).values() if key == "sensor_rms" else ()
            by_log = f" ({number(min(own), 2)} to {number(max(own), 2)} by log)" if own else ""
            parts.append(f"{what} of {with_unit(told['value'], unit, 2)} rms{by_log}")
    if noise["torque_rms_pct"]["ci95"][0] > 0.0:
        parts[-1] += f" that lasts {with_unit(noise['torque_time_s']['value'], 's', 2)}"
    return f" What is left is {listed(parts)}." if parts else ""


def _clock(diagnosis: Mapping[str, Any]) -> str:
    """What times mean where the logs did not say when they were begun; empty otherwise."""
    taken = diagnosis.get("clock") == "logs one after the other"
    return ", its time being that of the logs one after the other, in the order given" if taken else ""


def own_start_sentence(diagnosis: Mapping[str, Any]) -> str:
    """What held-out logs leave once what differs from run to run is taken from their beginnings; empty without any."""
    told, unit = diagnosis.get("own_start"), str(diagnosis.get("output_unit", ""))
    if not isinstance(told, Mapping):
        return ""
    cold, own = told["cold"], told["own"]
    seconds = ((diagnosis.get("settings") or {}).get("own_start") or {}).get("seconds")
    return (
        f"With gain, friction, load and dead time of each held-out log from its own first {number(seconds, 3)} s at "
        f"most, what comes after errs by {with_unit(own['window_rms'], unit)} rms in windows of 1 s "
        f"({with_unit(cold['window_rms'], unit)} without) and by {with_unit(own['free_run_rms'], unit)} as whole runs "
        f"({with_unit(cold['free_run_rms'], unit)})."
    )


def found_words(diagnosis: Mapping[str, Any]) -> list[str]:
    """The effects that were found, each with those that explain as much in its place."""
    found = []
    for step in diagnosis.get("steps") or []:
        rivals, name = rivals_of(diagnosis, step), effect_words(str(step.get("effect", "?")))
        found.append(f"{name} (these data cannot tell it from {listed(rivals, 'or')})" if rivals else name)
    return found


def rivals_of(diagnosis: Mapping[str, Any], step: Mapping[str, Any]) -> list[str]:
    """What explains as much in the place of an effect; not what was found beside it: of those the data need both."""
    both = {other.get("effect") for other in diagnosis.get("steps") or []}
    return [effect_words(str(name)) for name in step.get("indistinguishable_from") or [] if name not in both]


def _level(diagnosis: Mapping[str, Any], lead: str = ", ") -> str:
    role = judged(diagnosis)
    error = error_of(diagnosis.get("after"), role)
    floor = error_of(diagnosis.get("floor"), role)
    if error is None:
        return ""
    unit = str(diagnosis.get("output_unit", ""))
    floor_text = f", floor {with_unit(floor, unit)}" if floor is not None else ""
    if lead == ", ":
        return f" ({_role(role)} error {with_unit(error, unit)}{floor_text})"
    return f"{lead}The {_role(role)} error is {with_unit(error, unit)}{floor_text}."


def _change(diagnosis: Mapping[str, Any]) -> str:
    role = judged(diagnosis)
    unit = str(diagnosis.get("output_unit", ""))
    before, after = (error_of(diagnosis.get(key), role) for key in ("before", "after"))
    floor = error_of(diagnosis.get("floor"), role)
    if before is None or after is None:
        return ""
    verb = "falls" if after < before else "goes"
    tail = f"; the floor is {with_unit(floor, unit)}" if floor is not None else ""
    text = f"The {_role(role)} error {verb} from {with_unit(before, unit)} to {with_unit(after, unit)} rms{tail}."
    return text[0].upper() + text[1:]


def _role(role: str) -> str:
    return ROLE_WORDS[role].replace(" ", "-")
