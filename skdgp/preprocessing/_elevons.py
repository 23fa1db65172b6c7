"""ElevonSplitter: elevons mixed to elevator and aileron."""

from __future__ import annotations

import warnings

import numpy as np

from skdgp._flight.checks import check_columns
from skdgp.preprocessing._table import TableTransformer, numeric, with_columns

DISAGREEMENT = 1e-3  # rad: more than rounding of a log


class ElevonSplitter(TableTransformer):
    r"""Mix control surfaces into controls of one symmetry each.

    .. math:: \text{controls} = \text{mixing} \cdot \text{surfaces}

    By default, parity of two elevons: elevator = (left + right) / 2, aileron = (left - right) / 2. The lift of a
    symmetric aircraft is even and its roll odd under exchange of the elevons, which no regressor but these shows.

    A table that has the controls but not the surfaces (a conventional aircraft, a simulation) passes through
    unchanged. Where it has both, the controls are computed anew from the surfaces, which are what the air feels; a
    warning says so if the logged controls differ by more than 0.001 rad. The surfaces stay in the table.

    Parameters
    ----------
    surfaces : sequence of str, default=("elevon_left", "elevon_right")
        Columns of the deflections [rad].
    controls : sequence of str, default=("elevator", "aileron")
        Columns to make [rad].
    mixing : array-like of shape (n_controls, n_surfaces), optional
        By default the parity of two elevons.

    Attributes
    ----------
    mixing_ : ndarray of shape (n_controls, n_surfaces)
        The mixing used.
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If the table has neither the surfaces nor the controls, or the mixing has another shape.

    Examples
    --------
    >>> import pandas as pd
    >>> flight = pd.DataFrame({"elevon_left": [0.1, 0.1], "elevon_right": [0.1, -0.1]})
    >>> splitter = ElevonSplitter().fit(flight)
    >>> splitter.transform(flight)[["elevator", "aileron"]]
       elevator  aileron
    0       0.1      0.0
    1       0.0      0.1

    A V-tail and two ailerons:

    >>> tail = ElevonSplitter(
    ...     surfaces=("aileron_left", "aileron_right", "tail_left", "tail_right"),
    ...     controls=("aileron", "elevator", "rudder"),
    ...     mixing=[[0.5, -0.5, 0, 0], [0, 0, 0.5, 0.5], [0, 0, 0.5, -0.5]],
    ... )
    """

    in_simulation = "controls"
    _parameter_constraints: dict = {
        "surfaces": [list, tuple],
        "controls": [list, tuple],
        "mixing": ["array-like", None],
    }

    def __init__(self, *, surfaces=("elevon_left", "elevon_right"), controls=("elevator", "aileron"), mixing=None):
        self.surfaces = surfaces
        self.controls = controls
        self.mixing = mixing

    def inverse_transform(self, X):
        """Return the table with the surfaces that give its controls (of least deflection where several do).

        Parameters
        ----------
        X : DataFrame of shape (n, n_columns)
            Table with the controls.

        Returns
        -------
        DataFrame
            With the surfaces computed from the controls.
        """
        if self._passes:
            return self._contained(self._checked_stranger(X))
        check_columns(X, self.controls)
        surfaces = numeric(X, self.controls) @ np.linalg.pinv(self.mixing_).T
        return self._contained(with_columns(X, dict(zip(self.surfaces, surfaces.T, strict=True))))

    def _fit_table(self, table):
        shape = (len(self.controls), len(self.surfaces))
        if self.mixing is None and shape != (2, 2):
            raise ValueError(f"Got {shape[1]} surfaces for {shape[0]} controls and no mixing, but expected mixing.")
        self.mixing_ = np.array([[0.5, 0.5], [0.5, -0.5]] if self.mixing is None else self.mixing, dtype=float)
        if self.mixing_.shape != shape:
            raise ValueError(
                f"Got mixing of shape {self.mixing_.shape}, but expected (n_controls, n_surfaces) = {shape}: one row "
                f"for each of {list(self.controls)}, one column for each of {list(self.surfaces)}."
            )
        self._mixed(table)

    def _transform_table(self, table):
        return with_columns(table, self._mixed(table))

    def _columns_out(self, names):
        mixes = all(surface in names for surface in self.surfaces)
        return names + [name for name in self.controls if mixes and name not in names]

    def _mixed(self, table):
        """Return controls by name; none where the table has them but not the surfaces."""
        bare = not any(surface in table for surface in self.surfaces)
        if bare and all(control in table for control in self.controls):
            return {}
        check_columns(table, self.surfaces)
        mixed = dict(zip(self.controls, self.mixing_ @ numeric(table, self.surfaces).T, strict=True))
        _warn_of_disagreement(table, {name: values for name, values in mixed.items() if name in table})
        return mixed


def _warn_of_disagreement(table, mixed):
    if not mixed:
        return
    apart = np.abs(numeric(table, mixed) - np.column_stack(list(mixed.values())))
    largest = np.where(np.isfinite(apart), apart, 0.0).max(axis=0)
    worst = {name: float(f"{d:.2g}") for name, d in zip(mixed, largest, strict=True)}
    if max(worst.values()) > DISAGREEMENT:
        warnings.warn(
            f"Logged controls differ from the surfaces by up to {worst} rad; the surfaces are used. Drop the logged "
            "columns if they are commands, or correct surfaces, controls and mixing.",
            UserWarning,
            stacklevel=4,
        )
