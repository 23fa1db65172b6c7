"""The example flights of a simulated UAV with known truth: aircraft, sensors, simulation and tables."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.utils import Bunch, check_random_state

from skdgp._compute.files import read_toml
from skdgp._compute.messages import Progress, notify
from skdgp._compute.sklearn_compat import Interval, validate_params
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import (
    COEFFICIENTS,
    EARTH_VELOCITY,
    EULER,
    HAT,
    RATE_LENGTHS,
    RATES,
    SPECIFIC_FORCE,
    THRUST_FORCES,
    THRUST_MOMENTS,
    TRUTH_SUFFIX,
    WIND,
)
from skdgp._flight.excitation import Steps, Wavetrain, doublet, multisine, three_two_one_one
from skdgp._flight.frames import STANDARD_GRAVITY, wrapped
from skdgp._flight.tables import by_name
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    Instant,
    LocalAir,
    Motion,
    Trajectories,
    Turbulence,
    air_velocity,
    channels,
    dryden_gusts,
    euler_to_quaternion,
    fly_record,
    gusty_air,
    ned_to_body,
    propeller_loads,
)

# -- the aircraft and its true aerodynamics

# Columns of the regressors: angles [rad]; rates times b/2V (p, r, beta_dot) or c/2V (q, alpha_dot)
REGRESSORS = ("alpha", "beta", *RATES, "alpha_dot", "beta_dot", "elevator", "aileron", "rudder")

FILE = Path(__file__).with_name("brumby.toml")
BRUMBY = Aircraft.from_file(FILE)
PROPELLER: Any = BRUMBY.propeller


def brumby_coefficients(regressors: ArrayLike) -> Array:
    r"""Return CX CY CZ Cl Cm Cn, (..., 6), of `REGRESSORS` (..., 10); rates are relative to the air.

    The parts, with :math:`s = \sin\alpha`:

    wing
        Polhamus' leading-edge suction analogy (NASA TN D-3767, 1966): potential and vortex normal
        force :math:`K_p\, s \cos\alpha` and :math:`K_v\, s |s|`, the vortex breaking down near 18
        degrees; each acts at its own station, so Cm bends with alpha. The remaining suction
        increases CX.
    heave
        Normal force of q and alpha_dot, half a chord behind the centre of gravity.
    elevons
        Each one's force saturates with ITS deflection, left = elevator + aileron and right =
        elevator - aileron: the two commands couple. Drag of left and right differ, so aileron yaws.
    fin
        Force of the local sideslip (beta, roll and yaw rates, sidewash lag) and of the rudder,
        fading as the wing shades the fin at alpha; its arm turns it into Cl and Cn.
    wing and body in sideslip
        Dihedral effect, roll due to yaw and yaw due to roll grow with wing normal force; roll
        damping falls.

    Analytic in every argument: complex steps give exact derivatives.
    """
    columns = np.moveaxis(np.asarray(regressors), -1, 0)
    alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder = columns
    s = np.sin(alpha)
    beta2 = beta * beta
    # fraction of the vortex not broken down
    beyond = (alpha - 0.32) / 0.04
    ordered = 1.0 / (1.0 + np.exp(beyond))

    head_on = 1.0 - beta2
    potential = 2.7 * s * np.cos(alpha) * head_on
    # s |s|, without its bend at zero
    signed_square = s * np.sqrt(s * s + 1e-4)
    vortex = 3.0 * signed_square * ordered * head_on
    suction = 1.5 * s * s * ordered * head_on
    wing = potential + vortex
    plunge = 1.9 * q + 0.6 * alpha_dot
    heave = plunge * (0.5 + 0.5 * ordered)
    lift_left, drag_left = _elevon(elevator + aileron, s)
    lift_right, drag_right = _elevon(elevator - aileron, s)
    elevons = 0.36 * (lift_left + lift_right)
    drag_of_elevons = 0.5 * (drag_left + drag_right)
    drag = drag_of_elevons + 0.07 * rudder * rudder + 0.05 * beta2
    sidewash = beta + 0.14 * p - 0.68 * r + 0.15 * beta_dot
    fin = _fin(sidewash, rudder, s)

    CX = -0.026 + suction - drag
    side_force = (0.20 + 1.5 * beta2) * beta
    CY = fin - side_force + 0.06 * p
    CZ = -(wing + heave + elevons)
    roll_by_elevons = 0.075 * (lift_left - lift_right)
    Cl = 0.07 * fin + roll_by_elevons + _roll_in_sideslip(beta, p, r, s, wing)
    pitch_by_wing = -0.055 * potential - 0.10 * vortex
    Cm = 0.0085 + pitch_by_wing - 0.50 * heave - 0.44 * elevons + 0.06 * beta2
    yaw_by_elevons = -0.10 * (drag_left - drag_right)
    Cn = -0.34 * fin + yaw_by_elevons + _yaw_in_sideslip(beta, p, r, s, wing)
    return np.stack((CX, CY, CZ, Cl, Cm, Cn), axis=-1)


def _elevon(deflection: Array, s: Array) -> tuple[Array, Array]:
    """Return lift and drag of an elevon at the sine of alpha."""
    lift = _soft(deflection, 0.28) * (1.0 - 2.0 * s * s)
    drag = deflection * (0.16 * deflection + 0.30 * s)
    return lift, drag


def _fin(sidewash: Array, rudder: Array, s: Array) -> Array:
    """Return the side force of the fin and the rudder."""
    shade = 1.0 - 1.2 * s
    force = 0.13 * _soft(rudder, 0.30) - 0.26 * _soft(sidewash, 0.30)
    return force * shade


def _roll_in_sideslip(beta: Array, p: Array, r: Array, s: Array, wing: Array) -> Array:
    """Return the roll moment of wing and body, without the fin."""
    dihedral = 0.015 + 0.17 * wing
    damping = 0.24 - 0.35 * s
    by_yaw = 0.02 + 0.20 * wing
    return by_yaw * r - dihedral * beta - damping * p


def _yaw_in_sideslip(beta: Array, p: Array, r: Array, s: Array, wing: Array) -> Array:
    """Return the yaw moment of wing and body, without the fin."""
    stability = 0.018 - 0.05 * s
    by_roll = 0.01 + 0.10 * wing
    damping = 0.02 + 0.08 * wing * wing
    return -stability * beta - by_roll * p - damping * r


def _soft(angle: Array, limit: float) -> Array:
    """Return the angle, softly saturated: slope 1 at zero, never beyond the limit [rad]."""
    return angle / np.sqrt(1.0 + (angle / limit) ** 2)


BRUMBY_AERODYNAMICS = Aerodynamics(
    brumby_coefficients, [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
)
"""The same as a model of an aircraft, with the names of non-dimensional rates."""


# -- the flights

# of each flight [s]
DURATION = 180.0
TEST_FLIGHT = "two_altitudes"


# Simulation of the flights, chosen: between autopilot commands, integration steps and log rows [s]
STEP = 0.025
# flown before the log begins, so that it does not open with the transients of a guessed trim [s]
SETTLING = 8.0
# height of the ground, above which turbulence scales [m]
FIELD_ELEVATION = 60.0
# at which the gusts are crossed [m/s]
AIRSPEED = 36.0
# between two notes of the progress
STEPS_TOLD = 100
# of the fixed point of alpha_dot and beta_dot in the truth; each brings it 70 times nearer
PASSES = 8
DEGREE = np.pi / 180.0
# Standard deviations in SI units, of small UAV sensors: pitot tube and vanes, MEMS inertial unit,
# GPS
SENSOR_NOISE = {
    "airspeed": 0.3,
    "alpha": 0.3 * DEGREE,
    "beta": 0.3 * DEGREE,
    **dict.fromkeys(RATES, 0.002),
    **dict.fromkeys(SPECIFIC_FORCE, 0.05),
    **dict.fromkeys(EULER, 0.3 * DEGREE),
    **dict.fromkeys(("north", "east"), 0.5),
    **dict.fromkeys(EARTH_VELOCITY, 0.1),
}
DESCR = files("skdgp.datasets").joinpath("example_flights.rst").read_text(encoding="utf-8")
FACTOR = [Interval(Real, 0, None, closed="left")]


@validate_params(
    {
        "random_state": ["random_state"],
        "turbulence": FACTOR,
        "sensor_noise": FACTOR,
        "duration": [Interval(Real, 1, None, closed="left")],
    },
    prefer_skip_nested_validation=True,
)
def load_example_flights(
    *,
    random_state: Seed = 0,
    turbulence: float = 1.0,
    sensor_noise: float = 1.0,
    duration: float = DURATION,
) -> Bunch:
    """Return training and test flights of a simulated delta-wing UAV with known truth.

    `skdgp.dynamics` flies them, about 8 s at the first call, kept for later calls in the same
    process. The aircraft, its equations and the manoeuvres are described in
    docs/api/skdgp.datasets.md.

    Parameters
    ----------
    random_state : int, RandomState or None, default=0
        Seed of gusts and sensor noise. The same integer gives the same flights.
    turbulence : float, default=1.0
        Multiplies the gusts; 0 is calm air in the same steady wind.
    sensor_noise : float, default=1.0
        Multiplies the sensors' noise; 0 makes every sensor perfect.
    duration : float, default=180.0
        Length of each flight [s]. A shorter flight is the beginning of a longer one.

    Returns
    -------
    Bunch
        ``train``: two flights of 180 s at 40 Hz, a DataFrame (14400, 70) whose column ``flight``
        tells them apart and serves as ``groups`` of a cross-validation; ``test``: one flight along
        another path, at two altitudes, in stronger turbulence, (7200, 70); ``aircraft``;
        ``aerodynamics``: the true model, a function of regressors (..., 10) to CX CY CZ Cl Cm Cn
        (..., 6); its ``regressor_names`` (rates are relative to the air and non-dimensional);
        ``truth``: the same as an `Aerodynamics`, for `simulate`, `trim` and `linearize`; ``DESCR``,
        a text.

    Examples
    --------
    >>> from skdgp.datasets import load_example_flights
    >>> data = load_example_flights(duration=10.0)
    >>> data.train.groupby("flight", observed=True)["airspeed_true"].mean().round()
    flight
    lateral    35.0
    latlon     36.0
    Name: airspeed_true, dtype: float64
    >>> data.aircraft
    Aircraft('brumby', 45 kg, S 2.59 m^2, b 2.8 m, c 1.09 m)
    """
    seed: Any = random_state
    if not isinstance(seed, int | np.integer):
        seed = check_random_state(seed).randint(np.iinfo(np.int32).max)
    train, test = _flights(int(seed), float(turbulence), float(sensor_noise), float(duration))
    return Bunch(
        train=train.copy(),
        test=test.copy(),
        aircraft=BRUMBY,
        aerodynamics=brumby_coefficients,
        regressor_names=list(REGRESSORS),
        truth=BRUMBY_AERODYNAMICS,
        DESCR=DESCR,
    )


@lru_cache(maxsize=4)
def _flights(
    seed: int, turbulence: float, sensor_noise: float, duration: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return the tables of training and test."""
    seeds = np.random.SeedSequence(seed).spawn(1 + len(FLIGHT_PLANS))
    gust_seed, *sensor_seeds = seeds
    rng = np.random.default_rng(gust_seed)
    record, instant = fly_plans(FLIGHT_PLANS, duration, turbulence, rng)
    logs = flight_logs(record, instant, sensor_noise, sensor_seeds)
    tables = {}
    for plan, log in zip(FLIGHT_PLANS, logs, strict=True):
        log.insert(1, "flight", plan.name)
        tables[plan.name] = log
    test = tables.pop(TEST_FLIGHT)
    train = pd.concat(tables.values(), ignore_index=True)
    kinds = {"flight": "category"}
    return train.astype(kinds), test.astype(kinds)


