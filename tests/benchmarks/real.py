"""Real flights of others: DLR's test aircraft ATTAS, its stall, and a UAV of 3.3 kg, which no default was chosen on.

    python tests/benchmarks/real.py FOLDER --out OUT [--flights F] [--methods M] [--seeds S] [--redo]

FOLDER is an unpacked copy of the public repository github.com/josemiguelbento/UAV-OAT-controlo. Nothing of it stands
here: it states no licence. The manoeuvres of ATTAS in it are the flight data of Jategaonkar, Flight Vehicle System
Identification, 2nd edition (AIAA 2015), which the publisher gives away (arc.aiaa.org/doi/suppl/10.2514/4.102790). Mass,
geometry, positions of sensors and engines of ATTAS are those of the book's ``umr_reg_attas.m``; those of the UAV are
the repository's ``get_coefs_real.m``.

Each method learns the measured coefficients of some manoeuvres and predicts those of their repetitions, from the same
regressors, as in comparison.py. Each run is kept as OUT/real/FLIGHT-METHOD-SEED.json, and not run again unless
``--redo`` says so.
"""

import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
from _common import finish, parser_of
from _comparison_methods import METHODS, Identification, regressors
from comparison import OWN, SAMPLES, Kept, Task, run, scores, toy
from scipy.io import loadmat

from skdgp.dynamics import Aircraft, aerodynamic_coefficients

BOOK, UAV = Path("RVJategaonkar_codes_2ed/flt_data"), Path("get_coeffs/flight_data_1")
ACCELEROMETER, ENGINE, BOOM = (-1.010, 0.886, 0.103), (-1.343, 2.990, -0.652), (13.080, -0.010, -0.027)
"""Of ATTAS, from its centre of gravity [m]; the engine is the right one."""
ATTAS = Aircraft(
    name="ATTAS",
    mass=17631.0,
    inertia=[[133367.0, 0.0, -11442.0], [0.0, 252687.0, 0.0], [-11442.0, 0.0, 359593.0]],
    wing_area=64.0,
    span=21.5,
    chord=3.159,
)
SMALL_UAV = Aircraft(
    name="UAV",
    mass=3.3,
    inertia=[[0.170, 0.0, -0.019], [0.0, 0.289, 0.0], [-0.019, 0.0, 0.443]],
    wing_area=0.384,
    span=1.6,
    chord=0.24,
)
EDGE = 30
"""Samples at either end of the manoeuvres of ATTAS that its filters made to ring."""
TRAVEL = np.radians(25.0) / 2250.0
"""Angle of the UAV's surfaces by its commands, about; another scale changes no error."""


STRUCTURE = "dependentgpregressor__structure"
PIPELINES = {
    "pipeline": ("**skdgp pipeline**", {}, {}),
    "trend": ('the same, structure="trend"', {}, {STRUCTURE: "trend"}),
    "joint": ('the same, structure="joint"', {}, {STRUCTURE: "joint"}),
    "additive": ('the same, structure="additive"', {}, {STRUCTURE: "additive"}),
    "classical": ('the same, regressors="classical"', {"regressors": "classical"}, {}),
    "no_reconstruction": ('the same, reconstruction="passthrough"', {"reconstruction": "passthrough"}, {}),
}
PEERS = ("ols_all", "stepwise2_all", "trees_trend", "gp_trend")


def attas(folder):
    """Return aircraft, training and test flights: manoeuvres of elevator, aileron, rudder, and their repetitions."""
    train = [_attas(folder, name) for name in ("fAttasElv1", "fAttasAil1", "fAttasRud1")]
    test = [_attas(folder, name) for name in ("fAttasElv2", "fAttasAilRud2")]
    return ATTAS, pd.concat(train, ignore_index=True), pd.concat(test, ignore_index=True), {}


def attas_stall(folder):
    """Return aircraft, training and test flight: a quasi-steady stall and its repetition."""
    return (ATTAS, *(_attas(folder, f"fAttas_qst0{k}", boom=False) for k in (1, 2)), {})


