"""Turbulence: intensities and scale lengths of Dryden's spectra, given or estimated from flights and winds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.optimize import Bounds, minimize
from scipy.stats import chi2
from sklearn.utils import check_random_state

from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, WIND
from skdgp._flight.checks import check_columns, check_number, check_table
from skdgp._flight.frames import air_velocity, body_to_ned, euler_to_quaternion
from skdgp._flight.tables import FlightTable, interpolated, numeric
from skdgp._flight.units import check_radians
from skdgp.dynamics._dryden import dryden_gusts

FEET = 0.3048
CEILING = 1000 * FEET  # Height [m] at which the low-altitude model ends


@dataclass(frozen=True)
class SpectraSettings:
    """Settings of the estimate of turbulence from spectra of the wind."""

    # Shortest flight [s] that separates gusts from the mean wind
    duration: float = 30.0
    # Frequency [rad/s] below which the wind changes for other reasons than turbulence
    slowest: float = 0.03
    # Largest scale length [m]
    longest: float = 3000.0
    # Sample intervals that the shortest scale length lasts: shorter gusts resemble the noise of the
    # sensors
    samples: int = 10
    # Frequency, over the frequency of a wing's lag, up to which spectra are fitted. Sensors measure
    # the wind at a point, the wing meets its mean over the span. Below, both are the same to a
    # factor of 2. With the lag in the spectra, gusts of JSBSim's aircraft had lengths of 8 to 90 m
    # for 100 to 260 m, and their rates were 1.3 to 4 times too large.
    band: float = 1.0
    # Prior median [m] of a scale length and standard deviation of its logarithm: 95 % within 30 m
    # (a flight at that height) and 533 m (1750 ft, higher than 1000 ft) of MIL-F-8785C, 3.7.2.
    # Short winds do not show it.
    length: float = 126.0
    length_std: float = 0.72
    # Least values of the periodogram for an estimate: the standard error of an intensity is 30 %
    fewest: int = 3
    # Level of the test that intensity and length of u and v differ: the usual one
    level: float = 0.95
    # Power [m^2/s^2] of the wind below which it is round-off
    calm: float = 1e-12


SPECTRA = SpectraSettings()


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

    intensity: Array  #: (3,) [m/s]
    length: Array  #: (3,) [m]
    #: Mean of the flights [m/s]; None where intensity and length are given.
    airspeed: float | None = None

    @classmethod
    def low_altitude(cls, height: float, wind_at_6m: float) -> Turbulence:
        """Return the turbulence below 1000 ft, by height [m] and wind speed 6 m above ground [m/s].

        MIL-F-8785C, 3.7.3.4, with h in feet: L_w = h, L_u = L_v = h / (0.177 + 0.000823 h)^1.2,
        sigma_w = 0.1 W, sigma_u = sigma_v = sigma_w / (0.177 + 0.000823 h)^0.4, W the wind speed
        20 ft above the ground.
        """
        if not 0 < height <= CEILING:
            raise ValueError(
                f"Got height={height:g} m, but expected a number > 0 and at most {CEILING:g} m, "
                "where the low-altitude model ends."
            )
        check_number("wind_at_6m", wind_at_6m, is_open=False, unit="m/s")
        shear = 0.177 + 0.000823 * height / FEET
        length = height * np.array([shear**-1.2, shear**-1.2, 1.0])
        return cls(0.1 * wind_at_6m * np.array([shear**-0.4, shear**-0.4, 1.0]), length)

    @classmethod
    def from_flight(cls, flight: pd.DataFrame, span: float) -> Turbulence:
        """Return the turbulence of one or more flights.

        The velocity over the ground less that through the air is the wind, with the noise of the
        sensors. Its parts along the flight through the air, across and down are u, v and w:
        intensity and length are estimated as by `from_wind`, and white noise of each with them. u
        and v share intensity and length (MIL-F-8785C, 3.7.2) unless the test of the likelihood
        ratio (Wilks 1938) tells them apart at a level of 5 %. Six minutes give intensities to a
        tenth and lengths to a fifth. Raises ValueError if columns are missing, angles are in
        degrees, the span is not > 0, or no flight lasts 30 s and is sampled every 300 m.

        Parameters
        ----------
        flight : DataFrame (n, ...)
            With time, flight, airspeed, alpha, beta, phi, theta, psi, v_north, v_east, v_down.
        span : float
            Of the wing [m].

        Returns
        -------
        Turbulence
        """
        columns = ["time", *AIR_DATA, *EULER, *EARTH_VELOCITY]
        flights = FlightTable.of(flight, columns)
        check_radians(flight, (*EULER, "alpha", "beta"))
        winds = []
        airspeeds = []
        for segment in flights.segments:
            wind = _wind_of(flight.iloc[segment][columns].dropna())
            if len(wind) > 1 and np.ptp(wind["time"]) >= SPECTRA.duration:
                winds.append(wind)
                airspeeds.append(wind["airspeed"].mean())
        return cls.from_wind(winds, airspeeds, span)

    @classmethod
    def from_wind(
        cls, winds: pd.DataFrame | Sequence[pd.DataFrame], airspeeds: ArrayLike, span: float
    ) -> Turbulence:
        r"""Return the turbulence of winds that were met at some airspeeds.

        The spectra S are Dryden's. Their parameters maximise Whittle's likelihood of the
        periodogram I, with a prior on the length L,

        .. math:: -\sum_\omega \left(\log S(\omega) + \frac{I(\omega)}{S(\omega)}\right)
                  - \frac{\log^2(L / 126 \mathrm{m})}{2 \cdot 0.72^2},

        over the frequencies :math:`\omega \le \pi V / 4 b` at which a wing of the span b moves as
        one, all winds and axes. Where the direction of flight is not known, u and v share intensity
        and length (MIL-F-8785C, 3.7.2), and of north and east, S is the mean of their spectra.
        Raises ValueError if the span is not > 0, or the winds are too short or too rarely sampled.

        Parameters
        ----------
        winds : DataFrame or list of DataFrame
            Each with time, wind_north, wind_east, wind_down, and perhaps the heading of the flight
            through the air. Winds of a few seconds show the rates of the gusts, not their lengths.
        airspeeds : float or array-like (n_winds,)
            [m/s].
        span : float
            Of the wing [m].

        Returns
        -------
        Turbulence

        Examples
        --------
        >>> from skdgp.dynamics import Turbulence, dryden_wind
        >>> wind = dryden_wind(600.0, airspeed=25.0, height=100.0, wind_at_6m=7.7, random_state=0)
        >>> Turbulence.from_wind(wind, 25.0, span=2.0).intensity.round(1)
        array([1. , 1. , 0.8])
        """
        check_number("span", span, unit="m")
        winds = [winds] if isinstance(winds, pd.DataFrame) else list(winds)
        for table in winds:
            check_columns(check_table(table, what="wind"), ["time", *WIND], what="wind")
        if np.shape(airspeeds) not in ((), (len(winds),)):
            raise ValueError(
                f"Got {np.size(airspeeds)} airspeeds of {len(winds)} winds, but expected one, or one each."
            )
        speeds = np.broadcast_to(np.asarray(airspeeds, dtype=float), len(winds)).tolist()
        spectra = _spectra(winds, speeds, span, SPECTRA)
        fits = [*_along_and_across(spectra, SPECTRA), _fitted(spectra, (2,), SPECTRA)]
        durations = [spectrum.step * len(spectrum.values) for spectrum in spectra]
        airspeed = np.average([spectrum.airspeed for spectrum in spectra], weights=durations)
        return cls(
            intensity=np.array([fit.intensity for fit in fits]),
            length=np.array([fit.length for fit in fits]),
            airspeed=float(airspeed),
        )

    def scaled(self, factor: float) -> Turbulence:
        """Return turbulence of the same lengths with ``factor`` times the intensity."""
        return self._replace(intensity=factor * np.asarray(self.intensity))


class TooShort(ValueError):
    """Winds show no gusts."""


def dryden_wind(
    duration: float,
    airspeed: float,
    height: float,
    *,
    wind_at_6m: float = 5.0,
    span: float = 2.0,
    dt: float = 0.02,
    random_state: Seed = None,
) -> pd.DataFrame:
    """Return a gusty wind with mean zero, for ``simulate(air=...)``.

    Dryden turbulence of MIL-F-8785C below 1000 ft, crossed straight north at ``airspeed``, without
    its rotation.

    Parameters
    ----------
    duration : float
        [s].
    airspeed, height : float
        At which the frozen field is crossed [m/s], and how high above the ground [m], at most
        304.8.
    wind_at_6m : float, default=5.0
        [m/s]; 7.7 is light, 15 moderate, 23 severe turbulence.
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
    >>> wind = dryden_wind(60.0, airspeed=25.0, height=100.0, random_state=0)
    >>> list(wind), len(wind)
    (['time', 'wind_north', 'wind_east', 'wind_down'], 3001)
    """
    sizes = {"duration": duration, "airspeed": airspeed, "height": height, "span": span, "dt": dt}
    for name, value in sizes.items():
        check_number(name, value)
    n_times = int(np.floor(duration / dt + 1e-9)) + 1
    intensity, length, _ = Turbulence.low_altitude(height, wind_at_6m)
    rng = np.random.default_rng(check_random_state(random_state).randint(2**31 - 1))
    gusts = dryden_gusts(n_times, dt, airspeed, [length], [intensity], span, rng)
    wind = pd.DataFrame(gusts.velocity[:, 0], columns=list(WIND))
    wind.insert(0, "time", dt * np.arange(n_times))
    return wind


class _Spectra(NamedTuple):
    """Periodograms of the wind (n, 3), at frequencies (n,) [rad/s]."""

    frequency: np.ndarray
    values: Array
    step: float
    airspeed: float
    shortest: float  # Scale length [m] that they can show
    # Whether the axes are along the flight, across, down, with noise of sensors; else north, east,
    # down
    is_along: bool

    def unit(self, length: float, axis: int) -> Array:
        """Return Dryden's spectrum of an axis for unit variance: of north and east the mean spectrum of u and v."""
        time = length / self.airspeed
        if axis < 2 and not self.is_along:
            u = _spectrum(self.frequency, time, 0)
            v = _spectrum(self.frequency, time, 1)
            return (u + v) / 2
        return _spectrum(self.frequency, time, axis)


