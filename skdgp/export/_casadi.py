"""The model as a CasADi function, for optimisation."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp._compute.typing import Array, Matrix, Vector
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


def mixer(model: PortableModel) -> Array:
    """Return the matrix (K P, P) of the weighted sums that make outputs from values of parts (n, K P)."""
    return np.vstack([np.diag(weights) for weights in model.mixture])


def casadi_function(model: PortableModel) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of
    ``model.regressor_names``. The Jacobian is the mean's. The function can be differentiated
    further, also the deviation, and be saved with its method ``save``. A reduced model
    (``export_model`` with ``max_kb``) is faster. Raises ImportError if CasADi is not installed.
    """
    ca = extra("casadi", "export")
    x = ca.MX.sym("x", len(model.regressors))
    z = (x - ca.DM(model.shift)) / ca.DM(model.scale)
    p = ca.vertcat(1, z - ca.DM(model.trend_center))

    def functions(term):
        away = ca.repmat(ca.DM(term.root.T) @ z, 1, len(term.centres)) - ca.DM(term.centres.T)
        return term.gain * ca.exp(-0.5 * ca.sum1(away**2)).T

    means, variances = [], []
    for part in model.parts:
        terms, weights, root = used_basis(part)
        g = ca.vertcat(*(sum(map(functions, group)) for group in terms))
        value = ca.dot(ca.DM(part.trend_weights), p)
        half = ca.DM(part.trend_root.T) @ p
        if terms:
            value += ca.dot(ca.DM(weights), g)
            explained = ca.DM(root.T) @ g
            half += ca.vertcat(ca.DM.zeros(half.shape[0] - explained.shape[0]), explained)
        prior = part.prior_variance + ca.sumsqr(ca.DM(part.trend_prior.T) @ p)
        means.append(value)
        variances.append(ca.fmax(prior - ca.sumsqr(half), ROUNDING * prior))
    of_parts = ca.vertcat(*means)
    mixed = ca.DM(mixer(model).T) @ of_parts
    away = of_parts - ca.repmat(mixed, len(model.mixture), 1)
    variance = ca.DM(mixer(model).T) @ (ca.vertcat(*variances) + away**2)
    mean = ca.DM(model.center) + ca.DM(model.output_scale) * mixed
    values = [mean, ca.DM(model.output_scale) * ca.sqrt(variance), ca.jacobian(mean, x)]
    return ca.Function("aero", [x], values, ["x"], ["mean", "std", "jacobian"])


def write_casadi(folder: Path, model: PortableModel) -> list[Path]:
    """Save the function of a model; ``casadi.Function.load`` reads it, in Python, C++ and MATLAB."""
    path = folder / "aero.casadi"
    casadi_function(model).save(str(path))
    return [path]
