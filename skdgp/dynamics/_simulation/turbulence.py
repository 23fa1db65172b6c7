"""Turbulence of a flight: Dryden's spectra fitted to the wind that air data and velocity over the ground give."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import expm, solve_continuous_lyapunov
from scipy.optimize import minimize

from skdgp._compute.typing import Array
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER
from skdgp._flight.checks import check_columns, check_radians, check_table
from skdgp._flight.clock import flight_segments
from skdgp._flight.frames import air_velocity, body_to_ned, euler_to_quaternion, ned_to_body
from skdgp.dynamics._equations.aerodynamics import Drift
from skdgp.dynamics._simulation.gusts import dryden_system, low_altitude_turbulence

SHORTEST = 30.0
"""Flight [s] below which gusts cannot be told from the mean wind."""
SLOWEST = 0.03
"""Frequency [rad/s] below which the wind changes for other reasons than turbulence."""
LONGEST = 3000.0
"""Scale length [m] beyond which there is none."""
SAMPLES = 10
"""Sample intervals that the shortest scale length lasts: shorter gusts resemble the noise of the sensors."""
CALM = 1e-12
"""Power [m^2/s^2] of the wind below which it is round-off."""
HORIZON, POINTS = 1.0, 101
"""Time [s] over which the effects of rotation and drift are compared, and points of the integral."""


class Turbulence(NamedTuple):
    """Gusts by Dryden's spectra: standard deviations and scale lengths of the velocities u, v, w of the air.

    Examples
    --------
    >>> from skdgp.dynamics import Turbulence
    >>> light = Turbulence.low_altitude(height=100.0, wind_at_6m=7.7)
    >>> light.intensity.round(2), light.length.round(0)
    (array([1.06, 1.06, 0.77]), array([263., 263., 100.]))
    >>> light.scaled(0.5).intensity.round(2)
    array([0.53, 0.53, 0.38])
    """

    intensity: Array
    """(3,) [m/s]."""
    length: Array
    """(3,) [m]."""
    intensity_std: Array | None = None
    """Standard errors of the intensities, (3,); None where they are given."""
    length_std: Array | None = None
    airspeed: float | None = None
    """Mean of the flights [m/s]; None where it is given."""

    @classmethod
    def low_altitude(cls, height: float, wind_at_6m: float) -> Turbulence:
        """Return the turbulence of MIL-F-8785C below 1000 ft, by height [m] and wind speed 6 m above ground [m/s]."""
        length, intensity = low_altitude_turbulence(height, wind_at_6m)
        return cls(intensity, length)

    @classmethod
    def from_flight(cls, flight: pd.DataFrame, span: float) -> Turbulence:
        r"""Return the turbulence of one or more flights.

        The velocity over the ground less that through the air is the wind; less its mean, in body axes, it is the
        gusts u, v, w and the noise of the sensors. The spectra are Dryden's with the lag of a wing
        (:func:`skdgp.dynamics.simulate` draws such gusts) and white noise. Their parameters maximise Whittle's
        likelihood of the periodogram I at the frequencies \omega,

        .. math:: -\sum_\omega \log S(\omega) + I(\omega) / S(\omega),

        summed over flights. u and v share intensity and length (MIL-F-8785C, 3.7.2). Standard errors are those of its
        Fisher information. Six minutes give intensities to a tenth and lengths to a fifth.

        Parameters
        ----------
        flight : DataFrame (n, ...)
            With time, flight, airspeed, alpha, beta, phi, theta, psi, v_north, v_east, v_down.
        span : float
            Of the wing [m].

        Returns
        -------
        Turbulence

        Raises
        ------
        ValueError
            If columns are missing, angles are in degrees, the span is not > 0, or no flight lasts 30 s and is sampled
            every 300 m.
        """
        if not 0 < span < np.inf:
            raise ValueError(f"Got span={span!r}, but expected a number > 0 [m].")
        columns = ["time", *AIR_DATA, *EULER, *EARTH_VELOCITY]
        check_columns(check_table(flight, what="flight"), columns, what="flight")
        check_radians(flight, (*EULER, "alpha", "beta"))
        rows = flight_segments(flight["time"], flight.get("flight"))
        spectra = [found for part in rows if (found := _periodogram(flight.iloc[part][columns], span)) is not None]
        if not spectra:
            raise ValueError(
                f"Got no flight of {SHORTEST:g} s in the air, without gaps, sampled every {LONGEST / SAMPLES:g} m, "
                f"with values in {columns}, but gusts last for seconds: fly longer."
            )
        horizontal, vertical = (_fitted(spectra, axes) for axes in ((0, 1), (2,)))
        intensity, length, intensity_std, length_std = np.transpose([horizontal, horizontal, vertical])
        airspeed = np.average([p.airspeed for p in spectra], weights=[p.step * len(p.values) for p in spectra])
        return cls(intensity, length, intensity_std, length_std, float(airspeed))

    def scaled(self, factor: float) -> Turbulence:
        """Return turbulence of the same lengths with ``factor`` times the intensity."""
        std = None if self.intensity_std is None else factor * self.intensity_std
        return self._replace(intensity=factor * np.asarray(self.intensity), intensity_std=std)

    def without_rotation(self, drift: Drift, slopes: Array, airspeed: float, span: float) -> Drift:
        """Return the part of a drift that the rotation of these gusts does not explain.

        The residuals of a flight contain the effect of the rates p, q, r of the air, which no sensor shows. Of each
        coefficient, tau^2 is reduced by the share of the rates in the variance of its integral over 1 s.

        Parameters
        ----------
        drift : Drift
            Of a flight in this turbulence.
        slopes : ndarray (6, 3)
            Of the coefficients by p, q, r [s].
        airspeed, span : float
            Of that flight [m/s], [m].

        Returns
        -------
        Drift
        """
        A, B, C = dryden_system(airspeed, self.length, self.intensity, span)
        covariance, step = solve_continuous_lyapunov(A, -B @ B.T), expm(A * HORIZON / (POINTS - 1))
        lags = np.linspace(0.0, HORIZON, POINTS)
        autocovariance = np.empty((POINTS, 3))
        for k in range(POINTS):
            autocovariance[k] = np.einsum("ij,jk,ik->i", C[6:], covariance, C[6:])
            covariance = step @ covariance
        weight = 2 * np.gradient(lags) * (HORIZON - lags)
        weight[[0, -1]] *= 0.5
        rotation = slopes**2 @ (weight @ autocovariance)
        whole = weight @ (drift.variance * np.exp(-lags[:, None] / drift.memory))
        share = np.divide(rotation, whole, out=np.zeros(6), where=whole > 0)
        return drift._replace(variance=drift.variance * np.maximum(1 - share, 0.0))


class _Spectra(NamedTuple):
    """Periodograms of u, v, w of one flight, (n, 3), at frequencies (n,) [rad/s]."""

    frequency: Any
    values: Any
    step: float
    airspeed: float
    lag: Array


def _periodogram(rows: pd.DataFrame, span: float) -> _Spectra | None:
    """Return the periodogram of the wind of a flight, None if it is too short, on the ground, or sampled too rarely."""
    rows = rows.dropna()
    time = rows["time"].to_numpy(float)
    if len(time) < 2 or np.ptp(time) < SHORTEST:
        return None
    step, airspeed = float(np.median(np.diff(time))), float(rows["airspeed"].mean())
    if not 0 < SAMPLES * step * airspeed < LONGEST:
        return None
    attitude = euler_to_quaternion(*rows[[*EULER]].to_numpy(float).T)
    air = body_to_ned(attitude, air_velocity(*rows[[*AIR_DATA]].to_numpy(float).T))
    wind = rows[[*EARTH_VELOCITY]].to_numpy(float) - air
    gusts = ned_to_body(attitude, wind - wind.mean(axis=0))
    even = np.arange(time[0], time[-1], step)
    gusts = np.stack([np.interp(even, time, column) for column in gusts.T], axis=1)
    values = np.abs(np.fft.rfft(gusts - gusts.mean(axis=0), axis=0)) ** 2 * step / len(even)
    frequency = 2 * np.pi * np.fft.rfftfreq(len(even), step)
    used = (frequency > SLOWEST) & (frequency < 0.9 * np.pi / step)
    lag = np.array([4.0, 3.0, 4.0]) * span / (np.pi * airspeed)  # of u, v, w, as in dryden_system
    return _Spectra(frequency[used], values[used], step, airspeed, lag)


def _spectrum(frequency: Array, time: float, lag: float, axis: int) -> Array:
    """Return the spectrum of u, v, w (axis 0, 1, 2) of unit variance without the lag: `dryden_system`, T = ``time``."""
    x = (time * frequency) ** 2
    shape = 2 * time / (1 + x) if axis == 0 else time * (1 + 3 * x) / (1 + x) ** 2
    return shape / (1 + (lag * frequency) ** 2)


def _fitted(spectra: list[_Spectra], axes: tuple[int, ...]) -> tuple[float, float, float, float]:
    """Return intensity and length common to the axes, and their standard errors."""
    powers = [part.values[:, axes].sum(axis=0) / part.step / len(part.values) for part in spectra]
    power = max(float(np.mean(powers)), CALM)
    observed = np.concatenate([part.values[:, axis] for part in spectra for axis in axes])

    def logarithm(theta):
        variance, length, noise = np.exp(theta)
        parts = []
        for part in spectra:
            for axis in axes:
                unit = _spectrum(part.frequency, length / part.airspeed, part.lag[axis], axis)
                parts.append(np.log(variance * unit + noise * part.step))
        return np.concatenate(parts)

    def loss(theta):
        spectrum = logarithm(theta)
        return np.mean(spectrum + observed * np.exp(-spectrum))

    shortest = min(SAMPLES * part.step * part.airspeed for part in spectra)
    bounds = [*np.log([(1e-6 * power, 100 * power), (shortest, LONGEST), (1e-6 * power, 10 * power)])]
    starts = [np.log([0.5 * power, length, 0.5 * power]) for length in (2 * shortest, 10 * shortest)]
    best = min((minimize(loss, start, bounds=bounds) for start in starts), key=lambda found: found.fun).x
    step = 1e-4
    slopes = np.array([(logarithm(best + step * e) - logarithm(best - step * e)) / (2 * step) for e in np.eye(3)])
    error = np.sqrt(np.diag(np.linalg.pinv(slopes @ slopes.T)))  # of the logarithms
    intensity, length = np.exp(0.5 * best[0]), np.exp(best[1])
    return intensity, length, 0.5 * error[0] * intensity, error[1] * length
