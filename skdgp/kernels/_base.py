"""The base class of kernels, MultiOutputKernel, and sums of kernels."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np
from sklearn.gaussian_process.kernels import Hyperparameter, Kernel
from sklearn.gaussian_process.kernels import Sum as _SklearnSum

from skdgp._compute.linalg import RowPairs
from skdgp._compute.typing import Array, Indices, Matrix, Seed, Vector

DERIVATIVE_STEP = 1e-3  # step of numerical derivatives, for regressors of about unit size
SHOWN_ENTRIES = 12  # largest number of entries of an array that ``repr`` shows in full


@dataclass(frozen=True)
class FreeParameter:
    """The free entries of one parameter array.

    ``index`` has the shape of the array: entries with the same number share one hyperparameter, and
    -1 marks a fixed entry. ``log`` is True if theta holds the logarithm, False if it holds the
    signed value.
    """

    name: str
    index: Indices
    log: bool
    bounds: Any

    @property
    def fixed(self) -> bool:
        """Whether the parameter keeps its value."""
        if isinstance(self.bounds, str) and self.bounds != "fixed":
            raise ValueError(
                f"Got bounds {self.bounds!r} of {self.name}, but expected a pair, an array of "
                f"pairs, or 'fixed'."
            )
        return isinstance(self.bounds, str)

    @cached_property
    def n_elements(self) -> int:
        """Number of entries of theta for this parameter."""
        return 0 if self.fixed else int(self.index.max(initial=-1)) + 1

    def elements(self, values: Array) -> Array:
        """Return the value of each element, (n_elements, ...), from an array of the values of all entries."""
        found = np.empty((self.n_elements, *values.shape[self.index.ndim :]))
        if self.n_elements:
            free = self.index >= 0
            found[self.index[free]] = values[free]
        return found

    def pairs(self) -> Matrix:
        """Return the bounds of each element, (n_elements, 2), from one pair or one for each entry."""
        bounds = np.asarray(self.bounds, dtype=float)
        if (
            bounds.shape[-1:] != (2,)
            or not (bounds[..., 0] < bounds[..., 1]).all()
            or (self.log and not (bounds > 0).all())
        ):
            raise ValueError(
                f"Got bounds {self.bounds!r} of {self.name}, but expected "
                f"{'0 < ' if self.log else ''}lower < upper: a pair, or one for each entry."
            )
        if bounds.shape == (2,):
            return np.tile(bounds, (self.n_elements, 1))
        return self.elements(np.broadcast_to(bounds, (*self.index.shape, 2)))


class MultiOutputKernel(Kernel):
    """Covariance between the outputs of a vector-valued process, as a scikit-learn ``Kernel``.

    Inputs are one (n_i, d) array for each output, so outputs observed at different samples need no
    padding. A single (n, d) array means the same samples for every output. Matrices are
    output-major: all samples of the first output, then all samples of the second.

    A new kernel needs a constructor as scikit-learn requires it, the properties ``n_outputs`` and
    ``n_features``, and four methods: ``block``, ``block_gradient``, ``block_diag`` and
    ``free_parameters``. These are enough for exact and sparse inference. The other methods are
    optional: each has a default or raises an error that names the method.
    """

    @property
    @abstractmethod
    def n_outputs(self) -> int:
        """Number of outputs P."""

    @property
    @abstractmethod
    def n_features(self) -> int:
        """Number of regressors d."""

    @property
    def n_processes(self) -> int:
        """Number of terms that are no trends, by default one."""
        return 1

    # -- required methods
    # ------------------------------------------------------------------------------

    @abstractmethod
    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        """Return cov(y_i(Xi), y_j(Xj)), (n_i, n_j)."""

    @abstractmethod
    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        """Return sum(W * dK_ij / dtheta), (n_theta,), without the (n_i, n_j, n_theta) array of derivatives."""

    @abstractmethod
    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        """Return var(y_i(Xi)), (n_i,)."""

    @abstractmethod
    def free_parameters(self) -> list[FreeParameter]:
        """Return the parameters that form theta, in the order of theta."""

    # -- optional methods
    # ------------------------------------------------------------------------------

    def couples(self, i: int, j: int) -> bool:
        """Return whether cov(y_i, y_j) can differ from zero; otherwise ``block`` is not called for the pair."""
        return True

    def at_pairs(self, i: int, pairs: RowPairs) -> tuple[Vector, Callable[[Vector], Vector]]:
        """Return cov(y_i(x), y_i(x')) of pairs of rows, (n_pairs,), and its gradient.

        The gradient is the function from weights w (n_pairs,) to sum(w * dcov / dtheta).
        """

        def gradient(w):
            W = np.zeros((len(pairs.X),) * 2)
            W.ravel()[pairs.place] = w
            return self.block_gradient(i, i, pairs.X, pairs.X, W)

        return self.block(i, i, pairs.X, pairs.X).ravel()[pairs.place], gradient

    def block_derivative(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Array:
        """Return d cov(y_i(Xi), y_j(Xj)) / dXi, (d, n_i, n_j).

        The default uses central differences of fourth order, for regressors of about unit size.
        """
        Xi, Xj = np.asarray(Xi, dtype=float), np.asarray(Xj, dtype=float)
        if self.is_stationary() and len(
            Xj
        ):  # avoid rounding of small steps at points far from zero
            Xi, Xj = Xi - Xj[0], Xj - Xj[0]
        return np.stack(
            [
                _difference(lambda x: self.block(i, j, Xi + x, Xj), unit)
                for unit in np.eye(Xi.shape[1])
            ]
        )

    def has_values(self) -> bool:
        """Return whether all parameter values are given."""
        return all(
            getattr(self, parameter.name) is not None for parameter in self.free_parameters()
        )

    def initialize(
        self,
        X: Matrix,
        Y: Matrix,
        random_state: Seed,
        singles: Sequence | None = None,
        coarse: MultiOutputKernel | None = None,
        width_factor: float = 1.0,
    ) -> MultiOutputKernel:
        """Return the kernel with missing values and bounds estimated from data.

        X is (n, d), Y is (n, P) with NaN where an output was not observed. ``singles`` (fits of
        each output with ``single_output``) and a fit of ``coarse`` give better starting values.
        ``width_factor`` multiplies the default starting widths. Given values do not change.
        """
        if not self.has_values():
            raise ValueError(
                f"{type(self).__name__} cannot estimate values from data: give all of its "
                f"parameters."
            )
        for what, data, expected in (
            ("outputs", Y, self.n_outputs),
            ("regressors", X, self.n_features),
        ):
            if data.shape[1] != expected:
                raise ValueError(
                    f"Got data of {data.shape[1]} {what}, but expected {expected}, as many as the "
                    f"kernel {type(self).__name__} has."
                )
        return self

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        """Return the kernel of the outputs in another unit, in which their values are multiplied by ``factor``.

        The covariance of outputs i and j is multiplied by ``factor[i] * factor[j]``; factors (P,)
        are positive. Values and bounds are converted. The default wraps the kernel, and unwraps it
        when the product of all factors is one.
        """
        factor = np.asarray(factor, dtype=float)
        return self if np.allclose(factor, 1.0, rtol=1e-12, atol=0.0) else Rescaled(self, factor)

    def bounds_from_data(self, name: str) -> bool:
        """Return whether ``initialize`` estimates the bounds of a parameter from data, by default False."""
        return False

    def coarse(self) -> MultiOutputKernel:
        """Return a kernel without values and with fewer hyperparameters, to be fitted first, or the kernel itself."""
        return self

    def single_output(self) -> MultiOutputKernel | None:
        """Return a kernel without values for a separate fit of one output; None: outputs are fitted jointly alone."""
        return None

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        """Return the residuals (n, P) that initialize the other terms of a sum, by default Y."""
        return Y

    def summands(self) -> list[MultiOutputKernel]:
        """Return the kernels that add up to this one, which are not sums themselves."""
        return [self]

    def term_regressors(self) -> list[tuple[int, ...]]:
        """Return the regressors of every independent term of the kernel: columns of X, and () for a constant."""
        return [tuple(range(self.n_features))]

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        """Return the kernel, in the same shape, with only the terms of exactly these regressors; the others are zero.

        The kernels of all entries of ``term_regressors`` add up to the kernel.
        """
        if [regressors] == self.term_regressors():
            return self
        raise NotImplementedError(
            f"{type(self).__name__} does not define term, the terms of a sum of kernels."
        )

    # -- matrices
    # --------------------------------------------------------------------------------------

    def split(self, X: Matrix) -> list[np.ndarray]:
        """Return X as one array for each output."""
        per_output = isinstance(X, (list, tuple)) and len(X) > 0 and np.ndim(X[0]) == 2
        arrays = [np.asarray(x, dtype=float) for x in (X if per_output else [X])]
        if per_output and len(arrays) != self.n_outputs:
            raise ValueError(
                f"Got {len(arrays)} input arrays, but expected one for each of the "
                f"{self.n_outputs} outputs."
            )
        for x in arrays:
            if x.ndim != 2 or x.shape[1] != self.n_features:
                raise ValueError(
                    f"Got inputs of shape {x.shape}, but expected (n, {self.n_features}): one "
                    f"column for each "
                    "regressor of the kernel."
                )
        return arrays if per_output else arrays * self.n_outputs

    def __call__(self, X, Y=None, eval_gradient=False):
        """Return the covariance matrix, (sum n_i, sum n_j), output-major.

        X and Y are arrays (n, d), or lists of one (n_i, d) array per output; ``Y=None`` means
        ``Y=X``. With ``eval_gradient`` also return its derivatives by theta, (N, N, n_theta), for
        few samples: inference uses ``block`` and ``block_gradient``.
        """
        if eval_gradient and Y is not None:
            raise ValueError("Got eval_gradient=True with Y, but expected Y=None.")
        rows = self.split(X)
        columns = rows if Y is None else self.split(Y)
        K = np.block(
            [
                [self.block(i, j, Xi, Xj) for j, Xj in enumerate(columns)]
                for i, Xi in enumerate(rows)
            ]
        )
        return (K, self._gradient(rows)) if eval_gradient else K

    def _gradient(self, rows):
        """Return the derivatives of the covariance matrix by theta, entry by entry."""
        samples = [(i, x[None]) for i, Xi in enumerate(rows) for x in Xi]
        gradient = np.zeros((len(samples), len(samples), self.n_dims))
        one = np.ones((1, 1))
        for a, (i, x) in enumerate(samples):
            for b, (j, z) in enumerate(samples[: a + 1]):
                if self.couples(i, j):
                    gradient[a, b] = self.block_gradient(i, j, x, z, one)
                    gradient[b, a] = gradient[a, b]
        return gradient

    def diag(self, X: Matrix) -> Vector:
        """Return the diagonal of ``kernel(X)``, (sum n_i,)."""
        return np.concatenate([self.block_diag(i, Xi) for i, Xi in enumerate(self.split(X))])

    def __add__(self, other):
        return Sum(self, self._as_summand(other))

    def __radd__(self, other):
        return Sum(self._as_summand(other), self)

    @staticmethod
    def _as_summand(other):
        from skdgp.kernels._coregionalized import as_multi_output  # which imports this module

        if not isinstance(other, Kernel):
            raise TypeError(
                f"Got {other!r} to add to a multi-output kernel, but expected another kernel."
            )
        return as_multi_output(other)

    def _no_product(self, other):
        raise TypeError(
            f"Got a product with {other!r}, or a power, but multi-output kernels can be added, not "
            "multiplied. Change the amplitudes, or multiply scikit-learn's kernels inside "
            "Coregionalized."
        )

    __mul__ = __rmul__ = __pow__ = _no_product

    # -- hyperparameters
    # -------------------------------------------------------------------------------

    @property
    def hyperparameters(self) -> list:
        """Each hyperparameter with its number of elements and bounds."""
        return [_as_hyperparameter(f) for f in self.free_parameters() if f.fixed or f.n_elements]

    @property
    def theta(self):
        """Free hyperparameters, (n_theta,): the logarithms of positive parameters, and signed parameters themselves."""
        parts = [
            (f.elements(self.value(f.name)), f.log) for f in self.free_parameters() if f.n_elements
        ]
        return np.concatenate(
            [np.empty(0), *(np.log(part) if log else part for part, log in parts)]
        )

    @theta.setter
    def theta(self, theta: Vector | None):
        theta = np.asarray(theta, dtype=float)
        if theta.shape != (self.n_dims,):
            raise ValueError(f"Got theta of shape {theta.shape}, but expected ({self.n_dims},).")
        free, start, values = self.free_parameters(), 0, {}
        for f in free:
            if f.n_elements:
                part = theta[start : start + f.n_elements]
                start += f.n_elements
                value, chosen = self.value(f.name).copy(), f.index >= 0
                value[chosen] = (np.exp(part) if f.log else part)[f.index[chosen]]
                values[f.name] = value
        arrays = self.__dict__.get("_cache", {}).get("arrays")
        if arrays is not None:
            arrays = arrays | {name: frozen(value) for name, value in values.items()}
        for name, value in values.items():
            setattr(self, name, value)
        # other values, the same parameters
        self._cache = {"contents": self._contents(), "free": free}
        if arrays is not None:
            self._cache["arrays"] = arrays

    def clone_with_theta(self, theta: Vector) -> MultiOutputKernel:
        """Return a copy of the kernel with other free hyperparameters."""
        kernel = copy.copy(
            self
        )  # scikit-learn's clone copies every parameter, which costs more than a small matrix
        kernel._cache = dict(self.__dict__.get("_cache", {}))
        kernel.theta = theta
        return kernel

    @property
    def bounds(self) -> Matrix:
        """Bounds on theta, (n_theta, 2), of logarithms where theta holds logarithms."""
        parts = [
            np.log(f.pairs()) if f.log else f.pairs()
            for f in self.free_parameters()
            if f.n_elements
        ]
        return np.concatenate([np.empty((0, 2)), *parts])

    @property
    def n_dims(self) -> int:
        """Length of theta."""
        return sum(f.n_elements for f in self.free_parameters())

    def value(self, name: str) -> Array:
        """Return a parameter as an array of its full shape."""
        return np.asarray(getattr(self, name), dtype=float)

    def _cached(self, name, compute):
        """Return what ``compute()`` returned before, unless a parameter or an entry of one has changed."""
        cache = self.__dict__.get("_cache")
        if cache is None or any(_snapshot(value) != seen for value, seen in cache["contents"]):
            cache = self.__dict__["_cache"] = {"contents": self._contents()}
        if name not in cache:
            cache[name] = compute()
        return cache[name]

    def _contents(self):
        """Return the parameters whose entries can be set, with their entries."""
        return [
            (value, _snapshot(value))
            for name, value in self.__dict__.items()
            if name != "_cache" and _is_mutable(value)
        ]

    def __setattr__(self, name, value):
        if name != "theta":  # which sets parameters in turn
            self.__dict__.pop("_cache", None)  # values derived from the parameters
        super().__setattr__(name, value)

    def __getstate__(self):
        return {name: value for name, value in self.__dict__.items() if name != "_cache"}

    def __eq__(self, other):
        return type(self) is type(other) and _equal(self.get_params(), other.get_params())

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self):
        parameters = signature(type(self)).parameters
        shown = []
        for name, value in self.get_params(deep=False).items():
            if isinstance(value, Mapping):  # bounds; of each entry they are too long
                value = {key: pair for key, pair in value.items() if np.ndim(pair) < 2} or None
            if not _equal(value, parameters[name].default):
                shown.append(f"{name}={_as_text(value)}")
        return f"{type(self).__name__}({', '.join(shown)})"

    def is_stationary(self) -> bool:
        """Return whether the covariance depends only on x - x'."""
        return False

    def theta_gradient(self, gradients: dict[str, np.ndarray]) -> np.ndarray:
        """Return d/dtheta from derivatives by the parameter entries (by their logarithms where ``log``)."""
        masks = [(f, f.index >= 0) for f in self.free_parameters() if f.n_elements]
        parts = [
            np.bincount(f.index[free], weights=gradients[f.name][free], minlength=f.n_elements)
            for f, free in masks
        ]
        return np.concatenate([np.empty(0), *parts])


class Sum(_SklearnSum, MultiOutputKernel):
    """The sum of two multi-output kernels: the covariance of a sum of independent processes."""

    bounds = MultiOutputKernel.bounds  # scikit-learn's asks every kernel 2^depth times

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self._common("n_outputs")

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self._common("n_features")

    def _common(self, name):
        first, second = getattr(self.k1, name), getattr(self.k2, name)
        if first != second:
            raise ValueError(
                f"Got a sum of kernels with {name} {first} and {second}, but expected the same "
                f"number."
            )
        return first

    def couples(self, i: int, j: int) -> bool:
        return self.k1.couples(i, j) or self.k2.couples(i, j)

    @property
    def n_processes(self) -> int:
        return self.k1.n_processes + self.k2.n_processes

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        if not (self.k1.couples(i, j) and self.k2.couples(i, j)):
            return (self.k1 if self.k1.couples(i, j) else self.k2).block(i, j, Xi, Xj)
        K = self.k1.block(i, j, Xi, Xj)
        K += self.k2.block(i, j, Xi, Xj)
        return K

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        return np.concatenate([k.block_gradient(i, j, Xi, Xj, W) for k in (self.k1, self.k2)])

    def at_pairs(self, i: int, pairs: RowPairs) -> tuple[Vector, Callable[[Vector], Vector]]:
        parts = [
            kernel.at_pairs(i, pairs)
            if kernel.couples(i, i)
            else (0.0, lambda w, kernel=kernel: np.zeros(kernel.n_dims))
            for kernel in (self.k1, self.k2)
        ]
        values, gradients = zip(*parts, strict=True)
        return sum(values), lambda w: np.concatenate([gradient(w) for gradient in gradients])

    def block_derivative(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Array:
        return self.k1.block_derivative(i, j, Xi, Xj) + self.k2.block_derivative(i, j, Xi, Xj)

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return self.k1.block_diag(i, Xi) + self.k2.block_diag(i, Xi)

    def initialize(
        self,
        X: Matrix,
        Y: Matrix,
        random_state: Seed,
        singles: Sequence | None = None,
        coarse: MultiOutputKernel | None = None,
        width_factor: float = 1.0,
    ) -> MultiOutputKernel:
        def options(name):
            hints = (
                singles and [getattr(s, name) for s in singles],
                coarse and getattr(coarse, name),
            )
            return dict(zip(("singles", "coarse"), hints, strict=True), width_factor=width_factor)

        first = self.k1.initialize(X, Y, random_state, **options("k1"))
        return Sum(
            first, self.k2.initialize(X, first.residual(X, Y), random_state, **options("k2"))
        )

    def coarse(self) -> MultiOutputKernel:
        return Sum(self.k1.coarse(), self.k2.coarse())

    def has_values(self) -> bool:
        return self.k1.has_values() and self.k2.has_values()

    def summands(self) -> list[MultiOutputKernel]:
        return [*self.k1.summands(), *self.k2.summands()]

    def term_regressors(self) -> list[tuple[int, ...]]:
        return list(dict.fromkeys([*self.k1.term_regressors(), *self.k2.term_regressors()]))

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        return Sum(self.k1.term(regressors), self.k2.term(regressors))

    def single_output(self) -> MultiOutputKernel | None:
        first, second = self.k1.single_output(), self.k2.single_output()
        return None if first is None or second is None else Sum(first, second)

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        return self.k2.residual(X, self.k1.residual(X, Y))

    def clone_with_theta(self, theta: Vector) -> MultiOutputKernel:
        n = self.k1.n_dims
        return Sum(self.k1.clone_with_theta(theta[:n]), self.k2.clone_with_theta(theta[n:]))

    def free_parameters(self) -> list[FreeParameter]:
        return [*self.k1.free_parameters(), *self.k2.free_parameters()]

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        return Sum(self.k1.rescaled(factor), self.k2.rescaled(factor))


class Rescaled(MultiOutputKernel):
    r"""The kernel of outputs multiplied by factors: :math:`f_i f_j K_{ij}`.

    Theta is the theta of ``kernel``, but signed entries are divided by ``unit``, their starting
    values, so that a search does not depend on the unit of the outputs.

    Parameters
    ----------
    kernel : MultiOutputKernel
    factor : array (P,)
        Positive.
    unit : array (n_theta,) or None
        Ones for logarithms. None: ones.
    """

    def __init__(self, kernel: MultiOutputKernel, factor: Any, unit: Any = None) -> None:
        self.kernel = kernel
        self.factor = factor
        self.unit = unit

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        return self.kernel.rescaled(np.asarray(self.factor) * factor)

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return self.kernel.n_outputs

    @property
    def n_features(self) -> int:
        """Number of regressors d."""
        return self.kernel.n_features

    @property
    def n_processes(self) -> int:
        return self.kernel.n_processes

    def couples(self, i: int, j: int) -> bool:
        return self.kernel.couples(i, j)

    def is_stationary(self) -> bool:
        return self.kernel.is_stationary()

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        return self.factor[i] * self.factor[j] * self.kernel.block(i, j, Xi, Xj)

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return self.factor[i] ** 2 * self.kernel.block_diag(i, Xi)

    def block_derivative(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Array:
        return self.factor[i] * self.factor[j] * self.kernel.block_derivative(i, j, Xi, Xj)

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        W = self.factor[i] * self.factor[j] * W
        return self.kernel.block_gradient(i, j, Xi, Xj, W) * self._units()

    def at_pairs(self, i: int, pairs: RowPairs) -> tuple[Vector, Callable[[Vector], Vector]]:
        square = self.factor[i] ** 2
        values, gradient = self.kernel.at_pairs(i, pairs)
        return square * values, lambda w: gradient(square * w) * self._units()

    def free_parameters(self) -> list[FreeParameter]:
        return self.kernel.free_parameters()

    def value(self, name: str) -> Array:
        return self.kernel.value(name)

    @property
    def theta(self):
        """Free hyperparameters of the kernel, signed ones over their units, (n_theta,)."""
        return self.kernel.theta / self._units()

    @theta.setter
    def theta(self, theta: Vector | None):
        self.kernel = self.kernel.clone_with_theta(np.asarray(theta) * self._units())

    @property
    def bounds(self) -> Matrix:
        """Bounds on theta, (n_theta, 2)."""
        return self.kernel.bounds / self._units()[:, None]

    def _units(self):
        return np.ones(self.n_dims) if self.unit is None else self.unit

    def has_values(self) -> bool:
        return self.kernel.has_values()

    def initialize(
        self,
        X: Matrix,
        Y: Matrix,
        random_state: Seed,
        singles: Sequence | None = None,
        coarse: MultiOutputKernel | None = None,
        width_factor: float = 1.0,
    ) -> MultiOutputKernel:
        kernel = self.kernel.initialize(X, Y / self.factor, random_state, width_factor=width_factor)
        units = [np.empty(0)]
        for f in kernel.free_parameters():
            size = np.abs(f.elements(kernel.value(f.name)))
            units.append(np.ones(f.n_elements) if f.log else np.where(size > 0, size, 1.0))
        return Rescaled(kernel, self.factor, np.concatenate(units))

    def summands(self) -> list[MultiOutputKernel]:
        parts = self.kernel.summands()
        return [self] if len(parts) == 1 else [part.rescaled(self.factor) for part in parts]

    def term_regressors(self) -> list[tuple[int, ...]]:
        return self.kernel.term_regressors()

    def term(self, regressors: tuple[int, ...]) -> MultiOutputKernel:
        return Rescaled(self.kernel.term(regressors), self.factor)

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        return self.kernel.residual(X, Y / self.factor) * self.factor


def _difference(function, unit):
    """Return the derivative along a unit vector at zero, by central differences of fourth order."""
    near, far = (
        function(k * DERIVATIVE_STEP * unit) - function(-k * DERIVATIVE_STEP * unit) for k in (1, 2)
    )
    return (8 * near - far) / (12 * DERIVATIVE_STEP)


def as_shape(name: str, value: Any, shape) -> np.ndarray:
    """Return a parameter broadcast to its shape, or raise a ValueError with the expected shape."""
    value = np.array(value, dtype=float)
    try:
        return np.array(np.broadcast_to(value, shape))
    except ValueError:
        raise ValueError(
            f"Got {name} of shape {value.shape}, but expected {tuple(shape)} or a shape that "
            f"broadcasts to it."
        ) from None


def frozen(array: Array) -> Array:
    """Return an array of derived values, read-only from now on."""
    array.setflags(write=False)
    return array


def complete_bounds(given: Mapping[str, Any] | None, defaults: Mapping[str, Any]) -> dict[str, Any]:
    """Return the bounds of all parameters; a parameter that is not given, or None, has its default.

    Raises TypeError if the given bounds are no mapping, ValueError for a name without a default.
    """
    if not (given is None or isinstance(given, Mapping)):
        raise TypeError(
            f"Got parameter_bounds={given!r}, but expected bounds by the name of the parameter, such "
            f"as {{{next(iter(defaults))!r}: (0.1, 10.0)}}."
        )
    for name in given or {}:
        if name not in defaults:
            near = get_close_matches(str(name), defaults, n=1) or [" or ".join(defaults)]
            raise ValueError(f"Got {name!r} in parameter_bounds: did you mean {near[0]}?")
    return dict(defaults) | {k: v for k, v in (given or {}).items() if v is not None}


def given_bounds(kernel: MultiOutputKernel, names: Iterable[str]) -> dict[str, Any]:
    """Return the bounds that were given to a kernel, by the name of the parameter, one of ``names``."""
    given = complete_bounds(kernel.get_params(deep=False)["parameter_bounds"], dict.fromkeys(names))
    return {name: bounds for name, bounds in given.items() if bounds is not None}


def _equal(mine, theirs):
    """Return whether two parameters are equal: numbers, arrays, kernels or mappings of these."""
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        return set(mine) == set(theirs) and all(_equal(mine[k], theirs[k]) for k in mine)
    return np.array_equal(mine, theirs)


class FrozenBounds(Mapping):
    """Bounds by the name of the parameter that cannot be set, with copies of the arrays."""

    def __init__(self, bounds: Mapping[str, Any]) -> None:
        self._bounds = {
            name: pairs if isinstance(pairs, str) else frozen(np.array(pairs, dtype=float))
            for name, pairs in bounds.items()
        }

    def __getitem__(self, name: str) -> Any:
        return self._bounds[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bounds)

    def __len__(self) -> int:
        return len(self._bounds)

    def __repr__(self) -> str:
        return _as_text(self)

    def __reduce__(self):
        return FrozenBounds, (self._bounds,)  # the arrays of a copy are read-only, too


def _is_mutable(value):
    """Return whether entries of a parameter can be set."""
    if isinstance(value, np.ndarray):
        return value.flags.writeable or value.base is not None  # a view of an array that can be
    return isinstance(value, (list, Mapping)) and not isinstance(value, FrozenBounds)


def _snapshot(value):
    """Return the entries of a parameter, which compare as equal as long as none of them is set."""
    if isinstance(value, np.ndarray):
        return value.tobytes()
    if isinstance(value, Mapping):
        return {key: _snapshot(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_snapshot(entry) for entry in value]
    return value


def _as_text(value):
    """Return a parameter as text in one line, with three digits; of long arrays the ends."""
    if isinstance(value, Mapping):
        return f"{{{', '.join(f'{key!r}: {_as_text(entry)}' for key, entry in value.items())}}}"
    if isinstance(value, float):
        return f"{value:.3g}"
    if isinstance(value, (np.ndarray, list)):
        options: Any = {
            "separator": ", ",
            "threshold": SHOWN_ENTRIES,
            "edgeitems": 1,
            "formatter": {"float_kind": lambda number: f"{number:.3g}"},
        }
        return " ".join(np.array2string(np.asarray(value), **options).split())
    return repr(value)


def rescaled_values(name: str, value: Any, factor: Vector, axis: int) -> Any:
    """Return a parameter, or bounds, in the unit of the outputs multiplied by factors (P,); None and texts stay.

    ``axis`` is the axis of the outputs, counted from the last one.
    """
    if value is None or isinstance(value, str):
        return value
    values = np.asarray(value, dtype=float)
    if (factor == factor[0]).all():
        return values * factor[0]
    try:
        return values * factor.reshape(-1, *(1,) * (-1 - axis))
    except ValueError:
        raise ValueError(
            f"Got {name} of shape {values.shape}, but expected {len(factor)} entries, one for each "
            f"output, along axis {axis}."
        ) from None


def hyperparameter(name: str) -> property:
    """Return scikit-learn's attribute ``hyperparameter_<name>`` of a kernel."""

    def get(kernel):
        (parameter,) = (f for f in kernel.free_parameters() if f.name == name)
        return _as_hyperparameter(parameter)

    return property(get, doc=f"Number of free elements and bounds of ``{name}``.")


def _as_hyperparameter(f):
    if f.fixed:
        return Hyperparameter(f.name, "numeric", "fixed", 1)
    return Hyperparameter(f.name, "numeric", f.pairs(), f.n_elements)


def renumber(index: Indices, free):
    """Return the index with the free entries renumbered 0, 1, 2, ... and -1 for the other entries."""
    numbers = np.full(index.shape, -1)
    free = np.broadcast_to(free, index.shape)
    numbers[free] = np.unique(index[free], return_inverse=True)[1]
    return numbers
