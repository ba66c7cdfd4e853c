"""The sign of a command that has none: a column beside it that says which way, in numbers or in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from fiohost.importing.found import Found
from fiohost.importing.raw import TEXT, FloatArray, RawColumn, RawTable
from fiohost.importing.roles import plain, words_of

Value = float | str

DIRECTION_WORDS = frozenset({"dir", "direction", "richtung", "drehrichtung", "sign", "vorzeichen", "ccw", "reverse"})
BACKWARD_WORDS = frozenset({"ccw", "reverse"})  # whose larger value is backwards
FORWARD, BACKWARD, STILL = 1.0, -1.0, 0.0
MEANINGS = {
    word: way
    for way, words in (
        (FORWARD, "f fw fwd forward forwards cw right vor vorwaerts rechts pos positive up"),
        (BACKWARD, "b bw bwd r rv rev reverse reversed backward backwards back ccw left links zurueck rueckwaerts neg"),
        (BACKWARD, "negative down"),
        (STILL, "n s neutral none stop stopped brake braked coast off idle halt hold aus bremse"),
    )
    for word in words.split()
}
SIGNS = {"+": FORWARD, "-": BACKWARD, "": STILL}
MOST_VALUES = 4
LEAST_SHARE = 0.02  # of the driven rows for either value: less is a shaft that swings, measured
CLEAR = 0.2  # of the fast speed: from here on the shaft tells which value is forward


@dataclass(frozen=True)
class Direction:
    """A column and its values for forward and backward; where one of them is None, that is every other value but words
    for standing still.
    """

    column: str
    forward: Value | None
    backward: Value | None = None

    def ways(self, column: RawColumn) -> FloatArray:
        """1 where the command is forward, -1 where it is backward, 0 where it is neither, shape (rows,)."""
        values = values_of(column)
        forward, backward = values == self.forward, values == self.backward
        still = np.isin(values, [word for word in column.words if meaning(word) == STILL])
        if self.forward is None:
            forward = ~(backward | still)
        if self.backward is None:
            backward = ~(forward | still)
        return np.where(forward, FORWARD, np.where(backward, BACKWARD, STILL))


@dataclass(frozen=True)
class Driven:
    """A table of a bench with its command in percent and the speed of its shaft in any unit, each (rows,)."""

    table: RawTable
    duty: FloatArray
    speed: FloatArray


def values_of(column: RawColumn) -> np.ndarray:
    """What stands in a column of few different values, shape (rows,): numbers, or words as they are written."""
    return np.array(column.words, dtype=object)[column.values.astype(np.intp)] if column.words else column.values


def direction_of(tables: Sequence[Driven], found: Found) -> Direction | None:
    """The column that says which way, in all *tables* of a bench; None where the command has a sign or no column
    tells one.

    Words and negative numbers say it themselves, the shaft which of two others is forward; where its speed has a sign,
    it has the last word.
    """
    if any(not np.isfinite(one.duty).any() or np.nanmin(one.duty) < 0.0 for one in tables):
        return None
    likely = [
        c for c in tables[0].table.columns
        if words_of(c.name) & DIRECTION_WORDS and c.name not in found.used
        and all(_tells(one.table, c.name) for one in tables)
    ]  # fmt: skip
    if len(likely) != 1:
        return None
    name = likely[0].name
    duty, speed = (np.concatenate([getattr(one, of) for one in tables]) for of in ("duty", "speed"))
    values = np.concatenate([values_of(one.table.column(name)) for one in tables])
    driven = np.isfinite(duty) & np.isfinite(speed) & (duty > 0.3 * np.nanmax(duty))
    said, plainly = _meanings(values, bool(words_of(name) & BACKWARD_WORDS))
    if not said:
        return None
    ways = np.array([said[value] for value in values.tolist()])
    words = isinstance(values[0], str)
    sides = [driven & (ways == way) for way in (FORWARD, BACKWARD)]
    least, most = sorted(np.count_nonzero(side) for side in sides)
    if not most or (least < LEAST_SHARE * most and not (plainly and (words or not least))):
        return None
    if not words and np.any(driven & (ways == STILL)):
        return None  # what stands still though it is driven is measured
    found.used.add(name)
    fast = float(np.nanquantile(np.abs(speed), 0.9))
    means = [way * float(np.mean(speed[side])) for way, side in zip((1.0, -1.0), sides, strict=True) if side.any()]
    told = min(map(abs, means)) > CLEAR * fast and (min(means) > 0.0 or max(means) < 0.0) and np.nanmin(speed) < 0.0
    turned = told and means[0] < 0.0
    names = {-way if turned else way: value for value, way in said.items() if way != STILL}
    direction = Direction(name, names.get(FORWARD), names.get(BACKWARD) if plainly else None)
    sides_said = (("forward", direction.forward), ("backward", direction.backward))
    where = ", ".join(f"{way} where it is {_shown(value)}" for way, value in sides_said if value is not None)
    shaft = ", as the shaft turns" if turned or (told and not plainly) else ""
    if not (plainly or told):
        found.lines.append(f"sign of the command: {name!r}")
        found.assumed.append(f"the command is forward where {name!r} is {_shown(direction.forward)}")
    else:
        found.lines.append(f"sign of the command: {name!r}, {where}{shaft}")
    return direction


def _tells(table: RawTable, name: str) -> bool:
    """Whether a table's column of that name may be a direction: a few numbers, none missing, or a few words."""
    column = table.column(name)
    if column.kind == TEXT:
        return bool(column.words)
    return not column.missing and not column.bad and len(np.unique(column.values)) <= MOST_VALUES


def _meanings(values: np.ndarray, larger_is_backward: bool) -> tuple[dict[Value, float], bool]:
    """Which way each of the different values says, and whether they say it themselves; nothing where they do not."""
    different: list[Value] = sorted(set(values.tolist()), key=lambda value: (isinstance(value, str), value))
    said = {value: meaning(value) for value in different} if len(different) <= MOST_VALUES else {}
    known = {value: way for value, way in said.items() if way is not None}
    ways = [way for way in known.values() if way != STILL]
    bits = different == [0.0, 1.0] or (larger_is_backward and not any(isinstance(value, str) for value in different))
    if not bits and len(known) == len(different) and ways and len(set(ways)) == len(ways):
        return known, True
    if len(different) != 2:
        return {}, False
    low, high = different
    return {low: FORWARD, high: BACKWARD} if larger_is_backward else {low: BACKWARD, high: FORWARD}, False


def meaning(value: Value) -> float | None:
    """Which way a value says: 1, -1, or 0 for neither; None where it says nothing, as 1 does where the other is 0."""
    if not isinstance(value, str):
        return float(value) if value in (FORWARD, BACKWARD, STILL) else None
    word = value.strip()
    return SIGNS[word] if word in SIGNS else MEANINGS.get(plain(word))


def _shown(value: Value | None) -> str:
    return f"{value:g}" if isinstance(value, float) else repr(value)
