"""Small aircraft of known derivatives, flown in gusts under a simple controller, and what their sensors log."""

import tomllib
from pathlib import Path

import numpy as np
import pandas as pd
from flight_columns import COEFFICIENTS, EULER, FORCES, RATES, SPIN, SURFACES, VELOCITY, WIND
from log_errors import elsewhere, held, late

from skdgp.dynamics import Aerodynamics, Air, Aircraft, Servos, simulate

DENSITY = 1.2
STEP, EVERY = 0.01, 2  # s of the simulation, steps between logged samples
TERMS = ("level", "alpha", "beta", "p", "q", "r", "elevator", "aileron", "rudder", "abs_beta")
REGRESSORS = ["airspeed", "alpha", "beta", "p_hat", "q_hat", "r_hat"]
# [rad], at which the softened lift and moment of some aircraft have lost half their slope
STALL = 0.3


def aircraft(sizes):
    """Return the sizes of an aircraft of the file beside, with its inertia and its derivatives (6, 10) as matrices."""
    sizes = {"slipstream": 0.0, "thrust_arm": [0.0, 0.0]} | sizes
    x, y, z, xz = sizes["inertia"]
    W = pd.DataFrame({C: sizes[C] for C in COEFFICIENTS}).reindex(TERMS).fillna(0.0)
    inertia = [[x, 0, xz], [0, y, 0], [xz, 0, z]]
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
COMMANDS = ["elevator_command", "aileron_command", "rudder_command"]
# White noise of channels that are logged, standard deviation
NOISE = [
    (["airspeed"], 0.3), (FORCES, 0.1), (RATES, 0.005), (EULER, 0.005), (VELOCITY, 0.1),
    (SURFACES, 0.0), (["throttle"], 0.0), (["thrust_x"], 0.0), (["alpha_true"], 0.0),
]  # fmt: skip
# Of the attitude of real sensors: standard deviation [rad], correlation time [s]
ATTITUDE_ERRORS = ((0.01, 5.0), (0.01, 5.0), (0.03, 20.0))
THERMAL = (1.5, 4.0, 25.0)  # speed [m/s], width [s], and distance [s] of thermals
LEG = 15.0  # s between changes of bank and airspeed
BANKS = (-0.5, 0.0, 0.5)  # rad
SPEEDS = (0.85, 1.2)  # over the airspeed of the aircraft


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


def thrust_of(plane, throttle, airspeed):
    return throttle * plane["thrust"] * (1 - airspeed / (2.3 * plane["airspeed"]))


def aerodynamics(plane, lag):
    """Return the coefficients of an aircraft and its thrust, whose servos have a lag [s]."""

    def coefficients(X):
        V, alpha, beta, p, q, r, elevator, aileron, rudder, throttle = X.T
        load = 0.5 * DENSITY * V**2 * plane["wing_area"]
        thrust = thrust_of(plane, throttle, V) / load
        if plane["stalls"]:
            alpha = STALL * np.tanh(alpha / STALL)
        washed = 1 + plane["slipstream"] * thrust
        terms = [np.ones(len(V)), alpha, beta, p, q, r]
        terms += [elevator * washed, aileron, rudder * washed, abs(beta)]
        of_thrust = np.outer(thrust, [1.0, 0.0, 0.0, *plane["thrust_arm"], 0.0])
        return np.column_stack(terms) @ plane["derivatives"].T + of_thrust

    return Aerodynamics(coefficients, [*REGRESSORS, *SURFACES, "throttle"], servos=Servos(lag=lag))


def fly(plane, air, rng, seconds, lag, inputs=None, banks=BANKS, speeds=SPEEDS):
    """Return the true flight of an aircraft, at the rate of its log, with ``inputs`` (n, 3) of the surfaces."""
    n = round(seconds / STEP)
    time = STEP * np.arange(n + 1)
    wind = gusts(rng, n + 1, *air) + STEADY_WIND * bool(air[0])
    if inputs is None:
        has_rudder = plane["derivatives"][:, TERMS.index("rudder")].any()
        inputs = pulses(rng, n, 2 + has_rudder)
    legs = round(seconds / LEG) + 1
    bank = rng.choice(banks, legs)
    speed = plane["airspeed"] * rng.uniform(*speeds, legs)
    commanded = np.zeros((n + 1, 3))

    def law(t, state):
        leg = int(t / LEG)
        held_level = [
            0.5 * (state["theta"] - 0.1) + 0.08 * state["q"],
            0.25 * (bank[leg] - state["phi"]) - 0.05 * state["p"],
            0.0,
        ]
        k = round(t / STEP)
        commanded[k] = np.clip(inputs[min(k, n - 1)] + held_level, -0.4, 0.4)
        throttle = np.clip(0.4 + 0.08 * (speed[leg] - state["airspeed"]), 0.05, 1.0)
        return dict(zip(SURFACES, commanded[k], strict=True)) | {"throttle": throttle}

    start = {"airspeed": plane["airspeed"], "alpha": 0.05, "theta": 0.05, "altitude": 200.0}
    wind = pd.DataFrame(wind, columns=WIND).assign(time=time)
    flown = simulate(
        aerodynamics(plane, lag), aircraft_of(plane), start, law, STEP, duration=seconds,
        air=Air(wind, gusts=None, density=DENSITY), thrust=None,
    )  # fmt: skip
    flown[COMMANDS] = commanded
    flown["thrust_x"] = thrust_of(plane, flown["throttle"], flown["airspeed"])
    return flown.iloc[:n:EVERY].reset_index(drop=True)


def vibration(rng, throttle, dt):
    """Return accelerations and rates (n, 6) of an oscillation with the propeller's speed, sampled without a filter."""
    turns = np.cumsum((rng.uniform(80, 130) + 40 * throttle) * dt)  # [Hz]
    wave = np.sin(2 * np.pi * turns[:, None] + rng.uniform(0, 2 * np.pi, 6))
    return np.sqrt(2) * wave * np.repeat(VIBRATION, 3)


def logged(flown, rng, kind):
    """Return the table of one flight, with the noise of sensors, and other errors of its kind."""
    n = len(flown)
    table = flown.rename(columns={"alpha": "alpha_true"})
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
