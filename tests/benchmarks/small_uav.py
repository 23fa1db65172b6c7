"""Known derivatives of small aircraft without vanes, flown in gusts: how many lie inside their bands?

    python tests/benchmarks/small_uav.py [--aircraft NAME ...] [--air NAME ...] [--every N] [--out OUT]

Rigid bodies of 1 to 25 kg fly 3-2-1-1 inputs under a simple controller, in turbulence around a
steady wind. Ideal sensors have white noise alone; real ones are late, biased and scaled, and log
commands of late servos; held ones have slower clocks, and each row repeats their last sample;
vibration adds an aliased oscillation of inertial sensors. The table has for each air the known
derivatives inside value +/- 1.96 std, the median error and the median half band (medians over
aircraft); then the worst aircraft, medians of the errors of alpha, with its mean removed, and of
the lag of the servos, and how many flights did not converge.
"""

import itertools
import tomllib
import warnings
from pathlib import Path

import numpy as np
import pandas as pd
from _common import Kept, finish, parser_of
from numpy.random import default_rng

from skdgp.dynamics import Aircraft
from skdgp.preprocessing import estimate_air_motion

DENSITY = 1.2
GRAVITY = 9.80665
STEP, EVERY = 0.005, 4  # s of the simulation, steps between logged samples
COEFFICIENTS = ("CX", "CY", "CZ", "Cl", "Cm", "Cn")
TERMS = ("level", "alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder", "abs_beta")
# [rad], at which the softened lift and moment of some aircraft have lost half their slope
STALL = 0.3


def aircraft(sizes):
    """Return the sizes of an aircraft of the file beside, with its inertia and its derivatives (6, 10) as matrices."""
    sizes = {"slipstream": 0.0, "thrust_arm": [0.0, 0.0]} | sizes
    x, y, z, xz = sizes["inertia"]
    W = pd.DataFrame({C: sizes[C] for C in COEFFICIENTS}).reindex(TERMS).fillna(0.0)
    inertia = np.array([[x, 0, xz], [0, y, 0], [xz, 0, z]])
    return sizes | {"inertia": inertia, "derivatives": W.to_numpy().T}


def aircraft_of(plane):
    """Return the aircraft that is told."""
    return Aircraft(
        **{name: plane[name] for name in ("mass", "wing_area", "span", "chord", "inertia")}
    )


FILE = Path(__file__).with_suffix(".toml")
AIRCRAFT = {name: aircraft(sizes) for name, sizes in tomllib.loads(FILE.read_text()).items()}
SENSORS = {
    "ideal": "ideal sensors",
    "real": "real sensors, late commands",
    "held": "own clocks, held",
    "vibration": "vibration, own clocks, held",
}
NORMAL_95 = 1.96
SECONDS = 120.0
AIRS = {  # intensity [m/s], correlation time [s], spectrum
    "calm": (0.0, 1.0, "first order"),
    "0.5 m/s, 1 s": (0.5, 1.0, "first order"),
    "1 m/s, 1 s": (1.0, 1.0, "Dryden"),
    "1 m/s, 5 s": (1.0, 5.0, "first order"),
    "1 m/s, 2 s": (1.0, 2.0, "von Karman"),
    "thermals": (0.5, 1.0, "first order with thermals"),
}
VIBRATION = (1.5, 0.03)  # m/s^2, rad/s
SLOW = ("airspeed", "elevator")  # and the other surfaces: 10 Hz
THERMAL = (1.5, 4.0, 25.0)  # speed [m/s], width [s], and distance [s] of thermals


def spectrum(kind, x, axis):
    """Return the spectrum of unit variance over T, at x = omega T, of a longitudinal (axis 0) or other gust."""
    if kind.startswith("first order") or (kind == "Dryden" and axis == 0):
        return 2 / (1 + x**2)
    if kind == "Dryden":
        return (1 + 3 * x**2) / (1 + x**2) ** 2
    x = (1.339 * x) ** 2
    return 2 / (1 + x) ** (5 / 6) if axis == 0 else (1 + 8 / 3 * x) / (1 + x) ** (11 / 6)


def gusts(rng, n, intensity, correlation, kind):
    """Return gusts (n, 3) north, east, down, those down weaker."""
    x = 2 * np.pi * np.fft.rfftfreq(2 * n, STEP) * correlation
    white = np.fft.rfft(rng.standard_normal((3, 2 * n)))
    shape = np.array([spectrum(kind, x, axis) for axis in range(3)])
    colored = np.fft.irfft(white * np.sqrt(shape * correlation / STEP))[:, :n]
    air = intensity * np.array([1.0, 1.0, 0.7]) * colored.T
    if kind.endswith("thermals"):
        speed, width, distance = THERMAL
        t = np.arange(n) * STEP
        for middle in np.arange(distance / 2, n * STEP, distance) + rng.uniform(-5, 5):
            air[:, 2] -= speed * np.exp(-0.5 * ((t - middle) / width) ** 2)
    return air


