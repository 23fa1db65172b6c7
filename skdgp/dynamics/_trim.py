"""Trim: attitude and controls of steady flight, straight or turning, level or climbing."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    AIR_DATA,
    ALL_SURFACES,
    AUXILIARY,
    CHANNELS,
    THRUST_FORCES,
    THRUST_MOMENTS,
)
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import air_velocity, euler_to_quaternion, ned_to_body
from skdgp._flight.tables import by_name, check_names, check_number
from skdgp._flight.units import degrees_error
from skdgp.dynamics._aerodynamics import Aerodynamics
from skdgp.dynamics._aircraft import Aircraft
from skdgp.dynamics._motion import (
    DEFLECTION,
    Instant,
    Motion,
)
from skdgp.dynamics._rigid_body import (
    RATES,
    aerodynamic_loads,
    thrust_control,
)

# Settings of an engine, one of which trims the thrust
ENGINE_CONTROLS = ("throttle", "propeller_speed", "thrust")
# What gives the thrust where it is given
THRUST_SOURCES = ("propeller_speed", "thrust", *THRUST_FORCES, *THRUST_MOMENTS)
FLIGHT = ("altitude", "climb", "turn_rate", "alpha", "beta", "phi", "theta")
ANGLES = ("alpha", "beta", "theta", "phi", "turn_rate", "climb")
# Accelerations that vanish: places in the derivative of the state
ACCELERATIONS = {"u_dot": 3, "v_dot": 4, "w_dot": 5, "p_dot": 10, "q_dot": 11, "r_dot": 12}
PLACES = [*ACCELERATIONS.values()]
# Limits of unknowns, of alpha where its training range is not known
UNKNOWN_LIMITS = {
    "alpha": (-np.pi / 6, np.pi / 4),
    "beta": (-np.pi / 6, np.pi / 6),
    **dict.fromkeys(("theta", "phi", "climb"), (-np.pi / 2, np.pi / 2)),
    "turn_rate": (-np.inf, np.inf),
    "thrust": (0.0, np.inf),
    "throttle": (0.0, 1.0),
    "propeller_speed": (0.0, np.inf),
}


# Largest acceleration of a trim, which no aircraft's sensor shows (guess) [m/s^2, rad/s^2]
TOLERANCE = 1e-3
# Weight of the flight path's slope: where there is no trim, accelerations remain, and the path is as given
PATH_WEIGHT = 100.0
# Least allowed excess of a control or alpha over its training range [rad]
MARGIN = 0.1


@dataclass(frozen=True, eq=False)
class Trim:
    """A steady flight: airspeed [m/s], altitude [m], angles, climb angle of the path [rad], turn rate [rad/s]."""

    state: Array = field(repr=False)  #: (13,), see `STATE_NAMES`; above the origin, heading north
    controls: dict  #: Controls of the model and the engine
    airspeed: float
    altitude: float
    density: float  #: Of the air [kg/m^3]
    climb: float
    turn_rate: float
    alpha: float
    beta: float
    phi: float
    theta: float
    coefficients: Array = field(repr=False)  #: CX CY CZ Cl Cm Cn
    thrust: float  #: Thrust of the engine along its line [N]
    residual: float  #: The largest acceleration that remains [m/s^2 or rad/s^2]
    beyond: dict  #: Regressors outside their training ranges: name to (value, smallest, largest)

    @property
    def start(self) -> dict[str, float]:
        """The start of this flight by name, with the same airspeed in any wind."""
        values = {name: vars(self)[name] for name in (*AIR_DATA, "phi", "theta", "altitude")}
        return values | by_name(RATE_NAMES, self.state[RATES])


def trim(
    model: Aerodynamics | BaseEstimator,
    aircraft: Aircraft,
    airspeed: float,
    *,
    altitude: float = 0.0,
    climb: float | None = 0.0,
    bank: float | None = None,
    fixed: Mapping[str, float] | None = None,
    thrust: str | None = "auto",
    air: Any = None,
) -> Trim:
    r"""Return the steady flight of an aircraft at an airspeed.

    Six accelerations vanish and the flight path has its angle (Stevens, Lewis & Johnson 2016,
    section 3.6),

    .. math:: \dot u = \dot v = \dot w = \dot p = \dot q = \dot r = 0, \quad
        \dot h = V \sin\gamma, \quad (p, q, r) = \dot\psi\,(-\sin\theta, \sin\phi\cos\theta,
        \cos\phi\cos\theta).

    The unknowns are alpha, theta, phi and four controls: the model's, and the control of the
    thrust. With ``bank`` the turn rate is unknown instead of phi. Sideslip is unknown, instead
    of zero, where there are fewer controls, as without a rudder, or where both ``bank`` and a
    turn rate are given (a steady sideslip). Controls and alpha may leave the training range by its
    width on either side, at least 0.1 rad; surfaces reach 45 degrees where that is unknown;
    ``throttle`` is 0 to 1, ``thrust`` > 0. Raises ValueError if there is no such flight, with
    the accelerations that remain and the unknowns at a limit; if a given value is not finite, or an
    angle of 90 degrees or more.

    Parameters
    ----------
    model, aircraft
        As for :func:`skdgp.dynamics.simulate`.
    airspeed : float
        [m/s].
    altitude : float
        [m]; a climb is steady at the density of this altitude.
    climb : float or None
        Angle of the flight path [rad]; None: unknown, for a thrust that is ``fixed`` or None.
    bank : float, optional
        phi [rad]; without it and a turn rate, straight flight.
    fixed : mapping of str to float, optional
        Values of controls that are not unknowns, of ``turn_rate``, the rate of change of heading
        [rad/s], and of ``beta`` [rad], by default 0 where four controls can hold it.
        A ``throttle`` that is a regressor but does not set
        the thrust (an aircraft without a propeller) is by default the middle of its training range,
        and a surface that training did not move stays where it was.
    thrust, air
        As for :func:`skdgp.dynamics.simulate`; of the air, density and gravity count.

    Returns
    -------
    Trim

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
    airspeed = check_number("airspeed", airspeed, unit="m/s")
    values = dict(fixed or {})
    conditions = {
        "altitude": altitude,
        "climb": climb,
        "turn_rate": values.pop("turn_rate", 0.0 if bank is None else None),
        "phi": bank,
        "beta": values.pop("beta", None),
    }
    steady = SteadyFlight(motion, airspeed, conditions, values)
    flight, state, now = steady.at(steady.solve())
    aerodynamic, _ = aerodynamic_loads(now.coefficients, now.airspeed, now.density, aircraft)
    met = by_name(motion.aerodynamics.regressors, now.regressors)
    beyond = {}
    for name, (low, high) in motion.aerodynamics.training_ranges.items():
        if not low <= met[name] <= high:
            beyond[name] = (float(met[name]), low, high)
    return Trim(
        state=state,
        controls={name: float(flight[name]) for name in steady.controls},
        airspeed=airspeed,
        density=float(now.density),
        **{name: float(flight[name]) for name in FLIGHT},
        coefficients=now.coefficients,
        thrust=float((now.force - aerodynamic) @ aircraft.engine_line.direction),
        residual=float(np.abs(now.derivative[PLACES]).max()),
        beyond=beyond,
    )


