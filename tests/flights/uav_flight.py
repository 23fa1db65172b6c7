"""Small aircraft of known derivatives, flown in gusts under a simple controller, and what their sensors log."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd

from skdgp.dynamics import Aircraft, euler_to_matrix

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
        R = euler_to_matrix(*state[:, 6:].T)
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
