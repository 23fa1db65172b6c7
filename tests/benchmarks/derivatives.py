"""Stability derivatives and modes of the example aircraft, learned from its flights, beside the known ones.

    python tests/benchmarks/derivatives.py [--out OUT]

The default pipeline learns from both training flights. At three level trims of the true aircraft
each derivative is compared with the known one over the same perturbation, and the modes of the
learned aircraft at its own trims with those of the true one.

Gusts: value over the known derivative by models of flights in calm, light and moderate air, of the
example aircraft at the middle trim and of JSBSim's Cessna 172 at the mean of its flight.
"""

from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from freeflight_air import learned
from jsbsim_flight import (
    evaluated_derivatives,
    flight_of,
    learned_derivatives,
)
from made_outputs import slopes_over

from skdgp import make_identification_pipeline
from skdgp.datasets import load_example_flights
from skdgp.dynamics import (
    aerodynamic_coefficients,
    as_aerodynamics,
    linearize,
    stability_derivatives,
    trim,
)

AIRS = {"calm": 0.0, "light": 1.0, "moderate": 2.0}  # in parts of the usual turbulence
AIRSPEEDS = (32.0, 36.0, 40.0)
ALTITUDE = 220.0
NODES = 9  # of Gauss-Hermite quadrature
SHOWN = ("CL_alpha", "Cm_alpha", "Cm_q", "Cl_p", "Cn_beta", "Cn_r", "CY_rudder", "Cm_elevator")


def over_perturbation(truth, model):
    """Return the truth with slopes over the perturbation that the model flew, by quadrature.

    They are expected for each regressor alone, normal about the trim, as in `stability_derivatives`.
    """
    learned_from = as_aerodynamics(model)
    flown = dict(zip(learned_from.regressors, learned_from.perturbation, strict=True))
    spread = [flown.get(name, 0.0) for name in truth.regressors]
    return replace(truth, slopes=partial(slopes_over, truth.gradient, spread=spread, n_nodes=NODES))


def compared(model, truth, data, airspeed):
    """Return all derivatives at a trim, learned and known."""
    at_trim = trim(truth, data.aircraft, airspeed, altitude=ALTITUDE)
    table = stability_derivatives(model, data.aircraft, at_trim)
    known = stability_derivatives(truth, data.aircraft, at_trim)["value"]
    table = table[table["regressor"] != ""]
    return table.assign(known=known.reindex(table.index).fillna(0.0))  # by throttle


def coverage(table):
    """Return the percentage of the derivatives in body axes within two standard deviations."""
    table = table[~table["coefficient"].isin(["CL", "CD"])]
    off = np.abs(table["value"] - table["known"])
    inside = off < 2 * np.hypot(table["std"], table["std_merged"])
    alone = off < 2 * table["std_posterior"]
    return {
        "derivatives": len(table),
        "within 2 std of known, %": 100 * inside.mean(),
        "within 2 std of known, posterior alone, %": 100 * alone.mean(),
    }


def modes(model, truth, aircraft):
    """Return the largest error of each mode, the learned aircraft at its own trims."""
    rows = {}
    for airspeed in AIRSPEEDS:
        known, found = (
            linearize(one, aircraft, trim(one, aircraft, airspeed, altitude=ALTITUDE)).modes()
            for one in (truth, model)
        )
        for name, root in known["eigenvalue"].items():
            error = 100 * abs(found["eigenvalue"].get(name, np.nan) / root - 1)
            rows.setdefault(name, []).append(error)
    return [{"mode": name, "largest error, %": max(each)} for name, each in rows.items()]


def cessna(air):
    """Return derivatives of the Cessna 172 over the known ones, learned in this air."""
    flight = (1, air, int(air != "calm"))
    model, aircraft = learned("c172p", flight)
    log = flight_of("c172p", *flight)[0]
    at, known = evaluated_derivatives("c172p", log, aircraft)
    table = learned_derivatives(model[-3:], aircraft, at, log["airspeed_true"].mean())
    return {
        f"{C}_{x}, Cessna 172": table.loc[f"{C}_{x}", "value"] / known.loc[C, x]
        for C, x in (("Cl", "p"), ("Cm", "alpha"))
    }


def measured(air):
    """Return the tables of the example aircraft, learned in this air, and slopes of both."""
    data = load_example_flights(turbulence=AIRS[air])
    model = make_identification_pipeline(data.aircraft)
    model.set_params(dependentgpregressor__random_state=0)
    model.fit(data.train, aerodynamic_coefficients(data.train, data.aircraft))
    truth = over_perturbation(data.truth, model)
    tables = {airspeed: compared(model, truth, data, airspeed) for airspeed in AIRSPEEDS}
    middle = tables[36.0]
    shown = middle.loc[[*SHOWN], ["value", "std", "known"]]
    slopes = {"Cl_p, example aircraft": middle.loc["Cl_p", "value"] / middle.loc["Cl_p", "known"]}
    return {
        "over": slopes | cessna(air),
        "coverage": [coverage(pd.concat(tables))],
        "at_36_m_per_s": [{"derivative": name, **row} for name, row in shown.iterrows()],
        "modes": modes(model, truth, data.aircraft),
    }


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    kept = Kept(options, "derivatives")
    runs = {air: kept.run({"air": air}, measured, air) for air in AIRS}
    gusts = pd.DataFrame({air: run["over"] for air, run in runs.items()})
    gusts = gusts.reset_index(names="over the known derivative").to_dict("records")
    usual = {name: runs["light"][name] for name in ("coverage", "at_36_m_per_s", "modes")}
    finish(options, "derivatives", gusts=gusts, **usual)


if __name__ == "__main__":
    main()
