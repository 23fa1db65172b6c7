"""Inputs that a plan chooses from, by the modes of the aircraft: lengths of pulses, bands of frequencies, library."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np
import pandas as pd

from skdgp._excitation import (
    Limits,
    Signal,
    Steps,
    doublet,
    orthogonal_multisines,
    three_two_one_one,
)
from skdgp.dynamics import LinearModel

DOUBLET_PEAK = (
    2.331  # frequency times width at which the spectrum of a doublet is largest: tan(x / 2) = x
)
LONGITUDINAL, LATERAL = ("short period",), ("Dutch roll", "roll")
"""How names of the modes begin that surfaces excite; a pair that has split also has numbers."""
MODES = {"elevator": LONGITUDINAL, "aileron": LATERAL, "rudder": LATERAL}
MODES |= dict.fromkeys(("elevon_left", "elevon_right"), LONGITUDINAL + LATERAL)
MODES |= dict.fromkeys(("thrust", "throttle", "propeller_speed"), ("phugoid",))
BELOW, ABOVE = (
    0.4,
    2.5,
)  # the band begins at this part of the slowest mode and ends at this multiple of an oscillation
WIDTHS = (1.0, 2.5)  # widths of pulses, in units of the suggested one
MULTISINES = (5.0, 10.0)  # durations of multisines [s]
TICK = 0.5  # unit of time of a pilot's steps [s]
MOST_TONES = 8
STARTS = 2  # searches for the phases of a multisine
Inputs = dict[str, Signal]


def input_bands(linear: LinearModel) -> pd.DataFrame:
    r"""Return lengths of pulses and bands of frequencies that excite the modes of an aircraft.

    A table with a row for each input of a linear model (:func:`skdgp.dynamics.linearize`):
    ``frequency`` [rad/s] of its slowest mode, ``doublet_width`` and ``three_two_one_one_width``
    [s], ``lowest`` and ``highest`` frequency [Hz].

    The mode of the elevator is the short period, of aileron and rudder Dutch roll and roll, of the
    thrust the phugoid. A doublet has the largest part of its spectrum at the slowest of them,
    :math:`\omega`, if its pulses last :math:`2.33 / \omega`. The second pulse of a 3-2-1-1 lasts
    half a period: its unit is :math:`\pi / 2\omega` (Klein & Morelli, Aircraft System
    Identification, 2006, chapter 9). The band of multisines and sweeps begins at 0.4 times the
    slowest frequency. It ends at 2.5 times that of an oscillation, or at that of a faster mode
    without. With paths of the posterior it is wider, by two standard deviations of the frequencies.

    Raises ValueError if the linear model lacks the modes of an input, or has an input that is no
    surface and no thrust.

    Examples
    --------
    >>> import numpy as np
    >>> from skdgp.design import input_bands
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, linearize, trim
    >>> def linear(X):
    ...     alpha, q, elevator = X.T
    ...     none, lift = 0 * alpha, 0.3 + 4.5 * alpha
    ...     return np.stack([-0.02 * lift, none, -lift, none, 0.02 - 0.6 * alpha - 9 * q - elevator, none], axis=-1)
    >>> model = Aerodynamics(linear, ["alpha", "q_hat", "elevator"])
    >>> aircraft = Aircraft(mass=12, inertia=np.diag([1.1, 2.3, 3.1]), wing_area=1.3, span=2.6, chord=0.55)
    >>> input_bands(linearize(model, aircraft, trim(model, aircraft, 20.0), inputs=["elevator"])).T.round(2)
                             elevator
    frequency                   10.12
    doublet_width                0.23
    three_two_one_one_width      0.16
    lowest                       0.64
    highest                      4.03
    """
    table = linear.modes()
    rows = {}
    for name in linear.inputs:
        modes = table[[str(mode).startswith(MODES.get(name, ())) for mode in table.index]]
        if modes.empty:
            raise ValueError(
                f"Got a linear model with the input {name!r} and the modes {list(table.index)}, "
                f"but expected inputs of "
                f"{sorted(MODES)} and the modes that they excite: linearise with all states and "
                f"such inputs."
            )
        frequency, swings = modes["frequency"], np.isfinite(modes["period"])
        spread = 2.0 * modes["frequency_std"] if "frequency_std" in modes else 0.0 * frequency
        rows[name] = {
            "frequency": frequency.min(),
            "doublet_width": DOUBLET_PEAK / frequency.min(),
            "three_two_one_one_width": 0.5 * np.pi / frequency.min(),
            "lowest": BELOW * np.maximum(frequency - spread, 0.5 * frequency).min() / (2.0 * np.pi),
            "highest": ((frequency + spread) * np.where(swings, ABOVE, 1.0)).max() / (2.0 * np.pi),
        }
    return pd.DataFrame.from_dict(rows, orient="index")


def library(
    bands: pd.DataFrame, limits: Mapping[str, Limits], detents: Mapping[str, float], seed: int
) -> Iterator[tuple[str, Inputs]]:
    """Yield names and inputs, as large as the limits of the axes allow; with ``detents`` those that a pilot can fly."""
    for axis, limit in limits.items():
        for factor in WIDTHS:
            for kind, make, share in (
                ("doublet", doublet, 2 / 3),
                ("3-2-1-1", three_two_one_one, 1 / 2),
            ):
                width = factor * bands[f"{make.__name__}_width"].to_dict()[axis]
                width = TICK * max(1, round(width / TICK)) if detents else width
                most = min(
                    limit.amplitude, share * limit.rate * width
                )  # its ramps fit into the width
                signal = limit.largest(make(width, most, limits=replace(limit, rms=np.inf)))
                yield f"{axis} {kind} {width:.2f} s", {axis: signal}
    groups = [[axis] for axis in limits] + [[*limits]] * (len(limits) > 1)
    for group in () if detents else groups:
        low, high = bands.loc[group, "lowest"].min(), bands.loc[group, "highest"].max()
        for duration in MULTISINES:
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
    steps = {
        axis: signal for axis, signal in found.items() if detents and isinstance(signal, Steps)
    }
    return found | {
        axis: Steps(signal.durations, signal.levels_in(detents[axis]))
        for axis, signal in steps.items()
    }


def duration_of(inputs: Mapping[str, Signal]) -> float:
    """Return how long the inputs of a manoeuvre last [s]."""
    return max(signal.duration for signal in inputs.values())
