"""The air: wind, gusts, density, gravity; turbulence by Dryden's spectra, given or estimated from flights and winds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy.signal import periodogram

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, WIND
from skdgp._flight.frames import (
    STANDARD_GRAVITY,
    air_velocity,
    body_to_ned,
    euler_to_quaternion,
)
from skdgp._flight.tables import (
    FlightTable,
    as_floats,
    by_name,
    check_choice,
    check_number,
    interpolated,
    numeric,
)
from skdgp._flight.units import check_radians
from skdgp.dynamics._dryden import Gusts

# From a time or a stage, and states (..., 13), to the air there.
AirAt: TypeAlias = "Callable[[Any, Array], LocalAir]"
FEET = 0.3048
CEILING = 1000 * FEET  # Height [m] at which the low-altitude model ends


# Shortest flight [s] that separates gusts from the mean wind
DURATION = 30.0
# Frequency [rad/s] below which the wind changes for other reasons than turbulence
SLOWEST = 0.03
# Largest scale length [m]
LONGEST = 3000.0
# Sample intervals that the shortest scale length lasts: shorter gusts resemble the noise of sensors
SAMPLES = 10
# Prior median [m] of a scale length and standard deviation of its logarithm: 95 % within 30 m (a
# flight at that height) and 533 m (1750 ft, higher than 1000 ft) of MIL-F-8785C, 3.7.2. Short winds
# do not show it.
LENGTH = 126.0
LENGTH_STD = 0.72
# Least values of the periodogram for an estimate: the standard error of an intensity is 30 %
FEWEST = 3
# Variance [m^2/s^2] of a wind below which it is round-off
CALM = 1e-16
# Lengths that are tried, 2 to 4 % apart, and variances of the noise of a sample over that of the gusts; the likelihood
# of weak gusts has several maxima
N_LENGTHS = 200
NOISES = np.geomspace(1e-4, 1e4, 41)
NO_NOISE = np.zeros(1)


class Turbulence(NamedTuple):
    r"""Gusts by Dryden's spectra: standard deviations and scale lengths of the velocities u, v, w of the air.

    An aircraft of span b meets their mean over the span: u and w pass a lag of :math:`4 b / (\pi V)`, v one of
    :math:`3 b / (\pi V)`. MIL-F-8785C has these lags in the rates alone. The standard deviation of w is 0.95 of its
    intensity for a span of 1.6 m at a height of 30 m, and 0.67 for 60 m at 100 m.

    Examples
    --------
    >>> from skdgp.dynamics import Turbulence
    >>> light = Turbulence.low_altitude(height=100.0, wind_at_6m=7.7)
    >>> light.intensity.round(2), light.length.round(0)
    (array([1.06, 1.06, 0.77]), array([263., 263., 100.]))
    """

    intensity: Array  #: (3,) [m/s]
    length: Array  #: (3,) [m]

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
        r"""Return the turbulence of one or more flights.

        The wind is the ground velocity minus the velocity through the air, with white noise of the sensors.
        The spectra S are Dryden's; north and east have the mean of the spectra of u and v, which have one
        intensity and length, as in MIL-F-8785C. Lengths L and noises maximise the likelihood of the
        periodograms I, with a prior on the length,

        .. math:: -\sum \left(\log S + \frac{I}{S}\right)
                  - \frac{\log^2(L / 126 \mathrm{m})}{2 \cdot 0.72^2},

        over the frequencies :math:`\omega \le \pi V / 4 b` at which a wing of the span b moves as
        one; the variance is the mean of I over S of unit variance. Six minutes give intensities to a
        tenth and horizontal lengths to a fifth; vertical ones are up to 25 % too long where sensors
        have little noise. Raises ValueError if columns are missing, angles are in degrees, the span
        is not > 0, or no flight lasts 30 s and is sampled every 300 m.

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
        check_number("span", span, unit="m")
        columns = ["time", *AIR_DATA, *EULER, *EARTH_VELOCITY]
        flights = FlightTable.of(flight, columns)
        check_radians(flight, (*EULER, "alpha", "beta"))
        winds = [_wind_of(flight.iloc[segment][columns].dropna()) for segment in flights.segments]
        long = [wind for wind in winds if len(wind) and np.ptp(wind["time"]) >= DURATION]
        found = turbulence_of_winds(long, span, NOISES)
        if found is None:
            raise ValueError(
                "Got flights that are too short, or too rarely sampled, to show gusts, but expected a flight of "
                f"{DURATION:g} s in the air, without gaps or missing values, with a row for each "
                f"{LONGEST / SAMPLES:g} m: fly longer."
            )
        return found


