"""Derivatives of aircraft of which less and less is told: are the true ones inside the bands?

    python tests/benchmarks/little_told.py ../shared/data [--out FOLDER] [--samples 755]

`identify` learns the flights of five aircraft, and in turn one thing is withheld: inertia and area
(`Aircraft.estimate` of mass, span and kind), the thrust, the vanes, the angles of the surfaces (in
parts of their largest deflection), or all of these; and the airspeed alone, which is then that of
turns. Two are of the shared data; three of JSBSim, of three kinds, fly as in freeflight_air.py, 200
s in light gusts. Derivatives at the mean of the flight are compared with the true ones, slopes of
the polynomial of third order of the noise-free columns; their bands are value +- 1.96 sqrt(std^2 +
std_aircraft^2). "ratios" are those of the derivatives of a coefficient to its main one, by rates in
rad/s: no size is in them, so their bands are those of the log alone. "width" is the median ratio of
bands to those with everything told, "log width" that of bands by the log of accelerations by
regressors (m f / m, I^-1 M: normalised derivatives): again without a size. The error of the
held-out flight is over the spread of what was measured there, with the same sizes.
"""

import time
import warnings

import numpy as np
import pandas as pd
from _common import finish, parsed, parser_of
from _study_flights import (
    NAMES,
    ROTATION,
    exact_regressors,
    hats,
    milspec_rates,
    slopes_of_third_order,
)
from freeflight_air import FLOWN, TRAINING, flight_of

from skdgp._flight.channels import COEFFICIENTS, RATE_LENGTHS, TRUTH_SUFFIX
from skdgp.dynamics import Aircraft, air_velocity, stability_derivatives
from skdgp.identification import identify
from skdgp.io import FULL_THROW, read_flight
from skdgp.metrics import normalized_rmse

FLIGHTS = {
    "viggen_uav": ("train_latlon", "test_twoalt", "delta"),
    "c172p": ("train_latlon", "test_calm", "conventional"),
}
JSBSIM = {"c182": "conventional", "DHC6": "twin", "A4": "delta"}
"""Aircraft of JSBSim and their kinds: a single propeller, twin propellers, a jet with a delta wing
and a tail.
"""
THINGS = ("sizes", "thrust", "vanes", "angles")
WITHHELD = {
    "nothing": (),
    **{name: (name,) for name in THINGS},
    "all of these": THINGS,
    "airspeed": ("airspeed",),
}
SURFACES = ("elevator", "aileron", "rudder")
REGRESSORS = ("alpha", "beta", "p", "q", "r", *SURFACES)
MAIN = dict(
    zip(COEFFICIENTS, ("alpha", "beta", "alpha", "aileron", "elevator", "beta"), strict=True)
)
SIGNS = (
    "CZ_alpha",
    "Cm_alpha",
    "Cm_q",
    "Cl_p",
    "Cn_beta",
    "Cm_elevator",
    "Cl_aileron",
    "Cn_rudder",
)
HELD_OUT = 240.0  # s of the test flight
NORMAL_95 = 1.96


def subjects(options):
    """Yield name, kind, aircraft, training and test flight."""
    for name, (train, test, kind) in FLIGHTS.items():
        if not options.aircraft or name in options.aircraft:
            read = [
                read_flight(options.data / "flights" / f"{name}_{part}.parquet")
                for part in (train, test)
            ]
            yield name, kind, Aircraft.from_json(options.data / "flights" / f"{name}.json"), *read
    for name, kind in JSBSIM.items():
        if not options.aircraft or name in options.aircraft:
            (train, aircraft), (test, _) = (
                flight_of(name, *flight) for flight in (TRAINING, FLOWN["light"])
            )
            yield name, kind, aircraft, train, test


def withhold(things, aircraft, kind, *flights):
    """Return an aircraft and flights without some things, and the angle that is one unit of each surface [rad]."""
    flights, units = (
        [table.drop(columns=["elevon_left", "elevon_right"], errors="ignore") for table in flights],
        {},
    )
    if "sizes" in things:
        aircraft = Aircraft.estimate(aircraft.mass, aircraft.span, kind=kind, name=aircraft.name)
    if "thrust" in things:
        flights = [
            table.drop(columns=[n for n in table if n.startswith(("thrust_", "propeller"))])
            for table in flights
        ]
    if "airspeed" in things:
        flights = [table.drop(columns="airspeed") for table in flights]
    if "vanes" in things:
        flights = [table.drop(columns=["alpha", "beta"]) for table in flights]
    if "angles" in things:
        units = flights[0][[*SURFACES]].abs().max().to_dict()
        flights = [
            table.assign(**{name: table[name] / unit for name, unit in units.items()})
            for table in flights
        ]
    return aircraft, flights, units


