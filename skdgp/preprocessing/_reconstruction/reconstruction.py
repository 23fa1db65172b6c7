"""FlightPathReconstruction, the transformer."""

from __future__ import annotations

import warnings
from numbers import Real

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline
from sklearn.utils._param_validation import Interval, StrOptions
from sklearn.utils.validation import check_is_fitted

from skdgp._flight.checks import check_columns, check_radians
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.frames import air_data
from skdgp.preprocessing._reconstruction.flight_log import (
    AIR,
    ATTITUDE,
    FORCE,
    NEEDED,
    RATE,
    VELOCITY,
    first_guess,
    flight_logs,
    missing_in,
)
from skdgp.preprocessing._reconstruction.flight_path import GUSTS, NOISE, estimate
from skdgp.preprocessing._reconstruction.kinematics import CONSTANTS, INERTIAL, SENSORS, WIND, air_data_rates
from skdgp.preprocessing._smoother import FlightSmoother
from skdgp.preprocessing._table import TableTransformer, with_columns

WINDS = ("wind_north", "wind_east", "wind_down")
MADE = (*AIR, "alpha_dot", "beta_dot", *RATE, *FORCE, *ATTITUDE, *VELOCITY, *WINDS)
OBSERVABLE = 0.5
"""A constant is observable if the flight leaves less than this of its prior standard deviation."""


