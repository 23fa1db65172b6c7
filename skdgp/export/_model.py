"""The portable model: the posterior of an identified aircraft as arrays, evaluated by NumPy alone."""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy.spatial.distance import cdist
from sklearn.utils import gen_batches

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.dynamics import Aircraft

ROWS = 512  # predicted at once
ROUNDING = float(np.finfo(float).eps)


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
        mixed = np.asarray(np.tensordot(self.factors, columns, 1))
        if not self.power:
            return mixed
        return mixed * (self.length / (2 * np.asarray(table["airspeed"], float))) ** self.power


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

    def functions(self, Z: Matrix) -> Matrix:
        """Return the functions at scaled regressors (n, d), (n, k)."""
        return self.gain * np.exp(-0.5 * cdist(Z @ self.root, self.centres, "sqeuclidean"))


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

    def basis(self, Z: Matrix) -> Matrix:
        """Return g at scaled regressors (n, d), (n, k)."""
        values = np.zeros((len(Z), len(self.readout.weights)))
        for term in self.terms:
            values[:, term.entries] += term.functions(Z)
        return values

    def prior(self, p: Matrix) -> Vector:
        """Return the prior variance ``a + |R^T p|^2``, (n,)."""
        return np.asarray(self.prior_variance + np.square(p @ self.trend_prior).sum(axis=1))

    def variance(self, p: Matrix, explained: Matrix) -> Vector:
        """Return nu (n,) from p and U^T g, (n, k)."""
        prior = self.prior(p)
        half = _added(p @ self.trend_root, explained)
        return np.asarray(np.maximum(prior - np.square(half).sum(axis=1), ROUNDING * prior))

    def slopes(self, Z: Matrix) -> Matrix:
        """Return d mu / d z, (n, d)."""
        slopes = np.tile(self.trend_weights[1:], (len(Z), 1))
        for term in self.terms:
            pull = term.functions(Z) * self.readout.weights[term.entries]
            away = pull @ term.centres - pull.sum(axis=1)[:, None] * (Z @ term.root)
            slopes += away @ term.root.T
        return slopes

    def rounding(self, p: Matrix, g: Matrix) -> Vector:
        """Return the error of the variance by rounding, (n,)."""
        U = self.readout.root
        T = self.trend_root
        half = _added(p @ T, g @ U)
        squares = _added(p**2 @ T**2, g**2 @ U**2)
        explained = 2 * np.sqrt((half**2 * squares).sum(axis=1))
        epsilon = 2 * ROUNDING * np.sqrt(p.shape[1] + g.shape[1])
        return np.asarray(epsilon * np.hypot(self.prior(p), explained))


