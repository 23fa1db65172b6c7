"""Equations of the filter-error method and of a path against their definitions: slopes, filter, covariance."""

from functools import cache

import numpy as np
import pytest
from flight_columns import EULER, FORCES, RATES, SURFACES, VELOCITY
from made_flights import LINEAR_GLIDER, flight_of_motion
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from skdgp.dynamics import air_data, euler_to_matrix
from skdgp.estimation import FlightPath, flights_of
from skdgp.estimation._air_covariance import (
    add_attenuation,
    add_delay_error,
    add_model_error,
    inflate,
    misfit_of,
    spread_of,
    without_estimate,
)
from skdgp.estimation._air_linearization import (
    CONSTANTS,
    N_STATES,
    Expansion,
    Layout,
)
from skdgp.estimation._air_model import Inputs, Slipstream, sensors
from skdgp.estimation._air_parameters import (
    AIRCRAFT_CONSTANTS,
    DERIVATIVES,
    FLIGHT_CONSTANTS,
    TERMS,
    derivatives_of,
)
from skdgp.estimation._air_records import Record
from skdgp.estimation._kalman import (
    Linearization,
    Noise,
    Slopes,
    filtered,
    noise_slopes,
    parameter_slopes,
    smoothed,
)
from skdgp.estimation._least_squares import Equations, GaussianPrior, solve
from skdgp.estimation._path_equations import PLACE, path_equations
from skdgp.estimation._servos import servo_output


@cache
def flight_of_sines(n=30):
    """A record at states where nothing vanishes, parameters by name, and states of the filter."""
    rng = default_rng(2)
    t = 0.02 * np.arange(n)[:, None]
    wave = lambda k: np.sin(2 * t + rng.uniform(0, 6, k))  # noqa: E731
    attitude = np.swapaxes(euler_to_matrix(*(0.3 * wave(3) + [0.1, 0.2, 1.0]).T), 1, 2)
    thrust = wave(6) + 2
    thrust[:, 0] = 8 + 3 * wave(1)[:, 0]
    inputs = Inputs(0.1 * wave(3), thrust, np.full(n, 1.2))
    measured = np.column_stack([3 * wave(3), 0.5 * wave(3), 17 + wave(1), 0.1 * wave(2)])
    record = Record(
        0,
        np.arange(n),
        t[:, 0],
        0.3 * wave(3) + [17.0, 1.0, 1.5],
        attitude,
        measured,
        measured[:, :3],
        np.array([0.3, -0.1, 0.2]),
        np.zeros((n, 3)),
        inputs,
        np.zeros((6, 6)),
        np.zeros((n, 4)),
    )
    by_thrust = {"Cm": (*TERMS["Cm"], "thrust"), "Cn": (*TERMS["Cn"], "thrust")}
    derivatives = derivatives_of(TERMS | by_thrust, SURFACES)
    value = {name: DERIVATIVES.get(name, (0.01, 0))[0] for name in derivatives}
    value |= {
        name: mean + 0.3 * min(std, 5.0)
        for name, (mean, std) in (dict(AIRCRAFT_CONSTANTS) | FLIGHT_CONSTANTS).items()
    }
    value |= {"servo_lag": 0.03, "slipstream": 3.0, "Cm_elevator": -1.0}
    states = 0.2 * wave(N_STATES)
    return (
        record,
        Layout.of(LINEAR_GLIDER.aircraft, 0.05, list(derivatives), SURFACES),
        value,
        states,
    )


def test_a_slipstream_has_the_dynamic_pressure_of_momentum_theory():
    """Behind a propeller of the disk A it is that of the air and the thrust over A; other surfaces feel the air."""
    pressure, thrust, wing_area, disk = 180.0, np.array([9.0, 4.0]), 0.4, 0.08
    behind = pressure + thrust / disk
    tau = thrust / (pressure * wing_area)
    wake = Slipstream(wing_area / disk, tau[1], np.array([1.0, 0.0]))
    assert_allclose(wake.effect(tau), [[behind[0] / behind[1], 1.0], [1.0, 1.0]])


DECAY = np.append(np.linspace(0.3, 2.0, N_STATES - 3), np.zeros(3))


