"""The posterior of one term of a sum of kernels, centred over samples."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.linalg import unexplained_variance
from skdgp._compute.typing import Matrix
from skdgp.inference._mixture import moments


class CentredTerm:
    r"""The posterior of g(x) = f(x) - mean_n f(x_n) for one term f of a sum of kernels.

    The data determine g much better than f, as a constant can move from one term to another. With the covariances A(x)
    of f and the data, or the inducing features, mean and variance of g are those of f with A(x) - mean_n A(x_n) in
    place of A(x), and with the prior variance

    .. math:: k(x, x) - \frac{2}{N} \sum_n k(x, x_n) + \frac{1}{N^2} \sum_{nm} k(x_n, x_m).

    That of an average is the mixture of those of its members, zero where a member lacks the term.

    Parameters
    ----------
    posterior : AveragePosterior, ExactPosterior or SparsePosterior
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
        self.mixture = posterior.mixture
        self.terms = [
            _MemberTerm(member, regressors, X) if regressors in member.kernel.term_regressors() else None
            for member in posterior.members
        ]
        zero = np.zeros((len(X), self.mixture.shape[1]))
        self.values = moments(self.mixture, [zero if term is None else term.values for term in self.terms])

    def predict(self, X: Matrix, return_variance: bool = False) -> Any:
        """Return the mean and, with ``return_variance``, the variance at X (n, d): (n, P) each."""
        zero = np.zeros((len(X), self.mixture.shape[1]))
        none = (zero, zero) if return_variance else zero
        found = [none if term is None else term.predict(X, return_variance) for term in self.terms]
        return moments(self.mixture, found, return_variance)


class _MemberTerm:
    """The centred term of a single posterior."""

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


def training_inputs(posterior: Any) -> np.ndarray:
    """Return the distinct inputs of the observed values of a posterior that is not compact, (n, d)."""
    return np.unique(np.concatenate(posterior.samples().X), axis=0)
