"""Posteriors of one kernel: their interface, the exact one by one Cholesky factorisation, and sample paths.

A path is a sample of the prior plus a correction by the data. With f and u drawn jointly from the
prior, f + Kfu Kuu^-1 (u_post - u) has the mean and covariance of the posterior at all inputs
(Wilson et al. 2020, "Efficiently sampling functions from Gaussian process posteriors").
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    BlockFactor,
    consecutive,
    jittered_cholesky,
    triangular_solve,
    unexplained_variance,
)
from skdgp._compute.parallel import few_threads, thread_map, threads_for
from skdgp._compute.statistics import check_deviations
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, coupled_outputs, covariance, draw_noise
from skdgp.kernels import MultiOutputKernel, PathBundle, covariance_paths, prior_paths


@dataclass(frozen=True)
class PosteriorSettings:
    """How predictions are cut into batches, and how many waves paths have."""

    #: Working memory of one batch of predictions [bytes]
    chunk_bytes: int = 2**27
    #: Most samples in a batch: their covariances fit the cache
    rows: int = 512
    #: Waves of each latent process in each path
    frequencies: int = 64


class SinglePosterior(ABC):
    """A Gaussian process, given observed values.

    The mean of output i at Xs is A b, with the covariances A of its values and the variables that
    it is learned from, the observed values or the inducing variables.

    Attributes
    ----------
    kernel : MultiOutputKernel
    noise : ndarray (P,)
        Noise variance of each output.
    log_marginal_likelihood : float
        Or a lower bound on it.
    data : Data
        The observed values.
    """

    settings = PosteriorSettings()
    kernel: MultiOutputKernel
    noise: Vector
    log_marginal_likelihood: float
    data: Data

    @property
    @abstractmethod
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""

    @abstractmethod
    def covariance(self, Xs: Matrix) -> Matrix:
        """Return the joint covariance at Xs, (P n, P n), output-major."""

    @abstractmethod
    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples that are functions of the regressors."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of values or of inducing variables: the side of the largest matrix."""

    @abstractmethod
    def of(self, data: Data, noise: Vector) -> SinglePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""

    @abstractmethod
    def loading(self, i: int, Xs: Matrix) -> tuple[Array, Array]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""

    @abstractmethod
    def explained(self, i: int, A: Matrix) -> Array:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""

    @few_threads
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        if return_variance:
            return self._in_batches(self._moments, Xs, 1)
        (mean,) = self._in_batches(lambda X: [self.mean_function.values(X[None])[0]], Xs, 1)
        return mean

    @few_threads
    def gradient(self, Xs: Matrix, spread: Vector | None = None) -> Array:
        """Return d mean / d x at Xs, (n, P, d), or expected over each regressor alone with ``spread`` (d,)."""
        width = np.shape(Xs)[1]
        mean = self.mean_function

        def of_batch(X: Matrix) -> list[Array]:
            return [mean.slopes(X[None], spread)[0]]

        (slopes,) = self._in_batches(of_batch, Xs, width)
        return slopes

    def _moments(self, X):
        """Return mean and variance, (n, P) each."""
        mean, variance = np.empty((2, len(X), self.kernel.n_outputs))
        for i in range(self.kernel.n_outputs):
            A, b = self.loading(i, X)
            mean[:, i] = A @ b  # equation 17
            prior = self.kernel.block_diag(i, X)
            variance[:, i] = unexplained_variance(prior, self.explained(i, A))  # equation 18
        return mean, variance

    def _in_batches(self, function, Xs, width):
        """Return the arrays that a function of X returns, whose matrices hold ``width`` times A."""
        fitting = self.settings.chunk_bytes / (8 * width * max(self.size, 1))
        step = int(np.clip(fitting, 1, self.settings.rows))
        batches = [Xs[a : a + step] for a in range(0, max(len(Xs), 1), step)]
        return tuple(map(np.concatenate, zip(*thread_map(function, batches), strict=True)))


