"""Derivatives of aircraft of which less and less is told: are the true ones inside the bands?

    python tests/benchmarks/little_told.py [--out OUT]

`identify` learns the flights of four aircraft of JSBSim, of three kinds, and in turn one thing is
withheld: inertia and area (`Aircraft.estimate` of mass, span and kind) or the thrust. They fly as in
freeflight_air.py, 200 s in light gusts. Derivatives at the mean of the flight, over the perturbations
that were flown, are compared with those of JSBSim's own evaluations. Their bands are value +- 1.96
sqrt(std^2 + std_aircraft^2). The table has the percentage inside, the median ratio of bands to those
with everything told, and wrong signs.
"""

import numpy as np
from _common import Kept, finish, parser_of
from jsbsim_flight import (
    STEADY,
    TRAINING,
    evaluated_derivatives,
    flight_of,
    learned_derivatives,
    true_values,
)

from skdgp.dynamics import Aircraft
from skdgp.identification import identify

# Aircraft and their kinds
KINDS = {"c172p": "conventional", "c182": "conventional", "DHC6": "twin", "A4": "delta"}
WITHHELD = ("nothing", "sizes", "thrust")
REGRESSORS = STEADY[:-1]
SIGNS = [
    "CZ_alpha", "Cm_alpha", "Cm_q", "Cl_p", "Cn_beta", "Cm_elevator", "Cl_aileron", "Cn_rudder",
]  # fmt: skip
SAMPLES = 755  # to learn from
NORMAL_95 = 1.96


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


def compared(table, known):
    """Return the table with true values, bands, and how far values lie from the truth over deviations."""
    true = true_values(table, known)
    table = table.assign(true=true, band=np.hypot(table["std"], table["std_aircraft"]))
    return table.assign(off=(table["value"] - true) / table["band"])


def measured(name, kind):
    """Return for each thing withheld: percentage inside bands, width of bands, wrong signs."""
    train, aircraft = flight_of(name, *TRAINING)
    at, known = evaluated_derivatives(name, train, aircraft)
    airspeed = train["airspeed_true"].mean()
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
    options = parser_of(__doc__).parse_args(words)
    kept = Kept(options, "little_told")
    for name, kind in KINDS.items():
        kept.run({"aircraft": name}, measured, name, kind)
    runs = kept.table.set_index("aircraft")
    rows = runs[[*WITHHELD]].T.reset_index(names="withheld").to_dict("records")
    finish(options, "little_told", bands=rows)


if __name__ == "__main__":
    main()
