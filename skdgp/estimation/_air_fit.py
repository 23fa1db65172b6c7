r"""Search of the filter-error method: passes of the filter over the records, in turn with steps of the parameters.

With innovations :math:`e_k` of covariance :math:`S_k = L_k L_k^T`, :math:`D_k = \partial e_k / \partial \theta`
at given gains and the projection P on instruments, a pass sums score and information,

.. math:: g = \sum_k Z_k^T L_k^{-1} e_k + \Lambda (\theta - \theta_0), \quad
          A = \sum_k Z_k^T L_k^{-1} D_k + \Lambda, \quad Z_k = P (L_k^{-1} D_k),

(as P is a projection, :math:`Z^T L^{-1} D` is also :math:`Z^T Z`, the covariance of the score of a right model)

and a damped Gauss-Newton step solves :math:`A\,\Delta\theta = -g` (Jategaonkar 2015, chapter 5; instrumental
variables: Soderstrom & Stoica 1989, chapter 8). Noises move by Fisher scoring (``_air_noise.py``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import keep_freed_memory, matrix_vector
from skdgp._compute.messages import Progress, notify
from skdgp._compute.typing import Matrix, Vector
from skdgp.estimation._air_linearization import RATE_STATES, Expansion, Layout
from skdgp.estimation._air_noise import NoiseSearch
from skdgp.estimation._air_parameters import WINDS, Parameters, Sums
from skdgp.estimation._air_records import Record, n_samples, shortened
from skdgp.estimation._air_start import (
    add_airspeed,
    steady_derivatives,
    steady_wind,
)
from skdgp.estimation._kalman import (
    Linearization,
    Pass,
    filtered,
    parameter_slopes,
)


@dataclass(frozen=True)
class AirSettings:
    """Settings of `estimate_air_motion`."""

    # passes at most of one attempt
    max_passes: int = 45
    # samples to learn from at most, of all records
    most_samples: int = 12000
    # damping of the first step, over the information (Levenberg 1944)
    first_damping: float = 0.3


AIR_SETTINGS = AirSettings()


class FittedRecord(NamedTuple):
    """A record with its last pass, and the likelihood."""

    record: Record
    expansion: Expansion
    linear: Linearization
    filter_pass: Pass
    log_likelihood: float  # of the innovations, but for a constant


class AirFit:
    """Parameters x, noises and filtered states of the records, which `search` improves.

    Where derivatives are held, as of a known aircraft, score and information have no instruments.
    """

    def __init__(
        self,
        records: list[Record],
        layout: Layout,
        parameters: Parameters,
        noises: Parameters,
        settings: AirSettings,
    ) -> None:
        self.all_records = records
        self.layout = layout
        self.parameters = parameters
        self.noise_search = NoiseSearch(noises, layout.aircraft.span)
        self.settings = settings
        self.is_known = parameters.n_held > 0
        self.x = parameters.mean.copy()
        self.history: list[Vector] = []  # of x in the search
        self.airspeed_variances = []  # of each flight
        for flight in range(len(parameters.places)):
            own = [record for record in records if record.flight == flight]
            pitot, variance = steady_wind(own)
            self.airspeed_variances.append(variance)
            self.x[parameters.places_of(flight, WINDS[:2])] = pitot[1:]
        if not self.is_known:
            self.x = steady_derivatives(records, layout, parameters, self.x)
        self._begin(records)

    def _begin(self, records: list[Record]) -> None:
        """Set records, and their states: rates as measured, without gusts."""
        before = ((0, 0), (RATE_STATES.start, 0))
        self.is_part = n_samples(records) < n_samples(self.all_records)
        self.records = records
        self.states = [np.pad(record.rates, before) for record in records]

    @property
    def vibrates(self) -> bool:
        """Whether an oscillation shakes the inertial sensors of a record."""
        return any(record.vibration.any() for record in self.records)

    def search(self, n_before: int) -> tuple[bool, bool]:
        """Improve parameters and noises by passes of the filter; return (converged, went_back).

        The first ``n_before`` passes use no instruments. Raise LinAlgError if the search diverges. It may
        end far below the likelihood of an earlier pass, as instruments are weak far from the solution,
        and their equations have other solutions there. Then parameters and noises are those of the
        earlier pass, and the search did not converge. The first passes of long flights are over a part of
        their samples, unless ``n_before``: the part alone may diverge, or lead elsewhere.
        """
        keep_freed_memory()
        # far from the solution a part of long flights is enough
        few = self.settings.most_samples // 4
        if not n_before and n_samples(self.records) > 2 * few:
            self._begin(shortened(self.records, few))
        last_step = np.zeros(len(self.x) - self.parameters.n_held)
        damping = self.settings.first_damping  # over the information
        fraction = 1.0  # of a step that is taken
        max_passes = self.settings.max_passes
        was_small = False
        converged = False
        likelihood = -np.inf
        best = likelihood, self.x.copy(), self.noise_search.psi.copy()
        for number in range(max_passes):
            notify(Progress("estimating the air", number, max_passes))
            sums, fitted = self._pass(by_instruments=number >= n_before)
            likelihood = sum(item.log_likelihood for item in fitted)
            if likelihood > best[0]:
                best = likelihood, self.x.copy(), self.noise_search.psi.copy()
            information, score = sums.damped(damping)
            step = self._bounded_step(information, score)
            # less where steps turn back, so that no two solutions alternate
            if step @ information @ last_step < 0:
                fraction = max(0.5 * fraction, 0.25)
            else:
                fraction = min(1.4 * fraction, 1.0)
            self.x[sums.free] += fraction * step
            last_step = step
            damping *= 0.25
            self.history.append(self.x.copy())
            # noises move from the second pass on, by the middle of each record
            noise_length = np.inf
            if number:
                # samples of each record, from its middle, that show the noises
                linears = [item.linear.middle(2000) for item in fitted]
                noise_length = self.noise_search.move(self.records, linears)
            # squared length of the last two steps, in standard deviations of all parameters
            is_small = sums.squared_length(step) < 0.5
            # squared length of the last step of the noises
            is_still = was_small and is_small and noise_length < 5.0
            was_small = is_small
            converged = is_still and number > n_before
            if self.is_part and (converged or number == max_passes // 6):
                self._begin(self.all_records)
                best = -np.inf, *best[1:]
                # no step over all samples was small
                was_small = converged = False
            if converged:
                break
        # log likelihood for each sample that a solution may lie below the best pass: sound ones of simulated flights
        # lie up to 0.65 below, of a log 0.59, false ones 0.25 and 1.6
        lost = n_samples(self.records)
        if likelihood >= best[0] - lost:
            return converged, False
        _, self.x, self.noise_search.psi = best
        self.history.append(self.x.copy())
        self._pass()  # for the states there
        return False, True

    def _pass(self, by_instruments: bool = True) -> tuple[Sums, list[FittedRecord]]:
        """Filter all records about the states of the last pass, and keep states and records for the next one."""
        sums, fitted = self.filter_records(by_instruments)
        self.records = [item.record for item in fitted]
        self.states = [item.filter_pass.states for item in fitted]
        return sums, fitted

    def _bounded_step(self, information: Matrix, score: Vector) -> Vector:
        """Return the step of the free parameters, with a lag that stays at or above zero.

        No derivative moves by more than some standard deviations of its prior. Raise LinAlgError if
        the step is not finite.
        """
        step: Any = -np.linalg.solve(information, score)
        lag = self.parameters.names.index("servo_lag")
        place = lag - self.parameters.n_held
        if place >= 0 and self.x[lag] + step[place] < 0:
            at_zero = information.copy()
            at_zero[place] = 0.0
            at_zero[place, place] = 1.0
            right = -score
            right[place] = -self.x[lag]
            step = np.linalg.solve(at_zero, right)
        if not self.is_known:
            nd = self.layout.n_derivatives
            farthest = np.max(np.abs(step[:nd]) / self.parameters.std[:nd])
            # largest step of a derivative, in standard deviations of its prior
            step *= min(1.0, 2.0 / farthest)
        if not np.isfinite(step).all():
            raise np.linalg.LinAlgError
        return step

    def filter_records(self, by_instruments: bool = True) -> tuple[Sums, list[FittedRecord]]:
        """Filter all records at the parameters; return sums of the parameters, and the filtered records."""
        sums = Sums(self.x, self.parameters)
        fitted = []
        for record, states in zip(self.records, self.states, strict=True):
            if not self.is_known:
                variance = self.airspeed_variances[record.flight]
                add_airspeed(sums, record, self.x, self.parameters, variance)
            noise = self.noise_search.noise(record)
            value = self.parameters.values(self.x, record.flight)
            expansion = Expansion(record, self.layout, value, states, noise.decay[0])
            linear = expansion.linearization()
            # derivatives of a known aircraft are held
            slopes = expansion.slopes_of_flight() if self.is_known else expansion.slopes
            filter_pass = filtered(linear, noise)
            L_inverse = np.linalg.inv(np.linalg.cholesky(filter_pass.innovation_covariance))
            e = matrix_vector(L_inverse, filter_pass.innovations)
            scores = []  # of some steps each
            products: Any = 0.0
            for steps, by_parameters, _ in parameter_slopes(linear, filter_pass, slopes):
                whitened = L_inverse[steps] @ by_parameters
                rows = whitened.reshape(-1, whitened.shape[2])
                scores.append(rows.T @ e[steps].ravel())
                products = products + rows.T @ rows
            has_instruments = by_instruments and not self.is_known
            self._add_scores(sums, record.flight, np.array(scores), products, has_instruments)
            if has_instruments:
                # for the instruments of the next pass
                record = record.with_answers(e)
            determinants = np.log(np.einsum("nii->ni", L_inverse)).sum()
            log_likelihood = float(determinants - 0.5 * np.sum(e**2))
            fitted.append(FittedRecord(record, expansion, linear, filter_pass, log_likelihood))
        return sums, fitted

    def _add_scores(
        self, sums: Sums, flight: int, scores: Matrix, products: Matrix, has_instruments: bool
    ) -> None:
        """Add score and information of a record.

        With slopes S of whitened innovations e by the estimated parameters of a flight and, behind these, by the
        instruments, ``scores`` are S^T e of some steps each (k, q), and ``products`` S^T S of all.
        """
        places = self.parameters.free_places(flight)
        n = len(places)
        own = scores[:, :n]
        information = products[:n, :n]
        if has_instruments:
            used = slice(self.layout.n_derivatives, None)
            of_own = products[used, :n]
            weights = _projection(products[used, used], of_own)
            own = scores[:, used] @ weights
            information = weights.T @ of_own
        sums.add(places, own.sum(axis=0), information, own.T @ own)


def _projection(squares: Matrix, products: Matrix) -> Matrix:
    """Return weights (r, d): instruments R (n, r) times these are slopes D (n, d) projected on R.

    ``squares`` are R^T R, ``products`` R^T D. Directions of R that are small are left out.
    """
    size = np.sqrt(np.diag(squares))
    unit = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0)
    variance, V = np.linalg.eigh(unit[:, None] * squares * unit)  # squares of singular values
    # least singular value of the instruments, relative to the largest
    is_direction = variance > 1e-6**2 * variance[-1]
    V = unit[:, None] * V[:, is_direction]
    return V @ (V.T @ products / variance[is_direction, None])
