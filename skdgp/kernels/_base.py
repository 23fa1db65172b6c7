"""The base class of kernels, MultiOutputKernel, and sums of kernels."""

from __future__ import annotations

import copy
from abc import abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from inspect import signature
from typing import Any, NamedTuple, Protocol

import numpy as np
from sklearn.base import clone
from sklearn.gaussian_process.kernels import Hyperparameter, Kernel
from sklearn.gaussian_process.kernels import Sum as _SklearnSum

from skdgp._compute.linalg import consecutive
from skdgp._compute.typing import Array, Indices, Mask, Matrix, Seed, Vector

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
                f"Got bounds {self.bounds!r} of {self.name}, but expected a pair, an array of pairs, or 'fixed'."
            )
        return isinstance(self.bounds, str)

    @property
    def free(self) -> Mask:
        """Whether an entry is free, in the shape of the array."""
        return np.zeros(self.index.shape, dtype=bool) if self.fixed else self.index >= 0

    @property
    def n_elements(self) -> int:
        """Number of entries of theta for this parameter."""
        return 0 if self.fixed else int(self.index.max(initial=-1)) + 1

    def elements(self, values: Array) -> Array:
        """Return the value of each element, (n_elements, ...), from an array of the values of all entries."""
        elements = np.empty((self.n_elements, *values.shape[self.index.ndim :]))
        elements[self.index[self.free]] = values[self.free]
        return elements

    def with_elements(self, values: Array, elements: Vector) -> Array:
        """Return a copy of the values of all entries, with the elements in the free ones."""
        changed = np.array(values)
        changed[self.free] = elements[self.index[self.free]]
        return changed

    def pairs(self) -> Matrix:
        """Return the bounds of each element, (n_elements, 2), from one pair or one for each entry."""
        if self.fixed:
            return np.empty((0, 2))
        bounds = np.asarray(self.bounds, dtype=float)
        lower = "0 < lower" if self.log else "lower"
        is_pair = bounds.shape[-1:] == (2,) and (bounds[..., 0] <= bounds[..., 1]).all()
        if not is_pair or (self.log and not (bounds > 0).all()):
            raise ValueError(
                f"Got bounds {self.bounds!r} of {self.name}, but expected {lower} <= upper: "
                "a pair, or one for each entry."
            )
        return self.elements(np.broadcast_to(bounds, (*self.index.shape, 2)))


class InputPair(NamedTuple):
    """Inputs Xi (n_i, d) of output i and Xj (n_j, d) of output j."""

    i: int
    j: int
    Xi: Matrix
    Xj: Matrix


class EvaluatedBlock(Protocol):
    """The covariance of a pair of inputs, and its derivatives by theta."""

    def covariance(self) -> Matrix:
        """Return K_ij, (n_i, n_j)."""
        ...

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        """Add sum(W * dK_ij / dtheta), for weights W (n_i, n_j), to ``total`` (n_theta,)."""
        ...

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        """Add dK_ij / dtheta beta, for beta (n_j,), to ``total`` (n_i, n_theta).

        ``transposed``: dK_ij^T / dtheta beta, for beta (n_i,), to ``total`` (n_j, n_theta).
        """
        ...


