"""Diagnoses real motors and writes what was found into ``docs/measured.md``, with pictures in ``docs/images``.

Usage: ``python benchmarks/measured.py [FOLDER]``. FOLDER, else ``measured`` in the folder named by FIOHOST_DATA, holds
``nxt_open_loop``, ``brake_pwm_gearmotor`` and ``emps``: the public data named in the maps of ``configs/maps``. It takes
some minutes: whole runs, the whole library.

The words are in ``measured.template.md``. They describe what was seen when they were written: read them against the
figures and the pictures after every run.
"""

from __future__ import annotations

import os
import string
import sys
from pathlib import Path

import measured_emps
import measured_gearmotor
import measured_nxt

TEMPLATE = Path(__file__).with_name("measured.template.md")
PAGE = Path(__file__).resolve().parent.parent / "docs" / "measured.md"
SECTIONS = (
    ("nxt", "nxt_open_loop", measured_nxt.section),
    ("gear", "brake_pwm_gearmotor", measured_gearmotor.section),
    ("emps", "emps", measured_emps.section),
)


def main(folder: Path) -> None:
    facts: dict[str, str] = {}
    for prefix, name, section in SECTIONS:
        print(f"{name}:")
        facts |= {f"{prefix}_{key}": text for key, text in section(folder / name).items()}
    text = string.Template(TEMPLATE.read_text(encoding="utf-8")).substitute(facts)
    PAGE.write_text(text, encoding="utf-8")
    print("\n".join(text for key, text in facts.items() if key.endswith("_verdict")))


if __name__ == "__main__":
    named = os.environ.get("FIOHOST_DATA")
    given = sys.argv[1:] or ([f"{named}/measured"] if named else [])
    if len(given) != 1:
        sys.exit(__doc__)
    main(Path(given[0]))
