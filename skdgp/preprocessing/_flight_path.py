"""FlightPathReconstruction: the most likely path of each flight, from all its sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from numbers import Integral
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from skdgp._compute.messages import Progress, notify, report
from skdgp._compute.sklearn_compat import Interval, fit_context
from skdgp._flight.channels import (
    AIR_DATA,
    EULER,
    RATES,
    SENSOR_POSITION,
    VANES,
)
from skdgp._flight.faults import FlightDataWarning
from skdgp._flight.findings import Code, Finding
from skdgp._flight.physics import find_contradictions
from skdgp._flight.sensor_position import at_centre_of_gravity
from skdgp._flight.tables import FlightTable, by_name, has_values, with_sensor_position, wrap_near
from skdgp._flight.units import check_radians
from skdgp.dynamics import Aircraft, Servos
from skdgp.estimation import (
    CALIBRATED,
    GUSTS,
    PATH_CHANNELS,
    PATH_NOISE,
    RECONSTRUCTED,
    AirMotion,
    AirSettings,
    NamedFlight,
    PathEstimate,
    air_columns,
    apparent_arm,
    contradictions,
    estimate_air_motion,
    estimate_path,
    flights_of,
    ground_paths,
    missing_channels,
    path_columns,
)
from skdgp.preprocessing._cleaning import FlightSmoother
from skdgp.preprocessing._lag import deflections
from skdgp.preprocessing._table import (
    TableTransformer,
    with_names,
)

# Share of what accelerometers read off the paths, which another position explains: 0.44 of 3 m, 0.32 and 0.35 of 1 m
# on two other aircraft of JSBSim, 0.003 at most in six sound flights
LEAST_EXPLAINED = 0.2

EstimatedFlight: TypeAlias = tuple[NamedFlight, PathEstimate]


class FlightPathReconstruction(TableTransformer):
    r"""Reconstruct the path of each flight through the air from all its sensors at once.

    The most likely path under the exact kinematics, with ground velocity v (NED), attitude R (body
    to NED), wind w, specific force f, angular rate omega and gravity g,

    .. math:: \dot v = R f + g, \quad \dot R = R [\omega]_\times, \quad v_a = R^T (v - w),
    .. math:: V = |v_a|, \quad \alpha = \arctan(w_a / u_a), \quad \beta = \arcsin(v_a / V),

    and gusts of a correlation time of 10 s (Mulder et al. 1999; Klein & Morelli 2006, chapter 10;
    Jategaonkar 2006, chapter 10), as one sparse least-squares problem. Vanes are optional. ``fit``
    learns the noise of each sensor, by maximum likelihood. ``transform`` uses it, and estimates
    biases of inertial sensors, wind and gusts separately for each flight. Rates of change of single
    samples are NaN.

    All tables pass unchanged, if the flights of ``fit`` lack time, a rate, specific force,
    attitude, v_north, v_east, v_down or airspeed (``missing_``), or an inertial sensor, or two of
    air data, contradict the others. Residuals of a contradiction exceed the noise 6 times (inertial
    sensors) or 1.4 times (airspeed, alpha, beta). A log without alpha or beta is reconstructed all
    the same. If only flights of ``transform`` lack a channel, `FlightSmoother` smooths them. Raises
    ValueError of a table without any of the channels, if time does not increase within a flight, or
    if angles are not radians.

    Parameters
    ----------
    max_rows : int, default=65536
        Rows of a flight that are estimated at a time, of 20 kB each: a longer flight is estimated
        in parts of equal length, each with its own biases, wind and gusts.
    aircraft : Aircraft, optional
        For flights without alpha or beta. None: angles from attitude, velocity and steady wind, so
        without the gusts. Else by `estimate_air_motion`, whose derivatives, lag of the servos and
        noises ``fit`` keeps: ``transform`` estimates gusts, wind and biases of each flight, and the
        surfaces without their lag. Coefficients of such flights agree with these angles by
        construction: their errors on test flights say little. Of all flights it gives the position
        of the inertial sensors, where they do not state it: specific force is then returned at the
        centre of gravity.
    thrust : str or None, default="auto"
        For ``aircraft``, as in `skdgp.dynamics.aerodynamic_coefficients`.
    settings : AirSettings, optional
        For ``aircraft``, as in `estimate_air_motion`.

    Attributes
    ----------
    used_ : bool
        Whether ``transform`` reconstructs flights, or passes them unchanged.
    finding_ : Finding
        Why; ``finding_.clause`` says it in words.
    missing_ : list of str
        Missing channels of the flights of ``fit``, which then pass unchanged.
    contradictions_ : list of Finding
        Sensors that contradict the others (``channel``), with residual and noise (``numbers``).
    noise_std_ : dict of str to float
        Noise of each sensor: accelerometer, gyro, airspeed, alpha, beta, v_horizontal, v_down,
        tilt, heading.
    air_motion_ : AirMotion or None
        Of flights without vanes, where ``aircraft`` is given; its ``air`` is the mean. Then there is
        no ``calibration_``.
    doubts_ : list of Finding
        Why gusts of flights without vanes are not known, flights of ``fit`` whose paths did not converge, and
        sensors that contradict each other, so that paths are not used.
    gust_std_ : float
        Change of the air's velocity in one second [m/s], root mean square over the flights of
        ``fit``; the column ``gust`` of the transformed table holds the value of each flight.
    calibration_ : DataFrame
        Biases of inertial sensors and mean wind of each flight of ``fit``, or of each part of a
        long one: columns ``flight``, ``constant``, ``estimate`` and ``std``.

    Warns
    -----
    FlightDataWarning
        In ``transform``, where flights are smoothed although the ones in ``fit`` were
        reconstructed.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> rng = np.random.default_rng(0)
    >>> t = np.arange(0, 60, 0.05)
    >>> mean = {"az": -9.80665, "v_north": 30.0, "airspeed": 30.0}
    >>> noise = dict(p=0.003, q=0.003, r=0.003, ax=0.05, ay=0.05, az=0.05, phi=0.01, theta=0.01, psi=0.01, v_north=0.2,
    ...              v_east=0.2, v_down=0.2, airspeed=0.3, alpha=0.005, beta=0.005)
    >>> measured = {name: rng.normal(mean.get(name, 0.0), std, t.size) for name, std in noise.items()}
    >>> flight = pd.DataFrame({"time": t, **measured})
    >>> reconstruction = FlightPathReconstruction().fit(flight)
    >>> bool(reconstruction.transform(flight).alpha.std() < 0.2 * flight.alpha.std())
    True
    >>> round(reconstruction.noise_std_["alpha"], 3)
    0.005
    """

    _parameter_constraints: dict = {
        "max_rows": [Interval(Integral, 1, None, closed="left")],
        "aircraft": [Aircraft, None],
        "thrust": [str, None],
        "settings": [AirSettings, None],
    }

    def __init__(
        self,
        *,
        max_rows: int = 65536,
        aircraft: Aircraft | None = None,
        thrust: str | None = "auto",
        settings: AirSettings | None = None,
    ) -> None:
        self.max_rows = max_rows
        self.aircraft = aircraft
        self.thrust = thrust
        self.settings = settings

    def in_simulation(self) -> dict[str, Any]:
        """Return the servos."""
        return {"servos": self.servos_}

    @property
    def servos_(self) -> Servos:
        """Servos between the commands and the surfaces, ideal where their lag is not estimated."""
        if self.air_motion_ is None:
            return Servos()
        return Servos(lag=float(self.air_motion_.constants["value"]["servo_lag"]))

    @property
    def finding_(self) -> Finding:
        """Whether ``transform`` reconstructs flights, and why."""
        code = Code.PATHS_RECONSTRUCTED if self.used_ else Code.PATHS_SMOOTHED
        return Finding(
            code,
            missing=self.missing_,
            contradictions=self.contradictions_,
            air=self.air_motion_ and self.air_motion_.summary,
        )

    @fit_context(prefer_skip_nested_validation=True)
    def fit_transform(self, X: Any, y: Any = None) -> Any:
        """Return ``fit(X).transform(X)``; y is ignored."""
        table = self._checked(X)
        return self._transform_table(table, self._fit_table(table))

    def _fit_table(self, table: pd.DataFrame) -> list[PathEstimate] | None:
        """Set the fitted attributes; return the paths over the ground of flights without vanes, else None."""
        table = with_sensor_position(table, self.aircraft)
        self._check_any(table, (*PATH_CHANNELS, *VANES))
        self.missing_ = missing_channels(table)
        self.used_ = not self.missing_
        self.contradictions_: list[Finding] = []
        self.air_motion_: AirMotion | None = None
        self.doubts_: list[Finding] = []
        if self.missing_:
            return None
        self._check(table)
        has_vanes = has_values(table, *AIR_DATA)
        paths = None
        if not has_vanes and self.aircraft is None:
            cause = Finding(Code.NO_AIRCRAFT)
            self.doubts_ = [Finding(Code.GUSTS_UNKNOWN, cause=cause)]
        elif not has_vanes:
            paths = ground_paths(table)
            self._fit_air_motion(table, paths)
        if self.air_motion_ is None:
            self._fit_path(table, has_vanes)
        return paths

    def _fit_path(self, table: pd.DataFrame, has_vanes: bool) -> None:
        """Set the fitted attributes by the paths of the flights."""
        parts = self._estimated_paths(table, PATH_NOISE, learn=PATH_NOISE | GUSTS)
        samples = [len(flight.rows) for flight, _ in parts]
        noise = pd.DataFrame([estimate.noise for _, estimate in parts])
        self.noise_std_ = {name: _mean_std(noise[name], samples) for name in PATH_NOISE}
        self.gust_std_ = _mean_std([_gust_std(estimate) for _, estimate in parts], samples)
        self.calibration_ = pd.concat([_calibration(*part) for part in parts], ignore_index=True)
        found = contradictions([flight.sensors for flight, _ in parts], self.noise_std_)
        self.contradictions_ = found
        # one sensor of air data alone is probably filtered by the autopilot
        is_filtered = len(found) == 1 and found[0].channel in AIR_DATA
        self.used_ = not found or is_filtered or not has_vanes
        self.doubts_ += _diverged(parts, table) if self.used_ else _disagreement(parts, found)

    def _fit_air_motion(self, table: pd.DataFrame, paths: list[PathEstimate]) -> None:
        """Set the fitted attributes by the motion of the air, if it can be estimated."""
        motion, self.doubts_ = self._estimated_motion(table, paths)
        if motion is None:
            return
        error = motion.position_error()
        if not self.doubts_ and error is not None:
            report(Finding(Code.SENSORS_ELSEWHERE, distance=error))
        mean = motion.air.mean().to_frame().T  # a saved model holds no flights
        self.air_motion_ = replace(motion, air=mean)
        changes = [motion.gust_change(number) for number in range(len(paths))]
        self.gust_std_ = float(np.sqrt(np.nanmean(np.square(changes))))
        self.noise_std_ = PATH_NOISE | {name: motion.noise[name] for name in ("gyro", "airspeed")}

    def _estimated_motion(
        self,
        table: pd.DataFrame,
        paths: list[PathEstimate] | None,
        known: AirMotion | None = None,
    ) -> tuple[AirMotion | None, list[Finding]]:
        """Return the motion of the air, None where it cannot be estimated, and its doubts."""
        aircraft: Any = self.aircraft
        motion = None
        try:
            motion = estimate_air_motion(
                table,
                aircraft,
                thrust=self.thrust,
                known=known,
                settings=self.settings or AirSettings(),
                paths=paths,
            )
            if motion.converged:
                return motion, []
            cause = Finding(Code.AIR_NOT_CONVERGED, **_agreement(table))
        except ValueError as error:
            cause = Finding(Code.AIR_NOT_ESTIMATED, error=str(error))
        doubt = Finding(
            Code.GUSTS_UNKNOWN,
            cause=cause,
            angles_lack_gusts=motion is None,
            general_bands=known is None,
        )
        report(doubt)
        return motion, [doubt]

    def _transform_table(
        self, table: pd.DataFrame, paths: list[PathEstimate] | None = None
    ) -> pd.DataFrame:
        """Return the transformed table, whose flights have ``paths`` over the ground where these are known."""
        table = with_sensor_position(table, self.aircraft)
        if not self.used_:
            return at_centre_of_gravity(table)
        if missing := missing_channels(table):
            report(Finding(Code.SENSORS_MISSING, names=missing), FlightDataWarning)
            return FlightSmoother().fit_transform(at_centre_of_gravity(table))
        self._check(table)
        motion = None
        if self.air_motion_ is not None:
            motion, found = self._estimated_motion(table, paths, self.air_motion_)
            if paths is not None:  # of the flights of the fit
                self.doubts_ += found
        if motion is None:
            flights = self._columns_by_path(table)
        else:
            flights = self._columns_by_air(table, motion)
        columns = pd.concat(flights).sort_index()
        if columns["alpha"].abs().quantile(0.99) > np.pi / 2:
            raise ValueError(
                "Got flights that fly backwards by velocity, attitude and airspeed: correct the channels that "
                "contradict each other (skdgp inspect)."
            )
        new = by_name([*map(str, columns)], columns.to_numpy(float))
        if motion is not None:
            new |= deflections(table, self.servos_.lag)
        wrap_near(new, table, EULER)
        if {*SENSOR_POSITION} <= {*table}:
            # the specific force is that at the centre of gravity
            new |= dict.fromkeys(SENSOR_POSITION, np.zeros(len(table)))
        return table.assign(**new)

    def _columns_by_path(self, table: pd.DataFrame) -> list[pd.DataFrame]:
        """Return the columns of flights, at their rows, by their most likely paths."""
        tables = []
        parts = self._estimated_paths(table, self.noise_std_, learn=GUSTS)
        _diverged(parts, table)
        for flight, estimate in parts:
            columns: dict[str, Any] = path_columns(estimate.path, flight.sensors)
            columns["gust"] = self.gust_std_
            if estimate.converged:
                # gusts of the training flights count as 2 s of this flight: 2 and 5 have the best median scores
                stds = [_gust_std(estimate), self.gust_std_]
                seconds = [np.ptp(flight.sensors.time), 2.0]
                columns["gust"] = _mean_std(stds, seconds)
            tables.append(pd.DataFrame(columns, index=flight.rows))
        return tables

    def _columns_by_air(self, table: pd.DataFrame, motion: AirMotion) -> list[pd.DataFrame]:
        """Return the columns of flights, at their rows, by the motion of their air."""
        flights = []
        for number, (_, rows, sensors) in enumerate(flights_of(table)):
            columns: dict[str, Any] = air_columns(motion.air.iloc[rows], sensors)
            columns["gust"] = np.nan_to_num(motion.gust_change(number), nan=self.gust_std_)
            flights.append(pd.DataFrame(columns, index=rows))
        return flights

    def _columns_out(self, names):
        if self.aircraft is not None and self.aircraft.sensor_position is not None:
            names = with_names(names, SENSOR_POSITION)
        if not self.used_:
            return names
        return with_names(names, [*RECONSTRUCTED, "gust"])

    def _check(self, table):
        FlightTable.of(table, PATH_CHANNELS)
        check_radians(table, (*EULER, *RATES, *VANES))

    def _estimated_paths(
        self, table: pd.DataFrame, noise: dict[str, float], learn: Mapping[str, float]
    ) -> list[EstimatedFlight]:
        """Return every flight, each part of a long one, with its path."""
        parts = []
        for flight in flights_of(table):
            n = len(flight.rows)
            for rows in np.array_split(np.arange(n), -(-n // self.max_rows)):
                sensors = flight.sensors.part(rows[0], rows[-1] + 1)
                parts.append(flight._replace(rows=flight.rows[rows], sensors=sensors))
        estimated = []
        for number, part in enumerate(parts):
            notify(Progress("reconstructing paths", number, len(parts)))
            estimate = estimate_path(part.sensors, noise | GUSTS, learn=learn)
            estimated.append((part, estimate))
        return estimated


def _diverged(parts: Sequence[EstimatedFlight], table: pd.DataFrame) -> list[Finding]:
    """Return the doubt of flights whose paths are used and did not converge, and warn of it."""
    flights = dict.fromkeys(str(part.name) for part, path in parts if not path.converged)
    if not flights:
        return []
    doubt = Finding(Code.PATHS_NOT_CONVERGED, flights=list(flights), **_agreement(table))
    report(doubt)
    return [doubt]


def _disagreement(parts: Sequence[EstimatedFlight], found: list[Finding]) -> list[Finding]:
    """Return the doubt of sensors that were ``found`` to contradict each other, and warn of it."""
    arm = None
    if any(each.channel == "accelerometer" for each in found):
        position, explained = apparent_arm([(flight.sensors, path) for flight, path in parts])
        if explained > LEAST_EXPLAINED:
            arm = dict(zip("xyz", position.tolist(), strict=True))
    doubt = Finding(
        Code.SENSORS_DISAGREE, contradictions=found, arm=arm, is_unexplained=arm is None
    )
    report(doubt)
    return [doubt]


def _agreement(table: pd.DataFrame) -> dict[str, Any]:
    """Return the contradictions of flights, and whether there are none."""
    contradictions = find_contradictions(FlightTable.of(table))
    return {"contradictions": contradictions, "agrees": not contradictions}


def _mean_std(stds: Any, weights: Any = None) -> float:
    """Return the root of the weighted mean of variances."""
    return float(np.sqrt(np.average(np.square(stds), weights=weights)))


def _gust_std(estimate: PathEstimate) -> float:
    """Return the change of the air's velocity in one second [m/s], root mean square of the two directions."""
    return _mean_std([estimate.noise[name] for name in GUSTS])


def _calibration(flight: NamedFlight, estimate: PathEstimate) -> pd.DataFrame:
    """Return the estimated constants of a flight."""
    columns = {
        "flight": flight.name,
        "constant": CALIBRATED,
        "estimate": estimate.path.constant(*CALIBRATED),
        "std": np.sqrt(np.diag(estimate.covariance)),
    }
    return pd.DataFrame(columns)
