"""Library of manoeuvres by the modes of an aircraft, and the numbers of a plan."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from skdgp._flight.excitation import (
    Signal,
    Wavetrain,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
)

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
