"""Sample paths of kernels: functions drawn from the prior, sums of waves with random frequencies."""

from __future__ import annotations

from functools import singledispatch

import numpy as np
from scipy.special import logsumexp

from skdgp._compute.typing import Array, Indices, Matrix, Seed
from skdgp.kernels._base import MultiOutputKernel, Sum
from skdgp.kernels._convolved import ConvolvedGaussian
from skdgp.kernels._paths import PathBundle, Waves


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


@prior_paths.register
def _(kernel: ConvolvedGaussian, n_paths, n_frequencies, random_state):
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
    omegas = []
    phases = []
    all_gains = []
    for m, feeds in enumerate(filters.feeds):
        i = np.flatnonzero(feeds)
        lengths = filters.length_scale[m, i]
        component = np.arange(F) % len(i)
        normal = random_state.standard_normal((n_paths, F, lengths.shape[1]))
        omega = normal / lengths[component]
        # (g, g') in polar coordinates: its length, and its direction, the phase
        length = random_state.rayleigh(size=(n_paths, F, 1))
        phase = random_state.uniform(high=2 * np.pi, size=(n_paths, F))
        roots = _importance_gains(omega, lengths, np.bincount(component))
        gains = np.zeros((n_paths, F, len(feeds)))
        gains[..., i] = filters.amplitude[m, i] * roots * length
        # with a = omega^T (s - mu_1) + phi and b_i = omega^T (mu_i - mu_1) the waves are
        # cos(a - b_i) = cos b_i cos a + sin b_i cos(a - pi / 2), which all outputs share
        delay = omega @ filters.shift[m].T
        phase -= delay[..., i[0]]
        delay -= delay[..., i[:1]].copy()
        waves = [(phase, np.cos(delay))]
        if delay.any():  # no sines without shifts
            waves.append((phase - np.pi / 2, np.sin(delay)))
        for of_wave, part in waves:
            omegas.append(omega)
            phases.append(of_wave)
            all_gains.append(gains * part)
    return Waves(
        np.concatenate(omegas, axis=1).swapaxes(1, 2).copy(),
        np.concatenate(phases, axis=1)[:, None],
        np.concatenate(all_gains, axis=1).swapaxes(1, 2).copy(),
    )


def _importance_gains(omega: Array, lengths: Matrix, counts: Indices) -> Array:
    r"""Return :math:`\sqrt{N_i / (F q)}` at frequencies (n_paths, F, k), (n_paths, F, c).

    ``counts`` (c,) of the frequencies were drawn from the densities N_i with widths (c, k).
    """
    log_density = np.log(lengths).sum(axis=1) - 0.5 * omega**2 @ (lengths**2).T
    log_mixture = logsumexp(log_density, axis=2, b=counts, keepdims=True)  # log(F q)
    return np.exp(0.5 * (log_density - log_mixture))


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)