def flight_logs(
    record: Trajectories, instant: Instant, sensor_noise: float, seeds: Sequence[Any]
) -> list[pd.DataFrame]:
    """Return the log of each flight of `fly_plans`, measured columns and truth, with a seed of its sensors."""
    logged, true = _columns(record, instant)
    logs = []
    for k, seed in enumerate(seeds):
        exact = {name: values[:, k] for name, values in logged.items()}
        truth = pd.DataFrame({name: values[:, k] for name, values in true.items()})
        truth = truth.add_suffix(TRUTH_SUFFIX)
        measured = measure(truth, sensor_noise, np.random.default_rng(seed))
        logs.append(pd.concat([pd.DataFrame(exact), measured, truth], axis=1))
    return logs


def _columns(record: Any, truth: Any) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the channels logged without noise, and the truth of measured ones: (n_times, n_flights) by name."""
    motion = channels(record.states, record.wind)
    propeller_speed = record.controls["propeller_speed"]
    forces, moments = propeller_loads(BRUMBY, propeller_speed, motion["airspeed"], truth.density)
    shape = truth.density.shape
    logged = {
        "time": np.broadcast_to(record.time[:, None], shape),
        "altitude": motion["altitude"],
        "density": truth.density,
        **record.controls,
        **by_name(THRUST_FORCES, forces),
        **by_name(THRUST_MOMENTS, moments),
    }
    rate_derivatives = truth.derivative[..., -len(RATES) :]
    true = {
        **motion,
        "psi": motion["psi"] % (2.0 * np.pi),
        **by_name(("alpha_dot", "beta_dot"), truth.implicit),
        **by_name(("p_dot", "q_dot", "r_dot"), rate_derivatives),
        **by_name(SPECIFIC_FORCE, truth.force / BRUMBY.mass),
        **by_name(WIND, record.wind),
        **by_name(COEFFICIENTS, truth.coefficients),
    }
    return logged, true


def measure(truth: pd.DataFrame, scale: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return one measured column per name of `SENSOR_NOISE`, from the column of ``truth`` that ends in ``_true``.

    Noise is white and independent from channel to channel, with ``scale`` times the stated standard
    deviations.
    """
    names = list(SENSOR_NOISE)
    exact = truth.rename(columns=lambda name: name.removesuffix(TRUTH_SUFFIX))[names]
    std = scale * np.array(list(SENSOR_NOISE.values()))
    return exact + std * rng.standard_normal(exact.shape)


