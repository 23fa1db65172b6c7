"""JSBSim flown for logs of aircraft whose aerodynamics are known."""

from contextlib import suppress
from functools import cache

import numpy as np
import pandas as pd
from flight_columns import COEFFICIENTS, EULER, RATES, SURFACES
from numpy.random import default_rng

from skdgp.datasets import COMMANDS, FLIGHT_PLANS, measure
from skdgp.dynamics import (
    Aircraft,
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
    stability_derivatives,
)

FOOT = 0.3048
POUND_FORCE = 4.4482216152605
SLUG = POUND_FORCE / FOOT
START = {
    "h-sl-ft": 4000,
    "lat-geod-deg": 45,
    "long-gc-deg": 10,
    "psi-true-deg": 60,
    "gamma-deg": 0,
}


def started(model, rate, knots):
    """Return JSBSim with the aircraft in the air, its engine running, trimmed at an airspeed, its mass frozen."""
    import jsbsim

    fdm = jsbsim.FGFDMExec(None)
    fdm.set_debug_level(0)
    fdm.load_model(model)
    fdm.set_dt(1.0 / rate)
    for name, value in (START | {"vc-kts": knots}).items():
        fdm[f"ic/{name}"] = value
    fdm["fcs/mixture-cmd-norm"] = 0.9
    fdm["fcs/throttle-cmd-norm"] = 0.7
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


# -- flights to learn from, with their truth

STEADY = ("alpha", "beta", *RATES, *SURFACES, "throttle")
NAMES = (*STEADY, "alpha_dot", "beta_dot")  # Regressors of the truth, rates non-dimensional
ROTATION = [2, 3, 4]
SLOPES = [9, 10]
# [kt], MIL-F-8785C as JSBSim flies it
WIND_AT_20FT = {"calm": 0.0, "light": 15.0, "moderate": 30.0}
HEIGHT = 274.0  # above the ground [m]
# Calibrated airspeed of aircraft of JSBSim
KNOTS = {
    "J3Cub": 65.0, "DHC6": 130.0, "A4": 350.0, "global5000": 280.0, "c182": 100.0, "c172p": 100.0,
    "t6texan2": 150.0, "T37": 200.0, "737": 250.0, "A320": 250.0, "B747": 280.0,
}  # fmt: skip
# Aircraft of the ablation alone, which feel the rates of the air
LEFT_OUT = {
    "Camel": 85.0, "F4N": 320.0, "OV10": 150.0, "787-8": 250.0, "Boeing314": 130.0, "MD11": 280.0,
}  # fmt: skip
KNOTS |= LEFT_OUT
RATE = 40  # Hz, of the logs
# Of JSBSim per row; controls change at each of them: held longer, they would lag behind the loads
FRAMES = 6
SETTLING = 10.0  # s before the log
DURATION = 200.0  # s of a log
TRAINING = (1, "light", 1)  # Plan of the flight, air and seed
FLOWN = {"calm": (2, "calm", 0), "light": (2, "light", 11), "moderate": (2, "moderate", 12)}
UNITS = {
    "ft": FOOT, "ft/s": FOOT, "lb": POUND_FORCE, "lb ft": POUND_FORCE * FOOT,
    "slug/ft^3": SLUG / FOOT**3,
}  # fmt: skip
# Columns; the property of JSBSim that each comes from; their unit
PROPERTIES = """
alpha_true beta_true; aero/alpha-rad aero/beta-rad; rad
alpha_dot_true beta_dot_true; aero/alphadot-rad_sec aero/betadot-rad_sec; rad/s
phi_true theta_true psi_true; attitude/phi-rad attitude/theta-rad attitude/psi-rad; rad
p_true q_true r_true; velocities/p-rad_sec velocities/q-rad_sec velocities/r-rad_sec; rad/s
p_felt q_felt r_felt; velocities/p-aero-rad_sec velocities/q-aero-rad_sec velocities/r-aero-rad_sec; rad/s
v_north_true v_east_true v_down_true; velocities/v-north-fps velocities/v-east-fps velocities/v-down-fps; ft/s
ax_true ay_true az_true; forces/fbx-total-lbs forces/fby-total-lbs forces/fbz-total-lbs; lb
CX_true CY_true CZ_true; forces/fbx-aero-lbs forces/fby-aero-lbs forces/fbz-aero-lbs; lb
Cl_true Cm_true Cn_true; moments/l-aero-lbsft moments/m-aero-lbsft moments/n-aero-lbsft; lb ft
thrust_x thrust_y thrust_z; forces/fbx-prop-lbs forces/fby-prop-lbs forces/fbz-prop-lbs; lb
thrust_l thrust_m thrust_n; moments/l-prop-lbsft moments/m-prop-lbsft moments/n-prop-lbsft; lb ft
elevator aileron rudder; fcs/elevator-pos-rad fcs/left-aileron-pos-rad fcs/rudder-pos-rad; rad
throttle; fcs/throttle-pos-norm; 1
airspeed_true; velocities/vt-fps; ft/s
altitude; position/h-sl-ft; ft
density; atmosphere/rho-slugs_ft3; slug/ft^3
"""


