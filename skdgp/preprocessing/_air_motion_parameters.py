"""Parameters of the filter-error method, with prior knowledge of small aircraft and their sensors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array, Indices, Vector
from skdgp._flight.channels import COEFFICIENTS

Prior = Mapping[str, tuple[float, float]]
"""Mean and standard deviation; of noises the median, and the standard deviation of the logarithm."""

TERMS: dict[str, tuple[str, ...]] = {
    "CX": ("0", "alpha", "alpha2"),
    "CY": ("0", "beta", "p", "r", "rudder"),
    "CZ": ("0", "alpha", "q", "elevator"),
    "Cl": ("0", "beta", "p", "r", "aileron", "rudder"),
    "Cm": ("0", "alpha", "q", "elevator"),
    "Cn": ("0", "beta", "p", "r", "aileron", "rudder"),
}
"""Terms of each coefficient; those of surfaces that a flight lacks are left out."""
DERIVATIVES: Prior = {
    "CX_alpha": (0.2, 1.0), "CX_alpha2": (0.0, 5.0), "CY_beta": (-0.5, 0.5), "CY_p": (0.0, 0.5),
    "CY_r": (0.1, 0.5), "CZ_alpha": (-4.5, 1.5), "CZ_q": (-5.0, 10.0), "CZ_elevator": (-0.2, 0.5),
    "Cl_beta": (-0.05, 0.1), "Cl_p": (-0.4, 0.3), "Cl_r": (0.1, 0.2), "Cm_alpha": (-0.5, 0.7),
    "Cm_q": (-8.0, 10.0), "Cn_beta": (0.06, 0.1), "Cn_p": (-0.03, 0.2), "Cn_r": (-0.1, 0.2),
}  # fmt: skip
"""Of small aircraft (Beard & McLain 2012, appendix E; Paw 2009), with wide standard deviations [1/rad]."""
OTHER_DERIVATIVE = (0.0, 1.0)
SHARED: Prior = {
    "servo_lag": (0.03, 0.05),  # [s]
    "thrust_scale": (0.0, 0.1),
    "airspeed_scale": (0.0, 0.03),
    "arm_x": (0.0, 0.03),  # inertial sensors from the centre of gravity [m]
    "arm_y": (0.0, 0.01),
    "arm_z": (0.0, 0.03),
    "alpha_bias": (0.0, 0.02),  # of vanes [rad]
    "beta_bias": (0.0, 0.02),
}
OWN: Prior = {
    "wind_north": (0.0, 30.0),  # steady [m/s]
    "wind_east": (0.0, 30.0),
    "wind_down": (0.0, 0.1),
    "p_bias": (0.0, 0.003),  # left over by the path [rad/s]
    "q_bias": (0.0, 0.003),
    "r_bias": (0.0, 0.003),
}
"""Constants of a flight."""
SHARED_NOISES: Prior = {
    "time_h": (1.5, 0.8),  # correlation of gusts, horizontal and vertical [s]
    "time_v": (1.5, 0.8),
    "fast_h": (0.1, 0.5),  # intensity of the faster part of gusts, over that of the slower one
    "fast_v": (0.1, 0.5),
    "faster_h": (0.2, 0.5),  # its correlation time, over that of the slower one
    "faster_v": (0.2, 0.5),
    "drive_p": (0.02, 1.0),  # random angular acceleration [rad/s^2/sqrt(Hz)]
    "drive_q": (0.02, 1.0),
    "drive_r": (0.02, 1.0),
    "surface": (0.05, 1.0),  # error of a surface's position, in its change within a step
    "ax": (0.1, 0.3),  # sensors, with what the model leaves out; medians follow the log
    "ay": (0.1, 0.3),
    "az": (0.1, 0.3),
    "gyro": (0.005, 0.3),
    "airspeed": (0.3, 1.0),
    "vane": (0.01, 1.0),
}
OWN_NOISES: Prior = {
    "gust_north": (0.5, 1.5),  # [m/s]
    "gust_east": (0.5, 1.5),
    "gust_down": (0.5, 1.5),
    "path_y": (0.1, 1.0),  # air velocity that errors of attitude and ground path make, body axes
    "path_z": (0.1, 0.6),
}


class Parameters(NamedTuple):
    """Parameters of some flights: those that all share, and those of each."""

    names: list[str]
    mean: Vector
    std: Vector
    places: Indices  # (n_flights, k) of the k parameters of each flight
    local_names: list[str]

    @classmethod
    def of(cls, shared: Prior, own: Prior, n_flights: int) -> Parameters:
        """Return the parameters of ``n_flights`` flights."""
        owned = {f"{name} {f}": prior for f in range(n_flights) for name, prior in own.items()}
        mean, std = np.array(list((dict(shared) | owned).values())).T
        first = np.arange(len(shared))
        places = [
            np.append(first, len(shared) + f * len(own) + np.arange(len(own)))
            for f in range(n_flights)
        ]
        return cls([*shared, *owned], mean.copy(), std.copy(), np.array(places), [*shared, *own])

    def values(self, x: Array, flight: int) -> dict[str, Array]:
        """Return the values (...) of the parameters of one flight, from all (..., p)."""
        local = np.moveaxis(x[..., self.places[flight]], -1, 0)
        return dict(zip(self.local_names, local, strict=True))

    @property
    def precision(self) -> Vector:
        """The precision of the prior."""
        return self.std**-2.0


def derivatives_of(terms: Mapping[str, Sequence[str]], surfaces: Sequence[str]) -> Prior:
    """Return the priors of the derivatives of all terms but those of surfaces that are not there."""
    missing = {"elevator", "aileron", "rudder"} - set(surfaces)
    names = [f"{C}_{term}" for C in COEFFICIENTS for term in terms[C] if term not in missing]
    return {name: DERIVATIVES.get(name, OTHER_DERIVATIVE) for name in names}
