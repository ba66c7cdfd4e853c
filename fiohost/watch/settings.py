"""All numbers of the watch, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class WatchSettings:
    """What is normal, how long is looked back, and what an alarm asks for."""

    # Normal drift, as random walks: gain (share), dry friction (share) and load (percent of duty) change by so much
    # (one standard deviation) in a minute. A winding that warms by 20 K in ten minutes loses 0.8 % a minute.
    drift_per_minute: tuple[float, float, float] = (0.01, 0.06, 0.25)
    # How far the motor may stand from its model when the watch begins.
    begins_within: tuple[float, float, float] = (0.10, 0.40, 2.0)
    # It is looked for around the model anew until it moves by no more than this share of that, so often at most: some
    # motors swing about where they stand.
    moves: float = 0.02
    rounds: int = 12
    # Beyond this, what drifted slowly is said too: it is no longer the motor that the model is of.
    drifted: tuple[float, float, float] = (0.25, 1.0, 6.0)
    # Windows looked back (window-limited generalised likelihood ratio, Lai 1998). One alone is never believed.
    lengths: tuple[int, ...] = (2, 3, 4, 6, 8, 12, 16, 24, 32)
    # One false alarm in this time, over all candidates and lengths, and so much for tails that replicas do not show.
    false_alarm_h: float = 24.0
    tail_margin: float = 1000.0
    # Statistics are taken for so much wider (variance) than replicas show them: windows in which the shaft starts and
    # stops have tails that a thousand windows do not show. Without it there is a false alarm an hour.
    tail_widening: float = 1.8
    # Windows of replicas from which the spread of each statistic is taken, drawn on the learned commands.
    replica_windows: int = 900
    # The part of the replicas' statistics that sets their spread: far enough out to see the tail, with some left of it.
    spread_quantile: float = 0.98
    # A window counts for no more than so many times the power that is normal.
    most_power: float = 2.0
    # and moves what is believed of the drift by no more than so many standard deviations.
    most_sigmas: float = 1.5
    # What is believed of the drift before a stretch is taken for so much less sure (variance): windows in which the
    # shaft starts and stops err by more than the noise.
    prior_widening: float = 4.0
    # Seconds that teach what is normal, and the fewest.
    learn_s: float = 30.0
    least_learn_s: float = 8.0
    # Candidates whose share of the belief is below this are not named.
    named_share: float = 0.05
    # An alarm is over when its statistic has been below this share of the threshold for so many windows.
    over_share: float = 0.3
    over_windows: int = 10
    # What a named effect must take, with the drift, of the surplus power before a change counts as named.
    explained_share: float = 0.35
    # After an alarm the name is asked for again for so many windows, as more of the change is seen.
    refine_windows: int = 8
    # Rows before a window from which its commands and its start come: dead times up to this.
    lead_s: float = 0.3
    # At most so many windows are judged at once.
    chunk_windows: int = 60


SETTINGS = WatchSettings()
