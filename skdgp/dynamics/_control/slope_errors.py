r"""Errors of the slopes of a model at a flight that its posterior does not contain.

Most flights do not tell alpha_dot from q and beta_dot from r (Klein & Morelli 2006, section 5.1). A model without them
gives their effect to the regressors that they follow from. With :math:`\dot\alpha = S x` of the motion that the loads
of the model cause without gravity, a slope by x holds :math:`C_{\dot\alpha} S`. A tail in the downwash gives
:math:`C_{\dot\alpha} = C_q\, d\epsilon/d\alpha` (Etkin & Reid 1996, section 5.5). The downwash is not known here, so
:math:`C_{\dot\alpha}` is zero with a standard deviation of `SHARES` of :math:`C_q`, and of :math:`C_r` for beta_dot.
The square of :math:`C_q` is that of the model plus that of its deviation by method: where gusts make it vanish,
:math:`C_{\dot\alpha}` need not vanish.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import RATE_LENGTHS
from skdgp._flight.frames import air_data_slopes, air_velocity, cross
from skdgp.dynamics._equations.motion import Instant, Motion

LAGS = {"alpha_dot": "q", "beta_dot": "r"}
"""Rates of change, and the rates whose slopes theirs are shares of."""
SHARES = np.array([0.4, 0.2])


class Lag(NamedTuple):
    """What alpha_dot and beta_dot may change of C: slopes @ (missing * rates - relation @ regressors)."""

    slopes: Array
    """One standard deviation of the slopes of C by them [s/rad], (..., 6, 2)."""
    relation: Array
    """S, their slopes by the regressors, less what they are as regressors themselves, (..., 2, d)."""
    missing: Array
    """Whether they are no regressors, (2, 1)."""

    @property
    def errors(self) -> Array:
        """Errors of the slopes of C, (..., 6, d, 2)."""
        return -np.einsum("...ij,...jk->...ikj", self.slopes, self.relation)


def lag_of(motion: Motion, now: Instant, slopes: Array, scatter: ArrayLike = 0.0) -> Lag:
    """Return what alpha_dot and beta_dot may change at a flight, by the slopes (..., 6, d) of the model.

    ``scatter`` is the standard deviation of these slopes by method.
    """
    velocity = air_velocity(now.airspeed, now.alpha, now.beta)
    pressure = 0.5 * now.density * now.airspeed**2 * motion.aircraft.wing_area / motion.aircraft.mass
    acceleration = np.asarray(pressure)[..., None, None] * slopes[..., :3, :]
    by_rate = np.zeros((*slopes.shape[:-1], 2))
    own = np.zeros((*slopes.shape[:-2], 2, slopes.shape[-1]))
    size = np.copysign(np.hypot(slopes, scatter), slopes)
    for k, name in enumerate(motion.regressors):
        if name not in RATE_LENGTHS:
            continue
        unit = np.broadcast_to(1.0 / motion.factor(k, now.airspeed), np.shape(now.airspeed))  # of the regressor [rad/s]
        if name in LAGS:
            own[..., list(LAGS).index(name), k] = unit
            continue
        acceleration[..., k] -= cross(np.eye(3)["pqr".index(name)] * np.ones_like(velocity), velocity) * unit[..., None]
        if name in LAGS.values():
            by_rate[..., list(LAGS.values()).index(name)] = size[..., k] / unit[..., None]
    missing = np.array([[name not in motion.regressors] for name in LAGS])
    return Lag(SHARES * by_rate, air_data_slopes(velocity)[..., 1:, :] @ acceleration - own, missing)


def draw_errors(errors: Any, lag: Lag, n_paths: int, random_state: Seed) -> tuple[Array, Lag]:
    """Return draws of the errors of slopes at one flight, (n_paths, 6, d), and of the lag, with paths first."""
    seed = check_random_state(random_state).randint(2**31 - 1, size=4)  # other numbers than those of the paths
    rng = np.random.default_rng(seed)
    lag_drawn = lag._replace(slopes=lag.slopes * rng.standard_normal((n_paths, 1, 2)))
    drawn = np.zeros((n_paths, *lag.errors.shape[:-1]))
    for part in () if errors is None else (errors.random[0], errors.method[0]):
        drawn += np.moveaxis(part @ rng.standard_normal((part.shape[-1], n_paths)), -1, 0)
    return drawn, lag_drawn
