"""The example flights of a simulated delta-wing UAV, with known truth."""

from __future__ import annotations

from functools import lru_cache
from numbers import Real

import numpy as np
import pandas as pd
from sklearn.utils import Bunch, check_random_state

from skdgp._compute.sklearn_compat import Interval, validate_params
from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients
from skdgp.datasets._flight_plans import FLIGHT_PLANS
from skdgp.datasets._flight_table import flight_table, truth_of
from skdgp.datasets._simulation import fly

__all__ = ["load_example_flights"]

DURATION = 180.0
TEST_FLIGHT = "two_altitudes"

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
def load_example_flights(*, random_state=0, turbulence=1.0, sensor_noise=1.0) -> Bunch:
    """Return training and test flights of a simulated delta-wing UAV with known truth.

    Nothing is downloaded: `skdgp.dynamics` flies them, about 5 s at the first call, kept for later calls in the
    same process. The aircraft, its equations and the manoeuvres are described in docs/example_flights.md.

    Parameters
    ----------
    random_state : int, RandomState instance or None, default=0
        Seed of gusts and sensor noise. The same integer gives the same bits.
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
    if not isinstance(random_state, int | np.integer):
        random_state = check_random_state(random_state).randint(np.iinfo(np.int32).max)
    train, test = _flights(int(random_state), float(turbulence), float(sensor_noise))
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
    record = fly(FLIGHT_PLANS, duration, turbulence, np.random.default_rng(gust_seed))
    truth = truth_of(record)
    tables = {
        plan.name: flight_table(record, truth, k, plan.name, sensor_noise, np.random.default_rng(sensor_seeds[k]))
        for k, plan in enumerate(FLIGHT_PLANS)
    }
    test = tables.pop(TEST_FLIGHT)
    train = pd.concat([*tables.values()], ignore_index=True)
    return train.astype({"flight": "category"}), test.astype({"flight": "category"})
