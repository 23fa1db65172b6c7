"""Sample paths of kernels: functions drawn from the prior, sums of waves with random frequencies."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

import numpy as np
from scipy.special import logsumexp, ndtri

from skdgp._compute.typing import Array, Indices, Matrix, Seed
from skdgp.kernels._base import MultiOutputKernel, Rescaled, Sum
from skdgp.kernels._convolved import ConvolvedGaussian, Filters
from skdgp.kernels._paths import PathBundle, RescaledPaths, Waves


def draw_waves(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> tuple[Waves, Indices]:
    r"""Return sample paths of a ConvolvedGaussian and the latent of each wave, (C,).

    There are F waves for each of S paths of every latent, A_i = 2 L_i^-2.

    The spectral density of h_i * x is the Gaussian N_i = N(0, L_i^-2), so samples are

    .. math:: w_i \sum_k \sqrt{\frac{N_i(\omega_k)}{F q(\omega_k)}}
              \big(g_k \cos \omega_k^T (s - \mu_i) + g'_k \sin \omega_k^T (s - \mu_i)\big),
              \quad g_k, g'_k \sim N(0, 1).

    These are the random features of Rahimi & Recht (2007) for several outputs at once. q is the
    mixture of the N_i of all c outputs of the latent. Frequencies are stratified over its
    components, so the weights are bounded (the balance heuristic of Veach & Guibas 1995). Every
    path has new frequencies, so paths have the moments of the prior for any number of
    frequencies, at least c. Those of functions of a single regressor are stratified in size too,
    so a quarter of them makes paths as Gaussian.
    """
    along = np.flatnonzero(~kernel.without_effect(kernel.n_features))
    if len(along) == 1:
        n_frequencies = n_frequencies // 4
    filters = kernel.filters.of_regressors(along)
    unit = np.eye(filters.feeds.shape[1])
    S = n_paths
    F = max(n_frequencies, int(filters.feeds.sum(axis=1).max()))
    omegas, phases, weights, latents = [], [], [], []
    for m, feeds in enumerate(filters.feeds):
        i = np.flatnonzero(feeds)
        amplitude = filters.amplitude[m, i]
        shift = filters.shift[m, i]
        lengths = filters.length_scale[m, i]
        component = np.arange(F) % len(i)
        omega = _frequencies(S, component, lengths, random_state)
        log_density = np.log(lengths).sum(axis=1) - 0.5 * omega**2 @ (lengths**2).T
        counts = np.bincount(component)
        log_mixture = logsumexp(log_density, axis=2, b=counts, keepdims=True)  # log(F q)
        gain = amplitude * np.exp(0.5 * (log_density - log_mixture))
        # the length of (g, g'); the phase is its direction
        gain *= random_state.rayleigh(size=(S, F, 1))
        # the phase of the first output, and differences of the others
        turn = omega @ shift.T
        phase = random_state.uniform(0.0, 2 * np.pi, (S, F)) - turn[..., 0]
        turn -= turn[..., :1].copy()
        omegas.append(omega)
        phases.append(phase)
        weights.append((gain * np.cos(turn)) @ unit[i])
        latents += [m] * F
        if turn.any():  # cos(a - turn) = cos(a) cos(turn) + sin(a) sin(turn)
            omegas.append(omega)
            phases.append(phase - 0.5 * np.pi)
            weights.append((gain * np.sin(turn)) @ unit[i])
            latents += [m] * F
    omega = np.concatenate(omegas, axis=1).swapaxes(1, 2).copy()
    phase = np.concatenate(phases, axis=1)[:, None]
    drawn = np.concatenate(weights, axis=1).swapaxes(1, 2).copy()
    return Waves(omega, phase, drawn, along), np.array(latents)


def draw_waves_of_one_width(
    kernel: ConvolvedGaussian, n_paths: int, n_frequencies: int, random_state: Any
) -> Waves:
    """Return sample paths of independent outputs whose filters have one width, with the frequencies of `draw_waves`.

    Outputs share F frequencies, and each has cosines and sines of its own normal weights. So each is
    distributed as with frequencies of its own, no two correlate, and P outputs need 2 F waves, not P F.
    """
    along = np.flatnonzero(~kernel.without_effect(kernel.n_features))
    filters = kernel.filters.of_regressors(along)
    amplitude = np.sum(filters.amplitude, axis=0, where=filters.feeds)
    width = filters.length_scale[filters.feeds][0]
    shape = (n_paths, n_frequencies)
    omega = random_state.standard_normal((*shape, len(along))) / width
    phase = random_state.uniform(0.0, 2 * np.pi, shape)
    normal = random_state.standard_normal((n_paths, len(amplitude), 2 * n_frequencies))
    return Waves(
        np.concatenate([omega, omega], axis=1).swapaxes(1, 2).copy(),
        np.concatenate([phase, phase - 0.5 * np.pi], axis=1)[:, None],
        amplitude[:, None] / np.sqrt(n_frequencies) * normal,
        along,
    )


def _has_one_width(filters: Filters) -> bool:
    """Return whether each latent feeds one output, each output is fed by one, and all widths are equal."""
    feeds = filters.feeds
    is_private = (feeds.sum(axis=0) == 1).all() and (feeds.sum(axis=1) == 1).all()
    widths = filters.length_scale[feeds]
    return bool(is_private and (widths == widths[0]).all())


def _frequencies(n_paths: int, component: Indices, lengths: Matrix, random_state: Any) -> Array:
    """Return frequencies (n_paths, F, k) of the ``component`` (F,) of filters with these lengths (c, k)."""
    if lengths.shape[1] == 1:
        normal = _stratified_normal(n_paths, component, random_state)
    else:
        normal = random_state.standard_normal((n_paths, len(component), lengths.shape[1]))
    return normal / lengths[component]


def _stratified_normal(n_paths: int, component: Indices, random_state: Any) -> Array:
    """Return absolute values of normal numbers, (n_paths, F, 1), stratified over each ``component`` (F,)."""
    place = np.empty(len(component))
    size = np.empty(len(component))
    for c in np.unique(component):
        of_component = component == c
        size[of_component] = of_component.sum()
        place[of_component] = np.arange(of_component.sum())
    above = size - place - random_state.uniform(size=(n_paths, len(component)))
    return -ndtri(0.5 * above / size)[..., None]


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
    for term in kernel.summands():
        original = term.kernel if isinstance(term, Rescaled) else term
        if prior_paths.dispatch(type(original)) is missing:
            return False
    return True


@prior_paths.register
def _(kernel: ConvolvedGaussian, n_paths, n_frequencies, random_state):
    filters = kernel.filters
    if _has_one_width(filters) and len(kernel.term_regressors()[0]) > 1:
        return draw_waves_of_one_width(kernel, n_paths, n_frequencies, random_state)
    waves, latent = draw_waves(kernel, n_paths, n_frequencies, random_state)
    return waves.of_outputs(filters.feeds, latent)


@prior_paths.register
def _(kernel: Rescaled, n_paths, n_frequencies, random_state):
    paths = prior_paths(kernel.kernel, n_paths, n_frequencies, random_state)
    return RescaledPaths(paths, np.asarray(kernel.factor))


@prior_paths.register
def _(kernel: Sum, n_paths, n_frequencies, random_state):
    first = prior_paths(kernel.k1, n_paths, n_frequencies, random_state)
    return first + prior_paths(kernel.k2, n_paths, n_frequencies, random_state)
