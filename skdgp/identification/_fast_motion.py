r"""Motion that the smoothing of coefficients removes, put back by linear terms.

Smoothing F removes frequencies at which a channel has more noise than signal. Regressors X keep them, with
their noise, so slopes would be too small. With slopes :math:`\beta` of coefficients C by least squares in
the band of the motion G, coefficients are learned as

.. math:: F C + k \, (1 - F) \, X \beta,

where k is the fraction of :math:`(G - F) X \beta` that :math:`(G - F) C` shows in spite of its noise: one of
a linear function of exact regressors, and less of a curved one, whose slopes at the mean are not those of
fast gusts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.clock import Clock, median_step
from skdgp._flight.smoothing import FittedFilter, smooth


@dataclass(frozen=True)
class FastMotionSettings:
    """When fast motion is put back."""

    #: Length of the blocks whose errors are independent [s]
    block: float = 2.0
    #: Fractions below this many standard deviations are none; convention
    significance: float = 2.0


SETTINGS = FastMotionSettings()


@dataclass(frozen=True)
class FastMotion:
    """Linear terms of the motion that a smoothing of coefficients removes.

    Attributes
    ----------
    smoothing : FittedFilter
        Of the P coefficients.
    slopes : (P, d) array
        Of the coefficients by regressors, times the fraction k.
    """

    smoothing: FittedFilter
    slopes: Matrix

    @classmethod
    def of_flights(
        cls,
        smoothing: FittedFilter,
        smoothed: Matrix,
        noisy: Matrix,
        regressors: Matrix,
        flights: pd.DataFrame,
        band: float,
        settings: FastMotionSettings = SETTINGS,
    ) -> FastMotion:
        """Return the terms by coefficients (n, P), smoothed and up to a ``band`` [Hz], and regressors (n, d).

        ``flights`` have ``time`` [s], and ``flight`` where there are several.
        """
        up_to_band = FittedFilter.up_to(band, regressors.shape[1])
        in_band = _smoothed(regressors, up_to_band, flights)
        is_known = np.isfinite(np.hstack([in_band, smoothed, noisy])).all(axis=1)
        centred = in_band[is_known] - in_band[is_known].mean(axis=0)
        by_regressor: Any = np.linalg.lstsq(centred, noisy[is_known], rcond=None)[0]
        slow = _smoothed(regressors @ by_regressor, smoothing, flights)
        fast = (in_band @ by_regressor - slow)[is_known]
        removed = (noisy - smoothed)[is_known]
        clock = Clock.of(flights["time"], flights.get("flight"))
        width = max(1, round(settings.block / median_step(clock.time, clock.segments)))
        slopes = by_regressor.T.copy()
        for i, terms in enumerate(slopes):
            terms *= _fraction(fast[:, i], removed[:, i], width, settings)
        return cls(smoothing, slopes)

    def added(self, regressors: Matrix, flights: pd.DataFrame) -> Matrix:
        """Return what the fast motion of regressors (n, d) adds to smoothed coefficients, (n, P)."""
        linear = regressors @ self.slopes.T
        return linear - _smoothed(linear, self.smoothing, flights)


def _smoothed(columns: Matrix, cutoff: FittedFilter, flights: pd.DataFrame) -> Matrix:
    """Return columns (n, k) of flights smoothed by a filter of k channels."""
    return smooth(columns, flights["time"], flight=flights.get("flight"), cutoff=cutoff)


def _fraction(fast: Vector, removed: Vector, width: int, settings: FastMotionSettings) -> float:
    """Return the fraction k of the fast linear terms (n,) that a removed part (n,) shows, from zero to one.

    Zero where it is not significant, by errors that are independent between blocks of ``width`` rows.
    """
    square = fast @ fast
    if square <= np.finfo(float).tiny:
        return 0.0
    fraction = float(fast @ removed / square)
    errors = fast * (removed - fraction * fast)
    blocks = np.add.reduceat(errors, np.arange(0, len(errors), width))
    std = np.linalg.norm(blocks) / square
    is_significant = fraction > settings.significance * float(std)
    return min(fraction, 1.0) if is_significant else 0.0
