"""Linear algebra: Cholesky factors with jitter, triangular solves, scales of columns, k-means, a check of memory."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Sequence, Sized
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import eigh, lapack
from scipy.linalg.blas import dtrsm, dtrsv
from sklearn.cluster import KMeans
from sklearn.exceptions import ConvergenceWarning

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Vector

JITTER_FIRST = 1e-10  # of the diagonal
JITTER_LAST = 1e-4
# spread of a constant column over its largest value: sums of equal numbers are rounded
CONSTANT = 1e-14
# least singular value, over the largest, of columns that rounding has not made independent
COLLINEAR = 1e-9


class JitterWarning(UserWarning):
    """A covariance matrix was not positive definite in double precision and its diagonal was raised."""


def check_memory(n_values: int, what: str, remedy: str, n_matrices: int = 2) -> None:
    """Raise ValueError if ``n_matrices`` of n_values x n_values doubles do not fit into the machine's memory."""
    needed = 8 * n_matrices * n_values**2
    available = _physical_memory()
    if needed > 0.8 * available:
        raise ValueError(
            f"{what} {n_values} values needs about {needed / 2**30:.0f} GiB, but "
            f"this machine has {available / 2**30:.0f} GiB. {remedy}"
        )


def keep_freed_memory() -> None:
    """Have the C library keep up to 64 MB of freed memory: fresh pages would take a tenth of a search's time.

    glibc keeps twice the size of the largest block that was freed, of those up to 32 MB. Elsewhere
    this does nothing.
    """
    np.empty(2**25 - 2**15, dtype=np.uint8)


