r"""Equations 15 and 16: Gaussian filters of white noise, and the covariance of two outputs.

Latent process m reaches output i through the filter (Hemakumara & Sukkarieh 2011)

    h_mi(s) = v_mi exp(-1/2 (s - mu_mi)^T A_mi (s - mu_mi)).                                   (15)

With the separation delta = s - s', mu = mu_mi - mu_mj and Sigma = A_mi (A_mi + A_mj)^-1 A_mj, the
covariance of outputs i and j is

    cov_ij = sum_m (2 pi)^(d/2) v_mi v_mj |A_mi + A_mj|^(-1/2)
                   exp(-1/2 (delta - mu)^T Sigma (delta - mu)).                                (16)

The amplitude w = v pi^(d/4) |A|^(-1/4) replaces v, so that cov_ii(0) = sum_m w_mi^2. The factor of
the exponential is then the gain w_mi w_mj c, where c depends on the two widths alone and is 1 for
equal ones. A is diagonal, so Sigma is too. The first axis of all arrays runs over the latent
processes, (m, ...).

As a function of s, each latent adds a Gaussian function with the gain, the precision Sigma and the
centre s' + mu. A `GaussianBasis` of such functions evaluates covariances, their gradients, means,
slopes and sample paths alike.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.kernels._base import add_at

FAR = 1e9  # exponent above which cancellation, relatively about 1e-16, becomes visible


class GaussianBasis:
    r"""Gaussian functions of the regressors.

    .. math:: g_c(x) = \exp\left(-\frac{1}{2} \sum_k \Sigma_{ck} (x_k - z_{ck})^2\right)

    The exponents of all functions are one matrix product, (x^2, x, 1) M, with x and z relative to
    the mean of the centres, which avoids cancellation.

    Parameters
    ----------
    precision : array (C, d)
        Diagonals of Sigma.
    centres : array (C, d)
        z.
    """

    def __init__(self, precision: Matrix, centres: Matrix) -> None:
        self.precision = precision
        self.centres = centres
        self.middle = np.add.reduce(centres, axis=0) / max(len(centres), 1)
        centred = centres - self.middle
        linear = precision * centred
        constant = -0.5 * np.einsum("ck,ck->c", linear, centred)
        self._matrix = np.vstack([-0.5 * precision.T, linear.T, constant])
        self._far = -constant.min(initial=0.0) > FAR

    @classmethod
    def joined(cls, parts: Sequence[GaussianBasis]) -> GaussianBasis:
        """Return the functions of several bases, one after another."""
        precision = np.concatenate([part.precision for part in parts])
        return cls(precision, np.concatenate([part.centres for part in parts]))

    def __call__(self, X: Matrix) -> Matrix:
        """Return all functions at X (n, d), (n, C)."""
        if self._far:
            values = self._exponents_of_differences(X)
        else:
            values = self._powers(X) @ self._matrix
        return np.exp(values, out=values)

    def _powers(self, X):
        """Return (x^2, x, 1), (n, 2 d + 1)."""
        x = X - self.middle
        d = x.shape[1]
        powers = np.ones((len(x), 2 * d + 1))
        np.multiply(x, x, out=powers[:, :d])
        powers[:, d:-1] = x
        return powers

    def _exponents_of_differences(self, X):
        """Return the exponents (n, C) of centres so far apart that expanded squares would cancel."""
        exponents = np.zeros((len(X), len(self.centres)))
        for x, centre, precision in zip(X.T, self.centres.T, self.precision.T, strict=True):
            exponents -= 0.5 * precision * np.subtract.outer(x, centre) ** 2
        return exponents

    def slopes(self, X: Array, weights: list[Matrix], columns: list[slice]) -> Array:
        """Return the slopes at X (S or 1, n, d) of sums of some functions for each output, (S, n, P, d).

        ``weights`` (S, c) belong to the functions in the columns of each output.
        """
        n_functions, n, d = X.shape
        values = self(X.reshape(-1, d)).reshape(n_functions, n, len(self.centres))
        slopes = []
        for w, places in zip(weights, columns, strict=True):
            weighted = values[..., places] * w[:, None]
            # one product of matrices, as many small ones take longer
            sums = weighted.reshape(len(weighted) * n, w.shape[1]) @ self._matrix[:, places].T
            sums = sums.reshape(*weighted.shape[:2], 2 * d + 1)
            slopes.append(sums[..., d:-1] + 2.0 * sums[..., :d] * (X - self.middle))
        return np.stack(slopes, axis=2)

    def averaged(self, spread: Vector) -> tuple[GaussianBasis, Vector]:
        r"""Return the expected functions at x + e, :math:`e_k \sim N(0, s_k^2)`: wider ones and their factors.

        With the variance :math:`\Sigma^{-1} + s^2` for :math:`\Sigma^{-1}` the integral of each is
        the same (Rasmussen & Williams 2006, equation A.6).
        """
        wider = 1.0 + self.precision * spread**2
        basis = GaussianBasis(self.precision / wider, self.centres)
        return basis, 1.0 / np.sqrt(wider.prod(axis=1))


class Moments(NamedTuple):
    """Sums of weights G over the columns: of G, (n, m), of G (x - z) and of G (x - z)^2, (n, m, d)."""

    zeroth: Matrix
    first: Array
    second: Array


class PairSlopes(NamedTuple):
    """Derivatives by the parameters of two outputs, n rows of each.

    By the amplitudes (2, n, m), by the logarithms of the length scales (2, n, m, d), and by
    mu_i - mu_j (n, m, d).
    """

    by_amplitude: Array
    by_width: Array
    by_shift: Array


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
    Sigma : array (m, d)
        Diagonals of Sigma.
    """

    def __init__(self, w: Array, widths: Array, mu: Matrix) -> None:
        self.w = w
        self.widths = widths
        self.mu = mu
        li, lj = widths
        self.squares = li**2 + lj**2
        self.c = np.sqrt(2 * li * lj / self.squares).prod(axis=1)
        self.Sigma = 2 / self.squares
        self.gain = self.c * w[0] * w[1]

    def basis(self, Z: Matrix) -> GaussianBasis:
        """Return the exponentials of each latent in turn for output j at Z (k, d), (m k) functions."""
        m, d = self.mu.shape
        precision = np.repeat(self.Sigma, len(Z), axis=0)
        centres = (self.mu[:, None] + Z).reshape(m * len(Z), d)
        return GaussianBasis(precision, centres)

    def covariance(self, Xi: Matrix, Xj: Matrix) -> Matrix:
        """Return equation 16 at all pairs of rows, (n_i, n_j)."""
        return EvaluatedPair(self, Xi, Xj, ()).covariance()

    def slopes(self, moments: Moments) -> PairSlopes:
        """Return the derivatives by the parameters of both outputs from moments of the exponentials."""
        scaled = self.c * moments.zeroth
        by_w = np.stack([scaled * self.w[1], scaled * self.w[0]])
        gain = self.gain[:, None]
        li, lj = self.widths
        # of -delta^2 / (l_i^2 + l_j^2), and of the factor sqrt(2 l_i l_j / (l_i^2 + l_j^2))
        by_exponent = 2 * gain * moments.second / self.squares**2
        by_factor = 0.5 * gain * moments.zeroth[..., None] * (lj**2 - li**2) / self.squares
        by_li = by_exponent * li**2 + by_factor
        by_lj = by_exponent * lj**2 - by_factor
        return PairSlopes(by_w, np.stack([by_li, by_lj]), self.Sigma * gain * moments.first)


