"""Small aircraft of known derivatives, flown in gusts under a simple controller, and what their sensors log."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
from log_errors import EULER, FORCES, RATES, VELOCITY, elsewhere, held, late

from skdgp.dynamics import Aircraft, air_data, euler_to_matrix

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
STEADY_WIND = np.array([3.0, -2.0, 0.0])
SCALARS = ("mass", "wing_area", "airspeed", "thrust")
SPIN = ["p_dot", "q_dot", "r_dot"]
SURFACES = ["elevator", "aileron", "rudder"]
COMMANDS = ["elevator_command", "aileron_command", "rudder_command"]
# Of what the fleet flies
CHANNELS = [*FORCES, *SPIN, "airspeed", "alpha_true", "beta", "thrust_x", "throttle", *VELOCITY]
CHANNELS += ["u", "v", "w", *RATES, *EULER, *SURFACES, *COMMANDS]
# White noise of channels that are logged, standard deviation
NOISE = [(["airspeed"], 0.3), (FORCES, 0.1), (RATES, 0.005), (EULER, 0.005), (VELOCITY, 0.1)]
NOISE += [(SURFACES, 0.0), (["throttle"], 0.0), (["thrust_x"], 0.0), (["alpha_true"], 0.0)]
# Of the attitude of real sensors: standard deviation [rad], correlation time [s]
ATTITUDE_ERRORS = ((0.01, 5.0), (0.01, 5.0), (0.03, 20.0))
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

        def stacked(name):
            return np.array([plane[name] for plane in planes])

        self.mass, self.wing_area, self.airspeed, self.thrust = map(stacked, SCALARS)
        self.inertia = stacked("inertia")
        self.inverse = np.linalg.inv(self.inertia)
        self.W = stacked("derivatives")
        self.stalls = stacked("stalls")
        self.thrust_arm = stacked("thrust_arm")
        self.slipstream = stacked("slipstream")
        self.lengths = np.stack([stacked(name) for name in ("span", "chord", "span")], axis=1)
        self.lags = np.array(lags)[:, None]
        has_rudder = self.W[:, :, TERMS.index("rudder")].any(axis=1)
        winds = []
        inputs = []
        self.legs = []
        for rng, air, axes in zip(rngs, airs, 2 + has_rudder, strict=True):
            winds.append(gusts(rng, n, *air) + STEADY_WIND * bool(air[0]))
            inputs.append(pulses(rng, n, axes))
            self.legs.append((rng.choice([-0.5, 0.0, 0.5], n), rng.uniform(0.85, 1.2, n)))
        self.gusts = np.stack(winds, axis=1)
        self.pulses = np.stack(inputs, axis=1)

    def fly(self):
        """Return what may be logged, `CHANNELS`, (rows, flights, 29)."""
        V0 = self.airspeed
        state = np.outer(V0, [1.0, 0.0, 0.05, *[0.0] * 6])
        state[:, 7] = 0.05
        actuator = np.zeros((len(V0), 3))
        rows = []
        for i, (wind, pulse) in enumerate(zip(self.gusts, self.pulses, strict=True)):
            if i % round(15 / STEP) == 0:
                bank, speed = np.transpose([[banks[i], speeds[i]] for banks, speeds in self.legs])
                speed *= V0
            k1, log = self.rates(state, actuator, wind, speed)
            command = pulse.copy()
            command[:, 0] += 0.5 * (state[:, 7] - 0.1) + 0.08 * state[:, 4]
            command[:, 1] += 0.25 * (bank - state[:, 6]) - 0.05 * state[:, 3]
            command = np.clip(command, -0.4, 0.4)
            if i % EVERY == 0:
                rows.append(np.hstack([log, state, actuator, command]))
            state = state + STEP * self.rates(state + STEP / 2 * k1, actuator, wind, speed)[0]
            actuator = actuator + STEP / self.lags * (command - actuator)
        return np.array(rows)

    def rates(self, state, surfaces, wind, speed):
        """Return d state / dt (velocity, rates, angles), and loads with air data and ground velocity."""
        velocity, rates, angles = np.split(state, 3, axis=1)
        R = euler_to_matrix(*angles.T)
        V, alpha, beta = air_data(velocity - np.einsum("nji,nj->ni", R, wind))
        soft = np.where(self.stalls, STALL * np.tanh(alpha / STALL), alpha)
        throttle = np.clip(0.4 + 0.08 * (speed - V), 0.05, 1)
        thrust = throttle * self.thrust * (1 - V / (2.3 * self.airspeed))
        qS = 0.5 * DENSITY * V**2 * self.wing_area
        reduced = rates * self.lengths / (2 * V[:, None])
        washed = surfaces * (1 + np.outer(self.slipstream * thrust / qS, [1, 0, 1]))
        X = np.column_stack([np.ones(len(V)), soft, beta, reduced, washed, abs(beta)])
        loads = np.einsum("nij,nj->ni", self.W, X) * qS[:, None]
        loads[:, 0] += thrust
        loads[:, 3:5] += self.thrust_arm * thrust[:, None]
        force = loads[:, :3] / self.mass[:, None]
        turning = cross(rates, np.einsum("nij,nj->ni", self.inertia, rates))
        moment = loads[:, 3:] * self.lengths - turning
        spin = np.einsum("nij,nj->ni", self.inverse, moment)
        acceleration = force + GRAVITY * R[:, 2] - cross(rates, velocity)
        sin_phi, sin_theta = np.sin(angles[:, :2]).T
        cos_phi, cos_theta = np.cos(angles[:, :2]).T
        p, q, r = rates.T
        psi_dot = (sin_phi * q + cos_phi * r) / cos_theta
        euler = np.stack([p + sin_theta * psi_dot, cos_phi * q - sin_phi * r, psi_dot], axis=1)
        over_ground = np.einsum("nij,nj->ni", R, velocity)
        log = np.column_stack([force, spin, V, alpha, beta, thrust, throttle, over_ground])
        return np.hstack([acceleration, spin, euler]), log


def cross(a, b):
    """Return a x b (n, 3)."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def vibration(rng, throttle, dt):
    """Return accelerations and rates (n, 6) of an oscillation with the propeller's speed, sampled without a filter."""
    turns = np.cumsum((rng.uniform(80, 130) + 40 * throttle) * dt)  # [Hz]
    wave = np.sin(2 * np.pi * turns[:, None] + rng.uniform(0, 2 * np.pi, 6))
    return np.sqrt(2) * wave * np.repeat(VIBRATION, 3)


