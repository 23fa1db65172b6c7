"""JSBSim flown for its loads and motion: what it says acts on the aircraft, and where that takes it."""

import numpy as np
import pandas as pd

from skdgp.dynamics import Aircraft

FOOT, POUND_FORCE = 0.3048, 4.4482216152605
SLUG = POUND_FORCE / FOOT
EARTH_RATE = 7.292115e-5  # rad/s
FOURTH_ORDER = {
    "rate/rotational": 5,
    "rate/translational": 5,
    "position/rotational": 7,
    "position/translational": 5,
}
"""Integrators of JSBSim; its default is Euler's method for rates and attitude."""
START = {
    "h-sl-ft": 4000,
    "vc-kts": 100,
    "lat-geod-deg": 45,
    "long-gc-deg": 10,
    "psi-true-deg": 60,
    "gamma-deg": 0,
}
DOUBLETS = {
    "elevator": (1.0, -0.08),
    "aileron": (4.0, 0.25),
    "rudder": (7.0, 0.3),
}  # from [s], size;
# a second each way, smooth: a jump would cost any integrator an order


def _columns():
    """Yield the name, JSBSim's property and the factor to SI of each column."""
    for k, axis in enumerate("xyz"):
        moment, velocity, rate = "lmn"[k], "uvw"[k], "pqr"[k]
        yield f"aero_{axis}", f"forces/fb{axis}-aero-lbs", POUND_FORCE
        yield f"thrust_{axis}", f"forces/fb{axis}-prop-lbs", POUND_FORCE
        yield f"weight_{axis}", f"forces/fb{axis}-weight-lbs", POUND_FORCE
        yield f"aero_{moment}", f"moments/{moment}-aero-lbsft", POUND_FORCE * FOOT
        yield f"thrust_{moment}", f"moments/{moment}-prop-lbsft", POUND_FORCE * FOOT
        yield velocity, f"velocities/{velocity}-fps", FOOT
        yield f"{velocity}_dot", f"accelerations/{velocity}dot-ft_sec2", FOOT
        yield rate, f"velocities/{rate}-rad_sec", 1.0
        yield f"{rate}_dot", f"accelerations/{rate}dot-rad_sec2", 1.0
        yield f"earth_{axis}", f"position/ecef-{axis}-ft", FOOT
    for angle in ("phi", "theta", "psi"):
        yield angle, f"attitude/{angle}-rad", 1.0
    yield "latitude", "position/lat-geod-rad", 1.0
    yield "longitude", "position/long-gc-rad", 1.0


def fly(model, seconds, rate):
    """Return a flight of ``model`` with doublets of all surfaces, at ``rate`` [Hz], and the aircraft it was."""
    fdm = started(model, rate)
    for name, method in FOURTH_ORDER.items():
        fdm[f"simulation/integrator/{name}"] = method
    columns = list(_columns())
    neutral = {surface: fdm[f"fcs/{surface}-cmd-norm"] for surface in DOUBLETS}
    rows = np.empty((round(seconds * rate) + 1, len(columns)))
    for k in range(len(rows)):
        for surface, (start, size) in DOUBLETS.items():
            phase = np.pi * min(max(k / rate - start, 0.0), 2.0)
            fdm[f"fcs/{surface}-cmd-norm"] = neutral[surface] + size * np.sin(phase) ** 3
        fdm.run()
        rows[k] = [fdm[source] * factor for _, source, factor in columns]
    flight = pd.DataFrame(rows, columns=[name for name, *_ in columns])
    return flight.assign(time=np.arange(len(rows)) / rate), aircraft_of(fdm, model)


def started(model, rate, knots=START["vc-kts"]):
    """Return JSBSim with the aircraft in the air, its engine running, trimmed at an airspeed, its mass frozen."""
    import jsbsim

    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.load_model(model)
    fdm.set_dt(1.0 / rate)
    for name, value in (START | {"vc-kts": knots}).items():
        fdm[f"ic/{name}"] = value
    fdm["fcs/mixture-cmd-norm"], fdm["fcs/throttle-cmd-norm"] = 0.9, 0.7
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["propulsion/fuel_freeze"] = 1
    fdm["simulation/do_simple_trim"] = 1
    return fdm


def aircraft_of(fdm, model):
    """Return the aircraft as JSBSim carries it; its ixz is the tensor's element, not the product of inertia."""
    ixx, iyy, izz, ixy, ixz, iyz = (
        fdm[f"inertia/{name}-slugs_ft2"] * SLUG * FOOT**2
        for name in ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
    )
    return Aircraft(
        name=model,
        mass=fdm["inertia/mass-slugs"] * SLUG,
        inertia=[[ixx, -ixy, ixz], [-ixy, iyy, -iyz], [ixz, -iyz, izz]],
        wing_area=fdm["metrics/Sw-sqft"] * FOOT**2,
        span=fdm["metrics/bw-ft"] * FOOT,
        chord=fdm["metrics/cbarw-ft"] * FOOT,
    )


def earth_to_ned(latitude, longitude):
    """Return the rotations (n, 3, 3) from axes fixed in the Earth to north, east, down at a geodetic latitude [rad]."""
    (s, c), (sl, cl) = ((np.sin(x), np.cos(x)) for x in (latitude, longitude))
    zero = np.zeros_like(s)
    rows = [[-s * cl, -s * sl, c], [-sl, cl, zero], [-c * cl, -c * sl, -s]]
    return np.moveaxis(np.array(rows), -1, 0)
