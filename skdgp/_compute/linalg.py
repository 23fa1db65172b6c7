"""Linear algebra: Cholesky factors with jitter, triangular solves, scales of columns, k-means."""

from __future__ import annotations

import warnings
from collections.abc import Callable

import numpy as np
from scipy.linalg import eigh, lapack
from scipy.linalg.blas import dtrsm, dtrsv
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning

JITTER_FIRST, JITTER_LAST = 1e-10, 1e-4
CONSTANT = 1e-14  # spread of a constant column, relative to its largest value: sums of equal numbers are rounded


class JitterWarning(UserWarning):
    """A covariance matrix was not positive definite in double precision and its diagonal was raised."""


def jittered_cholesky(assemble: Callable[[], np.ndarray]) -> np.ndarray:
    """Return the lower Cholesky factor of ``assemble()``, raising the diagonal when, and only when, it is needed.

    Parameters
    ----------
    assemble : callable
        Returns the symmetric matrix, (N, N) in Fortran order, of which the lower triangle is read. It is
        factored in place, and asked for again when a factorisation fails: one N x N matrix of memory.

    Returns
    -------
    L : ndarray (N, N), Fortran order
        Lower factor; what stands above the diagonal is not to be read.

    Warns
    -----
    JitterWarning
        When the diagonal had to be raised, with the amount relative to it.

    Raises
    ------
    numpy.linalg.LinAlgError
        When 1e-4 of the diagonal is not enough, or the matrix is not finite.
    """
    jitter = 0.0
    while True:
        K = assemble()
        diagonal = np.einsum("ii->i", K)
        if not np.isfinite(diagonal.sum()):
            raise np.linalg.LinAlgError(
                f"The covariance matrix of {len(K)} values is not finite: some hyperparameter or input overflowed. "
                "Scale the regressors (StandardScaler) or narrow the bounds."
            )
        if jitter:
            diagonal *= 1.0 + jitter
        L, info = lapack.dpotrf(K, lower=1, overwrite_a=1, clean=0)
        if info == 0 and np.isfinite(np.einsum("ii->i", L)).all():
            break
        jitter = 10 * jitter if jitter else JITTER_FIRST
        if jitter > 1.01 * JITTER_LAST:
            raise np.linalg.LinAlgError(
                f"The covariance matrix of {len(K)} values is not positive definite even with {JITTER_LAST:g} of its "
                "diagonal added. Raise the noise (its lower bound), remove repeated samples, or shorten the "
                "length scales."
            )
    if jitter:
        warnings.warn(
            f"The covariance matrix of {len(L)} values was not positive definite in double precision; {jitter:g} of "
            "its diagonal was added. The results are those of a slightly noisier model: remove repeated samples "
            "or raise the lower bound of the noise if that matters.",
            JitterWarning,
            stacklevel=3,
        )
    return L


