"""The head of a log: metadata lines, column names, and which columns a row cannot do without."""

from __future__ import annotations

from pathlib import Path

from fiohost.errors import LogError

MAX_METADATA_LINES = 1000
MAX_LINE_CHARS = 20_000

# columns that can be the output, in order of preference, with their units; pos becomes an angle
OUTPUT_UNITS = {"angle_deg": "deg", "speed_deg_s": "deg/s", "position_m": "m", "speed_m_s": "m/s"}


def needed_columns(names: list[str]) -> list[str]:
    """Columns without which a row cannot be used."""
    outputs = [name for name in ("pos", *OUTPUT_UNITS) if name in names]
    return [name for name in ("time_s", "duty_pct", "c3", "c4") if name in names] + outputs[:1]


def read_head(text: str, path: Path) -> tuple[dict[str, str], list[str], int, int]:
    """Metadata, column names, where the rows start in the text, and the line number of the first row."""
    metadata: dict[str, str] = {}
    position = 0
    for number in range(1, MAX_METADATA_LINES + 2):
        end = text.find("\n", position)
        if end < 0:
            raise LogError(f"the log {path} holds no rows: it ends before its column names")
        if end - position > MAX_LINE_CHARS:
            raise LogError(f"{path} is not a log: line {number} is longer than {MAX_LINE_CHARS} characters")
        line = text[position:end].strip()
        position = end + 1
        if line.startswith("#"):
            key, _, value = line.lstrip("# ").partition(":")
            metadata[key.strip()] = value.strip()
        elif line:
            return metadata, [name.strip().strip('"') for name in line.split(",")], position, number + 1
    raise LogError(f"{path} is not a log: {MAX_METADATA_LINES} lines and no column names")


def check_names(names: list[str], path: Path) -> None:
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise LogError(f"{path}: column {twice[0]!r} is there twice")
    hint = "a table of another shape becomes a log by: fiohost import TABLE"
    for name in ("time_s", "duty_pct"):
        if name not in names:
            raise LogError(f"{path} has no column {name!r} (its first: {', '.join(names[:6])[:120]}); {hint}")
    if "pos" not in names and not any(name in names for name in OUTPUT_UNITS):
        raise LogError(f"{path} has no output column: pos, {', '.join(OUTPUT_UNITS)}; {hint}")
