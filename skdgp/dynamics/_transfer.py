"""Transfer functions of linear models."""

from __future__ import annotations

from typing import Any

import numpy as np

from skdgp._compute.typing import Array

# States that neither loads nor outputs of interest depend on: their modes are at zero
UNUSED = ("north", "east", "down", "psi")


def transfer(A: Any, B: Any, C: Any, D: Any, states: Any, s: Array) -> Array:
    """Return C (s I - A)^-1 B + D at s (n,), (..., n, n_outputs, n_inputs), without position and heading.

    A, B, C, D are tables or arrays (..., :, :); ``states`` are the names of the rows of A.
    """
    kept = [k for k, name in enumerate(states) if name not in UNUSED]
    A, B, C, D = (np.asarray(matrix) for matrix in (A, B, C, D))
    A = A[..., kept, :][..., kept]
    B = B[..., kept, :]
    C = C[..., kept]
    resolvent = s[:, None, None] * np.eye(len(kept)) - A[..., None, :, :]
    shape = (*resolvent.shape[:-1], B.shape[-1])
    response = np.linalg.solve(resolvent, np.broadcast_to(B[..., None, :, :], shape))
    return C[..., None, :, :] @ response + D[..., None, :, :]
