"""A real flight of others: short records of a Sport Cub under motion capture, rolled out from their first states.

    python tests/benchmarks/sportcub.py FOLDER [--out OUT] [--methods NAME ...] [--redo]

FOLDER is an unpacked copy of the public repository github.com/jgoppert/sysid_litreview_26. It
states no licence: fetch it yourself; nothing of it stands here. Mass, geometry and largest
deflections are read from its ``greybox.py``.

Nine records are learned from, five are predicted: 100 Hz, each cropped to the shortest (1.5 s) as
its own loader does. The files call their axes NED/FRD, but the data are NWU/FLU; signs of elevator
and aileron are opposite to ours. The thrust is unknown, so the coefficients contain it, and the
throttle is a regressor.

Each record is flown from its first state with its commands. The score is the repository's: root
mean square errors of 13 states (position, velocity in body axes, quaternion, rates) over all
records and times, each over the range of the truth, averaged.

Choices are made on the nine records alone: each is left out in turn ("left out"), and predicted by
a model of the rest. Runs are kept as OUT/sportcub/METHOD.json, and not run again unless ``--redo``
says so.
"""

import ast
import sys
import time
import warnings
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
from _common import finish, parser_of
from comparison import Kept
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.frames import body_to_ned, ned_to_body
from skdgp.dynamics import (
    Air,
    Aircraft,
    SimulationWarning,
    aerodynamic_coefficients,
    euler_to_quaternion,
    quaternion_to_euler,
    simulate,
    trajectory_bands,
)
from skdgp.metrics import normalized_rmse

SURFACES = ["elevator", "aileron", "rudder"]
REGRESSORS = ["alpha", "beta", "p_hat", "q_hat", "r_hat", *SURFACES, "throttle"]
GROUPS = {
    "position": ["north", "east", "down"],
    "velocity": ["u", "v", "w"],
    "attitude": ["phi", "theta", "psi"],
    "rates": ["p", "q", "r"],
}
STATES = [name for group in GROUPS.values() for name in group]
QUATERNION = ["q_w", "q_x", "q_y", "q_z"]
STEP, DENSITY = 0.01, 1.225


class Method(NamedTuple):
    """A row of the tables: its name, the regressor of the pipeline (None: the default), and what is measured of it."""

    name: str
    regressor: object = None
    bands: bool = False


TREND = DependentGPRegressor(structure="trend", random_state=0)
METHODS = {
    "hold": Method("straight on: first velocity, attitude, rates"),
    "least_squares": Method("least squares", LinearRegression()),
    "trend": Method('skdgp, structure="trend"', TREND, bands=True),
    "pipeline": Method("**skdgp pipeline**", bands=True),
}


class Records(NamedTuple):
    """Records as flight tables: to learn from or to score, and the rows from which they are flown."""

    tables: list
    starts: list
    coefficients: list

    def some(self, which):
        return Records(*([part[k] for k in which] for part in self))


class Task(NamedTuple):
    """The aircraft, records to learn from and to predict."""

    aircraft: Aircraft
    train: Records
    test: Records


# -- the repository's data
# ------------------------------------------------------------------------------------------


def constants(folder, name):
    """Return the dict of constants in ``greybox.py``, wherever the repository keeps it, that has this key."""
    for path in folder.rglob("greybox.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Dict) and name in [
                getattr(key, "value", None) for key in node.keys
            ]:
                return ast.literal_eval(node)
    raise ValueError(
        f"{folder} holds no greybox.py with a table of {name!r}; is this sysid_litreview_26?"
    )


def aircraft_of(folder):
    found = constants(folder, "Ixx")
    inertia = np.diag([found["Ixx"], found["Iyy"], found["Izz"]])
    inertia[0, 2] = inertia[2, 0] = -found["Ixz"]
    return Aircraft(
        mass=found["m"], inertia=inertia, wing_area=found["S"], span=found["b"], chord=found["cbar"]
    )


def read(folder, split):
    """Yield name, time, states and commands of each record, in the axes and signs of this package."""
    file = next((folder / "data").glob(f"sportcub_mocap_*_{split}.npz"))
    largest = np.deg2rad([constants(folder, "elevator")[name] for name in SURFACES]) * [-1, -1, 1]
    with np.load(file) as data:
        n = data["valid_mask"].sum(axis=1).min()
        for k, name in enumerate(data["segment_names"]):
            states, commands = data["x_meas"][k, :n].copy(), data["u_cmd"][k, :n]
            for vector in (slice(0, 3), slice(3, 6), slice(7, 10), slice(10, 13)):
                states[:, vector] *= [1, -1, -1]
            controls = dict(zip(SURFACES, (commands[:, 1:] * largest).T, strict=True))
            yield str(name), data["time_s"][k, :n], states, {"throttle": commands[:, 0], **controls}


