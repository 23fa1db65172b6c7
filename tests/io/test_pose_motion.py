"""Motion from noisy positions: the smoother is that of its equations, and bends nothing at the ends."""

from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.interpolate import BSpline
from scipy.spatial.transform import Rotation

from skdgp.io._poses import (
    ROUGHEST,
    SMOOTHEST,
    Record,
    minus_log_likelihood,
    smooth_motion,
    smooth_rotation,
)

LOG_K = np.array([-1.0, -3.0, 0.5])


def turning(time):
    return Rotation.from_rotvec(np.outer(time, [0.3, -0.2, 0.5]))


def still(time):
    return Rotation.identity(len(time))


def record(axes, n=14, *, gravity=0.0):
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(0.7, 1.3, n))
    return Record(time, rng.normal(0, 1, (n, 3)), axes(time), gravity)


def splines(record):
    """B-splines of the samples (n, K)."""
    n_splines = len(record.knots) - 6
    elements = [
        BSpline.basis_element(record.knots[j : j + 7], extrapolate=False) for j in range(n_splines)
    ]
    return np.nan_to_num(np.stack([element(record.time) for element in elements], axis=-1))


@pytest.mark.parametrize("gravity", [0.0, 9.8])
def test_coefficients_are_those_of_least_squares(gravity):
    given = record(turning, gravity=gravity)
    basis = splines(given)
    K = basis.shape[1]
    rows, right = [np.kron(basis, np.eye(3))], [given.x.ravel()]
    knots = np.clip(given.knots[4:], given.time[0], given.time[-1])
    C = turning(knots).as_matrix()
    for j in range(K - 4):
        row, known = np.zeros((3, K, 3)), np.zeros(3)
        for i, difference in enumerate((1, -2, 1)):
            row[:, j + i : j + i + 3] += difference * np.multiply.outer(
                (1, -2, 1), C[j + i].T
            ).swapaxes(0, 1)
            known += difference * C[j + i].T @ [0, 0, gravity * given.step**2]
        weight = np.exp(-0.5 * LOG_K) / given.step**2
        rows.append(weight[:, None] * row.reshape(3, 3 * K))
        right.append(weight * known)
    rows, right = np.concatenate(rows), np.concatenate(right)
    expected = np.linalg.lstsq(rows, right, rcond=None)[0]
    fit = given.fit(LOG_K)
    np.testing.assert_allclose(fit.coefficients.ravel(), expected, atol=1e-8)
    np.testing.assert_allclose(fit.misfit, np.sum((rows @ expected - right) ** 2), rtol=1e-8)
    np.testing.assert_allclose(fit.log_determinant, np.linalg.slogdet(rows.T @ rows)[1], rtol=1e-10)


def test_likelihood_is_that_of_the_samples_without_their_cubics():
    """The coefficients are random with white fourth differences, and any cubic; the normal density is scipy's."""
    given, offsets = record(still), []
    basis = splines(given)
    inverse = np.linalg.pinv(np.diff(np.eye(basis.shape[1]), 4, axis=0) / given.step**2)
    cubics = np.vander(given.time - given.time.mean(), 4)
    left = np.linalg.qr(cubics, mode="complete")[0][:, 4:]
    for log_k in (np.zeros(3), LOG_K):
        spread = left.T @ basis @ inverse
        parts = [np.exp(k) * spread @ spread.T + np.eye(len(spread)) for k in log_k]
        values = left.T @ given.x
        misfit = sum(y @ np.linalg.solve(part, y) for y, part in zip(values.T, parts, strict=True))
        density = sum(
            stats.multivariate_normal(cov=part).logpdf(0 * values[:, 0]) for part in parts
        )
        expected = values.size * np.log(misfit) - 2 * density
        offsets.append(minus_log_likelihood([given], log_k) - expected)
    np.testing.assert_allclose(offsets[0], offsets[1], atol=1e-8)


@pytest.mark.parametrize("jitter", [0.0, 0.95])
def test_the_corners_of_the_search_can_be_solved(jitter):
    rng = np.random.default_rng(0)
    time = np.cumsum(1 + rng.uniform(-jitter, jitter, 2000))
    path = np.cumsum(np.cumsum(rng.normal(0, 1e-4, (2000, 3)), axis=0), axis=0)
    given = Record(time, path, turning(0.05 * time), 1e-3)
    for log_k in product((SMOOTHEST, ROUGHEST), repeat=3):
        assert np.isfinite(given.fit(np.array(log_k)).coefficients).all()


@pytest.mark.parametrize("start", [0.0, 5e6])
def test_constant_acceleration_is_exact_up_to_the_ends(start):
    time = np.arange(150) * 0.01
    truth = start + np.outer(time, [5.0, -1, 2]) + np.outer(time**2, [1.0, 4, -3]) / 2
    motion = smooth_motion(time, truth, [slice(0, 150)])
    np.testing.assert_allclose(motion.x, truth, rtol=1e-9, atol=1e-9)
    velocity = np.array([5.0, -1, 2]) + np.outer(time, [1.0, 4, -3])
    np.testing.assert_allclose(motion.v, velocity, atol=1e-6 if start == 0 else 1e-4)
    np.testing.assert_allclose(
        motion.f, np.tile([1.0, 4, -3], (150, 1)), atol=1e-4 if start == 0 else 1e-1
    )


def test_body_falls_freely_where_nothing_acts():
    time = np.arange(100) * 0.02
    motion = smooth_motion(
        time, np.outer(time**2, [0, 0, 9.8 / 2]), [slice(0, 100)], axes=turning(time), gravity=9.8
    )
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
    rates = np.stack(
        [4 * np.sin(1.3 * fine), 0.5 + 2 * np.cos(2.1 * fine), np.sin(0.9 * fine + 1)], axis=-1
    )
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
