"""The kernel of a regressor, and its fit."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from sklearn.base import clone
from sklearn.utils import check_random_state
from sklearn.utils.parallel import Parallel, delayed

from skdgp._compute.typing import Matrix, Vector
from skdgp._regressor import _checks
from skdgp.inference import Fit, average, fit_exact, fit_sparse, joined, n_searched
from skdgp.kernels import BasisTrend, ConvolvedGaussian, LinearTrend, Trend

SEARCHES = 2
"""Of a log, which hold out other blocks.

On twelve pairs of flights, three seeds each, the mean of two has 0.98 to 0.99 of the error of one,
of three 0.97 (docs/results.md#pairs-of-flights; tests/benchmarks/pairs.py prints what one search
has alone)."""
N_LATENT = 2, 4
"""Fewest and most shared latents where their number is not given; more take more time.

Of the known values of seven electrodes (docs/results.md) the likelihood is 821, 888 and 910 with
two, three and four.
"""
LOG_ITERATIONS = 60  # of a log; held-out blocks end most searches before
ITERATIONS, ITERATED_VALUES = 150, 1500
"""Most iterations, of a search that learns from up to so many values; of more values as many as take the same time.

Seven electrodes need 100 of 1492 values: the error of gaps is .46 after 60, and .26 then. Other
searches of tests/benchmarks/published.py converge within 90, or do not gain.
"""
ADDITIVE_SAMPLES = (
    5000  # of a log: largest number for which an average has main effects, see docs/theory.md
)


def fit_structure(model: Any, X: Matrix, Z: Matrix, log: bool) -> Fit:
    """Return the fit to X (n, d) and centred and scaled targets Z (n, P), rows of a ``log`` in its order or others.

    Parameters of the model, a DependentGPRegressor, are read; it is not changed.
    """
    kernel, input_noise = _make_kernel(model, X, Z, log), model.input_noise
    if isinstance(input_noise, str) and input_noise == "auto":
        input_noise = "learned" if log else None
    options = {
        "optimizer": model.optimizer,
        "max_iter": most_iterations(model.max_iter, Z, log),
        "input_noise": _checks.input_root(input_noise, X, model._regressor_names()),
        "stop_early": log,
    }
    search = (
        fit_exact
        if model.inference_ == "exact"
        else partial(fit_sparse, n_inducing=model.n_inducing)
    )
    search = partial(search, kernel, X, Z, **options)
    averaged = model.structure == "average" and model.optimizer is not None
    seeds = check_random_state(model.random_state).randint(
        2**31 - 1, size=SEARCHES if averaged and log else 1
    )
    if not averaged:
        return search(random_state=int(seeds[0]))
    n_jobs = model.n_jobs if len(seeds) == 1 else None
    found = Parallel(n_jobs=model.n_jobs, return_as="generator")(
        delayed(_averaged)(search, X, Z, n_jobs, int(seed)) for seed in seeds
    )
    fits: list[Fit] = []
    for fit in found:
        fits.append(fit)
        if fit.interrupted:  # the next search would go on for as long
            break
    return joined(fits)


def most_iterations(max_iter: int | None, Y: Matrix, log: bool) -> int:
    """Return the largest number of iterations of the search for hyperparameters, which learns from N values.

    Where it is not given, 60 of a log, else 150, or :math:`150 (1500 / N)^3`, as N^3 is the time of
    an iteration.
    """
    if max_iter is not None or log:
        return LOG_ITERATIONS if max_iter is None else max_iter
    return int(ITERATIONS * min(ITERATED_VALUES / n_searched(Y), 1.0) ** 3)


def most_factors(model: Any, log: bool) -> int:
    """Return the largest number of Cholesky factors of all values that a posterior of exact inference holds."""
    return (
        2 * SEARCHES if model.structure == "average" and log else 1
    )  # all terms, trend and main effects


def _averaged(search, X, Z, n_jobs, seed):
    fit = search(random_state=seed)
    return fit if fit.interrupted else average(fit, X, Z, n_jobs)


def weights_of(posterior: Any) -> dict[str, Vector]:
    """Return the weight (P,) of each kind of member of a posterior, by its name."""
    weights: dict = {}
    for member, weight in zip(posterior.members, posterior.mixture, strict=True):
        weights[_name(member.kernel)] = weights.get(_name(member.kernel), 0.0) + weight
    return weights


def likeliest_mean(posterior: Any, X: Matrix) -> Matrix:
    """Return the mean at X (n, d) of the member with the largest weight, for each output, (n, P).

    Its errors are noise, where those of an average still hold a part of what the other members
    miss.
    """
    means = np.array([member.predict(X) for member in posterior.members])
    return np.take_along_axis(means, posterior.mixture.argmax(axis=0)[None, None], axis=0)[0]


def _name(kernel):
    terms = [term for term in kernel.summands() if not isinstance(term, Trend)]
    several = any(len(term.term_regressors()[0]) > 1 or kernel.n_features == 1 for term in terms)
    return "joint" if several else "additive" if terms else "trend"


def _make_kernel(model, X, Z, log):
    """Return the kernel of all terms; raise ValueError if the structure needs another kernel or trend."""
    if model.structure == "trend" and (
        model.kernel is not None or model.trend in ("constant", None)
    ):
        raise ValueError(
            f"Got structure='trend' with kernel={model.kernel!r} and trend={model.trend!r}, but "
            f"expected "
            "kernel=None and a trend such as 'linear'."
        )
    if model.structure == "additive" and model.kernel is not None:
        raise ValueError(
            f"Got structure='additive' with kernel={model.kernel!r}, but expected kernel=None: add "
            "ConvolvedGaussian(0, regressors=[k]) to the kernel."
        )
    n, d = X.shape
    trend: Any = None
    if model.trend not in ("constant", None):
        trend = LinearTrend() if model.trend == "linear" else BasisTrend(model.trend)
    if model.structure == "trend":
        return trend
    bounds = "spacing" if log else None
    kernel: Any = model.kernel and clone(model.kernel)
    if kernel is None:
        n_latent = model.n_latent
        if n_latent is None:  # more where they can fill what is missing, see docs/choosing.md
            n_latent = (
                N_LATENT[0]
                if log or np.isfinite(Z).all()
                else int(np.clip(Z.shape[1] // 2, *N_LATENT))
            )
        kernel = ConvolvedGaussian(
            n_latent, covariance_type=model.covariance_type, length_scale_bounds=bounds
        )
    averaged = model.structure == "average" and model.kernel is None and trend is not None
    if model.structure == "additive" or (log and averaged and d > 1 and n <= ADDITIVE_SAMPLES):
        for k in range(d):
            kernel = ConvolvedGaussian(0, regressors=[k], length_scale_bounds=bounds) + kernel
    return kernel if trend is None else trend + kernel