def turbulence_of_flights(flights: pd.DataFrame, aircraft: Any) -> Turbulence | None:
    """Return the turbulence of flights of a known aircraft, None where they do not show it."""
    if aircraft is not None:
        with suppress(TypeError, ValueError):  # short flights, or columns that are missing
            return Turbulence.from_flight(flights, aircraft.span)
    return None


def turbulence_of_winds(
    winds: Sequence[pd.DataFrame], span: float, noises: Vector = NO_NOISE
) -> Turbulence | None:
    """Return the turbulence of winds, by `Turbulence.from_flight`; None where they are too short to show gusts.

    Each has time, airspeed at which it was met, wind_north, wind_east, wind_down. Winds of a few seconds show
    the rates of the gusts, not their lengths. ``noises`` are possible variances of a sample's noise over that of
    the gusts.
    """
    parts = [_periodogram(wind, span) for wind in winds]
    if sum(map(len, parts)) < FEWEST:
        return None
    wave_number, interval, north, east, down = np.concatenate(parts).T
    shortest = max(SAMPLES * interval.min(), 4.0 * span / np.pi)
    lengths = np.geomspace(shortest, LONGEST, N_LENGTHS)
    # of unit variance, (n_lengths, n)
    x = np.square(np.multiply.outer(lengths, wave_number))
    scale = lengths[:, None]
    across = scale * (1 + 3 * x) / (1 + x) ** 2
    # north and east have the mean of the spectra of u and v, whatever the direction of the flight
    along = scale / (1 + x) + across / 2
    horizontal = _likeliest(along, 0.5 * (north + east), interval, lengths, noises)
    vertical = _likeliest(across, down, interval, lengths, noises)
    intensity, length = np.transpose([horizontal, horizontal, vertical])
    return Turbulence(intensity, length)


def _periodogram(wind: pd.DataFrame, span: float) -> Array:
    """Return wave number [rad/m], interval of the samples [m], and the periodogram of each axis, (n, 5)."""
    wind = wind.dropna()
    airspeed = wind["airspeed"].mean()
    time = wind["time"].to_numpy(float)
    interval = airspeed * float(np.median(np.diff(time)))
    if not 0 < SAMPLES * interval < LONGEST:
        return np.empty((0, 5))
    even = np.arange(time[0], time[-1], interval / airspeed)
    gusts = interpolated(even, time, numeric(wind, WIND))
    frequency, power = periodogram(gusts, 1 / interval, return_onesided=False, axis=0)
    wave_number = 2 * np.pi * frequency
    # above, a wing meets the mean over its span, while sensors measure the wind at a point
    highest = min(np.pi / (4 * span), 0.9 * np.pi / interval)
    is_used = (wave_number > SLOWEST / airspeed) & (wave_number < highest)
    intervals = np.full(len(wave_number), interval)
    return np.column_stack([wave_number, intervals, power])[is_used]


def _wind_of(rows: pd.DataFrame) -> pd.DataFrame:
    """Return time, airspeed and wind of a flight."""
    attitude = euler_to_quaternion(*numeric(rows, EULER).T)
    air = body_to_ned(attitude, air_velocity(*numeric(rows, AIR_DATA).T))
    wind = by_name(WIND, numeric(rows, EARTH_VELOCITY) - air)
    return rows[["time", "airspeed"]].astype(float).assign(**wind)


def _likeliest(
    spectra: Matrix, power: Vector, interval: Vector, lengths: Vector, noises: Vector
) -> tuple[float, float]:
    """Return intensity [m/s] and length [m] of an axis with a periodogram (n,).

    ``spectra`` (n_lengths, n) are of gusts of unit variance; the spectrum of unit noise is the interval.
    """
    variance, loss = np.empty((2, len(lengths), len(noises)))
    for k, of_gusts in enumerate(spectra):
        S = of_gusts + noises[:, None] * interval
        variance[k] = np.maximum((power / S).mean(axis=1), CALM)
        loss[k] = len(power) * np.log(variance[k]) + np.log(S).sum(axis=1)
    prior = 0.5 * (np.log(lengths / LENGTH) / LENGTH_STD) ** 2
    best = np.unravel_index((loss + prior[:, None]).argmin(), loss.shape)
    return float(np.sqrt(variance[best])), float(lengths[best[0]])


