"""The drift of errors along a flight, as residuals show it: neighbours in time err alike."""

import numpy as np
import pytest
from made_flights import lasting
from numpy.random import default_rng
from numpy.testing import assert_allclose
from sklearn.base import clone

from skdgp import DependentGPRegressor
from skdgp.inference import residual_drift


def integral_variance(variance, memory, time):
    """Variance of the integral of a drift, by quadrature of its covariance variance * exp(-|t - t'| / memory)."""
    times = np.linspace(0, time, 801)
    return time**2 * np.mean(variance * np.exp(-np.abs(np.subtract.outer(times, times)) / memory))


STEP, MEMORY, DRIFT, WHITE = 0.05, 0.5, 0.09, 0.01


@pytest.fixture
def log():
    """Four flights, each with its own clock from zero and its own drift."""
    rng = default_rng(5)
    time = np.tile(STEP * np.arange(300), 4)
    phase = np.repeat(np.arange(4), 300)
    x = np.sin(2 * np.pi * 0.1 * time + phase) + 0.1 * rng.normal(size=1200)
    drift = np.concatenate([lasting(rng, 300, MEMORY / STEP) for _ in range(4)])
    drifting = 2 * x + np.sqrt(DRIFT) * drift + rng.normal(0, np.sqrt(WHITE), 1200)
    steady = rng.normal(0, 0.3, 1200) - x
    return x[:, None], np.column_stack([drifting, steady]), time, phase


def test_residuals_show_the_drift_and_change_nothing_else(log):
    """The fit is that of white noise; another clock has another drift, and the same posterior."""
    X, Y, time, flight = log
    Y[:400:2, 0] = np.nan
    Y[600::3, 0] = np.nan
    model = DependentGPRegressor(structure="trend", input_noise=None, random_state=0)
    other = clone(model).fit(X, Y, time=np.arange(len(X)))
    model.fit(X, Y, time=time, flight=np.array(list("abcd"))[flight])
    variance, memory = model.drift_variance_, model.drift_memory_
    assert variance[0] == pytest.approx(DRIFT, rel=0.3)
    for horizon in (0.5, 2.0, 5.0):  # what a simulated flight integrates
        expected = integral_variance(DRIFT, MEMORY, horizon)
        assert integral_variance(variance[0], memory[0], horizon) == pytest.approx(
            expected, rel=0.4
        )
    assert variance[1] * np.exp(-1.0 / memory[1]) < 0.05 * 0.3**2  # after a second
    found, expected = (
        each.posterior_.with_errors(None).predict(X[:9], True) for each in (model, other)
    )
    assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
    assert_allclose(model.noise_variance_, other.noise_variance_, rtol=1e-6)


def drift_of(residuals, time, flight):
    """Return variance and memory of the drift of residuals."""

    class Nothing:
        """A posterior whose mean is zero."""

        predict = staticmethod(np.zeros_like)

    return residual_drift(Nothing(), residuals, residuals, np.column_stack([time, flight]))


def test_an_hour_tells_a_drift_from_white_noise():
    rng = default_rng(0)
    n = 60_000
    residuals = np.sqrt(0.04) * lasting(rng, n, MEMORY / STEP) + rng.normal(0, np.sqrt(0.06), n)
    variance, memory = drift_of(residuals[:, None], STEP * np.arange(n), np.zeros(n))
    assert variance == pytest.approx(0.04, rel=0.1)
    assert memory == pytest.approx(MEMORY, rel=0.2)


def test_the_end_of_a_flight_tells_nothing_of_the_next():
    """Errors that only change from flight to flight last as long as a flight can show."""
    flight = np.repeat(np.arange(40), 20)
    offset = default_rng(0).choice([-1.0, 1.0], 40)
    residuals = offset[flight] + default_rng(1).normal(0, 0.1, 800)
    _, memory = drift_of(residuals[:, None], 0.1 * np.arange(800), flight)
    assert memory[0] == pytest.approx(1.9, rel=0.01)


@pytest.mark.parametrize("rows", [1, 2])
def test_rows_that_show_no_drift_have_none(rows):
    """Flights of one row or two."""
    residuals = default_rng(0).normal(size=(60, 1))
    variance, _ = drift_of(residuals, 0.1 * np.arange(60), np.arange(60) // rows)
    assert variance < 1e-6 * np.mean(residuals**2)


@pytest.mark.parametrize(
    ("clock", "words"),
    [
        ({"flight": np.zeros(50)}, "flight without time"),
        ({"time": np.arange(49.0)}, r"\(49,\).*\(50,\)"),
        ({"time": np.arange(50.0), "flight": ["a"] * 48 + [None, None]}, "2 rows without a flight"),
        (
            {"time": np.datetime64("2026-01-01", "ms") + np.arange(50)},
            r"datetime64.*expected seconds",
        ),
    ],
)
def test_rows_must_say_when_they_were(clock, words):
    X = default_rng(0).normal(size=(50, 1))
    with pytest.raises(ValueError, match=words):
        DependentGPRegressor(structure="trend").fit(X, X[:, 0], **clock)
