"""Sample paths of kernels: functions drawn from the prior, sums of waves with random frequencies."""

from __future__ import annotations

from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from scipy.special import logsumexp

from skdgp._compute.typing import Array, Indices, Matrix, Seed
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian, Filters
from skdgp.kernels._paths import PathBundle, Waves


def draw_waves(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> Waves:
    r"""Return sample paths of a ConvolvedGaussian.

    There are F waves for each of S paths of every latent. With the amplitude w_i, the width L_i and
    the shift mu_i of the filter to output i, the spectral density of h_i * x is the Gaussian
    N_i = N(0, L_i^-2), so samples are

    .. math:: w_i \sum_k \sqrt{\frac{N_i(\omega_k)}{F q(\omega_k)}}
              \big(g_k \cos \omega_k^T (s - \mu_i) + g'_k \sin \omega_k^T (s - \mu_i)\big),
              \quad g_k, g'_k \sim N(0, 1).

    These are the random features of Rahimi & Recht (2007) for several outputs at once. q is the
    mixture of the N_i of all c outputs of the latent. Frequencies are stratified over its
    components, so the roots are bounded (the balance heuristic of Veach & Guibas 1995). Every
    path has new frequencies, so paths have the moments of the prior for any number of
    frequencies, at least c.
    """
    filters = kernel.filters
    F = max(n_frequencies, int(filters.feeds.sum(axis=1).max()))
    drawn: list[_LatentWaves] = []
    for m in range(len(filters.feeds)):
        drawn += _latent_waves(filters, m, n_paths, F, random_state)
    omega = np.concatenate([waves.omega for waves in drawn], axis=1)
    phase = np.concatenate([waves.phase for waves in drawn], axis=1)
    gains = np.concatenate([waves.gains for waves in drawn], axis=1)
    return Waves(omega.swapaxes(1, 2).copy(), phase[:, None], gains.swapaxes(1, 2).copy())


class _LatentWaves(NamedTuple):
    """Waves gain_i cos(omega^T s + phase) of a latent in c outputs i."""

    omega: Array  #: (n_paths, F, k)
    phase: Array  #: (n_paths, F)
    gains: Array  #: (n_paths, F, c)

    def scattered(self, outputs: Indices, n_outputs: int) -> _LatentWaves:
        """Return the waves in all outputs, without those that the latent does not feed."""
        gains = np.zeros((*self.phase.shape, n_outputs))
        gains[..., outputs] = self.gains
        return self._replace(gains=gains)


def _latent_waves(
    filters: Filters, m: int, n_paths: int, n_frequencies: int, random_state: Any
) -> list[_LatentWaves]:
    """Return the waves of latent m in all outputs; with shifts these are cosines and sines."""
    feeds = filters.feeds[m]
    i = np.flatnonzero(feeds)
    amplitude = filters.amplitude[m, i]
    lengths = filters.length_scale[m, i]
    component = np.arange(n_frequencies) % len(i)
    normal = random_state.standard_normal((n_paths, n_frequencies, lengths.shape[1]))
    omega = normal / lengths[component]
    gains = amplitude * _importance_gains(omega, lengths, np.bincount(component))
    # (g, g') in polar coordinates: its length, and its direction, the phase
    gains *= random_state.rayleigh(size=(n_paths, n_frequencies, 1))
    phase = random_state.uniform(0.0, 2 * np.pi, (n_paths, n_frequencies))
    waves = _delayed_waves(omega, phase, gains, filters.shift[m, i])
    return [wave.scattered(i, len(feeds)) for wave in waves]


def _importance_gains(omega: Array, lengths: Matrix, counts: Indices) -> Array:
    r"""Return :math:`\sqrt{N_i / (F q)}` at frequencies (n_paths, F, k), (n_paths, F, c).

    ``counts`` (c,) of the frequencies were drawn from the densities N_i with widths (c, k).
    """
    log_density = np.log(lengths).sum(axis=1) - 0.5 * omega**2 @ (lengths**2).T
    log_mixture = logsumexp(log_density, axis=2, b=counts, keepdims=True)  # log(F q)
    return np.exp(0.5 * (log_density - log_mixture))


def _delayed_waves(omega: Array, phase: Array, gains: Array, shift: Matrix) -> list[_LatentWaves]:
    r"""Return the waves :math:`\cos(\omega^T (s - \mu_i) + \phi)` of c outputs with shifts (c, k).

    With :math:`a = \omega^T (s - \mu_1) + \phi` and :math:`b_i = \omega^T (\mu_i - \mu_1)` they are
    :math:`\cos(a - b_i) = \cos b_i \cos a + \sin b_i \cos(a - \pi / 2)`: a cosine and a sine, which
    all outputs share; without shifts a cosine.
    """
    delay = omega @ shift.T
    phase = phase - delay[..., 0]
    delay -= delay[..., :1].copy()
    cosine = _LatentWaves(omega, phase, gains * np.cos(delay))
    if not delay.any():
        return [cosine]
    sine = _LatentWaves(omega, phase - 0.5 * np.pi, gains * np.sin(delay))
    return [cosine, sine]


def draw_waves_of_one_width(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> Waves:
    """Return sample paths of independent outputs whose filters have one width, with the frequencies of `draw_waves`.

    Outputs share F frequencies, and each has cosines and sines of its own normal weights. So each is
    distributed as with frequencies of its own, no two correlate, and P outputs need 2 F waves, not P F.
    """
    filters = kernel.filters
    amplitude = np.sum(filters.amplitude, axis=0, where=filters.feeds)
    width = filters.length_scale[filters.feeds][0]
    shape = (n_paths, n_frequencies)
    omega = random_state.standard_normal((*shape, len(width))) / width
    phase = random_state.uniform(0.0, 2 * np.pi, shape)
    normal = random_state.standard_normal((n_paths, len(amplitude), 2 * n_frequencies))
    return Waves(
        np.concatenate([omega, omega], axis=1).swapaxes(1, 2).copy(),
        np.concatenate([phase, phase - 0.5 * np.pi], axis=1)[:, None],
        amplitude[:, None] / np.sqrt(n_frequencies) * normal,
    )


def _has_one_width(filters: Filters) -> bool:
    """Return whether each latent feeds one output, each output is fed by one, and all widths are equal."""
    feeds = filters.feeds
    is_private = (feeds.sum(axis=0) == 1).all() and (feeds.sum(axis=1) == 1).all()
    widths = filters.length_scale[feeds]
    return bool(is_private and (widths == widths[0]).all())


# -- paths of a kernel
# ---------------------------------------------------------------------------------------------------


@singledispatch
def prior_paths(
    kernel: MultiOutputKernel, n_paths: int, n_frequencies: int, random_state: Seed
) -> PathBundle:
    """Return sample paths of the prior.

    ``prior_paths.register`` adds a class of kernels. Raises NotImplementedError for others.

    Parameters
    ----------
    kernel : MultiOutputKernel
    n_paths : int
    n_frequencies : int
        Number of waves for each latent process.
    random_state : RandomState

    Returns
    -------
    PathBundle
    """
    raise NotImplementedError(
        f"Got a {type(kernel).__name__}, but expected a kernel with sample paths. "
        "Use sample_y, or register paths of this class with skdgp.kernels.prior_paths."
    )


def has_prior_paths(kernel: MultiOutputKernel) -> bool:
    """Return whether sample paths are registered for the class of every term of a kernel."""
    missing = prior_paths.dispatch(object)
    return all(prior_paths.dispatch(type(term)) is not missing for term in kernel.summands())


@prior_paths.register
def _(kernel: ConvolvedGaussian, n_paths, n_frequencies, random_state):
    if _has_one_width(kernel.filters):
        return draw_waves_of_one_width(kernel, n_paths, n_frequencies, random_state)
    return draw_waves(kernel, n_paths, n_frequencies, random_state)


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)
