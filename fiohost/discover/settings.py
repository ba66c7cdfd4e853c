"""All numbers of the search, each with its reason; printed in every result."""

from __future__ import annotations

from dataclasses import dataclass

from fiohost.judging.settings import FLOOR, TORQUE, VERDICT, FloorSettings, TorqueSettings, VerdictSettings


@dataclass(frozen=True)
class ScreenSettings:
    """How effects are scored before they are fitted."""

    # Signatures are compared at this resolution in time: a shaft does not move faster, and arrays stay small.
    resolution_s: float = 0.02
    # Trials are for a motor of the speed that is exceeded in the rest of the samples.
    reached: float = 0.98
    # So many of an effect's trials are refitted.
    best_trials: int = 4
    # Of what swings each trial that scores so close to the best begins too.
    tied: float = 0.9
    # What the sine and the cosine of one frequency gain by chance, as deviance, is exponential of this mean.
    line_chance: float = 2.0
    # A shaft that stands for so long though driven on by more than friction may stand at an end of travel: readings are
    # within so many times their fast noise. So does one that comes with so many counts in two samples, and stands at
    # once for so many samples.
    driven_on_pct: float = 10.0
    near_scatter: float = 2.0
    held_s: float = 0.15
    abrupt_counts: float = 4.0
    stands: int = 5


@dataclass(frozen=True)
class LineSettings:
    """How lines of the clock are found in a spectrum."""

    # Frequencies on either side whose median is the background, and the fewest lines that make a spectrum.
    around: int = 25
    fewest: int = 40
    chance: float = 0.01
    # A frequency beside others says of their background as much as so many that know its mean: those next to it in a
    # tapered spectrum say the same (2 of 3 count), and a median knows less than a mean (1 / 2.08).
    knows: float = 0.32
    # So many lines at most, the strongest first: each is two trials.
    most: int = 3
    # Frequencies by the clock of several records are looked for at so many places at most.
    most_looks: int = 2000
    # Zeros after a series make its spectrum so much finer; within so many widths of a line another one is the same.
    finer: int = 2
    same: float = 1.5
    # A line repeats itself so often at least; a command does where one line has this share of its power.
    periods: float = 3.0
    periodic: float = 0.3


@dataclass(frozen=True)
class OptimiserSettings:
    """How a candidate is carried to its minimum."""

    # Rough fits begin from so many trials, those of least error; in windows those of the highest score.
    starts: int = 3
    window_starts: int = 3
    # Begun anew: from so many trials, on so much of all logs together and of each, with this lag.
    anew_starts: int = 2
    anew_s: float = 60.0
    anew_least_s: float = 4.0
    anew_lag_s: float = 0.1
    # Steps in windows of all that are begun anew, of the best of them, twice as many as are kept, and of these.
    anew_steps: tuple[int, int, int] = (2, 3, 7)
    # Where to look along a parameter in which the error is not smooth, as factors on its value (lowest, highest,
    # looks); a moment is moved by their logarithms times moment_s.
    coarse: tuple[float, float, int] = (0.2, 5.0, 20)
    fine: tuple[float, float, int] = (0.85, 1.18, 16)
    finest: tuple[float, float, int] = (0.98, 1.02, 16)
    moment_s: float = 2.0
    # The fine search goes on from where it came to while it pays by this factor, so often at most.
    searched_again: int = 3
    still_better: float = 0.99
    # Another choice is searched where it comes this close in squared error, from these multiples of the size.
    another_choice: float = 2.0
    choice_sizes: tuple[float, ...] = (1.0, -1.0, 0.5, -0.5, 2.0, -2.0)
    # A tolerance to which windows are fitted along their tangent.
    near_enough: float = 1e-4
    # Squared errors this close cannot tell two values of a threshold; how the ends of such a range are felt for.
    flat: float = 1e-4
    first_step: float = 1e-3
    doublings: int = 10
    halvings: int = 5
    # Polished: so many points within the uncertainty are looked at, the best of them fitted.
    looks: int = 48
    nudges: int = 4
    # What leaves a share less than this is the same fit.
    paid: float = 1e-6
    # How far around each parameter a fit in a local minimum is begun again, as factors on it, and how often at most.
    around: tuple[float, ...] = (0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 0.995, 1.005, 1.01, 1.02, 1.05, 1.1, 1.2, 1.4)
    begun_again: int = 3