class _Fit(NamedTuple):
    """Intensity and length of some axes."""

    intensity: float
    length: float
    loss: float  # The negative logarithm of likelihood and prior, but for a constant


def _spectra(
    winds: list[pd.DataFrame], airspeeds: list[float], span: float, settings: SpectraSettings
) -> list[_Spectra]:
    """Return the periodograms of the winds that are long enough; raise `TooShort` without enough values."""
    spectra = []
    for wind, airspeed in zip(winds, airspeeds, strict=True):
        spectrum = _periodogram(wind, airspeed, span, settings)
        if spectrum is not None:
            spectra.append(spectrum)
    if sum(len(spectrum.frequency) for spectrum in spectra) < settings.fewest:
        raise TooShort(
            "Got winds that are too short, or too rarely sampled, to show gusts, but expected a flight of "
            f"{settings.duration:g} s in the air, without gaps or missing values, or some seconds of a "
            f"wind, with a row for each {settings.longest / settings.samples:g} m: fly longer."
        )
    return spectra


def _wind_of(rows: pd.DataFrame) -> pd.DataFrame:
    """Return time, airspeed and wind of a flight, and the heading of its velocity through the air."""
    attitude = euler_to_quaternion(*numeric(rows, EULER).T)
    air = body_to_ned(attitude, air_velocity(*numeric(rows, AIR_DATA).T))
    wind = pd.DataFrame(numeric(rows, EARTH_VELOCITY) - air, columns=[*WIND])
    wind["heading"] = np.unwrap(np.arctan2(air[:, 1], air[:, 0]))
    wind["time"] = rows["time"].to_numpy(float)
    wind["airspeed"] = rows["airspeed"].to_numpy(float)
    return wind


