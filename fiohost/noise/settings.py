"""All numbers of the noise layer, each with its reason."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class NoiseSettings:
    """Grids and limits of the noise estimation."""

    # Pieces of steady motion are cut to these lengths, so that few covariances serve all of them; in shorter ones the
    # free angle and speed leave nothing of a torque.
    lengths_s: tuple[float, ...] = (0.1, 0.2, 0.4, 0.7, 1.0)
    shortest_samples: int = 8
    # Pieces in which speeds settle with lags this close, in logarithms, are taken for one; so many lags at most, those
    # of most samples: each takes covariances of its own.
    lags_apart: float = 0.5
    most_lags: int = 3
    # Below this speed in counts a sample the counts' error is a sawtooth and not white (Widrow and Kollar 2008, 19).
    slowest_counts: float = 0.5
    # Below this share of the top speed a torque of some percent may turn the shaft, and dry friction with it.
    slowest_share: float = 0.15
    # A piece that leaves so many times what half of those of its length do, rms, is no noise: of a torque that is
    # constant within pieces, one in a thousand does.
    most_of_usual: float = 5.0
    # From a torque that is white at the sample time to one that is constant within a window.
    times_s: tuple[float, float] = (0.01, 3.0)
    time_looks: int = 7
    # Sensor noise as a share of what is left, from next to nothing to all of it.
    sensor_span: tuple[float, float] = (0.03, 1.5)
    sensor_looks: int = 9
    # Torque in percent of duty: below, no bench can tell it; above, nothing would run.
    torque_span_pct: tuple[float, float] = (1e-3, 30.0)
    torque_looks: int = 16
    # The grid is drawn anew, closer, around what is within so much of the least deviance: more than any interval asks.
    sensor_zooms: int = 2
    zooms: int = 3
    near_deviance: float = 9.0
    # What is left, from which sensor noise is looked for, is taken to so much of itself, in logarithms.
    noise_step: float = 0.25
    # A lag is taken to so much of itself: the shape of covariances does not hang on less.
    lag_step: float = 0.05
    # 95 % intervals by profile likelihood (Wilks 1938): 3.84 where pieces are independent. Those that follow each other
    # share the torque, and counts are not normal: at 3.84 intervals held the truth 260 times of 288 on drawn sets.
    interval_deviance: float = 5.4
    # Scatter over runs is looked for in so many runs at least, on grids of gain and friction (shares) and load (percent
    # of duty), on every so many of them together, then one after the other: friction that scattered by more than half
    # of itself would be none in one run of fifty. It is believed at the 99 % point of chi-squared for one parameter.
    least_runs: int = 3
    run_spans: tuple[tuple[float, float], ...] = ((1e-4, 0.2), (1e-3, 0.5), (0.01, 10.0))
    run_looks: int = 40
    run_coarse: int = 4
    run_sweeps: int = 3
    run_deviance: float = 6.63
    # How many times louder a sensor is in one run than in all of them is looked for in this span; it is believed at the
    # 99.9 % point of chi-squared.
    louder_span: tuple[float, float] = (0.25, 4.0)
    louder_looks: int = 25
    louder_chance: float = 1e-3
    # So many draws of what the noise may be: bootstrap samples take theirs from them.
    likely: int = 64
    # A window's start goes by readings that a random torque has not moved far yet, one of no more than this: while much
    # is missing it holds that too, and a start that follows a few readings turns where the shaft does not.
    most_at_start_pct: float = 1.0
    # Lags of the whiteness test: a tenth of a window at 200 Hz.
    lags: int = 20
    # A window's autocorrelation, and what it adds to chance's gain, count for so many standard deviations at most.
    most_of_a_window: float = 3.0
    # One-sided 1 % point of the normal distribution.
    white_sigmas: float = 2.326
    # A step of the readings is one where 99 % of their differences are multiples of it to this share of it (by chance a
    # fifth would be so near), over so many differences.
    on_step: float = 0.1
    least_steps: int = 8
    # An average that forgets shows by a ratio of one change to the next that so many have; so many are tried.
    least_ratios: int = 40
    likely_ratios: int = 4


SETTINGS = NoiseSettings()
