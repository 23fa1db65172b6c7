"""Inducing features: finitely many variables that stand for the processes in sparse inference."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable

import numpy as np

from skdgp.kernels._paths import FeaturePaths, PathBundle, TrendPaths
from skdgp.kernels._rows import ExponentialRows, SumRows, TrendRows
from skdgp.kernels._waves import joint_paths

JITTER = 1e-6
"""White noise of the inducing variables, part of their definition: the bound stays a bound."""


class Features(ABC):
    """K variables u, jointly Gaussian with the outputs: Kuu (K, K), and Kfu of the ones that an output feels.

    ``theta`` holds what is variational: it changes the quality of the approximation, never the model.
    """

    size: int

    @abstractmethod
    def columns(self, i: int) -> np.ndarray:
        """Return which of the variables covary with output i, (c_i,)."""

    @abstractmethod
    def Kuu(self) -> np.ndarray:
        """Return cov(u, u), (K, K)."""

    @abstractmethod
    def Kfu(self, i: int, X) -> np.ndarray:
        """Return cov(y_i(X), u) of the columns of i, (n, c_i)."""

    @abstractmethod
    def rows(self) -> Callable[[np.ndarray], np.ndarray]:
        """Return a function X (n, d) -> Kfu of all outputs side by side, made for few samples at a time."""

    @abstractmethod
    def Kfu_derivative(self, i: int, X) -> np.ndarray:
        """Return dKfu / dX, (d, n, c_i)."""

    @abstractmethod
    def gradient_fu(self, i: int, X, W) -> np.ndarray:
        """Return sum(W * dKfu_i) by [kernel theta, features theta]."""

    @abstractmethod
    def gradient_uu(self, W) -> np.ndarray:
        """Return sum(W * dKuu) by [kernel theta, features theta]; W is symmetric."""

    @abstractmethod
    def prior_paths(self, n_paths: int, n_frequencies: int, random_state) -> tuple[PathBundle, np.ndarray]:
        """Return samples of the outputs that are functions, and u (n_paths, K), drawn with them."""

    @abstractmethod
    def paths(self, coefficients) -> PathBundle:
        """Return the functions Kfu c of the outputs, for coefficients (S, K)."""

    @property
    @abstractmethod
    def theta(self) -> np.ndarray:
        """Variational parameters."""

    @property
    @abstractmethod
    def bounds(self) -> np.ndarray:
        """Bounds on theta, (n, 2)."""

    @abstractmethod
    def theta_scale(self, scale) -> np.ndarray:
        """Return by how much each entry of theta varies, where the regressors vary by ``scale`` (d,)."""

    @abstractmethod
    def rebuild(self, kernel, theta) -> Features:
        """Return the features of another kernel of the same shape, with other variational parameters."""


class ConvolvedFeatures(Features):
    """Latent white noise smoothed by a Gaussian: u_m(z) = int T_m(z - t) x_m(t) dt, of unit variance.

    Such a variable is one more output of the same family (Alvarez et al. 2010), so every covariance is that of a
    ConvolvedGaussian with M further outputs, each fed by one latent.

    Parameters
    ----------
    kernel : ConvolvedGaussian
    Z : ndarray (M, k, d)
        Inducing inputs of each latent.
    width : ndarray (M, d)
        Length scale of each u_m.
    """

    def __init__(self, kernel, Z, width):
        self.kernel, self.Z, self.width = kernel, Z, width
        self.joint = _widened(kernel, width)
        self.fed = self.joint._value("feeds")[:, : kernel.n_outputs].astype(bool)
        self.size = Z.shape[0] * Z.shape[1]

    def _of_latent(self, m):
        k = self.Z.shape[1]
        return slice(m * k, (m + 1) * k)

    def _latents(self, i):
        return np.flatnonzero(self.fed[:, i])

    def columns(self, i):
        return np.concatenate([np.arange(self.size)[self._of_latent(m)] for m in self._latents(i)])

    def Kuu(self):
        P = self.kernel.n_outputs
        K = np.zeros((self.size, self.size))
        for m, z in enumerate(self.Z):
            K[self._of_latent(m), self._of_latent(m)] = self.joint.block(P + m, P + m, z, z)
        np.einsum("ii->i", K)[:] = 1.0 + JITTER
        return K

    def Kfu(self, i, X):
        P = self.kernel.n_outputs
        return np.hstack([self.joint.block(i, P + m, X, self.Z[m]) for m in self._latents(i)])

    def rows(self):
        P = self.kernel.n_outputs
        return ExponentialRows(self.joint, [[(P + m, self.Z[m]) for m in self._latents(i)] for i in range(P)])

    def Kfu_derivative(self, i, X):
        P = self.kernel.n_outputs
        return np.concatenate([self.joint.block_derivative(i, P + m, X, self.Z[m]) for m in self._latents(i)], axis=2)

    def gradient_fu(self, i, X, W):
        P, k = self.kernel.n_outputs, self.Z.shape[1]
        dZ, entries = np.zeros_like(self.Z), None
        for n, m in enumerate(self._latents(i)):
            part, dZ[m] = self.joint.entry_gradients(i, P + m, X, self.Z[m], W[:, n * k : (n + 1) * k], inputs=True)
            entries = part if entries is None else {name: entries[name] + part[name] for name in entries}
        return self._collect(entries, dZ)

    def gradient_uu(self, W):
        P = self.kernel.n_outputs
        dZ, entries = np.zeros_like(self.Z), None
        for m, z in enumerate(self.Z):
            own = np.array(W[self._of_latent(m), self._of_latent(m)])
            np.einsum("ii->i", own)[:] = 0.0  # the diagonal is one, whatever the parameters
            part, slope = self.joint.entry_gradients(P + m, P + m, z, z, own, inputs=True)
            dZ[m] = 2 * slope
            entries = part if entries is None else {name: entries[name] + part[name] for name in entries}
        return self._collect(entries, dZ)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        return joint_paths(self.joint, self.Z, JITTER, n_paths, n_frequencies, random_state)

    def paths(self, coefficients):
        return FeaturePaths(self, self.kernel.n_outputs, coefficients)

    def _collect(self, entries, dZ):
        """Return the gradient by [kernel theta, log width, Z] from derivatives by the joint kernel's entries."""
        P = self.kernel.n_outputs
        d_width = np.einsum("mmk->mk", entries["length_scale"][:, P:])
        d_kernel = self.kernel.pull_back({name: entry[:, :P] for name, entry in entries.items()})
        return np.concatenate([d_kernel, d_width.ravel(), dZ.ravel()])

    @property
    def theta(self):
        return np.concatenate([np.log(self.width).ravel(), self.Z.ravel()])

    @property
    def bounds(self):
        around = np.log(self.width).ravel()[:, None] + np.array([-7.0, 7.0])
        return np.concatenate([around, np.tile([-np.inf, np.inf], (self.Z.size, 1))])

    def theta_scale(self, scale):
        return np.concatenate([np.ones(self.width.size), np.tile(scale, self.Z.size // len(scale))])

    def rebuild(self, kernel, theta):
        width = np.exp(theta[: self.width.size]).reshape(self.width.shape)
        return ConvolvedFeatures(kernel, theta[self.width.size :].reshape(self.Z.shape), width)


def _widened(kernel, width):
    """Return the kernel with one more output for each latent: the latent itself, at unit variance and given width."""
    M = len(width)
    lengths = np.tile(width[:, None, :], (1, M, 1))
    extra = {"amplitude": np.eye(M), "length_scale": lengths, "feeds": np.eye(M)}
    arrays = {}
    for name in ("amplitude", "length_scale", "shift", "shear", "feeds"):
        value = kernel._value(name)
        arrays[name] = np.concatenate([value, extra.get(name, np.zeros((M, M, *value.shape[2:])))], axis=1)
    covariance_type = "full" if kernel.covariance_type == "full" else "diag"
    return type(kernel)(covariance_type=covariance_type, **arrays)


class TrendFeatures(Features):
    """The standardised weights of a trend: with them nothing is approximated."""

    def __init__(self, kernel):
        self.kernel = kernel
        self.n_weights = kernel.n_weights
        self.size = kernel.n_outputs * self.n_weights

    def columns(self, i):
        return np.arange(i * self.n_weights, (i + 1) * self.n_weights)

    def Kuu(self):
        return np.eye(self.size)

    def Kfu(self, i, X):
        return self.kernel.basis(i, X)

    def rows(self):
        return TrendRows(self.kernel)

    def Kfu_derivative(self, i, X):
        return self.kernel.basis_derivative(i, X)

    def gradient_fu(self, i, X, W):
        return self.kernel.basis_gradient(i, X, W)

    def gradient_uu(self, W):
        return np.zeros(self.kernel.n_dims)

    def prior_paths(self, n_paths, n_frequencies, random_state):
        u = random_state.standard_normal((n_paths, self.size))
        return self.paths(u), u

    def paths(self, coefficients):
        return TrendPaths(self.kernel, coefficients.reshape(len(coefficients), -1, self.n_weights))

    @property
    def theta(self):
        return np.empty(0)

    @property
    def bounds(self):
        return np.empty((0, 2))

    def theta_scale(self, scale):
        return np.empty(0)

    def rebuild(self, kernel, theta):
        return TrendFeatures(kernel)


class SumFeatures(Features):
    """The features of both terms of a sum."""

    def __init__(self, first: Features, second: Features):
        self.first, self.second = first, second
        self.size = first.size + second.size

    def columns(self, i):
        return np.concatenate([self.first.columns(i), self.first.size + self.second.columns(i)])

    def Kuu(self):
        K = np.zeros((self.size, self.size))
        n = self.first.size
        K[:n, :n], K[n:, n:] = self.first.Kuu(), self.second.Kuu()
        return K

    def Kfu(self, i, X):
        return np.hstack([self.first.Kfu(i, X), self.second.Kfu(i, X)])

    def rows(self):
        return SumRows(self.first.rows(), self.second.rows())

    def Kfu_derivative(self, i, X):
        return np.concatenate([self.first.Kfu_derivative(i, X), self.second.Kfu_derivative(i, X)], axis=2)

    def gradient_fu(self, i, X, W):
        n = len(self.first.columns(i))
        return self._order(self.first.gradient_fu(i, X, W[:, :n]), self.second.gradient_fu(i, X, W[:, n:]))

    def gradient_uu(self, W):
        n = self.first.size
        return self._order(self.first.gradient_uu(W[:n, :n]), self.second.gradient_uu(W[n:, n:]))

    def prior_paths(self, *args):
        (first, u), (second, v) = self.first.prior_paths(*args), self.second.prior_paths(*args)
        return first + second, np.hstack([u, v])

    def paths(self, coefficients):
        n = self.first.size
        return self.first.paths(coefficients[:, :n]) + self.second.paths(coefficients[:, n:])

    def _order(self, a, b):
        """Kernel thetas first, then the features'."""
        na, nb = len(a) - len(self.first.theta), len(b) - len(self.second.theta)
        return np.concatenate([a[:na], b[:nb], a[na:], b[nb:]])

    @property
    def theta(self):
        return np.concatenate([self.first.theta, self.second.theta])

    @property
    def bounds(self):
        return np.concatenate([self.first.bounds, self.second.bounds])

    def theta_scale(self, scale):
        return np.concatenate([self.first.theta_scale(scale), self.second.theta_scale(scale)])

    def rebuild(self, kernel, theta):
        n = len(self.first.theta)
        return SumFeatures(self.first.rebuild(kernel.k1, theta[:n]), self.second.rebuild(kernel.k2, theta[n:]))
