"""Aircraft with known truth that fly given inputs: an autopilot between manoeuvres, held controls during them."""

from collections.abc import Sequence
from functools import lru_cache, partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from _jsbsim_flight import FOOT, aircraft_of, started
from _study_flights import SOURCES, SURFACES, Log, _example_log, jsbsim_table

from skdgp.datasets._brumby import BRUMBY
from skdgp.datasets._example_flights import (
    TIME_CONSTANTS,
    FlightControls,
    FlightPlan,
    _columns,
    fly_plans,
)
from skdgp.design import (
    Limits,
    Wavetrain,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
    wavetrain,
)
from skdgp.dynamics import Aircraft

AXES = ("elevator", "aileron", "rudder")
PAUSE = 3.0
"""Between the manoeuvres of a first flight [s]."""
WIND = {"calm": 0.0, "light": 7.7, "moderate": 15.0}
"""6 m above the ground [m/s]: MIL-F-8785C."""
SETTLING, FRAMES = 10.0, 3  # s before a log of JSBSim; its steps per row
TRIMMING = 5.0
"""Time over which a pilot forms the mean of the controls that he then holds [s]."""
COMMANDED = np.linspace(-1.0, 1.0, 41)
STRAIGHT = ((-99.0, -1e6, 0.0, 1e6),)


