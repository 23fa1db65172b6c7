"""The display of simulated flights: the flown one is on the same turn, and marked where it was not learned."""

import numpy as np
import pandas as pd
from made_flights import wrapped
from matplotlib.figure import Figure
from numpy.random import default_rng
from numpy.testing import assert_allclose

from skdgp.plotting import TimeHistoryDisplay

TIME = np.arange(0, 4, 0.02)


def ensemble(n_paths=20):
    rng = default_rng(0)
    speed = rng.normal(0, 0.5, n_paths)
    turn = rng.normal(0, 0.05, n_paths)
    parts = [
        pd.DataFrame({"start": 0, "path": k, "time": TIME + 7, "airspeed": 30 + speed[k] * TIME,
                      "psi": wrapped(3.0 + (0.3 + turn[k]) * TIME), "beyond": "", "ended": ""})
        for k in range(n_paths)
    ]  # fmt: skip
    return pd.concat(parts, ignore_index=True)


def test_headings_do_not_tear():
    paths = ensemble()
    display = TimeHistoryDisplay.from_trajectories(paths, columns=["airspeed", "psi"], ax=Figure())
    (median,) = [one for one in display.axes_.T.flat[1].lines if "median" in one.get_label()]
    assert_allclose(np.diff(median.get_ydata()), 0.0, atol=2.0)