class ExactPosterior(SinglePosterior):
    """The posterior at fixed hyperparameters (equations 17 and 18).

    Parameters
    ----------
    kernel : MultiOutputKernel
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data

    Attributes
    ----------
    log_marginal_likelihood : float
    """

    def __init__(self, kernel: MultiOutputKernel, noise: Vector, data: Data) -> None:
        self.kernel = kernel
        self.noise = np.asarray(noise, dtype=float)
        self.data = data
        # equation 20
        constant = data.n_values * np.log(2 * np.pi)
        log_determinants = self.factor.log_determinant + constant
        squares = self._white @ self._white
        self.log_marginal_likelihood = -0.5 * float(squares + log_determinants)

    @property
    def size(self) -> int:
        """Number of values N."""
        return self.data.n_values

    @cached_property
    def factor(self) -> BlockFactor:
        """Cholesky factor of Kff + noise, a block for each group of dependent outputs.

        A loaded posterior computes it again. The result has the same bits for the same number of
        BLAS threads.
        """
        places = consecutive(self.data.y)
        rows, factors = [], []
        data = self.data.with_loadings()
        for outputs in coupled_outputs(self.kernel, data):
            of_outputs = [np.arange(places[i].start, places[i].stop) for i in outputs]
            rows.append(np.concatenate(of_outputs))
            part = data.of_outputs(outputs)
            with threads_for(part.n_values):
                assemble = partial(covariance, self.kernel, self.noise, part)
                factors.append(jittered_cholesky(assemble))
        return BlockFactor(rows, factors)

    @cached_property
    def _white(self):
        """L^-1 y."""
        with threads_for(self.size):
            return self.factor.solve(np.concatenate(self.data.y))

    @cached_property
    def alpha(self) -> np.ndarray:
        """K^-1 y of the stacked values, (N,)."""
        with threads_for(self.size):
            return self.factor.solve(self._white, transposed=True)

    def __getstate__(self):
        # A saved model holds the samples, not the factor: the file is about a hundred times smaller.
        not_saved = {"factor", "_white", "mean_function"}
        self.alpha  # noqa: B018 - computed now, so that a loaded model predicts means without it
        return {name: value for name, value in self.__dict__.items() if name not in not_saved}

    def of(self, data: Data, noise: Vector) -> ExactPosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""
        return ExactPosterior(self.kernel, noise, data)

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, N) and b (N,) such that the mean of output i at Xs is A b."""
        A = np.zeros((len(Xs), self.size))
        for j, (X, columns) in enumerate(zip(self.data.X, consecutive(self.data.y), strict=True)):
            if self.kernel.couples(i, j):
                A[:, columns] = self.kernel.block(i, j, Xs, X)
        return A, self.alpha

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, N), (n,)."""
        variance = np.zeros(len(A))
        for rows, L in zip(self.factor.rows, self.factor.factors, strict=True):
            part = A.T[rows]
            if part.any():  # else of outputs that are independent of i
                half = triangular_solve(L, part)
                variance += np.einsum("ab,ab->b", half, half)
        return variance

    # -- prediction
    # ------------------------------------------------------------------------------------

    @cached_property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""
        return covariance_paths(self.kernel, self.data.X, self.alpha[None])

    @few_threads
    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        A = np.vstack([self.loading(i, Xs)[0] for i in range(self.kernel.n_outputs)])
        half = self.factor.solve(A.T)
        return self.kernel(Xs) - half.T @ half

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples of the posterior, f + Kfy Kyy^-1 (y - f(X) - noise), that are functions of the regressors."""
        rng = check_random_state(random_state)
        data = self.data
        with threads_for(self.size):
            prior = prior_paths(self.kernel, n_paths, self.settings.frequencies, rng)
            points, row = np.unique(np.concatenate(data.X), axis=0, return_inverse=True)
            values = prior.values(points[None])
            f = []
            for i, place in enumerate(consecutive(data.X)):
                f.append(values[:, row.ravel()[place], i])
            noise = draw_noise(self.noise, data, n_paths, rng)
            residual = np.concatenate(data.y) - np.hstack(f) - noise
            half = self.factor.solve(np.array(residual.T, order="F"))
            weights = self.factor.solve(half, transposed=True)
            return prior + covariance_paths(self.kernel, data.X, weights.T)


class ExactTerm(ExactPosterior):
    """The posterior of one term of the kernel of an exact posterior, independent of the others a priori.

    With the covariance K_t of the term its mean is K_t(X*, X) K^-1 y, and its covariance
    K_t(X*, X*) - K_t(X*, X) K^-1 K_t(X, X*) (Duvenaud, Nickisch & Rasmussen 2011).
    """

    def __init__(self, whole: ExactPosterior, kernel: MultiOutputKernel) -> None:
        self.kernel = kernel
        self.noise = whole.noise
        self.data = whole.data
        self.log_marginal_likelihood = whole.log_marginal_likelihood
        self.factor = whole.factor
        self.alpha = whole.alpha


def check_spread(spread: Any, n_features: int) -> Vector:
    """Return the standard deviations of a perturbation of the regressors, (d,)."""
    expected = f"{n_features} finite numbers from 0 on: a standard deviation for each regressor"
    return check_deviations("spread", spread, n_features, expected)


class Paths:
    """Sample paths of the posterior, functions X (n, d) -> (n, P), that are evaluated together.

    ``paths(X)`` evaluates all paths at the same points, ``paths.each(X)`` each path at its own
    points, and ``paths.gradient(X)`` their slopes. Paths can be pickled. A path
    is a function: its value at a point does not depend on the other points or paths of a call, up
    to rounding.

    Parameters
    ----------
    bundle : PathBundle
    n_paths, n_features : int
    center, scale : ndarray (P,)
        Values are ``center`` + ``scale`` times the values of the bundle.
    single : bool
        Whether the axis of outputs is dropped.
    feature_names : sequence of str or None
        Expected column names of a DataFrame.
    """

    def __init__(
        self,
        bundle: PathBundle,
        n_paths: int,
        n_features: int,
        center: Vector,
        scale: Vector,
        single: bool,
        feature_names: Sequence[str] | None,
    ) -> None:
        self.bundle = bundle
        self.n_paths = n_paths
        self.n_features = n_features
        self.center = center
        self.scale = scale
        self.single = single
        self.feature_names = feature_names

    def __call__(self, X) -> np.ndarray:
        """Return the values of all paths at X (n, d), (n_paths, n, P), or (n_paths, n) for one-dimensional targets."""
        return self._values(self._check_points(X, 2)[None])

    def each(self, X: Matrix) -> np.ndarray:
        """Return the values of each path at its own points X (n_paths, n, d), in the shape of a call."""
        return self._values(self._check_points(X, 3))

    def gradient(self, X: Matrix, spread: Vector | None = None) -> np.ndarray:
        """Return the slopes of all paths at X (n, d), or of each path at its own points X (n_paths, n, d).

        The result is (n_paths, n, P, d), or (n_paths, n, d) for one-dimensional targets. With
        ``spread`` (d,) they are expectations over a normal perturbation of each regressor
        alone, as of ``predict_gradient``.
        """
        X = self._check_points(X, 3) if np.ndim(X) == 3 else self._check_points(X, 2)[None]
        if spread is not None:
            spread = check_spread(spread, self.n_features)
        with threads_for(X.shape[1]):
            slopes = self.bundle.slopes(X, spread)
            return self._squeeze(slopes * np.reshape(self.scale, (-1, 1)))

    def _values(self, X):
        with threads_for(X.shape[1]):
            values = self.bundle.values(X)
        values *= self.scale
        values += self.center
        return self._squeeze(values)

    def _check_points(self, X, ndim):
        names = getattr(X, "columns", None)
        expected = self.feature_names
        if names is not None and expected is not None and list(names) != list(expected):
            raise ValueError(
                f"Got X with the columns {list(names)}, but expected those of the fit, in their order: "
                f"{list(expected)}."
            )
        X = np.asarray(X, dtype=float)
        shape = (self.n_paths, "n", self.n_features)[-ndim:]
        wrong_paths = ndim == 3 and len(X) != self.n_paths
        if X.ndim != ndim or X.shape[-1] != self.n_features or wrong_paths:
            expected = ", ".join(map(str, shape))
            raise ValueError(
                f"Got X of shape {X.shape}, but expected ({expected}): a column for each regressor of the fit."
            )
        return X

    def _squeeze(self, values):
        return values[:, :, 0] if self.single else values
