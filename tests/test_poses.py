"""Motion from noisy positions: the smoother is that of its equations, and bends nothing at the ends."""

import numpy as np
import pytest
from scipy import stats
from scipy.spatial.transform import Rotation

from skdgp._flight.poses import Record, minus_log_likelihood, smooth_motion, smooth_rotation

LOG_K = np.array([-1.0, -3.0, 0.5])
COVARIANCE = np.array([[1 / 20, 1 / 8, 1 / 6], [1 / 8, 1 / 3, 1 / 2], [1 / 6, 1 / 2, 1.0]])
"""Of (x, v, f) after one second of integrated white noise."""


def turning(time, rate=(0.3, -0.2, 0.5)):
    return Rotation.from_rotvec(np.outer(time, rate))


def record(n=12, *, gravity=0.0, seed=0, axes=None):
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.7, 1.3, n))
    return Record(time, rng.normal(0, 1, (n, 3)), turning(time) if axes is None else axes(time), gravity)


def dense(record, log_k):
    """Rows of white residuals of all states, typed from x' = v, v' = C f + g, f' = w; and what they should be."""
    n, rows, right = len(record.x), [], []
    for k in range(n):
        row = np.zeros((3, n, 3, 3))
        row[:, k, 0] = np.eye(3)
        rows.append(row)
        right.append(record.x[k])
    for k, h in enumerate(np.diff(record.time)):
        C = (
            record.axes[k] * Rotation.from_rotvec((record.axes[k].inv() * record.axes[k + 1]).as_rotvec() / 2)
        ).as_matrix()
        flow = np.eye(9)
        flow[:3, 3:6], flow[:3, 6:], flow[3:6, 6:] = h * np.eye(3), h**2 / 2 * C, h * C
        turn = np.kron(np.diag([1.0, 1, 0]), C) + np.kron(np.diag([0.0, 0, 1]), np.eye(3))
        size = h ** np.array([2.5, 1.5, 0.5])
        covariance = turn @ np.kron(COVARIANCE * np.outer(size, size), np.diag(np.exp(log_k))) @ turn.T
        whiten = np.linalg.inv(np.linalg.cholesky(covariance))
        row = np.zeros((9, n, 9))
        row[:, k + 1], row[:, k] = whiten, -whiten @ flow
        fall = record.gravity * np.r_[0, 0, h**2 / 2, 0, 0, h, 0, 0, 0]
        rows.append(row.reshape(9, n, 3, 3))
        right.append(whiten @ fall)
    return np.concatenate(rows).reshape(-1, 9 * n), np.concatenate(right)


@pytest.mark.parametrize("gravity", [0.0, 9.8])
def test_states_are_those_of_least_squares(gravity):
    given = record(gravity=gravity)
    rows, right = dense(given, LOG_K)
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    states, misfit, log_determinant = given.solve(LOG_K)
    np.testing.assert_allclose(states.ravel(), expected, atol=1e-8)
    np.testing.assert_allclose(misfit, np.sum((rows @ expected - right) ** 2), rtol=1e-8)
    np.testing.assert_allclose(log_determinant, np.linalg.slogdet(rows.T @ rows)[1], rtol=1e-10)


def test_likelihood_is_that_of_the_third_differences_of_the_samples():
    """What is left of three independent random processes when their starts are projected out."""
    n, log_ratios = 9, []
    given = Record(np.arange(n, dtype=float), np.random.default_rng(1).normal(0, 1, (n, 3)), Rotation.identity(n), 0.0)
    third = np.diff(np.eye(n), 3, axis=0)
    for log_k in (np.zeros(3), LOG_K):
        time = np.arange(n, dtype=float)[:, None]
        early, late = np.minimum(time, time.T), np.maximum(time, time.T)
        integrated = early**5 / 20 - early**4 * (early - late) / 8 + early**3 * (late - early) ** 2 / 12
        parts = [third @ (np.exp(k) * integrated + np.eye(n)) @ third.T for k in log_k]
        values = third @ given.x
        degrees = values.size
        misfit = sum(y @ np.linalg.solve(part, y) for y, part in zip(values.T, parts, strict=True))
        reference = -2 * sum(stats.multivariate_normal(cov=part).logpdf(0 * values[:, 0]) for part in parts)
        log_ratios.append(minus_log_likelihood([given], log_k) - degrees * np.log(misfit) - reference)
    np.testing.assert_allclose(log_ratios[0], log_ratios[1], atol=1e-8)


@pytest.mark.parametrize("start", [0.0, 5e6])
def test_constant_acceleration_is_exact_up_to_the_ends(start):
    time = np.arange(150) * 0.01
    truth = start + np.outer(time, [5.0, -1, 2]) + np.outer(time**2, [1.0, 4, -3]) / 2
    motion = smooth_motion(time, truth, [slice(0, 150)])
    np.testing.assert_allclose(motion.x, truth, rtol=1e-9, atol=1e-9)
    velocity = np.array([5.0, -1, 2]) + np.outer(time, [1.0, 4, -3])
    np.testing.assert_allclose(motion.v, velocity, atol=1e-6 if start == 0 else 1e-4)
    np.testing.assert_allclose(motion.f, np.tile([1.0, 4, -3], (150, 1)), atol=1e-4 if start == 0 else 1e-1)


def test_body_falls_freely_where_nothing_acts():
    time = np.arange(100) * 0.02
    motion = smooth_motion(time, np.outer(time**2, [0, 0, 9.8 / 2]), [slice(0, 100)], axes=turning(time), gravity=9.8)
    np.testing.assert_allclose(motion.f, 0, atol=1e-5)


def test_noise_is_learned_from_all_records():
    rng = np.random.default_rng(0)
    time = np.tile(np.arange(120) * 0.01, 6)
    smooth = np.stack([np.sin(3 * time), np.cos(5 * time), np.sin(2 * time)], axis=-1)
    segments = [slice(k, k + 120) for k in range(0, 720, 120)]
    motion = smooth_motion(time, smooth + rng.normal(0, 1e-3, smooth.shape), segments)
    assert motion.noise == pytest.approx(1e-3, rel=0.1)


@pytest.mark.parametrize("rate", [25, 100])
def test_rates_are_those_of_the_body_in_a_fast_turn(rate):
    fine = np.arange(0, 6, 0.001)
    rates = np.stack([4 * np.sin(1.3 * fine), 0.5 + 2 * np.cos(2.1 * fine), np.sin(0.9 * fine + 1)], axis=-1)
    turns = Rotation.from_rotvec((rates[1:] + rates[:-1]) / 2 * 0.001)
    attitudes = [Rotation.identity()]
    for turn in turns:
        attitudes.append(attitudes[-1] * turn)
    rows = slice(None, None, 1000 // rate)
    attitude = Rotation.concatenate(attitudes)[rows]
    found = smooth_rotation(fine[rows], attitude, [slice(0, len(attitude))])
    np.testing.assert_allclose(found.rates[3:-3], rates[rows][3:-3], atol=0.1 / rate)
    acceleration = np.gradient(rates, 0.001, axis=0)[rows]
    np.testing.assert_allclose(found.accelerations[3:-3], acceleration[3:-3], atol=4 / rate)