def _periodogram(
    wind: pd.DataFrame, airspeed: float, span: float, settings: SpectraSettings
) -> _Spectra | None:
    """Return the periodogram of a wind, None if it is too short, met at no airspeed, or sampled too rarely."""
    wind = wind.dropna()
    steps = np.diff(wind["time"].to_numpy(float))
    step = float(np.median(steps)) if len(steps) else 0.0
    sampled = settings.samples * step * airspeed
    if not 0 < sampled < settings.longest:
        return None
    gusts = _even_gusts(wind, step)
    n_times = len(gusts)
    values = np.abs(np.fft.rfft(gusts, axis=0)) ** 2 * step / n_times
    frequency = 2 * np.pi * np.fft.rfftfreq(n_times, step)
    highest = min(settings.band * np.pi * airspeed / (4 * span), 0.9 * np.pi / step)
    used = (frequency > settings.slowest) & (frequency < highest)
    shortest = max(sampled, airspeed / highest)
    return _Spectra(frequency[used], values[used], step, airspeed, shortest, "heading" in wind)


def _even_gusts(wind: pd.DataFrame, step: float) -> Array:
    """Return a wind less its mean (n, 3) at even times: along a heading, across, down; or north, east, down."""
    time = wind["time"].to_numpy(float)
    even = np.arange(time[0], time[-1], step)
    gusts = interpolated(even, time, numeric(wind, WIND))
    gusts -= gusts.mean(axis=0)
    if "heading" not in wind:
        return gusts
    return _turned(gusts, np.interp(even, time, wind["heading"].to_numpy(float)))


