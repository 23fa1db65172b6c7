"""A smaller portable model: fewer basis functions, chosen so that mean and deviation change least."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import qr, rq

from skdgp._compute.typing import Indices, Matrix, Vector
from skdgp.export._model import Block, PortableModel, Readout

FIRST, GROWTH = 4, 1.15  # numbers of functions that are tried: the first, and the ratio of one to the next
SKETCH = 600  # rows of random combinations of points, from which functions are chosen
MOVED = (0.5, 1.0, 1.5)  # standard deviations by which copies of the points that functions are fitted at are moved
MOVED_CHECK = (0.5,)  # the same of the points that the loss is measured at
RCOND = 1e-11


class Loss(NamedTuple):
    """Change of an output by the reduction, at flown points and around them that it was not fitted to.

    Attributes
    ----------
    mean : float
        Root mean square change of the mean, in posterior deviations.
    std : float
        Root mean square of the relative change of the deviation.
    """

    mean: float
    std: float


class _Fit(NamedTuple):
    """The functions that stay for one output, the new weights and root, and the loss."""

    kept: Indices
    trend_weights: Vector
    weights: Vector
    trend_root: Matrix
    packed_root: Vector
    loss: Loss


def reduced(model: PortableModel, size: Callable[[PortableModel], int], most: int) -> PortableModel:
    r"""Return the model with so few basis functions that ``size(model) <= most``, at the least loss.

    The functions g of an output overlap, so a few of them, g_S, and the trend p span the others nearly:
    g = P^T (p, g_S), an interpolative decomposition (Cheng et al. 2005) by a pivoted QR factorisation at flown points.
    Mean and explained variance keep their form, with P w in place of w and P U in place of U. The output with the
    largest loss gets the next functions, until the size is reached. ``provenance["reduction"]`` holds the loss.

    Parameters
    ----------
    model : PortableModel
    size : callable
        Size of a model, such as bytes.
    most : int

    Returns
    -------
    PortableModel
        The same model where it is small enough.

    Raises
    ------
    ValueError
        If no model is small enough.
    """
    if size(model) <= most:
        return model
    outputs = [_Output(model, i, *_points(model)) for i in range(len(model.outputs))]
    numbers = [0] * len(outputs)
    best = _assembled(model, [output.fit(0) for output in outputs])
    if size(best) > most:
        raise ValueError(
            f"Got a size of at most {most} bytes, but the smallest form of this model takes {size(best)}: allow more."
        )
    while True:
        fits = [output.fit(n) for output, n in zip(outputs, numbers, strict=True)]
        growing = [k for k, output in enumerate(outputs) if numbers[k] + 1 < len(output.sizes)]
        if not growing:
            return best
        numbers[max(growing, key=lambda k: max(fits[k].loss))] += 1
        trial = _assembled(model, [output.fit(n) for output, n in zip(outputs, numbers, strict=True)])
        if size(trial) > most:
            return best
        best = trial


def loss_of(model: PortableModel) -> dict[str, dict[str, float]]:
    """Return the loss by reduction, ``{"CX": {"mean": ..., "std": ...}, ...}``; empty if there was none."""
    return model.provenance.get("reduction", {})


def _points(model) -> tuple[Matrix, Matrix]:
    """Return scaled regressors to fit and to check at: flown ones, and around them."""
    rng = np.random.default_rng(0)
    samples = (model.envelope.samples - model.shift) / model.scale
    if len(samples) < 2:  # a compact model has none, but its inducing inputs lie among them
        samples = model.centres if len(model.centres) > 1 else rng.standard_normal((200, len(model.scale)))

    def around(Z, moved):
        return np.concatenate([Z, *(Z + by * samples.std(axis=0) * rng.standard_normal(Z.shape) for by in moved)])

    return around(samples[::2], MOVED), around(samples[1::2], MOVED_CHECK)


class _Output:
    """One output: its functions in the order of their use, and the fit of the first ones."""

    def __init__(self, model: PortableModel, i: int, Z: Matrix, check: Matrix) -> None:
        self.readout = model.readouts[model.readout_of[i]]
        self.v, self.T = model.trend_weights[i], model.trend_roots[i]
        self.prior, self.tau = model.prior_variance[i], model.trend_scale[i]
        p, g = model._trend(Z), model._basis(Z, i)
        weight = 1 / self._predicted(p, g @ self.readout.weights, g @ self.readout.root)[1][:, None]
        self.p, self.g = weight * p, weight * g
        rest = self.g - self.p @ np.linalg.lstsq(self.p, self.g, rcond=None)[0]
        if len(rest) > SKETCH:
            rest = np.random.default_rng(1).standard_normal((SKETCH, len(rest))) @ rest
        self.order = qr(rest, mode="r", pivoting=True)[1]
        self.check = model._trend(check), model._basis(check, i)
        self.truth = self._predicted(
            self.check[0], self.check[1] @ self.readout.weights, self.check[1] @ self.readout.root
        )
        sizes = np.unique((FIRST * GROWTH ** np.arange(100)).astype(int))
        self.sizes = [0, *sizes[sizes < min(self.readout.size, len(rest))].tolist()]
        self.fit = cache(self._fit)

    def _predicted(self, p: Matrix, mean: Any, half: Any) -> Any:
        """Return mean and deviation, normalised."""
        prior = self.prior + ((p * self.tau) ** 2).sum(axis=1)
        whole = p @ self.T
        whole[:, whole.shape[1] - half.shape[1] :] += half
        explained = np.einsum("nr,nr->n", whole, whole)
        return p @ self.v + mean, np.sqrt(np.maximum(prior - explained, np.finfo(float).eps * prior))

    def _fit(self, number: int) -> _Fit:
        kept, n = np.sort(self.order[: self.sizes[number]]), self.p.shape[1]
        P: Any = np.linalg.lstsq(np.hstack([self.p, self.g[:, kept]]), self.g, rcond=RCOND)[0]
        w: Any = P @ self.readout.weights
        H: Any = P @ self.readout.root
        columns = np.hstack([self.check[0], self.check[1][:, kept]])
        mean, std = self._predicted(self.check[0], columns @ w, columns @ H)
        root: Any = np.vstack([self.T, np.zeros((len(kept), self.T.shape[1]))])
        root[:, root.shape[1] - H.shape[1] :] += H
        if root.shape[1] < len(root):
            root = np.hstack([np.zeros((len(root), len(root) - root.shape[1])), root])
        root = np.asarray(rq(root, mode="r"))[:, -len(root) :]
        loss = Loss(
            float(np.sqrt(np.mean(((mean - self.truth[0]) / self.truth[1]) ** 2))),
            float(np.sqrt(np.mean((std / self.truth[1] - 1) ** 2))),
        )
        return _Fit(kept, self.v + w[:n], w[n:], root[:n], root[n:, n:].T[np.tril_indices(len(kept))], loss)


def _assembled(model: PortableModel, fits: list[_Fit]) -> PortableModel:
    """Return the model with the functions that stay."""
    blocks: list[Block] = []
    centres: list[Any] = [np.empty((0, len(model.scale)))]
    places: dict[tuple, int] = {}
    n = 0
    for block in model.blocks:
        kept = fits[block.output].kept
        first, last = np.searchsorted(kept, [block.first_column, block.first_column + block.size])
        if first == last:
            continue
        rows = kept[first:last] - block.first_column + block.first_centre
        key = tuple(rows.tolist())
        if key not in places:
            places[key] = n
            centres.append(model.centres[rows])
            n += len(rows)
        first_column, size = int(first), int(last - first)
        blocks.append(replace(block, first_centre=places[key], first_column=first_column, size=size))
    losses = {name: fit.loss._asdict() for name, fit in zip(model.outputs, fits, strict=True)}
    return replace(
        model,
        centres=np.concatenate(centres),
        blocks=tuple(blocks),
        readouts=tuple(Readout(fit.weights, fit.packed_root) for fit in fits),
        readout_of=np.arange(len(fits)),
        trend_weights=np.stack([fit.trend_weights for fit in fits]),
        trend_roots=tuple(fit.trend_root for fit in fits),
        provenance=model.provenance | {"reduction": losses},
    )