class FlightPathReconstruction(TableTransformer):
    r"""Reconstruct the path of each flight through the air from all its sensors at once.

    The most likely path under the exact kinematics, with ground velocity v (NED), attitude R (body to NED), wind w,
    specific force f, angular rate omega and gravity g,

    .. math:: \dot v = R f + g, \quad \dot R = R [\omega]_\times, \quad v_a = R^T (v - w),
    .. math:: V = |v_a|, \quad \alpha = \arctan(w_a / u_a), \quad \beta = \arcsin(v_a / V),

    and gusts that wander with correlation time ``gust_time``. Accelerometers and gyros carry the path from sample to
    sample, GPS velocity and attitude hold it, airspeed and vanes tell it from the air. How noisy each sensor is, and
    how gusty each flight, is learned from the data by likelihood: in calm air alpha and beta are those of the inertial
    sensors, in gusts vanes are believed as far as the air is seen to move. Without vanes alpha and beta follow from
    the rest. This is the flight-path reconstruction (data compatibility check) of flight test (Mulder et al. 1999;
    Klein & Morelli 2006, chapter 10; Jategaonkar 2006, chapter 10), as one sparse least-squares problem.

    ``fit`` learns the sensors: their noise, and their scale factors, misalignments and lags if asked to. ``transform``
    takes these as given; it finds the biases of inertial sensors, the wind and the strength of gusts of each flight
    from that flight alone.

    Parameters
    ----------
    calibrate : {"inertial", "all"} or list of str, default="inertial"
        Errors to estimate and remove. "inertial": biases of accelerometers and gyros, ax_bias ... r_bias, flight by
        flight. A list may name these and errors of the other sensors, learned in ``fit``: airspeed_scale, alpha_bias,
        alpha_scale, beta_bias, beta_scale, airspeed_lag, vane_lag, velocity_lag, attitude_lag [s], the lags relative
        to the inertial sensors. Measured is (1 + scale) truth + bias. "all": all of them. Scales and biases of air data
        need calm air: an aircraft yields to gusts, which looks like a scale.
    rates : {"air", "steady"}, default="air"
        What alpha_dot and beta_dot are: "air", the slopes of the reconstructed alpha and beta, gusts and all; "steady",
        from the kinematics in air that keeps its velocity. The latter are several times more exact where that is what
        is asked for, and hold the measured accelerations (alpha_dot - q is about az / V, plus gravity): a model of the
        forces then leans on them where alpha is uncertain.
    gust_time : float, default=10.0
        Correlation time of gusts [s]. The longer, the more a steady vertical wind is possible instead of a vane's bias.
    gravity : float, default=9.80665
        [m/s^2]. An error appears as bias of the accelerometers.
    incomplete : {"raise", "pass"}, default="raise"
        What to do with flights that lack a channel that no path can be had without: raise, or let them pass. Where
        those of ``fit`` do (``missing_``), every further table passes as it is, for the next step to smooth; where only
        those of ``transform`` do, `FlightSmoother` makes of them what it can.

    Attributes
    ----------
    missing_ : list of str
        Channels without which flights pass as they are; empty where they are reconstructed.
    noise_std_ : dict of str to float
        Standard deviation of each sensor's noise: accelerometer, gyro, airspeed, alpha, beta, v_horizontal, v_down,
        tilt (roll and pitch), heading.
    error_std_ : dict of str to float
        Expected error of reconstructed airspeed, alpha and beta: root mean square of their standard deviations.
    gust_std_ : float
        How much the air changes in one second [m/s], root mean square over the flights of ``fit``; of each flight it is
        in the column ``gust`` that ``transform`` makes.
    sensors_ : dict of str to float
        Errors of the other sensors, learned over all flights of ``fit``; zero where not estimated.
    calibration_ : DataFrame
        :meth:`calibration` of the flights of ``fit``.
    n_features_in_, feature_names_in_
        Columns seen in ``fit``.

    Raises
    ------
    ValueError
        If one of time, p, q, r, ax, ay, az, phi, theta, psi, v_north, v_east, v_down, airspeed is missing, or has no
        value throughout a flight; if time does not increase within a flight; if angles are not radians.

    Warns
    -----
    FlightDataWarning
        In ``transform``, where flights pass though those of ``fit`` were reconstructed.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(0, 60, 0.05)
    >>> level = dict(p=0.0, q=0.0, r=0.0, ax=0.0, ay=0.0, az=-9.80665, phi=0.0, theta=0.0, psi=0.0)
    >>> flight = pd.DataFrame({"time": t, **level, "v_north": 30.0, "v_east": 0.0, "v_down": 0.0, "airspeed": 30.0,
    ...                        "alpha": rng.normal(0, 0.005, t.size), "beta": rng.normal(0, 0.005, t.size)})
    >>> reconstruction = FlightPathReconstruction().fit(flight)
    >>> bool(reconstruction.transform(flight).alpha.std() < 0.1 * flight.alpha.std())
    True
    >>> round(reconstruction.noise_std_["alpha"], 3)
    0.005
    """

    _parameter_constraints: dict = {
        "calibrate": [StrOptions({"inertial", "all"}), list, tuple],
        "rates": [StrOptions({"air", "steady"})],
        "gust_time": [Interval(Real, 0, None, closed="neither")],
        "gravity": [Interval(Real, 0, None, closed="neither")],
        "incomplete": [StrOptions({"raise", "pass"})],
    }

    def __init__(self, *, calibrate="inertial", rates="air", gust_time=10.0, gravity=9.80665, incomplete="raise"):
        self.calibrate = calibrate
        self.rates = rates
        self.gust_time = gust_time
        self.gravity = gravity
        self.incomplete = incomplete

    def calibration(self, X) -> pd.DataFrame:
        """Return the constants of each flight, estimated from that flight alone, and which of them it shows.

        Parameters
        ----------
        X : DataFrame of shape (n, n_columns)
            Flight table.

        Returns
        -------
        DataFrame
            A row per flight and constant: ``estimate``, ``std`` (standard deviation), ``prior_std`` (before the
            flight), ``observable`` (std below half of prior_std), ``confounded_with`` (the constant whose error is most
            correlated) and ``correlation`` with it.
        """
        check_is_fitted(self)
        table = self._as_table(X)
        if self.missing_:
            raise ValueError(f"The flights of fit lack {self.missing_}, so nothing was learned of their sensors.")
        self._check(table)
        return _calibration(self._estimates(table, free=self._errors(), learn=GUSTS, sensors={}), self._errors())

    def _fit_table(self, table):
        errors = self._errors()
        self.missing_ = missing_in(table) if self.incomplete == "pass" else []
        if self.missing_:
            return
        self._check(table)
        self.noise_std_ = dict(NOISE)
        found = self._estimates(table, free=errors, learn=NOISE | GUSTS, sensors={})
        samples = [len(log.time) for _, _, log, _ in found]
        variances = {name: [each.noise[name] ** 2 for *_, each in found] for name in NOISE}
        self.noise_std_ = {name: float(np.sqrt(np.average(v, weights=samples))) for name, v in variances.items()}
        self.gust_std_ = float(np.sqrt(np.average([_gust(each) ** 2 for *_, each in found], weights=samples)))
        left = np.sqrt(np.average([each.air_std**2 for *_, each in found], axis=0, weights=samples))
        self.error_std_ = dict(zip(AIR, left.tolist(), strict=True))
        self.sensors_ = dict.fromkeys(SENSORS, 0.0) | _pooled(found, errors)
        self.calibration_ = _calibration(found, errors)
        if not isinstance(self.calibrate, str):
            self._warn_of_hidden()

    def _transform_table(self, table):
        if self.missing_:
            return table
        missing = missing_in(table) if self.incomplete == "pass" else []
        if missing:
            warnings.warn(
                f"Got flights without {missing}, which those of the fit had: their paths are not reconstructed, each "
                "channel is smoothed by itself (FlightSmoother). Expect larger errors than with those sensors.",
                FlightDataWarning,
                stacklevel=3,
            )
            return FlightSmoother().fit_transform(table)
        self._check(table)
        inertial = [name for name in self._errors() if name in INERTIAL]
        new = {name: np.empty(len(table)) for name in (*MADE, "gust")}
        for _, rows, log, found in self._estimates(table, free=inertial, learn=GUSTS, sensors=self.sensors_):
            for name, values in _channels(found.path, log, self.rates).items():
                new[name][rows] = values
            new["gust"][rows] = _gust(found)
        for name in ATTITUDE:
            new[name] = _near(new[name], table[name].to_numpy(float, na_value=np.nan))
        return with_columns(table, new)

    def _columns_out(self, names):
        return names + [name for name in (*MADE, "gust") if name not in names and not self.missing_]

    def _errors(self):
        """Return the names of the sensors' errors to estimate."""
        known = INERTIAL | SENSORS
        if isinstance(self.calibrate, str):
            return list(INERTIAL if self.calibrate == "inertial" else known)
        strange = [name for name in self.calibrate if name not in known]
        if strange:
            raise ValueError(f"Got {strange} in calibrate, but expected some of {list(known)}.")
        return list(dict.fromkeys(self.calibrate))

    def _check(self, table):
        check_columns(table, ["time", *NEEDED])
        check_radians(table, ("theta", *RATE, "alpha", "beta"))  # roll and heading may have been unwrapped

    def _estimates(self, table, *, free, learn, sensors):
        """Return (name, rows, log, estimate) of every flight."""
        found = []
        constants = np.array([sensors.get(name, 0.0) for name in CONSTANTS])
        for name, rows, log in flight_logs(table, self.gravity):
            each = estimate(
                log,
                first_guess(log, constants),
                self.noise_std_ | GUSTS,
                learn=learn,
                free=[*free, *WIND],
                gust_time=self.gust_time,
            )
            if not each.converged:
                warnings.warn(
                    f"The reconstruction of flight {name!r} did not settle: its sensors contradict one another. Look "
                    "at calibration(flight), and for wrong signs, units or clocks.",
                    UserWarning,
                    stacklevel=4,
                )
            found.append((name, rows, log, each))
        return found

    def _warn_of_hidden(self):
        shown = self.calibration_.groupby("constant", sort=False).observable.any().drop(list(WIND))
        if not shown.all():
            warnings.warn(
                f"The flights hardly show {', '.join(shown.index[~shown])}: estimates stay near zero, the more so "
                "the less is seen (see calibration_). Fly turns and manoeuvres that excite them, or leave them out of "
                "calibrate.",
                UserWarning,
                stacklevel=4,
            )


