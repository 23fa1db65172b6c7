r"""estimate_air_motion: derivatives, gusts and wind of flights without vanes, by the filter-error method.

In order: records of the flights with their paths (``_air_records.py``), search for the parameters
(``_air_fit.py``), covariance of the parameters and smoothed motion of the air (``_air_covariance.py``).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import pandas as pd

from skdgp._compute.linalg import eigen_root
from skdgp._compute.typing import Array, Matrix
from skdgp._flight.channels import (
    ELEVONS,
    EULER,
    HAT,
    RATES,
    SURFACES,
    THRUST_COLUMNS,
    VANES,
    by_elevons,
)
from skdgp._flight.frames import wind_origin
from skdgp._flight.holds import with_own_clocks
from skdgp._flight.tables import FlightTable, has_values, sensor_position, with_sensor_position
from skdgp._flight.units import check_radians
from skdgp.dynamics import (
    Aircraft,
    check_aircraft,
    dynamic_pressure,
    propeller_speed_of,
    propulsive_loads,
)
from skdgp.estimation._air_covariance import (
    add_attenuation,
    add_delay_error,
    error_fractions,
    misfit_of_sensors,
    sandwich,
    smoothed_air,
    unfinished_covariance,
    widened,
)
from skdgp.estimation._air_fit import AIR_SETTINGS, AirFit, AirSettings
from skdgp.estimation._air_linearization import Layout
from skdgp.estimation._air_parameters import (
    AIRCRAFT_CONSTANTS,
    AIRCRAFT_NOISES,
    ALL_TERMS,
    ARM,
    FLIGHT_CONSTANTS,
    FLIGHT_NOISES,
    GUST_AXES,
    SENSOR_CONSTANTS,
    GustProcesses,
    Parameters,
    derivatives_of,
)
from skdgp.estimation._air_records import (
    FEWEST_SAMPLES,
    Record,
    quietest_noise,
    records_of,
    shortened,
)
from skdgp.estimation._path import PathEstimate, ground_paths
from skdgp.estimation._sensors import (
    FORCE_READINGS,
    KNOWN_ARM,
    PATH_CHANNELS,
    RATE_READINGS,
    Prior,
    moving,
)

DIVERGED = (
    "The estimate diverged: the flights do not tell gusts and derivatives apart. Give longer flights "
    "with inputs of every surface; what the checks of physics say of the sensors (skdgp inspect) comes first."
)


@dataclass(frozen=True)
class AirMotion:
    """Estimates of `estimate_air_motion`.

    Attributes
    ----------
    derivatives : DataFrame
        A row per derivative, such as CZ_alpha [1/rad], or Cm_thrust, by thrust over dynamic pressure
        and wing area: ``value``, ``std``, and ``prior_std``, which ``std`` approaches where the
        flights contain no information.
    covariance : DataFrame (p, p)
        Joint covariance of the derivatives.
    constants : DataFrame
        The same columns for servo_lag [s], thrust_scale, slipstream (wing area over the disk of a
        propeller before the tail), airspeed_scale, error of the position of the
        inertial sensors arm_x, arm_y, arm_z [m] (from the centre of gravity where it is not known),
        and for each flight wind and biases.
    noise : dict of str to float
        Gusts [m/s], their correlation times [s], and noises of the sensors (SI).
    air : DataFrame
        For each row of the table, the smoothed airspeed, alpha, beta, p, q, r, and wind with gusts,
        and ``_std`` of each; NaN in rows that no record contains. Then specific force at the centre
        of gravity, attitude and ground velocity without bias and lag.
    surfaces : list of str
        Surfaces that move in the flights.
    converged : bool
        Whether the last steps were small, and the likelihood had not fallen far. Otherwise ``std``
        includes how far the search still moved in its last passes, and slopes by alpha and beta have
        that of before the search, as all have if it was cut short.
    misfit : float
        Root mean square of the sensors' constants over their prior standard deviations, or of the
        errors of their position if that is larger, at least one. ``std`` is widened by it: effects
        that the model lacks shift these constants (Birge 1932).
    vibrates : bool
        Whether an oscillation shakes accelerometers and gyros of a flight. What they share then counts as
        noise, and ``std`` is larger by half.
    mean_thrust : float
        Mean thrust over dynamic pressure and wing area, at which derivatives by elevator and rudder hold.
    """

    derivatives: pd.DataFrame
    covariance: pd.DataFrame
    constants: pd.DataFrame
    noise: dict[str, float]
    air: pd.DataFrame
    surfaces: list[str]
    converged: bool
    misfit: float = 1.0
    vibrates: bool = False
    mean_thrust: float = 0.0

    @property
    def summary(self) -> str:
        """The estimates in one line.

        For example "gusts 1.0 m/s rms, 20 m; wind 3.6 m/s from 326 deg; servos 47 ± 2 ms late".
        """
        gust, length = self.gusts
        north, east = self.constants["value"].loc[["wind_north 0", "wind_east 0"]].to_numpy(float)
        servo = self.constants.loc["servo_lag"]
        parts = [
            f"gusts {gust:.1f} m/s rms, {length:.0f} m",
            f"wind {np.hypot(north, east):.1f} m/s from {wind_origin(north, east):.0f} deg",
            f"servos {1e3 * servo['value']:z.0f} ± {1e3 * servo['std']:.0f} ms late",
        ]
        if self.vibrates:
            parts.append("inertial sensors vibrate: bands wider by half")
        if not self.converged:
            parts.append("not converged: do not use")
        elif self.misfit > 1:
            of_sensors = self.constants.index.str.split().str[0].isin((*SENSOR_CONSTANTS, *ARM))
            found = self.constants[of_sensors]
            worst = found.loc[[(found["value"] / found["prior_std"]).abs().idxmax()]]
            size, usual = worst[["value", "prior_std"]].to_numpy()[0]
            parts.append(
                f"{worst.index[0]} is {size:.2g}, usual is 0 ± {usual:.2g}: bands {self.misfit:.1f} times as wide"
            )
        return "; ".join(parts)

    @property
    def gusts(self) -> tuple[float, float]:
        """Intensity of the gusts of the first flight [m/s], and the length [m] over which they fall to 1/e."""
        gusts = self._gusts(0)
        std = np.sqrt(np.mean(gusts.std**2))
        return float(std), float(gusts.time[0] * np.nanmean(self.air["airspeed"]))

    def slopes(
        self, coefficients: Sequence[str], regressors: Sequence[str]
    ) -> tuple[Matrix, Array]:
        """Return slopes (P, d) at the mean of alpha, NaN where there are none, and their errors (P, d, k).

        ``regressors`` are alpha, beta, p_hat, q_hat, r_hat and surfaces. An error is the sum of its
        last axis times independent standard normal numbers.
        """
        alpha = float(np.nanmean(self.air["alpha"]))
        errors = eigen_root(self.covariance.to_numpy())
        columns = np.column_stack([self.derivatives["value"], errors])
        table = pd.DataFrame(columns, index=self.derivatives.index)
        out = np.full((len(coefficients), len(regressors), columns.shape[1]), np.nan)
        for j, regressor in enumerate(map(str, regressors)):
            if regressor in RATES:  # of derivatives by non-dimensional ones
                continue
            term = regressor.removesuffix(HAT)
            out[:, j] = table.reindex([f"{name}_{term}" for name in coefficients])
            if regressor == "alpha":
                curvature = table.reindex([f"{name}_alpha2" for name in coefficients])
                out[:, j] += 2 * alpha * curvature.fillna(0.0)
        return out[..., 0], np.nan_to_num(out[..., 1:])

    def position_error(self) -> float | None:
        """Return how far the inertial sensors are from their position [m].

        None unless a component is more than three standard deviations of its prior.
        """
        error = self.constants.loc[list(ARM)]
        is_improbable = error["value"].abs() > 3.0 * error["prior_std"]
        return float(np.linalg.norm(error["value"])) if is_improbable.any() else None

    def gust_change(self, flight: int) -> float:
        """Return the change of the gusts of a flight in 1 s [m/s], root mean square of the axes; NaN if unknown."""
        gusts = self._gusts(flight)
        variance = 2 * gusts.std**2 * -np.expm1(-1 / gusts.time)  # of Gauss-Markov processes
        return float(np.sqrt(np.mean(variance)))

    def _gusts(self, flight: int) -> GustProcesses:
        """Return the gusts of a flight, NaN if unknown."""
        intensities = {axis: self.noise.get(f"{axis} {flight}", np.nan) for axis in GUST_AXES}
        return GustProcesses.of({**self.noise, **intensities})


def estimate_air_motion(
    table: pd.DataFrame,
    aircraft: Aircraft,
    *,
    thrust: str | None = "auto",
    known: AirMotion | None = None,
    settings: AirSettings = AIR_SETTINGS,
    paths: Sequence[PathEstimate] | None = None,
) -> AirMotion:
    r"""Estimate derivatives, gusts, wind and lag of the servos from flights with or without vanes.

    The filter-error method (Maine & Iliff 1981; Jategaonkar 2015, chapter 5). Coefficients are
    linear in derivatives :math:`\theta`; gusts are Gauss-Markov processes. The air also rolls, as the spectra of
    MIL-F-8785C have it for its vertical gusts and the span (`rolling_gust`); coefficients depend on the rate of
    roll relative to the air, which no sensor shows. Its intensity is near that one. With innovations
    :math:`e_k` of an extended Kalman filter, of covariance :math:`S_k`, and
    :math:`D_k = \partial e_k / \partial \theta` at given gains, the derivatives solve

    .. math:: \sum_k Z_k^T L_k^{-1} e_k + \Lambda (\theta - \theta_0) = 0, \quad
              Z_k = P (L_k^{-1} D_k), \quad S_k = L_k L_k^T,

    where P is the projection on the slopes D of a motion that the surfaces alone cause (instrumental
    variables; Soderstrom & Stoica 1989, chapter 8). Innovations of a filter with a wrong spectrum of
    gusts correlate with past gusts, and so with D, but hardly with this motion. An autopilot
    answers gusts: this motion excludes the part of the surfaces that innovations explain.
    Noises maximise the likelihood of the innovations. Priors :math:`\Lambda` are wide; they bound
    parameters that a flight does not determine. Terms beyond the usual ones, such as CY by the
    ailerons, or Cm by thrust over dynamic pressure and wing area, have narrow priors around zero, as
    of a symmetric aircraft without offset of the thrust line. Elevator and rudder may become stronger
    with thrust, in the slipstream of a propeller. The covariance is
    :math:`A^{-1} = (Z^T Z + \Lambda)^{-1}` times the square of `AirMotion.misfit`; variances are those of
    :math:`A^{-1} B A^{-1}` where these are larger, with the sum B of squares of the scores of some steps each
    (White 1982). It is larger where vibration shakes the inertial sensors.
    Readings in its two directions then count as noise. For nonlinear effects 4 % of each derivative are
    added. A delay of the servos beside their lag, of 0 ± 5 ms or, where it is
    larger, ``servo_delay_std``, moves all parameters.
    Where surfaces hardly move a term, so that errors of path and sensors make most of its motion,
    ``std`` approaches ``prior_std``.

    Parameters
    ----------
    table : DataFrame
        Flights with time, p, q, r, ax, ay, az, phi, theta, psi, v_north, v_east, v_down, airspeed,
        density, surfaces (deflections or commands), thrust or its sources; ``flight`` names the
        flights. alpha and beta are used where they are. SI, radians. Rows may repeat the last
        sample of a slower channel; surfaces are splines between samples. Of flights of more than 12,000
        samples at 50 to 100 Hz, the first parts of the records are used. A delay of the servos, which
        makes slopes by rates too small, is not estimated: `skdgp.preprocessing.LagCorrector` before this
        removes it, and says in ``servo_delay_std`` [s] how well it is known.
    aircraft : Aircraft
        Its position of the inertial sensors, or the one in the table, is taken to be right to 1 cm
        (across 5 mm). Unknown, it is estimated within 3 cm of the centre of gravity (across 1 cm).
    thrust : str or None, default="auto"
        As in `skdgp.dynamics.aerodynamic_coefficients`. Where it is None, or nothing gives it, the
        measured axial force takes the place of thrust and CX, whose derivatives are not estimated.
    known : AirMotion, optional
        Estimates from other flights of the aircraft. Derivatives, lag of the servos and noise of
        the sensors are held at its values; winds, biases and gusts of the given flights are
        estimated.
    settings : AirSettings
    paths : sequence of PathEstimate, optional
        Paths of the flights without air data, where they are known.

    Returns
    -------
    AirMotion

    Raises
    ------
    ValueError
        If no record has 100 samples without a gap, two where ``known`` is given, or the estimate diverges.
    """
    check_aircraft(aircraft)
    FlightTable.of(table, [*PATH_CHANNELS, "density"])
    check_radians(table, (*EULER, *RATES, *VANES))
    table = with_sensor_position(table, aircraft)
    table = with_own_clocks(table)
    if {*ELEVONS} <= {*table}:
        table = table.assign(**by_elevons(table))
    surfaces, derivatives, constants = _priors(table, known)
    has_drag = any(name.startswith("CX_") for name in derivatives)
    has_thrust = any(has_values(table, name) for name in THRUST_COLUMNS)
    has_thrust |= propeller_speed_of(aircraft.propeller, table) is not None
    if thrust is None or not (has_drag and has_thrust):
        # the measured axial force takes the place of thrust and CX, and thrust has no error
        thrust = None
        for name in [*derivatives]:
            if name.startswith("CX_") or name.endswith("_thrust"):
                del derivatives[name]
        constants |= dict.fromkeys(("thrust_scale", "slipstream"), (0.0, 1e-6))
    if paths is None:
        paths = ground_paths(table)
    # of a known aircraft a step is enough
    fewest = FEWEST_SAMPLES if known is None else 2
    loads = np.hstack(propulsive_loads(table, aircraft, thrust))
    records = records_of(table, surfaces, loads, paths)
    records = [record for record in records if len(record.rows) >= fewest]
    if thrust is None:
        records = [record.with_axial_force(aircraft.mass) for record in records]
    if not records:
        raise ValueError(
            f"Got no record of {fewest} samples without a gap, but expected one: give a longer flight."
        )
    if known is not None:
        mean_thrust = known.mean_thrust
    else:
        records = shortened(records, settings.most_samples)
        mean_thrust = 0.0 if thrust is None else _mean_thrust(records, aircraft)
    n_flights = 1 + max(record.flight for record in records)
    shared = derivatives | constants
    n_held = 0 if known is None else len(shared)
    start = partial(
        AirFit,
        records,
        Layout.of(aircraft, mean_thrust, list(derivatives), surfaces),
        Parameters.of(shared, FLIGHT_CONSTANTS, n_flights, n_held),
        _noises(records, known, n_flights),
        settings,
    )
    delay_std = 0.005  # of `estimate_lags`, mostly
    if has_values(table, "servo_delay_std"):
        delay_std = max(delay_std, float(np.nanmax(table["servo_delay_std"])))
    return _searched(start, len(table), delay_std)


def _searched(start: Callable[[], AirFit], n_rows: int, delay_std: float) -> AirMotion:
    """Return the result of the first search that does not go back to an earlier pass, else of the last one that ends.

    Raise ValueError if all diverge.
    """
    motion = None
    # passes before the instruments are used, whose slopes are small far from the solution; the
    # second number where the first attempt diverges, or goes back to an earlier pass
    for n_before in (0, 6):
        fit = start()
        try:
            # a search that diverges leaves the range of numbers
            with np.errstate(over="ignore", invalid="ignore"):
                converged, went_back = fit.search(n_before)
            motion = _air_motion(fit, converged, n_rows, delay_std)
        except np.linalg.LinAlgError:  # the search diverged
            continue
        if not went_back:
            break
    if motion is None:
        raise ValueError(DIVERGED)
    return motion


def _priors(table: pd.DataFrame, known: AirMotion | None) -> tuple[list[str], Prior, Prior]:
    """Return surfaces, and mean and standard deviation of derivatives and constants before the flights."""
    if known is not None:
        constants = _as_prior(known.constants.loc[list(AIRCRAFT_CONSTANTS)])
        return known.surfaces, _as_prior(known.derivatives), constants
    surfaces = moving(table, SURFACES)
    constants = dict(AIRCRAFT_CONSTANTS)
    if np.isfinite(sensor_position(table)).all():
        constants |= KNOWN_ARM
    return surfaces, derivatives_of(ALL_TERMS, surfaces), constants


def _mean_thrust(records: list[Record], aircraft: Aircraft) -> float:
    """Return the mean thrust over the mean dynamic pressure and wing area, by the speed over the ground.

    Slow and standing records hardly count.
    """
    thrust = np.concatenate([record.inputs.thrust[:, 0] for record in records])
    density = np.concatenate([record.inputs.density for record in records])
    speed = np.linalg.norm(np.concatenate([record.velocity for record in records]), axis=1)
    load = np.sum(dynamic_pressure(speed, density)) * aircraft.wing_area
    return float(np.sum(thrust) / load) if load > 0 else 0.0


def _as_prior(estimates: pd.DataFrame) -> Prior:
    """Return value and standard deviation of estimates by name."""
    pairs = zip(estimates["value"], estimates["std"], strict=True)
    return dict(zip(estimates.index, pairs, strict=True))


def _noises(records: list[Record], known: AirMotion | None, n_flights: int) -> Parameters:
    """Return the priors of the noises of the flights; shared ones of a known aircraft are held."""
    if known is not None:
        shared = {name: (known.noise[name], 1.0) for name in AIRCRAFT_NOISES}
        return Parameters.of(shared, FLIGHT_NOISES, n_flights, len(shared))
    accelerometer = quietest_noise(records, FORCE_READINGS)
    gyro = quietest_noise(records, RATE_READINGS)
    shared = dict(AIRCRAFT_NOISES)
    for name in ("ax", "ay", "az"):
        shared[name] = (accelerometer, shared[name][1])
    shared["gyro"] = (gyro, shared["gyro"][1])
    return Parameters.of(shared, FLIGHT_NOISES, n_flights)


def _air_motion(fit: AirFit, converged: bool, n_rows: int, delay_std: float) -> AirMotion:
    """Return the result of a search, from one more pass at its parameters."""
    sums, fitted = fit.filter_records()
    names = fit.parameters.names
    prior_std = fit.parameters.std
    nd = fit.layout.n_derivatives
    covariance = sandwich(sums.information, sums.variation)
    if not converged:
        covariance = unfinished_covariance(fit, covariance)
    misfit = 1.0
    if not fit.is_known:
        misfit = misfit_of_sensors(fit)
        covariance = widened(covariance, fit, misfit)
        place = names.index("servo_delay")
        covariance = add_delay_error(covariance, sums.information, place, delay_std)
    # the air has the errors of the estimates; those of flattened slopes are added below
    air = smoothed_air(fit, fitted, covariance, n_rows)
    if not fit.is_known:
        covariance = add_attenuation(covariance, fit.x, prior_std, error_fractions(fit, fitted))
    std = np.sqrt(np.diag(covariance))
    columns = {"value": fit.x, "std": std, "prior_std": prior_std}
    estimates = pd.DataFrame(columns, index=names)
    return AirMotion(
        derivatives=estimates[:nd],
        covariance=pd.DataFrame(covariance, index=names, columns=names).iloc[:nd, :nd],
        constants=estimates[nd:],
        noise=fit.noise_search.values,
        air=air,
        surfaces=list(fit.layout.surfaces),
        converged=converged,
        misfit=misfit,
        vibrates=fit.vibrates,
        mean_thrust=fit.layout.mean_thrust,
    )
