"""A reduced model: as small as asked, and near the whole one."""

import numpy as np
import pytest

from skdgp.export import export_model, load_portable


@pytest.fixture
def smaller(portable_of, tmp_path):
    """Return a function of a kind and a fraction of its size: the reduced model, and the size allowed."""

    def get(kind, fraction):
        (whole,) = export_model(tmp_path, portable_of(kind), "portable")["files"]
        most = fraction * whole.stat().st_size
        facts = export_model(tmp_path, portable_of(kind), "portable", max_kb=most / 1024)
        assert facts["files"][0].stat().st_size <= most
        return load_portable(facts["files"][0]), facts["loss"]

    return get


@pytest.mark.parametrize("kind", ["average", "full", "additive", "constant", "sparse"])
def test_the_loss_is_true(smaller, portable_of, kind):
    small, losses = smaller(kind, 0.6)
    X = portable_of(kind).samples
    mean, std = portable_of(kind).predict(X, return_std=True, include_input_noise=False)
    changed, other = small.predict(X, return_std=True, include_input_noise=False)
    of_mean = np.sqrt(np.mean(((changed - mean) / std) ** 2, axis=0))
    of_std = np.sqrt(np.mean((other / std - 1) ** 2, axis=0))
    least = 0.01  # of a standard deviation: losses below it are none
    assert (of_mean <= 3 * np.array([each["mean"] for each in losses.values()]) + least).all()
    assert (of_std <= 3 * np.array([each["std"] for each in losses.values()]) + least).all()
    assert small.provenance["reduction"] == losses


def test_more_functions_lose_less(smaller):
    few, more, most = (
        max(max(loss.values()) for loss in smaller("joint", fraction)[1].values())
        for fraction in (0.1, 0.2, 0.4)
    )
    assert few > more > most
    assert most < 0.05
