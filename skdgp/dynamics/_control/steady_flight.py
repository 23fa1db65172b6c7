"""Equations of steady flight, their unknowns and their solution."""

from __future__ import annotations

import numpy as np
from scipy.optimize import least_squares

from skdgp._flight.channels import CHANNELS
from skdgp._flight.checks import check_names
from skdgp._flight.frames import air_velocity, euler_to_quaternion, gravity_in_body_axes
from skdgp.dynamics._equations.motion import Instant, Motion
from skdgp.dynamics._equations.rigid_body import ATTITUDE, RATES, VELOCITY
from skdgp.dynamics._vehicle.loads import FORCE_AXES, MOMENT_AXES, thrust_control

__all__ = ["SteadyFlight"]

SURFACES = ("elevator", "aileron", "rudder", "elevon_left", "elevon_right")
ENGINE = ("thrust", "throttle", "propeller_speed")
THRUSTS = ("thrust", "propeller_speed", *(f"thrust_{axis}" for axis in (*FORCE_AXES, *MOMENT_AXES)))
"""Controls that tell the thrust whatever the engine's own one is."""
ANGLES = {"alpha": (-np.pi / 6, np.pi / 4), "beta": (-np.pi / 6, np.pi / 6), "theta": (-1.4, 1.4), "phi": (-1.5, 1.5)}
OTHERS = {"climb": (-1.4, 1.4), "turn_rate": (-np.inf, np.inf), "thrust": (0.0, np.inf), "throttle": (0.0, 1.0)}
DEFLECTION = np.pi / 4
"""Largest one of a control of a model that does not say what it was learned from."""
REACH = 0.1
"""Least distance by which a control or alpha may leave what a model was learned from [rad]."""
ACCELERATIONS = ("u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot")
TOLERANCE = 1e-6
"""Largest acceleration of a trim [m/s^2, rad/s^2]."""
DEMAND = 100.0
"""Weight of the flight path's slope: where there is no trim, accelerations are left, and the path is as asked."""
ASKED = {"phi": "bank"}
"""What `trim` calls it."""
STEP = 1e-5
"""Of differences of the residual, by an unknown or a fraction of it."""
STARTS = (0.5, 0.25, 0.75, 0.05)
"""Where between its limits alpha starts."""


