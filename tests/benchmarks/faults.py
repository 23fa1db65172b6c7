"""Faults put into simulated flights: how many are found, and how often is a sound channel accused?

    python tests/benchmarks/faults.py --out OUT

Sixty flights of the aircraft of small_uav.py in its airs, with ideal, real, held and vibrating
sensors in turn, and with vanes. Each sound way to record them (a recorder that smooths, sensors
ahead of the centre of gravity, without vanes, late GPS, 5 Hz) must raise nothing. Each fault is put
into each flight: signs, exchanged axes, units, gravity, axes of another convention, delays. It is
found if a contradiction, or the check of units, names a faulty channel, and accuses falsely if a
contradiction names sound channels alone. The table has for each way and each fault the flights
that could show it, and the percentages found and accused.
"""

import itertools
import warnings
from functools import partial

import numpy as np
from _common import Kept, finish, parser_of
from flight_columns import EULER, FORCES, RATES, SURFACES, VELOCITY
from log_errors import (
    GRAVITY,
    elsewhere,
    exchange,
    late,
    scale,
    without,
    without_gravity,
)
from made_flights import wrapped
from numpy.random import default_rng
from scipy import signal
from uav_flight import AIRCRAFT, AIRS, EVERY, SENSORS, STEP, fly, logged

from skdgp._flight.physics import find_contradictions
from skdgp._flight.tables import FlightTable
from skdgp._flight.units import check_flight

N_FLIGHTS = 60
SECONDS = 120.0
DEGREES = 180 / np.pi
KNOT = 0.514444
FOOT = 0.3048
VANE_NOISE, POSITION_NOISE = 0.005, 0.5  # rad, m
ARM = 0.25  # of the sensors ahead of the centre of gravity, over the span
CORNER = 2.0  # Hz, of a recorder that smooths
COMMANDS = [*SURFACES, "throttle"]


def with_vanes(flown, rng, kind):
    """Return a table of one flight with vanes, position and altitude."""
    table = logged(flown, rng, kind).drop(columns=["thrust_x", "alpha_true"])
    vanes = flown[["alpha", "beta"]]
    table[["alpha", "beta"]] = vanes + VANE_NOISE * rng.standard_normal(vanes.shape)
    place = flown[["north", "east", "altitude"]]
    table[[*place]] = place + POSITION_NOISE * rng.standard_normal(place.shape)
    return table


def smoothed(table):
    """Return a table whose sensors are smoothed without delay."""
    corner = signal.butter(2, CORNER, fs=1 / (STEP * EVERY), output="sos")
    names = [name for name in table if name not in ("time", "density", *COMMANDS)]
    values = table[names].to_numpy(copy=True)
    values[:, names.index("psi")] = np.unwrap(values[:, names.index("psi")])
    result = table.copy()
    result[names] = signal.sosfiltfilt(corner, values, axis=0)
    return result.assign(psi=wrapped(result["psi"]))


def ways(table, span):
    """Return the sound ways to record a flight, by name."""
    moved = elsewhere(table, (ARM * span, 0, 0))
    no_beta = without("beta")
    no_vanes = without("alpha", "beta")
    return {
        "as logged": table,
        "smoothed": smoothed(table),
        "sensors ahead": moved,
        "without beta": no_beta(table),
        "without vanes": no_vanes(table),
        "ahead, without beta": no_beta(moved),
        "ahead, without vanes": no_vanes(moved),
        "smoothed, ahead, without beta": no_beta(smoothed(moved)),
        "5 Hz, smoothed": smoothed(table).iloc[::10].reset_index(drop=True),
        "GPS late by 0.2 s": late(table, 0.2, VELOCITY),
        "without position": without("north", "east", "altitude")(table),
    }


def from_east(table):
    return table.assign(psi=np.pi / 2 - table["psi"])


