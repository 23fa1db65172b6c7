"""Posteriors: their interface, the exact one by one Cholesky factorisation, and sample paths by Matheron's rule.

A path is a sample of the prior plus a correction by the data. With f and u drawn jointly from the
prior, f + Kfu Kuu^-1 (u_post - u) has the mean and covariance of the posterior at all inputs
(Wilson et al. 2020, "Efficiently sampling functions from Gaussian process posteriors").
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    consecutive,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
    unexplained_variance,
)
from skdgp._compute.parallel import few_threads, thread_map, threads_for
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, covariance, draw_noise
from skdgp.kernels import MultiOutputKernel, PathBundle, covariance_paths, prior_paths

CHUNK_BYTES = 2**27  # working memory of one batch of predictions
ROWS = 512  # largest number of samples in a batch: their covariances fit the cache


class Posterior(ABC):
    """The outputs, given their observed values: a Gaussian process, or a mixture of several, its components.

    Attributes
    ----------
    kernel : MultiOutputKernel
        Of all terms.
    noise : ndarray (P,)
        Noise variance of each output.
    log_marginal_likelihood : float
        Or a lower bound on it.
    data : Data
        The observed values.
    members : sequence of SinglePosterior
        The components of the mixture. The first has all terms.
    mixture : ndarray (K, P)
        The weight of each component, for each output.
    """

    kernel: MultiOutputKernel
    noise: Vector
    log_marginal_likelihood: float
    data: Data
    members: Sequence[SinglePosterior]
    mixture: Matrix

    @abstractmethod
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""

    @abstractmethod
    def gradient(self, Xs: Matrix) -> Array:
        """Return d mean / d x at Xs, (n, P, d)."""

    @abstractmethod
    def covariance(self, Xs: Matrix) -> Matrix:
        """Return the joint covariance at Xs, (P n, P n), output-major."""

    @abstractmethod
    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples that are functions of the regressors."""


class SinglePosterior(Posterior):
    """A Gaussian process: the only component of its mixture.

    The mean of output i at Xs is A b, with the covariances A of its values and the variables that
    it is learned from, the observed values or the inducing variables.
    """

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of values or of inducing variables: the side of the largest matrix."""

    @property
    def members(self) -> Sequence[SinglePosterior]:  # type: ignore[override]
        """The posterior itself."""
        return [self]

    @property
    def mixture(self) -> Matrix:  # type: ignore[override]
        """Ones, (1, P)."""
        return np.ones((1, self.kernel.n_outputs))

    @abstractmethod
    def of(self, data: Data, noise: Vector) -> SinglePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""

    def term(self, kernel: MultiOutputKernel) -> SinglePosterior:
        """Return the posterior of one term of the kernel, which is independent of the others a priori.

        With the covariance K_t of the term its mean is K_t(X*, X) K^-1 y, and its covariance
        K_t(X*, X*) - K_t(X*, X) K^-1 K_t(X, X*) (Duvenaud, Nickisch & Rasmussen 2011), with
        inducing variables likewise. ``predict``, ``covariance`` and ``gradient`` refer to the
        term, which ``self.kernel.term(regressors)`` gives.
        """
        new = object.__new__(type(self))
        vars(new).update(vars(self) | self._factors(kernel) | {"kernel": kernel})
        vars(new).pop("mean_function", None)
        return new

    @abstractmethod
    def _factors(self, kernel: MultiOutputKernel) -> dict[str, Any]:
        """Return the attributes of the posterior of a term that are computed from all terms."""

    @abstractmethod
    def loading(self, i: int, Xs: Matrix) -> tuple[Array, Array]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""

    @abstractmethod
    def explained(self, i: int, A: Matrix) -> Array:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""

    @property
    @abstractmethod
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""

    @few_threads
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""
        if not return_variance:
            return self._in_batches(lambda X: [self.mean_function.values(X[None])[0]], Xs, 1)[0]
        return self._in_batches(self._moments, Xs, 1)

    @few_threads
    def gradient(self, Xs: Matrix) -> Array:
        """Return d mean / d x at Xs, (n, P, d)."""
        return self._in_batches(
            lambda X: [self.mean_function.slopes(X[None])[0]], Xs, np.shape(Xs)[1]
        )[0]

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
        step = int(np.clip(CHUNK_BYTES / (8 * width * max(self.size, 1)), 1, ROWS))
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
        self.log_marginal_likelihood = -0.5 * (
            self._white @ self._white + log_determinant(self.L) + data.n_values * np.log(2 * np.pi)
        )

    @property
    def size(self) -> int:
        """Number of values N."""
        return self.data.n_values

    @cached_property
    def L(self) -> np.ndarray:
        """Cholesky factor of Kff + noise, (N, N), lower triangle. A loaded posterior computes it again.

        The result has the same bits for the same number of BLAS threads.
        """
        with threads_for(self.size):
            return jittered_cholesky(lambda: covariance(self.kernel, self.noise, self.data))

    @cached_property
    def _white(self):
        """L^-1 y."""
        with threads_for(self.size):
            return triangular_solve(self.L, np.concatenate(self.data.y))

    @cached_property
    def alpha(self) -> np.ndarray:
        """K^-1 y of the stacked values, (N,)."""
        with threads_for(self.size):
            return triangular_solve(self.L, self._white, transposed=True)

    def __getstate__(self):
        # A saved model holds the samples, not L: the file is about a hundred times smaller.
        not_saved = {"L", "_white", "mean_function"}
        self.alpha  # noqa: B018 - computed now, so that a loaded model predicts means without L
        return {name: value for name, value in self.__dict__.items() if name not in not_saved}

    def of(self, data: Data, noise: Vector) -> ExactPosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""
        return ExactPosterior(self.kernel, noise, data)

    def _factors(self, kernel: MultiOutputKernel) -> dict[str, Any]:
        return {"L": self.L, "alpha": self.alpha}

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, N) and b (N,) such that the mean of output i at Xs is A b."""
        blocks = [
            self.kernel.block(i, j, Xs, X)
            if self.kernel.couples(i, j)
            else np.zeros((len(Xs), len(X)))
            for j, X in enumerate(self.data.X)
        ]
        return np.hstack(blocks), self.alpha

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, N), (n,)."""
        half = triangular_solve(self.L, A.T)
        return np.einsum("ab,ab->b", half, half)

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
        half = triangular_solve(self.L, A.T)
        return self.kernel(Xs) - half.T @ half

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples of the posterior, f + Kfy Kyy^-1 (y - f(X) - noise), that are functions of the regressors."""
        rng, data = check_random_state(random_state), self.data
        with threads_for(self.size):
            prior = prior_paths(self.kernel, n_paths, FREQUENCIES, rng)
            points, row = np.unique(np.concatenate(data.X), axis=0, return_inverse=True)
            f = prior.values(points[None])
            places = enumerate(consecutive(data.X))
            f = np.hstack([f[:, row.ravel()[place], i] for i, place in places])
            residual = np.concatenate(data.y) - f - draw_noise(self.noise, data, n_paths, rng)
            half = triangular_solve(self.L, np.array(residual.T, order="F"))
            weights = triangular_solve(self.L, half, transposed=True)
            return prior + covariance_paths(self.kernel, data.X, weights.T)


