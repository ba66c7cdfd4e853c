"""Writes docs/effects.md from the library of effects: ``python docs/tools/effects_page.py``."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

from fiohost.advice.limit import shipped
from fiohost.motor.effect import Effect, Parameter, effects
from fiohost.report.outlook import given_words, size_words
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

LIMITS = """
## How small an effect shows

The smallest size of each effect at which a figure of some log would have passed what counts alone leave there. Measured
with the suite of `fiohost close-loop` on the `{plant}` plant:

- {experiments}: {seconds:.0f} s in all, counts of half a degree;
- the model is what the plant is, `{model}`, and leaves {floor:.3f} deg in
  one-second windows; those two effects are measured on the same plant without them;
- phases are the worst of three, other shapes the middle one.

These are limits of the counts and the experiments: a motor that does not repeat itself as well shows less.
`fiohost effects --limits LOG...` says how small an effect would show in logs of your own. The figures are written by
`python benchmarks/limits.py` and kept in `configs/limits/default_suite.toml`.

| effect | parameter | smallest seen | given | shows first in |
|---|---|---|---|---|
"""

TAIL = """
## Adding one

One file in `fiohost/motor/effects/` with the equation, parameters, bounds, the sign that physics allows, what it is
equivalent to and where it comes from; one file in `firmware_model/effects/`, written apart from it, so that a fault in
one is visible to the other; one test. Then run `benchmarks/limits.py` and write this page anew. An effect of your own
needs no change here: see [own-effect.md](own-effect.md).
"""


def page() -> str:
    """The whole page as text."""
    return HEAD + "".join(section(item) for item in effects().values()) + limits() + TAIL


def limits() -> str:
    """How small each effect may be and still show, as a table."""
    measured = shipped()
    lines = []
    for limit in measured.limits:
        told = limit.to_json()
        seen = "–" if limit.value is None else size_words(told)
        given = limit.reason if limit.value is None else given_words(told)
        shows = f"{limit.log.removesuffix('.csv')}, {limit.figure}" if limit.log else ""
        lines.append(f"| {limit.effect} | `{limit.parameter}` | {seen} | {given} | {shows} |\n")
    head = LIMITS.format(
        experiments=", ".join(f"{n} times {e}" if n > 1 else e for e, n in Counter(measured.experiments).items()),
        seconds=measured.seconds,
        plant=measured.plant,
        floor=measured.window_floor_deg,
        model=measured.model,
    )
    return head + "".join(lines)


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
