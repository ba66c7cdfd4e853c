"""Which column is what: told by the words and units in its head."""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass

from fiohost.importing import units as u
from fiohost.importing.raw import TIME as STAMPS
from fiohost.importing.raw import RawColumn
from fiohost.importing.units import Unit, name_and_unit, unit_of

TIME, COMMAND, OUTPUT, REFERENCE, CURRENT, SUPPLY, TEMPERATURE, TORQUE, INDEX, OTHER = (
    "time", "command", "output", "reference", "current", "supply", "temperature", "torque", "index", "other"
)  # fmt: skip


def _sure(points: float, *lines: str) -> dict[str, float]:
    """Each of the words of these lines, with how sure it makes."""
    return {word: points for line in lines for word in line.split()}


# Words of a head, English and German; the number says how sure a word makes.
WORDS: dict[str, dict[str, float]] = {
    TIME: _sure(
        3.0, "time zeit timestamp datetime uhrzeit zeitstempel zeitpunkt millis micros elapsed", "tempo temps seconds"
    )
    | _sure(2.5, "t x_value ts")
    | _sure(1.5, "date datum clock"),
    COMMAND: _sure(
        3.0, "duty pwm command cmd stellgroesse stellwert stellgrad tastgrad tastverhaeltnis throttle dutycycle"
    )
    | _sure(2.5, "u input control actuation effort drive excitation eingang ansteuerung aussteuerung")
    | _sure(
        2.0,
        "voltage volt volts spannung motorspannung ankerspannung power leistung uq vm va ua vmotor umotor",
        "armature motor",
    )
    | _sure(1.5, "v"),
    OUTPUT: _sure(
        2.5,
        "angle position pos theta phi winkel encoder enc drehwinkel lage counter zaehler",
        "speed velocity vel omega rpm drehzahl geschwindigkeit winkelgeschwindigkeit",
    )
    | _sure(1.5, "y count counts ticks w n x q angular output rotation ausgang tacho"),
    REFERENCE: _sure(
        3.0,
        "ref reference setpoint soll sollwert target desired sollwinkel solldrehzahl fuehrungsgroesse wanted r",
    ),
    CURRENT: _sure(2.5, "current strom amps amp i iq motorcurrent motorstrom ankerstrom ia"),
    SUPPLY: _sure(3.5, "supply vbat battery vsupply vbus versorgung batterie vin vcc vdd akku versorgungsspannung"),
    TEMPERATURE: _sure(2.5, "temp temperature temperatur"),
    TORQUE: _sure(2.0, "torque drehmoment moment load tau"),
    INDEX: _sure(2.0, "index sample samples nr no row idx k zeile lfd step seq id unnamed"),
    OTHER: _sure(
        3.0,
        "error err fehler sim simulated model est estimate estimated predicted filtered raw status state flag mode",
        "comment bemerkung kommentar note dir direction richtung c3 c4 acceleration accel",
    ),
}
SPEED_WORDS = frozenset(
    _sure(1.0, "speed velocity vel omega rpm drehzahl geschwindigkeit winkelgeschwindigkeit w n angular")
)
COUNT_WORDS = frozenset(_sure(1.0, "encoder enc counts count ticks counter zaehler"))
MEASURED = frozenset(_sure(1.0, "ist measured actual meas messwert gemessen istwert act feedback"))


@dataclass(frozen=True)
class Head:
    """What the head of a column says: its name without unit, its unit, and how likely it is each of the roles."""

    column: RawColumn
    name: str
    unit_text: str
    unit: Unit | None
    words: frozenset[str]
    scores: dict[str, float]

    @property
    def role(self) -> str:
        """The likeliest role, "" where nothing speaks for any."""
        best = max(self.scores, key=lambda role: self.scores[role])
        return best if self.scores[best] > 0.0 else ""

    def score(self, role: str) -> float:
        return self.scores[role]


def head_of(column: RawColumn) -> Head:
    """Read the head of a column."""
    name, inside = name_and_unit(column.name)
    text = column.unit or inside
    unit = unit_of(text)
    words = words_of(name)
    scores = {role: max((table.get(word, 0.0) for word in words), default=0.0) for role, table in WORDS.items()}
    whole = "_".join(plain(name).split())
    for role, table in WORDS.items():
        if whole in table:
            scores[role] = table[whole] + 0.5
    if column.kind == STAMPS:
        scores[TIME] += 4.0 if scores[TIME] else 3.0
    if unit is not None:
        for role, points in _of_unit(unit).items():
            scores[role] += points
        if unit.measures != u.TIME:
            scores[TIME] = 0.0
        if unit.measures in (u.ANGLE, u.SPEED, u.POSITION):
            for role in (COMMAND, CURRENT, SUPPLY, TORQUE, INDEX):
                if role == COMMAND and scores[role] > 2.6:  # a commanded angle is a reference
                    scores[REFERENCE] = max(scores[REFERENCE], scores[role]) + 1.0
                scores[role] = 0.0
        elif unit.measures in (u.VOLTAGE, u.RATIO, u.CURRENT, u.TORQUE, u.TEMPERATURE, u.TIME):
            scores[OUTPUT] = scores[REFERENCE] = 0.0
        if unit.measures == u.CURRENT:
            scores[COMMAND] = min(scores[COMMAND], 0.5)
        if unit.measures == u.TIME:
            scores = {role: points if role in (TIME, OTHER) else 0.0 for role, points in scores.items()}
        scores[INDEX] = 0.0
    if scores[REFERENCE] and scores[OUTPUT]:
        scores[REFERENCE] += 2.0
    if scores[OTHER] and not words & MEASURED:
        scores[OTHER] += 2.0
    if words & MEASURED:
        scores[OUTPUT] += 1.0 if scores[OUTPUT] else 0.0
    return Head(column, name, text, unit, words, scores)


def words_of(name: str) -> frozenset[str]:
    """The words of a name: split at signs, digits and changes of case."""
    text = re.sub(r"([a-z])([A-Z])", r"\1 \2", name)
    parts = re.split(r"[^a-z]+", plain(text))
    return frozenset(part for part in (*parts, *plain(name).split()) if part)


def plain(text: str) -> str:
    """Lower case, umlauts written out, accents gone, signs as blanks."""
    text = text.lower().replace("ä", "ae").replace("ö", "oe").replace("ü", "ue").replace("ß", "ss")
    text = text.replace("ω", "omega").replace("θ", "theta").replace("φ", "phi").replace("ϕ", "phi")
    text = unicodedata.normalize("NFKD", text).encode("ascii", "ignore").decode()
    return re.sub(r"[^a-z0-9]+", " ", text).strip()


def _of_unit(unit: Unit) -> dict[str, float]:
    return {
        u.TIME: {TIME: 3.0},
        u.ANGLE: {OUTPUT: 2.0},
        u.SPEED: {OUTPUT: 2.0},
        u.POSITION: {OUTPUT: 2.0},
        u.VOLTAGE: {COMMAND: 1.5},
        u.RATIO: {COMMAND: 2.0},
        u.CURRENT: {CURRENT: 2.0},
        u.TORQUE: {TORQUE: 2.0},
        u.TEMPERATURE: {TEMPERATURE: 2.0},
    }[unit.measures]
