"""Errors that recorders and installations leave in logs of flights."""

import numpy as np
from scipy import signal

from skdgp.dynamics import euler_to_matrix

GRAVITY = 9.80665
FORCES = ["ax", "ay", "az"]
RATES = ["p", "q", "r"]
EULER = ["phi", "theta", "psi"]
VELOCITY = ["v_north", "v_east", "v_down"]


def ahead(table, arm):
    """Return a table whose accelerometers are ahead of the centre of gravity [m]."""
    p, q, r = rates = table[RATES].to_numpy().T
    step = np.median(np.diff(table["time"]))
    _, q_dot, r_dot = signal.savgol_filter(rates, 15, 2, 1, step, axis=1)
    moved = table.copy()
    moved[FORCES] += arm * np.stack([-(q**2) - r**2, p * q + r_dot, p * r - q_dot], axis=1)
    return moved


def late(table, seconds, names):
    """Return a table with late channels."""
    time = table["time"]
    delayed = table.copy()
    for name in names:
        values = np.unwrap(table[name]) if name in EULER else table[name]
        delayed[name] = np.interp(time - seconds, time, values)
    return delayed


def without_gravity(table):
    down = euler_to_matrix(table["phi"], table["theta"], table["psi"])[:, 2]
    changed = table.copy()
    changed[FORCES] += GRAVITY * down
    return changed
