"""Gusts by Dryden's spectra (MIL-F-8785C): a linear system driven by white noise, and its draws."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov

from skdgp._compute.linalg import covariance_root, matrix_vector
from skdgp._compute.typing import Array


class Gusts(NamedTuple):
    """Motion of the air around the aircraft, body axes, each (n_times, n_flights, 3)."""

    velocity: np.ndarray  # u, v, w of the air [m/s]
    acceleration: np.ndarray  # Rate of change of the velocity [m/s^2]
    rates: np.ndarray  # p, q, r of the air as if it turned like a rigid body [rad/s]


def dryden_system(
    airspeed: float, length: Array, intensity: Array, span: float
) -> tuple[Array, ...]:
    r"""Return A (9, 9), B (9, 4), C (9, 9) of the gusts' linear system driven by unit white noise.

    x' = A x + B n, and C x = (u, v, w, u', v', w', p, q, r) of the air. With T = L / V
    (MIL-F-8785C, 3.7.2.2, Dryden form; b the span):

    .. math::
        H_u = \sigma_u \frac{\sqrt{2 T_u}}{1 + T_u s}, \quad
        H_{v,w} = \sigma \sqrt{T} \frac{1 + \sqrt3 T s}{(1 + T s)^2}, \quad
        H_p = \sigma_w \sqrt{\frac{0.8 \pi}{V L_w}} \left(\frac{\pi L_w}{4 b}\right)^{1/6}
              \frac{1}{1 + \frac{4 b}{\pi V} s}, \quad
        H_q = \frac{-s / V}{1 + \frac{4 b}{\pi V} s} H_w, \quad H_r = \frac{s / V}{1 + \frac{3
        b}{\pi V} s} H_v.

    The lags of H_q and H_r are the wing's averaging over its span. Here they apply to u, v and w
    too, so that q and r are exactly -w'/V and v'/V of the gusts that the aircraft meets, and all
    slopes are finite.
    """
    Tu, Tv, Tw = np.asarray(length) / airspeed
    su, sv, sw = intensity
    lag, _, lag_r = gust_rate_lags(airspeed, span)
    first = np.array([[-1 / Tu, 0.0], [su * np.sqrt(2 * Tu) / lag, -1 / lag]])
    A = block_diag(first, _second_order(Tv, sv, lag_r), _second_order(Tw, sw, lag), [[-1 / lag]])
    B = np.zeros((9, 4))
    B[0, 0] = 1 / Tu
    B[3, 1] = 1 / Tv**2
    B[6, 2] = 1 / Tw**2
    B[8, 3] = sw / lag * np.sqrt(0.8 * np.pi / (airspeed * length[2])) * (Tw / lag) ** (1 / 6)
    velocity = np.eye(9)[[1, 4, 7]]
    _, v_dot, w_dot = velocity @ A
    rates = np.array([np.eye(9)[8], -w_dot / airspeed, v_dot / airspeed])
    return A, B, np.vstack([velocity, velocity @ A, rates])


def rolling_gust(airspeed: float, span: float, intensity: Any, length: Any) -> tuple[Array, float]:
    r"""Return the standard deviation [rad/s] and the correlation time [s] of the rate of roll p of the air.

    A first-order process, by H_p of `dryden_system`, of vertical gusts of an intensity [m/s] and a length [m],

    .. math::
        \sigma_p^2 = \frac{\pi^2 \sigma_w^2}{10\, b L_w} \left(\frac{\pi L_w}{4 b}\right)^{1/3}, \quad
        T_p = \frac{4 b}{\pi V}.
    """
    area = span * np.asarray(length)
    wide = (np.pi * np.asarray(length) / (4 * span)) ** (1 / 3)
    std = np.pi * np.asarray(intensity) * np.sqrt(wide / (10 * area))
    return std, gust_rate_lags(airspeed, span)[0]


def gust_rate_lags(airspeed: Any, span: float) -> Array:
    """Return the lags (3, ...) of the rates p, q, r of the air behind the slopes of its gusts [s].

    Those of H_p, H_q and H_r (MIL-F-8785C, 3.7.2.2), at the airspeed [m/s] with a span [m].

    Examples
    --------
    >>> from skdgp.dynamics import gust_rate_lags
    >>> gust_rate_lags(20.0, 2.8).round(3)
    array([0.178, 0.178, 0.134])
    """
    return np.multiply.outer([4.0, 4.0, 3.0], span / (np.pi * np.asarray(airspeed)))


def _second_order(T: float, sigma: float, lag: float) -> Array:
    """Return A of the states x, x' and gust: T^2 x'' + 2 T x' + x = n, gust sigma sqrt(T) (x + sqrt(3) T x')."""
    gain = sigma * np.sqrt(T) / lag
    return np.array(
        [[0.0, 1.0, 0.0], [-1 / T**2, -2 / T, 0.0], [gain, gain * np.sqrt(3) * T, -1 / lag]]
    )


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
    """Return stationary Dryden gusts of several flights at once.

    The linear systems are discretised exactly (matrix exponentials), for any step.

    Parameters
    ----------
    n_times : int
    step : float
        Time between two rows [s].
    airspeed : float or array (n_flights,)
        At which the frozen field is crossed [m/s].
    length, intensity : array (n_flights, 3)
        Of u, v, w [m], [m/s].
    span : float
        Of the wing [m].
    rng : Generator
    n_draws : int
        Draws of each flight.

    Returns
    -------
    Gusts
        Each (n_times, n_draws * n_flights, 3), all flights of the first draw first.
    """
    stream = gust_stream(step, airspeed, length, intensity, span, rng, n_draws=n_draws)
    return Gusts(*map(np.stack, zip(*islice(stream, n_times), strict=True)))


def gust_stream(
    step: float,
    airspeed: ArrayLike,
    length: Any,
    intensity: Any,
    span: float,
    rng: np.random.Generator,
    *,
    n_draws: int = 1,
) -> Iterator[Gusts]:
    """Yield the gusts of `dryden_gusts` without end, (n_draws * n_flights, 3) each, ``step`` [s] apart."""
    systems = []
    speeds = np.broadcast_to(airspeed, len(length))
    for speed, scales, sigmas in zip(speeds, length, intensity, strict=True):
        A, B, C = dryden_system(speed, scales, sigmas, span)
        systems.append((A, C, solve_continuous_lyapunov(A, -B @ B.T)))
    A, C, covariance = (
        np.tile(matrices, (n_draws, 1, 1)) for matrices in zip(*systems, strict=True)
    )
    transition, first, root = _discrete(A, covariance, step)
    x = matrix_vector(first, rng.standard_normal(first.shape[:-1]))
    while True:
        yield Gusts(*np.split(matrix_vector(C, x), 3, axis=-1))
        noise = matrix_vector(root, rng.standard_normal(root.shape[:-1]))
        x = matrix_vector(transition, x) + noise


def _discrete(A: Array, covariance: Any, step: float) -> tuple[Array, Array, Array]:
    """Return the transition over a step, and roots of the covariances of the state and of a step's noise."""
    transition = expm(A * step)
    # in steady state P = F P F' + Q, so Q, the covariance of one step's noise, needs no integral
    noise = covariance - transition @ covariance @ transition.swapaxes(-1, -2)
    return transition, covariance_root(covariance), covariance_root(noise)