FREQUENCIES = 64  # waves of each latent process in each path


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
        self.bundle, self.n_paths, self.n_features = bundle, n_paths, n_features
        self.center, self.scale, self.single, self.feature_names = (
            center,
            scale,
            single,
            feature_names,
        )

    def __call__(self, X) -> np.ndarray:
        """Return the values of all paths at X (n, d), (n_paths, n, P), or (n_paths, n) for one-dimensional targets."""
        return self._values(self._check_points(X, 2)[None])

    def each(self, X: Matrix) -> np.ndarray:
        """Return the values of each path at its own points X (n_paths, n, d), in the shape of a call."""
        return self._values(self._check_points(X, 3))

    def gradient(self, X: Matrix) -> np.ndarray:
        """Return the slopes of all paths at X (n, d), or of each path at its own points X (n_paths, n, d).

        The result is (n_paths, n, P, d), or (n_paths, n, d) for one-dimensional targets.
        """
        X = self._check_points(X, 3) if np.ndim(X) == 3 else self._check_points(X, 2)[None]
        with threads_for(X.shape[1]):
            return self._squeeze(self.bundle.slopes(X) * np.reshape(self.scale, (-1, 1)))

    def _values(self, X):
        with threads_for(X.shape[1]):
            values = self.bundle.values(X)
        values *= self.scale
        values += self.center
        return self._squeeze(values)

    def _check_points(self, X, ndim):
        columns = getattr(X, "columns", None)
        if (
            columns is not None
            and self.feature_names is not None
            and list(columns) != list(self.feature_names)
        ):
            raise ValueError(
                f"Got X with the columns {list(columns)}, but expected those of the fit, in their "
                f"order: "
                f"{list(self.feature_names)}."
            )
        X = np.asarray(X, dtype=float)
        if (
            X.ndim != ndim
            or X.shape[-1] != self.n_features
            or (ndim == 3 and len(X) != self.n_paths)
        ):
            expected = (
                f"(n, {self.n_features})"
                if ndim == 2
                else f"({self.n_paths}, n, {self.n_features})"
            )
            raise ValueError(
                f"Got X of shape {X.shape}, but expected {expected}: a column for each regressor "
                f"of the fit."
            )
        return X

    def _squeeze(self, values):
        return values[:, :, 0] if self.single else values
