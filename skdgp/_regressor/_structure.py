"""The kernel of a regressor, and its fit."""

from __future__ import annotations

from typing import Any

import numpy as np
from sklearn.base import BaseEstimator, clone
from sklearn.utils import check_random_state

from skdgp._compute.typing import Matrix, Vector
from skdgp._regressor import _checks
from skdgp.inference import (
    Fit,
    Posterior,
    as_exact,
    average,
    fit_exact,
    fit_sparse,
    mean_of,
    n_searched,
    stratified,
)
from skdgp.kernels import (
    ConvolvedGaussian,
    LinearTrend,
    MultiOutputKernel,
)

# Searches of a time series, each from other rows (docs/results.md, pairs of flights)
SEARCHES = 2
# Fewest and most shared latents where their number is not given; more take more time
N_LATENT = 2, 4
LOG_ITERATIONS = 60  # of a log
# Most iterations, of at most so many values; of more values, as many as take the same time
ITERATIONS, ITERATED_VALUES = 150, 1500
# Most observed values, and values of a log, of which inference="auto" is exact
EXACT_LIMIT, LOG_LIMIT = 6000, 1000
# Largest prior variance that inducing variables leave unexplained, over the noise variance
MOST_NEGLECTED = 0.3
ADDITIVE_SAMPLES = (
    5000  # of a log: largest number for which an average has main effects, see docs/theory.md
)


def fit_structure(model: BaseEstimator, X: Matrix, Z: Matrix, log: bool, inference: str) -> Fit:
    """Return the fit to X (n, d) and centred and scaled targets Z (n, P), rows of a ``log`` in its order or others.

    Parameters of the model, a DependentGPRegressor, are read; it is not changed.
    """
    random_state = check_random_state(model.random_state)
    fits: list[Fit] = []
    while len(fits) < n_searches(model, log):
        fits.append(_searched(model, X, Z, log, inference, random_state))
        if fits[-1].learned.interrupted:
            return fits[0].cut_short()
    return mean_of(fits)


def n_searches(model: BaseEstimator, log: bool) -> int:
    """Return the number of searches whose averages a fit is the mean of."""
    return SEARCHES if log and model.structure == "average" and model.optimizer is not None else 1


def _searched(model, X, Z, log, inference, random_state):
    """Return the fit of one search."""
    kernel = _make_kernel(model, X, Z, log)
    options = {
        "optimizer": model.optimizer,
        "max_iter": most_iterations(model.max_iter, Z, log),
        "input_noise": model.input_noise == "learned" or (log and model.input_noise == "auto"),
        "random_state": random_state.randint(2**31 - 1),
    }
    if inference == "exact":
        fit = fit_exact(kernel, X, Z, **options)
    else:
        fit = fit_sparse(kernel, X, Z, **options, n_inducing=model.n_inducing, ordered=log)
        neglected = 0.0  # prior variance over the noise, of the worst output
        if not (log or fit.learned.interrupted or fit.learned.input_std is not None):
            sparse: Any = fit.posterior
            neglected = float(np.max(sparse.unexplained_variance / sparse.noise))
        n_exact = EXACT_LIMIT if model.inference == "auto" else None
        if neglected > MOST_NEGLECTED:
            _checks.warn_of_approximation(neglected, model.n_inducing, n_exact)
        if neglected > MOST_NEGLECTED and n_exact is not None:
            n = EXACT_LIMIT * len(X) // np.isfinite(Z).sum()
            rows = stratified(np.arange(len(X)), n, random_state)
            X, Z = X[rows], Z[rows]
            fit = as_exact(fit.learned, X, Z, fit.learned.data(X, Z))
    if model.structure != "average" or model.optimizer is None or fit.learned.interrupted:
        return fit
    return average(fit, X, Z, None if log else random_state)


def most_iterations(max_iter: int | None, Y: Matrix, log: bool) -> int:
    """Return the largest number of iterations of the search for hyperparameters, which learns from N values.

    Where it is not given, 60 of a log, else 150, or :math:`150 (1500 / N)^3`, as N^3 is the time of
    an iteration.
    """
    if max_iter is not None or log:
        return LOG_ITERATIONS if max_iter is None else max_iter
    return int(ITERATIONS * min(ITERATED_VALUES / n_searched(Y), 1.0) ** 3)


def weights_of(posterior: Posterior) -> dict[str, Vector]:
    """Return the weight (P,) of each kind of member of a posterior, by its name."""
    weights: dict = {}
    for member, weight in zip(posterior.members, posterior.mixture, strict=True):
        weights[_name(member.kernel)] = weights.get(_name(member.kernel), 0.0) + weight
    return weights


def likeliest_mean(posterior: Posterior, X: Matrix) -> Matrix:
    """Return the mean at X (n, d) of the member with the largest weight, for each output, (n, P).

    Its errors are noise, where an average still has a part of the errors of the other members.
    """
    means = np.array([member.predict(X) for member in posterior.members])
    return np.take_along_axis(means, posterior.mixture.argmax(axis=0)[None, None], axis=0)[0]


def _name(kernel):
    terms = [term for term in kernel.summands() if not isinstance(term, LinearTrend)]
    several = any(len(term.term_regressors()[0]) > 1 or kernel.n_features == 1 for term in terms)
    return "joint" if several else "additive" if terms else "trend"


def _make_kernel(model, X, Z, log):
    """Return the kernel of all terms; raise ValueError if the structure needs another kernel or trend."""
    if model.structure == "trend" and (model.kernel is not None or model.trend != "linear"):
        raise ValueError(
            f"Got structure='trend' with kernel={model.kernel!r} and trend={model.trend!r}, but "
            f"expected "
            "kernel=None and trend='linear'."
        )
    if model.structure == "additive" and model.kernel is not None:
        raise ValueError(
            f"Got structure='additive' with kernel={model.kernel!r}, but expected kernel=None: add "
            "ConvolvedGaussian(0, regressors=[k]) to the kernel."
        )
    n, d = X.shape
    trend = LinearTrend() if model.trend == "linear" else None
    averaged = model.structure == "average" and model.kernel is None and trend is not None
    if model.structure == "trend" or (averaged and d > n):  # a process would have no weight
        return trend
    bounds = {"length_scale": "spacing"} if log else None
    kernel: MultiOutputKernel | None = model.kernel and clone(model.kernel)
    if kernel is None:
        n_latent = model.n_latent
        if n_latent is None:  # more where they can fill what is missing
            n_latent = (
                N_LATENT[0]
                if log or np.isfinite(Z).all()
                else int(np.clip(Z.shape[1] // 2, *N_LATENT))
            )
        kernel = ConvolvedGaussian(n_latent, parameter_bounds=bounds)
    if model.structure == "additive" or (log and averaged and d > 1 and n <= ADDITIVE_SAMPLES):
        for k in range(d):
            kernel = ConvolvedGaussian(0, regressors=[k], parameter_bounds=bounds) + kernel
    return kernel if trend is None else trend + kernel
