"""A smaller portable model: fewer basis functions, chosen so that mean and deviation change least."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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
    settings: ReductionSettings = SETTINGS,
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
    Z, check = _points(model, settings)
    reductions = [_PartReduction(model, j, Z, check, settings) for j in range(len(model.parts))]
    numbers = [0] * len(reductions)
    parts = []
    losses = []
    for reduction in reductions:
        part, loss = reduction.fit(0)
        parts.append(part)
        losses.append(loss)
    best = replace(model, parts=tuple(parts))
    if size(best) > most:
        raise ValueError(
            f"Got a size of at most {most} bytes, but the smallest form of this model takes "
            f"{size(best)}: allow more."
        )
    while True:
        growing = [j for j, item in enumerate(reductions) if numbers[j] + 1 < len(item.sizes)]
        if not growing:
            break
        worst = max(growing, key=losses.__getitem__)
        numbers[worst] += 1
        part, loss = reductions[worst].fit(numbers[worst])
        if loss >= losses[worst]:
            continue
        losses[worst] = loss
        parts[worst] = part
        grown = replace(model, parts=tuple(parts))
        if size(grown) > most:
            break
        best = grown
    return replace(best, provenance=model.provenance | {"reduction": _loss(model, best, check)})


def _points(model: PortableModel, settings: ReductionSettings) -> tuple[Matrix, Matrix]:
    """Return scaled regressors to fit and to check at, of the flights and around."""
    rng = np.random.default_rng(0)
    samples = model.scaled(model.samples)
    if max(len(readout.weights) for readout in model.readouts) > settings.many:
        samples = samples[:: -(-len(samples) // settings.fewer)]
    spread = samples.std(axis=0)

    def around(Z: Matrix, moved: Sequence[float]) -> Matrix:
        copies = max(len(moved), settings.points // len(Z))
        steps = spread * np.resize(moved, copies)[:, None]
        noise = rng.standard_normal((copies, *Z.shape)) * steps[:, None]
        return np.concatenate([Z, *(Z + noise)])

    fitted = around(samples[::2], settings.moved)
    return fitted, around(samples[1::2], settings.moved_check)


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
    """The functions of a part in the order of their use, and the fit of the first ones."""

    def __init__(
        self,
        model: PortableModel,
        j: int,
        Z: Matrix,
        check: Matrix,
        settings: ReductionSettings,
    ) -> None:
        component, i = divmod(j, len(model.outputs))
        self.part = model.parts[j]
        self.weight = model.mixture[component, i]
        self.trend = model.trend(check)
        self.spread = model.moments(i, check, self.trend, True)[1]
        g = self.part.basis(check)
        self.mean = self.part.functions_mean(g)
        self.variance = self.part.variance(self.trend, self.part.explained(g))

        # Rows are weighted by the standard deviation of the part
        p = model.trend(Z)
        g = self.part.basis(Z)
        explained = self.part.explained(g)
        scale = 1.0 / np.sqrt(self.part.variance(p, explained))[:, None]
        candidates = self._candidates(settings.max_candidates)
        functions = scale * self._functions(Z, candidates)
        order = self._order(scale * p, functions, settings.negligible)
        self.sizes = [0, *(size for size in settings.sizes if size <= len(order))]
        used = order[: self.sizes[-1]]
        self.chosen = candidates[used]
        Q, self.R = qr(np.hstack([scale * p, functions[:, used]]), mode="economic")
        mean = self.part.functions_mean(g)
        self.targets = Q.T @ (scale * np.column_stack([mean, explained]))
        self.checked = np.hstack([self.trend, self._functions(check, self.chosen)])

    def _candidates(self, most: int) -> Indices:
        """Return functions to choose from, by term and place in it (k, 2)."""
        places = []
        for t, term in enumerate(self.part.terms):
            for k in range(len(term.centres)):
                places.append((t, k))
        every = max(1, -(-len(places) // most))
        return np.array(places[::every], dtype=int).reshape(-1, 2)

    @staticmethod
    def _order(trend: Matrix, functions: Matrix, negligible: float) -> Indices:
        """Return the functions that the trend and the earlier ones do not represent, largest remainder first."""
        Q, _ = qr(trend, mode="economic")
        residual = functions - Q @ (Q.T @ functions)
        _, R, order = qr(residual, mode="economic", pivoting=True)
        remainder = np.abs(np.diag(R))
        n = int(np.sum(remainder > negligible * remainder.max(initial=0.0)))
        return np.asarray(order[:n])

    def _functions(self, Z: Matrix, places: Indices) -> Matrix:
        """Return Gaussian functions, by term and place in it (k, 2), at scaled regressors, (n, k)."""
        values = np.empty((len(Z), len(places)))
        for t, term in enumerate(self.part.terms):
            columns = np.flatnonzero(places[:, 0] == t)
            few = replace(term, centres=term.centres[places[columns, 1]])
            values[:, columns] = few.functions(Z)
        return values

    def fit(self, number: int) -> tuple[Part, float]:
        """Return the part with the first functions, and the larger of the changes of mean and deviation.

        Changes are of the output, root mean square in its standard deviations.
        """
        if self.weight == 0.0:
            return self.part, 0.0
        e = self.trend.shape[1]
        n = self.sizes[number]
        solved: Any = solve_triangular(self.R[: e + n, : e + n], self.targets[: e + n])
        return self._part(solved, self.chosen[:n]), self._change(solved)

    def _change(self, solved: Matrix) -> float:
        """Return the larger of the changes of mean and deviation by fitted weights of mean and explained root."""
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
        # h = T^T p + (0, U^T g) by p and the functions
        size = max(part.trend_root.shape[1], len(solved))
        root: Any = np.zeros((len(solved), size))
        root[:e, size - part.trend_root.shape[1] :] = part.trend_root
        root[:, size - solved.shape[1] + 1 :] += solved[:, 1:]
        root = np.asarray(rq(root, mode="r"))[:, -len(solved) :]
        return replace(
            part,
            terms=self._terms(places[order]),
            readout=Readout(solved[e:, 0], root[e:, e:]),
            trend_weights=part.trend_weights + solved[:e, 0],
            trend_root=root[:e],
        )

    def _terms(self, places: Indices) -> tuple[Term, ...]:
        """Return the terms of functions in order."""
        terms = []
        for t, term in enumerate(self.part.terms):
            rows = np.flatnonzero(places[:, 0] == t)
            if len(rows):
                centres = term.centres[places[rows, 1]]
                terms.append(replace(term, first=int(rows[0]), centres=centres))
        return tuple(terms)
