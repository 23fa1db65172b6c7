r"""Effects of single regressors that a search missed, by a score test.

An amplitude of zero is a stationary point of the likelihood, from which no search comes back. The
score test (Rao 1948) asks whether a process of variance v beside the kernel would raise it: with
:math:`\alpha = K^{-1} y` and the covariance C of this process for v = 1,

.. math:: s = \frac{1}{2} (\alpha^T C \alpha - \mathrm{tr}(K^{-1} C)), \quad
          I = \frac{1}{2} \mathrm{tr}(K^{-1} C K^{-1} C)

are slope and expected curvature of the log likelihood at v = 0. To second order it rises by
:math:`s^2 / 2 I`, at :math:`v = s / I`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dsymv

from skdgp._compute.linalg import cholesky_inverse, column_scale, consecutive, jittered_cholesky
from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.inference._likelihood import Data, covariance
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class MissedSettings:
    """Which effects are looked for, and which of them count."""

    #: Widths of the processes, in standard deviations of their regressor
    widths: tuple[float, ...] = (0.5, 1.0, 2.0)
    #: Inducing inputs of a process, at quantiles of its regressor, and their jitter
    n_inducing: int = 12
    jitter: float = 1e-6
    #: Rise of the log likelihood above which an effect counts: the price of amplitude and width, and
    #: of the choice among some dozens [nats]
    least_rise: float = 6.0


SETTINGS = MissedSettings()


class Effect(NamedTuple):
    """A process of one regressor for one output, and the expected rise of the log likelihood."""

    output: int
    regressor: int
    width: float
    variance: float
    rise: float


def missed_effects(
    kernel: MultiOutputKernel,
    noise: Vector,
    batches: Sequence[Data],
    X: Matrix,
    settings: MissedSettings = SETTINGS,
) -> list[Effect]:
    """Return the strongest effect of each output that the kernel lacks, if one counts.

    Parameters
    ----------
    kernel : MultiOutputKernel
    noise : ndarray (P,)
    batches : sequence of Data
        Their likelihoods add up.
    X : ndarray (n, d)
        Of all samples, which show the scales of the regressors.
    settings : MissedSettings

    Returns
    -------
    list of Effect
    """
    processes = _processes(X, settings)
    slope = np.zeros((len(batches[0].y), len(processes)))
    curvature = np.zeros_like(slope)
    for data in batches:
        of_batch = _slope_and_curvature(kernel, noise, data, processes)
        slope += of_batch[0]
        curvature += of_batch[1]
    with np.errstate(divide="ignore", invalid="ignore"):
        rise = np.where(slope > 0, slope**2 / (2.0 * curvature), 0.0)
    effects = []
    for output, best in enumerate(rise.argmax(axis=1)):
        if rise[output, best] > settings.least_rise:
            process = processes[best]
            variance = slope[output, best] / curvature[output, best]
            effects.append(
                Effect(output, process.regressor, process.width, variance, rise[output, best])
            )
    return effects


class _Process(NamedTuple):
    """A Gaussian process of one regressor with unit variance, and its inducing inputs with their factor."""

    regressor: int
    width: float
    inducing: Vector
    factor: Matrix

    def features(self, X: Matrix) -> Matrix:
        """Return features (n, m) whose inner products are the covariance."""
        cross = _gaussian(self.inducing, X[:, self.regressor], self.width)
        return solve_triangular(self.factor, cross, lower=True).T


def _processes(X, settings):
    quantiles = np.linspace(0.0, 1.0, settings.n_inducing)
    processes = []
    for k, scale in enumerate(column_scale(X)):
        inducing = np.unique(np.quantile(X[:, k], quantiles))
        if len(inducing) == 1:
            continue
        for width in scale * np.array(settings.widths):
            own = _gaussian(inducing, inducing, width) + settings.jitter * np.eye(len(inducing))
            processes.append(_Process(k, width, inducing, np.linalg.cholesky(own)))
    return processes


def _gaussian(a, b, width):
    return np.exp(-0.5 * (np.subtract.outer(a, b) / width) ** 2)


def _slope_and_curvature(kernel, noise, data, processes) -> tuple[Array, Array]:
    """Return s and I of each output and process, (P, processes)."""
    y = np.concatenate(data.y)
    with threads_for(data.n_values):
        inverse = cholesky_inverse(jittered_cholesky(lambda: covariance(kernel, noise, data)))
        alpha = dsymv(1.0, inverse, y, lower=1)
    slope = np.zeros((len(data.y), len(processes)))
    curvature = np.zeros_like(slope)
    for i, rows in enumerate(consecutive(data.y)):
        own = np.tril(inverse[rows, rows])
        own += np.tril(own, -1).T
        for k, process in enumerate(processes):
            features = process.features(data.X[i])
            projected = features.T @ own @ features
            explained = features.T @ alpha[rows]
            slope[i, k] = 0.5 * (explained @ explained - np.trace(projected))
            curvature[i, k] = 0.5 * np.sum(projected**2)
    return slope, curvature
