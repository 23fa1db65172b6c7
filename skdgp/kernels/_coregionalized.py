"""Kernels of scikit-learn on several outputs: the intrinsic model of coregionalisation."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from sklearn.gaussian_process.kernels import CompoundKernel, Kernel, WhiteKernel
from sklearn.gaussian_process.kernels import Sum as SklearnSum

from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector
from skdgp.kernels._base import (
    EstimatedKernel,
    EvaluatedBlock,
    FreeParameter,
    InputPair,
    MultiOutputKernel,
    Sum,
    add_at,
    as_shape,
    numbered,
)
from skdgp.kernels._convolved import feed_matrix, starting_values

PREFIX = "kernel__"  # of the parameters of scikit-learn's kernel, as in ``get_params``


class Coregionalized(EstimatedKernel):
    r"""Covariance of outputs that are combinations of independent processes with a kernel of scikit-learn.

    .. math:: K_{ij}(s, s') = B_{ij} \, k(s, s'), \quad B = W^T W

    which is the intrinsic model of coregionalisation (Bonilla, Chai & Williams 2008). A sum of such
    kernels is the linear model of coregionalisation.

    Parameters
    ----------
    kernel : sklearn.gaussian_process.kernels.Kernel
        The kernel k, with its values and bounds, without ``WhiteKernel``.
    n_latent : int
        Number of processes that all outputs share.
    private_latents : bool
        Whether each output also has a private process. A single output has one process in all.
    amplitude : array (M, P) or None
        Signed W, in the unit of the output, shared processes first, then private ones. None: from
        the data.
    parameter_bounds : mapping or None
        Bounds by the name ``"amplitude"``: a pair, an array (..., 2), or "fixed". None: from the
        data.

    Examples
    --------
    >>> from sklearn.gaussian_process.kernels import Matern
    >>> from skdgp.kernels import Coregionalized
    >>> kernel = Coregionalized(Matern(nu=1.5), private_latents=False, amplitude=[[1.0, -2.0]])
    >>> kernel([[0.0]])
    array([[ 1., -2.],
           [-2.,  4.]])
    """

    needed = ("amplitude",)
    default_bounds = {"amplitude": (-1e3, 1e3)}
    output_axes = {"amplitude": -1}

    def __init__(
        self,
        kernel: Kernel,
        n_latent: int = 1,
        *,
        private_latents: bool = True,
        amplitude: Any = None,
        parameter_bounds: Mapping[str, Any] | None = None,
    ) -> None:
        self.kernel = kernel
        self.n_latent = n_latent
        self.private_latents = private_latents
        self.amplitude = amplitude
        self.parameter_bounds = parameter_bounds

    def get_params(self, deep: bool = True) -> dict[str, Any]:
        """Return the parameters by name, with ``deep`` also the parameters of ``kernel``."""
        params = super().get_params(deep=False)
        if deep:
            inner = self.kernel.get_params(deep=True)
            params |= {PREFIX + name: value for name, value in inner.items()}
        return params

    # -- shapes and values
    # ---------------------------------------------------------------------------------

    def _feeds(self, P):
        """Return whether each process contributes to each output, (M, P)."""
        if P == 1:  # several processes of one output would be one
            return np.ones((1, 1), dtype=bool)
        return feed_matrix(self.n_latent, self.private_latents, P)

    @property
    def weights(self) -> Matrix:
        """W, (M, P)."""
        check_kernel(self.kernel)
        self._check_values()
        w = np.asarray(self.amplitude, dtype=float)
        feeds = self._feeds(w.shape[-1] if w.ndim else 1)
        return as_shape("amplitude", w, feeds.shape) * feeds

    @property
    def B(self) -> Matrix:
        """Covariance of the outputs for a unit kernel, (P, P)."""
        w = self.weights
        return w.T @ w

    def values(self) -> dict[str, Array]:
        inner = self.kernel.get_params(deep=True)
        values = {"amplitude": self.weights}
        for h in self.kernel.hyperparameters:
            values[PREFIX + h.name] = np.atleast_1d(np.asarray(inner[h.name], dtype=float))
        return values

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.weights.shape[1]

    @property
    def n_features(self) -> int | None:
        """Number of regressors d of an anisotropic kernel; None for an isotropic one, which takes any number."""
        check_kernel(self.kernel)
        n_scales = max((h.n_elements for h in self.kernel.hyperparameters), default=1)
        return None if n_scales == 1 else n_scales

    def initialize(self, X: Matrix, Y: Matrix, random_state: Seed) -> MultiOutputKernel:
        self._check_columns("regressors", X, self.n_features)
        feeds = self._feeds(Y.shape[1])
        values, bounds = starting_values(feeds, X, Y, random_state)
        return self._completed(
            {"amplitude": values["amplitude"]}, {"amplitude": bounds["amplitude"]}
        )

    # -- theta: amplitudes, then the theta of the kernel
    # ----------------------------------------------------------------------

    def free_parameters(self) -> list[FreeParameter]:
        feeds = self._feeds(self.n_outputs)
        bounds = self.bounds_by_name()
        parameters = [FreeParameter("amplitude", numbered(feeds), False, bounds["amplitude"])]
        for h in self.kernel.hyperparameters:
            index = np.arange(h.n_elements)
            parameters.append(FreeParameter(PREFIX + h.name, index, True, h.bounds))
        return parameters

    @MultiOutputKernel.theta.setter  # type: ignore[attr-defined]
    def theta(self, theta: Vector | None):
        theta = self._check_theta(theta)
        amplitude, *_ = self.free_parameters()
        own, inner = np.split(theta, [amplitude.n_elements])
        self.amplitude = amplitude.with_elements(self.weights, own)
        self.kernel = self.kernel.clone_with_theta(inner)

    # -- the equation
    # --------------------------------------------------------------------------------------

    def couples(self, i: int, j: int) -> bool:
        return self.n_latent > 0 or i == j

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        return self.B[i, j] * self.kernel(Xi, Xj)

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return self.B[i, i] * self.kernel.diag(Xi)

    def evaluate(self, pairs: Sequence[InputPair]) -> Sequence[EvaluatedBlock]:
        weights = self.weights
        places = self.theta_places()["amplitude"]
        evaluated = []
        for i, j, Xi, Xj in pairs:
            # scikit-learn has derivatives for equal inputs alone
            k, slopes = self.kernel(np.vstack([Xi, Xj]), eval_gradient=True)
            n = len(Xi)
            evaluated.append(
                _EvaluatedPair(k[:n, n:], slopes[:n, n:], (i, j), weights[:, [i, j]], places)
            )
        return evaluated

    def is_stationary(self) -> bool:
        """Return whether the covariance depends only on x - x'."""
        return self.kernel.is_stationary()


