"""Linearization of records: slopes by states and parameters, instruments, servos and answers to gusts."""

from functools import cache

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp._flight.frames import euler_to_matrix
from skdgp.dynamics import Aircraft
from skdgp.estimation import AirSettings
from skdgp.estimation._air_linearization import N_STATES, Layout, linearized
from skdgp.estimation._air_model import Inputs
from skdgp.estimation._air_parameters import DERIVATIVES, OWN, SHARED, TERMS, derivatives_of
from skdgp.estimation._air_records import Record, servo_output

SURFACES = ["elevator", "aileron", "rudder"]
AIRCRAFT = Aircraft(
    mass=1.9,
    inertia=[[0.09, 0.002, -0.015], [0.002, 0.11, 0.001], [-0.015, 0.001, 0.17]],
    wing_area=0.32,
    span=1.27,
    chord=0.25,
)


@cache
def flight_of_sines(n=30):
    """A record at states where nothing vanishes, parameters by name, and states of the filter."""
    rng = default_rng(2)
    t = 0.02 * np.arange(n)[:, None]
    wave = lambda k: np.sin(2 * t + rng.uniform(0, 6, k))  # noqa: E731
    attitude = np.swapaxes(euler_to_matrix(*(0.3 * wave(3) + np.array([0.1, 0.2, 1.0])).T), 1, 2)
    inputs = Inputs(0.1 * wave(3), wave(6) + 2, np.full(n, 1.2))
    measured = np.column_stack([3 * wave(3), 0.5 * wave(3), 17 + wave(1), 0.1 * wave(2)])
    record = Record(
        0,
        np.arange(n),
        t[:, 0],
        0.3 * wave(3) + np.array([17.0, 1.0, 1.5]),
        attitude,
        measured,
        inputs,
    )
    derivatives = derivatives_of(TERMS, SURFACES)
    value = {name: DERIVATIVES.get(name, (0.01, 0))[0] for name in derivatives}
    value |= {
        name: mean + 0.3 * min(std, 5.0) for name, (mean, std) in (dict(SHARED) | OWN).items()
    }
    value |= {"servo_lag": 0.03}
    states = 0.2 * wave(N_STATES)
    return record, Layout.of(list(derivatives), SURFACES), value, states


DECAY = np.append(np.linspace(0.3, 2.0, N_STATES - 3), np.zeros(3))


def moved(name, move):
    record, layout, value, states = flight_of_sines()
    value = value | {name: value[name] + move}
    return linearized(record, layout, AIRCRAFT, value, states, DECAY)


@pytest.mark.parametrize("name", flight_of_sines()[1].names)
def test_slopes_by_parameters_are_those_of_the_predictions(name):
    here, step = moved(name, 0.0), 1e-5
    later, before = moved(name, step), moved(name, -step)
    j = flight_of_sines()[1].names.index(name)
    pairs = (
        ("predicted", here.transition_slopes),
        ("innovation", -here.innovation_slopes),
        ("residual", -here.residual_slopes),
    )
    for field, slopes in pairs:
        numeric = (getattr(later, field) - getattr(before, field)) / (2 * step)
        if field == "residual":  # the state that it starts from moves as well
            numeric += (here.residual_states @ here.transition_slopes)[..., j]
        scale = np.abs(numeric).max() + 1e-3
        # terms within a step are taken as the mean of its ends, which is least true of rates
        atol = 0.2 if name.endswith(("_p", "_q", "_r")) else 0.05
        assert_allclose(slopes[..., j] / scale, numeric / scale, atol=atol)


def test_slopes_by_states_are_those_of_the_predictions():
    record, layout, value, states = flight_of_sines()
    here = linearized(record, layout, AIRCRAFT, value, states, DECAY)
    for i in range(N_STATES):
        shift = np.zeros(N_STATES)
        shift[i] = 1e-5
        later, before = (
            linearized(record, layout, AIRCRAFT, value, states + sign * shift, DECAY)
            for sign in (1, -1)
        )
        for field, slopes in (
            ("predicted", here.transition),
            ("innovation", -here.innovation_states),
            ("residual", -here.residual_states @ here.transition),
        ):
            numeric = (getattr(later, field) - getattr(before, field)) / 2e-5
            assert_allclose(slopes[..., i], numeric, atol=2e-2 * np.abs(numeric).max())


def test_instruments_are_moved_by_surfaces_and_hardly_by_gusts():
    record, layout, value, calm = flight_of_sines(200)
    record.inputs.surfaces[:] *= 5
    gusty = calm.copy()
    gusty[:, :3] += default_rng(0).standard_normal((200, 3))
    still = record._replace(inputs=record.inputs._replace(surfaces=np.zeros((200, 3))))
    at = np.array([layout.names.index(name) for name in ("CZ_0", "CZ_alpha")])
    slopes, instruments = [], []
    for flown, states in ((record, calm), (record, gusty), (still, gusty)):
        linear = linearized(flown, layout, AIRCRAFT, value, states, DECAY)
        for columns, out in ((at, slopes), (len(layout.names) + at, instruments)):
            offset, slope = linear.innovation_slopes[:, 2, columns].T
            out.append(
                slope - offset * (offset @ slope) / (offset @ offset)
            )  # without the pressure
    assert np.corrcoef(slopes)[0, 1] < 0.7
    assert np.corrcoef(instruments)[0, 1] > 0.95
    assert np.std(instruments[2]) < 0.01 * np.std(instruments[1])


def test_answers_are_the_part_of_surfaces_that_earlier_innovations_explain():
    record, *_ = flight_of_sines(2000)
    pushes, later = default_rng(0).standard_normal((2, 1999))
    answer = np.convolve(np.append(0, pushes), 0.9 ** np.arange(50))[:2000]
    record.inputs.surfaces[:, 0] = answer
    record.inputs.surfaces[:, 1] = np.append(later[3:], np.zeros(4))
    answers = record.with_answers(np.column_stack([pushes, later]), AirSettings()).answers
    assert np.std(answer - answers[:, 0]) < 0.15 * np.std(answer)
    assert np.std(answers[:, 1]) < 0.2 * np.std(later)


def test_lag_of_a_ramp_is_the_lag():
    ramp = np.arange(200.0)[:, None]
    assert_allclose(servo_output(ramp, 0.1, 0.02)[100:], ramp[100:] - 5.0, atol=1e-6)
    assert_allclose(servo_output(ramp, 0.0, 0.02), ramp, atol=0.01)


def test_slope_by_a_lag_of_zero_is_that_above_it():
    record, layout, value, states = flight_of_sines()
    at_zero, above = (
        linearized(record, layout, AIRCRAFT, value | {"servo_lag": lag}, states, DECAY)
        for lag in (0.0, 1e-3)
    )
    j = layout.place("servo_lag")[0]
    expected = above.innovation_slopes[..., j]
    assert np.abs(expected).max() > 0.1
    assert_allclose(at_zero.innovation_slopes[..., j], expected, atol=0.1 * np.abs(expected).max())
