r"""Noises of the filter-error method, by Fisher scoring of the likelihood of the innovations.

With innovations :math:`e_k` of covariance :math:`S_k = L_k L_k^T`, :math:`u = L^{-1} e`, and for the logarithm
:math:`\psi_i` of a noise :math:`d_i = L^{-1} \partial_i e` and
:math:`V_i = L^{-1} (\partial_i S) L^{-T}`,

.. math:: -\partial_i \log p = \sum_k d_i^T u + \frac{1}{2} (\operatorname{tr} V_i - u^T V_i u), \quad
          F_{ij} = \sum_k d_i^T d_j + \frac{1}{2} \operatorname{tr} V_i V_j,

(Maine & Iliff 1981).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from skdgp._compute.linalg import matrix_vector
from skdgp._compute.typing import Array, Matrix
from skdgp.dynamics import rolling_gust
from skdgp.estimation._air_parameters import PATH_ERRORS, GustProcesses, Parameters, Sums, stacked
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import (
    Linearization,
    Noise,
    Pass,
    both_sides,
    filtered,
    noise_slopes,
)

LARGEST_STEP = 0.7  # of the logarithm of a noise
NOISE_STEP = 1e-6  # of the logarithms, in slopes of the noises


class NoiseSearch:
    """Logarithms of the noises ``psi`` (p,), and their steps.

    ``noises`` have the prior medians, and the standard deviations of the logarithms.
    """

    def __init__(self, noises: Parameters, span: float) -> None:
        self.span = span
        self.prior = noises._replace(mean=np.log(noises.mean))
        self.psi = self.prior.mean.copy()
        n_free = len(self.psi) - noises.n_held
        self.last_step = np.zeros(n_free)
        self.limits = np.full(n_free, LARGEST_STEP)

    @property
    def values(self) -> dict[str, float]:
        """Noises by name."""
        return dict(zip(self.prior.names, np.exp(self.psi).tolist(), strict=True))

    def noise(self, record: Record, psi: Matrix | None = None) -> Noise:
        """Return the noises of a record, one set, or at other logarithms (s, p)."""
        psi = self.psi[None] if psi is None else psi
        value = self.prior.values(np.exp(psi), record.flight)
        gusts = GustProcesses.of(self.prior.values(np.exp(self.psi), record.flight))
        speed = record.airspeed
        roll = rolling_gust(speed, self.span, gusts.std[2], speed * gusts.time[2])
        return air_noise(value, record, roll)

    def move(self, records: list[Record], linears: list[Linearization]) -> float:
        """Move the noises by a step of Fisher scoring; return its squared length in standard deviations.

        ``linears`` are parts of the records' linearizations, which represent the full records.
        """
        sums = Sums(self.psi, self.prior)
        for record, linear in zip(records, linears, strict=True):
            places = self.prior.free_places(record.flight)
            moves = np.zeros((len(places), len(self.psi)))
            moves[:, places] = NOISE_STEP * np.eye(len(places))
            noise = self.noise(record)
            beside = self.noise(record, self.psi + moves)
            change = [(later - now) / NOISE_STEP for later, now in zip(beside, noise, strict=True)]
            filter_pass = filtered(linear, noise)
            slopes = noise_slopes(linear, filter_pass, noise, Noise(*change))
            gradient, fisher = _likelihood_slopes(filter_pass, slopes)
            weight = len(record.time_step) / len(linear.time_step)
            sums.add(places, weight * gradient, weight * fisher)
        # damping of steps of the noises, over the information
        information, score = sums.damped(0.02)
        step: Any = -np.linalg.solve(information, score)
        # half as large where it turns back: noises near zero overshoot
        factor = np.where(step * self.last_step < 0, 0.5, 1.3)
        self.limits = np.minimum(self.limits * factor, LARGEST_STEP)
        self.last_step = np.clip(step, -self.limits, self.limits)
        # farthest that the logarithm of a noise moves from its prior mean, in standard deviations: noise of
        # slow sensors resembles fast gusts
        reach = 2.0 * self.prior.std
        before = self.psi.copy()
        self.psi[sums.free] += self.last_step
        self.psi[sums.free] = np.clip(self.psi, self.prior.mean - reach, self.prior.mean + reach)[
            sums.free
        ]
        return sums.squared_length((self.psi - before)[sums.free])


def air_noise(value: Mapping[str, Any], record: Record, roll: tuple[Any, float]) -> Noise:
    """Return the noises of a record at parameters by name, each (s,).

    ``roll`` are standard deviation and correlation time of the rate of roll of the air, by the spectrum
    that belongs to the vertical gusts that were found. They do not move with the gusts of ``value``, as
    noise of the rates of the aircraft is no evidence of gusts, but with their own intensity, near one.
    """
    gusts = GustProcesses.of(value)
    roll_std, roll_time = (np.full_like(value["time_v"][..., None], number) for number in roll)
    path_std = stacked(value, *PATH_ERRORS)
    # correlation time of errors of the path [s]; guess
    path_time = np.full_like(path_std, 10.0)
    drive = stacked(value, "drive_p", "drive_q", "drive_r")
    std = np.concatenate([gusts.std, path_std, value["rolling"][..., None] * roll_std], axis=-1)
    time = np.concatenate([gusts.time, path_time, roll_time], axis=-1)
    # variance of the rates of the first sample [(rad/s)^2]; wide
    start_rates = np.full_like(drive, 0.1)
    inertial = stacked(value, "ax", "ay", "az", "gyro", "gyro", "gyro")
    air = stacked(value, "airspeed", "vane", "vane")
    sensors = np.concatenate([inertial, air], axis=-1)
    return Noise(
        density=np.concatenate([2 * std**2 / time, drive**2], axis=-1),  # of Gauss-Markov processes
        decay=np.concatenate([1 / time, np.zeros_like(drive)], axis=-1),
        surface=value["surface"] ** 2,
        sensor=sensors[..., record.sampled] ** 2,
        start=np.concatenate([std**2, start_rates], axis=-1),
    )


def _likelihood_slopes(
    filter_pass: Pass, slopes: Iterable[tuple[slice, Array, Array]]
) -> tuple[Any, Any]:
    """Return gradient and Fisher information of -log likelihood, by slopes of innovations and covariances."""
    L_inverse = np.linalg.inv(np.linalg.cholesky(filter_pass.innovation_covariance))
    whitened = matrix_vector(L_inverse, filter_pass.innovations)
    gradient: Any = 0.0
    fisher: Any = 0.0
    for steps, de, dS in slopes:
        u = whitened[steps]
        d = (L_inverse[steps] @ de).swapaxes(1, 2)  # (k, s, m)
        V = both_sides(L_inverse[steps], dS).swapaxes(1, 2)  # (k, s, m, m)
        excess = np.eye(u.shape[1]) - u[:, :, None] * u[:, None]
        gradient = gradient + np.einsum("ksm,km->s", d, u)
        gradient = gradient + 0.5 * np.einsum("ksmn,kmn->s", V, excess)
        for rows in (d, np.sqrt(0.5) * V):
            J = rows.swapaxes(0, 1).reshape(rows.shape[1], -1)
            fisher = fisher + J @ J.T
    return gradient, fisher