def small_uav(folder):
    """Return aircraft, training and test records: the first two of aileron, of elevator, and one of rudder to learn.

    The fourth of elevator is left out: the repository's notes call it badly flown; the airspeed falls to 3 m/s.
    """
    records = loadmat(
        Path(folder) / UAV / "ProcessedData_2022_05_07_11_13_57.mat", squeeze_me=True, struct_as_record=False
    )
    names = ["ail_1", "ail_2", "el_1", "el_2", "rud_1"], ["ail_3", "ail_4", "el_3"]
    parts = (pd.concat([_uav(records[name], name) for name in part], ignore_index=True) for part in names)
    return (SMALL_UAV, *parts, {"thrust": None})


def _attas(folder, name, boom=True):
    """Return the table of one manoeuvre, with accelerations and air data brought to the centre of gravity."""
    path = Path(folder) / BOOK / name
    mat = path.with_suffix(".mat")
    log = loadmat(mat)[name] if mat.exists() else np.loadtxt(path.with_suffix(".asc"))
    log = np.column_stack([np.full(len(log), np.nan), log])  # channels from 1 on, as the book numbers them
    degrees = np.radians(log)
    rates, vanes, airspeed = degrees[:, 7:10], degrees[:, 13:15], log[:, 15]
    if boom:
        alpha, beta = vanes.T
        flow = [np.cos(beta) * np.cos(alpha), np.sin(beta), np.cos(beta) * np.sin(alpha)]
        u, v, w = airspeed * np.stack(flow) - np.cross(rates, BOOM).T
        airspeed = np.sqrt(u**2 + v**2 + w**2)
        vanes = np.column_stack([np.arctan2(w, u), np.arcsin(v / airspeed)])
    accelerations, force = degrees[:, 17:20], log[:, 2:5]
    if boom:  # the stalls hold them at the centre of gravity, as their header says
        force = force - np.cross(accelerations, ACCELEROMETER) - np.cross(rates, np.cross(rates, ACCELEROMETER))
    left, right = log[:, 37], log[:, 38]
    columns = {
        "time": np.arange(len(log)) * 0.04,
        "airspeed": airspeed,
        "alpha": vanes[:, 0],
        "beta": vanes[:, 1],
        **dict(zip(("ax", "ay", "az"), force.T, strict=True)),
        **dict(zip("pqr", rates.T, strict=True)),
        **dict(zip(("p_dot", "q_dot", "r_dot"), accelerations.T, strict=True)),
        **dict(zip(("phi", "theta", "psi"), degrees[:, 10:13].T, strict=True)),
        "altitude": (0.3048 if boom else 1.0) * log[:, 16],  # the stalls hold metres
        "density": log[:, 34],
        "elevator": degrees[:, 22],
        "aileron": 0.5 * (degrees[:, 29] - degrees[:, 28]),
        "rudder": degrees[:, 30],
        "thrust_x": left + right,
        "thrust_m": ENGINE[2] * (left + right),
        "thrust_n": ENGINE[1] * (left - right),
    }
    part = np.cumsum(np.diff(log[:, 1], prepend=log[0, 1]) > 1.0)  # one file holds two manoeuvres
    table = pd.DataFrame(columns).assign(flight=[f"{name} {k + 1}" for k in part])
    from_end = [table.groupby("flight").cumcount(ascending=ascending) for ascending in (True, False)]
    return table[np.minimum(*from_end) >= EDGE].reset_index(drop=True)


def _uav(record, name):
    """Return the table of one manoeuvre of the UAV."""
    angles = np.radians([record.roll, record.pitch, record.yaw])
    columns = {
        "time": np.arange(len(record.time)) * 0.02,
        "airspeed": record.Va,
        "alpha": np.radians(record.AoA),
        "beta": np.radians(record.beta),
        **{channel: getattr(record, channel) for channel in ("ax", "ay", "az", "p", "q", "r")},
        **dict(zip(("phi", "theta", "psi"), angles, strict=True)),
        "altitude": record.h,
        "v_north": record.VN,
        "v_east": record.VE,
        "v_down": record.VD,
        "density": 1.2682,
        "elevator": TRAVEL * record.delta_e,
        "aileron": TRAVEL * record.delta_a,
        "rudder": TRAVEL * record.delta_r,
        "throttle": record.delta_t / 100.0,
    }
    return pd.DataFrame(columns).assign(flight=name)


