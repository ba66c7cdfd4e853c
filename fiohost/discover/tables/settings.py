"""All numbers by which tables of readings are fitted and compared, each with its reason; printed in every result."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class TableSettings:
    """How tables of readings are fitted and compared."""

    # Figures jump where a response enters another band: differences are taken so many times wider than for the samples
    # of a log; those of a constant are of this size.
    wider: float = 100.0
    constant_step: float = 1e-4
    # Evaluations of a fit to the end, from a neighbour and to a replica.
    evaluations: int = 40
    nearby: int = 6
    of_a_replica: int = 6
    # A simplex takes so many looks; it begins so many times as wide as the error is worth, at most this share of a
    # value.
    looks: int = 120
    reach: float = 0.5
    most_reach: float = 0.2
    # A figure that is not finite is so many floors off.
    far_off: float = 1e9
    # Figures that change by less, in floors, do not see a parameter; an effect that moves none of them by so much
    # leaves no trace.
    seen: float = 1e-6
    trace: float = 1e-3
    # Sizes of a candidate are tried at so many points about its trials, by up to this much in logarithms; the best so
    # many go on. Of its trials a fit takes so many evaluations with the sizes held, and so many with all free.
    points: int = 24
    spread: float = 0.5
    best: int = 2
    held: int = 3
    all_free: int = 8
    # A figure that is off by more floors than this jumps, and is left out once on the way down.
    jump: float = 10.0
    # A declared model begins from a grid: gains (lowest, highest, how many), lags, and its other sizes in multiples of
    # what the library has. So many of the closest are fitted, until one leaves so many squared floors a figure.
    gains: tuple[float, float, int] = (0.5, 500.0, 13)
    lags_s: tuple[float, ...] = (0.02, 0.05, 0.1, 0.2, 0.5)
    others: tuple[float, ...] = (0.4, 1.0, 2.5)
    starts: int = 4
    enough: float = 2.0
    # Candidates that come so many times farther from the data than the best, squared, are not fitted to the end; or not
    # compared by left-out rows.
    far: float = 12.0
    hopeless: float = 4.0
    # Left-out squared errors this close to the floor are as good as it gets.
    at_floor: float = 1.1
    # A figure so many floors off on the whole is part of what remains.
    stands_out: float = 2.0
    # A steady point is simulated in steps of this length, in which the kernel never runs out of events; of a lag within
    # this share of the time that a bench waits, it has settled, or it is no steady point.
    step_s: float = 0.05
    lags: float = 25.0


SETTINGS = TableSettings()