def expanded(record, layout, value, states):
    return Expansion(record, layout, value, states, DECAY)


def linearized(*parts):
    return expanded(*parts).linearization()


def slopes_at(*parts):
    return expanded(*parts).slopes(slice(None))


def differences(change):
    """Return the derivatives of predictions, past errors and path errors by a change of parts of `linearized`."""
    later, before = (linearized(*change(move)) for move in (1e-5, -1e-5))
    fields = ("predicted", "past_error", "path_error")
    return [(getattr(later, name) - getattr(before, name)) / 2e-5 for name in fields]


@pytest.mark.parametrize("name", flight_of_sines()[1].names)
def test_slopes_by_parameters_are_those_of_the_predictions(name):
    record, layout, value, states = flight_of_sines()
    H = linearized(record, layout, value, states).H
    here = slopes_at(record, layout, value, states)
    numeric = differences(lambda move: (record, layout, value | {name: value[name] + move}, states))
    # the state that the error along the path starts from moves as well
    slopes = here.Theta, -here.E, -here.F - H @ here.Theta
    # terms within a step are taken as the mean of its ends, which is least true of rates
    atol = 0.2 if name.endswith(("_p", "_q", "_r")) else 0.05
    if name in CONSTANTS:
        atol = 0.01
    j = layout.names.index(name)
    for found, expected in zip(slopes, numeric, strict=True):
        scale = np.abs(expected).max() + 1e-3
        assert_allclose(found[..., j] / scale, expected / scale, atol=atol)


def test_slopes_by_states_are_those_of_the_predictions():
    record, layout, value, states = flight_of_sines()
    here = linearized(record, layout, value, states)
    slopes = here.Phi, -here.D, -here.H @ here.Phi
    for i, unit in enumerate(np.eye(N_STATES)):
        numeric = differences(lambda move, unit=unit: (record, layout, value, states + move * unit))
        for found, expected in zip(slopes, numeric, strict=True):
            assert_allclose(found[..., i], expected, atol=2e-2 * np.abs(expected).max())


def test_instruments_are_moved_by_surfaces_and_hardly_by_gusts():
    record, layout, value, calm = flight_of_sines(200)
    moving = record._replace(inputs=record.inputs._replace(surfaces=5 * record.inputs.surfaces))
    still = record._replace(inputs=record.inputs._replace(surfaces=np.zeros((200, 3))))
    gusty = calm.copy()
    gusty[:, :3] += default_rng(0).standard_normal((200, 3))
    at = np.array([layout.names.index(name) for name in ("CZ_0", "CZ_alpha")])
    slopes, instruments = [], []
    for flown, states in ((moving, calm), (moving, gusty), (still, gusty)):
        E = slopes_at(flown, layout, value, states).E
        for columns, out in ((at, slopes), (len(layout.names) + at, instruments)):
            offset, slope = E[:, 2, columns].T
            of_pressure = offset * (offset @ slope) / (offset @ offset)
            out.append(slope - of_pressure)
    assert np.corrcoef(slopes)[0, 1] < 0.7
    assert np.corrcoef(instruments)[0, 1] > 0.95
    assert np.std(instruments[2]) < 0.01 * np.std(instruments[1])


def test_a_delay_of_the_servos_is_that_of_later_commands():
    """To first order in the delay, after the servos have started."""
    record, layout, value, states = flight_of_sines()
    d = 0.004
    commands = np.sin(2 * record.time)[:, None]
    sines = record._replace(inputs=record.inputs._replace(surfaces=np.tile(commands, 3)))
    value = value | {"servo_delay": d}
    delayed = Expansion(sines, layout, value, states, DECAY).inputs.surfaces
    later_commands = np.sin(2 * (record.time - d))[:, None]
    later = servo_output(later_commands, value["servo_lag"], record.median_step)
    assert_allclose(delayed[15:-1], np.tile(later, 3)[15:-1], atol=2 * d**2)


def test_lag_of_a_ramp_is_the_lag():
    ramp = np.arange(200.0)[:, None]
    assert_allclose(servo_output(ramp, 0.1, 0.02)[100:], ramp[100:] - 5.0, atol=1e-6)
    assert_allclose(servo_output(ramp, 0.0, 0.02), ramp, atol=0.01)