class MultiOutputKernel(Kernel):
    """Covariance between the outputs of a vector-valued process, as a scikit-learn ``Kernel``.

    Inputs are one (n_i, d) array for each output, so outputs observed at different samples need no
    padding. A single (n, d) array means the same samples for every output. Matrices are
    output-major: all samples of the first output, then all samples of the second.

    A new kernel needs a constructor as scikit-learn requires it, the properties ``n_outputs`` and
    ``n_features``, and five methods: ``block``, ``block_gradient``, ``block_diag``,
    ``free_parameters`` and ``rescaled``. These are enough for exact and sparse inference. The other
    methods are optional: each has a default or raises an error that names the method.
    """

    @property
    @abstractmethod
    def n_outputs(self) -> int:
        """Number of outputs P."""

    @property
    @abstractmethod
    def n_features(self) -> Any:
        """Number of regressors d, None for a kernel that takes any number."""

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

    @abstractmethod
    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        """Return the kernel of the outputs in other units: values multiplied by ``factor``.

        The covariance of outputs i and j is multiplied by ``factor[i] * factor[j]``; factors (P,)
        are positive. Values and bounds are converted.
        """

    # -- optional methods
    # ------------------------------------------------------------------------------

    def couples(self, i: int, j: int) -> bool:
        """Return whether cov(y_i, y_j) can differ from zero; otherwise ``block`` is not called for the pair."""
        return True

    def evaluate(self, pairs: Sequence[InputPair]) -> Sequence[EvaluatedBlock]:
        """Return the covariance of each pair, with its derivatives by theta.

        The default is of ``block`` and ``block_gradient``. For kernels that save time by computing
        these together.
        """
        return [_EvaluatedPair(self, pair) for pair in pairs]

    def has_values(self) -> bool:
        """Return whether all parameter values are given."""
        return all(getattr(self, f.name) is not None for f in self.free_parameters())

    def initialize(self, X: Matrix, Y: Matrix, random_state: Seed) -> MultiOutputKernel:
        """Return the kernel with missing values and bounds estimated from data.

        X is (n, d), Y is (n, P) with NaN where an output was not observed. Given values do not
        change.
        """
        if not self.has_values():
            raise ValueError(
                f"{type(self).__name__} cannot estimate values from data: give all of its parameters."
            )
        self._check_columns("outputs", Y, self.n_outputs)
        self._check_columns("regressors", X, self.n_features)
        return self

    def _check_columns(self, what, data, expected):
        if expected not in (None, data.shape[1]):
            raise ValueError(
                f"Got data of {data.shape[1]} {what}, but expected {expected}, "
                f"as many as the kernel {type(self).__name__} has."
            )

    def bounds_from_data(self, name: str) -> bool:
        """Return whether ``initialize`` estimates the bounds of a parameter from data, by default False."""
        return False

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        """Return the residuals (n, P) that initialize the other terms of a sum, by default Y."""
        return Y

    def summands(self) -> list[MultiOutputKernel]:
        """Return the kernels that add up to this one, which are not sums themselves."""
        return [self]

    # -- matrices
    # --------------------------------------------------------------------------------------

    def split(self, X: Matrix) -> list[np.ndarray]:
        """Return X as one array for each output."""
        if is_per_output(X):
            arrays = [np.asarray(x, dtype=float) for x in X]
            if len(arrays) != self.n_outputs:
                raise ValueError(
                    f"Got {len(arrays)} input arrays, but expected one for each of the {self.n_outputs} outputs."
                )
        else:
            arrays = [np.asarray(X, dtype=float)] * self.n_outputs
        for x in arrays:
            if x.ndim != 2 or self.n_features not in (None, x.shape[1]):
                raise ValueError(
                    f"Got inputs of shape {x.shape}, but expected (n, {self.n_features}): "
                    "one column for each regressor of the kernel."
                )
        return arrays

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
        matrix = []
        for i, Xi in enumerate(rows):
            blocks = [self.block(i, j, Xi, Xj) for j, Xj in enumerate(columns)]
            matrix.append(np.hstack(blocks))
        K = np.vstack(matrix)
        if eval_gradient:
            return K, self._gradient(rows)
        return K

    def _gradient(self, rows):
        """Return the derivatives of the covariance matrix by theta, column by column."""
        places = consecutive(rows)
        pairs = []
        for i, j in np.ndindex(len(rows), len(rows)):
            if self.couples(i, j):
                pairs.append(InputPair(i, j, rows[i], rows[j]))
        n = places[-1].stop
        gradient = np.zeros((n, n, self.n_dims))
        for pair, evaluated in zip(pairs, self.evaluate(pairs), strict=True):
            block = gradient[places[pair.i], places[pair.j]]
            for column, unit in enumerate(np.eye(len(pair.Xj))):
                evaluated.add_products(block[:, column], unit)
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
            f"Got a product with {other!r}, or a power, but multi-output kernels can be added, not multiplied. "
            "Change the amplitudes, or multiply scikit-learn's kernels inside Coregionalized."
        )

    __mul__ = __rmul__ = __pow__ = _no_product

    # -- hyperparameters
    # -------------------------------------------------------------------------------

    @property
    def hyperparameters(self) -> list:
        """Each hyperparameter with its number of elements and bounds."""
        parameters = []
        for f in self.free_parameters():
            if f.fixed:
                parameters.append(Hyperparameter(f.name, "numeric", "fixed"))
            elif f.n_elements:
                parameters.append(Hyperparameter(f.name, "numeric", f.pairs(), f.n_elements))
        return parameters

    @property
    def theta(self):
        """Free hyperparameters, (n_theta,): the logarithms of positive parameters, and signed parameters themselves."""
        values = self.values()
        theta = [np.empty(0)]
        for f in self.free_parameters():
            elements = f.elements(values[f.name])
            theta.append(np.log(elements) if f.log else elements)
        return np.concatenate(theta)

    @theta.setter
    def theta(self, theta: Vector | None):
        theta = self._check_theta(theta)
        values = self.values()
        for f in self.free_parameters():
            elements, theta = theta[: f.n_elements], theta[f.n_elements :]
            if len(elements):
                elements = np.exp(elements) if f.log else elements
                setattr(self, f.name, f.with_elements(values[f.name], elements))

    def _check_theta(self, theta):
        theta = np.asarray(theta, dtype=float)
        if theta.shape != (self.n_dims,):
            raise ValueError(f"Got theta of shape {theta.shape}, but expected ({self.n_dims},).")
        return theta

    def clone_with_theta(self, theta: Vector) -> MultiOutputKernel:
        """Return a copy of the kernel with other free hyperparameters."""
        # scikit-learn's clone copies every parameter, which costs more than a small matrix
        kernel = copy.copy(self)
        kernel.theta = theta
        return kernel

    @property
    def bounds(self) -> Matrix:
        """Bounds on theta, (n_theta, 2), of logarithms where theta holds logarithms."""
        bounds = [np.empty((0, 2))]
        for f in self.free_parameters():
            bounds.append(np.log(f.pairs()) if f.log else f.pairs())
        return np.concatenate(bounds)

    @property
    def n_dims(self) -> int:
        """Length of theta."""
        return sum(f.n_elements for f in self.free_parameters())

    def values(self) -> dict[str, Array]:
        """Return the parameters as arrays of their full shapes."""
        return {
            f.name: np.asarray(getattr(self, f.name), dtype=float) for f in self.free_parameters()
        }

    def value(self, name: str) -> Array:
        """Return a parameter as an array of its full shape."""
        return self.values()[name]

    def __eq__(self, other):
        return type(self) is type(other) and _equal(self.get_params(), other.get_params())

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self):
        parameters = signature(type(self)).parameters
        shown = []
        with np.printoptions(precision=3, threshold=SHOWN_ENTRIES, edgeitems=1):
            for name, value in self.get_params(deep=False).items():
                if isinstance(value, Mapping):  # bounds; of each entry they are too long
                    value = {k: pair for k, pair in value.items() if np.ndim(pair) < 2} or None
                if not _equal(value, parameters[name].default):
                    text = f"{value:.3g}" if isinstance(value, float) else repr(value)
                    shown.append(f"{name}={text}")
        return " ".join(f"{type(self).__name__}({', '.join(shown)})".split())

    def is_stationary(self) -> bool:
        """Return whether the covariance depends only on x - x'."""
        return False

    def theta_gradient(self, gradients: dict[str, np.ndarray]) -> np.ndarray:
        """Return d/dtheta from derivatives by the parameter entries (by their logarithms where ``log``)."""
        total = np.zeros(self.n_dims)
        for name, places in self.theta_places().items():
            free = places >= 0
            np.add.at(total, places[free], gradients[name][free])
        return total

    def add_curvature(self, total: Matrix, slopes: Mapping[tuple[int, int], Vector]) -> None:
        """Add the second derivatives of sum(W * K) by theta that matter where first derivatives are zero.

        By default there are none.

        Parameters
        ----------
        total : ndarray (n_theta, n_theta)
        slopes : mapping
            sum(W * dK_ij / dtheta), (n_theta,), of each pair of outputs (i, j).
        """

    def theta_places(self) -> dict[str, Indices]:
        """Return the place in theta of each entry of each parameter, -1 where it is fixed."""
        places = {}
        start = 0
        for f in self.free_parameters():
            places[f.name] = np.where(f.free, start + f.index, -1)
            start += f.n_elements
        return places


