"""What a regressor of several outputs asks of its targets, at the door."""

from __future__ import annotations

import os
import warnings
from numbers import Integral, Real

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_array

from skdgp._linalg import column_scale, constant_columns

MOST_NOISE = 10  # standard deviation of a regressor's noise, over that of the regressor
X_RANGE = (1e-60, 1e60)  # magnitudes of regressors: their fourth powers are numbers
MUCH = 0.5  # change of a prediction by compacting, in standard deviations, that is warned of unasked
Y_RANGE = (1e-100, 1e100)  # magnitudes of targets: their squares are numbers
FEWER_VALUES = (
    "Use inference='sparse', or observe fewer: skdgp.model_selection.thin_targets(Y, 755) keeps 755 samples spread "
    "over the log."
)
FEWER_LATER = (
    "Compact the model first (model.compact(), which goes on learning in memory that does not grow), or fit with "
    "inference='sparse'."
)


def check_targets(y, n_samples: int, estimator: str) -> tuple[np.ndarray, list[str], bool]:
    """Return the targets as (n, P) with NaN where not observed, their names, and whether they were (n,)."""
    if y is None:
        raise ValueError(f"This {estimator} estimator requires y to be passed, but the target y is None.")
    names = target_names(y)
    Y = check_array(y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y")
    if Y.ndim > 2:
        raise ValueError(f"Got y of shape {Y.shape}, but expected (n,) or (n, P).")
    if len(Y) != n_samples:
        raise ValueError(
            f"Found input variables with inconsistent numbers of samples: {[n_samples, len(Y)]}. y needs a row for "
            "each of X; NaN where an output was not observed."
        )
    table = Y.reshape(len(Y), -1)
    return table, names or unnamed(table.shape[1]), Y.ndim == 1


def target_names(y) -> list[str]:
    """Return the columns of a dataframe of any library, or the name of a series; empty if they are not all texts."""
    names = list(getattr(y, "columns", [getattr(y, "name", None)]))
    return names if all(isinstance(name, str) and name for name in names) else []


def standardized(Y: np.ndarray, centered: bool, scaled: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return targets with mean 0 and mean square 1 where asked, and the center and scale of each output, (P,).

    The center of a constant output is its value, its scale the size of that: it is 0 or 1 everywhere, without rounding.
    """
    constant, size = constant_columns(Y), np.nanmax(np.abs(Y), axis=0)
    Y = np.where(constant & np.isfinite(Y), Y[np.isfinite(Y).argmax(axis=0), range(Y.shape[1])], Y)
    center = np.where(constant, np.nanmax(Y, axis=0), np.nanmean(Y, axis=0)) if centered else np.zeros(Y.shape[1])
    scale = np.sqrt(np.nanmean((Y - center) ** 2, axis=0)) if scaled else np.ones(Y.shape[1])
    scale = np.where(constant & scaled, np.where(size > 0, size, 1.0), scale)
    return (Y - center) / scale, center, scale


def check_magnitudes(Z: np.ndarray, names: list[str], what: str, least: float, most: float) -> None:
    """Refuse columns whose powers overflow or vanish in double precision; Z (n, k) with NaN where not observed."""
    size = np.nanmax(np.abs(Z), axis=0, initial=0.0)
    extreme = (size > most) | ((size < least) & (size > 0))
    if extreme.any():
        found = {name: f"{s:.1g}" for name, s, out in zip(names, size, extreme, strict=True) if out}
        raise ValueError(
            f"Got {what} of magnitudes {found}, but expected between {least:g} and {most:g}: powers of others "
            "vanish or overflow. Use another unit, or scale them (StandardScaler)."
        )


def warn_of_constant_regressors(X: np.ndarray, names: list[str]) -> None:
    """Warn of regressors (n, d) that have the same value in all samples."""
    constant = [name for name, same in zip(names, constant_columns(X), strict=True) if same]
    if constant:
        _warn(
            f"The regressors {constant} are constant over the samples: their effect cannot be learned, and predictions "
            "at other values of them mean little. Leave them out, or add samples in which they vary."
        )


def check_enough(Y: np.ndarray, names: list[str]) -> None:
    """Refuse outputs that no two samples tell of."""
    counts = np.isfinite(Y).sum(axis=0)
    few = {name: int(n) for name, n in zip(names, counts, strict=True) if n < 2}
    if few:
        raise ValueError(
            f"Got outputs observed at fewer than two samples: {few} (NaN is not observed). Leave these columns out, or "
            "give at least two of their values, better many."
        )


def check_memory(n_values: int, what: str, remedy: str, n_matrices: int = 2) -> None:
    """Refuse what needs so many matrices of n_values x n_values doubles and would not fit the machine."""
    needed, there = 8 * n_matrices * n_values**2, _physical_memory()
    if needed > 0.8 * there:
        raise ValueError(
            f"{what} {n_values} values needs about {needed / 2**30:.0f} GiB, but this machine has "
            f"{there / 2**30:.0f} GiB. {remedy}"
        )


def check_same_targets(names: list[str], expected: list[str]) -> None:
    """Refuse further targets that are not of the outputs that were fitted."""
    if len(names) != len(expected):
        raise ValueError(
            f"Got y with {len(names)} outputs, but expected the {len(expected)} that were fitted: {expected}. Set the "
            "targets of an output that was not observed to NaN."
        )
    if names != expected and unnamed(len(names)) not in (names, expected):
        raise ValueError(f"Got y with the columns {names}, but expected those of the fit, in their order: {expected}.")


def warn_of_inducing(n_inducing: int, n_samples: int) -> None:
    """Warn of more inducing inputs than samples."""
    if n_inducing > n_samples:
        warnings.warn(
            f"Got n_inducing={n_inducing} for {n_samples} samples: each sample becomes an inducing input, which costs "
            "more than it saves. Lower n_inducing, or use inference='exact'.",
            UserWarning,
            stacklevel=4,
        )


def check_compaction(n_inducing, tolerance, max_iter) -> None:
    """Refuse numbers that make no sense."""
    if not isinstance(n_inducing, Integral) or isinstance(n_inducing, bool) or n_inducing < 1:
        raise ValueError(f"Got n_inducing={n_inducing!r}, but expected a number of inducing variables from 1 on.")
    if not isinstance(max_iter, Integral) or isinstance(max_iter, bool) or max_iter < 0:
        raise ValueError(f"Got max_iter={max_iter!r}, but expected a number of iterations, or 0 for none.")
    if tolerance is None:
        return
    if not isinstance(tolerance, Real) or isinstance(tolerance, bool) or not 0 < tolerance < np.inf:
        raise ValueError(
            f"Got tolerance={tolerance!r}, but expected a positive fraction of the standard deviation, such as 0.1, or "
            "None."
        )


def warn_of_compaction(tolerance: float | None, change: float, n_inducing: int) -> None:
    """Warn that compacting changed predictions by more than the tolerance, or, where none was asked for, by much."""
    if change <= (MUCH if tolerance is None else tolerance):
        return
    asked = "" if tolerance is None else f", which is more than the tolerance {tolerance:g}"
    warnings.warn(
        f"Compacting to {n_inducing} inducing variables changes mean or deviation of an output by {change:.2g} of its "
        f"standard deviation (root mean square){asked}. Raise n_inducing, or see compaction_ for which output it is.",
        UserWarning,
        stacklevel=3,
    )


def input_root(input_noise, X: np.ndarray, names: list[str]):
    """Return R (d, r) of the covariance R R^T of the regressors' noise, or what asks for none or for learning."""
    if input_noise is None or isinstance(input_noise, str):
        return input_noise
    root = _root_of(input_noise, X.shape[1])
    noise = np.sqrt(np.einsum("dr,dr->d", root, root))
    drowned = (noise > MOST_NOISE * column_scale(X)) & ~constant_columns(X)
    if drowned.any():
        found = {name: f"{s:.2g}" for name, s, out in zip(names, X.std(axis=0), drowned, strict=True) if out}
        raise ValueError(
            f"Got input_noise that is more than {MOST_NOISE} times what the regressors vary by (standard deviations: "
            f"{found}), but expected the noise that is part of this. Give it in the units of X, one for each column."
        )
    return root


def _root_of(input_noise, d):
    given = np.asarray(input_noise, dtype=float)
    expected = f"expected a standard deviation, {d} of them, or a covariance ({d}, {d}), in the units of X."
    if given.shape not in ((), (d,), (d, d)) or not np.isfinite(given).all():
        raise ValueError(f"Got input_noise of shape {given.shape}, but {expected}")
    if given.ndim < 2:
        if (given < 0).any():
            raise ValueError(f"Got input_noise down to {given.min():g}, but {expected}")
        return np.diag(np.broadcast_to(given, d))
    values, vectors = np.linalg.eigh(given)
    if not np.allclose(given, given.T) or values.min() < -1e-9 * abs(values).max():
        raise ValueError(f"Got input_noise that is no covariance (not symmetric, or not positive), but {expected}")
    return vectors * np.sqrt(np.maximum(values, 0.0))


def unnamed(n: int) -> list[str]:
    """Return the names of outputs that came without."""
    return [f"y{i}" for i in range(n)]


def warn_of_indices(index, y) -> None:
    """Warn when the rows of two tables are named differently."""
    if isinstance(index, pd.Index) and isinstance(y, (pd.DataFrame, pd.Series)) and not index.equals(y.index):
        _warn(
            "The indices of X and y differ; rows are matched by position. If rows of one were dropped or sorted, do "
            "the same to the other (y.loc[X.index])."
        )


def warn_of_samples(X: np.ndarray, Y: np.ndarray, names: list[str]) -> None:
    """Warn of outputs that are constant and of samples that stand twice."""
    constant = [name for name, same in zip(names, constant_columns(Y), strict=True) if same]
    if constant:
        _warn(
            f"The outputs {constant} are constant over the samples: nothing can be learned of how they depend on the "
            "regressors, and their stated uncertainty means little. Leave them out, or check the log."
        )
    repeated = int(pd.DataFrame(np.column_stack([X, Y])).duplicated().sum())
    if repeated:
        _warn(
            f"{repeated} of {len(X)} samples repeat another one, regressors and targets alike. Each counts as new "
            "evidence, so the uncertainty comes out too small: drop repeated rows (was a log read twice?)."
        )


def warn_of_search(best, max_iter: int) -> None:
    """Warn of a search for hyperparameters that was interrupted, or stopped far from an optimum."""
    if best.interrupted:
        _warn(
            f"The fit was interrupted after {best.n_evaluations} evaluations of the likelihood; the best "
            "hyperparameters so far are kept. Fit again for more.",
            ConvergenceWarning,
        )
    elif best.rising:
        _warn(
            f"The fit stopped at max_iter={max_iter} while the log likelihood was still rising fast: the "
            "hyperparameters are not good yet. Raise max_iter, or scale the regressors (StandardScaler).",
            ConvergenceWarning,
        )


def _warn(message, category=UserWarning):
    # From here through the check, fit and scikit-learn's wrapper of it, to who called fit.
    warnings.warn(message, category, stacklevel=5)


def _physical_memory():
    """Return the machine's memory in bytes; infinite where it cannot be told."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return float("inf")
