"""Sensor models of the example flights: truth plus white noise."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._flight.channels import TRUTH_SUFFIX

__all__ = ["SENSOR_NOISE", "measure"]

DEGREE = np.pi / 180.0

SENSOR_NOISE = {
    "airspeed": 0.3,
    "alpha": 0.3 * DEGREE,
    "beta": 0.3 * DEGREE,
    "p": 0.002,
    "q": 0.002,
    "r": 0.002,
    "ax": 0.05,
    "ay": 0.05,
    "az": 0.05,
    "phi": 0.3 * DEGREE,
    "theta": 0.3 * DEGREE,
    "psi": 0.3 * DEGREE,
    "north": 0.5,
    "east": 0.5,
    "v_north": 0.1,
    "v_east": 0.1,
    "v_down": 0.1,
}
"""Standard deviations in SI units, of small UAV sensors: pitot tube and vanes, MEMS inertial unit, GPS."""


def measure(truth: pd.DataFrame, scale: float, rng: np.random.Generator) -> pd.DataFrame:
    """Return one measured column per name of `SENSOR_NOISE`, from the column of ``truth`` that ends in ``_true``.

    Noise is white and independent from channel to channel, with ``scale`` times the stated standard deviations.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> truth = pd.DataFrame(0.0, index=range(10_000), columns=[name + "_true" for name in SENSOR_NOISE])
    >>> measure(truth, 1.0, np.random.default_rng(0))["airspeed"].std().round(2)
    np.float64(0.3)
    """
    names = list(SENSOR_NOISE)
    noise = scale * np.array([*SENSOR_NOISE.values()]) * rng.standard_normal((len(truth), len(names)))
    return pd.DataFrame(
        truth[[name + TRUTH_SUFFIX for name in names]].to_numpy() + noise, index=truth.index, columns=names
    )
