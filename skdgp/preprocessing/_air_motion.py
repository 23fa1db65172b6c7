"""estimate_air_motion: derivatives, gusts and wind of flights without vanes, by the filter-error method."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pandas as pd
from scipy.ndimage import uniform_filter1d
from scipy.spatial.transform import Rotation

from skdgp._compute.linalg import eigen_root
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import (
    AIR_DATA,
    COEFFICIENTS,
    EARTH_VELOCITY,
    ELEVONS,
    EULER,
    HAT,
    MIXED,
    RATES,
    SPECIFIC_FORCE,
    SURFACES,
    THRUST_FORCES,
    WIND,
)
from skdgp._flight.checks import check_columns, check_radians, check_table, numeric
from skdgp._flight.frames import air_data, air_data_slopes, cross, cross_matrix
from skdgp.dynamics import Aircraft, check_aircraft, propeller_speed_of, propulsive_loads
from skdgp.preprocessing._air_motion_equations import (
    AIRSPEED,
    ARM,
    BIASES,
    FAST,
    GUST,
    N_STATES,
    TINY,
    TURN,
    WINDS,
    Layout,
    Record,
    air_velocity,
    linearised,
    noise,
)
from skdgp.preprocessing._air_motion_filter import (
    Linearisation,
    Pass,
    filtered,
    innovation_slopes,
    smoothed,
    state_slopes,
)
from skdgp.preprocessing._air_motion_model import (
    OWN,
    OWN_NOISES,
    SENSOR_CONSTANTS,
    SHARED,
    SHARED_NOISES,
    STATE_TERMS,
    TERMS,
    Inputs,
    Parameters,
    Prior,
    derivatives_of,
)
from skdgp.preprocessing._path import (
    GUSTS,
    INERTIAL,
    NEEDED,
    NOISE,
    estimate,
    flight_logs,
)
from skdgp.preprocessing._table import has_values, interpolate_missing

PATH_CONSTANTS = (*INERTIAL, "velocity_lag", "attitude_lag")
FEWEST = 100  # samples of a record, of flights to learn from
MOST = 12000  # samples to learn from, of all records
RATE = 50.0  # Hz, of samples; faster logs are thinned to 50 to 100 Hz
LOG_MOVE = 1e-3  # of the logarithm of a noise
NOISE_SAMPLES = 2000  # of each record, from its middle, that tell the noises
MAX_PASSES = 45
# Passes before the instruments are used, whose slopes are small far from the solution. The second, where
# the first diverges.
ATTEMPTS = 0, 6
DAMPING = 0.3  # of the first step, over the information
# Share of a step that is taken: shortened where steps turn back, down to the least, else lengthened to one
SHORTER, LEAST_SHARE, LONGER = 0.5, 0.25, 1.4
PITOT = ("airspeed_scale", *WINDS[:2])
GUST_WINDOW = 20.0  # s, longer than gusts last
PITOT_NOISE = 10.0  # m/s, of the mean airspeed of a flight times the root of its samples; typical
PITOT_STD = 0.1  # m/s, least error of a sample of the airspeed
LARGEST_PATH = 2.0  # m/s, of the air velocity that errors of the path may make
TOLERANCE = 0.5  # squared length of the last two steps, in standard deviations of all parameters
NOISE_TOLERANCE = 5.0  # that of the last step of the noises
LARGEST_LOG = 0.7  # step of the logarithm of a noise
LEAST_NOISE = 1e-4  # of accelerometers and gyros, SI
LIFT_SLOPE = 4.5  # 1/rad, typical
MEAN_GUST = 0.2  # m/s, standard deviation of the mean vertical gust of a record
DIVERGED = (
    "The estimate diverged: the flights do not tell gusts and derivatives apart. Give longer flights "
    "with inputs of every surface, and look at the signs and units of their sensors."
)
LEAST_DIRECTION = 1e-6  # of the instruments, relative to the largest singular value
BLOCK = 2.0  # s of scores that are summed before their covariance is taken
LAG_ERROR = 0.1  # standard deviation by what a surface does between samples, in steps
# Errors of path [m/s], rates [rad/s] and surfaces [rad] that seem to be motion; guesses
ERROR_VELOCITY, ERROR_RATE, ERROR_SURFACE = 0.02, 0.002, 0.001
# Relative standard deviations of a derivative by what the model leaves out, and of the scale of alpha, and
# of beta, by a wrong spectrum of gusts; chosen by leaving each of six aircraft out (docs/preprocessing.md)
MODEL_ERROR, ANGLE_ERROR = 0.04, 0.02


@dataclass(frozen=True)
class AirMotion:
    """What the flights of `estimate_air_motion` show.

    Attributes
    ----------
    derivatives : DataFrame
        A row per derivative, such as CZ_alpha [1/rad]: ``value``, ``std``, and ``prior_std``, which
        ``std`` comes near where the flights cannot tell.
    covariance : DataFrame
        Of the derivatives.
    constants : DataFrame
        The same columns, of servo_lag [s], thrust_scale, airspeed_scale, position of the inertial
        sensors arm_x, arm_y, arm_z [m], and for each flight wind and biases.
    noise : dict of str to float
        Gusts [m/s], their correlation times [s], and noises of the sensors (SI).
    air : DataFrame
        For each row of the table, the smoothed airspeed, alpha, beta, p, q, r, and wind with gusts,
        and ``_std`` of each; NaN in rows that no record contains. Then specific force, attitude and
        ground velocity without bias and lag.
    surfaces : list of str
        Surfaces of the model.
    converged : bool
        Whether the last steps were small. Otherwise the results are not to be used; ``std`` has the
        prior's variance and the distance from its mean.
    seconds : float
        Length of the records.
    misfit : float
        Root mean square of the sensors' constants over their prior standard deviations, at least
        one. ``std`` is widened by it: effects that the model lacks shift these constants (Birge
        1932).
    """

    derivatives: pd.DataFrame
    covariance: pd.DataFrame
    constants: pd.DataFrame
    noise: dict[str, float]
    air: pd.DataFrame
    surfaces: list[str]
    converged: bool
    seconds: float
    misfit: float = 1.0

    @property
    def summary(self) -> str:
        """What was found, in one line.

        For example "gusts 1.0 m/s rms, 20 m; wind 3.6 m/s from 326 deg; servos 47 ± 2 ms late".
        """
        gust, length = self.gusts
        wind = self.constants["value"].loc[["wind_north 0", "wind_east 0"]].to_numpy(float)
        origin = np.rad2deg(np.arctan2(-wind[1], -wind[0])) % 360
        lag, std = 1e3 * self.constants.loc[["servo_lag"], ["value", "std"]].to_numpy(float)[0]
        parts = [
            f"gusts {gust:.1f} m/s rms, {length:.0f} m",
            f"wind {np.hypot(*wind):.1f} m/s from {origin:.0f} deg",
            f"servos {lag:.0f} ± {std:.0f} ms late",
        ]
        if not self.converged:
            parts.append("not converged: do not use")
        elif self.misfit > 1:
            parts.append(
                f"sensors' constants are improbable: bands {self.misfit:.1f} times as wide"
            )
        return "; ".join(parts)

    @property
    def gusts(self) -> tuple[float, float]:
        """Intensity of the gusts of the first flight [m/s], and the length [m] over which they fall to 1/e."""
        variances, _ = self._gust_variances(0)
        share, slow = self.noise["fast_h"] ** 2, self.noise["time_h"]
        times = np.geomspace(0.01, 10.0, 500) * slow
        correlation = np.exp(-times / slow) + share * np.exp(-times / slow / self.noise["faster_h"])
        time = times[np.argmax(correlation < (1 + share) * np.exp(-1.0))]
        return float(np.sqrt(np.mean(variances))), float(time * np.nanmean(self.air["airspeed"]))

    def slopes(
        self, coefficients: Sequence[str], regressors: Sequence[str]
    ) -> tuple[Matrix, Array]:
        """Return slopes (P, d) at the mean of alpha, NaN where there are none, and their errors (P, d, k).

        ``regressors`` are alpha, beta, p_hat, q_hat, r_hat and surfaces. An error is the sum of its
        last axis times independent standard normal numbers.
        """
        alpha, root = float(np.nanmean(self.air["alpha"])), eigen_root(self.covariance.to_numpy())
        errors = pd.DataFrame(root, index=self.derivatives.index)
        columns = pd.concat([self.derivatives["value"], errors], axis=1)
        out = np.full((len(coefficients), len(regressors), columns.shape[1]), np.nan)
        for i, C in enumerate(coefficients):
            for j, name in enumerate(regressors):
                term = f"{C}_{str(name).removesuffix(HAT)}"
                if term in columns.index and (str(name) not in RATES):
                    out[i, j] = columns.loc[term]
                if name == "alpha" and f"{C}_alpha2" in columns.index:
                    out[i, j] += 2 * alpha * columns.loc[f"{C}_alpha2"]
        return out[..., 0], np.nan_to_num(out[..., 1:])

    def gust_change(self, flight: int) -> float:
        """Return the change of the gusts of a flight in 1 s [m/s], root mean square of the axes; NaN if unknown."""
        return float(np.sqrt(np.mean(self._gust_variances(flight)[1])))

    def _gust_variances(self, flight: int) -> tuple[Vector, Vector]:
        """Return the variances of gusts north, east, down, and of their changes in 1 s."""
        noise = self.noise
        axes = [f"gust_{axis} {flight}" for axis in ("north", "east", "down")]
        slow = np.square([noise.get(name, np.nan) for name in axes])
        times = np.array([noise["time_h"], noise["time_h"], noise["time_v"]])
        fast = slow * np.square([noise["fast_h"], noise["fast_h"], noise["fast_v"]])
        faster = times * [noise["faster_h"], noise["faster_h"], noise["faster_v"]]
        changes = 2 * slow * -np.expm1(-1 / times) + 2 * fast * -np.expm1(-1 / faster)
        return slow + fast, changes


def estimate_air_motion(
    table: pd.DataFrame,
    aircraft: Aircraft,
    *,
    terms: Mapping[str, Sequence[str]] | None = None,
    thrust: str | None = "auto",
    known: AirMotion | None = None,
) -> AirMotion:
    r"""Estimate derivatives, gusts, wind and lag of the servos from flights with or without vanes.

    The filter-error method (Maine & Iliff 1981; Jategaonkar 2015, chapter 5). Coefficients are
    linear in derivatives :math:`\theta`; gusts are Gauss-Markov processes. With innovations
    :math:`e_k` of an extended Kalman filter, of covariance :math:`S_k`, and
    :math:`D_k = \partial e_k / \partial \theta` at given gains, the derivatives solve

    .. math:: \sum_k Z_k^T e_k + \Lambda (\theta - \theta_0) = 0, \quad
              Z_k = L_k^{-T} P (L_k^{-1} D_k), \quad S_k = L_k L_k^T,

    where P is the projection on the slopes D of a motion that the surfaces alone cause (instrumental
    variables; Soderstrom & Stoica 1989, chapter 8). Innovations of a filter with a wrong spectrum of
    gusts correlate with past gusts, and so with D, but hardly with this motion. An autopilot answers
    gusts: the part of the surfaces that past innovations explain is left out of it. Noises maximise the
    likelihood of the innovations. Priors :math:`\Lambda` are wide; they bound what a flight does
    not tell. The covariance is
    :math:`(Z^T D)^{-1} Z^T Z (D^T Z)^{-1}`, or its estimate from sums over blocks where that is
    larger, times the square of `AirMotion.misfit`, and 4 % of each derivative are added for what a
    linear model leaves out. All slopes by
    alpha, and all by beta, share an error of 2 % of the scale of the angle. Where surfaces hardly move
    a term, so that errors of path and sensors make most of its motion, ``std`` approaches ``prior_std``.

    Parameters
    ----------
    table : DataFrame
        Flights with time, p, q, r, ax, ay, az, phi, theta, psi, v_north, v_east, v_down, airspeed,
        density, surfaces (deflections or commands), thrust or what it follows from; ``flight``
        names them. alpha and beta are used where they are. SI, radians. Of flights of more than
        12,000 samples at 50 to 100 Hz, the first parts of the records are used.
    aircraft : Aircraft
    terms : mapping of str to sequence of str, optional
        Terms of CX ... Cn, of 0, alpha, alpha2, beta, p, q, r and surfaces.
    thrust : str or None, default="auto"
        As in `skdgp.dynamics.aerodynamic_coefficients`. Where it is None, or nothing gives it, the
        measured axial force takes the place of thrust and CX, whose derivatives are not estimated.
    known : AirMotion, optional
        Of other flights of the aircraft. Derivatives, lag of the servos and noise of the sensors
        are held at its values; winds, biases and gusts are those of the given flights.

    Returns
    -------
    AirMotion

    Raises
    ------
    ValueError
        If no record has 100 samples without a gap, or the estimate diverges.
    """
    check_aircraft(aircraft)
    check_columns(check_table(table), ["time", *NEEDED, "density"])
    check_radians(table, (*EULER, *RATES, "alpha", "beta"))
    if {*ELEVONS} <= {*table} and not {*MIXED} & {*table}:
        left, right = table[ELEVONS[0]], table[ELEVONS[1]]
        table = table.assign(elevator=(left + right) / 2, aileron=(left - right) / 2)
    surfaces = [name for name in SURFACES if has_values(table, name) and np.ptp(table[name]) > 0]
    if known is not None:
        surfaces = known.surfaces
    is_known = thrust is not None and (
        has_values(table, "thrust")
        or any(has_values(table, name) for name in THRUST_FORCES)
        or propeller_speed_of(aircraft.propeller, table) is not None
    )
    loads = np.concatenate(propulsive_loads(table, aircraft, thrust if is_known else None), axis=1)
    records = _records(table, surfaces, loads, FEWEST if known is None else 2)
    if not records:
        raise ValueError(
            f"Got no record of {FEWEST} samples without a gap, but expected one: give a longer flight."
        )
    if known is None:
        records = _shortened(records)
        derivatives = derivatives_of(TERMS if terms is None else terms, surfaces)
    else:
        derivatives = _posteriors(known.derivatives)
    if not is_known:
        records = [record.with_axial_force(aircraft.mass) for record in records]
        derivatives = {k: v for k, v in derivatives.items() if not k.startswith("CX_")}
    for n_before in ATTEMPTS:
        with contextlib.suppress(np.linalg.LinAlgError):
            return _Fit(records, aircraft, surfaces, derivatives, known).run(len(table), n_before)
    raise ValueError(DIVERGED)


def _posteriors(estimates: pd.DataFrame) -> Prior:
    """Return value and standard deviation of estimates by name."""
    return {str(name): (row["value"], row["std"]) for name, row in estimates.iterrows()}


def _records(table: pd.DataFrame, surfaces: list[str], loads: Matrix, fewest: int) -> list[Record]:
    """Return the records of a table with propulsive ``loads`` (n, 6), and paths that need no aerodynamics."""
    given = np.column_stack([numeric(table, [*surfaces, "density"]), loads])
    vanes = table.reindex(columns=list(AIR_DATA)).to_numpy(float)
    records = []
    for flight, (_, rows, log) in enumerate(flight_logs(table)):
        # over the ground, without air data; lags of GPS and attitude and biases are removed
        log = log._replace(air=np.full((len(log.time), 3), np.nan))
        learn = NOISE.keys() - {*AIR_DATA}
        path = estimate(log, NOISE | GUSTS, learn=learn, free=PATH_CONSTANTS).path
        to_body = np.swapaxes(path.attitude.as_matrix(), 1, 2)
        velocity = (to_body @ path.velocity[..., None])[..., 0]
        sensed = np.column_stack([path.force(log), path.rate(log), vanes[rows]])
        known = interpolate_missing(log.time, given[rows])
        inputs = Inputs(known[:, :-7], known[:, -6:], known[:, -7])
        for at in (part for part in log.segments() if len(part) >= fewest):
            stride = max(1, int((len(at) - 1) / np.ptp(log.time[at]) / RATE + 1e-6))
            part = slice(at[0], at[-1] + 1, stride)
            records.append(
                Record(
                    flight,
                    rows[part],
                    np.diff(log.time[part]),
                    velocity[part],
                    to_body[part],
                    sensed[part],
                    inputs.part(part),
                )
            )
    return records


def _shortened(records: list[Record]) -> list[Record]:
    """Return the first part of each record, `MOST` samples together."""
    share = MOST / sum(len(record.rows) for record in records)
    return [record.first(max(FEWEST, int(share * len(record.rows)))) for record in records]


def prior_deviations(coefficients: Sequence[str], regressors: Sequence[str]) -> Matrix:
    """Return prior standard deviations (P, d) of derivatives, NaN where `TERMS` has none."""
    stds = {name: std for name, (_, std) in derivatives_of(TERMS, SURFACES).items()}
    names = [str(name).removesuffix(HAT) for name in regressors]
    return np.array([[stds.get(f"{C}_{name}", np.nan) for name in names] for C in coefficients])


class _Sums(NamedTuple):
    """Score and information of the parameters, and what else one pass shows."""

    score: Vector
    information: Matrix
    scatter: Matrix  # covariance of the score
    blocks: Matrix  # (b, p) scores summed over blocks
    passes: list[Pass]
    parts: list[Linearisation]  # from which the noises are estimated


class _Fit:
    """Passes of the filter over the records, in turn with steps of the parameters."""

    def __init__(
        self,
        records: list[Record],
        aircraft: Aircraft,
        surfaces: list[str],
        derivatives: Prior,
        known: AirMotion | None,
    ) -> None:
        self.records, self.aircraft, self.known = records, aircraft, known
        self.surfaces = surfaces
        n_flights = 1 + max(record.flight for record in records)
        self.layout = Layout.of(list(derivatives), surfaces)
        shared, noises = dict(SHARED), SHARED_NOISES
        if not any(name.startswith("CX_") for name in derivatives):  # thrust is a measured force
            shared["thrust_scale"] = (0.0, 1e-6)
        if known is not None:
            shared = dict(_posteriors(known.constants.loc[list(SHARED)]))
            noises = {name: (known.noise[name], 1.0) for name in SHARED_NOISES}
        self.parameters = Parameters.of(dict(derivatives) | dict(shared), OWN, n_flights)
        self.noises = Parameters.of(noises, OWN_NOISES, n_flights)
        self.n_held = 0 if known is None else len(derivatives) + len(shared)
        self.n_held_noises = 0 if known is None else len(noises)
        self.log_noises = np.log(self.noises.mean)
        self.x, self.psi = self.parameters.mean.copy(), self.log_noises.copy()
        for names, sensors in ((("ax", "ay", "az"), slice(0, 3)), (("gyro",), slice(3, 6))):
            at = [self.noises.names.index(name) for name in names]
            if known is None:
                self.log_noises[at] = self.psi[at] = np.log(_white_noise(records, sensors))
        self.noise_moves, self.limits = np.zeros((2, len(self.psi)))
        self.limits += LARGEST_LOG
        # of measured rates, without gusts
        before = ((0, 0), (TURN.start, 0))
        self.states = [np.pad(record.measured[:, 3:6], before) for record in records]
        self._start()

    def run(self, n_rows: int, n_before: int) -> AirMotion:
        """Return the estimate, for a table of ``n_rows``."""
        damping, small, converged = DAMPING, False, False
        free = slice(self.n_held, None)
        share, last = 1.0, np.zeros(len(self.x) - self.n_held)
        for number in range(MAX_PASSES):
            sums = self._pass(number >= n_before)
            self.states = [run.filtered for run in sums.passes]
            information = sums.information[free, free]
            damped = information + damping * np.diag(np.diag(information))
            step = self._step(damped, sums.score[free])
            if not np.isfinite(step).all():
                raise np.linalg.LinAlgError
            turns_back = step @ damped @ last < 0  # two solutions could follow each other for ever
            share = max(SHORTER * share, LEAST_SHARE) if turns_back else min(LONGER * share, 1.0)
            self.x[free] += share * step
            last = step
            settled = self._noise_step(sums.parts) if number else np.inf
            before, small = small, bool(step @ information @ step < TOLERANCE)
            converged = before and small and settled < NOISE_TOLERANCE
            if converged and number > n_before:
                break
            damping /= 4
        # errors of the path are as small as attitude and GPS make them
        at = [k for k, name in enumerate(self.noises.names) if name.startswith("path_")]
        is_plausible = bool(np.all(np.exp(self.psi[at]) < LARGEST_PATH))
        return self._result(self._pass(), converged and is_plausible, n_rows)

    def _step(self, information: Matrix, score: Vector) -> Vector:
        """Return the step of the parameters that are not held, with a lag that stays at or above zero."""
        lag = self.parameters.names.index("servo_lag")
        step = np.asarray(-np.linalg.solve(information, score), dtype=float)
        at = lag - self.n_held
        if at >= 0 and self.x[lag] + step[at] < 0:
            others = np.arange(len(step)) != at
            step[at] = -self.x[lag]
            rest = score[others] + information[others, at] * step[at]
            step[others] = -np.linalg.solve(information[np.ix_(others, others)], rest)
        return step

    def linearised(self, record: Record, states: Matrix) -> Linearisation:
        """Return the filter's linearisation at the parameters."""
        value = self.parameters.values(self.x, record.flight)
        decay = self.noise(self.psi, record).decay
        return linearised(record, self.layout, self.aircraft, value, states, decay)

    def noise(self, psi: Array, record: Record):
        """Return the noises of a record at logarithms (..., p)."""
        return noise(self.noises.values(np.exp(psi), record.flight), record.sampled)

    def _start(self) -> None:
        """Set the wind by the airspeed, and derivatives that are not held by least squares."""
        self.gust_variances = []
        for flight, places in enumerate(self.parameters.places):
            own = [record for record in self.records if record.flight == flight]
            at = places[[self.parameters.local_names.index(name) for name in PITOT]]
            pitot, variance = _steady_wind(own)
            self.gust_variances.append(variance)
            self.x[at[1:]] = pitot[1:]
        if self.known is None:
            self._start_derivatives()

    def _start_derivatives(self) -> None:
        """Set derivatives by least squares, but slopes by alpha and beta.

        In gusts, alpha and beta of the path in steady wind are too noisy for least squares.
        """
        pairs = [self._regression(record) for record in self.records]
        X, C = (np.concatenate(part) for part in zip(*pairs, strict=True))
        rows, columns = self.layout.rows, self.layout.columns
        by_air = np.isin(columns, [STATE_TERMS.index(name) for name in ("alpha", "beta")])
        for row in range(6):
            given = np.flatnonzero((rows == row) & by_air)
            free = np.setdiff1d(np.flatnonzero(rows == row), given)
            if not len(free):
                continue
            rest = C[:, row] - X[:, columns[given]] @ self.x[given]
            self.x[free] = np.linalg.lstsq(X[:, columns[free]], rest, rcond=None)[0]

    def _regression(self, record: Record) -> tuple[Matrix, Matrix]:
        """Return terms (n, k) and coefficients (n, 6) in steady wind."""
        value = self.parameters.values(self.x, record.flight)
        air, _ = air_velocity(record, value, np.zeros((len(record.rows), N_STATES)))
        rates = record.measured[:, 3:6]
        width = 2 * round(0.05 / np.median(record.step)) + 1
        smooth = uniform_filter1d(rates, width, axis=0, mode="nearest")
        spin = np.gradient(smooth, np.append(0.0, np.cumsum(record.step)), axis=0)
        aircraft, thrust = self.aircraft, record.inputs.thrust
        moment = spin @ aircraft.inertia + cross(rates, rates @ aircraft.inertia) - thrust[:, 3:]
        force = record.measured[:, :3] * aircraft.mass - thrust[:, :3]
        pressure = 0.5 * record.inputs.density * np.sum(air**2, axis=1)
        loads = np.concatenate([force, moment / aircraft.moment_lengths], axis=1)
        C = loads / (pressure * aircraft.wing_area)[:, None]
        model = self.layout.model(aircraft, value)
        return model.terms(air, rates, record.inputs.surfaces), C

    def _add_mean_lift(self, record: Record, information: Matrix, score: Vector) -> None:
        """Add that the mean lift of a record is that of steady wind, but for a mean vertical gust.

        Alpha shows in forces alone, so that its mean and CZ_0 would not be told apart.
        """
        X, C = self._regression(record)
        lift = np.flatnonzero(self.layout.rows == COEFFICIENTS.index("CZ"))
        row = X.mean(axis=0)[self.layout.columns[lift]]
        slope = LIFT_SLOPE * MEAN_GUST / np.linalg.norm(record.velocity, axis=1).mean()
        information[np.ix_(lift, lift)] += np.outer(row, row) / slope**2
        score[lift] += row * (row @ self.x[lift] - C[:, 2].mean()) / slope**2

    def _add_airspeed(self, record: Record, information: Matrix, score: Vector) -> None:
        """Add that airspeed is the speed over the ground less a steady wind, but for gusts and the pitot's scale.

        Turns tell wind and scale, without coefficients or attitudes, and instruments hardly show them.
        """
        names = self.parameters.local_names
        at = self.parameters.places[record.flight][[names.index(name) for name in PITOT]]
        slopes, excess = _airspeed_error(record, self.x[at])
        variance = self.gust_variances[record.flight]
        information[np.ix_(at, at)] += slopes.T @ slopes / variance
        score[at] += slopes.T @ excess / variance

    def _pass(self, by_instruments: bool = True) -> _Sums:
        """Return score and information of the parameters, with those of the prior."""
        p = len(self.x)
        precision = self.parameters.std**-2.0
        information, score = np.diag(precision), (self.x - self.parameters.mean) * precision
        blocks, passes, parts = [], [], []
        for record in self.records if self.known is None else ():
            self._add_mean_lift(record, information, score)
            self._add_airspeed(record, information, score)
        scatter = information.copy()
        for j, (record, before) in enumerate(zip(self.records, self.states, strict=True)):
            at = self.parameters.places[record.flight]
            linear = self.linearised(record, before)
            run = filtered(linear, self.noise(self.psi, record))
            whitener = np.linalg.inv(np.linalg.cholesky(run.covariance))
            e = (whitener @ run.innovation[..., None])[..., 0]
            slopes = whitener @ innovation_slopes(linear, run)
            D = slopes[:, :, np.flatnonzero(at >= self.n_held)]
            at = at[at >= self.n_held]
            Z = D
            if self.known is None and by_instruments:
                Z = _projected(D, slopes[:, :, len(self.layout.rows) :])
                self.records[j] = record.with_answers(e)  # for the next pass
            information[np.ix_(at, at)] += np.tensordot(Z, D, axes=((0, 1), (0, 1)))
            scatter[np.ix_(at, at)] += np.tensordot(Z, Z, axes=((0, 1), (0, 1)))
            scores = np.einsum("nmk,nm->nk", Z, e)
            score[at] += scores.sum(axis=0)
            number = np.arange(len(scores)) // max(round(BLOCK / np.median(record.step)), 1)
            sums = np.zeros((number[-1] + 1, p))
            for k, place in enumerate(at):
                sums[:, place] = np.bincount(number, scores[:, k])
            blocks.append(sums)
            passes.append(run)
            parts.append(_middle(linear, NOISE_SAMPLES))
        return _Sums(score, information, scatter, np.concatenate(blocks), passes, parts)

    def _noise_step(self, parts: list[Linearisation]) -> float:
        """Move the logarithms of the noises by a step of Fisher scoring; return its squared length."""
        precision, held = self.noises.std**-2.0, self.n_held_noises
        information, score = np.diag(precision), (self.psi - self.log_noises) * precision
        for record, linear in zip(self.records, parts, strict=True):
            at = self.noises.places[record.flight]
            at = at[at >= held]
            sets = np.tile(self.psi, (len(at) + 1, 1))
            sets[np.arange(1, len(at) + 1), at] += LOG_MOVE
            run = filtered(linear, self.noise(sets, record), keep=False)
            weight = len(record.step) / len(linear.step)
            slope, square = _likelihood_slopes(run)
            score[at] += weight * slope
            information[np.ix_(at, at)] += weight * square
        information, score = information[held:, held:], score[held:]
        step = -np.linalg.solve(information + 0.02 * np.diag(np.diag(information)), score)
        back = step * self.noise_moves[held:] < 0
        limit = self.limits[held:] * np.where(back, 0.5, 1.3)  # noises near zero overshoot
        self.limits[held:] = limit = np.minimum(limit, LARGEST_LOG)
        self.noise_moves[held:] = step = np.clip(step, -limit, limit)
        self.psi[held:] += step
        return float(step @ information @ step)

    def _result(self, sums: _Sums, converged: bool, n_rows: int) -> AirMotion:
        nd, prior = len(self.layout.rows), self.parameters.std
        off = self.x - self.parameters.mean
        covariance = np.diag(prior**2) + np.outer(off, off)
        misfit = 1.0
        if converged:
            covariance = _covariance(sums)
        if converged and self.known is None:
            improbable = [name.split()[0] in SENSOR_CONSTANTS for name in self.parameters.names]
            misfit = max(1.0, float(np.sqrt(np.mean((off / prior)[improbable] ** 2))))
            covariance *= misfit**2
            covariance[:nd, :nd] += np.diag((MODEL_ERROR * self.x[:nd]) ** 2)
            for vane in ("alpha", "beta"):
                if not any(record.sampled[BIASES[f"{vane}_bias"]] for record in self.records):
                    is_slope = self.layout.columns == STATE_TERMS.index(vane)
                    scaled = ANGLE_ERROR * is_slope * self.x[:nd]
                    covariance[:nd, :nd] += np.outer(scaled, scaled)
        air = self._air(sums, covariance, n_rows)
        if converged and self.known is None:
            share = np.zeros(len(prior))
            share[:nd] = self._unmoved()
            kept = np.sqrt(1 - share**2)
            covariance = kept[:, None] * covariance * kept + np.diag((share * prior) ** 2)
        columns = {"value": self.x, "std": np.sqrt(np.diag(covariance))}
        if self.known is None:
            columns["std"][self.parameters.names.index("servo_lag")] += LAG_ERROR * float(
                np.median(self.records[0].step)
            )
        columns["prior_std"] = self.parameters.std
        estimates = pd.DataFrame(columns, index=self.parameters.names)
        names = self.parameters.names[:nd]
        shown = pd.DataFrame(covariance[:nd, :nd], index=names, columns=names)
        noises = dict(zip(self.noises.names, np.exp(self.psi).tolist(), strict=True))
        seconds = float(sum(record.step.sum() for record in self.records))
        found = estimates[:nd], shown, estimates[nd:], noises, air, self.surfaces
        return AirMotion(*found, converged, seconds, misfit)

    def _unmoved(self) -> Vector:
        """Return the share (p,) of errors of path and sensors in the variance of each derivative's term.

        One where surfaces do not move the term: an error then looks like motion.
        """
        pairs = zip(self.records, self.states, strict=True)
        moved = [self.linearised(record, states).response for record, states in pairs]
        variance = np.concatenate([motion - motion.mean(axis=0) for motion in moved]).var(axis=0)
        speed = np.linalg.norm(np.concatenate([r.velocity for r in self.records]), axis=1).mean()
        angle, rate = ERROR_VELOCITY / speed, ERROR_RATE / (2 * speed)
        span, chord = self.aircraft.span, self.aircraft.chord
        error = np.full(len(variance), ERROR_SURFACE)
        error[: len(STATE_TERMS)] = 0.0, angle, 0.0, angle, rate * span, rate * chord, rate * span
        share = error**2 / np.maximum(error**2 + variance, TINY)
        share[STATE_TERMS.index("alpha2")] = share[STATE_TERMS.index("alpha")]
        return share[self.layout.columns]

    def _air(self, sums: _Sums, covariance: Matrix, n_rows: int) -> pd.DataFrame:
        """Return the smoothed motion through the air, with standard deviations, in the rows of the table."""
        names, path = [*AIR_DATA, *RATES, *WIND], [*SPECIFIC_FORCE, *EULER, *EARTH_VELOCITY]
        out = np.full((n_rows, 27), np.nan)
        for record, before, run in zip(self.records, self.states, sums.passes, strict=True):
            linear = self.linearised(record, before)
            states, P = smoothed(linear, run)
            value = self.parameters.values(self.x, record.flight)
            velocity, by_state = air_velocity(record, value, states)
            slopes = np.zeros((len(states), 9, N_STATES))
            slopes[:, :3] = air_data_slopes(velocity) @ by_state
            slopes[:, 3:6, TURN] = slopes[:, 6:, GUST] = slopes[:, 6:, FAST] = np.eye(3)
            wind = states[:, GUST] + states[:, FAST] + [value[name] for name in WINDS]
            out[record.rows, :9] = np.column_stack([*air_data(velocity), states[:, TURN], wind])
            variance = np.einsum("nij,njk,nik->ni", slopes, P, slopes)
            at = self.parameters.places[record.flight]
            shift = self._shift(record, linear, run, slopes, velocity)[:, :, : len(at)]
            variance += np.einsum("nij,jk,nik->ni", shift, covariance[np.ix_(at, at)], shift)
            out[record.rows, 9:18] = np.sqrt(variance)
            earth = np.swapaxes(record.attitude, 1, 2)
            angles = Rotation.from_matrix(earth).as_euler("ZYX")[:, ::-1]
            ground = record.earth_velocity()
            force = record.measured[:, :3].copy()
            if not record.sampled[0]:
                force[:, 0] = record.inputs.thrust[:, 0] / self.aircraft.mass
            out[record.rows, 18:] = np.column_stack([force, angles, ground])
        return pd.DataFrame(out, columns=[*names, *(f"{name}_std" for name in names), *path])

    def _shift(
        self, record: Record, linear: Linearisation, run: Pass, slopes: Array, velocity: Matrix
    ) -> Array:
        """Return d (air data, rates, wind) / d parameters (n, 9, k), as of the filtered states."""
        wind, arm = self.layout.place(*WINDS), self.layout.place(*ARM)
        shift = slopes @ state_slopes(linear, run)
        by_air = air_data_slopes(velocity)
        shift[:, :3, wind] -= by_air @ record.attitude
        shift[:, :3, arm] -= by_air @ cross_matrix(record.measured[:, 3:6])
        shift[:, 6:, wind] += np.eye(3)
        return shift


