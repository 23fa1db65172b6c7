"""Errors that recorders and installations leave in logs of flights."""

import numpy as np
from flight_columns import EULER, FORCES, POSITION, RATES
from scipy import signal

from skdgp.dynamics import euler_to_matrix

GRAVITY = 9.80665


def scale(factors):
    """Return a function that multiplies channels of a table by factors, by name or names."""
    by_name = {name: factor for names, factor in factors.items() for name in names.split()}
    return lambda table: table.assign(**{name: by_name[name] * table[name] for name in by_name})


def without(*names):
    return lambda table: table.drop(columns=[*names])


def exchange(first, second):
    return lambda table: table.rename(columns={first: second, second: first})


def elsewhere(table, place, spin=None):
    """Return a table whose accelerometers are at a place (3,) from the centre of gravity [m].

    ``spin`` (n, 3) is the angular acceleration, by default the slope of the rates.
    """
    rates = table[RATES].to_numpy()
    if spin is None:
        step = np.median(np.diff(table["time"]))
        spin = signal.savgol_filter(rates, 15, 2, 1, step, axis=0)
    moved = table.copy()
    moved[FORCES] += np.cross(spin, place) + np.cross(rates, np.cross(rates, place))
    return moved


def with_channels(table, names, values):
    """Return a table with other values (n, k) of channels."""
    return table.assign(**dict(zip(names, np.asarray(values).T, strict=True)))


def placed(table, place):
    """Return a table that states where its inertial sensors are."""
    return with_channels(table, POSITION, place)


def late(table, seconds, names):
    """Return a table with late channels."""
    time = table["time"]
    delayed = table.copy()
    for name in names:
        values = np.unwrap(table[name]) if name in EULER else table[name]
        delayed[name] = np.interp(time - seconds, time, values)
    return delayed


def held(table, names, every):
    """Return a table in which channels are sampled at one row of so many, and repeated."""
    rows = np.arange(len(table)) // every * every
    return table.assign(**table[names].iloc[rows].set_index(table.index))


def shake(time, phase=0.0):
    """Return an oscillation of 8 to 14 Hz, whose frequency changes."""
    turns = np.cumsum(11 + 3 * np.sin(0.2 * time)) * np.median(np.diff(time))
    return np.sin(2 * np.pi * turns + phase)


def without_gravity(table):
    down = euler_to_matrix(table["phi"], table["theta"], table["psi"])[:, 2]
    changed = table.copy()
    changed[FORCES] += GRAVITY * down
    return changed
