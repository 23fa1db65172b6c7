"""ElevonSplitter, RateNondimensionalizer and RegressorSelector: from columns of a flight to the regressors."""

from __future__ import annotations

from collections.abc import Mapping
from numbers import Real
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.linalg import constant_columns
from skdgp._compute.messages import report
from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._flight.channels import (
    AUXILIARY,
    CHANNELS,
    ELEVONS,
    HAT,
    LENGTHS,
    MIXED,
    REGRESSOR_SETS,
    SURFACES,
    TRUTH_SUFFIX,
    rate_factor,
)
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.findings import Code, Finding
from skdgp._flight.tables import by_name, check_columns, check_spelling, numeric
from skdgp._flight.units import check_airspeed
from skdgp.dynamics import Mixing
from skdgp.preprocessing._table import (
    TableTransformer,
    as_table,
    present,
    with_names,
)

CONTROLS = ("throttle", *SURFACES)
# Standard deviation [rad, or a fraction] from which an auxiliary control is one of a named set; a guess
LEAST_MOTION = 0.01
ELEVON_MIXING = {
    "elevator": {"elevon_left": 0.5, "elevon_right": 0.5},
    "aileron": {"elevon_left": 0.5, "elevon_right": -0.5},
}


class ElevonSplitter(TableTransformer):
    r"""Mix control surfaces into controls.

    .. math:: \text{controls} = \text{mixing} \cdot \text{surfaces}

    Default: elevator = (left + right) / 2, aileron = (left - right) / 2 of two elevons. If the
    elevons are exchanged, lift and elevator of a symmetric aircraft stay, and roll moment and
    aileron change sign.

    A table without the surfaces (a conventional aircraft, a simulation) does not change. With both,
    the controls are computed from the surfaces. Raises ValueError if the table has some of the
    surfaces or misspells them.

    Parameters
    ----------
    mixing : dict of str to dict of str to float, optional
        For each control to compute [rad] the factors of the surfaces [rad]. By default those of two elevons.

    Attributes
    ----------
    mixing_ : DataFrame of shape (n_controls, n_surfaces)
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
    ...     {
    ...         "aileron": {"aileron_left": 0.5, "aileron_right": -0.5},
    ...         "elevator": {"tail_left": 0.5, "tail_right": 0.5},
    ...         "rudder": {"tail_left": 0.5, "tail_right": -0.5},
    ...     }
    ... )
    """

    _parameter_constraints: dict = {"mixing": [dict, None]}

    def __init__(self, mixing: Mapping[str, Mapping[str, float]] | None = None) -> None:
        self.mixing = mixing

    def _fit_table(self, table):
        mixing: Any = ELEVON_MIXING if self.mixing is None else self.mixing
        rows = list(mixing.values())
        is_named = bool(rows) and all(isinstance(row, Mapping) and row for row in rows)
        if not is_named or not all(np.isfinite([*row.values()]).all() for row in rows):
            raise ValueError(
                f"Got mixing={self.mixing!r}, but expected for each control the surfaces that move it, with finite "
                "factors, such as {'elevator': {'elevon_left': 0.5, 'elevon_right': 0.5}}."
            )
        self.mixing_: Any = pd.DataFrame.from_dict(mixing, orient="index", dtype=float).fillna(0.0)
        self._controls_of(table)

    def _transform_table(self, table):
        return table.assign(**self._controls_of(table))

    def _columns_out(self, names):
        return with_names(names, self.mixing_.index) if {*self.mixing_} <= {*names} else names

    def in_simulation(self) -> dict[str, Any]:
        """Return how controls follow from surfaces, if the flights had these."""
        if not {*self.mixing_} <= {*self.feature_names_in_}:
            return {}
        mixing = Mixing(tuple(self.mixing_), tuple(self.mixing_.index), self.mixing_.to_numpy())
        return {"mixing": mixing}

    def _controls_of(self, table):
        """Return controls by name; none where the table has no surface."""
        surfaces = list(self.mixing_)
        if not present(surfaces, table):
            check_spelling(table, surfaces)
            return {}
        check_columns(table, surfaces)
        controls = numeric(table, surfaces) @ self.mixing_.to_numpy().T
        return by_name(self.mixing_.index, controls)


