"""One likelihood as a function of hyperparameters, and its maximum from one starting point."""

from __future__ import annotations

from dataclasses import dataclass
from threading import Event
from typing import NamedTuple

import numpy as np
from scipy.linalg import hadamard

from skdgp._compute.linalg import constant_columns
from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._likelihood import Data, coupled_outputs, log_likelihood
from skdgp.inference._optimizer import OptimizerSettings, Optimum, maximize
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class ScaleSettings:
    """How the scale of hyperparameters is estimated."""

    #: Most values that show it, in 7 halves: as much time as two evaluations of 1800 values
    values: int = 400
    #: Groups of samples that form half-samples, a power of two
    groups: int = 8


SCALE = ScaleSettings()


class Objective:
    """The function [theta, log noise] -> log likelihood, and its gradient.

    ``n_noise`` is the length of the noise vector. This is the sum of the likelihoods of
    ``n_batches`` of the samples, as if these were independent, and of groups of dependent outputs:
    where nothing couples outputs, P^2 times faster.
    With ``common`` false it neglects the correlation of outputs by errors of the regressors: widths
    and amplitudes hardly change, but the variances of the regressors' noise must then be learned
    again.
    """

    def __init__(
        self,
        kernel: MultiOutputKernel,
        data: Data,
        n_noise: int,
        common: bool = True,
        n_batches: int = 1,
    ) -> None:
        self.kernel = kernel
        self.n_noise = n_noise
        self.common = common
        self.data = data = data.with_loadings()
        groups = coupled_outputs(kernel, data, common)
        batches = data.batches(n_batches)
        self.parts = [batch.of_outputs(outputs) for batch in batches for outputs in groups]

    def at(self, theta: Vector) -> tuple[MultiOutputKernel, Vector]:
        """Return the kernel and the noise of [theta, log noise]."""
        theta, log_noise = np.split(theta, [-self.n_noise])
        return self.kernel.clone_with_theta(theta), np.exp(log_noise)

    def scale(self, theta: Vector, settings: ScaleSettings = SCALE) -> Vector:
        r"""Return the lengths (n,) over which the likelihood changes by about one at [theta, log noise].

        These are :math:`(1 + F)^{-1/2}` with the Fisher information F of each hyperparameter, the
        variance of the gradient. Half-samples show it: balanced ones of g groups (McCarthy 1969),
        whose gradients have a quarter of this variance. A hyperparameter without information may
        change by a factor of e.
        """
        data = self.data.every(-(-self.data.n_values // settings.values))
        gradients = []
        for half in hadamard(settings.groups)[1:] > 0:
            objective = Objective(self.kernel, data.chosen_in_turn(half), self.n_noise, self.common)
            try:
                gradients.append(objective(theta)[1])
            except np.linalg.LinAlgError:
                return np.ones(len(theta))
        information = 4 * np.var(gradients, axis=0) * self.data.n_values / data.n_values
        return 1.0 / np.sqrt(1.0 + information)

    def __call__(self, theta: Vector) -> tuple[float, Vector]:
        kernel, noise = self.at(theta)
        value, gradient = 0.0, np.zeros(len(theta))
        for part in self.parts:
            of_part, slope = log_likelihood(kernel, noise, part, eval_gradient=True)
            value += of_part
            gradient += slope
        return value, gradient


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
    data: Data,
    max_iter: int,
    stop: Event,
    *,
    optimizer: OptimizerSettings,
    common: bool = True,
    noise_alone: bool = False,
    n_batches: int = 1,
    stage: str = "fit",
) -> Point:
    """Return the best kernel and noise found from these, which the kernel keeps if ``noise_alone``.

    The likelihoods of ``n_batches`` of the samples add up.
    """
    objective = Objective(kernel, data, len(noise), common, n_batches)
    bounds = np.concatenate([kernel.bounds, np.log(noise_bounds)])
    if noise_alone:
        bounds[: kernel.n_dims] = kernel.theta[:, None]
    start = np.concatenate([kernel.theta, np.log(noise)])
    # With more regressors than outputs most hyperparameters are widths, whose information differs
    # most. Elsewhere searches in units of the information end at lower maxima (published sets, yacht).
    n_regressors = np.sum(~constant_columns(np.concatenate(data.X)))
    has_many_widths = 1 < kernel.n_outputs < n_regressors
    with threads_for(data.n_values):
        end = maximize(
            objective,
            start,
            bounds,
            stop,
            max_iter=max_iter,
            stage=stage,
            scale=objective.scale if has_many_widths else None,
            settings=optimizer,
        )
    return Point(*objective.at(end.theta), end)
