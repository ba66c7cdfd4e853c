"""What is connected: HID devices and serial ports, each as the target that opens it, and whether this user may."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from fiohost.settings import config_names
from fiohost.transport import hid, serial
from fiohost.transport.access import refusal
from fiohost.transport.hid_modules import Backend, find_backends
from fiohost.transport.profile import TargetProfile

VENDOR_PAGES = hid.VENDOR_PAGES


@dataclass(frozen=True)
class Found:
    """One device. ``target`` opens it; ``profiles`` are those of its identity; ``problem`` keeps this user out."""

    target: str
    medium: str
    identity: str  # VID:PID:SERIAL
    name: str
    node: str
    profiles: tuple[str, ...]
    problem: str | None

    @property
    def is_candidate(self) -> bool:
        """Whether it could be a board: its identity is that of a profile, or it is a serial port."""
        return bool(self.profiles) or self.medium == "serial"

    def to_json(self) -> dict[str, Any]:
        return {**asdict(self), "profiles": list(self.profiles)}


def known_identities(more: Iterable[str] = ()) -> dict[tuple[int, int], tuple[str, ...]]:
    """(vendor, product) -> names of the profiles with it: the shipped ones, and *more* (names or files).

    Raises ConfigError for a profile that cannot be read.
    """
    found: dict[tuple[int, int], tuple[str, ...]] = {}
    for name in [*config_names("targets"), *more]:
        profile = TargetProfile.load(name)
        if profile.vendor_id is not None and profile.product_id is not None:
            key = (profile.vendor_id, profile.product_id)
            found[key] = (*found.get(key, ()), profile.name)
    return found


def find_devices() -> list[Found]:
    """All HID devices and serial ports, those that could be boards first."""
    known = known_identities()
    found = [*_hid_devices(find_backends()[0], known), *_serial_ports(known)]
    return sorted(found, key=lambda one: (not one.is_candidate, one.medium, one.target))


def _hid_devices(backends: Iterable[Backend], known: dict[tuple[int, int], tuple[str, ...]]) -> Iterable[Found]:
    seen: set[str] = set()
    for backend in backends:
        for info in backend.enumerate():
            key = hid.board_key(info)
            if key in seen:  # by the other backend, or with another collection of usages
                continue
            seen.add(key)
            identity = (info["vendor_id"], info["product_id"])
            serial_number, node = info.get("serial_number") or "", hid.node_of(info)
            yield Found(
                target=f"hid:{serial_number if serial_number and identity in known else hid.path_text(info)}",
                medium="hid",
                identity=f"{identity[0]:04x}:{identity[1]:04x}:{serial_number}".rstrip(":"),
                name=" ".join(filter(None, (info.get("manufacturer_string"), info.get("product_string")))),
                node=node,
                profiles=known.get(identity, ()),
                problem=refusal(node, "it") if node else None,
            )


def _serial_ports(known: dict[tuple[int, int], tuple[str, ...]]) -> Iterable[Found]:
    for port in serial.usb_ports():
        yield Found(
            target=f"serial:{port.device}",
            medium="serial",
            identity=f"{port.vid:04x}:{port.pid:04x}:{port.serial_number or ''}".rstrip(":"),
            name=str(port.description or ""),
            node=str(port.device),
            profiles=known.get((port.vid, port.pid), ()),
            problem=refusal(str(port.device), "it"),
        )
