"""Modes of a linear model: short period, phugoid, Dutch roll, roll and spiral."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np
import pandas as pd
from scipy.linalg import eig
from scipy.optimize import linear_sum_assignment

__all__ = ["LATERAL", "LONGITUDINAL", "mode_table"]

LONGITUDINAL, LATERAL = ("u", "w", "q", "theta"), ("v", "p", "r", "phi")


def mode_table(A: np.ndarray, states: Sequence[str], paths: np.ndarray | None = None) -> pd.DataFrame:
    r"""Return a row for each mode of :math:`\dot x = A x`, with the spread over ``paths`` (n_paths, n, n).

    See :meth:`skdgp.dynamics.LinearModel.modes`.
    """
    states = list(states)
    core = [name for family in (LONGITUDINAL, LATERAL) if set(family) <= set(states) for name in family]
    core = core or states
    rows = [states.index(name) for name in core]
    A = A[np.ix_(rows, rows)]
    eigenvalues, left, right = eig(A, left=True)
    share = np.abs(left.conj() * right)
    named = _named(_units(eigenvalues), share / share.sum(axis=0), core, eigenvalues)
    table = pd.DataFrame([_row(eigenvalues[list(unit)]) for unit in named.values()], index=list(named))
    if paths is None:
        return table
    spread = [_matched(np.linalg.eigvals(path), eigenvalues) for path in paths[:, rows][:, :, rows]]
    found = np.array([[_values(values[list(unit)]) for unit in named.values()] for values in spread])
    decay = np.quantile(found[..., 2], [0.025, 0.975], axis=0)
    table["frequency_std"], table["damping_std"] = found[..., 0].std(axis=0, ddof=1), found[..., 1].std(axis=0, ddof=1)
    table["time_constant_lower"], table["time_constant_upper"] = _inverse(decay[1]), _inverse(decay[0])
    table.loc[decay[0] <= 0, "time_constant_upper"] = np.inf
    table.loc[decay[1] <= 0, "time_constant_lower"] = -np.inf
    return table


def _units(eigenvalues: np.ndarray) -> list[tuple[int, ...]]:
    """Return pairs of conjugate eigenvalues, that of positive imaginary part first, and single real ones."""
    units = []
    for k, value in enumerate(eigenvalues):
        if value.imag > 0:
            units.append((k, int(np.argmin(np.abs(eigenvalues - value.conj())))))
        elif value.imag == 0:
            units.append((k,))
    return units


def _named(units, share, states, eigenvalues) -> dict[str, tuple[int, ...]]:
    """Return the units by name, of the shares that the states have in each eigenvalue."""

    def moving(names, unit):
        return share[np.ix_([states.index(name) for name in names], unit)].sum()

    def split(units, names, size):
        return max(_choices(units, size), key=lambda chosen: sum(moving(names, unit) for unit in chosen))

    named, rest = {}, list(units)
    if set(LONGITUDINAL) <= set(states):
        along = split(rest, LONGITUDINAL, 4)
        rest = [unit for unit in rest if unit not in along]
        short = split(along, ("w", "q"), 2)
        named |= _numbered("short period", short, eigenvalues)
        named |= _numbered("phugoid", [unit for unit in along if unit not in short], eigenvalues)
    if set(LATERAL) <= set(states):
        dutch = split(rest, ("v", "r"), 2)
        others = sorted((unit for unit in rest if unit not in dutch), key=lambda unit: -moving(("p",), unit))
        named |= _numbered("Dutch roll", dutch, eigenvalues)
        named |= dict(zip(("roll", "spiral") if len(others) == 2 else ("roll-spiral",), others, strict=True))
        rest = []
    if not named:
        named = _numbered("mode", rest, eigenvalues)
    return named


def _choices(units, size) -> Iterator[list]:
    """Yield every choice of units that holds ``size`` eigenvalues."""
    for number in range(1, size + 1):
        for chosen in combinations(units, number):
            if sum(map(len, chosen)) == size:
                yield list(chosen)


def _numbered(name, units, eigenvalues) -> dict[str, tuple[int, ...]]:
    """Return the one unit by its name; several with numbers, the fastest first."""
    units = sorted(units, key=lambda unit: -abs(eigenvalues[unit[0]]))
    return {name: units[0]} if len(units) == 1 else {f"{name} {k}": unit for k, unit in enumerate(units, start=1)}


def _values(eigenvalues: np.ndarray) -> tuple[float, float, float]:
    """Return frequency, damping and rate of decay of one root, or of two as s^2 + 2 zeta omega s + omega^2."""
    decay = float(-eigenvalues.real.mean())
    frequency = float(np.sqrt(np.abs(np.prod(eigenvalues)))) if len(eigenvalues) == 2 else float(abs(eigenvalues[0]))
    return frequency, decay / frequency if frequency > 0 else 0.0, decay


def _row(eigenvalues: np.ndarray) -> dict:
    frequency, damping, decay = _values(eigenvalues)
    return {
        "eigenvalue": eigenvalues[0],
        "frequency": frequency,
        "damping": damping,
        "time_constant": float(_inverse(decay)),
        "time_to_half": float(np.log(2.0) * _inverse(max(decay, 0.0))),
        "time_to_double": float(np.log(2.0) * _inverse(max(-decay, 0.0))),
        "period": float(2.0 * np.pi * _inverse(abs(eigenvalues[0].imag))),
    }


def _inverse(values) -> np.ndarray:
    values = np.asarray(values, dtype=float)
    return np.divide(1.0, values, out=np.full(values.shape, np.inf), where=values != 0)


def _matched(found: np.ndarray, eigenvalues: np.ndarray) -> np.ndarray:
    """Return the eigenvalues of a path in the order of those that they lie nearest to."""
    _, order = linear_sum_assignment(np.abs(eigenvalues[:, None] - found))
    return found[order]
