"""The elevator's constants from its parts (sections D-2-1 and D-2-2): inertia, the weight's torque, friction."""

from __future__ import annotations

from dataclasses import dataclass

from fiohost.labs.constants import TEXT
from fiohost.labs.elevator.car import DRUM_CM
from fiohost.labs.result import Cell, Table

GRAVITY_M_S2 = 9.81  # Eq. D-34
CAR_KG = 0.124
# The text's lines: current on torque (section D-2-2) and speed on torque (Eq. D-12), both without a car
A_PER_NM, NO_LOAD_A = 3.832, 0.046174
RAD_S_PER_NM, NO_LOAD_RAD_S = -63.63, 7.636
TEXTS_LOAD_NM = 0.017  # as the text rounds it, and goes on with


@dataclass(frozen=True)
class Parts:
    """What hangs on the motor: the car's mass, the drum's radius, and the motor's own inertia and torque constant."""

    car_kg: float = CAR_KG
    drum_m: float = 0.01 * DRUM_CM
    motor_kgm2: float = TEXT["no_load"].J_kgm2
    Ki: float = TEXT["no_load"].Kt_Nm_per_A

    @property
    def J_total_kgm2(self) -> float:
        """Eq. D-33."""
        return self.car_kg * self.drum_m**2 + self.motor_kgm2

    @property
    def load_Nm(self) -> float:
        """Eq. D-34."""
        return self.car_kg * GRAVITY_M_S2 * self.drum_m

    def current_A(self, load_Nm: float) -> float:
        """What lifts a load: the text's line through table D-5."""
        return A_PER_NM * load_Nm + NO_LOAD_A

    def speed_rad_s(self, load_Nm: float) -> float:
        """At which speed: Eq. D-12, with the torque that this current makes."""
        return RAD_S_PER_NM * self.Ki * self.current_A(load_Nm) + NO_LOAD_RAD_S

    def B_Nms(self, load_Nm: float) -> float:
        """Eq. D-10."""
        speed = self.speed_rad_s(load_Nm)
        return self.Ki / speed * self.current_A(load_Nm) - load_Nm / speed


def parts_table(parts: Parts = Parts()) -> Table:
    """Each constant by its equation, beside what the text goes on with (table D-11)."""
    load = TEXTS_LOAD_NM if parts == Parts() else parts.load_Nm
    rows: list[list[Cell]] = [
        ["weight's torque (N m)", "D-34", parts.load_Nm, TEXTS_LOAD_NM],
        ["total inertia (kg m2)", "D-33, D-35", parts.J_total_kgm2, TEXT["elevator"].J_kgm2],
        ["current that lifts it (A)", "line of D-14", parts.current_A(load), 0.1113],
        ["speed at it (rad/s)", "D-12", parts.speed_rad_s(load), 5.8655],
        ["viscous friction (N m s)", "D-10", parts.B_Nms(load), TEXT["elevator"].B_Nms],
    ]
    return Table(f"The elevator from its parts: {1e3 * parts.car_kg:g} g on a drum of {100.0 * parts.drum_m:g} cm",
                 ("constant", "Eq.", "computed", "text"), rows, (0, 1, 3))  # fmt: skip
