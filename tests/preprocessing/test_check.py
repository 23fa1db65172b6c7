"""The error of the airspeed, and regressors that never moved."""

import warnings

import numpy as np
import pytest
from made_flights import circling, make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.preprocessing import FlightCheck, FlightDataWarning, RegressorSelector


@pytest.mark.filterwarnings("ignore:Faults in the log")
def test_the_error_of_the_airspeed_is_told_with_its_deviation_and_corrected():
    flight = circling(0.05, gust=1.0)
    flight["airspeed"] += default_rng(0).normal(0.0, 0.1, len(flight))
    with pytest.warns(UserWarning, match=r"an error of \+5\.?\d* ± 0\.2 %"):
        out = FlightCheck().fit_transform(flight)
    assert_allclose(out["airspeed"], flight["airspeed"] / 1.05, rtol=0.005)


def test_regressors_that_never_moved_are_named():
    """The elevator is still where there are targets; alpha moves, in whatever unit."""
    table = make_flight({"alpha": (0, 0.1, 0.005)}).assign(rudder=0.01)
    table["elevator"] = np.where(table.time % 10 < 1, 0.1, 0.0)
    table["alpha"] *= 1e-6
    targets = np.where(table.time < 0.9, 1.0, np.nan)
    words = r"\['elevator', 'rudder'\] never change.*cannot learn"
    with pytest.warns(FlightDataWarning, match=words):
        RegressorSelector(["alpha", "elevator", "rudder"]).fit(table, targets)
    with warnings.catch_warnings(action="error"):
        RegressorSelector(["alpha", "rudder"]).fit(table)  # without targets nothing is learned
