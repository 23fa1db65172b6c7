"""An aircraft to excite."""

import numpy as np
import pytest

from skdgp.dynamics import Aircraft


@pytest.fixture(scope="session")
def uav():
    """Return a small aircraft."""
    return Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
