"""Flights with known truth for the study: what each regressor was, what turned with the air, what was commanded."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from _jsbsim_flight import FOOT, POUND_FORCE, SLUG, aircraft_of, started
from sklearn.preprocessing import PolynomialFeatures

from skdgp import make_identification_pipeline
from skdgp._flight.channels import COEFFICIENTS, EULER, HAT, RATE_LENGTHS, TRUTH_SUFFIX
from skdgp._flight.frames import euler_to_quaternion, ned_to_body
from skdgp._mechanics.motion import Motion
from skdgp.datasets._brumby import BRUMBY, REGRESSORS, brumby_coefficients, brumby_derivatives
from skdgp.datasets._example_flights import (
    COMMANDS,
    FLIGHT_PLANS,
    MEASURED,
    TRUTH,
    _columns,
    fly_plans,
    measure,
)
from skdgp.dynamics import Aerodynamics, Aircraft, aerodynamic_coefficients, trim

NAMES = (
    "alpha",
    "beta",
    "p",
    "q",
    "r",
    "alpha_dot",
    "beta_dot",
    "elevator",
    "aileron",
    "rudder",
    "throttle",
)
"""Regressors of the set "classical", rates non-dimensional."""
ROTATION, SLOPES = [2, 3, 4], [5, 6]
AIR = {"calm": 0.0, "light": 2.2, "moderate": 4.3}
"""Factors on the gusts of the example flights: a wind of 15 and 30 kt at 6 m, light and moderate of
MIL-F-8785C.
"""
TRIM_SPEED, TRIM_ALTITUDE = 36.0, 220.0


class Log(NamedTuple):
    """A flight, or several after each other, with its truth."""

    table: pd.DataFrame
    """Known columns, those of the truth ending in _true."""
    exact: np.ndarray
    """Regressors `NAMES`, (n, 11), rates relative to the earth."""
    gust: np.ndarray
    """Non-dimensional rates of the air, (n, 3): what the aerodynamics feel is ``exact`` less these.
    """
    truth: np.ndarray
    """Coefficients, (n, 6)."""


class Subject(NamedTuple):
    """An aircraft with known truth."""

    name: str
    aircraft: Aircraft
    logs: dict[str, list[Log]]
    """Training flights by air, one of each seed."""
    test: Log
    """A flight in calm air along another path."""
    trim: np.ndarray
    """Regressors `NAMES` of a trim, (11,)."""
    known: np.ndarray
    """Derivatives there, (6, 11)."""
    speed: float
    """Airspeed there [m/s]."""


class Seen(NamedTuple):
    """What the pipeline makes of a log with sensor noise, and the truth behind it."""

    inputs: dict[str, np.ndarray]
    """Regressors `NAMES`, (n, 11), "measured" and "exact"."""
    targets: dict[str, np.ndarray]
    """Coefficients, (n, 6), "measured" and "exact"."""
    log: Log


def example_subject(seeds: int, duration: float) -> Subject:
    """Return the example aircraft; in calm air it flies once, since only the sensors' noise has seeds there."""
    plans = (FLIGHT_PLANS[2], *[FLIGHT_PLANS[1]] * (1 + seeds * (len(AIR) - 1)))
    factors = [0.0, *(factor for factor in AIR.values() for _ in range(seeds if factor else 1))]
    record, truth = fly_plans(plans, duration, np.array(factors)[:, None], np.random.default_rng(0))
    known, true = _columns(record, truth)
    test, calm, *gusty = (
        _example_log(plan, k, known, true, truth.regressors[:, k]) for k, plan in enumerate(plans)
    )
    logs = {"calm": [calm] * seeds, "light": gusty[:seeds], "moderate": gusty[seeds:]}
    names = [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
    model = Aerodynamics(brumby_coefficients, names, gradient=brumby_derivatives)
    point = trim(model, BRUMBY, TRIM_SPEED, altitude=TRIM_ALTITUDE)
    at = Motion(model, BRUMBY).at(point.state, point.controls).regressors
    slopes = np.column_stack([brumby_derivatives(at), np.zeros(6)])  # none by throttle
    return Subject(
        "example", BRUMBY, logs, test, np.append(at, point.controls["throttle"]), slopes, TRIM_SPEED
    )


def _example_log(plan: Any, k: int, known: dict, true: dict, felt: np.ndarray) -> Log:
    table = pd.DataFrame({name + TRUTH_SUFFIX: true[name][:, k] for name in TRUTH})
    table = table.assign(flight=plan.name, **{name: values[:, k] for name, values in known.items()})
    felt = np.column_stack([felt, table["throttle"]])
    exact = felt.copy()
    for j, name in zip(ROTATION, "pqr", strict=True):
        length = getattr(BRUMBY, RATE_LENGTHS[name])
        exact[:, j] = table[name + TRUTH_SUFFIX] * length / (2 * table["airspeed_true"])
    return Log(
        table,
        exact,
        (exact - felt)[:, ROTATION],
        table[[f"{c}_true" for c in COEFFICIENTS]].to_numpy(),
    )


def seen(log: Log, aircraft: Aircraft, seed: int) -> Seen:
    """Return a log as sensors saw it, through the default pipeline."""
    noisy = measure(log.table, 1.0, np.random.default_rng([1, seed]))
    table = pd.concat([noisy, log.table], axis=1)
    table = table[[name for name in MEASURED if name in table]].copy()
    targets = {"exact": log.truth, "measured": aerodynamic_coefficients(table, aircraft).to_numpy()}
    steps = make_identification_pipeline(aircraft, regressors="classical")[:-2]
    return Seen(
        {"exact": log.exact, "measured": np.asarray(steps.fit_transform(table), dtype=float)},
        targets,
        log,
    )


# -- Cessna 172 of JSBSim
# -----------------------------------------------------------------------------

WIND_AT_20FT = {"calm": 0.0, "light": 15.0, "moderate": 30.0}
"""[kt], MIL-F-8785C as JSBSim flies it."""
HEIGHT = 274.0  # above the ground [m]
KNOTS = {"c172p": 100.0, "c182": 100.0, "t6texan2": 150.0, "T37": 200.0}
"""Calibrated airspeed of aircraft of JSBSim. On the last two of the study, t6texan2 and T37,
nothing was chosen.
"""
KNOTS |= {"J3Cub": 65.0, "DHC6": 130.0, "A4": 350.0, "global5000": 280.0}
KNOTS |= {"737": 250.0, "A320": 250.0, "B747": 280.0, "MD11": 280.0}
# of JSBSim per row; controls change at each of them: held longer, they would lag behind the logged
# loads
FRAMES = 6
SETTLING = 10.0  # s before the log
SURFACES = {"elevator": "elevator", "aileron": "left-aileron", "rudder": "rudder"}
SOURCES = {  # property and factor to SI; forces and moments in newtons
    **{f"{name}_true": (f"aero/{name}-rad", 1.0) for name in ("alpha", "beta")},
    **{f"{name}_dot_true": (f"aero/{name}dot-rad_sec", 1.0) for name in ("alpha", "beta")},
    **{f"{name}_true": (f"attitude/{name}-rad", 1.0) for name in ("phi", "theta", "psi")},
    **{f"{name}_true": (f"velocities/{name}-rad_sec", 1.0) for name in "pqr"},
    **{f"{name}_felt": (f"velocities/{name}-aero-rad_sec", 1.0) for name in "pqr"},
    **{f"v_{name}_true": (f"velocities/v-{name}-fps", FOOT) for name in ("north", "east", "down")},
    **{f"a{axis}_true": (f"forces/fb{axis}-total-lbs", POUND_FORCE) for axis in "xyz"},
    **{f"C{axis.upper()}_true": (f"forces/fb{axis}-aero-lbs", POUND_FORCE) for axis in "xyz"},
    **{f"C{axis}_true": (f"moments/{axis}-aero-lbsft", POUND_FORCE * FOOT) for axis in "lmn"},
    **{f"thrust_{axis}": (f"forces/fb{axis}-prop-lbs", POUND_FORCE) for axis in "xyz"},
    **{f"thrust_{axis}": (f"moments/{axis}-prop-lbsft", POUND_FORCE * FOOT) for axis in "lmn"},
    **{name: (f"fcs/{source}-pos-rad", 1.0) for name, source in SURFACES.items()},
    "throttle": ("fcs/throttle-pos-norm", 1.0),
    "airspeed_true": ("velocities/vt-fps", FOOT),
    "altitude": ("position/h-sl-ft", FOOT),
    "density": ("atmosphere/rho-slugs_ft3", SLUG / FOOT**3),
}


def jsbsim_subject(name: str, seeds: int, duration: float) -> Subject:
    """Return an aircraft of JSBSim; its derivatives are those of third order on exact regressors of all flights."""
    fly = partial(jsbsim_log, name, duration)
    test, aircraft = fly(2, "calm", 0)
    seeded = {
        air: range(1, seeds + 1) if wind else [0] * seeds for air, wind in WIND_AT_20FT.items()
    }
    flown = {
        (air, seed): fly(1, air, seed)[0] for air, all_of in seeded.items() for seed in {*all_of}
    }
    logs = {air: [flown[air, seed] for seed in all_of] for air, all_of in seeded.items()}
    felt = np.concatenate([log.exact for log in flown.values()])
    felt[:, ROTATION] -= np.concatenate([log.gust for log in flown.values()])
    truth, at = np.concatenate([log.truth for log in flown.values()]), test.exact.mean(axis=0)
    known = slopes_of_third_order(felt, truth, at)
    return Subject(name, aircraft, logs, test, at, known, float(test.table["airspeed_true"].mean()))


def slopes_of_third_order(X: np.ndarray, Y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Return the slopes (P, d) at a point (d,) of the polynomial of third order of regressors (n, d)."""
    terms, scale = PolynomialFeatures(3), X.std(axis=0)
    outer, inner = 0.0, 0.0
    for rows in np.array_split(np.arange(len(X)), len(X) // 5000 + 1):
        Q = terms.fit_transform((X[rows] - at) / scale)
        outer, inner = outer + Q.T @ Q, inner + Q.T @ Y[rows]
    return np.linalg.lstsq(outer, inner, rcond=1e-13)[0][1 : X.shape[1] + 1].T / scale


def jsbsim_log(
    model: str, duration: float, number: int, air: str, seed: int
) -> tuple[Log, Aircraft]:
    """Return a flight with the manoeuvres of a plan of the example flights, held level or in slow turns."""
    plan, fdm = FLIGHT_PLANS[number], started(model, 40 * FRAMES, KNOTS[model])
    fdm["ic/h-sl-ft"], fdm["ic/vc-kts"] = HEIGHT / FOOT, KNOTS[model]
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["simulation/do_simple_trim"] = 1
    if WIND_AT_20FT[air]:
        fdm["simulation/randomseed"] = seed
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = WIND_AT_20FT[air] * 1.68781
        fdm["atmosphere/turbulence/milspec/severity"] = 3 if air == "light" else 4
        fdm["atmosphere/turb-type"] = 3
    neutral = {name: fdm[f"fcs/{name}-cmd-norm"] for name in (*SURFACES, "throttle")}
    theta, speed = fdm["attitude/theta-rad"], fdm["velocities/vt-fps"]
    time = np.arange(round((SETTLING + duration) * 40 * FRAMES)) / (40 * FRAMES) - SETTLING
    command = np.column_stack([plan.manoeuvres(axis, time) for axis in COMMANDS]) * [
        1.0,
        1.5,
        1.0,
        1.0,
    ]
    rows = []
    for k, now in enumerate(time):
        phi = 0.3 * np.sin(2 * np.pi * now / (70 + 20 * number))
        climb = np.clip(
            (HEIGHT + 30 * (number == 2 and now > 70) - fdm["position/h-sl-ft"] * FOOT) / 200,
            -0.07,
            0.07,
        )
        surfaces = {
            "elevator": 0.5 * (fdm["attitude/theta-rad"] - theta - climb)
            + 0.15 * fdm["velocities/q-rad_sec"],
            "aileron": 0.25 * (phi - fdm["attitude/phi-rad"]) - 0.05 * fdm["velocities/p-rad_sec"],
            "rudder": 0.1 * fdm["velocities/r-rad_sec"],
        }
        slower = 0.03 * (speed - fdm["velocities/vt-fps"])
        for j, name in enumerate(SURFACES):
            fdm[f"fcs/{name}-cmd-norm"] = neutral[name] + (surfaces[name] + command[k, j]) / 0.35
        fdm["fcs/throttle-cmd-norm"] = np.clip(
            neutral["throttle"] + slower + command[k, 3], 0.1, 1.0
        )
        fdm.run()
        if k % FRAMES == FRAMES - 1:
            rows.append([fdm[source] * factor for source, factor in SOURCES.values()])
    time = time[FRAMES - 1 :: FRAMES]
    aircraft, log = aircraft_of(fdm, model), time >= 0
    return jsbsim_table(
        pd.DataFrame(rows, columns=[*SOURCES])[log], time[log], plan.name, aircraft
    ), aircraft


def jsbsim_table(table: pd.DataFrame, time: np.ndarray, name: str, aircraft: Aircraft) -> Log:
    table = table.reset_index(drop=True)
    table[[f"a{axis}_true" for axis in "xyz"]] /= aircraft.mass
    scale = (
        0.5
        * table["density"].to_numpy()
        * table["airspeed_true"].to_numpy() ** 2
        * aircraft.wing_area
    )
    truth = table[[f"{name}_true" for name in COEFFICIENTS]].to_numpy() / scale[:, None]
    truth[:, 3:] /= aircraft.moment_lengths
    for axis in ("north", "east"):
        table[f"{axis}_true"] = np.cumsum(table[f"v_{axis}_true"]) / 40
    exact = exact_regressors(table, aircraft)
    gust = np.column_stack([table[f"{rate}_true"] - table[f"{rate}_felt"] for rate in "pqr"])
    gust *= hats(table, aircraft)
    table = table.assign(time=time, flight=name, psi_true=table["psi_true"] % (2 * np.pi))
    return Log(table, exact, gust, truth)


def hats(table: pd.DataFrame, aircraft: Aircraft) -> np.ndarray:
    """Return the factors (n, 3) that make p, q, r non-dimensional."""
    lengths = [getattr(aircraft, RATE_LENGTHS[rate]) for rate in "pqr"]
    return np.array(lengths) / (2 * table["airspeed_true"].to_numpy()[:, None])


def exact_regressors(table: pd.DataFrame, aircraft: Aircraft) -> np.ndarray:
    """Return `NAMES` of columns of the truth, (n, 11), rates relative to the earth."""
    exact = np.column_stack(
        [table[name + TRUTH_SUFFIX if name + TRUTH_SUFFIX in table else name] for name in NAMES]
    )
    by = hats(table, aircraft)
    exact[:, ROTATION] *= by
    exact[:, SLOPES] *= by[:, 1:]
    return exact


# -- flights of others
# -------------------------------------------------------------------------------


def milspec_rates(table: pd.DataFrame, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the rates of the air that JSBSim's turbulence makes of its wind, (n, 3) in body axes [rad/s].

    Pitching and yawing lag behind the changes of the velocities w and v (Yeager 1998, eqs 14 and
    18). Rolling is drawn for itself and stays unknown: its axis is along the wind, so with the
    rates comes its part in the pitching, (n,).
    """
    north, east, down = (
        table[f"wind_{axis}_true"].to_numpy() for axis in ("north", "east", "down")
    )
    speed, azimuth = table["airspeed_true"].to_numpy(), np.arctan2(east.mean(), north.mean())
    cos, sin, step = np.cos(azimuth), np.sin(azimuth), np.median(np.diff(table["time"]))

    def lagging(velocity, lengths):
        time, rate = lengths * span / (np.pi * speed), np.zeros(len(velocity))
        keep, gain = np.exp(-step / time), time / step / (lengths * span / np.pi)
        for k in range(1, len(rate)):
            rate[k] = keep[k] * rate[k - 1] + gain[k] * (1 - keep[k]) * (
                velocity[k] - velocity[k - 1]
            )
        return rate

    q, r = lagging(down, 4), lagging(sin * north + cos * east, 3)
    attitude = euler_to_quaternion(*(table[f"{angle}_true"].to_numpy() for angle in EULER))
    axis = ned_to_body(attitude, np.tile([cos, -sin, 0.0], (len(table), 1)))
    return ned_to_body(attitude, np.column_stack([sin * q, cos * q, r])), np.abs(axis[:, 1])
