"""The model as a CasADi function, for optimisation."""

from __future__ import annotations

from itertools import groupby
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.messages import extra
from skdgp.export._model import Part, PortableModel, Term

ROUNDING = float(np.finfo(float).eps)


def casadi_function(model: PortableModel, *, mean_only: bool = False) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of
    ``model.regressor_names``. The Jacobian is the mean's. The function can be differentiated
    further, also the deviation, and be saved with its method ``save``. Raises ImportError if CasADi is
    not installed.

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
    symbols = _Symbols(ca, x, model, mean_only)
    means = []
    variances = []
    for i in range(len(model.outputs)):
        components = [(weight, *symbols.moments(part)) for weight, part in model.components(i)]
        mean = sum(weight * own_mean for weight, own_mean, _ in components)
        means.append(mean)
        variances.append(sum(w * (nu + (mu - mean) ** 2) for w, mu, nu in components))
    scale = ca.DM(model.output_scale)
    mean = ca.DM(model.center) + scale * ca.vertcat(*means)
    if mean_only:
        return ca.Function("aero_mean", [x], [mean], ["x"], ["mean"])
    std = scale * ca.sqrt(ca.vertcat(*variances))
    results = [mean, std, ca.jacobian(mean, x)]
    return ca.Function("aero", [x], results, ["x"], ["mean", "std", "jacobian"])


class _Symbols:
    """Normalised means and variances of parts of a model as expressions of the regressors ``x``."""

    def __init__(self, ca: Any, x: Any, model: PortableModel, mean_only: bool) -> None:
        self.ca = ca
        self.mean_only = mean_only
        self.z = (x.T - model.shift[None]) / model.scale[None]
        self.p = ca.horzcat(1, self.z - model.trend_center[None])

    def moments(self, part: Part) -> tuple[Any, Any]:
        """Return normalised mean and variance, by the formulas of `Part`."""
        ca, p = self.ca, self.p
        groups = _groups(part)
        functions = [sum(map(self._functions, group)) for group in groups]
        g = ca.horzcat(self.z[:, :0], *functions)
        used = [place for group in groups for place in _places(group[0])]
        mean = p @ part.trend_weights + g @ part.readout.weights[used]
        half = p @ part.trend_root
        first = part.trend_root.shape[1] - len(part.readout.weights)
        explained = ca.horzcat(half[:, :first], half[:, first:] + g @ part.readout.root[used])
        prior = part.prior_variance + ca.sumsqr(p @ part.trend_prior)
        return mean, ca.fmax(prior - ca.sumsqr(explained), ROUNDING * prior)

    def _functions(self, term: Term) -> Any:
        return term.gain * self.ca.exp(-0.5 * self._squared_distances(term))

    def _squared_distances(self, term: Term) -> Any:
        ca, centres = self.ca, term.centres
        u = self.z @ term.root
        if self.mean_only:
            # |u|^2 - 2 c^T u + |c|^2 takes one product; it rounds to 1e-16 of the squares
            squares = ca.DM(np.sum(centres**2, axis=1))
            return (ca.sumsqr(u) + squares - 2.0 * ca.mtimes(ca.DM(centres), u.T)).T
        away = ca.repmat(u, len(centres), 1) - centres
        return ca.sum2(away**2).T


def _groups(part: Part) -> list[list[Term]]:
    """Return the terms of a part in the order of the basis; the terms of a group add up."""
    first = attrgetter("first")
    return [list(group) for _, group in groupby(sorted(part.terms, key=first), key=first)]


def _places(term: Term) -> range:
    """Return the entries of the basis that the functions of a term add to."""
    return range(term.first, term.first + len(term.centres))


def write_casadi(folder: Path, model: PortableModel) -> list[Path]:
    """Save both functions of a model; ``casadi.Function.load`` reads them, in Python, C++ and MATLAB."""
    paths = []
    for mean_only in (False, True):
        function = casadi_function(model, mean_only=mean_only)
        path = folder / f"{function.name()}.casadi"
        function.save(str(path))
        paths.append(path)
    return paths
