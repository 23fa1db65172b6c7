"""The choice of a regressor's structure, number of shared latent processes and hyperparameters."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state

from skdgp._compute.parallel import fit_map
from skdgp._compute.typing import Matrix
from skdgp._regressor import _checks
from skdgp.inference import Fit, choose_kernel, fit_exact, fit_sparse, held_out_errors
from skdgp.kernels import BasisTrend, ConvolvedGaussian, LinearTrend

ADDITIVE_SAMPLES = 5000  # largest number of samples for which structure="auto" adds main effects: see docs/choosing.md
SHARED_LATENTS = 2  # number of shared latents of n_latent=None
COMPLETE = 0.95  # smallest part of the values that is observed for structure="auto" to share none
MAX_LATENT = 3  # largest number of shared latents that n_latent="auto" tries


@dataclass
class Chosen:
    """The fit and what was chosen for it: ``structure_``, ``n_latent_``, ... of the regressor."""

    structure: str
    n_latent: int | str | None
    n_latent_scores: dict[int, float] = field(default_factory=dict)
    structure_errors: dict[str, np.ndarray] = field(default_factory=dict)
    fit: Fit | None = None


def choose(model: Any, X: Matrix, Z: Matrix) -> Chosen:
    """Return the best fit over the starting points, or that of the trend alone where it is better.

    Parameters
    ----------
    model : DependentGPRegressor
        Its parameters are read; it is not changed.
    X : ndarray (n, d)
    Z : ndarray (n, P)
        Targets, centred and scaled. NaN where an output was not observed.
    """
    _check_structure(model)
    root = _checks.input_root(model.input_noise, X, model._regressor_names())
    options = {"optimizer": model.optimizer, "max_iter": model.max_iter, "input_noise": root}
    seeds = check_random_state(model.random_state).randint(2**31 - 1, size=1 + model.n_restarts_optimizer)
    chosen, kernel, known = _choose_kernel(model, X, Z, options | {"random_state": int(seeds[0])})
    exact = model.inference_ == "exact"
    search = fit_exact if exact else partial(fit_sparse, n_inducing=model.n_inducing)
    search = partial(search, X=X, Y=Z, early_stopping=model.early_stopping, **options)
    starts = [{"random_state": int(seed), "spread": float(k > 0)} for k, seed in enumerate(seeds)]
    fits = fit_map(partial(search, kernel, found=known), starts if known is None else starts[:1], model.n_jobs)
    best = max(fits, key=lambda fit: fit.value)
    chosen.fit = best.marked(any(fit.interrupted for fit in fits))
    if model.structure == "auto" and _has_trend(model) and not chosen.fit.interrupted:
        alone = partial(search, _make_trend(model), random_state=int(seeds[0]))
        try:
            _prefer_trend(chosen, alone, X, Z, model.n_inducing)
        except KeyboardInterrupt:
            chosen.fit = best.marked(interrupted=True)
    return chosen


def _prefer_trend(chosen, alone, X, Z, n_inducing):
    """Replace the fit by the trend ``alone`` if this predicts held-out blocks better.

    The trend is fitted to exact regressors for the comparison: that is faster and changes its errors by some per cent.
    """
    trend = alone(input_noise=None)
    if trend.interrupted:
        raise KeyboardInterrupt
    fits = {"trend": trend, chosen.structure: chosen.fit}
    errors: dict[str, Any] = {name: held_out_errors(fit, X, Z, n_inducing) for name, fit in fits.items()}
    if any(values is None for values in errors.values()):
        return
    chosen.structure_errors = errors
    if np.nanmean(errors["trend"]) < np.nanmean(errors[chosen.structure]):
        chosen.structure, chosen.n_latent, chosen.fit = "trend", 0, alone()


def _check_structure(model):
    """Raise ValueError if the structure needs another kernel or trend."""
    if model.structure == "trend" and not _has_trend(model):
        raise ValueError(
            f"Got structure='trend' with kernel={model.kernel!r} and trend={model.trend!r}, but expected "
            "kernel=None and a trend such as 'linear'."
        )
    if model.structure == "additive" and model.kernel is not None:
        raise ValueError(
            f"Got structure='additive' with kernel={model.kernel!r}, but expected kernel=None: add "
            "ConvolvedGaussian(0, regressors=[k]) to the kernel."
        )


def _has_trend(model):
    """Return whether the model has a trend that can be fitted without processes."""
    return model.kernel is None and model.trend not in ("constant", None)


def _choose_kernel(model, X, Z, options):
    """Return the choice, the kernel to fit, and the best hyperparameters so far if Ctrl-C ended its choice."""
    chosen = Chosen(model.structure, model.n_latent if model.kernel is None else None)
    if model.structure == "trend":
        chosen.n_latent = 0
        return chosen, _make_trend(model), None
    if model.structure == "auto":
        additive = _has_trend(model) and len(X) <= ADDITIVE_SAMPLES and X.shape[1] > 1
        chosen.structure = "additive" if additive else "joint"
    if model.kernel is None and model.n_latent is None:
        complete = np.isfinite(Z).mean() >= COMPLETE
        independent = model.structure == "auto" and model.private_latents and complete
        chosen.n_latent = 0 if independent else SHARED_LATENTS
    make = partial(_make_kernel, model, chosen.structure, X.shape[1])
    if chosen.n_latent != "auto":
        return chosen, make(chosen.n_latent), None
    fewest = int(not model.private_latents)
    numbers = range(fewest, (MAX_LATENT if Z.shape[1] > 1 else fewest) + 1)
    choice = choose_kernel([make(k) for k in numbers], X, Z, **options)
    chosen.n_latent = numbers[choice.index]
    chosen.n_latent_scores = dict(zip(numbers, choice.scores, strict=False))
    return chosen, make(chosen.n_latent), choice.found


def _make_kernel(model, structure, d, n_latent):
    widths = {"length_scale_bounds": model.length_scale_bounds, "length_scale_prior": model.length_scale_prior}
    options = {"private_latents": model.private_latents, "covariance_type": model.covariance_type, **widths}
    kernel: Any = ConvolvedGaussian(n_latent, **options) if model.kernel is None else clone(model.kernel)
    if structure == "additive":
        for k in range(d):
            kernel = ConvolvedGaussian(0, regressors=[k], **widths) + kernel
    return kernel if model.trend in ("constant", None) else _make_trend(model) + kernel


def _make_trend(model):
    return LinearTrend() if model.trend == "linear" else BasisTrend(model.trend)
