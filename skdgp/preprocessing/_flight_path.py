"""FlightPathReconstruction: the most likely path of each flight, from all its sensors."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from numbers import Integral
from typing import Any

import numpy as np
import pandas as pd
from scipy.interpolate import CubicSpline

from skdgp._compute.findings import Code, Finding
from skdgp._compute.messages import report
from skdgp._compute.sklearn_compat import Interval
from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    EARTH_VELOCITY,
    EULER,
    RATES,
    SPECIFIC_FORCE,
    VANES,
    WIND,
)
from skdgp._flight.checks import check_columns, check_radians, numeric
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.frames import air_data
from skdgp.dynamics import Aircraft
from skdgp.preprocessing._air_motion import AirMotion, estimate_air_motion
from skdgp.preprocessing._air_motion_equations import lagged
from skdgp.preprocessing._cleaning import FlightSmoother
from skdgp.preprocessing._path import (
    GUSTS,
    INERTIAL,
    MEAN_WIND,
    NEEDED,
    NOISE,
    Estimate,
    FlightPath,
    Log,
    estimate,
    flight_logs,
    missing_channels,
)
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
MAX_AIR_NOISE = 1.4  # residual over the noise of a sensor of air data, above which it contradicts
MAX_INERTIAL_NOISE = (
    6.0  # as above, of an inertial sensor; half a minute of sound ones shows up to 4.4
)
DIFFERENCES = (
    3  # order of the differences that show noise: the squares of their coefficients add up to 20
)
OVERLAP = 32  # of the rows of a part of a long flight, one in so many is added on either side
# By sensor: columns of a log, what contradicts if its residual is large, its unit and factor
FOLLOWS = {
    "gyro": ("rate", slice(3), "the attitude does not follow the gyros", "deg/s", 180 / np.pi),
    "accelerometer": ("force", slice(3), "the velocity does not follow the accelerometers", "m/s2", 1.0),
    "airspeed": ("air", 0, "airspeed does not follow the motion", "m/s", 1.0),
    "alpha": ("air", 1, "alpha does not follow the motion", "deg", 180 / np.pi),
    "beta": ("air", 2, "beta does not follow the motion", "deg", 180 / np.pi),
}  # fmt: skip

FREE = (*INERTIAL, *MEAN_WIND)  # constants that are estimated
Flights = list[tuple[Any, Indices, Log, Estimate]]


class FlightPathReconstruction(TableTransformer):
    r"""Reconstruct the path of each flight through the air from all its sensors at once.

    The most likely path under the exact kinematics, with ground velocity v (NED), attitude R (body
    to NED), wind w, specific force f, angular rate omega and gravity g,

    .. math:: \dot v = R f + g, \quad \dot R = R [\omega]_\times, \quad v_a = R^T (v - w),
    .. math:: V = |v_a|, \quad \alpha = \arctan(w_a / u_a), \quad \beta = \arcsin(v_a / V),

    and gusts of a correlation time of 10 s (Mulder et al. 1999; Klein & Morelli 2006, chapter 10;
    Jategaonkar 2006, chapter 10), as one sparse least-squares problem. Vanes are optional. ``fit``
    learns the noise of each sensor, by maximum likelihood. ``transform`` uses it, and estimates
    biases of inertial sensors, wind and gusts separately for each flight. Raises ValueError if
    time, a rate, specific force, attitude, v_north, v_east, v_down or airspeed is missing, or has
    no value throughout a flight; if time does not increase within a flight; if angles are not
    radians. Rates of change of single samples are NaN.

    Parameters
    ----------
    optional : bool, default=False
        Whether all tables pass unchanged, if the flights of ``fit`` lack a needed channel
        (``missing_``), or an inertial sensor, or two of air data, contradict the others: residuals
        are larger than their noise, 6 times of an inertial sensor, 1.4 times of airspeed, alpha and
        beta. A log without alpha or beta is reconstructed all the same. If only flights of
        ``transform`` lack a channel, `FlightSmoother` smooths them. A table without any of the
        channels is refused.
    max_rows : int, default=65536
        Rows of a flight that are estimated at a time, of 20 kB each: a longer flight is estimated
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
    missing_ : list of str
        Missing channels of the flights of ``fit``, which then pass unchanged.
    converged_ : dict of str to bool
        Whether the search for the path converged, for each flight of ``fit``: where it did not, its
        sensors contradict one another.
    noise_std_ : dict of str to float
        Noise of each sensor: accelerometer, gyro, airspeed, alpha, beta, v_horizontal, v_down,
        tilt, heading.
    air_motion_ : AirMotion or None
        Of flights without vanes, where ``aircraft`` is given; its ``air`` is the mean. Then there is
        no ``calibration_``.
    doubt_ : str
        Why gusts of flights without vanes are not known, in words; empty if they are, or with vanes.
    gust_std_ : float
        Change of the air's velocity in one second [m/s], root mean square over the flights of
        ``fit``; the column ``gust`` of the transformed table holds that of each flight.
    calibration_ : DataFrame
        Biases of inertial sensors and mean wind of each flight of ``fit``, or of each part of a
        long one: columns ``flight``, ``constant``, ``estimate`` and ``std``.

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
        "optional": ["boolean"],
        "max_rows": [Interval(Integral, 1, None, closed="left")],
        "aircraft": [Aircraft, None],
        "thrust": [str, None],
    }

    def __init__(
        self,
        *,
        optional: bool = False,
        max_rows: int = 65536,
        aircraft: Aircraft | None = None,
        thrust: str | None = "auto",
    ) -> None:
        self.optional = optional
        self.max_rows = max_rows
        self.aircraft = aircraft
        self.thrust = thrust

    @property
    def servo_lag_(self) -> float:
        """How late the surfaces follow their logged commands [s], zero where it is not estimated."""
        motion = self.air_motion_
        return 0.0 if motion is None else max(0.0, float(motion.constants["value"]["servo_lag"]))

    def _fit_table(self, table):
        self._check_any(table, (*NEEDED, *VANES))
        self.missing_ = missing_channels(table) if self.optional else []
        self.used_ = not self.missing_
        self.reason_ = "no sensor contradicts the others"
        self.air_motion_: AirMotion | None = None
        self.doubt_ = ""
        self.converged_: dict[Any, bool] = {}
        if self.missing_:
            self.reason_ = f"the flights lack {', '.join(self.missing_)}"
            return
        self._check(table)
        has_vanes = has_values(table, *AIR_DATA)
        if not has_vanes:
            self._fit_air_motion(table)
        if self.air_motion_ is not None:
            return
        self.noise_std_ = dict(NOISE)
        estimates = self._estimates(table, learn=NOISE | GUSTS)
        self.converged_ = {
            name: all(each.converged for flight, *_, each in estimates if flight == name)
            for name, *_ in estimates
        }
        samples = [len(log.time) for _, _, log, _ in estimates]
        self.noise_std_ = {
            name: float(
                np.sqrt(
                    np.average([each.noise[name] ** 2 for *_, each in estimates], weights=samples)
                )
            )
            for name in NOISE
        }
        self.gust_std_ = float(
            np.sqrt(np.average([_gust(each) ** 2 for *_, each in estimates], weights=samples))
        )
        self.calibration_ = pd.DataFrame(
            {"flight": flight, "constant": name, "estimate": value, "std": std}
            for flight, _, _, each in estimates
            for name, value, std in zip(
                FREE, each.path.constant(*FREE), np.sqrt(np.diag(each.covariance)), strict=True
            )
        )
        if contradictions := _contradictions(estimates, self.noise_std_):
            of_air = contradictions.keys() & {*AIR_DATA}
            alone = len(contradictions) == len(of_air) == 1  # probably filtered by the autopilot
            self.used_ = alone or not (self.optional and has_vanes)
            self.reason_ = "although " * self.used_ + "; ".join(contradictions.values())

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
            numbers = {
                "reason": doubt,
                "angles_lack_gusts": motion is None,
                "general_bands": known is None,
            }
            report(Finding(Code.GUSTS_UNKNOWN, numbers=numbers), stacklevel=5)
        return motion, doubt

    def _motion_of(self, table: pd.DataFrame, known: AirMotion) -> dict[str, Vector]:
        """Return the columns of flights by the motion of the air, with the aircraft as ``known``."""
        motion, _ = self._estimated_motion(table, known)
        if motion is None:
            return self._path_of(table)
        air = motion.air
        names = [name for name in ALL_SURFACES if has_values(table, name)]
        new = {name: np.empty(len(table)) for name in (*MADE, "gust", *names)}
        for k, (_, rows, log) in enumerate(flight_logs(table)):
            values = interpolate_missing(log.time, air.iloc[rows][list(_PATH)].to_numpy())
            part = dict(zip(_PATH, values.T, strict=True))
            dots = _angle_rates(log, np.column_stack([part[name] for name in AIR_DATA]))
            part |= dict(zip(("alpha_dot", "beta_dot"), dots.T, strict=True))
            part["gust"] = np.nan_to_num(motion.gust_change(k), nan=self.gust_std_)
            late = _late(log, numeric(table, names)[rows], self.servo_lag_)
            part |= dict(zip(names, late.T, strict=True))
            for name, column in part.items():
                new[name][rows] = column
        return new

    def _transform_table(self, table):
        if not self.used_:
            return table
        if self.optional and (missing := missing_channels(table)):
            finding = Finding(Code.SENSORS_MISSING, numbers={"names": missing})
            report(finding, FlightDataWarning, stacklevel=3)
            return FlightSmoother().fit_transform(table)
        self._check(table)
        known = self.air_motion_
        new = self._path_of(table) if known is None else self._motion_of(table, known)
        for name in EULER:
            new[name] = wrapped_near(new[name], table[name])
        return with_columns(table, new)

    def _path_of(self, table: pd.DataFrame) -> dict[str, Vector]:
        """Return the columns of flights by their most likely paths."""
        new = {name: np.empty(len(table)) for name in (*MADE, "gust")}
        for _, rows, log, solved in self._estimates(table, learn=GUSTS):
            for name, values in _channels(solved.path, log).items():
                new[name][rows] = values
            # the variance of the gusts of the fit counts as `OPINION` seconds of this flight
            squares = [_gust(solved) ** 2, self.gust_std_**2]
            gust = np.sqrt(np.average(squares, weights=[np.ptp(log.time), OPINION]))
            new["gust"][rows] = gust if solved.converged else self.gust_std_
        return new

    def _columns_out(self, names):
        return names + [name for name in (*MADE, "gust") if self.used_ and name not in names]

    def _check(self, table):
        check_columns(table, ["time", *NEEDED])
        check_radians(table, (*EULER, *RATES, "alpha", "beta"))  # roll and heading may be unwrapped

    def _estimates(self, table: pd.DataFrame, *, learn: Mapping[str, float]) -> Flights:
        """Return (name, rows, log, estimate) of every flight, of each part of a long one."""
        estimates = []
        for name, rows, whole in flight_logs(table):
            for part, inner in _parts(len(rows), self.max_rows):
                log = whole.part(part.start, part.stop)
                each = estimate(log, self.noise_std_ | GUSTS, learn=learn, free=FREE)
                path = each.path.part(inner.start, inner.stop)
                kept = rows[part][inner], log.part(inner.start, inner.stop)
                estimates.append((name, *kept, each._replace(path=path)))
        for name in dict.fromkeys(name for name, *_, each in estimates if not each.converged):
            report(Finding(Code.PATH_NOT_CONVERGED, flight=name), stacklevel=4)
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


