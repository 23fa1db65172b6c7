"""The portable model of an identified pipeline: posteriors as arrays."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any, TypeAlias, cast

import numpy as np
from scipy.linalg import lapack, rq
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import plain
from skdgp._compute.typing import Array, Matrix, Vector
from skdgp._flight.channels import ACCELERATION_LENGTHS, CHANNELS, HAT, LENGTHS
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import (
    Aerodynamics,
    Aircraft,
    as_aerodynamics,
    check_aircraft,
)
from skdgp.export._model import Part, PortableModel, Readout, Reference, Regressor, Term
from skdgp.inference import (
    ExactPosterior,
    FunctionErrors,
    Posterior,
    SinglePosterior,
    SparsePosterior,
)
from skdgp.kernels import ConvolvedGaussian, LatentFeatures, LinearTrend, MultiOutputKernel

# Rows with predictions of the pipeline that a portable model holds; distance of every second one from the
# training data, in standard deviations
REFERENCE_ROWS = 40
REFERENCE_STEP = 0.5
NO_FUNCTIONS = Readout(np.empty(0), np.empty((0, 0)))
# Terms, readout, weights of the trend and its root in the explained variance, of a part
Learned: TypeAlias = tuple[list[Term], Readout, Vector, Matrix]
REMEDY = "Export a pipeline of make_identification_pipeline that ends in DependentGPRegressor with a linear trend."


def portable_model(pipeline: Pipeline, aircraft: Aircraft, **facts: Any) -> PortableModel:
    """Return the portable model of a fitted identification pipeline.

    The pipeline is read as :func:`skdgp.dynamics.as_aerodynamics` reads it for a simulation. Behind
    the choice of regressors it may have scalers such as ``StandardScaler``, and at the end a
    ``DependentGPRegressor``, exact or sparse. The ``facts``
    of a model file become the provenance: ``portable_model(**load_model(path))``. Raises TypeError
    if ``aircraft`` is no `Aircraft`, ValueError if ``pipeline`` is no such pipeline, a coefficient is
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
    ...     glider, regressors=["alpha", "q_hat"], cutoff=None
    ... ).fit(flight, Y)
    >>> model = portable_model(pipeline, glider)
    >>> model
    PortableModel(CX, CY, CZ, Cl, Cm, Cn of alpha, q_hat)
    >>> model.columns
    ('alpha', 'q', 'airspeed')
    """
    check_aircraft(aircraft)
    regressor = pipeline[-1] if isinstance(pipeline, Pipeline) else pipeline
    if regressor is pipeline or not isinstance(regressor, DependentGPRegressor):
        raise ValueError(f"Got {type(regressor).__name__} at the end, which has no form. {REMEDY}")
    check_is_fitted(pipeline)
    simulated = as_aerodynamics(pipeline)
    learned = simulated.learned
    if learned is None:
        raise ValueError(
            "Got a step behind the choice of regressors that is no linear scaler, which has no portable form. "
            + REMEDY
        )
    shift, scale = learned.shift, learned.scale
    posterior = regressor.posterior_
    parts = _all_parts(posterior)
    samples = posterior.inputs * scale + shift
    points = samples
    if simulated.limits is not None:
        points = np.vstack([samples, simulated.limits])
    servos = simulated.servos
    model = PortableModel(
        regressors=_regressors(simulated, aircraft),
        outputs=tuple(regressor.output_names_),
        aircraft=aircraft,
        shift=shift,
        scale=scale,
        center=np.asarray(regressor.center_, dtype=float),
        output_scale=np.asarray(regressor.scale_, dtype=float),
        parts=parts,
        mixture=np.asarray(posterior.mixture, dtype=float),
        noise_variance=np.asarray(regressor.noise_variance_),
        input_covariance=regressor.input_covariance_ * np.multiply.outer(scale, scale),
        limits=np.stack([points.min(axis=0), points.max(axis=0)]),
        servos=np.array([servos.lag, servos.delay, servos.rate_limit]),
        provenance=plain(facts | {"inference": regressor.inference_}),
        reference=_reference(learned, samples),
    )
    names = dict.fromkeys((*model.columns, *model.regressor_names, *model.outputs))
    if strange := [name for name in names if not re.fullmatch(r"[A-Za-z_]\w*", name, re.ASCII)]:
        raise ValueError(
            f"Got columns {strange}, but exports need names of letters, digits and underscores: "
            f"rename them in the flights, and learn again."
        )
    return model


def _reference(learned: Any, samples: Matrix) -> Reference:
    """Return the predictions of the regressor at and near some samples (n, d)."""
    rows = np.linspace(0, len(samples) - 1, REFERENCE_ROWS).astype(int)
    X = samples[rows]
    moves = np.random.default_rng(0).standard_normal(X[1::2].shape)
    X[1::2] += REFERENCE_STEP * samples.std(axis=0) * moves
    Z = learned.scaled(X)
    regressor = learned.regressor
    mean, std = regressor.predict(Z, return_std=True, include_input_noise=False)
    slopes = regressor.posterior_.gradient(Z) * (regressor.scale_[:, None] / learned.scale)
    return Reference(X, mean.reshape(len(X), -1), std.reshape(len(X), -1), slopes)


def _regressors(model: Aerodynamics, aircraft: Aircraft) -> tuple[Regressor, ...]:
    """Return the regressors with the columns of flights that they are computed from."""
    lengths = model.lengths(aircraft)
    regressors = []
    for name in model.regressors:
        rate = name.removesuffix(HAT)
        unit, length, power = "", 1.0, 0
        if name != rate and rate in LENGTHS:
            factors = {rate: 1.0}
            length = float(lengths[LENGTHS[rate]])
            power = 2 if rate in ACCELERATION_LENGTHS else 1
        else:
            factors = _factors(name, model.mixing)
            unit = model.units.get(name, CHANNELS.get(name, ""))
        weights = tuple(factors.values())
        regressors.append(Regressor(name, unit, tuple(factors), weights, length, power))
    return tuple(regressors)


def _factors(name: str, mixing: Any) -> dict[str, float]:
    """Return the columns of a flight whose weighted sum is a regressor, with their weights."""
    if mixing is None or name not in mixing.controls:
        return {name: 1.0}
    row = mixing.matrix[mixing.controls.index(name)].tolist()
    return {surface: c for surface, c in zip(mixing.surfaces, row, strict=True) if c}


def _trend_roots(kernel: MultiOutputKernel) -> Array:
    """Return the roots R (P, d + 1, d + 1) of the prior covariances p^T R R^T p of the linear trend, p = (1, z)."""
    trends = [term for term in kernel.summands() if isinstance(term, LinearTrend)]
    if len(trends) > 1:
        raise ValueError(f"Got several linear trends, but only one has a portable form. {REMEDY}")
    if not trends:
        return np.zeros((kernel.n_outputs, kernel.n_features + 1, kernel.n_features + 1))
    (trend,) = trends
    center = np.broadcast_to(trend.value("center"), kernel.n_features).astype(float)
    scales = np.column_stack([trend.value("intercept_scale"), trend.value("slope_scale")])
    return _moved_trend(center).T * scales[:, None]


def _moved_trend(center: Vector) -> Matrix:
    """Return the matrix M (d + 1, d + 1) with (1, z - center) = M (1, z)."""
    moved = np.eye(len(center) + 1)
    moved[1:, 0] = -center
    return moved


def _all_parts(posterior: Posterior) -> tuple[Part, ...]:
    """Return the parts of all components, one for each output."""
    parts: list[Part] = []
    for member, weights in zip(posterior.members, posterior.mixture, strict=True):
        for part, weight in zip(_parts(member, posterior.errors), weights, strict=True):
            parts.append(part if weight > 0 else _unused(posterior.kernel.n_features))
    return tuple(parts)


def _parts(posterior: SinglePosterior, errors: FunctionErrors | None) -> list[Part]:
    """Return the parts of a single posterior, one for each output.

    A trend about a centre has the functions M p, p = (1, z), so the root of its prior covariance is M^T times its
    standard deviations. Errors of the function are further columns of the prior.
    """
    kernels = [term for term in posterior.kernel.summands() if not isinstance(term, LinearTrend)]
    others = [type(term).__name__ for term in kernels if not isinstance(term, ConvolvedGaussian)]
    if others:
        raise ValueError(
            f"Got a model with the kernels {others}, but only ConvolvedGaussian and LinearTrend "
            f"have a portable form. {REMEDY}"
        )
    roots = _trend_roots(posterior.kernel)
    priors = [root[:, root.any(axis=0)] for root in roots]
    variance = np.zeros(posterior.kernel.n_outputs)
    for kernel in kernels:
        variance += (kernel.value("amplitude") ** 2).sum(axis=0)
    added = np.zeros(roots.shape[:2])
    if errors is not None:
        moved = _moved_trend(errors.centre).T
        linear = moved @ errors.weights.T
        priors = [_square_root(np.hstack(pair)) for pair in zip(priors, linear, strict=True)]
        added = (moved @ errors.mean_path().weights[0]).T
    if isinstance(posterior, ExactPosterior):
        learned = _exact(posterior, kernels, roots)
    else:
        learned = _sparse(cast(SparsePosterior, posterior), roots)
    parts = []
    for of_output, R, a, mean in zip(learned, priors, variance.tolist(), added, strict=True):
        terms, readout, weights, trend_root = of_output
        if not terms:
            readout = NO_FUNCTIONS
            trend_root = _square_root(trend_root)
        parts.append(Part(tuple(terms), readout, weights + mean, trend_root, R, a))
    return parts


def _unused(d: int) -> Part:
    """Return a part of weight zero: its values do not matter, so it has no functions."""
    nothing = np.zeros((d + 1, 0))
    return Part((), NO_FUNCTIONS, np.zeros(d + 1), nothing, nothing, 1.0)


def _square_root(root: Matrix) -> Matrix:
    """Return a root R (k, k) with the same R R^T as a root of at least k columns."""
    triangle: Any = rq(root, mode="r")
    return triangle[:, -len(root) :]


def _exact(posterior: ExactPosterior, kernels: list[Any], roots: Array) -> Iterator[Learned]:
    """Yield terms, readout, weights and root of the trend of each output of an exact posterior.

    The samples are the centres. The basis is the covariance with the observed values, the readout C^-1 y and
    L^-T of C = L L^T.
    """
    X = posterior.data.X
    places = np.cumsum([0, *map(len, X)])
    inverse, info = lapack.dtrtri(posterior.factor.dense(), lower=1)
    if info:
        raise np.linalg.LinAlgError(f"The inverse of the Cholesky factor failed (trtri {info}).")
    inverse = np.tril(inverse)
    readout = Readout(posterior.alpha.copy(), inverse.T)
    for i, root in enumerate(roots):
        terms: list[Term] = []
        for kernel in kernels:
            for j, first in enumerate(places[:-1]):
                terms += _terms(kernel, i, j, first, X[j])
        own = slice(places[i], places[i + 1])
        samples = np.column_stack([np.ones(len(X[i])), X[i]])
        covariance = root @ root.T @ samples.T  # of the trend
        yield terms, readout, covariance @ posterior.alpha[own], (inverse[:, own] @ covariance.T).T


def _sparse(posterior: SparsePosterior, roots: Array) -> Iterator[Learned]:
    """Yield the same of each output of a sparse posterior; the inducing inputs are the centres."""
    summands = posterior.features.summands()
    latent = [features for features in summands if isinstance(features, LatentFeatures)]
    for i, of_prior in enumerate(roots):
        terms: list[Term] = []
        first = 0
        for features in latent:
            for f in features.blocks[i]:
                terms += _terms(features.joint, i, len(roots) + f, first, features.Z)
                first += len(features.Z)
        # the trend first
        is_latent = [np.full(len(part.columns(i)), part in latent) for part in summands]
        order = np.argsort(np.concatenate(is_latent), kind="stable")
        n = len(order) - first
        weights = posterior.weights[posterior.features.columns(i)][order]
        root: Any = rq(posterior.roots[i][order], mode="r")
        readout = Readout(weights[n:], np.ascontiguousarray(root[n:, n:]))
        # weights of the trend are in units of its prior
        yield terms, readout, of_prior[:, :n] @ weights[:n], of_prior[:, :n] @ root[:n]


def _terms(kernel, i, j, first, X) -> Iterator[Term]:
    """Yield the terms of output i for its covariance with output j at X."""
    pair = kernel.pair(i, j)
    for gain, root, shift in zip(pair.gain, np.sqrt(pair.Sigma), pair.mu, strict=True):
        if len(X):
            yield Term(int(first), float(gain), root, (X + shift) * root)
