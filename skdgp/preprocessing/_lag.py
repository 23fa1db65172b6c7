"""LagCorrector: lags of channels removed."""

from __future__ import annotations

import warnings
from numbers import Real

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from skdgp._compute.sklearn_compat import StrOptions
from skdgp._flight.checks import check_columns
from skdgp._flight.clock import flight_codes, flight_segments, uniform_grid
from skdgp.preprocessing._lag_estimate import FORCE, RATE, SURFACES, UNKNOWN, Lag, air_lag, stretches, surface_lag
from skdgp.preprocessing._reconstruction.flight_log import NEEDED
from skdgp.preprocessing._reconstruction.reconstruction import FlightPathReconstruction
from skdgp.preprocessing._smoother import WRAPPED, _rewrapped, _unwrapped
from skdgp.preprocessing._table import TableTransformer, numeric, with_columns

GROUPS = {
    "air": ("airspeed", "alpha", "beta"),
    "surfaces": SURFACES,
    "attitude": ("phi", "theta", "psi"),
    "gps": ("v_north", "v_east", "v_down", "north", "east", "down"),
}
CONTROLS = (*SURFACES, "throttle", "propeller_speed")
"""Channels without noise, in which steps are common."""
PADDING = 64
KINEMATIC = {"attitude": "attitude_lag", "gps": "velocity_lag"}
BIASES = ("p_bias", "q_bias", "r_bias")
SIGNIFICANT = 3.0
"""A lag of less than so many standard deviations is not told from none."""
LEAST = 0.01
"""A lag [s] of less than this costs a model nothing, and may be one of the local linear model."""
EXPLAINED = 0.8
"""A model that explains less of its response does not tell a lag."""
ENOUGH = 120.0
"""Seconds of each flight from which the lags of attitude and GPS are known to the millisecond."""


class LagCorrector(TableTransformer):
    r"""Estimate how late air data, surfaces, attitude and GPS are against the inertial unit, and shift them back.

    A channel that lags by tau shows at t what was at t - tau, so it is replaced by its value at t + tau, stretch by
    stretch and never across a gap; where that is beyond the end of a stretch the last value stands. Sensors are shifted
    in frequency, which leaves white noise white for :class:`FlightSmoother` to find; controls, and channels of a
    jittered clock, on cubic splines. For full-rate flights, before smoothing.

    Attitude and GPS are tied to gyros and accelerometers by kinematics, through
    :class:`FlightPathReconstruction`. Surfaces and vanes are tied to them by a local linear model, without assumed
    derivatives: at one and the same time

    .. math:: \dot\omega / V^2 \approx B\,[\delta, \omega / V, f / V^2], \quad
              (\alpha, \beta) \approx C\,[f / V^2, \omega / V, \delta],

    all within the band from 0.3 to 4 Hz. The lag is where least squares leaves least: the maximum of the profile
    likelihood (for lags in identification see Jategaonkar 2006, chapter 10; Morelli & Klein 2016, chapter 10). Its
    standard deviation takes residuals as correlated within 5 s (Liang & Zeger 1986).

    Engines take time to answer: throttle and propeller speed are not looked at, but may be given.

    Parameters
    ----------
    lags : {"auto"}, dict or None, default="auto"
        Estimated in ``fit``; or given [s], positive where late, by group (air: airspeed, alpha, beta; surfaces;
        attitude; gps) or column, nothing else being shifted; or None for no change.

    Attributes
    ----------
    lags_ : DataFrame
        By group or column: ``lag`` and ``std`` [s], ``explained`` (share of the response that the local linear model
        explains), ``applied`` (what is taken away [s]) and ``remark``. A lag under 3 standard deviations or 10 ms, or
        one of a model that explains less than 0.8, is not taken away.
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If ``time``, an accelerometer or a gyro is missing; if ``lags`` names what is no group and no column, or is not
        finite.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> t = np.arange(0, 4, 0.02)
    >>> flight = pd.DataFrame({"time": t, "alpha": np.sin(t - 0.08), "q": np.cos(t)})
    >>> on_time = LagCorrector(lags={"air": 0.08}).fit_transform(flight)
    >>> bool(np.allclose(on_time.alpha[:-4], np.sin(t)[:-4], atol=1e-4))
    True
    """

    _parameter_constraints: dict = {"lags": [StrOptions({"auto"}), dict, None]}

    def __init__(self, lags="auto"):
        self.lags = lags

    def _fit_table(self, table):
        check_columns(table, ["time"])
        if isinstance(self.lags, str):
            check_columns(table, [*FORCE, *RATE])
            self.lags_ = _judged(_estimated(table))
        else:
            self.lags_ = _given(self.lags or {}, table)

    def _transform_table(self, table):
        check_columns(table, ["time"])
        time, new = numeric(table, ["time"])[:, 0], {}
        for group, lag in self.lags_["applied"].items():
            for name in GROUPS.get(group, (group,)):
                if lag and name in table:
                    values, noisy = _unwrapped(table, [name])[:, 0], name not in CONTROLS
                    new[name] = _on_time(time, values, lag, table.get("flight"), noisy=noisy)
                    if name in WRAPPED:
                        new[name] = _rewrapped(new[name], table[name])
        return with_columns(table, new)

    def _columns_out(self, names):
        return names


