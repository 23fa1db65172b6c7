"""The portable model: the posterior of an identified aircraft as arrays, evaluated by NumPy alone, and its file."""

from __future__ import annotations

import hashlib
import io
import json
import os
import zipfile
from collections.abc import Iterator
from dataclasses import asdict, astuple, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from scipy.spatial.distance import cdist

from skdgp._compute.files import LARGEST, parse_json, sha256_of, write_atomically
from skdgp._compute.typing import Array, Indices, Matrix, Vector
from skdgp._flight.channels import COEFFICIENTS
from skdgp.dynamics import Aircraft
from skdgp.export._text import identifiers

CHUNK_BYTES = 2**26  # working memory of one chunk of rows
ROUNDING = float(np.finfo(float).eps)
ARRAYS = ("Vector", "Matrix", "Indices")  # annotations
FORMAT, VERSION = "skdgp portable model", 3
HEAD = "model.json"
DIGITS = 64  # of the SHA-256 at the end of the file
EPOCH = (1980, 1, 1, 0, 0, 0)  # equal models are equal files
MAX_NAMES = 1000  # regressors or outputs
SHAPES = {
    "d": "shift scale trend_center envelope_low envelope_high",
    "P": "center output_scale deviation_scale noise_variance drift_variance drift_memory",
    "K P": "mixture",
    "J": "prior_variance readout_of",
    "J e": "trend_scale trend_weights",
    "m d": "centres",
    "d d": "input_covariance",
    "B": "block_gain",
    "B 4": "block_place",
    "B d": "block_shift block_regressors",
    "s d": "envelope_samples",
}
"""Arrays by shape: d regressors, e = d + 1, P outputs, K members, J = K P parts, m centres, B
blocks, s samples.
"""
SHAPE_OF = {name: letters for letters, names in SHAPES.items() for name in names.split()}
TYPES = {"block_place": "<i8", "readout_of": "<i8", "block_regressors": "|u1"}  # else "<f8"