@dataclass(frozen=True, eq=False)
class Air:
    """The air that an aircraft flies in, and gravity: ``air`` of `simulate`, `trim` and others.

    A wind stands for ``Air(wind=wind)``. Raises ValueError if a value is invalid.

    Parameters
    ----------
    wind : array-like (3,), DataFrame or list of DataFrame, optional
        Velocity of the air, north, east, down [m/s]: constant; or a table with ``time``,
        ``wind_north``, ``wind_east``, ``wind_down`` (a list: one for each start). By default at
        rest.
    gusts : "auto", Turbulence or None, default="auto"
        Turbulence: each path of a simulation meets its own gusts, with their rates p, q, r, besides
        the wind, and so does a simulation of the mean. A table as wind contains the velocity of the
        gusts: then only rates are drawn. "auto", of paths alone: the turbulence of this table, else of
        the training flights, if the model knows it. None: calm air.
    drift : bool, default=True
        Whether each path also has a drift of its own flight: errors of the
        coefficients that change slowly, as the residuals of the training flights did beyond what
        their turbulence explains, if the model knows it. False: the uncertainty of the
        aircraft alone.
    density : float, optional
        [kg/m^3]; by default of the standard atmosphere.
    gravity : float, default=9.80665
        [m/s^2].

    Examples
    --------
    >>> from skdgp.dynamics import Air, Turbulence
    >>> Air(wind=[5.0, 0.0, 0.0], gusts=None)
    Air(wind=[5.0, 0.0, 0.0], gusts=None, drift=True, density=None, gravity=9.80665)
    """

    wind: Any = None
    gusts: Turbulence | Literal["auto"] | None = "auto"
    drift: bool = True
    density: float | None = None
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        _check_gusts(self.gusts)
        check_choice("drift", self.drift, (True, False))
        if self.density is not None:
            check_number("density", self.density, is_open=False, unit="kg/m^3")
        check_number("gravity", self.gravity, -np.inf, unit="m/s^2")


def _check_gusts(gusts: Any) -> None:
    """Raise ValueError if gusts are neither "auto" nor None nor a valid Turbulence."""
    if gusts is None or (isinstance(gusts, str) and gusts == "auto"):
        return
    if not isinstance(gusts, Turbulence):
        raise ValueError(
            f"Got gusts={gusts!r}, but expected 'auto', a Turbulence, or None: calm air."
        )
    sizes = as_floats([gusts.intensity, gusts.length])
    is_valid = sizes.shape == (2, 3) and np.isfinite(sizes).all() and (sizes >= 0).all()
    if not is_valid or not sizes[1].all():
        raise ValueError(
            f"Got {gusts}, but expected three intensities >= 0 [m/s] and lengths > 0 [m], of u, v, w."
        )


def as_air(air: Any) -> Air:
    """Return an `Air` as it is, and the air of a wind."""
    if isinstance(air, str | Turbulence):
        raise ValueError(
            f"Got {air!r} as the air, but expected Air(gusts=...) of a Turbulence, or of None for calm air."
        )
    return air if isinstance(air, Air) else Air(wind=air)


class LocalAir(NamedTuple):
    """Motion of the air at the aircraft: a wind, and gusts that turn with the aircraft; without both it is at rest."""

    wind: Array | None = None  #: Velocity, north, east, down, (..., 3) [m/s]
    wind_rate: Array | None = None  #: Its rate of change along the flight, (..., 3) [m/s^2]
    #: Gusts besides the wind, (..., 3) each; p, q, r as regressors are relative to their rates
    gusts: Gusts | None = None

    def velocity(self, attitude: Array) -> Array | None:
        """Return the velocity of wind and gust, north, east, down, (..., 3), at quaternions; None at rest."""
        if self.gusts is None:
            return self.wind
        gust = body_to_ned(attitude, self.gusts.velocity)
        return gust if self.wind is None else self.wind + gust


def gusty_air(wind: AirAt, gusts: Gusts) -> AirAt:
    """Return a function of a stage, or of several, to the air with gusts (n_stages, ..., 3) around each aircraft."""

    def air(stage: Any, state: Array) -> LocalAir:
        met = Gusts(*(part[stage] for part in gusts))
        return wind(stage, state)._replace(gusts=met)

    return air