def pulses(rng, n, axes):
    """Return surface commands (n, 3): a 3-2-1-1 every 5 s, on one of the first ``axes``."""
    out = np.zeros((n, 3))
    for start in np.arange(4, n * STEP - 6, 5.0):
        axis = rng.integers(axes)
        unit = rng.uniform(0.15, 0.3)
        size = rng.choice([-1, 1]) * rng.uniform(0.5, 1)
        for begin, end, sign in ((0, 3, 1), (3, 5, -1), (5, 6, 1), (6, 7, -1)):
            first = round((start + begin * unit) / STEP)
            last = round((start + end * unit) / STEP)
            out[first:last, axis] = size * sign * (0.09, 0.12, 0.15)[axis]
    return out


class Fleet:
    """Flights of aircraft in airs, side by side: arrays have an axis of flights."""

    def __init__(self, planes, airs, rngs, seconds, lags):
        n = round(seconds / STEP)
        self.planes = planes
        self.lags = np.array(lags)[:, None]
        for name in ("mass", "wing_area", "airspeed", "thrust"):
            setattr(self, name, np.array([plane[name] for plane in planes]))
        self.lengths = np.array([[p["span"], p["chord"], p["span"]] for p in planes])
        self.inertia = np.array([plane["inertia"] for plane in planes])
        self.inverse = np.linalg.inv(self.inertia)
        self.W = np.array([plane["derivatives"] for plane in planes])
        self.stalls = np.array([plane["stalls"] for plane in planes])
        self.slipstream = np.array([[plane["slipstream"]] for plane in planes])
        self.thrust_arm = np.array([plane["thrust_arm"] for plane in planes])
        self.gusts = np.stack([gusts(rng, n, *air) for rng, air in zip(rngs, airs, strict=True)], 1)
        steady = [[3.0, -2.0, 0.0] if air[0] else [0.0, 0.0, 0.0] for air in airs]
        self.gusts += np.array(steady)
        axes = [
            3 if plane["derivatives"][:, TERMS.index("rudder")].any() else 2 for plane in planes
        ]
        self.pulses = np.stack([pulses(rng, n, k) for rng, k in zip(rngs, axes, strict=True)], 1)
        self.legs = [(rng.choice([-0.5, 0.0, 0.5], n), rng.uniform(0.85, 1.2, n)) for rng in rngs]

    def fly(self):
        """Return what is logged, (rows, flights, 26)."""
        V0 = self.airspeed
        zero = np.zeros(len(self.planes))
        state = np.stack([V0, zero, 0.05 * V0, *[zero] * 4, zero + 0.05, zero], axis=1)
        actuator = np.zeros((len(V0), 3))
        rows = []
        for i, (wind, pulse) in enumerate(zip(self.gusts, self.pulses, strict=True)):
            if i % round(15 / STEP) == 0:
                bank = np.array([banks[i] for banks, _ in self.legs])
                speed = V0 * [speeds[i] for _, speeds in self.legs]
            k1, log = self.rates(state, actuator, wind, speed)
            command = [
                0.5 * (state[:, 7] - 0.1) + 0.08 * state[:, 4],
                0.25 * (bank - state[:, 6]) - 0.05 * state[:, 3],
                zero,
            ]
            command = np.clip(np.stack(command, axis=1) + pulse, -0.4, 0.4)
            if i % EVERY == 0:
                rows.append(np.concatenate([log, state, actuator, command], axis=1))
            state = state + STEP * self.rates(state + STEP / 2 * k1, actuator, wind, speed)[0]
            actuator = actuator + STEP / self.lags * (command - actuator)
        return np.array(rows)

    def rates(self, state, surfaces, wind, speed):
        """Return d state / dt (velocity, rates, angles), and loads with air data and ground velocity."""
        v = state[:, :3]
        w = state[:, 3:6]
        R = rotation(state[:, 6:])
        air = v - np.einsum("nji,nj->ni", R, wind)
        V = np.sqrt((air**2).sum(axis=1))
        alpha = np.arctan2(air[:, 2], air[:, 0])
        beta = np.arcsin(air[:, 1] / V)
        soft = np.where(self.stalls, STALL * np.tanh(alpha / STALL), alpha)
        X = np.empty((len(V), len(TERMS)))
        X[:, 0] = 1.0
        X[:, 1] = soft
        X[:, 2] = beta
        X[:, 6:9] = surfaces
        X[:, 9] = abs(beta)
        X[:, 3:6] = w * self.lengths / (2 * V[:, None])
        throttle = np.clip(0.4 + 0.08 * (speed - V), 0.05, 1)
        thrust = throttle * self.thrust * (1 - V / (2.3 * self.airspeed))
        qS = 0.5 * DENSITY * V**2 * self.wing_area
        wash = self.slipstream * (thrust / qS)[:, None]
        X[:, 6:9] *= 1 + wash * [1, 0, 1]
        C = np.einsum("nij,nj->ni", self.W, X) * qS[:, None]
        C[:, 0] += thrust
        C[:, 3:5] += self.thrust_arm * thrust[:, None]
        f = C[:, :3] / self.mass[:, None]
        H = np.einsum("nij,nj->ni", self.inertia, w)
        dw = np.einsum("nij,nj->ni", self.inverse, C[:, 3:] * self.lengths - cross(w, H))
        sf, st = np.sin(state[:, 6:8]).T
        cf, ct = np.cos(state[:, 6:8]).T
        turn = sf * w[:, 1] + cf * w[:, 2]
        phi_dot = w[:, 0] + st / ct * turn
        theta_dot = cf * w[:, 1] - sf * w[:, 2]
        angles = np.stack([phi_dot, theta_dot, turn / ct], axis=1)
        dv = f + GRAVITY * R[:, 2] - cross(w, v)
        ground = np.einsum("nij,nj->ni", R, v)
        log = np.column_stack([f, dw, V, alpha, beta, thrust, throttle, ground])
        return np.concatenate([dv, dw, angles], axis=1), log


