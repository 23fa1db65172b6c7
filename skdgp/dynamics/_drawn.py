"""Functions drawn from the posterior of a model, with the errors of the log that it was learned from."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from skdgp._compute.typing import Array, Vector
from skdgp.dynamics._aerodynamics import Aerodynamics, separate_generator
from skdgp.dynamics._motion import Motion
from skdgp.dynamics._size_errors import added_errors, errors_of_log, relative_errors


def drawn_functions(
    motion: Motion, n_paths: int, random_state: Any, *, rounded: bool = False
) -> Aerodynamics:
    r"""Return functions drawn from the posterior of the model of a motion, with the errors of its log.

    With these errors, of which each path has its own standard normal :math:`e_k`, a function C becomes

    .. math:: (1 + \sum_k e_k a_k) \, C((1 + \sum_k e_k b_k) \, x) + \sum_k e_k (c_k + D_k (x - m)),

    to first order what `errors_of_sizes` states: relative errors a (6,) of the coefficients and b (d,) of
    the regressors, errors c (6,) at the mean m (d,) of the training rows, and D (6, d) of the slopes.
    ``rounded`` functions are as simulations evaluate them.
    """
    model = motion.aerodynamics
    paths = model.sample(n_paths, random_state, rounded=rounded)
    deviations = errors_of_log(model.errors)
    if not deviations:
        return paths
    draws = separate_generator(random_state, 6).standard_normal((n_paths, len(deviations)))
    relative = relative_errors(deviations, motion.regressors)
    of_coefficients = relative[:, :, 0]
    # the slope of (1 + a) C((1 + b) x) has the relative error a + b to first order, so b is the
    # difference; it is the same for all coefficients, so the first one gives it
    of_regressors = relative[:, 0, 1:] - relative[:, 0, :1]
    factor = 1.0 + draws @ of_coefficients  # (n_paths, 6)
    stretch = 1.0 + draws @ of_regressors  # (n_paths, d)
    added = np.tensordot(draws, added_errors(deviations, motion.regressors), axes=1)
    offset = added[:, None, :, 0]
    slope = added[:, :, 1:]  # (n_paths, 6, d)
    mean = mean_regressors(model)

    # as `Aerodynamics` calls its functions: X (n_paths, n, d); ``paths.gradient`` also has slopes by
    # differences, where the paths have none of their own
    def values(X: Array) -> Array:
        scaled = paths.function(X * stretch[:, None]) * factor[:, None]
        return scaled + offset + (X - mean) @ slope.mT

    def slopes(X: Array) -> Array:
        by_scaled = paths.gradient(X * stretch[:, None])
        scales = factor[:, None, :, None] * stretch[:, None, None]
        return by_scaled * scales + slope[:, None]

    return replace(paths, function=values, slopes=slopes)


def mean_regressors(model: Aerodynamics) -> Vector:
    """Return the mean (d,) of the rows that a model was learned from, or the middle of its ranges."""
    if model.learned is not None:
        return model.learned.training_rows().mean(axis=0)
    if model.limits is not None:
        return model.limits.mean(axis=0)
    return np.zeros(len(model.regressors))
