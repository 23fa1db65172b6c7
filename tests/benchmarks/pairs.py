"""Pairs of flights of seven aircraft: the average of posteriors beside its members and least squares.

    python tests/benchmarks/pairs.py REPOSITORY ../shared/data --out OUT

REPOSITORY is an unpacked copy of github.com/josemiguelbento/UAV-OAT-controlo, see _real_flights.py;
the HFB-320 is ``hfb320_1_10.asc``. Each pipeline learns the measured coefficients of some flights
and predicts those of others: NRMSE, mean over the coefficients, over that of least squares from the
same regressors. Members are those of the same fit, each alone. Coverage is of measured
coefficients at one row in ten.
"""

from functools import partial
from pathlib import Path

import _real_flights as real
import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of, winners
from comparison import BANDS_EVERY, SAMPLES, Task, ampyx_ap2, task_of
from scipy.io import loadmat
from sklearn.linear_model import LinearRegression

from skdgp import make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.identification import flight_regressors
from skdgp.io import read_flight
from skdgp.metrics import interval_coverage, normalized_rmse

# The book's Izz of 35959 kg m^2 is that of no body; it hardly enters the longitudinal coefficients
HFB_320 = Aircraft(
    name="HFB-320",
    mass=7472.0,
    inertia=[[13336.0, 0.0, -1144.2], [0.0, 91420.0, 0.0], [-1144.2, 0.0, 1e5]],
    wing_area=30.097216,
    span=14.49,
    chord=2.43,
)
# Of the engines of the HFB-320 [rad], and their place from its centre of gravity [m]
TILT = 0.0524
HFB_ENGINE = (-1.343, 2.990, -0.652)
# Numbers of the channels in its log
HFB_CHANNELS = {"time": 0, "airspeed": 4, "alpha": 5, "beta": 16, "ax": 9, "ay": 11, "az": 10}
HFB_CHANNELS |= {"p": 12, "q": 7, "r": 13, "phi": 17, "theta": 6}
HFB_CHANNELS |= {"elevator": 1, "aileron": 18, "rudder": 19}
RECORDS = {
    "a": ("ail_1 ail_2 ail_3 el_1 el_2 el_3 rud_1", "ail_4 el_4"),
    "b": ("ail_3 ail_4 el_3 el_4 rud_1", "ail_1 ail_2 el_1 el_2"),
}


def hfb_320(folder):
    """Return aircraft, the first three quarters and the last one of a flight in turbulence, longitudinal."""
    log = np.loadtxt(Path(folder) / real.BOOK / "hfb320_1_10.asc").T
    table = pd.DataFrame({name: log[k] for name, k in HFB_CHANNELS.items()})
    thrust = log[3]
    dynamic_pressure = log[2]
    table["density"] = 2 * dynamic_pressure / table["airspeed"] ** 2
    table["thrust_x"] = thrust * np.cos(TILT)
    table["thrust_z"] = -thrust * np.sin(TILT)
    table["thrust_m"] = HFB_ENGINE[2] * table["thrust_x"] - HFB_ENGINE[0] * table["thrust_z"]
    n = 3 * len(table) // 4
    return HFB_320, table[:n].reset_index(drop=True), table[n:].reset_index(drop=True), {}


def small_uav(folder, split):
    """Return aircraft, training and test records of the UAV."""
    path = Path(folder) / real.UAV / "ProcessedData_2022_05_07_11_13_57.mat"
    records = loadmat(path, squeeze_me=True, struct_as_record=False)
    parts = []
    for names in RECORDS[split]:
        tables = [real.uav(records[name], name) for name in names.split()]
        parts.append(pd.concat(tables, ignore_index=True))
    return real.SMALL_UAV, *parts, {"thrust": None}


def swapped(load, folder):
    aircraft, train, test, loads = load(folder)
    return aircraft, test, train, loads


def quarter(data, number):
    """Return the AP2, three quarters of its flight, and the other one."""
    aircraft, *_, loads = ampyx_ap2(data)
    table = read_flight(data / "ampyx_ap2" / "ampyx_ap2.parquet")
    part = np.arange(len(table)) * 4 // len(table) + 1
    table["flight"] = [f"quarter {k}" for k in part]
    return (
        aircraft,
        *(table[rows].reset_index(drop=True) for rows in (part != number, part == number)),
        loads,
    )