def _added(total: Matrix, half: Matrix) -> Matrix:
    """Add (n, k) to the last columns of (n, r)."""
    total[:, total.shape[1] - half.shape[1] :] += half
    return total


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
    samples : ndarray (n, d)
        Some rows of the training data.
    servo_lag : ndarray (1,)
        Time constant T of the servos [s]: surfaces follow commands c by :math:`T \dot\delta = c - \delta`.
    provenance : dict
        Facts: creation, versions, options and fit, as JSON knows them.
    reference : Reference or None
        What an export is compared with.
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
    samples: Matrix
    servo_lag: Vector
    provenance: dict[str, Any] = field(default_factory=dict)
    reference: Reference | None = None

    def __repr__(self) -> str:
        return f"PortableModel({', '.join(self.outputs)} of {', '.join(self.regressor_names)})"

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """Names of the d regressors, in order."""
        return tuple(regressor.name for regressor in self.regressors)

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns of a flight that the regressors are computed from, each once."""
        return tuple(dict.fromkeys(name for each in self.regressors for name in each.columns))

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

    def predict(self, X: Any, return_std: bool = False, include_input_noise: Any = True) -> Any:
        """Return the mean of the coefficients (n, P) and, with ``return_std``, their standard deviations.

        X is an array (n, d) of regressors in their units, or a flight table, also a dict of
        columns, with their sources. The deviation is of the coefficient, without the noise of its
        measurements. ``include_input_noise`` is as in ``DependentGPRegressor.predict``: True for
        regressors as noisy as in the fit, False for exact ones (a simulation), or a
        factor of their noise's variance, also (n,).
        """
        Z = self.scaled(X)
        factor = np.broadcast_to(np.asarray(include_input_noise, dtype=float), len(Z))
        mean, variance = np.empty((2, len(Z), len(self.outputs)))
        for rows in gen_batches(len(Z), ROWS):
            mean[rows], variance[rows] = self._moments(Z[rows], return_std)
            if return_std and factor[rows].any():
                slopes = self._slopes(Z[rows]) / self.output_scale[:, None]
                noise = np.einsum("npd,npd->np", slopes @ self.input_covariance, slopes)
                variance[rows] += factor[rows, None] * noise
        mean = self.center + self.output_scale * mean
        return (mean, self.output_scale * np.sqrt(variance)) if return_std else mean

    def predict_gradient(self, X: Any) -> Array:
        """Return the slopes of the mean, d mean / d regressor, (n, P, d), per unit of the regressors."""
        Z = self.scaled(X)
        return np.concatenate([self._slopes(Z[rows]) for rows in gen_batches(len(Z), ROWS)])

    def rounding(self, X: Any) -> Matrix:
        r"""Return how far deviations (n, P) of two programs may differ by rounding alone, in double precision.

        The variance is a small difference of large sums. A sum of k terms t has an error of about
        :math:`\epsilon \sqrt{k} |t|` (Higham, Accuracy and Stability of Numerical Algorithms, 2002,
        section 2.8). With f = (p, g), F = (T, (0, U)) and the prior variance :math:`a' = a + |\tau
        \circ p|^2`, the variance has the error

        .. math:: e = 2 \epsilon \sqrt{k} \left(a'^2 + 4 \sum_r h_r^2 \sum_k f_k^2 F_{kr}^2\right)^{1/2},

        and the deviation :math:`e / \max(\sigma, \sqrt{e})`. The factor 2 is five times the
        largest error of C and CasADi (measured).
        """
        Z = self.scaled(X)
        p = self.trend(Z)
        errors = np.column_stack([part.rounding(p, part.basis(Z)) for part in self.parts])
        error = self._mixed(errors)[0]
        return self.output_scale * error / np.sqrt(np.maximum(self._moments(Z, True)[1], error))

    def _moments(self, Z, return_std):
        """Return normalised mean and variance of the outputs, (n, P) each."""
        p = self.trend(Z)
        mean, variance = np.zeros((2, len(Z), len(self.parts)))
        for j, part in enumerate(self.parts):
            g = part.basis(Z)
            mean[:, j] = p @ part.trend_weights + g @ part.readout.weights
            if return_std:
                variance[:, j] = part.variance(p, g @ part.readout.root)
        mixed, away = self._mixed(mean)
        return mixed, self._mixed(variance + away**2)[0]

    def _mixed(self, values):
        """Return the weighted sums over components (n, P) of values of parts (n, K P), and what differs from them."""
        of_parts = values.reshape(-1, *self.mixture.shape)
        mixed = (self.mixture * of_parts).sum(axis=1)
        return mixed, (of_parts - mixed[:, None]).reshape(values.shape)

    def _slopes(self, Z):
        slopes = np.stack([part.slopes(Z) for part in self.parts], axis=1)
        of_parts = slopes.reshape(len(Z), *self.mixture.shape, -1)
        mixed = (self.mixture[..., None] * of_parts).sum(axis=1)
        return mixed * self.output_scale[:, None] / self.scale

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
        d = len(self.regressors)
        places = {id(readout): k for k, readout in enumerate(self.readouts)}
        terms = [(j, term) for j, part in enumerate(self.parts) for term in part.terms]
        place = [(j, term.first, len(term.centres)) for j, term in terms]
        wide = [np.pad(t.root, ((0, 0), (0, d - t.root.shape[1]))) for _, t in terms]
        centres = [np.pad(t.centres, ((0, 0), (0, d - t.root.shape[1]))) for _, t in terms]
        arrays: dict[str, Any] = {name: getattr(self, name) for name in NUMBERS}
        arrays |= {
            name: np.array([getattr(part, name) for part in self.parts]) for name in OF_PARTS
        }
        arrays["readout_of"] = np.array([places[id(part.readout)] for part in self.parts])
        arrays["term_place"] = np.array(place, dtype=np.int64).reshape(-1, 3)
        arrays["term_gain"] = np.array([term.gain for _, term in terms])
        arrays["term_root"] = np.array(wide).reshape(-1, d, d)
        arrays["centres"] = np.concatenate([np.empty((0, d)), *centres])
        for j, part in enumerate(self.parts):
            arrays[f"trend_prior_{j}"] = part.trend_prior
            arrays[f"trend_root_{j}"] = part.trend_root
        for k, readout in enumerate(self.readouts):
            arrays[f"weights_{k}"] = readout.weights
            arrays[f"root_{k}"] = packed(readout.root)
        if self.reference is not None:
            arrays |= {REFERENCE + name: array for name, array in vars(self.reference).items()}
        return arrays

    @classmethod
    def from_arrays(cls, head: dict[str, Any], arrays: dict[str, np.ndarray]) -> PortableModel:
        """Return the model of a head and arrays."""
        places = arrays["term_place"]
        readouts = [
            Readout(
                arrays[f"weights_{k}"], unpacked(arrays[f"root_{k}"], len(arrays[f"weights_{k}"]))
            )
            for k in range(int(arrays["readout_of"].max()) + 1)
        ]
        terms: list[list[Term]] = [[] for _ in arrays["readout_of"]]
        centres = np.split(arrays["centres"], np.cumsum(places[:-1, 2]))
        columns = zip(places, arrays["term_gain"], arrays["term_root"], centres, strict=True)
        for (j, first, _), gain, root, at in columns if len(places) else ():
            used = root.any(axis=0)
            terms[j].append(Term(int(first), float(gain), root[:, used], at[:, used]))
        of_parts = zip(*(arrays[name] for name in OF_PARTS), strict=True)
        parts = tuple(
            Part(
                tuple(terms[j]),
                readouts[arrays["readout_of"][j]],
                v,
                arrays[f"trend_prior_{j}"],
                arrays[f"trend_root_{j}"],
                float(a),
            )
            for j, (v, a) in enumerate(of_parts)
        )
        reference = {
            name.removeprefix(REFERENCE): array
            for name, array in arrays.items()
            if name.startswith(REFERENCE)
        }
        return cls(
            regressors=tuple(
                Regressor(**r | {name: tuple(r[name]) for name in ("sources", "factors")})
                for r in head["regressors"]
            ),
            outputs=tuple(head["outputs"]),
            aircraft=Aircraft.from_dict(head["aircraft"]),
            parts=parts,
            provenance=head["provenance"],
            reference=Reference(**reference) if reference else None,
            **{name: arrays[name] for name in NUMBERS},
        )

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of regressors, outputs and arrays, as hexadecimal digits."""
        formulas = [asdict(regressor) for regressor in self.regressors]
        found = hashlib.sha256(json.dumps([formulas, self.outputs]).encode())
        for name, array in sorted(self.arrays().items()):
            found.update(f"{name} {array.shape} ".encode())
            found.update(np.ascontiguousarray(array, dtype="<f8"))
        return found.hexdigest()


# Arrays of a model
NUMBERS = (
    *("shift", "scale", "center", "output_scale", "trend_center", "mixture"),
    *("noise_variance", "input_covariance", "limits", "samples", "servo_lag"),
)
# Prefix of the arrays of a `Reference`
REFERENCE = "reference_"
# Arrays with one row for each part
OF_PARTS = ("trend_weights", "prior_variance")


def packed(triangle: Matrix) -> Vector:
    """Return an upper triangle (k, k) column by column: 1, 2, ... k entries."""
    return triangle.T[np.tril_indices(len(triangle))]


def unpacked(values: Vector, size: int) -> Matrix:
    """Return the upper triangle (size, size) of its entries, column by column."""
    triangle = np.zeros((size, size))
    triangle.T[np.tril_indices(size)] = values
    return triangle


# Names of the vocabulary: another column is never written under one of them