def add_at(total: Matrix, places: Indices, slopes: Array) -> None:
    """Add derivatives (n, ...) by entries with different ``places`` (...) in theta to ``total`` (n, n_theta)."""
    free = places >= 0
    if free.any():
        total[:, places[free]] += slopes[:, free]


class EstimatedKernel(MultiOutputKernel):
    """A kernel whose values and bounds are estimated from data where they are None.

    ``needed`` are the parameters without which it has no values, ``default_bounds`` the bounds of a
    kernel with values that was not initialized from data, ``output_axes`` the axis of the outputs,
    counted from the last one, of each parameter in units of the outputs.
    """

    needed: tuple[str, ...]
    default_bounds: Mapping[str, Any]
    output_axes: Mapping[str, int]
    parameter_bounds: Mapping[str, Any] | None

    def has_values(self) -> bool:
        return all(getattr(self, name) is not None for name in self.needed)

    def _check_values(self):
        if not self.has_values():
            raise ValueError(
                f"{type(self).__name__} has no values yet: give {' and '.join(self.needed)}, "
                "or let DependentGPRegressor.fit estimate from the data."
            )

    def given_bounds(self) -> dict[str, Any]:
        """Return the bounds that were given, by the name of the parameter.

        Raises TypeError if they are no mapping, ValueError for a name of no parameter.
        """
        given = self.parameter_bounds
        names = list(self.default_bounds)
        if not (given is None or isinstance(given, Mapping)):
            raise TypeError(
                f"Got parameter_bounds={given!r}, but expected bounds by the name of the parameter, "
                f"such as {{{names[0]!r}: (0.1, 10.0)}}."
            )
        for name in given or {}:
            if name not in names:
                near = get_close_matches(str(name), names, n=1) or [" or ".join(names)]
                raise ValueError(f"Got {name!r} in parameter_bounds: did you mean {near[0]}?")
        return {name: bounds for name, bounds in (given or {}).items() if bounds is not None}

    def bounds_by_name(self) -> dict[str, Any]:
        """Return the bounds of all parameters, the default ones where none were given."""
        return {**self.default_bounds, **self.given_bounds()}

    def bounds_from_data(self, name: str) -> bool:
        return name in self.default_bounds and name not in self.given_bounds()

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        total = np.zeros(self.n_dims)
        self.evaluate([InputPair(i, j, Xi, Xj)])[0].add_gradient(total, W)
        return total

    def _completed(self, values, bounds):
        """Return the kernel with these values and bounds where none were given."""
        params = self.get_params(deep=False)
        for name, value in values.items():
            given = value if params[name] is None else params[name]
            params[name] = as_shape(name, given, value.shape)
        params["parameter_bounds"] = bounds | self.given_bounds()
        return type(self)(**params)

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        factor = np.asarray(factor, dtype=float)
        bounds = dict(self.parameter_bounds or {})
        changed = {}
        for name, axis in self.output_axes.items():
            changed[name] = _rescaled_values(name, getattr(self, name), factor, axis)
            if name in bounds:  # whose last axis is the pair
                limits = _rescaled_values(f"bounds of {name}", bounds[name], factor, axis - 1)
                bounds[name] = limits
        return clone(self).set_params(**changed, parameter_bounds=bounds or None)


