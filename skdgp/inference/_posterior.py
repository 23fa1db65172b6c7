"""The interface of posteriors for fits, predictions, simulations and exports."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._paths import Paths
from skdgp.kernels import MultiOutputKernel


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
    """

    kernel: MultiOutputKernel
    noise: Vector
    log_marginal_likelihood: float

    @property
    @abstractmethod
    def members(self) -> Sequence[SinglePosterior]:
        """The components of the mixture. The first has all terms."""

    @property
    @abstractmethod
    def parts(self) -> list[tuple[int, ...]]:
        """The terms of the kernel that each component has, by their numbers."""

    @property
    @abstractmethod
    def mixture(self) -> Matrix:
        """The weight of each component, for each output, (K, P)."""

    @abstractmethod
    def predict(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of the functions at Xs (n, d): (n, P) each."""

    @abstractmethod
    def gradient(self, Xs: Matrix, return_variance: bool = False) -> Any:
        """Return d mean / d x at Xs, (n, P, d), and with ``return_variance`` the variance of the slopes."""

    @abstractmethod
    def covariance(self, Xs: Matrix) -> Matrix:
        """Return the joint covariance at Xs, (P n, P n), output-major."""

    @abstractmethod
    def paths(self, n_paths: int, random_state: Seed) -> Paths:
        """Return samples that are functions of the regressors."""

    @abstractmethod
    def samples(self) -> Data:
        """Return the observed values."""

    @abstractmethod
    def likelihood_at(
        self, kernel: MultiOutputKernel, noise: Vector, eval_gradient: bool = False
    ) -> Any:
        """Return the log likelihood of the same data at other hyperparameters, with ``eval_gradient`` its gradient."""


class SinglePosterior(Posterior):
    """A Gaussian process: the only component of its mixture."""

    @property
    @abstractmethod
    def size(self) -> int:
        """Number of values or of inducing variables: the side of the largest matrix."""

    @property
    def members(self) -> Sequence[SinglePosterior]:
        return [self]

    @property
    def parts(self) -> list[tuple[int, ...]]:
        return [tuple(range(len(self.kernel.summands())))]

    @property
    def mixture(self) -> Matrix:
        return np.ones((1, self.kernel.n_outputs))

    @abstractmethod
    def of(self, data: Data, noise: Vector) -> SinglePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters."""

    @abstractmethod
    def term(self, kernel: MultiOutputKernel) -> SinglePosterior:
        """Return the posterior of one term of the kernel, which is independent of the others a priori.

        ``predict``, ``covariance`` and ``gradient`` refer to the term, which
        ``self.kernel.term(regressors)`` gives.
        """

    @abstractmethod
    def loading(self, i: int, Xs: Matrix) -> tuple[Array, Array]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""

    @abstractmethod
    def explained(self, i: int, A: Matrix) -> Array:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""
