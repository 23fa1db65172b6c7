"""The convolved Gaussian kernel: outputs as filtered white noise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from sklearn.utils import check_random_state

from skdgp._compute.linalg import column_scale, constant_columns, output_scale
from skdgp._compute.parallel import thread_map
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Seed, Vector
from skdgp.kernels._base import (
    EstimatedKernel,
    EvaluatedBlock,
    FreeParameter,
    InputPair,
    MultiOutputKernel,
    as_shape,
    numbered,
)
from skdgp.kernels._gaussian_filters import EvaluatedPair, FilterPair

COVARIANCE_TYPES = ("diag", "tied")
ROUNDING = 1e-9  # relative difference of tied length scales that counts as rounding


@dataclass(frozen=True)
class StartSettings:
    """Starting values and bounds of filters that are estimated from data.

    Amplitudes are over the scale of their output, widths over the standard deviation of the
    regressor.
    """

    #: Largest amplitude
    largest_amplitude: float = 30.0
    #: Smallest amplitude of a private latent beside shared ones where targets are missing: without
    #: it a few rows where outputs overlap may make one output certain from another (trials)
    least_private: float = 0.2
    #: Smallest and largest width
    width_bounds: tuple[float, float] = (0.05, 1e3)
    #: Starting widths of the first and of the last shared latent, for one regressor
    shared_widths: tuple[float, float] = (2.0, 0.8)
    #: Starting width of the private latents, for one regressor
    private_width: float = 1.2


STARTS = StartSettings()
# Smallest variance of a starting direction, and its perturbation: away from zero, where the gradient
# is zero (guess)
SCATTER = 0.05


class Filters(NamedTuple):
    """Parameters of all filters, (M, P, ...), and the latents (M, P) that feed an output."""

    feeds: Mask
    amplitude: Matrix
    length_scale: Array
    shift: Array

    def latents(self, i: int, j: int) -> Indices:
        """Return the numbers of the latents that feed both outputs."""
        return np.flatnonzero(self.feeds[:, i] & self.feeds[:, j])

    def pair(self, i: int, j: int) -> FilterPair:
        """Return equation 16 of outputs i and j."""
        latents = self.latents(i, j)
        outputs = np.array([[i], [j]])
        shift = self.shift[latents, i] - self.shift[latents, j]
        return FilterPair(
            self.amplitude[latents, outputs], self.length_scale[latents, outputs], shift
        )


class ConvolvedGaussian(EstimatedKernel):
    r"""Covariance of dependent outputs: each output is a sum of latent white-noise processes with Gaussian filters.

    The filter from latent process m to output i is
    :math:`h_{mi}(s) = v_{mi} \exp(-\frac{1}{2} (s-\mu_{mi})^T A_{mi} (s-\mu_{mi}))`. For a
    separation :math:`\delta = s_a - s_b` the covariance is (Hemakumara & Sukkarieh 2011, equations
    14 to 16)

    .. math:: K_{ij}(\delta) = \sum_m \frac{(2\pi)^{d/2} v_{mi} v_{mj}}{\sqrt{|A_{mi} + A_{mj}|}}
              \exp\left(-\frac{1}{2} (\delta - \mu_{mi} + \mu_{mj})^T \Sigma_{mij}
              (\delta - \mu_{mi} + \mu_{mj})\right), \quad \Sigma_{mij} = A_{mi} (A_{mi} +
              A_{mj})^{-1} A_{mj}.

    The parameters are the amplitude :math:`w = v \pi^{d/4} |A|^{-1/4}`, so that
    :math:`K_{ii}(0) = \sum_m w_{mi}^2`, and the length scale :math:`\ell` with
    :math:`A = 2\,\mathrm{diag}(\ell^{-2})`, which is the length scale of scikit-learn's ``RBF``.

    Parameters
    ----------
    n_latent : int
        Number of latent processes that all outputs share.
    private_latents : bool
        Whether each output also has a private latent process.
    covariance_type : {"diag", "tied"}
        Widths of the filters, one for each regressor: "tied" has equal ones for all outputs of a
        latent (with zero shifts this is the linear model of coregionalisation).
    feeds : array (M, P) of bool or None
        Whether latent m contributes to output i, for example one latent for the lateral outputs
        only. It replaces ``n_latent`` and ``private_latents``.
    amplitude : array (M, P) or None
        Signed w, in the units of the outputs, shared latents first, then private ones. The last
        axis defines P. None: from the data.
    length_scale : array (M, P, d) or None
        Positive, in the units of the regressors. The last axis defines d. None: from the data.
    shift : array (M, P, d) or float
        mu, in the units of the regressors. Only differences between outputs matter: a pair of bounds
        is of the differences to the first output, which has zero, an array of the shift of each.
    parameter_bounds : mapping or None
        Bounds on the values by the names ``"amplitude"``, ``"length_scale"`` and ``"shift"``: a
        pair, an array (..., 2), or "fixed". Without an entry shifts are fixed, and bounds come from
        the data, on widths 0.05 to 1000 standard deviations of the regressor.

    Examples
    --------
    >>> from skdgp.kernels import ConvolvedGaussian
    >>> kernel = ConvolvedGaussian(1, private_latents=False, amplitude=[[1.0, -2.0]], length_scale=1.0)
    >>> kernel([[0.0]])
    array([[ 1., -2.],
           [-2.,  4.]])
    """

    needed = ("amplitude", "length_scale")
    default_bounds = {"amplitude": (-1e3, 1e3), "length_scale": (1e-3, 1e3), "shift": "fixed"}
    output_axes = {"amplitude": -1}

    def __init__(
        self,
        n_latent: Any = 1,
        *,
        private_latents: bool = True,
        covariance_type: str = "diag",
        feeds: Any = None,
        amplitude: Any = None,
        length_scale: Any = None,
        shift: Any = 0.0,
        parameter_bounds: Mapping[str, Any] | None = None,
    ) -> None:
        self.n_latent = n_latent
        self.private_latents = private_latents
        self.covariance_type = covariance_type
        self.feeds = feeds
        self.amplitude = amplitude
        self.length_scale = length_scale
        self.shift = shift
        self.parameter_bounds = parameter_bounds

    @property
    def filters(self) -> Filters:
        """Parameters of all filters in their full shapes."""
        if self.covariance_type not in COVARIANCE_TYPES:
            raise ValueError(
                f"Got covariance_type={self.covariance_type!r}, but expected one of {COVARIANCE_TYPES}."
            )
        self._check_values()
        amplitude = np.asarray(self.amplitude, dtype=float)
        lengths = np.asarray(self.length_scale, dtype=float)
        if not (lengths > 0).all() or not np.isfinite(amplitude).all():
            raise ValueError(
                "Got a length_scale that is not positive or an amplitude that is not finite."
            )
        P = amplitude.shape[-1] if amplitude.ndim else 1
        d = lengths.shape[-1] if lengths.ndim else 1
        feeds = self._feeds(P)
        shape = (*feeds.shape, d)
        lengths = as_shape("length_scale", lengths, shape)
        if self.covariance_type == "tied":
            check_tied(lengths, feeds)
        return Filters(
            feeds,
            as_shape("amplitude", amplitude, feeds.shape) * feeds,
            lengths,
            as_shape("shift", self.shift, shape),
        )

    def _feeds(self, P):
        """Return whether each latent feeds each output, (M, P)."""
        return feed_matrix(self.n_latent, self.private_latents, P, self.feeds)

    def values(self) -> dict[str, Array]:
        return self.filters._asdict()

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.filters.amplitude.shape[1]

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self.filters.length_scale.shape[2]

    def initialize(self, X: Matrix, Y: Matrix, random_state: Seed) -> MultiOutputKernel:
        feeds = self._feeds(Y.shape[1])
        return self._completed(*starting_values(feeds, X, Y, random_state))

    def free_parameters(self) -> list[FreeParameter]:
        d = np.atleast_1d(self.length_scale).shape[-1]
        feeds = self._feeds(np.atleast_1d(self.amplitude).shape[-1])
        is_tied = self.covariance_type == "tied"
        bounds = self.bounds_by_name()
        all_move = np.ndim(bounds["shift"]) > 1
        amplitudes, lengths, shifts = numbers(feeds.tobytes(), feeds.shape[1], d, is_tied, all_move)
        return [
            FreeParameter("amplitude", amplitudes, False, bounds["amplitude"]),
            FreeParameter("length_scale", lengths, True, bounds["length_scale"]),
            FreeParameter("shift", shifts, False, bounds["shift"]),
        ]

    # -- parameters of the paper's filters, equation 15
    # -----------------------------------------------------------------------

    @property
    def A(self) -> Array:
        """Diagonals of the filter precisions, (M, P, d)."""
        return 2.0 / self.filters.length_scale**2

    @property
    def mu(self) -> Array:
        """Filter shifts, (M, P, d)."""
        return self.filters.shift

    @property
    def v(self) -> Matrix:
        """Filter gains, (M, P), zero where a latent feeds no output: ``v = w |A|^(1/4) / pi^(d/4)``."""
        return self.filters.amplitude * np.exp(0.25 * np.log(self.A / np.pi).sum(axis=-1))

    # -- the equations
    # ---------------------------------------------------------------------------------

    def pair(self, i: int, j: int) -> FilterPair:
        """Return equation 16 of outputs i and j."""
        return self.filters.pair(i, j)

    def couples(self, i: int, j: int) -> bool:
        if self.feeds is None:
            return self.n_latent > 0 or i == j
        feeds = np.asarray(self.feeds, dtype=bool)
        return bool((feeds[:, i] & feeds[:, j]).any())

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        return self.pair(i, j).covariance(Xi, Xj)

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return np.full(len(Xi), np.sum(self.filters.amplitude[:, i] ** 2))

    def evaluate(self, pairs: Sequence[InputPair]) -> Sequence[EvaluatedBlock]:
        filters = self.filters
        places = self.theta_places().values()
        of_outputs = {}
        for i, j in {(pair.i, pair.j) for pair in pairs}:
            latents = filters.latents(i, j)
            of_outputs[i, j] = [(of_all[latents, i], of_all[latents, j]) for of_all in places]

        def evaluated(pair):
            filter_pair = filters.pair(pair.i, pair.j)
            return EvaluatedPair(filter_pair, pair.Xi, pair.Xj, of_outputs[pair.i, pair.j])

        return thread_map(evaluated, pairs)

    def add_curvature(self, total: Matrix, slopes: Mapping[tuple[int, int], Vector]) -> None:
        r"""Add the curvature of the factors c of equation 16 by the widths of two outputs.

        A factor is largest at equal widths, where its slope is zero. Its curvature is

        .. math:: \frac{\partial^2 \log c}{\partial (\log \ell_i - \log \ell_j)^2} = -\frac{1}{2}
                  \left(\frac{2 \ell_i \ell_j}{\ell_i^2 + \ell_j^2}\right)^2

        for each latent and regressor. Terms that would make the sum less positive are left out, as the
        average information is positive semi-definite. Nothing is added where amplitudes are fixed.
        """
        filters = self.filters
        places = self.theta_places()
        for (i, j), of_outputs in slopes.items():
            latents = filters.latents(i, j)
            by_amplitude = places["amplitude"][latents, i]
            if i == j or (by_amplitude < 0).any():
                continue
            # sum(W * K_ij) of each latent, as K_ij is linear in the amplitude of output i
            weighted = filters.amplitude[latents, i] * of_outputs[by_amplitude]
            li, lj = filters.length_scale[latents, i], filters.length_scale[latents, j]
            curvature = -0.5 * weighted[:, None] * (2.0 * li * lj / (li**2 + lj**2)) ** 2
            first, second = places["length_scale"][latents, i], places["length_scale"][latents, j]
            adds = (curvature > 0) & (first >= 0) & (first != second)
            a, b, added = first[adds], second[adds], curvature[adds]
            total[a, a] += added
            total[b, b] += added
            total[a, b] -= added
            total[b, a] -= added

    def is_stationary(self) -> bool:
        """Return True: the covariance depends only on the separation."""
        return True


@lru_cache(maxsize=64)  # all kernels of a search have the same numbers
def numbers(
    fed: bytes, n_outputs: int, d: int, is_tied: bool, all_move: bool
) -> tuple[Indices, Indices, Indices]:
    """Return the numbers of the free amplitudes (M, P), length scales and shifts (M, P, d).

    ``fed`` holds whether each latent feeds each output. All of its outputs have shifts if
    ``all_move``, or all but the first one.
    """
    feeds = np.frombuffer(fed, dtype=bool).reshape(-1, n_outputs)
    M = len(feeds)
    fed_along = np.repeat(feeds[..., None], d, axis=2)
    if is_tied:
        of_latents = np.arange(M * d).reshape(M, 1, d)  # one filter for each latent
        lengths = np.where(fed_along, of_latents, -1)
    else:
        lengths = numbered(fed_along)
    shifted = feeds & (feeds.sum(axis=1, keepdims=True) > 1)
    if not all_move:
        shifted[np.arange(M), feeds.argmax(axis=1)] = False
    return numbered(feeds), lengths, numbered(fed_along & shifted[..., None])


def check_tied(lengths: Array, feeds: Mask) -> None:
    """Raise a ValueError if length scales (M, P, d) differ between the outputs that a latent feeds."""
    fed = feeds[..., None]
    smallest = np.where(fed, lengths, np.inf).min(axis=1)
    largest = np.where(fed, lengths, 0.0).max(axis=1)
    if (smallest < (1 - ROUNDING) * largest).any():
        raise ValueError(
            "Got length scales that differ along the outputs with covariance_type='tied', "
            "but expected equal ones: use covariance_type='diag', or give equal length scales."
        )


def tied(lengths: Array) -> Array:
    """Return length scales (M, P, d) with their geometric mean over the outputs."""
    mean = np.log(lengths).mean(axis=1, keepdims=True)
    return np.exp(np.broadcast_to(mean, lengths.shape))


def feed_matrix(n_latent: int, private_latents: bool, P: int, feeds: Any = None) -> Mask:
    """Return whether each latent contributes to each output, (M, P), as in ``feeds`` if given."""
    if feeds is None:
        matrix = np.ones((n_latent, P), dtype=bool)
        if private_latents:
            return np.vstack([matrix, np.eye(P, dtype=bool)])
    else:
        matrix = np.array(feeds, dtype=bool)
    is_matrix = matrix.ndim == 2 and matrix.shape[1] == P
    if not (is_matrix and matrix.any(axis=1).all() and matrix.any(axis=0).all()):
        raise ValueError(
            f"Got feeds {matrix.astype(int).tolist()}, but expected (M, {P}) with at least one latent "
            "for every output, and at least one output for every latent: raise n_latent, "
            "or set private_latents=True."
        )
    return matrix


# -- starting values from the data


def starting_values(
    feeds: Mask, X: Matrix, Y: Matrix, random_state: Seed
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return values and bounds by name for samples X (n, d) and targets Y (n, P), NaN allowed.

    ``feeds`` (M, P) is whether a latent contributes to an output. Shared latents start along the
    principal directions of the correlation matrix of the outputs, so correlated outputs share a
    latent from the start. Latents start with different widths: with equal widths they would have
    equal gradients and remain equal.
    """
    rng = check_random_state(random_state)
    P = feeds.shape[1]
    x_scale = column_scale(X)
    y_scale = output_scale(Y)
    shared = feeds.sum(axis=1) > 1
    amplitude = _starting_amplitude(feeds, shared, Y, rng) * y_scale
    lengths = _starting_lengths(shared, X)
    values = {"amplitude": amplitude, "length_scale": np.repeat(lengths[:, None], P, axis=1)}

    largest = np.broadcast_to(STARTS.largest_amplitude * y_scale, feeds.shape)
    smallest = -largest
    observed = np.isfinite(Y)
    has_gaps = np.any(observed.any(axis=1) & ~observed.all(axis=1))
    if shared.any() and has_gaps:
        is_private = ~shared[:, None] & feeds
        smallest = np.where(is_private, STARTS.least_private * y_scale, smallest)
    widths = np.multiply.outer(x_scale, STARTS.width_bounds)
    bounds = {
        "amplitude": np.stack([smallest, largest], axis=-1),
        "length_scale": np.array(np.broadcast_to(widths, (*feeds.shape, *widths.shape))),
        "shift": "fixed",
    }
    return values, bounds


