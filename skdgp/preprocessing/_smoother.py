"""FlightSmoother: zero-phase smoothing and differentiation, flight by flight."""

from __future__ import annotations

from numbers import Real

import numpy as np

from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._flight.checks import check_columns, check_radians
from skdgp._flight.smoothing import differentiate, noise_level, smooth
from skdgp.preprocessing._table import TableTransformer, numeric, with_columns

SMOOTHED = (
    *("airspeed", "alpha", "beta", "alpha_dot", "beta_dot", "p", "q", "r", "p_dot", "q_dot", "r_dot"),
    *("ax", "ay", "az"),
)
DIFFERENTIATED = ("alpha", "beta")
VANES = ("alpha", "beta")
PARTNERS = {
    "rates": ("airspeed", "p", "q", "r"),
    "inertial": ("airspeed", "p", "q", "r", "ax", "ay", "az"),
}
WRAPPED = ("phi", "psi")
IN_RADIANS = ("alpha", "beta", "p", "q", "r")


class FlightSmoother(TableTransformer):
    """Smooth measured channels with zero phase and add their rates of change, flight by flight.

    Each gap-free stretch of each flight is filtered alone, on the columns ``time`` [s] and, where it is there,
    ``flight``. With ``cutoff="auto"`` each channel gets the Wiener smoother of its own spectrum,
    H(f) = max(0, 1 - N / P(f)), where N is the white noise that the upper end of P shows: a quiet channel stays as it
    is, a noisy vane keeps what lies below a few hertz. Rates of change are slopes of the cubic spline through the
    smoothed channel. Missing values (NaN) stay missing, and a slow sensor is filtered on its own clock.

    Smooth the whole flight at its full rate, before thinning: leave samples out of the fit by their targets
    (:func:`skdgp.model_selection.thin_targets`).

    Parameters
    ----------
    cutoff : {"auto"}, float, dict or None, default="auto"
        Chosen by the data; or half-amplitude frequency [Hz] of a forward-backward Butterworth filter; or one of these
        for each column by name (others: "auto"); or None for no smoothing.
    columns : "auto" or list of str, default="auto"
        Columns to smooth. "auto": airspeed, alpha, beta, rates and accelerations, those that are there. Controls and
        attitudes stay as they are unless named.
    derivatives : "auto" or list of str, default="auto"
        Columns to differentiate into ``<name>_dot``. "auto": alpha and beta, if they are there. A rate that the table
        already holds was measured and is kept (and smoothed).
    joint : {"rates", "inertial"} or None, default="rates"
        Whose company alpha and beta are smoothed in, where their cutoff is "auto": airspeed, p, q and r, or ax, ay and
        az too. A vane that moves as the gyros say is believed beyond the frequency at which it is lost alone.
        "inertial" is the more exact, but puts the forces that a model is to predict into its alpha and beta: fit for
        reconstructing a flight, not for judging a model.

    Attributes
    ----------
    columns_, derivatives_ : list of str
        Columns smoothed and differentiated.
    partners_ : list of str
        Columns in whose company alpha and beta are smoothed; ``transform`` needs them too.
    noise_std_, error_std_ : dict of str to float
        Standard deviation of each smoothed column's white noise as measured, and what smoothing by "auto" is
        expected to leave of it; NaN for a log too short to tell (less than 128 samples).
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If ``time`` is missing, does not increase within a flight or is grossly irregular; if a named column is
        missing or not numeric; if angles of the air or rates are larger than radians can be.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time = np.arange(0, 120, 0.025)
    >>> noise = np.random.default_rng(0).normal(0, 0.005, time.size)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + noise})
    >>> smoother = FlightSmoother().fit(flight)
    >>> list(smoother.get_feature_names_out())
    ['time', 'alpha', 'alpha_dot']
    >>> smoothed = smoother.transform(flight)
    >>> bool(np.std(smoothed.alpha_dot - 0.1 * np.cos(time)) < 0.02)
    True
    >>> round(smoother.noise_std_["alpha"], 3)
    0.005
    """

    _cutoff = [Interval(Real, 0, None, closed="neither"), StrOptions({"auto"}), dict, None]
    _parameter_constraints: dict = {
        "cutoff": _cutoff,
        "columns": [StrOptions({"auto"}), list, tuple],
        "derivatives": [StrOptions({"auto"}), list, tuple],
        "joint": [StrOptions(set(PARTNERS)), None],
    }

    def __init__(self, *, cutoff="auto", columns="auto", derivatives="auto", joint="rates"):
        self.cutoff = cutoff
        self.columns = columns
        self.derivatives = derivatives
        self.joint = joint

    def _fit_table(self, table):
        self.columns_ = _present(SMOOTHED, table) if self.columns == "auto" else list(self.columns)
        wanted = _present(DIFFERENTIATED, table) if self.derivatives == "auto" else list(self.derivatives)
        self.derivatives_ = [name for name in wanted if f"{name}_dot" not in table]
        check_columns(table, ["time", *self.columns_, *wanted])
        if isinstance(self.cutoff, dict):
            check_columns(table, self.cutoff)
        numeric(table, {*self.columns_, *wanted})
        check_radians(table, IN_RADIANS)
        read = {*self.columns_, *self.derivatives_}
        self._vanes = [name for name in VANES if self.joint and name in read and self._cutoff_of(name) == "auto"]
        self.partners_ = _present(PARTNERS[self.joint], table) if self._vanes else []
        levels = {}
        for names, partners, _ in self._groups(self.columns_):
            found = noise_level(_unwrapped(table, names + partners), **_clock(table), joint=bool(partners))
            levels |= dict(zip(names, zip(*found, strict=True), strict=False))
        self.noise_std_ = {name: float(levels[name][0]) for name in self.columns_}
        self.error_std_ = {name: float(levels[name][1]) for name in self.columns_}

    def _transform_table(self, table):
        check_columns(table, ["time", *self.columns_, *self.derivatives_, *self._vanes, *self.partners_])
        numeric(table, [*self.columns_, *self.derivatives_])
        check_radians(table, IN_RADIANS)
        new = self._apply(smooth, self.columns_, table)
        new |= {name: _rewrapped(new[name], table[name]) for name in WRAPPED if name in new}
        rates = self._apply(differentiate, self.derivatives_, table)
        return with_columns(table, new | {f"{name}_dot": rate for name, rate in rates.items()})

    def _columns_out(self, names):
        return names + [f"{name}_dot" for name in self.derivatives_]

    def _apply(self, operation, names, table):
        """Smooth or differentiate the named columns, each in its group."""
        new = {}
        for group, partners, cutoff in self._groups(names):
            values = operation(
                _unwrapped(table, group + partners), cutoff=cutoff, joint=bool(partners), **_clock(table)
            )
            new |= dict(zip(group, values.T, strict=False))  # partners help, and are smoothed by themselves
        return {name: new[name] for name in names}

    def _groups(self, names):
        """Return (columns filtered at once, their partners, cutoff); every name is in one group."""
        groups = [(self._vanes, self.partners_, "auto")] if any(name in self._vanes for name in names) else []
        rest = {name: self._cutoff_of(name) for name in names if name not in self._vanes}
        for cutoff in dict.fromkeys(rest.values()):
            groups.append(([name for name in rest if rest[name] == cutoff], [], cutoff))
        return groups

    def _cutoff_of(self, name):
        return self.cutoff.get(name, "auto") if isinstance(self.cutoff, dict) else self.cutoff


def _present(names, table):
    return [name for name in names if name in table]


def _clock(table):
    return {"time": numeric(table, ["time"])[:, 0], "flight": table.get("flight")}


def _unwrapped(table, names):
    """Columns as floats (n, k), roll and heading without their jumps of 2 pi."""
    values = numeric(table, names).copy()
    for j, name in enumerate(names):
        if name in WRAPPED:
            known = np.isfinite(values[:, j])
            values[known, j] = np.unwrap(values[known, j])
    return values


def _rewrapped(angle, near):
    """Return the same angle within pi of the one that was logged."""
    return angle - 2 * np.pi * np.round((angle - near.to_numpy(float)) / (2 * np.pi))
