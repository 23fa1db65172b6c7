"""The portable model of an identified pipeline: exact and sparse posteriors as arrays."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import lapack, rq
from sklearn.pipeline import Pipeline
from sklearn.utils.validation import check_is_fitted

from skdgp._compute.files import plain
from skdgp._compute.typing import Matrix, Vector
from skdgp._flight.channels import ACCELERATION_LENGTHS, CHANNELS, HAT, LENGTHS
from skdgp._mechanics.aerodynamics import SCALERS, scaling_of
from skdgp._mechanics.aircraft import check_aircraft
from skdgp._regressor import DependentGPRegressor
from skdgp.dynamics import Aircraft
from skdgp.export._model import Block, LearnedRange, PortableModel, Readout, Regressor
from skdgp.identification import regressor_and_scale
from skdgp.inference import ExactPosterior, SparsePosterior, training_inputs
from skdgp.kernels import ConvolvedGaussian, LinearTrend
from skdgp.kernels._features import TrendFeatures

MAX_SAMPLES = 1000  # rows of the training data that an envelope holds
REMEDY = "Export a pipeline of make_identification_pipeline that ends in DependentGPRegressor with a linear trend."


def portable_model(pipeline: Pipeline, aircraft: Aircraft, **facts: Any) -> PortableModel:
    """Return the portable model of a fitted identification pipeline.

    The pipeline has a ``RegressorSelector``, perhaps scalers such as ``StandardScaler`` behind it,
    and a ``DependentGPRegressor`` at the end, exact or sparse, perhaps in a
    ``CalibratedRegressor``. The ``facts`` of a model file become the provenance:
    ``portable_model(**load_model(path))``. Raises TypeError if ``pipeline`` is no pipeline or
    ``aircraft`` no `Aircraft`, ValueError if a step, the kernel or the trend has no portable form.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> from skdgp.dynamics import Aircraft
    >>> from skdgp.export import portable_model
    >>> from skdgp.identification import make_identification_pipeline
    >>> glider = Aircraft(mass=2.0, inertia=np.diag([0.2, 0.3, 0.4]), wing_area=0.5, span=2.0, chord=0.25)
    >>> t = np.arange(0, 4, 0.1)
    >>> flight = pd.DataFrame({"time": t, "airspeed": 12.0, "alpha": 0.1 * np.sin(t), "q": 0.1 * np.cos(t)})
    >>> Y = pd.DataFrame({"CZ": -4 * flight.alpha, "Cm": -0.5 * flight.alpha - 0.2 * flight.q})
    >>> pipeline = make_identification_pipeline(
    ...     glider, regressors=["alpha", "q_hat"], cutoff=None, mixer="passthrough"
    ... ).fit(flight, Y)
    >>> model = portable_model(pipeline, glider)
    >>> model
    PortableModel(CZ, Cm of alpha, q_hat)
    >>> model.predict({"alpha": [0.05], "q": [0.02], "airspeed": [12.0]}).round(2)
    array([[-0.2 , -0.03]])
    """
    check_aircraft(aircraft)
    if not isinstance(pipeline, Pipeline):
        raise TypeError(
            f"Got {type(pipeline).__name__} to export, but expected a fitted pipeline. {REMEDY}"
        )
    check_is_fitted(pipeline)
    regressor, deviation = regressor_and_scale(pipeline)
    if not isinstance(regressor, DependentGPRegressor):
        raise ValueError(
            f"Got {type(regressor).__name__} at the end of the pipeline, which has no form. "
            f"{REMEDY}"
        )
    regressors, shift, scale, limits = _inputs(pipeline)
    form = posterior_form(regressor.posterior_)
    form["prior_variance"] += np.tile(
        regressor.misfit_variance_ / regressor.scale_**2, len(form["mixture"])
    )
    drift = np.zeros((2, len(regressor.scale_)))
    if np.any(regressor.drift_variance_):
        drift = np.stack(
            [regressor.drift_variance_ * np.square(deviation), regressor.drift_memory_]
        )
    return PortableModel(
        regressors=regressors,
        outputs=tuple(regressor.output_names_),
        aircraft=aircraft,
        shift=shift,
        scale=scale,
        center=np.asarray(regressor.center_, dtype=float),
        output_scale=np.asarray(regressor.scale_, dtype=float),
        deviation_scale=np.asarray(regressor.scale_ * deviation, dtype=float),
        noise_variance=np.asarray(regressor.noise_variance_ * np.square(deviation)),
        drift_variance=drift[0],
        drift_memory=drift[1],
        input_covariance=regressor.input_covariance_ * np.multiply.outer(scale, scale),
        envelope=_envelope(regressor.posterior_, shift, scale, limits),
        provenance=plain(facts | {"inference": regressor.inference_}),
        **form,
    )


def _inputs(pipeline):
    """Return the regressors, their shift and scale, and their smallest and largest values or None."""
    steps = [step for _, step in pipeline.steps[:-1] if step not in (None, "passthrough")]
    roles = [getattr(step, "in_simulation", "measurements") for step in steps]
    if "regressors" not in roles:
        raise ValueError(
            f"Got a pipeline without RegressorSelector, so its regressors have no names. {REMEDY}"
        )
    place = len(roles) - 1 - roles[::-1].index("regressors")
    by_role, selector = dict(zip(roles[:place], steps, strict=False)), steps[place]
    scaled = [type(step).__name__ for step in steps[:place] if isinstance(step, SCALERS)]
    if scaled:
        raise ValueError(
            f"Got {scaled} before RegressorSelector, so regressors are not in their units. {REMEDY}"
        )
    names = [str(name) for name in selector.regressors_]
    shift, scale, others = scaling_of(steps[place + 1 :], len(names))
    if others:
        raise ValueError(
            f"Got {type(others[0]).__name__} behind RegressorSelector, which has no form. {REMEDY}"
        )
    units = getattr(pipeline, "control_units_", {})
    regressors = tuple(
        _regressor(name, by_role.get("rates"), by_role.get("controls"), units) for name in names
    )
    low, high = (getattr(selector, name, None) for name in ("data_min_", "data_max_"))
    return regressors, shift, scale, None if low is None or high is None else (low, high)


def _regressor(name, rates, controls, units) -> Regressor:
    """Return a regressor with the columns that the pipeline computes it from."""
    rate = name.removesuffix(HAT)
    if name.endswith(HAT) and rate in LENGTHS and rates is not None:
        power = 2 if rate in ACCELERATION_LENGTHS else 1
        return Regressor(name, "", (rate,), (1.0,), float(getattr(rates, LENGTHS[rate])), power)
    unit = units.get(name, CHANNELS[name].unit if name in CHANNELS else "")
    if controls is not None and name in controls.controls:
        row = controls.mixing_[list(controls.controls).index(name)]
        used = [
            (str(surface), float(c)) for surface, c in zip(controls.surfaces, row, strict=True) if c
        ]
        seen = getattr(controls, "feature_names_in_", ())
        if used and set(controls.surfaces) <= set(seen):
            return Regressor(
                name, unit, tuple(surface for surface, _ in used), tuple(c for _, c in used)
            )
    return Regressor(name, unit, (name,))


def _envelope(posterior, shift, scale, limits) -> LearnedRange:
    if posterior.samples() is None:
        low, high = np.tile([[-np.inf], [np.inf]], len(shift)) if limits is None else limits
        return LearnedRange(np.array(low), np.array(high), np.empty((0, len(shift))))
    X = training_inputs(posterior) * scale + shift
    seen = X if limits is None else np.vstack([X, *limits])
    rows = np.unique(np.linspace(0, len(X) - 1, MAX_SAMPLES).astype(int))
    return LearnedRange(seen.min(axis=0), seen.max(axis=0), X[rows])


def posterior_form(posterior: Any) -> dict[str, Any]:
    """Return the arrays of a posterior, those of the members of an average one after another."""
    forms, mixture = [_form(member) for member in posterior.members], posterior.mixture
    centres, readouts = (
        np.cumsum([0, *(len(form[name]) for form in forms)]) for name in ("centres", "readouts")
    )
    blocks = [
        replace(
            block,
            output=block.output + k * mixture.shape[1],
            first_centre=block.first_centre + int(centre),
        )
        for k, (form, centre) in enumerate(zip(forms, centres, strict=False))
        for block in form["blocks"]
    ]
    joined = ("centres", "trend_scale", "trend_weights", "prior_variance")
    return {
        **{name: np.concatenate([form[name] for form in forms]) for name in joined},
        **{
            name: tuple(each for form in forms for each in form[name])
            for name in ("readouts", "trend_roots")
        },
        "blocks": tuple(blocks),
        "readout_of": np.concatenate(
            [form["readout_of"] + n for form, n in zip(forms, readouts, strict=False)]
        ),
        "trend_center": forms[0]["trend_center"],
        "mixture": mixture,
    }


def _form(posterior: ExactPosterior | SparsePosterior) -> dict[str, Any]:
    """Return the arrays of a single posterior."""
    terms = posterior.kernel.summands()
    trends = [term for term in terms if isinstance(term, LinearTrend)]
    gaussians = [term for term in terms if isinstance(term, ConvolvedGaussian)]
    others = [
        type(term).__name__
        for term in terms
        if not isinstance(term, LinearTrend | ConvolvedGaussian)
    ]
    if others or len(trends) > 1:
        raise ValueError(
            f"Got a model with the kernels {others or 'of several linear trends'}, but only "
            f"ConvolvedGaussian and one "
            f"LinearTrend have a portable form. {REMEDY}"
        )
    P, d = posterior.kernel.n_outputs, posterior.kernel.n_features
    center, tau = np.zeros(d), np.zeros((P, d + 1))  # tau: prior deviations of intercept and slopes
    for trend in trends:
        center = np.broadcast_to(trend._value("center"), (d,)).astype(float)
        tau = np.column_stack([trend._value("intercept_scale"), trend._value("slope_scale")])
    exact = isinstance(posterior, ExactPosterior)
    form = _exact(posterior, gaussians, center, tau) if exact else _sparse(posterior, tau)
    return form | {
        "readout_of": np.arange(P) % len(form["readouts"]),
        "trend_center": center,
        "trend_scale": tau,
        "prior_variance": np.zeros(P)
        + sum((kernel._value("amplitude") ** 2).sum(axis=0) for kernel in gaussians),
    }


def _exact(
    posterior: Any, gaussians: list[ConvolvedGaussian], center: Vector, tau: Matrix
) -> dict[str, Any]:
    """Return the samples as centres, blocks, one readout with the inverse factor, weights and roots of the trends."""
    X, (P, e) = posterior.data.X, tau.shape
    places = np.cumsum([0, *map(len, X)])
    blocks = []
    for i in range(P):
        for kernel in gaussians:
            for j, first in enumerate(places[:-1]):
                blocks += _blocks(kernel, i, j, first, first, len(X[j]), kernel)
    inverse, info = lapack.dtrtri(posterior.L, lower=1)
    if info:
        raise np.linalg.LinAlgError(
            f"The inverse of the Cholesky factor failed (trtri info {info})."
        )
    inverse = np.tril(inverse)
    weights, roots = np.zeros((P, e)), []
    for i, (a, b) in enumerate(pairwise(places)):
        columns = np.column_stack([np.ones(b - a), X[i] - center]) * tau[i] ** 2
        weights[i] = posterior.alpha[a:b] @ columns
        roots.append((inverse[:, a:b] @ columns).T)
    if gaussians:
        centres = np.concatenate(X)
        readout = Readout(posterior.alpha.copy(), inverse[np.tril_indices(len(inverse))])
    else:
        centres, readout = np.empty((0, e - 1)), Readout(np.empty(0), np.empty(0))
        roots = [np.array(rq(root, mode="r"))[:, -e:] for root in roots]
    readouts = [readout]
    return {
        "centres": centres,
        "blocks": blocks,
        "readouts": readouts,
        "trend_weights": weights,
        "trend_roots": roots,
    }


def _sparse(posterior: Any, tau: Matrix) -> dict[str, Any]:
    """Return the same of a sparse posterior: inducing inputs are the centres, each output has a readout."""
    P, e = tau.shape
    summands, centres, m = [], [np.empty((0, e - 1))], 0
    for features in posterior.features.summands():
        sizes = [len(Z) for Z in getattr(features, "Z", ())]  # a trend has no inducing inputs
        summands.append((features, m + np.cumsum([0, *sizes])))
        centres += getattr(features, "Z", [])
        m += sum(sizes)
    blocks, readouts, weights, roots = [], [], np.zeros((P, e)), []
    for i in range(P):
        of_trend: list[int] = []
        of_gaussians: list[int] = []
        first = 0
        for features, places in summands:
            index = list(range(first, first + len(features.columns(i))))
            first += len(index)
            if isinstance(features, TrendFeatures):
                of_trend = index
                continue
            for f in features._blocks[i]:
                size = len(features.Z[f])
                blocks += _blocks(
                    features.joint, i, P + f, places[f], len(of_gaussians), size, features.kernel
                )
                of_gaussians += index[:size]
                index = index[size:]
        order, n = of_trend + of_gaussians, len(of_trend)
        w = posterior.weights[posterior.features.columns(i)][order]
        root = np.array(rq(posterior.roots[i][order], mode="r"))
        if n:
            weights[i] = w[:n] * tau[i]
            root[:n] *= tau[i][:, None]
        roots.append(root[:n] if n else np.zeros((e, len(order))))
        readouts.append(Readout(w[n:], root[n:, n:].T[np.tril_indices(len(of_gaussians))]))
    points = np.concatenate(centres)
    return {
        "centres": points,
        "blocks": blocks,
        "readouts": readouts,
        "trend_weights": weights,
        "trend_roots": roots,
    }


def _blocks(kernel, i, j, first_centre, first_column, size, original) -> list[Block]:
    """Return the blocks of output i for its covariance with output j; ``original`` is the kernel of the model."""
    pair = kernel.pair(i, j)
    (regressors,) = original.term_regressors()
    place = i, int(first_centre), int(first_column), int(size)
    return [
        Block(*place, float(gain), shift, root, regressors)
        for gain, root, shift in zip(pair.gain, pair.F, pair.mu, strict=True)
        if size
    ]
