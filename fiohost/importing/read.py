"""One table out of a file of any kind: text, MATLAB's (v5, v7.3), HDF5, Parquet; told by its first bytes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from fiohost import files
from fiohost.bench.log import MAX_LOG_BYTES
from fiohost.errors import LogError
from fiohost.importing.raw import MAX_BYTES, RawTable
from fiohost.importing.text import read_text_table

HDF5, PARQUET, MATLAB, ZIP, GZIP = b"\x89HDF\r\n\x1a\n", b"PAR1", b"MATLAB 5.0 MAT-file", b"PK\x03\x04", b"\x1f\x8b"
MATLAB_73 = b"MATLAB 7.3 MAT-file"
OLD_OFFICE = b"\xd0\xcf\x11\xe0"


def read_raw(path: Path, wanted: Sequence[str] = ()) -> RawTable:
    """Read the table at *path*; of a text table, where columns are *wanted*, only those. Raises LogError."""
    head = first_bytes(path)
    if head.startswith((MATLAB, MATLAB_73, PARQUET)) or HDF5 in head:
        from fiohost.importing import binary

        if head.startswith(MATLAB):
            return _with(binary.read_mat(path), wanted)
        if head.startswith(PARQUET):
            return _with(binary.read_parquet(path), wanted)
        return _with(binary.read_hdf5(path), wanted)
    for magic, what in (
        (ZIP, "a zip archive or an Excel workbook: save the sheet as CSV, or unpack it"),
        (GZIP, "compressed: unpack it"),
        (OLD_OFFICE, "an old Excel workbook: save the sheet as CSV"),
    ):
        if head.startswith(magic):
            raise LogError(f"{path} is {what}")
    return read_text_table(path, wanted)


def first_bytes(path: Path, what: str = "the table") -> bytes:
    """The first kilobyte of a file; *what* names its kind in messages. Raises LogError."""
    with files.open_input(path, MAX_LOG_BYTES if what == "the log" else MAX_BYTES, what, LogError) as file:
        return file.read(1024)


def _with(table: RawTable, wanted: Sequence[str]) -> RawTable:
    for name in wanted:
        table.column(name)
    return table
