"""Checks of the data and parameters of DependentGPRegressor, and its warnings."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from sklearn.exceptions import ConvergenceWarning
from sklearn.utils import check_array

from skdgp._compute.files import column_names
from skdgp._compute.linalg import constant_columns
from skdgp._compute.messages import warn
from skdgp._compute.statistics import autocorrelation_time
from skdgp.inference import KnownNoise
from skdgp.kernels import MultiOutputKernel

X_RANGE = (1e-60, 1e60)  # magnitudes of regressors whose fourth powers neither overflow nor vanish
Y_RANGE = (1e-100, 1e100)  # magnitudes of targets whose squares neither overflow nor vanish
SCALED = (
    10.0  # regressors of standard deviations from 1 / SCALED to SCALED need no scaling; a guess
)
# independent rows for each regressor: with fewer bands hold under 85 %, see docs/sharp_bits.md
LEAST_ROWS = 10
# distance from a bound at which a value has reached it, over the width of the bounds or, of
# logarithms, at most over one: guess
BOUND_TOLERANCE = 1e-3
MOST_TOLD = 5  # hyperparameters at bounds that a warning names
WHITE = 2.0  # autocorrelation time, in rows, below which errors count as independent: guess


class FewRowsWarning(UserWarning):
    """There are too few independent rows for the number of regressors: bands are too narrow."""


def check_targets(y: Any, n_samples: int, estimator: str) -> tuple[np.ndarray, list[str], bool]:
    """Return the targets as (n, P) with NaN where not observed, their names, and whether y is one-dimensional."""
    if y is None:
        raise ValueError(
            f"This {estimator} estimator requires y to be passed, but the target y is None."
        )
    names = column_names(y)
    if np.ma.isMaskedArray(y):
        y = np.ma.filled(y.astype(float), np.nan)
    Y = check_array(
        y, dtype=np.float64, ensure_2d=False, ensure_all_finite="allow-nan", input_name="y"
    )
    if Y.ndim > 2:
        raise ValueError(f"Got y of shape {Y.shape}, but expected (n,) or (n, P).")
    if len(Y) != n_samples:
        raise ValueError(
            f"Found input variables with inconsistent numbers of samples: {[n_samples, len(Y)]}. "
            f"Give y one row for "
            "each row of X, with NaN where an output was not observed."
        )
    table = Y.reshape(len(Y), -1)
    return table, names or [f"y{i}" for i in range(table.shape[1])], Y.ndim == 1


def check_unmasked(X: Any) -> None:
    """Raise a ValueError if regressors are masked."""
    if np.ma.isMaskedArray(X) and np.ma.getmaskarray(X).any():
        raise ValueError(
            f"Got X with {int(np.ma.getmaskarray(X).sum())} masked values, but expected all "
            "regressors of every sample: leave these rows out, or fill them."
        )


def standardize(
    Y: np.ndarray, centered: bool, weights: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return centred and scaled targets, and the center and scale of each output, (P,).

    The center is the mean with the ``weights`` (n, P) of the values, by default equal ones.

    The center of a constant output is its value, and its scale is the magnitude of that value, so
    it becomes 0 or 1 without rounding.
    """
    constant, size = constant_columns(Y), np.nanmax(np.abs(Y), axis=0)
    Y = np.where(constant & np.isfinite(Y), Y[np.isfinite(Y).argmax(axis=0), range(Y.shape[1])], Y)
    center = np.zeros(Y.shape[1])
    if centered:
        weighted = np.isfinite(Y) * (1.0 if weights is None else weights)
        mean = np.nansum(weighted * Y, axis=0) / weighted.sum(axis=0)
        center = np.where(constant, np.nanmax(Y, axis=0), mean)
    scale = np.where(
        constant, np.where(size > 0, size, 1.0), np.sqrt(np.nanmean((Y - center) ** 2, axis=0))
    )
    return (Y - center) / scale, center, scale