def test_error_of_a_delay_moves_the_other_parameters_as_least_squares_does():
    """Of y = X a + d s with a wrong d, the estimates of a move by the regression of s on X."""
    rng = default_rng(0)
    X, s = rng.normal(size=(50, 3)), rng.normal(size=50)
    columns = np.column_stack([X[:, :1], s, X[:, 1:]])
    covariance = add_delay_error(np.zeros((4, 4)), columns.T @ columns, 1, 0.1)
    moved = -np.linalg.lstsq(X, s, rcond=None)[0]
    expected = 0.1 * np.array([moved[0], 1.0, *moved[1:]])
    assert_allclose(covariance, np.outer(expected, expected), atol=1e-12)


def test_roll_of_the_air_is_no_roll_of_the_aircraft():
    """The moment is that of the rate relative to the air; gyros and gyroscopic moments are not."""
    record, layout, value, _ = flight_of_sines()
    model = layout.model(value)
    still = np.concatenate([[17.0, 1.0, 1.5], default_rng(1).normal(0, 0.3, 3), np.zeros(7)])[None]
    rolling = still.copy()
    rolling[:, -1] = 0.2
    inputs = record.inputs.part(slice(1))
    change = model.accelerations(rolling, inputs) - model.accelerations(still, inputs)
    slower = still[:, 3:6] - [[0.2, 0.0, 0.0]]
    air = air_data(still[:, :3])
    terms = [model.terms(air, rates, inputs) for rates in (still[:, 3:6], slower)]
    errors = still.copy()
    errors[:, 6:12] = (terms[1] - terms[0]) @ model.derivatives.T
    expected = model.accelerations(errors, inputs) - model.accelerations(still, inputs)
    assert np.abs(expected).max() > 0.1
    assert_allclose(change, expected, atol=1e-12)
    readings = [
        sensors(model.accelerations(variables, inputs), variables, np.zeros(3))[0, 3:6]
        for variables in (still, rolling)
    ]
    assert_allclose(*readings)


def linear_system(rng, n=7, N=3, m=2):
    """A filter that is linear, with predictions of a sample by way of the predicted state alone."""
    Phi = 0.5 * rng.standard_normal((n - 1, N, N))
    H = rng.standard_normal((n - 1, m, N))
    y = rng.standard_normal((n - 1, m))
    shared = rng.standard_normal((m, 1))
    linear = Linearization(
        states=np.zeros((n, N)),
        predicted=np.zeros((n - 1, N)),
        Phi=Phi,
        past_error=y,
        D=H @ Phi,
        L=H,
        path_error=y,
        H=H,
        time_step=rng.uniform(0.1, 0.2, n - 1),
        surface_noise=np.zeros((n - 1, N, N)),
        surface_reading_variance=np.zeros((n - 1, m)),
        added=np.tile(shared @ shared.T, (n - 1, 1, 1)),
    )
    noises = Noise(
        density=rng.uniform(1, 2, (1, N)),
        decay=np.zeros((1, N)),
        surface=np.zeros(1),
        sensor=rng.uniform(1, 2, (1, m)),
        start=rng.uniform(1, 2, (1, N)),
    )
    return linear, noises


def joint_distribution(linear, noises):
    """Return cov(x), H and cov(y) of all states x = M (x_0, w_1, ...) and readings y = H x + v.

    The noise of a step is by Simpson's rule.
    """
    (n, N), m = linear.states.shape, linear.past_error.shape[1]
    M = np.zeros((n, N, n * N))
    M[0, :, :N] = np.eye(N)
    Q = [np.diag(noises.start[0])]
    for k in range(1, n):
        Phi = linear.Phi[k - 1]
        M[k] = Phi @ M[k - 1]
        M[k, :, k * N : (k + 1) * N] += np.eye(N)
        half = 0.5 * (np.eye(N) + Phi)
        rate = np.diag(noises.density[0] * linear.time_step[k - 1])
        Q.append((rate + 4 * half @ rate @ half.T + Phi @ rate @ Phi.T) / 6)
    M = M.reshape(n * N, n * N)
    X = M @ block_diag(*Q) @ M.T
    H = np.hstack([np.zeros(((n - 1) * m, N)), block_diag(*linear.H)])
    R = np.diag(noises.sensor[0]) + linear.added
    return X, H, H @ X @ H.T + block_diag(*R)


