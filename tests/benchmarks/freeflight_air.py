"""Coverage of free flight in calm air and in gusts, by calls of `simulate` that say nothing but the wind.

    python tests/benchmarks/freeflight_air.py [--aircraft J3Cub DHC6 A4 global5000] [--models FOLDER] [--paths 40]

Each aircraft of JSBSim learns by the default pipeline from a flight of 200 s in light gusts with noisy sensors. It is
flown from 20 points of other flights along another path, in calm air, light and moderate gusts, under the logged
controls and thrust, from the true state (velocity over the ground, attitude, rates). "wind" is ``wind=`` the true
wind, a table over time; "nothing" says nothing of the air, where that is as it was in training. Coverage is the share
of the nine states v_north ... r within their 95 % bands. The medians and the worst are over aircraft.

The form of the drift was chosen on J3Cub, DHC6, A4, T37 and c182; nothing was on global5000, t6texan2 and c172p.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import joblib
import numpy as np
import pandas as pd
from _common import finish, parser_of
from _study_flights import KNOTS, jsbsim_log
from freeflight import HORIZONS, coverage_of, truth_of, windows

from skdgp import make_identification_pipeline
from skdgp._flight.channels import AIR_DATA, COEFFICIENTS, EARTH_VELOCITY, EULER, WIND
from skdgp.datasets._example_flights import MEASURED, measure
from skdgp.dynamics import (
    SimulationWarning,
    aerodynamic_coefficients,
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    simulate,
)
from skdgp.dynamics._equations.rigid_body import STANDARD_GRAVITY

DURATION, STEP = 200.0, 0.05
TRAINING = (1, "light", 1)
"""Plan of the flight, air and seed."""
FLOWN = {"calm": (2, "calm", 0), "light": (2, "light", 11), "moderate": (2, "moderate", 12)}
UNKNOWN = ["airspeed", *AIR_DATA[1:], "u", "v", "w"]
"""Columns of a start that hold a gust."""


def flight_of(name, number, air, seed):
    """Return a flight of an aircraft with its truth, and the aircraft."""
    log, aircraft = jsbsim_log(name, DURATION, number, air, seed)
    true = log.table.assign(**dict(zip([f"{c}_true" for c in COEFFICIENTS], log.truth.T, strict=True)))
    attitude = euler_to_quaternion(*true[[f"{name}_true" for name in EULER]].to_numpy().T)
    through_air = body_to_ned(attitude, air_velocity(*true[[f"{name}_true" for name in AIR_DATA]].to_numpy().T))
    wind = true[[f"{name}_true" for name in EARTH_VELOCITY]].to_numpy() - through_air
    true = true.assign(gravity_true=STANDARD_GRAVITY, **dict(zip([f"{w}_true" for w in WIND], wind.T, strict=True)))
    noise = np.random.default_rng([number, seed, len(name)])  # mostly another for each aircraft
    return pd.concat([measure(log.table, 1.0, noise), true], axis=1), aircraft


def learned(name, folder):
    """Return the model of an aircraft, from the folder if it is there, and the aircraft."""
    log, aircraft = flight_of(name, *TRAINING)
    path = None if folder is None else folder / f"{name}.joblib"
    if path is not None and path.exists():
        return joblib.load(path), aircraft
    log = log[[column for column in MEASURED if column in log]]
    model = make_identification_pipeline(aircraft)
    model[-1].set_params(random_state=0)
    model.fit(log, aerodynamic_coefficients(log, aircraft))
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        joblib.dump(model, path)
    return model, aircraft


def rows_of(name, model, aircraft, n_paths):
    """Return coverage in each air, by what is said of the wind."""
    rows = []
    for air, flight in FLOWN.items():
        stretches = windows(truth_of(flight_of(name, *flight)[0].iloc[::2]), STEP)
        starts = pd.DataFrame([stretch.iloc[0] for stretch in stretches]).drop(columns=UNKNOWN, errors="ignore")
        told = {"wind": {"wind": stretches}} | ({"nothing": {}} if air == TRAINING[1] else {})
        for said, options in told.items():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", SimulationWarning)
                paths = simulate(model, aircraft, starts, stretches, STEP, n_paths=n_paths, **options)
            found = {f"{row['horizon']:g} s": row["coverage %"] for row in coverage_of([paths], stretches, STEP)}
            rows.append({"aircraft": name, "air": air, "said": said} | found)
    return rows


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", nargs="+", default=["J3Cub", "DHC6", "A4", "global5000"], choices=[*KNOTS])
    parser.add_argument("--models", type=Path, help="folder of fitted pipelines")
    parser.add_argument("--paths", type=int, default=40, help="of the ensembles")
    options = parser.parse_args(words)
    rows = []
    for name in options.aircraft[: 0 if options.smoke else None]:
        rows += rows_of(name, *learned(name, options.models), options.paths)
        print(pd.DataFrame(rows[-4:]).round(1).to_string(header=len(rows) == 4, index=False), flush=True)
    if rows:
        by_air = pd.DataFrame(rows).groupby(["air", "said"], sort=False)[[f"{h:g} s" for h in HORIZONS]]
        found = {"median": by_air.median(), "lowest": by_air.min(), "highest": by_air.max()}
        rows += [{"aircraft": what} | row for what, t in found.items() for row in t.reset_index().to_dict("records")]
    finish(options, "freeflight_air", coverage=rows)


if __name__ == "__main__":
    main()
