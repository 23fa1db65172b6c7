"""JSBSim as a referee of the equations of motion: from its loads, does this package find its motion?

    python tests/benchmarks/referee.py ../shared/data [--live] [--out FOLDER]

Logged flights: true coefficients, airspeed, thrust, mass and inertia give the loads, those the accelerations, which are
compared with the true ones. The logs hold 18 significant bits; what this rounding may do is the floor printed beside:
each column is moved by half of its last bit, and the changes are added, as squares for the root mean square, as sizes
for the largest error.

--live flies JSBSim itself (``pip install jsbsim``) and compares in double precision: see _referee_live.py.
"""

import importlib
import importlib.util

import numpy as np
import pandas as pd
from _common import finish, parsed, parser_of

from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import (
    Aircraft,
    aerodynamic_loads,
    euler_to_quaternion,
    gravity_in_body_axes,
    propulsive_loads,
    rigid_body_derivative,
)
from skdgp.dynamics._equations.rigid_body import ATTITUDE, RATES, VELOCITY
from skdgp.io import read_flight

CHANNELS = ("ax", "ay", "az", "u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot")
THRUST = [f"thrust_{axis}" for axis in "xyzlmn"]
TRUTH = [*COEFFICIENTS, "airspeed", "u", "v", "w", "phi", "theta", "p", "q", "r", "p_dot", "q_dot", "r_dot", "ax", "ay"]
USED = ["density", *THRUST, "gravity_true", "az_true", *(f"{name}_true" for name in TRUTH)]


def computed(flight, aircraft):
    """Return the accelerations (n, 9) that follow from the true coefficients and the thrust."""
    force, moment = aerodynamic_loads(
        _true(flight, *COEFFICIENTS), *_true(flight, "airspeed").T, flight.density, aircraft
    )
    push, twist = propulsive_loads(flight, aircraft, "columns")
    state = np.zeros((len(flight), 13))
    state[:, VELOCITY], state[:, RATES] = _true(flight, "u", "v", "w"), _true(flight, "p", "q", "r")
    state[:, ATTITUDE] = euler_to_quaternion(*_true(flight, "phi", "theta").T, 0.0)
    gravity = flight["gravity_true"].to_numpy()
    derivative = rigid_body_derivative(state, force + push, moment + twist, aircraft, gravity)
    return np.hstack([(force + push) / aircraft.mass, derivative[:, VELOCITY], derivative[:, RATES]])


def recorded(flight):
    """Return the same accelerations as the flight holds them; u_dot = f + g - omega x v."""
    specific, rates = _true(flight, "ax", "ay", "az"), _true(flight, "p", "q", "r")
    gravity = gravity_in_body_axes(*_true(flight, "phi", "theta").T, flight["gravity_true"])
    velocity = specific + gravity - np.cross(rates, _true(flight, "u", "v", "w"))
    return np.hstack([specific, velocity, _true(flight, "p_dot", "q_dot", "r_dot")])


def rounding(flight, aircraft):
    """Return what the rounding of the columns may do to ``computed - recorded``: variance and bound, both (n, 9)."""
    bits = max(_significant_bits(flight[name].to_numpy()) for name in USED)
    error = computed(flight, aircraft) - recorded(flight)
    variance, bound = np.zeros_like(error), np.zeros_like(error)
    for name in USED:
        half = 0.5 * np.exp2(np.frexp(flight[name])[1] - bits)
        moved = flight.assign(**{name: flight[name] + half})
        change = computed(moved, aircraft) - recorded(moved) - error
        variance += change**2 / 3.0  # of what is uniform within half a bit either way
        bound += np.abs(change)
    return variance, bound


