"""Exports flown by JSBSim beside this package's simulation.

    python tests/benchmarks/travel.py results/model.joblib [--airspeed 40] [--out FOLDER]

Needs JSBSim (``pip install jsbsim``). Coefficients at points of the flown envelope, in functions and in tables; trims
of JSBSim beside ``trim``; a flight of 60 s with doublets from a trim, over an Earth without rotation and curvature and
in the air of JSBSim; bands of such flights of posterior aircraft.
"""

import tempfile
from pathlib import Path
from time import process_time

import numpy as np
import pandas as pd
from _common import finish, parser_of
from scipy.interpolate import CubicSpline

from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Air, as_aerodynamics, simulate, trim
from skdgp.export import write_jsbsim
from skdgp.export._build_up import Posterior
from skdgp.export._jsbsim import FOOT, POUND_FORCE, SOURCES, SURFACES
from skdgp.identification import load_model

RADIUS = 1e10  # of an Earth that is flat over the flight; a larger one rounds the altitude to 0.01 mm [m]
PLANET = f"""<?xml version="1.0"?>
<planet name="flat"><semimajor_axis unit="M">{RADIUS}</semimajor_axis><semiminor_axis unit="M">{RADIUS}</semiminor_axis>
<rotation_rate unit="RAD/SEC">0.0</rotation_rate><GM unit="M3/SEC2">{9.80665 * RADIUS**2}</GM><J2>0.0</J2></planet>
"""
ALTITUDE = 300.0  # m
COMPARED = ("airspeed", "alpha", "beta", "phi", "theta", "p", "q", "r", "altitude")


def loaded(folder, name, rate):
    import jsbsim

    fdm = jsbsim.FGFDMExec(str(folder))
    fdm.set_debug_level(0)
    planet = Path(folder) / "flat.xml"
    planet.write_text(PLANET)
    fdm.load_planet(str(planet), False)
    fdm.load_model(name)
    fdm.set_dt(1.0 / rate)
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
    source = SOURCES | {name: (f"velocities/{name}-rad_sec", 1.0) for name in "pqr"}
    found = []
    for following in [*rows[1:], rows[-1]]:
        found.append([fdm[source[name][0]] * source[name][1] for name in COMPARED])
        set_controls(fdm, following, largest)  # loads are computed after the step
        fdm.run()
    return pd.DataFrame(found, columns=list(COMPARED))


def doublets(trimmed, seconds, size, rate):
    time = np.arange(round(seconds * rate) + 1) / rate
    table = pd.DataFrame({"time": time} | {name: np.full(len(time), value) for name, value in trimmed.items()})
    for name, begin in zip(SURFACES, (2.0, 12.0, 22.0), strict=True):
        phase = np.pi * np.clip(time - begin, 0.0, 2.0)
        table[name] += size * np.sin(phase) ** 3
    return table


def jsbsim_density(fdm):
    """Return JSBSim's density [kg/m^3] as a function of altitude [m]: 8e-6 above the standard at sea level."""
    altitudes, found = np.arange(-1000.0, 5001.0, 50.0), []
    for altitude in altitudes:
        set_state(fdm, {"airspeed": 40.0, "altitude": altitude})
        fdm.run_ic()
        found.append(fdm["atmosphere/rho-slugs_ft3"] * POUND_FORCE / FOOT**4)
    return CubicSpline(altitudes, found)


class Travelled:
    """A model, the folder of its exports, and a flight with doublets from a trim."""

    def __init__(self, path, folder, airspeed, seconds, size, rate):
        saved = load_model(path)
        self.model, self.aircraft, self.airspeed, self.folder = saved.pipeline, saved.aircraft, airspeed, Path(folder)
        self.rate, self.paths = rate, {}
        self.posterior = Posterior(self.model, None)
        self.names, flown = self.posterior.names, self.posterior.samples
        self.largest = {n: np.abs(flown[:, self.names.index(n)]).max() for n in SURFACES if n in self.names}
        self.fixed = {"throttle": float(np.median(flown[:, self.names.index("throttle")]))}
        self.density = jsbsim_density(self.written("functions")[0])
        self.trimmed = self.trim(airspeed)
        self.controls = doublets(self.trimmed.controls, seconds, size, rate)

    def written(self, form, n_draws=0):
        """Return JSBSim with the aircraft of the mean and of each draw."""
        if (form, n_draws) not in self.paths:
            place = self.folder / f"{form}{n_draws}"
            self.paths[form, n_draws] = write_jsbsim(place, self.model, self.aircraft, form=form, n_draws=n_draws)
        return [loaded(path.parents[2], path.stem, self.rate) for path in self.paths[form, n_draws]]

    def trim(self, airspeed):
        air = Air(density=float(self.density(ALTITUDE)))
        return trim(self.model, self.aircraft, airspeed, fixed=self.fixed, altitude=ALTITUDE, air=air)

    def simulated(self, air=None, **options):
        options |= {"dt": 1.0 / self.rate, "air": Air(density=self.density, **air or {})}
        return simulate(self.model, self.aircraft, self.trimmed, self.controls, **options)

    def flown(self, fdm):
        return flown(fdm, state_of(self.trimmed), self.controls, self.largest)


