"""The plan of the example keeps its limits for the aircraft of the posterior, and the plan of the mean does not."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from skdgp.dynamics import Air, standard_density, trim

pytest.importorskip("casadi", reason='plans with IPOPT: pip install "skdgp[export]"')
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore:.*trajectories left what the model was learned from"),
]
PATHS, ALTITUDE, AIRSPEED = 100, 200.0, 25.0
LIMITS = np.array([0.16, 2.0])
DENSITY = float(standard_density(ALTITUDE))


def test_the_margin_keeps_the_limits_for_95_percent(example, fitted, portable_of):
    planner = example("pull_up_casadi")
    pipeline, aircraft = fitted("average").pipeline, fitted("average").aircraft
    steady = trim(pipeline, aircraft, AIRSPEED, altitude=ALTITUDE, air=Air(density=DENSITY))
    motion, start = planner.motion_of(portable_of("average"), aircraft, steady, DENSITY)
    rates, limited = motion(start, steady.controls["elevator"])
    assert_allclose(np.array(rates).ravel(), 0.0, atol=1e-5)
    assert_allclose(np.array(limited).ravel()[0], steady.alpha)

    margin = np.zeros((len(planner.TIME), 2))
    exceeding = []
    for seed in range(4):
        controls, mean = planner.planned(motion, start, steady, LIMITS - margin, (-0.3, 0.3))
        assert (mean + margin <= LIMITS + 1e-6).all()
        fly = pipeline, aircraft, steady, controls, DENSITY, PATHS
        others = planner.flown(*fly, seed=1000 + seed)
        exceeding.append(np.mean((others > LIMITS).any(axis=(1, 2))))
        margin = planner.margin(planner.flown(*fly, seed=seed), mean)
    assert exceeding[0] > 0.3
    assert exceeding[-1] <= 0.05
