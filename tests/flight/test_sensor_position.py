"""Inertial sensors away from the centre of gravity: kinematics of a rigid body."""

import numpy as np
import pandas as pd
import pytest
from flight_columns import FORCES, POSITION, RATES
from log_errors import placed
from made_flights import GLIDER, flight_of_motion
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy.spatial.transform import Rotation

from skdgp.dynamics import aerodynamic_coefficients
from skdgp.preprocessing import FlightPathReconstruction

ARM = [0.5, -0.2, 0.3]
STEP = 0.01


def tumbling(arm):
    """Return what sensors at ``arm`` read of a rigid body that rotates about the origin, without gravity."""

    def attitude(t):
        return Rotation.from_euler(
            "ZYX", np.stack([0.7 * np.sin(t), 0.4 * np.cos(1.3 * t), 0.5 * t], axis=-1)
        )

    def velocity(t):
        return (attitude(t + 1e-4).apply(arm) - attitude(t - 1e-4).apply(arm)) / 2e-4

    flight = flight_of_motion(np.arange(0, 6, STEP), attitude, velocity, gravity=0.0)
    return flight[["time", *RATES, *FORCES]]


def at_centre_of_gravity(flight):
    """Return a flight that lacks what its path needs, so that its forces alone are moved."""
    return FlightPathReconstruction().fit_transform(flight)


def test_an_unknown_position_stays_unknown_beside_a_known_one():
    known = placed(tumbling(ARM), ARM).assign(flight="known")
    unknown = placed(tumbling(ARM), [np.nan] * 3).assign(flight="unknown")
    moved = at_centre_of_gravity(pd.concat([known, unknown], ignore_index=True)).set_index("flight")
    assert_allclose(moved.loc["known", POSITION], 0.0)
    assert moved.loc["unknown", POSITION].isna().all(axis=None)


@pytest.mark.parametrize(
    "stated",
    [{}, {"sensor_position_x": 0.5}, dict.fromkeys(POSITION, 0.0), dict.fromkeys(POSITION, np.nan)],
)
def test_sensors_at_the_centre_or_at_an_unknown_place_read_as_they_are(stated):
    """Two of three columns state nothing."""
    flight = tumbling(ARM)
    assert_frame_equal(at_centre_of_gravity(flight.assign(**stated))[flight.columns], flight)


@pytest.mark.parametrize(
    ("x", "expected"), [(200.0, "expected metres"), (np.inf, "Got infinite values")]
)
def test_columns_that_are_no_metres_are_refused(x, expected):
    level = dict.fromkeys([*RATES, *FORCES], 0.0) | {"az": -9.8, "airspeed": 20.0, "density": 1.2}
    flight = pd.DataFrame({"time": np.arange(0, 4, STEP), **level})
    with pytest.raises(ValueError, match=expected):
        aerodynamic_coefficients(placed(flight, [x, 0.0, 0.0]), GLIDER, thrust=None)


def test_gyros_slower_than_accelerometers_tell_the_rotation_between_their_samples():
    flight = placed(tumbling(ARM), ARM)
    flight.loc[np.arange(len(flight)) % 2 == 1, RATES] = np.nan
    assert_allclose(at_centre_of_gravity(flight)[FORCES][5:-5], 0.0, atol=5e-3)
