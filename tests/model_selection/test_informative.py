"""Rows that tell a model most, against the criterion written out."""

import numpy as np
import pandas as pd
import pytest
from sklearn.exceptions import NotFittedError
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.model_selection import informative_targets


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(0)
    table = pd.DataFrame(rng.normal(0, 1, (60, 2)), columns=["alpha", "elevator"])
    Y = pd.DataFrame({"CZ": np.sin(table["alpha"]), "Cm": table["elevator"]}) + rng.normal(0, 0.1, (60, 2))
    Y.iloc[:5] = np.nan
    return table, Y


@pytest.fixture(scope="module")
def model(log):
    regressor = DependentGPRegressor(n_latent=1, max_iter=20, random_state=0)
    return make_pipeline(StandardScaler(), regressor).fit(*log)


@pytest.mark.filterwarnings("ignore:.*max_iter")
def test_each_row_lowers_the_mean_variance_most(log, model):
    """The first three, by posterior covariances computed from scratch for each candidate."""
    table, Y = log
    X, regressor = model[:-1].transform(table)[5:], model[-1]
    noise = regressor.posterior_.noise
    K = sum(regressor.kernel_.block(i, i, X, X) / one for i, one in enumerate(noise)) / 2
    rows = []
    for _ in range(3):

        def mean_variance(one, rows=tuple(rows)):
            known = [*rows, one]
            gained = np.linalg.solve(K[np.ix_(known, known)] + np.eye(len(known)), K[known])
            return np.mean(np.diag(K) - np.einsum("ij,ij->j", K[known], gained))

        rows.append(min(set(range(55)) - set(rows), key=mean_variance))
    chosen = informative_targets(model, table, Y, 3, n_points=100)
    assert np.flatnonzero(chosen.notna().all(axis=1)).tolist() == sorted(5 + np.array(rows))
    pd.testing.assert_frame_equal(chosen.dropna(), Y.loc[chosen.dropna().index])


def test_more_than_there_are_are_all(log, model):
    table, Y = log
    pd.testing.assert_frame_equal(informative_targets(model, table, Y, 100), Y)


def test_what_cannot_be_chosen_is_said(log, model):
    table, Y = log
    with pytest.raises(ValueError, match="positive number of rows"):
        informative_targets(model, table, Y, 0)
    with pytest.raises(ValueError, match="59 targets for a table of 60 rows"):
        informative_targets(model, table, Y[1:], 5)
    with pytest.raises(NotFittedError, match="call fit first"):
        informative_targets(DependentGPRegressor(), table, Y, 5)
