"""The model as a CasADi function, for optimisation."""

from __future__ import annotations

from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from skdgp._compute.files import Writer, write_together
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
    z = (x.T - model.shift[None]) / model.scale[None]
    means = []
    variances = []
    for i in range(len(model.outputs)):
        components = [(weight, *_moments(ca, z, part)) for weight, part in model.components(i)]
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


def _moments(ca: Any, z: Any, part: Part) -> tuple[Any, Any]:
    """Return normalised mean and variance as expressions of the scaled regressors, by the formulas of `Part`."""
    p = ca.horzcat(1, z)
    places = {term.first: range(*term.entries.indices(term.entries.stop)) for term in part.terms}
    functions = dict.fromkeys(places, 0.0)
    for term in part.terms:
        functions[term.first] += _functions(ca, z, term)
    g = ca.horzcat(z[:, :0], *functions.values())
    used = [*chain(*places.values())]
    mean = p @ part.trend_weights + g @ part.readout.weights[used]
    half = p @ part.trend_root
    first = part.trend_root.shape[1] - len(part.readout.weights)
    explained = ca.horzcat(half[:, :first], half[:, first:] + g @ part.readout.root[used])
    prior = part.prior_variance + ca.sumsqr(p @ part.trend_prior)
    return mean, ca.fmax(prior - ca.sumsqr(explained), ROUNDING * prior)


def _functions(ca: Any, z: Any, term: Term) -> Any:
    """Return the Gaussian functions of a term, (1, k)."""
    u = z * term.inverse_widths[None]
    # |u|^2 - 2 c^T u + |c|^2 takes one product; it rounds to 1e-16 of the squares
    squares = ca.DM(np.sum(term.centres**2, axis=1))
    distances = ca.sumsqr(u) + squares - 2.0 * ca.mtimes(ca.DM(term.centres), u.T)
    return term.gain * ca.exp(-0.5 * distances).T


def write_casadi(folder: Path, model: PortableModel) -> list[Path]:
    """Save both functions of a model, all or none; ``casadi.Function.load`` reads them, in Python, C++ and MATLAB."""
    functions = [casadi_function(model, mean_only=mean_only) for mean_only in (False, True)]
    writers = {f"{function.name()}.casadi": _writer(function) for function in functions}
    write_together(folder, writers)
    return [folder / name for name in writers]


def _writer(function: Any) -> Writer:
    """Return the writer of a function."""
    return lambda path: function.save(str(path))
