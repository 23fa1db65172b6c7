"""FlightCheck and FlightSmoother: faults and noise of single channels, flight by flight."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd
from scipy.integrate import cumulative_trapezoid
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.messages import report
from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    AUXILIARY,
    RATES,
    SPECIFIC_FORCE,
    VANES,
)
from skdgp._flight.faults import BRIDGED, FlightDataWarning, clean, find_faults
from skdgp._flight.findings import Code, Finding
from skdgp._flight.frames import air_velocity, flow_angle_rates
from skdgp._flight.smoothing import (
    band_limited,
    differentiate,
    smooth,
    vibration_band,
)
from skdgp._flight.tables import (
    FlightTable,
    by_name,
    check_columns,
    has_values,
    interpolate_missing,
    numeric,
    unwrapped,
    wrap_near,
)
from skdgp._flight.units import check_airspeed, check_radians
from skdgp.estimation import airspeed_scale
from skdgp.preprocessing._table import TableTransformer, present


def inspect_flight(flight: pd.DataFrame, *, ignore: Iterable[str] = ()) -> pd.DataFrame:
    """Return the faults of a flight log, one per row.

    A run of equal values is a fault if the channel's noise and usual rate make it improbable (less
    than once in 10,000 such flights). Sensors slower than the table, quantised sensors, and
    controls held still are no faults.

    ============== ===========================================================================================
    ``gap``        time jumps forward by more than 2.5 steps
    ``missing``    no value where the channel usually has one
    ``stuck``      a sensor repeats its last value for 0.3 s or longer
    ``impossible`` a value that no aircraft has, in at most 5 % of the samples: more are of another unit
    ``spike``      up to three samples that jump away from their neighbours, or to zero again and again
    ``constant``   a sensor that never changes while similar ones do
    ``jump``       an angle of the attitude changes within a step by 0.15 rad more than the gyros turn
    ============== ===========================================================================================

    Raises ValueError if ``time`` is missing, not finite or not in order.

    Parameters
    ----------
    flight : DataFrame of shape (n, n_columns)
        Flight table, with ``time`` [s], and ``flight`` where it holds several.
    ignore : iterable of str, default=()
        Columns to skip.

    Returns
    -------
    DataFrame
        Columns flight, channel, kind, start and end [s], n_samples, message.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time, rng = np.arange(0, 60, 0.025), np.random.default_rng(0)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + rng.normal(0, 0.005, time.size)})
    >>> len(inspect_flight(flight))
    0
    >>> flight.loc[400:479, "alpha"] = flight.alpha[400]
    >>> inspect_flight(flight)[["channel", "kind", "start", "end", "n_samples"]].round(3).values.tolist()
    [['alpha', 'stuck', 10.025, 11.975, 79]]
    """
    columns = ["flight", "channel", "kind", "start", "end", "n_samples", "message"]
    rows = []
    for fault in find_faults(FlightTable.of(flight), ignore):
        found = fault.finding
        place = [found.numbers[name] for name in ("start", "end", "samples")]
        rows.append([found.flight, found.channel, found.code.label, *place, found.text])
    return pd.DataFrame(rows, columns=columns)


class FlightCheck(TableTransformer):
    """Remove the faults of a flight log and the error of its airspeed: the first step of a pipeline.

    Stuck and impossible values and spikes (:func:`inspect_flight`) become NaN. Gaps up to 0.25 s
    are interpolated linearly, in channels with a value in nearly every row; longer ones
    stay NaN, which :class:`RegressorSelector` refuses. Where rows repeat the last sample of a slower
    clock, controls become splines between samples. A relative error of the airspeed, which legs of
    several headings show in ``fit``, is removed. Raises ValueError if ``time`` is missing, or
    does not increase within a flight; if the table has no channel of docs/notation.md; in
    ``transform`` if an airspeed is not positive.

    Parameters
    ----------
    ignore : sequence of str, default=()
        Columns to skip.

    Attributes
    ----------
    airspeed_scale_ : AirspeedScale
        Relative error of the airspeed, by the flights of ``fit``.

    Warns
    -----
    FlightDataWarning
        In ``transform``, if the log has faults other than gaps in time; one warning of all. If
        channels have slower clocks, which the warning names.
    FindingWarning
        In ``fit``, of an error of the airspeed that is removed.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> time, rng = np.arange(0, 60, 0.025), np.random.default_rng(0)
    >>> flight = pd.DataFrame({"time": time, "alpha": 0.1 * np.sin(time) + rng.normal(0, 0.005, time.size)})
    >>> FlightCheck().fit_transform(flight).equals(flight)
    True
    """

    _parameter_constraints: dict = {"ignore": [list, tuple]}

    def __init__(self, *, ignore: Sequence[str] = ()) -> None:
        self.ignore = ignore

    def transform(self, X: Any) -> Any:
        """Return the flight table X without faults and error of the airspeed, with its index."""
        check_is_fitted(self)
        flights = self._read(X)
        if flights is not X:  # of clean flights the findings are known
            for finding in flights.findings or ():
                report(finding, FlightDataWarning)
        return self._transform_table(flights)

    def _read(self, X):
        is_clean = isinstance(X, FlightTable) and X.findings is not None
        return X if is_clean else clean(FlightTable.of(super()._read(X)), self.ignore)

    def _fit_table(self, flights):
        self._check_any(flights.table, BRIDGED)
        self.airspeed_scale_ = airspeed_scale(flights.table)
        removed = self.airspeed_scale_.removable()
        if removed:
            report(
                Finding(
                    Code.AIRSPEED_CORRECTED,
                    percent=100 * removed,
                    std_percent=100 * self.airspeed_scale_.std,
                )
            )

    def _transform_table(self, flights):
        check_airspeed(flights.column("airspeed"))
        table, scale = flights.table, self.airspeed_scale_.removable()
        if not scale or "airspeed" not in table:
            return table
        return table.assign(airspeed=table["airspeed"] / (1 + scale))


SMOOTHED = (
    *AIR_DATA,
    "alpha_dot",
    "beta_dot",
    *RATES,
    "p_dot",
    "q_dot",
    "r_dot",
    *SPECIFIC_FORCE,
)
CONTROLS = (*ALL_SURFACES, *AUXILIARY, "throttle", "propeller_speed")
IN_RADIANS = (*VANES, *RATES)
# Channels that show the motion through steady air
MOTION = (*AIR_DATA, *SPECIFIC_FORCE, *RATES, "phi", "theta")


class FlightSmoother(TableTransformer):
    """Smooth measured channels with zero phase and add their rates of change, flight by flight.

    Each gap-free segment of a flight is filtered by itself, by the columns ``time`` [s] and
    ``flight`` (optional), at its full rate. With ``cutoff="auto"`` each channel gets the Wiener
    smoother of its own spectrum, H(f) = max(0, 1 - N / P(f)), where N is the white noise at the
    upper end of P. Of alpha and beta it filters only what the motion through steady air does not
    explain, where a flight has both, airspeed, phi, theta, rates and specific force: a transient of a
    quiet flight is kept. Rates of change are derivatives of the cubic spline through the smoothed
    channel. Flights that vibrate beyond the motion of the aircraft lose, with "auto" columns and
    cutoff, all frequencies beyond it, and so do their controls: vibration biases slopes. Missing
    values (NaN) stay missing; a slow sensor is filtered at its own rate. Raises
    ValueError if ``time`` is missing, does not increase within a flight or is too irregular; if a
    named column is missing or not numeric, or "auto" finds none; if angles or rates are too large for radians.

    Parameters
    ----------
    cutoff : {"auto"}, float or None, default="auto"
        Wiener smoother; or the half-amplitude frequency [Hz] of a forward-backward Butterworth
        filter; or None for no smoothing. For another cutoff of some columns, put a smoother of
        these ``columns`` before.
    columns : "auto" or list of str, default="auto"
        Columns to smooth, and to differentiate into ``<name>_dot``. "auto": airspeed, alpha, beta, rates and
        accelerations, where present; of these alpha, beta and rates are differentiated. A measured
        ``<name>_dot`` is kept.

    Attributes
    ----------
    columns_, derivatives_ : list of str
        Columns smoothed and differentiated.
    band_ : float
        Highest frequency [Hz] of channels and controls, where the flights of ``fit`` vibrate; else
        infinite.

    Warns
    -----
    FindingWarning
        In ``fit``, of vibration.

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
    """

    _parameter_constraints: dict = {
        "cutoff": [Interval(Real, 0, None, closed="neither"), StrOptions({"auto"}), None],
        "columns": [StrOptions({"auto"}), list, tuple],
    }

    def __init__(
        self,
        *,
        cutoff: Any = "auto",
        columns: Any = "auto",
    ) -> None:
        self.cutoff = cutoff
        self.columns = columns

    def _fit_table(self, table):
        is_auto = self.columns == "auto"
        self.columns_ = present(SMOOTHED, table) if is_auto else list(self.columns)
        self._check_columns(table)
        if is_auto:
            self._check_any(table, SMOOTHED)
        rates = present(IN_RADIANS, table) if is_auto else self.columns_
        self.derivatives_ = [name for name in rates if f"{name}_dot" not in table]
        self.band_ = vibration_band(table) if is_auto and self.cutoff == "auto" else np.inf
        if np.isfinite(self.band_):
            report(Finding(Code.VIBRATION, band=self.band_))

    def _check_columns(self, table):
        check_columns(table, ["time", *self.columns_])
        numeric(table, self.columns_)
        check_radians(table, IN_RADIANS)

    def _transform_table(self, table):
        self._check_columns(table)
        new = self._apply(smooth, self.columns_, table)
        wrap_near(new, table)
        for name, rate in self._apply(differentiate, self.derivatives_, table).items():
            new[f"{name}_dot"] = rate
        smoothed = table.assign(**new)
        if np.isinf(self.band_):
            return smoothed
        names = present(dict.fromkeys((*SMOOTHED, *new, *CONTROLS)), smoothed)
        values = band_limited(numeric(smoothed, names), smoothed, self.band_)
        return smoothed.assign(**by_name(names, values))

    def _columns_out(self, names):
        return names + [f"{name}_dot" for name in self.derivatives_]

    def _apply(self, operation, names, table):
        """Return filtered columns by name."""
        if not names:
            return {}
        clock = {"time": numeric(table, ["time"])[:, 0], "flight": table.get("flight")}
        values = unwrapped(table, names)
        if self.cutoff != "auto":
            return by_name(names, operation(values, cutoff=self.cutoff, **clock))
        motion = np.nan_to_num(_angles_by_motion(table).reindex(columns=names))
        rest = operation(values - motion, cutoff="auto", **clock)
        return by_name(names, rest + operation(motion, cutoff=None, **clock))


def _angles_by_motion(table: pd.DataFrame) -> pd.DataFrame:
    """Return the changes of alpha and beta (n, 2) by the motion through steady air [rad], from zero in each segment.

    Zero where a segment lacks airspeed, a vane, attitude or an inertial sensor.
    """
    flights = FlightTable.of(table)
    changes = np.zeros((len(table), 2))
    for rows in flights.segments:
        part = table.iloc[rows]
        if not has_values(part, *MOTION):
            continue
        time = flights.time[rows]
        values = interpolate_missing(time, unwrapped(part, MOTION))
        air, force, rates, attitude = np.split(values, [3, 6, 9], axis=1)
        airspeed, alpha, beta = air.T
        velocity = air_velocity(airspeed, alpha, beta)
        # at rest the rates of the angles diverge
        of_angles = flow_angle_rates(velocity, force, rates, attitude, least_speed=1.0)
        changes[rows] = cumulative_trapezoid(of_angles, time, axis=0, initial=0)
    return pd.DataFrame(changes, table.index, VANES)
