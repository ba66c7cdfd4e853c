"""Files and values that people write: strict TOML tables, names looked up in ``configs/``, nearest-name hints.

Every reader goes through :class:`Table`, so that an unknown key, a wrong type, NaN or a value out of range is
refused in one sentence that names the file, the key and the nearest valid one.
"""

from __future__ import annotations

import difflib
import errno
import math
import os
import tomllib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from fiohost import files
from fiohost.errors import ConfigError

MAX_CONFIG_BYTES = 1_000_000
_PACKAGE = Path(__file__).parent


def nearest(name: str, choices: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the closest of *choices*, else the whole list, for an error message."""
    known = sorted(choices)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"


def config_dirs(kind: str) -> list[Path]:
    """Folders of shipped files of one *kind* (``experiments``, ``targets``, ...): the wheel's, the checkout's."""
    return [d for d in (_PACKAGE / "configs" / kind, _PACKAGE.parent / "configs" / kind) if d.is_dir()]


def config_names(kind: str) -> list[str]:
    """Names of the shipped files of one kind, without ``.toml``."""
    return sorted({p.stem for d in config_dirs(kind) for p in d.glob("*.toml")})


def find_config(kind: str, name: str | Path) -> Path:
    """Find a file by path, or by name among the shipped ones. Raises ConfigError naming the nearest known name."""
    path = Path(name)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if exists(path):
            return path
        raise ConfigError(f"no file {files.shown(path)!r}; shipped {kind}: {', '.join(config_names(kind))}")
    for folder in config_dirs(kind):
        if exists(folder / f"{name}.toml"):
            return folder / f"{name}.toml"
    raise ConfigError(f"unknown name {files.shown(name)!r} in {kind}; {nearest(str(name), config_names(kind))}")


def exists(path: Path) -> bool:
    """Whether there is something of that name, of whatever kind: the reader says what is wrong with it."""
    try:
        os.lstat(path)
    except OSError as exc:
        return exc.errno not in (errno.ENOENT, errno.ENOTDIR, errno.ENAMETOOLONG)
    except ValueError:  # a zero byte in the name
        return False
    return True


def read_toml(path: Path) -> Table:
    """Parse a TOML file into a strict table. Raises ConfigError."""
    return parse_toml(read_text(path), str(path))


def read_text(path: Path) -> str:
    """The text of a settings file. Raises ConfigError."""
    data = files.read_input(path, MAX_CONFIG_BYTES, "the settings file", ConfigError)
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as exc:
        raise ConfigError(f"{files.shown(path)} is not valid TOML: byte {exc.start} is not UTF-8 text") from exc


def parse_toml(text: str, where: str) -> Table:
    """A strict table of TOML text. Raises ConfigError."""
    if not text.strip():
        raise ConfigError(f"{files.shown(where)} is empty: write its keys, or name another file")
    try:
        return Table(tomllib.loads(text.replace("\r\n", "\n")), where)
    except (ValueError, RecursionError) as exc:  # not TOML, numbers or nesting beyond all measure
        raise ConfigError(f"{files.shown(where)} is not valid TOML: {exc}") from exc


def _is_finite(value: Any) -> bool:
    """Whether *value* is a number (no flag) that a float can hold: TOML knows whole numbers of any length."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


class Table:
    """One TOML table being read: each key is taken once, and :meth:`finish` refuses what is left over."""

    def __init__(self, data: dict[str, Any], where: str) -> None:
        self.data = data
        self.where = where
        self._known: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def fail(self, message: str) -> ConfigError:
        return ConfigError(f"{self.where}: {message}")

    def raw(self, key: str, default: Any = None) -> Any:
        self._known.add(key)
        return self.data.get(key, default)

    def number(
        self, key: str, default: float | None = None, *, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A finite number within [low, high]; required when there is no default."""
        value = self.raw(key, default)
        if value is None:
            raise self.fail(f"key {key!r} is missing")
        if not _is_finite(value):
            shown = "a huge whole number" if isinstance(value, int) and not isinstance(value, bool) else repr(value)
            raise self.fail(f"{key} = {shown[:60]} is not a finite number")
        if not low <= value <= high:
            raise self.fail(f"{key} = {value!r} is outside {low:g}..{high:g}")
        return float(value)

    def integer(self, key: str, default: int | None = None, *, low: int, high: int) -> int:
        value = self.number(key, default, low=low, high=high)
        if value != int(value):
            raise self.fail(f"{key} = {value!r} is not a whole number")
        return int(value)

    def text(self, key: str, default: str | None = None, *, choices: Sequence[str] | None = None) -> str:
        value = self.raw(key, default)
        if value is None:
            raise self.fail(f"key {key!r} is missing")
        if not isinstance(value, str):
            raise self.fail(f"{key} = {value!r} is not text")
        if choices is not None and value not in choices:
            raise self.fail(f"{key} = {value!r} is unknown; {nearest(value, choices)}")
        return value

    def flag(self, key: str, default: bool = False) -> bool:
        value = self.raw(key, default)
        if not isinstance(value, bool):
            raise self.fail(f"{key} = {value!r} is not true or false")
        return value

    def numbers(self, key: str, default: Sequence[float] | None = None, *, most: int = 10_000) -> list[float]:
        value = self.raw(key, default)
        if value is None:
            raise self.fail(f"key {key!r} is missing")
        good = isinstance(value, (list, tuple)) and all(_is_finite(v) for v in value)
        if not good or not 0 < len(value) <= most:
            raise self.fail(f"{key} is not a list of 1 to {most} finite numbers")
        return [float(v) for v in value]

    def table(self, key: str, *, required: bool = False) -> Table:
        value = self.raw(key)
        if value is None and not required:
            value = {}
        if not isinstance(value, dict):
            raise self.fail(f"table [{key}] is missing" if value is None else f"{key} is not a table")
        return Table(value, f"{self.where} [{key}]")

    def tables(self, key: str) -> list[Table]:
        value = self.raw(key, [])
        if not isinstance(value, list) or not all(isinstance(v, dict) for v in value):
            raise self.fail(f"{key} is not a list of tables [[{key}]]")
        return [Table(v, f"{self.where} [[{key}]] {i + 1}") for i, v in enumerate(value)]

    def schema(self, expected: str) -> None:
        found = self.text("schema", expected)
        if found != expected:
            raise self.fail(f"schema is {found!r}, expected {expected!r}")

    def finish(self) -> None:
        """Refuse every key that nobody asked for."""
        for key in self.data:
            if key not in self._known:
                raise self.fail(f"unknown key {key!r}; {nearest(key, self._known)}")
