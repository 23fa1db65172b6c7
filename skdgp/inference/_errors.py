r"""Errors of the function that a posterior does not hold, and the posterior with them.

A posterior takes the errors of samples as independent, and the regressors as independent of the
noise. In a flight, errors last, gusts disturb several outputs and move the aircraft, noise of the
regressors flattens slopes, and the kernel may be too smooth. The error that this causes is a random
function

.. math:: e_i(x) = \sum_k z_k\, (w_{k0i} + \sum_j w_{kji} (x_j - c_j)) + \delta_i(x),
          \quad z_k \sim N(0, 1)

that is added to the posterior: a linear function, whose numbers z the outputs share, and the
discrepancy, a process of each output with the variance :func:`misfit_variance` and the width of one
standard deviation of the regressors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, consecutive
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import Posterior, PosteriorSettings, SinglePosterior
from skdgp.kernels import (
    LinearPaths,
    MultiOutputKernel,
    PathBundle,
    independent_processes,
    prior_paths,
)


@dataclass(frozen=True)
class ErrorSettings:
    """How errors of a function are found in the residuals of a time series."""

    #: Blocks of the time series; errors of different blocks are taken as independent
    n_blocks: int = 60
    #: Fewest samples in a block
    block_rows: int = 10
    #: Fewest autocorrelation times of the errors in a block, if ``fewest_blocks`` remain
    block_times: float = 4.0
    #: At least so many blocks
    fewest_blocks: int = 12
    #: Fewest samples for each weight of a line
    fewest: int = 10
    #: Delays of the instruments, in autocorrelation times of the errors
    delays: tuple[int, ...] = (2, 4, 6)
    #: F statistic of the first stage below which instruments are weak (Staiger & Stock 1997)
    least_f: float = 10.0
    #: Fraction of the largest eigenvalue below which instruments count as equal
    singular: float = 1e-10

    def inverse(self, M: Matrix) -> Matrix:
        """Return the inverse of a symmetric matrix, without directions that are nearly singular."""
        inverse: Any = np.linalg.pinv(M, rcond=self.singular, hermitian=True)
        return inverse


SETTINGS = ErrorSettings()


class FunctionErrors(NamedTuple):
    """A random function of d regressors: linear terms, and the discrepancy of each of P outputs."""

    #: w of errors that are correlated in time and between outputs, (K, d + 1, P)
    random: Array
    #: w of biases by gusts that move the aircraft and by noise of the regressors, (K', d + 1, P)
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
        return linear_basis(X - self.centre) @ self.weights

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
        return linear + prior_paths(self.kernel, n_paths, PosteriorSettings.frequencies, rng)

    def parts(self, X: Matrix) -> list[tuple[Array, Array]]:
        """Return values (n, P, k) and slopes (n, P, d, k) of random errors and of biases at X (n, d)."""
        Q = linear_basis(X - self.centre)
        parts = []
        for weights, slopes in zip((self.random, self.method), self.slopes(), strict=True):
            values = np.moveaxis(Q @ weights, 0, -1)
            parts.append((values, np.broadcast_to(slopes, (len(X), *slopes.shape))))
        return parts

    def slopes(self) -> tuple[Array, Array]:
        """Return the slopes of random errors and of biases, (P, d, K) and (P, d, K')."""
        random, bias = self.random[:, 1:], self.method[:, 1:]
        return np.transpose(random, (2, 1, 0)), np.transpose(bias, (2, 1, 0))

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


class PosteriorWithErrors(Posterior):
    """A posterior plus independent errors of its function.

    Mean, kernel, noise, likelihood, data and components are the posterior's.

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

    @property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""
        return self.posterior.mean_function

    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        if not return_variance:
            return self.posterior.predict(Xs)
        mean, variance = self.posterior.predict(Xs, return_variance=True)
        return mean, variance + self.errors.variance(Xs)

    def gradient(self, Xs: Matrix, spread: Vector | None = None) -> Array:
        """Return d mean / d x at Xs, (n, P, d), or expected over each regressor alone with ``spread`` (d,)."""
        return self.posterior.gradient(Xs, spread)

    def covariance(self, Xs: Matrix) -> Matrix:
        """Return the joint covariance at Xs, (P n, P n), output-major."""
        return self.posterior.covariance(Xs) + self.errors.covariance(Xs)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples that are functions of the regressors."""
        rng = check_random_state(random_state)
        return self.posterior.paths(n_paths, rng) + self.errors.paths(n_paths, rng)


def no_errors(data: Data) -> FunctionErrors:
    """Return errors of a function that are zero."""
    P, centre = len(data.y), max(data.X, key=len).mean(axis=0)
    nothing = np.zeros((0, len(centre) + 1, P))
    return FunctionErrors(nothing, nothing, centre, np.zeros(P), np.ones_like(centre))


# equations of a hundred terms: on two threads they take several times as long on a busy machine
@one_blas_thread()
def function_errors(
    posterior: Posterior,
    discrepancy: Vector,
    input_std: Vector | None = None,
    flight: Vector | None = None,
    settings: ErrorSettings = SETTINGS,
) -> FunctionErrors:
    r"""Return the errors of a posterior's function that it does not include, from its time series.

    With the residuals r of the posterior's mean, Q = (1, x - c) and :math:`G = (Q^T Q)^{-1}`:

    - random: over blocks b of consecutive samples, :math:`w_b = G Q_b^T r_b`, whatever the
      correlation within a block and between outputs (Liang & Zeger 1986), as far as their variance
      exceeds the white noise that the posterior holds;
    - gusts that move the aircraft bias slopes. Instruments, which are earlier regressors, find
      k slopes d of the residuals, with standard deviations s; weak ones find none. With
      :math:`\chi^2 = \sum d^2 / s^2`, which is k by chance, these count as
      :math:`d \sqrt{1 - k / \chi^2}`;
    - noise of the regressors with the covariance :math:`S = \mathrm{diag}(s_k^2)` flattens slopes J
      of regressors with the covariance C by :math:`C^{-1} S J` (Fuller 1987, section 1.1). It
      counts by one number for each regressor.

    With too few samples only the discrepancy is returned.

    Parameters
    ----------
    posterior : Posterior
        Its samples are in the order of recording.
    discrepancy : ndarray (P,)
        Variance of the discrepancy.
    input_std : ndarray (d,) or None
        Standard deviations of the noise of the regressors.
    flight : ndarray (n,) or None
        Number of the flight of each sample. No block and no instrument crosses the end of one.
        None: one flight.
    settings : ErrorSettings

    Returns
    -------
    FunctionErrors
    """
    data = posterior.data
    longest = max(data.X, key=len)
    centre = longest.mean(axis=0)
    scale = column_scale(longest)
    errors = no_errors(data)._replace(
        discrepancy=np.asarray(discrepancy, dtype=float), length_scale=scale
    )
    if min(map(len, data.y)) < settings.fewest * (len(centre) + 1):
        return errors

    series = _output_series(posterior, flight, centre, scale, settings)
    slopes = posterior.gradient(centre[None])[0]
    unit = np.append(1.0, scale)[:, None]  # of the weights of Q
    correlated = correlated_errors(series, mean_noise(posterior), settings) / unit
    gusts = gust_errors(series, settings) / unit
    flattened = attenuation(data.X, input_std, slopes, settings)
    return errors._replace(random=correlated, method=np.concatenate([gusts, flattened]))


class OutputSeries(NamedTuple):
    """The observed values of one output, n rows in the order of recording."""

    Q: Matrix  #: Terms of a line, (1, (x - c) / scale), (n, d + 1)
    residual: Vector  #: Observed value less the mean, (n,)
    records: list[Indices]  #: Rows of each flight
    blocks: list[Indices]  #: Rows of each block


def _output_series(
    posterior: Posterior,
    flight: Vector | None,
    centre: Vector,
    scale: Vector,
    settings: ErrorSettings,
) -> list[OutputSeries]:
    """Return the time series of each output; blocks and records are of the same samples for all."""
    data = posterior.data
    samples = data.sample or [np.arange(len(y)) for y in data.y]
    records = _records(samples, flight)
    means = [posterior.predict(x)[:, i] for i, x in enumerate(data.X)]
    residuals = list(map(np.subtract, data.y, means))
    parts = blocks(records, max(map(autocorrelation_time, residuals)), settings)
    series = []
    for x, residual, sample in zip(data.X, residuals, samples, strict=True):
        Q = linear_basis((x - centre) / scale)
        of_records = [_places(sample, rows) for rows in records]
        of_blocks = [_places(sample, rows) for rows in parts]
        series.append(OutputSeries(Q, residual, of_records, of_blocks))
    return series


def correlated_errors(
    series: Sequence[OutputSeries], noise: Vector, settings: ErrorSettings
) -> Array:
    """Return the errors of the weights by block, beyond those of white noise (P,), (n_blocks, d + 1, P)."""
    errors = []
    for output, variance in zip(series, noise, strict=True):
        of_blocks = block_errors(output.Q, output.residual, output.blocks, settings)
        white = white_variance(output.Q, variance, settings)
        errors.append(without_variance(of_blocks, white))
    return np.stack(errors, axis=-1)


def gust_errors(series: Sequence[OutputSeries], settings: ErrorSettings) -> Array:
    """Return the slopes that instruments find in the residuals, beyond chance, (1, d + 1, P)."""
    biases = [_gust_bias(output, settings) for output in series]
    return np.stack(biases, axis=-1)[None]


def attenuation(
    X: Sequence[Matrix], input_std: Vector | None, slopes: Matrix, settings: ErrorSettings
) -> Array:
    """Return how far noise of each regressor flattens each slope (P, d) of each output, (d, d + 1, P)."""
    P, d = slopes.shape
    flattened = np.zeros((d, d + 1, P))
    if input_std is not None:
        for i, x in enumerate(X):
            inverse = settings.inverse(np.atleast_2d(np.cov(x.T)))
            flattened[:, 1:, i] = inverse * (input_std**2 * slopes[i])[:, None]
    return flattened


def _gust_bias(output: OutputSeries, settings: ErrorSettings) -> Vector:
    """Return the slopes that instruments find in the residuals, beyond chance, and zero for the constant, (m,)."""
    change, scatter, is_determined = instrumental_weights(
        output.Q, output.residual, output.records, settings
    )
    is_determined[0] = False
    variance = np.sum(scatter**2, axis=0)
    squares = np.divide(change**2, variance, out=np.zeros_like(change), where=variance > 0)
    chi_squared = np.sum(squares * is_determined)
    beyond_chance = np.maximum(chi_squared - is_determined.sum(), 0.0)
    fraction = beyond_chance / chi_squared if chi_squared > 0 else 0.0
    return change * np.sqrt(fraction) * is_determined


def _records(sample: Sequence[Indices], flight: Vector | None) -> list[Indices]:
    """Return the samples of each flight that any output has."""
    samples = np.unique(np.concatenate(sample))
    codes = np.zeros(len(samples)) if flight is None else flight[samples]
    return [samples[codes == code] for code in np.unique(codes)]


def _places(sample: Indices, rows: Indices) -> Indices:
    """Return where the ``rows`` stand among the samples of an output, both in order."""
    return np.flatnonzero(np.isin(sample, rows, assume_unique=True))


def white_variance(Q: Matrix, noise: float, settings: ErrorSettings) -> Vector:
    """Return the variance of the weights of least squares, (m,), for white noise of this variance."""
    return noise * np.diag(settings.inverse(Q.T @ Q))


def without_variance(errors: Matrix, variance: Vector) -> Matrix:
    """Return errors (k, m) that are smaller, so that the sum of their squares is less by a ``variance`` (m,)."""
    total = np.sum(errors**2, axis=0)
    remaining = np.maximum(total - variance, 0.0)
    fraction = np.divide(remaining, total, out=np.zeros_like(total), where=total > 0)
    return errors * np.sqrt(fraction)


def linear_basis(x: Array) -> Array:
    """Return (1, x), (..., d + 1), for x (..., d)."""
    return np.concatenate([np.ones((*x.shape[:-1], 1)), x], axis=-1)


def blocks(
    records: Sequence[Indices], lasting: float = 1.0, settings: ErrorSettings = SETTINGS
) -> list[Indices]:
    """Return blocks of consecutive samples of the records, about 60, fewer where errors are ``lasting`` [samples]."""
    n = sum(map(len, records))
    longer = min(settings.block_times * lasting, n / settings.fewest_blocks)
    length = max(n / settings.n_blocks, settings.block_rows, longer)
    parts: list[Indices] = []
    for rows in records:
        parts += np.array_split(rows, max(1, int(len(rows) / length)))
    if len(parts) == 1:  # a scatter needs two
        parts = np.array_split(parts[0], 2)
    return parts


def block_errors(
    Q: Matrix,
    residual: Vector,
    parts: Sequence[Indices],
    settings: ErrorSettings = SETTINGS,
    inverse: Matrix | None = None,
) -> Matrix:
    """Return errors of the weights of least squares by block, (n_blocks, m), for terms Q (n, m).

    ``parts`` are the places of the rows of each block. ``inverse`` (m, m) is by default the inverse
    of Q^T Q.
    """
    if inverse is None:
        inverse = settings.inverse(Q.T @ Q)
    scores = np.array([Q[rows].T @ residual[rows] for rows in parts])
    n_blocks = max(sum(len(rows) > 0 for rows in parts), 2)
    return scores @ inverse.T * np.sqrt(n_blocks / (n_blocks - 1))


def instrumental_weights(
    Q: Matrix, y: Vector, records: Sequence[Indices], settings: ErrorSettings = SETTINGS
) -> tuple[Vector, Matrix, Mask]:
    """Return weights (m,) of y (n,) by two-stage least squares, their errors, and whether they are determined.

    Errors are by block, (n_blocks, m). Instruments are earlier rows of the terms Q (n, m) in the
    same record, by more than the errors ``y`` of least squares last (Soderstrom & Stoica 1989,
    section 8.1). An error that causes motion, such as a gust, correlates with present regressors
    and so biases least squares. Part of the bias remains, the more the longer gusts last.
    """
    lag = _instrument_lag(y, records, settings)
    present, delayed = delayed_rows(records, lag, settings.delays)
    if not present:
        m = Q.shape[1]
        return np.zeros(m), np.zeros((2, m)), np.zeros(m, bool)
    Z = np.hstack([Q[rows] for rows in delayed])
    rows = np.concatenate(present)
    Q = Q[rows]
    y = y[rows]
    weights, fitted, inverse = two_stage_least_squares(Q, Z, y, settings)
    of_records = [np.arange(place.start, place.stop) for place in consecutive(present)]
    parts = blocks(of_records, settings=settings)
    errors = block_errors(fitted, y - Q @ weights, parts, settings, inverse)
    n_independent = len(Q) / max(lag, 1)
    return weights, errors, determined_by_instruments(Q, inverse, n_independent, settings)


def _instrument_lag(y: Vector, records: Sequence[Indices], settings: ErrorSettings) -> int:
    """Return the autocorrelation time of y [samples]; the longest delay is at most half of the samples."""
    lasting = [autocorrelation_time(y[rows]) * len(rows) for rows in records if len(rows)]
    return min(round(sum(lasting) / len(y)), len(y) // (2 * settings.delays[-1]))


def delayed_rows(
    records: Sequence[Indices], lag: int, delays: Sequence[int]
) -> tuple[list[Indices], list[Indices]]:
    """Return the rows of each record that have a row before them by all delays [lags], and those by each delay."""
    first = lag * delays[-1]
    long = [rows for rows in records if len(rows) > first]
    if not long:
        return [], []
    delayed = []
    for shift in lag * np.array(delays):
        earlier = [rows[first - shift : len(rows) - shift] for rows in long]
        delayed.append(np.concatenate(earlier))
    return [rows[first:] for rows in long], delayed


def two_stage_least_squares(
    Q: Matrix, Z: Matrix, y: Vector, settings: ErrorSettings
) -> tuple[Vector, Matrix, Matrix]:
    r"""Return weights (m,) of y (n,) in the terms Q (n, m), with instruments Z (n, k).

    The first stage is the part of the terms that instruments explain, the second their weights,

    .. math:: \hat Q = Z (Z^T Z)^{-1} Z^T Q, \quad w = (\hat Q^T Q)^{-1} \hat Q^T y.

    :math:`\hat Q` (n, m) and :math:`(\hat Q^T Q)^{-1}` (m, m) follow the weights.
    """
    between = settings.inverse(Z.T @ Z)
    fitted = Z @ (between @ (Z.T @ Q))
    inverse = settings.inverse(fitted.T @ Q)
    return inverse @ (fitted.T @ y), fitted, inverse


def determined_by_instruments(
    Q: Matrix, inverse: Matrix, count: float, settings: ErrorSettings
) -> Mask:
    r"""Return the terms Q (n, m) whose weights by two-stage least squares instruments determine, (m,).

    The partial R^2 of a term (Shea 1997) is the variance of its weight by least squares over that by
    two-stage least squares, ``inverse`` (m, m). With N independent samples, ``count``, and k
    delays of the instruments,

    .. math:: F = \frac{R^2}{1 - R^2} \frac{N}{k}.

    Of weaker instruments weights are nearly arbitrary, and so are their standard deviations.
    """
    of_least_squares = np.diag(settings.inverse(Q.T @ Q))
    of_two_stages = np.diag(inverse)
    explained = np.zeros(len(inverse))
    np.divide(of_least_squares, of_two_stages, out=explained, where=of_two_stages > 0)
    explained = np.clip(explained, 0.0, 1 - settings.singular)
    statistic = explained / (1 - explained) * count / len(settings.delays)
    return statistic >= settings.least_f


def mean_noise(posterior: Posterior) -> Vector:
    """Return the harmonic mean of the noise variances of the values of each output, (P,).

    It includes noise of the regressors, and the inflation of correlated noise by a sparse
    posterior.
    """
    data = posterior.data
    members = np.array([member.noise for member in posterior.members])
    white = np.sum(posterior.mixture * members, axis=0)
    if data.sample_noise is None:
        return white
    means = []
    for variance, loading in zip(white, data.sample_noise.loading, strict=True):
        of_values = variance + np.sum(loading**2, axis=1)
        means.append(1 / np.mean(1 / of_values))
    return np.array(means)
