"""Prior samples as sums of waves with random frequencies."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.special import logsumexp

from skdgp.kernels._paths import PathBundle


class LatentWaves(NamedTuple):
    """What a latent contributes to the outputs that feel it: sums of gain * cos(omega . (s - shift) + phase).

    ``omega`` (S, F, d), ``phase`` (S, F), ``outputs`` (c,), and of these ``gain`` (S, F, c), ``shift`` (c, d).
    """

    omega: np.ndarray
    phase: np.ndarray
    outputs: np.ndarray
    gain: np.ndarray
    shift: np.ndarray

    @classmethod
    def draw(cls, outputs, roots, amplitude, shift, n_paths, n_frequencies, random_state) -> LatentWaves:
        r"""Draw what one latent contributes to convolved Gaussians, h_i * x with A_i = 2 R_i R_i^T.

        The spectral density of h_i * x is the Gaussian N_i = N(0, R_i R_i^T), so samples are

        .. math:: w_i \sum_k \sqrt{\frac{N_i(\omega_k)}{F q(\omega_k)}}
                  \big(g_k \cos \omega_k^T (s - \mu_i) + g'_k \sin \omega_k^T (s - \mu_i)\big),
                  \quad g_k, g'_k \sim N(0, 1).

        These are the random features of Rahimi & Recht (2007) for several outputs at once. q is the mixture of the N_i
        of all outputs that feel the latent, and frequencies are stratified over its components: each output has waves
        of its own, and weights are bounded (the balance heuristic of Veach & Guibas 1995). Frequencies are drawn anew
        for every path, so that moments over paths are those of the prior, however few they are.

        Parameters
        ----------
        outputs : ndarray (c,)
        roots : ndarray (c, d, d)
            R.
        amplitude : ndarray (c,)
            w.
        shift : ndarray (c, d)
            mu.
        n_paths, n_frequencies : int
            S, and F: at least c.
        random_state : RandomState
        """
        S, F, (c, d) = n_paths, n_frequencies, shift.shape
        component = np.arange(F) % c
        omega = (roots[component] @ random_state.standard_normal((S, F, d, 1)))[..., 0]
        white = np.tensordot(omega, np.linalg.inv(roots), axes=(2, 2))
        log_density = -0.5 * np.einsum("sfck,sfck->sfc", white, white) - np.linalg.slogdet(roots)[1]
        log_mixture = logsumexp(log_density, axis=2, b=np.bincount(component), keepdims=True)  # log(F q)
        gain = amplitude * np.exp(0.5 * (log_density - log_mixture))
        gain *= random_state.rayleigh(size=(S, F, 1))  # the length of (g, g'), whose direction is uniform
        return cls(omega, random_state.uniform(0.0, 2 * np.pi, (S, F)), outputs, gain, shift)

    def at_origin(self, chosen) -> tuple[np.ndarray, np.ndarray]:
        """Return the phase at the shift of the first of the chosen outputs, (S, F), and how the others turn it."""
        turn = self.omega @ self.shift[chosen].T
        return self.phase - turn[..., 0], turn - turn[..., :1]


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
    def of(cls, latents: list[LatentWaves], outputs) -> Waves:
        """Return the paths of some of the outputs, (P,)."""
        (S, F), P = latents[0].phase.shape, len(outputs)
        shared, own, fed = [], [], []
        for latent in latents:
            place, chosen = np.nonzero(np.equal.outer(outputs, latent.outputs))
            if len(place) == 0:
                continue
            phase, turn = latent.at_origin(chosen)
            gain = latent.gain[..., chosen]
            if len(place) == 1:
                own.append((latent.omega, phase, gain))
                fed.append(np.eye(P)[place[0]])
                continue
            unit = np.eye(P)[place]
            shared.append((latent.omega, phase, (gain * np.cos(turn)) @ unit))
            if turn.any():  # cos(a - turn) = cos(a) cos(turn) + sin(a) sin(turn)
                shared.append((latent.omega, phase - 0.5 * np.pi, (gain * np.sin(turn)) @ unit))
        omega, phase, _ = zip(*shared, *own, strict=True)
        alone = np.concatenate([np.empty((S, F, 0)), *(weight for *_, weight in own)], axis=2)
        return cls(
            np.concatenate(omega, axis=1).swapaxes(1, 2).copy(),
            np.concatenate(phase, axis=1)[:, None],
            np.concatenate([np.empty((S, 0, P)), *(weight for *_, weight in shared)], axis=1),
            alone.swapaxes(1, 2)[:, None].copy(),
            np.reshape(fed, (-1, P)),
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


def draw_latents(kernel, n_paths, n_frequencies, random_state) -> list[LatentWaves]:
    """Return the waves of every latent of a ConvolvedGaussian; as many as a latent has outputs, at least."""
    w, mu, feeds = (kernel._value(name) for name in ("amplitude", "shift", "feeds"))
    lengths = kernel._value("length_scale")
    roots = kernel._roots() if kernel.covariance_type == "full" else np.eye(mu.shape[2]) / lengths[..., None]
    n_frequencies = max(n_frequencies, int(feeds.sum(axis=1).max()))
    return [
        LatentWaves.draw(felt, roots[m, felt], w[m, felt], mu[m, felt], n_paths, n_frequencies, random_state)
        for m, felt in enumerate(map(np.flatnonzero, feeds))
    ]


def convolved_paths(kernel, n_paths, n_frequencies, random_state) -> Waves:
    """Return paths of all outputs of a ConvolvedGaussian."""
    return Waves.of(draw_latents(kernel, n_paths, n_frequencies, random_state), range(kernel.n_outputs))


def joint_paths(joint, Z, jitter, n_paths, n_frequencies, random_state) -> tuple[Waves, np.ndarray]:
    """Return paths of a ConvolvedGaussian's first outputs, and values (S, K) of its last ones at Z, a list of (k, d).

    ``jitter`` is the variance of white noise in these.
    """
    latents = draw_latents(joint, n_paths, n_frequencies, random_state)
    P = joint.n_outputs - len(Z)
    u = np.concatenate([Waves.of(latents, [P + f]).values(z[None])[..., 0] for f, z in enumerate(Z)], axis=1)
    u += np.sqrt(jitter) * random_state.standard_normal(u.shape)
    return Waves.of(latents, range(P)), u