@dataclass(frozen=True)
class Regressor:
    r"""One regressor, and the columns of a flight table that it is computed from.

    .. math:: x = \left(\frac{L}{2V}\right)^n \sum_k c_k u_k

    Parameters
    ----------
    name, unit : str
        Such as ``q_hat`` and "".
    sources, factors : tuples of str and of float
        Columns u of a flight table, and their factors c: those of the mixing for a control, else 1.
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
        """Every column that it needs."""
        return (*self.sources, "airspeed") if self.power else self.sources

    def values(self, table: Any) -> Vector:
        """Return the regressor (n,) of a table; without its sources, the column of its own name."""
        if self.name in table and not all(name in table for name in self.columns):
            return np.asarray(table[self.name], dtype=float)
        lacking = [name for name in self.columns if name not in table]
        if lacking:
            raise ValueError(
                f"Got a table without {lacking}, but the regressor {self.name} is computed from "
                f"{list(self.columns)}: "
                f"add them, or a column {self.name}."
            )
        mixed = sum(
            factor * np.asarray(table[name], float)
            for factor, name in zip(self.factors, self.sources, strict=True)
        )
        if not self.power:
            return np.asarray(mixed)
        return (
            mixed * (self.length / (2 * np.asarray(table["airspeed"], dtype=float))) ** self.power
        )


@dataclass(frozen=True, eq=False)
class Block:
    r"""Gaussian functions of one width, which add to neighbouring columns of the basis of one part.

    .. math:: g_k(z) = \mathrm{gain} \, \exp\left(-\frac{1}{2} |F^T (z - \mathrm{shift} - Z_k)|^2\right)

    with the scaled regressors z and Z the rows ``first_centre`` to ``first_centre + size`` of the
    model's centres.

    Parameters
    ----------
    output : int
        The part j, see :class:`PortableModel`.
    first_centre, first_column, size : int
        Rows of ``PortableModel.centres``, and columns of the basis of the part's readout.
    gain, shift, root : float, ndarray (d,), ndarray (d,) or (d, d)
        ``root`` is F, or its diagonal.
    regressors : tuple of int
        Regressors that the functions depend on.
    """

    output: int
    first_centre: int
    first_column: int
    size: int
    gain: float
    shift: Vector
    root: Array
    regressors: tuple[int, ...]

    @property
    def rows(self) -> slice:
        """Its centres, among those of the model."""
        return slice(self.first_centre, self.first_centre + self.size)

    @property
    def columns(self) -> slice:
        """Its columns of the basis."""
        return slice(self.first_column, self.first_column + self.size)

    def functions(self, Z: Matrix, centres: Matrix) -> Matrix:
        """Return its functions of any centres (k, d) at scaled regressors Z (n, d), (n, k)."""
        z = Z - self.shift
        full = self.root.ndim == 2
        pair = (
            (z @ self.root, centres @ self.root) if full else (z * self.root, centres * self.root)
        )
        return self.gain * np.exp(-0.5 * cdist(*pair, "sqeuclidean"))


@dataclass(frozen=True, eq=False)
class Readout:
    """Weights of the mean and root of the variance for a basis of k functions g.

    Parameters
    ----------
    weights : ndarray (k,)
        w of the mean.
    packed_root : ndarray (k (k + 1) / 2,)
        The upper triangle U (k, k) of the explained variance, column by column: 1, 2, ... k
        entries.
    """

    weights: Vector
    packed_root: Vector

    @property
    def size(self) -> int:
        """Number of basis functions k."""
        return len(self.weights)

    @cached_property
    def root(self) -> Matrix:
        """U (k, k)."""
        root = np.zeros((self.size, self.size))
        root.T[np.tril_indices(self.size)] = self.packed_root
        return root


@dataclass(frozen=True, eq=False)
class LearnedRange:
    """Regressors that the model was learned from, in their own units.

    Parameters
    ----------
    low, high : ndarray (d,)
        Smallest and largest value.
    samples : ndarray (n, d)
        Some rows of the training data.
    """

    low: Vector
    high: Vector
    samples: Matrix

    def inside(self, X: Matrix) -> Any:
        """Return whether each row of X (n, d) is within the range of every regressor, (n,)."""
        X = np.asarray(X, dtype=float)
        return np.logical_and(self.low <= X, self.high >= X).all(axis=1)


@dataclass(frozen=True, eq=False)
class PortableModel:
    r"""The posterior of the coefficients of an aircraft, as arrays.

    An output is the mixture of K posteriors, the members of an average; K is 1 for a single one.
    Member k of output i of P is the part j = k P + i. For regressors x (d,), with z = (x -
    ``shift``) / ``scale``, p = (1, z - ``trend_center``) and the basis g(z) of a part
    (:class:`Block`), normalised mean and variance of the part are

    .. math:: \mu_j = v_j^T p + w^T g, \quad
              \nu_j = a_j + |\tau_j \circ p|^2 - |h|^2, \quad
              h = T_j^T p + (0, U^T g),

    with a ``prior_variance``, v ``trend_weights``, tau ``trend_scale``, T ``trend_roots``, and w
    and U of the part's :class:`Readout`, which acts on the last k entries of h. With the weights q
    (``mixture``), c ``center``, s ``output_scale`` and t ``deviation_scale``, mean and variance of
    the coefficient are those of the mixture,

    .. math:: \mu_i = \sum_k q_{ki} \mu_j, \quad m_i = c_i + s_i \mu_i, \quad
              \sigma_i^2 = t_i^2 \sum_k q_{ki} \left(\nu_j + (\mu_j - \mu_i)^2\right).

    This is the posterior of the function at exact regressors. At measured ones, whose noise has the
    covariance S (``input_covariance``), their noise adds :math:`(t_i / s_i)^2 J_i S J_i^T` to the
    variance, with the slopes J of the mean: on most flights the larger part of it.

    Parameters
    ----------
    regressors : tuple of Regressor
    outputs : tuple of str
    aircraft : Aircraft
    shift, scale : ndarray (d,)
    center, output_scale, deviation_scale : ndarray (P,)
    centres : ndarray (m, d)
        Of Gaussian functions, in scaled regressors.
    blocks, readouts : tuples of Block and of Readout
    readout_of : ndarray (K P,) of int
        The readout of each part; parts may share one.
    trend_center : ndarray (d,)
    trend_scale, trend_weights : ndarray (K P, d + 1)
    trend_roots : tuple of ndarray (d + 1, r)
        One for each part, with k <= r <= k + d + 1.
    prior_variance : ndarray (K P,)
        Of the Gaussian functions and of the misfit, of normalised outputs.
    mixture : ndarray (K, P)
        Weight of each member for each output; columns add up to one.
    noise_variance : ndarray (P,)
        Of measurements of the coefficients; it is no part of the deviation.
    drift_variance, drift_memory : ndarray (P,)
        Of the errors along a flight, ``tau^2 exp(-|t - t'| / T)``; zero where there is none.
    input_covariance : ndarray (d, d)
        Covariance S of the noise of the regressors of the flights.
    envelope : LearnedRange
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
    deviation_scale: Vector
    centres: Matrix
    blocks: tuple[Block, ...]
    readouts: tuple[Readout, ...]
    readout_of: Indices
    trend_center: Vector
    trend_scale: Matrix
    trend_weights: Matrix
    trend_roots: tuple[Matrix, ...]
    prior_variance: Vector
    mixture: Matrix
    noise_variance: Vector
    drift_variance: Vector
    drift_memory: Vector
    input_covariance: Matrix
    envelope: LearnedRange
    provenance: dict[str, Any] = field(default_factory=dict)

    def __repr__(self) -> str:
        return f"PortableModel({', '.join(self.outputs)} of {', '.join(self.regressor_names)})"

    @property
    def regressor_names(self) -> tuple[str, ...]:
        """Names of the d regressors, in order."""
        return tuple(regressor.name for regressor in self.regressors)

    @property
    def columns(self) -> tuple[str, ...]:
        """Every column of a flight that the regressors are computed from, each once."""
        return tuple(
            dict.fromkeys(name for regressor in self.regressors for name in regressor.columns)
        )

    @property
    def order(self) -> list[int]:
        """Places of CX CY CZ Cl Cm Cn among the outputs; raises ValueError if one is missing."""
        if lacking := [name for name in COEFFICIENTS if name not in self.outputs]:
            raise ValueError(
                f"Got a model without {lacking}, but expected all six coefficients: learn them all."
            )
        return [self.outputs.index(name) for name in COEFFICIENTS]

    def points(self) -> Matrix:
        """Return regressors (n, d) that were flown: samples, or inducing inputs, among them."""
        if len(self.envelope.samples) > 1:
            return self.envelope.samples
        Z = (
            self.centres
            if len(self.centres) > 1
            else np.random.default_rng(0).standard_normal((200, len(self.scale)))
        )
        return Z * self.scale + self.shift

    @cached_property
    def mixer(self) -> Matrix:
        """The matrix (K P, P) by which values of parts (n, K P) become those of outputs, weighted sums."""
        return np.vstack([np.diag(weights) for weights in self.mixture])

    def mixed(self, mean: Matrix, variance: Matrix) -> tuple[Matrix, Matrix]:
        """Return normalised mean and variance of the outputs (n, P), from those of the parts (n, K P)."""
        of_outputs = mean @ self.mixer
        away = mean - np.tile(of_outputs, len(self.mixture))
        return of_outputs, (variance + away**2) @ self.mixer

    def with_identifiers(self) -> tuple[PortableModel, dict[str, str]]:
        """Return the model with identifiers for the names of its columns, regressors and outputs, and these by name."""
        names = identifiers((*self.columns, *self.regressor_names, *self.outputs))
        regressors = tuple(
            replace(r, name=names[r.name], sources=tuple(map(names.__getitem__, r.sources)))
            for r in self.regressors
        )
        return replace(
            self, regressors=regressors, outputs=tuple(map(names.__getitem__, self.outputs))
        ), names

    def arrays(self) -> dict[str, np.ndarray]:
        """Return every number of the model by name; :func:`skdgp.export.save_portable` writes these."""
        d = len(self.regressors)
        places = [(b.output, b.first_centre, b.first_column, b.size) for b in self.blocks]
        depends = [[k in b.regressors for k in range(d)] for b in self.blocks]
        full = any(block.root.ndim == 2 for block in self.blocks)
        roots = [np.diag(b.root) if full and b.root.ndim == 1 else b.root for b in self.blocks]
        named = [each.name for each in fields(self) if each.type in ARRAYS]
        return {
            **{name: getattr(self, name) for name in named},
            "block_place": np.array(places, dtype=np.int64).reshape(-1, 4),
            "block_gain": np.array([b.gain for b in self.blocks], dtype=float),
            "block_shift": np.array([b.shift for b in self.blocks]).reshape(-1, d),
            "block_root": np.array(roots).reshape((-1, d, d) if full else (-1, d)),
            "block_regressors": np.array(depends, dtype=bool).reshape(-1, d),
            **{f"trend_root_{i}": root for i, root in enumerate(self.trend_roots)},
            **{f"weights_{k}": readout.weights for k, readout in enumerate(self.readouts)},
            **{f"root_{k}": readout.packed_root for k, readout in enumerate(self.readouts)},
            **{
                f"envelope_{name}": getattr(self.envelope, name)
                for name in LearnedRange.__dataclass_fields__
            },
        }

    def terms(self, j: int) -> Iterator[tuple[Block, Vector, Matrix]]:
        """Yield every block of part j, with the weights (size,) and the rows of (0, U) (size, r) of its functions."""
        readout = self.readouts[self.readout_of[j]]
        left = self.trend_roots[j].shape[1] - readout.size  # U stands under the last columns of T
        for block in self.blocks:
            if block.output == j:
                yield (
                    block,
                    readout.weights[block.columns],
                    np.pad(readout.root[block.columns], ((0, 0), (left, 0))),
                )

    @cached_property
    def content_hash(self) -> str:
        """SHA-256 of the numbers and names that predictions depend on, as hexadecimal digits."""
        formulas = [astuple(regressor) for regressor in self.regressors]
        found = hashlib.sha256(repr((formulas, self.outputs)).encode())
        for name, array in sorted(self.arrays().items()):
            found.update(f"{name} {array.shape} ".encode())
            found.update(np.ascontiguousarray(array, dtype="<f8"))
        return found.hexdigest()

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
                "Got regressors that are not finite, but expected finite ones: leave out these "
                "rows."
            )
        return X

    def predict(self, X: Any, return_std: bool = False, include_input_noise: Any = True) -> Any:
        """Return the mean of the coefficients (n, P) and, with ``return_std``, their standard deviations.

        X is an array (n, d) of regressors in their units, or a flight table, also a dict of
        columns, with their sources. The deviation is that of the coefficient, without the noise of
        its measurements. ``include_input_noise`` is as of ``DependentGPRegressor.predict``: True
        for regressors as noisy as those of the fit, False for exact ones (a simulation), or a
        factor of their noise's variance, also (n,).
        """
        chunks = self._chunks(X)
        ends = np.cumsum([len(Z) for Z in chunks])
        noise = np.split(
            np.broadcast_to(np.asarray(include_input_noise, dtype=float), ends[-1]), ends[:-1]
        )
        parts = [
            self._predict(Z, return_std, of_rows) for Z, of_rows in zip(chunks, noise, strict=True)
        ]
        mean, std = (np.concatenate(part) for part in zip(*parts, strict=True))
        return (mean, std) if return_std else mean

    def rounding(self, X: Any) -> Matrix:
        r"""Return how far deviations (n, P) of two programs in double precision may differ, by rounding alone.

        The variance is a small difference of large sums. A sum of k terms t has an error of about
        :math:`\epsilon \sqrt{k} |t|` (Higham, Accuracy and Stability of Numerical Algorithms, 2002,
        section 2.8). With f = (p, g), F = (T, (0, U)) and the prior variance :math:`a' = a + |\tau
        \circ p|^2`, the variance has the error

        .. math:: e = 2 \epsilon \sqrt{k} \left(a'^2 + 4 \sum_r h_r^2 \sum_k f_k^2 F_{kr}^2\right)^{1/2},

        and the deviation :math:`t e / \max(\sigma / t, \sqrt{e})`. In a mixture the errors of means
        add to it through the scatter of the members. The factor 2 is five times the largest found
        in C, ONNX and CasADi.
        """
        return np.concatenate([self._rounding(Z) for Z in self._chunks(X)])

    def predict_gradient(self, X: Any) -> Array:
        """Return the slopes of the mean, d mean / d regressor, (n, P, d), per unit of the regressors."""
        return np.concatenate([self._gradient(Z) for Z in self._chunks(X)])

    def _chunks(self, X: Any) -> list[Matrix]:
        """Return the scaled regressors z, as many rows at a time as the working memory holds."""
        Z = (self.regressor_values(X) - self.shift) / self.scale
        widest = 3 * max(root.shape[1] for root in self.trend_roots) + 1
        step = max(1, CHUNK_BYTES // (8 * widest))
        return [Z[a : a + step] for a in range(0, max(len(Z), 1), step)]

    def _trend(self, Z):
        return np.column_stack([np.ones(len(Z)), Z - self.trend_center])

    def _basis(self, Z, j):
        """Return the basis of part j at scaled regressors, (n, k)."""
        basis = np.zeros((len(Z), self.readouts[self.readout_of[j]].size))
        for block in self.blocks:
            if block.output == j:
                basis[:, block.columns] += block.functions(Z, self.centres[block.rows])
        return basis

    def _predict(self, Z, return_std, input_noise):
        mean, variance = np.zeros((2, len(Z), len(self.readout_of)))
        trend = self._trend(Z)
        for j, k in enumerate(self.readout_of):
            basis, readout = self._basis(Z, j), self.readouts[k]
            mean[:, j] = trend @ self.trend_weights[j] + basis @ readout.weights
            if return_std:
                variance[:, j] = self._variance(j, trend, basis @ readout.root)
        mean, variance = self.mixed(mean, variance)
        if return_std and input_noise.any() and self.input_covariance.any():
            slopes = self._gradient(Z) / self.output_scale[:, None]
            added = np.einsum(
                "npd,de,npe->np", slopes, self.input_covariance, slopes, optimize=True
            )
            variance = variance + input_noise[:, None] * added
        return self.center + self.output_scale * mean, self.deviation_scale * np.sqrt(variance)

    def _variance(self, j: int, trend: Matrix, half: Matrix) -> Vector:
        """Return the normalised variance (n,) of part j, of the trend's basis p (n, d + 1) and of U^T g, (n, k)."""
        prior, whole = self._prior(j, trend), _added(trend @ self.trend_roots[j], half)
        return np.asarray(np.maximum(prior - np.einsum("nr,nr->n", whole, whole), ROUNDING * prior))

    def _prior(self, j: int, trend: Matrix) -> Vector:
        """Return a + |tau p|^2."""
        return np.asarray(self.prior_variance[j] + ((trend * self.trend_scale[j]) ** 2).sum(axis=1))

    def _rounding(self, Z):
        mean, mean_error, variance, error = np.zeros((4, len(Z), len(self.readout_of)))
        trend = self._trend(Z)
        for j, k in enumerate(self.readout_of):
            g, readout, v, T = (
                self._basis(Z, j),
                self.readouts[k],
                self.trend_weights[j],
                self.trend_roots[j],
            )
            w, U, epsilon = (
                readout.weights,
                readout.root,
                2 * ROUNDING * np.sqrt(trend.shape[1] + g.shape[1]),
            )
            h, squares = _added(trend @ T, g @ U), _added(trend**2 @ T**2, g**2 @ U**2)
            mean[:, j], variance[:, j] = trend @ v + g @ w, self._variance(j, trend, g @ U)
            mean_error[:, j] = epsilon * np.sqrt(trend**2 @ v**2 + g**2 @ w**2)
            error[:, j] = epsilon * np.hypot(
                self._prior(j, trend), 2 * np.sqrt((h**2 * squares).sum(axis=1))
            )
        of_outputs, variance = self.mixed(mean, variance)
        away = mean - np.tile(of_outputs, len(self.mixture))
        of_variance = (error + 2 * np.abs(away) * mean_error) @ self.mixer
        return self.deviation_scale * of_variance / np.sqrt(np.maximum(variance, of_variance))

    def _gradient(self, Z):
        slopes = np.repeat(self.trend_weights[None, :, 1:], len(Z), axis=0)
        for block in self.blocks:
            weights = self.readouts[self.readout_of[block.output]].weights[block.columns]
            centres = self.centres[block.rows]
            E = block.functions(Z, centres) * weights
            pull = E @ centres - E.sum(axis=1)[:, None] * (Z - block.shift)
            root = block.root
            slopes[:, block.output] += pull @ (root @ root.T) if root.ndim == 2 else pull * root**2
        return (
            np.einsum("njd,jp->npd", slopes, self.mixer) * self.output_scale[:, None] / self.scale
        )


def _added(whole: Matrix, half: Matrix) -> Matrix:
    """Return the sum of (n, r) and, at its last columns, (n, k)."""
    whole[:, whole.shape[1] - half.shape[1] :] += half
    return whole


class PortableFileError(ValueError):
    """A file could not be read as a portable model."""


def save_portable(path: str | os.PathLike[str], model: PortableModel) -> Path:
    """Write a portable model into one file, which appears whole or not at all, and return its path.

    The file is an uncompressed zip archive, which ``numpy.load`` opens: ``model.json`` and one
    ``.npy`` for each array. Its comment is the SHA-256 of all bytes before it. Raises TypeError if
    ``model`` is no `PortableModel`.
    """
    if not isinstance(model, PortableModel):
        raise TypeError(
            f"Got {type(model).__name__} to save, but expected a PortableModel: make one with "
            "skdgp.export.portable_model(pipeline, aircraft)."
        )
    return write_atomically(path, lambda temporary: _write(temporary, model))


def load_portable(path: str | os.PathLike[str]) -> PortableModel:
    """Return a portable model that :func:`save_portable` or ``skdgp export`` wrote, the same to the bit.

    No code is run. Raises FileNotFoundError if there is no such file, PortableFileError if it is
    not a portable model, differs from what was written in a single bit, or is of another format
    version.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(
            f"Got {path}, but there is no such file: skdgp export writes model.npz."
        )
    with path.open("rb") as file:
        try:
            if sha256_of(file, max(0, file.seek(0, os.SEEK_END) - DIGITS)) != file.read():
                raise ValueError(
                    "its checksum does not fit: it was cut off or changed, or is another file"
                )
            return _read(file)
        except Exception as error:  # a hostile archive may raise anything
            words = " ".join(str(error).split()) or type(error).__name__
            raise PortableFileError(
                f"Got {path}, which is not a portable model of this version ({words}): copy it "
                f"again, or export the "
                "model again."
            ) from error


def _write(path, model) -> None:
    head = {
        "format": FORMAT,
        "version": VERSION,
        "outputs": list(model.outputs),
        "regressors": [asdict(regressor) for regressor in model.regressors],
        "aircraft": model.aircraft.to_dict(),
        "n_readouts": len(model.readouts),
        "content_hash": model.content_hash,
        "provenance": model.provenance,
    }
    with zipfile.ZipFile(path, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr(zipfile.ZipInfo(HEAD, EPOCH), json.dumps(head, indent=1, allow_nan=False))
        for name, array in model.arrays().items():
            data = io.BytesIO()
            contiguous = np.ascontiguousarray(array, dtype=TYPES.get(name, "<f8"))
            np.lib.format.write_array(data, contiguous, allow_pickle=False)
            archive.writestr(zipfile.ZipInfo(f"{name}.npy", EPOCH), data.getbuffer())
        archive.comment = b"0" * DIGITS
    with path.open("rb+") as file:
        digest = sha256_of(file, path.stat().st_size - DIGITS)
        file.seek(-DIGITS, os.SEEK_END)
        file.write(digest)


def _read(file: BinaryIO) -> PortableModel:
    size = file.seek(0, os.SEEK_END)
    with zipfile.ZipFile(file) as archive:
        members = {member.filename: member for member in archive.infolist()}
        stored = all(
            m.compress_type == zipfile.ZIP_STORED and m.compress_size == m.file_size
            for m in members.values()
        )
        if (
            not stored
            or len(members) < len(archive.infolist())
            or sum(m.file_size for m in members.values()) > size
        ):
            raise ValueError("its members are compressed, repeated or larger than the file")
        if HEAD not in members or members[HEAD].file_size > LARGEST:
            raise ValueError(f"it has no {HEAD} of at most 16 MB")
        head = parse_json(archive.read(HEAD).decode(), f"{HEAD} is not JSON")
        if (
            not isinstance(head, dict)
            or head.get("format") != FORMAT
            or head.get("version") != VERSION
        ):
            found = [head.get("format"), head.get("version")] if isinstance(head, dict) else head
            raise ValueError(f"its format is {found}, but expected {FORMAT} {VERSION}")
        arrays = {
            name.removesuffix(".npy"): _array(archive, member)
            for name, member in members.items()
            if name != HEAD
        }
    return _assembled(head, arrays)


def _array(archive, member) -> np.ndarray:
    """Return an array whose header agrees with the size of the member; nothing larger is allocated."""
    name, data = member.filename.removesuffix(".npy"), io.BytesIO(archive.read(member))
    if np.lib.format.read_magic(data) != (1, 0):
        raise ValueError(f"{name} is of another version of npy")
    shape, fortran, dtype = np.lib.format.read_array_header_1_0(data)
    if dtype.str != TYPES.get(name, "<f8") or (fortran and len(shape) > 1):
        raise ValueError(f"{name} is of type {dtype.str}")
    values = np.frombuffer(data.getbuffer()[data.tell() :], dtype=dtype).reshape(shape)
    if not (
        np.isfinite(values).all()
        or (name in ("envelope_low", "envelope_high") and not np.isnan(values).any())
    ):
        raise ValueError(f"{name} is not finite")
    return values


def _assembled(head, arrays) -> PortableModel:
    """Return the model of checked names and arrays."""
    regressors, outputs = (
        tuple(_regressor(r) for r in head["regressors"]),
        tuple(map(str, head["outputs"])),
    )
    d, P, n = len(regressors), len(outputs), int(head["n_readouts"])
    sizes = {"d": d, "e": d + 1, "P": P, "4": 4}
    _check_shape("mixture", arrays, SHAPE_OF["mixture"], sizes)
    J = sizes["J"] = sizes["K"] * P
    if not (0 < d <= MAX_NAMES and 0 < P <= MAX_NAMES and 0 < n <= J):
        raise ValueError(f"it has {d} regressors, {P} outputs and {n} readouts")
    for name, letters in SHAPE_OF.items():
        _check_shape(name, arrays, letters, sizes)
    _check_shape(
        "block_root", arrays, "B d d" if np.ndim(arrays["block_root"]) == 3 else "B d", sizes
    )
    for k in range(n):
        _check_shape(f"weights_{k}", arrays, f"k{k}", sizes)
        sizes[f"t{k}"] = sizes[f"k{k}"] * (sizes[f"k{k}"] + 1) // 2
        _check_shape(f"root_{k}", arrays, f"t{k}", sizes)
    readout_of = arrays["readout_of"]
    _check_range("readout_of", readout_of, n)
    for j in range(J):
        _check_shape(f"trend_root_{j}", arrays, f"e r{j}", sizes)
        k = sizes[f"k{readout_of[j]}"]
        if not k <= sizes[f"r{j}"] <= k + d + 1:
            raise ValueError(f"trend_root_{j} has {sizes[f'r{j}']} columns for {k} functions")
    model = PortableModel(
        regressors=regressors,
        outputs=outputs,
        aircraft=Aircraft.from_dict(head["aircraft"]),
        **{name: arrays[name] for name in SHAPE_OF if not name.startswith(("block_", "envelope_"))},
        blocks=_blocks(arrays, sizes),
        readouts=tuple(Readout(arrays[f"weights_{k}"], arrays[f"root_{k}"]) for k in range(n)),
        trend_roots=tuple(arrays[f"trend_root_{j}"] for j in range(J)),
        envelope=LearnedRange(
            **{name: arrays[f"envelope_{name}"] for name in LearnedRange.__dataclass_fields__}
        ),
        provenance=dict(head["provenance"]),
    )
    if model.content_hash != head["content_hash"]:
        raise ValueError("its content is not what its hash says")
    return model


def _regressor(values) -> Regressor:
    r = Regressor(**values)
    sources, factors = tuple(map(str, r.sources)), tuple(map(float, r.factors))
    regressor = Regressor(str(r.name), str(r.unit), sources, factors, float(r.length), int(r.power))
    if (
        regressor.power not in (0, 1, 2)
        or len(regressor.factors) != len(regressor.sources)
        or not regressor.sources
    ):
        raise ValueError(f"the regressor {regressor.name} has no formula")
    return regressor


def _blocks(arrays, sizes) -> tuple[Block, ...]:
    places = arrays["block_place"]
    outputs, first_centre, first_column, counts = places.T
    _check_range("block_place", outputs, sizes["J"])
    width = np.array([sizes[f"k{k}"] for k in arrays["readout_of"]])[outputs]
    for first, most in ((first_centre, sizes["m"]), (first_column, width)):
        if (first < 0).any() or (counts < 0).any() or (first > most - counts).any():
            raise ValueError("block_place is outside of the centres or columns")
    columns = (
        arrays["block_gain"],
        arrays["block_shift"],
        arrays["block_root"],
        arrays["block_regressors"],
    )
    return tuple(
        Block(
            i, centre, column, size, float(gain), shift, root, tuple(np.flatnonzero(used).tolist())
        )
        for (i, centre, column, size), gain, shift, root, used in zip(
            places.tolist(), *columns, strict=True
        )
    )


def _check_shape(name, arrays, letters, sizes) -> None:
    """Raise ValueError unless an array has the shape of these sizes; sizes that are new become known."""
    if name not in arrays:
        raise ValueError(f"it lacks {name}")
    shape, expected = arrays[name].shape, letters.split()
    if len(shape) == len(expected):
        for letter, size in zip(expected, shape, strict=True):
            sizes.setdefault(letter, size)
    if shape != tuple(sizes.get(letter, -1) for letter in expected):
        raise ValueError(
            f"{name} is of shape {shape}, but expected {tuple(sizes.get(x, x) for x in expected)}"
        )


def _check_range(name, values, n) -> None:
    if ((values < 0) | (values >= n)).any():
        raise ValueError(f"{name} is outside of 0 to {n - 1}")
