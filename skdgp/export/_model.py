"""The portable model: the posterior of an identified aircraft as arrays, evaluated by NumPy alone."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field
from functools import cached_property
from itertools import chain, groupby
from operator import attrgetter, mul
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.utils import gen_batches

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.dynamics import Aircraft

ROUNDING = float(np.finfo(float).eps)


def _squared_distances(u: Matrix, centres: Matrix) -> Matrix:
    return cdist(u, centres, "sqeuclidean")


class Arithmetic(NamedTuple):
    """Functions of arrays with one row for each sample, or of symbols with a single row.

    The evaluation of a model consists of these and of ``+ - * / **`` and ``@``.

    Parameters
    ----------
    exp, maximum : callable
        By element.
    columns : callable
        Of a list of arrays: all side by side.
    squared_distances : callable
        Of u (n, r) and centres (k, r): their squared distances (n, k).
    """

    exp: Callable = np.exp
    maximum: Callable = np.maximum
    columns: Callable = np.hstack
    squared_distances: Callable = _squared_distances


ARRAYS = Arithmetic()


def inertia_entries(aircraft: Aircraft) -> dict[str, float]:
    """Return the entries of the inertia tensor by name, such as ixx and ixz [kg m^2]."""
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    return dict(zip(names, aircraft.inertia[np.triu_indices(3)].tolist(), strict=True))


@dataclass(frozen=True)
class Regressor:
    r"""One regressor, and the columns of a flight table that it is computed from.

    .. math:: x = \left(\frac{L}{2V}\right)^n \sum_k c_k u_k

    Parameters
    ----------
    name, unit : str
        Such as ``q_hat`` and "".
    sources, factors : tuples of str and of float
        Columns u of a flight table, and their factors c: of the mixing for a control, else 1.
    length : float
        Reference length L [m] of a non-dimensional rate.
    power : {0, 1, 2}
        n: 0 for a column itself, 1 for a rate, 2 for an angular acceleration. V is the column
        ``airspeed`` [m/s].
    """

    name: str
    unit: str
    sources: tuple[str, ...]
    factors: tuple[float, ...] = (1.0,)
    length: float = 1.0
    power: int = 0

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that it is computed from."""
        return (*self.sources, "airspeed") if self.power else self.sources

    def values(self, table: Any) -> Vector:
        """Return the regressor (n,) of a table; without its sources, the column of its own name."""
        lacking = [name for name in self.columns if name not in table]
        if lacking and self.name in table:
            return np.asarray(table[self.name], dtype=float)
        if lacking:
            raise ValueError(
                f"Got a table without {lacking}, but the regressor {self.name} is computed from "
                f"{list(self.columns)}: add them, or a column {self.name}."
            )
        columns = [np.asarray(table[name], dtype=float) for name in self.sources]
        mixed = np.tensordot(self.factors, columns, 1)
        if not self.power:
            return mixed
        airspeed = np.asarray(table["airspeed"], dtype=float)
        return mixed * (self.length / (2 * airspeed)) ** self.power


@dataclass(frozen=True, eq=False)
class Term:
    r"""Gaussian functions of one width: neighbouring entries of the basis of one part.

    .. math:: g_k(z) = \mathrm{gain} \, \exp\left(-\frac{1}{2} |F^T z - c_k|^2\right)

    Parameters
    ----------
    first : int
        Entry of the basis that the first function adds to.
    gain : float
    root : ndarray (d, r)
        F; it has a row of zeros for each regressor that the functions do not depend on.
    centres : ndarray (k, r)
        c.
    """

    first: int
    gain: float
    root: Matrix
    centres: Matrix

    @property
    def entries(self) -> slice:
        """Entries of the basis that the functions add to."""
        return slice(self.first, self.first + len(self.centres))

    @property
    def regressors(self) -> tuple[int, ...]:
        """Places of the regressors that the functions depend on."""
        return tuple(np.flatnonzero(self.root.any(axis=1)).tolist())

    def functions(self, Z: Any, arithmetic: Arithmetic = ARRAYS) -> Any:
        """Return the functions at scaled regressors (n, d), (n, k)."""
        squares = arithmetic.squared_distances(Z @ self.root, self.centres)
        return self.gain * arithmetic.exp(-0.5 * squares)


@dataclass(frozen=True, eq=False)
class Readout:
    """Weights of the mean, and root of the explained variance, for a basis of k functions.

    Parameters
    ----------
    weights : ndarray (k,)
        w.
    root : ndarray (k, k)
        U, an upper triangle.
    """

    weights: Vector
    root: Matrix


