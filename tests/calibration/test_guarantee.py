"""What is promised of flights to come, by simulation; quantiles against their definition."""

import numpy as np
import pytest
from scipy.signal import lfilter
from sklearn.base import BaseEstimator, RegressorMixin

from skdgp.calibration import CalibratedRegressor, unit_weights, units_needed, weighted_quantile


class Standard(RegressorMixin, BaseEstimator):
    """Predict 0 with deviation 1, whatever it is given."""

    def fit(self, X, y):
        self.n_features_in_ = 1
        return self

    def predict(self, X, return_std=False):
        mean = np.zeros(len(X))
        return (mean, mean + 1.0) if return_std else mean


def flight(rng):
    """Errors of one flight: they remember 50 samples; rough flights are short, calm ones long; each has an offset."""
    rough = rng.random() < 0.3
    errors = lfilter([0.2], [1, -0.98], rng.normal(size=200 + (40 if rough else 400)))[200:]
    return errors * (4.0 if rough else 0.5) + 0.5 * rng.normal()


def calibrated(flights, **parameters):
    y = np.concatenate(flights)
    groups = np.repeat(np.arange(len(flights)), [len(one) for one in flights])
    return CalibratedRegressor(Standard().fit(None, None), cv="prefit", **parameters).fit(
        y[:, None], y, groups=groups
    )


def held_by(model, errors):
    lower, upper = model.predict_interval(errors[:, None])
    return np.mean((lower <= errors) & (errors <= upper))


@pytest.mark.parametrize(("n_flights", "level"), [(9, 0.6), (19, 0.95)])
def test_next_flight_is_held_and_pooling_samples_does_not(n_flights, level):
    rng = np.random.default_rng(7)
    held, pooled = [], []
    for _ in range(150):
        flights, to_come = [flight(rng) for _ in range(n_flights)], flight(rng)
        held.append(held_by(calibrated(flights, level=level), to_come))
        pooled.append(
            np.mean(np.abs(to_come) <= np.quantile(np.abs(np.concatenate(flights)), level))
        )
    assert np.mean(held) >= level
    assert np.mean(pooled) < level - 0.08


def test_many_flights_leave_no_surplus():
    rng = np.random.default_rng(1)
    bound = calibrated([flight(rng) for _ in range(1500)], level=0.8).predict_interval(
        np.zeros((1, 1))
    )[1]
    assert np.mean([np.mean(np.abs(flight(rng)) <= bound) for _ in range(1500)]) == pytest.approx(
        0.8, abs=0.02
    )


def test_without_a_guarantee_the_band_is_what_held_on_these_flights():
    rng = np.random.default_rng(2)
    flights = [flight(rng) for _ in range(3)]
    with pytest.warns(
        UserWarning, match=r"3 flights guarantee no more than 0.75.*Calibrate on 19 .*level=0.75"
    ):
        model = calibrated(flights, level=0.95)
    assert not model.guaranteed_.any()
    assert np.mean([held_by(model, one) for one in flights]) == pytest.approx(0.95, abs=0.03)


@pytest.mark.parametrize("level", [0.3, 0.5, 0.75, 0.799])
def test_quantile_against_its_definition(level):
    rng = np.random.default_rng(3)
    units = np.repeat([0, 1, 2, 3], [5, 50, 1, 17])
    scores = np.abs(rng.normal(size=len(units))).round(1)  # with ties
    K = 4

    def share(q):
        return sum(np.mean(scores[units == k] <= q) for k in range(K)) / (K + 1)

    expected = min(q for q in scores if share(q) >= level - 1e-12)
    assert weighted_quantile(scores, unit_weights(units) * K / (K + 1), level) == expected


def test_flights_needed():
    assert [units_needed(level) for level in (0.5, 0.75, 0.8, 0.9, 0.95, 0.99)] == [
        1,
        3,
        4,
        9,
        19,
        99,
    ]
    for level in (0.5, 0.66, 0.9, 0.95, 0.975):
        n = units_needed(level)
        assert n / (n + 1) >= level - 1e-12 > (n - 1) / n - 1e-12
