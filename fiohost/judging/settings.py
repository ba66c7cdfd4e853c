"""All numbers by which models are judged, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FloorSettings:
    """How the floor is drawn."""

    # Bootstrap samples: few where the fit stands far above them, some where it stands no higher than half-way between
    # their mean and their limit, and up to so many more, a round at a time, where a figure stands just above the
    # highest: a tail is not known from so few.
    replicas: int = 32
    few: int = 4
    some: int = 12
    more_replicas: int = 160
    # The angle within its count is known to between so much and so much at best; a free run this far beyond one count
    # says nothing.
    least_room_counts: tuple[float, float] = (0.002, 0.05)
    lost_counts: float = 0.5
    # Windows whose residual spans so many counts are wide: no angle fits all their samples.
    wide: float = 1.15
    # What moves the readings by less than this share of what is left, all the way from bound to bound, is not seen.
    seen: float = 1e-4
    # Where a torque acts replicas are fitted to their minimum, in so many steps at most and to this tolerance: 0.1 of a
    # deviance of 10,000 samples.
    refit: tuple[int, float] = (8, 1e-5)
    # Shares of the step of a fit to a replica that are tried, until one pays.
    step_shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    # A fitted start that leaves less than this share of the squared error is another one, not the same a little better:
    # play and drift in a gap that the first second does not show.
    another_start: float = 0.25


@dataclass(frozen=True)
class Rule:
    """How far a figure may stand above its bootstrap samples: a factor on them and a margin in the figure's own unit.

    A model that is right but for the last digits of its parameters stays within these. Free runs are taken as a fit
    weighs them: at rest they hang on last digits, which windows do not. ``counts`` and ``points`` (of percent) are how
    much more nobody would call missing: no two simulators, and no bench twice, agree to a third of a count.
    """

    figure: str
    factor: float
    margin: float
    by_scatter: bool
    counts: float = 0.0
    points: float = 0.0


@dataclass(frozen=True)
class VerdictSettings:
    """When a residual is at its floor."""

    rules: tuple[Rule, ...] = (
        Rule("free_run_rms", 1.25, 0.0, True, counts=0.35),
        Rule("window_rms", 1.03, 0.0, True, counts=0.1),
        Rule("bin_violation_pct", 2.0, 6.0, False, points=24.0),
        Rule("wide_windows_pct", 1.0, 3.0, False, points=7.0),
    )
    # A limit is so many standard deviations above the mean of the samples.
    sigmas: float = 4.0
    # Within this factor of its limit a figure may be there by the error of estimation.
    near: float = 4.0


@dataclass(frozen=True)
class TorqueSettings:
    """How the missing torque is held against what it may follow."""

    # Circular shifts in time that say what chance reaches, and bins of each variable.
    shifts: int = 200
    bins: int = 16
    # Where no noise is known the torque wanders by so much of full duty in a second: nothing above counts is hidden.
    walk_pct: float = 20.0
    # A gain or a friction that changes in a run is looked for in stretches of so long: several correlation times of any
    # noise, and no more than what warms takes.
    stretch_s: float = 10.0
    # What swings by the clock goes through so many periods in the longest record, and is no faster than this.
    periods: int = 3
    fastest_hz: float = 10.0


FLOOR, VERDICT, TORQUE = FloorSettings(), VerdictSettings(), TorqueSettings()
