r"""Noises of the filter-error method, by Fisher scoring of the likelihood of the innovations.

With innovations :math:`e_k` of covariance :math:`S_k = L_k L_k^T`, :math:`u = L^{-1} e`, and for the logarithm
:math:`\psi_i` of a noise :math:`d_i = L^{-1} \partial_i e` and
:math:`V_i = L^{-1} (\partial_i S) L^{-T}`,

.. math:: -\partial_i \log p = \sum_k d_i^T u + \frac{1}{2} (\operatorname{tr} V_i - u^T V_i u), \quad
          F_{ij} = \sum_k d_i^T d_j + \frac{1}{2} \operatorname{tr} V_i V_j,

(Maine & Iliff 1981). Derivatives are differences between passes of the filter at sets of noises.
"""

from __future__ import annotations

import numpy as np

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.estimation._air_linearization import air_noise
from skdgp.estimation._air_parameters import Parameters
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import Innovations, Linearization, Noise, innovations
from skdgp.estimation._settings import AirSettings


class NoiseSearch:
    """Logarithms of the noises ``psi`` (p,), and their steps."""

    def __init__(self, noises: Parameters, settings: AirSettings) -> None:
        self.noises = noises
        self.settings = settings
        self.prior_mean = np.log(noises.mean)
        self.psi = self.prior_mean.copy()
        self.last = np.zeros(len(self.psi))
        self.limits = np.full(len(self.psi), settings.largest_noise_step)

    @property
    def values(self) -> dict[str, float]:
        """Noises by name."""
        return dict(zip(self.noises.names, np.exp(self.psi).tolist(), strict=True))

    def noise(self, record: Record) -> Noise:
        """Return the noises of a record, one set."""
        return self._sets(self.psi[None], record)

    def _sets(self, psi: Matrix, record: Record) -> Noise:
        """Return the noises of a record at logarithms (s, p)."""
        value = self.noises.values(np.exp(psi), record.flight)
        return air_noise(value, record.sampled, self.settings)

    def step(self, records: list[Record], linears: list[Linearization]) -> float:
        """Move the noises by a step of Fisher scoring; return its squared length in standard deviations.

        ``linears`` are parts of the records' linearizations, which represent the full records.
        """
        precision = self.noises.std**-2.0
        information = np.diag(precision)
        score = (self.psi - self.prior_mean) * precision
        difference = self.settings.noise_difference
        for record, linear in zip(records, linears, strict=True):
            places = self.noises.free_places(record.flight)
            sets = np.tile(self.psi, (len(places) + 1, 1))
            sets[np.arange(1, len(places) + 1), places] += difference
            run = innovations(linear, self._sets(sets, record))
            gradient, fisher = _likelihood_slopes(run, difference)
            weight = len(record.step) / len(linear.step)
            score[places] += weight * gradient
            information[np.ix_(places, places)] += weight * fisher
        free = self.noises.free
        information, score = information[free, free], score[free]
        damped = information + self.settings.noise_damping * np.diag(np.diag(information))
        step = self._limited(np.asarray(-np.linalg.solve(damped, score), dtype=float))
        self.psi[free] += step
        return float(step @ information @ step)

    def _limited(self, step: Vector) -> Vector:
        """Return the step within limits, half as large where it turns back: noises near zero overshoot."""
        free = self.noises.free
        turns_back = step * self.last[free] < 0
        limits = self.limits[free] * np.where(turns_back, 0.5, 1.3)
        limits = np.minimum(limits, self.settings.largest_noise_step)
        step = np.clip(step, -limits, limits)
        self.limits[free] = limits
        self.last[free] = step
        return step


def _likelihood_slopes(run: Innovations, difference: float) -> tuple[Vector, Matrix]:
    """Return gradient and Fisher information of -log likelihood, by differences of the sets to the first."""
    e, S = run.values[:, 0], run.covariance[:, 0]
    L_inverse = np.linalg.inv(np.linalg.cholesky(S))
    u = whitened(L_inverse, e)
    gradient = []
    rows = []
    for moved in range(1, run.values.shape[1]):
        d = whitened(L_inverse, (run.values[:, moved] - e) / difference)
        dS = (run.covariance[:, moved] - S) / difference
        V = L_inverse @ dS @ L_inverse.mT
        trace = np.einsum("nii->", V) - np.einsum("ni,nij,nj->", u, V, u)
        gradient.append(np.sum(d * u) + 0.5 * trace)
        rows.append(np.concatenate([d.ravel(), np.sqrt(0.5) * V.ravel()]))
    J = np.array(rows)
    return np.array(gradient), J @ J.T


def whitened(L_inverse: Array, vectors: Matrix) -> Matrix:
    """Return L^-1 e of each sample, (n, m)."""
    return (L_inverse @ vectors[..., None])[..., 0]
