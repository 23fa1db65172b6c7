"""Parameters of the filter-error method, with their priors: derivatives, constants and noises.

Derivatives and constants of sensors and servos are shared by all flights of an aircraft; wind and
biases of rates belong to one flight. Noises likewise: gusts are a Gauss-Markov process on each axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS, HAT, RATES, SURFACES
from skdgp.estimation._sensors import AIR_NOISE, AIR_SENSOR_ERRORS, RATE_BIASES, WIND_STD, Prior

STATE_TERMS = ("0", "alpha", "alpha2", "beta", "p", "q", "r", "thrust")
"""Terms of a coefficient before those of the surfaces; thrust over dynamic pressure and wing area."""
TERMS: dict[str, tuple[str, ...]] = {
    "CX": ("0", "alpha", "alpha2"),
    "CY": ("0", "beta", "p", "r", "rudder"),
    "CZ": ("0", "alpha", "q", "elevator"),
    "Cl": ("0", "beta", "p", "r", "aileron", "rudder"),
    "Cm": ("0", "alpha", "q", "elevator"),
    "Cn": ("0", "beta", "p", "r", "aileron", "rudder"),
}
"""Terms of each coefficient with wide priors; those of surfaces that a flight lacks are left out."""
LINEAR_TERMS = ("0", "alpha", "beta", "p", "q", "r", *SURFACES)
ALL_TERMS = dict.fromkeys(COEFFICIENTS, (*LINEAR_TERMS, "thrust")) | {
    "CX": (*LINEAR_TERMS, "alpha2")
}
"""These and all other linear terms: couplings, whose priors are narrow. CX by thrust is its scale."""
DERIVATIVES: Prior = {
    "CX_alpha": (0.2, 1.0), "CX_alpha2": (0.0, 5.0), "CY_beta": (-0.5, 0.5), "CY_p": (0.0, 0.5),
    "CY_r": (0.1, 0.5), "CZ_alpha": (-4.5, 1.5), "CZ_q": (-5.0, 10.0), "CZ_elevator": (-0.2, 0.5),
    "Cl_beta": (-0.05, 0.1), "Cl_p": (-0.4, 0.3), "Cl_r": (0.1, 0.2), "Cm_alpha": (-0.5, 0.7),
    "Cm_q": (-8.0, 10.0), "Cn_beta": (0.06, 0.1), "Cn_p": (-0.03, 0.2), "Cn_r": (-0.1, 0.2),
}  # fmt: skip
"""Of small aircraft (Beard & McLain 2012, appendix E; Paw 2009), with wide standard deviations [1/rad]."""
COUPLING_STD = {"CX": 0.05, "CY": 0.05, "CZ": 0.1, "Cl": 0.02, "Cm": 0.05, "Cn": 0.01}
"""Standard deviations of couplings, of zero in the mean [1/rad]; trials on one aircraft."""
TAIL = ("elevator", "rudder")
"""Surfaces that a slipstream may reach."""
WINDS = ("wind_north", "wind_east", "wind_down")
PITOT = ("airspeed_scale", "wind_north", "wind_east")
"""Parameters of the airspeed in a steady wind."""
ARM = ("arm_x", "arm_y", "arm_z")
AIRCRAFT_CONSTANTS: Prior = {
    "servo_lag": (0.03, 0.05),  # [s]
    "servo_delay": (0.0, 1e-6),  # zero: its error counts by `add_delay_error` [s]
    "thrust_scale": (0.0, 0.1),
    "slipstream": (0.0, 3.0),  # wing area over the propeller's disk of a tail behind it
    **AIR_SENSOR_ERRORS,
}
"""Constants of an aircraft and its sensors."""
FLIGHT_CONSTANTS: Prior = {
    "wind_north": (0.0, WIND_STD),  # steady [m/s]
    "wind_east": (0.0, WIND_STD),
    "wind_down": (0.0, 0.1),
    **RATE_BIASES,
}
"""Constants of a flight."""
SENSOR_CONSTANTS = ("thrust_scale", "airspeed_scale", "wind_down", *RATE_BIASES)
"""Constants whose priors hold for any flight, with a mean of zero."""
AIRCRAFT_NOISES: Prior = {
    "time_h": (1.5, 0.8),  # correlation of gusts, horizontal and vertical [s]
    "time_v": (1.5, 0.8),
    "rolling": (1.0, 1.0),  # intensity of the roll of the air, relative to the one by its spectrum
    "drive_p": (0.02, 1.0),  # random angular acceleration [rad/s^2/sqrt(Hz)]
    "drive_q": (0.02, 1.0),
    "drive_r": (0.02, 1.0),
    "surface": (0.05, 2.0),  # error of a surface's position, in its change within a step
    **AIR_NOISE,
}
"""Noises of an aircraft and its sensors, and of the air's spectrum."""
FLIGHT_NOISES: Prior = {
    "gust_north": (0.5, 1.5),  # [m/s]
    "gust_east": (0.5, 1.5),
    "gust_down": (0.5, 1.5),
    "path_y": (0.1, 1.0),  # air velocity that errors of attitude and ground path make, body axes
    "path_z": (0.1, 0.6),
}
"""Noises of a flight."""
GUST_AXES = ("gust_north", "gust_east", "gust_down")
PATH_ERRORS = ("path_y", "path_z")


