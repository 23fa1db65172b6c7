"""CalibratedBands: bands of simulated trajectories, scaled by the errors on recorded flights."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import t as student

from skdgp._compute.intervals import check_level
from skdgp._flight.channels import EARTH_VELOCITY, EULER, RATES
from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_codes
from skdgp._flight.frames import wrapped
from skdgp.calibration._regressor import ROUNDING, unit_weights, units_needed, weighted_quantile
from skdgp.dynamics import trajectory_bands

GROUPS = {"velocity": EARTH_VELOCITY, "attitude": EULER, "rates": RATES}
ONE_SIGMA = 0.6827  # probability of a normal variable within one standard deviation of its mean


@dataclass(frozen=True)
class CalibratedBands:
    r"""Bands that hold whole trajectories, from simulated ensembles and the flights that were recorded.

    A segment is a part of a recorded flight, simulated from its first row. Its score is, for each group of states, the
    largest error along it, over all its times and states,

    .. math:: \max_{t, i} |y_i(t) - m_i(t)| / s_i(t),

    with the median m of the ensemble and its deviation s: the distance from m to the 16 % or the 84 % quantile, on the
    side of y. The band of a level is :math:`m \pm q s`, with q as in :class:`CalibratedRegressor`: with one segment of
    each of K flights the :math:`\lceil (K + 1) \, level \rceil`-th smallest score. If the next flight and the K others
    are exchangeable, the expected share of its segments whose states of the group stay in their bands from beginning
    to end is at least ``level``.

    **K flights guarantee no level above K / (K + 1).** Above it, with a warning, q is the largest score, or if larger
    Student's prediction bound of the logarithms x of the largest score of each flight, with their mean and standard
    deviation,

    .. math:: \log q = \bar{x} + t_{K - 1, level} \, s_x \sqrt{1 + 1 / K},

    which holds the level if these are normal, without a guarantee otherwise.

    Parameters
    ----------
    scores, units : DataFrame (n_segments, n_groups), ndarray (n_segments,) of int
        Score of each segment and group, and the exchangeable unit of each segment, from 0 on.
    unit : {"flight", "segment"}
        What the units are.
    groups, noise : mappings of str to sequence of str, and of str to float
        States of each group; standard deviations of the recorded states' errors.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.calibration import CalibratedBands
    >>> rng, time = np.random.default_rng(0), np.arange(5) / 10
    >>> def ensemble(n):
    ...     paths = [pd.DataFrame({"start": s, "path": p, "time": time, "q": time * rng.normal(), "ended": ""})
    ...              for s in range(n) for p in range(30)]
    ...     return pd.concat(paths, ignore_index=True)
    >>> recorded = [pd.DataFrame({"time": time, "flight": k, "q": 2 * time * rng.normal()}) for k in range(9)]
    >>> calibrated = CalibratedBands.from_flights(ensemble(9), recorded)
    >>> calibrated.max_level, 1 < calibrated.factors(0.9)["rates"] < 10
    (0.9, True)
    >>> list(calibrated.bands(ensemble(1), level=0.9))
    ['start', 'time', 'flying', 'q', 'q_low', 'q_high']
    """

    scores: pd.DataFrame
    units: np.ndarray
    unit: str
    groups: Mapping[str, Sequence[str]]
    noise: Mapping[str, float]

    @classmethod
    def from_flights(
        cls, ensemble: pd.DataFrame, recorded: Sequence[pd.DataFrame], *,
        groups: Mapping[str, Sequence[str]] | None = None, noise: Mapping[str, float] | None = None,
    ) -> CalibratedBands:  # fmt: skip
        """Return the bands that the errors of an ensemble on recorded segments ask for.

        Raises ValueError if there are fewer than two units, a segment is shorter than its trajectory or lacks a state,
        or an ensemble does not spread. Warns if segments of one flight are the units.

        Parameters
        ----------
        ensemble : DataFrame
            Of :func:`skdgp.dynamics.simulate` with ``n_paths``, from the first row of each segment, by a model that did
            not learn from these flights.
        recorded : list of DataFrame
            The segments in the order of the starts, with ``time`` [s] and the states. A column ``flight`` names their
            flights, which are the exchangeable units. Without it, or with one flight, segments are, only approximately:
            neighbours fly in the same air.
        groups : mapping of str to sequence of str, optional
            States of each group, which has bands of its own; by default velocity (v_north, v_east, v_down), attitude
            (phi, theta, psi) and rates (p, q, r), as far as they were recorded.
        noise : mapping of str to float, optional
            Standard deviations of the errors of recorded states, by name. They are part of s: without them the first
            rows, where an ensemble has not spread, decide. ``initial_std`` of `simulate` is that of the starts.
        """
        names = {name for part in recorded for name in part}
        if groups is None:
            groups = {group: [name for name in states if name in names] for group, states in GROUPS.items()}
            groups = {group: states for group, states in groups.items() if states}
        bands = _one_sigma(ensemble, groups, noise := dict(noise or {}))
        if len(recorded) != len(bands):
            raise ValueError(
                f"Got {len(recorded)} recorded segments and {len(bands)} starts of the ensemble, but expected one "
                "segment for each start."
            )
        scores = pd.DataFrame([_scores(*pair, groups) for pair in zip(bands, recorded, strict=True)])
        if len(recorded) < 2:
            raise ValueError("Got one recorded segment, but expected at least two, of different flights.")
        codes, flights = flight_codes([part["flight"].iloc[0] if "flight" in part else 0 for part in recorded])
        if len(flights) > 1:
            return cls(scores, codes, "flight", groups, noise)
        warnings.warn(
            f"Got one flight, so its {len(recorded)} segments replace flights: the bands hold for further segments "
            "of this flight, not for other flights. Give segments of several (column flight).",
            stacklevel=2,
        )
        return cls(scores, np.arange(len(recorded)), "segment", groups, noise)

    @property
    def n_units(self) -> int:
        """Number of exchangeable units, K."""
        return len(np.unique(self.units))

    @property
    def max_level(self) -> float:
        """Highest level with a guarantee, K / (K + 1)."""
        return self.n_units / (self.n_units + 1)

    def factors(self, level: float = 0.95) -> dict[str, float]:
        """Return q of each group; raise ValueError if the level is not inside (0, 1).

        Warns if there are too few flights to guarantee the level.
        """
        if check_level(level) <= self.max_level + ROUNDING:
            weights = self.max_level * unit_weights(self.units)
            return {str(name): weighted_quantile(s.to_numpy(), weights, level) for name, s in self.scores.items()}
        warnings.warn(
            f"Got level={level:g}, but {self.n_units} {self.unit}s guarantee no more than {self.max_level:.3g}: the "
            f"bands assume that logarithms of their largest scores are normal. Calibrate on {units_needed(level)} "
            f"{self.unit}s or more, or set level={np.floor(100 * self.max_level) / 100:g}.",
            stacklevel=2,
        )
        largest = np.log(self.scores.groupby(self.units).max())
        margin = student.ppf(level, self.n_units - 1) * np.sqrt(1 + 1 / self.n_units) * largest.std()
        bound = np.fmax(largest.max(), largest.mean() + margin)  # without a standard deviation one is infinite
        return {str(name): float(q) for name, q in np.exp(bound).items()}

    def bands(self, ensemble: pd.DataFrame, level: float = 0.95) -> pd.DataFrame:
        """Return the calibrated bands of other trajectories, in the form of :func:`skdgp.dynamics.trajectory_bands`.

        The ensemble of :func:`skdgp.dynamics.simulate` is as long as the segments or shorter. Where ``noise`` was
        given, bands are those of records. Errors and warnings are those of :meth:`factors`.
        """
        factors = self.factors(level)
        table = pd.concat(_one_sigma(ensemble, self.groups, self.noise), ignore_index=True)
        for group, states in self.groups.items():
            for name in states:
                for end in ("_low", "_high"):
                    table[name + end] = table[name] + factors[group] * (table[name + end] - table[name])
        return table


def _one_sigma(ensemble: pd.DataFrame, groups: Mapping, noise: Mapping) -> list[pd.DataFrame]:
    """Return the median of the states and its distance from 16 and 84 % quantiles, noise included, of each start."""
    states = [name for names in groups.values() for name in names]
    check_columns(ensemble, states, what="ensemble")
    table = trajectory_bands(ensemble, ONE_SIGMA, states)
    for name in states:
        for end, sign in (("_low", -1), ("_high", 1)):
            table[name + end] = table[name] + sign * np.hypot(table[name + end] - table[name], noise.get(name, 0.0))
    return [band.reset_index(drop=True) for _, band in table.groupby("start", sort=True)]


def _scores(band: pd.DataFrame, recorded: pd.DataFrame, groups: Mapping) -> dict[str, float]:
    """Return the largest error over deviation of each group, after the first row; infinite where no path flies."""
    check_columns(recorded, ["time", *(name for names in groups.values() for name in names)], what="recorded segment")
    time = recorded["time"].to_numpy(float)
    at = band["time"].to_numpy(float) - band["time"].iloc[0] + time[0]
    if at[-1] > time[-1] + 1e-6:
        raise ValueError(
            f"Got a recorded segment of {np.ptp(time):g} s for a trajectory of {np.ptp(at):g} s, but expected records "
            "to its end: simulate a shorter duration."
        )

    def score(name: str) -> float:
        values = recorded[name].to_numpy(float)
        observed = np.isfinite(values)
        if not observed.any():
            raise ValueError(f"Got a recorded segment without a value of {name}, but expected some.")
        values = np.unwrap(values[observed]) if name in EULER else values[observed]
        error = np.interp(at, time[observed], values) - band[name]
        error = wrapped(error) if name in EULER else error
        spread = np.where(error > 0, band[name + "_high"] - band[name], band[name] - band[name + "_low"])[1:]
        if (spread == 0).any():
            raise ValueError(
                f"Got an ensemble in which {name} does not spread, but expected several paths: simulate with n_paths."
            )
        return float(np.max(np.nan_to_num(np.abs(error[1:]) / spread, nan=np.inf)))

    return {group: max(map(score, names)) for group, names in groups.items()}
