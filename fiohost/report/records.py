"""Records of a report as data for uPlot, which the page carries: they zoom and have a cursor without a network."""

from __future__ import annotations

import json
from collections.abc import Sequence
from importlib.resources import files as resources
from typing import Any

import numpy as np

from fiohost.report.plots import _quantity
from fiohost.report.series import Array, SeriesPlot

MOST_ROWS = 40_000  # of all records of a page together: some 2 MB
LEAST_ROWS = 2_000
DIGITS = 2  # of an error's rms that is shown


def records_script(series: Sequence[SeriesPlot]) -> str:
    """What goes between the script tags of a page: uPlot, the records, and what draws them."""
    library = (resources("fiohost.report") / "vendor" / "uPlot.iife.min.js").read_text(encoding="utf-8")
    library = library.partition("*/")[2] if library.startswith("/*!") else library  # its name stands in the foot
    drawing = (resources("fiohost.report") / "records.js").read_text(encoding="utf-8")
    rows = max(LEAST_ROWS, MOST_ROWS // max(len(series), 1))
    data = json.dumps([_record(one, rows) for one in series], allow_nan=False, separators=(",", ":"))
    return f"{library}\nconst RECORDS = {data.replace('</', '<' + chr(92) + '/')};\n{drawing}"


def records_style() -> str:
    return (resources("fiohost.report") / "vendor" / "uPlot.min.css").read_text(encoding="utf-8")


def _record(one: SeriesPlot, most_rows: int) -> dict[str, Any]:
    pick = _picked(one, most_rows)
    errors = [one.measured - y for y in (one.before, one.after) if y is not None]
    sizes = [float(np.sqrt(np.mean(e[np.isfinite(e)] ** 2))) for e in errors if np.isfinite(e).any()]
    decimals = _decimals(min([s for s in sizes if s > 0] or [1.0]))
    told: dict[str, Any] = {
        "label": f"{_quantity(one.unit)} ({one.unit})",
        "unit": one.unit,
        "time": _numbers(one.time_s[pick], 5),
        "measured": _numbers(one.measured[pick], decimals),
        "floor": one.floor_rms if np.isfinite(one.floor_rms) and one.floor_rms > 0 else None,
    }
    for name, values in (("before", one.before), ("after", one.after)):
        if values is not None:
            told[name] = _numbers(values[pick], decimals)
    if one.duty_pct is not None:
        told["duty"] = _numbers(one.duty_pct[pick], 2)
    return told


def _picked(one: SeriesPlot, most_rows: int) -> Array | Any:
    """Rows that are kept: of every piece those in which output and errors are extreme, so that peaks survive."""
    n = len(one.time_s)
    if n <= most_rows:
        return np.arange(n)
    wanted = [one.measured, *(one.measured - y for y in (one.before, one.after) if y is not None)]
    kept: set[int] = {0, n - 1}
    for piece in np.array_split(np.arange(n), most_rows // (2 * len(wanted))):
        for values in wanted:
            kept |= {int(piece[np.argmin(values[piece])]), int(piece[np.argmax(values[piece])])}
    return np.array(sorted(kept))


def _decimals(size: float) -> int:
    return int(np.clip(DIGITS - np.floor(np.log10(size)), 0, 9))


def _numbers(values: Array, decimals: int) -> list[float | None]:
    return [round(v, decimals) if np.isfinite(v) else None for v in values.tolist()]