def state_of(trimmed):
    state = {name: getattr(trimmed, name) for name in ("airspeed", "altitude", "alpha", "beta", "phi", "theta")}
    return state | dict(zip("pqr", trimmed.rates, strict=True))


def measure_coefficients(case, form, n_points):
    X = case.posterior.samples[np.random.default_rng(0).permutation(len(case.posterior.samples))[:n_points]]
    found = coefficients(case.written(form)[0], X, case.names, case.aircraft, case.largest, case.airspeed)
    off, deviation = found - as_aerodynamics(case.model)(X), np.sqrt(np.mean(case.posterior.deviation(X) ** 2, axis=0))
    return [
        {"form": form, "coefficient": name, "largest": np.abs(off[:, i]).max(),
         "rms / deviation": np.sqrt(np.mean(off[:, i] ** 2)) / deviation[i]}
        for i, name in enumerate(COEFFICIENTS)
    ]  # fmt: skip


def measure_flight(case, form):
    simulated, other = case.simulated(), case.flown(case.written(form)[0])
    rows = []
    for name in COMPARED:
        change = np.abs(other[name] - simulated[name]).max()
        size = np.ptp(simulated[name]) if name != "airspeed" else case.airspeed
        rows.append({"form": form, "channel": name, "largest difference": change, "percent": 100 * change / size})
    return rows


def measure_trims(case):
    """Compare ``trim`` with JSBSim's full trim at the same thrust, begun elsewhere (its tolerance: 0.001 ft/s^2)."""
    rows = []
    for airspeed in case.airspeed * np.array([0.9, 1.0, 1.1]):
        expected, fdm = case.trim(airspeed), case.written("functions")[0]
        wanted = state_of(expected) | {name: expected.controls[name] for name in case.largest}
        set_state(fdm, state_of(expected) | {"alpha": 0.05, "phi": 0.0, "theta": 0.05})
        set_controls(fdm, expected.controls | dict.fromkeys(case.largest, 0.0), case.largest)
        fdm.run_ic()
        fdm["simulation/do_simple_trim"] = 1
        for name in ("alpha", "theta", "phi", *case.largest):
            source = SOURCES[name][0]
            off = fdm[source] - wanted[name]
            rows.append({"airspeed": airspeed, "name": name, "trim": wanted[name], "JSBSim less trim": off})
    return rows


def measure_bands(case, n_draws):
    """Compare the 95 % band of posterior aircraft in JSBSim with that of ``simulate``, by paths of another seed."""
    started = process_time()
    fdms = case.written("functions", n_draws)[1:]
    made = process_time()
    theirs = [case.flown(fdm) for fdm in fdms]
    print(f"{n_draws} aircraft: {made - started:.0f} s to write and load, {process_time() - made:.0f} s to fly")
    ours, fresh = (case.simulated(n_paths=n_draws, random_state=k, air={"gusts": None, "drift": False}) for k in (0, 1))
    rows = []
    for name in COMPARED:
        one, two, new = np.stack(theirs)[:, :, COMPARED.index(name)], _by_path(ours, name), _by_path(fresh, name)
        row = {"channel": name, "largest difference": np.nanmax(np.abs(one - two))}
        for of, paths in (("JSBSim", one), ("simulate", two)):
            low, high = np.nanquantile(paths, [0.025, 0.975], axis=0)[:, 1:]
            row |= {f"covered by {of}": np.mean((low <= new[:, 1:]) & (new[:, 1:] <= high)), of: np.mean(high - low)}
        rows.append(row | {"width": row.pop("JSBSim") / row.pop("simulate")})
    return rows


def _by_path(flights, name):
    return np.stack([flight[name].to_numpy() for _, flight in flights.groupby("path")])


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("model", type=Path, nargs="?")
    parser.add_argument("--airspeed", type=float, default=40.0)
    parser.add_argument("--points", type=int, default=10000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--doublet", type=float, default=0.01, help="size [rad]")
    parser.add_argument("--draws", type=int, default=50, help="posterior aircraft")
    parser.add_argument("--rate", type=int, default=200, help="of the flights [Hz]")
    parser.add_argument("--forms", nargs="+", default=["functions", "tables"])
    options = parser.parse_args(words)
    if options.model is None:
        parser.error("the file of a model is needed")
    with tempfile.TemporaryDirectory() as folder:
        case = Travelled(options.model, folder, options.airspeed, options.seconds, options.doublet, options.rate)
        tables = {
            "coefficients": [row for form in options.forms for row in measure_coefficients(case, form, options.points)],
            "trims": measure_trims(case),
            "flights": [row for form in options.forms for row in measure_flight(case, form)],
        }
        if options.draws:
            tables["bands"] = measure_bands(case, options.draws)
        finish(options, "travel", **tables)


if __name__ == "__main__":
    main()
