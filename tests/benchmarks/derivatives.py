"""Stability derivatives and modes of the example aircraft, learned from its flights, beside the known ones.

    python tests/benchmarks/derivatives.py [--out FOLDER] [--samples N] [--seeds 0 1 2] [--turbulence 1]

The default pipeline learns from both training flights. At three level trims of the true aircraft
each derivative is compared with the known one, and the modes of the learned aircraft at its own
trims with those of the true one.

A model without alpha_dot and beta_dot gives other regressors what these do, as far as they went
together: what the data hold is the known derivative plus that by alpha_dot times the slope of
alpha_dot by the regressor, here of least squares on the noise-free columns of the training flights,
for scoring alone. These are the "merged" ones.
"""

import time
import warnings

import numpy as np
import pandas as pd
from _common import finish, parser_of, show
from sklearn.exceptions import ConvergenceWarning

from skdgp import make_identification_pipeline
from skdgp._flight.channels import COEFFICIENTS
from skdgp._mechanics.motion import Motion
from skdgp.datasets import load_example_flights
from skdgp.datasets._brumby import brumby_derivatives
from skdgp.dynamics import (
    Aerodynamics,
    aerodynamic_coefficients,
    linearize,
    stability_derivatives,
    trim,
)
from skdgp.model_selection import thin_targets

AIRSPEEDS, ALTITUDE = (32.0, 36.0, 40.0), 220.0
RATES = ("p", "q", "r", "alpha_dot", "beta_dot")
SHOWN = (
    "CL_alpha",
    "CD_alpha",
    "Cm_alpha",
    "Cm_q",
    "CY_beta",
    "Cl_beta",
    "Cn_beta",
    "Cl_p",
    "Cn_p",
    "Cl_r",
    "Cn_r",
    "CZ_elevator",
    "Cm_elevator",
    "Cl_aileron",
    "Cn_aileron",
    "CY_rudder",
    "Cn_rudder",
)


def known_aircraft(data):
    """Return the true coefficients as a model to fly."""
    names = [f"{name}_hat" if name in RATES else name for name in data.regressor_names]
    return Aerodynamics(data.aerodynamics, names, gradient=brumby_derivatives)


def slopes_of_slopes(data, regressors):
    """Return d (alpha_dot, beta_dot) / d regressors over the training flights, all rates non-dimensional."""
    train, aircraft = data.train, data.aircraft
    lengths = dict(
        zip(RATES, (*aircraft.moment_lengths, aircraft.chord, aircraft.span), strict=True)
    )

    def column(name):
        values = train[f"{name}_true"] if f"{name}_true" in train else train[name]
        return values * lengths[name] / (2 * train["airspeed_true"]) if name in lengths else values

    X = np.column_stack([np.ones(len(train)), *map(column, regressors)])
    lagging = np.column_stack([column("alpha_dot"), column("beta_dot")])
    return pd.DataFrame(
        np.linalg.lstsq(X, lagging, rcond=None)[0][1:], regressors, ["alpha_dot", "beta_dot"]
    )


def compared(model, truth, data, n_paths):
    """Return all derivatives at the trims, learned and known."""
    trims = trim(truth, data.aircraft, AIRSPEEDS, altitude=ALTITUDE)
    table = stability_derivatives(model, data.aircraft, trims, n_paths=n_paths)
    known = stability_derivatives(truth, data.aircraft, trims)["value"]
    table = table[table["regressor"] != ""].copy()
    regressors = list(table["regressor"].unique())
    table["known"] = known.reindex(table.index).fillna(0.0)  # by throttle
    table["merged"] = table["known"]
    if "alpha_dot" not in regressors:
        slopes = slopes_of_slopes(data, regressors)
        for (point, name), row in table.iterrows():
            lost = (
                known[point, f"{row['coefficient']}_{rate}"] * slopes.loc[row["regressor"], rate]
                for rate in slopes
            )
            table.loc[(point, name), "merged"] += sum(lost)
    return table


def coverage(tables):
    """Return the share of the derivatives within two standard deviations, and by the posterior alone."""
    table = pd.concat(tables.values())
    rows = {"all, body axes": table["coefficient"].isin(COEFFICIENTS)}
    rows |= {f"the {len(SHOWN)} below": table.index.get_level_values(1).isin(SHOWN)}
    inside = {
        kind: np.abs(table["value"] - table[kind]) < 2 * table["std"]
        for kind in ("known", "merged")
    }
    inside["known, posterior alone"] = (
        np.abs(table["value"] - table["known"]) < 2 * table["std_posterior"]
    )
    return [
        {"derivatives of": name, "number": int(chosen.sum())}
        | {
            f"within 2 std of {kind}, %": float(100 * found[chosen].mean())
            for kind, found in inside.items()
        }
        for name, chosen in rows.items()
    ]


