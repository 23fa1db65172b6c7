r"""Frequency responses from a flight, with correlated inputs (Tischler & Remple 2012, chapters 7 to 9).

With the spectra of the inputs x and an output y by Welch's method, averaged over windows and over a
band, and P their inverse,

.. math:: H = S_{xx}^{-1} S_{xy} = -\frac{P_{xy}}{P_{yy}}, \quad
    \gamma_i^2 = \frac{|P_{iy}|^2}{P_{ii} P_{yy}},

where :math:`\gamma_i^2` is the partial coherence, without what the other inputs explain. There are no
bands: formulas of the random error (Bendat & Piersol 2010, section 9.3) leave out the bias where an
autopilot feeds gusts back to the inputs; with a guess of it they held 71 to 88 % of the responses of the
example flights for 95 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from skdgp._compute.linalg import constant_columns
from skdgp._compute.typing import Array
from skdgp._flight.checks import check_names
from skdgp._flight.clock import true_runs
from skdgp._flight.spectra import cross_spectra
from skdgp._flight.tables import FlightTable, interpolated, unwrapped
from skdgp.dynamics._linearize import LinearModel, transfer
from skdgp.dynamics._motion import WITHOUT_SERVOS

# Longest and shortest window [s], and windows that a record shall hold
WINDOW = 20.0
LEAST_WINDOW = 1.0
N_WINDOWS = 5.0
# Bands of a factor of ten in frequency
PER_DECADE = 15
# Highest frequency over that of the sampling
HIGHEST = 0.2
# Least partial coherence of a response that counts (Tischler & Remple 2012, section 8.5)
COHERENCE = 0.6
# Least power of an input that counts, over its largest: below, an autopilot that feeds noise and
# gusts back may move it (guess)
POWER = 0.1
# Singular values of spectra over the largest that are round-off: inputs may always move together
RIDGE = 1e-12


def frequency_response(
    flight: pd.DataFrame,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    linear: LinearModel | None = None,
) -> pd.DataFrame:
    """Return the responses of outputs to inputs, estimated from a flight without a model of the aircraft.

    Name all inputs that moved together: what one explains is not counted for another.

    Parameters
    ----------
    flight : DataFrame
        One flight or several; gaps divide records.
    inputs, outputs : sequence of str
        Columns such as ``aileron``, ``rudder`` and ``p``, ``r``, ``ay``.
    linear : LinearModel, optional
        Of :func:`linearize`, for the model's response beside the estimate, without its ``delay``,
        which lies before the logged commands.

    Returns
    -------
    DataFrame
        Rows (output, input, frequency [rad/s]); columns ``gain`` [dB], ``phase`` [deg], ``coherence``, the
        partial one, and ``excited``: whether coherence and power of the input suffice. Where an autopilot
        feeds gusts back, coherence may be high and the response wrong. With a linear model
        ``model_gain``, ``model_phase`` and, of its paths, ``_lower`` and ``_upper``, which hold 95 %.

    Raises
    ------
    ValueError
        If columns are missing, an input is named twice or does not move, or the records are too short.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from scipy.signal import lfilter
    >>> from skdgp.dynamics import frequency_response
    >>> time = np.arange(0, 200, 0.02)
    >>> aileron = np.random.default_rng(0).normal(size=len(time))
    >>> p = lfilter([0.0, 0.2], [1, -0.96], aileron)
    >>> flight = pd.DataFrame({"time": time, "aileron": aileron, "p": p})
    >>> response = frequency_response(flight, ["aileron"], ["p"]).loc[("p", "aileron")]
    >>> row = response.iloc[response.index.get_indexer([2.0], method="nearest")[0]]
    >>> row[["gain", "phase"]].astype(float).round(0).tolist()
    [11.0, -44.0]
    """
    inputs, outputs = list(inputs), list(outputs)
    if not inputs or not outputs or len({*inputs, *outputs}) < len(inputs) + len(outputs):
        raise ValueError(
            f"Got inputs={inputs} and outputs={outputs}, but expected names of columns, each once."
        )
    table = FlightTable.of(flight, [*inputs, *outputs])
    step = float(np.median(np.diff(table.time)))
    frequency, S = _band_spectra(_records(table, [*inputs, *outputs], step), step)
    H, coherence, power = _responses(S, len(inputs))
    is_excited = (coherence >= COHERENCE) & (power >= POWER * power.max(axis=-1, keepdims=True))
    columns = {
        "gain": _decibels(H),
        "phase": np.rad2deg(np.angle(H)),
        "coherence": coherence,
        "excited": is_excited,
    }
    frequency *= 2.0 * np.pi
    if linear is not None:
        columns |= _of_model(linear, inputs, outputs, frequency)
    names = ["output", "input", "frequency"]
    index = pd.MultiIndex.from_product([outputs, inputs, frequency], names=names)
    values = {name: column.ravel() for name, column in columns.items()}
    return pd.DataFrame(values, index).sort_index()


def _records(table: FlightTable, names: list[str], step: float) -> list[Array]:
    """Return the channels (c, n) of each record without gaps, at even steps [s]; ValueError if one does not move."""
    values = unwrapped(table.table, names)
    still = np.array(names)[constant_columns(values)].tolist()
    if still:
        raise ValueError(f"Got columns {still} that do not move: leave them out.")
    is_whole: Any = np.isfinite(values).all(axis=1)
    records = []
    for rows in table.segments:
        for run in true_runs(is_whole[rows]):
            time = table.time[rows][run]
            even = np.arange(time[0], time[-1] + 0.5 * step, step)
            records.append(interpolated(even, time, values[rows][run]).T)
    return records


def _band_spectra(records: list[Array], step: float) -> tuple[Array, Array]:
    """Return frequencies [Hz] (n,) and cross spectra (n, c, c) of bands."""
    lengths = [record.shape[1] for record in records]
    longest = max(lengths, default=0)
    n = int(min(WINDOW / step, longest, sum(lengths) / N_WINDOWS))
    if n * step < LEAST_WINDOW:
        raise ValueError(
            f"Got records of {step * sum(lengths):.1f} s, the longest of {step * longest:.1f} s, but "
            f"expected at least {N_WINDOWS * LEAST_WINDOW:g} s, and one of {LEAST_WINDOW:g} s, "
            f"without gaps in these columns."
        )
    frequency, S, _ = cross_spectra(records, step, n)
    S = S.conj()  # S_ij, the mean of conj(x_i) x_j
    # two periods of the lowest frequency in a window
    is_used = (frequency >= 2.0 * frequency[1]) & (frequency <= HIGHEST / step)
    frequency = frequency[is_used]
    S = S[is_used]
    first = np.flatnonzero(np.diff(np.floor(PER_DECADE * np.log10(frequency)), prepend=-np.inf))
    n_bins = np.diff([*first, len(frequency)])
    mean_frequency = np.add.reduceat(frequency, first) / n_bins
    return mean_frequency, np.add.reduceat(S, first) / n_bins[:, None, None]


def _responses(S: Array, q: int) -> tuple[Array, Array, Array]:
    """Return H, partial coherence and power of q inputs, (n_outputs, q, n), by spectra (n, c, c) of inputs and outputs.

    The power is what the other inputs do not explain. Inputs that always move together share the response.
    """
    size = np.sqrt(np.einsum("nii->ni", S).real)
    scaled = S / (size[:, :, None] * size[:, None, :])
    responses, coherences = [], []
    for k in range(q, S.shape[1]):
        channels = [*range(q), k]
        P = _inverse(scaled[:, channels][:, :, channels])
        own = np.einsum("nii->in", P).real
        of_output = P[:, :q, q].T
        responses.append(-of_output / own[q] * size[:, k] / size[:, :q].T)
        coherences.append(np.abs(of_output) ** 2 / (own[:q] * own[q]))
    alone = np.einsum("nii->in", _inverse(scaled[:, :q, :q])).real
    power = size[:, :q].T ** 2 / alone
    coherence: Any = np.clip(coherences, np.finfo(float).tiny, 1.0)
    return np.array(responses), coherence, np.broadcast_to(power, coherence.shape)


def _inverse(S: Array) -> Any:
    """Return the pseudo-inverse of Hermitian matrices."""
    return np.linalg.pinv(S, rcond=RIDGE, hermitian=True)


def _decibels(H: Array) -> Any:
    return 20.0 * np.log10(np.maximum(np.abs(H), np.finfo(float).tiny))


def _of_model(
    linear: LinearModel, inputs: list[str], outputs: list[str], frequency: Array
) -> dict[str, Array]:
    """Return gain and phase (n_outputs, q, n) of a linear model, with limits of its paths."""
    check_names(outputs, linear.C.index, "outputs of the linear model")
    check_names(inputs, linear.B.columns, "controls of the linear model")
    rows = linear.C.index.get_indexer(outputs)[:, None]
    columns = linear.B.columns.get_indexer(inputs)
    s: Any = 1j * frequency
    has_servo = ~np.isin(inputs, [*WITHOUT_SERVOS])

    def response(A: Any, B: Any, C: Any, D: Any, delay: Any) -> Array:
        late = np.exp(-s[:, None, None] * has_servo * np.asarray(delay)[..., None, None, None])
        H = transfer(A, B, C, D, linear.A.index, s)[..., rows, columns] * late
        return np.moveaxis(H, -3, -1)

    H = response(linear.A, linear.B, linear.C, linear.D, linear.servos.delay)
    phase = np.rad2deg(np.angle(H))
    of_model = {"model_gain": _decibels(H), "model_phase": phase}
    if linear.paths is not None:
        drawn = response(*linear.paths)
        turned = phase + np.rad2deg(np.angle(drawn / H))
        for name, values in (("model_gain", _decibels(drawn)), ("model_phase", turned)):
            lower, upper = np.quantile(values, [0.025, 0.975], axis=0)
            of_model |= {f"{name}_lower": lower, f"{name}_upper": upper}
    return of_model
