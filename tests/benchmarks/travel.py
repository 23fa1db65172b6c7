"""Exports flown by JSBSim beside this package's simulation.

    python tests/benchmarks/travel.py results/model.joblib [--airspeed 40] [--out FOLDER]

Needs JSBSim (``pip install jsbsim``). Coefficients at points of the flown envelope, in functions and in tables, and a
flight of 60 s with doublets from a trim, over an Earth without rotation and curvature, as in ``simulate``.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
from _common import finish, parser_of

from skdgp.dynamics import as_aerodynamics, simulate, trim
from skdgp.export import write_jsbsim
from skdgp.export._build_up import Posterior
from skdgp.identification import load_model

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
COEFFICIENTS = ["CX", "CY", "CZ", "Cl", "Cm", "Cn"]
SURFACES = ("elevator", "aileron", "rudder")
RADIUS = 1e9  # of an Earth that is flat over the flight [m]
PLANET = f"""<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">{RADIUS}</semimajor_axis><semiminor_axis unit="M">{RADIUS}</semiminor_axis>
<rotation_rate unit="RAD/SEC">0.0</rotation_rate><GM unit="M3/SEC2">{9.80665 * RADIUS**2}</GM><J2>0.0</J2></planet>
"""
RATE = 200  # Hz
COMPARED = ("airspeed", "alpha", "beta", "phi", "theta", "p", "q", "r", "altitude")


def loaded(folder, name):
    import jsbsim

    fdm = jsbsim.FGFDMExec(str(folder))
    fdm.set_debug_level(0)
    planet = Path(folder) / "flat.xml"
    planet.write_text(PLANET)
    fdm.load_planet(str(planet), False)
    fdm.load_model(name)
    fdm.set_dt(1.0 / RATE)
    return fdm


def set_state(fdm, state):
    """Set the initial conditions of a row of a flight."""
    fdm["ic/h-sl-ft"], fdm["ic/vt-fps"] = state["altitude"] / FOOT, state["airspeed"] / FOOT
    for name in ("alpha", "beta", "phi", "theta", "psi"):  # alpha moves theta
        fdm[f"ic/{name}-rad" if name != "psi" else "ic/psi-true-rad"] = state.get(name, 0.0)
    for name in "pqr":
        fdm[f"ic/{name}-rad_sec"] = state.get(name, 0.0)


def set_controls(fdm, controls, largest):
    for name in SURFACES:
        if name in largest:
            fdm[f"fcs/{name}-cmd-norm"] = controls[name] / largest[name]
    fdm["fcs/throttle-cmd-norm"] = controls.get("throttle", 0.0)
    fdm["external_reactions/thrust/magnitude"] = controls.get("thrust", 0.0) / POUND_FORCE


def coefficients(fdm, X, names, aircraft, largest, airspeed):
    """Return JSBSim's coefficients (n, 6) at regressors."""
    found = np.empty((len(X), 6))
    lengths = {"p_hat": aircraft.span, "q_hat": aircraft.chord, "r_hat": aircraft.span}
    for k, row in enumerate(X):
        values = dict(zip(names, row, strict=True))
        state = {name: values.get(name, 0.0) for name in ("alpha", "beta")}
        state |= {h[0]: values[h] * 2 * airspeed / b for h, b in lengths.items() if h in values}
        set_state(fdm, {"airspeed": airspeed, "altitude": 300.0} | state)
        set_controls(fdm, values, largest)
        fdm.run_ic()
        found[k] = [fdm[f"aero/coefficient/{name}"] for name in COEFFICIENTS]
    return found


