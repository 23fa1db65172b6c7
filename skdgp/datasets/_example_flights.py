"""The example flights of a simulated delta-wing UAV, with known truth."""

from __future__ import annotations

from functools import lru_cache
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
    RATES,
    SPECIFIC_FORCE,
    THRUST_FORCES,
    THRUST_MOMENTS,
    TRUTH_SUFFIX,
    WIND,
)
from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients
from skdgp.datasets._flight_plans import FLIGHT_PLANS
from skdgp.datasets._simulation import fly_plans
from skdgp.dynamics import propeller_loads
from skdgp.dynamics._equations.rigid_body import RATES as SPIN
from skdgp.dynamics._simulation.trajectory import channels

DURATION = 180.0
TEST_FLIGHT = "two_altitudes"
DEGREE = np.pi / 180.0

SENSOR_NOISE = {
    "airspeed": 0.3,
    **dict.fromkeys(("alpha", "beta"), 0.3 * DEGREE),
    **dict.fromkeys(RATES, 0.002),
    **dict.fromkeys(SPECIFIC_FORCE, 0.05),
    **dict.fromkeys(EULER, 0.3 * DEGREE),
    **dict.fromkeys(("north", "east"), 0.5),
    **dict.fromkeys(EARTH_VELOCITY, 0.1),
}
"""Standard deviations in SI units, of small UAV sensors: pitot tube and vanes, MEMS inertial unit, GPS."""
MEASURED = (
    "time", "flight", "airspeed", "alpha", "beta", "p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi",
    "north", "east", "v_north", "v_east", "v_down", "altitude", "density", "throttle", "elevator", "aileron",
    "rudder", "elevon_left", "elevon_right", "thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m",
    "thrust_n", "propeller_speed",
)  # fmt: skip
"""Columns that a logger would write; the truth comes after them."""
TRUTH = (
    "airspeed", "alpha", "beta", "alpha_dot", "beta_dot", "p", "q", "r", "p_dot", "q_dot", "r_dot", "ax", "ay", "az",
    "u", "v", "w", "phi", "theta", "psi", "north", "east", "v_north", "v_east", "v_down", *WIND, "gravity",
    *COEFFICIENTS,
)  # fmt: skip

DESCR = """\
Example flights: a simulated Brumby-like UAV
--------------------------------------------
A 45 kg cropped delta with two elevons, a rudder and a pusher propeller, span 2.8 m, about 36 m/s, flown by an
autopilot through steady wind and Dryden turbulence (MIL-F-8785C) while doublets, 3-2-1-1s and multisines excite
it. Nonlinear aerodynamics: vortex lift and its breakdown, dihedral effect and damping that change with alpha,
elevons that saturate and so couple elevator and aileron. 40 Hz, SI units, radians.

train  flight "lateral": one altitude, aileron and rudder excited; flight "latlon": elevator and throttle too.
test   flight "two_altitudes": another path, another wind, more turbulence, a climb of 75 m.

Plain columns are what sensors saw, with white noise (airspeed 0.3 m/s, vanes and attitude 0.3 deg, rates
0.002 rad/s, accelerations 0.05 m/s2, ground velocity 0.1 m/s, position 0.5 m); surfaces, throttle, propeller
speed, thrust, altitude and density are known. Columns ending in _true are noise-free: score with them, never fit.
"""


@validate_params(
    {
        "random_state": ["random_state"],
        "turbulence": [Interval(Real, 0, None, closed="left")],
        "sensor_noise": [Interval(Real, 0, None, closed="left")],
    },
    prefer_skip_nested_validation=True,
)
def load_example_flights(*, random_state: Seed = 0, turbulence: float = 1.0, sensor_noise: float = 1.0) -> Bunch:
    """Return training and test flights of a simulated delta-wing UAV with known truth.

    Nothing is downloaded: `skdgp.dynamics` flies them, about 8 s at the first call, kept for later calls in the
    same process. The aircraft, its equations and the manoeuvres are described in docs/example_flights.md.

    Parameters
    ----------
    random_state : int, RandomState instance or None, default=0
        Seed of gusts and sensor noise. The same integer gives the same flights.
    turbulence : float, default=1.0
        Multiplies the gusts; 0 is calm air in the same steady wind.
    sensor_noise : float, default=1.0
        Multiplies the sensors' noise; 0 makes every sensor perfect.

    Returns
    -------
    data : :class:`~sklearn.utils.Bunch`
        train : pandas.DataFrame of shape (14400, 69)
            Two flights of 180 s at 40 Hz, one after the other; the column ``flight`` tells them apart and
            serves as ``groups`` of a cross-validation.
        test : pandas.DataFrame of shape (7200, 69)
            One flight along another path, at two altitudes, in stronger turbulence.
        aircraft : Aircraft
            Mass, inertia, reference lengths, thrust line and propeller.
        aerodynamics : callable
            The true model: regressors (..., 10) to CX CY CZ Cl Cm Cn (..., 6).
        regressor_names : list of str
            What the columns of the true model's regressors are (rates relative to the air, non-dimensional).
        DESCR : str
            Description of the data.

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
        train=train.copy(),
        test=test.copy(),
        aircraft=BRUMBY,
        aerodynamics=brumby_coefficients,
        regressor_names=list(REGRESSORS),
        DESCR=DESCR,
    )


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
        (true, [f"{name}_dot" for name in RATES], truth.derivative[..., SPIN]),
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
    names = list(SENSOR_NOISE)
    noise = scale * np.array([*SENSOR_NOISE.values()]) * rng.standard_normal((len(truth), len(names)))
    return pd.DataFrame(
        truth[[name + TRUTH_SUFFIX for name in names]].to_numpy() + noise, index=truth.index, columns=names
    )