class SteadyFlight:
    """The equations of a steady flight in the unknowns of one aircraft.

    Parameters
    ----------
    motion : Motion
    given : dict
        Values of altitude, climb, turn_rate, phi, beta; None where one is unknown.
    controls, fixed, limits
        As for :func:`skdgp.dynamics.trim`.
    """

    def __init__(self, motion: Motion, given: dict, controls, fixed: dict, limits: dict):
        self.motion, self.fixed = motion, fixed
        _check_given(given, fixed)
        self.flown = _flown(motion)
        self.controls = self._controls(controls)
        self.given = {name: value for name, value in given.items() if value is not None}
        if "beta" not in self.given and len(self.controls) >= 4 - ("climb" not in self.given):
            self.given |= {} if {"phi", "turn_rate"} <= set(self.given) else {"beta": 0.0}
        flight = [name for name in ("alpha", "beta", "theta", "phi", "turn_rate", "climb") if name not in self.given]
        self.unknowns = (*flight, *self.controls)
        if len(self.unknowns) > 7:
            raise ValueError(
                f"Got {len(self.unknowns)} unknowns, {', '.join(self.unknowns)}, but a steady flight has 7 equations: "
                f"give the value of {len(self.unknowns) - 7} more, controls as fixed={{name: value}}."
            )
        self.limits = {name: self._limits(name) for name in self.unknowns}
        check_names(limits, (*self.unknowns, *fixed), "unknowns of this trim, and the limits given with them,")
        for name, pair in limits.items():
            if np.shape(pair) != (2,):
                raise ValueError(f"Got limits of {name} {pair!r}, but expected two numbers, smallest and largest.")
        self.limits |= {name: tuple(map(float, pair)) for name, pair in limits.items() if name in self.unknowns}
        for name, (low, high) in self.limits.items():
            if not low < high:
                raise ValueError(f"Got limits of {name} from {low:g} to {high:g}, but expected smallest < largest.")

    def _controls(self, controls) -> tuple[str, ...]:
        """Return the controls to solve for; those that remain are fixed."""
        motion, engine = self.motion, thrust_control(self.motion.aircraft, self.motion.thrust)
        if engine is not None and motion.aircraft.propeller is not None and "propeller_speed" in motion.controls:
            engine = "propeller_speed"
        if motion.thrust == "auto" and any(name in self.fixed for name in THRUSTS):
            engine = None
        needed = dict.fromkeys([*motion.controls, *([] if engine is None else [engine])])
        check_names(controls or (), needed, "controls of the model and the engine")
        check_names(self.fixed, (*needed, *THRUSTS), "controls of the model and the engine")
        for name in needed:
            if name in ENGINE and name != engine and name not in self.fixed and name in self.flown:
                self.fixed[name] = float(np.mean(self.flown[name]))
        free = [name for name in needed if name not in self.fixed]
        lacking = [name for name in free if controls is not None and name not in controls]
        lacking += [n for n in free if n != engine and (n in ENGINE or (n in CHANNELS and n not in SURFACES))]
        if lacking:
            raise ValueError(
                f"The trim lacks values of {lacking}, which no steady flight determines: give fixed="
                f"{{{lacking[0]!r}: value}}."
            )
        return tuple(free)

    def _limits(self, name: str) -> tuple[float, float]:
        if name in OTHERS:
            return OTHERS[name]
        if name == "propeller_speed":
            propeller = self.motion.aircraft.propeller
            return propeller.speed_range or (0.0, np.inf)
        if name in ("theta", "phi", "beta") or name not in self.flown:
            return ANGLES.get(name, (-DEFLECTION, DEFLECTION))
        low, high = self.flown[name]
        reach = max(high - low, REACH)
        return low - reach, high + reach

    def solve(self, airspeed: float, near=None) -> np.ndarray:
        """Return the values of the unknowns, searched ``near`` those of another flight, and elsewhere."""
        low, high = np.array([self.limits[name] for name in self.unknowns]).T
        best = None
        for start in ([] if near is None else [near]) + [self._start(airspeed, part) for part in STARTS]:
            margin = 1e-6 * np.minimum(high - low, 1.0)
            solution = least_squares(
                self.residual, np.clip(start, low + margin, high - margin), jac=self._slopes, args=(airspeed,),
                bounds=(low, high), x_scale="jac", xtol=1e-15, ftol=1e-15, gtol=1e-15, max_nfev=200,
            )  # fmt: skip
            if best is None or solution.cost < best.cost:
                best = solution
            if np.abs(best.fun).max() < TOLERANCE:
                break
        if not np.abs(best.fun).max() < TOLERANCE:
            raise ValueError(self._why(best, airspeed))
        return best.x

    def _start(self, airspeed: float, part: float) -> np.ndarray:
        start = {name: min(max(0.0, low), high) for name, (low, high) in self.limits.items()}
        given = {"climb": 0.0, "turn_rate": 0.0, "phi": 0.0} | self.given
        if "alpha" in start:
            low, high = self.flown.get("alpha", (-0.1, 0.3))
            start["alpha"] = low + part * (high - low)
            start["theta"] = start["alpha"] + given["climb"]
        if "phi" in start:
            start["phi"] = np.arctan(airspeed * given["turn_rate"] / self.motion.gravity)
        if "turn_rate" in start:
            start["turn_rate"] = self.motion.gravity * np.tan(given["phi"]) / airspeed
        if "thrust" in start:
            start["thrust"] = 0.15 * self.motion.aircraft.mass * self.motion.gravity
        if "throttle" in start:
            start["throttle"] = 0.5
        if "propeller_speed" in start:  # at half the turns of an advance ratio of 1
            start["propeller_speed"] = 4.0 * np.pi * airspeed / self.motion.aircraft.propeller.diameter
        return np.array([start[name] for name in self.unknowns])

    def flight(self, x, airspeed: float) -> tuple[dict, np.ndarray, dict]:
        """Return what flies by name, its state, its controls, at unknowns (..., k)."""
        known = self.given | dict(zip(self.unknowns, np.moveaxis(x, -1, 0), strict=True))
        state = np.zeros((*x.shape[:-1], 13))
        state[..., 2] = -known["altitude"]
        state[..., VELOCITY] = air_velocity(airspeed, known["alpha"], known["beta"])
        state[..., ATTITUDE] = euler_to_quaternion(known["phi"], known["theta"], 0.0)
        vertical = gravity_in_body_axes(known["phi"], known["theta"], 1.0)
        state[..., RATES] = np.asarray(known["turn_rate"])[..., None] * vertical
        return known, state, self.fixed | {name: known[name] for name in self.controls}

    def instant(self, known, state, controls) -> Instant:
        """Return what happens in this flight; regressors that follow from loads start from those of a steady one."""
        steady = np.zeros((*state.shape[:-1], 8))
        weight = gravity_in_body_axes(known["phi"], known["theta"], self.motion.gravity)
        steady[..., 5:] = np.cross(state[..., RATES], state[..., VELOCITY]) - weight
        return self.motion.at(state, controls, implicit=steady)

    def residual(self, x, airspeed: float) -> np.ndarray:
        """Return the six accelerations, and how far the path is from that asked for, (..., 7)."""
        known, state, controls = self.flight(x, airspeed)
        derivative = self.instant(known, state, controls).derivative
        if not np.isfinite(derivative).all():
            raise ValueError(
                f"Got rates of change that are not finite at airspeed {airspeed:g} m/s, alpha "
                f"{np.mean(known['alpha']):.3g} rad, but expected six accelerations: the model, the thrust or the air "
                "is not defined there."
            )
        path = DEMAND * (-derivative[..., 2] / airspeed - np.sin(known["climb"]))
        return np.concatenate([derivative[..., VELOCITY], derivative[..., RATES], path[..., None]], axis=-1)

    def _slopes(self, x, airspeed: float) -> np.ndarray:
        """Return d residual / d unknowns by central differences, all points at once."""
        steps = STEP * np.maximum(1.0, np.abs(x))
        more, less = self.residual(x + np.stack([np.diag(steps), -np.diag(steps)]), airspeed)
        return (more - less).T / (2.0 * steps)

    def _why(self, best, airspeed: float) -> str:
        """Say what is left where the search ended, and what stands at a limit."""
        left = [
            f"{name} = {value:.3g} {'m' if name[0] in 'uvw' else 'rad'}/s^2"
            for name, value in zip(ACCELERATIONS, best.fun[:6], strict=True)
            if abs(value) > 0.01 * np.abs(best.fun[:6]).max()
        ]
        at = []
        for name, value in zip(self.unknowns, best.x, strict=True):
            low, high = self.limits[name]
            reach = 1e-3 * (high - low if np.isfinite(high - low) else 1.0)
            at += [f"{name} at its limit {limit:.4g}" for limit in (low, high) if abs(value - limit) < reach]
        todo = "Ask for another airspeed, climb or turn, or widen limits={name: (lowest, highest)} if these are not it"
        if not at:
            todo = (
                f"Nothing is at a limit: {', '.join(self.unknowns)} cannot balance it. Ask for another airspeed (too "
                "slow, it stalls), free a control, or let the path follow (climb=None: no thrust holds it)"
            )
        return (
            f"There is no trim of {self.motion.aircraft.name} at {self._asked(airspeed)}: nearest to it are left "
            f"{', '.join(left)}{', with ' + ', '.join(at) if at else ''}. {todo}."
        )

    def _asked(self, airspeed: float) -> str:
        units = {"altitude": "m", "turn_rate": "rad/s"}
        asked = [f"{name} {value:g} {units.get(name, 'rad')}" for name, value in self.given.items()]
        return ", ".join([f"airspeed {airspeed:g} m/s", *asked, *(f"{n} {v:g}" for n, v in self.fixed.items())])


def _check_given(given: dict, fixed: dict) -> None:
    """Raise a ValueError at what is asked for that is no number, or an angle in degrees."""
    for name, value in (given | fixed).items():
        if value is not None and not (np.ndim(value) == 0 and np.isreal(value) and np.isfinite(value)):
            raise ValueError(f"Got {ASKED.get(name, name)}={value!r}, but expected a finite number.")
        if name in ("climb", "phi", "beta") and value is not None and abs(value) >= np.pi / 2:
            raise ValueError(
                f"Got {ASKED.get(name, name)}={value:g}, but expected radians, less than {np.pi / 2:.3f}: if these are "
                "degrees, use numpy.deg2rad."
            )


def _flown(motion: Motion) -> dict[str, tuple[float, float]]:
    """Return what the model was learned from, by name, of the regressors that are no scaled rates."""
    aerodynamics = motion.aerodynamics
    if aerodynamics.limits is None:
        return {}
    pairs = zip(aerodynamics.regressors, motion.regressors, *aerodynamics.limits.tolist(), strict=True)
    return {name: (low, high) for full, name, low, high in pairs if "_hat" not in full}