def places(X: Matrix) -> Indices:
    """Return the place of each column of X (n, d), NaN allowed, in an order that depends on its values alone.

    So a table whose columns have another order, or other signs, has the same starting values.
    """
    moments = []
    for x, scale in zip(X.T, column_scale(X), strict=True):
        x = x[np.isfinite(x)]
        centred = x - x.sum() / max(1, len(x))
        moments.append(np.sum(np.abs(centred / scale) ** 3))
    return np.argsort(np.argsort(moments))


def _starting_amplitude(feeds, shared, Y, rng):
    """Return the signed amplitudes (M, P), over the scales of the outputs."""
    directions = np.ones(feeds.shape)
    directions[shared] = _directions(Y, int(shared.sum()), rng)
    variance = feeds * directions**2  # half of it is shared
    return np.sign(directions) * np.sqrt(variance / variance.sum(axis=0))


def _starting_lengths(shared, X):
    """Return the length scales of each latent, (M, d)."""
    # The first latents explain most of the variance and start wide, the last ones narrow.
    width = np.full(len(shared), STARTS.private_width)
    widest, narrowest = STARTS.shared_widths
    width[shared] = np.geomspace(widest, narrowest, int(shared.sum()))
    n_varying = int(np.sum(~constant_columns(X)))
    return np.sqrt(max(1, n_varying)) * width[:, None] * column_scale(X)


