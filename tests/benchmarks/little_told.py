"""Derivatives of aircraft of which less and less is told: are the true ones inside the bands?

    python tests/benchmarks/little_told.py ../shared/data [--out OUT] [--aircraft A] [--withheld W]

`identify` learns the flights of five aircraft, and in turn one thing is withheld: inertia and area
(`Aircraft.estimate` of mass, span and kind), the thrust, the vanes, the angles of the surfaces (in
parts of their largest deflection), or all of these. Two are of the shared data; three of JSBSim, of
three kinds, fly as in freeflight_air.py, 200 s in light gusts. Derivatives at the mean of the
flight are compared with the true ones, slopes of the polynomial of third order of the noise-free
columns; their bands are value +- 1.96 sqrt(std^2 + std_aircraft^2). "ratios" are those of the
derivatives of a coefficient to its main one, by rates in rad/s: no size is in them, so their bands
are those of the log alone. "width" is the median ratio of bands to those with everything told, "log
width" that of bands by the log of accelerations by regressors (m f / m, I^-1 M: normalised
derivatives): again without a size. The error of the held-out flight is over the spread of what was
measured there, with the same sizes.
"""

import time
import warnings

import numpy as np
from _common import finish, parsed, parser_of
from _jsbsim_flight import (
    COEFFICIENTS,
    FLOWN,
    STEADY,
    TRAINING,
    exact_regressors,
    flight_of,
    known_derivatives,
    learned_derivatives,
)

from skdgp.dynamics import Aircraft
from skdgp.identification import identify
from skdgp.io import FULL_THROW, read_flight
from skdgp.metrics import normalized_rmse

FLIGHTS = {
    "viggen_uav": ("train_latlon", "test_twoalt", "delta"),
    "c172p": ("train_latlon", "test_calm", "conventional"),
}
# Aircraft of JSBSim and their kinds
JSBSIM = {"c182": "conventional", "DHC6": "twin", "A4": "delta"}
THINGS = ("sizes", "thrust", "vanes", "angles")
WITHHELD = {
    "nothing": (),
    **{name: (name,) for name in THINGS},
    "all of these": THINGS,
}
SURFACES = ("elevator", "aileron", "rudder")
REGRESSORS = STEADY[:-1]
MAIN = dict(
    zip(COEFFICIENTS, ("alpha", "beta", "alpha", "aileron", "elevator", "beta"), strict=True)
)
SIGNS = ("CZ_alpha", "Cm_alpha", "Cm_q", "Cl_p", "Cn_beta", "Cm_elevator", "Cl_aileron")
SIGNS += ("Cn_rudder",)
HELD_OUT = 240.0  # s of the test flight
NORMAL_95 = 1.96


def subjects(options):
    """Yield name, kind, aircraft, training and test flight."""
    for name, (*parts, kind) in FLIGHTS.items():
        if name in options.aircraft:
            folder = options.data / "flights"
            flights = [read_flight(folder / f"{name}_{part}.parquet") for part in parts]
            yield name, kind, Aircraft.from_file(folder / f"{name}.json"), *flights
    for name, kind in JSBSIM.items():
        if name in options.aircraft:
            train, aircraft = flight_of(name, *TRAINING)
            yield name, kind, aircraft, train, flight_of(name, *FLOWN["light"])[0]


def withhold(things, aircraft, kind, *flights):
    """Return an aircraft and flights without some things, and the angle that is one unit of each surface [rad]."""
    units, dropped = {}, {"elevon_left", "elevon_right"}
    if "sizes" in things:
        aircraft = Aircraft.estimate(aircraft.mass, aircraft.span, kind=kind, name=aircraft.name)
    if "thrust" in things:
        dropped |= {name for name in flights[0] if name.startswith(("thrust_", "propeller"))}
    if "vanes" in things:
        dropped |= {"alpha", "beta"}
    flights = [table.drop(columns=[*dropped], errors="ignore") for table in flights]
    if "angles" in things:
        units = flights[0][[*SURFACES]].abs().max().to_dict()
        flights = [
            table.assign(**{name: table[name] / unit for name, unit in units.items()})
            for table in flights
        ]
    return aircraft, flights, units