class Parameters(NamedTuple):
    """Parameters of the flights with their priors: shared ones, and local ones for each flight."""

    names: list[str]
    mean: Vector  # (p,)
    std: Vector  # (p,)
    places: Indices  # (n_flights, k) of the k parameters of each flight
    local_names: list[str]
    n_held: int  # the first ones, which are not estimated

    @classmethod
    def of(cls, shared: Prior, local: Prior, n_flights: int, n_held: int = 0) -> Parameters:
        """Return the parameters of ``n_flights`` flights: shared ones, and local ones for each."""
        priors = dict(shared)
        places = []
        for flight in range(n_flights):
            first = len(priors)
            priors |= {f"{name} {flight}": prior for name, prior in local.items()}
            places.append([*range(len(shared)), *range(first, len(priors))])
        mean, std = np.array(list(priors.values())).T.copy()
        return cls([*priors], mean, std, np.array(places), [*shared, *local], n_held)

    def values(self, x: Array, flight: int) -> dict[str, Array]:
        """Return the values (...) of the parameters of one flight, from all (..., p)."""
        local = np.moveaxis(x[..., self.places[flight]], -1, 0)
        return dict(zip(self.local_names, local, strict=True))

    def places_of(self, flight: int, names: Sequence[str]) -> Indices:
        """Return the places of parameters of a flight by name."""
        return self.places[flight][[self.local_names.index(name) for name in names]]

    def places_of_all(self, names: Sequence[str]) -> Indices:
        """Return the places of parameters of all flights by name, ascending."""
        columns = [self.local_names.index(name) for name in names]
        return np.unique(self.places[:, columns])

    def free_places(self, flight: int) -> Indices:
        """Return the places of the parameters of a flight that are estimated."""
        places = self.places[flight]
        return places[places >= self.n_held]


class Sums:
    """Score, information and variation of the score of parameters x: of the prior, and of what is added."""

    def __init__(self, x: Vector, parameters: Parameters) -> None:
        precision = parameters.std**-2.0
        self.free = slice(parameters.n_held, None)
        self.score = (x - parameters.mean) * precision
        self.information = np.diag(precision)
        self.variation = np.diag(precision)

    def add(
        self,
        places: Indices,
        score: Vector,
        information: Matrix,
        variation: Matrix | None = None,
    ) -> None:
        """Add sums over samples for the parameters at some places; by default the score varies as the model says."""
        block = np.ix_(places, places)
        self.score[places] += score
        self.information[block] += information
        self.variation[block] += information if variation is None else variation

    def damped(self, damping: float) -> tuple[Matrix, Vector]:
        """Return information and score of the estimated parameters, with a larger diagonal (Levenberg 1944)."""
        information = self.information[self.free, self.free]
        return information + damping * np.diag(np.diag(information)), self.score[self.free]

    def squared_length(self, step: Vector) -> float:
        """Return the squared length of a step of the estimated parameters, in standard deviations."""
        return float(step @ self.information[self.free, self.free] @ step)


class GustProcesses(NamedTuple):
    """Gusts north, east, down: Gauss-Markov processes, (..., 3)."""

    std: Array  # [m/s]
    time: Array  # correlation time [s]

    @classmethod
    def of(cls, value: Mapping[str, Any]) -> GustProcesses:
        """Return the gusts of noises by name."""
        return cls(stacked(value, *GUST_AXES), stacked(value, "time_h", "time_h", "time_v"))


def stacked(value: Mapping[str, Any], *names: str) -> Array:
    """Return values by name along the last axis."""
    return np.stack([value[name] for name in names], axis=-1)


def derivatives_of(terms: Mapping[str, Sequence[str]], surfaces: Sequence[str]) -> Prior:
    """Return the priors of the derivatives of all terms, without missing surfaces."""
    missing = {*SURFACES} - {*surfaces}
    priors = {}
    for coefficient in COEFFICIENTS:
        for term in terms.get(coefficient, ()):
            if term not in missing:
                name = f"{coefficient}_{term}"
                priors[name] = _prior_of(coefficient, term)
    return priors


def is_coupling(name: str) -> bool:
    """Return whether a derivative is outside of `TERMS`, so that its prior is narrow."""
    coefficient, term = name.split("_", 1)
    return term not in TERMS[coefficient]


def _prior_of(coefficient: str, term: str) -> tuple[float, float]:
    """Return mean and standard deviation of a derivative."""
    name = f"{coefficient}_{term}"
    if is_coupling(name):
        factor = 3.0 if term in RATES else 1.0  # trials on one aircraft
        return 0.0, factor * COUPLING_STD[coefficient]
    return DERIVATIVES.get(name, (0.0, 1.0))  # wide where no usual value is known


def prior_deviations(coefficients: Sequence[str], regressors: Sequence[str]) -> Matrix:
    """Return prior standard deviations (P, d) of derivatives [1/rad], NaN where `TERMS` has none.

    Rates, such as q or q_hat, are non-dimensional.
    """
    priors = derivatives_of(TERMS, SURFACES)
    rows = []
    for coefficient in coefficients:
        names = [f"{coefficient}_{str(name).removesuffix(HAT)}" for name in regressors]
        rows.append([priors.get(name, (0.0, np.nan))[1] for name in names])
    return np.array(rows)