SIGNED = ["alpha", "beta", *RATES, *FORCES, *EULER, *VELOCITY, "altitude", *SURFACES]
EXCHANGED = ["p q", "q r", "ax az", "ay az", "phi theta", "v_north v_east"]
EXCHANGED += ["elevator aileron", "alpha beta"]
SCALED = {
    "alpha in deg": (DEGREES, "alpha"),
    "beta in deg": (DEGREES, "beta"),
    "attitude in deg": (DEGREES, "phi theta psi"),
    "rates in deg/s": (DEGREES, "p q r"),
    "forces in g": (1 / GRAVITY, "ax ay az"),
    "airspeed in kt": (1 / KNOT, "airspeed"),
    "airspeed in km/h": (3.6, "airspeed"),
    "velocity in ft/s": (1 / FOOT, "v_north v_east v_down"),
    "altitude in ft": (1 / FOOT, "altitude"),
    "p at half scale": (0.5, "p"),
}
LATE = {"p": 0.8, "theta": 0.8, "v_down": 0.8, "az": 0.8, "airspeed": 2.0}


def faults():
    """Return by name what puts a fault into a table, and the channels that are wrong then."""
    puts = {}
    for name in SIGNED:
        puts[f"sign of {name}"] = (scale({name: -1.0}), [name])
    for names in EXCHANGED:
        first, second = names.split()
        puts[f"{first} and {second} exchanged"] = (exchange(first, second), [first, second])
    for name, (factor, names) in SCALED.items():
        puts[name] = (scale({names: factor}), names.split())
    for name, seconds in LATE.items():
        puts[f"{name} late by {seconds} s"] = (partial(late, seconds=seconds, names=[name]), [name])
    puts["gravity removed"] = (without_gravity, FORCES)
    puts["heading from east"] = (from_east, ["psi"])
    return puts


def named(table):
    """Return the sets of channels that checks of units and of physics name."""
    try:
        check_flight(table, ["time"])
    except ValueError as error:
        return [{name for name in table if f"'{name}'" in str(error) or f" {name}" in str(error)}]
    return [
        {*each.numbers.get("channels", ())} for each in find_contradictions(FlightTable.of(table))
    ]


def score(table, wrong):
    """Return whether a wrong channel is named, and whether sound ones alone are."""
    sets = named(table)
    is_found = any(channels & {*wrong} for channels in sets)
    accused = [sorted(channels) for channels in sets if not channels & {*wrong}]
    return {"found": is_found, "accused": accused}


def flights():
    """Yield key, table and span of the flights."""
    cases = itertools.product((91, 92), AIRCRAFT, AIRS)
    for k, (seed, name, air) in enumerate(itertools.islice(cases, N_FLIGHTS)):
        rng = default_rng([*map(ord, name + air), seed])
        plane = AIRCRAFT[name]
        kind = list(SENSORS)[k % len(SENSORS)]
        key = {"aircraft": name, "air": air, "seed": seed, "sensors": kind}
        yield (
            key,
            with_vanes(fly(plane, AIRS[air], rng, SECONDS, 0.05), rng, kind),
            plane["span"],
        )


def main(words=None):
    options = parser_of(__doc__).parse_args(words)
    warnings.simplefilter("ignore")
    kept = Kept(options, "faults")
    for key, table, span in flights():
        recorded = ways(table, span)
        for way, sound in recorded.items():
            kept.run(key | {"case": way, "kind": "sound"}, score, sound, [])
        for fault, (put, wrong) in faults().items():
            if all(table[name].nunique() > 1 for name in wrong):
                kept.run(key | {"case": fault, "kind": "fault"}, score, put(table), wrong)
        if table["rudder"].nunique() > 1:
            wrong = scale({"rudder": -1.0})(recorded["ahead, without beta"])
            case = "sign of rudder, ahead, without beta"
            kept.run(key | {"case": case, "kind": "fault"}, score, wrong, ["rudder"])
    runs = kept.table
    runs["accused"] = runs["accused"].str.len() > 0
    shares = (
        runs.groupby(["kind", "case"], sort=False)[["found", "accused"]].mean().mul(100).round(1)
    )
    shares["flights"] = runs.groupby(["kind", "case"], sort=False).size()
    finish(options, "faults", shares=shares.reset_index().to_dict("records"))


if __name__ == "__main__":
    main()