class Sum(_SklearnSum, MultiOutputKernel):
    """The sum of two multi-output kernels: the covariance of a sum of independent processes."""

    bounds = MultiOutputKernel.bounds  # scikit-learn's asks every kernel 2^depth times

    @property
    def n_outputs(self) -> int:
        """Number of outputs P."""
        return _common("n_outputs", self.k1.n_outputs, self.k2.n_outputs)

    @property
    def n_features(self) -> Any:
        """Number of regressors d, None for kernels that take any number."""
        return _common("n_features", self.k1.n_features, self.k2.n_features)

    def couples(self, i: int, j: int) -> bool:
        return self.k1.couples(i, j) or self.k2.couples(i, j)

    @property
    def n_processes(self) -> int:
        return self.k1.n_processes + self.k2.n_processes

    def block(self, i: int, j: int, Xi: Matrix, Xj: Matrix) -> Matrix:
        coupled = [term for term in (self.k1, self.k2) if term.couples(i, j)]
        return sum(term.block(i, j, Xi, Xj) for term in coupled or [self.k1])

    def block_gradient(self, i: int, j: int, Xi: Matrix, Xj: Matrix, W: Matrix) -> Vector:
        terms = (self.k1, self.k2)
        return np.concatenate([term.block_gradient(i, j, Xi, Xj, W) for term in terms])

    def evaluate(self, pairs: Sequence[InputPair]) -> Sequence[EvaluatedBlock]:
        n_first = self.k1.n_dims
        sums = [_EvaluatedSum([]) for _ in pairs]
        for term, places in ((self.k1, slice(n_first)), (self.k2, slice(n_first, None))):
            coupled = [k for k, pair in enumerate(pairs) if term.couples(pair.i, pair.j)]
            evaluated = term.evaluate([pairs[k] for k in coupled])
            for k, of_pair in zip(coupled, evaluated, strict=True):
                sums[k].terms.append((places, of_pair))
        return sums

    def block_diag(self, i: int, Xi: Matrix) -> Vector:
        return self.k1.block_diag(i, Xi) + self.k2.block_diag(i, Xi)

    def initialize(self, X: Matrix, Y: Matrix, random_state: Seed) -> MultiOutputKernel:
        first = self.k1.initialize(X, Y, random_state)
        second = self.k2.initialize(X, first.residual(X, Y), random_state)
        return Sum(first, second)

    def has_values(self) -> bool:
        return self.k1.has_values() and self.k2.has_values()

    def summands(self) -> list[MultiOutputKernel]:
        return [*self.k1.summands(), *self.k2.summands()]

    def residual(self, X: Matrix, Y: Matrix) -> Matrix:
        return self.k2.residual(X, self.k1.residual(X, Y))

    def clone_with_theta(self, theta: Vector) -> MultiOutputKernel:
        n_first = self.k1.n_dims
        first = self.k1.clone_with_theta(theta[:n_first])
        return Sum(first, self.k2.clone_with_theta(theta[n_first:]))

    def free_parameters(self) -> list[FreeParameter]:
        return [*self.k1.free_parameters(), *self.k2.free_parameters()]

    def add_curvature(self, total: Matrix, slopes: Mapping[tuple[int, int], Vector]) -> None:
        n_first = self.k1.n_dims
        for term, places in ((self.k1, slice(n_first)), (self.k2, slice(n_first, None))):
            of_term = {pair: of_pair[places] for pair, of_pair in slopes.items()}
            term.add_curvature(total[places, places], of_term)

    def rescaled(self, factor: Vector) -> MultiOutputKernel:
        return Sum(self.k1.rescaled(factor), self.k2.rescaled(factor))


