"""What a search for hyperparameters maximises."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.typing import Vector
from skdgp.inference._likelihood import Data, couplings, log_likelihood


class Objective:
    """The function [theta, log noise] -> log likelihood, and its gradient.

    ``n_noise`` is the length of the noise vector. ``held_out`` is data that the likelihood does not know. Where
    nothing couples outputs, this is the sum of their likelihoods: P^2 times faster. With ``common`` false it neglects
    the correlation of outputs by errors of the regressors: widths and amplitudes hardly change, but the variances of
    the regressors' noise must then be learned again.
    """

    def __init__(self, kernel: Any, data: Data, n_noise: int, held_out: Any = None, common: bool = True) -> None:
        self.kernel, self.data, self.n_noise, self.held_out = kernel, data, n_noise, held_out
        coupled = any(couplings(kernel)) or (common and data.sample_noise is not None)
        self.parts = [data] if coupled else data.by_output()
        self.theta, self.weights = np.empty(0), [np.empty(part.n_values) for part in self.parts]
        self.workspace = np.empty(max(part.n_values for part in self.parts) ** 2)

    def __call__(self, theta):
        candidate, noise = self._split(theta)
        value, gradient = 0.0, np.zeros(len(theta))
        for part, weights in zip(self.parts, self.weights, strict=True):
            n = part.n_values
            workspace = self.workspace[: n * n].reshape(n, n)
            by_part = log_likelihood(candidate, noise, part, True, workspace, weights)
            value, gradient = value + by_part[0], gradient + by_part[1]
        self.theta = np.array(theta)
        return value, gradient

    def held_out_error(self, theta: Vector) -> float:
        """Return the mean squared error of the held-out values, averaged over the outputs."""
        if not np.array_equal(theta, self.theta):  # not the last point that was evaluated
            self(theta)
        kernel, held_out = self._split(theta)[0], self.held_out
        weights = np.split(np.concatenate(self.weights), np.cumsum([len(y) for y in self.data.y])[:-1])
        errors = []
        for i, (X, y) in enumerate(zip(held_out.X, held_out.y, strict=True)):
            pairs = [(j, Xj, w) for j, (Xj, w) in enumerate(zip(self.data.X, weights, strict=True))]
            mean = sum(kernel.block(i, j, X, Xj) @ w for j, Xj, w in pairs if kernel.couples(i, j))
            errors.append(np.mean((y - mean) ** 2) if len(y) else 0.0)
        return float(np.mean(errors))

    def _split(self, theta):
        return self.kernel.clone_with_theta(theta[: -self.n_noise]), np.exp(theta[-self.n_noise :])


def theta_bounds(kernel: Any, noise_bounds):
    """Return the bounds of [theta, log noise]."""
    return np.concatenate([kernel.bounds, np.log(noise_bounds)])
