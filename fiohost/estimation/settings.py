"""All numbers by which a model is fitted to logs, each with its reason; printed in every result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class StartSettings:
    """How the beginning of a log is found."""

    # Where a motor may stand in its gap, and how fast a load of its own inertia may drift there, in gaps per second:
    # after a sudden stop it goes on from wall to wall. Then a simplex of these steps takes so many looks.
    plays: tuple[float, ...] = (0.0, -1.0, 1.0, -0.5, 0.5)
    more_plays: tuple[float, ...] = (-0.75, -0.25, 0.25, 0.75)
    drifts: tuple[float, ...] = (-3.0, -1.0, -0.3, 0.3, 1.0, 3.0)
    lash_looks: int = 40
    lash_steps: tuple[float, float] = (0.15, 0.3)
    # Where the motor stood in its gap shows until both have met on either side.
    lash_shows_s: float = 4.0
    # Up to this span of the residual, in counts, the midpoint of its bounds says best where in its count a shaft stood.
    within_counts: float = 1.5
    # Warmth is looked for at so many levels, then as near by windows and as close by whole runs as this; by so much
    # further where what is least lies at an end. Every so many windows are enough to come near.
    warmth_looks: int = 9
    warmth_near: float = 0.02
    warmth_close: float = 1e-4
    warmth_further: float = 4.0
    warmth_every: int = 3
    # A log's own zero: angles looked at for each period, windows looked at, the motion in counts that makes a window
    # worth it. Around the best of them, in degrees of the phase: how far, from near, how close, and the most looks.
    zero_looks: int = 6
    zero_windows: int = 20
    zero_motion_counts: float = 4.0
    zero_reach_deg: float = 45.0
    zero_near_deg: float = 10.0
    zero_close_deg: float = 0.2
    zero_more: int = 16
    # What a shaft was turning with at the end of a record is the slope over so many samples.
    last_samples: int = 10
    # A shaft may stand so far beyond an end of travel, for want of a finer sensor; and an end is not known to better
    # than some degrees where noise tells when the shaft came to it.
    end_slack_counts: float = 3.0
    end_slack_deg: float = 5.0


@dataclass(frozen=True)
class FitSettings:
    """How a model is carried to its minimum."""

    start: StartSettings = StartSettings()
    # So many iterations at most; where a motor stood in its gap is looked for in so many rounds.
    max_iterations: int = 40
    play_rounds: int = 2
    # A log's own zero, in degrees of the phase that it turns, and its warmth: difference, and the longest step of one
    # iteration.
    zero_step_deg: float = 0.1
    zero_step_at_most_deg: float = 30.0
    warmth_step: float = 0.01
    warmth_step_at_most: float = 0.3
    # A step that promises less than this share of what the tolerance asks for is not tried.
    promised: float = 0.1
    # Windows are fitted along their tangent; to a tolerance below this one, with exact derivatives in the end.
    along_tangent: float = 9e-6
    # Where steps left no more than this share of the squared error, windows are begun anew.
    moved_far: float = 0.9
    # So often a step is tried, more damped each time; the longest one of a start shrinks so, by its reach.
    attempts: int = 8
    reach_shrinks: float = 0.3
    # Where a speed moves the output by less than this share of what it does in a shaft that runs on (of its square),
    # the shaft stands: friction takes the speed away at once.
    stands: float = 1e-4
    # Of a run that is looked at in fewer than one of so many windows, nothing is kept between them.
    sparse: int = 4
    # Readings of so many samples are taken together where intervals ask how far what is left goes on; of what the data
    # know less than by this share, they know nothing.
    block_samples: int = 200
    near_singular: float = 1e-9


SETTINGS = FitSettings()
