"""The example flights of a simulated UAV with known truth: their plans, their autopilot, and their simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from sklearn.utils import Bunch, check_random_state

from skdgp._compute.sklearn_compat import Interval, validate_params
from skdgp._compute.typing import Array, Seed
from skdgp._excitation import Steps, Wavetrain, doublet, multisine, three_two_one_one
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
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    Clock,
    GustyAir,
    Instant,
    LocalAir,
    Motion,
    Propeller,
    Record,
    ThrustLine,
    Turbulence,
    air_velocity,
    channels,
    dryden_gusts,
    euler_to_quaternion,
    fly_record,
    ned_to_body,
    propeller_loads,
)

# Columns of the regressors: angles [rad]; rates times b/2V (p, r, beta_dot) or c/2V (q, alpha_dot)
REGRESSORS = ("alpha", "beta", *RATES, "alpha_dot", "beta_dot", "elevator", "aileron", "rudder")

PROPELLER = Propeller(
    diameter=0.6, thrust_coefficients=(0.10, -0.045, -0.065), torque_coefficients=(0.0070, 0.0010, -0.0060),
    rotation=-1, speed_range=(280.0, 800.0),
)  # fmt: skip
BRUMBY = Aircraft(
    name="brumby", mass=45.0, inertia=np.array([[4.1, -0.06, -0.65], [-0.06, 9.2, 0.04], [-0.65, 0.04, 12.4]]),
    wing_area=2.59, span=2.80, chord=1.09, propeller=PROPELLER,
    thrust_line=ThrustLine(position=(-0.75, 0.0, -0.05), direction=(1.0, 0.0, -0.035)),
)  # fmt: skip


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

    Analytic in every argument: complex steps give exact derivatives (`brumby_derivatives`).
    """
    regressors = np.asarray(regressors)
    alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder = np.moveaxis(
        regressors, -1, 0
    )
    s = np.sin(alpha)
    s2 = s * s
    beta2 = beta * beta
    ordered = 1.0 / (1.0 + np.exp((alpha - 0.32) / 0.04))  # fraction of the vortex not broken down

    head_on = 1.0 - beta2
    potential = 2.7 * s * np.cos(alpha) * head_on
    vortex = 3.0 * s * np.sqrt(s2 + 1e-4) * ordered * head_on
    suction = 1.5 * s2 * ordered * head_on
    wing = potential + vortex
    heave = (1.9 * q + 0.6 * alpha_dot) * (0.5 + 0.5 * ordered)

    flow = 1.0 - 2.0 * s2
    lift_left, drag_left = _elevon(elevator + aileron, s, flow)
    lift_right, drag_right = _elevon(elevator - aileron, s, flow)
    elevons = 0.36 * (lift_left + lift_right)

    shade = 1.0 - 1.2 * s
    sidewash = beta + 0.14 * p - 0.68 * r + 0.15 * beta_dot
    fin = (0.13 * _soft(rudder, 0.30) - 0.26 * _soft(sidewash, 0.30)) * shade

    CX = -0.026 + suction - 0.5 * (drag_left + drag_right)
    CX = CX - 0.07 * rudder * rudder - 0.05 * beta2
    CY = fin - (0.20 + 1.5 * beta2) * beta + 0.06 * p
    CZ = -(wing + heave + elevons)
    Cl = 0.07 * fin + 0.075 * (lift_left - lift_right) - (0.015 + 0.17 * wing) * beta
    Cl = Cl - (0.24 - 0.35 * s) * p + (0.02 + 0.20 * wing) * r
    Cm = 0.0085 - 0.055 * potential - 0.10 * vortex - 0.50 * heave - 0.44 * elevons + 0.06 * beta2
    Cn = -0.34 * fin - 0.10 * (drag_left - drag_right) - (0.018 - 0.05 * s) * beta
    Cn = Cn - (0.01 + 0.10 * wing) * p - (0.02 + 0.08 * wing * wing) * r
    return np.stack((CX, CY, CZ, Cl, Cm, Cn), axis=-1)


