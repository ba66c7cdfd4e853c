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
from functools import cache
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from fiohost import files
from fiohost.errors import ConfigError

MAX_CONFIG_BYTES = 1_000_000
# Where more of them are: a folder, or several, with a folder for each kind; packages declare theirs in the group.
CONFIGS, CONFIGS_GROUP = "FIOHOST_CONFIGS", "fiohost.configs"
_PACKAGE = Path(__file__).parent


def nearest(name: str, choices: Iterable[str]) -> str:
    """Return `` (did you mean 'x'?)`` for the closest of *choices*, else the whole list, for an error message."""
    known = sorted(choices)
    close = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(known)}"


def counted(number: int, what: str) -> str:
    """``1 tick``, ``2 ticks``."""
    return f"{number} {what}{'' if number == 1 else 's'}"


def config_dirs(kind: str) -> list[Path]:
    """Folders of files of one *kind* (``experiments``, ``targets``, ...): the wheel's, the checkout's, then those of
    other packages and of the user.
    """
    shipped = [d for d in (_PACKAGE / "configs" / kind, _PACKAGE.parent / "configs" / kind) if d.is_dir()]
    return [*shipped, *(d for d in (root / kind for root in own_roots()) if d.is_dir())]


def own_roots() -> list[Path]:
    """Folders that hold a folder for each kind: those named in ``FIOHOST_CONFIGS``, and those of packages that declare
    themselves as entry points of the group ``fiohost.configs``. Raises ConfigError for one that is not there.
    """
    named = [Path(part).expanduser() for part in os.environ.get(CONFIGS, "").split(os.pathsep) if part]
    for folder in named:
        if not folder.is_dir():
            raise ConfigError(f"{CONFIGS} names {files.shown(folder)!r}, which is no folder")
    return [*named, *_package_roots()]


@cache
def _package_roots() -> tuple[Path, ...]:
    found = []
    for point in sorted(entry_points(group=CONFIGS_GROUP), key=lambda p: (p.name, p.value)):
        try:
            found += [Path(place) for place in submodule_places(point.value)]
        except (ImportError, ValueError) as exc:
            said = f"configs {point.name!r} of another package ({point.value}) cannot be found: {exc}"
            raise ConfigError(said) from exc
    return tuple(found)


def submodule_places(package: str) -> list[str]:
    """The folders of a package, without loading it. Raises ImportError where there is none."""
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise ImportError(f"{package} is no package with a folder")
    return list(spec.submodule_search_locations)


def config_names(kind: str) -> list[str]:
    """Names of the files of one kind, without ``.toml``: the shipped ones and the user's own."""
    return sorted({p.stem for d in config_dirs(kind) for p in d.glob("*.toml")})


def find_config(kind: str, name: str | Path) -> Path:
    """Find a file by path, or by name among the shipped ones. Raises ConfigError naming the nearest known name."""
    path = Path(name)
    if path.suffix == ".toml" or len(path.parts) > 1:
        if exists(path):
            return path
        raise ConfigError(f"no file {files.shown(path)!r}; shipped {kind}: {', '.join(config_names(kind))}")
    found = [folder / f"{name}.toml" for folder in config_dirs(kind) if exists(folder / f"{name}.toml")]
    if len(found) > 1 and not found[0].samefile(found[-1]):
        raise ConfigError(
            f"there are two {kind} of the name {files.shown(name)!r}: {files.shown(found[0])} and "
            f"{files.shown(found[-1])}; rename yours"
        )
    if found:
        return found[0]
    if path.suffix and exists(path):
        return path  # the reader says what is wrong with it
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
        return int(self.raw(key, default))  # a float has not all digits of a large one

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
