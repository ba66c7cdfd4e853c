"""A log of columns that are all there: written at once, each number as the shortest text that is read as that number.

A run writes its log row by row (:class:`fiohost.bench.writer.LogWriter`), so that a killed host loses none.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fiohost.bench.integrity import end_line
from fiohost.bench.writer import SCHEMA, one_line
from fiohost.files import Output, write_output

FloatArray = NDArray[np.float64]
LARGE_CELLS = 100_000  # from here on pyarrow is worth its import


def log_text(columns: Mapping[str, FloatArray], metadata: Mapping[str, str]) -> bytes:
    """The whole log with its last line: columns of one length (n) by name, NaN where a cell is empty."""
    lines = [f"# schema: {SCHEMA}"]
    lines += [f"# {one_line(k, 60)}: {one_line(v, 500)}" for k, v in metadata.items() if v and k != "schema"]
    head = ("\n".join([*lines, ",".join(columns)]) + "\n").encode()
    rows = rows_text(columns)
    count = len(next(iter(columns.values()))) if columns else 0
    return b"".join((head, rows, end_line(count, zlib.crc32(head), zlib.crc32(rows)).encode()))


def write_log(output: Output, columns: Mapping[str, FloatArray], metadata: Mapping[str, str]) -> Path:
    """Write it, whole or not at all; gives the file's name. Raises FiohostError."""
    return write_output(output, log_text(columns, metadata))


def rows_text(columns: Mapping[str, FloatArray]) -> bytes:
    """Comma-separated rows; by pyarrow where there are many and it is installed."""
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in columns.items()}
    if sum(values.size for values in arrays.values()) >= LARGE_CELLS:
        try:
            from pyarrow import BufferOutputStream, array, csv, table
        except ImportError:
            pass
        else:
            sink = BufferOutputStream()
            cells = {name: array(values, from_pandas=True) for name, values in arrays.items()}  # NaN is empty
            csv.write_csv(table(cells), sink, csv.WriteOptions(include_header=False))
            return bytes(sink.getvalue())
    cells_of = zip(*(map(_text, values.tolist()) for values in arrays.values()), strict=True)
    return "".join(f"{','.join(row)}\n" for row in cells_of).encode()


def _text(value: float) -> str:
    if value != value:
        return ""
    text = repr(value)
    return text[:-2] if text.endswith(".0") else text
