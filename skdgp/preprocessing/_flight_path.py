"""FlightPathReconstruction: the most likely path of each flight, from all its sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from numbers import Integral, Real
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from skdgp._compute.messages import warn, without_warnings
from skdgp._compute.sklearn_compat import Interval, StrOptions
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    EARTH_VELOCITY,
    EULER,
    RATES,
    SPECIFIC_FORCE,
    WIND,
)
from skdgp._flight.checks import check_columns, check_radians, numeric
from skdgp._flight.clock import flight_codes
from skdgp._flight.faults import AIR_UNKNOWN, FlightDataWarning
from skdgp._flight.frames import air_data
from skdgp.dynamics import Aircraft
from skdgp.preprocessing._air_motion import AirMotion, estimate_air_motion
from skdgp.preprocessing._air_motion_equations import lagged
from skdgp.preprocessing._path import (
    CONSTANTS,
    GUSTS,
    INERTIAL,
    MEAN_WIND,
    MIN_AIRSPEED,
    NEEDED,
    NOISE,
    SENSORS,
    Estimate,
    FlightPath,
    Log,
    air_data_rates,
    estimate,
    first_guess,
    flight_logs,
    missing_channels,
)
from skdgp.preprocessing._smoother import FlightSmoother
from skdgp.preprocessing._table import (
    TableTransformer,
    has_values,
    interpolate_missing,
    with_columns,
    wrapped_near,
)

MADE = (*AIR_DATA, "alpha_dot", "beta_dot", *RATES, *SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY, *WIND)
_PATH = tuple(name for name in MADE if name not in ("alpha_dot", "beta_dot"))
# Weight of the gusts of the fit [seconds of flight]: 2 and 5 have the best median scores
OPINION = 2.0
KINEMATIC_LAGS = ("attitude_lag", "velocity_lag")
KINEMATIC_SECONDS = (
    120.0  # of each flight [s], from which lags of attitude and GPS are known to the millisecond
)
# a constant is observable if its standard deviation is less than this share of the prior one
OBSERVABLE = 0.5
MAX_RATIO = (
    1.05  # largest error of reconstruction, relative to that of smoothing, with which it is used
)
MAX_AIR_NOISE = (
    1.4  # residual of an air data sensor over its own noise, above which the latter counts as zero
)
MAX_INERTIAL_NOISE = (
    4.0  # residual of an inertial sensor over its own noise, above which the reason names it
)
DIFFERENCES = (
    3  # order of the differences that show noise; the sum of squares of their coefficients is 20
)
OVERLAP = 32  # of the rows of a part of a long flight, one in so many is added on either side
PROBE = 0.3  # size of the random change that shows the slope of a smoother, in units of noise
UNITS = {"airspeed": ("m/s", 1.0), "alpha": ("deg", 180 / np.pi), "beta": ("deg", 180 / np.pi)}
# What contradicts itself if the residual of a sensor is large, its unit and its factor
FOLLOWS = {
    "gyro": ("the attitude does not follow the gyros", "deg/s", 180 / np.pi),
    "accelerometer": ("the velocity does not follow the accelerometers", "m/s2", 1.0),
    **{name: (f"{name} does not follow the motion", *unit) for name, unit in UNITS.items()},
}

Flights = list[tuple[Any, Indices, Log, Estimate]]


class FlightPathReconstruction(TableTransformer):
    r"""Reconstruct the path of each flight through the air from all its sensors at once.

    The most likely path under the exact kinematics, with ground velocity v (NED), attitude R (body
    to NED), wind w, specific force f, angular rate omega and gravity g,

    .. math:: \dot v = R f + g, \quad \dot R = R [\omega]_\times, \quad v_a = R^T (v - w),
    .. math:: V = |v_a|, \quad \alpha = \arctan(w_a / u_a), \quad \beta = \arcsin(v_a / V),

    and gusts of correlation time ``gust_time`` (Mulder et al. 1999; Klein & Morelli 2006, chapter
    10; Jategaonkar 2006, chapter 10), as one sparse least-squares problem. Vanes are optional.
    ``fit`` learns the noise of each sensor, by maximum likelihood, and, on request, scale factors,
    biases and lags. ``transform`` uses these, and estimates biases of inertial sensors, wind and
    gusts separately for each flight. Raises ValueError if time, a rate, specific force, attitude,
    v_north, v_east, v_down or airspeed is missing, or has no value throughout a flight; if time
    does not increase within a flight; if angles are not radians.

    Parameters
    ----------
    calibrate : {"inertial", "all"} or list of str, default="inertial"
        Errors to estimate and remove. "inertial": ax_bias, ay_bias, az_bias, p_bias, q_bias,
        r_bias, in each flight. "all", or a list of names: also airspeed_scale, alpha_bias,
        alpha_scale, beta_bias, beta_scale, and, relative to the inertial sensors, airspeed_lag,
        vane_lag, velocity_lag, attitude_lag [s], learned in ``fit``. Measured is (1 + scale) truth
        + bias. Errors of air data need calm air, as the response to gusts resembles a scale.
    gust_time : float, default=10.0
        Correlation time of gusts [s]. A longer one allows more steady vertical wind in place of a
        vane's bias.
    incomplete : {"raise", "pass"}, default="raise"
        For flights without a needed channel: raise ValueError, or pass them on. If flights of
        ``fit`` lack one (``missing_``), all tables pass unchanged; if only flights of ``transform``
        do, `FlightSmoother` smooths them.
    inconsistent : {"use", "pass"}, default="use"
        For flights whose sensors contradict each other: reconstruct them all the same; or let
        ``fit`` decide. With "pass" all tables pass (``used_`` is False), unchanged but for the column
        ``gust``, if the expected errors of airspeed, alpha and beta are larger than those of
        `FlightSmoother` (``errors_``). A log without alpha or beta is always reconstructed.
    max_rows : int, default=65536
        Rows of a flight that are estimated at a time, of 15 kB each: a longer flight is estimated
        in parts of equal length that overlap, each with its own biases, wind and gusts.
    aircraft : Aircraft, optional
        For flights without alpha or beta. None: angles from attitude, velocity and steady wind, so
        without the gusts. Else by `estimate_air_motion`, whose derivatives, lag of the servos and
        noises ``fit`` keeps: ``transform`` estimates gusts, wind and biases of each flight, and the
        surfaces without their lag. Coefficients of such flights agree with these angles by
        construction: their errors on test flights say little.
    thrust : str or None, default="auto"
        For ``aircraft``, as in `skdgp.dynamics.aerodynamic_coefficients`.

    Attributes
    ----------
    used_, reason_ : bool, str
        Whether ``transform`` reconstructs flights, or passes them unchanged, and why.
    tells_gusts_ : bool
        Whether transformed tables have a column ``gust``: also flights that pass, if no sensor
        contradicts the others.
    errors_ : DataFrame or None
        Of ``inconsistent="pass"``, by sensor: ``noise`` (by the sensor itself), ``residual`` (noise
        learned with the path), and of air data the expected errors of ``reconstruction`` and
        ``smoothing``, and their ``deviation``.
    missing_ : list of str
        Missing channels of the flights of ``fit``, which then pass unchanged.
    converged_ : dict of str to bool
        Whether the search for the path converged, for each flight of ``fit``: where it did not, its
        sensors contradict one another.
    noise_std_ : dict of str to float
        Noise of each sensor: accelerometer, gyro, airspeed, alpha, beta, v_horizontal, v_down,
        tilt, heading.
    error_std_ : dict of str to float
        Expected error of reconstructed airspeed, alpha and beta.
    air_motion_ : AirMotion or None
        Of flights without vanes, where ``aircraft`` is given; its ``air`` is the mean. Then there is
        no ``calibration_``.
    doubt_ : str
        Why gusts of flights without vanes are not known, in words; empty if they are, or with vanes.
    gust_std_ : float
        Change of the air's velocity in one second [m/s], root mean square over the flights of
        ``fit``; the column ``gust`` of the transformed table holds that of each flight.
    sensors_ : dict of str to float
        Errors of the other sensors, from all flights of ``fit``; zero where not estimated.
    calibration_ : DataFrame
        The constants of each flight of ``fit``, or of each part of a long one, estimated from that
        flight alone: columns ``flight``, ``constant``, ``estimate``, ``std`` and ``observable``
        (std below half of its prior one).

    Warns
    -----
    FlightDataWarning
        In ``transform``, where flights are smoothed although those of ``fit`` were reconstructed.

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
        "gust_time": [Interval(Real, 0, None, closed="neither")],
        "incomplete": [StrOptions({"raise", "pass"})],
        "inconsistent": [StrOptions({"use", "pass"})],
        "max_rows": [Interval(Integral, 1, None, closed="left")],
        "aircraft": [Aircraft, None],
        "thrust": [str, None],
    }

    def __init__(
        self,
        *,
        calibrate: Any = "inertial",
        gust_time: float = 10.0,
        incomplete: str = "raise",
        inconsistent: str = "use",
        max_rows: int = 65536,
        aircraft: Aircraft | None = None,
        thrust: str | None = "auto",
    ) -> None:
        self.calibrate = calibrate
        self.gust_time = gust_time
        self.incomplete = incomplete
        self.inconsistent = inconsistent
        self.max_rows = max_rows
        self.aircraft = aircraft
        self.thrust = thrust

    @property
    def servo_lag_(self) -> float:
        """How late the surfaces follow their logged commands [s], zero where it is not estimated."""
        motion = self.air_motion_
        return 0.0 if motion is None else max(0.0, float(motion.constants["value"]["servo_lag"]))

    def _fit_table(self, table):
        errors = self._error_names()
        self.missing_ = missing_channels(table) if self.incomplete == "pass" else []
        self.used_, self.errors_, self.reason_ = (
            not self.missing_,
            None,
            "asked for, without a check",
        )
        self.tells_gusts_ = self.used_
        self.air_motion_: AirMotion | None = None
        self.doubt_ = ""
        self.converged_: dict[Any, bool] = {}
        if self.missing_:
            self.reason_ = f"the flights lack {', '.join(self.missing_)}"
            return
        self._check(table)
        if not has_values(table, *AIR_DATA):
            self._fit_air_motion(table)
        if self.air_motion_ is not None:
            return
        self.noise_std_ = dict(NOISE)
        estimates = self._estimates(table, free=errors, learn=NOISE | GUSTS, sensors={})
        for name, _, _, each in estimates:
            self.converged_[name] = self.converged_.get(name, True) and each.converged
        samples = [len(log.time) for _, _, log, _ in estimates]
        variances = {name: [each.noise[name] ** 2 for *_, each in estimates] for name in NOISE}
        self.noise_std_ = {
            name: float(np.sqrt(np.average(v, weights=samples))) for name, v in variances.items()
        }
        self.gust_std_ = float(
            np.sqrt(np.average([_gust(each) ** 2 for *_, each in estimates], weights=samples))
        )
        left = np.sqrt(
            np.average([each.air_std**2 for *_, each in estimates], axis=0, weights=samples)
        )
        self.error_std_ = dict(zip(AIR_DATA, left.tolist(), strict=True))
        self.sensors_ = dict.fromkeys(SENSORS, 0.0) | _pooled(estimates, errors)
        self.calibration_ = _calibration(estimates, errors)
        shown = (
            self.calibration_.groupby("constant", sort=False).observable.any().drop(list(MEAN_WIND))
        )
        if not isinstance(self.calibrate, str) and not shown.all():
            warn(
                f"The flights hardly show {', '.join(shown.index[~shown])}: their estimates stay "
                f"near the prior, zero "
                "(see calibration_). Fly turns and manoeuvres that excite them, or leave them out "
                "of calibrate.",
                stacklevel=3,
            )
        if self.inconsistent == "pass":
            self._decide(table, estimates)

    def _decide(self, table: pd.DataFrame, estimates: Flights) -> None:
        """Set whether the reconstruction is used, and why."""
        if not has_values(table, *AIR_DATA):
            self.reason_ = "the flights lack a vane of alpha or beta"
        else:
            self.errors_ = expected_errors(table, estimates, self.noise_std_)
            self.used_, self.tells_gusts_, self.reason_ = decision(self.errors_)

    def _fit_air_motion(self, table: pd.DataFrame) -> None:
        """Set the fitted attributes by the motion of the air, if it can be estimated."""
        if self.aircraft is None:
            self.doubt_ = "no sensor measures alpha and beta, and no aircraft is given"
            return
        motion, self.doubt_ = self._estimated_motion(table)
        if motion is None:
            return
        mean = motion.air.mean().to_frame().T  # a saved model holds no flights
        self.air_motion_ = replace(motion, air=mean)
        names = [name for name, _, _ in flight_logs(table)]
        self.converged_ = dict.fromkeys(names, motion.converged)
        self.reason_ = f"alpha and beta by the motion that gusts cause: {motion.summary}"
        changes = [motion.gust_change(k) for k in range(len(names))]
        self.gust_std_ = float(np.sqrt(np.nanmean(np.square(changes))))
        self.noise_std_ = NOISE | {name: motion.noise[name] for name in ("gyro", "airspeed")}
        self.error_std_ = {name: float(mean[f"{name}_std"].item()) for name in AIR_DATA}
        self.sensors_ = dict.fromkeys(SENSORS, 0.0)

    def _estimated_motion(
        self, table: pd.DataFrame, known: Any = None
    ) -> tuple[AirMotion | None, str]:
        """Return the motion of the air, None where it cannot be estimated, and why it is in doubt."""
        aircraft: Any = self.aircraft
        motion, doubt = None, ""
        try:
            motion = estimate_air_motion(table, aircraft, thrust=self.thrust, known=known)
        except ValueError as error:
            doubt = str(error)
        if motion is not None and not motion.converged:
            doubt = (
                "the estimate did not converge. Give longer flights with inputs of every surface, and "
                "look at the signs and units of their sensors."
            )
        if doubt:
            fallback = "alpha and beta lack them. " if motion is None else ""
            bands = "Bands of derivatives are those of small aircraft in general." * (known is None)
            warn(f"{AIR_UNKNOWN}: {doubt} {fallback}{bands}".strip(), stacklevel=5)
        return motion, doubt

    def _motion_of(self, table: pd.DataFrame, known: AirMotion) -> dict[str, Vector]:
        """Return the columns of flights by the motion of the air, with the aircraft as ``known``."""
        motion, _ = self._estimated_motion(table, known)
        if motion is None:
            return self._path_of(table)
        air = motion.air
        new: dict[str, Vector] = {}
        for k, (_, rows, log) in enumerate(flight_logs(table)):
            values = interpolate_missing(log.time, air.iloc[rows][list(_PATH)].to_numpy())
            part = dict(zip(_PATH, values.T, strict=True))
            dots = _angle_rates(log, np.column_stack([part[name] for name in AIR_DATA]), 0.0)
            part |= dict(zip(("alpha_dot", "beta_dot"), dots.T, strict=True))
            gust = np.nan_to_num(motion.gust_change(k), nan=self.gust_std_)
            part["gust"] = np.full(len(rows), gust)
            names = [name for name in ALL_SURFACES if has_values(table, name)]
            late = _late(log, numeric(table, names)[rows], self.servo_lag_)
            part |= dict(zip(names, late.T, strict=True))
            for name, column in part.items():
                new.setdefault(name, np.empty(len(table)))[rows] = column
        order = [*MADE, "gust", *ALL_SURFACES]
        return {name: new[name] for name in order if name in new}

    def _transform_table(self, table):
        missing = missing_channels(table) if self.incomplete == "pass" else []
        if not self.tells_gusts_ or (missing and not self.used_):
            return table
        if missing:
            warn(
                f"Got flights without {missing}, which those of the fit had: they are smoothed "
                f"channel by channel "
                "(FlightSmoother), not reconstructed. Expect larger errors than with those "
                "sensors.",
                FlightDataWarning,
                stacklevel=3,
            )
            return FlightSmoother().fit_transform(table)
        self._check(table)
        known = self.air_motion_
        new = self._path_of(table) if known is None else self._motion_of(table, known)
        if not self.used_:
            return with_columns(table, {"gust": new["gust"]})
        for name in EULER:
            new[name] = wrapped_near(new[name], table[name])
        return with_columns(table, new)

    def _path_of(self, table: pd.DataFrame) -> dict[str, Vector]:
        """Return the columns of flights by their most likely paths."""
        inertial = [name for name in self._error_names() if name in INERTIAL]
        new = {name: np.empty(len(table)) for name in (*MADE, "gust")}
        for _, rows, log, solved in self._estimates(
            table, free=inertial, learn=GUSTS, sensors=self.sensors_
        ):
            for name, values in _channels(solved.path, log).items():
                new[name][rows] = values
            new["gust"][rows] = self._gust_of(solved, np.ptp(log.time))
        return new

    def _gust_of(self, solved: Estimate, seconds: float) -> float:
        """Return the gusts of a flight of some seconds; the variance of those of the fit counts as `OPINION` does."""
        if not solved.converged:
            return self.gust_std_
        squares = [_gust(solved) ** 2, self.gust_std_**2]
        return float(np.sqrt(np.average(squares, weights=[seconds, OPINION])))

    def _columns_out(self, names):
        made = [*(MADE if self.used_ else ()), *(["gust"] if self.tells_gusts_ else ())]
        return names + [name for name in made if name not in names]

    def _error_names(self) -> list[str]:
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
        check_radians(
            table, ("theta", *RATES, "alpha", "beta")
        )  # roll and heading may have been unwrapped

    def _estimates(
        self,
        table: pd.DataFrame,
        *,
        free: list[str],
        learn: Mapping[str, float],
        sensors: Mapping[str, float],
    ) -> Flights:
        """Return (name, rows, log, estimate) of every flight, of each part of a long one."""
        estimates = []
        constants = np.array([sensors.get(name, 0.0) for name in CONSTANTS])
        noise = self.noise_std_ | GUSTS
        names = [*free, *MEAN_WIND]
        contradictory: dict[Any, None] = {}
        for name, rows, whole in flight_logs(table):
            for part, inner in _parts(len(rows), self.max_rows):
                log = whole.part(part.start, part.stop)
                start = first_guess(log, constants)
                each = estimate(
                    log, start, noise, learn=learn, free=names, gust_time=self.gust_time
                )
                path = each.path.part(inner.start, inner.stop)
                kept = rows[part][inner], log.part(inner.start, inner.stop)
                estimates.append((name, *kept, each._replace(path=path)))
                contradictory |= {} if each.converged else {name: None}
        for name in contradictory:
            warn(
                f"The reconstruction of flight {name!r} did not converge: its sensors "
                f"contradict one another. Look for wrong signs, units or clocks.",
                stacklevel=4,
            )
        return estimates


