"""Modes of a linear model: names of its eigenvalues by the states that take part, and their spread over paths."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment

from skdgp._compute.typing import Array
from skdgp._flight.tables import check_names

# States of the modes along and across the plane of symmetry
LONGITUDINAL = ("u", "w", "q", "theta")
LATERAL = ("v", "p", "r", "phi")


def mode_table(A: pd.DataFrame, paths: Array | None = None) -> pd.DataFrame:
    """Return the table of :meth:`skdgp.dynamics.LinearModel.modes`, of A and of the A of paths (n_paths, n, n)."""
    names = [*LONGITUDINAL, *LATERAL]
    check_names(names, map(str, A), "states of the linear model")
    rows = A.columns.get_indexer(pd.Index(names))
    eigenvalues, left, right = eig(A.to_numpy()[np.ix_(rows, rows)], left=True)
    participation = pd.DataFrame(_participation(left, right), names)
    modes = _named(_units(eigenvalues), participation, eigenvalues)
    table = pd.DataFrame([_row(eigenvalues[unit]) for unit in modes.values()], list(modes))
    if paths is not None:
        _add_spread(table, paths[:, rows][:, :, rows], eigenvalues, list(modes.values()))
    return table


def _participation(left: np.ndarray, right: np.ndarray) -> Array:
    """Return the fraction of each state (rows) in each mode (columns), of its eigenvectors."""
    factors = np.abs(left.conj() * right)
    # a repeated root may have orthogonal vectors: an aircraft without lateral derivatives
    factors = np.where(factors.sum(axis=0) > 0, factors, np.abs(right))
    return factors / factors.sum(axis=0)


def _add_spread(
    table: pd.DataFrame, paths: Array, eigenvalues: np.ndarray, units: list[list[int]]
) -> None:
    """Add the standard deviations and limits over the paths (n_paths, n, n) to the table of modes."""
    values = []
    for path in paths:
        roots = np.linalg.eigvals(path)
        # in the order of the eigenvalues that they lie nearest to
        _, order = linear_sum_assignment(np.abs(eigenvalues[:, None] - roots))
        values.append([_values(roots[order[unit]]) for unit in units])
    frequency, damping, decay = np.moveaxis(np.array(values), -1, 0)  # (n_paths, modes) each
    table["frequency_std"] = frequency.std(axis=0, ddof=1)
    table["damping_std"] = damping.std(axis=0, ddof=1)
    slowest, fastest = np.quantile(decay, [0.025, 0.975], axis=0)
    with np.errstate(divide="ignore"):
        table["time_constant_lower"] = np.where(fastest > 0, 1.0 / fastest, -np.inf)
        table["time_constant_upper"] = np.where(slowest > 0, 1.0 / slowest, np.inf)


def _units(eigenvalues: np.ndarray) -> list[list[int]]:
    """Return pairs of conjugate eigenvalues, positive imaginary part first, and single real ones."""
    units = []
    for k, value in enumerate(eigenvalues):
        # LAPACK returns the conjugate next
        if value.imag >= 0:
            units.append([k, k + 1] if value.imag else [k])
    return units


def _named(
    units: list[list[int]], participation: pd.DataFrame, eigenvalues: Array
) -> dict[str, list[int]]:
    """Return the units by name, of the participation of the states in each eigenvalue.

    Several of one name have numbers, the fastest first.
    """
    along, across = _split(units, participation.loc[[*LONGITUDINAL]], 4)
    short, long = _split(along, participation.loc[["w", "q"]], 2)
    dutch, slow = _split(across, participation.loc[["v", "r"]], 2)
    roll, spiral = _split(slow, participation.loc[["p"]], 1)
    last = "spiral" if roll else "roll-spiral"
    modes = {
        "short period": short,
        "phugoid": long,
        "Dutch roll": dutch,
        "roll": roll,
        last: spiral,
    }
    named = {}
    for name, of_name in modes.items():
        fastest_first = sorted(of_name, key=lambda unit: -abs(eigenvalues[unit[0]]))
        for k, unit in enumerate(fastest_first, start=1):
            named[name if len(of_name) == 1 else f"{name} {k}"] = unit
    return named


def _split(
    units: list[list[int]], participation: pd.DataFrame, size: int
) -> tuple[list[list[int]], list[list[int]]]:
    """Return the units, ``size`` eigenvalues, with the largest participation of some states, and the others.

    A pair is not taken apart: there may be no such units.
    """
    share = participation.sum().to_numpy()
    largest: list[list[int]] = []
    left = size
    for unit in sorted(units, key=lambda unit: -share[unit[0]]):
        if len(unit) <= left:
            largest.append(unit)
            left -= len(unit)
    return largest, [unit for unit in units if unit not in largest]


def _values(roots: np.ndarray) -> tuple[float, float, float]:
    """Return frequency, damping and rate of decay of a root, or of two as s^2 + 2 zeta omega s + omega^2."""
    decay = float(-roots.real.mean())
    frequency = float(np.abs(np.prod(roots)) ** (1.0 / len(roots)))
    damping = decay / frequency if frequency > 0 else 0.0
    return frequency, damping, decay


def _row(roots: np.ndarray) -> dict[str, Any]:
    frequency, damping, decay = _values(roots)
    turn = abs(roots[0].imag)
    return {
        "eigenvalue": roots[0],
        "frequency": frequency,
        "damping": damping,
        "time_constant": 1.0 / decay if decay else np.inf,
        "period": 2.0 * np.pi / turn if turn else np.inf,
    }
