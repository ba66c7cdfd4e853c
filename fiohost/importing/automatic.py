"""Logs of any files: fiohost's own are read as they are, other tables by the map that is found for them."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fiohost.bench.head import OUTPUT_UNITS
from fiohost.bench.log import Log
from fiohost.errors import ConfigError
from fiohost.importing.convert import log_from_raw
from fiohost.importing.found import Answers
from fiohost.importing.raw import RawTable
from fiohost.importing.read import first_bytes, read_raw
from fiohost.importing.understand import understand


def is_log(path: Path) -> bool:
    """Whether a file begins like a log of fiohost (or like nothing, so that its reader says what is wrong). Raises
    LogError.
    """
    head = first_bytes(path, "the log")
    if not head.strip(b"\0 \r\n\t"):
        return True
    text = head.decode("utf-8-sig", errors="replace")
    if "fiohost.log" in text.partition("\n")[0]:
        return True
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("#")]
    names = [name.strip().strip('"') for name in lines[0].split(",")] if lines else []
    outputs = ("pos", *OUTPUT_UNITS)
    return not lines or ("time_s" in names and "duty_pct" in names and any(name in names for name in outputs))


def says_it_is_a_log(path: Path) -> bool:
    """Whether a file names the schema of a log. Raises LogError."""
    return b"fiohost.log" in first_bytes(path).partition(b"\n")[0]


def read_any(sources: Sequence[Path | Log | Any], answers: Answers | None = None) -> list[Log]:
    """Logs of files, of pandas' frames and of logs. Tables are understood together, so that a command has one scale in
    all that have it, and tables of the same columns have one sensor. Raises FiohostError.
    """
    read: list[Log | RawTable] = [_open(source) for source in sources]
    if answers is not None and answers != Answers() and read and all(isinstance(one, Log) for one in read):
        raise ConfigError(f"{read[0].path} is a log of fiohost: it says itself what it is; leave the answers away")
    found: list[Log] = []
    for one in read:
        if isinstance(one, Log):
            found.append(one)
            continue
        others = [other for other in read if isinstance(other, RawTable) and other is not one]
        told = understand(one, answers, others)
        found.append(log_from_raw(one, told.certain, told.sentences))
    return found


def understood(log: Log) -> str:
    """What was found about a table that was read directly; "" of a log."""
    return log.metadata.get("understood", "") if log.metadata.get("source") == log.path.name else ""


def _open(source: Path | Log | Any) -> Log | RawTable:
    if isinstance(source, Log):
        return source
    if isinstance(source, (str, Path)):
        path = Path(source)
        return Log.read(path) if is_log(path) else read_raw(path)
    if hasattr(source, "columns") and hasattr(source, "index"):
        from fiohost.importing.binary import read_frame

        return read_frame(source)
    raise TypeError(f"a log is a file, a pandas DataFrame or a Log, not {type(source).__name__}")