def _elevon(deflection: Array, s: Array, flow: Array) -> tuple[Array, Array]:
    """Return lift and drag of an elevon at the sine of alpha and the flow over it."""
    return _soft(deflection, 0.28) * flow, deflection * (0.16 * deflection + 0.30 * s)


def brumby_derivatives(regressors: ArrayLike) -> Array:
    """Return d coefficients / d regressors, (..., 6, 10), exact to rounding (complex steps, 1e-30)."""
    steps = np.asarray(regressors, dtype=float)[..., None, :] + 1e-30j * np.eye(len(REGRESSORS))
    derivatives = brumby_coefficients(steps).imag / 1e-30
    return np.swapaxes(derivatives, -1, -2)


def _soft(angle: Array, limit: float) -> Array:
    """Return the angle, softly saturated: slope 1 at zero, never beyond the limit [rad]."""
    return angle / np.sqrt(1.0 + (angle / limit) ** 2)


ALPHA = 0.085  # in straight level flight [rad]
COMMANDS = ("elevator", "aileron", "rudder", "throttle")
TRIM = (-0.04, -0.007, 0.0, 0.63)  # of the commands in straight level flight [rad]
BANK_LIMIT = 0.70  # [rad]
ELEVON_LIMIT = 0.42
RUDDER_LIMIT = 0.35
TIME_CONSTANTS = np.array([0.04, 0.04, 0.04, 0.25])  # lags of elevons, rudder and propeller [s]
# distance [m] from the orbit at which the wanted course still cuts it at 45 degrees
CAPTURE_DISTANCE = 170.0
# Harmonics of multisines that fly together
EVEN = range(12, 60, 2)
ODD = range(13, 60, 2)
FIRST = range(10, 60, 3)
SECOND = range(11, 60, 3)
THIRD = range(12, 60, 3)
TWO_ALTITUDES = Wavetrain({
    "elevator": {
        14: doublet(0.7, -0.06), 24: multisine(24, range(8, 42, 3), rms=0.035), 96: three_two_one_one(0.5, 0.05),
        140: multisine(30, range(10, 54, 4), rms=0.035),
    },
    "aileron": {
        18: doublet(0.6, 0.11), 24: multisine(24, range(9, 42, 3), rms=0.05), 101: three_two_one_one(0.45, -0.10),
        140: multisine(30, range(11, 54, 4), rms=0.04),
    },
    "rudder": {
        21: doublet(0.8, 0.16), 24: multisine(24, range(10, 42, 3), rms=0.09), 106: three_two_one_one(0.6, 0.13),
        140: multisine(30, range(12, 54, 4), rms=0.09),
    },
    "throttle": {44: Steps([5], [-0.15]), 150: doublet(7, 0.15)},
})  # fmt: skip
DURATION = 180.0
TEST_FLIGHT = "two_altitudes"
LOG_STEP = 0.025  # between autopilot commands, integration steps and log rows [s]
# flown before the log begins, so that it does not open with the transients of a guessed trim [s]
SETTLING = 8.0
FIELD_ELEVATION = 60.0  # height of the ground, above which turbulence scales [m]
AIRSPEED = 36.0  # at which the gusts are crossed [m/s]
# of the fixed point of alpha_dot and beta_dot in the truth; each brings it 70 times nearer
PASSES = 8
DEGREE = np.pi / 180.0
# Standard deviations in SI units, of small UAV sensors: pitot tube and vanes, MEMS inertial unit,
# GPS
SENSOR_NOISE = {
    "airspeed": 0.3, "alpha": 0.3 * DEGREE, "beta": 0.3 * DEGREE, **dict.fromkeys(RATES, 0.002),
    **dict.fromkeys(SPECIFIC_FORCE, 0.05), **dict.fromkeys(EULER, 0.3 * DEGREE), "north": 0.5, "east": 0.5,
    **dict.fromkeys(EARTH_VELOCITY, 0.1),
}  # fmt: skip
# Columns that a logger would write; the truth comes after them
MEASURED = (
    "time", "flight", "airspeed", "alpha", "beta", "p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi",
    "north", "east", "v_north", "v_east", "v_down", "altitude", "density", "throttle", "elevator", "aileron",
    "rudder", "elevon_left", "elevon_right", "thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m",
    "thrust_n", "propeller_speed",
)  # fmt: skip
TRUTH = (
    "airspeed", "alpha", "beta", "alpha_dot", "beta_dot", *RATES, "p_dot", "q_dot", "r_dot", *SPECIFIC_FORCE,
    "u", "v", "w", *EULER, "north", "east", *EARTH_VELOCITY, *WIND, "gravity", *COEFFICIENTS,
)  # fmt: skip
DESCR = files("skdgp.datasets").joinpath("example_flights.rst").read_text(encoding="utf-8")
FACTOR = [Interval(Real, 0, None, closed="left")]


