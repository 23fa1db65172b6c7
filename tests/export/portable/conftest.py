"""Small models of every kind of posterior that can be exported, fitted in a moment."""

import warnings
from functools import cache

import numpy as np
import pandas as pd
import pytest
from sklearn.utils import Bunch

from skdgp import DependentGPRegressor
from skdgp._flight.channels import COEFFICIENTS
from skdgp.calibration import CalibratedRegressor
from skdgp.dynamics import Aircraft
from skdgp.export import portable_model
from skdgp.identification import make_identification_pipeline

REGRESSORS = ["alpha", "beta", "q_hat", "elevator", "aileron"]
AVERAGE = {"n_latent": 1, "max_iter": 2, "random_state": 0}
QUICK = AVERAGE | {"structure": "joint"}
KINDS = {
    "exact": AVERAGE,
    "full": QUICK | {"covariance_type": "full"},
    "additive": QUICK | {"structure": "additive"},
    "trend": QUICK | {"structure": "trend"},
    "constant": QUICK | {"trend": "constant"},
    "noisy": QUICK | {"input_noise": 0.1},
    "sparse": AVERAGE | {"inference": "sparse", "n_inducing": 9},
    "sparse-additive": QUICK | {"inference": "sparse", "structure": "additive", "n_inducing": 9},
    "sparse-constant": QUICK | {"inference": "sparse", "trend": "constant", "n_inducing": 9},
    "calibrated": QUICK | {"input_noise": 0.1},
    "precise": QUICK | {"max_iter": 20},  # little noise: the variance is a millionth of the prior
}
AIRCRAFT = Aircraft(
    name="glider",
    mass=2.0,
    inertia=[[0.2, 0, -0.01], [0, 0.3, 0], [-0.01, 0, 0.4]],
    wing_area=0.5,
    span=2.0,
    chord=0.25,
)


def make_flight(n=28, seed=0, noise=0.01):
    """Return a flight of random states, and coefficients that are smooth functions of them plus noise."""
    rng = np.random.default_rng(seed)
    flight = pd.DataFrame(
        rng.normal(0.0, 0.1, (n, 5)), columns=["alpha", "beta", "q", "elevon_left", "elevon_right"]
    )
    flight["airspeed"], flight["time"] = rng.uniform(15.0, 25.0, n), 0.1 * np.arange(n)
    elevator, aileron = (
        flight.elevon_left + flight.elevon_right,
        flight.elevon_left - flight.elevon_right,
    )
    truth = [
        flight.alpha**2 - 0.05, flight.beta, -4 * flight.alpha + np.sin(20 * flight.alpha) / 20, 0.1 * aileron,
        -0.5 * flight.alpha - 0.6 * elevator - 0.05 * flight.q, 0.1 * flight.beta + 0.2 * flight.beta * flight.alpha,
    ]  # fmt: skip
    Y = np.column_stack(truth) + rng.normal(0.0, noise, (n, 6))
    return flight, pd.DataFrame(Y, columns=COEFFICIENTS)


@cache
def fitted(kind):
    """Return the pipeline and the aircraft of one kind of model."""
    flight, Y = make_flight(25, noise=1e-6) if kind == "precise" else make_flight()
    regressor = DependentGPRegressor(**KINDS[kind])
    if kind == "calibrated":
        regressor = CalibratedRegressor(regressor, method="variance", level=0.5, cv=2)
    model = make_identification_pipeline(
        AIRCRAFT,
        regressors=REGRESSORS,
        reconstruction="passthrough",
        cutoff=None,
        regressor=regressor,
    )
    model.set_params(flightcheck="passthrough", flightsmoother="passthrough").fit(flight, Y)
    return Bunch(
        pipeline=model,
        aircraft=AIRCRAFT,
        created="2026-01-01T00:00:00+00:00",
        versions={"skdgp": "1"},
    )


@cache
def exported(kind):
    """Return the portable model of one kind of model."""
    return portable_model(**fitted(kind))


@pytest.fixture(params=KINDS)
def kind(request, short_fits):
    quietly(fitted)(request.param)
    return request.param


@pytest.fixture
def model(kind):
    """Return what a model file of each kind holds, in turn."""
    return fitted(kind)


@pytest.fixture
def portable(kind):
    """Return the portable model of the same."""
    return exported(kind)


def quietly(function):
    """Return the function without the warnings of so short fits."""

    def quiet(kind):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return function(kind)

    return quiet


@pytest.fixture
def fitted_of(short_fits):
    """Return what the model file of one kind holds."""
    return quietly(fitted)


@pytest.fixture
def portable_of(short_fits):
    """Return the portable model of one kind."""
    return quietly(exported)


@pytest.fixture
def exact(portable_of):
    """Return the portable model of an exact posterior."""
    return portable_of("exact")


@pytest.fixture
def flight():
    """Return a flight that no model has seen."""
    return make_flight(30, seed=3)[0]
