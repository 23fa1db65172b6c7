"""A smaller portable model: fewer basis functions, chosen so that mean and deviation change least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import qr, rq, solve_triangular

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Indices, Matrix
from skdgp.export._model import Part, PortableModel, Readout, Term

SIZES = np.unique((4 * 1.15 ** np.arange(36)).astype(int))  # numbers of functions that are tried
MAX_CANDIDATES = 3000  # functions of a part to choose from
MANY, FEWER = 1500, 750  # functions of a readout that make it use fewer points, and how many
MOVED = (0.5, 1.0, 1.5)  # shifts of copies of the points to fit at, in standard deviations
POINTS = 500  # least number of moved points
NEGLIGIBLE = 1e-11  # remainder of a function that the others represent


@one_blas_thread()
def reduced(model: PortableModel, size: Callable[[PortableModel], int], most: int) -> PortableModel:
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
    choices = [_Choice(model, j, Z, check) for j in range(len(model.parts))]
    numbers = [0] * len(choices)
    parts, losses = map(list, zip(*(choice.fit(0) for choice in choices), strict=True))
    best = replace(model, parts=tuple(parts))
    if size(best) > most:
        raise ValueError(
            f"Got a size of at most {most} bytes, but the smallest form of this model takes "
            f"{size(best)}: allow more."
        )
    while growing := [j for j, choice in enumerate(choices) if numbers[j] + 1 < len(choice.sizes)]:
        worst = max(growing, key=losses.__getitem__)
        numbers[worst] += 1
        part, loss = choices[worst].fit(numbers[worst])
        if loss < losses[worst]:
            losses[worst] = loss
            parts[worst] = part
            grown = replace(model, parts=tuple(parts))
            if size(grown) > most:
                break
            best = grown
    return replace(best, provenance=model.provenance | {"reduction": _loss(model, best, check)})


def _points(model: PortableModel) -> tuple[Matrix, Matrix]:
    """Return scaled regressors to fit and to check at, of the flights and around."""
    rng = np.random.default_rng(0)
    samples = model.scaled(model.samples)
    if max(len(readout.weights) for readout in model.readouts) > MANY:
        samples = samples[:: -(-len(samples) // FEWER)]

    def around(Z, moved):
        steps = samples.std(axis=0) * np.resize(moved, max(len(moved), POINTS // len(Z)))[:, None]
        noise = rng.standard_normal((len(steps), *Z.shape)) * steps[:, None]
        return np.concatenate([Z, *(Z + noise)])

    return around(samples[::2], MOVED), around(samples[1::2], MOVED[:1])


def _loss(model: PortableModel, small: PortableModel, Z: Matrix) -> dict[str, dict[str, float]]:
    """Return root mean square changes of mean and deviation, over the deviation.

    The larger of two: at the samples, where the standard deviation is least, and around.
    """
    losses = []
    for X in (model.samples, Z * model.scale + model.shift):
        mean, std = model.predict(X, return_std=True, include_input_noise=False)
        changed, other = small.predict(X, return_std=True, include_input_noise=False)
        changes = np.stack([(changed - mean) / std, other / std - 1.0])
        losses.append(np.sqrt(np.mean(changes**2, axis=1)))
    of_mean, of_std = np.max(losses, axis=0).tolist()
    named = zip(model.outputs, of_mean, of_std, strict=True)
    return {name: {"mean": in_mean, "std": in_std} for name, in_mean, in_std in named}


class _Choice:
    """The functions of a part in the order of their use, and the fit of the first ones."""

    def __init__(self, model: PortableModel, j: int, Z: Matrix, check: Matrix) -> None:
        self.part = part = model.parts[j]
        component, i = divmod(j, len(model.outputs))
        self.weight = model.mixture[component, i]
        self.spread = model.moments(i, check, model.trend(check), True)[1]
        self.p = model.trend(check)
        g = part.basis(check)
        self.mean = g @ part.readout.weights[part.used]
        self.variance = part.variance(self.p, part.explained(g))

        p = model.trend(Z)
        g = part.basis(Z)
        explained = part.explained(g)
        own = 1.0 / np.sqrt(part.variance(p, explained))[:, None]
        places = [(t, k) for t, term in enumerate(part.terms) for k in range(len(term.centres))]
        candidates = np.array(places[:: -(-len(places) // MAX_CANDIDATES) or 1]).reshape(-1, 2)
        functions = own * self._functions(Z, candidates)
        trend, _ = qr(own * p, mode="economic")
        _, R, order = qr(functions - trend @ (trend.T @ functions), mode="economic", pivoting=True)
        left = np.abs(np.diag(R))
        n = int(np.sum(left > NEGLIGIBLE * left.max(initial=0.0)))
        self.sizes = [0, *SIZES[n >= SIZES].tolist()]
        self.chosen = candidates[order[: self.sizes[-1]]]
        columns = np.hstack([own * p, functions[:, order[: self.sizes[-1]]]])
        Q, self.R = qr(columns, mode="economic")
        mean = g @ part.readout.weights[part.used]
        self.targets = Q.T @ (own * np.column_stack([mean, explained]))
        self.checked = np.hstack([self.p, self._functions(check, self.chosen)])

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
        e = self.p.shape[1]
        n = self.sizes[number]
        T = self.part.trend_root
        solved: Any = solve_triangular(self.R[: e + n, : e + n], self.targets[: e + n])
        fitted = self.checked[:, : e + n] @ solved
        variance = self.part.variance(self.p, fitted[:, 1:])
        of_mean = self.weight**2 * np.mean((fitted[:, 0] - self.mean) ** 2 / self.spread)
        ratio = 1.0 + self.weight * (variance - self.variance) / self.spread
        of_std = np.mean((np.sqrt(np.maximum(ratio, 0.0)) - 1.0) ** 2)

        places = self.chosen[:n]
        order = np.lexsort((places[:, 1], places[:, 0]))
        solved = np.concatenate([solved[:e], solved[e:][order]])
        root: Any = np.zeros((e + n, max(T.shape[1], e + n)))
        root[:e, root.shape[1] - T.shape[1] :] = T
        root[:, root.shape[1] - solved.shape[1] + 1 :] += solved[:, 1:]
        root = np.asarray(rq(root, mode="r"))[:, -(e + n) :]
        part = replace(
            self.part,
            terms=self._terms(places[order]),
            readout=Readout(solved[e:, 0], root[e:, e:]),
            trend_weights=self.part.trend_weights + solved[:e, 0],
            trend_root=root[:e],
        )
        return part, float(np.sqrt(max(of_mean, of_std)))

    def _terms(self, places: Indices) -> tuple[Term, ...]:
        """Return the terms of functions in order."""
        terms = []
        for t, term in enumerate(self.part.terms):
            rows = np.flatnonzero(places[:, 0] == t)
            if len(rows):
                centres = term.centres[places[rows, 1]]
                terms.append(replace(term, first=int(rows[0]), centres=centres))
        return tuple(terms)
