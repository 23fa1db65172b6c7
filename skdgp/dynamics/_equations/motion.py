"""Forces and moments at an instant, and the state's derivative, from state and controls."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from skdgp._flight.atmosphere import HIGHEST, LOWEST, standard_density
from skdgp._flight.channels import CHANNELS, TRUTH_SUFFIX
from skdgp._flight.checks import check_names
from skdgp._flight.frames import air_data, ned_to_body, quaternion_to_euler
from skdgp.dynamics._equations.aerodynamics import as_aerodynamics
from skdgp.dynamics._equations.rigid_body import ATTITUDE, RATES, STANDARD_GRAVITY, VELOCITY, rigid_body_derivative
from skdgp.dynamics._vehicle.aircraft import Aircraft
from skdgp.dynamics._vehicle.loads import propulsion_loads

__all__ = ["Instant", "Motion"]

HAT = "_hat"
CONTROLS = (
    *("elevator", "aileron", "rudder", "elevon_left", "elevon_right", "throttle", "propeller_speed", "thrust"),
    *("thrust_x", "thrust_y", "thrust_z", "thrust_l", "thrust_m", "thrust_n", "gust"),
)
"""Words of the vocabulary that are set and not rebuilt; a control may also have any name that is not in it."""
LENGTHS = {"p": "span", "q": "chord", "r": "span", "alpha_dot": "chord", "beta_dot": "span"}
ACCELERATION_LENGTHS = {"p_dot": "span", "q_dot": "chord", "r_dot": "span"}
LENGTHS_OF_RATES = ("span", "chord")
IMPLICIT = ("alpha_dot", "beta_dot", "p_dot", "q_dot", "r_dot", "ax", "ay", "az")
"""What follows from the loads, and so from the coefficients that it is a regressor of."""
STATES = ("airspeed", "alpha", "beta", "density", "altitude", "u", "v", "w", "p", "q", "r", "phi", "theta", "psi")
PLACES = {"u": 3, "v": 4, "w": 5, "p": 10, "q": 11, "r": 12}
MOST_ITERATIONS = 60
MEMORY = 4
RIDGE, TINY = 1e-12, 1e-300
TOLERANCE = 1e-10
"""Of the implicit regressors, each over 1 + its size."""


class Instant(NamedTuple):
    """What acts on the aircraft and what follows, at states (..., 13)."""

    derivative: np.ndarray
    """Of the state, (..., 13)."""
    coefficients: np.ndarray
    """(..., 6)."""
    regressors: np.ndarray
    """(..., d)."""
    airspeed: np.ndarray
    alpha: np.ndarray
    beta: np.ndarray
    density: np.ndarray
    force: np.ndarray
    """All but gravity, body axes, (..., 3) [N]."""
    moment: np.ndarray
    implicit: np.ndarray | None
    """The regressors of `IMPLICIT`, (..., 8), where the model has any."""
    settled: np.ndarray | bool
    """Whether the fixed point of these was found."""


class Motion:
    """An aircraft with its aerodynamics and propulsion: `at` says how it moves.

    Parameters
    ----------
    model : Aerodynamics, Pipeline or estimator
        As for :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    thrust : "auto", callable or None
        As for :func:`skdgp.dynamics.simulate`.
    gravity : float
        [m/s^2].
    density : float, callable or None
        Density [kg/m^3], or a function of altitude [m]; None: the standard atmosphere.

    Attributes
    ----------
    regressors : tuple of str
        The names of the model's regressors without suffixes, in its order.
    controls : tuple of str
        Those of them that are controls: neither state nor motion.
    """

    def __init__(self, model, aircraft: Aircraft, *, thrust="auto", gravity: float = STANDARD_GRAVITY, density=None):
        self.aerodynamics = as_aerodynamics(model)
        if not isinstance(aircraft, Aircraft):
            raise TypeError(f"Got {type(aircraft).__name__} for aircraft, but expected a skdgp.dynamics.Aircraft.")
        self.aircraft, self.gravity, self.thrust = aircraft, gravity, thrust
        if not (density is None or callable(density) or (np.isfinite(density) and density >= 0)):
            raise ValueError(f"Got density={density!r}, but expected kg/m^3 from 0 on, or a function of altitude [m].")
        self._density = _density_of_air if density is None else density
        self._check_lengths()
        self._plan = [self._rule(name) for name in self.aerodynamics.regressors]
        self.regressors = tuple(name for name, *_ in self._plan)
        self.controls = tuple(n for n in self.regressors if n not in IMPLICIT and n not in STATES)
        unknown = [name for name in self.controls if name in CHANNELS and name not in CONTROLS]
        if unknown:
            raise ValueError(
                f"Got a model with the regressors {unknown}, which are neither controls nor rebuilt along a flight: "
                f"learn one without them. What is rebuilt: {', '.join((*STATES, *IMPLICIT))}."
            )
        self._needs_angles = any(name in ("phi", "theta", "psi") for name in self.regressors)
        self._implicit = [k for k, name in enumerate(self.regressors) if name in IMPLICIT]
        self._follows = [IMPLICIT.index(self.regressors[k]) for k in self._implicit]

    def _check_lengths(self) -> None:
        """Warn where the model seems to be of another aircraft."""
        model, aircraft = (
            [getattr(owner, name) for name in LENGTHS_OF_RATES] for owner in (self.aerodynamics, self.aircraft)
        )
        if None not in model and not np.isclose(model, aircraft, rtol=0.01).any():
            warnings.warn(
                f"The model's rates were made non-dimensional by span {model[0]:g} m and chord {model[1]:g} m, but "
                f"{self.aircraft!r} has others: is this the aircraft that the model was learned from?",
                UserWarning,
                stacklevel=4,
            )

    @property
    def is_implicit(self) -> bool:
        """Whether the coefficients depend on what follows from them."""
        return bool(self._implicit)

    def _rule(self, full: str) -> tuple[str, float, int]:
        """Return the quantity that a regressor is made from, and the length and power of L / 2V that scale it."""
        name = full.removesuffix(TRUTH_SUFFIX)
        if not name.endswith(HAT):
            return name, 1.0, 0
        name = name.removesuffix(HAT)
        lengths = LENGTHS | ACCELERATION_LENGTHS
        if name not in lengths:
            raise ValueError(f"Got regressor {full!r}, but only rates have a non-dimensional form: {list(lengths)}.")
        own = getattr(self.aerodynamics, lengths[name])
        return name, getattr(self.aircraft, lengths[name]) if own is None else own, 1 + (name in ACCELERATION_LENGTHS)

    def mixed(self, controls: Mapping) -> dict:
        """Return the controls that the model needs beside those given, made from surfaces where these are given.

        Raises
        ------
        ValueError
            If a control that the model needs is missing.
        """
        if not isinstance(controls, Mapping):
            raise TypeError(f"Got {type(controls).__name__} as controls, but expected values by name: {{name: value}}.")
        controls = dict(controls)
        mixing = self.aerodynamics.mixing
        lacking = [name for name in self.controls if name not in controls]
        if lacking and mixing is not None and all(name in controls for name in mixing.surfaces):
            values = [np.asarray(controls[name], dtype=float) for name in mixing.surfaces]
            made = {n: sum(a * v for a, v in zip(row, values, strict=True)) for n, row in zip(*mixing[1:], strict=True)}
            controls |= {name: made[name] for name in lacking if name in made}
        check_names(self.controls, controls, "controls")
        return controls

    def at(self, state, controls: Mapping, wind=None, wind_rate=None, implicit=None) -> Instant:
        """Return what happens at states (..., 13) under ``controls``, by name, each (...).

        ``wind`` (..., 3) is the velocity of the air [m/s], north, east, down, ``wind_rate`` its rate of change.
        ``implicit`` (..., 8) is a guess of the regressors of `IMPLICIT`: the last ones are a good one.
        """
        velocity = state[..., VELOCITY]
        steady = None
        if wind is not None:
            steady = ned_to_body(state[..., ATTITUDE], wind)
            velocity = velocity - steady
        airspeed, alpha, beta = air_data(velocity)
        altitude = -state[..., 2]
        density = self._density(altitude) if callable(self._density) else self._density
        X = self._explicit(state, controls, airspeed, alpha, beta, density, altitude)
        others = propulsion_loads(self.aircraft, self.thrust, controls, airspeed, density)
        if not self._implicit:
            return self._loaded(state, X, airspeed, alpha, beta, density, others)
        guess = np.zeros((*state.shape[:-1], len(IMPLICIT))) if implicit is None else implicit
        tried = []
        for _ in range(MOST_ITERATIONS):
            self._insert(X, guess, airspeed)
            now = self._loaded(state, X, airspeed, alpha, beta, density, others)
            found = self._follow(state, now, velocity, steady, wind_rate)
            off = ((found - guess) / (1.0 + np.abs(found)))[..., self._follows]
            settled = np.abs(off).max(axis=-1) < TOLERANCE
            if np.all(settled | ~np.isfinite(off).all(axis=-1)):
                break
            guess = _anderson(tried, found, off)
        return now._replace(implicit=found, settled=settled)

    def _explicit(self, state, controls, airspeed, alpha, beta, density, altitude) -> np.ndarray:
        """Return the regressors (..., d), those that follow from the loads still to be filled in."""
        values = {"airspeed": airspeed, "alpha": alpha, "beta": beta, "density": density, "altitude": altitude}
        if self._needs_angles:
            angles = quaternion_to_euler(state[..., ATTITUDE])
            values |= {name: angles[..., k] for k, name in enumerate(("phi", "theta", "psi"))}
        X = np.empty((*state.shape[:-1], len(self._plan)))
        over = 0.5 / airspeed
        for k, (name, length, power) in enumerate(self._plan):
            if name in PLACES:
                value = state[..., PLACES[name]]
            elif name in values:
                value = values[name]
            elif name in IMPLICIT:
                continue
            else:
                value = controls[name]
            X[..., k] = value * (length * over) if power else value
        return X

    def _insert(self, X, implicit, airspeed) -> None:
        """Fill in the regressors that follow from the loads."""
        for k in self._implicit:
            name, length, power = self._plan[k]
            value = implicit[..., IMPLICIT.index(name)]
            X[..., k] = value * (0.5 * length / airspeed) ** power if power else value

    def _loaded(self, state, X, airspeed, alpha, beta, density, others) -> Instant:
        C = self._coefficients(X)
        scale = (0.5 * self.aircraft.wing_area) * density * airspeed * airspeed
        force = C[..., :3] * np.asarray(scale)[..., None] + others[0]
        moment = C[..., 3:] * (np.asarray(scale)[..., None] * self.aircraft.moment_lengths) + others[1]
        derivative = rigid_body_derivative(state, force, moment, self.aircraft, self.gravity)
        return Instant(derivative, C, X, airspeed, alpha, beta, density, force, moment, None, True)

    def _coefficients(self, X) -> np.ndarray:
        """Return the model's coefficients, NaN where a state has diverged: models refuse what is not finite."""
        if np.isfinite(X).all():
            return self.aerodynamics(X)
        finite = np.isfinite(X).all(axis=-1, keepdims=True)
        return np.where(finite, self.aerodynamics(np.where(finite, X, 0.0)), np.nan)

    def _follow(self, state, now: Instant, velocity, steady, wind_rate) -> np.ndarray:
        """Return what follows from the loads, (..., 8), in the order of `IMPLICIT`."""
        acceleration = now.derivative[..., VELOCITY]
        if steady is not None:  # the wind is constant over the earth, so in body axes it turns against the aircraft
            acceleration = acceleration + np.cross(state[..., RATES], steady)
        if wind_rate is not None:
            acceleration = acceleration - ned_to_body(state[..., ATTITUDE], wind_rate)
        u, v, w = (velocity[..., k] for k in range(3))
        u_dot, v_dot, w_dot = (acceleration[..., k] for k in range(3))
        across2 = u * u + w * w
        found = np.empty((*state.shape[:-1], len(IMPLICIT)))
        found[..., 0] = (u * w_dot - w * u_dot) / across2
        found[..., 1] = (across2 * v_dot - v * (u * u_dot + w * w_dot)) / (np.sqrt(across2) * now.airspeed**2)
        found[..., 2:5] = now.derivative[..., RATES]
        found[..., 5:] = now.force / self.aircraft.mass
        return found


def _density_of_air(altitude):
    """Return the standard atmosphere's density, NaN where it knows none."""
    return standard_density(np.where((altitude > LOWEST) & (altitude < HIGHEST), altitude, np.nan))


def _anderson(tried: list, found, off) -> np.ndarray:
    """Return the next guess from the last ones, (found, off) each: the mixture whose residual vanishes to first order.

    Anderson (1965), over the last `MEMORY` changes, for each trajectory by itself.
    """
    tried.append((found, off))
    del tried[: -MEMORY - 1]
    if len(tried) == 1:
        return found
    changes, steps = ([b[i] - a[i] for a, b in pairwise(tried)] for i in (1, 0))
    D, F = np.stack(changes, axis=-1), np.stack(steps, axis=-1)
    normal = np.swapaxes(D, -1, -2) @ D
    normal = normal + (RIDGE * np.trace(normal, axis1=-2, axis2=-1) + TINY)[..., None, None] * np.eye(len(changes))
    mixture = np.linalg.solve(normal, np.swapaxes(D, -1, -2) @ off[..., None])
    return found - (F @ mixture)[..., 0]
