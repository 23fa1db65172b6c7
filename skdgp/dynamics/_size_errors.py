"""Errors of the sizes of an aircraft, and their effect on the learned coefficients."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import ACCELERATION_LENGTHS, COEFFICIENTS, RATE_LENGTHS
from skdgp._flight.tables import check_number

MOMENTS = ("Ixx", "Iyy", "Izz")
PRODUCT = "Ixz"
# A measured force coefficient is m f / (qbar S), a moment coefficient I omega_dot / (qbar S b) but
# for products of inertia and gyroscopic moments: powers of the quantities in each
FORCE_POWERS = {"mass": 1.0, "wing_area": -1.0}
POWERS = {
    **dict.fromkeys(COEFFICIENTS[:3], FORCE_POWERS),
    "Cl": {"Ixx": 1.0, "span": -1.0, "wing_area": -1.0},
    "Cm": {"Iyy": 1.0, "chord": -1.0, "wing_area": -1.0},
    "Cn": {"Izz": 1.0, "span": -1.0, "wing_area": -1.0},
}


@dataclass(frozen=True)
class ScaleFactor:
    """An error that several quantities of an aircraft share.

    Parameters
    ----------
    std : float
        Relative standard deviation.
    powers : mapping of str to float
        Powers of the factor in each quantity: mass, wing_area, span, chord, Ixx, Iyy, Izz, and full
        throws of controls. An error of 1 % of the aspect ratio b^2 / S is one of
        -1 % of ``wing_area`` and, as c = S / b, of -1 % of ``chord``. The product Ixz has no size
        to be relative to: its errors are of sqrt(Ixx Izz).
    source : str
        Source of the estimate.
    added : mapping of str to float
        Of a learned model, an error that adds to its coefficients, such as an error of the thrust:
        the change by an error of 100 %, of coefficients and their slopes by regressors, "CX",
        "CX_alpha", ...
    """

    std: float
    powers: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    added: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self):
        std = check_number("std of a scale factor", self.std, is_open=False)
        object.__setattr__(self, "std", std)
        object.__setattr__(self, "powers", _floats(self.powers))
        object.__setattr__(self, "added", _floats(self.added))


def _floats(values: Mapping) -> dict[str, float]:
    return {str(name): float(value) for name, value in values.items()}


def errors_of_sizes(
    deviations: Mapping[str, ScaleFactor],
    inertia: Array,
    regressors: tuple[str, ...],
    values: Array,
) -> Array:
    """Return errors of coefficients and slopes, ``values`` (6, 1 + regressors), by each factor, (factors, ...).

    A relative error scales them. Slopes are by the non-dimensional rates, p b / 2V, and by controls in the unit
    of the log, so that a full throw which is wrong by 1 % makes the effect of the control wrong by -1 %. One of
    Ixz by e sqrt(Ixx Izz) leaves N / Izz in the moment L, and L / Ixx in N: dCl = -e sqrt(Ixx / Izz) Cn and
    dCn = -e sqrt(Izz / Ixx) Cl, from L = Ixx p_dot - Ixz r_dot + ... One of the thrust is ``added``.
    """
    ratio = np.sqrt(inertia[0, 0] / inertia[2, 2])
    endings = ["", *(f"_{name}" for name in regressors)]
    errors = []
    for factor in deviations.values():
        of_coefficients = [_power(POWERS[name], factor) for name in COEFFICIENTS]
        of_slopes = [_power(_powers_of_slope(name), factor) for name in regressors]
        error = values * np.add.outer(of_coefficients, [0.0, *of_slopes])
        product = factor.powers.get(PRODUCT, 0.0)
        error[3] -= product * ratio * values[5]
        error[5] -= product / ratio * values[3]
        for row, name in zip(error, COEFFICIENTS, strict=True):
            row += [factor.added.get(name + ending, 0.0) for ending in endings]
        errors.append(factor.std * error)
    return np.array(errors)


def _powers_of_slope(regressor: str) -> dict[str, float]:
    """Return the powers of quantities in the slope by a regressor: p b / 2V, p_dot (b / 2V)^2, or a control."""
    if regressor in ACCELERATION_LENGTHS:
        return {ACCELERATION_LENGTHS[regressor]: -2.0}
    if regressor in RATE_LENGTHS:
        return {RATE_LENGTHS[regressor]: -1.0}
    return {regressor: -1.0}


def _power(powers: Mapping[str, float], factor: ScaleFactor) -> float:
    """Return the power of a factor in a product of powers of quantities."""
    return sum(power * factor.powers.get(name, 0.0) for name, power in powers.items())
