"""Tables in binary files, by the libraries that know them: MATLAB, HDF5, Parquet, and pandas' frames in memory."""

from __future__ import annotations

import hashlib
import zlib
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from fiohost import files
from fiohost.errors import ConfigError, LogError
from fiohost.importing.raw import (
    MAX_BYTES,
    TEXT,
    TIME,
    FloatArray,
    RawColumn,
    RawTable,
    checked_size,
    unique_names,
    within_reason,
)

MAX_DEPTH = 8
MAX_ITEMS = 10_000
SHORTEST = 2  # rows of what may be a column
MOST_UNPACKED = 1_000_000_000  # bytes: a small file may be compressed from more than any computer has
_MAT_HEAD, _MAT_COMPRESSED = 128, 15  # of a MATLAB v5 file: bytes before its elements, and the kind that is compressed


def read_mat(path: Path) -> RawTable:
    """A MATLAB file up to v7: vectors of one length, also within structures. Raises LogError."""
    from scipy.io import loadmat

    data = files.read_input(path, MAX_BYTES, "the MATLAB file", LogError)
    _check_unpacked(path, _mat_bytes(data))
    try:
        import io

        content = loadmat(io.BytesIO(data), simplify_cells=True)  # type: ignore[arg-type]
    except Exception as exc:  # of whatever kind: such files are made by anybody
        raise LogError(f"{path} cannot be read as a MATLAB file: {_short(exc)}") from exc
    return _table(path, data, dict(_leaves(content, "")), "MATLAB v5 to v7")


def read_hdf5(path: Path) -> RawTable:
    """An HDF5 file, as MATLAB v7.3 files are: data sets of one length. Raises LogError; ConfigError without h5py."""
    try:
        import h5py
    except ImportError:
        raise ConfigError(_absent(path, "an HDF5 or MATLAB 7.3 file", "h5py")) from None
    data = files.read_input(path, MAX_BYTES, "the HDF5 file", LogError)
    found: dict[str, Any] = {}
    units: dict[str, str] = {}
    sizes: list[int] = []

    def visit(name: str, item: Any) -> None:
        if not isinstance(item, h5py.Dataset) or len(found) >= MAX_ITEMS or name.startswith("#refs#"):
            return
        if item.dtype.kind == "O" or item.size is None:  # an empty one has no size
            return
        name = name.replace("/", ".")
        sizes.append(item.size * item.dtype.itemsize)
        _check_unpacked(path, sum(sizes))
        unit = next((item.attrs[k] for k in ("units", "unit", "Unit", "Units") if k in item.attrs), "")
        values = item[()]
        if values.dtype.names:
            for field in values.dtype.names:
                found[f"{name}.{field}"] = values[field]
            return
        if values.ndim == 2 and min(values.shape) == 1:
            values = values.ravel()  # MATLAB's vectors
        elif values.ndim == 2 and values.shape[0] < values.shape[1] and "MATLAB_class" in item.attrs:
            values = values.T
        found[name] = values
        units[name] = unit.decode() if isinstance(unit, bytes) else str(unit)

    try:
        with h5py.File(path, "r") as file:
            file.visititems(visit)
    except LogError:
        raise
    except Exception as exc:
        raise LogError(f"{path} cannot be read as HDF5: {_short(exc)}") from exc
    leaves: dict[str, Any] = {}
    for name, values in found.items():
        leaves.update(_leaves({name: values}, ""))
    form = "MATLAB v7.3" if data.startswith(b"MATLAB") else "HDF5"
    return _table(path, data, leaves, form, units)


def read_parquet(path: Path) -> RawTable:
    """A Parquet file. Raises LogError; ConfigError without pyarrow."""
    try:
        import pyarrow.parquet as parquet
    except ImportError:
        raise ConfigError(_absent(path, "a Parquet file", "pyarrow")) from None
    data = files.read_input(path, MAX_BYTES, "the Parquet file", LogError)
    try:
        import io

        file = parquet.ParquetFile(io.BytesIO(data))
        checked_size(path, file.metadata.num_rows, file.metadata.num_columns)
        table = file.read()
        leaves = {name: table.column(name).to_numpy() for name in table.column_names}
        units = {
            field.name: ((field.metadata or {}).get(b"unit") or (field.metadata or {}).get(b"units") or b"").decode()
            for field in table.schema
        }
    except LogError:
        raise
    except Exception as exc:
        raise LogError(f"{path} cannot be read as Parquet: {_short(exc)}") from exc
    return _table(path, data, leaves, "Parquet", units)


def read_frame(frame: Any, name: str = "(frame)") -> RawTable:
    """A pandas DataFrame: its columns, and its index where that is no mere count. Raises LogError."""
    leaves: dict[str, Any] = {}
    index = frame.index
    if index.name is not None or np.asarray(index).dtype.kind in "mM":
        leaves[str(index.name or "time")] = np.asarray(index)
    for column in frame.columns:
        label = "_".join(map(str, column)) if isinstance(column, tuple) else str(column)
        leaves[label] = np.asarray(frame[column])
    digest = hashlib.sha256(repr([(k, v.dtype.str) for k, v in leaves.items()]).encode())
    for values in leaves.values():
        digest.update(values.tobytes() if values.dtype.kind != "O" else repr(values.tolist()).encode())
    units = {str(k): str(v) for k, v in (frame.attrs.get("units") or {}).items()} if frame.attrs else {}
    return _table(Path(name), b"", leaves, "pandas DataFrame", units, digest.hexdigest())


