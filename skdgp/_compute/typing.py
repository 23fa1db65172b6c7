"""Types of arrays, which also say what an array holds; shapes stand in the docstrings."""

from __future__ import annotations

from typing import Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from numpy.random import RandomState
from numpy.typing import ArrayLike, NDArray

Array: TypeAlias = NDArray[np.float64]  # real numbers of any shape
Vector: TypeAlias = NDArray[np.float64]  # real numbers, (n,)
Matrix: TypeAlias = NDArray[np.float64]  # real numbers, (n, m)
Mask: TypeAlias = NDArray[np.bool_]  # truth values
Indices: TypeAlias = NDArray[np.intp]  # positions
Seed: TypeAlias = "int | RandomState | None"  # as scikit-learn's ``random_state``


@runtime_checkable
class Predictor(Protocol):
    """A fitted estimator or a posterior."""

    def predict(self, X: Matrix, /) -> Any:
        """Return the mean at X (n, d)."""


__all__ = ["Array", "ArrayLike", "Indices", "Mask", "Matrix", "Predictor", "Seed", "Vector"]
