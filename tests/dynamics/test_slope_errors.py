"""What alpha_dot and beta_dot may change of a model: by the motion they follow from, and as regressors would."""

import numpy as np
import pytest

from skdgp._flight.frames import air_data_slopes
from skdgp.datasets._example_flights import BRUMBY
from skdgp.dynamics import Aerodynamics, Air, air_velocity, euler_to_quaternion
from skdgp.dynamics._linearize import SHARES, Lag, jacobian, lag_of
from skdgp.dynamics._motion import Motion

NAMES = ["alpha", "beta", "p_hat", "q", "r_hat", "elevator", "rudder"]
SLOPES = np.zeros((6, 7))
SLOPES[0, [0, 5]] = 0.4, 0.02
SLOPES[1, [1, 4, 6]] = -0.5, 0.2, 0.1
SLOPES[2, [0, 3, 5]] = -4.5, -0.03, -0.4
SLOPES[3, [1, 2, 4]] = -0.05, -0.4, 0.1
SLOPES[4, [0, 3, 5]] = -0.6, -0.12, -1.0
SLOPES[5, [1, 4, 6]] = 0.08, -0.1, -0.06
LEVEL = np.array([-0.04, 0.0, -0.25, 0.0, 0.02, 0.0])
CONTROLS = {"elevator": -0.02, "rudder": 0.03}
LINEAR = Aerodynamics(
    lambda X: LEVEL + X @ SLOPES.T, NAMES, slopes=lambda X: np.tile(SLOPES, (len(X), 1, 1))
)


def state_of(alpha=0.08, beta=0.03, rates=(0.2, 0.1, 0.15)):
    attitude = euler_to_quaternion(0.3, 0.1, 1.0)
    return np.concatenate([[0.0, 0.0, -200.0], air_velocity(36.0, alpha, beta), attitude, rates])


def test_relation_is_of_the_motion_that_loads_cause():
    """Central differences of alpha_dot and beta_dot of the loads alone, by the regressors that are not angles."""
    motion = Motion(LINEAR, BRUMBY, thrust=None, air=Air(gravity=0.0))

    def angle_rates(**changes):
        state = state_of(rates=changes.get("rates", (0.2, 0.1, 0.15)))
        now = motion.at(state, CONTROLS | changes.get("controls", {}))
        return air_data_slopes(state[3:6])[1:] @ now.derivative[3:6]

    now = motion.at(state_of(), CONTROLS)
    relation = lag_of(motion, now, SLOPES).relation
    h = 1e-4
    for k, unit in ((2, 2 * 36.0 / BRUMBY.span), (3, 1.0), (4, 2 * 36.0 / BRUMBY.span)):
        step = h * np.eye(3)[k - 2]
        ahead, behind = (
            angle_rates(rates=np.array([0.2, 0.1, 0.15]) + sign * step) for sign in (1, -1)
        )
        assert relation[:, k] == pytest.approx(
            (ahead - behind) / (2 * h) * unit, rel=1e-6, abs=1e-8
        )
    for k, name in ((5, "elevator"), (6, "rudder")):
        ahead, behind = (
            angle_rates(controls={name: CONTROLS[name] + sign * h}) for sign in (1, -1)
        )
        assert relation[:, k] == pytest.approx((ahead - behind) / (2 * h), rel=1e-6, abs=1e-8)


def test_sizes_are_shares_of_the_slopes_by_rates():
    motion = Motion(LINEAR, BRUMBY, thrust=None)
    lag = lag_of(motion, motion.at(state_of(), CONTROLS), SLOPES)
    assert lag.slopes[:, 0] == pytest.approx(SHARES[0] * SLOPES[:, 3])
    assert lag.slopes[:, 1] == pytest.approx(SHARES[1] * SLOPES[:, 4] * BRUMBY.span / (2 * 36.0))
    assert lag.missing.all()


def test_scatter_of_slopes_by_rates_leaves_those_by_lags_unknown():
    """A Cm_q of zero with a deviation by method does not mean that Cm_alpha_dot is zero."""
    motion = Motion(LINEAR, BRUMBY, thrust=None)
    now, scatter = motion.at(state_of(), CONTROLS), np.zeros_like(SLOPES)
    scatter[4, 3], scatter[3, 3] = 0.16, 0.02
    lag = lag_of(motion, now, SLOPES, scatter)
    assert lag.slopes[4, 0] == pytest.approx(SHARES[0] * -0.2)
    assert abs(lag.slopes[3, 0]) == pytest.approx(SHARES[0] * 0.02)
    assert lag.slopes[:, 1] == pytest.approx(lag_of(motion, now, SLOPES).slopes[:, 1])


def test_a_lag_acts_as_a_small_slope_by_alpha_dot_does():
    size = 1e-5
    column = size * np.array([0.0, 0, -1.0, 0, -2.0, 0])
    named = Aerodynamics(
        lambda X: LEVEL + X[:, :7] @ SLOPES.T + X[:, 7:] * column, [*NAMES, "alpha_dot"]
    )
    lag = Lag(np.column_stack([column, 0 * column]), np.zeros((2, 7)), np.ones((2, 1), dtype=bool))
    state, with_lag, bare = (
        state_of(),
        Motion(named, BRUMBY, thrust=None),
        Motion(LINEAR, BRUMBY, thrust=None),
    )
    expected = jacobian(with_lag, state, CONTROLS, inputs=["elevator"])
    plain = jacobian(bare, state, CONTROLS, inputs=["elevator"])
    found = jacobian(bare, state, CONTROLS, inputs=["elevator"], lag=lag)
    for k in range(2):  # of the motion, of the outputs
        change = expected[k] - plain[k]
        own = found[k] - plain[k]
        assert np.abs(change - own).max() < 2e-2 * np.abs(change).max()


def test_with_alpha_dot_the_rest_of_it_is_uncertain():
    slopes = np.column_stack([SLOPES, np.zeros(6), np.zeros(6)])
    model = Aerodynamics(lambda X: LEVEL + X @ slopes.T, [*NAMES, "alpha_dot", "beta_dot_hat"])
    motion = Motion(model, BRUMBY, thrust=None)
    lag = lag_of(motion, motion.at(state_of(), CONTROLS), slopes)
    assert not lag.missing.any()
    assert lag.errors[4, 7] == pytest.approx([SHARES[0] * SLOPES[4, 3], 0.0])
    assert lag.errors[5, 8, 1] == pytest.approx(SHARES[1] * SLOPES[5, 4])
