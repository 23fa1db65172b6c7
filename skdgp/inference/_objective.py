"""One likelihood as a function of hyperparameters, and its maximum from one starting point."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._likelihood import Data, Likelihood, coupled_outputs, log_likelihood
from skdgp.inference._optimizer import Optimum, maximize
from skdgp.kernels import MultiOutputKernel

#: Smallest amplitude of a normalised output that is told apart from zero
LEAST_AMPLITUDE = 1e-6


class Objective:
    """The function [theta, log noise] -> `Likelihood`, the sum over blocks of independent samples.

    ``n_noise`` is the length of the noise vector. Each block is split into groups of dependent
    outputs: where nothing couples outputs, it is P^2 times faster.
    """

    def __init__(self, kernel: MultiOutputKernel, blocks: Sequence[Data], n_noise: int) -> None:
        self.kernel = kernel
        self.n_noise = n_noise
        self.unit, self.is_signed = _units(kernel, n_noise)
        self.parts = []
        for block in blocks:
            data = block.with_loadings()
            self.parts += [data.of_outputs(outputs) for outputs in coupled_outputs(kernel, data)]

    def at(self, theta: Vector) -> tuple[MultiOutputKernel, Vector]:
        """Return the kernel and the noise of [theta, log noise]."""
        theta, log_noise = np.split(theta, [-self.n_noise])
        return self.kernel.clone_with_theta(theta), np.exp(log_noise)

    def value(self, theta: Vector) -> float:
        """Return the log likelihood, minus infinity where the covariance is not positive definite."""
        kernel, noise = self.at(theta)
        try:
            return sum(log_likelihood(kernel, noise, part) for part in self.parts)
        except np.linalg.LinAlgError:
            return -np.inf

    def __call__(self, theta: Vector) -> Likelihood:
        kernel, noise = self.at(theta)
        value, gradient, information = 0.0, np.zeros(len(theta)), np.zeros((len(theta),) * 2)
        for part in self.parts:
            of_part = log_likelihood(kernel, noise, part, eval_gradient=True)
            value += of_part.value
            gradient += of_part.gradient
            information += of_part.information
        # K is quadratic in a signed amplitude w, which changes the curvature by -g / w where w falls
        falls = self.is_signed & (theta * gradient < 0) & (np.abs(theta) > LEAST_AMPLITUDE)
        information[falls, falls] -= gradient[falls] / theta[falls]
        return Likelihood(value, gradient, information)

    def in_units(self, z: Vector) -> Likelihood:
        """Return the likelihood and its derivatives by z, theta over its unit."""
        value, gradient, information = self(z * self.unit)
        return Likelihood(
            value, gradient * self.unit, information * np.multiply.outer(self.unit, self.unit)
        )


def _units(kernel, n_noise):
    """Return the unit of each hyperparameter, and whether it is a signed amplitude.

    Logarithms, and amplitudes of normalised outputs, have the unit one, shifts half of their length scale.
    """
    units, is_signed = [], []
    for term in kernel.summands():
        for f in term.free_parameters():
            is_shift = f.name == "shift"
            is_signed.append(np.full(f.n_elements, not f.log and not is_shift))
            if is_shift and f.n_elements:
                units.append(0.5 * f.elements(term.value("length_scale")))
            else:
                units.append(np.ones(f.n_elements))
    return (
        np.concatenate([*units, np.ones(n_noise)]),
        np.concatenate([*is_signed, np.zeros(n_noise, dtype=bool)]),
    )


class Point(NamedTuple):
    """Kernel and noise where a run of the search ended, and how it ended.

    A noise vector is [sigma^2 (P)], with learned noise of the regressors [sigma^2, s (d)].
    """

    kernel: MultiOutputKernel
    noise: Vector
    end: Optimum


def climb(
    kernel: MultiOutputKernel,
    noise: Vector,
    noise_bounds: Matrix,
    blocks: Sequence[Data],
    max_iter: int,
    *,
    noise_alone: bool = False,
    stage: str = "fit",
    least: Callable[[Likelihood], float] = lambda point: -np.inf,
) -> Point:
    """Return the best kernel and noise found from these, which the kernel keeps if ``noise_alone``.

    The likelihoods of the blocks add up. The climb ends early where their sum will hardly reach
    ``least``.
    """
    objective = Objective(kernel, blocks, len(noise))
    bounds = np.concatenate([kernel.bounds, np.log(noise_bounds)])
    if noise_alone:
        bounds[: kernel.n_dims] = kernel.theta[:, None]
    start = np.concatenate([kernel.theta, np.log(noise)])
    with threads_for(max(block.n_values for block in blocks)):
        end = maximize(
            objective.in_units,
            start / objective.unit,
            bounds / objective.unit[:, None],
            max_iter=max_iter,
            stage=stage,
            least=least,
        )
    return Point(*objective.at(end.theta * objective.unit), end)