def test_linear_filter_has_the_innovations_of_the_joint_distribution():
    linear, noises = linear_system(default_rng(0))
    found = filtered(linear, noises)
    m, y = linear.past_error.shape[1], linear.past_error.ravel()
    _, _, S = joint_distribution(linear, noises)
    for k in range(len(linear.past_error)):
        past, now = slice(0, k * m), slice(k * m, (k + 1) * m)
        gain = S[now, past] @ np.linalg.inv(S[past, past])
        covariance = S[now, now] - gain @ S[past, now]
        assert_allclose(found.innovations[k], y[now] - gain @ y[past], atol=1e-10)
        assert_allclose(found.innovation_covariance[k], covariance, atol=1e-10)


@pytest.mark.parametrize("field", Noise._fields)
def test_slopes_by_noises_are_those_of_the_filter(field):
    """With a state that decays, without noise of its own, and surfaces that err, in several parts of a record."""
    linear, noises = linear_system(default_rng(0), n=140)
    push = default_rng(5).normal(size=(len(linear.time_step), 3, 3))
    linear = linear._replace(
        surface_noise=push @ push.mT, surface_reading_variance=push[:, 0, :2] ** 2
    )
    noises = noises._replace(
        decay=np.array([[0.5, 0.0, 0.0]]),
        density=np.array([[0.0, 1.0, 2.0]]),
        surface=np.array([0.7]),
    )

    def run(noises):
        Phi = linear.Phi.copy()
        Phi[:, 0, 0] = np.exp(-linear.time_step * noises.decay[0, 0])
        system = linear._replace(Phi=Phi)
        return system, filtered(system, noises)

    change = Noise(*(np.zeros_like(part) for part in noises))
    getattr(change, field).flat[0] = 1.0
    step = 1e-6
    moved = Noise(*(part + step * slope for part, slope in zip(noises, change, strict=True)))
    system, here = run(noises)
    _, *parts = zip(*noise_slopes(system, here, noises, change), strict=True)
    of_innovations, of_covariance = map(np.concatenate, parts)
    _, later = run(moved)
    found = (later.innovations - here.innovations) / step
    assert_allclose(of_innovations[..., 0], found, atol=1e-5)
    found = (later.innovation_covariance - here.innovation_covariance) / step
    assert np.abs(found).max() > 0.01
    assert_allclose(of_covariance[:, :, 0], found, atol=1e-5)


def test_linear_smoother_has_the_conditional_distribution():
    linear, noises = linear_system(default_rng(0))
    states, covariance = smoothed(linear, filtered(linear, noises))
    X, H, S = joint_distribution(linear, noises)
    gain = X @ H.T @ np.linalg.inv(S)
    assert_allclose(states.ravel(), gain @ linear.past_error.ravel(), atol=1e-10)
    P = X - gain @ H @ X
    N = states.shape[1]
    for k, found in enumerate(covariance):
        at = slice(k * N, (k + 1) * N)
        assert_allclose(found, P[at, at], atol=1e-10)


def test_slopes_of_innovations_are_those_of_a_filter_with_the_same_gains():
    linear, noises = linear_system(default_rng(3), n=140)
    (n, N), m = linear.states.shape, linear.past_error.shape[1]
    Theta = default_rng(4).standard_normal((n - 1, N, 1))
    slopes = Slopes(Theta, linear.H @ Theta, np.zeros((n - 1, m, 1)))
    run = filtered(linear, noises)
    push = 1e-6 * (linear.H @ Theta)[..., 0]
    moved = linear._replace(
        predicted=linear.predicted + 1e-6 * Theta[..., 0],
        past_error=linear.past_error - push,
        path_error=linear.path_error - push,
    )
    again = filtered(moved, noises)
    found = parameter_slopes(linear, run, lambda steps: Slopes(*(part[steps] for part in slopes)))
    _, *parts = zip(*found, strict=True)
    of_innovations, of_states = map(np.concatenate, parts)
    change = (again.innovations - run.innovations) / 1e-6
    assert_allclose(of_innovations[..., 0], change, atol=1e-6)
    change = (again.states - run.states)[1:] / 1e-6
    assert_allclose(of_states[..., 0], change, atol=1e-6)