def _channels(path: FlightPath, log: Log) -> dict[str, Vector]:
    """Return the reconstructed columns of a flight."""
    air = np.column_stack(air_data(path.air_velocity()))
    rotation = path.attitude.as_euler("ZYX")[:, ::-1]
    parts = [
        air,
        _angle_rates(log, air),
        path.rate(log),
        path.force(log),
        rotation,
        path.velocity,
        path.wind(),
    ]
    return dict(zip(MADE, np.column_stack(parts).T, strict=True))


def _angle_rates(log: Log, air: Matrix) -> Matrix:
    """Return the rates of change of alpha and beta (n, 2) by air data (n, 3), NaN of single samples."""
    dots = np.full((len(air), 2), np.nan)
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


def _contradictions(estimates: Flights, residuals: Mapping[str, float]) -> dict[str, str]:
    """Return the sensors whose residuals, learned with the path, exceed their noise, in words."""
    words = {}
    for name, (kind, columns, what, unit, factor) in FOLLOWS.items():
        residual, noise = factor * residuals[name], factor * _noise(kind, columns, estimates)
        if residual > (MAX_AIR_NOISE if name in AIR_DATA else MAX_INERTIAL_NOISE) * noise:
            words[name] = f"{what} (residual {residual:.2g} {unit}, noise {noise:.2g})"
    return words


def _noise(kind: str, columns: Any, estimates: Flights) -> float:
    """Return the white noise in columns of each flight's log, from their third differences."""
    squares = []
    for _, _, log, _ in estimates:
        for column in getattr(log, kind).T[columns].reshape(-1, len(log.time)):
            rows = np.flatnonzero(np.isfinite(column))
            joined = log.segment[rows[DIFFERENCES:]] == log.segment[rows[:-DIFFERENCES]]
            squares.append(np.diff(column[rows], DIFFERENCES)[joined] ** 2 / 20)
    values = np.concatenate(squares)
    return float(np.sqrt(values.mean())) if len(values) else np.nan