def pivoted_cholesky(K: np.ndarray, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Return, step by step, which variable is least explained by those before it, and what of its variance is left.

    ``K`` (N, N), in Fortran order, is overwritten. Ends when less than ``tolerance`` is left of any; one is always
    returned.
    """
    L, pivots, rank, info = lapack.dpstrf(K, tol=tolerance, lower=1, overwrite_a=1)
    if info < 0:
        raise np.linalg.LinAlgError(f"The pivoted Cholesky factorisation failed (pstrf info {info}).")
    if rank == 0:
        return np.zeros(1, dtype=int), np.zeros(1)
    return pivots[:rank] - 1, np.einsum("ii->i", L)[:rank] ** 2


def semidefinite_root(M: np.ndarray) -> np.ndarray:
    """Return R with R R^T = M, (N, N) in Fortran order, of a symmetric matrix that is semidefinite but for rounding."""
    L, info = lapack.dpotrf(M, lower=1, clean=1)
    if info == 0:
        return L
    return np.asfortranarray(eigen_root(M))


def eigen_root(M: np.ndarray) -> np.ndarray:
    """Return R with R R^T = M, (N, N), of a symmetric matrix that may be singular: eigenvectors by their deviations."""
    values, vectors = eigh(M)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def covariance_root(M: np.ndarray) -> np.ndarray:
    """Return R with R R^T = M, (..., n, n), of covariances that may be singular: it changes continuously with M."""
    scale = np.sqrt(np.maximum(np.diagonal(M, axis1=-2, axis2=-1), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(M / (scale[..., :, None] * scale[..., None, :]))
    return scale[..., :, None] * ((vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]) @ vectors.swapaxes(-1, -2))


def cholesky_solve(L: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return K^-1 b from the lower factor of K."""
    return lapack.dpotrs(L, b, lower=1)[0]


def cholesky_inverse(L: np.ndarray) -> np.ndarray:
    """Return K^-1 in the lower triangle of ``L``, which it overwrites."""
    inverse, info = lapack.dpotri(L, lower=1, overwrite_c=1)
    if info:
        raise np.linalg.LinAlgError(f"The inverse from the Cholesky factor failed (potri info {info}).")
    return inverse


def triangular_solve(L: np.ndarray, B: np.ndarray, *, transposed: bool = False) -> np.ndarray:
    """Return L^-1 B, or L^-T B; a matrix ``B`` in Fortran order is overwritten."""
    if B.ndim == 1:
        return dtrsv(L, B, lower=1, trans=int(transposed))
    return dtrsm(1.0, L, B, lower=1, trans_a=int(transposed), overwrite_b=1)


def symmetric(lower: np.ndarray) -> np.ndarray:
    """Return the full matrix of which the lower triangle is given."""
    full = np.tril(lower)
    return full + np.tril(full, -1).T


def log_determinant(L: np.ndarray) -> float:
    """Return log |K| from its factor."""
    return 2.0 * float(np.log(np.einsum("ii->i", L)).sum())


def constant_columns(Z: np.ndarray) -> np.ndarray:
    """Return which columns (n, k) have one finite value only, but for rounding, or none: (k,) of bool."""
    finite = [z[np.isfinite(z)] for z in Z.T]
    return np.array([not len(z) or np.ptp(z) <= CONSTANT * np.abs(z).max() for z in finite], dtype=bool)


def column_scale(Z: np.ndarray) -> np.ndarray:
    """Return the standard deviation of each column over its finite values; of a constant one its size, at least one.

    A column of equal numbers may be zeros but for rounding: it is not measured by what rounding left.
    """
    finite = [z[np.isfinite(z)] for z in Z.T]
    columns = zip(finite, constant_columns(Z), strict=True)
    return np.array([np.abs(z).max(initial=1.0) if same else np.std(z) for z, same in columns])


def output_scale(Y: np.ndarray) -> np.ndarray:
    """Return how far the values of each output are from zero: by ``column_scale``, or by their mean where that is more.

    Outputs are centred beforehand, unless a process around zero was asked for.
    """
    scale = column_scale(Y)
    mean = np.array([np.mean(y[np.isfinite(y)]) if np.isfinite(y).any() else 0.0 for y in Y.T])
    return np.where(np.abs(mean) > scale, np.hypot(mean, scale), scale)


def cluster_centres(X: np.ndarray, scale: np.ndarray, n: int, random_state, max_iter=300) -> np.ndarray:
    """Return n centres of the rows of X (m, d), in the metric of the scales (d,), by k-means."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of rows that are alike but for rounding
        means = KMeans(n, n_init=1, max_iter=max_iter, random_state=random_state).fit(X / scale)
    return means.cluster_centers_ * scale


def unexplained_variance(prior: np.ndarray, explained: np.ndarray) -> np.ndarray:
    """Return prior less explained variance, at least the rounding error of the prior: no deviation is zero."""
    return np.maximum(prior - explained, np.finfo(float).eps * prior)
