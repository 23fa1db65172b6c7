"""The air as a user describes it, and as it moves at the aircraft; Dryden gusts (MIL-F-8785C), drawn and fitted."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from scipy.linalg import block_diag, expm, solve_continuous_lyapunov
from scipy.optimize import minimize
from scipy.stats import chi2
from sklearn.utils import check_random_state

from skdgp._compute.linalg import covariance_root
from skdgp._compute.typing import Array, Seed
from skdgp._flight.channels import AIR_DATA, EARTH_VELOCITY, EULER, WIND
from skdgp._flight.checks import (
    as_floats,
    check_choice,
    check_columns,
    check_number,
    check_radians,
    check_table,
)
from skdgp._flight.clock import flight_segments
from skdgp._flight.frames import (
    STANDARD_GRAVITY,
    air_velocity,
    body_to_ned,
    cross,
    euler_to_quaternion,
)
from skdgp.dynamics._rigid_body import ATTITUDE, RATES

FEET = 0.3048
CEILING = 1000 * FEET  # Height [m] at which the low-altitude model ends
SHORTEST = 30.0  # Flight [s] below which gusts cannot be told from the mean wind
SLOWEST = 0.03  # Frequency [rad/s] below which the wind changes for other reasons than turbulence
LONGEST = 3000.0  # Scale length [m] beyond which there is none
# Sample intervals that the shortest scale length lasts: shorter gusts resemble the noise of the
# sensors
SAMPLES = 10
# Frequency, over the frequency of a wing's lag, up to which spectra are fitted. Sensors measure the
# wind at a point, the wing meets its mean over the span. Below, both are the same to a factor of 2.
# With the lag in the spectra, gusts of JSBSim's aircraft had lengths of 8 to 90 m for 100 to 260 m,
# and their rates were 1.3 to 4 times too large.
BAND = 1.0
# Prior median [m] of a scale length and standard deviation of its logarithm: 95 % within 30 m (a
# flight at that height) and 533 m (1750 ft, higher than 1000 ft) of MIL-F-8785C, 3.7.2. Short winds
# do not show it.
LENGTH, LENGTH_STD = 126.0, 0.72
# Least values of the periodogram for an estimate of an intensity: its standard error is then 30 %
FEWEST = 3
LEVEL = 0.95  # Of the test that intensity and length of u and v differ: the usual one
CALM = 1e-12  # Power [m^2/s^2] of the wind below which it is round-off
# From a time or a stage, and states (..., 13), to the air there; None where it is at rest.
AirAt: TypeAlias = "Callable[[Any, Array], LocalAir | None]"


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
    speeds = np.broadcast_to(airspeed, len(length))
    systems = [
        dryden_system(V, L, s, span) for V, L, s in zip(speeds, length, intensity, strict=True)
    ]
    A, B, C = (np.array(matrices) for matrices in zip(*systems, strict=True))
    covariance = np.array(
        [solve_continuous_lyapunov(a, -b @ b.T) for a, b in zip(A, B, strict=True)]
    )
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
    intensity, length = Turbulence.low_altitude(height, wind_at_6m)[:2]
    rng = np.random.default_rng(check_random_state(random_state).randint(2**31 - 1))
    gusts = dryden_gusts(n_times, dt, airspeed, [length], [intensity], span, rng).velocity[:, 0]
    columns = dict(zip(WIND, gusts.T, strict=True))
    return pd.DataFrame({"time": dt * np.arange(n_times), **columns})


def _second_order(T: float, sigma: float, lag: float) -> Array:
    """Return A of the states x, x' and gust: T^2 x'' + 2 T x' + x = n, gust sigma sqrt(T) (x + sqrt(3) T x')."""
    gain = sigma * np.sqrt(T) / lag
    return np.array(
        [[0.0, 1.0, 0.0], [-1 / T**2, -2 / T, 0.0], [gain, gain * np.sqrt(3) * T, -1 / lag]]
    )


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
        check_columns(check_table(flight, what="flight"), columns, what="flight")
        check_radians(flight, (*EULER, "alpha", "beta"))
        rows = flight_segments(flight["time"], flight.get("flight"))
        winds = [_wind_of(flight.iloc[part][columns].dropna()) for part in rows]
        long = [wind for wind in winds if len(wind) > 1 and np.ptp(wind["time"]) >= SHORTEST]
        return cls.from_wind(long, [wind["airspeed"].mean() for wind in long], span)

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
        speeds = np.broadcast_to(np.asarray(airspeeds, dtype=float), (len(winds),))
        pairs = zip(winds, speeds.tolist(), strict=True)
        periodograms = [_periodogram(table, speed, span) for table, speed in pairs]
        spectra = [spectrum for spectrum in periodograms if spectrum is not None]
        if sum(len(spectrum.frequency) for spectrum in spectra) < FEWEST:
            raise TooShort(
                f"Got winds that are too short, or too rarely sampled, to show gusts, but expected "
                f"a flight of {SHORTEST:g} s in the air, without gaps or missing values, or some "
                f"seconds of a wind, with a row for each {LONGEST / SAMPLES:g} m: fly longer."
            )
        along, vertical = _fitted(spectra, (0, 1)), _fitted(spectra, (2,))
        across = along
        if spectra[0].is_along:
            apart = [_fitted(spectra, (axis,)) for axis in (0, 1)]
            if 2 * (along.loss - sum(fit.loss for fit in apart)) >= chi2.ppf(LEVEL, 2):
                along, across = apart
        fits = along, across, vertical
        intensity, length = (np.array(x) for x in zip(*(fit[:2] for fit in fits), strict=True))
        mean = np.average(
            [p.airspeed for p in spectra], weights=[p.step * len(p.values) for p in spectra]
        )
        return cls(intensity, length, float(mean))

    def scaled(self, factor: float) -> Turbulence:
        """Return turbulence of the same lengths with ``factor`` times the intensity."""
        return self._replace(intensity=factor * np.asarray(self.intensity))


class TooShort(ValueError):
    """Winds show no gusts."""


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
        axes = (0, 1) if axis < 2 and not self.is_along else (axis,)
        return np.mean(
            [_spectrum(self.frequency, length / self.airspeed, component) for component in axes],
            axis=0,
        )


class _Fit(NamedTuple):
    """Intensity and length of some axes."""

    intensity: float
    length: float
    loss: float  # The negative logarithm of likelihood and prior, but for a constant


def _wind_of(rows: pd.DataFrame) -> pd.DataFrame:
    """Return time, airspeed and wind of a flight, and the heading of its velocity through the air."""
    attitude = euler_to_quaternion(*rows[[*EULER]].to_numpy(float).T)
    air = body_to_ned(attitude, air_velocity(*rows[[*AIR_DATA]].to_numpy(float).T))
    wind = pd.DataFrame(rows[[*EARTH_VELOCITY]].to_numpy(float) - air, columns=[*WIND])
    wind["heading"] = np.unwrap(np.arctan2(air[:, 1], air[:, 0]))
    return wind.assign(time=rows["time"].to_numpy(float), airspeed=rows["airspeed"].to_numpy(float))


def _periodogram(wind: pd.DataFrame, airspeed: float, span: float) -> _Spectra | None:
    """Return the periodogram of a wind, None if it is too short, met at no airspeed, or sampled too rarely."""
    wind, is_along = wind.dropna(), "heading" in wind
    time = wind["time"].to_numpy(float)
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    if not 0 < SAMPLES * step * airspeed < LONGEST:
        return None
    even = np.arange(time[0], time[-1], step)
    gusts = np.stack([np.interp(even, time, wind[name].to_numpy(float)) for name in WIND], axis=1)
    gusts -= gusts.mean(axis=0)
    if is_along:
        heading = np.interp(even, time, wind["heading"].to_numpy(float))
        ahead, aside = np.cos(heading), np.sin(heading)
        north, east = gusts[:, 0].copy(), gusts[:, 1].copy()
        gusts[:, 0], gusts[:, 1] = ahead * north + aside * east, ahead * east - aside * north
    values = np.abs(np.fft.rfft(gusts, axis=0)) ** 2 * step / len(even)
    frequency = 2 * np.pi * np.fft.rfftfreq(len(even), step)
    highest = min(BAND * np.pi * airspeed / (4 * span), 0.9 * np.pi / step)
    used = (frequency > SLOWEST) & (frequency < highest)
    shortest = max(SAMPLES * step * airspeed, airspeed / highest)
    return _Spectra(frequency[used], values[used], step, airspeed, shortest, is_along)


def _spectrum(frequency: Array, time: float, axis: int) -> Array:
    """Return the spectrum of u, v, w (axis 0, 1, 2) of unit variance without lags: `dryden_system`, T = ``time``."""
    x = (time * frequency) ** 2
    return 2 * time / (1 + x) if axis == 0 else time * (1 + 3 * x) / (1 + x) ** 2


def _fitted(spectra: list[_Spectra], axes: tuple[int, ...]) -> _Fit:
    """Return intensity and length that the axes share; each has white noise of its own."""
    observed = np.concatenate([part.values[:, axis] for part in spectra for axis in axes])
    level = max(float(np.mean(observed)), CALM)
    power = level * max(part.frequency[-1] for part in spectra)
    density = level / min(part.step for part in spectra)

    def logarithm(theta):
        variance, length, *noise = np.exp(theta)
        return np.concatenate([
            np.log(variance * part.unit(length, axis) + noise[k] * part.step)
            for part in spectra for k, axis in enumerate(axes)
        ])  # fmt: skip

    def loss(theta):
        spectrum = logarithm(theta)
        return (
            np.sum(spectrum + observed * np.exp(-spectrum))
            + 0.5 * ((theta[1] - np.log(LENGTH)) / LENGTH_STD) ** 2
        )

    shortest = min(part.shortest for part in spectra)
    loudest = (10 if spectra[0].is_along else 2e-6) * density
    bounds = [
        *np.log(
            [
                (1e-6 * power, 100 * power),
                (shortest, LONGEST),
                *[(1e-6 * density, loudest)] * len(axes),
            ]
        )
    ]
    noise = [0.05 * loudest] * len(axes)
    starts = [np.log([0.5 * power, length, *noise]) for length in (2 * shortest, 10 * shortest)]
    best = min(
        (minimize(loss, start, bounds=bounds) for start in starts),
        key=lambda solution: solution.fun,
    )
    return _Fit(float(np.exp(0.5 * best.x[0])), float(np.exp(best.x[1])), best.fun)


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
        the wind. A table as wind contains the velocity of the gusts: then only rates are drawn.
        "auto": the turbulence of this table (`Turbulence.from_wind`), else of the training flights,
        if the model knows it. None: calm air.
    drift : bool, default=True
        Whether each path, and ``return_std``, also has a drift of its own flight: errors of the
        coefficients that change slowly, as the residuals of the training flights did; smaller in
        calmer air, if the model knows the turbulence of its flights. False: the uncertainty of the
        aircraft alone.
    density : float or callable, optional
        [kg/m^3], or a function of altitude [m]; by default the standard atmosphere.
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
    density: float | Callable | None = None
    gravity: float = STANDARD_GRAVITY

    def __post_init__(self) -> None:
        if isinstance(self.gusts, Turbulence):
            sizes = [as_floats(part) for part in self.gusts[:2]]
            is_valid = all(part.shape == (3,) and np.isfinite(part).all() for part in sizes)
            if not (is_valid and (sizes[0] >= 0).all() and (sizes[1] > 0).all()):
                raise ValueError(
                    f"Got {self.gusts}, but expected three intensities >= 0 [m/s] and lengths > 0 "
                    f"[m], of u, v, w."
                )
        elif not (self.gusts is None or (isinstance(self.gusts, str) and self.gusts == "auto")):
            raise ValueError(
                f"Got gusts={self.gusts!r}, but expected 'auto', a Turbulence, or None: calm air."
            )
        check_choice("drift", self.drift, (True, False))
        if not (self.density is None or callable(self.density)):
            check_number("density", self.density, is_open=False, unit="kg/m^3")
        check_number("gravity", self.gravity, -np.inf, unit="m/s^2")


def as_air(air: Any) -> Air:
    """Return an `Air` as it is, and the air of a wind."""
    if isinstance(air, str | Turbulence):
        raise ValueError(
            f"Got {air!r} as the air, but expected Air(gusts=...) of a Turbulence, or of None for calm air."
        )
    return air if isinstance(air, Air) else Air(wind=air)


class LocalAir(NamedTuple):
    """Motion of the air at the aircraft."""

    wind: Array  #: Velocity, north, east, down, (..., 3) [m/s]
    wind_rate: Array | None = None  #: Its rate of change along the flight, (..., 3) [m/s^2]
    #: Rates of the air, body axes, (..., 3) [rad/s]: p, q, r as regressors are relative to it
    rotation: Array | None = None


@dataclass(frozen=True)
class GustyAir:
    """Gusts around each aircraft, on top of a wind."""

    wind: AirAt
    gusts: Gusts  #: At each stage, (n_stages, ..., 3)

    def __call__(self, stage: Any, state: Array) -> LocalAir:
        """Return the air at a stage, or at several, and states (..., 13)."""
        velocity, acceleration, rotation = (part[stage] for part in self.gusts)
        steady, attitude = self.wind(stage, state), state[..., ATTITUDE]
        gust = body_to_ned(attitude, velocity)
        # a gust turns with the aircraft
        rate = body_to_ned(attitude, acceleration + cross(state[..., RATES], velocity))
        if steady is None:
            return LocalAir(gust, rate, rotation)
        if steady.wind_rate is not None:
            rate = steady.wind_rate + rate
        return LocalAir(steady.wind + gust, rate, rotation)
