"""Known noise of a fit, and starting values of learned noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.linalg import constant_columns
from skdgp._compute.typing import Matrix, Vector
from skdgp.inference._likelihood import Data


@dataclass(frozen=True)
class NoiseSettings:
    """Starting values and bounds of noise that is learned."""

    #: Bounds of the noise variance, over the variance of the output
    bounds: tuple[float, float] = (1e-6, 1e2)
    #: The lower bound of a single row. It falls to the above for twice as many rows as a plane has
    #: weights, whose few residuals do not show the noise (guess; three rows of a plane)
    few_rows: float = 0.3
    #: Starting noise variance, over the variance of the residual of the trend
    start: float = 0.2
    #: Bounds of the noise variance of a regressor, over the variance of the regressor
    input_bounds: tuple[float, float] = (1e-7, 0.3)
    #: Fraction of the noise of the outputs that starts as noise of the regressors
    input_fraction: float = 0.5


SETTINGS = NoiseSettings()


class KnownNoise(NamedTuple):
    """Noise that is known before the fit.

    ``variance`` (P,) are starting values within ``bounds`` (P, 2); equal bounds keep a value. None:
    both from the data. ``added`` (n, P), or None, are the variances of the noise of each value
    beside. ``input_std`` (d,), or None, are known standard deviations of the noise of the
    regressors.
    """

    variance: Vector | None = None
    bounds: Matrix | None = None
    added: Matrix | None = None
    input_std: Vector | None = None

    @classmethod
    def of_values(cls, variance: Matrix) -> KnownNoise:
        """Return the noise of known variances of all values, (n, P), as scikit-learn's ``alpha``.

        The smallest variance of each output is its white noise, the rest differs between samples.
        """
        white = variance.min(axis=0)
        return cls(white, np.column_stack([white, white]), variance - white)

    @property
    def is_learned(self) -> Any:
        """Whether the variance of each output is learned, (P,), or one value for all."""
        return np.bool_(True) if self.bounds is None else self.bounds[:, 0] < self.bounds[:, 1]

    @property
    def is_fixed(self) -> bool:
        """Whether all variances keep their values."""
        return not np.any(self.is_learned)

    def within(self, variance: Vector) -> Vector:
        """Return variances (P,) of learned noise within given bounds."""
        return variance if self.bounds is None else np.clip(variance, *self.bounds.T)

    @property
    def weights(self) -> Matrix | None:
        """Inverse variances of the values, (n, P), where they differ between samples."""
        if self.added is None or self.variance is None:
            return None
        return 1.0 / (self.variance + self.added)

    def of_rows(self, rows: Any) -> KnownNoise:
        """Return the same of some samples."""
        return self._replace(added=None if self.added is None else self.added[rows])

    def of_output(self, i: int) -> KnownNoise:
        """Return the same of output i."""
        column = slice(i, i + 1)
        return KnownNoise(
            None if self.variance is None else self.variance[column],
            None if self.bounds is None else self.bounds[column],
            None if self.added is None else self.added[:, column],
        )

    def in_units(self, scale: Vector) -> KnownNoise:
        """Return the same of outputs over ``scale`` (P,)."""
        return KnownNoise(
            None if self.variance is None else self.variance / scale**2,
            None if self.bounds is None else self.bounds / scale[:, None] ** 2,
            None if self.added is None else self.added / scale**2,
            self.input_std,
        )

    def start(self, residual: Matrix, scale: Vector, X: Matrix) -> tuple[Vector, Matrix]:
        """Return the starting noise variances (P,) and their bounds (P, 2).

        Without known ones: a fifth of the variance of the ``residual`` (n, P), and bounds relative
        to the ``scale`` (P,) of the outputs, the lower one larger for few rows of X (n, d).
        """
        bounds = self.bounds
        if bounds is None:
            n_rows = np.isfinite(residual).sum(axis=0)
            n_weights = 1 + np.sum(~constant_columns(X))  # of a plane
            few = SETTINGS.few_rows * (1.0 - (n_rows - 1) / (2.0 * n_weights))
            bounds = np.multiply.outer(scale**2, SETTINGS.bounds)
            bounds[:, 0] = np.maximum(bounds[:, 0], few * scale**2)
        variance = self.variance
        if variance is None:
            variance = SETTINGS.start * np.nanvar(residual, axis=0)
        return np.clip(variance, *bounds.T), bounds


UNKNOWN = KnownNoise()


def initial_input_noise(
    noise: Vector,
    blocks: Sequence[Data],
    scale: Vector,
    known: KnownNoise,
) -> tuple[Vector, Matrix]:
    """Return the noise vector with factors s (d,) of the regressors' noise variances, and bounds of s.

    Known standard deviations, over the ``scale`` (d,) of the regressors, keep their values. At the
    start of others, half of each output's noise comes from the regressors, with equal factors s.
    The loadings of the values in ``blocks`` are of errors of the size of ``scale``.
    """
    least, most = SETTINGS.input_bounds
    if known.input_std is not None:
        fixed = np.maximum((known.input_std / scale) ** 2, least)
        return np.concatenate([noise, fixed]), np.column_stack([fixed, fixed])
    fractions = []
    for i, variance in enumerate(noise):
        G = np.concatenate([block.loadings()[i] for block in blocks])
        if len(G):
            propagated = np.mean(np.sum(G**2, axis=1))
            fractions.append(variance / max(propagated, 1e-12))
    factor = SETTINGS.input_fraction * float(np.median(fractions))
    start = np.full(len(scale), np.clip(factor, 10 * least, most / 10))
    noise = (1 - SETTINGS.input_fraction) * noise
    return np.concatenate([noise, start]), np.tile(SETTINGS.input_bounds, (len(scale), 1))