def logged(rows, rng, kind):
    """Return the table of one flight, with the noise of sensors, and other errors of its kind."""
    n = len(rows)
    table = pd.DataFrame(rows, columns=CHANNELS)
    table = table.assign(time=STEP * EVERY * np.arange(n), density=DENSITY)
    slow = 1
    slower = 1
    if kind == "vibration":
        table[FORCES + RATES] += vibration(rng, table["throttle"].to_numpy(), STEP * EVERY)
    if kind in ("held", "vibration"):
        slow = 5
        slower = 10
        table = late(table, 0.15, VELOCITY)
    if kind == "real":
        arm = rng.uniform(-1, 1, 3) * [0.03, 0.005, 0.02]
        table = elsewhere(table, arm, table[SPIN].to_numpy())
        table[FORCES] += 0.08 * rng.standard_normal(3)
        table[RATES] += 0.003 * rng.standard_normal(3)
        for name, (std, correlation) in zip(EULER, ATTITUDE_ERRORS, strict=True):
            error = gusts(rng, n * EVERY, 1.0, correlation, "first order")
            table[name] += std * error[::EVERY, 0]
        slower = rng.integers(5, 11)
        table = late(table, rng.uniform(0.1, 0.2), VELOCITY)
        table["airspeed"] *= 1 + 0.03 * rng.uniform(-1, 1)
        table["thrust_x"] *= 1 + 0.1 * rng.uniform(-1, 1)
        table[SURFACES] = table[COMMANDS]
    names = ["time", "density"]
    for group, std in NOISE:
        table[group] += std * rng.standard_normal((n, len(group)))
        names += group
    table = held(table, VELOCITY, slower)
    return held(table, ["airspeed", *SURFACES], slow)[names]


def truth_of(plane, alpha, load):
    """Return the known derivatives by name, at the mean angle of attack and load of the thrust."""
    W = plane["derivatives"].copy()
    W[:, [6, 8]] *= 1 + plane["slipstream"] * load
    if plane["stalls"]:
        W[:, 1] *= 1 - np.tanh(alpha / STALL) ** 2
    known = pd.DataFrame(W, COEFFICIENTS, TERMS).iloc[1:, 1:9].stack()
    return {f"{C}_{term}": value for (C, term), value in known.items() if value}
