"""Trim: attitude and controls of steady flight, straight or turning, level or climbing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Array
from skdgp._flight.channels import ALL_SURFACES, CHANNELS, COEFFICIENTS
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.checks import check_names, degrees_error
from skdgp._flight.frames import air_velocity, cross, euler_to_quaternion, gravity_in_body_axes
from skdgp.dynamics._aerodynamics import Aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._jacobian import check_settled
from skdgp.dynamics._loads import CENTRED, Thrust, aerodynamic_loads, thrust_control
from skdgp.dynamics._motion import DEFLECTION, IMPLICIT, PROPULSION, Instant, Motion
from skdgp.dynamics._rigid_body import ATTITUDE, RATES, VELOCITY

ENGINE, THRUSTS = PROPULSION[:3], PROPULSION[1:]
"""Controls that give the thrust of any engine."""
ANGLES = {
    "alpha": (-np.pi / 6, np.pi / 4),
    "beta": (-np.pi / 6, np.pi / 6),
    "theta": (-1.4, 1.4),
    "phi": (-1.5, 1.5),
}
OTHERS = {
    "climb": (-1.4, 1.4),
    "turn_rate": (-np.inf, np.inf),
    "thrust": (0.0, np.inf),
    "throttle": (0.0, 1.0),
}
LEAST_MARGIN = 0.1
"""Least distance by which a control or alpha may leave what a model was learned from [rad]."""
ACCELERATIONS = ("u_dot", "v_dot", "w_dot", "p_dot", "q_dot", "r_dot")
TOLERANCE = 1e-6
"""Largest acceleration of a trim [m/s^2, rad/s^2]."""
DEMAND = 100.0
"""Weight of the flight path's slope: where there is no trim, accelerations remain, and the path is
as given.
"""
JACOBIAN_STEP = 1e-5
"""Of differences of the residual, by an unknown or a fraction of it."""
STARTS = (0.5, 0.25, 0.75, 0.05)
"""Where between its limits alpha starts."""


@dataclass(frozen=True, eq=False)
class Trim:
    """A steady flight: airspeed [m/s], altitude [m], angles and that of the path, climb [rad], turn rate [rad/s]."""

    state: Array
    """(13,), see `STATE_NAMES`; above the origin, heading north."""
    controls: dict
    """All that the model and the engine need."""
    airspeed: float
    altitude: float
    climb: float
    turn_rate: float
    alpha: float
    beta: float
    phi: float
    theta: float
    rates: Array
    """p, q, r [rad/s]."""
    coefficients: Array
    """CX CY CZ Cl Cm Cn."""
    thrust: float
    """Of the engine, along its line [N]."""
    solved: tuple[str, ...]
    """The unknowns; the rest was given."""
    residual: float
    """The largest acceleration that remains [m/s^2 or rad/s^2]."""
    beyond: dict
    """Regressors outside what the model was learned from: name to (value, smallest, largest)."""

    def __repr__(self) -> str:
        named = {
            name: getattr(self, name)
            for name in ("climb", "turn_rate", "alpha", "beta", "phi", "theta")
        }
        parts = [f"{name} {value:.4g}" for name, value in (named | self.controls).items()]
        parts += [f"beyond what was flown in {', '.join(self.beyond)}"] if self.beyond else []
        return f"Trim({self.airspeed:g} m/s, {', '.join(parts)})"

    def to_frame(self) -> pd.DataFrame:
        """Return the trim as a table of one row; ``beyond`` lists names."""
        names = ("airspeed", "altitude", "climb", "turn_rate", "alpha", "beta", "phi", "theta")
        named = {name: getattr(self, name) for name in names}
        named |= (
            dict(zip(RATE_NAMES, self.rates, strict=True)) | self.controls | {"thrust": self.thrust}
        )
        named |= dict(zip(COEFFICIENTS, self.coefficients, strict=True))
        return pd.DataFrame([named | {"residual": self.residual, "beyond": ", ".join(self.beyond)}])


def trim(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    airspeed: ArrayLike,
    *,
    altitude: float = 0.0,
    climb: float | None = 0.0,
    turn_rate: float | None = None,
    bank: float | None = None,
    beta: float | None = None,
    controls: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    thrust: Thrust = "auto",
    air: Any = None,
) -> Trim | list[Trim]:
    r"""Return the steady flight of an aircraft at an airspeed.

    Six accelerations vanish and the flight path has its angle (Stevens, Lewis & Johnson 2016,
    section 3.6),

    .. math:: \dot u = \dot v = \dot w = \dot p = \dot q = \dot r = 0, \quad
        \dot h = V \sin\gamma, \quad (p, q, r) = \dot\psi\,(-\sin\theta, \sin\phi\cos\theta,
        \cos\phi\cos\theta).

    The unknowns are alpha, theta, phi and four controls: those of the model, and the one that sets
    the thrust. With ``bank`` the turn rate is unknown instead of phi. Sideslip is unknown, instead
    of zero, where there are fewer controls, as without a rudder, or where both ``bank`` and
    ``turn_rate`` are given (a steady sideslip). Raises ValueError if there is no such flight, with
    the accelerations that remain and the unknowns at a limit; if a given value is not finite, or an
    angle of 90 degrees or more.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    airspeed : float or array-like of shape (n,)
        [m/s]; several give a list of trims.
    altitude : float
        [m]; a climb is steady at the density of this altitude.
    climb : float or None
        Angle of the flight path [rad]; None: unknown, for a thrust that is ``fixed`` or None.
    turn_rate, bank : float, optional
        Rate of change of heading [rad/s], or phi [rad]; neither: straight flight.
    beta : float, optional
        Sideslip [rad]; by default 0 where four controls can hold it.
    controls : sequence of str, optional
        The controls that are unknown, at most four; by default all that are not ``fixed``.
    fixed : mapping of str to float, optional
        Values of other controls. A ``throttle`` that the model knows but that does not set the
        thrust (an aircraft without a propeller) is by default the middle of what was flown.
    limits : mapping of str to pair of float, optional
        Of controls, alpha, beta, phi, theta. By default controls and alpha may leave what the model
        was learned from by the width of it on either side, at least 0.1 rad; surfaces reach 45
        degrees where that is unknown; ``throttle`` is 0 to 1, ``thrust`` > 0.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; of the air, density and gravity count.

    Returns
    -------
    Trim or list of Trim

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, trim
    >>> def linear(X):
    ...     alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    ...     lift = 0.3 + 4.5 * alpha
    ...     return np.stack([-0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
    ...                      -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
    ...                      0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> level, turning = (trim(Aerodynamics(linear, names), aircraft, 20.0, bank=phi) for phi in (0.0, 0.5))
    >>> round(level.alpha, 4), round(level.controls["elevator"], 4), round(level.controls["thrust"], 2)
    (0.0154, 0.0107, 12.16)
    >>> round(turning.turn_rate, 3), round(float(9.80665 * np.tan(0.5) / 20.0), 3)
    (0.264, 0.268)
    """
    motion = Motion(model, aircraft, thrust=thrust, air=air)
    airspeeds = np.asarray(airspeed, dtype=float)
    if airspeeds.ndim > 1 or not np.all(np.isfinite(airspeeds) & (airspeeds > 0)):
        raise ValueError(f"Got airspeed={airspeed!r}, but expected one or more numbers > 0 [m/s].")
    given = {
        "altitude": altitude,
        "climb": climb,
        "turn_rate": turn_rate,
        "phi": bank,
        "beta": beta,
    }
    if bank is None and turn_rate is None:
        given["turn_rate"] = 0.0
    steady = SteadyFlight(motion, given, controls, dict(fixed or {}), dict(limits or {}))
    found: list[Trim] = []
    near = None
    for one in np.atleast_1d(airspeeds).tolist():
        near = steady.solve(one, near)
        found.append(_trim_of(steady, near, one))
    return found if airspeeds.ndim else found[0]


def _trim_of(steady: SteadyFlight, x: Array, airspeed: float) -> Trim:
    """Return the trim at values of the unknowns."""
    known, state, controls = steady.flight(x, airspeed)
    now = steady.instant(known, state, controls)
    check_settled(now)
    aerodynamics = steady.motion.aerodynamics
    limits = [[], []] if aerodynamics.limits is None else aerodynamics.limits.tolist()
    bounds = zip(
        aerodynamics.regressors,
        now.regressors.tolist(),
        *limits,
        strict=aerodynamics.limits is not None,
    )
    aircraft = steady.motion.aircraft
    engine = now.force - aerodynamic_loads(now.coefficients, now.airspeed, now.density, aircraft)[0]
    named = {
        k: float(known[k])
        for k in ("altitude", "climb", "turn_rate", "alpha", "beta", "phi", "theta")
    }
    return Trim(
        state=state,
        controls={name: float(value) for name, value in controls.items()},
        airspeed=airspeed,
        **named,
        rates=state[RATES].copy(),
        coefficients=now.coefficients,
        thrust=float(engine @ (aircraft.thrust_line or CENTRED).direction),
        solved=steady.unknowns,
        residual=float(np.abs(steady.residual(x, airspeed)[:6]).max()),
        beyond={
            name: (value, low, high)
            for name, value, low, high in bounds
            if not low <= value <= high
        },
    )


class SteadyFlight:
    """The equations of a steady flight in the unknowns of one aircraft.

    ``given`` holds altitude, climb, turn_rate, phi, beta; None is an unknown. The other fields are
    those of `trim`.
    """

    def __init__(
        self, motion: Motion, given: dict, controls: Sequence[str] | None, fixed: dict, limits: dict
    ):
        self.motion, self.fixed = motion, fixed
        _check_given(given, fixed)
        # what the model was learned from, by name, of the regressors that are no scaled rates
        self.flown = {}
        if (learned := motion.aerodynamics.limits) is not None:
            pairs = zip(
                motion.aerodynamics.regressors, motion.regressors, learned.T.tolist(), strict=True
            )
            self.flown = {
                name: (low, high) for full, name, (low, high) in pairs if "_hat" not in full
            }
        self.controls = self._controls(controls)
        self.given = {name: value for name, value in given.items() if value is not None}
        if "beta" not in self.given and len(self.controls) >= 4 - ("climb" not in self.given):
            self.given |= {} if {"phi", "turn_rate"} <= set(self.given) else {"beta": 0.0}
        flight = [
            name
            for name in ("alpha", "beta", "theta", "phi", "turn_rate", "climb")
            if name not in self.given
        ]
        self.unknowns = (*flight, *self.controls)
        if len(self.unknowns) > 7:
            raise ValueError(
                f"Got {len(self.unknowns)} unknowns, {', '.join(self.unknowns)}, but a steady "
                f"flight has 7 equations: "
                f"give the value of {len(self.unknowns) - 7} more, controls as "
                f"fixed={{name: value}}."
            )
        self.limits = {name: self._limits(name) for name in self.unknowns}
        check_names(
            limits,
            (*self.unknowns, *fixed),
            "unknowns of this trim, and the limits given with them,",
        )
        for name, pair in limits.items():
            if np.shape(pair) != (2,) or not pair[0] < pair[1]:
                raise ValueError(
                    f"Got limits of {name} {pair!r}, but expected two numbers, smallest < largest."
                )
        self.limits |= {
            name: tuple(map(float, pair)) for name, pair in limits.items() if name in self.unknowns
        }

    def _controls(self, controls: Sequence[str] | None) -> tuple[str, ...]:
        """Return the controls to solve for; those that remain are fixed."""
        motion, engine = self.motion, thrust_control(self.motion.aircraft, self.motion.thrust)
        if (
            engine is not None
            and motion.aircraft.propeller is not None
            and "propeller_speed" in motion.controls
        ):
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
        lacking += [
            n
            for n in free
            if n != engine and (n in ENGINE or (n in CHANNELS and n not in ALL_SURFACES))
        ]
        if lacking:
            raise ValueError(
                f"The trim lacks values of {lacking}, which no steady flight determines: give "
                f"fixed="
                f"{{{lacking[0]!r}: value}}."
            )
        return tuple(free)

    def _limits(self, name: str) -> tuple[float, float]:
        if name in OTHERS:
            return OTHERS[name]
        if name == "propeller_speed":
            idle, full = getattr(self.motion.aircraft.propeller, "speed_range", None) or (
                0.0,
                np.inf,
            )
            return idle, full
        if name in ("theta", "phi", "beta") or name not in self.flown:
            return ANGLES.get(name, (-DEFLECTION, DEFLECTION))
        low, high = self.flown[name]
        margin = max(high - low, LEAST_MARGIN)
        return low - margin, high + margin

    def solve(self, airspeed: float, near: Array | None = None) -> Array:
        """Return the values of the unknowns, searched first ``near`` those of another flight."""
        low, high = np.array([self.limits[name] for name in self.unknowns]).T
        best: Any = None
        for start in ([] if near is None else [near]) + [
            self._start(airspeed, part) for part in STARTS
        ]:
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

    def _start(self, airspeed: float, part: float) -> Array:
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
        if (
            "propeller_speed" in start and self.motion.aircraft.propeller is not None
        ):  # an advance ratio of 1/2
            start["propeller_speed"] = (
                4.0 * np.pi * airspeed / self.motion.aircraft.propeller.diameter
            )
        return np.array([start[name] for name in self.unknowns])

    def flight(self, x: Array, airspeed: float) -> tuple[dict, Array, dict]:
        """Return the flight by name, its state and its controls, at unknowns (..., k)."""
        known = self.given | dict(zip(self.unknowns, np.moveaxis(x, -1, 0), strict=True))
        state = np.zeros((*x.shape[:-1], 13))
        state[..., 2] = -known["altitude"]
        state[..., VELOCITY] = air_velocity(airspeed, known["alpha"], known["beta"])
        state[..., ATTITUDE] = euler_to_quaternion(known["phi"], known["theta"], 0.0)
        vertical = gravity_in_body_axes(known["phi"], known["theta"], 1.0)
        state[..., RATES] = np.asarray(known["turn_rate"])[..., None] * vertical
        return known, state, self.fixed | {name: known[name] for name in self.controls}

    def instant(self, known: dict, state: Array, controls: dict) -> Instant:
        """Return what happens in this flight; implicit regressors are searched from those of a steady one."""
        steady = np.zeros((*state.shape[:-1], len(IMPLICIT)))
        weight = gravity_in_body_axes(known["phi"], known["theta"], self.motion.gravity)
        steady[..., 5:] = cross(state[..., RATES], state[..., VELOCITY]) - weight
        return self.motion.at(state, controls, implicit=steady)

    def residual(self, x: Array, airspeed: float) -> Array:
        """Return the six accelerations, and the error of the path's slope, (..., 7)."""
        known, state, controls = self.flight(x, airspeed)
        derivative = self.instant(known, state, controls).derivative
        if not np.isfinite(derivative).all():
            raise ValueError(
                f"Got rates of change that are not finite at airspeed {airspeed:g} m/s, alpha "
                f"{np.mean(known['alpha']):.3g} rad, but expected six accelerations: the model, "
                f"the thrust or the air "
                "is not defined there."
            )
        path = DEMAND * (-derivative[..., 2] / airspeed - np.sin(known["climb"]))
        return np.concatenate(
            [derivative[..., VELOCITY], derivative[..., RATES], path[..., None]], axis=-1
        )

    def _slopes(self, x: Array, airspeed: float) -> Array:
        """Return d residual / d unknowns by central differences, all points at once."""
        steps = JACOBIAN_STEP * np.maximum(1.0, np.abs(x))
        more, less = self.residual(x + np.stack([np.diag(steps), -np.diag(steps)]), airspeed)
        return (more - less).T / (2.0 * steps)

    def _why(self, best: Any, airspeed: float) -> str:
        """Return the error text: what accelerations remain, and what is at a limit."""
        left = [
            f"{name} = {value:.3g} {'m' if name[0] in 'uvw' else 'rad'}/s^2"
            for name, value in zip(ACCELERATIONS, best.fun[:6], strict=True)
            if abs(value) > 0.01 * np.abs(best.fun[:6]).max()
        ]
        at = []
        for name, value in zip(self.unknowns, best.x, strict=True):
            low, high = self.limits[name]
            near = 1e-3 * (high - low if np.isfinite(high - low) else 1.0)
            at += [
                f"{name} at its limit {limit:.4g}"
                for limit in (low, high)
                if abs(value - limit) < near
            ]
        remedy = "Ask for another airspeed, climb or turn, or give trim() wider limits={name: (lowest, highest)}"
        if not at:
            remedy = (
                f"Nothing is at a limit: {', '.join(self.unknowns)} cannot balance it. Ask for "
                f"another airspeed (too "
                "slow, it stalls), free a control, or let the path follow (climb=None: no thrust "
                "holds it)"
            )
        units = {"altitude": "m", "turn_rate": "rad/s"}
        asked = [f"{name} {value:g} {units.get(name, 'rad')}" for name, value in self.given.items()]
        asked = [
            f"airspeed {airspeed:g} m/s",
            *asked,
            *(f"{name} {value:g}" for name, value in self.fixed.items()),
        ]
        return (
            f"There is no trim of {self.motion.aircraft.name} at {', '.join(asked)}: nearest to "
            f"it are left "
            f"{', '.join(left)}{', with ' + ', '.join(at) if at else ''}. {remedy}."
        )


def _check_given(given: dict, fixed: dict) -> None:
    """Raise ValueError if a given value is no number, or an angle in degrees."""
    for name, value in (given | fixed).items():
        parameter = "bank" if name == "phi" else name
        if value is not None and not (
            np.ndim(value) == 0 and np.isreal(value) and np.isfinite(value)
        ):
            raise ValueError(f"Got {parameter}={value!r}, but expected a finite number.")
        if name in ("climb", "phi", "beta") and value is not None and abs(value) >= np.pi / 2:
            raise degrees_error(
                f"{parameter}={value:g}", f"radians, less than {np.pi / 2:.3f}", parameter
            )
