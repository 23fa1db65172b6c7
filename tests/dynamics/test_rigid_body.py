"""The rigid body under several loads; its equations are those that test_simulate.py types from the textbook."""

from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.dynamics import rigid_body_derivative

RNG = default_rng(5)


def test_one_state_under_many_loads(aircraft):
    state = RNG.normal(size=13)
    force, moment = RNG.normal(size=(5, 3)), RNG.normal(size=(5, 3))
    found = rigid_body_derivative(state, force, moment, aircraft)
    each = [
        rigid_body_derivative(state, *loads, aircraft) for loads in zip(force, moment, strict=True)
    ]
    assert_allclose(found, each, rtol=1e-12)