def _mat_bytes(data: bytes) -> int:
    """How many bytes the compressed elements of a MATLAB v5 file become, or the first sum beyond what is allowed."""
    order: Literal["little", "big"] = "little" if data[126:128] == b"IM" else "big"
    at, total = _MAT_HEAD, 0
    while at + 8 <= len(data) and total <= MOST_UNPACKED:
        kind, size = (int.from_bytes(data[i : i + 4], order) for i in (at, at + 4))
        if kind == _MAT_COMPRESSED:
            unpacking, rest = zlib.decompressobj(), data[at + 8 : at + 8 + size]
            try:
                while rest and total <= MOST_UNPACKED:
                    total += len(unpacking.decompress(rest, MAX_BYTES // 8))
                    rest = unpacking.unconsumed_tail
            except zlib.error:  # the reader says what is wrong
                return total
        at += 8 + size
    return total


def _check_unpacked(path: Path, size: int) -> None:
    if size > MOST_UNPACKED:
        raise LogError(f"{path} unpacks to more than {MOST_UNPACKED / 1e6:g} MB: cut it into shorter records")


def _leaves(item: Any, name: str, depth: int = 0) -> Iterator[tuple[str, Any]]:
    """Vectors within structures; the columns of a matrix one by one, a name with a number."""
    if depth > MAX_DEPTH:
        return
    if isinstance(item, Mapping):
        for key, value in list(item.items())[:MAX_ITEMS]:
            if not str(key).startswith("__"):
                yield from _leaves(value, f"{name}.{key}" if name else str(key), depth + 1)
        return
    if not isinstance(item, np.ndarray):
        return
    if item.dtype.names:
        for field in item.dtype.names:
            yield from _leaves(item[field], f"{name}.{field}" if name else str(field), depth + 1)
    elif item.ndim == 1:
        yield name, item
    elif item.ndim == 2 and item.shape[0] >= SHORTEST:
        if item.shape[1] == 1:
            yield name, item[:, 0]
        elif item.shape[0] > item.shape[1]:
            for place in range(min(item.shape[1], MAX_ITEMS)):
                yield f"{name}_{place + 1}", item[:, place]


def _table(
    path: Path,
    data: bytes,
    leaves: Mapping[str, Any],
    form: str,
    units: Mapping[str, str] | None = None,
    sha256: str = "",
) -> RawTable:
    """The vectors of the length that most have, as columns. Raises LogError."""
    vectors = {k: v for k, v in leaves.items() if isinstance(v, np.ndarray) and v.ndim == 1 and v.size >= SHORTEST}
    vectors = {k: v for k, v in vectors.items() if v.dtype.kind in "biufmMUSO"}
    if not vectors:
        raise LogError(f"{path} ({form}) holds no vectors of numbers of {SHORTEST} rows or more")
    lengths = Counter(v.size for v in vectors.values())
    rows = max(lengths, key=lambda n: (lengths[n] > 1, n if lengths[n] > 1 else lengths[n], n))
    left = [k for k, v in vectors.items() if v.size != rows]
    vectors = {k: v for k, v in vectors.items() if v.size == rows}
    checked_size(path, rows, len(vectors))
    notes = [f"{len(left)} vectors of another length ({', '.join(left[:3])[:120]})"] if left else []
    names = unique_names([name.strip() for name in _short_names(list(vectors))])
    told = {**{k: "" for k in vectors}, **(units or {})}
    columns = []
    for (key, values), name in zip(vectors.items(), names, strict=True):
        column = replace(_column(values), name=name, unit=told.get(key, ""))
        columns.append(column if column.kind == TEXT else replace(column, missing=_missing(column.values)))
    if not sha256:
        sha256 = hashlib.sha256(data).hexdigest()
    return RawTable(path, sha256, tuple(columns), form, (), tuple(notes))


def _column(values: np.ndarray[Any, Any]) -> RawColumn:
    """Any vector as a column without a name."""
    if values.dtype.kind in "mM":
        known = values[~np.isnat(values)]
        first = known.min() if known.size else values[0]
        since = values - first if values.dtype.kind == "M" else values
        seconds = since.astype("timedelta64[ns]").astype(np.float64) * 1e-9
        begins = str(first.astype("datetime64[us]")) if values.dtype.kind == "M" and known.size else ""
        return RawColumn("", np.where(np.isnat(values), np.nan, seconds), kind=TIME, begins=begins)
    if values.dtype.kind in "USO":
        from fiohost.importing.cells import column_of

        texts = ["" if v is None or (isinstance(v, float) and np.isnan(v)) else str(v).strip() for v in values.tolist()]
        return replace(column_of("", "", texts, False, range(len(texts))), bad=None)
    return RawColumn("", within_reason(values.astype(np.float64)))


def _missing(values: FloatArray) -> tuple[int, str] | None:
    gone = np.flatnonzero(~np.isfinite(values))
    return (int(gone[0]) + 1, "") if gone.size else None


def _short_names(names: list[str]) -> list[str]:
    """Names without what all of them begin with, such as the structure or group that holds them."""
    parts = [name.split(".") for name in names]
    while len(parts) > 1 and all(len(p) > 1 for p in parts) and len({p[0] for p in parts}) == 1:
        parts = [p[1:] for p in parts]
    if len(parts) == 1:
        parts = [parts[0][-1:]]
    return [".".join(p) for p in parts]


def _absent(path: Path, what: str, library: str) -> str:
    return f"{path} is {what}, which needs {library}: pip install 'fiohost[data]'"


def _short(exc: Exception) -> str:
    return " ".join(str(exc).split())[:200] or type(exc).__name__
