import numpy as np
import pandas as pd
import pytest

from skdgp.datasets._example_flights import SENSOR_NOISE, measure

N = 40_000


@pytest.fixture(scope="module")
def truth():
    wave = np.sin(np.arange(N) / 50.0)
    return pd.DataFrame({name + "_true": k + wave for k, name in enumerate(SENSOR_NOISE)})


@pytest.fixture(scope="module")
def errors(truth):
    return measure(truth, 1.0, np.random.default_rng(4)) - truth.rename(
        columns=lambda name: name[:-5]
    )


def test_noise_has_the_stated_levels(errors):
    np.testing.assert_allclose(errors.std(), [SENSOR_NOISE[name] for name in errors], rtol=0.02)
    assert (abs(errors.mean()) < 5 * errors.std() / np.sqrt(N)).all()


def test_noise_is_white_and_independent(errors):
    scaled = (errors / errors.std()).to_numpy()
    for lag in (1, 2, 17):
        assert abs((scaled[lag:] * scaled[:-lag]).mean(axis=0)).max() < 5 / np.sqrt(N)
    between = np.corrcoef(scaled.T) - np.eye(scaled.shape[1])
    assert abs(between).max() < 5 / np.sqrt(N)


def test_perfect_sensors_tell_the_truth(truth):
    measured = measure(truth, 0.0, np.random.default_rng(0))
    np.testing.assert_array_equal(measured.to_numpy(), truth.to_numpy())
