"""Whether path reconstruction or smoothing is better on flights with damaged sensors, and which one the check chooses.

    python tests/benchmarks/paths.py [../shared/data] [--out FOLDER]

The error of airspeed, alpha, beta, p, q and r is the root mean square over the six of rms error / standard deviation
of the truth, which the check does not see. A table is of the first 100 s of each flight, the other of nine records of
5 to 10 s. ``error`` is that of reconstruction (after its lags are removed) over that of smoothing, for each flight;
``used`` whether it was chosen, and ``loss`` the largest error of the choice over that of the better of the two.
"""

import warnings

import numpy as np
import pandas as pd
from _common import finish, parser_of
from scipy.ndimage import gaussian_filter1d
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from skdgp._flight.frames import air_data
from skdgp.datasets import load_example_flights
from skdgp.preprocessing import FlightPathReconstruction, FlightSmoother

INPUTS = ["airspeed", "alpha", "beta", "p", "q", "r"]
AIR, RATE, FORCE = INPUTS[:3], INPUTS[3:], ["ax", "ay", "az"]
ATTITUDE, VELOCITY = ["phi", "theta", "psi"], ["v_north", "v_east", "v_down"]
SHARED = ("viggen_uav_train_latlon", "viggen_uav_train_lateral", "c172p_train_latlon")


def each_flight(change):
    """Apply a change of channels (n, k), with the sampling interval, to columns of every flight."""

    def damage(table, names, *arguments):
        parts = []
        for _, part in table.groupby("flight", sort=False):
            step = float(np.median(np.diff(part["time"])))
            values = np.unwrap(part[names], axis=0) if names == ATTITUDE else part[names].to_numpy()
            parts.append(part.assign(**dict(zip(names, change(values, step, *arguments).T, strict=True))))
        return pd.concat(parts, ignore_index=True)

    return damage


@each_flight
def late(values, step, seconds):
    clock = step * np.arange(len(values))
    return np.column_stack([np.interp(clock - seconds, clock, column) for column in values.T])


@each_flight
def wandering(values, step, std, seconds):
    memory = np.exp(-step / seconds)
    white = np.random.default_rng(0).standard_normal(values.shape)
    white[0] /= np.sqrt(1 - memory**2)
    return values + lfilter([std * np.sqrt(1 - memory**2)], [1, -memory], white, axis=0)


@each_flight
def drifting(values, step, std, seconds):
    width = seconds / step / 2
    margin = int(3 * width)
    white = np.random.default_rng(0).standard_normal((len(values) + 2 * margin, values.shape[1]))
    smooth = gaussian_filter1d(white, width, axis=0)[margin : margin + len(values)]
    return values + std * smooth * np.sqrt(2 * width * np.sqrt(np.pi))


@each_flight
def slow(values, step, seconds):
    memory = np.exp(-step / seconds)
    return lfilter([1 - memory], [1, -memory], values - values[0], axis=0) + values[0]


@each_flight
def held(values, step, seconds):
    row = np.arange(len(values))
    return values[row - row % round(seconds / step)]


def tilted(table):
    turned = Rotation.from_euler("Y", 10, degrees=True).apply(table[FORCE].to_numpy(copy=True))
    return table.assign(**dict(zip(FORCE, turned.T, strict=True)))


def derived(table):
    """Air data computed from velocity and attitude, as if there were no wind."""
    turned = Rotation.from_euler("ZYX", table[ATTITUDE[::-1]].to_numpy(copy=True)).inv()
    return table.assign(**dict(zip(AIR, air_data(turned.apply(table[VELOCITY].to_numpy(copy=True))), strict=True)))


def exact(table, names):
    return table.assign(**{name: table[f"{name}_true"] for name in names})


