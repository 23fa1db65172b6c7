"""The portable model of an identified pipeline: posteriors as arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, cast

import numpy as np
import pandas as pd
from scipy.linalg import lapack, rq
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import plain
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import ACCELERATION_LENGTHS, CHANNELS, HAT, LENGTHS
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aerodynamics, Aircraft, as_aerodynamics, check_aircraft, scaling_of
from skdgp.export._model import Part, PortableModel, Readout, Reference, Regressor, Term
from skdgp.inference import (
    ExactPosterior,
    FunctionErrors,
    PosteriorWithErrors,
    SinglePosterior,
    SparsePosterior,
    training_inputs,
)
from skdgp.kernels import ConvolvedGaussian, LatentFeatures, LinearTrend, MultiOutputKernel

MAX_SAMPLES = 1000  # rows of the training data that a model holds
REFERENCE_ROWS = 40  # at which a model holds the predictions of the pipeline
REFERENCE_STEP = 0.5  # of every second one from the training data, in standard deviations
REMEDY = "Export a pipeline of make_identification_pipeline that ends in DependentGPRegressor with a linear trend."


def portable_model(pipeline: Pipeline, aircraft: Aircraft, **facts: Any) -> PortableModel:
    """Return the portable model of a fitted identification pipeline.

    The pipeline is read as :func:`skdgp.dynamics.as_aerodynamics` reads it for a simulation. Behind
    the choice of regressors it may have scalers such as ``StandardScaler``, and at the end a
    ``DependentGPRegressor``, exact or sparse. The ``facts``
    of a model file become the provenance: ``portable_model(**load_model(path))``. Raises TypeError
    if ``pipeline`` is no pipeline or ``aircraft`` no `Aircraft`, ValueError if a coefficient is
    lacking, a column has a name that is no identifier, or a step, the kernel or the trend has no
    portable form.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import Aerodynamics, Aircraft, as_aerodynamics
    >>> from skdgp.export import portable_model
    >>> from skdgp.identification import make_identification_pipeline
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> t = np.arange(0, 4, 0.1)
    >>> flight = pd.DataFrame({"time": t, "airspeed": 12.0, "alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t)})
    >>> slopes = {"CX": 0.2, "CY": 0.4, "CZ": -4.0, "Cl": 0.4, "Cm": -0.6, "Cn": 0.2}
    >>> Y = pd.DataFrame({name: slope * flight.alpha - flight.q / 10 for name, slope in slopes.items()})
    >>> pipeline = make_identification_pipeline(
    ...     glider, regressors=["alpha", "q_hat"], cutoff=None, mixer="passthrough"
    ... ).fit(flight, Y)
    >>> model = portable_model(pipeline, glider)
    >>> model
    PortableModel(CX, CY, CZ, Cl, Cm, Cn of alpha, q_hat)
    >>> model.predict({"alpha": [0.05], "q": [0.02], "airspeed": [12.0]}).round(2)
    array([[ 0.01,  0.02, -0.2 ,  0.02, -0.03,  0.01]])
    """
    check_aircraft(aircraft)
    if not isinstance(pipeline, Pipeline):
        raise TypeError(
            f"Got {type(pipeline).__name__} to export, but expected a fitted pipeline. {REMEDY}"
        )
    check_is_fitted(pipeline)
    regressor = pipeline[-1]
    if not isinstance(regressor, DependentGPRegressor):
        raise ValueError(
            f"Got {type(regressor).__name__} at the end of the pipeline, which has no form. "
            f"{REMEDY}"
        )
    simulated = as_aerodynamics(pipeline)
    behind = _behind_choice(pipeline)
    shift, scale = _scaling(behind, len(simulated.regressors))
    columns = {c for _, step in pipeline.steps for c in getattr(step, "feature_names_in_", ())}
    posterior = regressor.posterior_
    errors = posterior.errors if isinstance(posterior, PosteriorWithErrors) else None
    center = _trend_of(posterior.members[0].kernel)[0]
    parts: list[Part] = []
    for member, weights in zip(posterior.members, posterior.mixture, strict=True):
        own = _parts(member, errors, center)
        parts += [
            part if w > 0 else _unused(len(center)) for part, w in zip(own, weights, strict=True)
        ]
    samples = training_inputs(posterior) * scale + shift
    seen = samples if simulated.limits is None else np.vstack([samples, simulated.limits])
    model = PortableModel(
        regressors=tuple(_regressor(n, simulated, aircraft, columns) for n in simulated.regressors),
        outputs=tuple(regressor.output_names_),
        aircraft=aircraft,
        shift=shift,
        scale=scale,
        center=np.asarray(regressor.center_, dtype=float),
        output_scale=np.asarray(regressor.scale_, dtype=float),
        trend_center=center,
        parts=tuple(parts),
        mixture=np.asarray(posterior.mixture, dtype=float),
        noise_variance=np.asarray(regressor.noise_variance_),
        input_covariance=regressor.input_covariance_ * np.multiply.outer(scale, scale),
        limits=np.stack([seen.min(axis=0), seen.max(axis=0)]),
        samples=samples[:: -(-len(samples) // MAX_SAMPLES)],
        servo_lag=np.array([simulated.servo_lag]),
        provenance=plain(facts | {"inference": regressor.inference_}),
        reference=_reference(behind, regressor, samples, simulated.regressors),
    )
    names = dict.fromkeys((*model.columns, *model.regressor_names, *model.outputs))
    if strange := [name for name in names if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)]:
        raise ValueError(
            f"Got columns {strange}, but exports need names of letters, digits and underscores: "
            f"rename them in the flights, and learn again."
        )
    return model


def _behind_choice(pipeline: Pipeline) -> list[Any]:
    """Return the steps between the choice of regressors and the last step."""
    steps = [step for _, step in pipeline.steps[:-1] if step not in (None, "passthrough")]
    roles = [getattr(step, "in_simulation", "") for step in steps]
    chosen = max((k for k, role in enumerate(roles) if role == "regressors"), default=-1)
    return steps[chosen + 1 :]


def _reference(
    steps: list[Any], regressor: DependentGPRegressor, samples: Matrix, names: Sequence[str]
) -> Reference:
    """Return the predictions of the steps and the regressor at and near some samples (n, d)."""
    rows = np.linspace(0, len(samples) - 1, REFERENCE_ROWS).astype(int)
    X = samples[rows]
    moves = np.random.default_rng(0).standard_normal(X[1::2].shape)
    X[1::2] += REFERENCE_STEP * samples.std(axis=0) * moves
    Z: Any = X
    for step in steps:
        Z = step.transform(_as_fitted(Z, step, names))
    Z = _as_fitted(Z, regressor, names)
    mean, std = regressor.predict(Z, return_std=True, include_input_noise=False)
    return Reference(X, mean.reshape(len(X), -1), std.reshape(len(X), -1))


def _as_fitted(Z: Any, step: Any, names: Sequence[str]) -> Any:
    """Return regressors as a table for a step that was fitted on one."""
    if hasattr(step, "feature_names_in_") and not hasattr(Z, "columns"):
        return pd.DataFrame(Z, columns=list(names))
    return Z


def _scaling(steps: list[Any], n_regressors: int) -> tuple[Array, Array]:
    """Return shift and scale of scalers."""
    shift, scale, others = scaling_of(steps, n_regressors)
    if others:
        raise ValueError(
            f"Got {type(others[0]).__name__} behind the choice of regressors, which has no "
            f"portable form. {REMEDY}"
        )
    return shift, scale


def _regressor(name: str, model: Aerodynamics, aircraft: Aircraft, columns: set[str]) -> Regressor:
    """Return a regressor with the columns of flights that the pipeline computes it from."""
    rate = name.removesuffix(HAT)
    if name.endswith(HAT) and rate in LENGTHS:
        length = getattr(model, LENGTHS[rate]) or getattr(aircraft, LENGTHS[rate])
        power = 2 if rate in ACCELERATION_LENGTHS else 1
        return Regressor(name, "", (rate,), (1.0,), float(length), power)
    unit = model.units.get(name, CHANNELS[name].unit if name in CHANNELS else "")
    mixing = model.mixing
    factors = {}
    if mixing and name in mixing.controls and columns.issuperset(mixing.surfaces):
        row = mixing.matrix[mixing.controls.index(name)]
        factors = {s: float(c) for s, c in zip(mixing.surfaces, row, strict=True) if c}
    factors = factors or {name: 1.0}
    return Regressor(name, unit, tuple(factors), tuple(factors.values()))


def _trend_of(kernel: MultiOutputKernel) -> tuple[Vector, Matrix]:
    """Return the centre of the linear trend, and the prior deviations of intercept and slopes (P, d + 1)."""
    trends = [term for term in kernel.summands() if isinstance(term, LinearTrend)]
    if len(trends) > 1:
        raise ValueError(f"Got several linear trends, but only one has a portable form. {REMEDY}")
    if not trends:
        return np.zeros(kernel.n_features), np.zeros((kernel.n_outputs, kernel.n_features + 1))
    center = np.broadcast_to(trends[0].value("center"), kernel.n_features).astype(float)
    values = [trends[0].value(name) for name in ("intercept_scale", "slope_scale")]
    return center, np.column_stack(values)


def _moved_trend(own: Vector, center: Vector) -> Matrix:
    """Return the matrix M (d + 1, d + 1) with (1, z - own) = M (1, z - center)."""
    moved = np.eye(len(center) + 1)
    moved[1:, 0] = center - own
    return moved


def _parts(posterior: SinglePosterior, errors: FunctionErrors | None, center: Vector) -> list[Part]:
    """Return the parts of a single posterior, one for each output, with trends about a common centre.

    A trend about another centre has the functions M p, p = (1, z - center). So its weights are
    M^T v, and the roots of its prior and explained covariance M^T R and M^T T. Errors of the
    function add to the prior: their linear terms further columns, their discrepancy a variance.
    """
    terms = [term for term in posterior.kernel.summands() if not isinstance(term, LinearTrend)]
    others = [type(term).__name__ for term in terms if not isinstance(term, ConvolvedGaussian)]
    if others:
        raise ValueError(
            f"Got a model with the kernels {others}, but only ConvolvedGaussian and LinearTrend "
            f"have a portable form. {REMEDY}"
        )
    own, tau = _trend_of(posterior.kernel)
    prior = np.zeros(posterior.kernel.n_outputs)
    for kernel in terms:
        prior += (kernel.value("amplitude") ** 2).sum(axis=0)
    if errors is not None:
        prior += errors.discrepancy
    found = (
        _exact(posterior, terms, own, tau)
        if isinstance(posterior, ExactPosterior)
        else _sparse(cast(SparsePosterior, posterior), tau)
    )
    moved = _moved_trend(own, center).T
    parts = []
    for i, (of_part, readout, weights, root) in enumerate(found):
        trend_prior = (moved * tau[i])[:, tau[i] > 0]
        if errors is not None:
            linear = _moved_trend(errors.centre, center).T @ errors.weights[:, :, i].T
            trend_prior = _square_root(np.hstack([trend_prior, linear]))
        parts.append(
            Part(
                terms=tuple(of_part),
                readout=readout,
                trend_weights=moved @ weights,
                trend_prior=trend_prior,
                trend_root=moved @ root,
                prior_variance=float(prior[i]),
            )
        )
    return parts


def _unused(d: int) -> Part:
    """Return a part of weight zero: its values do not matter, so it has no functions."""
    nothing = np.zeros((d + 1, 0))
    none = Readout(np.empty(0), np.empty((0, 0)))
    return Part((), none, np.zeros(d + 1), nothing, nothing, 1.0)


def _square_root(root: Matrix) -> Matrix:
    """Return a root R (k, k) with the same R R^T as a root of at least k columns."""
    triangle: Any = rq(root, mode="r")
    return np.asarray(triangle)[:, -len(root) :]


def _exact(posterior: ExactPosterior, kernels, center: Vector, tau: Matrix) -> Iterator[tuple]:
    """Yield terms, readout, weights and root of the trend of each output; the samples are the centres.

    The basis is the covariance with the observed values, the readout C^-1 y and L^-T of C = L L^T.
    """
    X = posterior.data.X
    places = np.cumsum([0, *map(len, X)])
    inverse, info = lapack.dtrtri(posterior.L, lower=1)
    if info:
        raise np.linalg.LinAlgError(f"The inverse of the Cholesky factor failed (trtri {info}).")
    inverse = np.tril(inverse)
    none = Readout(np.empty(0), np.empty((0, 0)))
    readout = Readout(posterior.alpha.copy(), inverse.T) if kernels else none
    for i, (a, b) in enumerate(pairwise(places)):
        terms = [
            term
            for kernel in kernels
            for j, first in enumerate(places[:-1])
            for term in _terms(kernel, i, j, first, X[j], kernel)
        ]
        columns = np.column_stack([np.ones(b - a), X[i] - center]) * tau[i] ** 2
        root = (inverse[:, a:b] @ columns).T
        if not kernels:
            root = np.array(rq(root, mode="r"))[:, -tau.shape[1] :]
        yield terms, readout, posterior.alpha[a:b] @ columns, root


def _sparse(posterior: SparsePosterior, tau: Matrix) -> Iterator[tuple]:
    """Yield the same of a sparse posterior: the inducing inputs are the centres, each output has a readout."""
    for i in range(len(tau)):
        of_trend = np.zeros(0, int)
        of_terms: list[Any] = []
        terms: list[Term] = []
        first = 0
        for features in posterior.features.summands():
            own = np.arange(first, first + len(features.columns(i)))
            first += len(own)
            if not isinstance(features, LatentFeatures):
                of_trend = own
                continue
            for f in features.blocks[i]:
                pair = i, len(tau) + f
                terms += _terms(
                    features.joint, *pair, len(of_terms), features.Z[f], features.kernel
                )
                of_terms += own[: len(features.Z[f])].tolist()
                own = own[len(features.Z[f]) :]
        order = [*of_trend, *of_terms]
        n = len(of_trend)
        w = posterior.weights[posterior.features.columns(i)][order]
        root = np.array(rq(posterior.roots[i][order], mode="r"))
        units = tau[i] if n else np.zeros((len(tau[i]), 0))  # of weights of the trend
        trend_root = units[:, None] * root[:n] if n else np.zeros((len(units), len(order)))
        weights = units * w[:n] if n else np.zeros(len(units))
        yield terms, Readout(w[n:], np.ascontiguousarray(root[n:, n:])), weights, trend_root


def _terms(kernel, i, j, first, X, original) -> Iterator[Term]:
    """Yield the terms of output i for its covariance with output j at X; ``original`` is the kernel of the model."""
    pair = kernel.pair(i, j)
    (regressors,) = original.term_regressors()
    unused = np.setdiff1d(np.arange(X.shape[1]), regressors)
    for gain, root, shift in zip(pair.gain, pair.F, pair.mu, strict=True):
        F = np.diag(root)
        F[unused] = 0.0
        F = F[:, F.any(axis=0)]
        if len(X):
            yield Term(int(first), float(gain), F, (X + shift) @ F)
