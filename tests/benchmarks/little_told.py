"""Derivatives of aircraft of which less and less is told: are the true ones inside the bands?

    python tests/benchmarks/little_told.py ../shared/data [--out OUT]

`identify` learns the flights of five aircraft, and in turn one thing is withheld: inertia and area
(`Aircraft.estimate` of mass, span and kind) or the thrust. One is of the shared data; four of
JSBSim, of three kinds, fly as in freeflight_air.py, 200 s in light gusts. Derivatives at the mean
of the flight, over the perturbations that were flown, are compared with the true ones: those of
JSBSim's own evaluations, and of viggen_uav the slopes of the polynomial of third order of the
noise-free columns. Their bands are value +- 1.96 sqrt(std^2 + std_aircraft^2). The table has the
percentage inside, the median ratio of bands to those with everything told, and wrong signs.
"""

import numpy as np
from _common import Kept, finish, parser_of
from _inputs import task_of
from jsbsim_flight import (
    FLOWN,
    STEADY,
    TRAINING,
    evaluated_derivatives,
    exact_regressors,
    flight_of,
    known_derivatives,
    learned_derivatives,
    true_values,
)

from skdgp.dynamics import Aircraft
from skdgp.identification import identify

# Inputs and kinds
FLIGHTS = {"viggen_uav": ("viggen", "delta")}
# Aircraft of JSBSim and their kinds
JSBSIM = {"c172p": "conventional", "c182": "conventional", "DHC6": "twin", "A4": "delta"}
WITHHELD = ("nothing", "sizes", "thrust")
REGRESSORS = STEADY[:-1]
SIGNS = (
    *("CZ_alpha", "Cm_alpha", "Cm_q", "Cl_p"),
    *("Cn_beta", "Cm_elevator", "Cl_aileron", "Cn_rudder"),
)
SAMPLES = 755  # to learn from
NORMAL_95 = 1.96


def subject(name, folder):
    """Return kind, aircraft, training and test flight."""
    if name in JSBSIM:
        train, aircraft = flight_of(name, *TRAINING)
        return JSBSIM[name], aircraft, train, flight_of(name, *FLOWN["light"])[0]
    input_name, kind = FLIGHTS[name]
    task = task_of(input_name, folder)
    return kind, task.aircraft, task.train, task.test


def withhold(thing, aircraft, kind, flight):
    """Return an aircraft and a flight without one thing."""
    dropped = ["elevon_left", "elevon_right"]
    if thing == "sizes":
        aircraft = Aircraft.estimate(aircraft.mass, aircraft.span, kind=kind, name=aircraft.name)
    if thing == "thrust":
        dropped += [name for name in flight if name.startswith(("thrust_", "propeller"))]
    return aircraft, flight.drop(columns=dropped, errors="ignore")


def learned(thing, aircraft, kind, train, at, airspeed):
    """Return the table of derivatives."""
    told, train = withhold(thing, aircraft, kind, train)
    found = identify(train, told, samples=SAMPLES)
    # its aircraft has the deviation of thrust
    table = learned_derivatives(found.pipeline, found.aircraft, at, airspeed, REGRESSORS)
    return table.assign(std_aircraft=table.get("std_aircraft", 0.0))


def true_derivatives(name, flights, aircraft, at):
    """Return the derivatives to compare with, by coefficient and regressor."""
    if name in JSBSIM:
        return evaluated_derivatives(name, flights[0], aircraft, at)
    return known_derivatives(flights, aircraft, at)


def compared(table, known):
    """Return the table with true values, bands, and how far values lie from the truth over deviations."""
    true = true_values(table, known)
    table = table.assign(true=true, band=np.hypot(table["std"], table["std_aircraft"]))
    return table.assign(off=(table["value"] - true) / table["band"])


def measured(name, folder):
    """Return for each thing withheld: percentage inside bands, width of bands, wrong signs."""
    kind, aircraft, train, test = subject(name, folder)
    at = exact_regressors(train, aircraft).mean(axis=0)
    known = true_derivatives(name, [train, test], aircraft, at)
    airspeed = float(train["airspeed_true"].mean())
    result = {}
    tables = {
        thing: compared(learned(thing, aircraft, kind, train, at, airspeed), known)
        for thing in WITHHELD
    }
    for withheld, table in tables.items():
        inside = 100 * (table["off"].abs() < NORMAL_95).mean()
        wrong = [one for one in SIGNS if table.loc[one, "value"] * table.loc[one, "true"] <= 0]
        text = f"{inside:.0f} %, {(table['band'] / tables['nothing']['band']).median():.2f}"
        result[withheld] = f"{text}, wrong {' '.join(wrong)}" if wrong else text
    return result


def main(words=None):
    options = parser_of(__doc__, data=True).parse_args(words)
    kept = Kept(options, "little_told")
    for name in [*FLIGHTS, *JSBSIM]:
        kept.run({"aircraft": name}, measured, name, options.data)
    runs = kept.table.set_index("aircraft")
    rows = runs[[*WITHHELD]].T.reset_index(names="withheld").to_dict("records")
    finish(options, "little_told", bands=rows)


if __name__ == "__main__":
    main()