def check_clock(time: Any, flight: Any, n_samples: int) -> np.ndarray | None:
    """Return time and flight number of each sample, (n, 2), or None if no time is given."""
    if time is None:
        if flight is not None:
            raise ValueError(
                "Got flight without time, but expected both: the drift depends on time. Give time "
                "too."
            )
        return None
    kind = np.asarray(time).dtype
    if kind.kind in "mM":
        raise ValueError(
            f"Got time of type {kind}, but expected seconds: (time - time[0]) / np.timedelta64(1, "
            f"'s')."
        )
    time = check_array(time, dtype=np.float64, ensure_2d=False, input_name="time")
    codes = (
        np.zeros(n_samples) if flight is None else pd.factorize(np.asarray(flight))[0].astype(float)
    )
    for name, values in (("time", time), ("flight", codes)):
        if values.shape != (n_samples,):
            raise ValueError(
                f"Got {name} of shape {values.shape}, but expected ({n_samples},): one value for "
                f"each row of X."
            )
    if (codes < 0).any():
        raise ValueError(
            f"Got {int((codes < 0).sum())} rows without a flight, but expected a label for every "
            f"row."
        )
    return np.column_stack([time, codes])


def check_input_noise(input_noise: Any, n_regressors: int) -> np.ndarray | None:
    """Return known standard deviations of the regressors (d,), None where they are learned or zero."""
    if input_noise is None or isinstance(input_noise, str):
        return None
    std = np.asarray(input_noise, dtype=float)
    if std.shape != (n_regressors,) or not (np.isfinite(std) & (std >= 0)).all():
        raise ValueError(
            f"Got input_noise={input_noise!r}, but expected 'auto', 'learned', None, or a standard "
            f"deviation of at least zero for each of the {n_regressors} regressors."
        )
    return std


def check_noise(variance: Any, bounds: Any, Y: np.ndarray, is_single: bool) -> KnownNoise:
    """Return what is known of the noise of Y (n, P), in squared units of the outputs.

    ``variance`` has one number, one for each output (P,), or one for each value, in the shape of
    Y; ``bounds`` are a pair or (P, 2).
    """
    P = Y.shape[1]
    limits = None
    if bounds is not None:
        limits = np.asarray(bounds, dtype=float)
        if limits.shape not in ((2,), (P, 2)) or not (limits[..., 0] > 0).all():
            raise ValueError(
                f"Got noise_variance_bounds={bounds!r}, but expected a pair of positive numbers, or "
                f"one for each of the {P} outputs."
            )
        if not (limits[..., 0] <= limits[..., 1]).all():
            raise ValueError(
                f"Got noise_variance_bounds={bounds!r}, but expected lower before upper bounds."
            )
        limits = np.broadcast_to(limits, (P, 2)).copy()
    if variance is None:
        return KnownNoise(None, limits)
    values = np.asarray(variance, dtype=float)
    for_values = values.shape == Y.shape or (is_single and values.shape == (len(Y),) != (1,))
    if values.shape not in ((), (P,)) and not for_values:
        raise ValueError(
            f"Got noise_variance of shape {values.shape}, but expected one number, ({P},) for the "
            f"outputs, or one for each value of y, {(len(Y),) if is_single else Y.shape}."
        )
    observed = values.reshape(Y.shape)[np.isfinite(Y)] if for_values else values
    if not (np.isfinite(observed) & (observed > 0)).all():
        raise ValueError(
            "Got noise_variance with values that are not positive and finite, but expected variances "
            "above zero: leave out samples without a known one, or use a small number."
        )
    if for_values and limits is not None:
        raise ValueError(
            "Got noise_variance_bounds and a noise_variance for each value, but expected one of "
            "them: variances of values are known, and not learned."
        )
    if for_values:
        table = np.where(np.isfinite(Y), values.reshape(Y.shape), np.nan)
        return KnownNoise.of_values(np.where(np.isnan(table), np.nanmin(table, axis=0), table))
    white = np.broadcast_to(values, P).astype(float)
    fixed = np.column_stack([white, white])
    return KnownNoise(white, fixed if limits is None else limits)


