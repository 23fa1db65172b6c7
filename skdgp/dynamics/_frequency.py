r"""Frequency responses from a flight, with correlated inputs (CIFER: Tischler & Remple 2012, chapters 7 to 9).

With the spectra of the inputs x and an output y, averaged over windows and over a band,

.. math:: H = S_{xx}^{-1} S_{xy}, \quad
    \gamma_i^2 = \frac{|S_{iy \cdot r}|^2}{S_{ii \cdot r} S_{yy \cdot r}}, \quad
    \epsilon_i^2 = \frac{1 - \gamma_i^2}{2 \gamma_i^2} \Big(\frac{1}{n_d - q + 1} + f_i\Big),

where :math:`S_{\cdot r}` are conditioned spectra, without what the other q - 1 inputs explain,
:math:`\gamma_i^2` is the partial coherence, :math:`n_d` the number of independent averages and
:math:`\epsilon` the error of the gain, relative, and of the phase [rad]. Its first part is random
(Bendat & Piersol 2010, section 9.3). The second is the bias by feedback: a part f of the power of an
input that follows disturbances of the output has a cross spectrum with them of at most
:math:`\sqrt{f}` times that of full coherence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.signal import detrend
from scipy.signal.windows import hann

from skdgp._compute.linalg import constant_columns
from skdgp._compute.typing import Array, Indices, Mask, Matrix
from skdgp._flight.channels import (
    AIR_DATA,
    BODY_VELOCITY,
    EARTH_VELOCITY,
    EULER,
    POSITION,
    RATES,
)
from skdgp._flight.clock import n_rows, true_runs
from skdgp._flight.tables import FlightTable, interpolated, unwrapped
from skdgp.dynamics._linearize import LinearModel
from skdgp.dynamics._transfer import transfer


@dataclass(frozen=True)
class SpectrumSettings:
    """Settings of frequency responses from flights."""

    # Longest and shortest windows [s], and windows that a record shall hold
    window: float = 20.0
    least_window: float = 4.0
    n_windows: float = 5.0
    # Upper over lower end of the band of an average: windows alone average little
    band: float = 1.25
    # Bands of a factor of ten in frequency
    per_decade: int = 20
    # Periods of the lowest frequency in a window
    periods: float = 2.0
    # Highest frequency over that of the sampling
    highest: float = 0.2
    # Least partial coherence and largest random error of a response that counts (Tischler & Remple
    # 2012, sections 8.5 and 9.4)
    coherence: float = 0.6
    error: float = 0.2
    # Response to the input, in power over the noise of the output, that counts as excited, and the
    # part of the highest frequencies that is noise
    excited: float = 4.0
    noise: float = 0.25
    # Largest bias by feedback, relative, of a response that counts (chosen on JSBSim's viggen, judged
    # on five other aircraft), and largest part of the power of the input that is fed back
    bias: float = 0.15
    part: float = 0.5
    # Samples of the autoregression, and rows for each of its coefficients
    order: int = 20
    rows: int = 10


SPECTRA = SpectrumSettings()
# Outputs that do not follow inputs within a sample
LAGGING_OUTPUTS = (
    *RATES,
    *EULER,
    *AIR_DATA,
    *BODY_VELOCITY,
    *EARTH_VELOCITY,
    *POSITION,
    "altitude",
)
# Relative, of matrices that are inverted: inputs may always move together
RIDGE = 1e-10
# Correlations of the powers of neighbouring bins, and of those two apart, of Hann's window
NEIGHBOURS = (4 / 9, 1 / 36)
# Correlation of the powers of Hann's windows that overlap by half
OVERLAP = 1 / 36


class Spectra(NamedTuple):
    """Cross spectra of channels at the bins of a window, and the number of independent windows."""

    frequency: Array  #: [Hz], (n,)
    cross: Array  #: S_ij = mean of conj(x_i) x_j, (n, c, c)
    n_windows: float


def frequency_response(
    flight: pd.DataFrame,
    inputs: Sequence[str],
    outputs: Sequence[str],
    *,
    linear: LinearModel | None = None,
    settings: SpectrumSettings = SPECTRA,
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
    settings : SpectrumSettings

    Returns
    -------
    DataFrame
        Rows (output, input, frequency [rad/s]); columns ``gain`` [dB] and ``phase`` [deg] with
        standard deviations ``gain_std`` and ``phase_std``, ``coherence``, the partial one, and
        ``excited``: whether coherence, error and power of the response suffice, and the input moves
        by itself: where an autopilot feeds gusts and noise back, coherence is high and the response
        wrong. With a linear model ``model_gain``, ``model_phase`` and, of its paths, ``_lower`` and ``_upper``,
        which hold 95 %.

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
    [11.0, -46.0]
    """
    inputs, outputs = list(inputs), list(outputs)
    if not inputs or not outputs or len({*inputs, *outputs}) < len(inputs) + len(outputs):
        raise ValueError(
            f"Got inputs={inputs} and outputs={outputs}, but expected names of columns, each once."
        )
    table = FlightTable.of(flight, [*inputs, *outputs])
    step = float(np.median(np.diff(table.time)))
    records = _records(table, [*inputs, *outputs], step)
    spectra = _spectra(records, step, settings)
    bands = _bands(spectra.frequency, settings)
    phases = [2 * np.pi * step * spectra.frequency[band].mean() for band in bands]
    feedback = _feedback(records, np.array(phases), inputs, outputs, settings)
    rows = []
    for band, fed_back, is_free in zip(bands, feedback.fed_back, feedback.is_free, strict=True):
        rows += _band_rows(spectra, band, fed_back, is_free, inputs, outputs, settings)
    responses = pd.DataFrame(rows).set_index(["output", "input", "frequency"]).sort_index()
    if linear is not None:
        responses = responses.join(_of_model(linear, responses.index))
    return responses