def _channels(path, log, rates):
    """Return the reconstructed columns of a flight."""
    air = np.column_stack(air_data(path.air_velocity()))
    rotation = path.attitude.as_euler("ZYX")[:, ::-1]
    dots = air_data_rates(path, log) if rates == "steady" else _slopes(air, path, log)
    parts = [air, dots[:, 1:], path.rate(log), path.force(log), rotation, path.velocity, path.wind()]
    return dict(zip(MADE, np.column_stack(parts).T, strict=True))


def _slopes(air, path, log):
    """Return the slopes of the splines through air data (n, 3), stretch by stretch; of single samples in steady air."""
    slopes = air_data_rates(path, log)
    for stretch in np.unique(log.stretch):
        rows = log.stretch == stretch
        if rows.sum() > 1:
            slopes[rows] = CubicSpline(log.time[rows], air[rows])(log.time[rows], 1)
    return slopes


def _near(angle, logged):
    """Return the same angle within pi of the one that was logged."""
    return angle - 2 * np.pi * np.round((angle - np.where(np.isfinite(logged), logged, angle)) / (2 * np.pi))


def _gust(found) -> float:
    """Return how much the air changes in one second, along one axis [m/s]: root mean square of the two directions."""
    return float(np.sqrt(np.mean([found.noise[name] ** 2 for name in GUSTS])))


def _pooled(found, errors):
    """Return the errors of sensors that all flights share: the flights' estimates by precision, the prior once."""
    names = [name for name in errors if name in SENSORS]
    places = [errors.index(name) for name in names]
    prior = np.diag([CONSTANTS[name] ** -2 for name in names])
    precision, weighted = prior.copy(), np.zeros(len(names))
    for *_, each in found:
        own = np.linalg.inv(each.covariance[np.ix_(places, places)])
        weighted += own @ each.path.of(*names)
        precision += own - prior
    return dict(zip(names, np.linalg.solve(precision, weighted).tolist(), strict=True))


def _calibration(found, errors):
    """Return a row per flight and constant."""
    names = [*errors, *WIND]
    parts = []
    for flight, _, _, each in found:
        std = np.sqrt(np.diag(each.covariance))
        correlation = each.covariance / np.outer(std, std) - np.eye(len(names))
        partner = np.abs(correlation).argmax(axis=1)
        prior = np.array([CONSTANTS[name] for name in names])
        part = {"flight": flight, "constant": names, "estimate": each.path.of(*names), "std": std, "prior_std": prior}
        part |= {"observable": std < OBSERVABLE * prior, "confounded_with": np.array(names)[partner]}
        parts.append(pd.DataFrame(part | {"correlation": correlation[np.arange(len(names)), partner]}))
    return pd.concat(parts, ignore_index=True)
