"""From a target, as people write it, to a bench."""

from __future__ import annotations

import secrets
from collections.abc import Callable

from fiohost.bench.clock import Clock, MonotonicClock
from fiohost.bench.loop import Bench
from fiohost.bench.seal import MAX_SEED, SEALED, draw_seed, store_seed
from fiohost.errors import ConfigError
from fiohost.settings import config_names, nearest
from fiohost.transport.base import Transport
from fiohost.transport.profile import TargetProfile
from fiohost.transport.traced import traced

DEFAULT_TARGET = "sim"


def connect(target: str = DEFAULT_TARGET, *, seed: int | None = None, realtime: bool = False) -> Bench:
    """Open a target and return its bench (a context manager).

    ``sim`` and ``sim:PLANT`` are simulated boards, ``sim:sealed`` one that nobody is told about, drawn by *seed* or,
    without one, by a seed that is kept for ``fiohost unseal``; ``sim:sealed-faulty`` is the same on a line and a clock
    with faults. Simulated boards run in virtual time unless *realtime*. Raises ConfigError for an unknown target or
    plant, TransportError where it cannot be opened.
    """
    if seed is not None and not 0 <= seed <= MAX_SEED:
        raise ConfigError(f"seed {seed} is outside 0..{MAX_SEED}")
    medium, _, rest = target.partition(":")
    run_id = secrets.token_hex(8)
    if medium not in _MEDIA:
        if medium != target or medium not in config_names("targets"):
            known = [*_MEDIA, *config_names("targets")]
            raise ConfigError(f"unknown target {target!r}; {nearest(medium, known)}")
        medium, rest = TargetProfile.load(target).transport, target
    transport = traced(_MEDIA[medium](rest, seed, run_id))
    clock: Clock | None = MonotonicClock() if realtime else None
    return Bench(transport, TargetProfile.load(), clock=clock, run_id=run_id)


def _simulated(rest: str, seed: int | None, run_id: str) -> Transport:
    from fiohost.transport.simulated import plant_board, sealed_board

    if f"sim:{rest}" not in SEALED:
        return plant_board(rest, seed)
    drawn = draw_seed() if seed is None else seed
    store_seed(run_id, drawn)
    return sealed_board(drawn, faulty=f"sim:{rest}" != SEALED[0])


def _absent(rest: str, seed: int | None, run_id: str) -> Transport:
    raise ConfigError(
        "real lines (hid, serial) and replay are not in this version; simulated targets are sim, sim:PLANT, sim:sealed"
    )


_MEDIA: dict[str, Callable[[str, int | None, str], Transport]] = {
    "sim": _simulated,
    "hid": _absent,
    "serial": _absent,
    "replay": _absent,
}