def _white_noise(records: list[Record], sensors: slice) -> float:
    """Return the standard deviation of white noise of the quietest of some sensors, by third differences.

    Gusts shake one axis more than another; all have the same sensor.
    """
    differences = np.concatenate([np.diff(r.measured[:, sensors], 3, axis=0) for r in records])
    return float(max(np.sqrt(np.nanmin(np.mean(differences**2, axis=0)) / 20), LEAST_NOISE))


def _airspeed_error(record: Record, pitot: Vector) -> tuple[Matrix, Vector]:
    """Return the excess of airspeed in a steady wind over the measured one, and its derivatives by `PITOT`."""
    sampled = np.isfinite(record.measured[:, AIRSPEED])
    air = record.earth_velocity()[sampled] - [*pitot[1:], 0.0]
    speed = np.linalg.norm(air, axis=1)
    slopes = np.column_stack([speed, -(1 + pitot[0]) * air[:, :2] / speed[:, None]])
    return slopes, (1 + pitot[0]) * speed - record.measured[sampled, AIRSPEED]


def _steady_wind(records: list[Record]) -> tuple[Vector, float]:
    """Return `PITOT` of a flight by least squares of its airspeed, and the variance of a sample [m^2/s^2].

    Gusts correlate over seconds: a sample has the variance of a mean over `GUST_WINDOW`, times the
    samples of the mean, so that n samples tell as much as they do.
    """
    pitot = np.zeros(3)
    prior = np.diag([PITOT_NOISE / SHARED["airspeed_scale"][1], 0.1, 0.1])
    for _ in range(5):
        pairs = [_airspeed_error(record, pitot) for record in records]
        slopes, excess = (np.concatenate(part) for part in zip(*pairs, strict=True))
        rows, rest = np.vstack([slopes, prior]), np.concatenate([excess, prior @ pitot])
        pitot = pitot - np.linalg.lstsq(rows, rest, rcond=None)[0]
    if not len(excess):
        return pitot, PITOT_STD**2
    seconds = sum(float(record.step.sum()) for record in records)
    width = max(1, int(len(excess) * min(GUST_WINDOW / seconds, 0.25)))
    means = uniform_filter1d(excess, width, mode="nearest")
    return pitot, max(width * float(means.var()), float(excess.var()), PITOT_STD**2)


