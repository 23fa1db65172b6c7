"""ElevonSplitter, RateNondimensionalizer and RegressorSelector: from columns of a flight to the regressors."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from numbers import Real
from typing import Any, Self

import numpy as np
import pandas as pd

from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import report
from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._flight.channels import (
    CHANNELS,
    ELEVONS,
    HAT,
    LENGTHS,
    MIXED,
    RATES,
    REGRESSOR_SETS,
    SURFACES,
    TRUTH_SUFFIX,
    VANES,
    rate_factor,
)
from skdgp._flight.checks import check_columns
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.tables import numeric
from skdgp._flight.units import check_airspeed
from skdgp.preprocessing._table import TableTransformer, as_pandas, with_columns

RATED = (*VANES, *RATES)
# The column that another is made from, and the step that does it
MAKERS = {
    **{f"{name}_dot": (name, f"FlightSmoother(derivatives={[*RATED]})") for name in RATED},
    **dict.fromkeys(MIXED, (ELEVONS[0], "ElevonSplitter()")),
}
LARGEST = 1e60  # regressor; squares of larger numbers overflow
STILL = 1e-9  # a regressor that varies by less than this fraction of itself is constant


class ElevonSplitter(TableTransformer):
    r"""Mix control surfaces into controls.

    .. math:: \text{controls} = \text{mixing} \cdot \text{surfaces}

    Default: elevator = (left + right) / 2, aileron = (left - right) / 2 of two elevons. If the
    elevons are exchanged, lift and elevator of a symmetric aircraft stay, and roll moment and
    aileron change sign.

    A table with the controls but without the surfaces (a conventional aircraft, a simulation) does
    not change. With both, the controls are computed from the surfaces. Raises ValueError if the
    table has neither, or the mixing has another shape.

    Parameters
    ----------
    surfaces : sequence of str, default=("elevon_left", "elevon_right")
        Columns of the deflections [rad].
    controls : sequence of str, default=("elevator", "aileron")
        Columns to compute [rad].
    mixing : array-like of shape (n_controls, n_surfaces), optional
        By default the mixing of two elevons.

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
        self,
        *,
        surfaces: Sequence[str] = ELEVONS,
        controls: Sequence[str] = MIXED,
        mixing: Any = None,
    ) -> None:
        self.surfaces = surfaces
        self.controls = controls
        self.mixing = mixing

    def _fit_table(self, table):
        shape = (len(self.controls), len(self.surfaces))
        if self.mixing is None and shape != (2, 2):
            raise ValueError(
                f"Got {shape[1]} surfaces for {shape[0]} controls and no mixing, but expected "
                f"mixing."
            )
        self.mixing_ = np.array(
            [[0.5, 0.5], [0.5, -0.5]] if self.mixing is None else self.mixing, dtype=float
        )
        if self.mixing_.shape != shape:
            raise ValueError(
                f"Got mixing of shape {self.mixing_.shape}, but expected (n_controls, n_surfaces) "
                f"= {shape}: one row "
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
        if not any(name in table for name in self.surfaces) and all(
            name in table for name in self.controls
        ):
            return {}
        check_columns(table, self.surfaces)
        values = self.mixing_ @ numeric(table, self.surfaces).T
        return dict(zip(self.controls, values, strict=True))


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

    in_simulation = "rates"
    _parameter_constraints: dict = {
        key: [Interval(Real, 0, None, closed="neither")] for key in ("span", "chord")
    }

    def __init__(self, span: float, chord: float) -> None:
        self.span = span
        self.chord = chord

    def _fit_table(self, table):
        self.rates_ = [name for name in LENGTHS if name in table]
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
    left out and listed in ``absent_``. All other columns are needed. Raises ValueError if a column
    is missing (with the nearest name) or not numeric, or has NaN or infinite values in
    ``transform``.

    Parameters
    ----------
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        Named set, or columns in order.
    extra : sequence of str, default=()
        Columns to add to a named set, such as ``["airspeed"]``.

    Attributes
    ----------
    regressors_ : list of str
        The selected columns, in order; ``transform`` needs these.
    absent_ : list of str
        Controls of the named set that the table does not have.
    data_min_, data_max_ : ndarray (d,)
        Range of each regressor over the rows of ``fit`` that have a target.
    ranges_ : dict of str to tuple of float
        Range of each flight channel of the table over these rows.

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

    in_simulation = "regressors"
    _parameter_constraints: dict = {
        "regressors": [StrOptions(set(REGRESSOR_SETS)), list, tuple, np.ndarray],
        "extra": [list, tuple, np.ndarray],
    }

    def __init__(self, regressors: Any = "quasi-steady", *, extra: Sequence[str] = ()) -> None:
        self.regressors = regressors
        self.extra = extra

    def fit(self, X: Any, y: Any = None) -> Self:
        """Select the regressors of the flight table X, and learn their range over the rows with a target y."""
        X = as_pandas(X)
        super().fit(X, y)
        observed = np.ones(len(X), dtype=bool)
        is_targeted = y is not None and len(y) == len(X)
        if is_targeted:
            targets = np.asarray(y, dtype=float).reshape(len(X), -1)
            observed = np.isfinite(targets).any(axis=1)
        values = numeric(X, self.regressors_)
        values = values[observed & np.isfinite(values).all(axis=1)]
        self.data_min_ = values.min(axis=0) if len(values) else None
        self.data_max_ = values.max(axis=0) if len(values) else None
        self.ranges_ = {}
        channels = [name for name in X if name in CHANNELS]
        for name, column in X[channels].select_dtypes("number").items():
            observed_values = column[observed].dropna()
            if len(observed_values):
                self.ranges_[str(name)] = float(observed_values.min()), float(observed_values.max())
        if is_targeted and len(values):
            is_still = np.ptp(values, axis=0) <= STILL * np.abs(values).max(axis=0)
            self._warn_of_constant(np.flatnonzero(is_still))
        return self

    def _warn_of_constant(self, columns):
        names = [self.regressors_[k] for k in columns]
        if names:
            finding = Finding(Code.CONSTANT_REGRESSORS, numbers={"names": names})
            report(finding, FlightDataWarning, stacklevel=3)

    def _fit_table(self, table):
        self.absent_ = []
        is_set = isinstance(self.regressors, str)
        chosen = self._from_set(table) if is_set else list(self.regressors)
        chosen += [name for name in self.extra if name not in chosen]
        twice = sorted({name for name in chosen if chosen.count(name) > 1})
        if twice or not chosen:
            raise ValueError(
                f"Got regressors {chosen}, but expected at least one, each once (twice: {twice})."
            )
        _check_made(table, chosen)
        check_columns(table, chosen)
        numeric(table, chosen)
        truth = [name for name in chosen if str(name).endswith(TRUTH_SUFFIX)]
        if truth:
            report(Finding(Code.TRUTH_AS_REGRESSORS, numbers={"names": truth}), stacklevel=3)
        self.regressors_ = chosen

    def _transform_table(self, table):
        _check_made(table, self.regressors_)
        check_columns(table, self.regressors_)
        values = numeric(table, self.regressors_)
        holes = ~(np.abs(values) < LARGEST)
        if holes.any():
            counts = zip(self.regressors_, holes.sum(axis=0).tolist(), strict=True)
            missing = {name: rows for name, rows in counts if rows}
            raise ValueError(
                f"Got {int(holes.any(axis=1).sum())} of {len(values)} rows whose regressors are NaN "
                f"or infinite (by rows: {missing}), but expected finite ones: drop these rows of "
                f"the flight, as FlightCheck gives it, and of its targets, as skdgp identify does. "
                f"Interpolate a slow sensor to the clock of the others, leave out an empty column, "
                f"and isolated rows, which have no rate of change."
            )
        return pd.DataFrame(values, columns=self.regressors_, index=table.index)

    def _columns_out(self, names):
        return self.regressors_

    def _from_set(self, table):
        names = list(REGRESSOR_SETS[self.regressors])
        _check_made(table, names)
        names = [name + HAT if name + HAT in table else name for name in names]
        columns = [str(name) for name in table.columns if not str(name).endswith(TRUTH_SUFFIX)]
        controls = ("throttle", *SURFACES)
        missing = [name for name in controls if name in names and name not in table]  # or misspelt
        self.absent_ = [
            name for name in missing if not get_close_matches(name, columns, n=1, cutoff=0.85)
        ]
        if all(surface in self.absent_ for surface in SURFACES):
            check_columns(table, SURFACES)
        return [name for name in names if name not in self.absent_]


def _check_made(table: pd.DataFrame, names: Sequence[str]) -> None:
    """Raise ValueError, with the step that adds it, if a column is missing that could be made."""
    lacking = [name for name in names if name not in table and name + HAT not in table]
    makers = {name: MAKERS[name] for name in lacking if name in MAKERS}
    steps = {name: step for name, (origin, step) in makers.items() if origin in table}
    if steps:
        raise ValueError(
            f"The flight lacks {sorted(steps)}, but these regressors need them: put "
            f"{', '.join(dict.fromkeys(steps.values()))} before RegressorSelector in the pipeline, "
            "or name other regressors."
        )
    rates = [name for name in makers if name.endswith("_dot")]
    check_columns(table, [makers[name][0] for name in rates])
