"""The build-up of a model: constants, derivatives and tables, as simulators read them."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy.linalg import cho_factor, cho_solve, lapack
from scipy.sparse import csr_array
from sklearn.utils import check_random_state

from skdgp._compute.files import plain, text_writer, write_atomically
from skdgp._compute.typing import Array, Matrix, Seed, Vector
from skdgp._effects import in_units, samples_of, split_model
from skdgp._flight.channels import COEFFICIENTS
from skdgp._flight.checks import check_choice
from skdgp.dynamics import Aircraft, as_aerodynamics
from skdgp.export._text import units_of
from skdgp.inference import ExactPosterior

MAX_POINTS, MAX_TESTED = (
    10000,
    10000,
)  # samples of the projection; samples over which its loss is measured
FEW_POINTS = 2500  # samples of the projection while terms are chosen, and for deviations
OTHERS, OTHERS_WEIGHT = (
    0.4,
    0.25,
)  # points that mix the regressors of different samples: share, and weight of each
FEW, SINGLE, PAIR = (
    5,
    33,
    9,
)  # breakpoints: of pairs while terms are chosen; the most of a table of one and of two
CURVATURE = 3e-6  # penalty of squared second differences, for each point
NEGLIGIBLE = 1e-5  # of the mean variance: what a root of the posterior covariance leaves out
CHUNK = 512  # points whose covariance with the others is computed at once
RIDGE, PAIR_RIDGE = (
    1e-7,
    1e-6,
)  # of squared values; a table of two holds only what tables of one cannot


class Table(NamedTuple):
    """A part of a coefficient: linear between breakpoints, constant beyond the edges.

    Parameters
    ----------
    regressors, breakpoints : tuples
        One or two names, and the increasing breakpoints of each.
    values, std : ndarray (n,) or (n, m)
        At the breakpoints, and their standard deviations.
    """

    regressors: tuple[str, ...]
    breakpoints: tuple[Vector, ...]
    values: Array
    std: Array

    def __call__(self, X: Matrix) -> Vector:
        """Return the values at X (n, 1) or (n, 2), the regressors of the table."""
        cells, weights = _cells(np.asarray(X, dtype=float), self.breakpoints)
        return np.einsum("nk,nk->n", weights, np.ravel(self.values)[cells])


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class BuildUp:
    r"""The coefficients as sums of constants, derivatives and tables, each with a standard deviation.

    .. math:: C_i(x) = C_{i0} + \sum_k C_{ik} (x_k - \bar x_k) + \sum_t T_{it}(x)

    Attributes
    ----------
    aircraft : Aircraft
    regressors : tuple of str
        Names of the d regressors.
    units : tuple of str
        Of the regressors; "-" without one.
    reference : ndarray (d,)
        The point of the constants: the mean of the samples.
    limits : ndarray (2, d)
        Smallest and largest value of each regressor in the samples; breakpoints lie between them.
    lengths : tuple of float
        Span and chord of the non-dimensional rates [m].
    samples, predicted, predicted_std : ndarray (n, d), (n, 6), (n, 6)
        Samples of the flown envelope, the coefficients of the model at them, and their standard
        deviations.
    loss : DataFrame (6, 2)
        Root mean squares over the samples: "loss", the difference to the model, and "deviation", of
        its posterior.
    """

    aircraft: Aircraft
    regressors: tuple[str, ...]
    units: tuple[str, ...]
    reference: Vector
    limits: Matrix
    lengths: tuple[float, float]
    samples: Matrix
    predicted: Matrix
    predicted_std: Matrix
    loss: pd.DataFrame
    _bases: dict[str, _Basis]
    _weights: dict[str, Vector]
    _roots: dict[str, Matrix]
    _draw: Callable[[int, Seed], dict[str, Matrix]]

    def __repr__(self) -> str:
        n_tables = sum(map(len, self.tables.values()))
        return f"BuildUp({self.aircraft.name!r}, {', '.join(self.regressors)}, {n_tables} tables)"

    @property
    def constants(self) -> pd.Series:
        """Coefficients at the reference, without tables, (6,)."""
        return pd.Series({name: weights[0] for name, weights in self._weights.items()})

    @property
    def constants_std(self) -> pd.Series:
        """Standard deviations of the constants, (6,)."""
        return pd.Series({name: std[0] for name, std in self._stds.items()})

    @property
    def derivatives(self) -> pd.DataFrame:
        """Slopes, average over the samples, (6, d); tables hold what differs from straight lines."""
        return self._slopes(self._weights)

    @property
    def derivatives_std(self) -> pd.DataFrame:
        """Standard deviations of the derivatives, (6, d)."""
        return self._slopes(self._stds)

    @cached_property
    def tables(self) -> dict[str, list[Table]]:
        """Tables of each coefficient, of one regressor and of two."""
        found: dict[str, list[Table]] = {}
        for name, basis in self._bases.items():
            found[name] = []
            for axes, rows in zip(basis.tables, basis.slices, strict=True):
                shape = [len(points) for points in axes.breakpoints]
                cells = (
                    values[name][rows].reshape(shape) for values in (self._weights, self._stds)
                )
                found[name].append(
                    Table(tuple(self.regressors[k] for k in axes.columns), axes.breakpoints, *cells)
                )
        return found

    def evaluate(self, X: Any, return_std: bool = False) -> Any:
        """Return the coefficients (n, 6) at regressors X, and with ``return_std`` their standard deviations, too.

        X is an array (n, d) of the regressors in their order, or a table with all of them by name.
        """
        X = (
            X[list(self.regressors)].to_numpy(float)
            if isinstance(X, pd.DataFrame)
            else np.asarray(X, dtype=float)
        )
        mean, variance = np.empty((2, len(X), len(COEFFICIENTS)))
        for i, name in enumerate(COEFFICIENTS):
            basis = self._bases[name](X)
            mean[:, i] = basis @ self._weights[name]
            if return_std:
                variance[:, i] = np.square(basis @ self._roots[name]).sum(axis=1)
        return (mean, np.sqrt(variance)) if return_std else mean

    def effects(
        self, coefficient: str
    ) -> Callable[[tuple[str, ...], Matrix], tuple[Vector, Vector]]:
        """Return a function that evaluates parts of a coefficient.

        It takes names of one or two regressors and their values (n, 1) or (n, 2), and returns mean
        and standard deviation (n,) of the terms of exactly these: derivative and table of one
        regressor, the table of two. The terms have mean zero over the samples.
        """
        basis, weights = self._bases[coefficient], self._weights[coefficient]
        centre = np.asarray(basis(self.samples).mean(axis=0)).ravel()

        def effect(regressors, X):
            places = [self.regressors.index(regressor) for regressor in regressors]
            points = np.tile(self.reference, (len(X), 1))
            points[:, places] = X
            chosen = [1 + place for place in places] if len(places) == 1 else []
            for table, rows in zip(basis.tables, basis.slices, strict=True):
                if table.columns == tuple(places):
                    chosen += range(rows.start, rows.stop)
            values = basis(points)[:, chosen].toarray() - centre[chosen]
            root = self._roots[coefficient][chosen]
            return values @ weights[chosen], np.sqrt(np.square(values @ root).sum(axis=1))

        return effect

    def correlation(self, coefficient: str) -> Matrix:
        """Return the posterior correlation of the constant and the derivatives of a coefficient, (1 + d, 1 + d)."""
        root = self._roots[coefficient][: 1 + len(self.regressors)]
        size = self._stds[coefficient][: len(root)]
        root = root / np.where(size > 0, size, 1.0)[:, None]
        return root @ root.T

    def sample(self, n_draws: int, random_state: Seed = 0) -> list[BuildUp]:
        """Return build-ups of functions drawn from the posterior, with these breakpoints: aircraft that the data allow.

        Equal seeds give equal functions, those of ``sample_paths``.
        """
        drawn = self._draw(n_draws, random_state) if n_draws else {}
        return [
            replace(self, _weights={name: drawn[name][k] for name in drawn}) for k in range(n_draws)
        ]

    @cached_property
    def _stds(self) -> dict[str, Vector]:
        return {name: np.sqrt(np.square(root).sum(axis=1)) for name, root in self._roots.items()}

    def _slopes(self, weights: dict[str, Vector]) -> pd.DataFrame:
        d = len(self.regressors)
        return pd.DataFrame(
            [weights[name][1 : 1 + d] for name in weights], list(weights), list(self.regressors)
        )


def build_up(
    model: Any,
    aircraft: Aircraft,
    *,
    X: Any = None,
    tolerance: float = 0.1,
    pairs: str = "all",
    max_loss: float = 1.0,
) -> BuildUp:
    r"""Return the coefficients of a model as constants, derivatives and tables of one and of two regressors.

    The posterior mean f is projected on such sums: with the basis :math:`\Phi` of the terms at the
    samples, weights W, and a small penalty R of curvature, the values of all cells are
    :math:`\theta = L f`, :math:`L = (\Phi^T W \Phi + R)^{-1} \Phi^T W` (the functional ANOVA of
    Hooker 2007, by least squares). They are jointly normal with the covariance :math:`L K L^T` of
    the posterior covariance K. Mixtures of samples with a small weight determine cells that were
    not flown. Of joint processes terms of three and more regressors are lost.

    Raises TypeError if the model is not a ``DependentGPRegressor``, nor a pipeline that ends in
    one; ValueError if a coefficient loses more than ``max_loss``, the model lacks a coefficient, is
    compact and X is not given, or a parameter is invalid.

    Parameters
    ----------
    model : DependentGPRegressor or Pipeline
        Fitted to all six coefficients; a pipeline ends in a ``DependentGPRegressor``.
    aircraft : Aircraft
    X : array or DataFrame (n, ...), optional
        Input of the model: samples of the flown envelope. Default: the training samples, which a
        compact model lacks.
    tolerance : float, default=0.1
        Largest effect on a coefficient of the terms left out, root mean square over the samples,
        and of the breakpoints left out of a table, as fractions of the root mean square posterior
        deviation.
    pairs : {"all", "alpha", "none"}, default="all"
        Tables of two regressors to choose from: any two, alpha and another, or none.
    max_loss : float, default=1.0
        Largest loss, root mean square over the samples, as a fraction of the root mean square
        posterior deviation; ``np.inf`` accepts any.

    Returns
    -------
    BuildUp
        ``constants``, ``derivatives``, ``tables``, ``loss``; ``evaluate(X)`` and
        ``sample(n_draws)``.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp import DependentGPRegressor
    >>> from skdgp.dynamics import Aircraft
    >>> from skdgp.export import build_up
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> X = pd.DataFrame(np.random.default_rng(0).uniform(-0.1, 0.1, (50, 2)), columns=["alpha", "elevator"])
    >>> Y = pd.DataFrame(X.to_numpy() @ [[0, 0, -4, 0, -0.5, 0], [0, 0, -0.3, 0, -0.6, 0]],
    ...                  columns=["CX", "CY", "CZ", "Cl", "Cm", "Cn"])
    >>> Y += np.random.default_rng(1).normal(0, 1e-3, Y.shape)
    >>> found = build_up(DependentGPRegressor(structure="trend").fit(X, Y), glider)
    >>> found.derivatives.loc["Cm"].round(1).to_dict(), sum(map(len, found.tables.values()))
    ({'alpha': -0.5, 'elevator': -0.6}, 0)
    """
    check_choice("pairs", pairs, ("all", "alpha", "none"))
    if not 0 < tolerance < np.inf or not max_loss > 0:
        raise ValueError(
            f"Got tolerance={tolerance!r}, max_loss={max_loss!r}, but expected positive fractions."
        )
    posterior = Posterior(model, X)
    few, points = (_points(posterior.samples, most) for most in (FEW_POINTS, MAX_POINTS))
    mean, mean_of_few = posterior.mean(points.X), posterior.mean(few.X)
    tested = posterior.tested
    truth, std = posterior.mean(tested), posterior.deviation(tested)
    deviation = np.sqrt(np.mean(std**2, axis=0))
    kept = _important(few, mean_of_few, tolerance * deviation, _candidates(posterior.names, pairs))
    bases, weights, losses = {}, {}, {}
    for i, name in enumerate(COEFFICIENTS):
        basis = bases[name] = _chosen(few, mean_of_few[:, i], tolerance * deviation[i], kept[i])
        weights[name] = _Projection(basis, points)(mean[:, [i]])[:, 0]
        losses[name] = np.sqrt(np.mean((basis(tested) @ weights[name] - truth[:, i]) ** 2))
    loss = pd.DataFrame({"loss": pd.Series(losses), "deviation": deviation})
    _check_loss(loss, max_loss, pairs)
    roots = {
        name: _Projection(bases[name], few)(posterior.root(i, few.X))
        for i, name in enumerate(COEFFICIENTS)
    }

    def draw(n_draws, random_state):
        values = posterior.paths(n_draws, random_state, points.X)
        return {
            name: _Projection(bases[name], points)(values[..., i].T).T
            for i, name in enumerate(COEFFICIENTS)
        }

    return BuildUp(
        aircraft=aircraft,
        regressors=tuple(posterior.names),
        units=units_of(posterior.names, getattr(model, "control_units_", {})),
        reference=points.reference,
        limits=posterior.limits,
        lengths=posterior.lengths(aircraft),
        samples=tested,
        predicted=truth,
        predicted_std=std,
        loss=loss,
        _bases=bases,
        _weights=weights,
        _roots=roots,
        _draw=draw,
    )


def write_build_up(path: str | os.PathLike, build: BuildUp) -> None:
    """Write a build-up as JSON, SI units and radians, or units of the controls; docs/export.md describes its keys."""
    columns = zip(build.regressors, build.units, build.reference, build.limits.T, strict=True)
    regressors = {
        name: {"unit": unit, "reference": reference, "limits": limits}
        for name, unit, reference, limits in columns
    }
    coefficients = {
        name: {
            "constant": build.constants[name],
            "constant_std": build.constants_std[name],
            "derivatives": build.derivatives.loc[name].to_dict(),
            "derivatives_std": build.derivatives_std.loc[name].to_dict(),
            "tables": [table._asdict() for table in build.tables[name]],
            **build.loss.loc[name].to_dict(),
        }
        for name in COEFFICIENTS
    }
    aircraft = {"name": build.aircraft.name, "span": build.lengths[0], "chord": build.lengths[1]}
    values = {"aircraft": aircraft, "regressors": regressors, "coefficients": coefficients}
    write_atomically(path, text_writer(json.dumps(plain(values)) + "\n"))


def _check_loss(loss: pd.DataFrame, max_loss: float, pairs: str) -> None:
    ratio = loss["loss"] / loss["deviation"]
    if large := {name: f"{value:.2g}" for name, value in ratio.items() if value > max_loss}:
        hint = "" if pairs == "all" else " pairs='all',"
        raise ValueError(
            f"Got a model that tables of at most two regressors change by {large} posterior "
            f"deviations (root mean "
            f"square over the samples), but expected at most {max_loss:g}. Try{hint} a smaller "
            f"tolerance, a model with "
            "structure='additive', or accept the loss: max_loss=np.inf."
        )


class Points(NamedTuple):
    """Points X (n, d) at which functions are projected: samples, then mixtures; mean and deviation of all samples."""

    X: Matrix
    weight: Vector
    n_samples: int
    reference: Vector
    scale: Vector


def _points(samples: Matrix, most: int) -> Points:
    """Return some samples, the extreme ones among them, and mixtures of samples."""
    rng = check_random_state(0)
    ends = np.concatenate(
        [samples.argmin(axis=0), samples.argmax(axis=0)]
    )  # tables reach over all samples
    flown = samples[np.union1d(rng.permutation(len(samples))[:most], ends)]
    others = max(1000, int(OTHERS * len(flown)))
    mixed = np.column_stack([rng.choice(column, others) for column in samples.T])
    weight = np.concatenate(
        [np.ones(len(flown)), np.full(others, OTHERS * OTHERS_WEIGHT * len(flown) / others)]
    )
    scale = samples.std(axis=0)
    X, scale = np.concatenate([flown, mixed]), np.where(scale > 0, scale, 1.0)
    return Points(X, weight, len(flown), samples.mean(axis=0), scale)


def _candidates(names: Sequence[str], pairs: str) -> list[tuple[int, ...]]:
    """Return the columns of the terms to choose from: each regressor, and the allowed pairs."""
    every = list(combinations(range(len(names)), 2))
    with_alpha = [pair for pair in every if "alpha" in (names[pair[0]], names[pair[1]])]
    return [
        *((k,) for k in range(len(names))),
        *{"all": every, "alpha": with_alpha, "none": []}[pairs],
    ]


def _grids(points: Points, terms: Sequence[tuple[int, ...]], single: int, pair: int) -> list[Axes]:
    """Return breakpoints over the range of the regressors that vary, closer where samples are."""
    flown = points.X[: points.n_samples]

    def grid(x, n):
        return np.unique(
            0.5 * np.linspace(x.min(), x.max(), n) + 0.5 * np.quantile(x, np.linspace(0.0, 1.0, n))
        )

    varying = [term for term in terms if all(np.ptp(flown[:, k]) > 0 for k in term)]
    return [
        Axes(term, tuple(grid(flown[:, k], single if len(term) == 1 else pair) for k in term))
        for term in varying
    ]


def _important(
    points: Points, mean: Matrix, least: Vector, terms: Sequence[tuple[int, ...]]
) -> list[list]:
    """Return the terms of each coefficient; those left out together change it by less than ``least`` (6,), RMS."""
    basis = _Basis(_grids(points, terms, 2 * PAIR - 1, FEW), points.reference)
    weights, flown = _Projection(basis, points)(mean), basis(points.X[: points.n_samples])
    parts = (
        np.stack([flown[:, rows] @ weights[rows] for rows in basis.slices])
        if basis.slices
        else np.empty((0, 0, 6))
    )
    kept = []
    for i in range(len(COEFFICIENTS)):
        size = np.array([part[:, i].std() for part in parts])
        order = np.argsort(size)
        left_out = np.cumsum(
            parts[order][:, :, i] - parts[order][:, :, i].mean(axis=1, keepdims=True), axis=0
        )
        enough = (
            np.sqrt(np.mean(left_out**2, axis=1)) > least[i] if len(order) else np.empty(0, bool)
        )
        first = int(np.argmax(enough)) if enough.any() else len(order)
        kept.append([basis.tables[k].columns for k in sorted(order[first:])])
    return kept


def _chosen(points: Points, mean: Vector, least: float, terms: Sequence[tuple[int, ...]]) -> _Basis:
    """Return the basis of the terms with as few breakpoints as change no table by more than ``least``."""
    fine = _Basis(_grids(points, terms, SINGLE, PAIR), points.reference)
    weights = _Projection(fine, points)(mean[:, None])[:, 0]
    tables = []
    for table, rows in zip(fine.tables, fine.slices, strict=True):
        values = weights[rows].reshape([len(p) for p in table.breakpoints])
        kept = tuple(
            points_[_needed(points_, np.moveaxis(values, axis, 0).reshape(len(points_), -1), least)]
            for axis, points_ in enumerate(table.breakpoints)
        )
        tables.append(table._replace(breakpoints=kept))
    return _Basis(tables, points.reference)


def _needed(points: Vector, values: Matrix, least: float) -> list[int]:
    """Return the breakpoints between which straight lines keep all columns within ``least`` (Douglas & Peucker)."""
    needed, queue = {0, len(points) - 1}, [(0, len(points) - 1)]
    while queue:
        a, b = queue.pop()
        share = ((points[a : b + 1] - points[a]) / (points[b] - points[a]))[:, None]
        off = np.abs(values[a : b + 1] - (1 - share) * values[a] - share * values[b]).max(axis=1)
        worst = a + int(off.argmax())
        if off.max() > least and a < worst < b:
            needed.add(worst)
            queue += [(a, worst), (worst, b)]
    return sorted(needed)


class Axes(NamedTuple):
    """Regressors of a table, as columns, and their breakpoints."""

    columns: tuple[int, ...]
    breakpoints: tuple[Vector, ...]

    @property
    def size(self) -> int:
        """Number of cells."""
        return int(np.prod([len(points) for points in self.breakpoints]))


class _Basis:
    """The functions whose sum is a coefficient: 1, the regressors less the reference, and hats of each table."""

    def __init__(self, tables: Sequence[Axes], reference: Vector):
        self.tables, self.reference = list(tables), reference
        edges = np.cumsum([1 + len(reference), *(table.size for table in self.tables)])
        self.slices = [slice(a, b) for a, b in pairwise(edges)]
        self.size = int(edges[-1])

    def __call__(self, X: Matrix) -> csr_array:
        """Return their values at X, (n, size): few of a row are not zero."""
        cells = [_cells(X[:, list(table.columns)], table.breakpoints) for table in self.tables]
        lines = np.broadcast_to(
            np.arange(1 + len(self.reference)), (len(X), 1 + len(self.reference))
        )
        columns = [
            lines,
            *(k + rows.start for (k, _), rows in zip(cells, self.slices, strict=True)),
        ]
        values = np.hstack(
            [np.ones((len(X), 1)), X - self.reference, *(weights for _, weights in cells)]
        )
        places = np.arange(len(X) + 1) * values.shape[1]
        return csr_array(
            (values.ravel(), np.hstack(columns).ravel(), places), shape=(len(X), self.size)
        )


class _Projection:
    """The weights of a basis that represent functions by their values at points, by penalised least squares."""

    def __init__(self, basis: _Basis, points: Points):
        self.scale = np.concatenate(
            [[1.0], 1.0 / points.scale, np.ones(basis.size - 1 - len(basis.reference))]
        )
        values, total = basis(points.X) * self.scale[None, :], points.weight.sum()
        self.weighted = csr_array((values * points.weight[:, None]).T)
        normal = (self.weighted @ values).toarray()
        for table, rows in zip(basis.tables, basis.slices, strict=True):
            normal[rows, rows] += total * _penalty(table)
        np.einsum("aa->a", normal)[:] += 1e-12 * total
        self.factor = cho_factor(normal, overwrite_a=True, check_finite=False)

    def __call__(self, values: Matrix) -> Matrix:
        """Return the weights (size, m) of functions with values (n, m) at the points."""
        return self.scale[:, None] * cho_solve(
            self.factor, self.weighted @ values, check_finite=False
        )


def _cells(X: Matrix, breakpoints: Sequence[Vector]) -> tuple[Any, Matrix]:
    """Return the cells (n, 2) or (n, 4) of which a table at X (n, 1) or (n, 2) is a mean, and their weights."""
    cells, weights = np.zeros((len(X), 1), dtype=int), np.ones((len(X), 1))
    for x, points in zip(X.T, breakpoints, strict=True):
        left = np.clip(np.searchsorted(points, x, side="right") - 1, 0, len(points) - 2)
        share = np.clip((x - points[left]) / np.diff(points)[left], 0.0, 1.0)
        sides, shares = np.column_stack([left, left + 1]), np.column_stack([1.0 - share, share])
        cells = (cells[:, :, None] * len(points) + sides[:, None, :]).reshape(len(X), -1)
        weights = (weights[:, :, None] * shares[:, None, :]).reshape(len(X), -1)
    return cells, weights


def _penalty(table: Axes) -> Matrix:
    """Return R of the penalty v^T R v of the cells v of a table."""
    curvatures = [_curvature(points) for points in table.breakpoints]
    if len(curvatures) == 1:
        return CURVATURE * curvatures[0] + RIDGE * np.eye(table.size)
    first, second = (np.eye(len(points)) for points in table.breakpoints)
    both = np.kron(curvatures[0], second) + np.kron(first, curvatures[1])
    return CURVATURE * both + PAIR_RIDGE * np.eye(table.size)


def _curvature(points):
    """Return D^T D of the second differences D, over the mean distance of the breakpoints."""
    steps, mean = np.diff(points), np.diff(points).mean()
    D = np.zeros((max(len(points) - 2, 0), len(points)))
    for row, (a, b) in enumerate(pairwise(steps)):
        D[row, row : row + 3] = [mean / a, -mean / a - mean / b, mean / b]
    return D.T @ D


class Posterior:
    """Mean, covariance and functions of a fitted model, by regressors in their units."""

    def __init__(self, model: Any, X: Any):
        self.regressor, before, self.scalers, self.names = split_model(model)
        self.mean = as_aerodynamics(model)
        self.last = model[-1] if before is not None else model
        self.factors = np.asarray(getattr(self.last, "std_scale_", 1.0)) * self.regressor.scale_
        outputs = self.regressor.output_names_
        self.order = (
            [outputs.index(c) for c in COEFFICIENTS]
            if set(COEFFICIENTS) <= set(outputs)
            else list(range(6))
        )
        self.samples = np.asarray(in_units(samples_of(self.regressor, before, X), self.scalers))
        self.tested = self.samples[:: -(-len(self.samples) // MAX_TESTED)]
        self.limits = np.stack([self.samples.min(axis=0), self.samples.max(axis=0)])
        self.scale = self.regressor.scale_[self.order]

    def lengths(self, aircraft: Aircraft) -> tuple[float, float]:
        """Return span and chord of the non-dimensional rates."""
        return (self.mean.span or aircraft.span, self.mean.chord or aircraft.chord)

    def _scaled(self, X):
        for step in reversed(self.scalers):
            names = getattr(step, "feature_names_in_", None)
            X = np.asarray(
                step.transform(X if names is None else pd.DataFrame(X, columns=list(names)))
            )
        return np.ascontiguousarray(X, dtype=float)

    def deviation(self, X: Matrix) -> Vector:
        """Return the standard deviations of the coefficients at X, (n, 6)."""
        variance = self.regressor.posterior_.predict(self._scaled(X), return_variance=True)[1]
        return (np.sqrt(variance) * self.factors)[:, self.order]

    def root(self, i: int, X: Matrix) -> Matrix:
        """Return F (n, r) such that F F^T is the posterior covariance of coefficient i at X."""
        posterior, i, X = self.regressor.posterior_, self.order[i], self._scaled(X)
        members, weights = posterior.members, posterior.mixture
        chunks = [slice(a, a + CHUNK) for a in range(0, len(X), CHUNK)]
        covariance = np.zeros((len(X), len(X)), order="F")  # the lower triangle
        means = np.empty((len(X), len(members)))
        for k, member in enumerate(members):
            left, right = member.loading(i, X)
            means[:, k] = left @ right
            if isinstance(member, ExactPosterior):
                right = member.solve(left.T)
            else:
                left = left @ member.roots[i]
                right = left.T
            for c in chunks:
                of_member = (
                    member.kernel.block(i, i, X[c.start :], X[c]) - left[c.start :] @ right[:, c]
                )
                covariance[c.start :, c] += weights[k, i] * of_member
        away = (means - (means @ weights[:, i])[:, None]) * np.sqrt(weights[:, i])
        for c in chunks:
            covariance[c.start :, c] += away[c.start :] @ away[c].T
        least = NEGLIGIBLE * max(float(np.mean(np.diag(covariance))), 0.0)
        lower, pivots, rank, _ = lapack.dpstrf(covariance, tol=least, lower=1, overwrite_a=1)
        root = np.empty((len(X), rank))
        root[pivots - 1] = np.tril(lower[:, :rank])
        root *= self.factors[i]
        return root

    def paths(self, n_paths: int, random_state: Seed, X: Matrix) -> Array:
        """Return the coefficients (n_paths, n, 6) of functions of the posterior."""
        return self.last.sample_paths(n_paths, random_state)(self._scaled(X))[..., self.order]
