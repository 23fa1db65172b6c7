"""The plan of the example keeps its limits for the aircraft of the posterior, and the plan of the mean does not."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp import DependentGPRegressor
from skdgp.dynamics import Air, Aircraft, standard_density, trim
from skdgp.export import portable_model
from skdgp.identification import make_identification_pipeline
from skdgp.kernels import ConvolvedGaussian

pytest.importorskip("casadi", reason='plans with IPOPT: pip install "skdgp[export]"')
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:.*trajectories left what the model was learned from"),
]
PATHS, ALTITUDE = 100, 200.0
LIMITS = np.array([0.16, 2.0])
DENSITY = float(standard_density(ALTITUDE))
REGRESSORS = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
CENTRE, SPREAD = [0.08, *[0.0] * 7], [0.06, 0.05, 0.03, 0.01, 0.03, 0.06, 0.05, 0.05]
AIRCRAFT = Aircraft(
    name="uav", mass=12.0, inertia=[[1.1, 0, 0.1], [0, 2.3, 0], [0.1, 0, 3.1]], wing_area=1.3, span=2.6, chord=0.55,
    thrust_line={"position": [-0.5, 0, -0.1], "direction": [1.0, 0.0, 0.02]},
)  # fmt: skip


@pytest.fixture(scope="module")
def pipeline():
    """Return a model of 600 noisy samples of a textbook aircraft whose lift curve bends."""
    rng = default_rng(0)
    X = rng.normal(CENTRE, SPREAD, (600, 8))
    alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    flight = pd.DataFrame(X, columns=[name.removesuffix("_hat") for name in REGRESSORS])
    flight[["p", "q", "r"]] *= 2 * 22.0 / AIRCRAFT.moment_lengths
    flight = flight.assign(time=0.1 * np.arange(600), airspeed=22.0)
    lift = 0.2 + 4.5 * alpha - 6 * alpha**2
    Y = np.stack([
        -0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift - 0.3 * elevator,
        -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
        0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder,
    ], axis=-1)  # fmt: skip
    Y = Y + rng.normal(0, [5e-3, 5e-3, 2e-2, 1e-3, 5e-3, 1e-3], Y.shape)
    kernel = ConvolvedGaussian(1, private_latents=False)
    regressor = DependentGPRegressor(kernel, structure="joint", inference="sparse", n_inducing=15, max_iter=25,
                                     input_noise=None, random_state=0)  # fmt: skip
    model = make_identification_pipeline(
        AIRCRAFT, regressors=REGRESSORS, reconstruction="passthrough", cutoff=None,
        regressor=regressor,
    )  # fmt: skip
    model.set_params(flightcheck="passthrough", flightsmoother="passthrough")
    return model.fit(flight, pd.DataFrame(Y, columns=["CX", "CY", "CZ", "Cl", "Cm", "Cn"]))


def test_the_margin_keeps_the_limits_for_95_percent(example, pipeline):
    planner = example("pull_up_casadi")
    steady = trim(pipeline, AIRCRAFT, 22.0, altitude=ALTITUDE, air=Air(density=DENSITY))
    model = portable_model(pipeline, AIRCRAFT)
    motion, start = planner.motion_of(model, AIRCRAFT, steady, DENSITY)
    rates, limited = motion(start, steady.controls["elevator"])
    assert_allclose(np.array(rates).ravel(), 0.0, atol=1e-5)
    assert_allclose(np.array(limited).ravel()[0], steady.alpha)

    margin = np.zeros((len(planner.TIME), 2))
    exceeding = []
    for seed in range(3):
        plan = planner.planned(motion, start, steady, LIMITS - margin, (-0.3, 0.3))
        controls, mean = plan
        assert (mean + margin <= LIMITS + 1e-6).all()
        fly = pipeline, AIRCRAFT, steady, controls, DENSITY, PATHS
        others = planner.flown(*fly, seed=1000 + seed)
        exceeding.append(np.mean((others > LIMITS).any(axis=(1, 2))))
        margin = planner.margin(planner.flown(*fly, seed=seed), mean)
    assert exceeding[0] > 0.3
    assert exceeding[-1] <= 0.05