def test_covariances_in_named_steps_are_those_by_hand():
    covariance = np.array([[4.0, 1.0], [1.0, 9.0]])
    assert_allclose(inflate(covariance, 2.0), [[16.0, 4.0], [4.0, 36.0]])
    assert_allclose(add_model_error(covariance, np.array([-5.0]), 0.2), [[5.0, 1.0], [1.0, 9.0]])
    prior_std = np.array([1.0, 2.0])
    assert_allclose(without_estimate([3.0, -1.0], prior_std), [[10.0, -3.0], [-3.0, 5.0]])
    assert_allclose(misfit_of(np.array([3.0, 1.0])), np.sqrt(5))
    assert misfit_of(np.array([0.5, -0.1])) == 1.0


def test_error_of_a_slope_covers_its_attenuation():
    """The root mean square of the slope times the fraction of errors, as far as the estimate shows it."""
    covariance = 1e-6 * np.eye(1)
    fraction = np.array([0.1])
    wide = add_attenuation(covariance, np.array([-0.9]), np.array([100.0]), fraction)
    assert_allclose(np.sqrt(wide), 0.1, rtol=1e-4)  # of a slope of -1 that seems to be -0.9
    # regression on a regressor with errors of a tenth of its variance
    rng = default_rng(0)
    motion = rng.normal(0, 3, 100_000)
    measured = motion + rng.normal(0, 1, motion.size)
    seen = (measured @ motion) / (measured @ measured)
    wide = add_attenuation(covariance, np.array([seen]), np.array([100.0]), fraction)
    assert abs(seen - 1) < 1.05 * np.sqrt(wide)


def test_a_search_that_still_moves_has_the_spread_of_its_last_passes():
    path = [[1.0, 5.0], [3.0, 1.0], [2.0, 3.0]]
    assert_allclose(spread_of(path), np.array([[2.0, -4.0], [-4.0, 8.0]]) / 3)


EPS = 1e-6
TURN, SPEED = 0.4, 25.0
WIND = np.array([3.0, -2.0, 0.0])
INERTIAL = [*FORCES, *RATES]


def attitude(t):
    """Return the attitude in a turn, pitched and banked."""
    return Rotation.from_euler("ZYX", np.stack([TURN * t + 0.7, 0.1 + 0 * t, 0.5 + 0 * t], axis=-1))


def velocity(t):
    """Return the velocity over the ground in a circle over moving air."""
    circle = np.stack([np.cos(TURN * t), np.sin(TURN * t), 0.1 + 0 * t], axis=-1)
    return SPEED * circle + WIND


def sensors_of(table):
    """Return the sensors of a table of one flight."""
    (flight,) = flights_of(table)
    return flight.sensors


def constants_of(**values):
    """Return the constants of a path that are zero but for some."""
    constants = np.zeros(len(PLACE))
    for name, value in values.items():
        constants[PLACE[name]] = value
    return constants


@pytest.fixture
def near_path():
    """Sensors of a turning flight, and a path near it that is no solution."""
    rng = default_rng(4)
    n = 12
    table = flight_of_motion(0.04 * np.arange(n), attitude, velocity, WIND)
    sensed = [*INERTIAL, "airspeed", "alpha", "beta", *VELOCITY]
    table[sensed] += rng.normal(0, 0.05, (n, len(sensed)))
    sensors = sensors_of(table)
    constants = constants_of(p_bias=0.01, wind_east=4.0)
    path = FlightPath.initial(sensors).moved(0.1 * rng.standard_normal((n, 9)), constants)
    return sensors, path


def equations(path, sensors):
    correlation = np.full(len(sensors.time) - 1, 0.9)
    return path_equations(path, sensors, correlation, np.zeros(2, dtype=int))


