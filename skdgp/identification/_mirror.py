"""Flights of a symmetric aircraft as seen in a mirror."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from skdgp._flight.channels import COEFFICIENTS, ELEVONS, HAT

LATERAL = frozenset(("beta", "beta_dot", "p", "r", "p_dot", "r_dot", "ay", "aileron", "rudder", "CY", "Cl", "Cn"))
"""Regressors and coefficients whose sign changes in a mirror."""


def mirrored(regressors: pd.DataFrame, targets: pd.DataFrame) -> tuple[pd.DataFrame, pd.DataFrame]:
    """Return regressors (n, d) and coefficients (n, P) of the flights as seen in a mirror.

    A symmetric aircraft flies the mirrored flight with the mirrored controls. Lateral coefficients change their sign
    about their value without sideslip, rates and lateral controls, by least squares: an asymmetry stays. Raises
    ValueError for single elevons.
    """
    if set(ELEVONS) & set(regressors):
        raise ValueError(
            f"Got regressors {list(regressors)} of a symmetric aircraft, but expected elevator and aileron in place of "
            "single elevons: put ElevonSplitter() before RegressorSelector."
        )
    lateral = [name for name in map(str, regressors) if name.removesuffix(HAT) in LATERAL]
    X, Y = regressors.copy(), targets.copy()
    X[lateral] = -X[lateral]
    A = np.column_stack([np.ones(len(X)), regressors[lateral]])
    for name in LATERAL & set(Y):
        known = Y[name].notna().to_numpy()
        straight = np.linalg.lstsq(A[known], Y[name].to_numpy()[known], rcond=None)[0][0]
        Y[name] = 2 * straight - Y[name]
    return X, Y


def named_targets(y: Any) -> pd.DataFrame:
    """Return targets with the names of a table, or an array's as the six coefficients; ValueError for other arrays."""
    if isinstance(y, pd.DataFrame):
        return y
    if np.ndim(y) != 2 or np.shape(y)[1] != len(COEFFICIENTS):
        raise ValueError(
            f"Got targets of shape {np.shape(y)} without names, but expected a table with columns such as CY, Cl, Cn, "
            "or the six coefficients: give a DataFrame."
        )
    return pd.DataFrame(np.asarray(y, dtype=float), columns=COEFFICIENTS)
