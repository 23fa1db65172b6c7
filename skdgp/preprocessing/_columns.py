"""ElevonSplitter: elevator and aileron from elevons, and other mixings. RateNondimensionalizer."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np

from skdgp._compute.sklearn_compat import Interval
from skdgp._flight.channels import ACCELERATION_LENGTHS, ELEVONS, HAT, MIXED, RATE_LENGTHS, rate_factor
from skdgp._flight.checks import check_columns, numeric
from skdgp.preprocessing._table import TableTransformer, with_columns

MAX_DIFFERENCE = 1e-3  # rad, more than the rounding of a log


class ElevonSplitter(TableTransformer):
    r"""Mix control surfaces into controls.

    .. math:: \text{controls} = \text{mixing} \cdot \text{surfaces}

    Default: elevator = (left + right) / 2, aileron = (left - right) / 2 of two elevons. If the
    elevons are exchanged, lift and elevator of a symmetric aircraft stay, and roll moment and aileron change sign.

    A table with the controls but without the surfaces (a conventional aircraft, a simulation) does not change. With
    both, the controls are computed from the surfaces, with a warning if the logged ones differ by more than 0.001 rad.
    Raises ValueError if the table has neither, or the mixing has another shape.

    Parameters
    ----------
    surfaces : sequence of str, default=("elevon_left", "elevon_right")
        Columns of the deflections [rad].
    controls : sequence of str, default=("elevator", "aileron")
        Columns to compute [rad].
    mixing : array-like of shape (n_controls, n_surfaces), optional
        Default: that of two elevons.

    Attributes
    ----------
    mixing_ : ndarray of shape (n_controls, n_surfaces)
        The mixing used.

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

    def __init__(
        self, *, surfaces: Sequence[str] = ELEVONS, controls: Sequence[str] = MIXED, mixing: Any = None
    ) -> None:
        self.surfaces = surfaces
        self.controls = controls
        self.mixing = mixing

    def inverse_transform(self, X: Any) -> Any:
        """Return the table X with the surfaces that give its controls; of several, those of least deflection."""
        if self._passes:
            return self._as_output(self._check_other_input(X))
        check_columns(X, self.controls)
        surfaces = numeric(X, self.controls) @ np.linalg.pinv(self.mixing_).T
        return self._as_output(with_columns(X, dict(zip(self.surfaces, surfaces.T, strict=True))))

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
        self._controls_of(table)

    def _transform_table(self, table):
        return with_columns(table, self._controls_of(table))

    def _columns_out(self, names):
        mixes = all(surface in names for surface in self.surfaces)
        return names + [name for name in self.controls if mixes and name not in names]

    def _controls_of(self, table):
        """Return controls by name; none where the table has them but not the surfaces."""
        if not any(name in table for name in self.surfaces) and all(name in table for name in self.controls):
            return {}
        check_columns(table, self.surfaces)
        computed = dict(zip(self.controls, self.mixing_ @ numeric(table, self.surfaces).T, strict=True))
        difference = {n: np.abs(numeric(table, [n])[:, 0] - values) for n, values in computed.items() if n in table}
        largest = {name: float(f"{np.max(d, where=np.isfinite(d), initial=0):.2g}") for name, d in difference.items()}
        if max(largest.values(), default=0.0) > MAX_DIFFERENCE:
            warnings.warn(
                f"Logged controls differ from the surfaces by up to {largest} rad; the surfaces are used. Drop the "
                "logged columns if they are commands, or correct surfaces, controls and mixing.",
                stacklevel=3,
            )
        return computed


class RateNondimensionalizer(TableTransformer):
    r"""Add non-dimensional rates beside the measured ones.

    With airspeed V, span b and mean chord c,

    .. math::
        \hat p = \frac{p b}{2V}, \quad \hat q = \frac{q c}{2V}, \quad \hat r = \frac{r b}{2V}, \quad
        \hat{\dot\alpha} = \frac{\dot\alpha c}{2V}, \quad \hat{\dot\beta} = \frac{\dot\beta b}{2V}, \quad
        \hat{\dot p} = \frac{\dot p b^2}{4V^2}, \quad \hat{\dot q} = \frac{\dot q c^2}{4V^2}, \quad
        \hat{\dot r} = \frac{\dot r b^2}{4V^2},

    the usual normalisation of stability derivatives. Each rate in the table gets a column with the suffix ``_hat``
    (``alpha_dot_hat``), which named sets of :class:`RegressorSelector` use in its place. Raises ValueError if
    ``airspeed`` is missing or not positive, or the table has no rate.

    Parameters
    ----------
    span : float
        Wing span b [m].
    chord : float
        Mean aerodynamic chord c [m].

    Attributes
    ----------
    rates_ : list of str
        The rates of ``fit``; ``transform`` needs them, and ``airspeed``.

    Examples
    --------
    >>> import pandas as pd
    >>> flight = pd.DataFrame({"airspeed": [40.0, 20.0], "p": [0.5, 0.5]})
    >>> RateNondimensionalizer(span=2.8, chord=1.2).fit_transform(flight)
       airspeed    p   p_hat
    0      40.0  0.5  0.0175
    1      20.0  0.5  0.0350
    """

    in_simulation = "rates"
    _parameter_constraints: dict = {key: [Interval(Real, 0, None, closed="neither")] for key in ("span", "chord")}

    def __init__(self, span: float, chord: float) -> None:
        self.span = span
        self.chord = chord

    def _fit_table(self, table):
        self.rates_ = [name for name in RATE_LENGTHS | ACCELERATION_LENGTHS if name in table]
        if not self.rates_:
            check_columns(table, ["p", "q", "r"])
        self._non_dimensional(table)

    def _transform_table(self, table):
        return with_columns(table, self._non_dimensional(table))

    def _columns_out(self, names):
        return names + [name + HAT for name in self.rates_ if name + HAT not in names]

    def _non_dimensional(self, table):
        check_columns(table, ["airspeed", *self.rates_])
        airspeed = numeric(table, ["airspeed"])[:, 0]
        still = np.flatnonzero(airspeed <= 0)
        if still.size:
            raise ValueError(
                f"Got airspeed {airspeed[still[0]]:g} m/s at row {still[0]} ({still.size} rows at or below zero), but "
                "expected positive airspeed: keep the rows in flight, such as flight[flight.airspeed > 10]."
            )
        lengths = RATE_LENGTHS | ACCELERATION_LENGTHS
        return {
            name + HAT: rate_factor(name, getattr(self, lengths[name]), airspeed) * rate
            for name, rate in zip(self.rates_, numeric(table, self.rates_).T, strict=True)
        }