def test_slopes_by_states_are_those_of_the_residuals(near_path):
    sensors, path = near_path
    base = equations(path, sensors)
    for place in range(9):
        for first in (0, 1):  # every other sample moves: each equation feels one of its two
            states = np.zeros((len(sensors.time), 9))
            states[first::2, place] = EPS
            slope = (equations(path.moved(states, 0.0), sensors).residual - base.residual) / EPS
            assert_allclose(slope[first::2], base.d_state[first::2, :, place], atol=2e-3, rtol=2e-3)
            assert_allclose(
                slope[1 - first :: 2, :9],
                base.d_next[1 - first :: 2, :9, place],
                atol=2e-3,
                rtol=2e-3,
            )


@pytest.mark.parametrize("name", [name for name in PLACE if not name.endswith("_lag")])
def test_slopes_by_constants_are_those_of_the_residuals(name, near_path):
    """Those by lags are of first order only: see the recovery of lags."""
    sensors, path = near_path
    base = equations(path, sensors)
    states = np.zeros((len(sensors.time), 9))
    moved = equations(path.moved(states, constants_of(**{name: EPS})), sensors)
    slope = (moved.residual - base.residual) / EPS
    assert_allclose(slope, base.d_constants[:, :, PLACE[name]], atol=1e-3, rtol=1e-3)


@pytest.mark.parametrize("delay", [0, 3])
def test_a_turn_of_late_sensors_in_wind_and_gusts_solves_them(delay):
    n, step = 40, 0.01
    lags = {"velocity_lag": 0.032 if delay else 0.004, "attitude_lag": 0.027 if delay else -0.003}
    time = step * np.arange(n)
    correlation = np.exp(-step / 2.0)
    gust = np.multiply.outer(correlation ** np.arange(n), [0.5, -0.4, 0.3])
    table = flight_of_motion(time, attitude, velocity, WIND + gust)
    biases = {f"{name}_bias": 0.02 * k for k, name in enumerate(INERTIAL, start=1)}
    table[INERTIAL] += [*biases.values()]
    table[VELOCITY] = velocity(time - lags["velocity_lag"])
    table[EULER] = attitude(time - lags["attitude_lag"]).as_euler("ZYX")[:, ::-1]
    constants = constants_of(**biases, **lags, wind_north=WIND[0], wind_east=WIND[1])
    path = FlightPath(velocity(time), attitude(time), gust, constants)
    correlations = np.full(n - 1, correlation)
    found = path_equations(path, sensors_of(table), correlations, np.full(2, delay))
    residual = found.residual[: n - 1 - delay]
    assert np.isfinite(residual).all()
    assert_allclose(residual, 0.0, atol=2e-4)


def test_the_bordered_solution_is_that_of_the_dense_problem():
    rng = default_rng(0)
    n, s, c = 150, 3, 2
    equations = Equations(rng.normal(size=(n, 6, 2 * s + c + 1)), s)
    equations.d_next[-1] = 0.0
    prior = GaussianPrior(
        np.full((n, s), 0.3), rng.normal(size=(n, s)), np.full(c, 0.5), rng.normal(size=c)
    )
    root = np.sqrt(np.r_[prior.states.ravel(), prior.constants])

    def linear(z):
        """Return what states and constants add to the residuals, and their own deviations."""
        states, constants = z[: n * s].reshape(n, s, 1), z[n * s :, None]
        after = np.roll(states, -1, axis=0)  # the last equation has none
        of_path = equations.d_state @ states + equations.d_next @ after
        return np.r_[(of_path + equations.d_constants @ constants).ravel(), root * z]

    J = np.transpose([linear(unit) for unit in np.eye(len(root))])
    offset = np.r_[prior.states_offset.ravel(), prior.constants_offset]
    r = np.r_[equations.residual.ravel(), root * offset]
    covariance = np.linalg.inv(J.T @ J)
    solution = -covariance @ J.T @ r
    draws = np.asfortranarray(np.eye(n * s + c))
    found = solve(equations, prior, np.arange(c), draws)
    assert_allclose(np.r_[found.states.ravel(), found.constants], solution, atol=1e-10)
    assert_allclose(found.covariance, covariance[n * s :, n * s :], atol=1e-10)
    root = np.vstack([found.state_draws.reshape(n * s, -1), found.constant_draws])
    assert_allclose(root @ root.T, covariance, atol=1e-10)