FLIGHTS = {
    "attas": ("ATTAS, manoeuvres", attas),
    "attas_stall": ("ATTAS, stall", attas_stall),
    "small_uav": ("UAV of 3.3 kg", small_uav),
}


def task_of(name, folder):
    """Return the task of these flights; measured coefficients are scored, as there is no truth."""
    aircraft, train, test, loads = FLIGHTS[name][1](folder)
    targets, measured = (aerodynamic_coefficients(table, aircraft, **loads) for table in (train, test))
    return Task(aircraft, train, test, targets, measured.to_numpy(), None, SAMPLES)


def result(task, method, seed, **parameters):
    """Return the scores of one method."""
    if method not in PIPELINES:
        return run(task, *regressors(OWN, task), method)
    _, arguments, chosen = PIPELINES[method]
    seeded = {"dependentgpregressor__random_state": seed, **chosen, **parameters}
    start = time.process_time()
    model = Identification(arguments, seeded).fit_flight(task)
    seconds = time.process_time() - start
    shares = {name: float(np.mean(weights)) for name, weights in model.pipeline[-1].weights_.items()}
    kept = {"weights": shares, "cpu_seconds": seconds, "date": time.strftime("%Y-%m-%d")}
    return {**kept, **scores(task, model, model.transform(task.test))}


def table(runs):
    """Return a row for each flight and method: medians over the seeds."""
    rows = []
    for flight in ("toy", *FLIGHTS):
        for method in (*PEERS, *PIPELINES):
            some = [run for run in runs if (run["flight"], run["method"]) == (flight, method)]
            if some:
                each = np.array([run["NRMSE"] for run in some])
                held = [np.mean(run["band_holds"]["measured"]) for run in some if run["band_holds"]]
                rows.append(
                    {
                        "flight": FLIGHTS.get(flight, (flight,))[0],
                        "method": PIPELINES[method][0] if method in PIPELINES else METHODS[method].name,
                        "NRMSE": float(np.median(each.mean(axis=1))),
                        "by seed": " to ".join(f"{f(each.mean(axis=1)):.3f}" for f in (np.min, np.max)),
                        **dict(zip(some[0]["outputs"], np.median(each, axis=0).tolist(), strict=True)),
                        "band of measured holds %": 100 * float(np.mean(held)) if held else None,
                        "CPU s": float(np.median([run["cpu_seconds"] for run in some])),
                    }
                )
    return rows


def main(words=None):
    parser = parser_of(__doc__, redo=True)
    parser.add_argument("folder", type=Path, nargs="?", help="the unpacked copy of the repository")
    parser.add_argument("--flights", nargs="+", choices=FLIGHTS, default=list(FLIGHTS))
    parser.add_argument("--methods", nargs="+", choices=[*PEERS, *PIPELINES], default=[*PEERS, *PIPELINES])
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2], help="of our methods; the others take none")
    options = parser.parse_args(words)
    if options.folder is None and not options.smoke:
        parser.error("the copy of the repository is needed")
    methods = ["ols_all", "pipeline"] if options.smoke else options.methods
    parameters = {"dependentgpregressor__max_iter": 2} if options.smoke else {}
    kept = Kept(options.out, "real")
    for flight in ["toy"] if options.smoke else options.flights:
        task = toy() if options.smoke else task_of(flight, options.folder)
        for method in methods:
            for seed in options.seeds if method in PIPELINES and not options.smoke else [0]:
                name = f"{flight}-{method}-{seed}"
                if options.redo or name not in kept:
                    found = result(task, method, seed, **parameters)
                    kept.keep(name, {"flight": flight, "method": method, "seed": seed, **found})
                    print(f"{name}: NRMSE {np.mean(found['NRMSE']):.3f}", file=sys.stderr, flush=True)
    finish(options, "real", other_aircraft=table(list(kept.memory.values())))


if __name__ == "__main__":
    main()
