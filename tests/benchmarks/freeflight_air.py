"""A model judged on aircraft of JSBSim: what its bands hold of coefficients, derivatives and free flight.

    python tests/benchmarks/freeflight_air.py [--aircraft J3Cub DHC6 A4] [--models FOLDER] [--paths 40] [--constants]

Each aircraft of JSBSim learns by the default pipeline from a flight of 200 s in light gusts with
noisy sensors, and is asked about other flights along another path. Coverage is the share within 95
% bands; the worst is the lowest.

Models, at every tenth row: "coefficients" of flights in each air as measured, by bands of new
measurements; "function" at regressors without noise in calm air, against the true coefficients, by
bands of the function; "derivatives" within two standard deviations, of those that are not zero
(_study_flights.py says which are known); "NRMSE" of the function, and that over the one of least
squares on the same regressors and coefficients.

Free flight: from 20 points of the flights, under the logged controls and thrust, from the true
state (velocity over the ground, attitude, rates), the nine states v_north ... r. "wind" is ``air=``
the true wind, a table over time; "nothing" says nothing of the air, where that is as it was in
training.

"gusts": their power by `Turbulence.from_flight` of the sensors over the true one, at frequencies
that turn an aircraft.

The form of the drift was chosen on J3Cub, DHC6, A4, T37 and c182, and that of bands after smoothing
changed with A320 and B747 seen; nothing was chosen on global5000, 737, c172p and t6texan2.

--constants scores values of what was chosen, on half of the starts, by the score of Dawid and
Sebastiani: the mean of log s^2 + e^2 / s^2 over states, starts and both horizons, with the error e
of the mean of the paths and their deviation s. It is a proper score (Gneiting & Raftery 2007,
equation 25): the lower, the better. `OPINION` has the score of the coefficients of pieces of the
flights, given alone. Each aircraft is judged with the value whose mean over the other aircraft is
the lowest.
"""

import warnings
from itertools import pairwise
from pathlib import Path
from unittest.mock import patch

import joblib
import numpy as np
import pandas as pd
from _common import finish, parser_of
from _study_flights import KNOTS, jsbsim_log, jsbsim_subject
from _study_methods import EVERY, known_by, line
from freeflight import HORIZONS, SCORED, _off, coverage_of, truth_of, windows
from scipy.signal import welch
from scipy.stats import gmean, norm
from scipy.stats import t as student
from study import LOGGED, Results, coverage_table

from skdgp import make_identification_pipeline
from skdgp._flight.atmosphere import STANDARD_GRAVITY
from skdgp._flight.channels import AIR_DATA, COEFFICIENTS, EARTH_VELOCITY, EULER, WIND
from skdgp._mechanics import aerodynamics
from skdgp._mechanics.air import _spectrum
from skdgp.datasets._example_flights import MEASURED, measure
from skdgp.dynamics import (
    SimulationWarning,
    Turbulence,
    aerodynamic_coefficients,
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    simulate,
)
from skdgp.dynamics import _wind as simulated_wind
from skdgp.identification import flight_regressors
from skdgp.metrics import interval_coverage
from skdgp.preprocessing import _flight_path

DURATION, STEP = 200.0, 0.05
TRAINING = (1, "light", 1)
"""Plan of the flight, air and seed."""
FLOWN = {"calm": (2, "calm", 0), "light": (2, "light", 11), "moderate": (2, "moderate", 12)}
UNKNOWN = ["airspeed", *AIR_DATA[1:], "u", "v", "w"]
"""Columns of a start that hold a gust."""
CONSTANTS = [
    ("calm", aerodynamics, "MISFIT_MEMORY", (1.0, 2.0, 5.0)),
    ("moderate", simulated_wind, "ROUGHEST", (1.0, 2.0, np.inf)),
]
"""Air in which a constant counts, its module and name, and values that are scored."""
OPINIONS = (0.0, 0.5, 1.0, 2.0, 5.0, 20.0)
PIECES, PER_LENGTH = (0.5, 2.0, 10.0), 8
"""Lengths [s] of pieces of a log that are given alone, and pieces of each length."""


def flight_of(name, number, air, seed):
    """Return a flight of an aircraft with its truth, and the aircraft."""
    log, aircraft = jsbsim_log(name, DURATION, number, air, seed)
    true = log.table.assign(
        **dict(zip([f"{c}_true" for c in COEFFICIENTS], log.truth.T, strict=True))
    )
    attitude = euler_to_quaternion(*true[[f"{name}_true" for name in EULER]].to_numpy().T)
    through_air = body_to_ned(
        attitude, air_velocity(*true[[f"{name}_true" for name in AIR_DATA]].to_numpy().T)
    )
    wind = true[[f"{name}_true" for name in EARTH_VELOCITY]].to_numpy() - through_air
    true = true.assign(
        gravity_true=STANDARD_GRAVITY, **dict(zip([f"{w}_true" for w in WIND], wind.T, strict=True))
    )
    noise = np.random.default_rng([number, seed, len(name)])  # mostly another for each aircraft
    return pd.concat([measure(log.table, 1.0, noise), true], axis=1), aircraft


