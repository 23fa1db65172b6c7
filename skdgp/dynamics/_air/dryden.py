"""Dryden gusts: white noise through the filters of MIL-F-8785C."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov
from sklearn.utils import check_random_state

from skdgp._compute.linalg import covariance_root
from skdgp._compute.typing import Array, Seed

FEET = 0.3048
CEILING = 1000 * FEET
"""Height [m] at which the low-altitude model ends."""


class Gusts(NamedTuple):
    """Motion of the air around the aircraft, body axes, each (n_times, n_flights, 3)."""

    velocity: np.ndarray
    """u, v, w of the air [m/s]."""
    acceleration: np.ndarray
    """Rate of change of the velocity [m/s^2]."""
    rates: np.ndarray
    """p, q, r of the air as if it turned like a rigid body [rad/s]."""


def low_altitude_turbulence(height: float, wind_at_6m: float) -> tuple[np.ndarray, np.ndarray]:
    """Return scale lengths (3,) [m] and intensities (3,) [m/s] of u, v, w below 1000 ft (MIL-F-8785C, 3.7.3.4).

    With h in feet: L_w = h, L_u = L_v = h / (.177 + .000823 h)^1.2, sigma_w = .1 W, sigma_u = sigma_v =
    sigma_w / (.177 + .000823 h)^.4, W the wind speed 20 ft above the ground.
    """
    if not 0 < height <= CEILING:
        raise ValueError(
            f"Got height={height:g} m, but expected a number > 0 and at most {CEILING:g} m, where the low-altitude "
            "model ends."
        )
    if not 0 <= wind_at_6m < np.inf:
        raise ValueError(f"Got wind_at_6m={wind_at_6m!r}, but expected a number from 0 on [m/s].")
    shear = 0.177 + 0.000823 * height / FEET
    length = height * np.array([shear**-1.2, shear**-1.2, 1.0])
    return length, 0.1 * wind_at_6m * np.array([shear**-0.4, shear**-0.4, 1.0])


def dryden_system(airspeed: float, length: Array, intensity: Array, span: float) -> tuple[Array, ...]:
    r"""Return A (9, 9), B (9, 4), C (9, 9) of the gusts' linear system driven by unit white noise.

    x' = A x + B n, and C x = (u, v, w, u', v', w', p, q, r) of the air. With T = L / V (MIL-F-8785C, 3.7.2.2,
    Dryden form; b the span):

    .. math::
        H_u = \sigma_u \frac{\sqrt{2 T_u}}{1 + T_u s}, \quad
        H_{v,w} = \sigma \sqrt{T} \frac{1 + \sqrt3 T s}{(1 + T s)^2}, \quad
        H_p = \sigma_w \sqrt{\frac{0.8 \pi}{V L_w}} \left(\frac{\pi L_w}{4 b}\right)^{1/6}
              \frac{1}{1 + \frac{4 b}{\pi V} s}, \quad
        H_q = \frac{-s / V}{1 + \frac{4 b}{\pi V} s} H_w, \quad H_r = \frac{s / V}{1 + \frac{3 b}{\pi V} s} H_v.

    The lags of H_q and H_r are the wing's averaging over its span. Here they apply to u, v and w too, so that q and r
    are exactly -w'/V and v'/V of the gusts that the aircraft meets, and all slopes are finite.
    """
    (Tu, Tv, Tw), (su, sv, sw) = np.asarray(length) / airspeed, np.asarray(intensity)
    lag, lag_r = 4 * span / (np.pi * airspeed), 3 * span / (np.pi * airspeed)
    first = np.array([[-1 / Tu, 0.0], [su * np.sqrt(2 * Tu) / lag, -1 / lag]])
    A = block_diag(first, _second_order(Tv, sv, lag_r), _second_order(Tw, sw, lag), [[-1 / lag]])
    B = np.zeros((9, 4))
    B[0, 0], B[3, 1], B[6, 2] = 1 / Tu, 1 / Tv**2, 1 / Tw**2
    B[8, 3] = sw / lag * np.sqrt(0.8 * np.pi / (airspeed * length[2])) * (Tw / lag) ** (1 / 6)
    velocity = np.eye(9)[[1, 4, 7]]
    slope = velocity @ A
    rates = np.array([np.eye(9)[8], -slope[2] / airspeed, slope[1] / airspeed])
    return A, B, np.vstack([velocity, slope, rates])


def dryden_gusts(
    n_times: int,
    step: float,
    airspeed: ArrayLike,
    length: Any,
    intensity: Any,
    span: float,
    rng: np.random.Generator,
    *,
    n_draws: int = 1,
) -> Gusts:
    """Return stationary gusts every ``step`` seconds for several flights at once, each (n_times, n_flights, 3).

    Each flight is drawn ``n_draws`` times, (n_times, n_draws * n_flights, 3), all flights of the first draw first.

    ``length`` [m] and ``intensity`` [m/s] of u, v, w, (n_flights, 3), belong to a frozen field that is crossed at
    ``airspeed`` [m/s], a number or (n_flights,). The linear systems are discretised exactly (matrix exponentials), for
    any step.
    """
    speeds = np.broadcast_to(airspeed, len(length))
    systems = [dryden_system(V, L, s, span) for V, L, s in zip(speeds, length, intensity, strict=True)]
    A, B, C = (np.array(matrices) for matrices in zip(*systems, strict=True))
    covariance = np.array([solve_continuous_lyapunov(a, -b @ b.T) for a, b in zip(A, B, strict=True)])
    transition = expm(A * step)
    # In steady state P = F P F' + Q, so Q, the covariance of one step's noise, needs no integral.
    noise = covariance - transition @ covariance @ transition.swapaxes(-1, -2)
    A, C, transition, first, root = (
        np.tile(matrices, (n_draws, 1, 1))
        for matrices in (A, C, transition, covariance_root(covariance), covariance_root(noise))
    )
    x = np.einsum("fij,fj->fi", first, rng.standard_normal((len(A), 9)))
    states = np.einsum("fij,kfj->kfi", root, rng.standard_normal((n_times, len(A), 9)))
    for k, shock in enumerate(states):
        following = (transition @ x[..., None])[..., 0] + shock
        states[k], x = x, following  # in place: of a thousand paths they fill hundreds of megabytes
    return Gusts(*(np.einsum("fij,kfj->kfi", C[:, k : k + 3], states) for k in (0, 3, 6)))


def dryden_wind(
    duration: float,
    airspeed: float,
    height: float,
    *,
    wind_at_6m: float = 5.0,
    mean_wind: ArrayLike = (0.0, 0.0, 0.0),
    heading: float = 0.0,
    span: float = 2.0,
    dt: float = 0.02,
    random_state: Seed = None,
) -> pd.DataFrame:
    """Return a gusty wind, for ``simulate(air=...)``.

    Dryden turbulence of MIL-F-8785C below 1000 ft above a mean wind, crossed straight ahead at ``airspeed`` along
    ``heading``, without its rotation.

    Parameters
    ----------
    duration : float
        [s].
    airspeed, height : float
        At which the frozen field is crossed [m/s], and how high above the ground [m], at most 304.8.
    wind_at_6m : float, default=5.0
        [m/s]; 7.7 is light, 15 moderate, 23 severe turbulence.
    mean_wind : array-like (3,), default=(0, 0, 0)
        North, east, down [m/s].
    heading : float, default=0.0
        [rad].
    span : float, default=2.0
        Of the wing, which averages the gusts [m].
    dt : float, default=0.02
        Between the rows [s].
    random_state : int, RandomState or None
        Seed.

    Returns
    -------
    pandas.DataFrame
        ``time``, ``wind_north``, ``wind_east``, ``wind_down``.

    Examples
    --------
    >>> from skdgp.dynamics import dryden_wind
    >>> wind = dryden_wind(60.0, airspeed=25.0, height=100.0, mean_wind=[4.0, 0.0, 0.0], random_state=0)
    >>> list(wind), len(wind)
    (['time', 'wind_north', 'wind_east', 'wind_down'], 3001)
    """
    for name, value in (("duration", duration), ("airspeed", airspeed), ("height", height), ("span", span), ("dt", dt)):
        if not (np.isfinite(value) and value > 0):
            raise ValueError(f"Got {name}={value!r}, but expected a number > 0.")
    if np.shape(mean_wind) != (3,) or not np.isfinite(mean_wind).all():
        raise ValueError(f"Got mean_wind={mean_wind!r}, but expected three finite numbers, north, east, down [m/s].")
    n_times = int(np.floor(duration / dt + 1e-9)) + 1
    length, intensity = low_altitude_turbulence(height, wind_at_6m)
    rng = np.random.default_rng(check_random_state(random_state).randint(2**31 - 1))
    u, v, w = dryden_gusts(n_times, dt, airspeed, [length], [intensity], span, rng).velocity[:, 0].T
    ahead, aside = np.cos(heading), np.sin(heading)
    north, east, down = np.asarray(mean_wind, dtype=float)
    return pd.DataFrame({
        "time": dt * np.arange(n_times),
        "wind_north": north + ahead * u - aside * v,
        "wind_east": east + aside * u + ahead * v,
        "wind_down": down + w,
    })  # fmt: skip


def _second_order(T: float, sigma: float, lag: float) -> Array:
    """Return A of the states x, x' and gust: T^2 x'' + 2 T x' + x = n, gust sigma sqrt(T) (x + sqrt(3) T x')."""
    gain = sigma * np.sqrt(T) / lag
    return np.array([[0.0, 1.0, 0.0], [-1 / T**2, -2 / T, 0.0], [gain, gain * np.sqrt(3) * T, -1 / lag]])
