"""Whether an aircraft has changed since its model was learned."""

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter
from scipy.stats import kstest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.identification import changes_of
from skdgp.preprocessing import RegressorSelector

NAMES = ["alpha", "q_hat", "elevator"]
SLOPES = np.array([[0.3, 0.0, -4.0, 0.0, -0.5, 0.0], [0.0] * 6, [0.0] * 4 + [-0.6, 0.0]])


def lasting(rng, shape, memory):
    """Return noise of variance 1 whose correlation falls by e in ``memory`` rows."""
    keep = np.exp(-1 / memory)
    noise = rng.normal(size=shape)
    size = np.sqrt(1 - keep**2)
    noise[0] /= size  # the first one has a variance of 1, too
    return lfilter([size], [1.0, -keep], noise, axis=0)


def flight(seed, noise, n=1500):
    """Return regressors and coefficients of a flight with errors that last."""
    rng = np.random.default_rng(seed)
    X = pd.DataFrame(0.1 * lasting(rng, (n, 3), 15), columns=NAMES)
    return X, X.to_numpy() @ SLOPES + noise * lasting(rng, (n, 6), 5)


def learned_from(seed):
    """Return a pipeline that knows an aircraft by a flight."""
    X, Y = flight(seed, 0.02)
    regressor = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
    pipeline = make_pipeline(RegressorSelector(NAMES), StandardScaler(), regressor)
    time = np.arange(len(X)) * 0.05
    return pipeline.fit(X, Y, dependentgpregressor__time=time)


@pytest.fixture(scope="module")
def model():
    return learned_from(0)


def changes(model, flights, change=0.0):
    """Return the changes that flights show whose alpha by Cm is changed."""
    samples = {}
    for name, (X, Y) in flights.items():
        Y = Y.copy()
        Y[:, 4] += change * X["alpha"]
        samples[name] = np.asarray(model[:-1].transform(X)), Y - model.predict(X)
    return changes_of(model, samples)


def test_flights_of_the_same_aircraft_in_other_gusts_raise_few_alarms(model):
    flights = {
        str(seed): flight(seed, noise) for seed, noise in enumerate([0.01, 0.02, 0.04] * 20, 1)
    }
    p_values = changes(model, flights).p_values
    assert (p_values < 0.05).mean().max() < 0.2


@pytest.mark.slow
def test_p_values_of_unchanged_aircraft_are_uniform():
    """Each of its own model, as all flights share the error of one."""
    rows = []
    for seed in range(20):
        unseen = {"unseen": flight(100 + seed, [0.01, 0.02, 0.04][seed % 3])}
        rows.append(changes(learned_from(50 + seed), unseen).p_values.loc["unseen"])
    p_values = pd.DataFrame(rows).drop(columns="whole")
    for coefficient in p_values:
        assert kstest(p_values[coefficient], "uniform").pvalue > 0.001


def test_a_change_is_found_in_its_coefficient_and_its_size_is_within_its_band(model):
    result = changes(model, {"iced": flight(100, 0.02)}, change=0.2)
    p_values = result.p_values.loc["iced"]
    assert p_values["Cm"] < 0.01
    assert p_values["whole"] < 0.05
    row = result.derivatives.loc[("iced", "Cm_alpha")]
    assert abs(row["change"] - 0.2) < 3 * row["std"]
    assert "has changed" in result.summary()[0]
    assert "Cm_alpha" in result.summary()[0]


def test_a_short_flight_tells_nothing(model):
    X, Y = flight(7, 0.02)
    result = changes(model, {"short": (X[:25], Y[:25])}, change=1.0)
    assert result.p_values.isna().all(axis=None)
    assert "too short" in result.summary()[0]
