"""The lab's furniture: what stands beside the bench and is not the wire. Here only the seal.

Nothing that judges a log may use this channel.
"""

from __future__ import annotations

from typing import Any


def break_seal(seed: int) -> dict[str, Any]:
    """The truth about the sealed board that *seed* draws: plant, effects, parameters in SI and in reduced form."""
    from firmware_model import reveal

    return dict(reveal(seed))
