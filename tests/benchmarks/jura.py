"""Cadmium in Swiss Jura where nickel and zinc are known: the standard benchmark of dependent outputs.

    python tests/benchmarks/jura.py ../shared/data/jura

Fits Cd, Ni, Zn at 259 sites and Ni, Zn at 100 others; predicts Cd at these; prints the mean
absolute error for three seeds, by the average and by all terms alone.
"""

import sys
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd

from skdgp import DependentGPRegressor


def load(folder):
    """Return sites (359, 2), metals (359, 3) with Cd unknown at the last 100, and these 100."""
    known, asked = (
        pd.read_csv(Path(folder) / f"jura_{name}.csv") for name in ("prediction", "validation")
    )
    both = pd.concat([known, asked], ignore_index=True)
    Y = both[["Cd", "Ni", "Zn"]].to_numpy(float)
    Y[len(known) :, 0] = np.nan
    return both[["Xloc", "Yloc"]].to_numpy(), Y, asked["Cd"].to_numpy()


def error(folder, *, seed, logarithms=False, **parameters):
    """Return the mean absolute error of one fit."""
    X, Y, truth = load(folder)
    model = DependentGPRegressor(random_state=seed, **parameters).fit(
        X, np.log(Y) if logarithms else Y
    )
    mean = model.predict(X[-len(truth) :])[:, 0]
    return np.abs((np.exp(mean) if logarithms else mean) - truth).mean()


def main(folder):
    for structure, logarithms in product(("average", "joint"), (False, True)):
        errors = [
            error(folder, seed=seed, logarithms=logarithms, structure=structure)
            for seed in range(3)
        ]
        kind = "logarithms" if logarithms else "raw"
        print(
            structure, kind, np.round(errors, 4), "median", round(np.median(errors), 4), flush=True
        )


if __name__ == "__main__":
    main(sys.argv[1])
