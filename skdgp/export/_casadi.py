"""The model as a CasADi function: mean, deviation and Jacobian, for optimisation."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from skdgp.export._model import PortableModel
from skdgp.export._reduce import check_terms

NEEDED = 'This format needs CasADi, which is not installed: pip install "skdgp[export]".'


def casadi_function(model: PortableModel) -> Any:
    """Return a ``casadi.Function`` from regressors ``x`` (d,) to ``mean`` (P,), ``std`` (P,) and ``jacobian`` (P, d).

    The function is named ``aero``. The regressors are in their units, in the order of ``model.regressor_names``. The
    Jacobian is that of the mean. The function can be differentiated further, also the deviation, and be saved with its
    method ``save``. A reduced model (``export --max-kb``) is faster. Raises ImportError if CasADi is not installed,
    ValueError if the model is too large, such as an exact one of many samples.
    """
    try:
        import casadi as ca
    except ImportError as error:
        raise ImportError(NEEDED) from error
    check_terms(model)
    x = ca.MX.sym("x", len(model.regressors))
    z = (x - ca.DM(model.shift)) / ca.DM(model.scale)
    p = ca.vertcat(1, z - ca.DM(model.trend_center))
    means, variances = [], []
    for j in range(len(model.readout_of)):
        value = ca.dot(ca.DM(model.trend_weights[j]), p)
        half = ca.mtimes(ca.DM(model.trend_roots[j].T), p)
        for block, weights, rows in model.terms(j):
            away = ca.repmat(z - ca.DM(block.shift), 1, block.size) - ca.DM(model.centres[block.rows].T)
            F = np.diag(block.root) if block.root.ndim == 1 else block.root.T
            g = block.gain * ca.exp(-0.5 * ca.sum1(ca.mtimes(ca.DM(F), away) ** 2)).T
            value += ca.dot(ca.DM(weights), g)
            half += ca.mtimes(ca.DM(rows.T), g)
        prior = model.prior_variance[j] + ca.sumsqr(ca.DM(model.trend_scale[j]) * p)
        means.append(value)
        variances.append(ca.fmax(prior - ca.sumsqr(half), np.finfo(float).eps * prior))
    parts, mixer = ca.vertcat(*means), ca.DM(model.mixer.T)
    mixed = ca.mtimes(mixer, parts)
    away = parts - ca.repmat(mixed, len(model.mixture), 1)
    variance = ca.mtimes(mixer, ca.vertcat(*variances) + away**2)
    mean = ca.DM(model.center) + ca.DM(model.output_scale) * mixed
    values = [mean, ca.DM(model.deviation_scale) * ca.sqrt(variance), ca.jacobian(mean, x)]
    return ca.Function("aero", [x], values, ["x"], ["mean", "std", "jacobian"])


def write_casadi(path: Path, model: PortableModel) -> Path:
    """Save the function of a model; ``casadi.Function.load`` reads it, in Python, C++ and MATLAB."""
    casadi_function(model).save(str(path))
    return path