def sensed(log):
    """Return what the sensors saw of a flight."""
    return log[[column for column in MEASURED if column in log]]


def learned(name, folder):
    """Return the model of an aircraft, from the folder if it is there, its training flight, and the aircraft."""
    log, aircraft = flight_of(name, *TRAINING)
    log = sensed(log)
    path = None if folder is None else folder / f"{name}.joblib"
    if path is not None and path.exists():
        return joblib.load(path), log, aircraft
    model = make_identification_pipeline(aircraft)
    model[-1].set_params(random_state=0)
    model.fit(log, aerodynamic_coefficients(log, aircraft))
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        joblib.dump(model, path)
    return model, log, aircraft


def model_row(name, model, log, flown):
    """Return coverage of coefficients, function and derivatives, and errors of the function."""
    row, subject = {"aircraft": name}, jsbsim_subject(name, 1, DURATION)
    for air, flight in flown.items():
        measured = aerodynamic_coefficients(sensed(flight), subject.aircraft).to_numpy()
        regressors, ratio = flight_regressors(model, sensed(flight))
        options = {"return_std": True, "include_noise": True, "include_input_noise": ratio[::EVERY]}
        bands = model[-1].predict(regressors[::EVERY], **options)
        row[f"coefficients, {air}"] = 100.0 * interval_coverage(measured[::EVERY], *bands)
    ours = known_by(model[-3:], subject, LOGGED)
    X, Y = (
        model[:-2].transform(log).to_numpy(),
        aerodynamic_coefficients(log, subject.aircraft).to_numpy(),
    )
    keys = [(TRAINING[1], LOGGED, method) for method in ("default", "least squares")]
    found = dict(zip(keys, (ours, line(X, Y, subject, LOGGED)), strict=True))
    results = Results(subject, found.items())
    error, linear = (float(results.nrmse(key).mean()) for key in keys)
    row["function, calm"] = 100.0 * interval_coverage(
        results.truth, ours.function, ours.function_std
    )
    row["derivatives"] = coverage_table(results)[0]["within 2 std, %"]
    return row | {"NRMSE": error, "over least squares": error / linear}


def scores_of(model, aircraft, flown, n_paths):
    """Return score and coverage by constant, air and value, flown in the true wind from every other start."""
    found = {}
    for air, module, constant, values in CONSTANTS:
        stretches = windows(truth_of(flown[air].iloc[::2]), STEP)[::2]
        starts = pd.DataFrame([stretch.iloc[0] for stretch in stretches]).drop(
            columns=UNKNOWN, errors="ignore"
        )
        steps = [round(horizon / STEP) for horizon in HORIZONS]
        for value in values:
            with warnings.catch_warnings(), patch.object(module, constant, value):
                warnings.simplefilter("ignore", SimulationWarning)
                paths = simulate(
                    model, aircraft, starts, stretches, STEP, n_paths=n_paths, air=stretches
                )
            off = []
            for name in SCORED:
                flights = paths[name].to_numpy().reshape(n_paths, len(stretches), -1)[..., steps]
                off.append(
                    _off(
                        flights,
                        np.array([stretch[name].to_numpy()[steps] for stretch in stretches]),
                        name,
                    )
                )
            error, std = np.nanmean(off, axis=1), np.nanstd(off, axis=1, ddof=1)
            widest = student.ppf(0.975, n_paths - 1) * np.sqrt(1 + 1 / n_paths)
            score = np.mean(2 * np.log(std) + (error / std) ** 2)
            found[f"{constant}, {air}", value] = score, 100 * np.mean(np.abs(error) < widest * std)
    return found


def piece_scores(model, aircraft, flown):
    """Return score and coverage by value of `OPINION`: of the coefficients of pieces of flights in each air."""
    found = {}
    for value in OPINIONS:
        score, inside = [], []
        for flight in flown.values():
            log = sensed(flight)
            measured = aerodynamic_coefficients(log, aircraft).to_numpy()
            for seconds in PIECES:
                rows = round(seconds / STEP) + 1
                for start in np.linspace(0, len(log) - rows, PER_LENGTH).astype(int):
                    piece = slice(start, start + rows)
                    with patch.object(_flight_path, "OPINION", value):
                        regressors, ratio = flight_regressors(model, log.iloc[piece])
                    options = {
                        "return_std": True,
                        "include_noise": True,
                        "include_input_noise": ratio[::EVERY],
                    }
                    mean, std = model[-1].predict(regressors[::EVERY], **options)
                    error = measured[piece][::EVERY] - mean
                    score.append(np.mean(2 * np.log(std) + (error / std) ** 2))
                    inside.append(np.mean(np.abs(error) < norm.ppf(0.975) * std))
        found["OPINION, pieces", value] = np.mean(score), 100 * np.mean(inside)
    return found