def fly_plans(
    plans: tuple[FlightPlan, ...], duration: float, turbulence: float, rng: np.random.Generator
) -> tuple[Trajectories, Instant]:
    """Return the flights of ``plans``, ``duration`` [s] each, and what acted, the fixed point of the slopes converged.

    ``turbulence`` multiplies the gusts; the random numbers behind them do not depend on it.
    """
    n_settling = round(SETTLING / STEP)
    n_times = round((SETTLING + duration) / STEP)
    time = np.arange(n_times) * STEP - SETTLING
    wind = np.array([plan.wind for plan in plans])
    gusts = _gusts(plans, 2 * n_times + 1, turbulence, rng)
    air = gusty_air(lambda stage, state: LocalAir(wind), gusts)
    # in the steps alpha_dot and beta_dot lag by one evaluation
    motion = Motion(BRUMBY_AERODYNAMICS, BRUMBY, lagged=True)
    controls = FlightControls(plans, time, STEP)
    states = _initial_states(controls, wind)
    stages = 0.5 * STEP * np.arange(2 * n_times - 1, dtype=float)
    flown = fly_record(motion, controls, air, stages, states)
    states = flown.states[n_settling:]
    controls_set = {name: values[n_settling:] for name, values in flown.controls.items()}
    local_air = air(slice(2 * n_settling, 2 * n_times, 2), states)
    implicit = None
    for _ in range(PASSES):
        truth = motion.at(states, controls_set, local_air, implicit)
        implicit = truth.implicit
    met: Any = flown.wind
    record = flown._replace(states=states, controls=controls_set, wind=met[n_settling:])
    return record._replace(time=time[n_settling:]), truth