def cross(a, b):
    """Return a x b (n, 3)."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def rotation(angles):
    """Return matrices (n, 3, 3), body to NED."""
    sf, st, sp = np.sin(angles).T
    cf, ct, cp = np.cos(angles).T
    rows = [[ct * cp, sf * st * cp - cf * sp, cf * st * cp + sf * sp],
            [ct * sp, sf * st * sp + cf * cp, cf * st * sp - sf * cp], [-st, sf * ct, cf * ct]]  # fmt: skip
    return np.moveaxis(np.array(rows), -1, 0)


def vibration(rng, throttle, dt):
    """Return accelerations and rates (n, 6) of an oscillation with the propeller's speed, sampled without a filter."""
    turns = np.cumsum((rng.uniform(80, 130) + 40 * throttle) * dt)  # [Hz]
    wave = np.sin(2 * np.pi * turns[:, None] + rng.uniform(0, 2 * np.pi, 6))
    return np.sqrt(2) * wave * np.repeat(VIBRATION, 3)


def logged(rows, rng, kind):
    """Return the table of one flight (n, 29), with the noise of sensors, and other errors of its kind."""
    n = len(rows)
    dt = STEP * EVERY
    every = 1
    held = 1
    t = np.arange(n) * dt
    f, spin, air, thrust, throttle, ground = np.split(rows[:, :14], [3, 6, 9, 10, 11], axis=1)
    rates = rows[:, 17:20]
    angles = rows[:, 20:23]
    commands = rows[:, 26:29]
    surfaces = rows[:, 23:26]
    airspeed = air[:, 0]
    if kind == "vibration":
        shake = vibration(rng, throttle[:, 0], dt)
        f = f + shake[:, :3]
        rates = rates + shake[:, 3:]
    if kind in ("held", "vibration"):
        every = 10
        held = 5
        ground = np.stack([np.interp(t - 0.15, t, v) for v in ground.T], axis=1)
    if kind == "real":
        arm = rng.uniform(-1, 1, 3) * [0.03, 0.005, 0.02]
        f = f + cross(spin, arm + 0 * f) + cross(rates, cross(rates, arm + 0 * f))
        f = f + 0.08 * rng.standard_normal(3)
        rates = rates + 0.003 * rng.standard_normal(3)
        for k, (std, correlation) in enumerate(((0.01, 5.0), (0.01, 5.0), (0.03, 20.0))):
            angles[:, k] += std * gusts(rng, n * EVERY, 1.0, correlation, "first order")[::EVERY, 0]
        every = rng.integers(5, 11)
        late = rng.uniform(0.1, 0.2)
        ground = np.stack([np.interp(t - late, t, v) for v in ground.T], axis=1)
        airspeed = airspeed * (1 + 0.03 * rng.uniform(-1, 1))
        thrust = thrust * (1 + 0.1 * rng.uniform(-1, 1))
        surfaces = commands
    noisy = {
        ("airspeed",): (airspeed[:, None], 0.3), ("ax", "ay", "az"): (f, 0.1), ("p", "q", "r"): (rates, 0.005),
        ("phi", "theta", "psi"): (angles, 0.005), ("v_north", "v_east", "v_down"): (ground, 0.1),
        ("elevator", "aileron", "rudder"): (surfaces, 0.0), ("throttle",): (throttle, 0.0),
        ("thrust_x",): (thrust, 0.0), ("alpha_true",): (air[:, [1]], 0.0),
    }  # fmt: skip
    table = {"time": t, "density": DENSITY}
    for names, (values, std) in noisy.items():
        values = values + std * rng.standard_normal(values.shape)
        clock = every if names[0] == "v_north" else held if names[0] in SLOW else 1
        values = values[np.arange(n) // clock * clock]
        table |= dict(zip(names, values.T, strict=True))
    return pd.DataFrame(table)


def truth_of(plane, alpha, load):
    """Return the known derivatives by name, at the mean angle of attack and load of the thrust."""
    W = plane["derivatives"].copy()
    W[:, [6, 8]] *= 1 + plane["slipstream"] * load
    if plane["stalls"]:
        W[:, 1] *= 1 - np.tanh(alpha / STALL) ** 2
    known = pd.DataFrame(W, COEFFICIENTS, TERMS).iloc[1:, 1:9].stack()
    return {f"{C}_{term}": value for (C, term), value in known.items() if value}


def score(table, plane, lag):
    """Return z, errors and half bands of the derivatives, then other figures, of one flight."""
    alpha = table.pop("alpha_true")
    qS = 0.5 * DENSITY * table["airspeed"] ** 2 * plane["wing_area"]
    load = (table["thrust_x"] / qS).mean()
    try:
        found = estimate_air_motion(table, aircraft_of(plane))
    except ValueError:  # it says that it diverged
        return {"z": [], "error": [], "half": [], "converged": False}
    truth = truth_of(plane, alpha.mean(), load)
    known = [name for name in truth if name in found.derivatives.index]
    value, std = found.derivatives.loc[known, ["value", "std"]].to_numpy().T
    exact = np.array([truth[name] for name in known])
    return {
        "z": ((value - exact) / std).tolist(),
        "error": (100 * abs(value / exact - 1)).tolist(),
        "half": (196 * std / abs(exact)).tolist(),
        "alpha": float(np.rad2deg(np.std(found.air["alpha"].to_numpy() - alpha.to_numpy()))),
        "lag": float(1e3 * abs(found.constants.loc["servo_lag", "value"] - lag)),
        "converged": bool(found.converged),
    }


def column(flights):
    """Return a column of the table: cells by air, then over all."""
    table = flights.explode(["z", "error", "half"]).astype({"error": float, "half": float})
    table["inside"] = 100.0 * (table["z"].abs() < NORMAL_95)
    medians = table.groupby(["air", "aircraft"])[["error", "half"]].median().groupby("air").median()
    held = table.groupby("air")["inside"].mean()
    cells = {
        air: f"{held[air]:.0f} %, {medians.loc[air, 'error']:.0f} %, {medians.loc[air, 'half']:.0f} %"
        for air in flights["air"].unique()
    }
    worst = table.groupby("aircraft")["inside"].mean()
    alpha, lag = flights[["alpha", "lag"]].median()
    return cells | {
        "worst aircraft": f"{worst.min():.0f} % ({worst.idxmin()})",
        "error of alpha, of the lag": f"{alpha:.2f} deg, {lag:.1f} ms",
        "not converged": f"{sum(~flights['converged'])} of {len(flights)}",
    }


def main(words=None):
    parser = parser_of(__doc__)
    parser.add_argument("--aircraft", nargs="+", choices=AIRCRAFT, default=list(AIRCRAFT))
    parser.add_argument("--air", nargs="+", choices=AIRS, default=list(AIRS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[91])
    parser.add_argument("--every", type=int, default=1, help="3: a third, even over all kinds")
    options = parser.parse_args(words)
    axes = SENSORS, options.aircraft, options.air, options.seeds
    places = itertools.product(*(range(len(axis)) for axis in axes))
    chosen = [sum(place) % options.every == 0 for place in places]
    cases = list(itertools.compress(itertools.product(*axes), chosen))
    warnings.simplefilter("ignore")
    rngs = [default_rng([*map(ord, "".join(c[:3])), c[3]]) for c in cases]
    lags = [rng.uniform(0.02, 0.08) for rng in rngs]
    planes = [AIRCRAFT[name] for _, name, _, _ in cases]
    flown = Fleet(planes, [AIRS[air] for _, _, air, _ in cases], rngs, SECONDS, lags).fly()
    kept = Kept(options, "small_uav")
    for k, case in enumerate(cases):
        table = logged(flown[:, k], rngs[k], case[0])
        key = dict(zip(("sensors", "aircraft", "air", "seed"), case, strict=True))
        kept.run(key, score, table, planes[k], lags[k] if case[0] == "real" else 0.0)
    runs = kept.table
    columns = {SENSORS[kind]: column(some) for kind, some in runs.groupby("sensors", sort=False)}
    rows = pd.DataFrame(columns).reset_index(names="air").to_dict("records")
    finish(options, "small_uav", derivatives=rows)


if __name__ == "__main__":
    main()
