"""Linear models against differences of the motion, textbooks and simulations; refusals."""

import numpy as np
import pytest
from flight_columns import SURFACES
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal

from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Motion,
    Servos,
    euler_to_quaternion,
    linearize,
    quaternion_to_euler,
    trim,
)

AIR = Air(density=1.1, gravity=9.79)
EXAMPLE = load_example_flights(duration=1.0)
BRUMBYS = EXAMPLE.truth


@pytest.fixture(scope="module")
def level(glider):
    return trim(glider.model(), glider.aircraft, 20.0, air=AIR)


@pytest.fixture(scope="module")
def linear(glider, level):
    return linearize(glider.model(), glider.aircraft, level, air=AIR)


def test_all_states_at_a_turn_are_the_derivative_of_the_motion(aircraft, central_difference):
    """Euler angles, full inertia, implicit regressors, by differences."""
    motion = Motion(BRUMBYS, aircraft)
    controls = {"elevator": -0.03, "aileron": 0.01, "rudder": 0.02, "thrust": 60.0}

    def state_of(x):
        return np.concatenate([x[:6], euler_to_quaternion(*x[6:9]), x[9:12]])

    def rate(x):
        """Return d state / dt and outputs, of 12 states and 4 controls."""
        state = state_of(x)
        now = motion.at(state, dict(zip(controls, x[12:], strict=True)))
        ahead, behind = (
            quaternion_to_euler(state[6:10] + dt * now.derivative[6:10]) for dt in (1e-6, -1e-6)
        )
        seen = [now.airspeed, now.alpha, now.beta, *now.force / aircraft.mass]
        angles = (ahead - behind) / 2e-6
        return np.concatenate([now.derivative[:6], angles, now.derivative[10:], seen])

    x = np.array([10.0, 20.0, -300.0, 33.0, 1.5, 3.0, 0.6, 0.2, 1.1, 0.2, 0.1, 0.25])
    expected = central_difference(rate, [*x, *controls.values()], 1e-4)
    found = linearize(BRUMBYS, aircraft, state_of(x), controls)
    states = found.A.columns
    assert_allclose(found.C.loc[states], np.eye(12))
    assert not found.D.loc[states].any(axis=None)
    outputs = found.C.index[12:]
    rows = np.block([
        [found.A, found.B[[*controls]]], [found.C.loc[outputs], found.D.loc[outputs, [*controls]]]
    ])  # fmt: skip
    assert_allclose(rows, expected, rtol=5e-6, atol=5e-6)


class TestSpread:
    def test_each_path_is_the_linear_aircraft_of_its_own_function(self, level, glider):
        model = glider.model()
        many = linearize(model, glider.aircraft, level, n_paths=3, random_state=2, air=AIR)
        values, _ = model.sampler(3, 2)
        for k in range(3):
            alone = Aerodynamics(
                lambda X, k=k: values(np.broadcast_to(X, (3, *X.shape)))[k], glider.names
            )
            one = linearize(alone, glider.aircraft, level, air=AIR)
            for name in "ABCD":
                path, table = getattr(many.paths, name), getattr(one, name)
                assert_allclose(path[k], table, rtol=5e-7, atol=5e-7)


def nowhere(X):
    return np.full((len(X), 6), np.nan)


def loop(X):
    """Pulled up where it turns down, and down where up: no alpha_dot fits."""
    return np.where(X[:, 8:] < 0, 1.0, -1.0) * np.eye(6)[2]


@pytest.mark.parametrize(("change", "match"), [
    (lambda at: {"n_paths": 1}, "n_paths=1, but expected 0 or at least 2"),
    (lambda at: {"point": at.state[:12], "controls": at.controls}, "13 finite numbers .STATE_NAMES, or a Trim"),



    (lambda at: {"point": at.state, "controls": {"elevator": 0.0, "rudder": 0.0, "thrust": 1.0}}, "'aileron'"),
])  # fmt: skip
def test_what_cannot_be_linearized(glider, level, change, match):
    with pytest.raises((ValueError, TypeError), match=match):
        linearize(glider.model(), glider.aircraft, **{"point": level, "air": AIR} | change(level))


@pytest.mark.parametrize(
    ("function", "names", "match"),
    [(nowhere, [], "not finite"), (loop, ["alpha_dot"], "not finite")],
)
def test_a_motion_that_is_none(glider, level, function, names, match):
    model = Aerodynamics(function, [*glider.names, *names])
    with pytest.raises(ValueError, match=match):
        linearize(model, glider.aircraft, level, air=AIR)


LAG = 0.08  # of the servos [s]
POSITIONS = [f"{name}_position" for name in SURFACES]


@pytest.fixture(scope="module")
def late(glider, level):
    return linearize(
        glider.model(servos=Servos(lag=LAG)), glider.aircraft, level, air=AIR, n_paths=3
    )


class TestServos:
    """A servo lag T: T d(deflection)/dt = command - deflection."""

    def test_deflections_are_states_and_commands_are_inputs(self, late):
        assert [*late.A][-3:] == POSITIONS
        assert [*late.B] == [*SURFACES, "thrust"]
        servo = late.A.loc[POSITIONS]
        assert_allclose(servo[POSITIONS], -np.eye(3) / LAG)
        assert not servo.drop(columns=POSITIONS).any(axis=None)
        assert_allclose(late.B.loc[POSITIONS, SURFACES], np.eye(3) / LAG)

    def test_deflections_act_as_inputs_without_a_lag_do(self, late, linear):
        """The rest is the model without a lag, and so are its modes."""
        body = [*linear.A]
        for states, inputs in ("AB", "CD"):
            found, expected = getattr(late, states), getattr(linear, states)
            assert_frame_equal(found.loc[expected.index, body], expected)
            assert_allclose(found.loc[expected.index, POSITIONS], getattr(linear, inputs)[SURFACES])
            assert not getattr(late, inputs).loc[expected.index, SURFACES].any(axis=None)
        columns = ["eigenvalue", "frequency", "damping", "time_constant"]
        assert_frame_equal(late.modes()[columns], linear.modes()[columns])


def test_paths_have_the_errors_of_lag_and_delay_of_the_servos():
    """Longer lags with shorter delays, and no lag below what servos have."""
    lags, delays = Servos(lag=0.03, delay=0.02, lag_std=0.02, delay_std=0.01).drawn(4000, 0)
    assert_allclose(lags.min(), 0.01, rtol=0.01)
    assert delays.min() == 0.0
    assert np.corrcoef(lags, delays)[0, 1] < -0.9
    far_from_it, _ = Servos(lag=0.09, lag_std=0.02).drawn(4000, 0)
    assert_allclose(far_from_it.std(), 0.02, rtol=0.1)
    exact, _ = Servos(lag=0.03).drawn(3, 0)
    assert_allclose(exact, 0.03)
    none, delays = Servos(delay=0.05, lag_std=0.01, delay_std=0.01).drawn(4000, 0)
    assert not none.any()
    assert_allclose(delays.mean(), 0.05, rtol=0, atol=5e-4)
    assert_allclose(delays.std(), 0.01, rtol=0.05)
