"""Linear models against differences of the motion, textbooks and simulations; refusals."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from pandas.testing import assert_frame_equal
from scipy.optimize import brentq
from scipy.signal import find_peaks, lsim

from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    Mixing,
    Motion,
    euler_to_quaternion,
    linearize,
    quaternion_to_euler,
    simulate,
    trim,
)

NAMES = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
ALPHA, BETA, P, Q, R, ELEVATOR, AILERON, RUDDER = range(8)
X, Y, Z, L, M, N = range(6)
LEVEL = np.array([-0.04, 0.0, -0.25, 0.0, 0.02, 0.0])
SLOPES = np.zeros((6, 8))
SLOPES[X, [ALPHA, ELEVATOR]] = 0.4, 0.02
SLOPES[Y, [BETA, P, R, AILERON, RUDDER]] = -0.5, 0.05, 0.2, 0.03, 0.1
SLOPES[Z, [ALPHA, Q, ELEVATOR]] = -4.5, -3.0, -0.4
SLOPES[L, [BETA, P, R, AILERON, RUDDER]] = -0.05, -0.4, 0.1, 0.1, 0.01
SLOPES[M, [ALPHA, Q, ELEVATOR]] = -0.6, -9.0, -1.0
SLOPES[N, [BETA, P, R, AILERON, RUDDER]] = 0.08, -0.03, -0.1, -0.005, -0.06
AIR = Air(density=1.1, gravity=9.79)
EXAMPLE = load_example_flights(duration=1.0)
BRUMBYS = Aerodynamics(
    EXAMPLE.aerodynamics,
    [f"{name}_hat" if 2 <= k < 7 else name for k, name in enumerate(EXAMPLE.regressor_names)],
)


def sampler(n_paths, random_state):
    """Slopes that err by a tenth of themselves, each by itself."""
    draws = SLOPES * (1 + 0.1 * default_rng(random_state).normal(size=(n_paths, *SLOPES.shape)))
    return lambda X: LEVEL + X @ draws.swapaxes(1, 2), lambda X: np.repeat(
        draws[:, None], X.shape[1], axis=1
    )


MODEL = Aerodynamics(lambda X: LEVEL + X @ SLOPES.T, NAMES, sampler=sampler)


@pytest.fixture(scope="module")
def glider():
    return Aircraft(
        mass=12.0,
        inertia=[[1.1, 0, -0.2], [0, 2.3, 0], [-0.2, 0, 3.1]],
        wing_area=1.3,
        span=2.6,
        chord=0.55,
    )


@pytest.fixture(scope="module")
def level(glider):
    return trim(MODEL, glider, 20.0, air=AIR)


@pytest.fixture(scope="module")
def linear(glider, level):
    return linearize(MODEL, glider, level, air=AIR)


def test_entries_are_the_textbooks_dimensional_derivatives(linear, level, glider):
    """Stevens, Lewis & Johnson 2016, section 4.2; Etkin & Reid 1996, section 4.9: in body axes, wings level."""
    V, u, w, theta = 20.0, level.state[3], level.state[5], level.theta
    mass, S, b, c = glider.mass, glider.wing_area, glider.span, glider.chord
    qS = 0.5 * AIR.density * V**2 * S
    CX, _, CZ, *_ = level.coefficients
    (Ix, _, nIxz), (_, Iy, _), (_, _, Iz) = glider.inertia
    A, B = linear.A, linear.B
    alpha_u, alpha_w, pressure_u, pressure_w = -w / V**2, u / V**2, 2 * u / V**2, 2 * w / V**2
    expected = {
        ("u", "u"): qS / mass * (SLOPES[X, ALPHA] * alpha_u + CX * pressure_u),
        ("u", "w"): qS / mass * (SLOPES[X, ALPHA] * alpha_w + CX * pressure_w),
        ("u", "q"): -w,
        ("u", "theta"): -AIR.gravity * np.cos(theta),
        ("w", "u"): qS / mass * (SLOPES[Z, ALPHA] * alpha_u + CZ * pressure_u),
        ("w", "w"): qS / mass * (SLOPES[Z, ALPHA] * alpha_w + CZ * pressure_w),
        ("w", "q"): u + qS / mass * SLOPES[Z, Q] * c / (2 * V),
        ("w", "theta"): -AIR.gravity * np.sin(theta),
        ("q", "w"): qS * c / Iy * SLOPES[M, ALPHA] * alpha_w,
        ("q", "q"): qS * c / Iy * SLOPES[M, Q] * c / (2 * V),
        ("theta", "q"): 1.0,
        ("v", "v"): qS / mass * SLOPES[Y, BETA] / V,
        ("v", "p"): w + qS / mass * SLOPES[Y, P] * b / (2 * V),
        ("v", "r"): -u + qS / mass * SLOPES[Y, R] * b / (2 * V),
        ("v", "phi"): AIR.gravity * np.cos(theta),
        ("phi", "r"): np.tan(theta),
    }
    Ixz, both = -nIxz, Ix * Iz - nIxz**2
    for name, k, scale in (("v", BETA, 1 / V), ("p", P, b / (2 * V)), ("r", R, b / (2 * V))):
        rolling, yawing = (qS * b * SLOPES[row, k] * scale for row in (L, N))
        expected["p", name] = (Iz * rolling + Ixz * yawing) / both
        expected["r", name] = (Ixz * rolling + Ix * yawing) / both
    for entry, value in expected.items():
        assert A.loc[entry] == pytest.approx(value, rel=1e-8, abs=1e-9), entry
    assert_allclose(B.loc["q", "elevator"], qS * c / Iy * SLOPES[M, ELEVATOR])
    assert_allclose(B.loc["w", "elevator"], qS / mass * SLOPES[Z, ELEVATOR])
    assert_allclose(B.loc["u", "thrust"], 1 / mass)
    assert np.abs(A.loc[["u", "w", "q", "theta"], ["v", "p", "r", "phi"]]).max(axis=None) < 1e-9


def test_all_states_at_a_turn_are_the_derivative_of_the_motion(aircraft):
    """Euler angles, full inertia, implicit regressors, by differences."""
    state = np.concatenate(
        [
            [10.0, 20.0, -300.0],
            [33.0, 1.5, 3.0],
            euler_to_quaternion(0.6, 0.2, 1.1),
            [0.2, 0.1, 0.25],
        ]
    )
    controls = {"elevator": -0.03, "aileron": 0.01, "rudder": 0.02, "thrust": 60.0}
    found = linearize(BRUMBYS, aircraft, state, controls)
    motion = Motion(BRUMBYS, aircraft)

    def full(x):
        return np.concatenate([x[:6], euler_to_quaternion(*x[6:9]), x[9:]])

    def rate(x, controls=controls):
        now = motion.at(full(x), controls)
        nearby, before = (full(x)[6:10] + dt * now.derivative[6:10] for dt in (1e-6, -1e-6))
        angles = (quaternion_to_euler(nearby) - quaternion_to_euler(before)) / 2e-6
        seen = [now.airspeed, now.alpha, now.beta, *now.force / aircraft.mass]
        return np.concatenate([now.derivative[:6], angles, now.derivative[10:], seen])

    x = np.concatenate([state[:6], [0.6, 0.2, 1.1], state[10:]])
    steps = 1e-4 * np.eye(12)
    expected = np.stack([(rate(x + h) - rate(x - h)) / 2e-4 for h in steps], axis=-1)
    assert found.A.to_numpy() == pytest.approx(expected[:12], rel=1e-5, abs=1e-5)
    assert found.C.to_numpy()[12:] == pytest.approx(expected[12:], rel=1e-5, abs=1e-5)
    assert_allclose(found.C.to_numpy()[:12], np.eye(12))
    for name in controls:
        more, less = (rate(x, controls | {name: controls[name] + h}) for h in (1e-4, -1e-4))
        by_input = np.concatenate([found.B[name], found.D[name][12:]])
        assert by_input == pytest.approx((more - less) / 2e-4, rel=1e-5, abs=1e-6)


class TestSpread:
    def test_is_that_of_the_slopes(self, linear, level, glider):
        many = linearize(MODEL, glider, level, n_paths=2000, random_state=1, air=AIR)
        assert_allclose(many.A, linear.A)
        std = linear.A * 0.0 + many.paths.A.std(axis=0)
        for entry in (("q", "q"), ("q", "w"), ("v", "v")):
            assert_allclose(std.loc[entry], 0.1 * abs(linear.A.loc[entry]), rtol=0.1)
        by_elevator = (linear.B * 0.0 + many.paths.B.std(axis=0)).loc["q", "elevator"]
        assert_allclose(by_elevator, 0.1 * abs(linear.B.loc["q", "elevator"]), rtol=0.1)
        assert_allclose(std.loc["u", "theta"], 0.0, atol=1e-9)

    def test_each_path_is_the_linear_aircraft_of_its_own_function(self, level, glider):
        many = linearize(MODEL, glider, level, n_paths=3, random_state=2, air=AIR)
        values, _ = sampler(3, 2)
        for k in range(3):
            alone = Aerodynamics(lambda X, k=k: values(np.broadcast_to(X, (3, *X.shape)))[k], NAMES)
            one = linearize(alone, glider, level, air=AIR)
            for name in "ABCD":
                path, table = getattr(many.paths, name), getattr(one, name)
                assert path[k] == pytest.approx(table.to_numpy(), rel=1e-6, abs=1e-6)


AT_REST = np.where(np.arange(13) == 6, 1.0, 0.0)
LOOP = Aerodynamics(  # pulled up where it is pushed down, and down where up: no az fits
    lambda X: MODEL(X[:, :8]) + np.where(X[:, 8:] < 0, 1.0, -1.0) * np.eye(6)[2], [*NAMES, "az"]
)


@pytest.mark.parametrize(("model", "change", "match"), [
    (MODEL, lambda at: {"n_paths": 1}, "n_paths=1, but expected 0 or at least 2"),
    (MODEL, lambda at: {"point": at.state[:12], "controls": at.controls}, "expected a Trim or a state of 13"),
    (MODEL, lambda at: {"point": at.state}, "state without controls"),
    (MODEL, lambda at: {"point": AT_REST, "controls": at.controls}, "at rest"),
    (MODEL, lambda at: {"point": at.state, "controls": {"elevator": 0.0, "rudder": 0.0, "thrust": 1.0}}, "'aileron'"),
    (Aerodynamics(MODEL.function, NAMES), lambda at: {"n_paths": 5}, "without posterior samples"),
    (Aerodynamics(lambda X: MODEL(X) * np.nan, NAMES), lambda at: {}, "not finite"),
    (LOOP, lambda at: {}, "not determined"),
])  # fmt: skip
def test_what_cannot_be_linearized(glider, level, model, change, match):
    options = {"point": level} | change(level)
    with pytest.raises((ValueError, TypeError), match=match):
        linearize(
            model, glider, options.pop("point"), options.pop("controls", None), air=AIR, **options
        )


ALONG, ACROSS = ["u", "w", "q", "theta"], ["v", "p", "r", "phi"]


def test_outputs(linear, level):
    V, alpha = 20.0, level.alpha
    assert list(linear.C.index) == [*linear.A, "airspeed", "alpha", "beta", "ax", "ay", "az"]
    assert_allclose(linear.C.loc["airspeed", ["u", "w"]], [np.cos(alpha), np.sin(alpha)])
    assert_allclose(linear.C.loc["alpha", ["u", "w"]], [-np.sin(alpha) / V, np.cos(alpha) / V])
    assert_allclose(linear.C.loc["beta", "v"], 1 / V)
    assert_allclose(linear.C.loc["az", "w"], linear.A.loc["w", "w"])
    assert_allclose(linear.D.loc["ax", "thrust"], linear.B.loc["u", "thrust"])
    assert_allclose(linear.D.loc["az", "elevator"], linear.B.loc["w", "elevator"])


class TestParts:
    def test_split(self, linear, level, glider):
        """Straight flight of a symmetric aircraft has no coupling: the parts have its modes."""
        parts = [np.linalg.eigvals(linear.A.loc[part, part]) for part in (ALONG, ACROSS)]
        both = np.linalg.eigvals(linear.A.loc[ALONG + ACROSS, ALONG + ACROSS])
        assert_allclose(np.sort_complex(np.concatenate(parts)), np.sort_complex(both), rtol=1e-6)

    def test_height_changes_the_density(self, glider, level):
        high = linearize(MODEL, glider, level, air=Air(gravity=9.79))
        assert high.A.loc["w", "down"] < 0
        assert_allclose(high.A.loc["down", "theta"], -20.0)


LAG = 0.08  # of the servos [s]
SURFACES = ["elevator", "aileron", "rudder"]
POSITIONS = [f"{name}_position" for name in SURFACES]
LATE = Aerodynamics(MODEL.function, NAMES, sampler=sampler, servo_lag=LAG)


@pytest.fixture(scope="module")
def late(glider, level):
    return linearize(LATE, glider, level, air=AIR, n_paths=3)


class TestServos:
    """A servo lag T: T d(deflection)/dt = command - deflection."""

    def test_deflections_are_states_and_commands_are_inputs(self, late, level, glider):
        states = [*late.A]
        assert states[-3:] == POSITIONS
        assert [*late.A.index] == [*late.B.index] == [*late.C] == states
        assert [*late.B] == [*late.D] == [*SURFACES, "thrust"]
        outputs = ["airspeed", "alpha", "beta", "ax", "ay", "az"]
        assert [*late.C.index] == [*late.D.index] == [*states, *outputs]
        servo = late.A.loc[POSITIONS]
        assert_allclose(servo[POSITIONS], -np.eye(3) / LAG)
        assert not servo.drop(columns=POSITIONS).any(axis=None)
        assert_allclose(late.B.loc[POSITIONS, SURFACES], np.eye(3) / LAG)

    def test_deflections_act_as_inputs_without_a_lag_do(self, late, linear):
        body = [*linear.A]
        outputs = [*linear.C.index[12:]]
        assert_allclose(late.A.loc[body, POSITIONS], linear.B[SURFACES])
        assert_allclose(late.C.loc[outputs, POSITIONS], linear.D.loc[outputs, SURFACES])
        assert not late.B.loc[body, SURFACES].any(axis=None)
        assert not late.D[SURFACES].any(axis=None)
        assert_allclose(late.B.loc[body, "thrust"], linear.B["thrust"])
        assert_allclose(late.D.loc[outputs, "thrust"], linear.D.loc[outputs, "thrust"])

    def test_the_rest_is_the_model_without_a_lag_and_so_are_its_modes(self, late, linear):
        body = [*linear.A]
        assert_frame_equal(late.A.loc[body, body], linear.A)
        assert_frame_equal(late.C.loc[[*linear.C.index], body], linear.C)
        columns = ["eigenvalue", "frequency", "damping", "time_constant"]
        assert_frame_equal(late.modes()[columns], linear.modes()[columns])

    def test_paths_have_the_same_servos(self, late, level, glider):
        at_once = linearize(MODEL, glider, level, air=AIR, n_paths=3)
        states = [*late.A]
        places = [states.index(name) for name in POSITIONS]
        inputs = [[*late.B].index(name) for name in SURFACES]
        paths = late.paths
        assert_allclose(paths.A[:, :12, places], at_once.paths.B[..., inputs])
        assert_allclose(paths.C[:, 15:, places], at_once.paths.D[:, 12:, inputs])
        servos = np.broadcast_to(-np.eye(3) / LAG, (3, 3, 3))
        assert_allclose(paths.A[np.ix_(range(3), places, places)], servos)
        std = ["frequency_std", "damping_std"]
        assert_frame_equal(late.modes()[std], at_once.modes()[std])

    @pytest.mark.parametrize("surface", SURFACES)
    def test_response_to_a_doublet_is_that_of_the_simulation(self, late, level, glider, surface):
        """The difference is of second order in the doublet: halved, it is a quarter."""
        time = np.arange(0.0, 3.01, 0.01)
        doublet = np.interp(time, [0.2, 0.21, 0.5, 0.51, 0.8, 0.81], [0, 1, 1, -1, -1, 0])
        names = ["p", "q", "r", "phi", "theta", "alpha", "beta", "ax", "ay", "az"]

        def errors(size):
            commands = {name: level.controls[name] + 0.0 * time for name in level.controls}
            commands[surface] = commands[surface] + size * doublet
            flown = simulate(
                LATE, glider, level, pd.DataFrame({"time": time, **commands}), 0.01, air=AIR
            )
            deviations = pd.DataFrame(0.0, index=time, columns=[*late.B])
            deviations[surface] = size * doublet
            system = tuple(matrix.to_numpy() for matrix in (late.A, late.B, late.C, late.D))
            _, response, _ = lsim(system, deviations.to_numpy(), time)
            response = pd.DataFrame(response, columns=[*late.C.index])
            found = flown[names] - flown[names].iloc[0]
            expected = response[names] - response[names].iloc[0]
            position = flown[surface].to_numpy() - level.controls[surface]
            servo = response[f"{surface}_position"].to_numpy()
            assert_allclose(position, servo, rtol=0, atol=1e-9)
            return found.sub(expected).abs().max(), expected.abs().max()

        error, size = errors(0.01)
        moved = size > 1e-9
        assert moved.sum() >= 4
        assert (error[moved] < 0.01 * size[moved]).all()
        smaller, _ = errors(0.005)
        assert smaller.max() < 0.3 * error.max()

    def test_elevons_move_the_mixed_controls_with_the_same_lag(self, level, glider):
        """Controls are linear in the surfaces, which all have the same servos."""
        elevons = ("elevon_left", "elevon_right")
        mixing = Mixing(elevons, ("elevator", "aileron"), np.array([[0.5, 0.5], [-0.5, 0.5]]))
        model = Aerodynamics(MODEL.function, NAMES, servo_lag=LAG, mixing=mixing)
        late = linearize(model, glider, level, air=AIR)
        assert [*late.A][-3:] == POSITIONS
        elevator = level.controls["elevator"]
        time = np.arange(0.0, 1.01, 0.01)
        step = 0.002 * np.minimum(time / 0.01, 1.0)
        commands = {
            **{name: level.controls[name] for name in ("rudder", "thrust")},
            "elevon_left": elevator - step,
            "elevon_right": elevator + step,
        }
        flown = simulate(
            model, glider, level, pd.DataFrame({"time": time, **commands}), 0.01, air=AIR
        )
        B = late.B[["aileron"]].to_numpy()
        system = late.A.to_numpy(), B, late.C.to_numpy(), late.D[["aileron"]].to_numpy()
        _, response, _ = lsim(system, step, time)
        p = response[:, [*late.C.index].index("p")]
        assert_allclose(flown["p"], p, atol=1e-3 * np.abs(p).max())

    def test_gain_margin_of_a_bank_loop_is_where_the_simulation_turns_unstable(
        self, late, level, glider
    ):
        """aileron = trim - k phi, with the margin by the frequency response of the linear model."""
        A, B = late.A.to_numpy(), late.B["aileron"].to_numpy()
        phi = [*late.A].index("phi")

        def response(omega):
            return np.linalg.solve(1j * omega * np.eye(len(A)) - A, B)[phi]

        omega = brentq(lambda omega: response(omega).imag, 8.0, 40.0)
        assert response(omega).real < 0
        limit = 1.0 / abs(response(omega))

        def growth(gain):
            """Return the growth of the oscillation about its mean, from peak to later peak."""

            def law(t, state):
                return level.controls | {"aileron": level.controls["aileron"] - gain * state["phi"]}

            start = level.state.copy()
            start[6:10] = euler_to_quaternion(1e-3, level.theta, 0.0)
            flown = simulate(LATE, glider, start, law, 0.01, duration=8.0, air=AIR)
            p = np.abs(flown["p"].to_numpy())
            peaks = p[find_peaks(p)[0]]
            return peaks[-1] / peaks[len(peaks) // 2]

        assert growth(0.97 * limit) < 0.95
        assert growth(1.03 * limit) > 1.05
