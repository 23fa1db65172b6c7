"""The covariance of two Gaussian filters of one latent process, and its derivatives.

Notation: A = 2 R R^T, Sigma = A_i (A_i + A_j)^-1 A_j = F F^T, and c is the maximum of the
covariance for unit amplitudes. The first axis of all arrays runs over the latent processes, (m,
...).

Exponentials of squared distances and their sums are computed in strips of rows that fit the cache.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

STRIP = 3 * 2**16  # doubles in one strip; fewer strips mean less waiting between threads
FAR = 1e9  # |a|^2 / 2 or |b|^2 / 2 above which cancellation, about 1e-16 of them, becomes visible


def diagonal_pair(li, lj):
    """Return c (m,) and the diagonal of F (m, d) for length scales (m, d)."""
    total = li**2 + lj**2
    return np.sqrt(2 * li * lj / total).prod(axis=1), np.sqrt(2 / total)


def full_pair(Ri, Rj):
    """Return c (m,) and F (m, d, d) for lower triangular roots (m, d, d).

    A_i + A_j and A_i^-1 + A_j^-1 are sums of squares. Their roots come from QR factorisations,
    which are stable for length scales of very different size.
    """
    log_diagonals = (
        np.log(np.abs(np.einsum("mkk->mk", B))).sum(axis=1) for B in (Ri, Rj, _root_of_sum(Ri, Rj))
    )
    log_i, log_j, log_sum = log_diagonals
    c = np.exp(0.5 * Ri.shape[-1] * np.log(2.0) + 0.5 * (log_i + log_j) - log_sum)
    # Sigma = (A_i^-1 + A_j^-1)^-1 = U^-1 U^-T, where U^T U is the sum of the inverses, A^-1 = (R^-T
    # R^-1) / 2.
    inverses = (np.swapaxes(np.linalg.inv(R), -1, -2) / np.sqrt(2) for R in (Ri, Rj))
    return c, np.linalg.inv(_root_of_sum(*inverses))


def _root_of_sum(Ri, Rj):
    """Return the upper triangle U (m, d, d) with U^T U = R_i R_i^T + R_j R_j^T."""
    return np.linalg.qr(np.swapaxes(np.concatenate([Ri, Rj], axis=-1), -1, -2), mode="r")


def precision(R):
    """Return A = 2 R R^T, (..., d, d)."""
    return 2.0 * R @ np.swapaxes(R, -1, -2)


def moments(sums, a, b, full):
    """Return sum G, sum G delta and sum G delta delta^T (or its diagonal) over delta = a_i - b_j.

    Row sums, column sums and one matrix product are enough; the (n_i, n_j, d) array of separations
    is not needed.
    """
    rows, columns, Gb = sums
    first = rows @ a - columns @ b
    if full:
        cross = a.T @ Gb
        return rows.sum(), first, (a.T * rows) @ a + (b.T * columns) @ b - cross - cross.T
    return rows.sum(), first, rows @ (a * a) + columns @ (b * b) - 2 * np.einsum("ak,ak->k", a, Gb)


def diagonal_slopes(mass, second, li, lj):
    """Return d/dlog l_i and d/dlog l_j of sum(W c exp(...)), from the moments of W c exp(...): (m, d) each."""
    total = li**2 + lj**2
    by_exponent = 2 * second / total**2  # derivative of the exponent -delta^2 / (li^2 + lj^2)
    by_factor = (
        0.5 * mass[:, None] * (lj**2 - li**2) / total
    )  # derivative of sqrt(2 li lj / (li^2 + lj^2))
    return by_exponent * li**2 + by_factor, by_exponent * lj**2 - by_factor


def full_slopes(mass, second, F, R_both, R):
    """Return d/dR, (m, d, d), for the output with root R, from the moments of W c exp(...).

    With dSigma = Sigma A^-1 dA A^-1 Sigma and dlog c = tr((1/4 A^-1 - 1/2 (A_i + A_j)^-1) dA).
    """
    inverse = np.linalg.inv(precision(R))
    T = inverse @ F @ np.swapaxes(F, -1, -2)
    G = -0.5 * T @ second @ np.swapaxes(T, -1, -2)
    G += mass[:, None, None] * (
        0.25 * inverse - 0.5 * np.linalg.inv(sum(precision(r) for r in R_both))
    )
    return 4.0 * G @ R  # A = 2 R R^T


# -- exponentials of squared distances
# --------------------------------------------------------------------------------


class Exponent(NamedTuple):
    """Factors with left @ right.T = shift - |a - b|^2 / 2 for all rows a and b, so one matrix product is enough.

    Far from the origin the product would lose digits; ``far`` then selects explicit differences.
    """

    left: np.ndarray
    right: np.ndarray
    shift: float
    far: bool

    @classmethod
    def between(cls, a, b, shift=0.0) -> Exponent:
        """Return the exponent of rows a (n_i, d) and b (n_j, d)."""
        left, right = np.empty((len(a), a.shape[1] + 2)), np.empty((len(b), b.shape[1] + 2))
        left[:, :-2], right[:, :-2] = a, b
        left[:, -1], right[:, -2] = 1.0, 1.0
        np.einsum("nk,nk->n", a, a, out=left[:, -2])
        np.einsum("nk,nk->n", b, b, out=right[:, -1])
        left[:, -2] *= -0.5
        right[:, -1] *= -0.5
        far = bool(len(a) and len(b) and max(-left[:, -2].min(), -right[:, -1].min()) > FAR)
        right[:, -1] += shift
        return cls(left, right, shift, far)

    def exponential(self, rows, out):
        """Return the exponentials of some rows, written to ``out``."""
        if self.far:
            out[:] = self.shift - 0.5 * cdist(
                self.left[rows, :-2], self.right[:, :-2], "sqeuclidean"
            )
        else:
            np.matmul(self.left[rows], self.right.T, out=out)
        return np.exp(out, out=out)


def strips(n_rows, n_columns) -> Iterator[slice]:
    """Return slices of the rows with about STRIP entries each."""
    step = max(8, STRIP // max(n_columns, 1))
    return (slice(a, min(a + step, n_rows)) for a in range(0, n_rows, step))


def signed_sum(exponents, signs, shape) -> np.ndarray:
    """Return sum_k sign_k exp(exponent_k), (n_i, n_j)."""
    total = np.empty(shape) if exponents else np.zeros(shape)
    buffer = np.empty(min(total.size, STRIP + 8 * shape[1]))
    for rows in strips(*shape):
        out = total[rows]
        for k, (exponent, sign) in enumerate(zip(exponents, signs, strict=True)):
            if k == 0:
                exponent.exponential(rows, out)
                if sign < 0:
                    np.negative(out, out=out)
            else:
                E = exponent.exponential(rows, buffer[: out.size].reshape(out.shape))
                (np.add if sign > 0 else np.subtract)(out, E, out=out)
    return total


def exponential_times(exponent, B, n_rows) -> np.ndarray:
    """Return exp(exponent) @ B, (n_rows, k)."""
    out = np.empty((n_rows, B.shape[1]))
    buffer = np.empty(min(n_rows * len(B), STRIP + 8 * len(B)))
    for rows in strips(n_rows, len(B)):
        size = len(out[rows])
        np.matmul(
            exponent.exponential(rows, buffer[: size * len(B)].reshape(size, len(B))),
            B,
            out=out[rows],
        )
    return out


class WeightedSums(NamedTuple):
    """Row sums (n_i,), column sums (n_j,) and G b (n_i, d), for G = W * exp(exponent)."""

    rows: np.ndarray
    columns: np.ndarray
    right: np.ndarray


def weighted_sums(exponents, W, b) -> list[WeightedSums]:
    """Return the sums of G for each exponent; b is (n_j, d)."""
    (n_i, n_j), d = W.shape, b.shape[1]
    padded = np.column_stack([b, np.ones(n_j)])
    ones = np.ones(n_i)
    products = np.empty((len(exponents), n_i, d + 1))
    columns = np.zeros((len(exponents), n_j))
    buffer = np.empty(min(W.size, STRIP + 8 * n_j))
    for rows in strips(n_i, n_j):
        strip = W[rows]
        G = buffer[: strip.size].reshape(strip.shape)
        for k, exponent in enumerate(exponents):
            exponent.exponential(rows, G)
            np.multiply(G, strip, out=G)
            np.matmul(G, padded, out=products[k, rows])
            columns[k] += ones[rows] @ G
    return [WeightedSums(p[:, d], c, p[:, :d]) for p, c in zip(products, columns, strict=True)]


class ExponentialRows:
    """Covariances of the outputs of a convolved Gaussian with given values of other outputs, as columns.

    ``columns`` lists for each output pairs (j, Z): another output and its inputs (k, d). Each
    latent shared by the two has separate columns gain * exp(-1/2 |F (x - mu - z)|^2). With x
    relative to a central point, the exponent is one product: of squares, which are the same for all
    columns of a pair and latent, x and 1, with a matrix.
    """

    def __init__(self, joint, columns):
        self.joint = joint
        self.columns = columns = [
            (i, j, Z) for i, pairs in enumerate(columns) for j, Z in pairs if len(Z)
        ]
        d = joint.n_features
        self.middle = (
            np.concatenate([Z for *_, Z in columns]).mean(axis=0) if columns else np.zeros(d)
        )
        roots, slopes, constants, gains, sizes = [], [np.zeros((0, d))], [np.zeros(0)], [], []
        for i, j, Z in columns:
            _, gain, _, F, shifts = joint._pair(i, j)
            for root, mu in zip(F, shifts, strict=True):
                root = np.diag(root) if root.ndim == 1 else root
                b = (Z - self.middle + mu) @ root
                roots.append(root)
                slopes.append(b @ root.T)
                constants.append(-0.5 * np.einsum("kd,kd->k", b, b))
            gains.extend(gain)
            sizes.extend([len(Z)] * len(gain))
        constant, counts, self.n_terms = (
            np.concatenate(constants),
            np.array(sizes, dtype=int),
            len(roots),
        )
        self.far = -constant.min(initial=0.0) > FAR
        self.diagonal = all(np.count_nonzero(F - np.diag(np.diag(F))) == 0 for F in roots)
        self.roots = np.hstack([np.zeros((d, 0)), *roots])
        squares = (
            np.reshape([np.diag(F) ** 2 for F in roots], (-1, d)).T
            if self.diagonal
            else np.eye(len(roots))
        )
        with np.errstate(divide="ignore"):  # a gain of zero
            constant += np.repeat(np.log(np.abs(gains)), counts)
        self.matrix = np.vstack(
            [-0.5 * np.repeat(squares, counts, axis=1), np.concatenate(slopes).T, constant]
        )
        ends = np.cumsum(counts)
        self.negative = [
            slice(b - n, b) for gain, n, b in zip(gains, counts, ends, strict=True) if gain < 0
        ]

    def __call__(self, X) -> np.ndarray:
        """Return all columns at X (n, d), (n, C)."""
        if self.far:
            return np.hstack(
                [np.empty((len(X), 0)), *(self.joint.terms(i, j, X, Z) for i, j, Z in self.columns)]
            )
        x = X - self.middle
        squares = (
            x * x
            if self.diagonal
            else ((x @ self.roots).reshape(len(x), self.n_terms, -1) ** 2).sum(axis=2)
        )
        E = np.hstack([squares, x, np.ones((len(x), 1))]) @ self.matrix
        np.exp(E, out=E)
        for columns in self.negative:
            np.negative(E[:, columns], out=E[:, columns])
        return E
