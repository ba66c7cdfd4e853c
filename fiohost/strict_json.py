"""Results as strict JSON: NaN and infinity become null."""

from __future__ import annotations

import json
import math
from typing import Any


def text(result: Any, *, ascii_only: bool = False) -> str:
    """A result as JSON text that ends with a new line."""
    return json.dumps(plain(result), indent=2, allow_nan=False, ensure_ascii=ascii_only) + "\n"


def plain(value: Any) -> Any:
    """The same value in JSON's own types: arrays become lists, paths text, NaN and infinity null."""
    if value is None or isinstance(value, (bool, int)):
        return value
    if isinstance(value, str):  # a name in an odd locale is bytes in disguise
        return value.encode(errors="surrogateescape").decode(errors="replace")
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {plain(str(k)): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple, set)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):  # numpy, without importing it
        return plain(value.tolist())
    return plain(str(value))