def logged(name, flight, aircraft):
    """Return a row for each channel: errors over the channel's standard deviation."""
    flight = flight[USED].astype(float)
    truth = recorded(flight)
    error = np.abs(computed(flight, aircraft) - truth)
    variance, bound = rounding(flight, aircraft)
    std = truth.std(axis=0)
    columns = {
        "std": std,
        "rms error": np.sqrt(np.mean(error**2, axis=0)) / std,
        "rms of rounding": np.sqrt(variance.mean(axis=0)) / std,
        "largest error": error.max(axis=0) / std,
        "bound of rounding": bound.max(axis=0) / std,
        "beyond the bound %": 100.0 * np.mean(error > 1.001 * bound, axis=0),
    }
    return [
        {"flight": name, "channel": channel, **{key: float(values[k]) for key, values in columns.items()}}
        for k, channel in enumerate(CHANNELS)
    ]


def summary(rows):
    """Return a row for each flight: its worst channel in each respect."""
    found = []
    for name in dict.fromkeys(row["flight"] for row in rows):
        own = [row for row in rows if row["flight"] == name]
        worst = max(own, key=lambda row: row["rms error"])
        largest = {key: max(row[key] for row in own) for key in list(own[0])[3:]}
        found.append({"flight": name, "worst channel": worst["channel"], **largest})
    return found


def toy(n=200, bits=18):
    """Return a flight whose accelerations are Newton's and Euler's, written out and rounded, and its aircraft."""
    rng = np.random.default_rng(0)
    aircraft = Aircraft(
        mass=11.0, inertia=[[1.1, -0.1, 0.2], [-0.1, 2.3, 0.1], [0.2, 0.1, 2.9]], wing_area=1.3, span=2.6, chord=0.5
    )
    flight = pd.DataFrame(rng.normal(size=(n, len(USED))), columns=USED)
    flight["density"], flight["airspeed_true"] = rng.uniform(1.0, 1.2, n), rng.uniform(20.0, 30.0, n)
    flight["gravity_true"] = rng.uniform(9.78, 9.83, n)
    qbar = 0.5 * flight["density"] * flight["airspeed_true"] ** 2 * aircraft.wing_area
    load = {axis: qbar * flight[f"C{axis.upper()}_true"] + flight[f"thrust_{axis}"] for axis in "xyz"}
    lengths = {"l": aircraft.span, "m": aircraft.chord, "n": aircraft.span}
    moment = np.stack([qbar * b * flight[f"C{k}_true"] + flight[f"thrust_{k}"] for k, b in lengths.items()], axis=-1)
    for axis in "xyz":
        flight[f"a{axis}_true"] = load[axis] / aircraft.mass
    rates = _true(flight, "p", "q", "r")
    euler = np.linalg.solve(aircraft.inertia, (moment - np.cross(rates, rates @ aircraft.inertia))[..., None])
    flight[["p_dot_true", "q_dot_true", "r_dot_true"]] = euler[..., 0]
    scale = np.exp2(bits - np.frexp(flight)[1])
    return np.round(flight * scale) / scale, aircraft


def flights(folder):
    """Yield the name, table and aircraft of every flight of the folder."""
    aircraft = {path.stem: Aircraft.from_json(path) for path in sorted(folder.glob("*.json"))}
    for path in sorted(folder.glob("*.parquet")):
        yield path.stem, read_flight(path), next(aircraft[name] for name in aircraft if path.stem.startswith(name))


def _true(flight, *names):
    return np.stack([flight[f"{name}_true"].to_numpy(float) for name in names], axis=-1)


def _significant_bits(values):
    """Return how many bits the mantissas of the values use."""
    mantissa = np.abs(np.frexp(values[values != 0.0])[0] * 2.0**24).astype(np.int64)
    return 24 - min((int(each & -each).bit_length() - 1 for each in mantissa[mantissa > 0]), default=24)


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--live", action="store_true", help="fly JSBSim too")
    options = parsed(parser, words)
    if options.live and importlib.util.find_spec("jsbsim") is None:
        parser.error("--live needs JSBSim, which is not installed: pip install jsbsim")
    rows = [row for case in flights(options.data / "flights") for row in logged(*case)]
    found = importlib.import_module("_referee_live").live() if options.live else {}
    finish(options, "referee", flights=summary(rows), channels=rows, **found)


if __name__ == "__main__":
    main()