@dataclass(frozen=True, eq=False)
class Part:
    r"""Normalised posterior of one output by one component of the average.

    With scaled regressors z, p = (1, z - ``trend_center``) and the basis g(z) of the terms,

    .. math:: \mu = v^T p + w^T g, \quad \nu = a + |R^T p|^2 - |h|^2, \quad
              h = T^T p + (0, U^T g).

    Parameters
    ----------
    terms : tuple of Term
    readout : Readout
        w and U, which acts on the last k entries of h; parts may share one.
    trend_weights : ndarray (d + 1,)
        v: posterior mean of intercept and slopes.
    trend_prior : ndarray (d + 1, s)
        R, a root of the prior covariance R R^T of intercept and slopes; any number s of columns.
    trend_root : ndarray (d + 1, r)
        T, with k <= r <= k + d + 1.
    prior_variance : float
        a, of the Gaussian functions, with the variance of the model discrepancy.
    """

    terms: tuple[Term, ...]
    readout: Readout
    trend_weights: Vector
    trend_prior: Matrix
    trend_root: Matrix
    prior_variance: float

    @cached_property
    def groups(self) -> list[list[Term]]:
        """Terms in the order of the basis; the terms of a group add up."""
        first = attrgetter("first")
        return [list(group) for _, group in groupby(sorted(self.terms, key=first), key=first)]

    @cached_property
    def used(self) -> Any:
        """Entries of the basis that are not zero: a slice, or places."""
        places = [np.r_[group[0].entries] for group in self.groups]
        n = len(self.readout.weights)
        if sum(map(len, places)) == n:
            return slice(0, n)
        return np.concatenate([np.arange(0), *places])

    def basis(self, Z: Any, arithmetic: Arithmetic = ARRAYS) -> Any:
        """Return the used entries of g at scaled regressors (n, d), (n, k)."""
        values = []
        for group in self.groups:
            values.append(sum(term.functions(Z, arithmetic) for term in group))
        return arithmetic.columns(values) if values else Z[:, :0]

    def mean(self, p: Any, g: Any) -> Any:
        """Return mu from p (n, d + 1) and the basis (n, k)."""
        return p @ self.trend_weights + self.functions_mean(g)

    def functions_mean(self, g: Any) -> Any:
        """Return w^T g from the basis (n, k)."""
        return g @ self.readout.weights[self.used]

    def explained(self, g: Any) -> Any:
        """Return U^T g from the basis (n, k)."""
        return g @ self.readout.root[self.used]

    def prior(self, p: Any) -> Any:
        """Return the prior variance ``a + |R^T p|^2``."""
        return self.prior_variance + _row_sum((p @ self.trend_prior) ** 2)

    def variance(self, p: Any, explained: Any, arithmetic: Arithmetic = ARRAYS) -> Any:
        """Return nu from p and U^T g."""
        prior = self.prior(p)
        unexplained = prior - _row_sum(self._half(p, explained, arithmetic) ** 2)
        return arithmetic.maximum(unexplained, ROUNDING * prior)

    def _half(self, p: Any, explained: Any, arithmetic: Arithmetic = ARRAYS) -> Any:
        """Return h = T^T p + (0, U^T g), (n, r)."""
        half = p @ self.trend_root
        first = self.trend_root.shape[1] - len(self.readout.weights)
        return arithmetic.columns([half[:, :first], half[:, first:] + explained])

    def slopes(self, Z: Matrix) -> Matrix:
        """Return d mu / d z, (n, d)."""
        slopes = np.tile(self.trend_weights[1:], (len(Z), 1))
        for term in self.terms:
            pull = term.functions(Z) * self.readout.weights[term.entries]
            away = pull @ term.centres - pull.sum(axis=1)[:, None] * (Z @ term.root)
            slopes += away @ term.root.T
        return slopes


def _batches(Z: Matrix, rows: int = 512) -> Iterator[slice]:
    """Yield the rows that are predicted at once."""
    yield from gen_batches(len(Z), rows)


def _row_sum(values: Any) -> Any:
    """Return the sum of each row, of arrays and symbols."""
    return values @ np.ones(values.shape[1])


@dataclass(frozen=True, eq=False)
class Reference:
    """Predictions of the pipeline that a model is exported from, at exact regressors.

    Parameters
    ----------
    regressors : ndarray (n, d)
        In their units, in and near the training data.
    mean, std : ndarray (n, P)
    """

    regressors: Matrix
    mean: Matrix
    std: Matrix


