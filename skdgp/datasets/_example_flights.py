"""The example flights of a simulated delta-wing UAV, with known truth: one batch of the loop of `simulate`."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from importlib.resources import files
from numbers import Real
from typing import Any

import numpy as np
import pandas as pd
from sklearn.utils import Bunch, check_random_state

from skdgp._compute.sklearn_compat import Interval, validate_params
from skdgp._compute.typing import Array, Seed
from skdgp._flight.atmosphere import STANDARD_GRAVITY
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
from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients
from skdgp.datasets._flight_plans import ALPHA, FLIGHT_PLANS, FlightControls, FlightPlan
from skdgp.dynamics import Aerodynamics, euler_to_quaternion, ned_to_body, propeller_loads
from skdgp.dynamics import _rigid_body as rigid_body
from skdgp.dynamics._air import GustyAir, LocalAir
from skdgp.dynamics._inputs import Clock
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._simulate import Record, fly_record
from skdgp.dynamics._trajectory import channels
from skdgp.dynamics._turbulence import dryden_gusts, low_altitude_turbulence

DURATION = 180.0
TEST_FLIGHT = "two_altitudes"
LOG_STEP = 0.025  # between autopilot commands, integration steps and log rows [s]
SETTLING = 8.0  # flown before the log begins, so that it does not open with the transients of a guessed trim [s]
FIELD_ELEVATION = 60.0  # height of the ground, above which turbulence scales [m]
AIRSPEED = 36.0  # at which the gusts are crossed [m/s]
PASSES = 8  # of the fixed point of alpha_dot and beta_dot in the truth; each brings it 70 times nearer
DEGREE = np.pi / 180.0

SENSOR_NOISE = {
    "airspeed": 0.3, "alpha": 0.3 * DEGREE, "beta": 0.3 * DEGREE, **dict.fromkeys(RATES, 0.002),
    **dict.fromkeys(SPECIFIC_FORCE, 0.05), **dict.fromkeys(EULER, 0.3 * DEGREE), "north": 0.5, "east": 0.5,
    **dict.fromkeys(EARTH_VELOCITY, 0.1),
}  # fmt: skip
"""Standard deviations in SI units, of small UAV sensors: pitot tube and vanes, MEMS inertial unit, GPS."""
MEASURED = (
    "time", "flight", "airspeed", "alpha", "beta", "p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi",
    "north", "east", "v_north", "v_east", "v_down", "altitude", "density", "throttle", "elevator", "aileron",
    "rudder", "elevon_left", "elevon_right", "thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m",
    "thrust_n", "propeller_speed",
)  # fmt: skip
"""Columns that a logger would write; the truth comes after them."""
TRUTH = (
    *("airspeed", "alpha", "beta", "alpha_dot", "beta_dot", *RATES, "p_dot", "q_dot", "r_dot", *SPECIFIC_FORCE),
    *("u", "v", "w", *EULER, "north", "east", *EARTH_VELOCITY, *WIND, "gravity", *COEFFICIENTS),
)

DESCR = files("skdgp.datasets").joinpath("example_flights.rst").read_text(encoding="utf-8")
FACTOR = [Interval(Real, 0, None, closed="left")]


@validate_params(
    {"random_state": ["random_state"], "turbulence": FACTOR, "sensor_noise": FACTOR}, prefer_skip_nested_validation=True
)
def load_example_flights(*, random_state: Seed = 0, turbulence: float = 1.0, sensor_noise: float = 1.0) -> Bunch:
    """Return training and test flights of a simulated delta-wing UAV with known truth.

    `skdgp.dynamics` flies them, about 8 s at the first call, kept for later calls in the same process. The aircraft,
    its equations and the manoeuvres are described in docs/example_flights.md.

    Parameters
    ----------
    random_state : int, RandomState or None, default=0
        Seed of gusts and sensor noise. The same integer gives the same flights.
    turbulence : float, default=1.0
        Multiplies the gusts; 0 is calm air in the same steady wind.
    sensor_noise : float, default=1.0
        Multiplies the sensors' noise; 0 makes every sensor perfect.

    Returns
    -------
    Bunch
        ``train``: two flights of 180 s at 40 Hz, a DataFrame (14400, 69) whose column ``flight`` tells them apart and
        serves as ``groups`` of a cross-validation; ``test``: one flight along another path, at two altitudes, in
        stronger turbulence, (7200, 69); ``aircraft``; ``aerodynamics``: the true model, a function of regressors
        (..., 10) to CX CY CZ Cl Cm Cn (..., 6); ``regressor_names`` of it (rates are relative to the air and
        non-dimensional); ``DESCR``, a text.

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
    train, test = _flights(int(seed), float(turbulence), float(sensor_noise))
    return Bunch(
        train=train.copy(), test=test.copy(), aircraft=BRUMBY, aerodynamics=brumby_coefficients,
        regressor_names=list(REGRESSORS), DESCR=DESCR,
    )  # fmt: skip