def sources():
    """Return property and factor to SI of each column; forces and moments in newtons."""
    found = {}
    for line in PROPERTIES.strip().splitlines():
        names, properties, unit = line.split("; ")
        for name, source in zip(names.split(), properties.split(), strict=True):
            found[name] = source, UNITS.get(unit, 1.0)
    return found


SOURCES = sources()


@cache
def flight_of(model, number, air, seed, duration=DURATION):
    """Return a flight with sensors of a small aircraft and its truth, ending in _true, and the aircraft.

    It has the manoeuvres of a plan of the example flights, held level or in slow turns.
    """
    plan = FLIGHT_PLANS[number]
    fdm = started(model, RATE * FRAMES, KNOTS[model])
    fdm["ic/h-sl-ft"] = HEIGHT / FOOT
    fdm["ic/vc-kts"] = KNOTS[model]
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["simulation/do_simple_trim"] = 1
    if WIND_AT_20FT[air]:
        fdm["simulation/randomseed"] = seed
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = WIND_AT_20FT[air] * 1.68781
        fdm["atmosphere/turbulence/milspec/severity"] = 3 if air == "light" else 4
        fdm["atmosphere/turb-type"] = 3
    neutral = {name: fdm[f"fcs/{name}-cmd-norm"] for name in (*SURFACES, "throttle")}
    theta = fdm["attitude/theta-rad"]
    speed = fdm["velocities/vt-fps"]
    time = np.arange(round((SETTLING + duration) * RATE * FRAMES)) / (RATE * FRAMES) - SETTLING
    command = np.column_stack([plan.manoeuvres(axis, time) for axis in COMMANDS])
    command *= [1.0, 1.5, 1.0, 1.0]
    rows = []
    for k, now in enumerate(time):
        phi = 0.3 * np.sin(2 * np.pi * now / (70 + 20 * number))
        height = HEIGHT + 30 * (number == 2 and now > 70)
        climb = np.clip((height - fdm["position/h-sl-ft"] * FOOT) / 200, -0.07, 0.07)
        pitch = 0.5 * (fdm["attitude/theta-rad"] - theta - climb)
        surfaces = {
            "elevator": pitch + 0.15 * fdm["velocities/q-rad_sec"],
            "aileron": 0.25 * (phi - fdm["attitude/phi-rad"]) - 0.05 * fdm["velocities/p-rad_sec"],
            "rudder": 0.1 * fdm["velocities/r-rad_sec"],
        }
        for j, name in enumerate(SURFACES):
            fdm[f"fcs/{name}-cmd-norm"] = neutral[name] + (surfaces[name] + command[k, j]) / 0.35
        slower = neutral["throttle"] + 0.03 * (speed - fdm["velocities/vt-fps"])
        fdm["fcs/throttle-cmd-norm"] = np.clip(slower + command[k, 3], 0.1, 1.0)
        fdm.run()
        if k % FRAMES == FRAMES - 1:
            rows.append([fdm[source] * factor for source, factor in SOURCES.values()])
    time = time[FRAMES - 1 :: FRAMES]
    aircraft = aircraft_of(fdm, model)
    table = pd.DataFrame(rows, columns=[*SOURCES]).assign(time=time, flight=plan.name)
    true = with_truth(table[time >= 0].reset_index(drop=True), aircraft)
    noise = default_rng([number, seed, len(model)])  # mostly another for each aircraft
    return pd.concat([measure(true, 1.0, noise), true], axis=1), aircraft


