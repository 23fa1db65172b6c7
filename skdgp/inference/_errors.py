r"""Errors of the function that a posterior does not hold, and the posterior with them.

A posterior takes the errors of samples as independent, and the regressors as independent of the
noise. In a flight, errors last, gusts disturb several outputs and move the aircraft, noise of the
regressors flattens slopes, and the kernel may be too smooth. What this changes is a random function

.. math:: e_i(x) = \sum_k z_k\, (w_{k0i} + \sum_j w_{kji} (x_j - c_j)) + \delta_i(x),
          \quad z_k \sim N(0, 1)

that is added to the posterior: a linear function, of which the outputs share the numbers z, and the
discrepancy, a process of each output with the variance :func:`misfit_variance` and the width of one
standard deviation of the regressors.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.inference._posterior import FREQUENCIES, Posterior, SinglePosterior
from skdgp.kernels import MultiOutputKernel, PathBundle, independent_processes, prior_paths

BLOCKS = 60  # blocks of the time series; errors of different blocks are taken as independent
BLOCK_ROWS = 10  # fewest samples in a block
FEWEST = 10  # samples for each weight of a line
DELAYS = (2, 4, 6)  # of the instruments, in autocorrelation times of the errors
SINGULAR = 1e-10  # fraction of the largest eigenvalue below which instruments count as equal


class FunctionErrors(NamedTuple):
    """A random function of d regressors: linear terms, and the discrepancy of each of P outputs."""

    #: w of errors that are correlated in time and between outputs, (K, d + 1, P)
    random: Array
    #: w of errors by gusts that move the aircraft and by noise of the regressors, (K', d + 1, P)
    method: Array
    #: c, (d,)
    centre: Vector
    #: Variance of the discrepancy, (P,)
    discrepancy: Vector
    #: Its width, (d,)
    length_scale: Vector

    @property
    def weights(self) -> Array:
        """All w, (K + K', d + 1, P)."""
        return np.concatenate([self.random, self.method])

    @property
    def kernel(self) -> MultiOutputKernel:
        """Covariance of the discrepancy."""
        return independent_processes(self.discrepancy, self.length_scale)

    def linear(self, X: Matrix) -> Array:
        """Return the linear terms at X (n, d), (K + K', n, P)."""
        return _basis(X - self.centre) @ self.weights

    def variance(self, X: Matrix) -> Matrix:
        """Return the variance at X (n, d), (n, P)."""
        return np.sum(self.linear(X) ** 2, axis=0) + self.discrepancy

    def covariance(self, X: Matrix) -> Matrix:
        """Return the joint covariance at X (n, d), (P n, P n), output-major."""
        shape = len(self.weights), len(self.discrepancy) * len(X)
        terms = self.linear(X).swapaxes(1, 2).reshape(shape)
        return terms.T @ terms + self.kernel(X)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return draws of the errors."""
        rng = check_random_state(random_state)
        z = rng.standard_normal((n_paths, len(self.weights)))
        linear = LinearPaths(np.tensordot(z, self.weights, axes=1), self.centre)
        return linear + prior_paths(self.kernel, n_paths, FREQUENCIES, rng)

    def slopes(self) -> tuple[Array, Array]:
        """Return the slopes of the linear terms, random and by method, (P, d, K) and (P, d, K')."""
        random, method = self.random[:, 1:], self.method[:, 1:]
        return np.transpose(random, (2, 1, 0)), np.transpose(method, (2, 1, 0))

    def in_units(self, shift: Vector, scale: Vector, output_scale: Vector) -> FunctionErrors:
        """Return the errors of outputs times ``output_scale``, as a function of shift + scale x."""
        factor = np.concatenate([[1.0], 1.0 / scale])[:, None] * output_scale
        return FunctionErrors(
            self.random * factor,
            self.method * factor,
            shift + scale * self.centre,
            self.discrepancy * output_scale**2,
            scale * self.length_scale,
        )

    def of_outputs(self, outputs: Any) -> FunctionErrors:
        """Return the errors of some outputs."""
        return self._replace(
            random=self.random[..., outputs],
            method=self.method[..., outputs],
            discrepancy=self.discrepancy[outputs],
        )


class LinearPaths(PathBundle):
    """Linear functions of x - ``centre`` with the weights (S, d + 1, P)."""

    def __init__(self, weights: Array, centre: Vector) -> None:
        self.weights = weights
        self.centre = centre

    def take(self, index):
        return LinearPaths(self.weights[index], self.centre)

    def doubles(self, same_points):
        return len(self.weights) * sum(self.weights.shape[1:])

    def each(self, X):
        return _basis(X - self.centre) @ self.weights

    def gradient(self, X):
        slopes = self.weights[:, 1:].swapaxes(1, 2)[:, None]
        n = X.shape[1]
        return np.repeat(slopes, n, axis=1)


class PosteriorWithErrors(Posterior):
    """A posterior plus independent errors of its function.

    Mean, kernel, noise, likelihood, data and components are those of the posterior.

    Parameters
    ----------
    posterior : Posterior
    errors : FunctionErrors
    """

    def __init__(self, posterior: Posterior, errors: FunctionErrors) -> None:
        self.posterior = posterior
        self.errors = errors
        self.kernel = posterior.kernel
        self.noise = posterior.noise
        self.log_marginal_likelihood = posterior.log_marginal_likelihood
        self.data = posterior.data

    @property
    def members(self) -> Sequence[SinglePosterior]:  # type: ignore[override]
        """The components of the posterior, without the errors."""
        return self.posterior.members

    @property
    def mixture(self) -> Matrix:  # type: ignore[override]
        """The weights of the components, (K, P)."""
        return self.posterior.mixture

    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        if not return_variance:
            return self.posterior.predict(Xs)
        mean, variance = self.posterior.predict(Xs, return_variance=True)
        return mean, variance + self.errors.variance(Xs)

    def gradient(self, Xs: Matrix) -> Array:
        """Return d mean / d x at Xs, (n, P, d)."""
        return self.posterior.gradient(Xs)

    def covariance(self, Xs: Matrix) -> Matrix:
        """Return the joint covariance at Xs, (P n, P n), output-major."""
        return self.posterior.covariance(Xs) + self.errors.covariance(Xs)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples that are functions of the regressors."""
        rng = check_random_state(random_state)
        return self.posterior.paths(n_paths, rng) + self.errors.paths(n_paths, rng)


# equations of a hundred terms: on two threads they take several times as long on a busy machine
@one_blas_thread()
def function_errors(
    posterior: Posterior,
    discrepancy: Vector,
    input_std: Vector | None = None,
    flight: Vector | None = None,
) -> FunctionErrors:
    r"""Return the errors of the function of a posterior that it does not hold, from its time series.

    With the residuals r of the posterior's mean, Q = (1, x - c) and :math:`G = (Q^T Q)^{-1}`:

    - random: over blocks b of consecutive samples, :math:`w_b = G Q_b^T r_b`, whatever the
      correlation within a block and between outputs (Liang & Zeger 1986);
    - gusts that move the aircraft bias slopes. Instruments, which are earlier regressors, find
      slopes d of the residuals, with standard deviation s. These count as
      :math:`\sqrt{d^2 - s^2}`, what is beyond chance;
    - noise of the regressors with the covariance :math:`S = \mathrm{diag}(s_k^2)` flattens slopes
      J of regressors with the covariance C by :math:`C^{-1} S J`; it counts by one number for each
      regressor (Fuller 1987, section 1.1).

    With too few samples for that, only the discrepancy and ``mean_errors`` are returned.

    Parameters
    ----------
    posterior : Posterior
        Its samples are in the order of recording.
    discrepancy : ndarray (P,)
        Variance of the discrepancy.
    input_std : ndarray (d,) or None
        Standard deviations of the noise of the regressors.
    flight : ndarray (n,) or None
        Number of the flight of each sample. No block and no instrument crosses the end of one. None: one flight.

    Returns
    -------
    FunctionErrors
    """
    data = posterior.data
    longest = max(data.X, key=len)
    centre, scale = longest.mean(axis=0), column_scale(longest)
    P, d = len(data.y), len(centre)
    errors = mean_errors(posterior)._replace(
        centre=centre, discrepancy=np.asarray(discrepancy, dtype=float), length_scale=scale
    )
    if min(map(len, data.y)) < FEWEST * (d + 1):
        return errors
    n_records = 1 if flight is None else len(np.unique(flight))
    random = np.zeros((BLOCKS + n_records, d + 1, P))
    instruments = np.zeros((1, d + 1, P))
    attenuation = np.zeros((d, d + 1, P))
    slopes = posterior.gradient(centre[None])[0]
    for i, (x, y) in enumerate(zip(data.X, data.y, strict=True)):
        Q = _basis(x - centre)
        residual = y - posterior.predict(x)[:, i]
        records = _records(None if flight is None else flight[data.sample[i]], len(y))
        of_blocks = block_errors(Q, residual, blocks(records, len(y)))
        random[: len(of_blocks), :, i] = of_blocks
        change, scatter = instrumented(Q / np.append(1.0, scale), residual, records)
        beyond_chance = np.maximum(change**2 - np.sum(scatter**2, axis=0), 0.0)
        instruments[0, 1:, i] = (np.sign(change) * np.sqrt(beyond_chance))[1:] / scale
        if input_std is not None:
            attenuation[:, 1:, i] = _attenuation(x, input_std, slopes[i])
    return errors._replace(random=random, method=np.concatenate([instruments, attenuation]))


def _records(flight: Vector | None, n: int) -> list[Indices]:
    """Return the rows of each flight, of n samples of these flights."""
    codes = np.zeros(n) if flight is None else flight
    return [np.flatnonzero(codes == code) for code in np.unique(codes)]


def _attenuation(x: Matrix, input_std: Vector, slopes: Vector) -> Matrix:
    """Return how far noise of each regressor (rows) flattens each slope (columns), (d, d)."""
    covariance = np.atleast_2d(np.cov(x.T))
    inverse = np.linalg.pinv(covariance, rcond=SINGULAR, hermitian=True)
    return inverse * (input_std**2 * slopes)[:, None]


def _basis(x: Array) -> Array:
    """Return (1, x), (..., d + 1)."""
    return np.concatenate([np.ones((*x.shape[:-1], 1)), x], axis=-1)


def blocks(records: Sequence[Indices], n: int) -> list[Indices]:
    """Return the rows of blocks of consecutive samples of the records, in all about 60 of n samples."""
    length = max(n / BLOCKS, BLOCK_ROWS)
    parts: list[Indices] = []
    for rows in records:
        parts += np.array_split(rows, max(1, int(len(rows) / length)))
    if len(parts) == 1:  # a scatter needs two
        parts = np.array_split(parts[0], 2)
    return parts


def block_errors(
    Q: Matrix, residual: Vector, parts: Sequence[Indices], inverse: Any = None
) -> Matrix:
    """Return errors of the weights of least squares by block, (n_blocks, m), for terms Q (n, m).

    ``inverse`` is by default that of Q^T Q.
    """
    if inverse is None:
        size = np.sqrt(np.einsum("nm,nm->m", Q, Q))  # so that units of the terms do not count
        size[size == 0] = 1.0
        scaled = Q / size
        inverse = np.linalg.pinv(scaled.T @ scaled, rcond=SINGULAR, hermitian=True)
        inverse /= np.multiply.outer(size, size)
    scores = np.array([Q[rows].T @ residual[rows] for rows in parts])
    return scores @ inverse.T * np.sqrt(len(scores) / (len(scores) - 1))


def instrumented(Q: Matrix, y: Vector, records: Sequence[Indices]) -> tuple[Vector, Matrix]:
    """Return weights (m,) of y (n,) by two-stage least squares, and their errors by block, (n_blocks, m).

    Instruments are earlier rows of the terms Q (n, m) in the same record, by more than the errors
    ``y`` of least squares last (Soderstrom & Stoica 1989, section 8.1): an error that causes
    motion, such as that of a gust, correlates with present regressors, and so biases least squares.
    Part of the bias remains, the more the longer gusts last.
    """
    lasting = [autocorrelation_time(y[rows]) * len(rows) for rows in records]
    lag = min(round(sum(lasting) / len(y)), len(y) // (2 * DELAYS[-1]))
    first = lag * DELAYS[-1]
    long = [rows for rows in records if len(rows) > first]
    if not long:
        return np.zeros(Q.shape[1]), np.zeros((2, Q.shape[1]))
    now = np.concatenate([rows[first:] for rows in long])
    past = []
    for delay in DELAYS:
        earlier = [rows[first - lag * delay : len(rows) - lag * delay] for rows in long]
        past.append(Q[np.concatenate(earlier)])
    instruments = np.hstack(past)
    between = np.linalg.pinv(instruments.T @ instruments, rcond=SINGULAR, hermitian=True)
    expected = instruments @ (between @ (instruments.T @ Q[now]))
    inverse = np.linalg.pinv(expected.T @ Q[now], rcond=SINGULAR, hermitian=True)
    weights = inverse @ (expected.T @ y[now])
    ends = np.cumsum([0, *(len(rows) - first for rows in long)])
    of_records = [np.arange(a, b) for a, b in pairwise(ends)]
    parts = blocks(of_records, len(now))
    return weights, block_errors(expected, y[now] - Q[now] @ weights, parts, inverse)


def mean_errors(posterior: Posterior) -> FunctionErrors:
    """Return the errors of a function by the means of the outputs, which were subtracted before the fit.

    The mean of n values with noise of variance s^2 has the variance s^2 / n. For a linear function
    of centred regressors this is the uncertainty of an intercept without a prior.
    """
    data = posterior.data
    noise = np.array([member.noise for member in posterior.members])
    variance = np.sum(posterior.mixture * noise, axis=0) / [len(y) for y in data.y]
    if data.sample_noise is not None:
        for i, loading in enumerate(data.sample_noise.loading):
            variance[i] += np.mean(np.sum(loading**2, axis=1)) / len(loading)
    P, d = len(data.y), data.X[0].shape[1]
    random = np.zeros((P, d + 1, P))
    random[:, 0] = np.diag(np.sqrt(variance))
    centre = max(data.X, key=len).mean(axis=0)  # where errors of known slopes vanish
    return FunctionErrors(random, np.zeros((0, d + 1, P)), centre, np.zeros(P), np.ones(d))


@one_blas_thread()
def narrowing(posterior: Posterior, added: Matrix) -> Matrix:
    """Return how far rows flown next narrow the deviations of slopes at the centre, (P, d), as of least squares.

    ``added`` (k, d) are their regressors. With too few rows for least squares no promise is made:
    the factor is one.
    """
    data = posterior.data
    ratio = np.ones((len(data.y), added.shape[1]))
    for i, x in enumerate(data.X):
        if len(x) < FEWEST * (1 + x.shape[1]):
            continue
        centre, scale = x.mean(axis=0), column_scale(x)
        before = _slope_variances((x - centre) / scale)
        after = _slope_variances((np.vstack([x, added]) - centre) / scale)
        np.divide(after, before, out=ratio[i], where=before > 0)
    return np.sqrt(np.minimum(ratio, 1.0))


def _slope_variances(z: Matrix) -> Vector:
    """Return the variances (d,) of the slopes of a line by least squares at z (n, d), for noise of variance one."""
    Q = _basis(z)
    inverse = np.linalg.pinv(Q.T @ Q, rcond=SINGULAR, hermitian=True)
    return np.diag(inverse)[1:]
