"""Learned aircraft flown free from the state of another flight, replayed on it, and how long a minute of flight takes.

    python tests/benchmarks/freeflight.py ../shared/data [--models FOLDER] [--seeds 3] [--paths 100] [--out OUT]

Free flight: from 20 points of a flight, spread over it, at the true state, under the logged
controls and thrust and the true wind, by simulate: nothing of that flight enters after the start.
It is another flight than the one learned from, or its last 40 %, then not learned from. "default":
the pipeline of make_identification_pipeline; "least squares": that with LinearRegression at its
end; "truth replayed": the true coefficients, open loop in time, integrated from the same starts.
Errors are medians of the absolute errors over the starts and --seeds models, which differ in their
random numbers; bands are those of an ensemble of posterior functions, and their coverage counts
v_north ... r. With the mean wind, the velocity over the ground of the start is known, not its air
data, which hold the gust.

Replay: coefficients of the first model at the measured regressors, integrated from the measured
state every 2 s and 10 s.

--models keeps fitted pipelines there and takes those that are there.
"""

import time
import warnings
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from _common import finish, parsed, parser_of
from sklearn.linear_model import LinearRegression

from skdgp import make_identification_pipeline
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import COEFFICIENTS
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Air,
    Aircraft,
    SimulationWarning,
    Turbulence,
    aerodynamic_coefficients,
    replay,
    replay_errors,
    simulate,
    trajectory_bands,
    trim,
)
from skdgp.identification import predict_flight
from skdgp.io import read_flight

PAIRS = [
    ("c172p", "train_latlon", "test_calm"),
    ("c172p", "train_latlon", "last 40 %"),
    ("viggen_uav", "train_latlon", "test_twoalt"),
]
"""Aircraft, flight to learn from, and to fly: another flight, or the rest of the first one."""
SHARE = 0.6
SCORED = ("v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r")
ANGLES = ("phi", "theta", "psi")
HORIZONS = (2.0, 10.0)
STARTS, MARGIN, STEP, LEVEL = 20, 5.0, 0.025, 0.95
CONTROLS = ("elevator", "aileron", "rudder", "throttle")


def truth_of(flight):
    """Return the flight as it truly was, in the plain words, with its controls, thrust and air."""
    true = flight[[name for name in flight if name.endswith("_true")]]
    true = true.rename(columns=lambda name: name.removesuffix("_true"))
    known = [name for name in flight if name in CONTROLS or name.startswith("thrust")]
    return true.assign(
        time=flight["time"], altitude=flight["altitude"], density=flight["density"], **flight[known]
    )


def windows(truth, step=STEP):
    """Return the stretches that are flown free, one for each start, of a flight with a row each step."""
    rows = round(HORIZONS[-1] / step)
    first = np.linspace(round(MARGIN / step), len(truth) - rows - 2, STARTS).astype(int)
    clock = step * np.arange(rows + 1)
    return [truth.iloc[k : k + rows + 1].reset_index(drop=True).assign(time=clock) for k in first]


