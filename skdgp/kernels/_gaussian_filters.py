r"""Equations 15 and 16: Gaussian filters of white noise, and the covariance of two outputs.

Latent process m reaches output i through the filter (Hemakumara & Sukkarieh 2011)

    h_mi(s) = v_mi exp(-1/2 (s - mu_mi)^T A_mi (s - mu_mi)).                                   (15)

With the separation delta = s - s', mu = mu_mi - mu_mj and Sigma = A_mi (A_mi + A_mj)^-1 A_mj, the
covariance of outputs i and j is

    cov_ij = sum_m (2 pi)^(d/2) v_mi v_mj |A_mi + A_mj|^(-1/2)
                   exp(-1/2 (delta - mu)^T Sigma (delta - mu)).                                (16)

The amplitude w = v pi^(d/4) |A|^(-1/4) replaces v, so that cov_ii(0) = sum_m w_mi^2. The factor of
the exponential is then the gain w_mi w_mj c, where c depends on the two widths alone and is 1 for
equal ones. A is diagonal, so Sigma is too; it is used through its root F. The first axis of all
arrays runs over the latent processes, (m, ...).

Exponentials of squared distances and their sums are computed in strips of rows that fit the cache.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy.spatial.distance import cdist

from skdgp._compute.linalg import RowPairs
from skdgp._compute.typing import Array, Matrix, Vector

STRIP = 3 * 2**16  # doubles in one strip; fewer strips mean less waiting between threads
FAR = 1e9  # |a|^2 / 2 or |b|^2 / 2 above which cancellation, about 1e-16 of them, becomes visible


class Moments(NamedTuple):
    """Sums of G = W * exp(...) over all pairs of rows, for each latent: of G, G (delta - mu), G (delta - mu)^2.

    ``zeroth`` (m,), ``first`` (m, d), ``second`` (m, d).
    """

    zeroth: Vector
    first: Matrix
    second: Matrix


class FilterPair:
    """Equation 16 of outputs i and j, for the m latent processes that feed both.

    Parameters
    ----------
    w : array (2, m)
        Amplitudes of output i and of output j.
    widths : array (2, m, d)
        Length scales l with A = 2 diag(l^-2).
    mu : array (m, d)
        mu_mi - mu_mj.

    Attributes
    ----------
    c, gain : array (m,)
        Factor of the exponential for unit amplitudes, and for the amplitudes w.
    F, Sigma : array (m, d)
        Diagonals of the root of Sigma, and of Sigma.
    """

    def __init__(self, w: Array, widths: Array, mu: Matrix) -> None:
        self.w, self.widths, self.mu = w, widths, mu
        li, lj = widths
        self.squares = li**2 + lj**2
        self.c = np.sqrt(2 * li * lj / self.squares).prod(axis=1)
        self.F = np.sqrt(2 / self.squares)
        self.Sigma = self.F**2
        self.gain = self.c * w[0] * w[1]

    def exponents(self, Xi: Matrix, Xj: Matrix) -> list[Exponent]:
        """Return -1/2 (delta - mu)^T Sigma (delta - mu) of each latent."""
        middle = _middle(Xj)
        b = Xj - middle
        return [
            Exponent.between((Xi - (mu + middle)) * F, b * F)
            for mu, F in zip(self.mu, self.F, strict=True)
        ]

    def covariance(self, Xi: Matrix, Xj: Matrix) -> Matrix:
        """Return equation 16 at all pairs of rows, (n_i, n_j)."""
        total = np.zeros((len(Xi), len(Xj)))
        terms = list(zip(self.gain, self.exponents(Xi, Xj), strict=True))
        buffer = _strip_buffer(*total.shape)
        for rows in strips(*total.shape):
            out = total[rows]
            E = buffer[: out.size].reshape(out.shape)
            for gain, exponent in terms:
                exponent.exponential(rows, E)
                E *= gain
                out += E
        return total

    def at_pairs(
        self, pairs: RowPairs, columns: slice | Array
    ) -> tuple[Vector, Callable[[Vector], Moments]]:
        """Return equation 16 at pairs of rows, (n_pairs,), for mu = 0.

        Also return the function from weights (n_pairs,) to moments. ``columns`` are the regressors
        that matter.
        """
        squares = pairs.squares[columns]
        exponentials = -0.5 * self.F[:, columns] ** 2 @ squares
        np.exp(exponentials, out=exponentials)

        def moments(W: Vector) -> Moments:
            G = exponentials * W
            first, second = np.zeros((2, *self.mu.shape))
            second[:, columns] = G @ squares.T
            return Moments(G.sum(axis=1), first, second)

        return self.gain @ exponentials, moments

    # -- derivatives by the parameters
    # -----------------------------------------------------------------------------------

    def moments(self, Xi: Matrix, Xj: Matrix, W: Matrix) -> Moments:
        """Return the moments of weights W (n_i, n_j)."""
        middle = _middle(Xj)
        b = Xj - middle
        sums = weighted_sums(self.exponents(Xi, Xj), W, b)
        parts = []
        for mu, (rows, columns, Gb) in zip(self.mu, sums, strict=True):
            a = Xi - (mu + middle)
            first = rows @ a - columns @ b
            second = rows @ (a * a) + columns @ (b * b) - 2 * np.einsum("ak,ak->k", a, Gb)
            parts.append((rows.sum(), first, second))
        return Moments(*(np.array(part) for part in zip(*parts, strict=True)))

    def gradient(self, moments: Moments) -> tuple[Array, Array, Matrix]:
        """Return the derivatives of sum(W * cov_ij) by the parameters of both outputs, from the moments of W.

        By the amplitudes (2, m), by the logarithms of the length scales (2, m, d), and by mu_i -
        mu_j (m, d).
        """
        by_w = self.c * moments.zeroth * self.w[::-1]
        zeroth = self.gain * moments.zeroth
        li, lj = self.widths
        # of -delta^2 / (l_i^2 + l_j^2), and of the factor sqrt(2 l_i l_j / (l_i^2 + l_j^2))
        by_exponent = 2 * (self.gain[:, None] * moments.second) / self.squares**2
        by_factor = 0.5 * zeroth[:, None] * (lj**2 - li**2) / self.squares
        by_widths = np.stack([by_exponent * li**2 + by_factor, by_exponent * lj**2 - by_factor])
        return by_w, by_widths, self.Sigma * (self.gain[:, None] * moments.first)


def _middle(X):
    """Return the mean of the data; subtracting it avoids cancellation in the expanded square."""
    return np.add.reduce(X, axis=0) / max(len(X), 1)  # five times as fast as np.mean for few rows


# -- exponentials of squared distances
# --------------------------------------------------------------------------------


class Exponent(NamedTuple):
    """Factors with left @ right.T = -|a - b|^2 / 2 for all rows a and b: one matrix product.

    Far from the origin the product would lose digits; ``far`` then selects explicit differences.
    """

    left: np.ndarray
    right: np.ndarray
    far: bool

    @classmethod
    def between(cls, a: Matrix, b: Matrix) -> Exponent:
        """Return the exponent of rows a (n_i, d) and b (n_j, d)."""
        left = np.empty((len(a), a.shape[1] + 2))
        right = np.empty((len(b), b.shape[1] + 2))
        left[:, :-2], right[:, :-2] = a, b
        left[:, -1], right[:, -2] = 1.0, 1.0
        np.einsum("nk,nk->n", a, a, out=left[:, -2])
        np.einsum("nk,nk->n", b, b, out=right[:, -1])
        left[:, -2] *= -0.5
        right[:, -1] *= -0.5
        far = bool(len(a) and len(b) and max(-left[:, -2].min(), -right[:, -1].min()) > FAR)
        return cls(left, right, far)

    def exponential(self, rows: slice, out: Matrix) -> Matrix:
        """Return the exponentials of some rows, written to ``out``."""
        if self.far:
            squares = cdist(self.left[rows, :-2], self.right[:, :-2], "sqeuclidean")
            out[:] = -0.5 * squares
        else:
            np.matmul(self.left[rows], self.right.T, out=out)
        return np.exp(out, out=out)


def strips(n_rows: int, n_columns: int) -> Iterator[slice]:
    """Return slices of the rows with about STRIP entries each."""
    step = max(8, STRIP // max(n_columns, 1))
    return (slice(a, min(a + step, n_rows)) for a in range(0, n_rows, step))


def _strip_buffer(n_rows, n_columns):
    return np.empty(min(n_rows * n_columns, STRIP + 8 * n_columns))


def weighted_sums(
    exponents: list[Exponent], W: Matrix, b: Matrix
) -> list[tuple[Vector, Vector, Matrix]]:
    """Return row sums (n_i,), column sums (n_j,) and G b (n_i, d) of G = W * exp(exponent), for each exponent.

    These are enough for the moments: the (n_i, n_j, d) array of separations is not needed.
    """
    (n_i, n_j), d = W.shape, b.shape[1]
    padded = np.column_stack([b, np.ones(n_j)])
    ones = np.ones(n_i)
    products = np.empty((len(exponents), n_i, d + 1))
    columns = np.zeros((len(exponents), n_j))
    buffer = _strip_buffer(n_i, n_j)
    for rows in strips(n_i, n_j):
        strip = W[rows]
        G = buffer[: strip.size].reshape(strip.shape)
        for k, exponent in enumerate(exponents):
            exponent.exponential(rows, G)
            np.multiply(G, strip, out=G)
            np.matmul(G, padded, out=products[k, rows])
            columns[k] += ones[rows] @ G
    return [(p[:, d], c, p[:, :d]) for p, c in zip(products, columns, strict=True)]


class CovarianceColumns:
    """Equation 16 of all outputs with given values of others, term by term, for few rows at a time.

    ``pairs`` are (FilterPair, Z) of an output and another one at inputs Z (k, d); each latent of a
    pair has k columns of its own, gain exp(-1/2 |F (x - mu - z)|^2). With x relative to a central
    point, the exponents of all columns are one product: of x^2, x and 1 with a matrix.
    """

    def __init__(self, n_features: int, pairs: list[tuple[FilterPair, Matrix]]) -> None:
        pairs = [(pair, Z) for pair, Z in pairs if len(Z)]
        self.middle = _middle(np.concatenate([np.empty((0, n_features)), *(Z for _, Z in pairs)]))
        terms = [(pair, m, Z) for pair, Z in pairs for m in range(len(pair.gain))]
        columns = [np.empty((0, 2 * n_features + 1))]
        for pair, m, Z in terms:
            b = Z - self.middle + pair.mu[m]
            linear = b * pair.Sigma[m]
            squares = np.broadcast_to(-0.5 * pair.Sigma[m], Z.shape)
            constant = -0.5 * np.einsum("kd,kd->k", b, linear)
            columns.append(np.column_stack([squares, linear, constant]))
        self.matrix = np.concatenate(columns).T
        self.far = -self.matrix[-1].min(initial=0.0) > FAR
        gains = [np.full(len(Z), pair.gain[m]) for pair, m, Z in terms]
        self.gain = np.concatenate([np.empty(0), *gains])

    def __call__(self, X: Matrix) -> Matrix:
        """Return all columns at X (n, d), (n, C)."""
        x = X - self.middle
        E = np.hstack([x * x, x, np.ones((len(x), 1))]) @ self.matrix
        np.exp(E, out=E)
        E *= self.gain
        return E

    def slopes(self, X: Array, weighted: Array, columns: slice) -> Array:
        """Return d/dX, (..., n, d), of sums over some columns, ``weighted`` (..., n, c) at X (..., n, d)."""
        d = X.shape[-1]
        sums = weighted @ self.matrix[:, columns].T
        return sums[..., d:-1] + 2.0 * sums[..., :d] * (X - self.middle)