def check_magnitudes(Z: np.ndarray, names: list[str], what: str, least: float, most: float) -> None:
    """Raise a ValueError if powers of columns of Z (n, k) overflow or vanish in double precision; NaN is ignored."""
    size = np.nanmax(np.abs(Z), axis=0, initial=0.0)
    extreme = (size > most) | ((size < least) & (size > 0))
    if extreme.any():
        magnitudes = {
            name: f"{s:.1g}" for name, s, out in zip(names, size, extreme, strict=True) if out
        }
        raise ValueError(
            f"Got {what} of magnitudes {magnitudes}, but expected {least:g} to {most:g}, whose "
            f"powers neither vanish "
            "nor overflow. Use another unit, or scale them (StandardScaler)."
        )


def check_observed(Y: np.ndarray, names: list[str]) -> None:
    """Raise a ValueError if an output has fewer than two observed values."""
    few = {name: int(n) for name, n in zip(names, np.isfinite(Y).sum(axis=0), strict=True) if n < 2}
    if few:
        raise ValueError(
            f"Got outputs observed at fewer than two samples: {few} (NaN means not observed). "
            f"Leave these columns out, "
            "or give more of their values."
        )


def warn_of_approximation(neglected: float, n_inducing: int, n_exact: int | None) -> None:
    """Warn that inducing inputs leave a variance unexplained, ``neglected`` over the noise variance.

    ``n_exact``: the number of values that the model is learned from instead, if any.
    """
    remedy = (
        "predictions are less accurate than those of exact inference. Raise n_inducing."
        if n_exact is None
        else f"the model is learned from {n_exact} of the values instead. Raise n_inducing to learn "
        "from all."
    )
    _warn(
        f"{n_inducing} inducing inputs leave {neglected:.2g} of the noise variance unexplained: "
        f"{remedy}",
        stacklevel=9,
    )


def warn_of_indices(index: Any, y: Any) -> None:
    """Warn if X and y have different indices."""
    if (
        isinstance(index, pd.Index)
        and isinstance(y, (pd.DataFrame, pd.Series))
        and not index.equals(y.index)
    ):
        _warn(
            "The indices of X and y differ; rows are matched by position. If rows of one were "
            "dropped or sorted, do "
            "the same to the other (y.loc[X.index])."
        )


def warn_of_samples(
    X: np.ndarray, Y: np.ndarray, regressors: list[str], outputs: list[str]
) -> None:
    """Warn of constant regressors and outputs, and of repeated samples."""
    for what, Z, names, consequence in (
        ("regressors", X, regressors, "their effect cannot be learned, and predictions at other "
         "values are not reliable. Leave them out, or add samples in which they vary."),
        ("outputs", Y, outputs, "nothing can be learned about them, and their stated uncertainty "
         "is not reliable. Leave them out, or check the log."),
    ):  # fmt: skip
        constant = [name for name, same in zip(names, constant_columns(Z), strict=True) if same]
        if constant:
            _warn(f"The {what} {constant} are constant over the samples: {consequence}")
    repeated = int(pd.DataFrame(np.column_stack([X, Y])).duplicated().sum())
    if repeated:
        _warn(
            f"{repeated} of {len(X)} samples repeat another sample with the same regressors and "
            f"targets. They count as "
            "independent, so the uncertainty is too small: drop repeated rows (was a log read "
            "twice?)."
        )


