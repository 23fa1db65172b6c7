"""Known derivatives of small aircraft without vanes, flown in gusts: how many lie inside their bands?

    python tests/benchmarks/small_uav.py [--every N] [--out OUT]

Rigid bodies of 1 to 25 kg fly 3-2-1-1 inputs under a simple controller, in turbulence around a
steady wind. Ideal sensors have white noise alone; real ones are late, biased and scaled, and log
commands of late servos; held ones have slower clocks, and each row repeats their last sample;
vibration adds an aliased oscillation of inertial sensors. The table has for each air the known
derivatives inside value +/- 1.96 std, the median error and the median half band (medians over
aircraft); then the worst aircraft, medians of the errors of alpha, with its mean removed, and of
the lag of the servos, and how many flights did not converge.
"""

import warnings

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from numpy.random import default_rng
from uav_flight import (
    AIRCRAFT,
    AIRS,
    DENSITY,
    SECONDS,
    SENSORS,
    aircraft_of,
    fly,
    logged,
    truth_of,
)

from skdgp.estimation import estimate_air_motion

NORMAL_95 = 1.96
SEED = 91


def score(table, plane, lag):
    """Return z, errors and half bands of the derivatives, then other figures, of one flight."""
    alpha = table.pop("alpha_true")
    qS = 0.5 * DENSITY * table["airspeed"] ** 2 * plane["wing_area"]
    load = (table["thrust_x"] / qS).mean()
    try:
        found = estimate_air_motion(table, aircraft_of(plane))
    except ValueError:  # it says that it diverged
        return {"z": [], "error": [], "half": [], "converged": False}
    truth = truth_of(plane, alpha.mean(), load)
    known = [name for name in truth if name in found.derivatives.index]
    value, std = found.derivatives.loc[known, ["value", "std"]].to_numpy().T
    exact = np.array([truth[name] for name in known])
    return {
        "z": ((value - exact) / std).tolist(),
        "error": (100 * abs(value / exact - 1)).tolist(),
        "half": (196 * std / abs(exact)).tolist(),
        "alpha": np.rad2deg(np.std(found.air["alpha"].to_numpy() - alpha.to_numpy())),
        "lag": 1e3 * abs(found.constants.loc["servo_lag", "value"] - lag),
        "converged": bool(found.converged),
    }


def column(flights):
    """Return a column of the table: cells by air, then over all."""
    table = flights.explode(["z", "error", "half"]).astype({"error": float, "half": float})
    table["inside"] = 100.0 * (table["z"].abs() < NORMAL_95)
    medians = table.groupby(["air", "aircraft"])[["error", "half"]].median().groupby("air").median()
    held = table.groupby("air")["inside"].mean()
    cells = {
        air: f"{held[air]:.0f} %, {medians.loc[air, 'error']:.0f} %, {medians.loc[air, 'half']:.0f} %"
        for air in flights["air"].unique()
    }
    worst = table.groupby("aircraft")["inside"].mean()
    alpha, lag = flights[["alpha", "lag"]].median()
    return cells | {
        "worst aircraft": f"{worst.min():.0f} % ({worst.idxmin()})",
        "error of alpha, of the lag": f"{alpha:.2f} deg, {lag:.1f} ms",
        "not converged": f"{sum(~flights['converged'])} of {len(flights)}",
    }


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--every", type=int, default=1, help="3: a third, even over all kinds")
    options = parser.parse_args(words)
    warnings.simplefilter("ignore")
    kept = Kept(options, "small_uav")
    axes = [*SENSORS], [*AIRCRAFT], [*AIRS]
    for place in np.ndindex(*map(len, axes)):
        if sum(place) % options.every:
            continue
        kind, name, air = case = [axis[k] for axis, k in zip(axes, place, strict=True)]
        rng = default_rng([*map(ord, "".join(case)), SEED])
        lag = rng.uniform(0.02, 0.08)
        plane = AIRCRAFT[name]
        table = logged(fly(plane, AIRS[air], rng, SECONDS, lag), rng, kind)
        key = {"sensors": kind, "aircraft": name, "air": air}
        kept.run(key, score, table, plane, lag if kind == "real" else 0.0)
    runs = kept.table
    columns = {SENSORS[kind]: column(some) for kind, some in runs.groupby("sensors", sort=False)}
    rows = pd.DataFrame(columns).reset_index(names="air").to_dict("records")
    finish(options, "small_uav", derivatives=rows)


if __name__ == "__main__":
    main()