def _directions(Y, n_latent, rng):
    """Return principal directions (n_latent, P), again after P; squares sum to one over the latents."""
    P = Y.shape[1]
    if n_latent == 0:
        return np.empty((0, P))
    observed = np.isfinite(Y)
    mean = np.nanmean(np.where(observed.any(axis=0), Y, 0.0), axis=0)
    Z = np.where(observed, Y - mean, 0.0) / column_scale(Y)
    counts = np.maximum(observed.T.astype(float) @ observed, 1.0)
    place = places(Y)
    order = np.diag(1e-9 * (P - place))  # so that rounding does not choose the directions
    values, vectors = np.linalg.eigh(Z.T @ Z / counts + order)
    # The sign of an eigenvector depends on LAPACK: choose one.
    side = np.sqrt(place + 2) @ vectors
    vectors = vectors * np.where(side < 0, -1.0, 1.0)
    sizes = np.sqrt(np.maximum(values, SCATTER))
    principal = (vectors * sizes).T[::-1]
    rows = principal[np.arange(n_latent) % P]
    # A small perturbation, since an amplitude of exactly zero has no gradient, and equal ones have equal
    # gradients. It takes the sign of the amplitude, so that outputs of the other sign start, and end, as
    # the same model.
    perturbation = SCATTER * rng.normal(size=rows.shape)[:, place]
    rows = rows + perturbation * np.where(rows < 0, -1.0, 1.0)
    return rows / np.sqrt(np.sum(rows**2, axis=0))