HFB = "HFB-320, last quarter, longitudinal"
REAL = {
    "ATTAS, three manoeuvres to their repetitions": real.attas,
    "the other way round": partial(swapped, real.attas),
    "its stall, first to second": real.attas_stall,
    "second to first": partial(swapped, real.attas_stall),
    "UAV of 3.3 kg, one split": partial(small_uav, split="a"),
    "another split": partial(small_uav, split="b"),
    HFB: hfb_320,
}
QUARTERS = {"Ampyx AP2, first quarter left out": 1, "third": 3, "fourth": 4}
SHARED = {"viggen to test_twoalt": "viggen", "c172p to test_calm": "c172p"}
PAIRS = [*REAL, *QUARTERS, *SHARED]
LONGITUDINAL = ["CX", "CZ", "Cm"]
KINDS = {
    "average": "average",
    "joint": "all terms",
    "trend": "trend",
}


def task_of_pair(name, repository, data):
    """Return the task of a pair; measured coefficients are scored."""
    if name in SHARED:
        return task_of(SHARED[name], data)
    aircraft, train, test, loads = (
        REAL[name](repository) if name in REAL else quarter(data, QUARTERS[name])
    )
    targets, measured = (
        aerodynamic_coefficients(table, aircraft, **loads) for table in (train, test)
    )
    if name == HFB:
        targets = targets[LONGITUDINAL]
        measured = measured[LONGITUDINAL]
    return Task(aircraft, train, test, targets, measured.to_numpy(), None, SAMPLES)


def result(task, seed):
    """Return what the average and each member are worth."""
    pipeline = make_identification_pipeline(task.aircraft)
    pipeline[-1].set_params(n_latent=2, random_state=seed)
    pipeline.fit(task.train, task.targets)
    last = pipeline[-1]
    X, ratio = flight_regressors(pipeline, task.test)
    mean, std = last.predict(X, return_std=True, include_noise=True, include_input_noise=ratio)
    known = pipeline[:-1].transform(task.train)
    trusted = task.targets.notna().all(axis=1).to_numpy()
    least_squares = LinearRegression().fit(np.asarray(known)[trusted], task.targets[trusted])
    some = slice(None, None, BANDS_EVERY)
    found = {
        "least squares": float(normalized_rmse(task.measured, least_squares.predict(X))),
        "average": float(normalized_rmse(task.measured, mean)),
        "coverage": float(interval_coverage(task.measured[some], mean[some], std[some])),
    }
    for name, member in zip(last.weights_, last.posterior_.members, strict=False):
        alone = member.predict(X) * last.scale_ + last.center_
        found[name] = float(normalized_rmse(task.measured, alone))
    return found


def of_pairs(runs):
    """Return a row for each pair: medians over seeds, ratios to least squares; then geometric means."""
    table = runs.groupby("pair", sort=False).median(numeric_only=True)
    ratios = table[[*KINDS]].div(table["least squares"], axis=0).rename(columns=KINDS)
    means = f"geometric mean of the {len(table)}"
    ratios.loc[means] = np.exp(np.log(ratios).mean(skipna=False))
    table.loc[means, "least squares"] = 1.0
    return [
        {"pair": pair, "least squares": table.loc[pair, "least squares"]}
        | winners(row, missing="-")
        | {"in the band, %": 100 * table.loc[pair, "coverage"]}
        for pair, row in ratios.iterrows()
    ]


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("repository", type=Path, help="the unpacked copy of the repository")
    parser.add_argument("data", type=Path, help="folder of the shared data")
    options = parser.parse_args(words)
    kept = Kept(options, "pairs")
    for pair in PAIRS:
        task = task_of_pair(pair, options.repository, options.data)
        for seed in range(3):
            kept.run({"pair": pair, "seed": seed}, result, task, seed)
    finish(options, "pairs", of_pairs=of_pairs(kept.table))


if __name__ == "__main__":
    main()
