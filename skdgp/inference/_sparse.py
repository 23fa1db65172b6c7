"""Sparse inference by the collapsed variational bound.

Features are inducing variables u (Alvarez et al. 2010), see ``skdgp.kernels._features``. With their
covariance Kuu, the covariance Kfu of values and features, and the noise S, the bound of Titsias
(2009) is

    log N(y | 0, Kfu Kuu^-1 Kuf + S) - 1/2 tr S^-1 (Kff - Kfu Kuu^-1 Kuf).

It does not exceed the log marginal likelihood, and approaches it as features are added. It needs
only sums over the samples, so time is linear in their number and memory is constant. Noise of
regressors counts as independent between outputs here.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from sklearn.utils import check_random_state, gen_batches

from skdgp._compute.linalg import (
    cholesky_inverse,
    cholesky_solve,
    jittered_cholesky,
    log_determinant,
    semidefinite_root,
    symmetric,
    triangular_solve,
)
from skdgp._compute.parallel import few_threads, thread_map, threads_for
from skdgp._compute.typing import Matrix, Seed, Vector
from skdgp.inference._likelihood import Data
from skdgp.inference._posterior import SinglePosterior
from skdgp.kernels import Features, MultiOutputKernel, PathBundle


class SparsePosterior(SinglePosterior):
    """The sparse posterior at fixed hyperparameters and features.

    Parameters
    ----------
    kernel : MultiOutputKernel
    features : Features
    noise : ndarray (P,)
        Noise variance of each output.
    data : Data

    Attributes
    ----------
    log_marginal_likelihood : float
        Lower bound on the log marginal likelihood.
    neglected_variance : float
        Mean prior variance that the features do not explain, over the noise variance, of the worst
        output. Far below one, the posterior is nearly the exact one (Burt, Rasmussen & van der Wilk 2020).
    """

    def __init__(
        self, kernel: MultiOutputKernel, features: Features, noise: Vector, data: Data
    ) -> None:
        self.kernel = kernel
        self.features = features
        self.noise = np.asarray(noise, dtype=float)
        self.data = data
        with threads_for(self.size):
            self.Lu = jittered_cholesky(lambda: np.asfortranarray(features.Kuu()))
        self._condition()

    def __reduce__(self):
        # A saved model holds the samples, and computes the sums again.
        return SparsePosterior, (self.kernel, self.features, self.noise, self.data)

    @property
    def size(self) -> int:
        """Number of features K."""
        return self.features.size

    def _condition(self):
        """Compute the posterior of w in u = Lu w: precision B = I + sum_i V_i Pi_i V_i^T and mean B^-1 b."""
        variances = []
        for white, G in zip(self.noise, self.data.loadings(), strict=True):
            variances.append(white + np.sum(G**2, axis=1))
        observed = [i for i, y in enumerate(self.data.y) if len(y)]
        of_outputs = thread_map(lambda i: self._sums(i, variances[i]), observed)
        self.B = np.eye(self.size)
        b = np.zeros(self.size)
        neglected = []
        for i, sums in zip(observed, of_outputs, strict=True):
            columns = self.features.columns(i)
            self.B[np.ix_(columns, columns)] += sums.outer
            b[columns] += sums.inner
            neglected.append(sums.variance - np.trace(sums.outer))
        self.neglected_variance = max(np.divide(neglected, [len(self.data.y[i]) for i in observed]))
        with threads_for(self.size):
            self.LB = jittered_cholesky(lambda: np.array(self.B, order="F"))
            self.white = cholesky_solve(self.LB, b)
            self.weights = triangular_solve(self.Lu, self.white, transposed=True)
        squares = sum(sums.square for sums in of_outputs) - b @ self.white
        of_noise = np.sum(np.log(2 * np.pi * np.concatenate(variances)))
        determinants = of_noise + log_determinant(self.LB)
        self.log_marginal_likelihood = -0.5 * float(squares + determinants + sum(neglected))

    def _sums(self, i, variances):
        """Return the sums over the values of output i with these noise variances."""
        columns = self.features.columns(i)
        factor = sub_factor(self.Lu, columns)
        sums = _Sums(np.zeros((len(columns),) * 2), np.zeros(len(columns)))
        for rows in gen_batches(len(variances), self.settings.rows):
            X = self.data.X[i][rows]
            root = 1.0 / np.sqrt(variances[rows])
            V = triangular_solve(factor, self.features.Kfu(i, X).T) * root
            y = self.data.y[i][rows] * root
            sums.outer += V @ V.T
            sums.inner += V @ y
            sums.square += y @ y
            sums.variance += self.kernel.block_diag(i, X) @ root**2
        return sums

    @cached_property
    def B_inverse(self) -> np.ndarray:
        """Covariance of the whitened features, (K, K)."""
        with threads_for(self.size):
            return symmetric(cholesky_inverse(self.LB.copy(order="F")))

    def of(self, data: Data, noise: Vector) -> SparsePosterior:
        """Return the posterior of other values with another noise, at the same hyperparameters and features."""
        return SparsePosterior(self.kernel, self.features, noise, data)

    @cached_property
    def mean_function(self) -> PathBundle:
        """The mean, as a single path."""
        return self.features.paths(self.weights[None])

    @cached_property
    def roots(self) -> list[np.ndarray]:
        """Lu^-T R of the features of each output, (c, c), with R R^T = I - B^-1.

        With V = Lu^-1 Kuf the data reduce the prior variance by V^T (I - B^-1) V, the square of Kfu
        Lu^-T R.
        """
        roots = []
        with threads_for(self.size):
            for i in range(self.kernel.n_outputs):
                columns = self.features.columns(i)
                reduction = np.eye(len(columns)) - self.B_inverse[np.ix_(columns, columns)]
                R = semidefinite_root(reduction)
                roots.append(triangular_solve(sub_factor(self.Lu, columns), R, transposed=True))
        return roots

    def loading(self, i: int, Xs: Matrix) -> tuple[np.ndarray, np.ndarray]:
        """Return A (n, c) and b (c,) such that the mean of output i at Xs is A b."""
        return self.features.Kfu(i, Xs), self.weights[self.features.columns(i)]

    def explained(self, i: int, A: Matrix) -> np.ndarray:
        """Return the variance that the data explain of functions with the loadings A (n, c), (n,)."""
        half = A @ self.roots[i]
        return np.einsum("nc,nc->n", half, half)

    @few_threads
    def covariance(self, Xs: Matrix) -> np.ndarray:
        """Return the joint posterior covariance at Xs, (P n, P n), output-major."""
        P, n = self.kernel.n_outputs, len(Xs)
        A = np.zeros((self.features.size, P * n), order="F")
        for i in range(P):
            A[self.features.columns(i), i * n : (i + 1) * n] = self.features.Kfu(i, Xs).T
        V = triangular_solve(self.Lu, A)
        return self.kernel(Xs) - V.T @ (V - self.B_inverse @ V)

    def paths(self, n_paths: int, random_state: Seed) -> PathBundle:
        """Return samples of the posterior that are functions of the regressors; u_post = Lu w, w ~ N(white, B^-1)."""
        rng = check_random_state(random_state)
        with threads_for(self.size):
            prior, u = self.features.prior_paths(n_paths, self.settings.frequencies, rng)
            drawn = np.asfortranarray(rng.standard_normal(u.shape).T)
            w = self.white[:, None] + triangular_solve(self.LB, drawn, transposed=True)
            w -= triangular_solve(self.Lu, np.asfortranarray(u.T))
            coefficients = triangular_solve(self.Lu, np.asfortranarray(w), transposed=True).T
            return prior + self.features.paths(coefficients)


@dataclass
class _Sums:
    """Sums over values y of an output with the inverse noise Pi and V = Lu^-1 Kuf: V Pi V^T, V Pi y.

    And y Pi y and tr(Pi var(y)).
    """

    outer: Matrix
    inner: Vector
    square: float = 0.0
    variance: float = 0.0


def sub_factor(Lu, columns):
    """Return the Cholesky factor of some features: Kuu is block diagonal, and ``columns`` are whole blocks."""
    return np.asfortranarray(Lu[np.ix_(columns, columns)])
