"""Small models of every kind of posterior that can be exported, and the model that identify makes."""

import warnings
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pytest
from flight_columns import COEFFICIENTS, SURFACES
from made_flights import LINEAR_GLIDER
from numpy.random import default_rng
from sklearn.utils import Bunch

from skdgp import DependentGPRegressor
from skdgp.dynamics import as_aerodynamics
from skdgp.export import portable_model, save_portable
from skdgp.identification import identify, make_identification_pipeline
from skdgp.kernels import ConvolvedGaussian, LinearTrend

REGRESSORS = ["alpha", "beta", "q_hat", *SURFACES]
JOINT = {"structure": "joint"}
SPARSE = {"inference": "sparse", "n_inducing": 9}
ALONE = ConvolvedGaussian(0)
AVERAGE = {"kernel": ALONE + ConvolvedGaussian(1, private_latents=False)}
KINDS = {
    "average": AVERAGE,
    "joint": JOINT,
    "own trend": JOINT | {"kernel": LinearTrend() + ALONE, "trend": None},
    "trend": {"structure": "trend"},
    "constant": JOINT | {"trend": "constant"},
    "noisy": JOINT | {"input_noise": [0.05] * 6},
    "sparse": SPARSE | AVERAGE,
    "sparse-joint": SPARSE | JOINT,
    "sparse-constant": SPARSE | JOINT | {"trend": "constant"},
    "precise": JOINT | {"max_iter": 20},  # little noise: the variance is a millionth of the prior
}
AIRCRAFT = LINEAR_GLIDER.aircraft
# Of a textbook aircraft, by REGRESSORS
SLOPES = LINEAR_GLIDER.slopes[:, [0, 1, 3, 5, 6, 7]]


def textbook_flight(n, seed, noise=1e-3):
    """Return a flight of random states, and the coefficients of a textbook aircraft with curves."""
    rng = default_rng(seed)
    X = rng.normal(0.0, 0.1, (6, n)).T * [1.0, 1.0, 0.05, 1.0, 1.0, 1.0]
    speed = rng.uniform(20.0, 30.0, n)
    alpha, beta, q_hat, elevator, aileron, rudder = X.T
    Y = LINEAR_GLIDER.level + X @ SLOPES.T + rng.normal(0.0, noise, (n, 6))
    Y[:, 0] += 4 * alpha**2
    Y[:, 2] += 0.1 * np.sin(20 * alpha)
    Y[:, 4] += alpha * elevator
    flight = {
        "time": 0.1 * np.arange(n), "airspeed": speed, "alpha": alpha, "beta": beta, "rudder": rudder,
        "q": q_hat * 2 * speed / AIRCRAFT.chord,
        "elevon_left": elevator + aileron, "elevon_right": elevator - aileron,
    }  # fmt: skip
    return pd.DataFrame(flight), pd.DataFrame(Y, columns=COEFFICIENTS)


def pipeline_of(regressor, aircraft=AIRCRAFT, **options):
    """Return an identification pipeline without smoothing."""
    options = {"regressors": REGRESSORS, "cutoff": None, "regressor": regressor} | options
    model = make_identification_pipeline(aircraft, reconstruction="passthrough", **options)
    return model.set_params(flightcheck="passthrough", flightsmoother="passthrough")


IDENTIFIED = "identified"


@pytest.fixture(scope="session")
def identified(made_once, first_minute, cut_short):
    """Return the pipeline that `identify` makes, its aircraft and a flight that it has not seen.

    The default model of few rows, sparse.
    """

    def make():
        data = first_minute()
        train, test = data.train[data.train["time"] < 8], data.test[data.test["time"] < 4]
        regressor = DependentGPRegressor(
            inference="sparse", n_inducing=12, n_latent=1, max_iter=10, random_state=0
        )
        options = {"test": test, "samples": 120, "regressor": regressor, "horizon": 1.0}
        with cut_short(), warnings.catch_warnings(action="ignore"):  # of few rows
            found = identify(train, data.aircraft, **options)
        return Bunch(pipeline=found.pipeline, aircraft=found.aircraft, flight=test)

    return made_once("identified to export", make)


@pytest.fixture(scope="session")
def fitted(cut_short):
    """Return a function of a kind: what its model file holds; each kind is fitted once."""

    @cache
    def get(kind):
        options = {"max_iter": 2, "random_state": 0} | KINDS[kind]
        if "kernel" not in options:
            options["n_latent"] = 1
        flight, Y = textbook_flight(28, 0, 1e-6 if kind == "precise" else 1e-3)
        with cut_short(), warnings.catch_warnings(action="ignore"):  # of few rows
            model = pipeline_of(DependentGPRegressor(**options)).fit(flight, Y)
        return Bunch(
            pipeline=model, aircraft=AIRCRAFT, created="2026-01-01", versions={"skdgp": "1"}
        )

    return get