@dataclass(frozen=True)
class FlightPlan:
    """Plan of one flight: path, wind, and manoeuvres added to the controls."""

    name: str
    # (from time [s], centre north, centre east, radius [m]); a negative radius turns left
    orbits: tuple[tuple[float, float, float, float], ...]
    altitudes: tuple[tuple[float, float], ...]  # (from time [s], altitude [m])
    airspeeds: tuple[tuple[float, float], ...]  # (from time [s], airspeed [m/s])
    wind: tuple[float, float, float]  # mean velocity of the air, NED [m/s]
    wind_at_6m: float  # wind near the ground [m/s], which sets the turbulence
    manoeuvres: Wavetrain  # additions to elevator, aileron, rudder [rad] and throttle


def scheduled(steps: ArrayLike, time: Array) -> Array:
    """Return the values, (n, ...), of the last of ``steps`` (from time, values...) at each time."""
    steps = np.asarray(steps)
    last = np.searchsorted(steps[:, 0], time, side="right") - 1
    return steps[np.maximum(last, 0), 1:]


def interrupted(amplitude: float) -> Steps:
    """Return the 3-2-1-1 of 0.4 s as these flights have it, with a row at trim before the third pulse."""
    return Steps([1.2, 0.8, 0.025, 0.375, 0.4], [amplitude, -amplitude, 0.0, amplitude, -amplitude])


LATERAL = Wavetrain({
    "aileron": {
        6: multisine(30, EVEN, rms=0.055), 40: doublet(0.5, 0.14), 66: multisine(30, ODD, rms=0.07),
        104: interrupted(0.13), 140: multisine(30, EVEN, rms=0.05), 172: doublet(0.7, -0.11),
    },
    "rudder": {
        6: multisine(30, ODD, rms=0.12), 44: doublet(0.9, 0.18), 66: multisine(30, EVEN, rms=0.15),
        98: three_two_one_one(0.7, -0.16), 110: doublet(0.7, -0.23), 140: multisine(30, ODD, rms=0.09),
    },
})  # fmt: skip
LATLON = Wavetrain({
    "elevator": {
        6: multisine(30, FIRST, rms=0.04), 40: three_two_one_one(0.5, 0.05), 47: doublet(0.9, -0.075),
        70: multisine(30, SECOND, rms=0.045), 104: three_two_one_one(0.6, -0.055), 110: doublet(0.6, 0.09),
        144: multisine(30, THIRD, rms=0.04),
    },
    "aileron": {
        6: multisine(30, SECOND, rms=0.04), 51: doublet(0.5, 0.13), 70: multisine(30, THIRD, rms=0.05),
        114: interrupted(0.085), 144: multisine(30, FIRST, rms=0.04),
    },
    "rudder": {
        6: multisine(30, THIRD, rms=0.07), 54: doublet(0.8, -0.16), 70: multisine(30, FIRST, rms=0.08),
        118: doublet(0.6, 0.18), 144: multisine(30, SECOND, rms=0.07),
    },
    "throttle": {
        20: doublet(5, 0.2), 84: doublet(6, 0.25), 108: Steps([4], [-0.3]),
        144: multisine(30, range(1, 12, 2), rms=0.12),
    },
})  # fmt: skip

