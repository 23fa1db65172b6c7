"""Inputs that a plan chooses from: doublets, 3-2-1-1s and multisines, by the modes of the aircraft."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from skdgp._excitation.multisines import orthogonal_multisines
from skdgp._excitation.signals import ROUNDING, Limits, Signal, Steps, doublet, three_two_one_one

WIDTHS = (1.0, 2.5)
"""Of pulses, in units of the suggested width."""
MULTISINES = (5.0, 10.0)
"""Durations [s]."""
TICK = 0.5
"""Of the steps of a pilot [s]."""
MOST_TONES = 8
STARTS = 2
"""Searches for the phases of a multisine."""
Inputs = dict[str, Signal]


def library(
    bands: pd.DataFrame, limits: Mapping[str, Limits], detents: Mapping[str, float], seed: int
) -> Iterator[tuple[str, Inputs]]:
    """Yield names and inputs, as large as the limits of the axes allow; with ``detents`` those that a pilot can fly."""
    axes = list(limits)
    for axis, limit in limits.items():
        for factor in WIDTHS:
            for kind, make, share in (("doublet", doublet, 2 / 3), ("3-2-1-1", three_two_one_one, 1 / 2)):
                width = factor * bands[f"{make.__name__}_width"].to_dict()[axis]
                width = TICK * max(1, round(width / TICK)) if detents else width
                most = min(limit.amplitude, share * limit.rate * width)  # its ramps fit into the width
                signal = limit.largest(make(width, most, limits=replace(limit, rms=np.inf)))
                yield f"{axis} {kind} {width:.2f} s", {axis: signal}
    groups = [[axis] for axis in axes] + [axes] * (len(axes) > 1)
    for group in groups:
        low, high = bands.loc[group, "lowest"].min(), bands.loc[group, "highest"].max()
        for duration in () if detents else MULTISINES:
            n = int(np.floor(high * duration)) - int(np.ceil(low * duration)) + 1
            tones = min(MOST_TONES, n // len(group))
            if tones > 1:
                inputs = orthogonal_multisines(
                    {axis: limits[axis] for axis in group}, duration, (low, high), n_tones=tones, n_starts=STARTS,
                    random_state=seed,
                )  # fmt: skip
                yield f"{'+'.join(group)} multisine {duration:g} s", dict(inputs)


def scaled(inputs: Mapping[str, Signal], factor: float, detents: Mapping[str, float]) -> Inputs:
    """Return inputs of another size, the levels of a pilot's in whole detents."""
    found = {axis: signal.scaled(factor) for axis, signal in inputs.items()}
    for axis, signal in found.items():
        if detents and isinstance(signal, Steps):
            counts = np.trunc(np.divide(signal.levels, detents[axis]) * (1 + ROUNDING))
            found[axis] = Steps(signal.durations, (detents[axis] * counts).tolist())
    return found


def moves(inputs: Mapping[str, Signal]) -> bool:
    """Return whether any axis moves: a pilot's input may be smaller than a detent."""
    return any(signal.peak for signal in inputs.values())


def duration_of(inputs: Mapping[str, Signal]) -> float:
    """Return how long the inputs of a manoeuvre last [s]."""
    return max(signal.duration for signal in inputs.values())
