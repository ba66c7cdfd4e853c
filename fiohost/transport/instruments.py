"""The lab's furniture: what stands beside the bench and is not the wire. Meters, a supply, a mass, a hand, the seal.

Only the labs and ``unseal`` use it; nothing that judges a log may. A real bench has such things too, but on the table:
nobody can read them for you.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Protocol

from fiohost.errors import ConfigError
from fiohost.transport.base import Transport
from fiohost.transport.traced import TracedTransport

if TYPE_CHECKING:
    import firmware_model


class HasTransport(Protocol):
    """A bench, as far as this room knows one."""

    transport: Transport


class Instruments:
    """Meters and weights at a simulated board. Made by :meth:`of`.

    Readings are of the moment at which the board's last task step ended.
    """

    def __init__(self, furniture: firmware_model.Instruments) -> None:
        self._furniture = furniture

    @classmethod
    def of(cls, bench: HasTransport) -> Instruments:
        """The instruments of a bench on ``sim`` or ``sim:PLANT``.

        Raises ConfigError for a sealed bench, which may be known by its wire only, and for a real one.
        """
        from fiohost.transport import simulated

        transport = bench.transport
        if isinstance(transport, TracedTransport):
            transport = transport.inner
        board = simulated._boards.get(transport)
        if board is None:
            why = (
                "a sealed bench shows nothing but its wire"
                if "sealed" in transport.name.split(":", 1)[-1]
                else "read the meters on your table; only simulated benches (sim, sim:PLANT) bring their own"
            )
            raise ConfigError(f"{transport.name or 'this target'} has no instruments: {why}")
        from firmware_model import Instruments as Furniture

        return cls(Furniture(board))

    @property
    def current_A(self) -> float:
        """Mean winding current; positive when it drives forward."""
        return self._furniture.current_A

    @property
    def voltage_V(self) -> float:
        """Mean voltage across the winding; the back-emf where the bridge is open."""
        return self._furniture.voltage_V

    def hang_mass(self, mass_kg: float, drum_radius_m: float) -> None:
        """Hang a mass on a drum of that radius, against forward motion (a negative radius: with it); 0 kg takes it off.

        Raises ConfigError for a negative mass or a number that is not finite.
        """
        from firmware_model import FirmwareModelError

        try:
            self._furniture.hang_mass(mass_kg, drum_radius_m)
        except FirmwareModelError as exc:
            raise ConfigError(str(exc)) from exc

    def disturb(self, torque_Nm: float) -> None:
        """Press on the shaft with a torque, positive forward, until told otherwise. Raises ConfigError if infinite."""
        from firmware_model import FirmwareModelError

        try:
            self._furniture.disturb(torque_Nm)
        except FirmwareModelError as exc:
            raise ConfigError(str(exc)) from exc

    def limit_current(self, limit_A: float | None) -> None:
        """Set the bench supply's current limit; None takes it off (a limit that the plant itself has remains).

        Raises ConfigError for a limit below 0.001 A or one that is not finite.
        """
        from firmware_model import FirmwareModelError

        try:
            self._furniture.limit_current(limit_A)
        except FirmwareModelError as exc:
            raise ConfigError(str(exc)) from exc


def break_seal(seed: int, version: int | None = None, *, faulty: bool = False) -> dict[str, Any]:
    """The truth about the sealed board that *seed* draws: plant, effects, parameters in SI and in reduced form.

    *version* is that of the draws, None for the newest; *faulty*: with the faults of the same board as
    ``sim:sealed-faulty``. Raises ConfigError for a version that is not known.
    """
    from firmware_model import FirmwareModelError, reveal

    try:
        truth = dict(reveal(seed) if version is None else reveal(seed, version))
    except FirmwareModelError as exc:
        raise ConfigError(str(exc)) from exc
    if not faulty:
        del truth["faults"]
    return truth
