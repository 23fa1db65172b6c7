"""A smaller portable model: fewer basis functions, chosen so that mean and deviation change least."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.linalg import qr, rq, solve_triangular

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix
from skdgp.export._model import Part, PortableModel, Readout, Term


@dataclass(frozen=True)
class ReductionSettings:
    """Numbers of a reduction; guesses."""

    # Numbers of functions of a part that are tried
    sizes: Sequence[int] = tuple(np.unique((4 * 1.15 ** np.arange(36)).astype(int)).tolist())
    # Functions of a part to choose from
    max_candidates: int = 3000
    # Functions of a readout above which fewer points are used, and their number
    many: int = 1500
    fewer: int = 750
    # Shifts of copies of the points to fit at, and to check at, in standard deviations
    moved: Sequence[float] = (0.5, 1.0, 1.5)
    moved_check: Sequence[float] = (0.5,)
    # Least number of moved points
    points: int = 500
    # Remainder of a function that the others represent
    negligible: float = 1e-11


SETTINGS = ReductionSettings()


@one_blas_thread()
def reduced(
    model: PortableModel,
    size: Callable[[PortableModel], int],
    most: int,
) -> PortableModel:
    r"""Return the model with so few basis functions that ``size(model) <= most``, at a small loss.

    The Gaussian functions of a part overlap, so that a few functions g_S and the trend p span the
    others nearly. A pivoted QR factorisation at points of the flights chooses them, as in an
    interpolative decomposition (Cheng et al. 2005). Least squares fit mean and explained root as
    functions of p and g_S. The part whose reduction changes its output most gets the next
    functions, until the size is reached. ``provenance["reduction"]`` holds the loss of each output,
    at the samples or around them, whichever is larger. Raises ValueError if no model is small enough.
    """
    if size(model) <= most:
        return model
    Z, check = _points(model)
    reductions = [_PartReduction(model, j, Z, check) for j in range(len(model.parts))]
    best = _with_parts(model, reductions)
    if size(best) > most:
        raise ValueError(
            f"Got a size of at most {most} bytes, but the smallest form of this model takes "
            f"{size(best)}: allow more."
        )
    while growing := [item for item in reductions if item.can_grow]:
        worst = max(growing, key=attrgetter("loss"))
        if not worst.grow():
            continue
        grown = _with_parts(model, reductions)
        if size(grown) > most:
            break
        best = grown
    return replace(best, provenance=model.provenance | {"reduction": _loss(model, best, check)})


def _with_parts(model: PortableModel, reductions: list[_PartReduction]) -> PortableModel:
    """Return the model with the parts as they are reduced now."""
    return replace(model, parts=tuple(item.reduced for item in reductions))


def _points(model: PortableModel) -> tuple[Matrix, Matrix]:
    """Return scaled regressors to fit and to check at, of the flights and around."""
    rng = np.random.default_rng(0)
    samples = model.scaled(model.samples)
    if max(len(readout.weights) for readout in model.readouts) > SETTINGS.many:
        samples = samples[:: -(-len(samples) // SETTINGS.fewer)]
    spread = samples.std(axis=0)

    def around(Z: Matrix, moved: Sequence[float]) -> Matrix:
        copies = max(len(moved), SETTINGS.points // len(Z))
        steps = np.multiply.outer(np.resize(moved, copies), spread)
        noise = rng.standard_normal((copies, *Z.shape)) * steps[:, None]
        return np.concatenate([Z, *(Z + noise)])

    fitted = around(samples[::2], SETTINGS.moved)
    return fitted, around(samples[1::2], SETTINGS.moved_check)


def _loss(model: PortableModel, small: PortableModel, Z: Matrix) -> dict[str, dict[str, float]]:
    """Return root mean square changes of mean and deviation, over the deviation.

    The larger of two: at the samples, where the standard deviation is least, and around.
    """
    losses = []
    for X in (model.samples, Z * model.scale + model.shift):
        mean, std = model.predict(X, return_std=True, include_input_noise=False)
        changed, reduced_std = small.predict(X, return_std=True, include_input_noise=False)
        changes = np.stack([(changed - mean) / std, reduced_std / std - 1.0])
        losses.append(np.sqrt(np.mean(changes**2, axis=1)))
    of_mean, of_std = np.max(losses, axis=0).tolist()
    loss = {}
    for i, name in enumerate(model.outputs):
        loss[name] = {"mean": of_mean[i], "std": of_std[i]}
    return loss


class _PartReduction:
    """The functions of a part in the order of their use, and the part ``reduced`` to the first ones.

    ``loss`` is the larger of the changes of mean and deviation of the output, root mean square in
    its standard deviations.
    """

    def __init__(
        self,
        model: PortableModel,
        j: int,
        Z: Matrix,
        check: Matrix,
    ) -> None:
        component, i = divmod(j, len(model.outputs))
        self.part = model.parts[j]
        self.weight = model.mixture[component, i]
        self._factorise(Z, model.trend(Z))
        self.trend = model.trend(check)
        _, self.spread = model.moments(i, check, self.trend, True)
        g = self.part.basis(check)
        self.mean = self.part.functions_mean(g)
        self.variance = self.part.variance(self.trend, self.part.explained(g))
        self.checked = np.hstack([self.trend, self._functions(check, self.chosen)])
        self.step = 0
        self.reduced, self.loss = self._fit(self.sizes[0])

    def _factorise(self, Z: Matrix, p: Matrix) -> None:
        """Choose functions at Z, and factorise trend and functions for the fit of mean and explained root.

        Rows are weighted by the standard deviation of the part.
        """
        part = self.part
        g = part.basis(Z)
        explained = part.explained(g)
        weight = 1.0 / np.sqrt(part.variance(p, explained))[:, None]
        trend = weight * p
        candidates = self._candidates(SETTINGS.max_candidates)
        functions = weight * self._functions(Z, candidates)
        order = self._order(trend, functions, SETTINGS.negligible)
        self.sizes = [0, *(size for size in SETTINGS.sizes if size <= len(order))]
        used = order[: self.sizes[-1]]
        self.chosen = candidates[used]
        Q, self.R = qr(np.hstack([trend, functions[:, used]]), mode="economic")
        self.targets = Q.T @ (weight * np.column_stack([part.functions_mean(g), explained]))

    @property
    def can_grow(self) -> bool:
        """Whether a larger number of functions is left to try."""
        return self.step + 1 < len(self.sizes)

    def grow(self) -> bool:
        """Try the next number of functions, and return whether the loss falls; else the part stays."""
        self.step += 1
        part, loss = self._fit(self.sizes[self.step])
        is_better = loss < self.loss
        if is_better:
            self.reduced = part
            self.loss = loss
        return is_better

    def _candidates(self, most: int) -> Indices:
        """Return functions to choose from, by term and place in it (k, 2)."""
        places = [np.empty((0, 2), dtype=int)]
        for t, term in enumerate(self.part.terms):
            n = len(term.centres)
            places.append(np.column_stack([np.full(n, t), np.arange(n)]))
        stacked = np.concatenate(places)
        every = max(1, -(-len(stacked) // most))
        return stacked[::every]

    @staticmethod
    def _order(trend: Matrix, functions: Matrix, negligible: float) -> Indices:
        """Return the functions that the trend and the earlier ones do not represent, largest remainder first."""
        Q, _ = qr(trend, mode="economic")
        residual = functions - Q @ (Q.T @ functions)
        factors: Any = qr(residual, mode="economic", pivoting=True)
        _, R, order = factors
        remainder = np.abs(np.diag(R))
        n = int(np.sum(remainder > negligible * remainder.max(initial=0.0)))
        return order[:n]

    def _chosen(self, places: Indices) -> Iterator[tuple[Indices, Term]]:
        """Yield the rows of ``places`` (k, 2) in each term, and the term of these functions alone."""
        for t, term in enumerate(self.part.terms):
            rows = np.flatnonzero(places[:, 0] == t)
            if len(rows):
                yield rows, replace(term, centres=term.centres[places[rows, 1]])

    def _functions(self, Z: Matrix, places: Indices) -> Matrix:
        """Return Gaussian functions, by term and place in it (k, 2), at scaled regressors, (n, k)."""
        values = np.empty((len(Z), len(places)))
        for columns, term in self._chosen(places):
            values[:, columns] = term.functions(Z)
        return values

    def _fit(self, n: int) -> tuple[Part, float]:
        """Return the part with the first n functions, and its loss."""
        if self.weight == 0.0:
            return self.part, 0.0
        rows = slice(0, self.trend.shape[1] + n)
        solved: Any = solve_triangular(self.R[rows, rows], self.targets[rows])
        return self._part(solved, self.chosen[:n]), self._change(solved)

    def _change(self, solved: Matrix) -> float:
        """Return the loss by fitted weights of mean and explained root."""
        fitted = self.checked[:, : len(solved)] @ solved
        change = fitted[:, 0] - self.mean
        of_mean = self.weight**2 * np.mean(change**2 / self.spread)
        variance = self.part.variance(self.trend, fitted[:, 1:])
        ratio = 1.0 + self.weight * (variance - self.variance) / self.spread
        of_std = np.mean((np.sqrt(np.maximum(ratio, 0.0)) - 1.0) ** 2)
        return float(np.sqrt(max(of_mean, of_std)))

    def _part(self, solved: Matrix, places: Indices) -> Part:
        """Return the part of functions with fitted weights of mean and explained root."""
        part = self.part
        e = len(part.trend_weights)
        order = np.lexsort((places[:, 1], places[:, 0]))
        solved = np.concatenate([solved[:e], solved[e:][order]])
        weights = solved[:, 0]
        explained = solved[:, 1:]
        # h = T^T p + (0, U^T g) by p and the functions
        size = max(part.trend_root.shape[1], len(solved))
        root: Any = np.zeros((len(solved), size))
        root[:e, size - part.trend_root.shape[1] :] = part.trend_root
        root[:, size - explained.shape[1] :] += explained
        root = rq(root, mode="r")[:, -len(solved) :]
        terms = []
        for rows, term in self._chosen(places[order]):
            terms.append(replace(term, first=int(rows[0])))
        return replace(
            part,
            terms=tuple(terms),
            readout=Readout(weights[e:], root[e:, e:]),
            trend_weights=part.trend_weights + weights[:e],
            trend_root=root[:e],
        )
