"""Errors of flight tables of poses with the noise of motion capture, against the truth of a simulated flight.

    python tests/benchmarks/poses.py

The flight "latlon" of the example flights, simulated at 100 Hz with gusts, as poses with noise of 1 mm and 0.1 deg.
"""

import numpy as np
import pandas as pd
from scipy.spatial.transform import Rotation

from skdgp.datasets import _example_flights
from skdgp.io import flight_from_poses

RATE, LENGTH = 100, 60.0
POSITION, ATTITUDE = 1e-3, np.deg2rad(0.1)
END = 10
"""Samples at either end of a record that are also scored by themselves."""
NAMES = ["u", "v", "w", "p", "q", "r", "ax", "ay", "az", "p_dot", "q_dot", "r_dot"]


def flown():
    """Return the truth of 60 s at 100 Hz."""
    _example_flights.LOG_STEP = 1 / RATE
    flights, _ = _example_flights._flights.__wrapped__(0, 1.0, 1.0, LENGTH)
    flight = flights[flights.flight == "latlon"].reset_index(drop=True)
    truth = flight.filter(like="_true").rename(columns=lambda name: name.removesuffix("_true"))
    return truth.assign(time=flight.time, down=-flight.altitude)


def rms(errors):
    return np.sqrt(np.mean(np.square(errors), axis=0))


def score(truth, seconds, n_records):
    """Return a table of root mean square errors of records spread over the flight, and of their ends alone."""
    n = round(seconds * RATE)
    starts = np.linspace(0, len(truth) - n, n_records).astype(int)
    rows = np.concatenate([start + np.arange(n) for start in starts])
    true, rng = truth.iloc[rows].reset_index(drop=True), np.random.default_rng(0)
    attitude = Rotation.from_euler("ZYX", true[["psi", "theta", "phi"]])
    noisy = attitude * Rotation.from_rotvec(rng.normal(0, ATTITUDE, (len(rows), 3)))
    position = true[["north", "east", "down"]] + rng.normal(0, POSITION, (len(rows), 3))
    quaternion = noisy.as_quat()[:, [3, 0, 1, 2]]
    records = np.repeat(np.arange(n_records), n)
    table = flight_from_poses(true.time, position, quaternion, frame="NED/FRD", flight=records)
    true[["u", "v", "w"]] = attitude.inv().apply(true[["v_north", "v_east", "v_down"]])
    errors = (table[NAMES] - true[NAMES]).to_numpy()
    at_end = np.minimum(np.arange(len(rows)) % n, n - 1 - np.arange(len(rows)) % n) < END
    return pd.DataFrame({"std": true[NAMES].std(), "error": rms(errors), "ends": rms(errors[at_end])})


if __name__ == "__main__":
    flight = flown()
    for seconds, n_records in ((1.5, 9), (60.0, 1)):
        print(f"{n_records} of {seconds:g} s\n{score(flight, seconds, n_records).round(3).to_string()}\n")
