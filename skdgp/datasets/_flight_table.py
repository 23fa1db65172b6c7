"""Flight tables of simulated flights: true columns and measured ones."""

from __future__ import annotations

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS, TRUTH_SUFFIX
from skdgp.datasets._brumby import BRUMBY
from skdgp.datasets._loads import Loads, loads
from skdgp.datasets._sensors import measure
from skdgp.datasets._simulation import FlightRecord
from skdgp.dynamics import body_to_ned, quaternion_to_euler, standard_density
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY

__all__ = ["flight_table", "truth_of"]

MEASURED = (
    "time", "flight", "airspeed", "alpha", "beta", "p", "q", "r", "ax", "ay", "az", "phi", "theta", "psi",
    "north", "east", "v_north", "v_east", "v_down", "altitude", "density", "throttle", "elevator", "aileron",
    "rudder", "elevon_left", "elevon_right", "thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m",
    "thrust_n", "propeller_speed",
)  # fmt: skip
"""Columns that a logger would write; `flight_table` appends the truth."""


def truth_of(record: FlightRecord) -> Loads:
    """Return the loads at every log time of every flight, the fixed point of alpha_dot and beta_dot converged."""
    slopes = (np.zeros(record.throttle.shape), np.zeros(record.throttle.shape))
    for _ in range(8):
        now = loads(record.state, record.controls, record.wind, record.gusts, slopes)
        slopes = now.slopes
    return now


def flight_table(record: FlightRecord, truth: Loads, flight: int, name: str, noise: float, rng) -> pd.DataFrame:
    """Return flight number ``flight`` of the record: measured columns, then truth, one row per log time."""
    state = record.state[:, flight]
    known = _known_columns(record, truth, flight) | {"flight": name}
    true = pd.DataFrame(_true_columns(record, truth, flight)).add_suffix(TRUTH_SUFFIX)
    table = pd.concat([pd.DataFrame(known, index=range(len(state))), measure(true, noise, rng)], axis=1)
    return pd.concat([table[list(MEASURED)], true], axis=1)


def _known_columns(record, truth, flight) -> dict:
    """Return what is logged without noise: clock, controls, atmosphere, propulsion."""
    left, right, rudder, propeller_speed = record.controls[:, flight].T
    altitude = -record.state[:, flight, 2]
    return {
        "time": record.time,
        "altitude": altitude,
        "density": standard_density(altitude),
        "throttle": record.throttle[:, flight],
        "elevator": 0.5 * (left + right),
        "aileron": 0.5 * (left - right),
        "rudder": rudder,
        "elevon_left": left,
        "elevon_right": right,
        **_columns(("thrust_x", "thrust_y", "thrust_z"), truth.thrust_force[:, flight]),
        **_columns(("thrust_l", "thrust_m", "thrust_n"), truth.thrust_moment[:, flight]),
        "propeller_speed": propeller_speed,
    }


def _true_columns(record, truth, flight) -> dict:
    state = record.state[:, flight]
    euler = quaternion_to_euler(state[:, 6:10])
    euler[:, 2] %= 2.0 * np.pi
    derivative = truth.derivative[:, flight]
    wind = record.wind[flight] + body_to_ned(state[:, 6:10], record.gusts.velocity[:, flight])
    return {
        "airspeed": truth.airspeed[:, flight],
        "alpha": truth.alpha[:, flight],
        "beta": truth.beta[:, flight],
        "alpha_dot": truth.slopes[0][:, flight],
        "beta_dot": truth.slopes[1][:, flight],
        **_columns(("p", "q", "r"), state[:, 10:13]),
        **_columns(("p_dot", "q_dot", "r_dot"), derivative[:, 10:13]),
        **_columns(("ax", "ay", "az"), truth.force[:, flight] / BRUMBY.mass),
        **_columns(("u", "v", "w"), state[:, 3:6]),
        **_columns(("phi", "theta", "psi"), euler),
        **_columns(("north", "east"), state[:, :2]),
        **_columns(("v_north", "v_east", "v_down"), derivative[:, :3]),
        **_columns(("wind_north", "wind_east", "wind_down"), wind),
        "gravity": np.full(len(state), STANDARD_GRAVITY),
        **_columns(COEFFICIENTS, truth.coefficients[:, flight]),
    }


def _columns(names, array) -> dict:
    return dict(zip(names, array.T, strict=True))
