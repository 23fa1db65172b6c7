"""The posterior of one term of a sum of kernels, centred over samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.linalg import unexplained_variance
from skdgp._compute.typing import Matrix


class CentredTerm:
    r"""The posterior of g(x) = f(x) - mean_n f(x_n) for one term f of a sum of kernels.

    The data determine g much better than f, as a constant can move from one term to another. With the covariances A(x)
    of f and the data, or the inducing features, mean and variance of g are those of f with A(x) - mean_n A(x_n) in
    place of A(x), and with the prior variance

    .. math:: k(x, x) - \frac{2}{N} \sum_n k(x, x_n) + \frac{1}{N^2} \sum_{nm} k(x_n, x_m).

    Parameters
    ----------
    posterior : ExactPosterior or SparsePosterior
    regressors : tuple of int
        Regressors of the term, one of ``posterior.kernel.term_regressors()``.
    X : ndarray (N, d)
        The samples x_n.

    Attributes
    ----------
    values : ndarray (N, P)
        Mean of f at the samples; its own mean over them is not subtracted.
    """

    def __init__(self, posterior: Any, regressors: tuple[int, ...], X: Matrix) -> None:
        self.posterior = posterior.term(posterior.kernel.term(regressors))
        self.X = X
        outputs, kernel = range(posterior.kernel.n_outputs), self.posterior.kernel
        loadings = [self.posterior.loading(i, X) for i in outputs]
        self.values = np.column_stack([A @ b for A, b in loadings])
        self._means = [A.mean(axis=0) for A, _ in loadings]
        self._variances = [kernel.block(i, i, X, X).mean() for i in outputs]

    def predict(self, X: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance of g at X (n, d): (n, P) each."""
        mean, variance = np.empty((2, len(X), len(self._means)))
        for i, centre in enumerate(self._means):
            A, b = self.posterior.loading(i, X)
            A = A - centre
            mean[:, i] = A @ b
            if return_variance:
                kernel = self.posterior.kernel
                shared = kernel.block(i, i, X, self.X).mean(axis=1)
                prior = np.maximum(kernel.block_diag(i, X) - 2 * shared + self._variances[i], 0.0)
                variance[:, i] = unexplained_variance(prior, self.posterior.explained(i, A))
        return (mean, variance) if return_variance else mean


class AverageTerm:
    """The centred term of an average: the mixture of those of its members, zero where a member lacks the term."""

    def __init__(self, posterior: Any, regressors: tuple[int, ...], X: Matrix) -> None:
        self.posterior = posterior
        self.terms = [
            CentredTerm(member, regressors, X) if regressors in member.kernel.term_regressors() else None
            for member in posterior.members
        ]
        zero = np.zeros((len(X), posterior.kernel.n_outputs))
        self.values = posterior.mixed([zero if term is None else term.values for term in self.terms])[0]

    def predict(self, X: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance at X (n, d): (n, P) each."""
        zero = np.zeros((len(X), self.posterior.kernel.n_outputs))
        found = [(zero, zero) if term is None else term.predict(X, return_variance=True) for term in self.terms]
        means, variances = zip(*found, strict=True)
        mean, scatter = self.posterior.mixed(means)
        return (mean, self.posterior.mixed(variances)[0] + scatter) if return_variance else mean


def centred_term(posterior: Any, regressors: tuple[int, ...], X: Matrix) -> CentredTerm | AverageTerm:
    """Return the centred term of a posterior."""
    return (AverageTerm if hasattr(posterior, "members") else CentredTerm)(posterior, regressors, X)


def training_inputs(posterior: Any) -> np.ndarray:
    """Return the distinct inputs of the observed values of a posterior that is not compact, (n, d)."""
    return np.unique(np.concatenate(posterior.samples().X), axis=0)