def _parts(n: int, most: int) -> list[tuple[slice, slice]]:
    """Return parts of n rows, of at most so many and the overlap, and of each the rows between the overlaps."""
    margin = most // OVERLAP
    edges = np.linspace(0, n, -(-n // most) + 1).round().astype(int).tolist()
    parts = []
    for first, last in pairwise(edges):
        start = max(first - margin, 0)
        parts.append((slice(start, min(last + margin, n)), slice(first - start, last - start)))
    return parts


def kinematic_lags(table: pd.DataFrame) -> dict[str, tuple[float, float]]:
    """Return the lags [s] of attitude and GPS velocity against gyros and accelerometers, with standard deviations.

    Vanes are left out, as gusts would resemble a lag.
    """
    codes = flight_codes(table["flight"])[0] if "flight" in table else np.zeros(len(table))
    since = table["time"] - table.groupby(codes)["time"].transform("min")
    inertial = table[since < KINEMATIC_SECONDS].drop(columns=["alpha", "beta"], errors="ignore")
    with without_warnings():  # of unobservable constants; their std shows it
        path = FlightPathReconstruction(calibrate=["p_bias", "q_bias", "r_bias", *KINEMATIC_LAGS])
        path.fit(inertial)
    precision = (path.calibration_.set_index("constant")["std"] ** -2).groupby(level=0).sum()
    return {name: (path.sensors_[name], float(precision[name] ** -0.5)) for name in KINEMATIC_LAGS}


def _channels(path: FlightPath, log: Log) -> dict[str, Vector]:
    """Return the reconstructed columns of a flight."""
    air = np.column_stack(air_data(path.air_velocity()))
    rotation = path.attitude.as_euler("ZYX")[:, ::-1]
    steady = air_data_rates(path, log)[:, 1:]  # of single samples
    parts = [
        air,
        _angle_rates(log, air, steady),
        path.rate(log),
        path.force(log),
        rotation,
        path.velocity,
        path.wind(),
    ]
    return dict(zip(MADE, np.column_stack(parts).T, strict=True))


def _angle_rates(log: Log, air: Matrix, single: Any) -> Matrix:
    """Return the rates of change of alpha and beta (n, 2) by air data (n, 3); ``single`` of single samples."""
    dots = np.array(np.broadcast_to(single, (len(air), 2)))
    for rows in log.segments():
        if len(rows) > 1:
            dots[rows] = CubicSpline(log.time[rows], air[rows, 1:])(log.time[rows], 1)
    return dots


def _late(log: Log, surfaces: Matrix, lag: float) -> Matrix:
    """Return the outputs of servos with a first-order lag [s], by gap-free segments."""
    out, surfaces = np.empty_like(surfaces), interpolate_missing(log.time, surfaces)
    for rows in log.segments():
        step = float(np.median(np.diff(log.time[rows]))) if len(rows) > 1 else 1.0
        out[rows] = lagged(surfaces[rows], lag, step)
    return out


def _gust(solved: Estimate) -> float:
    """Return the change of the air's velocity in one second [m/s], root mean square of the two directions."""
    return float(np.sqrt(np.mean([solved.noise[name] ** 2 for name in GUSTS])))


def _pooled(estimates: Flights, errors: list[str]) -> dict[str, float]:
    """Return the errors of sensors over all flights: estimates weighted by precision, with the prior counted once."""
    names = [name for name in errors if name in SENSORS]
    places = [errors.index(name) for name in names]
    prior = np.diag([CONSTANTS[name] ** -2 for name in names])
    precision, weighted = prior.copy(), np.zeros(len(names))
    for *_, each in estimates:
        of_flight = np.linalg.inv(each.covariance[np.ix_(places, places)])
        weighted += of_flight @ each.path.constant(*names)
        precision += of_flight - prior
    return dict(zip(names, np.linalg.solve(precision, weighted).tolist(), strict=True))


def _calibration(estimates: Flights, errors: list[str]) -> pd.DataFrame:
    """Return a row per flight and constant."""
    names = [*errors, *MEAN_WIND]
    prior, parts = np.array([CONSTANTS[name] for name in names]), []
    for flight, _, _, each in estimates:
        std = np.sqrt(np.diag(each.covariance))
        part = {
            "flight": flight,
            "constant": names,
            "estimate": each.path.constant(*names),
            "std": std,
            "observable": std < OBSERVABLE * prior,
        }
        parts.append(pd.DataFrame(part))
    return pd.concat(parts, ignore_index=True)


def expected_errors(
    table: pd.DataFrame, estimates: Flights, noise: Mapping[str, float]
) -> pd.DataFrame:
    r"""Return noise, residual and expected errors of the sensors of a table, by the paths estimated from it.

    An estimate x of a channel from samples y of white noise :math:`\sigma` has the mean squared
    error

    .. math:: \overline{(y - x)^2} - \sigma^2 + 2 \sigma^2\, \overline{\partial x / \partial y}

    without knowledge of the truth (Stein 1981). The mean slope of the path is its variance over
    that of the noise; the slope of the smoother follows from a small random change of the samples
    (Ramani, Blu & Unser 2008). A constant error of a sensor, or a lag, is not seen. Third
    differences contain a little motion, so :math:`\sigma` is zero where the residual exceeds 1.4
    times the noise. Of n samples the first term has the standard error :math:`\sigma^2 \sqrt{2 /
    n}`: a mean squared error below it cannot be told from zero. Columns are those of
    ``FlightPathReconstruction.errors_``.
    """
    raw = numeric(table, AIR_DATA)
    path, slope = _path_air(raw.shape, estimates)
    known = np.isfinite(raw) & np.isfinite(path)
    squares = {kind: _noise_squares(kind, estimates) for kind in ("air", "rate", "force")}
    stds = np.sqrt(squares["air"])
    learned = np.array([noise[name] for name in AIR_DATA])
    variance = np.where(learned > MAX_AIR_NOISE * stds, 0.0, stds**2)
    smoothed, smoother_slope = _smoothed(table, raw, stds)
    rows = {}
    for row, name in enumerate(AIR_DATA):
        here = known[:, row]
        measured = raw[here, row]
        errors = [
            np.mean((measured - estimate[here, row]) ** 2) + variance[row] * (2 * gain[row] - 1)
            for estimate, gain in ((path, slope), (smoothed, smoother_slope))
        ]
        least = variance[row] * np.sqrt(2 / max(len(measured), 1))
        rows[name] = (stds[row], noise[name], *np.sqrt(np.maximum(errors, least)), measured.std())
    for name, kind in (("gyro", "rate"), ("accelerometer", "force")):
        rows[name] = (float(np.sqrt(np.mean(squares[kind]))), noise[name], np.nan, np.nan, np.nan)
    columns = ["noise", "residual", "reconstruction", "smoothing", "deviation"]
    return pd.DataFrame.from_dict(rows, orient="index", columns=columns).rename_axis("sensor")


def decision(errors: pd.DataFrame) -> tuple[bool, bool, str]:
    """Return whether the reconstruction is used, whether no sensor contradicts the others, and why, in words.

    It is if the mean square of expected error / deviation of airspeed, alpha, beta is at most
    1.05^2 that of smoothing.
    """
    air = errors.loc[list(AIR_DATA)]
    weights = np.divide(
        1.0, air.deviation**2, out=np.zeros(len(air)), where=air.deviation.to_numpy() > 0
    )
    path, smoothing = (
        float(np.sqrt(weights @ air[name] ** 2)) for name in ("reconstruction", "smoothing")
    )
    used = path <= MAX_RATIO * smoothing
    words = [
        f"expected errors {_listed(air.reconstruction)}; of smoothing {_listed(air.smoothing)}"
    ]
    for name, (what, unit, factor) in FOLLOWS.items() if not used else ():
        residual, noise = factor * errors.residual[name], factor * errors.noise[name]
        if residual > (MAX_AIR_NOISE if name in AIR_DATA else MAX_INERTIAL_NOISE) * noise:
            words.append(f"{what} (residual {residual:.2g} {unit}, noise {noise:.2g})")
    return used, used or len(words) == 1, "; ".join(words)


def _listed(errors: pd.Series) -> str:
    return ", ".join(
        f"{name} {round(factor * errors[name], 6):.2g} {unit}"
        for name, (unit, factor) in UNITS.items()
    )


def _path_air(shape: tuple[int, ...], estimates: Flights) -> tuple[Matrix, Vector]:
    """Return what airspeed and vanes should measure on the paths (n, 3), and the mean slope by their own samples."""
    values, slope = np.full(shape, np.nan), np.zeros(3)
    for _, rows, _, each in estimates:
        air = np.column_stack(air_data(each.path.air_velocity()))
        air[air[:, 0] < MIN_AIRSPEED] = np.nan
        scale = 1 + each.path.constant("airspeed_scale", "alpha_scale", "beta_scale")
        values[rows] = scale * air + [0.0, *each.path.constant("alpha_bias", "beta_bias")]
        learned = np.array([each.noise[name] for name in AIR_DATA])
        slope += len(rows) / shape[0] * (scale * each.air_std / learned) ** 2
    return values, slope


def _noise_squares(kind: str, estimates: Flights) -> Vector:
    """Return the variance of white noise in the columns of each flight's log, from their third differences."""
    total, count = np.zeros(3), np.zeros(3)
    for _, _, log, _ in estimates:
        for place, column in enumerate(getattr(log, kind).T):
            rows = np.flatnonzero(np.isfinite(column))
            if len(rows) > DIFFERENCES:
                joined = log.segment[rows[DIFFERENCES:]] == log.segment[rows[:-DIFFERENCES]]
                squares = np.diff(column[rows], DIFFERENCES)[joined] ** 2 / 20
                total[place], count[place] = (
                    total[place] + squares.sum(),
                    count[place] + len(squares),
                )
    return total / np.maximum(count, 1)


def _smoothed(table: pd.DataFrame, raw: Matrix, noise: Vector) -> tuple[Matrix, Vector]:
    """Return smoothed air data (n, 3), and their mean slope by their own samples."""
    probe = np.random.default_rng(0).standard_normal(raw.shape)
    moved = table.assign(**dict(zip(AIR_DATA, (raw + PROBE * noise * probe).T, strict=True)))
    with without_warnings():  # of flights too short to smooth: the pipeline's smoother says it
        smoother = FlightSmoother(columns=list(AIR_DATA), derivatives=[])
        before, after = (numeric(smoother.fit_transform(one), AIR_DATA) for one in (table, moved))
    response = np.nanmean((after - before) * probe, axis=0)
    return before, np.divide(response, PROBE * noise, out=np.ones(3), where=noise > 0)