class _EvaluatedPair:
    """`EvaluatedBlock` of any kernel."""

    def __init__(self, kernel: MultiOutputKernel, pair: InputPair) -> None:
        self.kernel = kernel
        self.pair = pair

    def covariance(self) -> Matrix:
        return self.kernel.block(*self.pair)

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        total += self.kernel.block_gradient(*self.pair, W)

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        i, j, Xi, Xj = self.pair
        if transposed:
            i, j, Xi, Xj = j, i, Xj, Xi
        for row, x in zip(total, Xi, strict=True):
            row += self.kernel.block_gradient(i, j, x[None], Xj, beta[None])


class _EvaluatedSum(NamedTuple):
    """`EvaluatedBlock` of a sum: of each term that couples the pair, and its places in theta."""

    terms: list[tuple[slice, EvaluatedBlock]]

    def covariance(self) -> Matrix:
        (_, first), *others = self.terms
        total = first.covariance()
        for _, evaluated in others:
            total += evaluated.covariance()
        return total

    def add_gradient(self, total: Vector, W: Matrix) -> None:
        for places, evaluated in self.terms:
            evaluated.add_gradient(total[places], W)

    def add_products(self, total: Matrix, beta: Vector, transposed: bool = False) -> None:
        for places, evaluated in self.terms:
            evaluated.add_products(total[:, places], beta, transposed)


def _common(name, first, second):
    """Return a number that both terms of a sum have in common, or the one that is known."""
    if first is None or second is None:
        return second if first is None else first
    if first != second:
        raise ValueError(
            f"Got a sum of kernels with {name} {first} and {second}, but expected the same number."
        )
    return first


def is_per_output(X: Any) -> bool:
    """Return whether inputs are one array for each output."""
    return isinstance(X, (list, tuple)) and len(X) > 0 and np.ndim(X[0]) == 2


def as_shape(name: str, value: Any, shape) -> np.ndarray:
    """Return a parameter broadcast to its shape, or raise a ValueError with the expected shape."""
    value = np.array(value, dtype=float)
    if value.shape == tuple(shape):
        return value
    try:
        return np.array(np.broadcast_to(value, shape))
    except ValueError:
        raise ValueError(
            f"Got {name} of shape {value.shape}, but expected {tuple(shape)} or a shape that broadcasts to it."
        ) from None


def _equal(mine, theirs):
    """Return whether two parameters are equal: numbers, arrays, kernels or mappings of these."""
    if isinstance(mine, Mapping) and isinstance(theirs, Mapping):
        return set(mine) == set(theirs) and all(_equal(mine[k], theirs[k]) for k in mine)
    return np.array_equal(mine, theirs)


def _rescaled_values(name: str, value: Any, factor: Vector, axis: int) -> Any:
    """Return a parameter, or bounds, in the unit of the outputs multiplied by factors (P,); None and texts stay.

    ``axis`` is the axis of the outputs, counted from the last one.
    """
    if value is None or isinstance(value, str):
        return value
    values = np.asarray(value, dtype=float)
    try:
        return values * factor.reshape(-1, *(1,) * (-1 - axis))
    except ValueError:
        raise ValueError(
            f"Got {name} of shape {values.shape}, but expected {len(factor)} entries, "
            f"one for each output, along axis {axis}."
        ) from None


def numbered(free: Mask) -> Indices:
    """Return the numbers 0, 1, 2, ... of the free entries, and -1 for the others."""
    numbers = np.cumsum(free).reshape(free.shape) - 1
    return np.where(free, numbers, -1)