def table_of(name, time, states, controls):
    """Return the flight table of a record as the file has it; accelerations by central differences."""
    position, velocity, quaternion, rates = np.split(states, [3, 6, 10], axis=1)
    euler = quaternion_to_euler(quaternion)
    airspeed = np.linalg.norm(velocity, axis=1)
    table = pd.DataFrame({"time": time, "flight": name, "airspeed": airspeed})
    table["alpha"] = np.arctan2(velocity[:, 2], velocity[:, 0])
    table["beta"] = np.arcsin(velocity[:, 1] / airspeed)
    euler[:, 2] = np.unwrap(euler[:, 2])
    table[STATES + QUATERNION] = np.hstack([position, velocity, euler, rates, quaternion])
    table[["v_north", "v_east", "v_down"]] = body_to_ned(quaternion, velocity)
    acceleration = np.gradient(velocity, time, axis=0, edge_order=2) + np.cross(rates, velocity)
    table[["ax", "ay", "az"]] = acceleration - ned_to_body(quaternion, [0.0, 0.0, STANDARD_GRAVITY])
    return table.assign(altitude=-table["down"], density=DENSITY, **controls)


def task_of(folder):
    """Return the task of the folder."""
    aircraft, parts = aircraft_of(folder), []
    for split in ("train", "validation"):
        tables = [table_of(*record) for record in read(folder, split)]
        coefficients = [aerodynamic_coefficients(table, aircraft, thrust=None) for table in tables]
        parts.append(Records(tables, [table.iloc[:1] for table in tables], coefficients))
    return Task(aircraft, *parts)


# -- predictions and scores
# -----------------------------------------------------------------------------------------


def learned(method, aircraft, records):
    """Return the fitted pipeline of a method, or its corrected coefficients; None: hold the first state."""
    if method == METHODS["hold"]:
        return None
    pipeline = make_identification_pipeline(
        aircraft, regressors=REGRESSORS, regressor=method.regressor
    )
    seeds = {name: 0 for name in pipeline.get_params() if name.endswith("random_state")}
    X, Y = (pd.concat(part, ignore_index=True) for part in (records.tables, records.coefficients))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        pipeline.set_params(**seeds).fit(X, Y)
        return pipeline


def flown(model, aircraft, records, drift=True, **options):
    """Return what the model makes of the records, from their first rows on, by start."""
    starts, air = pd.concat(records.starts, ignore_index=True), Air(drift=drift, density=DENSITY)
    controls = [
        table[["time", *SURFACES, "throttle"]].reset_index(drop=True) for table in records.tables
    ]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)
        found = simulate(
            model, aircraft, starts, controls, dt=STEP, thrust=None, air=air, **options
        )
    return found if "start" in found else found.assign(start=0)


def predicted(model, aircraft, records):
    """Return the 13 states of each record (n_records, n, 13)."""
    if model is None:
        return np.stack(
            [straight_on(*pair) for pair in zip(records.starts, records.tables, strict=True)]
        )
    return np.stack(
        [states(part) for _, part in flown(model, aircraft, records).groupby("start", sort=True)]
    )


def straight_on(start, table):
    """Return the states of a flight straight on: the first velocity, attitude and rates."""
    found = np.repeat(states(start), len(table), axis=0)
    elapsed = table["time"].to_numpy() - table["time"].iloc[0]
    found[:, :3] += elapsed[:, None] * start[["v_north", "v_east", "v_down"]].to_numpy()
    return found


def states(table):
    """Return the 13 states (n, 13); quaternions as the file has them, because their range depends on their sign."""
    known = set(QUATERNION) <= set(table)
    quaternion = (
        table[QUATERNION] if known else euler_to_quaternion(*table[GROUPS["attitude"]].to_numpy().T)
    )
    return np.hstack([table[STATES[:6]], quaternion, table[GROUPS["rates"]]])


def scores(prediction, truth):
    """Return the errors of the 13 states over their range, (13,); NaN where a record was not flown to its end."""
    truth = np.stack([states(table) for table in truth])
    sign = np.sign((prediction[..., 6:10] * truth[..., 6:10]).sum(axis=-1, keepdims=True))
    prediction[..., 6:10] *= np.where(sign == 0, 1, sign)
    return np.sqrt(((prediction - truth) ** 2).mean(axis=(0, 1))) / np.ptp(
        truth.reshape(-1, 13), axis=0
    )


