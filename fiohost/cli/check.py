"""``fiohost check``: whether logs are whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from fiohost.cli.options import PATH
from fiohost.cli.output import json_option, output_for
from fiohost.errors import LogError

SCHEMA = "fiohost.check/1"


@click.command()
@click.argument("logs", nargs=-1, required=True, type=PATH, metavar="LOG...")
@json_option
def check(logs: Sequence[Path], json_to: str | None) -> None:
    """Say of each LOG whether it is whole, cut off or altered since it was written, and what is missing.

    A log ends with a line of its row count and check sums. Exit code 1 where one is not whole.

    \b
    Example:
      fiohost check run.csv
      fiohost check *.csv --json check.json
    """
    from fiohost import files
    from fiohost.bench.integrity import WHOLE, judge
    from fiohost.bench.log import MAX_LOG_BYTES, Log

    out = output_for(json_to)
    results: list[dict[str, Any]] = []
    for path in logs:
        try:
            found = judge(files.read_input(path, MAX_LOG_BYTES, "the log", LogError))
        except LogError as exc:  # the others are looked at all the same
            out(f"{path}: UNREADABLE; {exc}")
            results.append({"log": path, "state": "unreadable", "rows": 0, "rows_written": None, "ending": "",
                            "notes": [str(exc)]})  # fmt: skip
            continue
        notes, ending, last_s = list(found.notes), "", None
        try:
            log = Log.read(path)
            ending, last_s = log.metadata.get("ending", ""), float(log.time_s[-1])
            notes += [note for note in log.dropped if "altered" not in note]
        except LogError as exc:
            notes.append(str(exc))
        rows = f"{found.rows} rows" if found.rows_written is None else f"{found.rows} of {found.rows_written} rows"
        upto = "" if last_s is None else f", the last at {last_s:g} s"
        out(f"{path}: {found.state.upper() if found.state != WHOLE else WHOLE}, {rows}{upto}; ending: {ending or '-'}")
        for note in notes:
            out(f"  {note}")
        results.append({"log": path, "state": found.state, "rows": found.rows, "rows_written": found.rows_written,
                        "ending": ending, "notes": notes})  # fmt: skip
    out.json({"schema": SCHEMA, "logs": results})
    bad = [result for result in results if result["state"] != WHOLE]
    if bad:
        raise LogError(f"{len(bad)} of {len(results)} logs {'is' if len(bad) == 1 else 'are'} not whole; see above")
