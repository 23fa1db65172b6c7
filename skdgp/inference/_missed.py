r"""Effects of single regressors that a search missed.

An amplitude of zero is a stationary point of the likelihood, from which no search comes back. So
processes of one regressor and one output are tried beside the kernel. With features
:math:`\Phi` of such a process of variance 1, the eigenvalues :math:`\lambda_j` and eigenvectors
U of :math:`\Phi^T K^{-1} \Phi`, and :math:`t = U^T \Phi^T K^{-1} y`, a variance v raises the log
likelihood by

.. math:: \frac{1}{2} \sum_j \left(\frac{v t_j^2}{1 + v \lambda_j} - \log(1 + v \lambda_j)\right),

by the matrix determinant lemma (Rasmussen & Williams 2006, equations A.9 and A.10).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_triangular
from scipy.linalg.blas import dsymv

from skdgp._compute.linalg import (
    cholesky_inverse,
    column_scale,
    consecutive,
    jittered_cholesky,
    symmetric,
)
from skdgp._compute.parallel import threads_for
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._likelihood import Data, covariance
from skdgp.kernels import MultiOutputKernel


@dataclass(frozen=True)
class MissedSettings:
    """Which effects are looked for, and which of them count."""

    #: Widths of the processes, in standard deviations of their regressor
    widths: tuple[float, ...] = (0.5, 1.0, 2.0)
    #: Least and largest variance over that of the output, and their number
    variances: tuple[float, float, int] = (1e-4, 10.0, 26)
    #: Inducing inputs of a process, at quantiles of its regressor, and their jitter
    n_inducing: int = 12
    jitter: float = 1e-6
    #: Rise of the log likelihood above which an effect counts [nats]: chance explains it in one of
    #: 2000 processes
    least_rise: float = 4.0


SETTINGS = MissedSettings()


class Effect(NamedTuple):
    """A process of one regressor for one output.

    ``width`` has the unit of the regressor, ``variance`` the squared unit of the output. ``rise`` is
    how far the process raises the log likelihood [nats].
    """

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
        Regressors of all samples.
    settings : MissedSettings

    Returns
    -------
    list of Effect
    """
    processes = _processes(X, settings)
    variances = []
    for y in zip(*(data.y for data in batches), strict=True):
        variances.append(np.var(np.concatenate(y)) * np.geomspace(*settings.variances))
    rises = np.zeros((len(variances), len(processes), settings.variances[2]))
    for data in batches:
        _add_rises(rises, kernel, noise, data, processes, variances)
    effects = []
    for output, of_output in enumerate(rises):
        best, k = np.unravel_index(of_output.argmax(), of_output.shape)
        rise = float(of_output[best, k])
        if rise > settings.least_rise:
            process = processes[best]
            variance = float(variances[output][k])
            effects.append(Effect(output, process.regressor, process.width, variance, rise))
    return effects


class _Process(NamedTuple):
    """A Gaussian process of one regressor with unit variance, its inducing inputs and their factor."""

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
            processes.append(_Process(k, float(width), inducing, np.linalg.cholesky(own)))
    return processes


def _gaussian(a, b, width):
    return np.exp(-0.5 * (np.subtract.outer(a, b) / width) ** 2)


def _add_rises(rises, kernel, noise, data, processes, variances):
    """Add the rises of a batch (P, processes, variances)."""
    y = np.concatenate(data.y)
    with threads_for(data.n_values):
        inverse = cholesky_inverse(jittered_cholesky(lambda: covariance(kernel, noise, data)))
        alpha = dsymv(1.0, inverse, y, lower=1)
    for i, rows in enumerate(consecutive(data.y)):
        own = symmetric(inverse[rows, rows])
        for k, process in enumerate(processes):
            features = process.features(data.X[i])
            values, vectors = np.linalg.eigh(features.T @ own @ features)
            explained = vectors.T @ (features.T @ alpha[rows])
            growth = np.multiply.outer(variances[i], np.maximum(values, 0.0))
            gain = np.multiply.outer(variances[i], explained**2) / (1.0 + growth)
            rises[i, k] += 0.5 * np.sum(gain - np.log1p(growth), axis=-1)