def _gusts(
    plans: tuple[FlightPlan, ...], n: int, turbulence: float, rng: np.random.Generator
) -> Any:
    """Return the gusts of the flights at n stages, two to a step."""
    scales = []
    for plan in plans:
        height = plan.altitudes[0][1] - FIELD_ELEVATION
        scales.append(Turbulence.low_altitude(height, plan.wind_at_6m)[:2])
    intensities, lengths = np.moveaxis(np.array(scales), 1, 0)
    return dryden_gusts(
        n, 0.5 * STEP, AIRSPEED, lengths, turbulence * intensities, BRUMBY.span, rng
    )


def _initial_states(controls: FlightControls, wind: Array) -> Array:
    """Return states (n_flights, 13) about trimmed, on the orbit due north of its centre, heading along it."""
    airspeed = controls.airspeed[0]
    north, east, radius = controls.orbit[0].T
    down = -controls.altitude[0]
    position = np.column_stack([north + np.abs(radius), east, down])
    heading = 0.5 * np.pi * np.sign(radius)
    attitude = euler_to_quaternion(0.0, ALPHA, heading)
    through_air = air_velocity(airspeed, ALPHA, 0.0)
    velocity = ned_to_body(attitude, wind) + through_air
    return np.hstack([position, velocity, attitude, np.zeros_like(position)])


# -- the autopilot: plans, control laws and actuators, of several flights at once

COMMANDS = ("elevator", "aileron", "rudder", "throttle")


