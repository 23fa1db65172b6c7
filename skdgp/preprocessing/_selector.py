"""RegressorSelector: the columns that coefficients are learned from."""

from __future__ import annotations

import warnings
from difflib import get_close_matches

import numpy as np
import pandas as pd
from sklearn.utils._param_validation import StrOptions

from skdgp._flight.channels import HAT, TRUTH_SUFFIX
from skdgp._flight.checks import check_columns
from skdgp._flight.faults import FlightDataWarning
from skdgp.preprocessing._table import TableTransformer, numeric

SURFACES = ("elevator", "aileron", "rudder")
ELEVONS, MIXED = ("elevon_left", "elevon_right"), ("elevator", "aileron")
OPTIONAL = ("throttle", *SURFACES)
REGRESSOR_SETS = {
    "quasi-steady": ("alpha", "beta", "p", "q", "r", *SURFACES, "throttle"),
    "classical": ("alpha", "beta", "p", "q", "r", "alpha_dot", "beta_dot", *SURFACES, "throttle"),
    "paper": (
        *("ax", "ay", "az", "p", "q", "r", "p_dot", "q_dot", "r_dot", "alpha_dot", "beta_dot", "throttle"),
        *SURFACES,
    ),
}
MAKERS = {
    "alpha_dot": "FlightSmoother()",
    "beta_dot": "FlightSmoother()",
    "p_dot": "FlightSmoother(derivatives=['alpha', 'beta', 'p', 'q', 'r'])",
    "q_dot": "FlightSmoother(derivatives=['alpha', 'beta', 'p', 'q', 'r'])",
    "r_dot": "FlightSmoother(derivatives=['alpha', 'beta', 'p', 'q', 'r'])",
}


LARGEST = 1e60  # of a regressor: squares of larger numbers overflow in what follows
STILL = 1e-9
"""A regressor that varies by less than this fraction of itself was not moved."""


