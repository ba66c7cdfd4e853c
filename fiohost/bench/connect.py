"""From a target, as people write it, to a bench."""

from __future__ import annotations

import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path

from fiohost import __version__
from fiohost.bench.clock import Clock, MonotonicClock, PlayedClock, VirtualClock
from fiohost.bench.loop import Bench
from fiohost.bench.seal import MAX_SEED, SEALED, STUDENT, draw_seed, store_seed, student_seed
from fiohost.errors import ConfigError
from fiohost.settings import config_names, nearest
from fiohost.transport.base import Transport
from fiohost.transport.profile import DEFAULT_PROFILE, TargetProfile
from fiohost.transport.replay import ReplayTransport
from fiohost.transport.trace import TraceWriter
from fiohost.transport.traced import TracedTransport, is_debugged

DEFAULT_TARGET = "sim"
# medium -> the profile of a target that names none
PROFILES = {"sim": DEFAULT_PROFILE, "hid": DEFAULT_PROFILE, "serial": "serial-documented"}


@dataclass(frozen=True)
class Asked:
    """What every bench of a command shall have: a trace of its traffic, limits beside those of its profile."""

    trace: TraceWriter | None = None
    limits: Mapping[str, float] = field(default_factory=dict)
    guards: Mapping[str, float] = field(default_factory=dict)
    reconnect_s: float = 0.0


_asked: ContextVar[Asked] = ContextVar("asked", default=Asked())  # noqa: B039 (frozen, and nobody writes to it)


@contextmanager
def asking(
    *,
    trace: str | Path | None = None,
    limits: Mapping[str, float] | None = None,
    guards: Mapping[str, float] | None = None,
    reconnect_s: float = 0.0,
) -> Iterator[None]:
    """Whatever is connected within has a trace written to that file, these limits and guards, and waits so long for a
    board that went away; see :func:`connect`.
    """
    before = _asked.get()
    writer = TraceWriter(trace) if trace is not None else None
    merged = {**before.limits}
    for name, value in (limits or {}).items():
        merged[name] = min(value, merged.get(name, value))  # none is made wider
    changed = {**before.guards, **(guards or {})}
    token = _asked.set(Asked(writer or before.trace, merged, changed, reconnect_s or before.reconnect_s))
    try:
        yield
    finally:
        _asked.reset(token)
        if writer is not None:
            writer.close()


def connect(
    target: str = DEFAULT_TARGET,
    *,
    seed: int | None = None,
    realtime: bool = False,
    limits: Mapping[str, float] | None = None,
    guards: Mapping[str, float] | None = None,
    reconnect_s: float = 0.0,
) -> Bench:
    """Open a target and return its bench (a context manager).

    ``sim`` and ``sim:PLANT`` are simulated boards, ``sim:sealed`` one that nobody is told about, drawn by *seed* or,
    without one, by a seed that is kept for ``fiohost unseal``; ``sim:student:ID`` is one of a student's own;
    ``sim:sealed-faulty`` is the same on a line and a clock
    with faults. ``emulated:BOARD[:PLANT]`` is the firmware's machine code in an emulator, in lock step with a plant.
    ``hid``, ``hid:SERIAL_OR_PATH`` and ``serial:PORT`` are boards, ``replay:FILE`` a recorded trace. NAME is a profile,
    shipped or a ``.toml`` file, and NAME:REST the same with what follows its medium: a plant, a port, a serial number.
    Simulated boards run in virtual time unless *realtime*. *limits* (keys of a profile's ``[limits]``) can only be
    stricter than the profile's and those of :func:`asking`, *guards* (keys of its ``[guards]``) take the place of its
    own. A board that goes away in a run is waited for, *reconnect_s*, and braked first of all when it is back; the run
    has ended. Raises ConfigError for an unknown target or plant, TransportError where it cannot be opened.
    """
    if seed is not None and not 0 <= seed <= MAX_SEED:
        raise ConfigError(f"seed {seed} is outside 0..{MAX_SEED}")
    run_id = secrets.token_hex(8)
    transport, profile = open_target(target, seed=seed, run_id=run_id, realtime=realtime)
    asked = _asked.get()
    profile = replace(
        profile,
        limits=profile.limits.within(asked.limits).within(limits or {}),
        guards=profile.guards.changed({**asked.guards, **(guards or {})}),
    )
    clock: Clock = MonotonicClock()
    if transport.lock_step and not realtime:
        clock = VirtualClock()
    elif isinstance(transport, ReplayTransport) and not realtime:
        replay = transport
        clock = PlayedClock(lambda: replay.time_s)
    line = watched(transport, profile, clock)
    return Bench(line, profile, clock=clock, run_id=run_id, reconnect_s=reconnect_s or asked.reconnect_s)