def _on_time(time, values, lag, flight, *, noisy):
    """Return a channel as it is without its lag, on the rows where it was sampled."""
    out, rows = values.copy(), np.flatnonzero(np.isfinite(values))
    for run in flight_segments(time[rows], None if flight is None else np.asarray(flight)[rows]):
        here = rows[run]
        if len(here) < 2:
            continue
        grid, jittered = uniform_grid(time[here])
        clock = time[here] if jittered else grid
        later = clock + lag
        if noisy and not jittered:
            shifted = _advanced(values[here], lag * (len(grid) - 1) / (grid[-1] - grid[0]))
        else:
            shifted = CubicSpline(clock, values[here])(np.clip(later, clock[0], clock[-1]))
        shifted[later > clock[-1]], shifted[later < clock[0]] = values[here[-1]], values[here[0]]
        out[here] = shifted
    return out


def _advanced(values, steps):
    """Return equidistant values a fraction of steps later: an all-pass, so that white noise stays white.

    Every frequency is turned by its phase (Oppenheim & Schafer 2010, section 4.5). The values are continued oddly
    beyond both ends, and the line between these shifted by itself, so that what repeats is continuous.
    """
    reach = min(len(values) - 1, PADDING + int(np.ceil(abs(steps))))
    padded = np.pad(values, reach, mode="reflect", reflect_type="odd")
    n = len(padded)
    slope = (padded[-1] - padded[0]) / (n - 1)
    line = padded[0] + slope * np.arange(n)
    turned = np.fft.rfft(padded - line) * np.exp(2j * np.pi * np.fft.rfftfreq(n) * steps)
    return (np.fft.irfft(turned, n) + line + slope * steps)[reach : n - reach]


def _estimated(table) -> dict[str, Lag]:
    """Return the lag of each group, unknown where the flights do not tell it."""
    flights = stretches(table)
    surfaces = surface_lag(flights)
    air = air_lag(flights, surfaces.lag)
    found = {"air": air, "surfaces": surfaces} | dict.fromkeys(KINEMATIC, UNKNOWN)
    heard = all(name in table and np.isfinite(numeric(table, [name])).any() for name in NEEDED)
    return found | _kinematic(table) if flights and heard else found


def _kinematic(table) -> dict[str, Lag]:
    """Return the lags of attitude and GPS against integrated gyros and accelerometers."""
    codes = flight_codes(table["flight"])[0] if "flight" in table else np.zeros(len(table))
    since = table["time"] - table.groupby(codes)["time"].transform("min")
    bare = table[since < ENOUGH].drop(columns=["alpha", "beta"], errors="ignore")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # of what flights do not show: the standard deviation says it
        path = FlightPathReconstruction(calibrate=[*BIASES, *KINEMATIC.values()]).fit(bare)
    precision = (path.calibration_.set_index("constant")["std"] ** -2).groupby(level=0).sum()
    return {
        group: Lag(path.sensors_[constant], float(precision[constant] ** -0.5), np.nan)
        for group, constant in KINEMATIC.items()
    }


def _judged(found) -> pd.DataFrame:
    """Return the table of lags, with those that are to be taken away."""
    table = pd.DataFrame.from_dict(found, orient="index", columns=Lag._fields).rename_axis("group")
    table["remark"] = [_remark(lag) for lag in found.values()]
    table["applied"] = table["lag"].where(table["remark"] == "taken away", 0.0)
    return table[[*Lag._fields, "applied", "remark"]]


def _remark(found: Lag) -> str:
    if not np.isfinite(found.std):
        return "not told by these flights"
    if found.explained < EXPLAINED:
        return "not told: the local linear model explains too little"
    if abs(found.lag) < SIGNIFICANT * found.std:
        return "not significant"
    return "too small to matter" if abs(found.lag) < LEAST else "taken away"


def _given(lags, table) -> pd.DataFrame:
    strange = [name for name in lags if name not in GROUPS and name not in table]
    if strange:
        raise ValueError(f"Got lags of {strange}, but expected groups {list(GROUPS)} or columns of the table.")
    wrong = {name: lag for name, lag in lags.items() if not isinstance(lag, Real) or not np.isfinite(lag)}
    if wrong:
        raise ValueError(f"Got lags {wrong}, but expected finite numbers of seconds.")
    rows = {name: (float(lag), np.nan, np.nan, float(lag), "given") for name, lag in lags.items()}
    columns = [*Lag._fields, "applied", "remark"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("group")
