"""Output error on a glider whose truth is an affine correction away."""

import pickle

import numpy as np
import pytest

from skdgp._mechanics.aerodynamics import Drift
from skdgp.dynamics import Aerodynamics, Aircraft, fit_output_error, simulate

GLIDER = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
NAMES = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator"]
MEAN = np.array([
    [-0.02, 0.3, 0, 0, 0, 0, 0], [0, 0, -0.4, 0, 0, 0, 0], [-0.2, -4.5, 0, 0, 0, 0, 0],
    [0, 0, -0.05, -0.4, 0, 0.1, 0], [0.02, -0.4, 0, 0, -8, 0, -0.8], [0, 0, 0.08, 0, 0, -0.1, 0],
])  # fmt: skip
UNSURE = {(4, 1): 0.1, (4, 6): 0.2, (3, 2): 0.02}
"""Weights of which the posterior is not sure, with their standard deviations."""
TRUE = MEAN + np.array([[1.3 * UNSURE.get((i, k), 0.0) for k in range(7)] for i in range(6)])
NOISE = {"phi": 0.002, "theta": 0.002, "p": 0.01, "q": 0.01}


def basis(X):
    return np.concatenate([np.ones((*X.shape[:-1], 1)), X], axis=-1)


def values(X, weights):
    return basis(X) @ np.swapaxes(weights, -1, -2)


def mean(X):
    return values(X, MEAN)


def sampler(n_paths, random_state):
    rng = np.random.default_rng(random_state)
    weights = np.tile(MEAN, (n_paths, 1, 1))
    for at, std in UNSURE.items():
        weights[:, *at] += std * rng.standard_normal(n_paths)
    return lambda X: values(X, weights), None


def covariance(X):
    roots = [np.kron(np.eye(6)[i], std * basis(X)[:, k]) for (i, k), std in UNSURE.items()]
    return sum(np.outer(root, root) for root in roots)


@pytest.fixture(scope="module")
def model():
    drift = Drift(np.full(6, 1e-8), np.ones(6))
    return Aerodynamics(mean, NAMES, sampler=sampler, covariance=covariance, drift=drift)


def records(weights, n, rng=None, duration=1.0):
    """Flights from different starts, elevator moving, with noise of the sensors."""
    truth = Aerodynamics(lambda X: values(X, weights), NAMES)
    found = []
    for k in range(n):
        start = {"airspeed": 12.0, "alpha": 0.03 * k, "beta": 0.02 * (-1) ** k, "altitude": 100.0}
        controls = lambda t, state, k=k: {"elevator": -0.01 + 0.03 * np.sin(6 * t + k)}  # noqa: E731
        flown = simulate(truth, GLIDER, start, controls, duration=duration, thrust=None)
        for name, std in NOISE.items() if rng else ():
            flown[name] += rng.normal(0, std, len(flown))
        found.append(flown.assign(flight=str(k)))
    return found


@pytest.fixture(scope="module")
def fitted(model):
    return fit_output_error(
        model, GLIDER, records(TRUE, 4, np.random.default_rng(0)), NOISE, thrust=None
    )


def weights_of(aerodynamics):
    """Return the weights of an affine model."""
    return np.column_stack([aerodynamics(np.zeros(6)), aerodynamics.gradient(np.zeros(6))])


def test_recovers_what_the_posterior_was_not_sure_of(model, fitted):
    off, before = (np.array([abs(w - TRUE)[at] / std for at, std in UNSURE.items()]) for w in (
        weights_of(fitted.model), MEAN))  # fmt: skip
    assert (off < 0.4 * before).all()
    sure = [(0, 1), (2, 1), (4, 4), (5, 2)]
    np.testing.assert_allclose(
        [weights_of(fitted.model)[at] for at in sure], [MEAN[at] for at in sure], atol=1e-5
    )
    assert fitted.loss[1] < 0.1 * fitted.loss[0]
    assert fitted.held_out[fitted.prior_scale] < fitted.held_out[0.0]


def test_the_truth_lies_within_the_corrected_posterior(model, fitted):
    """Its paths and its covariance agree, and are narrower than before."""
    X = np.random.default_rng(1).normal(0, [0.1, 0.1, 0.02, 0.02, 0.02, 0.05], (4, 6))
    drawn = fitted.model.sample(4000, 0)(np.broadcast_to(X, (4000, 4, 6)))
    off = np.moveaxis(drawn - fitted.model(X), 0, -1).transpose(1, 0, 2).reshape(24, -1)
    expected = fitted.model.covariance(X)
    np.testing.assert_allclose(off @ off.T / 4000, expected, atol=0.1 * expected.max())
    unsure = np.diag(covariance(X)) > 0
    assert (np.diag(expected)[unsure] < 0.5 * np.diag(covariance(X))[unsure]).all()
    error = (values(X, TRUE) - fitted.model(X)).T.ravel()
    assert (np.abs(error[unsure]) < 4 * np.sqrt(np.diag(expected)[unsure])).all()


def test_a_model_stays_where_flights_contradict_each_other(model):
    """Each predicts the other worse than no correction."""
    flights = [
        *records(TRUE, 1),
        *(part.assign(flight="other") for part in records(2 * MEAN - TRUE, 1)),
    ]
    found = fit_output_error(model, GLIDER, flights, NOISE, thrust=None)
    assert found.model is model
    assert found.prior_scale == 0
    assert not found.correction.any()


def test_the_corrected_model_is_stored_and_flies(fitted):
    again = pickle.loads(pickle.dumps(fitted.model))
    np.testing.assert_allclose(again(np.zeros(6)), fitted.model(np.zeros(6)), rtol=1e-9, atol=1e-10)
    paths = simulate(fitted.model, GLIDER, {"airspeed": 12.0, "altitude": 100.0}, {"elevator": 0.0}, duration=0.2,
                     thrust=None, n_paths=3)  # fmt: skip
    assert paths.groupby("time")["theta"].std().iloc[-1] > 0


def test_what_cannot_be_fitted_is_said(model):
    flights = records(MEAN, 2, duration=0.2)
    known = Aerodynamics(mean, NAMES)
    for arguments, message in (
        ((known, GLIDER, flights, NOISE), "without a posterior"),
        ((model, GLIDER, flights[:1], NOISE), "1 segment"),
        ((model, GLIDER, [part.drop(columns="q") for part in flights], NOISE), "lacks the columns"),
        ((model, GLIDER, [part.assign(q=np.nan) for part in flights], NOISE), "missing values"),
        ((model, GLIDER, flights, {"airspeed": 0.1}), "airspeed"),
        ((model, GLIDER, flights, {"q": 0.0}), "expected standard deviations > 0"),
    ):
        with pytest.raises(ValueError, match=message):
            fit_output_error(*arguments, thrust=None)
    slow = [part.drop(columns="airspeed").assign(u=0.1, v=0.0, w=0.0) for part in flights]
    with pytest.raises(ValueError, match="none of which the model flies"):
        fit_output_error(model, GLIDER, slow, NOISE, thrust=None)
    with pytest.warns(UserWarning, match="1 of 3 segments are left out"):
        fit_output_error(
            model, GLIDER, [part[list(slow[0])] for part in (*flights, slow[0])], NOISE, thrust=None
        )
