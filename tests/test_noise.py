"""The noise layer on drawn sets: what it estimates holds the truth, what it whitens is white."""

from __future__ import annotations

import numpy as np
import pytest

from fiohost.noise import covariance
from fiohost.noise.draw import draw_sensor, draw_torque
from fiohost.noise.estimate import Noise, Ranged, estimate
from fiohost.noise.likelihood import Group, Motor, deviances, pieces
from fiohost.noise.quantum import found_quantum
from fiohost.noise.whiten import Whitener, is_white, unevenness

STEP_S, WINDOW, WINDOWS = 0.005, 200, 50


def drawn(
    rng: np.random.Generator, motor: Motor, sensor: float, torque_pct: float, torque_s: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a true model leaves of noisy readings (n), its speed (n), and the windows' edges."""
    window, step_s = round(1.0 / motor.step_s), motor.step_s
    n = window * WINDOWS
    times, moving = np.arange(n) * step_s, covariance.Movement.steady(window, motor.tau_s)
    acts = covariance.response(times[:window], moving, motor.gain, motor.tau_s, motor.kind)
    known = Noise(Ranged(0.0, 0.0, 0.0), Ranged(torque_pct, 0.0, 0.0), Ranged(torque_s, 0.0, 0.0))
    torque = draw_torque(times, known, rng).reshape(WINDOWS, window)
    speed = np.repeat(rng.uniform(150.0, 700.0, WINDOWS), window)
    if motor.kind == covariance.ANGLE:
        true = np.cumsum(speed) * step_s
        read = true + (torque @ acts.T).ravel() + sensor * rng.standard_normal(n)
        read = np.floor(read / motor.quantum) * motor.quantum if motor.quantum else read
    elif motor.kind == covariance.SPEED:
        true = speed
        read = speed + (torque @ acts.T).ravel() + sensor * rng.standard_normal(n)
    else:
        true, count = speed, motor.quantum * step_s
        angle = np.floor((np.cumsum(speed) * step_s) / count) * count
        read = np.diff(angle, prepend=0.0) / step_s + (torque @ acts.T).ravel() + sensor * rng.standard_normal(n)
    return read - true, speed, np.full(n, motor.tau_s), np.arange(0, n + 1, window)


def drawn_motor(rng: np.random.Generator, kind: int, quantum: float) -> Motor:
    step_s = 4.0 * STEP_S if kind == covariance.MEAN_SPEED else STEP_S
    return Motor(rng.uniform(6.0, 16.0), rng.uniform(0.04, 0.15), kind, quantum, step_s)


CASES = [
    (covariance.ANGLE, 0.5, 0.0, 0.0),
    (covariance.ANGLE, 0.5, 0.5, 0.0),
    (covariance.ANGLE, 0.5, 1.5, 0.0),
    (covariance.ANGLE, 0.5, 0.0, 0.5),
    (covariance.ANGLE, 0.5, 0.0, 1.0),
    (covariance.ANGLE, 0.5, 0.3, 0.7),
    (covariance.ANGLE, 0.0, 0.2, 0.4),
    (covariance.SPEED, 0.0, 3.0, 1.0),
    (covariance.MEAN_SPEED, 6.0, 2.0, 1.0),
]


@pytest.mark.long
def test_intervals_of_the_noise_hold_the_truth_on_nine_sets_of_ten() -> None:
    rng = np.random.default_rng(20261122)
    hits, total = dict.fromkeys(("sensor", "torque", "time"), 0), dict.fromkeys(("sensor", "torque", "time"), 0)
    inside: list[float] = []
    for kind, quantum, sensor, torque_pct in CASES * 5:
        torque_s = float(rng.choice((0.1, 0.5)))
        motor = drawn_motor(rng, kind, quantum)
        found = estimate(pieces(*drawn(rng, motor, sensor, torque_pct, torque_s), motor))
        told = {"sensor": (found.sensor, sensor), "torque": (found.torque_pct, torque_pct)}
        told |= {"time": (found.torque_s, torque_s)} if torque_pct else {}
        assert found.likely is not None
        for ranged, draws in zip((found.sensor, found.torque_pct, found.torque_s), found.likely.T, strict=True):
            inside.append(float(np.mean((draws >= 0.99 * ranged.low) & (draws <= 1.01 * ranged.high))))
        for name, (ranged, truth) in told.items():
            total[name] += 1
            hits[name] += ranged.low <= truth + 1e-12 and truth <= ranged.high
    print({name: f"{hits[name]} of {total[name]}" for name in hits})
    assert 0.9 < float(np.mean(inside)) < 0.99  # what bootstrap samples take is as wide as the intervals
    assert sum(hits.values()) >= 0.9 * sum(total.values()), (hits, total)
    assert all(hits[name] >= 0.8 * total[name] for name in hits), (hits, total)


def test_a_torque_is_found_in_the_prototype_s_sets() -> None:
    rng = np.random.default_rng(1)
    motor = Motor(10.0, 0.08, covariance.ANGLE, 0.5, STEP_S)
    for torque_pct, torque_s in ((0.5, 0.1), (1.0, 0.5)):
        found = estimate(pieces(*drawn(rng, motor, 0.104, torque_pct, torque_s), motor))
        assert found.torque_known
        assert found.torque_pct.value == pytest.approx(torque_pct, rel=0.15)
        assert found.sensor.value == pytest.approx(0.104, abs=0.02)


@pytest.mark.parametrize("kind", [covariance.SPEED, covariance.MEAN_SPEED])
@pytest.mark.parametrize("of_angle", [False, True])
def test_noise_of_the_angle_is_told_from_noise_of_the_speed_that_is_taken_from_it(of_angle: bool, kind: int) -> None:
    """What one speed lacks the next one has: taken for noise of the speed it was never white."""
    rng = np.random.default_rng(12)
    motor = Motor(10.0, 0.08, kind, 6.0 if kind == covariance.MEAN_SPEED else 0.0, 4.0 * STEP_S)
    residual, speed, lag_s, edges = drawn(rng, motor, 0.0, 0.5, 0.3)
    sensor = Noise(Ranged(5.0, 5.0, 5.0), Ranged(0.5, 0.5, 0.5), Ranged(0.3, 0.3, 0.3), of_angle=of_angle)
    residual = residual + draw_sensor(len(residual), sensor, rng)
    found = estimate(pieces(residual, speed, lag_s, edges, motor))
    assert found.of_angle is of_angle
    assert found.sensor.low <= 5.0 <= found.sensor.high
    assert found.torque_pct.value == pytest.approx(0.5, rel=0.2)
    times, moves = np.arange(len(residual)) * motor.step_s, covariance.Movement.steady(len(residual), motor.tau_s)
    whitener = Whitener(times, moves, np.ones(len(times)), edges[:-1], edges[1:], motor, found)
    white = whitener.apply(residual)
    assert float(white @ white) == pytest.approx(len(white) - 2 * WINDOWS, rel=0.1)
    assert abs(float(white[1:] @ white[:-1])) < 0.05 * float(white @ white)


@pytest.mark.parametrize("seed", range(3))
def test_a_few_windows_in_which_a_shaft_stuck_make_no_random_torque(seed: int) -> None:
    rng = np.random.default_rng(seed)
    motor = drawn_motor(rng, covariance.ANGLE, 0.088)
    residual, *others = drawn(rng, motor, 0.09, 0.0, 0.1)
    for window in rng.choice(WINDOWS, 3, replace=False):
        stuck = residual[(window + 1) * 200 - int(rng.integers(50, 180)) : (window + 1) * 200]
        stuck -= 30.0 * (1.0 - np.exp(-np.arange(len(stuck)) * STEP_S / 0.1))
    found = estimate(pieces(residual, *others, motor))
    assert found.torque_pct.low < 0.001, found.torque_pct
    assert found.torque_pct.high < 0.1, found.torque_pct
    assert found.sensor.low < 0.09 < found.sensor.high


@pytest.mark.parametrize("times", [3.0, 7.0])
@pytest.mark.parametrize("kind", [covariance.ANGLE, covariance.SPEED])
def test_a_run_as_a_whole_louder_than_the_others_is_told_so(kind: int, times: float) -> None:
    rng = np.random.default_rng(1)
    motor = drawn_motor(rng, kind, 0.0)
    loud = {"a": 1.0, "b": 1.0, "c": times}
    groups = [g for run, k in loud.items() for g in pieces(*drawn(rng, motor, 0.5 * k, 0.0, 0.1), motor, run)]
    found = estimate(groups)
    for run, k in loud.items():
        assert found.of(run).sensor.value == pytest.approx(0.5 * k, rel=0.1)


def test_declared_sensor_noise_is_taken_as_it_is() -> None:
    rng = np.random.default_rng(2)
    motor = drawn_motor(rng, covariance.ANGLE, 0.5)
    parts = pieces(*drawn(rng, motor, 0.5, 0.0, 0.1), motor)
    assert estimate(parts, sensor=0.3).sensor == Ranged(0.3, 0.3, 0.3)


def test_nothing_is_estimated_where_nothing_moves() -> None:
    motor = Motor(10.0, 0.08, covariance.ANGLE, 0.5, STEP_S)
    still = np.zeros(WINDOW * 3)
    found = pieces(still, still, still, np.arange(0, 3 * WINDOW + 1, WINDOW), motor)
    assert found == []
    assert estimate(found).samples == 0


def test_whitened_windows_are_white_and_of_unit_variance() -> None:
    rng = np.random.default_rng(3)
    motor, noise = Motor(10.0, 0.08, covariance.ANGLE, 0.5, STEP_S), Ranged(0.5, 0.5, 0.5)
    known = Noise(noise, Ranged(1.0, 1.0, 1.0), Ranged(0.3, 0.3, 0.3))
    draws = []
    for _ in range(20):
        residual, _, _, edges = drawn(rng, motor, 0.5, 1.0, 0.3)
        n = len(residual)
        times, moves = np.arange(n) * STEP_S, covariance.Movement.steady(n, motor.tau_s)
        whitener = Whitener(times, moves, np.ones(n), edges[:-1], edges[1:], motor, known)
        white = whitener.apply(residual)
        assert float(white @ white) == pytest.approx((WINDOW - 2) * WINDOWS, rel=0.05)
        draws.append(unevenness([white], [edges]))
    residual, _, _, edges = drawn(rng, motor, 0.5, 1.0, 0.3)
    assert is_white(unevenness([whitener.apply(residual)], [edges]), draws)
    wave = 0.3 * np.sin(2.0 * np.pi * 5.0 * np.arange(len(residual)) * STEP_S)
    assert not is_white(unevenness([whitener.apply(residual + wave)], [edges]), draws)


def test_windows_that_leave_nothing_but_rounding_are_not_uneven() -> None:
    rng, edges = np.random.default_rng(10), np.arange(0, 41 * WINDOW, WINDOW)
    white = rng.standard_normal(40 * WINDOW)
    resting = white.copy()
    resting[: 20 * WINDOW] = 1e-6 * np.repeat(rng.standard_normal(20 * WINDOW // 10), 10)
    assert unevenness([resting], [edges]) < 2.0 * unevenness([white], [edges])
    swinging = white + 0.5 * np.sin(0.2 * np.arange(len(white)))
    assert unevenness([swinging], [edges]) > 5.0 * unevenness([white], [edges])


def test_a_window_s_own_start_leaves_nothing_whitened() -> None:
    motor = Motor(10.0, 0.08, covariance.ANGLE, 0.0, STEP_S)
    known = Noise(Ranged(0.1, 0.1, 0.1), Ranged(1.0, 1.0, 1.0), Ranged(0.2, 0.2, 0.2))
    times = np.arange(WINDOW) * STEP_S
    lag_s = np.where(np.arange(WINDOW) < 120, 0.08, np.where(np.arange(WINDOW) < 160, 80.0, 0.0))
    moving = covariance.Movement(lag_s, np.ones(WINDOW))
    whitener = Whitener(times, moving, np.ones(len(times)), np.array([0]), np.array([WINDOW]), motor, known)
    own = covariance.starts(times, moving, motor.kind) @ np.array([3.0, 40.0])
    assert np.abs(whitener.apply(own)).max() < 1e-4 * np.abs(own).max() / 0.1


@pytest.mark.parametrize("step", [0.5, 0.087890625, 6.43])
def test_the_step_of_counts_is_found_in_printed_readings(step: float) -> None:
    rng = np.random.default_rng(4)
    read = np.round(np.floor(np.cumsum(rng.uniform(-3.0, 5.0, 4000))) * step, 6)
    assert found_quantum(read) == pytest.approx(step, rel=1e-4)


def test_an_analogue_sensor_has_no_step() -> None:
    rng = np.random.default_rng(5)
    assert found_quantum(np.cumsum(rng.standard_normal(4000))) == 0.0
    assert found_quantum(np.round(rng.standard_normal(4000), 3) * np.pi + rng.choice((0.0, 0.0011), 4000)) == 0.0


def test_the_step_is_found_where_a_speed_takes_few_values() -> None:
    rng = np.random.default_rng(6)
    read = np.round(6.428571 * rng.integers(13, 34, 4000), 4)
    assert found_quantum(read) == pytest.approx(6.428571, rel=1e-4)


def test_a_few_values_of_a_list_are_no_counts() -> None:
    rng = np.random.default_rng(7)
    assert found_quantum(rng.choice(rng.uniform(0.0, 100.0, 12), 4000)) == 0.0


@pytest.mark.parametrize("kind", [covariance.SPEED, covariance.MEAN_SPEED])
def test_speeds_without_counts_have_their_noise_and_no_torque(kind: int) -> None:
    """The likelihood of mean speeds that show no counts lost its digits: all of their noise was told as a torque."""
    rng = np.random.default_rng(14)
    motor = Motor(14.1, 0.0966, kind, 0.0, 4.0 * STEP_S)
    window = round(1.0 / motor.step_s)
    left, speed = rng.standard_normal(window * WINDOWS), np.full(window * WINDOWS, 300.0)
    edges = np.arange(0, len(left) + 1, window)
    left[edges[:-1]] = 0.0  # the first of a window is taken as it was measured
    found = estimate(pieces(left, speed, np.full(len(left), motor.tau_s), edges, motor))
    assert found.sensor.low <= 1.0 <= found.sensor.high
    assert not found.torque_known


@pytest.mark.parametrize("sensor", [0.0, 0.3])
def test_a_torque_that_wanders_slowly_is_found_by_a_sharp_sensor(sensor: float) -> None:
    """A longer time goes with a larger torque, on a ridge narrower than a grid that all times share: 2.3 % for 1.16 s
    was told.
    """
    rng = np.random.default_rng(2)
    motor = Motor(10.0, 0.08, covariance.SPEED, 0.0, STEP_S)
    for _ in range(2):
        found = estimate(pieces(*drawn(rng, motor, sensor, 1.5, 0.5), motor))
        assert found.torque_pct.low <= 1.5 <= found.torque_pct.high
        assert found.torque_s.low <= 0.5 <= found.torque_s.high


@pytest.mark.parametrize("kind", [covariance.ANGLE, covariance.SPEED, covariance.MEAN_SPEED])
def test_a_sensor_with_neither_counts_nor_noise_has_a_torque_to_be_found(kind: int) -> None:
    rng = np.random.default_rng(8)
    motor = Motor(10.0, 0.08, kind, 0.0, 4.0 * STEP_S)
    window = round(1.0 / motor.step_s)
    times, moving = np.arange(window) * motor.step_s, covariance.Movement.steady(window, motor.tau_s)
    acts = covariance.response(times, moving, motor.gain, motor.tau_s, kind)
    known = Noise(Ranged(0.0, 0.0, 0.0), Ranged(1.0, 0.0, 0.0), Ranged(0.2, 0.0, 0.0))
    torque = draw_torque(np.arange(window * WINDOWS) * motor.step_s, known, rng).reshape(WINDOWS, window)
    left, speed = (torque @ acts.T).ravel(), np.full(window * WINDOWS, 300.0)
    found = estimate(pieces(left, speed, np.full(len(left), 0.08), np.arange(0, len(left) + 1, window), motor))
    assert found.torque_pct.value == pytest.approx(1.0, rel=0.15)
    assert found.sensor.value < 0.1 * float(np.std(left))


@pytest.mark.parametrize(
    ("kind", "of_angle"),
    [
        (covariance.ANGLE, False),
        (covariance.SPEED, False),
        (covariance.SPEED, True),
        (covariance.MEAN_SPEED, False),
        (covariance.MEAN_SPEED, True),
    ],
)
@pytest.mark.parametrize("torque_pct", [0.0, 1.0])
def test_innovations_are_what_the_covariance_whitens(kind: int, torque_pct: float, of_angle: bool) -> None:
    """The filter against the covariance itself, its start free: squares, products and determinant."""
    rng = np.random.default_rng(9)
    motor = Motor(10.0, 0.08, kind, 0.5, 0.01)
    known = Noise(Ranged(0.2, 0.2, 0.2), Ranged(torque_pct, 0.0, 2.0), Ranged(0.3, 0.3, 0.3), of_angle=of_angle)
    n = 60
    times, weights = np.cumsum(rng.uniform(0.008, 0.012, n)), rng.choice([1.0, 0.4], n)
    lag_s = np.where(np.arange(n) < 20, 0.08, np.where(np.arange(n) < 40, 0.02, np.where(np.arange(n) < 50, 0.0, 80.0)))
    keeps = np.where(np.arange(n) == 13, 0.6, 1.0)
    moving = covariance.Movement(lag_s, keeps)
    acts = covariance.response(times, moving, motor.gain, motor.tau_s, kind) * torque_pct
    own = covariance.counts(n, motor.quantum, kind)
    sensed = known.sensor.value**2 * np.eye(n)
    if of_angle:
        own, sensed = own + 6.0 * known.sensor.value**2 * covariance.counts(n, 1.0, covariance.MEAN_SPEED), 0.0 * sensed
    own = own / np.outer(weights, weights) + sensed + acts @ covariance.torque(times, known.torque_s.value) @ acts.T
    starts = covariance.starts(times, moving, kind)
    free = covariance.outside(starts)
    inside = free.T @ own @ free
    series = rng.standard_normal((n, 3))
    whitener = Whitener(times, moving, weights, np.array([0]), np.array([n]), motor, known)
    white = whitener.apply(series)
    expected = (free.T @ series).T @ np.linalg.solve(inside, free.T @ series)
    assert white.T @ white == pytest.approx(expected, rel=1e-5)
    determinant = np.linalg.slogdet(inside)[1] + np.linalg.slogdet(starts.T @ starts)[1]
    assert whitener.log_determinant == pytest.approx(determinant, rel=1e-5)
    assert np.abs(whitener.apply(starts)).max() < 1e-3


@pytest.mark.parametrize(
    ("kind", "of_angle"), [(covariance.SPEED, True), (covariance.MEAN_SPEED, False), (covariance.MEAN_SPEED, True)]
)
@pytest.mark.parametrize("quantum", [0.0, 0.5])
def test_the_likelihood_of_shared_errors_is_that_of_their_covariance(kind: int, of_angle: bool, quantum: float) -> None:
    """Pieces of two lengths, of which some are louder: by the filter, and by the covariance outside their starts."""
    rng = np.random.default_rng(21)
    motor, time_s = Motor(10.0, 0.08, kind, quantum, 0.01, of_angle), 0.3
    sensors, torques = np.array([0.3, 1.0]), np.array([0.0, 0.2, 3.0])
    groups = [
        Group(rng.standard_normal((n, 3)), motor, louder=louder) for n, louder in ((20, 1.0), (45, 1.0), (45, 2.0))
    ]
    expected = np.zeros((len(sensors), len(torques)))
    for group in groups:
        n = len(group.residuals)
        times, moving = np.arange(n) * motor.step_s, covariance.Movement.steady(n, motor.tau_s)
        free = covariance.outside(covariance.starts(times, moving, kind))
        acts = covariance.response(times, moving, motor.gain, motor.tau_s, kind)
        wanders = acts @ covariance.torque(times, time_s) @ acts.T
        counted = covariance.counts(n, quantum, kind)
        shared = 6.0 * covariance.counts(n, 1.0, covariance.MEAN_SPEED) if of_angle else np.eye(n)
        left = free.T @ group.residuals
        for i, sensor in enumerate(group.louder * sensors):
            for j, torque in enumerate(torques):
                inside = free.T @ (counted + sensor**2 * shared + torque**2 * wanders) @ free
                expected[i, j] += 3.0 * np.linalg.slogdet(inside)[1] + np.sum(left * np.linalg.solve(inside, left))
    (found,) = deviances(groups, [np.array([time_s]), sensors, torques[None, :]], 0.0)
    assert found - found[0, 0] == pytest.approx(expected - expected[0, 0], rel=1e-4)
