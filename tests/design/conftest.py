"""An aircraft to excite, and its coefficients."""

import numpy as np
import pytest

from skdgp.dynamics import Aerodynamics, Aircraft


@pytest.fixture(scope="session")
def uav():
    """Return a small aircraft."""
    return Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)


@pytest.fixture(scope="session")
def textbook():
    """Return coefficients of a textbook aircraft with induced drag."""

    def coefficients(X):
        alpha, beta, p, q, r, elevator, aileron, rudder = np.moveaxis(np.asarray(X), -1, 0)
        lift = 0.3 + 4.5 * alpha
        return np.stack([
            -0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
            -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
            0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder,
        ], axis=-1)  # fmt: skip

    names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    return Aerodynamics(coefficients, names)
