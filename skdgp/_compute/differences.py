"""Derivatives of functions by central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from skdgp._compute.typing import Array


def central_difference(function: Callable[[Array], Array], z: Array, steps: Array) -> Array:
    r"""Return the Jacobian (..., m, n) of a function of vectors (..., n) to (..., m), of fourth order in the steps.

    .. math:: f'(z) \approx \frac{8 (f(z + h) - f(z - h)) - (f(z + 2h) - f(z - 2h))}{12 h}

    ``steps`` h are (n,) or (..., n). The function gets arrays (..., n, n), whose row i has
    component i moved.
    """
    moves = steps[..., None] * np.eye(z.shape[-1])
    z = z[..., None, :]
    near = function(z + moves) - function(z - moves)
    far = function(z + 2.0 * moves) - function(z - 2.0 * moves)
    rows = (8.0 * near - far) / (12.0 * steps[..., None])
    return np.swapaxes(rows, -1, -2)
