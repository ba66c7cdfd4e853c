"""What a long command is doing: one live line on a terminal, lines with ``-v`` elsewhere."""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager


@contextmanager
def progress() -> Iterator[Callable[[str], None]]:
    """A function that takes one sentence on what is being done now; it goes to standard error."""
    logger = logging.getLogger("fiohost")
    if not sys.stderr.isatty() or logger.isEnabledFor(logging.INFO):
        yield logger.info
        return
    from rich.console import Console

    with Console(stderr=True).status("starting") as status:
        yield lambda text: status.update(text)
