"""The plan of the example keeps its limits for the aircraft of the posterior, and the plan of the mean does not."""

import importlib.util
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.linalg import block_diag

from skdgp import DependentGPRegressor
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    simulate,
    standard_density,
    trim,
)
from skdgp.export import portable_model
from skdgp.identification import make_identification_pipeline
from skdgp.kernels import ConvolvedGaussian

pytest.importorskip("casadi", reason='plans with IPOPT: pip install "skdgp[export]"')
pytestmark = [
    pytest.mark.filterwarnings("ignore:.*trajectories left what the model was learned from")
]
PATHS, ALTITUDE, LIMITS, ELEVATOR = 200, 200.0, (0.16, 2.0), (-0.3, 0.3)
DENSITY = float(standard_density(ALTITUDE))
REGRESSORS = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
CENTRE, SPREAD = [0.08, *[0.0] * 7], [0.06, 0.05, 0.03, 0.01, 0.03, 0.06, 0.05, 0.05]


@pytest.fixture(scope="module")
def example():
    spec = importlib.util.spec_from_file_location(
        "pull_up_casadi", Path(__file__).resolve().parents[2] / "examples" / "pull_up_casadi.py"
    )
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture(scope="module")
def aircraft():
    """Return an aircraft that is symmetric, with an engine above the centre of gravity."""
    return Aircraft(
        name="uav", mass=12.0, inertia=[[1.1, 0, 0.1], [0, 2.3, 0], [0.1, 0, 3.1]], wing_area=1.3, span=2.6, chord=0.55,
        thrust_line={"position": [-0.5, 0, -0.1], "direction": [1.0, 0.0, 0.02]},
    )  # fmt: skip


@pytest.fixture(scope="module")
def pipeline(aircraft):
    """Return a model of 600 noisy samples of a textbook aircraft whose lift curve bends."""
    rng = np.random.default_rng(0)
    X = rng.normal(CENTRE, SPREAD, (600, 8))
    alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    flight = pd.DataFrame(X, columns=[name.removesuffix("_hat") for name in REGRESSORS])
    flight[["p", "q", "r"]] *= 2 * 22.0 / aircraft.moment_lengths
    flight = flight.assign(time=0.1 * np.arange(600), airspeed=22.0)
    lift = 0.2 + 4.5 * alpha - 6 * alpha**2
    Y = np.stack([
        -0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift - 0.3 * elevator,
        -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
        0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder,
    ], axis=-1)  # fmt: skip
    Y = Y + rng.normal(0, [5e-3, 5e-3, 2e-2, 1e-3, 5e-3, 1e-3], Y.shape)
    kernel = ConvolvedGaussian(1, private_latents=False)
    regressor = DependentGPRegressor(kernel, structure="joint", inference="sparse", n_inducing=15, max_iter=10,
                                     input_noise=None, random_state=0)  # fmt: skip
    model = make_identification_pipeline(
        aircraft, regressors=REGRESSORS, reconstruction="passthrough", cutoff=None, mixer="passthrough",
        regressor=regressor,
    )  # fmt: skip
    model.set_params(flightcheck="passthrough", flightsmoother="passthrough")
    return model.fit(flight, pd.DataFrame(Y, columns=["CX", "CY", "CZ", "Cl", "Cm", "Cn"]))


@pytest.fixture(scope="module")
def steady(aircraft, pipeline):
    return trim(pipeline, aircraft, 22.0, altitude=ALTITUDE, air=Air(density=DENSITY))


@pytest.fixture(scope="module")
def pull_up(example, aircraft, pipeline, steady):
    covariance = example.joint_covariance(pipeline)
    model = portable_model(pipeline, aircraft)
    return example.PullUp(
        model, covariance, aircraft, steady, DENSITY, LIMITS, duration=2.0, max_kb=None
    )


@pytest.fixture(scope="module")
def careful(example, pull_up):
    """Return the plan with a margin."""
    return pull_up.plan(example.SHARE, ELEVATOR)


def test_the_margin_keeps_the_limits_for_95_percent(
    example, aircraft, pipeline, steady, pull_up, careful
):
    bold = pull_up.plan(0.0, ELEVATOR)
    np.testing.assert_allclose(bold.values.max(axis=0), LIMITS, rtol=1e-5)
    drawn = [
        example.flown(pipeline, aircraft, steady, plan, DENSITY, PATHS)[0]
        for plan in (bold, careful)
    ]
    bad, good = (example.violated(values, LIMITS) for values in drawn)
    assert bad > 0.4
    assert good <= 0.05
    assert bold.altitude[-1] > careful.altitude[-1] > ALTITUDE + 5
    assert ((careful.values + careful.margins) / LIMITS).max() == pytest.approx(
        1.0, abs=example.SETTLED
    )
    at = slice(
        20, None, 20
    )  # after 0.4 s, 0.8 s, ..., of the flights; the plan has a point each 0.05 s
    planned = np.linalg.norm(effects(pull_up, careful), axis=2)[8::8]
    np.testing.assert_allclose(planned, drawn[1].std(axis=0)[at], rtol=0.2)


def effects(pull_up, plan):
    """Return G of a plan, whose states are flown again."""
    return pull_up.effects(plan.states, plan.controls["elevator"].to_numpy())


def test_the_effects_are_those_of_errors_in_free_flight(
    example, aircraft, pipeline, steady, pull_up, careful, monkeypatch
):
    """Constant errors of a hundredth of a deviation, flown in six degrees of freedom."""
    model = portable_model(pipeline, aircraft)

    def flight(error):
        def coefficients(X):
            mean, std = model.predict(X, return_std=True, include_input_noise=False)
            return mean + std * error

        aerodynamics = Aerodynamics(coefficients, model.regressor_names)
        table = simulate(
            aerodynamics, aircraft, steady, careful.controls, dt=0.025, air=Air(density=DENSITY)
        )
        return np.stack([table["alpha"], -table["az"] / example.GRAVITY], axis=-1)

    mean = flight(np.zeros(6))
    np.testing.assert_allclose(mean[::2], careful.values, atol=6e-3)
    changes = [(flight(0.01 * row) - mean)[::2] / 0.01 for row in np.eye(6)[[0, 2, 4]]]

    def constant_errors(X):
        std = model.predict(X, return_std=True, include_input_noise=False)[1]
        return block_diag(*[np.outer(column, column) for column in std.T])

    monkeypatch.setattr(pull_up, "covariance", constant_errors)
    found = np.linalg.norm(effects(pull_up, careful), axis=2)
    np.testing.assert_allclose(found, np.linalg.norm(changes, axis=0), rtol=0.05)