class SteadyFlight:
    """The equations of a steady flight in the unknowns of one aircraft.

    ``conditions`` holds altitude, climb, turn_rate, phi, beta; None is an unknown. ``fixed`` is as of
    `trim`.

    Attributes
    ----------
    given : dict
        Known conditions and controls.
    controls : tuple of str
        All controls, given or unknown.
    unknowns : tuple of str
        What `solve` finds.
    """

    def __init__(self, motion: Motion, airspeed: float, conditions: dict, fixed: dict):
        self.motion = motion
        self.airspeed = airspeed
        _check_given(conditions, fixed)
        self.flown = motion.aerodynamics.training_ranges
        held, free = self._controls(fixed)
        self.controls = (*held, *free)
        known = {name: value for name, value in conditions.items() if value is not None}
        # without a given climb one control less is needed to hold the sideslip
        n_needed = 4 if "climb" in known else 3
        has_turn = {"phi", "turn_rate"} <= known.keys()
        if len(free) >= n_needed and not has_turn:
            known.setdefault("beta", 0.0)
        self.given = known | held
        self.unknowns = (*(name for name in ANGLES if name not in known), *free)
        if len(self.unknowns) > 7:
            raise ValueError(
                f"Got the unknowns {', '.join(self.unknowns)}, but expected at most 7, as many as a steady flight has "
                "equations: give values of controls, fixed={name: value}."
            )
        self.limits = {name: self._limits(name) for name in self.unknowns}

    def _controls(self, fixed: dict) -> tuple[dict, list[str]]:
        """Return the controls that are held, by name, and the names of those that are solved for.

        Held are given ones, a throttle without thrust, and surfaces of unknown effect.
        """
        motion = self.motion
        engine = thrust_control(motion.aircraft, motion.thrust)
        if engine == "throttle" and "propeller_speed" in motion.controls:
            engine = "propeller_speed"
        if not fixed.keys().isdisjoint(THRUST_SOURCES):
            engine = None
        names = list(motion.controls)
        if engine is not None and engine not in names:
            names.append(engine)
        check_names(fixed, (*names, *THRUST_SOURCES), "controls of the model and the engine")
        held = dict(fixed)
        for name in self.flown.keys() & {*names} - {engine}:
            limits = self.flown[name]
            is_unmoved = name in ALL_SURFACES and np.isclose(*limits)
            if name in ENGINE_CONTROLS or is_unmoved:
                held.setdefault(name, float(np.mean(limits)))
            elif name in AUXILIARY:
                held.setdefault(name, float(np.clip(0.0, *limits)))
        free = [name for name in names if name not in held]
        undetermined = {*ENGINE_CONTROLS, *CHANNELS} - {*ALL_SURFACES, *AUXILIARY, engine}
        lacking = [name for name in free if name in undetermined]
        if lacking:
            raise ValueError(
                f"The trim lacks values of {lacking}, which no steady flight determines: give "
                f"fixed={{{lacking[0]!r}: value}}."
            )
        return held, free

    def _limits(self, name: str) -> tuple[float, float]:
        """Return the limits of an unknown."""
        propeller = self.motion.aircraft.propeller
        if name == "propeller_speed" and propeller is not None and propeller.speed_range:
            idle, full = propeller.speed_range
            return idle, full
        if name in self.flown and (name == "alpha" or name not in UNKNOWN_LIMITS):
            low, high = self.flown[name]
            margin = max(high - low, MARGIN)
            return low - margin, high + margin
        return UNKNOWN_LIMITS.get(name, (-DEFLECTION, DEFLECTION))

    def solve(self) -> Array:
        """Return the values of the unknowns."""
        low, high = np.array([*self.limits.values()]).T
        solution = least_squares(
            self.residual,
            np.clip(self._start(), low, high),
            bounds=(low, high),
            x_scale="jac",
            ftol=None,
            gtol=None,
            xtol=1e-15,
            max_nfev=200,
        )
        if np.abs(solution.fun).max() > TOLERANCE:
            raise ValueError(self._no_trim(solution))
        return solution.x

    def _start(self) -> Array:
        """Return a first guess, with alpha in the middle of its training range."""
        aircraft = self.motion.aircraft
        start = {name: float(np.clip(0.0, *ends)) for name, ends in self.limits.items()}
        start["alpha"] = float(np.mean(self.flown.get("alpha", UNKNOWN_LIMITS["alpha"])))
        start["throttle"] = float(np.mean(UNKNOWN_LIMITS["throttle"]))
        if aircraft.propeller is not None:
            # at an advance ratio of 1
            start["propeller_speed"] = 2 * np.pi * self.airspeed / aircraft.propeller.diameter
        return np.array([start[name] for name in self.unknowns])

    def at(self, x: Array) -> tuple[dict, Array, Instant]:
        """Return all quantities by name, the state and what happens, at unknowns (k,)."""
        flight = self.given | dict(zip(self.unknowns, x, strict=True))
        velocity = air_velocity(self.airspeed, flight["alpha"], flight["beta"])
        attitude = euler_to_quaternion(flight["phi"], flight["theta"], 0.0)
        vertical = ned_to_body(attitude, (0.0, 0.0, 1.0))
        rates = flight["turn_rate"] * vertical
        position = np.array([0.0, 0.0, -flight["altitude"]])
        state = np.concatenate([position, velocity, attitude, rates])
        controls = {name: flight[name] for name in self.controls}
        return flight, state, self.motion.at(state, controls)

    def residual(self, x: Array) -> Array:
        """Return the six accelerations, and the error of the path's slope, (7,)."""
        flight, _, now = self.at(x)
        if not np.isfinite(now.derivative).all():
            raise ValueError(
                f"Got rates of change that are not finite at airspeed {self.airspeed:g} m/s, alpha "
                f"{flight['alpha']:.3g} rad, altitude {flight['altitude']:g} m, but "
                "expected six accelerations: the model, the thrust or the air is not defined there."
            )
        path = -now.derivative[2] / self.airspeed - np.sin(flight["climb"])
        return np.append(now.derivative[PLACES], PATH_WEIGHT * path)

    def _no_trim(self, nearest: Any) -> str:
        """Return the error text: the accelerations that remain, and the unknowns at a limit."""
        remaining = zip(ACCELERATIONS, nearest.fun, strict=False)
        accelerations = ", ".join(f"{name} = {value:.3g}" for name, value in remaining)
        given = {"airspeed": self.airspeed, **self.given}
        conditions = ", ".join(f"{name} {value:g}" for name, value in given.items())
        ends = []
        for name, value in zip(self.unknowns, nearest.x, strict=True):
            for limit in self.limits[name]:
                if abs(value - limit) < 1e-3:
                    ends.append(f"{name} at its limit {limit:.4g}")
        return (
            f"There is no trim of {self.motion.aircraft.name} at {conditions} (SI units): nearest to it are left "
            f"{accelerations} (m/s^2, rad/s^2), with {', '.join(ends) or 'nothing at a limit'}. "
            "Ask for another airspeed, climb or turn, free a control, or let the path follow (climb=None)."
        )


def _check_given(conditions: dict, fixed: dict) -> None:
    """Raise ValueError if a given value is no number, or an angle in degrees."""
    for name, value in (conditions | fixed).items():
        if value is None:
            continue
        parameter = "bank" if name == "phi" else name
        number = check_number(parameter, value, -np.inf)
        if name in ("climb", "phi", "beta") and abs(number) >= np.pi / 2:
            raise degrees_error(
                f"{parameter}={value:g}", f"radians, less than {np.pi / 2:.3f}", parameter
            )
