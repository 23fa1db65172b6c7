"""Small models of six coefficients."""

from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import build_up
from skdgp.kernels import ConvolvedGaussian, LinearTrend

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
RANGES = {
    "alpha": (-0.05, 0.2), "beta": (-0.15, 0.15), "p_hat": (-0.1, 0.1), "q_hat": (-0.01, 0.01), "r_hat": (-0.05, 0.05),
    "elevator": (-0.2, 0.2), "aileron": (-0.2, 0.2), "rudder": (-0.2, 0.2),
}  # fmt: skip


def alone(k):
    """Return processes of one regressor."""
    return ConvolvedGaussian(0, regressors=[k])


def linear(X):
    """Return six coefficients (n, 6), a textbook aircraft."""
    alpha, beta, p, q, r, elevator, aileron, rudder = np.asarray(X).T
    return np.stack([
        -0.03 + 0.3 * alpha, -0.5 * beta + 0.1 * rudder, -0.2 - 4.5 * alpha - 5 * q - 0.4 * elevator,
        -0.05 * beta - 0.45 * p + 0.1 * r + 0.15 * aileron, 0.02 - 0.5 * alpha - 9 * q - 0.9 * elevator,
        0.08 * beta - 0.03 * p - 0.12 * r - 0.08 * rudder,
    ], axis=-1)  # fmt: skip


def bent(X):
    """Return six coefficients with curves of alpha and of beta: additive."""
    X = np.asarray(X)
    alpha, beta = X[:, 0], X[:, 1]
    more = np.zeros((len(X), 6))
    more[:, 0] = 4 * alpha**2
    more[:, 2] = 0.3 * np.sin(20 * alpha)
    more[:, 5] = 0.3 * beta * np.abs(beta)
    return linear(X) + more


def curved(X):
    """Return six coefficients with curves, and a pair."""
    X = np.asarray(X)
    return bent(X) + np.multiply.outer(2 * X[:, 0] * X[:, 5], [0, 0, 0, 0, 1, 0])


@pytest.fixture(scope="session")
def uav():
    """Return an aircraft with a full inertia tensor."""
    return Aircraft(
        name="uav", mass=11.0, inertia=[[1.1, -0.1, 0.2], [-0.1, 2.3, 0.1], [0.2, 0.1, 2.9]],
        wing_area=1.3, span=2.6, chord=0.5,
    )  # fmt: skip


@pytest.fixture(scope="session")
def regressors():
    """Return 60 samples of eight regressors."""
    low, high = np.array(list(RANGES.values())).T
    return pd.DataFrame(np.random.default_rng(0).uniform(low, high, (60, 8)), columns=list(RANGES))


@pytest.fixture(scope="session")
def fitted(regressors, cut_short):
    """Return fitted pipelines by name, each fitted once."""
    shared = ConvolvedGaussian(1, private_latents=False, length_scale_bounds="spacing")
    noise = np.array([1e-3, 1e-3, 5e-3, 3e-4, 2e-3, 3e-4])
    options = {
        "trend": (linear, {"structure": "trend"}),
        "additive": (
            bent,
            {"kernel": LinearTrend() + alone(0) + alone(1), "trend": None, "structure": "joint"},
        ),
        "joint": (curved, {"kernel": shared, "structure": "joint"}),
        "sparse": (
            curved,
            {"kernel": shared, "structure": "joint", "inference": "sparse", "n_inducing": 40},
        ),
        "average": (curved, {"kernel": alone(0) + shared}),
        "sparse-average": (
            curved,
            {"kernel": alone(0) + shared, "inference": "sparse", "n_inducing": 20},
        ),
    }

    @cache
    def get(name):
        function, parameters = options[name]
        Y = function(regressors) + noise * np.random.default_rng(1).standard_normal(
            (len(regressors), 6)
        )
        regressor = DependentGPRegressor(max_iter=3, random_state=0, **parameters)
        model = make_pipeline(StandardScaler(), regressor)
        model[0].set_output(transform="pandas")
        with cut_short():
            return model.fit(regressors, pd.DataFrame(Y, columns=COEFFICIENTS))

    return get


@pytest.fixture(scope="session")
def built(fitted, uav):
    """Return the build-ups of the fitted pipelines by name, each made once; of main effects without pairs."""

    @cache
    def get(name):
        pairs = "none" if name == "additive" else "all"
        return build_up(fitted(name), uav, pairs=pairs, max_loss=np.inf)

    return get
