"""Free flight of models of aircraft of JSBSim: what their bands hold.

    python tests/benchmarks/freeflight_air.py [--out OUT]

Each aircraft learns by the default pipeline from a flight of 200 s in light gusts with noisy
sensors, and flies along another path: from 20 points of that flight, under the logged controls and
thrust, from the true state (velocity over the ground, attitude, rates), the nine states v_north ... r,
by bands of 95 % and of 50 %. "wind" is ``air=`` the true wind, a table over time; "nothing" says
nothing of the air, where that is as it was in training.

The form of the drift was chosen on J3Cub, DHC6, A4, T37 and c182, and that of bands after smoothing
changed with A320 and B747 seen; nothing was chosen on global5000, 737, c172p and t6texan2.
"""

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from flight_columns import EULER, RATES, SURFACES, VELOCITY
from jsbsim_flight import FLOWN, KNOTS, LEFT_OUT, TRAINING, flight_of, sensed
from made_flights import wrapped

from skdgp import make_identification_pipeline
from skdgp.dynamics import (
    aerodynamic_coefficients,
    simulate,
    trajectory_bands,
)

AIRCRAFT = [name for name in KNOTS if name not in LEFT_OUT]
N_PATHS = 40  # of the ensembles
STEP = 0.05  # s
HORIZONS, STARTS, MARGIN = (2.0, 10.0), 20, 5.0  # s, number, s
LEVELS = {"free_flight": 0.95, "free_flight_half": 0.5}  # of the bands, by table
SCORED = [*VELOCITY, *EULER, *RATES]
CONTROLS = [*SURFACES, "throttle"]
UNKNOWN = ["airspeed", "alpha", "beta", "u", "v", "w"]  # Columns of a start that hold a gust


def learned(name, flight=TRAINING):
    """Return the model of an aircraft, and the aircraft."""
    log, aircraft = flight_of(name, *flight)
    log = sensed(log)
    model = make_identification_pipeline(aircraft)
    model[-1].set_params(random_state=0)
    model.fit(log, aerodynamic_coefficients(log, aircraft))
    return model, aircraft


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
            off = wrapped(off) if name in EULER else off
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
    model, aircraft = learned(name)
    flown = {air: flight_of(name, *flight)[0] for air, flight in FLOWN.items()}
    return flown_rows(model, aircraft, flown)


def summary(runs, kind):
    """Return the median and the lowest coverage of the aircraft."""
    table = pd.DataFrame([run[kind] for run in runs])
    return [{"of aircraft": "median", **table.median()}, {"of aircraft": "worst", **table.min()}]


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    kept = Kept(options, "freeflight_air")
    for name in AIRCRAFT:
        kept.run({"aircraft": name}, measured, name)
    tables = {kind: summary(kept.asked.values(), kind) for kind in LEVELS}
    finish(options, "freeflight_air", **tables)


if __name__ == "__main__":
    main()
