"""The covariance of two Gaussian filters of one latent process, and its derivatives.

Notation: A = 2 R R^T, Sigma = A_i (A_i + A_j)^-1 A_j = F F^T, and c is the maximum of the covariance for unit
amplitudes. The first axis of all arrays runs over the latent processes, (m, ...).
"""

from __future__ import annotations

import numpy as np


def diagonal_pair(li, lj):
    """Return c (m,) and the diagonal of F (m, d) for length scales (m, d)."""
    total = li**2 + lj**2
    return np.sqrt(2 * li * lj / total).prod(axis=1), np.sqrt(2 / total)


def full_pair(Ri, Rj):
    """Return c (m,) and F (m, d, d) for lower triangular roots (m, d, d).

    A_i + A_j and A_i^-1 + A_j^-1 are sums of squares. Their roots come from QR factorisations, which are stable for
    length scales of very different size.
    """
    log_diagonals = (np.log(np.abs(np.einsum("mkk->mk", B))).sum(axis=1) for B in (Ri, Rj, _root_of_sum(Ri, Rj)))
    log_i, log_j, log_sum = log_diagonals
    c = np.exp(0.5 * Ri.shape[-1] * np.log(2.0) + 0.5 * (log_i + log_j) - log_sum)
    # Sigma = (A_i^-1 + A_j^-1)^-1 = U^-1 U^-T, where U^T U is the sum of the inverses, A^-1 = (R^-T R^-1) / 2.
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

    Row sums, column sums and one matrix product are enough; the (n_i, n_j, d) array of separations is not needed.
    """
    rows, columns, Gb, _ = sums
    first = rows @ a - columns @ b
    if full:
        cross = a.T @ Gb
        return rows.sum(), first, (a.T * rows) @ a + (b.T * columns) @ b - cross - cross.T
    return rows.sum(), first, rows @ (a * a) + columns @ (b * b) - 2 * np.einsum("ak,ak->k", a, Gb)


def diagonal_slopes(mass, second, li, lj):
    """Return d/dlog l_i and d/dlog l_j of sum(W c exp(...)), from the moments of W c exp(...): (m, d) each."""
    total = li**2 + lj**2
    by_exponent = 2 * second / total**2  # derivative of the exponent -delta^2 / (li^2 + lj^2)
    by_factor = 0.5 * mass[:, None] * (lj**2 - li**2) / total  # derivative of sqrt(2 li lj / (li^2 + lj^2))
    return by_exponent * li**2 + by_factor, by_exponent * lj**2 - by_factor


def full_slopes(mass, second, F, R_both, R):
    """Return d/dR, (m, d, d), for the output with root R, from the moments of W c exp(...).

    With dSigma = Sigma A^-1 dA A^-1 Sigma and dlog c = tr((1/4 A^-1 - 1/2 (A_i + A_j)^-1) dA).
    """
    inverse = np.linalg.inv(precision(R))
    T = inverse @ F @ np.swapaxes(F, -1, -2)
    G = -0.5 * T @ second @ np.swapaxes(T, -1, -2)
    G += mass[:, None, None] * (0.25 * inverse - 0.5 * np.linalg.inv(sum(precision(r) for r in R_both)))
    return 4.0 * G @ R  # A = 2 R R^T
