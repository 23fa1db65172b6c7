"""Samples of convolved Gaussians that are functions: sums of waves with random frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from skdgp.kernels._paths import PathBundle


class Spectrum(NamedTuple):
    """Waves gain * cos(omega . (s - shift) + phase) of M latents, F each, that S paths of P outputs consist of.

    ``omega`` (S, M, F, d), ``phase`` (S, M, F), ``gain`` (S, M, F, P), ``shift`` (M, P, d), and ``feeds`` (M, P) of
    bool, which latent is felt by which output.
    """

    omega: np.ndarray
    phase: np.ndarray
    gain: np.ndarray
    shift: np.ndarray
    feeds: np.ndarray


def draw_spectrum(roots, amplitude, shift, feeds, n_paths, n_frequencies, random_state) -> Spectrum:
    r"""Draw the waves of convolved Gaussians, f_i = sum_m h_mi * x_m with A_mi = 2 R_mi R_mi^T.

    The spectral density of h_mi is the Gaussian N_mi = N(0, R_mi R_mi^T), and what a latent contributes is

    .. math:: w_{mi} \sum_k \sqrt{\frac{N_{mi}(\omega_k)}{F q_m(\omega_k)}}
              \big(g_k \cos \omega_k^T (s - \mu_{mi}) + g'_k \sin \omega_k^T (s - \mu_{mi})\big),
              \quad g_k, g'_k \sim N(0, 1).

    q_m is the mixture of the N_mi of all outputs that feel the latent, which gives every output waves of its own and
    keeps weights bounded (the balance heuristic of Veach & Guibas 1995); frequencies are stratified over its
    components, and drawn anew for every path, so that moments over paths are those of the prior whatever F is (the
    waves of Rahimi & Recht 2007, with several spectra at once).

    Parameters
    ----------
    roots : ndarray (M, P, d, d)
        R.
    amplitude : ndarray (M, P)
        w.
    shift : ndarray (M, P, d)
        mu.
    feeds : ndarray (M, P) of bool
    n_paths, n_frequencies : int
        S, and F: raised to the number of outputs, where a latent has more.
    random_state : RandomState
    """
    M, P, d = shift.shape
    F = max(n_frequencies, int(feeds.sum(axis=1).max()))
    omega, gain = np.empty((n_paths, M, F, d)), np.zeros((n_paths, M, F, P))
    for m, felt in enumerate(map(np.flatnonzero, feeds)):
        component = np.arange(F) % len(felt)
        white = random_state.standard_normal((n_paths, F, d, 1))
        omega[:, m] = (roots[m, felt[component]] @ white)[..., 0]
        log_density = _log_density(omega[:, m], roots[m, felt])
        share = np.bincount(component) / F
        log_mixture = logsumexp(log_density, axis=-1, b=share, keepdims=True)
        gain[:, m][..., felt] = amplitude[m, felt] * np.exp(0.5 * (log_density - log_mixture))
    gain *= random_state.rayleigh(size=(n_paths, M, F, 1)) / np.sqrt(F)  # of g and g', with a uniform phase
    return Spectrum(omega, random_state.uniform(0.0, 2 * np.pi, (n_paths, M, F)), gain, shift, feeds)


def _log_density(omega, roots):
    """Return log N(omega; 0, R R^T) but for a constant, (S, F, c), for omega (S, F, d) and roots (c, d, d)."""
    white = np.tensordot(omega, np.linalg.inv(roots), axes=(2, 2))
    return -0.5 * np.einsum("sfck,sfck->sfc", white, white) - np.linalg.slogdet(roots)[1]


class Waves(PathBundle):
    """Sums of waves: one cosine of each serves all outputs that feel its latent.

    Waves of latents that several outputs feel come first, in one product with their weights; latents that one output
    feels alone (private ones) are summed apart, so that no zeros are multiplied.

    Parameters
    ----------
    omega : ndarray (S, d, C)
    phase : ndarray (S, 1, C)
    shared : ndarray (S, c, P)
        Weights of the first c waves.
    own : ndarray (S, 1, m, F)
        Weights of the other m F.
    fed : ndarray (m, P)
        One where the output is the one that feels the latent.
    """

    def __init__(self, omega, phase, shared, own, fed):
        self.omega, self.phase, self.shared, self.own, self.fed = omega, phase, shared, own, fed

    @classmethod
    def of(cls, spectrum: Spectrum, outputs) -> Waves:
        """Return the paths of some of the outputs."""
        omega, phase, gain, shift, feeds = spectrum
        gain, shift, feeds = gain[..., outputs], shift[:, outputs], feeds[:, outputs]
        origin = shift[np.arange(len(feeds)), feeds.argmax(axis=1)]  # of the first output that feels the latent
        phase = phase - np.einsum("smfk,mk->smf", omega, origin)
        turn = np.einsum("smfk,mpk->smfp", omega, (shift - origin[:, None]) * feeds[..., None])
        many, one = feeds.sum(axis=1) > 1, feeds.sum(axis=1) == 1
        parts = [(omega[:, many], phase[:, many])]
        shared = [(gain * np.cos(turn))[:, many]]
        if turn[:, many].any():  # cos(a - turn) = cos(a) cos(turn) + sin(a) sin(turn)
            parts.append((omega[:, many], phase[:, many] - 0.5 * np.pi))
            shared.append((gain * np.sin(turn))[:, many])
        parts.append((omega[:, one], phase[:, one]))
        S, d, P = len(omega), omega.shape[-1], len(outputs)
        return cls(
            np.concatenate([w.reshape(S, -1, d) for w, _ in parts], axis=1).swapaxes(1, 2).copy(),
            np.concatenate([p.reshape(S, 1, -1) for _, p in parts], axis=2),
            np.concatenate([g.reshape(S, -1, P) for g in shared], axis=1),
            gain[:, one].sum(axis=-1)[:, None],
            feeds[one].astype(float),
        )

    def take(self, some):
        return Waves(self.omega[some], self.phase[some], self.shared[some], self.own[some], self.fed)

    def doubles(self, alike):
        return len(self.omega) * self.omega.shape[2]

    def each(self, X):
        half = (0.5 * X) @ self.omega
        half += 0.5 * self.phase
        wave, c = _cosine_of_twice(half), self.shared.shape[1]
        values = wave[..., :c] @ self.shared
        values += np.einsum("snmf,slmf->snm", self._own(wave), self.own) @ self.fed
        return values

    def gradient(self, X):
        wave = -np.sin(X @ self.omega + self.phase)
        c, (S, d, _) = self.shared.shape[1], self.omega.shape
        shared = wave[:, :, None, :c] * self.shared.swapaxes(1, 2)[:, None]
        slopes = shared @ self.omega[:, None, :, :c].swapaxes(2, 3)
        alone = (self._own(wave) * self.own)[..., None, :]
        omega = self.omega[:, :, c:].reshape(S, 1, d, *self.own.shape[2:]).transpose(0, 1, 3, 4, 2)
        slopes += np.einsum("snmk,mp->snpk", (alone @ omega)[..., 0, :], self.fed)
        return slopes

    def _own(self, wave):
        return wave[..., self.shared.shape[1] :].reshape(*wave.shape[:2], *self.own.shape[2:])


def _cosine_of_twice(half):
    """Return cos(2 half), and overwrite ``half``: NumPy's tangent is vectorised, its cosine takes ten times as long."""
    square = np.tan(half, out=half)
    square *= square
    square += 1.0
    cosine = np.divide(2.0, square, out=square)
    cosine -= 1.0
    return cosine


def convolved_spectrum(kernel, n_paths, n_frequencies, random_state) -> Spectrum:
    """Return the waves of all outputs of a ConvolvedGaussian."""
    names = ("amplitude", "shift", "feeds", "length_scale")
    amplitude, shift, feeds, lengths = (kernel._value(name) for name in names)
    roots = kernel._roots() if kernel.covariance_type == "full" else np.eye(shift.shape[2]) / lengths[..., None]
    return draw_spectrum(roots, amplitude, shift, feeds.astype(bool), n_paths, n_frequencies, random_state)


def convolved_paths(kernel, n_paths, n_frequencies, random_state) -> Waves:
    """Return paths of all outputs of a ConvolvedGaussian."""
    spectrum = convolved_spectrum(kernel, n_paths, n_frequencies, random_state)
    return Waves.of(spectrum, list(range(kernel.n_outputs)))


def joint_paths(joint, Z, jitter, n_paths, n_frequencies, random_state) -> tuple[Waves, np.ndarray]:
    """Return paths of a ConvolvedGaussian's first outputs, and values (S, K) of its last ones at Z, a list of (k, d).

    ``jitter`` is the variance of white noise in these.
    """
    spectrum = convolved_spectrum(joint, n_paths, n_frequencies, random_state)
    P = joint.n_outputs - len(Z)
    last = [Waves.of(spectrum, [P + f]).values(np.asarray(z)[None])[..., 0] for f, z in enumerate(Z)]
    u = np.concatenate(last, axis=1)
    u += np.sqrt(jitter) * random_state.standard_normal(u.shape)
    return Waves.of(spectrum, list(range(P))), u
