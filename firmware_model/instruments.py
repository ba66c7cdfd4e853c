"""The lab's furniture beside the board: meters, a hanging mass, a hand on the shaft. None of it crosses the wire."""

from __future__ import annotations

import math

from firmware_model.board import Board
from firmware_model.emulated.board import EmulatedBoard
from firmware_model.errors import FirmwareModelError

GRAVITY_M_S2 = 9.81  # as in the lab appendix, table D-5


class Instruments:
    """Meters and weights clamped to a simulated board; a real bench has none of this in its telemetry.

    Readings are of the moment at which the board's last step ended.
    """

    def __init__(self, board: Board | EmulatedBoard) -> None:
        self._motor = board._motor
        self._hung_Nm = 0.0
        self._hand_Nm = 0.0

    @property
    def current_A(self) -> float:
        """Mean winding current; positive when it drives forward."""
        return self._motor.current_A

    @property
    def voltage_V(self) -> float:
        """Mean voltage across the winding; the back-emf where the bridge is open."""
        return self._motor.voltage_V

    def hang_mass(self, mass_kg: float, drum_radius_m: float) -> None:
        """Hang a mass on a drum: torque m g r, against forward motion (a negative radius: with it). 0 takes it off.

        The mass's own inertia is not added, as in the appendix's torque constant test.
        """
        if not (math.isfinite(mass_kg) and math.isfinite(drum_radius_m)) or mass_kg < 0.0:
            raise FirmwareModelError(
                f"a hanging mass needs mass_kg >= 0 and a finite radius, not {mass_kg}, {drum_radius_m}"
            )
        self._hung_Nm = -mass_kg * GRAVITY_M_S2 * drum_radius_m
        self._motor.set_external_torque(self._hung_Nm + self._hand_Nm)

    def disturb(self, torque_Nm: float) -> None:
        """Press on the shaft with a torque, positive forward, until told otherwise."""
        if not math.isfinite(torque_Nm):
            raise FirmwareModelError(f"a disturbance torque must be finite, not {torque_Nm}")
        self._hand_Nm = torque_Nm
        self._motor.set_external_torque(self._hung_Nm + self._hand_Nm)

    def limit_current(self, limit_A: float | None) -> None:
        """Set the current limit of the bench supply; None takes it off (a limit that the plant has remains)."""
        if limit_A is not None and not (math.isfinite(limit_A) and limit_A >= 1e-3):
            raise FirmwareModelError(f"a current limit must be 0.001 A or more, not {limit_A}")
        self._motor.set_current_limit(limit_A)
