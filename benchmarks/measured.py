"""Diagnoses real motors and writes what was found into ``docs/measured.md``, with pictures in ``docs/images``.

Usage: ``python benchmarks/measured.py FOLDER [SECTION...]``. FOLDER (or ``-`` for ``measured`` in the folder named by
FIOHOST_DATA) holds ``nxt_open_loop``, ``brake_pwm_gearmotor`` and ``emps``: the public data named in the maps of
``configs/maps``, and that named in ``measured_more.py``; ``nxt_textbook`` beside it holds printed tables. Whole runs
against the whole library take minutes, so that sections (nxt, gear, emps, more, tables) can be made anew alone; the
others are as ``measured.json`` keeps them, each with the commit it was made at. ``words`` makes none anew.

The words are in ``measured.template.md`` and ``measured_tables.template.md``. They describe what was seen when they
were written: read them against the figures and the pictures after every run.
"""

from __future__ import annotations

import json
import os
import string
import sys
from collections.abc import Sequence
from pathlib import Path

import measured_emps
import measured_gearmotor
import measured_more
import measured_nxt
import measured_tables
from rows import commit

TEMPLATES = [Path(__file__).with_name(f"{name}.template.md") for name in ("measured", "measured_tables")]
PAGE = Path(__file__).resolve().parent.parent / "docs" / "measured.md"
KEPT = Path(__file__).with_name("measured.json")
SECTIONS = {
    "nxt": ("nxt_open_loop", measured_nxt.section),
    "gear": ("brake_pwm_gearmotor", measured_gearmotor.section),
    "emps": ("emps", measured_emps.section),
    "more": ("", measured_more.section),
    "tables": ("../nxt_textbook", measured_tables.section),
}
WORDS = "words"


def kept_sections() -> dict[str, dict[str, str]]:
    return dict(json.loads(KEPT.read_text(encoding="utf-8"))) if KEPT.exists() else {}


def main(folder: Path, chosen: Sequence[str]) -> None:
    for prefix in [c for c in chosen if c != WORDS]:
        name, section = SECTIONS[prefix]
        print(f"{name}:")
        made = {"commit": commit(), **section(folder / name)}
        kept = {**kept_sections(), prefix: made}  # another section may have been made meanwhile
        KEPT.write_text(json.dumps(kept, indent=1) + "\n", encoding="utf-8")
    facts = {f"{prefix}_{key}": text for prefix, told in kept_sections().items() for key, text in told.items()}
    words = "".join(template.read_text(encoding="utf-8") for template in TEMPLATES)
    PAGE.write_text(string.Template(words).substitute(facts), encoding="utf-8")
    print("\n".join(text for key, text in facts.items() if key.endswith("_verdict")))


if __name__ == "__main__":
    if {"-h", "--help"} & set(sys.argv):
        print(__doc__)
        sys.exit()
    if len(sys.argv) < 2 or not set(sys.argv[2:]) <= {*SECTIONS, WORDS}:
        sys.exit(__doc__)
    if sys.argv[1] == "-" and "FIOHOST_DATA" not in os.environ:
        sys.exit("set FIOHOST_DATA to the folder that holds the measured data, or name that folder instead of -")
    given = Path(os.environ["FIOHOST_DATA"], "measured") if sys.argv[1] == "-" else Path(sys.argv[1])
    main(given, sys.argv[2:] or list(SECTIONS))
