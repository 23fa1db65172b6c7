"""A reduced model: as small as asked, and near the whole one."""

import numpy as np
import pandas as pd
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


@pytest.mark.parametrize("kind", ["average", "joint", "additive", "constant", "sparse-joint"])
def test_the_loss_is_true(smaller, portable_of, flight, kind):
    """At the samples it is a bound; on a flight that no model has seen, it is at most doubled."""
    whole = portable_of(kind)
    small, losses = smaller(kind, 0.6)
    assert small.provenance["reduction"] == losses
    stated = pd.DataFrame(losses).loc[["mean", "std"]].to_numpy()
    for X, factor in ((whole.samples, 1.0), (flight, 2.0)):
        mean, std = whole.predict(X, return_std=True, include_input_noise=False)
        changed, other = small.predict(X, return_std=True, include_input_noise=False)
        changes = np.array([(changed - mean) / std, other / std - 1.0])
        assert (np.sqrt(np.mean(changes**2, axis=1)) <= factor * stated + 1e-6).all()


def test_more_functions_lose_less(smaller):
    few, more, most = (
        pd.DataFrame(smaller("joint", fraction)[1]).max(axis=None) for fraction in (0.12, 0.2, 0.4)
    )
    assert few > more > most
    assert most < 0.05
