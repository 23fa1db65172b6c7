"""Motion that the smoothing of coefficients removes: slopes of a known function from noisy accelerometers."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng

from skdgp import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.identification import identify

AIRCRAFT = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
SPEED, DENSITY, STEP = 15.0, 1.2, 0.02
CZ_ALPHA, CZ_ELEVATOR = -4.0, -0.8


def flown(seed):
    """Return a minute of flight with elevator steps of 0.3 s, whose accelerometers have more noise than these cause."""
    rng = default_rng(seed)
    time = STEP * np.arange(3000)
    alpha = 0.05 + 0.04 * np.sin(0.9 * time) + 0.02 * np.sin(2.3 * time + seed)
    elevator = np.repeat(rng.choice([-0.05, 0.05], 200), 15)
    CZ = -0.1 + CZ_ALPHA * alpha + CZ_ELEVATOR * elevator
    force = CZ * 0.5 * DENSITY * SPEED**2 * AIRCRAFT.wing_area / AIRCRAFT.mass
    noise = rng.standard_normal((3, len(time)))
    return pd.DataFrame(
        {
            "time": time,
            "airspeed": SPEED + 0.01 * noise[0],
            "density": DENSITY,
            "alpha": alpha,
            "beta": 1e-3 * noise[1],
            "elevator": elevator,
            "ax": noise[0],
            "ay": noise[1],
            "az": force + 5 * noise[2],
            "p": 0.01 * noise[0],
            "q": 0.01 * noise[1],
            "r": 0.01 * noise[2],
        }
    )


@pytest.mark.usefixtures("no_mechanics")
def test_slopes_by_fast_surfaces_are_not_flattened():
    result = identify(
        flown(0),
        AIRCRAFT,
        test=flown(1),
        regressors=["alpha", "elevator"],
        regressor=DependentGPRegressor(structure="trend", max_iter=5, random_state=0),
        pipeline={"reconstruction": "passthrough", "lags": None, "cutoff": None},
        thrust=None,
        horizons=[2.0],
    )
    pipeline = result.pipeline
    slopes = pipeline[-1].predict_gradient(np.zeros((1, 2)))[0] / pipeline["standardscaler"].scale_
    assert slopes[2, 0] == pytest.approx(CZ_ALPHA, rel=0.1)
    assert slopes[2, 1] == pytest.approx(CZ_ELEVATOR, rel=0.05)
    assert result.evaluations[0].scores["measured"].loc["CZ", "interval_coverage"] > 0.85
