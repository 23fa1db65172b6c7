"""The model as a CasADi function, for optimisation."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.typing import Matrix, Vector
from skdgp.export._model import ROUNDING, Part, PortableModel, Term


def used_basis(part: Part) -> tuple[list[list[Term]], Vector, Matrix]:
    """Return the entries of the basis of a part that are not zero: terms, weights and rows of the root.

    Terms are in the order of the basis; the terms of each list add up.
    """
    order = sorted(part.terms, key=attrgetter("first"))
    terms = [list(group) for _, group in groupby(order, key=attrgetter("first"))]
    weights, root = part.readout.weights, part.readout.root
    rows = np.concatenate([np.arange(0), *(np.r_[group[0].entries] for group in terms)])
    return (terms, weights, root) if len(rows) == len(root) else (terms, weights[rows], root[rows])


def casadi_function(model: PortableModel, *, mean_only: bool = False) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of
    ``model.regressor_names``. The Jacobian is the mean's. The function can be differentiated
    further, also the deviation, and be saved with its method ``save``. A reduced model
    (``export_model`` with ``max_kb``) is faster. Raises ImportError if CasADi is not installed.

    Parameters
    ----------
    model : PortableModel
    mean_only : bool, default=False
        Return the function ``aero_mean`` from ``x`` to ``mean``: CasADi evaluates all results of a
        function, and most of the time goes into the deviation.

    Returns
    -------
    casadi.Function
    """
    ca = extra("casadi", "export")
    x = ca.MX.sym("x", len(model.regressors))
    z = (x - ca.DM(model.shift)) / ca.DM(model.scale)
    p = ca.vertcat(1, z - ca.DM(model.trend_center))
    normalised = [_moments(ca, model, i, z, p, mean_only) for i in range(len(model.outputs))]
    means, variances = zip(*normalised, strict=True)
    scale = ca.DM(model.output_scale)
    mean = ca.DM(model.center) + scale * ca.vertcat(*means)
    if mean_only:
        return ca.Function("aero_mean", [x], [mean], ["x"], ["mean"])
    std = scale * ca.sqrt(ca.vertcat(*variances))
    results = [mean, std, ca.jacobian(mean, x)]
    return ca.Function("aero", [x], results, ["x"], ["mean", "std", "jacobian"])


def _moments(ca: Any, model: PortableModel, i: int, z: Any, p: Any, mean_only: bool) -> Any:
    """Return normalised mean and variance of an output, of its components whose weight is not zero."""
    weights = model.mixture[:, i]
    used = np.flatnonzero(weights).tolist()
    parts = [model.parts[k * len(model.outputs) + i] for k in used]
    moments = [_part_moments(ca, part, z, p, mean_only) for part in parts]
    mean = sum(weights[k] * value for k, (value, _) in zip(used, moments, strict=True))
    if mean_only:
        return mean, None
    variance = sum(
        weights[k] * (own + (value - mean) ** 2)
        for k, (value, own) in zip(used, moments, strict=True)
    )
    return mean, variance


def _part_moments(ca: Any, part: Part, z: Any, p: Any, mean_only: bool) -> Any:
    """Return normalised mean and variance of a part."""

    def functions(term):
        away = ca.repmat(ca.DM(term.root.T) @ z, 1, len(term.centres)) - ca.DM(term.centres.T)
        return term.gain * ca.exp(-0.5 * ca.sum1(away**2)).T

    terms, weights, root = used_basis(part)
    g = ca.vertcat(*(sum(map(functions, group)) for group in terms))
    mean = ca.dot(ca.DM(part.trend_weights), p)
    if terms:
        mean += ca.dot(ca.DM(weights), g)
    if mean_only:
        return mean, None
    half = ca.DM(part.trend_root.T) @ p
    if terms:
        explained = ca.DM(root.T) @ g
        half += ca.vertcat(ca.DM.zeros(half.shape[0] - explained.shape[0]), explained)
    prior = part.prior_variance + ca.sumsqr(ca.DM(part.trend_prior.T) @ p)
    return mean, ca.fmax(prior - ca.sumsqr(half), ROUNDING * prior)


def write_casadi(folder: Path, model: PortableModel) -> list[Path]:
    """Save both functions of a model; ``casadi.Function.load`` reads them, in Python, C++ and MATLAB."""
    paths = []
    for mean_only in (False, True):
        function = casadi_function(model, mean_only=mean_only)
        paths.append(folder / f"{function.name()}.casadi")
        function.save(str(paths[-1]))
    return paths
