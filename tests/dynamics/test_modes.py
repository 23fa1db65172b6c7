"""Modes of linear models: published ones, names, and their spread over paths."""

import numpy as np
import pandas as pd
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.linalg import block_diag

from skdgp.dynamics import LinearModel

ALONG, ACROSS = ["u", "w", "q", "theta"], ["v", "p", "r", "phi"]
# Boeing 747-100 at Mach 0.8 and 40,000 ft, in feet: Etkin & Reid 1996, equations 6.2,1 and 6.7,1.
LONGITUDINAL = [
    [-0.006868, 0.01395, 0, -32.2],
    [-0.09055, -0.3151, 773.98, 0],
    [0.0001187, -0.001026, -0.4285, 0],
    [0, 0, 1, 0],
]
LATERAL = [
    [-0.0558, 0, -774, 32.2],
    [-0.003865, -0.4342, 0.4136, 0],
    [0.001086, -0.006112, -0.1458, 0],
    [0, 1, 0, 0],
]


def mode_table(A, states=(*ALONG, *ACROSS), paths=None):
    """The modes of x' = A x."""
    states = list(states)
    square, empty = pd.DataFrame(A, index=states, columns=states), pd.DataFrame(index=states)
    drawn = None if paths is None else LinearModel(paths, None, None, None, 20.0, 1.2)
    return LinearModel(square, empty, square.iloc[:0], empty.iloc[:0], 20.0, 1.2, drawn).modes()


BOTH = block_diag(LONGITUDINAL, LATERAL)


NAMES = ["short period", "phugoid", "Dutch roll", "roll", "spiral"]


def test_published_modes():
    table = mode_table(BOTH)
    assert list(table.index) == NAMES
    roots = [-0.3719 + 0.8875j, -0.003289 + 0.06723j, -0.033011 + 0.94655j, -0.56248, -0.0072973]
    assert_allclose(table["eigenvalue"].to_numpy(complex), roots, rtol=1e-3)
    assert_allclose(table["period"], [7.08, 93.4, 6.64, np.inf, np.inf], rtol=3e-3)
    assert_allclose(np.log(2.0) * table["time_constant"][:2], [1.86, 211.0], rtol=3e-3)
    assert_allclose(table["time_constant"]["roll"], 1 / 0.56248, rtol=1e-3)
    assert_allclose(table["damping"]["short period"], 0.387, rtol=3e-3)


def test_names_hold_whatever_the_order_and_units_of_states():
    rng = default_rng(0)
    scale, order = np.exp(3 * rng.normal(size=8)), rng.permutation(8)
    A = (BOTH * scale[:, None] / scale)[np.ix_(order, order)]
    table = mode_table(A, [(ALONG + ACROSS)[k] for k in order])
    assert list(table.index) == NAMES
    assert_allclose(table["eigenvalue"], mode_table(BOTH)["eigenvalue"], rtol=1e-6)


def test_states_of_one_plane_alone_are_refused():
    with pytest.raises(ValueError, match="The states of the linear model lack 'v'"):
        mode_table(BOTH[:4, :4], ALONG)


def test_an_unstable_aircraft_has_a_short_period_of_two_real_roots():
    A = BOTH.copy()
    A[2, 1] *= -0.5
    table = mode_table(A)[:3]
    assert list(table.index) == ["short period 1", "short period 2", "phugoid"]
    assert table.loc["short period 1", "damping"] == 1.0
    growth = np.real(table["eigenvalue"].to_numpy(complex))
    assert_allclose(table["time_constant"], -1.0 / growth)
    assert (growth > 0).any()
    assert table["eigenvalue"].abs()["short period 1"] > table["eigenvalue"].abs()["short period 2"]


def with_dutch_roll(omega, zeta):
    """Return A of an aircraft whose Dutch roll is that of v and r alone."""
    lateral = np.diag([0.0, -20.0, -2 * zeta * omega, -0.01])
    lateral[0, 2] = 1.0
    lateral[2, 0] = -(omega**2)
    return block_diag(LONGITUDINAL, lateral)


class TestSpreadOfModes:
    def test_is_that_of_the_frequency_and_the_damping(self):
        rng = default_rng(0)
        omega, zeta = 3 + 0.1 * rng.normal(size=500), 0.4 + 0.02 * rng.normal(size=500)
        paths = np.array([with_dutch_roll(*pair) for pair in zip(omega, zeta, strict=True)])
        row = mode_table(with_dutch_roll(3.0, 0.4), paths=paths).loc["Dutch roll"]
        assert_allclose(row["frequency_std"], omega.std(ddof=1))
        assert_allclose(row["damping_std"], zeta.std(ddof=1))
        ends = np.quantile(1 / (zeta * omega), [0.025, 0.975])
        assert_allclose(row[["time_constant_lower", "time_constant_upper"]], ends, rtol=1e-2)

    def test_paths_in_which_a_pair_splits_stay_with_it(self):
        """s^2 + 2 zeta omega s + omega^2 is one mode on either side of critical damping."""
        zeta = np.array([0.9, 0.95, 1.05, 1.1])
        paths = np.array([with_dutch_roll(2.0, z) for z in zeta])
        row = mode_table(with_dutch_roll(2.0, 0.975), paths=paths).loc["Dutch roll"]
        assert_allclose(row["frequency_std"], 0.0, atol=1e-7)
        assert_allclose(row["damping_std"], zeta.std(ddof=1))
