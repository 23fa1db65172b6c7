r"""Effects of alpha_dot and beta_dot that a model without them merges with other derivatives.

Most flights do not tell alpha_dot from q and beta_dot from r (Klein & Morelli 2006, section 5.1). A
model without them gives their effect to the regressors that they follow from. With
:math:`\dot\alpha = S x` of the motion that the loads of the model cause without gravity, a slope by
x holds :math:`C_{\dot\alpha} S`. A tail in the downwash gives :math:`C_{\dot\alpha} = C_q\,
d\epsilon/d\alpha` (Etkin & Reid 1996, section 5.5). The downwash is not known here, so
:math:`C_{\dot\alpha}` is zero with a standard deviation of `RELATIVE_STD` of :math:`C_q`, and of
:math:`C_r` for beta_dot. The square of :math:`C_q` is the model's, plus the variance
of its bias: where gusts make it vanish, :math:`C_{\dot\alpha}` need not vanish.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from skdgp._compute.typing import Array
from skdgp._flight.channels import RATES
from skdgp._flight.frames import air_data_slopes, air_velocity, cross
from skdgp.dynamics._motion import Instant, Motion
from skdgp.dynamics._rigid_body import dynamic_pressure

# Rate of each air angle, and the rate of rotation whose slopes have a similar effect
ROTATION_OF = {"alpha_dot": "q", "beta_dot": "r"}
# Standard deviation of the slopes by alpha_dot and beta_dot over those by q and r; a guess, for a
# tail in the downwash
RELATIVE_STD = np.array([0.4, 0.2])


class UnsteadyTerms(NamedTuple):
    """What alpha_dot and beta_dot may change of C: slopes @ (missing * rates - relation @ regressors)."""

    slopes: Array  #: One standard deviation of the slopes of C by them [s/rad], (..., 6, 2)
    #: S, their slopes by the regressors, less their slopes as regressors themselves, (..., 2, d)
    relation: Array
    missing: Array  #: Whether they are no regressors, (2, 1)

    @property
    def errors(self) -> Array:
        """Errors of the slopes of C, (..., 6, d, 2)."""
        return -np.einsum("...ij,...jk->...ikj", self.slopes, self.relation)

    def coefficients(self, angle_rates: Array, regressors: Array) -> Array:
        """Return the change of C (..., 6, k) by changes of alpha_dot, beta_dot (..., 2, k), regressors (..., d, k)."""
        return self.slopes @ (self.missing * angle_rates - self.relation @ regressors)


def unsteady_terms(motion: Motion, now: Instant, slopes: Array) -> UnsteadyTerms:
    """Return the unsteady terms at a flight, by the slopes (..., 6, d) of the model or of its paths."""
    units = _units(motion, now)
    std = np.zeros((*slopes.shape[:-1], 2))
    relation = _angle_rate_slopes(motion, now, slopes, units)
    missing = np.ones((2, 1), dtype=bool)
    for j, (angle_rate, rotation) in enumerate(ROTATION_OF.items()):
        for k, name in enumerate(motion.regressors):
            if name == rotation:
                std[..., j] = RELATIVE_STD[j] * slopes[..., k] / units[..., k, None]
            if name == angle_rate:
                relation[..., j, k] -= units[..., k]
                missing[j] = False
    return UnsteadyTerms(std, relation, missing)


def _units(motion: Motion, now: Instant) -> Array:
    """Return the channel over its regressor (..., d): 2 V / b [1/s] of p_hat, 1 of p and of alpha."""
    units = np.ones((*np.shape(now.airspeed), len(motion.regressors)))
    for k in range(len(motion.regressors)):
        units[..., k] /= motion.factor(k, now.airspeed)
    return units


def _angle_rate_slopes(motion: Motion, now: Instant, slopes: Array, units: Array) -> Array:
    r"""Return S (..., 2, d), slopes of alpha_dot and beta_dot by the regressors, without gravity.

    .. math:: \dot V = F_A(x) / m - \omega(x) \times V
    """
    aircraft = motion.aircraft
    velocity = air_velocity(now.airspeed, now.alpha, now.beta)
    force_per_slope = dynamic_pressure(now.airspeed, now.density) * aircraft.wing_area
    acceleration = (force_per_slope / aircraft.mass)[..., None, None] * slopes[..., :3, :]
    for k, name in enumerate(motion.regressors):
        if name in RATES:
            axis = np.eye(3)[RATES.index(name)] * np.ones_like(velocity)
            acceleration[..., k] -= cross(axis, velocity) * units[..., k, None]
    return air_data_slopes(velocity)[..., 1:, :] @ acceleration