class _EvaluatedPair(NamedTuple):
    """`EvaluatedBlock` of a `Coregionalized`, of outputs with the ``weights`` (M, 2)."""

    k: Matrix
    slopes: Array
    outputs: tuple[int, int]
    weights: Matrix
    places: Indices

    @property
    def B(self) -> float:
        return float(self.weights[:, 0] @ self.weights[:, 1])

    def covariance(self) -> Matrix:
        return self.B * self.k

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        by_inner = np.einsum("ab,abt->t", W, self.slopes)
        self._add(total[None], np.array([np.sum(W * self.k)]), by_inner)

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        k, slopes = self.k, self.slopes
        if transposed:
            k, slopes = k.T, slopes.swapaxes(0, 1)
        self._add(total, k @ beta, np.einsum("abt,b->at", slopes, beta))

    def _add(self, total, by_B, by_inner):
        """Add derivatives from sums of k (n,), and of its derivatives (n, t), to ``total`` (n, n_theta)."""
        for output, other in zip(self.outputs, self.weights.T[::-1], strict=True):
            add_at(total, self.places[:, output], np.multiply.outer(by_B, other))
        total[:, total.shape[1] - self.slopes.shape[2] :] += self.B * by_inner


def as_multi_output(kernel: Kernel, n_fixed: int | None = None) -> MultiOutputKernel:
    """Return a kernel of scikit-learn, or a sum of such and of multi-output kernels, as a multi-output kernel.

    With ``n_fixed`` it is the covariance of so many independent outputs, as it stands; otherwise the
    amplitudes of the outputs are left to be estimated. Raises TypeError for products and powers of
    multi-output kernels, and for white noise.
    """
    if any(isinstance(part, MultiOutputKernel) for part in _parts(kernel)):
        if isinstance(kernel, SklearnSum):
            return Sum(as_multi_output(kernel.k1, n_fixed), as_multi_output(kernel.k2, n_fixed))
        if isinstance(kernel, MultiOutputKernel):
            return kernel
        raise TypeError(
            f"Got {kernel!r}, a product or power of a multi-output kernel, but such kernels can only be added. "
            "Multiply scikit-learn's kernels inside Coregionalized."
        )
    check_kernel(kernel)
    if n_fixed is None:
        return Coregionalized(kernel)
    return Coregionalized(
        kernel, 0, amplitude=np.eye(n_fixed), parameter_bounds={"amplitude": "fixed"}
    )


def check_kernel(kernel: Any) -> None:
    """Raise TypeError unless this is a kernel of scikit-learn for one output, without white noise."""
    if not isinstance(kernel, Kernel) or isinstance(kernel, (MultiOutputKernel, CompoundKernel)):
        raise TypeError(
            f"Got the kernel {kernel!r}, but expected a kernel of scikit-learn for one output, such as RBF()."
        )
    if any(isinstance(part, WhiteKernel) for part in _parts(kernel)):
        raise TypeError(
            f"Got {kernel!r} as the kernel of several outputs, but expected one without WhiteKernel. "
            "Leave out measurement noise: DependentGPRegressor learns it for each output (noise_variance_)."
        )


def _parts(kernel: Kernel) -> Iterator[Kernel]:
    """Yield a kernel and the kernels that it is made of."""
    yield kernel
    for value in kernel.get_params(deep=False).values():
        if isinstance(value, Kernel):
            yield from _parts(value)