def chosen_by_others(found):
    """Return a table for each constant: by aircraft the scores, less the lowest, and what the other aircraft choose."""
    tables = {}
    for constant in dict.fromkeys(key[0] for each in found.values() for key in each):
        scores = pd.DataFrame(
            {
                n: {v: s for (c, v), (s, _) in each.items() if c == constant}
                for n, each in found.items()
            }
        )
        tables[constant] = rows = []
        for name, own in scores.items():
            value = scores.drop(columns=name).mean(axis=1).idxmin()
            row = {"aircraft": name} | {f"score, {v:g}": s - own.min() for v, s in own.items()}
            row |= {f"coverage, {v:g}": found[name][constant, v][1] for v in scores.index}
            rows.append(
                row | {"chosen by others": value, "coverage": found[name][constant, value][1]}
            )
    return tables


def flown_row(name, model, aircraft, flown, n_paths):
    """Return coverage of free flight in each air, by what is said of the wind."""
    row = {"aircraft": name}
    for air, flight in flown.items():
        stretches = windows(truth_of(flight.iloc[::2]), STEP)
        starts = pd.DataFrame([stretch.iloc[0] for stretch in stretches]).drop(
            columns=UNKNOWN, errors="ignore"
        )
        told = {"wind": {"air": stretches}} | ({"nothing": {}} if air == TRAINING[1] else {})
        for said, options in told.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SimulationWarning)
                paths = simulate(
                    model, aircraft, starts, stretches, STEP, n_paths=n_paths, **options
                )
            found = coverage_of([paths], stretches, STEP)
            row |= {f"{air}, {said}, {each['horizon']:g} s": each["coverage %"] for each in found}
    return row


def air_row(name, aircraft, flown):
    """Return the power of gusts u, v, w by `Turbulence.from_flight` over the true one, where gusts turn an aircraft.

    The geometric mean over three bands of the frequencies up to pi V / 4 b, the lowest of which
    begin at .3 rad/s.
    """
    row = {"aircraft": name}
    for air in ("light", "moderate"):
        flight, found = flown[air], Turbulence.from_flight(sensed(flown[air]), aircraft.span)
        wind, psi = flight[[f"{w}_true" for w in WIND]].to_numpy(), flight["psi_true"].to_numpy()
        (north, east, down), speed = (wind - wind.mean(axis=0)).T, flight["airspeed_true"].mean()
        gusts = [
            np.cos(psi) * north + np.sin(psi) * east,
            np.cos(psi) * east - np.sin(psi) * north,
            down,
        ]
        frequency, power = welch(
            np.array(gusts), 1 / np.median(np.diff(flight["time"])), nperseg=2048
        )
        edges = np.geomspace(0.3, np.pi * speed / (4 * aircraft.span), 7)[3:]
        for k, axis in enumerate("uvw"):
            model = (
                2
                * found.intensity[k] ** 2
                * _spectrum(2 * np.pi * frequency, found.length[k] / speed, k)
            )
            bands = [
                (low <= 2 * np.pi * frequency) & (2 * np.pi * frequency < high)
                for low, high in pairwise(edges)
            ]
            row[f"{axis}, {air}"] = gmean(
                [model[band].mean() / power[k, band].mean() for band in bands]
            )
        row[f"tied, {air}"] = found.is_tied
    return row


def summarized(rows):
    """Return the rows, and the median and the worst over aircraft: the lowest coverage, the largest error."""
    if not rows:
        return rows
    table = pd.DataFrame(rows).set_index("aircraft")
    errors = table.columns.isin(["NRMSE", "over least squares"])
    worst = table.min().where(~errors, table.max())
    return [*rows, {"aircraft": "median", **table.median()}, {"aircraft": "worst", **worst}]


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument(
        "--aircraft", nargs="+", default=["J3Cub", "DHC6", "A4", "global5000"], choices=[*KNOTS]
    )
    parser.add_argument("--models", type=Path, help="folder of fitted pipelines")
    parser.add_argument("--paths", type=int, default=40, help="of the ensembles")
    parser.add_argument(
        "--constants", action="store_true", help="score values of constants, and nothing else"
    )
    options = parser.parse_args(words)
    models, flights, gusts, scores = [], [], [], {}
    for name in options.aircraft:
        model, log, aircraft = learned(name, options.models)
        flown = {air: flight_of(name, *flight)[0] for air, flight in FLOWN.items()}
        if options.constants:
            scores[name] = scores_of(model, aircraft, flown, options.paths) | piece_scores(
                model, aircraft, flown
            )
            print(
                name, {key: np.round(value, 2) for key, value in scores[name].items()}, flush=True
            )
            continue
        models.append(model_row(name, model, log, flown))
        flights.append(flown_row(name, model, aircraft, flown, options.paths))
        gusts.append(air_row(name, aircraft, flown))
        print(pd.DataFrame([models[-1] | flights[-1]]).round(2).to_string(index=False), flush=True)
    if options.constants:
        finish(options, "freeflight_air_constants", **chosen_by_others(scores))
        return
    finish(
        options,
        "freeflight_air",
        models=summarized(models),
        free_flight=summarized(flights),
        gusts=gusts,
    )


if __name__ == "__main__":
    main()