def truth_of(aircraft, *flights):
    """Return the mean of the regressors of the first flight, by name, and the true derivatives there, by name."""
    felt, truth = [], []
    for table in flights:
        exact, felt_rates = exact_regressors(table, aircraft), [f"{rate}_felt" for rate in "pqr"]
        if {*felt_rates} <= {*table}:
            exact[:, ROTATION] = table[felt_rates].to_numpy() * hats(table, aircraft)
        else:
            exact[:, ROTATION] -= milspec_rates(table, aircraft.span)[0] * hats(table, aircraft)
        felt.append(exact)
        truth.append(table[[name + TRUTH_SUFFIX for name in COEFFICIENTS]].to_numpy())
    at = felt[0].mean(axis=0)
    slopes = slopes_of_third_order(np.concatenate(felt), np.concatenate(truth), at)
    return dict(zip(NAMES, at, strict=True)), pd.DataFrame(slopes, COEFFICIENTS, NAMES)


def state_at(at, airspeed, aircraft):
    """Return the state of 13 numbers with these regressors, wings level."""
    rates = [at[name] * 2 * airspeed / getattr(aircraft, RATE_LENGTHS[name]) for name in "pqr"]
    return np.r_[
        0.0, 0.0, 0.0, air_velocity(airspeed, at["alpha"], at["beta"]), 1.0, 0.0, 0.0, 0.0, rates
    ]


def derivatives(things, aircraft, kind, train, test, at, airspeed, options):
    """Return the table of derivatives by one radian, and the error over the spread of the test flight."""
    told, (train, test), units = withhold(things, aircraft, kind, train, test)
    servos = FULL_THROW if units else None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        found = identify(
            train, told, test=test, samples=options.samples, reading={"servos": servos}
        )
        controls = {name: at[name] / units.get(name, 1.0) for name in (*SURFACES, "throttle")}
        state = state_at(at, airspeed, aircraft)
        told = found.aircraft  # with the deviations of vanes, airspeed and thrust
        table = stability_derivatives(
            found.pipeline, told, state, controls, thrust=None, n_paths=options.paths
        )
    table = table[
        table["regressor"].isin(REGRESSORS) & table["coefficient"].isin(COEFFICIENTS)
    ].copy()
    by = table["regressor"].map(units).fillna(1.0)
    for column in ("value", "std", *(["std_aircraft"] if told.deviations else [])):
        table[column] /= by
    lengths = table["regressor"].map(
        {name: getattr(told, length) for name, length in RATE_LENGTHS.items()}
    )
    table["by_rate"] = lengths.fillna(
        1.0
    )  # over 2 V: of a derivative by rad/s over that by the non-dimensional rate
    sizes = [*[told.mass] * 3, *(told.inertia.diagonal() / told.moment_lengths)] / np.float64(
        told.wing_area
    )
    accelerations = (
        table["std"]
        * table["by_rate"]
        / table["coefficient"].map(dict(zip(COEFFICIENTS, sizes, strict=True)))
    )
    table["log_band"] = accelerations  # over qbar
    one = found.evaluations[0]
    scored = np.isfinite(one.measured).all(axis=1)
    return table.assign(std_aircraft=table.get("std_aircraft", 0.0)), normalized_rmse(
        one.measured[scored], one.mean[scored]
    )


def compared(table, known, aircraft):
    """Return the table with true values, bands, and how far values and ratios lie from the truth over deviations."""
    true = np.array([known.loc[row.coefficient, row.regressor] for row in table.itertuples()])
    lengths = table["regressor"].map(
        {name: getattr(aircraft, length) for name, length in RATE_LENGTHS.items()}
    )
    table = table.assign(true=true, band=np.hypot(table["std"], table["std_aircraft"]))
    table["off"] = (table["value"] - true) / table["band"]
    plain = pd.DataFrame(
        {"value": table["value"] * table["by_rate"], "std": table["std"] * table["by_rate"]}
    )
    plain["true"] = true * lengths.fillna(1.0)
    main = plain.loc[[f"{name}_{MAIN[name]}" for name in table["coefficient"]]].set_axis(
        table.index
    )
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
    parser.add_argument("--aircraft", nargs="*", choices=[*FLIGHTS, *JSBSIM], help="by default all")
    parser.add_argument(
        "--withheld", nargs="*", choices=WITHHELD, help="beside nothing; by default each in turn"
    )
    options = parsed(parser, words)
    options.paths = 200
    rows, outside = [], []
    for name, kind, aircraft, train, test in subjects(options):
        at, known = truth_of(aircraft, train, test)
        airspeed, test = (
            float(train["airspeed_true"].mean()),
            test[test["time"] < test["time"].iloc[0] + HELD_OUT],
        )
        told = None
        for withheld, things in WITHHELD.items():
            if (
                told is not None
                and options.withheld is not None
                and withheld not in options.withheld
            ):
                continue
            start = time.perf_counter()
            table, error = derivatives(things, aircraft, kind, train, test, at, airspeed, options)
            table = compared(table, known, aircraft)
            told = table if told is None else told
            rows.append(row_of(name, withheld, table, told, error))
            print(f"{time.perf_counter() - start:.0f} s: {rows[-1]}", flush=True)
            far = table[table[["off", "off_ratio"]].abs().max(axis=1) > NORMAL_95]
            columns = ["value", "std", "std_aircraft", "true", "off", "off_ratio"]
            outside += [
                {"aircraft": name, "withheld": withheld, "derivative": one, **row.astype(float)}
                for one, row in far[columns].iterrows()
            ]
    finish(options, "little_told", bands=rows, outside=outside)


if __name__ == "__main__":
    main()
