"""Models of aircraft of JSBSim: what their bands hold of coefficients, derivatives and free flight.

    python tests/benchmarks/freeflight_air.py [--out OUT]

Each aircraft learns by the default pipeline from a flight of 200 s in light gusts with noisy
sensors, and is asked about flights along another path. Coverage is the fraction within 95 % bands.

Models, at every tenth row: "coefficients" of flights in each air as measured, by bands of new
measurements; "function" at regressors without noise in calm air, against the true coefficients, by
bands of the function; "derivatives" within two standard deviations of JSBSim's own; "NRMSE" of the
function, and that over the one of least squares on the same regressors and coefficients.

Free flight: from 20 points of the flights, under the logged controls and thrust, from the true
state (velocity over the ground, attitude, rates), the nine states v_north ... r, by bands of 95 % and
of 50 %. "wind" is ``air=`` the true wind, a table over time; "nothing" says nothing of the air, where
that is as it was in training.

The form of the drift was chosen on J3Cub, DHC6, A4, T37 and c182, and that of bands after smoothing
changed with A320 and B747 seen; nothing was chosen on global5000, 737, c172p and t6texan2.
"""

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from ablation import LEFT_OUT, derivatives_of, of_derivatives, rows_of
from jsbsim_flight import FLOWN, KNOTS, TRAINING, flight_of, sensed
from sklearn.linear_model import LinearRegression

from skdgp import make_identification_pipeline
from skdgp.dynamics import (
    aerodynamic_coefficients,
    simulate,
    trajectory_bands,
)
from skdgp.metrics import interval_coverage, normalized_rmse

AIRCRAFT = [name for name in KNOTS if name not in LEFT_OUT]
N_PATHS = 40  # of the ensembles
STEP = 0.05  # s
HORIZONS, STARTS, MARGIN = (2.0, 10.0), 20, 5.0  # s, number, s
LEVELS = {"free_flight": 0.95, "free_flight_half": 0.5}  # of the bands, by table
SCORED = ("v_north", "v_east", "v_down", "phi", "theta", "psi", "p", "q", "r")
ANGLES = ("phi", "theta", "psi")
CONTROLS = ("elevator", "aileron", "rudder", "throttle")
UNKNOWN = ["airspeed", "alpha", "beta", "u", "v", "w"]  # Columns of a start that hold a gust


def learned(name, flight=TRAINING):
    """Return the model of an aircraft, its training flight, and the aircraft."""
    log, aircraft = flight_of(name, *flight)
    log = sensed(log)
    model = make_identification_pipeline(aircraft)
    model[-1].set_params(random_state=0)
    model.fit(log, aerodynamic_coefficients(log, aircraft))
    return model, log, aircraft


def model_row(name, model, log, aircraft, flown):
    """Return coverage of coefficients, function and derivatives, and errors of the function."""
    asked = {air: rows_of(model, flight, aircraft, {}, True) for air, flight in flown.items()}
    row = {}
    for air, rows in asked.items():
        noise = {"include_noise": True, "include_input_noise": rows.ratio}
        bands = model[-1].predict(rows.X, return_std=True, **noise)
        row[f"coefficients, {air}"] = 100.0 * interval_coverage(rows.measured, *bands)
    calm = asked["calm"]
    mean, std = model[-1].predict(calm.exact, return_std=True, include_input_noise=False)
    row["function, calm"] = 100.0 * interval_coverage(calm.truth, mean, std)
    row["derivatives"] = of_derivatives(model, **derivatives_of(name, aircraft, flown))["95 %"]
    X = np.asarray(model[:-1].transform(log))
    Y = aerodynamic_coefficients(model[:1].transform(log), aircraft).to_numpy()
    known = np.isfinite(X).all(axis=1) & np.isfinite(Y).all(axis=1)
    line = LinearRegression().fit(X[known], Y[known]).predict(calm.exact)
    error = float(normalized_rmse(calm.truth, mean))
    return row | {"NRMSE": error, "over least squares": error / normalized_rmse(calm.truth, line)}


def windows(flight):
    """Return the stretches of the true flight that are flown free, one for each start."""
    flight = flight.iloc[::2]
    true = flight.filter(regex="_true$").rename(columns=lambda name: name.removesuffix("_true"))
    known = [name for name in flight if name in CONTROLS or name.startswith("thrust")]
    true = true.assign(**flight[["time", "altitude", "density", *known]])
    rows = round(HORIZONS[-1] / STEP)
    first = np.linspace(round(MARGIN / STEP), len(true) - rows - 2, STARTS).astype(int)
    clock = STEP * np.arange(rows + 1)
    return [true.iloc[k : k + rows + 1].reset_index(drop=True).assign(time=clock) for k in first]


def held(paths, stretches, horizon, level):
    """Return the percentage of true states within bands of a level after a time [s]."""
    k = round(horizon / STEP)
    inside = []
    bands = trajectory_bands(paths, level, SCORED)
    for (_, band), stretch in zip(bands.groupby("start"), stretches, strict=True):
        for name in SCORED:
            low, middle, high = (band[name + end].iloc[k] for end in ("_low", "", "_high"))
            off = stretch[name][k] - middle
            off = np.angle(np.exp(1j * off)) if name in ANGLES else off
            inside.append(low <= middle + off <= high)
    return 100.0 * np.mean(inside)


def flown_rows(model, aircraft, flown):
    """Return coverage of free flight in each air, by what is said of the wind, for each level."""
    rows = {kind: {} for kind in LEVELS}
    for air, flight in flown.items():
        stretches = windows(flight)
        starts = pd.DataFrame([stretch.iloc[0] for stretch in stretches])
        starts = starts.drop(columns=UNKNOWN, errors="ignore")
        told = {"wind": {"air": stretches}} | ({"nothing": {}} if air == TRAINING[1] else {})
        for said, options in told.items():
            paths = simulate(model, aircraft, starts, stretches, STEP, n_paths=N_PATHS, **options)
            for kind, level in LEVELS.items():
                for t in HORIZONS:
                    rows[kind][f"{air}, {said}, {t:g} s"] = held(paths, stretches, t, level)
    return rows


def measured(name):
    """Return the rows of an aircraft."""
    model, log, aircraft = learned(name)
    flown = {air: flight_of(name, *flight)[0] for air, flight in FLOWN.items()}
    models = model_row(name, model, log, aircraft, flown)
    return {"models": models, **flown_rows(model, aircraft, flown)}


def summary(runs, kind):
    """Return the median and the worst over aircraft: the lowest coverage, the largest error."""
    table = pd.DataFrame([run[kind] for run in runs])
    errors = table.columns.isin(["NRMSE", "over least squares"])
    worst = table.min().where(~errors, table.max())
    return [{"of aircraft": "median", **table.median()}, {"of aircraft": "worst", **worst}]


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    kept = Kept(options, "freeflight_air")
    for name in AIRCRAFT:
        kept.run({"aircraft": name}, measured, name)
    tables = {kind: summary(kept.asked.values(), kind) for kind in ("models", *LEVELS)}
    finish(options, "freeflight_air", **tables)


if __name__ == "__main__":
    main()
