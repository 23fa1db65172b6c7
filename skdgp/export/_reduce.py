"""A smaller portable model: fewer basis functions, chosen so that mean and deviation change least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr, rq, solve_triangular
from scipy.linalg.blas import dtrmm

from skdgp._compute.parallel import one_blas_thread
from skdgp._compute.typing import Matrix, Vector
from skdgp.export._model import Block, PortableModel, Readout

FIRST, GROWTH = (
    4,
    1.15,
)  # numbers of functions that are tried: the first, and the ratio of one to the next
MAX_CANDIDATES, MAX_FUNCTIONS = 3000, 500  # functions of a part to choose from, and that may stay
MANY, FEWER = 1500, 750  # functions of a readout from which fewer points are used, and how many
PATIENCE = 8  # sizes without a smaller loss after which a part grows no more
MOVED = (
    0.5,
    1.0,
    1.5,
)  # standard deviations by which copies of the points that functions are fitted at are moved
MOVED_CHECK = (0.5,)  # the same of the points that the loss is measured at
MAX_TERMS = 2**28  # bytes
NEGLIGIBLE = 1e-11  # what is left of a function that the others represent


class Loss(NamedTuple):
    """Change of an output by the reduction of a part, at flown points and around them that it was not fitted to."""

    mean: float
    """Root mean square change of the mean, in posterior deviations."""
    std: float
    """Root mean square of the relative change of the deviation."""


class _Fit(NamedTuple):
    """The blocks and centres that stay for one part, its new weights and root, and the loss."""

    blocks: list[Block]
    centres: Matrix
    trend_weights: Vector
    weights: Vector
    trend_root: Matrix
    packed_root: Vector
    loss: Loss


@one_blas_thread()
def reduced(model: PortableModel, size: Callable[[PortableModel], int], most: int) -> PortableModel:
    r"""Return the model with so few basis functions that ``size(model) <= most``, at the least loss.

    The Gaussian functions of a part overlap, so that a few of them, g_S, and the trend p span the
    others nearly. A pivoted QR factorisation at flown points chooses them, as in an interpolative
    decomposition (Cheng et al. 2005). Least squares fit mean and explained root as functions of p
    and g_S. The part whose reduction changes its output most gets the next functions, until the
    size is reached. ``provenance["reduction"]`` holds the loss of each output, the sum over its
    parts. Raises ValueError if no model is small enough.
    """
    if size(model) <= most:
        return model
    Z, check = _points(model)
    truth = np.empty((2, len(check), len(model.readout_of)))
    parts = [_Part(model, j, Z, check, truth) for j in range(len(model.readout_of))]
    best = _assembled(model, [part.best() for part in parts])
    if size(best) > most:
        raise ValueError(
            f"Got a size of at most {most} bytes, but the smallest form of this model takes "
            f"{size(best)}: allow more."
        )
    while growing := [part for part in parts if part.can_grow()]:
        worst = max(growing, key=lambda part: max(part.best().loss))
        worst.number += 1
        trial = _assembled(model, [part.best() for part in parts])
        if size(trial) > most:
            return best
        best = trial
    return best


def reduced_to_kb(
    model: PortableModel, size: Callable[[PortableModel], int], max_kb: float | None
) -> PortableModel:
    """Return the model in at most ``max_kb`` kilobytes, or as it is for None; ``size`` returns bytes."""
    if max_kb is None:
        return model
    if not 0 < max_kb < np.inf:
        raise ValueError(f"Got max_kb={max_kb!r}, but expected a size > 0 [kB].")
    return reduced(model, size, int(1024 * max_kb))


def loss_of(model: PortableModel) -> dict[str, dict[str, float]]:
    """Return the loss by reduction, ``{"CX": {"mean": ..., "std": ...}, ...}``; empty if there was none."""
    return model.provenance.get("reduction", {})


def check_terms(model: PortableModel) -> None:
    """Raise ValueError if the terms of a model, each with its own rows of the root, are too large for a graph."""
    sizes = [
        block.size * model.readouts[model.readout_of[block.output]].size for block in model.blocks
    ]
    if 8 * sum(sizes) > MAX_TERMS:
        raise ValueError(
            f"Got a model whose terms take {8e-6 * sum(sizes):.0f} MB, but expected at most "
            f"{MAX_TERMS / 1e6:.0f} MB: "
            "give max_kb=256 (--max-kb 256), or another size."
        )


def _points(model) -> tuple[Matrix, Matrix]:
    """Return scaled regressors to fit and to check at: flown ones, and around them."""
    rng = np.random.default_rng(0)
    samples = (model.points() - model.shift) / model.scale
    if max(readout.size for readout in model.readouts) > MANY:
        samples = samples[np.linspace(0, len(samples) - 1, min(len(samples), FEWER)).astype(int)]

    def around(Z, moved):
        return np.concatenate(
            [Z, *(Z + by * samples.std(axis=0) * rng.standard_normal(Z.shape) for by in moved)]
        )

    return around(samples[::2], MOVED), around(samples[1::2], MOVED_CHECK)


class _Part:
    """One part: its functions in the order of their use, and the fit of the first ones.

    ``truth`` holds mean and variance of all parts at the points to check at, (2, n, K P); each part
    writes its own.
    """

    def __init__(
        self, model: PortableModel, j: int, Z: Matrix, check: Matrix, truth: np.ndarray
    ) -> None:
        readout = model.readouts[model.readout_of[j]]
        self.model, self.j, self.truth = model, j, truth
        self.v, self.T = model.trend_weights[j], model.trend_roots[j]
        self.p = model._trend(check)
        truth[:, :, j] = self._predicted(*_readout(readout, model._basis(check, j)))
        p, (mean, half) = model._trend(Z), _readout(readout, model._basis(Z, j))
        weight = 1 / np.sqrt(model._variance(j, p, half))[:, None]
        self.blocks = [block for block in model.blocks if block.output == j]
        step = max(
            1, -(-sum(block.size for block in self.blocks) // MAX_CANDIDATES)
        )  # evenly from each block
        places = [[b, k] for b, block in enumerate(self.blocks) for k in range(0, block.size, step)]
        candidates = np.array(places, dtype=int).reshape(-1, 2)
        g = weight * self._functions(Z, candidates)
        trend, _ = qr(weight * p, mode="economic")
        rest = g - trend @ (trend.T @ g)
        _, R, order = qr(rest, mode="economic", pivoting=True)
        size = np.abs(np.diag(R))
        n = min(int(np.sum(size > NEGLIGIBLE * size.max(initial=0.0))), MAX_FUNCTIONS)
        self.kept = candidates[order[:n]]
        Q, self.R = qr(np.hstack([weight * p, g[:, order[:n]]]), mode="economic")
        self.targets = Q.T @ (weight * np.column_stack([mean, half]))
        self.checked = np.hstack([self.p, self._functions(check, self.kept)])
        sizes = np.unique((FIRST * GROWTH ** np.arange(50)).astype(int))
        self.sizes, self.number = [0, *sizes[sizes <= n].tolist()], 0
        self.fit = cache(self._fit)

    def best(self) -> _Fit:
        """Return the fit of the least loss among the sizes so far."""
        return self.fit(self._best())

    def can_grow(self) -> bool:
        """Whether more functions may lose less."""
        return self.number + 1 < len(self.sizes) and self.number - self._best() < PATIENCE

    def _best(self) -> int:
        return min(range(self.number + 1), key=lambda number: max(self.fit(number).loss))

    def _functions(self, Z, places) -> Matrix:
        """Return Gaussian functions, by block and place in it (k, 2), at scaled regressors, (n, k)."""
        found = np.empty((len(Z), len(places)))
        for b, block in enumerate(self.blocks):
            columns = np.flatnonzero(places[:, 0] == b)
            centres = self.model.centres[block.first_centre + places[columns, 1]]
            found[:, columns] = block.functions(Z, centres)
        return found

    def _predicted(self, mean: Vector, half: Matrix) -> tuple[Vector, Vector]:
        """Return normalised mean and variance at the points to check at, of what functions add to mean and root."""
        return self.p @ self.v + mean, self.model._variance(self.j, self.p, half)

    def _loss(self, mean: Vector, variance: Vector) -> Loss:
        """Return how the output changes if this part has another mean and variance."""
        changed = self.truth.copy()
        changed[:, :, self.j] = mean, variance
        i = self.j % len(self.model.outputs)
        (mean, variance), (new_mean, new) = (
            (found[:, i] for found in self.model.mixed(*values)) for values in (self.truth, changed)
        )
        return Loss(
            float(np.sqrt(np.mean((new_mean - mean) ** 2 / variance))),
            float(np.sqrt(np.mean((np.sqrt(new / variance) - 1) ** 2))),
        )

    def _fit(self, number: int) -> _Fit:
        n, size = self.p.shape[1], self.sizes[number]
        kept = self.kept[:size]
        solved: Any = solve_triangular(self.R[: n + size, : n + size], self.targets[: n + size])
        columns = self.checked[:, : n + size]
        loss = self._loss(*self._predicted(columns @ solved[:, 0], columns @ solved[:, 1:]))
        order = np.lexsort((kept[:, 1], kept[:, 0]))
        solved = np.concatenate([solved[:n], solved[n:][order]])
        root: Any = np.zeros((n + size, max(self.T.shape[1], n + size)))
        root[:n, root.shape[1] - self.T.shape[1] :] = self.T
        root[:, root.shape[1] - solved.shape[1] + 1 :] += solved[:, 1:]
        root = np.asarray(rq(root, mode="r"))[:, -(n + size) :]
        blocks, centres = self._blocks(kept[order])
        packed = root[n:, n:].T[np.tril_indices(size)]
        return _Fit(blocks, centres, self.v + solved[:n, 0], solved[n:, 0], root[:n], packed, loss)

    def _blocks(self, kept) -> tuple[list[Block], Matrix]:
        """Return the blocks of the functions that stay, and their centres."""
        blocks, centres = [], [np.empty((0, len(self.model.scale)))]
        for b, block in enumerate(self.blocks):
            rows = np.flatnonzero(kept[:, 0] == b)
            if len(rows):
                first = int(rows[0])
                blocks.append(
                    replace(block, first_centre=first, first_column=first, size=len(rows))
                )
                centres.append(self.model.centres[block.first_centre + kept[rows, 1]])
        return blocks, np.concatenate(centres)


def _readout(readout: Readout, g: Matrix) -> tuple[Vector, Matrix]:
    """Return what a basis (n, k) adds to the mean (n,) and to the root (n, k)."""
    return g @ readout.weights, dtrmm(1.0, readout.root, g.T, trans_a=1).T if g.size else g


def _assembled(model: PortableModel, fits: list[_Fit]) -> PortableModel:
    """Return the model with the functions that stay."""
    places, P = np.cumsum([0, *(len(fit.centres) for fit in fits)]).tolist(), len(model.outputs)
    of_outputs = [[fit.loss for fit in fits[i::P]] for i in range(P)]
    losses = [
        {"mean": sum(loss.mean for loss in of), "std": sum(loss.std for loss in of)}
        for of in of_outputs
    ]
    return replace(
        model,
        centres=np.concatenate([fit.centres for fit in fits]),
        blocks=tuple(
            replace(block, first_centre=block.first_centre + place)
            for place, fit in zip(places, fits, strict=False)
            for block in fit.blocks
        ),
        readouts=tuple(Readout(fit.weights, fit.packed_root) for fit in fits),
        readout_of=np.arange(len(fits)),
        trend_weights=np.stack([fit.trend_weights for fit in fits]),
        trend_roots=tuple(fit.trend_root for fit in fits),
        provenance=model.provenance | {"reduction": dict(zip(model.outputs, losses, strict=True))},
    )