def learned(things, aircraft, kind, train, test, at, airspeed, samples):
    """Return the table of derivatives by one radian, and the error over the spread of the test flight."""
    told, (train, test), units = withhold(things, aircraft, kind, train, test)
    reading = {"servos": FULL_THROW if units else None}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(train, told, test=test, samples=samples, reading=reading)
        told = found.aircraft  # with the deviations of vanes and thrust
        table = learned_derivatives(found.pipeline, told, at, airspeed, REGRESSORS, units)
    by = table["regressor"].map(units).fillna(1.0)
    for column in ("value", "std", *(["std_aircraft"] if told.deviations else [])):
        table[column] /= by
    table["by_rate"] = lengths_of(table, told)
    # over 2 V: of a derivative by rad/s over that by the non-dimensional rate
    sizes = np.r_[[told.mass] * 3, told.inertia.diagonal() / told.moment_lengths] / told.wing_area
    size = table["coefficient"].map(dict(zip(COEFFICIENTS, sizes, strict=True)))
    table["log_band"] = table["std"] * table["by_rate"] / size  # over qbar
    one = found.evaluations[0]
    scored = np.isfinite(one.measured).all(axis=1)
    error = normalized_rmse(one.measured[scored], one.mean[scored])
    return table.assign(std_aircraft=table.get("std_aircraft", 0.0)), float(error)


def lengths_of(table, aircraft):
    lengths = dict(zip("pqr", aircraft.moment_lengths, strict=True))
    return table["regressor"].map(lengths).fillna(1.0)


def compared(table, known, aircraft):
    """Return the table with true values, bands, and how far values and ratios lie from the truth over deviations."""
    true = np.array([known.loc[row.coefficient, row.regressor] for row in table.itertuples()])
    table = table.assign(true=true, band=np.hypot(table["std"], table["std_aircraft"]))
    table["off"] = (table["value"] - true) / table["band"]
    plain = table[["value", "std"]].mul(table["by_rate"], axis=0)
    plain["true"] = true * lengths_of(table, aircraft)
    main = plain.loc[[f"{name}_{MAIN[name]}" for name in table["coefficient"]]]
    main = main.set_axis(table.index)
    # a / b = A / B without a division by what may be small: a B = b A
    error = plain["value"] * main["true"] - main["value"] * plain["true"]
    spread = np.hypot(plain["std"] * main["true"], main["std"] * plain["true"])
    table["off_ratio"] = (error / spread).mask(table["regressor"] == table["coefficient"].map(MAIN))
    return table


def row_of(name, withheld, table, told, error):
    """Return a row of the table of results."""
    ratios = table["off_ratio"].dropna()
    wrong = [one for one in SIGNS if table.loc[one, "value"] * table.loc[one, "true"] <= 0]
    return {
        "aircraft": name,
        "withheld": withheld,
        "inside, %": float(100 * (table["off"].abs() < NORMAL_95).mean()),
        "ratios inside, %": float(100 * (ratios.abs() < NORMAL_95).mean()),
        "width": float((table["band"] / told["band"]).median()),
        "log width": float((table["log_band"] / told["log_band"]).median()),
        "error over spread": float(error),
        "wrong signs": ", ".join(wrong) or "none",
    }


def main(words=None):
    parser = parser_of(__doc__, data=True)
    parser.add_argument("--samples", type=int, default=755, help="to learn from")
    names = [*FLIGHTS, *JSBSIM]
    parser.add_argument("--aircraft", nargs="+", choices=names, default=names)
    parser.add_argument("--withheld", nargs="+", choices=WITHHELD, default=[*WITHHELD])
    options, rows = parsed(parser, words), []
    for name, kind, aircraft, train, test in subjects(options):
        at = exact_regressors(train, aircraft).mean(axis=0)
        known = known_derivatives([train, test], aircraft, at)
        airspeed, told = float(train["airspeed_true"].mean()), None
        test = test[test["time"] < test["time"].iloc[0] + HELD_OUT]
        for withheld in dict.fromkeys(["nothing", *options.withheld]):
            start, flights = time.perf_counter(), (train, test, at, airspeed)
            table, error = learned(WITHHELD[withheld], aircraft, kind, *flights, options.samples)
            table = compared(table, known, aircraft)
            told = table if told is None else told
            rows.append(row_of(name, withheld, table, told, error))
            print(f"{time.perf_counter() - start:.0f} s: {rows[-1]}", flush=True)
    finish(options, "little_told", bands=rows)


if __name__ == "__main__":
    main()
