"""The portable model: the posterior of an identified aircraft as arrays, for other programs to evaluate."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from itertools import chain
from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Matrix, Vector
from skdgp.dynamics import Aircraft


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
        Reference length L [m] of a non-dimensional rate, 1 of others.
    power : {0, 1, 2}
        n: 0 for a column itself, 1 for a rate, 2 for an angular acceleration. V is the column
        ``airspeed`` [m/s].
    """

    name: str
    unit: str
    sources: tuple[str, ...]
    factors: tuple[float, ...]
    length: float
    power: int

    @property
    def columns(self) -> tuple[str, ...]:
        """All columns that it is computed from."""
        return (*self.sources, "airspeed") if self.power else self.sources


@dataclass(frozen=True, eq=False)
class Term:
    r"""Gaussian functions of one width: neighbouring entries of the basis of one part.

    .. math:: g_k(z) = \mathrm{gain} \, \exp\left(-\frac{1}{2} |f \circ z - c_k|^2\right)

    Parameters
    ----------
    first : int
        Entry of the basis that the first function adds to.
    gain : float
    inverse_widths : ndarray (d,)
        f.
    centres : ndarray (k, d)
        c.
    """

    first: int
    gain: float
    inverse_widths: Vector
    centres: Matrix

    @property
    def entries(self) -> slice:
        """Entries of the basis that the functions add to."""
        return slice(self.first, self.first + len(self.centres))


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

    With scaled regressors z, p = (1, z) and the basis g(z) of the terms,

    .. math:: \mu = v^T p + w^T g, \quad \nu = a + |R^T p|^2 - |h|^2, \quad
              h = T^T p + (0, U^T g).

    Parameters
    ----------
    terms : tuple of Term
    readout : Readout
        w and U, which acts on the last k entries of h; parts may share one.
    trend_weights : ndarray (d + 1,)
        v: posterior mean of intercept and slopes.
    trend_root : ndarray (d + 1, r)
        T, with k <= r <= k + d + 1.
    trend_prior : ndarray (d + 1, s)
        R, a root of the prior covariance R R^T of intercept and slopes; any number s of columns.
    prior_variance : float
        a, of the Gaussian functions.
    """

    terms: tuple[Term, ...]
    readout: Readout
    trend_weights: Vector
    trend_root: Matrix
    trend_prior: Matrix
    prior_variance: float


@dataclass(frozen=True, eq=False)
class Reference:
    """Predictions of the pipeline that a model is exported from, at exact regressors.

    Parameters
    ----------
    regressors : ndarray (n, d)
        In their units, in and near the training data.
    mean, std : ndarray (n, P)
    slopes : ndarray (n, P, d)
        Of the mean.
    """

    regressors: Matrix
    mean: Matrix
    std: Matrix
    slopes: Array


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

    def components(self, i: int) -> list[tuple[float, Part]]:
        """Return the components of output i: weight and part; those of weight zero have no functions."""
        parts = self.parts[i :: len(self.outputs)]
        return list(zip(self.mixture[:, i].tolist(), parts, strict=True))

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
        parts = self.parts
        readouts = self.readouts
        values = vars(self).items()
        arrays = {name: value for name, value in values if isinstance(value, np.ndarray)}
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
            arrays[f"reference_{name}"] = array
        return arrays

    def _term_arrays(self) -> dict[str, np.ndarray]:
        """Return the arrays of all terms, one after another."""
        d = len(self.regressors)
        terms = [(j, term) for j, part in enumerate(self.parts) for term in part.terms]
        places = [(j, term.first, len(term.centres)) for j, term in terms]
        widths = [term.inverse_widths for _, term in terms]
        return {
            "term_place": np.array(places, dtype=np.int64).reshape(-1, 3),
            "term_gain": np.array([term.gain for _, term in terms]),
            "term_inverse_widths": np.array(widths).reshape(-1, d),
            "centres": np.vstack([np.empty((0, d)), *(term.centres for _, term in terms)]),
        }


def packed(triangle: Matrix) -> Vector:
    """Return an upper triangle (k, k) column by column: 1, 2, ... k entries."""
    return triangle.T[np.tril_indices(len(triangle))]
