"""Loads and accelerations of an aircraft at given states."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from sklearn.base import BaseEstimator

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    ALL_SURFACES,
    CHANNELS,
    EULER,
    HAT,
    LENGTHS,
    THRUST_FORCES,
    THRUST_MOMENTS,
    TRUTH_SUFFIX,
    rate_factor,
)
from skdgp._flight.checks import check_names
from skdgp._flight.frames import (
    HIGHEST,
    LOWEST,
    air_data,
    air_data_slopes,
    cross,
    ned_to_body,
    quaternion_to_euler,
    standard_density,
)
from skdgp.dynamics._aerodynamics import Aerodynamics, as_aerodynamics
from skdgp.dynamics._air import LocalAir, as_air
from skdgp.dynamics._aircraft import Aircraft, check_aircraft
from skdgp.dynamics._rigid_body import (
    ATTITUDE,
    RATES,
    VELOCITY,
    aerodynamic_loads,
    propulsive_loads,
    rigid_body_derivative,
)

PROPULSION = ("throttle", "propeller_speed", "thrust", *THRUST_FORCES, *THRUST_MOMENTS)
# Channels that are set, not rebuilt from the state; a control may also have a name that is no
# channel
CONTROLS = (*ALL_SURFACES, *PROPULSION, "gust")
# Largest deflection [rad] of a control whose training range is not known
DEFLECTION = np.pi / 4
# Channels that follow from the loads, and so from the coefficients that they may be regressors of
IMPLICIT = ("alpha_dot", "beta_dot", "p_dot", "q_dot", "r_dot", "ax", "ay", "az")
STATES = (
    "airspeed",
    "alpha",
    "beta",
    "density",
    "altitude",
    "u",
    "v",
    "w",
    "p",
    "q",
    "r",
    "phi",
    "theta",
    "psi",
)
MOST_ITERATIONS = 60
MEMORY = 4  # Changes that Anderson's method mixes
RIDGE, TINY = 1e-12, 1e-300
TOLERANCE = 1e-10  # Of the implicit regressors, each over 1 + its size


class Instant(NamedTuple):
    """Loads, accelerations and coefficients at states (..., 13)."""

    derivative: Array  #: Of the state, (..., 13)
    coefficients: Array  #: (..., 6)
    regressors: Array  #: (..., d)
    airspeed: Array
    alpha: Array
    beta: Array
    density: Array
    force: Array  #: All but gravity, body axes, (..., 3) [N]
    implicit: Array | None  #: The regressors of `IMPLICIT`, (..., 8), where the model has any
    settled: Array | bool  #: Whether the fixed point of the implicit regressors was found


def check_settled(instant: Instant) -> None:
    """Raise ValueError if the fixed point of the implicit regressors was not found."""
    if not np.all(instant.settled):
        raise ValueError(
            "The coefficients depend so strongly on the accelerations they cause that the motion "
            "is not determined: "
            "learn a model without accelerations, as RegressorSelector() does."
        )


class Motion:
    """An aircraft with its aerodynamics and propulsion: `at` returns its loads and accelerations.

    The parameters are as of `skdgp.dynamics.simulate`; of the air, density and gravity count.
    With ``lagged`` the implicit regressors are the guess passed to `at`, instead of the fixed
    point.

    Attributes
    ----------
    regressors : tuple of str
        The names of the model's regressors without suffixes, in its order.
    controls : tuple of str
        Regressors that are controls: neither state nor motion.
    """

    def __init__(
        self,
        model: Aerodynamics | BaseEstimator,
        aircraft: Aircraft,
        *,
        thrust: str | None = "auto",
        air: Any = None,
        lagged: bool = False,
    ) -> None:
        self.aerodynamics: Aerodynamics = as_aerodynamics(model)
        self.lagged = lagged
        check_aircraft(aircraft)
        air = as_air(air)
        self.aircraft, self.gravity, self.thrust = aircraft, air.gravity, thrust
        self._density = air.density
        span, chord = self.aerodynamics.span, self.aerodynamics.chord
        lengths = [aircraft.span, aircraft.chord]
        if (
            span is not None
            and chord is not None
            and not np.isclose([span, chord], lengths, rtol=0.01).any()
        ):
            warn(
                f"The model's rates were made non-dimensional by span {span:g} m and chord "
                f"{chord:g} m, but "
                f"{aircraft!r} has others: is this the aircraft that the model was learned from?",
                stacklevel=3,
            )
        self._plan = [self._source(name) for name in self.aerodynamics.regressors]
        self.regressors = tuple(name for name, *_ in self._plan)
        self.controls = tuple(n for n in self.regressors if n not in IMPLICIT and n not in STATES)
        if unknown := [name for name in self.controls if name in CHANNELS and name not in CONTROLS]:
            raise ValueError(
                f"Got a model with the regressors {unknown}, which are neither controls nor "
                f"rebuilt along a flight: "
                f"learn one without them. What is rebuilt: {', '.join((*STATES, *IMPLICIT))}."
            )
        self._needs_angles = any(name in EULER for name in self.regressors)
        # places of regressors that follow from the coefficients
        self.implicit = [k for k, name in enumerate(self.regressors) if name in IMPLICIT]
        self._follows = [IMPLICIT.index(self.regressors[k]) for k in self.implicit]

    @property
    def inputs(self) -> frozenset[str]:
        """Names of the controls, and of the surfaces that they may be mixed from."""
        mixing = self.aerodynamics.mixing
        surfaces = () if mixing is None else mixing.surfaces
        return frozenset((*self.controls, *surfaces))

    def factor(self, k: int, airspeed: Array) -> Array | float:
        """Return the k-th regressor over its channel: what makes a rate non-dimensional, or 1."""
        name, length = self._plan[k]
        return rate_factor(name, length, airspeed) if length else 1.0

    def _source(self, full: str) -> tuple[str, float | None]:
        """Return the channel that a regressor is made from, and the length that makes it non-dimensional."""
        name = full.removesuffix(TRUTH_SUFFIX)
        if not name.endswith(HAT):
            return name, None
        name = name.removesuffix(HAT)
        if name not in LENGTHS:
            raise ValueError(
                f"Got regressor {full!r}, but only rates have a non-dimensional form: "
                f"{list(LENGTHS)}."
            )
        return name, getattr(self.aerodynamics, LENGTHS[name]) or getattr(
            self.aircraft, LENGTHS[name]
        )

    def mixed(self, controls: Mapping) -> dict:
        """Return all controls of the model, made from surfaces where these are given; ValueError if one is missing."""
        if not isinstance(controls, Mapping):
            raise TypeError(
                f"Got {type(controls).__name__} as controls, but expected values by name: "
                f"{{name: value}}."
            )
        controls = dict(controls)
        mixing = self.aerodynamics.mixing
        lacking = [name for name in self.controls if name not in controls]
        if lacking and mixing is not None and all(name in controls for name in mixing.surfaces):
            values = [np.asarray(controls[name], dtype=float) for name in mixing.surfaces]
            by_mixing = {
                n: sum(a * v for a, v in zip(row, values, strict=True))
                for n, row in zip(*mixing[1:], strict=True)
            }
            controls |= {name: by_mixing[name] for name in lacking if name in by_mixing}
        check_names(self.controls, controls, "controls")
        return controls

    def at(
        self,
        state: Array,
        controls: Mapping,
        air: LocalAir | None = None,
        implicit: Array | None = None,
        drift: Array | float = 0.0,
        coefficients: Array | None = None,
    ) -> Instant:
        """Return what happens at states (..., 13) under ``controls``, by name, each (...), in ``air``, else at rest.

        ``implicit`` (..., 8) is a guess of the channels of `IMPLICIT`, best from the last call.
        ``drift`` (..., 6) is added to the coefficients. Given ``coefficients`` (..., 6) take the
        place of the model's.
        """
        velocity = state[..., VELOCITY]
        wind = None
        if air is not None:
            wind = ned_to_body(state[..., ATTITUDE], air.wind)
            velocity = velocity - wind
        airspeed, alpha, beta = air_data(velocity)
        altitude = -state[..., 2]
        density = self._density(altitude) if callable(self._density) else self._density
        if density is None:  # the standard atmosphere, NaN outside
            density = standard_density(
                np.where((altitude > LOWEST) & (altitude < HIGHEST), altitude, np.nan)
            )
        X = self._explicit(state, controls, air, airspeed, alpha, beta, density, altitude)
        values = {**controls, "airspeed": airspeed, "density": density}
        propulsion = propulsive_loads(values, self.aircraft, self.thrust)

        def loaded() -> Instant:
            C = self._coefficients(X) + drift if coefficients is None else coefficients
            return self._loaded(state, X, C, airspeed, alpha, beta, density, propulsion)

        if not self.implicit:
            return loaded()
        guess = np.zeros((*state.shape[:-1], len(IMPLICIT))) if implicit is None else implicit
        tried: list[tuple[Array, Array]] = []
        for _ in range(MOST_ITERATIONS):
            for k, place in zip(self.implicit, self._follows, strict=True):
                X[..., k] = guess[..., place] * self.factor(k, airspeed)
            now = loaded()
            result = self._follow(state, now, velocity, wind, air)
            if self.lagged:
                return now._replace(implicit=result)
            off = ((result - guess) / (1.0 + np.abs(result)))[..., self._follows]
            settled = np.abs(off).max(axis=-1) < TOLERANCE
            if np.all(settled | ~np.isfinite(off).all(axis=-1)):
                break
            guess = _anderson(tried, result, off)
        return now._replace(implicit=result, settled=settled)

    def _explicit(self, state, controls, air, airspeed, alpha, beta, density, altitude) -> Array:
        """Return the regressors (..., d); regressors that follow from the loads are not yet set."""
        rates = (
            state[..., RATES]
            if air is None or air.rotation is None
            else state[..., RATES] - air.rotation
        )
        values = {
            "airspeed": airspeed,
            "alpha": alpha,
            "beta": beta,
            "density": density,
            "altitude": altitude,
            "p": rates[..., 0],
            "q": rates[..., 1],
            "r": rates[..., 2],
            "u": state[..., 3],
            "v": state[..., 4],
            "w": state[..., 5],
        }
        if self._needs_angles:
            angles = np.moveaxis(quaternion_to_euler(state[..., ATTITUDE]), -1, 0)
            values |= dict(zip(EULER, angles, strict=True))
        X = np.empty((*state.shape[:-1], len(self._plan)))
        for k, name in enumerate(self.regressors):
            if name not in IMPLICIT:
                X[..., k] = (values[name] if name in values else controls[name]) * self.factor(
                    k, airspeed
                )
        return X

    def _coefficients(self, X: Array) -> Array:
        """Return the model's coefficients (..., 6) at regressors (..., d), NaN where a state has diverged."""
        # models refuse infinite values
        finite = np.isfinite(X).all(axis=-1, keepdims=True)
        return np.where(finite, self.aerodynamics(np.where(finite, X, 0.0)), np.nan)

    def _loaded(self, state, X, C, airspeed, alpha, beta, density, propulsion) -> Instant:
        """Return what happens at coefficients (..., 6), with force and moment of the engine."""
        force, moment = aerodynamic_loads(C, airspeed, density, self.aircraft)
        force, moment = force + propulsion[0], moment + propulsion[1]
        derivative = rigid_body_derivative(state, force, moment, self.aircraft, self.gravity)
        return Instant(derivative, C, X, airspeed, alpha, beta, density, force, None, True)

    def _follow(self, state, now: Instant, velocity, wind, air) -> Array:
        """Return what follows from the loads, (..., 8), in the order of `IMPLICIT`; ``wind`` in body axes."""
        acceleration = now.derivative[..., VELOCITY]
        if (
            wind is not None
        ):  # a wind that is constant over the earth turns against the aircraft in body axes
            acceleration = acceleration + cross(state[..., RATES], wind)
            if air.wind_rate is not None:
                acceleration = acceleration - ned_to_body(state[..., ATTITUDE], air.wind_rate)
        implicit = np.empty((*state.shape[:-1], len(IMPLICIT)))
        implicit[..., :2] = (air_data_slopes(velocity)[..., 1:, :] @ acceleration[..., None])[
            ..., 0
        ]
        implicit[..., 2:5] = now.derivative[..., RATES]
        implicit[..., 5:] = now.force / self.aircraft.mass
        return implicit


def _anderson(tried: list[tuple[Array, Array]], result: Array, off: Array) -> Array:
    """Return the next guess from the last ones, (result, off) each: the mixture whose residual vanishes to first order.

    Anderson (1965), over the last `MEMORY` changes, for each trajectory by itself.
    """
    tried.append((result, off))
    del tried[: -MEMORY - 1]
    if len(tried) == 1:
        return result
    changes, steps = ([b[i] - a[i] for a, b in pairwise(tried)] for i in (1, 0))
    D, F = np.stack(changes, axis=-1), np.stack(steps, axis=-1)
    normal = np.swapaxes(D, -1, -2) @ D
    normal = normal + (RIDGE * np.trace(normal, axis1=-2, axis2=-1) + TINY)[
        ..., None, None
    ] * np.eye(len(changes))
    mixture = np.linalg.solve(normal, np.swapaxes(D, -1, -2) @ off[..., None])
    return result - (F @ mixture)[..., 0]