def warn_of_few_rows(errors: np.ndarray, n_regressors: int, members: list[str]) -> None:
    """Warn if there are fewer than `LEAST_ROWS` independent rows for each regressor.

    ``errors`` (n, P) are residuals of the targets, in the order of the log, NaN where
    not observed. They count as rows over their autocorrelation time, median over the outputs. An
    average leans on its trend then. A trend alone states its uncertainty well with few rows, unless
    their errors are correlated.
    """
    observed = [column[np.isfinite(column)] for column in errors.T]
    lasting = float(np.median([autocorrelation_time(e) for e in observed]))
    lasting = lasting if lasting >= WHITE else 1.0
    rows = float(np.median([len(column) for column in observed])) / lasting
    if rows >= LEAST_ROWS * n_regressors or (members == ["trend"] and lasting == 1.0):
        return
    because = (
        f", worth {rows:.0f} independent ones as errors last {lasting:.0f} rows,"
        if lasting > 1.0
        else ""
    )
    _warn(
        f"Got {len(errors)} rows{because} for {n_regressors} regressors, "
        f"{rows / n_regressors:.2g} for each, but "
        f"expected at least {LEAST_ROWS} for each: with fewer, the model leans on the linear "
        f"trend, and standard "
        "deviations may be too small. Give more rows or minutes of manoeuvres, or name fewer "
        "regressors.",
        FewRowsWarning,
        stacklevel=7,
    )


def warn_of_search(best, max_iter: int, X: np.ndarray, names: list[str]) -> None:
    """Warn if the search for hyperparameters was interrupted or has not converged; X (n, d) may lack scaling."""
    if best.interrupted:
        _warn(
            "The fit was interrupted; the best hyperparameters so far are kept. Fit again to "
            "continue.",
            ConvergenceWarning,
            stacklevel=7,
        )
    elif not best.converged:
        unscaled = [
            name
            for name, std in zip(names, X.std(axis=0), strict=True)
            if std > SCALED or 0 < std < 1 / SCALED
        ]
        scale = f", or scale the regressors {unscaled} (StandardScaler)" if unscaled else ""
        _warn(
            f"The fit stopped at max_iter={max_iter} before it converged: in as many iterations "
            f"again the log "
            f"likelihood is expected to rise by {best.remaining:,.0f} nats. Raise max_iter{scale}.",
            ConvergenceWarning,
            stacklevel=7,
        )


def _warn(message, category=UserWarning, stacklevel=6):
    # stacklevel: this function, the check, _checked, fit, its wrapper, and the caller of fit; other
    # checks are called from deeper
    warn(message, category, stacklevel=stacklevel)


def warn_of_bounds(given: MultiOutputKernel, kernel: MultiOutputKernel) -> None:
    """Warn of hyperparameters that end at a bound which the user gave.

    ``kernel`` is the fitted one, in the units of ``given``, whose terms are its last ones. A value
    that was given at its bound and stayed there is no news.
    """
    terms = given.summands()
    reached = []
    for term, fitted in zip(terms, kernel.summands()[-len(terms) :], strict=True):
        before = _at_bounds(term) if term.has_values() else {}
        reached += [
            text
            for name, text in _at_bounds(fitted).items()
            if name not in before and not term.bounds_from_data(name[0])
        ]
    if reached:
        more = f" and {len(reached) - MOST_TOLD} more" if len(reached) > MOST_TOLD else ""
        _warn(
            f"Got hyperparameters that end at a bound of the kernel: "
            f"{', '.join(reached[:MOST_TOLD])}{more}. Widen the bounds, unless they are known to "
            "hold.",
            ConvergenceWarning,
            stacklevel=7,
        )


def _at_bounds(kernel):
    """Return texts of the elements that are at a bound, by the name, number and side of each."""
    reached = {}
    for f in kernel.free_parameters():
        if not f.n_elements:
            continue
        values = f.elements(kernel.value(f.name))
        pairs = f.pairs()
        scaled = np.column_stack([pairs, values])
        low, high, at = (np.log(scaled) if f.log else scaled).T
        tolerance = BOUND_TOLERANCE * np.minimum(high - low, 1.0 if f.log else np.inf)
        for side, distance in (("lower", at - low), ("upper", high - at)):
            for k in np.flatnonzero(np.abs(distance) <= tolerance):
                bound = pairs[k, int(side == "upper")]
                entry = np.argwhere(f.index == k)[0].tolist()
                text = f"{f.name}{entry} = {values[k]:.3g} ({side} bound {bound:.3g})"
                reached[f.name, int(k), side] = text
    return reached
