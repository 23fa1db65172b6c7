"""Manoeuvres of a plan: a library by the modes of an aircraft, and its rehearsal inside the limits in calm air."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pandas as pd

from skdgp._compute.messages import notify
from skdgp._flight.excitation import (
    ROUNDING,
    Signal,
    Steps,
    Wavetrain,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
)
from skdgp.design._envelope import Range, quantities, regressors_of
from skdgp.dynamics import Motion, Trim, simulate

Inputs: TypeAlias = dict[str, Signal]
# Frequency times width where the spectrum of a doublet peaks: tan(x / 2) = x
DOUBLET_PEAK = 2.331
# How names of modes begin; a pair that has split also has numbers
LONGITUDINAL = ("short period",)
LATERAL = ("Dutch roll", "roll")
MODES = {
    "elevator": LONGITUDINAL,
    "aileron": LATERAL,
    "rudder": LATERAL,
    "elevon_left": LONGITUDINAL + LATERAL,
    "elevon_right": LONGITUDINAL + LATERAL,
    "thrust": ("phugoid",),
    "throttle": ("phugoid",),
    "propeller_speed": ("phugoid",),
}


# Rate of the autopilot [Hz]
RATE = 50.0
# Time between rows of a simulation [s]
ROW_STEP = 0.04
# Widths of pulses, in units of the suggested one, and durations of multisines [s]
WIDTHS = (1.0, 2.5)
MULTISINES = (5.0, 10.0)
# Most tones of an axis of a multisine
MOST_TONES = 8
# Lowest frequency over the frequency of the slowest mode, and highest frequency over the frequency of an
# oscillation
BAND = (0.4, 2.5)
# Seconds of response after a manoeuvre that the flight records
RESPONSE = 3.0
# Seconds after a manoeuvre without action of the pilot
REACTION = 1.0
# Fraction of the limits below which a manoeuvre is left out
LEAST_SCALE = 0.2
# Least and largest factor of a reduction of a manoeuvre at once
SHRINK = (0.7, 0.98)


def input_bands(table: pd.DataFrame, axes: Iterable[str]) -> pd.DataFrame:
    r"""Return lengths of pulses and bands of frequencies that excite the modes of an aircraft.

    A table with a row for each of the axes, by the modes of :func:`skdgp.dynamics.linearize`:
    ``doublet`` and ``three_two_one_one`` widths [s], ``lowest`` and ``highest`` frequency [Hz].

    The mode of the elevator is the short period, of aileron and rudder Dutch roll and roll, of the
    thrust the phugoid. A doublet has the peak of its spectrum at the slowest mode,
    :math:`\omega`, if its pulses last :math:`2.33 / \omega`. The second pulse of a 3-2-1-1 lasts
    half a period: its unit is :math:`\pi / 2\omega` (Klein & Morelli, Aircraft System
    Identification, 2006, chapter 9). The band of multisines begins at 0.4 times the slowest
    frequency. It ends at 2.5 times the frequency of an oscillation, or at the frequency of
    a faster mode.

    Raises ValueError if the modes of an axis are missing, or it is no surface and no thrust.
    """
    below, above = BAND
    rows = {}
    for name in axes:
        begins = MODES.get(name, ())
        is_excited = [str(mode).startswith(begins) for mode in table.index]
        modes = table[is_excited]
        if modes.empty:
            raise ValueError(
                f"Got the axis {name!r} and the modes {list(table.index)}, but expected axes of "
                f"{sorted(MODES)} and the modes that they excite: choose other axes, or a trim with "
                f"these modes."
            )
        frequency = modes["frequency"]
        slowest = frequency.min()
        factor = np.where(np.isfinite(modes["period"]), above, 1.0)
        rows[name] = {
            "doublet": DOUBLET_PEAK / slowest,
            "three_two_one_one": 0.5 * np.pi / slowest,
            "lowest": below * slowest / (2.0 * np.pi),
            "highest": (frequency * factor).max() / (2.0 * np.pi),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def library(bands: pd.DataFrame, limits: Mapping[str, float]) -> dict[str, Inputs]:
    """Return manoeuvres by name, as large as the limits of the axes allow."""
    manoeuvres: dict[str, Inputs] = {}
    for axis, limit in limits.items():
        manoeuvres |= _pulses(axis, limit, bands.loc[axis])
        manoeuvres |= _multisines({axis: limit}, bands.loc[[axis]])
    if len(limits) > 1:
        manoeuvres |= _multisines(limits, bands)
    return manoeuvres


def _pulses(axis: str, limit: float, band: Any) -> dict[str, Inputs]:
    """Return doublets and 3-2-1-1s of an axis, with pulses that the autopilot can set."""
    shortest = 0.5 * Wavetrain.samples_per_period / RATE
    pulses: dict[str, Inputs] = {}
    for factor in WIDTHS:
        width = max(factor * band["doublet"], shortest)
        pulses[f"{axis} doublet {width:.2f} s"] = {axis: doublet(width, limit)}
        width = max(factor * band["three_two_one_one"], shortest)
        pulses[f"{axis} 3-2-1-1 {width:.2f} s"] = {axis: three_two_one_one(width, limit)}
    return pulses


def _multisines(limits: Mapping[str, float], bands: pd.DataFrame) -> dict[str, Inputs]:
    """Return multisines on some axes at once, up to a frequency that the autopilot can set."""
    low = float(bands["lowest"].min())
    high = min(float(bands["highest"].max()), RATE / Wavetrain.samples_per_period)
    multisines: dict[str, Inputs] = {}
    for duration in MULTISINES:
        n = int(np.floor(high * duration)) - int(np.ceil(low * duration)) + 1
        tones = min(MOST_TONES, n // len(limits))
        if tones > 1:
            inputs = orthogonal_multisines(limits, duration, (low, high), n_tones=tones)
            multisines[f"{'+'.join(limits)} multisine {duration:g} s"] = {**inputs}
    return multisines


def scaled(inputs: Mapping[str, Signal], factor: float) -> Inputs:
    """Return inputs of another size."""
    return {axis: signal.scaled(factor) for axis, signal in inputs.items()}


def duration_of(inputs: Mapping[str, Signal]) -> float:
    """Return how long the inputs of a manoeuvre last [s]."""
    return max(signal.duration for signal in inputs.values())


class Rehearsed(NamedTuple):
    """A manoeuvre that stays inside the limits, and its flight with the response after it."""

    name: str
    inputs: Inputs
    scale: float  # relative to the limits of the axes
    flight: pd.DataFrame


@dataclass(frozen=True, eq=False)
class Rehearsal:
    """Simulations of manoeuvres of some axes from a trim, by the mean of a model in calm air, inside bounds."""

    motion: Motion
    trim: Trim
    axes: Sequence[str]
    bounds: Mapping[str, Range]  #: Lowest and highest value of each limited channel
    margin: float  #: Of responses to the bounds

    def inside(
        self, manoeuvres: Mapping[str, Inputs], seconds: float, pause: float
    ) -> list[Rehearsed]:
        """Return the manoeuvres that fit into the time with a pause, each as large as the limits allow."""
        full = _that_last(manoeuvres, seconds - pause)
        centre = self._centre()
        scales = dict.fromkeys(full, 1.0)
        inside = []
        cause = ""
        notify(f"planning: size of {len(scales)} manoeuvres", 0, np.nan)
        while scales:
            sized = {name: scaled(full[name], scale) for name, scale in scales.items()}
            for name, flight in self._flights(sized).items():
                factors = self._factors(sized[name], flight, centre)
                scale = scales.pop(name)
                if factors.min() >= 1.0:
                    inside.append(Rehearsed(name, sized[name], scale, flight))
                    continue
                # responses are nearly proportional to inputs
                scale *= float(np.clip(factors.min(), *SHRINK))
                cause = str(factors.idxmin())
                if scale >= LEAST_SCALE:
                    scales[name] = scale
        if not inside:
            raise ValueError(
                f"Got an envelope that every manoeuvre leaves even at {LEAST_SCALE:.0%} of the limits; the last one "
                f"leaves it by {cause}: widen this limit (--growth), or fly another airspeed or altitude."
            )
        return inside

    def _flights(self, manoeuvres: Mapping[str, Inputs]) -> dict[str, pd.DataFrame]:
        """Return the flights of manoeuvres, each with its response after it."""
        longest = max(map(duration_of, manoeuvres.values())) + RESPONSE
        tables = []
        for inputs in manoeuvres.values():
            train = Wavetrain({axis: {0.0: signal} for axis, signal in inputs.items()})
            pause = longest - train.duration
            tables.append(train.table(RATE, trim=self.trim.controls, pause=pause))
        flown = simulate(
            self.motion.aerodynamics,
            self.motion.aircraft,
            [self.trim] * len(tables),
            tables,
            ROW_STEP,
            thrust=self.motion.thrust,
        )
        flights = {}
        of_manoeuvres = zip(manoeuvres.items(), flown.groupby("flight"), strict=True)
        for (name, inputs), (_, rows) in of_manoeuvres:
            flight = rows.reset_index(drop=True)
            flights[name] = flight[flight["time"] <= duration_of(inputs) + RESPONSE + ROUNDING]
        return flights

    def _channels(self, flight: pd.DataFrame) -> pd.DataFrame:
        """Return the values of each of the bounds along one flight."""
        values = quantities(flight)
        values[[*self.motion.aerodynamics.regressors]] = regressors_of(flight, self.motion)
        return values[[*self.bounds]]

    def _centre(self) -> pd.Series:
        """Return the limited channels in trimmed flight; raise ValueError if they leave their limits."""
        nothing: Inputs = {self.axes[0]: Steps([1.0], [0.0])}
        centre = self._channels(self._flights({"trim": nothing})["trim"]).iloc[0]
        for name, (low, high) in self.bounds.items():
            if centre[name] < low or centre[name] > high:
                raise ValueError(
                    f"Got an envelope that trimmed flight at {self.trim.airspeed:g} m/s and {self.trim.altitude:.0f} m "
                    f"leaves by {name}: widen this limit (--growth), or choose another airspeed or altitude."
                )
        return centre

    def _factors(self, inputs: Inputs, flight: pd.DataFrame, centre: pd.Series) -> pd.Series:
        """Return for each limit the factor of the response that meets it, with the margin."""
        if (flight["ended"] != "").any():
            return pd.Series({"the end of the simulation": 0.0})
        unattended = duration_of(inputs) + REACTION + ROUNDING
        response = self._channels(flight[flight["time"] <= unattended]) - centre
        is_response = ~response.columns.isin(self.axes)  # a control has none
        response *= 1.0 + self.margin * is_response
        low, high = np.array([*self.bounds.values()]).T - centre.to_numpy()
        with np.errstate(divide="ignore", invalid="ignore"):
            factors = response.rdiv(1.0) * np.where(response > 0, high, low)
        return factors.where(np.isfinite(factors), np.inf).min()


def _that_last(manoeuvres: Mapping[str, Inputs], longest: float) -> dict[str, Inputs]:
    """Return the manoeuvres of at most a duration [s]; raise ValueError if there is none."""
    short = {name: inputs for name, inputs in manoeuvres.items() if duration_of(inputs) <= longest}
    if not short:
        shortest = min(map(duration_of, manoeuvres.values()))
        raise ValueError(
            f"Got {max(longest, 0.0):.3g} s for a manoeuvre between its pauses, but expected at least "
            f"{shortest:.3g} s: give {shortest - longest:.3g} s more."
        )
    return short
