"""Limits of a planned flight, and manoeuvres within them: a library by the modes of the aircraft, and rehearsal.

Manoeuvres are flown in simulation by the mean of a model, and by aircraft that are drawn from it in gusts.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
import pandas as pd
from sklearn.base import BaseEstimator

from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._excitation import (
    ROUNDING,
    SAMPLES_PER_PERIOD,
    Signal,
    Steps,
    Wavetrain,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
)
from skdgp._flight.channels import HAT, LENGTHS, rate_factor
from skdgp._flight.checks import as_floats, check_columns
from skdgp._flight.frames import STANDARD_GRAVITY
from skdgp.dynamics import (
    Aerodynamics,
    Air,
    Aircraft,
    Trim,
    Turbulence,
    UncertainStart,
    as_aerodynamics,
    simulate,
    trajectory_bands,
)

# What an envelope limits, and the options of the command line
OPTIONS = {
    "alpha": "--alpha", "beta": "--beta", "load_factor": "--load-factor", "bank": "--max-bank", "airspeed": "--speeds",
    "altitude": "--floor",
}  # fmt: skip
QUANTITIES = tuple(OPTIONS)
GROWTH = "growth of "  # before the name of a limit from the training range
ENDS = (lambda x: x.shape == (2,) and x[0] < x[1], "the lowest and the highest value")
NOT_NEGATIVE = (lambda x: x.shape == () and x >= 0, "a number >= 0")
# What each value of an envelope must be
RULES: dict[str, tuple[Callable[[Any], Any], str]] = {
    **dict.fromkeys(("alpha", "beta", "load_factor", "airspeed"), ENDS),
    "bank": (lambda x: x.shape == () and x > 0, "a number > 0"),
    "altitude": (lambda x: x.shape == () and not np.isnan(x), "a number"),
    **dict.fromkeys(("growth", "margin"), NOT_NEGATIVE),
    "risk": (lambda x: x.shape == () and 0 < x < 1, "a number between 0 and 1"),
}
WHOLE_RANGE = {
    "throttle": (0.0, 1.0)
}  # lowest and highest value that a control can have, beyond which no limit grows


@dataclass(frozen=True)
class Envelope:
    """Limits of a flight, and the accepted risk.

    Other limits are the training range, and a fraction ``growth`` more. A model of
    :class:`skdgp.preprocessing.RegressorSelector` knows this range where its flights have the
    channels airspeed, phi, az, altitude.

    Parameters
    ----------
    alpha, beta, load_factor : tuple of float, optional
        Lowest and highest [rad], and of -az / g.
    bank : float, optional
        Largest, to either side [rad].
    airspeed : tuple of float, optional
        Lowest and highest [m/s].
    altitude : float, optional
        Lowest [m]; by default the lowest that was flown, without growth.
    growth : float, default=0.2
        Fraction of its training range by which a regressor, or a quantity above without a value,
        may exceed it: half at either end. inf: no limit.
    risk : float, default=0.05
        Largest probability that a manoeuvre leaves any of these.
    margin : float, default=0.15
        Relative excess of the response to a manoeuvre over the model's: slopes learned in
        gusts err by more than the posterior says.
    gusts : Turbulence, "auto" or None, default="auto"
        Gusts of the predicted risk. "auto": as in the training flights, with a warning if the
        model does not know it. None: calm air.
    n_paths : int, default=200
        Aircraft drawn for each prediction. A risk of 5 % is then known to 1.5 %.

    Examples
    --------
    >>> from skdgp.design import Envelope
    >>> from skdgp.dynamics import Aerodynamics
    >>> flown = Aerodynamics(lambda X: 0 * X, ["alpha"], flown={"airspeed": (20.0, 30.0)})
    >>> bounds = Envelope(bank=0.8, growth=0.2).bounds(flown)
    >>> bounds["bank"], bounds["growth of airspeed"]
    ((-0.8, 0.8), (19.0, 31.0))
    """

    alpha: tuple[float, float] | None = None
    beta: tuple[float, float] | None = None
    load_factor: tuple[float, float] | None = None
    bank: float | None = None
    airspeed: tuple[float, float] | None = None
    altitude: float | None = None
    growth: float = 0.2
    risk: float = 0.05
    margin: float = 0.15
    gusts: Turbulence | Literal["auto"] | None = "auto"
    n_paths: int = 200
    #: Limited quantities, and their options of the command line
    command_options: ClassVar[Mapping[str, str]] = OPTIONS

    def __post_init__(self) -> None:
        for name, (is_valid, expected) in RULES.items():
            value = getattr(self, name)
            is_absent = value is None and name in QUANTITIES
            if not (is_absent or is_valid(as_floats(value))):
                raise ValueError(f"Got {name}={value!r}, but expected {expected}.")

    def bounds(self, model: Aerodynamics) -> dict[str, tuple[float, float]]:
        """Return the lowest and the highest value of each channel: "bank" asked, "growth of bank" flown."""
        limits: dict[str, Any] = {
            name: value for name in QUANTITIES if (value := getattr(self, name)) is not None
        }
        if "bank" in limits:
            limits["bank"] = (-limits["bank"], limits["bank"])
        if "altitude" in limits:
            limits["altitude"] = (limits["altitude"], np.inf)
        bounds = dict.fromkeys(QUANTITIES, (-np.inf, np.inf)) | limits
        if np.isfinite(self.growth):
            ranges = {
                name: pair for name, pair in flown_quantities(model).items() if name not in limits
            }
            if model.limits is not None:
                ranges |= dict(zip(model.regressors, model.limits.T, strict=True))
            for name, (low, high) in ranges.items():
                growth = 0.5 * self.growth * (high - low)
                least, most = WHOLE_RANGE.get(name, (-np.inf, np.inf))
                grown = (low, np.inf) if name == "altitude" else (low - growth, high + growth)
                bounds[GROWTH + name] = max(least, grown[0]), min(most, grown[1])
        return bounds

    def altitudes(self, model: Aerodynamics | BaseEstimator) -> tuple[float, float]:
        """Return the lowest and the highest altitude that a model was learned from [m], 0 and 100 if unknown."""
        return flown_quantities(as_aerodynamics(model)).get("altitude", (0.0, 100.0))

    def unlimited(self, model: Aerodynamics) -> list[str]:
        """Return the quantities with neither a limit nor a training range."""
        bounds = self.bounds(model)
        free = [
            name
            for name in QUANTITIES
            if getattr(self, name) is None and GROWTH + name not in bounds
        ]
        return free if np.isfinite(self.growth) else []

    def channels(
        self, flight: pd.DataFrame, aircraft: Aircraft, model: Aerodynamics
    ) -> pd.DataFrame:
        """Return the limited quantities along one simulated flight."""
        limited = quantities(flight)
        X = regressors_of(flight, aircraft, model.regressors)
        growth = limited.assign(**dict(zip(model.regressors, X.T, strict=True))).add_prefix(GROWTH)
        return pd.concat([limited, growth], axis=1)[[*self.bounds(model)]]

    def left(
        self,
        flight: pd.DataFrame,
        aircraft: Aircraft,
        model: Aerodynamics,
        margin: Matrix | float = 0.0,
    ) -> pd.DataFrame:
        """Return which limits each row of a flight leaves, with ``more`` (n, c) added; ``ended``: it ended early."""
        low, high = np.array([*self.bounds(model).values()]).T
        values = self.channels(flight, aircraft, model) + margin
        return ((values < low) | (values > high)).assign(ended=flight["ended"].to_numpy() != "")


def flown_quantities(model: Aerodynamics) -> dict[str, tuple[float, float]]:
    """Return lowest and highest value of each limited quantity in the flights of a model, where it changed."""
    ends = quantities(pd.DataFrame(model.flown, index=["low", "high"]))
    return {str(name): (min(pair), max(pair)) for name, pair in ends.items() if np.ptp(pair) > 0}


def option_of(limit: str, model: Aerodynamics) -> str:
    """Return the option of the command line that changes a limit of an envelope."""
    name = limit.removeprefix(GROWTH)
    return (
        "--growth" if limit != name and name in model.regressors else OPTIONS.get(name, "--limits")
    )


def quantities(flight: pd.DataFrame) -> pd.DataFrame:
    """Return the limited quantities of each row of a flight; angles in radians, load factor -az / g."""
    names = ["alpha", "beta", "airspeed", "altitude", "az", "phi"]
    flight = flight.reindex(columns=names).astype(float)
    return flight.assign(load_factor=-flight["az"] / STANDARD_GRAVITY, bank=flight["phi"])[
        list(QUANTITIES)
    ]


def with_band(flight: pd.DataFrame, paths: pd.DataFrame) -> pd.DataFrame:
    """Return a flight with the central 95 % of others at its times: columns such as ``alpha_low``, ``alpha_high``."""
    bands = trajectory_bands(
        paths.assign(path=paths["flight"], **quantities(paths)), 0.95, QUANTITIES
    )
    return flight.join(bands.filter(regex="_(low|high)$"))


def regressors_of(flight: pd.DataFrame, aircraft: Aircraft, names: Sequence[str]) -> Matrix:
    """Return the regressors (n, d) of one simulated flight; alpha_dot and beta_dot are differentiated."""
    columns = []
    for name in names:
        channel = name if name in flight else name.removesuffix(HAT)
        is_slope = channel in ("alpha_dot", "beta_dot") and channel not in flight
        source = channel.removesuffix("_dot") if is_slope else channel
        check_columns(flight, [source, "airspeed"])
        values = flight[source].to_numpy(float)
        if is_slope:
            values = np.gradient(values, flight["time"].to_numpy(float))
        if channel != name and channel in LENGTHS:
            length = getattr(aircraft, LENGTHS[channel])
            values = values * rate_factor(channel, length, flight["airspeed"].to_numpy(float))
        columns.append(values)
    return np.stack(columns, axis=-1)


# -- manoeuvres
# -------------------------------------------------------------------------------------

RATE = 50.0  # of the autopilot [Hz]
DOUBLET_PEAK = 2.331  # frequency times width where the spectrum of a doublet peaks: tan(x / 2) = x
LONGITUDINAL = ("short period",)  # how names of modes begin; a pair that has split also has numbers
LATERAL = ("Dutch roll", "roll")
MODES = {
    "elevator": LONGITUDINAL,
    **dict.fromkeys(("aileron", "rudder"), LATERAL),
    **dict.fromkeys(("elevon_left", "elevon_right"), LONGITUDINAL + LATERAL),
    **dict.fromkeys(("thrust", "throttle", "propeller_speed"), ("phugoid",)),
}
BELOW = 0.4  # lowest frequency of the band over the frequency of the slowest mode
ABOVE = 2.5  # highest frequency of the band over the frequency of an oscillation
WIDTHS = (1.0, 2.5)  # widths of pulses, in units of the suggested one
MULTISINES = (5.0, 10.0)  # durations of multisines [s]
MOST_TONES = 8
Inputs = dict[str, Signal]


def input_bands(table: pd.DataFrame, axes: Iterable[str]) -> pd.DataFrame:
    r"""Return lengths of pulses and bands of frequencies that excite the modes of an aircraft.

    A table with a row for each of the axes, by the modes of :func:`skdgp.dynamics.linearize`:
    ``frequency`` [rad/s] of its slowest mode, ``doublet_width`` and ``three_two_one_one_width``
    [s], ``lowest`` and ``highest`` frequency [Hz].

    The mode of the elevator is the short period, of aileron and rudder Dutch roll and roll, of the
    thrust the phugoid. A doublet has the peak of its spectrum at the slowest mode,
    :math:`\omega`, if its pulses last :math:`2.33 / \omega`. The second pulse of a 3-2-1-1 lasts
    half a period: its unit is :math:`\pi / 2\omega` (Klein & Morelli, Aircraft System
    Identification, 2006, chapter 9). The band of multisines begins at 0.4 times the slowest
    frequency. It ends at 2.5 times the frequency of an oscillation, or at the frequency of a
    faster mode.

    Raises ValueError if the modes of an axis are missing, or it is no surface and no thrust.
    """
    rows = {}
    for name in axes:
        modes = table[[str(mode).startswith(MODES.get(name, ())) for mode in table.index]]
        if modes.empty:
            raise ValueError(
                f"Got the axis {name!r} and the modes {list(table.index)}, but expected axes of "
                f"{sorted(MODES)} and the modes that they excite: choose other axes, or a trim with "
                f"these modes."
            )
        frequency = modes["frequency"]
        factor = np.where(np.isfinite(modes["period"]), ABOVE, 1.0)
        rows[name] = {
            "frequency": frequency.min(),
            "doublet_width": DOUBLET_PEAK / frequency.min(),
            "three_two_one_one_width": 0.5 * np.pi / frequency.min(),
            "lowest": BELOW * frequency.min() / (2.0 * np.pi),
            "highest": (frequency * factor).max() / (2.0 * np.pi),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def library(bands: pd.DataFrame, limits: Mapping[str, float]) -> Iterator[tuple[str, Inputs]]:
    """Yield names and inputs, as large as the limits of the axes allow."""
    shortest = SAMPLES_PER_PERIOD / RATE  # period that the autopilot can set [s]
    for axis, limit in limits.items():
        for factor in WIDTHS:
            for kind, make in (("doublet", doublet), ("3-2-1-1", three_two_one_one)):
                widest: Any = bands.loc[axis, f"{make.__name__}_width"]
                width = max(factor * float(widest), 0.5 * shortest)
                yield f"{axis} {kind} {width:.2f} s", {axis: make(width, limit)}
    groups = [[axis] for axis in limits] + [[*limits]] * (len(limits) > 1)
    for group in groups:
        low = float(np.min(bands.loc[group, "lowest"].to_numpy(dtype=float)))
        highest = float(np.max(bands.loc[group, "highest"].to_numpy(dtype=float)))
        high = min(highest, 1.0 / shortest)
        for duration in MULTISINES:
            n = int(np.floor(high * duration)) - int(np.ceil(low * duration)) + 1
            tones = min(MOST_TONES, n // len(group))
            if tones > 1:
                chosen = {axis: limits[axis] for axis in group}
                inputs = orthogonal_multisines(chosen, duration, (low, high), n_tones=tones)
                yield f"{'+'.join(group)} multisine {duration:g} s", dict(inputs)


def scaled(inputs: Mapping[str, Signal], factor: float) -> Inputs:
    """Return inputs of another size."""
    return {axis: signal.scaled(factor) for axis, signal in inputs.items()}


def duration_of(inputs: Mapping[str, Signal]) -> float:
    """Return how long the inputs of a manoeuvre last [s]."""
    return max(signal.duration for signal in inputs.values())


ROW_STEP = 0.04  # time between rows of a simulation [s]
ENTRY = {"phi": 0.035, "theta": 0.035}  # standard deviations of angles of entry from trim [rad]
ENTRY_SPEED = 0.02  # standard deviation of the airspeed of entry, relative to it
ENTRY_CONTROLS = 0.02  # standard deviation of held controls, relative to their limits
LEAST = 0.2  # fraction of the limits below which a manoeuvre is left out
RESPONSE = 3.0  # seconds of response after a manoeuvre that the flight records
REACTION = 1.0  # seconds after a manoeuvre without action of the pilot


class Hold(NamedTuple):
    """Trimmed flight of the mean and of aircraft that are drawn, and the envelope around it."""

    centre: Matrix  # channels of the envelope by the mean, (n, c)
    drawn: Array  # the same by each aircraft, (paths, n, c)
    low: Vector  # of the envelope, (c,)
    high: Vector
    margin: Vector  # relative excess of the response, (c,)
    allowed: int  # paths that may leave

    def response(self, values: Matrix) -> Matrix:
        """Return the deviation of channels (n, c) from trimmed flight."""
        return values - self.centre[self._rows(values)]

    def largest(self, responses: Array) -> float:
        """Return the factor of growth of responses (paths or 1, n, c) to inputs, until more paths leave than may."""
        still = self.drawn[:, self._rows(responses[0])]
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = (np.where(responses > 0, self.high, self.low) - still) / responses
        factors = np.where(np.isfinite(factors), factors, np.inf).min(axis=(1, 2))
        return max(0.0, float(np.partition(factors, self.allowed)[self.allowed]))

    def _rows(self, values: Matrix) -> Indices:
        return np.minimum(np.arange(len(values)), len(self.centre) - 1)


class Checked(NamedTuple):
    """What a manoeuvre risks."""

    risk: float
    causes: str  # the limits that it leaves
    flight: pd.DataFrame  # by the mean
    paths: pd.DataFrame  # by aircraft that are drawn, or by the mean without a posterior
    factor: float  # possible growth, if responses grow with it


@dataclass(eq=False)
class Rehearsal:
    """Flights of manoeuvres from a trim."""

    model: Aerodynamics | BaseEstimator
    aircraft: Aircraft
    point: Trim
    limits: Mapping[str, float]
    envelope: Envelope
    pause: float  # at the trim before and after each manoeuvre [s]
    thrust: Any
    seed: int

    def __post_init__(self) -> None:
        self.aerodynamics = as_aerodynamics(self.model)
        self.response = min(RESPONSE, self.pause)  # flown after each manoeuvre too [s]
        self._nothing: Inputs = {
            next(iter(self.limits)): Steps([max((*MULTISINES, self.response))], [0.0])
        }

    def flown(self, several: Sequence[Inputs]) -> list[pd.DataFrame]:
        """Return the flights of manoeuvres, each with its response after it, by the mean."""
        trains, tables = self._tables(several)
        shortest = min(table["time"].iloc[-1] for table in tables)
        flown = self._simulated([self.point] * len(tables), tables, shortest)
        parts = (
            [flown] if len(tables) == 1 else [part for _, part in flown.groupby("start", sort=True)]
        )
        return [self._cut(part, train) for part, train in zip(parts, trains, strict=True)]

    def drawn(self, inputs: Inputs) -> pd.DataFrame:
        """Return flights of a manoeuvre by aircraft and entries that are drawn, or by the mean without a posterior."""
        if not (self.envelope.n_paths and self.aerodynamics.is_uncertain):
            return self.flown([inputs])[0]
        (train,), tables = self._tables([inputs])
        rng, time = np.random.default_rng(self.seed), tables[0].pop("time").to_numpy()
        spreads = {axis: ENTRY_CONTROLS * limit for axis, limit in self.limits.items()}
        beside = {
            axis: spread * rng.standard_normal((self.envelope.n_paths, 1))
            for axis, spread in spreads.items()
        }
        columns = {str(name): values.to_numpy() for name, values in tables[0].items()}

        def controls(t: float, state: Any) -> dict[str, Any]:
            return {
                name: np.interp(t, time, values) + beside.get(name, 0.0)
                for name, values in columns.items()
            }

        entry = UncertainStart([self.point], ENTRY | {"u": ENTRY_SPEED * self.point.airspeed})
        flown = self._simulated(
            entry, controls, time[-1], n_paths=self.envelope.n_paths, random_state=self.seed,
            air=Air(gusts=self.envelope.gusts),
        )  # fmt: skip
        return self._cut(flown, train)

    def _tables(self, several: Sequence[Inputs]) -> tuple[list[Wavetrain], list[pd.DataFrame]]:
        """Return manoeuvres, and the controls of their flights."""
        trains = [
            Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()})
            for inputs in several
        ]
        longest = max(train.duration for train in trains) + self.response
        tables = [
            train.table(RATE, trim=self.point.controls, pause=longest - train.duration)
            for train in trains
        ]
        return trains, tables

    def _simulated(self, starts: Any, controls: Any, until: float, **options: Any) -> pd.DataFrame:
        options |= {"duration": ROW_STEP * np.floor(until / ROW_STEP + 1e-6), "thrust": self.thrust}
        return simulate(self.model, self.aircraft, starts, controls, ROW_STEP, **options)

    def _cut(self, flight: pd.DataFrame, train: Wavetrain) -> pd.DataFrame:
        return flight[flight["time"] <= train.duration + self.response + 1e-6].reset_index(
            drop=True
        )

    @cached_property
    def hold(self) -> Hold:
        """Trimmed flight and the room around it; raise ValueError if gusts alone leave the envelope."""
        paths = self.drawn(self._nothing)
        risk, causes = self.risk(paths[paths["time"] <= self.response + 1e-6])
        if risk > self.envelope.risk:
            raise ValueError(
                f"Got an envelope that trimmed flight at {self.point.airspeed:g} m/s and "
                f"{self.point.altitude:.0f} m "
                f"leaves in {risk:.0%} of cases within {self.response:g} s, by {causes}, but "
                f"expected at most {self.envelope.risk:.0%}: widen this limit, choose another "
                f"airspeed or altitude, or weaker gusts."
            )
        limits = self.envelope.bounds(self.aerodynamics)
        is_set = [
            name.removeprefix(GROWTH) in self.limits for name in limits
        ]  # a control has no response
        margin = np.where(is_set, 0.0, self.envelope.margin)
        low, high = np.array([*limits.values()]).T
        centre, allowed = self.channels(self.flown([self._nothing])[0]), 0
        if self.aerodynamics.is_uncertain:
            allowed = int(np.floor(self.envelope.risk * (self.envelope.n_paths + 2) - 1 + ROUNDING))
        return Hold(
            centre, self.channels(paths).reshape(-1, *centre.shape), low, high, margin, allowed
        )

    def room(self, flight: pd.DataFrame) -> float:
        """Return the largest factor of a manoeuvre whose response fits into the envelope, for all aircraft drawn."""
        response = self.hold.response(self.channels(self._unattended(flight)))
        return self.hold.largest((1 + self.hold.margin) * response[None])

    def _unattended(self, flight: pd.DataFrame) -> pd.DataFrame:
        """Return flights of a manoeuvre until the pilot acts."""
        return flight[
            flight["time"] <= flight["time"].max() - max(0.0, self.response - REACTION) + 1e-6
        ]

    def channels(self, flight: pd.DataFrame) -> Matrix:
        """Return the limited quantities along flights, one after another, (n, c)."""
        return self.envelope.channels(flight, self.aircraft, self.aerodynamics).to_numpy()

    def checked(self, inputs: Inputs) -> Checked:
        """Return the risk of a manoeuvre and its flights, and how much larger it may be."""
        flight = self.flown([inputs])[0]
        paths = self.drawn(inputs) if self.aerodynamics.is_uncertain else flight
        margin = self.hold.margin * self.hold.response(self.channels(self._unattended(flight)))
        counted = self._unattended(paths)
        flown = self.channels(counted).reshape(-1, *margin.shape)
        factor = self.hold.largest(flown + margin - self.hold.drawn[:, self.hold._rows(margin)])
        return Checked(*self.risk(counted, np.tile(margin, (len(flown), 1))), flight, paths, factor)

    def risk(self, flight: pd.DataFrame, margin: Matrix | float = 0.0) -> tuple[float, str]:
        """Return the risk that flights leave the envelope, and the limits that they leave, with their options."""
        exceeded = self.envelope.left(flight, self.aircraft, self.aerodynamics, margin)
        by_path = exceeded.groupby(flight["flight"].to_numpy(), sort=False).any()
        shares = by_path.mean().sort_values(ascending=False)
        shares = shares[shares > 0]
        causes = ", ".join(
            f"{name} ({share:.0%}, {option_of(str(name), self.aerodynamics)})"
            for name, share in shares.items()
        )
        n_left = int(by_path.any(axis=1).sum())
        risk = (
            (n_left + 1) / (self.envelope.n_paths + 2)
            if self.aerodynamics.is_uncertain
            else float(n_left)
        )
        return risk, causes.replace(GROWTH, "flown ")
