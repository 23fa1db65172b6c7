"""Measured thrust as a table over throttle and airspeed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.interpolate import RegularGridInterpolator

from skdgp._flight.atmosphere import standard_density
from skdgp._flight.checks import check_columns, check_names, check_table

__all__ = ["ThrustTable"]


class ThrustTable:
    """The thrust of any engine, linear between the points of a table: what ``simulate(thrust=...)`` asks.

    T = T(throttle, V) rho / rho_0, held beyond the edges of the table, with rho_0 the density of the bench.

    Parameters
    ----------
    throttle : array-like of shape (n,)
        Increasing, 0 to 1.
    airspeed : array-like of shape (m,)
        Increasing [m/s]; one alone: thrust does not depend on it.
    thrust : array-like of shape (n, m)
        [N].
    density : float or None, default=None
        Of the bench [kg/m^3]; None: the standard one at sea level.
    follows_density : bool, default=True
        Whether thrust goes with the density, as that of propellers and jets does.

    Examples
    --------
    >>> from skdgp.dynamics import ThrustTable
    >>> engine = ThrustTable(throttle=[0.0, 0.5, 1.0], airspeed=[0.0, 30.0], thrust=[[0, -5], [60, 25], [140, 80]])
    >>> engine({"throttle": 0.75}, airspeed=15.0, density=1.225).round(2)
    np.float64(76.25)
    """

    def __init__(
        self,
        throttle: ArrayLike,
        airspeed: ArrayLike,
        thrust: ArrayLike,
        *,
        density: float | None = None,
        follows_density: bool = True,
    ):
        self.throttle, self.airspeed, self.thrust = (np.asarray(x, dtype=float) for x in (throttle, airspeed, thrust))
        for name, grid in (("throttle", self.throttle), ("airspeed", self.airspeed)):
            if grid.ndim != 1 or not len(grid) or not np.isfinite(grid).all() or not (np.diff(grid) > 0).all():
                raise ValueError(f"Got {name}={grid.tolist()}, but expected finite numbers that increase.")
        expected = (len(self.throttle), len(self.airspeed))
        if self.thrust.shape != expected or not np.isfinite(self.thrust).all():
            raise ValueError(
                f"Got thrust of shape {self.thrust.shape}, but expected finite numbers, {expected}: a row for each "
                "throttle, a column for each airspeed [N]."
            )
        self.density = float(standard_density(0.0)) if density is None else float(density)
        self.follows_density = follows_density
        grid = [
            axis if len(axis) > 1 else np.array([axis[0], axis[0] + 1.0]) for axis in (self.throttle, self.airspeed)
        ]
        values = np.tile(self.thrust, [1 if len(axis) > 1 else 2 for axis in (self.throttle, self.airspeed)])
        self._low, self._high = ([axis[k] for axis in grid] for k in (0, -1))
        self._interpolated = RegularGridInterpolator(grid, values)

    @classmethod
    def from_table(cls, table: pd.DataFrame, **options) -> ThrustTable:
        """Return the engine of a bench table with the columns throttle, airspeed and thrust, a row for each point.

        Raises
        ------
        ValueError
            If the points are not a full grid: every throttle at every airspeed, once.
        """
        check_columns(check_table(table, what="bench table"), ["throttle", "airspeed", "thrust"], what="bench table")
        if table.duplicated(["throttle", "airspeed"]).any():
            raise ValueError("Got a bench table with a point twice, but expected each throttle and airspeed once.")
        grid = table.pivot(index="throttle", columns="airspeed", values="thrust").sort_index().sort_index(axis=1)
        if grid.isna().any(axis=None):
            raise ValueError(
                f"Got a bench table of {len(table)} points, but expected a full grid of {grid.shape[0]} throttles times"
                f" {grid.shape[1]} airspeeds."
            )
        return cls(grid.index, grid.columns, grid.to_numpy(), **options)

    def __call__(self, controls: Mapping, airspeed: ArrayLike, density: ArrayLike) -> np.ndarray:
        """Return the thrust [N] at ``controls["throttle"]``, airspeed [m/s] and density [kg/m^3]."""
        check_names(["throttle"], controls, "controls")
        points = np.stack(np.broadcast_arrays(np.asarray(controls["throttle"], float), airspeed), axis=-1)
        fine = np.isfinite(points).all(axis=-1, keepdims=True)
        clipped = np.clip(np.where(fine, points, self._low), self._low, self._high)
        thrust = self._interpolated(clipped.reshape(-1, 2)).reshape(clipped.shape[:-1])
        thrust = np.where(fine[..., 0], thrust, np.nan)
        return thrust * (np.asarray(density) / self.density) if self.follows_density else thrust