def _turned(gusts: Array, heading: Array) -> Array:
    """Return gusts (n, 3), north, east, down, along the heading, across and down."""
    north, east, down = gusts.T
    along = np.cos(heading) * north + np.sin(heading) * east
    across = np.cos(heading) * east - np.sin(heading) * north
    return np.stack([along, across, down], axis=1)


def _spectrum(frequency: Array, time: float, axis: int) -> Array:
    """Return the spectrum of u, v, w (axis 0, 1, 2) of unit variance without lags: `dryden_system`, T = ``time``."""
    x = (time * frequency) ** 2
    return 2 * time / (1 + x) if axis == 0 else time * (1 + 3 * x) / (1 + x) ** 2


def _along_and_across(spectra: list[_Spectra], settings: SpectraSettings) -> tuple[_Fit, _Fit]:
    """Return intensity and length of u and v: shared, unless they differ significantly (Wilks 1938)."""
    both = _fitted(spectra, (0, 1), settings)
    if not spectra[0].is_along:
        return both, both
    u = _fitted(spectra, (0,), settings)
    v = _fitted(spectra, (1,), settings)
    if 2 * (both.loss - u.loss - v.loss) >= chi2.ppf(settings.level, 2):
        return u, v
    return both, both


def _fitted(spectra: list[_Spectra], axes: tuple[int, ...], settings: SpectraSettings) -> _Fit:
    """Return intensity and length that the axes share; each has white noise of its own."""
    columns = list(axes)
    observed = np.concatenate([part.values[:, columns].T.ravel() for part in spectra])

    def loss(theta: Array) -> float:
        """Return the negative logarithm of Whittle's likelihood and of the prior of the length."""
        logarithm = _log_spectrum(theta, spectra, axes)
        whittle = np.sum(logarithm + observed * np.exp(-logarithm))
        off = (theta[1] - np.log(settings.length)) / settings.length_std
        return whittle + 0.5 * off**2

    level = max(float(np.mean(observed)), settings.calm)
    power = level * max(part.frequency[-1] for part in spectra)
    density = level / min(part.step for part in spectra)
    loudest = (10 if spectra[0].is_along else 2e-6) * density
    shortest = min(part.shortest for part in spectra)

    def logarithms(variance: float, length: float, noise: float) -> Array:
        return np.log([variance, length, *[noise] * len(axes)])

    least = logarithms(1e-6 * power, shortest, 1e-6 * density)
    most = logarithms(100 * power, settings.longest, loudest)
    solutions = []
    for length in (2 * shortest, 10 * shortest):
        start = logarithms(0.5 * power, length, 0.05 * loudest)
        solutions.append(minimize(loss, start, bounds=Bounds(least, most)))
    best = min(solutions, key=attrgetter("fun"))
    variance, length, *_ = np.exp(best.x)
    return _Fit(float(np.sqrt(variance)), float(length), best.fun)


def _log_spectrum(theta: Array, spectra: list[_Spectra], axes: tuple[int, ...]) -> Array:
    """Return the logarithm of the spectra of all axes, by the logarithms of variance, length and white noises."""
    variance, length, *noise = np.exp(theta)
    parts = []
    for part in spectra:
        for axis, white in zip(axes, noise, strict=True):
            parts.append(variance * part.unit(length, axis) + white * part.step)
    return np.log(np.concatenate(parts))
