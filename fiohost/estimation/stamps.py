"""What a log's time stamps and single rows can be believed for: missing ticks, wrong stamps, wrong direction bits."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

DRIVE = 1


@dataclass(frozen=True)
class StampSettings:
    """Numbers by which rows and stamps are believed."""

    # A command that is the same before and after a gap was the same in it, unless the gap is longer than a person's
    # shortest pulse.
    same_across_s: float = 0.1
    # A direction bit that differs in one row from so many before and after it, all alike, contradicts them; controllers
    # that really change for one tick do so again and again. One switch may be so near.
    alike_rows: int = 20
    switches_near: int = 1
    # Stamps that scatter less than this share of a tick are as good as regular.
    regular_share: float = 0.02
    # Stamps are judged where the shaft moves by the smallest step of the readings in a tick or more, in so many rows at
    # least: then their slope is known to a tenth.
    at_speed: float = 1.0
    least_rows: int = 100
    # The slope of readings over how late the stamps say they are is 1 for true stamps, 0 for a regular clock.
    follows: float = 0.5


SETTINGS = StampSettings()


def missing_ticks(times_s: np.ndarray, step_s: float) -> np.ndarray:
    """Ticks that are missing (n - 1) between each row and the next.

    A late stamp is no missing tick, and neither is a clock that is a little fast: both ways of counting must say so.
    """
    ticks = (times_s - times_s[0]) / step_s
    whole = np.minimum(np.rint(np.diff(ticks)), np.diff(np.rint(ticks)))
    return np.asarray(np.maximum(whole, 1.0).astype(np.int64) - 1)


def known_segments(
    times_s: np.ndarray,
    duty_pct: np.ndarray,
    mode: np.ndarray,
    doubtful: tuple[int, ...],
    step_s: float,
    delay_s: float,
    settings: StampSettings = SETTINGS,
) -> np.ndarray:
    """Number (n) of the stretch of known commands that each row is in, -1 where an unknown one acts.

    A command of a tick that is missing, or of a ``doubtful`` row, is unknown until the next row's acts, ``delay_s``
    after it; across a short gap with one command on both sides it is that one.
    """
    missing = missing_ticks(times_s, step_s)
    same = (np.diff(duty_pct) == 0.0) & (np.diff(mode) == 0) & (missing * step_s <= settings.same_across_s)
    gaps = np.flatnonzero((missing > 0) & ~same)
    spans = [(times_s[i] + step_s + delay_s, times_s[i + 1] + delay_s) for i in gaps.tolist()]
    spans += [(times_s[i] + delay_s, times_s[i] + step_s + delay_s) for i in doubtful]
    segments = np.zeros(len(times_s), dtype=np.int64)
    for begin, end in spans:
        # What acts from a sample on shows in the next one.
        first, last = np.searchsorted(times_s, begin + 1e-6 * step_s), np.searchsorted(times_s, end - 1e-6 * step_s)
        segments[last:] += 1
        segments[first:last] = -(10**9)
    return np.where(segments < 0, -1, segments)


def doubtful_modes(
    mode: np.ndarray, duty_pct: np.ndarray, settings: StampSettings = SETTINGS
) -> tuple[np.ndarray, tuple[int, ...]]:
    """The modes (n) with single rows that contradict all around them set as these are, and those rows.

    A row contradicts by a mode that differs while its duty does not, or by a duty that is not to be driven. So it may
    at a switch too, unless most switches have such a row: then the bridge is opened before it is driven. Near an end of
    the log the rows on the other side are enough.
    """
    near = settings.alike_rows
    changes = np.flatnonzero(np.diff(mode) != 0)  # between this row and the next
    within: dict[int, int] = {}
    at_switch: dict[int, int] = {}
    for a, b in zip(changes[:-1].tolist(), changes[1:].tolist(), strict=True):
        around = changes[(changes >= a - near) & (changes <= b + near)]
        if b != a + 1 or len(around) - 2 > settings.switches_near or (a < near and b + near >= len(mode)):
            continue
        idle = mode[b] != DRIVE and duty_pct[b] != 0.0
        driven = [k for k in (b + 1, a) if mode[k] == DRIVE and duty_pct[k] == duty_pct[b]]
        if mode[a] != mode[b + 1]:
            if idle and driven:
                at_switch[b] = driven[0]
        elif np.ptp(duty_pct[a : b + 2]) == 0.0 or idle:  # else a controller that passes zero
            within[b] = a
    if 2 * len(at_switch) > len(changes) - 2 * (len(within) + len(at_switch)):
        at_switch = {}
    found = {**within, **at_switch}
    settled = np.array(mode)
    for row, like in found.items():
        settled[row] = mode[like]
    return settled, tuple(sorted(found))


def true_times(times_s: np.ndarray, angle: np.ndarray, step_s: float, settings: StampSettings = SETTINGS) -> np.ndarray:
    """The times (n) at which an angle (n) was read: the stamps, or whole ticks where these scatter and the readings do
    not follow them. The same array where the stamps hold.
    """
    ticks = (times_s - times_s[0]) / step_s
    # The first stamp is wrong too: where the ticks are, all of them say together.
    phase = float(np.angle(np.mean(np.exp(2j * np.pi * ticks)))) / (2.0 * np.pi)
    places = np.rint(ticks - phase)
    off = ticks - phase - places
    if len(times_s) < settings.least_rows or float(np.std(off)) < settings.regular_share:
        return times_s
    whole, steps = np.diff(places), np.diff(angle)
    if np.any(whole < 1.0):
        return times_s
    pace = np.convolve(np.pad(steps / whole, 3, mode="edge"), np.ones(7) / 7.0, mode="valid")
    sizes = np.abs(steps[steps != 0.0])
    fast = np.abs(pace) > settings.at_speed * (float(sizes.min()) if len(sizes) else np.inf)
    if np.sum(fast) < settings.least_rows:
        return times_s
    late = (np.diff(ticks) - whole) * pace
    follows = float(late[fast] @ (steps - pace * whole)[fast]) / max(float(late[fast] @ late[fast]), 1e-300)
    if follows > settings.follows:
        return times_s
    return np.asarray((places - places[0]) * step_s)
