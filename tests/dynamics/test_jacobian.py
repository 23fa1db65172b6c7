"""The Jacobian is the derivative of the motion: against differences of all of it, model and fixed point included."""

import numpy as np
import pytest

from skdgp.dynamics import (
    Aerodynamics,
    air_velocity,
    euler_to_quaternion,
    ned_to_body,
    quaternion_rate,
)
from skdgp.dynamics._air import LocalAir
from skdgp.dynamics._error_covariance import ERRORS
from skdgp.dynamics._jacobian import OUTPUTS, jacobian
from skdgp.dynamics._motion import Motion

WIND, WIND_RATE = np.array([3.0, -2.0, 0.7]), np.array([0.4, 0.2, -0.3])
AIR = LocalAir(WIND, WIND_RATE)
QUASI_STEADY = ["alpha", "beta", "p_hat", "q", "r_hat", "airspeed", "phi", "elevator", "thrust"]
IMPLICIT = [*QUASI_STEADY, "alpha_dot_hat", "beta_dot", "q_dot_hat", "ax", "az"]
CONTROLS = {"elevator": -0.05, "thrust": 22.0}


def curved(names, seed=0):
    """Coefficients with slopes and curvature in every regressor; those that follow from the loads weigh little."""
    rng = np.random.default_rng(seed)
    size = np.array(
        [
            {"airspeed": 0.01, "thrust": 0.002, "ax": 1e-3, "az": 1e-3}.get(name, 0.2)
            for name in names
        ]
    )
    slope, bend = rng.normal(size=(2, len(names), 6)) * size[:, None]
    level = np.array([-0.03, 0.0, -0.3, 0.0, 0.0, 0.0])
    return Aerodynamics(lambda X: level + np.sin(X) @ slope + np.cos(2 * X) @ bend, names)


def states(n=()):
    """States at no special point: every angle and rate differs from zero, in air that moves."""
    rng = np.random.default_rng(1)
    angles = np.array([0.5, 0.15, 2.0]) + 0.1 * rng.normal(size=(*n, 3))
    attitude = euler_to_quaternion(*np.moveaxis(angles, -1, 0))
    velocity = (
        air_velocity(24.0, 0.1, -0.06)
        + ned_to_body(attitude, WIND)
        + 0.5 * rng.normal(size=(*n, 3))
    )
    rates = np.array([0.3, 0.1, -0.2]) + 0.05 * rng.normal(size=(*n, 3))
    position = np.broadcast_to([30.0, -20.0, -400.0], (*n, 3))
    return np.concatenate([position, velocity, attitude, rates], axis=-1)


def moved(state, error):
    """The state with an error, its rotation turned in many small steps."""
    state = np.concatenate([state[:6] + error[:6], state[6:10], state[10:] + error[9:]])
    for _ in range(4):
        state[6:10] += quaternion_rate(state[6:10], error[6:9] / 4)
        state[6:10] /= np.linalg.norm(state[6:10])
    return state


def followed(motion, state, controls, start):
    """Rates of all errors but the attitude's, and outputs, by the whole of `Motion.at`."""
    now = motion.at(state, controls, AIR)
    seen = [now.airspeed, now.alpha, now.beta, *(now.force / motion.aircraft.mass)]
    return np.concatenate([now.derivative[:6], now.derivative[10:], seen])


def differenced(motion, state, controls, inputs, h=1e-5):
    columns = []
    for k in range(12):
        both = [
            followed(motion, moved(state, s * h * np.eye(12)[k]), controls, state) for s in (1, -1)
        ]
        columns.append((both[0] - both[1]) / (2 * h))
    for name in inputs:
        both = [
            followed(motion, state, controls | {name: controls[name] + s * h}, state)
            for s in (1, -1)
        ]
        columns.append((both[0] - both[1]) / (2 * h))
    return np.stack(columns, axis=-1)


@pytest.mark.parametrize("names", [QUASI_STEADY, IMPLICIT], ids=["quasi-steady", "implicit"])
def test_is_the_derivative_of_the_motion(names, aircraft):
    motion, state = Motion(curved(names), aircraft), states()
    found = jacobian(motion, state, CONTROLS, inputs=list(CONTROLS), air=AIR)
    expected = differenced(motion, state, CONTROLS, CONTROLS)
    assert np.all(found.instant.settled)
    full = np.block([[found.state, found.controls], [found.outputs_state, found.outputs_controls]])
    rows = [k for k in range(12 + len(OUTPUTS)) if k not in (6, 7, 8)]
    assert full[rows] == pytest.approx(
        expected, rel=1e-5, abs=2e-6 * np.abs(expected).max(axis=-1).min()
    )