FLIGHT_PLANS = (
    FlightPlan(
        name="lateral", orbits=((-99, 0, 0, 230), (50, 0, 480, -230), (118, 0, 0, 190)), altitudes=((-99, 220),),
        airspeeds=((-99, 35),), wind=(-2.0, 3.0, 0.0), wind_at_6m=3.5, manoeuvres=LATERAL,
    ),
    FlightPlan(
        name="latlon", orbits=((-99, 0, 0, -260), (62, -520, 60, 240), (124, -80, 300, -210)),
        altitudes=((-99, 220), (76, 228), (114, 220)), airspeeds=((-99, 36), (38, 31), (66, 38), (120, 34)),
        wind=(3.0, -1.5, 0.0), wind_at_6m=3.5, manoeuvres=LATLON,
    ),
    FlightPlan(
        name="two_altitudes", orbits=((-99, 0, 0, 250), (56, 420, -350, -240), (116, -80, -500, 200)),
        altitudes=((-99, 200), (72, 275)), airspeeds=((-99, 37), (50, 32.5), (110, 35)), wind=(-3.5, -3.0, 0.0),
        wind_at_6m=5.5, manoeuvres=TWO_ALTITUDES,
    ),
)  # fmt: skip


class FlightControls:
    """Controls of several flights as a function of step, stage and measured values, for `fly_record`.

    At the beginning of each step the commands of the autopilot and the manoeuvres are added to
    targets. The actuators approach the targets as exact first-order lags.
    """

    def __init__(self, plans: tuple[FlightPlan, ...], time: np.ndarray, step: float):
        self.orbit = np.stack([scheduled(plan.orbits, time) for plan in plans], axis=1)
        self.altitude = np.column_stack([scheduled(plan.altitudes, time) for plan in plans])
        self.airspeed = np.column_stack([scheduled(plan.airspeeds, time) for plan in plans])
        self.manoeuvres = np.zeros((len(time), len(plans), len(COMMANDS)))
        for k, plan in enumerate(plans):
            for j, axis in enumerate(COMMANDS):
                self.manoeuvres[:, k, j] = plan.manoeuvres(axis, time)
        self.autopilot = Autopilot(step, len(plans))
        self.step = step
        self.now = -1
        self.end, _ = _targets(np.tile(TRIM, (len(plans), 1)))

    def __call__(
        self, k: int, stage: int, observe: Callable[[], Mapping[str, Array]]
    ) -> dict[str, Array]:
        """Return the controls (n_flights,) by name at a stage, two to a step."""
        if k != self.now:
            self.now = k
            self.begin = self.end
            command = self.autopilot.command(
                observe(), self.orbit[k], self.altitude[k], self.airspeed[k]
            )
            self.target, self.throttle = _targets(self.manoeuvres[k] + command)
        half_steps = stage - 2 * k
        positions = self.begin
        if half_steps:
            lag = np.exp(-0.5 * half_steps * self.step / TIME_CONSTANTS)
            positions = self.target + lag * (self.begin - self.target)
        if half_steps == 2:
            self.end = positions
        left, right, rudder, propeller_speed = positions.T
        return {
            "throttle": self.throttle, "elevator": 0.5 * (left + right), "aileron": 0.5 * (left - right),
            "rudder": rudder, "elevon_left": left, "elevon_right": right, "propeller_speed": propeller_speed,
        }  # fmt: skip