def flown(fdm, start, controls, largest):
    """Return JSBSim's flight from a start with a table of controls."""
    fdm["simulation/integrator/rate/rotational"] = 4
    fdm["simulation/integrator/rate/translational"] = 4
    fdm["simulation/integrator/position/rotational"] = 4
    fdm["simulation/integrator/position/translational"] = 4
    set_state(fdm, start)
    rows = controls.to_dict("records")
    set_controls(fdm, rows[0], largest)
    fdm.run_ic()
    source = {
        "airspeed": ("velocities/vt-fps", FOOT), "alpha": ("aero/alpha-rad", 1), "beta": ("aero/beta-rad", 1),
        "phi": ("attitude/phi-rad", 1), "theta": ("attitude/theta-rad", 1), "altitude": ("position/h-sl-ft", FOOT),
        **{name: (f"velocities/{name}-rad_sec", 1) for name in "pqr"},
    }  # fmt: skip
    found = []
    for following in [*rows[1:], rows[-1]]:
        found.append([fdm[source[name][0]] * source[name][1] for name in COMPARED])
        set_controls(fdm, following, largest)  # loads are computed after the step
        fdm.run()
    return pd.DataFrame(found, columns=list(COMPARED))


def doublets(trimmed, seconds, size):
    time = np.arange(round(seconds * RATE) + 1) / RATE
    table = pd.DataFrame({"time": time} | {name: np.full(len(time), value) for name, value in trimmed.items()})
    for name, begin in zip(SURFACES, (2.0, 12.0, 22.0), strict=True):
        phase = np.pi * np.clip(time - begin, 0.0, 2.0)
        table[name] += size * np.sin(phase) ** 3
    return table


def measure(path, airspeed, n_points, seconds, size):
    saved = load_model(path)
    model, aircraft = saved.pipeline, saved.aircraft
    posterior, aerodynamics = Posterior(model, None), as_aerodynamics(model)
    names = posterior.names
    largest = {n: np.abs(posterior.limits[:, names.index(n)]).max() for n in SURFACES if n in names}
    X = posterior.samples[np.random.default_rng(0).permutation(len(posterior.samples))[:n_points]]
    mean, deviation = aerodynamics(X), np.sqrt(np.mean(posterior.deviation(X) ** 2, axis=0))
    rows, flights = [], []
    fixed = {"throttle": float(np.median(posterior.samples[:, names.index("throttle")]))}
    trimmed = trim(model, aircraft, airspeed, altitude=300.0, fixed=fixed)
    start = {name: getattr(trimmed, name) for name in ("airspeed", "altitude", "alpha", "beta", "phi", "theta")}
    start |= dict(zip("pqr", trimmed.rates, strict=True))
    controls = doublets(trimmed.controls, seconds, size)
    simulated = simulate(model, aircraft, trimmed, controls, dt=1.0 / RATE)
    with tempfile.TemporaryDirectory() as folder:
        for form in ("functions", "tables"):
            options = {"max_loss": np.inf} if form == "tables" else {}
            place = Path(folder) / form
            paths = write_jsbsim(place, model, aircraft, form=form, **options)
            fdm = loaded(place, paths[0].stem)
            off = coefficients(fdm, X, names, aircraft, largest, airspeed) - mean
            for i, name in enumerate(COEFFICIENTS):
                rms = np.sqrt(np.mean(off[:, i] ** 2))
                rows.append({"form": form, "coefficient": name, "largest": np.abs(off[:, i]).max(),
                             "rms / deviation": rms / deviation[i]})  # fmt: skip
            other = flown(loaded(place, paths[0].stem), start, controls, largest)
            for name in COMPARED:
                change = np.abs(other[name] - simulated[name]).max()
                size_of = np.ptp(simulated[name]) if name != "airspeed" else airspeed
                flights.append(
                    {"form": form, "channel": name, "largest difference": change, "percent": 100 * change / size_of}
                )
    return rows, flights


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("model", type=Path, nargs="?")
    parser.add_argument("--airspeed", type=float, default=40.0)
    parser.add_argument("--points", type=int, default=10000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--doublet", type=float, default=0.01, help="size [rad]")
    options = parser.parse_args(words)
    if options.model is None:
        parser.error("the file of a model is needed")
    rows, flights = measure(options.model, options.airspeed, options.points, options.seconds, options.doublet)
    finish(options, "travel", coefficients=rows, flights=flights)


if __name__ == "__main__":
    main()