def _middle(linear: Linearisation, n_samples: int) -> Linearisation:
    """Return the linearisation of ``n_samples`` in the middle."""
    n = len(linear.step)
    first = max(n - n_samples, 0) // 2
    # there is a state more than steps
    return Linearisation(*(part[first : first + n_samples + len(part) - n] for part in linear))


def _likelihood_slopes(run: Pass) -> tuple[Vector, Matrix]:
    """Return gradient and Fisher information of -log likelihood, by differences of the sets to the first."""
    whitener = np.linalg.inv(np.linalg.cholesky(run.covariance[0]))
    e = (whitener @ run.innovation[0][..., None])[..., 0]
    gradient, changes = [], []
    for innovation, covariance in zip(run.innovation[1:], run.covariance[1:], strict=True):
        d = (whitener @ ((innovation - run.innovation[0]) / LOG_MOVE)[..., None])[..., 0]
        V = whitener @ ((covariance - run.covariance[0]) / LOG_MOVE) @ np.swapaxes(whitener, 1, 2)
        trace = np.einsum("nii->", V) - np.einsum("ni,nij,nj->", e, V, e)
        gradient.append(np.sum(d * e) + 0.5 * trace)
        changes.append(np.concatenate([d.ravel(), np.sqrt(0.5) * V.ravel()]))
    rows = np.array(changes)
    return np.array(gradient), rows @ rows.T


def _projected(slopes: Array, instruments: Array) -> Array:
    """Return slopes (n, m, p) projected on instruments (n, m, q)."""
    rows = instruments.reshape(-1, instruments.shape[2])
    size = np.linalg.norm(rows, axis=0)
    U, s, _ = np.linalg.svd(rows[:, size > 0] / size[size > 0], full_matrices=False)
    U = U[:, s > LEAST_DIRECTION * s[0]]
    return (U @ (U.T @ slopes.reshape(len(U), -1))).reshape(slopes.shape)


def _covariance(sums: _Sums) -> Matrix:
    """Return the covariance of the parameters, in sandwich form over blocks where its variance is larger.

    Scores of neighbouring blocks may be correlated (Newey & West 1987).
    """
    inverse = np.linalg.inv(sums.information)
    covariance = inverse @ sums.scatter @ inverse.T
    later = sums.blocks[1:].T @ sums.blocks[:-1]
    scatter = sums.blocks.T @ sums.blocks + 0.5 * (later + later.T)
    robust = np.diag(inverse @ scatter @ inverse.T)
    scale = np.sqrt(np.maximum(robust / np.diag(covariance), 1.0))
    return scale[:, None] * covariance * scale
