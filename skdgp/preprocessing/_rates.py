"""RateNondimensionalizer: non-dimensional rates."""

from __future__ import annotations

from numbers import Real

import numpy as np

from skdgp._compute.sklearn_compat import Interval
from skdgp._flight.channels import ACCELERATION_LENGTHS, HAT, RATE_LENGTHS, rate_factor
from skdgp._flight.checks import check_columns, numeric
from skdgp.preprocessing._table import TableTransformer, with_columns


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