def _targets(command: Array) -> tuple[Array, Array]:
    """Return where the actuators go (n, 4), elevons, rudder, propeller, and the throttle (n,), mixed and limited."""
    elevator, aileron, rudder, throttle = command.T
    throttle = np.clip(throttle, 0.0, 1.0)
    left = np.clip(elevator + aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    right = np.clip(elevator - aileron, -ELEVON_LIMIT, ELEVON_LIMIT)
    rudder = np.clip(rudder, -RUDDER_LIMIT, RUDDER_LIMIT)
    return np.stack([left, right, rudder, PROPELLER.speed_at(throttle)], axis=-1), throttle


class Autopilot:
    """Proportional-integral loops for attitude, altitude and airspeed of several flights."""

    def __init__(self, step: float, n_flights: int):
        self.step = step
        self.climb_integral = np.zeros(n_flights)
        self.speed_integral = np.zeros(n_flights)
        self.roll_integral = np.zeros(n_flights)

    def command(
        self, sensed: Mapping[str, Array], orbit: Array, altitude: Array, airspeed: Array
    ) -> Array:
        """Return elevator, aileron, rudder and throttle (n_flights, 4) for ``sensed`` channels by name.

        ``orbit`` (n_flights, 3) holds the centre's north, east and the radius [m], negative to turn
        left.
        """
        speed = sensed["airspeed"]
        climb = np.clip(0.35 * (altitude - sensed["altitude"]), -3.0, 4.0)
        elevator = self._elevator(sensed, climb)
        aileron = self._aileron(sensed, orbit)
        turn_rate = STANDARD_GRAVITY * np.sin(sensed["phi"]) * np.cos(sensed["theta"]) / speed
        rudder = 0.22 * (sensed["r"] - turn_rate) - 0.10 * sensed["beta"]
        error = airspeed - speed
        self.speed_integral = np.clip(self.speed_integral + 0.02 * error * self.step, -0.3, 0.3)
        throttle = 0.08 * error + 0.06 * climb + self.speed_integral
        return TRIM + np.stack((elevator, aileron, rudder, throttle), axis=-1)

    def _elevator(self, sensed: Mapping[str, Array], climb: Array) -> Array:
        """Return the addition to the elevator for a rate of climb [m/s]: > 0 pitches down."""
        speed = sensed["airspeed"]
        error = climb + sensed["v_down"]
        self.climb_integral = np.clip(self.climb_integral + 0.010 * error * self.step, -0.10, 0.10)
        level = np.cos(sensed["phi"])
        pitch = ALPHA / level + climb / speed + 0.012 * error + self.climb_integral
        pitch_rate = STANDARD_GRAVITY * np.sin(sensed["phi"]) ** 2 / (level * speed)
        damping = 0.12 * (sensed["q"] - pitch_rate)
        return -0.30 * (pitch - sensed["theta"]) + damping - 0.03 * (1.0 / level - 1.0)

    def _aileron(self, sensed: Mapping[str, Array], orbit: Array) -> Array:
        """Return the addition to the aileron that follows the orbit."""
        error = _bank(sensed, orbit) - sensed["phi"]
        self.roll_integral = np.clip(self.roll_integral + 0.01 * error * self.step, -0.05, 0.05)
        return np.clip(0.085 * error - 0.022 * sensed["p"] + self.roll_integral, -0.12, 0.12)


def _bank(sensed: Mapping[str, Array], orbit: Array) -> Array:
    """Return the bank that follows the vector field around the orbit (Beard & McLain 2012, section 10.2)."""
    center_north, center_east, signed_radius = orbit.T
    north = sensed["north"] - center_north
    east = sensed["east"] - center_east
    radius = np.abs(signed_radius)
    turn = np.sign(signed_radius)
    off = (np.hypot(north, east) - radius) / CAPTURE_DISTANCE
    course = np.arctan2(sensed["v_east"], sensed["v_north"])
    error = np.arctan2(east, north) + turn * (0.5 * np.pi + np.arctan(off)) - course
    error = (error + np.pi) % (2.0 * np.pi) - np.pi
    ground_speed2 = sensed["v_north"] ** 2 + sensed["v_east"] ** 2
    steady = np.arctan(ground_speed2 / (STANDARD_GRAVITY * radius))
    ahead = turn * steady * np.exp(-0.5 * off**2)
    return np.clip(ahead + 1.2 * error, -BANK_LIMIT, BANK_LIMIT)


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
        ``train``: two flights of 180 s at 40 Hz, a DataFrame (14400, 69) whose column ``flight``
        tells them apart and serves as ``groups`` of a cross-validation; ``test``: one flight along
        another path, at two altitudes, in stronger turbulence, (7200, 69); ``aircraft``;
        ``aerodynamics``: the true model, a function of regressors (..., 10) to CX CY CZ Cl Cm Cn
        (..., 6); its ``regressor_names`` (rates are relative to the air and non-dimensional);
        ``DESCR``, a text.

    Examples
    --------
    >>> from skdgp.datasets import load_example_flights
    >>> data = load_example_flights()
    >>> data.train.groupby("flight", observed=True)["airspeed_true"].mean().round()
    flight
    lateral    35.0
    latlon     35.0
    Name: airspeed_true, dtype: float64
    >>> data.aircraft
    Aircraft('brumby', 45 kg, S 2.59 m^2, b 2.8 m, c 1.09 m)
    """
    seed: Any = random_state
    if not isinstance(seed, int | np.integer):
        seed = check_random_state(seed).randint(np.iinfo(np.int32).max)
    train, test = _flights(int(seed), float(turbulence), float(sensor_noise), float(duration))
    return Bunch(
        train=train.copy(), test=test.copy(), aircraft=BRUMBY, aerodynamics=brumby_coefficients,
        regressor_names=list(REGRESSORS), DESCR=DESCR,
    )  # fmt: skip


@lru_cache(maxsize=4)
def _flights(
    seed: int, turbulence: float, sensor_noise: float, duration: float
) -> tuple[pd.DataFrame, pd.DataFrame]:
    gust_seed, *sensor_seeds = np.random.SeedSequence(seed).spawn(1 + len(FLIGHT_PLANS))
    rng = np.random.default_rng(gust_seed)
    record, instant = fly_plans(FLIGHT_PLANS, duration, turbulence, rng)
    logged, true = _columns(record, instant)
    tables = {}
    for k, (plan, sensor_seed) in enumerate(zip(FLIGHT_PLANS, sensor_seeds, strict=True)):
        truth = pd.DataFrame({name + TRUTH_SUFFIX: true[name][:, k] for name in TRUTH})
        table = measure(truth, sensor_noise, np.random.default_rng(sensor_seed))
        table = table.assign(flight=plan.name)
        table = table.assign(**{name: values[:, k] for name, values in logged.items()})
        tables[plan.name] = pd.concat([table[list(MEASURED)], truth], axis=1)
    test = tables.pop(TEST_FLIGHT)
    train = pd.concat([*tables.values()], ignore_index=True)
    return train.astype({"flight": "category"}), test.astype({"flight": "category"})


def _columns(record: Any, truth: Any) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the channels logged without noise, and the truth of measured ones: (n_times, n_flights) by name."""
    motion = channels(record.states, record.wind)
    forces, moments = propeller_loads(
        BRUMBY, record.controls["propeller_speed"], motion["airspeed"], truth.density
    )
    logged = {
        "time": np.broadcast_to(record.time[:, None], truth.density.shape),
        "altitude": motion["altitude"],
        "density": truth.density,
        **record.controls,
        **_named(THRUST_FORCES, forces),
        **_named(THRUST_MOMENTS, moments),
    }
    true = {
        **motion,
        "gravity": np.full(truth.density.shape, STANDARD_GRAVITY),
        "psi": motion["psi"] % (2.0 * np.pi),
        **_named(("alpha_dot", "beta_dot"), truth.implicit),
        **_named(("p_dot", "q_dot", "r_dot"), truth.derivative[..., -len(RATES) :]),
        **_named(SPECIFIC_FORCE, truth.force / BRUMBY.mass),
        **_named(WIND, record.wind),
        **_named(COEFFICIENTS, truth.coefficients),
    }
    return logged, true


def _named(names: Sequence[str], values: Array) -> dict[str, Array]:
    """Return the last axis of an array by name."""
    return {name: values[..., k] for k, name in enumerate(names)}


def measure(truth: pd.DataFrame, scale: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return one measured column per name of `SENSOR_NOISE`, from the column of ``truth`` that ends in ``_true``.

    Noise is white and independent from channel to channel, with ``scale`` times the stated standard
    deviations.
    """
    measured = truth[[name + TRUTH_SUFFIX for name in SENSOR_NOISE]]
    measured = measured.set_axis(list(SENSOR_NOISE), axis=1)
    std = scale * np.array(list(SENSOR_NOISE.values()))
    return measured + std * rng.standard_normal(measured.shape)


def brumby_motion() -> Motion:
    """Return how the Brumby moves; alpha_dot and beta_dot lag by one call, as in the steps of the example flights."""
    names = [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
    return Motion(Aerodynamics(brumby_coefficients, names), BRUMBY, lagged=True)


def fly_plans(
    plans: tuple[FlightPlan, ...],
    duration: float,
    turbulence: float,
    rng: np.random.Generator,
) -> tuple[Record, Instant]:
    """Return the flights of ``plans``, ``duration`` [s] each, and what acted, the fixed point of the slopes converged.

    ``turbulence`` multiplies the gusts; the random numbers behind them do not depend on it.
    """
    n_settling = round(SETTLING / LOG_STEP)
    n_times = round((SETTLING + duration) / LOG_STEP)
    time = np.arange(n_times) * LOG_STEP - SETTLING
    intensities = []
    lengths = []
    for plan in plans:
        height = plan.altitudes[0][1] - FIELD_ELEVATION
        intensity, length = Turbulence.low_altitude(height, plan.wind_at_6m)[:2]
        intensities.append(intensity)
        lengths.append(length)
    gusts = dryden_gusts(
        2 * n_times + 1, 0.5 * LOG_STEP, AIRSPEED, np.array(lengths), turbulence * np.array(intensities),
        BRUMBY.span, rng,
    )  # fmt: skip
    wind = np.array([plan.wind for plan in plans])
    air = GustyAir(lambda stage, state: LocalAir(wind), gusts)
    motion = brumby_motion()
    controls = FlightControls(plans, time, LOG_STEP)
    states = _initial_states(controls, wind)
    record = fly_record(motion, controls, air, Clock(LOG_STEP, n_times - 1), states)
    record = record.rows(slice(n_settling, None))
    local_air = air(slice(2 * n_settling, 2 * n_times, 2), record.states)
    implicit = None
    for _ in range(PASSES):
        truth = motion.at(record.states, record.controls, local_air, implicit)
        implicit = truth.implicit
    return record._replace(time=time[n_settling:]), truth


def _initial_states(controls: FlightControls, wind: Array) -> Array:
    """Return states (n_flights, 13) about trimmed, on the orbit due north of its centre, heading along it."""
    orbit, airspeed = controls.orbit[0], controls.airspeed[0]
    north, east, radius = orbit.T
    position = np.column_stack([north + np.abs(radius), east, -controls.altitude[0]])
    attitude = euler_to_quaternion(0.0, ALPHA, 0.5 * np.pi * np.sign(radius))
    velocity = ned_to_body(attitude, wind) + air_velocity(airspeed, ALPHA, 0.0)
    return np.hstack([position, velocity, attitude, np.zeros_like(position)])
