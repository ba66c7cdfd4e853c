"""Pictures as files: drawn in memory, then written whole or not at all."""

from __future__ import annotations

import io
from pathlib import Path

from matplotlib.figure import Figure

from fiohost.errors import FiohostError
from fiohost.files import FreeName, Output, shown, write_output

DPI = 130


def save_figure(figure: Figure, path: Output) -> Path:
    """Write a picture; the suffix of its name is its format (png, svg, pdf). Gives the name. Raises FiohostError."""
    name = path.path if isinstance(path, FreeName) else Path(path)
    drawn = io.BytesIO()
    try:
        figure.savefig(drawn, dpi=DPI, format=name.suffix.removeprefix(".") or "png")
    except ValueError as exc:
        raise FiohostError(f"cannot write the plot {shown(name)}: {exc}") from exc
    return write_output(path, drawn.getvalue())
