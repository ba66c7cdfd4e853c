"""All numbers of the search, each with its reason; printed in every result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How effects are looked for, believed and told apart."""

    # Null: bootstrap samples, and the 99 % point of the largest of many, from a Gumbel distribution of their mean and
    # spread, for which so many are enough.
    draws: int = 40
    gumbel_sigmas: float = 3.137
    # Refitted, an effect's shape goes where chance is best for it: it has to gain so many times what chance reaches in
    # the screen.
    margin: float = 1.5
    # Screen: effects are refitted while their score is this share of the best one's, so many at least and at most.
    worth: float = 0.1
    least_refitted: int = 4
    refitted: int = 10
    refitted_in_windows: int = 5
    # Of these, so many are carried to their minimum, those within this factor of the best in squared error.
    finalists: int = 10
    finalists_in_windows: int = 4
    hopeless: float = 12.0
    # Score: left-out blocks of 2 s speak for an effect, and against a rival, at two standard errors; no block counts
    # for more than five standard deviations of one sample.
    sure_sigmas: float = 2.0
    most_of_a_block: float = 25.0
    # A rival gains this share of what the best does on left-out blocks.
    shared_gain: float = 0.8
    # Fits whose squared errors are this close are as good: counts of whole runs err alike and do not average out.
    as_good: float = 1.03
    # Deviances this close are equal: twice what a free parameter gains by chance.
    equal_deviance: float = 2.0
    # A fit is at its floor within this factor; beyond the second one gradients lead nowhere.
    finished: float = 1.1
    lost: float = 12.0
    # A further effect accounts for this share of what whole runs still leave above the floor: small remains have many
    # takers.
    least_of_rest: float = 0.3
    # Search: so many structures are carried on beside each other, up to so many effects.
    beam: int = 2
    most_effects: int = 4
    # A share of the missing torque that follows the angle, the speed or the duty is no noise.
    follows: float = 0.1
    # Nor is a torque that wanders by more than this share of full duty rms: benches that were measured stay below 2 %.
    most_torque_pct: float = 5.0
    # Readings closer than this are thinned where windows are weighed by their noise: our own bench's tick.
    window_step_s: float = 0.005
    # Windows stand above their floor by no more than this where a fit of whole runs may be in a local minimum.
    stuck: float = 2.0


SETTINGS = SearchSettings()
