"""A Brumby-like UAV: cropped delta, two elevons, fin and rudder, pusher propeller; 45 kg, about 36 m/s.

The aerodynamics are the sum of a few parts (wing, elevons, fin, body), each a force with its point
of application. So the six coefficients share terms and depend on each other as on a real
aircraft. The numbers describe a plausible delta of aspect ratio 3, not measurements of any
aircraft.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from skdgp._compute.typing import Array
from skdgp.dynamics import Aircraft, Propeller, ThrustLine

# Columns of the regressors: angles [rad]; rates times b/2V (p, r, beta_dot) or c/2V (q, alpha_dot)
REGRESSORS = (
    "alpha",
    "beta",
    "p",
    "q",
    "r",
    "alpha_dot",
    "beta_dot",
    "elevator",
    "aileron",
    "rudder",
)

PROPELLER = Propeller(
    diameter=0.6, thrust_coefficients=(0.10, -0.045, -0.065), torque_coefficients=(0.0070, 0.0010, -0.0060),
    rotation=-1, speed_range=(280.0, 800.0),
)  # fmt: skip
BRUMBY = Aircraft(
    name="brumby", mass=45.0, inertia=np.array([[4.1, -0.06, -0.65], [-0.06, 9.2, 0.04], [-0.65, 0.04, 12.4]]),
    wing_area=2.59, span=2.80, chord=1.09, propeller=PROPELLER,
    thrust_line=ThrustLine(position=(-0.75, 0.0, -0.05), direction=(1.0, 0.0, -0.035)),
)  # fmt: skip


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

    Analytic in every argument: complex steps give exact derivatives (`brumby_derivatives`).
    """
    regressors = np.asarray(regressors)
    alpha, beta, p, q, r, alpha_dot, beta_dot, elevator, aileron, rudder = (
        regressors[..., k] for k in range(len(REGRESSORS))
    )
    s = np.sin(alpha)
    s2 = s * s
    beta2 = beta * beta
    ordered = 1.0 / (1.0 + np.exp((alpha - 0.32) / 0.04))

    head_on = 1.0 - beta2
    potential = 2.7 * s * np.cos(alpha) * head_on
    vortex = 3.0 * s * np.sqrt(s2 + 1e-4) * ordered * head_on
    wing = potential + vortex
    heave = (1.9 * q + 0.6 * alpha_dot) * (0.5 + 0.5 * ordered)

    left_elevon, right_elevon = elevator + aileron, elevator - aileron
    flow = 1.0 - 2.0 * s2
    lift_left, lift_right = _soft(left_elevon, 0.28) * flow, _soft(right_elevon, 0.28) * flow
    drag_left, drag_right = (
        left_elevon * (0.16 * left_elevon + 0.30 * s),
        right_elevon * (0.16 * right_elevon + 0.30 * s),
    )
    elevons = 0.36 * (lift_left + lift_right)

    shade = 1.0 - 1.2 * s
    sidewash = beta + 0.14 * p - 0.68 * r + 0.15 * beta_dot
    fin = (0.13 * _soft(rudder, 0.30) - 0.26 * _soft(sidewash, 0.30)) * shade

    return np.stack(
        (
            -0.026 + 1.5 * s2 * ordered * head_on - 0.5 * (drag_left + drag_right) - 0.07 * rudder * rudder
            - 0.05 * beta2,
            fin - (0.20 + 1.5 * beta2) * beta + 0.06 * p,
            -(wing + heave + elevons),
            0.07 * fin + 0.075 * (lift_left - lift_right) - (0.015 + 0.17 * wing) * beta
            - (0.24 - 0.35 * s) * p + (0.02 + 0.20 * wing) * r,
            0.0085 - 0.055 * potential - 0.10 * vortex - 0.50 * heave - 0.44 * elevons + 0.06 * beta2,
            -0.34 * fin - 0.10 * (drag_left - drag_right) - (0.018 - 0.05 * s) * beta - (0.01 + 0.10 * wing) * p
            - (0.02 + 0.08 * wing * wing) * r,
        ),
        axis=-1,
    )  # fmt: skip


def brumby_derivatives(regressors: ArrayLike) -> Array:
    """Return d coefficients / d regressors, (..., 6, 10), exact to rounding (complex steps, 1e-30)."""
    steps = np.asarray(regressors, dtype=float)[..., None, :] + 1e-30j * np.eye(len(REGRESSORS))
    return np.swapaxes(brumby_coefficients(steps).imag / 1e-30, -1, -2)


def _soft(angle: Array, limit: float) -> Array:
    """Return the angle, softly saturated: slope 1 at zero, never beyond the limit [rad]."""
    return angle / np.sqrt(1.0 + (angle / limit) ** 2)