def inside(model, aircraft, records, **options):
    """Return whether the truth lies within 95 % bands, a table (n_records * n, 12) less the first rows."""
    bands = trajectory_bands(flown(model, aircraft, records, **options), 0.95, STATES)
    rows = []
    for (_, band), table in zip(bands.groupby("start", sort=True), records.tables, strict=True):
        off = table[STATES].to_numpy() - band[STATES].to_numpy()
        turns = [STATES.index(name) for name in GROUPS["attitude"]]
        off[:, turns] = np.angle(np.exp(1j * off[:, turns]))
        low, high = (
            band[[f"{name}_{end}" for name in STATES]].to_numpy() for end in ("low", "high")
        )
        middle = band[STATES].to_numpy()
        rows.append(((low <= middle + off) & (middle + off <= high))[1:])
    return pd.DataFrame(np.concatenate(rows), columns=STATES)


def coverage(tables):
    held = pd.concat(tables)
    return {group: 100 * float(held[names].to_numpy().mean()) for group, names in GROUPS.items()}


def run(task, method, n_paths):
    """Return scores and coverage of one method: of the test records, and of training records left out in turn."""
    start = time.process_time()
    model = learned(method, task.aircraft, task.train)
    result = {"cpu_seconds": time.process_time() - start}
    result["test"] = scores(predicted(model, task.aircraft, task.test), task.test.tables).tolist()
    if model is not None:
        asked, mean = (
            np.vstack(task.test.coefficients),
            np.vstack([model.predict(t) for t in task.test.tables]),
        )
        result["coefficients"] = normalized_rmse(asked, mean, multioutput="raw_values").tolist()
    every = range(len(task.train.tables))
    models = {
        k: learned(method, task.aircraft, task.train.some([j for j in every if j != k]))
        for k in every
    }
    out = [predicted(models[k], task.aircraft, task.train.some([k])) for k in every]
    result["left_out"] = scores(np.concatenate(out), task.train.tables).tolist()
    if method.bands:
        for drift in (True, False):
            held = partial(inside, n_paths=n_paths, drift=drift)
            tables = [held(models[k], task.aircraft, task.train.some([k])) for k in every]
            test = held(model, task.aircraft, task.test)
            result[f"bands_{'with' if drift else 'without'}_drift"] = {
                "left out": coverage(tables),
                "test": coverage([test]),
            }
    if method.bands:
        shares = [
            getattr(each[-1], "weights_", {}).get("trend", 0.0)
            for each in (model, *models.values())
        ]
        result["trend"] = [float(np.mean(share)) for share in shares]
    return result


# -- tables
# ---------------------------------------------------------------------------------------------------------


def tables(runs):
    """Return the tables."""
    rows, bands, chosen = [], [], []
    for name, run in sorted(runs.items(), key=lambda item: list(METHODS).index(item[0])):
        first = {"method": METHODS[name].name}
        row = {
            f"NRMSE of states, {kind.replace('_', ' ')}": mean_of(run[kind])
            for kind in ("left_out", "test")
        }
        rows.append(first | row | {"NRMSE of coefficients, test": mean_of(run.get("coefficients"))})
        rows[-1]["CPU s"] = run["cpu_seconds"]
        for drift in ("with", "without"):
            for part, held in run.get(f"bands_{drift}_drift", {}).items():
                covered = {f"{group} %": share for group, share in held.items()}
                bands.append(first | {"records": part, "drift": drift, **covered})
        if "trend" in run:
            whole, *others = run["trend"]
            chosen.append(
                first
                | {"all records": whole, "one left out, least": min(others), "most": max(others)}
            )
    return {"states": rows, "bands": bands, "weight_of_the_trend": chosen}


def mean_of(errors):
    return None if errors is None else float(np.mean(errors))


def main(words=None):
    parser = parser_of(__doc__, redo=True)
    parser.add_argument(
        "folder", type=Path, nargs="?", help="unpacked copy of jgoppert/sysid_litreview_26"
    )
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=list(METHODS))
    parser.add_argument("--paths", type=int, default=100, help="functions drawn for bands")
    options = parser.parse_args(words)
    if options.folder is None:
        parser.error("the folder of the repository is needed")
    kept, task = Kept(options.out, "sportcub"), None
    for name in options.methods:
        if name not in kept or options.redo:
            task = task or task_of(options.folder)
            kept.keep(name, run(task, METHODS[name], options.paths))
            print(f"{name}: {mean_of(kept.memory[name]['test']):.4f}", file=sys.stderr, flush=True)
    finish(options, "sportcub", **tables(kept.memory))


if __name__ == "__main__":
    main()
