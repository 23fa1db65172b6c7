"""The exact posterior: one Cholesky factorisation, then equations 17 and 18."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    consecutive,
    jittered_cholesky,
    log_determinant,
    triangular_solve,
)
from skdgp._compute.parallel import few_threads, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._likelihood import Data, covariance, log_likelihood
from skdgp.inference._noise import draw_noise
from skdgp.inference._paths import FREQUENCIES
from skdgp.inference._posterior import SinglePosterior
from skdgp.kernels import MultiOutputKernel, PathBundle, covariance_paths, prior_paths


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
        square = self._white @ self._white
        self.log_marginal_likelihood = -0.5 * (
            square + log_determinant(self.L) + data.n_values * np.log(2 * np.pi)
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

    def likelihood_at(
        self, kernel: MultiOutputKernel, noise: Vector, eval_gradient: bool = False
    ) -> Any:
        """Return the log likelihood of the same data at other hyperparameters, with ``eval_gradient`` its gradient."""
        return log_likelihood(kernel, noise, self.data, eval_gradient)

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
            correction = covariance_paths(self.kernel, data.X, weights.T)
            return prior + correction
