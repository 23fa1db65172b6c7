"""The aircraft of the example flights, and its true aerodynamics."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.files import read_toml
from skdgp._compute.typing import Array
from skdgp._flight.channels import HAT, RATE_LENGTHS, RATES
from skdgp.dynamics import Aerodynamics, Aircraft, Propeller

# Columns of the regressors: angles [rad]; rates times b/2V (p, r, beta_dot) or c/2V (q, alpha_dot)
REGRESSORS = ("alpha", "beta", *RATES, "alpha_dot", "beta_dot", "elevator", "aileron", "rudder")

FILE = Path(__file__).with_name("brumby.toml")
BRUMBY = Aircraft.from_file(FILE)
PROPELLER = Propeller(**read_toml(FILE)["propeller"])


def brumby_coefficients(regressors: ArrayLike) -> Array:
    r"""Return CX CY CZ Cl Cm Cn, (..., 6), of `REGRESSORS` (..., 10); rates are relative to the air.

    The parts, with :math:`s = \sin\alpha`:

    wing
        Polhamus' leading-edge suction analogy (NASA TN D-3767, 1966): potential and vortex normal
        force :math:`K_p\, s \cos\alpha` and :math:`K_v\, s |s|`, the vortex breaking down near 18
        degrees; each acts at its own station, so Cm bends with alpha. The remaining suction
        increases CX.
    heave
        Normal force of q and alpha_dot, half a chord behind the centre of gravity.
    elevons
        Each one's force saturates with ITS deflection, left = elevator + aileron and right =
        elevator - aileron: the two commands couple. Drag of left and right differ, so aileron yaws.
    fin
        Force of the local sideslip (beta, roll and yaw rates, sidewash lag) and of the rudder,
        fading as the wing shades the fin at alpha; its arm turns it into Cl and Cn.
    wing and body in sideslip
        Dihedral effect, roll due to yaw and yaw due to roll grow with wing normal force; roll
        damping falls.

    Analytic in every argument: complex steps give exact derivatives.
    """
    columns = np.moveaxis(np.asarray(regressors), -1, 0)
    alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder = columns
    s = np.sin(alpha)
    beta2 = beta * beta
    # fraction of the vortex not broken down
    beyond = (alpha - 0.32) / 0.04
    ordered = 1.0 / (1.0 + np.exp(beyond))

    head_on = 1.0 - beta2
    potential = 2.7 * s * np.cos(alpha) * head_on
    # s |s|, without its bend at zero
    signed_square = s * np.sqrt(s * s + 1e-4)
    vortex = 3.0 * signed_square * ordered * head_on
    suction = 1.5 * s * s * ordered * head_on
    wing = potential + vortex
    plunge = 1.9 * q + 0.6 * alpha_dot
    heave = plunge * (0.5 + 0.5 * ordered)
    lift_left, drag_left = _elevon(elevator + aileron, s)
    lift_right, drag_right = _elevon(elevator - aileron, s)
    elevons = 0.36 * (lift_left + lift_right)
    drag_of_elevons = 0.5 * (drag_left + drag_right)
    drag = drag_of_elevons + 0.07 * rudder * rudder + 0.05 * beta2
    sidewash = beta + 0.14 * p - 0.68 * r + 0.15 * beta_dot
    fin = _fin(sidewash, rudder, s)

    CX = -0.026 + suction - drag
    side_force = (0.20 + 1.5 * beta2) * beta
    CY = fin - side_force + 0.06 * p
    CZ = -(wing + heave + elevons)
    roll_by_elevons = 0.075 * (lift_left - lift_right)
    Cl = 0.07 * fin + roll_by_elevons + _roll_in_sideslip(beta, p, r, s, wing)
    pitch_by_wing = -0.055 * potential - 0.10 * vortex
    Cm = 0.0085 + pitch_by_wing - 0.50 * heave - 0.44 * elevons + 0.06 * beta2
    yaw_by_elevons = -0.10 * (drag_left - drag_right)
    Cn = -0.34 * fin + yaw_by_elevons + _yaw_in_sideslip(beta, p, r, s, wing)
    return np.stack((CX, CY, CZ, Cl, Cm, Cn), axis=-1)


def _elevon(deflection: Array, s: Array) -> tuple[Array, Array]:
    """Return lift and drag of an elevon at the sine of alpha."""
    lift = _soft(deflection, 0.28) * (1.0 - 2.0 * s * s)
    drag = deflection * (0.16 * deflection + 0.30 * s)
    return lift, drag


def _fin(sidewash: Array, rudder: Array, s: Array) -> Array:
    """Return the side force of the fin and the rudder."""
    shade = 1.0 - 1.2 * s
    force = 0.13 * _soft(rudder, 0.30) - 0.26 * _soft(sidewash, 0.30)
    return force * shade


def _roll_in_sideslip(beta: Array, p: Array, r: Array, s: Array, wing: Array) -> Array:
    """Return the roll moment of wing and body, without the fin."""
    dihedral = 0.015 + 0.17 * wing
    damping = 0.24 - 0.35 * s
    by_yaw = 0.02 + 0.20 * wing
    return by_yaw * r - dihedral * beta - damping * p


def _yaw_in_sideslip(beta: Array, p: Array, r: Array, s: Array, wing: Array) -> Array:
    """Return the yaw moment of wing and body, without the fin."""
    stability = 0.018 - 0.05 * s
    by_roll = 0.01 + 0.10 * wing
    damping = 0.02 + 0.08 * wing * wing
    return -stability * beta - by_roll * p - damping * r


def _soft(angle: Array, limit: float) -> Array:
    """Return the angle, softly saturated: slope 1 at zero, never beyond the limit [rad]."""
    return angle / np.sqrt(1.0 + (angle / limit) ** 2)


BRUMBY_AERODYNAMICS = Aerodynamics(
    brumby_coefficients, [name + HAT if name in RATE_LENGTHS else name for name in REGRESSORS]
)
"""The same as a model of an aircraft, with the names of non-dimensional rates."""