class RegressorSelector(TableTransformer):
    """Choose the regressors from a flight table, by the name of a set or one by one.

    ================= ========================================================================================
    ``quasi-steady``  alpha, beta, p, q, r, elevator, aileron, rudder, throttle
    ``classical``     alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder, throttle
    ``paper``         ax, ay, az, p, q, r, p_dot, q_dot, r_dot, alpha_dot, beta_dot, throttle, elevator,
                      aileron, rudder (Hemakumara & Sukkarieh 2011, eq 22)
    ================= ========================================================================================

    The coefficients follow almost by definition from the accelerations of ``"paper"`` (m a / qbar S): a model on it
    scores well and cannot be simulated, as a simulator has no accelerations to give. In most flights alpha_dot nearly
    equals q, and beta_dot nearly -r cos alpha: the data then hardly tell them apart (Klein & Morelli 2006, section
    5.1), and a model of both errs where another flight does. Hence ``"quasi-steady"``, which merges them.

    In the named sets a non-dimensional rate (``p_hat``) takes the place of the rate where the table has it, and
    controls that the aircraft does not have (throttle, elevator, aileron, rudder; at least one surface must be there)
    are left out and listed in ``absent_``. Everything else is needed.

    Parameters
    ----------
    regressors : {"quasi-steady", "classical", "paper"} or list of str, default="quasi-steady"
        Named set, or columns in order.
    extra : sequence of str, default=()
        Columns to add to a named set, such as ``["airspeed"]``.

    Attributes
    ----------
    regressors_ : list of str
        The columns chosen, in order; ``transform`` needs exactly these.
    absent_ : list of str
        Controls of the named set that the table does not have.
    data_min_, data_max_ : ndarray (d,)
        Of each regressor, over the rows of ``fit`` that have a target: what was flown.
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If a column is missing (with the nearest name), not numeric, or in ``transform`` NaN or infinite somewhere.

    Warns
    -----
    FlightDataWarning
        In ``fit`` with targets, if a regressor never moved at the rows that are learned from, or there are no more of
        these than regressors.

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

    def __init__(self, regressors="quasi-steady", *, extra=()):
        self.regressors = regressors
        self.extra = extra

    def fit(self, X, y=None):
        """Learn which columns are there.

        Parameters
        ----------
        X : DataFrame of shape (n, n_columns)
            Flight table.
        y : array-like of shape (n,) or (n, P), optional
            Targets, NaN where not observed: tell which rows are learned from.

        Returns
        -------
        self
        """
        super().fit(X, y)
        if self._passes:
            return self
        values = numeric(X, self.regressors_)
        if y is not None and len(y) == len(X):
            targets = np.asarray(y, dtype=float).reshape(len(X), -1)
            _warn_of_untold(values, targets, self.regressors_)
            values = values[np.isfinite(targets).any(axis=1)]
        values = values[np.isfinite(values).all(axis=1)]
        ends = (values.min(axis=0), values.max(axis=0)) if len(values) else (None, None)
        self.data_min_, self.data_max_ = ends
        return self

    def _recognises(self, X):
        named = isinstance(self.regressors, str)
        return super()._recognises(X) or (not named and isinstance(X, pd.DataFrame))

    def _fit_table(self, table):
        self.absent_ = []
        if isinstance(self.regressors, str):
            chosen = self._from_set(table, REGRESSOR_SETS[self.regressors])
        else:
            chosen = list(self.regressors)
        chosen += [name for name in self.extra if name not in chosen]
        twice = sorted({name for name in chosen if chosen.count(name) > 1})
        if twice or not chosen:
            raise ValueError(f"Got regressors {chosen}, but expected at least one, each once (twice: {twice}).")
        check_columns(table, chosen)
        numeric(table, chosen)
        _warn_of_truth(chosen)
        self.regressors_ = chosen

    def _transform_table(self, table):
        _check_made(table, self.regressors_)
        check_columns(table, self.regressors_)
        values = numeric(table, self.regressors_)
        _check_whole(values, self.regressors_, table)
        return pd.DataFrame(values, columns=self.regressors_, index=table.index)

    def _columns_out(self, names):
        return self.regressors_

    def _from_set(self, table, names):
        _check_made(table, names)
        here = [name + HAT if name + HAT in table else name for name in names]
        self.absent_ = [name for name in OPTIONAL if name in here and _absent(name, table)]
        if all(surface in self.absent_ for surface in SURFACES):
            check_columns(table, SURFACES)
        return [name for name in here if name not in self.absent_]


def _absent(name, table):
    """Whether the aircraft has no such control; a misspelt one is not absent."""
    if name in table:
        return False
    words = [str(column) for column in table.columns if not str(column).endswith(TRUTH_SUFFIX)]
    return not get_close_matches(name, words, n=1, cutoff=0.85)


def _check_made(table, names):
    """Point to the step that makes a missing column."""
    if all(name in table or name + HAT in table for name in names):
        return
    check_columns(table, [name.removesuffix("_dot") for name in MAKERS if name in names and name not in table])
    missing = {name: maker for name, maker in MAKERS.items() if name in names and name not in table}
    if missing:
        raise ValueError(
            f"The flight lacks {sorted(missing)}, but these regressors need them: put {set(missing.values()).pop()} "
            "before RegressorSelector in the pipeline, or name other regressors."
        )
    if {"elevon_left", "elevon_right"} <= set(table.columns) and "elevator" in names and "elevator" not in table:
        raise ValueError(
            "The flight has elevons but no elevator and aileron: put ElevonSplitter() before RegressorSelector in "
            "the pipeline, or name elevon_left and elevon_right as regressors."
        )


def _warn_of_truth(chosen):
    truth = [name for name in chosen if str(name).endswith(TRUTH_SUFFIX)]
    if truth:
        warnings.warn(
            f"Regressors {truth} are noise-free truth of a simulation, which no aircraft has: use them to score, or "
            "to measure what sensor noise costs.",
            UserWarning,
            stacklevel=4,
        )


def _warn_of_untold(values, targets, names):
    """Warn of what the rows with targets cannot tell: regressors that never moved, slopes more than rows."""
    values = values[np.isfinite(targets.reshape(len(values), -1)).any(axis=1)]
    known = values[np.isfinite(values).all(axis=1)]
    if not len(known):
        return
    still = [name for name, v in zip(names, known.T, strict=True) if np.ptp(v) <= STILL * np.abs(v).max()]
    if len(known) <= len(names):
        warnings.warn(
            f"Got {len(known)} samples to learn from for {len(names)} regressors: too few to tell what each does (at "
            f"least {len(names) + 1}, better hundreds): give longer flights, more samples of them, or fewer columns.",
            FlightDataWarning,
            stacklevel=3,
        )
    elif still:
        warnings.warn(
            f"In the training flights {still} never change: what they do cannot be learned, and the model knows "
            "nothing about them. Fly manoeuvres that move them, or leave them out of the regressors.",
            FlightDataWarning,
            stacklevel=3,
        )


def _check_whole(values, names, table):
    """Raise a ValueError that tells where regressors are no numbers, by the columns that they were made from."""
    holes = ~(np.abs(values) < LARGEST)
    if not holes.any():
        return
    measured, made = {}, {}
    for name, rows in zip(names, holes.sum(axis=0), strict=True):
        sources = _sources(name, table) if rows else {}
        measured |= sources
        made |= {name: int(rows)} if rows and not sources else {}
    raise ValueError(
        f"Got {int(holes.any(axis=1).sum())} of {len(values)} rows whose regressors are NaN or infinite (by rows: "
        f"{measured or made}), but expected finite ones: {_remedy_of_holes(measured)}."
    )


def _remedy_of_holes(measured) -> str:
    if not measured:
        return "leave out rows that stand alone between gaps, which have no rate of change"
    return (
        "drop these rows of the flight (as FlightCheck gives it, if that is in the pipeline) and of its targets, as "
        "python -m skdgp identify does: keep = "
        f"np.isfinite(flight[{list(measured)}]).all(axis=1); flight, Y = flight[keep], Y[keep]. Interpolate a slow "
        "sensor to the clock of the others, leave out a column that is empty"
    )


def _sources(name, table) -> dict[str, int]:
    """Return the measured columns with holes that a regressor was made from, by rows."""
    rate = name.removesuffix(HAT)
    sources = [rate.removesuffix("_dot"), *(["airspeed"] if rate != name else [])]
    sources += ELEVONS if name in MIXED else ()
    holes = {source: ~(np.abs(numeric(table, [source])) < LARGEST) for source in sources if source in table}
    found = {source: int(where.sum()) for source, where in holes.items() if where.any()}
    return {source: n for source, n in found.items() if source in ELEVONS} or found