class Sortie(NamedTuple):
    """Inputs to fly."""

    train: Wavetrain
    busy: Sequence[tuple[float, float]]
    """Beginnings and ends of the manoeuvres [s]: controls are held."""

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return when controls are held, (n,)."""
        return np.any([(time >= start - 1e-6) & (time < end) for start, end in self.busy], axis=0)

    def pauses(self, seconds: float) -> list[tuple[float, float]]:
        """Return beginnings and ends of the pauses after the manoeuvres [s]."""
        starts = [start for start, _ in self.busy]
        return list(zip((end for _, end in self.busy), [*starts[1:], seconds], strict=True))


class Subject(NamedTuple):
    """An aircraft with known truth."""

    name: str
    aircraft: Aircraft
    airspeed: float
    altitude: float
    limits: dict[str, float]
    width: float
    """Of the doublets of its first flight [s]."""
    fly: Any
    """Sorties, seconds, air and seed to logs."""
    lag: float = 0.0
    """Time constant of its servos [s]."""

    @property
    def allowed(self) -> dict[str, Limits]:
        """Limits of the axes, as a planner knows them."""
        return {axis: Limits(size, lag=self.lag) for axis, size in self.limits.items()}


def sortie(manoeuvres: Sequence[dict], pause: float = PAUSE) -> Sortie:
    """Return manoeuvres one after another."""
    busy, start = [], pause
    for one in manoeuvres:
        end = start + max(signal.duration for signal in one.values())
        busy.append((start, end))
        start = end + pause
    return Sortie(wavetrain(manoeuvres, pause=pause), busy)


def exploratory(subject: Subject, share: float = 0.5, stretch: float = 1.0) -> Sortie:
    """Return the first flight: a multisine, doublets and 3-2-1-1s, as large as a share of the limits."""
    limits = {axis: share * limit for axis, limit in subject.limits.items()}
    steps = [
        {axis: make(width, limits[axis])}
        for make, width in (
            (doublet, stretch * subject.width),
            (three_two_one_one, 0.7 * stretch * subject.width),
        )
        for axis in AXES
    ]
    return sortie([orthogonal_multisines(limits, 10.0, (0.2, 1.5), n_tones=4, n_starts=2), *steps])


# -- example aircraft
# ---------------------------------------------------------------------------------


class _Held:
    """An autopilot whose mean commands are held where a flight is busy, (n_steps, n_flights)."""

    def __init__(self, autopilot: Any, busy: np.ndarray):
        self.autopilot, self.busy, self.k = autopilot, busy, -1
        self.share = autopilot.step / TRIMMING

    def command(self, *seen: Any) -> np.ndarray:
        self.k += 1
        kept = {
            name: value.copy()
            for name, value in vars(self.autopilot).items()
            if name.endswith("integral")
        }
        found, held = self.autopilot.command(*seen), self.busy[self.k]
        if self.k == 0:
            self.mean = found
        if held.any():
            for name, before in kept.items():
                setattr(self.autopilot, name, np.where(held, before, getattr(self.autopilot, name)))
            found = np.where(held[:, None], self.mean, found)
        self.mean = self.mean + self.share * (found - self.mean)
        return found


def _held_controls(
    sorties: Sequence[Sortie], plans: Any, time: np.ndarray, step: float
) -> FlightControls:
    controls = FlightControls(plans, time, step)
    controls.autopilot._bank = lambda seen, orbit: np.zeros(len(sorties))  # type: ignore[method-assign]
    controls.autopilot = _Held(
        controls.autopilot, np.stack([one.at(time) for one in sorties], axis=1)
    )
    return controls


def fly_example(sorties: Sequence[Sortie], seconds: float, air: str, seed: Any) -> list[Log]:
    """Return the logs of the example aircraft, each in gusts of its own."""
    plans = tuple(
        FlightPlan(
            f"{seed}-{k}",
            STRAIGHT,
            ((-99.0, 200.0),),
            ((-99.0, 35.0),),
            (3.0, -1.5, 0.0),
            WIND[air],
            one.train,
        )
        for k, one in enumerate(sorties)
    )
    rng = np.random.default_rng(seed)
    flown = fly_plans(plans, seconds, 1.0, rng, controls_of=partial(_held_controls, sorties))
    known, true = _columns(*flown)
    return [
        _example_log(plan, k, known, true, flown[1].regressors[:, k])
        for k, plan in enumerate(plans)
    ]


# -- aircraft of JSBSim
# -------------------------------------------------------------------------------


def jsbsim_subject(
    model: str, knots: float, height: float, limits: dict[str, float], width: float
) -> Subject:
    fdm = _at_trim(model, knots, height)
    speed = fdm["velocities/vt-fps"] * FOOT
    return Subject(
        model,
        aircraft_of(fdm, model),
        speed,
        height,
        limits,
        width,
        partial(fly_jsbsim, model, knots, height),
    )


def _at_trim(model: str, knots: float, height: float) -> Any:
    fdm = started(model, 40 * FRAMES)
    fdm["ic/h-sl-ft"], fdm["ic/vc-kts"] = height / FOOT, knots
    fdm.run_ic()
    fdm["propulsion/set-running"] = -1
    fdm["simulation/do_simple_trim"] = 1
    return fdm


def fly_jsbsim(
    model: str,
    knots: float,
    height: float,
    sorties: Sequence[Sortie],
    seconds: float,
    air: str,
    seed: Any,
) -> list[Log]:
    """Return the logs of an aircraft of JSBSim."""
    return [
        _flown_jsbsim(model, knots, height, one, seconds, air, [*np.atleast_1d(seed), k])
        for k, one in enumerate(sorties)
    ]


def _flown_jsbsim(
    model: str,
    knots: float,
    height: float,
    one: Sortie,
    seconds: float,
    air: str,
    seed: Sequence[int],
) -> Log:
    fdm = _at_trim(model, knots, height)
    if WIND[air]:
        fdm["simulation/randomseed"] = int(np.random.default_rng(seed).integers(1, 2**31 - 1))
        fdm["atmosphere/turbulence/milspec/windspeed_at_20ft_AGL-fps"] = WIND[air] / FOOT
        fdm["atmosphere/turbulence/milspec/severity"] = 3 if air == "light" else 4
        fdm["atmosphere/turb-type"] = 3
    neutral = {name: fdm[f"fcs/{name}-cmd-norm"] for name in (*SURFACES, "throttle")}
    linkage = _linkage(model, knots, height)
    trimmed = {
        name: np.interp(value, COMMANDED, linkage[name])
        for name, value in neutral.items()
        if name in linkage
    }
    theta, speed = fdm["attitude/theta-rad"], fdm["velocities/vt-fps"]
    time = np.arange(round((SETTLING + seconds) * 40 * FRAMES)) / (40 * FRAMES) - SETTLING
    command, busy = np.stack([one.train(axis, time) for axis in AXES], axis=1), one.at(time)
    feedback, throttle, rows = dict.fromkeys(SURFACES, 0.0), neutral["throttle"], []
    for k in range(len(time)):
        if busy[k]:
            feedback = dict.fromkeys(SURFACES, 0.0)  # the trim
        else:
            climb = np.clip((height - fdm["position/h-sl-ft"] * FOOT) / 200, -0.07, 0.07)
            feedback = {
                "elevator": 0.5 * (fdm["attitude/theta-rad"] - theta - climb)
                + 0.15 * fdm["velocities/q-rad_sec"],
                "aileron": -0.25 * fdm["attitude/phi-rad"] - 0.05 * fdm["velocities/p-rad_sec"],
                "rudder": 0.1 * fdm["velocities/r-rad_sec"],
            }
            throttle = np.clip(
                neutral["throttle"] + 0.03 * (speed - fdm["velocities/vt-fps"]), 0.1, 1.0
            )
        for j, name in enumerate(SURFACES):
            deflection = trimmed[name] + feedback[name] + command[k, j]
            fdm[f"fcs/{name}-cmd-norm"] = np.interp(deflection, linkage[name], COMMANDED)
        fdm["fcs/throttle-cmd-norm"] = throttle
        fdm.run()
        if k % FRAMES == FRAMES - 1:
            rows.append([fdm[source] * factor for source, factor in SOURCES.values()])
    time = time[FRAMES - 1 :: FRAMES]
    table = pd.DataFrame(rows, columns=[*SOURCES])[time >= 0]
    return jsbsim_table(table, time[time >= 0], "-".join(map(str, seed)), aircraft_of(fdm, model))


@lru_cache
def _linkage(model: str, knots: float, height: float) -> dict[str, np.ndarray]:
    """Return deflections [rad] at `COMMANDED`: ailerons go further up than down."""
    fdm, found = _at_trim(model, knots, height), {}
    for name, source in SURFACES.items():
        before, found[name] = fdm[f"fcs/{name}-cmd-norm"], np.empty(len(COMMANDED))
        for k, command in enumerate(COMMANDED):
            fdm[f"fcs/{name}-cmd-norm"] = command
            for _ in range(40 * FRAMES // 10):
                fdm.run()
            found[name][k] = fdm[f"fcs/{source}-pos-rad"]
        fdm[f"fcs/{name}-cmd-norm"] = before
    return found


SUBJECTS = {
    "example": lambda: Subject(
        "example",
        BRUMBY,
        35.0,
        200.0,
        {"elevator": 0.08, "aileron": 0.12, "rudder": 0.16},
        0.5,
        fly_example,
        TIME_CONSTANTS[0],
    ),
    "c172p": lambda: jsbsim_subject(
        "c172p", 100.0, 274.0, {"elevator": 0.07, "aileron": 0.15, "rudder": 0.12}, 0.7
    ),
    "t6texan2": lambda: jsbsim_subject(
        "t6texan2", 150.0, 1000.0, {"elevator": 0.05, "aileron": 0.1, "rudder": 0.1}, 0.6
    ),
}
