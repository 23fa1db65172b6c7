"""Trim: attitude and controls of steady flight, straight or turning, level or climbing."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics._control.jacobian import check_settled
from skdgp.dynamics._control.steady_flight import SteadyFlight
from skdgp.dynamics._equations.motion import Motion
from skdgp.dynamics._equations.rigid_body import RATES, STANDARD_GRAVITY
from skdgp.dynamics._vehicle.aircraft import Aircraft

__all__ = ["Trim", "trim"]


@dataclass(frozen=True, eq=False)
class Trim:
    """A steady flight, and how near to steady it is.

    Parameters
    ----------
    state : ndarray of shape (13,)
        See `STATE_NAMES`; above the origin, heading north.
    controls : dict of str to float
        All that the model and the engine need.
    airspeed, altitude, climb, turn_rate : float
        [m/s, m, rad, rad/s]; ``climb`` is the angle of the flight path.
    alpha, beta, phi, theta : float
        [rad].
    rates : ndarray of shape (3,)
        p, q, r [rad/s].
    coefficients : ndarray of shape (6,)
        CX CY CZ Cl Cm Cn.
    solved : tuple of str
        What was solved for; the rest was given.
    residual : float
        The largest acceleration that is left [m/s^2 or rad/s^2].
    beyond : dict
        Regressors outside what the model was learned from: name to (value, smallest, largest).
    """

    state: np.ndarray
    controls: dict
    airspeed: float
    altitude: float
    climb: float
    turn_rate: float
    alpha: float
    beta: float
    phi: float
    theta: float
    rates: np.ndarray
    coefficients: np.ndarray
    solved: tuple[str, ...]
    residual: float
    beyond: dict

    def __repr__(self):
        named = {name: getattr(self, name) for name in ("climb", "turn_rate", "alpha", "beta", "phi", "theta")}
        told = [f"{name} {value:.4g}" for name, value in (named | self.controls).items()]
        told += [f"beyond what was flown in {', '.join(self.beyond)}"] if self.beyond else []
        return f"Trim({self.airspeed:g} m/s, {', '.join(told)})"

    def to_frame(self) -> pd.DataFrame:
        """Return the trim as a table of one row; ``beyond`` lists names."""
        named = {name: getattr(self, name) for name in ("airspeed", "altitude", "climb", "turn_rate")}
        named |= {name: getattr(self, name) for name in ("alpha", "beta", "phi", "theta")}
        named |= dict(zip("pqr", self.rates, strict=True)) | self.controls
        named |= dict(zip(COEFFICIENTS, self.coefficients, strict=True))
        return pd.DataFrame([named | {"residual": self.residual, "beyond": ", ".join(self.beyond)}])


def trim(
    model,
    aircraft: Aircraft,
    airspeed: ArrayLike,
    *,
    altitude: float = 0.0,
    climb: float | None = 0.0,
    turn_rate: float | None = None,
    bank: float | None = None,
    beta: float | None = None,
    controls: Sequence[str] | None = None,
    fixed: Mapping[str, float] | None = None,
    limits: Mapping[str, tuple[float, float]] | None = None,
    thrust="auto",
    gravity: float = STANDARD_GRAVITY,
    density=None,
) -> Trim | list[Trim]:
    r"""Find the steady flight of an aircraft at an airspeed.

    Six accelerations vanish and the flight path has its angle (Stevens, Lewis & Johnson 2016, section 3.6),

    .. math:: \dot u = \dot v = \dot w = \dot p = \dot q = \dot r = 0, \quad
        \dot h = V \sin\gamma, \quad (p, q, r) = \dot\psi\,(-\sin\theta, \sin\phi\cos\theta, \cos\phi\cos\theta),

    solved for alpha, theta, phi and four controls: of the model, and the one that sets the thrust. With ``bank`` the
    turn rate is solved for instead of phi. With fewer controls, as without a rudder, sideslip is solved for instead of
    being zero, and so it is if both ``bank`` and ``turn_rate`` are given (a steady sideslip).

    Parameters
    ----------
    model : Aerodynamics, Pipeline or estimator
        As for :func:`skdgp.dynamics.as_aerodynamics`.
    aircraft : Aircraft
    airspeed : float or array-like of shape (n,)
        [m/s]; several give a list of trims.
    altitude : float
        [m], for the density of the air; a climb is steady at that altitude.
    climb : float or None
        Angle of the flight path [rad]; None: what the thrust that is ``fixed`` gives, or none in a glider.
    turn_rate, bank : float, optional
        Rate of change of heading [rad/s], or phi [rad]; neither: straight flight.
    beta : float, optional
        Sideslip [rad]; by default 0 where four controls can hold it.
    controls : sequence of str, optional
        Which controls to solve for; by default all that are not ``fixed``. At most four.
    fixed : mapping of str to float, optional
        Values of other controls. A ``throttle`` that the model knows but that does not set the thrust (an aircraft
        without a propeller) is otherwise in the middle of what was flown.
    limits : mapping of str to pair of float, optional
        Of controls, alpha, beta, phi, theta. By default controls and alpha may leave what the model was learned from
        by the width of it on either side, or 0.1 rad: a model knows nothing of stops, and beyond knows nothing at all.
        Where a model does not say what it was learned from, surfaces reach 45 degrees. ``throttle`` is 0 to 1,
        ``thrust`` > 0.
    thrust, gravity, density
        As for :func:`skdgp.dynamics.simulate`.

    Returns
    -------
    Trim or list of Trim

    Raises
    ------
    ValueError
        If there is no such flight: which accelerations are left, and what is at its limit. If what is asked for is
        not finite, or an angle beyond a right one.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, trim
    >>> def linear(X):
    ...     alpha, beta, p, q, r, elevator, aileron, rudder = X.T
    ...     lift = 0.3 + 4.5 * alpha
    ...     return np.stack([-0.03 - 0.06 * lift**2 + lift * alpha, -0.5 * beta + 0.1 * rudder, -lift,
    ...                      -0.05 * beta - 0.4 * p + 0.1 * r + 0.1 * aileron, 0.02 - 0.6 * alpha - 9 * q - elevator,
    ...                      0.08 * beta - 0.03 * p - 0.1 * r - 0.06 * rudder], axis=-1)
    >>> names = ["alpha", "beta", "p_hat", "q_hat", "r_hat", "elevator", "aileron", "rudder"]
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> level, turning = (trim(Aerodynamics(linear, names), aircraft, 20.0, bank=phi) for phi in (0.0, 0.5))
    >>> round(level.alpha, 4), round(level.controls["elevator"], 4), round(level.controls["thrust"], 2)
    (0.0154, 0.0107, 12.16)
    >>> round(turning.turn_rate, 3), round(float(9.80665 * np.tan(0.5) / 20.0), 3)
    (0.264, 0.268)
    """
    motion = Motion(model, aircraft, thrust=thrust, gravity=gravity, density=density)
    airspeeds = np.asarray(airspeed, dtype=float)
    if airspeeds.ndim > 1 or not np.all(np.isfinite(airspeeds) & (airspeeds > 0)):
        raise ValueError(f"Got airspeed={airspeed!r}, but expected one or more numbers > 0 [m/s].")
    given = {"altitude": altitude, "climb": climb, "turn_rate": turn_rate, "phi": bank, "beta": beta}
    if bank is None and turn_rate is None:
        given["turn_rate"] = 0.0
    steady = SteadyFlight(motion, given, controls, dict(fixed or {}), dict(limits or {}))
    found, near = [], None
    for one in np.atleast_1d(airspeeds).tolist():
        near = steady.solve(one, near)
        found.append(_trim_of(steady, near, one))
    return found if airspeeds.ndim else found[0]


def _trim_of(steady: SteadyFlight, x: np.ndarray, airspeed: float) -> Trim:
    """Return the trim that the values of the unknowns make."""
    known, state, controls = steady.flight(x, airspeed)
    now = steady.instant(known, state, controls)
    check_settled(now)
    aerodynamics, bounds = steady.motion.aerodynamics, ()
    if aerodynamics.limits is not None:
        bounds = zip(aerodynamics.regressors, now.regressors.tolist(), *aerodynamics.limits.tolist(), strict=True)
    named = {k: float(known[k]) for k in ("altitude", "climb", "turn_rate", "alpha", "beta", "phi", "theta")}
    return Trim(
        state=state,
        controls={name: float(value) for name, value in controls.items()},
        airspeed=airspeed,
        **named,
        rates=state[RATES].copy(),
        coefficients=now.coefficients,
        solved=steady.unknowns,
        residual=float(np.abs(steady.residual(x, airspeed)[:6]).max()),
        beyond={name: (value, low, high) for name, value, low, high in bounds if not low <= value <= high},
    )
