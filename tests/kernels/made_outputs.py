"""Outputs that depend on each other in known ways: regressors, outputs with gaps, points and the truth there."""

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.random import default_rng

SHIFTS = np.array([0.0, 1.5, -1.0])


def waves(rng, x):
    """Return a draw of a stationary process of unit variance and width about one."""
    frequency = rng.normal(size=40)
    phase = rng.uniform(0, 2 * np.pi, 40)
    return np.sqrt(2 / 40) * np.cos(np.multiply.outer(x, frequency) + phase).sum(axis=-1)


def translated(rng, n=150):
    """Return three copies of one function, moved by `SHIFTS`, each with a gap of its own."""
    x = np.sort(rng.uniform(0, 20, n))
    points = np.linspace(0.5, 19.5, 400)
    both = waves(rng, np.subtract.outer(np.concatenate([x, points]), SHIFTS))
    Y = both[:n] + rng.normal(0, 0.1, (n, 3))
    for i, start in enumerate((4.0, 9.0, 14.0)):
        Y[(x > start) & (x < start + 4), i] = np.nan
    return x[:, None], Y, points[:, None], both[n:]


def noisy_copies(rng):
    """Return four multiples of one function of three regressors, of which one has little noise."""
    X = rng.uniform(-2, 2, (480, 3))
    f = np.sin(X[:, 0]) + 0.5 * X[:, 1] * X[:, 2] + 0.5 * np.cos(2 * X[:, 1])
    F = np.outer(f, [1.0, -2.0, 0.5, 1.5])
    return X[:80], F[:80] + rng.normal(size=(80, 4)) * [0.05, 1.0, 0.5, 1.5], X[80:], F[80:]


def little_overlap(rng):
    """Return two outputs that were observed in different places, as in GPy's tutorial of coregionalisation.

    The truth is known where an output was not observed.
    """

    def functions(x):
        wave = np.cos(x / 5)
        return np.column_stack([4 * wave - 0.4 * x - 35, 6 * wave + 0.2 * x + 35])

    x = np.concatenate([rng.uniform(0, 75, 100), rng.uniform(70, 100, 100)])
    Y = functions(x) + rng.uniform(-1, 1, (200, 2)) * [1.0, 4.0]
    Y[100:, 0] = np.nan
    Y[:100, 1] = np.nan
    points = np.linspace(0, 100, 101)
    truth = functions(points)
    truth[points <= 75, 0] = np.nan
    truth[points >= 70, 1] = np.nan
    return x[:, None], Y, points[:, None], truth


def slopes_over(slopes, X, spread, n_nodes=60):
    """Return slopes (..., n, P, d) at X (n, d), each expected over a normal perturbation of its regressor alone."""
    nodes, weights = hermegauss(n_nodes)
    weights /= weights.sum()
    expected = []
    for k, step in enumerate(np.diag(spread)):
        moved = [w * slopes(X + z * step)[..., k] for z, w in zip(nodes, weights, strict=True)]
        expected.append(np.sum(moved, axis=0))
    return np.stack(expected, axis=-1)


def in_units(n=40, seed=0):
    """Return two dependent outputs of two regressors, in units far from one, some of the second not observed."""
    rng = default_rng(seed)
    X = rng.normal(size=(n, 2)) * [1.0, 30.0] + [0.0, 200.0]
    z = (X - [0.0, 200.0]) / [1.0, 30.0]
    common = np.sin(1.5 * z[:, 0]) + 0.5 * z[:, 1]
    Y = np.column_stack([1e-2 * common + 3.0, -50 * common + 10 * np.cos(z[:, 1])])
    Y += rng.normal(0, [3e-4, 2.0], Y.shape)
    Y[rng.random(n) < 0.3, 1] = np.nan
    return X, Y
