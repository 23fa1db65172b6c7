"""Default models on flights they have not seen, beside least squares: coefficients, in NRMSE.

    python tests/benchmarks/flights.py ../shared/data [samples]      default: 755 samples

Against the truth where the flight holds it, else against the measured coefficients. AP2: ten blocks in time, odd ones
learned from, even ones predicted, the tether taken away like thrust.
"""

import sys
import time
from pathlib import Path

import numpy as np
from sklearn.linear_model import LinearRegression

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import median_relative_error, normalized_rmse
from skdgp.model_selection import thin_targets

PAIRS = [
    ("viggen_uav", "train_latlon", "test_twoalt"),
    ("viggen_uav", "train_lateral", "test_twoalt"),
    ("c172p", "train_latlon", "test_calm"),
]
MODELS = {
    "dependent": DependentGPRegressor(random_state=0),
    "independent": DependentGPRegressor(n_latent=0, random_state=0),
}


def flights(folder):
    """Yield a name, aircraft, training and test flight, and the keywords of the inverse dynamics."""
    folder = Path(folder)
    for aircraft, train, test in PAIRS:
        tables = (read_flight(folder / "flights" / f"{aircraft}_{part}.parquet") for part in (train, test))
        yield f"{aircraft} {train}", Aircraft.from_json(folder / "flights" / f"{aircraft}.json"), *tables, {}
    yield "ampyx_ap2 blocks", *ampyx_ap2(folder)


def ampyx_ap2(folder):
    """Return aircraft, training and test blocks, and the keywords of the inverse dynamics."""
    table = read_flight(Path(folder) / "ampyx_ap2" / "ampyx_ap2.parquet")
    block = np.arange(len(table)) * 10 // len(table)
    table["flight"] = [f"block {b + 1}" for b in block]
    parts = (table[block % 2 == k].reset_index(drop=True) for k in (0, 1))
    loads = {"thrust": None, "external_forces": ["tether"]}
    return Aircraft.from_json(Path(folder) / "ampyx_ap2" / "ampyx_ap2.json"), *parts, loads


def main(folder, samples=755):
    for name, aircraft, train, test, loads in flights(folder):
        targets = thin_targets(aerodynamic_coefficients(train, aircraft, **loads), samples)
        learned = targets.notna().all(axis=1).to_numpy()
        asked = aerodynamic_coefficients(test, aircraft, **loads)
        truth = [f"{column}_true" for column in asked]
        asked = test[truth].to_numpy() if set(truth) <= set(test) else asked.to_numpy()
        pipeline = make_identification_pipeline(aircraft)[:-1]
        X, Xt = np.asarray(pipeline.fit_transform(train)), np.asarray(pipeline.transform(test))
        for model_name, model in {"least squares": LinearRegression(), **MODELS}.items():
            start = time.perf_counter()
            mean = model.fit(X[learned], targets.to_numpy()[learned]).predict(Xt)
            each = normalized_rmse(asked, mean, multioutput="raw_values")
            relative = 100 * median_relative_error(asked, mean, multioutput="raw_values")
            print(
                f"{name:25} {model_name:14} NRMSE {each.mean():.3f} {each.round(3)} median relative error % "
                f"{relative.round(1)} in {time.perf_counter() - start:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main(sys.argv[1], *(int(word) for word in sys.argv[2:3]))