DAMAGES = {
    "none": lambda t: t,
    "attitude .1 s late": lambda t: late(t, ATTITUDE, 0.1),
    "attitude .2 s late": lambda t: late(t, ATTITUDE, 0.2),
    "attitude .4 s late": lambda t: late(t, ATTITUDE, 0.4),
    "attitude wanders 3 deg in 5 s": lambda t: wandering(t, ATTITUDE, np.deg2rad(3), 5.0),
    "attitude wanders 1 deg in 5 s": lambda t: wandering(t, ATTITUDE, np.deg2rad(1), 5.0),
    "attitude drifts 3 deg in 5 s": lambda t: drifting(t, ATTITUDE, np.deg2rad(3), 5.0),
    "attitude drifts 3 deg in 30 s": lambda t: drifting(t, ATTITUDE, np.deg2rad(3), 30.0),
    "vanes .1 s late": lambda t: late(t, AIR[1:], 0.1),
    "vanes .2 s late": lambda t: late(t, AIR[1:], 0.2),
    "alpha x 1.3 + 2 deg": lambda t: t.assign(alpha=1.3 * t["alpha"] + 0.035),
    "airspeed x 1.1": lambda t: t.assign(airspeed=1.1 * t["airspeed"]),
    "airspeed x 1.1, lag .5 s": lambda t: slow(t.assign(airspeed=1.1 * t["airspeed"]), ["airspeed"], 0.5),
    "air data without noise": lambda t: exact(t, AIR),
    "all without noise": lambda t: exact(t, [*INPUTS, *FORCE, *ATTITUDE, *VELOCITY]),
    "air data from velocity": derived,
    "accelerometer tilted 10 deg": tilted,
    "gyros .1 s late": lambda t: late(t, RATE, 0.1),
    "gyro q reversed": lambda t: t.assign(q=-t["q"]),
    "velocity held for 1 s": lambda t: held(t, VELOCITY, 1.0),
    "velocity held for .2 s": lambda t: held(t, VELOCITY, 0.2),
    "velocity .3 s late": lambda t: late(t, VELOCITY, 0.3),
    "velocity wanders 2 m/s in 5 s": lambda t: wandering(t, VELOCITY, 2.0, 5.0),
}


def records(table):
    """Return nine records of 5 to 10 s, as flights."""
    rng, start, parts = np.random.default_rng(0), table["time"].min() + 2, []
    for number in range(9):
        length = rng.uniform(5, 10)
        inside = (table["time"] >= start) & (table["time"] < start + length)
        parts.append(table[inside].assign(flight=number))
        start += length + 3
    return pd.concat(parts, ignore_index=True)


def error(table):
    """Return a function from an estimate of the table's channels to its error."""
    truth = table[[f"{name}_true" for name in INPUTS]].to_numpy()
    return lambda out: np.sqrt(np.mean((out[INPUTS].to_numpy() - truth) ** 2 / truth.var(axis=0)))


def judged(damage, tables):
    """Return a row of the table: errors, choices and the largest loss over the flights."""
    ratios, used, losses = {}, {}, []
    for name, table in tables.items():
        table = damage(table).reset_index(drop=True)
        score, smoother = error(table), FlightSmoother(derivatives=[])
        check = FlightPathReconstruction(inconsistent="pass").fit(table)
        used[name], check.used_ = check.used_, True
        ratios[name] = score(smoother.fit_transform(check.transform(table))) / score(smoother.fit_transform(table))
        losses.append((ratios[name] if used[name] else 1.0) / min(ratios[name], 1.0))
    errors = " ".join(f"{ratio:.2f}" if ratio < 10 else "> 10" for ratio in ratios.values())
    return {"error": errors, "used": f"{sum(used.values())} of {len(used)}", "loss": max(losses)}


def main(arguments=None):
    parser = parser_of(__doc__, data=True)
    options = parser.parse_args(arguments)
    tables = {"example": load_example_flights().train.query("flight == flight.iloc[0]")}
    if options.data:
        tables |= {name: pd.read_parquet(f"{options.data}/flights/{name}.parquet") for name in SHARED}
    tables = {name: table.astype(dict.fromkeys(INPUTS + FORCE, float)) for name, table in tables.items()}
    tables = {name: table[table["time"] < table["time"].min() + 100.0] for name, table in tables.items()}
    cut = {name: records(table) for name, table in tables.items()}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # contradictions, and records too short to smooth
        long = [{"damage": name, **judged(DAMAGES[name], tables)} for name in DAMAGES]
        short = [{"damage": name, **judged(DAMAGES[name], cut)} for name in DAMAGES]
    finish(options, "paths", flights_of_100_s=long, nine_records=short)


if __name__ == "__main__":
    main()