# Trim and limits of the Brumby [rad], chosen: alpha, and elevator, aileron, rudder and throttle, in
# straight level flight
ALPHA = 0.085
TRIM = (-0.04, -0.007, 0.0, 0.63)
BANK_LIMIT = 0.70
ELEVON_LIMIT = 0.42
RUDDER_LIMIT = 0.35
# lags of left and right elevon, rudder and propeller [s]
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])
# distance [m] from the orbit at which the wanted course still cuts it at 45 degrees
CAPTURE_DISTANCE = 170.0


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    steps = np.asarray(steps)
    last = np.searchsorted(steps[:, 0], time, side="right") - 1
    return steps[np.maximum(last, 0), 1:]


class FlightControls:
    """Controls of several flights as a function of step, stage and measured values, for `fly_record`.

    At the beginning of each step the commands of proportional-integral loops for attitude, altitude
    and airspeed, and the manoeuvres, are added to targets, which the actuators approach as exact
    first-order lags.
    """

    def __init__(self, plans: tuple[FlightPlan, ...], time: np.ndarray, step: float):
        self.orbit = np.stack([scheduled(plan.orbits, time) for plan in plans], axis=1)
        altitudes = [scheduled(plan.altitudes, time) for plan in plans]
        self.altitude = np.hstack(altitudes)
        airspeeds = [scheduled(plan.airspeeds, time) for plan in plans]
        self.airspeed = np.hstack(airspeeds)
        manoeuvres = [[plan.manoeuvres(axis, time) for axis in COMMANDS] for plan in plans]
        self.manoeuvres = np.moveaxis(np.array(manoeuvres), -1, 0)
        self.integrals: dict[str, Array] = {}
        self.step = step
        self.now = -1
        trim = np.tile(TRIM, (len(plans), 1))
        self.end, _ = _targets(trim)

    def __call__(
        self, k: int, stage: int, observe: Callable[[], Mapping[str, Array]]
    ) -> dict[str, Array]:
        """Return the controls (n_flights,) by name at a stage, two to a step."""
        if k != self.now:
            self.now = k
            if k % STEPS_TOLD == 0:
                notify(Progress("steps", k, len(self.manoeuvres)))
            self.begin = self.end
            command = self._command(observe(), k)
            self.target, self.throttle = _targets(self.manoeuvres[k] + command)
        half_steps = stage - 2 * k
        positions = self.begin
        if half_steps:
            seconds = 0.5 * half_steps * self.step
            lag = np.exp(-seconds / TIME_CONSTANTS)
            positions = self.target + lag * (self.begin - self.target)
        if half_steps == 2:
            self.end = positions
        left, right, rudder, propeller_speed = positions.T
        return {
            "throttle": self.throttle,
            "elevator": 0.5 * (left + right),
            "aileron": 0.5 * (left - right),
            "rudder": rudder,
            "elevon_left": left,
            "elevon_right": right,
            "propeller_speed": propeller_speed,
        }

    def _integral(self, name: str, rate: Array, limit: float) -> Array:
        """Return the limited integral of a loop after this step."""
        total = self.integrals.get(name, 0.0) + rate * self.step
        self.integrals[name] = np.clip(total, -limit, limit)
        return self.integrals[name]

    def _command(self, sensed: Mapping[str, Array], k: int) -> Array:
        """Return elevator, aileron, rudder and throttle (n_flights, 4) of a step for ``sensed`` channels by name.

        Orbits (n_flights, 3) hold the centre's north, east and the radius [m], negative to turn left.
        """
        speed = sensed["airspeed"]
        climb = np.clip(0.35 * (self.altitude[k] - sensed["altitude"]), -3.0, 4.0)
        elevator = self._elevator(sensed, climb)
        aileron = self._aileron(sensed, self.orbit[k])
        rudder = _rudder(sensed)
        error = self.airspeed[k] - speed
        integral = self._integral("speed", 0.02 * error, 0.3)
        throttle = 0.08 * error + 0.06 * climb + integral
        return TRIM + np.stack((elevator, aileron, rudder, throttle), axis=-1)

    def _elevator(self, sensed: Mapping[str, Array], climb: Array) -> Array:
        """Return the addition to the elevator for a rate of climb [m/s]: > 0 pitches down."""
        speed = sensed["airspeed"]
        phi = sensed["phi"]
        level = np.cos(phi)
        error = climb + sensed["v_down"]
        integral = self._integral("climb", 0.010 * error, 0.10)
        steady = ALPHA / level + climb / speed
        pitch = steady + 0.012 * error + integral
        pitch_rate = STANDARD_GRAVITY * np.sin(phi) ** 2 / (level * speed)
        damping = 0.12 * (sensed["q"] - pitch_rate)
        in_turn = 0.03 * (1.0 / level - 1.0)
        return -0.30 * (pitch - sensed["theta"]) + damping - in_turn

    def _aileron(self, sensed: Mapping[str, Array], orbit: Array) -> Array:
        """Return the addition to the aileron that follows the orbit."""
        error = _bank(sensed, orbit) - sensed["phi"]
        integral = self._integral("roll", 0.01 * error, 0.05)
        aileron = 0.085 * error - 0.022 * sensed["p"] + integral
        return np.clip(aileron, -0.12, 0.12)