@lru_cache(maxsize=2)
def _flights(
    seed: int, turbulence: float, sensor_noise: float, duration: float = DURATION
) -> tuple[pd.DataFrame, pd.DataFrame]:
    gust_seed, *sensor_seeds = np.random.SeedSequence(seed).spawn(1 + len(FLIGHT_PLANS))
    known, true = _columns(*fly_plans(FLIGHT_PLANS, duration, turbulence, np.random.default_rng(gust_seed)))
    tables = {}
    for k, plan in enumerate(FLIGHT_PLANS):
        truth = pd.DataFrame({name + TRUTH_SUFFIX: true[name][:, k] for name in TRUTH})
        logged = measure(truth, sensor_noise, np.random.default_rng(sensor_seeds[k]))
        logged = logged.assign(flight=plan.name, **{name: values[:, k] for name, values in known.items()})
        tables[plan.name] = pd.concat([logged[list(MEASURED)], truth], axis=1)
    test = tables.pop(TEST_FLIGHT)
    train = pd.concat([*tables.values()], ignore_index=True)
    return train.astype({"flight": "category"}), test.astype({"flight": "category"})


def _columns(record: Any, truth: Any) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return what is logged without noise, and the truth of what is measured: (n_times, n_flights) by name."""
    seen = channels(record.states, record.wind)
    thrust = propeller_loads(BRUMBY, record.controls["propeller_speed"], seen["airspeed"], truth.density)
    known = {"altitude": seen["altitude"], "density": truth.density, **record.controls}
    known["time"] = np.broadcast_to(record.time[:, None], truth.density.shape)
    true = seen | {"gravity": np.full(truth.density.shape, STANDARD_GRAVITY), "psi": seen["psi"] % (2.0 * np.pi)}
    for columns, names, values in (
        (known, THRUST_FORCES, thrust[0]),
        (known, THRUST_MOMENTS, thrust[1]),
        (true, ("alpha_dot", "beta_dot"), truth.implicit),
        (true, [f"{name}_dot" for name in RATES], truth.derivative[..., rigid_body.RATES]),
        (true, SPECIFIC_FORCE, truth.force / BRUMBY.mass),
        (true, WIND, record.wind),
        (true, COEFFICIENTS, truth.coefficients),
    ):
        columns |= {name: values[..., k] for k, name in enumerate(names)}
    return known, true


def measure(truth: pd.DataFrame, scale: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return one measured column per name of `SENSOR_NOISE`, from the column of ``truth`` that ends in ``_true``.

    Noise is white and independent from channel to channel, with ``scale`` times the stated standard deviations.
    """
    measured = truth[[name + TRUTH_SUFFIX for name in SENSOR_NOISE]].set_axis([*SENSOR_NOISE], axis=1)
    return measured + scale * np.array([*SENSOR_NOISE.values()]) * rng.standard_normal(measured.shape)


def brumby_motion() -> Motion:
    """Return how the Brumby moves; alpha_dot and beta_dot lag by one call, as in the steps of the example flights."""
    names = [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
    return Motion(Aerodynamics(brumby_coefficients, names), BRUMBY, lagged=True)


def fly_plans(
    plans: tuple[FlightPlan, ...],
    duration: float,
    turbulence: float,
    rng: np.random.Generator,
    controls_of: Callable = FlightControls,
) -> tuple[Record, Instant]:
    """Return the flights of ``plans``, ``duration`` [s] each, and what acted, the fixed point of the slopes converged.

    ``turbulence`` multiplies the gusts; the random numbers behind them do not depend on it. ``controls_of`` makes the
    controls from the plans, the times and the step.
    """
    time: np.ndarray = np.arange(round((SETTLING + duration) / LOG_STEP)) * LOG_STEP - SETTLING
    heights = [plan.altitudes[0][1] - FIELD_ELEVATION for plan in plans]
    scales = [low_altitude_turbulence(h, plan.wind_at_6m) for h, plan in zip(heights, plans, strict=True)]
    lengths, intensities = (np.array(part) for part in zip(*scales, strict=True))
    gusts = dryden_gusts(
        2 * len(time) + 1, 0.5 * LOG_STEP, AIRSPEED, lengths, turbulence * intensities, BRUMBY.span, rng
    )
    wind = np.array([plan.wind for plan in plans])
    air = GustyAir(lambda stage, state: LocalAir(wind), gusts)
    motion, controls = brumby_motion(), controls_of(plans, time, LOG_STEP)
    record = fly_record(motion, controls, air, Clock(LOG_STEP, len(time) - 1), _initial_states(controls, wind))
    log = slice(round(SETTLING / LOG_STEP), None)
    record = record.rows(log)
    at = air(slice(2 * log.start, 2 * len(time), 2), record.states)
    implicit = None
    for _ in range(PASSES):
        truth = motion.at(record.states, record.controls, at, implicit)
        implicit = truth.implicit
    return record._replace(time=time[log]), truth


def _initial_states(controls: FlightControls, wind: Array) -> Array:
    """Return states (n_flights, 13) about trimmed, on the orbit due north of its centre, heading along it."""
    orbit, airspeed = controls.orbit[0], controls.airspeed[0]
    state = np.zeros((len(orbit), 13))
    state[:, :2], state[:, 2] = orbit[:, :2], -controls.altitude[0]
    state[:, 0] += np.abs(orbit[:, 2])
    state[:, rigid_body.ATTITUDE] = euler_to_quaternion(0.0, ALPHA, 0.5 * np.pi * np.sign(orbit[:, 2]))
    state[:, rigid_body.VELOCITY] = ned_to_body(state[:, rigid_body.ATTITUDE], wind)
    state[:, 3] += airspeed * np.cos(ALPHA)
    state[:, 5] += airspeed * np.sin(ALPHA)
    return state