def open_target(
    target: str, *, seed: int | None = None, run_id: str = "", realtime: bool = False
) -> tuple[Transport, TargetProfile]:
    """The line to a target, not yet open, and the profile of its board. Raises ConfigError."""
    medium, rest, name = split_target(target)
    if medium == "replay":
        replay = ReplayTransport(rest, paced=realtime)
        return replay, replay.profile
    profile = TargetProfile.load(name)
    return _MEDIA[medium](rest, profile, seed, run_id), profile


def split_target(target: str) -> tuple[str, str, str]:
    """Medium, what follows it, and the profile's name of a target as people write it. Raises ConfigError."""
    medium, _, rest = target.partition(":")
    if medium == "emulated":
        from fiohost.transport.emulated import split_emulated

        return medium, rest, split_emulated(rest)[0].partition("-")[0]
    if medium in _MEDIA:
        return medium, rest, PROFILES[medium]
    if medium == "replay":
        if not rest:
            raise ConfigError("replay needs the file of a trace: replay:FILE")
        return medium, rest, ""
    name = medium
    if name not in config_names("targets"):
        if ".toml" not in target:
            known = [*_MEDIA, "replay", *config_names("targets")]
            raise ConfigError(f"unknown target {target!r}; {nearest(medium, known)}")
        name, _, rest = target.partition(".toml")  # a path may have colons of its own
        name, rest = name + ".toml", rest.removeprefix(":")
    return TargetProfile.load(name).transport, rest, name


def watched(transport: Transport, profile: TargetProfile, clock: Clock) -> Transport:
    """*transport*, traced where a trace or hex traffic was asked for."""
    trace = _asked.get().trace
    if trace is None:
        return TracedTransport(transport) if is_debugged() else transport
    head = {
        "profile": profile.name,
        "profile_toml": profile.text,
        "sample_time_s": profile.sample_time_s,
        "host_version": __version__,
        "start_time": datetime.now().astimezone().isoformat(timespec="seconds"),
    }
    return TracedTransport(transport, trace, clock.now_s, head)


def _simulated(rest: str, profile: TargetProfile, seed: int | None, run_id: str) -> Transport:
    from fiohost.transport.simulated import plant_board, sealed_board

    if f"sim:{rest}".startswith(STUDENT):  # its seed is kept nowhere: a teacher draws it anew
        if seed is not None:
            raise ConfigError("a student's board is drawn by the student's name: leave the seed away")
        own = student_seed(f"sim:{rest}".removeprefix(STUDENT))
        return sealed_board(own, faulty=False, layout=profile.board_layout, duty_steps=profile.duty_steps)
    if f"sim:{rest}" not in SEALED:
        return plant_board(rest, seed, layout=profile.board_layout, duty_steps=profile.duty_steps)
    drawn = draw_seed() if seed is None else seed
    store_seed(run_id, drawn)
    faulty = f"sim:{rest}" != SEALED[0]
    return sealed_board(drawn, faulty=faulty, layout=profile.board_layout, duty_steps=profile.duty_steps)


def _serial(rest: str, profile: TargetProfile, seed: int | None, run_id: str) -> Transport:
    from fiohost.transport.serial import SerialTransport

    identity = "" if profile.vendor_id is None else f"{profile.vendor_id:04x}:{profile.product_id or 0:04x}"
    return SerialTransport(rest or identity, profile.baud)


def _hid(rest: str, profile: TargetProfile, seed: int | None, run_id: str) -> Transport:
    from fiohost.transport.hid import HidTransport

    numbered = profile.codec.telemetry_layout.report_id is not None
    return HidTransport(rest, profile.vendor_id, profile.product_id, numbered=numbered)


def _emulated(rest: str, profile: TargetProfile, seed: int | None, run_id: str) -> Transport:
    from fiohost.transport.emulated import SEALED_PLANT, emulated_board, split_emulated

    if split_emulated(rest)[1] == SEALED_PLANT:
        seed = draw_seed() if seed is None else seed
        store_seed(run_id, seed)
    return emulated_board(rest, seed)


# what follows the medium in the target, profile, seed, run id
_MEDIA: dict[str, Callable[[str, TargetProfile, int | None, str], Transport]] = {
    "sim": _simulated,
    "hid": _hid,
    "serial": _serial,
    "emulated": _emulated,
}