@dataclass(frozen=True)
class MomentSettings:
    """How the moment of an event is found from windows."""

    # What changed is linear in its size up to so much.
    small_change: float = 0.02
    # A moment is looked for between the windows on either side, at so many places at a time, ever closer.
    reach_s: float = 1.5
    looks: int = 24
    closer: float = 8.0
    rounds: int = 3
    # So many of the things that may have changed are followed up, with ratios within these.
    likely: int = 2
    least_ratio: float = 0.2
    most_ratio: float = 5.0


@dataclass(frozen=True)
class ScoreSettings:
    """How a fit is judged without a group of its records, and by its own parameters."""

    # Shares of the Newton step that are tried.
    step_shares: tuple[float, ...] = (1.0, 0.5, 0.25)
    # A parameter of which the rest says less than this share of what all say stays about where it was.
    known_anyway: float = 0.02
    # Of a parameter that the others know by no more than this share of what one group does, they know nothing.
    elsewhere: float = 1e-3
    # A size so many standard errors from where the effect vanishes is distinct from it.
    sigmas_from_neutral: float = 3.0
    block_s: float = 2.0


@dataclass(frozen=True)
class WhitenSettings:
    """How windows are whitened by what is left in them."""

    # Noise and model settle on each other in so many rounds at most; they have where the next round would change the
    # noise by less than this share of its interval, or, of several runs, the last one lowered the deviance by less.
    rounds: int = 4
    settled: float = 0.1
    settled_deviance: float = 0.2
    # A speed below this share of the top speed is a digit of rounding.
    stands: float = 1e-6
    # Lags of a speed that settles at once, and of one that hardly does, as where it coasts, in those of the motor.
    lags: tuple[float, float] = (1e-2, 1e3)
    # A shaft stands where a random torque of so many standard deviations does not turn it.
    rest_sigmas: float = 2.0
    # Samples of the whiteness test: enough to know a spread to a fifth; they have a stream of their own.
    draws: int = 16
    seed: int = 2
    # By so much gain, friction and load are changed for a derivative: shares, and percent of duty.
    run_steps: tuple[float, float, float] = (1e-3, 1e-2, 0.05)
    # So near to where a model stops or starts, the shaft may do so otherwise: it is taken for moving there.
    kink_s: float = 0.1