def with_truth(table, aircraft):
    """Return the table with coefficients of its loads, places, and the wind."""
    table[[f"a{axis}_true" for axis in "xyz"]] /= aircraft.mass
    dynamic_pressure = 0.5 * table["density"] * table["airspeed_true"] ** 2
    coefficients = [f"{name}_true" for name in COEFFICIENTS]
    table[coefficients] = table[coefficients].div(dynamic_pressure * aircraft.wing_area, axis=0)
    table[coefficients[3:]] /= aircraft.moment_lengths
    for axis in ("north", "east"):
        table[f"{axis}_true"] = np.cumsum(table[f"v_{axis}_true"]) / RATE
    attitude = euler_to_quaternion(*(table[f"{angle}_true"] for angle in EULER))
    air = air_velocity(
        *(table[f"{name}_true"].to_numpy() for name in ("airspeed", "alpha", "beta"))
    )
    through_air = body_to_ned(attitude, air).T
    for axis, velocity in zip(("north", "east", "down"), through_air, strict=True):
        table[f"wind_{axis}_true"] = table[f"v_{axis}_true"] - velocity
    return table.assign(gravity_true=9.80665, psi_true=table["psi_true"] % (2 * np.pi))


def sensed(log):
    """Return what the sensors saw of a flight."""
    return log[[name for name in log if not name.endswith(("_true", "_felt"))]]


def exact_regressors(table, aircraft):
    """Return `NAMES` of columns of the truth, (n, 11), with the rates that the aerodynamics feel."""
    columns = [f"{name}_true" if f"{name}_true" in table else name for name in NAMES]
    exact = table[columns].to_numpy()
    exact[:, ROTATION] = table[[f"{rate}_felt" for rate in "pqr"]]
    lengths = aircraft.moment_lengths / (2 * table[["airspeed_true"]].to_numpy())
    exact[:, ROTATION] *= lengths
    exact[:, SLOPES] *= lengths[:, 1:]
    return exact


# Command and position of each surface of JSBSim
MOVED = {
    "elevator": ("fcs/elevator-cmd-norm", "fcs/elevator-pos-rad"),
    "aileron": ("fcs/aileron-cmd-norm", "fcs/left-aileron-pos-rad"),
    "rudder": ("fcs/rudder-cmd-norm", "fcs/rudder-pos-rad"),
}
REACH = 0.5  # of the perturbation, where a surface does not reach further
BANK = 0.5  # rad, changes alpha_dot and beta_dot of an instant, and no other regressor
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(6)
KNOT = 0.514444
SEA_LEVEL_DENSITY = 1.225