@pytest.mark.parametrize("names", [QUASI_STEADY, IMPLICIT], ids=["quasi-steady", "implicit"])
def test_errors_of_the_model_reach_the_motion(names, aircraft):
    """An offset of the coefficient function, the implicit regressors following it."""
    model, state, h = curved(names), states(), 1e-5
    found = jacobian(Motion(model, aircraft), state, CONTROLS, air=AIR).coefficients
    for k in range(6):
        offset = h * np.eye(6)[k]
        more, less = (
            Motion(Aerodynamics(lambda X, o=s * offset: model(X) + o, names), aircraft)
            .at(state, CONTROLS, AIR)
            .derivative
            for s in (1, -1)
        )
        expected = ((more - less) / (2 * h))[[3, 4, 5, 10, 11, 12]]
        assert found[[3, 4, 5, 9, 10, 11], k] == pytest.approx(
            expected, rel=1e-6, abs=1e-6 * np.abs(expected).max()
        )


def test_an_error_of_attitude_turns_as_rotations_do(aircraft):
    """Two attitudes that differ by a small rotation, flown for a moment with rates that differ too."""
    state, h, dt = states(), 1e-6, 1e-5
    found = jacobian(Motion(curved(QUASI_STEADY), aircraft), state, CONTROLS).state[6:9]
    for k in (*range(6, 9), *range(9, 12)):
        error = h * np.eye(12)[k]
        true, off = (
            one[6:10] + dt * quaternion_rate(one[6:10], one[10:])
            for one in (moved(state, 0 * error), moved(state, error))
        )
        conjugate = true * [1, -1, -1, -1]
        product = 2 * np.array(
            [
                conjugate[0] * off[1]
                + conjugate[1] * off[0]
                + conjugate[2] * off[3]
                - conjugate[3] * off[2],
                conjugate[0] * off[2]
                - conjugate[1] * off[3]
                + conjugate[2] * off[0]
                + conjugate[3] * off[1],
                conjugate[0] * off[3]
                + conjugate[1] * off[2]
                - conjugate[2] * off[1]
                + conjugate[3] * off[0],
            ]
        )
        assert (product - error[6:9]) / dt / h == pytest.approx(found[:, k], abs=1e-3)


def test_many_states_at_once_are_each_alone(aircraft):
    motion, state = Motion(curved(IMPLICIT), aircraft), states((2, 3))
    controls = {"elevator": np.linspace(-0.1, 0.1, 6).reshape(2, 3), "thrust": 22.0}
    many = jacobian(motion, state, controls, inputs=["elevator"], air=LocalAir(WIND))
    assert many.state.shape == (2, 3, len(ERRORS), len(ERRORS))
    alone = {"elevator": controls["elevator"][1, 2], "thrust": 22.0}
    one = jacobian(motion, state[1, 2], alone, inputs=["elevator"], air=LocalAir(WIND))
    for name in ("state", "controls", "coefficients", "outputs_state", "outputs_controls"):
        assert getattr(many, name)[1, 2] == pytest.approx(getattr(one, name), rel=1e-7, abs=1e-7)


def test_paths_are_asked_each_at_its_own(aircraft):
    models = [curved(QUASI_STEADY, seed) for seed in range(3)]

    def by_path(of):
        return lambda X: np.stack([of(model)(x) for model, x in zip(models, X, strict=True)])

    def sampler(n_paths, random_state):
        return by_path(lambda model: model), by_path(lambda model: model.gradient)

    drawn = Aerodynamics(models[0].function, QUASI_STEADY, sampler=sampler).sample(3)
    state = np.broadcast_to(states(), (3, 13))
    found = jacobian(Motion(drawn, aircraft), state, CONTROLS, inputs=["thrust"]).state
    for k, model in enumerate(models):
        assert found[k] == pytest.approx(
            jacobian(Motion(model, aircraft), states(), CONTROLS).state, rel=1e-6, abs=1e-9
        )