@dataclass(frozen=True)
class SearchSettings:
    """How effects are looked for, believed and told apart."""

    # Null: bootstrap samples, and the 99 % point of the largest of the library, from a Gumbel distribution of their
    # mean and spread. So many know the level to a tenth where few runs differ; 40 give from half to half as much again.
    draws: int = 120
    # So many do where nothing is believed by them, as they say where to look next; and where by them no candidate
    # gains what it has to within a factor of plainly_told.
    draws_of_a_guide: int = 40
    plainly_told: float = 2.0
    gumbel_sigmas: float = 3.137
    # Refitted, an effect's shape goes where chance is best for it: it has to gain so many times what chance reaches in
    # the screen.
    margin: float = 1.5
    # Beside noise, which may be what is missing, so many times, but for the dry friction that every drive has: bearings
    # that warm up look like a gain that warms.
    margin_in_windows: float = 2.25
    # Screen: effects are refitted while their score is this share of the best one's, so many at least and at most.
    worth: float = 0.1
    least_refitted: int = 4
    refitted: int = 10
    refitted_in_windows: int = 5
    # Of these, so many are carried to their minimum, those within this factor of the best in squared error. Whole runs
    # that follow nothing are left to windows but where one takes as much.
    finalists: int = 10
    finalists_in_windows: int = 4
    hopeless: float = 12.0
    # Score: left-out blocks of 2 s speak for an effect, and against a rival, at two standard errors; no block counts
    # for more than five standard deviations of one sample.
    sure_sigmas: float = 2.0
    most_of_a_block: float = 25.0
    # A rival gains this share of what the best does on left-out blocks. Beside one at the floor of whole runs, effects
    # that score this share of it are refitted besides the least number.
    shared_gain: float = 0.8
    # Fits whose squared errors are this close are as good: counts of whole runs err alike and do not average out.
    as_good: float = 1.03
    # Deviances this close are equal: twice what a free parameter gains by chance.
    equal_deviance: float = 2.0
    # Left-out blocks tell a rival apart by so much deviance at least: odds of 20 to 1 (Kass and Raftery 1995).
    strong_deviance: float = 6.0
    # A price, in deviance, on each rank that an effect is rarer than dry friction, a factor of 1.6 in prior odds: of
    # two that data tell apart by less than 7 the commonest wins over the rarest.
    rare: float = 1.0
    # A shaft rests that moves for less than this share of the time, as readings weigh in a fit of whole runs.
    mostly: float = 0.5
    # What leaves so many times the squared error of counts at most may be on a ledge beside one that leaves these, and
    # leaves nothing for a curve over the angle.
    near_counts: float = 4.0
    # A fit is at its floor within this factor; beyond the second one gradients lead nowhere.
    finished: float = 1.1
    lost: float = 12.0
    # A further effect accounts for this share of what whole runs still leave above the floor: small remains have many
    # takers.
    least_of_rest: float = 0.3
    # Of what windows leave beside noise it takes this share at least: what a motor does by less from one minute to the
    # next, as warming, one record cannot tell from noise.
    least_further: float = 0.1
    # Search: so many structures are carried on beside each other, up to so many effects. Whole runs first look for so
    # many, and beside so many the best structure alone is carried on: a third, which windows lead to, takes minutes.
    beam: int = 2
    most_effects: int = 4
    most_before_windows: int = 2
    # A share of the missing torque that follows the angle, the speed or the duty, or a gain or a friction that changes
    # in a run, is no noise. Commands that nobody logged, in 1 % of the rows, look like a tenth.
    follows: float = 0.2
    # Nor is a load that runs have in common beside how they scatter: by this chance a bench that has none looks so.
    shared_load: float = 1e-3
    # Nor is a torque that wanders by more than this share of full duty rms: benches that were measured stay below 2 %.
    most_torque_pct: float = 5.0
    # Nor is one of more than this share of the commands' rms: a linear axis without its friction, driven at a fifth of
    # full duty, left one of half of them.
    most_of_duty: float = 0.2
    # Readings closer than this are thinned where windows are weighed by their noise: our own bench's tick.
    window_step_s: float = 0.005
    # So many windows of all records are searched at most, spread over them: more only take longer. What is found is
    # judged on all.
    most_windows: int = 160
    # So many where they only say what whole runs are to be asked: 22 drawn pairs were told by them as by twice as many.
    windows_of_a_guide: int = 80
    # Windows stand above their floor by no more than this where a fit of whole runs may be in a local minimum; beyond
    # it whole runs are not searched finely along a threshold.
    stuck: float = 2.0
    screen: ScreenSettings = ScreenSettings()
    lines: LineSettings = LineSettings()
    optimiser: OptimiserSettings = OptimiserSettings()
    moments: MomentSettings = MomentSettings()
    score: ScoreSettings = ScoreSettings()
    floor: FloorSettings = FLOOR
    verdict: VerdictSettings = VERDICT
    whitening: WhitenSettings = WhitenSettings()
    missing_torque: TorqueSettings = TORQUE


SETTINGS = SearchSettings()
