"""Inputs that a plan chooses from, by the modes of the aircraft: lengths of pulses, bands of frequencies, library."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import numpy as np
import pandas as pd

from skdgp._excitation import (
    SAMPLES_PER_PERIOD,
    Signal,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
)

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
