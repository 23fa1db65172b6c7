"""Stability derivatives and modes of the example aircraft, learned from its flights, beside the known ones.

    python tests/benchmarks/derivatives.py [--out OUT] [--seed 0]

The default pipeline learns from both training flights. At three level trims of the true aircraft
each derivative is compared with the known one, and the modes of the learned aircraft at its own
trims with those of the true one.

A model without alpha_dot and beta_dot gives other regressors what these do, as far as they went
together: what the data hold is the known derivative plus that by alpha_dot times the slope of
alpha_dot by the regressor, here of least squares on the noise-free columns of the training flights,
for scoring alone. These are the "merged" ones.
"""

import warnings

import numpy as np
import pandas as pd
from _common import finish, parser_of
from sklearn.exceptions import ConvergenceWarning

from skdgp import make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    Aerodynamics,
    aerodynamic_coefficients,
    linearize,
    stability_derivatives,
    trim,
)

AIRSPEEDS, ALTITUDE = (32.0, 36.0, 40.0), 220.0
RATES = ("p", "q", "r", "alpha_dot", "beta_dot")
SHOWN = ("CL_alpha", "Cm_alpha", "Cm_q", "Cl_p", "Cn_beta", "Cn_r", "CY_rudder", "Cm_elevator")


def slopes_of_slopes(data, regressors):
    """Return d (alpha_dot, beta_dot) / d regressors over the training flights, all rates non-dimensional."""
    train, aircraft = data.train, data.aircraft
    lengths = (*aircraft.moment_lengths, aircraft.chord, aircraft.span)
    lengths = dict(zip(RATES, lengths, strict=True))

    def column(name):
        values = train.get(f"{name}_true", train.get(name))
        return values * lengths[name] / (2 * train["airspeed_true"]) if name in lengths else values

    X = np.column_stack([np.ones(len(train)), *map(column, regressors)])
    slopes = np.linalg.lstsq(X, np.column_stack([*map(column, RATES[3:])]), rcond=None)[0][1:]
    return pd.DataFrame(slopes, regressors, RATES[3:])


def compared(model, truth, data):
    """Return all derivatives at the trims, learned and known."""
    trims = trim(truth, data.aircraft, AIRSPEEDS, altitude=ALTITUDE)
    table = stability_derivatives(model, data.aircraft, trims)
    table = table[table["regressor"] != ""].copy()
    known = stability_derivatives(truth, data.aircraft, trims)["value"]
    slopes = slopes_of_slopes(data, list(table["regressor"].unique()))
    table["known"] = known.reindex(table.index).fillna(0.0)  # by throttle
    table["merged"] = table["known"]
    for rate in slopes:
        by_rate = [
            known[point, f"{name}_{rate}"] for (point, _), name in table["coefficient"].items()
        ]
        table["merged"] += by_rate * table["regressor"].map(slopes[rate])
    return table


def coverage(table):
    """Return the percentage of the derivatives in body axes within two standard deviations."""
    table = table[~table["coefficient"].isin(["CL", "CD"])]
    table = table.assign(std_known=np.hypot(table["std"], table["std_merged"]))
    kinds = {"known": "std_known", "merged": "std", "known, posterior alone": "std_posterior"}
    row = {"derivatives": len(table)}
    for kind, std in kinds.items():
        off = np.abs(table["value"] - table[kind.partition(",")[0]])
        row[f"within 2 std of {kind}, %"] = 100 * float((off < 2 * table[std]).mean())
    return row


def modes(model, truth, aircraft):
    """Return the modes at each airspeed, known and learned, the learned aircraft at its own trim."""
    rows = []
    for airspeed in AIRSPEEDS:
        known, found = (
            linearize(one, aircraft, trim(one, aircraft, airspeed, altitude=ALTITUDE)).modes()
            for one in (truth, model)
        )
        for name, root in known["eigenvalue"].items():
            value = found["eigenvalue"].get(name, np.nan)
            row = {"V, m/s": airspeed, "mode": name, "known": f"{root:.3f}"}
            rows.append(row | {"learned": f"{value:.3f}", "error, %": 100 * abs(value / root - 1)})
    return rows


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--seed", type=int, default=0, help="of gusts, sensor noise and the search")
    options = parser.parse_args(words)
    data = load_example_flights(random_state=options.seed)
    names = [f"{name}_hat" if name in RATES else name for name in data.regressor_names]
    truth = Aerodynamics(data.aerodynamics, names)
    model = make_identification_pipeline(data.aircraft)
    model.set_params(dependentgpregressor__random_state=options.seed)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        model.fit(data.train, aerodynamic_coefficients(data.train, data.aircraft))
    table = compared(model, truth, data)
    middle = table.loc[AIRSPEEDS.index(36.0)].loc[[*SHOWN], ["value", "std", "known", "merged"]]
    shown = [{"derivative": name, **row.astype(float)} for name, row in middle.iterrows()]
    tables = {"coverage": [coverage(table)], "at_36_m_per_s": shown}
    finish(options, "derivatives", **tables, modes=modes(model, truth, data.aircraft))


if __name__ == "__main__":
    main()