class RateNondimensionalizer(TableTransformer):
    r"""Add non-dimensional rates beside the measured ones.

    With airspeed V, span b and mean chord c,

    .. math::
        \hat p = \frac{p b}{2V}, \quad \hat q = \frac{q c}{2V}, \quad \hat r = \frac{r b}{2V}, \quad
        \hat{\dot\alpha} = \frac{\dot\alpha c}{2V}, \quad \hat{\dot\beta} = \frac{\dot\beta b}{2V},
        \quad \hat{\dot p} = \frac{\dot p b^2}{4V^2}, \quad \hat{\dot q} = \frac{\dot q c^2}{4V^2},
        \quad \hat{\dot r} = \frac{\dot r b^2}{4V^2},

    the usual normalisation of stability derivatives. Each rate in the table gets a column with the
    suffix ``_hat`` (``alpha_dot_hat``), which named sets of :class:`RegressorSelector` use in its
    place. Raises ValueError if ``airspeed`` is missing or not positive, or the table has no rate.

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

    _parameter_constraints: dict = {
        "span": [Interval(Real, 0, None, closed="neither")],
        "chord": [Interval(Real, 0, None, closed="neither")],
    }

    def __init__(self, span: float, chord: float) -> None:
        self.span = span
        self.chord = chord

    def _fit_table(self, table):
        self.rates_ = present(LENGTHS, table)
        if not self.rates_:
            check_columns(table, ["p", "q", "r"])
        self._non_dimensional(table)

    def _transform_table(self, table):
        return table.assign(**self._non_dimensional(table))

    def _columns_out(self, names):
        return with_names(names, [name + HAT for name in self.rates_])

    def in_simulation(self) -> dict[str, Any]:
        """Return the lengths of non-dimensional rates."""
        return {"span": self.span, "chord": self.chord}

    def _non_dimensional(self, table):
        check_columns(table, ["airspeed", *self.rates_])
        airspeed = numeric(table, ["airspeed"])[:, 0]
        check_airspeed(airspeed)
        lengths = {"span": self.span, "chord": self.chord}
        rates = {}
        for name, rate in zip(self.rates_, numeric(table, self.rates_).T, strict=True):
            rates[name + HAT] = rate_factor(name, lengths[LENGTHS[name]], airspeed) * rate
        return rates


class RegressorSelector(TableTransformer):
    """Select the regressors of a flight table, by the name of a set or by column names.

    ================= ========================================================================================
    ``quasi-steady``  alpha, beta, p, q, r, elevator, aileron, rudder, throttle
    ``classical``     alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder, throttle
    ``paper``         ax, ay, az, p, q, r, p_dot, q_dot, r_dot, alpha_dot, beta_dot, throttle, elevator,
                      aileron, rudder (Hemakumara & Sukkarieh 2011, eq 22)
    ================= ========================================================================================

    The coefficients follow almost by definition from the accelerations of ``"paper"`` (m a / qbar
    S): such a model has good scores, but cannot be simulated. In most flights alpha_dot nearly
    equals q, and beta_dot -r cos alpha, so data hardly separate their effects (Klein & Morelli
    2006, section 5.1). Hence ``"quasi-steady"``, which merges them.

    In the named sets a non-dimensional rate (``p_hat``) replaces the rate where present. Controls
    that the aircraft does not have (throttle, elevator, aileron, rudder, but not all surfaces) are
    left out and listed in ``absent_``; flap, spoiler and differential_throttle are added where they
    move. All other columns are needed. Raises ValueError if a column
    is missing (with the nearest name) or not numeric, or has NaN or infinite values in
    ``transform``.

    Parameters
    ----------
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        Named set, or columns in order.
    engine : bool, default=False
        Whether the thrust is part of the targets: a named set then gets the airspeed, unless the throttle
        stays at zero, and loses a throttle that does not move.

    Attributes
    ----------
    regressors_ : list of str
        The selected columns, in order; ``transform`` needs these.
    absent_ : list of str
        Controls of the named set that the table does not have.
    ranges_ : dict of str to tuple of float
        Range of each regressor and flight channel over the rows of ``fit`` with all regressors and a target.

    Warns
    -----
    FlightDataWarning
        In ``fit`` with targets, if a regressor is constant over the rows with targets.

    Examples
    --------
    >>> import pandas as pd
    >>> flight = pd.DataFrame({"time": [0.0], "flight": ["a"], "alpha": [0.1], "q": [0.2], "elevator": [0.0]})
    >>> RegressorSelector(["alpha", "elevator"]).fit_transform(flight)
       alpha  elevator
    0    0.1       0.0
    """

    _parameter_constraints: dict = {
        "regressors": [StrOptions(set(REGRESSOR_SETS)), list, tuple, np.ndarray],
        "engine": ["boolean"],
    }

    regressors_: list[str]

    def __init__(
        self,
        regressors: Any = "quasi-steady",
        *,
        engine: bool = False,
    ) -> None:
        self.regressors = regressors
        self.engine = engine

    def fit(self, X: Any, y: Any = None) -> Self:
        """Select the regressors of the flight table X, and learn their range over the rows with a target y."""
        table = as_table(X)
        super().fit(table, y)
        values = numeric(table, self.regressors_)
        used = np.isfinite(values).all(axis=1)
        if y is not None:
            targets = np.asarray(y, dtype=float).reshape(len(table), -1)
            used &= np.isfinite(targets).any(axis=1)
        table = table.assign(**by_name(self.regressors_, values))[used]
        known = [name for name in table if name in CHANNELS or name in self.regressors_]
        limits = table[known].select_dtypes("number").dropna(axis=1, how="all").agg(["min", "max"])
        self.ranges_ = {name: tuple(limits[name].astype(float)) for name in limits}
        is_still = constant_columns(values[used])
        names = [name for name, still in zip(self.regressors_, is_still, strict=True) if still]
        if y is not None and names:
            report(Finding(Code.CONSTANT_REGRESSORS, names=names), FlightDataWarning)
        return self

    def _fit_table(self, table):
        self.absent_ = []
        is_set = isinstance(self.regressors, str)
        chosen = self._from_set(table) if is_set else list(self.regressors)
        if not chosen or len({*chosen}) < len(chosen):
            raise ValueError(f"Got regressors {chosen}, but expected at least one, each once.")
        check_columns(table, chosen)
        numeric(table, chosen)
        truth = [name for name in chosen if str(name).endswith(TRUTH_SUFFIX)]
        if truth:
            report(Finding(Code.TRUTH_AS_REGRESSORS, names=truth))
        self.regressors_ = chosen

    def _transform_table(self, table):
        check_columns(table, self.regressors_)
        values = numeric(table, self.regressors_)
        chosen = pd.DataFrame(values, columns=self.regressors_, index=table.index)
        holes = ~(chosen.abs() < 1e60)  # squares of larger numbers overflow
        if holes.any(axis=None):
            counts = holes.sum()
            raise ValueError(
                f"Got {holes.any(axis=1).sum()} of {len(values)} rows whose regressors are NaN or "
                f"infinite (by rows: {counts[counts > 0].to_dict()}), but expected finite ones: drop "
                "these rows of the flight, as FlightCheck gives it, and of its targets, as skdgp "
                "identify does. Interpolate a slow sensor to the clock of the others, leave out an "
                "empty column, and isolated rows, which have no rate of change."
            )
        return chosen

    def _columns_out(self, names):
        return self.regressors_

    def in_simulation(self) -> dict[str, Any]:
        """Return the regressors, their limits, and the flown ranges of other channels."""
        limits = None
        if {*self.regressors_} <= {*self.ranges_}:
            limits = np.array([self.ranges_[name] for name in self.regressors_]).T
        return {"regressors": self.regressors_, "limits": limits, "flown": self.ranges_}

    def _from_set(self, table):
        """Return the regressors of the named set, without the controls that the aircraft does not have."""
        names = list(REGRESSOR_SETS[self.regressors])
        names = [name + HAT if name + HAT in table else name for name in names]
        if ELEVONS[0] in table:
            check_columns(table, MIXED)
        controls = present(CONTROLS, names)
        check_spelling(table, controls)
        self.absent_ = [name for name in controls if name not in table]
        if {*SURFACES} <= {*self.absent_}:
            check_columns(table, SURFACES)
        if "elevator" in self.absent_:  # other regressors take its effect
            report(Finding(Code.NO_ELEVATOR), FlightDataWarning)
        names = [name for name in names if name not in self.absent_]
        for name in present(AUXILIARY, table):
            if np.nanstd(numeric(table, [name])) > LEAST_MOTION:
                names.append(name)
        if self.engine and "throttle" in names:
            throttle = numeric(table, ["throttle"])
            motion, mean = np.nanstd(throttle), np.nanmean(throttle)
            if motion <= LEAST_MOTION:
                names.remove("throttle")
            if max(motion, mean) > LEAST_MOTION:  # a constant thrust still depends on the airspeed
                names.append("airspeed")
        return names
