"""What sharing latents is worth: n_latent=0 and 2, everything else equal, in NRMSE on other samples.

    python tests/benchmarks/sharing.py ../shared/data [--out OUT] [--samples N] [--cases C]

Flights: viggen_uav, N samples of train_lateral learned from, the truth of train_latlon asked, with
outputs missing or noisy as the case says. Jura: cadmium where nickel and zinc are known. Drawn:
four outputs of three regressors that are independent, or have nine tenths of their variance in
common and one of them on every fifth sample alone.
"""

import sys
import time
import warnings
from functools import cache

import numpy as np
from _common import finish, parsed, parser_of
from jura import load
from sklearn.exceptions import ConvergenceWarning

from skdgp import DependentGPRegressor, make_identification_pipeline
from skdgp.dynamics import Aircraft, aerodynamic_coefficients
from skdgp.io import read_flight
from skdgp.metrics import normalized_rmse
from skdgp.model_selection import thin_targets

EVERY = 10  # of the rows that are asked
ALL, MOMENTS = slice(None), slice(4, 6)  # Cm and Cn


def complete(Y):
    return ALL


def first_third(Y):
    Y[len(Y) // 3 :, MOMENTS] = np.nan
    return MOMENTS


def noisy(Y):
    Y[:, 3] += Y[:, 3].std() * np.random.default_rng(0).normal(size=len(Y))
    return slice(3, 4)


FLIGHTS = {
    "flight complete": complete,
    "flight, Cm Cn in its first third": first_third,
    "flight, Cl with noise of 1 std": noisy,
}
OTHERS = ("Jura", "drawn independent", "drawn dependent, one every 5th sample")
CASES = [*OTHERS, *FLIGHTS]


def case(name, options):
    """Return samples learned from, samples asked and their truth, and the outputs that the case is about."""
    if name in FLIGHTS:
        X, Y, asked, truth = (part.copy() for part in flight(options.data, options.samples))
        return X, Y, asked, truth, FLIGHTS[name](Y)
    if name == "Jura":
        X, Y, truth = load(options.data / "jura")
        return (
            X,
            Y,
            X[-len(truth) :],
            np.column_stack([truth, np.full((len(truth), 2), np.nan)]),
            slice(0, 1),
        )
    return drawn(name == OTHERS[-1], 120)


@cache
def flight(data, n_samples):
    """Return regressors and coefficients of the samples learned from, and of those asked, the true ones."""
    folder = data / "flights"
    aircraft = Aircraft.from_json(folder / "viggen_uav.json")
    train, test = (
        read_flight(folder / f"viggen_uav_{part}.parquet")
        for part in ("train_lateral", "train_latlon")
    )
    Y = thin_targets(aerodynamic_coefficients(train, aircraft), n_samples)
    learned = Y.notna().all(axis=1).to_numpy()
    inputs = make_identification_pipeline(aircraft)[:-1]
    X, asked = np.asarray(inputs.fit_transform(train)), np.asarray(inputs.transform(test))
    truth = test[[f"{name}_true" for name in Y]].to_numpy()
    return X[learned], Y.to_numpy()[learned], asked[::EVERY], truth[::EVERY]


def drawn(dependent, n, d=3, P=4):
    """Return a case drawn from the prior (random Fourier features), noise of a fifth of the standard deviation."""
    rng = np.random.default_rng(0)
    processes = [
        (rng.normal(size=(d, 200)), rng.uniform(0, 2 * np.pi, 200), rng.normal(size=200))
        for _ in range(P + 1)
    ]
    own, common = (np.sqrt(0.1), np.sqrt(0.9)) if dependent else (1.0, 0.0)

    def outputs(X):
        each = np.column_stack([np.cos(X @ W + b) @ a / 10 for W, b, a in processes])
        return own * each[:, 1:] + common * each[:, :1] * (-1.0) ** np.arange(P)

    X, asked = rng.uniform(-2, 2, (n, d)), rng.uniform(-2, 2, (1000, d))
    Y = outputs(X) + 0.2 * rng.normal(size=(n, P))
    if dependent:
        Y[np.arange(n) % 5 > 0, 0] = np.nan
    return X, Y, asked, outputs(asked), slice(0, 1) if dependent else ALL


def run(name, options):
    """Return the errors of one case."""
    X, Y, asked, truth, about = case(name, options)
    row, start = {"case": name}, time.process_time()
    scored = np.isfinite(truth).all(axis=0)
    for n_latent in (0, 2):
        mean = (
            DependentGPRegressor(n_latent=n_latent, max_iter=60, random_state=0)
            .fit(X, Y)
            .predict(asked)
        )
        error = normalized_rmse(np.where(scored, truth, mean), mean, multioutput="raw_values")
        error = np.where(scored, error, np.nan)
        for outputs, part in (("all outputs", ALL), ("those of the case", about)):
            row[f"{outputs}, {n_latent}"] = float(np.nanmean(error[part]))
    row["2 over 0"] = row["all outputs, 2"] / row["all outputs, 0"]
    return row | {"CPU s": round(time.process_time() - start, 1)}


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument(
        "--samples", type=int, default=150, help="of the flight, learned from (default: 150)"
    )
    parser.add_argument("--cases", nargs="+", choices=CASES, default=CASES)
    options = parsed(parser, words)
    warnings.simplefilter("ignore", ConvergenceWarning)
    rows = []
    for name in options.cases:
        rows.append(run(name, options))
        print(rows[-1], file=sys.stderr, flush=True)
    finish(options, "sharing", errors=rows)


if __name__ == "__main__":
    main()