def _targets(command: Array) -> tuple[Array, Array]:
    """Return where the actuators go (n, 4), elevons, rudder, propeller, and the throttle (n,), mixed and limited."""
    elevator, aileron, rudder, throttle = command.T
    throttle = np.clip(throttle, 0.0, 1.0)
    left = np.clip(elevator + aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    right = np.clip(elevator - aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    rudder = np.clip(rudder, -RUDDER_LIMIT, RUDDER_LIMIT)
    propeller_speed = PROPELLER.speed_at(throttle)
    return np.stack([left, right, rudder, propeller_speed], axis=-1), throttle


def _rudder(sensed: Mapping[str, Array]) -> Array:
    """Return the addition to the rudder that coordinates a turn."""
    across = np.sin(sensed["phi"]) * np.cos(sensed["theta"])
    turn_rate = STANDARD_GRAVITY * across / sensed["airspeed"]
    return 0.22 * (sensed["r"] - turn_rate) - 0.10 * sensed["beta"]


def _bank(sensed: Mapping[str, Array], orbit: Array) -> Array:
    """Return the bank that follows the vector field around the orbit (Beard & McLain 2012, section 10.2)."""
    center_north, center_east, signed_radius = orbit.T
    north = sensed["north"] - center_north
    east = sensed["east"] - center_east
    radius = np.abs(signed_radius)
    turn = np.sign(signed_radius)
    distance = np.hypot(north, east) - radius
    off = distance / CAPTURE_DISTANCE
    bearing = np.arctan2(east, north)
    wanted = bearing + turn * (0.5 * np.pi + np.arctan(off))
    v_north = sensed["v_north"]
    v_east = sensed["v_east"]
    course = np.arctan2(v_east, v_north)
    error = wrapped(wanted - course)
    # of a steady turn on the orbit
    centripetal = (v_north**2 + v_east**2) / radius
    steady = np.arctan(centripetal / STANDARD_GRAVITY)
    ahead = turn * steady * np.exp(-0.5 * off**2)
    limit = BANK_LIMIT
    return np.clip(ahead + 1.2 * error, -limit, limit)


WAVES: dict[str, Callable[..., Any]] = {
    "doublet": doublet,
    "3-2-1-1": three_two_one_one,
    "multisine": multisine,
    "steps": Steps,
}


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    # (from time [s], centre north, centre east, radius [m]); a negative radius turns left
    orbits: list[list[float]]
    # (from time [s], altitude [m])
    altitudes: list[list[float]]
    # (from time [s], airspeed [m/s])
    airspeeds: list[list[float]]
    # mean velocity of the air, NED [m/s]
    wind: list[float]
    # wind near the ground [m/s], which sets the turbulence
    wind_at_6m: float
    # additions to elevator, aileron, rudder [rad] and throttle
    manoeuvres: Wavetrain


def _plan(manoeuvres: Mapping[str, list[dict]], **plan: Any) -> FlightPlan:
    """Return the plan of a table of the file."""
    inputs = {}
    for axis, entries in manoeuvres.items():
        inputs[axis] = {entry["start"]: _wave(**entry) for entry in entries}
    return FlightPlan(**plan, manoeuvres=Wavetrain(inputs))


def _wave(wave: str, start: float, **parameters: Any) -> Any:
    """Return an input by its kind and parameters."""
    if wave == "multisine":
        parameters["harmonics"] = range(*parameters["harmonics"])
    return WAVES[wave](**parameters)


PLANS = read_toml(Path(__file__).with_name("example_flights.toml"))["flights"]
FLIGHT_PLANS = tuple(_plan(**plan) for plan in PLANS)