def _physical_memory() -> float:
    """Return bytes; infinity where the system does not say."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return float("inf")


def jittered_cholesky(assemble: Callable[[], Matrix]) -> Matrix:
    """Return the lower Cholesky factor (N, N), in Fortran order, of the symmetric matrix that ``assemble()`` returns.

    The matrix is in Fortran order too; its lower triangle is read and overwritten, so that one N x
    N matrix of memory is enough. Where a factorisation fails it is assembled again with a raised
    diagonal, and a JitterWarning says by how much. Above the diagonal the factor holds other
    numbers. Raises LinAlgError if 1e-4 of the diagonal is not enough, or the matrix is not finite.
    """
    jitter = 0.0
    while True:
        K = assemble()
        diagonal = np.einsum("ii->i", K)
        if not np.isfinite(diagonal.sum()):
            raise np.linalg.LinAlgError(
                f"The covariance matrix of {len(K)} values is not finite: some hyperparameter or input "
                "overflowed. Scale the regressors (StandardScaler) or narrow the bounds."
            )
        if jitter:
            diagonal *= 1.0 + jitter
        L, info = lapack.dpotrf(K, lower=1, overwrite_a=1, clean=0)
        if info == 0 and np.isfinite(np.einsum("ii->i", L)).all():
            break
        jitter = 10 * jitter if jitter else JITTER_FIRST
        if jitter > 1.01 * JITTER_LAST:
            raise np.linalg.LinAlgError(
                f"The covariance matrix of {len(K)} values is not positive definite even with "
                f"{JITTER_LAST:g} of its diagonal added. Raise the noise (its lower bound), "
                "remove repeated samples, or shorten the length scales."
            )
    if jitter:
        warn(
            f"The covariance matrix of {len(L)} values was not positive definite in double precision; "
            f"{jitter:g} of its diagonal was added. The results belong to a slightly noisier model: "
            "remove repeated samples or raise the lower bound of the noise if that matters.",
            JitterWarning,
        )
    return L


def semidefinite_root(M: Matrix) -> Matrix:
    """Return R (N, N), in Fortran order, with R R^T = M symmetric and positive semidefinite up to rounding."""
    L, info = lapack.dpotrf(M, lower=1, clean=1)
    if info == 0:
        return L
    return np.asfortranarray(eigen_root(M))


def eigen_root(M: Matrix) -> Matrix:
    """Return R (N, N) with R R^T = M symmetric, perhaps singular: eigenvectors times their standard deviations."""
    values, vectors = eigh(M)
    return vectors * np.sqrt(np.maximum(values, 0.0))


def covariance_root(M: Matrix) -> Matrix:
    """Return R with R R^T = M, (..., n, n), of covariances that may be singular: it changes continuously with M."""
    variance = np.diagonal(M, axis1=-2, axis2=-1)
    scale = np.sqrt(np.maximum(variance, np.finfo(float).tiny))[..., None]
    values, vectors = np.linalg.eigh(M / (scale * scale.swapaxes(-1, -2)))
    std = np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return scale * ((vectors * std) @ vectors.swapaxes(-1, -2))


def cholesky_solve(L: Matrix, b: Array) -> Array:
    """Return K^-1 b from the lower factor of K."""
    return lapack.dpotrs(L, b, lower=1)[0]


def cholesky_inverse(L: Matrix) -> Matrix:
    """Return K^-1 in the lower triangle of its factor ``L``, which it overwrites."""
    return lapack.dpotri(L, lower=1, overwrite_c=1)[0]


def triangular_solve(L: Matrix, B: Array, *, transposed: bool = False) -> Array:
    """Return L^-1 B, or L^-T B; a matrix ``B`` in Fortran order is overwritten."""
    if B.ndim == 1:
        return dtrsv(L, B, lower=1, trans=int(transposed))
    return dtrsm(1.0, L, B, lower=1, trans_a=int(transposed), overwrite_b=1)


class BlockFactor(NamedTuple):
    """Cholesky factor of a symmetric matrix (N, N) that is block-diagonal after a permutation.

    ``rows`` (n_b,) are the places of the rows of each block among the N, in order, ``factors``
    (n_b, n_b) the Cholesky factors of the blocks in their lower triangles.
    """

    rows: Sequence[Indices]
    factors: Sequence[Matrix]

    @property
    def size(self) -> int:
        """Side of the matrix."""
        return sum(map(len, self.factors))

    @property
    def log_determinant(self) -> float:
        """Return log |K|."""
        return sum(map(log_determinant, self.factors))

    def solve(self, B: Array, *, transposed: bool = False) -> Array:
        """Return L^-1 B, or L^-T B; a matrix ``B`` (N, k) in Fortran order may be overwritten."""
        if len(self.factors) == 1:
            return triangular_solve(self.factors[0], B, transposed=transposed)
        solution = np.empty_like(B, order="F")
        for places, L in zip(self.rows, self.factors, strict=True):
            part = np.asfortranarray(B[places])
            solution[places] = triangular_solve(L, part, transposed=transposed)
        return solution

    def dense(self) -> Matrix:
        """Return L (N, N), with zeros beside the blocks."""
        full = np.zeros((self.size, self.size), order="F")
        for places, L in zip(self.rows, self.factors, strict=True):
            full[np.ix_(places, places)] = np.tril(L)
        return full


def symmetric(lower: Matrix) -> Matrix:
    """Return the symmetric matrix with this lower triangle."""
    full = np.tril(lower)
    return full + np.tril(full, -1).T


def log_determinant(L: Matrix) -> float:
    """Return log |K| from its factor."""
    return 2.0 * float(np.log(np.einsum("ii->i", L)).sum())


def constant_columns(Z: Matrix) -> Mask:
    """Return, (k,), which columns of (n, k) have at most one finite value up to rounding."""
    constant = np.empty(Z.shape[1], dtype=bool)
    for k, z in enumerate(Z.T):
        finite = z[np.isfinite(z)]
        largest = np.abs(finite).max(initial=0.0)
        constant[k] = not len(finite) or np.ptp(finite) <= CONSTANT * largest
    return constant


def column_scale(Z: Matrix) -> Vector:
    """Return the standard deviation of each column over its finite values.

    For a constant column, whose deviation is rounding alone: its magnitude, at least one.
    """
    constant = constant_columns(Z)
    scale = np.empty(Z.shape[1])
    for k, z in enumerate(Z.T):
        finite = z[np.isfinite(z)]
        scale[k] = np.abs(finite).max(initial=1.0) if constant[k] else np.std(finite)
    return scale


def output_scale(Y: Matrix) -> Vector:
    """Return ``column_scale`` of each output, or the root mean square where its mean is larger.

    Outputs are centred unless a process around zero is asked for.
    """
    scale = column_scale(Y)
    mean = np.zeros(Y.shape[1])
    for k, y in enumerate(Y.T):
        finite = y[np.isfinite(y)]
        if len(finite):
            mean[k] = np.mean(finite)
    return np.where(np.abs(mean) > scale, np.hypot(mean, scale), scale)


def cluster_centres(X: Matrix, scale: Vector, n: int) -> Matrix:
    """Return n centres of the rows of X (m, d), in the metric of the scales (d,), by k-means."""
    with warnings.catch_warnings():
        # of rows that are alike but for rounding; KMeans has no other way to be silent
        warnings.simplefilter("ignore", ConvergenceWarning)
        means = KMeans(n, n_init=1, random_state=0).fit(X / scale)
    return means.cluster_centers_ * scale


def matrix_vector(matrices: Array, vectors: Array) -> Array:
    """Return the products (..., k) of matrices (..., k, m) and vectors (..., m)."""
    return (matrices @ vectors[..., None])[..., 0]


def consecutive(parts: Sequence[Sized]) -> list[slice]:
    """Return the places of parts that stand one after another."""
    edges = np.cumsum([0, *map(len, parts)]).tolist()
    return [slice(first, last) for first, last in pairwise(edges)]


def least_squares(Q: Matrix, y: Vector) -> Vector:
    """Return the weights (k,) of columns Q (n, k) by least squares of the rows where y (n,) is finite."""
    rows = np.isfinite(y)
    scale = column_scale(Q)
    weights: Any = np.linalg.lstsq(Q[rows] / scale, y[rows], rcond=COLLINEAR)[0]
    return weights / scale


def unexplained_variance(prior: Array, explained: Array) -> Array:
    """Return prior minus explained variance, at least the rounding error of the prior, so that none is zero."""
    return np.maximum(prior - explained, np.finfo(float).eps * prior)
