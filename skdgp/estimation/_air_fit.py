r"""Search of the filter-error method: passes of the filter over the records, in turn with steps of the parameters.

With innovations :math:`e_k` of covariance :math:`S_k = L_k L_k^T`, :math:`D_k = \partial e_k / \partial \theta`
at given gains and the projection P on instruments, a pass sums score and information,

.. math:: g = \sum_k Z_k^T L_k^{-1} e_k + \Lambda (\theta - \theta_0), \quad
          A = \sum_k Z_k^T L_k^{-1} D_k + \Lambda, \quad Z_k = P (L_k^{-1} D_k),

and a damped Gauss-Newton step solves :math:`A\,\Delta\theta = -g` (Jategaonkar 2015, chapter 5; instrumental
variables: Soderstrom & Stoica 1989, chapter 8). Noises move by Fisher scoring (``_air_noise.py``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp.dynamics import Aircraft
from skdgp.estimation._air_linearization import TURN, Layout, linearized
from skdgp.estimation._air_noise import NoiseSearch, whitened
from skdgp.estimation._air_parameters import PATH_ERRORS, WINDS, Parameters
from skdgp.estimation._air_records import Record
from skdgp.estimation._air_start import (
    LinearEquation,
    SteadyRegression,
    SteadyWind,
    mean_lift,
    pitot_equation,
    steady_wind,
)
from skdgp.estimation._kalman import Linearization, Pass, filtered, innovation_slopes
from skdgp.estimation._settings import AirSettings


class Sums:
    """Score, information and scatter of the parameters that the passes over all records sum."""

    def __init__(self, x: Vector, parameters: Parameters) -> None:
        precision = parameters.std**-2.0
        self.information = np.diag(precision)
        self.score = (x - parameters.mean) * precision
        self.scatter = np.diag(precision)  # covariance of the score
        self.blocks: list[Matrix] = []  # (b, p) scores summed over blocks

    def add_equation(self, equation: LinearEquation) -> None:
        """Add linear equations of some parameters, known with their variance."""
        block = np.ix_(equation.places, equation.places)
        fisher = equation.slopes.T @ equation.slopes / equation.variance
        self.information[block] += fisher
        self.scatter[block] += fisher
        self.score[equation.places] += equation.slopes.T @ equation.residual / equation.variance

    def add_record(self, places: Indices, Z: Array, D: Array, e: Matrix, width: int) -> None:
        """Add instruments Z, slopes D (n, m, k) and innovations e (n, m), whitened; blocks of ``width`` samples."""
        block = np.ix_(places, places)
        self.information[block] += np.tensordot(Z, D, axes=((0, 1), (0, 1)))
        self.scatter[block] += np.tensordot(Z, Z, axes=((0, 1), (0, 1)))
        scores = np.einsum("nmk,nm->nk", Z, e)
        self.score[places] += scores.sum(axis=0)
        starts = np.arange(0, len(scores), width)
        blocks = np.zeros((len(starts), len(self.score)))
        blocks[:, places] = np.add.reduceat(scores, starts, axis=0)
        self.blocks.append(blocks)


class FittedRecord(NamedTuple):
    """A record with its last pass."""

    record: Record
    linear: Linearization
    run: Pass


class AirFit:
    """Parameters x, noises and filtered states of the records, which `search` improves.

    Where derivatives are held, as of a known aircraft, score and information have no instruments.
    """

    def __init__(
        self,
        records: list[Record],
        aircraft: Aircraft,
        layout: Layout,
        parameters: Parameters,
        noises: Parameters,
        settings: AirSettings,
    ) -> None:
        self.records = records
        self.aircraft = aircraft
        self.layout = layout
        self.parameters = parameters
        self.noise_search = NoiseSearch(noises, settings)
        self.settings = settings
        self.is_known = parameters.n_held > 0
        self.regression = SteadyRegression(aircraft, layout, parameters)
        self.winds = self._steady_winds()
        self.x = parameters.mean.copy()
        for flight, wind in enumerate(self.winds):
            self.x[parameters.places_of(flight, WINDS[:2])] = wind.pitot[1:]
        if not self.is_known:
            self.x = self.regression.derivatives(records, self.x)
        # rates as measured, without gusts
        before = ((0, 0), (TURN.start, 0))
        self.states = [np.pad(record.rates, before) for record in records]

    def _steady_winds(self) -> list[SteadyWind]:
        """Return wind and pitot of each flight by its airspeed."""
        winds = []
        for flight in range(len(self.parameters.places)):
            records = [record for record in self.records if record.flight == flight]
            winds.append(steady_wind(records, self.settings))
        return winds

    def search(self, n_before: int) -> bool:
        """Improve parameters and noises; return whether the search converged to a plausible solution.

        The first ``n_before`` passes use no instruments. Raise LinAlgError if the search diverges.
        """
        settings = self.settings
        damping = settings.first_damping
        fraction = 1.0
        free = self.parameters.free
        last = np.zeros(len(self.x[free]))
        small = converged = False
        for number in range(settings.max_passes):
            sums, fitted = self.run(by_instruments=number >= n_before)
            self.records = [item.record for item in fitted]
            self.states = [item.run.states for item in fitted]
            information = sums.information[free, free]
            damped = information + damping * np.diag(np.diag(information))
            step = self._bounded_step(damped, sums.score[free])
            if not np.isfinite(step).all():
                raise np.linalg.LinAlgError
            # two solutions could follow each other for ever
            if step @ damped @ last < 0:
                fraction = max(settings.shorter * fraction, settings.least_fraction)
            else:
                fraction = min(settings.longer * fraction, 1.0)
            self.x[free] += fraction * step
            last = step
            noise_length = np.inf
            if number:
                linears = [item.linear.middle(settings.noise_samples) for item in fitted]
                noise_length = self.noise_search.step(self.records, linears)
            before = small
            small = bool(step @ information @ step < settings.tolerance)
            converged = before and small and noise_length < settings.noise_tolerance
            if converged and number > n_before:
                break
            damping /= 4
        return converged and self._is_plausible()

    def _is_plausible(self) -> bool:
        """Return whether errors of the path are as small as attitude and GPS make them."""
        noises = self.noise_search.noises
        largest = 0.0
        for flight in range(len(noises.places)):
            places = noises.places_of(flight, PATH_ERRORS)
            largest = max(largest, np.exp(self.noise_search.psi[places]).max())
        return bool(largest < self.settings.largest_path_error)

    def _bounded_step(self, information: Matrix, score: Vector) -> Vector:
        """Return the step of the free parameters, with a lag that stays at or above zero."""
        step = np.asarray(-np.linalg.solve(information, score), dtype=float)
        lag = self.parameters.names.index("servo_lag")
        place = lag - self.parameters.n_held
        if place >= 0 and self.x[lag] + step[place] < 0:
            free = np.arange(len(step)) != place
            step[place] = -self.x[lag]
            gradient = score[free] + information[free, place] * step[place]
            step[free] = -np.linalg.solve(information[np.ix_(free, free)], gradient)
        return step

    def run(self, by_instruments: bool = True) -> tuple[Sums, list[FittedRecord]]:
        """Filter all records at the parameters; return sums of the parameters, and the filtered records."""
        sums = Sums(self.x, self.parameters)
        if not self.is_known:
            self._add_steady_equations(sums)
        fitted = []
        for record, states in zip(self.records, self.states, strict=True):
            linear = self.linearized(record, states)
            run = filtered(linear, self.noise_search.noise(record))
            fitted.append(self._add_scores(sums, FittedRecord(record, linear, run), by_instruments))
        return sums, fitted

    def _add_steady_equations(self, sums: Sums) -> None:
        """Add mean lift and airspeed of each record in steady wind."""
        for record in self.records:
            sums.add_equation(mean_lift(record, self.x, self.regression, self.settings))
            variance = self.winds[record.flight].variance
            sums.add_equation(pitot_equation(record, self.x, self.parameters, variance))

    def _add_scores(self, sums: Sums, fitted: FittedRecord, by_instruments: bool) -> FittedRecord:
        """Add the scores of a pass over a record; with instruments, return it with its surfaces' answers to gusts."""
        record, linear, run = fitted
        L_inverse = np.linalg.inv(np.linalg.cholesky(run.innovations.covariance))
        e = whitened(L_inverse, run.innovations.values)
        slopes = L_inverse @ innovation_slopes(linear, run)
        free = self.parameters.places[record.flight] >= self.parameters.n_held
        D = slopes[:, :, np.flatnonzero(free)]
        Z = D
        if by_instruments and not self.is_known:
            instruments = slopes[:, :, self.layout.n_derivatives :]
            Z = _projected(D, instruments, self.settings.least_direction)
            record = record.with_answers(e, self.settings)
        width = max(round(self.settings.block / record.median_step), 1)
        sums.add_record(self.parameters.free_places(record.flight), Z, D, e, width)
        return fitted._replace(record=record)

    def linearized(self, record: Record, states: Matrix) -> Linearization:
        """Return the filter's linearization at the parameters."""
        value = self.parameters.values(self.x, record.flight)
        decay = self.noise_search.noise(record).decay[0]
        return linearized(record, self.layout, self.aircraft, value, states, decay, self.settings)


def _projected(slopes: Array, instruments: Array, least: float) -> Array:
    """Return slopes (n, m, p) projected on instruments (n, m, q), whose directions below ``least`` are left out."""
    rows = instruments.reshape(-1, instruments.shape[2])
    size = np.linalg.norm(rows, axis=0)
    moved = size > 0
    U, s, _ = np.linalg.svd(rows[:, moved] / size[moved], full_matrices=False)
    U = U[:, s > least * s[0]]
    projected = U @ (U.T @ slopes.reshape(len(U), -1))
    return projected.reshape(slopes.shape)