class EvaluatedPair:
    """Equation 16 at pairs of rows Xi (n_i, d) and Xj (n_j, d), with the exponential of each latent.

    ``places`` are those in theta of the amplitudes, widths and shifts of both outputs.
    """

    def __init__(
        self,
        pair: FilterPair,
        Xi: Matrix,
        Xj: Matrix,
        places: Sequence[tuple[Indices, Indices]],
    ) -> None:
        self.pair = pair
        self.places = places
        self.Xi = Xi
        self.Xj = Xj
        self.basis = pair.basis(Xj)
        self.exponentials = self.basis(Xi).reshape(len(Xi), len(pair.gain), len(Xj))

    def covariance(self) -> Matrix:
        """Return equation 16, (n_i, n_j)."""
        return np.einsum("m,nmk->nk", self.pair.gain, self.exponentials)

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        """Add the derivatives of sum(W * cov_ij) by theta."""
        rows = self._moments(self.exponentials * W[:, None], np.ones(len(self.Xj)), False)
        moments = Moments(*(part.sum(axis=0, keepdims=True) for part in rows))
        self._add(total[None], self.pair.slopes(moments))

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        """Add the derivatives of cov_ij beta, beta (n_j,), or of cov_ij^T beta, beta (n_i,)."""
        self._add(total, self.pair.slopes(self._moments(self.exponentials, beta, transposed)))

    def _add(self, total, slopes):
        """Add derivatives of n rows to ``total`` (n, n_theta)."""
        of_shifts = (slopes.by_shift, -slopes.by_shift)
        of_parameters = (slopes.by_amplitude, slopes.by_width, of_shifts)
        for places, of_outputs in zip(self.places, of_parameters, strict=True):
            for of_output, part in zip(places, of_outputs, strict=True):
                # places differ: those of tied length scales are of different latents
                add_at(total, of_output, part)

    def _moments(self, exponentials, beta, transposed):
        """Return the moments of exponentials (n_i, m, n_j) times ``beta`` of the columns, or of the rows."""
        rows, columns = (self.Xj, self.Xi) if transposed else (self.Xi, self.Xj)
        sign = -1.0 if transposed else 1.0
        x = (rows - self.basis.middle)[:, None] - sign * self.pair.mu
        z = columns - self.basis.middle
        d = z.shape[1]
        powers = beta[:, None] * np.hstack([np.ones((len(z), 1)), z, z * z])
        order = (1, 2, 0) if transposed else (1, 0, 2)
        sums = (exponentials.transpose(order) @ powers).swapaxes(0, 1)
        zeroth = sums[..., :1]
        of_z = sums[..., 1 : d + 1]
        second = sums[..., d + 1 :] + x * (x * zeroth - 2.0 * of_z)
        first = sign * (x * zeroth - of_z)
        return Moments(zeroth[..., 0], first, second)
