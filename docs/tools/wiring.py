"""Wiring of the boards as pictures: python docs/tools/wiring.py writes docs/images/wiring_*.svg.

A picture is three columns (computer or adapter, controller, bridge, motor and encoder); every wire is a straight line
between two pins at one height, so that none crosses another. Pins stand in the order of their wires, not where they are
on the board.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import escape

IMAGES = Path(__file__).resolve().parent.parent / "images"
ROW = 34  # between two wires
TOP = 84
PIN = 5
SUPPLY, GROUND, LOGIC, SENSOR, MOTOR, LINE = "#c62828", "#424242", "#1565c0", "#2e7d32", "#e65100", "#6a1b9a"


@dataclass(frozen=True)
class Box:
    """A part: its name, its left and right edge, the rows it covers, a remark below its name."""

    name: str
    left: int
    right: int
    first: float
    last: float
    remark: str = ""
    fill: str = "#f5f5f5"


@dataclass(frozen=True)
class Wire:
    """From the right pin of one box to the left pin of another, at one height. ``down``: a resistor to GND on it."""

    row: float
    start: Box
    pin: str
    end: Box
    to: str
    colour: str
    down: str = ""


@dataclass(frozen=True)
class Picture:
    name: str
    title: str
    boxes: tuple[Box, ...]
    wires: tuple[Wire, ...]
    notes: tuple[str, ...]


def y_of(row: float) -> float:
    return TOP + ROW * row


def draw(picture: Picture) -> str:
    """The picture as SVG."""
    bottom = max(y_of(box.last) for box in picture.boxes) + 62
    height = bottom + 20 * len(picture.notes) + 12
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1000 {height:g}" width="1000" height="{height:g}" '
        'font-family="DejaVu Sans, Arial, sans-serif" font-size="13">',
        f"<title>{escape(picture.title)}</title>",
        f'<rect width="1000" height="{height:g}" fill="white"/>',
        f'<text x="20" y="30" font-size="18" font-weight="bold">{escape(picture.title)}</text>',
    ]
    for box in picture.boxes:
        top, low = y_of(box.first) - 40, y_of(box.last) + 20
        middle = (box.left + box.right) / 2
        out.append(
            f'<rect x="{box.left}" y="{top:g}" width="{box.right - box.left}" height="{low - top:g}" rx="8" '
            f'fill="{box.fill}" stroke="#37474f" stroke-width="1.5"/>'
        )
        name = f'x="{middle:g}" y="{top + 17:g}" text-anchor="middle" font-weight="bold"'
        out.append(f"<text {name}>{escape(box.name)}</text>")
        if box.remark:
            out.append(
                f'<text x="{middle:g}" y="{low + 15:g}" text-anchor="middle" font-size="11" fill="#555">'
                f"{escape(box.remark)}</text>"
            )
    for wire in picture.wires:
        out += _wire(wire)
    for k, note in enumerate(picture.notes):
        out.append(f'<text x="20" y="{bottom + 20 * k:g}" font-size="12" fill="#333">{escape(note)}</text>')
    return "\n".join([*out, "</svg>", ""])


def _wire(wire: Wire) -> list[str]:
    y, left, right = y_of(wire.row), wire.start.right, wire.end.left
    out = [f'<line x1="{left}" y1="{y:g}" x2="{right}" y2="{y:g}" stroke="{wire.colour}" stroke-width="2.5"/>']
    if wire.down:
        x = left + 0.62 * (right - left)
        out.append(f'<circle cx="{x:g}" cy="{y:g}" r="3.5" fill="{wire.colour}"/>')
        out.append(f'<line x1="{x:g}" y1="{y:g}" x2="{x:g}" y2="{y + 66:g}" stroke="{GROUND}" stroke-width="1.5"/>')
        out += _resistor(x - 6, y + 12, 12, 34, GROUND)
        out.append(f'<text x="{x + 12:g}" y="{y + 34:g}" font-size="11">{escape(wire.down)}</text>')
        for k, half in enumerate((11, 7, 3)):
            at = y + 66 + 4 * k
            ends = f'x1="{x - half:g}" y1="{at:g}" x2="{x + half:g}" y2="{at:g}"'
            out.append(f'<line {ends} stroke="{GROUND}" stroke-width="1.5"/>')
    for x, anchor, at, text in ((left, "end", left - 10, wire.pin), (right, "start", right + 10, wire.to)):
        out.append(f'<rect x="{x - PIN}" y="{y - PIN:g}" width="{2 * PIN}" height="{2 * PIN}" fill="{wire.colour}"/>')
        out.append(f'<text x="{at:g}" y="{y + 4.5:g}" text-anchor="{anchor}">{escape(text)}</text>')
    return out


def _resistor(x: float, y: float, width: float, height: float, colour: str) -> list[str]:
    return [
        f'<rect x="{x:g}" y="{y:g}" width="{width:g}" height="{height:g}" fill="white" stroke="{colour}" '
        'stroke-width="1.5"/>'
    ]


def uno(bridge: str) -> Picture:
    """Uno or Nano with a TB6612 or an L298N."""
    tb = bridge == "tb6612"
    pc = Box("computer", 20, 120, 3, 4)
    board = Box("Arduino Uno / Nano", 250, 400, 0, 10.5, "ATmega328P, 5 V", "#e3f2fd")
    chip = Box("TB6612 module" if tb else "L298N module", 580, 720, 0, 7, fill="#fff3e0")
    supply = Box("motor supply", 860, 980, 0, 1, fill="#ffebee")
    motor = Box("motor", 860, 980, 3.2, 4.2, fill="#fbe9e7")
    encoder = Box("encoder", 860, 980, 8.4, 10.5, "on the motor's shaft", "#e8f5e9")
    logic: tuple[tuple[float, str, str, str, str], ...] = (
        (0, "5V", "VCC" if tb else "+5V *", SUPPLY, ""),
        (1, "GND", "GND", GROUND, ""),
        (2, "D8", "AIN1" if tb else "IN1", LOGIC, ""),
        (3, "D10", "AIN2" if tb else "IN2", LOGIC, ""),
        (4, "D9", "PWMA" if tb else "ENA **", LOGIC, "" if tb else "10 k"),
        *(((5, "D12", "STBY", LOGIC, "10 k"),) if tb else ()),
    )
    wires = [Wire(row, board, pin, chip, to, colour, down) for row, pin, to, colour, down in logic]
    wires += [
        Wire(3.5, pc, "USB", board, "USB", LINE),
        Wire(0, chip, "VM" if tb else "+12V", supply, "+", SUPPLY),
        Wire(1, chip, "GND", supply, "-", GROUND),
        Wire(3.2, chip, "AO1" if tb else "OUT1", motor, "M1", MOTOR),
        Wire(4.2, chip, "AO2" if tb else "OUT2", motor, "M2", MOTOR),
        Wire(8.4, board, "D2", encoder, "A", SENSOR),
        Wire(9.1, board, "D3", encoder, "B", SENSOR),
        Wire(9.8, board, "5V", encoder, "VCC", SUPPLY),
        Wire(10.5, board, "GND", encoder, "GND", GROUND),
    ]
    notes = (
        (
            "The 10 k resistor keeps the bridge off (STBY low) while the board starts or is flashed.",
            "Pins stand in the order of their wires, not where they are on the boards.",
        )
        if tb
        else (
            "*  from the Uno only where the module's own 5 V regulator is off (its 5V-EN jumper taken out).",
            "** take the jumper off ENA. The 10 k resistor keeps the bridge off (ENA low) while the board starts.",
            "Pins stand in the order of their wires, not where they are on the boards.",
        )
    )
    title = f"Arduino Uno or Nano with {'a TB6612' if tb else 'an L298N'}"
    return Picture(f"uno_{bridge}", title, (pc, board, chip, supply, motor, encoder), tuple(wires), notes)


def bluepill() -> Picture:
    """Blue Pill with a TB6612 and a serial adapter."""
    adapter = Box("USB adapter", 20, 140, 2, 4, "serial, 3.3 V levels", "#f3e5f5")
    board = Box("Blue Pill", 270, 400, 0, 10.5, "STM32F103C8, 3.3 V", "#e3f2fd")
    chip = Box("TB6612 module", 580, 720, 0, 7, fill="#fff3e0")
    supply = Box("motor supply", 860, 980, 0, 1, fill="#ffebee")
    motor = Box("motor", 860, 980, 3.2, 4.2, fill="#fbe9e7")
    encoder = Box("encoder", 860, 980, 8.4, 10.5, "on the motor's shaft", "#e8f5e9")
    wires = (
        Wire(0, board, "3V3", chip, "VCC", SUPPLY),
        Wire(1, board, "GND", chip, "GND", GROUND),
        Wire(2, board, "PB12", chip, "AIN1", LOGIC),
        Wire(3, board, "PB13", chip, "AIN2", LOGIC),
        Wire(4, board, "PA3", chip, "PWMA", LOGIC),
        Wire(5, board, "PB14", chip, "STBY", LOGIC, "10 k"),
        Wire(2, adapter, "TX", board, "PA10", LINE),
        Wire(3, adapter, "RX", board, "PA9", LINE),
        Wire(4, adapter, "GND", board, "GND", GROUND),
        Wire(0, chip, "VM", supply, "+", SUPPLY),
        Wire(1, chip, "GND", supply, "-", GROUND),
        Wire(3.2, chip, "AO1", motor, "M1", MOTOR),
        Wire(4.2, chip, "AO2", motor, "M2", MOTOR),
        Wire(8.4, board, "PA6", encoder, "A *", SENSOR),
        Wire(9.1, board, "PA7", encoder, "B *", SENSOR),
        Wire(9.8, board, "3V3", encoder, "VCC *", SUPPLY),
        Wire(10.5, board, "GND", encoder, "GND", GROUND),
    )
    notes = (
        "The 10 k resistor keeps the bridge off (STBY low) while the board starts or is flashed.",
        "*  PA6 and PA7 do not stand 5 V: feed the encoder with 3.3 V, or give A and B a divider each (10 k in the",
        "    wire, 20 k from the pin to GND) and VCC its own 5 V.",
    )
    boxes = (adapter, board, chip, supply, motor, encoder)
    return Picture("bluepill_tb6612", "Blue Pill with a TB6612", boxes, wires, notes)


def pictures() -> dict[str, str]:
    """File name -> SVG."""
    return {f"wiring_{one.name}.svg": draw(one) for one in (uno("tb6612"), uno("l298n"), bluepill())}


if __name__ == "__main__":
    for name, text in pictures().items():
        (IMAGES / name).write_text(text, encoding="utf-8")
        print(IMAGES / name)