def _spectra(records: list[Array], step: float, settings: SpectrumSettings) -> Spectra:
    """Return the spectra of the channels of records, averaged over windows that overlap by half."""
    lengths = [step * record.shape[1] for record in records]
    longest = max(lengths, default=0.0)
    seconds = min(settings.window, longest, sum(lengths) / settings.n_windows)
    if seconds < settings.least_window:
        raise ValueError(
            f"Got records of {sum(lengths):.1f} s, the longest of {longest:.1f} s, but expected at least "
            f"{settings.n_windows * settings.least_window:g} s, and one of {settings.least_window:g} s, without gaps "
            "in these columns."
        )
    n = round(seconds / step)
    transforms = []
    for record in records:
        for begin in range(0, record.shape[1] - n + 1, n // 2):
            window = detrend(record[:, begin : begin + n])
            transforms.append(np.fft.rfft(window * hann(n, sym=False)))
    X = np.array(transforms)
    cross = np.einsum("wif,wjf->fij", X.conj(), X) / len(X)
    n_independent = len(X) / (1.0 + 2.0 * OVERLAP * (1.0 - 1.0 / len(X)))
    frequency = np.arange(n // 2 + 1) / (n * step)
    return Spectra(frequency, cross, n_independent)


def _records(table: FlightTable, names: list[str], step: float) -> list[Array]:
    """Return the channels (c, n) of each record without gaps, at even steps [s]; ValueError if one does not move."""
    values = unwrapped(table.table, names)
    still = np.array(names)[constant_columns(values)].tolist()
    if still:
        raise ValueError(f"Got columns {still} that do not move: leave them out.")
    is_whole: Mask = np.all(np.isfinite(values), axis=1)
    records = []
    for rows in table.segments:
        for run in true_runs(is_whole[rows]):
            if n_rows(run) > 1:
                time = table.time[rows][run]
                even = np.arange(time[0], time[-1] + 0.5 * step, step)
                channels = interpolated(even, time, values[rows][run]).T
                records.append(np.ascontiguousarray(channels))
    return records


def _bands(frequency: Array, settings: SpectrumSettings) -> list[Indices]:
    """Return the bins of each band, without the lowest and highest frequencies."""
    spacing = frequency[1]
    low = settings.periods * spacing
    high = 2.0 * settings.highest * frequency[-1]
    n_bands = 1 + int(settings.per_decade * np.log10(high / low))
    half = np.sqrt(settings.band)
    bands: list[Indices] = []
    for centre in np.geomspace(low, high, n_bands):
        bins = np.flatnonzero((frequency >= centre / half) & (frequency <= centre * half))
        if len(bins) and not (bands and np.array_equal(bins, bands[-1])):
            bands.append(bins)
    return bands


class Feedback(NamedTuple):
    """What an autopilot feeds back to q inputs, at n frequencies."""

    is_free: Array  #: Whether inputs move by themselves, for each response (n, q, outputs)
    fed_back: Array  #: Fraction of the power of inputs that is fed back (n, q)


def _feedback(
    records: list[Array],
    phases: Array,
    inputs: list[str],
    outputs: list[str],
    settings: SpectrumSettings,
) -> Feedback:
    r"""Return what is fed back to the inputs at ``phases`` :math:`\omega` [rad a sample] (n,).

    An autoregression of all channels z (Geweke 1982),

    .. math:: z_k = \sum_j A_j z_{k-j} + L e_k, \quad
        T(\omega) = \Big(I - \sum_j A_j e^{-i \omega j}\Big)^{-1} L,

    with white e of unit variance, gives the response from the spectra :math:`T T^H`, as
    `_estimated_response` has it. From the innovations of the inputs alone it is the aircraft's, and
    the power that remains is fed back. What moves within a sample may follow the inputs or the
    outputs: L is triangular either way, and inputs are free if they are in one of them. The
    fraction that errors count is larger: within a sample inputs follow states, as rates, and other outputs
    follow inputs.
    """
    A, covariance = _autoregression(records, settings)
    order, c, _ = A.shape
    q = len(inputs)
    delays = np.exp(-1j * np.outer(phases, np.arange(1, order + 1)))
    transfers = np.linalg.inv(np.eye(c) - np.tensordot(delays, A, axes=1))
    is_free = np.zeros((len(phases), q, c - q), dtype=bool)
    channels = np.arange(c)
    for sequence in (channels, channels[::-1]):
        T, fed_back = _of_innovations(transfers, covariance, sequence, q)
        aircraft = _response_of(T[..., channels < q], q)
        bias = np.abs(_response_of(T, q) - aircraft)
        moves_by_itself = fed_back <= settings.part
        is_free |= (bias <= settings.bias * np.abs(aircraft)) & moves_by_itself[..., None]
    rank = [1] * q + [0 if name in LAGGING_OUTPUTS else 2 for name in outputs]
    _, fed_back = _of_innovations(transfers, covariance, np.argsort(rank, kind="stable"), q)
    return Feedback(is_free, fed_back)


def _of_innovations(
    transfers: Array, covariance: Matrix, sequence: Indices, q: int
) -> tuple[Array, Array]:
    """Return T (n, c, c) where channels follow in a sequence within a sample, and the fraction of inputs fed back.

    Columns of T are innovations of the channels in their order, of which the first q are inputs.
    """
    L = np.zeros_like(covariance)
    L[np.ix_(sequence, sequence)] = np.linalg.cholesky(covariance[np.ix_(sequence, sequence)])
    T = transfers @ L
    power = np.sum(np.abs(T[:, :q]) ** 2, axis=2)
    fed_back = np.sum(np.abs(T[:, :q, q:]) ** 2, axis=2)
    return T, fed_back / power


def _autoregression(records: list[Array], settings: SpectrumSettings) -> tuple[Array, Matrix]:
    """Return A (order, c, c) and the covariance (c, c) of e of channels (c, n) over their deviations."""
    c = len(records[0])
    lengths = [record.shape[1] for record in records]
    order = min(settings.order, sum(lengths) // (settings.rows * c), max(lengths) - 1)
    order = max(1, order)
    scale = np.concatenate(records, axis=1).std(axis=1)
    before, now = [], []
    for record in records:
        n = record.shape[1]
        if n > order:
            z = ((record.T - record.mean(axis=1)) / scale).T
            before.append(np.concatenate([z[:, order - j : n - j] for j in range(1, order + 1)]))
            now.append(z[:, order:])
    X = np.concatenate(before, axis=1)
    Y = np.concatenate(now, axis=1)
    gram = X @ X.T
    np.einsum("ii->i", gram)[:] *= 1.0 + RIDGE
    coefficients = np.linalg.solve(gram, X @ Y.T).T
    innovations = Y - coefficients @ X
    covariance = innovations @ innovations.T / Y.shape[1] + RIDGE * np.eye(c)
    return coefficients.reshape(c, order, c).swapaxes(0, 1), covariance


def _response_of(T: Array, q: int) -> Array:
    """Return the responses (n, q, outputs) to q inputs of channels with the spectra T T^H."""
    inputs, outputs = T[:, :q], T[:, q:]
    adjoint = inputs.conj().swapaxes(1, 2)
    inverse = np.linalg.pinv(inputs @ adjoint, rcond=RIDGE, hermitian=True)
    return (outputs @ adjoint @ inverse).swapaxes(1, 2)


class _Response(NamedTuple):
    """Response of an output to an input in a band."""

    H: complex
    coherence: float  #: Partial
    error: float  #: Standard deviation of the gain, relative, and of the phase [rad]
    power: float  #: Of the output, by what the other inputs do not explain of the input


def _band_rows(
    spectra: Spectra,
    band: Indices,
    fed_back: Array,
    is_free: Array,
    inputs: list[str],
    outputs: list[str],
    settings: SpectrumSettings,
) -> list[dict[str, Any]]:
    """Return the rows of all outputs and inputs in a band.

    ``fed_back`` (q,) and ``is_free`` (q, outputs) are as of `Feedback`.
    """
    S = spectra.cross[band].mean(axis=0)
    q = len(inputs)
    n_averages = spectra.n_windows * _independent_bins(len(band)) - q + 1
    frequency = 2 * np.pi * float(spectra.frequency[band].mean())
    rows = []
    for j, output in enumerate(outputs):
        noise = _noise(spectra, q + j, settings)
        for i, name in enumerate(inputs):
            response = _estimated_response(S, i, q + j, q, n_averages, fed_back[i])
            is_excited = _is_excited(response, noise, settings) and bool(is_free[i, j])
            names = {"output": output, "input": name, "frequency": frequency}
            rows.append(names | _columns(response) | {"excited": is_excited})
    return rows


def _estimated_response(
    S: Matrix, i: int, j: int, q: int, n_averages: float, fed_back: float
) -> _Response:
    """Return the response of channel j to input i, one of q, by the spectra S of a band.

    ``n_averages`` is n_d - q + 1, ``fed_back`` the fraction f of the power of the input.
    """
    H = _solved(S[:q, :q], S[:q, j])[i]
    conditioned = _conditioned(S, i, j, q)
    S_ii, S_yy = np.maximum(np.diag(conditioned).real, np.finfo(float).tiny)
    coherence = min(float(abs(conditioned[0, 1]) ** 2 / (S_ii * S_yy)), 1.0)
    error = np.inf
    if coherence > 0 and n_averages > 0:
        averaged = 1.0 / n_averages + fed_back
        error = float(np.sqrt((1.0 - coherence) / (2.0 * coherence) * averaged))
    return _Response(H, coherence, error, abs(H) ** 2 * S_ii)


def _is_excited(response: _Response, noise: float, settings: SpectrumSettings) -> bool:
    """Return whether coherence, error, and power over the noise of the output suffice."""
    is_sure = response.coherence >= settings.coherence and response.error <= settings.error
    return bool(is_sure and response.power > settings.excited * noise)


def _columns(response: _Response) -> dict[str, float]:
    """Return the columns of a response, in decibels and degrees."""
    return {
        "gain": _decibels(response.H),
        "phase": float(np.rad2deg(np.angle(response.H))),
        "gain_std": 20.0 / np.log(10.0) * response.error,
        "phase_std": float(np.rad2deg(response.error)),
        "coherence": response.coherence,
    }


def _conditioned(S: Array, i: int, j: int, q: int) -> Array:
    """Return the spectra (2, 2) of input i and channel j without what the other of q inputs explain."""
    pair = [i, j]
    others = [k for k in range(q) if k != i]
    spectra = S[np.ix_(pair, pair)]
    if not others:
        return spectra
    explained = _solved(S[np.ix_(others, others)], S[np.ix_(others, pair)])
    return spectra - S[np.ix_(pair, others)] @ explained


def _solved(S: Matrix, b: Array) -> Array:
    """Return S^-1 b; inputs that always move together share the response."""
    solution: Any = np.linalg.lstsq(S, b, rcond=RIDGE)[0]
    return solution


def _noise(spectra: Spectra, j: int, settings: SpectrumSettings) -> float:
    """Return the power of the noise of a channel, that of its highest frequencies."""
    n_highest = max(1, int(settings.noise * len(spectra.frequency)))
    return float(np.median(spectra.cross[-n_highest:, j, j].real))


def _independent_bins(m: int) -> float:
    """Return the number of independent averages of m neighbouring bins."""
    near, far = NEIGHBOURS
    return m**2 / (m + 2.0 * (m - 1) * near + 2.0 * max(m - 2, 0) * far)


def _decibels(H: Any) -> Any:
    return 20.0 * np.log10(np.maximum(np.abs(H), np.finfo(float).tiny))


def _of_model(linear: LinearModel, index: pd.Index) -> pd.DataFrame:
    """Return gain and phase of a linear model, with limits of its paths, at rows (output, input, frequency)."""
    w = np.unique(index.get_level_values("frequency"))
    s: Any = 1j * w
    outputs = linear.C.index.intersection(index.unique("output"))
    inputs = linear.B.columns.intersection(index.unique("input"))
    rows = linear.C.index.get_indexer(outputs)[:, None]
    columns = linear.B.columns.get_indexer(inputs)
    late = np.exp(-s[:, None, None] * linear.servo_delays[columns])
    H = transfer(linear.A, linear.B, linear.C, linear.D, linear.A.index, s)[:, rows, columns] * late
    responses = {"model_gain": _decibels(H), "model_phase": np.rad2deg(np.angle(H))}
    if linear.paths is not None:
        drawn = transfer(*linear.paths, linear.A.index, s)[..., rows, columns] * late
        turned = responses["model_phase"] + np.rad2deg(np.angle(drawn / H))
        for name, values in (("model_gain", _decibels(drawn)), ("model_phase", turned)):
            lower, upper = np.quantile(values, [0.025, 0.975], axis=0)
            responses |= {f"{name}_lower": lower, f"{name}_upper": upper}
    of_model = pd.MultiIndex.from_product(
        [w, outputs, inputs], names=["frequency", "output", "input"]
    )
    table = pd.DataFrame({name: values.ravel() for name, values in responses.items()}, of_model)
    return table.reorder_levels(["output", "input", "frequency"]).reindex(index)
