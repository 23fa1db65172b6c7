"""Cross spectra of channels by Welch's method.

Windows by Hann overlap by half and lose their trends. They are counted from either end of a record,
so that no sample is left over.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.signal import stft
from scipy.signal.windows import hann

from skdgp._compute.typing import Array, Vector


def cross_spectra(records: Sequence[Array], step: float, size: int) -> tuple[Vector, Array, int]:
    """Return frequencies [Hz] (m,), one-sided densities (m, c, c) and the number of their windows.

    Parameters
    ----------
    records : sequence of ndarray (c, n)
        Channels at even steps; those shorter than a window are left out.
    step : float
        Of the samples [s].
    size : int
        Samples of a window.

    Returns
    -------
    frequency, density, n_windows
        The density S_ij is the mean of x_i conj(x_j).
    """
    options: Any = {"fs": 1.0 / step, "window": hann(size), "nperseg": size, "scaling": "psd"}
    options |= {"detrend": "linear", "boundary": None, "padded": False}
    total: Any = 0.0
    n_windows = 0
    for record in records:
        n_left_over = (record.shape[1] - size) % (size - size // 2)
        for part in (record, record[:, n_left_over:]):
            if part.shape[1] >= size:
                frequency, _, waves = stft(part, **options)
                total = total + np.einsum("ift,jft->fij", waves, waves.conj())
                n_windows += waves.shape[-1]
    density = 2.0 * total / n_windows
    # there is no wave of negative frequency beside these
    density[0] /= 2.0
    if size % 2 == 0:
        density[-1] /= 2.0
    return frequency, density, n_windows
