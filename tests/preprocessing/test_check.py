"""FlightCheck: the error of the airspeed, and what the steps behind it refuse."""

import warnings

import numpy as np
import pytest
from made_flights import circling, make_flight
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.pipeline import make_pipeline

from skdgp.preprocessing import FlightCheck, FlightDataWarning, FlightSmoother, RegressorSelector


@pytest.mark.filterwarnings("ignore:Faults in the log")
def test_the_error_of_the_airspeed_is_told_with_its_deviation_and_corrected():
    flight = circling(0.05, gust=1.0)
    flight["airspeed"] += default_rng(0).normal(0.0, 0.1, len(flight))
    with pytest.warns(UserWarning, match=r"an error of \+5\.?\d* ± 0\.2 %"):
        out = FlightCheck().fit_transform(flight)
    assert_allclose(out["airspeed"], flight["airspeed"] / 1.05, rtol=0.005)


def log():
    table = make_flight({"alpha q": (0, 0.1, 0.005)})
    return table.assign(elevator=np.where(table.time % 10 < 1, 0.1, 0.0))


def test_what_is_not_is_refused_with_a_remedy_that_works():
    steps = make_pipeline(
        FlightCheck(), FlightSmoother(cutoff=4.0), RegressorSelector(["alpha", "q", "elevator"])
    )
    table = log()
    table.loc[700:800, "alpha"] = table["alpha"][700]
    words = r"100 of 2400 rows .*'alpha': 100.*as FlightCheck gives it"
    with pytest.warns(FlightDataWarning), pytest.raises(ValueError, match=words):
        steps.fit_transform(table)
    with pytest.warns(FlightDataWarning):
        table = FlightCheck().fit_transform(table)
    assert len(steps.fit_transform(table[np.isfinite(table.alpha)])) == 2300


def test_regressors_that_never_moved_are_named():
    """The elevator is still where there are targets; alpha moves, in whatever unit."""
    table = log().assign(rudder=0.01)
    table["alpha"] *= 1e-6
    targets = np.where(table.time < 0.9, 1.0, np.nan)
    words = r"\['elevator', 'rudder'\] never change.*cannot learn"
    with pytest.warns(FlightDataWarning, match=words):
        RegressorSelector(["alpha", "elevator", "rudder"]).fit(table, targets)
    with warnings.catch_warnings(action="error"):
        RegressorSelector(["alpha", "rudder"]).fit(table)  # without targets nothing is learned
