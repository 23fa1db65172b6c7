"""Small models of every kind of posterior that can be exported, fitted in a moment."""

import warnings
from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.utils import Bunch

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import portable_model
from skdgp.identification import make_identification_pipeline
from skdgp.kernels import ConvolvedGaussian, LinearTrend

COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
REGRESSORS = ["alpha", "beta", "q_hat", "elevator", "aileron", "rudder"]
JOINT = {"structure": "joint"}
SPARSE = {"inference": "sparse", "n_inducing": 9}
ALONE = ConvolvedGaussian(0, regressors=[0]) + ConvolvedGaussian(0, regressors=[2])
AVERAGE = {"kernel": ALONE + ConvolvedGaussian(1, private_latents=False)}
KINDS = {
    "average": AVERAGE,
    "joint": JOINT,
    "additive": JOINT | {"kernel": LinearTrend() + ALONE, "trend": None},
    "trend": {"structure": "trend"},
    "constant": JOINT | {"trend": "constant"},
    "noisy": JOINT | {"input_noise": "learned"},
    "sparse": SPARSE | AVERAGE,
    "sparse-joint": SPARSE | JOINT,
    "sparse-constant": SPARSE | JOINT | {"trend": "constant"},
    "precise": JOINT | {"max_iter": 20},  # little noise: the variance is a millionth of the prior
}
AIRCRAFT = Aircraft(
    name="uav", mass=11.0, inertia=[[1.1, -0.1, 0.2], [-0.1, 2.3, 0.1], [0.2, 0.1, 2.9]],
    wing_area=1.3, span=2.6, chord=0.5,
)  # fmt: skip


def make_flight(n, seed, noise=1e-3):
    """Return a flight of random states, and the coefficients of a textbook aircraft with curves."""
    rng = np.random.default_rng(seed)
    x = {name: rng.normal(0.0, 0.1, n) for name in REGRESSORS}
    x["q_hat"] /= 20
    speed = rng.uniform(20.0, 30.0, n)
    Y = np.stack([
        -0.03 + 0.3 * x["alpha"] + 4 * x["alpha"] ** 2, -0.5 * x["beta"] + 0.1 * x["rudder"],
        -0.2 - 4.5 * x["alpha"] - 5 * x["q_hat"] - 0.4 * x["elevator"] + 0.1 * np.sin(20 * x["alpha"]),
        -0.05 * x["beta"] + 0.15 * x["aileron"],
        0.02 - 0.5 * x["alpha"] - 9 * x["q_hat"] - 0.9 * x["elevator"] + x["alpha"] * x["elevator"],
        0.08 * x["beta"] - 0.08 * x["rudder"],
    ], axis=-1)  # fmt: skip
    flight = {"alpha": x["alpha"], "beta": x["beta"], "rudder": x["rudder"], "airspeed": speed}
    flight["q"] = x["q_hat"] * 2 * speed / AIRCRAFT.chord
    flight["elevon_left"] = x["elevator"] + x["aileron"]
    flight["elevon_right"] = x["elevator"] - x["aileron"]
    flight = pd.DataFrame(flight).assign(time=0.1 * np.arange(n))
    return flight, pd.DataFrame(Y + rng.normal(0.0, noise, Y.shape), columns=COEFFICIENTS)


def pipeline_of(regressor, aircraft=AIRCRAFT, **options):
    """Return an identification pipeline without smoothing."""
    options = {"regressors": REGRESSORS, "cutoff": None, "regressor": regressor} | options
    model = make_identification_pipeline(aircraft, reconstruction="passthrough", **options)
    return model.set_params(flightcheck="passthrough", flightsmoother="passthrough")


@pytest.fixture(scope="session")
def fitted(cut_short):
    """Return a function of a kind: what its model file holds; each kind is fitted once."""

    @cache
    def get(kind):
        options = {"max_iter": 2, "random_state": 0} | KINDS[kind]
        if "kernel" not in options:
            options["n_latent"] = 1
        with cut_short(), warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of few rows
            model = pipeline_of(DependentGPRegressor(**options)).fit(
                *make_flight(28, 0, 1e-6 if kind == "precise" else 1e-3)
            )
        return Bunch(
            pipeline=model, aircraft=AIRCRAFT, created="2026-01-01", versions={"skdgp": "1"}
        )

    return get


@pytest.fixture(scope="session")
def portable_of(fitted):
    """Return a function of a kind: its portable model."""
    return cache(lambda kind: portable_model(**fitted(kind)))


@pytest.fixture(params=KINDS)
def kind(request):
    return request.param


@pytest.fixture
def portable(portable_of, kind):
    """Return the portable model of each kind, in turn."""
    return portable_of(kind)


@pytest.fixture(scope="session")
def flight():
    """Return a flight that no model has seen."""
    return make_flight(30, 3)[0]
