"""The interface of posteriors for fits, predictions, simulations and exports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from skdgp._compute.linalg import unexplained_variance
from skdgp._compute.parallel import few_threads, thread_map
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.kernels import MultiOutputKernel, PathBundle

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
    parts : list of tuple of int
        The terms of the kernel that each component has, by their numbers.
    mixture : ndarray (K, P)
        The weight of each component, for each output.
    """

    kernel: MultiOutputKernel
    noise: Vector
    log_marginal_likelihood: float
    data: Data
    members: Sequence[SinglePosterior]
    parts: list[tuple[int, ...]]
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
    def parts(self) -> list[tuple[int, ...]]:  # type: ignore[override]
        """All terms."""
        return [tuple(range(len(self.kernel.summands())))]

    @property
    def mixture(self) -> Matrix:  # type: ignore[override]
        """Ones, (1, P)."""
        return np.ones((1, self.kernel.n_outputs))

    @abstractmethod
    def likelihood_at(
        self, kernel: MultiOutputKernel, noise: Vector, eval_gradient: bool = False
    ) -> Any:
        """Return the log likelihood of the same data at other hyperparameters, with ``eval_gradient`` its gradient."""

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
        d = np.shape(Xs)[1]
        return self._in_batches(lambda X: [self.mean_function.slopes(X[None])[0]], Xs, d)[0]

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