class JSBSimAerodynamics:
    """Coefficients of an aircraft of JSBSim at given regressors, evaluated by JSBSim itself.

    The propeller turns as in the trim at the mean airspeed of a flight.
    """

    def __init__(self, model, flight):
        self.airspeed = flight["airspeed_true"].mean()
        ratio = flight["density"].mean() / SEA_LEVEL_DENSITY
        self.fdm = started(model, RATE * FRAMES, self.airspeed / KNOT * np.sqrt(ratio))
        self.aircraft = aircraft_of(self.fdm, model)

    def __call__(self, x, bank=0.0):
        """Return coefficients (6,) and the non-dimensional alpha_dot and beta_dot (2,) at `STEADY`[:8]."""
        fdm = self.fdm
        lengths = self.aircraft.moment_lengths
        fdm["ic/vt-fps"] = self.airspeed / FOOT
        fdm["ic/phi-rad"] = bank
        fdm["ic/alpha-rad"], fdm["ic/beta-rad"] = x[:2]
        for rate, value, length in zip("pqr", x[2:5], lengths, strict=True):
            fdm[f"ic/{rate}-rad_sec"] = value * 2 * self.airspeed / length
        fdm.run_ic()
        for name, angle in zip(SURFACES, x[5:8], strict=True):
            self._move(name, angle)
        density = fdm["atmosphere/rho-slugs_ft3"] * SLUG / FOOT**3
        load = 0.5 * density * self.airspeed**2 * self.aircraft.wing_area
        forces = [fdm[f"forces/fb{axis}-aero-lbs"] * POUND_FORCE / load for axis in "xyz"]
        moments = np.array([fdm[f"moments/{axis}-aero-lbsft"] for axis in "lmn"])
        moments *= POUND_FORCE * FOOT / (load * lengths)
        dots = np.array([fdm["aero/alphadot-rad_sec"], fdm["aero/betadot-rad_sec"]])
        return np.array([*forces, *moments]), dots * lengths[1:] / (2 * self.airspeed)

    def _move(self, name, angle):
        """Move a surface to an angle, past what an autopilot in JSBSim adds to its command."""
        command, position = MOVED[name]
        for _ in range(6):
            now = self.fdm[command]
            before = self.fdm[position]
            if abs(angle - before) < 1e-7:
                return
            self.fdm[command] = now + 1e-3
            self.fdm.run_ic()
            gain = (self.fdm[position] - before) / 1e-3
            self.fdm[command] = now + (angle - before) / gain if gain else now
            self.fdm.run_ic()
        self.fdm[command] = 0.0  # at its end a surface does not show what a command changes
        raise ValueError(f"Got {name} {angle:.3f} rad, but it reaches {before:.3f} rad.")

    def derivatives(self, at, spread):
        """Return the derivatives (6, 10) at `STEADY`[:8] (8,), the mean over the spread of each regressor alone.

        Those by alpha_dot and beta_dot follow from banked instants, and are taken out of the others.
        """
        level, dots = self(at)
        banked = [self(at, bank) for bank in (BANK, -BANK)]
        changes = [of_bank - dots for _, of_bank in banked]
        loads = [of_bank - level for of_bank, _ in banked]
        by_dots = np.linalg.lstsq(changes, loads, rcond=None)[0].T
        slopes = np.zeros((6, 8))
        for k, step in enumerate(spread):
            for node, weight in zip(NODES, WEIGHTS / WEIGHTS.sum(), strict=True):
                x = at.copy()
                x[k] += step * node
                coefficients, dots = self(x)
                slopes[:, k] += weight * node / step * (coefficients - by_dots @ dots)
        return pd.DataFrame(np.hstack([slopes, by_dots]), COEFFICIENTS, [*STEADY[:8], *NAMES[9:]])


def evaluated_derivatives(name, flight, aircraft):
    """Return the mean regressors of a flight and the derivatives (6, 10) there of an aircraft of JSBSim.

    They are means over the spread of each regressor in the flight, smaller where a surface does not
    reach that far.
    """
    exact = exact_regressors(flight, aircraft)
    at, spread = exact.mean(axis=0), exact.std(axis=0)[:8]
    evaluated = JSBSimAerodynamics(name, flight)
    for fraction in (1.0, REACH):
        with suppress(ValueError):
            return at, evaluated.derivatives(at[:8], fraction * spread)
    raise ValueError(f"Got surfaces of {name} that do not reach {REACH:.0%} of what was flown.")


def learned_derivatives(model, aircraft, at, airspeed, names=STEADY):
    """Return the table of derivatives by some regressors at `NAMES`."""
    at = dict(zip(NAMES, at, strict=True))
    rates = np.array([at[name] for name in "pqr"]) * 2 * airspeed / aircraft.moment_lengths
    velocity = air_velocity(airspeed, at["alpha"], at["beta"])
    attitude = euler_to_quaternion(0.0, at["alpha"], 0.0)
    state = np.concatenate([[0.0, 0.0, -HEIGHT], velocity, attitude, rates])
    controls = {name: at[name] for name in STEADY[5:]}
    table = stability_derivatives(model, aircraft, state, controls, thrust=None)
    if "std_merged" in table:  # the known ones are without alpha_dot and beta_dot
        table["std"] = np.hypot(table["std"], table["std_merged"])
    return table[table["coefficient"].isin(COEFFICIENTS) & table["regressor"].isin(names)].copy()


def true_values(table, known):
    """Return the known values (n,) of the rows of a table of derivatives."""
    return np.array([known.loc[row.coefficient, row.regressor] for row in table.itertuples()])
