"""The lab's furniture beside the board: meters, a hanging mass, a hand on the shaft. None of it crosses the wire."""

from __future__ import annotations

from firmware_model.board import Board


class Instruments:
    """Meters and weights clamped to a simulated board; a real bench has none of this in its telemetry."""

    def __init__(self, board: Board) -> None:
        self._board = board
