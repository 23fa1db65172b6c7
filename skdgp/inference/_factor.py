"""A Cholesky factor that grows by rows."""

from __future__ import annotations

import numpy as np

from skdgp._compute.linalg import jittered_cholesky, log_determinant, triangular_solve

TAIL = 8  # one part in so many is kept apart before both are copied into one


class Factor:
    """L of K = L L^T, (N, N): a large head, and a small tail of rows appended since.

    With the tail apart, appending copies little; at times the two are copied into one.

    Parameters
    ----------
    head : ndarray (n, n), Fortran order
        A lower Cholesky factor; what stands above its diagonal is not read.
    below : ndarray (m, n), Fortran order, optional
    tail : ndarray (m, m), Fortran order, optional
        The rows of L that follow are [below, tail].
    """

    def __init__(self, head, below=None, tail=None):
        self.head, self.below, self.tail = head, below, tail

    @property
    def size(self) -> int:
        """Number of rows N."""
        return len(self.head) + (0 if self.tail is None else len(self.tail))

    def matrix(self) -> np.ndarray:
        """Return L, (N, N); what stands above its diagonal is not to be read."""
        return self.head if self.tail is None else _stacked(self.head, self.below, self.tail)

    def log_determinant(self) -> float:
        """Return log |K|."""
        return log_determinant(self.head) + (0.0 if self.tail is None else log_determinant(self.tail))

    def half(self, B):
        """Return L^-1 B; a matrix ``B`` in Fortran order is overwritten where that saves memory."""
        if self.tail is None:
            return triangular_solve(self.head, B)
        n = len(self.head)
        first = triangular_solve(self.head, np.array(B[:n], order="F"))
        last = np.asfortranarray(B[n:] - self.below @ first)
        return np.concatenate([first, triangular_solve(self.tail, last)])

    def other_half(self, b):
        """Return L^-T b of a vector."""
        if self.tail is None:
            return triangular_solve(self.head, b, transposed=True)
        n = len(self.head)
        last = triangular_solve(self.tail, b[n:], transposed=True)
        first = triangular_solve(self.head, b[:n] - self.below.T @ last, transposed=True)
        return np.concatenate([first, last])

    def extended(self, half, K) -> tuple[Factor, np.ndarray]:
        """Return the factor of the matrix with further rows and columns, and its last corner, (m, m).

        Parameters
        ----------
        half : ndarray (N, m)
            ``half`` of the covariance of the old rows with the new ones.
        K : ndarray (m, m), Fortran order
            Covariance of the new rows, of which the lower triangle is read; it is overwritten.

        Raises
        ------
        numpy.linalg.LinAlgError
            When the matrix is not positive definite, see ``jittered_cholesky``.
        """
        K -= half.T @ half
        corner = jittered_cholesky(lambda: K.copy(order="F"))
        n = len(self.head)
        if self.tail is None:
            below, tail = half.T, corner
        else:
            below = np.concatenate([self.below, half[:n].T])
            tail = _stacked(self.tail, half[n:].T, corner)
        if TAIL * len(tail) > n:
            return Factor(_stacked(self.head, below, tail)), corner
        return Factor(self.head, np.asfortranarray(below), tail), corner


def _stacked(head, below, tail):
    """Return [[head, *], [below, tail]], in Fortran order."""
    n, m = len(head), len(tail)
    L = np.empty((n + m, n + m), order="F")
    L[:n, :n], L[n:, :n], L[n:, n:] = head, below, tail
    return L
