"""Errors of slopes and values that the deviations of a posterior do not contain, estimated from polynomials.

Errors of neighbouring samples and of different outputs are correlated, widths may be wrong, gusts
flatten slopes and correlate errors with rates. Polynomials show how large such errors are: with
past regressors as instruments, which correlate less with the present error; with third powers,
since a smooth prior and polynomials of second order find too small a slope at the trim of a
function that saturates on both sides; and with the residuals of the outputs, which bound the noise
of each regressor.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale
from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.statistics import autocorrelation_time
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import Posterior

BLOCKS = 60  # blocks of the log; errors of different blocks are taken as independent
BLOCK_ROWS = 10  # fewest samples in a block
FEWEST, FEWEST_INSTRUMENTED = (
    10,
    50,
)  # smallest number of samples for each weight of a polynomial, with instruments
DELAYS = (2, 4, 6)  # of the regressors that are instruments, in autocorrelation times of the errors
SINGULAR = 1e-10  # share of the largest eigenvalue below which instruments count as equal


class SlopeErrors(NamedTuple):
    """Errors of slopes at points (n, d): sums of the last axis times independent standard normal numbers."""

    #: By noise that is correlated between samples and between outputs, (n, P, d, n_blocks)
    random: Array
    #: By instruments, by third powers, by the noise of each regressor, (n, P, d, 2 + d)
    method: Array
    #: Deviation of ``random`` if errors of samples were independent, (n, P, d)
    white: Array
    n_samples: int

    def scaled(self, factor: Array) -> SlopeErrors:
        """Return the errors of slopes times ``factor``, which broadcasts to (n, P, d)."""
        factor = np.asarray(factor)
        random, method = (part * factor[..., None] for part in (self.random, self.method))
        return SlopeErrors(random, method, self.white * factor, self.n_samples)

    def take(self, outputs: Any) -> SlopeErrors:
        """Return the errors of some outputs."""
        return SlopeErrors(
            self.random[:, outputs], self.method[:, outputs], self.white[:, outputs], self.n_samples
        )


class FunctionErrors(NamedTuple):
    """Errors of a function by noise that is correlated between samples and between outputs.

    They are polynomials of second order, one for each block of the log. An error of the function is
    their sum, times independent standard normal numbers.
    """

    #: Of the terms of each polynomial of (X - centre) / scale, (k, n_terms, P)
    weights: Array
    centre: Vector
    scale: Vector

    def __call__(self, X: Array) -> Array:
        """Return the values (k, n, P) of each polynomial at its own points X (k, n, d)."""
        return _parabola((X - self.centre) / self.scale) @ self.weights

    def gradient(self, X: Array) -> Array:
        """Return the slopes (k, n, P, d) of each polynomial at its own points X (k, n, d)."""
        slopes = _slopes_of(_parabola, (X - self.centre) / self.scale) @ self.weights[:, None]
        return np.swapaxes(slopes, -1, -2) / self.scale

    def draw(self, n_paths: int, random_state: Seed) -> FunctionErrors:
        """Return draws of the error, as polynomials (n_paths, n_terms, P)."""
        seed = check_random_state(random_state).randint(
            2**31 - 1, size=7
        )  # other numbers than in the paths
        normal = np.random.default_rng(seed).standard_normal((n_paths, len(self.weights)))
        return self._replace(weights=np.tensordot(normal, self.weights, axes=1))

    def in_units(self, shift: Vector, scale: Vector, outputs: Any) -> FunctionErrors:
        """Return the errors of some outputs as a function of ``shift + scale`` times the regressors."""
        return FunctionErrors(
            self.weights[..., outputs], shift + scale * self.centre, scale * self.scale
        )


# equations of a hundred terms: on two threads they take several times as long on a busy machine
@one_blas_thread()
def function_errors(posterior: Posterior) -> FunctionErrors | None:
    """Return the errors of the function of a posterior, or None if there are too few samples: see `slope_errors`."""
    data = posterior.data
    centre, scale = data.X[0].mean(axis=0), column_scale(data.X[0])
    weights = np.zeros((BLOCKS, _parabola(data.X[0][:1]).shape[1], len(data.y)))
    for k, (x, y) in enumerate(zip(data.X, data.y, strict=True)):
        basis = _basis_for(len(x), x.shape[1])
        if basis is None:
            return None
        errors = _Polynomial(
            basis, (x - centre) / scale, y
        ).errors  # a line has the first terms of a parabola
        weights[: len(errors), : errors.shape[1], k] = errors
    return FunctionErrors(weights, centre, scale)


@one_blas_thread()
def slope_errors(
    posterior: Posterior, X: Matrix, added: Matrix | None = None
) -> SlopeErrors | None:
    r"""Return the errors of the slopes of a posterior at X (n, d), or None if there are too few samples.

    The polynomial of all samples has the weights :math:`w = G \sum_b Q_b^T y_b` with blocks b of
    consecutive samples and :math:`G = (\sum_b Q_b^T Q_b)^{-1}`. With residuals r its error is a sum
    over blocks of :math:`G Q_b^T r_b`, whatever the correlation within a block and between outputs
    (Liang & Zeger 1986).

    A slope by instruments, of standard deviation s, differs by d. It counts as :math:`d |d| /
    \sqrt{d^2 + s^2}`: as d where it is much larger than s, and as .8 s in root mean square where it
    is only chance. What instruments do not determine, least squares does.

    Noise in a regressor flattens the slopes w of least squares. The same noise is in the residuals
    of all outputs, which have the covariance :math:`\Sigma`. With p, the variance of the regressor
    that the others do not explain, it can be no more than what leaves :math:`\Sigma` positive
    definite, so true slopes lie between w and w + g:

    .. math:: g = \frac{w}{p\, w^T \Sigma^{-1} w}

    (bounds by direct and reverse regression: Frisch 1934; Klepper & Leamer 1984). Its error is
    :math:`g / \sqrt 3`, the root mean square of a value anywhere between. Slopes by other
    regressors follow as the weights correlate.

    With the regressors ``added`` (k, d) of rows that may be flown next, errors are those expected
    after them: their targets are the means of the posterior and the residuals of the samples.
    """
    data = posterior.data
    if added is not None:
        data = _extended(data, posterior, added)
    parts = [_of_output(x, y, X) for x, y in zip(data.X, data.y, strict=True)]
    if any(part is None for part in parts):
        return None
    polynomials, errors, white, fits, rests, slopes = zip(*parts, strict=True)
    n_blocks = max(error.shape[-1] for error in errors)
    random = [np.pad(error, [(0, 0), (0, 0), (0, n_blocks - error.shape[-1])]) for error in errors]
    instrumented, std, third = np.moveaxis(np.stack(polynomials, axis=1), -1, 0)
    if added is None:
        gradient = posterior.gradient(X)
    else:
        pairs = zip(slopes, fits, strict=True)
        gradient = np.stack([terms @ fit.weights for terms, fit in pairs], axis=1)
    flat = gradient - instrumented
    share = np.divide(np.abs(flat), np.hypot(flat, std), out=np.zeros_like(flat), where=flat != 0)
    noisy = [
        D @ moved for D, moved in zip(slopes, _noise_of_regressors(data, fits, rests), strict=True)
    ]
    method = np.concatenate(
        [np.stack([flat * share, third / np.sqrt(2)], axis=-1), np.stack(noisy, axis=1)], axis=-1
    )
    return SlopeErrors(
        np.stack(random, axis=1), method, np.stack(white, axis=1), max(map(len, data.y))
    )


def _extended(data: Data, posterior: Posterior, added: Matrix) -> Data:
    """Return the data with the rows ``added``, which take the residuals of the data in their order."""
    means = posterior.predict(added)
    targets = []
    for k, (x, y) in enumerate(zip(data.X, data.y, strict=True)):
        residuals = y - posterior.predict(x)[:, k]
        targets.append(np.concatenate([y, means[:, k] + np.resize(residuals, len(added))]))
    return Data([np.concatenate([x, added]) for x in data.X], targets)


def _of_output(x, y, X):
    """Return slopes (n, d, 3), the error (n, d, n_blocks) of the polynomial of all samples, its white std.

    The slopes are by instruments, their standard deviation, and the change of the slopes of all
    samples by third powers. Last come the polynomial of all samples, its residuals, and the
    slopes (n, d, n_terms) of its terms.
    """
    basis = _basis_for(len(x), x.shape[1])
    if basis is None:
        return None
    centre, scale = x.mean(axis=0), column_scale(x)
    z, at = (x - centre) / scale, (X - centre) / scale
    every, Q = _Polynomial(basis, z, y), basis(z)
    rest = (
        y - Q @ every.weights
    )  # without instruments that determine them, slopes come from all samples
    few = _basis_for(len(x), x.shape[1], FEWEST_INSTRUMENTED) or _line
    change, scatter = _instrumented(few(z), rest)
    std = np.linalg.norm(_slopes_of(few, at) @ scatter.T, axis=-1)
    instrumented = _slopes_of(basis, at) @ every.weights + _slopes_of(few, at) @ change
    slopes = np.stack([instrumented, std, _third(basis, z, rest, at)], axis=-1)
    error, white = every.error(at)
    terms = _slopes_of(basis, at) / scale[:, None]
    return slopes / scale[:, None], error / scale[:, None], white / scale, every, rest, terms


def _noise_of_regressors(data, fits, rests):
    """Return by how much noise of each regressor may change the weights of each output, (n_terms, d)."""
    linear = slice(1, data.X[0].shape[1] + 1)
    weights = np.array([fit.weights[linear] for fit in fits])
    least = SINGULAR * np.array([y @ y for y in data.y])
    if all(np.array_equal(x, data.X[0]) for x in data.X):
        covariance = np.array(rests) @ np.transpose(rests) + np.diag(least)
        strength = np.einsum(
            "ik,ij,jk->k", weights, np.linalg.pinv(covariance, hermitian=True), weights
        )
    else:  # each output bounds the noise by itself
        squares = least + [rest @ rest for rest in rests]
        strength = np.max(
            np.divide(weights.T**2, squares, out=np.zeros(weights.T.shape), where=squares > 0),
            axis=1,
        )
    g = np.divide(
        weights, strength, out=np.zeros_like(weights), where=strength > 0
    )  # times 1 / (n p)
    return [fit.inverse[:, linear] * one / np.sqrt(3) for fit, one in zip(fits, g, strict=True)]


def _third(basis, z, rest, at):
    """Return the change of the slopes (n, d) by third powers of the regressors, from the residuals of a polynomial."""
    Q, d = np.column_stack([basis(z), z**3]), z.shape[1]
    weights = np.linalg.pinv(Q.T @ Q, rcond=SINGULAR, hermitian=True) @ (Q.T @ rest)
    return _slopes_of(basis, at) @ weights[:-d] + 3 * at**2 * weights[-d:]


def _basis_for(n, d, fewest=FEWEST):
    """Return the highest order of polynomials of d regressors with ``fewest`` samples for each weight, or None."""
    sizes = {_parabola: 1 + d + d * (d + 1) // 2, _line: 1 + d}
    return next((basis for basis, size in sizes.items() if n >= fewest * size), None)


def _instrumented(Q, y):
    """Return weights (m,) of y (n,) by two-stage least squares, and their errors by block, (n_blocks, m).

    Instruments are earlier rows of the terms Q (n, m), by more than the errors ``y`` of least
    squares last (Soderstrom & Stoica 1989, section 8.1): an error that causes motion, such as that
    of a gust, correlates with present regressors, and so biases least squares. Part of the bias
    remains, the more the longer gusts last: least squares hides some gusts, and past gusts have
    moved the instruments.
    """
    lag = min(round(autocorrelation_time(y)), len(y) // (2 * DELAYS[-1]))
    first = lag * DELAYS[-1]
    past, now, y = (
        [Q[first - lag * delay : len(Q) - lag * delay] for delay in DELAYS],
        Q[first:],
        y[first:],
    )
    between = np.block([[one.T @ other for other in past] for one in past])
    by_past = np.linalg.pinv(between, rcond=SINGULAR, hermitian=True) @ np.vstack(
        [one.T @ now for one in past]
    )
    expected = sum(one @ part for one, part in zip(past, np.split(by_past, len(past)), strict=True))
    inverse = np.linalg.pinv(expected.T @ now, rcond=SINGULAR, hermitian=True)
    weights = inverse @ (expected.T @ y)
    rest = y - now @ weights
    scores = np.array([expected[rows].T @ rest[rows] for rows in _blocks(len(y))])
    return weights, _errors(scores, inverse)


def _blocks(n):
    """Return the rows of blocks of consecutive samples."""
    return np.array_split(np.arange(n), int(np.clip(n // BLOCK_ROWS, 2, BLOCKS)))


def _errors(scores, inverse):
    """Return the errors of weights by block (n_blocks, m), from sums over its terms times residuals."""
    return scores @ inverse * np.sqrt(len(scores) / (len(scores) - 1))


class _Polynomial:
    """Least squares in a basis, from sums over blocks of consecutive samples."""

    def __init__(self, basis: Any, z: Matrix, y: Array) -> None:
        self.basis = basis
        sums = [
            (Q.T @ Q, Q.T @ y[rows], y[rows] @ y[rows])
            for rows in _blocks(len(y))
            for Q in [basis(z[rows])]
        ]
        self.outer, self.inner, square = (np.array(part) for part in zip(*sums, strict=True))
        self.inverse = np.linalg.pinv(self.outer.sum(axis=0), hermitian=True)
        self.weights = self.inverse @ self.inner.sum(axis=0)
        left = square.sum() - self.weights @ self.inner.sum(axis=0)
        self.variance = max(float(left), 0.0) / max(len(y) - len(self.weights), 1)
        self.errors = _errors(
            self.inner - self.outer @ self.weights, self.inverse
        )  # of the weights, by block

    def error(self, at: Matrix) -> tuple[Array, Array]:
        """Return the error of the slopes (n, d, n_blocks), and its deviation (n, d) if samples were independent."""
        D = _slopes_of(self.basis, at) @ self.inverse
        white = np.sqrt(self.variance * np.einsum("nkp,pq,nkq->nk", D, self.outer.sum(axis=0), D))
        return _slopes_of(self.basis, at) @ self.errors.T, white


def _line(z):
    return np.concatenate([np.ones((*z.shape[:-1], 1)), z], axis=-1)


def _parabola(z):
    first, second = _products(z.shape[-1])
    return np.concatenate([_line(z), z[..., first] * z[..., second]], axis=-1)


_products = cache(np.triu_indices)  # a simulation asks in every step


def _slopes_of(basis, at):
    """Return d basis / d z at points (..., d), (..., d, p): differences, which are exact up to second order."""
    change = [basis(at + step) - basis(at - step) for step in np.eye(at.shape[-1])]
    return 0.5 * np.stack(change, axis=-2)


class KnownSlopes(NamedTuple):
    """Slopes of P outputs by d regressors, NaN where the samples are to tell them.

    Samples whose regressors were estimated from their own targets, as an angle of attack from the
    force that it causes, are no evidence of slopes: least squares is biased, and its bands are too
    narrow.
    """

    value: Matrix  # (P, d)
    errors: Array  # (P, d, k), sums of the last axis times independent standard normal numbers

    @classmethod
    def of_samples(cls, X: Matrix, Y: Matrix, deviations: Matrix) -> KnownSlopes:
        """Return the slopes of least squares with standard ``deviations`` (P, d), where these are finite.

        Rows of X (n, d) and Y (n, P) with missing values are left out.
        """
        value, complete = np.empty_like(deviations), np.isfinite(X).all(axis=1)
        for y, slopes in zip(np.asarray(Y, dtype=float).T, value, strict=True):
            rows = np.isfinite(y) & complete
            centred = X[rows] - X[rows].mean(axis=0)
            slopes[:] = np.linalg.lstsq(centred, y[rows] - y[rows].mean(), rcond=None)[0]
        value[~np.isfinite(deviations)] = np.nan
        errors = np.zeros((*value.shape, value.size))
        np.einsum("pdpd->pd", errors.reshape(*value.shape, *value.shape))[:] = np.nan_to_num(
            deviations
        )
        return cls(value, errors)

    @property
    def known(self) -> Array:
        """Whether a slope is known, (P, d, 1)."""
        return np.isfinite(self.value)[..., None]

    def scaled(self, factor: Array) -> KnownSlopes:
        """Return the slopes times ``factor``, which broadcasts to (P, d)."""
        return KnownSlopes(self.value * factor, self.errors * np.asarray(factor)[..., None])

    def corrected(self, X: Matrix, Y: Matrix) -> Matrix:
        """Return Y (n, P) plus what makes its slopes by least squares at X (n, d) the known ones."""
        Y, centred = Y.copy(), X - X.mean(axis=0)
        for y, value in zip(Y.T, self.value, strict=True):
            rows, known = np.isfinite(y), np.isfinite(value)
            Q = np.column_stack([np.ones(rows.sum()), centred[rows]])
            wanted = np.zeros(1 + len(value))
            wanted[1:][known] = value[known]
            free = np.append(True, ~known)
            residual = y[rows] - Q @ wanted
            wanted[free] = np.linalg.lstsq(Q[:, free], residual, rcond=None)[0]
            residual = y[rows] - Q @ wanted
            y[rows] -= Q @ np.linalg.lstsq(Q, residual, rcond=None)[0]
        return Y

    def applied(self, slope_errors: SlopeErrors, ratio: Array) -> SlopeErrors:
        """Return the errors of slopes (n, P, d), with the errors of known slopes times ``ratio`` (n, P, d)."""
        errors = self.errors * ratio[..., None]
        random = np.concatenate([np.where(self.known, 0.0, slope_errors.random), errors], axis=-1)
        return slope_errors._replace(
            random=random, method=np.where(self.known, 0.0, slope_errors.method)
        )

    def added(self, function_errors: FunctionErrors) -> FunctionErrors:
        """Return the errors of a function, with the errors of its known slopes."""
        P, d, k = self.errors.shape
        weights = np.zeros((k, function_errors.weights.shape[1], P))
        weights[:, 1 : d + 1] = (
            np.transpose(self.errors, (2, 1, 0)) * function_errors.scale[:, None]
        )
        return function_errors._replace(weights=np.concatenate([function_errors.weights, weights]))
