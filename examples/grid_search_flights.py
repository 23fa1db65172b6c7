"""
Choose a model
==============

Choose settings by grid search over the whole pipeline, with one flight held out each time::

    python examples/grid_search_flights.py

The search takes raw flight tables, so smoothing is chosen too, and no information of the held-out
flight leaks into the fit. Targets that are NaN are neither learned nor scored. The scorers use the
predicted standard deviations, so narrow bands around a wrong mean score worst. It takes five to
ten minutes. Needs matplotlib: pip install "skdgp[plot]".
"""

import argparse
import warnings

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from sklearn.exceptions import ConvergenceWarning
from sklearn.model_selection import GridSearchCV, LeaveOneGroupOut

from skdgp.datasets import load_example_flights
from skdgp.dynamics import aerodynamic_coefficients
from skdgp.identification import make_identification_pipeline
from skdgp.metrics import SCORERS
from skdgp.model_selection import thin_targets

GRID = {
    "flightsmoother__cutoff": ["auto", None],
    "dependentgpregressor__trend": ["linear", "constant"],
    "dependentgpregressor__n_latent": [2, 0],
}
WORDS = {
    "auto": "smoothed",
    None: "raw",
    "linear": "linear trend",
    "constant": "constant trend",
    2: "dependent",
    0: "independent",
}
SHOWN = {
    "neg_normalized_rmse": "RMSE / std of the flight",
    "log_predictive_density": "log predictive density",
}


def flights_of(n_days):
    """The two training flights of some days: the same plans, other gusts."""
    days = [load_example_flights(random_state=day) for day in range(n_days)]
    tables = [
        day.train.assign(flight=day.train["flight"].astype(str) + f" {k + 1}")
        for k, day in enumerate(days)
    ]
    return pd.concat(tables, ignore_index=True), days[0].aircraft


def draw(results, groups, path):
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, len(SHOWN), sharey=True)
    order = np.argsort(results["mean_test_log_predictive_density"])
    names = [", ".join(WORDS[value] for value in results["params"][k].values()) for k in order]
    for ax, (scorer, label) in zip(axes, SHOWN.items(), strict=True):
        sign = -1 if scorer.startswith("neg_") else 1
        for fold, group in enumerate(groups):
            ax.plot(
                sign * results[f"split{fold}_test_{scorer}"][order],
                range(len(names)),
                "o",
                alpha=0.6,
                label=group,
            )
        ax.plot(
            sign * results[f"mean_test_{scorer}"][order],
            range(len(names)),
            "k|",
            markersize=16,
            label="mean",
        )
        ax.set_xlabel(label)
        ax.grid(axis="x", alpha=0.3)
    axes[0].set_yticks(range(len(names)), names)
    axes[-1].legend(title="held out", loc="lower right", fontsize="small")
    figure.suptitle("What to learn the coefficients with: best at the top")
    figure.savefig(path, dpi=150)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--samples",
        type=int,
        default=200,
        help="rows to learn from and score (default: %(default)s)",
    )
    parser.add_argument(
        "--max-iter", type=int, default=30, help="iterations of each fit (default: %(default)s)"
    )
    parser.add_argument(
        "--days", type=int, default=2, help="two flights of each (default: %(default)s)"
    )
    parser.add_argument(
        "--n-jobs", type=int, default=2, help="fits side by side (default: %(default)s)"
    )
    parser.add_argument(
        "--output", default="grid_search.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)

    flights, aircraft = flights_of(options.days)
    targets = thin_targets(aerodynamic_coefficients(flights, aircraft), options.samples)

    model = make_identification_pipeline(aircraft, reconstruction="passthrough")
    model.set_params(
        dependentgpregressor__max_iter=options.max_iter, dependentgpregressor__random_state=0
    )
    search = GridSearchCV(
        model,
        GRID,
        scoring={name: SCORERS[name] for name in SHOWN},
        refit="log_predictive_density",
        cv=LeaveOneGroupOut(),
        n_jobs=options.n_jobs,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # --max-iter cuts fits short
        search.fit(flights, targets, groups=flights["flight"])

    print("best:", ", ".join(f"{name} = {value}" for name, value in search.best_params_.items()))
    print(f"log predictive density of flights held out: {search.best_score_:.3f}")
    draw(search.cv_results_, sorted(flights["flight"].unique()), options.output)
    print(options.output)


if __name__ == "__main__":
    main()
