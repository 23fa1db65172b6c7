"""The convolved Gaussian kernel: outputs as filtered white noise."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state

from skdgp._compute.linalg import (
    RowPairs,
    column_scale,
    constant_columns,
    output_scale,
)
from skdgp._compute.typing import Array, Mask, Matrix, Seed, Vector
from skdgp.kernels._base import (
    FreeParameter,
    FrozenBounds,
    MultiOutputKernel,
    as_shape,
    complete_bounds,
    frozen,
    given_bounds,
    hyperparameter,
    renumber,
    rescaled_values,
)
from skdgp.kernels._gaussian_filters import FilterPair

CONSTANT_LENGTH = 1e9  # length scale over the standard deviation of a regressor without effect:
# it changes 1e-18 of the variance, below rounding
ADDITIVE_AMPLITUDE = (
    0.3  # starting amplitude of a term of few regressors, over the amplitude of a kernel of all
)
PARAMETERS = ("amplitude", "length_scale", "shift")
# Bounds of a kernel that has values, and was not initialized from data
DEFAULT_BOUNDS = {"amplitude": (-1e3, 1e3), "length_scale": (1e-3, 1e3), "shift": "fixed"}
SPACING = "spacing"  # for length scales alone
NOISE_AMPLITUDE = (
    0.1  # below this fraction of its starting amplitude an output was explained as noise
)
COVARIANCE_TYPES = ("diag", "tied")
TIE_BREAK = 1e-9  # added to correlations, so that rounding does not choose the principal directions
# Fraction of an output's variance that starts in the shared latents (guess; 0.1 ends alike)
SHARED_VARIANCE = 0.5
WIDTHS = 0.05, 1e3  # bounds, over the standard deviation of the regressor
# Largest width, over that, from which a fit of few rows may start the next: from wider ones, where
# the likelihood is flat, it does not come back (a log keeps them)
WIDEST_START = 10.0
MOST_COUNTED = (
    400  # samples for the smallest width: searches learn from a few hundred, however long the log
)


class ConvolvedGaussian(MultiOutputKernel):
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
    regressors : sequence of int or None
        Columns of X that the outputs depend on, for additive models: a sum of kernels of few
        regressors each. Length scales of the others are fixed at 1e9 times their standard deviation
        (at least at 1e9), whatever ``length_scale`` is given, so that they have no effect in double
        precision. None: all columns.
    feeds : array (M, P) of bool or None
        Whether latent m contributes to output i, for example one latent for the lateral outputs
        only. It replaces ``n_latent`` and ``private_latents``.
    amplitude : array (M, P) or None
        Signed w, in the units of the outputs, shared latents first, then private ones. The last
        axis defines P. None: from the data.
    length_scale : array (M, P, d) or None
        Positive, in the units of the regressors. The last axis defines d. None: from the data.
    shift : array (M, P, d) or float
        mu, in the units of the regressors. Only differences between outputs matter, so the first
        output has zero.
    parameter_bounds : mapping or None
        Bounds on the values by the names ``"amplitude"``, ``"length_scale"`` and ``"shift"``: a
        pair, an array (..., 2), or "fixed". Without an entry shifts are fixed, and bounds come from
        the data, on widths 0.05 to 1000 standard deviations of the regressor.
        ``{"length_scale": "spacing"}``: widths of at least n^(-1/d) standard deviations, for n
        samples, at most 400, in d regressors. In many regressors, a process of smaller width is
        noise to the samples.

    Examples
    --------
    >>> from skdgp.kernels import ConvolvedGaussian
    >>> kernel = ConvolvedGaussian(1, private_latents=False, amplitude=[[1.0, -2.0]], length_scale=1.0)
    >>> kernel([[0.0]])
    array([[ 1., -2.],
           [-2.,  4.]])
    """

    def __init__(
        self,
        n_latent: Any = 1,
        *,
        private_latents: bool = True,
        covariance_type: str = "diag",
        regressors: Sequence[int] | None = None,
        feeds: Any = None,
        amplitude: Any = None,
        length_scale: Any = None,
        shift: Any = 0.0,
        parameter_bounds: Mapping[str, Any] | None = None,
    ) -> None:
        self.n_latent = n_latent
        self.private_latents = private_latents
        self.covariance_type = covariance_type
        self.regressors = regressors
        self.feeds = feeds
        self.amplitude = amplitude
        self.length_scale = length_scale
        self.shift = shift
        self.parameter_bounds = parameter_bounds

    # -- shapes
    # ----------------------------------------------------------------------------------------

    def _arrays(self):
        """Return a dict of the parameters broadcast to (M, P, ...) and of ``feeds`` (M, P)."""
        if self.covariance_type not in COVARIANCE_TYPES:
            raise ValueError(
                f"Got covariance_type={self.covariance_type!r}, but expected one of "
                f"{COVARIANCE_TYPES}."
            )
        if self.amplitude is None or self.length_scale is None:
            raise ValueError(
                "ConvolvedGaussian has no values yet: give amplitude and length_scale, or let "
                "DependentGPRegressor.fit estimate them from the data."
            )
        w, lengths = (
            np.asarray(self.amplitude, dtype=float),
            np.asarray(self.length_scale, dtype=float),
        )
        P, d = w.shape[-1] if w.ndim else 1, lengths.shape[-1] if lengths.ndim else 1
        feeds = self._feed_matrix(P)
        M, others = len(feeds), self.without_effect(d)
        if not (lengths > 0).all() or not np.isfinite(w).all():
            raise ValueError(
                "Got a length_scale that is not positive or an amplitude that is not finite."
            )
        lengths = as_shape("length_scale", lengths, (M, P, d))
        lengths[..., others] = np.maximum(lengths[..., others], CONSTANT_LENGTH)
        fed = feeds[..., None] > 0
        least, most = np.where(fed, lengths, np.inf).min(1), np.where(fed, lengths, 0.0).max(1)
        if self.covariance_type == "tied" and (least < (1 - 1e-9) * most).any():
            raise ValueError(
                "Got length scales that differ along the outputs with covariance_type='tied', but "
                "expected equal ones: use covariance_type='diag', or give equal length scales."
            )
        arrays = {
            "feeds": feeds,
            "amplitude": as_shape("amplitude", w, (M, P)) * feeds,
            "length_scale": lengths,
            "shift": as_shape("shift", self.shift, (M, P, d)),
        }
        return {name: frozen(array) for name, array in arrays.items()}

    def without_effect(self, d: int) -> Mask:
        """Return the mask (d,) of regressors that the outputs do not depend on."""
        if self.regressors is None:
            return np.zeros(d, dtype=bool)
        columns = np.asarray(self.regressors)
        whole = columns.ndim == 1 and columns.dtype.kind in "iu" and len(columns) > 0
        if not (whole and set(columns) <= set(range(d))):
            raise ValueError(
                f"Got regressors={self.regressors!r}, but expected columns of X from 0 to {d - 1}."
            )
        return ~np.isin(np.arange(d), columns)

    def _feed_matrix(self, P):
        """Return the matrix (M, P) that is one where a latent contributes to an output."""
        return feed_matrix(self.n_latent, self.private_latents, P, self.feeds)

    hyperparameter_amplitude = hyperparameter("amplitude")
    hyperparameter_length_scale = hyperparameter("length_scale")
    hyperparameter_shift = hyperparameter("shift")

    def value(self, name: str) -> Array:
        return self._cached("arrays", self._arrays)[name]

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        return rescaled_amplitude(self, factor, PARAMETERS)

    def bounds_from_data(self, name: str) -> bool:
        given = given_bounds(self, PARAMETERS).get(name)
        return given is None or (isinstance(given, str) and given == SPACING)

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.value("amplitude").shape[1]

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self.value("length_scale").shape[2]

    def _bounds_of_widths(self):
        """Return the bounds on the widths as given, and whether the data decide on them."""
        given = complete_bounds(self.parameter_bounds, dict.fromkeys(PARAMETERS))["length_scale"]
        return given, given is None or (isinstance(given, str) and given == SPACING)

    def _bounds(self, defaults):
        """Return the bounds of all parameters, the defaults where none were given."""
        bounds = complete_bounds(self.parameter_bounds, defaults)
        if self._bounds_of_widths()[1]:
            bounds["length_scale"] = defaults["length_scale"]
        return bounds

    def has_values(self) -> bool:
        return self.amplitude is not None and self.length_scale is not None

    def initialize(
        self,
        X: Matrix,
        Y: Matrix,
        random_state: Seed,
        singles: Sequence | None = None,
        coarse: MultiOutputKernel | None = None,
        width_factor: float = 1.0,
    ) -> MultiOutputKernel:
        others = self.without_effect(X.shape[1])
        params = self.get_params()
        feeds = self._feed_matrix(Y.shape[1])
        for name, shape in (
            ("amplitude", feeds.shape),
            ("length_scale", (*feeds.shape, X.shape[1])),
        ):
            if params[name] is not None:
                params[name] = as_shape(name, params[name], shape)
        start, bounds = starting_values(feeds, X, Y, random_state, width_factor)
        given, from_data = self._bounds_of_widths()
        if given is not None and from_data:  # "spacing"
            smallest = bounds["length_scale"][..., 0]
            np.maximum(smallest, spacing(X, Y, ~others) * column_scale(X), out=smallest)
        params["parameter_bounds"] = FrozenBounds(self._bounds(bounds))
        if singles:
            start |= self._from_singles(start["amplitude"], start["length_scale"], singles)
            if given is None:
                widest = WIDEST_START * column_scale(X)
                start["length_scale"] = np.minimum(start["length_scale"], widest)
        if coarse:
            start |= {name: coarse.value(name) for name in ("amplitude", "length_scale")}
        if self.covariance_type == "tied":
            mean = np.log(start["length_scale"]).mean(axis=1, keepdims=True)
            start["length_scale"] = np.exp(np.broadcast_to(mean, start["length_scale"].shape))
        if others.any() and not singles and not coarse:
            start["amplitude"] *= ADDITIVE_AMPLITUDE
            start["length_scale"][..., ~others] *= np.sqrt(np.mean(~others))
        for name, value in start.items():
            if params[name] is None:
                params[name] = value
        params["length_scale"] = np.array(params["length_scale"])
        params["length_scale"][..., others] = CONSTANT_LENGTH * column_scale(X)[others]
        for name in ("amplitude", "length_scale"):
            frozen(params[name])
        return type(self)(**params)

    def _from_singles(self, w, lengths, singles):
        """Return starting values (M, P, ...) from separate fits of each output.

        Private latents take the fitted widths. A shared latent takes their weighted geometric mean
        for all outputs, because equal widths allow the strongest coupling; with very different
        widths no coupling can be learned. An output that its separate fit explains as noise keeps
        its default values: at zero amplitude the gradient is zero and a dependence on other outputs
        cannot be found.
        """
        total = np.sqrt((w**2).sum(axis=0))
        amplitude = np.array([abs(s.value("amplitude")[0, 0]) for s in singles])
        explained = amplitude > NOISE_AMPLITUDE * total
        widths = np.where(
            explained[:, None],
            np.stack([s.value("length_scale")[0, 0] for s in singles]),
            lengths[-1],
        )
        weight = w**2 / (w**2).sum(axis=1, keepdims=True)
        private = (weight == 1.0)[..., None]
        return {
            "amplitude": w * np.where(explained, amplitude / total, 1.0),
            "length_scale": np.where(private, widths, np.exp(weight @ np.log(widths))[:, None, :]),
        }

    def coarse(self) -> MultiOutputKernel:
        _, from_data = self._bounds_of_widths()
        if self.covariance_type == "diag" and self.length_scale is None and from_data:
            bounds = dict(self.parameter_bounds or {}, shift="fixed")
            return clone(self).set_params(
                covariance_type="tied", shift=0.0, parameter_bounds=bounds
            )
        return self

    def single_output(self) -> MultiOutputKernel:
        given, from_data = self._bounds_of_widths()
        return ConvolvedGaussian(
            0,
            regressors=self.regressors,
            parameter_bounds={"length_scale": given} if from_data else None,
        )

    def term_regressors(self) -> list[tuple[int, ...]]:
        return [tuple(np.flatnonzero(~self.without_effect(self.n_features)).tolist())]

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        if regressors in self.term_regressors():
            return self
        return clone(self).set_params(amplitude=np.zeros_like(self.value("amplitude")))

    def free_parameters(self) -> list[FreeParameter]:
        return self._cached("free", self._free_parameters)

    def _free_parameters(self):
        feeds = self.value("feeds").astype(bool)
        M, P, d = self.value("shift").shape
        latent, output = np.indices((M, P))
        # One filter for each latent and output, or for each latent if "tied".
        filters = latent * P + output
        width = latent if self.covariance_type == "tied" else filters
        matters = ~self.without_effect(d)
        shifted = feeds & (
            output != feeds.argmax(axis=1)[:, None]
        )  # only differences between outputs matter
        bounds = self._bounds(DEFAULT_BOUNDS)
        lengths = renumber(width[..., None] * d + np.arange(d), feeds[..., None] & matters)
        shifts = renumber(filters[..., None] * d + np.arange(d), shifted[..., None] & matters)
        return [
            FreeParameter("amplitude", renumber(filters, feeds), False, bounds["amplitude"]),
            FreeParameter("length_scale", lengths, True, bounds["length_scale"]),
            FreeParameter("shift", shifts, False, bounds["shift"]),
        ]

    # -- parameters of the paper's filters, equation 15
    # -----------------------------------------------------------------------

    @property
    def A(self) -> Array:
        """Diagonals of the filter precisions, (M, P, d)."""
        return 2.0 / self.value("length_scale") ** 2

    @property
    def mu(self) -> Array:
        """Filter shifts, (M, P, d)."""
        return self.value("shift")

    @property
    def v(self) -> Matrix:
        """Filter gains, (M, P), zero where a latent feeds no output: ``v = w |A|^(1/4) / pi^(d/4)``."""
        return self.value("amplitude") * np.exp(0.25 * np.log(self.A / np.pi).sum(axis=-1))

    # -- the equations
    # ---------------------------------------------------------------------------------

    def pair(self, i: int, j: int) -> FilterPair:
        """Return equation 16 of outputs i and j."""
        return self._cached((i, j), lambda: self._pair(i, j))

    def _common(self, i, j):
        """Return the numbers of the latents that feed both outputs."""
        return np.flatnonzero(self.value("feeds")[:, [i, j]].all(axis=1))

    def _pair(self, i, j):
        latents = self._common(i, j)
        w, widths, mu = (
            np.stack([values[latents, i], values[latents, j]])
            for values in map(self.value, PARAMETERS)
        )
        return FilterPair(w, widths, mu[0] - mu[1])

    def couples(self, i: int, j: int) -> bool:
        return len(self.pair(i, j).gain) > 0

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        return self.pair(i, j).covariance(Xi, Xj)

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return np.full(len(Xi), (self.value("amplitude")[:, i] ** 2).sum())

    def block_derivative(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Array:
        Xi, Xj, pair = np.asarray(Xi, float), np.asarray(Xj, float), self.pair(i, j)
        slopes = np.zeros((Xi.shape[1], len(Xi), len(Xj)))
        for gain, mu, Sigma in zip(pair.gain, pair.mu, pair.Sigma, strict=True):
            apart = Xi.T[:, :, None] - Xj.T[:, None] - mu[:, None, None]
            E = gain * np.exp(-0.5 * np.tensordot(Sigma, apart**2, 1))
            slopes -= E * apart * Sigma[:, None, None]
        return slopes

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        if not self.couples(i, j):
            return np.zeros(self.n_dims)
        return self._theta_gradient(i, j, self.pair(i, j).moments(Xi, Xj, W))

    def at_pairs(self, i: int, pairs: RowPairs) -> tuple[Vector, Callable[[Vector], Vector]]:
        columns: Any = slice(None)  # needs no copy
        if self.regressors is not None:
            columns = np.flatnonzero(~self.without_effect(self.n_features))
        values, moments = self.pair(i, i).at_pairs(pairs, columns)
        return values, lambda w: self._theta_gradient(i, i, moments(w))

    def _theta_gradient(self, i, j, moments):
        """Return d/dtheta of sum(W * cov_ij), from the moments of W."""
        latents = self._common(i, j)
        by_w, by_widths, by_mu = self.pair(i, j).gradient(moments)
        gradients = {name: np.zeros_like(self.value(name)) for name in PARAMETERS}
        for k, output in enumerate((i, j)):
            gradients["amplitude"][latents, output] += by_w[k]
            gradients["length_scale"][latents, output] += by_widths[k]
        gradients["shift"][latents, i] += by_mu
        gradients["shift"][latents, j] -= by_mu
        return self.theta_gradient(gradients)

    def is_stationary(self) -> bool:
        """Return True: the covariance depends only on the separation."""
        return True


def feed_matrix(n_latent: int, private_latents: bool, P: int, feeds: Any = None) -> Matrix:
    """Return the matrix (M, P) that is one where a latent contributes to an output, or ``feeds`` if given."""
    if feeds is None:
        private = np.eye(P)[: P * bool(private_latents)]
        feeds = np.concatenate([np.ones((n_latent, P)), private])
    else:
        feeds = np.array(feeds, dtype=float)
    if (
        feeds.ndim != 2
        or feeds.shape[1] != P
        or not feeds.any(axis=1).all()
        or not feeds.any(axis=0).all()
    ):
        raise ValueError(
            f"Got feeds {feeds.astype(int).tolist()}, but expected (M, {P}) with at least one "
            f"latent for every output, and at least one output for every latent: raise n_latent, "
            "or set private_latents=True."
        )
    return feeds


def rescaled_amplitude(
    kernel: MultiOutputKernel, factor: Vector, names: Iterable[str]
) -> MultiOutputKernel:
    """Return a kernel whose amplitudes, and their bounds, are multiplied by factors of the outputs (P,).

    ``names`` are the parameters that have bounds.
    """
    factor = np.asarray(factor, dtype=float)
    amplitude = kernel.get_params(deep=False)["amplitude"]
    bounds = given_bounds(kernel, names)
    if "amplitude" in bounds:
        given = bounds["amplitude"]
        bounds["amplitude"] = rescaled_values("bounds of amplitude", given, factor, axis=-2)
    return clone(kernel).set_params(
        amplitude=rescaled_values("amplitude", amplitude, factor, axis=-1),
        parameter_bounds=bounds or None,
    )


def independent_processes(variance: Vector, length_scale: Vector) -> ConvolvedGaussian:
    """Return the kernel of independent processes of variances (P,) with the widths (d,)."""
    P, d = len(variance), len(length_scale)
    return ConvolvedGaussian(
        0,
        amplitude=np.diag(np.sqrt(variance)),
        length_scale=np.broadcast_to(length_scale, (P, P, d)),
    )


# -- starting values from the data
# ------------------------------------------------------------------------------------


def spacing(X, Y, matters):
    """Return the smallest width n^(-1/d) for samples X (rows, columns) and targets Y (rows, P), NaN allowed.

    n are the samples of the most observed output, at most ``MOST_COUNTED``, d the regressors that
    ``matters`` marks and that are not constant. n samples spread evenly over d regressors are 3.5
    times as far apart, in their deviations.
    """
    n_axes = max(1, int(np.sum(matters & ~constant_columns(X))))
    n = np.clip(np.isfinite(Y).sum(axis=0).max(), 1, MOST_COUNTED)
    return float(n) ** (-1.0 / n_axes)


def starting_values(feeds, X, Y, random_state, width_factor=1.0):
    """Return values and bounds by name for samples X (n, d) and targets Y (n, P), NaN allowed.

    ``feeds`` (M, P) is one where a latent contributes to an output. Shared latents start along the
    principal directions of the correlation matrix of the outputs, so correlated outputs share a
    latent from the start. Latents start with different widths: with equal widths they would have
    equal gradients and remain equal.
    """
    rng = check_random_state(random_state)
    M, P = feeds.shape
    d = X.shape[1]
    x_scale, y_scale = column_scale(X), output_scale(Y)
    shared = feeds.sum(axis=1) > 1
    n_shared = int(shared.sum())
    weight = (
        np.where(shared[:, None], SHARED_VARIANCE, 1.0 - SHARED_VARIANCE) * np.ones((1, P)) * feeds
    )
    directions = np.ones((M, P))
    directions[shared] = _directions(Y, n_shared, rng)
    weight *= directions**2
    amplitude = np.sign(directions) * np.sqrt(weight / weight.sum(axis=0)) * y_scale
    # The first latents explain most of the variance and start wide, the last ones narrow.
    spread = np.full(M, 1.2)
    spread[shared] = np.geomspace(2.0, 0.8, n_shared)
    varies = ~constant_columns(X)  # the others change nothing
    apart = np.zeros((M, 1, d))
    apart[..., varies] = 0.1 * shared[:, None, None] * rng.normal(size=(M, 1, varies.sum()))
    lengths = (
        width_factor
        * np.sqrt(max(1, varies.sum()))
        * spread[:, None, None]
        * x_scale
        * np.exp(apart)
    )
    values = {
        "amplitude": amplitude,
        "length_scale": np.broadcast_to(lengths, (M, P, d)).copy(),
    }
    amplitudes = np.broadcast_arrays(-30 * y_scale, 30 * y_scale * np.ones((M, 1)))
    widths = np.broadcast_to(np.multiply.outer(x_scale, WIDTHS), (M, P, d, 2)).copy()
    return values, {
        "amplitude": np.stack(amplitudes, axis=-1),
        "length_scale": widths,
        "shift": DEFAULT_BOUNDS["shift"],
    }


def _directions(Y, n_latent, rng):
    """Return directions (n_latent, P), first principal ones, then random ones; squares sum to one over the latents."""
    P = Y.shape[1]
    observed = np.isfinite(Y)
    Z = np.where(
        observed, Y - np.nanmean(np.where(observed.any(axis=0), Y, 0.0), axis=0), 0.0
    ) / column_scale(Y)
    counts = np.maximum(observed.T.astype(float) @ observed, 1.0)
    order = np.diag(TIE_BREAK * np.arange(P, 0, -1))
    values, vectors = np.linalg.eigh(Z.T @ Z / counts + order)
    side = (
        np.sqrt(np.arange(2, P + 2)) @ vectors
    )  # the sign of an eigenvector depends on LAPACK: choose one
    vectors = vectors * np.where(side < 0, -1.0, 1.0)
    rows = (vectors * np.sqrt(np.maximum(values, 0.05))).T[::-1][:n_latent]  # principal ones
    if n_latent > P:
        rows = np.concatenate([rows, 0.5 * rng.normal(size=(n_latent - P, P))])
    # A small perturbation, since an amplitude of exactly zero has no gradient. It takes the sign of
    # the amplitude, so that outputs of the other sign start, and end, as the same model.
    rows = rows + 0.05 * rng.normal(size=rows.shape) * np.where(rows < 0, -1.0, 1.0)
    return rows / np.sqrt((rows**2).sum(axis=0, keepdims=True)) if n_latent else rows
