"""FlightSmoother: zero-phase smoothing and differentiation, flight by flight."""

from __future__ import annotations

from numbers import Real
from typing import Any

from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._compute.typing import Vector
from skdgp._flight.channels import AIR_DATA, RATES, SPECIFIC_FORCE, VANES
from skdgp._flight.checks import WRAPPED, check_columns, check_radians, numeric, unwrapped
from skdgp._flight.smoothing import differentiate, noise_level, smooth
from skdgp.preprocessing._table import TableTransformer, with_columns, wrapped_near

SMOOTHED = (
    *(*AIR_DATA, "alpha_dot", "beta_dot", *RATES, "p_dot", "q_dot", "r_dot", *SPECIFIC_FORCE),
)
PARTNERS = {"rates": ("airspeed", *RATES), "inertial": ("airspeed", *RATES, *SPECIFIC_FORCE)}
IN_RADIANS = (*VANES, *RATES)


class FlightSmoother(TableTransformer):
    """Smooth measured channels with zero phase and add their rates of change, flight by flight.

    Each gap-free segment of a flight is filtered by itself, by the columns ``time`` [s] and
    ``flight`` (optional), at its full rate. With ``cutoff="auto"`` each channel gets the Wiener
    smoother of its own spectrum, H(f) = max(0, 1 - N / P(f)), where N is the white noise at the
    upper end of P. Rates of change are derivatives of the cubic spline through the smoothed
    channel. Missing values (NaN) stay missing; a slow sensor is filtered at its own rate. Raises
    ValueError if ``time`` is missing, does not increase within a flight or is too irregular; if a
    named column is missing or not numeric; if angles or rates are too large for radians.

    Parameters
    ----------
    cutoff : {"auto"}, float or None, default="auto"
        Wiener smoother; or the half-amplitude frequency [Hz] of a forward-backward Butterworth
        filter; or None for no smoothing. For another cutoff of some columns, put a smoother of
        these ``columns`` before.
    columns : "auto" or list of str, default="auto"
        Columns to smooth. "auto": airspeed, alpha, beta, rates and accelerations, where present.
    derivatives : "auto" or list of str, default="auto"
        Columns to differentiate into ``<name>_dot``. "auto": alpha and beta, where present. A
        measured rate is kept.
    joint : {"rates", "inertial"} or None, default="rates"
        Channels to smooth alpha and beta jointly with, if the cutoff is "auto": airspeed, p, q
        and r; "inertial" adds ax, ay and az. Their cross-spectra keep higher frequencies of the
        vanes than their own spectra do. "inertial" is more exact, but puts the forces that a model
        shall predict into its alpha and beta.

    Attributes
    ----------
    columns_, derivatives_ : list of str
        Columns smoothed and differentiated.
    partners_ : list of str
        Columns that alpha and beta are smoothed with; ``transform`` needs them too.
    noise_std_ : dict of str to float
        White noise of each smoothed column; NaN of less than 128 samples.

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

    _parameter_constraints: dict = {
        "cutoff": [Interval(Real, 0, None, closed="neither"), StrOptions({"auto"}), None],
        "columns": [StrOptions({"auto"}), list, tuple],
        "derivatives": [StrOptions({"auto"}), list, tuple],
        "joint": [StrOptions(set(PARTNERS)), None],
    }

    def __init__(
        self,
        *,
        cutoff: Any = "auto",
        columns: Any = "auto",
        derivatives: Any = "auto",
        joint: str | None = "rates",
    ) -> None:
        self.cutoff = cutoff
        self.columns = columns
        self.derivatives = derivatives
        self.joint = joint

    def _fit_table(self, table):
        self.columns_ = _present(SMOOTHED, table) if self.columns == "auto" else list(self.columns)
        wanted = _present(VANES, table) if self.derivatives == "auto" else list(self.derivatives)
        self.derivatives_ = [name for name in wanted if f"{name}_dot" not in table]
        check_columns(table, ["time", *self.columns_, *wanted])
        numeric(table, {*self.columns_, *wanted})
        check_radians(table, IN_RADIANS)
        used = {*self.columns_, *self.derivatives_}
        is_joint = self.joint and self.cutoff == "auto"
        self._vanes = [name for name in VANES if is_joint and name in used]
        self.partners_ = _present(PARTNERS[self.joint], table) if self.joint and self._vanes else []
        noise = noise_level(unwrapped(table, self.columns_), **_clock(table))
        self.noise_std_ = dict(zip(self.columns_, noise.tolist(), strict=True))

    def _transform_table(self, table):
        check_columns(
            table, ["time", *self.columns_, *self.derivatives_, *self._vanes, *self.partners_]
        )
        numeric(table, [*self.columns_, *self.derivatives_])
        check_radians(table, IN_RADIANS)
        new = self._apply(smooth, self.columns_, table)
        new |= {name: wrapped_near(new[name], table[name]) for name in WRAPPED if name in new}
        rates = self._apply(differentiate, self.derivatives_, table)
        return with_columns(table, new | {f"{name}_dot": rate for name, rate in rates.items()})

    def _columns_out(self, names):
        return names + [f"{name}_dot" for name in self.derivatives_]

    def _apply(self, operation, names, table):
        new: dict[str, Vector] = {}
        for group, partners in self._groups(names):
            columns = unwrapped(table, group + partners)
            values = operation(columns, cutoff=self.cutoff, joint=bool(partners), **_clock(table))
            new |= dict(
                zip(group, values.T, strict=False)
            )  # without the partners, which are in other groups
        return {name: new[name] for name in names}

    def _groups(self, names):
        """Return (columns to filter together, their partners); every name is in one group."""
        apart = [name for name in names if name not in self._vanes]
        groups = [(self._vanes, self.partners_)] * any(name in self._vanes for name in names)
        return groups + [(apart, [])] * bool(apart)


def _present(names, table):
    return [name for name in names if name in table]


def _clock(table):
    return {"time": numeric(table, ["time"])[:, 0], "flight": table.get("flight")}