def flown_free(model, aircraft, stretches, air=None, **options):
    """Return what the model makes of the stretches, from their first rows on."""
    unknown = (
        ["airspeed"] if "wind" not in (air or {}) else ["airspeed", "alpha", "beta", "u", "v", "w"]
    )  # hold a gust
    starts = pd.DataFrame([stretch.iloc[0] for stretch in stretches]).drop(
        columns=unknown, errors="ignore"
    )
    gravity = float(np.mean([stretch["gravity"].mean() for stretch in stretches]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SimulationWarning)
        air = Air(**{"wind": stretches, "gravity": gravity} | (air or {}))
        return simulate(model, aircraft, starts, stretches, dt=STEP, air=air, **options)


def errors_of(flights, stretches):
    """Return the median absolute errors, a row for each horizon."""
    rows = []
    for horizon in HORIZONS:
        k = round(horizon / STEP)
        row = {"horizon": horizon}
        for name in SCORED:
            pairs = zip(flights, stretches, strict=True)
            error = [
                _off(flown[name].to_numpy()[k], truth[name][k], name) for flown, truth in pairs
            ]
            row[name] = float(np.nanmedian(np.abs(error)))
        rows.append(row)
    return rows


def coverage_of(ensembles, stretches, step=STEP):
    """Return which share of the truth lies within the 95 % bands of ensembles, a row for each horizon.

    The interval score (Gneiting & Raftery 2007) is over the deviation of each state along all
    stretches.
    """
    size = pd.concat(stretches)[[*SCORED]].std()
    bands = [
        band for ensemble in ensembles for band in _parts(trajectory_bands(ensemble, LEVEL, SCORED))
    ]
    stretches, rows = stretches * len(ensembles), []
    for horizon in HORIZONS:
        k = round(horizon / step)
        inside, width, score = [], [], []
        for band, stretch in zip(bands, stretches, strict=True):
            for name in SCORED:
                low, middle, high = (band[name + end][k] for end in ("_low", "", "_high"))
                value = middle + _off(stretch[name][k], middle, name)
                inside.append(low <= value <= high)
                width.append(abs(value - middle) / (0.5 * (high - low)))
                outside = max(low - value, 0.0, value - high)
                score.append((high - low + 2 / (1 - LEVEL) * outside) / size[name])
        row = {"horizon": horizon, "coverage %": 100.0 * np.mean(inside)}
        row["median error / half width"] = float(np.median(width))
        row["interval score"] = float(np.mean(score))
        row["flying %"] = 100.0 * float(np.mean([band["flying"][k] for band in bands]))
        rows.append(row)
    return rows


def free(name, models, aircraft, flight, n_paths):
    """Return the rows of one test flight: errors of every method, and the coverage of the bands in each air."""
    stretches = windows(truth_of(flight))
    flights = {
        method: [part for model in each for part in _parts(flown_free(model, aircraft, stretches))]
        for method, each in models.items()
    }
    flights["truth replayed"] = [
        replay(
            s, aircraft, s[list(COEFFICIENTS)], horizon=HORIZONS[-1], gravity=s["gravity"].mean()
        )
        for s in stretches
    ]
    errors = [
        {"flight": name, "method": method, **row}
        for method, parts in flights.items()
        for row in errors_of(parts, stretches * (len(parts) // len(stretches)))
    ]
    rows = []
    for air, options in airs(aircraft, flight).items():
        found = [
            flown_free(model, aircraft, stretches, options, n_paths=n_paths)
            for model in models["default"]
        ]
        rows += [
            {"flight": name, "wind and gusts": air} | row for row in coverage_of(found, stretches)
        ]
    return errors, rows


def airs(aircraft, flight):
    """Return the options of `Air` for what is known of it."""
    turbulence = Turbulence.from_flight(flight, aircraft.span)
    mean = flight[["wind_north_true", "wind_east_true", "wind_down_true"]].mean().to_numpy()
    return {
        "true wind": {},
        "mean wind, turbulence of the flight": {"gusts": turbulence, "wind": mean},
    }


def replayed(name, model, aircraft, flight):
    """Return the paper's test: medians of v_E, p, r over restarts, against measurement and truth."""
    mean, std = predict_flight(model, flight)
    flown = replay(flight, aircraft, mean, std=std, horizon=HORIZONS)
    rows = []
    for against, suffix in (("measured", ""), ("true", "_true")):
        table = replay_errors(flown, flight, suffix=suffix).set_index(["state", "horizon"])
        for horizon in HORIZONS:
            scores = {
                state: float(table.loc[(state, horizon), "median"])
                for state in ("v_east", "p", "r")
            }
            rows.append({
                "flight": name, "against": against, "horizon": horizon, "v_east [m/s]": scores["v_east"],
                "p [deg/s]": np.rad2deg(scores["p"]), "r [deg/s]": np.rad2deg(scores["r"]),
                "coverage %": 100.0 * float(np.mean([table.loc[(state, horizon), "coverage"] for state in scores])),
            })  # fmt: skip
    return rows


def timed(model, aircraft, n_paths, duration=60.0):
    """Return how long a minute of free flight at 50 Hz takes, from a trim, controls held."""
    steady = trim(model, aircraft, 35.0)
    rows = []
    for what, options in (
        ("mean", {}),
        (f"{n_paths} paths", {"n_paths": n_paths}),
        ("mean and first-order std", {"return_std": True}),
    ):
        start = time.perf_counter()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", SimulationWarning)
            simulate(
                model, aircraft, steady, steady.controls, dt=0.02, duration=duration, **options
            )
        rows.append(
            {
                "flight": what,
                "flown [s]": duration,
                "steps": round(duration / 0.02),
                "seconds": time.perf_counter() - start,
            }
        )
    return rows


def learned(options, name, flight, aircraft):
    """Return pipelines that learned from the flight, one for each seed, from the folder where they are there."""
    models = []
    for seed in range(options.seeds):
        path = options.models / f"{name}_{seed}.joblib" if options.models else None
        if path is not None and path.exists():
            models.append(joblib.load(path))
            continue
        model = make_identification_pipeline(aircraft)
        model[-1].set_params(random_state=seed)
        models.append(model.fit(flight, aerodynamic_coefficients(flight, aircraft)))
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            joblib.dump(model, path)
    return models


def _parts(trajectories):
    return [part.reset_index(drop=True) for _, part in trajectories.groupby("start")]


def _off(value, reference, name):
    difference = value - reference
    return np.angle(np.exp(1j * difference)) if name in ANGLES else difference


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--models", type=Path, help="folder of fitted pipelines")
    parser.add_argument(
        "--seeds", type=int, default=3, help="of the search: models of each training flight"
    )
    parser.add_argument("--paths", type=int, default=100, help="of the ensembles")
    options = parsed(parser, words)
    example = load_example_flights()
    test = example.test.assign(gravity_true=STANDARD_GRAVITY)
    cases = {"example test": ("example", example.aircraft, example.train, test)}
    cases |= {
        f"{name} {test}": (
            f"{name}_{test[:4]}",
            *flights_of(options.data / "flights", name, train, test),
        )
        for name, train, test in PAIRS
    }
    errors, air, replays = [], [], []
    for name, (short, aircraft, log, flight) in cases.items():
        default = learned(options, f"{short}_default", log, aircraft)
        line = make_identification_pipeline(aircraft, regressor=LinearRegression())
        models = {
            "default": default,
            "least squares": [line.fit(log, aerodynamic_coefficients(log, aircraft))],
        }
        found = free(name, models, aircraft, flight, options.paths)
        errors, air = errors + found[0], air + found[1]
        replays += replayed(name, default[0], aircraft, flight)
        if short == "example":
            times = timed(default[0], aircraft, options.paths)
    finish(
        options,
        "freeflight",
        errors=errors,
        bands=air,
        replay=replays,
        times=times,
    )


def flights_of(folder, name, train, test):
    """Return an aircraft, its flight to learn from, and the one to fly."""
    log = read_flight(folder / f"{name}_{train}.parquet")
    if test.startswith("test"):
        flight = read_flight(folder / f"{name}_{test}.parquet")
    else:
        split = round(SHARE * len(log))
        log, flight = log.iloc[:split], log.iloc[split:].reset_index(drop=True)
    return Aircraft.from_json(folder / f"{name}.json"), log, flight


if __name__ == "__main__":
    main()