def examples(table):
    """Return the best known derivatives at the middle trim."""
    middle = table.loc[len(AIRSPEEDS) // 2]
    columns = ["value", "std", "known", "merged"]
    return [
        {"derivative": n, **middle.loc[n, columns].astype(float)}
        for n in SHOWN
        if n in middle.index
    ]


def merged_aircraft(truth, data, point):
    """Return the true aircraft as one without alpha_dot and beta_dot: linear about a trim, slopes merged."""
    regressors = [name for name in data.regressor_names if name not in ("alpha_dot", "beta_dot")]
    at = Motion(truth, data.aircraft).at(point.state, point.controls).regressors
    start, slopes = (
        pd.Series(at, data.regressor_names),
        pd.DataFrame(truth.gradient(at), columns=data.regressor_names),
    )
    merged = (
        slopes[regressors]
        + slopes[["alpha_dot", "beta_dot"]] @ slopes_of_slopes(data, regressors).T
    )
    x, y, J = start[regressors].to_numpy(), truth(at), merged.to_numpy()
    names = [f"{name}_hat" if name in RATES else name for name in regressors]
    return Aerodynamics(lambda X: y + (X - x) @ J.T, names)


def modes(model, truth, data, n_paths):
    """Return the modes at each airspeed, known, merged, and learned, the learned aircraft at its own trim."""
    rows = []
    for airspeed in AIRSPEEDS:
        own, point = (
            trim(one, data.aircraft, airspeed, altitude=ALTITUDE) for one in (model, truth)
        )
        found = linearize(model, data.aircraft, own, n_paths=n_paths).modes()
        known = linearize(truth, data.aircraft, point).modes()["eigenvalue"]
        merged = linearize(merged_aircraft(truth, data, point), data.aircraft, point).modes()[
            "eigenvalue"
        ]
        for name, root in known.items():
            row = {
                "V, m/s": airspeed,
                "mode": name,
                "known": _text(root),
                "merged": _text(merged[name]),
            }
            row |= {"learned": None, "error, %": None, "frequency std": None, "damping std": None}
            if name in found.index:
                one, pair = found.loc[name, "eigenvalue"], bool(root.imag)
                row |= {"learned": _text(one), "error, %": float(100 * abs(one / root - 1))}
                row |= {"frequency std": float(found.loc[name, "frequency_std"])}
                row |= {"damping std": float(found.loc[name, "damping_std"]) if pair else None}
            rows.append(row)
    return rows


def _text(root):
    return f"{root.real:.3f} +- {root.imag:.3f}i" if root.imag else f"{root.real:.4f}"


def learned(data, options, seed):
    """Return the pipeline, fitted."""
    model = make_identification_pipeline(data.aircraft, regressors=options.regressors)
    model.set_params(dependentgpregressor__random_state=seed)
    Y, start = aerodynamic_coefficients(data.train, data.aircraft), time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(data.train, Y if options.samples is None else thin_targets(Y, options.samples))
    print(f"seed {seed}: learned in {time.perf_counter() - start:.0f} s", flush=True)
    return model


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--samples", type=int, help="to learn from; default: all")
    parser.add_argument(
        "--seeds",
        type=int,
        nargs="+",
        default=[0, 1, 2],
        help="of gusts, sensor noise and the search",
    )
    parser.add_argument("--turbulence", type=float, default=1.0)
    parser.add_argument("--regressors", default="quasi-steady")
    options, n_paths = parser.parse_args(words), 200
    tables, roots = {}, {}
    for seed in options.seeds:
        data = load_example_flights(random_state=seed, turbulence=options.turbulence)
        model, truth = learned(data, options, seed), known_aircraft(data)
        tables[seed], roots[seed] = (
            compared(model, truth, data, n_paths),
            modes(model, truth, data, n_paths),
        )
        show(coverage({seed: tables[seed]}))
    first, *others = roots.values()
    for k, row in enumerate(first if others else ()):
        row["worst of all seeds, %"] = max(
            (rows[k]["error, %"] for rows in (first, *others)), key=lambda e: e or 0.0
        )
    finish(
        options,
        "derivatives",
        coverage=coverage(tables),
        at_36_m_per_s=examples(tables[options.seeds[0]]),
        modes=first,
    )


if __name__ == "__main__":
    main()
