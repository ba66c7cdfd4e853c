"""Writes docs/effects.md from the library of effects: ``python docs/tools/effects_page.py``."""

from __future__ import annotations

from pathlib import Path

from fiohost.motor.effect import Effect, Parameter, effects
from firmware_model.registry import effects as board_effects

PAGE = Path(__file__).resolve().parent.parent / "effects.md"

HEAD = """\
# Effects

A model is `linear` plus effects: `linear+coulomb_friction+gravity_load`. This page lists the library; `fiohost effects`
and `fiohost effects NAME` show the same on the terminal. It is written by `python docs/tools/effects_page.py`.

Torque-like parameters are in percent of duty: the duty that would balance them. That is all a log of commands and
angles can tell: resistance, torque constant, inertia and supply cannot be separated by it. Positive loads oppose
forward motion. Angles are in degrees of the output shaft, speeds in degrees a second.

Some effects are exactly the same thing seen in a log, whatever the experiment. They are named together, always: in the
result they stand under `indistinguishable_from`.

Where the simulated board can carry an effect, the keys of its table in a [plant file](plants.md) are given too.
"""

TAIL = """
## Adding one

One file in `fiohost/motor/effects/` with the equation, parameters, bounds, the sign that physics allows, what it is
equivalent to and where it comes from; one file in `firmware_model/effects/`, written apart from it, so that a fault in
one is visible to the other; one test. Then write this page anew.
"""


def page() -> str:
    """The whole page as text."""
    return HEAD + "".join(section(item) for item in effects().values()) + TAIL


def section(item: Effect) -> str:
    lines = [f"\n## {item.name}\n", f"{item.summary[0].upper()}{item.summary[1:]}.\n", f"- Equation: `{item.equation}`"]
    if item.signature:
        lines.append(f"- What it does to a log: {item.signature}")
    if item.equivalents:
        names = ", ".join(f"`{name}`" for name in item.equivalents)
        lines.append(f"- The same in every log as: {names}")
    lines.append(f"- Source: {item.source}")
    lines += ["", "| parameter | unit | range |", "|---|---|---|"]
    lines += [f"| `{p.name}` | {p.unit or '–'} | {bounds(p)} |" for p in item.parameters]
    board = board_effects().get(item.name)
    if board is not None:
        keys = ", ".join(f"`{p.key}`" + (f" ({' or '.join(p.choices)})" if p.choices else "") for p in board.parameters)
        lines += ["", f"In a plant file: `[effects.{item.name}]` with {keys}."]
    return "\n".join(lines) + "\n"


def bounds(parameter: Parameter) -> str:
    if parameter.choices:
        return " or ".join(f"`{choice}`" for choice in parameter.choices)
    if parameter.period:
        return f"any; {parameter.period:g} is a full turn"
    return f"{parameter.lower:g} to {parameter.upper:g}"


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
