"""Loads and accelerations of an aircraft at given states."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from sklearn.base import BaseEstimator

from skdgp._compute.messages import warn
from skdgp._compute.typing import Array
from skdgp._flight.channels import (
    ALL_SURFACES,
    AUXILIARY,
    BODY_VELOCITY,
    CHANNELS,
    EULER,
    HAT,
    RATE_LENGTHS,
    THRUST_FORCES,
    THRUST_MOMENTS,
    TRUTH_SUFFIX,
)
from skdgp._flight.channels import RATES as RATE_NAMES
from skdgp._flight.frames import (
    air_data,
    air_data_slopes,
    cross,
    density_or_nan,
    ned_to_body,
    quaternion_to_euler,
)
from skdgp._flight.tables import by_name, check_names
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
CONTROLS = (*ALL_SURFACES, *AUXILIARY, *PROPULSION, "gust")
# Controls that no servo of a surface moves
WITHOUT_SERVOS = frozenset((*PROPULSION, "gust"))
# Largest deflection [rad] of a control whose training range is not known
DEFLECTION = np.pi / 4
# Channels that follow from the loads, and so from the coefficients that they may be regressors of
FROM_LOADS = ("alpha_dot", "beta_dot")
# Channels that are rebuilt from the state
FROM_STATE = (
    *("airspeed", "alpha", "beta", "density", "altitude"),
    *("u", "v", "w", "p", "q", "r", "phi", "theta", "psi"),
)
# All channels that a motion gives
FROM_MOTION = (*FROM_STATE, *FROM_LOADS)


# Largest difference of a regressor between two iterations, over 1 + its size, of a fixed point of the
# implicit regressors, which follow from the loads; and most iterations
TOLERANCE = 1e-10
ITERATIONS = 60
STILL = LocalAir()


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
    implicit: (
        Array | None
    )  #: Rates of the air angles, (..., 2) of `FROM_LOADS`, where they are regressors


class Flow(NamedTuple):
    """The air that an aircraft meets, at states (..., 13)."""

    velocity: Array  #: Through the air, body axes, (..., 3) [m/s]
    wind: Array | None  #: Without gusts, body axes, (..., 3) [m/s]; None: none
    airspeed: Array
    alpha: Array
    beta: Array
    altitude: Array
    density: Array


def _source(full: str, lengths: Mapping[str, float]) -> tuple[str, float]:
    """Return the channel that a regressor is made from, and the length that makes it non-dimensional, else NaN."""
    name = full.removesuffix(TRUTH_SUFFIX)
    if not name.endswith(HAT):
        return name, np.nan
    name = name.removesuffix(HAT)
    if name not in RATE_LENGTHS:
        raise ValueError(
            f"Got regressor {full!r}, but of {list(RATE_LENGTHS)} alone a simulation knows the non-dimensional form."
        )
    return name, lengths[RATE_LENGTHS[name]]


class Motion:
    """An aircraft with its aerodynamics and propulsion: `at` returns its loads and accelerations.

    The parameters are as of `skdgp.dynamics.simulate`; of the air, density and gravity count.
    With ``lagged`` the implicit regressors are the guess given to `at`, instead of the fixed
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
        self.aircraft = check_aircraft(aircraft)
        self.thrust = thrust
        air = as_air(air)
        self.gravity = air.gravity
        self._density = air.density
        lengths = self._check_lengths()
        sources = [_source(name, lengths) for name in self.aerodynamics.regressors]
        self.regressors = tuple(name for name, _ in sources)
        self._rate_lengths = np.array([length for _, length in sources])
        self.controls = tuple(name for name in self.regressors if name not in FROM_MOTION)
        unknown = [name for name in self.controls if name in CHANNELS and name not in CONTROLS]
        if unknown:
            raise ValueError(
                f"Got a model with the regressors {unknown}, which are neither controls nor "
                f"rebuilt along a flight: learn one without them. What is rebuilt: {', '.join(FROM_MOTION)}."
            )
        self._needs_angles = not set(EULER).isdisjoint(self.regressors)
        # Regressors that follow from the loads: their places, and those in `FROM_LOADS`
        self._implicit_places = [k for k, name in enumerate(self.regressors) if name in FROM_LOADS]
        self._load_places = [FROM_LOADS.index(self.regressors[k]) for k in self._implicit_places]

    def _check_lengths(self) -> dict[str, float]:
        """Return span and chord of the non-dimensional rates; warn if the aircraft has others."""
        lengths = self.aerodynamics.lengths(self.aircraft)
        own = self.aircraft.lengths
        if not np.isclose(list(lengths.values()), list(own.values()), rtol=0.01).all():
            warn(
                f"The model's rates were made non-dimensional by span {lengths['span']:g} m and chord "
                f"{lengths['chord']:g} m, but {self.aircraft!r} has others: is this the aircraft that "
                "the model was learned from?"
            )
        return lengths

    @property
    def inputs(self) -> frozenset[str]:
        """Names of the controls, and of the surfaces that they may be mixed from."""
        mixing = self.aerodynamics.mixing
        surfaces = () if mixing is None else mixing.surfaces
        return frozenset((*self.controls, *surfaces))

    @property
    def surfaces(self) -> frozenset[str]:
        """Names of the inputs that servos move."""
        return self.inputs - WITHOUT_SERVOS

    def factors(self, airspeed: Array) -> Array:
        """Return the regressors over their channels, (..., d): what makes a rate non-dimensional, or 1."""
        L = self._rate_lengths
        return np.where(np.isnan(L), 1.0, L / (2.0 * airspeed[..., None]))

    def mixed(self, controls: Mapping) -> dict:
        """Return all controls of the model, made from surfaces where these are given; ValueError if one is missing."""
        if not isinstance(controls, Mapping):
            raise TypeError(
                f"Got {type(controls).__name__} as controls, but expected values by name: {{name: value}}."
            )
        mixed = {}
        mixing = self.aerodynamics.mixing
        if mixing is not None and controls.keys() >= set(mixing.surfaces):
            surfaces = [np.asarray(controls[name], dtype=float) for name in mixing.surfaces]
            for name, row in zip(mixing.controls, mixing.matrix, strict=True):
                if name in self.controls:
                    mixed[name] = sum(map(np.multiply, row, surfaces))
        controls = mixed | dict(controls)
        if not controls.keys() >= {*self.controls}:
            check_names(self.controls, controls, "controls")
        return controls

    def with_aerodynamics(self, aerodynamics: Aerodynamics) -> Motion:
        """Return the motion with other aerodynamics of the same regressors, such as drawn functions."""
        other = copy.copy(self)
        other.aerodynamics = aerodynamics
        return other

    def at(
        self,
        state: Array,
        controls: Mapping,
        air: LocalAir = STILL,
        guess: Array | None = None,
        drift: Array | float = 0.0,
        model: Any = None,
    ) -> Instant:
        """Return what happens at states (..., 13) under ``controls``, by name, each (...), in ``air``, else at rest.

        ``guess`` (..., 2) starts the search for the channels of `FROM_LOADS`, best from the last call; loads are
        NaN where no channels follow from them.
        ``drift`` (..., 6) is added to the coefficients, which are the aerodynamics', or those of another
        ``model``, a function of the regressors such as a tangent.
        """
        model = model or self.evaluated
        flow = self._flow(state, air)
        X = self._explicit(state, controls, flow, air)
        values = {**controls, "airspeed": flow.airspeed, "density": flow.density}
        other_loads = propulsive_loads(values, self.aircraft, self.thrust)

        def loaded() -> Instant:
            return self._loaded(state, X, model(X) + drift, flow, other_loads)

        if not self._implicit_places:
            return loaded()
        factors = self.factors(flow.airspeed)[..., self._implicit_places]

        def loaded_by(guess: Array) -> Instant:
            X[..., self._implicit_places] = guess[..., self._load_places] * factors
            now = loaded()
            return now._replace(implicit=self._from_loads(state, now, flow, air))

        if guess is None:
            guess = np.zeros((*state.shape[:-1], len(FROM_LOADS)))
        return loaded_by(guess) if self.lagged else self._fixed_point(loaded_by, guess)

    def _fixed_point(self, loaded_by: Callable[[Array], Instant], guess: Array) -> Instant:
        """Return the instant whose implicit regressors are those that follow from it, by iteration."""
        for _ in range(ITERATIONS):
            now = loaded_by(guess)
            result: Any = now.implicit
            off = ((result - guess) / (1.0 + np.abs(result)))[..., self._load_places]
            is_found = np.abs(off).max(axis=-1) < TOLERANCE
            if is_found.all():
                return now
            if np.all(is_found | np.isnan(off).any(axis=-1)):
                break
            guess = result
        return loaded_by(np.where(is_found[..., None], guess, np.nan))

    def _flow(self, state: Array, air: LocalAir) -> Flow:
        """Return the air that the aircraft meets."""
        velocity = state[..., VELOCITY]
        wind = None
        if air.wind is not None:
            wind = ned_to_body(state[..., ATTITUDE], air.wind)
            velocity = velocity - wind
        if air.gusts is not None:
            velocity = velocity - air.gusts.velocity
        altitude = -state[..., 2]
        density = self._density
        if density is None:
            density = density_or_nan(altitude)
        return Flow(velocity, wind, *air_data(velocity), altitude, density)

    def _explicit(self, state: Array, controls: Mapping, flow: Flow, air: LocalAir) -> Array:
        """Return the regressors (..., d); regressors that follow from the loads are not yet set."""
        rates = state[..., RATES]
        if air.gusts is not None:
            rates = rates - air.gusts.rates
        values = {
            **controls,
            **by_name(RATE_NAMES, rates),
            **by_name(BODY_VELOCITY, state[..., VELOCITY]),
            **flow._asdict(),
        }
        if self._needs_angles:
            values |= by_name(EULER, quaternion_to_euler(state[..., ATTITUDE]))
        X = np.empty((*state.shape[:-1], len(self.regressors)))
        for k, name in enumerate(self.regressors):
            X[..., k] = values.get(name, 0.0)
        return X * self.factors(flow.airspeed)

    def evaluated(self, X: Array) -> Array:
        """Return the model's coefficients (..., 6) at regressors (..., d), NaN where a state has diverged."""
        if np.isfinite(X).all():
            return self.aerodynamics(X)
        # models refuse infinite values
        finite = np.isfinite(X).all(axis=-1, keepdims=True)
        return np.where(finite, self.aerodynamics(np.where(finite, X, 0.0)), np.nan)

    def _loaded(
        self, state: Array, X: Array, C: Array, flow: Flow, other_loads: tuple[Array, Array]
    ) -> Instant:
        """Return what happens at coefficients (..., 6), with force and moment of the engine."""
        force, moment = aerodynamic_loads(C, flow.airspeed, flow.density, self.aircraft)
        force += other_loads[0]
        moment += other_loads[1]
        derivative = rigid_body_derivative(state, force, moment, self.aircraft, self.gravity)
        air = (flow.airspeed, flow.alpha, flow.beta, flow.density)
        return Instant(derivative, C, X, *air, force, None)

    def _from_loads(self, state: Array, now: Instant, flow: Flow, air: LocalAir) -> Array:
        """Return what follows from the loads, (..., 2), in the order of `FROM_LOADS`."""
        acceleration = now.derivative[..., VELOCITY]
        if flow.wind is not None:
            # a wind that is constant over the earth turns against the aircraft in body axes
            acceleration = acceleration + cross(state[..., RATES], flow.wind)
        if air.wind_rate is not None:
            acceleration = acceleration - ned_to_body(state[..., ATTITUDE], air.wind_rate)
        if air.gusts is not None:
            acceleration = acceleration - air.gusts.acceleration
        air_rates = air_data_slopes(flow.velocity) @ acceleration[..., None]
        return air_rates[..., 1:, 0]
