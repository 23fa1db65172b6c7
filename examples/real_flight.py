"""
Learn from a real flight
========================

Learn a model from a public log of a small aircraft, and compare derivatives with published ones::

    python examples/real_flight.py

The log is flight 75 of Thor, an Ultra Stick 25e of the University of Minnesota (1.96 kg, span
1.27 m), with vanes. The example fetches it (3.8 MB) from `NorthStarUAS/insgnss_tools
<https://github.com/NorthStarUAS/insgnss_tools>`_ (MIT licence), or says that it cannot; ``--log
FILE`` reads a copy. Sizes and published derivatives are from ``UltraStick25e_config.m`` of
`UASLab/OpenFlight <https://github.com/UASLab/OpenFlight>`_.

An autopilot flies a square, without manoeuvres: 95 % bands hold 96 % of the coefficients of the last
third, but derivatives have standard deviations as large as their values, and Cm_alpha is too small.
Fly manoeuvres for derivatives. It takes one to three minutes. Needs matplotlib: pip install
"skdgp[plot]".
"""

import argparse
import hashlib
import http.client
import urllib.request
from pathlib import Path

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from scipy.io import loadmat

from skdgp.dynamics import Aircraft, standard_density
from skdgp.identification import identify
from skdgp.plotting import TimeHistoryDisplay

ADDRESS = (
    "https://raw.githubusercontent.com/NorthStarUAS/insgnss_tools/"
    "0b5f6b16f00997baa5e02f85d1959355aa2a4c82/flight_data/"
    "thor_flight75_WaypointTracker_150squareWaypointNew_2012_10_10.mat"
)
SHA256 = "d87340d8a5ab2bbc0121e73521bb68bfc9042786c78329d965c5aca6d0431675"
AIRCRAFT = Aircraft(
    name="Thor",
    mass=1.959,
    inertia=np.diag([0.0715, 0.0864, 0.1536]),  # the published Ixz contradicts the moments
    wing_area=0.3097,
    span=1.27,
    chord=0.25,
)
PUBLISHED = {"Cm_alpha": -0.723, "Cm_q": -13.6, "Cm_elevator": -0.849, "CY_beta": -0.489}
PUBLISHED |= {"Cl_p": -0.450, "Cl_beta": -0.0545, "Cl_aileron": 0.165, "Cn_beta": 0.0723}
PUBLISHED |= {"Cn_r": -0.183, "Cn_rudder": -0.181}
CHANNELS = {"airspeed": "ias", "alpha": "aoa", "beta": "aos", "altitude": "alt"}
CHANNELS |= {"v_north": "navvn", "v_east": "navve", "v_down": "navvd"}
CHANNELS |= {name: name for name in ("ax", "ay", "az", "p", "q", "r", "phi", "theta", "psi")}


def fetched(path):
    """Fetch the log to ``path`` unless it is there; return None where there is no network."""
    if not path.exists():
        try:
            with urllib.request.urlopen(ADDRESS, timeout=30) as answer:
                content = answer.read()
        except (OSError, http.client.HTTPException) as error:
            print(f"No log ({error}). Fetch it from\n{ADDRESS}\nand give --log FILE.")
            return None
        path.write_bytes(content)
    if hashlib.sha256(path.read_bytes()).hexdigest() != SHA256:
        raise SystemExit(f"{path} is not the log that this example expects: delete it.")
    return path


def flight_table(path):
    """Return the flight as a table with the names, units and signs of the package."""
    log = loadmat(path, squeeze_me=True, struct_as_record=False)["flight_data"]
    table = pd.DataFrame({name: getattr(log, theirs) for name, theirs in CHANNELS.items()})
    table.insert(0, "time", log.time.round(3))
    table["density"] = standard_density(table["altitude"])
    table["airspeed"] *= np.sqrt(1.225 / table["density"])  # from indicated to true airspeed
    table["psi"] = np.angle(np.exp(1j * table["psi"]))
    by_pilot = log.mode == 1  # else the autopilot moves the surfaces
    moved = {
        name: np.where(by_pilot, getattr(log, f"{name}_in"), getattr(log, name))
        for name in ("de", "da_l", "da_r", "dr", "dthr")
    }
    table["elevator"], table["rudder"], table["throttle"] = moved["de"], moved["dr"], moved["dthr"]
    table["aileron"] = (moved["da_l"] - moved["da_r"]) / 2
    flying = np.flatnonzero((log.ias > 10) & (log.h > 15))
    return table.iloc[flying[0] : flying[-1]].reset_index(drop=True)


def main(arguments=None):
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--log", type=Path, help="a copy of the log (default: fetch it)")
    parser.add_argument(
        "--samples", type=int, default=None, help="rows to learn from (default: all)"
    )
    parser.add_argument(
        "--output", default="real_flight.png", help="the picture (default: %(default)s)"
    )
    options = parser.parse_args(arguments)
    log = fetched(options.log or Path("thor_flight75.mat"))
    if log is None:
        return

    flight = flight_table(log)
    last = flight["time"] > flight["time"].quantile(2 / 3)
    train = flight[~last].assign(flight="first part")
    test = flight[last].assign(flight="last third")
    result = identify(train, AIRCRAFT, test=test, thrust=None, samples=options.samples)
    print(result.summary())
    table = result.mechanics.derivatives.loc[list(PUBLISHED), ["value", "std"]]
    print(table.assign(published=pd.Series(PUBLISHED)).round(3))
    (part,) = result.evaluations
    figure = Figure(figsize=(10, 6.5), layout="constrained")
    rows = slice(0, 750)  # 15 s
    TimeHistoryDisplay.from_predictions(
        part.time[rows], part.measured[rows], part.mean[rows], part.measured_std[rows], ax=figure
    )
    figure.suptitle("Thor, flight 75: coefficients of the last third, which the model has not seen")
    figure.savefig(options.output, dpi=150)
    print(options.output)


if __name__ == "__main__":
    main()