@pytest.fixture
def in_another_order():
    """Return a trend of coefficients that are not in their usual order, and the aircraft."""
    flight, Y = textbook_flight(28, 0)
    learner = DependentGPRegressor(structure="trend", random_state=0)
    with warnings.catch_warnings(action="ignore"):  # of few rows
        pipeline = pipeline_of(learner).fit(flight, Y[["Cm", "CX", "CY", "CZ", "Cl", "Cn"]])
    return pipeline, AIRCRAFT


@pytest.fixture
def read(example, tmp_path):
    """Return a function of a portable model: its file, as the example reads it."""
    reader = example("read_portable")
    return lambda model: reader.Model(save_portable(tmp_path / "model.npz", model))


@pytest.fixture(scope="session")
def portable_of(fitted):
    """Return a function of a kind: its portable model."""
    return cache(lambda kind: portable_model(**fitted(kind)))


class Case(NamedTuple):
    """A pipeline, its portable model, and what the PIPELINE predicts at points in and near a flight."""

    pipeline: Any
    model: Any
    flight: pd.DataFrame
    X: np.ndarray  # regressors in their units
    mean: np.ndarray
    std: np.ndarray  # at exact regressors
    slopes: np.ndarray

    def predict(self, noise):
        """Return mean and standard deviation of the pipeline with a factor of the regressors' noise."""
        table = pd.DataFrame(self.X, columns=self.model.regressor_names)
        tail = self.pipeline[-2:]  # the scaler and the regressor
        return tail.predict(table, return_std=True, include_input_noise=noise)

    def with_noise(self, noise):
        """Return the case whose moments are those with a factor of the regressors' noise."""
        mean, std = self.predict(noise)
        return self._replace(mean=mean, std=std)

    def assert_moments(self, moments):
        mean, std = moments
        self.assert_mean(mean)
        self.assert_std(std)

    def assert_mean(self, mean, tolerance=1e-9):
        """The tolerance is of the largest value of each coefficient."""
        assert (np.abs(mean - self.mean) <= tolerance * np.abs(self.mean).max(axis=0)).all()

    def assert_std(self, std):
        """Within 1e-6 of the largest value of each coefficient: variances are differences of large sums."""
        assert (np.abs(std - self.std) <= 1e-6 * self.std.max(axis=0)).all()

    def assert_slopes(self, slopes, tolerance=1e-9):
        """The tolerance is of the largest slope of each coefficient, by scaled regressors."""
        expected = self.slopes * self.model.scale
        largest = np.abs(expected).max(axis=(0, 2), keepdims=True)
        assert (np.abs(slopes * self.model.scale - expected) <= tolerance * largest).all()


@pytest.fixture(scope="session")
def case_of(request, fitted, portable_of):
    """Return a function of a kind: its `Case`."""

    def get(kind):
        if kind == IDENTIFIED:
            model = request.getfixturevalue("identified")
            portable = portable_model(model.pipeline, model.aircraft)
        else:
            model, portable = (
                fitted(kind) | {"flight": textbook_flight(30, 3)[0]},
                portable_of(kind),
            )
            model = Bunch(**model)
        rng = default_rng(5)
        flown = np.asarray(model.pipeline[:-2].transform(model.flight))
        X = flown[rng.choice(len(flown), 30, replace=False)]
        X[1::2] += 0.5 * flown.std(axis=0) * rng.standard_normal(X[1::2].shape)
        slopes = as_aerodynamics(model.pipeline).gradient(X)
        return Case(model.pipeline, portable, model.flight, X, X, X, slopes).with_noise(0.0)

    return cache(get)


@pytest.fixture(params=[IDENTIFIED, *KINDS])
def case(request, case_of):
    """Return the `Case` of each kind, in turn."""
    return case_of(request.param)


# Mixtures, terms that share entries, no functions, no slopes, and little noise: what a writer can meet
WRITTEN = [IDENTIFIED, "average", "own trend", "trend", "sparse-constant", "precise"]


@pytest.fixture(params=WRITTEN)
def written(request, case_of):
    """Return the `Case` of each kind whose arrays differ in shape, for writers and readers of these."""
    return case_of(request.param)


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
    return textbook_flight(30, 3)[0]
