"""The benches of a fleet: the folders of a folder, its files, or the rows of a table."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from fiohost.errors import ConfigError, LogError
from fiohost.files import entries, read_input

TABLES = (".csv", ".tsv", ".txt", ".dat", ".mat", ".h5", ".hdf5", ".parquet")
MOST_BYTES = 256_000_000
MOST_TABLE_BYTES = 50_000_000  # of benches
HOLDOUT = "holdout"


@dataclass(frozen=True)
class Bench:
    """One bench: its logs, those that only report, and what a table says of it (serial number, time, type)."""

    name: str
    logs: tuple[Path, ...]
    holdout: tuple[Path, ...] = ()
    said: Mapping[str, str] = field(default_factory=dict)

    def contents(self) -> dict[str, bytes]:
        """The bytes of its files by place in ``logs`` and ``holdout``, for a worker that has not these disks."""
        files = [*self.logs, *self.holdout]
        return {
            f"{i:04d}-{path.name}": read_input(path, MOST_BYTES, "the log", LogError) for i, path in enumerate(files)
        }


def key_of(contents: Mapping[str, bytes], settings: str) -> str:
    """What a result is of: files and settings, the program's among them. Another key, and it is made anew."""
    digest = hashlib.sha256(settings.encode())
    for name, data in contents.items():
        digest.update(name.encode() + b"\0" + hashlib.sha256(data).digest())
    return digest.hexdigest()


def find_benches(folder: Path) -> list[Bench]:
    """Benches of a folder (one folder each; its files where it has none) or of a table's rows. Raises ConfigError."""
    if os.path.isfile(folder):
        return _of_table(folder)
    if not os.path.isdir(folder):
        raise ConfigError(f"there is no folder or table {folder}")
    inside = [p for p in _entries(folder) if p.is_dir() and not p.name.startswith(".")]
    found = [Bench(p.name, _tables(p), _tables(p / HOLDOUT) if (p / HOLDOUT).is_dir() else ()) for p in inside]
    found = [bench for bench in found if bench.logs]
    found = found or [Bench(p.stem, (p,)) for p in _tables(folder)]
    if not found:
        raise ConfigError(f"{folder} holds no bench: one folder of logs each, or one log each")
    return _unique(found)


def _tables(folder: Path) -> tuple[Path, ...]:
    return tuple(p for p in _entries(folder) if p.is_file() and p.suffix.lower() in TABLES)


def _entries(folder: Path) -> list[Path]:
    return entries(folder, "the folder", ConfigError)


def _of_table(path: Path) -> list[Bench]:
    """A table of benches: columns ``bench`` and ``logs`` (several with ; between), ``holdout``, what else is said."""
    try:
        import pandas
    except ImportError:
        raise ConfigError("a table of benches needs pandas: pip install 'fiohost[data]'") from None
    data = io.BytesIO(read_input(path, MOST_TABLE_BYTES, "the table of benches", ConfigError))
    try:
        parquet = path.suffix.lower() == ".parquet"
        table = pandas.read_parquet(data) if parquet else pandas.read_csv(data, dtype=str, keep_default_na=False)
    except (ValueError, OSError) as exc:
        raise ConfigError(f"{path} is no table of benches: {exc}") from exc
    for name in ("bench", "logs"):
        if name not in table.columns:
            raise ConfigError(
                f"{path} has no column {name!r}: a table of benches has bench, logs, and what else is known"
            )
    found = []
    for row in table.to_dict("records"):
        cells = {str(k): "" if v is None else str(v) for k, v in row.items()}
        logs, held = _paths(path, cells.pop("logs")), _paths(path, cells.pop(HOLDOUT, ""))
        found.append(Bench(cells.pop("bench"), logs, held, cells))
        if not logs:
            raise ConfigError(f"{path}: the bench {found[-1].name!r} has no log")
    return _unique(found)


def _paths(table: Path, text: str) -> tuple[Path, ...]:
    return tuple(table.parent / part.strip() for part in text.split(";") if part.strip())


def _unique(benches: Sequence[Bench]) -> list[Bench]:
    names = [b.name for b in benches]
    twice = sorted({n for n in names if names.count(n) > 1}) if len(set(names)) < len(names) else []
    if twice:
        raise ConfigError(f"the bench {twice[0]!r} is there twice: give each bench once")
    return list(benches)
