"""Where the stages of a search start: simpler kernels to fit first, and the values that a stage hands on to the next.

The kernel of a search has missing values. ``initialize`` estimates them from the data, and the
functions here replace these estimates by values of earlier stages. Given values do not change.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from sklearn.base import clone

from skdgp._compute.linalg import column_scale
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.kernels import ConvolvedGaussian, LinearTrend, MultiOutputKernel, Sum, tied


@dataclass(frozen=True)
class StartSettings:
    """Values that a stage of the search starts from."""

    #: Fraction of its starting amplitude below which an output was explained as noise
    noise_amplitude: float = 0.1
    #: Largest width of a start beside shared latents, in standard deviations of the regressor: from
    #: wider ones, where the likelihood is flat, a search does not come back
    widest: float = 10.0
    #: Ratios of the widths of the latents of one output, each of another start: equal ones are one process, a
    #: saddle. On six of eight splits of four tables the likelihood ends 3 to 26 nats higher from 4, on two 22
    #: and 4 nats from 2
    apart: tuple[float, ...] = (2.0, 4.0)


SETTINGS = StartSettings()


def starting_kernel(
    kernel: MultiOutputKernel,
    X: Matrix,
    Y: Matrix,
    singles: Sequence[MultiOutputKernel] | None = None,
    apart: float = 1.0,
) -> MultiOutputKernel:
    """Return the kernel with missing values from the data, or from fits of each output alone.

    Parameters
    ----------
    kernel : MultiOutputKernel
        With missing values.
    X : ndarray (n, d)
    Y : ndarray (n, P)
        NaN where an output was not observed.
    singles : sequence of MultiOutputKernel or None
        Fits of ``single_output(kernel)``.
    apart : float
        Ratio of the widths of one latent and the next, of these fits.

    Returns
    -------
    MultiOutputKernel
    """
    start = kernel.initialize(X, Y, np.random.RandomState(0))
    if singles is None:
        return start
    return _of_terms(partial(_from_singles, X, apart), kernel, start, *singles)


def single_output(kernel: MultiOutputKernel) -> MultiOutputKernel | None:
    """Return a kernel without values for a separate fit of one output; None: outputs are fitted jointly alone."""
    if not all(isinstance(term, (ConvolvedGaussian, LinearTrend)) for term in kernel.summands()):
        return None
    return _of_terms(_single_output, kernel)


def from_simpler(start: MultiOutputKernel, fitted: MultiOutputKernel) -> MultiOutputKernel:
    """Return a start with the values of a fitted kernel that it contains."""
    return _of_terms(_from_simpler, start, fitted)


def narrowed(
    kernel: MultiOutputKernel, start: MultiOutputKernel, factor: float
) -> MultiOutputKernel:
    """Return a start whose estimated widths are multiplied by a factor."""
    return _of_terms(partial(_narrowed, factor), kernel, start)


def redrawn(
    start: MultiOutputKernel, noise_bounds: Matrix, random_state: np.random.RandomState
) -> tuple[MultiOutputKernel, Vector]:
    """Return a kernel and noise (P,) drawn within their bounds, as scikit-learn's restarts.

    Logarithms are uniform. Signed values, whose bounds are wide, are normal with their starting
    size.
    """
    theta = start.theta
    is_log = np.concatenate([np.full(f.n_elements, f.log) for f in start.free_parameters()])
    uniform = random_state.uniform(*start.bounds.T)
    normal = np.clip(theta * random_state.standard_normal(len(theta)), *start.bounds.T)
    noise = np.exp(random_state.uniform(*np.log(noise_bounds).T))
    return start.clone_with_theta(np.where(is_log, uniform, normal)), noise


# -- terms of a sum


def _of_terms(function: Callable, kernel: MultiOutputKernel, *others: Any) -> MultiOutputKernel:
    """Return the sum of a function of each term of a kernel, and of the terms of others of the same shape."""
    if not isinstance(kernel, Sum):
        return function(kernel, *others)
    first = _of_terms(function, kernel.k1, *(other.k1 for other in others))
    return Sum(first, _of_terms(function, kernel.k2, *(other.k2 for other in others)))


def _with_missing(term, start, values: Mapping[str, Array]):
    """Return a start with values for the parameters that a term lacks."""
    parameters = term.get_params(deep=False)
    missing = {name: value for name, value in values.items() if parameters[name] is None}
    return clone(start).set_params(**missing)


def _single_output(term):
    if isinstance(term, LinearTrend):
        return LinearTrend()
    bounds: Any = (term.parameter_bounds or {}).get("length_scale")
    if np.ndim(bounds) in (1, 2):  # of all filters
        return ConvolvedGaussian(0, parameter_bounds={"length_scale": bounds})
    return ConvolvedGaussian(0)


def _narrowed(factor, term, start):
    if not isinstance(term, ConvolvedGaussian):
        return start
    return _with_missing(term, start, {"length_scale": factor * start.filters.length_scale})


def _from_simpler(term, fitted):
    values = fitted.values()
    return clone(term).set_params(**{name: values[name] for name in term.needed})


def _from_singles(X, apart, term, start, *singles):
    if isinstance(term, ConvolvedGaussian):
        return _filters_from_singles(X, apart, term, start, singles)
    if start.n_features > len(X):  # one prior scale of all slopes, which is not learned
        return start
    intercept = np.concatenate([single.value("intercept_scale") for single in singles])
    slope = np.concatenate([single.value("slope_scale") for single in singles])
    return _with_missing(term, start, {"intercept_scale": intercept, "slope_scale": slope})


def _filters_from_singles(X, apart, term, start, singles):
    """Return the start of filters from separate fits of each output.

    Private latents take the fitted widths. A shared latent takes their weighted geometric mean for
    all outputs, because equal widths allow the strongest coupling; with very different widths no
    coupling can be learned. An output that its separate fit explains as noise keeps its default
    values: at zero amplitude the gradient is zero and a dependence on other outputs cannot be found.
    """
    filters = start.filters
    w = filters.amplitude
    fits = [single.filters for single in singles]
    fitted = np.array([abs(fit.amplitude[0, 0]) for fit in fits])
    total = np.sqrt(np.sum(w**2, axis=0))
    explained = fitted > SETTINGS.noise_amplitude * total
    amplitude = w * np.where(explained, fitted / total, 1.0)

    widths = np.stack([fit.length_scale[0, 0] for fit in fits])
    widths = np.where(explained[:, None], widths, filters.length_scale[-1])
    weight = w**2 / np.sum(w**2, axis=1, keepdims=True)
    private = (weight == 1.0)[..., None]
    mean = np.exp(weight @ np.log(widths))[:, None, :]
    place = np.arange(len(w)) - 0.5 * (len(w) - 1)
    lengths = np.where(private, widths, mean) * apart ** place[:, None, None]
    is_shared = not private.any(axis=1).all()
    if is_shared and (term.parameter_bounds or {}).get("length_scale") is None:
        lengths = np.minimum(lengths, SETTINGS.widest * column_scale(X))
    if term.covariance_type == "tied":
        lengths = tied(lengths)
    return _with_missing(term, start, {"amplitude": amplitude, "length_scale": lengths})