@dataclass(frozen=True, eq=False)
class PortableModel:
    r"""The posterior of the coefficients of an aircraft, as arrays.

    An output is the mixture of K posteriors, the components of an average; K is 1 for a single one.
    Component k of output i is the part j = k P + i, with mean mu and variance nu as in
    :class:`Part`. With the weights q (``mixture``), c ``center`` and s ``output_scale``,
    mean and variance of the coefficient are

    .. math:: \mu_i = \sum_k q_{ki} \mu_j, \quad m_i = c_i + s_i \mu_i, \quad
              \sigma_i^2 = s_i^2 \sum_k q_{ki} \left(\nu_j + (\mu_j - \mu_i)^2\right).

    This is the posterior of the function at exact regressors. At measured ones, whose noise has the
    covariance S (``input_covariance``), their noise adds :math:`J_i S J_i^T` to the
    variance, with the slopes J of the mean: on most flights the larger part.

    Parameters
    ----------
    regressors : tuple of Regressor
    outputs : tuple of str
    aircraft : Aircraft
    shift, scale : ndarray (d,)
        Scaled regressors are z = (x - shift) / scale.
    center, output_scale : ndarray (P,)
    trend_center : ndarray (d,)
        Point of the intercepts, in scaled regressors, of all parts.
    parts : tuple of Part
        K P.
    mixture : ndarray (K, P)
        Weight of each component for each output; columns add up to one.
    noise_variance : ndarray (P,)
        Of measurements of the coefficients; it is not in the deviation.
    input_covariance : ndarray (d, d)
        Covariance S of the noise of the regressors of the flights.
    limits : ndarray (2, d)
        Smallest and largest value of each regressor in the training data.
    servos : ndarray (3,)
        Time constant T [s], delay tau [s] and limit R of the rate of the servos, infinite where there is none:
        surfaces follow commands c by :math:`T \dot\delta(t) = c(t - \tau) - \delta(t)`.
    reference : Reference
        What an export is compared with.
    provenance : dict
        Facts: creation, versions, options and fit, as JSON knows them.
    """

    regressors: tuple[Regressor, ...]
    outputs: tuple[str, ...]
    aircraft: Aircraft
    shift: Vector
    scale: Vector
    center: Vector
    output_scale: Vector
    trend_center: Vector
    parts: tuple[Part, ...]
    mixture: Matrix
    noise_variance: Vector
    input_covariance: Matrix
    limits: Matrix
    servos: Vector
    reference: Reference
    provenance: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"PortableModel({', '.join(self.outputs)} of {', '.join(self.regressor_names)})"

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """Names of the d regressors, in order."""
        return tuple(regressor.name for regressor in self.regressors)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns of a flight that the regressors are computed from, each once."""
        columns = chain.from_iterable(regressor.columns for regressor in self.regressors)
        return tuple(dict.fromkeys(columns))

    @property
    def nbytes(self) -> int:
        """Bytes of all numbers."""
        return sum(array.nbytes for array in self.arrays().values())

    @property
    def readouts(self) -> list[Readout]:
        """The different readouts of the parts."""
        return list({id(part.readout): part.readout for part in self.parts}.values())

    def inside(self, X: Any) -> Any:
        """Return whether each row of X is within the range of every regressor, (n,)."""
        X = self.regressor_values(X)
        return np.logical_and(self.limits[0] <= X, self.limits[1] >= X).all(axis=1)

    def regressor_values(self, X: Any) -> Matrix:
        """Return regressors (n, d) of an array (n, d), or of a flight table by its columns.

        Raises ValueError if columns are missing, the shape is another, or a value is not finite.
        """
        if hasattr(X, "columns") or isinstance(X, dict):
            X = np.column_stack([regressor.values(X) for regressor in self.regressors])
        X = np.asarray(X, dtype=float)
        if X.ndim != 2 or X.shape[1] != len(self.regressors):
            raise ValueError(
                f"Got regressors of shape {X.shape}, but expected (n, {len(self.regressors)}): "
                f"{', '.join(self.regressor_names)}."
            )
        if not np.isfinite(X).all():
            raise ValueError(
                "Got regressors that are not finite, but expected finite ones: leave out these rows."
            )
        return X

    def scaled(self, X: Any) -> Matrix:
        """Return the scaled regressors z, (n, d)."""
        return (self.regressor_values(X) - self.shift) / self.scale

    def trend(self, Z: Matrix) -> Matrix:
        """Return p at scaled regressors (n, d), (n, d + 1)."""
        return np.column_stack([np.ones(len(Z)), Z - self.trend_center])

    def components(self, i: int) -> list[tuple[float, Part]]:
        """Return the components of output i whose weight is not zero: weight and part."""
        weights = self.mixture[:, i].tolist()
        parts = self.parts[i :: len(self.outputs)]
        return [pair for pair in zip(weights, parts, strict=True) if pair[0] != 0.0]

    def moments(
        self, i: int, Z: Any, p: Any, return_variance: bool, arithmetic: Arithmetic = ARRAYS
    ) -> tuple[Any, Any]:
        """Return normalised mean and variance of output i at scaled regressors; 0 as variance if it is not asked."""
        weights, parts = zip(*self.components(i), strict=True)
        bases = [part.basis(Z, arithmetic) for part in parts]
        means = [part.mean(p, g) for part, g in zip(parts, bases, strict=True)]
        mean = sum(map(mul, weights, means))
        if not return_variance:
            return mean, 0.0
        variances = []
        for part, g, own_mean in zip(parts, bases, means, strict=True):
            variance = part.variance(p, part.explained(g), arithmetic)
            variances.append(variance + (own_mean - mean) ** 2)
        return mean, sum(map(mul, weights, variances))

    def predict(self, X: Any, return_std: bool = False, include_input_noise: Any = True) -> Any:
        """Return the mean of the coefficients (n, P) and, with ``return_std``, their standard deviations.

        X is an array (n, d) of regressors in their units, or a flight table, also a dict of
        columns, with their sources. The deviation is of the coefficient, without the noise of its
        measurements. ``include_input_noise`` is as in ``DependentGPRegressor.predict``: True for
        regressors as noisy as in the fit, False for exact ones (a simulation), or a
        factor of their noise's variance, also (n,).
        """
        Z = self.scaled(X)
        mean, variance = self._predicted(Z, return_std)
        mean = self.center + self.output_scale * mean
        if not return_std:
            return mean
        factor = np.broadcast_to(np.asarray(include_input_noise, dtype=float), len(Z))
        if factor.any():
            slopes = self._slopes(Z) / self.output_scale[:, None]
            noise = np.einsum("npd,npd->np", slopes @ self.input_covariance, slopes)
            variance += factor[:, None] * noise
        return mean, self.output_scale * np.sqrt(variance)

    def _predicted(self, Z: Matrix, return_variance: bool) -> tuple[Matrix, Matrix]:
        """Return normalised means and variances of all outputs, (n, P) each."""
        moments = np.empty((2, len(Z), len(self.outputs)))
        for rows in _batches(Z):
            p = self.trend(Z[rows])
            for i in range(len(self.outputs)):
                moments[0, rows, i], moments[1, rows, i] = self.moments(
                    i, Z[rows], p, return_variance
                )
        return moments[0], moments[1]

    def predict_gradient(self, X: Any) -> Array:
        """Return the slopes of the mean, d mean / d regressor, (n, P, d), per unit of the regressors."""
        return self._slopes(self.scaled(X))

    def _slopes(self, Z: Matrix) -> Array:
        slopes = np.zeros((len(Z), len(self.outputs), Z.shape[1]))
        for rows in _batches(Z):
            for i in range(len(self.outputs)):
                for weight, part in self.components(i):
                    slopes[rows, i] += weight * part.slopes(Z[rows])
        return slopes * self.output_scale[:, None] / self.scale

    def head(self) -> dict[str, Any]:
        """Return names, formulas of the regressors, aircraft and provenance, as JSON knows them."""
        return {
            "outputs": list(self.outputs),
            "regressors": [asdict(regressor) for regressor in self.regressors],
            "aircraft": self.aircraft.to_dict(),
            "provenance": self.provenance,
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """Return every number of the model by name, as :func:`skdgp.export.save_portable` writes them."""
        values = vars(self)
        parts = self.parts
        readouts = self.readouts
        arrays: dict[str, Any] = {name: values[name] for name in NUMBERS_OF_MODEL}
        arrays["trend_weights"] = np.array([part.trend_weights for part in parts])
        arrays["prior_variance"] = np.array([part.prior_variance for part in parts])
        arrays["readout_of"] = np.array([readouts.index(part.readout) for part in parts])
        arrays |= self._term_arrays()
        for j, part in enumerate(parts):
            arrays[f"trend_prior_{j}"] = part.trend_prior
            arrays[f"trend_root_{j}"] = part.trend_root
        for k, readout in enumerate(readouts):
            arrays[f"weights_{k}"] = readout.weights
            arrays[f"root_{k}"] = packed(readout.root)
        for name, array in vars(self.reference).items():
            arrays[REFERENCE + name] = array
        return arrays

    def _term_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of all terms, one after another."""
        d = len(self.regressors)
        places = []
        gains = []
        roots = []
        centres = [np.empty((0, d))]
        for j, part in enumerate(self.parts):
            for term in part.terms:
                k, rank = term.centres.shape
                wide = ((0, 0), (0, d - rank))
                places.append((j, term.first, k))
                gains.append(term.gain)
                roots.append(np.pad(term.root, wide))
                centres.append(np.pad(term.centres, wide))
        return {
            "term_place": np.array(places, dtype=np.int64).reshape(-1, 3),
            "term_gain": np.array(gains),
            "term_root": np.array(roots).reshape(-1, d, d),
            "centres": np.concatenate(centres),
        }

    @classmethod
    def from_arrays(cls, head: dict[str, Any], arrays: dict[str, np.ndarray]) -> PortableModel:
        """Return the model of a head and arrays."""
        names = ("regressors", "mean", "std")
        reference = Reference(*(arrays[REFERENCE + name] for name in names))
        regressors = []
        for facts in head["regressors"]:
            sequences = {name: tuple(facts[name]) for name in ("sources", "factors")}
            regressors.append(Regressor(**facts | sequences))
        return cls(
            regressors=tuple(regressors),
            outputs=tuple(head["outputs"]),
            aircraft=Aircraft.from_dict(head["aircraft"]),
            parts=_parts_of(arrays),
            provenance=head["provenance"],
            reference=reference,
            **{name: arrays[name] for name in NUMBERS_OF_MODEL},
        )

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of regressors, outputs and arrays, as hexadecimal digits."""
        formulas = [asdict(regressor) for regressor in self.regressors]
        digest = hashlib.sha256(json.dumps([formulas, self.outputs]).encode())
        for name, array in sorted(self.arrays().items()):
            digest.update(f"{name} {array.shape} ".encode())
            digest.update(np.ascontiguousarray(array, dtype="<f8"))
        return digest.hexdigest()


# Arrays of a model
NUMBERS_OF_MODEL = (
    *("shift", "scale", "center", "output_scale", "trend_center", "mixture"),
    *("noise_variance", "input_covariance", "limits", "servos"),
)
# Prefix of the arrays of a `Reference`
REFERENCE = "reference_"


def _parts_of(arrays: dict[str, np.ndarray]) -> tuple[Part, ...]:
    """Return the parts of a model from its arrays."""
    readout_of = arrays["readout_of"]
    readouts = []
    for k in range(int(readout_of.max()) + 1):
        weights = arrays[f"weights_{k}"]
        readouts.append(Readout(weights, unpacked(arrays[f"root_{k}"], len(weights))))
    terms = _terms_of(arrays)
    parts = []
    for j, k in enumerate(readout_of):
        part = Part(
            terms=tuple(terms[j]),
            readout=readouts[k],
            trend_weights=arrays["trend_weights"][j],
            trend_prior=arrays[f"trend_prior_{j}"],
            trend_root=arrays[f"trend_root_{j}"],
            prior_variance=float(arrays["prior_variance"][j]),
        )
        parts.append(part)
    return tuple(parts)


def _terms_of(arrays: dict[str, np.ndarray]) -> list[list[Term]]:
    """Return the terms of each part from the arrays of a model."""
    terms: list[list[Term]] = [[] for _ in arrays["readout_of"]]
    places = arrays["term_place"]
    centres = np.split(arrays["centres"], np.cumsum(places[:, 2]))[:-1]
    gains = arrays["term_gain"].tolist()
    rows = zip(places.tolist(), gains, arrays["term_root"], centres, strict=True)
    for (j, first, _), gain, root, c in rows:
        used = root.any(axis=0)
        terms[j].append(Term(first, gain, root[:, used], c[:, used]))
    return terms


def packed(triangle: Matrix) -> Vector:
    """Return an upper triangle (k, k) column by column: 1, 2, ... k entries."""
    return triangle.T[np.tril_indices(len(triangle))]


def unpacked(values: Vector, size: int) -> Matrix:
    """Return the upper triangle (size, size) of its entries, column by column."""
    triangle = np.zeros((size, size))
    triangle.T[np.tril_indices(size)] = values
    return triangle
